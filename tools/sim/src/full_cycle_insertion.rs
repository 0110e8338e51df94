//! The Original RTEC and Design A (NISTIR 4832).
//! They insert four counts by two pairs of inversions.
//!
//! Every insertion switches the inverters on and off again, one whole encoder cycle. The Original begins
//! only at A = B = low; Design A begins in any state. Both wait for the same speed gate as the engine, for
//! twice as many inversions. The simulated cards show every edge and confirm every write at once, so no code
//! here guards against missed counts.

use crate::corrected_axis::{CardResult, CorrectedAxis, EventSink, GateInsertionDesign};
use rtec_driver::card::{Card, MachineLines};
use rtec_driver::quadrature::{Decoder, Signal, State};
use rtec_rt::axis::{AxisConfig, InsertionAtRestPolicy, TotalRequestResult};
use rtec_rt::engine::StartError;
use rtec_rt::link_messages::{
    AxisStatus, CorrectorMode, CorrectorStatus, Event, EventKind, Fault, InsertionStatus, MAX_AXES, Refusal,
};
use rtec_rt::speed_gate::{SpeedGate, SpeedGateConfig};

/// Inversions of one insertion, which are also its counts.
const INCREMENT_COUNTS: i64 = GateInsertionDesign::A.increment_counts();
/// The speed gate for four inversions.
/// `None` if no speed leaves time for an insertion.
pub fn gate(config: &AxisConfig) -> Option<SpeedGate> {
    SpeedGate::new(SpeedGateConfig {
        max_accel_counts_s2: config.max_accel_counts_s2,
        hysteresis_counts: config.hysteresis_counts,
        need_ns: (config.detect_ns + config.min_separation_ns + busy_ns(config)).max(1),
    })
}

/// Time from the first inversion until the MTC is ready for a real edge, ns.
fn busy_ns(config: &AxisConfig) -> u64 {
    INCREMENT_COUNTS as u64 * (config.write_ns + config.min_separation_ns) + config.guard_ns
}

/// The corrected axes of one machine, homed, with corrections enabled.
#[derive(Debug)]
pub struct FullCycleCorrector {
    axes: Vec<FullCycleAxis>,
    /// The card's feed-hold line, asserted on a fault.
    hold: Option<u8>,
    look_ns: u64,
    /// Whether the next poll comes at once, after a fault or a write.
    look_at_once: bool,
    faulted: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum InsertionPhase {
    Idle,
    /// An edge has opened the gate.
    /// The insertion begins from `from_ns` until `until_ns`.
    Opened {
        add: bool,
        pairs: u8,
        from_ns: u64,
        until_ns: u64,
    },
    /// The first inversion of a pair is in effect since `effective_ns`.
    /// `edges` real edges have come since.
    HalfPair {
        add: bool,
        pairs: u8,
        effective_ns: u64,
        edges: u8,
    },
    /// One pair is done; the MTC gets its separation before the next.
    BetweenPairs {
        add: bool,
        pairs: u8,
        effective_ns: u64,
    },
}

/// The last inversion, which an edge may have preceded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct LastInversion {
    signal: Signal,
    from_ns: u64,
    done_ns: u64,
}

#[derive(Debug)]
struct FullCycleAxis {
    config: AxisConfig,
    gate: SpeedGate,
    only_at_low: bool,
    scale: Decoder,
    home_counts: i64,
    /// Inverters: bit 0 A, bit 1 B.
    inverters: u8,
    /// A' and B', and the MTC's count since homing.
    mtc: State,
    mtc_count: i64,
    /// Totals, figures and faults; [`FullCycleAxis::status`] adds the rest.
    status: AxisStatus,
    not_believed: u8,
    phase: InsertionPhase,
    last_inversion: Option<LastInversion>,
    /// Bounds of the time of the last edge, ns.
    last_edge: Option<(u64, u64)>,
    /// Direction of the last edge; 0 before the first and after an illegal transition.
    last_step: i8,
    /// Lower bound of the last period, ns; `None` before the second edge.
    period_ns: Option<u64>,
    next_allowed_ns: u64,
    /// The mode has changed since the last poll or total.
    look_at_once: bool,
}

