//! Judges a structure by blocked cross-validation in time.

use super::problem::Problem;
use super::term::Term;
use rtec_least_squares::dot;
use rtec_measure::iso230::correlation;
use rtec_model::record::span;
use std::ops::Range;

/// A structure with its cross-validation.
#[derive(Debug, Clone)]
pub(super) struct ValidatedStructure {
    pub(super) terms: Vec<Term>,
    /// Mean square per fold.
    pub(super) mse: Vec<f64>,
    pub(super) r: f64,
    /// Constant, then one coefficient per term.
    pub(super) coefficients: Vec<f64>,
    /// Mean square residual on its own data, as a share of the response's variance.
    left: f64,
    /// Number of independent values in the residual.
    /// Neighbours in time share their noise.
    independent: f64,
}

/// Twice the log likelihood that chance reaches once in about a thousand cases.
const CHANCE: f64 = 9.0;

/// The same for one column that needs no choice, during the search.
/// Chance reaches it once in twenty cases.
const BENT: f64 = 4.0;

/// A square stays in the model above this: three standard errors.
const CERTAIN: f64 = 9.0;

/// Largest movement of one term, relative to the response's whole movement.
const CANCELLED: f64 = 2.0;

impl ValidatedStructure {
    /// Root of the mean over the folds.
    pub(super) fn rms(&self) -> f64 {
        (self.mse.iter().sum::<f64>() / self.mse.len() as f64).sqrt()
    }

    /// Whether it beats `other` by more than the standard error over the folds.
    pub(super) fn beats(&self, other: &Self) -> bool {
        let d: Vec<f64> = other.mse.iter().zip(&self.mse).map(|(o, s)| o - s).collect();
        let n = d.len() as f64;
        let mean = d.iter().sum::<f64>() / n;
        let var = d.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
        // An improvement by rounding does not count: the same sums from other differences are the same
        // structure.
        let rounding = 1e-9 * other.mse.iter().sum::<f64>() / n;
        mean > (var / n).sqrt().max(rounding)
    }

    /// Whether the additional terms of a larger structure are justified.
    /// It must predict unseen blocks better than `simpler`, and explain more than the best of that many
    /// chance columns. The noise may be correlated from row to row.
    pub(super) fn earns(&self, simpler: &Self, choices: usize) -> bool {
        self.beyond_chance(simpler, choices) && self.beats(simpler)
    }

    /// Twice the log likelihood ratio to `simpler`, counting independent values only.
    pub(super) fn gain_over(&self, simpler: &Self) -> f64 {
        self.independent * (simpler.left.max(1e-12) / self.left.max(1e-12)).ln()
    }

    /// Whether the square of a difference is justified over `simpler`, which lacks it.
    /// Equation 1 has the square of every difference, so there is no choice to allow for.
    pub(super) fn is_bent(&self, simpler: &Self) -> bool {
        self.gain_over(simpler) > BENT && self.rms() < simpler.rms()
    }

    /// The same with enough certainty to stay in the model.
    pub(super) fn is_certainly_bent(&self, simpler: &Self) -> bool {
        self.is_bent(simpler) && self.gain_over(simpler) > CERTAIN
    }

    /// As `earns`, but unseen blocks need only be better on the whole.
    /// It is used against the mean, which has small residuals in most blocks if the machine stood most of the
    /// time.
    pub(super) fn beyond_chance(&self, simpler: &Self, choices: usize) -> bool {
        // Each additional term was a choice, except a square.
        let chosen =
            |j: &Self| j.terms.iter().filter(|t| !matches!(t, Term::Thermal { square: true, .. })).count();
        let more = chosen(self).saturating_sub(chosen(simpler)).max(1) as f64;
        self.gain_over(simpler) > CHANCE + 2.0 * more * (choices.max(1) as f64).ln()
            && self.rms() < simpler.rms()
    }
}

