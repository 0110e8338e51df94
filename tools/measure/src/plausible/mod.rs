//! Suspicions: likely mistakes that records show without a model.
//!
//! A suspicion is a question to the person who measured, never an error. Records stay unchanged, and
//! [`FitExclusions`] lists what a fit should leave out. Every rule demands more than chance, coarse resolution and
//! normal physics explain, so clean data raise nothing. Checks that need a model (another machine, a sign)
//! are elsewhere.
//!
//! | module | what it looks at |
//! |---|---|
//! | `sensor_cross_check` | one temperature or channel against the others: unplugged, range, unit, jump, outliers, a copy |
//! | `motion_consistency` | positions, directions, speeds, times and errors of a run against one another |
//! | `duplicates_and_outliers` | duplicated rows, outliers and constant stretches of responses |
//! | `small_sample_outliers` | outliers in records of few rows |
//! | `misplaced_digits` | a position with a misplaced decimal point or a lost digit |
//! | `frozen_sensors` | a frozen sensor, by its noise at other times and by the other sensors |
//! | `approach_outliers` | single approaches far from the others to the same target |
//! | `physical_peaks` | where a short peak is physical, and in which orders rows are neighbours |
//! | `long_record_check` | a record too long for memory, piece by piece |
//! | `between_records` | records against one another: repeated, a sign, a unit, two sensors exchanged |
//! | `lasting_steps` | a lasting step of an error; it may be lost counts, so it is no suspicion |
//! | `sensor_regression` | regression of a sensor on other sensors |
//! | `within_record` | rows against other rows: direction, sign or unit wrong from a row on, exchanged columns, a clock put forward |
//! | `wrong_units` | minutes, hours, inches |
//! | `robust_stats` | medians, robust spreads, differences |

mod approach_outliers;
mod between_records;
mod duplicates_and_outliers;
mod frozen_sensors;
mod lasting_steps;
mod long_record_check;
mod misplaced_digits;
mod motion_consistency;
mod physical_peaks;
mod robust_stats;
mod sensor_cross_check;
mod sensor_regression;
mod small_sample_outliers;
pub(crate) mod time_column_check;
mod within_record;
mod wrong_units;

pub use between_records::repeated;
pub use lasting_steps::steps_of;
pub use long_record_check::LongRecordSuspicions;
pub use motion_consistency::agreement;
pub(crate) use sensor_cross_check::DEGC;

use crate::gauge_resolution;
use rtec_files::{InputError, InputNotice, Result};
use rtec_model::record::{Column, Record, Role};
use serde::Serialize;
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::Path;

/// A sensor with at most this share of bad rows loses only those rows.
const FEW: f64 = 0.1;

rtec_files::choice! {
    /// The kind of mistake (`what` in tools/guide/reference/verdict.md).
    #[derive(PartialOrd, Ord, Hash, Serialize)]
    #[serde(rename_all = "snake_case")]
    pub enum MistakeKind {
        Unit = "unit", "Another unit than the column states.";
        Sign = "sign", "The opposite sign.";
        Direction = "direction", "A direction of approach that contradicts the movement or is constant.";
        Stuck = "stuck", "A constant value where a real one would change.";
        Unplugged = "unplugged", "The value of an input without a sensor.";
        Range = "range", "A value that is impossible on a machine.";
        Jump = "jump", "A step that is impossible on a machine.";
        Doubled = "doubled", "Duplicated rows or columns.";
        Swapped = "swapped", "Two columns or two sensors exchanged.";
        Outliers = "outliers", "Single rows far from all others.";
        OtherMachine = "other_machine", "Measured on another machine than the model's (found only with a model).";
    }
}

impl MistakeKind {
    /// The name in JSON documents.
    pub fn name(self) -> &'static str {
        Self::ALL[self as usize].0
    }
}

impl fmt::Display for MistakeKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A suspected mistake in a record.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Suspicion {
    /// Path of the record's sidecar.
    pub record: String,
    /// Name of the column in the CSV; empty for whole rows.
    pub column: String,
    /// Rows from 1 without header and comments, such as `3-9,14`; empty for all rows.
    pub rows: String,
    /// Kind of the mistake.
    pub what: MistakeKind,
    /// One line: what was seen, and what it looks like.
    pub text: String,
    /// Whether the column is a temperature or a channel.
    #[serde(skip)]
    sensor: bool,
    /// Number of rows of the record.
    #[serde(skip)]
    of: usize,
}