#[derive(Debug, Clone, Copy)]
struct PollSample {
    t_ns: u64,
    /// Bounds of the time of an edge that this poll shows, ns.
    edge_ns: (u64, u64),
    may_insert: bool,
}

impl FullCycleCorrector {
    /// Takes over the card as it is; axis `n` is homed at `origin_counts(n)`.
    ///
    /// # Errors
    /// When the card cannot be read or written, or an axis has no speed that leaves time for an insertion.
    pub fn new<C: Card>(
        design: GateInsertionDesign,
        card: &mut C,
        configs: &[AxisConfig],
        lines: MachineLines,
        origin_counts: impl Fn(usize) -> i64,
    ) -> Result<Self, StartError> {
        let sample = card.sample(0)?;
        let axis = |(n, config): (usize, &AxisConfig)| {
            let state = config.lines.scale(sample.inputs);
            Some(FullCycleAxis {
                config: *config,
                gate: gate(config)?,
                only_at_low: design == GateInsertionDesign::Original,
                scale: Decoder::new(state),
                home_counts: origin_counts(n),
                inverters: 0,
                mtc: state,
                mtc_count: 0,
                status: AxisStatus::default(),
                not_believed: 0,
                phase: InsertionPhase::Idle,
                last_inversion: None,
                last_edge: None,
                last_step: 0,
                period_ns: None,
                next_allowed_ns: sample.t_ns,
                look_at_once: true,
            })
        };
        let axes = configs.iter().enumerate().map(|at| axis(at).ok_or(StartError::NoGate(at.0)));
        Ok(Self {
            axes: axes.collect::<Result<_, _>>()?,
            hold: lines.hold,
            look_ns: sample.t_ns,
            look_at_once: true,
            faulted: false,
        })
    }

    /// Takes a new total of an axis, counts.
    ///
    /// # Errors
    /// When the card fails.
    pub fn correct_axis<C: Card>(
        &mut self,
        n: usize,
        total_counts: i64,
        large: bool,
        card: &mut C,
        report: &mut impl EventSink,
    ) -> CardResult {
        let answer = match self.axes.get_mut(n) {
            None => TotalRequestResult::Refused(Refusal::NoSuchAxis),
            _ if self.faulted => TotalRequestResult::Refused(Refusal::FaultLatched),
            Some(axis) => axis.request(total_counts, large),
        };
        self.look_at_once = self.axes.iter().any(|a| a.look_at_once);
        let kind = match answer {
            TotalRequestResult::AcceptedWithWarning => EventKind::Warning { total_counts },
            TotalRequestResult::Refused(why) => EventKind::Refused { total_counts, why },
            TotalRequestResult::Fault(fault) if self.axes[n].status.faults.latch(fault) => {
                EventKind::Fault(fault)
            }
            TotalRequestResult::Accepted | TotalRequestResult::Fault(_) => return Ok(()),
        };
        report(Event { t_ns: self.look_ns, axis: Some(n as u8), kind });
        self.stop_on_fault(card)
    }

    /// Holds the feed from the first fault on.
    fn stop_on_fault<C: Card>(&mut self, card: &mut C) -> CardResult {
        if self.faulted || !self.axes.iter().any(|a| a.status.faults.any()) {
            return Ok(());
        }
        if let Some(bit) = self.hold {
            card.write(1 << bit, 1 << bit)?;
        }
        (self.faulted, self.look_at_once) = (true, true);
        self.axes.iter_mut().for_each(|a| a.look_at_once = true);
        Ok(())
    }

    /// The present status.
    pub fn status(&self) -> CorrectorStatus {
        let mut axes = [AxisStatus::default(); MAX_AXES];
        for (status, axis) in axes.iter_mut().zip(&self.axes) {
            *status = axis.status();
        }
        CorrectorStatus {
            t_ns: self.look_ns,
            mode: if self.faulted { CorrectorMode::Fault } else { CorrectorMode::Run },
            mtc_ready: true,
            enabled: true,
            axes_used: self.axes.len() as u8,
            axes,
            ..CorrectorStatus::default()
        }
    }
}

