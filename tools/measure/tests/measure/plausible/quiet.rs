//! What a good machine does, and no mistake is reported.

use super::{along, column, record, rounded, to_and_fro};
use rtec_measure::plausible::{MistakeKind, Suspicion, suspicions, unusable};
use rtec_model::record::{Record, RunKind};
use std::f64::consts::TAU;
use test_needs::dice::Dice;

/// What a fit leaves out, and how a suspicion names its rows.
/// A month of minutes is no record in milliseconds; a clock that was set is said as one.
#[test]
fn a_long_record_and_a_clock_that_steps() {
    let mut d = Dice::new(31);
    let mut at = |seconds: &[f64]| {
        let e = seconds.iter().map(|_| d.normal()).collect();
        let columns = vec![column("t", "time", seconds.to_vec()), column("e", "error.z", e)];
        suspicions(&[record("long", RunKind::Drift, columns)])
    };
    let minutes: Vec<f64> = (0..43_200).map(|m| 60.0 * f64::from(m)).collect();
    assert_eq!(at(&minutes), []);
    let step: Vec<f64> =
        (0..500).map(|i| 10.0 * f64::from(i) + if i < 200 { 0.0 } else { 30.0 * 86_400.0 }).collect();
    let said = at(&step);
    assert!(said.len() == 1 && said[0].what == MistakeKind::Jump, "{said:?}");
    assert!(said[0].text.contains("30.0 days") && said[0].rows == "201", "{said:?}");
    let milliseconds: Vec<f64> = (0..2000).map(|i| 1000.0 * f64::from(i)).collect();
    assert!(at(&milliseconds).iter().any(|s| s.what == MistakeKind::Unit), "seconds in milliseconds");
}

/// Rows sorted by position, − before + at each; a gauge read by hand every hour.
/// Nothing is wrong with either.
#[test]
fn a_sorted_run_and_hourly_readings_are_not_doubted() {
    let mut d = Dice::new(3);
    let (mut x, mut way, mut e) = (Vec::new(), Vec::new(), Vec::new());
    for i in 0..33 {
        for w in [-1.0, 1.0] {
            x.push(20.0 * f64::from(i / 3));
            way.push(w);
            e.push(0.4 * f64::from(i / 3) + 1.5 * w + 0.2 * d.normal());
        }
    }
    let columns = |x: Vec<f64>, way: Vec<f64>, e: Vec<f64>| {
        vec![column("x", "position.x", x), column("d", "direction.x", way), column("e", "error.x", e)]
    };
    assert_eq!(
        suspicions(&[record("s", RunKind::Positioning, columns(x.clone(), way.clone(), e.clone()))]),
        []
    );
    let back = |v: &[f64]| v.iter().rev().copied().collect::<Vec<_>>();
    assert_eq!(suspicions(&[record("s", RunKind::Positioning, columns(back(&x), back(&way), back(&e)))]), []);
    let drift = |step: f64| {
        let t: Vec<f64> = (0..24).map(|i| step * f64::from(i)).collect();
        let warm = |k: f64| move |i: i32| 20.0 + k * (1.0 - (-f64::from(i) / 5.0).exp());
        let columns = vec![
            column("t", "time", t),
            column("T1", "temperature", (0..24).map(warm(6.0)).collect()),
            column(
                "e",
                "error.z",
                (0..24).map(|i| 3.0 * (warm(6.0)(i) - 20.0) + 0.2 * f64::from(i % 3)).collect(),
            ),
        ];
        suspicions(&[record("h", RunKind::Drift, columns)])
    };
    for step in [900.0, 3600.0, 7200.0] {
        assert_eq!(drift(step), [], "{step}");
    }
    assert!(drift(10_000.0).iter().any(|s| s.text.contains("milliseconds")), "a row each ten seconds, in ms");
}

