//! Number and positions of insertions (NISTIR 4832).

use super::runs::{Done, ExperimentRun, MeasuredRow, along, digits, feed};
use super::{ExperimentError, ExperimentInputs, ExperimentResult};
use crate::axis::AxisSpec;
use crate::corrected_axis::GateInsertionDesign;
use crate::corrected_machine_sim::MachineSpec;
use crate::nc_block::Block;
use rtec_model::record::RunKind;
use rtec_rt::axis::{AxisConfig, InsertionAtRestPolicy};
use serde_json::json;

/// The report's machine: one axis of a metre, corrected by the Original RTEC.
pub fn one_metre(count_um: f64, travel_mm: f64) -> MachineSpec {
    let mut spec = MachineSpec::new(vec![AxisSpec { count_um, ..AxisSpec::new("x", travel_mm) }]);
    spec.design = GateInsertionDesign::Original;
    spec.rest = InsertionAtRestPolicy::Wait;
    spec
}

pub(super) fn linear_error(experiment: &mut ExperimentRun<'_>) -> Done {
    // A quarter of the travel, at a cutting feed.
    experiment.findings = over_a_part(experiment.setting, &one_metre(1.0, 1000.0), 250.0, 500.0)?;
    Ok(())
}

/// Number and positions of insertions over the length of a part at a cutting feed.
///
/// # Errors
/// As [`super::Experiment::run`].
pub fn over_a_part(
    setting: &ExperimentInputs<'_>,
    spec: &MachineSpec,
    length_mm: f64,
    mm_min: f64,
) -> Result<ExperimentResult, ExperimentError> {
    let (mut experiment, mut insertions) = (ExperimentRun::new(setting), 0);
    let runs = experiment.both_on(spec, [0.0; 3], "linear-error-240um", |sim, log| {
        sim.machine.load([feed(along(0, length_mm), mm_min)]);
        while !sim.machine.finished() {
            // A row every millimetre.
            sim.advance(60.0 / mm_min)?;
            log.take(sim, 1.0);
        }
        sim.finish()?;
        insertions = sim.status().axes[0].insertions;
        Ok(())
    })?;
    let x = |r: &MeasuredRow| r.now.axes[0].position_mm;
    experiment.publish(&runs, RunKind::Positioning, (&[0], 0.0), ("position (mm)", &x))?;
    experiment.findings.summary.insert("insertions".to_owned(), json!(insertions));
    Ok(experiment.findings)
}

pub(super) fn rapid_catch_up(experiment: &mut ExperimentRun<'_>) -> Done {
    let mut spec = one_metre(1.0, 1000.0);
    // The 8051's nine microseconds (NISTIR 4832): at rapid traverse they do not fit.
    let nine = crate::computer_timing::ComputerTiming::i8051().configure(AxisConfig::default());
    (spec.detect_ns, spec.write_ns) = (nine.detect_ns + nine.guard_ns, 500);
    let (mut waited, mut entering) = (0, Vec::new());
    let runs = experiment.both_on(&spec, [0.0; 3], "rapid-catch-up", |sim, log| {
        let rapid = [
            Block::Rapid { to: [400.0, 0.0, 0.0] },
            feed([410.0, 0.0, 0.0], 500.0),
            feed([440.0, 0.0, 0.0], 200.0),
        ];
        sim.machine.load(rapid);
        while !sim.machine.finished() {
            sim.advance(0.02)?;
            log.take(sim, 1.0);
        }
        waited = sim.status().axes[0].waited_for_gate;
        // The tool enters the part after ten millimetres of feed in air.
        entering =
            log.rows.iter().filter(|r| r.now.axes[0].position_mm > 410.0).map(|r| r.now.off_um(0)).collect();
        Ok(())
    })?;
    let x = |r: &MeasuredRow| r.now.axes[0].position_mm;
    experiment.publish(&runs, RunKind::Positioning, (&[0], 0.0), ("position (mm)", &x))?;
    let pending = |r: &MeasuredRow| (r.requested_um[0] - r.now.inserted_um[0]).abs();
    let worst = runs.logs.iter().flat_map(|l| &l.rows).map(pending).fold(0.0, f64::max);
    let in_part = entering.iter().fold(0.0_f64, |w, e| w.max(e.abs()));
    experiment.findings.summary.insert("edges_waited_for_gate".to_owned(), json!(waited));
    experiment.findings.summary.insert("largest_backlog_um".to_owned(), json!(digits(worst, 1e3)));
    experiment.findings.summary.insert("largest_error_in_part_um".to_owned(), json!(digits(in_part, 1e3)));
    Ok(())
}
