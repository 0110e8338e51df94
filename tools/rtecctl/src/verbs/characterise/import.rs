//! `rtecctl characterise import`: other tools' files as run records.

use anyhow::Context;
use rtec_files::InputError;
use rtec_measure::import;
use rtec_measure::import::ImportColumn;
use rtec_model::record::{Axis, Kind};
use std::path::{Path, PathBuf};

/// Turn another tool's file into a run record
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The file to import
    file: PathBuf,
    /// What it is
    #[arg(long, value_enum)]
    format: Format,
    /// The axis that was measured (not for plates and CSV)
    #[arg(long)]
    axis: Option<String>,
    /// CSV: its columns with their roles, and the unit where it is not the role's own, as t=time:min,gz=error.z:mm
    #[arg(long, value_delimiter = ',', value_name = "NAME=ROLE[:UNIT]", required_if_eq("format", "csv"))]
    columns: Vec<String>,
    /// CSV: what kind of run it is
    #[arg(long, default_value = "drift")]
    kind: String,
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
    /// Coordinate measuring machine's table of holes: Meas X, Meas Y, Nom X, Nom Y, Nom D
    CmmPlate,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let text = rtec_files::text::read(&args.file)?;
    let axis = || -> Result<Axis, InputError> {
        let name = args.axis.as_deref().unwrap_or_default();
        let found = if name.is_empty() { "no --axis".to_owned() } else { format!("--axis {name}") };
        Axis::new(name).ok_or_else(|| InputError::whole(&args.file, found, "--axis with the axis' name"))
    };
    let mut record = match args.format {
        Format::EcmcDat => import::ecmc_dat(&args.file, &text, &axis()?, &args.out)?,
        Format::LinuxcncComp0 => import::linuxcnc_comp(&args.file, &text, &axis()?, false, &args.out)?,
        Format::LinuxcncComp1 => import::linuxcnc_comp(&args.file, &text, &axis()?, true, &args.out)?,
        Format::Csv => {
            let usage = |(found, expected)| InputError::whole(Path::new("--columns"), found, expected);
            let wanted = args.columns.iter().map(|c| ImportColumn::parse(c)).collect::<Result<Vec<_>, _>>();
            let kind = Kind::parse(&args.kind).ok_or_else(|| {
                let kinds = "positioning, drift, ballbar, plate, dynamics, probing, feed_sweep or part";
                InputError::whole(Path::new("--kind"), format!("`{}`", args.kind), kinds)
            })?;
            import::csv(&args.file, &text, &wanted.map_err(usage)?, kind, &args.out)?
        }
        Format::CmmPlate => import::cmm_plate(&args.file, &text, &args.out)?,
    };
    record = args.circle.apply(record)?;
    rtec_measure::record::write(&mut record).with_context(|| format!("writing {}", args.out.display()))?;
    eprintln!("{}: {} rows, and {} beside it", args.out.display(), record.rows(), record.file);
    Ok(())
}
