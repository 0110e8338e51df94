//! Runs the reconciler on a case, and reads its answer from the document.

use crate::bounds::beyond;
use crate::case::{Case, rms};
use crate::scene::Scene;
use crate::score::{REFUSED, Reply, unordered};
use crate::source::Source;
use rtec_model::machine::Machine;
use rtec_model::record::Record;
use serde_json::Value;
use std::f64::consts::{PI, TAU};
use std::path::PathBuf;

/// An answer with its cost.
pub struct Verdict {
    /// Verdict and names.
    pub reply: Reply,
    /// The whole document; null where the files were refused.
    pub document: Value,
    /// Share of the gap that is closed, from the document.
    pub closed: Option<f64>,
    /// RMS of measured minus simulated on the hold-outs, before and after.
    /// The simulation uses the written model.
    pub held: Option<[f64; 2]>,
    /// Processor time, s.
    pub cpu_s: f64,
}

fn read(paths: &[PathBuf]) -> anyhow::Result<Vec<Record>> {
    Ok(paths.iter().map(|p| rtec_measure::run_record_files::read(p)).collect::<Result<Vec<_>, _>>()?)
}

fn text(v: &Value) -> String {
    v.as_str().unwrap_or_default().to_owned()
}

fn list(v: &Value) -> &[Value] {
    v.as_array().map_or(&[], Vec::as_slice)
}

/// Processor time of this thread, s; 0 where the system does not report it.
fn cpu_s() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    text.split_whitespace().next().and_then(|ns| ns.parse::<f64>().ok()).unwrap_or(0.0) * 1e-9
}

/// Reads a case's files, reconciles and reads the verdict.
///
/// # Errors
/// When a file of the case is refused.
pub fn judge(case: &Case) -> anyhow::Result<Verdict> {
    let (train, holdout) = (read(&case.train)?, read(&case.holdout)?);
    let machine = Machine::read(&case.model)?;
    let start = cpu_s();
    let r = rtec_reconcile::reconcile(
        &train,
        &holdout,
        &machine,
        &rtec_reconcile::ReconciliationOptions::default(),
    )?;
    let (document, text_of_model) = (r.to_json(), r.model.to_text());
    let cpu_s = cpu_s() - start;
    let effects = list(&document["effects"])
        .iter()
        .map(|e| (text(&e["name"]), list(&e["alternatives"]).iter().map(|a| text(&a["name"])).collect()))
        .collect();
    // The written text must read as a model again.
    let written = Machine::parse(&case.model, &text_of_model)?;
    let held = (!holdout.is_empty()).then(|| [&machine, &written].map(|m| left(&holdout, m)));
    Ok(Verdict {
        reply: Reply { verdict: text(&document["verdict"]), effects },
        closed: document["gap"]["closed"].as_f64(),
        document,
        held: held.and_then(|[a, b]| Some([a?, b?])),
        cpu_s,
    })
}

/// The same, where a refusal of the files is an answer.
pub fn answer(case: &Case) -> (Verdict, Option<String>) {
    match judge(case) {
        Ok(v) => (v, None),
        Err(e) => {
            let reply = Reply { verdict: REFUSED.into(), effects: vec![] };
            let v = Verdict { reply, document: Value::Null, closed: None, held: None, cpu_s: 0.0 };
            (v, Some(format!("{e:#}")))
        }
    }
}

/// RMS of a model's residual on records, without the constant.
/// A hold-out may have another zero.
fn left(records: &[Record], model: &Machine) -> Option<f64> {
    let mut all = Vec::new();
    for r in records {
        let simulated = model.predict(r).ok()?;
        for (c, (_, p)) in r.responses().zip(&simulated.columns) {
            let rest: Vec<f64> = c.data.iter().zip(p).map(|(e, p)| e - p).collect();
            all.extend(centred(&rest));
        }
    }
    Some(rms(&all))
}

pub(crate) fn centred(v: &[f64]) -> Vec<f64> {
    let mean = v.iter().sum::<f64>() / v.len().max(1) as f64;
    v.iter().map(|x| x - mean).collect()
}

/// RMS of the noise alone over the hold-outs.
pub fn floor(scene: &Scene) -> f64 {
    let all: Vec<f64> =
        scene.noise_alone[scene.runs.len()..].iter().flatten().flat_map(|v| centred(v)).collect();
    rms(&all)
}

/// Share of a gap that is closed; `None` where there is no gap.
/// There is no gap if `before` is at most a twentieth above the noise alone.
pub fn closed(before: f64, after: f64, floor: f64) -> Option<f64> {
    (before > 1.05 * floor).then(|| (before - after) / (before - floor))
}

/// A parameter of an effect that was found, against the truth.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Covered {
    /// Text of the effect, the parameter, the truth and the interval.
    pub what: String,
    /// Whether the truth is within the interval.
    pub holds: bool,
    /// Whether a wrong period is an alias that lists the true period.
    /// The alternatives then have the true period, which looks the same at these places.
    pub alias_said: bool,
}

