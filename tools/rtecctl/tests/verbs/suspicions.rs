//! Signs of mistakes in a record are reported where records are read.
//! A fit does not learn from them.

use serde_json::Value;
use std::fmt::Write as _;
use std::path::Path;
use std::process::{Command, Output};

fn rtecctl(dir: &Path, words: &str) -> Output {
    Command::new(env!("CARGO_BIN_EXE_rtecctl")).current_dir(dir).args(words.split(' ')).output().unwrap()
}

/// A drift with three sensors: growth of 3 µm/K of T1 over the air.
/// One sensor is off, and three rows are doubled.
fn drift(dir: &Path) {
    let mut csv = String::from("t,T1,off,air,e\n");
    let mut deep = 0.0;
    for i in 0..240 {
        let heat = if (i / 60) % 2 == 0 { 8.0 } else { 0.0 };
        deep += (heat - deep) / 20.0;
        let rough = 0.02 * f64::from((i * 7919) % 13 - 6);
        let air = 20.0 + 0.5 * (f64::from(i) / 50.0).sin() + 0.1 * rough;
        let e = 3.0 * deep + rough;
        let row = format!("{},{:.3},-127,{air:.3},{e:.3}\n", 60 * i, air + deep + 0.05 * rough);
        csv += &row;
        if [50, 90, 130].contains(&i) {
            csv += &row;
        }
    }
    std::fs::write(dir.join("d.csv"), csv).unwrap();
    let mut side = String::from("file = \"d.csv\"\nkind = \"drift\"\n[columns]\n");
    side += "t = { role = \"time\", unit = \"s\" }\ne = { role = \"error.z\", unit = \"um\" }\n";
    for s in ["T1", "off", "air"] {
        writeln!(side, "{s} = {{ role = \"temperature\", unit = \"degC\" }}").unwrap();
    }
    std::fs::write(dir.join("d.run.toml"), side).unwrap();
}

#[test]
fn a_fit_warns_and_leaves_out_what_is_no_measurement() {
    let dir = tempfile::tempdir().unwrap();
    drift(dir.path());
    let out = rtecctl(dir.path(), "model fit --record d.run.toml --out m.toml --json");
    let said = String::from_utf8_lossy(&out.stderr).into_owned();
    assert!(out.status.success(), "{said}");
    for line in [
        "warning: d.run.toml: unplugged: off: reads -127 degC: a DS18B20 that does not answer",
        "warning: d.run.toml: doubled: 3 of 243 rows are the row before once more (rows 52,93,134)",
        "warning: d.run.toml: left out of the fit: off, 3 rows",
    ] {
        assert!(said.lines().any(|l| l == line), "{line}: {said}");
    }
    let document = crate::document(&out.stdout);
    let list = document["suspicions"].as_array().unwrap();
    assert_eq!(list.len(), 2, "{list:?}");
    assert_eq!((list[0]["what"].as_str(), list[0]["column"].as_str()), (Some("unplugged"), Some("off")));
    assert_eq!(list[1]["rows"].as_str(), Some("52,93,134"));
    let model = std::fs::read_to_string(dir.path().join("m.toml")).unwrap();
    assert!(model.contains("T1") && !model.contains("\"off\""), "{model}");
    let out = rtecctl(dir.path(), "characterise evaluate d.run.toml --json");
    let document = crate::document(&out.stdout);
    assert_eq!(document["suspicions"].as_array().map(Vec::len), Some(2));
}

/// A record with one misread row, and its twin without that row.
/// They have the same names in two folders.
struct Twins([tempfile::TempDir; 2]);

impl Twins {
    /// Rows with a header; the misread one is given by its index.
    fn new(kind: &str, extra: &str, columns: &str, rows: &[String], misread: (usize, &str)) -> Self {
        let twins = Self([tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()]);
        for (dir, has_it) in twins.0.iter().zip([true, false]) {
            let mut csv = String::new();
            for (n, row) in rows.iter().enumerate() {
                match n == misread.0 + 1 {
                    true if has_it => writeln!(csv, "{}", misread.1).unwrap(),
                    true => {}
                    false => writeln!(csv, "{row}").unwrap(),
                }
            }
            std::fs::write(dir.path().join("r.csv"), csv).unwrap();
            let mut side =
                format!("file = \"r.csv\"\nkind = \"{kind}\"\ndate = 2026-03-01\n{extra}[columns]\n");
            for column in columns.split(' ') {
                let (name, role) = column.split_once('=').unwrap();
                let unit = match role.split('.').next().unwrap() {
                    "time" => "s",
                    "temperature" => "degC",
                    "position" => "mm",
                    "error" => "um",
                    "angle" => "rad",
                    _ => "1",
                };
                writeln!(side, "{name} = {{ role = \"{role}\", unit = \"{unit}\" }}").unwrap();
            }
            std::fs::write(dir.path().join("r.run.toml"), side).unwrap();
        }
        twins
    }

