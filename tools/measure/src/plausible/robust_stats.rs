//! Medians, robust spreads, differences.

pub(super) use rtec_model::record::median;
use rtec_model::record::span;

/// For each value the median of the other values.
pub(super) fn medians_of_others(v: &[f64]) -> Vec<f64> {
    let mut sorted = v.to_vec();
    sorted.sort_by(f64::total_cmp);
    let middle = (v.len().max(1) - 1) / 2;
    let of = |x: &f64| {
        let own = sorted.partition_point(|s| s.total_cmp(x).is_lt());
        sorted.get(if middle < own { middle } else { middle + 1 }).copied().unwrap_or(0.0)
    };
    v.iter().map(of).collect()
}

/// Robust standard deviation about 0: 1.4826 times the median absolute value.
pub(super) fn spread(v: &[f64]) -> f64 {
    1.4826 * median(v.iter().map(|v| v.abs()))
}

/// Largest less smallest value; 0 of no values.
pub(super) fn range(v: &[f64]) -> f64 {
    let [l, h] = span(v);
    (h - l).max(0.0)
}

/// Range of the middle 90 % of the values.
pub(super) fn middle_range(v: &[f64]) -> f64 {
    let mut v = v.to_vec();
    v.sort_by(f64::total_cmp);
    let at = |share: f64| v[((v.len() - 1) as f64 * share).round() as usize];
    if v.is_empty() { 0.0 } else { at(0.95) - at(0.05) }
}

/// Smallest difference between two different values; 0 if all are equal.
pub(super) fn quantum(v: &[f64]) -> f64 {
    let mut v = v.to_vec();
    v.sort_by(f64::total_cmp);
    let size = v.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
    let steps = v.windows(2).map(|w| w[1] - w[0]).filter(|d| *d > 1e-9 * size);
    let least = steps.fold(f64::INFINITY, f64::min);
    if least.is_finite() { least } else { 0.0 }
}

/// The longest run of one value: first row and the row after the last.
pub(super) fn longest_run(v: &[f64]) -> (usize, usize) {
    let (mut best, mut start) = ((0, 0), 0);
    for i in 0..=v.len() {
        if i == v.len() || v[i].to_bits() != v[start].to_bits() {
            if i - start > best.1 - best.0 {
                best = (start, i);
            }
            start = i;
        }
    }
    best
}

/// Number of different values.
pub(super) fn distinct(v: &[f64]) -> usize {
    let mut v = v.to_vec();
    v.sort_by(f64::total_cmp);
    v.dedup();
    v.len()
}

/// Differences of neighbouring values.
pub(super) fn steps(v: &[f64]) -> Vec<f64> {
    v.windows(2).map(|w| w[1] - w[0]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The same as leaving each value out in turn.
    /// 100 000 values must not take quadratic time.
    #[test]
    fn the_median_of_the_others_is_that_without_the_one() {
        let value = |i: usize| ((i * i * 7 + 3 * i) % 11) as f64;
        for n in 1..14 {
            let v: Vec<f64> = (0..n).map(value).collect();
            let without = |i: usize| median((0..n).filter(|j| *j != i).map(|j| v[j]));
            assert_eq!(medians_of_others(&v), (0..n).map(without).collect::<Vec<_>>());
        }
        let many: Vec<f64> = (0..100_000).map(value).collect();
        assert_eq!(medians_of_others(&many).len(), many.len());
    }
}
