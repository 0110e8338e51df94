//! State that a restart must keep, and corrections that must not return (law 7).
//! The state is feed hold, faults and the controller's counts. Each row of the guide's page "Who homes what, when" is
//! tested here.

use crate::survival::Stopped;
use rtec_driver::card_profile::Width;
use rtec_driver::mapped_registers::MappedRegisterFile;
use rtec_driver::quadrature::State;
use rtec_tests::daemon::{Bench, CONFIG, Lines, alone, shared_memory, until, user};
use serde_json::Value;
use std::os::unix::fs::FileExt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Whether the controller sees feed hold.
fn held(bench: &Bench) -> bool {
    bench.machine.look_twice();
    bench.machine.seen.outputs.load(Ordering::Relaxed) >> 28 & 1 == 1
}

fn in_effect(bench: &Bench) -> i64 {
    bench.x()["in_effect"].as_i64().unwrap_or(i64::MIN)
}

fn done(bench: &Bench, args: &[&str]) -> String {
    let (code, text) = bench.user(args);
    assert_eq!(code, Some(0), "{args:?}: {text}");
    text
}

fn refused(bench: &Bench, args: &[&str]) -> String {
    let (code, text) = bench.user(args);
    assert!(matches!(code, Some(1 | 4)), "{args:?}: {code:?} {text}");
    text
}

/// Moves the axis and waits for two edges, which every homing needs for a speed.
fn moves(bench: &Bench) {
    bench.machine.move_axis(true);
    bench.edges(3);
}

#[test]
fn a_restart_keeps_hold_and_faults() {
    let _alone = alone();
    let bench = Bench::default();
    for signal in ["KILL", "TERM"] {
        let daemon = bench.daemon();
        bench.go();
        done(&bench, &["hold", "on"]);
        let since = daemon.status()["hold"]["at_s"].as_f64().unwrap();
        daemon.end(signal);
        assert!(held(&bench), "nobody is there");
        let daemon = bench.daemon();
        let status = daemon.status();
        assert!(held(&bench) && status["mode"] == "hold" && status["enabled"] == false, "{status}");
        // The same user, and the same time.
        let hold = &status["hold"];
        assert!(hold["by"].as_str().is_some_and(|by| by.starts_with("user ")), "{hold}");
        assert!((hold["at_s"].as_f64().unwrap() - since).abs() < 2.0, "{hold} {since}");
        let (_, text) = bench.user(&["status"]);
        assert!(text.contains("mode HOLD, DISABLED") && text.contains("feed hold by user"), "{text}");
        assert!(refused(&bench, &["enable"]).contains("feed hold is on"));
        done(&bench, &["hold", "off"]);
        assert!(!held(&bench) && daemon.status()["mode"] == "disabled");

        // A fault that leaves the count certain, with its feed hold. At the first edge after a start the axis may seem
        // fast, because its speed counts from the start. Homing is refused until then.
        until("homed", || bench.user(&["home", "--controller-homed"]).0 == Some(0));
        done(&bench, &["enable"]);
        for _ in 0..3 {
            refused(&bench, &["correct", "x", "900"]);
        }
        let latched = daemon.status()["latched_faults"].clone();
        assert!(held(&bench) && latched[0]["fault"] == "still_not_believed", "{latched}");
        daemon.end(signal);
        let daemon = bench.daemon();
        let status = daemon.status();
        assert!(held(&bench) && status["mode"] == "fault" && status["hold"]["by"] == "fault", "{status}");
        let again = &status["latched_faults"][0];
        assert_eq!((&again["fault"], &again["axis"]), (&"still_not_believed".into(), &"x".into()));
        let at_s = |fault: &Value| fault["at_s"].as_f64().unwrap();
        assert!((at_s(again) - at_s(&latched[0])).abs() < 2.0, "{again} {latched}");
        refused(&bench, &["home", "--controller-homed"]);
        done(&bench, &["hold", "off"]);
        assert!(held(&bench), "a fault holds, whoever releases the other hold");
        done(&bench, &["clear"]);
        assert!(!held(&bench) && daemon.status()["mode"] == "disabled");
        daemon.end("TERM");
    }
}

