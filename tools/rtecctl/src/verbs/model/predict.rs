//! `rtecctl model predict`: the sum of a model's effects at every row of a record.

use crate::prelude::*;
use crate::verbs::input_notices;
use rtec_files::atomic_write::AtomicFile;
use rtec_measure::prediction::{self, PredictionFailure};
use rtec_model::machine::Machine;

/// Predict a record's responses from a machine model
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The machine model
    #[arg(long, value_name = "FILE")]
    machine: PathBuf,
    /// The run record
    #[arg(long, value_name = "NAME.run.toml")]
    record: PathBuf,
    /// The record's rows with one column `predicted_RESPONSE` per response
    #[arg(long, value_name = "FILE.csv", value_parser = crate::verbs::output())]
    out: PathBuf,
    /// Further columns `low_RESPONSE` and `high_RESPONSE`: the 95 % prediction interval, where a fit has stated one
    #[arg(long)]
    interval: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let machine = Machine::read(&args.machine)?;
    let writing = || format!("writing {}", args.out.display());
    let mut out = AtomicFile::create(&args.out).with_context(writing)?;
    match prediction::write(&machine, &args.record, args.interval, &mut out, &mut input_notices::say) {
        Err(PredictionFailure::Input(found)) => return Err(found.into()),
        written => written.with_context(writing)?,
    }
    out.finish().with_context(writing)
}
