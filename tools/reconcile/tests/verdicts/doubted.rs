//! Records that carry people's mistakes.
//! What is said of them, what is left out, and what is not learned. The runs are made here, by formulas of their own.

#![allow(clippy::unwrap_used)] // a test's own helpers

use rtec_measure::plausible::What;
use rtec_model::machine::Machine;
use rtec_model::record::{Axis, Column, Kind, Record, Role};
use rtec_reconcile::{Options, Reconciliation, Verdict, reconcile};
use std::f64::consts::TAU;
use std::path::Path;
use test_needs::dice::Dice;

const MODEL: &str =
    "name = \"m\"\n[[effect]]\nname = \"thermal_growth.x\"\nsensor = \"T1\"\num_per_K = 3.0\n";

/// Strokes of 300 mm with 40 ppm that the model lacks, a bearing that warms up and the air; `n` rows, 30 s apart.
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
    Record::new(Path::new(&format!("{name}.run.toml")), Kind::Positioning, columns).unwrap()
}

fn spoil(record: &mut Record, column: &str, f: impl Fn(usize, f64) -> f64) {
    let c = record.columns.iter_mut().find(|c| c.name == column).unwrap();
    c.data.iter_mut().enumerate().for_each(|(i, v)| *v = f(i, *v));
}

fn answer(train: &[Record], holdout: &[Record]) -> Reconciliation {
    let model = Machine::parse(Path::new("m.toml"), MODEL).unwrap();
    reconcile(train, holdout, &model, &Options::default()).unwrap()
}

fn names(r: &Reconciliation) -> Vec<String> {
    r.effects.iter().map(|(f, _)| f.effect.name()).collect()
}

#[test]
fn a_bad_sensor_of_a_holdout_changes_nothing_that_is_learned() {
    let (train, mut later) = (run("a", 1, 160), run("later", 2, 160));
    let clean = answer(std::slice::from_ref(&train), std::slice::from_ref(&later));
    assert!(clean.suspicions.is_empty() && clean.left_out.is_empty(), "{:?}", clean.suspicions);
    assert_eq!((clean.verdict, names(&clean)), (Verdict::Named, vec!["scale.x".to_owned()]));
    spoil(&mut later, "T8", |_, _| 999.9);
    let bad = answer(&[train], &[later]);
    assert!(bad.suspicions.iter().any(|s| s.what == What::Unplugged && s.record.contains("later")));
    assert_eq!(names(&bad), names(&clean));
    assert_eq!(bad.model.effects().collect::<Vec<_>>(), clean.model.effects().collect::<Vec<_>>());
    assert!(bad.left_out.iter().any(|l| l.contains("later") && l.contains("T8")), "{:?}", bad.left_out);
}

