//! Measures the latencies that the speed gate needs, with the real engine.
//! They say how late this machine can be.
//!
//! No latency is understated. Where a clock is read before or after an event, the reading that gives the longer time is
//! used.
//!
//! | figure | how |
//! |---|---|
//! | wake-up | `clock_nanosleep` to an absolute time, as cyclictest does |
//! | poll gap | between two looks of the engine's own polling loop, as oslat does with an empty one |
//! | edge to done, of a simulated card | another CPU plays the scale and the MTC: from the moment before it changes A or B to the moment it has seen the second inversion |
//!
//! On a simulated card, poll gap and edge to done are measured twice: undisturbed, and with requests as fast as the
//! link takes them. The gate gets the worse of the two.
//! On the real card nothing moves the machine. Its reads are timed with the outputs held. Its writes are insertions at
//! rest, if the caller allows them ([`run_on_card`]).

pub use crate::far_side::MachineSideCounts;
use crate::far_side::{FarSideWires, SelftestControlSide, play};
use crate::real_card_timing;
use crate::selftest_results::tid;
pub use crate::selftest_results::{
    CardWriteTestResults, LatencyDistribution, PollingLoopResults, SelftestError, SelftestOptions,
};
use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::SeedableRng;
use rtec_driver::card::Card;
use rtec_driver::card_profile::CardProfile;
use rtec_driver::clock::{Clock, Monotonic};
use rtec_driver::mapped_registers::{MappedCard, MappedRegisterFile};
use rtec_driver::mock_card::{MockCard, SharedWires};
use rtec_rt::axis::{AxisConfig, INCREMENT_COUNTS};
use rtec_rt::latency_histogram::{HistogramSnapshot, Recorder, histogram};
use rtec_rt::link_messages::Fault;
use rtec_rt::realtime_setup::{self, SetupReport, SystemRoot, apply};
use serde::Serialize;
use std::time::{Duration, Instant};

/// Interval of the wake-ups, ns.
pub const WAKEUP_INTERVAL_NS: u64 = 500_000;
/// Interval at which the main thread checks whether the wake-ups are over.
const WATCH_INTERVAL: Duration = Duration::from_millis(2);
const SECOND: Duration = Duration::from_secs(1);

/// The simulated card of the test.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum SimulatedCardKind {
    /// Wires in the same process.
    Mock,
    /// Registers in a file that is mapped twice, once for each side of a card.
    Mapped,
}

/// The measured latencies, and their conditions.
#[derive(Debug, Clone)]
pub struct LatencyTestResult {
    /// The set-up under which it was measured.
    pub setup: SetupReport,
    /// Lateness of a sleeping thread's wake-ups.
    pub wakeup: LatencyDistribution,
    /// Configuration of the axis in the test.
    pub axis: AxisConfig,
    /// The polling loop without requests.
    ///
    /// Empty with one CPU only, because nothing could end the polling there.
    pub quiet: PollingLoopResults,
    /// The polling loop with requests as fast as the link takes them.
    /// On the card that will do the work it is the loop with insertions. Empty with one CPU only.
    pub with_requests: PollingLoopResults,
    /// How the card was measured.
    pub how: CardTestExtent,
}

/// How a card was measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum CardTestExtent {
    /// A simulated card; another CPU plays the machine.
    Simulated,
    /// The card that will do the work, with its outputs held.
    Reads,
    /// The card that will do the work, reads and writes.
    ReadsAndWrites {
        /// The fault that ended the writes, if any.
        ended_by: Option<Fault>,
        /// Whether the outputs are as they were before.
        restored: bool,
    },
}

impl LatencyTestResult {
    fn both(&self) -> [&PollingLoopResults; 2] {
        [&self.quiet, &self.with_requests]
    }

    /// Whether at least one insertion was timed in each part.
    pub fn timed(&self) -> bool {
        match self.how {
            CardTestExtent::Simulated => self.both().iter().all(|p| p.edge_to_done.ns.samples() > 0),
            CardTestExtent::Reads => false,
            CardTestExtent::ReadsAndWrites { .. } => {
                self.looked() && self.with_requests.seen_to_done.samples() > 0
            }
        }
    }

