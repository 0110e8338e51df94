//! Checks rows of one record against its other rows.
//! Finds runs with a wrong direction, a sign or a unit that changes midway, exchanged columns and a clock put
//! forward.

use super::robust_stats::{median, medians_of_others, quantum, range, spread, steps};
use super::sensor_regression::sensor_regression;
use super::{MistakeKind, Suspicion, approach_outliers, motion_consistency};
use crate::iso230::{correlation, mean_of};
use rtec_model::effect::sign;
use rtec_model::record::{Axis, Column, Record, Role, RunKind};

/// Fewest moves of a run.
const RUN: usize = 5;
/// Flipping the sign must reduce the residual below this share.
/// The share is of squares over a record, and of the RMS for one cycle.
const TURNED: f64 = 0.1;
/// Flipping the sign must also beat a step by this ratio of squared residuals.
const NO_STEP: f64 = 0.5;
/// Smallest difference at which two sensors are seen to exchange places, K.
const EXCHANGE_K: f64 = 1.5;
/// Fewest rows of a part in another unit.
const PART: usize = 12;
/// Ratios of the two parts that look like a factor of 1000.
const A_THOUSAND: std::ops::RangeInclusive<f64> = 350.0..=3000.0;
/// A time step above this multiple of the median step is a pause.
const PAUSE: f64 = 20.0;

pub(super) fn look(record: &Record, out: &mut Vec<Suspicion>) {
    let axes: Vec<Axis> = record.axes(Role::Position).cloned().collect();
    for axis in &axes {
        runs(record, axis, out);
    }
    for c in record.responses().filter(|c| matches!(c.role, Role::Error(_))) {
        let at = if record.kind == RunKind::Drift { in_time(record, c) } else { by_place(record, c) };
        if let Some(at) = at {
            let rows: Vec<usize> = (at..c.data.len()).collect();
            let text = "has the sign opposite to the rows before".to_owned();
            out.push(Suspicion::new(record, &c.name, MistakeKind::Sign, &rows, text));
        } else if record.kind == RunKind::Positioning
            && let Some(rows) = of_approaches(record, c)
        {
            let text = "has the sign opposite to the other approaches to the same places".to_owned();
            out.push(Suspicion::new(record, &c.name, MistakeKind::Sign, &rows, text));
        }
    }
    for c in record.responses() {
        other_unit_midway(record, c, out);
    }
    clock(record, out);
    exchanged(record, out);
    counts_as_clock(record, out);
}

/// Detects a part of the rows whose size and bends are 1000 times smaller.
fn other_unit_midway(record: &Record, c: &Column, out: &mut Vec<Suspicion>) {
    let n = c.data.len();
    if n < 2 * PART {
        return;
    }
    // Bends contain neither zero nor drift. Constant values count as a tenth of the resolution.
    let least = quantum(&c.data).max(f64::MIN_POSITIVE);
    let bends: Vec<f64> = c.data.windows(3).map(|w| (w[2] - 2.0 * w[1] + w[0]).abs()).collect();
    let sizes: Vec<f64> = bends.iter().map(|b| b.max(0.1 * least).ln()).collect();
    let whole: f64 = sizes.iter().sum();
    let (mut before, mut best) = (0.0, (0.0, 0));
    for (i, size) in sizes.iter().enumerate() {
        before += size;
        let (k, rest) = ((i + 1) as f64, (sizes.len() - i - 1) as f64);
        if i + 2 >= PART && n - i - 2 >= PART {
            let apart = (before / k - (whole - before) / rest).powi(2) * k * rest;
            best = if apart > best.0 { (apart, i + 2) } else { best };
        }
    }
    let at = best.1;
    if at == 0 {
        return;
    }
    let times = median(bends[..at - 2].to_vec()) / median(bends[at..].to_vec());
    let [rows, other] = if times > 1.0 { [at..n, 0..at] } else { [0..at, at..n] };
    let size = |rows: std::ops::Range<usize>| median(c.data[rows].iter().map(|x| x.abs()));
    let (small, large) = (size(rows.clone()), size(other));
    if A_THOUSAND.contains(&times.max(1.0 / times)) && small > 0.0 && large > A_THOUSAND.start() * small {
        let rows: Vec<usize> = rows.collect();
        let text = "is some 1000 times smaller than in the other rows: given in mm there, called µm?";
        out.push(Suspicion::new(record, &c.name, MistakeKind::Unit, &rows, text.to_owned()));
    }
}

