//! Figures of a machine over time.

#![allow(clippy::unwrap_used)] // a test's own helpers

use rtec_builders::{column, record};
use rtec_files::{InputError, Result};
use rtec_measure::figure_history::{FigureTolerances, history};
use rtec_model::record::{Record, RunKind};
use std::path::Path;

fn run(name: &str, date: Option<&str>, scale_ppm: f64) -> (String, Result<Record>) {
    let (mut at, mut up, mut e) = (Vec::new(), Vec::new(), Vec::new());
    for cycle in 0..5 {
        for side in [1.0, -1.0] {
            for i in 0..11 {
                let target = f64::from(if side > 0.0 { i } else { 10 - i }) * 30.0;
                at.push(target);
                up.push(side);
                e.push(scale_ppm * target / 1000.0 + side + 0.01 * f64::from(cycle % 2));
            }
        }
    }
    let columns =
        vec![column("x", "position.x", at), column("d", "direction.x", up), column("e", "error.x", e)];
    let mut record = record(name, RunKind::Positioning, columns);
    record.date = date.map(str::to_owned);
    (name.to_owned(), Ok(record))
}

#[test]
fn a_scale_that_grows_is_a_trend_with_a_day() {
    let mut records: Vec<_> =
        [("2026-01-01", 10.0), ("2026-04-01", 13.1), ("2026-07-01", 15.9), ("2026-09-30", 19.0)]
            .into_iter()
            .map(|(day, ppm)| run(day, Some(day), ppm))
            .collect();
    records.reverse();
    records.push(run("undated", None, 1.0));
    let gone = InputError::whole(Path::new("gone"), "nothing", "a record");
    records.push(("gone".to_owned(), Err(gone)));
    let found =
        history("m", &records, &FigureTolerances::of([("M".to_owned(), 7.0), ("x.B_mean".to_owned(), 1.5)]));
    let of = |name: &str| found.figures.iter().find(|f| f.name == name).unwrap();
    let m = of("x.M");
    // 10 ppm over 300 mm are 3 µm; 9 ppm more after nine months.
    assert!((m.points[0].value - 3.0).abs() < 0.02 && (m.points[3].value - 5.7).abs() < 0.02, "{m:?}");
    let trend = m.trend.unwrap();
    assert!(trend.drifts && (trend.per_year - 3.6).abs() < 0.2, "{trend:?}");
    let day = m.reaches.as_deref();
    assert!(day.is_some_and(|d| d > "2026-12-01" && d < "2027-04-01"), "{day:?}");
    assert!(!m.beyond && of("x.B_mean").beyond && !of("x.B_mean").trend.unwrap().drifts);
    assert_eq!(found.left_out.len(), 2);
    let page = found.report().unwrap().html();
    assert!(page.contains("x.M") && page.contains("undated"), "{page}");
}

#[test]
fn power_on_readings_are_in_no_growth() {
    let run = |bad: bool| {
        let n = 60;
        let mut t1: Vec<f64> = (0..n).map(|i| 20.0 + 4.0 * f64::from(i) / f64::from(n)).collect();
        let e = t1.iter().map(|t| 6.0 * (t - 20.0)).collect();
        if bad {
            (t1[0], t1[31]) = (85.0, 85.0);
        }
        let t = (0..n).map(|i| 60.0 * f64::from(i)).collect();
        let columns =
            vec![column("t", "time", t), column("T1", "temperature", t1), column("e", "error.z", e)];
        let mut record = record("d.run.toml", RunKind::Drift, columns);
        record.date = Some("2026-01-02".to_owned());
        let found = history("m", &[("d".to_owned(), Ok(record))], &FigureTolerances::default());
        found.figures.iter().find(|f| f.name == "z.growth_um_per_K").unwrap().points[0].value
    };
    let [good, bad] = [run(false), run(true)];
    assert!((good - 6.0).abs() < 1e-9 && (bad - 6.0).abs() < 1e-9, "{good} {bad}");
}