impl Suspicion {
    /// A suspicion against a column.
    /// `rows` count from 0 in this record; none means all.
    pub fn new(record: &Record, column: &str, what: MistakeKind, rows: &[usize], text: String) -> Self {
        let sensor = record.columns.iter().any(|c| c.name == column && is_sensor(c));
        let (of, path) = (record.rows(), record.path.display().to_string());
        let rows: Vec<usize> = rows.iter().map(|row| record.first_row() + row).collect();
        Self { record: path, column: column.to_owned(), rows: rows_text(&rows), what, text, sensor, of }
    }

    /// A record with the same rows as another one.
    pub fn again(first: &Record, record: &Record) -> Self {
        let text = format!("holds the same rows as {}: it says nothing more", first.path.display());
        Self::new(record, "", MistakeKind::Doubled, &[], text)
    }

    /// Whether it concerns at most a tenth of the rows, and the others are good.
    pub fn is_few(&self) -> bool {
        !self.rows.is_empty()
            && self.row_list().len() as f64 <= FEW * self.of as f64
            && self.what != MistakeKind::Jump
    }

    /// Whether it concerns a temperature or a channel.
    pub fn is_of_sensor(&self) -> bool {
        self.sensor
    }

    /// Whether it is about this column of this record.
    fn is_of(&self, record: &Record, column: &Column) -> bool {
        self.column == column.name && self.is_in(record)
    }

    fn is_in(&self, record: &Record) -> bool {
        self.record == record.path.display().to_string()
    }

    /// Its rows, from 0; empty for all.
    pub fn row_list(&self) -> Vec<usize> {
        let range = |part: &str| {
            let (a, b) = part.split_once('-').unwrap_or((part, part));
            let (a, b) = (a.trim().parse::<usize>().ok()?, b.trim().parse::<usize>().ok()?);
            Some(a.checked_sub(1)?..b)
        };
        self.rows.split(',').filter_map(range).flatten().collect()
    }
}

impl fmt::Display for Suspicion {
    /// One line; of many rows only some.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { record, column, rows, what, text, .. } = self;
        write!(f, "{record}: {what}: ")?;
        if !column.is_empty() {
            write!(f, "{column}: ")?;
        }
        f.write_str(text)?;
        let parts: Vec<&str> = rows.split(',').collect();
        match parts.len() {
            _ if rows.is_empty() => Ok(()),
            n if n > 6 => write!(f, " (rows {}, … {})", parts[..5].join(","), parts[n - 1]),
            _ => write!(f, " (rows {rows})"),
        }
    }
}

/// Rows from 0 as text, such as `3-9,14`, from 1.
fn rows_text(rows: &[usize]) -> String {
    let written = |run: &[usize]| match run {
        [first, .., last] => format!("{}-{}", first + 1, last + 1),
        one => (one[0] + 1).to_string(),
    };
    rows.chunk_by(|a, b| *b == a + 1).map(written).collect::<Vec<_>>().join(",")
}

/// All suspicions of these records, compared with one another; none for clean data.
pub fn suspicions(records: &[Record]) -> Vec<Suspicion> {
    let mut found = Vec::new();
    for record in records {
        sensor_cross_check::look(record, &mut found);
        motion_consistency::look(record, &mut found);
        duplicates_and_outliers::look(record, records, &mut found);
        misplaced_digits::look(record, &mut found);
        approach_outliers::look(record, &mut found);
        wrong_units::look(record, &mut found);
        within_record::look(record, &mut found);
    }
    frozen_sensors::look(records, &mut found);
    between_records::look(records, &mut found);
    // Jumps in several records show that something is switched.
    let jumps = |s: &Suspicion, all: &[Suspicion]| {
        all.iter()
            .filter(|o| o.what == MistakeKind::Jump && o.column == s.column && o.record != s.record)
            .count()
    };
    let all = found.clone();
    found.retain(|s| s.what != MistakeKind::Jump || jumps(s, &all) == 0);
    found
}

/// Reports suspicions, steps and conditions of records; returns the suspicions.
pub fn report_suspicions(records: &[Record], say: &mut dyn FnMut(InputNotice)) -> Vec<Suspicion> {
    let found = suspicions(records);
    found.iter().map(ToString::to_string).chain(steps_of(records)).for_each(|s| say(InputNotice::Warning(s)));
    say_conditions(records, &found, say);
    found
}

