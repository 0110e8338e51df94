//! The process-intermittent loop through a real `rtecd`.
//!
//! A simulated turning centre moves behind its mock card. Its controller runs the probing program and the finish cut;
//! `rtecctl` does everything else.

use rtec_part::contour::nose;
use rtec_part::length_unit::LengthUnit;
use rtec_sim::turning_experiment::TurningExperimentInputs;
use rtec_tests::daemon::{Daemon, program, until};
use serde_json::Value;
use std::path::Path;
use std::process::Command;

const CONFIG: &str = r#"
[machine]
name = "simulated turning centre"
[card]
backend = "mock"
[[axis]]
name = "z"
count_um = 1.0
travel_mm = 900.0
max_correction_counts = 1000
window_counts = 50
min_separation_ns = 500
home_mm = 480.0
[[axis]]
name = "x"
count_um = 1.0
travel_mm = 400.0
max_correction_counts = 1000
window_counts = 50
min_separation_ns = 500
home_mm = 100.0
"#;
const SEMI_MM: f64 = 38.354;

/// Runs an `rtecctl part …` that needs no daemon.
fn part(folder: &Path, line: &str) -> Value {
    let run = Command::new(program("rtecctl"))
        .arg("part")
        .args(line.split_whitespace())
        .arg("--json")
        .current_dir(folder)
        .output()
        .unwrap();
    assert_eq!(run.status.code(), Some(0), "{line}: {}", String::from_utf8_lossy(&run.stderr));
    serde_json::from_slice(&run.stdout).unwrap()
}

fn largest_um(errors: &Value) -> f64 {
    errors["errors"]
        .as_array()
        .unwrap()
        .iter()
        .map(|e| e["error_um"].as_f64().unwrap().abs())
        .fold(0.0, f64::max)
}

/// A daemon whose simulated machine does `task`.
fn daemon(folder: &Path, task: &str) -> Daemon {
    let (config, lathe, socket) = (folder.join("rtec.toml"), folder.join("lathe.toml"), folder.join("s"));
    std::fs::write(&config, CONFIG).unwrap();
    std::fs::write(&lathe, task).unwrap();
    let mut command = Command::new(program("rtecd"));
    command.arg("--socket").arg(&socket).arg("--config").arg(&config).arg("--lathe").arg(&lathe);
    let daemon = Daemon::spawn(&mut command, &socket);
    daemon.expect(0, &["home"]);
    daemon
}

/// Points of a plan on the nose, as `part points` writes them.
fn plan(folder: &Path, name: &str, radius_mm: f64) {
    let setup = TurningExperimentInputs { points: 7, ..TurningExperimentInputs::default() };
    std::fs::create_dir_all(folder.join(name)).unwrap();
    for (file, text) in setup.plan(radius_mm).files(&nose(setup.centre, radius_mm), LengthUnit::MM) {
        std::fs::write(folder.join(name).join(file), text).unwrap();
    }
}

#[test]
fn a_part_is_probed_and_finished_through_the_daemon() {
    if !test_needs::long() {
        return;
    }
    let directory = tempfile::tempdir().unwrap();
    let folder = directory.path();
    part(folder, &format!("finish --radius-mm {SEMI_MM} --out semi"));
    plan(folder, "semi", SEMI_MM);

    let probing = "workpiece = \"semi/workpiece.csv\"\npath = \"semi/pathfin.cdl\"\nfeed_mm_min = 2500.0\ntip_mm = 2.5\n\
                   origin_mm = [300.0, 100.0]\nseed = 3\n";
    let machine = daemon(folder, probing);
    let at = |file: &str| folder.join(file).display().to_string();
    let (path, expected, out) = (at("semi/pathfin.cdl"), at("semi/probpath.cdl"), at("semi"));
    let session = [
        "part",
        "probe",
        "--daemon",
        "--path",
        &path,
        "--expected",
        &expected,
        "--origin-mm",
        "300,100",
        "--out",
        &out,
    ];
    let said = machine.expect(0, &[&session[..], &["--start"]].concat());
    assert!(said.contains("point 7 of 7"), "{said}");
    assert_eq!(machine.status()["mode"], "disabled", "probing is off again");
    // The program has ended, so there is no further touch.
    let said = machine.expect(1, &[&session[..], &["--patience-s", "0.2"]].concat());
    assert!(said.contains("point 1: missed"), "{said}");
    assert_eq!(machine.status()["mode"], "disabled", "off after a failure too");
    drop(machine);

    let errors = format!("errors --points semi/probed.csv --radius-mm {SEMI_MM} --tip-mm 2.5 --out semi");
    let before = part(folder, &errors);
    assert!(largest_um(&before) > 12.0, "the worn tool's bump: {before}");
    let record = rtec_measure::run_record_files::read(&folder.join("semi/probing.run.toml")).unwrap();
    assert_eq!(record.rows(), 7);

    let cutting =
        "workpiece = \"final.csv\"\ncut_radius_mm = 38.1\nfeed_mm_min = 1800.0\norigin_mm = [300.0, 100.0]\n";
    let table = at("semi/error.cor");
    let load = [
        "part",
        "load",
        "--errors",
        &table,
        "--centre-z-mm",
        "127",
        "--radius-mm",
        "38.1",
        "--nose-mm",
        "0.794",
        "--tool-z-mm",
        "300",
        "--tool-x-mm",
        "100",
    ];
    let mut left_um = [0.0; 2];
    for (corrected, left_um) in left_um.iter_mut().enumerate() {
        std::fs::copy(folder.join("semi/workpiece.csv"), folder.join("final.csv")).unwrap();
        let machine = daemon(folder, cutting);
        machine.expect(0, &["enable"]);
        if corrected == 1 {
            let wrong = machine.expect(2, &[&load[..], &["--z-axis", "b"]].concat());
            assert!(wrong.contains("expected one of z, x"), "{wrong}");
            machine.expect(0, &load);
            assert_eq!(machine.status()["table"]["radius_mm"], 38.1);
        }
        machine.expect(0, &["hold", "on"]);
        machine.expect(0, &["hold", "off"]);
        // The arc ends slightly beyond X 138.9 mm.
        let place = |status: &Value, n: usize| status["axes"][n]["position_mm"].as_f64().unwrap();
        let mut most = 0;
        until("the cut's end", || {
            let status = machine.status();
            most = most.max(status["axes"][0]["completed"].as_i64().unwrap().abs());
            assert_ne!(status["mode"], "fault", "{status}");
            place(&status, 0) < 426.5 && place(&status, 1) > 138.5
        });
        let status = machine.status();
        assert_eq!(status["balanced"], true);
        assert_eq!(most > 4, corrected == 1, "{most} counts at most");
        if corrected == 1 {
            machine.expect(0, &["part", "unload"]);
            let said = machine.expect(1, &["part", "unload"]);
            assert!(said.contains("no part table"), "{said}");
        }
        assert_eq!(machine.end("TERM").0, Some(0));
        plan(folder, "final", 38.1);
        part(
            folder,
            "probe --workpiece final.csv --path final/pathfin.cdl --expected final/probpath.cdl --seed 9 --out final",
        );
        let after = part(folder, "errors --points final/probed.csv --radius-mm 38.1 --tip-mm 2.5");
        *left_um = largest_um(&after);
    }
    let [plain, corrected] = left_um;
    println!("largest error: {plain:.2} µm without the table, {corrected:.2} µm with it");
    assert!(plain > 12.0 && corrected < 4.0, "{plain} {corrected}");
}
