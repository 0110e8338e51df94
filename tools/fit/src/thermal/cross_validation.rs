//! Judges a structure by blocked cross-validation in time.

use super::fit_candidates::TermSelectionProblem;
use super::term::Term;
use rtec_least_squares::{QrFactor, add, dot};
use rtec_measure::iso230::correlation;
use rtec_model::record::span;
use std::ops::Range;
use std::rc::Rc;

/// A structure with its cross-validation.
#[derive(Debug, Clone)]
pub(super) struct CrossValidatedTerms {
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

/// Smallest share of a column that those before it must not explain.
const OWN_SHARE: f64 = 3e-4;

/// Largest movement of one term, relative to the response's whole movement.
const CANCELLED: f64 = 2.0;

impl CrossValidatedTerms {
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

/// Constant and terms on some folds, by orthogonal factors.
/// Rows are weighted; columns are less their means.
#[derive(Clone)]
pub(super) struct FoldLeastSquares {
    factor: QrFactor,
    /// Root of each bin's weight, fold after fold.
    roots: Rc<[f64]>,
    /// Each fold's bins, and the sum of their weights.
    folds: Rc<[(Range<usize>, f64)]>,
    /// The folds' bins in all rows of the search.
    stretches: Rc<[Range<usize>]>,
    /// Means of the response and of each term.
    means: Vec<f64>,
    /// Sum of squares of the response about its mean.
    square: f64,
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

impl FoldLeastSquares {
    /// Response and constant on some folds; `None` if the response does not vary.
    fn new(problem: &TermSelectionProblem, folds: &[usize]) -> Option<Self> {
        let stretches: Rc<[Range<usize>]> = problem.stretches(folds).collect();
        let roots = stretches.iter().flat_map(|s| &problem.weight[s.clone()]).map(|w| w.sqrt()).collect();
        let mut from = 0;
        let fold = |stretch: &Range<usize>| {
            let own = from..from + stretch.len();
            from = own.end;
            (own, problem.weight[stretch.clone()].iter().sum())
        };
        let folds = stretches.iter().map(fold).collect();
        let factor = QrFactor::new(&[]);
        let empty = Self { factor, roots, folds, stretches, means: Vec::new(), square: 0.0 };
        let (response, mean) = empty.rows(&problem.y)?;
        let mut factor = QrFactor::new(&response);
        factor.push_free(&empty.roots);
        Some(Self { factor, means: vec![mean], square: dot(&response, &response), ..empty })
    }

    /// A column's weighted rows less their mean, and the mean.
    /// `None` if it does not vary.
    fn rows(&self, column: &[f64]) -> Option<(Vec<f64>, f64)> {
        let total = dot(&self.roots, &self.roots);
        let mut rows = Vec::with_capacity(self.roots.len());
        self.stretches.iter().for_each(|s| rows.extend_from_slice(&column[s.clone()]));
        rows.iter_mut().zip(&*self.roots).for_each(|(v, root)| *v *= root);
        let mean = dot(&rows, &self.roots) / total;
        add(&mut rows, -mean, &self.roots);
        (dot(&rows, &rows) > 1e-18 * total).then_some((rows, mean))
    }

    /// The same with one more column.
    /// `None` if it does not vary, or depends on those before it.
    pub(super) fn with(&self, column: &[f64]) -> Option<Self> {
        let (rows, mean) = self.rows(column)?;
        let mut more = self.clone();
        more.means.push(mean);
        (more.factor.push_free(&rows) > OWN_SHARE).then_some(more)
    }

    /// Least squares on all folds, judged by leaving out each in turn.
    /// `None` if the columns are dependent without a fold.
    pub(super) fn solve(&self) -> Option<CrossValidatedSolution> {
        rtec_files::cancellable_computation::step();
        let fold =
            |(bins, weight): &(Range<usize>, f64)| Some(self.factor.left_out(bins, OWN_SHARE)? / weight);
        let mse = self.folds.iter().map(fold).collect::<Option<_>>()?;
        let mut coefficients = self.factor.solve();
        coefficients[0] += self.means[0] - dot(&coefficients[1..], &self.means[1..]);
        let residual = self.factor.residual();
        Some(CrossValidatedSolution { mse, coefficients, left: dot(residual, residual) / self.square })
    }

