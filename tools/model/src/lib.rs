//! The machine model: a description of a machine's errors.
//! It serves simulation, live compensation and reconciliation.
//!
//! | module | what |
//! |---|---|
//! | [`effect`] | the dictionary: every effect's law, parameters, channels, derivative and experiment |
//! | [`kinematic_chain`] | the other way to build a model: error components of each joint, combined by homogeneous transforms |
//! | [`machine`] | `machine.toml`: a list of named effects, read strictly, written without losing a comment |
//! | [`live_evaluation`] | a model evaluated at one instant, without allocation |
//! | [`record`] | a run in memory, column by column, over which effects are evaluated |
//! | `role` | the role and axis of a column |
//! | [`ballbar_circle`] | a circular run measured by a bar: the errors of its two axes from the angle |
//! | [`file_kind`] | the kind of a file that was given in place of another (from `rtec-files`) |
//!
//! These do not belong here: files of runs (`rtec-measure`), anything that chooses or fits (`rtec-fit`),
//! counts, ramps and limits (`rtec-correct`).
//!
//! An example: `cargo run -p rtec-model --example evaluate`. The tests run it too.

pub mod ballbar_circle;
pub mod effect;
pub mod kinematic_chain;
pub use rtec_files::file_kind;
pub mod disconnected_sensor_codes;
pub mod live_evaluation;
pub mod machine;
pub mod record;
mod role;
mod statistics;
