//! `rtecctl part`: the contract of `part errors`, exit codes, and all steps one after the other through their files.
#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use serde_json::Value;
use std::fmt::Write as _;
use std::path::Path;
use std::process::{Command, Output};

fn part(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_rtecctl"))
        .arg("part")
        .args(arguments)
        .current_dir(folder)
        .env("SOURCE_DATE_EPOCH", "709171199")
        .output()
        .unwrap()
}

fn json(folder: &Path, arguments: &[&str]) -> Value {
    let output = part(folder, arguments);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{arguments:?}: {said}");
    serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{arguments:?}: {e}"))
}

/// A quarter of a nose about Z 127, in mm, as the plainest of drawings.
fn drawing(radius_mm: f64) -> String {
    format!(
        "0\nSECTION\n2\nHEADER\n9\n$ACADVER\n1\nAC1015\n9\n$INSUNITS\n70\n4\n0\nENDSEC\n0\nSECTION\n2\nENTITIES\n\
         0\nARC\n5\n2F\n8\n0\n10\n127.0\n20\n0.0\n30\n0.0\n40\n{radius_mm}\n50\n0.0\n51\n90.0\n0\nENDSEC\n0\nEOF\n"
    )
}

#[test]
fn part_errors_keeps_its_contract() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let mut text = String::from("z_mm,x_mm\n");
    for k in 0..20 {
        let angle = std::f64::consts::FRAC_PI_2 * f64::from(k) / 19.0;
        let r = 38.1 + 2.5 + if (4..8).contains(&k) { 0.02 } else { 0.0 };
        let _ = writeln!(text, "{:.6},{:.6}", 5.0 + r * angle.cos(), r * angle.sin());
    }
    std::fs::write(folder.join("probed.csv"), format!("\u{feff}{}", text.replace('\n', "\r\n"))).unwrap();
    let arguments = ["errors", "--points", "probed.csv", "--radius-mm", "38.1", "--tip-mm", "2.5", "--json"];
    let document = json(folder, &arguments);
    assert!((document["radius_mm"].as_f64().unwrap() - 38.1).abs() < 0.01, "{document}");
    assert!((document["centre_mm"][0].as_f64().unwrap() - 5.0).abs() < 0.01);
    assert!(document["sd_after_um"].as_f64().unwrap() < 0.5 * document["sd_before_um"].as_f64().unwrap());
    let rejected: Vec<u64> =
        document["rejected"].as_array().unwrap().iter().map(|v| v.as_u64().unwrap()).collect();
    assert!((4..8).all(|k| rejected.contains(&k)) && !rejected.contains(&0) && !rejected.contains(&19));
    let errors = document["errors"].as_array().unwrap();
    assert_eq!(errors.len(), 20);
    assert!((errors[5]["error_um"].as_f64().unwrap() - 20.0).abs() < 3.0 && errors[5]["angle_rad"].is_f64());
    assert_eq!(std::fs::read_dir(folder).unwrap().count(), 1, "no file unless --out names a place");
    assert_eq!(document["tip_mm"], 2.5);

    // A tip of no radius is said, and what it means; one that was asked for is no reason for a word more.
    for (tip, word) in [(None, true), (Some("0"), false), (Some("2.5"), false)] {
        let mut arguments = vec!["errors", "--points", "probed.csv", "--radius-mm", "38.1"];
        arguments.extend(tip.iter().flat_map(|t| ["--tip-mm", t]));
        let output = part(folder, &arguments);
        let said = |bytes: &[u8], what: &str| String::from_utf8_lossy(bytes).contains(what);
        assert_eq!(said(&output.stderr, "no --tip-mm: the points are taken as on the part's surface"), word);
        assert_eq!(said(&output.stdout, "taken as the part's surface"), tip != Some("2.5"), "{tip:?}");
    }

    // A false trip is the part's for error.cor: said.
    let place = |k: usize| text.lines().nth(k).unwrap().to_owned();
    std::fs::write(folder.join("false.csv"), text.replace(&place(15), "20.71,35.80")).unwrap();
    let output = part(folder, &["errors", "--points", "false.csv", "--radius-mm", "38.1", "--tip-mm", "2.5"]);
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(stderr.contains("point 14 is") && stderr.contains("false trip"), "{stderr}");
    std::fs::remove_file(folder.join("false.csv")).unwrap();

    // Tables that no memory holds, and counts that no axis has.
    std::fs::write(folder.join("e.cor"), "angle_rad,error_um\n0.1,1.0\n0.2,2.0\n").unwrap();
    for (option, value) in [
        ("--between", "18446744073709551615"),
        ("--between", "100000000"),
        ("--count-um", "1e-300"),
        ("--increment", "3"),
        ("--tool-z-mm", "1e300"),
        ("--nose-mm", "1e9"),
    ] {
        let line = [
            "table",
            "--errors",
            "e.cor",
            "--centre-z-mm",
            "5",
            "--radius-mm",
            "38",
            "--out",
            "o",
            option,
            value,
        ];
        let output = part(folder, &line);
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{option} {value}: {stderr}");
        assert!(stderr.contains(option), "{stderr}");
    }

    std::fs::write(folder.join("bad.csv"), "z_mm,x_mm\n1,2\n3,nan\n").unwrap();
    for (arguments, said) in [
        (vec!["errors", "--points", "bad.csv", "--radius-mm", "1", "--out", "o"], "bad.csv:3:3"),
        (vec!["errors", "--points", "none.csv", "--radius-mm", "1", "--out", "o"], "none.csv"),
        (vec!["errors", "--points", "probed.csv", "--radius-mm=-1", "--out", "o"], "--radius-mm"),
        (vec!["errors", "--points", "probed.csv", "--out", "o"], "--radius-mm"),
        (vec!["run", "--design", "z", "--out", "o"], "--design"),
        (vec!["run", "--bench", "bad.csv", "--out", "o"], "bad.csv:1"),
    ] {
        let output = part(folder, &arguments);
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {stderr}");
        assert!(stderr.contains(said), "{arguments:?}: {stderr}");
        assert!(output.stdout.is_empty() && !folder.join("o").exists());
    }
}

