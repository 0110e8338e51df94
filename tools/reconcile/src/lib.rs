//! Reconciliation: measured runs and a machine model in.
//! Out comes where they disagree, which effect is missing, a better model, and how far the gap shrank.
//!
//! A reader's way: [`reconcile()`] → `doubt` → `answer` (which asks `rtec-estimate`) → [`Reconciliation`].
//!
//! | module | what |
//! |---|---|
//! | `workflow` | the whole of it: what is doubted, the estimate, what is written into the model |
//! | `doubt`, `suspected` | what records show by themselves of people's mistakes: said, and left out |
//! | `mistakes` | mistakes as hypotheses beside the model |
//! | `drawn` | of very many rows those that are looked at |
//! | `answer` | what the estimate says, as findings |
//! | `where_found` | where measured and simulated disagree |
//! | `room` | the sensors that a fit of growth chooses on the same drift |
//! | `unexplained` | a curve that stands for what has no name |
//! | `extent` | places on a grid, for the advice |
//! | `interval` | within what the better model predicts, as a fit states it |
//! | `next_run` | the run that tells an effect from its rivals, before it is made |
//! | `regression` | what stands behind a fit or a verdict, as arrays |
//! | `verdict`, `gap`, `advice`, `document`, `report` | the answer, its figures, what to do next, as JSON and as a page |
//!
//! Laws must not be here. A law, how it is searched and what may replace it are in its description in `rtec-model`; no module matches a law
//! by its name. Nothing here depends on a machine, a simulator or time.
//!
//! At work: `cargo run -p rtec-reconcile --example name_what_is_missing`, which the tests run too.

mod advice;
mod answer;
mod document;
mod doubt;
mod drawn;
mod extent;
mod gap;
mod interval;
mod mistakes;
mod next_run;
mod regression;
mod report;
mod room;
mod suspected;
#[cfg(test)]
mod testing;
mod unexplained;
mod verdict;
mod where_found;
mod why;
mod workflow;

/// Seed of all permutations.
pub const SEED: u64 = 4832;

pub use answer::Finding;
pub use gap::{Gap, Over, Trace};
pub use next_run::{NextRuns, Open, Tells, next_runs};
pub use regression::{Regression, RegressionColumn, RegressionRows, SetUpColumns};
pub use report::{html, pictures};
pub use rtec_estimate::{Rival, Shape, Tried};
pub use unexplained::LAWS_FILE;
pub use verdict::{Reconciliation, Refined, SetUp, Unsaid, Verdict};
pub use where_found::Place;
pub use why::why;
pub use workflow::{find, reconcile};

/// What a reconciliation may be told.
#[derive(Debug, Clone)]
pub struct Options {
    /// Probability with which chance alone may lead to an answer other than "nothing is missing".
    pub level: f64,
    /// The date that added effects carry, ISO 8601.
    pub date: Option<String>,
    /// Where something is unexplained, add a bounded curve in its place, marked as such.
    pub unexplained: bool,
    /// Whether the figures of the gap and the traces are wanted too.
    /// The last stage's work.
    pub figures: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self { level: 0.01, date: None, unexplained: false, figures: true }
    }
}
