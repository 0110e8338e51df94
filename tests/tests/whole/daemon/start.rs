//! Starts, refusals, and answers without a daemon.

use super::{axis, completed, refused_start, write};
use rtec_tests::daemon::{Bench, CONFIG, Daemon, alone, program, until, user};
use serde_json::Value;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::os::unix::net::UnixListener;
use std::process::{Command, Stdio};

#[test]
fn from_start_to_correction_and_through_every_refusal() {
    let _alone = alone();
    let directory = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(&directory.path().join("s"), None);

    let status = daemon.status();
    for key in ["machine", "mode", "homed", "uptime_s", "rt", "axes"] {
        assert!(status.get(key).is_some(), "no {key} in {status}");
    }
    for key in [
        "name",
        "position_counts",
        "position_mm",
        "requested",
        "completed",
        "inverted",
        "gate",
        "edge_rate_hz",
        "faults",
    ] {
        assert!(axis(&status, 0).get(key).is_some(), "no {key} in {status}");
    }
    assert_eq!((&status["mode"], &status["homed"]), (&"disabled".into(), &false.into()));

    // Not homed, and disabled.
    assert!(daemon.expect(1, &["correct", "x", "10"]).contains("axis x: not homed: move to"));
    assert!(daemon.expect(1, &["enable"]).contains("axes x, y, z: not homed: move to"));
    daemon.expect(0, &["home", "x"]);
    daemon.expect(0, &["home", "z"]);
    assert!(daemon.expect(1, &["shadow"]).contains("rtecctl: axis y: not homed: move to"));
    daemon.expect(0, &["home"]);
    assert!(daemon.expect(1, &["correct", "x", "10"]).contains("corrections are disabled"));
    assert!(daemon.expect(1, &["correct", "x", "0"]).contains("corrections are disabled"));
    assert!(daemon.expect(2, &["correct", "xx", "1"]).contains("expected one of x, y, z; did you mean x?"));
    assert!(daemon.expect(2, &["home", "w"]).contains("expected one of x, y, z"));

    daemon.expect(0, &["enable"]);
    daemon.expect(0, &["correct", "x", "-12"]);
    completed(&daemon, -12);
    // The same total twice changes nothing.
    daemon.expect(0, &["correct", "x", "-12"]);
    assert!(daemon.expect(1, &["correct", "x", "1001"]).contains("beyond max_correction_counts"));
    // Outside the window once it is refused, and back inside it is accepted.
    assert!(daemon.expect(1, &["correct", "x", "500"]).contains("larger than window_counts"));
    daemon.expect(0, &["correct", "x", "-2"]);
    daemon.expect(0, &["correct", "x", "300", "--large"]);
    completed(&daemon, 300);

    // Outside three times: the fault is latched, feed hold is on, and nothing moves.
    for _ in 0..2 {
        daemon.expect(1, &["correct", "x", "900"]);
    }
    assert!(daemon.expect(4, &["correct", "x", "900"]).contains("outside the belief window"));
    let text = daemon.expect(4, &["status"]);
    assert!(text.contains("mode FAULT") && text.contains("rtecctl clear"), "{text}");
    assert!(daemon.expect(4, &["correct", "x", "301"]).contains("a fault is latched"));
    let status = daemon.status();
    assert_eq!((&status["mode"], &status["balanced"]), (&"fault".into(), &true.into()));
    assert_eq!(axis(&status, 0)["faults"][0], "still_not_believed");
    assert_eq!(axis(&status, 0)["completed"], 300);
    daemon.expect(0, &["clear"]);
    // The position was never in doubt, but nothing moves before somebody enables it.
    assert!(daemon.expect(1, &["correct", "x", "310"]).contains("corrections are disabled"));
    daemon.expect(0, &["enable"]);
    daemon.expect(0, &["correct", "x", "310"]);
    completed(&daemon, 310);

    // Shadow mode counts and does not write. The way back shows the jump, and a large one needs consent.
    daemon.expect(0, &["shadow"]);
    daemon.expect(0, &["correct", "x", "320"]);
    daemon.expect(0, &["correct", "x", "330"]);
    completed(&daemon, 330);
    assert_eq!(axis(&daemon.status(), 0)["in_effect"], 310);
    let text = daemon.expect(1, &["enable"]);
    assert!(text.contains("axis x: +20 counts (+20.000 µm), belief window 12 counts"), "{text}");
    assert_eq!(daemon.status()["mode"], "shadow");
    assert!(daemon.expect(0, &["enable", "--accept-jump"]).contains("axis x: +20 counts"));
    until("the jump", || axis(&daemon.status(), 0)["in_effect"] == 330);

    // Hold and probe mode: no corrections, but captures.
    daemon.expect(0, &["hold", "on"]);
    assert_eq!(daemon.status()["mode"], "hold");
    daemon.expect(0, &["hold", "off"]);
    let probed = daemon.user(&["probe", "on", "--captures", "3", "--json"]);
    assert_eq!(probed.status.code(), Some(0), "{}", String::from_utf8_lossy(&probed.stderr));
    let captures: Value = serde_json::from_slice(&probed.stdout).unwrap();
    let captures = captures["captures"].as_array().unwrap();
    assert_eq!(captures.len(), 3);
    for capture in captures {
        assert!(capture["trip"]["uncertainty_counts"].as_f64().unwrap() <= 1.0, "{capture}");
    }
    daemon.expect(0, &["probe", "on", "--captures", "0"]);
    assert!(daemon.expect(1, &["correct", "x", "331"]).contains("probing mode is on"));
    daemon.expect(0, &["probe", "off"]);
    daemon.expect(2, &["probe", "on", "--json"]);

    // The ledger balances, the log has the events, and a clean stop parks.
    let status = daemon.status();
    assert_eq!((&status["mode"], &status["balanced"]), (&"run".into(), &true.into()));
    assert_eq!((&axis(&status, 0)["illegal"], &status["rt"]["events_lost"]), (&0.into(), &0.into()));
    let (code, log) = daemon.end("TERM");
    assert_eq!(code, Some(0), "{log}");
    for line in [
        "mode run",
        "axis x: still_not_believed",
        "signal 15: parking",
        "parked axis x: completed +330 counts",
    ] {
        assert!(log.contains(line), "no {line:?} in {log}");
    }
    assert!(!directory.path().join("s").exists(), "the socket was left behind");
}

