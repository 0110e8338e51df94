//! `rtecctl selftest latency`: how late this machine can be, and what that leaves for corrections.

use crate::Outcome;
use crate::document::line;
use crate::say;
use crate::verbs::card::{alone, confirm, unreachable};
use anyhow::Context;
use rtec_control::card::{self, Access, OnCard};
use rtec_control::config::{CardConfig, Config, ConfiguredAxis, Measured as Provenance, floors_ns};
use rtec_control::protocol::{Rates, explain_fault, word};
use rtec_files::InputError;
use rtec_platform::selftest::{
    Backend, FarSide, Latency, Measured, MeasuredOn, SelftestError, SelftestOptions, WAKEUP_INTERVAL_NS,
    run as measure, run_on_card,
};
use rtec_rt::axis::AxisConfig;
use rtec_rt::histogram::Snapshot;
use rtec_rt::setup::System;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Rows of the text's histogram, 1 µs each: as many as the plotting scripts of the field ask cyclictest for.
const ROWS: usize = 400;

/// Test this machine
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    test: Test,
}

#[derive(Debug, clap::Subcommand)]
enum Test {
    Latency(LatencyArgs),
}

/// Measure wake-up, poll gap and edge-to-done latency with the real engine; exit 1 when they do not allow corrections
///
/// The text is shaped like cyclictest's: thread 0 is the wake-up, thread 1 the poll gap, thread 2 edge to done.
#[derive(Debug, clap::Args)]
struct LatencyArgs {
    /// How long: a third each for the wake-ups, the polling loop, and the polling loop with requests streaming in
    #[arg(long, value_name = "TIME", default_value = "10s", value_parser = duration)]
    duration: Duration,
    /// Measure the card of this configuration, with its axes, CPU and priority: reads with the outputs held. The daemon must
    /// be stopped. Without it: a simulated card, one axis of 1e6 counts/s², 500 ns separation
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// The CPU of the real-time thread [default: the configuration's, else the first isolated, else the last one]
    #[arg(long, value_name = "N")]
    cpu: Option<usize>,
    /// The `SCHED_FIFO` priority of the real-time thread [default: the configuration's, else 80]
    #[arg(long, value_name = "P", value_parser = clap::value_parser!(u8).range(1..=99))]
    priority: Option<u8>,
    /// The backend that the configuration must have; without a configuration a simulated card: registers in shared memory
    /// (`mapped`, the default) or wires in the process (`mock`)
    #[arg(long, value_enum)]
    backend: Option<Card>,
    /// Measure the writes too: every axis's inverters are switched, again and again. THE MTC MUST BE OFF: its axes would move
    #[arg(long, requires = "config")]
    drive: bool,
    /// The MTC is off: do not ask
    #[arg(long, requires = "drive")]
    mtc_is_off: bool,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
    /// Write the histogram, as cyclictest's --histfile does, to F and not to standard output
    #[arg(long, value_name = "F", value_parser = crate::verbs::output())]
    histfile: Option<PathBuf>,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Card {
    Mock,
    Mapped,
    Gpio,
    Port,
}

impl Card {
    const fn name(self) -> &'static str {
        match self {
            Self::Mock => "mock",
            Self::Mapped => "mapped",
            Self::Gpio => "gpio",
            Self::Port => "port",
        }
    }
}

/// What is measured.
enum Target {
    /// A card of the test's own.
    Simulated(Backend),
    /// The configuration's.
    Configured(Box<Config>),
}

/// The self-test on a card, whichever it is.
struct CardTest<'a> {
    options: SelftestOptions,
    axes: &'a [AxisConfig],
    drive: bool,
}

