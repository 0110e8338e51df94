//! The Error Correction Circuit of CMTI (2014).
//! It subtracts pulses by blocking them. It adds pulses by splitting each into two with a phase-locked loop (PLL)
//! that doubles their frequency.
//!
//! | block of the paper | here |
//! |---|---|
//! | pulse subtraction (fig. 2): counter, comparator, AND gates | A' = B' = low until as many pulses of A have passed |
//! | XOR of A and B, PLL frequency doubler (fig. 4), 90° phase shifter (fig. 5) | ticks of a VCO, two for each count of the scale |
//! | pulse pre-conditioning (fig. 6) | both begin and end at A = B = low |
//! | direction detector and corrector (fig. 7) | the last count's direction decides which way a tick counts |
//! | full adder, counter, comparator | after twice the compensation value in pulses the encoder's own are passed again |
//! | acknowledgement, 4-bit value | the controller requests at most 15 pulses at a time and books them when acknowledged |
//! | X/Z, S1, S0 (table 1), ACK | [`EccControlLines`]; two circuits behind one controller: the papers' `ecc_board` |
//!
//! The PLL is a behavioural model of the paper's measurements, not of its parts.

use crate::corrected_axis::{CardResult, CorrectedAxis, EventSink};
use crate::noise::NoiseGenerator;
use rtec_driver::card::{AxisLines, Card, CardError};
use rtec_driver::quadrature::{Decoder, State};
use rtec_rt::link_messages::{AxisStatus, Event, EventKind, Refusal};
use serde::{Deserialize, Serialize};

/// The paper's measurements of its PLL.
/// Frequencies are of the XOR of A and B, which is twice the encoder's.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PllFrequencyLimits {
    /// Lowest input frequency at which the PLL doubles at all, Hz.
    pub lock_from_hz: f64,
    /// Lowest input frequency at which it doubles cleanly, Hz.
    pub clean_from_hz: f64,
    /// Highest input frequency at which it doubles cleanly, Hz.
    pub clean_to_hz: f64,
    /// Highest input frequency at which it doubles at all, Hz.
    pub lock_to_hz: f64,
    /// Time constant with which the VCO follows a changing input, ns.
    pub follow_ns: f64,
}

impl Default for PllFrequencyLimits {
    /// CMTI (2014), section 2.2.2.
    /// The time constant is that of the loop's natural frequency, 2 kHz with the parts given there (R3 = 360 Ω, R4 =
    /// 100 Ω, C2 = 1 µF, 5 V, 320 kHz).
    fn default() -> Self {
        Self {
            lock_from_hz: 700.0,
            clean_from_hz: 2300.0,
            clean_to_hz: 125_000.0,
            lock_to_hz: 160_000.0,
            follow_ns: 76_000.0,
        }
    }
}

/// Its ranges in words: the command's warning and the guide have them from here.
impl std::fmt::Display for PllFrequencyLimits {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [lock, to, clean, clean_to] =
            [self.lock_from_hz, self.lock_to_hz, self.clean_from_hz, self.clean_to_hz].map(|hz| hz / 1e3);
        write!(f, "doubles from {lock} to {to} kHz of A XOR B, cleanly from {clean} to {clean_to} kHz")
    }
}

/// Duration of the acknowledgement, ns: "a short duration pulse".
/// The paper gives no figure (CMTI 2014, section 2.3).
pub const ACK_NS: u64 = 1000;

/// The lines between embedded controller and circuit (CMTI 2014, section 2).
#[allow(clippy::struct_excessive_bools, reason = "each is a wire")]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct EccControlLines {
    /// X/Z: whether the controller addresses this axis.
    pub selected: bool,
    /// Whether a compensation is requested.
    pub s1: bool,
    /// Whether pulses are added; otherwise they are subtracted.
    pub s0: bool,
    /// The compensation value, pulses; four bits.
    pub value: u8,
    /// The circuit's acknowledgement that the compensation is over.
    pub ack: bool,
}

/// The largest compensation value, pulses (CMTI 2014, section 2.2.7: four bits).
pub const MAX_PULSES: i64 = 15;

