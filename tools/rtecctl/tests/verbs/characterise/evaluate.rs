//! `characterise evaluate`: figures, pages and warnings.

use super::{Noise, ballbar, rtecctl, said, tilt, write};
use std::path::{Path, PathBuf};
use std::process::Command;

fn positioning(folder: &Path, name: &str, length_mm: f64, way: impl Fn(f64) -> f64) {
    let mut noise = Noise(4);
    let mut rows = Vec::new();
    for _ in 0..5 {
        for up in [1.0, -1.0] {
            for k in 0..11 {
                let k = f64::from(if up > 0.0 { k } else { 10 - k });
                let p = length_mm * (k + 0.07 * ((3.0 * k) % 5.0)) / 10.3;
                let e = 0.012 * p + 3.0 * (p / 60.0).sin() + 2.5 * up + 1.5 * noise.next();
                rows.push(vec![p, way(up), e, 21.0 + 0.2 * noise.next()]);
            }
        }
    }
    let columns = [
        ("y", "position.y", "mm"),
        ("dir", "direction.y", "1"),
        ("e", "error.y", "um"),
        ("T3", "temperature", "degC"),
    ];
    write(folder, name, "kind = \"positioning\"\ndate = \"2026-05-01\"", &columns, &rows);
}

fn drift(folder: &Path) {
    let mut noise = Noise(6);
    let rows = (0..420).map(|m| {
        let m = f64::from(m);
        let rpm = if (60.0..240.0).contains(&m) && m % 45.0 > 4.0 { 4000.0 } else { 0.0 };
        let heat = if m < 60.0 {
            0.0
        } else if m < 240.0 {
            1.0 - ((60.0 - m) / 50.0).exp()
        } else {
            (1.0 - (-3.6_f64).exp()) * ((240.0 - m) / 70.0).exp()
        };
        let room = 0.4 * (m / 60.0).sin();
        vec![
            60.0 * m,
            rpm,
            20.0 + room,
            20.0 + room + 9.0 * heat,
            28.0 * heat + room + 0.3 * noise.next(),
            -6.0 * heat + 0.3 * noise.next(),
        ]
    });
    let columns = [
        ("t", "time", "s"),
        ("rpm", "spindle_speed", "rpm"),
        ("air", "temperature", "degC"),
        ("bearing", "temperature", "degC"),
        ("z", "error.z", "um"),
        ("y", "error.y", "um"),
    ];
    write(folder, "drift", "kind = \"drift\"", &columns, &rows.collect::<Vec<_>>());
}

fn plate(folder: &Path) {
    let mut noise = Noise(7);
    let mut rows = Vec::new();
    for i in 0..6 {
        for j in 0..6 {
            let (x, y) = (f64::from(i) * 40.0 - 100.0, f64::from(j) * 40.0 - 100.0);
            rows.push(vec![
                x,
                y,
                0.03 * x - 0.05 * y + 4.0 * noise.next(),
                0.05 * x - 0.01 * y + 4.0 * noise.next(),
            ]);
        }
    }
    let columns = [
        ("x", "position.x", "mm"),
        ("y", "position.y", "mm"),
        ("ex", "error.x", "um"),
        ("ey", "error.y", "um"),
    ];
    write(folder, "plate", "kind = \"plate\"", &columns, &rows);
}

fn diagonals(folder: &Path) {
    let size = [400.0, 300.0, 350.0];
    let d = size.iter().map(|s| s * s).sum::<f64>().sqrt();
    for (n, signs) in
        [[1.0, 1.0, 1.0], [-1.0, 1.0, 1.0], [1.0, -1.0, 1.0], [-1.0, -1.0, 1.0]].iter().enumerate()
    {
        let mut noise = Noise(n as u64 + 10);
        let mut rows = Vec::new();
        for _ in 0..5 {
            for way in [1.0, -1.0] {
                for k in 0..9 {
                    let k = f64::from(if way > 0.0 { k } else { 8 - k });
                    let s = (k + 0.05 * ((3.0 * k) % 5.0)) / 8.2;
                    let at = |i: usize| size[i] * if signs[i] > 0.0 { s } else { 1.0 - s };
                    let along = (25e-3 * at(1) * signs[0] * size[0] + 12e-3 * at(0) * signs[0] * size[0]) / d;
                    rows.push(vec![at(0), at(1), at(2), way, along + 1.5 * way + noise.next()]);
                }
            }
        }
        let columns = [
            ("x", "position.x", "mm"),
            ("y", "position.y", "mm"),
            ("z", "position.z", "mm"),
            ("dir", "direction.d", "1"),
            ("e", "error.d", "um"),
        ];
        write(folder, &format!("d{n}"), "kind = \"positioning\"", &columns, &rows);
    }
}

