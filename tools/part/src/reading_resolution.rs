//! The step in which measured values are written.
//! A caliper has 0.01 mm, an indicator a thousandth of an inch.

use std::f64::consts::PI;

/// The largest step of which all values are multiples.
/// It is 1, 2 or 5 times a decimal fraction of a mm, or of an inch. Values are in mm; `None` below a
/// nanometre.
pub(crate) fn written_step_mm(values: &[f64]) -> Option<f64> {
    // Values computed from written ones are off by less than a hundredth of a nanometre.
    let all = |step: f64| values.iter().all(|v| (v - (v / step).round() * step).abs() < 1e-8);
    let decades = (-1..=6).map(|k| 0.1_f64.powi(k));
    let mut steps: Vec<f64> =
        decades.flat_map(|ten| [5.0, 2.0, 1.0].map(|n| n * ten)).flat_map(|mm| [mm, 25.4 * mm]).collect();
    steps.retain(|step| *step >= 1e-6);
    steps.sort_by(|a, b| b.total_cmp(a));
    steps.into_iter().find(|step| all(*step)).filter(|_| values.iter().any(|v| *v != 0.0))
}

/// The largest error that rounding leaves in a mean of values that scatter by `sd`.
/// Noise dithers the steps (Widrow, "A study of rough amplitude quantization", 1956).
pub(crate) fn left_in_mean(step: f64, sd: f64) -> f64 {
    // The observed scatter includes that of the rounding.
    let noise = (sd * sd - step * step / 12.0).max(0.0).sqrt();
    0.5 * step * (-2.0 * (PI * noise / step).powi(2)).exp()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_the_step_that_values_are_written_in() {
        for (values, step) in [
            (&[38.11, 38.1, 38.12][..], 0.01),
            (&[0.005, 0.015, -0.01], 0.005),
            (&[0.0254, 0.0508, 0.1016], 0.0254),
            (&[38.1125, 38.1112, 0.5], 0.000_1),
            (&[38.112_503, 38.111_2], 0.000_001),
        ] {
            let found = written_step_mm(values).unwrap();
            assert!((found / step - 1.0).abs() < 1e-9, "{values:?}: {found}");
        }
        assert_eq!(written_step_mm(&[]), None);
        assert!((left_in_mean(10.0, 0.0) - 5.0).abs() < 1e-12);
        assert!(left_in_mean(1.0, 1.0) < 1e-6);
    }
}