/// Largest error of the ticks of a loop that does not double cleanly.
/// It is a share of their spacing. The paper gives no figure.
const UNCLEAN: f64 = 0.45;

/// Error: a compensation value of more bits than the circuit has lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "found a compensation value of {0} pulses, expected 0 to {MAX_PULSES}: it has four bits (CMTI 2014, section 2.2.7); ask for the \
     rest after the acknowledgement"
)]
pub struct PulseCountTooLarge(pub u8);

/// What the circuit sends to the MTC.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum CircuitOutputToMtc {
    Encoder,
    /// Blocking: pulses of A still to be blocked.
    Blocked {
        left: i64,
    },
    /// Splitting: counts still to be sent.
    Split {
        left: i64,
    },
}

/// One axis with the circuit in its feedback, and with its embedded controller.
#[derive(Debug)]
pub struct ErrorCorrectionCircuitAxis {
    pll: PllFrequencyLimits,
    lines: AxisLines,
    scale: Decoder,
    out: Decoder,
    passing: CircuitOutputToMtc,
    /// The compensation under way, pulses with sign.
    asked: i64,
    /// Totals and figures; [`ErrorCorrectionCircuitAxis::axis`] adds the rest.
    status: AxisStatus,
    look_ns: u64,
    last_edge_ns: Option<u64>,
    /// Output of the direction detector: whether the motion is positive.
    positive: bool,
    /// Time between two scale counts at the VCO's frequency, ns.
    vco_ns: f64,
    input_hz: f64,
    tick_ns: Option<u64>,
    /// Whether the tick between the last scale edge and the next has been sent.
    half_sent: bool,
    /// Ticks that the VCO still has to send, while it is slower than its input.
    ticks_pending: u64,
    last_tick_ns: u64,
    noise: NoiseGenerator,
    worst_phase_deg: f64,
    begun_ns: u64,
    /// Shortest and longest time per pulse, ns.
    pulse_ns: Option<(u64, u64)>,
    /// Present state of the controller's lines, and every change of them.
    control: EccControlLines,
    lines_log: Vec<(u64, EccControlLines)>,
    /// Whether S1, S0 and the value are set by hand instead of by totals.
    by_hand: bool,
    /// Acceleration that the controller allows for, counts/s².
    /// It requests only if the axis can neither leave the PLL's clean range nor reverse before the
    /// compensation is over.
    accel_counts_s2: Option<f64>,
}

impl ErrorCorrectionCircuitAxis {
    /// Takes over a card without gates: its output lines are A' and B'.
    ///
    /// # Errors
    /// When the card cannot be read or written.
    pub fn new<C: Card>(pll: PllFrequencyLimits, seed: u64, card: &mut C) -> Result<Self, CardError> {
        let lines = AxisLines::standard(0, false);
        let sample = card.sample(0)?;
        let state = lines.scale(sample.inputs);
        let mut ecc = Self {
            pll,
            lines,
            scale: Decoder::new(state),
            out: Decoder::new(state),
            passing: CircuitOutputToMtc::Encoder,
            asked: 0,
            status: AxisStatus::default(),
            look_ns: sample.t_ns,
            last_edge_ns: None,
            positive: true,
            vco_ns: 0.5e9 / pll.lock_from_hz,
            input_hz: 0.0,
            tick_ns: None,
            half_sent: false,
            ticks_pending: 0,
            last_tick_ns: 0,
            noise: NoiseGenerator::new(seed, 0xECC),
            worst_phase_deg: 0.0,
            begun_ns: 0,
            pulse_ns: None,
            control: EccControlLines { selected: true, ..EccControlLines::default() },
            lines_log: Vec::new(),
            by_hand: false,
            accel_counts_s2: None,
        };
        ecc.send(state, card)?;
        Ok(ecc)
    }

    /// Adds a controller that requests only compensations sure to end well.
    /// The axis must never accelerate by more than this, counts/s². The paper's circuit miscounts when its
    /// PLL loses lock or the axis reverses in the middle.
    #[must_use]
    pub fn guarded(mut self, accel_counts_s2: f64) -> Self {
        self.accel_counts_s2 = Some(accel_counts_s2.max(1.0));
        self
    }

