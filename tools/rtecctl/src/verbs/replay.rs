//! `rtecctl replay`: the real-time engine on a recorded trace, by a virtual clock.

use crate::prelude::*;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use rtec_control::config::Config;
use rtec_driver::quadrature::State;
use rtec_driver::trace_replay::{MtcSignalListener, TracePoint};
use rtec_files::clock_column;
use rtec_files::quadrature_trace::{
    AtomicTraceFile, RequestedTotalReader, TraceFormat, TraceReader, request_columns, trace_columns,
};
use rtec_rt::axis::AxisConfig;
use rtec_rt::link_messages::Fault;
use rtec_sim::engine_replay::{ReplayError, ReplayOutcome};
use rtec_sim::error_correction_circuit::PllFrequencyLimits;
use rtec_sim::insertion_design_bench::{InsertionDesign, replay_any};
use std::collections::BTreeSet;
use std::fs::File;
use std::io;
use std::time::{Duration, Instant};

/// Replay a recorded trace through the real-time engine and print what the MTC would have counted
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// What the scale gave (.csv: `t_ns,a,b`; .vcd: IEEE 1364, signals a and b)
    #[arg(long, value_name = "FILE")]
    trace: PathBuf,
    /// Requested totals (CSV: `t_ns,requested`)
    #[arg(long, value_name = "FILE")]
    requests: PathBuf,
    /// Columns or signals of the trace that have other names, or none, each by its name or number from 1; `t_us`, `t_ms` and
    /// `t_s` for times that are not in ns
    #[arg(long, value_name = "NAME=COLUMN", value_delimiter = ',')]
    columns: Vec<String>,
    /// Columns of the requests that have other names, or none: as --columns, with `requested` for the total
    #[arg(long, value_name = "NAME=COLUMN", value_delimiter = ',')]
    request_columns: Vec<String>,
    /// Insertion design
    #[arg(long, default_value = "c", value_parser = designs())]
    design: InsertionDesign,
    /// Take the axis and its belief window from this configuration; without it: 1 µm counts, 500 ns separation,
    /// 1e6 counts/s², ±1000 counts, requests believed whatever their size
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// The configuration's axis [default: the first]
    #[arg(long, value_name = "NAME", requires = "config")]
    axis: Option<String>,
    /// Write what the MTC sees (.csv)
    #[arg(long, value_name = "FILE", value_parser = crate::verbs::output())]
    out: Option<PathBuf>,
    /// Write what the MTC sees (.vcd)
    #[arg(long, value_name = "FILE", value_parser = crate::verbs::output())]
    vcd: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

impl Args {
    fn open(&self) -> Result<(TraceReader<File>, RequestedTotalReader<File>), InputError> {
        let trace = TraceReader::open_columns(&self.trace, &trace_columns(&self.columns)?)?;
        let columns = request_columns(&self.request_columns)
            .map_err(|e| InputError { file: Path::new("--request-columns").to_owned(), ..e })?;
        let requests = RequestedTotalReader::open_beside(&self.requests, &columns, &trace)?;
        Ok((trace, requests))
    }
}

/// The designs by their names in the contract.
fn designs() -> impl TypedValueParser<Value = InsertionDesign> {
    PossibleValuesParser::new(InsertionDesign::ALL.map(InsertionDesign::name))
        .try_map(|name| InsertionDesign::parse(&name).ok_or("no such design"))
}

