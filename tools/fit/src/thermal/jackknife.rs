//! 95 % intervals of the parameters, by leaving out each block.
//! A lag's interval is at least as wide as the curvature of the sum of squares requires. Blocks in which
//! nothing warms do not show a lag, so leaving one of them out has no effect.

use super::cross_validation::independent;
use super::fit_candidates::TermSelectionProblem;
use super::least_squares_rows::{CentredRows, LeastSquaresRows, lags_of};
use super::term::{Term, relagged, squared};
use crate::statistics::mean;
use crate::temperature_denoising::SmoothingUncertainty;
use rtec_files::InputError;
use rtec_model::machine::NORMAL_95;
use rtec_model::record::{Record, Role, shared_step};
use statrs::distribution::{ContinuousCDF, StudentsT};
use std::collections::BTreeMap;

/// 95 % intervals of an effect's parameters by name, one per value.
pub(crate) type Intervals = BTreeMap<String, Vec<[f64; 2]>>;

/// The 95 % interval of a value from its values with each block left out.
pub(crate) fn jackknife_interval(value: f64, parts: &[f64]) -> [f64; 2] {
    let m = mean(parts);
    let n = parts.len() as f64;
    let t = student((n - 1.0).max(1.0));
    let se = ((n - 1.0) / n * parts.iter().map(|p| (p - m).powi(2)).sum::<f64>()).sqrt();
    [value - t * se, value + t * se]
}

/// Student's factor of a two-sided 95 % interval.
fn student(degrees_of_freedom: f64) -> f64 {
    StudentsT::new(0.0, 1.0, degrees_of_freedom).map_or(1.96, |d| d.inverse_cdf(0.975))
}

/// 95 % intervals by leaving out each block: of coefficients, and of lags by term.
pub(super) struct JackknifeIntervals {
    pub(super) coefficients: Vec<[f64; 2]>,
    /// Intervals of omitted squares, by the index of their difference's term.
    pub(super) squares: BTreeMap<usize, [f64; 2]>,
    pub(super) tau_s: BTreeMap<usize, [f64; 2]>,
}

/// Range around the grid's value in which a lag is refined (log).
const REACH: f64 = 0.5;
/// Accuracy of a refined lag (log).
const CLOSE: f64 = 1e-3;
/// Random draws of the temperatures' errors; their spread is then known to a fifth.
const DRAWS: usize = 12;

/// The terms with their lags refined between the grid's steps, on all rows.
pub(super) fn tuned(
    problem: &mut TermSelectionProblem,
    mut terms: Vec<Term>,
    train: &[&Record],
    response: &Role,
) -> Result<Vec<Term>, InputError> {
    let lags_s = best_lags(problem, &terms, &lags_of(problem, &terms), train, response, &|_| true)?;
    for k in 0..terms.len() {
        let Term::Thermal { lag: 1.., square: false, .. } = terms[k] else { continue };
        let lag = problem.with_lag(lags_s[k], train);
        terms = relagged(&terms, k, lag);
    }
    Ok(terms)
}

/// The lags with the least sum of squares on the blocks that `take` selects, s.
fn best_lags(
    problem: &TermSelectionProblem,
    terms: &[Term],
    start_s: &[f64],
    train: &[&Record],
    response: &Role,
    take: &dyn Fn(usize) -> bool,
) -> Result<Vec<f64>, InputError> {
    let mut lags_s = start_s.to_vec();
    let lagged: Vec<usize> = (0..terms.len())
        .filter(|k| matches!(terms[*k], Term::Thermal { lag: 1.., square: false, .. }))
        .collect();
    let mut rows = LeastSquaresRows::with_lags(problem, terms, &lags_s, train, response)?;
    let taken = rows.runs(&|i| take(rows.fold[i]));
    let mut centred = (!taken.is_empty()).then(|| CentredRows::new(&rows, &taken));
    // If there are several, each is refined with the others held, in two rounds.
    for _ in 0..lagged.len().min(2) {
        for &k in &lagged {
            let shared = shared(terms, k);
            let left = |ln: f64| {
                rows.lag(problem, terms, &shared, ln.exp(), train)?;
                let found = centred.as_mut().and_then(|all| {
                    all.renew(&rows, &shared);
                    all.solve()
                });
                // A lag that needs implausible gains is not accepted.
                let found = found.filter(|c| problem.implausible(terms, c).is_none());
                let left = found.map_or(f64::INFINITY, |c| rows.rms_on(&c, &taken));
                Ok::<_, InputError>(left)
            };
            let middle = start_s[k].ln();
            let ln = smallest(middle - REACH, middle + REACH, left)?;
            rows.lag(problem, terms, &shared, ln.exp(), train)?;
            if let Some(all) = &mut centred {
                all.renew(&rows, &shared);
            }
            for j in &shared {
                lags_s[*j] = ln.exp();
            }
        }
    }
    Ok(lags_s)
}

