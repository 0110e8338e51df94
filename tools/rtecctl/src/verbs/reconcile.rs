//! `rtecctl reconcile`: finds where simulation and measurement disagree.
//! It names missing effects and writes a better model.

use super::characterise::record::{RecorderArgs, record};
use super::read_records;
use crate::json_output::write;
use crate::prelude::*;
use crate::uncertainty_rounding::with_half;
use rtec_files::cli_option_parsers::number;
use rtec_files::{InputError, date};
use rtec_model::machine::Machine;
use rtec_reconcile::{
    LAWS_FILE, ReconciliationOptions, ReconciliationResult, ResidualStructure, RevisedEffect, SEED, html,
    reconcile, why,
};

/// Find what the model of a machine lacks: name it, add it, show the gap shrink
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Run records to learn from
    #[arg(required_unless_present = "live", value_name = "TRAIN.run.toml")]
    train: Vec<PathBuf>,
    /// First record a run with the corrector's own recorder into this file (a bench reads the error), and learn from it
    #[arg(long, value_name = "NAME.run.toml")]
    live: Option<PathBuf>,
    #[command(flatten)]
    recorder: RecorderArgs,
    /// The machine model as it is; never touched
    #[arg(long)]
    model: PathBuf,
    /// A later run, for the last stage's figures only; may repeat
    #[arg(long, value_name = "LATER.run.toml")]
    holdout: Vec<PathBuf>,
    /// Directory for verdict.json, model.toml and report.html, created where it is missing
    #[arg(long)]
    out: Option<PathBuf>,
    /// Print the verdict as one JSON document
    #[arg(long)]
    json: bool,
    /// How often chance alone may lead to an answer
    #[arg(long, default_value_t = 0.01,
          value_parser = number(|v| v > 0.0 && v < 0.5, "a probability above 0 and below 0.5"))]
    level: f64,
    /// Stop after a stage: find (where they disagree), name (what is missing), add (the better model), show (all)
    #[arg(long, value_enum, default_value_t = Stage::Show)]
    stage: Stage,
    /// Where something has no name, add a bounded curve in its place, marked as unexplained; its law goes to
    /// unexplained.toml beside the model
    #[arg(long, requires = "out")]
    unexplained: bool,
    /// Print the evidence for and against one effect instead of the summary: name of the dictionary, as reversal.x
    #[arg(long, value_name = "NAME", conflicts_with = "json")]
    why: Option<String>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, clap::ValueEnum)]
enum Stage {
    Find,
    Name,
    Add,
    Show,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let usage = |found: String, expected: &str| InputError::whole(Path::new("reconcile"), found, expected);
    if let (None, Some(option)) = (&args.live, args.recorder.given()) {
        return Err(usage(
            format!("{option} without --live"),
            "--live NAME.run.toml with it: it says how a run is recorded; records that are there need it not",
        )
        .into());
    }
    let machine = Machine::read(&args.model)?;
    spares_inputs(args)?;
    let asked = args.why.as_ref().map(|name| machine.dictionary().effect(name));
    let asked =
        asked.transpose().map_err(|error| usage(format!("--why {}", error.found), &error.expected))?;
    if asked.is_some() && args.stage == Stage::Find {
        let expected = "a later stage: the first says where, not what";
        return Err(usage("--why with --stage find".to_owned(), expected).into());
    }
    let mut runs = args.train.clone();
    if let Some(live) = &args.live {
        record(live, &args.recorder, true)?;
        runs.push(live.clone());
    }
    let (train, holdout) = (read_records(&runs)?, read_records(&args.holdout)?);
    spares_inputs(args)?;
    let date = date::format(date::today());
    let figures = args.stage == Stage::Show;
    let options =
        ReconciliationOptions { level: args.level, date: Some(date), unexplained: args.unexplained, figures };
    let answer = reconcile(&train, &holdout, &machine, &options)?;
    answer.say_of(&train, &holdout, &mut super::input_notices::say);
    if args.stage == Stage::Find {
        let document = answer.to_json();
        let document = json!({"where": document["where"], "level": args.level, "seed": SEED});
        return tell(args, &document, &found(&answer), &[]);
    }
    let mut document = answer.to_json();
    if let (false, Some(map)) = (figures, document.as_object_mut()) {
        map.remove("gap");
    }
    let mut files = Vec::new();
    if let (true, Some(dir)) = (args.stage >= Stage::Add, &args.out) {
        files.extend(answer.curve.as_ref().map(|(_, laws)| (LAWS_FILE, laws.clone())));
        // Other files that the model names are found relative to that folder.
        std::fs::create_dir_all(dir).with_context(|| format!("creating {}", dir.display()))?;
        let beside: Vec<(&str, &str)> = files.iter().map(|(name, text)| (*name, text.as_str())).collect();
        let model = answer.model.readable_text_at(&dir.join("model.toml"), &beside)?;
        files.push(("model.toml", model));
    }
    if figures {
        files.push(("report.html", html(&answer, machine.name())));
    }
    let text = match &asked {
        Some(effect) => why(&answer, effect, &train, machine.dictionary()),
        None => summary(&answer),
    };
    tell(args, &document, &text, &files)
}

/// Refuses an output that would overwrite an input.
/// It is checked before the work, which may take minutes.
fn spares_inputs(args: &Args) -> Result<(), InputError> {
    let Some(dir) = &args.out else { return Ok(()) };
    let written = [
        ("verdict.json", Stage::Find),
        ("model.toml", Stage::Add),
        (LAWS_FILE, Stage::Add),
        ("report.html", Stage::Show),
    ];
    let mut names = written.iter().filter(|(_, from)| args.stage >= *from);
    names.try_for_each(|(name, _)| rtec_files::atomic_write::is_no_input(&dir.join(name)))
}

