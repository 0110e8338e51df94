//! Factors of symmetric matrices with two bands beside the diagonal.
//! Smooth series have such matrices.

/// `LDLᵀ` factor of a positive definite matrix with two bands beside the diagonal.
#[derive(Debug, Clone)]
pub struct BandedFactor {
    d: Vec<f64>,
    one: Vec<f64>,
    two: Vec<f64>,
    log_determinant: f64,
}

impl BandedFactor {
    /// Factors the matrix with this diagonal, and the first and second band below it.
    /// All have the matrix's length: `one[i]` is in row i and column i − 1, `two[i]` in column i − 2.
    pub fn new(mut d: Vec<f64>, mut one: Vec<f64>, mut two: Vec<f64>) -> Self {
        let n = d.len();
        let mut log_determinant = 0.0;
        for i in 0..n {
            if i >= 2 {
                two[i] /= d[i - 2];
                one[i] -= two[i] * one[i - 1] * d[i - 2];
                d[i] -= two[i] * two[i] * d[i - 2];
            }
            if i >= 1 {
                one[i] /= d[i - 1];
                d[i] -= one[i] * one[i] * d[i - 1];
            }
            log_determinant += d[i].ln();
        }
        Self { d, one, two, log_determinant }
    }

    /// The logarithm of the matrix's determinant.
    pub fn log_determinant(&self) -> f64 {
        self.log_determinant
    }

    /// The solution for this right-hand side.
    pub fn solve(&self, mut x: Vec<f64>) -> Vec<f64> {
        for i in 0..x.len() {
            if i >= 2 {
                x[i] -= self.two[i] * x[i - 2];
            }
            if i >= 1 {
                x[i] -= self.one[i] * x[i - 1];
            }
        }
        x.iter_mut().zip(&self.d).for_each(|(x, d)| *x /= d);
        self.back(x)
    }

    /// Solves for Lᵀ.
    fn back(&self, mut x: Vec<f64>) -> Vec<f64> {
        let n = x.len();
        for i in (0..n).rev() {
            if i + 1 < n {
                x[i] -= self.one[i + 1] * x[i + 1];
            }
            if i + 2 < n {
                x[i] -= self.two[i + 2] * x[i + 2];
            }
        }
        x
    }

    /// Correlated errors whose precision is this matrix.
    /// They are made of independent standard normal numbers.
    pub fn with_this_precision(&self, mut normal: impl FnMut() -> f64) -> Vec<f64> {
        let white = self.d.iter().map(|d| normal() / d.sqrt()).collect();
        self.back(white)
    }
}

#[cfg(all(test, feature = "matrices"))]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};

    #[test]
    fn solves_as_the_whole_matrix_does() {
        let n = 7;
        let band = |from: usize, scale: f64| {
            (0..n).map(|i| if i < from { 0.0 } else { scale * (1.3 * i as f64).sin() }).collect::<Vec<f64>>()
        };
        let (d, one, two) = (vec![4.0; n], band(1, 1.0), band(2, 0.7));
        let whole = DMatrix::from_fn(n, n, |i, j| match i.abs_diff(j) {
            0 => d[i],
            1 => one[i.max(j)],
            2 => two[i.max(j)],
            _ => 0.0,
        });
        let factor = BandedFactor::new(d, one, two);
        let y: Vec<f64> = (0..n).map(|i| (0.7 * i as f64).cos()).collect();
        let inverse = whole.clone().try_inverse().unwrap();
        let x = &inverse * DVector::from_column_slice(&y);
        factor.solve(y).iter().zip(x.iter()).for_each(|(a, b)| assert!((a - b).abs() < 1e-12));
        assert!((factor.log_determinant() - whole.determinant().ln()).abs() < 1e-12);
        // The covariance of the errors is the inverse: one error for each unit vector.
        let errors: Vec<Vec<f64>> = (0..n)
            .map(|k| {
                let mut i = 0;
                factor.with_this_precision(|| {
                    i += 1;
                    f64::from(u8::from(i == k + 1))
                })
            })
            .collect();
        for i in 0..n {
            for j in 0..n {
                let covariance: f64 = errors.iter().map(|e| e[i] * e[j]).sum();
                assert!((covariance - inverse[(i, j)]).abs() < 1e-12);
            }
        }
    }
}
