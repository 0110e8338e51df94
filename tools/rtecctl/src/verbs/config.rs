//! `rtecctl config`: is a configuration right, and if not, where.

use crate::terminal::{self, Tone, toned};
use clap::Subcommand;
use rtec_control::config::{Config, ConfigFindings, EMBEDDED};
use serde_json::json;
use std::path::PathBuf;

/// Check a configuration, or print the embedded one
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Explain every finding with its line; exit 0 when there is none, 2 otherwise
    Check {
        /// The configuration
        file: PathBuf,
        /// It is for another computer: groups, cards, devices, recordings and the model that it names are not looked for here
        #[arg(long)]
        elsewhere: bool,
        /// Say nothing where it is right
        #[arg(long, short, conflicts_with = "json")]
        quiet: bool,
        /// Print one JSON document
        #[arg(long)]
        json: bool,
    },
    /// Print the configuration that stands without a file, as a start for your own
    Default,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    match &args.what {
        What::Default => print!("{EMBEDDED}"),
        What::Check { file, elsewhere, quiet, json } => {
            let config = if *elsewhere { Config::load(file) } else { Config::check_here(file) };
            if *json {
                println!("{}", document(file, &config));
            }
            let config = config?;
            if !json && !quiet {
                println!("{}: {}", file.display(), toned("no findings", Tone::Good, terminal::colour()));
                print(&config);
            }
        }
    }
    Ok(())
}

fn document(file: &std::path::Path, config: &Result<Config, ConfigFindings>) -> serde_json::Value {
    let findings: Vec<_> = config.as_ref().err().into_iter().flat_map(|f| &f.0).collect();
    let findings: Vec<_> = findings
        .iter()
        .map(|f| {
            json!({"file": f.file, "line": f.line, "column": f.column, "found": f.found,
                   "expected": f.expected})
        })
        .collect();
    let notes = config.as_ref().map_or(&[][..], |c| &c.notes);
    json!({"file": file, "ok": config.is_ok(), "findings": findings, "notes": notes})
}

fn print(config: &Config) {
    println!("machine \"{}\", card {}", config.machine, config.card.backend());
    println!(
        "{:<8} {:>10} {:>10} {:>9} {:>8} {:>8} {:>10} {:>9} {:>14}",
        "axis", "µm/count", "travel/mm", "design", "max", "window", "sep/ns", "need/ns", "fastest/Hz"
    );
    for axis in &config.axes {
        let e = &axis.engine;
        let Some(gate) = e.gate() else { continue };
        let design = format!("{:?}", e.design).to_lowercase();
        println!(
            "{:<8} {:>10} {:>10} {design:>9} {:>8} {:>8} {:>10} {:>9} {:>14.0}",
            axis.name,
            axis.count_um,
            axis.travel_mm,
            e.max_correction_counts,
            e.window_counts,
            e.min_separation_ns,
            gate.need_ns(),
            1e9 / gate.min_period_ns() as f64,
        );
    }
    for note in &config.notes {
        println!("{} {note}", toned("note:", Tone::Doubtful, terminal::colour()));
    }
}