impl CorrectedAxis for FullCycleCorrector {
    fn poll<C: Card>(&mut self, card: &mut C, by_ns: u64, report: &mut impl EventSink) -> CardResult {
        let due_ns = self.axes.iter().map(FullCycleAxis::due_ns).min().unwrap_or(u64::MAX);
        let wake_ns = if std::mem::replace(&mut self.look_at_once, false) { 0 } else { due_ns };
        let sample = card.sample(wake_ns.min(by_ns))?;
        let since_ns = std::mem::replace(&mut self.look_ns, sample.t_ns);
        let look = PollSample {
            t_ns: sample.t_ns,
            edge_ns: sample.edge_ns.map_or((since_ns, sample.t_ns), |ns| (ns, ns)),
            may_insert: !self.faulted,
        };
        let mut emit = |n: usize, kind| report(Event { t_ns: look.t_ns, axis: Some(n as u8), kind });
        let (mut mask, mut value) = (0, 0);
        for (n, axis) in self.axes.iter_mut().enumerate() {
            let state = axis.config.lines.scale(sample.inputs);
            if let Some(signal) = axis.look(state, &look, &mut |kind| {
                emit(n, kind);
            }) {
                let lines = &axis.config.lines;
                let line = 1_u64 << if signal == Signal::A { lines.invert_a } else { lines.invert_b };
                mask |= line;
                value |= if axis.inverters & signal as u8 == 0 { 0 } else { line };
            }
        }
        if mask != 0 {
            self.look_at_once = true;
            let done_ns = card.write(mask, value)?.unwrap_or(look.t_ns);
            for axis in &mut self.axes {
                let lines = &axis.config.lines;
                if mask & (1 << lines.invert_a | 1 << lines.invert_b) != 0 {
                    axis.written(done_ns);
                }
            }
        }
        self.stop_on_fault(card)
    }

    fn correct<C: Card>(
        &mut self,
        total_counts: i64,
        large: bool,
        card: &mut C,
        report: &mut impl EventSink,
    ) -> CardResult {
        self.correct_axis(0, total_counts, large, card, report)
    }

    fn axis(&self) -> AxisStatus {
        self.axes[0].status()
    }

    fn now_ns(&self) -> u64 {
        self.look_ns
    }
}

impl FullCycleAxis {
    fn pending(&self) -> i64 {
        self.status.requested - self.status.completed
    }

    /// Pairs of the next insertion: two, or one if a left-over pair must be undone.
    fn pairs(&self) -> u8 {
        if self.inverters == 0 { 2 } else { 1 }
    }

    fn ready(&self) -> bool {
        let least = if self.inverters == 0 { INCREMENT_COUNTS } else { INCREMENT_COUNTS / 2 };
        self.pending().abs() >= least && !self.status.faults.any()
    }

    fn may_begin_here(&self) -> bool {
        !self.only_at_low || self.scale.state() == State::default()
    }

    fn request(&mut self, total: i64, large: bool) -> TotalRequestResult {
        let answer = self.config.judge(total, self.status.requested, large, &mut self.not_believed);
        if matches!(answer, TotalRequestResult::Accepted | TotalRequestResult::AcceptedWithWarning) {
            (self.status.requested, self.look_at_once) = (total, false);
        }
        answer
    }

    /// Handles a poll; returns the signal to invert now, if any.
    fn look(
        &mut self,
        state: State,
        look: &PollSample,
        report: &mut impl FnMut(EventKind),
    ) -> Option<Signal> {
        self.look_at_once = false;
        if state != self.scale.state() {
            self.edge(state, look, report);
        }
        self.last_inversion = self.last_inversion.filter(|i| look.edge_ns.1 <= i.done_ns);
        self.act(look, report)
    }

    fn fault(&mut self, fault: Fault, report: &mut impl FnMut(EventKind)) {
        if self.status.faults.latch(fault) {
            report(EventKind::Fault(fault));
        }
    }

