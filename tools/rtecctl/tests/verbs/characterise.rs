//! `rtecctl characterise record` and `evaluate` as a person runs them.

use std::io::Write;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::time::Duration;

fn rtecctl(folder: &Path, words: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_rtecctl"))
        .current_dir(folder)
        .arg("characterise")
        .args(words)
        .output()
        .unwrap()
}

fn said(out: &Output) -> (Option<i32>, String, String) {
    let text = |bytes: &[u8]| String::from_utf8(bytes.to_vec()).unwrap();
    (out.status.code(), text(&out.stdout), text(&out.stderr))
}

/// A feed that says so many lines, a reading every 20 ms; its address.
fn feed(line: impl Fn(usize) -> String + Send + 'static) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    std::thread::spawn(move || {
        let Ok((mut stream, _)) = listener.accept() else { return };
        for i in 0.. {
            if stream.write_all(line(i).as_bytes()).is_err() {
                return;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    });
    address
}

#[test]
fn one_nan_costs_its_row_and_not_the_run() {
    let dir = tempfile::tempdir().unwrap();
    let from = feed(|i| if (10..13).contains(&i) { "gz nan\n".to_owned() } else { format!("gz {i}\n") });
    let words =
        ["record", "--out", "r.run.toml", "--feed", &from, "--columns", "gz=error.z", "--period", "0.02"];
    let (code, _, err) = said(&rtecctl(dir.path(), &[&words[..], &["--duration", "1.5"]].concat()));
    assert_eq!(code, Some(0), "{err}");
    assert!(err.contains("'gz nan' is no line NAME VALUE") && err.contains("rows are missing"), "{err}");
    let record = rtec_measure::record::read(&dir.path().join("r.run.toml")).unwrap();
    assert!(record.rows() > 20 && !dir.path().join("r.run.csv.part").exists(), "{}", record.rows());
}

/// A bug once: a run of a rotary axis was recorded, and then refused by every verb that reads it.
#[test]
fn a_rotary_axis_is_refused_before_it_is_recorded() {
    let dir = tempfile::tempdir().unwrap();
    for columns in ["b=position.b,e=error.x", "e=error.c"] {
        let words = ["record", "--out", "r.run.toml", "--feed", "127.0.0.1:9", "--columns", columns];
        let (code, _, err) = said(&rtecctl(dir.path(), &words));
        assert!(code == Some(2) && err.contains("of a rotary axis"), "{columns}: {err}");
    }
    assert!(std::fs::read_dir(dir.path()).unwrap().next().is_none());
}

/// Ctrl-C ends a run and keeps its rows; the rows of one that was killed are not the next one's to remove.
#[test]
fn a_run_that_is_interrupted_is_kept() {
    let dir = tempfile::tempdir().unwrap();
    let part = dir.path().join("r.run.csv.part");
    let start = |duration: &str| {
        let from = feed(|i| format!("gz {i}\n"));
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_rtecctl"));
        command.args([
            "characterise",
            "record",
            "--out",
            "r.run.toml",
            "--feed",
            &from,
            "--columns",
            "gz=error.z",
        ]);
        command.args(["--period", "0.02", "--duration", duration]).current_dir(dir.path());
        command.stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::piped()).spawn().unwrap()
    };
    let rows = || std::fs::read_to_string(&part).unwrap_or_default().lines().count();
    let end = |run: std::process::Child, signal: &str| {
        while rows() < 12 {
            std::thread::sleep(Duration::from_millis(10));
        }
        std::process::Command::new("kill").args([signal, &run.id().to_string()]).status().unwrap();
        run.wait_with_output().unwrap()
    };
    let out = end(start("600"), "-INT");
    let err = String::from_utf8_lossy(&out.stderr).into_owned();
    assert!(out.status.success() && err.contains("of 600 s: ") && err.contains("rows are kept"), "{err}");
    assert!(
        rtec_measure::record::read(&dir.path().join("r.run.toml")).unwrap().rows() >= 11 && !part.exists()
    );
    assert!(!end(start("600"), "-KILL").status.success());
    let left = std::fs::read(&part).unwrap();
    let (code, _, err) = said(&start("0.1").wait_with_output().unwrap());
    assert!(code == Some(2) && err.contains("rows of a run that was cut off"), "{code:?} {err}");
    assert!(std::fs::read(&part).unwrap() == left);
}