#[test]
fn the_training_given_again_as_a_holdout_is_no_holdout() {
    let train = run("a", 3, 160);
    let r = answer(std::slice::from_ref(&train), std::slice::from_ref(&train));
    assert!(r.suspicions.iter().any(|s| s.what == What::Doubled), "{:?}", r.suspicions);
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
    // Without it the gap is closed, and that is said beside what it is with it.
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
    // Six rows: what was left of them is no share closed.
    let r = answer(&[run("a", 9, 6)], &[]);
    assert!(r.gap.iter().all(|g| g.closed().is_none()), "{}", r.to_json());
    // Ten rows of a machine that the model holds: nothing is seen to be missing, and that says little.
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

/// A sensor that stands still from some row on, read in tenths.
/// Its own noise before says that it should not.
#[test]
fn a_sensor_that_stops_midway_is_stuck() {
    let (mut train, good) = (run("a", 10, 160), run("b", 11, 160));
    let held = (train.temperature("T1").unwrap()[80] * 100.0).round() / 100.0;
    spoil(&mut train, "T1", |i, v| if i < 80 { (v * 100.0).round() / 100.0 } else { held });
    let r = answer(&[train, good], &[]);
    let stuck = r.suspicions.iter().find(|s| s.what == What::Stuck).unwrap();
    assert_eq!((stuck.column.as_str(), stuck.rows.as_str()), ("T1", "81-160"), "{:?}", r.suspicions);
    assert_eq!(names(&r), ["scale.x"]);
}

/// Nothing is named where every record is doubted.
#[test]
fn doubted_records_name_nothing() {
    let mut train = run("a", 12, 160);
    spoil(&mut train, "e", |_, v| -v);
    let r = answer(&[train], &[]);
    assert!(r.suspicions.iter().any(|s| s.what == What::Sign), "{:?}", r.suspicions);
    assert!(r.effects.is_empty() && r.verdict == Verdict::UnknownEffect, "{}", r.verdict);
    assert!(r.left_out[0].contains("all of it (sign)"), "{:?}", r.left_out);
    // The model is what it was: so is the gap.
    let g = &r.gap[0];
    let unchanged = |[before, after]: [f64; 2]| (before - after).abs() < 1e-12;
    assert!(g.closed().is_none() && g.blocked.is_none() && unchanged(g.train), "{g:?}");
    assert!(r.unexplained[0].manner.contains("every record is doubted"), "{:?}", r.unexplained);
}

/// A hold-out that is the training's opposite is not doubted where the model says that the training is.
#[test]
fn a_clean_holdout_is_not_accused_of_the_trainings_sign() {
    let (mut train, later) = (run("a", 13, 160), run("later", 14, 160));
    spoil(&mut train, "e", |_, v| -v);
    let r = answer(&[train], &[later]);
    let said: Vec<(What, &str)> = r.suspicions.iter().map(|s| (s.what, s.record.as_str())).collect();
    assert_eq!(said, [(What::Sign, "a.run.toml")], "{:?}", r.suspicions);
    assert!(r.gap[0].holdout.is_some_and(|[before, after]| (before - after).abs() < 1e-12), "{:?}", r.gap);
}

/// Two sensors exchanged under noise as large as what that does, in one record or in all of them: more likely than growth that
/// is missing and goes as the exchange would, to the size.
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
        let r = reconcile(records, &[], &machine, &Options::default()).unwrap();
        let swapped = r.suspicions.iter().filter(|s| s.what == What::Swapped);
        // One or both of the pair may be said.
        let mut records: Vec<String> = swapped.map(|s| s.record.clone()).collect();
        records.dedup();
        // Beside a suspicion that is not certain no name may hold its place.
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

fn with_model(text: &str, train: &Record) -> Reconciliation {
    let model = Machine::parse(Path::new("m.toml"), text).unwrap();
    reconcile(std::slice::from_ref(train), &[], &model, &Options::default()).unwrap()
}

fn parsed(name: &str, kind: Kind, columns: Vec<(&str, &str, Vec<f64>)>) -> Record {
    let of = |(n, r, v)| Column::new(n, Role::parse(r).unwrap(), v);
    let columns = columns.into_iter().map(of).collect();
    Record::new(Path::new(&format!("{name}.run.toml")), kind, columns).unwrap()
}

fn swap(record: &mut Record, a: &str, b: &str) {
    let at = |name: &str| record.columns.iter().position(|c| c.name == name).unwrap();
    let (a, b) = (at(a), at(b));
    let x = std::mem::take(&mut record.columns[a].data);
    let y = std::mem::replace(&mut record.columns[b].data, x);
    record.columns[a].data = y;
}

fn kinds(r: &Reconciliation) -> Vec<(What, &str)> {
    r.suspicions.iter().map(|s| (s.what, s.column.as_str())).collect()
}

/// A grid of 100 mm by 60 mm with the errors of two scales; `more`: what the model lacks of each error, by the place.
fn plate(seed: u64, more: impl Fn(f64, f64) -> [f64; 2]) -> Record {
    let mut d = Dice::new(seed);
    let places: Vec<(f64, f64)> =
        (0..81).map(|i| (25.0 * f64::from(i % 9) - 40.0, 15.0 * f64::from(i / 9))).collect();
    let mut error = |k: usize| -> Vec<f64> {
        let own = |(x, y): &(f64, f64)| [0.052 * x, -0.083 * y][k] + more(*x, *y)[k] + 0.5 * d.normal();
        places.iter().map(own).collect()
    };
    let (ex, ey) = (error(0), error(1));
    let [x, y]: [Vec<f64>; 2] = [places.iter().map(|p| p.0).collect(), places.iter().map(|p| p.1).collect()];
    let columns =
        vec![("x", "position.x", x), ("y", "position.y", y), ("ex", "error.x", ex), ("ey", "error.y", ey)];
    parsed("plate", Kind::Plate, columns)
}

/// Two axes in each other's place are no squareness and no rotation.
/// What is one of those is named as before.
#[test]
fn positions_or_errors_of_two_axes_exchanged_are_said() {
    let model = "name = \"m\"\n[[effect]]\nname = \"scale.x\"\nppm = 50.0\n[[effect]]\nname = \"scale.y\"\nppm = -85.0\n";
    for seed in 1..=3 {
        for pair in [["x", "y"], ["ex", "ey"]] {
            let mut run = plate(seed, |_, _| [0.0, 0.0]);
            let clean = with_model(model, &run);
            assert_eq!((clean.verdict, kinds(&clean)), (Verdict::NothingMissing, vec![]));
            swap(&mut run, pair[0], pair[1]);
            let r = with_model(model, &run);
            assert_eq!((kinds(&r), names(&r).len()), (vec![(What::Swapped, pair[0])], 0), "{}", r.to_json());
        }
        let turned = with_model(model, &plate(seed, |x, y| [-0.06 * y, 0.06 * x]));
        assert_eq!((kinds(&turned), names(&turned)), (vec![], vec!["rotation.x.y".to_owned()]));
        let oblique = with_model(model, &plate(seed, |_, y| [0.09 * y, 0.0]));
        assert_eq!((kinds(&oblique).len(), names(&oblique).len()), (0, 1));
    }
}

/// Three strokes.
/// A value of the model that is off by a third is refined, and one that is off by what an inch has is no refinement.
#[test]
fn inches_that_only_the_model_shows_are_said() {
    let run = |ppm: f64, per: f64| {
        let mut d = Dice::new(5);
        let p: Vec<f64> = (0..123).map(|i: i32| 12.4 * f64::from(20 - ((i % 41) - 20).abs()) + 3.7).collect();
        let e = p.iter().map(|p| ppm * p / 1000.0 + 0.5 * d.normal()).collect();
        let p = p.iter().map(|p| p / per).collect();
        parsed("off", Kind::Positioning, vec![("x", "position.x", p), ("e", "error.x", e)])
    };
    let model = |ppm: f64| format!("name = \"m\"\n[[effect]]\nname = \"scale.x\"\nppm = {ppm}\n");
    for (given, ppm) in [(25.0, 24.0), (24.0, 24.0), (16.0, 24.0), (0.3, 24.0), (1.5, 24.0)] {
        assert_eq!(kinds(&with_model(&model(given), &run(ppm, 1.0))), [], "{given} for {ppm}");
    }
    let r = with_model(&model(25.0), &run(24.0, 25.4));
    assert_eq!((kinds(&r), r.refined.len()), (vec![(What::Unit, "x")], 0), "{}", r.to_json());
}

/// The same beside a reversal that the model lacks.
/// Found, and then the scale is off by what an inch has.
#[test]
fn inches_beside_a_missing_effect_are_said() {
    let run = |per: f64| {
        let mut d = Dice::new(7);
        let (mut p, mut way, mut e) = (Vec::new(), Vec::new(), Vec::new());
        for i in 0..160_i32 {
            let up = i % 40 < 20;
            let at = 24.7 * f64::from(if up { i % 40 } else { 39 - i % 40 }) - 233.3;
            p.push(at / per);
            way.push(if up { 1.0 } else { -1.0 });
            e.push(22.0 * at / 1000.0 + if up { -3.0 } else { 3.0 } + 0.1 * d.normal());
        }
        let columns = vec![("x", "position.x", p), ("way", "direction.x", way), ("e", "error.x", e)];
        parsed("strokes", Kind::Positioning, columns)
    };
    let model = "name = \"m\"\n[[effect]]\nname = \"scale.x\"\nppm = 23.1\n";
    let clean = with_model(model, &run(1.0));
    assert_eq!(
        (kinds(&clean), names(&clean)),
        (vec![], vec!["reversal.x".to_owned()]),
        "{}",
        clean.to_json()
    );
    let r = with_model(model, &run(25.4));
    assert_eq!((kinds(&r), names(&r).len()), (vec![(What::Unit, "x")], 0), "{}", r.to_json());
    assert!(r.refined.is_empty() && r.suspicions[0].text.contains("inch"), "{:?}", r.suspicions);
}

/// A circle of 100 mm radius, both ways, four times.
/// Errors of two scales, two reversals and a squareness.
fn circle(seed: u64) -> Record {
    let mut d = Dice::new(seed);
    let mut columns: Vec<Vec<f64>> = vec![Vec::new(); 8];
    for i in 0..960 {
        let (turn, way) = (TAU * f64::from(i % 240) / 240.0, if i / 240 % 2 == 0 { 1.0 } else { -1.0 });
        let (x, z) = (100.0 * turn.cos(), 100.0 * way * turn.sin());
        let to =
            [-way * (way * turn).sin(), way * (way * turn).cos()].map(|v| if v < 0.0 { -1.0 } else { 1.0 });
        let back = |to: f64, um: f64| if to < 0.0 { um } else { 0.0 };
        let ex = -0.013 * x + back(to[0], 2.9) + 0.045 * z + 0.1 * d.normal();
        let ez = 0.023 * z + back(to[1], 6.2) + 0.1 * d.normal();
        let row = [0.05 * f64::from(i), x, to[0], z, to[1], f64::from(i / 240), ex, ez];
        columns.iter_mut().zip(row).for_each(|(c, v)| c.push(v));
    }
    let roles = [
        ("t", "time"),
        ("x", "position.x"),
        ("wx", "direction.x"),
        ("z", "position.z"),
        ("wz", "direction.z"),
        ("n", "cycle"),
        ("ex", "error.x"),
        ("ez", "error.z"),
    ];
    parsed("circle", Kind::Ballbar, roles.into_iter().zip(columns).map(|((n, r), v)| (n, r, v)).collect())
}

/// The errors of a circle in each other's place, beside a model that lacks so much that it shows nothing of it: what explains the
/// circle then is far less likely than what explains it with the exchange undone.
#[test]
fn exchanged_errors_that_the_model_does_not_show_are_said() {
    let model = "name = \"m\"\n[[effect]]\nname = \"scale.x\"\nppm = -13.2\n[[effect]]\nname = \"reversal.x\"\num = 2.9\n";
    let mut run = circle(3);
    let clean = with_model(model, &run);
    assert_eq!((kinds(&clean), clean.verdict), (vec![], Verdict::Named), "{}", clean.to_json());
    swap(&mut run, "ex", "ez");
    let r = with_model(model, &run);
    assert_eq!((kinds(&r), names(&r).len()), (vec![(What::Swapped, "ex")], 0), "{}", r.to_json());
}

/// A drift test of a spindle whose housing follows a bearing late.
fn warming(seed: u64, minutes: bool, revolutions: bool) -> Record {
    let mut d = Dice::new(seed);
    let t: Vec<f64> = (0..240).map(|i| 60.0 * f64::from(i)).collect();
    let on = |t: f64| (0.0..4800.0).contains(&t) || (9000.0..11_000.0).contains(&t);
    let (mut bearing, mut late) = (0.0_f64, 0.0_f64);
    let mut rows: Vec<Vec<f64>> = vec![Vec::new(); 4];
    for t in &t {
        let rpm: f64 = if on(*t) { [3000.0, 6000.0][usize::from((t / 1200.0) as i32 % 2 == 0)] } else { 0.0 };
        let (ex, ez) = (3.0 * late + 0.4 * d.normal(), 4.0 * rpm / 1000.0 + 0.4 * d.normal());
        let row = [rpm / if revolutions { 60.0 } else { 1.0 }, 20.0 + bearing, ex, ez];
        rows.iter_mut().zip(row).for_each(|(c, v)| c.push(v));
        // In balance at the first row, and straight from row to row.
        let before = bearing;
        bearing += (rpm / 500.0 - bearing) * (1.0 - (-60.0_f64 / 2400.0).exp());
        late += (f64::midpoint(before, bearing) - late) * (1.0 - (-60.0_f64 / 1500.0).exp());
    }
    let t = t.iter().map(|t| t / if minutes { 60.0 } else { 1.0 }).collect();
    let mut rows = rows.into_iter();
    let mut next = || rows.next().unwrap();
    let columns = vec![
        ("t", "time", t),
        ("rpm", "spindle_speed", next()),
        ("T1", "temperature", next()),
        ("ex", "error.x", next()),
        ("ez", "error.z", next()),
    ];
    parsed("drift", Kind::Drift, columns)
}

const WARM: &str = "name = \"m\"\n[[effect]]\nname = \"thermal_lag.x\"\nsensor = \"T1\"\num_per_K = 3.1\num_per_K2 = 0.0\ntau_s = 1450.0\n\
    [[effect]]\nname = \"spindle_speed.z\"\num_per_krpm = 3.9\num_per_krpm2 = 0.0\n";

/// Minutes and revolutions a second that only the model shows.
/// No lag is named by a clock that is doubted, whoever doubts it.
#[test]
fn minutes_and_revolutions_a_second_that_only_the_model_shows_are_said() {
    for seed in 1..=3 {
        let clean = with_model(WARM, &warming(seed, false, false));
        assert_eq!((clean.verdict, kinds(&clean)), (Verdict::NothingMissing, vec![]), "{}", clean.to_json());
        for (minutes, revolutions, column) in [(true, false, "t"), (false, true, "rpm")] {
            let r = with_model(WARM, &warming(seed, minutes, revolutions));
            assert_eq!(kinds(&r), [(What::Unit, column)], "{}", r.to_json());
            assert!(names(&r).is_empty() && r.refined.is_empty(), "{}", r.to_json());
        }
        let r = with_model("name = \"m\"\n", &warming(seed, false, false));
        assert!(names(&r).contains(&"thermal_lag.x".to_owned()), "{}", r.to_json());
    }
}

/// Tool changes, say.
/// Every axis comes back to one place, and what is seen of its travel is a count. A run that was written in metres is told from it.
#[test]
fn an_axis_that_stands_is_no_other_unit() {
    for (at_mm, stroke_mm, doubted) in [(50.0, 0.0007, false), (0.0, 0.0007, false), (0.0, 300.0, true)] {
        let mut d = Dice::new(7);
        let axis = Axis::new("x").unwrap();
        let (mut columns, n) = (vec![Vec::new(); 4], 40);
        for i in 0..n {
            let up = i % 2 == 0;
            let p = at_mm + if up { stroke_mm * f64::from(i) / f64::from(n) } else { 0.0 };
            let dir = if up { 1.0 } else { -1.0 };
            let e = 54.0 * p / 1000.0 + 5.0 * dir + 1.2 * d.normal();
            let given = if doubted { p / 1000.0 } else { p };
            columns.iter_mut().zip([10.0 * f64::from(i), given, dir, e]).for_each(|(c, v)| c.push(v));
        }
        let roles =
            [Role::Time, Role::Position(axis.clone()), Role::Direction(axis.clone()), Role::Error(axis)];
        let columns = ["t", "x", "dir", "e"].into_iter().zip(roles).zip(columns);
        let columns = columns.map(|((n, r), v)| Column::new(n, r, v)).collect();
        let record = Record::new(Path::new("r.run.toml"), Kind::Positioning, columns).unwrap();
        let model = "name = \"m\"\n[[effect]]\nname = \"scale.x\"\nppm = 54.0\n[[effect]]\nname = \"reversal.x\"\num = 10.2\n";
        let model = Machine::parse(Path::new("m.toml"), model).unwrap();
        let r = reconcile(&[record], &[], &model, &Options::default()).unwrap();
        let said = r.suspicions.iter().any(|s| s.what == What::Unit);
        assert_eq!(said, doubted, "at {at_mm} mm, stroke {stroke_mm} mm: {:?}", r.suspicions);
    }
}