/// Number of independent values in a series that has a slow cause.
/// It follows from the correlation of neighbours.
pub(super) fn independent(series: impl Iterator<Item = f64>) -> f64 {
    let (mut n, mut own, mut next, mut last) = (0.0, 1e-300, 0.0, None);
    for v in series {
        n += 1.0;
        own += v * v;
        next += last.map_or(0.0, |l: f64| l * v);
        last = Some(v);
    }
    let phi = (next / own).clamp(0.0, 0.999);
    n * (1.0 - phi) / (1.0 + phi)
}

/// A column less its mean over the folds, scaled.
/// With it the normal equations keep their digits.
struct ScaledColumn {
    mean: f64,
    scale: f64,
    values: Vec<f64>,
    weighted: Vec<f64>,
}

/// Columns with their products for least squares on some folds.
/// The response, the constant, then one column per term. Terms are added and removed at the end; the products
/// of those that stay are kept.
pub(super) struct GramColumns<'a> {
    problem: &'a Problem,
    folds: &'a [usize],
    total: f64,
    columns: Vec<ScaledColumn>,
    /// Products of every column with those up to itself, row after row.
    /// There is one set per fold, and one for all folds.
    products: Vec<Vec<f64>>,
    all: Vec<f64>,
    /// Cached factors of least squares: without each fold, and on all.
    /// Columns that stay are not factored again.
    roots: Vec<CholeskyFactor>,
    roots_of_all: CholeskyFactor,
}

/// A least-squares solution on the folds.
pub(super) struct CrossValidatedSolution {
    /// Mean square per fold, each left out.
    pub(super) mse: Vec<f64>,
    /// Constant, then one coefficient per term.
    pub(super) coefficients: Vec<f64>,
    /// Mean square of the residual, as a share of the response's variance.
    left: f64,
}

impl CrossValidatedSolution {
    /// Root of the mean over the folds.
    pub(super) fn rms(&self) -> f64 {
        (self.mse.iter().sum::<f64>() / self.mse.len() as f64).sqrt()
    }
}

impl<'a> GramColumns<'a> {
    /// Response and constant on some folds; `None` if the response does not vary.
    pub(super) fn new(problem: &'a Problem, folds: &'a [usize]) -> Option<Self> {
        let total = folds.iter().flat_map(|f| &problem.weight[problem.stretches[*f].clone()]).sum();
        let products = vec![Vec::new(); folds.len()];
        let roots = folds.iter().map(|_| CholeskyFactor::default()).collect();
        let (columns, all, roots_of_all) = (Vec::new(), Vec::new(), CholeskyFactor::default());
        let mut beside = Self { problem, folds, total, columns, products, all, roots, roots_of_all };
        beside.push(&problem.y)?;
        let (values, weighted) = (vec![1.0; problem.y.len()], problem.weight.clone());
        beside.enter(ScaledColumn { mean: 0.0, scale: 1.0, values, weighted });
        Some(beside)
    }

    /// Adds a column at the end; `None` if it does not vary.
    pub(super) fn push(&mut self, column: &[f64]) -> Option<()> {
        let ready = self.ready(column)?;
        self.enter(ready);
        Some(())
    }

    /// Replaces the k-th term's column.
    /// `None` if it does not vary; then the old one stays.
    pub(super) fn replace(&mut self, k: usize, column: &[f64]) -> Option<()> {
        // After response and constant.
        let place = k + 2;
        self.columns[place] = self.ready(column)?;
        self.keep_roots(place - 1);
        for other in 0..self.columns.len() {
            let (later, earlier) = (place.max(other), place.min(other));
            let at = row(later) + earlier;
            let (later, earlier) = (&self.columns[later], &self.columns[earlier]);
            self.all[at] = 0.0;
            for (f, products) in self.folds.iter().zip(&mut self.products) {
                let stretch = self.problem.stretches[*f].clone();
                products[at] = dot(&later.weighted[stretch.clone()], &earlier.values[stretch]);
                self.all[at] += products[at];
            }
        }
        Some(())
    }

