//! Columns, projections and lengths.

/// Orthonormal basis of the columns in a fit.
#[derive(Clone, Default)]
pub struct Basis(pub(crate) Vec<Vec<f64>>);

impl Basis {
    /// The part of a column that is orthogonal to the basis.
    pub(crate) fn rest(&self, column: &[f64]) -> Vec<f64> {
        let mut c = column.to_vec();
        for q in &self.0 {
            let d: f64 = q.iter().zip(&c).map(|(a, b)| a * b).sum();
            c.iter_mut().zip(q).for_each(|(c, q)| *c -= d * q);
        }
        c
    }

    /// Adds a column; returns false where the basis contains it already.
    pub(crate) fn add(&mut self, column: &[f64]) -> bool {
        let before = length(column);
        let mut c = self.rest(column);
        c = self.rest(&c);
        let l = length(&c);
        if l <= 1e-6 * before || l == 0.0 {
            return false;
        }
        c.iter_mut().for_each(|x| *x /= l);
        self.0.push(c);
        true
    }
}

pub(crate) fn length(x: &[f64]) -> f64 {
    x.iter().map(|v| v * v).sum::<f64>().sqrt()
}

pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut lanes = [0.0; 8];
    let (ca, cb) = (a.chunks_exact(8), b.chunks_exact(8));
    let tail: f64 = ca.remainder().iter().zip(cb.remainder()).map(|(x, y)| x * y).sum();
    for (x, y) in ca.zip(cb) {
        for k in 0..8 {
            lanes[k] += x[k] * y[k];
        }
    }
    lanes.iter().sum::<f64>() + tail
}
