//! The post-process loop: a measured batch against nominal.
//! The batch comes from a coordinate measuring machine. Systematic errors are offered as a change, with their
//! statistics; nothing is applied (NISTIR 4854, section 1).

use crate::error_cor_file::{MOST_RAD, MOST_UM, PointError, turned_near};
use crate::geometric_fit::sd;
use crate::part_error_request::is_times;
use crate::reading_resolution::{left_in_mean, written_step_mm};
use rtec_files::{ColumnAssignment, CsvTable, InputError};
use rtec_model::record::{mean, span};
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};
use std::collections::BTreeMap;
use std::path::Path;

/// Errors at one place of one feature over the batch, in the order of the parts.
#[derive(Debug, Clone)]
struct PlaceErrorSeries {
    feature: String,
    angle_rad: Option<f64>,
    errors_um: Vec<f64>,
    /// The sheet's row of each error.
    rows: Vec<usize>,
    /// Indices in `errors_um` of readings that are left out of the figures.
    wild: Vec<usize>,
}

impl PlaceErrorSeries {
    fn kept(&self) -> Vec<(usize, f64)> {
        let is_kept = |(k, _): &(usize, f64)| !self.wild.contains(k);
        self.errors_um.iter().copied().enumerate().filter(is_kept).collect()
    }
}

/// A reading far from those of the other parts at its place; it is left out.
#[derive(Debug, Clone, Serialize)]
pub struct OutlierReading {
    /// The part, as the file has it.
    pub part: String,
    /// Line of the file, from 1.
    pub line: usize,
    /// Its error, in µm.
    pub error_um: f64,
}

/// The figures of a place with every reading.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct StatisticsWithOutliers {
    /// Mean error, in µm.
    pub mean_um: f64,
    /// Sample standard deviation, in µm.
    pub sd_um: f64,
}

/// The finding for a place of a batch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PlaceFinding {
    /// No error beyond chance and beyond the smallest that matters.
    Nothing,
    /// The same error on every part, and probing on the machine confirms it.
    /// It is also used if no probing was given.
    Systematic,
    /// The same error on every part, but probing on the machine does not see it.
    /// Tool and probe then follow the same wrong path.
    NotObservable,
    /// The error changes along the batch: wear, or the machine's temperature.
    Trend,
    /// The error changes between two parts: another tool, offset or material.
    Step,
}

/// A step of a place's errors between two parts.
#[derive(Debug, Clone, Serialize)]
pub struct ErrorStepBetweenParts {
    /// The first part after the step, as the file has it.
    pub part: String,
    /// The size of the step, in µm.
    pub um: f64,
    /// Standard deviation about the means on either side, in µm.
    pub sd_about_um: f64,
    /// Probability of such a step by chance.
    /// Two-sided t-test, corrected for the parts that it may lie between and for all places.
    pub p_value: f64,
}

/// The statistics of one place.
#[derive(Debug, Clone, Serialize)]
pub struct PlaceStatistics {
    /// Name of the feature, as the file has it.
    pub feature: String,
    /// Angle on the feature from the part's +Z, if the file gives one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub angle_rad: Option<f64>,
    /// Number of parts whose reading at this place is in the figures.
    pub parts: usize,
    /// Mean error, in µm.
    pub mean_um: f64,
    /// Sample standard deviation, in µm.
    pub sd_um: f64,
    /// 95 % interval of the mean, in µm.
    /// `None` if all readings of the batch are 0: what rounding hides is then unknown.
    pub interval_um: Option<[f64; 2]>,
    /// Probability of a mean this far from 0 by chance.
    /// It is from a two-sided t-test with Holm's correction over all places.
    pub p_value: f64,
    /// Change from part to part, in µm.
    pub trend_um_per_part: f64,
    /// Standard error of that change, in µm.
    pub trend_standard_error_um: f64,
    /// Standard deviation about that change, in µm: the parts' scatter without it.
    pub sd_about_trend_um: f64,
    /// Probability of that change by chance, with the same correction.
    pub trend_p_value: f64,
    /// The error that probing on the machine found there, in µm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seen_on_machine_um: Option<f64>,
    /// A step beyond chance, if it explains the change better than a straight line.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub step: Option<ErrorStepBetweenParts>,
    /// Readings that are left out of the figures.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<OutlierReading>,
    /// The figures with those readings included.
    #[serde(rename = "with_every_row", skip_serializing_if = "Option::is_none")]
    pub with_every_reading: Option<StatisticsWithOutliers>,
    /// The finding that follows from the statistics.
    pub finding: PlaceFinding,
}

