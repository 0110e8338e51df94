//! Which figures of the four sources come out of the simulated machines, run now.
//!
//! | module | source |
//! |---|---|
//! | [`nistir4832`] | NISTIR 4832 (1992): the Original RTEC, Designs A, B and C |
//! | [`nistir4854`] | NISTIR 4854 (1992): fast probing, part-form error, compensation by table |
//! | [`cmti`], [`ecc_board`] | CMTI (2014): the Error Correction Circuit; two of them behind one controller |
//! | [`wo97`] | WO 97/43703 (1997): the global differential wet model |
//!
//! Each runs the machine that its source describes (`rtec_sim::described`). It gives one [`Row`] for every table,
//! figure and figure in the text that can be compared. A row has what the paper says, what came out, and why they
//! differ.
//!
//! What must not live here: a machine, an experiment (`rtec-sim`), a fit (`rtec-fit`).
//!
//! `cargo run --profile quick -p rtec-papers -- cmti` prints the table of a source.

pub mod cmti;
pub mod ecc_board;
pub mod nistir4832;
pub mod nistir4854;
mod rows;
mod spread;
pub mod wo97;

pub use rows::{Basis, Row, Verdict};
pub use spread::Spread;

use rows::Rows;
use rtec_files::InputError;
use rtec_sim::compensation_experiments::ExperimentError;
use rtec_sim::corrected_machine_sim::SimError;
use rtec_sim::described_machines::MachineDescriptions;
use rtec_sim::engine_replay::ReplayError;
use rtec_sim::turning_experiment::TurningExperimentError;
use serde::Serialize;

/// A source.
#[derive(Debug, Clone, Copy)]
pub struct Paper {
    /// Its name on the command line.
    pub name: &'static str,
    /// What it is.
    pub title: &'static str,
    run: Run,
}

/// Whoever is told of each step.
pub type Progress<'p> = &'p mut dyn FnMut(&str);

/// From a source's description, a seed, and whoever is told of progress.
type Run = fn(&MachineDescriptions, u64, Progress<'_>) -> Result<Rows, PaperError>;

/// The four sources.
pub const PAPERS: [Paper; 4] = [
    Paper {
        name: "4832",
        title: "NISTIR 4832 (1992), alternative designs of a real-time error corrector",
        run: nistir4832::run,
    },
    Paper {
        name: "4854",
        title: "NISTIR 4854 (1992), compensation of part errors by in-process gauging",
        run: nistir4854::run,
    },
    Paper {
        name: "cmti",
        title: "CMTI (2014), thermal error compensation by feedback signal manipulation",
        run: cmti::run,
    },
    Paper { name: "wo97", title: "WO 97/43703 (1997), global differential wet modelling", run: wo97::run },
];

/// What stops a comparison.
#[derive(Debug, thiserror::Error)]
pub enum PaperError {
    /// A description is not as it must be, or a record or model that came of it.
    #[error(transparent)]
    Input(#[from] InputError),
    /// An experiment failed on the machine that is described.
    #[error(transparent)]
    Experiment(#[from] ExperimentError),
    /// The simulated machine stopped.
    #[error(transparent)]
    Sim(#[from] SimError),
    /// The simulated lathe stopped.
    #[error(transparent)]
    Turning(#[from] TurningExperimentError),
    /// A recording could not be played.
    #[error(transparent)]
    Replay(#[from] ReplayError<InputError>),
    /// A figure could not be drawn.
    #[error(transparent)]
    Plot(#[from] rtec_measure::plot::PlotError),
    /// A machine as described cannot do what its source does with it.
    #[error("{0}")]
    Cannot(String),
}

/// How many rows of a basis agree and differ.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Count {
    /// Where what came out comes from.
    pub basis: Basis,
    /// Rows that agree.
    pub agree: usize,
    /// Rows that differ, each with its reason.
    pub differ: usize,
}

impl std::fmt::Display for Count {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} agree, {} differ", self.agree, self.differ)
    }
}

/// A source beside what came out.
#[derive(Debug, Clone, Serialize)]
pub struct Compared {
    /// The source's name on the command line.
    pub paper: &'static str,
    /// What it is.
    pub title: &'static str,
    /// Seed of all noise.
    pub seed: u64,
    /// How many rows agree and differ, by where what came out comes from.
    pub counts: [Count; 3],
    /// Figures left out because they are no larger than their tolerance.
    pub too_small: usize,
    /// Every figure, in the source's order.
    pub rows: Vec<Row>,
    /// What the source draws without printing its values, as tables to read.
    pub tables: Vec<String>,
    /// Its figures as they come out here: file name and text.
    #[serde(skip)]
    pub figures: Vec<(String, String)>,
}

impl Paper {
    /// The source of this name; `nistir4832` is `4832`.
    pub fn find(name: &str) -> Option<&'static Self> {
        let name = name.strip_prefix("nistir").unwrap_or(name);
        PAPERS.iter().find(|p| p.name == name)
    }

    /// Runs everything that the source gives a figure of.
    /// `progress` is told what is under way.
    ///
    /// # Errors
    /// A description that is not right, or a machine that stops.
    pub fn compare(
        &self,
        described: &MachineDescriptions,
        seed: u64,
        progress: Progress<'_>,
    ) -> Result<Compared, PaperError> {
        let Rows { list: rows, figures, tables, too_small, .. } = (self.run)(described, seed, progress)?;
        let counts = Basis::ALL.map(|basis| {
            let count = |v: Verdict| rows.iter().filter(|r| r.basis == basis && r.verdict == v).count();
            Count { basis, agree: count(Verdict::Agrees), differ: count(Verdict::Differs) }
        });
        Ok(Compared { paper: self.name, title: self.title, seed, counts, too_small, rows, tables, figures })
    }
}
