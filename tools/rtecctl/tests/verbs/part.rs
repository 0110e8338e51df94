//! `rtecctl part`: the contract of `part errors`, exit codes, and all steps one after the other through their files.

use serde_json::Value;
use std::fmt::Write as _;
use std::path::Path;
use std::process::Command;

use crate::parts::{drawing, json, part, taper};

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
    assert!(stderr.contains("point 15 is") && stderr.contains("false trip"), "{stderr}");
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
