//! Single approaches to a target that are far from the others to the same target.

use super::physical_peaks::{read_along, stays};
use super::robust_stats::{distinct, median, range};
use super::{MistakeKind, Suspicion};
use rtec_model::record::{Axis, Column, Record, Role, RunKind};

/// An approach is an outlier above this multiple of the approaches' robust spread.
const FAR: f64 = 10.0;
/// The worst outlier must exceed this multiple.
const WORST: f64 = 14.0;

/// Outliers among the approaches of a positioning run to the same target.
/// Columns with known outliers are skipped.
pub(super) fn look(record: &Record, out: &mut Vec<Suspicion>) {
    for c in record.measured().filter(|_| record.kind == RunKind::Positioning) {
        let known = |s: &Suspicion| s.what == MistakeKind::Outliers && s.is_of(record, c);
        let Some(axis) = read_along(record, c).filter(|_| !out.iter().any(known)) else { continue };
        let (Some(p), Some(d)) = (record.position(axis), record.direction(axis)) else {
            continue;
        };
        let groups = groups(p, d);
        if groups.iter().filter(|g| g.len() >= 3).count() * 2 < groups.len().max(8) {
            continue;
        }
        let mut away = vec![0.0; record.rows()];
        for g in groups.iter().filter(|g| g.len() >= 3) {
            let middle = median(g.iter().map(|i| c.data[*i]));
            for i in g {
                away[*i] = c.data[*i] - middle;
            }
        }
        // The median approach of each group deviates by 0 and tells nothing of the spread.
        let others: Vec<f64> = away.iter().map(|v| v.abs()).filter(|v| *v > 0.0).collect();
        let resolution = smallest_step(&c.data);
        let spread = (1.4826 * median(others)).max(resolution);
        let far = |i: &usize| away[*i].abs() > FAR * spread;
        // Before its first reversal an axis lacks the spike that each later pass begins with.
        let begun = (0..away.len()).take_while(far).count();
        let begun = if d[..begun].windows(2).all(|w| w[0] * w[1] > 0.0) { begun } else { 0 };
        // A level that persists is not a single approach.
        let single = |i: &usize| far(i) && !stays(&c.data, *i, away[*i]);
        let rows: Vec<usize> = (begun..away.len()).filter(single).collect();
        let worst = rows.iter().map(|i| away[*i].abs()).fold(0.0, f64::max);
        let tails = away[begun..].iter().filter(|v| v.abs() > 5.0 * spread).count() - rows.len();
        if spread > 0.0 && worst > WORST * spread && rows.len() * 20 <= away.len() && 2 * tails <= rows.len()
        {
            let text = format!(
                "{} of {} approaches are up to {worst:.1} off the others to the same target (the others spread by {spread:.2})",
                rows.len(),
                away.len()
            );
            out.push(Suspicion::new(record, &c.name, MistakeKind::Outliers, &rows, text));
        }
    }
}

/// An axis moves if its range exceeds this share of the other axis's range.
pub(super) const MOVES: f64 = 0.01;

/// Positions of the other axes that move.
/// On a plate or a circle one axis alone does not define a place.
pub(super) fn also_moved<'r>(record: &'r Record, axis: &Axis) -> Vec<&'r [f64]> {
    let least = MOVES * record.position(axis).map_or(0.0, range);
    let other = |c: &&Column| matches!(&c.role, Role::Position(a) if a != axis) && range(&c.data) > least;
    record.columns.iter().filter(other).map(|c| c.data.as_slice()).collect()
}

/// Splits each group where another axis is at another position.
pub(super) fn apart_by(groups: Vec<Vec<usize>>, q: &[f64]) -> Vec<Vec<usize>> {
    let apart = range(q) / 200.0;
    let mut out = Vec::new();
    for mut group in groups {
        group.sort_by(|a, b| q[*a].total_cmp(&q[*b]).then(a.cmp(b)));
        for part in group.chunk_by(|a, b| q[*b] - q[*a] <= apart) {
            let mut rows = part.to_vec();
            rows.sort_unstable();
            out.push(rows);
        }
    }
    out
}

/// Rows of one target and one direction, grouped by position.
pub(super) fn groups(p: &[f64], d: &[f64]) -> Vec<Vec<usize>> {
    let mut order: Vec<usize> = (0..p.len()).collect();
    order.sort_by(|a, b| p[*a].total_cmp(&p[*b]));
    let (lo, hi) = (order.first().map_or(0.0, |i| p[*i]), order.last().map_or(0.0, |i| p[*i]));
    let apart = (hi - lo) / 200.0;
    let ways = |t: &[usize]| {
        let (up, down): (Vec<usize>, Vec<usize>) = t.iter().partition(|i| d[**i] > 0.0);
        [up, down]
    };
    order.chunk_by(|a, b| p[*b] - p[*a] <= apart).flat_map(ways).filter(|g| !g.is_empty()).collect()
}

/// Resolution of the values, if at most half of them differ; else 0.
fn smallest_step(values: &[f64]) -> f64 {
    if distinct(values) * 2 > values.len() {
        return 0.0;
    }
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.windows(2).map(|w| w[1] - w[0]).filter(|s| *s > 0.0).fold(f64::INFINITY, f64::min)
}
