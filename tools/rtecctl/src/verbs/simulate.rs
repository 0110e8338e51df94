//! `rtecctl simulate`: experiments on the simulated machine.

use crate::prelude::*;
use rtec_model::machine::{FitNote, Machine};
use rtec_model::record::RunKind;
use rtec_sim::compensation_experiments::{EXPERIMENTS, Experiment, ExperimentError, ExperimentInputs};
use rtec_sim::corrected_machine_sim::{MachineSpec, SimError};
use rtec_sim::lathe_program_run::ProgramRunError;
use rtec_sim::turning_experiment::TurningExperimentError;
use serde_json::Map;

/// Run an experiment on the simulated machine, without and with compensation
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The experiment; see --list
    #[arg(required_unless_present = "list", value_parser = experiment)]
    name: Option<&'static Experiment>,
    /// List the experiments
    #[arg(long, conflicts_with_all = ["name", "machine", "model", "out"])]
    list: bool,
    /// The true machine [default: the one that the experiment's source describes, where there is one]
    #[arg(long, value_name = "true.toml")]
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
        if args.json {
            let all = EXPERIMENTS.map(|e| serde_json::json!({"name": e.name, "what": e.what}));
            return say_line(&serde_json::json!({ "experiments": all }));
        }
        print!("{}", EXPERIMENTS.map(|e| format!("{:<26} {}\n", e.name, e.what)).concat());
        return Ok(());
    }
    // clap reports usage errors: both are required unless the experiments are listed.
    let (Some(experiment), Some(out)) = (args.name, &args.out) else {
        anyhow::bail!("NAME and --out are needed");
    };
    let own = experiment.own_machine()?;
    let fixed = experiment.own.is_some_and(|o| o.fixed);
    if fixed && (args.machine.is_some() || args.model.is_some()) {
        eprintln!(
            "rtecctl: {} brings its own machine, which it is about: --machine and --model are not used; \
             linear-displacement takes any",
            experiment.name
        );
    }
    let truth = match (&args.machine, own) {
        (Some(file), own) if !fixed || own.is_none() => Machine::read(file)?,
        (_, Some(own)) => {
            eprintln!("rtecctl: the true machine is {}", own.name());
            own
        }
        (_, None) => {
            let expected = format!("--machine true.toml: {} brings no machine of its own", experiment.name);
            return Err(InputError::whole(Path::new("simulate"), "no machine", expected).into());
        }
    };
    let known = match &args.model {
        Some(file) if !fixed => Machine::read(file)?,
        _ => truth.clone(),
    };
    std::fs::create_dir_all(out).with_context(|| format!("making {}", out.display()))?;
    eprintln!("rtecctl: simulating {}, without and with compensation", experiment.name);
    for fit in known.fits() {
        let (response, unit, promised) =
            (&fit.response, FitNote::unit_of(&fit.response), known.promised_um(fit));
        eprintln!(
            "rtecctl: {response}: the model promises 95 % within ±{promised:.1} {unit}; an axis that moves by less may gain nothing"
        );
    }
    let spec = MachineSpec::machining_centre();
    let setting = ExperimentInputs { spec: &spec, truth: &truth, known: Some(&known), seed: args.seed, out };
    let mut findings = experiment.run(&setting).map_err(|e| explain(e, &truth.path))?;
    for record in findings.records.iter().filter(|r| !r.path.to_string_lossy().contains("compensated")) {
        // A response on which no error of the machine acts shows only noise, which is reported.
        let Ok(said) = truth.predict(record) else { continue };
        let still = list(said.columns.iter().filter(|c| c.1.iter().all(|e| e.abs() < 1e-9)).map(|c| &c.0));
        if record.kind != RunKind::Dynamics && record.kind != RunKind::Probing && !still.is_empty() {
            let file = record.path.file_name().unwrap_or_default().to_string_lossy();
            eprintln!("rtecctl: {file}: {still} shows noise alone, nothing of the machine acts on it here");
        }
    }
    let mut files = Vec::new();
    for record in &mut findings.records {
        let done = rtec_measure::run_record_files::write(record);
        done.with_context(|| format!("writing {}", record.path.display()))?;
        files.push(record.path.display().to_string());
    }
    for (name, svg) in &findings.plots {
        let file = out.join(name);
        crate::json_output::write(&file, svg)?;
        files.push(file.display().to_string());
    }
    if args.json {
        return say_pretty(&serde_json::json!({
            "experiment": experiment.name, "seed": args.seed, "files": files, "summary": findings.summary,
        }));
    }
    for file in &files {
        eprintln!("rtecctl: wrote {file}");
    }
    crate::say(&text(&findings.summary));
    Ok(())
}

/// The findings for people: a line per figure, a table per list.
fn text(summary: &Map<String, Value>) -> String {
    let mut text = String::new();
    for (what, found) in summary {
        let Value::Object(figures) = found else {
            let _ = writeln!(text, "{what}: {}", shown(found));
            continue;
        };
        let _ = writeln!(text, "{what}");
        for (name, value) in figures {
            let _ = writeln!(text, "  {:36} {}", name.replace('_', " "), shown(value));
        }
    }
    text
}

/// A figure without JSON's punctuation.
fn shown(value: &Value) -> String {
    match value {
        Value::Array(all) => all.iter().map(shown).collect::<Vec<_>>().join(" "),
        Value::String(text) => text.clone(),
        Value::Object(of) => list(of.iter().map(|(k, v)| format!("{k} {}", shown(v)))),
        other => other.to_string(),
    }
}

/// An experiment's error with its exit code.
/// An effect that reads something which the machine does not have is bad input.
fn explain(error: ExperimentError, file: &Path) -> anyhow::Error {
    match error {
        ExperimentError::Sim(SimError::Missing(missing))
        | ExperimentError::Turning(TurningExperimentError::Run(ProgramRunError::Missing(missing))) => {
            let expected = format!("sensors and channels of the simulated machine: {}", missing.has);
            InputError::whole(file, missing.to_string(), expected).into()
        }
        other => other.into(),
    }
}
