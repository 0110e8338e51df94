//! `rtecctl ship`: finished records from a spool folder to the shop's store.

use crate::prelude::*;
use rtec_measure::spool::{FolderStore, ShipError, ship};
use std::os::unix::process::CommandExt;
use std::process::Command;

/// Send finished records from a spool folder to the shop's folder or S3-like store, each once and whole
///
/// What the store gives back as it was sent leaves the spool, for `sent/` below it. A store that goes away loses nothing: what
/// was not sent waits for the next time. A store of S3 is served by the program `rtec-ship` beside this one, with the same
/// options; its key is read from the environment (`AWS_ACCESS_KEY_ID`, `AWS_SECRET_ACCESS_KEY`).
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The folder that the daemon and `characterise record --spool` write to
    #[arg(long, value_name = "DIR")]
    spool: PathBuf,
    /// The shop's folder: of this computer, or a share that is mounted; one that is missing is not made. Or `s3://BUCKET/FOLDER`
    #[arg(long, value_name = "DIR|URL")]
    to: PathBuf,
    /// The machine's name in the shop: letters, digits, `.`, `_`, `-`
    #[arg(long)]
    machine: String,
    /// The S3-like store's address [default: `AWS_ENDPOINT_URL`, else Amazon's of `AWS_REGION`]
    #[arg(long, value_name = "URL")]
    endpoint: Option<String>,
    /// Go on, and look again after so many seconds, also when the store was not there
    #[arg(long, value_name = "SECONDS", value_parser = clap::value_parser!(u64).range(1..))]
    every: Option<u64>,
    /// Print one JSON document (with --every one a line)
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    match args.to.to_str().and_then(|to| to.split_once("://")) {
        Some(("s3", _)) => {
            // Replaces this process by the program that knows S3. Its options are those of this verb.
            let program = std::env::current_exe().unwrap_or_default().with_file_name("rtec-ship");
            let why = Command::new(&program).args(std::env::args_os().skip(2)).exec();
            let mend = "it stands beside rtecctl in the package, and is built by `cargo build -p rtec-ship`";
            fail!(Bad, "{}: {why}: {mend}", program.display());
        }
        Some((other, _)) => {
            let found = format!("--to: found `{other}://`, expected a folder or s3://BUCKET");
            fail!(Bad, "{found}; other stores: python -m rtec.shop ship");
        }
        None if args.endpoint.is_some() => {
            fail!(Bad, "found --to {} beside --endpoint, expected s3://BUCKET", args.to.display());
        }
        None => {}
    }
    loop {
        let done = once(args);
        let Some(seconds) = args.every else { return done };
        if let Err(error) = done {
            if !matches!(error.downcast_ref::<CommandFailure>(), Some(CommandFailure::Unreachable(_))) {
                return Err(error);
            }
            eprintln!("warning: {error}; looked at again in {seconds} s");
        }
        std::thread::sleep(Duration::from_secs(seconds));
    }
}

fn once(args: &Args) -> anyhow::Result<()> {
    let away = |e| CommandFailure::Unreachable(format!("{}: {e}: is the share mounted?", args.to.display()));
    let store = FolderStore::open(&args.to).map_err(away)?;
    let round = ship(&args.spool, &store, &args.machine).map_err(|error| match error {
        ShipError::Store { .. } => CommandFailure::Unreachable(error.to_string()),
        _ => CommandFailure::Bad(error.to_string()),
    })?;
    for finding in &round.kept {
        eprintln!("warning: {finding}; it stays in the spool");
    }
    crate::say(&round.text(args.json));
    match round.stays(&args.spool) {
        Some(stays) if args.every.is_none() => Err(CommandFailure::No(stays).into()),
        _ => Ok(()),
    }
}
