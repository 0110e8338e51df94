//! Evaluations of the ISO 230 series.
//!
//! | module | standard |
//! |---|---|
//! | [`positioning()`] | ISO 230-2: accuracy and repeatability of positioning of an axis, of tilts too |
//! | [`drift()`] | ISO 230-3: thermal effects, phase by phase |
//! | [`straightness()`] | ISO 230-1: straightness of an axis's motion |
//! | [`diagonals()`] | ISO 230-6: body and face diagonals |
//! | [`TestConditions`] | conditions of a test, and the uncertainty that follows |

mod air_refraction;
mod conditions;
mod diagonals;
mod drift;
mod positioning;
mod straightness;

pub use air_refraction::{AirState, AirTemperatureSource, LaserPathAir};
pub use conditions::{
    CircleAndDriftUncertainty, ExpandingBody, PositioningUncertainty, TestConditions, UncertaintyContributor,
};
pub use diagonals::{DiagonalResult, DiagonalTestResult, diagonals};
pub use drift::{DriftFigures, DriftPhaseResult, DriftResult, SensorDrift, drift, drift_charts};
pub(crate) use drift::{StreamedDriftTest, state_budget};
pub(crate) use positioning::{LONG_AXIS_MM, LONG_INTERVAL_MM, fewest_targets};
pub use positioning::{
    PositioningOptions, PositioningResult, SharedDrift, SharedStep, TargetResult, has_positioning,
    positioning, positioning_with,
};
pub use straightness::{StraightnessPoint, StraightnessResult, has_straightness, straightness};

use rtec_files::InputError;
use rtec_least_squares::dot;
use rtec_model::record::{Axis, Record, Role, mean};
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, FisherSnedecor, StudentsT};
use std::borrow::Borrow;
use std::collections::BTreeMap;

/// Largest scatter of positions at one target, as a share of the travel.
const ALIKE: f64 = 1e-4;
/// For larger scatter: least ratio of distances between targets to those within.
const APART: f64 = 10.0;

/// A place of a run, with the errors read there by side of approach.
pub(crate) struct MeasuredPosition {
    pub(crate) position_mm: f64,
    pub(crate) up: Vec<f64>,
    pub(crate) down: Vec<f64>,
}

/// The places of a run, in order.
/// Without a direction all errors are upwards.
pub(crate) fn places(position: &[f64], direction: Option<&[f64]>, error: &[f64]) -> Vec<MeasuredPosition> {
    let of = |rows: Vec<usize>| {
        let side = |up: bool| -> Vec<f64> {
            let on = |r: &&usize| direction.map_or(up, |d| if up { d[**r] > 0.0 } else { d[**r] < 0.0 });
            rows.iter().filter(on).map(|r| error[*r]).collect()
        };
        let position_mm = rows.iter().map(|r| position[*r]).sum::<f64>() / rows.len() as f64;
        MeasuredPosition { position_mm, up: side(true), down: side(false) }
    };
    targets(position).into_iter().map(of).collect()
}

/// Least-squares line y = a + b·x with its residual standard deviation.
/// `None` if x does not vary.
pub(crate) fn line(x: &[f64], y: &[f64]) -> Option<(f64, f64, f64)> {
    let [xx, xy, _] = moments(x, y);
    if x.len() < 3 || xx <= 0.0 {
        return None;
    }
    let (b, a) = (xy / xx, mean(y) - xy / xx * mean(x));
    let left: f64 = x.iter().zip(y).map(|(x, y)| (y - a - b * x).powi(2)).sum();
    Some((a, b, (left / (x.len() as f64 - 2.0)).sqrt()))
}

/// The circle through places, by least squares of squared distances (Kåsa).
pub(crate) struct FittedCircle {
    centre: [f64; 2],
    /// In the unit of the places.
    pub(crate) radius: f64,
    /// Distance from the circle to the farthest place.
    pub(crate) off: f64,
}

impl FittedCircle {
    /// `None` for fewer than three places, or places on a line.
    pub(crate) fn through(x: &[f64], y: &[f64]) -> Option<Self> {
        let (mx, my) = (mean(x), mean(y));
        let size = x.iter().zip(y).map(|(x, y)| (x - mx).hypot(y - my)).fold(0.0, f64::max);
        let place = |i: usize| [(x[i] - mx) / size, (y[i] - my) / size];
        let of = |k: usize| (0..x.len()).map(|i| place(i)[k]).collect::<Vec<f64>>();
        let squares: Vec<f64> = (0..x.len()).map(|i| place(i).iter().map(|v| v * v).sum()).collect();
        let fit = rtec_least_squares::solve(&[of(0), of(1), vec![1.0; x.len()]], &squares).ok()?;
        // For places on a line one direction is rounding only.
        if fit.independent.iter().any(|share| *share < 3e-5) {
            return None;
        }
        let [a, b] = [fit.values[0] / 2.0, fit.values[1] / 2.0];
        let radius = (fit.values[2] + a * a + b * b).sqrt() * size;
        let mut found = Self { centre: [mx + a * size, my + b * size], radius, off: 0.0 };
        let [cx, cy] = found.centre;
        let off = x.iter().zip(y).map(|(x, y)| ((x - cx).hypot(y - cy) - radius).abs());
        found.off = off.fold(0.0, f64::max);
        Some(found)
    }

