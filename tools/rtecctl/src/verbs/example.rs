//! `rtecctl example`: a simulated machine to begin with.

use crate::Outcome;
use crate::document::line;
use anyhow::Context;
use rtec_sim::example::{EXAMPLES, Example};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// Write an example machine into a folder: model, run records, hold-outs, configuration
///
/// The runs are simulated, from fixed seeds: the same files each time. README.md in the folder says what is there and what
/// to try. The four sources' experiments (wo97, nistir4854, nistir4832, cmti) run by one command each, which the last line names.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The machine; see --list
    #[arg(required_unless_present = "list", value_parser = example)]
    name: Option<&'static Example>,
    /// The folder, created where it is missing; one with anything in it is refused
    #[arg(value_name = "DIR", required_unless_present = "list")]
    dir: Option<PathBuf>,
    /// List the example machines
    #[arg(long, conflicts_with_all = ["name", "dir"])]
    list: bool,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

fn example(name: &str) -> Result<&'static Example, String> {
    Example::find(name).ok_or_else(|| format!("expected one of {}", EXAMPLES.map(|e| e.name).join(", ")))
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let (Some(example), Some(dir)) = (args.name, &args.dir) else {
        let text = if args.json {
            let all = EXAMPLES.map(|e| serde_json::json!({"name": e.name, "what": e.what}));
            line(&serde_json::json!({ "examples": all }))?
        } else {
            EXAMPLES.map(|e| format!("{:<11} {}\n", e.name, e.what)).concat()
        };
        crate::say(&text);
        return Ok(());
    };
    empty(dir)?;
    if example.has_runs() {
        eprintln!("rtecctl: simulating the runs of the example {}", example.name);
    }
    let mut records = example.records(dir)?;
    let making = |folder: &Path| format!("making {}", folder.display());
    let mut files = Vec::new();
    for record in &mut records {
        let folder = record.path.parent().unwrap_or(dir);
        std::fs::create_dir_all(folder).with_context(|| making(folder))?;
        let done = rtec_measure::record::write(record);
        done.with_context(|| format!("writing {}", record.path.display()))?;
        files.push(record.path.clone());
    }
    for (name, text) in example.files {
        let file = dir.join(name);
        let folder = file.parent().unwrap_or(dir);
        std::fs::create_dir_all(folder).with_context(|| making(folder))?;
        crate::document::write(&file, text)?;
        files.push(file);
    }
    let text = if args.json {
        let command = example.experiment();
        line(&serde_json::json!({ "example": example.name, "files": files, "experiment": command }))?
    } else {
        let experiment = example.experiment().map_or_else(String::new, |command| {
            format!("its whole experiment, tables and figures: cd {} && {command}\n", dir.display())
        });
        format!(
            "{} files in {}: begin with {}\n{experiment}",
            files.len(),
            dir.display(),
            dir.join("README.md").display()
        )
    };
    crate::say(&text);
    Ok(())
}

/// Refuses a folder that is not empty, so that nothing is overwritten.
fn empty(dir: &Path) -> anyhow::Result<()> {
    let first = match std::fs::read_dir(dir) {
        Ok(mut entries) => entries.next(),
        Err(e) if e.kind() == ErrorKind::NotFound => return Ok(()),
        Err(e) => {
            return Err(
                Outcome::Bad(format!("{}: {e}; expected an empty folder, or none", dir.display())).into()
            );
        }
    };
    match first {
        None => Ok(()),
        Some(entry) => {
            let entry = entry.with_context(|| format!("reading {}", dir.display()))?;
            let found = entry.file_name();
            let text = format!(
                "{}: found {} in it, expected an empty folder, or none: name another",
                dir.display(),
                found.to_string_lossy()
            );
            Err(Outcome::Bad(text).into())
        }
    }
}