/// A gauge that says nothing more while its line stays open: its last value is no reading of the rows that follow.
#[test]
fn a_gauge_that_goes_silent_gives_no_more_rows() {
    let dir = tempfile::tempdir().unwrap();
    let from = feed(|i| if i < 20 { format!("gz {i}.5\nT1 20.0\n") } else { "T1 20.1\n".to_owned() });
    let words = ["record", "--out", "r.run.toml", "--feed", &from, "--columns", "gz=error.z,T1=temperature"];
    let to = ["--period", "0.02", "--duration", "1.5"];
    let (code, _, err) = said(&rtecctl(dir.path(), &[&words[..], &to].concat()));
    assert_eq!(code, Some(0), "{err}");
    assert!(err.contains("gz no new reading") && err.contains("rows are missing"), "{err}");
    let record = rtec_measure::record::read(&dir.path().join("r.run.toml")).unwrap();
    let mut readings = record.responses().next().unwrap().data.clone();
    let rows = readings.len();
    readings.dedup();
    assert!(rows <= 20 && readings.len() == rows, "{rows} rows of 20 readings: {readings:?}");
}

#[test]
fn a_shift_without_a_response_is_recorded_and_two_alike_are_refused_first() {
    let dir = tempfile::tempdir().unwrap();
    let from = feed(|i| format!("T1 20.{}\n", i % 10));
    let words = [
        "record",
        "--out",
        "s.run.toml",
        "--feed",
        &from,
        "--period",
        "0.02",
        "--duration",
        "0.6",
        "--columns",
    ];
    let (code, _, err) = said(&rtecctl(dir.path(), &[&words[..], &["T1=temperature"]].concat()));
    assert_eq!(code, Some(0), "{err}");
    assert!(rtec_measure::record::read_log(&dir.path().join("s.run.toml")).unwrap().rows() > 5);
    let (code, _, err) = said(&rtecctl(dir.path(), &[&words[..], &["a=error.x,b=error.x"]].concat()));
    assert!(code == Some(2) && err.contains("two columns of role error.x"), "{code:?} {err}");
}

struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
    }
}

fn write(folder: &Path, name: &str, head: &str, columns: &[(&str, &str, &str)], rows: &[Vec<f64>]) {
    let listed = columns
        .iter()
        .map(|(column, role, unit)| format!("{column} = {{ role = \"{role}\", unit = \"{unit}\" }}"));
    let sidecar =
        format!("file = \"{name}.csv\"\n{head}\n[columns]\n{}\n", listed.collect::<Vec<_>>().join("\n"));
    let line = |r: &Vec<f64>| r.iter().map(f64::to_string).collect::<Vec<_>>().join(",");
    let names = columns.iter().map(|c| c.0).collect::<Vec<_>>().join(",");
    let csv = std::iter::once(names).chain(rows.iter().map(line)).collect::<Vec<_>>().join("\n");
    std::fs::write(folder.join(format!("{name}.csv")), csv + "\n").unwrap();
    std::fs::write(folder.join(format!("{name}.run.toml")), sidecar).unwrap();
}

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

