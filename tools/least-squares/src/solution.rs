//! The values of columns that explain a response best, and their uncertainty.

use crate::factor::{QrFactor, dot};
#[cfg(feature = "matrices")]
use nalgebra::DMatrix;

/// Share of a column below which it is rounding.
const ROUNDING: f64 = 1e-9;

/// A least-squares solution.
#[derive(Debug, Clone)]
pub struct Solution {
    /// One value per column, in the response's unit per the column's.
    pub values: Vec<f64>,
    /// Residual of the response, row by row.
    pub residual: Vec<f64>,
    /// Share of each column, 0 to 1, that those before it do not explain.
    pub independent: Vec<f64>,
    /// Rows of R⁻¹ in the columns' units.
    inverse: Vec<Vec<f64>>,
}

impl Solution {
    /// Sum of the squared residuals.
    pub fn left(&self) -> f64 {
        dot(&self.residual, &self.residual)
    }

    /// Covariance of the values if each row has the variance one.
    #[cfg(feature = "matrices")]
    pub fn covariance(&self) -> DMatrix<f64> {
        let p = self.values.len();
        DMatrix::from_fn(p, p, |i, j| dot(&self.inverse[i], &self.inverse[j]))
    }

    /// Standard deviation of each value if each row has the variance one.
    pub fn spread(&self) -> Vec<f64> {
        self.inverse.iter().map(|row| dot(row, row).sqrt()).collect()
    }
}

/// Least-squares values of the columns of a response.
///
/// # Errors
/// The index of the first column that is zero or that those before it explain.
pub fn solve<C: AsRef<[f64]>>(columns: &[C], y: &[f64]) -> Result<Solution, usize> {
    let mut factor = QrFactor::new(y);
    let mut sizes = Vec::with_capacity(columns.len());
    let mut independent = Vec::with_capacity(columns.len());
    for (k, column) in columns.iter().map(AsRef::as_ref).enumerate() {
        let size = dot(column, column).sqrt();
        let unit: Vec<f64> = column.iter().map(|v| v / size).collect();
        // A size of zero, or one that is not finite, gives no share.
        let share = if size > 0.0 { factor.push_free(&unit) } else { 0.0 };
        if share.is_nan() || share <= ROUNDING {
            return Err(k);
        }
        sizes.push(size);
        independent.push(share);
    }
    let values = factor.solve().iter().zip(&sizes).map(|(v, size)| v / size).collect();
    let mut inverse = factor.inverse();
    inverse.iter_mut().zip(&sizes).for_each(|(row, size)| row.iter_mut().for_each(|v| *v /= size));
    Ok(Solution { values, residual: factor.residual().to_vec(), independent, inverse })
}

/// As many rows as columns, with the same solution when joined with other rows.
/// They are the triangle of the columns' factors and the products of the response.
pub fn compress_rows(columns: &[Vec<f64>], y: &[f64]) -> (Vec<Vec<f64>>, Vec<f64>) {
    let p = columns.len();
    if y.len() <= p {
        return (columns.to_vec(), y.to_vec());
    }
    let mut factor = QrFactor::new(y);
    for column in columns {
        factor.push_free(column);
    }
    let padded = |own: &Vec<f64>| {
        let mut own = own.clone();
        own.resize(p, 0.0);
        own
    };
    (factor.triangle().iter().map(padded).collect(), factor.along().to_vec())
}

#[cfg(all(test, feature = "matrices"))]
mod tests {
    use super::*;

    /// The line through 1, 2, 4 at 0, 1, 2: 5/6 + 3/2 x, by hand.
    #[test]
    fn fits_a_line_as_by_hand() {
        let found = solve(&[vec![1.0, 1.0, 1.0], vec![0.0, 1.0, 2.0]], &[1.0, 2.0, 4.0]).unwrap();
        assert!((found.values[0] - 5.0 / 6.0).abs() < 1e-14 && (found.values[1] - 1.5).abs() < 1e-14);
        assert!((found.left() - 1.0 / 6.0).abs() < 1e-14);
        let covariance = found.covariance();
        assert!((covariance[(0, 0)] - 5.0 / 6.0).abs() < 1e-14 && (covariance[(1, 1)] - 0.5).abs() < 1e-14);
        assert!((covariance[(0, 1)] + 0.5).abs() < 1e-14);
        assert!((found.spread()[1] - 0.5_f64.sqrt()).abs() < 1e-14);
    }

    /// A column of ones, and one that differs from it by a hundred-millionth.
    /// Products of the columns would lose the difference entirely.
    #[test]
    fn keeps_digits_that_products_of_columns_lose() {
        let n = 20;
        let near: Vec<f64> = (0..n).map(|i| 1.0 + 1e-8 * f64::from(i)).collect();
        let y: Vec<f64> = near.iter().map(|x| 3.0 * x - 2.0).collect();
        let found = solve(&[vec![1.0; n as usize], near], &y).unwrap();
        assert!((found.values[1] - 3.0).abs() < 1e-5 && (found.values[0] + 2.0).abs() < 1e-5);
    }

    #[test]
    fn says_which_column_is_made_up_by_others() {
        let (a, b) = (vec![1.0, 2.0, 3.0, 5.0], vec![0.0, 1.0, -1.0, 2.0]);
        let sum: Vec<f64> = a.iter().zip(&b).map(|(a, b)| 2.0 * a - b).collect();
        assert_eq!(solve(&[a.clone(), b, sum], &[1.0; 4]).unwrap_err(), 2);
        assert_eq!(solve(&[a, vec![0.0; 4]], &[1.0; 4]).unwrap_err(), 1);
    }

    #[test]
    fn equal_rows_of_stretches_give_the_whole_solution() {
        let value = |i: usize, j: usize| ((i * (2 * j + 3) + 5 * j) as f64 * 0.37).sin();
        let columns: Vec<Vec<f64>> = (0..3).map(|j| (0..40).map(|i| value(i, j)).collect()).collect();
        let y: Vec<f64> = (0..40).map(|i| value(i, 7)).collect();
        let whole = solve(&columns, &y).unwrap();
        let (mut stacked, mut of_y) = (vec![Vec::new(); 3], Vec::new());
        for rows in [0..2, 2..17, 17..40] {
            let own: Vec<Vec<f64>> = columns.iter().map(|c| c[rows.clone()].to_vec()).collect();
            let (equal, along) = compress_rows(&own, &y[rows]);
            stacked.iter_mut().zip(equal).for_each(|(all, own)| all.extend(own));
            of_y.extend(along);
        }
        assert_eq!(of_y.len(), 2 + 3 + 3);
        let again = solve(&stacked, &of_y).unwrap();
        for (a, b) in whole.values.iter().zip(&again.values) {
            assert!((a - b).abs() < 1e-12, "{a} {b}");
        }
    }
}