/// Step in a lag's logarithm to either side, for the sum of squares' curvature.
const BESIDE: f64 = 0.05;

/// Half the 95 % interval of a lag's logarithm, from the sum of squares' curvature.
/// All other parameters are refitted at each lag; the number of values is that of independent ones. `None` if
/// it does not curve upwards.
fn lag_half_width(
    problem: &TermSelectionProblem,
    terms: &[Term],
    lags_s: &[f64],
    k: usize,
    train: &[&Record],
    response: &Role,
) -> Result<Option<f64>, InputError> {
    let left = |by: f64| {
        let mut tried = lags_s.to_vec();
        for j in shared(terms, k) {
            tried[j] *= by.exp();
        }
        let rows = LeastSquaresRows::with_lags(problem, terms, &tried, train, response)?;
        let n = rows.y.len();
        let of = |c: Vec<f64>| (0..n).map(|i| rows.residual(&c, i)).collect::<Vec<f64>>();
        Ok::<_, InputError>(rows.solve(&|_| true).map(of))
    };
    let (Some(below), Some(here), Some(above)) = (left(-BESIDE)?, left(0.0)?, left(BESIDE)?) else {
        return Ok(None);
    };
    let sum = |r: &[f64]| r.iter().map(|v| v * v).sum::<f64>();
    let curvature = (sum(&below) + sum(&above) - 2.0 * sum(&here)) / (BESIDE * BESIDE);
    let worth = independent(here.iter().copied());
    // Every coefficient, the constant and the lag itself use one of the independent values.
    let free = worth - terms.len() as f64 - 2.0;
    if curvature <= 0.0 || free < 1.0 {
        return Ok(None);
    }
    let variance = sum(&here) / free * 2.0 / curvature;
    Ok(Some(student(free) * variance.sqrt()))
}

/// The terms that share the k-th one's lag: itself and its difference's square.
fn shared(terms: &[Term], k: usize) -> Vec<usize> {
    (0..terms.len()).filter(|j| *j == k || squared(terms[k]) == Some(terms[*j])).collect()
}

