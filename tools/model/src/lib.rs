//! The machine model: what is known about a machine's errors.
//! It serves simulation, live compensation and reconciliation.
//!
//! | module | what |
//! |---|---|
//! | [`effect`] | the dictionary: every effect's law, parameters, channels, derivative and experiment |
//! | [`chain`] | the other way to build a model: error components of each joint, combined by homogeneous transforms |
//! | [`machine`] | `machine.toml`: a list of named effects, read strictly, written without losing a comment |
//! | [`live`] | a model evaluated at one instant, without allocation |
//! | [`record`] | a run in memory: what an effect is evaluated over, column by column |
//! | `role` | what a column is: its role and axis |
//! | [`circle`] | a circular run measured by a bar: what its angle says of the two axes |
//! | [`file_kind`] | what a file says that it is, where another kind was asked for (of `rtec-files`) |
//!
//! What must not live here: files of runs (`rtec-measure`), anything that chooses or fits (`rtec-fit`), counts, ramps
//! and limits (`rtec-correct`).
//!
//! At work: `cargo run -p rtec-model --example evaluate`, which the tests run too.

pub mod chain;
pub mod circle;
pub mod effect;
pub use rtec_files::file_kind;
pub mod limits;
pub mod live;
pub mod machine;
pub mod record;
mod role;
