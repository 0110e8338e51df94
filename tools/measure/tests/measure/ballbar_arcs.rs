//! Arcs, circles run one way and single rows: what they show, and what they do not.

#![allow(clippy::unwrap_used)] // a test's own helpers

use crate::circles::{Noise, Run, column, near, one};
use rtec_model::ballbar_circle::Circle;
use rtec_model::record::{Axis, Record, Role, RunKind};
use std::f64::consts::TAU;
use std::path::Path;

/// Radial errors of a machine whose values are stated in the test, with noise of 0.15 µm.
fn known(name: &str, circles: &[(f64, f64)], arc: f64, seed: u64) -> Record {
    let mut noise = Noise(seed);
    let run = Run { circles: circles.to_vec(), from: 0.0, ..Run::both(150.0, 8.0) };
    let full = run.record(name, |[_, a, turn]| {
        let (s, c) = a.sin_cos();
        let x = 3.0 + 40.0 * 0.15 * c + 2.0 * (-s * turn).signum() + 60.0 * 0.15 * s;
        let y = -2.0 + 10.0 * 0.15 * s - 1.5 * (c * turn).signum();
        x * c + y * s + 0.15 * noise.normal()
    });
    // So much of it from the angle 0 on, both ways.
    let [t, a, e] = ["time", "angle", "error.r"].map(|role| of_role(&full, role));
    let once = |i: &usize| (*i % run.rows) as f64 * 1.02 < run.rows as f64 - 1.0;
    let kept: Vec<usize> = (0..a.len()).filter(once).filter(|i| a[*i] <= arc).collect();
    let of = |v: &[f64]| kept.iter().map(|i| v[*i]).collect::<Vec<f64>>();
    let columns =
        vec![column("t", "time", of(t)), column("a", "angle", of(a)), column("e", "error.r", of(e))];
    let record = Record::new(Path::new(name), RunKind::Ballbar, columns).unwrap();
    let plane = ["x", "y"].map(|n| Axis::new(n).unwrap());
    record.with_circle(Circle { radius_mm: 150.0, plane, centre_mm: None }).unwrap()
}

fn of_role<'r>(record: &'r Record, role: &str) -> &'r [f64] {
    record.data(&Role::parse(role).unwrap()).unwrap()
}

fn with_errors(record: &Record, errors: Vec<f64>) -> Record {
    let mut other = record.clone();
    other.columns.iter_mut().find(|c| c.role == Role::parse("error.r").unwrap()).unwrap().data = errors;
    other
}

const TRUTH: [(&str, f64); 4] =
    [("scale_mismatch_ppm", 30.0), ("squareness_urad", 60.0), ("reversal.x", 4.0), ("reversal.y", -3.0)];

