//! Mistakes that records show, said on the way: one warning a line, and a list for the JSON document.

use rtec_measure::plausible::{self, Suspicion, Unusable, What, unusable};
use rtec_model::record::Record;
use serde_json::{Value, json};

/// Warns of what these records show of mistakes; gives it for the document.
pub(crate) fn warn(records: &[Record]) -> Vec<Suspicion> {
    let found = plausible::suspicions(records);
    for s in &found {
        eprintln!("warning: {s}");
    }
    found
}

/// Puts the list into a JSON document, where that is an object.
pub(crate) fn enter(document: &mut Value, found: &[Suspicion]) {
    if let Value::Object(map) = document {
        map.insert("suspicions".to_owned(), json!(found));
    }
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
        eprintln!("warning: {}: {} is kept as it stands", s.record, s.column);
    }
    (left, out)
}
