//! Reconciles measured runs with a machine model.
//! It finds where they disagree and which effect is missing. It returns a better model, and how far the gap
//! shrank.
//!
//! To read the code, follow [`reconcile()`] → `data_screening` → `analysis` (which calls `rtec-estimate`) →
//! [`ReconciliationResult`].
//!
//! | module | what |
//! |---|---|
//! | `workflow` | the whole workflow: doubts, the estimate, changes to the model |
//! | `data_mistake_screening`, `suspicion_scope` | people's mistakes that records show by themselves: reported and left out |
//! | `mistakes` | mistakes as hypotheses beside the model |
//! | `row_subsample` | a subsample of very many rows |
//! | `findings_from_estimate` | the estimate as findings |
//! | `residual_localisation` | where measured and simulated disagree |
//! | `sensor_choice_check` | the sensors that a fit of growth chooses on the same drift |
//! | `unexplained_curve` | a curve in place of what no effect explains |
//! | `period_aliases_on_grid` | aliases on a grid of places, for the advice |
//! | `prediction_interval` | the prediction interval of the better model |
//! | `next_run` | the run that would separate an effect from its rivals, planned before it is made |
//! | `regression_export` | the regression behind a fit or a verdict, as arrays |
//! | `verdict`, `gap`, `advice`, `document`, `html_report` | the answer, its figures, what to do next, as JSON and as a page |
//!
//! Laws must not be here. A law's description in `rtec-model` says how it is searched and what may replace
//! it; no module matches a law by its name. Nothing here depends on a machine, a simulator or time.
//!
//! An example: `cargo run -p rtec-reconcile --example name_what_is_missing`. The tests run it too.

mod data_mistake_screening;
mod evidence_for_effect;
mod experiment_advice;
mod findings_from_estimate;
mod gap;
mod html_report;
mod mistakes;
mod next_run;
mod period_aliases_on_grid;
mod prediction_interval;
mod regression_export;
mod residual_localisation;
mod row_subsample;
mod sensor_choice_check;
mod suspicion_scope;
#[cfg(test)]
mod test_records;
mod unexplained_curve;
mod verdict;
mod verdict_json;
mod workflow;

/// Seed of all permutations.
pub const SEED: u64 = 4832;

pub use evidence_for_effect::why;
pub use findings_from_estimate::FoundEffect;
pub use gap::{Abscissa, Gap, ResidualTrace};
pub use html_report::{html, pictures};
pub use next_run::{ExpectedEvidence, NextRuns, UnresolvedEffect, next_runs};
pub use regression_export::{RegressionArrays, RegressionColumn, RegressionRows, SetUpTermsIncluded};
pub use residual_localisation::ResidualStructure;
pub use rtec_estimate::{RivalExplanation, TriedExplanation, UnnamedShape};
pub use unexplained_curve::LAWS_FILE;
pub use verdict::{ReconciliationResult, RecordSetUp, RevisedEffect, SkippedRecord, Verdict};
pub use workflow::{find, reconcile};

/// The options of a reconciliation.
#[derive(Debug, Clone)]
pub struct ReconciliationOptions {
    /// False-alarm rate, a probability.
    /// With it chance alone may lead to an answer other than "nothing is missing".
    pub level: f64,
    /// The date that added effects carry, ISO 8601.
    pub date: Option<String>,
    /// Whether to add a bounded curve, marked as such, for what is unexplained.
    pub unexplained: bool,
    /// Whether to compute the figures of the gap and the traces.
    /// The last stage needs them.
    pub figures: bool,
}

impl Default for ReconciliationOptions {
    fn default() -> Self {
        Self { level: 0.01, date: None, unexplained: false, figures: true }
    }
}