// The documentation of the fields is the help of `rtecctl part post-process`.
/// The strictness of the judgement
#[derive(Debug, Clone, Copy)]
#[cfg_attr(feature = "clap", derive(clap::Args))]
pub struct SignificanceLimits {
    /// False-alarm rate over all places together
    #[cfg_attr(feature = "clap", arg(long, default_value_t = 0.01))]
    pub alpha: f64,
    /// Mean errors below this do not matter, in µm
    #[cfg_attr(feature = "clap", arg(long, default_value_t = 1.0))]
    pub least_um: f64,
}

/// A change of one feature's table.
#[derive(Debug, Clone, Serialize)]
pub struct ProposedCorrection {
    /// Name of the feature, as the file has it.
    pub feature: String,
    /// The error to add at an angle.
    #[serde(flatten)]
    pub error: PointError,
}

/// A batch of parts, judged place by place.
#[derive(Debug, Clone, Serialize)]
pub struct BatchEvaluation {
    /// Every place, features and angles ascending.
    pub places: Vec<PlaceStatistics>,
    /// Systematic errors by angle, to be added to the table if the user decides so.
    pub offer_table: Vec<ProposedCorrection>,
    /// The offered changes in words, with the person concerned.
    pub offers: Vec<String>,
    /// Step in which the errors are written, µm, if the parts scatter by less.
    /// The interval of a mean includes its rounding. A mean below half a step is not systematic.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub step_um: Option<f64>,
    /// How the file's format differs from the usual one.
    #[serde(skip)]
    pub written: Option<String>,
}

/// Evaluates a batch from a file, with columns that the user has assigned.
/// The columns are `part,feature,error_um[,angle_rad]` or `part,feature,nominal_mm,measured_mm[,angle_rad]`.
/// Words are such as `feature=2` or `measured_mm=Ist`. Without words the columns have their own names.
/// `seen` are the errors that probing on the machine found on the same feature.
///
/// # Errors
/// A bad file, an invalid word or a missing column. A place measured twice on one part; fewer than three
/// parts at a place; other features besides the one that was `seen`.
pub fn evaluate_columns(
    file: &Path,
    columns: &[String],
    seen: Option<&[PointError]>,
    judgement: SignificanceLimits,
) -> Result<BatchEvaluation, InputError> {
    let columns = ColumnAssignment::parse(columns, &COLUMNS, |_| false)?;
    judge(file, &CsvTable::read_columns(file, &COLUMNS, |_| false, &columns)?, seen, judgement)
}

/// As [`evaluate_columns`], from text already in memory; `file` only names it.
///
/// # Errors
/// As [`evaluate_columns`].
pub fn evaluate_text(
    file: &Path,
    text: &str,
    seen: Option<&[PointError]>,
    judgement: SignificanceLimits,
) -> Result<BatchEvaluation, InputError> {
    judge(file, &CsvTable::parse(file, text, &COLUMNS, |_| false)?, seen, judgement)
}

const COLUMNS: [&str; 6] = ["part", "feature", "angle_rad", "error_um", "nominal_mm", "measured_mm"];

