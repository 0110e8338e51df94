//! Records that contain people's mistakes.
//! The tests check what is reported, what is left out, and what is not learned. The runs are made here, by
//! formulas.

#![allow(clippy::unwrap_used)] // a test's own helpers

use crate::names;
use rtec_measure::plausible::MistakeKind;
use rtec_model::ballbar_circle::Circle;
use rtec_model::machine::Machine;
use rtec_model::record::{Axis, Column, Record, Role, RunKind};
use rtec_reconcile::{ReconciliationOptions, ReconciliationResult, Verdict, reconcile};
use std::path::Path;
use test_needs::dice::Dice;

const MODEL: &str =
    "name = \"m\"\n[[effect]]\nname = \"thermal_growth.x\"\nsensor = \"T1\"\num_per_K = 3.0\n";

/// Strokes of 300 mm with 40 ppm that the model lacks; `n` rows, 30 s apart.
/// A bearing warms up, and the air changes.
fn run(name: &str, seed: u64, n: usize) -> Record {
    let mut d = Dice::new(seed);
    let mut columns: Vec<Vec<f64>> = vec![Vec::new(); 6];
    for i in 0..n {
        let t = 30.0 * i as f64;
        let p = 30.0 * (10.0 - (i as f64 % 20.0 - 10.0).abs());
        let warm = 8.0 * (1.0 - (-t / 1800.0).exp());
        let (bearing, air) = (21.0 + warm, 20.0 + 0.4 * (t / 900.0).sin());
        let e = 3.0 * (bearing - 20.0) + 40.0 * p / 1000.0 + 0.2 * d.normal();
        let other = 20.5 + 0.3 * warm + 0.02 * d.normal();
        let row = [t, p, bearing + 0.02 * d.normal(), air + 0.02 * d.normal(), e, other];
        columns.iter_mut().zip(row).for_each(|(c, v)| c.push(v));
    }
    let axis = Axis::new("x").unwrap();
    let named = [
        ("t", Role::Time),
        ("x", Role::Position(axis.clone())),
        ("T1", Role::Temperature),
        ("air", Role::Temperature),
        ("e", Role::Error(axis)),
        ("T8", Role::Temperature),
    ];
    let columns = named.into_iter().zip(columns).map(|((n, r), v)| Column::new(n, r, v)).collect();
    Record::new(Path::new(&format!("{name}.run.toml")), RunKind::Positioning, columns).unwrap()
}

fn spoil(record: &mut Record, column: &str, f: impl Fn(usize, f64) -> f64) {
    let c = record.columns.iter_mut().find(|c| c.name == column).unwrap();
    c.data.iter_mut().enumerate().for_each(|(i, v)| *v = f(i, *v));
}

fn answer(train: &[Record], holdout: &[Record]) -> ReconciliationResult {
    let model = Machine::parse(Path::new("m.toml"), MODEL).unwrap();
    reconcile(train, holdout, &model, &ReconciliationOptions::default()).unwrap()
}

/// Eight quiet hours are no evidence for another unit of time.
/// A stand that stays is as likely as a short run.
#[test]
fn a_quiet_stand_says_nothing_about_the_clock() {
    let model = "name = \"m\"\n[[effect]]\nname = \"thermal_lag.z\"\nsensor = \"T\"\num_per_K = 0.5\ntau_s = 7200.0\n";
    let model = Machine::parse(Path::new("m.toml"), model).unwrap();
    for seed in 1..4 {
        let mut d = Dice::new(seed);
        let mut rough = |middle: f64| (0..480).map(|_| middle + 0.05 * d.normal()).collect::<Vec<f64>>();
        let t = (0..480).map(|i| 60.0 * f64::from(i)).collect();
        let named = [("x", 3.0), ("y", -2.0), ("z", 1.0)];
        let mut columns =
            vec![Column::new("t", Role::Time, t), Column::new("T", Role::Temperature, rough(20.0))];
        columns.extend(
            named.map(|(axis, um)| Column::new(axis, Role::Error(Axis::new(axis).unwrap()), rough(um))),
        );
        let run = Record::new(Path::new("a.run.toml"), RunKind::Drift, columns).unwrap();
        let said = reconcile(&[run], &[], &model, &ReconciliationOptions::default()).unwrap();
        assert_eq!((said.suspicions, said.verdict), (vec![], Verdict::NothingMissing), "seed {seed}");
    }
}

