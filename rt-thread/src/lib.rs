//! The engine between two edges of a scale, its link and its pinned thread.
//!
//! | module | what |
//! |---|---|
//! | [`engine`] | all axes of a machine: one look, one write |
//! | [`axis`] | one axis: insertion, ledger, belief window, homing, probe capture |
//! | [`gate`] | can the next edge come before an insertion is done? |
//! | [`event`] | requests, events and status: what goes over the link |
//! | [`link`] | requests down, events up, status in a snapshot |
//! | [`snapshot`] | the latest state, for a reader that never stops the writer |
//! | [`journal`] | what survives a crash: inverters and completed totals in a mapped file |
//! | [`state_file`] | the control side's watch over that file: removed, replaced or cut short, it is written again |
//! | [`histogram`] | latencies in fixed memory, written by one thread, read by any |
//! | [`thread`] | the pinned thread and its loop |
//! | [`setup`] | real-time set-up of the thread: applied, read back, reported |
//!
//! This crate does not know why an axis should have a total: models, temperatures and parts are above it. It knows no
//! file format. It cannot tell a machine from a recording or a simulation.
//!
//! An example, which the tests run too: `cargo run -p rtec-rt --example mock_card`.

pub mod axis;
pub mod engine;
pub mod event;
pub mod gate;
pub mod histogram;
pub mod journal;
pub mod link;
pub mod setup;
pub mod snapshot;
pub mod state_file;
pub mod thread;
