//! `rtecctl shadow`: computes everything, writes nothing to the card.

use crate::daemon_connection::DaemonArgs;
use rtec_control::protocol::ClientRequest;

/// Compute, gate and count everything, write nothing: watch a machine before it is touched
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    daemon: DaemonArgs,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    args.daemon.order(&ClientRequest::Shadow {}, "shadow mode: nothing is written")
}
