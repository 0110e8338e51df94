//! `rtecctl disable`: corrections off.

use crate::daemon_connection::DaemonArgs;
use rtec_control::protocol::ClientRequest;

/// Switch corrections off: they freeze where they are, nothing moves
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    daemon: DaemonArgs,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    args.daemon.order(&ClientRequest::Disable {}, "corrections off, frozen where they are")
}
