//! Fits the sizes of given effects again.
//! It leaves rows out, or adds a curve for something without a name.

use crate::hypothesis_contribution::HypothesisContribution;
use crate::measurement_model::EstimationProblem;
use crate::priors::WIDE;
use crate::rows_and_noise::{MeasuredRows, ResponseNoise};
use rtec_least_squares::{QrFactor, add};
use rtec_model::effect::Effect;
use rtec_model::machine::NORMAL_95;
use rtec_model::record::Record;

/// The linear parameters of effects, in addition to model and set-up.
pub struct EffectSizeRefit<'p, 'r> {
    problem: &'p EstimationProblem<'r>,
    /// Columns of each effect, at one standard deviation.
    columns: Vec<Vec<Vec<f64>>>,
    effects: Vec<Effect>,
}

fn cause(effect: &Effect) -> HypothesisContribution {
    HypothesisContribution::Effect {
        effect: effect.clone(),
        free: effect.coefficient_count(),
        reference: false,
    }
}

impl<'p, 'r> EffectSizeRefit<'p, 'r> {
    /// A refit of these effects; their non-linear parameters stay as they are.
    #[must_use]
    pub fn new(problem: &'p EstimationProblem<'r>, effects: &[Effect]) -> Self {
        let columns = effects
            .iter()
            .map(|e| {
                let mut columns = cause(e).columns(problem.rows);
                columns.iter_mut().flatten().for_each(|x| *x *= WIDE);
                columns
            })
            .collect();
        Self { problem, columns, effects: effects.to_vec() }
    }

    fn factor(&self, noise: &ResponseNoise) -> (QrFactor, usize) {
        let base = self.problem.base(noise.clone());
        let from = base.factor.len();
        let mut factor = base.factor;
        for c in self.columns.iter().flatten() {
            let mut c = c.clone();
            noise.whiten(self.problem.rows, &mut c);
            factor.push(&c);
        }
        (factor, from)
    }

    /// The last effect, a curve, and the half widths of its values.
    /// If it acts `alone` they are about its mean, which the gauge's zero may have instead. `None` without effects.
    #[must_use]
    pub fn beside_set_up(&self, noise: &ResponseNoise, alone: bool) -> Option<(Effect, Vec<f64>)> {
        let (factor, from) = self.factor(noise);
        let effect = self.effects.last()?;
        let scale = cause(effect).coefficient_sizes(self.problem.rows);
        let k = scale.len();
        let before: usize = self.columns[..self.columns.len() - 1].iter().map(Vec::len).sum();
        let at = from + before;
        let mean = if alone { 1.0 / k as f64 } else { 0.0 };
        let (beta, inverse) = (factor.solve(), factor.inverse());
        let mut values = Vec::new();
        let mut half = Vec::new();
        for i in 0..k {
            let mut row = vec![0.0; inverse[at].len()];
            for j in 0..k {
                let share = f64::from(u8::from(i == j)) - mean;
                add(&mut row, share * WIDE * scale[j], &inverse[at + j]);
            }
            values.push(beta[at + i] * WIDE * scale[i]);
            half.push(NORMAL_95 * rtec_least_squares::dot(&row, &row).sqrt());
        }
        let mut out = effect.clone();
        out.set_coefficients(&values);
        Some((out, half))
    }

    /// Residual of each row under a fit of the record's other blocks.
    /// It is in the response's unit.
    #[must_use]
    pub fn left_by_others(&self, noise: &ResponseNoise, folds: usize) -> Vec<f64> {
        let rows = self.problem.rows;
        let mut out = vec![0.0; rows.n];
        for fold in 0..folds {
            let mut held = noise.clone();
            let mut own = Vec::new();
            for s in &rows.segments {
                let (n, blocks) = (s.rows.len(), 4 * folds);
                for b in (fold..blocks).step_by(folds) {
                    for row in s.rows.start + n * b / blocks..s.rows.start + n * (b + 1) / blocks {
                        held.weight[row] = 0.0;
                        own.push(row);
                    }
                }
            }
            let (factor, from) = self.factor(&held);
            let beta = factor.solve();
            let mut left = self.problem.missing.clone();
            for (t, b) in self.problem.terms.iter().zip(&beta) {
                add(&mut left, -b * t.sd, &t.column);
            }
            for (k, b) in self.problem.known.iter().zip(&beta[self.problem.terms.len()..from]) {
                add(&mut left, -b, &k.column);
            }
            for (c, b) in self.columns.iter().flatten().zip(&beta[from..]) {
                add(&mut left, -b, c);
            }
            for row in own {
                out[row] = left[row];
            }
        }
        out
    }
}

/// Residuals of a record once its set-up is removed, response by response.
#[must_use]
pub fn left(record: &Record, model: &[Effect]) -> Vec<Vec<f64>> {
    let records = std::slice::from_ref(record);
    let rows = MeasuredRows::new(records);
    let problem = EstimationProblem::new(&rows, model, &[]);
    let mut noise = problem.first_noise();
    noise.phi.fill(0.0);
    let problem = problem.by_hand();
    let mut factor = QrFactor::new(&{
        let mut y = problem.missing.clone();
        noise.whiten(&rows, &mut y);
        y
    });
    for t in &problem.terms {
        let mut c: Vec<f64> = t.column.iter().map(|x| x * t.sd).collect();
        noise.whiten(&rows, &mut c);
        factor.push(&c);
    }
    let mut left = problem.missing.clone();
    for (t, b) in problem.terms.iter().zip(factor.solve()) {
        add(&mut left, -b * t.sd, &t.column);
    }
    rows.segments.iter().map(|s| left[s.rows.clone()].to_vec()).collect()
}
