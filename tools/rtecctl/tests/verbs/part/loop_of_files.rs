//! The steps from drawing to finish cut, through their files.

use crate::parts::{drawing, json, part};
use serde_json::Value;
use std::path::Path;
use std::process::Command;

/// Deviation of the G01 moves, as LinuxCNC's interpreter reads them, µm.
/// The path must be within 1.5 µm of the corrected arc.
fn worst_of_g01_um(folder: &Path, g01: &str, errors: &[(f64, f64)]) -> Option<f64> {
    if !test_needs::installed("rs274", "linuxcnc-uspace") {
        return None;
    }
    std::fs::write(folder.join("g01.ngc"), format!("G21 G18 G8 G90 G94\n{g01}M2\n")).unwrap();
    std::fs::write(folder.join("none.tbl"), "").unwrap();
    std::fs::write(folder.join("none.var"), "").unwrap();
    let run = Command::new("rs274")
        .args(["-g", "-t", "none.tbl", "-v", "none.var", "g01.ngc"])
        .current_dir(folder)
        .output()
        .unwrap();
    let canon = String::from_utf8_lossy(&run.stdout).into_owned();
    assert!(run.status.success(), "{canon}");
    let corners: Vec<[f64; 2]> = canon
        .lines()
        .filter_map(|l| {
            let values = l.split_once("STRAIGHT_FEED(")?.1;
            let values: Vec<f64> = values.split([',', ')']).filter_map(|v| v.trim().parse().ok()).collect();
            Some([*values.get(2)? - 127.0, *values.first()?])
        })
        .collect();
    assert_eq!(corners.len(), g01.lines().count(), "{canon}");
    let error_um = |angle: f64| {
        let next = errors.iter().position(|e| e.0 > angle).unwrap_or(errors.len() - 1).max(1);
        let ((a, from), (b, to)) = (errors[next - 1], errors[next]);
        from + (to - from) * ((angle - a) / (b - a)).clamp(0.0, 1.0)
    };
    let off_um = |[z, x]: [f64; 2]| ((z.hypot(x) - 38.894) * 1e3 + error_um(x.atan2(z))).abs();
    let along = corners.windows(2).flat_map(|w| {
        (0..=100).map(|k| [0, 1].map(|n| w[0][n] + (w[1][n] - w[0][n]) * f64::from(k) / 100.0))
    });
    Some(along.map(off_um).fold(0.0, f64::max))
}

#[test]
fn a_run_begins_with_the_drawing() {
    if !test_needs::long() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(folder.join("nose.dxf"), drawing(30.0)).unwrap();
    let report = json(folder, &["run", "--points", "8", "--json"]);
    assert!(report["finish"]["largest_um"].as_f64().unwrap() <= 4.0, "without a drawing: {report}");
    let run = json(folder, &["run", "nose.dxf", "--out", "o", "--json"]);
    assert!(run["finish"]["largest_um"].as_f64().unwrap() <= 2.0, "{run}");
    assert!(folder.join("o/features.svg").exists());
    let probed =
        ["errors", "--points", "o/inspection/probed.csv", "--radius-mm", "30", "--tip-mm", "2.5", "--json"];
    let inspected = json(folder, &probed);
    assert!((inspected["radius_mm"].as_f64().unwrap() - 30.0).abs() < 0.01, "{inspected}");
    assert!((inspected["centre_mm"][0].as_f64().unwrap() - 127.0).abs() < 0.01, "{inspected}");

    std::fs::write(folder.join("fillet.dxf"), drawing(30.0).replace("90.0", "80.0")).unwrap();
    for (line, said) in [
        ("run fillet.dxf --out none", "fillet.dxf: found"),
        ("run nose.dxf --radius-mm 30 --out none", "--radius-mm"),
        ("run --layer PART --out none", "DRAWING"),
    ] {
        let output = part(folder, &line.split_whitespace().collect::<Vec<_>>());
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{line}: {stderr}");
        assert!(stderr.contains(said), "{line}: {stderr}");
        assert!(!folder.join("none").exists());
    }
}

