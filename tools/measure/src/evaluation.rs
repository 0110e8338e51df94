//! Evaluates runs by the standard that fits them.
//! The results are a document for programs and a report for people.

use crate::gauge_resolution;
use crate::iso230::{self, PositioningOptions, StreamedDriftTest, TestConditions};
use crate::plausible::{self, Suspicion};
use crate::plot::PlotError;
use crate::report::{self, Report, ReportedRecord};
use crate::{Sink, ballbar, drilled_plate, run_record_files};
use rtec_files::text_file::short;
use rtec_files::{InputError, InputNotice, Result};
use rtec_model::record::{Column, Record, Role, RunKind, median, sha256_of};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

rtec_files::choice! {
    /// The evaluations and their names.
    pub enum Standard {
        Iso230_2 = "iso230-2", "Positioning: accuracy and repeatability; tilts too";
        Straightness = "straightness",
            "Straightness of an axis's motion: the error across it, about a least-squares line (ISO 230-1)";
        Iso230_3 = "iso230-3", "Thermal effects, phase by phase";
        Iso230_6 = "iso230-6", "Body or face diagonals";
        Ballbar = "ballbar", "Circular test, ISO 230-4";
        Plate = "plate", "Plate of holes: offset, scale, rotation, quadrupole";
        Repeatability = "repeatability", "Returning to one position: standard deviation and range per axis";
    }
}

impl Standard {
    /// The other name of the circular test.
    pub const CIRCULAR: (&'static str, &'static str) = ("iso230-4", "ballbar");

    /// The evaluation of this name, or of [`Standard::CIRCULAR`].
    pub fn parse(name: &str) -> Option<Self> {
        let name = if name == Self::CIRCULAR.0 { Self::CIRCULAR.1 } else { name };
        Self::ALL.iter().find(|all| all.0 == name).map(|all| all.1)
    }

    /// The evaluation for a record's kind.
    ///
    /// # Errors
    /// There is none.
    pub fn of(record: &Record) -> Result<Self> {
        match record.kind {
            // Errors across the moving axis only are straightness, not positioning.
            RunKind::Positioning if !iso230::has_positioning(record) && iso230::has_straightness(record) => {
                Ok(Self::Straightness)
            }
            RunKind::Positioning => Ok(Self::Iso230_2),
            RunKind::Drift => Ok(Self::Iso230_3),
            RunKind::Ballbar => Ok(Self::Ballbar),
            RunKind::Plate => Ok(Self::Plate),
            kind => {
                let expected = "--standard, as no evaluation belongs to this kind";
                Err(InputError::whole(&record.path, format!("a run of kind {}", kind.name()), expected))
            }
        }
    }

    /// Conditions that this evaluation does not use.
    fn unused(self, conditions: &TestConditions, records: &[Record]) -> Option<String> {
        let lengths = records.iter().flat_map(Record::responses).any(|c| matches!(c.role, Role::Error(_)));
        if matches!(self, Self::Iso230_2 | Self::Iso230_6) && lengths {
            // A scale alone is right with an interferometer. A workpiece is compared with a scale, and both
            // grow.
            let one = conditions.workpiece.is_some() && conditions.scale.is_none();
            let said = "[thermal] has a sensor of the workpiece alone: the scale is taken to be at 20 °C";
            return one.then(|| said.to_owned());
        }
        let thermal = conditions.scale.is_some() || conditions.workpiece.is_some();
        let parts = [
            thermal.then_some("[thermal]: nothing is reduced to 20 °C"),
            conditions.air.is_some().then_some("[air]: no length is corrected"),
        ];
        let mut said: Vec<String> = parts.into_iter().flatten().map(str::to_owned).collect();
        let keys = match self {
            Self::Ballbar | Self::Iso230_3 => conditions.not_in_budget(self == Self::Ballbar),
            _ => conditions.stated.keys().map(String::as_str).collect(),
        };
        if keys.len() == conditions.stated.len() && !keys.is_empty() {
            said.push("[uncertainty]: no figure has one".to_owned());
        } else if !keys.is_empty() {
            said.push(format!("[uncertainty] {}", keys.join(", ")));
        }
        let said = said.join(", ");
        (!said.is_empty()).then(|| format!("of the conditions this evaluation does not use {said}"))
    }
}

