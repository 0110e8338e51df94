//! `rtecctl papers`: what the sources say, what the simulated machines give now, and why it is not the same.

use anyhow::Context;
use rtec_papers::{Compared, PAPERS, Paper, PaperError, Verdict};
use rtec_sim::described::{Described, FILES};
use rtec_sim::experiment::ExperimentError;
use rtec_sim::sim::SimError;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Compare every table and figure of the sources with what the simulation gives now
///
/// Each source's machine is within this program; `--write` shows it as files, and `--from` runs files of one's own.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The source: 4832, 4854, cmti or wo97 [default: all four]
    #[arg(value_parser = paper)]
    paper: Option<&'static Paper>,
    /// Take the machines' files from this folder; those that are not there are this program's
    #[arg(long, value_name = "DIR")]
    from: Option<PathBuf>,
    /// Write the machines' files into this folder, the Error Correction Circuit's trace beside them, and end
    #[arg(long, value_name = "DIR")]
    write: Option<PathBuf>,
    /// Only rows that differ
    #[arg(long)]
    differ: bool,
    /// Seed of all noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

fn paper(name: &str) -> Result<&'static Paper, String> {
    Paper::find(name).ok_or_else(|| format!("expected one of {}", PAPERS.map(|p| p.name).join(", ")))
}

/// The first word of progress comes after so long.
const PATIENCE: Duration = Duration::from_secs(2);

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let described = Described { folder: args.from.clone() };
    if let Some(folder) = &args.from
        && !folder.is_dir()
    {
        let found = "no such folder";
        return Err(rtec_files::InputError::whole(folder, found, "a folder with the machines' files").into());
    }
    if let Some(folder) = &args.write {
        std::fs::create_dir_all(folder).with_context(|| format!("making {}", folder.display()))?;
        let trace = rtec_papers::cmti::trace(&described, args.seed).map_err(explain)?;
        for (name, text) in FILES.iter().copied().chain([("cmti.vcd", trace.as_str())]) {
            let file = folder.join(name);
            rtec_files::write::whole(&file, text.as_bytes())
                .with_context(|| format!("writing {}", file.display()))?;
            eprintln!("rtecctl: wrote {}", file.display());
        }
        return Ok(());
    }
    let began = Instant::now();
    let mut progress = |step: &str| {
        if began.elapsed() > PATIENCE {
            eprintln!("rtecctl: {:.0} s: {step}", began.elapsed().as_secs_f64());
        }
    };
    let mut all = Vec::new();
    for paper in PAPERS.iter().filter(|p| args.paper.is_none_or(|own| own.name == p.name)) {
        let compared = paper.compare(&described, args.seed, &mut progress).map_err(explain)?;
        if !args.json {
            print!("{}", table(&compared, args.differ));
        }
        all.push(compared);
    }
    if args.json {
        println!("{}", serde_json::to_string_pretty(&serde_json::json!({ "papers": all }))?);
    }
    Ok(())
}

/// A description that is not right is bad input, wherever it was found.
fn explain(error: PaperError) -> anyhow::Error {
    match error {
        PaperError::Input(input)
        | PaperError::Experiment(
            ExperimentError::Record(input) | ExperimentError::Sim(SimError::Model(input)),
        )
        | PaperError::Sim(SimError::Model(input)) => input.into(),
        other => other.into(),
    }
}

/// A source as a table: place, what, paper, we; beneath a row why it is not the same, once for rows that share it.
fn table(c: &Compared, differ: bool) -> String {
    let mut text = format!(
        "{}, seed {}\n{} agree, {} differ, {} cannot be compared\n",
        c.title, c.seed, c.agree, c.differ, c.not_compared
    );
    let (mut place, mut why) = ("", "");
    for row in c.rows.iter().filter(|r| !differ || r.verdict == Verdict::Differs) {
        if place != row.place {
            let _ = writeln!(text, "\n{}\n  {:<76} {:>16}  {:>16}", row.place, "", "paper says", "we get");
            (place, why) = (&row.place, "");
        }
        let mark = match row.verdict {
            Verdict::Agrees if row.why.is_empty() => String::new(),
            Verdict::Agrees => format!("  ({})", row.agreement),
            Verdict::Differs => format!("  DIFFERS: not {}", row.agreement),
            Verdict::NotCompared => "  not compared".to_owned(),
        };
        let gets = if row.gets.is_empty() { "-" } else { &row.gets };
        let _ = writeln!(text, "  {:<76} {:>16}  {gets:>16} {}{mark}", row.what, row.says, row.unit);
        if !row.why.is_empty() && row.why != why {
            let _ = writeln!(text, "      why: {}", row.why);
            why = &row.why;
        }
    }
    text + "\n"
}
