//! What has no name gets none: shapes of real life that are near a law, and readings that the model explains.

#![allow(clippy::unwrap_used)] // a test's own helpers

use rtec_model::machine::Machine;
use rtec_model::record::{Column, Kind, Record, Role};
use rtec_reconcile::{Options, Reconciliation, Verdict, reconcile};
use std::f64::consts::TAU;
use std::path::Path;
use test_needs::dice::Dice;

fn record(name: &str, kind: Kind, columns: Vec<(&str, &str, Vec<f64>)>) -> Record {
    let of = |(n, r, v)| Column::new(n, Role::parse(r).unwrap(), v);
    let columns = columns.into_iter().map(of).collect();
    Record::new(Path::new(&format!("{name}.run.toml")), kind, columns).unwrap()
}

fn answer(model: &str, train: &[Record]) -> Reconciliation {
    let model = Machine::parse(Path::new("m.toml"), &format!("name = \"m\"\n{model}")).unwrap();
    reconcile(train, &[], &model, &Options::default()).unwrap()
}

fn nameless(model: &str, train: &[Record]) {
    let said = answer(model, train);
    let names: Vec<String> = said.effects.iter().map(|(f, _)| f.effect.name()).collect();
    assert!(names.is_empty(), "{names:?}");
    assert_eq!(said.verdict, Verdict::UnknownEffect, "{:?}", said.unexplained);
}

/// A drift of one axis that does as it is told, in µm over seconds.
fn drift(name: &str, seed: u64, of: impl Fn(f64) -> f64) -> Record {
    let mut d = Dice::new(seed);
    let t: Vec<f64> = (0..240).map(|i| 20.0 * f64::from(i)).collect();
    let e = t.iter().map(|t| of(*t) + 0.1 * d.normal()).collect();
    record(name, Kind::Drift, vec![("t", "time", t), ("e", "error.x", e)])
}

#[test]
fn a_stand_that_creeps_is_no_warm_up() {
    for seed in 1..4 {
        nameless("", &[drift("a", seed, |t| 1.5 * (t / 30.0).ln_1p())]);
    }
}

/// An air conditioning blows for a third of its period.
#[test]
fn what_swings_in_time_need_not_be_a_sine() {
    for (seed, period_s) in [(1, 610.0), (2, 820.0), (3, 455.0)] {
        let swing = |t: f64| {
            let turn = (t / period_s).rem_euclid(1.0);
            4.0 * if turn < 0.3 { turn / 0.3 } else { (1.0 - turn) / 0.7 }
        };
        nameless("", &[drift("a", seed, swing)]);
    }
}

/// A line to and fro at which each place has a level of its own, the same in all cycles, that depends on the side it is come from.
#[test]
fn what_repeats_at_its_places_is_seen_whatever_its_form() {
    for seed in 1..4 {
        let mut d = Dice::new(seed);
        let levels: Vec<[f64; 2]> = (0..21).map(|_| [2.0 * d.normal(), 2.0 * d.normal()]).collect();
        let mut rows: Vec<Vec<f64>> = vec![Vec::new(); 4];
        for row in 0..21 * 2 * 5 {
            let (lap, at) = (row / 21, row % 21);
            let back = lap % 2;
            let place = if back == 0 { at } else { 20 - at };
            let e = levels[place][back] + 0.3 * d.normal();
            let direction = if back == 0 { 1.0 } else { -1.0 };
            let row = [5.0 * row as f64, 20.0 * place as f64, direction, e];
            rows.iter_mut().zip(row).for_each(|(c, v)| c.push(v));
        }
        let roles = [("t", "time"), ("x", "position.x"), ("d", "direction.x"), ("e", "error.x")];
        let columns = roles.into_iter().zip(rows).map(|((n, r), v)| (n, r, v)).collect();
        let said = answer("", &[record("line", Kind::Positioning, columns)]);
        assert!(!said.unexplained.is_empty(), "{:?}", said.verdict);
    }
}

/// A narrow bump of the part that the model knows stands far off the rows beside it, as a misread row does.
#[test]
fn what_the_model_explains_is_no_misread_row() {
    let mut d = Dice::new(7);
    let angle: Vec<f64> = (0..96).map(|i| TAU * f64::from(i) / 48.0).collect();
    let bump = |a: f64| {
        let off = (a - 0.5 + TAU / 2.0).rem_euclid(TAU) - TAU / 2.0;
        -40.0 * (-0.5 * (off / 0.12).powi(2)).exp()
    };
    let model = "[[effect]]\nname = \"form_bump\"\num = -40.0\ncentre_rad = 0.5\nwidth_rad = 0.12\n";
    let e = angle.iter().map(|a| bump(*a) + 0.3 * d.normal()).collect();
    let t = (0..96).map(|i| f64::from(i) * 2.0).collect();
    let columns = vec![("t", "time", t), ("a", "angle", angle), ("e", "error.r", e)];
    let said = answer(model, &[record("ring", Kind::Part, columns)]);
    assert_eq!(said.suspicions.iter().map(ToString::to_string).collect::<Vec<_>>(), Vec::<String>::new());
}
