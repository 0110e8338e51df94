//! `rtecctl part`: from a drawing to a probed, compensated part (NISTIR 4854). One file per step.

mod errors;
mod features;
mod points;
mod post_process;
mod program;
mod table;

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
    Errors(Box<errors::Args>),
    Table(Box<table::Args>),
    PostProcess(Box<post_process::Args>),
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    match &args.step {
        Step::Features(args) => features::run(args),
        Step::Points(args) => points::run(args),
        Step::Program(args) => program::run(args),
        Step::Errors(args) => errors::run(args),
        Step::Table(args) => table::run(args),
        Step::PostProcess(args) => post_process::run(args),
    }
}

/// Write files of one result into a folder, making the folder where it is not there.
fn write_all(folder: &Path, files: &[(&str, &[u8])]) -> anyhow::Result<()> {
    use anyhow::Context as _;
    std::fs::create_dir_all(folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    for (name, content) in files {
        let file = folder.join(name);
        rtec_part::sheet::write_whole(&file, content)
            .with_context(|| format!("cannot write {}", file.display()))?;
        eprintln!("wrote {}", file.display());
    }
    Ok(())
}

/// Print a whole result; a reader that has seen enough (`| head`) is no fault.
fn print(text: &str) -> anyhow::Result<()> {
    use std::io::Write as _;
    match std::io::stdout().write_all(text.as_bytes()) {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => Err(e.into()),
        _ => Ok(()),
    }
}

/// A usage finding that clap cannot express: exit code 2.
fn usage(argument: &str, found: impl Into<String>, expected: impl Into<String>) -> anyhow::Error {
    rtec_driver::input::InputError::whole(Path::new(argument), found, expected).into()
}