#[test]
fn a_table_is_checked_before_the_daemon_is_asked_and_no_daemon_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(folder.join("good.cor"), "0.0 -1.3\n0.1 2.5\n").unwrap();
    std::fs::write(folder.join("bad.cor"), "0.0 -1.3\n0.1 2.5\n0.1 2.5\n").unwrap();
    std::fs::write(folder.join("dxf.cor"), "0.0\n").unwrap();
    let load = "load --socket none --centre-z-mm 127";
    for (line, code, said) in [
        (format!("{load} --radius-mm 38.1 --errors none.cor"), 2, "none.cor: found No such file"),
        (format!("{load} --radius-mm 38.1 --errors bad.cor"), 2, "bad.cor:3:1: found angle 0.1 after"),
        (
            format!("{load} --radius-mm 38.1 --errors dxf.cor"),
            2,
            "dxf.cor:1:1: found '0.0', expected angle in rad",
        ),
        (format!("{load} --radius-mm 0 --errors good.cor"), 2, "--radius-mm: found 0"),
        (format!("{load} --radius-mm 38.1 --lead-ms 2000 --errors good.cor"), 2, "--lead-ms: found 2000"),
        (format!("{load} --radius-mm 38.1 --nose-mm=-1 --errors good.cor"), 2, "--nose-mm: found -1"),
        (format!("{load} --radius-mm 38.1"), 2, "--errors"),
        (format!("{load} --radius-mm 38.1 --errors good.cor"), 3, "none"),
        ("unload --socket none".to_owned(), 3, "none"),
        ("unload --json --socket none".to_owned(), 3, "none"),
    ] {
        let output = part(folder, &line.split_whitespace().collect::<Vec<_>>());
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(code), "{line}: {stderr}");
        assert!(stderr.contains(said), "{line}: {stderr}");
        assert!(output.stdout.is_empty());
    }
}

/// A taper of −20° with 8 µm too much at one of twelve points, 30 µm outside its drawing throughout.
fn taper(folder: &Path) {
    let (sin, cos) = (-20.0_f64).to_radians().sin_cos();
    let (mut text, mut expected) = (String::from("z_mm,x_mm\n"), String::new());
    for k in 0..12 {
        let (s, off) = (2.0 * f64::from(k), 0.03 + if k == 5 { 0.008 } else { 0.0 });
        let (z, x) = (100.0 - s * cos, 30.0 - s * sin);
        let _ = writeln!(text, "{:.6},{:.6}", z - off * sin, x + off * cos);
        let _ = writeln!(expected, "POINT touch {}, {z:.6}, {x:.6}, 0.000000", k + 1);
    }
    std::fs::write(folder.join("taper.csv"), text).unwrap();
    std::fs::write(folder.join("expected.cdl"), expected).unwrap();
}

