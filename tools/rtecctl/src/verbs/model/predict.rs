//! `rtecctl model predict`: the sum of a model's effects at every row of a record.

use crate::verbs::suspicions;
use anyhow::Context;
use rtec_measure::prediction;
use rtec_model::machine::Machine;
use std::path::PathBuf;

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
    #[arg(long, value_name = "FILE.csv")]
    out: PathBuf,
    /// Further columns `low_RESPONSE` and `high_RESPONSE`: the 95 % prediction interval, where a fit has stated one
    #[arg(long)]
    interval: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let machine = Machine::read(&args.machine)?;
    let record = rtec_measure::record::read(&args.record)?;
    let text = prediction::csv(&machine, &record, args.interval, &mut suspicions::say)?;
    rtec_files::write::whole(&args.out, text.as_bytes())
        .with_context(|| format!("writing {}", args.out.display()))
}
