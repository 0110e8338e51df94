//! Mistakes compared with effects that the model may lack.
//! The tests also check what is reported if a record was left out. The runs are made here, by formulas.

#![allow(clippy::unwrap_used)] // a test's own helpers

use crate::{answer, names, record};
use rtec_measure::plausible::MistakeKind;
use rtec_model::record::{Column, Record, RunKind};
use rtec_reconcile::{ReconciliationResult, Verdict};
use std::f64::consts::{PI, TAU};
use test_needs::dice::Dice;
use test_needs::repetitions;

fn kinds(r: &ReconciliationResult) -> Vec<(MistakeKind, &str)> {
    r.suspicions.iter().map(|s| (s.what, s.column.as_str())).collect()
}

/// The errors of both axes by place and by acceleration, mm/s².
type Law = dyn Fn([f64; 2], [f64; 2]) -> [f64; 2];

/// Half arcs to and fro about a centre, at 25 mm/s, between two angles.
fn arc(seed: u64, radius: f64, centre: [f64; 2], (from, to): (f64, f64), law: &Law) -> Record {
    let mut d = Dice::new(seed);
    let mut rows: Vec<Vec<f64>> = vec![Vec::new(); 5];
    let (n, rate) = (240, 25.0 / radius);
    for i in 0..2 * n {
        let share = f64::from(i % n) / f64::from(n - 1);
        let along = if i < n { share } else { 1.0 - share };
        let a = from + (to - from) * along;
        let away = [radius * a.cos(), radius * a.sin()];
        let p = [centre[0] + away[0], centre[1] + away[1]];
        let e = law(p, away.map(|v| -rate * rate * v));
        let t = (to - from) / rate * share + if i < n { 0.0 } else { (to - from) / rate + 3.0 };
        let row = [t, p[0], p[1], e[0] + 0.3 * d.normal(), e[1] + 0.3 * d.normal()];
        rows.iter_mut().zip(row).for_each(|(c, v)| c.push(v));
    }
    let roles = ["time", "position.x", "position.z", "error.x", "error.z"];
    let named = ["t", "px", "pz", "ex", "ez"].into_iter().zip(roles).zip(rows);
    record("circle", RunKind::Ballbar, named.map(|((n, r), v)| (n, r, v)).collect())
}

/// Two effects that resemble a mistake but are none.
/// On a quarter circle an axis' acceleration nearly cancels a known rotation. Along a vertical line, a tilt
/// at that place is as large as the missing scale. Neither is a column in another unit, or at another place.
#[test]
fn what_only_looks_like_a_mistake_is_none() {
    if !test_needs::long() {
        return;
    }
    let model =
        "[[effect]]\nname = \"scale.x\"\nppm = -13.0\n[[effect]]\nname = \"rotation.x.z\"\nurad = -11.5\n";
    for seed in repetitions(1..=3) {
        let law = |p: [f64; 2], a: [f64; 2]| [-0.0136 * p[0] + 0.0116 * p[1] + 4.224 * a[0], -0.0116 * p[0]];
        let run = arc(seed, 150.0, [-4.0, 175.0], (0.0, PI / 2.0), &law);
        let r = answer(model, &[run], &[]);
        assert_eq!(kinds(&r), [], "{}", r.to_json());
    }
    let model = "[[effect]]\nname = \"rotation.x.z\"\nurad = 24.0\n";
    let law = |p: [f64; 2]| [-0.0248 * p[1] + 131e-6 * p[0] * p[1], 0.0248 * p[0] - 0.0266 * p[1]];
    for seed in repetitions(1..=3) {
        let circle = arc(seed, 50.0, [0.0, 0.0], (0.0, 1.1 * TAU), &move |p, _| law(p));
        let r = answer(model, &[circle, line(seed, "z", 300.0, &law)], &[]);
        assert_eq!(kinds(&r), [], "{}", r.to_json());
        assert!(names(&r).contains(&"scale.z".to_owned()), "{}", r.to_json());
    }
}

