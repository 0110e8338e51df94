//! 95 % intervals of the parameters, from what they are with each block left out.

use super::problem::Problem;
use super::rows::{Rows, lags_of, mean};
use super::term::{Term, relagged, squared};
use rtec_files::InputError;
use rtec_model::record::{Record, Role};
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

/// 95 % intervals by leaving out each block: of every coefficient, and of each lag by its term's place.
pub(super) struct Jackknife {
    pub(super) coefficients: Vec<[f64; 2]>,
    /// Of the squares that were left out, by the place of their difference's term.
    pub(super) squares: BTreeMap<usize, [f64; 2]>,
    pub(super) tau_s: BTreeMap<usize, [f64; 2]>,
}

/// How far from the grid's value a lag is looked for, in the logarithm; and how finely.
const REACH: f64 = 0.5;
const CLOSE: f64 = 1e-3;

/// The terms with their lags as all rows have them best, between the steps of the grid.
pub(super) fn tuned(
    problem: &mut Problem,
    mut terms: Vec<Term>,
    train: &[&Record],
    response: &Role,
) -> Result<Vec<Term>, InputError> {
    let lags_s = best_lags(problem, &terms, &lags_of(problem, &terms), train, response, &|_, _| true)?;
    for k in 0..terms.len() {
        let Term::Thermal { lag: 1.., square: false, .. } = terms[k] else { continue };
        let lag = problem.with_lag(lags_s[k], train);
        terms = relagged(&terms, k, lag);
    }
    Ok(terms)
}

/// The lag of each term, s, with which least squares on the rows that `take` chooses (number, block) leave least.
fn best_lags(
    problem: &Problem,
    terms: &[Term],
    start_s: &[f64],
    train: &[&Record],
    response: &Role,
    take: &dyn Fn(usize, usize) -> bool,
) -> Result<Vec<f64>, InputError> {
    let mut lags_s = start_s.to_vec();
    let lagged: Vec<usize> = (0..terms.len())
        .filter(|k| matches!(terms[*k], Term::Thermal { lag: 1.., square: false, .. }))
        .collect();
    // With more than one, each beside the others, twice round.
    for _ in 0..lagged.len().min(2) {
        for &k in &lagged {
            let shared: Vec<usize> =
                (0..terms.len()).filter(|j| *j == k || squared(terms[k]) == Some(terms[*j])).collect();
            let left = |ln: f64| {
                let mut tried = lags_s.clone();
                for j in &shared {
                    tried[*j] = ln.exp();
                }
                let rows = Rows::with_lags(problem, terms, &tried, train, response)?;
                let own = |i: usize| take(i, rows.fold[i]);
                Ok::<_, InputError>(rows.solve(&own).map_or(f64::INFINITY, |c| rows.rms(&c, &own)))
            };
            let middle = start_s[k].ln();
            let ln = smallest(middle - REACH, middle + REACH, left)?;
            for j in &shared {
                lags_s[*j] = ln.exp();
            }
        }
    }
    Ok(lags_s)
}

/// Where a function of one minimum is smallest (golden section).
fn smallest(
    mut lo: f64,
    mut hi: f64,
    of: impl Fn(f64) -> Result<f64, InputError>,
) -> Result<f64, InputError> {
    const GOLDEN: f64 = 0.618_033_988_749_894_9;
    let (mut a, mut b) = (hi - GOLDEN * (hi - lo), lo + GOLDEN * (hi - lo));
    let (mut fa, mut fb) = (of(a)?, of(b)?);
    while hi - lo > CLOSE {
        if fa < fb {
            (hi, b, fb) = (b, a, fa);
            a = hi - GOLDEN * (hi - lo);
            fa = of(a)?;
        } else {
            (lo, a, fa) = (a, b, fb);
            b = lo + GOLDEN * (hi - lo);
            fb = of(b)?;
        }
    }
    Ok(f64::midpoint(lo, hi))
}

/// Every coefficient's interval, and every lag's: without each block in turn, lags found anew.
pub(super) fn jackknife(
    problem: &Problem,
    terms: &[Term],
    train: &[&Record],
    response: &Role,
    full: &[f64],
) -> Result<Jackknife, InputError> {
    let start_s = lags_of(problem, terms);
    let (mut parts, mut lags): (Vec<Vec<f64>>, Vec<Vec<f64>>) = (Vec::new(), Vec::new());
    for f in 0..problem.folds {
        let lags_s = best_lags(problem, terms, &start_s, train, response, &|_, fold| fold != f)?;
        let rows = Rows::with_lags(problem, terms, &lags_s, train, response)?;
        if let Some(c) = rows.solve(&|i| rows.fold[i] != f) {
            parts.push(c);
            lags.push(lags_s);
        }
    }
    let of = |k: usize| jackknife_interval(full[k], &parts.iter().map(|p| p[k]).collect::<Vec<f64>>());
    let mut tau_s = BTreeMap::new();
    for (k, term) in terms.iter().enumerate() {
        let Term::Thermal { lag: 1.., square: false, .. } = *term else { continue };
        let [lo, hi] =
            jackknife_interval(start_s[k].ln(), &lags.iter().map(|l| l[k].ln()).collect::<Vec<f64>>());
        tau_s.insert(k, [lo.exp(), hi.exp()]);
    }
    let coefficients = (0..full.len()).map(of).collect();
    Ok(Jackknife { coefficients, squares: BTreeMap::new(), tau_s })
}

/// A square is certain beyond this gain, as twice the logarithm of the likelihood: three standard errors.
const CERTAIN: f64 = 9.0;

impl Jackknife {
    /// Whether a growth is bent is itself a choice that the data made: where it is not certain, the intervals of growth,
    /// lag and square hold what they are with the square and what they are without.
    pub(super) fn allow_for_squares(
        &mut self,
        problem: &mut Problem,
        terms: &[Term],
        train: &[&Record],
        response: &Role,
        folds: &[usize],
    ) -> Result<(), InputError> {
        if !problem.square {
            return Ok(());
        }
        for (k, term) in terms.iter().enumerate() {
            let Some(square) = squared(*term) else { continue };
            let place = terms.iter().position(|t| *t == square);
            let other: Vec<Term> = match place {
                Some(_) => terms.iter().filter(|t| **t != square).copied().collect(),
                None => terms.iter().copied().chain([square]).collect(),
            };
            let other = tuned(problem, other, train, response)?;
            let (Some(now), Some(then)) = (problem.judge(terms, folds), problem.judge(&other, folds)) else {
                continue;
            };
            if place.is_some() && now.gain_over(&then) > CERTAIN {
                continue;
            }
            let rows = Rows::new(problem, &other, train, response)?;
            let Some(c) = rows.solve(&|_| true) else { continue };
            let alternative = jackknife(problem, &other, train, response, &c)?;
            // Terms before the square keep their places, those after it move up.
            let at = k - usize::from(place.is_some_and(|p| p < k));
            let hull = |a: &mut [f64; 2], b: [f64; 2]| *a = [a[0].min(b[0]), a[1].max(b[1])];
            hull(&mut self.coefficients[k + 1], alternative.coefficients[at + 1]);
            if let (Some(a), Some(b)) = (self.tau_s.get_mut(&k), alternative.tau_s.get(&at)) {
                hull(a, *b);
            }
            if let Some(p) = place {
                hull(&mut self.coefficients[p + 1], [0.0; 2]);
            } else {
                let mut own = alternative.coefficients[other.len()];
                hull(&mut own, [0.0; 2]);
                self.squares.insert(k, own);
            }
        }
        Ok(())
    }
}
