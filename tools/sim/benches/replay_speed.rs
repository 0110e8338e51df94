//! Prints a replay's edges per second from a CSV file, and its memory.
//! Run it as `cargo bench -p rtec-sim --bench replay_speed [-- EDGES]`.
//!
//! The axis moves 1000 counts there and back at 2 µs per count. A correction of ±2 counts is requested every
//! 500 edges.

use rtec_driver::quadrature::State;
use rtec_driver::trace_replay::RequestedTotal;
use rtec_files::quadrature_trace::TraceReader;
use rtec_rt::axis::AxisConfig;
use rtec_sim::engine_replay::replay;
use std::io::{BufWriter, Write};
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let edges: u64 = std::env::args().skip(1).find_map(|n| n.parse().ok()).unwrap_or(20_000_000);
    let file = std::env::temp_dir().join(format!("rtec-replay-speed-{}.csv", std::process::id()));
    let mut out = BufWriter::new(std::fs::File::create(&file)?);
    writeln!(out, "t_ns,a,b\n0,0,0")?;
    let mut state = State::default();
    for n in 1..=edges {
        state = state.next(n / 1000 % 2 == 0);
        writeln!(out, "{},{},{}", n * 2000, u8::from(state.a()), u8::from(state.b()))?;
    }
    out.into_inner()?.sync_all()?;
    let totals = (1..edges / 500)
        .map(|n| Ok(RequestedTotal { t_ns: n * 1_000_000, requested: if n % 2 == 0 { 2 } else { -2 } }));
    let config = AxisConfig { max_accel_counts_s2: 1e6, ..AxisConfig::default() };
    let begun = Instant::now();
    let (outcome, _) = replay(config, TraceReader::open(&file)?, totals, true, |_, _| ())?;
    let seconds = begun.elapsed().as_secs_f64();
    std::fs::remove_file(&file)?;
    let status = std::fs::read_to_string("/proc/self/status")?;
    let peak = status.lines().find(|l| l.starts_with("VmHWM")).unwrap_or_default();
    println!(
        "{} edges in {seconds:.2} s: {:.1} million edges/s; {} insertions, balanced: {}; {peak}",
        outcome.edges,
        outcome.edges as f64 / seconds / 1e6,
        outcome.insertions,
        outcome.balanced(),
    );
    Ok(())
}
