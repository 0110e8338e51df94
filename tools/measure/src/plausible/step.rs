//! What may be a mistake or the machine's own, and is worth a look either way.
//! An error that steps between two rows and stays.

use super::peaks::excused;
use super::stats::{median, spread, steps};
use rtec_model::record::{Column, Kind, Record, Role};

/// So many times the usual step from row to row, and the largest of those around it.
const OVER_ALL: f64 = 12.0;
const OVER_NEAR: f64 = 6.0;
/// Rows that are so many times the usual time apart have others missing between them.
const PAUSE: f64 = 3.0;
/// Rows on either side that a level is taken from.
const SIDE: usize = 6;

/// Steps in the errors of drift tests, a line each.
/// Lost counts, or a gauge or tool that was moved.
pub fn steps_of(records: &[Record]) -> Vec<String> {
    let drifts = records.iter().filter(|r| r.kind == Kind::Drift);
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
    // Where rows are missing the error went on without them.
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
