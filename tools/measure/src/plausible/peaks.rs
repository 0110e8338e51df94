//! Where a short peak is physical, and in which orders rows are neighbours.
//! A peak is physical at a turn, at a change of coolant, speed, load or temperature, at a run's ends, and in a state that stays.

use super::stats::{median, range, spread, steps};
use rtec_model::record::{Axis, Column, Record, Role};

/// The bound of a reversal spike's amplitude in the dictionary, µm.
pub(super) const LARGEST_PEAK_UM: f64 = 1000.0;

/// The axis along whose positions a response is read.
/// Its own, or where that stands still the only one that moves: a straightness, a tilt. `None` where positions were not logged.
pub(super) fn read_along<'r>(record: &'r Record, c: &'r Column) -> Option<&'r Axis> {
    let moves = |axis: &Axis| record.data(&Role::Position(axis.clone())).is_some_and(|p| range(p) > 0.0);
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

/// The rows of each direction, in the order of the positions of [`read_along`].
/// None where these were not logged.
pub(super) fn ways(record: &Record, c: &Column) -> Vec<Vec<usize>> {
    let Some(axis) = read_along(record, c) else { return Vec::new() };
    let Some(p) = record.data(&Role::Position(axis.clone())) else { return Vec::new() };
    let d = record.data(&Role::Direction(axis.clone()));
    let of = |way: f64| {
        let own = |i: &usize| (d.map_or(0.0, |d| d[*i]) - way).abs() < 0.5;
        let mut rows: Vec<usize> = (0..p.len()).filter(own).collect();
        rows.sort_by(|a, b| p[*a].total_cmp(&p[*b]).then(a.cmp(b)));
        rows
    };
    [-1.0, 0.0, 1.0].map(of).into()
}

/// Each row's deviation from the median of seven rows, and whether it is isolated.
/// The seven are the row itself and three on each side, in these orders; towards the ends they are fewer, so that a trend leaves nothing. A
/// row is isolated if it stands alone, or in a group of up to [`GROUP`] equal rows far from both sides. The edge of a step is not.
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

/// So many rows on end, one of them far off others, are a level and no single readings; and they lie this near, as a share of how
/// far it is off.
const LEVEL: usize = 4;
const LEVEL_SHARE: f64 = 0.5;

/// Whether a row that is so far off others stands among rows that are as it is, in the order of time.
pub(super) fn stays(v: &[f64], row: usize, off: f64) -> bool {
    let alike = |x: &&f64| (**x - v[row]).abs() < LEVEL_SHARE * off.abs();
    let before = v[..row].iter().rev().take(LEVEL).take_while(alike).count();
    let behind = v[row..].iter().take(LEVEL).take_while(alike).count();
    before + behind >= LEVEL
}

/// A state of so few rows makes a peak.
const SHORT: usize = 3;

/// How many rows on either side of a turn may have a peak.
/// Turns every few rows excuse nothing: that is how the run is made.
fn after_turns(turns: usize, rows: usize) -> Option<usize> {
    match rows / turns.max(1) {
        12.. => Some(3),
        // A circle of thirty rows has one a quarter, and a spike at some of them.
        6.. => Some(1),
        _ => None,
    }
}

/// Rows where something else may honestly make a short peak.
/// At the ends, or by one of the [`causes`].
pub(super) fn excused(record: &Record) -> Vec<bool> {
    let mut out = causes(record);
    let n = out.len();
    out.iter_mut().take(2).for_each(|row| *row = true);
    out[n.saturating_sub(2)..].fill(true);
    out
}

/// Rows next to a reversal, to a change of coolant, spindle speed, load or temperature.
pub(super) fn causes(record: &Record) -> Vec<bool> {
    let n = record.rows();
    let mut out = vec![false; n];
    let mut around = |i: usize, by: usize| {
        (i.saturating_sub(by)..(i + by + 1).min(n)).for_each(|j| out[j] = true);
    };
    for c in &record.columns {
        match &c.role {
            Role::Direction(_) | Role::Velocity(_) | Role::Acceleration(_) => {
                let turns: Vec<usize> = (1..n).filter(|i| c.data[*i] * c.data[i - 1] < 0.0).collect();
                if let Some(by) = after_turns(turns.len(), n) {
                    for i in turns {
                        around(i, by);
                    }
                }
            }
            Role::Position(_) => {
                let d = steps(&c.data);
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
                    // A pump that is on or off for few rows shows in those.
                    let short = |w: &&[usize]| w[1] - w[0] <= SHORT;
                    for w in changes.windows(2).filter(short) {
                        (w[0]..w[1]).for_each(|i| around(i, 0));
                    }
                }
            }
            Role::Load(_) | Role::Channel => {
                // A cause that peaks by itself at a row explains a peak there.
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
