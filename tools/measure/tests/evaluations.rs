//! Circular tests, drift and imports against machines whose errors are known.

#![allow(clippy::unwrap_used)] // a test's own helpers

use rtec_measure::{import, iso230};
use rtec_model::machine::Machine;
use rtec_model::record::{Axis, Column, Kind, Record, Role};
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

#[test]
fn a_csv_comes_in_with_its_own_names_units_and_commas() {
    let text = "\u{feff}Zeit;T1;\"Luft\";Weg\r\n0;20,0;68,0;0,0000\r\n1;20,5;69,8;-0,0010\r\n";
    let text = text.trim_start_matches('\u{feff}');
    let wanted = |columns: &[&str]| {
        columns.iter().map(|c| import::ImportColumn::parse(c).unwrap()).collect::<Vec<_>>()
    };
    let read = |text: &str, columns: &[&str]| {
        import::csv(Path::new("g.csv"), text, &wanted(columns), Kind::Drift, Path::new("g.run.toml"))
    };
    let all = ["Zeit=time:min", "T1=temperature", "Luft=temperature:degF", "Weg=error.z:mm"];
    let record = read(text, &all).unwrap();
    assert_eq!(record.time_s(), [0.0, 60.0]);
    assert_eq!(record.temperature("T1").unwrap(), [20.0, 20.5]);
    assert!(record.temperature("Luft").unwrap().iter().zip([20.0, 21.0]).all(|(a, b)| (a - b).abs() < 1e-12));
    assert_eq!(record.data(&Role::parse("error.z").unwrap()).unwrap(), [0.0, -1.0]);
    let plain = "t\tx\te\n0\t1\t2\n1\t1\t3\n";
    assert_eq!(read(plain, &["t=time", "x=position.x:in", "e=error.x"]).unwrap().rows(), 2);
    for (text, line, column, found) in [
        ("", 0, 0, "no header"),
        ("t,e\n", 2, 0, "no rows"),
        ("t,f\n0,1\n", 1, 1, "no column e"),
        ("t,e,e\n0,1,1\n", 1, 5, "column 'e' a second time"),
        ("t,e\n0,1\n1\n", 3, 2, "after 1 of 2 fields"),
        ("t,e\n0,1\n1, ,\n", 3, 5, "nothing"),
        ("t,e\n0,1\n1, x\n", 3, 4, "'x' in column e"),
        ("t,e\n0,1\n1,\n", 3, 3, "nothing in column e"),
        ("t,e\n0,inf\n", 2, 3, "'inf'"),
    ] {
        let e = read(text, &["t=time", "e=error.x"]).unwrap_err();
        assert_eq!((e.line, e.column), (line, column), "{text:?}: {e}");
        assert!(e.found.contains(found), "{text:?}: {e}");
    }
    assert!(read("t,e\n1,1\n0,1\n", &["t=time", "e=error.x"]).is_err(), "time runs backwards");
    for (text, expected) in [
        ("t", "NAME=ROLE"),
        ("t=zeit", "a role"),
        ("t=time:day", "s, ns, us, ms, min, h"),
        ("t=cycle:s", "a unit of cycle: 1"),
    ] {
        let (_, wants) = import::ImportColumn::parse(text).unwrap_err();
        assert!(wants.contains(expected), "{text}: {wants}");
    }
}

#[test]
fn linuxcnc_files_of_both_types_mean_the_same_errors() {
    let x = Axis::new("x").unwrap();
    let read = |text: &str, trims: bool| {
        import::linuxcnc_comp(Path::new("x.comp"), text, &x, trims, Path::new("x.run.toml")).unwrap()
    };
    // At 10 mm it reached 10.004 going up and 9.998 coming down.
    let positions = read("# x\n0 0 0\n10 10.004 9.998\n", false);
    let trims = read("0 0 0\n10 -0.004 0.002 ; trim\n", true);
    let errors = |r: &Record| {
        r.responses().next().unwrap().data.iter().map(|v| (v * 1e6).round() / 1e6).collect::<Vec<_>>()
    };
    assert_eq!(errors(&positions), [0.0, 4.0, -2.0, 0.0]);
    assert_eq!(
        errors(&positions).iter().map(|v| v.abs()).collect::<Vec<_>>(),
        errors(&trims).iter().map(|v| v.abs()).collect::<Vec<_>>()
    );
    assert_eq!(errors(&trims)[1..3], [4.0, -2.0]);
    let bad = import::linuxcnc_comp(Path::new("x.comp"), "0 0 0\n1 2\n", &x, false, Path::new("x.run.toml"));
    assert_eq!(bad.unwrap_err().line, 2);
}
