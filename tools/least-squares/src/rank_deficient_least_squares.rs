//! Least squares with columns that may depend on each other.

use nalgebra::{DMatrix, DVector, SymmetricEigen};

/// Smallest singular value, for columns of length one, of a direction that is used.
const LEAST: f64 = 1e-3;

/// The directions of the values that columns determine.
#[derive(Debug, Clone)]
pub struct DeterminedDirections {
    /// Maps rows to values: of several solutions the smallest.
    to_values: DMatrix<f64>,
    /// Covariance of the values if each row has the variance one.
    pub covariance: DMatrix<f64>,
    /// Share of each value that lies in the determined directions, 0 to 1.
    pub resolution: Vec<f64>,
}

impl DeterminedDirections {
    /// Directions determined by columns; the lengths of the columns have no effect.
    pub fn by(columns: &DMatrix<f64>) -> Self {
        let p = columns.ncols();
        let lengths: Vec<f64> = columns.column_iter().map(|c| c.norm().max(1e-300)).collect();
        let unit = DMatrix::from_fn(columns.nrows(), p, |r, c| columns[(r, c)] / lengths[c]);
        let parts = unit.qr();
        let found = parts.r().svd(true, true);
        let (Some(u), Some(v_t)) = (found.u, found.v_t) else { unreachable!("both were asked for") };
        let u = parts.q() * u;
        let mut to_values = DMatrix::zeros(p, columns.nrows());
        let mut resolution = vec![0.0; p];
        for (k, size) in found.singular_values.iter().enumerate().filter(|(_, size)| **size > LEAST) {
            let v = v_t.row(k).transpose();
            to_values.ger(1.0 / size, &v, &u.column(k), 1.0);
            resolution.iter_mut().zip(v.iter()).for_each(|(r, v)| *r += v * v);
        }
        for (mut row, length) in to_values.row_iter_mut().zip(&lengths) {
            row /= *length;
        }
        let covariance = &to_values * to_values.transpose();
        Self { to_values, covariance, resolution }
    }

    /// The values that explain a response best.
    pub fn solve(&self, y: &DVector<f64>) -> DVector<f64> {
        &self.to_values * y
    }

    /// The values that explain each of several responses best, one column each.
    pub fn solve_all(&self, responses: &DMatrix<f64>) -> DMatrix<f64> {
        &self.to_values * responses
    }
}

/// Orthonormal columns that span the same space.
pub fn orthonormal(columns: DMatrix<f64>) -> DMatrix<f64> {
    if columns.ncols() == 0 { columns } else { columns.qr().q() }
}

/// What remains of a column after projection on orthonormal ones.
/// Not generic, so that it is compiled in this crate only.
pub fn projected_out(orthonormal: &DMatrix<f64>, column: DVector<f64>) -> DVector<f64> {
    let along = orthonormal * orthonormal.tr_mul(&column);
    column - along
}

/// Orthonormal directions of what remains of columns after projection on others.
/// Directions with less than `share` of the largest are left out.
pub fn principal(columns: &DMatrix<f64>, beside: DMatrix<f64>, share: f64) -> Vec<DVector<f64>> {
    let q = orthonormal(beside);
    let found = (columns - &q * q.tr_mul(columns)).svd(true, false);
    let Some(u) = found.u else { unreachable!("it was asked for") };
    let largest = found.singular_values.max();
    let own = (0..u.ncols()).filter(|i| found.singular_values[*i] > share * largest);
    own.map(|i| u.column(i).into_owned()).collect()
}

/// Eigenvalues of a covariance of `k` values with their directions.
/// The largest is the first. The covariance is given by the indices of two values. The orthonormal rows of `without` are projected out.
pub fn projected_eigen(
    k: usize,
    covariance: impl Fn(usize, usize) -> f64,
    without: &[Vec<f64>],
) -> Vec<(f64, Vec<f64>)> {
    eigen(&DMatrix::from_fn(k, k, covariance), without)
}

/// Not generic, so that it is compiled in this crate only.
fn eigen(covariance: &DMatrix<f64>, without: &[Vec<f64>]) -> Vec<(f64, Vec<f64>)> {
    let k = covariance.nrows();
    let project = DMatrix::from_fn(k, k, |i, j| {
        f64::from(u8::from(i == j)) - without.iter().map(|b| b[i] * b[j]).sum::<f64>()
    });
    let found = SymmetricEigen::new(&project * covariance * &project);
    let mut order: Vec<usize> = (0..k).collect();
    order.sort_by(|a, b| found.eigenvalues[*b].total_cmp(&found.eigenvalues[*a]));
    order
        .into_iter()
        .map(|i| (found.eigenvalues[i], found.eigenvectors.column(i).iter().copied().collect()))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of two equal columns each gets half of the value, and half of it is determined.
    #[test]
    fn of_several_answers_gives_the_smallest() {
        let columns = DMatrix::from_column_slice(3, 3, &[1.0, 2.0, 2.0, 1.0, 2.0, 2.0, 0.0, 1.0, -1.0]);
        let shown = DeterminedDirections::by(&columns);
        let values = shown.solve(&DVector::from_column_slice(&[4.0, 8.0, 8.0]));
        assert!((values[0] - 2.0).abs() < 1e-12 && (values[1] - 2.0).abs() < 1e-12, "{values}");
        assert!(values[2].abs() < 1e-12);
        let expected = [0.5, 0.5, 1.0];
        assert!(shown.resolution.iter().zip(expected).all(|(r, e)| (r - e).abs() < 1e-12));
        assert!((shown.covariance[(2, 2)] - 0.5).abs() < 1e-12);
    }

    #[test]
    fn principal_directions_are_beside_the_others() {
        let others = DMatrix::from_column_slice(4, 1, &[1.0, 1.0, 1.0, 1.0]);
        let columns = DMatrix::from_column_slice(4, 2, &[1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0, 4.0]);
        let found = principal(&columns, others.clone(), 0.1);
        assert_eq!(found.len(), 1);
        assert!(found[0].dot(&others.column(0)).abs() < 1e-12 && (found[0].norm() - 1.0).abs() < 1e-12);
    }
}