/// What formats.md calls the self-test's document, and what else is worth knowing.
#[derive(Serialize)]
struct Document<'a> {
    wakeup_ns: &'a Latency,
    poll_gap_ns: &'a Latency,
    edge_to_done_ns: &'a Latency,
    /// The engine's own part of it: from the look that saw the edge to the look that ordered the second inversion.
    seen_to_done_ns: &'a Snapshot,
    /// The same three while requests stream in as fast as the link takes them.
    poll_gap_with_requests_ns: &'a Latency,
    edge_to_done_with_requests_ns: &'a Latency,
    seen_to_done_with_requests_ns: &'a Snapshot,
    /// Number of requests that streamed in.
    requests: u64,
    /// Per axis, from the worst that was seen.
    /// Null where that leaves no time for an insertion at any speed.
    max_safe_edge_rate_hz: BTreeMap<&'a str, Option<f64>>,
    /// The same but for one look in ten thousand.
    edge_rate_at_p9999_hz: BTreeMap<&'a str, Option<f64>>,
    /// The same as speeds, mm/min, and up to where every count is seen.
    rates: BTreeMap<&'a str, Rates>,
    /// What belongs into `[rt]` of the configuration.
    rt: RtKeys<'a>,
    backend: &'static str,
    /// What was measured with.
    card: &'a str,
    /// How: `simulated`, `reads` (outputs held), `reads_and_writes`.
    how: MeasuredOn,
    verdict: &'static str,
    reason: String,
    separations_ns: u64,
    duration_s: f64,
    cpu: usize,
    priority: u8,
    emulated: Option<&'a str>,
    ledger_balanced: bool,
    poll_gap_faults: u64,
    far_side: Option<FarSide>,
    missing_to_arm: Vec<&'static str>,
}

#[derive(Serialize)]
struct RtKeys<'a> {
    detect_ns: u64,
    /// None where no write was measured.
    write_ns: Option<u64>,
    measured: &'a Provenance,
}

/// An axis and the highest edge rates at which an insertion still has time: from the worst latency that was seen, and
/// from all but one in ten thousand. `None` where there is no such rate.
struct AxisRate {
    name: String,
    safe_hz: Option<f64>,
    usual_hz: Option<f64>,
    rates: Rates,
    /// Its rapid outruns the card.
    outruns: Option<String>,
}

fn duration(text: &str) -> Result<Duration, String> {
    let time = humantime::parse_duration(text).map_err(|e| format!("{e}; write 10s, 2m or 1h"))?;
    if time < Duration::from_millis(100) { Err("at least 100ms".into()) } else { Ok(time) }
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let Test::Latency(args) = &args.test;
    let target = target(args)?;
    let config = match &target {
        Target::Simulated(_) => args.config.as_deref().map(Config::load).transpose()?,
        Target::Configured(config) => Some((**config).clone()),
    };
    let rt = config.as_ref().map(|c| &c.rt);
    let options = SelftestOptions {
        cpu: args.cpu.or(rt.and_then(|rt| rt.cpu)).unwrap_or_else(|| System::live().default_cpu()),
        priority: args.priority.or(rt.map(|rt| rt.priority)).unwrap_or(80),
        run: args.duration,
        seed: 1,
    };
    let histfile = args.histfile.as_deref().map(AtomicFile::create).transpose()?;
    let progress = |what: &str, left_s: u64| eprintln!("selftest: {what}, {left_s} s left");
    let mut provenance = Provenance::here(&CardConfig::Mock, options.cpu, &System::live());
    let measured = match &target {
        Target::Simulated(backend) => {
            let card = if *backend == Backend::Mock {
                "wires in this process"
            } else {
                "registers in shared memory"
            };
            provenance.card = format!("simulated: {card}");
            measure(options, *backend, progress).context("measuring latencies")?
        }
        Target::Configured(config) => {
            provenance.card = config.card.named();
            let _alone = alone(config)?;
            if args.drive && !args.mtc_is_off {
                confirm("every inverter of this card is switched on and off again, for a third of the time")?;
            }
            eprintln!("selftest: card {}", provenance.card);
            let access = if args.drive { Access::Drive } else { Access::Read };
            let test = CardTest { options, axes: &config.engine_axes(), drive: args.drive };
            card::with(&config.card, access, test).map_err(unreachable)??
        }
    };
    let axes = match &config {
        Some(config) => config.axes.clone(),
        None => Config::embedded().axes.iter().take(1).map(default_axis).collect(),
    };
    let floors = match &target {
        Target::Simulated(_) => None,
        Target::Configured(config) => floors_ns(&config.card),
    };
    let rates: Vec<AxisRate> = axes.into_iter().map(|axis| axis_rate(axis, &measured)).collect();
    let reasons = reasons(&measured, &rates, floors);
    if let Some(histfile) = histfile {
        histfile
            .finish(&format!("{}# Card: {}\n", histogram(&measured), provenance.card))
            .context("writing the histogram file")?;
    }
    if args.json {
        let document = Document {
            wakeup_ns: &measured.wakeup,
            poll_gap_ns: &measured.quiet.poll_gap,
            edge_to_done_ns: &measured.quiet.edge_to_done,
            seen_to_done_ns: &measured.quiet.seen_to_done,
            poll_gap_with_requests_ns: &measured.with_requests.poll_gap,
            edge_to_done_with_requests_ns: &measured.with_requests.edge_to_done,
            seen_to_done_with_requests_ns: &measured.with_requests.seen_to_done,
            requests: measured.with_requests.requests,
            max_safe_edge_rate_hz: rates.iter().map(|r| (r.name.as_str(), r.safe_hz)).collect(),
            edge_rate_at_p9999_hz: rates.iter().map(|r| (r.name.as_str(), r.usual_hz)).collect(),
            rates: rates.iter().map(|r| (r.name.as_str(), r.rates)).collect(),
            rt: RtKeys {
                detect_ns: measured.detect_ns().0,
                write_ns: measured.timed().then(|| measured.write_ns()),
                measured: &provenance,
            },
            backend: match &target {
                Target::Simulated(Backend::Mock) => "mock",
                Target::Simulated(Backend::Mapped) => "mapped",
                Target::Configured(config) => config.card.backend(),
            },
            card: &provenance.card,
            how: measured.how,
            verdict: if reasons.is_empty() { "pass" } else { "fail" },
            reason: reasons.join("; "),
            separations_ns: measured.separations_ns(),
            duration_s: args.duration.as_secs_f64(),
            cpu: options.cpu,
            priority: options.priority,
            emulated: measured.setup.emulated.as_deref(),
            ledger_balanced: measured.balanced(),
            poll_gap_faults: measured.faults(),
            far_side: measured.far(),
            missing_to_arm: measured.setup.missing().map(|f| f.name).collect(),
        };
        say(&line(&document)?);
    } else {
        // As cyclictest: what goes into a file is not on the terminal, too.
        print!("{}", text(&measured, &options, &rates, &reasons, &provenance, args.histfile.is_none()));
    }
    if reasons.is_empty() { Ok(()) } else { Err(Outcome::No(reasons.join("; ")).into()) }
}

