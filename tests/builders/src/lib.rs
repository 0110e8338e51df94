//! Builders for tests: columns, axes and records from literals.
//!
//! A test states only what it needs. A wrong literal panics, because it is a mistake of the test.

#![allow(
    clippy::missing_panics_doc,
    reason = "they panic where they cannot do their work, and the test fails"
)]

use rtec_model::record::{Axis, Column, Record, Role, RunKind};
use std::path::Path;

/// An axis of this name.
pub fn axis(name: &str) -> Axis {
    Axis::new(name).expect("an axis name")
}

/// A column of a role such as `error.x`, in the role's own unit.
pub fn column(name: &str, role: &str, data: Vec<f64>) -> Column {
    Column::new(name, Role::parse(role).expect("a role"), data)
}

/// A record `NAME.run.toml` of these columns.
pub fn record(name: &str, kind: RunKind, columns: Vec<Column>) -> Record {
    Record::new(Path::new(&format!("{name}.run.toml")), kind, columns).expect("columns of one record")
}
