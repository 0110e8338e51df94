//! The exact times at which the engine acts.
//! The card's looks, edges and writes have the times that a test gives them.
//!
//! The engine's documentation states the boundaries of its rules. Each is tested at the last nanosecond on either side.

#![allow(clippy::unwrap_used)]

mod inside;
mod states;
mod times;

use rtec_driver::card::{AxisLines, Card, CardError, CardInputSample, MachineLines};
use rtec_driver::quadrature::{Decoder, Signal, State};
use rtec_rt::axis::{AxisConfig, InsertionAtRestPolicy};
use rtec_rt::engine::{Engine, MachineConfig};
use rtec_rt::journal::{AxisStateRecord, Journal};
use rtec_rt::link_messages::{
    CorrectorMode, Event, EventKind, Fault, FaultSet, InsertionStatus, Refusal, RequestToRt,
};
use std::path::PathBuf;

const PROBE: u64 = 1 << 28;
const BOTH: u64 = 0b11;

#[derive(Default)]
struct Hand {
    t_ns: u64,
    inputs: u64,
    outputs: u64,
    /// Time of the change at the next look, ns, on a card with timestamps.
    stamp: Option<u64>,
    /// Mask of lines on which no edge passes unseen.
    complete: u64,
    /// Time from order to effect of a write, ns, where the card reports it.
    tells_ns: Option<u64>,
    /// Time, ns, and outputs of each write.
    writes: Vec<(u64, u64)>,
    /// Time until which the last look might have slept, ns.
    wake_ns: u64,
    /// State file that is read at each write.
    state_file: Option<PathBuf>,
    noted: Vec<Vec<u8>>,
}

impl Card for Hand {
    fn sample(&mut self, wake_ns: u64) -> Result<CardInputSample, CardError> {
        self.wake_ns = wake_ns;
        Ok(CardInputSample {
            edge_ns: self.stamp.take(),
            complete: self.complete,
            ..CardInputSample::level(self.t_ns, self.inputs)
        })
    }

    fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError> {
        self.outputs = self.outputs & !mask | value & mask;
        if mask & (1 << 28) == 0 {
            self.writes.push((self.t_ns, self.outputs));
        }
        self.noted.extend(self.state_file.as_ref().map(|file| std::fs::read(file).unwrap()));
        Ok(self.tells_ns.map(|ns| self.t_ns + ns))
    }

    fn outputs(&mut self) -> Result<u64, CardError> {
        Ok(self.outputs)
    }
}

struct Rig {
    engine: Engine,
    card: Hand,
    events: Vec<Event>,
    keep: bool,
}

impl Rig {
    /// An engine homed and enabled at 1000 ns.
    fn new(configs: &[AxisConfig], card: Hand) -> Self {
        let mut card = Hand { t_ns: 1000, ..card };
        let machine = MachineConfig { lines: MachineLines::standard(), may_arm: true };
        let mut engine = Engine::new(&mut card, configs, machine, &[]).unwrap();
        engine.start_homed(&mut card, &mut |_| true).unwrap();
        Self { engine, card, events: Vec::new(), keep: true }
    }

    /// One axis that never accelerates.
    /// So the next edge comes no sooner than the last did.
    fn steady(config: AxisConfig, card: Hand) -> Self {
        Self::new(&[AxisConfig { max_accel_counts_s2: 0.0, ..one(config) }], card)
    }

    fn take(&mut self, request: RequestToRt) {
        let Self { engine, card, events, keep } = self;
        let report = &mut |e| {
            events.push(e);
            *keep
        };
        engine.take(request, card, report).unwrap();
    }

    fn correct(&mut self, total_counts: i64) {
        self.take(RequestToRt::Correct { axis: 0, total_counts, large: false });
    }

    fn look(&mut self, t_ns: u64) {
        self.card.t_ns = t_ns;
        let Self { engine, card, events, keep } = self;
        let report = &mut |e| {
            events.push(e);
            *keep
        };
        engine.poll(card, u64::MAX, report).unwrap();
    }

    /// Looks every 10 ns, the last one at `until_ns`.
    fn looks(&mut self, until_ns: u64) {
        while self.card.t_ns < until_ns {
            self.look((self.card.t_ns + 10).min(until_ns));
        }
    }

    /// An edge of an axis, which a look at this time shows.
    fn edge_of(&mut self, axis: u8, up: bool, t_ns: u64) {
        let lines = AxisLines::standard(axis, false);
        let next = lines.scale(self.card.inputs).next(up);
        for (bit, level) in [(lines.a, next.a()), (lines.b, next.b())] {
            self.card.inputs = self.card.inputs & !(1 << bit) | u64::from(level) << bit;
        }
        self.look(t_ns);
    }

    fn edge(&mut self, up: bool, t_ns: u64) {
        self.edge_of(0, up, t_ns);
    }

    /// An edge with the time of the look as its timestamp.
    fn stamped(&mut self, up: bool, t_ns: u64) {
        self.card.stamp = Some(t_ns);
        self.edge(up, t_ns);
    }

    fn faults(&self) -> Vec<Fault> {
        let fault = |e: &Event| if let EventKind::Fault(f) = e.kind { Some(f) } else { None };
        self.events.iter().filter_map(fault).collect()
    }

    fn refusals(&self) -> Vec<Refusal> {
        let why = |e: &Event| if let EventKind::Refused { why, .. } = e.kind { Some(why) } else { None };
        self.events.iter().filter_map(why).collect()
    }

    /// Times of the writes after `from_ns`, ns.
    fn written(&self, from_ns: u64) -> Vec<u64> {
        self.card.writes.iter().map(|(t_ns, _)| t_ns - from_ns).collect()
    }
}

fn one(config: AxisConfig) -> AxisConfig {
    AxisConfig { lines: AxisLines::standard(0, config.lines.read_back.is_some()), ..config }
}

/// A card that timestamps edges and reports a write in effect after 20 ns.
fn stamping() -> Hand {
    Hand { complete: u64::MAX, tells_ns: Some(20), ..Hand::default() }
}

fn resting(after_ns: u64) -> AxisConfig {
    AxisConfig { rest: InsertionAtRestPolicy::Insert { after_ns }, ..AxisConfig::default() }
}
