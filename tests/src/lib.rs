//! What only the whole can show, and the counters we did not write that judge it.
//!
//! | module | what |
//! |---|---|
//! | [`clients`] | who reads a daemon: clients that ask all the time, a scraper of its metrics |
//! | [`daemon`] | a real `rtecd`, a user with `rtecctl`, and a machine at the end of a shared-memory card |
//! | [`disk`] | a disk that is soon full |
//! | [`pages`] | the commands of README and guide, run as a reader would |
//! | [`gpio_sim`] | the kernel's simulated GPIO lines, from outside |
//! | [`judge`] | LinuxCNC's `encoder` component and sigrok's graycode decoder as counters of a trace |
//! | [`ledger`] | what a corrected trace must count, from the scale's trace and the order of the inversions |
//! | [`sensors`] | two temperature sensors at the end of a line |
//! | [`workload`] | three axes on a card in memory: what benchmarks time |
//! | [`machine`] | a two-axis machine with a known error, driven by LinuxCNC, corrected by the engine |
//! | [`supervisor`] | a service manager that keeps file descriptors, and the trial that kills `rtecd` |
//! | [`planted`] | corrected traces made without the engine, right ones and wrong ones: the judges' own test |
//!
//! What must not live here: anything that the product needs; the judges take no formula from what they judge.

pub mod clients;
pub mod daemon;
pub mod disk;
pub mod gpio_sim;
pub mod judge;
pub mod ledger;
pub mod machine;
pub mod pages;
pub mod planted;
pub mod sensors;
pub mod supervisor;
pub mod workload;

use std::path::Path;

/// The workspace's root.
#[must_use]
pub fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
}

pub use test_needs::{asked, shared, skipped};
