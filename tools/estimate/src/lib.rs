//! What measured records support: missing effects, parameters and their intervals.
//!
//! y = M(θ) + Z(η) + H(β, ψ) + e: the machine as its model has it, the set-up of each instrument, hypotheses, noise. One likelihood
//! decides. Every number that an answer depends on is in [`priors`].
//!
//! | module | what |
//! |---|---|
//! | [`priors`] | every number that decides |
//! | [`effort`] | how far the search goes |
//! | [`rows`] | records as rows under one noise |
//! | [`setup`] | set-up terms, in one list |
//! | [`shapes`] | shapes without a name, in one list |
//! | `cause`, `family` | what a hypothesis puts into the rows; all of them |
//! | `smooth`, `wave` | smooth functions as columns; frequencies that rows show |
//! | `wander` | what goes on for longer than noise remembers |
//! | `bank` | a quick look at many columns |
//! | `problem` | what is beside every hypothesis; the noise |
//! | `search` | the likeliest set |
//! | `estimate` | noise and search in turn; names, values, intervals |
//! | `refit` | sizes once more, with rows left out or a curve added |

pub mod bank;
pub mod cause;
pub mod effort;
pub mod estimate;
pub mod family;
pub mod priors;
pub mod problem;
pub mod refit;
pub mod rows;
pub mod search;
pub mod setup;
pub mod shapes;
pub mod smooth;
pub mod wander;
pub mod wave;

pub use cause::Shape;
pub use estimate::{Estimate, Found, Moved, Rival, SetUp, Tried, alone, estimate, score, unexplained};
