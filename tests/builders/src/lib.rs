//! Builders of tests: columns, axes and records from literals.
//!
//! A test states only what it is about. A wrong literal panics, as a mistake of the test.

use rtec_model::record::{Axis, Column, Kind, Record, Role};
use std::path::Path;

/// Axis of this name.
///
/// # Panics
/// The name is no axis name.
#[must_use]
pub fn axis(name: &str) -> Axis {
    Axis::new(name).expect("an axis name")
}

/// Column of a role, as `error.x`, in the role's own unit.
///
/// # Panics
/// There is no such role.
#[must_use]
pub fn column(name: &str, role: &str, data: Vec<f64>) -> Column {
    Column::new(name, Role::parse(role).expect("a role"), data)
}

/// Record `NAME.run.toml` of these columns.
///
/// # Panics
/// The columns make no record, because of different lengths for example.
#[must_use]
pub fn record(name: &str, kind: Kind, columns: Vec<Column>) -> Record {
    Record::new(Path::new(&format!("{name}.run.toml")), kind, columns).expect("columns of one record")
}
