//! The machine model: what is known about a machine's errors, for simulation, live compensation and reconciliation.
//!
//! | module | what |
//! |---|---|
//! | [`record`] | run records: a measured or simulated run, read strictly and written whole |
//! | [`effect`] | the dictionary: every effect's law, parameters, channels, derivative and experiment |
//! | [`machine`] | `machine.toml`: a list of named effects, read strictly, written without losing a comment |
//! | [`live`] | a model evaluated at one instant, without allocation |
//! | [`chain`] | the other way to build a model: error components of each joint, combined by homogeneous transforms |
//! | [`chain_fit`] | a chain's polynomials, fitted component by component |
//! | [`fit`] | sensor selection (CASC) and the fit of equation 1 of WO 97/43703 |
//! | [`least`] | least squares for effects and chain terms that are named |
//! | [`sensors`] | temperatures through what Linux offers, each watched |
//! | [`rehearse`] | a recorded shift replayed against a new model |
//! | [`iso230`], [`plate`] | evaluations as the standards define them |
//! | [`plan`] | the test sequence a machine is characterised with |
//! | [`import`] | other tools' files as run records |
//! | [`plot`] | charts as SVG |

pub mod chain;
pub mod chain_fit;
pub mod date;
pub mod effect;
pub mod fit;
pub mod import;
pub mod iso230;
pub mod least;
pub mod live;
pub mod machine;
pub mod plan;
pub mod plate;
pub mod plot;
pub mod record;
pub mod rehearse;
pub mod sensors;