/// Options of an evaluation.
#[derive(Debug, Clone, Default)]
pub struct EvaluationRequest {
    /// The evaluation; `None`: the one for the first record's kind.
    pub standard: Option<Standard>,
    /// Conditions of the test.
    pub conditions: TestConditions,
    /// Positioning: accept targets approached from one side only.
    pub one_way: bool,
    /// Plates: minimise the sum of fourth powers instead of squares.
    pub fourth_powers: bool,
}

/// An evaluation.
#[derive(Debug, Clone)]
pub struct Evaluation {
    /// Document for programs.
    pub document: Value,
    /// Report for people.
    pub report: Report,
    /// Suspicions against the records.
    pub doubts: Vec<Suspicion>,
}

/// Evaluates runs by their standard; messages go to `say`.
///
/// # Errors
/// No record; a kind without a standard; data that the standard needs and the records lack; a bad sensor
/// needed for the reduction to 20 °C.
pub fn evaluate(records: &[Record], asked: &EvaluationRequest, say: Sink<'_>) -> Result<Evaluation> {
    let Some(first) = records.first() else {
        return Err(InputError::whole(Path::new("characterise evaluate"), "no record", "a record"));
    };
    let doubts = plausible::report_suspicions(records, say);
    reducible(&asked.conditions, &doubts)?;
    let standard = asked.standard.map_or_else(|| Standard::of(first), Ok)?;
    let usable = plausible::in_figures(records, &doubts);
    let left_out = doubts.iter().any(Suspicion::is_of_rows);
    let note = if left_out { "; the rows that look misread are in no figure" } else { "" };
    let (mut document, mut report) = evaluate_by(standard, &usable, asked, say)
        .map_err(|e| InputError { expected: e.expected + note, ..e })?;
    // No standard excludes rows, so the figures with all rows are given too.
    if left_out
        && let Ok((all, _)) =
            evaluate_by(standard, &plausible::every_row(records, &doubts), asked, &mut |_| ())
    {
        with_every_row(&mut document, &all, &mut report);
    }
    for [one, other] in plausible::exchanged(&doubts) {
        let (a, b, rows) = (&one.column, &other.column, &one.rows);
        report.warn(&format!(
            "{a} and {b} are put back into each other's place in rows {rows}: their ranges are those of one sensor each. Exchange the two \
             columns in these rows of the file; or in those before them, if the names are right here"
        ));
    }
    // Positioning and returns already report the resolution with their figures.
    let responses = !matches!(standard, Standard::Iso230_2 | Standard::Repeatability);
    for note in usable.iter().flat_map(|record| gauge_resolution::resolution_notes(record, responses)) {
        report.warn(&note);
    }
    if let Some(unused) = standard.unused(&asked.conditions, records) {
        report.warn(&unused);
    }
    Ok(doubted(&first.path, document, report, doubts, say))
}

/// As [`evaluate`], for records on file.
/// A drift test of more than [`MOST_ROWS`] rows without axis movement is read in pieces. Its figures are
/// those of the whole; suspicions are found per piece.
///
/// # Errors
/// As [`evaluate`], and as [`run_record_files::read`].
pub fn evaluate_files(paths: &[PathBuf], asked: &EvaluationRequest, say: Sink<'_>) -> Result<Evaluation> {
    if let [path] = paths
        && let Some(mut long) = long_drift(path, asked, MOST_ROWS)?
    {
        return in_pieces(path, &mut long, asked, MOST_ROWS, say);
    }
    evaluate(&paths.iter().map(|p| run_record_files::read(p)).collect::<Result<Vec<_>, _>>()?, asked, say)
}

