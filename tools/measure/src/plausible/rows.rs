//! Rows that stand twice, and responses far off all others.

use super::stats::{distinct, median, range, spread, steps};
use super::{Suspicion, What};
use rtec_model::record::{Column, Record, Role};
use std::collections::HashMap;

/// A block that stands twice is at least so long.
const BLOCK: usize = 8;

pub(super) fn look(record: &Record, out: &mut Vec<Suspicion>) {
    doubled(record, out);
    for c in record.responses() {
        flat(record, c, out);
        wild(record, c, out);
    }
}

/// The same row again: the next one, or a block pasted once more.
fn doubled(record: &Record, out: &mut Vec<Suspicion>) {
    let n = record.rows();
    if n < 4 {
        return;
    }
    let with_time = record.column(&Role::Time).is_some();
    let whole: Vec<&Column> = record.columns.iter().collect();
    let measured: Vec<&Column> = record.columns.iter().filter(|c| c.role != Role::Time).collect();
    let same =
        |of: &[&Column], i: usize, j: usize| of.iter().all(|c| c.data[i].to_bits() == c.data[j].to_bits());
    // The next row, or the one after where pairs were doubled: with time the clock says so, without it neighbours must
    // be alike far more often than rows a few apart.
    let next: Vec<usize> = (1..n).filter(|i| same(&whole, *i, i - 1)).collect();
    let apart = (7..n).filter(|i| same(&whole, *i, i - 7)).count();
    let told = if with_time { !next.is_empty() } else { next.len() >= 3 && next.len() > 10 * apart };
    if told {
        let text = format!("{} of {n} rows are the row before once more", next.len());
        out.push(Suspicion::new(record, "", What::Doubled, &next, text));
        return;
    }
    let copies = pasted(record, &measured, &same);
    if !copies.is_empty() {
        let text = format!("{} of {n} rows repeat earlier ones in every measured value", copies.len());
        out.push(Suspicion::new(record, "", What::Doubled, &copies, text));
    }
}

/// Rows of blocks that repeat an earlier block in all that was measured, where that is no chance.
fn pasted(
    record: &Record,
    measured: &[&Column],
    same: &dyn Fn(&[&Column], usize, usize) -> bool,
) -> Vec<usize> {
    let n = record.rows();
    // Only what is noisy cannot repeat by itself: rows are told apart by a response that does not run smoothly.
    let noisy = record.responses().any(|c| rough(&c.data) && distinct(&c.data) * 4 > n);
    if !noisy || n < 2 * BLOCK {
        return Vec::new();
    }
    let key = |i: usize| measured.iter().map(|c| c.data[i].to_bits()).collect::<Vec<u64>>();
    let mut first: HashMap<Vec<u64>, Vec<usize>> = HashMap::new();
    for i in 0..n {
        first.entry(key(i)).or_default().push(i);
    }
    let mut rows = Vec::new();
    let mut i = 1;
    while i < n {
        let starts = first.get(&key(i)).map_or(&[][..], Vec::as_slice);
        // The longest run from here that some earlier stretch has too.
        let length = |j: usize| (0..n - i).take_while(|k| j + k < i && same(measured, i + k, j + k)).count();
        let best = starts.iter().filter(|j| **j < i).take(50).map(|j| length(*j)).max().unwrap_or(0);
        if best >= BLOCK {
            rows.extend(i..i + best);
            i += best;
        } else {
            i += 1;
        }
    }
    // A machine without noise repeats itself in every cycle; a pasted block is not all there is, but for one copy of all.
    if rows.len() * 2 > n { Vec::new() } else { rows }
}

/// Up and down from row to row more often than not.
fn rough(v: &[f64]) -> bool {
    let d = steps(v);
    let turns = d.windows(2).filter(|w| w[0] * w[1] < 0.0).count();
    turns * 100 > 35 * d.len()
}

/// A response that stands still: a gauge that is not read.
fn flat(record: &Record, c: &Column, out: &mut Vec<Suspicion>) {
    let n = c.data.len();
    if n < 40 {
        return;
    }
    let mut best = (0, 0);
    let mut start = 0;
    for i in 0..=n {
        if i == n || c.data[i].to_bits() != c.data[start].to_bits() {
            if i - start > best.1 - best.0 {
                best = (start, i);
            }
            start = i;
        }
    }
    let length = best.1 - best.0;
    let outside: Vec<f64> = (0..n).filter(|i| *i < best.0 || *i >= best.1).map(|i| c.data[i]).collect();
    if outside.len() < 20 || length < 20 {
        return;
    }
    let p = outside.windows(2).filter(|w| w[0].to_bits() != w[1].to_bits()).count() as f64
        / (outside.len() - 1) as f64;
    // Coarse steps change less where the value lies between two of them, hence the square.
    let chance = length as f64 * (1.0 - 0.7 * p.min(0.95).powi(2)).ln() + (n as f64).ln();
    if p >= 0.7 && distinct(&outside) * 4 > outside.len() && chance < (1e-8_f64).ln() {
        let rows: Vec<usize> = (best.0..best.1).collect();
        let text = format!("reads {} in {length} rows on end, as it does nowhere else", c.data[best.0]);
        out.push(Suspicion::new(record, &c.name, What::Stuck, &rows, text));
    }
}

