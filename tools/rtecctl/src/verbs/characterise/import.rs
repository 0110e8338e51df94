//! `rtecctl characterise import`: turns other tools' files into run records.

use crate::verbs::suspicions;
use anyhow::Context;
use rtec_files::Said;
use rtec_measure::export::linuxcnc::Unit;
use rtec_measure::import::asked::{Asked, Name};
use rtec_measure::record;
use std::path::PathBuf;

/// Turn another tool's file into a run record
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The file to import
    file: PathBuf,
    /// What it is
    #[arg(long, value_enum)]
    format: Format,
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
    #[arg(long, value_enum)]
    decimal: Option<Decimal>,
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
    #[arg(long, value_enum, default_value = "mm")]
    unit: UnitName,
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

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    /// ecmc's ISO 230-2 data: `TGT_DATA`, `REF_DATA_FWD`, `REF_DATA_BWD`
    EcmcDat,
    /// LinuxCNC compensation file of type 0: nominal, forward, backward position
    LinuxcncComp0,
    /// LinuxCNC compensation file of type 1: nominal, forward, backward correction
    LinuxcncComp1,
    /// A table with a header line, parted by commas, semicolons or tabs; --columns says what is in it
    Csv,
    /// A table as a file of your own describes it: --form
    Own,
    /// Coordinate measuring machine's table of holes: Meas X, Meas Y, Nom X, Nom Y, Nom D
    CmmPlate,
    /// Renishaw .rtl of linear targets, as other programs read it
    Rtl,
    /// Etalon exchange format: `[EXX] Gridpoints = { … }`
    Etalon,
    /// What LinuxCNC's halsampler prints
    Halsampler,
    /// A log of `MTConnect`'s SHDR lines: TIME|KEY|VALUE
    Shdr,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Decimal {
    Point,
    Comma,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum UnitName {
    Mm,
    Inch,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let asked = Asked {
        file: args.file.clone(),
        format: match args.format {
            Format::EcmcDat => Name::EcmcDat,
            Format::LinuxcncComp0 => Name::LinuxcncComp0,
            Format::LinuxcncComp1 => Name::LinuxcncComp1,
            Format::Csv => Name::Csv,
            Format::Own => Name::Own,
            Format::CmmPlate => Name::CmmPlate,
            Format::Rtl => Name::Rtl,
            Format::Etalon => Name::Etalon,
            Format::Halsampler => Name::Halsampler,
            Format::Shdr => Name::Shdr,
        },
        axis: args.axis.clone(),
        columns: args.columns.clone(),
        kind: args.kind.clone(),
        decimal_comma: args.decimal.map(|d| d == Decimal::Comma),
        log: args.log,
        period_s: args.period_s,
        numbered: args.numbered,
        unit: match args.unit {
            UnitName::Mm => Unit::Mm,
            UnitName::Inch => Unit::Inch,
        },
        form: args.form.clone(),
        derive: args.derive,
        circle: args.circle.circle()?,
        out: args.out.clone(),
    };
    let mut record = asked.read(&mut |said| match said {
        Said::Note(text) => eprintln!("{text}"),
        Said::Warning(text) => eprintln!("warning: {text}"),
    })?;
    record::write(&mut record).with_context(|| format!("writing {}", args.out.display()))?;
    if let Some(note) = &record.note {
        eprintln!("note: {note}");
    }
    suspicions::warn(std::slice::from_ref(&record));
    eprintln!("{}: {} rows, and {} beside it", args.out.display(), record.rows(), record.file);
    Ok(())
}
