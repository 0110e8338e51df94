//! Reconciliation: measured runs and a machine model in; out comes where they disagree, which effect is missing, a
//! better model, and how far the gap shrank.

// Sums over columns read best as `for_each`; the lists of hypotheses are long because the dictionary is.
#![allow(clippy::needless_for_each, clippy::too_many_lines)]

mod analysis;
mod chance;
mod fit;
mod gram;
mod hypotheses;
mod problem;
mod report;
mod search;
mod steady;
mod unexplained;
mod verdict;
mod wherein;

pub use analysis::{Answer, Finding, Rival, Tried};
pub use chance::SEED;
pub use hypotheses::Shape;
pub use report::html;
pub use unexplained::LAWS_FILE;
pub use verdict::{Gap, Reconciliation, Refined, Trace, find, reconcile};
pub use wherein::Place;

/// What a reconciliation may be told.
#[derive(Debug, Clone)]
pub struct Options {
    /// Probability with which chance alone may lead to an answer other than "nothing is missing".
    pub level: f64,
    /// The date that added effects carry, ISO 8601.
    pub date: Option<String>,
    /// Where something is unexplained, add a bounded curve that stands for it, marked as such.
    pub unexplained: bool,
    /// Whether the figures of the gap and the traces are wanted too: the last stage's work.
    pub figures: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self { level: 0.01, date: None, unexplained: false, figures: true }
    }
}