fn judge(
    file: &Path,
    sheet: &CsvTable,
    seen: Option<&[PointError]>,
    judgement: SignificanceLimits,
) -> Result<BatchEvaluation, InputError> {
    let mut series = read(file, sheet)?;
    let places = series.len();
    for s in &mut series {
        s.wild = wild(&s.errors_um, places);
    }
    if let (Some(_), Some(other)) = (seen, series.iter().find(|s| s.feature != series[0].feature)) {
        let found = format!("the features {} and {}", series[0].feature, other.feature);
        return Err(InputError::whole(file, found, "the one that was inspected: its rows alone"));
    }
    let largest_seen = seen.into_iter().flatten().map(|e| e.error_um.abs()).fold(0.0, f64::max);
    if is_other_unit(largest_seen) {
        let found = format!("inspected errors of {largest_seen} µm at most beside it");
        return Err(InputError::whole(file, found, OTHER_UNIT));
    }
    let parts = sheet.words("part")?;
    let errors_mm: Vec<f64> =
        series.iter().flat_map(PlaceErrorSeries::kept).map(|(_, um)| um / 1000.0).collect();
    let step_um = written_step_mm(&errors_mm).map_or(0.0, |mm| 1000.0 * mm);
    let is_step_seen = errors_mm.iter().any(|mm| *mm != 0.0);
    let mut places: Vec<PlaceStatistics> = series
        .iter()
        .map(|s| {
            let reading = |k: &usize| OutlierReading {
                part: parts[s.rows[*k]].clone(),
                line: sheet.line(s.rows[*k]),
                error_um: s.errors_um[*k],
            };
            let step = step(&s.kept(), step_um, |k| parts[s.rows[k]].clone());
            PlaceStatistics { left_out: s.wild.iter().map(reading).collect(), step, ..statistics(s, seen) }
        })
        .collect();
    if seen.is_some() && places.iter().all(|p| p.seen_on_machine_um.is_none()) {
        let ends = |angles: &mut dyn Iterator<Item = f64>| {
            let [low, high] = span(angles);
            if low > high { "no angle".to_owned() } else { format!("angle_rad {low:.3} to {high:.3}") }
        };
        let found = ends(&mut places.iter().filter_map(|p| p.angle_rad));
        let inspected = ends(&mut seen.into_iter().flatten().map(|e| e.angle_rad));
        let expected = format!("places that were inspected, {inspected}, within 0.05 rad");
        return Err(InputError::whole(file, found, expected));
    }
    let rounding = |p: &PlaceStatistics| if step_um > 0.0 { left_in_mean(step_um, p.sd_um) } else { 0.0 };
    let is_coarse = step_um > LEAST_TOLD_UM && places.iter().any(|p| p.sd_um < step_um);
    for p in &mut places {
        let rounding = rounding(p);
        p.interval_um = p.interval_um.filter(|_| is_step_seen).map(|[l, h]| [l - rounding, h + rounding]);
    }
    let means: Vec<f64> = places.iter().map(|p| p.p_value).collect();
    let trends: Vec<f64> = places.iter().map(|p| p.trend_p_value).collect();
    let steps: Vec<f64> = places.iter().map(|p| p.step.as_ref().map_or(1.0, |s| s.p_value)).collect();
    let (means, trends, steps) = (holm(&means), holm(&trends), holm(&steps));
    for (i, p) in places.iter_mut().enumerate() {
        (p.p_value, p.trend_p_value) = (means[i], trends[i]);
        let step = p.step.take().map(|s| ErrorStepBetweenParts { p_value: steps[i], ..s });
        p.step = step.filter(|s| s.p_value < judgement.alpha);
        let drift_um = (p.trend_um_per_part * (p.parts - 1) as f64).abs();
        p.finding = if p.step.as_ref().is_some_and(|s| s.um.abs() > judgement.least_um) {
            PlaceFinding::Step
        } else if p.trend_p_value < judgement.alpha && drift_um > judgement.least_um {
            PlaceFinding::Trend
        } else if p.p_value < judgement.alpha && p.mean_um.abs() > judgement.least_um.max(rounding(p)) {
            // Probing sees the error if it finds at least half of it, with its sign.
            match p.seen_on_machine_um {
                Some(on_machine) if on_machine / p.mean_um < 0.5 => PlaceFinding::NotObservable,
                _ => PlaceFinding::Systematic,
            }
        } else {
            PlaceFinding::Nothing
        };
    }
    let proposed = |p: &PlaceStatistics| {
        let error = PointError { angle_rad: p.angle_rad?, error_um: p.mean_um, along_mm: None };
        Some(ProposedCorrection { feature: p.feature.clone(), error })
    };
    let systematic = places.iter().filter(|p| p.finding == PlaceFinding::Systematic);
    let offer_table = systematic.filter_map(proposed).collect();
    let offers = places.iter().filter_map(offer).collect();
    Ok(BatchEvaluation {
        places,
        offer_table,
        offers,
        step_um: is_coarse.then_some(step_um),
        written: sheet.written(),
    })
}

