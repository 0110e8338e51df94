//! The guide's page of verbs, generated from the command line itself.
//! `RTEC_BLESS=1` rewrites it.

use super::known;
use crate::help::command;
use clap::builder::StyledStr;
use clap::{Arg, Command};
use std::fmt::Write as _;
use std::path::Path;

const HEAD: &str = "# Verbs\n\n\
    Every verb of `rtecctl`, as the program itself knows it. `--json` prints one document on standard output; messages, progress and\n\
    warnings go to standard error. Exit codes: 0 done; 1 the run finished and the answer is no; 2 bad input or usage; 3 daemon or\n\
    hardware not reached; 4 fault latched.\n";

#[test]
fn the_page_of_verbs_is_what_the_program_takes() {
    let mut root = command();
    root.build();
    let mut page = HEAD.to_owned();
    for (role, who, verbs) in known() {
        let list = verbs.iter().filter(|v| **v != "help").map(|v| format!("[`{v}`](#{v})"));
        let _ = write!(page, "\n**{role}**, {who}: {}\n", list.collect::<Vec<_>>().join(", "));
    }
    let mut verbs = 0;
    for (_, _, names) in known() {
        for name in names.iter().filter(|n| **n != "help") {
            describe(&mut page, root.find_subcommand(name).unwrap(), name, 2);
            verbs += 1;
        }
    }
    assert_eq!(verbs, root.get_subcommands().filter(|c| c.get_name() != "help").count());
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../guide/reference/verbs.md");
    test_needs::golden(&file, &page);
}

fn describe(page: &mut String, verb: &Command, path: &str, depth: usize) {
    let _ = write!(page, "\n{} {path}\n\n", "#".repeat(depth.min(4)));
    let about = plain(verb.get_long_about().or(verb.get_about()));
    let _ = writeln!(page, "{}\n", sentence(&about));
    let usage = verb.clone().render_usage().to_string();
    let _ =
        write!(page, "```text\n{}\n```\n", usage.trim_start_matches("Usage: ").replace("\n       ", "\n"));
    let own = |a: &&Arg| !matches!(a.get_id().as_str(), "help" | "version") && !a.is_hide_set();
    let args: Vec<&Arg> = verb.get_arguments().filter(own).collect();
    if !args.is_empty() {
        page.push_str("\n| option | meaning | values, default |\n|---|---|---|\n");
        for arg in args {
            let _ = writeln!(page, "| {} | {} | {} |", option(arg), meaning(arg), values(arg));
        }
    }
    for line in plain(verb.get_after_help()).lines() {
        let (what, text) = line.split_once(": ").unwrap();
        let text = if what == "Example" { format!("`{text}`") } else { text.to_owned() };
        let _ = write!(page, "\n{what}: {text}\n");
    }
    for sub in verb.get_subcommands().filter(|c| c.get_name() != "help") {
        describe(page, sub, &format!("{path} {}", sub.get_name()), depth + 1);
    }
}

fn plain(text: Option<&StyledStr>) -> String {
    text.map(ToString::to_string).unwrap_or_default()
}

/// A text with a full stop at its end.
fn sentence(text: &str) -> String {
    let text = text.trim();
    format!("{text}{}", if text.ends_with(['.', ':']) || text.is_empty() { "" } else { "." })
}

/// A table cell in which no character ends the cell or the row.
/// Text that looks like HTML is escaped.
fn cell(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ").replace('|', "\\|").replace('<', "&lt;")
}

fn option(arg: &Arg) -> String {
    let value = arg.get_value_names().map(|n| n.join(" ")).filter(|_| arg.get_action().takes_values());
    let name = match (arg.get_long(), arg.get_short()) {
        (Some(long), _) => format!("--{long}"),
        (None, Some(short)) => format!("-{short}"),
        (None, None) => return format!("`{}`", value.unwrap_or_default().replace('|', "\\|")),
    };
    let value = value.map(|v| format!(" {v}")).unwrap_or_default();
    format!("`{name}{}`", value.replace('|', "\\|"))
}

fn meaning(arg: &Arg) -> String {
    cell(&plain(arg.get_long_help().or(arg.get_help())))
}

fn values(arg: &Arg) -> String {
    let mut said = Vec::new();
    let shown = arg.get_action().takes_values() && !arg.is_hide_possible_values_set();
    let possible = arg.get_possible_values();
    if shown && !possible.is_empty() {
        let each = possible.iter().map(|v| match v.get_help() {
            Some(help) => format!("`{}` ({})", v.get_name(), cell(&help.to_string())),
            None => format!("`{}`", v.get_name()),
        });
        said.push(each.collect::<Vec<_>>().join(", "));
    }
    let default = arg.get_default_values().iter().map(|v| v.to_string_lossy()).collect::<Vec<_>>().join(" ");
    if arg.get_action().takes_values() && !default.is_empty() {
        said.push(format!("default `{default}`"));
    }
    if arg.is_required_set() {
        said.push("must be given".to_owned());
    }
    if matches!(arg.get_action(), clap::ArgAction::Append)
        || arg
            .get_num_args()
            .is_some_and(|n| n.max_values() > 1 && arg.get_value_names().is_none_or(|v| v.len() == 1))
    {
        said.push("may repeat".to_owned());
    }
    said.join("; ")
}