    fn ready(&self, column: &[f64]) -> Option<ScaledColumn> {
        let weight = &self.problem.weight;
        let stretches = || self.folds.iter().map(|f| self.problem.stretches[*f].clone());
        let mean = stretches().map(|s| dot(&weight[s.clone()], &column[s])).sum::<f64>() / self.total;
        let mut values: Vec<f64> = column.iter().map(|v| v - mean).collect();
        let mut weighted: Vec<f64> = values.iter().zip(weight).map(|(v, w)| v * w).collect();
        let variance = stretches().map(|s| dot(&weighted[s.clone()], &values[s])).sum::<f64>() / self.total;
        if variance <= 1e-18 {
            return None;
        }
        let scale = variance.sqrt();
        values.iter_mut().chain(&mut weighted).for_each(|v| *v /= scale);
        Some(ScaledColumn { mean, scale, values, weighted })
    }

    fn enter(&mut self, column: ScaledColumn) {
        self.columns.push(column);
        let new = &self.columns[self.columns.len() - 1];
        let begin = self.all.len();
        self.all.resize(begin + self.columns.len(), 0.0);
        for (f, products) in self.folds.iter().zip(&mut self.products) {
            let stretch = self.problem.stretches[*f].clone();
            for (k, other) in self.columns.iter().enumerate() {
                let product = dot(&new.weighted[stretch.clone()], &other.values[stretch.clone()]);
                products.push(product);
                self.all[begin + k] += product;
            }
        }
    }

    /// Removes the last column.
    pub(super) fn pop(&mut self) {
        let left = self.all.len() - self.columns.len();
        self.columns.pop();
        self.products.iter_mut().chain([&mut self.all]).for_each(|p| p.truncate(left));
        self.keep_roots(self.columns.len() - 1);
    }

    /// Keeps the factors of the first `columns` of constant and terms.
    fn keep_roots(&mut self, columns: usize) {
        self.roots.iter_mut().chain([&mut self.roots_of_all]).for_each(|r| r.keep(columns));
    }

    /// Least squares on all folds, judged by leaving out each in turn.
    /// `None` if the columns are dependent.
    pub(super) fn solve(&mut self) -> Option<CrossValidatedSolution> {
        rtec_files::cancellable_computation::step();
        let response = &self.columns[0];
        let fit = self.roots_of_all.least_squares(&self.all)?;
        let left = left_over(&self.all, &fit) / self.total;
        let mut mse = Vec::with_capacity(self.folds.len());
        let mut others = vec![0.0; self.all.len()];
        for (own, roots) in self.products.iter().zip(&mut self.roots) {
            others.iter_mut().zip(self.all.iter().zip(own)).for_each(|(o, (all, own))| *o = all - own);
            let c = roots.least_squares(&others)?;
            mse.push(left_over(own, &c) * response.scale * response.scale / own[CONSTANT].max(1e-300));
        }
        let terms = &self.columns[2..];
        let mut coefficients = vec![0.0];
        coefficients.extend(fit[1..].iter().zip(terms).map(|(c, t)| c * response.scale / t.scale));
        let means: f64 = coefficients[1..].iter().zip(terms).map(|(c, t)| c * t.mean).sum();
        coefficients[0] = response.mean + fit[0] * response.scale - means;
        Some(CrossValidatedSolution { mse, coefficients, left })
    }

    /// Fits and judges these terms, whose columns are here.
    /// `None` if they are dependent.
    pub(super) fn judge(&mut self, terms: &[Term]) -> Option<ValidatedStructure> {
        let solved = self.solve()?;
        let independent = independent(self.residuals(&solved).into_iter()).max(self.folds.len() as f64);
        let CrossValidatedSolution { mse, coefficients, left } = solved;
        let r = (1.0 - left).max(0.0).sqrt();
        Some(ValidatedStructure { terms: terms.to_vec(), mse, r, coefficients, left, independent })
    }

