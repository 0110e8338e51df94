//! How late this machine can be: the latencies that the speed gate stands on, measured with the real engine.
//!
//! Nothing is understated: where a clock had to be read before or after an event, the worse side was taken.
//!
//! | figure | how |
//! |---|---|
//! | wake-up | `clock_nanosleep` to an absolute time, as cyclictest does |
//! | poll gap | between two looks of the engine's own polling loop, as oslat does with an empty one |
//! | edge to done | another CPU plays the scale and the MTC: from the moment before it changes A or B to the moment it has seen the second inversion |

use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{RngCore, SeedableRng};
use rtec_driver::card::{AxisLines, Card, CardError, MachineLines};
use rtec_driver::clock::{Clock, Monotonic};
use rtec_driver::mapped::{MapError, MappedCard, Registers};
use rtec_driver::mock::{MockCard, SharedWires};
use rtec_driver::profile::{Profile, Width};
use rtec_driver::quadrature::Decoder;
use rtec_rt::axis::AxisConfig;
use rtec_rt::engine::{Engine, MachineConfig, StartError};
use rtec_rt::event::{Mode, Request};
use rtec_rt::histogram::{Recorder, Snapshot, histogram};
use rtec_rt::link::ControlEnd;
use rtec_rt::setup::{self, Report, System, Wanted, apply};
use rtec_rt::thread::SpawnError;
use serde::Serialize;
use std::io;
use std::sync::atomic::{
    AtomicBool, AtomicU64,
    Ordering::{Acquire, Relaxed, Release},
};
use std::time::{Duration, Instant};

/// Time between two wake-ups, ns.
pub const WAKEUP_INTERVAL_NS: u64 = 500_000;
/// The far side waits this long, at least and at most, between an insertion and the next edge, ns: not in step with
/// anything the loop does.
const DWELL_NS: (u64, u64) = (20_000, 40_000);
/// A sample for which the far side itself did not look for longer than this is not counted: its time is its own, ns.
const RESOLUTION_NS: u64 = 1_000;
/// How often the control side looks after the engine: seldom, because it may share the far side's CPU.
const CONTROL_INTERVAL: Duration = Duration::from_millis(2);
/// A request that has shown no effect for this long is sent again, ns.
const ASK_AGAIN_NS: u64 = 20_000_000;
/// So much longer than asked for the loop runs while not one insertion has been timed.
const PATIENCE: Duration = Duration::from_secs(10);
const SECOND: Duration = Duration::from_secs(1);

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

