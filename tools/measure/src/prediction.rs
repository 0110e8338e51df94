//! Predictions of a machine model for a record, with notes on their assumptions.

use crate::{Sink, motion_from_positions, plausible, run_record_files};
use rtec_files::{InputError, InputNotice, Result};
use rtec_model::machine::{
    ChunkedHalfWidthPredictor, ChunkedRecordPredictor, FitRangeCheck, Machine, RecordRanges,
};
use rtec_model::record::{Record, Role};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

/// The sum of the model's effects at every row, by response column.
/// Quantities that the record lacks, and rows outside the range of the fit, are reported by `say`.
///
/// # Errors
/// An effect reads a sensor or channel that the record does not have.
pub fn predict(machine: &Machine, record: &Record, say: Sink<'_>) -> Result<Vec<(String, Vec<f64>)>> {
    let (prediction, notes) = motion_from_positions::predict(machine, record)?;
    for note in notes {
        say(InputNotice::Note(format!("{}: {note}", record.path.display())));
    }
    warn(&record.path, &prediction.taken_as_zero, &machine.out_of_range(record), say);
    Ok(prediction.columns)
}

fn warn(file: &Path, taken_as_zero: &[(String, String)], beyond: &[String], say: Sink<'_>) {
    let file = file.display();
    for (effect, role) in taken_as_zero {
        say(InputNotice::Warning(format!("{file}: no {role} in the record, taken as zero for {effect}")));
    }
    for warning in beyond {
        say(InputNotice::Warning(format!("{file}: {warning}")));
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
    say: Sink<'_>,
) -> Result<(), PredictionFailure> {
    let Some(mut pieces) = run_record_files::RecordPieceReader::of(path)? else {
        return Ok(out.write_all(csv(machine, &run_record_files::read(path)?, interval, say)?.as_bytes())?);
    };
    // Derived motion needs the positions of all rows, so the record is read as a whole.
    let first = pieces.next_record(PIECE_ROWS)?;
    if first.is_some_and(|first| motion_from_positions::reads_more_motion(machine, &first)) {
        return Ok(out.write_all(csv(machine, &run_record_files::read(path)?, interval, say)?.as_bytes())?);
    }
    pieces.rewind()?;
    let (mut running, mut asked) = (ChunkedRecordPredictor::of(machine), FitRangeCheck::of(machine));
    let looked_over = if interval { Some(look_over(&mut pieces, &mut asked)?) } else { None };
    pieces.rewind()?;
    let mut widths: Vec<ChunkedHalfWidthPredictor<'_>> = Vec::new();
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
fn warn_of_readings(file: &Path, not_taken: usize, say: Sink<'_>) {
    if not_taken > 0 {
        say(InputNotice::Warning(format!(
            "{}: {not_taken} readings that a sensor did not take (`characterise evaluate` names them): those rows are predicted from the \
             sensor's last good reading",
            file.display()
        )));
    }
}

/// The range of a record, and its number of rows.
fn look_over(
    pieces: &mut run_record_files::RecordPieceReader,
    asked: &mut FitRangeCheck<'_>,
) -> Result<(RecordRanges, usize)> {
    let (mut reach, mut rows, mut held) = (RecordRanges::default(), 0, BTreeMap::new());
    while let Some(mut record) = pieces.next_record(PIECE_ROWS)? {
        plausible::hold_last_good(&mut record, &mut held);
        asked.see(&record);
        reach.see(&record);
        rows += record.rows();
    }
    Ok((reach, rows))
}

/// Half widths of every response of the record.
fn half_widths<'m>(
    machine: &'m Machine,
    reach: &RecordRanges,
    record: &Record,
) -> Result<Vec<ChunkedHalfWidthPredictor<'m>>> {
    let of = |role: &Role| {
        ChunkedHalfWidthPredictor::of(machine, reach, role).ok_or_else(|| no_interval(machine, role))
    };
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
pub enum PredictionFailure {
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
pub fn csv(machine: &Machine, record: &Record, interval: bool, say: Sink<'_>) -> Result<String> {
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
    crate::run_record_files::csv_with(record, &columns)
}