impl OnCard for CardTest<'_> {
    type Output = Result<Measured, SelftestError>;

    fn on<C: rtec_driver::card::Card + Send + 'static>(self, card: C) -> Self::Output {
        let progress = |what: &str, left_s: u64| eprintln!("selftest: {what}, {left_s} s left");
        run_on_card(self.options, card, self.axes, self.drive, progress)
    }
}

/// What is to be measured; refused where that cannot be.
fn target(args: &LatencyArgs) -> anyhow::Result<Target> {
    let bad = |text: String| anyhow::Error::from(Outcome::Bad(text));
    let Some(file) = &args.config else {
        return match args.backend {
            None | Some(Card::Mapped) => Ok(Target::Simulated(Backend::Mapped)),
            Some(Card::Mock) => Ok(Target::Simulated(Backend::Mock)),
            Some(card) => Err(bad(format!(
                "--backend {} needs --config FILE: which card of this backend is to be measured stands there",
                card.name()
            ))),
        };
    };
    let config = Config::load(file)?;
    let configured = config.card.backend();
    if let Some(asked) = args.backend.filter(|card| card.name() != configured) {
        return Err(bad(format!(
            "{} has card {}, and --backend {} asks for another: leave --backend out",
            file.display(),
            config.card.named(),
            asked.name()
        )));
    }
    match &config.card {
        CardConfig::Replay { .. } => {
            Err(bad("a recording has no latency: [card] backend = \"replay\" cannot be measured".to_owned()))
        }
        CardConfig::Mock if args.drive => {
            Err(bad("a mock card has no outputs outside the process: leave --drive out".to_owned()))
        }
        CardConfig::Mock => Ok(Target::Simulated(Backend::Mock)),
        _ => Ok(Target::Configured(Box::new(config))),
    }
}

