//! Verdicts through the public interface, one file per question.
//! They form one program, so that long tests run in parallel with the others.

mod alike;
mod ballbar;
mod doubted;
mod exchanged;
mod nameless;
mod names;
mod next_run;
mod noise;
mod one_room;
mod page;
mod somewhere;
mod stands;
mod unlike_records;
mod weighed;
mod zeros;

use rtec_model::machine::Machine;
use rtec_model::record::{Column, Record, Role, RunKind};
use rtec_reconcile::{ReconciliationOptions, ReconciliationResult, reconcile};
use std::path::Path;

/// A record of columns: name, role, values.
#[expect(clippy::unwrap_used, reason = "a test's own helper")]
fn record(name: &str, kind: RunKind, columns: Vec<(&str, &str, Vec<f64>)>) -> Record {
    let of = |(n, r, v)| Column::new(n, Role::parse(r).unwrap(), v);
    let columns = columns.into_iter().map(of).collect();
    Record::new(Path::new(&format!("{name}.run.toml")), kind, columns).unwrap()
}

/// The answer for records beside a model, with later records as hold-outs.
#[expect(clippy::unwrap_used, reason = "a test's own helper")]
fn answer(model: &str, train: &[Record], later: &[Record]) -> ReconciliationResult {
    let model = Machine::parse(Path::new("m.toml"), &format!("name = \"m\"\n{model}")).unwrap();
    reconcile(train, later, &model, &ReconciliationOptions::default()).unwrap()
}

/// The names that were given, likeliest first.
fn names(r: &ReconciliationResult) -> Vec<String> {
    r.effects.iter().map(|(f, _)| f.effect.name()).collect()
}
