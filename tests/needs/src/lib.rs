//! What a test needs that the project does not bring: other programs, measured data, root.
//!
//! Where it is missing, the test says so and ends. The test harness hides what a passing test prints. So it is noted,
//! and the last test of `cargo test --workspace` names all that was not run.
//!
//! With `RTEC_REQUIRE=1`, as `.ci/run` sets it, no program may be missing. A clone without the folder `../shared/data`
//! passes without measured data, and says so.
//!
//! And what tests of several crates are made of: numbers ([`dice`]), and an axis that moves ([`motion`]).

pub mod dice;
pub mod motion;

use std::io::Write;
use std::os::unix::process::parent_id;
use std::path::{Path, PathBuf};

/// So many random cases, times `RTEC_CASES` (1).
///
/// # Panics
/// It is no number.
#[must_use]
pub fn cases(n: u64) -> u64 {
    n * asked("RTEC_CASES", 1)
}

/// The number that an environment variable gives, else `otherwise`.
///
/// # Panics
/// What it gives is no number.
#[must_use]
pub fn asked(variable: &str, otherwise: u64) -> u64 {
    std::env::var(variable).map_or(otherwise, |text| {
        text.parse().unwrap_or_else(|_| panic!("{variable}: found {text:?}, expected a number"))
    })
}

/// Notes that a test could not run, and why. The test is to end after it.
///
/// # Panics
/// With `RTEC_REQUIRE` set: then nothing may be left out.
pub fn skipped(why: &str) {
    assert!(std::env::var_os("RTEC_REQUIRE").is_none(), "RTEC_REQUIRE is set, but: {why}");
    left_out(why);
}

fn left_out(why: &str) {
    eprintln!("SKIPPED: {why}");
    assert!(note(why).is_some(), "not noted: {why}");
}

/// The note alone; `None` where it could not be written.
#[must_use]
pub fn note(why: &str) -> Option<()> {
    let test = std::thread::current().name().unwrap_or("main").to_owned();
    let file = notes()?;
    std::fs::create_dir_all(file.parent()?).ok()?;
    let mut file = std::fs::File::options().create(true).append(true).open(file).ok()?;
    // One write: tests run in parallel.
    file.write_all(format!("{why}\t{test}\n").as_bytes()).ok()
}

/// A file or folder of the measured data that is no part of the project, or `None`, noted, where it is not there.
///
/// # Panics
/// With `RTEC_REQUIRE` set, where the other data is there: then this one was forgotten.
#[must_use]
pub fn shared(file: &str) -> Option<PathBuf> {
    let found = data(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"), file);
    match &found {
        Err((why, true)) => skipped(why),
        Err((why, false)) => left_out(why),
        Ok(_) => {}
    }
    found.ok()
}

/// A file of this folder; else why not, and whether `RTEC_REQUIRE` makes that a failure.
fn data(folder: &Path, file: &str) -> Result<PathBuf, (String, bool)> {
    let path = folder.join(file);
    let why = || (format!("../shared/{file} is not there"), folder.join("data").exists());
    if path.exists() { Ok(path) } else { Err(why()) }
}

/// Compares what was made with the file that it should be; `RTEC_BLESS=1` writes the file anew.
///
/// # Panics
/// At the first line that differs; the file cannot be written.
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

/// Whether a program of a Debian package is there; where it is not, that is noted.
#[must_use]
pub fn installed(program: &str, package: &str) -> bool {
    let there = ["/usr/bin", "/usr/sbin"].iter().any(|folder| Path::new(folder).join(program).exists());
    if !there {
        skipped(&format!("no {program} (Debian: {package})"));
    }
    there
}

/// Whether Debian's own Python has a module; where it has not, that is noted.
#[must_use]
pub fn python(module: &str, package: &str) -> bool {
    let found = std::process::Command::new(PYTHON).args(["-c", &format!("import {module}")]).output();
    let there = found.is_ok_and(|out| out.status.success());
    if !there {
        skipped(&format!("{PYTHON} has no {module} (Debian: {package})"));
    }
    there
}

/// Debian's own interpreter, which its modules belong to.
pub const PYTHON: &str = "/usr/bin/python3";

/// The notes of this run: of all test programs that one cargo has started.
fn notes() -> Option<PathBuf> {
    let program = std::env::current_exe().ok()?;
    // target/PROFILE/deps/PROGRAM
    Some(program.parent()?.parent()?.join("not-run").join(parent_id().to_string()))
}

/// What was noted in this run, reason and test, sorted by reason; and forgets it, with what older runs have left.
#[must_use]
pub fn take_notes() -> Vec<(String, String)> {
    let Some(file) = notes() else { return Vec::new() };
    let text = std::fs::read_to_string(&file).unwrap_or_default();
    if let Some(folder) = file.parent() {
        // Nothing to forget, or in use by nobody: either way the run is over.
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
