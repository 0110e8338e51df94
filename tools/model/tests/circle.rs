//! A ballbar's radial error: the projection of the two axes' errors.
//! The formulas are written out here.

#![allow(clippy::unwrap_used)] // a test's own helpers

use rtec_builders::column;
use rtec_model::ballbar_circle::Circle;
use rtec_model::effect::{Dictionary, Effect};
use rtec_model::machine::Machine;
use rtec_model::record::{Axis, Column, Record, Role, RunKind};
use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::fmt::Write as _;
use std::path::Path;

const ROWS: usize = 1440;
const RADIUS_MM: f64 = 150.0;
const FEED_MM_S: f64 = 25.0;

fn circle(radius_mm: f64) -> Circle {
    Circle { radius_mm, plane: [Axis::new("x").unwrap(), Axis::new("y").unwrap()], centre_mm: None }
}

/// Two turns counter-clockwise, a pause, two turns back.
/// No row is exactly at a quadrant.
fn angles() -> Vec<(f64, f64, f64)> {
    let step = 2.0 * TAU / ROWS as f64 * 2.0;
    let half = ROWS / 2;
    let dt = step * RADIUS_MM / FEED_MM_S;
    let there = (0..half).map(|i| (i as f64 * dt, (i as f64 + 0.37) * step, 1.0));
    let back = (0..half).map(|i| {
        let t = (half + i) as f64 * dt + 4.0;
        (t, ((half - 1 - i) as f64 + 0.37) * step, -1.0)
    });
    there.chain(back).collect()
}

fn record(more: Vec<Column>) -> Record {
    let rows = angles();
    let mut columns = vec![
        column("t", "time", rows.iter().map(|r| r.0).collect()),
        // A controller shows the angle from 0 to 2π.
        column("a", "angle", rows.iter().map(|r| r.1.rem_euclid(TAU)).collect()),
        column("e", "error.r", vec![0.0; rows.len()]),
    ];
    columns.extend(more);
    Record::new(Path::new("b.run.toml"), RunKind::Ballbar, columns)
        .unwrap()
        .with_circle(circle(RADIUS_MM))
        .unwrap()
}

fn machine(effects: &str) -> Machine {
    let mut text = String::from("name = \"m\"\n");
    for line in effects.lines().map(str::trim).filter(|l| !l.is_empty()) {
        let (name, values) = line.split_once(' ').unwrap();
        let _ = write!(text, "[[effect]]\nname = \"{name}\"\n{}\n", values.replace("; ", "\n"));
    }
    Machine::parse(Path::new("m.toml"), &text).unwrap()
}

fn predicted(record: &Record, effects: &str) -> Vec<f64> {
    let prediction = machine(effects).predict(record).unwrap();
    assert_eq!(prediction.taken_as_zero, []);
    prediction.columns[0].1.clone()
}

/// Compares every row with a formula of the angle and the sense of turning.
#[track_caller]
fn check(effects: &str, formula: impl Fn(f64, f64) -> f64) {
    let got = predicted(&record(vec![]), effects);
    for ((_, a, turn), got) in angles().into_iter().zip(&got) {
        let want = formula(a, turn);
        assert!((got - want).abs() < 1e-9, "{effects} at {a}: {got} and {want}");
    }
}

#[test]
fn scale_mismatch_is_two_lobed() {
    let r = RADIUS_MM / 1000.0;
    check("scale.x ppm = 20.0", |a, _| 20.0 * r * a.cos().powi(2));
    check("scale.x ppm = 20.0\nscale.y ppm = -10.0", |a, _| {
        r * (20.0 * a.cos().powi(2) - 10.0 * a.sin().powi(2))
    });
    // The mean scale, plus half the mismatch times the radius at twice the angle.
    check("scale.x ppm = 20.0\nscale.y ppm = -10.0", |a, _| r * (5.0 + 15.0 * (2.0 * a).cos()));
}

/// R·α/2 at twice the angle, whichever of the two axes is inclined.
#[test]
fn squareness_is_half_the_radius_times_the_angle() {
    let amplitude_um = 25.0 * 0.150 / 2.0;
    assert!((amplitude_um - 1.875_f64).abs() < 1e-12);
    check("squareness.x.y urad = 25.0", |a, _| amplitude_um * (2.0 * a).sin());
    check("squareness.y.x urad = 25.0", |a, _| amplitude_um * (2.0 * a).sin());
    let largest = predicted(&record(vec![]), "squareness.x.y urad = 25.0").into_iter().fold(0.0, f64::max);
    assert!((largest - amplitude_um).abs() < 1e-3);
}