/// The page "Who homes what, when", row by row.
#[test]
fn who_homes_what_and_when() {
    let _alone = alone();
    let bench = Bench::default();

    // At the first start the controller's count is unknown.
    let daemon = bench.daemon();
    moves(&bench);
    assert!(refused(&bench, &["home"]).contains("nobody knows what the controller counts"));
    assert!(refused(&bench, &["home", "--controller-not-homed"]).contains("nobody knows"));
    assert_eq!(bench.x()["mtc_known"], false);
    done(&bench, &["home", "--controller-homed"]);
    let base = bench.machine.offset();
    done(&bench, &["enable"]);
    bench.correct(6);

    // Homed again with counts in effect: refused with the numbers, and nothing changes.
    let text = refused(&bench, &["home"]);
    assert!(text.contains("axis x: +6 counts, +6.000 µm: still in the controller's count"), "{text}");
    assert_eq!((in_effect(&bench), &bench.x()["homed"]), (6, &true.into()));

    // Homing the scale alone five times keeps the total, which counts against the limit.
    for round in 1..=5 {
        done(&bench, &["home", "--controller-not-homed"]);
        assert_eq!((in_effect(&bench), bench.machine.offset() - base), (6, 6), "round {round}");
    }
    assert!(refused(&bench, &["correct", "x", "1001"]).contains("max_correction_counts"));

    // After a restart of the daemon alone, the total in effect is known and reported.
    daemon.end("KILL");
    let daemon = bench.daemon();
    assert_eq!(
        (in_effect(&bench), &bench.x()["mtc_known"], &bench.x()["homed"]),
        (6, &true.into(), &false.into())
    );
    assert!(bench.user(&["status"]).1.contains("still in the controller's count: x +6 counts"));
    assert!(refused(&bench, &["home"]).contains("+6 counts"));
    bench.edges(3);
    done(&bench, &["home", "--controller-not-homed"]);
    let text = done(&bench, &["enable"]);
    assert!(text.contains("nothing moves"), "{text}");
    bench.correct(8);
    assert_eq!(bench.machine.offset() - base, 8);

    // After a restart of the controller, both are homed. (Its count starts at zero; here the test takes a new base.)
    done(&bench, &["disable"]);
    done(&bench, &["home", "--controller-homed"]);
    let base = bench.machine.offset();
    assert_eq!(in_effect(&bench), 0);
    done(&bench, &["enable"]);
    bench.correct(4);

    // An odd number of insertions leaves the inverters on. One insertion less, and a gated reference mark is in its
    // place.
    bench.correct(6);
    assert!(bench.machine.inverted());
    done(&bench, &["park", "--inverters-off"]);
    assert_eq!((in_effect(&bench), bench.machine.inverted()), (4, false));
    done(&bench, &["enable"]);

    // After parking to zero a restart needs homing of the scale alone, without a statement on the controller.
    done(&bench, &["park", "--to-zero"]);
    assert_eq!(bench.machine.offset(), base);
    daemon.end("TERM");
    let _daemon = bench.daemon();
    bench.edges(3);
    done(&bench, &["home"]);
    done(&bench, &["enable"]);

    // After a fault that puts the count in doubt, only homing both makes it known.
    bench.correct(4);
    bench.machine.glitch();
    until("the fault", || bench.x()["faults"].as_array().is_some_and(|f| !f.is_empty()));
    let text = done(&bench, &["clear"]);
    assert!(text.contains("the controller too, then `rtecctl home --controller-homed`"), "{text}");
    assert!(refused(&bench, &["home", "--controller-not-homed"]).contains("nobody knows"));
    done(&bench, &["home", "--controller-homed"]);
}

/// A PC that lost power and its state says that it knows nothing.
/// It starts with its outputs low.
#[test]
fn a_pc_that_comes_back_without_its_state_knows_nothing() {
    let _alone = alone();
    let bench = Bench::default();
    let daemon = bench.daemon();
    bench.go();
    bench.correct(6);
    daemon.end("KILL");
    std::fs::remove_file(bench.at("state")).unwrap();
    // The outputs are the second register.
    std::fs::File::options().write(true).open(bench.at("card")).unwrap().write_all_at(&[0; 4], 4).unwrap();
    let daemon = bench.daemon();
    let status = daemon.status();
    let why = status["why_not"].to_string();
    assert!(why.contains("the controller's count is not known: x"), "{why}");
    assert_eq!(status["axes"][0]["mtc_known"], false);
    moves(&bench);
    assert!(refused(&bench, &["home"]).contains("nobody knows what the controller counts"));
    for order in [&["enable"][..], &["shadow"], &["park"], &["park", "--to-zero"]] {
        let said = refused(&bench, order);
        assert!(
            said.contains("is not known: x") && said.contains("`rtecctl home --controller-homed`"),
            "{said}"
        );
    }
}

/// A real-time thread that stalls ends the process, and the next one holds.
/// The service manager starts the next one.
#[test]
fn a_thread_that_stands_still_ends_the_process_and_holds_the_machine() {
    if !test_needs::long() {
        return;
    }
    let _alone = alone();
    let bench = Bench::default();
    let daemon = bench.daemon();
    bench.go();
    let tasks = std::fs::read_dir(format!("/proc/{}/task", daemon.id())).unwrap();
    let named = |task: &std::path::Path| {
        std::fs::read_to_string(task.join("comm")).is_ok_and(|name| name.trim() == "rtec-rt")
    };
    let task = tasks.map(|t| t.unwrap().path()).find(|t| named(t)).unwrap();
    let tid = task.file_name().and_then(|n| n.to_str()?.parse().ok()).unwrap();
    Stopped::thread(tid).dies();
    let (code, log) = daemon.end("CONT");
    assert!(code == Some(1) && log.contains("the real-time thread is lost"), "{code:?} {log}");
    let daemon = bench.daemon();
    let status = daemon.status();
    assert!(held(&bench) && status["mode"] == "fault", "{status}");
    assert_eq!(status["faults"][0], "thread_lost");
    done(&bench, &["clear"]);
    daemon.end("TERM");
    assert_eq!(bench.daemon().status()["mode"], "disabled", "it was cleared");
}