    fn edge(&mut self, state: State, look: &PollSample, report: &mut impl FnMut(EventKind)) {
        let before = self.scale.state();
        let step = self.scale.update(state);
        let last = self.last_edge.replace(look.edge_ns);
        self.period_ns = last.map(|(_, last_ns)| look.edge_ns.0.saturating_sub(last_ns));
        if let InsertionPhase::HalfPair { edges, .. } = &mut self.phase {
            *edges += 1;
        }
        let Some(step) = step else {
            (self.last_step, self.mtc) = (0, state.inverted(self.inverters));
            self.fault(Fault::IllegalTransition, report);
            return;
        };
        let turned = self.last_step != 0 && step != self.last_step;
        self.last_step = step;
        self.pass_on(before.signal_to(state), look.edge_ns.1, report);
        if matches!(self.inverters, 1 | 2) {
            self.status.overlaps += 1;
            report(EventKind::Overlap);
        } else if self.mtc_count - self.scale.count() != self.status.completed && !self.status.faults.any() {
            self.fault(Fault::LedgerImbalance, report);
        }
        if matches!(self.phase, InsertionPhase::Idle | InsertionPhase::Opened { .. }) {
            self.phase = InsertionPhase::Idle;
            if self.ready() && look.may_insert {
                if turned {
                    self.status.waited_for_gate += 1;
                } else {
                    self.open(look.edge_ns);
                }
            }
        }
    }

    /// Adds a real edge to the MTC's count, in its true order with the last inversion.
    fn pass_on(&mut self, signal: Signal, edge_ns: u64, report: &mut impl FnMut(EventKind)) {
        let overtaken = self.last_inversion.filter(|i| i.signal != signal && edge_ns <= i.done_ns);
        if let Some(inversion) = overtaken.filter(|i| edge_ns <= i.from_ns) {
            let before = self.mtc.flipped(inversion.signal);
            self.mtc_count -= i64::from(before.step_of(inversion.signal));
            self.mtc_count += i64::from(before.step_of(signal));
            self.mtc_count += i64::from(before.flipped(signal).step_of(inversion.signal));
            self.mtc = self.mtc.flipped(signal);
            if matches!(self.inverters, 0 | 3) {
                self.status.completed = self.mtc_count - self.scale.count();
            }
            return;
        }
        self.mtc_count += i64::from(self.mtc.step_of(signal));
        self.mtc = self.mtc.flipped(signal);
        if overtaken.is_some() {
            self.fault(Fault::OrderUnknown, report);
        }
    }

    /// Opens an insertion after an edge if it can end before the next edge.
    fn open(&mut self, edge: (u64, u64)) {
        if !self.may_begin_here() || edge.1 < self.next_allowed_ns {
            return;
        }
        let period_ns = self.period_ns.unwrap_or(0);
        let quiet_ns = self.gate.quiet_ns(period_ns);
        if period_ns < self.gate.min_period_ns() || quiet_ns < self.gate.need_ns() {
            self.status.waited_for_gate += 1;
            return;
        }
        self.phase = InsertionPhase::Opened {
            add: self.pending() > 0,
            pairs: self.pairs(),
            from_ns: edge.1 + self.config.min_separation_ns,
            until_ns: edge.0 + quiet_ns - busy_ns(&self.config),
        };
    }

    fn act(&mut self, look: &PollSample, report: &mut impl FnMut(EventKind)) -> Option<Signal> {
        if look.t_ns < self.due_ns() {
            return None;
        }
        match self.phase {
            InsertionPhase::Idle => {
                let add = self.pending() > 0;
                look.may_insert.then(|| self.invert_first(add, self.pairs(), look.t_ns))
            }
            InsertionPhase::Opened { add, pairs, until_ns, .. } => {
                self.phase = InsertionPhase::Idle;
                let wanted = look.may_insert && self.ready() && (self.pending() > 0) == add;
                if wanted && look.t_ns <= until_ns {
                    return Some(self.invert_first(add, pairs, look.t_ns));
                }
                if wanted {
                    self.status.late += 1;
                    report(EventKind::Late);
                }
                None
            }
            InsertionPhase::HalfPair { add, pairs, edges, .. } => {
                Some(self.invert_second(add, pairs, edges > 0, look.t_ns, report))
            }
            InsertionPhase::BetweenPairs { add, pairs, .. } => Some(self.invert_first(add, pairs, look.t_ns)),
        }
    }