/// A taper needs no radius, and gets whiskers, errors by place and a table; an arc asked of it is refused.
#[test]
fn a_straight_feature_is_recognised_and_gets_its_table() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    taper(folder);
    for asked in [&["--feature", "line"][..], &[]] {
        let mut arguments =
            vec!["errors", "--points", "taper.csv", "--taper-deg=-20", "--out", "o", "--json"];
        arguments.extend(asked);
        let document = json(folder, &arguments);
        assert_eq!(document["feature"], "line");
        assert!(document["inclination_error_deg"].as_f64().unwrap().abs() < 1e-3, "{document}");
        assert!((document["errors"][5]["error_um"].as_f64().unwrap() - 8.0).abs() < 0.01, "{document}");
    }
    for arguments in [
        &["errors", "--points", "taper.csv", "--radius-mm", "38.1", "--out", "no"][..],
        &["errors", "--points", "taper.csv", "--feature", "circle", "--radius-mm", "38.1", "--out", "no"],
        &["errors", "--points", "taper.csv", "--with-size", "--out", "no"],
    ] {
        let output = part(folder, arguments);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        assert!(said.contains("line") || said.contains("--expected"), "{said}");
        assert!(output.stdout.is_empty() && !folder.join("no").exists());
    }
    // The table: Z and X counts that together move the tool by the error along the normal at 20° to X.
    let line =
        "table --errors o/error.cor --nose-mm 0.8 --tool-z-mm 300 --between 0 --g01-um 1 --out t --json";
    let table = json(folder, &line.split_whitespace().collect::<Vec<_>>());
    let rows = table["rows"].as_array().unwrap();
    assert_eq!(rows.len(), 12);
    let row = &rows.iter().find(|r| r["error_um"].as_f64().unwrap() > 7.0).unwrap();
    let (z_um, x_um) = (8.0 * 20.0_f64.to_radians().sin(), 8.0 * 20.0_f64.to_radians().cos());
    let counts = |um: f64| 2 * (um / 2.0).round() as i64;
    assert_eq!((&row["requested"][0], &row["requested"][1]), (&counts(z_um).into(), &counts(x_um).into()));
    // The nose's centre is 0.8 mm outside the place that was probed.
    let (sin, cos) = (-20.0_f64).to_radians().sin_cos();
    let place = |key: &str| row["part_mm"][key].as_f64().unwrap();
    let off = 0.03 + 0.8;
    assert!((place("z") - (100.0 - 10.0 * cos - off * sin)).abs() < 1e-3, "{row}");
    assert!((place("x") - (30.0 - 10.0 * sin + off * cos)).abs() < 1e-3, "{row}");
    assert_eq!(std::fs::read_to_string(folder.join("t/g01.nc")).unwrap().lines().count(), 12);
    // What is by place has no centre: refused before the daemon is asked, which is not there.
    let load = |more: &str| {
        let line = format!("load --socket none --errors o/error.cor {more}");
        let output = part(folder, &line.split_whitespace().collect::<Vec<_>>());
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let (code, said) = load("--centre-z-mm 127 --radius-mm 38.1");
    assert!(code == Some(2) && said.contains("bring their places"), "{said}");
    assert_eq!(load("--nose-mm 0.8").0, Some(3));
    // Bowed by 8 µm over 55 mm: a circle of 47 m lies through the points, and it is a taper all the same.
    let bowed = (0..12).fold(String::from("z_mm,x_mm\n"), |mut text, k| {
        let s = 5.0 * f64::from(k);
        let off = 0.008 * (1.0 - (s / 27.5 - 1.0).powi(2));
        let _ = writeln!(text, "{:.5},{:.5}", 20.0 + s * cos + off * sin, 10.0 - s * sin + off * cos);
        text
    });
    std::fs::write(folder.join("bowed.csv"), bowed).unwrap();
    let document = json(folder, &["errors", "--points", "bowed.csv", "--json"]);
    assert_eq!(document["feature"], "line");
    let bow = document["errors"].as_array().unwrap().iter().map(|e| e["error_um"].as_f64().unwrap());
    let (low, high) = bow.fold((f64::MAX, f64::MIN), |(l, h), e| (l.min(e), h.max(e)));
    assert!((high - low - 7.93).abs() < 0.05, "{low} to {high}: 8 µm less what no point is at");
    // An arc's table wants its arc.
    std::fs::write(folder.join("arc.cor"), "0.0 -1.3\n0.1 2.5\n").unwrap();
    let output = part(folder, &["table", "--errors", "arc.cor", "--out", "no"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("--radius-mm"));
    // A file's name is no folder.
    let output = part(folder, &["table", "--errors", "o/error.cor", "--out", "x.csv"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(!folder.join("x.csv").exists());
}

/// What is constant is no form: it is said to be left, or put into the table on request.
#[test]
fn a_constant_error_is_said_to_be_left_or_taken_out() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    taper(folder);
    let first = |file: &str| -> f64 {
        let text = std::fs::read_to_string(folder.join(file)).unwrap();
        text.lines().next().unwrap().split(' ').nth(1).unwrap().parse().unwrap()
    };
    let errors = "errors --points taper.csv --expected expected.cdl";
    let run = |more: &str| part(folder, &format!("{errors} {more}").split_whitespace().collect::<Vec<_>>());
    let plain = run("--out plain");
    assert!(plain.status.success(), "{}", String::from_utf8_lossy(&plain.stderr));
    let said = String::from_utf8_lossy(&plain.stdout).into_owned();
    assert!(said.contains("size            +30.0 µm constant, left by error.cor"), "{said}");
    assert!(run("--with-size --out sized").status.success());
    assert!((first("sized/error.cor") - first("plain/error.cor") - 30.0).abs() < 0.01);
}

#[test]
fn numbers_of_a_probe_that_cannot_be_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(folder.join("nose.dxf"), drawing(38.1)).unwrap();
    let go = |more: &str| {
        let line = format!("points nose.dxf --feature F1:5 --tip-mm 2.5 --out o {more}");
        part(folder, &line.split_whitespace().collect::<Vec<_>>())
    };
    for (more, said) in [
        ("--margin-mm=-1", "--margin-mm: found -1"),
        ("--margin-mm=NaN", "--margin-mm: found NaN"),
        (
            "--margin-mm 30",
            "found 30 at each end of F1, expected less than half of its 59.8473 mm, below 29.9237",
        ),
        ("--stem 60,2", "--stem: found 60,2, expected LENGTH,RADIUS,DEG"),
        ("--stem 60,0,90", "--stem: found 60,0,90"),
        ("--bypass=-1", "--bypass: found -1"),
        ("--points nose.dxf --off-mm 0", "--off-mm: found 0"),
    ] {
        let output = go(more);
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(2) && stderr.contains(said), "{more}: {stderr}");
        assert!(!folder.join("o").exists());
    }
    assert_eq!(go("--margin-mm 29").status.code(), Some(0));
    std::fs::write(folder.join("xz.csv"), "z_mm,x_mm\n38.1,127.0\n").unwrap();
    let output = go("--points xz.csv");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.code() == Some(2) && said.contains("with z_mm and x_mm exchanged it is"), "{said}");
    // A stylus that stands up is clear of the nose, one along −Z runs through it.
    assert_eq!(go("--stem 60,2,90").status.code(), Some(0));
    let through = go("--stem 60,2,180");
    assert_eq!(through.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&through.stdout).contains("the stylus meets"));
}

