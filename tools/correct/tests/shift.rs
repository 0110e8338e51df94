//! One recorded shift through the law and through a rehearsal.
//! Both give the same totals, count by count. The simulator, the daemon and the demo run the same file
//! through their own code (`shift` in their tests).

#![allow(clippy::unwrap_used)] // a test's own helpers

mod bench;

use rtec_correct::rehearse::{RehearsalOptions, rehearse};
use rtec_correct::{AxisCorrectionSettings, Corrector};
use rtec_files::csv::Reader;
use rtec_model::machine::Machine;
use rtec_model::record::{Axis, Column, Record, Role, RunKind};
use rtec_rt::link_messages::{CorrectorMode, CorrectorStatus};
use rtec_sensors::{SensorConfig, SensorMonitor};
use std::path::Path;

const LEAD_S: f64 = 0.02;

/// Columns of the shift, as its header names them.
fn shift() -> Vec<Vec<f64>> {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/shift/shift.csv");
    let mut reader = Reader::open(&file).unwrap();
    let header = reader.header("t_s, positions, sensors, operator, totals").unwrap();
    assert_eq!(
        header.names().collect::<Vec<_>>(),
        [
            "t_s",
            "x_counts",
            "y_counts",
            "z_counts",
            "T8",
            "T18",
            "operator_x",
            "total_x",
            "total_y",
            "total_z"
        ]
    );
    let mut columns = vec![Vec::new(); 10];
    while let Some(row) = reader.row().unwrap() {
        header
            .each(row, |n, cell| {
                columns[n].push(cell.finite()?);
                Ok(())
            })
            .unwrap();
    }
    columns
}

fn machine() -> Machine {
    Machine::read(&Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/shift/machine.toml")).unwrap()
}

fn axes() -> Vec<AxisCorrectionSettings> {
    ["x", "y", "z"].map(bench::axis).to_vec()
}

#[test]
fn the_law_asks_for_what_was_recorded() {
    let shift = shift();
    let mut watches = ["T8", "T18"].map(|n| SensorMonitor::new(SensorConfig::believed(n, Role::Temperature)));
    let mut law = Corrector::new(axes(), rtec_correct::RAMP_UM_S, LEAD_S, 0.0);
    law.sense(0.0, &watches);
    law.load(machine(), &|_| Vec::new()).unwrap();
    let mut status = CorrectorStatus { mode: CorrectorMode::Run, axes_used: 3, ..CorrectorStatus::default() };
    status.axes.iter_mut().for_each(|a| a.homed = true);
    let mut moved = [0; 3];
    for (row, t_s) in shift[0].iter().copied().enumerate() {
        let at = |column: usize| shift[column][row];
        watches[0].offer(t_s, Ok(at(4)));
        watches[1].offer(t_s, Ok(at(5)));
        law.operator_is(0, at(6) as i64);
        status.t_ns = (t_s * 1e9).round() as u64;
        (0..3).for_each(|n| status.axes[n].position_counts = at(1 + n) as i64);
        let totals = law.tick(t_s, &status, &watches);
        for (n, axis) in status.axes.iter_mut().enumerate().take(3) {
            let total = totals[n].unwrap_or(axis.requested);
            assert_eq!(total, at(7 + n) as i64, "axis {n} at {t_s} s");
            moved[n] += usize::from(total != axis.requested);
            (axis.requested, axis.completed, axis.in_effect) = (total, total, total);
        }
    }
    assert!(moved.iter().all(|m| *m > 15), "a shift in which every axis is corrected: {moved:?}");
}

#[test]
fn a_rehearsal_of_it_shows_the_same_totals() {
    let shift = shift();
    let name = |n: &str| Axis::new(n).unwrap();
    let mm = |n: usize| shift[n].iter().map(|c| c / 1000.0).collect::<Vec<_>>();
    let columns = vec![
        Column::new("t", Role::Time, shift[0].clone()),
        Column::new("x", Role::Position(name("x")), mm(1)),
        Column::new("y", Role::Position(name("y")), mm(2)),
        Column::new("z", Role::Position(name("z")), mm(3)),
        Column::new("T8", Role::Temperature, shift[4].clone()),
        Column::new("T18", Role::Temperature, shift[5].clone()),
    ];
    let record = Record::of_checked(Path::new("shift.run.toml"), RunKind::Drift, columns);
    let options = RehearsalOptions { axes: axes(), lead_s: LEAD_S, ..RehearsalOptions::default() };
    let found = rehearse(&Machine::ideal("no model"), &machine(), &record, &options).unwrap();
    assert_eq!(found.axes.iter().map(|a| a.axis.as_str()).collect::<Vec<_>>(), ["x", "y", "z"]);
    for (n, axis) in found.axes.iter().enumerate() {
        assert_eq!(axis.rows.len(), shift[0].len());
        assert!((axis.held, axis.largest_um[0]) == (0.0, 0.0), "{axis:?}");
        for (row, (t_s, totals)) in axis.rows.iter().enumerate() {
            // A rehearsal has no operator.
            let operator = if n == 0 { shift[6][row] as i64 } else { 0 };
            assert_eq!(totals[1] + operator, shift[7 + n][row] as i64, "axis {} at {t_s} s", axis.axis);
        }
    }
}
