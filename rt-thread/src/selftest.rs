//! How late this machine can be: the latencies that the speed gate stands on, measured with the real engine.
//!
//! Nothing is understated: where a clock had to be read before or after an event, the worse side was taken.
//!
//! | figure | how |
//! |---|---|
//! | wake-up | `clock_nanosleep` to an absolute time, as cyclictest does |
//! | poll gap | between two looks of the engine's own polling loop, as oslat does with an empty one |
//! | edge to done | another CPU plays the scale and the MTC: from the moment before it changes A or B to the moment it has seen the second inversion |

use crate::axis::AxisConfig;
use crate::engine::{Engine, MachineConfig, StartError};
use crate::event::{Mode, Request};
use crate::histogram::{Recorder, Snapshot, histogram};
use crate::setup::{self, Report, System, Wanted, apply};
use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{RngCore, SeedableRng};
use rtec_driver::card::{AxisLines, Card, CardError, MachineLines};
use rtec_driver::clock::{Clock, Monotonic};
use rtec_driver::mapped::{MapError, MappedCard, Registers};
use rtec_driver::mock::{MockCard, SharedWires};
use rtec_driver::profile::{Profile, Width};
use rtec_driver::quadrature::Decoder;
use serde::Serialize;
use std::io;
use std::sync::atomic::{
    AtomicBool, AtomicU64,
    Ordering::{Acquire, Relaxed, Release},
};
use std::thread;
use std::time::Duration;

/// Time between two wake-ups, ns.
pub const WAKEUP_INTERVAL_NS: u64 = 500_000;
/// The far side waits this long, at least and at most, between an insertion and the next edge, ns: not in step with
/// anything the loop does.
const DWELL_NS: (u64, u64) = (20_000, 40_000);
/// A sample for which the far side itself did not look for longer than this is not counted: its time is its own, ns.
const RESOLUTION_NS: u64 = 1_000;
/// An insertion that has not come after so many looks at an edge will not come: one takes some twenty.
const LOOKS_TO_GIVE_UP: u64 = 2_000;

/// Which card to measure with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Backend {
    /// Wires in the same process.
    Mock,
    /// Registers in a file that is mapped twice, as the two sides of a PCI card see them.
    Mapped,
}

/// What to measure, and where.
#[derive(Debug, Clone, Copy)]
pub struct Options {
    /// The CPU of the real-time thread.
    pub cpu: usize,
    /// Its `SCHED_FIFO` priority.
    pub priority: u8,
    /// How long, all in all: half for the wake-ups, half for the polling loop.
    pub run: Duration,
    /// The card.
    pub backend: Backend,
    /// Seed of the far side's dwell times.
    pub seed: u64,
}

