//! What no effect explains gets no name.
//! The shapes are real ones that resemble a law, and readings that the model explains.

#![allow(clippy::unwrap_used)] // a test's own helpers

use crate::noise::noise;
use crate::{answer, names, record};
use rtec_measure::plausible::MistakeKind;
use rtec_model::ballbar_circle::Circle;
use rtec_model::machine::Machine;
use rtec_model::record::{Axis, Record, RunKind};
use rtec_reconcile::{ReconciliationOptions, ReconciliationResult, Verdict, reconcile};
use std::f64::consts::TAU;
use test_needs::dice::Dice;
use test_needs::repetitions;

fn nameless(model: &str, train: &[Record]) {
    let said = answer(model, train, &[]);
    let names: Vec<String> = said.effects.iter().map(|(f, _)| f.effect.name()).collect();
    assert!(names.is_empty(), "{names:?}");
    assert_eq!(said.verdict, Verdict::UnknownEffect, "{:?}", said.unexplained);
}

/// A drift of one axis with a given error, µm over seconds.
fn drift(name: &str, seed: u64, of: impl Fn(f64) -> f64) -> Record {
    let mut d = Dice::new(seed);
    let t: Vec<f64> = (0..240).map(|i| 20.0 * f64::from(i)).collect();
    let e = t.iter().map(|t| of(*t) + 0.1 * d.normal()).collect();
    record(name, RunKind::Drift, vec![("t", "time", t), ("e", "error.x", e)])
}

#[test]
fn a_stand_that_creeps_is_no_warm_up() {
    for seed in repetitions(1..4) {
        nameless("", &[drift("a", seed, |t| 1.5 * (t / 30.0).ln_1p())]);
    }
}

