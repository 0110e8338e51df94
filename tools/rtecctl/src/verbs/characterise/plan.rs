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
    /// Radius of the ballbar, mm
    #[arg(long, default_value_t = 150.0)]
    ballbar_mm: f64,
    /// Write the sequence as Markdown
    #[arg(long, value_name = "FILE.md")]
    out: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let usage =
        |found: String, expected: &str| InputError::whole(Path::new("characterise plan"), found, expected);
    let mut axes = Vec::new();
    for text in &args.axes {
        let parsed = text.split_once('=').and_then(|(n, t)| Some((Axis::new(n)?, t.parse::<f64>().ok()?)));
        let (axis, travel_mm) = parsed
            .filter(|(_, t)| t.is_finite() && *t > 0.0)
            .ok_or_else(|| usage(format!("--axes {text}"), "AXIS=TRAVEL in mm, as x=500"))?;
        axes.push(PlanAxis { name: axis.to_string(), travel_mm });
    }
    for (name, v) in [("--max-rpm", args.max_rpm), ("--ballbar-mm", args.ballbar_mm)] {
        if !(v.is_finite() && v > 0.0) {
            return Err(usage(format!("{name} {v}"), "a number above zero").into());
        }
    }
    let steps = plan::sequence(&axes, args.max_rpm, args.ballbar_mm);
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
