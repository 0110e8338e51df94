//! Columns, signs and cycles that were exchanged or copied.

use super::{
    Clean, Machine, Mistake, again, along, by_name, column, drift, positioning, record, rounded, to_and_fro,
    two_drift, warming,
};
use rtec_measure::plausible::{MistakeKind, suspicions};
use rtec_model::record::{Column, Record, Role, RunKind};
use std::f64::consts::TAU;
use test_needs::dice::Dice;

/// The directions are those of x, and y moves as they say.
/// With its own directions it is a straightness.
#[test]
fn positions_in_another_axis_s_column_are_said() {
    let of = |way: &str, still: bool| {
        let mut d = Dice::new(6);
        let at = |i: i32| 30.0 * f64::from(10 - (i % 20 - 10).abs());
        let mut columns = vec![
            column("y", "position.y", (0..100).map(at).collect()),
            column(
                "way",
                way,
                (0..100).map(|i| if (1..=10).contains(&(i % 20)) { 1.0 } else { -1.0 }).collect(),
            ),
            column("e", "error.x", (0..100).map(|_| 2.0 * d.normal()).collect()),
        ];
        if still {
            columns.push(column("x", "position.x", vec![0.0; 100]));
        }
        suspicions(&[record("line", RunKind::Positioning, columns)])
    };
    for still in [false, true] {
        let said: Vec<(MistakeKind, String)> =
            of("direction.x", still).into_iter().map(|s| (s.what, s.column)).collect();
        assert_eq!(said, [(MistakeKind::Swapped, "y".to_owned())]);
        assert_eq!(of("direction.y", still), []);
    }
}

/// An angle in degrees whatever its steps are, and one that is not that of the positions.
#[test]
fn another_angle_on_a_circle_is_said() {
    let record = |rows: u32, turns: f64, of: fn(f64) -> f64, positions: bool| {
        let truth: Vec<f64> =
            (0..rows).map(|i| TAU * turns * (f64::from(i) + 0.3) / f64::from(rows)).collect();
        let place = |f: fn(f64) -> f64| truth.iter().map(|a| 150.0 * f(*a)).collect::<Vec<_>>();
        let mut columns = vec![
            column("a", "angle", truth.iter().map(|a| of(*a)).collect()),
            column("e", "error.r", truth.iter().map(|a| 2.0 * (2.0 * a).sin() + (a * 97.0).sin()).collect()),
        ];
        if positions {
            columns.push(column("x", "position.x", place(f64::cos)));
            columns.push(column("y", "position.y", place(f64::sin)));
        }
        let plane = ["x", "y"].map(|n| rtec_model::record::Axis::new(n).unwrap());
        let circle = rtec_model::ballbar_circle::Circle { radius_mm: 150.0, plane, centre_mm: None };
        record("b", RunKind::Ballbar, columns).with_circle(circle).unwrap()
    };
    let said = |r: Record| suspicions(&[r]).into_iter().map(|s| (s.what, s.column)).collect::<Vec<_>>();
    let is = |what: MistakeKind| vec![(what, "a".to_owned())];
    for rows in [500, 777, 7200] {
        for turns in [0.5, 1.0, 2.0] {
            for positions in [false, turns > 0.9] {
                assert_eq!(said(record(rows, turns, |a| a, positions)), [], "{rows} {turns}");
                let degrees = record(rows, turns, f64::to_degrees, positions);
                assert_eq!(said(degrees), is(MistakeKind::Unit), "{rows} {turns} {positions}");
            }
        }
    }
    // From another axis, the other way round; late by a third of a degree is none.
    assert_eq!(said(record(720, 2.0, |a| a + 0.005, true)), []);
    assert_eq!(said(record(720, 2.0, |a| a + TAU, true)), []);
    assert!(said(record(720, 2.0, |a| a + TAU / 4.0, true)).contains(&is(MistakeKind::Swapped)[0]));
    assert!(said(record(720, 2.0, |a| -a, true)).contains(&is(MistakeKind::Swapped)[0]));
}

/// A gauge that stands for a stretch, and two sensors in each other's place, in one of two records or on the way: most are said, and
/// their clean twins are not.
#[test]
fn stretches_and_exchanges_are_said() {
    fn stands(mut r: Vec<Record>, d: &mut Dice) -> Vec<Record> {
        let k = r.len() - 1;
        let n = r[k].rows();
        let (from, rows) = (5 + d.below(n - 10), 10 + d.below(n / 8));
        let e = &mut by_name(&mut r[k], "e").data;
        let held = e[from];
        e[from..(from + rows).min(n)].iter_mut().for_each(|v| *v = held);
        r[k] = again(&r[k]);
        r
    }
    fn crossed(mut r: Vec<Record>, d: &mut Dice, from: usize) -> Vec<Record> {
        let k = r.len() - 1;
        let sensors = r[k].names(&Role::Temperature).count();
        let (a, b) = (1 + d.below(sensors - 1), d.below(sensors));
        let b = if a == b { 0 } else { b };
        let (x, y) = (format!("T{a}"), format!("T{b}"));
        let (old, new) = (by_name(&mut r[k], &x).data.clone(), by_name(&mut r[k], &y).data.clone());
        by_name(&mut r[k], &x).data[from..].copy_from_slice(&new[from..]);
        by_name(&mut r[k], &y).data[from..].copy_from_slice(&old[from..]);
        r[k] = again(&r[k]);
        r
    }
    const KINDS: [(&str, Clean, Mistake, MistakeKind, f64); 4] = [
        ("a gauge stands for a stretch, drift", drift, stands, MistakeKind::Stuck, 0.8),
        ("a gauge stands for a stretch, positioning", positioning, stands, MistakeKind::Stuck, 0.5),
        (
            "two sensors exchanged in one of two records",
            two_drift,
            |r, d| crossed(r, d, 0),
            MistakeKind::Swapped,
            0.4,
        ),
        (
            "two sensors exchanged on the way",
            warming,
            |r, d| {
                let at = r[0].rows() / 3 + d.below(r[0].rows() / 2);
                crossed(r, d, at)
            },
            MistakeKind::Swapped,
            0.5,
        ),
    ];
    if !test_needs::long() {
        return;
    }
    let (mut wrong, mut clean) = (0, 0);
    for (k, (name, make, mistake, what, least)) in KINDS.iter().enumerate() {
        let (mut said, turns) = (0, 12);
        for turn in 0..turns {
            let mut d = Dice::new(90_000 + 1000 * k as u64 + turn);
            let machine = Machine::random(&mut d);
            let records = make(&machine, &mut d);
            let twin = suspicions(&records);
            (clean, wrong) = (clean + 1, wrong + usize::from(!twin.is_empty()));
            for s in &twin {
                println!("clean: {s}");
            }
            said += u64::from(suspicions(&mistake(records, &mut d)).iter().any(|s| s.what == *what));
        }
        println!("{name}: {said} of {turns}");
        assert!(said as f64 >= least * turns as f64, "{name}: {said} of {turns}");
    }
    println!("clean suspected {wrong} of {clean}");
    assert!(wrong == 0, "clean suspected {wrong} of {clean}");
}

