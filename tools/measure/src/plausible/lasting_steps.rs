//! Steps of an error between two rows that stay.
//! They may be a mistake or the machine's own, so they are reported but are no suspicion.

use super::physical_peaks::excused;
use super::robust_stats::{median, spread, steps};
use rtec_model::record::{Column, Record, Role, RunKind};

/// The step must exceed this multiple of the usual row-to-row step.
const OVER_ALL: f64 = 12.0;
/// It must exceed this multiple of the largest step near it.
const OVER_NEAR: f64 = 6.0;
/// Rows are missing if the time step exceeds this multiple of the usual one.
const PAUSE: f64 = 3.0;
/// Rows on either side that give a level.
const SIDE: usize = 6;

/// Reports steps in the errors of drift tests, one line each.
/// Counts were lost, or a gauge or tool was moved.
pub fn steps_of(records: &[Record]) -> Vec<String> {
    let drifts = records.iter().filter(|r| r.kind == RunKind::Drift);
    let of = |r: &Record| {
        let own = r.responses().filter(|c| matches!(c.role, Role::Error(_)));
        own.filter_map(|c| step(r, c)).collect::<Vec<_>>()
    };
    drifts.flat_map(of).collect()
}

fn step(record: &Record, c: &Column) -> Option<String> {
    let n = c.data.len();
    if n < 40 {
        return None;
    }
    let own = steps(&c.data);
    let usual = spread(&own);
    let size = |i: usize| own[i].abs();
    let at = (SIDE..n - SIDE).max_by(|a, b| size(*a).total_cmp(&size(*b)))?;
    let near = (at - SIDE + 1..at + SIDE - 1).filter(|i| *i != at).map(size).fold(0.0, f64::max);
    if usual <= 0.0 || size(at) < OVER_ALL * usual || size(at) < OVER_NEAR * near || excused(record)[at + 1] {
        return None;
    }
    // Over missing rows the error may drift by more than a step.
    let time = record.time_s();
    if time[at + 1] - time[at] > PAUSE * median(steps(time)) {
        return None;
    }
    let level = |rows: std::ops::Range<usize>| median(c.data[rows].to_vec());
    let stays = level(at + 1..at + 1 + SIDE) - level(at + 1 - SIDE..at + 1);
    (stays / own[at] > 0.7).then(|| {
        format!(
            "{}: {}: steps by {:.1} µm at row {} and stays: counts that were lost, or a gauge or tool that was moved",
            record.path.display(),
            c.name,
            own[at],
            record.first_row() + at + 2
        )
    })
}
