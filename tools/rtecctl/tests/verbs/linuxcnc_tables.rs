//! Exported tables in a complete LinuxCNC, compared with the model's laws.
//! The laws are written again here.
//!
//! The tests read the compensation that LinuxCNC adds to the motors' command. They do so at the tables'
//! points and between them, in both directions, for both types, in millimetres and inches.

use std::path::Path;
use std::process::Command;

const MACHINE: &str = r#"
name = "screw"
effect = [
    { name = "scale.x", ppm = 40.0 },
    { name = "screw_periodic.x", um = 4.0, period_mm = 10.0, phase_rad = 0.5 },
    { name = "reversal.x", um = 6.0 },
    { name = "thermal_growth.x", sensor = "T1", um_per_K = 1.5 },
]
"#;

/// Position reached minus commanded, µm, at T1 = 24 °C.
fn error_um(p: f64, direction: f64) -> f64 {
    40.0 * p / 1000.0 + 4.0 * (std::f64::consts::TAU * p / 10.0 + 0.5).sin() + 3.0 * direction + 6.0
}

fn available() -> bool {
    test_needs::installed("linuxcnc", "linuxcnc-uspace")
}

/// Position (mm), joint, trim by HAL, and motor command minus command (µm).
/// The rows are in the order of the positions.
fn visited(dir: &Path, unit: &str, places_mm: &[f64]) -> Vec<(f64, usize, f64, f64)> {
    let mm = if unit == "inch" { 25.4 } else { 1.0 };
    let lines: Vec<String> = places_mm.iter().map(|p| format!("{:.9}", p / mm)).collect();
    std::fs::write(dir.join("places"), lines.join("\n") + "\n").unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/linuxcnc/run-compensation");
    let out = Command::new(script).arg(dir).arg(unit).output().unwrap();
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let text = std::fs::read_to_string(dir.join("compensated")).unwrap();
    let rows = text.lines().filter(|l| *l != "ended").map(|line| {
        let v: Vec<f64> = line.split(' ').map(|w| w.parse().unwrap()).collect();
        (v[0] * mm, v[1] as usize, v[3] * mm * 1000.0, v[4] * mm * 1000.0)
    });
    rows.collect()
}

fn export(dir: &Path, words: &str) {
    let words = format!("model export --machine m.toml --axis x --temperatures T1=24 {words}");
    let out =
        Command::new(env!("CARGO_BIN_EXE_rtecctl")).current_dir(dir).args(words.split(' ')).output().unwrap();
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
}

/// Up through all positions and down again.
fn there_and_back(places: &[f64]) -> Vec<f64> {
    let (low, high) = (places[0] - 5.0, places[places.len() - 1] + 5.0);
    let up = std::iter::once(low).chain(places.iter().copied());
    up.chain([high]).chain(places.iter().rev().copied()).collect()
}

#[test]
fn linuxcnc_takes_out_the_models_errors_in_both_units_types_and_directions() {
    if !test_needs::long() {
        return;
    }
    if !available() {
        return;
    }
    for unit in ["mm", "inch"] {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("m.toml"), MACHINE).unwrap();
        // 256 points, the most that LinuxCNC accepts: 102 mm in steps of 0.4 mm.
        let range = "--from -40 --to 62 --step 0.4";
        export(dir.path(), &format!("{range} --unit {unit} --out type0.comp"));
        export(dir.path(), &format!("{range} --unit {unit} --format linuxcnc-type1 --out type1.comp"));
        for name in ["type0.comp", "type1.comp"] {
            let text = std::fs::read_to_string(dir.path().join(name)).unwrap();
            assert_eq!(text.lines().count(), 256);
        }
        let points = [-40.0, -22.4, 0.0, 10.4, 37.6, 62.0];
        let between = [-31.3, -3.7, 8.5, 20.9, 61.9];
        let mut places: Vec<f64> = points.iter().chain(&between).copied().collect();
        places.sort_by(f64::total_cmp);
        let rows = visited(dir.path(), unit, &there_and_back(&places));
        assert_eq!(rows.len(), 2 * (2 * places.len() + 2));
        let mut worst = [0.0f64; 2];
        for (n, (place, joint, trim, motor)) in rows.iter().enumerate() {
            assert!((trim - motor).abs() < 1e-3, "the filter has settled: {trim} and {motor} µm");
            // The turning points lie outside, where the value of the end applies. The first is approached
            // from home, downwards.
            let up = (1..=places.len() + 1).contains(&(n / 2));
            let expected = -error_um(place.clamp(-40.0, 62.0), if up { 1.0 } else { -1.0 });
            let off = (motor - expected).abs();
            let at_point = points.iter().any(|p| (p - place).abs() < 1e-4) || !(-40.0..=62.0).contains(place);
            let kind = usize::from(!at_point);
            worst[kind] = worst[kind].max(off);
            // LinuxCNC evaluates the table while the axis moves, last a micrometre before the position.
            // Between points it interpolates linearly: the error is at most 4 µm·(2π/10)²·0.4²/8 mm².
            let allowed = 0.01 + if at_point { 0.0 } else { 0.0316 };
            assert!(off < allowed, "{unit}, type {joint}, {place} mm, up {up}: {motor} µm, model {expected}");
        }
        println!(
            "{unit}: {} readings, at most {:.5} µm off at points, {:.5} between",
            rows.len(),
            worst[0],
            worst[1]
        );
    }
}

/// Older tables began with a comment, at which LinuxCNC stops reading.
/// It then compensates nothing, and the test above would fail.
#[test]
fn a_planted_comment_leaves_linuxcnc_without_compensation() {
    if !test_needs::long() {
        return;
    }
    if !available() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("m.toml"), MACHINE).unwrap();
    export(dir.path(), "--from -40 --to 60 --out good.comp");
    let good = std::fs::read_to_string(dir.path().join("good.comp")).unwrap();
    let (head, tail) = good.split_at(good.find("\n0.0").map_or(good.len() / 2, |at| at + 1));
    std::fs::write(dir.path().join("type0.comp"), format!("# a comment\n{good}")).unwrap();
    export(dir.path(), "--from -40 --to 60 --format linuxcnc-type1 --out type1.comp");
    let rows = visited(dir.path(), "mm", &[5.0, 25.0]);
    for (place, joint, trim, _) in rows {
        let off = (trim + error_um(place, 1.0)).abs();
        assert!(if joint == 0 { trim == 0.0 && off > 5.0 } else { off < 0.6 }, "joint {joint}: {trim} µm");
    }
    // In the middle: the rest of the table is lost, and the last value before it applies.
    std::fs::write(dir.path().join("type0.comp"), format!("{head}; half way\n{tail}")).unwrap();
    std::fs::remove_file(dir.path().join("compensated")).unwrap();
    let rows = visited(dir.path(), "mm", &[35.0, 55.0]);
    let trims: Vec<f64> = rows.iter().filter(|r| r.1 == 0).map(|r| r.2).collect();
    assert!((trims[0] - trims[1]).abs() < 1e-3, "{trims:?}");
}