/// Rows that stand twice in a file are said.
/// Velocities are derived from them.
#[test]
fn doubled_rows_of_a_circle_are_said() {
    let mut d = Dice::new(1);
    let rows: Vec<usize> =
        (0..200).flat_map(|i| vec![i; if (40..80).contains(&i) { 2 } else { 1 }]).collect();
    let once: Vec<[f64; 3]> = (0..200)
        .map(f64::from)
        .map(|i| [0.1 * i + 0.01 * (i % 3.0), 0.03 * i, (0.06 * i).cos() + 0.2 * d.normal()])
        .collect();
    let column = |k: usize| rows.iter().map(|i| once[*i][k]).collect();
    let columns = vec![("t", "time", column(0)), ("a", "angle", column(1)), ("e", "error.r", column(2))];
    let [x, y] = ["x", "y"].map(|a| Axis::new(a).unwrap());
    let circle = Circle { radius_mm: 100.0, plane: [x, y], centre_mm: Some([0.0, 0.0]) };
    let record = crate::record("a", RunKind::Ballbar, columns).with_circle(circle).unwrap();
    let said = crate::answer("", &[record], &[]);
    let [s] = &said.suspicions[..] else { panic!("{:?}", said.suspicions) };
    assert!(s.what == MistakeKind::Doubled && s.text.starts_with("40 of 240 rows"), "{s:?}");
}

#[test]
fn a_bad_sensor_of_a_holdout_changes_nothing_that_is_learned() {
    let (train, mut later) = (run("a", 1, 160), run("later", 2, 160));
    let clean = answer(std::slice::from_ref(&train), std::slice::from_ref(&later));
    assert!(clean.suspicions.is_empty() && clean.left_out.is_empty(), "{:?}", clean.suspicions);
    assert_eq!((clean.verdict, names(&clean)), (Verdict::Named, vec!["scale.x".to_owned()]));
    spoil(&mut later, "T8", |_, _| 999.9);
    let bad = answer(&[train], &[later]);
    assert!(bad.suspicions.iter().any(|s| s.what == MistakeKind::Unplugged && s.record.contains("later")));
    assert_eq!(names(&bad), names(&clean));
    assert_eq!(bad.model.effects().collect::<Vec<_>>(), clean.model.effects().collect::<Vec<_>>());
    assert!(bad.left_out.iter().any(|l| l.contains("later") && l.contains("T8")), "{:?}", bad.left_out);
}

#[test]
fn the_training_given_again_as_a_holdout_is_no_holdout() {
    let train = run("a", 3, 160);
    let r = answer(std::slice::from_ref(&train), std::slice::from_ref(&train));
    assert!(r.suspicions.iter().any(|s| s.what == MistakeKind::Doubled), "{:?}", r.suspicions);
    assert!(r.gap.iter().all(|g| g.holdout.is_none() && g.blocked.is_some()));
    assert_eq!(names(&r), ["scale.x"]);
}

#[test]
fn the_holdout_of_another_machine_is_the_one_that_is_named() {
    let (train, good, mut strange) = (run("a", 4, 160), run("good", 5, 160), run("strange", 6, 160));
    spoil(&mut strange, "e", |i, v| v + 25.0 * (i as f64 / 9.0).sin());
    let r = answer(&[train], &[good, strange]);
    let said: Vec<&str> = r.suspicions.iter().map(|s| s.record.as_str()).collect();
    assert_eq!(said, ["strange.run.toml"], "{:?}", r.suspicions);
    // Without that hold-out the gap is closed. Both figures are reported.
    let [before, after] = r.gap[0].without_strangers.unwrap();
    assert!(after < 0.15 * before && r.gap[0].holdout.unwrap()[1] > 10.0, "{:?}", r.gap);
    assert!(r.advice.contains("strange"), "{}", r.advice);
}

#[test]
fn a_few_bad_readings_cost_their_rows_and_no_sensor() {
    let mut train = run("a", 7, 160);
    spoil(&mut train, "T1", |i, v| if i == 40 || i == 90 { -127.0 } else { v });
    let r = answer(&[train], &[run("later", 8, 160)]);
    assert_eq!(names(&r), ["scale.x"]);
    assert!(r.left_out.iter().any(|l| l.contains("2 of 160 rows (unplugged)")), "{:?}", r.left_out);
}

#[test]
fn a_row_alone_tells_nothing() {
    let r = answer(&[run("a", 9, 1)], &[]);
    assert!(r.effects.is_empty() && r.refined.is_empty(), "{}", r.to_json());
    assert_eq!(r.verdict, Verdict::UnknownEffect);
    assert!(r.advice.contains("tell nothing apart"), "{}", r.advice);
    // Six rows: no share of the gap is reported.
    let r = answer(&[run("a", 9, 6)], &[]);
    assert!(r.gap.iter().all(|g| g.closed().is_none()), "{}", r.to_json());
    // Ten rows of a machine that the model describes: nothing is seen to be missing, with low confidence.
    let mut ten = run("a", 9, 10);
    spoil(&mut ten, "e", |i, _| 0.3 * ((i * 7919 % 13) as f64 - 6.0) / 6.0);
    let r = answer(&[ten], &[]);
    assert!(
        r.verdict != Verdict::NothingMissing || r.advice.contains("10 rows show only"),
        "{} {}",
        r.verdict,
        r.advice
    );
}