fn ballbar(folder: &Path, name: &str, feed_mm_s: f64) {
    let mut noise = Noise(5);
    let mut rows = Vec::new();
    let step = std::f64::consts::TAU * 1.02 / 720.0;
    let mut t = 0.0;
    for turn in [1.0, -1.0] {
        for i in 0..720 {
            let a: f64 = turn * (f64::from(i) + 0.5) * step + 0.3;
            let (s, c) = a.sin_cos();
            let square = 25e-3 * 150.0 * s * c;
            let travel = 150.0 * (1.0 - turn * s.signum() * c);
            let reversal = -turn * s.signum() * c * (2.5 + 4.0 * f64::exp(-travel / 0.6));
            let lag = turn * 0.3 * feed_mm_s * s * c;
            rows.push(vec![t, a, square + reversal + lag + 4.0 * c - 2.0 * s + 0.4 * noise.next()]);
            t += step * 150.0 / feed_mm_s;
        }
        t += 2.0;
    }
    let head = "kind = \"ballbar\"\nradius_mm = 150.0\nplane = [\"x\", \"y\"]";
    write(folder, name, head, &[("t", "time", "s"), ("a", "angle", "rad"), ("e", "error.r", "um")], &rows);
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

/// Both diagonals of the face x y, 500 mm long: 18 µrad out of square, 6 ppm long.
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

/// How x pitches, over 800 mm, in arcseconds.
fn tilt(folder: &Path) {
    let mut noise = Noise(30);
    let mut rows = Vec::new();
    for _ in 0..5 {
        for way in [1.0, -1.0] {
            for k in 0..11 {
                let x = 80.0 * f64::from(if way > 0.0 { k } else { 10 - k }) + 3.0;
                rows.push(vec![x, way, 2.5 * (x / 250.0).sin() + 0.3 * way + 0.2 * noise.next()]);
            }
        }
    }
    let columns =
        [("x", "position.x", "mm"), ("dir", "direction.x", "1"), ("pitch", "angle_error.x.b", "arcsec")];
    write(folder, "tilt", "kind = \"positioning\"", &columns, &rows);
}

/// A workpiece reduced to 20 °C beside a scale that is not; conditions of lengths for a tilt.
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

/// A sensor of the conditions that reads 999.9 would carry it into every figure.
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

/// A file of another kind is called what it is.
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

/// Reports; kept in target/reports for whoever wants to look at them, and as pictures where Chromium is there.
#[test]
fn reports_are_pages_of_their_own() {
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
    // Page, standard and its words, what stands on it.
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
            &[
                "Uncertainty budget of the displacements",
                "drift (E_VE)",
                "does not use [uncertainty] misalignment_mm",
            ],
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
        // Nothing is fetched: the only addresses are names of formats.
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

/// The keys that other people's scripts use.
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

/// No plan asks for what the machine cannot do.
#[test]
fn a_plan_fits_the_machine() {
    let dir = tempfile::tempdir().unwrap();
    let plan = |words: &[&str]| said(&rtecctl(dir.path(), &[&["plan", "--axes"], words].concat()));
    for (words, code, what) in [
        (&["x=500,y=400"][..], 0, "ballbar of 150 mm"),
        (&["x=500,y=220"], 0, "ballbar of 100 mm"),
        (&["x=500,y=110"], 0, "ballbar of 50 mm"),
        (&["x=500,y=80"], 0, "no circles"),
        (&["x=500,y=80", "--ballbar-mm", "40"], 0, "ballbar of 40 mm"),
        (&["x=500,y=400", "--ballbar-mm", "900"], 2, "a circle 1800 mm across on an axis of 400 mm"),
        (&["x=500,x=400"], 2, "x a second time"),
        (&["x=500"], 0, "linear_x"),
    ] {
        let (got, out, err) = plan(words);
        assert_eq!(got, Some(code), "{words:?}: {err}");
        assert!(out.contains(what) || err.contains(what), "{words:?}: {out} {err}");
    }
}

#[test]
fn a_verdict_s_rivals_get_the_run_that_tells_them() {
    let dir = tempfile::tempdir().unwrap();
    let verdict = r#"{"verdict":"not_separable","gap":{"unit":"um","floor":0.3},"effects":[
        {"name":"screw_periodic.x","parameters":{"period_mm":{"value":12.0},"um":{"value":1.5},"phase_rad":{"value":0.3}},
         "alternatives":[{"name":"screw_periodic.x","period_mm":16.0,"log_odds":0.4}]},
        {"name":"scale.x","parameters":{"ppm":{"value":8.0}},
         "alternatives":[{"name":"thermal_expansion.x","sensor":"T3","log_odds":0.2}]},
        {"name":"thermal_growth.z","sensor":"T1","parameters":{"um_per_K":{"value":2.0},"um_per_K2":{"value":0.0}},
         "alternatives":[{"name":"thermal_growth.z","sensor":"T2","log_odds":0.2}]}]}"#;
    std::fs::write(dir.path().join("verdict.json"), verdict).unwrap();
    let plan = |more: &[&str]| {
        let all = ["plan", "--axes", "x=600,z=400", "--verdict", "verdict.json"];
        rtecctl(dir.path(), &[&all[..], more].concat())
    };
    let found: serde_json::Value = serde_json::from_slice(&plan(&["--json"]).stdout).unwrap();
    let (steps, tells) = (found["steps"].as_array().unwrap(), found["tells"].as_array().unwrap());
    // One run tells wave and scale; no run of targets parts two sensors.
    assert_eq!((steps.len(), tells.len()), (1, 3), "{found}");
    assert!(tells[0]["log_odds"].as_f64() > Some(20.0) && tells[1]["by"] == steps[0]["record"], "{found}");
    assert!(tells[2]["log_odds"].is_null() && tells[2]["by"].as_str().unwrap().contains("heat one place"));
    let text = String::from_utf8(plan(&[]).stdout).unwrap();
    assert!(text.contains("| screw_periodic.x | screw_periodic.x (period_mm = 16.0000) |"), "{text}");
    std::fs::write(dir.path().join("verdict.json"), verdict.replace("scale.x", "scal.x")).unwrap();
    let refused = plan(&[]);
    let said = String::from_utf8(refused.stderr).unwrap();
    assert!(
        refused.status.code() == Some(2) && said.contains("verdict.json: found the effect `scal.x`"),
        "{said}"
    );
}
