//! What the self-test is asked for and what each of its parts brings, on a simulated card and on the one that will do the work.

use crate::far::FarSide;
use rtec_driver::card::CardError;
use rtec_driver::mapped::MapError;
use rtec_rt::engine::StartError;
use rtec_rt::event::Fault;
use rtec_rt::histogram::Snapshot;
use rtec_rt::setup::Wanted;
use rtec_rt::thread::SpawnError;
use serde::Serialize;
use std::io;
use std::time::Duration;

/// What to measure, and where.
#[derive(Debug, Clone, Copy)]
pub struct SelftestOptions {
    /// The CPU of the real-time thread.
    pub cpu: usize,
    /// The thread's `SCHED_FIFO` priority, 1 to 99.
    pub priority: u8,
    /// How long, all in all: a third each for the wake-ups, the polling loop, and the polling loop with requests.
    pub run: Duration,
    /// Seed of the far side's dwell times.
    pub seed: u64,
}

impl SelftestOptions {
    pub(crate) fn wanted(&self) -> Wanted {
        Wanted { cpu: self.cpu, priority: self.priority }
    }
}

/// Why nothing could be measured.
#[derive(Debug, thiserror::Error)]
pub enum SelftestError {
    /// A file or thread that the test needs.
    #[error("{0}: {1}")]
    Io(&'static str, #[source] io::Error),
    /// The card's registers cannot be mapped.
    #[error(transparent)]
    Map(#[from] MapError),
    /// The card failed while the test ran.
    #[error(transparent)]
    Card(#[from] CardError),
    /// The engine did not start.
    #[error(transparent)]
    Start(#[from] StartError),
    /// The engine's thread did not start.
    #[error(transparent)]
    Spawn(#[from] SpawnError),
    /// The wake-up thread ended by a panic: a bug.
    #[error("the wake-up thread panicked")]
    Panicked,
}

/// One of the three latencies.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct Latency {
    /// Distribution of the measured times, ns.
    #[serde(flatten)]
    pub ns: Snapshot,
    /// The last value, ns; of the poll gap, of which none is kept, the median.
    #[serde(skip)]
    pub last_ns: u64,
    /// The thread that measured it.
    #[serde(skip)]
    pub tid: i32,
}

/// What the polling loop did, while the far side gave edges and was the MTC.
#[derive(Debug, Clone, Default)]
pub struct Polling {
    /// Time between two looks of the loop.
    pub poll_gap: Latency,
    /// The engine's own part of edge to done.
    /// It lasts from the look that saw the edge to the look that ordered the second
    /// inversion.
    pub seen_to_done: Snapshot,
    /// From an edge to the second inversion, both separations included.
    pub edge_to_done: Latency,
    /// What the far side saw and counted.
    pub far: FarSide,
    /// Counts inserted according to the engine.
    pub completed: i64,
    /// Faults that a gap in the polling loop latched.
    pub faults: u64,
    /// Requests that streamed in.
    pub requests: u64,
    /// Insertions made.
    pub insertions: u64,
}

impl Polling {
    /// Counts to the MTC minus counts from the scale, as the far side counted them, are what the engine completed.
    pub(crate) fn balanced(&self) -> bool {
        self.far.mtc_minus_scale == self.completed && self.far.illegal == 0
    }
}

/// What was measured of the writes.
#[derive(Debug, Clone, Default)]
pub struct Driven {
    /// The loop meanwhile; `seen_to_done` from the look at which an insertion began to the one that ordered its second
    /// inversion.
    pub polling: Polling,
    /// Why it ended before its time, if it did.
    pub ended_by: Option<Fault>,
    /// The outputs are as they were found.
    pub restored: bool,
}

/// The thread of this process that has this name; 0 when there is none.
pub(crate) fn tid_of(name: &str) -> i32 {
    let tasks = std::fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    let mut named =
        tasks.filter(|t| std::fs::read_to_string(t.path().join("comm")).is_ok_and(|n| n.trim() == name));
    named.find_map(|t| t.file_name().to_str()?.parse().ok()).unwrap_or(0)
}

pub(crate) fn tid() -> i32 {
    // SAFETY: takes nothing and always succeeds.
    unsafe { libc::gettid() }
}
