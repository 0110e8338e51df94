//! Needs of tests beyond the project: other programs, measured data, root.
//!
//! Where one is missing, the test says so and ends. The test harness hides the output of a passing test. So it is
//! noted, and the last test of `cargo test --workspace` names all tests that were not run.
//!
//! With `RTEC_REQUIRE=1`, as `.ci/run` sets it, no program may be missing. A clone without the folder `../shared/data`
//! passes without measured data, and says so. What takes long runs with `RTEC_LONG=1` or `RTEC_REQUIRE=1` ([`long`]).
//!
//! It also has shared parts of tests: random numbers ([`dice`]), and an axis that moves ([`motion`]).

#![allow(
    clippy::missing_panics_doc,
    reason = "they panic where they cannot do their work, and the test fails"
)]

pub mod dice;
pub mod motion;

use std::io::Write;
use std::os::unix::process::parent_id;
use std::path::{Path, PathBuf};

/// Number of random cases: `n` times `RTEC_CASES` (default 1).
pub fn cases(n: u64) -> u64 {
    n * asked("RTEC_CASES", 1)
}

/// The number in an environment variable, else `otherwise`.
pub fn asked(variable: &str, otherwise: u64) -> u64 {
    std::env::var(variable).map_or(otherwise, |text| {
        text.parse().unwrap_or_else(|_| panic!("{variable}: found {text:?}, expected a number"))
    })
}

/// Notes that a test could not run, and why. The test must end after it.
pub fn skipped(why: &str) {
    assert!(std::env::var_os("RTEC_REQUIRE").is_none(), "RTEC_REQUIRE is set, but: {why}");
    left_out(why);
}

/// Whether tests that take long are to run.
/// They are with `RTEC_LONG=1` or `RTEC_REQUIRE=1`; otherwise it is noted.
pub fn long() -> bool {
    let asked = long_asked();
    if !asked {
        left_out("it takes long, RTEC_LONG=1 runs it");
    }
    asked
}

fn long_asked() -> bool {
    ["RTEC_LONG", "RTEC_REQUIRE"].iter().any(|variable| std::env::var_os(variable).is_some())
}

/// Repetitions of a check with other numbers, in a short run the first one.
/// `RTEC_LONG=1` or `RTEC_REQUIRE=1` runs them all; otherwise it is noted.
pub fn repetitions<T>(all: impl IntoIterator<Item = T>) -> std::vec::IntoIter<T> {
    let mut all: Vec<T> = all.into_iter().collect();
    if !long_asked() {
        all.truncate(1);
        let why = "one of its repetitions, RTEC_LONG=1 runs them all";
        assert!(note(why).is_some(), "not noted: {why}");
    }
    all.into_iter()
}

/// A number of random cases, in a short run a sixteenth of it.
/// `RTEC_LONG=1` or `RTEC_REQUIRE=1` runs them all; otherwise it is noted.
pub fn fewer(all: u64) -> u64 {
    if long_asked() {
        return all;
    }
    let why = "a sixteenth of its cases, RTEC_LONG=1 runs them all";
    assert!(note(why).is_some(), "not noted: {why}");
    all.div_ceil(16)
}

fn left_out(why: &str) {
    eprintln!("SKIPPED: {why}");
    assert!(note(why).is_some(), "not noted: {why}");
}

/// Writes the note; `None` where it could not be written.
pub fn note(why: &str) -> Option<()> {
    let test = std::thread::current().name().unwrap_or("main").to_owned();
    let file = notes()?;
    std::fs::create_dir_all(file.parent()?).ok()?;
    let mut file = std::fs::File::options().create(true).append(true).open(file).ok()?;
    // One write, because tests run in parallel.
    file.write_all(format!("{why}\t{test}\n").as_bytes()).ok()
}

