//! 95 % intervals of the parameters, from what they are with each block left out.

use super::judge::Judged;
use super::problem::{LAG_STEP, Problem};
use super::rows::{Rows, mean};
use super::term::{Term, relagged};
use statrs::distribution::{ContinuousCDF, StudentsT};
use std::collections::BTreeMap;

/// 95 % intervals of an effect's parameters by their names, one per value.
pub(crate) type Intervals = BTreeMap<String, Vec<[f64; 2]>>;

/// The 95 % interval of a value from what it is with each block left out.
pub(crate) fn jackknife_interval(value: f64, parts: &[f64]) -> [f64; 2] {
    let m = mean(parts);
    let n = parts.len() as f64;
    let t = StudentsT::new(0.0, 1.0, (n - 1.0).max(1.0)).map_or(2.26, |d| d.inverse_cdf(0.975));
    let se = ((n - 1.0) / n * parts.iter().map(|p| (p - m).powi(2)).sum::<f64>()).sqrt();
    [value - t * se, value + t * se]
}

/// 95 % intervals by leaving out each block: of every coefficient, and of the first term's lag.
pub(super) struct Jackknife {
    pub(super) coefficients: Vec<[f64; 2]>,
    pub(super) tau_s: BTreeMap<usize, [f64; 2]>,
}

pub(super) fn jackknife(problem: &Problem, structure: &Judged, rows: &Rows, full: &[f64]) -> Jackknife {
    let folds = problem.folds;
    let spread = jackknife_interval;
    let parts: Vec<Vec<f64>> = (0..folds).filter_map(|f| rows.solve(&|i| rows.fold[i] != f)).collect();
    let coefficients =
        (0..full.len()).map(|k| spread(full[k], &parts.iter().map(|p| p[k]).collect::<Vec<f64>>())).collect();
    let mut tau_s = BTreeMap::new();
    for (k, term) in structure.terms.iter().enumerate() {
        let Term::Thermal { lag, square: false, .. } = *term else { continue };
        if lag == 0 {
            continue;
        }
        let parts: Vec<f64> = (0..folds)
            .filter_map(|f| {
                let others: Vec<usize> = (0..folds).filter(|o| *o != f).collect();
                let fits = (1..problem.taus.len())
                    .filter_map(|l| Some((l, problem.judge(&relagged(&structure.terms, k, l), &others)?.r)));
                fits.max_by(|a, b| a.1.total_cmp(&b.1)).map(|(l, _)| problem.taus[l].ln())
            })
            .collect();
        let tau = problem.taus[lag];
        // One step of the grid is known no better than that.
        let [lo, hi] = spread(tau.ln(), &parts);
        let step = LAG_STEP.ln() / 2.0;
        tau_s.insert(k, [lo.min(tau.ln() - step).exp(), hi.max(tau.ln() + step).exp()]);
    }
    Jackknife { coefficients, tau_s }
}
