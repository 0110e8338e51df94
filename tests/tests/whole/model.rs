//! The machine model in a real `rtecd`.
//! It is loaded, explained, kept over a restart, and refused when its file has changed.

use super::top::Terminal;
use rtec_tests::daemon::{Daemon, among_others, until};
use rtec_tests::sensors::Sensors;
use rtec_tests::skipped;
use serde_json::Value;
use std::path::Path;
use std::sync::atomic::Ordering;
use std::time::Duration;

fn set_up(directory: &Path, sensors: &Sensors, model: &str) -> std::path::PathBuf {
    std::fs::write(directory.join("machine.toml"), format!("name = \"bench\"\n{model}")).unwrap();
    let axis = |n: &str| {
        format!(
            "[[axis]]\nname = '{n}'\ncount_um = 1.0\ntravel_mm = 40\nmax_correction_counts = 1000\nwindow_counts = 50\n\
             min_separation_ns = 500\nmax_accel_mm_s2 = 1000\n"
        )
    };
    let text = format!(
        "[machine]\nname = 'bench'\n[card]\nbackend = 'mock'\n{}{}[model]\nfile = 'machine.toml'\nramp_um_s = 200\nlog_s = 0.2\n{}",
        axis("x"),
        axis("z"),
        sensors.config()
    );
    let file = directory.join("rtec.toml");
    std::fs::write(&file, text).unwrap();
    file
}

fn explained(daemon: &Daemon, axis: &str) -> Value {
    let text = daemon.expect(0, &["explain", axis, "--json"]);
    serde_json::from_str::<Value>(&text).unwrap()["axes"][0].clone()
}

/// The present contribution of an effect, µm.
fn part_um(daemon: &Daemon, axis: &str, name: &str) -> Option<f64> {
    let found = explained(daemon, axis);
    let part = found["parts"].as_array().unwrap().iter().find(|p| p["name"] == name)?;
    part["um"].as_f64()
}

const GROWTH: &str =
    "[[effect]]\nname = \"thermal_growth.z\"\nsensor = \"T1\"\nminus = \"T2\"\num_per_K = 10.0\n";

/// Regression: the line of progress took the place of the question.
#[test]
fn the_question_of_a_load_stays_on_the_terminal() {
    if !test_needs::long() {
        return;
    }
    if std::process::Command::new("tmux").arg("-V").output().is_err() {
        return skipped("no tmux (Debian: tmux)");
    }
    let _room = among_others();
    let directory = tempfile::tempdir().unwrap();
    let socket = directory.path().join("s");
    let daemon = Daemon::start(&socket, None);
    let file = directory.path().join("m.toml");
    std::fs::write(&file, "name = \"m\"\n[[effect]]\nname = \"scale.x\"\nppm = 10.0\n").unwrap();
    let words = ["model", "load", file.to_str().unwrap()];
    let terminal = Terminal::of(directory.path(), &words, &socket, (100, 30), "");
    let question = "take it? [y/N]";
    terminal.shows(question);
    // A computation shows its line after two seconds.
    std::thread::sleep(Duration::from_secs(4));
    let screen = terminal.screen();
    assert!(screen.trim_end().ends_with(question) && !screen.contains("model: "), "{screen}");
    terminal.tmux(&["send-keys", "y", "Enter"]);
    terminal.shows("ended with 0");
    assert_eq!(daemon.status()["model"]["file"], file.to_str().unwrap());
}