    /// Fits and judges these terms, whose columns are here.
    /// `None` if they are dependent.
    pub(super) fn judge(&self, terms: &[Term]) -> Option<CrossValidatedTerms> {
        let CrossValidatedSolution { mse, coefficients, left } = self.solve()?;
        let residual = self.factor.residual().iter().zip(&*self.roots).map(|(r, root)| r / root);
        let independent = independent(residual).max(self.folds.len() as f64);
        let r = (1.0 - left).max(0.0).sqrt();
        Some(CrossValidatedTerms { terms: terms.to_vec(), mse, r, coefficients, left, independent })
    }
}

impl TermSelectionProblem {
    /// Fits the terms on the given folds, judged by leaving out each in turn.
    /// `None` if the columns are dependent.
    pub(super) fn judge(&self, terms: &[Term], folds: &[usize]) -> Option<CrossValidatedTerms> {
        self.beside(terms, folds)?.judge(terms)
    }

    /// The columns of these terms on some folds; `None` if one does not vary.
    pub(super) fn beside(&self, terms: &[Term], folds: &[usize]) -> Option<FoldLeastSquares> {
        let none = FoldLeastSquares::new(self, folds)?;
        terms.iter().try_fold(none, |beside, term| beside.with(&self.column(*term)))
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
    pub(super) fn is_physical(&self, judged: &CrossValidatedTerms, folds: &[usize]) -> bool {
        self.physical(&judged.terms, &judged.coefficients, folds)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)] // a test's own helpers

    use super::*;
    use crate::thermal::ThermalFitOptions;
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
        let problem =
            TermSelectionProblem::new(&[&record], &response(), &ThermalFitOptions::default()).unwrap();
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

    /// A column that does not vary, or is the double of another, is refused.
    #[test]
    fn a_column_without_news_is_refused() {
        let record = drift(3);
        let problem =
            TermSelectionProblem::new(&[&record], &response(), &ThermalFitOptions::default()).unwrap();
        let folds: Vec<usize> = (0..problem.folds).collect();
        let beside = problem.beside(&[difference(0, 0)], &folds).unwrap();
        let more = beside.with(&problem.column(difference(1, 7))).unwrap();
        assert!(more.solve().unwrap().rms() < beside.solve().unwrap().rms());
        assert!(beside.with(&vec![3.0; problem.y.len()]).is_none());
        assert!(beside.with(&problem.column(difference(0, 0))).is_none());
        // One that varies within a single fold is dependent without it.
        let stretch = problem.stretches[4].clone();
        let once =
            (0..problem.y.len()).map(|i| f64::from(u8::from(stretch.contains(&i)))).collect::<Vec<_>>();
        assert!(beside.with(&once).unwrap().solve().is_none());
    }

    /// Reordered terms give the same residual up to rounding, so they are not better.
    #[test]
    fn the_order_of_terms_is_no_gain() {
        let record = drift(3);
        let problem =
            TermSelectionProblem::new(&[&record], &response(), &ThermalFitOptions::default()).unwrap();
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
        let problem = |options: &ThermalFitOptions| {
            TermSelectionProblem::new(&[&record], &response(), options).unwrap()
        };
        let all = problem(&ThermalFitOptions::default());
        assert_eq!(
            (all.sensors, all.still, all.environment),
            (vec!["T0".into()], vec!["A".into(), "Z".into()], None)
        );
        let named =
            problem(&ThermalFitOptions { environment: Some("A".into()), ..ThermalFitOptions::default() });
        assert_eq!((named.sensors, named.still), (vec!["T0".into(), "A".into()], vec!["Z".into()]));
        let (_, reports) = crate::thermal::fit(&[&record], &[], &ThermalFitOptions::default()).unwrap();
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
        let said =
            TermSelectionProblem::new(&[&record], &response(), &ThermalFitOptions::default()).err().unwrap();
        assert!(said.found.contains("260 temperatures") && said.expected.contains("--sensors"), "{said}");
        let few = ["T0", "T7"].map(rtec_model::effect::TemperatureDifference::single);
        let named = ThermalFitOptions { sensors: few.to_vec(), ..ThermalFitOptions::default() };
        assert!(TermSelectionProblem::new(&[&record], &response(), &named).is_ok());
    }
}