    /// The documents that a command prints of both.
    /// They are without notes about the row itself, and without the file's hash.
    fn documents(&self, words: &str) -> [Value; 2] {
        fn bare(value: &mut Value) {
            match value {
                Value::Object(map) => {
                    for key in ["suspicions", "with_every_row", "sha256", "from"] {
                        map.remove(key);
                    }
                    map.values_mut().for_each(bare);
                }
                Value::Array(list) => list.iter_mut().for_each(bare),
                _ => {}
            }
        }
        self.0.each_ref().map(|dir| {
            let out = rtecctl(dir.path(), words);
            let said = String::from_utf8_lossy(&out.stderr).into_owned();
            assert!(out.status.code().is_some_and(|code| code <= 1), "{words}: {said}");
            let mut document = serde_json::from_slice(&out.stdout).unwrap();
            bare(&mut document);
            document
        })
    }

    fn are_alike(&self, words: &str) {
        let [with, without] = self.documents(words);
        assert_eq!(with, without, "{words}");
    }

    /// As [`Self::are_alike`], but for values that follow from time and angle.
    /// They were found with the row's own time and angle, which are good.
    fn are_near(&self, words: &str) {
        fn near(a: &Value, b: &Value) -> bool {
            match (a, b) {
                (Value::Number(a), Value::Number(b)) => {
                    let (a, b) = (a.as_f64().unwrap(), b.as_f64().unwrap());
                    (a - b).abs() <= 1e-5 + 1e-3 * a.abs()
                }
                (Value::Array(a), Value::Array(b)) => {
                    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| near(a, b))
                }
                (Value::Object(a), Value::Object(b)) => {
                    a.len() == b.len() && a.iter().all(|(key, a)| b.get(key).is_some_and(|b| near(a, b)))
                }
                _ => a == b,
            }
        }
        let [with, without] = self.documents(words);
        assert!(near(&with, &without), "{words}: {with} {without}");
    }

    fn draw_alike(&self, words: &str, file: &str) {
        let [with, without] = self.0.each_ref().map(|dir| {
            let out = rtecctl(dir.path(), words);
            assert!(out.status.code().is_some_and(|code| code <= 1), "{words}: {out:?}");
            std::fs::read_to_string(dir.path().join(file)).unwrap()
        });
        assert!(with == without, "{words}: another plot");
    }
}

fn rough(i: u32) -> f64 {
    0.2 * (f64::from((i * 7919 + i * i * 31) % 13) / 6.0 - 1.0)
}

/// A misread row is in no figure and no plot of any verb.
/// Each verb gives the results of the record without that row.
#[test]
fn a_misread_row_is_in_no_figure_of_any_verb() {
    if !test_needs::long() {
        return;
    }
    let mut rows = vec!["t,x,d,e".to_owned()];
    for i in 0..110_u32 {
        let (k, up) = (i % 22, i % 22 < 11);
        let at = 50 * if up { k } else { 21 - k };
        let way = if up { 1.0 } else { -1.0 };
        rows.push(format!("{i},{at},{way},{:.3}", 0.01 * f64::from(at) + way + rough(i)));
    }
    let columns = "t=time x=position.x d=direction.x e=error.x";
    let positioning = Twins::new("positioning", "", columns, &rows, (48, "48,200,1,412.5"));
    positioning.are_alike("characterise evaluate r.run.toml --json");
    positioning.are_alike("history r.run.toml --json");
    positioning.are_alike("model fit --record r.run.toml --effects scale.x,reversal.x --out m.toml --json");
    positioning.are_alike("model validate --machine m.toml --record r.run.toml --json");
    positioning.draw_alike("characterise evaluate r.run.toml --plot p.svg", "p.svg");
    positioning.draw_alike("model validate --machine m.toml --record r.run.toml --plot v.svg", "v.svg");
    // The standard's figure with all rows is given too.
    let out = rtecctl(positioning.0[0].path(), "characterise evaluate r.run.toml --json");
    let document = crate::document(&out.stdout);
    let all = document["with_every_row"]["R"].as_f64().unwrap();
    assert!(all > 400.0 && document["R"].as_f64().unwrap() < 10.0, "{document}");
    let said = String::from_utf8_lossy(&out.stderr);
    assert!(said.contains("(rows 49)") && said.contains("these rows are in no figure"), "{said}");
    assert!(said.contains("with every row the figures would be: A "), "{said}");

    let mut rows = vec!["t,T1,T2,e".to_owned()];
    for i in 0..240_u32 {
        let warm = 6.0 * (1.0 - (-f64::from(i) / 60.0).exp());
        let (t1, t2) = (20.0 + warm + 0.1 * rough(i + 3), 20.0 + 0.1 * rough(i + 7) + 0.002 * f64::from(i));
        rows.push(format!("{},{t1:.3},{t2:.3},{:.3}", 60 * i, 3.0 * warm + rough(i)));
    }
    let columns = "t=time T1=temperature T2=temperature e=error.z";
    let drift = Twins::new("drift", "", columns, &rows, (120, "7200,25.189,20.241,-388.2"));
    drift.are_alike("characterise evaluate r.run.toml --json");
    drift.are_alike("history r.run.toml --json");
    // A history also gives its figure with that row.
    let out = rtecctl(drift.0[0].path(), "history r.run.toml --json");
    let document = crate::document(&out.stdout);
    let point = &document["figures"][0]["points"][0];
    let [value, all] = ["value", "with_every_row"].map(|key| point[key].as_f64().unwrap());
    assert!((value - 3.0).abs() < 0.1 && (all - value).abs() > 0.05, "{document}");
    let said = String::from_utf8_lossy(&out.stderr);
    assert!(said.contains("; with every row it would be "), "{said}");
    drift.are_alike("model fit --record r.run.toml --out m.toml --json");
    drift.are_alike("model fit --record r.run.toml --holdout r.run.toml --out m.toml --json");
    drift.are_alike("model validate --machine m.toml --record r.run.toml --json");
    drift.draw_alike("characterise evaluate r.run.toml --plot p.svg", "p.svg");

    let mut rows = vec!["e".to_owned()];
    rows.extend((0..16).map(|i| format!("{:.3}", rough(i))));
    let returns = Twins::new("positioning", "", "e=error.x", &rows, (7, "88.8"));
    returns.are_alike("characterise evaluate r.run.toml --standard repeatability --json");
    returns.draw_alike("characterise evaluate r.run.toml --standard repeatability --plot p.svg", "p.svg");

    let mut rows = vec!["t,a,r".to_owned()];
    for i in 0..720_u32 {
        let angle = f64::from(if i < 360 { i } else { 720 - i }).to_radians();
        rows.push(format!(
            "{:.2},{angle:.6},{:.3}",
            0.02 * f64::from(i),
            4.0 * (2.0 * angle).cos() + rough(i)
        ));
    }
    let circle = "radius_mm = 150.0\nplane = [\"x\", \"y\"]\n";
    let ballbar =
        Twins::new("ballbar", circle, "t=time a=angle r=error.r", &rows, (200, "4.00,3.490659,-250.0"));
    ballbar.are_near("characterise evaluate r.run.toml --json");
    ballbar.are_near("history r.run.toml --json");
}

