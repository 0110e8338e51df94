//! Reconciliation: measured runs and a machine model in; out comes where they disagree, which effect is missing, a
//! better model, and how far the gap shrank.
//!
//! A reader's way: [`reconcile()`] → `analysis` → `search` → `naming` → `fit` → [`Reconciliation`].
//!
//! | module | what |
//! |---|---|
//! | `workflow` | the whole of it: analysis, last fit, what is written into the model |
//! | `doubt`, `weighed`, `undone`, `swapped`, `suspected` | people's mistakes: said, and left out; weighed against what may be missing; columns or sensors exchanged; what a suspicion is about |
//! | `drawn` | of very many rows those that are looked at |
//! | `problem`, `gram`, `bank`, `cholesky`, `lanes`, `threads` | runs and model as one least-squares problem; products of columns under correlated noise, of very many columns; factors of them; sums and waves over many numbers; as many threads as there are processors |
//! | `cause`, `hypotheses`, `shapes`, `teeth`, `waves`, `extent` | what may be missing: effects over their grids, shapes of no name |
//! | `search` | the set of explanations that the data pay for |
//! | `analysis`, `tuning` | the search again and again, the model's own parameters and the noise's size mended in between |
//! | `chance` | what the same search finds in noise |
//! | `naming`, `simpler`, `anew`, `leftover`, `rounding`, `steady` | which of it is named, what else it might be; fewer names; an axis's own laws chosen together; what they leave, and what no name is confirmed for; what rounding makes; explanations by heat that predict |
//! | `fit`, `fitted` | all effects jointly, with an interval for each value; which of them keep their place |
//! | `where_found` | where measured and simulated disagree |
//! | `room` | the sensors that a fit of growth chooses on the same drift |
//! | `rhythm` | whether what is left changes from row to row as noise does |
//! | `unexplained` | a curve that stands for what has no name |
//! | `answer` | what the analysis found, before anything is written |
//! | `verdict`, `gap`, `advice`, `document`, `report` | the answer, its figures, what to do next, as JSON and as a page |
//!
//! What must not be here: the laws. What a law is, how it is searched, what stands in for what, is asked of its
//! description in `rtec-model`; no module matches a law by its name. Nothing here knows a machine, a simulator or time.
//!
//! At work: `cargo run -p rtec-reconcile --example name_what_is_missing`, which the tests run too.

mod advice;
mod analysis;
mod anew;
mod answer;
mod bank;
mod cause;
mod chance;
mod cholesky;
mod document;
mod doubt;
mod drawn;
mod extent;
mod fit;
mod fitted;
mod gap;
mod gram;
mod hypotheses;
mod lanes;
mod leftover;
mod naming;
mod problem;
mod report;
mod rhythm;
mod room;
mod rounding;
mod search;
mod shapes;
mod simpler;
mod steady;
mod suspected;
mod swapped;
mod teeth;
#[cfg(test)]
mod testing;
mod threads;
mod tuning;
mod undone;
mod unexplained;
mod verdict;
mod waves;
mod weighed;
mod where_found;
mod workflow;

pub use answer::{Answer, Finding, Rival, Tried};
pub use cause::Shape;
pub use chance::SEED;
pub use gap::{Gap, Trace};
pub use report::{html, pictures};
pub use unexplained::LAWS_FILE;
pub use verdict::{Reconciliation, Refined, Unsaid, Verdict};
pub use where_found::Place;
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
    /// Whether the figures of the gap and the traces are wanted too: the last stage's work.
    pub figures: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self { level: 0.01, date: None, unexplained: false, figures: true }
    }
}
