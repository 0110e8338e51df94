//! Velocity and acceleration from positions.
//! Against trajectories written down as formulas, and against what the owners of a real axis' record identified from it.

#![allow(clippy::unwrap_used)] // a test's own helpers

use rtec_measure::motion_from_positions::derive;
use rtec_model::record::{Axis, Column, Record, Role, RunKind};
use std::path::Path;

fn x() -> Axis {
    Axis::new("x").unwrap()
}

/// Normal deviates of mean 0 and variance 1, by a generator of the test's own.
fn noise(n: usize, mut state: u64) -> Vec<f64> {
    let mut uniform = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    (0..n).map(|_| (0..12).map(|_| uniform()).sum::<f64>() - 6.0).collect()
}

fn record(kind: RunKind, t: &[f64], p: &[f64]) -> Record {
    let columns = vec![
        Column::new("t", Role::Time, t.to_vec()),
        Column::new("px", Role::Position(x()), p.to_vec()),
        Column::new("e", Role::Error(x()), vec![0.0; t.len()]),
    ];
    Record::new(Path::new("m.run.toml"), kind, columns).unwrap()
}

/// Strokes of 60 mm, each of fifth order in time (at rest at both ends), 0.4 s long, a pause of 0.1 s between; and their
/// first and second derivative.
fn stroke(t: f64) -> [f64; 3] {
    let (n, rest) = ((t / 0.5).floor(), t % 0.5);
    let (length, time) = (60.0, 0.4);
    let (start, sign) = if n % 2.0 == 0.0 { (0.0, 1.0) } else { (length, -1.0) };
    let s = (rest / time).min(1.0);
    let p = 10.0 * s.powi(3) - 15.0 * s.powi(4) + 6.0 * s.powi(5);
    let v = (30.0 * s.powi(2) - 60.0 * s.powi(3) + 30.0 * s.powi(4)) / time;
    let a = (60.0 * s - 180.0 * s.powi(2) + 120.0 * s.powi(3)) / (time * time);
    [start + sign * length * p, sign * length * v, sign * length * a]
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (n, sum) = values.fold((0.0, 0.0), |(n, s), v| (n + 1.0, s + v * v));
    (sum / n).sqrt()
}

/// Derivatives of a record, and their errors against the formula, both RMS.
/// The lag in s that explains most of the velocity's.
fn judged(t: &[f64], noise_mm: f64, resolution_mm: f64) -> ([f64; 2], f64, Vec<String>) {
    let true_: Vec<[f64; 3]> = t.iter().map(|t| stroke(*t)).collect();
    let p: Vec<f64> = true_
        .iter()
        .zip(noise(t.len(), 7))
        .map(|(s, z)| s[0] + noise_mm * z)
        .map(|p| if resolution_mm > 0.0 { (p / resolution_mm).round() * resolution_mm } else { p })
        .collect();
    let mut record = record(RunKind::Dynamics, t, &p);
    let notes = derive(&mut record);
    let (v, a) = (record.data(&Role::Velocity(x())).unwrap(), record.data(&Role::Acceleration(x())).unwrap());
    let ev = rms(v.iter().zip(&true_).map(|(v, s)| v - s[1]));
    let ea = rms(a.iter().zip(&true_).map(|(a, s)| a - s[2]));
    // v(t − lag) = v − lag·a
    let lag = v.iter().zip(&true_).map(|(v, s)| (s[1] - v) * s[2]).sum::<f64>()
        / true_.iter().map(|s| s[2] * s[2]).sum::<f64>();
    ([ev, ea], lag, notes)
}

