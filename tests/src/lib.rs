//! Tests of the whole, and counters of other programs that judge it.
//!
//! | module | what |
//! |---|---|
//! | [`clients`] | clients that poll a daemon's status, and a scraper of its metrics |
//! | [`daemon`] | a real `rtecd`, a user with `rtecctl`, and a machine at the end of a shared-memory card |
//! | [`disk`] | a small disk that a test can fill |
//! | [`pages`] | the commands of README and guide, run as a reader would |
//! | [`gpio_sim`] | the kernel's simulated GPIO lines, from outside |
//! | [`judge`] | LinuxCNC's `encoder` component and sigrok's graycode decoder as counters of a trace |
//! | [`ledger`] | the counts due in a corrected trace, from the scale's trace and the order of the inversions |
//! | [`sensors`] | two temperature sensors at the end of a line |
//! | [`workload`] | three axes on a card in memory, which benchmarks time |
//! | [`machine`] | a two-axis machine with a known error, driven by LinuxCNC, corrected by the engine |
//! | [`supervisor`] | a service manager that keeps file descriptors, and the trial that kills `rtecd` |
//! | [`planted_traces`] | right and wrong corrected traces made without the engine, which test the judges |
//!
//! Nothing that the product needs belongs here. The judges use no formula of the code that they judge.

#![allow(
    clippy::missing_panics_doc,
    reason = "they panic where they cannot do their work, and the test fails"
)]

pub mod clients;
pub mod daemon;
pub mod disk;
pub mod gpio_sim;
pub mod judge;
pub mod ledger;
pub mod machine;
pub mod pages;
pub mod planted_traces;
pub mod sensors;
pub mod supervisor;
pub mod workload;

use std::path::Path;

/// The workspace's root.
pub fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
}

pub use test_needs::{asked, shared, skipped};
