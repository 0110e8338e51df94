//! Reconciliation: measured runs and a machine model in; out comes where they disagree, which effect is missing, a
//! better model, and how far the gap shrank.

mod analysis;
mod chance;
mod gram;
mod hypotheses;
mod problem;
mod search;

pub use analysis::{Answer, Finding, Rival, analyse};
pub use chance::SEED;
pub use hypotheses::Shape;