/// Most rows of a drift test in memory: three days at one row per second.
pub const MOST_ROWS: usize = 1 << 18;

/// The evaluation of a drift test of more rows; `None` for other records.
fn long_drift(path: &Path, asked: &EvaluationRequest, more_than: usize) -> Result<Option<StreamedDriftTest>> {
    let drift = match asked.standard {
        Some(standard) => standard == Standard::Iso230_3,
        None => run_record_files::RecordPieceReader::of(path)?.is_some_and(|p| p.kind() == RunKind::Drift),
    };
    if drift { StreamedDriftTest::of(path, more_than) } else { Ok(None) }
}

fn in_pieces(
    path: &Path,
    long: &mut StreamedDriftTest,
    asked: &EvaluationRequest,
    most_rows: usize,
    say: Sink<'_>,
) -> Result<Evaluation> {
    // Pieces of equal length, so that none is too short for the checks.
    let pieces = long.rows.div_ceil(most_rows);
    let mut looked_at = plausible::LongRecordSuspicions::default();
    let rows_at_once = long.rows.div_ceil(pieces);
    let mut all = long.drift(rows_at_once, |piece| looked_at.see(piece))?;
    let doubts = looked_at.report_suspicions(say);
    reducible(&asked.conditions, &doubts)?;
    let every = all.clone();
    if doubts.iter().any(|d| d.is_of_rows() || d.is_not_taken()) {
        long.leave_out(&doubts)?;
        all = long.drift(rows_at_once, |_| ())?;
    }
    iso230::state_budget(&mut all, &asked.conditions);
    let head = &long.head;
    let ranges = long.ranges_degc().map(|(name, range)| (name.to_owned(), range)).collect();
    let csv = path.parent().unwrap_or(Path::new("")).join(&head.file);
    let run = ReportedRecord {
        rows: long.rows,
        sha256: sha256_of(&csv)?,
        ranges_degc: ranges,
        ..ReportedRecord::of(head)
    };
    let mut document = figures(path, "axes", &all)?;
    let mut report = drawn(path, report::drift(&all, &run, long.charts(), &asked.conditions))?;
    if doubts.iter().any(Suspicion::is_of_rows) {
        with_every_row(&mut document, &figures(path, "axes", &every)?, &mut report);
    }
    if let Some(unused) = Standard::Iso230_3.unused(&asked.conditions, &[]) {
        report.warn(&unused);
    }
    report.warn(&format!(
        "mistakes are looked for in {pieces} pieces of its rows, each by itself: what shows only beside another one (rows of one that \
         stand once more in another) is not found"
    ));
    Ok(doubted(path, document, report, doubts, say))
}

/// The figures for programs: one as it is, several as a list under a name.
fn figures(file: &Path, name: &str, all: &[impl serde::Serialize]) -> Result<Value> {
    let written = match all {
        [one] => serde_json::to_value(one),
        all => serde_json::to_value(all).map(|list| json!({ name: list })),
    };
    written.map_err(|e| InputError::whole(file, e.to_string(), "figures that can be written"))
}

fn drawn(file: &Path, report: Result<Report, PlotError>) -> Result<Report> {
    report.map_err(|e| InputError::whole(file, e.to_string(), "figures that can be drawn"))
}

/// An evaluation with the suspicions against its records.
/// Reports the warnings of the report.
fn doubted(
    file: &Path,
    mut document: Value,
    mut report: Report,
    doubts: Vec<Suspicion>,
    say: Sink<'_>,
) -> Evaluation {
    for doubt in &doubts {
        report.doubt(&doubt.to_string(), doubt.is_of_rows());
    }
    for warning in report.warnings().iter().skip(doubts.len()) {
        say(InputNotice::Warning(format!("{}: {warning}", file.display())));
    }
    if doubts.iter().any(Suspicion::is_of_rows) {
        say(InputNotice::Warning(report::LEFT_OUT.to_owned()));
    }
    plausible::enter(&mut document, &doubts);
    Evaluation { document, report, doubts }
}

