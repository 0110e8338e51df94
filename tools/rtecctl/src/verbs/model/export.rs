//! `rtecctl model export`: a model's correction table for one axis, for a controller that compensates by itself.

use anyhow::Context;
use rtec_files::InputError;
use rtec_measure::export::linuxcnc::{LinuxCnc, Unit};
use rtec_measure::export::own::Own;
use rtec_measure::export::{Csv, Errors, Table, Wanted, beckhoff, siemens};
use rtec_model::date;
use rtec_model::machine::Machine;
use serde_json::json;
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
    #[arg(long, value_enum, default_value = "linuxcnc")]
    format: Format,
    /// linuxcnc: the machine's `LINEAR_UNITS`
    #[arg(long, value_enum, default_value = "mm")]
    unit: UnitName,
    /// siemens: the machine axis as the controller names it, as X1
    #[arg(long, required_if_eq("format", "siemens"))]
    axis_name: Option<String>,
    /// siemens: number of the encoder
    #[arg(long, default_value_t = 0)]
    encoder: u8,
    /// siemens, and forms that want a zero there: the reference point, mm
    #[arg(long, allow_negative_numbers = true, required_if_eq("format", "siemens"))]
    reference_mm: Option<f64>,
    /// ssfk: the controller's logical axis number
    #[arg(long, required_if_eq("format", "ssfk"))]
    axis_number: Option<u16>,
    /// own: the file that describes the form
    #[arg(long, value_name = "FORM.toml", required_if_eq("format", "own"))]
    form: Option<PathBuf>,
    /// The file
    #[arg(long)]
    out: PathBuf,
    /// What was written and what it leaves, as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    /// `COMP_FILE` of type 0: nominal, forward and reverse position
    Linuxcnc,
    /// `COMP_FILE` of type 1: nominal, forward and reverse trim
    #[value(name = "linuxcnc-type1")]
    LinuxcncType1,
    /// Beckhoff TF5200 and ISG kernel: leadscrew error compensation `kw.ssfk.*`, both directions
    Ssfk,
    /// SINUMERIK: `$AA_ENC_COMP`, the mean of both directions
    Siemens,
    /// `position_mm,error_up_um,error_down_um`
    Csv,
    /// A form of your own: --form
    Own,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum UnitName {
    Mm,
    Inch,
}

fn usage(found: impl Into<String>, expected: impl Into<String>) -> InputError {
    InputError::whole(Path::new("model export"), found, expected)
}

fn format(args: &Args) -> Result<Box<dyn rtec_measure::export::Format>, InputError> {
    let unit = match args.unit {
        UnitName::Mm => Unit::Mm,
        UnitName::Inch => Unit::Inch,
    };
    let linuxcnc = matches!(args.format, Format::Linuxcnc | Format::LinuxcncType1);
    if unit == Unit::Inch && !linuxcnc {
        return Err(usage("--unit inch", "--unit with LinuxCNC's tables only; the others are in mm"));
    }
    let reference_mm = args.reference_mm.unwrap_or(0.0);
    if !reference_mm.is_finite() {
        return Err(usage(format!("--reference-mm {reference_mm}"), "a position in mm"));
    }
    Ok(match args.format {
        Format::Linuxcnc | Format::LinuxcncType1 => {
            Box::new(LinuxCnc { trims: args.format == Format::LinuxcncType1, unit })
        }
        Format::Ssfk => Box::new(beckhoff::Ssfk {
            axis_number: args.axis_number.unwrap_or_default(),
            most: args.max_points.unwrap_or(beckhoff::MOST),
        }),
        Format::Siemens => Box::new(siemens::EncComp {
            axis: args.axis_name.clone().unwrap_or_default(),
            reference_mm,
            encoder: args.encoder,
            most: args.max_points.unwrap_or(siemens::MOST),
        }),
        Format::Csv => Box::new(Csv),
        Format::Own => {
            let form = args.form.as_deref().unwrap_or(Path::new(""));
            Box::new(Own::parse(form, &rtec_files::text::read(form)?, reference_mm)?)
        }
    })
}

/// Where a table goes beyond what the model was stated or seen on.
fn beyond(machine: &Machine, axis: &str, [from, to]: [f64; 2]) -> Vec<String> {
    let mut found = machine.beyond_stated(|a| {
        (a.as_str() == axis).then(|| (0..=100).map(|k| from + (to - from) * f64::from(k) / 100.0).collect())
    });
    let seen = machine.fits().iter().filter(|f| f.response == format!("error.{axis}"));
    for [lo, hi] in seen.filter_map(|f| f.at_mm.as_ref()?.get(axis).copied()) {
        let margin = 0.1 * (hi - lo);
        if from < lo - margin || to > hi + margin {
            found.push(format!(
                "the model was fitted from {lo:.1} to {hi:.1} mm of {axis}, and the table goes from {from} to {to} mm: no record has shown what the \
                 axis does there"
            ));
        }
    }
    found
}

