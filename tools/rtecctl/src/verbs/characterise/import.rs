//! `rtecctl characterise import`: turns other tools' files into run records.

use crate::verbs::{one_of, suspicions};
use anyhow::Context;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use rtec_files::InputMessage;
use rtec_measure::export::linuxcnc::Unit;
use rtec_measure::import::request::{ImportFormat, ImportRequest};
use rtec_measure::record;
use std::path::PathBuf;

/// Turn another tool's file into a run record
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The file to import
    file: PathBuf,
    /// What it is
    #[arg(long, value_parser = one_of(&ImportFormat::ALL, &[]))]
    format: ImportFormat,
    /// The axis that was measured (not for plates and tables)
    #[arg(long)]
    axis: Option<String>,
    /// csv, halsampler, shdr: columns with their roles, and the unit where it is not the role's own, as
    /// t=time:min,gz=error.z:mm; with a factor as volt=force.x:V*35.15=N. Columns of halsampler go by number, from 1
    #[arg(
        long,
        value_delimiter = ',',
        value_name = "NAME=ROLE[:UNIT]",
        required_if_eq_any([("format", "csv"), ("format", "halsampler"), ("format", "shdr")])
    )]
    columns: Vec<String>,
    /// csv, halsampler, shdr: what kind of run it is
    #[arg(long, default_value = "drift")]
    kind: String,
    /// csv: how numbers are written [default: a point; either where semicolons part the columns]
    #[arg(long, value_parser = PossibleValuesParser::new(["point", "comma"]).map(|way| way == "comma"))]
    decimal: Option<bool>,
    /// csv, halsampler, shdr: a log, which need not have a response
    #[arg(long)]
    log: bool,
    /// halsampler: seconds a sample
    #[arg(long, required_if_eq("format", "halsampler"), allow_negative_numbers = true)]
    period_s: Option<f64>,
    /// halsampler: written with -t, the sample's number in front
    #[arg(long)]
    numbered: bool,
    /// linuxcnc-comp: the machine's `LINEAR_UNITS`
    #[arg(long, value_parser = one_of(&Unit::ALL, &[]), default_value = "mm")]
    unit: Unit,
    /// own: the file that describes the table
    #[arg(long, value_name = "FORM.toml", required_if_eq("format", "own"))]
    form: Option<PathBuf>,
    /// Add velocity and acceleration from the positions, where there are none
    #[arg(long)]
    derive: bool,
    #[command(flatten)]
    circle: super::CircleOptions,
    /// The run record to write; its CSV stands beside it
    #[arg(long, value_name = "NAME.run.toml", value_parser = crate::verbs::output())]
    out: PathBuf,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let asked = ImportRequest {
        file: args.file.clone(),
        format: args.format,
        axis: args.axis.clone(),
        columns: args.columns.clone(),
        kind: args.kind.clone(),
        decimal_comma: args.decimal,
        log: args.log,
        period_s: args.period_s,
        numbered: args.numbered,
        unit: args.unit,
        form: args.form.clone(),
        derive: args.derive,
        circle: args.circle.circle()?,
        out: args.out.clone(),
    };
    let mut record = asked.read(&mut |said| match said {
        InputMessage::Note(text) => eprintln!("{text}"),
        InputMessage::Warning(text) => eprintln!("warning: {text}"),
    })?;
    record::write(&mut record).with_context(|| format!("writing {}", args.out.display()))?;
    if let Some(note) = &record.note {
        eprintln!("note: {note}");
    }
    suspicions::warn(std::slice::from_ref(&record));
    eprintln!("{}: {} rows, and {} beside it", args.out.display(), record.rows(), record.file);
    Ok(())
}
