//! Velocity and acceleration from recorded positions, if they are not logged.
//!
//! A cubic is fitted around every row to the positions in a symmetric window, with tricube weights. So there
//! is no phase shift, and rows may be uneven (Cleveland, 1979; Fan and Gijbels, 1996). The window is chosen
//! from the data, separately for velocity and acceleration. Ever wider windows are each compared with one of
//! half their width: what the noise does not explain of the change is distortion. The window with the least
//! sum of noise and distortion is used.

use rtec_files::Result;
use rtec_least_squares::QrFactor;
use rtec_model::machine::{Machine, RecordPrediction};
use rtec_model::record::{Axis, Column, Record, Role, RunKind, median};
use std::ops::Range;

/// Rows that a window needs: a cubic, and one more for the noise.
pub(crate) const FEWEST: usize = 5;
/// Rows of the first window on each side.
const FIRST: usize = 3;
/// Rows at which windows are compared: evenly spread, enough for a mean.
const JUDGED: usize = 1500;
/// Factor on the squared distortion that the change between two windows shows.
/// Half a window keeps part of the distortion: a third at a corner of the acceleration, as at the ends of a
/// stroke.
const SHORT: f64 = 2.0;
/// A time step above this multiple of the usual one separates two runs.
const GAP: f64 = 8.0;
/// Time between rows above which a run was read at rest, s; it shows no motion.
const AT_STOPS_S: f64 = 0.1;

/// Adds velocity (mm/s) and acceleration (mm/s²) of axes that lack them.
/// An axis needs positions and times. Returns one note per added column, with its window and standard error,
/// and one per axis whose rows show no motion.
///
/// The columns are named `velocity_AXIS` and `acceleration_AXIS`. An axis at rest gets none.
pub fn derive(record: &mut Record) -> Vec<String> {
    let axes: Vec<Axis> = record.axes(Role::Position).cloned().collect();
    let mut notes = Vec::new();
    for axis in axes {
        let roles = [(Role::Velocity(axis.clone()), 1), (Role::Acceleration(axis.clone()), 2)];
        let wanted: Vec<(Role, usize)> =
            roles.into_iter().filter(|(role, _)| record.column(role).is_none()).collect();
        let (Some(t), Some(p)) = (record.data(&Role::Time), record.position(&axis)) else {
            continue;
        };
        if wanted.is_empty() || p.iter().all(|v| v - p[0] == 0.0) {
            continue;
        }
        let runs = match runs(t, record.kind) {
            Ok(runs) => runs,
            Err(why) => {
                let names: Vec<String> = wanted.iter().map(|(role, _)| role.to_string()).collect();
                notes.push(format!("{} not derived: {why}", names.join(" and ")));
                continue;
            }
        };
        let noise_mm = noise(t, p, &runs).max(record.count_um.unwrap_or(0.0) / 1000.0 / 12f64.sqrt());
        let motion = PositionSeries { t, p, runs: &runs, noise_mm };
        let mut columns = Vec::new();
        for (role, order) in wanted {
            let (rows, error) = motion.window(order);
            let data = motion.all(order, rows);
            let rms = (data.iter().map(|v| v * v).sum::<f64>() / data.len() as f64).sqrt();
            let unit = role.unit().unwrap_or_default();
            if rms < 2.0 * error {
                let noise = format!("noise of {error:.2e} {unit} hides it ({rms:.2e} RMS)");
                notes.push(format!("{role} not derived: {noise}"));
                continue;
            }
            let (reach_s, noise_um) = (rows as f64 * median(steps(t, &runs)), 1000.0 * noise_mm);
            notes.push(format!(
                "{role} derived from position: local cubic, zero phase, ±{rows} rows (±{reach_s:.4} s), standard error {error:.2e} {unit} from \
                 position noise of {noise_um:.3} um"
            ));
            let mut name = role.to_string().replace('.', "_");
            while record.columns.iter().any(|c| c.name == name) {
                name.push_str("_derived");
            }
            columns.push(Column::new(&name, role, data));
        }
        record.columns.extend(columns);
    }
    notes
}

