//! Drift and imports against machines whose errors are known.

#![allow(clippy::unwrap_used)] // a test's own helpers

use crate::circles::{Noise, Run, one};
use rtec_builders::column;
use rtec_measure::evaluation::{self, EvaluationRequest};
use rtec_measure::iso230::{self, TestConditions};
use rtec_model::record::{Record, RunKind};
use std::f64::consts::TAU;
use std::path::Path;

/// The scatter of a circle's readings is their noise alone.
/// The machine's form, the number of rows and the steps of the gauge do not matter.
#[test]
fn a_circles_scatter_is_its_noise() {
    if !test_needs::long() {
        return;
    }
    for (rows, wave_um, noise_um, step_um) in
        [(60, 0.0, 0.3, 0.0), (720, 1.0, 0.3, 0.0), (720, 1.0, 0.05, 0.0), (720, 1.0, 0.05, 1.0)]
    {
        let run = Run { rows, ..Run::both(150.0, 25.0) };
        let of = |seed: u64| {
            let mut noise = Noise(seed);
            let record = run.record("b.run.toml", |[_, a, turn]| {
                let (s, c) = a.sin_cos();
                let form = 15.0 * s * c + 4.0 * turn * s.signum() * c + wave_um * (TAU * 15.0 * s).sin() * s;
                let read = form + noise_um * noise.normal();
                if step_um > 0.0 { (read / step_um).round() * step_um } else { read }
            });
            one(&[record]).diagnosis.scatter_um
        };
        let mean = (1..=5).map(of).sum::<f64>() / 5.0;
        let expected = if step_um > 0.0 { step_um / 12.0_f64.sqrt() } else { noise_um };
        assert!((0.85..1.15).contains(&(mean / expected)), "{rows} rows, {noise_um} µm: {mean}");
    }
}

/// Without a radius lengths have no uncertainty, and that is said.
#[test]
fn a_circle_without_radius_says_what_has_no_uncertainty() {
    if !test_needs::long() {
        return;
    }
    let full = Run::both(150.0, 25.0).record("b.run.toml", |[_, a, _]| 2.0 * (2.0 * a).sin());
    let bare = Record::new(&full.path, RunKind::Ballbar, full.columns.clone()).unwrap();
    let conditions = TestConditions::parse(Path::new("c.toml"), "[uncertainty]\ndevice_um = 0.5\n").unwrap();
    let of = |record: Record| {
        let asked = EvaluationRequest { conditions: conditions.clone(), ..EvaluationRequest::default() };
        let found = evaluation::evaluate(&[record], &asked, &mut |_| ()).unwrap();
        let said = found.report.warnings().iter().any(|w| w.contains("no uncertainty of F and D"));
        (found.document["uncertainty"].clone(), said)
    };
    let ((with, said), (without, said_without)) = (of(full), of(bare));
    assert!(with["U_length_um"].is_f64() && !said, "{with}");
    assert!(without["U_length_um"].is_null() && said_without, "{without}");
    let of = |u: &serde_json::Value| u["U_difference_um"].as_f64().unwrap();
    assert!((of(&with) - of(&without)).abs() < 1e-9, "{with} {without}");
}

/// What nobody waited an hour for has no change within an hour.
#[test]
fn a_drift_of_less_than_an_hour_has_no_hourly_change() {
    for (minutes, has) in [(19, false), (50, false), (60, true), (130, true)] {
        let t: Vec<f64> = (0..=minutes).map(|i| 60.0 * f64::from(i)).collect();
        let e = t.iter().map(|t| 0.01 * t).collect();
        let columns = vec![column("t", "time", t), column("e", "error.z", e)];
        let r = Record::new(Path::new("d.run.toml"), RunKind::Drift, columns).unwrap();
        let whole = &iso230::drift(&r).unwrap()[0].whole;
        assert_eq!(whole.max_rate_per_h.is_some(), has, "{minutes} min");
        assert!((whole.rate_per_h - 36.0).abs() < 1e-9, "{minutes} min");
    }
}

#[test]
fn drift_ranges_and_rate() {
    // 12 µm/h for two hours, then still for two.
    let t: Vec<f64> = (0..=240).map(|i| 60.0 * f64::from(i)).collect();
    let e: Vec<f64> = t.iter().map(|t| (t / 300.0).min(24.0)).collect();
    let warm = e.iter().map(|e| 20.0 + e / 4.0).collect();
    let columns = vec![column("t", "time", t), column("T1", "temperature", warm), column("e", "error.z", e)];
    let r = Record::new(Path::new("d.run.toml"), RunKind::Drift, columns).unwrap();
    let d = &iso230::drift(&r).unwrap()[0];
    let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-6, "{a} and {b}");
    let w = &d.whole;
    near(w.d_60, 12.0);
    near(w.d_t, 24.0);
    near(w.d_last_60, 0.0);
    near(w.max_rate_per_h.unwrap(), 12.0);
    near(w.t_min, 240.0);
    near(w.temperatures["T1"].range_k, 6.0);
    near(w.temperatures["T1"].gamma, 1.0);
    assert_eq!(d.phases.len(), 1);
    assert_eq!(d.phases[0].phase, "environment");
}

