//! The regression behind a fit or a verdict, as arrays.
//! It has the measured and predicted rows, the derivative by each fitted value and the columns of the set-up.
//! With it others can check the intervals with their own tools.

use crate::findings_from_estimate::stated;
use rtec_estimate::rows_and_noise::{MeasuredRows, ResponseSegment};
use rtec_estimate::set_up_terms::{self, SetUpTermKind};
use rtec_model::effect::Effect;
use rtec_model::machine::Machine;
use rtec_model::record::Record;

/// The set-up terms that belong to a regression.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SetUpTermsIncluded {
    /// A zero for every response of every record, as in `model fit --effects`.
    /// It is omitted if a fitted effect is such a constant.
    Zeros,
    /// The zeros of a verdict, which records may share, and a circle's centre.
    ByHand,
}

/// A fitted value or a set-up term, and its derivative at every row.
#[derive(Debug, Clone)]
pub struct RegressionColumn {
    /// The effect with its sensors; for a set-up term `zero` or `centre`.
    pub name: String,
    /// The parameter, numbered if it is an array; for a set-up term the record.
    pub parameter: String,
    /// Its unit.
    pub unit: String,
    /// Its value; `None` for a set-up term, which is solved for.
    pub value: Option<f64>,
    /// Half width of its stated 95 % interval; `None` for a set-up term.
    pub half_width: Option<f64>,
    /// Change of the response per unit of it, row by row.
    pub derivative: Vec<f64>,
}

/// Rows of one response of one record.
#[derive(Debug, Clone)]
pub struct RegressionRows {
    /// The record's file.
    pub record: String,
    /// The response's role.
    pub response: String,
    /// Its unit.
    pub unit: &'static str,
    /// Number of rows.
    pub count: usize,
}

/// All rows and all columns.
#[derive(Debug, Clone)]
pub struct RegressionArrays {
    /// Rows, response by response and record by record.
    pub rows: Vec<RegressionRows>,
    /// The measured values, µm or N.
    pub measured: Vec<f64>,
    /// The model's prediction without set-up, µm or N.
    pub predicted: Vec<f64>,
    /// Fitted values, then set-up terms.
    pub columns: Vec<RegressionColumn>,
}

impl RegressionArrays {
    /// The regression of the effects that a model has in addition to `base`.
    /// Changed effects count too. A value without an interval was held.
    #[must_use]
    pub fn new(records: &[Record], base: &Machine, machine: &Machine, set_up: SetUpTermsIncluded) -> Self {
        let rows = MeasuredRows::new(records);
        let mut predicted = vec![0.0; rows.n];
        let mut add = |column: &[f64]| predicted.iter_mut().zip(column).for_each(|(p, v)| *p += v);
        machine.effects().for_each(|e| add(&rows.predict(e)));
        if let Some(chain) = machine.chain() {
            let mut of_chain = vec![0.0; rows.n];
            for s in &rows.segments {
                // If a record lacked a column that the chain reads, `Machine::predict` has already refused
                // it.
                let _bound =
                    chain.add(rows.record(s), &rows.responses[s.response], &mut of_chain[s.rows.clone()]);
            }
            add(&of_chain);
        }
        let fitted: Vec<(&Effect, Vec<Option<f64>>)> =
            machine.effects().zip(stated(machine)).filter(|(e, _)| base.effects().all(|b| b != *e)).collect();
        let mut columns: Vec<RegressionColumn> =
            fitted.iter().flat_map(|(e, half)| of_effect(&rows, e, half)).collect();
        columns.extend(match set_up {
            SetUpTermsIncluded::ByHand => by_hand(&rows),
            SetUpTermsIncluded::Zeros => zeros(&rows, &fitted.iter().map(|(e, _)| *e).collect::<Vec<_>>()),
        });
        let of_rows = |s: &ResponseSegment| RegressionRows {
            record: rows.record(s).file.clone(),
            response: rows.responses[s.response].to_string(),
            unit: if rows.is_force(s.response) { "N" } else { "um" },
            count: s.rows.len(),
        };
        let of = rows.segments.iter().map(of_rows).collect();
        Self { rows: of, measured: rows.measured.clone(), predicted, columns }
    }
}

fn of_effect(rows: &MeasuredRows<'_>, effect: &Effect, half: &[Option<f64>]) -> Vec<RegressionColumn> {
    let width = effect.width();
    let slopes = rows.slopes(effect);
    let sensor = effect.delta.as_ref().map_or_else(String::new, |d| format!(" ({d})"));
    let name = effect.name() + &sensor;
    let column = |(i, derivative): (usize, Vec<f64>)| {
        let half_width = half[i].filter(|h| *h > 0.0)?;
        let p = &effect.description().parameters[i / width];
        Some(RegressionColumn {
            name: name.clone(),
            parameter: if width == 1 { p.name.clone() } else { format!("{}[{}]", p.name, i % width) },
            unit: p.unit.clone(),
            value: Some(effect.values()[i]),
            half_width: Some(half_width),
            derivative,
        })
    };
    slopes.into_iter().enumerate().filter_map(column).collect()
}

fn of_set_up(
    rows: &MeasuredRows<'_>,
    what: &str,
    record: &Record,
    response: usize,
    derivative: Vec<f64>,
) -> RegressionColumn {
    RegressionColumn {
        name: what.to_owned(),
        parameter: format!("{} {}", record.file, rows.responses[response]),
        unit: if rows.is_force(response) { "N" } else { "um" }.to_owned(),
        value: None,
        half_width: None,
        derivative,
    }
}

fn by_hand(rows: &MeasuredRows<'_>) -> Vec<RegressionColumn> {
    let of = |t: set_up_terms::SetUpTerm| {
        let what = match t.what {
            SetUpTermKind::Zero => "zero",
            SetUpTermKind::CentreFirst => "centre, first axis",
            SetUpTermKind::CentreSecond => "centre, second axis",
            _ => return None,
        };
        let row = t.column.iter().position(|x| *x != 0.0)?;
        let response = rows.segments.iter().find(|s| s.rows.contains(&row))?.response;
        Some(of_set_up(rows, what, &rows.records[t.record], response, t.column))
    };
    set_up_terms::terms(rows, &[]).into_iter().filter_map(of).collect()
}

fn zeros(rows: &MeasuredRows<'_>, fitted: &[&Effect]) -> Vec<RegressionColumn> {
    let constants: Vec<Vec<f64>> =
        fitted.iter().filter(|e| e.description().constant).flat_map(|e| rows.basis(e)).collect();
    let of = |s: &ResponseSegment| {
        let known = constants.iter().any(|c| c[s.rows.clone()].iter().any(|v| *v != 0.0));
        let mut own = vec![0.0; rows.n];
        own[s.rows.clone()].fill(1.0);
        (!known).then(|| of_set_up(rows, "zero", rows.record(s), s.response, own))
    };
    rows.segments.iter().filter_map(of).collect()
}