fn read(file: &Path, sheet: &CsvTable) -> Result<Vec<PlaceErrorSeries>, InputError> {
    let (parts, features) = (sheet.words("part")?, sheet.words("feature")?);
    let angles = sheet.optional("angle_rad")?;
    let given = sheet.optional("error_um")?;
    let worked_out = |nominal: Vec<f64>| -> Result<Vec<f64>, InputError> {
        let measured = sheet.numbers("measured_mm")?;
        // No part has such an error: one value is a radius, the other a diameter.
        let is_double =
            |row: &usize| [2.0, 0.5].iter().any(|times| is_times(measured[*row] / nominal[*row], *times));
        if let Some(row) = (0..measured.len()).find(is_double) {
            let found = format!("{} mm measured where {} mm is nominal", measured[row], nominal[row]);
            return Err(sheet.finding(row, found, "both as radii, or both as diameters"));
        }
        Ok(measured.iter().zip(nominal).map(|(m, n)| (m - n) * 1e3).collect())
    };
    let errors = match (given, sheet.optional("nominal_mm")?) {
        (Some(given), Some(nominal)) if sheet.names().iter().any(|n| n == "measured_mm") => {
            let errors = worked_out(nominal)?;
            if let Some(row) = (0..given.len()).find(|&k| (given[k] - errors[k]).abs() > ROUNDING_UM) {
                let (given, own) = (given[row], errors[row]);
                let found = format!("an error_um of {given} beside measured minus nominal of {own:.3} µm");
                let expected = "the same error, measured minus nominal; or one of the two alone";
                return Err(sheet.finding(row, found, expected));
            }
            given
        }
        (Some(given), _) => given,
        (None, _) => worked_out(sheet.numbers("nominal_mm")?)?,
    };
    let degrees = format!("angles in rad, within ±{MOST_RAD}; are these degrees?");
    for (name, column, most, expected) in [
        ("error", Some(&errors), MOST_UM, format!("errors within ±{MOST_UM} µm: more is another part")),
        ("angle", angles.as_ref(), MOST_RAD, degrees),
    ] {
        if let Some((row, v)) = column.and_then(|c| c.iter().enumerate().find(|(_, v)| v.abs() > most)) {
            return Err(sheet.finding(row, format!("a larger {name}, {v}"), expected));
        }
    }
    let largest = errors.iter().map(|e| e.abs()).fold(0.0, f64::max);
    if is_other_unit(largest) {
        let found = format!("errors of {largest} µm at most");
        return Err(InputError::whole(file, found, OTHER_UNIT));
    }
    // One name in two spellings would become two features, each with some of the rows.
    let mut spelled: BTreeMap<String, &str> = BTreeMap::new();
    for (row, name) in features.iter().enumerate() {
        if let Some(other) = spelled.insert(name.trim().to_lowercase(), name).filter(|other| other != name) {
            let expected = "one spelling of one feature";
            return Err(sheet.finding(row, format!("the feature {name:?} beside {other:?}"), expected));
        }
    }
    // Angles are keys in microradians, so that a repeated angle is the same place.
    let mut groups: BTreeMap<(String, i64), PlaceErrorSeries> = BTreeMap::new();
    for row in 0..sheet.len() {
        let angle_rad = angles.as_ref().map(|a| a[row]);
        let key = (features[row].clone(), angle_rad.map_or(0, |a| (a * 1e6).round() as i64));
        let series = groups.entry(key).or_insert_with(|| {
            let (feature, errors_um) = (features[row].clone(), Vec::new());
            PlaceErrorSeries { feature, angle_rad, errors_um, rows: Vec::new(), wild: Vec::new() }
        });
        if series.rows.iter().any(|other| parts[*other] == parts[row]) {
            let found = format!("part {} measured twice at {}", parts[row], features[row]);
            return Err(sheet.finding(row, found, "every place once on each part"));
        }
        series.errors_um.push(errors[row]);
        series.rows.push(row);
    }
    if let Some(few) = groups.values().find(|s| s.errors_um.len() < 3) {
        let found = format!("{} parts for {}", few.errors_um.len(), few.feature);
        return Err(InputError::whole(file, found, "at least 3 parts to tell system from chance"));
    }
    if groups.is_empty() {
        return Err(InputError::whole(file, "no measurement", "a batch of at least 3 parts"));
    }
    Ok(groups.into_values().collect())
}

