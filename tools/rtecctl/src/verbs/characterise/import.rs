//! `rtecctl characterise import`: turns other tools' files into run records.

use crate::prelude::*;
use crate::verbs::input_notices;
use rtec_files::InputNotice;
use rtec_measure::import::request::ImportRequest;
use rtec_measure::run_record_files;

/// Turn another tool's file into a run record
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    request: ImportRequest,
    #[command(flatten)]
    circle: super::BallbarCircleOptions,
    /// The run record to write; its CSV stands beside it
    #[arg(long, value_name = "NAME.run.toml", value_parser = crate::verbs::output())]
    out: PathBuf,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let mut record = args.request.read(args.circle.circle()?, &args.out, &mut |said| match said {
        InputNotice::Note(text) => eprintln!("{text}"),
        InputNotice::Warning(text) => eprintln!("warning: {text}"),
    })?;
    run_record_files::write(&mut record).with_context(|| format!("writing {}", args.out.display()))?;
    if let Some(note) = &record.note {
        eprintln!("note: {note}");
    }
    input_notices::warn(std::slice::from_ref(&record));
    eprintln!("{}: {} rows, and {} beside it", args.out.display(), record.rows(), record.file);
    Ok(())
}
