//! Structure that no law describes: maps, bends and slow drift.
//! It is fitted beside the laws so that no law absorbs it, and it widens their intervals.
//!
//! Structure that depends on the place alone is the same in both directions of rotation: common harmonics of
//! the angle. Orders from three up are fitted. Orders 0 to 2 are radius, centre, scale and squareness. How
//! much structure adds to those orders is estimated from the orders just above.

use super::CircleTrace;
use nalgebra::{DMatrix, DVector};
use rtec_least_squares::principal;
use rtec_model::record::Role;
use std::f64::consts::TAU;

/// Highest order of the laws: radius (0), centre (1), scale and squareness (2).
const TAKEN: usize = 2;
/// Highest order that is fitted beside the laws.
const HIGHEST: usize = 20;
/// Orders from which the structure in orders 0 to 2 is estimated.
const TELLING: [usize; 4] = [3, 4, 5, 6];

/// Harmonics common to both directions of rotation, cosine and sine of each order.
/// With one direction only smoothness separates them from reversals.
#[derive(Clone)]
pub(super) struct UnexplainedHarmonics {
    /// Whether both directions of rotation were measured.
    pub(super) both_ways: bool,
    /// Columns over all rows.
    pub(super) columns: DMatrix<f64>,
    /// Highest order fitted; below 3: none.
    highest: usize,
    /// Rows of the shortest contour.
    rows: usize,
    /// Whether a record leaves out a part of the circle.
    /// Then the harmonics are correlated with one another and with the laws' orders.
    arc: bool,
    /// Columns of the orders that the laws take: 1, cos, sin, cos 2, sin 2.
    pub(super) taken: DMatrix<f64>,
}

/// Variance that structure adds to the laws' orders, and degrees of freedom.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct StructureVariance {
    /// Variance of the amplitude of each order: 1, cos, sin, cos 2, sin 2, µm².
    pub(super) variance: [f64; 5],
    /// Degrees of freedom of each variance.
    pub(super) freedom: [f64; 5],
    /// RMS of all that was fitted, µm.
    pub(super) rms_um: f64,
}

impl UnexplainedHarmonics {
    /// Harmonics of these records, of `n` rows altogether.
    pub(super) fn of(traces: &[CircleTrace], n: usize) -> Self {
        let angles = || traces.iter().flat_map(|t| t.angle.iter().copied());
        let senses = || traces.iter().flat_map(|t| &t.contours).map(|c| c.1);
        let both = senses().any(|s| s > 0.0) && senses().any(|s| s < 0.0);
        let rows = traces.iter().flat_map(|t| &t.contours).map(|c| c.0.len()).min().unwrap_or(0);
        // The highest order has at least a dozen rows per wave.
        let highest = HIGHEST.min(rows / 12);
        let orders = |from: usize, to: usize| -> Vec<DVector<f64>> {
            let both = |k: usize| {
                [f64::cos as fn(f64) -> f64, f64::sin]
                    .map(|f| DVector::from_iterator(n, angles().map(|a| f(k as f64 * a))))
            };
            (from..=to).flat_map(both).collect()
        };
        let columns = matrix_of(n, &orders(TAKEN + 1, highest));
        let mut taken = vec![DVector::from_element(n, 1.0)];
        taken.extend(orders(1, TAKEN));
        let taken = matrix_of(n, &taken);
        // Each record has its own centre, so the records do not fill each other's gaps.
        let arc = traces.iter().any(|t| widest_gap(t.angle.clone()) > MISSING_RAD);
        let columns = if arc { apart(columns, &taken) } else { columns };
        Self { both_ways: both, columns, highest, rows, arc, taken }
    }

    /// Variance of sums of the whitened residual, relative to white noise, at least 1.
    /// Above 1 the residual is correlated more than the noise model says.
    pub(super) fn excess_correlation(white: &DVector<f64>) -> f64 {
        let n = white.len();
        let own = white.norm_squared() / n.max(1) as f64;
        let of = |rows: usize| {
            let sums: Vec<f64> = white.as_slice().chunks_exact(rows).map(|c| c.iter().sum::<f64>()).collect();
            let mean = sums.iter().map(|s| s * s).sum::<f64>() / sums.len().max(1) as f64;
            mean / rows as f64 / own.max(1e-300)
        };
        [5, 10, 20].map(of).into_iter().fold(1.0, f64::max)
    }

    /// Autocorrelation of the noise, if the residual's is `seen`.
    /// Fitted harmonics remove low-frequency noise and so bias the autocorrelation; this corrects it.
    pub(super) fn memory(&self, seen: f64, n: usize, most: f64) -> f64 {
        if self.arc {
            return seen.clamp(0.0, most);
        }
        let expected = |phi: f64| {
            let (mut own, mut next) = (1.0, phi);
            for k in TAKEN + 1..=self.highest {
                let c = (TAU * k as f64 / self.rows as f64).cos();
                let taken = 2.0 / n as f64 * (1.0 - phi * phi) / (1.0 - 2.0 * phi * c + phi * phi);
                own -= taken;
                next -= taken * c;
            }
            next / own
        };
        (0..=100).map(|i| most * f64::from(i) / 100.0).find(|phi| expected(*phi) >= seen).unwrap_or(most)
    }

