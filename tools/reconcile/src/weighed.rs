//! Mistakes that a record shows beside the model, weighed: with the mistake undone the records have to be explained better than as
//! they stand with whatever effect of the dictionary the model may lack. One that only happens to look like a mistake (a squareness
//! as large as the scale of the other axis) is explained down to the noise as it stands, and then it is no mistake.

use crate::answer::{Answer, Finding};
use crate::drawn::bounded;
use crate::suspected::about;
use rtec_measure::plausible::Suspicion;
use rtec_model::machine::Machine;
use rtec_model::record::Record;
use std::borrow::Cow;

/// A mistake is the likelier where it explains the records better by so much, nats: people make one in a few dozen records, and what is
/// missing has paid for its own choice.
const LIKELIER: f64 = 4.0;
/// What no effect of the dictionary explains is rarer than any mistake, each shape of it.
const NO_NAME: f64 = 12.0;
/// An effect of the model that has to be farther off than it was trusted to be is as unlikely as that, each.
const OFF: f64 = 6.0;
/// So many mistakes of a record are weighed.
const WEIGHED: usize = 3;

/// A mistake that a record may carry.
pub(crate) struct Mistake {
    pub(crate) said: Suspicion,
    /// The record without it.
    pub(crate) undone: Record,
    /// How many times larger its response is then: of numbers that lie closer together each is the likelier by as much.
    pub(crate) larger: f64,
}

impl Mistake {
    pub(crate) fn new(said: Suspicion, undone: Record) -> Self {
        Self { said, undone, larger: 1.0 }
    }
}

/// Of each record's mistakes the first that is likelier than an effect that is missing. `mistakes`: those of each record; `looked_at`: what
/// an analysis of records comes to.
pub(crate) fn weighed(
    records: &[Record],
    mistakes: Vec<Vec<Mistake>>,
    machine: &Machine,
    looked_at: &dyn Fn(&[Record]) -> Option<Answer>,
) -> Vec<Suspicion> {
    let evidence = |records: &[Record]| {
        let answer = looked_at(records)?;
        let own = |f: &&Finding| machine.effects().any(|e| e.identity() == f.effect.identity());
        let off = answer.findings.iter().filter(own).count() as f64;
        Some(answer.evidence - OFF * off - NO_NAME * answer.unexplained.len() as f64)
    };
    // What has no mistake of its own is what the others are held beside.
    let sound: Vec<&Record> =
        records.iter().zip(&mistakes).filter(|(_, m)| m.is_empty()).map(|(r, _)| r).collect();
    let mut out = Vec::new();
    for (record, mistakes) in records.iter().zip(mistakes).filter(|(_, m)| !m.is_empty()) {
        let beside =
            |r: &Record| -> Vec<Record> { sound.iter().copied().cloned().chain([r.clone()]).collect() };
        let as_it_stands = beside(record);
        let as_it_stands = bounded(&as_it_stands);
        let Some(missing) = evidence(&as_it_stands) else { continue };
        let rows = as_it_stands.last().map_or(0, Record::rows) as f64;
        let likelier = |m: &Mistake| {
            let then = beside(&m.undone);
            let then: Cow<'_, [Record]> = bounded(&then);
            let found = evidence(&then).map(|found| found + rows * m.larger.ln());
            found.is_some_and(|found| found > missing + LIKELIER)
        };
        let said = mistakes.into_iter().take(WEIGHED).find(likelier).map(|m| m.said);
        debug_assert!(said.iter().all(|s| about(s, record)));
        out.extend(said);
    }
    out
}