/// Both diagonals of the face x y, 500 mm long: 18 µrad off square, 6 ppm too long.
fn faces(folder: &Path) {
    for (n, sign) in [1.0, -1.0].iter().enumerate() {
        let mut noise = Noise(n as u64 + 20);
        let mut rows = Vec::new();
        for _ in 0..3 {
            for way in [1.0, -1.0] {
                for k in 0..9 {
                    let s = f64::from(if way > 0.0 { k } else { 8 - k }) / 8.0;
                    let (x, y) = (400.0 * if *sign > 0.0 { s } else { 1.0 - s }, 300.0 * s);
                    let along = 6e-3 * 500.0 * s + 18e-3 * y * sign * 400.0 / 500.0;
                    rows.push(vec![x, y, way, along + 0.8 * way + noise.next()]);
                }
            }
        }
        let columns = [
            ("x", "position.x", "mm"),
            ("y", "position.y", "mm"),
            ("dir", "direction.d", "1"),
            ("e", "error.d", "um"),
        ];
        write(folder, &format!("f{n}"), "kind = \"positioning\"", &columns, &rows);
    }
}

/// Conditions of which only half is used are reported.
/// Here a workpiece is reduced to 20 °C but its scale is not, and a tilt has conditions of lengths.
#[test]
fn conditions_of_which_half_is_used_are_said() {
    let dir = tempfile::tempdir().unwrap();
    positioning(dir.path(), "y", 800.0, |w| w);
    tilt(dir.path());
    let said = |record: &str, thermal: &str| {
        let text = format!("[thermal]\n{thermal}\n[uncertainty]\ndevice_um_per_m = 0.8\n");
        std::fs::write(dir.path().join("c.toml"), text).unwrap();
        let (code, _, err) = said(&rtecctl(dir.path(), &["evaluate", record, "--conditions", "c.toml"]));
        assert_eq!(code, Some(0), "{err}");
        err
    };
    let [scale, workpiece] =
        ["scale", "workpiece"].map(|b| format!("{b} = {{ sensor = \"T3\", ppm_per_K = 8.5 }}"));
    assert!(said("y.run.toml", &workpiece).contains("the scale is taken to be at 20 °C"));
    for thermal in [scale.clone(), format!("{scale}\n{workpiece}")] {
        assert!(!said("y.run.toml", &thermal).contains("taken to be"), "{thermal}");
    }
    assert!(
        said("tilt.run.toml", &scale)
            .contains("does not use [thermal]: nothing is reduced to 20 °C, [uncertainty]")
    );
}