/// Why nothing could be measured.
#[derive(Debug, thiserror::Error)]
pub enum SelftestError {
    /// A file or thread that the test needs.
    #[error("{0}: {1}")]
    Io(&'static str, #[source] io::Error),
    /// The card's registers.
    #[error(transparent)]
    Map(#[from] MapError),
    /// The card failed.
    #[error(transparent)]
    Card(#[from] CardError),
    /// The engine did not start.
    #[error(transparent)]
    Start(#[from] StartError),
    /// A thread ended by a panic: a bug.
    #[error("the {0} thread panicked")]
    Panicked(&'static str),
}

/// One of the three latencies.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct Latency {
    /// Its distribution, ns.
    #[serde(flatten)]
    pub ns: Snapshot,
    /// The last value, ns.
    #[serde(skip)]
    pub last_ns: u64,
    /// The thread that measured it.
    #[serde(skip)]
    pub tid: i32,
}

/// Everything that was measured.
#[derive(Debug, Clone)]
pub struct Measured {
    /// The set-up under which it was measured.
    pub setup: Report,
    /// How late a sleeping thread wakes.
    pub wakeup: Latency,
    /// How long the polling loop does not look.
    pub poll_gap: Latency,
    /// From an edge to the second inversion, both separations included. Empty with one CPU only.
    pub edge_to_done: Latency,
    /// What the far side saw and counted; `None` with one CPU only.
    pub far: Option<FarSide>,
    /// The axis that was measured with.
    pub axis: AxisConfig,
    /// Counts inserted according to the engine.
    pub completed: i64,
    /// Faults that a gap in the polling loop latched; the axis was homed again after each.
    pub faults: u64,
}

impl Measured {
    /// Counts to the MTC minus counts from the scale, as the far side counted them, are what the engine completed.
    #[must_use]
    pub fn balanced(&self) -> bool {
        self.far.as_ref().is_none_or(|far| far.mtc_minus_scale == self.completed && far.illegal == 0)
    }

    /// Time from an edge until the engine acts on it, ns, beyond the separations that it has to keep: at the worst seen
    /// and, apart from one look in ten thousand, at the worst.
    #[must_use]
    pub fn detect_ns(&self) -> (u64, u64) {
        let separations = self.separations_ns();
        let of = |gap: u64, done: u64| gap.max(done.saturating_sub(separations));
        (
            of(self.poll_gap.ns.max(), self.edge_to_done.ns.max()),
            of(self.poll_gap.ns.p9999(), self.edge_to_done.ns.p9999()),
        )
    }

    /// The part of edge to done that is wanted: the MTC's separation after the edge, and between the two inversions.
    #[must_use]
    pub fn separations_ns(&self) -> u64 {
        2 * self.axis.min_separation_ns
    }
}

/// What the other end of the wires saw.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct FarSide {
    /// Edges given.
    pub edges: u64,
    /// Edges that no insertion followed: the first one, and those that were seen too late.
    pub without_insertion: u64,
    /// Insertions whose time the far side missed because it was kept from looking itself.
    pub unresolved: u64,
    /// What an MTC counted minus what the scale did.
    pub mtc_minus_scale: i64,
    /// Illegal transitions at the MTC.
    pub illegal: u64,
}

/// The other end of a card's wires.
trait Far {
    fn drive(&mut self, inputs: u64);
    fn outputs(&mut self) -> u64;
}

impl Far for SharedWires {
    fn drive(&mut self, inputs: u64) {
        self.inputs.store(inputs, Release);
    }

    fn outputs(&mut self) -> u64 {
        self.outputs.load(Acquire)
    }
}

/// The registers of the shared-memory test card, from the machine's side.
impl Far for Registers {
    fn drive(&mut self, inputs: u64) {
        self.write(0, Width::Bits32, inputs as u32);
    }

    fn outputs(&mut self) -> u64 {
        u64::from(self.read(4, Width::Bits32))
    }
}

/// What the two threads tell each other besides the wires.
#[derive(Debug, Default)]
#[repr(align(128))]
struct Between {
    /// Looks of the loop so far. Written by: real-time thread. Read by: far side, when an insertion does not come.
    looks: AtomicU64,
    /// Written by: real-time thread, when its time is over. Read by: far side.
    stop: AtomicBool,
    /// Nobody looks any more. Written by: real-time thread. Read by: far side.
    ended: AtomicBool,
    /// Written by: far side, no insertion under way any more. Read by: real-time thread.
    stopped: AtomicBool,
}

/// However one of the two threads ends, the other must not wait for it for ever.
struct AtEnd<'a>(&'a Between, fn(&Between));

impl Drop for AtEnd<'_> {
    fn drop(&mut self) {
        self.1(self.0);
    }
}

impl Between {
    fn nobody_looks(&self) {
        self.stop.store(true, Relaxed);
        self.ended.store(true, Relaxed);
    }

