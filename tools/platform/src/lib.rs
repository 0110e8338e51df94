//! Is this computer fit for the real-time thread, and may the service use the card?
//!
//! | module | what |
//! |---|---|
//! | [`selftest`] | the latencies that the speed gate stands on, measured with the real engine |
//! | [`access`] | may the service open the card's devices, and where do their interrupts land? |
//!
//! Never known here: a machine's errors, corrections or parts; and nothing here runs while a machine is corrected.

pub mod access;
mod far;
pub mod selftest;