/// A sensor read in tenths repeats one value from some row on.
/// Its own noise before shows that it should not.
#[test]
fn a_sensor_that_stops_midway_is_stuck() {
    let (mut train, good) = (run("a", 10, 160), run("b", 11, 160));
    let held = (train.temperature("T1").unwrap()[80] * 100.0).round() / 100.0;
    spoil(&mut train, "T1", |i, v| if i < 80 { (v * 100.0).round() / 100.0 } else { held });
    let r = answer(&[train, good], &[]);
    let stuck = r.suspicions.iter().find(|s| s.what == MistakeKind::Stuck).unwrap();
    assert_eq!((stuck.column.as_str(), stuck.rows.as_str()), ("T1", "81-160"), "{:?}", r.suspicions);
    assert_eq!(names(&r), ["scale.x"]);
}

/// If every record is doubted, nothing is named.
#[test]
fn doubted_records_name_nothing() {
    let mut train = run("a", 12, 160);
    spoil(&mut train, "e", |_, v| -v);
    let r = answer(&[train], &[]);
    assert!(r.suspicions.iter().any(|s| s.what == MistakeKind::Sign), "{:?}", r.suspicions);
    assert!(r.effects.is_empty() && r.verdict == Verdict::UnknownEffect, "{}", r.verdict);
    assert!(r.left_out[0].contains("all of it (sign)"), "{:?}", r.left_out);
    // The model is unchanged, so the gap is unchanged.
    let g = &r.gap[0];
    let unchanged = |[before, after]: [f64; 2]| (before - after).abs() < 1e-12;
    assert!(g.closed().is_none() && g.blocked.is_none() && unchanged(g.train), "{g:?}");
    assert!(r.unexplained[0].manner.contains("every record is doubted"), "{:?}", r.unexplained);
}

/// A hold-out is not doubted for the sign of a training record.
/// The two are opposite, and the model accuses the training.
#[test]
fn a_clean_holdout_is_not_accused_of_the_trainings_sign() {
    let (mut train, later) = (run("a", 13, 160), run("later", 14, 160));
    spoil(&mut train, "e", |_, v| -v);
    let r = answer(&[train], &[later]);
    let said: Vec<(MistakeKind, &str)> = r.suspicions.iter().map(|s| (s.what, s.record.as_str())).collect();
    assert_eq!(said, [(MistakeKind::Sign, "a.run.toml")], "{:?}", r.suspicions);
    assert!(r.gap[0].holdout.is_some_and(|[before, after]| (before - after).abs() < 1e-12), "{:?}", r.gap);
}

/// Two sensors are exchanged, in one record or in all of them.
/// The noise is as large as the exchange's effect. The exchange is more likely than a missing growth of
/// exactly that form and size.
#[test]
fn an_exchange_that_explains_more_than_a_missing_growth_is_said() {
    let exchange = |r: &mut Record| {
        let at = |name: &str| r.columns.iter().position(|c| c.name == name).unwrap();
        let (a, b) = (at("T1"), at("T8"));
        let data = std::mem::take(&mut r.columns[a].data);
        r.columns[a].data = std::mem::replace(&mut r.columns[b].data, data);
    };
    let noisy = |name: &str, seed: u64| {
        let (mut r, mut dice) = (run(name, seed, 120), Dice::new(seed + 100));
        let e = r.columns.iter_mut().find(|c| c.name == "e").unwrap();
        e.data.iter_mut().for_each(|e| *e += 4.0 * dice.normal());
        r
    };
    let machine = Machine::parse(Path::new("machine.toml"), MODEL).unwrap();
    let said = |records: &[Record]| {
        let r = reconcile(records, &[], &machine, &ReconciliationOptions::default()).unwrap();
        let swapped = r.suspicions.iter().filter(|s| s.what == MistakeKind::Swapped);
        // One or both of the pair may be reported.
        let mut records: Vec<String> = swapped.map(|s| s.record.clone()).collect();
        records.dedup();
        // Beside an uncertain suspicion no name may be accepted.
        let thermal = r.effects.iter().any(|(f, _)| f.effect.name().starts_with("thermal"));
        let growth = thermal && r.verdict == Verdict::Named;
        (records, growth)
    };
    let clean = [noisy("a", 1), noisy("b", 2), noisy("c", 3)];
    assert_eq!(said(&clean), (Vec::new(), false));
    let mut one = clean.clone();
    exchange(&mut one[2]);
    assert_eq!(said(&one), (vec!["c.run.toml".to_owned()], false));
    let mut all = clean;
    all.iter_mut().for_each(exchange);
    let (records, growth) = said(&all);
    assert!(records.len() == 3 && !growth, "{records:?}");
}