    fn far_side_ended(&self) {
        self.stopped.store(true, Relaxed);
    }
}

/// Measures. `progress` hears, about once a second, what is going on and for how many more seconds.
///
/// # Errors
/// When the test card or a thread cannot be made, or the card fails.
pub fn run(options: Options, progress: impl FnMut(&str, u64)) -> Result<Measured, SelftestError> {
    match options.backend {
        Backend::Mock => {
            let wires = SharedWires::default();
            measure(options, MockCard::new(wires.clone(), Monotonic), wires, progress)
        }
        Backend::Mapped => {
            let io = |e| SelftestError::Io("making the card's file", e);
            let shared_memory = std::path::Path::new("/dev/shm");
            let dir = if shared_memory.is_dir() { shared_memory.to_owned() } else { std::env::temp_dir() };
            let file = tempfile::Builder::new().prefix("rtec-selftest-").tempfile_in(dir).map_err(io)?;
            let profile = Profile::shared_memory();
            file.as_file().set_len(profile.size() as u64).map_err(io)?;
            let far = Registers::open(file.path(), profile.size(), &profile.name)?;
            measure(options, MappedCard::open(file.path(), &profile, Monotonic)?, far, progress)
        }
    }
}

fn measure<C: Card + Send, F: Far + Send>(
    options: Options,
    mut card: C,
    mut far: F,
    mut progress: impl FnMut(&str, u64),
) -> Result<Measured, SelftestError> {
    let system = System::live();
    // Everything but the real-time thread leaves its CPU; threads started from here do as this one does.
    let second_cpu = setup::leave(options.cpu);
    let between = Between::default();
    let (mut done, done_reader) = histogram();
    thread::scope(|scope| {
        let far_side = second_cpu
            .then(|| {
                thread::Builder::new().name("far-side".into()).spawn_scoped(scope, || {
                    let _end = AtEnd(&between, Between::far_side_ended);
                    play(&mut far, &between, &mut done, options.seed)
                })
            })
            .transpose()
            .map_err(|e| SelftestError::Io("starting the far side", e))?;
        if far_side.is_none() {
            between.far_side_ended();
        }
        let real_time = thread::Builder::new().name("rtec-rt".into()).spawn_scoped(scope, || {
            let _end = AtEnd(&between, Between::nobody_looks);
            real_time(&system, options, &mut card, &between)
        });
        let real_time = real_time.map_err(|e| {
            between.nobody_looks();
            SelftestError::Io("starting the real-time thread", e)
        })?;
        let half = options.run / 2;
        for (what, left) in [("wake-up", half), ("poll gap and edge to done", half)] {
            let mut left = left;
            while !left.is_zero() && !real_time.is_finished() {
                progress(what, left.as_secs() + 1);
                let step = left.min(Duration::from_secs(1));
                thread::sleep(step);
                left -= step;
            }
        }
        let mut measured = real_time.join().map_err(|_| SelftestError::Panicked("real-time"))??;
        if let Some(far_side) = far_side {
            let (seen, tid, last_ns) = far_side.join().map_err(|_| SelftestError::Panicked("far-side"))?;
            measured.far = Some(seen);
            measured.edge_to_done = Latency { ns: done_reader.snapshot(), last_ns, tid };
        }
        Ok(measured)
    })
}

/// The real-time thread: wake-ups first, then the engine.
fn real_time<C: Card>(
    system: &System,
    options: Options,
    card: &mut C,
    between: &Between,
) -> Result<Measured, SelftestError> {
    let wanted = Wanted { cpu: options.cpu, priority: options.priority };
    let (_held, setup) = apply(system, wanted);
    let half_ns = (options.run / 2).as_nanos() as u64;
    let tid = tid();

    let (mut recorder, reader) = histogram();
    let last_ns = wake_ups(half_ns, &mut recorder);
    let wakeup = Latency { ns: reader.snapshot(), last_ns, tid };

    // The far side keeps its dwell time and waits for each insertion: the last period alone decides.
    let axis =
        AxisConfig { max_correction_counts: i64::MAX, max_accel_counts_s2: 0.0, ..AxisConfig::default() };
    let machine = MachineConfig { lines: MachineLines::default(), may_arm: true };
    let mut engine = Engine::new(card, &[axis], machine, &[])?;
    let timing = engine.timing();
    let tell = &mut |_| true;
    let always = Request::Correct { axis: 0, total_counts: i64::MAX / 2, large: true };
    engine.start_homed(card, tell)?;
    engine.take(always, card, tell)?;
    let (mut completed, mut faults, mut looks) = (0, 0, 0);
    let completed_of = |engine: &Engine| engine.in_effect(0).map_or(0, |(_, completed)| completed);
    let end_ns = engine.now_ns() + half_ns;
    let mut before_ns = engine.now_ns();
    let last_ns = loop {
        engine.poll(card, u64::MAX, tell)?;
        looks += 1;
        between.looks.store(looks, Release);
        let gap_ns = engine.now_ns() - std::mem::replace(&mut before_ns, engine.now_ns());
        if engine.mode() == Mode::Fault {
            faults += 1;
            completed += completed_of(&engine);
            engine.take(Request::Clear, card, tell)?;
            engine.start_homed(card, tell)?;
            engine.take(always, card, tell)?;
        }
        if before_ns >= end_ns {
            between.stop.store(true, Relaxed);
            if between.stopped.load(Relaxed) {
                break gap_ns;
            }
        }
    };
    Ok(Measured {
        setup,
        wakeup,
        poll_gap: Latency { ns: timing.poll_gap_ns.snapshot(), last_ns, tid },
        edge_to_done: Latency::default(),
        far: None,
        axis,
        completed: completed + completed_of(&engine),
        faults,
    })
}

/// Sleeps to one absolute time after the other and records how late it wakes; returns the last value, ns.
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
        // After a long delay: go on from now, do not wake a hundred times at once.
        next_ns += late_ns / WAKEUP_INTERVAL_NS * WAKEUP_INTERVAL_NS;
    }
    late_ns
}

