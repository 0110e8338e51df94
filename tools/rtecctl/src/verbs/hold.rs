//! `rtecctl hold`: feed hold.

use crate::daemon_connection::DaemonArgs;
use crate::verbs::probe::OnOrOff;
use rtec_control::protocol::ClientRequest;

/// Switch feed hold on or off; corrections freeze while it is on
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// On or off
    switch: OnOrOff,
    #[command(flatten)]
    daemon: DaemonArgs,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let on = args.switch == OnOrOff::On;
    args.daemon.order(&ClientRequest::Hold { on }, if on { "feed hold on" } else { "feed hold off" })
}
