//! Predictions of a machine model for a record, with notes on their assumptions.

use crate::{derive, plausible, record};
use rtec_files::{InputError, Result, Said};
use rtec_model::machine::{FitRangeCheck, HalfWidths, Machine, Reach, Running};
use rtec_model::record::{Record, Role};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

/// The sum of the model's effects at every row, by response column.
/// Quantities that the record lacks, and rows outside the range of the fit, are reported by `say`.
///
/// # Errors
/// An effect reads a sensor or channel that the record does not have.
pub fn predict(
    machine: &Machine,
    record: &Record,
    say: &mut dyn FnMut(Said),
) -> Result<Vec<(String, Vec<f64>)>> {
    let (prediction, notes) = derive::predict(machine, record)?;
    for note in notes {
        say(Said::Note(format!("{}: {note}", record.path.display())));
    }
    warn(&record.path, &prediction.taken_as_zero, &machine.out_of_range(record), say);
    Ok(prediction.columns)
}

fn warn(file: &Path, taken_as_zero: &[(String, String)], beyond: &[String], say: &mut dyn FnMut(Said)) {
    let file = file.display();
    for (effect, role) in taken_as_zero {
        say(Said::Warning(format!("{file}: no {role} in the record, taken as zero for {effect}")));
    }
    for warning in beyond {
        say(Said::Warning(format!("{file}: {warning}")));
    }
}

/// As [`csv`], for the record at `path`, written to `out`.
/// Works in pieces of a few thousand rows, except for circles and for motion derived from positions. With an
/// interval the file is read twice, because the interval depends on the range of all rows.
///
/// # Errors
/// As [`csv`]; the record cannot be read; errors of `out`. A partial output is invalid.
pub fn write(
    machine: &Machine,
    path: &Path,
    interval: bool,
    out: &mut impl Write,
    say: &mut dyn FnMut(Said),
) -> Result<(), Failed> {
    let Some(mut pieces) = record::RecordPieces::of(path)? else {
        return Ok(out.write_all(csv(machine, &record::read(path)?, interval, say)?.as_bytes())?);
    };
    // Derived motion needs the positions of all rows, so the record is read as a whole.
    let first = pieces.next_record(PIECE_ROWS)?;
    if first.is_some_and(|first| derive::reads_more_motion(machine, &first)) {
        return Ok(out.write_all(csv(machine, &record::read(path)?, interval, say)?.as_bytes())?);
    }
    pieces.rewind()?;
    let (mut running, mut asked) = (Running::of(machine), FitRangeCheck::of(machine));
    let looked_over = if interval { Some(look_over(&mut pieces, &mut asked)?) } else { None };
    pieces.rewind()?;
    let mut widths: Vec<HalfWidths<'_>> = Vec::new();
    let style = pieces.style();
    let (mut rows, mut taken_as_zero, mut text) = (0, Vec::new(), String::new());
    let (mut not_taken, mut held) = (0, BTreeMap::new());
    while let Some(mut piece) = pieces.next(PIECE_ROWS)? {
        not_taken += plausible::hold_last_good(&mut piece.record, &mut held);
        let prediction = running.next(&piece.record)?;
        text.clear();
        if rows == 0 {
            taken_as_zero = prediction.taken_as_zero;
            if let Some((reach, _)) = &looked_over {
                widths = half_widths(machine, reach, &piece.record)
                    .inspect_err(|_| warn(path, &taken_as_zero, &asked.out_of_range(), say))?;
            }
            text.push_str(pieces.header());
            for (name, _) in &prediction.columns {
                for bound in if interval { &["low_", "high_", "predicted_"][..] } else { &["predicted_"] } {
                    style.push_text(&mut text, &format!("{bound}{name}"));
                }
            }
            text.push('\n');
        }
        if !interval {
            asked.see(&piece.record);
        }
        let widths: Vec<Vec<f64>> = widths.iter_mut().map(|w| w.next(&piece.record)).collect();
        for (n, row) in piece.texts.iter().enumerate() {
            text.push_str(row);
            for (response, (_, data)) in prediction.columns.iter().enumerate() {
                let p = data[n];
                if let Some(w) = widths.get(response).map(|w| w[n]) {
                    style.push_number(&mut text, p - w);
                    style.push_number(&mut text, p + w);
                }
                style.push_number(&mut text, p);
            }
            text.push('\n');
        }
        rows += piece.texts.len();
        out.write_all(text.as_bytes())?;
    }
    if let Some((_, before)) = looked_over.filter(|(_, before)| *before != rows) {
        let expected = format!("{before} rows, as when it was read first");
        return Err(InputError::whole(path, format!("{rows} rows"), expected).into());
    }
    warn(path, &taken_as_zero, &asked.out_of_range(), say);
    warn_of_readings(path, not_taken, say);
    Ok(())
}