/// Twice up and down one axis, the other at one place; errors of both.
fn line(seed: u64, axis: &str, at: f64, law: &dyn Fn([f64; 2]) -> [f64; 2]) -> Record {
    let mut d = Dice::new(seed + 50);
    let along: Vec<f64> = (0..84).map(|i: i32| 20.3 * f64::from(20 - (i % 42 - 20).abs().min(20))).collect();
    let places: Vec<[f64; 2]> = along.iter().map(|p| if axis == "x" { [*p, at] } else { [at, *p] }).collect();
    let mut of = |k: usize| places.iter().map(|p| law(*p)[k] + 0.3 * d.normal()).collect();
    let (ex, ez) = (of(0), of(1));
    let [px, pz] = [0, 1].map(|k| places.iter().map(|p| p[k]).collect());
    let columns = vec![
        ("px", "position.x", px),
        ("pz", "position.z", pz),
        ("ex", "error.x", ex),
        ("ez", "error.z", ez),
    ];
    record("line", RunKind::Positioning, columns)
}

/// Strokes of 400 mm, two out and two back, with a scale and a reversal.
/// The columns have these roles.
fn strokes(name: &str, seed: u64, roles: [&str; 3], per_um: f64) -> Record {
    let mut d = Dice::new(seed);
    let (mut p, mut way, mut e) = (Vec::new(), Vec::new(), Vec::new());
    for i in 0..160_i32 {
        let up = i % 40 < 20;
        let at = 24.7 * f64::from(if up { i % 40 } else { 39 - i % 40 }) - 33.3;
        p.push(at);
        way.push(if up { 1.0 } else { -1.0 });
        e.push((22.0 * at / 1000.0 + if up { 3.0 } else { -3.0 } + 0.2 * d.normal()) / per_um);
    }
    record(name, RunKind::Positioning, vec![("p", roles[0], p), ("way", roles[1], way), ("e", roles[2], e)])
}

const STROKES: &str =
    "[[effect]]\nname = \"scale.x\"\nppm = 23.0\n[[effect]]\nname = \"reversal.x\"\num = 5.8\n";
const RIGHT: [&str; 3] = ["position.x", "direction.x", "error.x"];

/// An axis' error was read, but the positions are in another axis' column.
/// The directions are exchanged too, or not.
#[test]
fn positions_in_another_axis_s_column_are_said() {
    for roles in [["position.y", "direction.x", "error.x"], ["position.y", "direction.y", "error.x"]] {
        let r = answer(STROKES, &[strokes("a", 1, roles, 1.0)], &[]);
        assert_eq!((kinds(&r), names(&r).len()), (vec![(MistakeKind::Swapped, "p")], 0), "{}", r.to_json());
    }
    // A true straightness is not reported as exchanged columns, because the model has nothing similar.
    let model = "[[effect]]\nname = \"scale.x\"\nppm = -40.0\n[[effect]]\nname = \"reversal.x\"\num = 9.0\n";
    let r = answer(model, &[strokes("a", 1, ["position.y", "direction.y", "error.x"], 1.0)], &[]);
    assert_eq!(kinds(&r), [], "{}", r.to_json());
}

/// A gauge that reads thousandths of an inch, or inches.
#[test]
fn errors_in_thousandths_of_an_inch_are_said() {
    assert_eq!(kinds(&answer(STROKES, &[strokes("a", 1, RIGHT, 1.0)], &[])), []);
    for (per_um, text) in [(25.4, "thousandths of an inch"), (25.4e3, "")] {
        let r = answer(STROKES, &[strokes("a", 1, RIGHT, per_um)], &[]);
        assert_eq!((kinds(&r), names(&r).len()), (vec![(MistakeKind::Unit, "e")], 0), "{}", r.to_json());
        assert!(r.suspicions[0].text.contains(text), "{:?}", r.suspicions);
    }
}

/// A hold-out that gets worse is said in the headline.
/// It does not change the verdict.
#[test]
fn a_headline_says_what_the_hold_out_does_not_confirm() {
    let model = "[[effect]]\nname = \"scale.x\"\nppm = 23.0\n";
    let [train, alike, mut mended] = [1, 2, 3].map(|seed| strokes("a", seed, RIGHT, 1.0));
    let way = mended.columns[1].data.clone();
    mended.columns[2].data.iter_mut().zip(way).for_each(|(e, way)| *e -= 3.0 * way);
    for (later, want) in [(alike, None), (mended, Some("not confirmed by the hold-out".to_owned()))] {
        let r = answer(model, std::slice::from_ref(&train), &[later]);
        assert_eq!((r.verdict, r.reservation()), (Verdict::Named, want), "{}", r.to_json());
    }
}

