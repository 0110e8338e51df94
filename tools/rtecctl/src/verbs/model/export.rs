//! `rtecctl model export`: a model's correction table for one axis, for a controller that compensates by itself.

use anyhow::Context;
use rtec_files::InputError;
use rtec_model::along::Standing;
use rtec_model::date;
use rtec_model::machine::Machine;
use rtec_model::record::Axis;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Write one axis' errors as a table: LinuxCNC compensation file or CSV
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
    /// Distance between positions, mm
    #[arg(long)]
    step: f64,
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
    /// The file
    #[arg(long)]
    out: PathBuf,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    /// `COMP_FILE` of type 0: nominal, forward and backward position, mm
    Linuxcnc,
    /// `position_mm,error_up_um,error_down_um`
    Csv,
}

/// LinuxCNC takes no more points than this.
const LINUXCNC_POINTS: usize = 256;

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let usage = |found: String, expected: &str| InputError::whole(Path::new("model export"), found, expected);
    let machine = Machine::read(&args.machine)?;
    for warning in machine.doubts(date::today()) {
        eprintln!("warning: {}: {warning}", args.machine.display());
    }
    let axis =
        Axis::new(&args.axis).ok_or_else(|| usage(format!("--axis {}", args.axis), "an axis' name"))?;
    let span = args.to - args.from;
    if !(span > 0.0 && args.step > 0.0 && span.is_finite()) {
        let found = format!("--from {} --to {} --step {}", args.from, args.to, args.step);
        return Err(usage(found, "a range that rises, and a step above zero").into());
    }
    let points = (span / args.step + 1e-9).floor() as usize + 1;
    if args.format == Format::Linuxcnc && points > LINUXCNC_POINTS {
        return Err(
            usage(format!("{points} points"), "at most 256, as LinuxCNC takes; a larger --step").into()
        );
    }
    let standing = standing(args, &machine, &axis)?;
    let positions: Vec<f64> = (0..points).map(|i| args.from + args.step * i as f64).collect();
    let along = |direction: f64| {
        let errors = machine.along_um(&axis, &positions, direction, &standing);
        errors.map_err(|e| usage(e.to_string(), "sensors and axes only"))
    };
    let errors = [along(1.0)?, along(-1.0)?];
    let mut text = match args.format {
        Format::Linuxcnc => {
            format!("# COMP_FILE_TYPE = 0 for axis {}, from {}\n", args.axis, args.machine.display())
        }
        Format::Csv => "position_mm,error_up_um,error_down_um\n".to_owned(),
    };
    for (i, (up, down)) in errors[0].iter().zip(&errors[1]).enumerate() {
        let p = positions[i];
        let _ = match args.format {
            Format::Linuxcnc => writeln!(text, "{p:.6} {:.6} {:.6}", p + up / 1000.0, p + down / 1000.0),
            Format::Csv => writeln!(text, "{p},{up},{down}"),
        };
    }
    rtec_files::write::whole(&args.out, text.as_bytes())
        .with_context(|| format!("writing {}", args.out.display()))
}

/// Temperatures and the other axes' places, as the command line gives them.
fn standing(args: &Args, machine: &Machine, axis: &Axis) -> Result<Standing, InputError> {
    let usage =
        |found: String, expected: String| InputError::whole(Path::new("model export"), found, expected);
    let pairs = |given: &[String], option: &str, names: &[String], what: &str, unit: &str| {
        let mut pairs = Vec::new();
        for one in given {
            let parsed = one.split_once('=').and_then(|(n, v)| Some((n, v.parse::<f64>().ok()?)));
            let known = parsed.filter(|(n, v)| v.is_finite() && names.iter().any(|x| x == n));
            let (n, v) = known.ok_or_else(|| {
                let of = if names.is_empty() { "the model reads none".to_owned() } else { names.join(", ") };
                usage(format!("{option} {one}"), format!("{what}={unit}, {what} of: {of}"))
            })?;
            pairs.push((n.to_owned(), v));
        }
        Ok(pairs)
    };
    let others = machine.other_axes(axis);
    let names: Vec<String> = others.iter().map(|a| a.as_str().to_owned()).collect();
    let at = pairs(&args.at, "--at", &names, "axis", "mm")?;
    let not_stated: Vec<&str> =
        (names.iter().filter(|n| !at.iter().any(|(a, _)| a == *n))).map(String::as_str).collect();
    if !not_stated.is_empty() && (machine.chain().is_some() || !at.is_empty()) {
        eprintln!(
            "warning: the table holds with {} at 0 mm; --at states another place",
            not_stated.join(", ")
        );
    }
    Ok(Standing {
        others_mm: at.into_iter().filter_map(|(n, v)| Some((Axis::new(&n)?, v))).collect(),
        degc: pairs(&args.temperatures, "--temperatures", &machine.sensors(), "SENSOR", "degC")?,
    })
}
