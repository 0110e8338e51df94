//! What `rtecd` survives, and what the MTC sees of it (laws 2 and 3): kills at any moment, a control side that stalls or is
//! flooded, full disks, stepped clocks. Not one jump, not one illegal transition; the ledger balances or a fault is latched.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use rtec_tests::daemon::{CONFIG, Machine, program};
use rtec_tests::supervisor::Trial;
use std::sync::{Mutex, MutexGuard};

/// Each daemon keeps a CPU busy: one at a time.
fn alone() -> MutexGuard<'static, ()> {
    static ONE: Mutex<()> = Mutex::new(());
    ONE.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}

#[test]
fn killed_twenty_times_it_leaves_no_jump_and_no_illegal_state() {
    let _alone = alone();
    let directory = tempfile::tempdir().unwrap();
    let at = |name: &str| directory.path().join(name);
    std::fs::write(at("rtec.toml"), CONFIG.replace("CARD", "card")).unwrap();
    let machine = Machine::start(&at("card"));
    let rtecd = program("rtecd");
    let trial = Trial { rtecd, config: at("rtec.toml"), socket: at("s"), kills: 20, seed: 7 };
    let tally = trial.run(&machine, std::io::stderr()).unwrap();
    assert!(tally.kills == 20 && tally.halfway >= 5 && tally.inverted >= 1, "{tally:?}");
    assert!(tally.faults.len() as u32 >= tally.halfway, "{tally:?}");
}
