//! Outliers in records with few rows, where a robust spread is uncertain.
//!
//! A reading deviates by the smaller of its differences from the readings before and after, if both have one
//! sign. A step, a slope and a bend therefore do not deviate. The noise is taken from the other readings:
//! their differences from the middle of their neighbours. The ratio follows Student's law with the effective
//! number of differences as degrees of freedom. The probability is multiplied by the number of rows, because
//! the largest was selected. Several outliers are removed in turn, up to the last that chance does not
//! explain (Rosner's generalised test, Technometrics 25, 1983).

use super::physical_peaks::{LARGEST_PEAK_UM, causes, stays, ways};
use super::robust_stats::{median, quantum};
use rtec_model::record::{Column, Record, Role, RunKind};
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Rows from which a robust spread is used instead of this test.
pub(super) const FEW: usize = 30;
/// Minimum number of rows for an estimate of the noise.
const FEWEST: usize = 5;
/// Probability of a false outlier per column.
const CHANCE: f64 = 1e-3;
/// Largest share of outliers.
const MOST: f64 = 0.12;
/// Variance inflation of correlated second differences: 1 + 2 Σ ρ².
/// ρ is −2/3 and 1/6 from row to row.
const WORTH_ONE: f64 = 1.0 + 2.0 * (4.0 / 9.0 + 1.0 / 36.0);

/// Outliers of a column, and the noise of its other readings.
#[derive(Debug, Default)]
pub(super) struct SmallSampleOutliers {
    pub(super) rows: Vec<usize>,
    pub(super) spread: f64,
}

/// The deviation of a reading from its neighbours in one order of the rows.
struct NeighbourDeviation {
    row: usize,
    off: f64,
    /// Noise of the other rows, from this many differences.
    noise: f64,
    differences: usize,
}

/// Outliers of a response.
pub(super) fn of_response(record: &Record, c: &Column) -> SmallSampleOutliers {
    let is_error = matches!(c.role, Role::Error(_));
    // A peak over the angle is a form error.
    let form = record.column(&Role::Angle).is_some();
    let may_peak = causes(record);
    let last = c.data.len().saturating_sub(1);
    let excused = |row: usize, off: f64| {
        let honest = form || may_peak[row] || row == 0 || row == last;
        honest && !(is_error && off > LARGEST_PEAK_UM)
    };
    let mut orders = vec![vec![(0..c.data.len()).collect()]];
    orders.extend(Some(ways(record, c)).filter(|by_place| !by_place.is_empty()));
    let mut found = wild(&c.data, &orders, &excused, |off| is_error && off > LARGEST_PEAK_UM);
    if found.rows.is_empty()
        && returns_to_one_place(record)
        && let Some((row, spread)) = apart_from_all(&c.data)
    {
        found = SmallSampleOutliers { rows: vec![row], spread };
    }
    let usual = median(c.data.clone());
    found.rows.retain(|row| !stays(&c.data, *row, c.data[*row] - usual));
    found
}

/// Whether only time, cycle and responses change: rows repeat one measurement.
fn returns_to_one_place(record: &Record) -> bool {
    let counts = |role: &Role| matches!(role, Role::Time | Role::Cycle) || role.is_response();
    let changes = |c: &Column| c.data.windows(2).any(|w| w[0].to_bits() != w[1].to_bits());
    record.kind != RunKind::Drift && !record.columns.iter().any(|c| !counts(&c.role) && changes(c))
}

/// The outlier of repeated readings of one place, and the scatter of the others.
/// Its difference from their mean follows Student's law with n − 2 degrees of freedom (Grubbs, "Sample
/// criteria for testing outlying observations", 1950).
fn apart_from_all(v: &[f64]) -> Option<(usize, f64)> {
    let n = v.len() as f64;
    let law = StudentsT::new(0.0, 1.0, n - 2.0).ok()?;
    let off = |row: usize| {
        let rest: Vec<f64> = v.iter().enumerate().filter(|(i, _)| *i != row).map(|(_, v)| *v).collect();
        let mean = rest.iter().sum::<f64>() / (n - 1.0);
        let s = (rest.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 2.0)).sqrt();
        let s = s.max(rounding(&rest, v));
        (row, s, (v[row] - mean).abs() / (s * (1.0 + 1.0 / (n - 1.0)).sqrt()))
    };
    let (row, s, size) = (0..v.len()).map(off).max_by(|a, b| a.2.total_cmp(&b.2))?;
    (size > -law.inverse_cdf(CHANCE / 2.0 / n)).then_some((row, s))
}