/// Warns if only one of trace and requests counts Unix time.
fn two_clocks(args: &Args) -> anyhow::Result<()> {
    // A pipe cannot be read twice.
    if !(args.trace.is_file() && args.requests.is_file()) {
        return Ok(());
    }
    let (mut trace, mut requests) = args.open()?;
    let first = trace.next_point()?.map(|point| point.t_ns);
    // A total of 0 at time 0 may come first with any clock.
    let last = requests.by_ref().last().transpose()?.map(|request| request.t_ns);
    for said in [trace.notes(), requests.notes()].into_iter().flatten() {
        eprintln!("note: {said}");
    }
    let Some((first, last)) = first.zip(last) else { return Ok(()) };
    let day = |t_ns: u64| match clock_column::unix(t_ns as f64) {
        Some(("ns", day)) => Some(day),
        _ => None,
    };
    let said = |day: Option<String>| day.map_or(String::new(), |day| format!(" (Unix time, {day})"));
    if day(first).is_some() != day(last).is_some() {
        let [of_trace, of_requests] = [first, last].map(|t_ns| said(day(t_ns)));
        eprintln!(
            "warning: the trace begins at {first} ns{of_trace}, the requests end at {last} ns{of_requests}: they are not on one clock"
        );
    }
    Ok(())
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let (config, large) = axis(args)?;
    let design = args.design;
    let (trace, requests) = args.open()?;
    for written in [trace.written(), requests.written()].into_iter().flatten() {
        eprintln!("note: {written}");
    }
    two_clocks(args)?;
    let trace = trace.playable();
    let mut files = Vec::new();
    for (file, format) in [(&args.out, TraceFormat::Csv), (&args.vcd, TraceFormat::Vcd)] {
        if let Some(file) = file {
            if TraceFormat::of(file)? != format {
                let expected = if format == TraceFormat::Csv { "--out FILE.csv" } else { "--vcd FILE.vcd" };
                let found = format!("the name {}", file.display());
                return Err(InputError::whole(file, found, expected).into());
            }
            files.push((AtomicTraceFile::create(file)?, file.as_path()));
        }
    }
    let shown_at = Instant::now();
    let mut trace = TraceWithProgress {
        trace,
        points: 0,
        shown_at,
        last: None,
        alone: [(0, 0); 2],
        longest: [(0, 0); 2],
    };
    // Without an output file there is no listener, and the compiler removes that branch from the loop.
    let outcome = if files.is_empty() {
        replay_any(design, config, trace.by_ref(), requests, large, |_, _: State| {})
            .map(|(outcome, _)| outcome)
    } else {
        let to = CorrectedTraceFiles { files, failed: None };
        match replay_any(design, config, trace.by_ref(), requests, large, to) {
            Ok((outcome, to)) => to.finish().map(|()| Ok(outcome))?,
            Err(error) => Err(error),
        }
    };
    if let Some(sampled) = trace.trace.sampled() {
        eprintln!("note: {sampled}");
    }
    let mut outcome = outcome.map_err(|error| match error {
        ReplayError::Input(error) => error,
        ReplayError::Start(error) => {
            let file = args.config.as_deref().unwrap_or(Path::new("the default axis"));
            InputError::whole(file, error.to_string(), "an axis that can be corrected")
        }
    })?;
    let latched = outcome.faults.iter().find(|latched| latched.fault == Fault::ChannelDead);
    let dead = latched.map(|latched| (latched.t_ns, trace.dead()));
    outcome.dead_channel = dead.as_ref().map(|(_, (channel, _))| *channel);
    if args.json {
        say_line(&outcome)?;
    } else {
        print(&outcome);
    }
    if let Some((t_ns, (_, said))) = dead {
        let axis = args.axis.as_ref().map_or_else(String::new, |axis| format!(" of axis {axis}"));
        let fault = word(Fault::ChannelDead);
        fail!(Fault, "{fault} latched at {t_ns} ns{axis}: {said}: a broken wire or receiver of it");
    }
    // The more informative answer first: a latched fault explains a ledger that does not balance.
    if let Some(latched) = outcome.faults.first() {
        fail!(Fault, "{} latched at {} ns", word(latched.fault), latched.t_ns);
    }
    let ReplayOutcome { counts_out, counts_in, completed, illegal_out, .. } = outcome;
    if !outcome.balanced() || illegal_out > 0 {
        let sums = format!("{counts_out} counts out - {counts_in} in, {completed} completed");
        fail!(No, "the ledger does not balance: {sums}, {illegal_out} illegal transitions at the MTC");
    }
    let open = outcome.requested - outcome.completed;
    if design == InsertionDesign::Ecc && open.abs() >= InsertionDesign::Ecc.increment_counts() {
        eprintln!(
            "warning: {open:+} of the requested {:+} counts were not made: the circuit {}, twice the encoder's frequency. It adds only what \
             is done before the axis can leave the clean range; let the axis move at such a speed for longer, or take another design",
            outcome.requested,
            PllFrequencyLimits::default()
        );
    }
    if outcome.requests > 0 && outcome.refused.len() as u64 == outcome.requests {
        let why = list(outcome.refused.iter().map(|r| word(r.why)).collect::<BTreeSet<_>>());
        fail!(No, "nothing was corrected: every request was refused ({why})");
    }
    Ok(())
}

/// The axis to replay, and whether its requests are flagged large.
fn axis(args: &Args) -> anyhow::Result<(AxisConfig, bool)> {
    let Some(file) = &args.config else { return Ok((AxisConfig::default(), true)) };
    Ok((Config::load(file)?.replayed_axis(file, args.axis.as_deref())?, false))
}