/// Writes the verdict and other files to the directory, and prints the result.
fn tell(args: &Args, document: &Value, summary: &str, files: &[(&str, String)]) -> anyhow::Result<()> {
    let text = pretty(document)?;
    if let Some(dir) = &args.out {
        std::fs::create_dir_all(dir).with_context(|| format!("creating {}", dir.display()))?;
        write(&dir.join("verdict.json"), &text)?;
        for (name, text) in files {
            write(&dir.join(name), text)?;
        }
    }
    if args.json {
        say(&text);
    } else {
        print!("{summary}");
    }
    Ok(())
}

/// A probability for people; permutations show none below one in a thousand.
fn chance(p: f64) -> String {
    if p <= 0.001 { "< 0.001".to_owned() } else { format!("{p:.3}") }
}

fn found(answer: &ReconciliationResult) -> String {
    use std::fmt::Write as _;
    let mut s = String::from("Where measured and simulated disagree (false-discovery rate 5 %):\n");
    let found: Vec<_> = answer.places.iter().filter(|p| p.counts()).collect();
    let line = |p: &ResidualStructure| {
        let (response, against, share, p) =
            (&p.response, p.against(), 100.0 * p.statistic, chance(p.p_value));
        format!("{response} against {against}: {share:.1} %, p {p}")
    };
    for p in found.iter().take(8) {
        let _ = writeln!(s, "  {}", line(p));
    }
    for g in answer.gap.iter().filter(|_| found.is_empty()) {
        let ([left, _], unit, floor) = (g.train, &g.unit, g.floor);
        if !answer.is_above_floor(g) {
            let _ = writeln!(s, "  nowhere: {left:.4} {unit} are left; one reading scatters by {floor:.4}");
            continue;
        }
        let _ = writeln!(
            s,
            "  against nothing beyond chance, but {left:.4} {unit} are left where one reading scatters by {floor:.4}"
        );
        if let Some(p) = answer.places.first() {
            let _ = writeln!(s, "  nearest: {}", line(p));
        }
        for of in &answer.set_up {
            for (name, value, half) in &of.terms {
                if !name.starts_with("zero") && value.abs() > *half {
                    let value = with_half(*value, *half);
                    let _ = writeln!(s, "  in the set-up of {}: {name} = {value}", of.record);
                }
            }
        }
    }
    s
}

/// Values of an effect before and after; none for a curve with many.
fn values(x: &RevisedEffect) -> String {
    let (after, half) = &x.after;
    let law = x.before.description();
    let each = law.parameters.iter().enumerate().filter(|(i, p)| !p.array && half[*i] > 0.0);
    let each = each.map(|(i, p)| {
        let name = if p.name == p.unit { String::new() } else { format!("{} ", p.name) };
        let [was, now] = [x.before.scalar(i), after.scalar(i)].map(|v| with_half(v, half[i]));
        let was = was.split(' ').next().unwrap_or_default();
        format!("{name}{was} -> {now} {}", p.unit)
    });
    let each = list(each);
    if each.is_empty() { each } else { format!(": {each}") }
}

fn summary(r: &ReconciliationResult) -> String {
    use std::fmt::Write as _;
    let mut s = found(r);
    let but = r.reservation().map_or_else(String::new, |reservation| format!("; {reservation}"));
    let _ = writeln!(s, "Verdict: {}{but}", r.verdict);
    for (f, half) in &r.effects {
        let sensor = f.effect.delta.as_ref().map_or_else(String::new, |d| format!(" ({d})"));
        let _ = writeln!(s, "  {}{sensor}, p {}", f.effect.name(), chance(f.p_value));
        for (i, p) in f.effect.description().parameters.iter().enumerate().filter(|(_, p)| !p.array) {
            let _ = writeln!(s, "    {} = {} {}", p.name, with_half(f.effect.scalar(i), half[i]), p.unit);
        }
        for v in &f.rivals {
            let _ = writeln!(s, "    or {}, odds 1:{:.1}", v.label(), v.margin.exp());
        }
    }
    for u in &r.unexplained {
        // Nothing was judged.
        let _ = if u.against.is_empty() {
            writeln!(s, "  {}: {}", u.response, u.manner)
        } else {
            let against = u.against.join(" and ");
            writeln!(s, "  {} against {against}: {}, no effect explains it", u.response, u.manner)
        };
    }
    if let Some(curve) = r.curve.as_ref().map(|(curve, _)| curve.name()) {
        let _ = writeln!(s, "  {curve} takes its place in the model: a bounded curve, no explanation");
    }
    if let Some(why) = &r.no_curve {
        let _ = writeln!(s, "  no curve takes its place: {why}");
    }
    for x in &r.refined {
        let _ = writeln!(s, "  {} corrected{}", x.before.name(), values(x));
    }
    for g in &r.gap {
        let ([before, after], rows) = g.judged_on();
        let closed = g.closed().map_or_else(|| "-".to_owned(), |c| format!("{:.1} % ({rows})", 100.0 * c));
        let (unit, floor) = (&g.unit, g.floor);
        let _ = writeln!(s, "Gap: {before:.4} -> {after:.4} {unit}, floor {floor:.4}, closed {closed}");
        if let Some([before, after]) = g.without_strangers {
            let _ = writeln!(s, "  {before:.4} -> {after:.4} {unit} without what may be another machine's");
        }
    }
    for line in &r.left_out {
        let _ = writeln!(s, "Left out: {line}");
    }
    if !r.advice.is_empty() {
        let _ = writeln!(s, "Next: {}", r.advice);
    }
    s
}