    /// The residual of the response, one value per bin of the folds.
    fn residuals(&self, solved: &CrossValidatedSolution) -> Vec<f64> {
        let response = &self.columns[0];
        let mut left: Vec<f64> = response.values.iter().map(|v| v * response.scale + response.mean).collect();
        for v in &mut left {
            *v -= solved.coefficients[0];
        }
        for (term, c) in self.columns[2..].iter().zip(&solved.coefficients[1..]) {
            let (gain, zero) = (c * term.scale, c * term.mean);
            left.iter_mut().zip(&term.values).for_each(|(l, v)| *l -= gain * v + zero);
        }
        self.folds.iter().flat_map(|f| &left[self.problem.stretches[*f].clone()]).copied().collect()
    }
}

/// Index of the constant's product with itself.
/// It follows the response's own product, and that of the constant with the response.
const CONSTANT: usize = 2;

/// Index at which the products of the k-th column begin.
const fn row(k: usize) -> usize {
    k * (k + 1) / 2
}

/// Least squares by products of columns (Cholesky).
/// It holds the factor, row after row, and the response solved with it.
#[derive(Default)]
struct CholeskyFactor {
    factor: Vec<f64>,
    response: Vec<f64>,
}

impl CholeskyFactor {
    /// Keeps the factors of the first `columns`.
    fn keep(&mut self, columns: usize) {
        self.response.truncate(columns);
        self.factor.truncate(row(self.response.len()));
    }

    /// Coefficients of constant and terms from these products.
    /// Factors of the columns kept are reused. `None` if columns are nearly equal.
    fn least_squares(&mut self, products: &[f64]) -> Option<Vec<f64>> {
        let mut begin = row(self.response.len() + 1);
        while begin < products.len() {
            let k = self.response.len();
            if !self.enter(&products[begin..begin + k + 2], 1e-7 * products[CONSTANT]) {
                self.keep(k);
                return None;
            }
            begin += k + 2;
        }
        let roots = &self.factor;
        let mut solution = self.response.clone();
        for k in (0..solution.len()).rev() {
            let known: f64 = (k + 1..solution.len()).map(|i| roots[row(i) + k] * solution[i]).sum();
            solution[k] = (solution[k] - known) / roots[row(k) + k];
        }
        Some(solution)
    }

    /// Adds the next row of the factor and its forward substitution.
    /// `false` if at most the share `linear_least_squares` of the column is independent of those before.
    fn enter(&mut self, own: &[f64], least: f64) -> bool {
        let (roots, k) = (&mut self.factor, self.response.len());
        for j in 0..=k {
            let (mine, theirs) = (row(k), row(j));
            let inner: f64 = roots[mine..].iter().zip(&roots[theirs..theirs + j]).map(|(m, t)| m * t).sum();
            let rest = own[j + 1] - inner;
            if j < k {
                roots.push(rest / roots[theirs + j]);
            } else if rest > least {
                roots.push(rest.sqrt());
            } else {
                return false;
            }
        }
        let mine = &roots[row(k)..];
        let known: f64 = self.response.iter().zip(mine).map(|(s, r)| s * r).sum();
        self.response.push((own[0] - known) / mine[k]);
        true
    }
}

/// The residual sum of squares of these coefficients, from the products.
/// The products are of the response, the constant and the terms.
fn left_over(products: &[f64], coefficients: &[f64]) -> f64 {
    let by = |k: usize| if k == 0 { -1.0 } else { coefficients[k - 1] };
    let mut sum = 0.0;
    for k in 0..=coefficients.len() {
        let own = &products[row(k)..];
        let beside: f64 = (0..k).map(|j| own[j] * by(j)).sum();
        sum += by(k) * (2.0 * beside + by(k) * own[k]);
    }
    sum.max(0.0)
}

impl Problem {
    /// Fits the terms on the given folds, judged by leaving out each in turn.
    /// `None` if the columns are dependent.
    pub(super) fn judge(&self, terms: &[Term], folds: &[usize]) -> Option<ValidatedStructure> {
        self.beside(terms, folds)?.judge(terms)
    }