/// Reports conditions of records that are no mistakes.
/// How their CSV is written, a clock that does not begin with the run, constant sensors.
pub fn say_conditions(records: &[Record], found: &[Suspicion], say: &mut dyn FnMut(InputNotice)) {
    for still in frozen_sensors::still(records, found) {
        say(InputNotice::Warning(still));
    }
    for written in records.iter().filter_map(|r| r.written.clone()) {
        say(InputNotice::Note(written));
    }
    let clocks = records.iter().flat_map(|r| {
        [time_column_check::absolute(r), time_column_check::stands_still(r), gauge_resolution::shared_time(r)]
    });
    for clock in clocks.flatten() {
        say(InputNotice::Warning(clock));
    }
}

/// Adds the suspicions to a JSON document, if that is an object.
pub fn enter(document: &mut serde_json::Value, found: &[Suspicion]) {
    if let serde_json::Value::Object(map) = document {
        map.insert("suspicions".to_owned(), serde_json::json!(found));
    }
}

/// Refuses records with a wrong unit, sign, direction or column for a fit.
///
/// # Errors
/// The first such suspicion against one of these records.
pub fn refuse(found: &[Suspicion], records: &[&Path]) -> Result<()> {
    let learned = |s: &&Suspicion| records.iter().any(|r| r.display().to_string() == s.record);
    let wrong = |s: &&Suspicion| {
        let dead = s.what == MistakeKind::Stuck && s.rows.is_empty();
        (dead
            || matches!(
                s.what,
                MistakeKind::Unit | MistakeKind::Sign | MistakeKind::Direction | MistakeKind::Swapped
            ))
            && !s.is_of_sensor()
    };
    let Some(first) = found.iter().filter(learned).find(wrong) else { return Ok(()) };
    let expected = "a record in which that is put right, or --despite-suspicions; nothing is written";
    let found = format!("{}: {}: {}", first.column, first.what, first.text);
    Err(InputError::whole(Path::new(&first.record), found, expected))
}

/// Drops records that repeat an earlier one, from training and hold-out.
pub fn once(train: Vec<Record>, holdout: Vec<Record>) -> (Vec<Record>, Vec<Record>) {
    let all: Vec<&Record> = train.iter().chain(&holdout).collect();
    let again: Vec<usize> = repeated(&all).into_iter().map(|(_, k)| k).collect();
    let n = train.len();
    let new = |from: usize, records: Vec<Record>| {
        let own = records.into_iter().enumerate().filter(|(k, _)| !again.contains(&(from + k)));
        own.map(|(_, r)| r).collect()
    };
    (new(0, train), new(n, holdout))
}

/// The records without what a fit should leave out, which is reported.
pub fn usable(records: &[Record], found: &[Suspicion], say: &mut dyn FnMut(InputNotice)) -> Vec<Record> {
    let out = unusable(found);
    let left: Vec<Record> = records.iter().map(|r| out.without(r)).collect();
    for (before, after) in records.iter().zip(&left) {
        let gone = |c: &&Column| after.columns.iter().all(|k| k.name != c.name);
        let sensors: Vec<&str> = before.columns.iter().filter(gone).map(|c| c.name.as_str()).collect();
        let rows = before.rows() - after.rows();
        if !sensors.is_empty() || rows > 0 {
            let sensors = if sensors.is_empty() { "no sensor".to_owned() } else { sensors.join(", ") };
            let file = before.path.display();
            say(InputNotice::Warning(format!("{file}: left out of the fit: {sensors}, {rows} rows")));
        }
    }
    let kept = found
        .iter()
        .filter(|s| matches!(s.what, MistakeKind::Unit | MistakeKind::Sign | MistakeKind::Direction));
    for s in kept.filter(|s| !out.sensor(&s.column)) {
        say(InputNotice::Warning(format!("{}: {} is kept as it is", s.record, s.column)));
    }
    left
}

/// The records for figures and plots.
/// Leaves out misread and duplicated rows and sensors without readings. A single missing reading of a sensor
/// becomes NaN.
pub fn in_figures<'r>(records: &'r [Record], doubts: &[Suspicion]) -> Cow<'r, [Record]> {
    let mut usable = every_row(records, doubts);
    let of_rows = FitExclusions { rows: rows_left_out(doubts), ..FitExclusions::default() };
    for (at, record) in records.iter().enumerate() {
        if !of_rows.rows(record).is_empty() {
            usable.to_mut()[at] = of_rows.without(&usable[at]);
        }
    }
    usable
}