/// Whether a wave has an alias of the true period, and lists the true one.
/// In frequency, the listed period is at most the interval's width from the true one.
fn alias_said(e: &Value, t: &Source) -> bool {
    ["period_mm", "period_um"].into_iter().filter(|key| t.has(key)).any(|key| {
        let p = &e["parameters"][key];
        let (Some(value), Some(high)) = (p["value"].as_f64(), p["high"].as_f64()) else { return false };
        let width = (high - value) / (value * value);
        let off = |period: f64| (1.0 / period - 1.0 / t.val(key)).abs();
        let same = |a: &Value| {
            a["name"] == e["name"] && a[key].as_f64().is_some_and(|p| off(p) <= width.max(SAME_PERIOD / p))
        };
        off(value) > width && list(&e["alternatives"]).iter().any(same)
    })
}

/// Relative difference up to which two periods count as the same.
/// It allows for places that are not exactly on a grid.
const SAME_PERIOD: f64 = 2e-3;

/// Parameters of found effects, and whether the truth is within their interval.
/// A value without an interval is not checked: a time, a whole number, a term that was left out. Growth by another
/// sensor or reference is another number. So are then the constant and the straight line that go with it.
pub fn covered(document: &Value, hidden: &[Source]) -> Vec<Covered> {
    let mut out = Vec::new();
    let effects = list(&document["effects"]);
    let truth = |e: &Value| {
        let name = unordered(&text(&e["name"]));
        hidden.iter().find(|h| unordered(&h.name) == name)
    };
    let same = |e: &Value, t: &Source| {
        let reference = |v: Option<f64>| v.unwrap_or(20.0);
        let theirs = reference(e["reference_degC"].as_f64());
        let ours = reference(t.has("reference_degC").then(|| t.val("reference_degC")));
        let word = |key: &str| text(&e[key]) == t.word(key).unwrap_or_default();
        word("sensor") && word("minus") && (theirs - ours).abs() < 1e-6
    };
    let axis = |name: &str| name.split('.').nth(1).unwrap_or_default().to_owned();
    let moved: Vec<String> = effects
        .iter()
        .filter(|e| e["sensor"].is_string() && !truth(e).is_some_and(|t| same(e, t)))
        .map(|e| axis(&text(&e["name"])))
        .collect();
    for e in effects {
        let name = text(&e["name"]);
        let Some(t) = truth(e).filter(|t| same(e, t)) else { continue };
        if (name.starts_with("offset.") || name.starts_with("scale.")) && moved.contains(&axis(&name)) {
            continue;
        }
        let alias = alias_said(e, t);
        for (key, p) in e["parameters"].as_object().into_iter().flatten() {
            let (Some(low), Some(high), true) = (p["low"].as_f64(), p["high"].as_f64(), t.has(key)) else {
                continue;
            };
            if low >= high {
                continue;
            }
            let mut v = t.val(key);
            if key == "phase_rad" || key == "centre_rad" {
                let middle = f64::midpoint(low, high);
                v = middle + (v - middle + PI).rem_euclid(TAU) - PI;
            }
            let holds = (low..=high).contains(&v);
            let what = format!("{name} {key} {v:.4} in {low:.4} to {high:.4}");
            out.push(Covered { what, holds, alias_said: !holds && alias });
        }
    }
    out
}

/// Values of an answer that no machine can have, as text.
pub fn impossible(document: &Value) -> Vec<String> {
    let mut out = Vec::new();
    for e in list(&document["effects"]).iter().chain(list(&document["refined"])) {
        let value = |key: &str| e["parameters"][key]["value"].as_f64().or_else(|| e[key].as_f64());
        out.extend(beyond(&text(&e["name"]), &value));
    }
    out
}

/// How an answer treated a mistake.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Heard {
    /// Reported: a suspicion has its word or column, or the files were refused.
    Said,
    /// Not reported, and an effect is named that does not exist.
    Wrong,
    /// Not reported.
    Silent,
}

/// The suspicions of a document: kind, column and text.
pub fn suspicions(document: &Value) -> Vec<String> {
    let line = |s: &Value| format!("{} {}: {}", text(&s["what"]), text(&s["column"]), text(&s["text"]));
    list(&document["suspicions"]).iter().map(line).collect()
}

/// How the answer to a case with a mistake treated it.
pub fn heard(v: &Verdict, mistake: &crate::mistakes::Mistake, case: &Case) -> Heard {
    let said = list(&v.document["suspicions"]).iter().any(|s| {
        text(&s["what"]) == mistake.what || mistake.columns.iter().any(|c| text(&s["column"]).contains(c))
    });
    if said || v.reply.verdict == REFUSED {
        Heard::Said
    } else if v.reply.effects.iter().any(|(n, _)| !case.truth.contains(n)) {
        Heard::Wrong
    } else {
        Heard::Silent
    }
}
