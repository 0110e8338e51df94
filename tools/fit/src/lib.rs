//! Which parameters, sensors and intervals the data supports.
//!
//! | module | what |
//! |---|---|
//! | [`thermal`] | sensor selection (CASC) and the fit of equation 1 of WO 97/43703 |
//! | [`least`] | least squares for effects and chain terms that are named |
//! | [`quiet`] | temperatures without their sensors' noise |
//! | [`chain`] | a chain's polynomials, fitted component by component |
//!
//! What must not live here: which effect is missing altogether (`rtec-reconcile`).

pub mod chain;
pub mod least;
pub mod quiet;
pub mod thermal;