/// Outliers of a column in these orders of its rows.
/// `excused` rows may deviate. `beyond` is a deviation that no physics explains: it is compared only with the
/// noise of the others.
pub(super) fn wild(
    v: &[f64],
    orders: &[Vec<Vec<usize>>],
    excused: &dyn Fn(usize, f64) -> bool,
    beyond: impl Fn(f64) -> bool,
) -> SmallSampleOutliers {
    let most = ((MOST * v.len() as f64) as usize).max(1);
    let (mut out, mut wild) = (Vec::new(), SmallSampleOutliers::default());
    for _ in 0..most {
        // Use the order in which the other rows are smoothest.
        let held = orders.iter().filter_map(|order| farthest(v, order, &out, excused));
        let Some(worst) = held.min_by(|a, b| a.noise.total_cmp(&b.noise)) else { break };
        let rest: Vec<f64> =
            (0..v.len()).filter(|i| *i != worst.row && !out.contains(i)).map(|i| v[i]).collect();
        let all = [&rest[..], &[v[worst.row]]].concat();
        let noise = worst.noise.max(rounding(&rest, &all));
        out.push(worst.row);
        if worst.off > bound(rest.len() + 1, worst.differences) * noise
            || beyond(worst.off) && worst.off > 100.0 * worst.noise
        {
            wild = SmallSampleOutliers { rows: out.clone(), spread: worst.noise };
        }
    }
    wild.rows.sort_unstable();
    wild
}

/// Standard deviation of rounding to the resolution, the least noise.
/// If all the others are equal, the deviation itself gives the resolution.
fn rounding(others: &[f64], all: &[f64]) -> f64 {
    let step = if quantum(others) > 0.0 { quantum(others) } else { quantum(all) };
    step / 12_f64.sqrt()
}

/// Student's quantile for [`CHANCE`] per column of `rows` rows.
fn bound(rows: usize, differences: usize) -> f64 {
    let freedom = differences as f64 / WORTH_ONE;
    let law = StudentsT::new(0.0, 1.0, freedom);
    law.map_or(f64::INFINITY, |law| -law.inverse_cdf(CHANCE / 2.0 / rows as f64))
}

/// The reading farthest from its neighbours in this order, rows in `out` left out.
fn farthest(
    v: &[f64],
    order: &[Vec<usize>],
    out: &[usize],
    excused: &dyn Fn(usize, f64) -> bool,
) -> Option<NeighbourDeviation> {
    let rows: Vec<Vec<usize>> =
        order.iter().map(|part| part.iter().copied().filter(|i| !out.contains(i)).collect()).collect();
    let off = |part: &[usize], k: usize| {
        let n = part.len();
        let (a, b) = match k {
            0 => (1, 2),
            _ if k == n - 1 => (n - 2, n - 3),
            _ => (k - 1, k + 1),
        };
        let (a, b) = (v[part[k]] - v[part[a]], v[part[k]] - v[part[b]]);
        if a * b > 0.0 { a.abs().min(b.abs()) } else { 0.0 }
    };
    let candidates = rows.iter().filter(|part| part.len() >= 3).flat_map(|part| {
        (0..part.len()).map(|k| (part[k], off(part, k))).filter(|(row, off)| !excused(*row, *off))
    });
    let (row, off) = candidates.max_by(|a, b| a.1.total_cmp(&b.1)).filter(|(_, off)| *off > 0.0)?;
    let (mut squares, mut differences) = (0.0, 0);
    for part in &rows {
        let others: Vec<f64> = part.iter().filter(|i| **i != row).map(|i| v[*i]).collect();
        for w in others.windows(3) {
            squares += (w[1] - f64::midpoint(w[0], w[2])).powi(2);
            differences += 1;
        }
    }
    let noise = (squares / differences as f64).sqrt();
    (differences > 0).then_some(NeighbourDeviation { row, off, noise, differences })
}

/// Whether this small-sample test applies to a column of `rows` rows.
pub(super) fn is_small_sample(rows: usize) -> bool {
    (FEWEST..FEW).contains(&rows)
}
