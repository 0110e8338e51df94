//! Orthogonal factors of columns, grown column by column.
//!
//! Columns are scaled by the standard deviation of their coefficients, so that each coefficient has a prior of unit size. The prior is a
//! row below the data: [X; I] = Q R with orthonormal Q. A free column has no such row. Gram–Schmidt is applied twice where the first pass leaves little; that is as stable
//! as Householder's reflections (Giraud, Langou, Rozložník 2005). The Gram matrix of the data is never formed.

#[cfg(feature = "matrices")]
use nalgebra::{DMatrix, DVector};
use std::ops::Range;
use std::rc::Rc;

/// Orthogonal factors of a growing set of columns, and the residual of a response.
#[derive(Debug, Clone)]
pub struct QrFactor {
    /// Upper parts (data rows) of the orthonormal columns.
    upper: Vec<Rc<[f64]>>,
    /// Rows in which each is non-zero: a set-up term acts only on its own record.
    within: Vec<Range<usize>>,
    /// Lower parts (prior rows): column k has k + 1 entries.
    lower: Vec<Vec<f64>>,
    /// Columns of the triangle R.
    triangle: Vec<Vec<f64>>,
    /// Products of the orthonormal columns with the response.
    along: Vec<f64>,
    /// Remaining response: C⁻¹y, C = I + `XXᵀ`.
    residual: Vec<f64>,
    /// The residual in the prior rows.
    pulled: Vec<f64>,
    /// yᵀC⁻¹y.
    left: f64,
    /// ½ log |I + `XᵀX`|.
    half_log_det: f64,
}

/// Σ aᵢbᵢ.
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma") {
        // SAFETY: the processor has both.
        return unsafe { wide::dot(a, b) };
    }
    let mut sums = [0.0; 8];
    let (whole_a, whole_b) = (a.chunks_exact(8), b.chunks_exact(8));
    let rest: f64 = whole_a.remainder().iter().zip(whole_b.remainder()).map(|(x, y)| x * y).sum();
    for (x, y) in whole_a.zip(whole_b) {
        for i in 0..8 {
            sums[i] += x[i] * y[i];
        }
    }
    sums.iter().sum::<f64>() + rest
}

/// a += k·b.
pub fn add(a: &mut [f64], k: f64, b: &[f64]) {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma") {
        // SAFETY: the processor has both.
        return unsafe { wide::add(a, k, b) };
    }
    a.iter_mut().zip(b).for_each(|(a, b)| *a += k * b);
}

/// The same with explicit AVX2 instructions.
/// For a generic loop, the compiled code would depend on inlining.
#[cfg(target_arch = "x86_64")]
mod wide {
    use std::arch::x86_64::{
        __m256d, _mm256_add_pd, _mm256_fmadd_pd, _mm256_loadu_pd, _mm256_set1_pd, _mm256_setzero_pd,
        _mm256_storeu_pd,
    };

    /// # Safety
    /// The processor has AVX2 and FMA.
    #[target_feature(enable = "avx2,fma")]
    pub(super) unsafe fn dot(a: &[f64], b: &[f64]) -> f64 {
        let n = a.len().min(b.len());
        let mut sums: [__m256d; 4] = [_mm256_setzero_pd(); 4];
        let (whole, mut out) = (n - n % 16, [0.0; 4]);
        for i in (0..whole).step_by(16) {
            for (k, sum) in sums.iter_mut().enumerate() {
                // SAFETY: i + 4k + 3 < whole ≤ n.
                let (x, y) = unsafe {
                    (_mm256_loadu_pd(a.as_ptr().add(i + 4 * k)), _mm256_loadu_pd(b.as_ptr().add(i + 4 * k)))
                };
                *sum = _mm256_fmadd_pd(x, y, *sum);
            }
        }
        let sum = _mm256_add_pd(_mm256_add_pd(sums[0], sums[1]), _mm256_add_pd(sums[2], sums[3]));
        // SAFETY: four numbers.
        unsafe { _mm256_storeu_pd(out.as_mut_ptr(), sum) };
        let rest: f64 = a[whole..n].iter().zip(&b[whole..n]).map(|(x, y)| x * y).sum();
        out.iter().sum::<f64>() + rest
    }

