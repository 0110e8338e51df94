//! How far measured and simulated are apart, before and after, and what the data itself repeats to.

use crate::answer::Answer;
use crate::fit::{self, Term};
use crate::problem::{Segment, Stack, rms};
use rtec_model::machine::Machine;
use rtec_model::record::{Record, Role};
use std::collections::BTreeMap;

/// Folds of the blocked cross-validation.
const FOLDS: usize = 5;
/// A fold is of so many blocks where one is too long.
const PIECES: usize = 4;
/// Fewer degrees of freedom among repeats say nothing of the repeatability.
const FEWEST_REPEATS: f64 = 10.0;

/// How far measured and simulated are apart, for the responses of one unit.
#[derive(Debug, Clone)]
pub struct Gap {
    /// The responses' unit.
    pub unit: String,
    /// Root mean square on the training records: before, after.
    pub train: [f64; 2],
    /// The same on the hold-outs.
    pub holdout: Option<[f64; 2]>,
    /// The same on those hold-outs alone that do not look like another machine's, where some do and some do not. [`Gap::holdout`] is of
    /// all: it may as well be the model that is wrong.
    pub without_strangers: Option<[f64; 2]>,
    /// The same by blocked cross-validation, where anything was fitted.
    pub blocked: Option<[f64; 2]>,
    /// Repeatability of the data.
    pub floor: f64,
    /// The hold-out is doubted, or so few rows taught nothing: how much of the gap is closed says nothing.
    pub doubted: bool,
}

/// A gap that is so many times as wide afterwards is no chance.
pub(crate) const WORSE: f64 = 1.1;

impl Gap {
    /// Share of the gap that is closed on the hold-out (or by cross-validation): 1 is down to the floor.
    #[must_use]
    pub fn closed(&self) -> Option<f64> {
        let [before, after] = self.holdout.or(self.blocked).unwrap_or(self.train);
        (before > self.floor && !self.doubted).then(|| ((before - after) / (before - self.floor)).max(0.0))
    }

    /// Whether the gap of rows that nothing was learned from is wider afterwards, by cross-validation.
    pub(crate) fn is_wider(&self) -> bool {
        let [before, after] = self.blocked.unwrap_or(self.train);
        after > WORSE * before.max(self.floor)
    }
}

/// What the simulation leaves of one response of one record.
#[derive(Debug, Clone)]
pub struct Trace {
    /// The record's file.
    pub file: String,
    /// The response.
    pub response: String,
    /// Whether it was held out.
    pub holdout: bool,
    /// Row times, s.
    pub time_s: Vec<f64>,
    /// Measured minus simulated with the model as it was.
    pub before: Vec<f64>,
    /// The same with the better model.
    pub after: Vec<f64>,
}

/// Measured minus simulated by the model as it was and by the better one, record by record.
pub(crate) fn traces(train: &[Record], holdout: &[Record], before: &Machine, after: &Machine) -> Vec<Trace> {
    let mut out = Vec::new();
    let zeros: Vec<_> = train.iter().chain(holdout).map(|r| &r.zero).collect();
    for (record, held) in train.iter().map(|r| (r, false)).chain(holdout.iter().map(|r| (r, true))) {
        // A zero of its own is no gap.
        let own_zero = record.zero.is_some() && zeros.iter().any(|z| **z != record.zero);
        for column in record.responses() {
            let left = |machine: &Machine| {
                let mut sum = vec![0.0; record.rows()];
                for e in machine.effects() {
                    let _absent = e.add(record, &column.role, &mut sum);
                }
                let mut left: Vec<f64> = column.data.iter().zip(&sum).map(|(m, s)| m - s).collect();
                let mean = if own_zero { left.iter().sum::<f64>() / left.len() as f64 } else { 0.0 };
                for l in &mut left {
                    *l -= mean;
                }
                left
            };
            out.push(Trace {
                file: record.file.clone(),
                response: column.role.to_string(),
                holdout: held,
                time_s: record.time_s().to_vec(),
                before: left(before),
                after: left(after),
            });
        }
    }
    out
}

fn unit_of(response: &str) -> &'static str {
    if response.starts_with("force") { "N" } else { "um" }
}

/// The gap of the responses of each unit.
pub(crate) fn gaps(
    stack: &Stack<'_>,
    train: &[Record],
    traces: &[Trace],
    terms: &[Term],
    answer: &Answer,
) -> Vec<Gap> {
    let mut units: Vec<&str> = traces.iter().map(|t| unit_of(&t.response)).collect();
    units.sort_unstable();
    units.dedup();
    let fitted = terms.iter().any(|t| t.half.iter().any(|h| *h > 0.0));
    let folds = fitted.then(|| blocked(stack, terms, answer, 1));
    let before = |unit: &str| pooled(traces, unit, false).map_or(0.0, |t| t[0]);
    // What a block alone shows (a stretch of a map, where a plate is measured line by line) its absence leaves open: that is
    // no prediction that fails. Shorter blocks leave a part of it.
    let open = |all: &Vec<f64>| units.iter().any(|u| rms(&in_own_unit(stack, all, u)) > WORSE * before(u));
    let blocked = folds.map(|all| if open(&all) { blocked(stack, terms, answer, PIECES) } else { all });
    let freedom = terms.iter().flat_map(|t| &t.half).filter(|h| **h > 0.0).count() as f64;
    let of = |unit: &str| {
        let train_gap = pooled(traces, unit, false).unwrap_or([0.0; 2]);
        let left = in_own_unit(stack, &answer.residual, unit);
        let n = left.len() as f64;
        let noise = rms(&left) * (n / (n - freedom).max(1.0)).sqrt();
        let floor = repeatability(stack, train, answer, unit).unwrap_or(noise).min(noise);
        let blocked = blocked.as_ref().map(|all| [train_gap[0], rms(&in_own_unit(stack, all, unit))]);
        let holdout = pooled(traces, unit, true);
        Gap {
            unit: unit.to_owned(),
            train: train_gap,
            holdout,
            without_strangers: None,
            blocked,
            floor,
            doubted: false,
        }
    };
    units.into_iter().map(of).collect()
}

