//! `rtecctl part`: from a drawing to a probed, compensated part (NISTIR 4854).
//! One file per step.

mod errors;
mod features;
mod finish;
mod inspect;
mod linuxcnc_download;
mod load;
mod points;
mod post_process;
mod probe;
mod probing_plan_page;
mod program;
mod run;
mod simulated_machine_args;
mod table;

use crate::prelude::*;
use rtec_sim::turning_experiment::TurningExperimentError;
use std::ops::RangeInclusive;

super::verbs_below! {
    /// Probe a part and compensate its errors: the steps of the process-intermittent and post-process loops
    #[command(arg_required_else_help = true)]
    Args;
    Features Box<features::Args> => features::run;
    Points Box<points::Args> => points::run;
    Program Box<program::Args> => program::run;
    Probe Box<probe::Args> => probe::run;
    Errors Box<errors::Args> => errors::run;
    Table Box<table::Args> => table::run;
    Load Box<load::LoadArgs> => load::load;
    /// Take the part table out: corrections go back in a ramp
    Unload crate::daemon_connection::DaemonArgs => load::unload;
    Finish Box<finish::Args> => finish::run;
    Inspect Box<inspect::Args> => inspect::run;
    PostProcess Box<post_process::Args> => post_process::run;
    Run Box<run::Args> => run::run;
}

/// Extensions of the steps' files, after which no folder may be named.
const FILES: [&str; 10] = ["csv", "cor", "nc", "ngc", "dnc", "svg", "dxf", "cdl", "html", "toml"];

/// Writes the files of one result into a folder, which is made if needed.
fn write_all(folder: &Path, files: &[(&str, impl AsRef<[u8]>)]) -> anyhow::Result<()> {
    use anyhow::Context as _;
    let ends = folder.extension().and_then(|e| e.to_str()).unwrap_or_default();
    if !folder.is_dir() && FILES.contains(&ends) {
        let expected = format!("a folder, for {}", crate::json_output::list(files.iter().map(|f| f.0)));
        return Err(usage("--out", format!("the name of a file, {}", folder.display()), expected));
    }
    std::fs::create_dir_all(folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    for (name, content) in files {
        let file = folder.join(name);
        let written = rtec_files::atomic_write::write_atomically(&file, content.as_ref());
        written.with_context(|| format!("cannot write {}", file.display()))?;
        eprintln!("wrote {}", file.display());
    }
    Ok(())
}

/// A value within a range; otherwise a usage error.
fn within(name: &str, value: f64, range: RangeInclusive<f64>, expected: &str) -> anyhow::Result<f64> {
    if range.contains(&value) { Ok(value) } else { Err(usage(name, value.to_string(), expected)) }
}

/// A usage error that clap cannot express: exit code 2.
fn usage(argument: &str, found: impl Into<String>, expected: impl Into<String>) -> anyhow::Error {
    rtec_files::InputError::whole(Path::new(argument), found, expected).into()
}

/// An experiment's failure with its exit code.
/// Bad points are bad input, a latched fault is a fault, and a trip that differs from the plan is a no.
fn failed(error: TurningExperimentError) -> anyhow::Error {
    match error {
        TurningExperimentError::Points(input) => input.into(),
        TurningExperimentError::Fault(_) => CommandFailure::Fault(error.to_string()).into(),
        TurningExperimentError::Trip(_) => CommandFailure::No(error.to_string()).into(),
        other => other.into(),
    }
}
