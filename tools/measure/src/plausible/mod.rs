//! Mistakes in records that the records alone show.
//! A unit, a sign, a sensor that is off, rows that stand twice.
//!
//! Each finding is a question to whoever measured, never an error: the record stays as it is, and [`Unusable`] says what a
//! fit should leave out. Every rule asks for more than chance, coarse resolution and honest physics give, so that clean
//! data raise nothing; what a rule cannot tell from a machine that is merely odd it leaves alone. What needs a model
//! (another machine, an error with the model's sign) is not asked here.
//!
//! | module | what it looks at |
//! |---|---|
//! | `sensors` | one temperature or channel beside the others: unplugged, range, unit, stuck, jump, wild values, a copy |
//! | `motion` | positions, directions, speeds, times and errors of a run beside one another |
//! | `rows` | rows that stand twice, wild responses |
//! | `lone` | wild readings in records of few rows |
//! | `slips` | a position with its decimal point in another place |
//! | `stuck` | a sensor that stands still, beside itself at other times and beside the others |
//! | `repeats` | single approaches far off the others to the same target |
//! | `peaks` | where a short peak is honest, and the orders in which neighbours are neighbours |
//! | `pieces` | a record that is too long to be held, each of its pieces by itself |
//! | `between` | several records beside one another: the same rows twice, a sign, a unit, two sensors exchanged |
//! | `step` | an error that steps and stays: lost counts are the machine's own, so it is no suspicion |
//! | `told` | what some sensors say of another one |
//! | `turned` | a record beside itself: single runs of a wrong direction, a sign that turns, another unit from a row on, a clock put forward or in the repeats' place, two sensors exchanged on the way |
//! | `units` | minutes, hours, inches |
//! | `stats` | medians, robust deviations, straight lines |

mod between;
pub(crate) mod clock;
mod lone;
mod motion;
mod peaks;
mod pieces;
mod repeats;
mod rows;
mod sensors;
mod slips;
mod stats;
mod step;
mod stuck;
mod told;
mod turned;
mod units;

pub use between::repeated;
pub use motion::agreement;
pub use pieces::PieceSuspicions;
pub(crate) use sensors::DEGC;
pub use step::steps_of;

use crate::steps;
use rtec_files::{InputError, Said};
use rtec_model::record::{Column, Record, Role};
use serde::{Serialize, Serializer};
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::Path;

/// Bad readings of a sensor in no more than this share of the rows cost those rows.
/// More of them cost the sensor.
const FEW: f64 = 0.1;

/// The kind of mistake (`what` of a suspicion, tools/guide/reference/verdict.md).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum What {
    /// Another unit than the column says.
    Unit,
    /// The other sign.
    Sign,
    /// A direction of approach that contradicts the movement, or says nothing.
    Direction,
    /// A value that stands still where it should not.
    Stuck,
    /// What an input reads without its sensor.
    Unplugged,
    /// A value that no machine has.
    Range,
    /// A step that no machine makes.
    Jump,
    /// Rows or columns that stand twice.
    Doubled,
    /// Two columns, or two sensors, one in the other's place.
    Swapped,
    /// Single rows far off all others.
    Outliers,
    /// Taken on another machine than the model's (found only beside a model).
    OtherMachine,
}

impl What {
    /// As the document writes it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Unit => "unit",
            Self::Sign => "sign",
            Self::Direction => "direction",
            Self::Stuck => "stuck",
            Self::Unplugged => "unplugged",
            Self::Range => "range",
            Self::Jump => "jump",
            Self::Doubled => "doubled",
            Self::Swapped => "swapped",
            Self::Outliers => "outliers",
            Self::OtherMachine => "other_machine",
        }
    }
}

impl fmt::Display for What {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl Serialize for What {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(self.name())
    }
}

/// A mistake that the data itself shows.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Suspicion {
    /// The record: its sidecar as it was named.
    pub record: String,
    /// The column, by its name in the CSV; empty where it is the whole row's.
    pub column: String,
    /// Rows of data from 1, the header and comments not counted: `3-9,14`; empty for all of them.
    pub rows: String,
    /// What it looks like.
    pub what: What,
    /// One line: what was seen, and what it looks like.
    pub text: String,
    /// The column is a temperature or a channel.
    #[serde(skip)]
    sensor: bool,
    /// Rows of its record.
    #[serde(skip)]
    of: usize,
}

impl Suspicion {
    /// A suspicion against a column; no rows (of this record, from 0) stand for all.
    pub fn new(record: &Record, column: &str, what: What, rows: &[usize], text: String) -> Self {
        let sensor = record.columns.iter().any(|c| c.name == column && is_sensor(c));
        let (of, path) = (record.rows(), record.path.display().to_string());
        let rows: Vec<usize> = rows.iter().map(|row| record.first_row() + row).collect();
        Self { record: path, column: column.to_owned(), rows: rows_text(&rows), what, text, sensor, of }
    }

