//! What some sensors say of another one, or of an error, learned from one run and asked of another.

use nalgebra::{DMatrix, DVector};
use rtec_model::record::Record;

/// What sensors of a record say of another one, or of an error.
pub(super) struct Told {
    constant: f64,
    slopes: DVector<f64>,
    /// Standard deviation of what is left where it was learned.
    pub(super) left: f64,
}

impl Told {
    pub(super) fn says(&self, record: &Record, rest: &[&str]) -> Vec<f64> {
        let columns: Vec<&[f64]> = rest.iter().filter_map(|n| record.temperature(n)).collect();
        let of = |i: usize| {
            self.constant + columns.iter().zip(self.slopes.iter()).map(|(c, s)| s * c[i]).sum::<f64>()
        };
        (0..record.rows()).map(of).collect()
    }
}

pub(super) fn told(record: &Record, y: &[f64], rest: &[&str]) -> Option<Told> {
    let columns: Vec<&[f64]> = rest.iter().filter_map(|n| record.temperature(n)).collect();
    let n = y.len() as f64;
    let mean = |v: &[f64]| v.iter().sum::<f64>() / n;
    let means: Vec<f64> = columns.iter().map(|c| mean(c)).collect();
    let a = DMatrix::from_fn(y.len(), columns.len(), |i, j| columns[j][i] - means[j]);
    let my = mean(y);
    let b = DVector::from_fn(y.len(), |i, _| y[i] - my);
    // A touch of ridge: sensors that warm together share their part rather than fight over it.
    let mut g = a.tr_mul(&a);
    let ridge = 1e-4 * g.trace() / columns.len().max(1) as f64 + 1e-9;
    (0..columns.len()).for_each(|k| g[(k, k)] += ridge);
    let slopes = g.cholesky()?.solve(&a.tr_mul(&b));
    let left = ((&b - &a * &slopes).norm_squared() / n).sqrt();
    let constant = my - slopes.iter().zip(&means).map(|(s, m)| s * m).sum::<f64>();
    Some(Told { constant, slopes, left })
}
