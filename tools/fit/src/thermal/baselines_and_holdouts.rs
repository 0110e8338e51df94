//! Compares the model with others.
//! These are simpler predictions, unseen records, and dry rows against wet ones.

use super::fit_candidates::TermSelectionProblem;
use super::least_squares_rows::{LeastSquaresRows, wet};
use super::report::{CrossValidatedRms, DryWetComparison};
use super::term::Term;
use crate::statistics::{mean, mean_square, rms};
use rtec_files::InputError;
use rtec_model::machine::Machine;
use rtec_model::record::{Record, Role, span};
use std::collections::BTreeMap;

/// Simple predictions on the same blocks.
/// They are the mean, the value of the previous row, and a straight line in each offered difference.
pub(super) fn baselines(
    problem: &TermSelectionProblem,
    train: &[&Record],
    holdout: &[&Record],
    response: &Role,
) -> Result<BTreeMap<String, CrossValidatedRms>, InputError> {
    let mut found = BTreeMap::new();
    let mut judge = |name: String, terms: &[Term]| -> Result<(), InputError> {
        let rows = LeastSquaresRows::new(problem, terms, train, response)?;
        let Some(c) = rows.solve(&|_| true) else { return Ok(()) };
        let mut folds = Vec::new();
        for f in 0..problem.folds {
            if let Some(c) = rows.solve(&|i| rows.fold[i] != f) {
                folds.push(rows.rms(&c, &|i| rows.fold[i] == f));
            }
        }
        let mut out = Vec::new();
        for r in holdout {
            let own = LeastSquaresRows::new(problem, terms, &[r], response)?;
            out.push(own.rms(&c, &|_| true));
        }
        let train = rows.rms(&c, &|_| true);
        found.insert(
            name,
            CrossValidatedRms { train, folds_rms: mean_square(&folds).sqrt(), folds, holdout: out },
        );
        Ok(())
    };
    judge("mean".to_owned(), &[])?;
    for (sensor, minus) in &problem.offered {
        let term = Term::plain((*sensor, *minus));
        judge(format!("linear {}", problem.name(term)), &[term])?;
    }
    let steps = |r: &Record| {
        let y = r.data(response).unwrap_or_default();
        y.windows(2).map(|w| w[1] - w[0]).collect::<Vec<f64>>()
    };
    let all: Vec<f64> = train.iter().flat_map(|r| steps(r)).collect();
    let n = all.len();
    let fold = |f: usize| {
        let own = all.iter().enumerate().filter(move |(i, _)| i * problem.folds / n.max(1) == f);
        rms(own.map(|(_, v)| *v))
    };
    let folds: Vec<f64> = (0..problem.folds).map(fold).collect();
    found.insert(
        "persistence".to_owned(),
        CrossValidatedRms {
            train: rms(all.iter().copied()),
            folds_rms: mean_square(&folds).sqrt(),
            folds,
            holdout: holdout.iter().map(|r| rms(steps(r).iter().copied())).collect(),
        },
    );
    Ok(found)
}

/// The result of a fitted model on unseen records.
#[derive(Default)]
pub(super) struct HoldoutResult {
    pub(super) rms: Vec<f64>,
    pub(super) coverage: Vec<f64>,
    pub(super) width_um: Vec<f64>,
    pub(super) warnings: Vec<String>,
}

pub(super) fn judge_holdouts(
    machine: &Machine,
    holdout: &[&Record],
    response: &Role,
) -> Result<HoldoutResult, InputError> {
    let mut later = HoldoutResult::default();
    for r in holdout {
        let Some(y) = r.data(response) else {
            return Err(InputError::whole(
                &r.path,
                format!("no {response}"),
                "the training record's responses",
            ));
        };
        let place = r.responses().position(|c| c.role == *response).unwrap_or_default();
        let predicted = &machine.predict(r)?.columns[place].1;
        let left = y.iter().zip(predicted).map(|(y, p)| y - p);
        let widths = machine.half_widths_um(r, response).unwrap_or_default();
        let inside = left.clone().zip(&widths).filter(|(v, w)| v.abs() <= **w).count();
        later.width_um.push(mean(&widths));
        later.coverage.push(inside as f64 / y.len() as f64);
        later.rms.push(rms(left));
        later
            .warnings
            .extend(machine.out_of_range(r).into_iter().map(|w| format!("{}: {w}", r.path.display())));
    }
    Ok(later)
}

pub(super) fn dry_wet(
    problem: &TermSelectionProblem,
    terms: &[Term],
    train: &[&Record],
    rows: &LeastSquaresRows,
) -> Option<DryWetComparison> {
    let wet: Vec<bool> = train.iter().flat_map(|r| wet(r)).map(|v| v > 0.5).collect();
    let enough = |w: bool| wet.iter().filter(|v| **v == w).count() >= 20 * (terms.len() + 1);
    if wet.len() != rows.y.len() || !enough(true) || !enough(false) {
        return None;
    }
    // The two fits' constants include the step that coolant itself causes.
    let thermal: Vec<usize> = (0..terms.len()).filter(|k| terms[*k] != Term::Coolant).collect();
    let own = LeastSquaresRows {
        columns: thermal.iter().map(|k| rows.columns[*k].clone()).collect(),
        y: rows.y.clone(),
        fold: rows.fold.clone(),
        elapsed_s: Vec::new(),
    };
    let (dry_fit, wet_fit) = (own.solve(&|i| !wet[i])?, own.solve(&|i| wet[i])?);
    let named = |c: &[f64]| thermal.iter().zip(&c[1..]).map(|(k, c)| (problem.name(terms[*k]), *c)).collect();
    let growth = |w: bool| {
        let own = own.y.iter().zip(&wet).filter(|(_, is)| **is == w).map(|(y, _)| *y);
        let [least, most] = span(own);
        most - least
    };
    Some(DryWetComparison {
        growth_dry_um: growth(false),
        growth_wet_um: growth(true),
        dry: named(&dry_fit),
        wet: named(&wet_fit),
        dry_model_on_wet_rms_um: own.rms(&dry_fit, &|i| wet[i]),
        wet_model_on_wet_rms_um: own.rms(&wet_fit, &|i| wet[i]),
    })
}
