//! The figures of all classes as a markdown table, or as JSON.

use crate::case::Hides;
use crate::class::{CLASSES, Class};
use crate::judge::Heard;
use crate::mistakes::KINDS;
use crate::outcome::{Counts, Outcome};
use crate::score::Mark;
use serde_json::{Value, json};
use std::fmt::Write as _;

/// Whether a mark counts as right.
pub fn right(m: Mark) -> bool {
    matches!(m, Mark::Exact | Mark::Group)
}

/// Whether a mark is a wrong name.
pub fn wrong(m: Mark) -> bool {
    matches!(m, Mark::Wrong | Mark::WrongGroup)
}

/// A share: `yes` of `all`.
#[derive(Clone, Copy, Default)]
struct Share(usize, usize);

impl Share {
    fn of<'o>(outcomes: impl Iterator<Item = &'o Outcome>, yes: impl Fn(&Outcome) -> bool) -> Self {
        outcomes.fold(Self(0, 0), |s, o| Self(s.0 + usize::from(yes(o)), s.1 + 1))
    }

    fn cell(self) -> String {
        match self {
            Self(_, 0) => "–".into(),
            Self(k, n) => format!("{:.0} % ({k}/{n})", 100.0 * k as f64 / n as f64),
        }
    }

    fn json(self) -> Value {
        json!({ "yes": self.0, "of": self.1 })
    }
}

fn quantile(values: &[f64], q: f64) -> Option<f64> {
    let mut v = values.to_vec();
    v.sort_by(f64::total_cmp);
    v.get(((v.len().max(1) - 1) as f64 * q) as usize).copied()
}