/// Both ways in one record, as a logger that never stops has it.
/// Starts, the recorded pause, its noise and the clock's step take nothing of the second circle.
#[test]
fn a_recorded_pause_takes_nothing_of_a_circle() {
    if !test_needs::long() {
        return;
    }
    let (feed_rad_s, radius_mm) = (0.28, 150.0);
    for (period_s, clock_s, start_s, pause_s, angle_sd) in [
        (0.0371, 0.01, 0.2, 2.0, 0.0),
        (0.0371, 0.01, 0.5, 2.0, 1e-5),
        (0.01, 0.0, 0.2, 5.0, 1e-6),
        (0.05, 0.0, 1.0, 0.4, 0.0),
        (0.005, 0.01, 0.3, 1.0, 0.0),
    ] {
        let mut noise = Noise(3);
        // One turn with an even start and stop, and then at rest.
        let whole_s = TAU / feed_rad_s + start_s;
        let turned = |t: f64| {
            let ramp = |t: f64| 0.5 * feed_rad_s / start_s * t * t;
            if t < start_s {
                ramp(t)
            } else {
                TAU - if t < whole_s - start_s { feed_rad_s * (whole_s - start_s - t) } else { 0.0 }
                    - ramp((whole_s - t).clamp(0.0, start_s))
            }
        };
        let second_s = whole_s + pause_s;
        let rows = ((second_s + whole_s) / period_s) as usize;
        let at = |i: usize| i as f64 * period_s;
        let angle = |i: usize| turned(at(i)) - turned((at(i) - second_s).max(0.0));
        let read: Vec<f64> =
            (0..rows).map(|i| (angle(i) + angle_sd * noise.normal()).rem_euclid(TAU)).collect();
        let clock = |t: f64| if clock_s > 0.0 { (t / clock_s).round() * clock_s } else { t };
        let columns = vec![
            column("t", "time", (0..rows).map(|i| clock(at(i))).collect()),
            column("a", "angle", read.clone()),
            column(
                "e",
                "error.r",
                read.iter().map(|a| 3.0 * (2.0 * a).sin() + 0.1 * noise.normal()).collect(),
            ),
        ];
        let record = Record::new(Path::new("b.run.toml"), RunKind::Ballbar, columns).unwrap();
        let plane = ["x", "y"].map(|n| Axis::new(n).unwrap());
        let circle = Circle { radius_mm, plane, centre_mm: None };
        let found = one(&[record.with_circle(circle).unwrap()]);
        let turned: Vec<f64> = found.contours.iter().map(|c| c.turned_deg).collect();
        assert!(
            turned.len() == 2 && turned.iter().all(|t| (t - 360.0).abs() < 2.0),
            "{period_s}: {turned:?}"
        );
        let feeds: Vec<f64> = found.contours.iter().filter_map(|c| c.feed_mm_per_min).collect();
        let stated = 60.0 * feed_rad_s * radius_mm;
        assert!(feeds.iter().all(|f| (f / stated - 1.0).abs() < 0.02), "{period_s}: {feeds:?}");
        assert_eq!(found.warnings, [""; 0], "{period_s}");
    }
}

/// A circle beside the machine's zero is the same circle.
/// What straight laws make at its centre is a shift.
#[test]
fn a_circle_away_from_zero_has_the_same_contributions() {
    if !test_needs::long() {
        return;
    }
    let mut noise = Noise(11);
    let plain = Run::both(150.0, 25.0).record("b.run.toml", |[_, a, turn]| {
        let (s, c) = a.sin_cos();
        let x = 3.0 - 20.0 * 0.15 * c - 2.5 * (-s * turn).signum() / 2.0 + 22.0 * 0.15 * s;
        let y = 8.0 + 7.0 * (c * turn).signum() / 2.0;
        x * c + y * s + 0.1 * noise.normal()
    });
    let mut away = plain.clone();
    let angle = of_role(&plain, "angle").to_vec();
    away.columns.push(column("x", "position.x", angle.iter().map(|a| 250.0 + 150.0 * a.cos()).collect()));
    away.columns.push(column("y", "position.y", angle.iter().map(|a| 120.0 + 150.0 * a.sin()).collect()));
    let (plain, away) = (one(&[plain]).diagnosis, one(&[away]).diagnosis);
    assert_eq!(plain.contributions.len(), away.contributions.len(), "{plain:?} {away:?}");
    for (p, a) in plain.contributions.iter().zip(&away.contributions) {
        assert_eq!(p.cause, a.cause);
        near(a.um, p.um, 0.02 * p.um.max(1.0));
    }
    for (p, a) in plain.centre_um.iter().zip(away.centre_um) {
        near(a, p.unwrap(), 0.05);
    }
}

/// What was not measured, behind an obstacle, is not called turned.
#[test]
fn a_gap_is_no_part_of_a_circle() {
    let full = Run::both(150.0, 25.0).record("b.run.toml", |[_, a, _]| 3.0 * (2.0 * a).sin());
    let angle = of_role(&full, "angle");
    let kept: Vec<usize> = (0..angle.len()).filter(|i| (angle[*i] + 0.2).rem_euclid(TAU) < 3.54).collect();
    let of = |role: &str| kept.iter().map(|i| of_role(&full, role)[*i]).collect::<Vec<f64>>();
    let columns = vec![
        column("t", "time", of("time")),
        column("a", "angle", of("angle")),
        column("e", "error.r", of("error.r")),
    ];
    let record = Record::new(Path::new("b.run.toml"), RunKind::Ballbar, columns).unwrap();
    let circle =
        Circle { radius_mm: 150.0, plane: ["x", "y"].map(|n| Axis::new(n).unwrap()), centre_mm: None };
    let found = one(&[record.with_circle(circle).unwrap()]);
    for c in &found.contours {
        // 203° of the circle, of which the start's 7° were run over twice.
        near(c.turned_deg, 207.0, 4.0);
    }
    assert!(found.warnings.iter().any(|w| w.contains("less than a full circle")), "{:?}", found.warnings);
}

