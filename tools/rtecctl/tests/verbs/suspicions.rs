//! What a record shows of mistakes is said where records are read, and a fit does not learn from it.

use serde_json::Value;
use std::fmt::Write as _;
use std::path::Path;
use std::process::{Command, Output};

fn rtecctl(dir: &Path, words: &str) -> Output {
    Command::new(env!("CARGO_BIN_EXE_rtecctl")).current_dir(dir).args(words.split(' ')).output().unwrap()
}

/// A drift of three sensors, one of them off, with three rows doubled: growth of 3 µm/K of T1 over the air.
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
    let document: Value = serde_json::from_slice(&out.stdout).unwrap();
    let list = document["suspicions"].as_array().unwrap();
    assert_eq!(list.len(), 2, "{list:?}");
    assert_eq!((list[0]["what"].as_str(), list[0]["column"].as_str()), (Some("unplugged"), Some("off")));
    assert_eq!(list[1]["rows"].as_str(), Some("52,93,134"));
    let model = std::fs::read_to_string(dir.path().join("m.toml")).unwrap();
    assert!(model.contains("T1") && !model.contains("\"off\""), "{model}");
    let out = rtecctl(dir.path(), "characterise evaluate d.run.toml --json");
    let document: Value = serde_json::from_slice(&out.stdout).unwrap();
    assert_eq!(document["suspicions"].as_array().map(Vec::len), Some(2));
}

/// A run of scale and reversal over so many targets; positions, direction and error as they are written.
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

/// What looks wrong is not carried on into a model; what no model can hold is not written even when it is asked for.
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
    // 80 ppm are 2032 ppm by these positions.
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
