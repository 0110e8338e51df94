//! `rtecctl part load` and `unload`: the part table in the daemon.
//! The daemon removes its errors while the tool cuts.

use super::table::FinishCutArgs;
use super::within;
use crate::daemon_connection::{DaemonArgs, absolute};
use rtec_control::protocol::{ClientRequest, PartTable};
use rtec_files::text_file::open_regular;
use rtec_part::error_cor_file::FeatureErrors;
use std::path::PathBuf;

/// Have the daemon take out a part's errors in the finish cut
///
/// The daemon evaluates the table from the machine's position, ahead of it, on top of the machine model and the
/// operator's totals. It acts near the arc, or near the cylinder, face or taper, only. Corrections go to it in a ramp.
#[derive(Debug, clap::Args)]
pub(crate) struct LoadArgs {
    /// Errors as `part errors` writes them: by angle of an arc, by place of a straight feature
    #[arg(long, value_name = "ERROR.COR")]
    errors: PathBuf,
    #[command(flatten)]
    cut: FinishCutArgs,
    /// Ask for each correction this long before the tool is there, in ms
    #[arg(long, default_value_t = 50.0)]
    lead_ms: f64,
    /// The daemon's axis along the part
    #[arg(long, default_value = "z")]
    z_axis: String,
    /// The daemon's axis across the part
    #[arg(long, default_value = "x")]
    x_axis: String,
    #[command(flatten)]
    daemon: DaemonArgs,
}

pub(crate) fn load(args: &LoadArgs) -> anyhow::Result<()> {
    within("--lead-ms", args.lead_ms, 0.0..=1000.0, "a time in ms, 0 to 1000")?;
    // Mistakes are found here, with line and column, before the daemon is asked.
    let errors = FeatureErrors::read(&args.errors)?;
    let (points, [low_um, high_um]) = (errors.len(), errors.range_um());
    let arc = match errors {
        FeatureErrors::Arc(_) => Some(args.cut.cut()?),
        FeatureErrors::Line(_) => {
            args.cut.is_of_no_arc()?;
            None
        }
    };
    let (nose_mm, origin) = args.cut.tool()?;
    let table = PartTable {
        errors: absolute(&args.errors),
        axes: [args.z_axis.clone(), args.x_axis.clone()],
        centre_mm: arc.map(|cut| [cut.centre.z, cut.centre.x]),
        radius_mm: arc.map(|cut| cut.radius_mm),
        nose_mm,
        hollow: args.cut.hollow,
        origin_mm: [origin.z, origin.x],
        lead_ms: args.lead_ms,
    };
    let files = [open_regular(&args.errors)?];
    args.daemon.ask_with(&ClientRequest::TableLoad(table), &files)?;
    if !args.daemon.json {
        println!(
            "part table of {points} points loaded: surface {low_um:+.1} to {high_um:+.1} µm off, taken out near it"
        );
    }
    Ok(())
}

pub(crate) fn unload(daemon: &DaemonArgs) -> anyhow::Result<()> {
    daemon.order(&ClientRequest::TableUnload {}, "part table unloaded; corrections go back in a ramp")
}
