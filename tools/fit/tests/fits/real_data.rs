//! Evaluations of real measurements against their owners' own figures.
//! The data is in `../shared/data`, outside the project. Without it the tests are skipped with a message.

#![allow(clippy::unwrap_used)] // a test's own helpers

use rtec_fit::thermal::{self, ThermalFitOptions};
use rtec_measure::drilled_plate;
use rtec_measure::import;
use rtec_measure::iso230;
use rtec_model::record::{Axis, Column, Record, Role, RunKind};
use std::path::{Path, PathBuf};

/// A file of `../shared/data`, relative to the workspace's root.
fn shared(name: &str) -> Option<(PathBuf, String)> {
    let path = test_needs::shared(&format!("data/{name}"))?;
    let text = std::fs::read_to_string(&path).unwrap();
    Some((path, text))
}

/// A `KEY = VALUE [mm]` line of the owners' report, in µm.
fn report_um(report: &str, key: &str) -> f64 {
    let found = report.lines().map(|l| l.trim_matches(['*', ' '])).find_map(|l| {
        let (k, v) = l.split_once(" = ")?;
        let v: f64 = v.trim_end_matches("[mm]").trim().parse().ok()?;
        (k == key).then_some(1000.0 * v)
    });
    found.unwrap_or_else(|| panic!("{key} in the report"))
}

/// The owners' report calls the file's backward data forward.
/// All its other figures are equal to ours if they are right.
#[test]
fn real_axis_equals_the_report_where_it_is_right() {
    let (Some((path, text)), Some((_, report))) =
        (shared("axis_iso230/y_axis.dat"), shared("axis_iso230/y_axis_report.md"))
    else {
        return;
    };
    let y = Axis::new("y").unwrap();
    let record = import::ecmc_dat(&path, &text, &y, Path::new("y.run.toml")).unwrap();
    assert_eq!(record.rows(), 90);
    let p = &iso230::positioning(&record).unwrap()[0];
    let near = |name: &str, got: Option<f64>, key: &str| {
        let (got, want) = (got.unwrap(), report_um(&report, key));
        println!("{name}: {got:.2} µm, report {want:.2} µm");
        // The report prints 10 nm; its R is four times an s that was rounded in the same way.
        assert!((got - want).abs() <= 0.0051, "{name}: {got} and {want}");
    };
    near("A", p.A, "A");
    near("A_up", p.A_up, "A_bwd");
    near("A_down", p.A_down, "A_fwd");
    near("E_up", p.E_up, "E_bwd");
    near("E_down", p.E_down, "E_fwd");
    near("R_up", p.R_up, "R_bwd");
    near("R_down", p.R_down, "R_fwd");
    near("B", p.B, "B");
    near("B_mean (report's sign, its forward being backward)", p.B_mean.map(|b| -b), "B_avg");
    near("M", p.M, "M");
    // By hand from the report's own tables: E over all means is 60.76 − (−39.30) µm; R at the sixth target is
    // 2·8.14 + 2·9.52 + 11.56 µm.
    assert!((p.E.unwrap() - 100.06).abs() < 0.02, "{:?}", p.E);
    assert!((p.R.unwrap() - 46.87).abs() < 0.02, "{:?}", p.R);
    let svg = p.chart().svg(800, 500).unwrap();
    assert!(svg.contains("Positioning of axis y"));
}

#[test]
fn real_plate_equals_the_owners_fit() {
    let (Some((path, text)), Some((_, fit))) =
        (shared("plate_cmm/D8131_1"), shared("plate_cmm/fit_8131_1_2014-10-14.txt"))
    else {
        return;
    };
    let record = import::cmm_plate(&path, &text, Path::new("plate.run.toml")).unwrap();
    let squares = drilled_plate::evaluate(&record, drilled_plate::PlateFitLoss::Squares).unwrap();
    // The owners minimise the sum of the fourth powers (a squared length handed to a least-squares routine).
    let p = drilled_plate::evaluate(&record, drilled_plate::PlateFitLoss::Fourth).unwrap();
    let owners = |key: &str, n: usize| -> f64 {
        let line = fit.lines().find(|l| l.starts_with(key)).unwrap();
        line[key.len()..].split_whitespace().nth(n).unwrap().parse().unwrap()
    };
    println!(
        "{} holes: scale {}, rms {:.2} µm {:?}, quadrupole {:.3e} at {:.2}°",
        p.holes, p.scale, p.rms_um, p.rms_um_by_diameter, p.quadrupole, p.quadrupole_deg
    );
    let near =
        |got: f64, want: f64, digit: f64| assert!((got - want).abs() <= 0.51 * digit, "{got} and {want}");
    for p in [&p, &squares] {
        near(p.offset_mm[0], owners("FitOffset", 0), 0.001);
        near(p.offset_mm[1], owners("FitOffset", 1), 0.001);
        near(p.scale, owners("FitScale", 0), 0.000_001);
        near(p.rotation_deg, owners("FitRotAngle", 0), 0.001);
    }
    assert!(squares.rms_um < p.rms_um && p.rms_um - squares.rms_um < 0.1, "{} {}", squares.rms_um, p.rms_um);
    // The owners' first RMS is over the ordinary holes, the one in brackets over the larger MaNGA holes.
    let bracket = fit.split("ResidRadErrRMS (MANGA)").nth(1).and_then(|t| t.split(['(', ')']).nth(1));
    near(p.rms_um_by_diameter["2.167"] / 1000.0, owners("ResidRadErrRMS (MANGA)", 0).abs(), 0.0001);
    near(p.rms_um_by_diameter["2.845"] / 1000.0, bracket.unwrap().trim().parse().unwrap(), 0.0001);
    near(p.quadrupole, owners("QPMagnitude", 0), 0.000_000_01);
    // The owners' search stops before the last digit here.
    near(p.quadrupole_deg, owners("QPAngle", 0), 0.04);
    near(p.rms_quadrupole_um / 1000.0, owners("QPResidRadErrRMS", 0), 0.0001);
}