/// Enters figures that differ with all rows as `with_every_row`; warns of some.
fn with_every_row(document: &mut Value, all: &Value, report: &mut Report) {
    let (own, every) = (single_figures("", document), single_figures("", all));
    let differs = |(name, with): (String, f64)| {
        let without = own.iter().find(|(n, _)| *n == name)?.1;
        (!is_same_figure(with, without)).then_some((name, with, without))
    };
    let differing: Vec<(String, f64, f64)> = every.into_iter().filter_map(differs).collect();
    let words = |(name, with, without): &(String, f64, f64)| {
        let [with, without] = [with, without].map(|v| format!("{v:.3}"));
        (with != without).then(|| format!("{name} {with} instead of {without}"))
    };
    let words: Vec<String> = differing.iter().filter_map(words).take(MOST_BESIDE).collect();
    if words.is_empty() {
        return;
    }
    let more = if differing.len() > words.len() { ", …" } else { "" };
    report.warn(&format!("with every row the figures would be: {}{more}", words.join(", ")));
    if let Value::Object(map) = document {
        let figures = differing.into_iter().map(|(name, with, _)| (name, json!(with))).collect();
        map.insert("with_every_row".to_owned(), Value::Object(figures));
    }
}

/// Relative difference up to which figures are the same.
const SAME: f64 = 1e-9;

/// Whether two figures differ at most by the order of summation.
pub(crate) fn is_same_figure(one: f64, other: f64) -> bool {
    (one - other).abs() <= SAME * one.abs().max(other.abs())
}

/// Most figures in the warning about rows left out; the document has all.
const MOST_BESIDE: usize = 8;

/// The numbers of a document by their path, such as `x.A`.
/// Lists are left out unless named by axis or response.
fn single_figures(place: &str, value: &Value) -> Vec<(String, f64)> {
    let under = |name: &str| if place.is_empty() { name.to_owned() } else { format!("{place}.{name}") };
    match value {
        Value::Number(number) => number.as_f64().map(|n| (place.to_owned(), n)).into_iter().collect(),
        Value::Object(map) => map.iter().flat_map(|(name, v)| single_figures(&under(name), v)).collect(),
        Value::Array(list) if ["axes", "motions", "planes"].contains(&place) => {
            let name = |v: &Value, n: usize| {
                let own = ["response", "plane", "axis"].iter().find_map(|key| v[key].as_str());
                own.map_or_else(|| n.to_string(), str::to_owned)
            };
            list.iter().enumerate().flat_map(|(n, v)| single_figures(&name(v, n), v)).collect()
        }
        _ => Vec::new(),
    }
}

/// Refuses a bad sensor, which would spoil every figure reduced to 20 °C.
fn reducible(conditions: &TestConditions, doubts: &[Suspicion]) -> Result<()> {
    let bodies = [&conditions.scale, &conditions.workpiece].into_iter().flatten();
    let bodies = bodies.map(|body| (body.sensor.as_str(), "[thermal]", "reduced to 20 °C"));
    let air = conditions.air.iter().filter_map(|air| match &air.temperature {
        iso230::AirTemperatureSource::Sensor(sensor) => {
            Some((sensor.as_str(), "[air]", "corrected for the air"))
        }
        iso230::AirTemperatureSource::Degc(_) => None,
    });
    for (sensor, table, why) in bodies.chain(air) {
        if let Some(doubt) = doubts.iter().find(|d| d.is_of_sensor() && d.column == sensor) {
            let Suspicion { record, what, text, .. } = doubt;
            let found = format!("{sensor}: {what}: {text}, and lengths are to be {why} with it");
            let expected = format!(
                "another sensor in {table} of the conditions, a record without those rows, or no {table}"
            );
            return Err(InputError::whole(Path::new(record), found, expected));
        }
    }
    Ok(())
}