/// The far side: moves the scale edge by edge, and is the MTC. Returns what it saw, its thread and the last time, ns.
fn play(far: &mut impl Far, between: &Between, done: &mut Recorder, seed: u64) -> (FarSide, i32, u64) {
    let lines = AxisLines::standard(0, false);
    let mut clock = Monotonic;
    let mut dwell = SplitMix64::seed_from_u64(seed);
    let mut inverters = lines.inverters(far.outputs());
    let mut scale = Decoder::new(lines.scale(0));
    let mut mtc = Decoder::new(scale.state().inverted(inverters));
    let mut seen = FarSide::default();
    let mut last_done_ns = 0;
    // The engine is not there while the wake-ups are measured.
    while between.looks.load(Relaxed) == 0 && !between.stop.load(Relaxed) {
        thread::sleep(Duration::from_millis(1));
    }
    while !between.stop.load(Relaxed) {
        let until = clock.now_ns() + DWELL_NS.0 + dwell.next_u64() % (DWELL_NS.1 - DWELL_NS.0);
        while clock.now_ns() < until {}
        let next = scale.state().next(true);
        let edge_ns = clock.now_ns();
        far.drive(u64::from(next.a()) << lines.a | u64::from(next.b()) << lines.b);
        let mut looked_ns = clock.now_ns();
        seen.edges += 1;
        scale.update(next);
        mtc.update(next.inverted(inverters));

        let looks = between.looks.load(Relaxed);
        let mut resolved = looked_ns - edge_ns <= RESOLUTION_NS;
        let mut left = 2;
        while left > 0 {
            let now = lines.inverters(far.outputs());
            let now_ns = clock.now_ns();
            if now == inverters {
                let waited = left == 2 && now_ns - edge_ns > DWELL_NS.0;
                let given_up = waited && between.looks.load(Acquire) > looks + LOOKS_TO_GIVE_UP;
                // Looked at once more: this thread may have been away since it looked.
                if given_up && lines.inverters(far.outputs()) == inverters || between.ended.load(Relaxed) {
                    seen.without_insertion += 1;
                    break;
                }
            } else {
                resolved &= now_ns - looked_ns <= RESOLUTION_NS;
                if (now ^ inverters).count_ones() == 2 {
                    // Not looked in between: the two came one after the other all the same, the adding one first.
                    let first = mtc.state().next(true);
                    mtc.update(first);
                }
                mtc.update(next.inverted(now));
                left -= (now ^ inverters).count_ones();
                inverters = now;
                if left == 0 {
                    if resolved {
                        last_done_ns = now_ns - edge_ns;
                        done.record(last_done_ns);
                    } else {
                        seen.unresolved += 1;
                    }
                }
            }
            looked_ns = now_ns;
        }
    }
    seen.mtc_minus_scale = mtc.count() - scale.count();
    seen.illegal = mtc.illegal();
    (seen, tid(), last_done_ns)
}

fn tid() -> i32 {
    // SAFETY: takes nothing and always succeeds.
    unsafe { libc::gettid() }
}
