//! `judge`: lets counters of other programs count a corrected trace.
//!
//! `cargo run --release -p rtec-tests --bin judge -- linuxcnc --scale in.csv --mtc out.csv --completed 40`

use anyhow::{Context, ensure};
use clap::{Parser, Subcommand};
use rtec_driver::quadrature::State;
use rtec_files::quadrature_trace::TraceReader;
use rtec_tests::judge::{LinuxCnc, Sigrok, Verdict};
use rtec_tests::ledger;
use std::path::PathBuf;
use std::time::Instant;

/// Let counters of other programs count a corrected trace
#[derive(Debug, Parser)]
struct Cli {
    #[command(subcommand)]
    judge: Judge,
}

#[derive(Debug, Subcommand)]
enum Judge {
    /// LinuxCNC's encoder component, at every state
    Linuxcnc(Traces),
    /// sigrok's graycode decoder, at every state (slow)
    Sigrok(Traces),
    /// TSC cycles of LinuxCNC's encoder.update-counters for three channels, as JSON
    Cycles,
}

#[derive(Debug, clap::Args)]
struct Traces {
    /// Trace of the scale
    #[arg(long)]
    scale: PathBuf,
    /// Trace at the MTC
    #[arg(long)]
    mtc: PathBuf,
    /// Counts that the corrector reports as completed
    #[arg(long, allow_negative_numbers = true)]
    completed: i64,
}

fn main() -> anyhow::Result<()> {
    match Cli::parse().judge {
        Judge::Linuxcnc(traces) => {
            let mut judge = LinuxCnc::new()?;
            let totals = traces.walk(|point, due| judge.show(point.state, due))?;
            let start = Instant::now();
            report("LinuxCNC", totals, judge.verdict()?, start)
        }
        Judge::Sigrok(traces) => {
            let mut judge = Sigrok::default();
            let start = Instant::now();
            let totals = traces.walk(|point, due| judge.show(point.state, due))?;
            report("sigrok", totals, judge.verdict()?, start)
        }
        Judge::Cycles => cycles(),
    }
}

impl Traces {
    fn walk(
        &self,
        each: impl FnMut(rtec_driver::trace_replay::TracePoint, i64) -> anyhow::Result<()>,
    ) -> anyhow::Result<ledger::Totals> {
        let (scale, mtc) = (TraceReader::open(&self.scale)?, TraceReader::open(&self.mtc)?);
        let totals = ledger::walk(scale, mtc, each).with_context(|| self.mtc.display().to_string())?;
        let (inserted, completed) = (totals.inserted, self.completed);
        ensure!(
            inserted == completed,
            "the trace holds {inserted} inserted counts, completed says {completed}"
        );
        Ok(totals)
    }
}

fn report(name: &str, totals: ledger::Totals, verdict: Verdict, start: Instant) -> anyhow::Result<()> {
    let seconds = start.elapsed().as_secs_f64();
    let (phases, fewest) = totals.phases_seen();
    println!(
        "{name}: {} states judged, {} wrong ({:.0} states/s); scale {:+}, inserted {:+} by {} inversions, insertions at {phases} of 16 \
         phases, {fewest} at least",
        verdict.judged,
        verdict.wrong,
        verdict.judged as f64 / seconds,
        totals.scale_counts,
        totals.inserted,
        totals.inversions,
    );
    ensure!(
        verdict.judged == totals.states,
        "only {} of {} states were judged",
        verdict.judged,
        totals.states
    );
    ensure!(verdict.wrong == 0, "{name} counts otherwise, first at {:?}", verdict.first_wrong);
    Ok(())
}

/// Measures LinuxCNC's counter with warm and with cold caches.
/// Called without a pause, everything is in the cache. Called once a millisecond, as in a servo thread, hardly anything
/// is.
fn cycles() -> anyhow::Result<()> {
    let mut document = serde_json::Map::new();
    for (name, period_ns, calls) in [("flat_out", 1000, 1_000_000), ("every_ms", 1_000_000, 3000)] {
        let mut judge = LinuxCnc::new()?;
        let mut state = State::default();
        for n in 0..calls {
            judge.show(state, 0)?;
            state = state.next(n % 64 < 40);
        }
        let cycles = judge.cycles(period_ns)?;
        document.insert(
            name.to_owned(),
            serde_json::json!({
                "channels": 3, "calls": cycles.calls, "period_ns": period_ns, "p50_cycles": cycles.p50,
                "p99_cycles": cycles.p99, "empty_p50_cycles": cycles.empty_p50,
            }),
        );
    }
    println!("{}", serde_json::json!({ "linuxcnc_update_counters": document }));
    Ok(())
}
