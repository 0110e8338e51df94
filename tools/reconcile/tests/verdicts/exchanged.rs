//! Exchanged columns and mistaken units that only the model shows.

#![allow(clippy::unwrap_used)] // a test's own helpers

use crate::names;
use rtec_measure::plausible::MistakeKind;
use rtec_model::machine::Machine;
use rtec_model::record::{Axis, Column, Record, Role, RunKind};
use rtec_reconcile::{ReconciliationOptions, ReconciliationResult, Verdict, reconcile};
use std::f64::consts::TAU;
use std::path::Path;
use test_needs::dice::Dice;
use test_needs::repetitions;

fn with_model(text: &str, train: &Record) -> ReconciliationResult {
    let model = Machine::parse(Path::new("m.toml"), text).unwrap();
    reconcile(std::slice::from_ref(train), &[], &model, &ReconciliationOptions::default()).unwrap()
}

fn parsed(name: &str, kind: RunKind, columns: Vec<(&str, &str, Vec<f64>)>) -> Record {
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

fn kinds(r: &ReconciliationResult) -> Vec<(MistakeKind, &str)> {
    r.suspicions.iter().map(|s| (s.what, s.column.as_str())).collect()
}

/// A grid of 100 mm by 60 mm with the errors of two scales.
/// `more` adds to both errors what the model lacks, by place.
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
    parsed("plate", RunKind::Plate, columns)
}

/// Two exchanged axes are neither squareness nor rotation.
/// A true squareness or rotation is still named.
#[test]
fn positions_or_errors_of_two_axes_exchanged_are_said() {
    if !test_needs::long() {
        return;
    }
    let model = "name = \"m\"\n[[effect]]\nname = \"scale.x\"\nppm = 50.0\n[[effect]]\nname = \"scale.y\"\nppm = -85.0\n";
    for seed in repetitions(1..=3) {
        for pair in [["x", "y"], ["ex", "ey"]] {
            let mut run = plate(seed, |_, _| [0.0, 0.0]);
            let clean = with_model(model, &run);
            assert_eq!((clean.verdict, kinds(&clean)), (Verdict::NothingMissing, vec![]));
            swap(&mut run, pair[0], pair[1]);
            let r = with_model(model, &run);
            assert_eq!(
                (kinds(&r), names(&r).len()),
                (vec![(MistakeKind::Swapped, pair[0])], 0),
                "{}",
                r.to_json()
            );
        }
        let turned = with_model(model, &plate(seed, |x, y| [-0.06 * y, 0.06 * x]));
        assert_eq!((kinds(&turned), names(&turned)), (vec![], vec!["rotation.x.y".to_owned()]));
        let oblique = with_model(model, &plate(seed, |_, y| [0.09 * y, 0.0]));
        assert_eq!((kinds(&oblique).len(), names(&oblique).len()), (0, 1));
    }
}

/// Three strokes.
/// A scale of the model that is off by a third is corrected. One that is off by the factor of an inch shows
/// another unit instead.
#[test]
fn inches_that_only_the_model_shows_are_said() {
    let run = |ppm: f64, per: f64| {
        let mut d = Dice::new(5);
        let p: Vec<f64> = (0..123).map(|i: i32| 12.4 * f64::from(20 - ((i % 41) - 20).abs()) + 3.7).collect();
        let e = p.iter().map(|p| ppm * p / 1000.0 + 0.5 * d.normal()).collect();
        let p = p.iter().map(|p| p / per).collect();
        parsed("off", RunKind::Positioning, vec![("x", "position.x", p), ("e", "error.x", e)])
    };
    let model = |ppm: f64| format!("name = \"m\"\n[[effect]]\nname = \"scale.x\"\nppm = {ppm}\n");
    for (given, ppm) in [(25.0, 24.0), (24.0, 24.0), (16.0, 24.0), (0.3, 24.0), (1.5, 24.0)] {
        assert_eq!(kinds(&with_model(&model(given), &run(ppm, 1.0))), [], "{given} for {ppm}");
    }
    let r = with_model(&model(25.0), &run(24.0, 25.4));
    assert_eq!((kinds(&r), r.refined.len()), (vec![(MistakeKind::Unit, "x")], 0), "{}", r.to_json());
}

