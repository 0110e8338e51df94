//! Causes that look the same at the measured rows.

use crate::noise::noise;
use crate::{answer, record};
use rtec_model::ballbar_circle::Circle;
use rtec_model::record::{Axis, Record, RunKind};
use rtec_reconcile::{ReconciliationResult, Verdict};
use std::f64::consts::TAU;
use test_needs::repetitions;

/// A run both ways over the targets, with a wave of 3 µm and noise of 0.1 µm.
fn wave(name: &str, targets: &[f64], cycles: usize, period_mm: f64, seed: u64) -> Record {
    let mut normal = noise(seed);
    let way = targets.iter().chain(targets.iter().rev()).copied();
    let places: Vec<f64> = (0..cycles).flat_map(|_| way.clone()).collect();
    let way = |i: usize| if i % (2 * targets.len()) < targets.len() { 1.0 } else { -1.0 };
    let n = places.len();
    let error = places.iter().map(|y| 3.0 * (TAU * y / period_mm + 0.5).sin() + 0.1 * normal());
    let columns = vec![
        ("t", "time", (1..=n).map(|i| 5.0 * i as f64).collect()),
        ("e", "error.y", error.collect()),
        ("d", "direction.y", (0..n).map(way).collect()),
        ("y", "position.y", places.clone()),
    ];
    record(name, RunKind::Positioning, columns)
}

fn periods_mm(r: &ReconciliationResult) -> Vec<f64> {
    let (found, _) = &r.effects[0];
    let others = found.rivals.iter().filter_map(|r| Some(r.differs.as_ref()?.1));
    std::iter::once(found.effect.scalar(0)).chain(others).collect()
}

/// The targets of both runs are multiples of 0.08 mm.
/// A signal period of 40 µm therefore looks the same as a lead, to the last digit.
#[test]
fn runs_on_grids_with_a_common_step_show_no_period_below_two_of_them() {
    let even: Vec<f64> = (0..12).map(|i| 26.0 * f64::from(i)).collect();
    let uneven = [8.0, 49.12, 78.72, 131.36, 160.96, 190.56, 243.2, 272.8, 325.44, 355.04, 392.0];
    for seed in repetitions([9, 10, 11]) {
        let runs = [wave("even", &even, 3, 43.3398, seed), wave("uneven", &uneven, 2, 43.3398, seed + 50)];
        let r = answer("", &runs, &[]);
        assert_eq!(r.effects[0].0.effect.name(), "screw_periodic.y", "{}", r.verdict);
        assert!(periods_mm(&r).iter().any(|p| (p - 43.34).abs() < 0.1), "{:?}", periods_mm(&r));
    }
}

/// Eleven places nearly fit many waves.
/// The true wave is between two of the grid's frequencies.
#[test]
fn a_wave_between_frequencies_of_the_grid_is_found_at_few_places() {
    if !test_needs::long() {
        return;
    }
    let near = [
        7.9988, 49.121, 78.7187, 131.3605, 160.9588, 190.5607, 243.2015, 272.7999, 325.4426, 355.0392, 392.0,
    ];
    for (seed, period_mm) in [(1, 43.34), (2, 43.34), (4, 57.3)] {
        let r = answer("", &[wave("near", &near, 2, period_mm, seed)], &[]);
        let found = periods_mm(&r);
        assert_eq!(r.effects[0].0.effect.name(), "screw_periodic.y", "{period_mm}: {} {found:?}", r.verdict);
        assert!(found.iter().any(|p| (p / period_mm - 1.0).abs() < 0.01), "{period_mm}: {found:?}");
    }
}

/// A verdict that is not separable lists the rivals that make it so.
#[test]
fn a_verdict_that_is_not_separable_has_its_rivals() {
    let even: Vec<f64> = (0..12).map(|i| 26.0 * f64::from(i)).collect();
    for (seed, period_mm) in [(9, 10.0), (5, 10.0), (7, 18.57), (8, 43.34)] {
        let r = answer("", &[wave("even", &even, 3, period_mm, seed)], &[]);
        let (found, _) = &r.effects[0];
        assert!(r.verdict != Verdict::NotSeparable || !found.rivals.is_empty(), "{period_mm}: {}", r.advice);
    }
}

/// A bow of Z's guideway, seen by a circle in X and Z.
/// An angular error that grows along Z looks the same, apart from the circle's centre.
#[test]
fn a_bow_that_a_circle_shows_has_the_angular_error_as_its_rival() {
    if !test_needs::long() {
        return;
    }
    for (seed, bow_um) in [(1, 6.0), (2, -4.0), (3, 12.0)] {
        let mut normal = noise(seed);
        let angles: Vec<f64> = (0..720).map(|i| TAU * f64::from(i) / 720.0).collect();
        let of = |f: &dyn Fn(f64) -> f64| angles.iter().map(|a| f(*a)).collect::<Vec<f64>>();
        let error = angles.iter().map(|a| a.sin() * bow_um * (1.0 - a.cos().powi(2)) + 0.2 * normal());
        let columns = vec![
            ("t", "time", (0..720).map(|i| 0.05 * f64::from(i)).collect()),
            ("a", "angle", angles.clone()),
            ("x", "position.x", of(&|a| 150.0 * a.sin())),
            ("z", "position.z", of(&|a| 150.0 * a.cos())),
            ("e", "error.r", error.collect()),
        ];
        let plane = [Axis::new("z").unwrap(), Axis::new("x").unwrap()];
        let circle = Circle { radius_mm: 150.0, plane, centre_mm: None };
        let run = record("bow", RunKind::Ballbar, columns).with_circle(circle).unwrap();
        let r = answer("", &[run], &[]);
        let (found, _) = &r.effects[0];
        let rivals: Vec<&str> = found.rivals.iter().map(|r| r.name.as_str()).collect();
        assert_eq!(r.verdict, Verdict::NotSeparable, "{bow_um}: {} {rivals:?}", found.effect.name());
        assert!(!rivals.is_empty());
    }
}