/// LinuxCNC's interpreter reads the G01 moves; where they run it must be within 1.5 µm of the corrected arc.
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
    // The part is not where the plan for another says: the first point is named.
    let output = part(
        folder,
        &"probe --workpiece final/workpiece.csv --path semi/pathfin.cdl --expected semi/probpath.cdl --trip-window-mm 0.1 --out x"
            .split_whitespace()
            .collect::<Vec<_>>(),
    );
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("point 1: tripped 0.2"), "{output:?}");
}

/// A server that answers as LinuxCNC's `linuxcncrsh` does: echo until it is told not to, acknowledgements in verbose mode.
fn linuxcncrsh(opens: bool) -> (std::net::SocketAddr, std::thread::JoinHandle<Vec<String>>) {
    use std::io::{BufRead as _, Write as _};
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let server = std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let mut heard = Vec::new();
        let (mut echo, mut verbose, mut open) = (true, false, "none".to_owned());
        for line in std::io::BufReader::new(stream.try_clone().unwrap()).lines() {
            let Ok(line) = line else { break };
            let line = line.trim().to_owned();
            let words: Vec<&str> = line.split(' ').collect();
            let mut say = |text: String| stream.write_all((text + "\r\n").as_bytes()).unwrap();
            if echo {
                say(line.clone());
            }
            match words[..] {
                ["hello", "EMC", ..] => say("HELLO ACK EMCNETSVR 1.1".into()),
                ["hello", ..] => say("HELLO NAK".into()),
                ["set", "echo", "off"] => echo = false,
                ["set", "open", _] if !opens => say("SET OPEN NAK".into()),
                ["set", what, value] => {
                    verbose |= what == "verbose";
                    if what == "open" {
                        value.clone_into(&mut open);
                    }
                    if verbose {
                        say(format!("SET {} ACK", what.to_uppercase()));
                    }
                }
                ["get", "program"] => say(format!("PROGRAM {open}")),
                ["quit"] => break,
                _ => {}
            }
            heard.push(line);
        }
        heard
    });
    (address, server)
}

/// NISTIR 4854, Operating Procedure: the program is down-loaded to the MTC; here over LinuxCNC's own network interface.
#[test]
fn the_program_is_opened_in_linuxcnc() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(folder.join("nose.dxf"), drawing(38.1)).unwrap();
    std::fs::create_dir(folder.join("nc_files")).unwrap();
    json(folder, &["points", "nose.dxf", "--feature", "F1:5", "--tip-mm", "2.5", "--out", "o", "--json"]);
    let program = |more: &str| {
        let line = format!("program --path o/pathfin.cdl --dialect linuxcnc --set part=6304 --out o {more}");
        part(folder, &line.split_whitespace().collect::<Vec<_>>())
    };
    let (address, server) = linuxcncrsh(true);
    let done = program(&format!("--program-folder nc_files --folder-there /nc --download {address}"));
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let heard = server.join().unwrap();
    let place = heard.iter().position(|l| l == "set open /nc/pt6304s2.dnc").unwrap();
    assert!(
        heard[..place].contains(&"set enable EMCTOO".to_owned()) && heard.contains(&"get program".to_owned())
    );
    let text = |at: &str| std::fs::read_to_string(folder.join(at)).unwrap();
    assert_eq!(text("nc_files/pt6304s2.dnc"), text("o/pt6304s2.dnc"));
    // Refused, let in by another password, nobody there, no folder.
    let (address, server) = linuxcncrsh(false);
    let refused = program(&format!("--program-folder nc_files --download {address}"));
    assert_eq!(refused.status.code(), Some(1), "{}", String::from_utf8_lossy(&refused.stderr));
    drop(server);
    let (address, server) = linuxcncrsh(true);
    let other = program(&format!("--program-folder nc_files --download {address} --passwords x,y"));
    assert_eq!(other.status.code(), Some(1));
    drop(server);
    let nobody = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    assert_eq!(program(&format!("--program-folder nc_files --download {nobody}")).status.code(), Some(3));
    assert_eq!(program("--program-folder none").status.code(), Some(2));
    assert_eq!(program("--download x").status.code(), Some(2));
}

