//! What happens between two edges of a scale: the insertion engine, its pinned thread and that thread's verified set-up.
//!
//! | module | what |
//! |---|---|
//! | [`histogram`] | latencies in fixed memory, written by one thread, read by any |
//! | [`setup`] | real-time set-up of the thread: applied, read back, reported |

pub mod histogram;
pub mod setup;
