//! The gap between measured and simulated, before and after, and its floor.
//! The floor is the repeatability of the data.

use crate::findings_from_estimate::{AnalysisFindings, stated};
use rtec_estimate::effect_size_refit::{EffectSizeRefit, left};
use rtec_estimate::measurement_model::EstimationProblem;
use rtec_estimate::rows_and_noise::MeasuredRows;
use rtec_model::effect::Effect;
use rtec_model::machine::Machine;
use rtec_model::record::{Axis, Record, Role, RunKind, span};

/// Folds of the blocked cross-validation.
pub(crate) const FOLDS: usize = 5;

/// The gap between measured and simulated, for the responses of one unit.
#[derive(Debug, Clone)]
pub struct Gap {
    /// The responses' unit.
    pub unit: String,
    /// Root mean square on the training records: before, after.
    pub train: [f64; 2],
    /// The same on the hold-outs.
    pub holdout: Option<[f64; 2]>,
    /// The same without hold-outs that seem to be of another machine.
    /// Set only if some do and some do not. [`Gap::holdout`] covers all, because the model may be wrong
    /// instead.
    pub without_strangers: Option<[f64; 2]>,
    /// The same by blocked cross-validation, if anything was fitted.
    pub blocked: Option<[f64; 2]>,
    /// Noise of the data, the floor of the gap.
    pub floor: f64,
    /// Whether the closed share is meaningless.
    /// The hold-out is then doubted, or has few rows.
    pub doubted: bool,
    /// Rows of the hold-outs.
    pub held_rows: usize,
}

impl Gap {
    /// The gap before and after, and the kind of rows it is from.
    /// Rows that the fit has not seen are preferred: hold-outs, then blocks left out in turn.
    #[must_use]
    pub fn judged_on(&self) -> ([f64; 2], &'static str) {
        match (self.holdout, self.blocked) {
            (Some(pair), _) => (pair, "on the hold-outs"),
            (None, Some(pair)) => (pair, "on blocks of rows left out in turn; a hold-out would judge it"),
            (None, None) => (self.train, "nothing was fitted"),
        }
    }

    /// Share of the gap closed on the rows of [`Gap::judged_on`].
    /// 1 means closed down to the floor.
    #[must_use]
    pub fn closed(&self) -> Option<f64> {
        self.closed_by(self.judged_on().0)
    }

    /// The closed share for a given RMS before and after.
    pub(crate) fn closed_by(&self, [before, after]: [f64; 2]) -> Option<f64> {
        (before > self.floor && !self.doubted).then(|| ((before - after) / (before - self.floor)).max(0.0))
    }

    /// Whether the findings make the hold-out no worse, apart from chance.
    /// The allowance for chance is two standard errors of a mean square. `None` without a hold-out.
    #[must_use]
    pub fn confirmed(&self) -> Option<bool> {
        let [before, after] = self.holdout?;
        let most = (before * before).max(self.floor * self.floor);
        Some(after * after <= most * chance(self.held_rows as f64))
    }
}

/// Factor by which chance may change a mean square of so many independent rows.
/// It is two standard errors.
pub(crate) fn chance(rows: f64) -> f64 {
    1.0 + 2.0 * (2.0 / rows.max(1.0)).sqrt()
}

/// The residuals of one response of one record, its set-up removed.
#[derive(Debug, Clone)]
pub struct ResidualTrace {
    /// The record's file.
    pub file: String,
    /// The response.
    pub response: String,
    /// Whether it was held out.
    pub holdout: bool,
    /// The abscissa of a plot: position, angle or time.
    pub over: Abscissa,
    /// Measured minus simulated with the original model.
    pub before: Vec<f64>,
    /// The same with the better model.
    pub after: Vec<f64>,
}

/// The abscissa of a response's rows.
#[derive(Debug, Clone, PartialEq)]
pub struct Abscissa {
    /// Its name with its unit.
    pub name: String,
    /// Its value at every row.
    pub values: Vec<f64>,
    /// Whether the rows follow each other along it, as they do in time.
    pub in_order: bool,
    /// Direction of approach of every row; empty if the rows have none.
    pub direction: Vec<f64>,
}

/// An axis that moves by less counts as standing still, mm.
const STILL_MM: f64 = 1.0;