/// An hour at rest, three of spindle with short stops, two of an axis to and fro, one of cooling: each by itself.
#[test]
fn a_drift_test_is_evaluated_phase_by_phase() {
    let minutes: Vec<f64> = (0..420).map(f64::from).collect();
    let of = |f: &dyn Fn(f64) -> f64| minutes.iter().map(|m| f(*m)).collect::<Vec<f64>>();
    let rpm = |m: f64| if (60.0..240.0).contains(&m) && m % 40.0 > 3.0 { 4000.0 } else { 0.0 };
    let moving = |m: f64| (240.0..360.0).contains(&m);
    let x = |m: f64| if moving(m) && m % 2.0 > 0.5 { 500.0 } else { 100.0 };
    // 1 µm in the first hour, 12 µm/h under the spindle, then at 500 mm 5 µm/h more than at 100 mm, then 6 µm/h back.
    let z = |m: f64| {
        if m < 60.0 { m / 60.0 } else { 1.0 + (m.min(240.0) - 60.0) / 5.0 - (m - 360.0).max(0.0) / 10.0 }
    };
    let e = |m: f64| z(m) + if moving(m) && x(m) > 300.0 { (m - 240.0) / 12.0 } else { 0.0 };
    let columns = vec![
        column("t", "time", of(&|m| 60.0 * m)),
        column("rpm", "spindle_speed", of(&rpm)),
        column("x", "position.x", of(&x)),
        column("T1", "temperature", of(&|m| 20.0 + m / 60.0)),
        column("e", "error.z", of(&e)),
    ];
    let r = Record::new(Path::new("d.run.toml"), RunKind::Drift, columns).unwrap();
    let d = &iso230::drift(&r).unwrap()[0];
    let phases: Vec<(&str, Option<f64>, f64)> =
        d.phases.iter().map(|p| (p.phase, p.at_mm, p.from_min.round())).collect();
    let moves = [("movement", Some(100.0), 240.0), ("movement", Some(500.0), 241.0)];
    assert_eq!(phases[2..4], moves, "{phases:?}");
    assert_eq!(
        (phases[0].0, phases[1].0, phases[4].0, phases.len()),
        ("environment", "spindle", "cooling", 5)
    );
    let near = |a: f64, b: f64, by: f64| assert!((a - b).abs() < by, "{a} and {b}: {phases:?}");
    near(d.phases[0].figures.d_t, 1.0, 0.2);
    near(d.phases[1].figures.d_60, 12.0, 0.5);
    near(d.phases[1].figures.rate_per_h, 12.0, 0.3);
    near(d.phases[1].figures.temperatures["T1"].rate_k_per_h, 1.0, 1e-6);
    near(d.phases[2].figures.d_t, 0.0, 0.3);
    near(d.phases[3].figures.rate_per_h, 5.0, 0.1);
    near(d.phases[4].figures.rate_per_h, -6.0, 0.1);
    assert!(d.phases[1].what.contains("4000 rpm") && d.phases[3].what.contains("movement of x"));
    let charts = iso230::drift_charts(&r);
    assert_eq!(charts[0].marks.len(), 4);
    assert!(charts[0].svg(800, 500).unwrap().contains("at rest after heat"));
}