/// A trace that reports its progress every two seconds.
struct TraceWithProgress {
    trace: TraceReader<std::fs::File>,
    points: u64,
    shown_at: Instant,
    last: Option<State>,
    /// Changes of A, and of B, since the other's last change, and its time, ns.
    alone: [(u64, u64); 2],
    longest: [(u64, u64); 2],
}

impl TraceWithProgress {
    #[inline]
    fn see(&mut self, point: TracePoint) {
        let Some(last) = self.last.replace(point.state) else {
            self.alone = [(0, point.t_ns); 2];
            return;
        };
        for (n, changed) in [last.a() != point.state.a(), last.b() != point.state.b()].into_iter().enumerate()
        {
            if changed {
                self.alone[n].0 += 1;
                if self.alone[n].0 > self.longest[n].0 {
                    self.longest[n] = self.alone[n];
                }
                self.alone[1 - n] = (0, point.t_ns);
            }
        }
    }

    /// The channel that does not change while the other does.
    fn dead(&self) -> (&'static str, String) {
        let moving = usize::from(self.longest[1].0 > self.longest[0].0);
        let (times, since_ns) = self.longest[moving];
        let [alive, dead] = [["A", "B"][moving], ["A", "B"][1 - moving]];
        let said = format!("{dead} does not change after {since_ns} ns while {alive} changes {times} times");
        (["a", "b"][1 - moving], said)
    }
}

impl Iterator for TraceWithProgress {
    type Item = Result<TracePoint, InputError>;

    #[inline]
    fn next(&mut self) -> Option<Self::Item> {
        let point = self.trace.next();
        if let Some(Ok(point)) = &point {
            self.see(*point);
        }
        self.points += 1;
        if self.points.is_multiple_of(1 << 22) && self.shown_at.elapsed() > Duration::from_secs(2) {
            self.shown_at = Instant::now();
            eprintln!("{} million edges", self.points / 1_000_000);
        }
        point
    }
}

/// The files for A' and B', and the first failure to write one.
struct CorrectedTraceFiles<'a> {
    files: Vec<(AtomicTraceFile, &'a Path)>,
    failed: Option<io::Error>,
}

impl MtcSignalListener for CorrectedTraceFiles<'_> {
    #[inline]
    fn changed(&mut self, t_ns: u64, state: State) {
        for (file, _) in &mut self.files {
            if let Err(error) = file.write(TracePoint { t_ns, state })
                && self.failed.is_none()
            {
                self.failed = Some(error);
            }
        }
    }
}

impl CorrectedTraceFiles<'_> {
    fn finish(self) -> anyhow::Result<()> {
        if let Some(error) = self.failed {
            return Err(error).context("writing what the MTC sees; nothing is left behind");
        }
        for (file, path) in self.files {
            file.finish().with_context(|| format!("writing {}", path.display()))?;
        }
        Ok(())
    }
}

/// A name of the JSON document, with blanks.
fn word(name: impl serde::Serialize) -> String {
    let value = serde_json::to_value(name).unwrap_or_default();
    value.as_str().map_or_else(|| value.to_string(), |s| s.replace('_', " "))
}

fn print(outcome: &ReplayOutcome) {
    let closest = outcome.min_edge_separation_ns.map_or_else(|| "-".to_owned(), |ns| format!("{ns} ns"));
    let rows = [
        ("edges", outcome.edges.to_string()),
        ("counts of the scale", format!("{:+}", outcome.counts_in)),
        ("counts at the MTC", format!("{:+}", outcome.counts_out)),
        ("requested", format!("{:+}", outcome.requested)),
        ("completed", format!("{:+}", outcome.completed)),
        ("insertions", outcome.insertions.to_string()),
        ("edges too fast for one", outcome.waited_for_gate.to_string()),
        ("edges inside one", outcome.overlaps.to_string()),
        ("illegal, from the scale", outcome.illegal_in.to_string()),
        ("illegal, at the MTC", outcome.illegal_out.to_string()),
        ("closest edges at the MTC", closest),
        ("ledger", if outcome.balanced() { "balances" } else { "DOES NOT BALANCE" }.to_owned()),
    ];
    for (name, value) in rows {
        println!("{name:<26} {value:>20}");
    }
    for refused in &outcome.refused {
        println!("refused  {:>14} ns  {:+} counts: {}", refused.t_ns, refused.requested, word(refused.why));
    }
    for latched in &outcome.faults {
        println!("FAULT    {:>14} ns  {}", latched.t_ns, word(latched.fault));
    }
}
