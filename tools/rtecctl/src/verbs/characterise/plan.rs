//! `rtecctl characterise plan`: the test sequence for this machine.

use crate::verbs::suspicions;
use anyhow::Context;
use rtec_files::InputError;
use rtec_measure::plan::{self, PlanAxis};
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

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let mut axes: Vec<PlanAxis> = Vec::new();
    for text in &args.axes {
        let parsed = text.split_once('=').and_then(|(n, t)| Some((n.to_owned(), t.parse::<f64>().ok()?)));
        let (name, travel_mm) = parsed.ok_or_else(|| {
            let expected = "AXIS=TRAVEL in mm, as x=500";
            InputError::whole(Path::new("characterise plan"), format!("--axes {text}"), expected)
        })?;
        axes.push(PlanAxis { name, travel_mm });
    }
    let steps = plan::for_machine(&axes, args.max_rpm, args.ballbar_mm, &mut suspicions::said)?;
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