/// A run of scale and reversal over a number of targets.
/// `write` turns position, direction and error into written values.
fn positioning(dir: &Path, ppm: f64, write: impl Fn(f64, f64, f64) -> (f64, f64, f64)) {
    let mut csv = String::from("x,d,e\n");
    for cycle in 0..3 {
        for up in [1.0, -1.0] {
            for k in 0..11 {
                let at = 60.0 * f64::from(if up > 0.0 { k } else { 10 - k });
                let rough = 0.2 * (f64::from((k * 7919 + cycle * 31) % 13) / 6.0 - 1.0);
                let (x, d, e) = write(at, up, ppm * at / 1000.0 + 1.5 * up + rough);
                writeln!(csv, "{x:.4},{d},{e:.6}").unwrap();
            }
        }
    }
    std::fs::write(dir.join("p.csv"), csv).unwrap();
    let columns = "x = { role = \"position.x\", unit = \"mm\" }\nd = { role = \"direction.x\", unit = \"1\" }\n\
                   e = { role = \"error.x\", unit = \"um\" }\n";
    let side = format!("file = \"p.csv\"\nkind = \"positioning\"\n[columns]\n{columns}");
    std::fs::write(dir.join("p.run.toml"), side).unwrap();
}

/// No model is made from data that look wrong.
/// A model that could not be loaded is not written even on request.
#[test]
fn no_model_is_written_from_what_looks_wrong_nor_one_that_cannot_be_loaded() {
    let dir = tempfile::tempdir().unwrap();
    let fit = |more: &str| {
        let words = format!("model fit --effects scale.x,reversal.x --record p.run.toml --out m.toml{more}");
        let out = rtecctl(dir.path(), &words);
        let there = dir.path().join("m.toml").exists();
        (out.status.code(), String::from_utf8_lossy(&out.stderr).into_owned(), there)
    };
    let despite = " --despite-suspicions";
    positioning(dir.path(), 80.0, |x, d, e| (x / 25.4, d, e));
    let (code, said, there) = fit("");
    assert!(code == Some(2) && !there && said.contains("inches") && said.contains(despite.trim()), "{said}");
    // 80 ppm are 2032 ppm with these positions.
    let (code, said, there) = fit(despite);
    assert!(code == Some(2) && !there && said.contains("is not written") && said.contains("203"), "{said}");
    positioning(dir.path(), 80.0, |x, d, e| (x, f64::midpoint(d, 1.0), e));
    let (code, said, there) = fit("");
    assert!(code == Some(2) && !there && said.contains("0 and 1"), "{said}");
    positioning(dir.path(), 30.0, |x, d, e| (x, d, e / 1000.0));
    let (code, said, there) = fit("");
    assert!(code == Some(2) && !there && said.contains("millimetres"), "{said}");
    let (code, said, there) = fit(despite);
    assert!(code == Some(0) && there, "{said}");
    positioning(dir.path(), 30.0, |x, d, e| (x, d, e));
    let (code, said, there) = fit("");
    assert!(code == Some(0) && there && !said.contains("suspicions"), "{said}");
}