/// Detects time and cycle in each other's column.
/// The cycle has fractions and never decreases, and the time repeats whole numbers.
fn counts_as_clock(record: &Record, out: &mut Vec<Suspicion>) {
    let (Some(t), Some(n)) = (record.column(&Role::Time), record.column(&Role::Cycle)) else { return };
    let whole = |c: &Column| c.data.iter().all(|v| (v - v.round()).abs() < 1e-9);
    let stands = t.data.windows(2).filter(|w| w[1] <= w[0]).count() * 2 > t.data.len();
    if whole(t) && stands && !whole(n) && n.data.windows(2).all(|w| w[1] >= w[0]) {
        let n = &n.name;
        let text = format!(
            "stands still at whole numbers as a repeat does, and {n} goes on as a time: the two look exchanged"
        );
        out.push(Suspicion::new(record, &t.name, MistakeKind::Swapped, &[], text));
    }
}

/// Detects two sensors that exchange columns: each steps to where the other was.
fn exchanged(record: &Record, out: &mut Vec<Suspicion>) {
    let sensors: Vec<&Column> = record.temperatures().collect();
    let usual: Vec<f64> = sensors.iter().map(|c| spread(&steps(&c.data)).max(quantum(&c.data))).collect();
    let n = record.rows();
    for (k, q) in sensors.iter().enumerate() {
        for (i, p) in sensors[..k].iter().enumerate() {
            let most = usual[i].max(usual[k]);
            // Each continues where the other would be, by the last movement of both.
            let goes_on = |x: &Column, y: &Column, at: usize| {
                let due = x.data[at - 1] + (x.data[at - 1] - x.data[at - 2]);
                (y.data[at] - due).abs()
                    < (0.15 * (x.data[at - 1] - y.data[at - 1]).abs()).max(6.0 * most).min(EXCHANGE_K / 2.0)
            };
            let at = (2..n).find(|&at| {
                let apart = (p.data[at - 1] - q.data[at - 1]).abs();
                apart > EXCHANGE_K.max(20.0 * most)
                    && (p.data[at] - p.data[at - 1]) * (q.data[at] - q.data[at - 1]) < 0.0
                    && goes_on(p, q, at)
                    && goes_on(q, p, at)
            });
            if let Some(at) = at {
                let rows: Vec<usize> = (at..n).collect();
                for (own, other) in [(p, q), (q, p)] {
                    let text = format!("goes on where {} was, and that one where this one was", other.name);
                    out.push(Suspicion::new(record, &own.name, MistakeKind::Swapped, &rows, text));
                }
                return;
            }
        }
    }
}

/// Detects runs of rows whose direction column contradicts the movement.
fn runs(record: &Record, axis: &Axis, out: &mut Vec<Suspicion>) {
    let (Some(p), Some(d)) = (record.position(axis), record.column(&Role::Direction(axis.clone()))) else {
        return;
    };
    if out.iter().any(|s| s.is_of(record, d)) {
        return;
    }
    let mut stretches: Vec<(f64, Vec<usize>)> = Vec::new();
    for (i, m) in motion_consistency::moves(p).into_iter().enumerate() {
        let Some(way) = m else { continue };
        match stretches.last_mut() {
            Some((w, rows)) if (*w - way).abs() < 0.5 => rows.push(i),
            _ => stretches.push((way, vec![i])),
        }
    }
    stretches.retain(|(_, rows)| rows.len() >= RUN);
    let against = |(way, rows): &&(f64, Vec<usize>)| {
        rows.iter().filter(|i| d.data[**i] * way < 0.0).count() * 10 >= rows.len() * 9
    };
    let wrong: Vec<&(f64, Vec<usize>)> = stretches.iter().filter(against).collect();
    if wrong.is_empty() || wrong.len() == stretches.len() {
        return;
    }
    let rows: Vec<usize> = wrong.iter().flat_map(|(_, rows)| rows.iter().copied()).collect();
    let text = format!("is opposite to the movement in {} of {} runs", wrong.len(), stretches.len());
    out.push(Suspicion::new(record, &d.name, MistakeKind::Direction, &rows, text));
}

/// Direction of an axis at each row; 0 if unknown.
/// Taken from the direction column, else the velocity, else (on circles) the positions, because lag changes
/// sign with the direction.
fn ways(record: &Record, axis: &Axis, p: &[f64]) -> Vec<f64> {
    if let Some(way) = record.direction_or_velocity(axis) {
        return way.iter().map(|v| sign(*v)).collect();
    }
    if record.kind != RunKind::Ballbar {
        return vec![0.0; p.len()];
    }
    let near = |i: usize| (i.saturating_sub(1), (i + 1).min(p.len() - 1));
    (0..p.len()).map(|i| sign(p[near(i).1] - p[near(i).0])).collect()
}

