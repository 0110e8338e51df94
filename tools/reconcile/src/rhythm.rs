//! Whether what is left changes from row to row as noise does. Noise forgets within a few rows; what goes on for longer is an effect,
//! whether or not a shape of it was found.

use crate::cause::Shape;
use crate::fit::{self, Term};
use crate::problem::{Segment, Stack};
use rtec_model::record::{Record, Role};
use std::cmp::Ordering;

/// The longest memory that noise has from one row to the next: what is slower is structure.
const MEMORY: f64 = 0.7;
/// By so many standard deviations the rows must lie farther apart than noise of that memory lets them.
const BEYOND: f64 = 4.0;
/// Fewer rows of a response say nothing of its rhythm.
const FEWEST: usize = 24;

/// A column by its name and role.
type Of<'r> = (&'r str, &'r Role);

/// The response in which what is left goes on for longer than noise does: from row to row, from place to place, from one temperature
/// to the next.
pub(crate) fn slower_than_noise(stack: &Stack<'_>, terms: &[Term]) -> Option<Shape> {
    let left = fit::residual(stack, terms);
    (0..stack.responses.len()).find_map(|j| {
        let segments: Vec<&Segment> = stack.segments.iter().filter(|s| s.response == j).collect();
        let records: Vec<&Record> = segments.iter().map(|s| stack.record(s)).collect();
        let over = |order: &Vec<Of<'_>>| {
            let of = |s: &&Segment| -> Vec<f64> {
                let rows = in_order(stack.record(s), order);
                rows.into_iter().map(|row| left[s.rows.start + row]).collect()
            };
            is_slow(&segments.iter().map(of).collect::<Vec<_>>())
        };
        let order = orders(&records, &stack.responses[j]).into_iter().find(over)?;
        let label = |(name, role): &Of<'_>| match role {
            Role::Temperature | Role::Channel => format!("{role}.{name}"),
            role => role.to_string(),
        };
        Some(Shape {
            response: stack.responses[j].to_string(),
            against: vec![order.last().map_or_else(|| "time".to_owned(), label)],
            manner: "slower than noise, in no shape that is known".to_owned(),
        })
    })
}

/// What the rows of some records may be put in order by, the last of each within equal values of the others; first as they
/// are.
fn orders<'r>(records: &[&'r Record], response: &Role) -> Vec<Vec<Of<'r>>> {
    let mut out = vec![Vec::new()];
    let Some(axis) = response.axis() else { return out };
    let moves = |(name, role): &Of<'_>| {
        let data = records.iter().map(|r| data(r, (name, role)));
        let moved = |d: &[f64]| d.windows(2).any(|w| w[0].to_bits() != w[1].to_bits());
        data.clone().all(|d| d.is_some()) && data.flatten().any(moved)
    };
    let columns = records[0].columns.iter().map(|c| (c.name.as_str(), &c.role));
    let all: Vec<Of<'r>> = columns.filter(moves).collect();
    let of = |wanted: &Role| all.iter().copied().find(|(_, role)| *role == wanted);
    if let Some(place) = of(&Role::Position(axis.clone())) {
        out.push(of(&Role::Direction(axis.clone())).into_iter().chain([place]).collect());
        for other in all.iter().filter(|(_, role)| matches!(role, Role::Position(o) if o != axis)) {
            out.extend([vec![*other, place], vec![place, *other]]);
        }
    }
    let own = |role: &Role| match role {
        Role::Velocity(a) | Role::Acceleration(a) | Role::Load(a) => a == axis,
        Role::Angle | Role::Temperature | Role::Channel => true,
        _ => false,
    };
    out.extend(all.iter().filter(|(_, role)| own(role)).map(|of| vec![*of]));
    out
}

fn data<'d>(record: &'d Record, (name, role): Of<'_>) -> Option<&'d [f64]> {
    record.columns.iter().find(|c| c.name == name && c.role == *role).map(|c| c.data.as_slice())
}

/// A record's rows by these columns, one within the other.
fn in_order(record: &Record, by: &[Of<'_>]) -> Vec<usize> {
    let mut rows: Vec<usize> = (0..record.rows()).collect();
    let columns: Vec<&[f64]> = by.iter().filter_map(|of| data(record, *of)).collect();
    rows.sort_by(|a, b| {
        let each = columns.iter().map(|c| c[*a].total_cmp(&c[*b]));
        each.fold(Ordering::Equal, Ordering::then)
    });
    rows
}

/// Whether values in this order, stretch by stretch, lie farther from their mean than they change from one to the next, by more
/// than noise of the longest memory does.
fn is_slow(stretches: &[Vec<f64>]) -> bool {
    let (mut spread, mut steps, mut n) = (0.0, 0.0, 0.0);
    for v in stretches.iter().filter(|v| v.len() > 2) {
        let mean = v.iter().sum::<f64>() / v.len() as f64;
        let rows = v.len() as f64;
        spread += v.iter().map(|v| (v - mean).powi(2)).sum::<f64>() * rows / (rows - 1.0);
        steps += v.windows(2).map(|w| (w[1] - w[0]).powi(2)).sum::<f64>() / 2.0 * rows / (rows - 1.0);
        n += rows;
    }
    // Of noise with that memory: 1/(1 - MEMORY), known as well as from so many rows without one.
    let free = n * (1.0 - MEMORY) / (1.0 + MEMORY);
    n >= FEWEST as f64 && spread > steps / (1.0 - MEMORY) * (1.0 + BEYOND * (2.0 / free).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::noise;

    /// Noise with all the memory that it may have is noise; a slow wave of twice its size, in time or hidden by the order of the
    /// rows, is none.
    #[test]
    fn noise_is_no_structure_and_what_goes_on_is() {
        let with_memory = |seed: u64, phi: f64, n: usize| -> Vec<f64> {
            let mut x = 0.0;
            let of = |e: &f64| {
                x = phi * x + (1.0 - phi * phi).sqrt() * e;
                x
            };
            noise(seed, n).iter().map(of).collect()
        };
        let mut slow = 0;
        for seed in 1..=400 {
            let n = [30, 60, 150, 600][seed as usize % 4];
            slow += usize::from(is_slow(&[with_memory(seed, 0.6, n), with_memory(seed + 1000, 0.6, n / 2)]));
            let wave = |phi: f64| -> Vec<f64> {
                let of = |(i, e): (usize, f64)| e + 4.0 * (i as f64 / 40.0).sin();
                with_memory(seed, phi, 300).into_iter().enumerate().map(of).collect()
            };
            assert!(is_slow(&[wave(0.0)]), "{seed}");
        }
        assert_eq!(slow, 0);
    }
}
