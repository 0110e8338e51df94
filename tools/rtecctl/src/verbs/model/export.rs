//! `rtecctl model export`: a model's correction table for one axis, for a controller that compensates by itself.

use anyhow::Context;
use rtec_files::InputError;
use rtec_model::date;
use rtec_model::live::{AxisNow, Frame, Layout, Live};
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
    let names = machine.sensors();
    let mut degc = vec![20.0; names.len()];
    for given in &args.temperatures {
        let parsed = given.split_once('=').and_then(|(n, v)| Some((n, v.parse::<f64>().ok()?)));
        let place = parsed.and_then(|(n, v)| Some((names.iter().position(|x| x == n)?, v)));
        let (place, v) = place.ok_or_else(|| {
            usage(
                format!("--temperatures {given}"),
                &format!("SENSOR=degC, a sensor of {}", names.join(", ")),
            )
        })?;
        degc[place] = v;
    }
    let layout = Layout { axes: vec![axis], sensors: names, channels: Vec::new() };
    let mut errors = Vec::new();
    for direction in [1.0, -1.0] {
        // At rest at every point, approached from one side: what depends on speed, time and load stays out.
        let mut live =
            Live::of(&machine, layout.clone()).map_err(|e| usage(e.to_string(), "sensors and axes only"))?;
        let at = |i: usize| args.from + args.step * i as f64;
        let mut column = vec![0.0; points];
        let order: Vec<usize> =
            if direction > 0.0 { (0..points).collect() } else { (0..points).rev().collect() };
        for i in order {
            let now = AxisNow { position_mm: at(i), direction, ..AxisNow::default() };
            live.evaluate(&Frame { axes: &[now], temperatures_degc: &degc, ..Frame::default() });
            column[i] = live.errors_um()[0];
        }
        errors.push(column);
    }
    let mut text = match args.format {
        Format::Linuxcnc => {
            format!("# COMP_FILE_TYPE = 0 for axis {}, from {}\n", args.axis, args.machine.display())
        }
        Format::Csv => "position_mm,error_up_um,error_down_um\n".to_owned(),
    };
    for (i, (up, down)) in errors[0].iter().zip(&errors[1]).enumerate() {
        let p = args.from + args.step * i as f64;
        let _ = match args.format {
            Format::Linuxcnc => writeln!(text, "{p:.6} {:.6} {:.6}", p + up / 1000.0, p + down / 1000.0),
            Format::Csv => writeln!(text, "{p},{up},{down}"),
        };
    }
    rtec_files::write::whole(&args.out, text.as_bytes())
        .with_context(|| format!("writing {}", args.out.display()))
}