/// The axis of a test without a configuration: 1 µm a count, the replay's limits.
fn default_axis(axis: &ConfiguredAxis) -> ConfiguredAxis {
    ConfiguredAxis {
        name: "default".to_owned(),
        count_um: 1.0,
        engine: AxisConfig::default(),
        rapid_mm_min: None,
        ..axis.clone()
    }
}

/// What the measured latency leaves an axis.
fn axis_rate(axis: ConfiguredAxis, measured: &Measured) -> AxisRate {
    let (worst, usual) = measured.detect_ns();
    let (safe_hz, usual_hz) =
        (edge_rate_hz(axis.engine, measured, worst), edge_rate_hz(axis.engine, measured, usual));
    let mut as_measured = axis;
    (as_measured.engine.detect_ns, as_measured.engine.write_ns) = (worst, measured.write_ns());
    let rates = Rates { corrected_mm_min: safe_hz.map(|hz| as_measured.mm_min(hz)), ..as_measured.rates() };
    AxisRate { outruns: as_measured.outruns(), name: as_measured.name, safe_hz, usual_hz, rates }
}

/// The highest edge rate at which an insertion still has time on an axis, with this machine's latency.
fn edge_rate_hz(axis: AxisConfig, measured: &Measured, detect_ns: u64) -> Option<f64> {
    if !measured.timed() {
        return None; // nothing is known
    }
    let axis = AxisConfig { detect_ns, write_ns: measured.write_ns(), ..axis };
    axis.gate().map(|gate| 1e9 / gate.min_period_ns() as f64)
}