/// As [`in_figures`], but with every row.
/// Exchanged sensors are put back.
pub fn every_row<'r>(records: &'r [Record], doubts: &[Suspicion]) -> Cow<'r, [Record]> {
    let mut usable = Cow::Borrowed(records);
    let place = |doubt: &Suspicion| records.iter().position(|r| doubt.is_in(r));
    for [one, other] in exchanged(doubts) {
        let Some(at) = place(one) else { continue };
        let record = &mut usable.to_mut()[at];
        let column = |name: &str| record.columns.iter().position(|c| c.name == name);
        if let (Some(a), Some(b)) = (column(&one.column), column(&other.column)) {
            let (first, rows) = (record.first_row(), record.rows());
            let own = one.row_list().into_iter().filter_map(|row| row.checked_sub(first));
            for row in own.filter(|row| *row < rows) {
                let value = record.columns[a].data[row];
                record.columns[a].data[row] = record.columns[b].data[row];
                record.columns[b].data[row] = value;
            }
        }
    }
    for doubt in doubts.iter().filter(|d| d.is_not_taken()) {
        let Some(at) = place(doubt) else { continue };
        let record = &mut usable.to_mut()[at];
        let first = record.first_row();
        if doubt.is_of_column() {
            record.columns.retain(|c| c.name != doubt.column);
        }
        for column in record.columns.iter_mut().filter(|c| c.name == doubt.column) {
            for row in doubt.row_list() {
                if let Some(v) = row.checked_sub(first).and_then(|row| column.data.get_mut(row)) {
                    *v = f64::NAN;
                }
            }
        }
    }
    usable
}

/// Pairs of sensors that are exchanged from a row of their record on.
pub(crate) fn exchanged(doubts: &[Suspicion]) -> Vec<[&Suspicion; 2]> {
    let is_one = |d: &&Suspicion| d.what == MistakeKind::Swapped && d.sensor && !d.rows.is_empty();
    let all: Vec<&Suspicion> = doubts.iter().filter(is_one).collect();
    let pairs = all.windows(2).filter(|w| w[0].record == w[1].record && w[0].rows == w[1].rows);
    pairs.map(|w| [w[0], w[1]]).collect()
}

/// Rows left out of all figures, from 0, by record.
pub(crate) fn rows_left_out(doubts: &[Suspicion]) -> BTreeMap<String, BTreeSet<usize>> {
    let mut rows: BTreeMap<String, BTreeSet<usize>> = BTreeMap::new();
    for doubt in doubts.iter().filter(|d| d.is_of_rows()) {
        rows.entry(doubt.record.clone()).or_default().extend(doubt.row_list());
    }
    rows
}

/// Reports the suspicions of a record and returns it without the bad rows.
pub fn only_good(record: Record, say: &mut dyn FnMut(InputNotice)) -> Record {
    let records = [record];
    let doubts = report_suspicions(&records, say);
    good_rows(&in_figures(&records, &doubts)[0], records[0].rows(), say).into_owned()
}

/// The rows of a record of [`in_figures`] in which every sensor has a reading.
/// Reports how many of the `all` rows are left out.
pub fn good_rows<'r>(record: &'r Record, all: usize, say: &mut dyn FnMut(InputNotice)) -> Cow<'r, Record> {
    let off = |c: &&Column| is_sensor(c) && c.data.iter().any(|v| !v.is_finite());
    let mut left = Cow::Borrowed(record);
    if record.columns.iter().any(|c| off(&c)) {
        let is_taken = |row: &usize| record.columns.iter().all(|c| !is_sensor(c) || c.data[*row].is_finite());
        let keep: Vec<usize> = (0..record.rows()).filter(is_taken).collect();
        // If no row is whole, the sensors with gaps are dropped instead.
        let mut whole = if keep.is_empty() { record.clone() } else { record.select(&keep) };
        whole.columns.retain(|c| !off(&c));
        left = Cow::Owned(whole);
    }
    let out = all - left.rows();
    if out > 0 {
        let file = record.path.display();
        say(InputNotice::Warning(format!("{file}: {out} of {all} rows look misread and are in no figure")));
    }
    left
}