#[test]
fn no_daemon_is_exit_3_and_says_what_to_do() {
    let directory = tempfile::tempdir().unwrap();
    let run = user(&directory.path().join("s"), &["status"]);
    assert_eq!(run.status.code(), Some(3));
    assert!(String::from_utf8_lossy(&run.stderr).contains("is it running?"));
    assert!(run.stdout.is_empty());
}

#[test]
fn a_second_daemon_and_a_taken_socket_are_refused_an_old_socket_is_not() {
    let _alone = alone();
    let directory = tempfile::tempdir().unwrap();
    let socket = directory.path().join("s");
    // An old socket that no process listens on.
    drop(UnixListener::bind(&socket).unwrap());
    let daemon = Daemon::start(&socket, None);
    let (code, text) = refused_start(&[("--socket", &socket)]);
    assert_eq!(code, Some(1), "{text}");
    assert!(text.contains(&format!("another rtecd (process {})", daemon.id())), "{text}");
    daemon.expect(0, &["status"]);
    let (code, log) = daemon.end("INT");
    assert_eq!(code, Some(0), "{log}");

    // Another process's socket, and a file that is no socket: neither is touched.
    let listener = UnixListener::bind(&socket).unwrap();
    let (code, text) = refused_start(&[("--socket", &socket)]);
    assert!(code == Some(1) && text.contains("is in use"), "{code:?} {text}");
    drop(listener);
    std::fs::remove_file(&socket).unwrap();
    std::fs::write(&socket, "precious").unwrap();
    let (code, text) = refused_start(&[("--socket", &socket)]);
    assert!(code == Some(1) && text.contains("no socket"), "{code:?} {text}");
    assert_eq!(std::fs::read_to_string(&socket).unwrap(), "precious");
}

#[test]
fn a_wrong_configuration_or_card_is_named_and_nothing_starts() {
    let directory = tempfile::tempdir().unwrap();
    let (at, socket) = (directory.path(), directory.path().join("s"));
    let typo = write(at, "typo.toml", &CONFIG.replace("window_counts", "windw_counts"));
    let (code, text) = refused_start(&[("--config", &typo), ("--socket", &socket)]);
    assert_eq!(code, Some(2));
    assert!(text.contains("typo.toml:14:1: found unknown key windw_counts"), "{text}");
    assert!(text.contains("did you mean window_counts?"), "{text}");

    let config = write(at, "rtec.toml", &CONFIG.replace("CARD", "card"));
    let (code, text) = refused_start(&[("--config", &config), ("--socket", &socket)]);
    assert!(code == Some(3) && text.matches("No such file").count() == 1, "{code:?} {text}");
    write(at, "card", "1234567");
    let (code, text) = refused_start(&[("--config", &config), ("--socket", &socket)]);
    assert!(code == Some(3) && text.contains("found 7 bytes, expected at least 8"), "{code:?} {text}");

    let replay = "[machine]\nname='r'\n[card]\nbackend='replay'\n[[axis]]\nname='x'\ncount_um=1\ntravel_mm=9\n\
                  max_correction_counts=9\nwindow_counts=9\nmin_separation_ns=500\ntrace='back.csv'\n";
    let replay = write(at, "replay.toml", replay);
    write(at, "back.csv", "t_ns,a,b\n0,0,0\n2000,1,0\n1000,1,1\n");
    let (code, text) = refused_start(&[("--config", &replay), ("--socket", &socket)]);
    assert!(code == Some(2) && text.contains("back.csv:4:1"), "{code:?} {text}");

    let group = CONFIG.replace("CARD", "card") + "[control]\ngroup = 'nobody-has-this'\n";
    let group = write(at, "group.toml", &group);
    let (code, text) = refused_start(&[("--config", &group), ("--socket", &socket)]);
    assert!(code == Some(1) && text.contains("there is no group nobody-has-this"), "{code:?} {text}");
}