/// The place of the minimum of a function that has one (golden section).
fn smallest(
    mut lo: f64,
    mut hi: f64,
    mut of: impl FnMut(f64) -> Result<f64, InputError>,
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

/// The intervals of every coefficient and every lag.
/// They come from leaving out each block in turn, with the lags fitted again.
pub(super) fn jackknife(
    problem: &TermSelectionProblem,
    terms: &[Term],
    train: &[&Record],
    response: &Role,
    full: &[f64],
) -> Result<JackknifeIntervals, InputError> {
    let start_s = lags_of(problem, terms);
    let (mut parts, mut lags): (Vec<Vec<f64>>, Vec<Vec<f64>>) = (Vec::new(), Vec::new());
    for f in 0..problem.folds {
        let lags_s = best_lags(problem, terms, &start_s, train, response, &|fold| fold != f)?;
        let rows = LeastSquaresRows::with_lags(problem, terms, &lags_s, train, response)?;
        if let Some(c) = rows.solve(&|i| rows.fold[i] != f) {
            parts.push(c);
            lags.push(lags_s);
        }
    }
    let of = |k: usize| jackknife_interval(full[k], &parts.iter().map(|p| p[k]).collect::<Vec<f64>>());
    let drawn = drawn(problem, terms, train, response)?;
    let mut tau_s = BTreeMap::new();
    let clocks = train.iter().filter_map(|r| shared_step(r.data(&Role::Time)?));
    let clock_s = clocks.fold(0.0, f64::max);
    for (k, term) in terms.iter().enumerate() {
        let Term::Thermal { lag: 1.., square: false, .. } = *term else { continue };
        let middle = start_s[k].ln();
        let [mut lo, mut hi] =
            jackknife_interval(middle, &lags.iter().map(|l| l[k].ln()).collect::<Vec<f64>>());
        if let Some(half) = lag_half_width(problem, terms, &start_s, k, train, response)? {
            (lo, hi) = (lo.min(middle - half), hi.max(middle + half));
        }
        [lo, hi] = drawn.allow_for(middle, [lo, hi], |(_, lags_s)| lags_s[k].ln());
        // A row's time is known within a coarse clock's step.
        tau_s.insert(k, [(lo.exp() - clock_s).max(0.0), hi.exp() + clock_s]);
    }
    let coefficients = (0..full.len()).map(|k| drawn.allow_for(full[k], of(k), |(c, _)| c[k])).collect();
    Ok(JackknifeIntervals { coefficients, squares: BTreeMap::new(), tau_s })
}

/// Coefficients and lags fitted to random draws of the true temperatures.
struct FitsToTemperatureDraws(Vec<(Vec<f64>, Vec<f64>)>);

fn drawn(
    problem: &TermSelectionProblem,
    terms: &[Term],
    train: &[&Record],
    response: &Role,
) -> Result<FitsToTemperatureDraws, InputError> {
    let start_s = lags_of(problem, terms);
    let mut found = Vec::new();
    let draws = if problem.spread.iter().all(SmoothingUncertainty::is_empty) { 0 } else { DRAWS };
    for n in 0..draws {
        let drawn: Vec<Record> = problem.spread.iter().zip(train).map(|(s, r)| s.draw(r, n)).collect();
        let drawn: Vec<&Record> = drawn.iter().collect();
        let lags_s = best_lags(problem, terms, &start_s, &drawn, response, &|_| true)?;
        let rows = LeastSquaresRows::with_lags(problem, terms, &lags_s, &drawn, response)?;
        found.extend(rows.solve(&|_| true).map(|c| (c, lags_s)));
    }
    Ok(FitsToTemperatureDraws(found))
}

impl FitsToTemperatureDraws {
    /// The interval of a value, including the uncertainty of its temperatures.
    fn allow_for(
        &self,
        value: f64,
        [lo, hi]: [f64; 2],
        of: impl Fn(&(Vec<f64>, Vec<f64>)) -> f64,
    ) -> [f64; 2] {
        let squares: f64 = self.0.iter().map(|d| (of(d) - value).powi(2)).sum();
        let more = NORMAL_95 * (squares / self.0.len().max(1) as f64).sqrt();
        [value - (value - lo).hypot(more), value + (hi - value).hypot(more)]
    }
}

impl JackknifeIntervals {
    /// A square that may be zero, by its index among the terms.
    /// Its interval contains zero, or it is not certain to predict unseen blocks better. The comparison is
    /// with the best lag without the square.
    pub(super) fn idle_square(
        &self,
        problem: &mut TermSelectionProblem,
        terms: &[Term],
        train: &[&Record],
        response: &Role,
        folds: &[usize],
    ) -> Result<Option<usize>, InputError> {
        for (k, term) in terms.iter().enumerate() {
            let Term::Thermal { square: true, .. } = term else { continue };
            let [lo, hi] = self.coefficients[k + 1];
            let mut rest = terms.to_vec();
            rest.remove(k);
            let rest = tuned(problem, rest, train, response)?;
            let certain = match (problem.judge(terms, folds), problem.judge(&rest, folds)) {
                (Some(bent), Some(plain)) => bent.is_certainly_bent(&plain),
                _ => true,
            };
            if (lo <= 0.0 && hi >= 0.0) || !certain {
                return Ok(Some(k));
            }
        }
        Ok(None)
    }

    /// The index of a growth that is the only one and may be zero.
    /// Its interval contains zero. Several similar growths may each be consistent with zero although together
    /// they are needed, so they are not considered.
    pub(super) fn alone_and_idle(&self, terms: &[Term]) -> Option<usize> {
        let mut growths = terms.iter().enumerate().filter(|(_, t)| matches!(t, Term::Thermal { .. }));
        let (Some((k, _)), None) = (growths.next(), growths.next()) else { return None };
        let [lo, hi] = self.coefficients[k + 1];
        (lo <= 0.0 && hi >= 0.0).then_some(k)
    }

    /// Widens intervals for squares that were left out.
    /// Leaving out a square was itself a choice from the data. The intervals of growth, lag and square cover
    /// the values with and without it.
    pub(super) fn allow_for_squares(
        &mut self,
        problem: &mut TermSelectionProblem,
        terms: &[Term],
        train: &[&Record],
        response: &Role,
    ) -> Result<(), InputError> {
        if !problem.square {
            return Ok(());
        }
        for (k, term) in terms.iter().enumerate() {
            let Some(square) = squared(*term) else { continue };
            if terms.contains(&square) {
                continue;
            }
            let other: Vec<Term> = terms.iter().copied().chain([square]).collect();
            let other = tuned(problem, other, train, response)?;
            let rows = LeastSquaresRows::new(problem, &other, train, response)?;
            let Some(c) = rows.solve(&|_| true) else { continue };
            let alternative = jackknife(problem, &other, train, response, &c)?;
            let hull = |a: &mut [f64; 2], b: [f64; 2]| *a = [a[0].min(b[0]), a[1].max(b[1])];
            hull(&mut self.coefficients[k + 1], alternative.coefficients[k + 1]);
            if let (Some(a), Some(b)) = (self.tau_s.get_mut(&k), alternative.tau_s.get(&k)) {
                hull(a, *b);
            }
            let mut own = alternative.coefficients[other.len()];
            hull(&mut own, [0.0; 2]);
            self.squares.insert(k, own);
        }
        Ok(())
    }
}