/// The row from which an error has the opposite sign at the same place.
fn by_place(record: &Record, c: &Column) -> Option<usize> {
    let axis = c.role.axis()?;
    let p = record.position(axis)?;
    let d = ways(record, axis, p);
    let others = approach_outliers::also_moved(record, axis);
    let groups = others
        .iter()
        .fold(approach_outliers::groups(p, &d), |groups, q| approach_outliers::apart_by(groups, q));
    let n = p.len();
    if groups.iter().filter(|g| g.len() >= 3).count() < 8 || range(&c.data) <= 0.0 {
        return None;
    }
    let left = |at: usize| -> f64 {
        let of = |i: usize| if i < at { c.data[i] } else { -c.data[i] };
        let own = |g: &Vec<usize>| {
            let mean = g.iter().map(|i| of(*i)).sum::<f64>() / g.len() as f64;
            g.iter().map(|i| (of(*i) - mean).powi(2)).sum::<f64>()
        };
        groups.iter().map(own).sum()
    };
    let as_it_is = left(n);
    let at = least_left(&groups, &c.data, n / 10..n - n / 10)?;
    let turned = left(at);
    if turned > TURNED * as_it_is {
        return None;
    }
    // A step across zero also looks like that, but it does not reverse the dependence on the place.
    let mean = |g: &Vec<usize>, before: bool| {
        mean_of(&g.iter().filter(|i| (**i < at) == before).map(|i| c.data[*i]).collect::<Vec<_>>())
    };
    let (a, b): (Vec<f64>, Vec<f64>) =
        groups.iter().filter_map(|g| Some((mean(g, true)?, mean(g, false)?))).unzip();
    (a.len() >= 8 && correlation(&a, &b) < -0.85).then_some(at)
}

/// Rows of one cycle whose error has the opposite sign of the other cycles.
/// One direction against the other is not compared: a screw worn along its length looks the same.
fn of_approaches(record: &Record, c: &Column) -> Option<Vec<usize>> {
    let axis = c.role.axis()?;
    let groups = approach_outliers::groups(record.position(axis)?, record.direction(axis)?);
    let cycles = groups.iter().map(Vec::len).min().filter(|n| *n >= 3 && groups.len() >= 8)?;
    let others_of = |g: &Vec<usize>| medians_of_others(&g.iter().map(|i| c.data[*i]).collect::<Vec<_>>());
    let without: Vec<Vec<f64>> = groups.iter().map(others_of).collect();
    for k in 0..cycles {
        let (own, others): (Vec<f64>, Vec<f64>) =
            groups.iter().zip(&without).map(|(g, others)| (c.data[g[k]], others[k])).unzip();
        if is_turned(&own, &others) {
            return Some(groups.iter().map(|g| g[k]).collect());
        }
    }
    None
}

/// Whether the values are the negative of the others, and far from equal.
fn is_turned(own: &[f64], others: &[f64]) -> bool {
    let left = |sign: f64| own.iter().zip(others).map(|(a, b)| (a - sign * b).powi(2)).sum::<f64>();
    left(-1.0) < TURNED * TURNED * left(1.0) && correlation(own, others) < -0.95
}

/// The row in `rows` from which flipping the sign leaves the least scatter.
/// Going one row on changes the sign of one value, and so the sum of one group.
fn least_left(groups: &[Vec<usize>], data: &[f64], rows: std::ops::Range<usize>) -> Option<usize> {
    let mut group_of = vec![None; data.len()];
    let mut sums = vec![0.0; groups.len()];
    for (g, own) in groups.iter().enumerate() {
        for i in own {
            group_of[*i] = Some(g);
            sums[g] += if *i < rows.start { data[*i] } else { -data[*i] };
        }
    }
    // Sum of squares that the means explain; the total does not depend on the sign.
    let explains = |g: usize, sum: f64| sum * sum / groups[g].len().max(1) as f64;
    let mut explained: f64 = sums.iter().enumerate().map(|(g, sum)| explains(g, *sum)).sum();
    let mut best: Option<(f64, usize)> = None;
    for at in rows {
        if best.is_none_or(|b| explained > b.0) {
            best = Some((explained, at));
        }
        if let Some(g) = group_of[at] {
            explained -= explains(g, sums[g]);
            sums[g] += 2.0 * data[at];
            explained += explains(g, sums[g]);
        }
    }
    best.map(|b| b.1)
}