/// A dead path counts by its length times the change of the air's index.
/// The air is known to the instrument at the zero, so nothing else is corrected. The indices are those of NIST's table for dry air.
#[test]
fn a_dead_path_counts_by_the_change_of_the_index() {
    let dir = tempfile::tempdir().unwrap();
    let (cold, warm) = ((5.0, 1.000_282_750), (50.0, 1.000_243_270));
    let mut rows = Vec::new();
    for (cycle, degc) in [cold.0, warm.0].into_iter().enumerate() {
        for up in [1.0, -1.0] {
            for k in 0..11 {
                let k = f64::from(if up > 0.0 { k } else { 10 - k });
                rows.push(vec![80.0 * k, up, cycle as f64 + 1.0, 0.0, degc]);
            }
        }
    }
    let columns = [
        ("y", "position.y", "mm"),
        ("dir", "direction.y", "1"),
        ("n", "cycle", "1"),
        ("e", "error.y", "um"),
        ("T3", "temperature", "degC"),
    ];
    write(dir.path(), "y", "kind = \"positioning\"", &columns, &rows);
    // The mean of cold and warm cycles at the first target: half of the warm ones' shift.
    let shift_um = |dead_path_mm: f64| {
        let air = format!(
            "[air]\nsensor = \"T3\"\nkPa = 100.0\nrh_percent = 0\nassumed_degC = 5\nassumed_kPa = 100.0\n\
             assumed_rh_percent = 0\ndead_path_mm = {dead_path_mm}\nwavelength_nm = 633.0\n"
        );
        std::fs::write(dir.path().join("c.toml"), air).unwrap();
        let words = ["evaluate", "y.run.toml", "--conditions", "c.toml", "--json"];
        let (code, out, err) = said(&rtecctl(dir.path(), &words));
        assert_eq!(code, Some(0), "{err}");
        assert!(err.contains(&format!("dead path {dead_path_mm} mm (Edlén, NIST)")), "{err}");
        let found: serde_json::Value = serde_json::from_str(&out).unwrap();
        found["targets"][0]["mean_up"].as_f64().unwrap()
    };
    let per_mm = 1e3 * (cold.1 / warm.1 - 1.0);
    for dead_path_mm in [250.0, 800.0] {
        let (found, want) = (shift_um(dead_path_mm) - shift_um(0.0), 0.5 * per_mm * dead_path_mm);
        assert!((found - want).abs() < 2e-3, "{dead_path_mm} mm: {found} and {want} µm");
    }
}

/// A sensor of the conditions that reads 999.9 must not change the figures.
#[test]
fn lengths_are_not_reduced_by_a_sensor_that_reads_nonsense() {
    let dir = tempfile::tempdir().unwrap();
    positioning(dir.path(), "y", 800.0, |w| w);
    std::fs::write(dir.path().join("conditions.toml"), CONDITIONS).unwrap();
    let words = ["evaluate", "y.run.toml", "--conditions", "conditions.toml"];
    assert_eq!(said(&rtecctl(dir.path(), &words)).0, Some(0));
    let csv = std::fs::read_to_string(dir.path().join("y.csv")).unwrap();
    let place = csv.lines().next().unwrap().split(',').position(|c| c == "T3").unwrap();
    let unplugged = csv.lines().enumerate().map(|(row, line)| {
        let mut cells: Vec<&str> = line.split(',').collect();
        if (20..30).contains(&row) {
            cells[place] = "999.9";
        }
        cells.join(",") + "\n"
    });
    std::fs::write(dir.path().join("y.csv"), unplugged.collect::<String>()).unwrap();
    let (code, out, err) = said(&rtecctl(dir.path(), &words));
    assert!(
        code == Some(2) && out.is_empty() && err.contains("T3") && err.contains("20 °C"),
        "{code:?} {err}"
    );
}

/// A file of another kind is named by its kind.
#[test]
fn a_file_of_another_kind_is_said() {
    let dir = tempfile::tempdir().unwrap();
    positioning(dir.path(), "y", 800.0, |w| w);
    std::fs::write(dir.path().join("m.toml"), "name = \"m\"\n[[effect]]\nname = \"scale.x\"\nppm = 1.0\n")
        .unwrap();
    for (words, what) in [
        (["characterise", "evaluate", "m.toml"].as_slice(), "a machine model"),
        (&["characterise", "evaluate", "y.csv"], "a table of values"),
        (&["model", "show", "--machine", "y.run.toml"], "a run record"),
        (&["model", "show", "--machine", "y.csv"], "a table of values"),
        (&["config", "check", "y.run.toml"], "a run record"),
        (&["config", "check", "m.toml"], "a machine model"),
    ] {
        let out =
            Command::new(env!("CARGO_BIN_EXE_rtecctl")).current_dir(dir.path()).args(words).output().unwrap();
        let (code, _, err) = said(&out);
        assert!(code == Some(2) && err.contains(what) && err.lines().count() == 1, "{words:?}: {err}");
    }
}

