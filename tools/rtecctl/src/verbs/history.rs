//! `rtecctl history`: one machine's figures of merit over time.

use crate::prelude::*;
use rtec_measure::figure_history::{FigureTolerances, history};

/// Show a machine's figures over time: A, E, M, R, B, squareness, growth per K, with limits and trend
///
/// Every record is evaluated by itself. One without a date, or that cannot be read, is named and left out.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Run records, or folders of them
    #[arg(required = true, value_name = "NAME.run.toml|DIR")]
    records: Vec<PathBuf>,
    /// The machine's name
    #[arg(long, default_value = "the machine")]
    machine: String,
    /// What the figures may be: a table `[limits]` with `"x.A" = 12.0`, or for every axis `B_mean = 5.0`
    #[arg(long, value_name = "FILE.toml")]
    limits: Option<PathBuf>,
    /// Write the history with a plot of each figure as one page
    #[arg(long, value_name = "FILE.html", value_parser = crate::verbs::output())]
    html: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let limits = args.limits.as_deref().map(FigureTolerances::read).transpose()?.unwrap_or_default();
    let mut paths = Vec::new();
    let missing = |path, found| InputError::whole(path, found, "NAME.run.toml, or a folder with one");
    for given in &args.records {
        if given.is_dir() {
            below(given, &mut paths).with_context(|| format!("reading {}", given.display()))?;
        } else if given.exists() {
            paths.push(given.clone());
        } else {
            return Err(missing(given, "no such file or folder").into());
        }
    }
    if paths.is_empty() {
        return Err(missing(&args.records[0], "no record").into());
    }
    let records: Vec<_> =
        paths.iter().map(|p| (p.display().to_string(), rtec_measure::run_record_files::read(p))).collect();
    let found = history(&args.machine, &records, &limits);
    for left in &found.left_out {
        eprintln!("warning: {}: left out: {}", left.record, left.why);
    }
    let suspicions = found.suspicions.iter().map(ToString::to_string);
    let changes = found.changes.iter().cloned();
    for warning in suspicions.chain(found.with_every_row()).chain(changes) {
        eprintln!("warning: {warning}");
    }
    let report = found.report()?;
    if let Some(path) = &args.html {
        crate::json_output::write(path, &report.html())?;
    }
    answer(args.json, &found, || report.text())?;
    // A limit that was applied to nothing does not count as kept.
    let unjudged = limits.without(&found).join(", ");
    if !unjudged.is_empty() {
        fail!(No, "no record here has {unjudged}: nothing is within a limit that nothing was held against");
    }
    let beyond = list(found.beyond().map(|f| &f.name));
    ensure!(beyond.is_empty(), No, "beyond its limit: {beyond}");
    Ok(())
}

/// The sidecars below a folder, in order.
fn below(folder: &Path, into: &mut Vec<PathBuf>) -> std::io::Result<()> {
    let mut entries = std::fs::read_dir(folder)?.collect::<Result<Vec<_>, _>>()?;
    entries.sort_by_key(std::fs::DirEntry::path);
    for entry in entries {
        if entry.file_type()?.is_dir() {
            below(&entry.path(), into)?;
        } else if entry.file_name().to_string_lossy().ends_with(".run.toml") {
            into.push(entry.path());
        }
    }
    Ok(())
}
