//! The pinned thread.
//! It sets itself up, reports the result, then looks at the card until asked to stop.

use crate::engine::{Engine, LoopHistograms};
use crate::link::{ControlEnd, RtEnd, link};
use crate::link_messages::CorrectorStatus;
use crate::realtime_setup::{RtSettings, SetupReport, SystemRoot, apply};
use rtec_driver::card::{Card, CardError};
use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc;
use std::thread::JoinHandle;

/// Interval of the status and of the check for silence, ns.
const PUBLISH_NS: u64 = 1_000_000;

/// Options of the real-time thread.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ThreadOptions {
    /// CPU and priority; `None` runs as an ordinary thread.
    pub wanted: Option<RtSettings>,
    /// The card drives a real machine, so every setting must be read back as wanted.
    pub real: bool,
    /// Silence of the control side after which no insertion begins, ns.
    pub stale_after_ns: u64,
}

/// A running engine, seen from the control side.
#[derive(Debug)]
pub struct RtThreadHandle<C> {
    /// The control side's end of the link.
    pub control: ControlEnd,
    /// Histograms of the loop's times.
    pub timing: LoopHistograms,
    /// The report of the set-up; `None` where none was wanted.
    pub report: Option<SetupReport>,
    thread: JoinHandle<ThreadExit<C>>,
}

/// What the thread returns at its end.
#[derive(Debug)]
pub struct ThreadExit<C> {
    /// The card, with its outputs unchanged.
    pub card: C,
    /// The last status.
    pub status: CorrectorStatus,
    /// The error that ended it; `None` where it was asked to end.
    pub error: Option<CardError>,
}

/// Why the thread did not start.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)] // the messages say what they are
pub enum SpawnError {
    #[error("starting the real-time thread: {0}")]
    Thread(#[from] std::io::Error),
    #[error("a real-time thread that polls needs a CPU of its own, and this machine has one in all")]
    OneCpu,
    #[error("the real-time thread ended during its set-up")]
    SetUp,
}

/// Starts the thread on an engine and its card.
///
/// # Errors
/// When the system gives no thread, or real-time priority is wanted on a machine with one CPU.
pub fn spawn<C: Card + Send + 'static>(
    mut engine: Engine,
    card: C,
    options: ThreadOptions,
) -> Result<RtThreadHandle<C>, SpawnError> {
    if options.wanted.is_some() && SystemRoot::live().cpus_online() == 1 {
        return Err(SpawnError::OneCpu);
    }
    let (control, rt) = link(engine.status());
    let timing = engine.timing();
    let (send_report, report) = mpsc::sync_channel(1);
    let thread = std::thread::Builder::new().name("rtec-rt".into()).spawn(move || {
        let (_held, report) = options.wanted.map(|w| apply(&SystemRoot::live(), w)).unzip();
        engine.set_may_arm(!options.real || report.as_ref().is_some_and(SetupReport::can_arm));
        // The receiver waits for this message. If it has gone, the loop below is asked to stop.
        let _ = send_report.send(report);
        run(engine, card, rt, options.stale_after_ns)
    })?;
    let report = report.recv().map_err(|_| SpawnError::SetUp)?;
    Ok(RtThreadHandle { control, timing, report, thread })
}

impl<C> RtThreadHandle<C> {
    /// Stops the thread and waits for it.
    /// Requests sent before are taken first, and an insertion under way is finished. Then corrections freeze, and
    /// inverters stay as they are.
    ///
    /// # Panics
    /// When the real-time thread itself panicked.
    pub fn stop(self) -> (ThreadExit<C>, ControlEnd) {
        self.control.stop();
        match self.thread.join() {
            Ok(ended) => (ended, self.control),
            Err(panic) => std::panic::resume_unwind(panic),
        }
    }
}

/// Runs the loop until it is asked to stop or the card fails.
/// Nothing in it allocates, locks, logs or (on a card of mapped registers) calls the system. A panic in it latches a
/// fault, and feed hold is written.
pub fn run<C: Card>(engine: Engine, card: C, rt: RtEnd, stale_after_ns: u64) -> ThreadExit<C> {
    let mut turns = SteppedLoop::new(engine, card, rt, stale_after_ns);
    // After a panic the engine is only asked to latch a fault and to write the hold line.
    let ended = catch_unwind(AssertUnwindSafe(|| {
        loop {
            if let ControlFlow::Break(error) = turns.turn() {
                return error;
            }
        }
    }));
    match ended {
        Ok(error) => turns.end(error),
        Err(_) => turns.end_after_panic(),
    }
}

/// The loop of [`run`] turn by turn, for a caller with a clock of its own.
#[derive(Debug)]
pub struct SteppedLoop<C> {
    engine: Engine,
    card: C,
    rt: RtEnd,
    stale_after_ns: u64,
    published_ns: u64,
    beats: u64,
    beat_ns: u64,
}

impl<C: Card> SteppedLoop<C> {
    /// Prepares the loop; no turn is made.
    pub fn new(engine: Engine, card: C, rt: RtEnd, stale_after_ns: u64) -> Self {
        let (beats, beat_ns) = (rt.beats(), engine.now_ns());
        Self { engine, card, rt, stale_after_ns, published_ns: 0, beats, beat_ns }
    }

    /// The engine between two turns.
    pub const fn engine(&self) -> &Engine {
        &self.engine
    }

    /// One turn: at most one request, one look, and at times a status.
    /// It breaks with the card's error. It breaks without one if the end was asked for or a recording has ended.
    #[inline]
    pub fn turn(&mut self) -> ControlFlow<Option<CardError>> {
        let Self { engine, card, rt, .. } = self;
        // One request a look, so that many requests at once do not lengthen a gap between looks.
        let wait_until_ns = if let Some(request) = rt.request() {
            if let Err(error) = engine.take(request, card, &mut |e| rt.report(e)) {
                engine.card_failed(error, &mut |e| rt.report(e));
            }
            // The next request may be there already, and must not wait for a card that sleeps.
            0
        } else {
            self.published_ns + PUBLISH_NS
        };
        if let Err(error) = engine.poll(card, wait_until_ns, &mut |e| rt.report(e)) {
            engine.card_failed(error, &mut |e| rt.report(e));
            return ControlFlow::Break(Some(error).filter(|e| *e != CardError::Ended));
        }
        let now_ns = engine.now_ns();
        if now_ns >= self.published_ns + PUBLISH_NS {
            if rt.stopped() && rt.all_taken() && engine.at_rest() {
                return ControlFlow::Break(None);
            }
            if rt.beats() != self.beats {
                (self.beats, self.beat_ns) = (rt.beats(), now_ns);
            }
            engine.set_control_stale(now_ns - self.beat_ns > self.stale_after_ns, &mut |e| rt.report(e));
            rt.publish(engine.status());
            self.published_ns = now_ns;
        }
        ControlFlow::Continue(())
    }

    /// Publishes the last status and hands back the card.
    pub fn end(mut self, error: Option<CardError>) -> ThreadExit<C> {
        let status = self.engine.status();
        self.rt.publish(status);
        self.rt.end();
        ThreadExit { card: self.card, status, error }
    }

    fn end_after_panic(mut self) -> ThreadExit<C> {
        let Self { engine, card, rt, .. } = &mut self;
        // The cause of the panic may break this too. The end is reported anyway.
        let _ = catch_unwind(AssertUnwindSafe(|| engine.panicked(card, &mut |e| rt.report(e))));
        self.end(None)
    }
}
