//! Edge to done on a mapped card, beside the machine's own floor.
//!
//! `cargo bench -p rtec-tests --bench latency [-- SECONDS]`. It prints and asserts nothing. The floor is an empty
//! polling loop on the same CPU and priority, in the same minute. `oslat` and `cyclictest` (Debian rt-tests) run beside
//! it where they are installed.

use rtec_driver::clock::{Clock, Monotonic};
use rtec_platform::latency_test::{SelftestOptions, SimulatedCardKind, run};
use rtec_rt::latency_histogram::{HistogramSnapshot, histogram};
use rtec_rt::realtime_setup::{RtSettings, SystemRoot, apply};
use std::process::Command;
use std::time::Duration;

fn main() -> anyhow::Result<()> {
    let seconds = std::env::args().skip(1).find_map(|a| a.parse::<u64>().ok()).unwrap_or(10);
    let cpu = SystemRoot::live().default_cpu();
    let priority = 80;
    let options = SelftestOptions { cpu, priority, run: Duration::from_secs(3 * seconds), seed: 1 };
    let measured =
        run(options, SimulatedCardKind::Mapped, |what, left_s| eprintln!("{what}, {left_s} s left"))?;
    eprintln!("floor, oslat and cyclictest, {seconds} s each");
    let separations_ns = measured.separations_ns();
    let (floor, windows) =
        floor(RtSettings { cpu, priority }, Duration::from_secs(seconds), separations_ns / 2)?;

    println!("CPU {cpu}, priority {priority}, {seconds} s each, ns");
    for finding in measured.setup.findings.iter().filter(|f| !f.ok) {
        println!("  not as wanted: {} is {}", finding.name, finding.got);
    }
    println!(
        "  {:<34} {:>11} {:>8} {:>8} {:>8} {:>8} {:>10}",
        "", "samples", "min", "p50", "p99", "p99.9", "max"
    );
    let row = |name: &str, s: &HistogramSnapshot, less: u64| {
        let of = |ns: u64| ns.saturating_sub(less);
        let figures = [s.min(), s.p50(), s.p99(), s.p999()].map(of);
        let [min, p50, p99, p999] = figures;
        println!("  {name:<34} {:>11} {min:>8} {p50:>8} {p99:>8} {p999:>8} {:>10}", s.samples(), of(s.max()));
    };
    row("floor: gaps of an empty loop", &floor, 0);
    row("floor: two separations, late by", &windows, 0);
    let quiet = &measured.quiet;
    for (polling, how) in [(quiet, ""), (&measured.with_requests, ", with requests")] {
        row(&format!("poll gap{how}"), &polling.poll_gap.ns, 0);
        row(&format!("edge seen to done{how}"), &polling.seen_to_done, separations_ns);
        row(&format!("edge to done{how}"), &polling.edge_to_done.ns, separations_ns);
    }
    row("wake-up", &measured.wakeup.ns, 0);
    println!(
        "  to done less {separations_ns} ns, which are the MTC's: after the edge and between the inversions; {} requests",
        measured.with_requests.requests
    );
    // An insertion that meets such a gap of the machine is late, whatever the engine does.
    let long: u64 = floor.buckets().filter(|b| b.low >= 1000).map(|b| b.count).sum();
    let per_s = long as f64 / (floor.sum() as f64 / 1e9);
    let window_ns = quiet.seen_to_done.p50() as f64;
    println!(
        "  floor: {per_s:.0} gaps of 1 µs and more per second, so {:.3} % of insertions of {window_ns:.0} ns meet one",
        100.0 * per_s * window_ns / 1e9
    );
    // The same rule for both: what is late by a microsecond or more was interrupted by the system or the host.
    let late = |s: &HistogramSnapshot, less: u64| {
        (s.p999().saturating_sub(less), kept_p999(s, less + TAKEN_AWAY_NS))
    };
    let (floor_all, (floor_kept, floor_share)) = late(&windows, 0);
    let (ours_all, (ours_kept, ours_share)) = late(&quiet.seen_to_done, separations_ns);
    let ours_kept = ours_kept.saturating_sub(separations_ns);
    let ratio = |a: u64, b: u64| a as f64 / b.max(1) as f64;
    println!("  p99.9 of an insertion, less its separations, beside the empty loop's two separations:");
    println!("    all: {ours_all} to {floor_all}, {:.1} times", ratio(ours_all, floor_all));
    println!(
        "    without those late by {TAKEN_AWAY_NS} ns and more ({:.3} and {:.3} %): {ours_kept} to {floor_kept}, {:.1} times",
        100.0 * ours_share,
        100.0 * floor_share,
        ratio(ours_kept, floor_kept)
    );
    println!(
        "  ledger {}, {} poll gap faults",
        if measured.balanced() { "balanced" } else { "DOES NOT BALANCE" },
        measured.faults()
    );
    let (cpu, seconds, priority) = (cpu.to_string(), seconds.to_string(), priority.to_string());
    other("oslat", &["--cpu-list", &cpu, "--rtprio", &priority, "-D", &seconds, "-z"]);
    other("cyclictest", &["-q", "-m", "-p", &priority, "-i", "500", "-D", &seconds, "-t", "1", "-a", &cpu]);
    Ok(())
}