    /// # Safety
    /// The processor has AVX2 and FMA.
    #[target_feature(enable = "avx2,fma")]
    pub(super) unsafe fn add(a: &mut [f64], k: f64, b: &[f64]) {
        let n = a.len().min(b.len());
        let (whole, by) = (n - n % 4, _mm256_set1_pd(k));
        for i in (0..whole).step_by(4) {
            // SAFETY: i + 3 < whole ≤ n.
            unsafe {
                let (at, x) = (a.as_mut_ptr().add(i), _mm256_loadu_pd(b.as_ptr().add(i)));
                _mm256_storeu_pd(at, _mm256_fmadd_pd(by, x, _mm256_loadu_pd(at)));
            }
        }
        for (a, b) in a[whole..n].iter_mut().zip(&b[whole..n]) {
            *a += k * b;
        }
    }
}

/// Products of columns among each other, row by row.
/// They are those after projection on orthonormal columns.
/// By products of matrices: for many columns they take a fraction of the time of single products.
#[cfg(feature = "matrices")]
pub fn products_beside(orthonormal: &DMatrix<f64>, columns: &[Vec<f64>]) -> Vec<f64> {
    let own =
        DMatrix::from_row_iterator(columns.len(), orthonormal.nrows(), columns.iter().flatten().copied());
    let shares = &own * orthonormal;
    (&own * own.transpose() - &shares * shares.transpose()).as_slice().to_vec()
}

/// ½ log |I + tS| and t hᵀ(I + tS)⁻¹h: what a prior of variance t adds.
/// S holds the products of columns among each other, row by row; h those with a residual.
#[must_use]
pub fn prior_terms(along: &[f64], among: &[f64], t: f64) -> (f64, f64) {
    let p = along.len();
    // Cholesky's triangle of I + tS, row by row, and along it the solution of L z = h.
    let mut triangle = vec![0.0; p * p];
    let mut z = vec![0.0; p];
    let (mut half_log_det, mut less) = (0.0, 0.0);
    for i in 0..p {
        let (above, own) = triangle.split_at_mut(i * p);
        for j in 0..i {
            let row = &above[j * p..=j * p + j];
            own[j] = (t * among[i * p + j] - dot(&own[..j], &row[..j])) / row[j];
        }
        // A pivot of I plus a sum of squares is at least one, up to rounding.
        let pivot = (1.0 + t * among[i * p + i] - dot(&own[..i], &own[..i])).max(1.0).sqrt();
        z[i] = (along[i] - dot(&own[..i], &z[..i])) / pivot;
        own[i] = pivot;
        half_log_det += pivot.ln();
        less += t * z[i] * z[i];
    }
    (half_log_det, less)
}