impl Abscissa {
    /// The abscissa of a trace: angle of a circle, position, or time.
    /// The position is that of an axis that moves, if possible the response's own.
    fn of(record: &Record, response: &Role) -> Self {
        let in_time = matches!(record.kind, RunKind::Drift | RunKind::Dynamics);
        if let Some(angle) = record.data(&Role::Angle).filter(|_| !in_time) {
            let values = angle.iter().map(|a| a.to_degrees()).collect();
            return Self { name: "angle (°)".to_owned(), values, in_order: false, direction: Vec::new() };
        }
        let span = |axis: &&Axis| {
            let [low, high] = span(record.data(&Role::Position((*axis).clone())).unwrap_or_default());
            (high - low).max(0.0)
        };
        let moving: Vec<&Axis> = record.axes(Role::Position).filter(|a| span(a) > STILL_MM).collect();
        let own = moving.iter().find(|a| response.axis() == Some(**a));
        let most = own.or_else(|| moving.iter().max_by(|a, b| span(a).total_cmp(&span(b))));
        if let Some(axis) = most.filter(|_| !in_time) {
            let column = |role: Role| record.data(&role).unwrap_or_default().to_vec();
            return Self {
                name: format!("position of {axis} (mm)"),
                values: column(Role::Position((*axis).clone())),
                in_order: false,
                direction: column(Role::Direction((*axis).clone())),
            };
        }
        let (name, values) = record.over_time();
        Self { name: name.to_owned(), values, in_order: true, direction: Vec::new() }
    }
}

/// Residuals under the original and the better model, record by record.
pub(crate) fn traces(
    train: &[Record],
    holdout: &[Record],
    before: &Machine,
    after: &Machine,
) -> Vec<ResidualTrace> {
    let mut out = Vec::new();
    let effects = |m: &Machine| -> Vec<Effect> { m.effects().cloned().collect() };
    let (old, new) = (effects(before), effects(after));
    for (record, held) in train.iter().map(|r| (r, false)).chain(holdout.iter().map(|r| (r, true))) {
        let (before, after) = (left(record, &old), left(record, &new));
        for ((column, before), after) in record.responses().zip(before).zip(after) {
            out.push(ResidualTrace {
                file: record.file.clone(),
                response: column.role.to_string(),
                holdout: held,
                over: Abscissa::of(record, &column.role),
                before,
                after,
            });
        }
    }
    out
}

pub(crate) fn unit_of(response: &str) -> &'static str {
    if response.starts_with("force") { "N" } else { "um" }
}

pub(crate) fn rms<'v>(v: impl IntoIterator<Item = &'v f64>) -> f64 {
    let (sum, n) = v.into_iter().fold((0.0, 0.0), |(s, n), x| (s + x * x, n + 1.0));
    (sum / f64::max(n, 1.0)).sqrt()
}

/// Residual of each row under a fit of the other blocks.
/// `None` if nothing was fitted.
/// `curve` replaces what no effect explains, and is fitted with the findings.
/// Of the model's effects only those move that the better model corrects.
pub(crate) fn left_of_blocks(
    used: &[Record],
    answer: &AnalysisFindings,
    curve: Option<&Effect>,
    machine: &Machine,
) -> Option<Vec<f64>> {
    let findings = answer.findings.iter().map(|(f, _)| &f.effect);
    let found: Vec<Effect> = findings.chain(curve).cloned().collect();
    let known = answer.estimate.known.iter().filter(|k| k.beyond_chance);
    let corrected: Vec<usize> = known.map(|k| k.place).collect();
    (!found.is_empty() || !corrected.is_empty()).then(|| {
        let (rows, model) = (MeasuredRows::new(used), machine.effects().cloned().collect::<Vec<_>>());
        let mut problem = EstimationProblem::new(&rows, &model, &stated(machine));
        problem.known.retain(|k| corrected.contains(&k.effect));
        EffectSizeRefit::new(&problem, &found).left_by_others(&answer.estimate.noise, FOLDS)
    })
}

