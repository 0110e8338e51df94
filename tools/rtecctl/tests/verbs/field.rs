//! Cases of users, from `tests/field/`; each runs as its table says.
//! Each must print what is right.
//!
//! `cases.toml` contains the first round, `further.toml` a second one that also states the present output.

use serde::Deserialize;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

#[derive(Deserialize)]
struct Cases {
    case: Vec<Case>,
}

#[derive(Deserialize)]
struct Case {
    /// The command's first input.
    input: String,
    /// The public report that the input imitates; the numbers are ours.
    source: String,
    /// The kind of mistake that it represents.
    kind: String,
    /// Its kind was not among the first cases.
    #[serde(default)]
    unlike: bool,
    /// The arguments of `rtecctl`.
    run: String,
    exit: i32,
    /// The right answer.
    right: String,
    /// The earlier output.
    was: String,
    /// The present output in words; only in cases of the second round.
    #[serde(default)]
    now: String,
    /// Parts that the output must contain.
    says: Vec<String>,
    /// Parts that the output must not contain.
    #[serde(default)]
    never: Vec<String>,
    /// Figures of the JSON document: pointer, value, tolerance.
    #[serde(default)]
    figures: Vec<(String, f64, f64)>,
    /// Lines of a written file: its name, the line.
    #[serde(default)]
    writes: Vec<(String, String)>,
}

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/field")
}

fn cases(file: &str) -> Vec<Case> {
    let text = std::fs::read_to_string(folder().join(file)).unwrap();
    toml::from_str::<Cases>(&text).unwrap().case
}

/// A copy of the inputs, for commands that write into their folder.
fn copied() -> tempfile::TempDir {
    let copy = tempfile::tempdir().unwrap();
    for entry in std::fs::read_dir(folder()).unwrap() {
        let entry = entry.unwrap();
        std::fs::copy(entry.path(), copy.path().join(entry.file_name())).unwrap();
    }
    copy
}

/// The words of a command, separated by blanks.
/// Text between single quotes is one word.
fn words(command: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let mut quoted = false;
    for c in command.chars() {
        match c {
            '\'' => quoted = !quoted,
            ' ' if !quoted => words.push(String::new()),
            other => words.last_mut().unwrap().push(other),
        }
    }
    words
}

fn run(dir: &Path, command: &str) -> (i32, String, String) {
    let out =
        Command::new(env!("CARGO_BIN_EXE_rtecctl")).current_dir(dir).args(words(command)).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (out.status.code().unwrap_or(-1), text(out.stdout), text(out.stderr))
}

#[test]
fn field_cases_print_what_is_right() {
    if !test_needs::long() {
        return;
    }
    check("cases.toml");
}

#[test]
fn further_field_cases_print_what_is_right() {
    if !test_needs::long() {
        return;
    }
    check("further.toml");
}

fn check(file: &str) {
    let mut wrong = String::new();
    for case in cases(file) {
        let dir = copied();
        let (exit, out, err) = run(dir.path(), &case.run);
        let printed = format!("{out}{err}");
        let mut miss = |what: String| {
            let _ = writeln!(wrong, "{}: `{}`: {what}\n{printed}\n", case.input, case.run);
        };
        if exit != case.exit {
            miss(format!("exit code {exit}, not {}", case.exit));
        }
        for part in case.says.iter().filter(|part| !printed.contains(part.as_str())) {
            miss(format!("does not say {part:?}"));
        }
        for part in case.never.iter().filter(|part| printed.contains(part.as_str())) {
            miss(format!("says {part:?}"));
        }
        if !case.figures.is_empty() {
            let document: serde_json::Value = serde_json::from_str(&out).unwrap_or_default();
            for (pointer, value, within) in &case.figures {
                let found = document.pointer(pointer).and_then(serde_json::Value::as_f64);
                if found.is_none_or(|found| (found - value).abs() > *within) {
                    miss(format!("{pointer} is {found:?}, not {value} ± {within}"));
                }
            }
        }
        for (file, line) in &case.writes {
            let written = std::fs::read_to_string(dir.path().join(file)).unwrap_or_default();
            if !written.lines().any(|own| own == line) {
                miss(format!("{file} has no line {line:?}, but:\n{written}"));
            }
        }
        if exit == 2 {
            let before = std::fs::read_dir(folder()).unwrap().count();
            if std::fs::read_dir(dir.path()).unwrap().count() != before {
                miss("leaves a file".to_owned());
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong}");
}

/// The rows of a table in Markdown.
/// With `now`, the present output is the last cell.
fn rows(file: &str, now: bool) -> String {
    let cell = |text: &str| text.replace('|', "\\|");
    let row = |case: &Case| {
        let mut cells = vec![
            format!("`{}`", case.input),
            case.source.clone(),
            cell(&case.kind) + if case.unlike { " (new)" } else { "" },
            format!("`{}`", cell(&case.run)),
            cell(&case.right),
            cell(&case.was),
        ];
        if now {
            cells.push(cell(&case.now));
        }
        format!("| {} |\n", cells.join(" | "))
    };
    cases(file).iter().map(row).collect()
}

/// Cases from public reports, not trials of users: a least number.
/// A third of them are of new kinds.
#[test]
fn a_third_of_the_public_cases_are_new_kinds() {
    for (file, fewest) in [("cases.toml", 20), ("further.toml", 20)] {
        let public: Vec<Case> = cases(file).into_iter().filter(|c| c.source != "a user's trial").collect();
        let new = public.iter().filter(|c| c.unlike).count();
        assert!(public.len() >= fewest && 3 * new >= public.len(), "{file}: {new} of {}", public.len());
    }
}

#[test]
fn the_table_of_field_cases_lists_them_all() {
    let file = folder().join("README.md");
    let text = std::fs::read_to_string(&file).unwrap();
    let begin = text.find("| input |").unwrap();
    let (first, second) = (rows("cases.toml", false), rows("further.toml", true));
    let head = "| input | source | kind | `rtecctl` … | right | printed before |";
    let wanted = format!(
        "{}{head}\n|---|---|---|---|---|---|\n{first}\n## Further cases\n\n`further.toml` holds these. Right values are by hand, \
         by Python's `statistics` and `datetime`, or by the other\nprogram's own rule. The last column says what is printed now, and \
         what stays wrong.\n\n{head} printed now |\n|---|---|---|---|---|---|---|\n{second}",
        &text[..begin]
    );
    if std::env::var_os("RTEC_BLESS").is_some() {
        std::fs::write(&file, &wanted).unwrap();
    } else {
        assert_eq!(text, wanted, "RTEC_BLESS=1 writes it");
    }
}