/// Rows far off those that are near in time, and off those near in position and direction.
fn wild(record: &Record, c: &Column, out: &mut Vec<Suspicion>) {
    let n = c.data.len();
    if n < 20 || range(&c.data) <= 0.0 {
        return;
    }
    let excused = excused(record);
    let in_time: Vec<usize> = (0..n).collect();
    let mut lefts = vec![beside(&c.data, &in_time)];
    if let Some(axis) = c.role.axis()
        && let Some(p) = record.data(&Role::Position(axis.clone()))
    {
        let d = record.data(&Role::Direction(axis.clone()));
        let mut left = vec![0.0; n];
        for way in [-1.0, 0.0, 1.0] {
            let mut rows: Vec<usize> = (0..n).filter(|i| d.map_or(0.0, |d| d[*i]) == way).collect();
            rows.sort_by(|a, b| p[*a].total_cmp(&p[*b]).then(a.cmp(b)));
            let own = beside(&c.data, &rows);
            rows.iter().for_each(|i| left[*i] = own[*i]);
        }
        lefts.push(left);
    }
    // By the order in which the response runs most smoothly.
    let left = lefts.into_iter().min_by(|a, b| spread(a).total_cmp(&spread(b)));
    let Some(left) = left else { return };
    let scale = spread(&left);
    if scale <= 0.0 {
        return;
    }
    let far = |i: usize| left[i].abs() / scale;
    let rows: Vec<usize> = (0..n).filter(|i| far(*i) > 9.0 && !excused[*i]).collect();
    let worst = rows.iter().map(|i| far(*i)).fold(0.0, f64::max);
    // Heavy tails are one thing, a few rows beyond all others another: between the two lies a gap.
    let bulk = (0..n).filter(|i| !rows.contains(i) && !excused[*i] && far(*i) > 5.0).count();
    let apart = rows.windows(2).filter(|w| w[1] == w[0] + 1).count() * 2 <= rows.len();
    let enough = rows.len() >= 2 && worst > 12.0 || worst > 20.0;
    if enough && apart && rows.len() * 100 <= 12 * n && bulk <= rows.len() {
        let text = format!(
            "{} of {n} rows are far off those beside them, as {:.2} (the others spread by {scale:.2})",
            rows.len(),
            c.data[rows[0]]
        );
        out.push(Suspicion::new(record, &c.name, What::Outliers, &rows, text));
    }
}

/// What each row has beyond the median of the three before, itself and the three after it in this order; of fewer towards
/// the ends, so that a trend leaves nothing there.
fn beside(v: &[f64], order: &[usize]) -> Vec<f64> {
    let n = order.len();
    let mut left = vec![0.0; v.len()];
    for (k, i) in order.iter().enumerate() {
        let half = 3.min(k).min(n - 1 - k);
        let near: Vec<f64> = order[k - half..=k + half].iter().map(|j| v[*j]).collect();
        left[*i] = v[*i] - median(near);
    }
    left
}

/// Rows where something else may honestly make a short peak: next to a reversal, to a change of coolant, spindle speed,
/// load or temperature, at the ends.
fn excused(record: &Record) -> Vec<bool> {
    let n = record.rows();
    let mut out = vec![false; n];
    let mut around = |i: usize, by: usize| {
        (i.saturating_sub(by)..(i + by + 1).min(n)).for_each(|j| out[j] = true);
    };
    around(0, 1);
    around(n - 1, 1);
    for c in &record.columns {
        match &c.role {
            Role::Direction(_) | Role::Velocity(_) | Role::Acceleration(_) => {
                // Signs that turn every few rows excuse nothing: that is how the run is made.
                let turns: Vec<usize> = (1..n).filter(|i| c.data[*i] * c.data[i - 1] < 0.0).collect();
                if turns.len() * 12 <= n {
                    turns.iter().for_each(|i| around(*i, 3));
                }
            }
            Role::Position(_) => {
                let d = steps(&c.data);
                let turns: Vec<usize> = (1..d.len()).filter(|i| d[*i] * d[i - 1] < 0.0).collect();
                if turns.len() * 12 <= n {
                    turns.iter().for_each(|i| around(*i, 3));
                }
            }
            Role::Coolant | Role::SpindleSpeed => {
                let changes: Vec<usize> =
                    (1..n).filter(|i| c.data[*i].to_bits() != c.data[i - 1].to_bits()).collect();
                if changes.len() * 6 <= n {
                    changes.iter().for_each(|i| around(*i, 2));
                }
            }
            Role::Load(_) | Role::Channel => {
                // A cause that peaks by itself at a row explains a peak there.
                let order: Vec<usize> = (0..n).collect();
                let left = beside(&c.data, &order);
                let scale = spread(&left);
                (0..n).filter(|i| left[*i].abs() > 6.0 * scale.max(1e-12)).for_each(|i| around(i, 0));
            }
            _ => {}
        }
    }
    out
}