/// One request by hand: the status line, and what follows.
fn http(address: &str, request: &str) -> String {
    let mut stream = std::net::TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(std::time::Duration::from_secs(30))).unwrap();
    std::io::Write::write_all(&mut stream, request.as_bytes()).unwrap();
    let mut answer = String::new();
    std::io::Read::read_to_string(&mut stream, &mut answer).unwrap();
    answer
}

#[test]
fn the_page_is_for_whoever_started_it_and_nobody_holds_it_up() {
    use std::io::{BufRead, Write};
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("nose.dxf"), drawing(38.1)).unwrap();
    let mut page = Command::new(env!("CARGO_BIN_EXE_rtecctl"))
        .args(["part", "points", "nose.dxf", "--feature", "F1:5", "--tip-mm", "2.5", "--web", "--out", "out"])
        .current_dir(folder.path())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    std::io::BufReader::new(page.stderr.take().unwrap()).read_line(&mut line).unwrap();
    let url = line.split_whitespace().find(|w| w.starts_with("http://")).unwrap_or_else(|| panic!("{line}"));
    let (address, secret) = url.strip_prefix("http://").unwrap().split_once('/').unwrap();
    let secret = secret.trim_end_matches('/');
    assert!(secret.len() == 32 && secret.chars().all(|c| c.is_ascii_hexdigit()), "{url}");
    let post = |path: &str, body: &str| {
        let length = body.len();
        let head = format!(
            "POST {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\nContent-Length: {length}"
        );
        http(address, &format!("{head}\r\n\r\n{body}"))
    };
    // Another user of this machine finds the port, and no more.
    for path in ["/remove", "/00000000000000000000000000000000/remove", "/save", "/done", "/"] {
        let answer = post(path, "{\"index\":0}");
        assert!(answer.starts_with("HTTP/1.1 403"), "{path}: {answer}");
    }
    // Nor does he hold it up, however slow his request is and however long he says that it will be.
    let strangers: Vec<_> = [3_000_000_u64, 1_000_000_000_000_000]
        .into_iter()
        .flat_map(|length| [format!("{length}"), format!("{length}\r\nExpect: 100-continue")])
        .map(|length| {
            let mut stranger = std::net::TcpStream::connect(address).unwrap();
            let head = format!("POST /add HTTP/1.1\r\nHost: {address}\r\nContent-Length: {length}\r\n\r\n{{");
            stranger.write_all(head.as_bytes()).unwrap();
            stranger
        })
        .collect();
    // One that never finishes its request holds up no other.
    let mut slow = std::net::TcpStream::connect(address).unwrap();
    let head = format!("POST /{secret}/add HTTP/1.1\r\nHost: {address}\r\nContent-Length: 3000\r\n\r\n{{");
    slow.write_all(head.as_bytes()).unwrap();
    let answer = post(&format!("/{secret}/remove"), "{\"index\":0}");
    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
    let plan: Value = serde_json::from_str(answer.split("\r\n\r\n").nth(1).unwrap()).unwrap();
    assert_eq!(plan["points"].as_array().unwrap().len(), 4);
    let answer = post(&format!("/{secret}/done"), "{}");
    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
    assert_eq!(page.wait().unwrap().code(), Some(0));
    drop(strangers);
}

/// A diameter for a radius, and the tip's diameter for its radius: the commonest slips, both said.
#[test]
fn a_diameter_for_a_radius_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path();
    let points = (0..20).fold("z_mm,x_mm\n".to_owned(), |text, k| {
        let a = std::f64::consts::FRAC_PI_2 * f64::from(k) / 19.0;
        text + &format!("{:.6},{:.6}\n", 127.0 + 40.854 * a.cos(), 40.854 * a.sin())
    });
    std::fs::write(folder.join("p.csv"), points).unwrap();
    let run = |words: &[&str]| {
        let out = part(folder, &[&["errors", "--points", "p.csv"], words].concat());
        (out.status.code(), String::from_utf8(out.stderr).unwrap())
    };
    let (code, said) = run(&["--radius-mm", "76.708", "--tip-mm", "2.5"]);
    assert!(code == Some(2) && said.contains("diameter"), "{code:?} {said}");
    let (code, said) = run(&["--radius-mm", "38.354", "--tip-mm", "5"]);
    assert!(code == Some(0) && said.contains("half of --tip-mm"), "{code:?} {said}");
    let (code, said) = run(&["--radius-mm", "40.854", "--tip-mm", "2.5"]);
    assert!(code == Some(0) && said.contains("as much as --tip-mm"), "{code:?} {said}");
    let (code, said) = run(&["--radius-mm", "38.354", "--tip-mm", "5", "--with-size", "--out", "o"]);
    assert!(code == Some(2) && said.contains("--with-size") && !folder.join("o").exists(), "{code:?} {said}");
    let (code, said) = run(&["--radius-mm", "38.354", "--tip-mm", "2.5"]);
    assert!(code == Some(0) && said.is_empty(), "{code:?} {said}");
}

