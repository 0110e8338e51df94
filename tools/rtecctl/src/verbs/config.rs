//! `rtecctl config`: checks a configuration, and shows where it is wrong.

use crate::document::line;
use crate::say;
use crate::terminal::{self, Tone, toned};
use clap::Subcommand;
use rtec_control::config::{Config, ConfigFindings, EMBEDDED};
use serde_json::json;
use std::path::PathBuf;

/// Check a configuration, or print the embedded one
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    what: ConfigAction,
}

#[derive(Debug, Subcommand)]
enum ConfigAction {
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
    /// Print the built-in configuration, as a start for your own
    Default,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    match &args.what {
        ConfigAction::Default => print!("{EMBEDDED}"),
        ConfigAction::Check { file, elsewhere, quiet, json } => {
            let config = if *elsewhere { Config::load(file) } else { Config::check_here(file) };
            if *json {
                say(&line(&document(file, &config))?);
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
    let notes = config.as_ref().map_or_else(|findings| &findings.1, |c| &c.notes);
    let axes: Vec<_> = config.iter().flat_map(|c| &c.axes).collect();
    let axes: Vec<_> = axes
        .iter()
        .map(|a| {
            let rates = a.rates();
            let known = config.as_ref().is_ok_and(measured);
            json!({"name": a.name, "rapid_mm_min": rates.rapid_mm_min, "followed_mm_min": rates.followed_mm_min,
                   "corrected_mm_min": rates.corrected_mm_min.filter(|_| known), "followed_hz": a.followed_hz(),
                   "corrected_hz": a.corrected_hz().filter(|_| known)})
        })
        .collect();
    json!({"file": file, "ok": config.is_ok(), "findings": findings, "notes": notes, "axes": axes})
}

/// Whether the card's latencies are known, from which an axis's speed follows.
fn measured(config: &Config) -> bool {
    config.rt.latency_measured || !config.card.may_drive_a_machine()
}

fn print(config: &Config) {
    println!("machine \"{}\", card {}", config.machine, config.card.named());
    println!(
        "{:<8} {:>10} {:>10} {:>8} {:>8} {:>10} {:>9}",
        "axis", "µm/count", "travel/mm", "max", "window", "sep/ns", "need/ns"
    );
    for axis in &config.axes {
        let e = &axis.engine;
        let Some(gate) = e.gate() else { continue };
        println!(
            "{:<8} {:>10} {:>10} {:>8} {:>8} {:>10} {:>9}",
            axis.name,
            axis.count_um,
            axis.travel_mm,
            e.max_correction_counts,
            e.window_counts,
            e.min_separation_ns,
            gate.need_ns(),
        );
    }
    println!(
        "{:<8} {:>14} {:>17} {:>18} {:>11} {:>12}",
        "axis", "rapid/(mm/min)", "followed/(mm/min)", "corrected/(mm/min)", "followed/Hz", "corrected/Hz"
    );
    for axis in &config.axes {
        let shown = |speed: Option<f64>| speed.map_or_else(|| "–".to_owned(), |v| format!("{v:.1}"));
        let whole = |hz: Option<f64>| hz.map_or_else(|| "–".to_owned(), |v| format!("{v:.0}"));
        let rates = axis.rates();
        println!(
            "{:<8} {:>14} {:>17} {:>18} {:>11} {:>12}",
            axis.name,
            shown(rates.rapid_mm_min),
            shown(rates.followed_mm_min),
            shown(rates.corrected_mm_min.filter(|_| measured(config))),
            whole(axis.followed_hz()),
            whole(axis.corrected_hz().filter(|_| measured(config))),
        );
    }
    for note in &config.notes {
        println!("{} {note}", toned("note:", Tone::Doubtful, terminal::colour()));
    }
}