/// The findings that forbid corrections on this machine.
fn reasons(measured: &Measured, rates: &[AxisRate], floors: Option<(u64, u64, &'static str)>) -> Vec<String> {
    let mut reasons = Vec::new();
    if let Some(emulator) = &measured.setup.emulated {
        reasons.push(format!("emulated by {emulator}: emulated time is no evidence for any machine"));
    }
    reasons.extend(measured.setup.missing().map(|f| {
        let errno = f.errno.as_ref().map(|e| format!(" ({e})")).unwrap_or_default();
        format!("{} is {}, wanted {}{errno}: {}", f.name, f.got, f.wanted, f.remedy)
    }));
    if let MeasuredOn::ReadsAndWrites { ended_by, restored } = measured.how {
        reasons.extend(ended_by.map(|fault| {
            format!("{} was latched while the card was written to: {}", word(fault), explain_fault(fault))
        }));
        if !restored {
            reasons.push(
                "the outputs are not as they were found: switch the card off before the MTC is switched on"
                    .into(),
            );
        }
    }
    if measured.how != MeasuredOn::Simulated && !measured.looked() {
        let why = if measured.quiet.poll_gap.tid == 0 {
            "a polling loop needs a second CPU"
        } else {
            "a card that sleeps until an edge comes is measured by its edges, and none came: with the drives off push an axis \
             by hand while the test runs"
        };
        reasons.push(format!("reads were not measured: {why}"));
        return reasons;
    }
    if !measured.timed() {
        let why = match measured.how {
            MeasuredOn::Reads => {
                "reads only: writes were not measured, so this never passes; with the MTC off, --drive measures them"
            }
            MeasuredOn::ReadsAndWrites { .. } => "writes were not measured: no insertion was made",
            MeasuredOn::Simulated if measured.far().is_some() => {
                "edge to done was not measured: no insertion was seen"
            }
            MeasuredOn::Simulated => "edge to done was not measured: a polling loop needs a second CPU",
        };
        reasons.push(why.to_owned());
        reasons.extend(rates.iter().filter_map(|axis| axis.outruns.clone()));
        return reasons;
    }
    if !measured.balanced() {
        reasons.push("the ledger does not balance".into());
    }
    if let Some((detect_ns, write_ns, why)) = floors
        && (measured.detect_ns().0 < detect_ns || measured.write_ns() < write_ns)
    {
        reasons.push(format!(
            "detect_ns = {} and write_ns = {} are less than such a card takes ({detect_ns} and {write_ns}): {why}. Is this the \
             card?",
            measured.detect_ns().0,
            measured.write_ns()
        ));
    }
    reasons.extend(rates.iter().filter_map(|axis| axis.outruns.clone()));
    for axis in rates.iter().filter(|axis| axis.safe_hz.is_none()) {
        let (worst_us, usual_us) = (measured.detect_ns().0 as f64 / 1e3, measured.detect_ns().1 as f64 / 1e3);
        let usual = axis.usual_hz.map_or_else(String::new, |hz| {
            format!(" (the {usual_us:.1} µs that 99.99 % keep to would do, up to {hz:.0} edges/s)")
        });
        let name = &axis.name;
        reasons.push(format!(
            "the longest delay, {worst_us:.1} µs, leaves axis {name} no time for an insertion at any speed{usual}"
        ));
    }
    reasons
}

fn threads(measured: &Measured) -> [&Latency; 3] {
    [&measured.wakeup, &measured.quiet.poll_gap, &measured.quiet.edge_to_done]
}

fn text(
    measured: &Measured,
    options: &SelftestOptions,
    rates: &[AxisRate],
    reasons: &[String],
    provenance: &Provenance,
    with_histogram: bool,
) -> String {
    let mut out = String::new();
    let mut line = |text: std::fmt::Arguments| {
        let _ = writeln!(out, "{text}"); // a String takes everything
    };
    if measured.setup.finding("cpu_dma_latency").is_some_and(|f| f.ok) {
        line(format_args!("# /dev/cpu_dma_latency set to 0us"));
    }
    let fifo = measured.setup.finding("scheduler").is_some_and(|f| f.ok);
    for (n, thread) in threads(measured).into_iter().enumerate() {
        let ns = &thread.ns;
        line(format_args!(
            "T:{n:2} ({:5}) P:{:2} I:{} C:{:7} Min:{:7} Act:{:5} Avg:{:5} Max:{:8}",
            thread.tid,
            if fifo && n < 2 { options.priority } else { 0 },
            if n == 0 { WAKEUP_INTERVAL_NS / 1000 } else { 0 },
            ns.samples(),
            ns.min() / 1000,
            thread.last_ns / 1000,
            ns.mean() as u64 / 1000,
            ns.max() / 1000,
        ));
    }
    if with_histogram {
        line(format_args!("{}", histogram(measured).trim_end()));
    }
    line(format_args!("{}", table(measured).trim_end()));
    line(format_args!("# Card: {}", provenance.card));
    match measured.how {
        MeasuredOn::Simulated => line(format_args!(
            "# Edge to done contains {} ns that the MTC is given: {} after the edge, as much between the inversions.",
            measured.separations_ns(),
            measured.axis.min_separation_ns
        )),
        MeasuredOn::Reads => {
            line(format_args!("# Reads alone were measured; every output was held as it was."));
        }
        MeasuredOn::ReadsAndWrites { .. } => line(format_args!(
            "# {} insertions at rest; each contains {} ns that the MTC is given between the inversions.",
            measured.with_requests.insertions,
            measured.separations_ns()
        )),
    }
    if let Some(far) = measured.far() {
        line(format_args!(
            "# Far side: {} edges, {} without insertion, {} untimed; MTC minus scale {}, completed {}; {} poll gap faults.",
            far.edges,
            far.without_insertion,
            far.unresolved,
            far.mtc_minus_scale,
            measured.completed(),
            measured.faults()
        ));
    }
    let rate = |hz: Option<f64>| hz.map_or_else(|| "none".into(), |hz| format!("{hz:.0}"));
    for axis in rates.iter().filter(|_| measured.timed()) {
        line(format_args!(
            "# Max Safe Edge Rate, axis {}: {} edges/s from the worst seen, {} from 99.99 %",
            axis.name,
            rate(axis.safe_hz),
            rate(axis.usual_hz)
        ));
    }
    for axis in rates.iter().filter(|_| !measured.timed()) {
        line(format_args!("# Max Safe Edge Rate, axis {}: not measured", axis.name));
    }
    let uncorrected = if measured.timed() { "corrected at no speed" } else { "corrected: not measured" };
    for axis in rates {
        line(format_args!("# Axis {}: {}", axis.name, axis.rates.told(uncorrected)));
    }
    if measured.timed() {
        line(format_args!("# For the configuration, below [rt], these three lines:"));
        line(format_args!("detect_ns = {}", measured.detect_ns().0));
        line(format_args!("write_ns = {}", measured.write_ns()));
        line(format_args!("{provenance}"));
    }
    if reasons.is_empty() {
        line(format_args!("# Verdict: pass"));
    } else {
        line(format_args!("# Verdict: fail"));
        for reason in reasons {
            line(format_args!("#   {reason}"));
        }
    }
    out
}

/// All distributions in ns.
fn table(measured: &Measured) -> String {
    let mut out = String::from(
        "#\n# in ns              samples      min      p50      p99    p99.9   p99.99         max\n",
    );
    let mut row = |name: &str, s: &Snapshot| {
        let _ = writeln!(
            out,
            "# {name:<15} {:>11} {:>8} {:>8} {:>8} {:>8} {:>8} {:>11}",
            s.samples(),
            s.min(),
            s.p50(),
            s.p99(),
            s.p999(),
            s.p9999(),
            s.max()
        );
    };
    let (quiet, with_requests) = (&measured.quiet, &measured.with_requests);
    row("T0 wake-up", &measured.wakeup.ns);
    row("T1 poll gap", &quiet.poll_gap.ns);
    if measured.how != MeasuredOn::Simulated {
        row("   w. writes", &with_requests.poll_gap.ns);
        row("   insertions", &with_requests.seen_to_done);
        return out;
    }
    row("   w. requests", &with_requests.poll_gap.ns);
    row("T2 edge to done", &quiet.edge_to_done.ns);
    row("   w. requests", &with_requests.edge_to_done.ns);
    row("   seen to done", &quiet.seen_to_done);
    row("   w. requests", &with_requests.seen_to_done);
    let _ = writeln!(
        out,
        "# w. requests: {} came in, as fast as the link took them. Below, the worse of the two.",
        with_requests.requests
    );
    out
}

/// The part between `# Histogram` and the overflows, shaped as cyclictest -h prints it.
fn histogram(measured: &Measured) -> String {
    let threads = threads(measured);
    let linear = threads.map(|t| t.ns.linear(1000, ROWS));
    let joined = |values: [String; 3], by: &str| values.join(by);
    let mut out = String::from("# Histogram\n");
    for row in 0..ROWS {
        let counts = [0, 1, 2].map(|t: usize| format!("{:06}", linear[t].0[row]));
        let _ = writeln!(out, "{row:06} {}", joined(counts, "\t"));
    }
    let totals = [0, 1, 2].map(|t: usize| format!("{:09}", threads[t].ns.samples() - linear[t].1));
    let of = |f: fn(&Snapshot) -> u64| joined(threads.map(|t| format!("{:05}", f(&t.ns))), " ");
    let _ = writeln!(out, "# Total: {}", joined(totals, " "));
    let _ = writeln!(out, "# Min Latencies: {}", of(|s| s.min() / 1000));
    let _ = writeln!(out, "# Avg Latencies: {}", of(|s| s.mean() as u64 / 1000));
    let _ = writeln!(out, "# Max Latencies: {}", of(|s| s.max() / 1000));
    let overflows = [0, 1, 2].map(|t: usize| format!("{:05}", linear[t].1));
    let _ = writeln!(out, "# Histogram Overflows: {}", joined(overflows, " "));
    out
}

/// A file that appears under its name only when it is whole.
/// Made before the measurement: a place that cannot be written to is known at once.
struct AtomicFile<'a> {
    file: &'a Path,
    temporary: tempfile::NamedTempFile,
}

impl<'a> AtomicFile<'a> {
    fn create(file: &'a Path) -> Result<Self, InputError> {
        let directory = file.parent().filter(|d| !d.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let mut builder = tempfile::Builder::new();
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666)); // less the umask, as any file
        let temporary = builder.prefix(".rtec-histogram-").tempfile_in(directory);
        let unwritable =
            |e: std::io::Error| InputError::whole(file, e.to_string(), "a place that can be written to");
        Ok(Self { file, temporary: temporary.map_err(unwritable)? })
    }

    fn finish(mut self, text: &str) -> std::io::Result<()> {
        self.temporary.write_all(text.as_bytes())?;
        self.temporary.persist(self.file).map_err(|e| e.error)?;
        Ok(())
    }
}