/// A part 50 µm too large, of good form, is not accepted.
#[test]
fn a_part_of_the_wrong_size_is_not_accepted() {
    let dir = tempfile::tempdir().unwrap();
    let points = |radius_mm: f64| {
        (0..20).fold("z_mm,x_mm\n".to_owned(), |text, k| {
            let a = std::f64::consts::FRAC_PI_2 * f64::from(k) / 19.0;
            let r = radius_mm + 2.5;
            text + &format!("{:.6},{:.6}\n", 127.0 + r * a.cos(), r * a.sin())
        })
    };
    std::fs::write(dir.path().join("before.csv"), points(38.354)).unwrap();
    for (radius_mm, code) in [(38.15, 1), (38.1, 0)] {
        std::fs::write(dir.path().join("after.csv"), points(radius_mm)).unwrap();
        let words = "inspect --before before.csv --after after.csv --before-radius-mm 38.354 --radius-mm 38.1 --tip-mm 2.5 --limit-um 2";
        let out = part(dir.path(), &words.split(' ').collect::<Vec<_>>());
        let text = String::from_utf8(out.stdout).unwrap();
        assert_eq!(out.status.code(), Some(code), "{text}");
        assert!(text.contains("farthest from nominal"), "{text}");
        assert!(out.stderr.is_empty() || code == 1);
        let bare = words.replace("--tip-mm 2.5 ", "");
        let out = part(dir.path(), &bare.split(' ').collect::<Vec<_>>());
        assert!(String::from_utf8_lossy(&out.stderr).contains("no --tip-mm"));
    }
}

/// A bump draws the size to itself: both together are less than it. And what was not probed again is not accepted.
#[test]
fn a_bump_that_the_size_hides_is_not_accepted() {
    let dir = tempfile::tempdir().unwrap();
    let points = |from: f64, to: f64, bump_um: f64| {
        (0..40).fold("z_mm,x_mm\n".to_owned(), |text, k| {
            let a = from + (to - from) * f64::from(k) / 39.0;
            let r = 38.0 + 2.5 + 1e-3 * bump_um * (-((a - 0.8) / 0.12_f64).powi(2)).exp();
            text + &format!("{:.6},{:.6}\n", r * a.cos(), r * a.sin())
        })
    };
    let words = "inspect --before before.csv --after after.csv --before-radius-mm 38 --radius-mm 38 --tip-mm 2.5 --limit-um 5";
    let run = |after: String| {
        std::fs::write(dir.path().join("after.csv"), after).unwrap();
        let out = part(dir.path(), &words.split(' ').collect::<Vec<_>>());
        (
            out.status.code(),
            format!("{}{}", String::from_utf8_lossy(&out.stdout), String::from_utf8_lossy(&out.stderr)),
        )
    };
    std::fs::write(dir.path().join("before.csv"), points(0.05, 1.5, 17.0)).unwrap();
    let (code, said) = run(points(0.05, 1.5, 8.0));
    assert!(code == Some(1) && said.contains("not kept"), "{code:?} {said}");
    let (code, said) = run(points(0.05, 1.5, 1.0));
    assert!(code == Some(0), "{code:?} {said}");
    let (code, said) = run(points(1.1, 1.5, 1.0));
    assert!(code == Some(2) && said.contains("before from 0.05 to 1.50 rad"), "{code:?} {said}");
}

