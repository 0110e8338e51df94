//! The engine between two edges of a scale, its link and its pinned thread.
//!
//! This crate does not know why an axis should have a total: models, temperatures and parts are above it. It knows no
//! file format. It cannot tell a machine from a recording or a simulation.
//!
//! An example, which the tests run too: `cargo run -p rtec-rt --example mock_card`.

pub mod axis; // one axis: insertion, ledger, belief window, homing, probe capture
pub mod engine; // all axes of a machine: one look, one write
pub mod journal; // what survives a crash: inverters and completed totals in a mapped file
pub mod latency_histogram; // latencies in fixed memory, written by one thread, read by any
pub mod link; // requests down, events up, status in a snapshot
pub mod link_messages; // requests, events and status: what goes over the link
pub mod pinned_rt_thread;
pub mod realtime_setup; // real-time set-up of the thread: applied, read back, reported
pub mod speed_gate; // can the next edge come before an insertion is done?
pub mod state_file_watch; // watch over the journal's file: removed, replaced or cut short, it is written again
pub mod triple_buffer; // the latest state, for a reader that never stops the writer // the pinned thread and its loop