    /// Angle of a place about the centre, rad.
    pub(crate) fn angle(&self, x: f64, y: f64) -> f64 {
        (y - self.centre[1]).atan2(x - self.centre[0])
    }

    /// Whether all places are within 1 % of the radius from the circle.
    pub(crate) fn is_met(&self) -> bool {
        self.off <= 0.01 * self.radius
    }
}

/// Rows of equal target, in order of position.
pub(crate) fn targets(position: &[f64]) -> Vec<Vec<usize>> {
    let alike = alike(position, ALIKE);
    let mut sorted = position.to_vec();
    sorted.sort_by(f64::total_cmp);
    let mut gaps: Vec<f64> = sorted.windows(2).map(|w| w[1] - w[0]).collect();
    gaps.sort_by(f64::total_cmp);
    let span: f64 = gaps.iter().sum();
    // The largest ratio of two consecutive distances, beyond the tolerance.
    let break_at = gaps
        .windows(2)
        .filter(|w| w[0] > ALIKE * span && w[1] > APART * w[0])
        .max_by(|a, b| (a[1] / a[0]).total_cmp(&(b[1] / b[0])));
    // A limit between the two, so that rounding does not split a target.
    let wider = break_at.map(|w| self::alike(position, (w[0] * w[1]).sqrt() / span));
    // There are several targets, and each repeats.
    wider.filter(|wider| wider.len() >= 3 && 2 * wider.len() <= position.len()).unwrap_or(alike)
}

/// Groups rows whose sorted positions differ by at most a share of the span.
pub(crate) fn alike(position: &[f64], share: f64) -> Vec<Vec<usize>> {
    let mut order: Vec<usize> = (0..position.len()).collect();
    order.sort_by(|a, b| position[*a].total_cmp(&position[*b]));
    let gap = (position[order[order.len() - 1]] - position[order[0]]) * share;
    let near = |a: &usize, b: &usize| position[*b] - position[*a] <= gap;
    let mut groups: Vec<Vec<usize>> = order.chunk_by(near).map(<[usize]>::to_vec).collect();
    for g in &mut groups {
        g.sort_unstable();
    }
    groups
}

pub(crate) fn mean_and_s(values: &[f64]) -> Option<(f64, f64)> {
    let n = values.len() as f64;
    if values.len() < 2 {
        return None;
    }
    let mean = mean(values);
    let s = (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
    Some((mean, s))
}

pub(crate) fn range(values: impl IntoIterator<Item = (f64, f64)>) -> Option<f64> {
    let wider = |(lo, hi): (f64, f64), (l, h): (f64, f64)| (lo.min(l), hi.max(h));
    let (lo, hi) = values.into_iter().reduce(wider)?;
    (hi >= lo).then_some(hi - lo)
}

/// Largest less smallest value; `None` of no values.
pub(crate) fn spread(values: impl IntoIterator<Item: Borrow<f64>>) -> Option<f64> {
    range(values.into_iter().map(|v| (*v.borrow(), *v.borrow())))
}

pub(crate) fn mean_of(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| mean(values))
}

pub(crate) fn largest(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    values.into_iter().reduce(f64::max)
}

/// The errors of a record with their axes.
pub(crate) fn error_axes(record: &Record) -> Vec<(&Axis, &[f64])> {
    let errors = record.columns.iter().filter(|c| matches!(c.role, Role::Error(_)));
    errors.filter_map(|c| Some((c.role.axis()?, c.data.as_slice()))).collect()
}

pub(crate) fn lacks(record: &Record, found: &str, expected: &str) -> InputError {
    InputError::whole(&record.path, found, expected)
}

/// Conditions name a sensor that the record lacks.
fn no_temperature(record: &Record, sensor: &str, of: &str, expected: &str) -> InputError {
    let has = record.names(&Role::Temperature).collect::<Vec<_>>().join(", ");
    lacks(record, &format!("no temperature {sensor} for the {of} (the record has: {has})"), expected)
}

