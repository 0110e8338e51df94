//! What a plant must be able to count on: one request, one client, one lost record or one late card stops nothing else.

use rtec_tests::daemon::{Bench, CONFIG, Daemon, alone, program, until};
use rtec_tests::disk::SmallDisk;
use rtec_tests::skipped;
use serde_json::Value;
use std::fmt::Write as _;
use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::os::unix::fs::FileExt;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

struct Line(BufReader<UnixStream>);

impl Line {
    fn to(socket: &Path) -> Self {
        let stream = UnixStream::connect(socket).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        Self(BufReader::new(stream))
    }

    fn say(&mut self, request: &Value) {
        writeln!(self.0.get_mut(), "{request}").unwrap();
    }

    fn hear(&mut self) -> Value {
        let mut line = String::new();
        self.0.read_line(&mut line).unwrap();
        serde_json::from_str(&line).unwrap_or_else(|e| panic!("{e}: {line:?}"))
    }

    fn ask(&mut self, request: &Value) -> Value {
        self.say(request);
        self.hear()
    }
}

fn wants(what: &str) -> Value {
    serde_json::json!({ "do": what })
}

fn loads(file: &Path) -> Value {
    serde_json::json!({"do": "model_load", "file": file})
}

/// A model that takes seconds to be read.
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
    // Either the first one is still at it, or it is so quick that nobody has to wait.
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
    // A stop does not wait for it either.
    let mut again = Line::to(&at("s"));
    again.say(&loads(&at("slow.toml")));
    assert!(other.ask(&wants("status"))["status"].is_object());
    assert_eq!(daemon.end("TERM").0, Some(0));
}

