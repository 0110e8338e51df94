//! The engine seen from the control side.
//! It covers requests, refusals, faults, modes, homing, probing and shadow mode.

#![allow(clippy::unwrap_used)]

mod faults;
mod looks;
mod requests;

use rtec_driver::card::{
    AxisLines, Card, CardError, CardFault, CardFaultKind, CardInputSample, MachineLines,
};
use rtec_driver::quadrature::Decoder;
use rtec_rt::axis::{AxisConfig, InsertionAtRestPolicy};
use rtec_rt::engine::{Engine, MachineConfig, StartError};
use rtec_rt::link_messages::{
    CorrectorMode, CorrectorStatus, DisableReason, Event, EventKind, Fault, FeedHoldSource, InsertionStatus,
    Refusal, RequestToRt,
};

const PROBE: u64 = 1 << 28;
const SWITCH: u64 = 1 << 29;
const READY: u64 = 1 << 30;
const HOLD: u64 = 1 << 28;

/// A card whose time and lines a test sets by hand.
#[derive(Default)]
struct Bench {
    t_ns: u64,
    inputs: u64,
    outputs: u64,
    writes: usize,
    broken: bool,
    count: i64,
    /// Sample that the next looks return, apart from the levels.
    /// Without it the `fresh` lines do not count.
    says: Option<CardInputSample>,
}

impl Card for Bench {
    fn sample(&mut self, _wake_ns: u64) -> Result<CardInputSample, CardError> {
        self.t_ns += 100;
        if self.broken {
            return Err(CardError::Io { op: "reading the lines", errno: 19 });
        }
        let level = CardInputSample::level(self.t_ns, self.inputs);
        Ok(self.says.map_or(level, |s| CardInputSample { t_ns: self.t_ns, inputs: self.inputs, ..s }))
    }

    fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError> {
        self.outputs = self.outputs & !mask | value & mask;
        self.writes += 1;
        Ok(None)
    }

    fn outputs(&mut self) -> Result<u64, CardError> {
        Ok(self.outputs)
    }
}

/// An engine with its card.
struct Rig<C = Bench> {
    engine: Engine,
    card: C,
    events: Vec<Event>,
}

impl<C: Card> Rig<C> {
    fn on(mut card: C, config: AxisConfig, may_arm: bool) -> Self {
        let machine = MachineConfig { lines: MachineLines::standard(), may_arm };
        let engine = Engine::new(&mut card, &[config], machine, &[]).unwrap();
        Self { engine, card, events: Vec::new() }
    }

    /// An axis homed and enabled, with A' and B' read back.
    fn wired_back(card: C, config: AxisConfig) -> Self {
        let mut rig = Self::on(card, AxisConfig { lines: AxisLines::standard(0, true), ..config }, true);
        rig.engine.start_homed(&mut rig.card, &mut |_| true).unwrap();
        rig
    }

    fn take(&mut self, request: RequestToRt) {
        let events = &mut self.events;
        let tell = &mut |e| {
            events.push(e);
            true
        };
        self.engine.take(request, &mut self.card, tell).unwrap();
    }

    fn correct(&mut self, total_counts: i64) {
        self.take(RequestToRt::Correct { axis: 0, total_counts, large: false });
    }

    fn looks(&mut self, n: usize) {
        for _ in 0..n {
            let events = &mut self.events;
            let tell = &mut |e| {
                events.push(e);
                true
            };
            self.engine.poll(&mut self.card, u64::MAX, tell).unwrap();
        }
    }

    fn status(&self) -> CorrectorStatus {
        self.engine.status()
    }

    fn refusals(&self) -> Vec<Refusal> {
        let why = |e: &Event| if let EventKind::Refused { why, .. } = e.kind { Some(why) } else { None };
        self.events.iter().filter_map(why).collect()
    }

    fn faults(&self) -> Vec<Fault> {
        let fault = |e: &Event| if let EventKind::Fault(f) = e.kind { Some(f) } else { None };
        self.events.iter().filter_map(fault).collect()
    }
}

impl Rig {
    fn with(config: AxisConfig, may_arm: bool) -> Self {
        Self::on(Bench::default(), AxisConfig { lines: AxisLines::standard(0, false), ..config }, may_arm)
    }

    /// An axis homed and enabled.
    fn running(config: AxisConfig) -> Self {
        let mut rig = Self::with(config, true);
        rig.take(RequestToRt::Home { axis: 0, position_counts: 0, controller_homed: true });
        rig.take(RequestToRt::ConfirmHome { axis: 0, position_counts: 0 });
        rig.take(RequestToRt::Enable);
        assert_eq!(rig.status().mode, CorrectorMode::Run);
        rig.events.clear();
        rig
    }

    /// Moves the scale one count every 100 looks.
    fn step(&mut self, counts: i64) {
        for _ in 0..counts.abs() {
            self.card.count += counts.signum();
            let state = [0, 1, 3, 2][self.card.count.rem_euclid(4) as usize];
            self.card.inputs = self.card.inputs & !3 | state;
            self.looks(100);
        }
    }
}

fn windowed() -> AxisConfig {
    AxisConfig { window_counts: 3, max_correction_counts: 100, ..AxisConfig::default() }
}

impl Rig {
    /// Changes one channel (1 A, 2 B) `edges` times, every `looks` looks of 100 ns.
    fn alone(&mut self, channel: u64, edges: usize, looks: usize) {
        for _ in 0..edges {
            self.card.inputs ^= channel;
            self.looks(looks);
        }
    }

    /// A running axis that has moved by `counts`.
    /// Its card keeps every edge, or shows levels only.
    fn moved(counts: i64, keeps_edges: bool) -> Self {
        let mut rig = Self::running(AxisConfig::default());
        if keeps_edges {
            rig.card.says = Some(CardInputSample { complete: 0b11, ..CardInputSample::level(0, 0) });
        }
        rig.step(counts);
        rig
    }
}
