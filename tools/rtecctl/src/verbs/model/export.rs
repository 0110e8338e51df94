//! `rtecctl model export`: a model's correction table for one axis.
//! It is for a controller that compensates by itself.

use crate::document::say_pretty;
use crate::verbs::{one_of, pairs};
use clap::builder::{PossibleValuesParser, TypedValueParser};
use rtec_files::InputError;
use rtec_measure::export::TableRange;
use rtec_measure::export::linuxcnc::Unit;
use rtec_measure::export::request::{ExportFormat, ExportRequest};
use rtec_model::machine::Machine;
use std::path::{Path, PathBuf};

/// Write one axis' errors as a table for a controller that compensates by itself
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The machine model
    #[arg(long, value_name = "FILE")]
    machine: PathBuf,
    /// The axis
    #[arg(long)]
    axis: String,
    /// Lowest position, mm
    #[arg(long, allow_negative_numbers = true)]
    from: f64,
    /// Highest position, mm
    #[arg(long, allow_negative_numbers = true)]
    to: f64,
    /// Distance between positions, mm; chosen from the model where it is not given
    #[arg(long, allow_negative_numbers = true)]
    step: Option<f64>,
    /// How far the table may be off the model between its positions, um; a warning above
    #[arg(long, default_value_t = 0.5, allow_negative_numbers = true)]
    limit_um: f64,
    /// Most positions (linuxcnc 256; siemens 200 unless MD38000 says more; ssfk 1500 unless P-COMP-00059 says more)
    #[arg(long)]
    max_points: Option<usize>,
    /// Temperatures that the table holds for, as T8=31.5; others stand at 20 degC
    #[arg(long, value_delimiter = ',', value_name = "SENSOR=degC")]
    temperatures: Vec<String>,
    /// Where the other axes stand, as z=100,y=0 in mm; others stand at 0. What a chain or a cross error says of this axis
    /// depends on it
    #[arg(long, value_delimiter = ',', value_name = "AXIS=mm", allow_negative_numbers = true)]
    at: Vec<String>,
    /// What to write
    #[arg(long, value_parser = one_of(&ExportFormat::ALL, &[]), default_value = "linuxcnc")]
    format: ExportFormat,
    /// linuxcnc: the machine's `LINEAR_UNITS`
    #[arg(long, value_parser = one_of(&Unit::ALL, &[]), default_value = "mm")]
    unit: Unit,
    /// The axis that the table goes along, where it is another: what squareness, straightness and sag make of `--axis`
    #[arg(long)]
    along: Option<String>,
    /// siemens-cec: that axis as the controller names it, as X1
    #[arg(long)]
    along_name: Option<String>,
    /// siemens-cec: number of the table
    #[arg(long, default_value_t = 0)]
    table: u16,
    /// siemens-cec: which way a positive value moves the axis, as tried on the machine
    #[arg(long, value_parser = PossibleValuesParser::new(["up", "down"]).map(|way| way == "up"))]
    positive_moves: Option<bool>,
    /// siemens, siemens-cec: the machine axis as the controller names it, as X1
    #[arg(long, required_if_eq("format", "siemens"))]
    axis_name: Option<String>,
    /// siemens: number of the encoder
    #[arg(long, default_value_t = 0)]
    encoder: u8,
    /// siemens, siemens-cec, and forms that want a zero there: the reference point, mm
    #[arg(long, allow_negative_numbers = true, required_if_eq("format", "siemens"))]
    reference_mm: Option<f64>,
    /// ssfk: the controller's logical axis number
    #[arg(long, required_if_eq("format", "ssfk"))]
    axis_number: Option<u16>,
    /// own: the file that describes the form
    #[arg(long, value_name = "FORM.toml", required_if_eq("format", "own"))]
    form: Option<PathBuf>,
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
        wanted: TableRange {
            from_mm: args.from,
            to_mm: args.to,
            step_mm: args.step,
            limit_um: args.limit_um,
            most: args.max_points,
        },
        temperatures_degc: pairs(VERB, "--temperatures", &args.temperatures, "SENSOR=degC, as T8=31.5")?,
        at_mm: pairs(VERB, "--at", &args.at, "AXIS=mm, as z=100")?,
        format: args.format,
        unit: args.unit,
        along: args.along.clone(),
        along_name: args.along_name.clone(),
        table: args.table,
        positive_moves_up: args.positive_moves,
        axis_name: args.axis_name.clone(),
        encoder: args.encoder,
        reference_mm: args.reference_mm,
        axis_number: args.axis_number,
        form: args.form.clone(),
    };
    let done = order.of(&machine)?;
    crate::document::write(&args.out, &done.text)?;
    for warning in &done.warnings {
        eprintln!("warning: {}: {warning}", args.machine.display());
    }
    for (n, note) in done.notes.iter().enumerate() {
        let of = if n == 0 { format!("{}: ", args.out.display()) } else { String::new() };
        eprintln!("{of}{note}");
    }
    if args.json { say_pretty(&done.document) } else { Ok(()) }
}