/// Replaces missing readings of sensors by the last good one; returns how many.
/// Readings before the first good one take that. `held` carries each sensor's last good reading to the next
/// piece.
pub fn hold_last_good(record: &mut Record, held: &mut BTreeMap<String, f64>) -> usize {
    let mut found = Vec::new();
    sensor_cross_check::look(record, &mut found);
    let (first, rows) = (record.first_row(), record.rows());
    let mut held_rows = 0;
    for column in record.columns.iter_mut().filter(|c| is_sensor(c)) {
        // After a step a prediction uses the readings: nothing shows which level was right.
        let is_bad =
            |d: &&Suspicion| d.is_not_taken() && d.what != MistakeKind::Jump && d.column == column.name;
        let bad = found.iter().filter(is_bad);
        let bad: BTreeSet<usize> = bad
            .flat_map(|d| if d.rows.is_empty() { (0..rows).collect() } else { d.row_list() })
            .map(|row| row.saturating_sub(first))
            .collect();
        let good = (0..rows).find(|row| !bad.contains(row)).map(|row| column.data[row]);
        let mut last = held.get(&column.name).copied().or(good);
        for (row, v) in column.data.iter_mut().enumerate() {
            if bad.contains(&row) {
                held_rows += 1;
                *v = last.unwrap_or(*v);
            } else {
                last = Some(*v);
            }
        }
        held.extend(last.map(|last| (column.name.clone(), last)));
    }
    held_rows
}

impl Suspicion {
    /// Whether its rows are misread or duplicated.
    fn misreads_rows(&self) -> bool {
        let misread = matches!(
            self.what,
            MistakeKind::Doubled
                | MistakeKind::Outliers
                | MistakeKind::Stuck
                | MistakeKind::Unplugged
                | MistakeKind::Range
        );
        misread && !self.rows.is_empty()
    }

    /// Whether whole rows are bad, not only one sensor. Figures leave such rows out.
    pub fn is_of_rows(&self) -> bool {
        self.misreads_rows() && !self.sensor
    }

    /// Whether a sensor has no valid reading in these rows, or in any row.
    pub(crate) fn is_not_taken(&self) -> bool {
        self.is_of_sensor()
            && (self.misreads_rows()
                || matches!(self.what, MistakeKind::Unplugged | MistakeKind::Stuck | MistakeKind::Jump))
    }

    /// Whether the whole column is lost: all rows are bad, or a step leaves two levels.
    fn is_of_column(&self) -> bool {
        self.rows.is_empty() || self.what == MistakeKind::Jump
    }
}

/// What a fit should leave out.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct FitExclusions {
    sensors: BTreeSet<String>,
    rows: BTreeMap<String, BTreeSet<usize>>,
}

/// What a fit should leave out after these suspicions.
/// Sensors are dropped from all records, unless few rows are bad: then those rows. A response with a wrong
/// unit, sign or direction stays, because only the person who measured knows the truth.
pub fn unusable(suspicions: &[Suspicion]) -> FitExclusions {
    let mut out = FitExclusions::default();
    for s in suspicions {
        let is_kept =
            matches!(s.what, MistakeKind::Sign | MistakeKind::Direction | MistakeKind::OtherMachine);
        if s.sensor && !is_kept && !s.is_few() {
            out.sensors.insert(s.column.clone());
        } else if s.misreads_rows() {
            out.rows.entry(s.record.clone()).or_default().extend(s.row_list());
        }
    }
    out
}

impl FitExclusions {
    /// Whether a temperature or channel of this name is left out.
    pub fn sensor(&self, name: &str) -> bool {
        self.sensors.contains(name)
    }

    /// The rows of a record that are left out, from 0.
    pub fn rows(&self, record: &Record) -> Vec<usize> {
        let rows = self.rows.get(&record.path.display().to_string());
        rows.map(|r| r.iter().copied().filter(|i| *i < record.rows()).collect()).unwrap_or_default()
    }

    /// The record without its unusable rows and sensors.
    /// If no row would remain, all rows stay.
    pub fn without(&self, record: &Record) -> Record {
        let out = self.rows(record);
        let keep: Vec<usize> = (0..record.rows()).filter(|i| out.binary_search(i).is_err()).collect();
        let mut left = if keep.is_empty() || out.is_empty() { record.clone() } else { record.select(&keep) };
        left.columns.retain(|c| !(is_sensor(c) && self.sensor(&c.name)));
        left
    }
}

/// Whether a law may take the column as a cause: a temperature or a channel.
fn is_sensor(column: &Column) -> bool {
    matches!(column.role, Role::Temperature | Role::Channel)
}
