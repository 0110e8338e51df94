//! Run records of a machine tool, for the daemon and for evaluations.
//!
//! Statistics and charts of a record are in `rtec-measure`.

pub mod run_record_files; // run records, read strictly and written whole
pub mod spool; // sends finished records to the shop's store
