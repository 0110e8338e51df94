//! `rtecctl reconcile --live`: a run from the recorder's own feed, and the verdict, in one command.
#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::io::Write as _;
use std::net::TcpListener;
use std::process::Command;

/// A gauge that reads 5 µm and a little that changes, until nobody listens.
fn gauge() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let Ok(mut stream) = stream else { return };
            for i in 0_u32.. {
                let little = f64::from(i * 7919 % 1000) / 1000.0 - 0.5;
                if writeln!(stream, "gz {}", 5.0 + little).is_err() {
                    break;
                }
                std::thread::sleep(std::time::Duration::from_millis(5));
            }
        }
    });
    address
}

#[test]
fn a_live_run_is_recorded_and_reconciled() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("machine.toml"), "name = \"m\"\n").unwrap();
    let feed = gauge();
    let output = Command::new(env!("CARGO_BIN_EXE_rtecctl"))
        .args(["reconcile", "--live", "run.run.toml", "--model", "machine.toml", "--json"])
        .args(["--feed", &feed, "--columns", "gz=error.z", "--period", "0.02", "--duration", "3"])
        .current_dir(folder.path())
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    assert!(folder.path().join("run.run.toml").exists());
    let verdict: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(verdict["verdict"], "named", "{verdict}");
    assert_eq!(verdict["effects"][0]["name"], "offset.z");
}

#[test]
fn what_a_live_run_needs_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("machine.toml"), "name = \"m\"\n").unwrap();
    for (arguments, expected) in [
        (vec!["--live", "run.run.toml"], "--duration"),
        (vec!["--live", "run.run.toml", "--duration", "1"], "no response"),
    ] {
        let output = Command::new(env!("CARGO_BIN_EXE_rtecctl"))
            .args(["reconcile", "--model", "machine.toml"])
            .args(&arguments)
            .current_dir(folder.path())
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(said.contains(expected), "{said}");
        assert!(!folder.path().join("run.run.toml").exists());
    }
}