/// The steps of the guide's page on upgrades, with a model.
/// They go from set-up to the operator who may not load one.
#[test]
fn the_steps_of_an_upgrade() {
    if !test_needs::long() {
        return;
    }
    let _alone = alone();
    let bench = Bench::with("[model]\nfile = 'machine.toml'\nramp_um_s = 200\n");
    std::fs::write(bench.at("machine.toml"), "name = 'bench'\n[[effect]]\nname = 'offset.x'\num = 6.0\n")
        .unwrap();
    let daemon = bench.daemon();
    bench.go();
    done(&bench, &["model", "load", "--yes"]);
    until("the model's correction", || in_effect(&bench).abs() == 6);
    done(&bench, &["park", "--to-zero"]);
    assert_eq!(daemon.end("TERM").0, Some(0));
    let _daemon = bench.daemon();
    let (_, text) = bench.user(&["status"]);
    assert!(text.contains("the model was unloaded: `rtecctl model again` takes it up as it was"), "{text}");
    moves(&bench);
    done(&bench, &["home"]);
    done(&bench, &["enable"]);
    let operator = |args: &[&str]| {
        let run = user(&bench.at("s-operate"), args);
        (run.status.code(), String::from_utf8_lossy(&[run.stdout, run.stderr].concat()).into_owned())
    };
    let (code, text) = operator(&["model", "load", "--yes"]);
    assert!(code == Some(1) && text.contains("this takes \"set up\""), "{code:?} {text}");
    let (code, text) = operator(&["model", "again"]);
    assert!(code == Some(0), "{text}");
    until("the model's correction", || in_effect(&bench).abs() == 6);
    assert_eq!(operator(&["model", "again"]).0, Some(1), "there is none to take up any more");
}

/// When `mtc_ready` falls, corrections are off and the axes not homed.
/// Feed hold stays until it is released.
#[test]
fn a_controller_that_restarts_has_to_be_homed() {
    let _alone = alone();
    let config =
        CONFIG.replace("CARD", "card").replace("disable = 'in29'", "disable = 'in29'\nmtc_ready = 'in30'");
    let config = config.replace("name = 'bench'", "name = 'bench'\nmtc_off = 'hold'");
    let ready = Arc::new(AtomicBool::new(true));
    let line = Arc::clone(&ready);
    let bench = Bench::on(&config, |file| WithReady { card: shared_memory(file), ready: line });
    let daemon = bench.daemon();
    bench.go();
    bench.correct(6);
    ready.store(false, Ordering::Relaxed);
    until("it is seen", || daemon.status()["rt"]["mtc_ready"] == false);
    let status = daemon.status();
    assert_eq!(
        (&status["mode"], &status["homed"], &status["enabled"]),
        (&"hold".into(), &false.into(), &false.into())
    );
    assert!(held(&bench) && status["hold"]["by"] == "the controller", "{status}");
    assert!(refused(&bench, &["home", "--controller-homed"]).contains("the controller is off"));
    ready.store(true, Ordering::Relaxed);
    until("it is seen", || daemon.status()["rt"]["mtc_ready"] == true);
    assert!(held(&bench), "hold does not fall by itself");
    assert!(refused(&bench, &["home"]).contains("nobody knows"));
    done(&bench, &["hold", "off"]);
    done(&bench, &["home", "--controller-homed"]);
    done(&bench, &["enable"]);
    bench.correct(2);
}

/// Shared memory with the controller's ready line on input 30.
struct WithReady {
    card: MappedRegisterFile,
    ready: Arc<AtomicBool>,
}

impl Lines for WithReady {
    fn outputs(&mut self) -> u64 {
        self.card.outputs()
    }

    fn show(&mut self, scale: State) {
        let ready = u32::from(self.ready.load(Ordering::Relaxed)) << 30;
        self.card.write(0, Width::Bits32, ready | u32::from(scale.bits()));
    }
}

/// A hangup is a failure, so that the service manager starts the daemon again.
#[test]
fn a_hangup_is_a_failure_for_the_service_manager() {
    let _alone = alone();
    let bench = Bench::default();
    let (code, log) = bench.daemon().end("HUP");
    assert!(code == Some(1) && log.contains("a hangup ended it"), "{code:?} {log}");
}