/// An axis that turns with a spike has none until it has turned.
/// The first pass of a record begins without it.
#[test]
fn the_first_pass_of_an_axis_with_a_spike_is_not_doubted() {
    let run = |d: &mut Dice, spike: f64, wild: Option<usize>| {
        let targets: Vec<f64> = (0..11).map(|i| 20.0 * f64::from(i)).collect();
        let (mut p, mut dir, mut e, mut n) = (vec![], vec![], vec![], vec![]);
        let mut turned_at = None;
        for pass in 0..10 {
            let way = if pass % 2 == 0 { 1.0 } else { -1.0 };
            for k in 0..11 {
                let at = if way > 0.0 { targets[k] } else { targets[10 - k] };
                if k == 0 && pass > 0 {
                    turned_at = p.last().copied();
                }
                let travelled: f64 = turned_at.map_or(f64::INFINITY, |t: f64| (at - t).abs());
                p.push(at);
                dir.push(way);
                n.push(f64::from(pass / 2 + 1));
                e.push(0.01 * at + spike * way * (-travelled / 25.0).exp() + 0.3 * d.normal());
            }
        }
        if let Some(row) = wild {
            e[row] += 40.0;
        }
        let columns = vec![
            column("p", "position.x", p),
            column("dir", "direction.x", dir),
            column("n", "cycle", n),
            column("e", "error.x", e),
        ];
        suspicions(&[record("spike", RunKind::Positioning, columns)])
    };
    for seed in 0..20 {
        let said = run(&mut Dice::new(seed), 11.0, None);
        assert!(said.is_empty(), "{seed}: {said:?}");
        // A wild row in the middle of the first pass is as wild as anywhere.
        let said = run(&mut Dice::new(seed), 0.0, Some(5));
        assert!(said.iter().any(|s| s.what == MistakeKind::Outliers && s.rows == "6"), "{seed}: {said:?}");
    }
}

/// A drift test of a sensor that shows its heat at once, and of one that follows late. `step`: kelvin that the first one
/// shows from a row on; `rpm` that the spindle turns at from there.
fn switched(d: &mut Dice, rows: usize, tau_rows: f64, steps: &[(usize, f64)], rpm: f64) -> Record {
    let on = |i: usize| steps.iter().filter(|s| s.0 <= i).map(|s| s.1).sum::<f64>();
    let noisy = |d: &mut Dice, v: f64| ((v + 0.015 * d.normal()) / 0.0625).round() * 0.0625;
    let mut late = 0.0;
    let (mut front, mut rear, mut room) = (vec![], vec![], vec![]);
    for i in 0..rows {
        if tau_rows > 0.0 {
            late += (0.6 * on(i) - late) / tau_rows;
        }
        front.push(noisy(d, 20.0 + on(i)));
        rear.push(noisy(d, 20.5 + late));
        room.push(noisy(d, 20.0 + 0.4 * (i as f64 / rows as f64)));
    }
    let columns = vec![
        column("t", "time", (0..rows).map(|i| 60.0 * i as f64).collect()),
        column("T1", "temperature", front),
        column("T2", "temperature", rear),
        column("T3", "temperature", room),
        column("rpm", "spindle_speed", (0..rows).map(|i| if on(i) > 0.0 { rpm } else { 0.0 }).collect()),
        column("e", "error.x", (0..rows).map(|_| 0.3 * d.normal()).collect()),
    ];
    record("switched", RunKind::Drift, columns)
}

/// A sensor that jumps by itself is doubted.
/// One whose jump a slow body follows, that jumps each time it is switched, or with the spindle, is not.
#[test]
fn heat_that_is_switched_is_no_jump() {
    for seed in 0..20 {
        let d = &mut Dice::new(seed);
        let jumps =
            |r: Record| suspicions(&[r]).iter().any(|s| s.what == MistakeKind::Jump && s.column == "T1");
        assert!(jumps(switched(d, 160, 0.0, &[(80, 5.0)], 0.0)), "{seed}: by itself");
        assert!(!jumps(switched(d, 160, 60.0, &[(80, 5.0)], 0.0)), "{seed}: a slow body follows");
        assert!(!jumps(switched(d, 160, 0.0, &[(60, 5.0), (90, -5.0), (120, 5.0)], 0.0)), "{seed}: switched");
        assert!(!jumps(switched(d, 160, 0.0, &[(80, 5.0)], 6000.0)), "{seed}: with the spindle");
    }
}

/// On a slope a reading goes up by its resolution every few rows, and stands still where it turns: that is no noise that
/// stops.
#[test]
fn a_coarse_sensor_stands_still_where_the_room_turns() {
    for seed in 0..20 {
        let d = &mut Dice::new(seed);
        let phase = d.unit();
        let swing = |i: i32| 21.0 + 0.8 * (TAU * (f64::from(i) / 150.0 + phase)).sin();
        let values: Vec<f64> = (0..150).map(swing).collect();
        let read = |d: &mut Dice, sd: f64| -> Vec<f64> {
            values.iter().map(|v| ((v + sd * d.normal()) / 0.0625).round() * 0.0625).collect()
        };
        let columns = vec![
            column("t", "time", (0..150).map(|i| 60.0 * f64::from(i)).collect()),
            column("T1", "temperature", read(d, 0.004)),
            column("e", "error.x", (0..150).map(|_| 0.3 * d.normal()).collect()),
        ];
        let said = suspicions(&[record("room", RunKind::Drift, columns)]);
        assert!(said.is_empty(), "{seed}: {said:?}");
    }
}