impl QrFactor {
    /// Factors without columns.
    pub fn new(response: &[f64]) -> Self {
        Self {
            upper: Vec::new(),
            within: Vec::new(),
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
    pub fn len(&self) -> usize {
        self.upper.len()
    }

    /// Whether there are no columns.
    pub fn is_empty(&self) -> bool {
        self.upper.is_empty()
    }

    /// Data rows of the orthonormal columns.
    pub fn columns(&self) -> &[Rc<[f64]>] {
        &self.upper
    }

    /// Products of the orthonormal columns with another column.
    pub fn shares(&self, column: &[f64]) -> Vec<f64> {
        self.shares_after(Vec::new(), column)
    }

    /// As [`Self::shares`], with the products of the first columns already known.
    pub fn shares_after(&self, mut first: Vec<f64>, column: &[f64]) -> Vec<f64> {
        let of = |(q, within): (&Rc<[f64]>, &Range<usize>)| dot(&q[within.clone()], &column[within.clone()]);
        let from = first.len();
        first.extend(self.upper[from..].iter().zip(&self.within[from..]).map(of));
        first
    }

    /// The orthonormal columns as a matrix.
    #[cfg(feature = "matrices")]
    pub fn matrix(&self) -> DMatrix<f64> {
        let columns = self.upper.iter().flat_map(|q| q.iter().copied());
        DMatrix::from_iterator(self.residual.len(), self.len(), columns)
    }

    /// The residual of another column after projection on these.
    pub fn projected_out(&self, column: &[f64]) -> Vec<f64> {
        let mut out = column.to_vec();
        for (share, (q, within)) in self.shares(column).iter().zip(self.upper.iter().zip(&self.within)) {
            add(&mut out[within.clone()], -share, &q[within.clone()]);
        }
        out
    }

    /// Columns of R: products of each pushed column with the orthonormal ones.
    pub fn triangle(&self) -> &[Vec<f64>] {
        &self.triangle
    }

    /// Products of the orthonormal columns with the response.
    /// Each product is of what the columns before it leave.
    pub fn along(&self) -> &[f64] {
        &self.along
    }

    /// C⁻¹y: the remaining response.
    pub fn residual(&self) -> &[f64] {
        &self.residual
    }

    /// yᵀC⁻¹y.
    pub fn left(&self) -> f64 {
        self.left
    }

    /// ½ log |I + `XᵀX`|.
    pub fn half_log_det(&self) -> f64 {
        self.half_log_det
    }

    /// Effective number of coefficients that the data determine.
    /// Each counts by how much narrower its posterior is than its prior.
    pub fn freedom(&self) -> f64 {
        let inverse = self.inverse();
        let prior: f64 = inverse.iter().map(|row| dot(row, row)).sum();
        (self.len() as f64 - prior).max(0.0)
    }

    /// Adds a column, scaled by the standard deviation of its coefficient.
    pub fn push(&mut self, column: &[f64]) {
        self.push_under(column, 1.0);
    }

    /// Adds a column whose coefficient has no prior.
    /// Returns the share of it, 0 to 1, that the columns before do not explain; rounding alone counts as
    /// zero.
    pub fn push_free(&mut self, column: &[f64]) -> f64 {
        self.push_under(column, 0.0)
    }

    fn push_under(&mut self, column: &[f64], prior: f64) -> f64 {
        let k = self.len();
        let mut up = column.to_vec();
        let mut low = vec![0.0; k + 1];
        low[k] = prior;
        let mut r = vec![0.0; k + 1];
        let whole = dot(&up, &up) + prior;
        for pass in 0..2 {
            // One pass is enough if little was removed (Daniel, Gragg, Kaufman, Stewart 1976).
            if pass == 1 && dot(&up, &up) + dot(&low, &low) > 0.5 * whole {
                break;
            }
            for i in 0..k {
                let within = self.within[i].clone();
                let q = &self.upper[i][within.clone()];
                let c = dot(q, &up[within.clone()]) + dot(&self.lower[i], &low[..=i]);
                if c == 0.0 {
                    continue;
                }
                add(&mut up[within], -c, q);
                add(&mut low[..=i], -c, &self.lower[i]);
                r[i] += c;
            }
        }
        let mut size = (dot(&up, &up) + dot(&low, &low)).sqrt();
        let share = size / whole.sqrt();
        if share > 1e-14 {
            up.iter_mut().chain(&mut low).for_each(|x| *x /= size);
        } else {
            up.iter_mut().chain(&mut low).for_each(|x| *x = 0.0);
            size = 0.0;
        }
        r[k] = size;
        self.pulled.push(0.0);
        let along = dot(&up, &self.residual) + dot(&low, &self.pulled);
        add(&mut self.residual, -along, &up);
        add(&mut self.pulled, -along, &low);
        self.left -= along * along;
        self.half_log_det += size.ln();
        let first = up.iter().position(|x| *x != 0.0).unwrap_or(0);
        let last = up.iter().rposition(|x| *x != 0.0).map_or(first, |l| l + 1);
        self.within.push(first..last);
        self.upper.push(up.into());
        self.lower.push(low);
        self.triangle.push(r);
        self.along.push(along);
        share
    }

    /// Sum of squares of the residual in these rows, if they are left out of the fit.
    /// No second fit is needed: with Q the orthonormal columns in these rows and r the residual there, it is
    /// |(I − QQᵀ)⁻¹ r|² (Cook, Weisberg 1982). `None` if without these rows less than the share `least` of a
    /// column is its own.
    #[cfg(feature = "matrices")]
    pub fn left_out(&self, rows: &Range<usize>, least: f64) -> Option<f64> {
        let (k, residual) = (self.len(), &self.residual[rows.clone()]);
        let q: Vec<&[f64]> = self.upper.iter().map(|q| &q[rows.clone()]).collect();
        // What the other rows keep of the columns: I − QᵀQ. Its eigenvalues are within 0 and 1.
        let kept = DMatrix::from_fn(k, k, |i, j| f64::from(u8::from(i == j)) - dot(q[i], q[j]));
        let triangle = kept.cholesky()?.unpack();
        let own = |(i, r): (usize, &Vec<f64>)| triangle[(i, i)] * r[i] > least * dot(r, r).sqrt();
        if !self.triangle.iter().enumerate().all(own) {
            return None;
        }
        let along = DVector::from_iterator(k, q.iter().map(|q| dot(q, residual)));
        let shift = triangle.tr_solve_lower_triangular(&triangle.solve_lower_triangular(&along)?)?;
        let mut out = residual.to_vec();
        q.iter().zip(&shift).for_each(|(q, z)| add(&mut out, *z, q));
        Some(dot(&out, &out))
    }

    /// Weight of each row in a coefficient's value: a row of the pseudo-inverse.
    pub fn weights(&self, coefficient: usize) -> Vec<f64> {
        let mut out = vec![0.0; self.residual.len()];
        for (r, q) in self.inverse()[coefficient].iter().zip(&self.upper) {
            add(&mut out, *r, q);
        }
        out
    }

    /// Factors of the first `k` columns only.
    #[must_use]
    pub fn first(&self, k: usize) -> Self {
        self.without(k..self.len())
    }

    /// Factors without these columns.
    /// Givens rotations restore the triangle; the columns after them are not pushed again.
    #[must_use]
    pub fn without(&self, columns: Range<usize>) -> Self {
        let mut out = self.clone();
        for i in columns.rev() {
            out.remove(i);
        }
        out
    }

    fn remove(&mut self, column: usize) {
        let last = self.len() - 1;
        self.half_log_det -= (column..=last).map(|j| self.triangle[j][j].ln()).sum::<f64>();
        self.triangle.remove(column);
        for j in column..last {
            // Columns j and j + 1 are turned so that the diagonal takes what stands below it.
            let (above, below) = (self.triangle[j][j], self.triangle[j][j + 1]);
            let size = above.hypot(below);
            let (c, s) = if size > 0.0 { (above / size, below / size) } else { (1.0, 0.0) };
            for r in &mut self.triangle[j..] {
                (r[j], r[j + 1]) = (c * r[j] + s * r[j + 1], c * r[j + 1] - s * r[j]);
            }
            self.triangle[j].truncate(j + 1);
            let turn = |a: &mut [f64], b: &mut [f64]| {
                for (a, b) in a.iter_mut().zip(b) {
                    (*a, *b) = (c * *a + s * *b, c * *b - s * *a);
                }
            };
            let within = self.within[j].start.min(self.within[j + 1].start)
                ..self.within[j].end.max(self.within[j + 1].end);
            let (mut a, mut b) = (self.upper[j].to_vec(), self.upper[j + 1].to_vec());
            turn(&mut a[within.clone()], &mut b[within.clone()]);
            (self.upper[j], self.upper[j + 1]) = (a.into(), b.into());
            (self.within[j], self.within[j + 1]) = (within.clone(), within);
            self.lower[j].push(0.0);
            let (low, high) = self.lower.split_at_mut(j + 1);
            turn(&mut low[j], &mut high[0]);
            let (low, high) = self.along.split_at_mut(j + 1);
            turn(&mut low[j..], &mut high[..1]);
            self.half_log_det += self.triangle[j][j].ln();
        }
        let along = self.along[last];
        add(&mut self.residual, along, &self.upper[last]);
        add(&mut self.pulled, along, &self.lower[last]);
        self.left += along * along;
        self.upper.truncate(last);
        self.within.truncate(last);
        self.lower.truncate(last);
        self.along.truncate(last);
        // The coefficient's prior row has become zero in all other columns.
        for low in &mut self.lower[column..] {
            low.remove(column);
        }
        self.pulled.remove(column);
    }

    /// The coefficients' posterior means, in prior standard deviations.
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

#[cfg(all(test, feature = "matrices"))]
mod tests {
    use super::*;

    /// Compares with the normal equations of another library, well-conditioned.
    #[test]
    fn agrees_with_ridge_regression() {
        let n = 40;
        let x = |i: usize, j: usize| ((i * (j + 2) + 3 * j) as f64 * 0.37).sin() * (1.0 + j as f64);
        let y: Vec<f64> = (0..n).map(|i| (i as f64 * 0.2).cos() * 3.0).collect();
        let mut factor = QrFactor::new(&y);
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

    /// Compares with fits to the other rows.
    #[test]
    fn rows_are_left_out_as_by_a_second_fit() {
        let column = |j: u32, rows: &[u32]| {
            rows.iter().map(|i| f64::from(i * (j + 1)).cos() + f64::from(j)).collect::<Vec<f64>>()
        };
        let fit = |rows: &[u32]| {
            let y: Vec<f64> = rows.iter().map(|i| f64::from(*i).sin()).collect();
            let mut factor = QrFactor::new(&y);
            (0..4).for_each(|j| _ = factor.push_free(&column(j, rows)));
            (factor, y)
        };
        let all: Vec<u32> = (0..30).collect();
        for block in [0..7, 7..20, 20..30] {
            let (own, others): (Vec<u32>, Vec<u32>) =
                all.iter().partition(|i| block.contains(&(**i as usize)));
            let mut left = fit(&own).1;
            for (j, c) in fit(&others).0.solve().into_iter().enumerate() {
                add(&mut left, -c, &column(j as u32, &own));
            }
            let at_once = fit(&all).0.left_out(&block, 1e-7).unwrap();
            assert!((at_once / dot(&left, &left) - 1.0).abs() < 1e-9, "{block:?}");
        }
        let (mut factor, _) = fit(&all);
        factor.push_free(&(0..30).map(|i| f64::from(u8::from(i == 3))).collect::<Vec<_>>());
        assert!(factor.left_out(&(0..7), 1e-7).is_none() && factor.left_out(&(7..20), 1e-7).is_some());
    }

    #[test]
    fn a_priors_terms_are_those_of_the_whole_matrix() {
        let column = |j: u32| (0..30).map(|i| f64::from(i * (j + 1)).cos()).collect::<Vec<f64>>();
        let columns: Vec<_> = (0..4).map(column).collect();
        let y: Vec<f64> = (0..30).map(|i| f64::from(i).sin()).collect();
        let along: Vec<f64> = columns.iter().map(|c| dot(c, &y)).collect();
        let among: Vec<f64> = columns.iter().flat_map(|a| columns.iter().map(|b| dot(a, b))).collect();
        let mut factor = QrFactor::new(&y);
        for c in &columns {
            factor.push(&c.iter().map(|x| 1.7 * x).collect::<Vec<_>>());
        }
        let (half_log_det, less) = prior_terms(&along, &among, 1.7 * 1.7);
        assert!((half_log_det - factor.half_log_det()).abs() < 1e-9);
        assert!((dot(&y, &y) - less - factor.left()).abs() < 1e-9);
    }

    #[test]
    fn the_first_columns_are_as_if_alone() {
        let y: Vec<f64> = (0..30).map(|i| f64::from(i).sin()).collect();
        let column = |j: u32| (0..30).map(|i| f64::from(i * (j + 1)).cos()).collect::<Vec<f64>>();
        let mut all = QrFactor::new(&y);
        (0..4).for_each(|j| all.push(&column(j)));
        let mut two = QrFactor::new(&y);
        (0..2).for_each(|j| two.push(&column(j)));
        let first = all.first(2);
        assert!((first.left() - two.left()).abs() < 1e-9 && first.len() == 2);
        assert!((first.half_log_det() - two.half_log_det()).abs() < 1e-9);
        assert!(first.residual().iter().zip(two.residual()).all(|(a, b)| (a - b).abs() < 1e-9));
        assert!(first.solve().iter().zip(two.solve()).all(|(a, b)| (a - b).abs() < 1e-9));
    }

    #[test]
    fn products_of_matrices_are_those_of_columns() {
        let column = |j: u32| (0..30).map(|i| f64::from(i * (j + 1)).cos()).collect::<Vec<f64>>();
        let mut factor = QrFactor::new(&column(20));
        (0..4).for_each(|j| factor.push(&column(j)));
        let others: Vec<Vec<f64>> = (5..9).map(column).collect();
        let among = products_beside(&factor.matrix(), &others);
        for (i, a) in others.iter().enumerate() {
            for (j, b) in others.iter().enumerate() {
                let beside = dot(a, b) - dot(&factor.shares(a), &factor.shares(b));
                assert!((among[i * 4 + j] - beside).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn without_some_columns_is_as_if_they_had_never_been() {
        let y: Vec<f64> = (0..30).map(|i| f64::from(i).sin() + 0.1 * f64::from(i)).collect();
        // Some columns act on their own rows only, and one has no prior.
        let column = |j: u32| {
            let of = |i: u32| {
                if j == 2 && i < 20 { 0.0 } else { f64::from(i * (j + 1)).cos() + f64::from(i % (j + 2)) }
            };
            (0..30).map(of).collect::<Vec<f64>>()
        };
        let of = |kept: &dyn Fn(u32) -> bool| {
            let mut factor = QrFactor::new(&y);
            for j in (0..7).filter(|j| kept(*j)) {
                if j == 1 {
                    factor.push_free(&column(j));
                } else {
                    factor.push(&column(j));
                }
            }
            factor
        };
        let all = of(&|_| true);
        for range in [0..1, 1..2, 2..5, 0..7, 5..7, 6..7] {
            let (mut less, mut never) = (all.without(range.clone()), of(&|j| !range.contains(&(j as usize))));
            less.push(&column(9));
            never.push(&column(9));
            let close = |a: &[f64], b: &[f64]| {
                a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9)
            };
            assert!((less.left() - never.left()).abs() < 1e-9, "{range:?}");
            assert!((less.half_log_det() - never.half_log_det()).abs() < 1e-9, "{range:?}");
            assert!(
                close(less.residual(), never.residual()) && close(&less.solve(), &never.solve()),
                "{range:?}"
            );
            assert!((less.freedom() - never.freedom()).abs() < 1e-9, "{range:?}");
            assert!(close(&less.weights(0), &never.weights(0)), "{range:?}");
        }
    }

    /// Nearly equal columns give finite results.
    #[test]
    fn survives_equal_columns() {
        let y: Vec<f64> = (0..30).map(f64::from).collect();
        let mut factor = QrFactor::new(&y);
        for _ in 0..3 {
            factor.push(&y.iter().map(|v| 1e6 * v).collect::<Vec<_>>());
        }
        assert!(factor.solve().iter().all(|b| b.is_finite()) && factor.left() >= 0.0);
    }
}