const CONDITIONS: &str = "machine = \"machining centre 12\"\naxis = \"Y, 800 mm\"\noperator = \"N. N.\"\n[instrument]\nname = \"laser interferometer\"\n\
                          calibrated = \"2026-01-15\"\n[test]\nfeed_mm_per_min = 1000\ndwell_s = 4\n[thermal]\n\
                          scale = { sensor = \"T3\", ppm_per_K = 8.5 }\n[uncertainty]\ndevice_um_per_m = 0.8\nmisalignment_mm = 1.0\n\
                          machine_ppm_per_K = 8.5\nmachine_temperature_K = 0.3\ndrift_um = 1.2\nset_up_um = 0.3\n";

/// The reports are complete pages.
/// They are kept in target/reports, and as pictures if Chromium is installed.
#[test]
#[expect(clippy::too_many_lines, reason = "a table of pages")]
fn reports_are_pages_of_their_own() {
    if !test_needs::long() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path();
    positioning(folder, "y", 800.0, |w| w);
    ballbar(folder, "slow", 10.0);
    ballbar(folder, "fast", 50.0);
    drift(folder);
    plate(folder);
    diagonals(folder);
    faces(folder);
    tilt(folder);
    std::fs::write(folder.join("conditions.toml"), CONDITIONS).unwrap();
    std::fs::write(folder.join("uncertainty.toml"), "[uncertainty]\ndevice_um_per_m = 0.8\n").unwrap();
    let of_a_drift =
        "[uncertainty]\ndevice_um = 0.3\nset_up_um = 0.4\ndrift_um = 1.7\nmisalignment_mm = 1.0\n";
    std::fs::write(folder.join("drift.toml"), of_a_drift).unwrap();
    let reports = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../target/reports");
    std::fs::create_dir_all(&reports).unwrap();
    // Page, standard, its words, and the page's contents.
    let tests: [(&str, &[&str], &[&str]); 8] = [
        (
            "iso230-2",
            &["iso230-2", "y.run.toml", "--conditions", "conditions.toml"],
            &[
                "laser interferometer",
                "feed (mm/min)",
                "A↑",
                "U, k = 2 (µm)",
                "up ↑ mean",
                "ISO/TR 230-9",
                "reduced to 20 °C",
            ],
        ),
        (
            "ballbar",
            &["ballbar", "slow.run.toml", "fast.run.toml", "--conditions", "conditions.toml"],
            &[
                "Uncertainty budget, plane",
                "of G and H: a difference of two readings",
                "instrument, serial number",
                "squareness",
                "µrad",
                "servo mismatch",
                "95 % interval",
                "deviations enlarged",
                "counter-clockwise",
            ],
        ),
        (
            "iso230-3",
            &["iso230-3", "drift.run.toml", "--conditions", "uncertainty.toml"],
            &[
                "does not use [uncertainty]: no figure has one",
                "environment (ETVE)",
                "4000 rpm",
                "at rest after heat",
                "K/h",
                "bearing",
            ],
        ),
        (
            "drift-budget",
            &["iso230-3", "drift.run.toml", "--conditions", "drift.toml"],
            &["Uncertainty budget of error.z", "drift (E_VE)", "does not use [uncertainty] misalignment_mm"],
        ),
        ("plate", &["plate", "plate.run.toml"], &["quadrupole", "ppm", "this arrow is", "times enlarged"]),
        (
            "iso230-6",
            &[
                "iso230-6",
                "d0.run.toml",
                "d1.run.toml",
                "d2.run.toml",
                "d3.run.toml",
                "--conditions",
                "uncertainty.toml",
            ],
            &["U, k = 2 (µm)", "PPP", "NNP", "squareness.x.y", "distance along it (mm)"],
        ),
        (
            "faces",
            &["iso230-6", "f0.run.toml", "f1.run.toml"],
            &["squareness.x.y", "distance along it (mm)", "face diagonals"],
        ),
        (
            "tilt",
            &["iso230-2", "tilt.run.toml"],
            &["Tilts while moving x", "arcsec", "position x (mm)", "angle_error.x.b"],
        ),
    ];
    for (standard, words, want) in tests {
        let page = reports.join(format!("{standard}.html"));
        let to = ["evaluate", "--html", page.to_str().unwrap(), "--standard"];
        let (code, text, err) = said(&rtecctl(folder, &[&to[..], words].concat()));
        assert_eq!(code, Some(0), "{standard}: {err}");
        assert!(text.lines().count() > 8, "{standard}: {text}");
        let html = std::fs::read_to_string(&page).unwrap();
        for w in want {
            assert!(html.contains(w), "{standard}: {w}");
        }
        // Nothing is loaded from outside: the only addresses name formats.
        let fetched =
            html.matches("http").count() - html.matches("xmlns=\"http://www.w3.org/2000/svg\"").count();
        assert!(fetched == 0 && html.contains("@page{size:A4") && html.contains("<svg"), "{standard}");
        assert!(!html.contains("NaN") && !html.contains(">inf"), "{standard}");
        std::fs::write(reports.join(format!("{standard}.txt")), text).unwrap();
    }
}