/// Five cycles over eleven targets, 30 ppm and 4 µm of play.
fn cycles(seed: u64) -> Vec<Column> {
    let mut d = Dice::new(seed);
    let (mut x, mut way, mut n, mut e) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for cycle in 1..=5 {
        for w in [1.0, -1.0] {
            for k in 0..11 {
                let p = 50.0 * f64::from(if w > 0.0 { k } else { 10 - k });
                x.push(p);
                way.push(w);
                n.push(f64::from(cycle));
                e.push(0.03 * p + 2.0 * w + 3.0 * (p / 80.0).sin() + 0.3 * d.normal());
            }
        }
    }
    vec![
        column("x", "position.x", x),
        column("d", "direction.x", way),
        column("n", "cycle", n),
        column("e", "error.x", e),
    ]
}

/// One cycle with the other sign, one cycle pasted under a number of its own; and their clean twins.
#[test]
fn signs_and_copies_of_cycles_are_said() {
    for seed in 1..=20 {
        let said = |f: &dyn Fn(usize, f64) -> f64| {
            let mut columns = cycles(seed);
            columns[3].data = columns[3].data.iter().enumerate().map(|(i, v)| f(i, *v)).collect();
            suspicions(&[record("c", RunKind::Positioning, columns)])
        };
        assert_eq!(said(&|_, e| e), [], "{seed}");
        for cycle in 0..5 {
            let found = said(&|i, e| if i / 22 == cycle { -e } else { e });
            assert!(found.iter().any(|s| s.what == MistakeKind::Sign), "{seed}, {cycle}: {found:?}");
        }
        // A screw that is worn in its middle gives that too: backlash that changes along the axis.
        assert_eq!(said(&|i, e| if i / 11 % 2 == 1 { -e } else { e }), [], "{seed}");
        let own = cycles(seed)[3].data.clone();
        let found = said(&|i, e| if i / 22 == 3 { own[i - 22] } else { e });
        assert!(found.iter().any(|s| s.what == MistakeKind::Doubled), "{seed}: {found:?}");
    }
}

/// Circles one way, then the other, no direction logged.
/// An axis that follows late errs to the other side on the way back.
#[test]
fn an_axis_that_follows_late_around_a_circle_has_no_turned_sign() {
    let mut d = Dice::new(8);
    let n = 120;
    // Whole turns from the same place.
    let angle =
        |i: usize| if i < 3 * n { i as f64 } else { 6.0 * n as f64 - 1.0 - i as f64 } * TAU / n as f64;
    let angles: Vec<f64> = (0..6 * n).map(angle).collect();
    let speed = |i: usize| if i < 3 * n { 1.0 } else { -1.0 };
    let e = angles.iter().enumerate().map(|(i, a)| 6.0 * a.sin() * speed(i) + 0.2 * d.normal());
    let columns = vec![
        column("x", "position.x", angles.iter().map(|a| 150.0 * a.cos()).collect()),
        column("y", "position.y", angles.iter().map(|a| 150.0 * a.sin()).collect()),
        column("e", "error.x", rounded(e, 0.01)),
    ];
    assert_eq!(suspicions(&[record("c", RunKind::Ballbar, columns)]), []);
}

/// The repeat's column holds the times, and the time's the repeats.
#[test]
fn time_and_repeat_exchanged_are_said() {
    let mut d = Dice::new(5);
    let targets: Vec<f64> = (0..12).map(|k| 25.0 * f64::from(k)).collect();
    let p = to_and_fro(&targets, &mut d);
    let n = p.len();
    let clean = along(RunKind::Positioning, p, &mut d);
    let with = |t: Vec<f64>, cycle: Vec<f64>| {
        let more = vec![column("t", "time", t), column("n", "cycle", cycle)];
        record("a", RunKind::Positioning, [more, clean.columns.clone()].concat())
    };
    let time: Vec<f64> = (0..n).map(|i| 4.18 + 2.3 * i as f64).collect();
    let cycle: Vec<f64> = (0..n).map(|i| (i / 24 + 1) as f64).collect();
    assert_eq!(suspicions(&[with(time.clone(), cycle.clone())]), []);
    let found = suspicions(&[with(cycle, time)]);
    assert!(found.iter().any(|s| (s.what, s.column.as_str()) == (MistakeKind::Swapped, "t")), "{found:?}");
}
