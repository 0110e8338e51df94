//! `rtecctl park`: ends corrections, with the counts kept or withdrawn.

use crate::daemon_connection::{DaemonArgs, ask, explained, status};
use crate::json_output::list;
use rtec_control::daemon_client::DaemonConnection;
use rtec_control::protocol::{AxisCorrectionComponents, AxisReport, ClientRequest, DaemonStatus};
use std::time::{Duration, Instant};

/// Freeze the corrections where they are and disarm; with --to-zero take them out first, step by step
///
/// Without an option the inverters stay as they are. --to-zero unloads the machine model and then requests smaller and smaller totals, each
/// within the belief window and inserted when the speed gate allows, until nothing is in effect.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Take the remaining correction out of every axis first
    #[arg(long, group = "moves")]
    to_zero: bool,
    /// Take out one insertion where an axis has its inverters on: before the controller is homed at a reference mark that
    /// it gates with A and B
    #[arg(long, group = "moves")]
    inverters_off: bool,
    /// Give up after this time without a count taken out, as 30s or 5min; corrections stay on then
    #[arg(long, value_name = "TIME", default_value = "5min", requires = "moves", value_parser = rtec_files::cli_option_parsers::duration)]
    patience: Duration,
    #[command(flatten)]
    daemon: DaemonArgs,
}

const EVERY: Duration = Duration::from_millis(100);
const PROGRESS_EVERY: Duration = Duration::from_secs(1);

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let mut client = args.daemon.connect()?;
    if args.inverters_off {
        inverters_off(&mut client, args.patience)?;
        args.daemon.order(&ClientRequest::Park {}, "parked: all inverters off, corrections frozen")?;
        let on = list(inverted(&status(&mut client)?).map(|a| &a.name));
        let why = "a model or part table has moved it on meanwhile; enable and park again";
        ensure!(on.is_empty(), No, "axis {on}: {why}");
        return Ok(());
    }
    // If the MTC's count is unknown, nothing can be withdrawn, but corrections are still disabled.
    let known = unknown(&status(&mut client)?).is_none();
    let unloaded = known && args.to_zero && to_zero(&mut client, args.patience)?;
    if let Some(why) = unknown(&status(&mut client)?) {
        ask(&mut client, &ClientRequest::Park {})?;
        fail!(No, "{why}");
    }
    let done = match (args.to_zero, unloaded) {
        (false, _) => "parked: corrections frozen where they are",
        (true, false) => "parked: nothing is in effect",
        (true, true) => {
            "parked: nothing is in effect; the model is unloaded: `rtecctl model again` takes it up again"
        }
    };
    args.daemon.order(&ClientRequest::Park {}, done)
}

/// Reason why the counts in effect are unknown, if so.
fn unknown(now: &DaemonStatus) -> Option<String> {
    let names = list(now.axes.iter().filter(|a| !a.mtc_known).map(|a| &a.name));
    let first = if now.mode == "fault" { "`rtecctl clear`, then " } else { "" };
    let next = format!("{first}home both: `rtecctl home --controller-homed`");
    (!names.is_empty())
        .then(|| format!("parked, but what the controller counts is not known: {names}; {next}"))
}

/// Withdraws all counts; returns whether a model was unloaded for it.
fn to_zero(client: &mut DaemonConnection, patience: Duration) -> anyhow::Result<bool> {
    let mut now = status(client)?;
    let unloads = now.model.is_some() && now.mode == "run";
    if unloads {
        ask(client, &ClientRequest::ModelUnload {})?;
        eprintln!("the machine model is unloaded");
    }
    let left = |s: &DaemonStatus| s.axes.iter().map(|a| a.in_effect.unsigned_abs()).sum::<u64>();
    let (mut least, mut since) = (left(&now), Instant::now());
    let mut shown_at = Instant::now();
    loop {
        // Requested totals are zeroed too, so that a later enable moves nothing.
        if now.mode != "fault" && now.axes.iter().all(|a| a.in_effect == 0 && a.requested == 0) {
            return Ok(unloads);
        }
        corrects(&now)?;
        let axes = explained(client)?;
        for (axis, parts) in now.axes.iter().zip(&axes).filter(|(_, parts)| parts.requested != 0) {
            ask(client, &step_to_zero(axis, parts))?;
        }
        if left(&now) < least {
            (least, since) = (left(&now), Instant::now());
        }
        let waiting: Vec<String> = now.axes.iter().filter(|a| a.in_effect != 0).map(why).collect();
        let waiting = waiting.join("; ");
        ensure!(since.elapsed() < patience, No, "not at zero, corrections are still on: {waiting}");
        if shown_at.elapsed() >= PROGRESS_EVERY {
            shown_at = Instant::now();
            eprintln!("{waiting}");
        }
        std::thread::sleep(EVERY);
        now = status(client)?;
    }
}