/// Delay above which the loop was interrupted, ns.
/// No instruction of it takes that long.
const TAKEN_AWAY_NS: u64 = 1000;

/// The 99.9th percentile of the values below `limit_ns`, and the share above it.
fn kept_p999(all: &HistogramSnapshot, limit_ns: u64) -> (u64, f64) {
    let kept: u64 = all.buckets().filter(|b| b.low < limit_ns).map(|b| b.count).sum();
    let mut left = kept - kept / 1000;
    let at = all.buckets().find(|b| {
        let found = left <= b.count;
        left = left.saturating_sub(b.count);
        found
    });
    (at.map_or(0, |b| b.low), 1.0 - kept as f64 / all.samples().max(1) as f64)
}

/// A loop that only reads the clock, set up as the engine's thread.
/// Measures the gaps between two readings, and the delay after two waits of `separation_ns` one after the other. An
/// insertion waits like that; each wait ends at the first reading after it.
fn floor(
    wanted: RtSettings,
    time: Duration,
    separation_ns: u64,
) -> anyhow::Result<(HistogramSnapshot, HistogramSnapshot)> {
    let (mut gaps, gaps_reader) = histogram();
    let (mut late, late_reader) = histogram();
    let polling = std::thread::Builder::new().spawn(move || {
        let (_held, _) = apply(&SystemRoot::live(), wanted);
        let mut clock = Monotonic;
        let mut last_ns = clock.now_ns();
        let end_ns = last_ns + time.as_nanos() as u64;
        let (mut begun_ns, mut due_ns, mut second) = (last_ns, last_ns + separation_ns, false);
        while last_ns < end_ns {
            let now_ns = clock.now_ns();
            gaps.record(now_ns - last_ns);
            last_ns = now_ns;
            if now_ns >= due_ns {
                if second {
                    late.record(now_ns - begun_ns - 2 * separation_ns);
                    begun_ns = now_ns;
                }
                second = !second;
                due_ns = now_ns + separation_ns;
            }
        }
    })?;
    polling.join().map_err(|_| anyhow::anyhow!("the polling thread panicked"))?;
    Ok((gaps_reader.snapshot(), late_reader.snapshot()))
}

/// Another program's measurement of the same CPU, as it prints it.
fn other(program: &str, arguments: &[&str]) {
    println!("\n{program} {}", arguments.join(" "));
    match Command::new(program).args(arguments).output() {
        Ok(out) => print!("{}", String::from_utf8_lossy(&out.stdout)),
        Err(e) => println!("not there: {e} (Debian: rt-tests)"),
    }
}
