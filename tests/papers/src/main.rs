//! Prints the sources beside what the simulated machines give.
//!
//! It draws the sources' figures too.

use anyhow::Context;
use clap::Parser as _;
use rtec_files::InputError;
use rtec_papers::{Compared, PAPERS, Paper, PaperError, Row, Spread, Verdict};
use rtec_sim::compensation_experiments::ExperimentError;
use rtec_sim::corrected_machine_sim::SimError;
use rtec_sim::described_machines::{FILES, MachineDescriptions};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Compares the sources with what the simulation gives now
#[derive(Debug, clap::Parser)]
#[command(version)]
struct Args {
    /// The source: 4832 or nistir4832, 4854, cmti or wo97 [default: all four]
    #[arg(value_parser = paper)]
    paper: Option<&'static Paper>,
    /// Take the machines' files from this folder; missing ones are built in
    #[arg(long, value_name = "DIR")]
    from: Option<PathBuf>,
    /// Write the machines' files and the circuit's trace into this folder, and end
    #[arg(long, value_name = "DIR")]
    write: Option<PathBuf>,
    /// Draw the source's figures into this folder
    #[arg(long, value_name = "DIR", requires = "paper")]
    out: Option<PathBuf>,
    /// Print only rows that differ
    #[arg(long)]
    differ: bool,
    /// Seed of all noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Run with so many seeds, from --seed on, and print what the rows give over them
    #[arg(long, value_name = "N", conflicts_with_all = ["out", "differ", "write"], value_parser = clap::value_parser!(u64).range(2..=1000))]
    seeds: Option<u64>,
}

fn paper(name: &str) -> Result<&'static Paper, String> {
    let names = PAPERS.map(|p| p.name).join(", ");
    Paper::find(name).ok_or_else(|| format!("expected one of {names} (nistir4832 and nistir4854 too)"))
}

/// Exits with 2 on bad input, with 1 on any other error.
fn main() -> ExitCode {
    let Err(error) = run(&Args::parse()) else { return ExitCode::SUCCESS };
    eprintln!("rtec-papers: {error:#}");
    ExitCode::from(if error.is::<InputError>() { 2 } else { 1 })
}

fn run(args: &Args) -> anyhow::Result<()> {
    let described = MachineDescriptions::of(args.from.clone());
    if let Some(folder) = args.from.as_deref().filter(|f| !f.is_dir()) {
        return Err(InputError::whole(folder, "no such folder", "a folder with the machines' files").into());
    }
    if let Some(folder) = &args.write {
        let trace = rtec_papers::cmti::trace(&described, args.seed).map_err(input_error)?;
        return write_all(folder, FILES.iter().copied().chain([("cmti.vcd", trace.as_str())]));
    }
    for paper in PAPERS.iter().filter(|p| args.paper.is_none_or(|own| own.name == p.name)) {
        let mut progress = |step: &str| eprintln!("rtec-papers: {step}");
        if let Some(n) = args.seeds {
            let (mut spread, last) = (Spread::default(), args.seed.saturating_add(n - 1));
            for seed in args.seed..=last {
                spread.add(paper.compare(&described, seed, &mut progress).map_err(input_error)?);
            }
            tell_missing(&described, args);
            println!("{}, seeds {} to {last}\n{}", paper.title, args.seed, spread.table());
            continue;
        }
        let compared = paper.compare(&described, args.seed, &mut progress).map_err(input_error)?;
        tell_missing(&described, args);
        if let Some(folder) = &args.out {
            write_all(folder, compared.figures.iter().map(|(name, text)| (name.as_str(), text.as_str())))?;
        }
        print!("{}", table(&compared, args.differ));
    }
    Ok(())
}

/// Names the files that `--from` was expected to have.
fn tell_missing(described: &MachineDescriptions, args: &Args) {
    let folder = args.from.as_deref().unwrap_or(Path::new(""));
    for file in described.take_missing() {
        eprintln!("rtec-papers: no {}: the one built in was taken", folder.join(file).display());
    }
}