    /// The columns of these terms on some folds; `None` if one does not vary.
    pub(super) fn beside<'a>(&'a self, terms: &[Term], folds: &'a [usize]) -> Option<GramColumns<'a>> {
        let mut beside = GramColumns::new(self, folds)?;
        for term in terms {
            beside.push(&self.column(*term))?;
        }
        Some(beside)
    }

    /// The bins of these folds.
    pub(super) fn stretches<'a>(&'a self, folds: &'a [usize]) -> impl Iterator<Item = Range<usize>> + 'a {
        folds.iter().map(|f| self.stretches[*f].clone())
    }

    pub(super) fn gamma(&self, term: Term, folds: &[usize]) -> f64 {
        let u = self.column(term);
        let of = |v: &[f64]| self.stretches(folds).map(|s| &v[s]).collect::<Vec<_>>().concat();
        correlation(&of(&u), &of(&self.y))
    }

    /// Range of the values on these folds.
    fn swing(&self, values: &[f64], folds: &[usize]) -> f64 {
        let [least, most] = span(self.stretches(folds).flat_map(|s| &values[s]));
        most - least
    }

    /// Whether the coefficients are physical.
    /// Differences to the environment must keep the sign of their own correlation; a fit that reverses it
    /// exploits collinearity. So does a fit with implausible gains. So do terms that move the response far
    /// more than it moves and cancel each other, because in other states they would not cancel.
    pub(super) fn physical(&self, terms: &[Term], coefficients: &[f64], folds: &[usize]) -> bool {
        let signs = terms.iter().zip(&coefficients[1..]).all(|(t, c)| match t {
            Term::Thermal { minus, square: false, .. } => {
                *minus != self.environment || self.gamma(*t, folds) * c >= 0.0
            }
            _ => true,
        });
        let plausible = signs && self.implausible(terms, coefficients).is_none();
        plausible && (terms.len() < 2 || !self.cancel(terms, coefficients, folds))
    }

    /// The term whose gain is furthest beyond the dictionary's plausible range.
    /// `None` if all are within.
    pub(super) fn implausible(&self, terms: &[Term], coefficients: &[f64]) -> Option<usize> {
        let share = |(k, t): (usize, &Term)| match t {
            Term::Thermal { square, .. } => coefficients[k + 1].abs() / self.plausible[usize::from(*square)],
            _ => 0.0,
        };
        let shares = terms.iter().enumerate().map(share).enumerate();
        shares.filter(|(_, s)| *s > 1.0).max_by(|a, b| a.1.total_cmp(&b.1)).map(|(k, _)| k)
    }

    /// Whether a term moves the response far more than it moves in all.
    fn cancel(&self, terms: &[Term], coefficients: &[f64], folds: &[usize]) -> bool {
        let most_um = CANCELLED * self.swing(&self.y, folds);
        terms.iter().zip(&coefficients[1..]).any(|(t, c)| {
            matches!(t, Term::Thermal { square: false, .. })
                && c.abs() * self.swing(&self.column(*t), folds) > most_um
        })
    }

