//! State files that were lost, damaged or moved.

use rtec_tests::daemon::{Bench, CONFIG, alone, program, until};
use std::io::{BufRead, BufReader};
use std::os::unix::fs::FileExt;
use std::process::Command;

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
    // 64 bytes anywhere are no loss, because the other copy has them.
    zero(64);
    let daemon = bench.daemon();
    assert_eq!((&bench.x()["in_effect"], &bench.x()["faults"]), (&4.into(), &serde_json::json!([])));
    assert_eq!(daemon.end("KILL").0, None);
    // In both copies: the total in effect is unknown, which is a fault.
    zero(64);
    zero(64 + 4096);
    let daemon = bench.daemon();
    let status = daemon.status();
    assert_eq!((&status["mode"], &status["axes"][0]["faults"][0]), (&"fault".into(), &"record_lost".into()));
    assert!(daemon.expect(4, &["status"]).contains("has lost what this axis had in effect"));
    assert_eq!(bench.machine.illegal(), 0);
}

/// After a power cut of PC and MTC the count is unknown, and hold is kept.
/// The file is on a disk and survives.
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
    // It stays unknown until the MTC has been homed.
    let daemon = bench.daemon();
    assert_eq!(daemon.status()["axes"][0]["mtc_known"], false);
}

/// A newest record that is damaged in both copies is unknown, and latches.
#[test]
fn a_newest_record_that_is_damaged_in_both_copies_latches() {
    if !test_needs::long() {
        return;
    }
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

/// A state file that is lost in use is reported, held and written again.
/// It is removed, replaced, cut short or overwritten. Nothing is lost with the process.
#[test]
fn a_state_file_that_is_lost_while_it_is_written_is_written_anew() {
    if !test_needs::long() {
        return;
    }
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
        // A store to the file that is gone.
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
    // An orderly end checks once more.
    std::fs::remove_file(&state).unwrap();
    assert_eq!(daemon.end("TERM").0, Some(0));
    let daemon = bench.daemon();
    assert_eq!(daemon.status()["faults"][0], "state_file_lost");
    daemon.expect(0, &["clear"]);
    // A failure to write it again is reported too, and the fault is latched again while it lasts.
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
    // Its own daemon finds it unchanged.
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
    // A stop while it waits for the card is a clean stop.
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
    // If the card does not come, the result is that of a start without waiting.
    let run = bench.command().args(["--wait-for-card", "1"]).output().unwrap();
    let text = String::from_utf8_lossy(&run.stderr);
    assert!(run.status.code() == Some(3) && text.contains("No such file"), "{:?} {text}", run.status);
}
