//! Figures of plain lists of numbers.

use std::borrow::Borrow;

/// Smallest and largest of these values; `[∞, −∞]` of none.
pub fn span(values: impl IntoIterator<Item: Borrow<f64>>) -> [f64; 2] {
    let wider = |[low, high]: [f64; 2], v: f64| [low.min(v), high.max(v)];
    values.into_iter().map(|v| *v.borrow()).fold([f64::INFINITY, f64::NEG_INFINITY], wider)
}

/// The mean; NaN of no values.
pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// The median, the upper one of an even number; 0 of no values.
pub fn median(values: impl IntoIterator<Item = f64>) -> f64 {
    let mut v: Vec<f64> = values.into_iter().collect();
    if v.is_empty() {
        return 0.0;
    }
    let n = v.len();
    *v.select_nth_unstable_by(n / 2, f64::total_cmp).1
}
