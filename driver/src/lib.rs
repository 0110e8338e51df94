//! The wires between a machine's scales, the corrector and the machine-tool controller (MTC).
//!
//! | module | what |
//! |---|---|
//! | [`quadrature`] | the state table of two signals in quadrature, and a decoder that counts |
//! | [`input`] | the one shape of error for a file that a person wrote |
//! | [`trace`] | recorded quadrature, as CSV and VCD, and requested totals |

pub mod input;
pub mod quadrature;
pub mod trace;
