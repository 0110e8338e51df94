//! The resolution of gauges and clocks.

#![allow(clippy::unwrap_used)] // a test's own helpers

use rtec_measure::gauge_resolution::ReadingResolution;
use rtec_model::record::shared_step;

#[test]
fn a_clock_is_coarse_where_rows_share_its_times() {
    let by =
        |step: f64| -> Vec<f64> { (0..40).map(|i| (f64::from(i) * 7.0 / step).floor() * step).collect() };
    assert_eq!(shared_step(&by(60.0)), Some(60.0));
    for fine in [by(1.0), by(7.0), by(10.0), vec![0.0], Vec::new()] {
        assert_eq!(shared_step(&fine), None, "{fine:?}");
    }
}

fn pairs(n: usize) -> Vec<Vec<usize>> {
    (0..n).step_by(2).map(|i| vec![i, i + 1]).collect()
}

#[test]
fn steps_without_noise_stay_in_the_mean() {
    let readings = [10.0, 10.0, 0.0, 0.0, 10.0, 10.0, 20.0, 20.0, 0.0, 0.0, 10.0, 10.0];
    let steps = ReadingResolution::of(&readings, &pairs(12)).unwrap();
    assert_eq!((steps.step, steps.is_coarse(), steps.half_width()), (10.0, true, 5.0));
    assert!((steps.standard_error() - 10.0 / 12f64.sqrt()).abs() < 1e-12);
}

#[test]
fn noise_of_a_step_takes_the_rounding_out() {
    let readings = [0.0, 3.0, 1.0, -1.0, 2.0, 0.0, -2.0, 1.0, 1.0, -1.0, 0.0, 2.0, -1.0, 1.0];
    let steps = ReadingResolution::of(&readings, &pairs(14)).unwrap();
    assert!(!steps.is_coarse() && steps.half_width() < 1e-3, "{steps:?}");
}

#[test]
fn readings_without_a_step_have_none() {
    let readings: Vec<f64> = (0..40).map(|i| f64::from(i * i) * 0.013_7).collect();
    assert_eq!(ReadingResolution::of(&readings, &pairs(40)), None);
}
