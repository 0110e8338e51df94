//! Least squares under autocorrelated noise, for many candidate columns at once.
//!
//! Noise is a first-order autoregression inside each segment (a response of a record), of any coefficient φ. With
//! whitening W the inner product ⟨x, v⟩ = (Wx)·(Wv) is, for every φ at once,
//!
//! (1 + φ²)·Σxᵢvᵢ − φ·Σ(xᵢvᵢ₋₁ + xᵢ₋₁vᵢ) − φ²·(first and last product of each segment),
//!
//! so three [`Products`] per pair of columns serve every noise model, and a fit costs nothing that grows with the rows.

use std::ops::Range;

/// The three sums that give the whitened inner product of two columns at any φ.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Products {
    plain: f64,
    lagged: f64,
    ends: f64,
}

impl Products {
    /// The whitened inner product at φ.
    pub(crate) fn at(self, phi: f64) -> f64 {
        (1.0 + phi * phi) * self.plain - phi * self.lagged - phi * phi * self.ends
    }
}

/// A column with what its products need: itself and the sum of its neighbours inside each segment.
#[derive(Debug, Clone)]
pub(crate) struct Vector {
    pub(crate) data: Vec<f64>,
    neighbours: Vec<f64>,
}

impl Vector {
    pub(crate) fn new(data: Vec<f64>, segments: &[Range<usize>]) -> Self {
        let mut neighbours = vec![0.0; data.len()];
        for s in segments {
            let (x, out) = (&data[s.clone()], &mut neighbours[s.clone()]);
            for i in 1..x.len() {
                out[i] += x[i - 1];
                out[i - 1] += x[i];
            }
        }
        Self { data, neighbours }
    }

    pub(crate) fn products(&self, other: &[f64], segments: &[Range<usize>]) -> Products {
        Products {
            plain: dot(&self.data, other),
            lagged: dot(&self.neighbours, other),
            ends: ends(&self.data, other, segments),
        }
    }
}

fn ends(x: &[f64], v: &[f64], segments: &[Range<usize>]) -> f64 {
    segments.iter().map(|s| x[s.start] * v[s.start] + x[s.end - 1] * v[s.end - 1]).sum()
}

/// Dot product in four lanes, in a fixed order of summation.
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut lanes = [0.0; 4];
    let (ca, cb) = (a.chunks_exact(4), b.chunks_exact(4));
    let tail: f64 = ca.remainder().iter().zip(cb.remainder()).map(|(x, y)| x * y).sum();
    for (x, y) in ca.zip(cb) {
        for k in 0..4 {
            lanes[k] += x[k] * y[k];
        }
    }
    (lanes[0] + lanes[1]) + (lanes[2] + lanes[3]) + tail
}

/// Candidate columns, one after the other, all of the same number of rows.
#[derive(Debug, Clone, Default)]
pub(crate) struct Bank {
    rows: usize,
    data: Vec<f64>,
    /// Weight that was taken off each column: column = stored · scale.
    pub(crate) scale: Vec<f64>,
}

impl Bank {
    pub(crate) fn new(rows: usize) -> Self {
        Self { rows, data: Vec::new(), scale: Vec::new() }
    }

    pub(crate) fn len(&self) -> usize {
        self.scale.len()
    }

    pub(crate) fn column(&self, at: usize) -> &[f64] {
        &self.data[at * self.rows..(at + 1) * self.rows]
    }

    /// Adds a column, scaled to a mean square of one; gives its number.
    pub(crate) fn push(&mut self, column: &[f64]) -> usize {
        let rms = (dot(column, column) / self.rows.max(1) as f64).sqrt();
        let scale = if rms > 0.0 { rms } else { 1.0 };
        self.data.extend(column.iter().map(|x| x / scale));
        self.scale.push(scale);
        self.scale.len() - 1
    }

