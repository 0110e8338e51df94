//! Blind cases: random machines with something hidden, and the score of an answer. What makes the cases ([`world`],
//! [`case`]) and marks the answers ([`score`]) shares no code and no formula with what it judges.

// Long lists of experiments and formulas, each with its switches; text is put together plainly.
#![allow(
    clippy::needless_for_each,
    clippy::too_many_lines,
    clippy::format_push_string,
    clippy::match_same_arms,
    clippy::struct_excessive_bools
)]

pub mod baseline;
pub mod case;
pub mod score;
pub mod world;

use rtec_model::machine::Machine;

/// Reads a case's files, reconciles and reads the verdict as a stranger would: from the document. The share of the gap
/// that is closed beside it.
///
/// # Errors
/// A file of the case is refused.
pub fn judge(case: &case::Case) -> anyhow::Result<(score::Reply, Option<f64>)> {
    let read = |paths: &[std::path::PathBuf]| {
        paths.iter().map(|p| rtec_measure::record::read(p)).collect::<Result<Vec<_>, _>>()
    };
    let (train, holdout) = (read(&case.train)?, read(&case.holdout)?);
    let machine = Machine::read(&case.model)?;
    let answer = rtec_reconcile::reconcile(&train, &holdout, &machine, &rtec_reconcile::Options::default())?;
    let document = answer.to_json();
    let text = |v: &serde_json::Value| v.as_str().unwrap_or_default().to_owned();
    let list = |v: &serde_json::Value| v.as_array().cloned().unwrap_or_default();
    let effects = list(&document["effects"])
        .iter()
        .map(|e| (text(&e["name"]), list(&e["alternatives"]).iter().map(|a| text(&a["name"])).collect()))
        .collect();
    // What was written must be a model that can be read again.
    Machine::parse(&case.model, &answer.model.to_text())?;
    Ok((score::Reply { verdict: text(&document["verdict"]), effects }, document["gap"]["closed"].as_f64()))
}
