//! A user's view of a real `rtecd`: from start to correction, to restart.
//! It also covers bad input, faults and crashes.

mod faults;
mod start;

use rtec_tests::daemon::{Daemon, program, until};
use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Exit code and message of a daemon that does not start.
fn refused_start(args: &[(&str, &Path)]) -> (Option<i32>, String) {
    let mut command = Command::new(program("rtecd"));
    for (flag, value) in args {
        command.arg(flag).arg(value);
    }
    let run = command.output().unwrap();
    (run.status.code(), String::from_utf8(run.stderr).unwrap())
}

fn axis(status: &Value, n: usize) -> &Value {
    &status["axes"][n]
}

fn completed(daemon: &Daemon, counts: i64) {
    until("completed", || {
        let status = daemon.status();
        assert_ne!(status["mode"], "fault", "{status}\n{}", daemon.log());
        axis(&status, 0)["completed"] == counts
    });
}

fn write(directory: &Path, name: &str, text: &str) -> PathBuf {
    let path = directory.join(name);
    std::fs::write(&path, text).unwrap();
    path
}

fn line(stream: &mut BufReader<UnixStream>) -> Value {
    let mut line = String::new();
    stream.read_line(&mut line).unwrap();
    serde_json::from_str(&line).unwrap_or_else(|e| panic!("{e}: {line:?}"))
}
