//! Documents, tables and refusals of `part`.

use crate::parts::{drawing, json, part, taper};
use std::fmt::Write as _;

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

    // A missing tip radius is reported with its meaning; one that was given is not.
    for (tip, word) in [(None, true), (Some("0"), false), (Some("2.5"), false)] {
        let mut arguments = vec!["errors", "--points", "probed.csv", "--radius-mm", "38.1"];
        arguments.extend(tip.iter().flat_map(|t| ["--tip-mm", t]));
        let output = part(folder, &arguments);
        let said = |bytes: &[u8], what: &str| String::from_utf8_lossy(bytes).contains(what);
        assert_eq!(said(&output.stderr, "no --tip-mm: the points are taken as on the part's surface"), word);
        assert_eq!(said(&output.stdout, "taken as the part's surface"), tip != Some("2.5"), "{tip:?}");
    }

    // A false trip counts as an error of the part in error.cor, and is reported.
    let place = |k: usize| text.lines().nth(k).unwrap().to_owned();
    std::fs::write(folder.join("false.csv"), text.replace(&place(15), "20.71,35.80")).unwrap();
    let output = part(folder, &["errors", "--points", "false.csv", "--radius-mm", "38.1", "--tip-mm", "2.5"]);
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(stderr.contains("point 15 is") && stderr.contains("false trip"), "{stderr}");
    std::fs::remove_file(folder.join("false.csv")).unwrap();

    // Tables too large for any memory, and counts that no axis has.
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

/// A taper needs no radius, and gets whiskers, errors by position and a table.
/// An arc requested for it is refused.
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
    // The nose's centre is 0.8 mm outside the probed position.
    let (sin, cos) = (-20.0_f64).to_radians().sin_cos();
    let place = |key: &str| row["part_mm"][key].as_f64().unwrap();
    let off = 0.03 + 0.8;
    assert!((place("z") - (100.0 - 10.0 * cos - off * sin)).abs() < 1e-3, "{row}");
    assert!((place("x") - (30.0 - 10.0 * sin + off * cos)).abs() < 1e-3, "{row}");
    assert_eq!(std::fs::read_to_string(folder.join("t/g01.nc")).unwrap().lines().count(), 12);
    // Errors by position have no centre: refused before the daemon, which does not run, is asked.
    let load = |more: &str| {
        let line = format!("load --socket none --errors o/error.cor {more}");
        let output = part(folder, &line.split_whitespace().collect::<Vec<_>>());
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let (code, said) = load("--centre-z-mm 127 --radius-mm 38.1");
    assert!(code == Some(2) && said.contains("bring their places"), "{said}");
    assert_eq!(load("--nose-mm 0.8").0, Some(3));
    // Bowed by 8 µm over 55 mm: a circle of 47 m fits the points, but it is still a taper.
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
    // An arc's table needs its arc.
    std::fs::write(folder.join("arc.cor"), "0.0 -1.3\n0.1 2.5\n").unwrap();
    let output = part(folder, &["table", "--errors", "arc.cor", "--out", "no"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("--radius-mm"));
    // A file's name is not accepted for a folder.
    let output = part(folder, &["table", "--errors", "o/error.cor", "--out", "x.csv"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(!folder.join("x.csv").exists());
}

/// A constant error is not an error of form.
/// It is reported as left, or put into the table on request.
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
    // A stylus that points up is clear of the nose; one along −Z passes through it.
    assert_eq!(go("--stem 60,2,90").status.code(), Some(0));
    let through = go("--stem 60,2,180");
    assert_eq!(through.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&through.stdout).contains("the stylus meets"));
}

/// A program turned by what is advised cuts the nominal taper.
#[test]
fn the_advised_turn_of_a_taper_mends_it() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let cut = |program_deg: f64| {
        // The machine cuts 0.01° less than the program has.
        let slope = (program_deg - 0.01).to_radians().tan();
        let row = |k: i32| {
            let z = 5.0 * f64::from(k);
            format!("{z},{:.6}\n", 20.0 + slope * z + 2e-4 * f64::from(k % 3))
        };
        let rows: String = (0..12).map(row).collect();
        std::fs::write(folder.join("taper.csv"), format!("z_mm,x_mm\n{rows}")).unwrap();
        let line = "errors --points taper.csv --tip-mm 0 --taper-deg 0.3";
        let output = part(folder, &line.split_whitespace().collect::<Vec<_>>());
        String::from_utf8_lossy(&output.stdout).into_owned()
    };
    let said = cut(0.3);
    let turn = said.split_once("turn the program's taper by ").unwrap().1.split('°').next().unwrap();
    let mended = cut(0.3 + turn.parse::<f64>().unwrap());
    assert!(mended.contains("no turn of the program's taper is advised"), "{said}{mended}");
}
