//! Is this computer fit for the real-time thread, and may the service use the card?
//!
//! | module | what |
//! |---|---|
//! | [`selftest`] | the latencies that the speed gate rests on, measured with the real engine |
//! | [`access`] | may the service open the card's devices, and where do their interrupts land? |
//! | `measurement` | what the self-test is asked for, and what each of its parts brings |
//! | `on_card` | the self-test on the card that will do the work |
//! | [`verdict`] | what they leave each axis, and whether the machine may correct |
//! | `far` | the far side of the self-test's wires: gives the edges, times the insertions, is the MTC |
//!
//! What must not live here: a machine's errors, its corrections or parts; anything that runs while a machine is corrected.
//!
//! At work: `cargo run -p rtec-platform --example latency`, which the tests run too.

pub mod access;
mod far;
mod measurement;
mod on_card;
pub mod selftest;
pub mod verdict;
