//! The 95 % prediction interval.
//! It combines what the fit cannot know in a row with the residuals of unseen blocks.

use super::fit_candidates::TermSelectionProblem;
use super::least_squares_rows::LeastSquaresRows;
use super::term::{Term, unlagged};
use crate::statistics::{mean_square, quantile, rms};
use rtec_files::InputError;
use rtec_model::machine::{ValidTemperatureRange, unknown_um};
use rtec_model::record::{Record, Role, span};

/// Largest used excess of a difference over its seen range, as a share of it.
/// Further out it is held at the bound.
const BEYOND: f64 = 0.1;

/// The bounds of a difference in a fit, beyond which less is known.
pub(super) struct TemperatureDifferenceBounds {
    /// Indices of the difference's column, and of its square's.
    pub(super) term: usize,
    pub(super) square: Option<usize>,
    /// The range beyond which the difference is held, K.
    pub(super) range_k: [f64; 2],
    /// RMS of the lagged difference minus the difference itself, K.
    /// It is the uncertainty at a start.
    pub(super) start_k: f64,
    pub(super) tau_s: f64,
}

impl LeastSquaresRows {
    /// Bounds of a fit's differences on the rows that `take` selects.
    /// `plain` has the same terms without lag.
    pub(super) fn guards(
        &self,
        problem: &TermSelectionProblem,
        terms: &[Term],
        plain: &Self,
        take: &dyn Fn(usize) -> bool,
    ) -> Vec<TemperatureDifferenceBounds> {
        let mut found = Vec::new();
        for (k, term) in terms.iter().enumerate() {
            let Term::Thermal { sensor, minus, lag, square: false } = *term else { continue };
            let square = terms.iter().position(|t| *t == Term::Thermal { sensor, minus, lag, square: true });
            let (mut lo, mut hi, mut late, mut n) = (f64::INFINITY, f64::NEG_INFINITY, 0.0, 0.0);
            for i in (0..self.y.len()).filter(|i| take(*i)) {
                let v = self.columns[k][i];
                (lo, hi) = (lo.min(v), hi.max(v));
                late += (v - plain.columns[k][i]).powi(2);
                n += 1.0;
            }
            let margin = BEYOND * (hi - lo);
            found.push(TemperatureDifferenceBounds {
                term: k,
                square,
                range_k: [lo - margin, hi + margin],
                start_k: (late / f64::max(n, 1.0)).sqrt(),
                tau_s: problem.taus[lag],
            });
        }
        found
    }

    /// The prediction of a row with its differences in range, and its interval's x.
    fn held(&self, c: &[f64], guards: &[TemperatureDifferenceBounds], i: usize) -> (f64, f64) {
        let mut says = c[0] + self.columns.iter().zip(&c[1..]).map(|(u, c)| c * u[i]).sum::<f64>();
        let mut x2 = 0.0;
        for g in guards {
            let asked = self.columns[g.term][i];
            let held = asked.clamp(g.range_k[0], g.range_k[1]);
            let gain = c[g.term + 1];
            let bend = g.square.map_or(0.0, |k| c[k + 1]);
            says += gain * (held - asked) + bend * (held * held - asked * asked);
            x2 += unknown_um(gain, bend, asked, held, g.start_k, g.tau_s, self.elapsed_s[i]).powi(2);
        }
        (says, x2.sqrt())
    }
}

/// Every offered difference as measured, chosen or not.
/// If one leaves the range that the fit has seen, the machine is in an unknown state, whatever the chosen
/// differences show.
pub(super) struct OfferedTemperatureDifferences {
    rows: LeastSquaresRows,
    offered: Vec<Term>,
}

impl OfferedTemperatureDifferences {
    pub(super) fn new(
        problem: &TermSelectionProblem,
        train: &[&Record],
        response: &Role,
    ) -> Result<Self, InputError> {
        let offered: Vec<Term> = problem.offered.iter().map(|pair| Term::plain(*pair)).collect();
        Ok(Self { rows: LeastSquaresRows::new(problem, &offered, train, response)?, offered })
    }

    /// The range of each difference, and how much the response moved with it.
    /// It uses the rows that `take` selects. The movement is a ratio of standard deviations, because noise
    /// shrinks a slope but not that ratio.
    pub(super) fn ranges(
        &self,
        problem: &TermSelectionProblem,
        take: &dyn Fn(usize) -> bool,
    ) -> Vec<ValidTemperatureRange> {
        let rows: Vec<usize> = (0..self.rows.y.len()).filter(|i| take(*i)).collect();
        let sd = |v: &[f64]| {
            let m = rows.iter().map(|i| v[*i]).sum::<f64>() / rows.len() as f64;
            (rows.iter().map(|i| (v[*i] - m).powi(2)).sum::<f64>() / rows.len() as f64).sqrt()
        };
        let y = sd(&self.rows.y);
        let of = |(term, u): (&Term, &Vec<f64>)| {
            let Term::Thermal { sensor, minus, .. } = *term else {
                unreachable!("only differences are watched")
            };
            let [lo, hi] = span(rows.iter().map(|i| u[*i]));
            let margin = BEYOND * (hi - lo);
            let difference = problem.difference((sensor, minus));
            let um_per_k = (y / sd(u).max(1e-9)).min(problem.plausible[0]);
            ValidTemperatureRange { difference, range_k: [lo - margin, hi + margin], um_per_k }
        };
        self.offered.iter().zip(&self.rows.columns).map(of).collect()
    }

    /// Possible error at a row from differences outside their ranges, µm.
    pub(super) fn outside_um(&self, ranges: &[ValidTemperatureRange], i: usize) -> f64 {
        ranges.iter().zip(&self.rows.columns).map(|(r, u)| r.outside_um(u[i])).fold(0.0, f64::max)
    }
}

