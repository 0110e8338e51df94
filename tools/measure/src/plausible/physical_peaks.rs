//! Where a short peak is physical, and in which orders rows are neighbours.
//! Peaks are physical at reversals, at changes of coolant or spindle speed, at peaks of load or a channel,
//! and at a run's ends.

use super::robust_stats::{median, range, spread, steps};
use rtec_model::record::{Axis, Column, Record, Role};

/// Largest amplitude of a reversal spike in the effect dictionary, µm.
pub(super) const LARGEST_PEAK_UM: f64 = 1000.0;

/// The axis along whose positions a response is read.
/// The response's own axis, or the only moving one if that is at rest (straightness, tilt). `None` if there
/// is no such axis.
pub(super) fn read_along<'r>(record: &'r Record, c: &'r Column) -> Option<&'r Axis> {
    let moves = |axis: &Axis| record.position(axis).is_some_and(|p| range(p) > 0.0);
    let own = match &c.role {
        Role::AngleError(axis, _) => Some(axis),
        role => role.axis(),
    };
    let mut others = record.columns.iter().filter_map(|c| match &c.role {
        Role::Position(axis) => Some(axis).filter(|axis| moves(axis)),
        _ => None,
    });
    own.filter(|axis| moves(axis)).or_else(|| others.next().filter(|_| others.next().is_none()))
}

/// The rows of each direction, sorted by the position of [`read_along`].
/// Empty if positions are not logged.
pub(super) fn ways(record: &Record, c: &Column) -> Vec<Vec<usize>> {
    let Some(axis) = read_along(record, c) else { return Vec::new() };
    let Some(p) = record.position(axis) else { return Vec::new() };
    let d = record.direction(axis);
    let of = |way: f64| {
        let own = |i: &usize| (d.map_or(0.0, |d| d[*i]) - way).abs() < 0.5;
        let mut rows: Vec<usize> = (0..p.len()).filter(own).collect();
        rows.sort_by(|a, b| p[*a].total_cmp(&p[*b]).then(a.cmp(b)));
        rows
    };
    [-1.0, 0.0, 1.0].map(of).into()
}

/// Each row's deviation from the median of seven rows, and whether it is isolated.
/// The seven are the row and three on each side, in these orders. Towards the ends they are fewer and stay
/// symmetric, so that a trend leaves nothing. An isolated row is in a group of at most [`GROUP`] rows that is
/// far from both sides; the edge of a step is not isolated.
pub(super) fn beside(v: &[f64], orders: &[Vec<usize>]) -> (Vec<f64>, Vec<bool>) {
    let (mut left, mut alone) = (vec![0.0; v.len()], vec![false; v.len()]);
    for order in orders {
        for (k, i) in order.iter().enumerate() {
            let half = 3.min(k).min(order.len() - 1 - k);
            if half == 0 {
                continue;
            }
            let near: Vec<f64> = order[k - half..=k + half].iter().map(|j| v[*j]).collect();
            left[*i] = v[*i] - median(near);
            let far = |j: &usize| (v[*i] - v[*j]) / left[*i] > 0.6;
            let before = order[..k].iter().rev().take(GROUP).position(far);
            let behind = order[k + 1..].iter().take(GROUP).position(far);
            let group = before.zip(behind).map(|(before, behind)| 1 + before + behind);
            alone[*i] = left[*i] != 0.0 && group.is_some_and(|rows| rows <= GROUP);
        }
    }
    (left, alone)
}

/// Most consecutive bad readings; with more, the median of seven rows is bad.
const GROUP: usize = 3;

/// Consecutive similar rows from which a deviation is a level, not single readings.
const LEVEL: usize = 4;
/// Rows of a level differ by less than this share of its deviation.
const LEVEL_SHARE: f64 = 0.5;

/// Whether a row that deviates by `off` is part of a level in time order.
pub(super) fn stays(v: &[f64], row: usize, off: f64) -> bool {
    let alike = |x: &&f64| (**x - v[row]).abs() < LEVEL_SHARE * off.abs();
    let before = v[..row].iter().rev().take(LEVEL).take_while(alike).count();
    let behind = v[row..].iter().take(LEVEL).take_while(alike).count();
    before + behind >= LEVEL
}

/// Most rows of a short coolant state, in which a peak is physical.
const SHORT: usize = 3;

/// Rows on either side of a reversal that may have a peak.
/// `None` if the run reverses every few rows.
fn after_turns(turns: usize, rows: usize) -> Option<usize> {
    match rows / turns.max(1) {
        12.. => Some(3),
        // A circle of 30 rows reverses every quarter and may have a spike there.
        6.. => Some(1),
        _ => None,
    }
}

/// Rows in which a short peak may be physical: both ends and [`causes`].
pub(super) fn excused(record: &Record) -> Vec<bool> {
    let mut out = causes(record);
    let n = out.len();
    out.iter_mut().take(2).for_each(|row| *row = true);
    out[n.saturating_sub(2)..].fill(true);
    out
}

/// Rows near a reversal, a change of coolant or speed, or a peak of a load.
pub(super) fn causes(record: &Record) -> Vec<bool> {
    let n = record.rows();
    let mut out = vec![false; n];
    let mut around = |i: usize, by: usize| {
        (i.saturating_sub(by)..(i + by + 1).min(n)).for_each(|j| out[j] = true);
    };
    for c in &record.columns {
        match &c.role {
            Role::Direction(_) | Role::Velocity(_) | Role::Acceleration(_) | Role::Position(_) => {
                let d = if matches!(c.role, Role::Position(_)) { steps(&c.data) } else { c.data.clone() };
                let turns: Vec<usize> = (1..d.len()).filter(|i| d[*i] * d[i - 1] < 0.0).collect();
                if let Some(by) = after_turns(turns.len(), n) {
                    for i in turns {
                        around(i, by);
                    }
                }
            }
            Role::Coolant | Role::SpindleSpeed => {
                let changes: Vec<usize> =
                    (1..n).filter(|i| c.data[*i].to_bits() != c.data[i - 1].to_bits()).collect();
                if changes.len() * 6 <= n {
                    for i in changes {
                        around(i, 2);
                    }
                } else if c.role == Role::Coolant {
                    // A pump that is on or off for few rows affects those rows.
                    let short = changes.windows(2).filter(|w| w[1] - w[0] <= SHORT);
                    short.flat_map(|w| w[0]..w[1]).for_each(|i| around(i, 0));
                }
            }
            Role::Load(_) | Role::Channel => {
                // A cause that has a peak itself explains one in the response.
                let order: Vec<usize> = (0..n).collect();
                let (left, _) = beside(&c.data, &[order]);
                let scale = spread(&left);
                (0..n).filter(|i| left[*i].abs() > 6.0 * scale.max(1e-12)).for_each(|i| around(i, 0));
            }
            _ => {}
        }
    }
    out
}