/// Predicts a record with a model, deriving motion that was not logged.
/// Uses the same derivation as a reconciliation; each derived column gets a note.
///
/// # Errors
/// An effect reads a sensor or channel that the record does not have.
pub fn predict(machine: &Machine, record: &Record) -> Result<(RecordPrediction, Vec<String>)> {
    let as_logged = machine.predict(record)?;
    if !lacks_motion(&as_logged, record) {
        return Ok((as_logged, Vec::new()));
    }
    let mut with_motion = record.clone();
    let notes = derive(&mut with_motion);
    if with_motion.columns.len() == record.columns.len() {
        return Ok((as_logged, Vec::new()));
    }
    Ok((machine.predict(&with_motion)?, notes))
}

/// Whether a model reads motion that a record shows but does not log.
/// The first rows of a record suffice.
pub(crate) fn reads_more_motion(machine: &Machine, record: &Record) -> bool {
    machine.predict(record).is_ok_and(|prediction| lacks_motion(&prediction, record))
}

/// Whether motion that the positions show was taken as zero.
fn lacks_motion(prediction: &RecordPrediction, record: &Record) -> bool {
    let motion =
        |role: &str| ["velocity.", "acceleration.", "direction."].iter().any(|m| role.starts_with(m));
    let shown = record.data(&Role::Time).is_some_and(|t| runs(t, record.kind).is_ok());
    shown && prediction.taken_as_zero.iter().any(|(_, role)| motion(role))
}

/// Stretches of rows without a gap in time, or the reason why they show no motion.
fn runs(t: &[f64], kind: RunKind) -> Result<Vec<Range<usize>>, String> {
    if t.len() < 2 * FEWEST {
        return Err(format!("{} rows are too few", t.len()));
    }
    let step = median(t.windows(2).map(|w| w[1] - w[0]));
    if step <= 0.0 {
        return Err("most rows have the same time as the row before".to_owned());
    }
    let moving = matches!(kind, RunKind::Dynamics | RunKind::Ballbar | RunKind::FeedSweep);
    if !moving && step > AT_STOPS_S {
        let name = kind.name();
        return Err(format!("rows {step} s apart in a run of kind {name} are readings at stops"));
    }
    let mut runs = Vec::new();
    let mut start = 0;
    for i in 1..=t.len() {
        if i == t.len() || t[i] - t[i - 1] > GAP * step {
            if distinct(&t[start..i]) < FEWEST {
                return Err(format!("rows {} to {i} stand alone between gaps in time", start + 1));
            }
            runs.push(start..i);
            start = i;
        }
    }
    Ok(runs)
}

/// Number of distinct times; a cubic needs [`FEWEST`].
fn distinct(t: &[f64]) -> usize {
    1 + t.windows(2).filter(|w| w[1] > w[0]).count()
}

fn steps<'a>(t: &'a [f64], runs: &'a [Range<usize>]) -> impl Iterator<Item = f64> + 'a {
    runs.iter().flat_map(|run| t[run.clone()].windows(2).map(|w| w[1] - w[0]))
}

/// Standard deviation of the noise of `p` over `t`, in the unit of `p`.
/// From the median residual of a row from a cubic through its four neighbours, which a few jerks do not
/// change. Only moving rows count, because a scale at rest shows no noise. A run has at least five rows.
pub(crate) fn noise(t: &[f64], p: &[f64], runs: &[Range<usize>]) -> f64 {
    let mut left = Vec::new();
    for run in runs {
        for start in run.start..=run.end - FEWEST {
            let (t, p) = (&t[start..start + FEWEST], &p[start..start + FEWEST]);
            if t.windows(2).any(|w| w[1] <= w[0]) || p[4] - p[0] == 0.0 {
                continue;
            }
            left.push(beyond_cubic(t, p).abs());
        }
    }
    // 0.6745: the median of the absolute value of a standard normal deviate.
    median(left) / 0.6745
}

/// Residual of five values from a cubic over rising times, in their unit.
/// It is scaled to the standard deviation of white noise in the values.
pub(crate) fn beyond_cubic(t: &[f64], p: &[f64]) -> f64 {
    // Divided differences of fourth order vanish for a cubic.
    let of = |i: usize| (0..FEWEST).filter(|j| *j != i).map(|j| t[i] - t[j]).product::<f64>().recip();
    let (value, square) = (0..FEWEST).fold((0.0, 0.0), |(v, s), i| (v + of(i) * p[i], s + of(i) * of(i)));
    value / square.sqrt()
}

