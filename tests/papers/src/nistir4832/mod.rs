//! NISTIR 4832: the Original RTEC and the alternative Designs A, B and C.

mod belief;
mod designs;
mod signals;

use crate::rows::Agreement::{AtMost, Within};
use crate::rows::Rows;
use crate::{PaperError, Progress};
use rtec_driver::quadrature::State;
use rtec_model::machine::Machine;
use rtec_model::record::Role;
use rtec_sim::compensation_experiments::{ExperimentInputs, one_metre, over_a_part};
use rtec_sim::computer_timing::ComputerTiming;
use rtec_sim::corrected_machine_sim::{CorrectedMachineSim, MachineSpec};
use rtec_sim::described_machines::MachineDescriptions;
use rtec_sim::insertion_design_bench::InsertionDesign;
use rtec_sim::insertion_design_comparison::waveforms;
use rtec_sim::nc_block::Block;
use serde::Deserialize;
use std::path::Path;

/// The machine as its file describes it.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Bench {
    machine: String,
    count_um: f64,
    travel_mm: f64,
    rapid_mm_min: f64,
    cutting_mm_min: f64,
    part_share: f64,
    correction_bits: u32,
    window_corrections: i64,
    update_every_mm: f64,
    dither_counts: f64,
    computer: Timing,
    faster_computer: Timing,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Timing {
    name: String,
    react_ns: u64,
    step_ns: u64,
    after_ns: u64,
    pass_ns: u64,
}

impl Timing {
    fn computer(&self) -> ComputerTiming {
        let Self { name, react_ns, step_ns, after_ns, pass_ns } = self.clone();
        ComputerTiming { name, react_ns, step_ns, after_ns, pass_ns, looks: Vec::new(), write_ns: 0 }
    }
}

/// A look of a run: time, scale, MTC, its count.
type Change = (u64, State, State, i64);

pub(crate) fn run(
    described: &MachineDescriptions,
    seed: u64,
    progress: Progress<'_>,
) -> Result<Rows, PaperError> {
    let bench: Bench = described.read("4832.toml")?;
    let machine = described.machine(&bench.machine)?;
    let (computer, faster) = (bench.computer.computer(), bench.faster_computer.computer());
    let mut rows = Rows::default();
    progress("NISTIR 4832: the axis over its travel, the pulses");
    signals::signals(&mut rows, &bench, seed)?;
    signals::pulses(&mut rows, &bench, &computer)?;
    for design in InsertionDesign::ALL {
        let with = if design == InsertionDesign::B { &faster } else { &computer };
        let name = format!("figure-2-{}.svg", design.name());
        rows.figures.push((name, waveforms(design, with, 3)));
    }
    progress("NISTIR 4832: the linear error over a part");
    linear(&mut rows, &bench, &machine, seed)?;
    progress("NISTIR 4832: at rest, and with dither");
    designs::at_rest(&mut rows, &bench, &computer, seed)?;
    progress("NISTIR 4832: Designs A, B and C");
    designs::design_b(&mut rows, &computer, &faster);
    designs::design_c(&mut rows, &computer)?;
    progress("NISTIR 4832: range, belief window, switches");
    belief::range(&mut rows, &bench, &computer)?;
    belief::belief(&mut rows, &bench)?;
    belief::switches(&mut rows)?;
    Ok(rows)
}

fn cannot(what: &str) -> PaperError {
    PaperError::Cannot(format!("NISTIR 4832: {what} cannot be run on the machine as described"))
}

/// 240 µm over one metre, one correction every 16 700 µm, fifteen over a quarter of the travel.
fn linear(rows: &mut Rows, bench: &Bench, machine: &Machine, seed: u64) -> Result<(), PaperError> {
    let place = "The \"Original RTEC\"";
    let spec = MachineSpec::machining_centre();
    let setting =
        ExperimentInputs { spec: &spec, truth: machine, known: Some(machine), seed, out: Path::new("") };
    let spec = one_metre(bench.count_um, bench.travel_mm);
    let length_mm = bench.part_share * bench.travel_mm;
    let mut found = over_a_part(&setting, &spec, length_mm, bench.cutting_mm_min)?;
    rows.figures.append(&mut found.plots);
    let data = |n: usize| -> (Vec<f64>, Vec<f64>) {
        let record = &found.records[n];
        let x = record.columns.iter().find(|c| matches!(c.role, Role::Position(_)));
        let e = record.responses().next();
        (x.map_or_else(Vec::new, |c| c.data.clone()), e.map_or_else(Vec::new, |c| c.data.clone()))
    };
    let ((x, e), (cx, ce)) = (data(0), data(1));
    let whole = e.last().copied().unwrap_or(0.0) / (x.last().copied().unwrap_or(1.0) / bench.travel_mm);
    let other = "the machine file has another error";
    rows.given().number((place, "error over one metre", "µm"), 240.0, whole, Within(1.0), other);
    let half_um = 2.0 * bench.count_um;
    let steps: Vec<f64> =
        (1..ce.len()).filter(|&k| (ce[k - 1] - ce[k]).abs() > half_um).map(|k| cx[k]).collect();
    let spacing = match (steps.first(), steps.last()) {
        (Some(a), Some(b)) if steps.len() > 1 => (b - a) / (steps.len() - 1) as f64,
        _ => 0.0,
    };
    rows.given().number((place, "one correction every", "mm"), 16.7, spacing, Within(0.2), other);
    let what = "corrections over a quarter of the travel";
    let gets = found.summary.get("insertions").and_then(serde_json::Value::as_f64).unwrap_or(0.0);
    rows.given().number((place, what, ""), 15.0, gets, Within(0.0), other);
    // A new value only every so often.
    let place = "Alternate Configurations";
    let mut sim = CorrectedMachineSim::new(&spec, machine, Some(machine), [0.0; 3], seed)?;
    let v_mm_s = bench.cutting_mm_min / 60.0;
    sim.set_control_period((bench.update_every_mm / v_mm_s * 1e9) as u64);
    sim.machine.load([Block::Feed { to: [length_mm, 0.0, 0.0], feed_mm_s: v_mm_s }]);
    let mut late: f64 = 0.0;
    while !sim.machine.finished() {
        sim.advance(0.12)?;
        late = late.max(sim.moment().off_um(0).abs());
    }
    let what = "a new value every 1 to 2 mm is sufficient: the error stays below one correction";
    rows.number((place, what, "µm"), 4.0 * bench.count_um, late, AtMost, "with a value every 2 mm");
    let every_ms = rtec_sim::corrected_machine_sim::CONTROL_NS as f64 / 1e6;
    let what = "a new value every 10 to 20 ms: our control period";
    rows.given().number((place, what, "ms"), 20.0, every_ms, AtMost, "10 ms");
    Ok(())
}
