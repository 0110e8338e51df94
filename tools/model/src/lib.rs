//! The machine model: what is known about a machine's errors, for simulation, live compensation and reconciliation.
//!
//! | module | what |
//! |---|---|
//! | [`record`] | run records: a measured or simulated run, read strictly and written whole |
//! | [`effect`] | the dictionary: every effect's law, parameters, channels, derivative and experiment |
//! | [`machine`] | `machine.toml`: a list of named effects, read strictly, written without losing a comment |
//! | [`live`] | a model evaluated at one instant, without allocation |
//! | [`document`] | TOML tables read with line and column |

pub mod document;
pub mod effect;
pub mod fit;
pub mod import;
pub mod iso230;
pub mod live;
pub mod machine;
pub mod plate;
pub mod plot;
pub mod record;
