//! Rounding of figures to their uncertainty, which is shown with two digits.

/// Decimals at which an uncertainty has two digits; four if there is none.
fn decimals(half: f64) -> usize {
    if half.is_finite() && half > 0.0 { (1.0 - half.log10().floor()).clamp(0.0, 12.0) as usize } else { 4 }
}

/// A value with half its 95 % interval: `4.9950 ± 0.0031`.
pub(crate) fn with_half(value: f64, half: f64) -> String {
    let n = decimals(half);
    format!("{value:.n$} ± {half:.n$}")
}

/// A value with the bounds of its 95 % interval: `4.9950  [4.9919, 4.9983]`.
pub(crate) fn with_bounds(value: f64, low: f64, high: f64) -> String {
    let [value, low, high] = alike([value, low, high]);
    format!("{value:>12}  [{low}, {high}]")
}

/// The value and both bounds, rounded alike.
pub(crate) fn alike([value, low, high]: [f64; 3]) -> [String; 3] {
    let n = decimals((high - low) / 2.0);
    [value, low, high].map(|v| format!("{v:.n$}"))
}

#[cfg(test)]
mod tests {
    use super::{with_bounds, with_half};

    #[test]
    fn two_digits_of_the_uncertainty_are_shown() {
        assert_eq!(with_half(4.995_123_4, 0.003_12), "4.9951 ± 0.0031");
        assert_eq!(with_half(1107.546, 23.4), "1108 ± 23");
        assert_eq!(with_half(-0.000_812_3, 0.000_002), "-0.0008123 ± 0.0000020");
        assert_eq!(with_half(12.0, 0.0), "12.0000 ± 0.0000");
        assert_eq!(with_half(123.4, 4567.0), "123 ± 4567");
        assert_eq!(with_bounds(0.020_2, 0.019_9, 0.020_5).trim(), "0.02020  [0.01990, 0.02050]");
    }
}
