//! Design B (NISTIR 4832): A and B pass through the computer.
//! The computer may add or leave out single counts on the way.
//!
//! A' and B' are driven, not gated: the state for scale count n and total c is that of count n + c. Real
//! edges and inserted steps are sent one after another, each with the MTC's separation before it. Edges that
//! the computer sees too late are lost. When the computer stops, the MTC sees an axis at rest.

use crate::corrected_axis::{CardResult, CorrectedAxis, EventSink};
use rtec_driver::card::{Card, CardError};
use rtec_driver::quadrature::{Decoder, State};
use rtec_rt::axis::{AxisConfig, InsertionAtRestPolicy};
use rtec_rt::link_messages::{AxisStatus, Event, EventKind, Fault, InsertionStatus, Refusal};
use rtec_rt::speed_gate::{SpeedGate, SpeedGateConfig};

/// One axis whose signals pass through the computer, homed to zero at its position.
#[derive(Debug)]
pub struct PassThroughDesignB {
    config: AxisConfig,
    gate: SpeedGate,
    scale: Decoder,
    /// State of A' and B' and its count.
    out: Decoder,
    /// Totals, figures and faults; [`PassThroughDesignB::axis`] adds the rest.
    status: AxisStatus,
    look_ns: u64,
    last_edge_ns: Option<u64>,
    period_ns: u64,
    /// Time until which a step may begin after the last edge, ns.
    open_until_ns: Option<u64>,
    /// Time before which A' and B' may not change again, ns.
    free_ns: u64,
    /// Time before which no insertion may begin (rate limit), ns.
    next_allowed_ns: u64,
}

impl PassThroughDesignB {
    /// Takes over the card in its present state.
    /// `None` if the configuration leaves no time for a step at any speed.
    ///
    /// # Errors
    /// When the card cannot be read or written.
    pub fn new<C: Card>(config: AxisConfig, card: &mut C) -> Result<Option<Self>, CardError> {
        let Some(gate) = Self::gate(&config) else { return Ok(None) };
        let sample = card.sample(0)?;
        let state = config.lines.scale(sample.inputs);
        let mut through = Self {
            config,
            gate,
            scale: Decoder::new(state),
            out: Decoder::new(state),
            status: AxisStatus::default(),
            look_ns: sample.t_ns,
            last_edge_ns: None,
            period_ns: 0,
            open_until_ns: None,
            free_ns: sample.t_ns,
            next_allowed_ns: sample.t_ns,
        };
        through.drive(state, card)?;
        Ok(Some(through))
    }

    /// The speed gate: time for edge, separation, step and its separation.
    pub fn gate(config: &AxisConfig) -> Option<SpeedGate> {
        let step_ns = config.write_ns + config.min_separation_ns;
        SpeedGate::new(SpeedGateConfig {
            max_accel_counts_s2: config.max_accel_counts_s2,
            hysteresis_counts: config.hysteresis_counts,
            need_ns: (config.detect_ns + 2 * step_ns + config.guard_ns).max(1),
        })
    }

    fn drive<C: Card>(&mut self, state: State, card: &mut C) -> CardResult {
        let lines = &self.config.lines;
        let mask = 1 << lines.invert_a | 1 << lines.invert_b;
        let value = u64::from(state.a()) << lines.invert_a | u64::from(state.b()) << lines.invert_b;
        let done_ns = card.write(mask, value)?;
        self.out.update(state);
        self.free_ns = done_ns.unwrap_or(self.look_ns) + self.config.min_separation_ns;
        Ok(())
    }

    fn fault(&mut self, fault: Fault, report: &mut impl EventSink) {
        if self.status.faults.latch(fault) {
            report(Event { t_ns: self.look_ns, axis: Some(0), kind: EventKind::Fault(fault) });
        }
    }

    /// The count that the MTC should have: scale count plus total.
    fn expected_mtc_count(&self) -> i64 {
        self.scale.count() + self.status.completed
    }

