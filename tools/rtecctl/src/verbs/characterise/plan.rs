//! `rtecctl characterise plan`: the test sequence for this machine.

use crate::prelude::*;
use crate::verbs::{input_notices, pairs};
use rtec_measure::plan::{self, PlanAxis};
use rtec_model::machine::Machine;
use rtec_reconcile::{NextRuns, UnresolvedEffect, next_runs};

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
    /// Plan only the runs that tell what this verdict could not tell apart
    #[arg(long, value_name = "verdict.json")]
    verdict: Option<PathBuf>,
    /// The model that the verdict was made with [default: an ideal machine]
    #[arg(long, value_name = "machine.toml", requires = "verdict")]
    model: Option<PathBuf>,
    /// Write the sequence as Markdown
    #[arg(long, value_name = "FILE.md")]
    out: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let axis = |(name, travel_mm)| PlanAxis { name, travel_mm };
    let axes = pairs("characterise plan", "--axes", &args.axes, "AXIS=TRAVEL in mm, as x=500")?;
    let axes: Vec<PlanAxis> = axes.into_iter().map(axis).collect();
    if let Some(verdict) = &args.verdict {
        return telling(args, verdict, &axes);
    }
    let steps = plan::for_machine(&axes, args.max_rpm, args.ballbar_mm, &mut input_notices::said)?;
    give(args, &plan::markdown(&args.machine, &steps), &steps)
}

/// Writes the plan to its file, and prints what was asked for.
fn give(args: &Args, text: &str, document: &impl serde::Serialize) -> anyhow::Result<()> {
    if let Some(path) = &args.out {
        crate::json_output::write(path, text)?;
    }
    if args.json {
        say_pretty(document)?;
    } else if args.out.is_none() {
        say(text);
    }
    Ok(())
}

/// The runs that distinguish an effect from its rivals, with each run's purpose.
fn telling(args: &Args, verdict: &Path, axes: &[PlanAxis]) -> anyhow::Result<()> {
    plan::check(axes, args.max_rpm, args.ballbar_mm)?;
    let machine = Machine::read_or_ideal(args.model.as_deref(), &args.machine)?;
    let found = next_runs(&UnresolvedEffect::read(verdict, machine.dictionary())?, &machine, axes);
    give(args, &said(&args.machine, &found), &found)
}

fn said(machine: &str, found: &NextRuns) -> String {
    if found.tells.is_empty() {
        return format!("# Characterisation of {machine}\n\nThe verdict leaves nothing to be told apart.\n");
    }
    let mut out = plan::markdown(machine, &found.steps);
    out.push_str("\n## What they tell\n\n| effect | rival | log odds to expect | by |\n|---|---|---|---|\n");
    for t in &found.tells {
        let odds = t.log_odds.map_or_else(|| "–".to_owned(), |o| format!("{o:.0}"));
        let _ = writeln!(out, "| {} | {} | {odds} | {} |", t.effect, t.rival, t.by);
    }
    out
}