#[test]
fn two_daemons_cannot_share_a_card() {
    let _alone = alone();
    let bench = Bench::default();
    let _daemon = bench.daemon();
    let config = bench.at("rtec.toml");
    let (code, text) = refused_start(&[("--config", &config), ("--socket", &bench.at("other"))]);
    assert!(code == Some(1) && text.contains("another rtecd holds the card"), "{code:?} {text}");
}

#[test]
fn without_privileges_it_runs_and_says_what_is_missing() {
    let _alone = alone();
    let directory = tempfile::tempdir().unwrap();
    std::fs::set_permissions(directory.path(), std::fs::Permissions::from_mode(0o755)).unwrap();
    let own = directory.path().join("own");
    std::fs::create_dir(&own).unwrap();
    let config = write(
        directory.path(),
        "rtec.toml",
        "[machine]\nname='m'\n[card]\nbackend='mock'\n[[axis]]\nname='x'\ncount_um=1\ntravel_mm=9\n\
         max_correction_counts=9\nwindow_counts=9\nmin_separation_ns=500\n[rt]\ncpu=0\n",
    );
    let socket = own.join("s");
    let [copy, rtecctl] = ["rtecd", "rtecctl"].map(|name| {
        let copy = directory.path().join(name);
        std::fs::copy(program(name), &copy).unwrap();
        copy
    });
    let mut command = Command::new(&copy);
    command.arg("--config").arg(&config).arg("--socket").arg(&socket);
    let root = std::fs::metadata("/proc/self").unwrap().uid() == 0;
    if root {
        std::os::unix::fs::chown(&own, Some(65534), Some(65534)).unwrap();
        std::os::unix::process::CommandExt::uid(&mut command, 65534);
        std::os::unix::process::CommandExt::gid(&mut command, 65534);
    }
    let daemon = Daemon::spawn_for(root.then_some((rtecctl, 65534)), &mut command, &socket);
    let status = daemon.status();
    let missing: Vec<_> =
        status["rt"]["missing"].as_array().unwrap().iter().map(|m| m.as_str().unwrap()).collect();
    assert!(missing.iter().any(|m| m.starts_with("scheduler: wanted SCHED_FIFO")), "{missing:?}");
    assert!(daemon.log().contains("warning: scheduler"), "{}", daemon.log());
    // A mock may be armed all the same.
    assert_eq!(status["rt"]["may_arm"], true);
    daemon.expect(0, &["home"]);
    daemon.expect(0, &["enable"]);
    daemon.expect(0, &["correct", "x", "2"]);
    completed(&daemon, 2);
}