    /// Sets the controller's lines by hand; from then on totals request nothing.
    /// The acknowledgement clears S1.
    ///
    /// # Errors
    /// A value of more than four bits.
    pub fn set_lines(&mut self, s1: bool, s0: bool, value: u8) -> Result<(), PulseCountTooLarge> {
        if i64::from(value) > MAX_PULSES {
            return Err(PulseCountTooLarge(value));
        }
        self.by_hand = true;
        self.set_control_lines(self.look_ns, EccControlLines { s1, s0, value, ..self.control });
        Ok(())
    }

    /// Sets X/Z: whether the controller addresses this axis.
    /// Compensations begin only on a selected axis.
    pub fn select(&mut self, selected: bool) {
        self.set_control_lines(self.look_ns, EccControlLines { selected, ..self.control });
    }

    /// Every change of the controller's lines and of the acknowledgement.
    /// Each has its time (ns) and the new state.
    pub fn lines_log(&self) -> &[(u64, EccControlLines)] {
        &self.lines_log
    }

    fn set_control_lines(&mut self, t_ns: u64, to: EccControlLines) {
        if to != self.control {
            self.control = to;
            self.lines_log.push((t_ns, to));
        }
    }

    /// Number of acknowledgements, that is of completed compensations.
    pub fn acknowledged(&self) -> u64 {
        self.status.insertions
    }

    /// Largest deviation from 90° between two edges of a split pulse, degrees of phase.
    /// At 180° the edges have changed places; larger values are not phases.
    pub fn worst_phase_deg(&self) -> f64 {
        self.worst_phase_deg
    }

    fn send<C: Card>(&mut self, state: State, card: &mut C) -> CardResult {
        let lines = &self.lines;
        let mask = 1 << lines.invert_a | 1 << lines.invert_b;
        card.write(mask, u64::from(state.a()) << lines.invert_a | u64::from(state.b()) << lines.invert_b)?;
        self.out.update(state);
        Ok(())
    }

    /// Handles a tick of the phase shifter: one count in the encoder's direction.
    fn tick<C: Card>(&mut self, card: &mut C) -> CardResult {
        if let CircuitOutputToMtc::Split { left } = &mut self.passing {
            *left -= 1;
            let done = *left == 0;
            self.last_tick_ns = self.look_ns;
            let next = self.out.state().next(self.positive);
            self.send(next, card)?;
            if done {
                self.acknowledge(card)?;
            }
        }
        Ok(())
    }

    /// Sends one of the ticks due, never two at the same instant.
    /// The others follow as fast as the VCO can.
    fn catch_up<C: Card>(&mut self, edge_ns: u64, card: &mut C) -> CardResult {
        self.ticks_pending -= 1;
        self.tick(card)?;
        if matches!(self.passing, CircuitOutputToMtc::Split { .. }) {
            if self.ticks_pending > 0 {
                (self.tick_ns, self.half_sent) = (Some(self.look_ns + self.fastest_ns()), false);
            } else {
                self.schedule_half(edge_ns);
            }
        }
        Ok(())
    }

    /// Switches the multiplexer back to the encoder.
    /// The controller books its request as completed in any case.
    fn acknowledge<C: Card>(&mut self, card: &mut C) -> CardResult {
        self.passing = CircuitOutputToMtc::Encoder;
        (self.tick_ns, self.ticks_pending) = (None, 0);
        self.status.completed += 4 * self.asked;
        let took = (self.look_ns - self.begun_ns) / self.asked.unsigned_abs().max(1);
        self.pulse_ns = Some(self.pulse_ns.map_or((took, took), |(lo, hi)| (lo.min(took), hi.max(took))));
        self.asked = 0;
        self.status.insertions += 1;
        // The controller clears S1 when it sees the pulse.
        self.set_control_lines(self.look_ns, EccControlLines { ack: true, ..self.control });
        let off = EccControlLines { s1: false, s0: false, value: 0, ack: false, ..self.control };
        self.set_control_lines(self.look_ns + ACK_NS, off);
        if self.out.state() != self.scale.state() {
            let state = self.scale.state();
            self.send(state, card)?;
        }
        Ok(())
    }