/// One axis' positions over time.
struct PositionSeries<'a> {
    t: &'a [f64],
    p: &'a [f64],
    runs: &'a [Range<usize>],
    noise_mm: f64,
}

impl PositionSeries<'_> {
    /// Half width of the window for a derivative, rows, and its standard error.
    /// The error includes noise, distortion and the uncertainty of the distortion.
    fn window(&self, order: usize) -> (usize, f64) {
        let longest = self.runs.iter().map(Range::len).max().unwrap_or(0);
        let every = (self.t.len() / JUDGED).max(1);
        let judged: Vec<(usize, &Range<usize>)> =
            self.runs.iter().flat_map(|run| run.clone().step_by(every).map(move |i| (i, run))).collect();
        let mut best = (FIRST, f64::INFINITY, f64::INFINITY);
        let mut rows = FIRST;
        while 2 * rows < longest {
            let (mut variance, mut change, mut explained) = (0.0, 0.0, 0.0);
            for (i, run) in &judged {
                let (from, wide) = self.weights(order, rows, *i, run);
                variance += wide.iter().map(|w| w * w).sum::<f64>();
                if rows == FIRST {
                    continue; // nothing smaller to compare with
                }
                let (inner_from, narrow) = self.weights(order, rows.div_ceil(2), *i, run);
                let mut difference = wide;
                // The narrow window lies inside the wide one.
                for (place, w) in narrow.iter().enumerate() {
                    difference[inner_from - from + place] -= w;
                }
                let value: f64 = difference.iter().zip(&self.p[from..]).map(|(w, p)| w * p).sum();
                change += value * value;
                explained += self.noise_mm.powi(2) * difference.iter().map(|w| w * w).sum::<f64>();
            }
            let n = judged.len() as f64;
            let variance = self.noise_mm.powi(2) * variance / n;
            let distortion = SHORT * ((change - explained) / n).max(0.0);
            if variance + distortion < best.1 {
                // Uncertainty of a mean of squares; rows within one window are not independent.
                let doubt = SHORT * explained / n * (4.0 * rows as f64 / self.t.len() as f64).sqrt();
                best = (rows, variance + distortion, variance + distortion + doubt);
            } else if distortion > 4.0 * best.1 {
                break; // wider ones only agree with each other
            }
            rows = (rows * 5).div_ceil(4);
        }
        (best.0, best.2.sqrt())
    }

    /// The derivative at every row.
    fn all(&self, order: usize, rows: usize) -> Vec<f64> {
        let at = |(i, run): (usize, &Range<usize>)| {
            let (from, weights) = self.weights(order, rows, i, run);
            // Differences of positions: a place far from zero costs no digits.
            weights.iter().zip(&self.p[from..]).map(|(w, p)| w * (p - self.p[i])).sum()
        };
        self.runs.iter().flat_map(|run| run.clone().map(move |i| (i, run))).map(at).collect()
    }

    /// Weights of the positions around row `i` in the derivative there.
    /// Returns the first row and the weights from it on. At the ends of a run the window is one-sided and has
    /// the full reach.
    fn weights(&self, order: usize, rows: usize, i: usize, run: &Range<usize>) -> (usize, Vec<f64>) {
        let (mut from, mut to) = (i.saturating_sub(rows).max(run.start), (i + rows + 1).min(run.end));
        while distinct(&self.t[from..to]) < FEWEST {
            from = from.saturating_sub(1).max(run.start);
            to = (to + 1).min(run.end);
        }
        let at = self.t[i];
        // Slightly beyond the last row, which would have weight zero otherwise.
        let reach = 1.05 * (at - self.t[from]).max(self.t[to - 1] - at);
        let near = |t: f64| (1.0 - ((t - at) / reach).abs().powi(3)).powi(3);
        let roots: Vec<f64> = self.t[from..to].iter().map(|t| near(*t).sqrt()).collect();
        let mut column = roots.clone();
        let mut cubic = QrFactor::new(&roots);
        // Five distinct times: the cubic is determined.
        for _ in 0..4 {
            cubic.push_free(&column);
            column.iter_mut().zip(&self.t[from..to]).for_each(|(c, t)| *c *= (t - at) / reach);
        }
        let factor = if order == 1 { reach.recip() } else { 2.0 / (reach * reach) };
        (from, cubic.weights(order).iter().zip(roots).map(|(w, root)| factor * w * root).collect())
    }
}
