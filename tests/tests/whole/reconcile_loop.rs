//! The closed loop of reconciliation, through `rtecctl` alone.
//!
//! The model lacks an effect of the machine that it corrects. The measured runs are reconciled, and the found model
//! makes better parts.

use rtec_tests::daemon::program;
use serde_json::Value;
use std::path::Path;
use std::process::Command;

fn json(folder: &Path, arguments: &[&str]) -> Value {
    let run =
        Command::new(program("rtecctl")).args(arguments).arg("--json").current_dir(folder).output().unwrap();
    assert!(run.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&run.stderr));
    serde_json::from_slice(&run.stdout).unwrap()
}

const KNOWN: &str = "name = \"lathe\"\n[[effect]]\nname = \"scale.x\"\nppm = 12.0\n";

/// The hidden effect is tool wear, seen in probed points of a nose.
/// The nose is turned, probed on the machine, reconciled and turned again. `rtecctl part errors` judges the probed
/// points.
#[test]
fn a_worn_tool_is_named_from_probed_points_and_the_next_nose_is_round() {
    if !test_needs::long() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    std::fs::write(at.join("true.toml"), KNOWN).unwrap();
    std::fs::write(at.join("known.toml"), KNOWN).unwrap();
    let turn = |model: &str, out: &str| {
        let arguments = ["simulate", "hemisphere", "--machine", "true.toml", "--model", model, "--out", out];
        json(at, &arguments)["summary"]["form"].clone()
    };
    let before = turn("known.toml", "first");
    let arguments = ["reconcile", "first/hemisphere.run.toml", "--model", "known.toml", "--out", "found"];
    let verdict = json(at, &arguments);
    assert_eq!(verdict["effects"][0]["name"], "form_bump", "{verdict}");
    let after = turn("found/model.toml", "second");
    eprintln!("form without {before}, with what was found {after}");
    // Largest error of the probed points, from their positions.
    let probed = |run: &str| -> f64 {
        let csv = std::fs::read_to_string(at.join(run)).unwrap();
        let point = |line: &str| {
            let fields: Vec<f64> = line.split(',').map(|f| f.parse().unwrap()).collect();
            let [angle, error_um] = fields[fields.len() - 2..] else { panic!("angle and error end a row") };
            let r = 38.1 + error_um / 1000.0;
            format!("{},{}\n", r * angle.cos(), r * angle.sin())
        };
        let points: String = csv.lines().skip(1).map(point).collect();
        std::fs::write(at.join("points.csv"), format!("z_mm,x_mm\n{points}")).unwrap();
        let document = json(at, &["part", "errors", "--points", "points.csv", "--radius-mm", "38.1"]);
        let errors = document["errors"].as_array().unwrap();
        errors.iter().map(|e| e["error_um"].as_f64().unwrap().abs()).fold(0.0, f64::max)
    };
    let (worn, mended) = (probed("first/hemisphere.csv"), probed("second/hemisphere-compensated.csv"));
    eprintln!("largest probed error {worn:.2} µm, then {mended:.2} µm");
    assert!(worn > 15.0 && mended < worn / 4.0, "{worn} and {mended}");
}

/// The hidden effect is growth with the spindle's heat.
/// It is found in a drift test, and is gone from the drilled part.
#[test]
fn a_growth_found_in_a_drift_test_is_gone_from_the_drilled_part() {
    if !test_needs::long() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let growth = "[[effect]]\nname = \"thermal_growth.z\"\nsensor = \"T8\"\nminus = \"T18\"\num_per_K = 1.9\n\
                  um_per_K2 = 0.0\n";
    std::fs::write(at.join("true.toml"), format!("{KNOWN}{growth}")).unwrap();
    std::fs::write(at.join("known.toml"), KNOWN).unwrap();
    let simulate = |what: &str, model: &str, out: &str| {
        json(at, &["simulate", what, "--machine", "true.toml", "--model", model, "--out", out])["summary"]
            .clone()
    };
    simulate("drift", "known.toml", "drift");
    // In the dry run alone the surroundings do not change. Only both runs show what the nose grows with.
    let records = ["drift/drift-dry.run.toml", "drift/drift-wet.run.toml"];
    let arguments = ["reconcile", records[0], records[1], "--model", "known.toml", "--out", "found"];
    let verdict = json(at, &arguments);
    let effect = &verdict["effects"][0];
    assert_eq!((&verdict["verdict"], &effect["name"]), (&"named".into(), &"thermal_growth.z".into()));
    assert_eq!((&effect["sensor"], &effect["minus"]), (&"T8".into(), &"T18".into()), "{verdict}");
    assert_eq!(verdict["suspicions"].as_array().map(Vec::len), Some(0), "{verdict}");
    assert!(verdict["gap"]["closed"].as_f64().unwrap() > 0.99, "{}", verdict["gap"]);
    let depth = |summary: &Value| summary["drilling"]["z_with"]["max"].as_f64().unwrap();
    let before = depth(&simulate("drilling", "known.toml", "before"));
    let after = depth(&simulate("drilling", "found/model.toml", "after"));
    eprintln!("drilled depth, largest error: {before:.2} µm, then {after:.2} µm");
    assert!(before > 5.0 && after < before / 3.0, "{before} and {after}");
}
