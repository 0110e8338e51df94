//! A structure judged by blocked cross-validation in time.

use super::problem::Problem;
use super::term::Term;
use nalgebra::{DMatrix, DVector};
use rtec_measure::iso230::correlation;

/// A structure with its cross-validation.
#[derive(Debug, Clone)]
pub(super) struct Judged {
    pub(super) terms: Vec<Term>,
    /// Mean square per fold.
    pub(super) mse: Vec<f64>,
    pub(super) r: f64,
    /// Constant, then one coefficient per term.
    pub(super) coefficients: Vec<f64>,
    /// Mean square of what the fit leaves on its own data, as a share of the response's variance.
    left: f64,
    /// How many independent values what it leaves is worth: neighbours in time share their noise.
    independent: f64,
}

/// What a chance improvement reaches once in some thousand times, as twice the logarithm of the likelihood.
const CHANCE: f64 = 9.0;

/// The same for one column that needs no choice, while a structure is looked for: once in twenty times.
const BENT: f64 = 4.0;

/// A square stands in the model beyond this: three standard errors.
const CERTAIN: f64 = 9.0;

impl Judged {
    /// Root of the mean over the folds.
    pub(super) fn rms(&self) -> f64 {
        (self.mse.iter().sum::<f64>() / self.mse.len() as f64).sqrt()
    }

    /// This one is better than `other` by more than the standard error of the difference over the folds.
    pub(super) fn beats(&self, other: &Self) -> bool {
        let d: Vec<f64> = other.mse.iter().zip(&self.mse).map(|(o, s)| o - s).collect();
        let n = d.len() as f64;
        let mean = d.iter().sum::<f64>() / n;
        let var = d.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
        mean > (var / n).sqrt()
    }

    /// This one, with more in it, earns what it has beyond `simpler`: blocks that it has not seen are better off, and what
    /// it explains is more than the best of so many chance columns would, noise being alike from row to row.
    pub(super) fn earns(&self, simpler: &Self, choices: usize) -> bool {
        self.beyond_chance(simpler, choices) && self.beats(simpler)
    }

    /// Twice the logarithm of the likelihood that this one has more than `simpler`, with as many values as are independent.
    pub(super) fn gain_over(&self, simpler: &Self) -> f64 {
        self.independent * (simpler.left.max(1e-12) / self.left.max(1e-12)).ln()
    }

    /// This one, with the square of a difference that `simpler` has without, earns it: equation 1 has the square of every
    /// difference, so that there is no choice to allow for.
    pub(super) fn is_bent(&self, simpler: &Self) -> bool {
        self.gain_over(simpler) > BENT && self.rms() < simpler.rms()
    }

    /// The same, certain enough to stand in the model.
    pub(super) fn is_certainly_bent(&self, simpler: &Self) -> bool {
        self.is_bent(simpler) && self.gain_over(simpler) > CERTAIN
    }

    /// The same, where unseen blocks need only be better off on the whole: beside the mean, which a machine that stood most
    /// of the time leaves little in most blocks.
    pub(super) fn beyond_chance(&self, simpler: &Self, choices: usize) -> bool {
        // Every term more was a choice; a square was none.
        let chosen =
            |j: &Self| j.terms.iter().filter(|t| !matches!(t, Term::Thermal { square: true, .. })).count();
        let more = chosen(self).saturating_sub(chosen(simpler)).max(1) as f64;
        self.gain_over(simpler) > CHANCE + 2.0 * more * (choices.max(1) as f64).ln()
            && self.rms() < simpler.rms()
    }
}

/// How many independent values a series is worth for a slow cause: by its correlation from one to the next.
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

impl Problem {
    /// Fits the terms on the given folds and judges them by leaving out each in turn; `None` when the columns are
    /// dependent.
    pub(super) fn judge(&self, terms: &[Term], folds: &[usize]) -> Option<Judged> {
        let columns: Vec<Vec<f64>> = terms.iter().map(|t| self.column(*t)).collect();
        self.judge_columns(terms, &columns, folds)
    }