#[test]
fn a_known_motion_comes_back_in_phase() {
    if !test_needs::long() {
        return;
    }
    let even: Vec<f64> = (0..4000).map(|n| f64::from(n) * 1e-3).collect();
    // Rows that come when they come: 0.4 to 1.6 ms apart.
    let uneven: Vec<f64> = noise(4000, 3)
        .iter()
        .scan(0.0, |t, z| {
            *t += 1e-3 * (1.0 + 0.2 * z).clamp(0.4, 1.6);
            Some(*t)
        })
        .collect();
    let peak = [60.0 * 1.875 / 0.4, 60.0 * 5.7735 / 0.16];
    for (name, t, noise_um, resolution_um, allowed) in [
        ("even, no noise", &even, 0.0, 0.0, [2e-4, 0.03]),
        ("even, 1 µm", &even, 1.0, 0.0, [0.003, 0.03]),
        ("even, 1 µm counts", &even, 0.0, 1.0, [0.003, 0.03]),
        ("even, 10 µm", &even, 10.0, 0.0, [0.006, 0.05]),
        ("uneven, 1 µm", &uneven, 1.0, 0.0, [0.003, 0.03]),
    ] {
        let ([v, a], lag, notes) = judged(t, 1e-3 * noise_um, 1e-3 * resolution_um);
        println!(
            "{name}: velocity {v:.3} mm/s, acceleration {a:.1} mm/s2, lag {:.2} µs; {notes:#?}",
            1e6 * lag
        );
        assert!(v < allowed[0] * peak[0] && a < allowed[1] * peak[1], "{name}");
        assert!(lag.abs() < 5e-6, "{name}: no lag worth a twentieth of a row");
        assert_eq!(notes.len(), 2);
        assert!(notes.iter().all(|n| n.contains("zero phase") && n.contains("standard error")), "{notes:?}");
    }
}

#[test]
fn the_stated_error_is_the_real_one_and_noise_alone_is_no_motion() {
    if !test_needs::long() {
        return;
    }
    let t: Vec<f64> = (0..4000).map(|n| f64::from(n) * 1e-3).collect();
    for noise_um in [0.3, 3.0, 30.0] {
        let (errors, _, notes) = judged(&t, 1e-3 * noise_um, 0.0);
        for (error, note) in errors.iter().zip(&notes) {
            let stated = note.split("standard error ").nth(1).unwrap().split(' ').next().unwrap();
            let stated: f64 = stated.parse().unwrap();
            println!("{noise_um} µm: off by {error:.3} RMS; {note}");
            assert!(*error < 1.5 * stated && *error > 0.4 * stated, "{noise_um}: {error} against {stated}");
        }
    }
    let still: Vec<f64> = noise(2000, 5).iter().map(|z| 10.0 + 1e-3 * z).collect();
    let mut at_rest = record(RunKind::Dynamics, &t[..2000], &still);
    let notes = derive(&mut at_rest);
    assert!(at_rest.data(&Role::Acceleration(x())).is_none(), "{notes:?}");
    assert!(notes.iter().any(|n| n.contains("acceleration.x not derived: noise")), "{notes:?}");
}

#[test]
fn what_is_there_stays_and_what_is_no_motion_is_not_differentiated() {
    let t: Vec<f64> = (0..400).map(|n| f64::from(n) * 1e-3).collect();
    let p: Vec<f64> = t.iter().map(|t| stroke(*t)[0]).collect();
    let mut given = record(RunKind::Dynamics, &t, &p);
    given.columns.push(Column::new("v", Role::Velocity(x()), vec![1.0; 400]));
    assert_eq!(derive(&mut given).len(), 1);
    assert_eq!(given.data(&Role::Velocity(x())).unwrap(), [1.0; 400]);
    let once = given.clone();
    assert!(derive(&mut given).is_empty(), "a second time there is nothing to do");
    assert_eq!(given, once);
    // Targets visited every ten seconds.
    let stops: Vec<f64> = (0..40).map(|n| f64::from(n) * 10.0).collect();
    let mut positioning = record(RunKind::Positioning, &stops, &stops);
    let notes = derive(&mut positioning);
    assert_eq!(positioning.columns.len(), 3);
    assert!(notes[0].contains("10 s apart in a run of kind positioning are readings at stops"), "{notes:?}");
    // Without times, or standing still: nothing to say.
    let columns =
        vec![Column::new("px", Role::Position(x()), p.clone()), Column::new("e", Role::Error(x()), p)];
    let mut timeless = Record::new(Path::new("m.run.toml"), RunKind::Dynamics, columns).unwrap();
    assert!(derive(&mut timeless).is_empty());
    assert!(derive(&mut record(RunKind::Dynamics, &t, &[5.0; 400])).is_empty());
    assert!(
        derive(&mut record(RunKind::Dynamics, &t[..6], &[1.0, 2.0, 3.0, 5.0, 6.0, 9.0]))[0]
            .contains("too few")
    );
    let same = record(RunKind::Dynamics, &[0.0; 400], &once.columns[1].data);
    assert!(derive(&mut same.clone())[0].contains("same time"));
}

