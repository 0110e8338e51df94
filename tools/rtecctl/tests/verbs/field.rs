//! Cases of people who do this job, from `tests/field/`: each is run as its table says, and prints what is right.

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
    /// What the command reads first.
    input: String,
    /// The public report after which the input was made; the numbers are ours.
    source: String,
    /// What kind of mistake it stands for.
    kind: String,
    /// What `rtecctl` is asked.
    run: String,
    exit: i32,
    /// What is right.
    right: String,
    /// What was printed before.
    was: String,
    /// Parts of what is printed.
    says: Vec<String>,
    /// Parts of nothing that is printed.
    #[serde(default)]
    never: Vec<String>,
    /// Figures of the JSON document: pointer, value, tolerance.
    #[serde(default)]
    figures: Vec<(String, f64, f64)>,
}

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/field")
}

fn cases() -> Vec<Case> {
    let text = std::fs::read_to_string(folder().join("cases.toml")).unwrap();
    toml::from_str::<Cases>(&text).unwrap().case
}

/// A copy of the inputs, for commands that write beside them.
fn copied() -> tempfile::TempDir {
    let copy = tempfile::tempdir().unwrap();
    for entry in std::fs::read_dir(folder()).unwrap() {
        let entry = entry.unwrap();
        std::fs::copy(entry.path(), copy.path().join(entry.file_name())).unwrap();
    }
    copy
}

fn run(dir: &Path, words: &str) -> (i32, String, String) {
    let out =
        Command::new(env!("CARGO_BIN_EXE_rtecctl")).current_dir(dir).args(words.split(' ')).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (out.status.code().unwrap_or(-1), text(out.stdout), text(out.stderr))
}

#[test]
fn field_cases_print_what_is_right() {
    let mut wrong = String::new();
    for case in cases() {
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
        if exit == 2 {
            let before = std::fs::read_dir(folder()).unwrap().count();
            if std::fs::read_dir(dir.path()).unwrap().count() != before {
                miss("leaves a file".to_owned());
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong}");
}

#[test]
fn the_table_of_field_cases_lists_them_all() {
    let mut rows = String::new();
    for case in cases() {
        let cell = |text: &str| text.replace('|', "\\|");
        let _ = writeln!(
            rows,
            "| `{}` | {} | {} | `{}` | {} | {} |",
            case.input,
            case.source,
            cell(&case.kind),
            cell(&case.run),
            cell(&case.right),
            cell(&case.was)
        );
    }
    let file = folder().join("README.md");
    let text = std::fs::read_to_string(&file).unwrap();
    let begin = text.find("| input |").unwrap();
    let table = format!(
        "| input | source | kind | `rtecctl` … | right | printed before |\n|---|---|---|---|---|---|\n{rows}"
    );
    let wanted = format!("{}{table}", &text[..begin]);
    if std::env::var_os("RTEC_BLESS").is_some() {
        std::fs::write(&file, &wanted).unwrap();
    } else {
        assert_eq!(text, wanted, "RTEC_BLESS=1 writes it");
    }
}