/// Sums of products about the means: x·x, x·y and y·y.
pub(crate) fn moments(x: &[f64], y: &[f64]) -> [f64; 3] {
    let (mx, my) = (mean(x), mean(y));
    let sum = |of: fn(f64, f64) -> f64| x.iter().zip(y).map(|(a, b)| of(a - mx, b - my)).sum::<f64>();
    [sum(|a, _| a * a), sum(|a, b| a * b), sum(|_, b| b * b)]
}

/// Correlation coefficient; 0 if one of the two does not vary.
pub fn correlation(x: &[f64], y: &[f64]) -> f64 {
    let [xx, xy, yy] = moments(x, y);
    if xx > 0.0 && yy > 0.0 { xy / (xx * yy).sqrt() } else { 0.0 }
}

/// Repeatability of returns to one position (tool changes, reference marks).
/// Scatter with and without drift.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ReturnRepeatability {
    /// Number of returns.
    pub returns: usize,
    /// Standard deviation of all returns, µm.
    pub s_um: f64,
    /// Largest minus smallest error, µm.
    pub range_um: f64,
    /// Slope of the straight line through the returns, µm per return.
    pub trend_um_per_return: f64,
    /// Standard error of that slope, µm; `None` below three returns.
    pub trend_standard_error_um: Option<f64>,
    /// Probability of a slope of this size by chance; `None` below three returns.
    pub trend_p_value: Option<f64>,
    /// Standard deviation about that line, µm; `None` below three returns.
    pub s_about_trend_um: Option<f64>,
    /// Standard deviation from differences of consecutive returns, µm.
    /// They contain no slow drift of any shape. `None` below three returns.
    pub s_of_neighbours_um: Option<f64>,
    /// A step that explains the returns better than a straight line.
    /// It must leave no other structure in them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub step: Option<StepInReturns>,
    /// A periodic pattern in the returns, if there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub turns: Option<PeriodInReturns>,
}

/// A periodic pattern of returns: two grippers, four sides of a tool.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PeriodInReturns {
    /// Period, in returns.
    pub every: usize,
    /// Highest less lowest mean of the phases, µm.
    pub range_um: f64,
    /// Probability of means this far apart by chance, over all periods tried.
    pub p_value: f64,
    /// Standard deviation about those means, µm.
    pub s_about_them_um: f64,
}

/// Fewest returns per phase.
const ROUNDS: usize = 3;

impl PeriodInReturns {
    /// The best period of returns without drift, by analysis of variance.
    fn of(left: &[f64], used: usize) -> Option<Self> {
        let n = left.len();
        let tried = (2..=n / ROUNDS).count() as f64;
        let found = (2..=n / ROUNDS).filter_map(|every| {
            let sum = |k: usize| left.iter().skip(k).step_by(every).sum::<f64>();
            let mean = |k: usize| sum(k) / (k..n).step_by(every).count() as f64;
            let means: Vec<f64> = (0..every).map(mean).collect();
            let within: f64 = left.iter().enumerate().map(|(i, v)| (v - means[i % every]).powi(2)).sum();
            let between: f64 = (0..n).map(|i| means[i % every].powi(2)).sum();
            let freedom = n.checked_sub(every + used).filter(|f| *f > 0)? as f64;
            let law = FisherSnedecor::new(every as f64 - 1.0, freedom).ok()?;
            let ratio = between / (every as f64 - 1.0) / (within / freedom);
            let p_value = if within > 0.0 { tried * law.sf(ratio) } else { 0.0 };
            let (range_um, s_about_them_um) = (spread(&means)?, (within / freedom).sqrt());
            (between > 0.0).then_some(Self { every, range_um, p_value, s_about_them_um })
        });
        // The shortest period among equally good ones: a period of two is also one of four.
        let best = found.min_by(|a, b| a.p_value.total_cmp(&b.p_value).then(a.every.cmp(&b.every)))?;
        (best.p_value < CHANCE).then_some(best)
    }
}

/// A step in the returns: the returns before and after have different means.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct StepInReturns {
    /// The first return after it, from 1.
    pub row: usize,
    /// Its size, µm.
    pub um: f64,
    /// Standard error of its size, µm.
    pub standard_error_um: f64,
    /// Probability of a step of this size at any place by chance.
    pub p_value: f64,
    /// Standard deviation about the two means, or about two lines of one slope, µm.
    pub s_about_step_um: f64,
    /// Slope on both sides of it, µm per return, if it is beyond chance.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub drift_um_per_return: Option<f64>,
}

