//! `rtecctl man DIR`: one manual page per verb.

use crate::prelude::*;

/// Write the manual pages, one per verb, into a directory
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The directory, created where it is missing
    dir: PathBuf,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    std::fs::create_dir_all(&args.dir).with_context(|| format!("creating {}", args.dir.display()))?;
    clap_mangen::generate_to(crate::help::command(), &args.dir)
        .with_context(|| format!("writing manual pages into {}", args.dir.display()))
}
