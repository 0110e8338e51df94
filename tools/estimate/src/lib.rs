//! Missing effects, parameters and their intervals, estimated from records.
//!
//! y = M(θ) + Z(η) + H(β, ψ) + e: the machine by its model, the set-up of each instrument, hypotheses, noise.
//! One likelihood decides. Every number that an answer depends on is in [`priors`].
//!
//! | module | what |
//! |---|---|
//! | [`priors`] | every number that an answer depends on |
//! | [`search_limits`] | limits of the search's work |
//! | [`rows_and_noise`] | records as rows under one noise |
//! | [`set_up_terms`] | set-up terms, in one list |
//! | [`unnamed_shapes`] | shapes without a name, in one list |
//! | `hypothesis_contribution`, `hypothesis_family` | contribution of a hypothesis to the rows; all hypotheses |
//! | `gaussian_process`, `wave` | smooth functions as columns; frequencies that rows show |
//! | `wander` | walks that last longer than the noise's correlation |
//! | `hypothesis_column_bank` | a quick look at many columns |
//! | `measurement_model` | the measurement model without hypotheses; the noise |
//! | `search` | the likeliest set |
//! | `estimate` | noise and search in turn; names, values, intervals |
//! | `effect_size_refit` | sizes fitted again, with rows left out or a curve added |

pub mod candidate_hypotheses;
pub mod effect_size_refit;
pub mod estimate;
pub mod gaussian_process;
pub mod hypothesis_column_bank;
pub mod hypothesis_contribution;
pub mod measurement_model;
pub mod priors;
pub mod rows_and_noise;
pub mod search;
pub mod search_limits;
pub mod set_up_terms;
pub mod unnamed_shapes;
pub mod wander;
pub mod wave_periodogram;

pub use estimate::{
    CorrectedKnownEffect, EstimatedHypothesis, EstimationResult, RivalExplanation, SetUpEstimate,
    TriedExplanation, estimate, evidence_without_hypotheses, of_other_machine, score, unexplained,
};
pub use hypothesis_contribution::UnnamedShape;