/// A bug once: whoever went away while his file was loaded kept his place for good, and the control thread busy.
#[test]
fn who_goes_away_during_a_load_leaves_nothing_behind() {
    let _alone = alone();
    let directory = tempfile::tempdir().unwrap();
    let at = |name: &str| directory.path().join(name);
    let _daemon = Daemon::start(&at("s"), None);
    slow_model(&at("slow.toml"));
    let mut view = Line::to(&at("s-view"));
    // Again where it was loaded before anybody could look.
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
    // Nothing more to say is not gone: the answer is waited for.
    let mut answer = Value::Null;
    until("it is loaded", || {
        let mut loader = Line::to(&at("s"));
        loader.say(&loads(&at("slow.toml")));
        loader.0.get_ref().shutdown(std::net::Shutdown::Write).unwrap();
        answer = loader.hear();
        answer["refused"]["why"] != "loading"
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
    // More that say nothing at all.
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
    let _alone = alone();
    let directory = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(&directory.path().join("s"), None);
    // As it starts it stands, at its home.
    daemon.expect(0, &["home"]);
    daemon.expect(0, &["enable"]);
    let rate = |status: &Value| status["axes"][0]["edge_rate_hz"].as_f64().unwrap();
    until("the axis moves", || rate(&daemon.status()) > 10_000.0);
    let text = daemon.expect(1, &["home", "x"]);
    assert!(text.contains("axis x moves at") && text.contains("standstill"), "{text}");
    assert_eq!(daemon.status()["homed"], true);
    // Feed hold stops it at the end of its cycle, and then it may be.
    daemon.expect(0, &["hold", "on"]);
    until("it stands", || daemon.user(&["home", "x"]).status.code() == Some(0));
}

#[test]
fn a_lost_record_is_no_first_start() {
    let _alone = alone();
    let bench = Bench::default();
    let daemon = bench.daemon();
    bench.go();
    bench.correct(4);
    assert_eq!(daemon.end("KILL").0, None);
    bench.balances_with(4);
    let state = std::fs::File::options().read(true).write(true).open(bench.at("state")).unwrap();
    let zero = |at: u64| state.write_all_at(&[0; 64], at).unwrap();
    // Sixty-four bytes, wherever they are: the other copy has them.
    zero(64);
    let daemon = bench.daemon();
    assert_eq!((&bench.x()["in_effect"], &bench.x()["faults"]), (&4.into(), &serde_json::json!([])));
    assert_eq!(daemon.end("KILL").0, None);
    // In both copies: what is in effect is not known, and that is a fault.
    zero(64);
    zero(64 + 4096);
    let daemon = bench.daemon();
    let status = daemon.status();
    assert_eq!((&status["mode"], &status["axes"][0]["faults"][0]), (&"fault".into(), &"record_lost".into()));
    assert!(daemon.expect(4, &["status"]).contains("has lost what this axis had in effect"));
    assert_eq!(bench.machine.illegal(), 0);
}

/// The PC and the MTC lost their power, and the file is on a disk: what the MTC counts is not known, and hold is kept.
#[test]
fn a_state_file_of_another_boot_is_not_trusted_with_the_count() {
    let _alone = alone();
    let bench = Bench::default();
    let daemon = bench.daemon();
    bench.go();
    bench.correct(4);
    daemon.expect(0, &["hold", "on"]);
    let by = daemon.status()["hold"]["by"].clone();
    assert_eq!(daemon.end("KILL").0, None);
    let file = std::fs::File::options().read(true).write(true).open(bench.at("state")).unwrap();
    let mut boot = [0; 16];
    for page in [0, 4096] {
        file.read_exact_at(&mut boot, page + 40).unwrap();
        assert_ne!(boot, [0; 16]);
        file.write_all_at(&boot.map(|b| !b), page + 40).unwrap();
    }
    let daemon = bench.daemon();
    let status = daemon.status();
    assert_eq!((&status["axes"][0]["mtc_known"], &status["mode"]), (&false.into(), &"hold".into()));
    assert_eq!((&status["hold"]["by"], &status["balanced"]), (&by, &false.into()));
    let shown = daemon.expect(0, &["status"]);
    assert!(shown.contains("the computer was restarted: ") && shown.contains("not known"), "{shown}");
    daemon.expect(1, &["home", "x", "--controller-not-homed"]);
    assert_eq!(daemon.end("KILL").0, None);
    // It stays so until the MTC has been homed.
    let daemon = bench.daemon();
    assert_eq!(daemon.status()["axes"][0]["mtc_known"], false);
}

/// Where the newest record is gone in both copies, nobody knows what it held.
#[test]
fn a_newest_record_that_is_damaged_in_both_copies_latches() {
    let _alone = alone();
    for (row, who) in [(0, serde_json::json!("x")), (6, serde_json::Value::Null)] {
        for slot in 0..2 {
            let bench = Bench::default();
            let daemon = bench.daemon();
            bench.go();
            bench.correct(4);
            daemon.expect(0, &["hold", "on"]);
            assert_eq!(daemon.end("KILL").0, None);
            let file = std::fs::File::options().write(true).open(bench.at("state")).unwrap();
            for page in [0, 4096] {
                file.write_all_at(&[0x5A; 32], page + 64 * (row + 1) + 32 * slot).unwrap();
            }
            let daemon = bench.daemon();
            let status = daemon.status();
            assert_eq!(status["mode"], "fault", "row {row}, slot {slot}");
            let latched = status["latched_faults"].as_array().unwrap();
            assert!(
                latched.iter().any(|l| l["fault"] == "record_lost"
                    && l.get("axis").unwrap_or(&serde_json::Value::Null) == &who),
                "{latched:?}"
            );
            assert!(row != 0 || status["axes"][0]["mtc_known"] == false);
            daemon.expect(0, &["clear"]);
            assert_eq!(daemon.status()["mode"], "hold", "it is held all the same");
            daemon.expect(0, &["hold", "off"]);
            assert_eq!(daemon.end("KILL").0, None);
            let daemon = bench.daemon();
            assert_eq!(daemon.status()["mode"], "disabled", "it is told once");
        }
    }
}

/// Removed, replaced, cut short or overwritten while the daemon writes it: told, held, and nothing is lost with the process.
#[test]
fn a_state_file_that_is_lost_while_it_is_written_is_written_anew() {
    let _alone = alone();
    let bench = Bench::default();
    let state = bench.at("state");
    let mut daemon = bench.daemon();
    bench.go();
    bench.correct(4);
    let older = std::fs::read(&state).unwrap();
    daemon.expect(0, &["hold", "on"]);
    let deeds: [(&str, &dyn Fn()); 4] = [
        ("removed", &|| std::fs::remove_file(&state).unwrap()),
        ("replaced", &|| {
            std::fs::write(bench.at("older"), &older).unwrap();
            std::fs::rename(bench.at("older"), &state).unwrap();
        }),
        ("cut short", &|| std::fs::File::create(&state).unwrap().set_len(0).unwrap()),
        ("overwritten", &|| std::fs::write(&state, &older).unwrap()),
    ];
    for (what, deed) in deeds {
        deed();
        // A store to the file that is not there any more.
        daemon.expect(0, &["hold", "off"]);
        daemon.expect(0, &["hold", "on"]);
        until("it is found", || daemon.status()["mode"] == "fault");
        let shown = daemon.expect(4, &["status"]);
        assert!(shown.contains("state_file_lost: the state file was removed"), "{shown}");
        until("it is written anew", || daemon.log().contains(&format!("it was {what}")) && state.exists());
        assert!(daemon.log().contains("it is written anew"), "{}", daemon.log());
        assert_eq!(daemon.end("KILL").0, None);
        daemon = bench.daemon();
        let status = daemon.status();
        assert_eq!(
            (&status["mode"], &status["faults"][0]),
            (&"fault".into(), &"state_file_lost".into()),
            "{what}"
        );
        let axis = &status["axes"][0];
        assert_eq!((&axis["in_effect"], &axis["mtc_known"]), (&4.into(), &true.into()), "{what}");
        daemon.expect(0, &["clear"]);
        assert_eq!(daemon.status()["mode"], "hold", "{what}");
        assert!(daemon.status()["hold"]["by"].as_str().is_some_and(|by| by.starts_with("user ")), "{what}");
    }
    // An orderly end looks once more.
    std::fs::remove_file(&state).unwrap();
    assert_eq!(daemon.end("TERM").0, Some(0));
    let daemon = bench.daemon();
    assert_eq!(daemon.status()["faults"][0], "state_file_lost");
    daemon.expect(0, &["clear"]);
    // Where it cannot be written anew that is told too, and the fault is latched again as long as it is so.
    std::fs::remove_file(&state).unwrap();
    std::fs::create_dir_all(state.join("in")).unwrap();
    until("it is told", || daemon.log().contains("and cannot be written anew"));
    daemon.expect(0, &["clear"]);
    until("it is latched again", || daemon.status()["mode"] == "fault");
    std::fs::remove_dir_all(&state).unwrap();
    until("it is there again", || state.is_file());
    assert_eq!(bench.machine.illegal(), 0);
}

#[test]
fn a_state_file_is_one_daemons_and_one_machines() {
    let _alone = alone();
    let bench = Bench::with("[control]\nstate_file = 'shared'\n");
    std::fs::write(bench.at("card2"), [0; 4096]).unwrap();
    let other = |name: &str, config: String| {
        std::fs::write(bench.at(name), config).unwrap();
        let mut command = Command::new(program("rtecd"));
        let run =
            command.arg("--config").arg(bench.at(name)).arg("--socket").arg(bench.at("s2")).output().unwrap();
        (run.status.code(), String::from_utf8_lossy(&run.stderr).into_owned())
    };
    let control = "[control]\nstate_file = 'shared'\n";
    let second = CONFIG.replace("CARD", "card2");
    let daemon = bench.daemon();
    let (code, text) = other("second.toml", format!("{second}{control}"));
    assert!(code == Some(1) && text.contains("another rtecd works with it"), "{code:?} {text}");
    assert_eq!(daemon.end("TERM").0, Some(0));
    let (code, text) = other("second.toml", format!("{second}{control}"));
    assert!(
        code == Some(4) && text.contains("it belongs to machine \"bench\" on card mapped"),
        "{code:?} {text}"
    );
    assert!(text.contains("card2") && text.contains("state file of its own"), "{text}");
    let renamed = CONFIG.replace("CARD", "card").replace("'bench'", "'mill'");
    let (code, text) = other("renamed.toml", format!("{renamed}{control}"));
    assert!(code == Some(4) && text.contains("this is machine \"mill\""), "{code:?} {text}");
    // Its own finds it as it was.
    let daemon = bench.daemon();
    assert_eq!(daemon.status()["mode"], "disabled");
}

#[test]
fn a_card_that_comes_late_is_waited_for() {
    let _alone = alone();
    let bench = Bench::default();
    std::fs::rename(bench.at("card"), bench.at("later")).unwrap();
    let mut command = bench.command();
    command.args(["--wait-for-card", "60"]).stderr(std::process::Stdio::piped());
    let mut child = command.spawn().unwrap();
    let mut said = String::new();
    let mut log = BufReader::new(child.stderr.take().unwrap());
    log.read_line(&mut said).unwrap();
    while !said.contains("waiting for the card") {
        assert!(log.read_line(&mut said).unwrap() > 0, "{said}");
    }
    assert!(said.contains("No such file"), "{said}");
    std::fs::rename(bench.at("later"), bench.at("card")).unwrap();
    until("it serves", || bench.user(&["status"]).0 == Some(0));
    // A stop while it waits is a stop.
    let stop =
        |child: &std::process::Child| Command::new("kill").arg(child.id().to_string()).status().unwrap();
    stop(&child);
    assert_eq!(child.wait().unwrap().code(), Some(0));
    std::fs::rename(bench.at("card"), bench.at("later")).unwrap();
    let mut child = command.spawn().unwrap();
    said.clear();
    let mut log = BufReader::new(child.stderr.take().unwrap());
    while !said.contains("waiting for the card") {
        assert!(log.read_line(&mut said).unwrap() > 0, "{said}");
    }
    stop(&child);
    assert_eq!(child.wait().unwrap().code(), Some(0));
    // In vain: as without waiting.
    let run = bench.command().args(["--wait-for-card", "1"]).output().unwrap();
    let text = String::from_utf8_lossy(&run.stderr);
    assert!(run.status.code() == Some(3) && text.contains("No such file"), "{:?} {text}", run.status);
}

#[test]
fn a_full_disk_under_the_record_stops_no_correction_and_is_told() {
    let _alone = alone();
    let directory = tempfile::tempdir().unwrap();
    let at = |name: &str| directory.path().join(name);
    let Some(disk) = SmallDisk::mount(&at("disk"), 32) else {
        return skipped("no file system can be mounted here");
    };
    let config = "[machine]\nname='m'\n[card]\nbackend='mock'\n[[axis]]\nname='x'\ncount_um=1\ntravel_mm=40\n\
                  max_correction_counts=100\nwindow_counts=50\nmin_separation_ns=500\n[control]\nlog_file='disk/audit.log'\n";
    std::fs::write(at("rtec.toml"), config).unwrap();
    let daemon = Daemon::start(&at("s"), Some(&at("rtec.toml")));
    daemon.expect(0, &["home"]);
    daemon.expect(0, &["enable"]);
    let mut line = Line::to(&at("s"));
    let mut log = || line.ask(&wants("observe"))["observed"]["log"].clone();
    until("the record has begun", || log()["last_n"].as_u64() >= Some(3));
    disk.fill();
    let mut n = 0;
    until("the record is in trouble", || {
        n += 2;
        daemon.expect(0, &["correct", "x", &(n % 40).to_string()]);
        log()["trouble"].is_string()
    });
    until("corrected", || daemon.status()["axes"][0]["completed"] == n % 40);
    disk.free();
    until("the record goes on", || log()["trouble"].is_null() && log()["lost"] == 0);
    assert!(daemon.expect(0, &["log"]).contains("lost, "));
    assert!(daemon.expect(0, &["log", "--verify"]).contains("lines, number 1 to"));
}

/// A bug once: a model that was unloaded while the disk was full came back with the next start.
#[test]
fn what_a_full_disk_does_not_remember_is_said_and_never_comes_back() {
    let _alone = alone();
    let directory = tempfile::tempdir().unwrap();
    let at = |name: &str| directory.path().join(name);
    let Some(disk) = SmallDisk::mount(&at("disk"), 32) else {
        return skipped("no file system can be mounted here");
    };
    let config = "[machine]\nname='m'\n[card]\nbackend='mock'\n[[axis]]\nname='x'\ncount_um=1\ntravel_mm=40\n\
                  max_correction_counts=100\nwindow_counts=50\nmin_separation_ns=500\n[control]\nstate_file='disk/state'\n\
                  [model]\nfile='m.toml'\n";
    std::fs::write(at("rtec.toml"), config).unwrap();
    std::fs::write(at("m.toml"), "name = 'm'\n").unwrap();
    let start = || Daemon::start(&at("s"), Some(&at("rtec.toml")));
    let daemon = start();
    disk.fill();
    let said = daemon.expect(0, &["model", "load", "--yes"]);
    assert!(
        said.contains("loaded\n") && said.contains("a restart will not know which model was loaded"),
        "{said}"
    );
    disk.free();
    assert!(!daemon.expect(0, &["model", "load", "--yes"]).contains("warning"));
    disk.fill();
    assert!(!daemon.expect(0, &["model", "unload"]).contains("warning"));
    drop(daemon);
    disk.free();
    assert!(start().status()["model"].is_null());
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
    // By this socket nothing else.
    assert_eq!(line.ask(&wants("disable"))["refused"]["why"], "role");
}

#[test]
fn who_was_late_is_seen_on_the_mock_too() {
    let _alone = alone();
    let directory = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(&directory.path().join("s"), None);
    // Longer than the silence that is worth a line.
    let (begun, stopped_s) = (Instant::now(), 3.1);
    daemon.pause(|| begun.elapsed().as_secs_f64() > stopped_s + 0.2);
    let max_s = || daemon.status()["rt"]["poll_gap_ns"]["max"].as_f64().unwrap() * 1e-9;
    assert!(max_s() >= stopped_s, "{} s, and it was stopped for {stopped_s} s", max_s());
    until("it says so", || daemon.log().contains("the daemon did not run for "));
    until("the record", || daemon.expect(0, &["log"]).contains("stood still: the daemon did not run for "));
}

#[test]
fn a_record_that_cannot_be_written_is_told_everywhere() {
    let _alone = alone();
    let directory = tempfile::tempdir().unwrap();
    let at = |name: &str| directory.path().join(name);
    let config = "[machine]\nname='m'\n[card]\nbackend='mock'\n[[axis]]\nname='x'\ncount_um=1\ntravel_mm=40\n\
                  max_correction_counts=100\nwindow_counts=50\nmin_separation_ns=500\n[control]\nlog_file='later/audit.log'\n";
    std::fs::write(at("rtec.toml"), config).unwrap();
    let daemon = Daemon::start(&at("s"), Some(&at("rtec.toml")));
    until("it says so", || daemon.log().contains("is not written: No such file or directory"));
    daemon.expect(0, &["home"]);
    let said = daemon.expect(0, &["status"]);
    assert!(
        said.contains("record of commands not written: ") && said.contains("corrections go on"),
        "{said}"
    );
    assert!(daemon.expect(0, &["metrics"]).contains("\nrtec_record_trouble 1\n"));
    let check =
        Command::new(program("rtecctl")).args(["config", "check"]).arg(at("rtec.toml")).output().unwrap();
    assert_eq!(check.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&check.stderr).contains("expected a folder that is there"), "{check:?}");
    std::fs::create_dir(at("later")).unwrap();
    until("it says so", || daemon.log().contains("is written again"));
    assert!(!daemon.expect(0, &["status"]).contains("record of commands"));
    // The record is whole as far as it goes, and says how far that is.
    let said = daemon.expect(0, &["log", "--verify"]);
    assert!(said.contains("commands were not recorded"), "{said}");
    // Nobody else writes it.
    let second = Daemon::start(&at("s2"), Some(&at("rtec.toml")));
    until("it says so", || second.log().contains("another process writes it"));
    daemon.expect(0, &["disable"]);
    assert_eq!(daemon.user(&["log", "--verify"]).status.code(), Some(0));
}

/// The settings of the whole machine are put back when the service has ended.
#[test]
fn the_machine_gets_its_throttling_back() {
    let directory = tempfile::tempdir().unwrap();
    let root = directory.path();
    let put = |path: &str, text: &str| {
        let file = root.join(path);
        std::fs::create_dir_all(file.parent().unwrap()).unwrap();
        std::fs::write(file, text).unwrap();
    };
    let get = |path: &str| std::fs::read_to_string(root.join(path)).unwrap().trim().to_owned();
    let [throttling, fair, governor] = [
        "proc/sys/kernel/sched_rt_runtime_us",
        "sys/kernel/debug/sched/fair_server/cpu0/runtime",
        "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor",
    ];
    put(throttling, "950000\n");
    put(fair, "50000000\n");
    put(governor, "schedutil\n");
    put("run/nothing", "");
    let script = rtec_tests::root().join("udev/realtime");
    let run = |what: &str| {
        let done = Command::new("sh").arg(&script).arg(what).env("RTEC_ROOT", root).output().unwrap();
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    };
    // Twice: a restart without a stop between, as after a crash.
    for _ in 0..2 {
        run("set");
        assert_eq!([get(throttling), get(fair), get(governor)], ["-1", "0", "performance"]);
    }
    run("restore");
    assert_eq!([get(throttling), get(fair), get(governor)], ["950000", "50000000", "schedutil"]);
    run("restore");
    assert_eq!(get(throttling), "950000");
}