#[test]
fn a_turned_bar_reads_nothing_of_a_rotation() {
    check("rotation.x.y urad = 80.0", |_, _| 0.0);
}

#[test]
fn the_centre_is_an_eccentric_circle() {
    check("offset.x um = 3.0\noffset.y um = -4.0", |a, _| 3.0 * a.cos() - 4.0 * a.sin());
    check("offset.r um = 2.0", |_, _| 2.0);
}

/// Counter-clockwise, x falls in the upper half and y rises in the right half.
#[test]
fn reversal_steps_at_the_quadrants() {
    let x_way = |a: f64, turn: f64| -turn * a.sin().signum();
    let y_way = |a: f64, turn: f64| turn * a.cos().signum();
    check("reversal.x um = 6.0\nreversal.y um = -4.0", |a, turn| {
        3.0 * x_way(a, turn) * a.cos() - 2.0 * y_way(a, turn) * a.sin()
    });
}

/// Counter-clockwise, x moves at −v·sin θ and lags in proportion to that speed.
#[test]
fn a_servo_mismatch_turns_the_circle_by_45_degrees() {
    let v = FEED_MM_S;
    check("following_error.x ms = -0.4", |a, turn| 0.4 * v * turn * a.sin() * a.cos());
    check("following_error.x ms = -0.4\nfollowing_error.y ms = -0.1", |a, turn| {
        (0.4 - 0.1) / 2.0 * v * turn * (2.0 * a).sin()
    });
    check("following_error.x ms = -0.4\nfollowing_error.y ms = -0.4", |_, _| 0.0);
}

#[test]
fn waves_maps_and_straightness_go_by_the_place_on_the_circle() {
    check("screw_periodic.y period_mm = 10.0; um = 1.5; phase_rad = 0.4", |a, _| {
        1.5 * (TAU * RADIUS_MM * a.sin() / 10.0 + 0.4).sin() * a.sin()
    });
    check("subdivision.x period_um = 200.0; um = 0.5; phase_rad = 0.0", |a, _| {
        0.5 * (TAU * RADIUS_MM * a.cos() / 0.2).sin() * a.cos()
    });
    let hat = |p: f64| (1.0 - p.abs() / 150.0).max(0.0);
    check("position_map.x knots_mm = [-150.0, 0.0, 150.0]; um = [0.0, 5.0, 0.0]", |a, _| {
        5.0 * hat(RADIUS_MM * a.cos()) * a.cos()
    });
    check("straightness.x.y knots_mm = [-150.0, 0.0, 150.0]; um = [0.0, 5.0, 0.0]", |a, _| {
        5.0 * hat(RADIUS_MM * a.sin()) * a.cos()
    });
}

#[test]
fn a_spike_dies_out_with_the_travel_of_its_own_axis() {
    let got = predicted(&record(vec![]), "reversal_spike.y um = 6.0; length_mm = 3.0");
    let rows = angles();
    // Part of the first turn: y turned at θ = π/2, and again at 3π/2.
    let at = |row: usize| rows[row].1;
    for row in (0..ROWS / 2).filter(|r| at(*r) > 0.6 * PI && at(*r) < 2.4 * PI) {
        let last_old = |turned: f64| (0..row).rev().find(|r| at(*r) < turned).unwrap();
        let (way, turned) =
            if at(row) < 3.0 * FRAC_PI_2 { (-1.0, FRAC_PI_2) } else { (1.0, 3.0 * FRAC_PI_2) };
        // The travel of y from the last row of the old direction, over the top, row by row.
        let from = last_old(turned);
        let travel: f64 = (from..row).map(|r| RADIUS_MM * (at(r + 1).sin() - at(r).sin()).abs()).sum();
        let want = 6.0 * way * (-travel / 3.0).exp() * at(row).sin();
        assert!((got[row] - want).abs() < 1e-9, "row {row}: {} and {want}", got[row]);
    }
}

#[test]
fn what_is_logged_stands_before_what_follows_from_the_angle() {
    let rows = angles();
    // A circle about (400, -200), where a scale also acts as an offset.
    let about = vec![
        column("x", "position.x", rows.iter().map(|r| 400.0 + RADIUS_MM * r.1.cos()).collect()),
        column("y", "position.y", rows.iter().map(|r| -200.0 + RADIUS_MM * r.1.sin()).collect()),
    ];
    let got = predicted(&record(about), "scale.x ppm = 20.0");
    for (r, got) in rows.iter().zip(&got) {
        let want = 0.02 * (400.0 + RADIUS_MM * r.1.cos()) * r.1.cos();
        assert!((got - want).abs() < 1e-9);
    }
    // A logged direction is used even if it is wrong. A logged velocity gives the direction by its sign.
    let up = vec![column("dx", "direction.x", vec![1.0; ROWS])];
    let by_velocity = vec![column("vx", "velocity.x", vec![2.5; ROWS])];
    for more in [up, by_velocity] {
        let got = predicted(&record(more), "reversal.x um = 6.0");
        assert!(rows.iter().zip(&got).all(|(r, got)| (got - 3.0 * r.1.cos()).abs() < 1e-12));
    }
}

