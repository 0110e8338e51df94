//! `rtecctl correct`: the total correction of an axis.

use crate::daemon_connection::DaemonArgs;
use rtec_control::protocol::ClientRequest;

/// Request the total correction of an axis, in counts since homing
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The axis
    axis: String,
    /// The total, not an increment: giving it twice does no harm
    #[arg(allow_negative_numbers = true)]
    counts: i64,
    /// A change beyond the belief window is meant (a restart with a hot machine)
    #[arg(long)]
    large: bool,
    #[command(flatten)]
    daemon: DaemonArgs,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let Args { axis, counts, large, daemon } = args;
    let request = ClientRequest::Correct { axis: axis.clone(), total_counts: *counts, large: *large };
    daemon.order(&request, &format!("axis {axis}: {counts:+} counts requested"))
}