    /// Whether gaps between looks were measured.
    /// On a card that sleeps these are the times from edges to looks.
    pub fn looked(&self) -> bool {
        self.quiet.poll_gap.ns.samples() > 0
    }

    /// Sums of the far side's counts; `None` with one CPU only.
    pub fn far(&self) -> Option<MachineSideCounts> {
        let [a, b] = self.both().map(|p| &p.far);
        (a.edges > 0).then(|| MachineSideCounts {
            edges: a.edges + b.edges,
            without_insertion: a.without_insertion + b.without_insertion,
            unresolved: a.unresolved + b.unresolved,
            mtc_minus_scale: a.mtc_minus_scale + b.mtc_minus_scale,
            illegal: a.illegal + b.illegal,
        })
    }

    /// Counts inserted in both parts, by the engine's count.
    pub fn completed(&self) -> i64 {
        self.both().iter().map(|p| p.completed).sum()
    }

    /// Faults of both parts that were latched after a gap in the polling loop.
    pub fn faults(&self) -> u64 {
        self.both().iter().map(|p| p.faults).sum()
    }

    /// Whether the MTC's counts minus the scale's equal the completed counts.
    /// The far side counted them.
    pub fn balanced(&self) -> bool {
        match self.how {
            CardTestExtent::Simulated => self.both().iter().all(|p| p.balanced()),
            CardTestExtent::Reads => true,
            CardTestExtent::ReadsAndWrites { restored, .. } => restored && self.completed() == 0,
        }
    }

    /// Time from an edge until the engine acts on it, ns, without its separations.
    ///
    /// The worse value of the parts with and without requests counts. Returns two figures: the worst one, and the worst
    /// apart from one look in ten thousand.
    pub fn detect_ns(&self) -> (u64, u64) {
        let separations = self.separations_ns();
        let of = |figure: fn(&HistogramSnapshot) -> u64| {
            let late = |p: &PollingLoopResults| {
                figure(&p.poll_gap.ns).max(figure(&p.edge_to_done.ns).saturating_sub(separations))
            };
            let late = late(&self.quiet).max(late(&self.with_requests));
            // Without a far side, an edge right after its line was read is seen at the end of the next look.
            if self.how == CardTestExtent::Simulated { late } else { late + self.quiet.poll_gap.ns.p99() }
        };
        (of(HistogramSnapshot::max), of(HistogramSnapshot::p9999))
    }

    /// Time from one write until the next look, ns.
    ///
    /// It is half the time of an insertion without its separations, with or without requests. One insertion in ten
    /// thousand is left out; rarer delays are in [`Self::detect_ns`].
    pub fn write_ns(&self) -> u64 {
        let inserting_ns = self.both().map(|p| p.seen_to_done.p9999());
        if self.how != CardTestExtent::Simulated {
            // An insertion at rest is the first write, its confirmation, one separation, and the look that orders the
            // second write.
            return inserting_ns[1].saturating_sub(self.axis.min_separation_ns);
        }
        inserting_ns[0].max(inserting_ns[1]).saturating_sub(self.separations_ns()).div_ceil(2)
    }

    /// The intended part of edge to done.
    /// It is the MTC's separation after the edge, and the one between the two inversions. An insertion at rest has only
    /// the second.
    pub fn separations_ns(&self) -> u64 {
        if self.how == CardTestExtent::Simulated {
            2 * self.axis.min_separation_ns
        } else {
            self.axis.min_separation_ns
        }
    }
}

