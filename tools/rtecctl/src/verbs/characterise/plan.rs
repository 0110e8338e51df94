//! `rtecctl characterise plan`: the test sequence for this machine.

use anyhow::Context;
use rtec_files::InputError;
use rtec_measure::plan::{self, PlanAxis};
use rtec_model::record::Axis;
use std::path::{Path, PathBuf};

/// Write the test sequence for this machine: what to mount where, how to move, what to record
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The machine's name
    #[arg(long, default_value = "the machine")]
    machine: String,
    /// Axes with their travel, as x=500,y=400,z=300 (mm)
    #[arg(long, value_delimiter = ',', required = true, value_name = "AXIS=mm")]
    axes: Vec<String>,
    /// Highest spindle speed, rpm
    #[arg(long, default_value_t = 6000.0)]
    max_rpm: f64,
    /// Radius of the ballbar, mm [default: the longest of 150, 100 and 50 whose circle fits every axis]
    #[arg(long)]
    ballbar_mm: Option<f64>,
    /// Write the sequence as Markdown
    #[arg(long, value_name = "FILE.md")]
    out: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// Bars that are usual, longest first, mm.
const BARS_MM: [f64; 3] = [150.0, 100.0, 50.0];

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let usage =
        |found: String, expected: &str| InputError::whole(Path::new("characterise plan"), found, expected);
    let mut axes: Vec<PlanAxis> = Vec::new();
    for text in &args.axes {
        let parsed = text.split_once('=').and_then(|(n, t)| Some((Axis::new(n)?, t.parse::<f64>().ok()?)));
        let (axis, travel_mm) = parsed
            .filter(|(_, t)| t.is_finite() && *t > 0.0)
            .ok_or_else(|| usage(format!("--axes {text}"), "AXIS=TRAVEL in mm, as x=500"))?;
        if axes.iter().any(|a| a.name == axis.to_string()) {
            return Err(usage(format!("--axes {text}: {axis} a second time"), "each axis once").into());
        }
        axes.push(PlanAxis { name: axis.to_string(), travel_mm });
    }
    let given = [("--max-rpm", Some(args.max_rpm)), ("--ballbar-mm", args.ballbar_mm)];
    for (name, v) in given.into_iter().filter_map(|(name, v)| Some((name, v?))) {
        if !(v.is_finite() && v > 0.0) {
            return Err(usage(format!("{name} {v}"), "a number above zero").into());
        }
    }
    let shortest = axes.iter().map(|a| a.travel_mm).fold(f64::INFINITY, f64::min);
    if let Some(radius) = args.ballbar_mm.filter(|r| axes.len() > 1 && 2.0 * r > shortest) {
        let found =
            format!("--ballbar-mm {radius}: a circle {} mm across on an axis of {shortest} mm", 2.0 * radius);
        return Err(usage(found, "a bar whose circle fits every axis").into());
    }
    let bar_mm = args.ballbar_mm.or_else(|| BARS_MM.into_iter().find(|r| 2.0 * r <= shortest));
    if bar_mm.is_none() && axes.len() > 1 {
        eprintln!(
            "rtecctl: no circles: none of the bars of 150, 100 and 50 mm fits an axis of {shortest} mm; --ballbar-mm names another"
        );
    }
    let steps = plan::sequence(&axes, args.max_rpm, bar_mm);
    let text = plan::markdown(&args.machine, &steps);
    if let Some(path) = &args.out {
        rtec_files::write::whole(path, text.as_bytes())
            .with_context(|| format!("writing {}", path.display()))?;
    }
    if args.json {
        println!("{}", serde_json::to_string_pretty(&steps)?);
    } else if args.out.is_none() {
        print!("{text}");
    }
    Ok(())
}