/// An empty answer says why, and what to do next.
/// Programs get the same document as before.
#[test]
fn an_empty_answer_says_that_it_is_one() {
    let _alone = alone();
    let directory = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(&directory.path().join("s"), None);
    let said = |args: &[&str]| {
        let run = daemon.user(args);
        assert_eq!(run.status.code(), Some(0), "{args:?}");
        (String::from_utf8(run.stdout).unwrap(), String::from_utf8(run.stderr).unwrap())
    };
    for (name, empty) in [("faults", "[]\n"), ("axes.x.faults", "[]\n"), ("latched", "{}\n")] {
        assert_eq!(said(&["get", name]), (empty.to_owned(), "none\n".to_owned()));
        assert_eq!(said(&["get", name, "--json"]), (empty.to_owned(), String::new()));
    }
    assert_eq!(said(&["get", "axes.x.requested"]).1, "");
    let unknown = daemon.expect(2, &["get", "part"]);
    assert!(["model", "table", "sensors"].iter().all(|name| unknown.contains(name)), "{unknown}");
    let (text, why) = said(&["explain"]);
    assert!(
        text.starts_with("axis x: +0.000 µm") && why.contains("`rtecctl model load FILE`"),
        "{text}{why}"
    );
    assert_eq!(said(&["explain", "--json"]).1, "");

    // Before homing there are counts, but no ledger.
    let out = directory.path().join("ledger").display().to_string();
    let export = ["ledger", "export", "--out", out.as_str()];
    assert!(said(&export).1.contains("axis x, y, z not homed") && said(&export).1.contains("`rtecctl home`"));
    daemon.expect(0, &["home"]);
    assert_eq!(said(&export).1, "");

    // The record has lines, but none of the next century.
    until("the record", || daemon.expect(0, &["log"]).contains(" home: done"));
    let (text, why) = said(&["log", "--since", "2100-01-01"]);
    assert!(text.is_empty() && why.contains("no line since 2100-01-01 00:00:00.000 "), "{why}");
    assert_eq!(said(&["log", "--since", "2100-01-01", "--json"]).1, "");
    let run = daemon.user(&["log", "--axis", "q"]);
    assert!(run.status.code() == Some(2) && run.stdout.is_empty(), "{run:?}");
    let none = directory.path().join("none.log").display().to_string();
    assert!(
        daemon.expect(2, &["log", "--file", &none]).contains("no record yet, expected one that rtecd writes")
    );
    std::fs::write(&none, "").unwrap();
    assert!(said(&["log", "--file", &none]).1.contains("the record has no line yet"));

    // A model without effects.
    let ideal = directory.path().join("ideal.toml").display().to_string();
    std::fs::write(&ideal, "name = \"ideal\"\n").unwrap();
    daemon.expect(0, &["model", "load", &ideal, "--yes"]);
    assert!(said(&["explain"]).1.contains("the model holds no effect: `rtecctl model fit`"));
}

/// A verb that has nothing to work on says so, and what to do.
#[test]
fn what_is_not_there_is_said_with_the_next_step() {
    let _alone = alone();
    let directory = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(&directory.path().join("s"), None);
    daemon.expect(0, &["home"]);
    let enabled = daemon.user(&["enable"]);
    let said = String::from_utf8(enabled.stderr).unwrap();
    assert!(said.contains("no model is loaded") && said.contains("`rtecctl model load FILE`"), "{said}");
    for (name, next) in [
        ("model", "`rtecctl model load FILE`"),
        ("model.name", "`rtecctl model load FILE`"),
        ("table", "`rtecctl part load`"),
        ("sensors", "`[[sensor]]`"),
    ] {
        let answer = daemon.expect(1, &["get", name]);
        assert!(answer.contains("no ") && answer.contains(next) && !answer.contains("expected"), "{answer}");
    }
    daemon.expect(2, &["get", "modell"]);

    // Only whole insertions: seven counts become six and a rest of one.
    let seven = daemon.user(&["correct", "x", "7"]);
    let said = String::from_utf8(seven.stderr).unwrap();
    assert!(said.contains("+6 of +7 counts will be in effect, +1 is left"), "{said}");
    completed(&daemon, 6);
    let status = daemon.expect(0, &["status"]);
    assert!(status.contains("x +6 of +7 (+1 left, less than one insertion)"), "{status}");
    assert!(daemon.user(&["correct", "x", "8"]).stderr.is_empty());
    completed(&daemon, 8);

    // The list of captures ends with probing, whoever ends it.
    for (captures, code) in [(None, 0), (Some("1000000"), 1)] {
        let mut list = Command::new(program("rtecctl"));
        list.args(["probe", "on", "--socket"]).arg(directory.path().join("s"));
        list.args(captures.map(|n| ["--captures", n]).into_iter().flatten());
        let list = list.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        until("probing", || daemon.status()["mode"] == "probe");
        daemon.expect(0, &["probe", "off"]);
        let list = list.wait_with_output().unwrap();
        let said = String::from_utf8(list.stderr).unwrap();
        assert_eq!(list.status.code(), Some(code), "{said}");
        assert!(said.contains("probing has ended (mode run)"), "{said}");
    }

    // `record` without a source takes the daemon, which it finds as every verb does.
    let record = |socket: &[&str]| {
        let mut record = Command::new(program("rtecctl"));
        record.args([
            "characterise",
            "record",
            "--out",
            "r.run.toml",
            "--duration",
            "0.1",
            "--period",
            "0.05",
        ]);
        record.args(socket).env("RTEC_RUN_DIR", directory.path()).current_dir(directory.path());
        let out = record.output().unwrap();
        (out.status.code(), String::from_utf8(out.stderr).unwrap())
    };
    for socket in [&[][..], &["--socket"]] {
        let (code, said) = record(socket);
        assert!(code == Some(3) && said.contains("control"), "{code:?} {said}");
    }
    drop(daemon);
    let daemon = Daemon::start(&directory.path().join("control.sock"), None);
    daemon.expect(0, &["home"]);
    for socket in [&[][..], &["--socket"]] {
        let (code, said) = record(socket);
        assert_eq!(code, Some(0), "{said}");
    }
}