/// Points without directions: of a face the probe's path says the side, or nothing does; of a cylinder it is said what is
/// assumed.
#[test]
fn the_side_of_a_straight_feature_comes_from_the_path() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path();
    let mut path = String::new();
    for k in 0..12 {
        let (x, n) = (10.0 + 2.0 * f64::from(k), k + 1);
        let _ = writeln!(
            path,
            "POINT start 12.5, {x}, 0\nPOINT touch {n}, 5.0, {x}, 0\nPOINT finish 12.5, {x}, 0"
        );
    }
    std::fs::write(folder.join("pathfin.cdl"), path).unwrap();
    let write = |name: &str, place: &dyn Fn(f64, f64) -> [f64; 2]| {
        let text = (0..12).fold("z_mm,x_mm\n".to_owned(), |text, k| {
            let off = 0.03 + if (4..7).contains(&k) { 0.012 } else { 0.0 };
            let [z, x] = place(10.0 + 2.0 * f64::from(k), off);
            text + &format!("{z:.7},{x:.7}\n")
        });
        std::fs::write(folder.join(name), text).unwrap();
    };
    for tilt in [1e-5, -1e-5] {
        write("face.csv", &|s, off| [7.5 + off + tilt * (s - 21.0), s]);
        let errors = ["errors", "--points", "face.csv", "--tip-mm", "2.5", "--json"];
        let out = part(folder, &errors);
        let said = String::from_utf8_lossy(&out.stderr).into_owned();
        assert!(out.status.code() == Some(2) && said.contains("--path PATHFIN.CDL"), "{said}");
        let document = json(folder, &[&errors[..], &["--path", "pathfin.cdl"]].concat());
        assert!(
            (document["errors"][5]["error_um"].as_f64().unwrap() - 12.0).abs() < 0.1,
            "{tilt}: {document}"
        );
        assert!((document["centre_mm"][0].as_f64().unwrap() - 5.03).abs() < 1e-3, "{tilt}: {document}");
        // The path of the other side, and of another face.
        for (start, end) in [("-2.5", "5.0"), ("112.5", "105.0")] {
            let path = std::fs::read_to_string(folder.join("pathfin.cdl")).unwrap();
            let other = path.replace("12.5,", &format!("{start},")).replace(" 5.0,", &format!(" {end},"));
            std::fs::write(folder.join("other.cdl"), other).unwrap();
            let out = part(folder, &[&errors[..], &["--path", "other.cdl"]].concat());
            let said = String::from_utf8_lossy(&out.stderr).into_owned();
            assert!(out.status.code() == Some(2) && said.contains("the way of its touch"), "{said}");
        }
    }
    write("cylinder.csv", &|s, off| [s, 22.5 + off]);
    let out = part(folder, &["errors", "--points", "cylinder.csv", "--tip-mm", "2.5"]);
    let said = String::from_utf8_lossy(&out.stderr).into_owned();
    assert!(out.status.success() && said.contains("taken as touched from outside"), "{said}");
}

/// `offer.cor` is one feature's table.
#[test]
fn changes_of_two_features_make_no_offer() {
    let dir = tempfile::tempdir().unwrap();
    let batch = (0..5).fold("part,feature,angle_rad,error_um\n".to_owned(), |text, p| {
        let e = 8.0 + 0.1 * f64::from(p);
        text + &format!("{p},nose,0.3,{e}\n{p},fillet,0.3,-{e}\n")
    });
    std::fs::write(dir.path().join("batch.csv"), batch).unwrap();
    let out = part(dir.path(), &["post-process", "--batch", "batch.csv", "--out", "o"]);
    let said = String::from_utf8_lossy(&out.stderr).into_owned();
    assert!(out.status.code() == Some(2) && said.contains("changes of fillet and of nose"), "{said}");
    assert!(!dir.path().join("o").exists());
    let document = json(dir.path(), &["post-process", "--batch", "batch.csv", "--json"]);
    assert_eq!(document["offer_table"][0]["feature"], "fillet", "{document}");
}

/// What a model reads and nobody gave is not taken as zero in silence.
#[test]
fn a_model_without_the_machines_place_or_direction_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path();
    let points = (0..20).fold("z_mm,x_mm\n".to_owned(), |text, k| {
        let a = std::f64::consts::FRAC_PI_2 * f64::from(k) / 19.0;
        text + &format!("{:.6},{:.6}\n", 127.0 + 40.6 * a.cos(), 40.6 * a.sin())
    });
    std::fs::write(folder.join("p.csv"), points).unwrap();
    let model = "name = \"m\"\n[[effect]]\nname = \"scale.z\"\nppm = 40.0\n[[effect]]\nname = \"reversal.x\"\num = 4.0\n";
    std::fs::write(folder.join("m.toml"), model).unwrap();
    std::fs::write(folder.join("flat.toml"), "name = \"m\"\n[[effect]]\nname = \"offset.z\"\num = 4.0\n")
        .unwrap();
    let run = |more: &str| {
        let line = format!("errors --points p.csv --radius-mm 38.1 --tip-mm 2.5 {more}");
        let out = part(folder, &line.split_whitespace().collect::<Vec<_>>());
        (out.status.code(), String::from_utf8(out.stderr).unwrap())
    };
    let (code, said) = run("--machine m.toml");
    assert!(code == Some(0) && said.contains("no --origin-mm") && said.contains("scale.z reads"), "{said}");
    assert!(said.contains("warning: reversal.x of the model"), "{said}");
    let (code, said) = run("--machine m.toml --origin-mm 300,0");
    assert!(code == Some(0) && !said.contains("--origin-mm") && said.contains("reversal.x"), "{said}");
    assert_eq!(run("--machine flat.toml"), (Some(0), String::new()));
    let (code, said) = run("--machine m.toml --origin-mm 300");
    assert!(code == Some(2) && said.contains("--origin-mm: found 300, expected Z,X"), "{said}");
}