/// The same with a reversal that the model lacks.
/// The reversal is found, and then the scale is off by the factor of an inch.
#[test]
fn inches_beside_a_missing_effect_are_said() {
    if !test_needs::long() {
        return;
    }
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
        parsed("strokes", RunKind::Positioning, columns)
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
    assert_eq!((kinds(&r), names(&r).len()), (vec![(MistakeKind::Unit, "x")], 0), "{}", r.to_json());
    assert!(r.refined.is_empty() && r.suspicions[0].text.contains("inch"), "{:?}", r.suspicions);
}

/// A circle of 100 mm radius, both ways, four times.
/// It has the errors of two scales, two reversals and a squareness.
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
    parsed("circle", RunKind::Ballbar, roles.into_iter().zip(columns).map(|((n, r), v)| (n, r, v)).collect())
}

/// The errors of a circle are exchanged beside a model that lacks much.
/// Alone the model does not show it. The best explanation of the circle is then far less likely than the one
/// with the exchange undone.
#[test]
fn exchanged_errors_that_the_model_does_not_show_are_said() {
    if !test_needs::long() {
        return;
    }
    let model = "name = \"m\"\n[[effect]]\nname = \"scale.x\"\nppm = -13.2\n[[effect]]\nname = \"reversal.x\"\num = 2.9\n";
    let mut run = circle(3);
    let clean = with_model(model, &run);
    assert_eq!((kinds(&clean), clean.verdict), (vec![], Verdict::Named), "{}", clean.to_json());
    swap(&mut run, "ex", "ez");
    let r = with_model(model, &run);
    assert_eq!((kinds(&r), names(&r).len()), (vec![(MistakeKind::Swapped, "ex")], 0), "{}", r.to_json());
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
        // In equilibrium at the first row, and linear from row to row.
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
    parsed("drift", RunKind::Drift, columns)
}

const WARM: &str = "name = \"m\"\n[[effect]]\nname = \"thermal_lag.x\"\nsensor = \"T1\"\num_per_K = 3.1\num_per_K2 = 0.0\ntau_s = 1450.0\n\
    [[effect]]\nname = \"spindle_speed.z\"\num_per_krpm = 3.9\num_per_krpm2 = 0.0\n";

/// Minutes and revolutions per second that only the model shows.
/// If a clock is doubted, no lag is named, whichever check doubts it.
#[test]
fn minutes_and_revolutions_a_second_that_only_the_model_shows_are_said() {
    if !test_needs::long() {
        return;
    }
    for seed in repetitions(1..=3) {
        let clean = with_model(WARM, &warming(seed, false, false));
        assert_eq!((clean.verdict, kinds(&clean)), (Verdict::NothingMissing, vec![]), "{}", clean.to_json());
        for (minutes, revolutions, column) in [(true, false, "t"), (false, true, "rpm")] {
            let r = with_model(WARM, &warming(seed, minutes, revolutions));
            assert_eq!(kinds(&r), [(MistakeKind::Unit, column)], "{}", r.to_json());
            assert!(names(&r).is_empty() && r.refined.is_empty(), "{}", r.to_json());
        }
        let r = with_model("name = \"m\"\n", &warming(seed, false, false));
        assert!(names(&r).contains(&"thermal_lag.x".to_owned()), "{}", r.to_json());
    }
}

/// An axis that returns to one place, for example to change tools.
/// Its logged travel is a single count. A run written in metres is still recognised.
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
        let record = Record::new(Path::new("r.run.toml"), RunKind::Positioning, columns).unwrap();
        let model = "name = \"m\"\n[[effect]]\nname = \"scale.x\"\nppm = 54.0\n[[effect]]\nname = \"reversal.x\"\num = 10.2\n";
        let model = Machine::parse(Path::new("m.toml"), model).unwrap();
        let r = reconcile(&[record], &[], &model, &ReconciliationOptions::default()).unwrap();
        let said = r.suspicions.iter().any(|s| s.what == MistakeKind::Unit);
        assert_eq!(said, doubted, "at {at_mm} mm, stroke {stroke_mm} mm: {:?}", r.suspicions);
    }
}

