//! What a user sees of a real `rtecd`: the way from start to correction, every bad input and fault, crash and restart.

use rtec_tests::daemon::{Bench, CONFIG, Daemon, alone, program, until, user};
use serde_json::Value;
use std::fmt::Write as _;
use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

/// The daemon's exit code and what it said, where it is not to start.
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

    // Before homing, while disabled.
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
    daemon.expect(0, &["correct", "x", "-40"]);
    completed(&daemon, -40);
    // Twice the same total does no harm.
    daemon.expect(0, &["correct", "x", "-40"]);
    assert!(daemon.expect(1, &["correct", "x", "1001"]).contains("beyond max_correction_counts"));
    // Once outside the window: not believed; back inside: all is well.
    assert!(daemon.expect(1, &["correct", "x", "500"]).contains("larger than window_counts"));
    daemon.expect(0, &["correct", "x", "-30"]);
    daemon.expect(0, &["correct", "x", "300", "--large"]);
    completed(&daemon, 300);

    // Three times outside: the fault is latched, the machine held, and nothing moves.
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
    // The position was never in doubt, but nothing moves before somebody wants it.
    assert!(daemon.expect(1, &["correct", "x", "310"]).contains("corrections are disabled"));
    daemon.expect(0, &["enable"]);
    daemon.expect(0, &["correct", "x", "310"]);
    completed(&daemon, 310);

    // Shadow: counted, not written; the way back shows the jump, and a large one must be meant.
    daemon.expect(0, &["shadow"]);
    daemon.expect(0, &["correct", "x", "350"]);
    daemon.expect(0, &["correct", "x", "380"]);
    completed(&daemon, 380);
    assert_eq!(axis(&daemon.status(), 0)["in_effect"], 310);
    let text = daemon.expect(1, &["enable"]);
    assert!(text.contains("axis x: +70 counts (+70.000 µm), belief window 50 counts"), "{text}");
    assert_eq!(daemon.status()["mode"], "shadow");
    assert!(daemon.expect(0, &["enable", "--accept-jump"]).contains("axis x: +70 counts"));
    until("the jump", || axis(&daemon.status(), 0)["in_effect"] == 380);

    // Hold and probe: no corrections, captures.
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
    assert!(daemon.expect(1, &["correct", "x", "381"]).contains("probing mode is on"));
    daemon.expect(0, &["probe", "off"]);
    daemon.expect(2, &["probe", "on", "--json"]);

    // The ledger balances, the log tells the story, and the clean stop parks.
    let status = daemon.status();
    assert_eq!((&status["mode"], &status["balanced"]), (&"run".into(), &true.into()));
    assert_eq!((&axis(&status, 0)["illegal"], &status["rt"]["events_lost"]), (&0.into(), &0.into()));
    let (code, log) = daemon.end("TERM");
    assert_eq!(code, Some(0), "{log}");
    for line in [
        "mode run",
        "axis x: still_not_believed",
        "signal 15: parking",
        "parked axis x: completed +380 counts",
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
    // An old socket that nobody listens at.
    drop(UnixListener::bind(&socket).unwrap());
    let daemon = Daemon::start(&socket, None);
    let (code, text) = refused_start(&[("--socket", &socket)]);
    assert_eq!(code, Some(1), "{text}");
    assert!(text.contains(&format!("another rtecd (process {})", daemon.id())), "{text}");
    daemon.expect(0, &["status"]);
    let (code, log) = daemon.end("INT");
    assert_eq!(code, Some(0), "{log}");

    // Somebody else's socket, and something that is no socket: neither is touched.
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

fn write(directory: &Path, name: &str, text: &str) -> PathBuf {
    let path = directory.join(name);
    std::fs::write(&path, text).unwrap();
    path
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
fn a_recording_is_played_in_real_time_and_then_stands_still() {
    let _alone = alone();
    let directory = tempfile::tempdir().unwrap();
    let mut trace = String::from("t_ns,a,b\n");
    for n in 0..=2000_u64 {
        let state = ["0,0", "1,0", "1,1", "0,1"][n as usize % 4];
        writeln!(trace, "{},{state}", 5_000_000 + n * 100_000).unwrap();
    }
    write(directory.path(), "x.csv", &trace);
    let config = write(
        directory.path(),
        "rtec.toml",
        "[machine]\nname='r'\n[card]\nbackend='replay'\n[[axis]]\nname='x'\ncount_um=0.5\ntravel_mm=9\n\
         max_correction_counts=9\nwindow_counts=9\nmin_separation_ns=500\ntrace='x.csv'\n",
    );
    let daemon = Daemon::start(&directory.path().join("s"), Some(&config));
    until("the end of the recording", || axis(&daemon.status(), 0)["position_counts"] == 2000);
    let status = daemon.status();
    assert_eq!((&status["rt"]["card"], &axis(&status, 0)["position_mm"]), (&"replay".into(), &1.0.into()));
    assert_eq!((&status["balanced"], &axis(&status, 0)["illegal"]), (&true.into(), &0.into()));
}

#[test]
fn the_socket_is_for_its_group_only() {
    let _alone = alone();
    let directory = tempfile::tempdir().unwrap();
    let socket = directory.path().join("run/s");
    let daemon = Daemon::start(&socket, None);
    assert_eq!(std::fs::metadata(&socket).unwrap().permissions().mode() & 0o777, 0o600);
    assert_eq!(std::fs::metadata(directory.path().join("run")).unwrap().permissions().mode() & 0o777, 0o700);
    drop(daemon);
    // A group that this user may give files to: its own.
    let own = Command::new("id").arg("-gn").output().unwrap();
    let own = String::from_utf8(own.stdout).unwrap();
    let config = format!("{}[control]\ngroup = '{}'\n", CONFIG.replace("CARD", "card"), own.trim());
    let config = write(directory.path(), "rtec.toml", &config);
    std::fs::write(directory.path().join("card"), [0; 64]).unwrap();
    let _daemon = Daemon::start(&socket, Some(&config));
    let found = std::fs::metadata(&socket).unwrap();
    assert_eq!(found.permissions().mode() & 0o777, 0o660);
    assert_eq!(found.gid(), std::fs::metadata(directory.path()).unwrap().gid());
}

fn line(stream: &mut BufReader<UnixStream>) -> Value {
    let mut line = String::new();
    stream.read_line(&mut line).unwrap();
    serde_json::from_str(&line).unwrap_or_else(|e| panic!("{e}: {line:?}"))
}

fn connect(socket: &Path) -> BufReader<UnixStream> {
    let stream = UnixStream::connect(socket).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
    BufReader::new(stream)
}

#[test]
fn nonsense_and_floods_hurt_nobody_else() {
    let _alone = alone();
    let directory = tempfile::tempdir().unwrap();
    let socket = directory.path().join("s");
    let daemon = Daemon::enabled(&socket);

    // Wrong requests get an answer each, on the same connection.
    let mut client = connect(&socket);
    for (request, wants) in [
        (&b"{\"do\":\"dance\"}\n"[..], "unknown variant"),
        (b"\n", "EOF"),
        (b"\xff\xfe\n", "no UTF-8"),
        (b"{\"do\":\"correct\",\"axis\":\"x\",\"counts\":1}\n", "unknown field `counts`"),
        (b"[1,2]\n", "expected"),
    ] {
        client.get_mut().write_all(request).unwrap();
        let answer = line(&mut client);
        assert!(answer["bad"]["text"].as_str().is_some_and(|t| t.contains(wants)), "{answer}");
    }
    client.get_mut().write_all(b"{\"do\":\"status\"}\n{\"do\":\"hold\",\"on\":false}\n").unwrap();
    assert_eq!(line(&mut client)["status"]["mode"], "run");
    assert_eq!(line(&mut client)["done"], serde_json::json!({}));

    // A line without an end: refused, and disconnected.
    client.get_mut().write_all(&[b'x'; 5000]).unwrap();
    assert!(line(&mut client)["bad"]["text"].as_str().is_some_and(|t| t.contains("4096 bytes")));
    assert_eq!(client.read(&mut [0; 16]).unwrap_or(0), 0);

    // Thirty-two that say nothing; the next one is refused what is not urgent.
    let idle: Vec<_> = (0..32).map(|_| connect(&socket)).collect();
    let mut late = connect(&socket);
    late.get_mut().write_all(b"{\"do\":\"clear\"}\n").unwrap();
    assert!(line(&mut late)["refused"]["text"].as_str().is_some_and(|t| t.contains("32 clients")));
    drop((idle, late));
    until("their places", || daemon.user(&["correct", "x", "0"]).status.code() == Some(0));

    // One asks without ever reading the answers, one watches without reading: another user still gets his.
    let deaf = UnixStream::connect(&socket).unwrap();
    deaf.set_nonblocking(true).unwrap();
    let flood = "{\"do\":\"status\"}\n".repeat(10_000);
    let sent = (&deaf).write(flood.as_bytes()).unwrap();
    assert!(sent > 4096);
    (UnixStream::connect(&socket).unwrap()).write_all(b"{\"do\":\"watch\"}\n").unwrap();
    for n in 1..=20 {
        daemon.expect(0, &["correct", "x", &(2 * n).to_string()]);
        while (&deaf).write(flood.as_bytes()).is_ok_and(|n| n > 0) {}
    }
    completed(&daemon, 40);
    let status = daemon.status();
    assert_eq!((&status["rt"]["control_stale"], &status["rt"]["events_lost"]), (&false.into(), &0.into()));
    assert!(!daemon.log().contains("control side is silent"), "{}", daemon.log());
}

#[test]
fn a_killed_daemon_leaves_no_jump_and_its_successor_takes_over() {
    let _alone = alone();
    let bench = Bench::default();
    let mut daemon = bench.daemon();
    bench.go();
    let mut total = 0;
    // An odd number of insertions leaves the inverters on, an even one off.
    for (counts, signal) in [(2, "KILL"), (4, "TERM")] {
        daemon.expect(0, &["correct", "x", &counts.to_string()]);
        completed(&daemon, counts);
        total += counts;
        let inverted = axis(&daemon.status(), 0)["inverted"].clone();
        let (_, log) = daemon.end(signal);
        assert!(!log.contains("FAULT") && !log.contains("error"), "{log}");
        bench.machine.move_axis(false);
        until("the controller's count", || bench.machine.offset() == total);
        assert_eq!(bench.outputs() & 3, if inverted == true { 3 } else { 0 });

        daemon = bench.daemon();
        let status = daemon.status();
        let x = axis(&status, 0);
        // Taken over, not believed for more than it is: frozen until it is homed again.
        assert_eq!((&x["completed"], &x["inverted"]), (&counts.into(), &inverted), "{status}");
        assert_eq!((&status["mode"], &x["homed"]), (&"disabled".into(), &false.into()));
        assert!(daemon.expect(1, &["enable"]).contains("not homed"));
        bench.go();
    }
    drop(daemon);
    assert_eq!(bench.machine.illegal(), 0);
}

#[test]
fn inverters_that_moved_while_nobody_looked_are_a_fault() {
    let _alone = alone();
    let bench = Bench::default();
    let daemon = bench.daemon();
    daemon.expect(0, &["home", "--controller-homed"]);
    assert_eq!(daemon.end("TERM").0, Some(0));
    let card = std::fs::File::options().write(true).open(bench.at("card")).unwrap();
    std::os::unix::fs::FileExt::write_at(&card, &[3], 4).unwrap();
    let daemon = bench.daemon();
    let status = daemon.status();
    assert_eq!(axis(&status, 0)["faults"][0], "inverters_moved", "{status}");
    assert!(daemon.expect(4, &["enable"]).contains("a fault is latched"));
    assert!(daemon.log().contains("not where the state file left them"));
    // One of the two only: nothing starts, nothing is written.
    assert_eq!(daemon.end("TERM").0, Some(0));
    std::os::unix::fs::FileExt::write_at(&card, &[1], 4).unwrap();
    let config = bench.at("rtec.toml");
    let (code, text) = refused_start(&[("--config", &config), ("--socket", &bench.at("s"))]);
    assert!(code == Some(4) && text.contains("two inverters are not equal"), "{code:?} {text}");
    until("the outputs", || bench.outputs() & 3 == 1);
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
fn an_illegal_transition_holds_the_machine_until_cleared_and_homed() {
    let _alone = alone();
    let bench = Bench::default();
    let daemon = bench.daemon();
    bench.go();
    daemon.expect(0, &["correct", "x", "2"]);
    completed(&daemon, 2);
    bench.machine.move_axis(false);
    bench.machine.glitch();
    until("the fault", || daemon.status()["mode"] == "fault");
    until("feed hold", || bench.outputs() >> 28 & 1 == 1);
    assert!(daemon.expect(4, &["status"]).contains("illegal_transition"));
    assert!(daemon.expect(4, &["correct", "x", "4"]).contains("a fault is latched"));
    daemon.expect(0, &["clear"]);
    until("feed hold off", || bench.outputs() >> 28 & 1 == 0);
    let said = daemon.expect(1, &["correct", "x", "4"]);
    assert!(said.contains("the controller's count is not known"), "{said}");
    let status = daemon.status();
    assert_eq!((&axis(&status, 0)["illegal"], &axis(&status, 0)["completed"]), (&1.into(), &2.into()));
    daemon.expect(0, &["home", "--controller-homed"]);
    assert_eq!(axis(&daemon.status(), 0)["completed"], 0);
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
    // It is a mock: it may be armed all the same.
    assert_eq!(status["rt"]["may_arm"], true);
    daemon.expect(0, &["home"]);
    daemon.expect(0, &["enable"]);
    daemon.expect(0, &["correct", "x", "2"]);
    completed(&daemon, 2);
}

/// An answer without a line says why, and what comes next; programs get what they got before.
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

    // Before homing there are counts, and no ledger.
    let out = directory.path().join("ledger").display().to_string();
    let export = ["ledger", "export", "--out", out.as_str()];
    assert!(said(&export).1.contains("axis x, y, z not homed") && said(&export).1.contains("`rtecctl home`"));
    daemon.expect(0, &["home"]);
    assert_eq!(said(&export).1, "");

    // The record has lines, and none of the next century.
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

/// Where there is nothing to correct with, to show or to wait for, the answer says so, and what to do.
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

    // Whole insertions only: seven counts are six and one.
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

    // A record without a source of its own is the daemon's, found as every verb finds it.
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
