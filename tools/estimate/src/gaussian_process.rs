//! Smooth functions of one variable as a few columns.
//! Each is a Gaussian process on knots, without straight lines.

use crate::priors::SMOOTH_RANK;

/// Knots over these values.
/// They are the values if there are few, and evenly spread otherwise.
#[must_use]
pub fn knots(values: &[f64], most: usize) -> Vec<f64> {
    let mut sorted: Vec<f64> = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let (Some(lo), Some(hi)) = (sorted.first().copied(), sorted.last().copied()) else { return Vec::new() };
    if hi <= lo {
        return Vec::new();
    }
    let close = (hi - lo) / 1000.0;
    let mut distinct: Vec<f64> = Vec::new();
    for v in &sorted {
        if distinct.last().is_none_or(|d| v - d > close) {
            distinct.push(*v);
        }
    }
    if distinct.len() <= most {
        return distinct;
    }
    let even: Vec<f64> = (0..most).map(|i| lo + (hi - lo) * i as f64 / (most - 1) as f64).collect();
    // A knot far from all data would be undetermined.
    let pitch = (hi - lo) / (most - 1) as f64;
    let near = |k: &f64| {
        let i = sorted.partition_point(|v| v < k);
        [i.checked_sub(1), Some(i)]
            .into_iter()
            .flatten()
            .filter_map(|i| sorted.get(i))
            .any(|v| (v - k).abs() <= pitch)
    };
    even.into_iter().filter(near).collect()
}

/// Weights of the two neighbouring knots in the value at `x`.
#[must_use]
pub fn shares(knots: &[f64], x: f64) -> [(usize, f64); 2] {
    let after = knots.partition_point(|k| *k <= x);
    if after == 0 || after == knots.len() {
        let end = after.saturating_sub(1);
        return [(end, 1.0), (end, 0.0)];
    }
    let w = (x - knots[after - 1]) / (knots[after] - knots[after - 1]);
    [(after - 1, 1.0 - w), (after, w)]
}

/// Kernel of a Gaussian process, with its correlation length ℓ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Kernel {
    /// exp(−½ (d/ℓ)²)
    Smooth(f64),
    /// (1 + d/ℓ) exp(−d/ℓ): straight pieces with kinks (Matérn 3/2).
    Kinked(f64),
    /// exp(−d/ℓ): a mean-reverting walk.
    Rough(f64),
}

/// Directions over knots, each times its standard deviation.
/// The process has unit variance, and `without` (rows over the knots) is projected out; at most `most` directions.
#[must_use]
pub fn directions(knots: &[f64], kernel: Kernel, without: &[Vec<f64>], most: usize) -> Vec<Vec<f64>> {
    let k = knots.len();
    if k < 2 {
        return Vec::new();
    }
    let covariance = |i: usize, j: usize| {
        let d = (knots[i] - knots[j]).abs();
        match kernel {
            Kernel::Smooth(l) => (-0.5 * (d / l).powi(2)).exp(),
            Kernel::Kinked(l) => (1.0 + d / l) * (-d / l).exp(),
            Kernel::Rough(l) => (-d / l).exp(),
        }
    };
    // P = I − orthonormal rows of `without`.
    let mut basis: Vec<Vec<f64>> = Vec::new();
    for row in without {
        let mut v = row.clone();
        for _ in 0..2 {
            for b in &basis {
                let c = rtec_least_squares::dot(&v, b);
                rtec_least_squares::add(&mut v, -c, b);
            }
        }
        let size = rtec_least_squares::dot(&v, &v).sqrt();
        if size > 1e-9 {
            for x in &mut v {
                *x /= size;
            }
            basis.push(v);
        }
    }
    let found = rtec_least_squares::projected_eigen(k, covariance, &basis);
    let largest = found[0].0.max(1e-300);
    found
        .into_iter()
        .take_while(|(value, _)| *value > SMOOTH_RANK * largest)
        .take(most)
        .map(|(value, vector)| vector.iter().map(|v| v * value.sqrt()).collect())
        .collect()
}
