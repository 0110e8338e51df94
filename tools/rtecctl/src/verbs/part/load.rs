//! `rtecctl part load` and `unload`: the part table that the daemon takes out while the tool cuts.

use super::table::CutArgs;
use super::usage;
use crate::daemon::{Daemon, absolute};
use rtec_control::protocol::{ClientRequest, PartTable};
use rtec_part::errors::read_error_cor;
use std::path::PathBuf;

/// Have the daemon take out a part's errors in the finish cut
///
/// The daemon evaluates the table from the machine's position, ahead of it, on top of the machine model and the
/// operator's totals. It acts near the arc only. Corrections go to it in a ramp.
#[derive(Debug, clap::Args)]
pub(crate) struct LoadArgs {
    /// Errors by angle, as `part errors` writes them
    #[arg(long, value_name = "ERROR.COR")]
    errors: PathBuf,
    #[command(flatten)]
    cut: CutArgs,
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
    daemon: Daemon,
}

pub(crate) fn load(args: &LoadArgs) -> anyhow::Result<()> {
    let cut = args.cut.cut()?;
    if !(0.0..=1000.0).contains(&args.lead_ms) {
        return Err(usage("--lead-ms", args.lead_ms.to_string(), "a time in ms, 0 to 1000"));
    }
    // Found here, with line and column, before the daemon is asked.
    let points = read_error_cor(&args.errors)?.len();
    let table = PartTable {
        errors: absolute(&args.errors),
        axes: [args.z_axis.clone(), args.x_axis.clone()],
        centre_mm: [cut.centre.z, cut.centre.x],
        radius_mm: cut.radius_mm,
        nose_mm: cut.nose_mm,
        origin_mm: [cut.origin.z, cut.origin.x],
        lead_ms: args.lead_ms,
    };
    args.daemon.order(&ClientRequest::TableLoad(table), &format!("part table of {points} points loaded"))
}

pub(crate) fn unload(daemon: &Daemon) -> anyhow::Result<()> {
    daemon.order(&ClientRequest::TableUnload {}, "part table unloaded; corrections go back in a ramp")
}
