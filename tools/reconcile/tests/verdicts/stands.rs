//! The set-up and resolution of a gauge or a plate are not findings.
//! The machine lacks nothing, so no run may report anything.

#![allow(clippy::unwrap_used)] // a test's own helpers

use crate::{answer, record};
use rtec_measure::plausible::MistakeKind;
use rtec_model::record::{Record, Role, RunKind};
use rtec_reconcile::Verdict;
use test_needs::dice::Dice;
use test_needs::repetitions;

/// A laser's run along x, up and down again.
/// Its stand creeps by `creep_um` from the first reading to the last.
fn line(seed: u64, creep_um: f64, timed: bool) -> Record {
    let mut d = Dice::new(seed);
    let n = 120;
    let way = |i: usize| if (i / 20).is_multiple_of(2) { 1.0 } else { -1.0 };
    let at = |i: usize| if way(i) > 0.0 { (i % 20) as f64 } else { 19.0 - (i % 20) as f64 };
    let of = |f: &mut dyn FnMut(usize) -> f64| (0..n).map(f).collect::<Vec<f64>>();
    let share = |i: usize| i as f64 / (n - 1) as f64;
    let mut columns = vec![
        ("p", "position.x", of(&mut |i| 25.0 * at(i))),
        ("d", "direction.x", of(&mut |i| way(i))),
        ("T1", "temperature", of(&mut |i| 20.0 + 1.5 * share(i) + 0.02 * d.normal())),
        ("T2", "temperature", of(&mut |i| 20.3 + 0.7 * share(i) + 0.02 * d.normal())),
        ("e", "error.x", of(&mut |i| creep_um * share(i) + 0.08 * d.normal())),
    ];
    if timed {
        columns.insert(0, ("t", "time", of(&mut |i| 90.0 * i as f64)));
    }
    record("line", RunKind::Positioning, columns)
}

/// Rows take time even if the record does not log it.
#[test]
fn a_stand_creeps_in_runs_without_times_too() {
    for seed in repetitions(0..6) {
        let creep_um = [-2.5, 2.0][seed as usize % 2];
        for timed in [true, false] {
            let said = answer("", &[line(seed, creep_um, timed)], &[]);
            assert_eq!(said.verdict, Verdict::NothingMissing, "{seed} {timed}: {said:?}");
            let terms = &said.set_up[0].terms;
            let crept = terms.iter().find(|t| t.0.starts_with("line_um_per"));
            let (unit, um) = if timed { ("h", creep_um / 2.975) } else { ("run", creep_um) };
            let Some((name, value, half)) = crept else { panic!("{terms:?}") };
            assert_eq!(*name, format!("line_um_per_{unit}.error.x"));
            assert!((value - um).abs() < 1.5 * half, "{value} ± {half}, {um} is true");
        }
    }
}

/// A plate of 5 by 5 holes, turned by an angle.
fn plate(name: &str, seed: u64, turn_urad: f64) -> Record {
    plate_of(name, seed, turn_urad, 0.0)
}

/// The same on a machine whose x is out of square to y.
fn plate_of(name: &str, seed: u64, turn_urad: f64, square_urad: f64) -> Record {
    let mut d = Dice::new(seed);
    let at = |i: usize| [100.0 * (i % 5) as f64, 100.0 * (i / 5 % 5) as f64];
    let of = |f: &mut dyn FnMut(usize) -> f64| (0..50).map(f).collect::<Vec<f64>>();
    let columns = vec![
        ("x", "position.x", of(&mut |i| at(i)[0])),
        ("y", "position.y", of(&mut |i| at(i)[1])),
        ("e_x", "error.x", of(&mut |i| (square_urad - turn_urad) * 1e-3 * at(i)[1] + 0.2 * d.normal())),
        ("e_y", "error.y", of(&mut |i| turn_urad * 1e-3 * at(i)[0] + 0.2 * d.normal())),
    ];
    record(name, RunKind::Plate, columns)
}

/// The next plate lies differently, but the machine is the same.
#[test]
fn a_plate_that_lies_otherwise_is_of_no_other_machine() {
    for seed in repetitions(0..6) {
        let turns = [60.0, -90.0, 15.0];
        let [first, second, later] =
            [0, 1, 2].map(|k| plate(&format!("p{k}"), 3 * seed + k, turns[k as usize]));
        let said = answer("[[effect]]\nname = \"scale.x\"\nppm = 0.01\n", &[first, second], &[later]);
        assert!(said.suspicions.is_empty(), "{seed}: {:?}", said.suspicions);
    }
}

/// Two axes have one squareness, and a plate always lies a little turned.
/// Two squarenesses would say the same of the rows, but not of a machine.
#[test]
fn a_turned_plate_shows_one_squareness() {
    for seed in repetitions(20..26) {
        let [turn, square] = [[14.0, -5.0], [-25.0, -50.0], [5.0, 30.0]][seed as usize % 3];
        let runs = [0, 1].map(|k| plate_of(&format!("p{k}"), 2 * seed + k, turn - 40.0 * k as f64, square));
        for plates in [&runs[..1], &runs] {
            let said = answer("", plates, &[]);
            let mut laws: Vec<&str> =
                said.effects.iter().map(|(f, _)| f.effect.description().name.as_str()).collect();
            laws.sort_unstable();
            assert_eq!(laws, ["rotation", "squareness"], "{seed}: {:?}", said.effects);
        }
    }
}

/// A gauge in steps of 1 µm turns a slope into a saw-tooth.
/// It is reported neither as a wave or a shape nor as another unit.
#[test]
fn the_saw_of_a_gauge_in_steps_is_no_finding() {
    for seed in repetitions(0..6) {
        let mut d = Dice::new(seed);
        let of = |f: &mut dyn FnMut(usize) -> f64| (0..180).map(f).collect::<Vec<f64>>();
        let at = |i: usize| 2.3 * i as f64;
        let columns = vec![
            ("t", "time", of(&mut |i| 2.0 * i as f64)),
            ("p", "position.x", of(&mut at.clone())),
            ("v", "velocity.x", of(&mut |i| 20.0 + 0.1 * (i % 7) as f64)),
            ("e", "error.x", of(&mut |i| (0.031 * at(i) + 0.06 * d.normal() + 0.3).round())),
        ];
        let run = record("saw", RunKind::FeedSweep, columns);
        let said = answer("[[effect]]\nname = \"scale.x\"\nppm = 30.0\n", &[run], &[]);
        assert_eq!(
            said.verdict,
            Verdict::NothingMissing,
            "{seed}: {:?} {:?}",
            said.effects,
            said.unexplained
        );
        assert!(said.suspicions.iter().all(|s| s.what != MistakeKind::Unit), "{:?}", said.suspicions);
    }
}

/// A creep belongs to the stand and is not explained by exchanged sensors.
#[test]
fn sensors_are_not_exchanged_for_a_creep() {
    for seed in repetitions(10..16) {
        let growth =
            "[[effect]]\nname = \"thermal_growth.x\"\num_per_K = 2.0\num_per_K2 = 0.0\nsensor = \"T1\"\n";
        let mut run = line(seed, 2.5, true);
        let warm: Vec<f64> = run.data(&Role::Temperature).unwrap().to_vec();
        for c in run.columns.iter_mut().filter(|c| c.role.is_response()) {
            c.data.iter_mut().zip(&warm).for_each(|(e, t)| *e += 2.0 * (t - 20.0));
        }
        let said = answer(growth, &[run], &[]);
        assert!(said.suspicions.is_empty(), "{seed}: {:?}", said.suspicions);
    }
}
