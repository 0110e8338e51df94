//! The experiments that characterise a machine, run on the simulated one.
//! Each runs without and with compensation, and gives a run record and a plot.
//!
//! | module | contents |
//! |---|---|
//! | `runs` | both runs of an experiment, their rows, records and plots |
//! | `motion_experiments` | displacement, circles, plate, feeds, drive forces |
//! | `heat_experiments` | spindle cycles, tool changes, drilling |
//! | `turned_hemisphere` | the turned and probed hemisphere |
//! | `insertion_counts` | number and positions of insertions |

mod heat_experiments;
mod insertion_counts;
mod motion_experiments;
mod runs;
mod turned_hemisphere;

pub use insertion_counts::{one_metre, over_a_part};

use crate::corrected_machine_sim::{MachineSpec, SimError};
use crate::described_machines::MachineDescriptions;
use crate::turning_experiment::TurningExperimentError;
use heat_experiments::{DrillingStartState, drift, drilling, production, tool_change, wet_runs};
use insertion_counts::{linear_error, rapid_catch_up};
use motion_experiments::{ballbar, dynamics, feed_sweep, linear_displacement, plate};
use rtec_files::InputError;
use rtec_model::machine::Machine;
use rtec_model::record::Record;
use runs::{Done, ExperimentRun};
use serde_json::{Map, Value};
use std::path::Path;
use turned_hemisphere::hemisphere;

/// Inputs of an experiment.
#[derive(Debug, Clone, Copy)]
pub struct ExperimentInputs<'a> {
    /// The machine's construction.
    /// Experiments with a fixed machine, and the nose, build their own.
    pub spec: &'a MachineSpec,
    /// The machine with its true errors.
    pub truth: &'a Machine,
    /// The model that the corrector knows; without one there is no compensated run.
    pub known: Option<&'a Machine>,
    /// Seed of all noise.
    pub seed: u64,
    /// Folder for the records.
    pub out: &'a Path,
}

/// Results of an experiment.
#[derive(Debug, Default)]
pub struct ExperimentResult {
    /// Run records, not yet written, without and with compensation (`…-compensated`).
    pub records: Vec<Record>,
    /// Plots and tables of the records: file name and text.
    pub plots: Vec<(String, String)>,
    /// Readings of gauges on a mandrel by record name, one per row.
    pub gauges: Vec<(String, Vec<MandrelGaugeReadings>)>,
    /// The experiment's figures, by name with unit.
    pub summary: Map<String, Value>,
}

/// Title of what a model promises of each response before a drilling test, µm.
pub const PROMISED: &str = "promised of the tool's own error, 95 %";
/// Title of what temperatures outside the range of a model's fits may cost, µm.
pub const UNSEEN: &str = "temperatures at hole 1 that no fit saw may leave, up to";

/// Distance between the two gauges of each direction on the mandrel, mm.
/// WO 97/43703, figure 7, does not state it.
pub const GAUGE_SPACING_MM: f64 = 100.0;

/// Readings of five gauges at a mandrel in the spindle (WO 97/43703, figure 7).
/// 2 and 5 are in X, 1 and 4 in Y, near and far, and 3 in Z.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MandrelGaugeReadings {
    /// Time of the simulation, s.
    pub t_s: f64,
    /// Gauges 1 to 5, µm.
    pub um: [f64; 5],
    /// Tilt of the spindle, by the two gauges of X and those of Y, arcseconds.
    pub tilt_arcsec: [f64; 2],
}

