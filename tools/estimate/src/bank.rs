//! The columns of all hypotheses that have a fixed place, and what they explain of a residual: a quick look that decides nothing, but
//! only what is looked at exactly.

use crate::factor::{Factor, dot};
use crate::rows::{Noise, Rows};
use std::ops::Range;
use std::rc::Rc;

/// Columns in groups.
#[derive(Debug, Default, Clone)]
pub struct Bank {
    n: usize,
    raw: Vec<Vec<f64>>,
    /// Whitened, one after the other; in single precision, which is enough to see what is worth an exact look.
    white: Vec<f32>,
    /// Columns of each group, and where its products begin.
    groups: Vec<(Range<usize>, usize)>,
    count: usize,
}

/// What columns explain of what a factor leaves.
#[derive(Debug, Clone)]
pub struct Look {
    /// Products with the residual.
    pub along: Vec<f64>,
    /// Products among the columns of each group, after the factor's columns.
    pub among: Vec<f64>,
}

impl Bank {
    /// No columns of so many rows.
    #[must_use]
    pub fn new(n: usize) -> Self {
        Self { n, ..Self::default() }
    }

    /// Adds a group; its number.
    pub fn push(&mut self, columns: Vec<Vec<f64>>) -> usize {
        let from = self.raw.len();
        self.raw.extend(columns);
        let k = self.raw.len() - from;
        self.groups.push((from..self.raw.len(), self.count));
        self.count += k * k;
        self.groups.len() - 1
    }

    /// Columns of a group, and where its products begin.
    #[must_use]
    pub fn group(&self, group: usize) -> (Range<usize>, usize) {
        self.groups[group].clone()
    }

    /// Divides all columns by the noise.
    pub fn whiten(&mut self, rows: &Rows<'_>, noise: &Noise) {
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

    /// The first look, beside a factor.
    #[must_use]
    pub fn look(&self, factor: &Factor) -> Look {
        let n = self.n;
        let residual: Vec<f32> = factor.residual().iter().map(|x| *x as f32).collect();
        let along = self.products(0..self.raw.len(), &residual, 1);
        let mut among = vec![0.0; self.count];
        for (columns, at) in &self.groups {
            let own = self.products(
                columns.clone(),
                &self.white[columns.start * n..columns.end * n],
                columns.len(),
            );
            among[*at..at + own.len()].copy_from_slice(&own);
        }
        let mut look = Look { along, among };
        self.take(&mut look, factor.columns());
        look
    }

    /// Products of some columns with others, that lie one after the other: row by row.
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

    /// The look beside further orthonormal columns: `along` are their products with the residual before them.
    pub fn after(&self, look: &mut Look, columns: &[Rc<[f64]>], along: &[f64]) {
        let shares = self.take(look, columns);
        let k = columns.len();
        for (h, shares) in look.along.iter_mut().zip(shares.chunks(k.max(1))) {
            *h -= dot(shares, along);
        }
    }

    /// Takes orthonormal columns out of the products among the bank's; the bank's shares in them.
    fn take(&self, look: &mut Look, columns: &[Rc<[f64]>]) -> Vec<f64> {
        let k = columns.len();
        let packed: Vec<f32> = columns.iter().flat_map(|c| c.iter()).map(|x| *x as f32).collect();
        let shares = self.products(0..self.raw.len(), &packed, k);
        if k == 0 {
            return shares;
        }
        for (columns, at) in &self.groups {
            let p = columns.len();
            for i in 0..p {
                let a = &shares[(columns.start + i) * k..(columns.start + i + 1) * k];
                for j in 0..=i {
                    let d = dot(a, &shares[(columns.start + j) * k..(columns.start + j + 1) * k]);
                    look.among[at + i * p + j] -= d;
                    if i != j {
                        look.among[at + j * p + i] -= d;
                    }
                }
            }
        }
        shares
    }
}