#[test]
fn a_model_is_shown_taken_explained_held_and_unloaded() {
    if !test_needs::long() {
        return;
    }
    let _room = among_others();
    let directory = tempfile::tempdir().unwrap();
    let sensors = Sensors::start(23.0);
    let scale = "[[effect]]\nname = \"scale.x\"\nppm = 1000.0\n[[effect]]\nname = \"scale.Z\"\nppm = 10.0\n";
    let file = set_up(directory.path(), &sensors, &[GROWTH, scale].concat());
    let daemon = Daemon::start(&directory.path().join("s"), Some(&file));
    daemon.expect(0, &["home"]);
    daemon.expect(0, &["enable"]);
    let text = daemon.expect(0, &["status"]);
    assert!(text.contains("not correcting: the model") && text.contains("has not been loaded yet"), "{text}");
    until("both sensors", || daemon.expect(0, &["status"]).contains("sensors: 2 of 2 good"));

    // Shown, and not loaded without consent. A file that is no model is an input error, and nothing has moved.
    let text = daemon.expect(1, &["model", "load"]);
    assert!(
        text.contains("no axis Z in the daemon's configuration, which has x, z (is Z its z?")
            && text.contains("here scale.Z"),
        "{text}"
    );
    assert!(
        text.contains("nothing is loaded")
            && text.contains("z                 0        0.000          30       30.000"),
        "{text}"
    );
    assert!(
        daemon
            .expect(2, &["model", "load", "/nonexistent", "--yes"])
            .contains("expected a file that can be read")
    );
    // A file without an end, and a pipe without a writer: both are reported at once, and the daemon continues.
    let pipe = directory.path().join("pipe");
    nix::unistd::mkfifo(&pipe, nix::sys::stat::Mode::S_IRWXU).unwrap();
    for special in [Path::new("/dev/zero"), &pipe] {
        let said = daemon.expect(2, &["model", "load", special.to_str().unwrap(), "--yes"]);
        assert!(said.contains("found a pipe, socket or device, expected a regular file"), "{said}");
    }
    let bad = directory.path().join("bad.toml");
    std::fs::write(
        &bad,
        "name = \"b\"\n[[effect]]\nname = \"thermal_growth.z\"\nsensor = \"T9\"\num_per_K = 1\n",
    )
    .unwrap();
    let said = daemon.expect(2, &["model", "load", bad.to_str().unwrap(), "--yes"]);
    let lacks = "no temperature T9 (read by thermal_growth.z) in the daemon's configuration";
    assert!(said.contains(lacks) && said.contains("[[sensor]] name = \"T9\""), "{said}");
    assert_eq!(daemon.status()["axes"][1]["requested"], 0);

    daemon.expect(0, &["model", "load", "--yes"]);
    until("the growth is corrected", || daemon.status()["axes"][1]["completed"] == 30);
    let z = explained(&daemon, "z");
    let parts = z["parts"].as_array().unwrap();
    let sum: f64 = parts.iter().map(|p| p["um"].as_f64().unwrap()).sum();
    assert!((sum - z["total_um"].as_f64().unwrap()).abs() < 1e-9 && z["requested"] == 30, "{z}");
    assert_eq!(
        (&parts[0]["name"], &parts[0]["sensors"][0]["degc"]),
        (&"thermal_growth.z".into(), &23.0.into())
    );
    assert!(parts[0]["sensors"][0]["age_s"].as_f64().unwrap() < 2.0, "{z}");
    // X moves, and its correction follows.
    until("the scale error is followed", || daemon.status()["axes"][0]["requested"].as_i64().unwrap() >= 6);
    let status = daemon.status();
    assert!(
        status["why_not"].as_array().unwrap().is_empty() && status["model"]["name"] == "bench",
        "{status}"
    );
    assert_eq!(status["sensors"][0]["place"], "spindle");

    // In probing mode the model's correction is reported, but not applied.
    let probed = daemon.user(&["probe", "on", "--captures", "2", "--json"]);
    let captures: Value = serde_json::from_slice(&probed.stdout).unwrap();
    for capture in captures["captures"].as_array().unwrap() {
        let trip = &capture["trip"];
        let um = |key: &str| trip[key].as_f64().unwrap();
        let wanted = if capture["axis"] == "z" { 30.0 } else { um("position_mm") };
        assert!((um("error_um") - wanted).abs() < 1e-6, "{capture}");
        assert!((um("corrected_mm") - um("position_mm") - um("error_um") / 1000.0).abs() < 1e-9);
        assert_eq!(trip["degc"][0], 23.0);
    }

    // Silent sensors: the last good value is used, then thermal corrections hold, and that is reported.
    sensors.silent.store(true, Ordering::Relaxed);
    until("holding", || {
        daemon.expect(0, &["status"]).contains("axis z: thermal corrections hold: sensor T1: silent")
    });
    assert_eq!(daemon.status()["axes"][1]["requested"], 30);
    sensors.silent.store(false, Ordering::Relaxed);
    sensors.set(25.0);
    until("it is said", || daemon.expect(0, &["status"]).contains("sensor T1 is good again"));
    assert_eq!(daemon.status()["axes"][1]["requested"], 30, "what came back enables nothing");
    daemon.expect(0, &["enable"]);
    until("it is back", || daemon.status()["axes"][1]["completed"] == 50);

    daemon.expect(0, &["model", "unload"]);
    daemon.expect(1, &["model", "unload"]);
    until("nothing is asked for", || daemon.status()["axes"][1]["completed"] == 0);
    let status = daemon.status();
    assert_eq!((&status["balanced"], status["model"].is_null()), (&true.into(), true));
}

