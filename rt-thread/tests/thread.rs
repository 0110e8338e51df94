//! The thread's loop: how requests and looks alternate. No time is measured.

#![allow(clippy::unwrap_used)]

use rtec_driver::card::{AxisLines, Card, CardError, CardInputSample, MachineLines};
use rtec_rt::axis::{AxisConfig, InsertionAtRestPolicy};
use rtec_rt::engine::{Engine, MachineConfig};
use rtec_rt::journal::Journal;
use rtec_rt::link::{ControlEnd, REQUESTS, RtEnd, link};
use rtec_rt::link_messages::{CorrectorMode, EventKind, Fault, Refusal, RequestToRt};
use rtec_rt::pinned_rt_thread::{SteppedLoop, ThreadOptions, run, spawn};
use std::ops::ControlFlow;

/// An access of the loop to the card.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Did {
    /// A look: when it began, ns, and until when it might have waited for a line, ns.
    Look { at_ns: u64, wait_until_ns: u64 },
    /// A write of the hold line, after a request that changes it.
    Write,
}

/// A card at rest that records its accesses. Every look takes 1 µs.
#[derive(Default)]
struct Diary {
    t_ns: u64,
    outputs: u64,
    did: Vec<Did>,
    ends: Option<CardError>,
    /// Number of the look that panics.
    panics_at: Option<usize>,
}

impl Card for Diary {
    fn sample(&mut self, wait_until_ns: u64) -> Result<CardInputSample, CardError> {
        if let Some(error) = self.ends {
            return Err(error);
        }
        assert_ne!(self.panics_at, Some(self.did.len()), "planted");
        self.did.push(Did::Look { at_ns: self.t_ns, wait_until_ns });
        self.t_ns += 1000;
        Ok(CardInputSample::level(self.t_ns, 0))
    }

    fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError> {
        self.outputs = self.outputs & !mask | value & mask;
        self.did.push(Did::Write);
        Ok(None)
    }

    fn outputs(&mut self) -> Result<u64, CardError> {
        Ok(self.outputs)
    }
}

fn start() -> (Engine, Diary, ControlEnd, RtEnd) {
    let mut card = Diary::default();
    let rest = InsertionAtRestPolicy::Insert { after_ns: 997_000 };
    let axis = AxisConfig { lines: AxisLines::standard(0, false), rest, ..AxisConfig::default() };
    let machine = MachineConfig { lines: MachineLines::standard(), may_arm: true };
    let engine = Engine::new(&mut card, &[axis], machine, &[]).unwrap();
    card.did.clear();
    let (control, rt) = link(engine.status());
    (engine, card, control, rt)
}

#[test]
fn a_full_ring_is_taken_one_request_a_look() {
    let (engine, card, mut control, rt) = start();
    for n in 0..REQUESTS {
        // Each of them writes the hold line.
        control.send(RequestToRt::Hold { on: n % 2 == 0, by: 0 }).unwrap();
    }
    assert!(control.send(RequestToRt::Clear).is_err(), "the ring is full");
    control.stop();
    let ended = run(engine, card, rt, u64::MAX);
    let between_looks = ended.card.did.split(|d| matches!(d, Did::Look { .. }));
    let writes: Vec<usize> = between_looks.map(<[Did]>::len).collect();
    assert_eq!(writes.iter().sum::<usize>(), REQUESTS, "every request was taken");
    assert!(writes.iter().all(|n| *n <= 1), "more than one request between two looks: {writes:?}");
}

/// A panic in the loop latches and reports the fault and writes feed hold.
/// The end is reported too.
#[test]
fn a_panic_is_a_fault_and_holds_the_machine() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("state");
    let open = || Journal::open(&file, "panic").unwrap();
    let (mut engine, card, mut control, rt) = start();
    engine.keep_journal(open().0).unwrap();
    let ended = run(engine, Diary { panics_at: Some(20), ..card }, rt, u64::MAX);
    assert!(control.ended() && ended.status.faults.has(Fault::ThreadLost));
    assert_eq!((control.status().mode, ended.status.hold_output), (CorrectorMode::Fault, true));
    assert_eq!((ended.card.outputs & 1 << 28, ended.card.did.last()), (1 << 28, Some(&Did::Write)));
    let events: Vec<_> = std::iter::from_fn(|| control.event()).map(|e| e.kind).collect();
    assert!(events.contains(&EventKind::Fault(Fault::ThreadLost)), "{events:?}");
    drop(ended);
    let noted = open().1.machine.unwrap();
    assert!(noted.hold_output && noted.faults.has(Fault::ThreadLost));
}

#[test]
fn requests_sent_before_the_stop_are_taken_and_answered() {
    let (engine, card, mut control, rt) = start();
    for _ in 0..REQUESTS {
        control.send(RequestToRt::Home { axis: 5, position_counts: 0, controller_homed: true }).unwrap();
    }
    control.stop();
    run(engine, card, rt, u64::MAX);
    assert_eq!(control.pending(), 0);
    let refused = EventKind::Refused { total_counts: 0, why: Refusal::NoSuchAxis };
    let answers = std::iter::from_fn(|| control.event()).filter(|e| e.kind == refused);
    assert_eq!(answers.count(), REQUESTS);
    assert!(control.ended());
}

