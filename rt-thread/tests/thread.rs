//! The thread's loop between the link and the card: how requests and looks take turns. No time is measured.

#![allow(clippy::unwrap_used)]

use rtec_driver::card::{AxisLines, Card, CardError, MachineLines, Sample};
use rtec_rt::axis::AxisConfig;
use rtec_rt::engine::{Engine, MachineConfig};
use rtec_rt::event::{EventKind, Refusal, Request};
use rtec_rt::link::{ControlEnd, REQUESTS, RtEnd, link};
use rtec_rt::thread::run;

/// What the loop did to the card.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Did {
    /// A look that might have waited for a line until this time, ns, and the time it began, ns.
    Look { at_ns: u64, wait_until_ns: u64 },
    /// A write: here only the hold line is ever written, by a request that changes it.
    Write,
}

/// A card at rest that writes down what is done to it. Every look takes 1 µs.
#[derive(Default)]
struct Diary {
    t_ns: u64,
    outputs: u64,
    did: Vec<Did>,
}

impl Card for Diary {
    fn sample(&mut self, wait_until_ns: u64) -> Result<Sample, CardError> {
        self.did.push(Did::Look { at_ns: self.t_ns, wait_until_ns });
        self.t_ns += 1000;
        Ok(Sample::level(self.t_ns, 0))
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
    let axis = AxisConfig { lines: AxisLines::standard(0, false), ..AxisConfig::default() };
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
        control.send(Request::Hold(n % 2 == 0)).unwrap();
    }
    assert!(control.send(Request::Clear).is_err(), "the ring is full");
    control.stop();
    let ended = run(engine, card, rt, u64::MAX);
    let between_looks = ended.card.did.split(|d| matches!(d, Did::Look { .. }));
    let writes: Vec<usize> = between_looks.map(<[Did]>::len).collect();
    assert_eq!(writes.iter().sum::<usize>(), REQUESTS, "every request was taken");
    assert!(writes.iter().all(|n| *n <= 1), "more than one request between two looks: {writes:?}");
}

#[test]
fn requests_sent_before_the_stop_are_taken_and_answered() {
    let (engine, card, mut control, rt) = start();
    for _ in 0..REQUESTS {
        control.send(Request::Home { axis: 5, position_counts: 0 }).unwrap();
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
        // Refused: nothing else wakes the engine.
        control.send(Request::Home { axis: 5, position_counts: 0 }).unwrap();
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
