//! `rtecctl home`: declares that the axis is at its home position.

use crate::daemon_connection::DaemonArgs;
use rtec_control::protocol::ClientRequest;

/// Set the counters at the known home place and read them back
///
/// Corrections freeze until this is done after every start. The place is `home_mm` of the configuration. Counts that were
/// inserted stay in the controller's position until it is homed too: then say so, or they are refused or kept.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The axis [default: all]
    axis: Option<String>,
    /// The controller has been homed there too: what was inserted before is forgotten
    #[arg(long)]
    controller_homed: bool,
    /// The controller has not been homed: what was inserted before is kept, and counts against the axis's limit
    #[arg(long, conflicts_with = "controller_homed")]
    controller_not_homed: bool,
    #[command(flatten)]
    daemon: DaemonArgs,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let done =
        args.axis.as_ref().map_or_else(|| "all axes homed".to_owned(), |axis| format!("axis {axis} homed"));
    let controller_homed = match (args.controller_homed, args.controller_not_homed) {
        (false, false) => None,
        (homed, _) => Some(homed),
    };
    args.daemon.order(&ClientRequest::Home { axis: args.axis.clone(), controller_homed }, &done)
}
