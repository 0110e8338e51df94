//! The one least-squares core: orthogonal factors of columns under Gaussian priors, grown column by column.
//!
//! Columns come scaled by the standard deviation of their coefficients, so that each coefficient has a prior of unit size. The
//! prior is a row below the data: [X; I] = Q R with orthonormal Q, by Gram–Schmidt applied twice (which is as stable as
//! Householder's reflections; Giraud, Langou, Rozložník 2005). No Gram matrix of the data is formed.

/// Orthogonal factors of a growing set of columns, and what they leave of a response.
#[derive(Debug, Clone)]
pub struct Factor {
    /// Upper parts (data rows) of the orthonormal columns.
    upper: Vec<Vec<f64>>,
    /// Lower parts (prior rows): column k has k + 1 entries.
    lower: Vec<Vec<f64>>,
    /// Columns of the triangle R.
    triangle: Vec<Vec<f64>>,
    /// Products of the orthonormal columns with the response.
    along: Vec<f64>,
    /// What is left of the response: C⁻¹y, C = I + `XXᵀ`.
    residual: Vec<f64>,
    /// The same of the prior rows.
    pulled: Vec<f64>,
    /// yᵀC⁻¹y.
    left: f64,
    /// ½ log |I + `XᵀX`|.
    half_log_det: f64,
}

/// Σ aᵢbᵢ, in running sums.
#[must_use]
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma") {
        // SAFETY: the processor has both.
        return unsafe { dot_wide(a, b) };
    }
    dot_by::<8>(a, b, |s, x, y| s + x * y)
}

/// [`dot`] for processors with wide registers.
///
/// # Safety
/// The processor has AVX2 and FMA.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
unsafe fn dot_wide(a: &[f64], b: &[f64]) -> f64 {
    dot_by::<16>(a, b, |s, x, y| x.mul_add(y, s))
}

#[inline]
fn dot_by<const N: usize>(a: &[f64], b: &[f64], step: impl Fn(f64, f64, f64) -> f64) -> f64 {
    let mut sums = [0.0; N];
    let (wide_a, wide_b) = (a.chunks_exact(N), b.chunks_exact(N));
    let rest: f64 = wide_a.remainder().iter().zip(wide_b.remainder()).map(|(x, y)| x * y).sum();
    for (x, y) in wide_a.zip(wide_b) {
        for i in 0..N {
            sums[i] = step(sums[i], x[i], y[i]);
        }
    }
    sums.iter().sum::<f64>() + rest
}

/// a += k·b.
pub fn add(a: &mut [f64], k: f64, b: &[f64]) {
    a.iter_mut().zip(b).for_each(|(a, b)| *a += k * b);
}

impl Factor {
    /// No columns yet.
    #[must_use]
    pub fn new(response: &[f64]) -> Self {
        Self {
            upper: Vec::new(),
            lower: Vec::new(),
            triangle: Vec::new(),
            along: Vec::new(),
            residual: response.to_vec(),
            pulled: Vec::new(),
            left: dot(response, response),
            half_log_det: 0.0,
        }
    }

    /// Number of columns.
    #[must_use]
    pub fn len(&self) -> usize {
        self.upper.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.upper.is_empty()
    }

    /// The orthonormal columns' data rows.
    #[must_use]
    pub fn columns(&self) -> &[Vec<f64>] {
        &self.upper
    }

    /// Products of the orthonormal columns with what the ones before them left of the response.
    #[must_use]
    pub fn along(&self) -> &[f64] {
        &self.along
    }

    /// C⁻¹y: what is left of the response.
    #[must_use]
    pub fn residual(&self) -> &[f64] {
        &self.residual
    }

    /// yᵀC⁻¹y.
    #[must_use]
    pub fn left(&self) -> f64 {
        self.left
    }

    /// ½ log |I + `XᵀX`|.
    #[must_use]
    pub fn half_log_det(&self) -> f64 {
        self.half_log_det
    }

    /// Number of coefficients that the data determine, each by how much narrower than its prior it is.
    #[must_use]
    pub fn freedom(&self) -> f64 {
        let inverse = self.inverse();
        let prior: f64 = inverse.iter().map(|row| dot(row, row)).sum();
        (self.len() as f64 - prior).max(0.0)
    }

