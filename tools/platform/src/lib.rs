//! Self-test of a computer for the real-time thread, and access to the card.
//!
//! This crate knows no errors, corrections or parts of a machine. Nothing in it runs while a machine is corrected.
//!
//! An example, which the tests run too: `cargo run -p rtec-platform --example latency`.

pub mod device_access_check; // may the service open the card's devices, and where do their interrupts land?
mod far_side; // the far side of the self-test's wires: makes the edges, times the insertions, counts as the MTC
pub mod latency_test; // the latencies that the speed gate rests on, measured with the real engine
mod real_card_timing; // the self-test on the card that will do the work
mod selftest_results; // options of the self-test, and results of its parts
pub mod selftest_verdict; // the edge rates that the latencies leave each axis, and whether the machine may correct
