//! Rehearsals of a few rows whose totals, shares and speeds are known by hand.

#![allow(clippy::unwrap_used)] // a test's own helpers

use rtec_correct::rehearse::{AxisCorrectionChange, RehearsalOptions, RehearsalResult, rehearse};
use rtec_correct::{AxisCorrectionSettings, RAMP_UM_S};
use rtec_model::machine::Machine;
use rtec_model::record::{Axis, Column, Record, Role, RunKind};
use rtec_rt::link_messages::MAX_AXES;
use std::path::Path;

fn machine(effects: &str) -> Machine {
    Machine::parse(Path::new("m.toml"), &format!("name = \"m\"\n{effects}")).unwrap()
}

fn scale(axis: &str, ppm: f64) -> String {
    format!("[[effect]]\nname = \"scale.{axis}\"\nppm = {ppm:?}\n")
}

fn thermal(name: &str, rest: &str) -> Machine {
    machine(&format!(
        "[[effect]]\nname = \"{name}\"\nsensor = \"T1\"\nminus = \"T2\"\num_per_K = 10.0\n{rest}\n"
    ))
}

fn position(axis: &str, mm: Vec<f64>) -> Column {
    Column::new(axis, Role::Position(Axis::new(axis).unwrap()), mm)
}

fn shift(t_s: Vec<f64>, mut columns: Vec<Column>) -> Record {
    columns.insert(0, Column::new("t", Role::Time, t_s));
    Record::of_checked(Path::new("shift.run.toml"), RunKind::Drift, columns)
}

/// Counts of half a micrometre, and windows of 50 counts.
fn fine(axes: &[&str]) -> RehearsalOptions {
    let axis = |name: &&str| AxisCorrectionSettings {
        name: (*name).to_owned(),
        count_um: 0.5,
        increment_counts: 2,
        window_counts: 50,
        max_counts: 1000,
    };
    RehearsalOptions { axes: axes.iter().map(axis).collect(), ..RehearsalOptions::default() }
}

fn axis<'r>(found: &'r RehearsalResult, name: &str) -> &'r AxisCorrectionChange {
    found.axes.iter().find(|a| a.axis == name).unwrap()
}

/// The axis moves 400 mm in a second between two rows, and back.
/// The present model asks for 20 µm and the new one for 40 µm. The law must be called between the rows, because 80
/// counts are more than a window. The shift's clock starts late.
#[test]
fn what_changes_is_said_in_micrometres_when_and_how_fast() {
    let t_s = vec![500.0, 501.0, 502.0, 502.0, 503.0];
    let record = shift(t_s.clone(), vec![position("x", vec![0.0, 400.0, 400.0, 300.0, 100.0])]);
    let found =
        rehearse(&machine(&scale("x", 50.0)), &machine(&scale("x", 100.0)), &record, &fine(&["x"])).unwrap();
    assert_eq!((found.axes.len(), found.outside.len()), (1, 0));
    let x = axis(&found, "x");
    let totals = [[0, 0], [40, 80], [40, 80], [30, 60], [10, 20]];
    assert_eq!(x.rows, t_s.into_iter().zip(totals).collect::<Vec<_>>());
    assert_eq!((x.count_um, x.largest_um, x.change_um, x.held), (0.5, [20.0, 40.0], 20.0, 0.0));
    assert!([501.0, 502.0].contains(&x.change_at_s), "{}", x.change_at_s);
    // 0, 20, 20, 15 and 5 µm; two rows of the same time have no speed between them.
    assert!((x.change_rms_um - (1050.0_f64 / 5.0).sqrt()).abs() < 1e-9, "{}", x.change_rms_um);
    assert!((x.fastest_um_per_s - 40.0).abs() < 1e-9, "{}", x.fastest_um_per_s);
}

/// A change in the other direction is as large.
#[test]
fn a_change_has_its_sign() {
    let record = shift(vec![0.0, 1.0, 2.0], vec![position("x", vec![0.0, 200.0, 400.0])]);
    let found =
        rehearse(&machine(&scale("x", 50.0)), &machine(&scale("x", -50.0)), &record, &fine(&["x"])).unwrap();
    let x = axis(&found, "x");
    assert_eq!((x.largest_um, x.change_um, x.change_at_s), ([20.0, 20.0], -40.0, 2.0));
}

