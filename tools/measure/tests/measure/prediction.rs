//! Predictions of a record, whole and row by row.

#![allow(clippy::unwrap_used)] // a test's own helpers

use rtec_measure::prediction::{csv, predict, write};
use rtec_measure::run_record_files;
use rtec_model::machine::Machine;
use std::fmt::Write as _;

/// Rows that a prediction holds at a time.
const PIECE_ROWS: usize = 4096;

/// An unlogged acceleration is derived from positions, also row by row.
#[test]
fn motion_that_nobody_logged_is_that_of_the_positions() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::write(
        at("m.toml"),
        "name = \"m\"\n[[effect]]\nname = \"acceleration_error.x\"\num_per_m_s2 = 10.0\n",
    )
    .unwrap();
    let sidecar = "file = \"r.csv\"\nkind = \"dynamics\"\n[columns]\nt = { role = \"time\", unit = \"s\" }\n\
                   x = { role = \"position.x\", unit = \"mm\" }\ne = { role = \"error.x\", unit = \"um\" }\n";
    std::fs::write(at("r.run.toml"), sidecar).unwrap();
    let mut rows = "t,x,e\n".to_owned();
    let phase = |i: usize| i as f64 * 0.002 * 4.0;
    for i in 0..2000 {
        let _ = writeln!(rows, "{:.3},{:.6},0", i as f64 * 0.002, 50.0 * phase(i).sin());
    }
    std::fs::write(at("r.csv"), rows).unwrap();
    let machine = Machine::read(&at("m.toml")).unwrap();
    let record = run_record_files::read(&at("r.run.toml")).unwrap();
    let mut said = Vec::new();
    let predicted = predict(&machine, &record, &mut |s| said.push(s.to_string())).unwrap().remove(0).1;
    // 10 µm at 1 m/s²; 0.8 m/s² at the ends of the stroke.
    let off = |(i, p): (usize, &f64)| (p + 10.0 * 0.8 * phase(i).sin()).abs();
    let worst = predicted.iter().enumerate().skip(100).take(1800).map(off).fold(0.0, f64::max);
    assert!(worst < 0.1, "{worst}");
    assert!(said.iter().any(|s| s.contains("acceleration.x derived from position")), "{said:?}");
    let mut written = Vec::new();
    write(&machine, &at("r.run.toml"), false, &mut written, &mut |_| {}).unwrap();
    assert!(String::from_utf8(written).unwrap() == csv(&machine, &record, false, &mut |_| {}).unwrap());
}

/// Writing row by row gives the same text and warnings as the whole record.
/// The model has memory, and the record has comments, notes and no time in one case.
#[test]
fn a_prediction_row_by_row_is_that_of_the_whole() {
    if !test_needs::long() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let model = "name = \"m\"\n[[effect]]\nname = \"thermal_lag.z\"\nsensor = \"T1\"\num_per_K = 1.3\num_per_K2 = 0.01\ntau_s = 900.0\n\
                 range_K = [-1.0, 4.0]\nstart_K = 0.7\n[[effect]]\nname = \"position_map.z\"\nknots_mm = [0.0, 10.0]\num = [1.0, 2.0]\n[[effect]]\nname = \"reversal.z\"\num = 4.0\n\
                 [[fit]]\nresponse = \"error.z\"\ndate = 2026-05-01\nvalid_until = \"2027-05-01\"\nrms_um = 0.1\nhalf_width_um = 0.2\n\
                 valid = [{ sensor = \"T2\", range_K = [0.0, 1.0], um_per_K = 1.0 }]\n";
    std::fs::write(at("m.toml"), model).unwrap();
    let machine = Machine::read(&at("m.toml")).unwrap();
    // Text and messages, which are the same of the whole record and row by row.
    let both = |machine: &Machine, interval: bool| {
        let (mut said, mut written, mut said_by_rows) = (Vec::new(), Vec::new(), Vec::new());
        let path = at("r.run.toml");
        let record = run_record_files::read(&path).unwrap();
        let whole = csv(machine, &record, interval, &mut |s| said.push(s.to_string()));
        let by_rows =
            write(machine, &path, interval, &mut written, &mut |s| said_by_rows.push(s.to_string()));
        assert_eq!(said_by_rows, said);
        let by_rows = by_rows.map(|()| String::from_utf8(written).unwrap()).map_err(|e| e.to_string());
        assert!(by_rows == whole.map_err(|e| e.to_string()));
        (by_rows, said)
    };
    let times = ["", "t = { role = \"time\", unit = \"s\" }\n"];
    for (time, interval) in times.into_iter().flat_map(|time| [(time, false), (time, true)]) {
        let sidecar = format!(
            "file = \"r.csv\"\nkind = \"drift\"\n[columns]\n{time}z = {{ role = \"position.z\", unit = \"mm\" }}\n\
             T1 = {{ role = \"temperature\", unit = \"degC\" }}\nT2 = {{ role = \"temperature\", unit = \"degC\" }}\n\
             e = {{ role = \"error.z\", unit = \"um\" }}\n"
        );
        std::fs::write(at("r.run.toml"), sidecar).unwrap();
        let mut rows = "t,z,T1,\"a note\",T2,e\n# begun\n".to_owned();
        for i in 0..3 * PIECE_ROWS + 5 {
            let (v, note) = (i as f64, ["", "x", "\"1, 2\"", "µ"][i % 97 % 4]);
            let [z, t1, t2] = [20.0 * (v / 50.0).sin(), 20.0 + 6.0 * (v / 900.0).sin(), 20.5 + v / 3000.0];
            let _ = write!(rows, "{},{z:.3},{t1},{note},{t2:.2},{:.1}", 60 * i, v / 7.0);
            rows.push_str(if i % 1000 == 3 { " # seen\n\n" } else { "\n" });
        }
        std::fs::write(at("r.csv"), rows).unwrap();
        let (whole, said) = both(&machine, interval);
        let whole = whole.unwrap();
        let head = "t,z,T1,\"a note\",T2,e,low_e,high_e,predicted_e\n";
        assert!(interval == whole.starts_with(head), "{}", &whole[..60]);
        // Warnings: at a bound, outside the range of the fit, outside the knots, no direction logged.
        assert_eq!(said.len(), 4, "{said:?}");
    }
    // If no fit covers the rows, the error follows the warnings; the far row is after the first piece.
    let narrow = model.replace("valid =", "at_mm = { z = [-20.0, 20.0] }\nvalid =");
    std::fs::write(at("m.toml"), narrow).unwrap();
    let narrow = Machine::read(&at("m.toml")).unwrap();
    assert!(both(&narrow, true).0.is_ok());
    let text = std::fs::read_to_string(at("r.csv")).unwrap();
    std::fs::write(at("r.csv"), text.clone() + "9999999,90,21,,21,0\n").unwrap();
    assert!(both(&narrow, true).0.unwrap_err().contains("no fit of error.z"));
    assert!(both(&machine, true).0.is_ok());
    // A mistake far after the first piece names its row.
    std::fs::write(at("r.csv"), text + "5,1,2,,3,4\n").unwrap();
    let whole = run_record_files::read(&at("r.run.toml")).unwrap_err();
    for interval in [false, true] {
        let by_rows = write(&machine, &at("r.run.toml"), interval, &mut Vec::new(), &mut |_| {});
        let by_rows = by_rows.unwrap_err().to_string();
        assert_eq!(by_rows, whole.to_string());
        assert!(by_rows.contains("after"), "{by_rows}");
    }
}
