//! `rtecctl model predict`: the sum of a model's effects at every row of a record.

use anyhow::Context;
use rtec_model::machine::Machine;
use rtec_model::record::{Record, write_whole};
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
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let machine = Machine::read(&args.machine)?;
    let record = Record::read(&args.record)?;
    let prediction = machine.predict(&record)?;
    for (effect, role) in &prediction.taken_as_zero {
        eprintln!("warning: {}: no {role} in the record, taken as zero for {effect}", args.record.display());
    }
    let columns: Vec<_> =
        prediction.columns.into_iter().map(|(name, data)| (format!("predicted_{name}"), data)).collect();
    let text = record.csv_with(&columns)?;
    write_whole(&args.out, text.as_bytes()).with_context(|| format!("writing {}", args.out.display()))
}
