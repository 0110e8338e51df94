//! Circular tests, drift and imports against machines whose errors are known.

#![allow(clippy::unwrap_used)] // a test's own helpers

use rtec_measure::iso230;
use rtec_model::machine::Machine;
use rtec_model::record::{Column, Kind, Record, Role};
use std::path::Path;

fn column(name: &str, role: &str, data: Vec<f64>) -> Column {
    let role = Role::parse(role).unwrap();
    Column { name: name.into(), unit: role.unit().unwrap().into(), role, data }
}

/// A circle of radius r, once counter-clockwise and once clockwise, with the errors of a machine model.
fn ballbar(model: &str, r: f64) -> Record {
    let n = 720;
    let turn = std::f64::consts::TAU / f64::from(n);
    let angle: Vec<f64> = (0..n).map(|i| (f64::from(i) + 0.5) * turn).collect();
    let angle: Vec<f64> = angle.iter().copied().chain(angle.iter().rev().copied()).collect();
    let way = |i: usize| if i < n as usize { 1.0 } else { -1.0 };
    let by = |of: &dyn Fn(f64, f64) -> f64| {
        angle.iter().enumerate().map(|(i, a)| of(*a, way(i))).collect::<Vec<f64>>()
    };
    let mut columns = vec![
        column("x", "position.x", by(&|a, _| r * a.cos())),
        column("y", "position.y", by(&|a, _| r * a.sin())),
        column("dx", "direction.x", by(&|a, w| -w * a.sin().signum())),
        column("dy", "direction.y", by(&|a, w| w * a.cos().signum())),
        column("ex", "error.x", vec![0.0; angle.len()]),
        column("ey", "error.y", vec![0.0; angle.len()]),
    ];
    let ideal = Record::new(Path::new("b.run.toml"), Kind::Ballbar, columns.clone()).unwrap();
    let machine = Machine::parse(Path::new("m.toml"), model).unwrap();
    for (c, (_, data)) in columns[4..].iter_mut().zip(machine.predict(&ideal).unwrap().columns) {
        c.data = data;
    }
    Record::new(Path::new("b.run.toml"), Kind::Ballbar, columns).unwrap()
}

#[test]
fn a_circle_gives_back_reversal_squareness_and_scale() {
    let model = "name = \"m\"\n[[effect]]\nname = \"reversal.x\"\num = 6.0\n[[effect]]\nname = \"reversal.y\"\num = -4.0\n\
                 [[effect]]\nname = \"squareness.x.y\"\nurad = 30.0\n[[effect]]\nname = \"scale.x\"\nppm = 20.0\n\
                 [[effect]]\nname = \"scale.y\"\nppm = -10.0\n[[effect]]\nname = \"offset.x\"\num = 3.0\n";
    let c = iso230::circular(&ballbar(model, 150.0)).unwrap();
    assert_eq!(c.plane, "x-y");
    let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-6, "{a} and {b} in {c:?}");
    near(c.reversal["x"], 6.0);
    near(c.reversal["y"], -4.0);
    near(c.squareness_urad, 30.0);
    near(c.scale_mismatch_ppm.unwrap(), 30.0);
    near(c.centre_um[0], 3.0);
    near(c.radius_um, 5.0 * 150.0 / 1000.0);
    near(c.rms, 0.0);
}

#[test]
fn circularity_of_squareness_alone_by_hand() {
    let c = iso230::circular(&ballbar(
        "name = \"m\"\n[[effect]]\nname = \"squareness.x.y\"\nurad = 40.0\n",
        100.0,
    ))
    .unwrap();
    // An ellipse: the radial error is 40·100/2000·sin 2θ = ±2 µm, the same both ways.
    for g in [c.g_ccw.unwrap(), c.g_cw.unwrap(), c.g_b] {
        assert!((g - 4.0).abs() < 1e-3, "{c:?}");
    }
    assert!(c.h.unwrap() < 0.1 && (c.f_max - 2.0).abs() < 1e-3 && (c.f_min + 2.0).abs() < 1e-3, "{c:?}");
    // Backlash shows as hysteresis: both ways differ by it where the axis' error is radial.
    let b = iso230::circular(&ballbar("name = \"m\"\n[[effect]]\nname = \"reversal.x\"\num = 5.0\n", 100.0))
        .unwrap();
    assert!((b.h.unwrap() - 5.0).abs() < 0.01, "{b:?}");
}

#[test]
fn half_a_quadrant_is_no_circle() {
    let whole = ballbar("name = \"m\"\n", 100.0);
    let part = whole.select(&(0..60).collect::<Vec<_>>());
    assert!(iso230::circular(&part).is_err());
}

#[test]
fn drift_ranges_and_rate() {
    // 12 µm/h for two hours, then still for two.
    let t: Vec<f64> = (0..=240).map(|i| 60.0 * f64::from(i)).collect();
    let e: Vec<f64> = t.iter().map(|t| (t / 300.0).min(24.0)).collect();
    let warm = e.iter().map(|e| 20.0 + e / 4.0).collect();
    let columns = vec![column("t", "time", t), column("T1", "temperature", warm), column("e", "error.z", e)];
    let r = Record::new(Path::new("d.run.toml"), Kind::Drift, columns).unwrap();
    let d = &iso230::drift(&r).unwrap()[0];
    let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-6, "{a} and {b}");
    near(d.d_60, 12.0);
    near(d.d_t, 24.0);
    near(d.d_last_60, 0.0);
    near(d.max_rate_per_h, 12.0);
    near(d.t_min, 240.0);
    near(d.temperatures["T1"].range_k, 6.0);
    near(d.temperatures["T1"].gamma, 1.0);
}