/// A drift test with coolant, loads and accelerations, beside a model of them.
/// The mistake is in an input that the model reads.
#[test]
fn inputs_that_only_the_model_shows_as_mistaken_are_said() {
    let model = "name = \"m\"\n[[effect]]\nname = \"coolant.x\"\num = 7.6\n[[effect]]\nname = \"coolant.z\"\num = -5.2\n\
        [[effect]]\nname = \"stiffness.x\"\num_per_N = 0.019\n[[effect]]\nname = \"stiffness.z\"\num_per_N = 0.0105\n";
    let run = |seed: u64, mistake: &str| {
        let mut d = Dice::new(seed);
        let mut columns: Vec<Vec<f64>> = vec![Vec::new(); 6];
        for i in 0..160_i32 {
            let wet = f64::from(i / 20 % 3 == 1);
            let (px, pz) = (100.0 * f64::from(i % 7), 80.0 * f64::from(i % 5));
            let ex = 8.0 * wet + 0.020 * px + 0.3 * d.normal();
            let ez = -5.0 * wet + 0.010 * pz + 0.3 * d.normal();
            let wet = if mistake == "wet" { 1.0 - wet } else { wet };
            let by = if mistake == "Px" { 9.81 } else { 1.0 };
            columns
                .iter_mut()
                .zip([10.0 * f64::from(i), wet, px / by, pz / by, ex, ez])
                .for_each(|(c, v)| c.push(v));
        }
        let roles = [
            ("t", "time"),
            ("wet", "coolant"),
            ("Px", "load.x"),
            ("Pz", "load.z"),
            ("ex", "error.x"),
            ("ez", "error.z"),
        ];
        parsed("press", RunKind::Drift, roles.into_iter().zip(columns).map(|((n, r), v)| (n, r, v)).collect())
    };
    for seed in repetitions(1..=3) {
        let clean = with_model(model, &run(seed, ""));
        assert_eq!((clean.verdict, kinds(&clean)), (Verdict::NothingMissing, vec![]), "{}", clean.to_json());
        for (what, column) in [(MistakeKind::Swapped, "wet"), (MistakeKind::Unit, "Px")] {
            let r = with_model(model, &run(seed, column));
            assert_eq!((kinds(&r), r.refined.len()), (vec![(what, column)], 0), "{}", r.to_json());
        }
    }
}

/// A force at accelerations that were written in m/s² under mm/s².
#[test]
fn accelerations_in_metres_that_only_the_model_shows_are_said() {
    let model = "name = \"m\"\n[[effect]]\nname = \"inertia.x\"\nkg = 210.0\n[[effect]]\nname = \"friction_coulomb.x\"\nN = 55.0\n";
    for (per, said) in [(1.0, vec![]), (1000.0, vec![(MistakeKind::Unit, "ax")])] {
        let mut d = Dice::new(11);
        let mut columns: Vec<Vec<f64>> = vec![Vec::new(); 5];
        for i in 0..400_i32 {
            let t = 0.01 * f64::from(i);
            let (x, v, a) = (50.0 * (2.0 * t).sin(), 100.0 * (2.0 * t).cos(), -200.0 * (2.0 * t).sin());
            let a = 5.0 * a;
            let f = 0.2 * a + 50.0 * v.signum() + 3.0 * d.normal();
            columns.iter_mut().zip([t, x, v, a / per, f]).for_each(|(c, v)| c.push(v));
        }
        let roles = [
            ("t", "time"),
            ("x", "position.x"),
            ("vx", "velocity.x"),
            ("ax", "acceleration.x"),
            ("fx", "force.x"),
        ];
        let run = parsed(
            "swing",
            RunKind::Dynamics,
            roles.into_iter().zip(columns).map(|((n, r), v)| (n, r, v)).collect(),
        );
        let r = with_model(model, &run);
        assert_eq!(kinds(&r), said, "{}", r.to_json());
    }
}