    /// Products of every column with every vector: `out[v][column]`.
    pub(crate) fn products(&self, vectors: &[&Vector], segments: &[Range<usize>]) -> Vec<Vec<Products>> {
        let (c, n, m) = (self.len(), self.rows, vectors.len());
        if c == 0 || m == 0 || n == 0 {
            return vec![Vec::new(); m];
        }
        let mut right = Vec::with_capacity(2 * m * n);
        for v in vectors {
            right.extend_from_slice(&v.data);
            right.extend_from_slice(&v.neighbours);
        }
        let mut sums = vec![0.0; 2 * m * c];
        // SAFETY: `data` holds c columns of n values, `right` 2m columns of n, `sums` 2m rows of c, all with these strides.
        unsafe {
            matrixmultiply::dgemm(
                2 * m,
                n,
                c,
                1.0,
                right.as_ptr(),
                n as isize,
                1,
                self.data.as_ptr(),
                1,
                n as isize,
                0.0,
                sums.as_mut_ptr(),
                c as isize,
                1,
            );
        }
        vectors
            .iter()
            .enumerate()
            .map(|(k, v)| {
                (0..c)
                    .map(|j| Products {
                        plain: sums[2 * k * c + j],
                        lagged: sums[(2 * k + 1) * c + j],
                        ends: ends(&v.data, self.column(j), segments),
                    })
                    .collect()
            })
            .collect()
    }
}

/// A lower Cholesky factor of a symmetric matrix, row by row.
#[derive(Debug, Clone, Default)]
pub(crate) struct Cholesky {
    n: usize,
    l: Vec<f64>,
}

impl Cholesky {
    /// Factor of a matrix given row by row. A column that the ones before it explain to 1 part in 10⁹ is dropped: its
    /// coefficient will be zero.
    pub(crate) fn new(a: &[f64], n: usize) -> Self {
        let mut l = vec![0.0; n * n];
        for i in 0..n {
            for j in 0..=i {
                let s = a[i * n + j] - dot(&l[i * n..i * n + j], &l[j * n..j * n + j]);
                if i == j {
                    l[i * n + i] = if s > 1e-9 * a[i * n + i] { s.sqrt() } else { f64::INFINITY };
                } else {
                    l[i * n + j] = s / l[j * n + j];
                }
            }
        }
        Self { n, l }
    }

    /// L⁻¹b, in place.
    pub(crate) fn forward(&self, b: &mut [f64]) {
        for i in 0..self.n {
            let row = &self.l[i * self.n..];
            b[i] = (b[i] - dot(&row[..i], &b[..i])) / row[i];
        }
    }

    /// L⁻ᵀb, in place.
    pub(crate) fn backward(&self, b: &mut [f64]) {
        for i in (0..self.n).rev() {
            let mut s = b[i];
            for (k, x) in b.iter().enumerate().skip(i + 1) {
                s -= self.l[k * self.n + i] * x;
            }
            b[i] = s / self.l[i * self.n + i];
        }
    }

    /// Diagonal of the inverse.
    pub(crate) fn inverse_diagonal(&self) -> Vec<f64> {
        (0..self.n)
            .map(|i| {
                let mut e = vec![0.0; self.n];
                e[i] = 1.0;
                self.forward(&mut e);
                dot(&e, &e)
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn whiten(x: &[f64], phi: f64, segments: &[Range<usize>]) -> Vec<f64> {
        let mut w = x.to_vec();
        for s in segments {
            w[s.start] = x[s.start] * (1.0 - phi * phi).sqrt();
            for i in s.start + 1..s.end {
                w[i] = x[i] - phi * x[i - 1];
            }
        }
        w
    }

    #[test]
    fn products_are_the_whitened_inner_product() {
        let segments = [0..5, 5..9];
        let x: Vec<f64> = (0..9).map(|i| f64::from(i * i % 7) - 2.0).collect();
        let v: Vec<f64> = (0..9).map(|i| f64::from(i * 5 % 11) - 4.0).collect();
        let mut bank = Bank::new(9);
        bank.push(&v);
        let vector = Vector::new(x.clone(), &segments);
        let fast = bank.products(&[&vector], &segments)[0][0];
        for phi in [-0.3, 0.0, 0.6, 0.97] {
            let slow = dot(&whiten(&x, phi, &segments), &whiten(&v, phi, &segments));
            assert!((vector.products(&v, &segments).at(phi) - slow).abs() < 1e-12);
            assert!((fast.at(phi) * bank.scale[0] - slow).abs() < 1e-12);
        }
    }

    #[test]
    fn cholesky_solves_and_drops_what_is_explained_already() {
        // Third column = first + second.
        let a = [4.0, 2.0, 6.0, 2.0, 3.0, 5.0, 6.0, 5.0, 11.0];
        let c = Cholesky::new(&a, 3);
        let mut b = [8.0, 8.0, 16.0];
        c.forward(&mut b);
        c.backward(&mut b);
        assert!((b[0] - 1.0).abs() < 1e-12 && (b[1] - 2.0).abs() < 1e-12 && b[2] == 0.0);
    }
}
