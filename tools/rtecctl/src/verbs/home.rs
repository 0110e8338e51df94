//! `rtecctl home`: the axis stands at its known place.

use crate::daemon::Daemon;
use rtec_control::protocol::ClientRequest;

/// Set the counters at the known home place and read them back
///
/// Corrections freeze until this is done after every start. The place is `home_mm` of the configuration.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The axis [default: all]
    axis: Option<String>,
    #[command(flatten)]
    daemon: Daemon,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let done =
        args.axis.as_ref().map_or_else(|| "all axes homed".to_owned(), |axis| format!("axis {axis} homed"));
    args.daemon.order(&ClientRequest::Home { axis: args.axis.clone() }, &done)
}