/// A gauge finer than the scale, circles to and fro, a plate gone over from below, approaches from alternate sides: errors that look
/// like those of a mistake along one axis alone, and are none.
#[test]
fn what_a_good_machine_does_is_no_mistake() {
    for seed in 1..=20 {
        let mut d = Dice::new(seed);
        // Far less than a count of the scale, which the gauge does not read in.
        let t: Vec<f64> = (0..200).map(|i| 60.0 * f64::from(i)).collect();
        let e = rounded(t.iter().map(|_| 0.08 * d.normal()), [0.01, 0.002][seed as usize % 2]);
        let mut quiet =
            record("q", RunKind::Drift, vec![column("t", "time", t.clone()), column("e", "error.x", e)]);
        quiet.count_um = Some(2.0);
        assert_eq!(suspicions(&[quiet]), [], "{seed}");

        // A turn either way, of a frame that is not square: at each x the one way is above where the other is below.
        let turn = |way: f64, begins: f64| -> Vec<f64> {
            (0..311).map(|i| begins + way * TAU * f64::from(i) / 311.0).collect()
        };
        let mut circle = |name: &str, angles: &[f64]| {
            let places = |f: fn(f64) -> f64| -> Vec<f64> { angles.iter().map(|a| 150.0 * f(*a)).collect() };
            let (x, y) = (places(f64::cos), places(f64::sin));
            let way = |v: &[f64]| -> Vec<f64> {
                (0..v.len()).map(|i| (v[i.max(1)] - v[i.max(1) - 1]).signum()).collect()
            };
            let (ways_x, ways_y) = (way(&x), way(&y));
            let e_x = rounded(y.iter().map(|y| -0.06 * y + 0.3 * d.normal()), 0.01);
            let e_y = rounded(x.iter().map(|x| 0.05 * x + 0.3 * d.normal()), 0.01);
            let columns = vec![
                column("x", "position.x", x),
                column("y", "position.y", y),
                column("d_x", "direction.x", ways_x),
                column("d_y", "direction.y", ways_y),
                column("e_x", "error.x", e_x),
                column("e_y", "error.y", e_y),
            ];
            record(name, RunKind::Ballbar, columns)
        };
        let begins = 0.31 * seed as f64;
        let both = circle("c", &[turn(1.0, begins), turn(-1.0, begins)].concat());
        assert_eq!(suspicions(&[both]), [], "{seed}");
        let records = [circle("a", &turn(1.0, begins)), circle("b", &turn(-1.0, begins))];
        assert_eq!(suspicions(&records), [], "{seed}");

        let (mut x, mut y) = (Vec::new(), Vec::new());
        for row in 0..12 {
            for k in 0..3 * 15 {
                x.push(20.0 * f64::from(k % 15));
                y.push(20.0 * f64::from(row) - 110.0);
            }
        }
        let e = rounded(y.iter().map(|y| 0.04 * y + 0.3 * d.normal()), 0.01);
        let plate = vec![
            column("x", "position.x", x.clone()),
            column("y", "position.y", y.clone()),
            column("e", "error.x", e),
        ];
        assert_eq!(suspicions(&[record("p", RunKind::Plate, plate)]), [], "{seed}");

        // Targets drawn from a few, each from the other side than the one before.
        let ways: Vec<f64> = (0..60).map(|i| if i % 2 == 0 { 1.0 } else { -1.0 }).collect();
        let z: Vec<f64> = ways.iter().map(|_| [0.0, 20.0, 50.0][d.below(3)]).collect();
        let e = rounded(ways.iter().map(|w| 0.6 * w + 0.15 * d.normal()), 0.01);
        let columns =
            vec![column("z", "position.z", z), column("d", "direction.z", ways), column("e", "error.z", e)];
        assert_eq!(suspicions(&[record("r", RunKind::Probing, columns)]), [], "{seed}");
    }
}