    /// The first inversion of a pair (NISTIR 4832: A = B and adding inverts A first).
    fn invert_first(&mut self, add: bool, pairs: u8, t_ns: u64) -> Signal {
        self.phase = InsertionPhase::HalfPair { add, pairs, effective_ns: t_ns, edges: 0 };
        self.invert(self.mtc.signal_towards(add), t_ns)
    }

    /// Makes the second inversion.
    /// It chooses the signal that brings the MTC's count to its goal, or else back.
    fn invert_second(
        &mut self,
        add: bool,
        pairs: u8,
        overlapped: bool,
        t_ns: u64,
        report: &mut impl FnMut(EventKind),
    ) -> Signal {
        let wanted = self.status.completed + if add { 2 } else { -2 };
        let offset = self.mtc_count - self.scale.count();
        let mut signal = self.mtc.signal_towards(add);
        let step = if add { 1 } else { -1 };
        let [ahead, aback] = [offset + step, offset - step].map(|o| o.abs_diff(wanted));
        if aback < ahead || aback == ahead && signal == Signal::B {
            signal = signal.other();
        }
        self.invert(signal, t_ns);
        let offset = self.mtc_count - self.scale.count();
        self.status.completed = if overlapped { offset } else { wanted };
        if offset != self.status.completed {
            self.fault(Fault::LedgerImbalance, report);
        }
        if pairs > 1 {
            self.phase = InsertionPhase::BetweenPairs { add, pairs: pairs - 1, effective_ns: t_ns };
        } else {
            self.phase = InsertionPhase::Idle;
            self.status.insertions += 1;
            let interval_ns = INCREMENT_COUNTS as f64 / self.config.max_rate_counts_s * 1e9;
            self.next_allowed_ns = t_ns + interval_ns as u64;
        }
        signal
    }

    fn invert(&mut self, signal: Signal, t_ns: u64) -> Signal {
        self.mtc_count += i64::from(self.mtc.step_of(signal));
        self.mtc = self.mtc.flipped(signal);
        self.inverters ^= signal as u8;
        self.last_inversion = Some(LastInversion { signal, from_ns: t_ns, done_ns: t_ns });
        signal
    }

    /// Notes that the card confirmed the last write at `at_ns`.
    fn written(&mut self, at_ns: u64) {
        if let Some(inversion) = &mut self.last_inversion {
            inversion.done_ns = at_ns;
        }
        if let InsertionPhase::HalfPair { effective_ns, .. }
        | InsertionPhase::BetweenPairs { effective_ns, .. } = &mut self.phase
        {
            *effective_ns = at_ns;
        }
    }

    /// Time at which the insertion continues, or one begins at rest, ns.
    fn due_ns(&self) -> u64 {
        match self.phase {
            InsertionPhase::Idle => match self.config.rest {
                InsertionAtRestPolicy::Insert { after_ns } if self.ready() && self.may_begin_here() => {
                    self.last_edge.map_or(0, |(_, t)| t).max(self.next_allowed_ns) + after_ns
                }
                _ => u64::MAX,
            },
            InsertionPhase::Opened { from_ns, .. } => from_ns,
            // Two real edges inside: the axis is too fast for a separation, and the MTC counts mirrored.
            InsertionPhase::HalfPair { edges: 2.., .. } => 0,
            InsertionPhase::HalfPair { effective_ns, .. }
            | InsertionPhase::BetweenPairs { effective_ns, .. } => {
                let last_out = self.last_edge.map_or(effective_ns, |(_, edge)| edge.max(effective_ns));
                last_out + self.config.min_separation_ns
            }
        }
    }

    fn status(&self) -> AxisStatus {
        let faulted = self.status.faults.any();
        AxisStatus {
            position_counts: self.home_counts + self.scale.count(),
            mtc_minus_scale: self.mtc_count - self.scale.count(),
            in_effect: self.status.completed,
            inverted: self.inverters == 3,
            homed: !faulted,
            mtc_known: !faulted,
            gate: if faulted { InsertionStatus::Fault } else { InsertionStatus::WaitingForEdge },
            illegal: self.scale.illegal(),
            ..self.status
        }
    }
}
