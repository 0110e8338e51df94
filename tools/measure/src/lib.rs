//! What a run showed.
//! Run records on file, other tools' files, the plan of a characterisation, evaluations, charts.
//!
//! | module | what |
//! |---|---|
//! | [`export`] | one axis' errors as a table for a controller that compensates by itself |
//! | [`import`] | other tools' files as run records |
//! | [`derive`](mod@derive) | velocity and acceleration from positions |
//! | [`evaluation`] | runs evaluated by the standard that fits them: document and report
//! | [`history`] | one machine's figures of merit over time
//! | [`plan`] | the test sequence a machine is characterised with |
//! | [`iso230`], [`ballbar`], [`plate`] | evaluations as the standards define them |
//! | [`plausible`] | mistakes that the records themselves show: units, signs, sensors that are off, doubled rows
//! | [`plot`] | charts as SVG |
//! | [`prediction`] | a model's answer about a record
//! | [`report`] | an evaluation for a person, as text and as one page |
//!
//! [`record`] and [`spool`] are those of `rtec-records`, which the daemon uses without the evaluations.
//!
//! What must not live here: a choice among models (`rtec-fit`, `rtec-reconcile`).
//!
//! At work: `cargo run -p rtec-measure --example evaluate_axis`, which the tests run too.

pub mod ballbar;
pub mod derive;
pub mod evaluation;
pub mod export;
pub mod history;
pub mod import;
pub mod iso230;
pub mod plan;
pub mod plate;
pub mod plausible;
pub mod plot;
pub mod prediction;
pub mod report;
pub mod steps;

pub use rtec_records::{record, spool};