/// Measures a simulated card.
///
/// `progress` is called about once a second with the present part of the test and the seconds that are left.
///
/// # Errors
/// When the test card or a thread cannot be made, or the card fails.
pub fn run(
    options: SelftestOptions,
    backend: SimulatedCardKind,
    progress: impl FnMut(&str, u64),
) -> Result<LatencyTestResult, SelftestError> {
    match backend {
        SimulatedCardKind::Mock => measure(options, progress, || {
            let wires = SharedWires::default();
            Ok((MockCard::new(wires.clone(), Monotonic), wires))
        }),
        SimulatedCardKind::Mapped => measure(options, progress, || {
            let io = |e| SelftestError::Io("making the card's file", e);
            let shared_memory = std::path::Path::new("/dev/shm");
            let dir = if shared_memory.is_dir() { shared_memory.to_owned() } else { std::env::temp_dir() };
            // The file needs its name until both ends have mapped it.
            let file = tempfile::Builder::new().prefix("rtec-selftest-").tempfile_in(dir).map_err(io)?;
            let profile = CardProfile::shared_memory();
            file.as_file().set_len(profile.size() as u64).map_err(io)?;
            let far = MappedRegisterFile::open(file.path(), profile.size(), &profile.name)?;
            Ok((MappedCard::open(file.path(), &profile, Monotonic)?, far))
        }),
    }
}

/// Measures the card that will do the work, with the lines of these axes.
/// It times reads with the outputs held, and with `drive` also writes. The caller must make sure that no MTC listens,
/// because the MTC counts each insertion.
///
/// # Errors
/// When a thread cannot be made, an axis is in the middle of an insertion, or the card fails.
pub fn run_on_card<C: Card + Send + 'static>(
    options: SelftestOptions,
    card: C,
    axes: &[AxisConfig],
    drive: bool,
    mut progress: impl FnMut(&str, u64),
) -> Result<LatencyTestResult, SelftestError> {
    let left = realtime_setup::move_off_cpu(options.cpu);
    let (wakeup, setup) = measure_wake_ups(options, &mut progress)?;
    let axis = axes.iter().max_by_key(|a| a.min_separation_ns).copied().unwrap_or_default();
    let (quiet, with_requests) = (PollingLoopResults::default(), PollingLoopResults::default());
    let mut measured =
        LatencyTestResult { setup, wakeup, axis, quiet, with_requests, how: CardTestExtent::Reads };
    if left.is_some() {
        let (quiet, card) = real_card_timing::reads(card, axes, options, &mut progress)?;
        measured.quiet = quiet;
        if drive {
            // All axes get the longest separation, so that it can be subtracted from every insertion alike.
            let axes: Vec<_> =
                axes.iter().map(|a| AxisConfig { min_separation_ns: axis.min_separation_ns, ..*a }).collect();
            let CardWriteTestResults { polling, ended_by, restored } =
                real_card_timing::writes(card, &axes, options, &mut progress)?;
            measured.with_requests = polling;
            measured.how = CardTestExtent::ReadsAndWrites { ended_by, restored };
        }
    }
    Ok(measured)
}

/// Measures wake-ups, then the polling loop without and with requests.
/// Each part has a new card from `wires`: the engine's end and the machine's end.
fn measure<C: Card + Send + 'static, F: FarSideWires>(
    options: SelftestOptions,
    mut progress: impl FnMut(&str, u64),
    mut wires: impl FnMut() -> Result<(C, F), SelftestError>,
) -> Result<LatencyTestResult, SelftestError> {
    // All threads but the real-time one leave its CPU. Threads started from here inherit that.
    let left = realtime_setup::move_off_cpu(options.cpu);
    let (wakeup, setup) = measure_wake_ups(options, &mut progress)?;
    // The far side waits for each insertion and keeps its dwell time. So the gate uses the last period alone.
    let axis =
        AxisConfig { max_correction_counts: i64::MAX, max_accel_counts_s2: 0.0, ..AxisConfig::default() };
    let mut measured = LatencyTestResult {
        setup,
        wakeup,
        axis,
        quiet: PollingLoopResults::default(),
        with_requests: PollingLoopResults::default(),
        how: CardTestExtent::Simulated,
    };
    if left.is_some() {
        measured.quiet = measure_polling(options, axis, wires()?, false, &mut progress)?;
        measured.with_requests = measure_polling(options, axis, wires()?, true, &mut progress)?;
    }
    Ok(measured)
}