/// The only record of an evaluation that takes one at a time.
fn single(records: &[Record]) -> Result<&Record> {
    match records {
        [_, second, ..] => {
            let found = format!("{} records", records.len());
            Err(InputError::whole(&second.path, found, "one record at a time by this standard"))
        }
        one => Ok(&one[0]),
    }
}

fn evaluate_by(
    standard: Standard,
    records: &[Record],
    asked: &EvaluationRequest,
    say: Sink<'_>,
) -> Result<(Value, Report)> {
    let file = &records[0].path;
    let options = PositioningOptions { one_way: asked.one_way, conditions: asked.conditions.clone() };
    let conditions = &asked.conditions;
    Ok(match standard {
        Standard::Iso230_2 => {
            let mut all = Vec::new();
            for record in records {
                all.extend(iso230::positioning_with(record, &options).map_err(|e| {
                    // If only the conditions are wrong, the record is one of positioning.
                    let bare = PositioningOptions { one_way: asked.one_way, ..PositioningOptions::default() };
                    let is_other = iso230::positioning_with(record, &bare).is_err();
                    let hint = "; where the machine only returned to one position, --standard repeatability";
                    InputError { expected: e.expected + if is_other { hint } else { "" }, ..e }
                })?);
            }
            for record in records.iter().filter(|r| iso230::has_straightness(r)) {
                say(InputNotice::Note(format!(
                    "{}: errors across the moving axis too: --standard straightness evaluates them",
                    record.path.display()
                )));
            }
            (figures(file, "axes", &all)?, drawn(file, report::positioning(&all, records, conditions))?)
        }
        Standard::Straightness => {
            let record = single(records)?;
            let all = iso230::straightness(record)?;
            (figures(file, "motions", &all)?, drawn(file, report::straightness(&all, record, conditions))?)
        }
        Standard::Iso230_3 => {
            let record = single(records)?;
            let mut all = iso230::drift(record)?;
            iso230::state_budget(&mut all, conditions);
            let charts = iso230::drift_charts(record);
            let mut report =
                drawn(file, report::drift(&all, &ReportedRecord::of(record), charts, conditions))?;
            if let Some(gap) = gaps(record) {
                report.warn(&gap);
            }
            (figures(file, "axes", &all)?, report)
        }
        Standard::Iso230_6 => {
            let found = iso230::diagonals(records, &options)?;
            let report = drawn(file, report::diagonals(&found, records, conditions))?;
            (figures(file, "", &[found])?, report)
        }
        Standard::Ballbar => {
            let mut planes = ballbar::evaluate(records)?;
            for b in &mut planes {
                b.uncertainty = conditions.circle_budget(b.radius_mm, b.diagnosis.scatter_um);
                if b.uncertainty.as_ref().is_some_and(|u| u.length_um.is_none()) {
                    let why = "it needs one radius; state radius_mm in the sidecar, and evaluate each radius by itself";
                    b.warnings.push(format!("no uncertainty of F and D: {why}"));
                }
            }
            (figures(file, "planes", &planes)?, drawn(file, report::ballbar(&planes, records, conditions))?)
        }
        Standard::Plate => {
            let record = single(records)?;
            let norm = if asked.fourth_powers {
                drilled_plate::PlateFitLoss::Fourth
            } else {
                drilled_plate::PlateFitLoss::Squares
            };
            let found = drilled_plate::evaluate(record, norm)?;
            let report = drawn(file, report::plate(&found, record, conditions))?;
            (figures(file, "", &[found])?, report)
        }
        Standard::Repeatability => returns(single(records)?, conditions)?,
    })
}

