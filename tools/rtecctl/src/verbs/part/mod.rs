//! `rtecctl part`: from a drawing to a probed, compensated part (NISTIR 4854).
//! One file per step.

mod bench;
mod download;
mod errors;
mod features;
mod finish;
mod inspect;
mod load;
mod points;
mod post_process;
mod probe;
mod program;
mod run;
mod table;
mod web;

use crate::Outcome;
use rtec_sim::turning::TurningError;
use std::path::Path;

/// Probe a part and compensate its errors: the steps of the process-intermittent and post-process loops
#[derive(Debug, clap::Args)]
#[command(arg_required_else_help = true)]
pub(crate) struct Args {
    #[command(subcommand)]
    step: Step,
}

#[derive(Debug, clap::Subcommand)]
enum Step {
    Features(Box<features::Args>),
    Points(Box<points::Args>),
    Program(Box<program::Args>),
    Probe(Box<probe::Args>),
    Errors(Box<errors::Args>),
    Table(Box<table::Args>),
    Load(Box<load::LoadArgs>),
    /// Take the part table out: corrections go back in a ramp
    Unload(crate::daemon::Daemon),
    Finish(Box<finish::Args>),
    Inspect(Box<inspect::Args>),
    PostProcess(Box<post_process::Args>),
    Run(Box<run::Args>),
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    match &args.step {
        Step::Features(args) => features::run(args),
        Step::Points(args) => points::run(args),
        Step::Program(args) => program::run(args),
        Step::Probe(args) => probe::run(args),
        Step::Errors(args) => errors::run(args),
        Step::Table(args) => table::run(args),
        Step::Load(args) => load::load(args),
        Step::Unload(args) => load::unload(args),
        Step::Finish(args) => finish::run(args),
        Step::Inspect(args) => inspect::run(args),
        Step::PostProcess(args) => post_process::run(args),
        Step::Run(args) => run::run(args),
    }
}

/// Extensions of files that the steps read and write.
/// A folder may not be named like such a file.
const FILES: [&str; 10] = ["csv", "cor", "nc", "ngc", "dnc", "svg", "dxf", "cdl", "html", "toml"];

/// Writes the files of one result into a folder, which is made if needed.
fn write_all(folder: &Path, files: &[(&str, impl AsRef<[u8]>)]) -> anyhow::Result<()> {
    use anyhow::Context as _;
    let ends = folder.extension().and_then(|e| e.to_str()).unwrap_or_default();
    if !folder.is_dir() && FILES.contains(&ends) {
        let names = files.iter().map(|f| f.0).collect::<Vec<_>>().join(", ");
        let expected = format!("a folder, for {names}");
        return Err(usage("--out", format!("the name of a file, {}", folder.display()), expected));
    }
    std::fs::create_dir_all(folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    for (name, content) in files {
        let file = folder.join(name);
        let written = rtec_files::write::whole(&file, content.as_ref());
        written.with_context(|| format!("cannot write {}", file.display()))?;
        eprintln!("wrote {}", file.display());
    }
    Ok(())
}

/// Prints a whole result.
#[allow(clippy::unnecessary_wraps, reason = "the last thing that every step does")]
fn print(text: &str) -> anyhow::Result<()> {
    crate::say(text);
    Ok(())
}

/// A usage error that clap cannot express: exit code 2.
fn usage(argument: &str, found: impl Into<String>, expected: impl Into<String>) -> anyhow::Error {
    rtec_files::InputError::whole(Path::new(argument), found, expected).into()
}

/// An experiment's failure with its exit code.
/// Bad points are bad input, a latched fault is a fault, and a trip that differs from the plan is a no.
fn failed(error: TurningError) -> anyhow::Error {
    match error {
        TurningError::Points(input) => input.into(),
        TurningError::Fault(_) => Outcome::Fault(error.to_string()).into(),
        TurningError::Trip(_) => Outcome::No(error.to_string()).into(),
        other => other.into(),
    }
}