/// A restart continues with the same correction, from the log.
/// The log gives the heat inside the machine. A file that has changed meanwhile is not run.
#[test]
fn a_restart_goes_on_with_the_same_correction_and_a_changed_file_does_not() {
    if !test_needs::long() {
        return;
    }
    let _room = among_others();
    let directory = tempfile::tempdir().unwrap();
    let sensors = Sensors::start(20.0);
    let lag = GROWTH.replace("growth", "lag") + "tau_s = 12.0\n";
    let file = set_up(directory.path(), &sensors, &lag);
    let socket = directory.path().join("s");
    let ready = |daemon: &Daemon| {
        daemon.expect(0, &["home"]);
        daemon.expect(0, &["enable"]);
        until("the sensors", || daemon.expect(0, &["status"]).contains("sensors: 2 of 2 good"));
    };
    let daemon = Daemon::start(&socket, Some(&file));
    ready(&daemon);
    daemon.expect(0, &["model", "load", "--yes"]);
    // The log must have a cold row, because a restart can know no more than the log.
    let logged = || std::fs::read_to_string(directory.path().join("temperatures.csv")).unwrap_or_default();
    until("a cold row in the log", || logged().lines().any(|l| l.ends_with(",20,20")));
    sensors.set(30.0);
    // Cold at its start, so its state is known. After warming by 10 K the effect goes towards 100 µm, with its lag.
    until("half way", || part_um(&daemon, "z", "thermal_lag.z").is_some_and(|um| um > 40.0));
    let before = part_um(&daemon, "z", "thermal_lag.z").unwrap();
    assert!(before < 90.0, "{before}");
    let (code, log) = daemon.end("KILL");
    assert_eq!(code, None, "{log}");

    let daemon = Daemon::start(&socket, Some(&file));
    ready(&daemon);
    let after = part_um(&daemon, "z", "thermal_lag.z").unwrap();
    // Meanwhile the lag has continued, as in the machine. Without the log the value would be 100 at once, or 0.
    assert!(after >= before - 2.0 && after < 99.0, "{before} before, {after} after the restart");
    assert!(daemon.status()["why_not"].as_array().unwrap().is_empty(), "{}", daemon.status());
    let (_, log) = daemon.end("TERM");
    assert!(log.contains("machine model"), "{log}");

    // A model that was loaded for one machine is refused for another.
    let configured = std::fs::read_to_string(&file).unwrap();
    std::fs::write(&file, configured.replacen("'bench'", "'another bench'", 1)).unwrap();
    let daemon = Daemon::start(&socket, Some(&file));
    let text = daemon.expect(0, &["status"]);
    assert!(text.contains("was loaded for the machine"), "{text}");
    assert!(daemon.status()["model"].is_null());
    drop(daemon);
    std::fs::write(&file, configured).unwrap();

    let path = directory.path().join("machine.toml");
    let changed = std::fs::read_to_string(&path).unwrap().replace("10.0", "11.0");
    std::fs::write(&path, changed).unwrap();
    let daemon = Daemon::start(&socket, Some(&file));
    let text = daemon.expect(0, &["status"]);
    assert!(text.contains("is not the one that was loaded last (its hash is another)"), "{text}");
    assert!(daemon.status()["model"].is_null());
    ready(&daemon);
    daemon.expect(0, &["model", "load", "--yes"]);
    assert!(part_um(&daemon, "z", "thermal_lag.z").is_some());
}

/// An expired model is refused unless the user says that it is meant.
/// That consent is stored with it.
#[test]
fn an_expired_model_is_refused_unless_it_is_meant() {
    let _room = among_others();
    let directory = tempfile::tempdir().unwrap();
    let sensors = Sensors::start(23.0);
    let fit = "[[fit]]\nresponse = \"error.x\"\ndate = \"2001-01-01\"\nvalid_until = \"2002-01-01\"\nrms_um = 1\n\
               half_width_um = 2\n[[effect]]\nname = \"scale.x\"\nppm = 1000.0\n";
    let file = set_up(directory.path(), &sensors, fit);
    let socket = directory.path().join("s");
    let daemon = Daemon::start(&socket, Some(&file));
    let ended = "error.x: the fit's validity ended on 2002-01-01";
    let text = daemon.expect(1, &["model", "load", "--yes"]);
    assert!(text.contains(ended) && text.contains("--expired"), "{text}");
    assert!(daemon.status()["model"].is_null());
    daemon.expect(0, &["model", "load", "--yes", "--expired"]);
    assert_eq!(daemon.status()["model"]["expired"][0], ended);
    daemon.expect(0, &["home"]);
    daemon.expect(0, &["enable"]);
    until("it corrects", || daemon.status()["axes"][0]["requested"].as_i64().unwrap() >= 6);
    assert!(daemon.expect(0, &["status"]).contains(ended));
    daemon.end("TERM");

    // The consent holds after a restart. Without it in the stored file the model is not loaded.
    let daemon = Daemon::start(&socket, Some(&file));
    assert_eq!(daemon.status()["model"]["name"], "bench");
    daemon.end("TERM");
    let taken = directory.path().join("model.taken");
    let text = std::fs::read_to_string(&taken).unwrap();
    std::fs::write(&taken, text.lines().take(2).collect::<Vec<_>>().join("\n")).unwrap();
    let daemon = Daemon::start(&socket, Some(&file));
    let text = daemon.expect(0, &["status"]);
    assert!(text.contains("not correcting: the model") && text.contains(ended), "{text}");
    assert!(daemon.status()["model"].is_null());
    // After an explicit unload it runs without a model.
    daemon.expect(0, &["model", "unload"]);
    assert!(!daemon.expect(0, &["status"]).contains(ended));
}