/// Measures the polling of the engine's own thread, for a third of the time.
///
/// This thread is both the far side and the control side. So requests arrive at the moment of an edge, on any number of
/// CPUs.
fn measure_polling<C: Card + Send + 'static, F: FarSideWires>(
    options: SelftestOptions,
    axis: AxisConfig,
    (card, mut far): (C, F),
    requests: bool,
    progress: &mut impl FnMut(&str, u64),
) -> Result<PollingLoopResults, SelftestError> {
    let (mut running, loop_tid) = real_card_timing::start(card, &[axis], options)?;
    let (mut done, done_reader) = histogram();
    let what =
        if requests { "poll gap and edge to done, with requests" } else { "poll gap and edge to done" };
    let mut show = |left_s| progress(what, left_s);
    let mut control = SelftestControlSide::new(&mut running.control, requests, options.run / 3, &mut show);
    let (far, last_done_ns) =
        play(&mut far, &mut control, &mut done, &mut SplitMix64::seed_from_u64(options.seed));
    let (faults, requests) = (control.faults, control.requests);

    let (polling, _) = real_card_timing::stopped(running, loop_tid)?;
    Ok(PollingLoopResults {
        edge_to_done: LatencyDistribution { ns: done_reader.snapshot(), last_ns: last_done_ns, tid: tid() },
        far,
        // The axis's own total starts at zero after every homing, so insertions are counted instead.
        completed: polling.insertions as i64 * INCREMENT_COUNTS,
        faults,
        requests,
        ..polling
    })
}

/// Measures wake-ups for a third of the time, on a thread set up as the real one.
fn measure_wake_ups(
    options: SelftestOptions,
    progress: &mut impl FnMut(&str, u64),
) -> Result<(LatencyDistribution, SetupReport), SelftestError> {
    let third = options.run / 3;
    let thread = std::thread::Builder::new().name("rtec-wakeup".into()).spawn(move || {
        let (_held, report) = apply(&SystemRoot::live(), options.wanted());
        let (mut recorder, reader) = histogram();
        let last_ns = wake_ups(third.as_nanos() as u64, &mut recorder);
        (LatencyDistribution { ns: reader.snapshot(), last_ns, tid: tid() }, report)
    });
    let thread = thread.map_err(|e| SelftestError::Io("starting the wake-up thread", e))?;
    let start = Instant::now();
    let mut next = start;
    while !thread.is_finished() {
        if Instant::now() >= next {
            progress("wake-up", third.saturating_sub(start.elapsed()).as_secs() + 1);
            next += SECOND;
        }
        std::thread::sleep(WATCH_INTERVAL);
    }
    thread.join().map_err(|_| SelftestError::Panicked)
}

/// Records how late it wakes at each of many times; returns the last value, ns.
fn wake_ups(run_ns: u64, recorder: &mut Recorder) -> u64 {
    let mut clock = Monotonic;
    let start_ns = clock.now_ns();
    let mut next_ns = start_ns;
    let mut late_ns = 0;
    while next_ns - start_ns < run_ns {
        next_ns += WAKEUP_INTERVAL_NS;
        let next = libc::timespec {
            tv_sec: (next_ns / 1_000_000_000) as libc::time_t,
            tv_nsec: (next_ns % 1_000_000_000) as _,
        };
        // SAFETY: the request is a valid timespec that outlives the call; a null remainder is allowed.
        while unsafe {
            libc::clock_nanosleep(
                libc::CLOCK_MONOTONIC,
                libc::TIMER_ABSTIME,
                &raw const next,
                std::ptr::null_mut(),
            )
        } == libc::EINTR
        {}
        let now_ns = clock.now_ns();
        late_ns = now_ns - next_ns;
        recorder.record(late_ns);
        // After a long delay it continues from now, instead of waking a hundred times at once.
        next_ns += late_ns / WAKEUP_INTERVAL_NS * WAKEUP_INTERVAL_NS;
    }
    late_ns
}