/// A file or folder of the measured data, which are not part of the project.
/// Returns `None`, and notes it, where it is missing.
pub fn shared(file: &str) -> Option<PathBuf> {
    let found = data(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"), file);
    match &found {
        Err((why, true)) => skipped(why),
        Err((why, false)) => left_out(why),
        Ok(_) => {}
    }
    found.ok()
}

/// A file of this folder, or why it is missing.
/// The flag tells whether `RTEC_REQUIRE` makes that a failure.
fn data(folder: &Path, file: &str) -> Result<PathBuf, (String, bool)> {
    let path = folder.join(file);
    let why = || (format!("../shared/{file} is not there"), folder.join("data").exists());
    if path.exists() { Ok(path) } else { Err(why()) }
}

/// Compares a text with its golden file; `RTEC_BLESS=1` writes the file.
#[track_caller]
pub fn golden(file: &Path, made: &str) {
    if std::env::var_os("RTEC_BLESS").is_some() {
        let written =
            file.parent().map_or(Ok(()), std::fs::create_dir_all).and_then(|()| std::fs::write(file, made));
        assert!(written.is_ok(), "{}: {written:?}", file.display());
    }
    let there = std::fs::read_to_string(file).unwrap_or_default();
    for (n, (made, there)) in made.lines().zip(there.lines()).enumerate() {
        assert_eq!(made, there, "{}:{}: RTEC_BLESS=1 writes it anew", file.display(), n + 1);
    }
    assert_eq!(made, there, "{}: RTEC_BLESS=1 writes it anew", file.display());
}

/// Whether a program of a Debian package is installed; notes where it is not.
pub fn installed(program: &str, package: &str) -> bool {
    let there = ["/usr/bin", "/usr/sbin"].iter().any(|folder| Path::new(folder).join(program).exists());
    if !there {
        skipped(&format!("no {program} (Debian: {package})"));
    }
    there
}

/// Whether Debian's own Python has a module; notes where it has not.
pub fn python(module: &str, package: &str) -> bool {
    let found = std::process::Command::new(PYTHON).args(["-c", &format!("import {module}")]).output();
    let there = found.is_ok_and(|out| out.status.success());
    if !there {
        skipped(&format!("{PYTHON} has no {module} (Debian: {package})"));
    }
    there
}

/// Debian's own interpreter, to which its modules belong.
pub const PYTHON: &str = "/usr/bin/python3";

/// The notes of this run, from all test programs that one cargo has started.
fn notes() -> Option<PathBuf> {
    let program = std::env::current_exe().ok()?;
    // target/PROFILE/deps/PROGRAM
    Some(program.parent()?.parent()?.join("not-run").join(parent_id().to_string()))
}

/// Returns the notes of this run, sorted by reason, and removes them.
/// A note is a reason and a test. Notes of older runs are removed too.
pub fn take_notes() -> Vec<(String, String)> {
    let Some(file) = notes() else { return Vec::new() };
    let text = std::fs::read_to_string(&file).unwrap_or_default();
    if let Some(folder) = file.parent() {
        // An error means that there are no notes, or nobody uses them: the run is over.
        let _ = std::fs::remove_dir_all(folder);
    }
    let mut noted: Vec<_> =
        text.lines().filter_map(|l| l.split_once('\t')).map(|(w, t)| (w.to_owned(), t.to_owned())).collect();
    noted.sort();
    noted.dedup();
    noted
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn data_is_required_only_where_other_data_is() {
        let here = Path::new(env!("CARGO_MANIFEST_DIR"));
        let missing = |required| Err(("../shared/data/planted is not there".to_owned(), required));
        assert_eq!(data(&here.join("nowhere"), "data/planted"), missing(false));
        let with_data = std::env::temp_dir().join(format!("test-needs-{}", std::process::id()));
        std::fs::create_dir_all(with_data.join("data")).expect("a folder for temporary files");
        let found = data(&with_data, "data/planted");
        std::fs::remove_dir_all(&with_data).expect("its own folder");
        assert_eq!(found, missing(true));
    }
}