    fn in_range(&self, from: f64, to: f64) -> bool {
        (from..=to).contains(&self.input_hz)
    }

    /// Schedules the tick between two scale edges: halfway if the loop locks cleanly.
    fn schedule_half(&mut self, edge_ns: u64) {
        let clean = self.in_range(self.pll.clean_from_hz, self.pll.clean_to_hz);
        let shift = if clean { 0.0 } else { UNCLEAN * (2.0 * self.noise.uniform() - 1.0) };
        let half_ns = self.vco_ns * 0.5 * (1.0 + shift);
        // Two edges per count of the input are 90° apart, half of its period.
        let off = half_ns / (0.25e9 / self.input_hz) - 1.0;
        self.worst_phase_deg = self.worst_phase_deg.max((90.0 * off.abs()).min(180.0));
        self.tick_ns = Some((edge_ns + half_ns as u64).max(self.look_ns + self.fastest_ns()));
        self.half_sent = false;
    }

    /// Time between two ticks of the VCO at its highest frequency, ns.
    fn fastest_ns(&self) -> u64 {
        (0.25e9 / self.pll.lock_to_hz) as u64
    }

    /// Time between two ticks of an unlocked VCO, at one end of its range, ns.
    fn free_ns(&self) -> u64 {
        let limit =
            if self.input_hz > self.pll.lock_to_hz { self.pll.lock_to_hz } else { self.pll.lock_from_hz };
        (0.25e9 / limit) as u64
    }

    fn edge<C: Card>(&mut self, state: State, edge_ns: u64, card: &mut C) -> CardResult {
        let before = self.scale.state();
        let Some(step) = self.scale.update(state) else { return self.send(state, card) };
        let period_ns = self.last_edge_ns.map_or(f64::INFINITY, |last| (edge_ns - last).max(1) as f64);
        self.last_edge_ns = Some(edge_ns);
        self.positive = step > 0;
        self.input_hz = 0.5e9 / period_ns;
        let locked = self.in_range(self.pll.lock_from_hz, self.pll.lock_to_hz);
        let limits = [0.5e9 / self.pll.lock_to_hz, 0.5e9 / self.pll.lock_from_hz];
        let target = period_ns.clamp(limits[0], limits[1]);
        self.vco_ns += (target - self.vco_ns) * (1.0 - libm::exp(-target / self.pll.follow_ns));
        match &mut self.passing {
            CircuitOutputToMtc::Encoder => self.send(state, card)?,
            CircuitOutputToMtc::Blocked { left } => {
                // The counter counts rising edges of A in either direction of motion.
                *left -= i64::from(state.a() && !before.a());
                if *left <= 0 && state == State::default() {
                    self.acknowledge(card)?;
                }
                return Ok(());
            }
            CircuitOutputToMtc::Split { .. } if locked => {
                // Phase lock gives two ticks per count: this one, and the one before if it is still due.
                self.ticks_pending += 1 + u64::from(!self.half_sent);
                let soonest_ns = self.last_tick_ns + self.fastest_ns();
                if edge_ns < soonest_ns {
                    (self.tick_ns, self.half_sent) = (Some(soonest_ns), false);
                    return Ok(());
                }
                return self.catch_up(edge_ns, card);
            }
            CircuitOutputToMtc::Split { .. } => {
                self.tick_ns.get_or_insert(edge_ns + 1);
                return Ok(());
            }
        }
        self.begin(state, edge_ns);
        Ok(())
    }

    /// Number of pulses that end before the axis can reverse.
    /// With `adds`, also before the PLL can leave its clean range. Outside the lock range none are added,
    /// because the VCO would run free and the number could not be kept. None are added before the loop has
    /// followed a motion that just began.
    fn sure_pulses(&self, adds: bool) -> i64 {
        let followed = (self.vco_ns * self.input_hz / 0.5e9 - 1.0).abs() <= UNCLEAN;
        if adds && !(followed && self.in_range(self.pll.lock_from_hz, self.pll.lock_to_hz)) {
            return 0;
        }
        let Some(a) = self.accel_counts_s2 else { return MAX_PULSES };
        // The XOR of A and B has one cycle per two counts.
        let rate = |xor_hz: f64| 2.0 * xor_hz;
        let v = rate(self.input_hz);
        let slowest = if adds { rate(self.pll.clean_from_hz) } else { 0.0 };
        let fastest = if adds { rate(self.pll.clean_to_hz) } else { f64::INFINITY };
        let travel = ((v * v - slowest * slowest).min(fastest * fastest - v * v) / (2.0 * a)).max(0.0);
        // A pulse is four counts, and two more until its last edge is out.
        ((travel - 2.0) / 4.0).clamp(0.0, MAX_PULSES as f64) as i64
    }

