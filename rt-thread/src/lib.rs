//! What happens between two edges of a scale: the engine, its link to the control side, and its pinned thread.
//!
//! | module | what |
//! |---|---|
//! | [`access`] | may the daemon open the card's devices, and where do their interrupts land? |
//! | [`engine`] | all axes of a machine: one look, one write |
//! | [`axis`] | one axis: insertion, ledger, belief window, homing, probe capture |
//! | [`gate`] | can the next edge come before an insertion is done? |
//! | [`event`] | requests, events and status: what goes over the link |
//! | [`histogram`] | latencies in fixed memory, written by one thread, read by any |
//! | [`journal`] | what survives a crash: inverters and completed totals in a mapped file |
//! | [`link`] | requests down, events up, status in a snapshot |
//! | [`replay`] | the engine over a recording, and what the MTC would have counted |
//! | [`selftest`] | this machine's latencies, measured with the real engine |
//! | [`through`] | Design B: the signals pass through the computer |
//! | [`setup`] | real-time set-up of the thread: applied, read back, reported |
//! | [`snapshot`] | the latest state, for a reader that never stops the writer |
//! | [`thread`] | the pinned thread and its loop |

pub mod access;
pub mod axis;
pub mod engine;
pub mod event;
pub mod gate;
pub mod histogram;
pub mod journal;
pub mod link;
pub mod replay;
pub mod selftest;
pub mod setup;
pub mod snapshot;
pub mod thread;
pub mod through;