/// Fewest returns on either side of a step; a single one is a bad return.
const STEP_SIDE: usize = 2;
/// A trend, step or period is reported below this probability of chance.
const CHANCE: f64 = 0.01;
/// Least share of a step's size between two returns; a bend comes slowly.
const AT_ONCE: f64 = 0.7;
/// Normal quantile of 99 %.
const ONE_IN_A_HUNDRED: f64 = 2.326;

impl StepInReturns {
    /// The step that explains the returns best, if better than a straight line.
    /// `about_line` is the line's residual sum of squares, µm².
    fn of(e: &[f64], about_line: f64) -> Option<Self> {
        let n = e.len();
        let squares = |v: &[f64]| {
            let mean = mean(v);
            v.iter().map(|x| (x - mean).powi(2)).sum::<f64>()
        };
        let about = |k: usize| squares(&e[..k]) + squares(&e[k..]);
        let places = STEP_SIDE..(n + 1).checked_sub(STEP_SIDE)?;
        let tried = places.len() as f64;
        let (at, left) = places.map(|k| (k, about(k))).min_by(|a, b| a.1.total_cmp(&b.1))?;
        let freedom = n.checked_sub(2).filter(|f| *f > 0)? as f64;
        if let Some(found) = Self::beside_drift(e, about_line, left) {
            return Some(found);
        }
        // The place is one more parameter than a line has (Schwarz's criterion).
        let count = n as f64;
        if count * (about_line / left.max(f64::MIN_POSITIVE)).ln() < count.ln() {
            return None;
        }
        let um = mean(&e[at..]) - mean(&e[..at]);
        let s = (left / freedom).sqrt();
        let standard_error_um = s * (1.0 / at as f64 + 1.0 / (n - at) as f64).sqrt();
        let t = StudentsT::new(0.0, 1.0, freedom).ok()?;
        let size = (um / standard_error_um).abs();
        let p_value = if s > 0.0 { (tried * 2.0 * t.cdf(-size)).min(1.0) } else { 0.0 };
        let residual: Vec<f64> =
            (0..n).map(|i| e[i] - if i < at { mean(&e[..at]) } else { mean(&e[at..]) }).collect();
        let found = Self {
            row: at + 1,
            um,
            standard_error_um,
            p_value,
            s_about_step_um: s,
            drift_um_per_return: None,
        };
        (p_value < CHANCE && um != 0.0 && is_rest(&residual, left)).then_some(found)
    }

    /// A step in returns that drift as well.
    /// Both must explain more than either alone (Schwarz's criterion), and be beyond chance.
    fn beside_drift(e: &[f64], about_line: f64, about_step: f64) -> Option<Self> {
        let (n, count) = (e.len(), e.len() as f64);
        let freedom = n.checked_sub(3).filter(|f| *f >= STEP_SIDE)? as f64;
        let step = |k: usize| over_returns(&(0..n).map(|i| f64::from(i >= k)).collect::<Vec<f64>>());
        let (line, _, of_returns) = over_returns(e);
        let at_row = |k: usize| {
            let (slope, _, of_step) = step(k);
            let square = dot(&of_step, &of_step);
            let um = dot(&of_step, &of_returns) / square;
            (k, um, square, line - um * slope, about_line - um * um * square)
        };
        let places = STEP_SIDE..(n + 1).checked_sub(STEP_SIDE)?;
        let tried = places.len() as f64;
        let (at, um, square, slope, left) = places.map(at_row).min_by(|a, b| a.4.total_cmp(&b.4))?;
        let gains = |other: f64, parameters: f64| {
            count * (other / left.max(f64::MIN_POSITIVE)).ln() > parameters * count.ln()
        };
        let s = (left.max(0.0) / freedom).sqrt();
        let standard_error_um = s / square.sqrt();
        let law = StudentsT::new(0.0, 1.0, freedom).ok()?;
        let chance =
            |size: f64, error: f64| if error > 0.0 { 2.0 * law.cdf(-(size / error).abs()) } else { 0.0 };
        // Each mean has its own error, but the common slope is known from both sides.
        let within: f64 = [at as f64, count - at as f64].map(|m| m * (m * m - 1.0) / 12.0).iter().sum();
        let p_value = (tried * chance(um, standard_error_um)).min(1.0);
        let (_, _, of_step) = step(at);
        let residual: Vec<f64> = of_returns.iter().zip(&of_step).map(|(v, h)| v - um * h).collect();
        // A step comes between two returns; heat takes more than two.
        let pair = |k: usize| f64::midpoint(e[k], e[k + 1]);
        let is_sudden = (pair(at) - pair(at - 2) - 2.0 * slope) / um > AT_ONCE;
        let is_both = is_rest(&residual, left)
            && is_sudden
            && gains(about_line, 2.0)
            && gains(about_step, 1.0)
            && chance(slope, s / within.sqrt()) < CHANCE;
        let (row, drift_um_per_return) = (at + 1, Some(slope));
        let found = Self { row, um, standard_error_um, p_value, s_about_step_um: s, drift_um_per_return };
        (is_both && p_value < CHANCE).then_some(found)
    }
}