fn write_all<'t>(folder: &Path, files: impl Iterator<Item = (&'t str, &'t str)>) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("making {}", folder.display()))?;
    for (name, text) in files {
        let file = folder.join(name);
        rtec_files::atomic_write::write_atomically(&file, text.as_bytes())
            .with_context(|| format!("writing {}", file.display()))?;
        eprintln!("rtec-papers: wrote {}", file.display());
    }
    Ok(())
}

/// Finds the input error within the errors of the layers above it.
fn input_error(error: PaperError) -> anyhow::Error {
    match error {
        PaperError::Input(input)
        | PaperError::Experiment(
            ExperimentError::Record(input) | ExperimentError::Sim(SimError::Model(input)),
        )
        | PaperError::Sim(SimError::Model(input)) => input.into(),
        other => other.into(),
    }
}

/// A source as a table: place, what, paper, we.
/// A row that differs has the number of its reason. The reason follows the first such row of a place.
fn table(c: &Compared, differ: bool) -> String {
    let [compared, fitted, given] = c.counts;
    let mut text = format!(
        "{}, seed {}\n{compared}\nnot counted: fitted to the source's figures: {fitted}; given by the machine's file: {given}\n",
        c.title, c.seed
    );
    let mut reasons: Vec<&str> = Vec::new();
    let (mut place, mut said) = ("", Vec::new());
    for row in c.rows.iter().filter(|r| !differ || r.verdict == Verdict::Differs) {
        if place != row.place {
            let _ = writeln!(text, "\n{}\n  {:<83} {:>16}  {:>16}", row.place, "", "paper says", "we get");
            place = &row.place;
            said.clear();
        }
        let mark = match row.verdict {
            Verdict::Agrees if row.why.is_empty() => String::new(),
            Verdict::Agrees => format!("  ({})", row.agreement),
            Verdict::Differs => format!("  DIFFERS: not {}", row.agreement),
        };
        let Row { what, says, gets, unit, basis, .. } = row;
        let line = format!("  {what:<76} {:<6} {says:>16}  {gets:>16} {unit}{mark}", basis.mark());
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
    for table in c.tables.iter().filter(|_| !differ) {
        let _ = write!(text, "\n{table}");
    }
    if c.too_small > 0 {
        let _ = writeln!(text, "\nleft out: {} figures that are no larger than their tolerance", c.too_small);
    }
    text + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;
    use rtec_papers::{Basis, Count};

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
            basis: Basis::Compared,
            why: why.into(),
        }
    }

    #[test]
    fn names_the_reason_of_every_row_that_differs() {
        let rows = vec![
            row("Table 1", "first", Verdict::Differs, "a scale of its own"),
            row("Table 1", "second", Verdict::Agrees, ""),
            row("Table 1", "third", Verdict::Differs, "noise"),
            row("Table 1", "fourth", Verdict::Differs, "a scale of its own"),
            row("Table 2", "fifth", Verdict::Differs, "a scale of its own"),
        ];
        let (paper, title) = ("p", "A paper");
        let counts = Basis::ALL.map(|basis| Count { basis, agree: 1, differ: 4 });
        let (tables, figures) = (Vec::new(), Vec::new());
        let compared = Compared { paper, title, seed: 1, counts, too_small: 0, rows, tables, figures };
        let text = table(&compared, false);
        assert!(text.contains("\n1 agree, 4 differ\n"), "{text}");
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

    #[test]
    fn marks_what_was_put_in() {
        let mut rows =
            Basis::ALL.map(|basis| Row { basis, ..row("Table 1", basis.mark(), Verdict::Agrees, "") });
        rows[0].what = "measured".into();
        let counts = Basis::ALL.map(|basis| Count { basis, agree: 1, differ: 0 });
        let compared = Compared {
            paper: "p",
            title: "A paper",
            seed: 1,
            counts,
            too_small: 0,
            rows: rows.into(),
            tables: Vec::new(),
            figures: Vec::new(),
        };
        let text = table(&compared, false);
        let marked = |mark: &str| text.lines().filter(|l| l.matches(mark).count() == 2).count();
        assert_eq!([marked("fitted "), marked("given ")], [1, 1], "{text}");
        assert!(
            text.contains("not counted: fitted to the source's figures: 1 agree, 0 differ; given"),
            "{text}"
        );
    }
}