/// Smallest error that a measuring machine or probe can resolve, µm.
const LEAST_TOLD_UM: f64 = 0.05;
const OTHER_UNIT: &str =
    "errors in µm, of which no measurement tells less than 0.05: are these mm or inches?";

/// Whether a whole file of errors is in another unit.
/// Its largest error is then below the resolution of any measurement.
fn is_other_unit(largest: f64) -> bool {
    largest > 0.0 && largest < LEAST_TOLD_UM
}

/// Largest contradiction that rounding of three values to 1 µm explains, µm.
const ROUNDING_UM: f64 = 1.6;

/// Two-sided probability of a t this large by chance.
fn two_sided(t: f64, freedom: usize) -> f64 {
    match StudentsT::new(0.0, 1.0, freedom as f64) {
        Ok(d) if t.is_finite() => (2.0 * d.sf(t.abs())).min(1.0),
        // There is no scatter: the probability is 0, or 1 if the mean is zero too.
        _ => f64::from(u8::from(t.is_nan())),
    }
}

/// A straight line along the batch.
struct TrendLine {
    middle: f64,
    mean: f64,
    slope: f64,
    /// Sum of the squared distances from the middle.
    square: f64,
}

impl TrendLine {
    /// Fits the line to errors, each at its place in the batch.
    fn through(points: &[(usize, f64)]) -> Self {
        let n = points.len() as f64;
        let middle = points.iter().map(|(k, _)| *k as f64).sum::<f64>() / n;
        let mean = points.iter().map(|(_, um)| um).sum::<f64>() / n;
        let square: f64 = points.iter().map(|(k, _)| (*k as f64 - middle).powi(2)).sum();
        let product: f64 = points.iter().map(|(k, um)| (*k as f64 - middle) * (um - mean)).sum();
        Self { middle, mean, slope: product / square, square }
    }

    /// Residual of an error from the line.
    fn left(&self, (k, um): (usize, f64)) -> f64 {
        um - self.mean - self.slope * (k as f64 - self.middle)
    }

    /// Residual sum of squares.
    fn squares(&self, points: &[(usize, f64)]) -> f64 {
        points.iter().map(|point| self.left(*point).powi(2)).sum()
    }
}

/// Probability of a false outlier in a batch.
const CHANCE: f64 = 1e-3;
/// Largest share of outliers at a place.
const MOST_WILD: f64 = 0.25;
/// Difference of neighbouring outliers that form a state, as share of distance.
/// A state is another tool, or a worn one.
const STATE_SHARE: f64 = 0.5;

/// The reading with the largest distance from the others, in standard errors.
/// Returns its index among the readings, and the probability of such a distance by chance.
/// The distance is that from a straight line through them, or from their mean if not `sloped`.
/// `least_um` is the smallest standard deviation of a reading.
fn farthest(rest: &[(usize, f64)], sloped: bool, least_um: impl Fn(usize) -> f64) -> Option<(usize, f64)> {
    let (n, line) = (rest.len() as f64, TrendLine::through(rest));
    let line = if sloped { line } else { TrendLine { slope: 0.0, ..line } };
    let freedom = rest.len().checked_sub(if sloped { 3 } else { 2 }).filter(|f| *f > 1)?;
    let squares = line.squares(rest);
    // Reduction of the sum of squares when a reading is left out.
    let taken = |point: &(usize, f64)| {
        let along = if sloped { (point.0 as f64 - line.middle).powi(2) / line.square } else { 0.0 };
        line.left(*point).powi(2) / (1.0 - 1.0 / n - along)
    };
    let (at, own) = rest.iter().map(taken).enumerate().max_by(|a, b| a.1.total_cmp(&b.1))?;
    let variance = ((squares - own).max(0.0) / freedom as f64).max(least_um(at).powi(2));
    Some((at, n * two_sided((own / variance).sqrt(), freedom)))
}