/// The row from which the error of a drift test has the opposite sign.
fn in_time(record: &Record, c: &Column) -> Option<usize> {
    let n = c.data.len();
    let names: Vec<&str> = record.names(&Role::Temperature).collect();
    if n < 40 || names.is_empty() {
        return None;
    }
    // At such a row the error steps from a value to its opposite.
    let own = steps(&c.data);
    let usual = spread(&own);
    let steps_over = |k: usize| {
        let (before, after) = (median(c.data[k - 3..k].to_vec()), median(c.data[k..k + 3].to_vec()));
        let step = (after - before).abs();
        step > 8.0 * usual && (after + before).abs() < 0.2 * step
    };
    let candidates: Vec<usize> = (n / 20 + 3..n - n / 20 - 3).filter(|k| steps_over(*k)).collect();
    let left = |at: usize| {
        let data: Vec<f64> = c.data.iter().enumerate().map(|(i, v)| if i < at { *v } else { -v }).collect();
        sensor_regression(record, &data, &names).left
    };
    let as_it_is = left(n);
    let (turned, at) = candidates.into_iter().map(|k| (left(k), k)).min_by(|a, b| a.0.total_cmp(&b.0))?;
    // A step from a value to its opposite without a changed slope is lost counts.
    let step = median(c.data[at..at + 3].to_vec()) - median(c.data[at - 3..at].to_vec());
    let stepped: Vec<f64> =
        c.data.iter().enumerate().map(|(i, v)| if i < at { *v } else { v - step }).collect();
    let stepped = sensor_regression(record, &stepped, &names).left;
    let squares = turned * turned;
    (squares < TURNED * as_it_is * as_it_is && squares < NO_STEP * stepped * stepped).then_some(at)
}

/// Detects a clock put forward: a pause in which no temperature went on.
fn clock(record: &Record, out: &mut Vec<Suspicion>) {
    let Some(t) = record.column(&Role::Time).filter(|t| record.kind == RunKind::Drift && t.data.len() >= 40)
    else {
        return;
    };
    let own = steps(&t.data);
    let usual = median(own.clone());
    let pauses: Vec<usize> = (10..own.len().saturating_sub(10)).filter(|i| own[*i] > PAUSE * usual).collect();
    let [at] = pauses[..] else { return };
    // Per temperature: did it move over the pause, given equal slopes before and after?
    let went_on = |c: &Column| {
        let rate = |from: usize| (c.data[from + 9] - c.data[from]) / (t.data[from + 9] - t.data[from]);
        let (before, behind) = (rate(at - 9), rate(at + 1));
        let due = f64::midpoint(before, behind) * own[at];
        let alike = (before - behind).abs() < 0.3 * before.abs().max(behind.abs());
        let moved = c.data[at + 1] - c.data[at];
        (alike && due.abs() > 1.0).then(|| moved.abs() > 0.3 * due.abs())
    };
    let told: Vec<bool> = record.temperatures().filter_map(went_on).collect();
    if told.len() >= 2 && told.iter().all(|on| !on) {
        let s = own[at];
        let text = format!(
            "goes on by {s:.0} s in one step, in which no temperature moves on: the clock looks put forward"
        );
        out.push(Suspicion::new(record, &t.name, MistakeKind::Jump, &[at + 1], text));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The same as trying each row.
    #[test]
    fn the_row_where_a_sign_turns_leaves_least() {
        let groups: Vec<Vec<usize>> = (0..9).map(|g| (0..60).filter(|i| i * i % 9 == g).collect()).collect();
        for turned in [11, 30, 47] {
            let value = |i: usize| (i * i % 9) as f64 - 3.3 + 0.1 * ((i * 37 % 11) as f64 - 5.0);
            let data: Vec<f64> = (0..60).map(|i| if i < turned { value(i) } else { -value(i) }).collect();
            let left = |at: usize| -> f64 {
                let of = |i: &usize| if *i < at { data[*i] } else { -data[*i] };
                let own = |g: &Vec<usize>| {
                    let mean = g.iter().map(of).sum::<f64>() / g.len().max(1) as f64;
                    g.iter().map(|i| (of(i) - mean).powi(2)).sum::<f64>()
                };
                groups.iter().map(own).sum()
            };
            let slow = (6..54).min_by(|a, b| left(*a).total_cmp(&left(*b)));
            assert_eq!((least_left(&groups, &data, 6..54), slow), (Some(turned), Some(turned)));
        }
    }
}
