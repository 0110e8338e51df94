//! WO 97/43703: global differential wet modelling.

mod drilling;
mod geometry;
mod heat;
mod model;
mod starts;

use crate::rows::Rows;
use crate::{PaperError, Progress};
use drilling::drilling;
use geometry::{GROWN_UM, circles, displacement, grown_reversal, tool_changes};
use heat::{drifts, dry_against_wet, equations, table_6};
pub use starts::{STARTS, StartResult, starts};

use model::wet_model;
use rtec_model::machine::Machine;
use rtec_model::record::{Axis, Record, Role};
use rtec_sim::compensation_experiments::{Experiment, ExperimentInputs, ExperimentResult};
use rtec_sim::corrected_machine_sim::MachineSpec;
use rtec_sim::described_machines::MachineDescriptions;
use serde::Deserialize;
use std::path::Path;

/// The machine as its file describes it.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Centre {
    machine: String,
    redundant: f64,
    equation: Vec<Equation>,
}

/// One of equations 2 to 4.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Equation {
    axis: String,
    constant_mm: f64,
    terms: Vec<Term>,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(non_snake_case, reason = "the unit is kelvin")]
struct Term {
    sensor: String,
    minus: String,
    mm_per_K: f64,
    mm_per_K2: f64,
}

impl Equation {
    fn mm(&self, degc: impl Fn(&str) -> f64) -> f64 {
        let of = |t: &Term| {
            let k = degc(&t.sensor) - degc(&t.minus);
            t.mm_per_K * k + t.mm_per_K2 * k * k
        };
        self.constant_mm + self.terms.iter().map(of).sum::<f64>()
    }
}

/// µm in an inch.
const INCH_UM: f64 = 25_400.0;
const AXES: [&str; 3] = ["X", "Y", "Z"];
/// Rows of tables 4 and 5: what, and from which minute to which.
const PHASES: [(&str, usize, usize); 8] = [
    ("5500 rpm, 3 h", 0, 180),
    ("1 h cooling", 180, 240),
    ("3000 rpm, 1 h", 240, 300),
    ("1 h cooling again", 300, 360),
    ("1500 rpm, 15 min", 360, 375),
    ("3000 rpm, 15 min", 380, 395),
    ("5500 rpm, 15 min", 400, 415),
    ("3000 rpm, 15 min, the last", 420, 435),
];
/// Tables 4 and 5: drift in X, Y, Z, inches, and tilt in X and Y, arcseconds, of each phase.
const TABLE_4: [[f64; 5]; 8] = [
    [0.0027, 0.0017, -0.0048, 11.6, -21.3],
    [0.0003, -0.0002, 0.0006, 3.1, 1.1],
    [0.0002, -0.0001, -0.0007, -1.0, -3.5],
    [0.0002, -0.0001, 0.0001, 1.7, 1.1],
    [0.0001, -0.0003, 0.0003, -3.4, 4.5],
    [0.0001, 0.0, 0.0001, 4.5, -3.5],
    [-0.0002, 0.0002, -0.0006, 2.3, -4.6],
    [0.0, 0.0001, 0.0002, 1.1, -6.9],
];
const TABLE_5: [[f64; 5]; 8] = [
    [-0.0029, 0.0041, -0.0036, 6.1, -12.1],
    [0.0005, -0.0015, -0.001, 3.5, -7.6],
    [-0.0004, 0.001, 0.001, -8.4, 4.2],
    [0.0001, -0.0012, -0.001, 3.3, -3.1],
    [0.0001, 0.0001, 0.0001, -9.5, 4.2],
    [0.0001, 0.0005, -0.0004, -8.4, 2.9],
    [0.0, 0.0005, -0.0005, -5.3, 2.1],
    [-0.0001, 0.0004, 0.0008, -5.2, -2.5],
];

struct Run<'a> {
    spec: MachineSpec,
    truth: &'a Machine,
    seed: u64,
}

