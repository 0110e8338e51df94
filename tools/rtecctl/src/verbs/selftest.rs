//! `rtecctl selftest latency`: measures this computer's latencies.
//! It shows the speeds at which they allow corrections.

use crate::prelude::*;
use crate::verbs::card::{confirm, lock_out_daemon, unreachable};
use rtec_control::card_opening::{self, CardAccess, CardOperation};
use rtec_control::config::{CardConfig, Config, LatencyTestConditions};
use rtec_files::atomic_write::AtomicFile;
use rtec_platform::latency_test::{
    CardTestExtent, LatencyDistribution, LatencyTestResult, SelftestError, SelftestOptions,
    SimulatedCardKind, WAKEUP_INTERVAL_NS, run as measure, run_on_card,
};
use rtec_platform::selftest_verdict::SelftestVerdict;
use rtec_rt::axis::AxisConfig;
use rtec_rt::latency_histogram::HistogramSnapshot;
use rtec_rt::realtime_setup::SystemRoot;
use std::io::Write as _;

/// Rows of the histogram in the text, 1 µs each.
/// The plotting scripts of the field ask cyclictest for as many.
const ROWS: usize = 400;

super::verbs_below! {
    /// Test this machine
    Args;
    Latency LatencyArgs => latency;
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
    #[arg(long, value_parser = ["mock", "mapped", "gpio", "port"])]
    backend: Option<String>,
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

/// The self-test, for a card of any backend.
struct LatencyTest<'a> {
    options: SelftestOptions,
    axes: &'a [AxisConfig],
    drive: bool,
}

fn duration(text: &str) -> Result<Duration, String> {
    let time = rtec_files::cli_option_parsers::duration(text)?;
    if time < Duration::from_millis(100) { Err("at least 100ms".into()) } else { Ok(time) }
}

fn latency(args: &LatencyArgs) -> anyhow::Result<()> {
    let config = args.config.as_deref().map(Config::load).transpose()?;
    let simulated = simulated(args, config.as_ref())?;
    let rt = config.as_ref().map(|c| &c.rt);
    let options = SelftestOptions {
        cpu: args.cpu.or(rt.and_then(|rt| rt.cpu)).unwrap_or_else(|| SystemRoot::live().default_cpu()),
        priority: args.priority.or(rt.map(|rt| rt.priority)).unwrap_or(80),
        run: args.duration,
        seed: 1,
    };
    // Made before the measurement, so that a folder that cannot be written to is reported at once.
    let created = |file: &PathBuf| {
        let unwritable =
            |e: std::io::Error| InputError::whole(file, e.to_string(), "a place that can be written to");
        AtomicFile::create(file).map_err(unwritable)
    };
    let histfile = args.histfile.as_ref().map(created).transpose()?;
    let mut provenance = LatencyTestConditions::here(&CardConfig::Mock, options.cpu, &SystemRoot::live());
    let (measured, backend) = match (simulated, &config) {
        (None, Some(config)) => {
            provenance.card = config.card.named();
            let _alone = lock_out_daemon(config)?;
            if args.drive && !args.mtc_is_off {
                confirm("every inverter of this card is switched on and off again, for a third of the time")?;
            }
            eprintln!("selftest: card {}", provenance.card);
            let access = if args.drive { CardAccess::Drive } else { CardAccess::Read };
            let test = LatencyTest { options, axes: &config.engine_axes(), drive: args.drive };
            (card_opening::with(&config.card, access, test).map_err(unreachable)??, config.card.backend())
        }
        (simulated, _) => {
            let backend = simulated.unwrap_or(SimulatedCardKind::Mapped);
            let (name, card) = match backend {
                SimulatedCardKind::Mock => ("mock", "wires in this process"),
                SimulatedCardKind::Mapped => ("mapped", "registers in shared memory"),
            };
            provenance.card = format!("simulated: {card}");
            (measure(options, backend, progress).context("measuring latencies")?, name)
        }
    };
    let verdict = SelftestVerdict::new(&measured, config.as_ref());
    if let Some(mut file) = histfile {
        let written = writeln!(file, "{}# Card: {}", histogram(&measured), provenance.card);
        written.and_then(|()| file.finish()).context("writing the histogram file")?;
    }
    if args.json {
        say_line(&verdict.document(&measured, &options, &provenance, backend))?;
    } else {
        // As with cyclictest, a histogram written to a file is not printed as well.
        print!("{}", text(&measured, &options, &verdict, &provenance, args.histfile.is_none()));
    }
    ensure!(verdict.reasons.is_empty(), No, "{}", verdict.reasons.join("; "));
    Ok(())
}

impl CardOperation for LatencyTest<'_> {
    type Output = Result<LatencyTestResult, SelftestError>;

    fn on<C: rtec_driver::card::Card + Send + 'static>(self, card: C) -> Self::Output {
        run_on_card(self.options, card, self.axes, self.drive, progress)
    }
}

fn progress(what: &str, left_s: u64) {
    eprintln!("selftest: {what}, {left_s} s left");
}

/// The simulated card to be measured; none for the configured one.
fn simulated(args: &LatencyArgs, config: Option<&Config>) -> anyhow::Result<Option<SimulatedCardKind>> {
    let (Some(file), Some(config)) = (&args.config, config) else {
        return match args.backend.as_deref() {
            None | Some("mapped") => Ok(Some(SimulatedCardKind::Mapped)),
            Some("mock") => Ok(Some(SimulatedCardKind::Mock)),
            Some(card) => {
                let why = "which card of this backend is to be measured stands there";
                fail!(Bad, "--backend {card} needs --config FILE: {why}")
            }
        };
    };
    let configured = config.card.backend();
    if let Some(asked) = args.backend.as_deref().filter(|card| *card != configured) {
        let (file, named) = (file.display(), config.card.named());
        fail!(Bad, "{file} has card {named}, and --backend {asked} asks for another: leave --backend out");
    }
    match &config.card {
        CardConfig::Replay { .. } => {
            fail!(Bad, "a recording has no latency: [card] backend = \"replay\" cannot be measured")
        }
        CardConfig::Mock if args.drive => {
            fail!(Bad, "a mock card has no outputs outside the process: leave --drive out")
        }
        CardConfig::Mock => Ok(Some(SimulatedCardKind::Mock)),
        _ => Ok(None),
    }
}

