//! Run records, imports and exports, plans, evaluations and charts.
//!
//! | module | contents |
//! | [`compensation_export`] | one axis's errors as a table for a controller that compensates itself |
//! | [`import`] | other tools' files as run records |
//! | [`motion_from_positions`] | velocity and acceleration from positions |
//! | [`evaluation`] | evaluates runs by the standard that fits them: document and report
//! | [`figure_history`] | one machine's figures of merit over time
//! | [`plan`] | the test sequence to characterise a machine |
//! | [`iso230`], [`ballbar`], [`drilled_plate`] | evaluations as the standards define them |
//! | [`plausible`] | likely mistakes that records show: units, signs, bad sensors, duplicated rows
//! | [`plot`] | charts as SVG |
//! | [`prediction`] | predictions of a model for a record
//! | [`report`] | an evaluation as text and as one page |
//!
//! [`run_record_files`] and [`spool`] come from `rtec-records`, which the daemon uses without the evaluations.
//!
//! Model selection belongs to `rtec-fit` and `rtec-reconcile`, not here.
//!
//! Example: `cargo run -p rtec-measure --example evaluate_axis`, which the tests run too.

pub mod ballbar;
pub mod compensation_export;
pub mod drilled_plate;
pub mod evaluation;
pub mod figure_history;
pub mod gauge_resolution;
pub mod import;
pub mod iso230;
pub mod motion_from_positions;
pub mod plan;
pub mod plausible;
pub mod plot;
pub mod prediction;
pub mod report;

pub use rtec_records::{run_record_files, spool};

/// Where messages for people go.
pub type Sink<'s> = &'s mut dyn FnMut(rtec_files::InputNotice);

/// All in order, those that come again left out.
pub(crate) fn each_once<T: PartialEq>(all: impl IntoIterator<Item = T>) -> Vec<T> {
    let mut kept = Vec::new();
    for one in all {
        if !kept.contains(&one) {
            kept.push(one);
        }
    }
    kept
}
