//! The help: verbs by the role of their user, with examples and exit codes.

use crate::terminal::flowed;
use crate::{Cli, VERBS};
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Command, CommandFactory};
use rtec_files::message_text::nearest;
use std::ffi::OsString;
use std::fmt::Write as _;

/// Roles of users, with what each does.
const ROLES: [(&str, &str); 5] = [
    ("operator", "runs the machine"),
    ("integrator", "wires it, sets it up, connects it to the plant"),
    ("metrologist", "measures it and makes its model"),
    ("part", "probes and compensates a part"),
    ("anyone", "looks round: no hardware, no daemon"),
];

/// Exit codes of verbs that ask the daemon.
/// Below: of verbs that only show something, and of verbs that judge.
pub(crate) const ASKS: &str = "0 done; 1 refused; 2 bad usage; 3 no daemon; 4 a fault is latched";
pub(crate) const SHOWS: &str = "0 shown; 2 bad usage; 3 no daemon";
pub(crate) const JUDGES: &str = "0 yes; 1 no; 2 bad input or usage";
pub(crate) const READS: &str = "0 done; 2 bad input or usage";

/// The verb that clap adds by itself, as in [`VERBS`].
const HELP: (&str, usize, &str, &str) = ("help", 4, "rtecctl help status", READS);

fn all() -> impl Iterator<Item = &'static (&'static str, usize, &'static str, &'static str)> {
    VERBS.iter().chain([&HELP])
}

/// Examples of verbs below a verb whose own example is of another.
#[rustfmt::skip] // a verb a line
const BELOW: [&str; 17] = [
    "rtecctl card show parallel-port",
    "rtecctl card probe --config rtec.toml --watch --for 10s",
    "rtecctl characterise import x.csv --format csv --columns x=position.x,dir=direction.x,e=error.x --out x.run.toml",
    "rtecctl characterise plan --axes x=500,y=400 --out plan.md",
    "rtecctl characterise record --sensors sensors.toml --feed 127.0.0.1:47901 --columns e=error.x --duration 90s --out x.run.toml",
    "rtecctl model compare machine.toml found/model.toml",
    "rtecctl model export --machine machine.toml --axis x --from 0 --to 500 --format linuxcnc --out x.comp",
    "rtecctl model fit --record drift.run.toml --out fitted.toml",
    "rtecctl model load machine.toml",
    "rtecctl model predict --machine machine.toml --record x.run.toml --out predicted.csv",
    "rtecctl model rehearse --machine machine.toml --record x.run.toml",
    "rtecctl model validate --machine machine.toml --record x.run.toml",
    "rtecctl part errors --points probed.csv --radius-mm 25",
    "rtecctl part features nose.dxf",
    "rtecctl part points nose.dxf --tip-mm 2.5 --out semi",
    "rtecctl part table --errors error.cor --out table",
    "rtecctl trace from-position x.csv --count-um 1 --out trace.csv",
];

/// First steps of a newcomer: the aim, and its command.
const BEGIN: [(&str, &str); 8] = [
    ("see a machine corrected, ten seconds, no hardware", "rtecctl demo"),
    ("have a machine to try everything on", "rtecctl example mill mill"),
    ("see whether mine is corrected, and if not, why not", "rtecctl status"),
    ("see what this computer lacks for it", "rtecctl platform"),
    ("write its configuration", "rtecctl config default"),
    ("plan its measurements", "rtecctl characterise plan --axes x=500,y=400"),
    ("go through a part on a simulated lathe", "rtecctl part run"),
    ("see all verbs, or one", "rtecctl help"),
];

/// Text that `rtecctl` prints without arguments.
pub(crate) fn begin() -> String {
    let mut text = "Where to begin:\n".to_owned();
    for (want, command) in BEGIN {
        let _ = writeln!(text, "  {want:<51}  {command}");
    }
    text + "The guide: /usr/share/doc/rtec/guide of the package, tools/guide of the source.\n"
}

/// The whole command line with its help.
pub(crate) fn command() -> Command {
    let mut command = crate::with_negative_values(Cli::command());
    let mut list = String::new();
    for (n, (role, who)) in ROLES.iter().enumerate() {
        let _ = writeln!(list, "{}{role}: {who}", if n == 0 { "" } else { "\n" });
        for (verb, ..) in all().filter(|v| v.1 == n) {
            let about = command.find_subcommand(verb).and_then(Command::get_about).map(ToString::to_string);
            let about = about.unwrap_or_else(|| "Print this, or the help of a verb".to_owned());
            let _ = writeln!(list, "  {verb:<13} {}", flowed(&about, 16, 16, 79));
        }
    }
    for (verb, _, example, codes) in VERBS {
        let text = format!("Example: {example}\nExit codes: {codes}");
        command = command.mut_subcommand(verb, |c| c.after_help(text));
    }
    command
        .help_template("{about}\n\n{usage-heading} {usage}{after-help}\nOptions:\n{options}")
        .after_help(list)
}

