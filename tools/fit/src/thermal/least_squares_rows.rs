//! The least-squares problem over every row.
//! The rows of all records follow each other; each term has a column.

use super::fit_candidates::{TermSelectionProblem, lagged};
use super::term::Term;
use crate::statistics::quantile;
use rtec_files::InputError;
use rtec_least_squares::dot;
use rtec_model::effect::STANDARD_DEGC;
use rtec_model::record::{Record, Role};
use std::ops::Range;

/// The rows of all records, one after the other.
pub(super) struct LeastSquaresRows {
    pub(super) columns: Vec<Vec<f64>>,
    pub(super) y: Vec<f64>,
    pub(super) fold: Vec<usize>,
    /// Time since the start of the row's record, s.
    pub(super) elapsed_s: Vec<f64>,
}

impl LeastSquaresRows {
    pub(super) fn new(
        problem: &TermSelectionProblem,
        terms: &[Term],
        records: &[&Record],
        response: &Role,
    ) -> Result<Self, InputError> {
        Self::with_lags(problem, terms, &lags_of(problem, terms), records, response)
    }

    /// The same with other lags for the terms than the grid's, s.
    pub(super) fn with_lags(
        problem: &TermSelectionProblem,
        terms: &[Term],
        lags_s: &[f64],
        records: &[&Record],
        response: &Role,
    ) -> Result<Self, InputError> {
        let mut columns = vec![Vec::new(); terms.len()];
        let (mut y, mut elapsed_s) = (Vec::new(), Vec::new());
        for r in records {
            for (all, own) in columns.iter_mut().zip(full_columns(problem, terms, lags_s, r)?) {
                all.extend(own);
            }
            y.extend_from_slice(r.data(response).unwrap_or_default());
            elapsed_s.extend(r.time_s().iter().map(|t| t - r.time_s()[0]));
        }
        let n = y.len();
        let fold = (0..n).map(|i| i * problem.folds / n).collect();
        Ok(Self { columns, y, fold, elapsed_s })
    }

    /// Least squares on the rows that `take` chooses.
    /// It returns the constant, then one coefficient per column.
    pub(super) fn solve(&self, take: &dyn Fn(usize) -> bool) -> Option<Vec<f64>> {
        self.solve_on(&self.runs(take))
    }

    /// The same on these stretches of rows.
    pub(super) fn solve_on(&self, taken: &[Range<usize>]) -> Option<Vec<f64>> {
        if taken.is_empty() {
            return None;
        }
        CentredRows::new(self, taken).solve()
    }

    /// The rows that `take` chooses, as stretches.
    pub(super) fn runs(&self, take: &dyn Fn(usize) -> bool) -> Vec<Range<usize>> {
        let mut runs: Vec<Range<usize>> = Vec::new();
        for i in (0..self.y.len()).filter(|i| take(*i)) {
            match runs.last_mut() {
                Some(run) if run.end == i => run.end += 1,
                _ => runs.push(i..i + 1),
            }
        }
        runs
    }

    /// Gives these terms another lag, s.
    pub(super) fn lag(
        &mut self,
        problem: &TermSelectionProblem,
        terms: &[Term],
        which: &[usize],
        tau_s: f64,
        records: &[&Record],
    ) -> Result<(), InputError> {
        let own: Vec<Term> = which.iter().map(|k| terms[*k]).collect();
        for k in which {
            self.columns[*k].clear();
        }
        for r in records {
            for (k, column) in which.iter().zip(full_columns(problem, &own, &vec![tau_s; own.len()], r)?) {
                self.columns[*k].extend(column);
            }
        }
        Ok(())
    }

    pub(super) fn residual(&self, c: &[f64], i: usize) -> f64 {
        let model: f64 = c[0] + self.columns.iter().zip(&c[1..]).map(|(u, c)| c * u[i]).sum::<f64>();
        self.y[i] - model
    }

    /// Standard deviation of the residual's change from row to row.
    /// It is the gauge's own noise, µm.
    pub(super) fn noise_um(&self, c: &[f64]) -> f64 {
        let left: Vec<f64> = (0..self.y.len()).map(|i| self.residual(c, i)).collect();
        let steps: f64 = left.windows(2).map(|w| (w[1] - w[0]).powi(2)).sum();
        (steps / (2 * left.len().saturating_sub(1).max(1)) as f64).sqrt()
    }

    /// The half width that contains 95 % of the residuals after the fit, µm.
    pub(super) fn scatter_um(&self, c: &[f64]) -> f64 {
        quantile((0..self.y.len()).map(|i| self.residual(c, i).abs()).collect(), 0.95)
    }

    pub(super) fn rms(&self, c: &[f64], take: &dyn Fn(usize) -> bool) -> f64 {
        self.rms_on(c, &self.runs(take))
    }

