//! Medians, robust deviations, straight lines.

/// The median; 0 of nothing.
pub(super) fn median(mut v: Vec<f64>) -> f64 {
    if v.is_empty() {
        return 0.0;
    }
    let n = v.len();
    let (_, m, _) = v.select_nth_unstable_by(n / 2, f64::total_cmp);
    *m
}

/// Median of the sizes, scaled to the standard deviation of a normal distribution.
pub(super) fn spread(v: &[f64]) -> f64 {
    1.4826 * median(v.iter().map(|v| v.abs()).collect())
}

/// Smallest and largest.
pub(super) fn span(v: &[f64]) -> [f64; 2] {
    v.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], x| [l.min(*x), h.max(*x)])
}

/// Largest less smallest; 0 of nothing.
pub(super) fn range(v: &[f64]) -> f64 {
    let [l, h] = span(v);
    (h - l).max(0.0)
}

/// The range that the middle 90 % take.
pub(super) fn middle_range(v: &[f64]) -> f64 {
    let mut v = v.to_vec();
    v.sort_by(f64::total_cmp);
    let at = |share: f64| v[((v.len() - 1) as f64 * share).round() as usize];
    if v.is_empty() { 0.0 } else { at(0.95) - at(0.05) }
}

/// The smallest step between two different values; 0 where there is only one.
pub(super) fn quantum(v: &[f64]) -> f64 {
    let mut v = v.to_vec();
    v.sort_by(f64::total_cmp);
    let size = v.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
    let steps = v.windows(2).map(|w| w[1] - w[0]).filter(|d| *d > 1e-9 * size);
    let least = steps.fold(f64::INFINITY, f64::min);
    if least.is_finite() { least } else { 0.0 }
}

/// How many different values.
pub(super) fn distinct(v: &[f64]) -> usize {
    let mut v = v.to_vec();
    v.sort_by(f64::total_cmp);
    v.dedup();
    v.len()
}

/// The differences of neighbours.
pub(super) fn steps(v: &[f64]) -> Vec<f64> {
    v.windows(2).map(|w| w[1] - w[0]).collect()
}
