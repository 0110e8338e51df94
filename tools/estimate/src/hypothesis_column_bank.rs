//! The columns of all hypotheses on a fixed grid, for a quick look.
//! It estimates how much each column explains of a residual. It decides nothing; it only selects what is
//! computed exactly.

use crate::rows_and_noise::{MeasuredRows, ResponseNoise};
use rtec_least_squares::{QrFactor, add};
use std::ops::Range;

/// Columns in groups.
#[derive(Debug, Default, Clone)]
pub struct HypothesisColumnBank {
    n: usize,
    raw: Vec<Vec<f64>>,
    /// Whitened columns, one after the other.
    /// Single precision is enough to select what to compute exactly.
    white: Vec<f32>,
    /// Range of columns of each group, and the index at which its products begin.
    groups: Vec<(Range<usize>, usize)>,
    count: usize,
}

/// How much the columns explain of a factor's residual.
#[derive(Debug, Clone)]
pub struct ScreeningProducts {
    /// Products with the residual.
    pub along: Vec<f64>,
    /// Products among the columns of each group, after projection on the factor.
    pub among: Vec<f64>,
}

impl HypothesisColumnBank {
    /// An empty bank for columns of `n` rows.
    #[must_use]
    pub fn new(n: usize) -> Self {
        Self { n, ..Self::default() }
    }

    /// Adds a group and returns its number.
    pub fn push(&mut self, columns: Vec<Vec<f64>>) -> usize {
        let from = self.raw.len();
        self.raw.extend(columns);
        let k = self.raw.len() - from;
        self.groups.push((from..self.raw.len(), self.count));
        self.count += k * k;
        self.groups.len() - 1
    }

    /// Columns of a group, and the index at which its products begin.
    #[must_use]
    pub fn group(&self, group: usize) -> (Range<usize>, usize) {
        self.groups[group].clone()
    }

    /// Divides all columns by the noise.
    pub fn whiten(&mut self, rows: &MeasuredRows<'_>, noise: &ResponseNoise) {
        self.white.clear();
        self.white.reserve(self.raw.len() * self.n);
        let mut buffer = Vec::with_capacity(self.n);
        for c in &self.raw {
            buffer.clear();
            buffer.extend_from_slice(c);
            noise.whiten(rows, &mut buffer);
            self.white.extend(buffer.iter().map(|x| *x as f32));
        }
    }

    /// The first look: products of the columns with a factor's residual.
    #[must_use]
    pub fn screening_products(&self, factor: &QrFactor) -> ScreeningProducts {
        let along = self.shares(factor.residual());
        let mut among = vec![0.0; self.count];
        let n = self.n;
        for (columns, at) in &self.groups {
            let white = &self.white[columns.start * n..columns.end * n];
            let own = match columns.len() {
                1 => vec![f64::from(single::dot(white, white))],
                p => self.products(columns.clone(), white, p),
            };
            among[*at..at + own.len()].copy_from_slice(&own);
        }
        let mut look = ScreeningProducts { along, among };
        self.take(&mut look, &self.shares_of(factor.columns()));
        look
    }

    /// Products of all columns with each of these.
    #[must_use]
    pub fn shares_of<C: AsRef<[f64]>>(&self, columns: &[C]) -> Vec<Vec<f64>> {
        if let [one] = columns {
            return vec![self.shares(one.as_ref())];
        }
        let (k, m) = (columns.len(), self.raw.len());
        let packed: Vec<f32> = columns.iter().flat_map(AsRef::as_ref).map(|x| *x as f32).collect();
        let products = self.products(0..m, &packed, k);
        (0..k).map(|j| (0..m).map(|i| products[i * k + j]).collect()).collect()
    }

    /// Products of all columns with another column.
    fn shares(&self, column: &[f64]) -> Vec<f64> {
        if self.n == 0 {
            return vec![0.0; self.raw.len()];
        }
        let column: Vec<f32> = column.iter().map(|x| *x as f32).collect();
        self.white.chunks_exact(self.n).map(|c| f64::from(single::dot(c, &column))).collect()
    }

    /// Products of a range of columns with others, row by row.
    /// The others are stored one after the other.
    fn products(&self, columns: Range<usize>, others: &[f32], k: usize) -> Vec<f64> {
        let (m, n) = (columns.len(), self.n);
        if m == 0 || k == 0 || n == 0 {
            return vec![0.0; m * k];
        }
        assert_eq!(others.len(), n * k, "columns of as many rows");
        let own = &self.white[columns.start * n..columns.end * n];
        let mut out = vec![0.0_f32; m * k];
        // SAFETY: `own` holds m rows of n numbers, `others` k rows of n, `out` m rows of k, as the strides say.
        unsafe {
            matrixmultiply::sgemm(
                m,
                n,
                k,
                1.0,
                own.as_ptr(),
                n as isize,
                1,
                others.as_ptr(),
                1,
                n as isize,
                0.0,
                out.as_mut_ptr(),
                k as isize,
                1,
            );
        }
        out.into_iter().map(f64::from).collect()
    }

    /// Updates a look after further orthonormal columns were added.
    /// `shares` are the bank's products with each of them, `along` their products with the residual before
    /// they were added.
    pub fn update_products(&self, look: &mut ScreeningProducts, shares: &[Vec<f64>], along: &[f64]) {
        for (shares, along) in shares.iter().zip(along) {
            add(&mut look.along, -along, shares);
        }
        self.take(look, shares);
    }

    /// Projects orthonormal columns out of the products among the bank's columns.
    fn take(&self, look: &mut ScreeningProducts, shares: &[Vec<f64>]) {
        for share in shares {
            for (columns, at) in &self.groups {
                let own = &share[columns.clone()];
                for (i, a) in own.iter().enumerate() {
                    let from = at + i * own.len();
                    add(&mut look.among[from..from + own.len()], -a, own);
                }
            }
        }
    }
}

/// Products in single precision.
mod single {
    /// Σ aᵢbᵢ.
    pub(super) fn dot(a: &[f32], b: &[f32]) -> f32 {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma") {
            // SAFETY: the processor has AVX2 and FMA.
            return unsafe { wide(a, b) };
        }
        sum(a, b)
    }

    /// # Safety
    /// The processor has AVX2 and FMA.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    unsafe fn wide(a: &[f32], b: &[f32]) -> f32 {
        sum(a, b)
    }

    #[expect(clippy::inline_always, reason = "it is compiled for the processor of whoever calls it")]
    #[inline(always)]
    fn sum(a: &[f32], b: &[f32]) -> f32 {
        let mut sums = [0.0_f32; 32];
        let (whole_a, whole_b) = (a.chunks_exact(32), b.chunks_exact(32));
        let rest: f32 = whole_a.remainder().iter().zip(whole_b.remainder()).map(|(x, y)| x * y).sum();
        for (x, y) in whole_a.zip(whole_b) {
            for i in 0..32 {
                sums[i] += x[i] * y[i];
            }
        }
        sums.iter().sum::<f32>() + rest
    }
}
