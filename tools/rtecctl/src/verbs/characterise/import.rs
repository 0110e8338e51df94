//! `rtecctl characterise import`: other tools' files as run records.

use crate::verbs::suspicions;
use anyhow::Context;
use rtec_files::InputError;
use rtec_measure::export::linuxcnc::Unit;
use rtec_measure::import::{self, Form, ImportColumn, Own};
use rtec_measure::{derive::derive, record};
use rtec_model::record::{Axis, Kind, Record};
use std::path::{Path, PathBuf};

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
    #[arg(long, value_name = "NAME.run.toml")]
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

/// Whether two paths lead to one file that is there.
fn same_file(a: &Path, b: &Path) -> bool {
    a.canonicalize().ok().zip(b.canonicalize().ok()).is_some_and(|(a, b)| a == b)
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let text = match args.format {
        Format::Rtl => import::any_text(&args.file, &rtec_files::text::bytes(&args.file)?)?,
        _ => rtec_files::text::read(&args.file)?,
    };
    let (file, out) = (args.file.as_path(), args.out.as_path());
    let axis = || -> Result<Axis, InputError> {
        let name = args.axis.as_deref().unwrap_or_default();
        let found = if name.is_empty() { "no --axis".to_owned() } else { format!("--axis {name}") };
        Axis::new(name).ok_or_else(|| InputError::whole(file, found, "--axis with the axis' name"))
    };
    let columns = || {
        let usage = |(found, expected)| InputError::whole(Path::new("--columns"), found, expected);
        args.columns.iter().map(|c| ImportColumn::parse(c).map_err(usage)).collect::<Result<Vec<_>, _>>()
    };
    let kind = || {
        Kind::parse(&args.kind).ok_or_else(|| {
            let kinds = "positioning, drift, ballbar, plate, dynamics, probing, feed_sweep or part";
            InputError::whole(Path::new("--kind"), format!("`{}`", args.kind), kinds)
        })
    };
    let unit = match args.unit {
        UnitName::Mm => Unit::Mm,
        UnitName::Inch => Unit::Inch,
    };
    let form =
        Form { decimal_comma: args.decimal.map(|d| d == Decimal::Comma), log: args.log, ..Form::default() };
    let read = || -> Result<Record, InputError> {
        Ok(match args.format {
            Format::EcmcDat => import::ecmc_dat(file, &text, &axis()?, out)?,
            Format::LinuxcncComp0 | Format::LinuxcncComp1 => {
                import::linuxcnc_comp(file, &text, &axis()?, args.format == Format::LinuxcncComp1, unit, out)?
            }
            Format::Csv => import::table(file, &text, &columns()?, &form, kind()?, out)?,
            Format::Own => {
                let path = args.form.as_deref().unwrap_or(Path::new(""));
                Own::parse(path, &rtec_files::text::read(path)?)?.read(file, &text, out)?
            }
            Format::CmmPlate => import::cmm_plate(file, &text, out)?,
            Format::Rtl => import::rtl(file, &text, &axis()?, out)?,
            Format::Etalon => import::etalon(file, &text, &axis()?, out)?,
            Format::Halsampler => {
                let sampling =
                    import::Sampling { period_s: args.period_s.unwrap_or_default(), numbered: args.numbered };
                import::halsampler(file, &text, &columns()?, &sampling, &form, kind()?, out)?
            }
            Format::Shdr => import::shdr(file, &text, &columns()?, kind()?, args.log, out)?,
        })
    };
    // What is wrong with its columns is wrong in the file that was given: the record is not written yet.
    let mut record =
        read().map_err(|e| if e.file == out { InputError { file: file.to_owned(), ..e } } else { e })?;
    if matches!(args.format, Format::LinuxcncComp0 | Format::LinuxcncComp1) {
        let unit = if unit == Unit::Inch { "inches, written in mm and µm" } else { "mm" };
        eprintln!("positions and corrections were read in {unit}: --unit states another");
    }
    record = args.circle.apply(record)?;
    if args.derive {
        for note in derive(&mut record) {
            eprintln!("{note}");
            import::add_note(&mut record, &note);
        }
    }
    let csv = out.parent().unwrap_or(Path::new("")).join(&record.file);
    if same_file(&csv, file) || same_file(out, file) {
        let found = format!("--out {}: its CSV would be written over the file to import", out.display());
        return Err(InputError::whole(file, found, "another name or folder for --out").into());
    }
    record::write(&mut record).with_context(|| format!("writing {}", args.out.display()))?;
    if let Some(note) = &record.note {
        eprintln!("note: {note}");
    }
    suspicions::warn(std::slice::from_ref(&record));
    eprintln!("{}: {} rows, and {} beside it", args.out.display(), record.rows(), record.file);
    Ok(())
}