/// The line over the returns' numbers: slope, squares of the numbers, residuals.
fn over_returns(y: &[f64]) -> (f64, f64, Vec<f64>) {
    let (mean, middle) = (mean(y), (y.len() as f64 - 1.0) / 2.0);
    let about: Vec<f64> = (0..y.len()).map(|i| i as f64 - middle).collect();
    let xx: f64 = about.iter().map(|x| x.powi(2)).sum();
    let slope = about.iter().zip(y).map(|(x, y)| x * (y - mean)).sum::<f64>() / xx;
    (slope, xx, about.iter().zip(y).map(|(x, y)| y - mean - slope * x).collect())
}

/// Whether neighbouring residuals differ; `left` is their sum of squares.
/// A bend leaves residuals alike on both sides of a step.
fn is_rest(residual: &[f64], left: f64) -> bool {
    let pairs: f64 = residual.windows(2).map(|w| (w[1] - w[0]).powi(2)).sum();
    left <= 0.0 || !is_alike(pairs / left, residual.len())
}

/// Whether neighbours are more alike than chance makes them (1 %).
/// Von Neumann's ratio has mean 2 and variance 4 (n − 2) / (n² − 1).
pub(crate) fn is_alike(ratio: f64, n: usize) -> bool {
    let n = n as f64;
    ratio < 2.0 - ONE_IN_A_HUNDRED * 2.0 * ((n - 2.0) / (n * n - 1.0)).sqrt()
}

impl ReturnRepeatability {
    /// From errors in µm in the order of the returns; `None` for fewer than two.
    pub fn of(e: &[f64]) -> Option<Self> {
        let (_, s_um) = mean_and_s(e)?;
        let n = e.len() as f64;
        let (slope, xx, residual) = over_returns(e);
        let left = residual.iter().map(|r| r.powi(2)).sum::<f64>();
        let s_about = (n > 2.0).then(|| (left / (n - 2.0)).sqrt());
        let error = s_about.map_or(f64::INFINITY, |s| s / xx.sqrt());
        let p = s_about.and_then(|s| {
            let t = StudentsT::new(0.0, 1.0, n - 2.0).ok()?;
            let size = (slope / error).abs();
            Some(if s > 0.0 { 2.0 * t.cdf(-size) } else { f64::from(slope == 0.0) })
        });
        Some(Self {
            returns: e.len(),
            s_um,
            range_um: spread(e)?,
            trend_um_per_return: slope,
            trend_standard_error_um: Some(error).filter(|error| error.is_finite()),
            trend_p_value: p,
            step: StepInReturns::of(e, left),
            turns: PeriodInReturns::of(&residual, 1),
            s_about_trend_um: s_about,
            s_of_neighbours_um: (n > 2.0).then(|| {
                let squares: f64 = e.windows(2).map(|w| (w[1] - w[0] - slope).powi(2)).sum();
                (squares / (2.0 * (n - 1.0))).sqrt()
            }),
        })
    }

    /// Whether the drift is not a straight line: neighbours are alike about it.
    pub fn is_bent(&self) -> bool {
        let n = self.returns as f64;
        self.s_about_trend_um.zip(self.s_of_neighbours_um).is_some_and(|(about, neighbours)| {
            let ratio = 2.0 * (neighbours / about).powi(2) * (n - 1.0) / (n - 2.0);
            is_alike(ratio, self.returns)
        })
    }

    /// Whether the returns drift beyond chance (one of a hundred runs).
    /// A step must not explain them better.
    pub fn is_trend(&self) -> bool {
        self.step.is_none() && self.trend_p_value.is_some_and(|p| p < CHANCE)
    }
}

/// Repeatability of returning to one position, from the record's first error per axis.
pub fn returns(record: &Record) -> BTreeMap<String, ReturnRepeatability> {
    let of = |(axis, e): (&Axis, &[f64])| {
        let mut found = ReturnRepeatability::of(e)?;
        if let Some(step) = &mut found.step {
            step.row = record.row_number(step.row - 1);
        }
        Some((axis.to_string(), found))
    };
    error_axes(record).into_iter().filter_map(of).collect()
}
