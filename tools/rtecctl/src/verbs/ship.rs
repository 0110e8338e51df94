//! `rtecctl ship`: finished records from a spool folder to the shop's store.

use crate::Outcome;
use rtec_measure::spool::{Folder, Round, ShipError, ship};
use std::path::PathBuf;
use std::time::Duration;

/// Send finished records from a spool folder to the shop's folder, each once and whole
///
/// What the store gives back as it was sent leaves the spool, for `sent/` below it. A store that goes away loses nothing: what
/// was not sent waits for the next time. Object stores are served by `python -m rtec.shop ship`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The folder that `characterise record --spool` writes to
    #[arg(long, value_name = "DIR")]
    spool: PathBuf,
    /// The shop's folder: of this computer, or a share that is mounted; one that is missing is not made
    #[arg(long, value_name = "DIR")]
    to: PathBuf,
    /// The machine's name in the shop: letters, digits, `.`, `_`, `-`
    #[arg(long)]
    machine: String,
    /// Go on, and look again after so many seconds, also when the store was not there
    #[arg(long, value_name = "SECONDS", value_parser = clap::value_parser!(u64).range(1..))]
    every: Option<u64>,
    /// Print one JSON document (with --every one a line)
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    loop {
        let done = once(args);
        let Some(seconds) = args.every else { return done };
        if let Err(error) = done {
            if !matches!(error.downcast_ref::<Outcome>(), Some(Outcome::Unreachable(_))) {
                return Err(error);
            }
            eprintln!("warning: {error}; looked at again in {seconds} s");
        }
        std::thread::sleep(Duration::from_secs(seconds));
    }
}

fn once(args: &Args) -> anyhow::Result<()> {
    let away = |e: &std::io::Error| {
        Outcome::Unreachable(format!("{}: {e}: is the share mounted?", args.to.display()))
    };
    let store = Folder::open(&args.to).map_err(|e| away(&e))?;
    let Round { sent, kept } = match ship(&args.spool, &store, &args.machine) {
        Ok(round) => round,
        Err(error @ ShipError::Store { .. }) => return Err(Outcome::Unreachable(error.to_string()).into()),
        Err(error) => return Err(Outcome::Bad(error.to_string()).into()),
    };
    for finding in &kept {
        eprintln!("warning: {finding}; it stays in the spool");
    }
    let text = if args.json {
        let kept: Vec<String> = kept.iter().map(ToString::to_string).collect();
        format!("{}\n", serde_json::json!({"sent": sent, "kept": kept}))
    } else {
        let places = sent.iter().fold(String::new(), |all, place| all + place + "\n");
        format!("{places}{} records sent, {} kept\n", sent.len(), kept.len())
    };
    crate::say(&text);
    Ok(())
}
