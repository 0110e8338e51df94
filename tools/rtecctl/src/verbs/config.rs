//! `rtecctl config`: checks a configuration, and shows where it is wrong.

use crate::prelude::*;
use crate::terminal::{self, ColourMeaning, toned};
use clap::Subcommand;
use rtec_control::config::{Config, ConfigFindings, ConfiguredAxis, EMBEDDED};
use rtec_rt::axis::AxisConfig;

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
                say_line(&document(file, &config))?;
            }
            let config = config?;
            if !json && !quiet {
                println!(
                    "{}: {}",
                    file.display(),
                    toned("no findings", ColourMeaning::Good, terminal::colour())
                );
                print(&config);
            }
        }
    }
    Ok(())
}

fn document(file: &std::path::Path, config: &Result<Config, ConfigFindings>) -> serde_json::Value {
    let finding = |f: &InputError| json!({"file": f.file, "line": f.line, "column": f.column, "found": f.found, "expected": f.expected});
    let findings: Vec<_> = config.as_ref().err().into_iter().flat_map(|f| &f.0).map(finding).collect();
    let notes = config.as_ref().map_or_else(|findings| &findings.1, |c| &c.notes);
    let known = config.as_ref().is_ok_and(measured);
    let axis = |a: &ConfiguredAxis| {
        let rates = a.rates();
        json!({"name": a.name, "rapid_mm_min": rates.rapid_mm_min, "followed_mm_min": rates.followed_mm_min,
               "corrected_mm_min": rates.corrected_mm_min.filter(|_| known), "followed_hz": a.followed_hz(),
               "corrected_hz": a.corrected_hz().filter(|_| known)})
    };
    let axes: Vec<_> = config.iter().flat_map(|c| &c.axes).map(axis).collect();
    json!({"file": file, "ok": config.is_ok(), "findings": findings, "notes": notes, "axes": axes})
}

/// Whether the card's latencies are known, from which an axis's speed follows.
fn measured(config: &Config) -> bool {
    config.rt.latency_measured || !config.card.may_drive_a_machine()
}

fn print(config: &Config) {
    println!("machine \"{}\", card {}", config.machine, config.card.named());
    println!("axis       µm/count  travel/mm      max   window     sep/ns   need/ns");
    for ConfiguredAxis { name, count_um, travel_mm, engine, .. } in &config.axes {
        let AxisConfig { max_correction_counts: max, window_counts, min_separation_ns, .. } = engine;
        let Some(need_ns) = engine.gate().map(|gate| gate.need_ns()) else { continue };
        println!(
            "{name:<8} {count_um:>10} {travel_mm:>10} {max:>8} {window_counts:>8} {min_separation_ns:>10} {need_ns:>9}"
        );
    }
    println!("axis     rapid/(mm/min) followed/(mm/min) corrected/(mm/min) followed/Hz corrected/Hz");
    for axis in &config.axes {
        let known = |value: Option<f64>| value.filter(|_| measured(config));
        let shown = |v: Option<f64>, digits| v.map_or_else(|| "–".to_owned(), |v| format!("{v:.digits$}"));
        let (name, rates) = (&axis.name, axis.rates());
        let (rapid, followed) = (shown(rates.rapid_mm_min, 1), shown(rates.followed_mm_min, 1));
        let corrected = shown(known(rates.corrected_mm_min), 1);
        let [followed_hz, corrected_hz] =
            [axis.followed_hz(), known(axis.corrected_hz())].map(|hz| shown(hz, 0));
        println!("{name:<8} {rapid:>14} {followed:>17} {corrected:>18} {followed_hz:>11} {corrected_hz:>12}");
    }
    for note in &config.notes {
        println!("{} {note}", toned("note:", ColourMeaning::Doubtful, terminal::colour()));
    }
}