    /// A record that holds the rows of another one, whatever its name.
    pub fn again(first: &Record, record: &Record) -> Self {
        let text = format!("holds the same rows as {}: it says nothing more", first.path.display());
        Self::new(record, "", What::Doubled, &[], text)
    }

    /// It is about few of its record's rows.
    /// They can be spared, and the column is good without them.
    pub fn is_few(&self) -> bool {
        !self.rows.is_empty()
            && self.row_list().len() as f64 <= FEW * self.of as f64
            && self.what != What::Jump
    }

    /// It is about a temperature or a channel.
    pub fn is_of_sensor(&self) -> bool {
        self.sensor
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
    /// One line, with few of the rows where there are many.
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

/// Rows from 0 as `3-9,14`, from 1.
fn rows_text(rows: &[usize]) -> String {
    let mut out: Vec<String> = Vec::new();
    let mut i = 0;
    while i < rows.len() {
        let mut j = i;
        while j + 1 < rows.len() && rows[j + 1] == rows[j] + 1 {
            j += 1;
        }
        out.push(if j > i { format!("{}-{}", rows[i] + 1, rows[j] + 1) } else { (rows[i] + 1).to_string() });
        i = j + 1;
    }
    out.join(",")
}

/// What these records, given together, show of mistakes; none for clean data.
pub fn suspicions(records: &[Record]) -> Vec<Suspicion> {
    let mut found = Vec::new();
    for record in records {
        sensors::look(record, &mut found);
        motion::look(record, &mut found);
        rows::look(record, records, &mut found);
        slips::look(record, &mut found);
        repeats::look(record, &mut found);
        units::look(record, &mut found);
        turned::look(record, &mut found);
    }
    stuck::look(records, &mut found);
    between::look(records, &mut found);
    // A sensor that jumps in one record after the other shows something that is switched.
    let jumps = |s: &Suspicion, all: &[Suspicion]| {
        all.iter().filter(|o| o.what == What::Jump && o.column == s.column && o.record != s.record).count()
    };
    let all = found.clone();
    found.retain(|s| s.what != What::Jump || jumps(s, &all) == 0);
    found
}

/// As [`suspicions`], and says each of them, with the steps that are none.
pub fn said(records: &[Record], say: &mut dyn FnMut(Said)) -> Vec<Suspicion> {
    let found = suspicions(records);
    for s in &found {
        say(Said::Warning(s.to_string()));
    }
    for step in steps_of(records) {
        say(Said::Warning(step));
    }
    say_conditions(records, &found, say);
    found
}

/// Says what is no mistake and worth knowing of records.
/// How their CSV is written, a clock that does not begin with the run, sensors that stand still.
pub fn say_conditions(records: &[Record], found: &[Suspicion], say: &mut dyn FnMut(Said)) {
    for still in stuck::still(records, found) {
        say(Said::Warning(still));
    }
    for written in records.iter().filter_map(|r| r.written.clone()) {
        say(Said::Note(written));
    }
    let clocks =
        records.iter().flat_map(|r| [clock::absolute(r), clock::stands_still(r), steps::shared_time(r)]);
    for clock in clocks.flatten() {
        say(Said::Warning(clock));
    }
}

/// Puts suspicions into a document, where that is an object.
pub fn enter(document: &mut serde_json::Value, found: &[Suspicion]) {
    if let serde_json::Value::Object(map) = document {
        map.insert("suspicions".to_owned(), serde_json::json!(found));
    }
}

/// Refuses records to learn from in which a unit, a sign, a direction or a column looks wrong: a model would carry it on.
///
/// # Errors
/// The first such suspicion against one of these records.
pub fn refuse(found: &[Suspicion], records: &[&Path]) -> Result<(), InputError> {
    let learned = |s: &&Suspicion| records.iter().any(|r| r.display().to_string() == s.record);
    let wrong = |s: &&Suspicion| {
        let dead = s.what == What::Stuck && s.rows.is_empty();
        (dead || matches!(s.what, What::Unit | What::Sign | What::Direction | What::Swapped))
            && !s.is_of_sensor()
    };
    let Some(first) = found.iter().filter(learned).find(wrong) else { return Ok(()) };
    let expected = "a record in which that is put right, or --despite-suspicions; nothing is written";
    let found = format!("{}: {}: {}", first.column, first.what, first.text);
    Err(InputError::whole(Path::new(&first.record), found, expected))
}

/// The records that no earlier one of these repeats.
/// Those to learn from, and those to judge by.
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

/// The records as a fit may learn from them; what it leaves out of them is said.
pub fn usable(records: &[Record], found: &[Suspicion], say: &mut dyn FnMut(Said)) -> Vec<Record> {
    let out = unusable(found);
    let left: Vec<Record> = records.iter().map(|r| out.without(r)).collect();
    for (before, after) in records.iter().zip(&left) {
        let gone = |c: &&Column| after.columns.iter().all(|k| k.name != c.name);
        let sensors: Vec<&str> = before.columns.iter().filter(gone).map(|c| c.name.as_str()).collect();
        let rows = before.rows() - after.rows();
        if !sensors.is_empty() || rows > 0 {
            let sensors = if sensors.is_empty() { "no sensor".to_owned() } else { sensors.join(", ") };
            let file = before.path.display();
            say(Said::Warning(format!("{file}: left out of the fit: {sensors}, {rows} rows")));
        }
    }
    let kept = found.iter().filter(|s| matches!(s.what, What::Unit | What::Sign | What::Direction));
    for s in kept.filter(|s| !out.sensor(&s.column)) {
        say(Said::Warning(format!("{}: {} is kept as it is", s.record, s.column)));
    }
    left
}

/// The records as figures and plots may hold them, after these suspicions.
/// Without the rows that look misread or stand twice, and without the sensors that took no reading. A single reading that a sensor did not
/// take is no number.
pub fn in_figures<'r>(records: &'r [Record], doubts: &[Suspicion]) -> Cow<'r, [Record]> {
    let mut usable = every_row(records, doubts);
    let of_rows = Unusable { rows: rows_left_out(doubts), ..Unusable::default() };
    for (at, record) in records.iter().enumerate() {
        if !of_rows.rows(record).is_empty() {
            usable.to_mut()[at] = of_rows.without(&usable[at]);
        }
    }
    usable
}