/// A position in mm to the nanometre: 203.2, not 203.200 000 000 000 02.
fn short(mm: f64) -> f64 {
    (mm * 1e6).round() / 1e6
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let machine = Machine::read(&args.machine)?;
    let at = |p: &Path| p.canonicalize().ok();
    if at(&args.out).is_some_and(|out| Some(out) == at(&args.machine)) {
        return Err(usage(format!("--out {}", args.out.display()), "a file of its own, not the model").into());
    }
    let pairs = |option: &str, given: &[String], expected: &str| {
        let pair = |one: &String| {
            let parsed = one.split_once('=').and_then(|(n, v)| Some((n.to_owned(), v.parse::<f64>().ok()?)));
            parsed.ok_or_else(|| usage(format!("{option} {one}"), expected))
        };
        given.iter().map(pair).collect::<Result<Vec<_>, _>>()
    };
    let temperatures = pairs("--temperatures", &args.temperatures, "SENSOR=degC, as T8=31.5")?;
    let others = pairs("--at", &args.at, "AXIS=mm, as z=100")?;
    let errors = Errors::of(&machine, &args.axis, &temperatures, &others)?;
    let format = format(args)?;
    let wanted = Wanted {
        from_mm: args.from,
        to_mm: args.to,
        step_mm: args.step,
        limit_um: args.limit_um,
        most: args.max_points,
    };
    let table = Table::of(&errors, &wanted, &format.rules())?;
    let text = format.text(&table)?;
    let mut warnings = machine.doubts(date::today());
    warnings.extend(errors.doubts()?);
    warnings.extend(beyond(&machine, &args.axis, [args.from, args.to]));
    let (left, points) = (table.left, table.points.len());
    if table.between_um > args.limit_um {
        warnings.push(format!(
            "between its positions the table is up to {:.2} um off the model, more than the limit of {} um{}",
            table.between_um,
            args.limit_um,
            if args.step.is_some() {
                ": a smaller --step, or none"
            } else {
                ": the format takes no more positions"
            }
        ));
    }
    if table.end_mm() > args.to + 1e-9 {
        warnings.push(format!(
            "its last position, {} mm, is past --to {} mm: equal steps of {:.4} mm do not end there",
            short(table.end_mm()),
            args.to,
            table.step_mm
        ));
    }
    if left.max_um() > table.between_um + args.limit_um {
        warnings.push(format!(
            "one value serves both directions: what they differ by stays, up to {:.2} um in each",
            left.max_um()
        ));
    }
    rtec_files::write::whole(&args.out, text.as_bytes())
        .with_context(|| format!("writing {}", args.out.display()))?;
    for warning in &warnings {
        eprintln!("warning: {}: {warning}", args.machine.display());
    }
    eprintln!(
        "{}: axis {}, {points} positions, {:.4} mm apart, {} to {} mm",
        args.out.display(),
        table.axis,
        table.step_mm,
        short(table.points[0].position_mm),
        short(table.end_mm())
    );
    eprintln!(
        "it leaves of the model at most {:.2} um moving up and {:.2} um moving down, {:.2} um RMS",
        left.max_up_um, left.max_down_um, left.rms_um
    );
    let held = errors.temperatures_degc()?;
    if !held.is_empty() {
        let of = |(name, degc): &(&str, f64)| format!("{name} {degc}");
        let all = held.iter().map(of).collect::<Vec<_>>().join(", ");
        eprintln!("it holds at these temperatures: {all} degC; --temperatures states others");
    }
    if table.constant_um != 0.0 {
        eprintln!("{:+.2} um were taken out to make it zero at the reference point", table.constant_um);
    }
    for advice in format.advice(&table) {
        eprintln!("{advice}");
    }
    if args.json {
        let document = json!({
            "axis": table.axis.as_str(), "points": points, "step_mm": table.step_mm,
            "from_mm": table.points[0].position_mm, "to_mm": table.end_mm(),
            "max_up_um": left.max_up_um, "max_down_um": left.max_down_um, "rms_um": left.rms_um,
            "between_um": table.between_um, "constant_um": table.constant_um, "warnings": warnings,
            "temperatures_degC": held.iter().copied().collect::<std::collections::BTreeMap<&str, f64>>(),
        });
        println!("{document:#}");
    }
    Ok(())
}