#[test]
fn the_older_plate_reads_too() {
    let Some((path, text)) = shared("plate_cmm/D2130A1") else { return };
    let record = import::cmm_plate(&path, &text, Path::new("plate.run.toml")).unwrap();
    let p = drilled_plate::evaluate(&record, drilled_plate::PlateFitLoss::Squares).unwrap();
    assert_eq!(p.holes, text.lines().skip(4).filter(|l| !l.trim().is_empty()).count());
    assert!(p.rms_um > 1.0 && p.rms_um < 10.0, "{}", p.rms_um);
}

/// Rows of the spindle run as a record: growth (error.z) and sixteen temperatures.
fn spindle(text: &str, rows: std::ops::Range<usize>) -> Record {
    let lines: Vec<&str> = text.lines().collect();
    let names: Vec<&str> = lines[0].split(',').collect();
    let columns = names.iter().enumerate().map(|(k, name)| {
        let role = match k {
            0 => Role::Time,
            1 => Role::Error(Axis::new("z").unwrap()),
            _ => Role::Temperature,
        };
        let value = |l: &&str| l.split(',').nth(k).unwrap().trim().parse::<f64>().unwrap();
        let data = lines[1..][rows.clone()].iter().map(|l| if k == 0 { 60.0 * value(l) } else { value(l) });
        Column { name: (*name).to_owned(), unit: role.unit().unwrap().to_owned(), role, data: data.collect() }
    });
    Record::new(Path::new("spindle.run.toml"), RunKind::Drift, columns.collect()).unwrap()
}

/// Growth of a real spindle from temperatures alone.
/// Sensors, lag and parameters are chosen without the block judged.
#[test]
fn real_spindle_is_predicted_from_temperatures() {
    if !test_needs::long() {
        return;
    }
    let Some((_, text)) = shared("spindle_thermal/first_half.csv") else { return };
    let record = spindle(&text, 0..2341);
    let (machine, reports) = thermal::fit(&[&record], &[], &ThermalFitOptions::default()).unwrap();
    let r = &reports[0];
    let linear = &r.baselines["linear T0-T15"];
    println!("environment {:?}; {}", r.environment, r.rounds.last().unwrap().added);
    println!(
        "RMS over the blocks {:.3} µm; T0-T15 linear {:.3}, mean {:.3}, persistence {:.3}",
        r.rms_um.folds_rms,
        linear.folds_rms,
        r.baselines["mean"].folds_rms,
        r.baselines["persistence"].folds_rms
    );
    println!(
        "95 % interval ±{:.2} µm holds {:.1} %",
        r.interval95.half_width_um,
        100.0 * r.interval95.coverage_folds
    );
    assert_eq!(r.environment.as_deref(), Some("T15"));
    assert!(r.rms_um.folds_rms < 0.25 * linear.folds_rms);
    assert!((0.90..=0.99).contains(&r.interval95.coverage_folds));
    // Physics: growth follows warmth with a lag.
    let growth = machine.effects().find(|e| e.description().name == "thermal_lag").unwrap();
    assert!(growth.value("um_per_K").unwrap()[0] > 0.0 && growth.value("tau_s").unwrap()[0] > 600.0);
}

/// The best choice within one stretch may fail on the next.
/// The model is fitted on the first 30 h and tested on the 9 h after.
#[test]
fn real_spindle_is_predicted_into_unseen_later_time() {
    if !test_needs::long() {
        return;
    }
    let Some((_, text)) = shared("spindle_thermal/first_half.csv") else { return };
    let (early, late) = (spindle(&text, 0..1800), spindle(&text, 1800..2341));
    let (_, reports) = thermal::fit(&[&early], &[&late], &ThermalFitOptions::default()).unwrap();
    let r = &reports[0];
    let of = |name: &str| r.baselines[name].holdout[0];
    println!(
        "hold-out {:.3} µm; T0-T15 linear {:.3}, mean {:.3}",
        r.rms_um.holdout[0],
        of("linear T0-T15"),
        of("mean")
    );
    assert!(r.rms_um.holdout[0] < 0.5 * of("linear T0-T15") && r.rms_um.holdout[0] < 0.2 * of("mean"));
    assert!(r.interval95.coverage_holdout[0] >= 0.9, "{:?}", r.interval95);
}

/// Wherever the rows are cut, the earlier ones predict the later ones well.
/// The prediction is far better than the mean. No two large terms cancelled each other before.
#[test]
fn real_spindle_is_predicted_from_wherever_it_is_cut() {
    if !test_needs::long() {
        return;
    }
    let Some((_, text)) = shared("spindle_thermal/first_half.csv") else { return };
    for cut in [700, 1000, 1170, 1500] {
        let (early, late) = (spindle(&text, 0..cut), spindle(&text, cut..2341));
        let (_, reports) = thermal::fit(&[&early], &[&late], &ThermalFitOptions::default()).unwrap();
        let (own, mean) = (reports[0].rms_um.holdout[0], reports[0].baselines["mean"].holdout[0]);
        println!("{cut} rows learned: {own:.2} µm, the mean {mean:.2}");
        assert!(own < 0.5 * mean, "{cut} rows learned: {own:.2} µm, the mean {mean:.2}");
    }
}