/// Indices of readings far from the others.
/// Causes are a digit too many, another unit or another part. The distance from the others' mean, and that
/// from a line through them, follow Student's law: batches are level or worn. Readings are removed one after
/// the other, and all up to the last significant one count (Rosner, Technometrics 25, 1983). `places` is the
/// number of tested places.
fn wild(errors_um: &[f64], places: usize) -> Vec<usize> {
    let mut rest: Vec<(usize, f64)> = errors_um.iter().copied().enumerate().collect();
    let most = ((MOST_WILD * rest.len() as f64) as usize).max(1);
    let (mut out, mut found) = (Vec::new(), 0);
    while out.len() < most {
        // No reading is better than its step. If all others are zero, the step may be as large as this
        // reading.
        let least_um = |at: usize| {
            let others_mm: Vec<f64> = (0..rest.len()).filter(|k| *k != at).map(|k| rest[k].1 / 1e3).collect();
            let step = written_step_mm(&others_mm).or_else(|| written_step_mm(&[rest[at].1 / 1e3]));
            step.map_or(0.0, |mm| 1e3 * mm / 12f64.sqrt())
        };
        let models = [true, false].into_iter().filter_map(|sloped| farthest(&rest, sloped, least_um));
        let Some((at, p_value)) = models.min_by(|a, b| a.1.total_cmp(&b.1)) else { break };
        out.push(rest.remove(at).0);
        if p_value < CHANCE / (2 * places) as f64 {
            found = out.len();
        }
    }
    out.truncate(found);
    let kept: Vec<(usize, f64)> =
        errors_um.iter().copied().enumerate().filter(|(k, _)| !out.contains(k)).collect();
    let line = TrendLine::through(&kept);
    let is_state = |k: usize| {
        let near = |other: usize| {
            out.contains(&other)
                && (errors_um[other] - errors_um[k]).abs() < STATE_SHARE * line.left((k, errors_um[k])).abs()
        };
        near(k + 1) || k > 0 && near(k - 1)
    };
    let mut single: Vec<usize> = out.iter().copied().filter(|k| !is_state(*k)).collect();
    single.sort_unstable();
    single
}

/// The step between two parts that explains errors better than a line.
/// Its place was searched for, which costs one parameter more than a line has (Schwarz's criterion), and a
/// test for each place. `step_um` is the gauge's: readings between two of its steps scatter by half of one.
/// The probability is for a single place of the batch; `part` names the part of a reading.
fn step(
    points: &[(usize, f64)],
    step_um: f64,
    part: impl Fn(usize) -> String,
) -> Option<ErrorStepBetweenParts> {
    const SIDE: usize = 2;
    let (n, line) = (points.len(), TrendLine::through(points));
    let mean = |points: &[(usize, f64)]| points.iter().map(|(_, um)| um).sum::<f64>() / points.len() as f64;
    let squares = |points: &[(usize, f64)]| {
        let mean = mean(points);
        points.iter().map(|(_, um)| (um - mean).powi(2)).sum::<f64>()
    };
    let about_line = line.squares(points);
    let about = |k: usize| squares(&points[..k]) + squares(&points[k..]);
    let places = SIDE..(n + 1).checked_sub(SIDE)?;
    let sought = places.len() as f64;
    let (at, left) = places.map(|k| (k, about(k))).min_by(|a, b| a.1.total_cmp(&b.1))?;
    let count = n as f64;
    let is_better = count * (about_line / left.max(f64::MIN_POSITIVE)).ln() > count.ln();
    if n <= 2 * SIDE || !is_better {
        return None;
    }
    let um = mean(&points[at..]) - mean(&points[..at]);
    let sd_about_um = (left / (count - 2.0)).sqrt();
    let of_mean = sd_about_um.max(0.5 * step_um) * (1.0 / at as f64 + 1.0 / (n - at) as f64).sqrt();
    let p_value = (sought * two_sided(um / of_mean, n - 2)).min(1.0);
    Some(ErrorStepBetweenParts { part: part(points[at].0), um, sd_about_um, p_value })
}