/// As [`in_figures`], with every row.
/// What a figure would be if no row had been left out. Sensors that change places are put back.
pub fn every_row<'r>(records: &'r [Record], doubts: &[Suspicion]) -> Cow<'r, [Record]> {
    let mut usable = Cow::Borrowed(records);
    for [one, other] in exchanged(doubts) {
        let Some(at) = records.iter().position(|r| r.path.display().to_string() == one.record) else {
            continue;
        };
        let record = &mut usable.to_mut()[at];
        let place = |name: &str| record.columns.iter().position(|c| c.name == name);
        if let (Some(a), Some(b)) = (place(&one.column), place(&other.column)) {
            let first = record.first_row();
            for row in one.row_list().into_iter().filter_map(|row| row.checked_sub(first)) {
                if row < record.rows() {
                    let value = record.columns[a].data[row];
                    record.columns[a].data[row] = record.columns[b].data[row];
                    record.columns[b].data[row] = value;
                }
            }
        }
    }
    for doubt in doubts.iter().filter(|d| d.is_not_taken()) {
        let Some(at) = records.iter().position(|r| r.path.display().to_string() == doubt.record) else {
            continue;
        };
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

/// Pairs of sensors that change places at a row of their record.
pub(crate) fn exchanged(doubts: &[Suspicion]) -> Vec<[&Suspicion; 2]> {
    let is_one = |d: &&Suspicion| d.what == What::Swapped && d.sensor && !d.rows.is_empty();
    let all: Vec<&Suspicion> = doubts.iter().filter(is_one).collect();
    let pairs = all.windows(2).filter(|w| w[0].record == w[1].record && w[0].rows == w[1].rows);
    pairs.map(|w| [w[0], w[1]]).collect()
}

/// Rows that no figure holds, from 0, by their record.
pub(crate) fn rows_left_out(doubts: &[Suspicion]) -> BTreeMap<String, BTreeSet<usize>> {
    let mut rows: BTreeMap<String, BTreeSet<usize>> = BTreeMap::new();
    for doubt in doubts.iter().filter(|d| d.is_of_rows()) {
        rows.entry(doubt.record.clone()).or_default().extend(doubt.row_list());
    }
    rows
}

/// A record without the rows that no figure may hold.
/// What the record shows of mistakes is said, and how many rows are left out.
pub fn only_good(record: Record, say: &mut dyn FnMut(Said)) -> Record {
    let records = [record];
    let doubts = said(&records, say);
    good_rows(&in_figures(&records, &doubts)[0], records[0].rows(), say).into_owned()
}

/// The rows of a record of [`in_figures`] in which every sensor took its reading.
/// Says how many of its `all` rows are left out.
pub fn good_rows<'r>(record: &'r Record, all: usize, say: &mut dyn FnMut(Said)) -> Cow<'r, Record> {
    let off = |c: &&Column| is_sensor(c) && c.data.iter().any(|v| !v.is_finite());
    let mut left = Cow::Borrowed(record);
    if record.columns.iter().any(|c| off(&c)) {
        let is_taken = |row: &usize| record.columns.iter().all(|c| !is_sensor(c) || c.data[*row].is_finite());
        let keep: Vec<usize> = (0..record.rows()).filter(is_taken).collect();
        // Where sensors are off in turns no row is whole: those sensors go then.
        let mut whole = if keep.is_empty() { record.clone() } else { record.select(&keep) };
        whole.columns.retain(|c| !off(&c));
        left = Cow::Owned(whole);
    }
    let out = all - left.rows();
    if out > 0 {
        let file = record.path.display();
        say(Said::Warning(format!("{file}: {out} of {all} rows look misread and are in no figure")));
    }
    left
}

