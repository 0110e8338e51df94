//! Cholesky factors, of matrices whose columns may be made up by one another.

use crate::lanes::{dot, minus};

/// What of a column is no new explanation: so much of its square, of which others explain the rest. In the columns of the
/// bank, kept to seven digits, less would be what was rounded off, and it takes part in nothing. One measure for the search and
/// for what chance would find, as they are compared.
pub(crate) const KNOWN: f64 = 1e-6;

/// Where more is explained than there is: columns of which only all together make up one of them, so that none is nearly made up by the
/// ones before it, and what rounding leaves of the last one is anything. Then so much of its own square is added to each column's.
pub(crate) const RIDGE: f64 = 1e-8;

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
        Self::dropping(a, n, 1e-9)
    }

    /// The same where a column is dropped of which the ones before it leave less than this.
    pub(crate) fn dropping(a: &[f64], n: usize, least: f64) -> Self {
        Self::growing(&Self::default(), 0, a, n, least)
    }

    /// The same of a matrix whose first `same` rows and columns are those of one whose factor is at hand: these are taken from
    /// it, and are not looked at in `a`.
    pub(crate) fn growing(from: &Self, same: usize, a: &[f64], n: usize, least: f64) -> Self {
        let mut l = vec![0.0; n * n];
        for i in 0..same {
            l[i * n..=i * n + i].copy_from_slice(from.row(i));
        }
        for i in same..n {
            for j in 0..=i {
                let s = a[i * n + j] - dot(&l[i * n..i * n + j], &l[j * n..j * n + j]);
                if i == j {
                    l[i * n + i] = if s > least * a[i * n + i] { s.sqrt() } else { f64::INFINITY };
                } else {
                    l[i * n + j] = s / l[j * n + j];
                }
            }
        }
        Self { n, l }
    }

    /// L⁻¹b, in place.
    pub(crate) fn forward(&self, b: &mut [f64]) {
        self.forward_from(0, b);
    }

    /// The same where the first `same` values are L⁻¹b already.
    pub(crate) fn forward_from(&self, same: usize, b: &mut [f64]) {
        for i in same..self.n {
            let row = &self.l[i * self.n..];
            b[i] = (b[i] - dot(&row[..i], &b[..i])) / row[i];
        }
    }

    /// L⁻¹B, in place: B row by row, `width` values each.
    pub(crate) fn forward_many(&self, b: &mut [f64], width: usize) {
        for i in 0..self.n {
            let (before, at) = b.split_at_mut(i * width);
            let (row, at) = (self.row(i), &mut at[..width]);
            for (l, before) in row.iter().zip(before.chunks_exact(width)) {
                minus(at, *l, before);
            }
            for x in at {
                *x /= row[i];
            }
        }
    }

    /// A row of L, up to its diagonal.
    pub(crate) fn row(&self, i: usize) -> &[f64] {
        &self.l[i * self.n..=i * self.n + i]
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
}

/// L⁻¹b in place of b, L the Cholesky factor that takes the place of a matrix's lower triangle: [`Cholesky`] for what is
/// needed once, with columns dropped of which less than [`KNOWN`] is new.
pub(crate) fn reduce(a: &mut [f64], b: &mut [f64]) {
    let n = b.len();
    for i in 0..n {
        for j in 0..=i {
            let s = a[i * n + j] - dot(&a[i * n..i * n + j], &a[j * n..j * n + j]);
            a[i * n + j] = if i != j {
                s / a[j * n + j]
            } else if s > KNOWN * a[i * n + i] {
                s.sqrt()
            } else {
                f64::INFINITY
            };
        }
        b[i] = (b[i] - dot(&a[i * n..i * n + i], &b[..i])) / a[i * n + i];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of two columns that differ by so little of their square, the second is dropped or not.
    #[test]
    fn how_much_of_a_column_is_new_decides_whether_it_counts() {
        for (least, new, counts) in [(1e-9, 1e-7, true), (KNOWN, 1e-7, false), (KNOWN, 1e-5, true)] {
            let a = [1.0, 1.0, 1.0, 1.0 + new];
            let mut b = [1.0, 2.0];
            Cholesky::dropping(&a, 2, least).forward(&mut b);
            assert_eq!(b[1] != 0.0, counts, "{least} {new}: {b:?}");
        }
    }

    #[test]
    fn cholesky_solves_and_drops_what_is_explained_already() {
        // Third column = first + second.
        let a = [4.0, 2.0, 6.0, 2.0, 3.0, 5.0, 6.0, 5.0, 11.0];
        let c = Cholesky::new(&a, 3);
        let mut b = [8.0, 8.0, 16.0];
        c.forward(&mut b);
        // The same, grown out of the factor of the first row and column.
        let grown = Cholesky::growing(
            &Cholesky::new(&a[..1], 1),
            1,
            &[[f64::NAN; 3], [2.0, 3.0, 5.0], [6.0, 5.0, 11.0]].concat(),
            3,
            1e-9,
        );
        assert!((0..3).all(|i| grown.row(i) == c.row(i)));
        let mut on = [b[0], 8.0, 16.0];
        grown.forward_from(1, &mut on);
        assert_eq!(on.map(f64::to_bits), b.map(f64::to_bits));
        let (mut m, mut once) = (a, [8.0, 8.0, 16.0]);
        reduce(&mut m, &mut once);
        assert_eq!(once.map(f64::to_bits), b.map(f64::to_bits));
        // The same, twice as much beside it.
        let mut many = [8.0, 16.0, 8.0, 16.0, 16.0, 32.0];
        c.forward_many(&mut many, 2);
        for (pair, b) in many.chunks(2).zip(b) {
            assert!((pair[0] - b).abs() < 1e-12 && (pair[1] - 2.0 * b).abs() < 1e-12);
        }
        c.backward(&mut b);
        assert!((b[0] - 1.0).abs() < 1e-12 && (b[1] - 2.0).abs() < 1e-12 && b[2] == 0.0);
    }
}
