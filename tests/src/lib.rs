//! What only the whole can show, and the counters we did not write that judge it.
//!
//! | module | what |
//! |---|---|
//! | [`daemon`] | a real `rtecd`, a user with `rtecctl`, and a machine at the end of a shared-memory card |
//! | [`gpio_sim`] | the kernel's simulated GPIO lines, from outside |
//! | [`judge`] | LinuxCNC's `encoder` component and sigrok's graycode decoder as counters of a trace |
//! | [`ledger`] | what a corrected trace must count, from the scale's trace and the order of the inversions |
//! | [`workload`] | three axes on a card in memory: what benchmarks time |
//! | [`machine`] | a two-axis machine with a known error, driven by LinuxCNC, corrected by the engine |
//! | [`supervisor`] | a service manager that keeps file descriptors, and the trial that kills `rtecd` |
//! | [`planted`] | corrected traces made without the engine, right ones and wrong ones: the judges' own test |
//!
//! What must not live here: anything that the product needs; the judges take no formula from what they judge.

pub mod daemon;
pub mod gpio_sim;
pub mod judge;
pub mod ledger;
pub mod machine;
pub mod planted;
pub mod supervisor;
pub mod workload;

use std::path::{Path, PathBuf};

/// The workspace's root.
#[must_use]
pub fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
}

/// A file of the shared real data, or `None`, said loudly, where it is not there.
#[must_use]
pub fn shared(file: &str) -> Option<PathBuf> {
    let path = root().join("../shared").join(file);
    if path.exists() {
        return Some(path);
    }
    skipped(&format!("../shared/{file} not there"));
    None
}

/// Says loudly that a test could not run. With `RTEC_REQUIRE=1`, as `.ci/run` sets it, that is a failure.
///
/// # Panics
/// When nothing may be skipped.
pub fn skipped(why: &str) {
    assert!(std::env::var_os("RTEC_REQUIRE").is_none(), "RTEC_REQUIRE is set, but: {why}");
    eprintln!("SKIPPED: {why}");
}
