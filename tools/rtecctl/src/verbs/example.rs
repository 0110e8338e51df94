//! `rtecctl example`: a simulated machine to begin with.

use crate::prelude::*;
use rtec_sim::example_machines::{EXAMPLES, ExampleMachine};
use std::io::ErrorKind;

/// Write an example machine into a folder: model, run records, hold-outs, configuration
///
/// The runs are simulated, from fixed seeds: the same files each time. README.md in the folder says what is there and what
/// to try. The four sources' experiments (wo97, nistir4854, nistir4832, cmti) run by one command each, which the last line names.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The machine; see --list
    #[arg(required_unless_present = "list", value_parser = example)]
    name: Option<&'static ExampleMachine>,
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

fn example(name: &str) -> Result<&'static ExampleMachine, String> {
    ExampleMachine::find(name)
        .ok_or_else(|| format!("expected one of {}", EXAMPLES.map(|e| e.name).join(", ")))
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let (Some(example), Some(dir)) = (args.name, &args.dir) else {
        if args.json {
            let all = EXAMPLES.map(|e| json!({"name": e.name, "what": e.what}));
            return say_line(&json!({ "examples": all }));
        }
        print!("{}", EXAMPLES.map(|e| format!("{:<11} {}\n", e.name, e.what)).concat());
        return Ok(());
    };
    empty(dir)?;
    if example.has_runs() {
        eprintln!("rtecctl: simulating the runs of the example {}", example.name);
    }
    let mut records = example.records(dir)?;
    let make_folder_of = |file: &Path| {
        let folder = file.parent().unwrap_or(dir);
        std::fs::create_dir_all(folder).with_context(|| format!("making {}", folder.display()))
    };
    let mut files = Vec::new();
    for record in &mut records {
        make_folder_of(&record.path)?;
        let done = rtec_measure::run_record_files::write(record);
        done.with_context(|| format!("writing {}", record.path.display()))?;
        files.push(record.path.clone());
    }
    for (name, text) in example.files {
        let file = dir.join(name);
        make_folder_of(&file)?;
        crate::json_output::write(&file, text)?;
        files.push(file);
    }
    let command = example.experiment();
    if args.json {
        let document = json!({ "example": example.name, "files": files, "experiment": command });
        return say_line(&document);
    }
    let (n, folder, first) = (files.len(), dir.display(), dir.join("README.md"));
    println!("{n} files in {folder}: begin with {}", first.display());
    if let Some(command) = command {
        println!("its whole experiment, tables and figures: cd {folder} && {command}");
    }
    Ok(())
}

/// Refuses a folder that is not empty, so that nothing is overwritten.
fn empty(dir: &Path) -> anyhow::Result<()> {
    let folder = dir.display();
    let found = match std::fs::read_dir(dir).map(|mut entries| entries.next()) {
        Ok(None) => return Ok(()),
        Ok(Some(entry)) => entry.with_context(|| format!("reading {folder}"))?.file_name(),
        Err(e) if e.kind() == ErrorKind::NotFound => return Ok(()),
        Err(e) => fail!(Bad, "{folder}: {e}; expected an empty folder, or none"),
    };
    let found = found.to_string_lossy();
    fail!(Bad, "{folder}: found {found} in it, expected an empty folder, or none: name another")
}