/// The result of nested cross-validation.
/// Structure and parameters are chosen without the block they are judged on.
pub(super) struct NestedCrossValidation {
    pub(super) folds: Vec<f64>,
    pub(super) half_width_um: f64,
    pub(super) coverage: f64,
}

impl NestedCrossValidation {
    /// Mean square over the blocks.
    pub(super) fn mean_square(&self) -> f64 {
        mean_square(&self.folds)
    }
}

/// The same without any term: only the constant.
pub(super) fn mean_only(
    problem: &TermSelectionProblem,
    train: &[&Record],
    response: &Role,
) -> Result<NestedCrossValidation, InputError> {
    let found = blocks(problem, train, response, &|_| Some(Vec::new()))?;
    found.ok_or_else(|| InputError::whole(&train[0].path, "no rows", "rows in every block"))
}

pub(super) fn nested(
    problem: &TermSelectionProblem,
    train: &[&Record],
    response: &Role,
) -> Result<Option<NestedCrossValidation>, InputError> {
    blocks(problem, train, response, &|others| Some(problem.select(others)?.structure.terms))
}

fn blocks(
    problem: &TermSelectionProblem,
    train: &[&Record],
    response: &Role,
    choose: &dyn Fn(&[usize]) -> Option<Vec<Term>>,
) -> Result<Option<NestedCrossValidation>, InputError> {
    let mut folds = Vec::new();
    // Per fold: the residual of every row, and x of its interval.
    let mut left: Vec<Vec<(f64, f64)>> = Vec::new();
    let watched = OfferedTemperatureDifferences::new(problem, train, response)?;
    for f in 0..problem.folds {
        let others: Vec<usize> = (0..problem.folds).filter(|o| *o != f).collect();
        let Some(terms) = choose(&others) else { return Ok(None) };
        let Some(own) = unseen(problem, &terms, train, response, &watched, &|g| g == f)? else {
            return Ok(None);
        };
        folds.push(rms(own.iter().map(|l| l.0)));
        left.push(own);
    }
    // h is such that 95 % of a block's rows are within √(h² + x²), in the worst block. Neighbouring rows
    // share their error, so a new stretch of time counts as one more block, not as a thousand more rows. Of n
    // + 1 blocks, n are no worse than the worst of n.
    let of_block = |rows: &Vec<(f64, f64)>| {
        quantile(rows.iter().map(|(r, x)| (r * r - x * x).max(0.0).sqrt()).collect(), 0.95)
    };
    let widths: Vec<f64> = left.iter().map(of_block).collect();
    let width_without = |f: Option<usize>| {
        widths.iter().enumerate().filter(|(g, _)| Some(*g) != f).map(|(_, w)| *w).fold(0.0, f64::max)
    };
    let inside = |(f, own): (usize, &Vec<(f64, f64)>)| {
        let h = width_without(Some(f));
        own.iter().filter(|(r, x)| r.abs() <= h.hypot(*x)).count()
    };
    let all: usize = left.iter().map(Vec::len).sum();
    let coverage = left.iter().enumerate().map(inside).sum::<usize>() as f64 / all as f64;
    Ok(Some(NestedCrossValidation { folds, half_width_um: width_without(None), coverage }))
}

/// Share of one half's rows inside this half width under a fit on the other half.
/// Model and terms are chosen on that other half; both directions are given. It shows how reliable the
/// interval is in states that the fit has not seen.
pub(super) fn halves(
    problem: &TermSelectionProblem,
    train: &[&Record],
    response: &Role,
    half_width_um: f64,
) -> Result<Option<[f64; 2]>, InputError> {
    let watched = OfferedTemperatureDifferences::new(problem, train, response)?;
    let middle = problem.folds / 2;
    let mut held = [0.0; 2];
    for (held, later) in held.iter_mut().zip([true, false]) {
        let asked = |f: usize| (f >= middle) == later;
        let known: Vec<usize> = (0..problem.folds).filter(|f| !asked(*f)).collect();
        let Some(terms) = problem.select(&known).map(|c| c.structure.terms) else { return Ok(None) };
        let Some(left) = unseen(problem, &terms, train, response, &watched, &asked)? else { return Ok(None) };
        let inside = left.iter().filter(|(r, x)| r.abs() <= half_width_um.hypot(*x)).count();
        *held = inside as f64 / left.len().max(1) as f64;
    }
    Ok(Some(held))
}

/// Residuals of the `asked` blocks under a fit without them, and the interval's x.
fn unseen(
    problem: &TermSelectionProblem,
    terms: &[Term],
    train: &[&Record],
    response: &Role,
    watched: &OfferedTemperatureDifferences,
    asked: &dyn Fn(usize) -> bool,
) -> Result<Option<Vec<(f64, f64)>>, InputError> {
    let rows = LeastSquaresRows::new(problem, terms, train, response)?;
    let plain = LeastSquaresRows::new(problem, &unlagged(terms), train, response)?;
    let Some(c) = rows.solve(&|i| !asked(rows.fold[i])) else { return Ok(None) };
    let guards = rows.guards(problem, terms, &plain, &|i| !asked(rows.fold[i]));
    let ranges = watched.ranges(problem, &|i| !asked(rows.fold[i]));
    let of = |i: usize| {
        let (says, x) = rows.held(&c, &guards, i);
        (rows.y[i] - says, x.hypot(watched.outside_um(&ranges, i)))
    };
    Ok(Some((0..rows.y.len()).filter(|i| asked(rows.fold[*i])).map(of).collect()))
}
