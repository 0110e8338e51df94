//! `rtecctl model predict`: the sum of a model's effects at every row of a record.

use anyhow::Context;
use rtec_files::InputError;
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
    let prediction = machine.predict(&record)?;
    for (effect, role) in &prediction.taken_as_zero {
        eprintln!("warning: {}: no {role} in the record, taken as zero for {effect}", args.record.display());
    }
    for warning in machine.out_of_range(&record) {
        eprintln!("warning: {}: {warning}", args.record.display());
    }
    let mut columns = Vec::new();
    for (response, (name, data)) in record.responses().zip(prediction.columns) {
        if args.interval {
            let Some(width) = machine.half_widths_um(&record, &response.role) else {
                let found = format!("no fit of {}", response.role);
                let expected = "a [[fit]] that states its interval, as `model fit` writes it";
                return Err(InputError::whole(&args.machine, found, expected).into());
            };
            let bound = |sign: f64| data.iter().zip(&width).map(|(p, w)| p + sign * w).collect::<Vec<f64>>();
            let (low, high) = (bound(-1.0), bound(1.0));
            columns.push((format!("low_{name}"), low));
            columns.push((format!("high_{name}"), high));
        }
        columns.push((format!("predicted_{name}"), data));
    }
    let text = rtec_measure::record::csv_with(&record, &columns)?;
    rtec_files::write::whole(&args.out, text.as_bytes())
        .with_context(|| format!("writing {}", args.out.display()))
}