impl Options {
    fn wanted(&self) -> Wanted {
        Wanted { cpu: self.cpu, priority: self.priority }
    }
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
    /// Its thread did not.
    #[error(transparent)]
    Spawn(#[from] SpawnError),
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
    /// The last value, ns; of the poll gap, of which none is kept, the median.
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
    /// How long the polling loop does not look. Empty with one CPU only.
    pub poll_gap: Latency,
    /// The engine's own part of it: from the look that saw the edge to the look that ordered the second inversion.
    pub seen_to_done: Snapshot,
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

    /// Time of one write until the next look, ns: half of what an insertion took beyond the separations that it has to
    /// keep, but for one in ten thousand. Rarer delays are in [`Self::detect_ns`].
    #[must_use]
    pub fn write_ns(&self) -> u64 {
        self.seen_to_done.p9999().saturating_sub(self.separations_ns()).div_ceil(2)
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

/// What the far side and the control side tell each other besides the wires.
#[derive(Debug, Default)]
struct Between {
    /// The engine's last look that is known of, ns. Written by: control side. Read by: far side.
    looked_ns: AtomicU64,
    /// The far side shall end. Written by: control side. Read by: far side.
    stop: AtomicBool,
    /// Nobody looks at the card any more. Written by: control side. Read by: far side.
    ended: AtomicBool,
}

/// However the control side ends, the far side must not wait for it for ever.
struct AtEnd<'a>(&'a Between);

impl Drop for AtEnd<'_> {
    fn drop(&mut self) {
        self.0.stop.store(true, Relaxed);
        self.0.ended.store(true, Relaxed);
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

fn measure<C: Card + Send + 'static, F: Far + Send>(
    options: Options,
    mut card: C,
    mut far: F,
    mut progress: impl FnMut(&str, u64),
) -> Result<Measured, SelftestError> {
    // Everything but the real-time thread leaves its CPU; threads started from here do as this one does.
    let left = setup::leave(options.cpu);
    let (wakeup, setup) = measure_wake_ups(options, &mut progress)?;
    if left.is_none() {
        // Polling would leave nobody to end it.
        return Ok(Measured {
            setup,
            wakeup,
            poll_gap: Latency::default(),
            seen_to_done: Snapshot::default(),
            edge_to_done: Latency::default(),
            far: None,
            axis: AxisConfig::default(),
            completed: 0,
            faults: 0,
        });
    }

    // The far side keeps its dwell time and waits for each insertion: the last period alone decides.
    let axis =
        AxisConfig { max_correction_counts: i64::MAX, max_accel_counts_s2: 0.0, ..AxisConfig::default() };
    let machine = MachineConfig { lines: MachineLines::default(), may_arm: false };
    let engine = Engine::new(&mut card, &[axis], machine, &[])?;
    let thread =
        rtec_rt::thread::Options { wanted: Some(options.wanted()), real: false, stale_after_ns: u64::MAX };
    let mut running = rtec_rt::thread::spawn(engine, card, thread)?;

    let between = Between::default();
    let (mut done, done_reader) = histogram();
    std::thread::scope(|scope| {
        let _end = AtEnd(&between);
        let far_side = std::thread::Builder::new()
            .name("far-side".into())
            .spawn_scoped(scope, || play(&mut far, &between, &mut done, options.seed))
            .map_err(|e| SelftestError::Io("starting the far side", e))?;
        let mut control = Control::default();
        let end = Instant::now() + options.run / 2;
        let mut next = Instant::now();
        // On a crowded machine the far side may not have had its turn yet.
        let empty_handed = || Instant::now() < end + PATIENCE && done_reader.snapshot().samples() == 0;
        while (Instant::now() < end || empty_handed()) && !running.control.ended() {
            if Instant::now() >= next {
                progress("poll gap and edge to done", end.saturating_duration_since(next).as_secs() + 1);
                next += SECOND;
            }
            control.look_after(&mut running.control, &between);
            std::thread::sleep(CONTROL_INTERVAL);
        }
        between.stop.store(true, Relaxed);
        while !far_side.is_finished() && !running.control.ended() {
            control.look_after(&mut running.control, &between);
            std::thread::sleep(CONTROL_INTERVAL);
        }
        between.ended.store(true, Relaxed);
        let loop_tid = tid_of("rtec-rt");
        let timing = running.timing.clone();
        let (ended, _) = running.stop();
        if let Some(error) = ended.error {
            return Err(error.into());
        }
        let (seen, far_tid, last_done_ns) =
            far_side.join().map_err(|_| SelftestError::Panicked("far-side"))?;
        let poll_gap_ns = timing.poll_gap_ns.snapshot();
        Ok(Measured {
            setup,
            poll_gap: Latency { last_ns: poll_gap_ns.p50(), ns: poll_gap_ns, tid: loop_tid },
            seen_to_done: timing.edge_to_done_ns.snapshot(),
            edge_to_done: Latency { ns: done_reader.snapshot(), last_ns: last_done_ns, tid: far_tid },
            // Not the axis's own total: that begins anew at every homing.
            completed: ended.status.axes().first().map_or(0, |a| a.insertions as i64)
                * axis.design.increment_counts(),
            faults: control.faults,
            wakeup,
            far: Some(seen),
            axis,
        })
    })
}

/// The control side while the engine runs: always a correction pending, homed again after a fault.
#[derive(Debug, Default)]
struct Control {
    faults: u64,
    state: Homed,
}

#[derive(Debug, Default)]
enum Homed {
    /// Asked for at this look of the engine, or not yet.
    #[default]
    Never,
    /// Asked for at this look, ns.
    Asked { at_ns: u64 },
    /// Correcting.
    Done,
}

impl Control {
    fn look_after(&mut self, control: &mut ControlEnd, between: &Between) {
        control.beat();
        while control.event().is_some() {}
        let status = control.status();
        between.looked_ns.store(status.t_ns, Release);
        match self.state {
            Homed::Never => self.ask(control, status.t_ns),
            Homed::Asked { .. } if status.mode == Mode::Run => self.state = Homed::Done,
            // An insertion was under way, and the request refused.
            Homed::Asked { at_ns } if status.t_ns > at_ns + ASK_AGAIN_NS => self.ask(control, status.t_ns),
            Homed::Done if status.mode == Mode::Fault => {
                self.faults += 1;
                self.ask(control, status.t_ns);
            }
            _ => {}
        }
    }

    fn ask(&mut self, control: &mut ControlEnd, at_ns: u64) {
        for request in [
            Request::Clear,
            Request::Home { axis: 0, position_counts: 0 },
            Request::ConfirmHome { axis: 0, position_counts: 0 },
            Request::Enable,
            Request::Correct { axis: 0, total_counts: i64::MAX / 2, large: true },
        ] {
            // A full ring means that the loop stands still: asked again at the next look.
            let _ = control.send(request);
        }
        self.state = Homed::Asked { at_ns };
    }
}

/// Wakes up for half of the time, on a thread set up as the real one.
fn measure_wake_ups(
    options: Options,
    progress: &mut impl FnMut(&str, u64),
) -> Result<(Latency, Report), SelftestError> {
    let half = options.run / 2;
    let thread = std::thread::Builder::new().name("rtec-wakeup".into()).spawn(move || {
        let (_held, report) = apply(&System::live(), options.wanted());
        let (mut recorder, reader) = histogram();
        let last_ns = wake_ups(half.as_nanos() as u64, &mut recorder);
        (Latency { ns: reader.snapshot(), last_ns, tid: tid() }, report)
    });
    let thread = thread.map_err(|e| SelftestError::Io("starting the wake-up thread", e))?;
    let start = Instant::now();
    let mut next = start;
    while !thread.is_finished() {
        if Instant::now() >= next {
            progress("wake-up", half.saturating_sub(start.elapsed()).as_secs() + 1);
            next += SECOND;
        }
        std::thread::sleep(CONTROL_INTERVAL);
    }
    thread.join().map_err(|_| SelftestError::Panicked("wake-up"))
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
    while !between.stop.load(Relaxed) {
        let until = clock.now_ns() + DWELL_NS.0 + dwell.next_u64() % (DWELL_NS.1 - DWELL_NS.0);
        while clock.now_ns() < until {}
        let mut late = lines.inverters(far.outputs());
        while (late ^ inverters).is_power_of_two() && !between.ended.load(Relaxed) {
            late = lines.inverters(far.outputs());
        }
        if late != inverters {
            // It came after all.
            seen.without_insertion -= 1;
            seen.unresolved += 1;
            mtc.update(mtc.state().next(true));
            mtc.update(scale.state().inverted(late));
            inverters = late;
        }
        let next = scale.state().next(true);
        let edge_ns = clock.now_ns();
        far.drive(u64::from(next.a()) << lines.a | u64::from(next.b()) << lines.b);
        let mut looked_ns = clock.now_ns();
        seen.edges += 1;
        scale.update(next);
        mtc.update(next.inverted(inverters));

        let mut resolved = looked_ns - edge_ns <= RESOLUTION_NS;
        let driven_ns = looked_ns;
        let mut before_ns = edge_ns;
        let mut heard_ns = None;
        let mut left = 2;
        while left > 0 {
            let now = lines.inverters(far.outputs());
            let now_ns = clock.now_ns();
            if now == inverters {
                // The engine has seen the edge at one look that is known of, and has done nothing until another.
                let known_ns = between.looked_ns.load(Acquire);
                let given_up = left == 2
                    && known_ns > driven_ns
                    && *heard_ns.get_or_insert(known_ns) < known_ns
                    // Looked at once more: this thread may have been away since it looked.
                    && lines.inverters(far.outputs()) == inverters;
                if given_up || between.ended.load(Relaxed) {
                    seen.without_insertion += 1;
                    break;
                }
            } else {
                // The lines changed after the look before, whose own time lies between two readings of the clock.
                resolved &= now_ns - before_ns <= RESOLUTION_NS;
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
            (before_ns, looked_ns) = (looked_ns, now_ns);
        }
    }
    seen.mtc_minus_scale = mtc.count() - scale.count();
    seen.illegal = mtc.illegal();
    (seen, tid(), last_done_ns)
}

/// The thread of this process that has this name; 0 when there is none.
fn tid_of(name: &str) -> i32 {
    let tasks = std::fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    let mut named =
        tasks.filter(|t| std::fs::read_to_string(t.path().join("comm")).is_ok_and(|n| n.trim() == name));
    named.find_map(|t| t.file_name().to_str()?.parse().ok()).unwrap_or(0)
}

fn tid() -> i32 {
    // SAFETY: takes nothing and always succeeds.
    unsafe { libc::gettid() }
}
