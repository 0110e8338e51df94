//! Mistakes that records show, said on the way: one warning a line, and a list for the JSON document.

use rtec_files::InputError;
use rtec_measure::plausible::{self, Suspicion, Unusable, What, unusable};
use rtec_model::record::Record;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Warns of what these records show of mistakes; gives it for the document.
pub(crate) fn warn(records: &[Record]) -> Vec<Suspicion> {
    let found = plausible::suspicions(records);
    for s in &found {
        eprintln!("warning: {s}");
    }
    for step in plausible::steps_of(records) {
        eprintln!("warning: {step}");
    }
    found
}

/// Puts the list into a JSON document, where that is an object.
pub(crate) fn enter(document: &mut Value, found: &[Suspicion]) {
    if let Value::Object(map) = document {
        map.insert("suspicions".to_owned(), json!(found));
    }
}

/// Refuses to write a model from records in which a unit, a sign, a direction or a column looks wrong: the fit would carry it on.
pub(crate) fn refuse(found: &[Suspicion], records: &[PathBuf], despite: bool) -> Result<(), InputError> {
    let learned = |s: &&Suspicion| records.iter().any(|r| r.display().to_string() == s.record);
    let wrong = |s: &&Suspicion| {
        let dead = s.what == What::Stuck && s.rows.is_empty();
        (dead || matches!(s.what, What::Unit | What::Sign | What::Direction | What::Swapped))
            && !s.is_of_sensor()
    };
    let Some(first) = found.iter().filter(learned).find(wrong).filter(|_| !despite) else { return Ok(()) };
    let expected = "a record in which that is put right, or --despite-suspicions; nothing is written";
    let found = format!("{}: {}: {}", first.column, first.what, first.text);
    Err(InputError::whole(Path::new(&first.record), found, expected))
}

/// The records that no earlier one of these repeats: those to learn from, and those to judge by.
pub(crate) fn once(train: Vec<Record>, holdout: Vec<Record>) -> (Vec<Record>, Vec<Record>) {
    let all: Vec<&Record> = train.iter().chain(&holdout).collect();
    let again: Vec<usize> = plausible::repeated(&all).into_iter().map(|(_, k)| k).collect();
    let n = train.len();
    let new = |from: usize, records: Vec<Record>| {
        let own = records.into_iter().enumerate().filter(|(k, _)| !again.contains(&(from + k)));
        own.map(|(_, r)| r).collect()
    };
    (new(0, train), new(n, holdout))
}

/// The records that a fit may learn from, and what it leaves out of them, said too.
pub(crate) fn usable(records: &[Record], found: &[Suspicion]) -> (Vec<Record>, Unusable) {
    let out = unusable(found);
    let left: Vec<Record> = records.iter().map(|r| out.without(r)).collect();
    for (before, after) in records.iter().zip(&left) {
        let gone = |c: &&rtec_model::record::Column| after.columns.iter().all(|k| k.name != c.name);
        let sensors: Vec<&str> = before.columns.iter().filter(gone).map(|c| c.name.as_str()).collect();
        let rows = before.rows() - after.rows();
        if !sensors.is_empty() || rows > 0 {
            let sensors = if sensors.is_empty() { "no sensor".to_owned() } else { sensors.join(", ") };
            eprintln!("warning: {}: left out of the fit: {sensors}, {rows} rows", before.path.display());
        }
    }
    let kept = found.iter().filter(|s| matches!(s.what, What::Unit | What::Sign | What::Direction));
    for s in kept.filter(|s| !out.sensor(&s.column)) {
        eprintln!("warning: {}: {} is kept as it is", s.record, s.column);
    }
    (left, out)
}
