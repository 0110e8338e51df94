//! Build script of each program that writes documents.
//!
//! It hands the commit to the program as `RTEC_COMMIT`: the one that the variable of that name holds, else the one that is
//! checked out. Only a release has it: the programs of the tests would be built anew after each commit.

use std::path::Path;
use std::process::Command;

fn git(arguments: &[&str]) -> Option<String> {
    let out = Command::new("git").args(arguments).output().ok().filter(|out| out.status.success())?;
    Some(String::from_utf8_lossy(&out.stdout).trim().to_owned())
}

/// The commit of this project's own repository.
/// Sources that were unpacked within another repository have none.
fn checked_out() -> Option<String> {
    let root = Path::new("../..").canonicalize().ok()?;
    if Path::new(&git(&["rev-parse", "--show-toplevel"])?) != root {
        return None;
    }
    // The first changes with the branch, the second with each commit.
    for file in ["HEAD", "logs/HEAD"] {
        let path = git(&["rev-parse", "--git-path", file])?;
        if Path::new(&path).exists() {
            println!("cargo:rerun-if-changed={path}");
        }
    }
    git(&["rev-parse", "--short=10", "HEAD"])
}

pub(crate) fn main() {
    println!("cargo:rerun-if-env-changed=RTEC_COMMIT");
    let release = std::env::var("PROFILE").is_ok_and(|profile| profile == "release");
    let given = std::env::var("RTEC_COMMIT").ok();
    let commit = given.or_else(|| release.then(checked_out).flatten()).unwrap_or_default();
    println!("cargo:rustc-env=RTEC_COMMIT={commit}");
}
