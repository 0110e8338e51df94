//! Missing effects, parameters and their intervals, estimated from records.
//!
//! y = M(θ) + Z(η) + H(β, ψ) + e: the machine by its model, the set-up of each instrument, hypotheses, noise.
//! One likelihood decides. Every number that an answer depends on is in [`priors`].
//!
//! | module | what |
//! |---|---|
//! | [`priors`] | every number that an answer depends on |
//! | [`search_limits`] | limits of the search's work |
//! | [`rows`] | records as rows under one noise |
//! | [`setup`] | set-up terms, in one list |
//! | [`unnamed_shapes`] | shapes without a name, in one list |
//! | `contribution`, `hypothesis_family` | contribution of a hypothesis to the rows; all hypotheses |
//! | `gaussian_process`, `wave` | smooth functions as columns; frequencies that rows show |
//! | `wander` | walks that last longer than the noise's correlation |
//! | `hypothesis_columns` | a quick look at many columns |
//! | `problem` | the measurement model without hypotheses; the noise |
//! | `search` | the likeliest set |
//! | `estimate` | noise and search in turn; names, values, intervals |
//! | `refit` | sizes fitted again, with rows left out or a curve added |

pub mod contribution;
pub mod estimate;
pub mod gaussian_process;
pub mod hypothesis_columns;
pub mod hypothesis_family;
pub mod priors;
pub mod problem;
pub mod refit;
pub mod rows;
pub mod search;
pub mod search_limits;
pub mod setup;
pub mod unnamed_shapes;
pub mod wander;
pub mod wave;

pub use contribution::UnnamedShape;
pub use estimate::{
    Estimate, EstimatedMember, RefinedEffect, Rival, SetUpEstimate, TriedExplanation, estimate,
    evidence_without_hypotheses, of_other_machine, score, unexplained,
};
