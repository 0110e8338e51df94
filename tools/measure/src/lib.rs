//! What a run showed: run records on file, other tools' files, the plan of a characterisation, evaluations, charts.
//!
//! | module | what |
//! |---|---|
//! | [`record`] | run records, read strictly and written whole |
//! | [`import`] | other tools' files as run records |
//! | [`plan`] | the test sequence a machine is characterised with |
//! | [`iso230`], [`ballbar`], [`plate`] | evaluations as the standards define them |
//! | [`plot`] | charts as SVG |
//! | [`report`] | an evaluation for a person, as text and as one page |
//!
//! What must not live here: a choice among models (`rtec-fit`, `rtec-reconcile`).

pub mod ballbar;
pub mod import;
pub mod iso230;
pub mod plan;
pub mod plate;
pub mod plot;
pub mod record;
pub mod report;