    /// One more column, scaled by the standard deviation of its coefficient.
    pub fn push(&mut self, column: &[f64]) {
        let k = self.len();
        let mut up = column.to_vec();
        let mut low = vec![0.0; k + 1];
        low[k] = 1.0;
        let mut r = vec![0.0; k + 1];
        for pass in 0..2 {
            for i in 0..k {
                let q = &self.upper[i];
                let mut c = dot(q, &up);
                if pass == 1 {
                    c += dot(&self.lower[i], &low[..=i]);
                }
                add(&mut up, -c, q);
                add(&mut low[..=i], -c, &self.lower[i]);
                r[i] += c;
            }
        }
        let size = (dot(&up, &up) + dot(&low, &low)).sqrt();
        for x in &mut up {
            *x /= size;
        }
        for x in &mut low {
            *x /= size;
        }
        r[k] = size;
        self.pulled.push(0.0);
        let along = dot(&up, &self.residual) + dot(&low, &self.pulled);
        add(&mut self.residual, -along, &up);
        add(&mut self.pulled, -along, &low);
        self.left -= along * along;
        self.half_log_det += size.ln();
        self.upper.push(up);
        self.lower.push(low);
        self.triangle.push(r);
        self.along.push(along);
    }

    /// The coefficients' posterior means, in prior standard deviations.
    #[must_use]
    pub fn solve(&self) -> Vec<f64> {
        let k = self.len();
        let mut x = self.along.clone();
        for i in (0..k).rev() {
            x[i] /= self.triangle[i][i];
            let xi = x[i];
            for (j, r) in self.triangle[i][..i].iter().enumerate() {
                x[j] -= r * xi;
            }
        }
        x
    }

    /// Rows of R⁻¹: the posterior covariance is R⁻¹R⁻ᵀ.
    #[must_use]
    pub fn inverse(&self) -> Vec<Vec<f64>> {
        let k = self.len();
        let mut rows = vec![vec![0.0; k]; k];
        for column in 0..k {
            // R x = e_column, from below.
            let mut x = vec![0.0; column + 1];
            x[column] = 1.0;
            for i in (0..=column).rev() {
                x[i] /= self.triangle[i][i];
                let xi = x[i];
                for (j, r) in self.triangle[i][..i].iter().enumerate() {
                    x[j] -= r * xi;
                }
            }
            for (i, v) in x.into_iter().enumerate() {
                rows[i][column] = v;
            }
        }
        rows
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};

    /// Against the normal equations of another library, where these are good enough.
    #[test]
    fn agrees_with_ridge_regression() {
        let n = 40;
        let x = |i: usize, j: usize| ((i * (j + 2) + 3 * j) as f64 * 0.37).sin() * (1.0 + j as f64);
        let y: Vec<f64> = (0..n).map(|i| (i as f64 * 0.2).cos() * 3.0).collect();
        let mut factor = Factor::new(&y);
        for j in 0..5 {
            factor.push(&(0..n).map(|i| x(i, j)).collect::<Vec<_>>());
        }
        let m = DMatrix::from_fn(n, 5, x);
        let a = m.transpose() * &m + DMatrix::identity(5, 5);
        let b = m.transpose() * DVector::from_column_slice(&y);
        let beta = a.clone().lu().solve(&b).unwrap();
        let inverse = a.clone().try_inverse().unwrap();
        let rows = factor.inverse();
        for i in 0..5 {
            assert!((factor.solve()[i] - beta[i]).abs() < 1e-10);
            assert!((dot(&rows[i], &rows[i]) - inverse[(i, i)]).abs() < 1e-10);
        }
        assert!((2.0 * factor.half_log_det() - a.determinant().ln()).abs() < 1e-9);
        let left = dot(&y, &y) - b.dot(&beta);
        assert!((factor.left() - left).abs() < 1e-9 && factor.residual().len() == n);
    }

    /// Columns that are nearly the same leave nothing undefined.
    #[test]
    fn survives_equal_columns() {
        let y: Vec<f64> = (0..30).map(f64::from).collect();
        let mut factor = Factor::new(&y);
        for _ in 0..3 {
            factor.push(&y.iter().map(|v| 1e6 * v).collect::<Vec<_>>());
        }
        assert!(factor.solve().iter().all(|b| b.is_finite()) && factor.left() >= 0.0);
    }
}