/// A part that rests in either of two places, and drifts in no known way.
/// Beside what is unknown over time, none of its steps is lost counts.
#[test]
fn no_name_is_given_to_a_part_of_what_is_unknown() {
    for seed in repetitions(1..9) {
        let mut d = Dice::new(seed);
        let mut at: Vec<f64> = Vec::new();
        while at.last().is_none_or(|t| *t < 4800.0) {
            at.push(at.last().unwrap_or(&0.0) + 150.0 - 600.0 * d.between(0.02, 1.0).ln());
        }
        let place = |t: f64| 1.2 * f64::from(u8::from(at.iter().filter(|s| **s < t).count() % 2 == 1));
        let bend = |t: f64| 1.5 * (t / 500.0).sin() * (t / 1300.0).cos();
        nameless("", &[drift("a", seed, |t| place(t) + bend(t))]);
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

/// A chiller that switches: the error creeps and falls back, seven times in a run.
#[test]
fn a_saw_over_time_is_missing() {
    for seed in repetitions(1..4) {
        let mut d = Dice::new(seed);
        let t: Vec<f64> = (0..72).map(|i| 20.0 * f64::from(i)).collect();
        let saw = |t: f64| 10.0 * ((t / 198.0 + 0.3).rem_euclid(1.0) - 0.5);
        let e = t.iter().map(|t| saw(*t) + 0.4 * d.normal()).collect();
        let said =
            answer("", &[record("a", RunKind::Drift, vec![("t", "time", t), ("e", "error.x", e)])], &[]);
        let manners: Vec<&str> = said.unexplained.iter().map(|s| s.manner.as_str()).collect();
        assert_eq!((said.verdict, manners), (Verdict::UnknownEffect, vec!["saw-tooth"]));
    }
}

/// A line that is homed again before each cycle has another level in each.
#[test]
fn what_differs_from_cycle_to_cycle_is_no_lost_count() {
    let line = |name: &str, seed: u64, cycles: usize| {
        let mut d = Dice::new(seed);
        let levels: Vec<f64> = (0..cycles).map(|_| 1.5 * d.normal()).collect();
        let mut rows: Vec<Vec<f64>> = vec![Vec::new(); 5];
        for row in 0..14 * 2 * cycles {
            let (lap, at) = (row / 14, row % 14);
            let place = if lap % 2 == 0 { at } else { 13 - at };
            let direction = if lap % 2 == 0 { 1.0 } else { -1.0 };
            let e = levels[lap / 2] + 0.3 * d.normal();
            let row = [5.0 * row as f64, 20.0 * place as f64, direction, (lap / 2 + 1) as f64, e];
            rows.iter_mut().zip(row).for_each(|(c, v)| c.push(v));
        }
        let roles =
            [("t", "time"), ("x", "position.x"), ("d", "direction.x"), ("n", "cycle"), ("e", "error.x")];
        let columns = roles.into_iter().zip(rows).map(|((n, r), v)| (n, r, v)).collect();
        record(name, RunKind::Positioning, columns)
    };
    for seed in repetitions(1..9) {
        nameless("", &[line("a", seed, 5), line("b", seed + 50, 3)]);
    }
}

/// Two circles with a vibration that comes and goes, each at its own frequency.
#[test]
fn a_vibration_of_each_run_is_no_map() {
    if !test_needs::long() {
        return;
    }
    let bar = |name: &str, seed: u64, rows_per_wave: f64, way: f64| {
        let mut d = Dice::new(seed);
        let n = 0..720;
        let angle = n.clone().map(|i| way * TAU * f64::from(i) / 720.0).collect();
        let vibration = |i: f64| {
            let turns = i / rows_per_wave;
            4.0 * (TAU * turns + seed as f64).sin() * (1.0 + 0.6 * (TAU * turns / 11.0).sin())
        };
        let e = n.clone().map(|i| vibration(f64::from(i)) + 0.3 * d.normal()).collect();
        let t = n.map(|i| 0.1 * f64::from(i)).collect();
        let r = record(
            name,
            RunKind::Ballbar,
            vec![("t", "time", t), ("a", "angle", angle), ("e", "error.r", e)],
        );
        let plane = ["x", "y"].map(|a| Axis::new(a).unwrap());
        r.with_circle(Circle { radius_mm: 100.0, plane, centre_mm: Some([0.0, 0.0]) }).unwrap()
    };
    for (seed, there, back) in [(0, 10.0, 10.0), (3, 28.4, 20.8), (7, 33.0, 15.4), (13, 10.0, 37.0)] {
        nameless("", &[bar("there", seed, there, 1.0), bar("back", seed + 9, back, -1.0)]);
    }
}

/// A wave that comes and goes along the travel, and turns its sign.
#[test]
fn a_wave_of_changing_size_is_not_two_waves() {
    if !test_needs::long() {
        return;
    }
    for (seed, period_mm) in [(0, 8.0), (1, 10.0), (6, 10.0), (10, 8.0)] {
        let mut d = Dice::new(seed);
        let waves: Vec<[f64; 3]> = (1..=5)
            .map(|k| {
                let k = f64::from(k);
                [2.0 * d.normal() / (1.0 + 0.3 * k), k + 0.2 * d.normal(), TAU * d.normal()]
            })
            .collect();
        let place = |i: u32| 1.01 * f64::from(i) + 0.3 * f64::from(i * 7 % 11) / 11.0;
        let x: Vec<f64> = (0..620).chain((0..620).rev()).map(place).collect();
        let size = |x: f64| waves.iter().map(|[a, f, at]| a * (TAU * f * x / 630.0 + at).sin()).sum::<f64>();
        let e = x.iter().map(|x| size(*x) * (TAU * x / period_mm).sin() + 0.1 * d.normal()).collect();
        let t = (0..1240).map(|i| 3.0 * f64::from(i)).collect();
        let way = (0..1240).map(|i| if i < 620 { 1.0 } else { -1.0 }).collect();
        let columns =
            vec![("t", "time", t), ("x", "position.x", x), ("d", "direction.x", way), ("e", "error.x", e)];
        nameless("", &[record("line", RunKind::Positioning, columns)]);
    }
}

/// A part that resonates at one speed of the spindle is no line in the speed.
#[test]
fn a_resonance_is_one_error_without_a_name() {
    for seed in repetitions(1..4) {
        let mut d = Dice::new(seed);
        let speeds = [0.0, 2500.0, 5200.0, 6000.0, 7100.0, 8000.0, 6600.0, 4000.0, 1200.0];
        let rpm: Vec<f64> = (0..270).map(|i| speeds[i / 30]).collect();
        let bell = |n: f64| if n > 0.0 { 5.0 / (1.0 + ((n - 7000.0) / 700.0).powi(2)) } else { 0.0 };
        let e = rpm.iter().map(|n| bell(*n) + 0.1 * d.normal()).collect();
        let t = (0..270).map(|i| 20.0 * f64::from(i)).collect();
        let columns = vec![("t", "time", t), ("n", "spindle_speed", rpm), ("e", "error.z", e)];
        nameless("", &[record("speeds", RunKind::Drift, columns)]);
    }
}

/// A line to and fro at which each place has its own level.
/// The level depends on the direction of approach and is the same in all cycles.
#[test]
fn what_repeats_at_its_places_is_seen_whatever_its_form() {
    for seed in repetitions(1..4) {
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
        let said = answer("", &[record("line", RunKind::Positioning, columns)], &[]);
        assert!(!said.unexplained.is_empty(), "{:?}", said.verdict);
    }
}

/// A motor's cogging: a force periodic in the position, which no effect describes.
#[test]
fn a_force_that_swings_with_the_place_is_missing() {
    let effect = |law: &str, value: &str| format!("[[effect]]\nname = \"{law}.x\"\n{value}\n");
    let model = effect("inertia", "kg = 430.0")
        + &effect("friction_viscous", "N_s_per_m = 320.0")
        + &effect("friction_coulomb", "N = 100.0");
    for (seed, period_mm) in [(1_u64, 12.0), (2, 32.0), (3, 60.0)] {
        let mut dice = Dice::new(seed);
        let mut columns: [Vec<f64>; 5] = Default::default();
        for i in 0..600 {
            let t = 0.02 * f64::from(i);
            let (w, stroke_mm) = (1.3, 100.0);
            let (x, v) = (-stroke_mm * (w * t).cos(), stroke_mm * w * (w * t).sin());
            let a = -w * w * x;
            let force = 0.43 * a + 0.32 * v + 100.0 * v.signum();
            let cogs = 60.0 * (TAU * x / period_mm + 0.7).sin();
            let row = [t, x, v, a, force + cogs + 5.0 * dice.normal()];
            row.into_iter().zip(&mut columns).for_each(|(v, c)| c.push(v));
        }
        let roles = [
            ("t", "time"),
            ("x", "position.x"),
            ("v", "velocity.x"),
            ("a", "acceleration.x"),
            ("f", "force.x"),
        ];
        let columns = roles.into_iter().zip(columns).map(|((name, role), data)| (name, role, data)).collect();
        let said = answer(&model, &[record("dyn", RunKind::Dynamics, columns)], &[]);
        assert_eq!(said.verdict, Verdict::UnknownEffect, "{period_mm} mm");
        assert!(said.effects.is_empty(), "{period_mm} mm: {:?}", said.effects);
        let of_place = said.unexplained.iter().any(|s| s.against == ["position.x"]);
        assert!(of_place, "{period_mm} mm: {:?}", said.unexplained);
    }
}

/// A narrow bump that the model knows differs much from the rows beside it.
/// A misread row does so too.
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
    let said = answer(model, &[record("ring", RunKind::Part, columns)], &[]);
    assert_eq!(said.suspicions.iter().map(ToString::to_string).collect::<Vec<_>>(), Vec::<String>::new());
}

/// A line to and fro, five times, with only noise.
fn line(name: &str, seed: u64, noise_um: f64) -> Record {
    let mut d = Dice::new(seed);
    let mut rows: Vec<Vec<f64>> = vec![Vec::new(); 4];
    for row in 0..31 * 2 * 5 {
        let (lap, at) = (row / 31, row % 31);
        let back = lap % 2 == 1;
        let place = if back { 30 - at } else { at };
        // Uneven places, so that no wave looks like another.
        let mm = 20.0 * f64::from(place) + 0.9 * f64::from(place * 7 % 11);
        let direction = if back { -1.0 } else { 1.0 };
        let row = [5.0 * f64::from(row), mm, direction, noise_um * d.normal()];
        rows.iter_mut().zip(row).for_each(|(c, v)| c.push(v));
    }
    let roles = [("t", "time"), ("x", "position.x"), ("d", "direction.x"), ("e", "error.x")];
    let columns = roles.into_iter().zip(rows).map(|((n, r), v)| (n, r, v)).collect();
    record(name, RunKind::Positioning, columns)
}

/// The air is quiet on one day and not on another.
/// The noise of the second run gives no information about the first.
#[test]
fn each_run_has_noise_of_its_own_size() {
    for seed in repetitions(0..12) {
        let runs = [line("quiet", 2 * seed, 0.1), line("loud", 2 * seed + 1, 0.6)];
        let said = answer("", &runs, &[]);
        assert_eq!(said.verdict, Verdict::NothingMissing, "{seed}: {:?}", said.unexplained);
    }
}

/// A gauge with constant readings shows neither its noise nor its unit.
#[test]
fn a_gauge_that_stands_still_says_nothing() {
    let steady = |name: &str, seed: u64| {
        let mut d = Dice::new(seed);
        let t: Vec<f64> = (0..240).map(|i| 20.0 * f64::from(i)).collect();
        let moves = t.iter().map(|_| 0.3 * d.normal()).collect();
        let still = vec![40.0; 240];
        let columns = vec![("t", "time", t), ("e", "error.x", moves), ("f", "error.z", still)];
        record(name, RunKind::Drift, columns)
    };
    let said = answer("", &[steady("a", 1), steady("b", 2)], &[]);
    assert_eq!(said.verdict, Verdict::NothingMissing, "{:?}", said.unexplained);
    assert!(said.suspicions.iter().all(|s| s.what != MistakeKind::Unit), "{:?}", said.suspicions);
}

/// What is missing in this run, with a curve where nothing has a name.
fn with_curve(train: Record, later: &[Record]) -> ReconciliationResult {
    let options = ReconciliationOptions { unexplained: true, ..ReconciliationOptions::default() };
    reconcile(&[train], later, &Machine::ideal("m"), &options).unwrap()
}

/// A curve must help rows that it was not fitted to.
#[test]
fn a_curve_that_helps_nothing_is_not_written() {
    if !test_needs::long() {
        return;
    }
    let saw = |period_s: f64| move |t: f64| 8.0 * ((t / period_s).fract() - 0.5);
    let run = |name: &str, seed: u64, of: &dyn Fn(f64) -> f64| {
        let mut dice = Dice::new(seed);
        let t: Vec<f64> = (0..240).map(|i| 5.0 * f64::from(i)).collect();
        let e = t.iter().map(|t| of(*t) + 0.3 * dice.normal()).collect();
        let p = (0..240).map(|i| f64::from(i * 37 % 101)).collect();
        record(
            name,
            RunKind::Positioning,
            vec![("t", "time", t), ("x", "position.x", p), ("e", "error.x", e)],
        )
    };
    let helps = with_curve(run("a", 1, &saw(450.0)), &[]);
    assert!(helps.curve.is_some() && helps.no_curve.is_none(), "{:?}", helps.no_curve);
    let same = with_curve(run("a", 1, &saw(450.0)), &[run("b", 2, &saw(450.0))]);
    assert!(same.curve.is_some(), "{:?}", same.no_curve);
    // The later run has no saw.
    let other = with_curve(run("a", 1, &saw(450.0)), &[run("b", 2, &|_| 0.0)]);
    let why = other.no_curve.as_deref().unwrap_or_default();
    assert!(other.curve.is_none() && why.starts_with("the hold-outs are no better"), "{why}");
    assert_eq!(other.verdict, Verdict::UnknownEffect);
    assert!(other.model.effects().all(|e| !e.name().starts_with("unexplained")));
    // More teeth than the curve has knots.
    let fast = with_curve(run("a", 1, &saw(50.0)), &[]);
    if fast.verdict == Verdict::UnknownEffect {
        assert!(fast.curve.is_none() && fast.no_curve.is_some(), "{:?}", fast.curve);
    }
}

/// Above the floor something is always said of where.
#[test]
fn above_the_floor_is_more_than_chance() {
    let mut said = with_curve(drift("a", 3, |_| 0.0), &[]);
    let gap = |left: f64, said: &ReconciliationResult| {
        let mut gap = said.gap[0].clone();
        gap.train[0] = left * gap.floor;
        said.is_above_floor(&gap)
    };
    // 240 independent rows: chance is nine percent of the RMS.
    assert_eq!([gap(1.0, &said), gap(1.05, &said), gap(1.2, &said)], [false, false, true]);
    said.phi = 0.7;
    assert!(!gap(1.1, &said), "so much memory leaves few independent rows");
}

#[test]
fn growth_read_in_coarse_steps_is_no_shape() {
    // A dial in steps of 1 µm follows a growth of 2 µm up and down. Noise changes a few readings.
    let model =
        "[[effect]]\nname = \"thermal_growth.x\"\num_per_K = -0.33\nsensor = \"T1\"\nreference_degC = 20.0\n";
    let mut loud = Vec::new();
    for seed in repetitions(1..=8) {
        let mut d = Dice::new(seed);
        let t: Vec<f64> = (0..900).map(|i| 16.0 * f64::from(i)).collect();
        let warm: Vec<f64> = t.iter().map(|t| 19.8 + 3.5 * (1.0 - (t / 1000.0).cos())).collect();
        let zero = 30.0 + 0.1 * seed as f64;
        let error = warm.iter().map(|k| (zero - 0.32 * (k - 20.0) + 0.2 * d.normal()).round()).collect();
        let columns = vec![("t", "time", t), ("T1", "temperature", warm), ("e", "error.x", error)];
        let r = answer(model, &[record("drift", RunKind::Drift, columns)], &[]);
        if r.verdict != Verdict::NothingMissing {
            loud.push((seed, names(&r), r.unexplained));
        }
    }
    assert!(loud.is_empty(), "{loud:?}");
}

#[test]
fn a_map_of_a_few_rows_is_no_noise() {
    // Beside two long lines, one along y with a dozen readings and noise that has a memory.
    let mut loud = Vec::new();
    for seed in repetitions(1..=40) {
        let mut d = Dice::new(seed);
        let mut line = |axis: &str, count: u32, memory: f64| {
            let rows = || (0..count).map(f64::from);
            let mut before = 0.0;
            let error = rows().map(|_| {
                before = memory * before + 0.12 * d.normal();
                before
            });
            let (time, place) = rows().map(|i| (20.0 * i, 200.0 * i / f64::from(count))).unzip();
            let roles = [format!("position.{axis}"), format!("error.{axis}")];
            let columns =
                vec![("t", "time", time), ("p", &*roles[0], place), ("e", &*roles[1], error.collect())];
            record(axis, RunKind::Positioning, columns)
        };
        let r = answer("", &[line("x", 120, 0.3), line("y", 12, 0.7), line("z", 120, 0.3)], &[]);
        if r.verdict != Verdict::NothingMissing {
            loud.push((seed, names(&r), r.unexplained));
        }
    }
    assert!(loud.is_empty(), "{loud:?}");
}

/// A wave that grows to both ends of a long line with few, uneven targets.
/// At its own period such a wave shows no power, and a shape with a level at each target fits as well.
#[test]
fn a_wave_that_grows_from_the_middle_is_named() {
    let mut draw = noise(17);
    let mut places: Vec<f64> = (0..31).map(|k| -590.0 + 39.0 * f64::from(k) + 6.0 * draw()).collect();
    let (mut y, mut d, mut n, mut e) = (vec![], vec![], vec![], vec![]);
    for pass in 0..6 {
        for mm in &places {
            let turn = (std::f64::consts::TAU * mm / 20.0 + 2.07).sin();
            y.push(*mm);
            d.push(if pass % 2 == 0 { 1.0 } else { -1.0 });
            n.push(f64::from(pass / 2 + 1));
            e.push(12.7 * mm / 1000.0 + (1.15 + 10.5 * mm / 1000.0) * turn + 0.1 * draw());
        }
        places.reverse();
    }
    let rows = y.len() as i32;
    let columns = vec![
        ("t", "time", (0..rows).map(|i| 4.0 * f64::from(i)).collect()),
        ("n", "cycle", n),
        ("y", "position.y", y),
        ("d", "direction.y", d),
        ("e", "error.y", e),
    ];
    let r = answer("", &[record("line", RunKind::Positioning, columns)], &[]);
    let mut names = names(&r);
    names.sort();
    assert_eq!(names, ["scale.y", "screw_periodic.y", "screw_slope.y"], "{}", r.to_json());
    assert!(r.unexplained.is_empty());
}