/// Five kelvin between two rows: the ramp continues over the rows.
#[test]
fn between_the_rows_a_ramp_sees_the_time_that_passes() {
    let rows = 12;
    let t_s = (0..rows).map(|k| 2.0 * f64::from(k)).collect();
    let mut warm = vec![25.0; rows as usize];
    warm[0] = 20.0;
    let columns = vec![
        position("z", vec![0.0; rows as usize]),
        Column::new("T1", Role::Temperature, warm),
        Column::new("T2", Role::Temperature, vec![20.0; rows as usize]),
    ];
    let growth = thermal("thermal_growth.z", "range_K = [-1.0, 30.0]");
    let found = rehearse(&Machine::ideal("none"), &growth, &shift(t_s, columns), &fine(&["z"])).unwrap();
    let z = axis(&found, "z");
    for (k, (_, [present, new])) in z.rows.iter().enumerate() {
        let um = (2.0 * RAMP_UM_S * k as f64).min(50.0);
        assert!(*present == 0 && (*new as f64 * 0.5 - um).abs() < 1.5, "{new} counts for {um} µm at row {k}");
    }
    assert!((z.fastest_um_per_s - RAMP_UM_S).abs() <= 0.5, "{}", z.fastest_um_per_s);
}

/// The machine is warm at the first row.
/// Its heat is known after four lags of five seconds, which is ten rows of thirty. The difference then leaves its
/// fitted range for six rows.
#[test]
fn rows_that_hold_and_rows_outside_are_shares() {
    let rows = 30;
    let t_s = (0..rows).map(|k| 2.0 * f64::from(k)).collect();
    let columns = |warm: &dyn Fn(i32) -> f64| {
        vec![
            Column::new("T1", Role::Temperature, (0..rows).map(warm).collect()),
            Column::new("T2", Role::Temperature, vec![20.0; rows as usize]),
        ]
    };
    let lag = thermal("thermal_lag.z", "tau_s = 5.0");
    let record = shift(t_s, columns(&|_| 25.0));
    let found = rehearse(&Machine::ideal("none"), &lag, &record, &fine(&["z"])).unwrap();
    let z = axis(&found, "z");
    assert!((z.held - 10.0 / 30.0).abs() < 1e-9, "{}", z.held);
    let growth = thermal("thermal_growth.z", "range_K = [0.0, 3.0]");
    let t_s = (0..rows).map(|k| 2.0 * f64::from(k)).collect();
    let record = shift(t_s, columns(&|k| if k < 24 { 22.0 } else { 25.0 }));
    let found = rehearse(&Machine::ideal("none"), &growth, &record, &fine(&["z"])).unwrap();
    let share = found.outside["thermal_growth.z T1-T2"];
    assert!(found.outside.len() == 1 && (share - 6.0 / 30.0).abs() < 1e-9, "{:?}", found.outside);
}

/// Axes of shift and models count once each, up to the engine's number.
#[test]
fn axes_of_shift_and_models_are_counted_once_and_are_no_more_than_the_engines() {
    let names = ["x", "y", "z", "u", "v", "w", "p"];
    let run = |of_shift: usize, of_model: usize| {
        let columns = names[..of_shift].iter().map(|n| position(n, vec![0.0, 100.0])).collect();
        let models: String = names[..of_model].iter().map(|n| scale(n, 100.0)).collect();
        let record = shift(vec![0.0, 1.0], columns);
        rehearse(&machine(&models), &machine(&models), &record, &RehearsalOptions::default())
    };
    let found = run(2, MAX_AXES).unwrap();
    assert_eq!(found.axes.iter().map(|a| a.axis.as_str()).collect::<Vec<_>>(), names[..MAX_AXES]);
    // Counts of an axis without any description are one micrometre.
    assert_eq!(axis(&found, "y").rows[1].1, [10, 10]);
    let refused = run(names.len(), 1).unwrap_err();
    assert_eq!(
        (refused.found.as_str(), refused.expected.as_str()),
        ("7 axes in the shift and the models", "at most 6")
    );
}