/// Arcs as they are usual in planes with z.
/// What is told holds the truth, what cannot be told is not.
#[test]
fn an_arc_tells_what_it_shows_and_nothing_else() {
    if !test_needs::long() {
        return;
    }
    for seed in test_needs::repetitions(1..=6) {
        for degrees in [180.0_f64, 220.0, 270.0] {
            let arc = degrees.to_radians();
            let ways = [(1.0, 8.0), (-1.0, 8.0)]
                .map(|way| known("b.run.toml", &[way], arc, seed + way.0 as u64 * 99));
            let found = one(&ways);
            let d = &found.diagnosis;
            for (name, truth) in TRUTH {
                // Half a circle each with a centre of its own: the reversal of x is as good as the centre.
                let hidden = name == "reversal.x" && degrees < 181.0;
                let interval = d.interval_95.get(name);
                assert_eq!(interval.is_none(), hidden, "{degrees}: {name} {d:?}");
                if let Some([lo, hi]) = interval {
                    let slack = hi - lo;
                    assert!(
                        lo - slack < truth && truth < hi + slack,
                        "{degrees}, {seed}: {name} {lo} … {hi}"
                    );
                    assert!(hi - lo < 0.5 * truth.abs(), "{degrees}, {seed}: {name} {lo} … {hi}");
                }
            }
            assert!((0.1..0.2).contains(&d.rms), "{degrees}: {}", d.rms);
            assert!(d.unexplained_um.is_none_or(|um| um < 0.2), "{degrees}: {d:?}");
            let said = found.warnings.iter().any(|w| w.contains("do not tell") && w.contains("reversal x"));
            assert_eq!(said, degrees < 181.0, "{:?}", found.warnings);
            assert_eq!(d.centre_um[0].is_none(), degrees < 181.0);
        }
    }
}

/// What the causes leave is never more than the data, whatever the data; and no value is told where there is none.
#[test]
fn one_way_nothing_is_told_beyond_the_data() {
    if !test_needs::long() {
        return;
    }
    let jump = |record: &Record, um: f64| {
        let mut errors = of_role(record, "error.r").to_vec();
        let half = errors.len() / 2;
        errors[half..].iter_mut().for_each(|e| *e += um);
        with_errors(record, errors)
    };
    for (arc, um) in [(3.2, 0.0), (4.7, 0.0), (7.0, 30.0), (7.0, 0.0)] {
        let record = jump(&known("b.run.toml", &[(1.0, 8.0)], arc, 5), um);
        let errors = of_role(&record, "error.r");
        let raw = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
        let found = one(std::slice::from_ref(&record));
        let d = &found.diagnosis;
        assert!(d.rms <= raw, "{arc}: {} of {raw}", d.rms);
        near(d.radius_um, found.contours[0].radius_um, 1e-9);
        for (name, [lo, hi]) in &d.interval_95 {
            assert!(hi - lo < 1e4, "{arc}: {name} {lo} … {hi}");
        }
    }
}

/// A bar that is read absolutely is off by its length, and by nothing else.
#[test]
fn a_bar_read_absolutely_has_the_same_causes() {
    if !test_needs::long() {
        return;
    }
    let record = known("b.run.toml", &[(1.0, 8.0), (-1.0, 8.0)], 7.0, 3);
    let errors = of_role(&record, "error.r");
    let far = with_errors(&record, errors.iter().map(|e| e + 150_000.0).collect());
    let (near_by, off) = (one(&[record]).diagnosis, one(&[far]).diagnosis);
    near(off.radius_um, near_by.radius_um.unwrap() + 150_000.0, 1e-3);
    near(off.squareness_urad, near_by.squareness_urad.unwrap(), 1e-3);
    near(off.reversal["x"], near_by.reversal["x"], 1e-3);
    near(off.rms, near_by.rms, 1e-4);
}