/// A slip of the decimal point and a lost digit are said with the row, which is left out; targets that are a tenth of others, a run
/// back to a datum at a tenth of where it goes on, and targets in any order are none.
#[test]
fn a_position_that_slipped_is_said_and_targets_that_are_there_are_not() {
    let even: Vec<f64> = (0..11).map(|k| 50.0 * f64::from(k)).collect();
    let odd = [0.0, 17.3, 61.0, 95.5, 160.2, 188.8, 240.0, 301.7, 355.1, 399.9, 470.0];
    let tenths = [1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0];
    for seed in 1..=20 {
        let mut d = Dice::new(seed);
        for targets in [&even[..], &odd, &tenths] {
            let p = to_and_fro(targets, &mut d);
            let clean = along(RunKind::Positioning, p.clone(), &mut d);
            assert_eq!(suspicions(&[clean]), [], "{seed}");
        }
        for (targets, row, by) in
            [(&even[..], 8, 0.1), (&even, 30, 10.0), (&odd, 5, 0.1), (&odd, 10, 0.1), (&odd, 27, 100.0)]
        {
            let mut p = to_and_fro(targets, &mut d);
            p[row] *= by;
            let r = along(RunKind::Positioning, p, &mut d);
            let found = suspicions(std::slice::from_ref(&r));
            assert_eq!(found.len(), 1, "{seed}: {row} by {by}: {found:?}");
            assert_eq!(
                (found[0].what, found[0].column.as_str(), found[0].row_list()),
                (MistakeKind::Outliers, "x", vec![row])
            );
            assert_eq!(unusable(&found).rows(&r), [row]);
        }
        let mut p = to_and_fro(&even, &mut d);
        p[7] = 50.0 + (p[7] - 350.0);
        let lost = suspicions(&[along(RunKind::Positioning, p.clone(), &mut d)]);
        assert_eq!(lost.iter().map(Suspicion::row_list).collect::<Vec<_>>(), [vec![7]], "{lost:?}");
        // Back to a datum at 10 mm before each of the targets, where 100 mm is one of them.
        let datum: Vec<f64> = even.iter().flat_map(|p| [10.0, *p]).collect();
        assert_eq!(suspicions(&[along(RunKind::Probing, datum, &mut d)]), [], "{seed}");
        let drawn: Vec<f64> = (0..60).map(|_| tenths[d.below(tenths.len())]).collect();
        assert_eq!(suspicions(&[along(RunKind::Probing, drawn, &mut d)]), [], "{seed}");
    }
}

/// What moves by less than a gauge's step leaves it where it is.
/// A gauge that stands alone, or on no step of the other record's, is not read.
#[test]
fn a_gauge_that_another_record_shows_as_coarse_may_stand_still() {
    let drift = |e: Vec<f64>| {
        let t = (0..e.len()).map(|i| 10.0 * i as f64).collect();
        record("d", RunKind::Drift, vec![column("t", "time", t), column("e", "error.z", e)])
    };
    let grown: Vec<f64> = (0..60).map(|i| 10.0 * (f64::from(i) / 20.0).floor()).collect();
    assert_eq!(suspicions(&[drift(grown.clone()), drift(vec![20.0; 60])]), []);
    let stuck = |found: Vec<Suspicion>| found.iter().filter(|s| s.what == MistakeKind::Stuck).count();
    assert_eq!(stuck(suspicions(&[drift(vec![20.0; 60])])), 1);
    assert_eq!(stuck(suspicions(&[drift(grown), drift(vec![23.0; 60])])), 1);
}

/// A sensor whose logger writes tenths in one record and hundredths in another.
/// What it does not write in the first record is no sign that the sensor stands still.
#[test]
fn a_sensor_may_stand_still_in_the_digits_that_were_written() {
    for seed in 0..40 {
        let mut d = Dice::new(seed);
        let mut run = |degc: f64, step: f64, rows: usize| {
            let t: Vec<f64> = (0..rows).map(|i| 4.0 * i as f64).collect();
            let warm = rounded(t.iter().map(|t| degc + 1e-4 * t + 0.02 * d.normal()), step);
            let e = t.iter().map(|_| d.normal()).collect();
            let columns =
                vec![column("t", "time", t), column("T1", "temperature", warm), column("e", "error.z", e)];
            record("run", RunKind::Drift, columns)
        };
        let both = [run(20.47, 0.1, 66), run(27.9, 0.01, 88)];
        assert_eq!(suspicions(&both), [], "{seed}");
    }
}
