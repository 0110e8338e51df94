//! What is named beside something that no name explains, and what is said where names leave much.

#![allow(clippy::unwrap_used)] // a test's own helpers

use crate::noise::noise;
use rtec_model::machine::Machine;
use rtec_model::record::{Column, Kind, Record, Role};
use rtec_reconcile::{Options, Reconciliation, Verdict, reconcile};
use std::f64::consts::TAU;
use std::path::Path;

fn record(kind: Kind, columns: Vec<(&str, &str, Vec<f64>)>) -> Record {
    let columns = columns.into_iter().map(|(n, role, data)| Column::new(n, Role::parse(role).unwrap(), data));
    Record::new(Path::new("r.run.toml"), kind, columns.collect()).unwrap()
}

fn answer(record: Record) -> Reconciliation {
    reconcile(&[record], &[], &Machine::ideal("m"), &Options::default()).unwrap()
}

fn names(r: &Reconciliation) -> Vec<String> {
    r.effects.iter().map(|(f, _)| f.effect.name()).collect()
}

/// A ring, probed every three degrees, three times around.
fn ring(seed: u64, error: impl Fn(f64) -> f64) -> Record {
    let mut normal = noise(seed);
    let angle: Vec<f64> = (0..360).map(|i| TAU * f64::from(i % 120) / 120.0).collect();
    let e = angle.iter().map(|a| error(*a) + 0.3 * normal()).collect();
    let t = (0..360).map(|i| 4.0 * f64::from(i)).collect();
    record(Kind::Probing, vec![("t", "time", t), ("a", "angle", angle), ("e", "error.r", e)])
}

/// Teeth, steps and a wave that quickens are no bumps and no lobes, however many of them come near.
#[test]
fn parts_of_an_unknown_curve_over_the_angle_have_no_name() {
    let saw = |a: f64| 8.0 * ((3.3 * a / TAU).rem_euclid(1.0) - 0.5);
    let steps = |a: f64| 5.0 * (3.0 * a + 0.6).sin().signum();
    let chirp = |a: f64| 6.0 * (1.2 * a * a).sin();
    for (k, r) in [answer(ring(21, saw)), answer(ring(22, steps)), answer(ring(23, chirp))].iter().enumerate()
    {
        assert_eq!(r.verdict, Verdict::UnknownEffect, "{k}: {:?}", names(r));
        assert!(r.effects.is_empty(), "{k}: {:?}", names(r));
        assert_eq!(r.model.effects().count(), 0);
    }
}

/// Three lobes and a bump are what they are.
#[test]
fn a_bump_beside_lobes_is_named() {
    let bump = |a: f64| if (a - 2.0).abs() < 0.4 { 3.0 * (1.0 + (TAU * (a - 2.0) / 0.8).cos()) } else { 0.0 };
    let r = answer(ring(24, |a| bump(a) + 4.0 * (3.0 * a + 0.5).cos()));
    assert_eq!(r.verdict, Verdict::Named, "{:?}", r.unexplained);
    let mut all = names(&r);
    all.sort();
    assert_eq!(all, ["form_bump", "probe_lobing"]);
}

/// A plate with a hill in one place.
fn plate(seed: u64, error: impl Fn(f64, f64) -> f64) -> Record {
    let mut normal = noise(seed);
    let places = (0..2).flat_map(|_| 0..8).flat_map(|j| (0..9).map(move |i| (f64::from(i), f64::from(j))));
    let (x, y): (Vec<f64>, Vec<f64>) = places.map(|(i, j)| (50.0 * i, 40.0 * j)).unzip();
    let e = x.iter().zip(&y).map(|(x, y)| error(*x, *y) + 0.3 * normal()).collect();
    let none = x.iter().map(|_| 0.3 * normal()).collect();
    let t = (0..x.len()).map(|i| 8.0 * i as f64).collect();
    let columns = vec![
        ("t", "time", t),
        ("x", "position.x", x),
        ("y", "position.y", y),
        ("ex", "error.x", e),
        ("ey", "error.y", none),
    ];
    record(Kind::Plate, columns)
}

/// Its section along one axis is no map: that closes a tenth of the gap.
#[test]
fn a_hill_in_the_plane_is_no_map_of_an_axis() {
    let hill = |x: f64, y: f64| 14.0 * (-((x - 260.0) / 60.0).powi(2) - ((y - 130.0) / 50.0).powi(2)).exp();
    let r = answer(plate(25, hill));
    assert_eq!(r.verdict, Verdict::UnknownEffect, "{:?}", names(&r));
    assert!(r.effects.is_empty(), "{:?}", names(&r));
}

/// A scale beside it is named as what it is.
#[test]
fn a_scale_beside_what_has_no_name_is_named() {
    let mut normal = noise(26);
    let p: Vec<f64> = (0..300).map(|i| (f64::from(i) * 61.803_398_875) % 500.0).collect();
    let t: Vec<f64> = (0..300).map(|i| 6.0 * f64::from(i)).collect();
    let saw = |t: f64| 6.0 * ((t / 290.0).rem_euclid(1.0) - 0.5);
    let e = p.iter().zip(&t).map(|(p, t)| 20.0 * p / 1000.0 + saw(*t) + 0.3 * normal()).collect();
    let r = answer(record(
        Kind::Positioning,
        vec![("t", "time", t), ("p", "position.x", p), ("e", "error.x", e)],
    ));
    assert_eq!(r.verdict, Verdict::UnknownEffect, "{:?}", names(&r));
    assert_eq!(names(&r), ["scale.x"], "{:?}", r.unexplained);
    assert!((r.effects[0].0.effect.scalar(0) - 20.0).abs() < 2.5);
}