/// Figures of one class and one method: the reconciler, a baseline, the oracle.
struct Row {
    class: Class,
    way: &'static str,
    cases: usize,
    shares: Vec<(&'static str, Share)>,
    gap: [Option<f64>; 2],
    impossible: Option<usize>,
    refused: Option<usize>,
    suspected: Option<usize>,
    seconds: Option<f64>,
}

fn rows(outcomes: &[Outcome], baselines: bool) -> Vec<Row> {
    let mut out = Vec::new();
    for (class, ..) in CLASSES.iter().filter(|(c, ..)| *c != Class::Mistakes) {
        let of: Vec<&Outcome> = outcomes.iter().filter(|o| o.class == *class).collect();
        if of.is_empty() {
            continue;
        }
        out.push(row(*class, "finder", &of, 0, &|o| o.mark));
        if baselines {
            out.push(row(*class, "BIC", &of, 1, &|o| o.base[0]));
            out.push(row(*class, "LASSO", &of, 2, &|o| o.base[1]));
        }
        if !matches!(class, Class::Narrow(_)) {
            let by_truth = |o: &Outcome| if o.oracle { Mark::Exact } else { Mark::Missed };
            out.push(row(*class, "oracle", &of, 3, &by_truth));
        }
    }
    out
}

fn row(class: Class, way: &'static str, of: &[&Outcome], k: usize, mark: &dyn Fn(&Outcome) -> Mark) -> Row {
    let all = || of.iter().copied();
    let is = |o: &Outcome, hides: Hides| o.case.hides == hides;
    let high = |o: &&Outcome| !is(o, Hides::Nothing) && o.case.snr.iter().all(|s| *s >= 2.0);
    let many = |o: &&Outcome| is(o, Hides::Many);
    let sum = |f: &dyn Fn(Counts) -> [usize; 2]| {
        all().filter(many).map(|o| f(o.counts[k])).fold(Share(0, 0), |s, [a, b]| Share(s.0 + a, s.1 + b))
    };
    let covered = |o: &Outcome| match k {
        0 => [o.covered.iter().filter(|c| c.holds).count(), o.covered.len()],
        3 => o.oracle_covered,
        _ => [0, 0],
    };
    let add = |s: Share, [a, b]: [usize; 2]| Share(s.0 + a, s.1 + b);
    // Parameters outside the interval whose period is an alias that lists the true one.
    let aliased = |o: &Outcome| {
        let outside = o.covered.iter().filter(|c| !c.holds && k == 0);
        [outside.clone().filter(|c| c.alias_said).count(), outside.count()]
    };
    let shares = vec![
        ("right, effect/noise ≥ 2", Share::of(all().filter(high), |o| right(mark(o)))),
        ("right, all", Share::of(all(), |o| right(mark(o)))),
        ("wrong name", Share::of(all().filter(|o| !is(o, Hides::Nothing)), |o| wrong(mark(o)))),
        ("found in nothing", Share::of(all().filter(|o| is(o, Hides::Nothing)), |o| wrong(mark(o)))),
        ("unknown called so", Share::of(all().filter(|o| is(o, Hides::Stranger)), |o| right(mark(o)))),
        ("both of two", Share::of(all().filter(|o| is(o, Hides::Two)), |o| right(mark(o)))),
        ("recall", sum(&|c| [c.found, c.asked])),
        ("precision", if k == 3 { Share::default() } else { sum(&|c| [c.true_names, c.named]) }),
        ("in the 95 % interval", all().map(covered).fold(Share(0, 0), add)),
        (
            "of those outside: of an alias, the true period beside it",
            all().map(aliased).fold(Share(0, 0), add),
        ),
    ];
    // A name closes nothing without a law, and where nothing is missing there is no gap.
    let closed: Vec<f64> = all()
        .filter(|o| !is(o, Hides::Nothing) && !is(o, Hides::Stranger))
        .filter_map(|o| match k {
            0 => o.closed,
            3 => o.oracle_closed,
            _ => None,
        })
        .collect();
    let finder = k == 0;
    Row {
        class,
        way,
        cases: of.len(),
        shares,
        gap: [quantile(&closed, 0.5), quantile(&closed, 0.1)],
        impossible: finder.then(|| all().map(|o| o.impossible.len()).sum()),
        refused: finder.then(|| all().filter(|o| o.refused.is_some()).count()),
        suspected: finder.then(|| all().filter(|o| !o.suspicions.is_empty()).count()),
        seconds: finder.then(|| all().map(|o| o.seconds).sum::<f64>() / of.len() as f64),
    }
}

/// How each kind of mistake was treated.
/// It also counts how often its clean twin raised a suspicion.
fn taken(outcomes: &[Outcome]) -> Vec<(&'static str, &'static str, [Share; 4])> {
    KINDS
        .iter()
        .enumerate()
        .filter_map(|(k, (what, text))| {
            let of = || outcomes.iter().filter(move |o| o.mistake.as_ref().is_some_and(|m| m.0 == k));
            let how = |h: Heard| Share::of(of(), |o| o.mistake.as_ref().is_some_and(|m| m.1 == h));
            let twin = Share::of(of(), |o| o.mistake.as_ref().is_some_and(|m| !m.2.is_empty()));
            (of().count() > 0)
                .then(|| (*what, *text, [how(Heard::Said), how(Heard::Wrong), how(Heard::Silent), twin]))
        })
        .collect()
}

/// The tables as markdown.
pub fn markdown(outcomes: &[Outcome], baselines: bool) -> String {
    let mut text = String::new();
    let rows = rows(outcomes, baselines);
    if let Some(first) = rows.first() {
        let heads: Vec<&str> = ["class", "by", "cases"]
            .into_iter()
            .chain(first.shares.iter().map(|s| s.0))
            .chain([
                "gap closed, median",
                "10th percentile",
                "impossible values",
                "refused",
                "suspected",
                "CPU s a case",
            ])
            .collect();
        text += &format!("| {} |\n|{}\n", heads.join(" | "), "---|".repeat(heads.len()));
    }
    let or_dash = |v: Option<String>| v.unwrap_or_else(|| "–".into());
    for r in &rows {
        let cells: Vec<String> = [r.class.word().to_owned(), r.way.into(), r.cases.to_string()]
            .into_iter()
            .chain(r.shares.iter().map(|s| s.1.cell()))
            .chain(r.gap.iter().map(|g| or_dash(g.map(|g| format!("{:.1} %", 100.0 * g)))))
            .chain([r.impossible, r.refused, r.suspected].map(|n| or_dash(n.map(|n| n.to_string()))))
            .chain([or_dash(r.seconds.map(|s| format!("{s:.2}")))])
            .collect();
        text += &format!("| {} |\n", cells.join(" | "));
    }
    let taken = taken(outcomes);
    if !taken.is_empty() {
        text += "\n| mistake | word | said | wrong effect named | silent | clean twin suspected |\n|---|---|---|---|---|---|\n";
    }
    let mut sums = [Share::default(); 4];
    for (what, kind, shares) in &taken {
        let cells = shares.map(Share::cell);
        let _infallible = writeln!(text, "| {kind} | {what} | {} |", cells.join(" | "));
        for (sum, s) in sums.iter_mut().zip(shares) {
            *sum = Share(sum.0 + s.0, sum.1 + s.1);
        }
    }
    if !taken.is_empty() {
        text += &format!("| all | | {} |\n", sums.map(Share::cell).join(" | "));
    }
    text
}

/// The same as one JSON document.
pub fn json(outcomes: &[Outcome], baselines: bool) -> Value {
    let classes: Vec<Value> = rows(outcomes, baselines)
        .iter()
        .map(|r| {
            let shares: serde_json::Map<String, Value> =
                r.shares.iter().map(|(k, s)| ((*k).to_owned(), s.json())).collect();
            json!({
                "class": r.class.word(), "by": r.way, "cases": r.cases, "shares": shares,
                "gap_closed": { "median": r.gap[0], "p10": r.gap[1] },
                "impossible_values": r.impossible, "refused": r.refused, "suspected": r.suspected, "cpu_s": r.seconds,
            })
        })
        .collect();
    let mistakes: Vec<Value> = taken(outcomes)
        .iter()
        .map(|(what, kind, [said, wrong, silent, twin])| {
            json!({
                "mistake": kind, "what": what, "said": said.json(), "wrong_effect": wrong.json(),
                "silent": silent.json(), "clean_twin_suspected": twin.json(),
            })
        })
        .collect();
    json!({ "classes": classes, "mistakes": mistakes })
}