/// One row that is off at a reversal is no spike.
#[test]
fn a_single_row_is_no_spike() {
    if !test_needs::long() {
        return;
    }
    let record = known("b.run.toml", &[(1.0, 8.0), (-1.0, 8.0)], 7.0, 8);
    let mut errors = of_role(&record, "error.r").to_vec();
    let angles = of_role(&record, "angle");
    for i in 1..angles.len() {
        // The first row beyond each reversal of x.
        if angles[i - 1].sin().signum() != angles[i].sin().signum() && angles[i].cos() > 0.0 {
            errors[i] -= 2.0;
        }
    }
    let d = one(&[with_errors(&record, errors)]).diagnosis;
    assert!(d.spike.values().all(|s| s.um.abs() < 20.0), "{d:?}");
    near(d.reversal["x"], 4.0, 0.3);
    near(d.servo_mismatch_ms, 0.0, 0.1);
}

/// Play that is taken up over its own width after each turn, rows at whole degrees and halves from 0: those on an axis stand on
/// either side of its turn. Reversals are the play, and nothing is made of those rows, no spike and no servo mismatch.
#[test]
fn rows_where_an_axis_turns_are_no_cause() {
    if !test_needs::long() {
        return;
    }
    let (radius_mm, noise_um) = (150.0, 0.15);
    for (n, first, play, seed) in [
        (360, 0.0, [10.0, 5.0], 1),
        (720, 0.0, [10.0, 5.0], 2),
        (720, 0.0, [10.0, -6.0], 3),
        (1440, 0.0, [4.0, 3.0], 4),
        (720, 0.7, [10.0, 5.0], 5),
        (360, 0.002, [10.0, 5.0], 6),
        (720, 0.0, [60.0, 35.0], 7),
    ] {
        for at_turn in [-1.0, 0.0, 1.0] {
            let mut noise = Noise(seed);
            let mut columns: [Vec<f64>; 4] = Default::default();
            for (lap, turn) in [(1.0, 1.0), (2.0, -1.0)] {
                for k in 0..=n {
                    let a = first + turn * TAU * f64::from(k) / f64::from(n);
                    let error = |at: f64, slope: f64, play: f64| {
                        let to_turn_um = 1000.0 * radius_mm * (1.0 - at.abs());
                        let way = slope * turn;
                        // Past the turn it moves back towards zero: the play is then being taken up.
                        let moved = if to_turn_um < 1e-6 {
                            0.5 * (1.0 + at_turn)
                        } else if way * at < 0.0 {
                            (to_turn_um / play.abs()).min(1.0)
                        } else {
                            1.0
                        };
                        let now = if to_turn_um < 1e-6 { -at.signum() } else { way.signum() };
                        play * now * (moved - 0.5)
                    };
                    let (s, c) = a.sin_cos();
                    let radial =
                        error(c, -s, play[0]) * c + error(s, c, play[1]) * s + noise_um * noise.normal();
                    let t = columns[0].len() as f64 * TAU * radius_mm / f64::from(n) / 16.67;
                    for (column, v) in columns.iter_mut().zip([t, lap, a, radial]) {
                        column.push(v);
                    }
                }
            }
            let roles = [("t", "time"), ("n", "cycle"), ("a", "angle"), ("e", "error.r")];
            let columns =
                roles.into_iter().zip(columns).map(|((name, role), data)| column(name, role, data)).collect();
            let plane = ["x", "y"].map(|a| Axis::new(a).unwrap());
            let record = Record::new(Path::new("p.run.toml"), RunKind::Ballbar, columns).unwrap();
            let record = record.with_circle(Circle { radius_mm, plane, centre_mm: None }).unwrap();
            let d = one(&[record]).diagnosis;
            let said = format!("{n} rows from {first}, play {play:?}, at the turn {at_turn}: {d:?}");
            for (axis, play) in ["x", "y"].iter().zip(play) {
                near(d.reversal[*axis], play, 0.25);
                let [lo, hi] = d.interval_95[&format!("reversal.{axis}")];
                assert!(lo - 0.05 <= play && play <= hi + 0.05, "{said}");
            }
            assert!(d.spike.values().all(|s| s.um.abs() < 0.5), "{said}");
            assert!(d.servo_mismatch_ms.is_none_or(|ms| ms.abs() < 0.02), "{said}");
        }
    }
}