#[test]
fn no_look_waits_while_requests_may_be_there() {
    let (engine, card, mut control, rt) = start();
    for _ in 0..REQUESTS {
        // A refused request, so that nothing else wakes the engine.
        control.send(RequestToRt::Home { axis: 5, position_counts: 0, controller_homed: true }).unwrap();
    }
    control.stop();
    let ended = run(engine, card, rt, u64::MAX);
    let looks = ended.card.did.iter().filter_map(|did| match did {
        Did::Look { at_ns, wait_until_ns } => Some(wait_until_ns > at_ns),
        Did::Write => None,
    });
    let waits: Vec<bool> = looks.collect();
    assert!(
        !waits[..REQUESTS].contains(&true),
        "each of the requests would wait as long as a card may sleep"
    );
    assert!(waits[REQUESTS..].contains(&true), "a card may sleep when there are none");
}

/// A status is published every millisecond, and silence is found with it.
/// The return of the control side is reported in the same way.
#[test]
fn a_status_is_published_every_millisecond_and_silence_is_noticed_with_it() {
    const MS: u64 = 1_000_000;
    let (engine, card, mut control, rt) = start();
    let begun_ns = engine.now_ns();
    let mut turns = SteppedLoop::new(engine, card, rt, 3 * MS);
    let mut until = |t_ns: u64| {
        while turns.engine().now_ns() < t_ns {
            assert_eq!(turns.turn(), ControlFlow::Continue(()));
        }
    };
    let seen = |control: &mut ControlEnd| {
        let told: Vec<_> = std::iter::from_fn(|| control.event()).map(|e| e.kind).collect();
        (control.status().t_ns, told)
    };
    until(MS - 1000);
    assert_eq!(seen(&mut control), (begun_ns, vec![]));
    until(MS);
    assert_eq!(seen(&mut control), (MS, vec![]));
    until(2 * MS - 1000);
    assert_eq!(seen(&mut control), (MS, vec![]));
    control.beat();
    // The sign of life is noticed at 2 ms, and silence counts from there.
    until(5 * MS);
    assert_eq!(seen(&mut control), (5 * MS, vec![]), "for as long as it may be");
    until(6 * MS);
    assert_eq!(seen(&mut control), (6 * MS, vec![EventKind::ControlStale(true)]));
    control.beat();
    until(7 * MS);
    assert_eq!(seen(&mut control), (7 * MS, vec![EventKind::ControlStale(false)]));
}

/// A request to end waits for the insertion under way.
/// It also waits for the requests that were sent before.
#[test]
fn the_end_waits_for_the_insertion_under_way_and_for_the_requests_sent_before() {
    let (mut engine, mut card, mut control, rt) = start();
    engine.start_homed(&mut card, &mut |_| true).unwrap();
    let mut turns = SteppedLoop::new(engine, card, rt, u64::MAX);
    // 1000 µs at rest, then two inversions at least 1 µs apart, the first in the turn that publishes a status.
    control.send(RequestToRt::Correct { axis: 0, total_counts: 2, large: false }).unwrap();
    while turns.engine().at_rest() {
        assert_eq!(turns.turn(), ControlFlow::Continue(()));
    }
    control.stop();
    while turns.turn() == ControlFlow::Continue(()) {}
    let ended = turns.end(None);
    assert_eq!((ended.status.axes[0].completed, ended.error), (2, None));
    assert!(control.ended() && control.status() == ended.status);
}

#[test]
fn a_card_that_fails_is_the_reason_of_the_end_and_one_that_has_ended_is_none() {
    let broken = CardError::Io { op: "reading the lines", errno: 19 };
    for (error, reason, faults) in
        [(broken, Some(broken), vec![Fault::Card]), (CardError::Ended, None, vec![])]
    {
        let (engine, card, mut control, rt) = start();
        let ended = run(engine, Diary { ends: Some(error), ..card }, rt, u64::MAX);
        assert_eq!((ended.error, ended.status.faults.iter().collect::<Vec<_>>()), (reason, faults));
        assert_eq!(control.status(), ended.status);
    }
}

/// In an ordinary thread a mock may be armed, a real card may not.
#[test]
fn a_real_card_is_armed_by_nothing_less_than_a_verified_set_up() {
    for (real, mode) in [(false, CorrectorMode::Run), (true, CorrectorMode::Disabled)] {
        let (engine, card, ..) = start();
        let options = ThreadOptions { wanted: None, real, stale_after_ns: u64::MAX };
        let mut running = spawn(engine, card, options).unwrap();
        assert!(running.report.is_none());
        for request in [
            RequestToRt::Home { axis: 0, position_counts: 0, controller_homed: true },
            RequestToRt::ConfirmHome { axis: 0, position_counts: 0 },
            RequestToRt::Enable,
        ] {
            running.control.send(request).unwrap();
        }
        let (ended, _control) = running.stop();
        assert_eq!((ended.status.mode, ended.error), (mode, None), "a real card: {real}");
    }
}
