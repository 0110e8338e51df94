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
    /// The source: 4832 (or nistir4832), 4854, cmti or wo97 [default: all four]
    #[arg(value_parser = paper)]
    paper: Option<&'static Paper>,
    /// Take the machines' files from this folder; those that are not there are this program's
    #[arg(long, value_name = "DIR")]
    from: Option<PathBuf>,
    /// Write the machines' files into this folder, the Error Correction Circuit's trace beside them, and end
    #[arg(long, value_name = "DIR")]
    write: Option<PathBuf>,
    /// Draw the source's figures into this folder, as they come out here
    #[arg(long, value_name = "DIR", requires = "paper")]
    out: Option<PathBuf>,
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
        if let Some(folder) = &args.out {
            std::fs::create_dir_all(folder).with_context(|| format!("making {}", folder.display()))?;
            for (name, text) in &compared.figures {
                let file = folder.join(name);
                rtec_files::write::whole(&file, text.as_bytes())
                    .with_context(|| format!("writing {}", file.display()))?;
                eprintln!("rtecctl: wrote {}", file.display());
            }
        }
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

/// A source as a table: place, what, paper, we. Every row that is not the same has its reason's number, the same in all of the
/// source; beneath the first row of a place that has it stands the reason.
fn table(c: &Compared, differ: bool) -> String {
    let mut text = format!(
        "{}, seed {}\n{} agree, {} differ, {} cannot be compared\n",
        c.title, c.seed, c.agree, c.differ, c.not_compared
    );
    let mut reasons: Vec<&str> = Vec::new();
    let (mut place, mut said) = ("", Vec::new());
    for row in c.rows.iter().filter(|r| !differ || r.verdict == Verdict::Differs) {
        if place != row.place {
            let _ = writeln!(text, "\n{}\n  {:<76} {:>16}  {:>16}", row.place, "", "paper says", "we get");
            place = &row.place;
            said.clear();
        }
        let mark = match row.verdict {
            Verdict::Agrees if row.why.is_empty() => String::new(),
            Verdict::Agrees => format!("  ({})", row.agreement),
            Verdict::Differs => format!("  DIFFERS: not {}", row.agreement),
            Verdict::NotCompared => "  not compared".to_owned(),
        };
        let gets = if row.gets.is_empty() { "-" } else { &row.gets };
        let line = format!("  {:<76} {:>16}  {gets:>16} {}{mark}", row.what, row.says, row.unit);
        text += line.trim_end();
        if row.why.is_empty() {
            text.push('\n');
            continue;
        }
        let number = reasons.iter().position(|w| *w == row.why).unwrap_or_else(|| {
            reasons.push(&row.why);
            reasons.len() - 1
        });
        let _ = writeln!(text, " [{}]", number + 1);
        if !said.contains(&number) {
            said.push(number);
            let _ = writeln!(text, "      [{}] {}", number + 1, row.why);
        }
    }
    text + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;
    use rtec_papers::Row;

    fn row(place: &str, what: &str, verdict: Verdict, why: &str) -> Row {
        Row {
            place: place.into(),
            what: what.into(),
            unit: "um",
            says: "1".into(),
            paper: Some(1.0),
            gets: "2".into(),
            we: Some(2.0),
            agreement: "within 0.5 um".into(),
            verdict,
            why: why.into(),
        }
    }

    /// Rows that share a reason, with others between them, and in another table: each row names its own.
    #[test]
    fn every_row_that_is_not_the_same_names_its_reason() {
        let rows = vec![
            row("Table 1", "first", Verdict::Differs, "a scale of its own"),
            row("Table 1", "second", Verdict::Agrees, ""),
            row("Table 1", "third", Verdict::Differs, "noise"),
            row("Table 1", "fourth", Verdict::Differs, "a scale of its own"),
            row("Table 2", "fifth", Verdict::NotCompared, "a scale of its own"),
        ];
        let (paper, title) = ("p", "A paper");
        let compared = Compared {
            paper,
            title,
            seed: 1,
            agree: 1,
            differ: 3,
            not_compared: 1,
            rows,
            figures: Vec::new(),
        };
        let text = table(&compared, false);
        let mark = |what: &str| {
            let line = text.lines().find(|l| l.trim_start().starts_with(what)).unwrap_or_default();
            line.rsplit_once(" [").map(|(_, n)| n.trim_end_matches(']').to_owned())
        };
        let marks = ["first", "second", "third", "fourth", "fifth"].map(mark);
        assert_eq!(marks.map(Option::unwrap_or_default), ["1", "", "2", "1", "1"], "{text}");
        // Once in each table.
        assert_eq!(text.matches("[1] a scale of its own").count(), 2, "{text}");
        assert!(table(&compared, true).contains("fourth"));
    }
}