/// A pause between two strokes in which nothing was logged.
/// Neither knows of the other.
#[test]
fn a_gap_in_time_parts_two_runs() {
    let t: Vec<f64> = (0..400).map(|n| f64::from(n) * 1e-3 + if n < 200 { 0.0 } else { 30.0 }).collect();
    let p: Vec<f64> =
        (0..400).map(|n| if n < 200 { f64::from(n) * 0.05 } else { 300.0 - f64::from(n) * 0.02 }).collect();
    let mut parted = record(RunKind::Dynamics, &t, &p);
    derive(&mut parted);
    let v = parted.data(&Role::Velocity(x())).unwrap();
    assert!(v[..200].iter().all(|v| (v - 50.0).abs() < 1e-6), "{:?}", &v[195..205]);
    assert!(v[200..].iter().all(|v| (v + 20.0).abs() < 1e-6), "{:?}", &v[195..205]);
}

/// The EMPS record.
/// Mass, friction and offset by ordinary least squares on what was derived, against those its owners state (95.11 kg, 203.50 N s/m, 20.39
/// N, −3.165 N; 4.08 % of the force left).
#[test]
fn a_real_axis_has_the_mass_and_friction_that_its_owners_found() {
    let Some(path) = test_needs::shared("data/axis_dynamics/identification.csv") else { return };
    let text = std::fs::read_to_string(path).unwrap();
    let rows: Vec<Vec<f64>> =
        text.lines().skip(1).map(|l| l.split(',').map(|w| w.parse().unwrap()).collect()).collect();
    let get = |k: usize, factor: f64| rows.iter().map(|r| factor * r[k]).collect::<Vec<f64>>();
    let force = get(3, 35.1507);
    let columns = vec![
        Column::new("t", Role::Time, get(0, 1.0)),
        Column::new("x", Role::Position(x()), get(2, 1000.0)),
        Column::new("f", Role::Force(x()), force.clone()),
    ];
    let mut record = Record::new(Path::new("emps.run.toml"), RunKind::Dynamics, columns).unwrap();
    let notes = derive(&mut record);
    println!("{notes:#?}");
    let (v, a) = (record.data(&Role::Velocity(x())).unwrap(), record.data(&Role::Acceleration(x())).unwrap());
    let regressors = nalgebra::DMatrix::from_fn(v.len(), 4, |i, k| match k {
        0 => a[i] / 1000.0,
        1 => v[i] / 1000.0,
        2 => {
            if v[i].abs() < 1e-3 {
                0.0
            } else {
                v[i].signum()
            }
        }
        _ => 1.0,
    });
    let y = nalgebra::DVector::from_vec(force);
    let found = (regressors.transpose() * &regressors).try_inverse().unwrap() * regressors.transpose() * &y;
    let left = (&y - &regressors * &found).norm() / y.norm();
    println!("mass, viscous, Coulomb, offset: {found}, {:.2} % of the force left", 100.0 * left);
    for (k, (owners, within)) in
        [(95.11, 0.02), (203.50, 0.03), (20.39, 0.05), (-3.165, 0.05)].into_iter().enumerate()
    {
        assert!((found[k] / owners - 1.0).abs() < within, "{k}: {} against {owners}", found[k]);
    }
}
