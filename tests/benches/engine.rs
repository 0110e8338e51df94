//! Cost of an engine step in TSC cycles, beside LinuxCNC's encoder, and replay.
//!
//! `cargo bench -p rtec-tests --bench engine`. It prints and asserts nothing. LinuxCNC's encoder is measured in the
//! same run, where it is installed.

use rtec_driver::card::CardError;
use rtec_driver::quadrature::State;
use rtec_driver::trace_replay::{RequestedTotal, TracePoint};
use rtec_rt::axis::AxisConfig;
use rtec_sim::engine_replay::replay;
use rtec_tests::judge::LinuxCnc;
use rtec_tests::workload::{Motion, Workload};
use std::time::Instant;

/// Number of calls that are timed one by one.
const CALLS: usize = 1_000_000;

fn main() -> anyhow::Result<()> {
    println!("one step of the engine, three axes, card in memory, each timed as HAL does ({UNIT})");
    println!("  {:<34} {:>8} {:>8}   of LinuxCNC's", "", "p50", "p99");
    let peer = linuxcnc();
    for (name, motion) in Motion::ALL {
        let mut work = Workload::new(motion)?;
        work.looks(100_000)?;
        let ours = timed(|| work.looks(1))?;
        let share = peer.as_ref().map_or_else(|_| String::new(), |p| format!("{:.2}", ours.p50 / p.p50));
        println!("  {name:<34} {:>8.0} {:>8.0}   {share}", ours.p50, ours.p99);
    }
    match peer {
        Ok(Times { p50, p99 }) => {
            println!("  {:<34} {p50:>8.0} {p99:>8.0}", "LinuxCNC encoder.update-counters");
        }
        Err(why) => println!("  LinuxCNC's encoder was not measured: {why:#}"),
    }
    batches()?;
    replay_speed()
}

/// A function's times, without the cost of the measurement.
struct Times {
    p50: f64,
    p99: f64,
}

impl Times {
    fn of(mut each: Vec<u64>, mut empty: Vec<u64>) -> Self {
        each.sort_unstable();
        empty.sort_unstable();
        let nothing = empty[empty.len() / 2] as f64;
        let at = |percent: usize| each[(each.len() - 1) * percent / 100] as f64 - nothing;
        Self { p50: at(50), p99: at(99) }
    }
}

/// Times every call as HAL does: the counter is read before and after it.
fn timed(mut step: impl FnMut() -> Result<(), CardError>) -> anyhow::Result<Times> {
    let (mut each, mut empty) = (Vec::with_capacity(CALLS), Vec::with_capacity(CALLS));
    for _ in 0..CALLS {
        let start = ticks();
        step()?;
        let end = ticks();
        let nothing = ticks();
        each.push(end - start);
        empty.push(nothing - end);
    }
    Ok(Times::of(each, empty))
}

/// LinuxCNC's counter as HAL times it, called without a pause.
/// It gets an edge per call on each channel.
fn linuxcnc() -> anyhow::Result<Times> {
    anyhow::ensure!(cfg!(target_arch = "x86_64"), "HAL measures in TSC cycles");
    let mut judge = LinuxCnc::new()?;
    let mut state = State::default();
    for n in 0..CALLS {
        judge.show(state, 0)?;
        state = state.next(n % 64 < 40);
    }
    let cycles = judge.cycles(1000)?;
    let empty = f64::from(cycles.empty_p50);
    Ok(Times { p50: f64::from(cycles.p50) - empty, p99: f64::from(cycles.p99) - empty })
}

/// Times the same step in batches of a thousand, as the loop as a whole has it.
fn batches() -> anyhow::Result<()> {
    const BATCH: u64 = 1000;
    const BATCHES: usize = 5000;
    println!("one step of the engine, three axes, card in memory, mean of {BATCH} in a row ({UNIT})");
    for (name, motion) in Motion::ALL {
        let mut work = Workload::new(motion)?;
        let mut means = Vec::with_capacity(BATCHES);
        for _ in 0..BATCHES {
            let start = ticks();
            work.looks(BATCH)?;
            means.push((ticks() - start) as f64 / BATCH as f64);
        }
        means.sort_by(f64::total_cmp);
        println!("  {name:<34} {:>8.1} {:>8.1}", means[BATCHES / 2], means[BATCHES * 99 / 100]);
    }
    Ok(())
}

/// A replay from memory: the engine and its virtual clock without a file.
fn replay_speed() -> anyhow::Result<()> {
    const EDGES: u64 = 20_000_000;
    println!("replay of {EDGES} edges from memory, 2 µs apart");
    for (name, every) in
        [("no correction", u64::MAX), ("±2 counts every 500 edges", 500), ("at every edge", 1)]
    {
        let mut point = TracePoint { t_ns: 0, state: State::default() };
        let trace = (0..EDGES).map(|n| {
            point = TracePoint { t_ns: point.t_ns + 2000, state: point.state.next(n / 1000 % 2 == 0) };
            Ok::<_, std::convert::Infallible>(point)
        });
        let requests = (1..EDGES / every).map(|n| {
            Ok(RequestedTotal { t_ns: n * every * 2000, requested: if n % 2 == 0 { 2 } else { 0 } })
        });
        let before_kb = peak_kb();
        let start = Instant::now();
        let (outcome, _) = replay(AxisConfig::default(), trace, requests, true, |_, _| ())?;
        let seconds = start.elapsed().as_secs_f64();
        println!(
            "  {name:<28} {:>6.1} million edges/s, {} insertions, ledger {}, peak memory {} kB, {} kB more than before",
            outcome.edges as f64 / seconds / 1e6,
            outcome.insertions,
            if outcome.balanced() { "balanced" } else { "DOES NOT BALANCE" },
            peak_kb(),
            peak_kb() - before_kb,
        );
    }
    Ok(())
}

/// The process's largest resident size so far, kB.
fn peak_kb() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.and_then(|line| line.split_whitespace().next()?.parse().ok()).unwrap_or(0)
}

#[cfg(target_arch = "x86_64")]
const UNIT: &str = "TSC cycles";
#[cfg(not(target_arch = "x86_64"))]
const UNIT: &str = "ns";

#[cfg(target_arch = "x86_64")]
fn ticks() -> u64 {
    // SAFETY: every x86-64 CPU has RDTSC, and it touches no memory.
    unsafe { std::arch::x86_64::_rdtsc() }
}

#[cfg(not(target_arch = "x86_64"))]
fn ticks() -> u64 {
    use std::sync::OnceLock;
    static START: OnceLock<Instant> = OnceLock::new();
    START.get_or_init(Instant::now).elapsed().as_nanos() as u64
}
