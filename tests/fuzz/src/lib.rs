//! Shared checks of the fuzz targets, beyond the absence of panics.
//!
//! | expected | seen by |
//! |---|---|
//! | an error is one line that can be printed | [`checked`] |
//! | a written file reads back the same | the targets |
//! | where nothing writes it: the same content in another form reads the same | [`said_anew`], and the target `batch` |
//! | a finding has its file, and a line of it | [`placed`] |
//! | memory and time are bounded | libFuzzer's limits (`.ci/run`) |
//!
//! `RTEC_FUZZ_PLANTED=panic|text|memory|time` plants a fault of that kind behind three letters. `.ci/run` shows that it
//! is found.

use rtec_files::InputError;
use std::fmt::Display;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

/// A file name for readers of text, without any files beside it.
pub const NAME: &str = "/nonexistent/in";

/// Kind of the planted fault, if any.
static PLANTED: LazyLock<Option<String>> = LazyLock::new(|| std::env::var("RTEC_FUZZ_PLANTED").ok());

/// A reader's result; asserts that its error can be shown to people.
pub fn checked<T, E: Display>(result: Result<T, E>) -> Option<T> {
    result.map_err(|e| fit(&e.to_string())).ok()
}

/// Asserts that a message can be shown as it is.
/// It has text, is on one line, and has nothing that a terminal acts on.
pub fn fit(message: &str) {
    assert!(!message.trim().is_empty(), "an error without words");
    assert!(!message.chars().any(char::is_control), "an error that does not print: {message:?}");
}

/// Asserts that a finding names its file and a line of the text.
/// The line after the last is allowed, where rows should begin.
pub fn placed(finding: &InputError, text: &str) {
    fit(&finding.to_string());
    assert_eq!(finding.file, Path::new(NAME), "{finding}");
    assert!(finding.line <= text.matches('\n').count() + 2, "{finding}: a line that is not there");
}

/// The same TOML as another program writes it, between two comments.
/// It has no comments or blanks of its own, tables for dotted keys, and decimal numbers. Numbers beyond that program's
/// range are not supported.
pub fn said_anew(text: &str) -> Option<String> {
    let table: toml::Table = text.parse().ok()?;
    let text = toml::to_string(&table).expect("what was TOML is TOML");
    Some(format!("# said anew\r\n\n{text}\n\t# the end"))
}

/// The input as text, as a reader of files gets it.
pub fn text(data: &[u8]) -> Option<String> {
    if let Some(kind) = PLANTED.as_deref() {
        plant(data, kind);
        return None;
    }
    checked(rtec_files::text_file::decode(Path::new(NAME), data))
}

/// An input of several files, separated by lines of `%%`; missing ones are empty.
pub fn parts<const N: usize>(text: &str) -> [&str; N] {
    let mut rest = Some(text);
    [(); N].map(|()| match rest.and_then(|r| r.split_once("\n%%\n")) {
        Some((part, more)) => {
            rest = Some(more);
            part
        }
        None => rest.take().unwrap_or_default(),
    })
}

/// Writes a file for readers that take no text, and returns its path.
pub fn put(name: &str, bytes: &[u8]) -> PathBuf {
    static FOLDER: LazyLock<PathBuf> = LazyLock::new(|| {
        let folder = std::env::temp_dir().join(format!("rtec-fuzz-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("the folder for temporary files can be written to");
        folder
    });
    let path = FOLDER.join(name);
    std::fs::write(&path, bytes).expect("the folder for temporary files can be written to");
    path
}

fn plant(data: &[u8], kind: &str) {
    // One byte at a time, each in a branch, so that a fuzzer that follows coverage gets there.
    let is = |n: usize, byte: u8| black_box(data.get(n).copied()) == Some(byte);
    if is(0, b'R') && is(1, b'T') && is(2, b'E') {
        match kind {
            "text" => fit("found \u{1b}[2J, expected nothing of the kind"),
            "memory" => drop(black_box(vec![1_u8; 1 << 30])),
            "time" => loop {
                std::thread::yield_now();
            },
            _ => panic!("planted"),
        }
    }
}
