//! LinuxCNC's compensation file, read as LinuxCNC reads it.

use super::finite;
use crate::compensation_export::linuxcnc::{LinuxcncLinearUnit, MOST};
use rtec_files::{InputError, Result};
use rtec_model::record::{Axis, Column, Record, Role, RunKind};
use std::path::Path;

/// Reads a LinuxCNC compensation file (`COMP_FILE`).
/// Lines are `nominal forward backward` in machine units. Type 0 gives the positions reached, type 1
/// (`trims`) the values added to the command. Errors are position reached less nominal.
///
/// # Errors
/// A line that does not begin with three numbers before further points: LinuxCNC stops there silently and
/// uses the points before it. Positions that do not rise, fewer than two points or more than LinuxCNC takes.
pub fn linuxcnc_comp(
    from: &Path,
    text: &str,
    axis: &Axis,
    trims: bool,
    unit: LinuxcncLinearUnit,
    to: &Path,
) -> Result<Record> {
    let mut rows: Vec<[f64; 3]> = Vec::new();
    let mut stopped: Option<(usize, &str)> = None;
    for (i, line) in text.lines().enumerate() {
        let mut words = line.split_whitespace();
        let mut next = || words.next().and_then(finite);
        let (Some(nominal), Some(forward), Some(backward)) = (next(), next(), next()) else {
            stopped = stopped.or(Some((i + 1, line)));
            continue;
        };
        if let Some((at, line)) = stopped {
            let taken = match rows.len() {
                0 => "has no point at all".to_owned(),
                n => format!("has only the {n} points before it"),
            };
            let stops = "LinuxCNC stops at this line without a word";
            let expected = format!("three numbers: {stops} and {taken}; take the line out");
            return Err(InputError::line(from, at, format!("`{}`", line.trim()), expected));
        }
        if let Some(before) = rows.last().map(|r: &[f64; 3]| r[0] / unit.mm()).filter(|b| nominal <= *b) {
            let found = format!("{nominal} after {before}");
            return Err(InputError::line(from, i + 1, found, "positions that rise, as LinuxCNC wants them"));
        }
        if rows.len() == MOST {
            let expected = format!("at most {MOST} points, as LinuxCNC takes");
            return Err(InputError::line(from, i + 1, "one more point", expected));
        }
        rows.push([nominal, forward, backward].map(|v| v * unit.mm()));
    }
    if rows.len() < 2 {
        let (line, found) =
            stopped.map_or((0, "nothing".to_owned()), |(at, l)| (at, format!("`{}`", l.trim())));
        let expected = "nominal, forward, backward; two points at least";
        return Err(InputError::at(from, line, usize::from(line > 0), found, expected));
    }
    let error = |nominal: f64, v: f64| 1000.0 * if trims { -v } else { v - nominal };
    // A slope near 1: positions read as trims, or trims as positions.
    let ends = [rows[0], rows[rows.len() - 1]];
    let [first, last] = ends.map(|r| error(r[0], r[1]) / 1000.0);
    let slope = (last - first) / (ends[1][0] - ends[0][0]);
    if slope.abs() > 0.5 {
        let kinds = [("positions reached", "trims (type 1)"), ("trims", "positions reached (type 0)")];
        let (is, other) = kinds[usize::from(trims)];
        let found = format!("{is} that make errors of {slope:.2} mm per mm");
        let expected = format!("{is}; the file looks like {other}: choose the other type");
        return Err(InputError::whole(from, found, expected));
    }
    let up = rows.iter().map(|r| (r[0], 1.0, error(r[0], r[1])));
    let down = rows.iter().rev().map(|r| (r[0], -1.0, error(r[0], r[2])));
    let all: Vec<(f64, f64, f64)> = up.chain(down).collect();
    let columns = vec![
        Column::new(axis.as_str(), Role::Position(axis.clone()), all.iter().map(|r| r.0).collect()),
        Column::new("direction", Role::Direction(axis.clone()), all.iter().map(|r| r.1).collect()),
        Column::new("error", Role::Error(axis.clone()), all.iter().map(|r| r.2).collect()),
    ];
    Record::new(to, RunKind::Positioning, columns)
}