/// Reason why an experiment failed.
#[derive(Debug, thiserror::Error)]
pub enum ExperimentError {
    /// The simulation could not continue.
    #[error(transparent)]
    Sim(#[from] SimError),
    /// The turning of a nose failed.
    #[error(transparent)]
    Turning(#[from] TurningExperimentError),
    /// A record or a model is invalid.
    #[error(transparent)]
    Record(#[from] InputError),
    /// A plot could not be drawn.
    #[error(transparent)]
    Plot(#[from] rtec_measure::plot::PlotError),
}

#[derive(Debug, Clone, Copy)]
enum ExperimentProcedure {
    Own(fn(&mut ExperimentRun<'_>) -> Done),
    /// The drilling test of WO 97/43703 from this thermal state.
    Drilling(DrillingStartState),
}

/// An experiment that characterises a machine.
#[derive(Debug, Clone, Copy)]
pub struct Experiment {
    /// The experiment's name on the command line.
    pub name: &'static str,
    /// Its description in one line.
    pub what: &'static str,
    /// Its own machine, if a source describes one.
    pub own: Option<ExperimentMachine>,
    run: ExperimentProcedure,
}

/// An experiment's own machine.
#[derive(Debug, Clone, Copy)]
pub struct ExperimentMachine {
    file: &'static str,
    /// Whether another machine would make it another experiment.
    pub fixed: bool,
}

/// The turning centre of NISTIR 4832; the results depend on its one error.
const NIST_4832: Option<ExperimentMachine> =
    Some(ExperimentMachine { file: "4832-machine.toml", fixed: true });
/// The turning centre of NISTIR 4854.
const NIST_4854: Option<ExperimentMachine> =
    Some(ExperimentMachine { file: "4854-machine.toml", fixed: false });
/// The machining centre of WO 97/43703.
const WO_97: Option<ExperimentMachine> = Some(ExperimentMachine { file: "wo97-machine.toml", fixed: false });

impl Experiment {
    /// Runs it.
    ///
    /// # Errors
    /// The machine's effects read what the simulation does not have, or the controller gave up.
    pub fn run(&self, setting: &ExperimentInputs<'_>) -> Result<ExperimentResult, ExperimentError> {
        match self.own {
            Some(own) if own.fixed => {
                let machine = MachineDescriptions::default().machine(own.file)?;
                self.run_as_set(&ExperimentInputs { truth: &machine, known: Some(&machine), ..*setting })
            }
            _ => self.run_as_set(setting),
        }
    }

    fn run_as_set(&self, setting: &ExperimentInputs<'_>) -> Result<ExperimentResult, ExperimentError> {
        let mut experiment = ExperimentRun::new(setting);
        match &self.run {
            ExperimentProcedure::Own(run) => run(&mut experiment)?,
            ExperimentProcedure::Drilling(start) => drilling(&mut experiment, self.name, start)?,
        }
        Ok(experiment.findings)
    }

    /// A drilling test after a spindle cycle (rpm and minutes), wet.
    const fn drilling(name: &'static str, what: &'static str, before: &'static [(f64, f64)]) -> Self {
        Self {
            name,
            what,
            own: WO_97,
            run: ExperimentProcedure::Drilling(DrillingStartState { before, stood_degc: None }),
        }
    }

    /// Its own machine; none if the user's is to be used.
    ///
    /// # Errors
    /// Never: the files are within the program, and a test reads them.
    pub fn own_machine(&self) -> Result<Option<Machine>, InputError> {
        self.own.map(|own| MachineDescriptions::default().machine(own.file)).transpose()
    }

    /// The experiment of this name.
    pub fn find(name: &str) -> Option<&'static Self> {
        EXPERIMENTS.iter().find(|e| e.name == name)
    }
}

/// Every experiment, as `simulate --list` shows them.
pub const EXPERIMENTS: [Experiment; 18] = [
    Experiment {
        name: "linear-displacement",
        what: "ISO 230-2: 5 cycles over 13 targets, both directions, each axis against a laser",
        own: WO_97,
        run: ExperimentProcedure::Own(linear_displacement),
    },
    Experiment {
        name: "ballbar",
        what: "circles of 150 mm in three planes, both ways, at 10, 50 and 100 in/min (WO 97/43703, table 1)",
        own: WO_97,
        run: ExperimentProcedure::Own(ballbar),
    },
    Experiment {
        name: "drift",
        what: "the spindle cycle of WO 97/43703, figure 9, dry and wet: spindle growth and 20 temperatures",
        own: WO_97,
        run: ExperimentProcedure::Own(drift),
    },
    Experiment {
        name: "production-cycle",
        what: "a wet spindle cycle that no characterisation runs: four hours of changing speeds and rests",
        own: WO_97,
        run: ExperimentProcedure::Own(production),
    },
    Experiment {
        name: "tool-change-repeatability",
        what: "ten tool changes with arbitrary moves in between, back to a reference (WO 97/43703, table 3)",
        own: WO_97,
        run: ExperimentProcedure::Own(tool_change),
    },
    Experiment {
        name: "wet-runs",
        what: "wet, from cold: warm-up, speeds on the warm machine, cool-down; a shift of speeds and rests (WO 97/43703)",
        own: WO_97,
        run: ExperimentProcedure::Own(wet_runs),
    },
    Experiment::drilling(
        "drilling",
        "three cycles of two passes of 4 holes, from cold, wet (WO 97/43703, tests 1 and 3, table 7)",
        &[],
    ),
    Experiment::drilling("drilling-semi-warm", "the same after an hour at 3000 rpm, wet", &[(3000.0, 60.0)]),
    Experiment::drilling(
        "drilling-warm",
        "the same after three hours at 5000 rpm, wet, the corrector on throughout",
        &[(5000.0, 180.0)],
    ),
    Experiment::drilling(
        "drilling-fully-warm",
        "the same after eight hours at 5000 rpm, wet: the machine hardly moves any more",
        &[(5000.0, 480.0)],
    ),
    Experiment::drilling(
        "drilling-after-rest",
        "the same after four hours at 5000 rpm and three quarters of an hour of rest",
        &[(5000.0, 240.0), (0.0, 45.0)],
    ),
    Experiment {
        name: "drilling-weekend",
        what: "the same after a weekend: all at 16 °C, the hall heated to 20 °C for an hour",
        own: WO_97,
        run: ExperimentProcedure::Drilling(DrillingStartState { before: &[], stood_degc: Some(16.0) }),
    },
    Experiment {
        name: "hemisphere",
        what: "a 38.1 mm nose turned with a worn tool (25 µm flat) and probed at 2.5 m/min (NISTIR 4854)",
        own: NIST_4854,
        run: ExperimentProcedure::Own(hemisphere),
    },
    Experiment {
        name: "plate",
        what: "a grid of holes over the XY plane",
        own: None,
        run: ExperimentProcedure::Own(plate),
    },
    Experiment {
        name: "feed-sweep",
        what: "the same stretch at feeds from 0.1 to 10 m/min, both directions",
        own: None,
        run: ExperimentProcedure::Own(feed_sweep),
    },
    Experiment {
        name: "dynamics",
        what: "drive force over moves of rising speed and acceleration, 1 kHz",
        own: None,
        run: ExperimentProcedure::Own(dynamics),
    },
    Experiment {
        name: "linear-error-240um",
        what: "240 µm per metre over a quarter of a metre: 15 corrections of 4 µm (NISTIR 4832, The \"Original RTEC\")",
        own: NIST_4832,
        run: ExperimentProcedure::Own(linear_error),
    },
    Experiment {
        name: "rapid-catch-up",
        what: "a rapid too fast for insertions: corrections catch up before the tool enters the part (NISTIR 4832)",
        own: NIST_4832,
        run: ExperimentProcedure::Own(rapid_catch_up),
    },
];