fn statistics(series: &PlaceErrorSeries, seen: Option<&[PointError]>) -> PlaceStatistics {
    let kept = series.kept();
    let (e, n): (Vec<f64>, usize) = (kept.iter().map(|(_, um)| *um).collect(), kept.len());
    let (mean_um, sd_um) = (mean(&e), sd(&e, |_| true));
    let of_mean = sd_um / (n as f64).sqrt();
    let half = StudentsT::new(0.0, 1.0, (n - 1) as f64).map_or(0.0, |d| d.inverse_cdf(0.975)) * of_mean;
    let line = TrendLine::through(&kept);
    let slope = line.slope;
    let sd_about = (line.squares(&kept) / (n.saturating_sub(2).max(1)) as f64).sqrt();
    let slope_error = sd_about / line.square.sqrt();
    let with_every_reading = (n < series.errors_um.len()).then(|| StatisticsWithOutliers {
        mean_um: mean(&series.errors_um),
        sd_um: sd(&series.errors_um, |_| true),
    });
    let seen_on_machine_um = series.angle_rad.zip(seen).and_then(|(angle, seen)| {
        let at = |e: &&PointError| (e.angle_rad - turned_near(angle, e.angle_rad)).abs();
        seen.iter().min_by(|a, b| at(a).total_cmp(&at(b))).filter(|e| at(e) < 0.05).map(|e| e.error_um)
    });
    PlaceStatistics {
        feature: series.feature.clone(),
        angle_rad: series.angle_rad,
        parts: n,
        mean_um,
        sd_um,
        interval_um: Some([mean_um - half, mean_um + half]),
        p_value: two_sided(mean_um / of_mean, n - 1),
        trend_um_per_part: slope,
        trend_standard_error_um: slope_error,
        sd_about_trend_um: sd_about,
        trend_p_value: two_sided(slope / slope_error, n - 2),
        seen_on_machine_um,
        step: None,
        left_out: Vec::new(),
        with_every_reading,
        finding: PlaceFinding::Nothing,
    }
}

/// Holm's step-down correction.
/// With it the false-alarm rate applies to all places together.
fn holm(p: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..p.len()).collect();
    order.sort_by(|&a, &b| p[a].total_cmp(&p[b]));
    let mut corrected = vec![0.0; p.len()];
    let mut least: f64 = 0.0;
    for (rank, &i) in order.iter().enumerate() {
        least = least.max(p[i] * (p.len() - rank) as f64).min(1.0);
        corrected[i] = least;
    }
    corrected
}

fn offer(p: &PlaceStatistics) -> Option<String> {
    let at = p.angle_rad.map_or(String::new(), |a| format!(" at {a:.4} rad"));
    let (name, mean, [low, high]) = (&p.feature, p.mean_um, p.interval_um?);
    Some(match p.finding {
        PlaceFinding::Nothing => return None,
        PlaceFinding::Systematic if p.angle_rad.is_some() => {
            format!("{name}{at}: add {mean:+.1} µm ({low:+.1} to {high:+.1}) to the correction table")
        }
        PlaceFinding::Systematic => format!(
            "{name}: {mean:+.1} µm ({low:+.1} to {high:+.1}) on every part: a tool or work offset of the table"
        ),
        PlaceFinding::NotObservable => format!(
            "{name}{at}: {mean:+.1} µm ({low:+.1} to {high:+.1}) not observable by probing on the machine, which saw \
             {:+.1} µm: tool and probe trace the same machine error; it belongs in the machine's model",
            p.seen_on_machine_um.unwrap_or(0.0)
        ),
        PlaceFinding::Step => {
            let step = p.step.as_ref()?;
            format!(
                "{name}{at}: {:+.2} µm from part {} on, a step and no wear: look at what changed there (tool, offset, clamping, material) \
                 before changing a table; the SD of {:.2} µm holds it, on either side the parts scatter by {:.2} µm",
                step.um, step.part, p.sd_um, step.sd_about_um
            )
        }
        PlaceFinding::Trend => format!(
            "{name}{at}: {:+.2} ± {:.2} µm from part to part: wear or temperature; look at the tool, the spindle's growth and \
             the model's temperatures before changing a table; the SD of {:.2} µm holds that change, about it the parts scatter by {:.2} µm",
            p.trend_um_per_part, p.trend_standard_error_um, p.sd_um, p.sd_about_trend_um
        ),
    })
}
