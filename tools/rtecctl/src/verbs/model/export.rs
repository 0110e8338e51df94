//! `rtecctl model export`: a model's correction table for one axis.
//! It is for a controller that compensates by itself.

use crate::prelude::*;
use crate::verbs::pairs;
use rtec_measure::compensation_export::TableRange;
use rtec_measure::compensation_export::request::{ControllerTableFormat, ExportRequest};
use rtec_model::machine::Machine;

/// Write one axis' errors as a table for a controller that compensates by itself
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The machine model
    #[arg(long, value_name = "FILE")]
    machine: PathBuf,
    /// The axis
    #[arg(long)]
    axis: String,
    #[command(flatten)]
    range: TableRange,
    /// Temperatures that the table holds for, as T8=31.5; others stand at 20 degC
    #[arg(long, value_delimiter = ',', value_name = "SENSOR=degC")]
    temperatures: Vec<String>,
    /// Where the other axes stand, as z=100,y=0 in mm; others stand at 0. What a chain or a cross error says of this axis
    /// depends on it
    #[arg(long, value_delimiter = ',', value_name = "AXIS=mm", allow_negative_numbers = true)]
    at: Vec<String>,
    #[command(flatten)]
    to: ControllerTableFormat,
    /// The file
    #[arg(long, value_parser = crate::verbs::output())]
    out: PathBuf,
    /// What was written and what it leaves, as JSON
    #[arg(long)]
    json: bool,
}

const VERB: &str = "model export";

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let machine = Machine::read(&args.machine)?;
    let at = |p: &Path| p.canonicalize().ok();
    if at(&args.out).is_some_and(|out| Some(out) == at(&args.machine)) {
        let (found, expected) = (format!("--out {}", args.out.display()), "a file of its own, not the model");
        return Err(InputError::whole(Path::new(VERB), found, expected).into());
    }
    let order = ExportRequest {
        axis: args.axis.clone(),
        wanted: args.range.clone(),
        temperatures_degc: pairs(VERB, "--temperatures", &args.temperatures, "SENSOR=degC, as T8=31.5")?,
        at_mm: pairs(VERB, "--at", &args.at, "AXIS=mm, as z=100")?,
        to: args.to.clone(),
    };
    let done = order.of(&machine)?;
    crate::json_output::write(&args.out, &done.text)?;
    for warning in &done.warnings {
        eprintln!("warning: {}: {warning}", args.machine.display());
    }
    for (n, note) in done.notes.iter().enumerate() {
        let of = if n == 0 { format!("{}: ", args.out.display()) } else { String::new() };
        eprintln!("{of}{note}");
    }
    if args.json { say_pretty(&done.document) } else { Ok(()) }
}