fn returns(record: &Record, conditions: &TestConditions) -> Result<(Value, Report)> {
    let axes = iso230::returns(record);
    if axes.is_empty() {
        let expected = "a column of role error.AXIS with two returns at least";
        return Err(InputError::whole(&record.path, "nothing that returned twice", expected));
    }
    let found = figures(&record.path, "", &[&axes])?;
    let mut report = drawn(&record.path, report::repeatability(&axes, record, conditions))?;
    for (axis, of) in axes.iter().filter(|(_, of)| of.is_trend()) {
        let (s, about) = match of.s_of_neighbours_um.filter(|_| of.is_bent()) {
            Some(s) => (s, "from one return to the next"),
            None => (of.s_about_trend_um.unwrap_or(0.0), "about it"),
        };
        report.warn(&format!(
            "error.{axis}: the returns drift by {:+.2} ± {:.2} µm a return ({:+.1} µm in all): s and the range hold that drift; {about} the returns scatter by s = {s:.2} µm, which is the repeatability",
            of.trend_um_per_return,
            of.trend_standard_error_um.unwrap_or(0.0),
            of.trend_um_per_return * (of.returns - 1) as f64,
        ));
    }
    for (axis, of) in &axes {
        if let Some(turns) = of.turns.filter(|_| of.step.is_none()) {
            report.warn(&format!(
                "error.{axis}: every {} returns the same comes again, over {:.2} µm: s and the range hold that; about those means the \
                 returns scatter by s = {:.2} µm. What takes turns there (direction of approach, gripper, side of the tool)?",
                turns.every, turns.range_um, turns.s_about_them_um
            ));
        }
        let Some(step) = of.step else { continue };
        let drift = step.drift_um_per_return.map_or_else(String::new, |slope| {
            format!(" Beside it they drift by {slope:+.2} µm a return, which that s does not hold.")
        });
        report.warn(&format!(
            "error.{axis}: the returns step by {:+.2} ± {:.2} µm at row {} and stay: s and the range hold that step; before and behind it the \
             returns scatter by s = {:.2} µm, which is the repeatability.{drift} A step is no drift: look for what moved there (tool, \
             gauge, chip, lost counts)",
            step.um, step.standard_error_um, step.row, step.s_about_step_um,
        ));
    }
    let coarse = |column: &Column| {
        let (step, of) =
            (gauge_resolution::step_of(&column.data)?, iso230::ReturnRepeatability::of(&column.data)?);
        let s_um = of.s_about_trend_um.unwrap_or(of.s_um);
        (s_um < step).then(|| (column.role.to_string(), short(step)))
    };
    for (role, step) in record.responses().filter_map(coarse) {
        report.warn(&format!(
            "{role}: readings in steps of {step} µm, and the returns scatter by less: scatter below a step does not show; a finer gauge shows it"
        ));
    }
    let is_constant = |c: &&Column| c.data.windows(2).all(|w| w[0].to_bits() == w[1].to_bits());
    for column in record.responses().filter(|c| c.data.len() > 1).filter(is_constant) {
        // All are within one step of the gauge; their deviation is largest with half at each end.
        let n = column.data.len() as f64;
        let hides = |step: f64| {
            let (step, s_um) = (short(step), 0.5 * step * (n / (n - 1.0)).sqrt());
            format!(" a step of {step} µm, as they are written, hides s up to {s_um:.2} µm;")
        };
        let most = record.count_um.or_else(|| written_step(column.data[0])).map_or_else(String::new, hides);
        report.warn(&format!(
            "{}: all {} returns read {}: s = 0 is the gauge's step, no repeatability;{most} a finer gauge shows it",
            column.role, column.data.len(), short(column.data[0])
        ));
    }
    Ok((found, report))
}

/// The decimal step that a reading is written in; `None` for zero.
fn written_step(reading: f64) -> Option<f64> {
    let text = format!("{reading}");
    let decimals = text.split_once('.').map_or(0, |(_, decimals)| decimals.len());
    (reading != 0.0).then(|| 0.1_f64.powi(decimals as i32))
}

