//! Options of the self-test, and results of its parts.
//! They are the same for a simulated card and for the card that will do the work.

use crate::far_side::MachineSideCounts;
use rtec_driver::card::CardError;
use rtec_driver::mapped_registers::MapError;
use rtec_rt::engine::StartError;
use rtec_rt::latency_histogram::HistogramSnapshot;
use rtec_rt::link_messages::Fault;
use rtec_rt::pinned_rt_thread::SpawnError;
use rtec_rt::realtime_setup::RtSettings;
use serde::Serialize;
use std::io;
use std::time::Duration;

/// Options of the self-test.
#[derive(Debug, Clone, Copy)]
pub struct SelftestOptions {
    /// The CPU of the real-time thread.
    pub cpu: usize,
    /// The thread's `SCHED_FIFO` priority, 1 to 99.
    pub priority: u8,
    /// Duration of the whole self-test.
    /// A third each is for wake-ups, the polling loop, and the polling loop with requests.
    pub run: Duration,
    /// Seed of the far side's dwell times.
    pub seed: u64,
}

impl SelftestOptions {
    pub(crate) fn wanted(&self) -> RtSettings {
        RtSettings { cpu: self.cpu, priority: self.priority }
    }
}

/// Why nothing could be measured.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)] // the messages say what they are
pub enum SelftestError {
    #[error("{0}: {1}")]
    Io(&'static str, #[source] io::Error),
    #[error(transparent)]
    Map(#[from] MapError),
    #[error(transparent)]
    Card(#[from] CardError),
    #[error(transparent)]
    Start(#[from] StartError),
    #[error(transparent)]
    Spawn(#[from] SpawnError),
    #[error("the wake-up thread panicked")]
    Panicked,
}

/// One of the three latencies.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct LatencyDistribution {
    /// Distribution of the measured times, ns.
    #[serde(flatten)]
    pub ns: HistogramSnapshot,
    /// The last value, ns. The poll gap keeps none, so it has the median.
    #[serde(skip)]
    pub last_ns: u64,
    /// Number of the thread that measured it.
    #[serde(skip)]
    pub tid: i32,
}

/// Results of the polling loop.
/// Meanwhile the far side makes edges and counts as the MTC.
#[derive(Debug, Clone, Default)]
pub struct PollingLoopResults {
    /// Time between two looks of the loop.
    pub poll_gap: LatencyDistribution,
    /// The engine's own part of edge to done.
    /// It lasts from the look that saw the edge to the look that ordered the second inversion.
    pub seen_to_done: HistogramSnapshot,
    /// From an edge to the second inversion, both separations included.
    pub edge_to_done: LatencyDistribution,
    /// Counts of the far side.
    pub far: MachineSideCounts,
    /// Counts inserted according to the engine.
    pub completed: i64,
    /// Number of faults latched after a gap in the polling loop.
    pub faults: u64,
    /// Number of requests sent.
    pub requests: u64,
    /// Insertions made.
    pub insertions: u64,
}

impl PollingLoopResults {
    /// Whether the MTC's counts minus the scale's equal the completed counts.
    /// The far side counted them, without an illegal state.
    pub(crate) fn balanced(&self) -> bool {
        self.far.mtc_minus_scale == self.completed && self.far.illegal == 0
    }
}

/// Results of the writes.
#[derive(Debug, Clone, Default)]
pub struct CardWriteTestResults {
    /// The loop during the writes.
    /// `seen_to_done` lasts from the look at which an insertion began to the look that ordered its second inversion.
    pub polling: PollingLoopResults,
    /// The fault that ended it early, if any.
    pub ended_by: Option<Fault>,
    /// Whether the outputs are as they were before.
    pub restored: bool,
}

/// Number of the thread of this process with this name; 0 when there is none.
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
