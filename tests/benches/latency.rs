//! Edge to done on a mapped card beside the machine's own floor, measured in the same minute.
//!
//! `cargo bench -p rtec-tests --bench latency [-- SECONDS]`. Prints, asserts nothing. The floor is an empty polling loop on the
//! same CPU and priority; `oslat` and `cyclictest` (Debian rt-tests) beside it where they are installed.

use rtec_driver::clock::{Clock, Monotonic};
use rtec_platform::selftest::{Backend, SelftestOptions, run};
use rtec_rt::histogram::{Snapshot, histogram};
use rtec_rt::setup::{System, Wanted, apply};
use std::process::Command;
use std::time::Duration;

fn main() -> anyhow::Result<()> {
    let seconds = std::env::args().skip(1).find_map(|a| a.parse::<u64>().ok()).unwrap_or(10);
    let cpu = System::live().default_cpu();
    let priority = 80;
    let options = SelftestOptions {
        cpu,
        priority,
        run: Duration::from_secs(3 * seconds),
        backend: Backend::Mapped,
        seed: 1,
    };
    let measured = run(options, |what, left_s| eprintln!("{what}, {left_s} s left"))?;
    eprintln!("floor, oslat and cyclictest, {seconds} s each");
    let floor = floor(Wanted { cpu, priority }, Duration::from_secs(seconds))?;

    println!("CPU {cpu}, priority {priority}, {seconds} s each, ns");
    for finding in measured.setup.findings.iter().filter(|f| !f.ok) {
        println!("  not as wanted: {} is {}", finding.name, finding.got);
    }
    println!(
        "  {:<34} {:>11} {:>8} {:>8} {:>8} {:>8} {:>10}",
        "", "samples", "min", "p50", "p99", "p99.9", "max"
    );
    let row = |name: &str, s: &Snapshot, less: u64| {
        let of = |ns: u64| ns.saturating_sub(less);
        let figures = [s.min(), s.p50(), s.p99(), s.p999()].map(of);
        let [min, p50, p99, p999] = figures;
        println!("  {name:<34} {:>11} {min:>8} {p50:>8} {p99:>8} {p999:>8} {:>10}", s.samples(), of(s.max()));
    };
    let separations_ns = measured.separations_ns();
    row("floor: gaps of an empty loop", &floor, 0);
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
    // What the machine itself allows: an insertion that meets such a gap is late, whatever the engine does.
    let long: u64 = floor.buckets().filter(|b| b.low >= 1000).map(|b| b.count).sum();
    let per_s = long as f64 / (floor.sum() as f64 / 1e9);
    let window_ns = quiet.seen_to_done.p50() as f64;
    println!(
        "  floor: {per_s:.0} gaps of 1 µs and more per second, so {:.3} % of insertions of {window_ns:.0} ns meet one",
        100.0 * per_s * window_ns / 1e9
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

/// Gaps between two readings of the clock in a loop that does nothing else, set up as the engine's thread.
fn floor(wanted: Wanted, time: Duration) -> anyhow::Result<Snapshot> {
    let (mut recorder, reader) = histogram();
    let polling = std::thread::Builder::new().spawn(move || {
        let (_held, _) = apply(&System::live(), wanted);
        let mut clock = Monotonic;
        let mut last_ns = clock.now_ns();
        let end_ns = last_ns + time.as_nanos() as u64;
        while last_ns < end_ns {
            let now_ns = clock.now_ns();
            recorder.record(now_ns - last_ns);
            last_ns = now_ns;
        }
    })?;
    polling.join().map_err(|_| anyhow::anyhow!("the polling thread panicked"))?;
    Ok(reader.snapshot())
}

/// Another program's view of the same CPU, as it prints it.
fn other(program: &str, arguments: &[&str]) {
    println!("\n{program} {}", arguments.join(" "));
    match Command::new(program).args(arguments).output() {
        Ok(out) => print!("{}", String::from_utf8_lossy(&out.stdout)),
        Err(e) => println!("not there: {e} (Debian: rt-tests)"),
    }
}