/// Puts the last good reading in place of those that a sensor did not take.
/// Returns how many those are.
/// Where none is before them it is the first good one of this piece of the record. `held`: each sensor's last good reading so far.
pub fn hold_last_good(record: &mut Record, held: &mut BTreeMap<String, f64>) -> usize {
    let mut found = Vec::new();
    sensors::look(record, &mut found);
    let (first, rows) = (record.first_row(), record.rows());
    let mut held_rows = 0;
    for column in record.columns.iter_mut().filter(|c| is_sensor(c)) {
        // Behind a step a prediction goes on with what is read: nothing says which level was the body's.
        let is_bad = |d: &&Suspicion| d.is_not_taken() && d.what != What::Jump && d.column == column.name;
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
    /// Its rows are misread or stand twice.
    fn misreads_rows(&self) -> bool {
        let misread =
            matches!(self.what, What::Doubled | What::Outliers | What::Stuck | What::Unplugged | What::Range);
        misread && !self.rows.is_empty()
    }

    /// It is about whole rows: of a response, a position or the row itself, not of one sensor. Such rows are in no figure.
    pub fn is_of_rows(&self) -> bool {
        self.misreads_rows() && !self.sensor
    }

    /// Of a sensor that did not take its reading: of these rows, or of all where there are none.
    pub(crate) fn is_not_taken(&self) -> bool {
        self.is_of_sensor()
            && (self.misreads_rows() || matches!(self.what, What::Unplugged | What::Stuck | What::Jump))
    }

    /// It leaves no row of its column:
    /// all are doubted, or one of the two levels that a step parts.
    fn is_of_column(&self) -> bool {
        self.rows.is_empty() || self.what == What::Jump
    }
}

/// What a fit should leave out.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Unusable {
    sensors: BTreeSet<String>,
    rows: BTreeMap<String, BTreeSet<usize>>,
}

/// What a fit should leave out after these suspicions.
/// Sensors that are no predictors in any record, and rows (those of a few bad readings among them). A unit, a sign or a direction is left
/// as it stands: what is right there only who measured can say.
pub fn unusable(suspicions: &[Suspicion]) -> Unusable {
    let mut out = Unusable::default();
    for s in suspicions {
        let off = matches!(
            s.what,
            What::Unplugged
                | What::Range
                | What::Stuck
                | What::Jump
                | What::Outliers
                | What::Unit
                | What::Swapped
        );
        if s.sensor && (off || s.what == What::Doubled) && !s.is_few() {
            out.sensors.insert(s.column.clone());
        } else if s.misreads_rows() {
            out.rows.entry(s.record.clone()).or_default().extend(s.row_list());
        }
    }
    out
}

impl Unusable {
    /// A temperature or channel of this name is no predictor.
    pub fn sensor(&self, name: &str) -> bool {
        self.sensors.contains(name)
    }

    /// The rows of a record that should be left out, from 0.
    pub fn rows(&self, record: &Record) -> Vec<usize> {
        let rows = self.rows.get(&record.path.display().to_string());
        rows.map(|r| r.iter().copied().filter(|i| *i < record.rows()).collect()).unwrap_or_default()
    }

    /// The record without its unusable rows, temperatures and channels.
    /// As it is where that would leave nothing.
    pub fn without(&self, record: &Record) -> Record {
        let out = self.rows(record);
        let keep: Vec<usize> = (0..record.rows()).filter(|i| out.binary_search(i).is_err()).collect();
        let mut left = if keep.is_empty() || out.is_empty() { record.clone() } else { record.select(&keep) };
        left.columns.retain(|c| !(is_sensor(c) && self.sensor(&c.name)));
        left
    }
}

/// A temperature or a channel: what a law may take as its cause by name.
fn is_sensor(column: &Column) -> bool {
    matches!(column.role, Role::Temperature | Role::Channel)
}