    /// Begins the controller's next request, which is possible only at A = B = low.
    fn begin(&mut self, state: State, edge_ns: u64) {
        if state != State::default() || !self.control.selected {
            return;
        }
        let sign = if self.positive { 1 } else { -1 };
        let pulses = if self.by_hand {
            let EccControlLines { s1, s0, value, .. } = self.control;
            i64::from(s1) * i64::from(value) * if s0 { sign } else { -sign }
        } else {
            ((self.status.requested - self.status.completed) / 4).clamp(-MAX_PULSES, MAX_PULSES)
        };
        // More counts in the direction of motion are added pulses; fewer are blocked ones.
        let adds = pulses * sign > 0;
        // Lines set by hand act directly on the circuit, without a guard.
        let sure =
            if pulses == 0 || self.by_hand { pulses.abs() } else { self.sure_pulses(adds).min(pulses.abs()) };
        self.status.waited_for_gate += u64::from(sure < pulses.abs());
        if sure == 0 {
            return;
        }
        let pulses = sure * pulses.signum();
        self.asked = pulses;
        self.begun_ns = edge_ns;
        let value = pulses.unsigned_abs() as u8;
        self.set_control_lines(edge_ns, EccControlLines { s1: true, s0: adds, value, ..self.control });
        if adds {
            self.passing = CircuitOutputToMtc::Split { left: 8 * pulses.abs() };
            self.schedule_half(edge_ns);
        } else {
            self.passing = CircuitOutputToMtc::Blocked { left: pulses.abs() };
        }
    }
}

impl CorrectedAxis for ErrorCorrectionCircuitAxis {
    fn poll<C: Card>(&mut self, card: &mut C, by_ns: u64, _report: &mut impl EventSink) -> CardResult {
        let splitting = matches!(self.passing, CircuitOutputToMtc::Split { .. });
        // If the input falls below the lock range, the VCO runs at its lowest frequency.
        let loses_ns = self.last_edge_ns.map_or(u64::MAX, |t| t + (0.5e9 / self.pll.lock_from_hz) as u64);
        let mut wake_ns = if splitting { self.tick_ns.unwrap_or(loses_ns) } else { u64::MAX };
        wake_ns = wake_ns.max(self.look_ns);
        let sample = card.sample(wake_ns.min(by_ns))?;
        self.look_ns = sample.t_ns;
        let state = self.lines.scale(sample.inputs);
        if state != self.scale.state() {
            return self.edge(state, sample.edge_ns.unwrap_or(sample.t_ns), card);
        }
        if splitting && self.look_ns >= wake_ns {
            if self.ticks_pending > 0 {
                return self.catch_up(self.last_edge_ns.unwrap_or(self.look_ns), card);
            }
            self.tick(card)?;
            self.half_sent = true;
            let locked = self.in_range(self.pll.lock_from_hz, self.pll.lock_to_hz) && self.look_ns < loses_ns;
            self.tick_ns = if !matches!(self.passing, CircuitOutputToMtc::Split { .. }) {
                None
            } else if locked {
                Some(loses_ns)
            } else {
                Some(self.look_ns + self.free_ns())
            };
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
        if total_counts.abs() > 1000 {
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
            homed: true,
            illegal: self.scale.illegal(),
            ..self.status
        }
    }

    fn now_ns(&self) -> u64 {
        self.look_ns
    }

    fn split_pulses(&self) -> (f64, Option<(u64, u64)>) {
        (self.worst_phase_deg, self.pulse_ns)
    }
}
