//! `rtecctl probe`: positions at the trips of the probe.

use crate::daemon_connection::{DaemonArgs, NO_EVENTS, ask, check, observe, unreachable};
use crate::json_output::say_line;
use clap::ValueEnum;
use rtec_control::protocol::{ClientRequest, DaemonResponse, ProbeTripReport};

/// Switch probing on and print every captured position, or switch it off
///
/// While probing is on no corrections are made. `on` prints until probing is switched off; interrupted by Ctrl-C it leaves
/// probing on.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// On or off
    switch: OnOrOff,
    /// Switch off again and end after so many captures, every axis counted; 0 only switches on
    #[arg(long, value_name = "N")]
    captures: Option<u64>,
    #[command(flatten)]
    daemon: DaemonArgs,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum OnOrOff {
    On,
    Off,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    if args.switch == OnOrOff::Off {
        return args.daemon.order(&ClientRequest::Probe { on: false }, "probing off");
    }
    if args.captures == Some(0) {
        return args.daemon.order(&ClientRequest::Probe { on: true }, "probing on");
    }
    let ends = args.captures.is_some() || !args.daemon.json;
    ensure!(ends, Bad, "one JSON document needs an end: --captures N beside --json");
    // The watch starts first, so that no trip can come in between.
    let mut watch = args.daemon.connect()?;
    ask(&mut watch, &ClientRequest::Watch {})?;
    watch.be_patient()?;
    ask(&mut args.daemon.connect()?, &ClientRequest::Probe { on: true })?;
    let mut captured = Vec::new();
    match args.captures {
        None => eprintln!(
            "probing: every capture is printed; `rtecctl probe off` elsewhere ends it, Ctrl-C ends this list alone; \
             `--captures 0` returns at once"
        ),
        Some(n) => eprintln!(
            "probing: {n} captures awaited; `rtecctl probe off` elsewhere ends it, Ctrl-C this list alone"
        ),
    }
    if !args.daemon.json {
        println!("            t/ns axis        position/mm         counts          ±    by model/mm");
    }
    let mut number = 0;
    while args.captures.is_none_or(|n| number < n) {
        let DaemonResponse::Event(happened) = check(watch.answer().map_err(unreachable)?)? else { continue };
        if happened.trip.is_none() {
            if happened.kind != "mode" {
                let axis = happened.axis.map(|a| format!("axis {a}: ")).unwrap_or_default();
                eprintln!("{axis}{}", happened.text);
            } else if observe(&mut args.daemon.view()?, NO_EVENTS)?.status.mode != "probe" {
                // Another user or a fault has switched probing off: no capture will come.
                let text = format!("probing has ended ({}) after {number} captures", happened.text);
                ensure!(args.captures.is_none(), No, "{text}");
                eprintln!("{text}");
                return Ok(());
            }
            continue;
        }
        number += 1;
        if let (Some(n), true) = (args.captures, args.daemon.json) {
            eprintln!("capture {number} of {n}");
        }
        if let (Some(trip), false) = (&happened.trip, args.daemon.json) {
            let ProbeTripReport { position_mm, position_counts, uncertainty_counts, .. } = trip;
            let (t_ns, axis) = (happened.t_ns, happened.axis.as_deref().unwrap_or("-"));
            let by_model = trip.corrected_mm.map_or("-".to_owned(), |mm| format!("{mm:.6}"));
            println!(
                "{t_ns:>16} {axis:<8} {position_mm:>14.6} {position_counts:>14.3} {uncertainty_counts:>10.3} {by_model:>14}"
            );
        }
        if args.captures.is_some() {
            captured.push(happened);
        }
    }
    if args.daemon.json {
        say_line(&serde_json::json!({ "captures": captured }))?;
    }
    ask(&mut args.daemon.connect()?, &ClientRequest::Probe { on: false })?;
    Ok(())
}