    /// Latest time at which a step may begin after an edge.
    /// The step must be done before the next edge can come.
    fn latest_step_start_ns(&mut self, edge_ns: u64) -> Option<u64> {
        let quiet_ns = self.gate.quiet_ns(self.period_ns);
        if self.period_ns >= self.gate.min_period_ns() && quiet_ns >= self.gate.need_ns() {
            return Some(edge_ns + quiet_ns - self.config.write_ns - self.config.min_separation_ns);
        }
        self.status.waited_for_gate += u64::from(self.pending());
        None
    }

    fn pending(&self) -> bool {
        self.status.requested != self.status.completed && !self.status.faults.any()
    }

    /// Whether a step may be inserted now, with all edges passed on.
    fn due_now(&self) -> bool {
        let quiet_since = self.last_edge_ns.unwrap_or(0).max(self.next_allowed_ns);
        let rests = match self.config.rest {
            InsertionAtRestPolicy::Insert { after_ns } => self.look_ns >= quiet_since + after_ns,
            InsertionAtRestPolicy::Wait => false,
        };
        let open =
            self.look_ns >= self.next_allowed_ns && self.open_until_ns.is_some_and(|t| self.look_ns <= t);
        self.pending()
            && self.out.count() == self.expected_mtc_count()
            && self.look_ns >= self.free_ns
            && (open || rests)
    }
}

impl CorrectedAxis for PassThroughDesignB {
    fn poll<C: Card>(&mut self, card: &mut C, by_ns: u64, report: &mut impl EventSink) -> CardResult {
        let waits = self.out.count() == self.expected_mtc_count()
            && !(self.pending() && self.open_until_ns.is_some());
        let mut wake_ns = if waits { u64::MAX } else { self.free_ns };
        if let InsertionAtRestPolicy::Insert { after_ns } = self.config.rest
            && self.pending()
        {
            wake_ns = wake_ns.min(self.last_edge_ns.unwrap_or(0).max(self.next_allowed_ns) + after_ns);
        }
        let sample = card.sample(wake_ns.min(by_ns))?;
        self.look_ns = sample.t_ns;
        let state = self.config.lines.scale(sample.inputs);
        if state != self.scale.state() {
            let edge_ns = sample.edge_ns.unwrap_or(sample.t_ns);
            self.period_ns = self.last_edge_ns.map_or(0, |last| edge_ns - last);
            self.last_edge_ns = Some(edge_ns);
            if self.scale.update(state).is_none() {
                self.fault(Fault::IllegalTransition, report);
            }
            self.open_until_ns = self.latest_step_start_ns(edge_ns);
        }
        self.open_until_ns = self.open_until_ns.filter(|&t| self.look_ns <= t);
        if self.due_now() {
            self.open_until_ns = None;
            self.status.completed += (self.status.requested - self.status.completed).signum();
            self.status.insertions += 1;
            self.next_allowed_ns = self.look_ns + (1e9 / self.config.max_rate_counts_s) as u64;
        }
        // One count at a time, never two signals at once.
        if self.out.count() != self.expected_mtc_count() && self.look_ns >= self.free_ns {
            let next = self.out.state().next(self.expected_mtc_count() > self.out.count());
            self.drive(next, card)?;
        }
        Ok(())
    }

    fn correct<C: Card>(
        &mut self,
        total_counts: i64,
        _large: bool,
        _card: &mut C,
        report: &mut impl EventSink,
    ) -> CardResult {
        if total_counts.unsigned_abs() > self.config.max_correction_counts.unsigned_abs() {
            let kind = EventKind::Refused { total_counts, why: Refusal::AboveMaximum };
            report(Event { t_ns: self.look_ns, axis: Some(0), kind });
        } else {
            self.status.requested = total_counts;
        }
        Ok(())
    }

    fn axis(&self) -> AxisStatus {
        AxisStatus {
            position_counts: self.scale.count(),
            mtc_minus_scale: self.out.count() - self.scale.count(),
            in_effect: self.status.completed,
            homed: !self.status.faults.any(),
            gate: if self.status.faults.any() {
                InsertionStatus::Fault
            } else {
                InsertionStatus::WaitingForEdge
            },
            illegal: self.scale.illegal(),
            ..self.status
        }
    }

    fn now_ns(&self) -> u64 {
        self.look_ns
    }
}