#[test]
fn what_looks_wrong_is_named_and_exits_with_2() {
    let dir = tempfile::tempdir().unwrap();
    positioning(dir.path(), "coded", 800.0, |w| if w > 0.0 { 1.0 } else { 0.0 });
    positioning(dir.path(), "oneway", 800.0, |_| 1.0);
    let evaluate =
        |name: &str, more: &[&str]| said(&rtecctl(dir.path(), &[&["evaluate", name][..], more].concat()));
    let (code, _, err) = evaluate("coded.run.toml", &[]);
    assert!(code == Some(2) && err.contains("stood for downwards"), "{code:?} {err}");
    let (code, _, err) = evaluate("oneway.run.toml", &[]);
    assert!(code == Some(2) && err.contains("--one-way"), "{code:?} {err}");
    let (code, out, err) = evaluate("oneway.run.toml", &["--one-way", "--json"]);
    assert!(
        code == Some(0) && out.contains("\"A\": null") && out.contains("\"A_up\": "),
        "{code:?} {out} {err}"
    );
}

#[test]
fn an_imported_ballbar_has_its_bar_and_plane() {
    let dir = tempfile::tempdir().unwrap();
    ballbar(dir.path(), "b", 20.0);
    let words =
        ["import", "b.csv", "--format", "csv", "--kind", "ballbar", "--columns", "t=time,a=angle,e=error.r"];
    let to = ["--out", "c.run.toml", "--radius-mm", "150", "--plane", "x,y"];
    let (code, _, err) = said(&rtecctl(dir.path(), &[&words[..], &to].concat()));
    assert_eq!(code, Some(0), "{err}");
    let sidecar = std::fs::read_to_string(dir.path().join("c.run.toml")).unwrap();
    assert!(sidecar.contains("radius_mm = 150.0\nplane = [\"x\", \"y\"]"), "{sidecar}");
    for bad in ["x", "x,x", "1,y"] {
        let to = ["--out", "d.run.toml", "--radius-mm", "150", "--plane", bad];
        let (code, _, err) = said(&rtecctl(dir.path(), &[&words[..], &to].concat()));
        assert!(
            code == Some(2) && err.contains("--plane") && !dir.path().join("d.run.toml").exists(),
            "{bad}: {err}"
        );
    }
}

/// The keys that other people's scripts read.
#[test]
fn json_has_the_standard_s_keys() {
    let dir = tempfile::tempdir().unwrap();
    positioning(dir.path(), "y", 800.0, |w| w);
    ballbar(dir.path(), "b", 20.0);
    let (_, out, _) =
        said(&rtecctl(dir.path(), &["evaluate", "y.run.toml", "--standard", "iso230-2", "--json"]));
    for key in ["A", "A_up", "A_down", "E", "E_up", "E_down", "R", "R_up", "R_down", "B", "B_mean", "M"] {
        assert!(out.contains(&format!("\"{key}\": ")), "{key}: {out}");
    }
    let (_, out, _) =
        said(&rtecctl(dir.path(), &["evaluate", "b.run.toml", "--standard", "ballbar", "--json"]));
    for key in [
        "G_ccw",
        "G_cw",
        "G_b",
        "H",
        "F_max",
        "F_min",
        "D",
        "squareness_urad",
        "scale_mismatch_ppm",
        "interval_95",
    ] {
        assert!(out.contains(&format!("\"{key}\": ")), "{key}: {out}");
    }
}
