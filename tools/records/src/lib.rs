//! Run records of a machine tool, for the daemon and for evaluations.
//!
//! | module | contents |
//! |---|---|
//! | [`record`] | run records, read strictly and written whole |
//! | [`spool`] | sends finished records to the shop's store |
//!
//! Statistics and charts of a record are in `rtec-measure`.

pub mod record;
pub mod spool;
