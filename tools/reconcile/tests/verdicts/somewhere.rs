//! The first stage has a place for what a later stage finds.
//! The place is against a variable, a period or a position.

#![allow(clippy::unwrap_used)] // a test's own helpers

use crate::noise::noise;
use rtec_model::effect::{Dictionary, Effect, ParameterFitMethod};
use rtec_model::machine::{Machine, Provenance};
use rtec_model::record::{Record, RunKind};
use rtec_reconcile::{ReconciliationOptions, ResidualStructure, Verdict, find, reconcile};
use std::f64::consts::TAU;

/// Strokes of X and Y that warm up, and white noise of 1 µm.
/// Everything that a law can read is there, except the angle.
fn everything(seed: u64) -> Record {
    let mut normal = noise(seed);
    let n = 360;
    let of = |f: &dyn Fn(f64) -> f64| (0..n).map(|i| f(f64::from(i))).collect::<Vec<_>>();
    // A stroke of 61 rows out and as many back; Y has another number.
    let there = |i: f64, rows: f64| {
        let k = i % (2.0 * rows);
        if k < rows { (k, 1.0) } else { (2.0 * rows - k, -1.0) }
    };
    let speed = |i: f64| 5.0 + (i * 13.0 % 7.0);
    let mut quiet = |v: Vec<f64>| v.iter().map(|v| v + 0.02 * normal()).collect::<Vec<_>>();
    let warm = quiet(of(&|i| 20.0 + 6.0 * (1.0 - (-i / 90.0).exp())));
    let room = quiet(of(&|i| 20.0 + (TAU * i / 140.0).sin()));
    let error: Vec<f64> = (0..n).map(|_| normal()).collect();
    let columns = vec![
        ("t", "time", of(&|i| 20.0 * i)),
        ("x", "position.x", of(&|i| 5.3 * there(i, 61.0).0)),
        ("y", "position.y", of(&|i| 7.1 * there(i, 37.0).0)),
        ("dx", "direction.x", of(&|i| there(i, 61.0).1)),
        ("dy", "direction.y", of(&|i| there(i, 37.0).1)),
        ("vx", "velocity.x", of(&|i| there(i, 61.0).1 * speed(i))),
        ("ax", "acceleration.x", of(&|i| 40.0 * (TAU * i / 9.7).sin())),
        ("load", "load.x", of(&|i| 300.0 * (TAU * i / 23.0).cos())),
        ("rpm", "spindle_speed", of(&|i| 1000.0 * (i / 45.0).floor())),
        ("wet", "coolant", of(&|i| (i / 70.0).floor() % 2.0)),
        ("T1", "temperature", warm),
        ("T2", "temperature", room),
        ("level", "channel", of(&|i| (TAU * i / 51.0).sin())),
        ("e", "error.x", error),
    ];
    crate::record("run", RunKind::Positioning, columns)
}

/// The record with an effect of a given RMS, µm.
/// `None` if the effect is only a constant there, and for arrays, whose knots the caller sets.
fn with(effect: &Effect, rms_um: f64, mut record: Record) -> Option<Record> {
    let mut effect = effect.clone();
    let parameters = effect.description().parameters.clone();
    if parameters.iter().any(|p| p.array) {
        return None;
    }
    let mut sized = |um: f64| {
        for p in parameters
            .iter()
            .filter(|p| matches!(p.search, ParameterFitMethod::Linear | ParameterFitMethod::Amplitude))
        {
            effect.set(&p.name, &[um]).ok()?;
        }
        let mut machine = Machine::ideal("m");
        machine.push(effect.clone(), Provenance::default()).ok()?;
        let um = machine.predict(&record).ok()?.columns[0].1.clone();
        let mean = um.iter().sum::<f64>() / um.len() as f64;
        let rms = (um.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / um.len() as f64).sqrt();
        Some((um, rms))
    };
    let (_, one) = sized(1.0)?;
    let (um, rms) = sized(rms_um / one).filter(|_| one > 1e-9)?;
    assert!((rms / rms_um - 1.0).abs() < 0.01, "{rms} µm");
    let error = record.columns.iter_mut().find(|c| c.name == "e").unwrap();
    error.data.iter_mut().zip(um).for_each(|(e, um)| *e += um);
    Some(record)
}

#[test]
fn every_effect_that_is_named_is_somewhere() {
    if !test_needs::long() {
        return;
    }
    let dictionary = Dictionary::default();
    let ideal = Machine::ideal("m");
    let (mut found, mut silent) = (0, Vec::new());
    for (k, effect) in dictionary.candidates(&[&everything(0)]).iter().enumerate() {
        // From well above the noise to barely visible.
        for rms_um in [3.0, 0.5] {
            let Some(record) = with(effect, rms_um, everything(k as u64 + 1)) else { continue };
            let train = [record];
            let places = find(&train, &ideal, 0.01).unwrap();
            let somewhere = places.iter().any(ResidualStructure::counts);
            let later = reconcile(&train, &[], &ideal, &ReconciliationOptions::default()).unwrap();
            let said = format!("{} of {rms_um} µm: {} {:?}", effect.name(), later.verdict, later.unexplained);
            assert_eq!(places.len(), later.places.len(), "{said}");
            assert!(somewhere || later.verdict == Verdict::NothingMissing, "{said}: nowhere");
            // The place is against a variable that the law reads, if it reads any.
            for (f, _) in &later.effects {
                let needs = f.effect.description().needs.iter();
                let roles: Vec<String> = needs.map(|n| n.role(f.effect.axes()).to_string()).collect();
                let of = |p: &ResidualStructure| {
                    p.counts() && roles.iter().any(|r| p.against.starts_with(r.as_str()))
                };
                let name = f.effect.name();
                assert!(roles.is_empty() || places.iter().any(of), "{said}: {name} is nowhere");
            }
            if rms_um > 1.0 && somewhere {
                found += 1;
            } else if rms_um > 1.0 {
                silent.push(effect.name());
            }
        }
    }
    // An effect of three times the noise is always found.
    assert!(found >= 20 && silent.is_empty(), "{found}, and nothing of {silent:?}");
}