    pub(super) fn judge_columns(
        &self,
        terms: &[Term],
        columns: &[Vec<f64>],
        folds: &[usize],
    ) -> Option<Judged> {
        let p = columns.len() + 2;
        let rows: Vec<usize> = (0..self.y.len()).filter(|i| folds.contains(&self.fold[*i])).collect();
        let total: f64 = rows.iter().map(|i| self.weight[*i]).sum();
        let (mean, scale) = self.standard(columns, &rows, total)?;
        let mut grams = self.grams(columns, &rows, &mean, &scale);
        let mut all = DMatrix::<f64>::zeros(p, p);
        for g in &mut grams {
            g.fill_lower_triangle_with_upper_triangle();
            all += &*g;
        }
        let solve = |g: &DMatrix<f64>| {
            let c = g.view((0, 0), (p - 1, p - 1)).into_owned().cholesky()?;
            // Columns that are nearly one another leave a diagonal near zero.
            let least = c.l_dirty().diagonal().iter().map(|d| d * d).fold(f64::INFINITY, f64::min);
            (least > 1e-7 * g[(0, 0)]).then(|| c.solve(&g.view((0, p - 1), (p - 1, 1)).into_owned()))
        };
        let rss = |g: &DMatrix<f64>, c: &DMatrix<f64>| {
            let mut v = DVector::from_element(p, -1.0);
            v.rows_mut(0, p - 1).copy_from(&c.column(0));
            (v.transpose() * g * &v)[(0, 0)].max(0.0) * scale[p - 1] * scale[p - 1]
        };
        let fit = solve(&all)?;
        let mut mse = Vec::with_capacity(folds.len());
        for f in folds {
            let c = solve(&(&all - &grams[*f]))?;
            mse.push(rss(&grams[*f], &c) / grams[*f][(0, 0)].max(1e-300));
        }
        let left = rss(&all, &fit) / (total * scale[p - 1] * scale[p - 1]);
        let mut coefficients: Vec<f64> = (0..p - 1).map(|j| fit[(j, 0)] * scale[p - 1] / scale[j]).collect();
        coefficients[0] = mean[p - 1] + fit[(0, 0)] * scale[p - 1]
            - (1..p - 1).map(|j| coefficients[j] * mean[j]).sum::<f64>();
        let residual = |i: usize| {
            self.y[i]
                - coefficients[0]
                - columns.iter().zip(&coefficients[1..]).map(|(u, c)| c * u[i]).sum::<f64>()
        };
        let independent = independent(rows.iter().map(|i| residual(*i))).max(folds.len() as f64);
        let r = (1.0 - left).max(0.0).sqrt();
        Some(Judged { terms: terms.to_vec(), mse, r, coefficients, left, independent })
    }

    /// Mean and scale of the constant, of every column and of the response: with means taken off and scales made one, the
    /// normal equations keep their digits. `None` where one does not vary.
    fn standard(&self, columns: &[Vec<f64>], rows: &[usize], total: f64) -> Option<(Vec<f64>, Vec<f64>)> {
        let p = columns.len() + 2;
        let mut mean = vec![0.0; p];
        let mut scale = vec![1.0; p];
        for j in 1..p {
            let v = if j + 1 == p { &self.y } else { &columns[j - 1] };
            mean[j] = rows.iter().map(|i| self.weight[*i] * v[*i]).sum::<f64>() / total;
            let var = rows.iter().map(|i| self.weight[*i] * (v[*i] - mean[j]).powi(2)).sum::<f64>() / total;
            if var <= 1e-18 {
                return None;
            }
            scale[j] = var.sqrt();
        }
        Some((mean, scale))
    }

    /// Per fold, the upper triangle of the products of constant, columns and response over its rows.
    fn grams(&self, columns: &[Vec<f64>], rows: &[usize], mean: &[f64], scale: &[f64]) -> Vec<DMatrix<f64>> {
        let p = columns.len() + 2;
        let mut grams = vec![DMatrix::<f64>::zeros(p, p); self.folds];
        let mut row = vec![1.0; p];
        for &i in rows {
            for j in 1..p {
                let v = if j + 1 == p { self.y[i] } else { columns[j - 1][i] };
                row[j] = (v - mean[j]) / scale[j];
            }
            let g = &mut grams[self.fold[i]];
            for a in 0..p {
                for b in a..p {
                    g[(a, b)] += self.weight[i] * row[a] * row[b];
                }
            }
        }
        grams
    }

    pub(super) fn gamma(&self, term: Term, folds: &[usize]) -> f64 {
        let u = self.column(term);
        let rows = (0..u.len()).filter(|i| folds.contains(&self.fold[*i]));
        let (x, y): (Vec<f64>, Vec<f64>) = rows.map(|i| (u[i], self.y[i])).unzip();
        correlation(&x, &y)
    }

    /// Differences to the environment keep the sign of their own correlation: the sign is known, and a fit that
    /// turns it round lives on collinearity, as one with gains beyond reason does.
    pub(super) fn physical(&self, judged: &Judged, folds: &[usize]) -> bool {
        judged.terms.iter().zip(&judged.coefficients[1..]).all(|(t, c)| match t {
            Term::Thermal { square: true, .. } => c.abs() <= self.plausible[1],
            Term::Thermal { minus, .. } => {
                c.abs() <= self.plausible[0]
                    && (*minus != self.environment || self.gamma(*t, folds) * c >= 0.0)
            }
            _ => true,
        })
    }
}