/// RMS before and after over all responses of a unit, of the training records or of the held-out ones.
pub(crate) fn pooled(traces: &[Trace], unit: &str, held: bool) -> Option<[f64; 2]> {
    let of: Vec<&Trace> =
        traces.iter().filter(|t| t.holdout == held && unit_of(&t.response) == unit).collect();
    let pool = |f: fn(&Trace) -> &[f64]| rms(&of.iter().flat_map(|t| f(t)).copied().collect::<Vec<_>>());
    (!of.is_empty()).then(|| [pool(|t| &t.before), pool(|t| &t.after)])
}

/// The traces of each hold-out, where `traces` are those of all of them, record by record.
pub(crate) fn by_record<'t>(held: &[Record], traces: &'t [Trace]) -> Vec<&'t [Trace]> {
    let mut rest = traces;
    let own = |record: &Record| {
        let (own, further) = rest.split_at(record.responses().count().min(rest.len()));
        rest = further;
        own
    };
    held.iter().map(own).collect()
}

/// What the gaps are on these hold-outs' traces alone.
pub(crate) fn without_strangers(gap: &mut [Gap], traces: &[Trace]) {
    for g in gap {
        g.without_strangers = pooled(traces, &g.unit, true);
    }
}

/// The segments of a unit's responses.
fn segments<'s>(stack: &'s Stack<'_>, unit: &str) -> impl Iterator<Item = &'s Segment> {
    stack.segments.iter().filter(move |s| unit_of(&stack.responses[s.response].to_string()) == unit)
}

/// The rows of a unit's responses of a weighed column, in that unit.
fn in_own_unit(stack: &Stack<'_>, weighed: &[f64], unit: &str) -> Vec<f64> {
    let mut out = Vec::new();
    for s in segments(stack, unit) {
        out.extend(weighed[s.rows.clone()].iter().map(|r| r * stack.sigma[s.response]));
    }
    out
}

/// Spread among repeats at equal positions and directions, where a record has a cycle column: of what the best
/// explanation leaves, so that a drift from cycle to cycle is no lack of repeatability.
fn repeatability(stack: &Stack<'_>, train: &[Record], answer: &Answer, unit: &str) -> Option<f64> {
    let (mut sum, mut freedom) = (0.0, 0.0);
    for s in segments(stack, unit) {
        let record = &train[s.record];
        record.column(&Role::Cycle)?;
        let keys: Vec<&[f64]> = record
            .columns
            .iter()
            .filter(|c| {
                matches!(c.role, Role::Position(_) | Role::Direction(_) | Role::Coolant | Role::Angle)
            })
            .map(|c| c.data.as_slice())
            .collect();
        if keys.is_empty() {
            return None;
        }
        let mut groups: BTreeMap<Vec<i64>, Vec<f64>> = BTreeMap::new();
        for (row, r) in answer.residual[s.rows.clone()].iter().enumerate() {
            // Positions reached again differ by little: 50 µm is the same target.
            let key = keys.iter().map(|k| (k[row] * 20.0).round() as i64).collect();
            groups.entry(key).or_default().push(r * stack.sigma[s.response]);
        }
        for g in groups.values().filter(|g| g.len() > 1) {
            let mean = g.iter().sum::<f64>() / g.len() as f64;
            sum += g.iter().map(|x| (x - mean).powi(2)).sum::<f64>();
            freedom += g.len() as f64 - 1.0;
        }
    }
    (freedom > FEWEST_REPEATS).then(|| (sum / freedom).sqrt())
}

/// What the better model leaves of rows that its parameters were not fitted on, block by block, weighed; each fold is of so
/// many blocks.
fn blocked(stack: &Stack<'_>, terms: &[Term], answer: &Answer, pieces: usize) -> Vec<f64> {
    let mut out = vec![0.0; stack.n];
    for fold in 0..FOLDS {
        let mut keep = vec![true; stack.n];
        for s in &stack.ranges {
            let (n, blocks) = (s.len(), FOLDS * pieces);
            for b in (fold..blocks).step_by(FOLDS) {
                keep[s.start + n * b / blocks..s.start + n * (b + 1) / blocks].fill(false);
            }
        }
        let mut without = terms.to_vec();
        fit::fit(stack, &mut without, answer.phi, 2, Some(&keep));
        let r = fit::residual(stack, &without);
        for (i, k) in keep.iter().enumerate() {
            if !k {
                out[i] = r[i];
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gap_is_closed_when_only_the_floor_is_left() {
        let gap = |train, holdout, blocked, floor| Gap {
            unit: "um".into(),
            train,
            holdout,
            without_strangers: None,
            blocked,
            floor,
            doubted: false,
        };
        assert_eq!(gap([5.0, 1.0], None, None, 1.0).closed(), Some(1.0));
        // The hold-out counts where there is one, then the cross-validation.
        assert_eq!(gap([5.0, 1.0], Some([5.0, 3.0]), Some([5.0, 5.0]), 1.0).closed(), Some(0.5));
        assert_eq!(gap([5.0, 1.0], None, Some([5.0, 5.0]), 1.0).closed(), Some(0.0));
        assert_eq!(gap([1.0, 0.9], None, None, 1.0).closed(), None, "nothing to close");
    }

    #[test]
    fn forces_are_no_lengths() {
        assert_eq!((unit_of("force.x"), unit_of("error.x")), ("N", "um"));
    }
}
