//! `rtec-ship`: sends the records of a spool to an S3-like store.
//! `rtecctl ship` starts it for such a store. `rtec_records::spool` decides what is sent, in which order, and when it
//! leaves the spool. Only the store is implemented here.

mod s3;

use clap::Parser;
use rtec_files::eprintln;
use rtec_records::spool::{ShipError, ship};
use rusty_s3::Credentials;
use s3::{Address, S3Bucket, roots};
use std::io::{self, Write};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

/// Send finished records from a spool folder to an S3-like store, each once
#[derive(Debug, Parser)]
#[command(
    version,
    after_help = "Example: rtec-ship --spool /var/spool/rtec --to s3://plant/shop --machine mill-7 --endpoint https://store.plant:9000\n\
        Environment: AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, AWS_SESSION_TOKEN; AWS_ENDPOINT_URL_S3, AWS_ENDPOINT_URL or\n\
        AWS_ENDPOINT; AWS_REGION or AWS_DEFAULT_REGION; AWS_CA_BUNDLE, a file of the plant's own certificates; HTTPS_PROXY, NO_PROXY\n\
        Exit codes: 0 sent; 1 a record that is none stays in the spool; 2 bad usage, a wrong key, no such bucket; 3 the store could not be reached, or takes nothing"
)]
struct Args {
    /// The spool folder
    #[arg(long, value_name = "DIR")]
    spool: PathBuf,
    /// The bucket, and a folder within it
    #[arg(long, value_name = "s3://BUCKET/FOLDER")]
    to: String,
    /// The machine's name in the shop: letters, digits, `.`, `_`, `-`
    #[arg(long)]
    machine: String,
    /// The store's address [default: the environment's, else Amazon's of `AWS_REGION`]
    #[arg(long, value_name = "URL")]
    endpoint: Option<String>,
    /// Go on, and look again after so many seconds, also when the store was not there
    #[arg(long, value_name = "SECONDS", value_parser = clap::value_parser!(u64).range(1..))]
    every: Option<u64>,
    /// Print one JSON document (with --every one a line)
    #[arg(long)]
    json: bool,
}

/// Why a round failed: the caller's mistake, or a condition that may pass.
enum ShippingRoundFailure {
    Bad(String),
    Away(String),
    /// Files that are no records stay in the spool; the store is not at fault.
    Kept(String),
}

fn main() -> ExitCode {
    rtec_files::file_format_stamp::built_from(env!("RTEC_COMMIT"));
    let (code, said) = match run(&Args::parse()) {
        Ok(()) => return ExitCode::SUCCESS,
        Err(ShippingRoundFailure::Kept(said)) => (1, said),
        Err(ShippingRoundFailure::Bad(said)) => (2, said),
        Err(ShippingRoundFailure::Away(said)) => (3, said),
    };
    eprintln!("rtec-ship: {said}");
    ExitCode::from(code)
}

fn run(args: &Args) -> Result<(), ShippingRoundFailure> {
    let env = |name: &str| std::env::var(name).ok();
    let address =
        Address::parse(&args.to, args.endpoint.as_deref(), env).map_err(ShippingRoundFailure::Bad)?;
    let credentials = Credentials::from_env().ok_or_else(|| {
        let found = "found no AWS_ACCESS_KEY_ID with AWS_SECRET_ACCESS_KEY";
        ShippingRoundFailure::Bad(format!(
            "{found}, expected both in the environment; they stand in no file of ours"
        ))
    })?;
    let bundle = env("AWS_CA_BUNDLE").filter(|f| !f.is_empty());
    let roots = bundle.map(|file| {
        let bytes = std::fs::read(&file).map_err(|e| e.to_string());
        bytes
            .and_then(|b| roots(&b))
            .map_err(|e| ShippingRoundFailure::Bad(format!("AWS_CA_BUNDLE: {file}: {e}")))
    });
    let store =
        S3Bucket::open(&address, credentials, roots.transpose()?).map_err(ShippingRoundFailure::Bad)?;
    loop {
        let done = once(args, &store);
        let Some(seconds) = args.every else { return done };
        match done {
            Err(ShippingRoundFailure::Away(said)) => {
                eprintln!("warning: {said}; looked at again in {seconds} s");
            }
            // The files that stay were reported already.
            Ok(()) | Err(ShippingRoundFailure::Kept(_)) => {}
            Err(bad) => return Err(bad),
        }
        std::thread::sleep(Duration::from_secs(seconds));
    }
}

fn once(args: &Args, store: &S3Bucket) -> Result<(), ShippingRoundFailure> {
    let round = ship(&args.spool, store, &args.machine).map_err(|error| match &error {
        ShipError::Store { error: why, .. } if !mended_by_the_caller(why) => {
            ShippingRoundFailure::Away(error.to_string())
        }
        _ => ShippingRoundFailure::Bad(error.to_string()),
    })?;
    for finding in &round.kept {
        eprintln!("warning: {finding}; it stays in the spool");
    }
    let mut out = io::stdout().lock();
    match out.write_all(round.text(args.json).as_bytes()).and_then(|()| out.flush()) {
        // A reader that has closed the pipe is no error.
        Err(e) if e.kind() != io::ErrorKind::BrokenPipe => {
            Err(ShippingRoundFailure::Bad(format!("writing to standard output: {e}")))
        }
        _ => round.stays(&args.spool).map_or(Ok(()), |stays| Err(ShippingRoundFailure::Kept(stays))),
    }
}

fn mended_by_the_caller(why: &io::Error) -> bool {
    use io::ErrorKind::{InvalidInput, NotFound, PermissionDenied};
    matches!(why.kind(), InvalidInput | NotFound | PermissionDenied)
}