/// A record that was left out appears as not covered everywhere.
/// The headline, the advice and the document all say so.
#[test]
fn nothing_is_said_of_a_record_that_was_left_out() {
    let [good, mut bad] = [strokes("good", 1, RIGHT, 1.0), strokes("bad", 2, RIGHT, 1.0)];
    let r = answer(STROKES, std::slice::from_ref(&good), &[]);
    assert_eq!((r.verdict, r.reservation()), (Verdict::NothingMissing, None), "{}", r.to_json());
    bad.columns[2].data.iter_mut().for_each(|e| *e = -*e);
    let r = answer(STROKES, &[good.clone(), bad.clone()], &[]);
    assert_eq!(r.verdict, Verdict::NothingMissing, "{}", r.to_json());
    let headline = r.reservation().unwrap();
    assert!(headline.contains("bad.run.toml (sign)") && !headline.contains("good"), "{headline}");
    assert!(r.advice.starts_with("bad.run.toml (sign): nothing is said of it"), "{}", r.advice);
    assert_eq!(r.to_json()["nothing_said_of"], serde_json::json!(["bad.run.toml"]));
    // The same for a hold-out.
    let r = answer(STROKES, &[good], &[bad]);
    assert!(r.gap[0].holdout.is_none() && r.reservation().is_some(), "{}", r.to_json());
}

/// One of two hold-outs differs.
/// It is from another machine, or the model is wrong. The gap is reported with and without it.
#[test]
fn no_gap_is_narrower_for_a_hold_out_that_is_suspected() {
    let [train, good, mut strange] =
        ["train", "good", "strange"].map(|name| strokes(name, name.len() as u64, RIGHT, 1.0));
    for (i, e) in strange.columns[2].data.iter_mut().enumerate() {
        *e += 40.0 * (i as f64 / 9.0).sin();
    }
    let r = answer("effect = []\n", &[train], &[good, strange]);
    assert_eq!(kinds(&r), [(MistakeKind::OtherMachine, "")], "{:?}", r.suspicions);
    let [with, without] = [r.gap[0].holdout.unwrap()[1], r.gap[0].without_strangers.unwrap()[1]];
    assert!(with > 15.0 && without < 0.4, "{}", r.to_json());
    assert!(r.gap[0].closed().is_none_or(|c| c < 0.2), "{}", r.to_json());
    assert!(r.advice.contains("strange.run.toml: of another machine, or the model is wrong"), "{}", r.advice);
}

/// A gauge that was never read has no error to explain; the other column has one.
#[test]
fn a_gauge_that_stands_still_names_nothing() {
    let mut run = strokes("a", 1, RIGHT, 1.0);
    run.columns[2].data.fill(7.5);
    let r = answer("effect = []\n", std::slice::from_ref(&run), &[]);
    assert_eq!((kinds(&r), names(&r).len()), (vec![(MistakeKind::Stuck, "e")], 0), "{}", r.to_json());
    assert_eq!(r.verdict, Verdict::UnknownEffect, "{}", r.to_json());
    let other = strokes("b", 2, ["position.x", "direction.x", "error.z"], 1.0).columns.swap_remove(2);
    run.columns.push(Column { name: "ez".into(), ..other });
    let r = answer("effect = []\n", &[run], &[]);
    assert_eq!(kinds(&r), [(MistakeKind::Stuck, "e")], "{}", r.to_json());
    assert!(!names(&r).is_empty() && names(&r).iter().all(|n| n.contains(".z")), "{}", r.to_json());
}

/// Targets on a grid show a wave at many equally likely periods.
#[test]
fn a_wave_on_a_grid_of_targets_is_not_separable() {
    let mut d = Dice::new(4);
    let p: Vec<f64> = (0..205).map(|i: i32| 7.3 * f64::from(20 - (i % 41 - 20).abs())).collect();
    let e = p.iter().map(|p| 4.0 * (TAU * p / 17.1 + 0.4).sin() + 0.5 * d.normal()).collect();
    let run = record("grid", RunKind::Positioning, vec![("x", "position.x", p), ("e", "error.x", e)]);
    let r = answer("effect = []\n", &[run], &[]);
    assert_eq!(names(&r), ["screw_periodic.x"], "{}", r.to_json());
    let near = r.effects[0].0.rivals.iter().any(|r| r.differs.is_some() && r.margin < 0.7);
    assert_eq!(r.verdict == Verdict::NotSeparable, near, "{}", r.to_json());
    assert!(near, "{}", r.to_json());
}

