//! The blind suite: hundreds of machines with hidden effects.
//! It judges the answers and prints them beside two baselines.
//!
//! `rtec-blind [--class WORD[,WORD…]|narrow|wide|all] [--manner first|second] [--from SEED] [--count N] [--jobs N]
//! [--bare] [--json] [-v]`

use rtec_blind::case::Hides;
use rtec_blind::class::{CLASSES, Class};
use rtec_blind::judge::Heard;
use rtec_blind::mistakes::KINDS;
use rtec_blind::outcome::{Outcome, outcome};
use rtec_blind::plan::Manner;
use rtec_blind::record::{self, Figure};
use rtec_blind::score::Mark;
use rtec_blind::table::{self, right, wrong};
use std::collections::BTreeMap;
use std::process::ExitCode;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

const USAGE: &str = "rtec-blind [--class WORD[,WORD…]|narrow|wide|all] [--manner first|second] [--from SEED] [--count N] \
                     [--jobs N] [--bare] [--json] [-v]";

/// Share of the gap below which a case is printed.
const OPEN: f64 = 0.9;

/// The arguments.
struct Asked {
    classes: Vec<Class>,
    manner: Option<Manner>,
    from: u64,
    count: Option<usize>,
    jobs: usize,
    bare: bool,
    json: bool,
    verbose: bool,
}

fn asked(args: &[String]) -> Result<Asked, String> {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let mut a = Asked {
        classes: chosen("narrow")?,
        manner: None,
        from: 10_000,
        count: None,
        jobs: cores,
        bare: false,
        json: false,
        verbose: false,
    };
    let mut rest = args.iter();
    while let Some(arg) = rest.next() {
        let mut value = || rest.next().ok_or(format!("{arg} wants a value"));
        let number = |v: &String| v.parse::<u64>().map_err(|_| format!("{arg} {v}: not a whole number"));
        match arg.as_str() {
            "--class" => a.classes = chosen(value()?)?,
            "--manner" => {
                a.manner = Some(match value()?.as_str() {
                    "first" => Manner::First,
                    "second" => Manner::Second,
                    other => return Err(format!("--manner {other}: first or second")),
                });
            }
            "--from" => a.from = number(value()?)?,
            "--count" => a.count = Some(number(value()?)? as usize).filter(|n| *n > 0),
            "--jobs" => a.jobs = (number(value()?)? as usize).max(1),
            "--bare" => a.bare = true,
            "--json" => a.json = true,
            "-v" => a.verbose = true,
            other => return Err(format!("`{other}` is no option")),
        }
    }
    Ok(a)
}

fn chosen(words: &str) -> Result<Vec<Class>, String> {
    let mut out = Vec::new();
    for word in words.split(',') {
        let narrow = |c: &Class| matches!(c, Class::Narrow(_));
        let of = |yes: &dyn Fn(Class, &str) -> bool| -> Vec<Class> {
            CLASSES.iter().filter(|(c, w, _)| yes(*c, w)).map(|(c, ..)| *c).collect()
        };
        let more = match word {
            "all" => of(&|_, _| true),
            "narrow" => of(&|c, _| narrow(&c)),
            "wide" => of(&|c, _| !narrow(&c)),
            word => of(&|_, w| w == word),
        };
        if more.is_empty() {
            let words: Vec<&str> = CLASSES.iter().map(|(_, w, _)| *w).collect();
            return Err(format!("--class {word}: one of {}, narrow, wide, all", words.join(", ")));
        }
        out.extend(more);
    }
    Ok(out)
}

