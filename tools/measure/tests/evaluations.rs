//! Drift and imports against machines whose errors are known.

#![allow(clippy::unwrap_used)] // a test's own helpers

use rtec_measure::iso230;
use rtec_model::record::{Column, Kind, Record, Role};
use std::path::Path;

fn column(name: &str, role: &str, data: Vec<f64>) -> Column {
    let role = Role::parse(role).unwrap();
    Column { name: name.into(), unit: role.unit().unwrap().into(), role, data }
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
