//! Run records of a machine tool, as the daemon and the evaluations need them alike.
//!
//! | module | what |
//! |---|---|
//! | [`record`] | run records, read strictly and written whole |
//! | [`spool`] | finished records on their way to the shop's store |
//!
//! What a record shows is in `rtec-measure`, and so are charts.

pub mod record;
pub mod spool;