/// A pause in a log is a gap above this multiple of the usual time step.
const GAP: f64 = 5.0;
/// Shorter gaps do not affect a figure of a thermal test, s.
const SHORTEST_GAP_S: f64 = 300.0;

/// The longest gap in an evenly logged record, as a message.
fn gaps(record: &Record) -> Option<String> {
    let time = record.data(&Role::Time)?;
    let steps: Vec<f64> = time.windows(2).map(|w| w[1] - w[0]).collect();
    let at = (0..steps.len()).max_by(|a, b| steps[*a].total_cmp(&steps[*b]))?;
    let (longest, usual) = (steps[at], median(steps.iter().copied()));
    let many = steps.iter().filter(|s| **s > GAP * usual).count();
    let is_pause =
        usual > 0.0 && longest > GAP * usual && longest >= SHORTEST_GAP_S && 10 * many <= steps.len();
    let [from, to] = [time[at], time[at + 1]].map(|s| s / 60.0);
    is_pause.then(|| {
        format!(
            "no rows from {from:.0} to {to:.0} min, where they are {usual:.0} s apart: what went on there is in no figure, nor in d60 and \
             the last hour"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plausible::MistakeKind;
    use std::fmt::Write as _;

    /// A drift test on file: rest, spindle with pauses, rest; uneven times.
    /// `spoilt` changes rows.
    fn drift(folder: &Path, rows: usize, spoilt: impl Fn(usize, &mut [f64; 7])) -> PathBuf {
        let mut csv = "t,rpm,z,T1,T2,e,f\n".to_owned();
        let mut dice = 1_u64;
        let mut noise = || {
            dice = dice.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (dice >> 40) as f64 / f64::from(1 << 24) - 0.5
        };
        for row in 0..rows {
            let (part, t) = (row as f64 / rows as f64, row as f64 * 7.0 + (row % 5) as f64);
            let turns = (0.3..0.7).contains(&part) && row % 97 > 5;
            let warm = if part < 0.3 { 0.0 } else { 1.0 - (-(part - 0.3) * 4.0).exp() };
            let rpm = if turns { 3000.0 + (row % 7) as f64 * 40.0 } else { 0.0 };
            let (t1, t2) = (20.0 + 9.0 * warm + 0.05 * noise(), 21.0 + 2.0 * part + 0.05 * noise());
            let mut cells = [t, rpm, 5.0, t1, t2, 30.0 * warm + noise(), -4.0 * warm + noise()];
            spoilt(row, &mut cells);
            let line: Vec<String> = cells.iter().map(f64::to_string).collect();
            let _ = writeln!(csv, "{}", line.join(","));
        }
        std::fs::write(folder.join("d.csv"), csv).unwrap();
        let sidecar = "file = \"d.csv\"\nkind = \"drift\"\ndate = 2026-05-01\nnote = \"gantry\"\n[columns]\n\
                       t = { role = \"time\", unit = \"s\" }\nrpm = { role = \"spindle_speed\", unit = \"rpm\" }\n\
                       z = { role = \"position.z\", unit = \"mm\" }\nT1 = { role = \"temperature\", unit = \"degC\" }\n\
                       T2 = { role = \"temperature\", unit = \"degC\" }\ne = { role = \"error.z\", unit = \"um\" }\n\
                       f = { role = \"error.x\", unit = \"um\" }\n";
        let path = folder.join("d.run.toml");
        std::fs::write(&path, sidecar).unwrap();
        path
    }

    fn pieces(path: &Path, most_rows: usize) -> (Evaluation, Vec<String>) {
        let (asked, mut said) = (EvaluationRequest::default(), Vec::new());
        let mut long = long_drift(path, &asked, most_rows).unwrap().unwrap();
        let found = in_pieces(path, &mut long, &asked, most_rows, &mut |s| said.push(s.to_string()));
        (found.unwrap(), said)
    }

    fn held(path: &Path) -> Evaluation {
        evaluate(&[run_record_files::read(path).unwrap()], &EvaluationRequest::default(), &mut |_| ())
            .unwrap()
    }

    /// Reading piece by piece gives the same figures, phases, tables and plots.
    #[test]
    fn a_long_drift_is_evaluated_as_a_short_one() {
        let folder = tempfile::tempdir().unwrap();
        for rows in [1201, 5000] {
            let path = drift(folder.path(), rows, |_, _| ());
            let whole = held(&path);
            assert_eq!(whole.doubts, []);
            assert_eq!(
                whole.document["axes"][1]["phases"].as_array().map(Vec::len),
                Some(3),
                "{}",
                whole.document
            );
            for most_rows in [400, 1200] {
                let (found, said) = pieces(&path, most_rows);
                assert_eq!(found.document.to_string(), whole.document.to_string());
                assert_eq!(found.report.text(), whole.report.text());
                assert!(found.report.plots().eq(whole.report.plots()));
                // The rest of the page differs only by the warning about pieces.
                let [warning] = found.report.warnings() else { panic!("{:?}", found.report.warnings()) };
                assert_eq!(said, [format!("warning: {}: {warning}", path.display())]);
                let html = found.report.html().replace(&format!("<p class=\"warn\">{warning}</p>"), "");
                assert_eq!(html, whole.report.html());
            }
        }
    }

    /// A suspicion keeps its rows in any piece. One in all pieces is one of the record.
    #[test]
    fn mistakes_in_a_long_drift_are_found_piece_by_piece() {
        let folder = tempfile::tempdir().unwrap();
        let path = drift(folder.path(), 4000, |row, cells| {
            cells[3] += 273.15;
            cells[4] = if row >= 3900 { 999.9 } else { cells[4] };
            cells[6] += if row == 2500 { 500.0 } else { 0.0 };
        });
        let (found, said) = pieces(&path, 1000);
        let doubts: Vec<(&str, MistakeKind, &str)> =
            found.doubts.iter().map(|d| (d.column.as_str(), d.what, d.rows.as_str())).collect();
        let want = [
            ("T1", MistakeKind::Unit, ""),
            ("f", MistakeKind::Outliers, "2501"),
            ("T2", MistakeKind::Unplugged, "3901-4000"),
        ];
        assert_eq!(doubts, want, "{said:?}");
        assert!(said.iter().any(|s| s.contains("in 4 pieces")), "{said:?}");
        assert_eq!(found.document["suspicions"].as_array().map(Vec::len), Some(3));
    }

    /// Records that need all rows at once are not split.
    /// Few rows, a moving axis, another kind, no time.
    #[test]
    fn what_cannot_be_cut_is_held() {
        let folder = tempfile::tempdir().unwrap();
        let is_long = |path: &Path, most_rows: usize| {
            long_drift(path, &EvaluationRequest::default(), most_rows).unwrap().is_some()
        };
        let path = drift(folder.path(), 1000, |_, _| ());
        assert!(is_long(&path, 999) && !is_long(&path, 1000));
        let sidecar = std::fs::read_to_string(&path).unwrap();
        for (from, to) in
            [("\"drift\"", "\"positioning\""), ("\"time\", unit = \"s\"", "\"channel\", unit = \"s\"")]
        {
            std::fs::write(&path, sidecar.replace(from, to)).unwrap();
            assert!(!is_long(&path, 999), "{to}");
        }
        // A move from the last row of one piece to the first of the next one.
        let path = drift(folder.path(), 9000, |row, cells| cells[2] += if row < 4096 { 0.0 } else { 1.0 });
        assert!(!is_long(&path, 999));
        let path = drift(folder.path(), 9000, |row, cells| cells[2] += if row < 4096 { 0.0 } else { 0.005 });
        assert!(is_long(&path, 999));
    }
}
