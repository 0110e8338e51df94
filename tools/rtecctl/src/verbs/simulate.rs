//! `rtecctl simulate`: experiments on the simulated machine.

use anyhow::Context;
use rtec_files::InputError;
use rtec_model::machine::Machine;
use rtec_sim::experiment::{EXPERIMENTS, Experiment, ExperimentError, Setting};
use rtec_sim::job::RunError;
use rtec_sim::sim::SimError;
use rtec_sim::turning::TurningError;
use serde_json::{Map, Value};
use std::fmt::Write as _;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Run an experiment on the simulated machine, without and with compensation
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The experiment; see --list
    #[arg(required_unless_present = "list", value_parser = experiment)]
    name: Option<&'static Experiment>,
    /// List the experiments
    #[arg(long, conflicts_with_all = ["name", "machine", "model", "out"])]
    list: bool,
    /// The true machine
    #[arg(long, value_name = "true.toml", required_unless_present = "list")]
    machine: Option<PathBuf>,
    /// What the corrector knows of it [default: all of it]
    #[arg(long, value_name = "known.toml")]
    model: Option<PathBuf>,
    /// Seed of all noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Directory for run records and plots
    #[arg(long, value_name = "DIR", required_unless_present = "list")]
    out: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

fn experiment(name: &str) -> Result<&'static Experiment, String> {
    Experiment::find(name)
        .ok_or_else(|| format!("expected one of {}", EXPERIMENTS.map(|e| e.name).join(", ")))
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    if args.list {
        let text = if args.json {
            let all = EXPERIMENTS.map(|e| serde_json::json!({"name": e.name, "what": e.what}));
            format!("{}\n", serde_json::json!({ "experiments": all }))
        } else {
            EXPERIMENTS.map(|e| format!("{:<26} {}\n", e.name, e.what)).concat()
        };
        return say(&text);
    }
    // Usage errors are clap's: both are required unless the experiments are listed.
    let (Some(experiment), Some(machine), Some(out)) = (args.name, &args.machine, &args.out) else {
        anyhow::bail!("NAME, --machine and --out are needed");
    };
    let truth = Machine::read(machine)?;
    let known = args.model.as_deref().map_or_else(|| Ok(truth.clone()), Machine::read)?;
    std::fs::create_dir_all(out).with_context(|| format!("making {}", out.display()))?;
    eprintln!("rtecctl: simulating {}, without and with compensation", experiment.name);
    let setting = Setting { truth: &truth, known: &known, seed: args.seed, out };
    let mut findings = experiment.run(&setting).map_err(|e| explain(e, &truth.path))?;
    let writing = |file: &Path| format!("writing {}", file.display());
    let mut files = Vec::new();
    for record in &mut findings.records {
        rtec_measure::record::write(record).with_context(|| writing(&record.path))?;
        files.push(record.path.display().to_string());
    }
    for (name, svg) in &findings.plots {
        let file = out.join(name);
        rtec_files::write::whole(&file, svg.as_bytes()).with_context(|| writing(&file))?;
        files.push(file.display().to_string());
    }
    let text = if args.json {
        let document = serde_json::json!({
            "experiment": experiment.name, "seed": args.seed, "files": files, "summary": findings.summary,
        });
        serde_json::to_string_pretty(&document)? + "\n"
    } else {
        for file in &files {
            eprintln!("rtecctl: wrote {file}");
        }
        text(&findings.summary)
    };
    say(&text)
}

/// The findings as a person reads them: a line for what is one figure, a table for what is one a row.
fn text(summary: &Map<String, Value>) -> String {
    let mut text = String::new();
    for (what, found) in summary {
        let Value::Object(figures) = found else {
            // Writing to a String does not fail.
            let _ = writeln!(text, "{what}: {}", shown(found));
            continue;
        };
        let _ = writeln!(text, "{what}");
        for (name, value) in figures {
            let value = match value {
                Value::Object(of) => {
                    let each = of.iter().map(|(key, v)| format!("{key} {}", shown(v)));
                    each.collect::<Vec<_>>().join(", ")
                }
                one => shown(one),
            };
            let _ = writeln!(text, "  {:36} {value}", name.replace('_', " "));
        }
    }
    text
}

/// A figure without what JSON needs.
fn shown(value: &Value) -> String {
    match value {
        Value::Array(all) => all.iter().map(shown).collect::<Vec<_>>().join(" "),
        Value::String(text) => text.clone(),
        Value::Object(of) => {
            of.iter().map(|(k, v)| format!("{k} {}", shown(v))).collect::<Vec<_>>().join(", ")
        }
        other => other.to_string(),
    }
}

/// Prints to standard output; a reader that has gone away (`| head`) is no error.
pub(super) fn say(text: &str) -> anyhow::Result<()> {
    match std::io::stdout().write_all(text.as_bytes()) {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => Err(e).context("writing to standard output"),
        _ => Ok(()),
    }
}

/// An effect that reads what the machine does not have is bad input, not a failed run.
fn explain(error: ExperimentError, file: &Path) -> anyhow::Error {
    match error {
        ExperimentError::Sim(SimError::Missing(missing))
        | ExperimentError::Turning(TurningError::Run(RunError::Missing(missing))) => {
            let expected = format!("sensors and channels of the simulated machine: {}", missing.has);
            InputError::whole(file, missing.to_string(), expected).into()
        }
        other => other.into(),
    }
}