impl<'a> Run<'a> {
    /// The patent's machine.
    fn new(truth: &'a Machine, seed: u64) -> Self {
        Self { spec: MachineSpec::machining_centre(), truth, seed }
    }

    /// An experiment of the characterisation, or with a model the drilling test without and with compensation.
    fn experiment(&self, name: &str, known: Option<&Machine>) -> Result<ExperimentResult, PaperError> {
        let setting = ExperimentInputs {
            spec: &self.spec,
            truth: self.truth,
            known,
            seed: self.seed,
            out: Path::new(""),
        };
        let experiment =
            Experiment::find(name).ok_or_else(|| PaperError::Cannot(format!("no experiment {name}")))?;
        Ok(experiment.run(&setting)?)
    }
}

pub(crate) fn run(
    described: &MachineDescriptions,
    seed: u64,
    progress: Progress<'_>,
) -> Result<Rows, PaperError> {
    let centre: Centre = described.read("wo97.toml")?;
    let truth = described.machine(&centre.machine)?;
    let run = Run::new(&truth, seed);
    let mut rows = Rows::default();
    let characterise = |rows: &mut Rows, name: &str| -> Result<ExperimentResult, PaperError> {
        let mut found = run.experiment(name, None)?;
        rows.figures.append(&mut found.plots);
        Ok(found)
    };
    progress("WO 97/43703: circles in three planes");
    let found = characterise(&mut rows, "ballbar")?;
    circles(&mut rows, &found);
    let grown = with_reversal(&truth, GROWN_UM)?;
    grown_reversal(&mut rows, &Run::new(&grown, seed).experiment("ballbar", None)?);
    progress("WO 97/43703: linear displacement, tool changes");
    let found = characterise(&mut rows, "linear-displacement")?;
    let linear = displacement(&mut rows, &found);
    let found = characterise(&mut rows, "tool-change-repeatability")?;
    let positioning = tool_changes(&mut rows, &found);
    progress("WO 97/43703: the spindle cycle, dry and wet");
    let drift = characterise(&mut rows, "drift")?;
    let thermal = drifts(&mut rows, &drift);
    table_6(&mut rows, linear, positioning, thermal);
    dry_against_wet(&mut rows, &drift);
    equations(&mut rows, &centre, &drift);
    progress("WO 97/43703: sensors chosen, the wet model fitted");
    let model = wet_model(&mut rows, &centre, &run, &drift)?;
    progress("WO 97/43703: drilling, tests 1 to 3");
    drilling(&mut rows, &run, &model, (linear, positioning, thermal))?;
    Ok(rows)
}

/// The machine with another reversal of Z.
fn with_reversal(truth: &Machine, um: f64) -> Result<Machine, PaperError> {
    let mut machine = truth.clone();
    let place = truth.effects().position(|e| e.name() == "reversal.z");
    let set = place.map(|place| machine.set(place, "um", &[um], None));
    match set {
        Some(Ok(())) => Ok(machine),
        _ => Err(PaperError::Cannot("WO 97/43703: no reversal.z in the machine's file".to_owned())),
    }
}

fn column<'r>(record: &'r Record, role: &Role) -> &'r [f64] {
    record.data(role).unwrap_or_default()
}

fn of_axis(record: &Record, role: fn(Axis) -> Role, axis: usize) -> &[f64] {
    Axis::new(["x", "y", "z"][axis]).map_or(&[], |axis| column(record, &role(axis)))
}

fn error_of(record: &Record, axis: usize) -> &[f64] {
    of_axis(record, Role::Error, axis)
}

fn record<'f>(findings: &'f ExperimentResult, name: &str) -> Result<&'f Record, PaperError> {
    let file = format!("{name}.run.toml");
    let found =
        findings.records.iter().find(|r| r.path.file_name().is_some_and(|n| n.to_string_lossy() == file));
    found.ok_or_else(|| PaperError::Cannot(format!("no record {name}")))
}