#[test]
fn at_the_quadrant_an_axis_has_no_direction() {
    let a: Vec<f64> = (0..8).map(|i| f64::from(i) * PI / 4.0).collect();
    let columns = vec![column("a", "angle", a), column("e", "error.r", vec![0.0; 8])];
    let r = Record::new(Path::new("b.run.toml"), RunKind::Ballbar, columns).unwrap();
    let r = r.with_circle(circle(100.0)).unwrap();
    let way = |n: &str| r.data(&Role::parse(&format!("direction.{n}")).unwrap()).unwrap().to_vec();
    assert_eq!(way("x"), [0.0, -1.0, -1.0, -1.0, 0.0, 1.0, 1.0, 1.0]);
    assert_eq!(way("y"), [1.0, 1.0, 0.0, -1.0, -1.0, -1.0, 0.0, 1.0]);
    // Without a time the rows give the direction, but no velocity.
    let speed = Role::parse("velocity.x").unwrap();
    assert!(r.column(&speed).is_none());
    assert_eq!(machine("following_error.x ms = 1.0").predict(&r).unwrap().taken_as_zero.len(), 1);
}

#[test]
fn selected_rows_keep_their_directions() {
    let r = record(vec![]);
    let odd: Vec<usize> = (0..ROWS).filter(|i| (i * i) % 7 == 2).collect();
    let effects = "reversal.x um = 6.0\nfollowing_error.y ms = 1.0\nscale.x ppm = 9.0";
    let whole = predicted(&r, effects);
    let some = predicted(&r.select(&odd), effects);
    assert!(odd.iter().zip(&some).all(|(i, v)| (whole[*i] - v).abs() < 1e-12));
}

#[test]
fn basis_and_slopes_are_those_of_the_sum() {
    let r = record(vec![]);
    let d = Dictionary::default();
    for (name, values) in [
        ("screw_periodic.x", &[10.0, 1.5, 0.4][..]),
        ("screw_slope.x", &[10.0, 6.0, 0.4]),
        ("reversal_slope.y", &[9.0]),
        ("reversal_spike.y", &[6.0, 3.0]),
        ("rotation.x.y", &[30.0]),
        ("angular.x.y.x", &[30.0]),
    ] {
        let with = |values: &[f64]| {
            let mut e: Effect = d.effect(name).unwrap();
            e.set_values(values).unwrap();
            e
        };
        let e = with(values);
        let (role, component) = e.acts_on(&r)[0].clone();
        assert_eq!(role.to_string(), "error.r");
        let bound = e.bind(&r).unwrap();
        let mut slopes = vec![0.0; ROWS * values.len()];
        bound.slopes(&e, component, &mut slopes);
        for i in 0..values.len() {
            let shifted = |by: f64| {
                let mut v = values.to_vec();
                v[i] += by;
                let mut out = vec![0.0; ROWS];
                with(&v).add(&r, &role, &mut out).unwrap();
                out
            };
            let (up, down) = (shifted(1e-6), shifted(-1e-6));
            for row in 0..ROWS {
                let want = (up[row] - down[row]) / 2e-6;
                assert!(
                    (slopes[i * ROWS + row] - want).abs() < 1e-6 * (1.0 + want.abs()),
                    "{name} {i} {row}"
                );
            }
        }
    }
}

