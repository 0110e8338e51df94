//! `rtecctl park`: corrections come to rest, frozen where they are or taken out first.

use crate::Outcome;
use crate::daemon::{Daemon, check, unreachable};
use anyhow::bail;
use rtec_control::client::Client;
use rtec_control::protocol::{AxisReport, ClientRequest, DaemonStatus, Explained, Response};
use std::time::{Duration, Instant};

/// Freeze the corrections where they are and disarm; with --to-zero take them out first, step by step
///
/// The inverters stay as they are. --to-zero unloads the machine model and then requests smaller and smaller totals, each
/// within the belief window and inserted when the speed gate allows, until nothing is in effect.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Take the remaining correction out of every axis first
    #[arg(long)]
    to_zero: bool,
    /// Give up after this time without a count taken out, as 30s or 5min; corrections stay on then
    #[arg(long, value_name = "TIME", default_value = "5min", requires = "to_zero")]
    patience: humantime::Duration,
    #[command(flatten)]
    daemon: Daemon,
}

const EVERY: Duration = Duration::from_millis(100);
const PROGRESS_EVERY: Duration = Duration::from_secs(1);

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    if args.to_zero {
        to_zero(&mut args.daemon.connect()?, args.patience.into())?;
    }
    let done = if args.to_zero {
        "parked: nothing is in effect"
    } else {
        "parked: corrections frozen where they are"
    };
    args.daemon.order(&ClientRequest::Disable {}, done)
}

fn ask(client: &mut Client, request: &ClientRequest) -> anyhow::Result<Response> {
    check(client.ask(request).map_err(unreachable)?)
}

fn status(client: &mut Client) -> anyhow::Result<DaemonStatus> {
    match ask(client, &ClientRequest::Status {})? {
        Response::Status(status) => Ok(*status),
        other => {
            bail!("rtecd answered {other:?}, expected a status; are rtecctl and rtecd of the same version?")
        }
    }
}

fn to_zero(client: &mut Client, patience: Duration) -> anyhow::Result<()> {
    let mut now = status(client)?;
    if now.model.is_some() && now.mode == "run" {
        ask(client, &ClientRequest::ModelUnload {})?;
        eprintln!("the machine model is unloaded");
    }
    let left = |s: &DaemonStatus| s.axes.iter().map(|a| a.in_effect.unsigned_abs()).sum::<u64>();
    let (mut least, mut since) = (left(&now), Instant::now());
    let mut shown_at = Instant::now();
    loop {
        // What is requested is put back too: enabled again, nothing moves.
        if now.axes.iter().all(|a| a.in_effect == 0 && a.requested == 0) {
            return Ok(());
        }
        if now.mode == "fault" {
            let text = "a fault is latched: see `rtecctl status`; mend its cause, `rtecctl clear`, home and enable first";
            return Err(Outcome::Fault(text.to_owned()).into());
        }
        if now.mode != "run" {
            let why = now.why_not.join("; ");
            let text =
                format!("mode {}: nothing can be taken out before corrections are on: {why}", now.mode);
            return Err(Outcome::No(text).into());
        }
        let Response::Explained { axes } = ask(client, &ClientRequest::Explain { axis: None })? else {
            bail!("rtecd did not answer what makes up the totals; are rtecctl and rtecd of the same version?")
        };
        for (axis, parts) in now.axes.iter().zip(&axes).filter(|(_, parts)| parts.requested != 0) {
            ask(client, &next(axis, parts))?;
        }
        if left(&now) < least {
            (least, since) = (left(&now), Instant::now());
        }
        let waiting: Vec<String> = now.axes.iter().filter(|a| a.in_effect != 0).map(why).collect();
        if since.elapsed() >= patience {
            let text = format!("not at zero, corrections are still on: {}", waiting.join("; "));
            return Err(Outcome::No(text).into());
        }
        if shown_at.elapsed() >= PROGRESS_EVERY {
            shown_at = Instant::now();
            eprintln!("{}", waiting.join("; "));
        }
        std::thread::sleep(EVERY);
        now = status(client)?;
    }
}

/// The operator's next total towards zero that the belief window lets through. What a model has asked for runs out by
/// itself once it is unloaded.
fn next(axis: &AxisReport, parts: &Explained) -> ClientRequest {
    let operator_um = parts.parts.iter().find(|p| p.name == "operator").map_or(0.0, |p| p.um);
    let operator_counts = (operator_um * parts.requested as f64 / parts.total_um).round() as i64;
    let step = axis.window_counts.max(1);
    let total_counts = operator_counts - operator_counts.clamp(-step, step);
    ClientRequest::Correct { axis: axis.name.clone(), total_counts, large: false }
}

/// What an axis has left, and what it waits for.
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
