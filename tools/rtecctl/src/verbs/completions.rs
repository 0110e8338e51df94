//! `rtecctl completions SHELL`: shell completions on standard output.

use clap_complete::Shell;

/// Print a completion script for your shell
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The shell to complete in
    shell: Shell,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut crate::help::command(), "rtecctl", &mut script);
    crate::say(&String::from_utf8_lossy(&script));
    Ok(())
}
