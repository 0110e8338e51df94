//! The resolution of a gauge, and the rounding error that it leaves in a mean.
//!
//! Noise of more than half a step dithers the readings, so a mean has no rounding error. Without noise
//! repeats are equal, and their mean is off by up to half a step. The remaining error falls with
//! exp(−2π²σ²/q²) (Widrow, "A study of rough amplitude quantization", 1956).

use crate::iso230::targets;
use rtec_files::text_file::short;
use rtec_model::ballbar_circle::tick;
use rtec_model::record::{Column, Record, Role, RunKind, shared_step, span};

/// Readings with more different values are not coarse.
const MOST_VALUES: usize = 400;
/// Fewest repeats that show whether noise dithers the steps.
const FEWEST_REPEATS: usize = 6;

/// Resolution and noise of a response's readings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReadingResolution {
    /// The step q that all readings are multiples of, in the column's unit.
    pub step: f64,
    /// Standard deviation σ before rounding; 0 if most repeats are equal.
    pub noise: f64,
}

impl ReadingResolution {
    /// From readings; `repeats` are rows that differ by noise alone.
    /// `None` for readings without a step, or too few repeats.
    pub fn of(readings: &[f64], repeats: &[Vec<usize>]) -> Option<Self> {
        let step = step_of(readings)?;
        let (mut pairs, mut same, mut squares, mut freedom) = (0, 0, 0.0, 0.0);
        for rows in repeats.iter().filter(|rows| rows.len() > 1) {
            for pair in rows.windows(2) {
                pairs += 1;
                same += usize::from((readings[pair[0]] - readings[pair[1]]).abs() < 0.5 * step);
            }
            let mean = rows.iter().map(|i| readings[*i]).sum::<f64>() / rows.len() as f64;
            squares += rows.iter().map(|i| (readings[*i] - mean).powi(2)).sum::<f64>();
            freedom += rows.len() as f64 - 1.0;
        }
        if pairs < FEWEST_REPEATS {
            return None;
        }
        let variance = (squares / freedom - step * step / 12.0).max(0.0);
        Some(Self { step, noise: if 2 * same >= pairs { 0.0 } else { variance.sqrt() } })
    }

    /// For one response of a record: rows of one place and side are repeats.
    /// Without positions, neighbouring rows are.
    pub fn of_response(record: &Record, column: &Column) -> Option<Self> {
        Self::of(&column.data, &repeats(record, column))
    }

    /// Whether most repeats are equal, so that their mean keeps the rounding error.
    pub fn is_coarse(&self) -> bool {
        self.noise == 0.0
    }

    /// Standard deviation of the rounding error of a mean of repeats.
    pub fn standard_error(&self) -> f64 {
        self.step / 12f64.sqrt() * self.rounding_share_left()
    }

    /// Largest rounding error of a mean of repeats.
    pub fn half_width(&self) -> f64 {
        0.5 * self.step * self.rounding_share_left()
    }

    fn rounding_share_left(&self) -> f64 {
        (-2.0 * (std::f64::consts::PI * self.noise / self.step).powi(2)).exp()
    }
}

/// A cause with a range of fewer steps is coarse.
const FEW_STEPS: f64 = 20.0;
/// A response with a range of more steps is fine.
const MANY_STEPS: f64 = 50.0;

/// Resolution of a temperature that is fine enough, K.
const FINE_K: f64 = 0.05;

/// Whether the resolution of a cause is coarse for its range.
pub fn is_coarse_cause(cause: &Column, step: f64, range: f64) -> bool {
    range < FEW_STEPS * step && (cause.role != Role::Temperature || step >= FINE_K)
}

/// A warning if several rows of a drift test share a time.
pub(crate) fn shared_time(record: &Record) -> Option<String> {
    let step = record.data(&Role::Time).filter(|_| record.kind == RunKind::Drift).and_then(shared_step)?;
    let (file, step) = (record.path.display(), short(step));
    Some(format!(
        "{file}: time in steps of {step} s, several rows at each: models take them as even within it, and a row's moment is known within \
         ±{step} s, as is a moment or a lag that is found"
    ))
}

/// Messages about coarse resolution in a record.
/// Of its gauges if `responses`, of its sensors, and in motion of positions and clock.
pub fn resolution_notes(record: &Record, responses: bool) -> Vec<String> {
    let moving = matches!(record.kind, RunKind::Ballbar | RunKind::Dynamics | RunKind::FeedSweep);
    let mut said = Vec::new();
    for column in record.responses().filter(|_| responses) {
        let [low, high] = span(&column.data);
        let matters = |steps: &ReadingResolution| steps.is_coarse() && high - low < MANY_STEPS * steps.step;
        if let Some(steps) = ReadingResolution::of_response(record, column).filter(matters) {
            let unit = if matches!(column.role, Role::Error(_)) { "µm" } else { column.unit.as_str() };
            let (role, step, half) = (&column.role, short(steps.step), short(steps.half_width()));
            said.push(format!(
                "{role}: readings in steps of {step} {unit}, most neighbours alike: each figure may be off by up to {half} {unit}, a range by twice \
                 that; a finer gauge shows more"
            ));
        }
    }
    for column in &record.columns {
        let is_cause = column.role == Role::Temperature || moving && matches!(column.role, Role::Position(_));
        let Some(step) = step_of(&column.data).filter(|_| is_cause) else { continue };
        let [low, high] = span(&column.data);
        if is_coarse_cause(column, step, high - low) {
            let unit = if column.role == Role::Temperature { "K" } else { column.unit.as_str() };
            let (name, step, range) = (&column.name, short(step), short(1e-9 * (1e9 * (high - low)).round()));
            said.push(format!(
                "{name}: readings in steps of {step} {unit} over {range} {unit}: its range is known within ±{step} {unit}, and what follows it in \
                 proportion"
            ));
        }
    }
    if let Some(tick) = record.data(&Role::Time).filter(|_| moving).and_then(tick) {
        said.push(format!(
            "time in steps of {} s, rows not much further apart: velocities and feeds are taken over as many rows as make that little",
            short(tick)
        ));
    }
    said
}

/// Rows of a response that differ by noise alone.
pub(crate) fn repeats(record: &Record, column: &Column) -> Vec<Vec<usize>> {
    let axis = column.role.axis();
    let Some(place) = axis.and_then(|a| record.position(a)) else {
        let n = column.data.len();
        return (0..n).step_by(2).map(|i| (i..n.min(i + 2)).collect()).collect();
    };
    let Some(direction) = axis.and_then(|a| record.direction(a)) else { return targets(place) };
    let sides = |rows: Vec<usize>| -> [Vec<usize>; 2] {
        rows.into_iter().partition(|row| direction[*row] > 0.0).into()
    };
    targets(place).into_iter().flat_map(sides).collect()
}

/// The step that all readings are multiples of.
/// `None` if there is none, or too few readings share a value.
pub fn step_of(readings: &[f64]) -> Option<f64> {
    let mut values: Vec<f64> = readings.iter().copied().filter(|v| v.is_finite()).collect();
    values.sort_by(f64::total_cmp);
    values.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
    if values.len() < 2 || values.len() > MOST_VALUES || 2 * values.len() > readings.len() {
        return None;
    }
    let step = values.windows(2).map(|w| w[1] - w[0]).fold(f64::MAX, f64::min);
    let steps = |v: &f64| (v - values[0]) / step;
    values.iter().all(|v| (steps(v) - steps(v).round()).abs() < 0.02).then_some(step)
}