/// The scatter of a drift's readings is their noise, or its gauge's step.
/// Growth, phases and the places of a moving axis do not matter. The budget holds it twice, as a difference does.
#[test]
fn a_drifts_scatter_is_its_noise() {
    let conditions = TestConditions::parse(Path::new("c.toml"), "[uncertainty]\ndevice_um = 0.5\n").unwrap();
    for (noise_um, step_um, shared_s) in
        [(0.3, 0.0, 0.0), (0.05, 1.0, 0.0), (0.3, 0.1, 0.0), (0.3, 0.0, 120.0)]
    {
        let mut noise = Noise(7);
        let minutes: Vec<f64> = (0..480).map(f64::from).collect();
        let of = |f: &dyn Fn(f64) -> f64| minutes.iter().map(|m| f(*m)).collect::<Vec<f64>>();
        let moving = |m: f64| m >= 240.0 && m % 2.0 > 0.5;
        let read = |m: &f64| {
            let grown = 40.0 * (1.0 - (-m / 15.0).exp()) + if moving(*m) { 25.0 } else { 0.0 };
            let read = grown + noise_um * noise.normal();
            if step_um > 0.0 { (read / step_um).round() * step_um } else { read }
        };
        let e: Vec<f64> = minutes.iter().map(read).collect();
        let clock = |m: f64| if shared_s > 0.0 { (60.0 * m / shared_s).floor() * shared_s } else { 60.0 * m };
        let columns = vec![
            column("t", "time", of(&clock)),
            column("rpm", "spindle_speed", of(&|m| if (120.0..240.0).contains(&m) { 4000.0 } else { 0.0 })),
            column("x", "position.x", of(&|m| if moving(m) { 500.0 } else { 100.0 })),
            column("e", "error.z", e),
        ];
        let record = Record::new(Path::new("d.run.toml"), RunKind::Drift, columns).unwrap();
        let asked = EvaluationRequest { conditions: conditions.clone(), ..EvaluationRequest::default() };
        let found = evaluation::evaluate(&[record], &asked, &mut |_| ()).unwrap().document;
        let scatter = found["scatter"].as_f64().unwrap();
        let expected = f64::max(noise_um, step_um / 12.0_f64.sqrt());
        assert!((0.85..1.15).contains(&(scatter / expected)), "{noise_um} {step_um} {shared_s}: {scatter}");
        let u = found["uncertainty"]["U_difference_um"].as_f64().unwrap();
        assert!((u - 0.5_f64.hypot(2.0 * 2.0_f64.sqrt() * scatter)).abs() < 1e-9, "{found}");
    }
}

/// A plate that is not square with a scale for each axis, squareness and rotation.
/// One fit gives each back; one after another, as owners of plates publish it, does not, and leaves more.
#[test]
fn a_plate_that_is_not_square_is_fitted_at_once() {
    let mut holes: Vec<(f64, f64)> = Vec::new();
    for i in 0..9 {
        for j in 0..4 {
            holes.push((-240.0 + 60.0 * f64::from(i), -60.0 + 40.0 * f64::from(j)));
        }
    }
    let (sx, sy, c, d) = (30.0, -10.0, 13.0, 12.0);
    let of = |f: &dyn Fn(f64, f64) -> f64| holes.iter().map(|(x, y)| f(*x, *y)).collect::<Vec<_>>();
    let columns = vec![
        column("x", "position.x", of(&|x, _| x)),
        column("y", "position.y", of(&|_, y| y)),
        column("ex", "error.x", of(&|x, y| (sx * x + c * y) / 1000.0 + 4.0)),
        column("ey", "error.y", of(&|x, y| (sy * y + d * x) / 1000.0 - 7.0)),
    ];
    let record = Record::new(Path::new("p.run.toml"), RunKind::Plate, columns).unwrap();
    let p =
        rtec_measure::drilled_plate::evaluate(&record, rtec_measure::drilled_plate::PlateFitLoss::Squares)
            .unwrap();
    let near = |got: f64, want: f64| assert!((got - want).abs() < 1e-6, "{got} and {want}");
    near(p.joint.terms.scale_x_ppm, sx);
    near(p.joint.terms.scale_y_ppm, sy);
    near(p.joint.terms.squareness_urad, c + d);
    // As the effects have it: squareness.x.y = c + d beside rotation.x.y = d make error x = c·y and error y = d·x.
    near(p.joint.terms.rotation_urad, d);
    near(p.joint.terms.quadrupole_ppm, 20.0_f64.hypot(12.5));
    near(p.joint.terms.quadrupole_deg, (25.0_f64.atan2(40.0) / 2.0).to_degrees());
    near(p.joint.rms_um, 0.0);
    // Each fit has an offset of its own; here the holes are about (0, 0) in x only.
    near(p.joint.terms.offset_mm[0], 0.004);
    near(p.joint.terms.offset_mm[1], -0.007);
    assert!(p.rms_quadrupole_um > 1.0 && (p.scale_ppm - 10.0).abs() > 5.0, "{p:?}");
}