/// A wave with two places per period has no definite size.
/// The size depends on the phase, and the period on the grid. A name needs an interval that excludes zero.
#[test]
fn a_wave_of_a_size_that_is_not_told_is_not_separable() {
    for seed in repetitions(1..=4) {
        let mut d = Dice::new(seed);
        let p: Vec<f64> = (0..205).map(|i: i32| 10.0 * f64::from(20 - (i % 41 - 20).abs())).collect();
        let e = p.iter().map(|p| 4.0 * (TAU * p / 20.0 + 0.3).cos() + 0.5 * d.normal()).collect();
        let run = record("grid", RunKind::Positioning, vec![("x", "position.x", p), ("e", "error.x", e)]);
        let r = answer("effect = []\n", &[run], &[]);
        assert_eq!(r.verdict, Verdict::NotSeparable, "{}", r.to_json());
    }
}

/// A reversal as large as the model's, with the opposite sign.
/// The directions agree with the positions, so it belongs to the machine. With exchanged directions they do
/// not agree.
#[test]
fn a_reversal_opposite_to_the_model_s_is_no_mistake_in_the_directions() {
    let model = "[[effect]]\nname = \"reversal.x\"\num = 7.0\n[[effect]]\nname = \"scale.x\"\nppm = 20.0\n";
    let run = |seed: u64, half_um: f64, logged: f64| {
        let mut d = Dice::new(seed);
        let mut rows: Vec<Vec<f64>> = vec![Vec::new(); 4];
        for i in 0..192_u32 {
            let (k, way) = (i % 16, if i / 16 % 2 == 0 { 1.0 } else { -1.0 });
            let p = 20.0 * f64::from(if way > 0.0 { k } else { 15 - k });
            let e = 0.02 * p + half_um * way + 0.3 * d.normal();
            rows.iter_mut().zip([10.0 * f64::from(i), p, logged * way, e]).for_each(|(c, v)| c.push(v));
        }
        let named = ["t", "x", "dir", "e"].into_iter();
        let named = named.zip(["time", "position.x", "direction.x", "error.x"]).zip(rows);
        record("line", RunKind::Positioning, named.map(|((n, r), v)| (n, r, v)).collect())
    };
    for seed in repetitions(1..=3) {
        let r = answer(model, &[run(seed, -3.5, 1.0)], &[]);
        assert_eq!(kinds(&r), [], "{}", r.to_json());
        let reversal = r.model.effects().find(|e| e.name() == "reversal.x").unwrap();
        assert!((reversal.values()[0] + 7.0).abs() < 0.3, "{}", r.to_json());
        let exchanged = answer(model, &[run(seed, 3.5, -1.0)], &[]);
        assert_eq!(kinds(&exchanged), [(MistakeKind::Direction, "dir")], "{}", exchanged.to_json());
    }
}

/// The share that blocks close is that of the better model.
/// Two known effects that no row tells apart are off together, and neither is corrected. That gap stays open.
#[test]
fn what_the_better_model_leaves_as_given_stays_in_the_gap() {
    let mut d = Dice::new(41);
    let at = |i: usize| if (i / 20).is_multiple_of(2) { (i % 20) as f64 } else { 19.0 - (i % 20) as f64 };
    let way = |i: usize| if (i / 20).is_multiple_of(2) { 1.0 } else { -1.0 };
    let of = |f: &mut dyn FnMut(usize) -> f64| (0..160).map(f).collect::<Vec<f64>>();
    let columns = vec![
        ("t", "time", of(&mut |i| 20.0 * i as f64)),
        ("x", "position.x", of(&mut |i| 25.0 * at(i))),
        ("d", "direction.x", of(&mut way.clone())),
        ("T1", "temperature", of(&mut |_| 25.0)),
        ("e", "error.x", of(&mut |i| 4.0 * way(i) + 0.212 * 25.0 * at(i) + 0.3 * d.normal())),
    ];
    let run = record("line", RunKind::Positioning, columns);
    let model = "[[effect]]\nname = \"scale.x\"\nppm = 100.0\n\
        [[effect]]\nname = \"thermal_expansion.x\"\nsensor = \"T1\"\nppm_per_K = 20.0\n";
    let r = answer(model, &[run], &[]);
    assert_eq!((names(&r), r.refined.len()), (vec!["reversal.x".to_owned()], 0), "{}", r.to_json());
    let ([_, left], [_, of_blocks]) = (r.gap[0].train, r.gap[0].blocked.unwrap());
    assert!(left > 1.0 && (of_blocks - left).abs() < 0.1 * left, "{left} µm, by blocks {of_blocks} µm");
}