    /// Whether a judged structure is physical.
    pub(super) fn is_physical(&self, judged: &ValidatedStructure, folds: &[usize]) -> bool {
        self.physical(&judged.terms, &judged.coefficients, folds)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)] // a test's own helpers

    use super::*;
    use crate::thermal::Options;
    use nalgebra::{DMatrix, DVector};
    use rtec_model::record::{Axis, Column, Record, Role, RunKind};
    use std::path::Path;

    /// Rows of several sensors; more rows than bins, so that the last bin weighs less.
    fn drift(sensors: usize) -> Record {
        let rows = || (0..1300_u32).map(f64::from);
        let warm = |i: f64, k: f64| 8.0 * (i / (150.0 + 60.0 * k)).sin() + 0.05 * (k * i * i + i).sin();
        let growth =
            rows().map(|i| 5.0 + 1.3 * warm(i, 0.0) - 0.4 * warm(i, 1.0) + 0.3 * (1.7 * i * i).sin());
        let mut columns = vec![Column::new("t", Role::Time, rows().map(|i| 60.0 * i).collect())];
        columns.push(Column::new("e", Role::Error(Axis::new("z").unwrap()), growth.collect()));
        for k in 0..sensors {
            let degc = rows().map(|i| 20.0 + warm(i, k as f64) / (1.0 + k as f64)).collect();
            columns.push(Column::new(&format!("T{k}"), Role::Temperature, degc));
        }
        Record::new(Path::new("drift.run.toml"), RunKind::Drift, columns).unwrap()
    }

    fn response() -> Role {
        Role::Error(Axis::new("z").unwrap())
    }

    fn difference(sensor: usize, lag: usize) -> Term {
        Term::Thermal { sensor, minus: Some(2), lag, square: false }
    }

    /// Weighted least squares by another method.
    /// It uses singular values of all rows at once, each fold left out.
    #[test]
    fn a_structure_is_judged_as_by_singular_values() {
        let record = drift(3);
        let problem = Problem::new(&[&record], &response(), &Options::default()).unwrap();
        let folds = [0, 1, 3, 4, 6, 7, 8, 9];
        let terms = [difference(0, 0), difference(1, 40)];
        let judged = problem.judge(&terms, &folds).unwrap();
        let columns = terms.map(|t| problem.column(t));
        let solve = |bins: &[usize]| {
            let root = |i: usize| problem.weight[i].sqrt();
            let a = DMatrix::from_fn(bins.len(), 3, |n, k| {
                root(bins[n]) * if k == 0 { 1.0 } else { columns[k - 1][bins[n]] }
            });
            let b = DVector::from_fn(bins.len(), |n, _| root(bins[n]) * problem.y[bins[n]]);
            a.svd(true, true).solve(&b, 1e-12).unwrap()
        };
        let near = |a: f64, b: f64| assert!((a - b).abs() <= 1e-9 * b.abs().max(1.0), "{a} {b}");
        let bins = |folds: &[usize]| problem.stretches(folds).flatten().collect::<Vec<usize>>();
        let all = solve(&bins(&folds));
        judged.coefficients.iter().zip(&all).for_each(|(a, b)| near(*a, *b));
        for (f, mse) in folds.iter().zip(&judged.mse) {
            let others: Vec<usize> = folds.iter().copied().filter(|o| o != f).collect();
            let c = solve(&bins(&others));
            let left = |i: usize| problem.y[i] - c[0] - c[1] * columns[0][i] - c[2] * columns[1][i];
            let own = bins(&[*f]);
            let sum: f64 = own.iter().map(|i| problem.weight[*i] * left(*i).powi(2)).sum();
            near(*mse, sum / own.iter().map(|i| problem.weight[*i]).sum::<f64>());
        }
    }

    /// A column that was added and removed leaves no trace.
    /// One that does not vary, or is the double of another, is refused.
    #[test]
    fn columns_come_and_go() {
        let record = drift(3);
        let problem = Problem::new(&[&record], &response(), &Options::default()).unwrap();
        let folds: Vec<usize> = (0..problem.folds).collect();
        let mut beside = problem.beside(&[difference(0, 0)], &folds).unwrap();
        let before = beside.solve().unwrap();
        beside.push(&problem.column(difference(1, 7))).unwrap();
        assert!(beside.solve().unwrap().rms() < before.rms());
        beside.pop();
        assert_eq!(beside.solve().unwrap().mse, before.mse);
        assert!(beside.push(&vec![3.0; problem.y.len()]).is_none());
        beside.push(&problem.column(difference(0, 0))).unwrap();
        assert!(beside.solve().is_none());
    }

    /// Cached results equal fresh ones to the last bit.
    /// This holds after replacing a column in any place, adding or removing one, or doubling one.
    #[test]
    fn columns_change_places() {
        let record = drift(4);
        let problem = Problem::new(&[&record], &response(), &Options::default()).unwrap();
        let folds: Vec<usize> = (0..problem.folds).filter(|f| *f != 4).collect();
        let mut terms = vec![difference(0, 0), difference(1, 7), difference(3, 20)];
        let mut beside = problem.beside(&terms, &folds).unwrap();
        let same = |beside: &mut GramColumns, terms: &[Term]| {
            let (kept, anew) = (beside.judge(terms).unwrap(), problem.judge(terms, &folds).unwrap());
            assert_eq!((kept.mse, kept.coefficients), (anew.mse, anew.coefficients));
        };
        same(&mut beside, &terms);
        for (k, lag) in [(2, 30), (1, 9), (0, 3), (1, 0), (2, 5)] {
            let Term::Thermal { sensor, .. } = terms[k] else { unreachable!() };
            terms[k] = difference(sensor, lag);
            beside.replace(k, &problem.column(terms[k])).unwrap();
            same(&mut beside, &terms);
            assert!(beside.replace(k, &vec![3.0; problem.y.len()]).is_none());
            same(&mut beside, &terms);
            beside.push(&problem.column(terms[0])).unwrap();
            assert!(beside.solve().is_none());
            beside.pop();
            same(&mut beside, &terms);
        }
    }

    /// Reordered terms give the same residual up to rounding, so they are not better.
    #[test]
    fn the_order_of_terms_is_no_gain() {
        let record = drift(3);
        let problem = Problem::new(&[&record], &response(), &Options::default()).unwrap();
        let folds: Vec<usize> = (0..problem.folds).collect();
        let judge = |terms: &[Term]| problem.judge(terms, &folds).unwrap();
        for lag in 0..60 {
            let (a, b) = (difference(0, lag), difference(1, 30));
            let (one, other) = (judge(&[a, b]), judge(&[b, a]));
            assert!(!one.beats(&other) && !other.beats(&one), "{lag}");
        }
        assert!(judge(&[difference(0, 0), difference(1, 0)]).beats(&judge(&[difference(1, 0)])));
    }

    #[test]
    fn a_sensor_that_stands_still_is_offered_only_by_name() {
        let mut record = drift(1);
        for (name, degc) in [("A", 25.0), ("Z", 0.0)] {
            record.columns.push(Column::new(name, Role::Temperature, vec![degc; record.rows()]));
        }
        let problem = |options: &Options| Problem::new(&[&record], &response(), options).unwrap();
        let all = problem(&Options::default());
        assert_eq!(
            (all.sensors, all.still, all.environment),
            (vec!["T0".into()], vec!["A".into(), "Z".into()], None)
        );
        let named = problem(&Options { environment: Some("A".into()), ..Options::default() });
        assert_eq!((named.sensors, named.still), (vec!["T0".into(), "A".into()], vec!["Z".into()]));
        let (_, reports) = crate::thermal::fit(&[&record], &[], &Options::default()).unwrap();
        let said = &reports[0].warnings;
        assert!(said.iter().any(|s| s.starts_with("A reads the same in every row")), "{said:?}");
        assert!(reports[0].kept.iter().all(|k| !k.sensor.contains('A') && !k.sensor.contains('Z')));
    }

    #[test]
    fn more_sensors_than_can_be_paired_are_to_be_named() {
        if !test_needs::long() {
            return;
        }
        let record = drift(260);
        let said = Problem::new(&[&record], &response(), &Options::default()).err().unwrap();
        assert!(said.found.contains("260 temperatures") && said.expected.contains("--sensors"), "{said}");
        let few = ["T0", "T7"].map(rtec_model::effect::TemperatureDifference::single);
        let named = Options { sensors: few.to_vec(), ..Options::default() };
        assert!(Problem::new(&[&record], &response(), &named).is_ok());
    }
}
