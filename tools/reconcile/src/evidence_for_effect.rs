//! The evidence for and against one name, as a table for a metrologist.

use crate::experiment_advice::separating;
use crate::findings_from_estimate::FoundEffect;
use crate::verdict::ReconciliationResult;
use rtec_estimate::TriedExplanation;
use rtec_estimate::search_limits::HOPELESS;
use rtec_model::effect::{Dictionary, Effect};
use rtec_model::record::Record;
use std::fmt::Write as _;

/// Odds in words: `12 to 1`, `1 to 12`.
fn odds(nats: f64) -> String {
    let of = |nats: f64| match nats.exp() {
        x if x < 100.0 => format!("{x:.1}"),
        x if x < 1e6 => format!("{x:.0}"),
        _ => format!("10^{:.0}", nats / std::f64::consts::LN_10),
    };
    if nats >= 0.0 { format!("{} to 1", of(nats)) } else { format!("1 to {}", of(-nats)) }
}

struct EvidenceTable(String);

impl EvidenceTable {
    fn row(&mut self, side: &str, figure: &str, meaning: &str) {
        let _ = writeln!(self.0, "  {side:<8} {figure:>14}  {meaning}");
    }
}

/// The evidence for and against an effect, and the runs that separate its rivals.
///
/// `effect` is any effect of the name in question.
#[must_use]
pub fn why(
    answer: &ReconciliationResult,
    effect: &Effect,
    train: &[Record],
    dictionary: &Dictionary,
) -> String {
    let name = effect.name();
    let mut table = EvidenceTable(String::new());
    let found: Vec<&FoundEffect> =
        answer.effects.iter().map(|(f, _)| f).filter(|f| f.effect.name() == name).collect();
    let tried: Vec<&TriedExplanation> =
        answer.ranking.iter().filter(|t| !t.accepted && t.label.split(' ').next() == Some(&name)).collect();
    let known = answer.model.effects().any(|e| e.name() == name) && found.is_empty();
    let _ = match (&found[..], known) {
        ([_, ..], _) => writeln!(table.0, "{name}: in the answer"),
        ([], true) => writeln!(table.0, "{name}: in the model already, not missing once more"),
        ([], false) => writeln!(table.0, "{name}: not in the answer"),
    };
    for f in &found {
        in_the_answer(&mut table, f, dictionary);
    }
    for x in answer.refined.iter().filter(|x| x.before.name() == name) {
        let all = x.after.1.iter().filter(|half| **half > 0.0).count();
        table.row("for", &format!("{all} values"), "of the model's are off beyond chance, and are corrected");
    }
    for t in &tried {
        let text = format!("{} in the place of {}, whose rows they share", t.label, t.place);
        table.row("against", &odds(t.odds), &text);
    }
    if found.is_empty() && tried.is_empty() && !known {
        not_tried(&mut table, &name, effect, train, dictionary);
    }
    for s in answer.suspicions.iter().filter(|_| !found.is_empty()) {
        table.row("against", "", &format!("a mistake may explain it as well: {s}"));
    }
    table.0
}

fn in_the_answer(table: &mut EvidenceTable, f: &FoundEffect, dictionary: &Dictionary) {
    let label =
        f.effect.delta.as_ref().map_or_else(|| f.effect.name(), |d| format!("{} ({d})", f.effect.name()));
    table.row("for", &odds(f.evidence), &format!("the rows with {label} against the rows without it"));
    table.row(
        "for",
        &format!("{:.1} %", 100.0 * f.name_mass),
        "of its place among all names that could stand there",
    );
    if f.mode_mass < 0.9995 {
        let text = "of its name: the rest are other periods, lobes or sensors of it";
        table.row("for", &format!("{:.1} %", 100.0 * f.mode_mass), text);
    }
    table.row("for", &format!("p {:.1e}", f.p_value), "at most: that chance alone explains as much");
    for r in &f.rivals {
        table.row("against", &odds(-r.margin), &format!("{} instead", r.label()));
    }
    for text in separating(f, dictionary) {
        table.row("to tell", "", &text);
    }
    table.row("to see", "", &f.effect.description().experiment);
}

/// The reason why a name was not tested in full.
fn not_tried(
    table: &mut EvidenceTable,
    name: &str,
    effect: &Effect,
    train: &[Record],
    dictionary: &Dictionary,
) {
    let shown = train.iter().any(|r| dictionary.candidates(&[r]).iter().any(|c| c.name() == name));
    if shown {
        let text = "at most, beside the best of what could be added: it was not looked at further";
        table.row("against", &odds(-HOPELESS), text);
    } else {
        let needs: Vec<String> =
            effect.description().needs.iter().map(|n| n.role(effect.axes()).to_string()).collect();
        let text = format!("no record shows it: it needs {}, and what it acts on", needs.join(", "));
        table.row("unknown", "", &text);
    }
    table.row("to see", "", &effect.description().experiment);
}
