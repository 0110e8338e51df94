//! `rtecctl enable`: corrections on.

use crate::daemon_connection::{DaemonArgs, describe};
use rtec_control::protocol::{ClientRequest, DaemonResponse};

/// Switch corrections on; shows what moves, and refuses a jump beyond the belief window
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// A jump beyond the belief window is meant
    #[arg(long)]
    accept_jump: bool,
    #[command(flatten)]
    daemon: DaemonArgs,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let response = args.daemon.ask(&ClientRequest::Enable { accept_jump: args.accept_jump })?;
    if let DaemonResponse::Done { jumps, already, .. } = response
        && !args.daemon.json
    {
        let what = match (already, jumps.is_empty()) {
            (true, _) => " already",
            (false, true) => ", nothing moves",
            (false, false) => "; what moves:",
        };
        println!("corrections on{what}");
        for jump in &jumps {
            println!("  {}", describe(jump));
        }
    }
    Ok(())
}