#[test]
fn candidates_are_the_axes_effects() {
    let d = Dictionary::default();
    let names = |records: &[&Record]| d.candidates(records).iter().map(Effect::identity).collect::<Vec<_>>();
    let ballbar = record(vec![]);
    let of_circle = names(&[&ballbar]);
    for axis in ["x", "y"] {
        for law in [
            "offset",
            "scale",
            "position_map",
            "screw_periodic",
            "subdivision",
            "reversal",
            "reversal_slope",
            "reversal_spike",
            "following_error",
        ] {
            let name = format!("{law}.{axis}");
            assert!(
                of_circle.iter().any(|n| n.split(' ').next() == Some(&name)),
                "{name} not in {of_circle:?}"
            );
        }
    }
    for name in ["squareness.x.y", "squareness.y.x", "straightness.x.y", "straightness.y.x"] {
        assert!(of_circle.iter().any(|n| n.split(' ').next() == Some(name)), "{name} not in {of_circle:?}");
    }
    // A bar has no probe and measures no part. A rotation of its circle is invisible.
    let none = ["probe_lobing", "form_bump", "rotation"];
    assert!(!of_circle.iter().any(|n| none.iter().any(|law| n.starts_with(law))));
    assert!(!of_circle.iter().any(|n| n.starts_with("angular.r") || n.starts_with("squareness.r")));
    // Together with a run along x: the candidates that both records show.
    let line = Record::new(
        Path::new("x.run.toml"),
        RunKind::Positioning,
        vec![
            column("x", "position.x", vec![0.0, 1.0]),
            column("d", "direction.x", vec![1.0, -1.0]),
            column("e", "error.x", vec![0.0, 1.0]),
        ],
    )
    .unwrap();
    let both = names(&[&ballbar, &line]);
    assert!(both.iter().any(|n| n == "scale.x") && both.iter().any(|n| n == "reversal.x"), "{both:?}");
    assert!(!both.iter().any(|n| n.starts_with("scale.y")), "{both:?}");
}

#[test]
fn a_probe_s_and_a_part_s_own_effects_stay_as_they_are() {
    check("probe_lobing um = 2.0; lobes = 3; phase_rad = 0.3", |a, _| 2.0 * (3.0 * a + 0.3).cos());
    let bump = predicted(&record(vec![]), "form_bump um = 5.0; centre_rad = 1.0; width_rad = 0.5");
    let largest = bump.iter().fold(0.0_f64, |a, b| a.max(*b));
    assert!((largest - 5.0).abs() < 0.01);
}

/// The bar measures the chain's squareness and scale.
#[test]
fn a_chain_is_projected_too() {
    let folder = tempfile::tempdir().unwrap();
    let chain = folder.path().join("chain.toml");
    std::fs::write(
        &chain,
        "[[joint]]\nname = \"x\"\nbranch = \"tool\"\naxis = \"x\"\ndirection = [1, 0, 0]\n\
         component = [{ of = \"dx\", terms = [{ p = 1, value = 2.0 }] }]\n",
    )
    .unwrap();
    let chain = rtec_model::kinematic_chain::KinematicChain::read(&chain).unwrap();
    let mut out = vec![0.0; ROWS];
    chain.add(&record(vec![]), &Role::parse("error.r").unwrap(), &mut out).unwrap();
    // 2 µm per 100 mm.
    for (r, got) in angles().iter().zip(&out) {
        let want = 0.02 * RADIUS_MM * r.1.cos().powi(2);
        assert!((got - want).abs() < 1e-6, "{got} and {want}");
    }
}

/// A fraction of a millimetre is the set-up's, and no contradiction.
#[test]
fn a_centre_that_the_positions_contradict_is_refused() {
    let axis = |n: &str| Axis::new(n).unwrap();
    let angle: Vec<f64> = (0..72).map(|i| TAU * f64::from(i) / 72.0).collect();
    let columns = vec![
        Column::new("a", Role::Angle, angle.clone()),
        Column::new("x", Role::Position(axis("x")), angle.iter().map(|a| 250.0 + 100.0 * a.cos()).collect()),
        Column::new("e", Role::Error(axis("r")), vec![0.0; angle.len()]),
    ];
    let record = Record::new(Path::new("c.run.toml"), RunKind::Ballbar, columns).unwrap();
    let about = |x: f64| record.clone().with_circle(Circle { centre_mm: Some([x, 0.0]), ..circle(100.0) });
    assert!(about(250.0).is_ok() && about(250.4).is_ok());
    let (found, expected) = about(25.0).unwrap_err();
    assert!(found.contains("centre_mm with 25 mm on x") && found.contains("about 250.000 mm"), "{found}");
    assert!(expected.contains("no centre_mm"));
}

/// Positions that follow from a circle do not contradict another centre.
#[test]
fn a_circle_without_a_centre_may_be_given_one() {
    let nowhere = record(vec![]);
    let placed = Circle { centre_mm: Some([80.0, -40.0]), ..circle(RADIUS_MM) };
    let there = nowhere.clone().with_circle(placed).unwrap();
    let x = Role::parse("position.x").unwrap();
    let apart = there.data(&x).unwrap().iter().zip(nowhere.data(&x).unwrap()).map(|(a, b)| a - b);
    assert!(apart.into_iter().all(|mm| (mm - 80.0).abs() < 1e-9));
}