/// Checks that corrections run, since withdrawing needs insertions.
fn corrects(now: &DaemonStatus) -> anyhow::Result<()> {
    if now.mode == "fault" {
        let next = "mend its cause, `rtecctl clear`, home and enable first";
        fail!(Fault, "a fault is latched: see `rtecctl status`; {next}");
    }
    let (mode, why) = (&now.mode, now.why_not.join("; "));
    ensure!(mode == "run", No, "mode {mode}: nothing can be taken out before corrections are on: {why}");
    Ok(())
}

fn inverted(now: &DaemonStatus) -> impl Iterator<Item = &AxisReport> {
    now.axes.iter().filter(|a| a.inverted)
}

/// Requests one insertion on each axis with inverters on, until all are off.
fn inverters_off(client: &mut DaemonConnection, patience: Duration) -> anyhow::Result<()> {
    let begun = Instant::now();
    loop {
        let now = status(client)?;
        if inverted(&now).next().is_none() && now.axes.iter().all(|a| a.requested == a.in_effect) {
            return Ok(());
        }
        corrects(&now)?;
        let parts = explained(client)?;
        for (axis, parts) in now.axes.iter().zip(&parts) {
            if axis.inverted && axis.requested == axis.in_effect {
                // Towards zero. At zero, if the axis was homed with its inverters on, either way will do.
                let step = if axis.in_effect > 0 { -2 } else { 2 };
                let total_counts = operator_counts(parts) + step;
                let axis = axis.name.clone();
                ask(client, &ClientRequest::Correct { axis, total_counts, large: false })?;
            }
        }
        if begun.elapsed() >= patience {
            let waiting = inverted(&now).map(why).collect::<Vec<_>>().join("; ");
            fail!(No, "inverters still on, corrections are still on: {waiting}");
        }
        std::thread::sleep(EVERY);
    }
}

/// The operator's share of a total, counts.
fn operator_counts(parts: &AxisCorrectionComponents) -> i64 {
    let operator_um = parts.parts.iter().find(|p| p.name == "operator").map_or(0.0, |p| p.um);
    if parts.requested == 0 {
        0
    } else {
        (operator_um * parts.requested as f64 / parts.total_um).round() as i64
    }
}

/// The operator's next total towards zero within the belief window.
/// The model's part returns by itself after the model is unloaded.
fn step_to_zero(axis: &AxisReport, parts: &AxisCorrectionComponents) -> ClientRequest {
    let operator_counts = operator_counts(parts);
    let step = axis.window_counts.max(1);
    let total_counts = operator_counts - operator_counts.clamp(-step, step);
    ClientRequest::Correct { axis: axis.name.clone(), total_counts, large: false }
}

/// The counts that an axis has left, and what it waits for.
fn why(axis: &AxisReport) -> String {
    let wait = match axis.gate.as_str() {
        "at_rest" => "it stands still and rest_policy is wait: jog it a little",
        "one_channel" => {
            "only one channel changes: move it by some counts; if the other never changes, its wire is broken"
        }
        "too_fast" => "it is too fast for an insertion: slow down",
        "rate_cap" => "max_rate_counts_s holds it back",
        "waiting_for_edge" => "at its next edge",
        "control_stale" => "the daemon is busy",
        _ => "under way",
    };
    format!("axis {}: {:+} counts left, {wait}", axis.name, axis.in_effect)
}