#[test]
fn holes_on_one_line_are_no_plate() {
    let along: Vec<f64> = (0..12).map(|i| 40.0 * f64::from(i)).collect();
    for slope in [0.0, 0.7] {
        let across = along.iter().map(|x| slope * x + 3.0).collect();
        let columns = vec![
            column("x", "position.x", along.clone()),
            column("y", "position.y", across),
            column("ex", "error.x", along.iter().map(|x| 0.03 * x).collect()),
            column("ey", "error.y", along.iter().map(|x| 0.02 * x).collect()),
        ];
        let record = Record::new(Path::new("p.run.toml"), RunKind::Plate, columns).unwrap();
        let said = rtec_measure::drilled_plate::evaluate(
            &record,
            rtec_measure::drilled_plate::PlateFitLoss::Squares,
        )
        .unwrap_err();
        assert!(said.to_string().contains("holes on one line"), "{said}");
    }
}

/// Five gauges on a mandrel show the tilt of the spindle too.
/// It drifts as displacements do, in its own unit.
#[test]
fn the_tilt_of_a_spindle_drifts_as_displacements_do() {
    let rows = 121;
    let grown = |i: usize| 1.0 - (-(i as f64) / 40.0).exp();
    let of = |size: f64| (0..rows).map(|i| size * grown(i)).collect::<Vec<f64>>();
    let columns = vec![
        column("t", "time", (0..rows).map(|i| 60.0 * i as f64).collect()),
        column("x", "error.x", of(12.0)),
        column("b", "angle_error.s.b", of(80.0)),
    ];
    let record = Record::new(Path::new("d.run.toml"), RunKind::Drift, columns).unwrap();
    let all = iso230::drift(&record).unwrap();
    let names: Vec<_> = all.iter().map(|d| (d.response.as_str(), d.unit.as_str())).collect();
    assert_eq!(names, [("error.x", "um"), ("angle_error.s.b", "urad")]);
    for (d, size) in all.iter().zip([12.0, 80.0]) {
        assert!((d.whole.d_t - size * grown(rows - 1)).abs() < 1e-9, "{d:?}");
    }
    let charts = iso230::drift_charts(&record);
    let titles: Vec<_> = charts.iter().map(|c| c.y.as_str()).collect();
    assert_eq!(titles, ["displacement (µm)", "tilt (urad)"]);
}

/// A bow of k·u² (u from −1 to 1 over the travel) is 1·k from its least-squares line, whatever slope and zero stand beside
/// it; up and down apart by the reversal.
#[test]
fn straightness_is_what_is_off_the_line() {
    let (bow_um, slope_urad, reversal_um) = (8.0, -35.0, 1.5);
    let mut columns: [Vec<f64>; 4] = Default::default();
    for _cycle in 0..3 {
        for (dir, k) in (0..21).map(|k| (1.0, k)).chain((0..21).rev().map(|k| (-1.0, k))) {
            let p = 100.0 + 20.0 * f64::from(k);
            let u = (p - 300.0) / 200.0;
            let e = 12.0 + slope_urad * p / 1000.0 + bow_um * u * u + dir * reversal_um / 2.0;
            for (c, v) in columns.iter_mut().zip([p, dir, e, e / 2.0]) {
                c.push(v);
            }
        }
    }
    let [p, dir, y, z] = columns;
    let columns = vec![
        column("x", "position.x", p.clone()),
        column("dir", "direction.x", dir),
        column("y", "error.y", y),
        column("z", "error.z", z),
    ];
    let record = Record::new(Path::new("s.run.toml"), RunKind::Positioning, columns).unwrap();
    let found = iso230::straightness(&record).unwrap();
    assert_eq!(found.iter().map(|s| s.symbol.as_str()).collect::<Vec<_>>(), ["EYX", "EZX"]);
    let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-6, "{a} and {b}");
    let s = &found[0];
    near(s.straightness_um, bow_um);
    near(s.straightness_up_um.unwrap(), bow_um);
    near(s.straightness_down_um.unwrap(), bow_um);
    near(s.slope_urad, slope_urad);
    near(s.reversal_um.unwrap(), reversal_um);
    near(s.repeatability_um.unwrap(), 0.0);
    near(found[1].straightness_um, bow_um / 2.0);
    assert!(!iso230::has_positioning(&record) && iso230::has_straightness(&record));

    // Four places are a line and no straightness; an axis that stands has none.
    let columns =
        vec![column("x", "position.x", vec![0.0, 1.0, 2.0, 3.0]), column("y", "error.y", vec![0.0; 4])];
    let few = Record::new(Path::new("f.run.toml"), RunKind::Positioning, columns).unwrap();
    assert!(iso230::straightness(&few).unwrap_err().to_string().contains("4 places"));
    let columns = vec![column("x", "position.x", vec![1.0; 4]), column("y", "error.y", vec![0.0; 4])];
    let still = Record::new(Path::new("f.run.toml"), RunKind::Positioning, columns).unwrap();
    assert!(iso230::straightness(&still).is_err());
}