#[test]
fn the_steps_follow_each_other_through_their_files() {
    if !test_needs::long() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let go = |line: &str| json(folder, &line.split_whitespace().chain(["--json"]).collect::<Vec<_>>());
    std::fs::write(folder.join("semi.dxf"), drawing(38.354)).unwrap();
    std::fs::write(folder.join("final.dxf"), drawing(38.1)).unwrap();

    let features = go("features semi.dxf");
    assert_eq!(features["features"][0]["feature"]["kind"], "arc", "{features}");
    go("finish --radius-mm 38.354 --out semi");
    let plan = go("points semi.dxf --feature F1:20 --tip-mm 2.5 --out semi");
    assert!((plan["stand_off_mm"].as_f64().unwrap() - 5.0).abs() < 0.01, "{plan}");
    go("program --path semi/pathfin.cdl --set part=6304 --out semi");
    let program = std::fs::read_to_string(folder.join("semi/pt6304s2.dnc")).unwrap();
    assert!(program.contains("1992-06-21 23:59") && program.contains("TOUCH POINT 20"));
    let probed = go(
        "probe --workpiece semi/workpiece.csv --path semi/pathfin.cdl --expected semi/probpath.cdl --out semi",
    );
    assert_eq!(probed["trips"].as_array().unwrap().len(), 20);
    let before = go(
        "errors --points semi/probed.csv --radius-mm 38.354 --tip-mm 2.5 --expected semi/probpath.cdl --out semi",
    );
    let largest = |r: &Value| {
        r["errors"]
            .as_array()
            .unwrap()
            .iter()
            .map(|e| e["error_um"].as_f64().unwrap().abs())
            .fold(0.0, f64::max)
    };
    assert!(largest(&before) > 18.0, "the worn tool's bump");
    let table = go(
        "table --errors semi/error.cor --centre-z-mm 127 --radius-mm 38.1 --nose-mm 0.794 --g01-um 1.5 --out final",
    );
    assert!((90..100).contains(&table["g01_lines"].as_u64().unwrap()), "{}", table["g01_lines"]);
    let corrections: Vec<(f64, f64)> = std::fs::read_to_string(folder.join("semi/error.cor"))
        .unwrap()
        .lines()
        .map(|l| l.split_once(' ').unwrap())
        .map(|(angle, um)| (angle.parse().unwrap(), um.parse().unwrap()))
        .collect();
    let g01 = std::fs::read_to_string(folder.join("final/g01.nc")).unwrap();
    if let Some(worst_um) = worst_of_g01_um(folder, &g01, &corrections) {
        assert!(worst_um <= 1.5 && worst_um > 1.4, "{worst_um}");
    }
    let cut = go(
        "finish --workpiece semi/workpiece.csv --errors semi/error.cor --radius-mm 38.1 --seed 2 --out final",
    );
    assert_eq!(cut["mtc_minus_scale"], cut["completed"], "{cut}");
    assert!(cut["insertions"][0].as_u64().unwrap() >= 10);
    go("points final.dxf --feature F1:20 --tip-mm 2.5 --out final");
    go(
        "probe --workpiece final/workpiece.csv --path final/pathfin.cdl --expected final/probpath.cdl --seed 3 --out final",
    );
    let compare = "inspect --before semi/probed.csv --after final/probed.csv --before-radius-mm 38.354 --radius-mm 38.1 \
                   --tip-mm 2.5";
    let both = go(&format!("{compare} --limit-um 4 --out report"));
    assert!(largest(&both["after"]) <= 2.0, "{}", both["decisions"]);
    assert!(std::fs::read_to_string(folder.join("report/inspection.html")).unwrap().contains("<svg"));
    assert!(std::fs::read_to_string(folder.join("report/decisions.log")).unwrap().contains("accepted"));

    let arguments: Vec<&str> = compare.split_whitespace().chain(["--limit-um", "0.01"]).collect();
    assert_eq!(part(folder, &arguments).status.code(), Some(1), "the answer is no");
    // The part is not where the plan of another part expects it: the first point is named.
    let output = part(
        folder,
        &"probe --workpiece final/workpiece.csv --path semi/pathfin.cdl --expected semi/probpath.cdl --trip-window-mm 0.1 --out x"
            .split_whitespace()
            .collect::<Vec<_>>(),
    );
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("point 1: tripped 0.2"), "{output:?}");
}
