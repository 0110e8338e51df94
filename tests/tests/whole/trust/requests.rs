//! Clients that ask too much, too slowly or at the wrong time.

use super::{Line, wants};
use rtec_tests::daemon::{Daemon, alone, until};
use serde_json::Value;
use std::fmt::Write as _;
use std::io::{BufRead, ErrorKind, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;

fn loads(file: &Path) -> Value {
    serde_json::json!({"do": "model_load", "file": file})
}

/// Writes a model that takes seconds to read.
fn slow_model(file: &Path) {
    let mut text = String::from("name = \"slow\"\n");
    for n in 0..25_000 {
        let period_um = 1.5 + f64::from(n) * 0.005;
        let effect = "[[effect]]\nname=\"subdivision.x\"\num=0.01\nphase_rad=0";
        let _ = writeln!(text, "{effect}\nperiod_um={period_um}");
    }
    std::fs::write(file, text).unwrap();
}

#[test]
fn while_one_file_is_loaded_everybody_else_is_answered() {
    if !test_needs::long() {
        return;
    }
    let _alone = alone();
    let directory = tempfile::tempdir().unwrap();
    let at = |name: &str| directory.path().join(name);
    let daemon = Daemon::start(&at("s"), None);
    nix::unistd::mkfifo(&at("pipe"), nix::sys::stat::Mode::S_IRWXU).unwrap();
    let mut loader = Line::to(&at("s"));
    for special in [at("pipe"), "/dev/zero".into(), "/dev/stdin".into(), at("")] {
        let answer = loader.ask(&loads(&special));
        assert!(answer["bad"]["text"].as_str().is_some_and(|t| t.contains("regular file")), "{answer}");
    }
    slow_model(&at("slow.toml"));
    loader.say(&loads(&at("slow.toml")));
    let mut other = Line::to(&at("s"));
    assert!(other.ask(&wants("status"))["status"].is_object());
    let mut third = Line::to(&at("s"));
    let busy = third.ask(&loads(&at("slow.toml")));
    // Either the first load is still running, or it was so quick that nobody has to wait.
    let mut answered = 0;
    loader.0.get_ref().set_nonblocking(true).unwrap();
    let mut first = String::new();
    while first.is_empty() {
        assert!(other.ask(&wants("status"))["status"].is_object());
        answered += 1;
        match loader.0.read_line(&mut first) {
            Err(e) if e.kind() == ErrorKind::WouldBlock => {}
            done => assert!(done.unwrap() > 0),
        }
    }
    assert_eq!(busy["refused"]["why"], "loading", "{busy}, after {answered} answers: {first:.200}");
    assert!(answered > 3, "{answered} answers while a file was loaded");
    assert!(!daemon.log().contains("control side is silent"), "{}", daemon.log());
    // A stop does not wait for the load either.
    let mut again = Line::to(&at("s"));
    again.say(&loads(&at("slow.toml")));
    assert!(other.ask(&wants("status"))["status"].is_object());
    assert_eq!(daemon.end("TERM").0, Some(0));
}

/// Regression: a client that left during a load kept its place for good.
/// The control thread stayed busy too.
#[test]
fn who_goes_away_during_a_load_leaves_nothing_behind() {
    if !test_needs::long() {
        return;
    }
    let _alone = alone();
    let directory = tempfile::tempdir().unwrap();
    let at = |name: &str| directory.path().join(name);
    let _daemon = Daemon::start(&at("s"), None);
    slow_model(&at("slow.toml"));
    let mut view = Line::to(&at("s-view"));
    // Tries again where the load ended before anybody could look.
    until("it is being loaded", || {
        let mut loader = Line::to(&at("s"));
        loader.say(&loads(&at("slow.toml")));
        Line::to(&at("s")).ask(&loads(&at("slow.toml")))["refused"]["why"] == "loading"
    });
    let mut connected = || {
        let all = view.ask(&serde_json::json!({"do": "observe", "events_after": u64::MAX}));
        all["observed"]["clients"][2]["connected"].as_u64().unwrap()
    };
    until("its place is free", || connected() == 0);
    // A client that closed its writing side is still there, and waits for the answer.
    let mut answer = Value::Null;
    until("it is loaded", || {
        let mut loader = Line::to(&at("s"));
        loader.say(&loads(&at("slow.toml")));
        loader.0.get_ref().shutdown(std::net::Shutdown::Write).unwrap();
        answer = loader.hear();
        // On a busy machine a load may take longer than is allowed, and is asked for again.
        ["loading", "too_long"].iter().all(|why| answer["refused"]["why"] != *why)
    });
    assert!(answer["model_preview"].is_object() || answer["bad"].is_object(), "{answer}");
    until("its place is free", || connected() == 0);
}

#[test]
fn idle_watchers_keep_nobody_from_stopping_the_machine() {
    let _alone = alone();
    let directory = tempfile::tempdir().unwrap();
    let socket = directory.path().join("s");
    let daemon = Daemon::enabled(&socket);
    let watchers: Vec<Line> = (0..32)
        .map(|_| {
            let mut line = Line::to(&socket);
            assert_eq!(line.ask(&wants("watch"))["done"], serde_json::json!({}));
            line
        })
        .collect();
    // More clients, all silent.
    let silent: Vec<UnixStream> = (0..64).map(|_| UnixStream::connect(&socket).unwrap()).collect();
    let text = daemon.expect(1, &["correct", "x", "2"]);
    assert!(text.contains("connected already"), "the refusal reaches the user: {text}");
    daemon.expect(0, &["status"]);
    daemon.expect(0, &["hold", "on"]);
    daemon.expect(0, &["disable"]);
    assert_eq!(daemon.status()["mode"], "hold");
    daemon.expect(0, &["hold", "off"]);
    assert_eq!(daemon.status()["mode"], "disabled");
    drop((watchers, silent));
    until("a place", || daemon.user(&["clear"]).status.code() == Some(0));
}

#[test]
fn thirty_that_ask_without_end_do_not_shut_the_others_out() {
    let _alone = alone();
    let directory = tempfile::tempdir().unwrap();
    let socket = directory.path().join("s");
    let daemon = Daemon::enabled(&socket);
    let flood = "{\"do\":\"correct\",\"axis\":\"x\",\"total_counts\":2}\n".repeat(500);
    let flooders: Vec<UnixStream> = (0..30)
        .map(|_| {
            let stream = UnixStream::connect(&socket).unwrap();
            stream.set_nonblocking(true).unwrap();
            stream
        })
        .collect();
    let pour = || {
        for mut stream in &flooders {
            while stream.write(flood.as_bytes()).is_ok_and(|n| n > 0) {}
            while stream.read(&mut [0; 4096]).is_ok_and(|n| n > 0) {}
        }
    };
    let mut other = Line::to(&socket);
    for _ in 0..20 {
        pour();
        let before = flooders.len();
        assert!(other.ask(&wants("status"))["status"].is_object());
        assert_eq!(before, 30);
    }
    pour();
    assert_eq!(other.ask(&wants("disable"))["done"], serde_json::json!({}));
    assert!(!daemon.log().contains("control side is silent"), "{}", daemon.log());
}

#[test]
fn corrections_are_not_switched_on_behind_probing_or_hold() {
    let _alone = alone();
    let directory = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(&directory.path().join("s"), None);
    daemon.expect(0, &["home"]);
    daemon.expect(0, &["shadow"]);
    for (on, off, wants) in [
        (&["probe", "on", "--captures", "0"][..], &["probe", "off"], "probing mode is on"),
        (&["hold", "on"], &["hold", "off"], "feed hold is on"),
    ] {
        daemon.expect(0, on);
        for verb in ["enable", "shadow"] {
            let text = daemon.expect(1, &[verb]);
            assert!(text.contains(wants) && !text.contains("corrections on"), "{text}");
        }
        daemon.expect(0, off);
        assert_eq!(daemon.status()["mode"], "shadow", "as it was before");
    }
}

#[test]
fn an_axis_that_moves_is_not_homed() {
    if !test_needs::long() {
        return;
    }
    let _alone = alone();
    let directory = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(&directory.path().join("s"), None);
    // At its start it is at rest, at its home.
    daemon.expect(0, &["home"]);
    daemon.expect(0, &["enable"]);
    let rate = |status: &Value| status["axes"][0]["edge_rate_hz"].as_f64().unwrap();
    until("the axis moves", || rate(&daemon.status()) > 10_000.0);
    let text = daemon.expect(1, &["home", "x"]);
    assert!(text.contains("axis x moves at") && text.contains("standstill"), "{text}");
    assert_eq!(daemon.status()["homed"], true);
    // Feed hold stops it at the end of its cycle, and then homing is allowed.
    daemon.expect(0, &["hold", "on"]);
    until("it stands", || daemon.user(&["home", "x"]).status.code() == Some(0));
}

#[test]
fn one_request_sees_everything() {
    let _alone = alone();
    let directory = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(&directory.path().join("s"), None);
    daemon.expect(0, &["home"]);
    let mut line = Line::to(&directory.path().join("s-view"));
    let all = line.ask(&wants("observe"));
    let all = &all["observed"];
    assert_eq!((&all["status"]["homed"], &all["explained"][2]["axis"]), (&true.into(), &"z".into()), "{all}");
    let events = all["events"].as_array().unwrap();
    assert_eq!(events.iter().filter(|e| e["event"]["kind"] == "homed").count(), 3);
    assert_eq!(all["clients"][0], serde_json::json!({"role": "view", "connected": 1, "watching": 0}));
    let samples: u64 =
        all["histograms"]["poll_gap_ns"].as_array().unwrap().iter().map(|b| b[2].as_u64().unwrap()).sum();
    assert!(samples > 1000, "{samples}");
    let last = events.last().unwrap()["n"].as_u64().unwrap();
    let again = line.ask(&serde_json::json!({"do": "observe", "events_after": last}));
    assert_eq!(again["observed"]["events"], serde_json::json!([]));
    assert_eq!(again["observed"]["events_missed"], 0);
    // This socket allows nothing else.
    assert_eq!(line.ask(&wants("disable"))["refused"]["why"], "role");
}
