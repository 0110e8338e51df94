//! Finds the parameters, sensors and intervals that the data supports.
//!
//! | module | contents |
//! |---|---|
//! | [`thermal`] | sensor selection (CASC) and the fit of equation 1 of WO 97/43703 |
//! | [`linear_least_squares`] | least squares for named effects and chain terms |
//! | `repeated_residuals` | residuals that repeat at a place |
//! | [`temperature_denoising`] | temperatures without sensor noise |
//! | `statistics` | means and quantiles |
//! | [`workflow`] | a fit from records as users give them, and its document |
//! | [`validate`] | checks a model on records that it has not seen |
//! | [`kinematic_chain_fit`] | a chain's polynomials, fitted component by component |
//!
//! `rtec-reconcile`, not this crate, decides which effect is missing altogether.
//!
//! An example: `cargo run -p rtec-fit --example fit_growth`. The tests run it too.

pub mod kinematic_chain_fit;
pub mod linear_least_squares;
mod repeated_residuals;
mod statistics;
pub mod temperature_denoising;
pub mod thermal;
pub mod validate;
pub mod workflow;