/// The gap of the responses of each unit.
/// `used` are the analysed rows; `blocked` is the residual of each ([`left_of_blocks`]).
pub(crate) fn gaps(
    used: &[Record],
    traces: &[ResidualTrace],
    answer: &AnalysisFindings,
    blocked: Option<&[f64]>,
) -> Vec<Gap> {
    let mut units: Vec<&str> = traces.iter().map(|t| unit_of(&t.response)).collect();
    units.sort_unstable();
    units.dedup();
    let rows = MeasuredRows::new(used);
    let noise = &answer.estimate.noise;
    let of = |unit: &str| {
        let of_unit = |j: usize| unit_of(&rows.responses[j].to_string()) == unit;
        let own = || rows.segments.iter().enumerate().filter(|(_, s)| of_unit(s.response));
        let pick = |all: &[f64]| rms(own().flat_map(|(_, s)| &all[s.rows.clone()]));
        let variance: f64 = own()
            .map(|(number, s)| {
                let (sigma, phi) = (noise.size(&rows, number), noise.phi[number]);
                s.rows.len() as f64 * sigma * sigma / (1.0 - phi * phi)
            })
            .sum();
        let n: f64 = own().map(|(_, s)| s.rows.len() as f64).sum();
        let train = pooled(traces, unit, false).unwrap_or([0.0; 2]);
        let held_rows =
            traces.iter().filter(|t| t.holdout && unit_of(&t.response) == unit).map(|t| t.before.len()).sum();
        Gap {
            unit: unit.to_owned(),
            train,
            holdout: pooled(traces, unit, true),
            without_strangers: None,
            blocked: blocked.map(|all| [train[0], pick(all)]),
            floor: (variance / n.max(1.0)).sqrt(),
            doubted: false,
            held_rows,
        }
    };
    units.into_iter().map(of).collect()
}

/// Share of a response's mean square that the better model explains.
/// It covers the training records.
pub(crate) fn explained(traces: &[ResidualTrace], response: &str) -> f64 {
    let of = |pick: fn(&ResidualTrace) -> &[f64]| {
        rms(traces.iter().filter(|t| !t.holdout && t.response == response).flat_map(pick))
    };
    let [before, after] = [of(|t| &t.before), of(|t| &t.after)];
    (1.0 - (after / before.max(f64::MIN_POSITIVE)).powi(2)).max(0.0)
}

/// RMS before and after, over all responses of a unit.
/// It covers the training records, or the hold-outs if `held`.
pub(crate) fn pooled(traces: &[ResidualTrace], unit: &str, held: bool) -> Option<[f64; 2]> {
    let of: Vec<&ResidualTrace> =
        traces.iter().filter(|t| t.holdout == held && unit_of(&t.response) == unit).collect();
    let pool = |f: fn(&ResidualTrace) -> &[f64]| rms(of.iter().flat_map(|t| f(t)));
    (!of.is_empty()).then(|| [pool(|t| &t.before), pool(|t| &t.after)])
}

/// The traces of each hold-out.
/// `traces` are those of all hold-outs, record by record.
pub(crate) fn by_record<'t>(held: &[Record], traces: &'t [ResidualTrace]) -> Vec<&'t [ResidualTrace]> {
    let mut rest = traces;
    let own = |record: &Record| {
        let (own, further) = rest.split_at(record.responses().count().min(rest.len()));
        rest = further;
        own
    };
    held.iter().map(own).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gap(train: [f64; 2], holdout: Option<[f64; 2]>, blocked: Option<[f64; 2]>, floor: f64) -> Gap {
        Gap {
            unit: "um".into(),
            train,
            holdout,
            without_strangers: None,
            blocked,
            floor,
            doubted: false,
            held_rows: 200,
        }
    }

    #[test]
    fn the_gap_is_closed_when_only_the_floor_is_left() {
        assert_eq!(gap([5.0, 1.0], None, None, 1.0).closed(), Some(1.0));
        // A hold-out is used if there is one, then the cross-validation.
        assert_eq!(gap([5.0, 1.0], Some([5.0, 3.0]), Some([5.0, 5.0]), 1.0).closed(), Some(0.5));
        assert_eq!(gap([5.0, 1.0], None, Some([5.0, 5.0]), 1.0).closed(), Some(0.0));
        assert_eq!(gap([1.0, 0.9], None, None, 1.0).closed(), None, "nothing to close");
        // Each line of a report has its own share, whichever rows the gap is judged on.
        let both = gap([5.0, 1.0], Some([5.0, 1.0]), Some([5.0, 3.0]), 1.0);
        assert_eq!(
            [both.holdout, both.blocked].map(|pair| both.closed_by(pair.unwrap())),
            [Some(1.0), Some(0.5)]
        );
    }

    #[test]
    fn a_hold_out_confirms_unless_it_is_worse_than_chance() {
        assert_eq!(gap([5.0, 1.0], None, None, 1.0).confirmed(), None);
        assert_eq!(gap([5.0, 1.0], Some([2.0, 2.1]), None, 1.0).confirmed(), Some(true));
        assert_eq!(gap([5.0, 1.0], Some([2.0, 4.0]), None, 1.0).confirmed(), Some(false));
    }

    #[test]
    fn forces_are_no_lengths() {
        assert_eq!((unit_of("force.x"), unit_of("error.x")), ("N", "um"));
    }
}
