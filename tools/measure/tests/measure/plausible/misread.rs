//! Sensors that leap: what they read there is in no figure.

use rtec_builders::{column, record};
use rtec_measure::plausible::{in_figures, suspicions};
use rtec_model::record::{Record, RunKind};
use test_needs::dice::Dice;

/// A body that warms by 8 K with 0.03 K of noise, a second one, and an error of
/// 1 µm/K.
fn warming(n: usize, of: impl Fn(usize, f64, &mut Dice) -> f64) -> Record {
    let mut d = Dice::new(39);
    let warm = |i: usize, k: f64, tau: f64| k * (1.0 - (-(i as f64) / tau).exp());
    let mut data: [Vec<f64>; 4] = Default::default();
    for i in 0..n {
        let degc = 20.0 + warm(i, 8.0, 20.0) + 0.03 * d.normal();
        let two = |v: f64| (v * 100.0).round() / 100.0;
        data[0].push(60.0 * i as f64);
        data[1].push(two(of(i, degc, &mut d)));
        data[2].push(two(20.0 + warm(i, 3.0, 40.0) + 0.03 * d.normal()));
        data[3].push(two(warm(i, 8.0, 20.0) + 0.1 * d.normal()));
    }
    let roles = [("t", "time"), ("T1", "temperature"), ("T2", "temperature"), ("e", "error.z")];
    let columns = roles.into_iter().zip(data).map(|((name, role), data)| column(name, role, data));
    record("a", RunKind::Drift, columns.collect())
}

/// The rows of T1 that are said to be bad, and whether a figure holds anything
/// but what the body had.
fn found(record: Record) -> String {
    let records = [record];
    let doubts = suspicions(&records);
    let usable = in_figures(&records, &doubts);
    let kept = usable[0].temperature("T1").unwrap_or_default();
    let off: Vec<&f64> = kept.iter().filter(|v| v.is_finite() && !(19.0..29.0).contains(*v)).collect();
    assert!(off.is_empty(), "{off:?} in figures, {doubts:?}");
    doubts.iter().filter(|s| s.column == "T1").map(|s| s.rows.clone()).collect::<Vec<_>>().join(",")
}

#[test]
fn readings_that_leap_out_and_back_are_in_no_figure() {
    type Misread = fn(usize, f64, &mut Dice) -> f64;
    let cases: [(&str, usize, Misread); 12] = [
        ("1-4", 60, |i, v, _| if i < 4 { 55.0 } else { v }),
        ("1", 60, |i, v, _| if i < 1 { 60.0 } else { v }),
        ("58-60", 60, |i, v, _| if i >= 57 { 90.0 } else { v }),
        ("57-60", 60, |i, v, _| if i >= 56 { 4.0 } else { v }),
        ("31-34", 60, |i, v, _| if (30..34).contains(&i) { 60.0 } else { v }),
        ("31-35", 60, |i, v, d| if (30..35).contains(&i) { 60.0 + 3.0 * d.normal() } else { v }),
        ("31-33", 60, |i, v, _| if (30..33).contains(&i) { v + 12.0 } else { v }),
        ("56-60", 60, |i, v, d| if i >= 55 { 60.0 + 3.0 * d.normal() } else { v }),
        ("1-2", 60, |i, v, d| if i < 2 { 60.0 + 3.0 * d.normal() } else { v }),
        ("11-12,26,41-43", 60, |i, v, d| {
            if [10, 11, 25, 40, 41, 42].contains(&i) { 70.0 + 8.0 * d.normal() } else { v }
        }),
        ("6-8", 16, |i, v, _| if (5..8).contains(&i) { 70.0 } else { v }),
        ("15-16", 16, |i, v, _| if i >= 14 { 70.0 } else { v }),
    ];
    for (rows, n, of) in cases {
        assert_eq!(found(warming(n, of)), rows);
    }
    assert_eq!(found(warming(60, |_, v, _| v)), "");
}

/// A power-on value does not hide what the sensor misreads later.
#[test]
fn a_code_does_not_hide_a_leap() {
    let record = warming(60, |i, v, _| match i {
        0 => 85.0,
        40..43 => 61.5,
        _ => v,
    });
    assert_eq!(found(record), "1,41-43");
}

/// Of a step that stays nothing tells which level was the body's:
/// none is in a figure.
#[test]
fn a_sensor_that_steps_and_stays_is_in_no_figure() {
    let records = [warming(60, |i, v, _| if i >= 30 { v + 12.0 } else { v })];
    let doubts = suspicions(&records);
    assert!(doubts.iter().any(|s| s.column == "T1" && s.rows == "31"), "{doubts:?}");
    assert_eq!(in_figures(&records, &doubts)[0].temperature("T1"), None);
}

/// What a switched body does is its own:
/// fast from row to row, and again and again.
#[test]
fn a_body_that_is_switched_is_not_misread() {
    let pulses =
        warming(60, |i, v, _| v + if i % 10 < 4 { 6.0 * (1.0 - (-((i % 10) as f64)).exp()) } else { 0.0 });
    let doubts = suspicions(std::slice::from_ref(&pulses));
    assert!(doubts.iter().all(|s| s.column != "T1"), "{doubts:?}");
    let warms_at_once = warming(60, |i, v, _| if i < 3 { v - 18.0 * (-(i as f64)).exp() } else { v });
    let doubts = suspicions(std::slice::from_ref(&warms_at_once));
    assert!(doubts.iter().all(|s| s.column != "T1"), "{doubts:?}");
}
