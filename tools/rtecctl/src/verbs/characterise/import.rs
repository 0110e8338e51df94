//! `rtecctl characterise import`: other tools' files as run records.

use anyhow::Context;
use rtec_driver::input::InputError;
use rtec_model::record::Axis;
use rtec_model::{document, import};
use std::path::PathBuf;

/// Turn another tool's file into a run record
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The file to import
    file: PathBuf,
    /// What it is
    #[arg(long, value_enum)]
    format: Format,
    /// The axis that was measured (not for plates)
    #[arg(long)]
    axis: Option<String>,
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
    /// Coordinate measuring machine's table of holes: Meas X, Meas Y, Nom X, Nom Y, Nom D
    CmmPlate,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let text = document::read(&args.file)?;
    let axis = || -> Result<Axis, InputError> {
        let name = args.axis.as_deref().unwrap_or_default();
        let found = if name.is_empty() { "no --axis".to_owned() } else { format!("--axis {name}") };
        Axis::new(name).ok_or_else(|| InputError::whole(&args.file, found, "--axis with the axis' name"))
    };
    let mut record = match args.format {
        Format::EcmcDat => import::ecmc_dat(&args.file, &text, &axis()?, &args.out)?,
        Format::LinuxcncComp0 => import::linuxcnc_comp(&args.file, &text, &axis()?, false, &args.out)?,
        Format::LinuxcncComp1 => import::linuxcnc_comp(&args.file, &text, &axis()?, true, &args.out)?,
        Format::CmmPlate => import::cmm_plate(&args.file, &text, &args.out)?,
    };
    record.write().with_context(|| format!("writing {}", args.out.display()))?;
    eprintln!("{}: {} rows, and {} beside it", args.out.display(), record.rows(), record.file);
    Ok(())
}
