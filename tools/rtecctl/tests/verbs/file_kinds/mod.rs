//! Files and readings as users have them, one test per kind.
//! Each has the right value.

#![allow(clippy::format_collect, clippy::format_push_string, reason = "inputs of tests")]

mod columns;
mod dialects;
mod readings;
mod signals;

use serde_json::Value;
use std::path::Path;
use std::process::Command;

/// A folder with all inputs, including those of the crates below.
fn inputs() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let own = Path::new(env!("CARGO_MANIFEST_DIR"));
    for from in ["tests/verbs/kinds", "../measure/tests/field", "../part/tests/field"] {
        for entry in std::fs::read_dir(own.join(from)).unwrap() {
            let entry = entry.unwrap();
            std::fs::copy(entry.path(), folder.path().join(entry.file_name())).unwrap();
        }
    }
    folder
}

struct Run {
    exit: i32,
    out: String,
    err: String,
}

impl Run {
    fn json(&self) -> Value {
        serde_json::from_str(&self.out).unwrap_or_else(|e| panic!("{e}: {}\n{}", self.out, self.err))
    }

    fn figure(&self, pointer: &str) -> f64 {
        let json = self.json();
        json.pointer(pointer).and_then(Value::as_f64).unwrap_or_else(|| panic!("no {pointer} in {json}"))
    }

    fn says(&self, text: &str) -> bool {
        self.out.contains(text) || self.err.contains(text)
    }
}

fn run(folder: &Path, words: &[&str]) -> Run {
    let done = Command::new(env!("CARGO_BIN_EXE_rtecctl")).current_dir(folder).args(words).output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    Run { exit: done.status.code().unwrap(), out: text(done.stdout), err: text(done.stderr) }
}

fn words(line: &str) -> Vec<&str> {
    line.split(' ').collect()
}

/// The numbers of a CSV's column.
fn column(folder: &Path, file: &str, name: &str) -> Vec<f64> {
    let text = std::fs::read_to_string(folder.join(file)).unwrap();
    let mut lines = text.lines();
    let place = lines.next().unwrap().split(',').position(|n| n.trim_matches('"') == name).unwrap();
    lines.map(|l| l.split(',').nth(place).unwrap().parse().unwrap()).collect()
}