/// Reports readings that a sensor did not take.
fn warn_of_readings(file: &Path, not_taken: usize, say: &mut dyn FnMut(Said)) {
    if not_taken > 0 {
        say(Said::Warning(format!(
            "{}: {not_taken} readings that a sensor did not take (`characterise evaluate` names them): those rows are predicted from the \
             sensor's last good reading",
            file.display()
        )));
    }
}

/// The range of a record, and its number of rows.
fn look_over(pieces: &mut record::RecordPieces, asked: &mut FitRangeCheck<'_>) -> Result<(Reach, usize)> {
    let (mut reach, mut rows, mut held) = (Reach::default(), 0, BTreeMap::new());
    while let Some(mut record) = pieces.next_record(PIECE_ROWS)? {
        plausible::hold_last_good(&mut record, &mut held);
        asked.see(&record);
        reach.see(&record);
        rows += record.rows();
    }
    Ok((reach, rows))
}

/// Half widths of every response of the record.
fn half_widths<'m>(machine: &'m Machine, reach: &Reach, record: &Record) -> Result<Vec<HalfWidths<'m>>> {
    let of = |role: &Role| HalfWidths::of(machine, reach, role).ok_or_else(|| no_interval(machine, role));
    record.responses().map(|response| of(&response.role)).collect()
}

fn no_interval(machine: &Machine, response: &Role) -> InputError {
    let found = format!("no fit of {response}");
    let expected = "a [[fit]] that states its interval, as `model fit` writes it";
    InputError::whole(&machine.path, found, expected)
}

/// Rows in memory at a time.
const PIECE_ROWS: usize = 4096;

/// Why a prediction was not written.
#[derive(Debug, thiserror::Error)]
pub enum Failed {
    /// An error of the record or the model.
    #[error(transparent)]
    Input(#[from] InputError),
    /// An error of the file system.
    #[error(transparent)]
    Output(#[from] std::io::Error),
}

/// The record's rows with a column `predicted_RESPONSE` for each response.
/// With `interval`, also the bounds of its 95 % interval.
///
/// # Errors
/// As [`predict`]; no interval is known; the record's CSV has changed.
pub fn csv(machine: &Machine, record: &Record, interval: bool, say: &mut dyn FnMut(Said)) -> Result<String> {
    let mut columns = Vec::new();
    let mut good = record.clone();
    let not_taken = plausible::hold_last_good(&mut good, &mut BTreeMap::new());
    warn_of_readings(&record.path, not_taken, say);
    for (response, (name, data)) in record.responses().zip(predict(machine, &good, say)?) {
        if interval {
            let width = machine.half_widths_um(&good, &response.role);
            let width = width.ok_or_else(|| no_interval(machine, &response.role))?;
            let bound = |sign: f64| data.iter().zip(&width).map(|(p, w)| p + sign * w).collect::<Vec<f64>>();
            columns.push((format!("low_{name}"), bound(-1.0)));
            columns.push((format!("high_{name}"), bound(1.0)));
        }
        columns.push((format!("predicted_{name}"), data));
    }
    crate::record::csv_with(record, &columns)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fmt::Write as _;

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
        let record = record::read(&at("r.run.toml")).unwrap();
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
            let record = record::read(&path).unwrap();
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
                let [z, t1, t2] =
                    [20.0 * (v / 50.0).sin(), 20.0 + 6.0 * (v / 900.0).sin(), 20.5 + v / 3000.0];
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
        let whole = record::read(&at("r.run.toml")).unwrap_err();
        for interval in [false, true] {
            let by_rows = write(&machine, &at("r.run.toml"), interval, &mut Vec::new(), &mut |_| {});
            let by_rows = by_rows.unwrap_err().to_string();
            assert_eq!(by_rows, whole.to_string());
            assert!(by_rows.contains("after"), "{by_rows}");
        }
    }
}
