//! A short self-test on a mock card.
//! It measures the latencies of the speed gate, and checks that the ledger balances.
use rtec_platform::latency_test::{SelftestOptions, SimulatedCardKind, run};
use std::time::Duration;

#[cfg_attr(test, test)]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let options = SelftestOptions { cpu: 0, priority: 80, run: Duration::from_millis(300), seed: 1 };
    let measured = run(options, SimulatedCardKind::Mock, |what, left_s| println!("{what}, {left_s} s left"))?;
    println!(
        "wake-up at the worst {} ns late; detected within {} ns",
        measured.wakeup.ns.max(),
        measured.detect_ns().0
    );
    assert!(measured.balanced());
    Ok(())
}