/// The command line with one verb only; none if there is no such verb.
pub(crate) fn command_of(verb: &str) -> Option<Command> {
    let own = crate::Verb::described(verb)?;
    Some(crate::with_negative_values(Command::new("rtecctl").subcommand(own)))
}

/// Adds the most similar verbs to an error about an unknown verb.
/// clap compares letters among the verbs of one level only, and proposes `enable` for `evaluate`.
pub(crate) fn with_meant(mut error: clap::Error, words: &[OsString]) -> clap::Error {
    let word = match (error.kind(), error.get(ContextKind::InvalidSubcommand)) {
        (ErrorKind::InvalidSubcommand, Some(ContextValue::String(word))) => word.clone(),
        _ => return error,
    };
    let command = Cli::command();
    let (mut place, mut under) = (&command, Vec::new());
    for name in words.iter().skip(1).filter_map(|w| w.to_str()).filter(|w| *w != "help") {
        let Some(next) = place.find_subcommand(name) else { break };
        place = next;
        under.push(name.to_owned());
    }
    let suggestion = match &meant(&command, place, &under, &word)[..] {
        [] => ContextValue::None,
        [one] => ContextValue::String(one.clone()),
        all => ContextValue::Strings(all.to_vec()),
    };
    error.insert(ContextKind::SuggestedSubcommand, suggestion);
    error
}

/// The verbs that a word may mean at the level of `place`.
/// They have their full names, unless they belong to `place`.
fn meant(command: &Command, place: &Command, under: &[String], word: &str) -> Vec<String> {
    let mut all = Vec::new();
    paths(command, &mut Vec::new(), &mut all);
    let called = |name: &str| {
        let of_name =
            all.iter().filter(|p| p.last().is_some_and(|last| last == name) && p[..p.len() - 1] != *under);
        of_name.map(|p| p.join(" ")).collect::<Vec<_>>()
    };
    let exactly = called(word);
    if !exactly.is_empty() {
        return exactly;
    }
    let own: Vec<&str> = place.get_subcommands().map(Command::get_name).collect();
    // `enable` switches corrections on, so it is proposed only for a word that begins like it.
    let begun = |near: &str| near != "enable" || word.starts_with("en");
    if let Some(near) = nearest(word, &own).filter(|near| begun(near)) {
        return vec![near.to_owned()];
    }
    let others: Vec<&str> = all.iter().filter_map(|p| p.last().map(String::as_str)).collect();
    nearest(word, &others).filter(|near| begun(near)).map_or_else(Vec::new, called)
}

/// Every verb, with the verbs above it.
fn paths(command: &Command, under: &mut Vec<String>, all: &mut Vec<Vec<String>>) {
    for verb in command.get_subcommands() {
        under.push(verb.get_name().to_owned());
        all.push(under.clone());
        paths(verb, under, all);
        under.pop();
    }
}

/// Hints after a usage error: an example of the verb and its list of names.
/// A hint that the error already contains is left out.
pub(crate) fn next(words: &[OsString], said: &str) -> String {
    let word = |n: usize| words.get(n).and_then(|w| w.to_str()).unwrap_or_default();
    let (verb, below) = (word(1), word(2));
    let command = Cli::command();
    let found = command.find_subcommand(verb);
    let mut examples = all().filter(|v| v.0 == verb).map(|v| v.2);
    let example = match found.and_then(|c| c.find_subcommand(below)) {
        // An example of another verb below it would mislead.
        Some(_) => examples.chain(BELOW).find(|e| e.split(' ').take(3).eq(["rtecctl", verb, below])),
        None => examples.next(),
    };
    let Some(example) = example.filter(|_| !said.contains("Example:")) else { return String::new() };
    let mut text = format!("Example: {example}\n");
    let mut options = found.into_iter().flat_map(Command::get_arguments);
    if options.any(|a| a.get_long() == Some("list")) && !example.ends_with("--list") {
        let _ = writeln!(text, "Names: rtecctl {verb} --list");
    }
    text
}

#[cfg(test)]
pub(crate) mod tests;