fn main() -> anyhow::Result<ExitCode> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let asked = match asked(&args) {
        Ok(a) => a,
        Err(why) => {
            eprintln!("{why}\n{USAGE}");
            return Ok(ExitCode::from(2));
        }
    };
    let mut plan: Vec<(Class, u64, Manner)> = Vec::new();
    for (class, _, usual) in CLASSES.iter().filter(|(c, ..)| asked.classes.contains(c)) {
        for i in 0..asked.count.unwrap_or(*usual) as u64 {
            let turn = if i % 2 == 0 { Manner::First } else { Manner::Second };
            plan.push((*class, asked.from + i, asked.manner.unwrap_or(turn)));
        }
    }
    let outcomes = run(&plan, &asked)?;
    if asked.verbose {
        let taken_wrong =
            |o: &Outcome| o.mistake.as_ref().is_some_and(|m| m.1 != Heard::Said || !m.2.is_empty());
        let told = |o: &&Outcome| {
            if o.mistake.is_some() {
                return taken_wrong(o);
            }
            let by_truth = o.oracle_closed.unwrap_or(1.0);
            let open = o.closed.is_some_and(|c| c < OPEN && c < by_truth);
            !right(o.mark) || open || o.covered.iter().any(|c| !c.holds) || !o.suspicions.is_empty()
        };
        outcomes.iter().filter(told).for_each(tell);
        let mut longest: Vec<&Outcome> = outcomes.iter().collect();
        longest.sort_by(|a, b| b.seconds.total_cmp(&a.seconds));
        for o in longest.into_iter().take(5) {
            eprintln!(
                "{:.2} s of processor: {} seed {}, {}",
                o.seconds,
                o.class.word(),
                o.case.seed,
                o.case.design
            );
        }
    }
    if asked.json {
        println!("{:#}", table::json(&outcomes, !asked.bare));
        return Ok(ExitCode::SUCCESS);
    }
    let narrow: Vec<&Outcome> = outcomes.iter().filter(|o| matches!(o.class, Class::Narrow(_))).collect();
    let good = narrow.is_empty() || report(&narrow, !asked.bare);
    if narrow.len() < outcomes.len() {
        print!("{}", table::markdown(&outcomes, !asked.bare));
    }
    Ok(if good { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Runs every case, several at a time; returns them in order.
fn run(plan: &[(Class, u64, Manner)], asked: &Asked) -> anyhow::Result<Vec<Outcome>> {
    let (next, done) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    let failed = Mutex::new(None);
    std::thread::scope(|scope| {
        for _ in 0..asked.jobs {
            scope.spawn(|| {
                loop {
                    let i = next.fetch_add(1, Ordering::Relaxed);
                    let Some(&(class, seed, manner)) = plan.get(i) else { break };
                    match outcome(class, seed, manner, !asked.bare) {
                        Ok(o) => {
                            if let Ok(mut all) = done.lock() {
                                all.push((i, o));
                            }
                        }
                        Err(e) => {
                            if let Ok(mut f) = failed.lock() {
                                *f = Some(e);
                            }
                        }
                    }
                    if i % 50 == 49 {
                        eprintln!("{} of {} cases", i + 1, plan.len());
                    }
                }
            });
        }
    });
    if let Some(e) = failed.into_inner().ok().flatten() {
        return Err(e);
    }
    let mut all = done.into_inner().unwrap_or_default();
    all.sort_by_key(|(i, _)| *i);
    Ok(all.into_iter().map(|(_, o)| o).collect())
}

/// Prints a case with a wrong answer to standard error.
fn tell(o: &Outcome) {
    let missed: Vec<String> = o
        .covered
        .iter()
        .filter(|c| !c.holds)
        .map(|c| {
            let alias = if c.alias_said { "; the true period stands beside it" } else { "" };
            format!("\n    not in its interval: {}{alias}", c.what)
        })
        .collect();
    let suspected = match &o.suspicions[..] {
        [] => String::new(),
        said => format!("\n    suspected: {said:?}"),
    };
    let beyond = o.impossible.iter().map(|what| format!("\n    that no machine has: {what}"));
    let missed: Vec<String> = missed.into_iter().chain(beyond).collect();
    let taken = o.mistake.as_ref().map_or(suspected, |(kind, heard, twin)| {
        let (_, kind) = KINDS[*kind];
        format!("\n    {kind}: {heard:?} {:?}; its clean twin: {twin:?}", o.suspicions)
    });
    let closed =
        [o.closed, o.oracle_closed].map(|c| c.map_or("–".into(), |c| format!("{:.1} %", 100.0 * c)));
    eprintln!(
        "{:?} {} seed {} {:?} {} {:.1}s, closed {}, with the true names {}\n    hidden {:?} at {:.1?}; {}\n    answer {} {:?}{}{}{taken}",
        o.mark,
        o.class.word(),
        o.case.seed,
        o.case.hides,
        o.case.design,
        o.seconds,
        closed[0],
        closed[1],
        o.case.truth,
        o.case.snr,
        o.case.story,
        o.reply.verdict,
        o.reply.effects,
        missed.concat(),
        o.refused.as_ref().map_or(String::new(), |why| format!("\n    refused: {why}")),
    );
}

/// Prints all figures, with BIC and LASSO where they were run.
/// Returns whether the figures hold, within the chance of so many cases.
fn report(lines: &[&Outcome], baselines: bool) -> bool {
    println!("confusion: what was hidden, what was answered (all others right)");
    let mut confusion: BTreeMap<(String, String), usize> = BTreeMap::new();
    for l in lines.iter().filter(|l| !right(l.mark)) {
        let law = |n: &str| n.split('.').next().unwrap_or("").to_owned();
        let truth = if l.case.truth.is_empty() {
            "nothing".into()
        } else {
            l.case.truth.iter().map(|t| law(t)).collect::<Vec<_>>().join("+")
        };
        let answer = match l.reply.verdict.as_str() {
            "named" | "not_separable" => {
                l.reply.effects.iter().map(|(n, _)| law(n)).collect::<Vec<_>>().join("+")
            }
            other => other.to_owned(),
        };
        *confusion.entry((truth, answer)).or_default() += 1;
    }
    for ((truth, answer), n) in &confusion {
        println!("    {truth:32} -> {answer:32} {n}");
    }
    let share = |of: &dyn Fn(&Outcome) -> bool, yes: &dyn Fn(&Outcome) -> bool| -> (usize, usize) {
        let all: Vec<&&Outcome> = lines.iter().filter(|l| of(l)).collect();
        (all.iter().filter(|l| yes(l)).count(), all.len())
    };
    println!(
        "detection against amplitude (one hidden): effect/noise, cases, right, of these as a group{}",
        if baselines { "; BIC right; LASSO right" } else { "" }
    );
    for (lo, hi) in [(0.0, 1.0), (1.0, 1.5), (1.5, 2.0), (2.0, 3.0), (3.0, 5.0), (5.0, 99.0)] {
        let of = |l: &Outcome| l.case.hides == Hides::One && l.case.snr[0] >= lo && l.case.snr[0] < hi;
        let (r, n) = share(&of, &|l| right(l.mark));
        let (g, _) = share(&of, &|l| l.mark == Mark::Group);
        let [b, l] = [0, 1].map(|k| share(&of, &|l| right(l.base[k])).0);
        let beside = if baselines { format!("   {b:4}  {l:4}") } else { String::new() };
        println!("    {lo:4.1} to {hi:4.1}  {n:4}  {r:4}  {g:4}{beside}");
    }
    let mut good = true;
    let mut row = |figure: Figure, of: &dyn Fn(&Outcome) -> bool, yes: fn(Mark) -> bool| {
        let (k, n) = share(of, &|l| yes(l.mark));
        let percent = |k: usize| 100.0 * k as f64 / n.max(1) as f64;
        let [bic, lasso] = [0, 1].map(|b| percent(share(of, &|l| yes(l.base[b])).0));
        good &= figure.within_chance((k, n));
        let beside =
            if baselines { format!("  BIC {bic:5.1} %  LASSO {lasso:5.1} %") } else { String::new() };
        println!(
            "    {:40} {:5.1} % ({k}/{n}){beside}  {}  {}",
            figure.what,
            percent(k),
            figure.asks(),
            if figure.reached((k, n)) { "reached" } else { "NOT REACHED" }
        );
    };
    let one = |l: &Outcome| l.case.hides == Hides::One;
    let high = |l: &Outcome| one(l) && l.case.snr[0] >= 2.0;
    let two = |l: &Outcome| l.case.hides == Hides::Two && l.case.snr.iter().all(|s| *s >= 3.0);
    let known = |l: &Outcome| matches!(l.case.hides, Hides::One | Hides::Two);
    let null = |l: &Outcome| l.case.hides == Hides::Nothing;
    let stranger = |l: &Outcome| l.case.hides == Hides::Stranger;
    println!("figures");
    row(record::ONE_CLEAR, &high, right);
    row(record::ONE, &one, right);
    row(record::WRONG, &known, wrong);
    row(record::NOTHING, &null, |m| !right(m));
    row(record::UNKNOWN, &stranger, right);
    row(record::UNKNOWN_NAMED, &stranger, wrong);
    row(record::BOTH, &two, right);
    let mut closed: Vec<f64> =
        lines.iter().filter(|l| known(l) && right(l.mark)).filter_map(|l| l.closed).collect();
    closed.sort_by(f64::total_cmp);
    if !closed.is_empty() {
        let at = |q: f64| 100.0 * closed[((closed.len() - 1) as f64 * q) as usize];
        println!(
            "    gap closed where named: median {:.1} %, tenth percentile {:.1} % (asked 99 and 85)",
            at(0.5),
            at(0.1)
        );
    }
    let mean = lines.iter().map(|l| l.seconds).sum::<f64>() / lines.len().max(1) as f64;
    let mut by_time: Vec<&Outcome> = lines.to_vec();
    by_time.sort_by(|a, b| a.seconds.total_cmp(&b.seconds));
    if let Some(l) = by_time.last() {
        println!(
            "    processor time per case: median {:.2} s, mean {mean:.2} s, longest {:.2} s ({:?} seed {}, {})",
            by_time[by_time.len() / 2].seconds,
            l.seconds,
            l.case.hides,
            l.case.seed,
            l.case.design
        );
    }
    println!(
        "    {} of {} cases answered rightly",
        lines.iter().filter(|l| right(l.mark)).count(),
        lines.len()
    );
    good
}
