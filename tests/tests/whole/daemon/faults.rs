//! Floods, kills and faults of a running daemon.

use super::{axis, completed, line, refused_start, write};
use rtec_tests::daemon::{Bench, CONFIG, Daemon, alone, until};
use std::fmt::Write as _;
use std::io::{BufReader, Read, Write};
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

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
    // A group that this user may give files to: the user's own.
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

    // Each wrong request gets an answer, on the same connection.
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

    // A line without an end is refused, and the client is disconnected.
    client.get_mut().write_all(&[b'x'; 5000]).unwrap();
    assert!(line(&mut client)["bad"]["text"].as_str().is_some_and(|t| t.contains("4096 bytes")));
    assert_eq!(client.read(&mut [0; 16]).unwrap_or(0), 0);

    // 32 silent connections: the next one is refused what is not urgent.
    let idle: Vec<_> = (0..32).map(|_| connect(&socket)).collect();
    let mut late = connect(&socket);
    late.get_mut().write_all(b"{\"do\":\"clear\"}\n").unwrap();
    assert!(line(&mut late)["refused"]["text"].as_str().is_some_and(|t| t.contains("32 clients")));
    drop((idle, late));
    until("their places", || daemon.user(&["correct", "x", "0"]).status.code() == Some(0));

    // One client never reads its answers and one watches without reading. Another user is still served.
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
    // An odd number of insertions leaves the inverters on, an even one leaves them off.
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
        // The state is taken over, but corrections are frozen until the axis is homed again.
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
    // One of the two inverters alone is on: the daemon does not start, and writes nothing.
    assert_eq!(daemon.end("TERM").0, Some(0));
    std::os::unix::fs::FileExt::write_at(&card, &[1], 4).unwrap();
    let config = bench.at("rtec.toml");
    let (code, text) = refused_start(&[("--config", &config), ("--socket", &bench.at("s"))]);
    assert!(code == Some(4) && text.contains("two inverters are not equal"), "{code:?} {text}");
    until("the outputs", || bench.outputs() & 3 == 1);
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
