//! Speed of reading a record, and of fitting 78 h of sixteen sensors.
//! Prints the times and asserts nothing: `cargo bench -p rtec-fit`.

use rtec_fit::thermal::{self, ThermalFitOptions};
use rtec_model::record::{Axis, Column, Record, Role, RunKind};
use std::hint::black_box;
use std::path::Path;
use std::time::Instant;

fn axis(name: &str) -> Axis {
    Axis::new(name).expect("a letter is an axis name")
}

/// Median time of several runs, ns.
fn median_ns(runs: usize, mut run: impl FnMut()) -> f64 {
    let mut times: Vec<f64> = (0..runs)
        .map(|_| {
            let start = Instant::now();
            run();
            start.elapsed().as_nanos() as f64
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

fn log(rows: usize, sensors: usize) -> Record {
    let mut columns = vec![Column {
        name: "t".into(),
        role: Role::Time,
        unit: "s".into(),
        data: (0..rows).map(|i| 60.0 * i as f64).collect(),
    }];
    let warm = |i: usize, tau: f64| {
        15.0 * (1.0 - (-(i as f64) / tau).exp()) * (1.0 + 0.2 * (i as f64 / 400.0).sin())
    };
    for s in 0..sensors {
        let wobble = |i: usize| 0.02 * ((i * (s + 3)) as f64).sin();
        let data =
            (0..rows).map(|i| 20.0 + warm(i, 60.0 + 40.0 * s as f64) * (1.0 - s as f64 / 17.0) + wobble(i));
        columns.push(Column {
            name: format!("T{s}"),
            role: Role::Temperature,
            unit: "degC".into(),
            data: data.collect(),
        });
    }
    columns.push(Column {
        name: "e".into(),
        role: Role::Error(axis("z")),
        unit: "um".into(),
        data: (0..rows).map(|i| 1.3 * warm(i, 320.0) + 0.1 * (i as f64 * 1.7).sin()).collect(),
    });
    Record::new(Path::new("log.run.toml"), RunKind::Drift, columns).expect("a sound record")
}

fn main() {
    let dir = tempfile::tempdir().expect("a temporary directory");
    for (rows, sensors) in [(5000, 23), (4681, 16)] {
        let mut record = log(rows, sensors);
        record.path = dir.path().join("log.run.toml");
        rtec_measure::run_record_files::write(&mut record).expect("a writable directory");
        let ns = median_ns(20, || {
            black_box(rtec_measure::run_record_files::read(&record.path).expect("what was written"));
        });
        println!("record: {rows} rows x {} columns read in {:.2} ms", sensors + 2, ns / 1e6);
    }
    let record = log(4681, 16);
    let ns = median_ns(5, || {
        black_box(
            thermal::fit(&[&record], &[], &ThermalFitOptions::default())
                .expect("a record that can be fitted"),
        );
    });
    println!("fit: 78 h x 16 sensors with selection and nested cross-validation in {:.3} s", ns / 1e9);
}