    /// The same on these stretches of rows.
    pub(super) fn rms_on(&self, c: &[f64], taken: &[Range<usize>]) -> f64 {
        let (mut sum, mut n) = (0.0, 0_usize);
        for run in taken {
            let mut left: Vec<f64> = self.y[run.clone()].iter().map(|y| y - c[0]).collect();
            for (u, c) in self.columns.iter().zip(&c[1..]) {
                left.iter_mut().zip(&u[run.clone()]).for_each(|(l, u)| *l -= c * u);
            }
            sum += dot(&left, &left);
            n += left.len();
        }
        (sum / n.max(1) as f64).sqrt()
    }
}

/// Response and columns less their means on stretches of rows.
pub(super) struct CentredRows<'a> {
    taken: &'a [Range<usize>],
    y: (Vec<f64>, f64),
    columns: Vec<(Vec<f64>, f64)>,
}

impl<'a> CentredRows<'a> {
    pub(super) fn new(rows: &LeastSquaresRows, taken: &'a [Range<usize>]) -> Self {
        let columns = rows.columns.iter().map(|c| about(c, taken)).collect();
        Self { taken, y: about(&rows.y, taken), columns }
    }

    /// Recomputes these columns after a change.
    pub(super) fn renew(&mut self, rows: &LeastSquaresRows, which: &[usize]) {
        for k in which {
            self.columns[*k] = about(&rows.columns[*k], self.taken);
        }
    }

    /// Least squares: the constant, then one coefficient per column.
    pub(super) fn solve(&self) -> Option<Vec<f64>> {
        let columns: Vec<&[f64]> = self.columns.iter().map(|(c, _)| &**c).collect();
        let c = rtec_least_squares::solve(&columns, &self.y.0).ok()?.values;
        let constant = self.y.1 - c.iter().zip(&self.columns).map(|(c, (_, m))| c * m).sum::<f64>();
        Some(std::iter::once(constant).chain(c).collect())
    }
}

/// Values about their mean on these stretches of rows, and the mean.
fn about(v: &[f64], taken: &[Range<usize>]) -> (Vec<f64>, f64) {
    let n = taken.iter().map(Range::len).sum::<usize>();
    let mean = taken.iter().map(|run| v[run.clone()].iter().sum::<f64>()).sum::<f64>() / n as f64;
    let mut own = Vec::with_capacity(n);
    for run in taken {
        own.extend(v[run.clone()].iter().map(|v| v - mean));
    }
    (own, mean)
}

/// The lag of each term on the grid, s.
pub(super) fn lags_of(problem: &TermSelectionProblem, terms: &[Term]) -> Vec<f64> {
    let of = |t: &Term| match t {
        Term::Thermal { lag, .. } => problem.taus[*lag],
        _ => 0.0,
    };
    terms.iter().map(of).collect()
}

/// The columns of a structure at every row of a record, each with its lag.
fn full_columns(
    problem: &TermSelectionProblem,
    terms: &[Term],
    lags_s: &[f64],
    record: &Record,
) -> Result<Vec<Vec<f64>>, InputError> {
    let lacks =
        |what: String| InputError::whole(&record.path, format!("no {what}"), "what the model was fitted on");
    let sensor =
        |s: usize| record.temperature(&problem.sensors[s]).ok_or_else(|| lacks(problem.sensors[s].clone()));
    let role = |role: Role, of: fn(f64) -> f64| {
        let data = record.data(&role).ok_or_else(|| lacks(role.to_string()))?;
        Ok::<_, InputError>(data.iter().map(|v| of(*v)).collect::<Vec<f64>>())
    };
    terms
        .iter()
        .zip(lags_s)
        .map(|(t, tau)| match *t {
            Term::Coolant => Ok(wet(record)),
            Term::Speed => role(Role::SpindleSpeed, |v| v / 1000.0),
            Term::Thermal { sensor: s, minus, square, .. } => {
                // The lag of a difference is the difference of the lags.
                let mut u = sensor(s)?.to_vec();
                match minus.map(sensor).transpose()? {
                    Some(m) => u.iter_mut().zip(m).for_each(|(u, m)| *u -= m),
                    None => u.iter_mut().for_each(|u| *u -= STANDARD_DEGC),
                }
                if *tau > 0.0 {
                    u = lagged(record.time_s(), &u, *tau);
                }
                if square {
                    for u in &mut u {
                        *u *= *u;
                    }
                }
                Ok(u)
            }
        })
        .collect()
}

/// 1 at the rows of a record at which coolant is on.
/// A record that does not log it is dry.
pub(super) fn wet(record: &Record) -> Vec<f64> {
    let logged = record.data(&Role::Coolant).map(|c| c.iter().map(|v| f64::from(*v > 0.5)).collect());
    logged.unwrap_or_else(|| vec![0.0; record.rows()])
}
