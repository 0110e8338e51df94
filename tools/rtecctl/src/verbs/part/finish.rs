//! `rtecctl part finish`: a simulated cut around the nose.
//! It runs with or without the corrector's table.

use super::points::positive;
use super::simulated_machine_args::SimMachineArgs;
use super::{failed, within, write_all};
use crate::prelude::*;
use rtec_model::machine::Machine;
use rtec_part::arc_finish_cut_table::ArcFinishCutTable;
use rtec_part::error_cor_file::read_arc;
use rtec_part::geometric_fit::Zx;
use rtec_sim::lathe::{axes, design};
use rtec_sim::workpiece::Workpiece;

/// Cut the nose on the simulated machine, with the errors' table loaded
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The workpiece to cut on; without one a raw part, 1 mm larger
    #[arg(long)]
    workpiece: Option<PathBuf>,
    /// Errors to take out, as `part errors` writes them; without them the cut is not corrected
    #[arg(long, value_name = "ERROR.COR")]
    errors: Option<PathBuf>,
    /// What is known of the machine: corrected live, beneath the table or alone
    #[arg(long, value_name = "MACHINE.TOML")]
    model: Option<PathBuf>,
    /// Radius to cut to, in mm
    #[arg(long)]
    radius_mm: f64,
    /// Centre of the nose on the part's axis, in mm; a workpiece brings its own
    #[arg(long, default_value_t = 127.0, allow_negative_numbers = true)]
    centre_z_mm: f64,
    #[command(flatten)]
    bench: SimMachineArgs,
    /// Folder for workpiece.csv
    #[arg(long)]
    out: PathBuf,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let mut setup = args.bench.setup()?;
    setup.model = args.model.as_deref().map(Machine::read).transpose()?;
    let radius_mm = positive("--radius-mm", args.radius_mm)?;
    within("--centre-z-mm", args.centre_z_mm, f64::MIN..=f64::MAX, "a finite number")?;
    let mut part = match &args.workpiece {
        Some(file) => Workpiece::read(file)?,
        None => Workpiece::raw(Zx::new(args.centre_z_mm, 0.0), radius_mm + 1.0),
    };
    setup.centre = part.centre;
    let table = match (&args.errors, design(&setup.design)) {
        (Some(file), Some(design)) => {
            Some(ArcFinishCutTable::new(setup.cut(radius_mm), axes(&setup.bench, design), read_arc(file)?))
        }
        _ => None,
    };
    let ran = setup.turn(&mut part, radius_mm, table.as_ref(), setup.seed).map_err(failed)?;
    write_all(&args.out, &[("workpiece.csv", part.to_csv())])?;
    let insertions = [0, 1].map(|n| ran.status.axes[n].insertions);
    let completed = [0, 1].map(|n| ran.status.axes[n].completed);
    let document = serde_json::json!({"seconds": ran.seconds, "insertions": insertions,
        "completed": completed, "mtc_minus_scale": ran.mtc_minus_scale, "corrected": table.is_some()});
    let how = match (&table, &setup.model) {
        (Some(_), Some(_)) => "with the table on top of the model",
        (Some(_), None) => "with the table",
        (None, Some(_)) => "with the model",
        (None, None) => "without corrections",
    };
    let (seconds, [z, x]) = (ran.seconds, insertions);
    answer(args.json, &document, || {
        format!("cut to {radius_mm} mm {how} in {seconds:.1} s: {z} insertions in Z, {x} in X\n")
    })
}
