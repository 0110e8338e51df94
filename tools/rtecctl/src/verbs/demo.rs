//! `rtecctl demo`: corrects a simulated axis with the embedded default.

use crate::prelude::*;
use rtec_demo::Options;

/// Correct a simulated axis in real time: no hardware, no root, no configuration
///
/// The real engine runs on a thread of its own, against a mock card with a moving axis behind it and a controller that
/// counts what it is sent. The axis has an error of 240 µm per metre and a periodic one of its screw.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct Args {
    /// How long to run
    #[arg(long, default_value = "10s", value_parser = crate::duration::duration)]
    duration: Duration,
    /// Print one JSON document at the end instead of the live view
    #[arg(long)]
    json: bool,
    /// Write the tool's error every 10 ms into this CSV file, without and with correction
    #[arg(long, value_name = "FILE")]
    errors: Option<PathBuf>,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let Args { duration, json, errors } = args.clone();
    rtec_demo::run(&Options { duration, json, errors })
}
