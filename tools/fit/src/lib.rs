//! Which parameters, sensors and intervals the data supports.
//!
//! | module | what |
//! |---|---|
//! | [`thermal`] | sensor selection (CASC) and the fit of equation 1 of WO 97/43703 |
//! | [`least`] | least squares for effects and chain terms that are named |
//! | `places` | what is left at a place every time |
//! | [`quiet`] | temperatures without their sensors' noise |
//! | `statistics` | means and ranks |
//! | [`workflow`] | a fit from records as people give them, and its document |
//! | [`validate`] | a model judged on records it has not seen |
//! | [`chain`] | a chain's polynomials, fitted component by component |
//!
//! Which effect is missing altogether is decided in `rtec-reconcile`, not here.
//!
//! At work: `cargo run -p rtec-fit --example fit_growth`, which the tests run too.

pub mod chain;
pub mod least;
mod places;
pub mod quiet;
mod statistics;
pub mod thermal;
pub mod validate;
pub mod workflow;