/// A drawing in inches that is read as millimetres on request: said; the same unit twice is no reason for a word.
#[test]
fn a_unit_other_than_the_headers_is_said() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("inch.dxf"), drawing(38.1).replace("70\n4\n", "70\n1\n")).unwrap();
    let said = |units: &[&str]| {
        let out = part(dir.path(), &[&["features", "inch.dxf"], units].concat());
        assert!(out.status.success());
        String::from_utf8(out.stderr).unwrap()
    };
    let over = said(&["--units", "mm"]);
    assert!(over.contains("says 1 unit = 25.4 mm, --units says 1 mm") && over.lines().count() == 1, "{over}");
    assert_eq!(said(&["--units", "inch"]) + &said(&[]), "");
    // The path is in the drawing's inches, or in mm: 127 + 38.1 + 2.5 mm at the first point.
    let first = |dxf: &str, units: &str| {
        let out = part(
            dir.path(),
            &["points", dxf, "--units", units, "--feature", "F1:5", "--tip-mm", "2.5", "--out", "o"],
        );
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        let path = std::fs::read_to_string(dir.path().join("o/probpath.cdl")).unwrap();
        let z: f64 = path.split([' ', ',']).nth(4).unwrap().parse().unwrap();
        (z, String::from_utf8_lossy(&out.stderr).contains("--path-units inch"))
    };
    let cm = drawing(3.81).replace("70\n4\n", "70\n5\n").replace("127.0", "12.7");
    std::fs::write(dir.path().join("cm.dxf"), cm).unwrap();
    let inch = drawing(1.5).replace("70\n4\n", "70\n1\n").replace("127.0", "5.0");
    std::fs::write(dir.path().join("in.dxf"), inch).unwrap();
    assert_eq!(first("inch.dxf", "mm"), (167.6, false));
    let (z, said) = first("in.dxf", "inch");
    assert!((z - 167.6 / 25.4).abs() < 1e-5 && said, "{z}");
    let out = part(dir.path(), &["points", "cm.dxf", "--feature", "F1:5", "--tip-mm", "2.5", "--out", "o"]);
    assert!(out.status.success());
    let path = std::fs::read_to_string(dir.path().join("o/probpath.cdl")).unwrap();
    assert!(path.starts_with("POINT touch 1, 167.600000, 0.000000"), "{path}");
}

/// In a hollow arc the tool's nose runs inside: on 5 mm less 0.8 mm about the centre, and it stays off the surface that
/// it cuts by its own radius.
#[test]
fn the_nose_runs_inside_a_hollow_arc() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path();
    let points = (0..12).fold("z_mm,x_mm,approach_z,approach_x\n".to_owned(), |text, k| {
        let (sin, cos) = (185.0 + 80.0 * f64::from(k) / 11.0_f64).to_radians().sin_cos();
        let off = if k == 6 { 0.004 } else { 0.0 };
        text + &format!("{:.6},{:.6},{cos:.5},{sin:.5}\n", 50.0 + (4.0 + off) * cos, 30.0 + (4.0 + off) * sin)
    });
    std::fs::write(folder.join("fillet.csv"), points).unwrap();
    let line = "errors --points fillet.csv --radius-mm 5 --tip-mm 1 --out o";
    let out = part(folder, &line.split(' ').collect::<Vec<_>>());
    assert!(String::from_utf8_lossy(&out.stderr).contains("part table wants --hollow"));
    let table = |more: &str| {
        let line = "table --errors o/error.cor --centre-z-mm 50 --centre-x-mm 30 --radius-mm 5 --g01-um 1 --out t --json";
        let line = format!("{line} --nose-mm {more}");
        part(folder, &line.split(' ').collect::<Vec<_>>())
    };
    let inside = table("0.8 --hollow");
    assert!(inside.status.success(), "{}", String::from_utf8_lossy(&inside.stderr));
    let document: Value = serde_json::from_slice(&inside.stdout).unwrap();
    for row in document["rows"].as_array().unwrap() {
        let at = |key: &str| row["part_mm"][key].as_f64().unwrap();
        let (z, x) = (at("z") - 50.0, at("x") - 30.0);
        assert!((z.hypot(x) - 4.2).abs() < 1e-6 && z < 0.0 && x < 0.0, "{row}");
    }
    // The moves are nearer to the centre where the fillet is cut too deep.
    let moves = std::fs::read_to_string(folder.join("t/g01.nc")).unwrap();
    for line in moves.lines() {
        let at = |c: char| line.split(c).nth(1).unwrap().split(' ').next().unwrap().parse::<f64>().unwrap();
        let r = (at('Z') - 50.0).hypot(at('X') - 30.0);
        assert!((4.194..4.203).contains(&r), "{line}: {r}");
    }
    assert_eq!(table("5 --hollow").status.code(), Some(2));
}

/// A taper of the other sign, a whole angle, an angle to the face: said.
#[test]
fn another_taper_is_said() {
    let dir = tempfile::tempdir().unwrap();
    taper(dir.path());
    let said = |deg: &str| {
        let out = part(
            dir.path(),
            &["errors", "--points", "taper.csv", "--tip-mm", "0", &format!("--taper-deg={deg}")],
        );
        assert!(out.status.success());
        String::from_utf8(out.stderr).unwrap()
    };
    for (deg, hint) in
        [("20", "other sign"), ("-40", "whole angle"), ("-70", "to the face"), ("5", "order of z_mm")]
    {
        assert!(said(deg).contains(hint), "{deg}: {}", said(deg));
    }
    assert!(!said("-20.5").contains("from --taper-deg"));
}
