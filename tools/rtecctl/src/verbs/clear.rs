//! `rtecctl clear`: release latched faults.

use crate::daemon::Daemon;
use rtec_control::protocol::ClientRequest;

/// Release latched faults, once their cause is mended
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    daemon: Daemon,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let done = "faults released; axes whose count was in doubt must be homed again (rtecctl status)";
    args.daemon.order(&ClientRequest::Clear {}, done)
}