fn threads(measured: &LatencyTestResult) -> [&LatencyDistribution; 3] {
    [&measured.wakeup, &measured.quiet.poll_gap, &measured.quiet.edge_to_done]
}

fn text(
    measured: &LatencyTestResult,
    options: &SelftestOptions,
    verdict: &SelftestVerdict,
    provenance: &LatencyTestConditions,
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
    for (n, LatencyDistribution { tid, last_ns, ns, .. }) in threads(measured).into_iter().enumerate() {
        let priority = if fifo && n < 2 { options.priority } else { 0 };
        let interval = if n == 0 { WAKEUP_INTERVAL_NS / 1000 } else { 0 };
        let [min, act, avg, max] = [ns.min(), *last_ns, ns.mean() as u64, ns.max()].map(|ns| ns / 1000);
        line(format_args!(
            "T:{n:2} ({tid:5}) P:{priority:2} I:{interval} C:{:7} Min:{min:7} Act:{act:5} Avg:{avg:5} Max:{max:8}",
            ns.samples()
        ));
    }
    if with_histogram {
        line(format_args!("{}", histogram(measured).trim_end()));
    }
    line(format_args!("{}", table(measured).trim_end()));
    line(format_args!("# Card: {}", provenance.card));
    match measured.how {
        CardTestExtent::Simulated => line(format_args!(
            "# Edge to done contains {} ns that the MTC is given: {} after the edge, as much between the inversions.",
            measured.separations_ns(),
            measured.axis.min_separation_ns
        )),
        CardTestExtent::Reads => {
            line(format_args!("# Reads alone were measured; every output was held as it was."));
        }
        CardTestExtent::ReadsAndWrites { .. } => line(format_args!(
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
    for axis in &verdict.axes {
        let (safe, usual) = (rate(axis.safe_hz), rate(axis.usual_hz));
        let rates = format!("{safe} edges/s from the worst seen, {usual} from 99.99 %");
        let rates = if measured.timed() { &rates } else { "not measured" };
        line(format_args!("# Max Safe Edge Rate, axis {}: {rates}", axis.name));
    }
    let uncorrected = if measured.timed() { "corrected at no speed" } else { "corrected: not measured" };
    for axis in &verdict.axes {
        line(format_args!("# Axis {}: {}", axis.name, axis.rates.told(uncorrected)));
    }
    if measured.timed() {
        line(format_args!("# For the configuration, below [rt], these three lines:"));
        line(format_args!("detect_ns = {}", measured.detect_ns().0));
        line(format_args!("write_ns = {}", measured.write_ns()));
        line(format_args!("{provenance}"));
    }
    line(format_args!("# Verdict: {}", if verdict.reasons.is_empty() { "pass" } else { "fail" }));
    for reason in &verdict.reasons {
        line(format_args!("#   {reason}"));
    }
    out
}

/// All distributions in ns.
fn table(measured: &LatencyTestResult) -> String {
    let mut out = String::from(
        "#\n# in ns              samples      min      p50      p99    p99.9   p99.99         max\n",
    );
    let mut row = |name: &str, s: &HistogramSnapshot| {
        let inner = [s.min(), s.p50(), s.p99(), s.p999(), s.p9999()].map(|ns| format!(" {ns:>8}")).concat();
        let _ = writeln!(out, "# {name:<15} {:>11}{inner} {:>11}", s.samples(), s.max());
    };
    let (quiet, with_requests) = (&measured.quiet, &measured.with_requests);
    row("T0 wake-up", &measured.wakeup.ns);
    row("T1 poll gap", &quiet.poll_gap.ns);
    if measured.how != CardTestExtent::Simulated {
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

/// The part from `# Histogram` to the overflows, formatted like `cyclictest -h`.
fn histogram(measured: &LatencyTestResult) -> String {
    let threads = threads(measured);
    let linear = threads.map(|t| t.ns.linear(1000, ROWS));
    let joined = |values: [String; 3], by: &str| values.join(by);
    let mut out = String::from("# Histogram\n");
    for row in 0..ROWS {
        let counts = [0, 1, 2].map(|t: usize| format!("{:06}", linear[t].0[row]));
        let _ = writeln!(out, "{row:06} {}", joined(counts, "\t"));
    }
    let totals = [0, 1, 2].map(|t: usize| format!("{:09}", threads[t].ns.samples() - linear[t].1));
    let of = |f: fn(&HistogramSnapshot) -> u64| joined(threads.map(|t| format!("{:05}", f(&t.ns))), " ");
    let _ = writeln!(out, "# Total: {}", joined(totals, " "));
    let _ = writeln!(out, "# Min Latencies: {}", of(|s| s.min() / 1000));
    let _ = writeln!(out, "# Avg Latencies: {}", of(|s| s.mean() as u64 / 1000));
    let _ = writeln!(out, "# Max Latencies: {}", of(|s| s.max() / 1000));
    let overflows = [0, 1, 2].map(|t: usize| format!("{:05}", linear[t].1));
    let _ = writeln!(out, "# Histogram Overflows: {}", joined(overflows, " "));
    out
}