    /// Estimates the structure in the laws' orders from the fitted amplitudes.
    pub(super) fn structure_variance(
        &self,
        amplitude: &DVector<f64>,
        variance: &DVector<f64>,
    ) -> Option<StructureVariance> {
        if self.highest < TELLING[TELLING.len() - 1] {
            return None;
        }
        if self.arc {
            // On an arc no order is independent: each may be as large as all fitted orders together.
            let power: f64 = amplitude.iter().zip(variance).map(|(a, v)| a * a - v).sum::<f64>().max(0.0);
            let freedom = [amplitude.len().clamp(1, TELLING.len()) as f64; 5];
            return Some(StructureVariance { variance: [power; 5], freedom, rms_um: (power / 2.0).sqrt() });
        }
        let at = |k: usize, sine: usize| 2 * (k - TAKEN - 1) + sine;
        let mean = |which: &[(usize, usize)]| {
            // The power of a line with kinks falls with the square of the order.
            let own = |(k, s): &(usize, usize)| {
                (amplitude[at(*k, *s)].powi(2) - variance[at(*k, *s)]) * (*k as f64 / TAKEN as f64).powi(2)
            };
            ((which.iter().map(own).sum::<f64>() / which.len() as f64).max(0.0), which.len() as f64)
        };
        // A map of an axis has even cosines, a bend along the other axis even sines; both have odd orders.
        let odd: Vec<_> = TELLING.iter().filter(|k| *k % 2 == 1).flat_map(|k| [(*k, 0), (*k, 1)]).collect();
        let even = |s: usize| TELLING.iter().filter(|k| *k % 2 == 0).map(|k| (*k, s)).collect::<Vec<_>>();
        let all = |s: usize| [even(s), odd.clone()].concat();
        let each = [mean(&all(0)), mean(&odd), mean(&odd), mean(&all(0)), mean(&all(1))];
        let fitted = 2 * (self.highest - TAKEN);
        let power: f64 = (0..fitted).map(|i| (amplitude[i].powi(2) - variance[i]) / 2.0).sum();
        let (variance, freedom) = (each.map(|e| e.0), each.map(|e| e.1));
        Some(StructureVariance { variance, freedom, rms_um: power.max(0.0).sqrt() })
    }
}

/// Number of columns of [`drift`].
pub(super) const DRIFTS: usize = 3;

/// Linear drift of radius and centre over a record's time; empty without time.
/// Out and back on one path, curved drift is the same in both directions: harmonics include it.
pub(super) fn drift(trace: &CircleTrace, start: usize, n: usize) -> Vec<DVector<f64>> {
    let Some(t) = trace.record.data(&Role::Time) else { return Vec::new() };
    let (from, to) = (t.first().copied().unwrap_or(0.0), t.last().copied().unwrap_or(0.0));
    if to <= from {
        return Vec::new();
    }
    let of = |shape: fn(f64) -> f64| {
        let mut column = DVector::zeros(n);
        for (i, (a, t)) in trace.angle.iter().zip(t).enumerate() {
            column[start + i] = shape(*a) * (2.0 * (t - from) / (to - from) - 1.0);
        }
        column
    };
    vec![of(|_| 1.0), of(f64::cos), of(f64::sin)]
}

/// Gap of the angles above which a record is an arc, rad.
const MISSING_RAD: f64 = 0.2;
/// Least size of an independent shape on an arc, relative to the largest.
const OF_ITS_OWN: f64 = 0.1;

/// The widest angle without a row.
fn widest_gap(mut angles: Vec<f64>) -> f64 {
    for a in &mut angles {
        *a = a.rem_euclid(TAU);
    }
    angles.sort_by(f64::total_cmp);
    let round = angles.first().zip(angles.last()).map_or(TAU, |(first, last)| first + TAU - last);
    angles.windows(2).map(|w| w[1] - w[0]).fold(round, f64::max)
}

/// Independent shapes of harmonics on an arc, orthogonal to the laws' columns.
/// Each is scaled like a harmonic of amplitude one.
fn apart(columns: DMatrix<f64>, taken: &DMatrix<f64>) -> DMatrix<f64> {
    if columns.ncols() == 0 {
        return columns;
    }
    let n = columns.nrows();
    let own = principal(&columns, taken.clone(), OF_ITS_OWN);
    let shapes: Vec<DVector<f64>> = own.into_iter().map(|u| u * (n as f64 / 2.0).sqrt()).collect();
    matrix_of(n, &shapes)
}

/// These columns of `n` rows as a matrix.
pub(super) fn matrix_of(n: usize, all: &[DVector<f64>]) -> DMatrix<f64> {
    if all.is_empty() { DMatrix::zeros(n, 0) } else { DMatrix::from_columns(all) }
}
