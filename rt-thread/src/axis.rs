//! One axis between two edges: insertion, ledger, belief, homing, probe capture.

use crate::link_messages::{AxisStatus, EventKind, Fault, FaultSet, InsertionStatus, ProbeCapture, Refusal};
use crate::speed_gate::{SpeedGate, SpeedGateConfig};
use rtec_driver::card::{AxisLines, CardInputSample};
use rtec_driver::quadrature::{Decoder, Signal, State};

/// Counts of one insertion: two inversions, each one count (NISTIR 4832, Design C).
pub const INCREMENT_COUNTS: i64 = 2;

/// Insertion at rest, where no edge opens the gate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum InsertionAtRestPolicy {
    /// Wait for the next edge (NISTIR 4832).
    #[default]
    Wait,
    /// Insert after this long without an edge, ns.
    /// No gate can exclude an edge at rest. The engine works out an edge that falls inside the insertion.
    Insert {
        /// The quiet time, ns.
        after_ns: u64,
    },
}

/// Configuration of one axis, fixed before the engine starts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisConfig {
    /// Input and output lines of the axis.
    pub lines: AxisLines,
    /// Largest correction, counts; a request beyond it is refused.
    pub max_correction_counts: i64,
    /// Largest change of a request that is believed at once, counts.
    pub window_counts: i64,
    /// A request of this size gives a warning, counts.
    pub warn_counts: i64,
    /// A request of this size latches a fault and holds the machine, counts.
    pub error_counts: i64,
    /// Fastest change of the correction, counts/s.
    pub max_rate_counts_s: f64,
    /// Shortest separation of two edges that the MTC's decoder accepts, ns.
    pub min_separation_ns: u64,
    /// The axis's acceleration limit, counts/s².
    pub max_accel_counts_s2: f64,
    /// The scale's hysteresis on reversal, counts.
    pub hysteresis_counts: f64,
    /// Insertion at rest.
    pub rest: InsertionAtRestPolicy,
    /// The longest time from an edge until the engine acts on it, ns.
    /// It is measured on this machine (the tail of the self-test).
    pub detect_ns: u64,
    /// The longest time until a write is in effect, ns.
    /// A card that does not report this needs a look to confirm the write, so the time includes that look. On a
    /// polled card it is up to two gaps between looks.
    pub write_ns: u64,
    /// Reserve on top of the other times, ns.
    pub guard_ns: u64,
}

impl Default for AxisConfig {
    /// The axis of a replay, with an ideal computer.
    /// It has 500 ns separation, 1e6 counts/s², ±1000 counts and no belief window.
    fn default() -> Self {
        Self {
            lines: AxisLines::standard(0, false),
            max_correction_counts: 1000,
            window_counts: i64::MAX,
            warn_counts: i64::MAX,
            error_counts: i64::MAX,
            max_rate_counts_s: f64::INFINITY,
            min_separation_ns: 500,
            max_accel_counts_s2: 1e6,
            hysteresis_counts: 0.05,
            rest: InsertionAtRestPolicy::Wait,
            detect_ns: 0,
            write_ns: 0,
            guard_ns: 0,
        }
    }
}

impl AxisConfig {
    /// Time from writing the first inversion until the MTC can take a real edge, ns.
    fn busy_ns(&self) -> u64 {
        INCREMENT_COUNTS as u64 * (self.write_ns + self.min_separation_ns) + self.guard_ns
    }

    /// The axis's speed gate.
    /// `None` where its limits leave no time for an insertion at any speed.
    ///
    /// Time needed: detection + the MTC's separation after the edge + the inversions, each with its write and the
    /// separation behind it + guard.
    pub fn gate(&self) -> Option<SpeedGate> {
        SpeedGate::new(SpeedGateConfig {
            max_accel_counts_s2: self.max_accel_counts_s2,
            hysteresis_counts: self.hysteresis_counts,
            need_ns: (self.detect_ns + self.min_separation_ns + self.busy_ns()).max(1),
        })
    }

    /// Judges a new total after `requested`, counts.
    /// `large` flags one that may lie outside the belief window.
    ///
    /// A total outside the window is not believed once. Two more readings may come back into range, then it is a fault
    /// (NISTIR 4832, General Considerations: "I Don't Believe You", "I Still Don't Believe You").
    pub const fn judge(
        &self,
        total: i64,
        requested: i64,
        large: bool,
        not_believed: &mut u8,
    ) -> TotalRequestResult {
        if total.unsigned_abs() > self.max_correction_counts.unsigned_abs() {
            return TotalRequestResult::Refused(Refusal::AboveMaximum);
        }
        if total.unsigned_abs() >= self.error_counts.unsigned_abs() {
            return TotalRequestResult::Fault(Fault::ErrorLimit);
        }
        if !large && total.abs_diff(requested) > self.window_counts.unsigned_abs() {
            *not_believed += 1;
            return if *not_believed > 2 {
                TotalRequestResult::Fault(Fault::StillNotBelieved)
            } else {
                TotalRequestResult::Refused(Refusal::NotBelieved)
            };
        }
        *not_believed = 0;
        if total.unsigned_abs() >= self.warn_counts.unsigned_abs() {
            TotalRequestResult::AcceptedWithWarning
        } else {
            TotalRequestResult::Accepted
        }
    }
}

/// State of an insertion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum InsertionState {
    /// None under way; both inverters are equal.
    Idle,
    /// An edge has opened the gate.
    /// The insertion begins at `from_ns`, after the MTC's separation from that edge. After `until_ns` another edge can
    /// come, so the insertion is given up before its first inversion.
    Opened { add: bool, from_ns: u64, until_ns: u64 },
    /// The first inversion is written; until the second is, the MTC counts mirrored.
    /// It is known to be in effect from `effective_ns` on, once the card or the next look has confirmed it.
    Half { add: bool, effective_ns: Option<u64>, edges: u8, seen_ns: u64 },
}

/// An inversion written at the last look, not yet known to be in effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct UnconfirmedInversion {
    signal: Signal,
    from_ns: u64,
    done_ns: Option<u64>,
}

/// An inversion to be written at this look.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct InversionCommand {
    /// The inverter to be toggled: 1 A, 2 B.
    pub inverter: u8,
    /// Time from the look that saw the edge, ns, if this inversion ends an insertion.
    pub edge_to_done_ns: Option<u64>,
}

/// When an axis acts next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum NextAction {
    /// Invert at this look.
    Now(InversionCommand),
    /// Nothing before this time, ns, unless a line changes.
    At(u64),
}

/// In which order a real edge and an inversion reached the XOR gate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum OrderAtGate {
    InversionFirst,
    EdgeFirst,
    Unknown,
}

/// Result of a request for a new total.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TotalRequestResult {
    /// The request is the axis's total from now on.
    Accepted,
    /// Accepted, and at or beyond the axis's warning limit.
    AcceptedWithWarning,
    /// Refused; the total does not change.
    Refused(Refusal),
    /// Refused with a fault to latch; the total does not change.
    Fault(Fault),
}

/// What the mode of the machine allows an axis at this look.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct InsertionPermit {
    /// New insertions may begin.
    pub insert: bool,
    /// Nothing is written: shadow mode.
    pub shadow: bool,
}

/// One look at the card, as an axis needs it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct AxisSample {
    pub t_ns: u64,
    pub inputs: u64,
    gap_ns: u64,
    /// The earliest and latest time of the edge that this look shows, ns.
    /// Both are the edge's own time where the card gives a timestamp.
    edge_ns: (u64, u64),
    /// Input lines on which counts may pass between two looks of this card unseen.
    unseen: u64,
    fresh: u64,
    more: bool,
    pub permit: InsertionPermit,
}

impl AxisSample {
    /// Prepares a look; `since_ns` is the earliest time of an edge without a timestamp.
    /// That is the time of the look before, or of the one before that if the look before came late.
    #[inline]
    pub(crate) fn new(sample: &CardInputSample, since_ns: u64, permit: InsertionPermit) -> Self {
        let CardInputSample { t_ns, inputs, edge_ns, complete, more, fresh, .. } = *sample;
        Self {
            t_ns,
            inputs,
            gap_ns: t_ns - since_ns,
            edge_ns: edge_ns.map_or((since_ns, t_ns), |ns| (ns, ns)),
            unseen: if edge_ns.is_none() { !complete } else { 0 },
            fresh,
            more,
            permit,
        }
    }

    /// The earliest and latest time of the change that this look shows, ns.
    /// It applies to the probe's line too.
    pub(crate) const fn edge_ns(&self) -> (u64, u64) {
        self.edge_ns
    }
}

/// The inverters of an axis and the MTC's count.
/// Shadow mode works on a copy.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct InvertersAndMtcCount {
    /// Inverters: bit 0 A, bit 1 B.
    inverters: u8,
    /// Levels of A' and B'.
    mtc: State,
    /// Counts of the MTC since homing.
    mtc_count: i64,
    /// Counts inserted since homing.
    completed: i64,
}

impl InvertersAndMtcCount {
    /// Passes a change of `signal` on to the MTC, which counts `step`.
    #[inline]
    fn pass_on(&mut self, signal: Signal, step: i8) {
        debug_assert_eq!(self.mtc.step_of(signal), step);
        self.mtc_count += i64::from(step);
        self.mtc = self.mtc.flipped(signal);
    }
}

/// One axis between two edges: its count, its inverters and its open insertion.
#[allow(clippy::struct_excessive_bools)] // each is known independently of the others
#[derive(Debug)]
pub(crate) struct AxisEngine {
    config: AxisConfig,
    gate: SpeedGate,
    min_interval_ns: u64,
    busy_ns: u64,
    scale: Decoder,
    /// Position of the place where the counters were zeroed.
    home_counts: i64,
    wire: InvertersAndMtcCount,
    /// The real wire while shadow mode works on a copy.
    real: Option<InvertersAndMtcCount>,
    requested: i64,
    insertion: InsertionState,
    unsettled: Option<UnconfirmedInversion>,
    /// When the last inversion came into effect, ns, until A' and B' are read back.
    back_due: Option<u64>,
    /// Earliest and latest time of the last edge, ns.
    last_edge: Option<(u64, u64)>,
    /// Direction of the last edge.
    last_step: i8,
    /// Lower bound of the last period, ns; [`REST`] before the second edge.
    period_ns: u64,
    /// Earliest time of the next insertion by the rate cap, ns.
    next_allowed_ns: u64,
    /// Why the last edge opened no insertion.
    waits_for: InsertionStatus,
    /// Requests in a row outside the belief window.
    not_believed: u8,
    homing: Option<i64>,
    homed: bool,
    /// The difference of the MTC's and the scale's counts is certain.
    mtc_known: bool,
    faults: FaultSet,
    capture: Option<ProbeCapture>,
    /// Nothing to do before this time, ns, unless a line changes.
    wake_ns: u64,
    /// An edge only has to be counted.
    /// No insertion is open, pending or due, and only totals were requested since the last full look.
    count_only: bool,
    /// Masks in the input word: all lines of the axis, A alone, A and B.
    input_mask: u64,
    a_mask: u64,
    scale_mask: u64,
    /// Masks in the output word: the inverter of A, the inverter of B.
    invert_masks: (u64, u64),
    /// A and B in the input word as they were at the last look that counted.
    scale_inputs: u64,
    /// Line and signal that change at the next count in the last direction.
    /// The line is a mask in the input word. It is [`NOWHERE`] where the last edge had no direction.
    expected_edge: (u64, Signal),
    insertions: u64,
    waited_for_gate: u64,
    overlaps: u64,
    late: u64,
    beyond_limits: u64,
    /// An inversion was made since homing.
    touched: bool,
    /// Successive edges of one channel alone.
    alone: SingleChannelEdges,
}

/// Successive edges of one channel while the other does not change.
/// Either the axis oscillates over one boundary between two counts, or the other channel is dead.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct SingleChannelEdges {
    /// Position of that boundary, counts.
    boundary: i64,
    /// Reversals in a row that came sooner than the axis can turn.
    impossible: u8,
}

/// State of an axis at the start of the engine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct InitialAxisState {
    pub scale: State,
    pub inverters: u8,
    pub completed: i64,
    pub t_ns: u64,
}

/// Period before the second edge after homing, ns.
/// The axis is taken to start from rest.
const REST: u64 = u64::MAX;
/// No line: after an edge without a direction, no next edge is predicted.
const NOWHERE: (u64, Signal) = (u64::MAX, Signal::A);
/// Early reversals in a row after which the other channel is dead.
/// A reversal is early if the axis cannot turn that fast. A burst of noise is shorter, and an axis moves on by at most
/// 32 counts.
const DEAD_AFTER: u8 = 16;
/// Time after which a capture without a further edge ends, ns.
/// The axis has stopped then.
const CAPTURE_LIMIT_NS: u64 = 100_000_000;

impl AxisEngine {
    /// An axis engine that starts from the state `found` on the card.
    /// `None` where the configuration leaves no time for an insertion at any speed.
    pub(crate) fn new(config: AxisConfig, found: InitialAxisState) -> Option<Self> {
        // The process before ended between two inversions, so the MTC counts mirrored. The pair is finished towards
        // zero as soon as its separation allows. How the scale moved meanwhile is unknown, so a fault is latched.
        let half = matches!(found.inverters, 1 | 2);
        let add = found.completed < 0;
        let total = found.completed + if half { if add { 1 } else { -1 } } else { 0 };
        let mut faults = FaultSet::NONE;
        if half {
            faults.latch(Fault::Interrupted);
        }
        let interval = INCREMENT_COUNTS as f64 / config.max_rate_counts_s * 1e9;
        Some(Self {
            config,
            gate: config.gate()?,
            min_interval_ns: interval as u64,
            busy_ns: config.busy_ns(),
            scale: Decoder::new(found.scale),
            home_counts: 0,
            wire: InvertersAndMtcCount {
                inverters: found.inverters,
                mtc: found.scale.inverted(found.inverters),
                mtc_count: found.completed,
                // The total before the insertion that is finished first.
                completed: if half { 2 * found.completed - total } else { total },
            },
            real: None,
            requested: total,
            insertion: if half {
                let (effective_ns, seen_ns) = (Some(found.t_ns), found.t_ns);
                InsertionState::Half { add, effective_ns, edges: 0, seen_ns }
            } else {
                InsertionState::Idle
            },
            unsettled: None,
            back_due: None,
            last_edge: None,
            last_step: 0,
            period_ns: REST,
            next_allowed_ns: found.t_ns,
            waits_for: InsertionStatus::WaitingForEdge,
            not_believed: 0,
            homing: None,
            homed: false,
            mtc_known: !half,
            faults,
            capture: None,
            wake_ns: found.t_ns,
            count_only: false,
            input_mask: config.lines.input_mask(),
            a_mask: 1 << config.lines.a,
            scale_mask: 1 << config.lines.a | 1 << config.lines.b,
            invert_masks: (1 << config.lines.invert_a, 1 << config.lines.invert_b),
            scale_inputs: 0,
            expected_edge: NOWHERE,
            insertions: 0,
            waited_for_gate: 0,
            overlaps: 0,
            late: 0,
            beyond_limits: 0,
            touched: half,
            alone: SingleChannelEdges::default(),
        })
    }

    /// Mask and level of the output line of an inverter (1 A, 2 B) that is toggled.
    #[inline]
    pub(crate) const fn output(&self, toggled: u8) -> (u64, u64) {
        let mask = if toggled == 1 { self.invert_masks.0 } else { self.invert_masks.1 };
        (mask, if self.wire.inverters & toggled == 0 { 0 } else { mask })
    }

    /// Mask of the axis's lines in the output word.
    #[inline]
    pub(crate) const fn output_mask(&self) -> u64 {
        self.invert_masks.0 | self.invert_masks.1
    }

    /// Mask of the axis's lines in the input word.
    pub(crate) const fn input_mask(&self) -> u64 {
        self.input_mask
    }

    /// Time before which nothing is due, ns, unless a line changes.
    pub(crate) const fn wake_ns(&self) -> u64 {
        self.wake_ns
    }

    /// Makes the next look check whether something is due.
    pub(crate) fn wake(&mut self) {
        (self.wake_ns, self.count_only) = (0, false);
    }

    /// Makes the next edge take the full path.
    /// A request other than a total calls for it.
    pub(crate) fn take_care(&mut self) {
        self.count_only = false;
    }

    pub(crate) const fn homed(&self) -> bool {
        self.homed
    }

    pub(crate) const fn mtc_known(&self) -> bool {
        self.mtc_known
    }

    /// Marks the MTC's count as unknown.
    /// The MTC must then be homed together with this axis.
    pub(crate) fn lose_controller(&mut self) {
        (self.mtc_known, self.homed, self.homing) = (false, false, None);
    }

    pub(crate) const fn faults(&self) -> FaultSet {
        self.faults
    }

    /// Both inverters are equal and no insertion is under way.
    pub(crate) fn idle(&self) -> bool {
        matches!(self.insertion, InsertionState::Idle | InsertionState::Opened { .. })
    }

    /// Real inverters and the total in the MTC's count, for a restart.
    /// It is the completed total, or between the two inversions of a pair the odd number halfway.
    pub(crate) fn in_effect(&self) -> (u8, i64) {
        let wire = self.real.unwrap_or(self.wire);
        let half = matches!(wire.inverters, 1 | 2);
        (wire.inverters, if half { wire.mtc_count - self.scale.count() } else { wire.completed })
    }

    fn pending(&self) -> i64 {
        self.requested - self.wire.completed
    }

    /// Whether four counts may have passed unseen between two looks.
    /// After four counts the lines are as before. It applies to lines that are not all `complete`, if the axis was
    /// moving and the time was long enough.
    pub(crate) fn may_have_missed_a_cycle(&self, complete: u64, since_ns: u64, t_ns: u64) -> bool {
        let Some((_, last_ns)) = self.last_edge else { return false };
        let gap_ns = t_ns - since_ns;
        self.homed
            && complete & self.a_mask == 0
            && gap_ns > self.gate.need_ns()
            && since_ns.saturating_sub(last_ns) < self.period_ns.saturating_mul(2)
            && self.gate.travel_ns(self.period_ns, 4.0) < gap_ns as f64
    }

    pub(crate) fn need_ns(&self) -> u64 {
        self.gate.need_ns()
    }

    /// Latches a fault; `true` when it is new.
    pub(crate) fn latch(&mut self, fault: Fault) -> bool {
        if fault.loses_home() {
            self.lose_controller();
        }
        self.faults.latch(fault)
    }

    pub(crate) fn clear(&mut self) {
        self.faults = FaultSet::NONE;
        self.not_believed = 0;
    }

    /// Enters or leaves shadow mode; in it everything happens on a copy of the wire.
    pub(crate) fn set_shadow(&mut self, on: bool) {
        match (on, self.real) {
            (true, None) => self.real = Some(self.wire),
            (false, Some(real)) => {
                // The real inverters stood still: the MTC counted what the scale counted.
                self.wire = InvertersAndMtcCount {
                    mtc: self.scale.state().inverted(real.inverters),
                    mtc_count: self.scale.count() + real.completed,
                    ..real
                };
                self.real = None;
                self.insertion = InsertionState::Idle;
            }
            _ => {}
        }
    }

    /// Zeroes the scale's counter at the known place.
    /// The total is zeroed too if the MTC has been homed there. Otherwise the MTC still counts what was inserted, and
    /// the total continues.
    pub(crate) fn home(&mut self, position_counts: i64, controller_homed: bool) {
        self.scale = Decoder::new(self.scale.state());
        self.home_counts = position_counts;
        if controller_homed {
            self.wire.completed = 0;
            if let Some(real) = &mut self.real {
                real.completed = 0;
            }
            (self.mtc_known, self.touched) = (true, false);
        }
        self.wire.mtc_count = self.wire.completed;
        self.requested = self.wire.completed;
        self.not_believed = 0;
        self.homed = false;
        self.homing = Some(position_counts);
        self.capture = None;
    }

    /// Completes homing when the control side has read back the home position.
    pub(crate) fn confirm_home(&mut self, position_counts: i64) -> bool {
        self.homed = self.homing == Some(position_counts);
        if self.homed {
            self.homing = None;
        }
        self.homed
    }

    /// Takes a new total, counts since homing.
    /// If the answer is a fault, the caller latches it.
    pub(crate) fn request(&mut self, total: i64, large: bool) -> TotalRequestResult {
        let answer = self.config.judge(total, self.requested, large, &mut self.not_believed);
        if matches!(answer, TotalRequestResult::Accepted | TotalRequestResult::AcceptedWithWarning) {
            self.requested = total;
            // Due next is an edge or the end of the rest time; a new total makes nothing due sooner.
            self.set_wake_time();
        }
        answer
    }

    /// The probe tripped between these two times, ns.
    /// Returns `false` for a bounce, which is a trip during a capture.
    pub(crate) fn trip(&mut self, trip_ns: (u64, u64)) -> bool {
        if self.capture.is_some() {
            return false;
        }
        let before = (self.last_boundary(), self.last_edge.map(|(_, t)| t));
        self.capture = Some(ProbeCapture { trip_ns, before, after: None });
        self.wake();
        true
    }

    /// Notes that the write is in effect from `done_ns` on, as the card reports it.
    pub(crate) fn written(&mut self, done_ns: u64) {
        if let Some(u) = &mut self.unsettled {
            u.done_ns = Some(done_ns);
        }
        self.settle(done_ns);
        self.set_wake_time();
    }

    fn settle(&mut self, at_ns: u64) {
        if let InsertionState::Half { effective_ns, .. } = &mut self.insertion
            && effective_ns.is_none()
        {
            *effective_ns = Some(at_ns);
        }
    }

    /// Fast path for a regular edge: same direction, on time, no insertion pending.
    /// The edge steps both counts alike, so their difference stays. Returns `false` and changes nothing where
    /// [`AxisEngine::look`] has to check more.
    #[inline]
    pub(crate) fn count_regular_edge(&mut self, look: &AxisSample) -> bool {
        let (Some(last_edge), true) = (self.last_edge, self.count_only) else { return false };
        let scale_inputs = look.inputs & self.scale_mask;
        let changed = scale_inputs ^ self.scale_inputs;
        let (line, signal) = self.expected_edge;
        if changed != line {
            return changed == 0;
        }
        if look.unseen & self.a_mask != 0
            && (look.gap_ns > self.gate.need_ns()
                || look.edge_ns.1 - last_edge.0 + self.config.detect_ns < self.period_ns)
        {
            return false;
        }
        self.count_edge(signal, line, self.last_step, scale_inputs, look.edge_ns);
        // Both inverters are equal: the MTC counts as the scale does.
        self.wire.pass_on(signal, self.last_step);
        true
    }

    /// Enters an edge of `signal` on `line` into the scale's count.
    /// It also stores what the next edge is compared with.
    #[allow(clippy::inline_always, reason = "each edge of a moving axis passes here")]
    #[inline(always)]
    fn count_edge(&mut self, signal: Signal, line: u64, step: i8, scale_inputs: u64, edge_ns: (u64, u64)) {
        self.scale.take_step(self.scale.state().flipped(signal), step);
        self.scale_inputs = scale_inputs;
        // A and B alternate while the axis moves on.
        self.expected_edge = (line ^ self.scale_mask, signal.other());
        self.period_ns = self.last_edge.map_or(REST, |(_, last_ns)| edge_ns.0.saturating_sub(last_ns));
        // Writing in place saves one instruction at a regular edge.
        *self.last_edge.get_or_insert(edge_ns) = edge_ns;
    }

    /// Handles one look, whether or not lines of the axis have changed.
    /// Returns the inversion to be made now.
    #[inline]
    pub(crate) fn look(
        &mut self,
        look: &AxisSample,
        changed: bool,
        report: &mut impl FnMut(EventKind),
    ) -> Option<InversionCommand> {
        if changed {
            let state = self.config.lines.scale(look.inputs);
            if state != self.scale.state() {
                self.edge(state, look, report);
            }
        }
        self.advance(look, report)
    }

    /// Continues an insertion under way, or begins one that is due.
    fn advance(&mut self, look: &AxisSample, report: &mut impl FnMut(EventKind)) -> Option<InversionCommand> {
        if let Some(u) = self.unsettled
            && u.done_ns.is_none_or(|done| look.edge_ns.1 > done)
        {
            // The axis had time to cross an edge and come back. With an inversion in between, that is four counts
            // unseen.
            if look.unseen & self.a_mask != 0 && look.gap_ns >= self.gate.turn_back_ns() {
                self.fault(Fault::PollGap, report);
            }
            self.unsettled = None;
            self.settle(look.t_ns);
            self.back_due = if self.config.lines.read_back.is_some() && self.real.is_none() {
                Some(u.done_ns.unwrap_or(look.t_ns))
            } else {
                None
            };
        }
        if let Some(effective_ns) = self.back_due
            && self.reads_back_wrong(effective_ns, look)
        {
            self.fault(Fault::ReadBackMismatch, report);
        }
        if let Some(c) = self.capture
            && look.t_ns > c.trip_ns.1 + CAPTURE_LIMIT_NS
        {
            self.capture = None;
            report(EventKind::Trip(c));
        }
        match if look.more { NextAction::At(self.due_ns()) } else { self.act(look, report) } {
            NextAction::At(wake_ns) => {
                self.set_wake(wake_ns);
                None
            }
            NextAction::Now(inversion) => {
                // The next look tells whether the inversion is in effect.
                (self.wake_ns, self.count_only) = (0, false);
                Some(inversion)
            }
        }
    }

    /// Whether A' and B' differ from what was written.
    /// Each inversion is checked once, after gates, receivers and the card's input filter had the separation that the
    /// MTC is given. Not inlined, because few looks need it.
    #[inline(never)]
    fn reads_back_wrong(&mut self, effective_ns: u64, look: &AxisSample) -> bool {
        if self.unsettled.is_some()
            || look.t_ns < self.apart_ns(effective_ns)
            || look.more
            || look.fresh & self.input_mask != self.input_mask
        {
            return false;
        }
        self.back_due = None;
        self.config.lines.back(look.inputs).is_some_and(|back| back != self.wire.mtc)
    }

    fn fault(&mut self, fault: Fault, report: &mut impl FnMut(EventKind)) {
        if self.latch(fault) {
            report(EventKind::Fault(fault));
        }
    }

    /// Handles a change of A or B.
    fn edge(&mut self, state: State, look: &AxisSample, report: &mut impl FnMut(EventKind)) {
        let before = self.scale.state();
        let Some(step) = before.step_to(state) else {
            self.illegal_edge(state, look, report);
            return;
        };
        let (last, last_period_ns, signal) = (self.last_edge, self.period_ns, before.signal_to(state));
        let line = match signal {
            Signal::A => self.a_mask,
            Signal::B => self.scale_mask ^ self.a_mask,
        };
        self.count_edge(signal, line, step, look.inputs & self.scale_mask, look.edge_ns);
        if let Some((last_ns, _)) = last
            && look.unseen & self.a_mask != 0
        {
            self.check_gap(look.gap_ns, last_period_ns, report);
            self.check_limits(step, look.edge_ns.1 - last_ns, last_period_ns, report);
        }
        let turned = self.last_step != 0 && step != self.last_step;
        self.last_step = step;
        if turned {
            self.check_turns(look, last.map(|(ns, _)| ns), report);
        }
        if self.unsettled.is_none() {
            self.wire.pass_on(signal, self.wire.mtc.step_of(signal));
        } else {
            self.pass_on_beside_inversion(signal, look.edge_ns.1, report);
        }
        if self.wire.inverters == 0 || self.wire.inverters == 3 {
            if self.wire.mtc_count - self.scale.count() != self.wire.completed
                && self.faults == FaultSet::NONE
            {
                self.fault(Fault::LedgerImbalance, report);
            }
        } else {
            self.overlaps += 1;
            report(EventKind::Overlap);
        }
        if let Some(mut c) = self.capture.take() {
            c.after = Some((self.last_boundary(), look.edge_ns.1));
            report(EventKind::Trip(c));
        }
        match &mut self.insertion {
            InsertionState::Idle | InsertionState::Opened { .. } => {
                self.insertion = InsertionState::Idle;
                if self.ready() && look.permit.insert {
                    if turned {
                        // Only edges of both channels show that the axis moves.
                        self.waits_for = InsertionStatus::OneChannel;
                        self.waited_for_gate += 1;
                    } else {
                        self.open(look.edge_ns);
                    }
                }
            }
            InsertionState::Half { edges, .. } => *edges += 1,
        }
    }

    /// Checks a repeated edge of one channel, which is a reversal.
    /// The axis is known to move only while A and B take turns. It may oscillate over one boundary, but no sooner
    /// than its limits allow.
    #[cold]
    fn check_turns(&mut self, look: &AxisSample, before_ns: Option<u64>, report: &mut impl FnMut(EventKind)) {
        let boundary = self.last_boundary();
        if self.alone.boundary != boundary {
            self.alone = SingleChannelEdges { boundary, impossible: 0 };
        }
        // Without a timestamp, the edge before came at the earliest after the look before it.
        let after_ns = before_ns.map_or(u64::MAX, |ns| look.edge_ns.1 - ns);
        self.alone.impossible =
            if after_ns < self.gate.turn_back_ns() { self.alone.impossible.saturating_add(1) } else { 0 };
        if self.alone.impossible >= DEAD_AFTER {
            self.fault(Fault::ChannelDead, report);
        }
    }

    /// Handles a change of A and B at once, whose step is unknown.
    #[cold]
    fn illegal_edge(&mut self, state: State, look: &AxisSample, report: &mut impl FnMut(EventKind)) {
        self.scale.update(state);
        self.scale_inputs = look.inputs & self.scale_mask;
        let last = self.last_edge.replace(look.edge_ns);
        let period_ns = last.map_or(REST, |(_, last_ns)| look.edge_ns.0.saturating_sub(last_ns));
        let last_period_ns = std::mem::replace(&mut self.period_ns, period_ns);
        if last.is_some() && look.unseen & self.a_mask != 0 {
            self.check_gap(look.gap_ns, last_period_ns, report);
        }
        (self.last_step, self.expected_edge, self.alone) = (0, NOWHERE, SingleChannelEdges::default());
        self.wire.mtc = state.inverted(self.wire.inverters);
        if let InsertionState::Half { edges, .. } = &mut self.insertion {
            *edges += 1;
        }
        self.fault(Fault::IllegalTransition, report);
    }

    /// The position of the boundary that the last edge crossed.
    fn last_boundary(&self) -> i64 {
        self.home_counts + self.scale.count() + i64::from(self.last_step < 0)
    }

    /// Checks an edge that was seen late.
    /// Three or more counts may have passed, and one change may hide them.
    #[inline]
    fn check_gap(&mut self, gap_ns: u64, period_ns: u64, report: &mut impl FnMut(EventKind)) {
        if gap_ns > self.gate.need_ns() && self.homed && self.gate.travel_ns(period_ns, 3.0) < gap_ns as f64 {
            self.fault(Fault::PollGap, report);
        }
    }

    /// Checks an edge at most `after_ns` after the one before.
    /// An edge that is too early disproves the axis's limits. The engine relied on them for every insertion since
    /// homing: it assumed that no two edges cancelled between two looks beside an insertion.
    fn check_limits(&mut self, step: i8, after_ns: u64, period_ns: u64, report: &mut impl FnMut(EventKind)) {
        // The look before read its lines some time before the time that it reports.
        let after_ns = after_ns + self.config.detect_ns;
        let beyond = if step == self.last_step {
            self.gate.too_soon(period_ns, after_ns) && period_ns != REST
        } else {
            self.last_step != 0 && after_ns < self.gate.turn_back_ns()
        };
        if beyond {
            self.beyond_limits += 1;
            if self.touched {
                self.fault(Fault::BeyondLimits, report);
            }
        }
    }

    /// Enters a real edge of `signal` into the MTC's count beside an inversion.
    /// The inversion is not confirmed yet. Edge and inversion are entered in the order in which they happened.
    fn pass_on_beside_inversion(&mut self, signal: Signal, edge_ns: u64, report: &mut impl FnMut(EventKind)) {
        let order = match self.unsettled {
            None => OrderAtGate::InversionFirst,
            // The same signal changed twice, so the MTC is where it was in either order.
            Some(u) if u.signal == signal => OrderAtGate::InversionFirst,
            Some(u) => match (u.done_ns, edge_ns) {
                (Some(done), e) if e > done => OrderAtGate::InversionFirst,
                (_, e) if e <= u.from_ns && u.done_ns.is_some() => OrderAtGate::EdgeFirst,
                _ => OrderAtGate::Unknown,
            },
        };
        let w = &mut self.wire;
        match (order, self.unsettled) {
            (OrderAtGate::EdgeFirst, Some(u)) => {
                let undone = w.mtc.flipped(u.signal);
                w.mtc_count -= i64::from(undone.step_of(u.signal));
                w.mtc_count += i64::from(undone.step_of(signal));
                w.mtc_count += i64::from(undone.flipped(signal).step_of(u.signal));
                w.mtc = w.mtc.flipped(signal);
            }
            _ => w.pass_on(signal, w.mtc.step_of(signal)),
        }
        if order == OrderAtGate::Unknown {
            self.fault(Fault::OrderUnknown, report);
        } else if order == OrderAtGate::EdgeFirst && (w.inverters == 0 || w.inverters == 3) {
            // The edge came before the second inversion after all. Only now is the effect of the pair known.
            w.completed = w.mtc_count - self.scale.count();
        }
    }

    fn ready(&self) -> bool {
        let pending = self.pending();
        // The usual case is less than an insertion, and is decided first.
        !(-1..=1).contains(&pending) && self.homed && !self.faults.any()
    }

    /// Opens an insertion after an edge with a total pending, or notes why not.
    /// It is written in place, because reading it back in other pieces stalls the processor.
    fn open(&mut self, edge: (u64, u64)) {
        if edge.1 < self.next_allowed_ns {
            self.waits_for = InsertionStatus::RateCap;
            return;
        }
        // The first edge gives no period, so no speed.
        let period_ns = if self.period_ns == REST { 0 } else { self.period_ns };
        let quiet_ns = self.gate.quiet_ns(period_ns);
        if period_ns < self.gate.min_period_ns() || quiet_ns < self.gate.need_ns() {
            self.waits_for = InsertionStatus::TooFast;
            self.waited_for_gate += 1;
            return;
        }
        self.waits_for = InsertionStatus::WaitingForEdge;
        self.insertion = InsertionState::Opened {
            add: self.pending() > 0,
            from_ns: edge.1 + self.config.min_separation_ns,
            until_ns: edge.0 + quiet_ns - self.busy_ns,
        };
    }

    /// Finds what is due at this look, or the time when something is.
    fn act(&mut self, look: &AxisSample, report: &mut impl FnMut(EventKind)) -> NextAction {
        let t_ns = look.t_ns;
        match self.insertion {
            InsertionState::Idle => {
                let due_ns = self.due_at_rest_ns();
                if t_ns < due_ns || !look.permit.insert {
                    return NextAction::At(due_ns);
                }
                self.invert_first(self.pending() > 0, t_ns, t_ns)
            }
            InsertionState::Opened { add, from_ns, until_ns } => {
                if t_ns < from_ns {
                    return NextAction::At(from_ns);
                }
                self.insertion = InsertionState::Idle;
                let wanted = look.permit.insert && self.ready() && (self.pending() > 0) == add;
                if wanted && t_ns <= until_ns {
                    return self.invert_first(add, t_ns, from_ns - self.config.min_separation_ns);
                }
                if wanted {
                    self.late += 1;
                    report(EventKind::Late);
                }
                NextAction::At(self.due_at_rest_ns())
            }
            InsertionState::Half { add, effective_ns: Some(effective), edges, seen_ns } => {
                // Two real edges came inside: the axis is too fast to keep a separation, and the MTC counts mirrored.
                let due_ns = self.apart_ns(effective);
                if t_ns < due_ns && edges < 2 {
                    return NextAction::At(due_ns);
                }
                self.invert_second(add, edges > 0, t_ns, seen_ns, report)
            }
            InsertionState::Half { .. } => NextAction::At(0),
        }
    }

    /// Makes the first inversion.
    /// With A and B equal, A adds and B subtracts; with A and B different it is the other way round (NISTIR 4832,
    /// Design C). Both inverters are equal here, so A' and B' decide alike.
    fn invert_first(&mut self, add: bool, t_ns: u64, seen_ns: u64) -> NextAction {
        self.insertion = InsertionState::Half { add, effective_ns: None, edges: 0, seen_ns };
        self.touched |= self.real.is_none();
        let inverter = self.invert(self.wire.mtc.signal_towards(add), if add { 1 } else { -1 }, t_ns);
        NextAction::Now(InversionCommand { inverter, edge_to_done_ns: None })
    }

    /// Makes the second inversion.
    /// Without an edge in between it inverts the other signal. With one it inverts the signal that brings the MTC to
    /// the wanted count, or else back to where it was.
    fn invert_second(
        &mut self,
        add: bool,
        overlapped: bool,
        t_ns: u64,
        seen_ns: u64,
        report: &mut impl FnMut(EventKind),
    ) -> NextAction {
        let wanted = self.wire.completed + if add { 2 } else { -2 };
        let offset = self.wire.mtc_count - self.scale.count();
        // In the usual case the other signal completes the insertion.
        let (mut signal, mut step) = (self.wire.mtc.signal_towards(add), if add { 1 } else { -1 });
        if offset + step != wanted {
            let [ahead, aback] = [offset + step, offset - step].map(|o| o.abs_diff(wanted));
            if aback < ahead || aback == ahead && signal == Signal::B {
                (signal, step) = (signal.other(), -step);
            }
        }
        let inverter = self.invert(signal, step, t_ns);
        let offset = offset + step;
        if overlapped {
            self.wire.completed = offset;
        } else {
            self.wire.completed = wanted;
            if offset != wanted {
                self.fault(Fault::LedgerImbalance, report);
            }
        }
        self.insertion = InsertionState::Idle;
        self.insertions += 1;
        self.next_allowed_ns = t_ns + self.min_interval_ns;
        NextAction::Now(InversionCommand { inverter, edge_to_done_ns: Some(t_ns - seen_ns) })
    }

    /// Inverts a signal, which the MTC counts as `step`.
    fn invert(&mut self, signal: Signal, step: i64, t_ns: u64) -> u8 {
        let w = &mut self.wire;
        debug_assert_eq!(i64::from(w.mtc.step_of(signal)), step);
        w.mtc_count += step;
        w.mtc = w.mtc.flipped(signal);
        w.inverters ^= signal as u8;
        self.unsettled = Some(UnconfirmedInversion { signal, from_ns: t_ns, done_ns: None });
        signal as u8
    }

    /// Time until which the MTC needs its separation, ns.
    /// It counts from an inversion in effect since `effective_ns` and from the last edge.
    fn apart_ns(&self, effective_ns: u64) -> u64 {
        let last_out = self.last_edge.map_or(effective_ns, |(_, edge)| edge.max(effective_ns));
        last_out + self.config.min_separation_ns
    }

    /// Time when the insertion under way continues, or one begins at rest, ns.
    fn due_ns(&self) -> u64 {
        match self.insertion {
            InsertionState::Idle => self.due_at_rest_ns(),
            InsertionState::Opened { from_ns, .. } => from_ns,
            InsertionState::Half { effective_ns: Some(e), edges: 0..2, .. } => self.apart_ns(e),
            InsertionState::Half { .. } => 0,
        }
    }

    /// Time when an insertion begins without an edge, ns.
    fn due_at_rest_ns(&self) -> u64 {
        match self.config.rest {
            InsertionAtRestPolicy::Insert { after_ns } if self.ready() => {
                self.last_edge.map_or(0, |(_, t)| t).max(self.next_allowed_ns) + after_ns
            }
            _ => u64::MAX,
        }
    }

    /// Works out the time before which nothing is due unless a line changes.
    fn set_wake_time(&mut self) {
        let next_look_tells = self.unsettled.is_some_and(|u| u.done_ns.is_none());
        self.set_wake(if next_look_tells { 0 } else { self.due_ns() });
    }

    /// Sets the wake time where it is known and no look has to confirm an inversion.
    fn set_wake(&mut self, due_ns: u64) {
        debug_assert!(due_ns == 0 || self.unsettled.is_none_or(|u| u.done_ns.is_some()));
        let mut wake = due_ns;
        if let Some(effective_ns) = self.back_due {
            wake = wake.min(self.apart_ns(effective_ns));
        }
        if let Some(c) = self.capture {
            wake = wake.min(c.trip_ns.1 + CAPTURE_LIMIT_NS + 1);
        }
        self.wake_ns = wake;
        self.count_only = wake == u64::MAX
            && !self.ready()
            && self.unsettled.is_none()
            && matches!(self.wire.inverters, 0 | 3);
    }

    /// Status of the axis.
    /// `blocked` is the machine's reason against insertions, if any.
    pub(crate) fn status(&self, t_ns: u64, blocked: Option<InsertionStatus>) -> AxisStatus {
        let real = self.real.unwrap_or(self.wire);
        let mtc_count =
            if self.real.is_some() { self.scale.count() + real.completed } else { self.wire.mtc_count };
        let since_ns = self.last_edge.map(|(_, t)| t_ns.saturating_sub(t));
        let at_rest = since_ns.is_none_or(|s| s > 50_000_000);
        let gate = if self.faults.any() {
            InsertionStatus::Fault
        } else if !self.homed {
            InsertionStatus::NotHomed
        } else if let Some(blocked) = blocked {
            blocked
        } else if self.insertion != InsertionState::Idle {
            InsertionStatus::Inserting
        } else if !self.ready() {
            InsertionStatus::Done
        } else if at_rest && self.config.rest == InsertionAtRestPolicy::Wait {
            InsertionStatus::AtRest
        } else {
            self.waits_for
        };
        // One edge alone gives no speed.
        let period_ns = since_ns.map_or(REST, |s| s.max(self.period_ns));
        AxisStatus {
            position_counts: self.home_counts + self.scale.count(),
            mtc_minus_scale: mtc_count - self.scale.count(),
            requested: self.requested,
            completed: self.wire.completed,
            in_effect: real.completed,
            inverted: real.inverters == 3,
            homed: self.homed,
            mtc_known: self.mtc_known,
            gate,
            edge_rate_hz: if period_ns == REST || at_rest { 0.0 } else { 1e9 / period_ns.max(1) as f64 },
            faults: self.faults,
            insertions: self.insertions,
            waited_for_gate: self.waited_for_gate,
            overlaps: self.overlaps,
            late: self.late,
            illegal: self.scale.illegal(),
            beyond_limits: self.beyond_limits,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// What a test does between two looks.
    #[derive(Debug, Clone, Copy)]
    enum Between {
        Forward,
        Back,
        Both,
        Nothing,
        Request(i64),
    }

    fn between() -> impl Strategy<Value = Between> {
        prop_oneof![
            12 => Just(Between::Forward),
            2 => Just(Between::Back),
            1 => Just(Between::Both),
            3 => Just(Between::Nothing),
            1 => (-6..=6_i64).prop_map(Between::Request),
        ]
    }

    /// The fast path takes every edge that is neither late nor too early.
    /// The limits are tested to the nanosecond.
    #[test]
    fn the_short_way_is_taken_where_nothing_can_be_wrong() {
        // Edges are 10 µs apart. The last came at most `after_ns` after the one before, and shows `gap_ns` after the
        // look before.
        let calm = |complete: u64, gap_ns: u64, after_ns: u64| {
            let config = AxisConfig { detect_ns: 700, ..AxisConfig::default() };
            let found = InitialAxisState { scale: State::default(), inverters: 0, completed: 0, t_ns: 1 };
            let mut axis = AxisEngine::new(config, found).unwrap();
            axis.home(0, true);
            axis.confirm_home(0);
            let mut state = State::default();
            let mut edge = |t_ns: u64, since_ns: u64, careful: bool| {
                state = state.next(true);
                let sample =
                    CardInputSample { complete, ..CardInputSample::level(t_ns, u64::from(state.bits())) };
                let look =
                    AxisSample::new(&sample, since_ns, InsertionPermit { insert: true, shadow: false });
                if careful {
                    axis.look(&look, true, &mut |_| {});
                    return true;
                }
                let (need_ns, count) = (axis.gate.need_ns(), axis.scale.count());
                let calm = axis.count_regular_edge(&look);
                assert_eq!(axis.scale.count() - count, i64::from(calm));
                assert_eq!(need_ns, 2200);
                calm
            };
            for n in 1..=3 {
                edge(10_000 * n, 10_000 * n - 100, true);
            }
            let t_ns = 30_000 - 100 + after_ns;
            edge(t_ns, t_ns - gap_ns, false)
        };
        // A period of at least 9.9 µs. The time after it is extended by the detection time of the look before.
        assert!(calm(0, 2200, 9_200));
        assert!(!calm(0, 2201, 9_200), "late");
        assert!(!calm(0, 100, 9_199), "sooner than the one before");
        assert!(calm(0b11, 20_000, 9_000), "a card that keeps every edge");
        assert!(!calm(0b10, 2201, 9_200) && !calm(0b10, 100, 9_199), "one that keeps those of B alone");
    }

    proptest! {
        /// The fast path leaves the axis as the full path does.
        #[test]
        fn a_calm_edge_is_what_a_careful_one_is(
            looks in prop::collection::vec((between(), 100_u64..4000, any::<bool>(), any::<bool>(), any::<bool>()), 1..200),
        ) {
            let config = AxisConfig { max_accel_counts_s2: 1e9, ..AxisConfig::default() };
            let found = InitialAxisState { scale: State::default(), inverters: 0, completed: 0, t_ns: 1 };
            let mut axes = [(); 2].map(|()| AxisEngine::new(config, found).unwrap());
            for axis in &mut axes {
                axis.home(0, true);
                axis.confirm_home(0);
            }
            let (mut state, mut t_ns, mut calm) = (State::default(), 1, 0);
            for (what, gap_ns, insert, stamped, done) in looks {
                let before = state;
                match what {
                    Between::Forward => state = state.next(true),
                    Between::Back => state = state.next(false),
                    Between::Both => state = state.inverted(3),
                    Between::Nothing => {}
                    Between::Request(total) => axes.iter_mut().for_each(|a| {
                        a.request(total, true);
                    }),
                }
                let since_ns = t_ns;
                t_ns += gap_ns;
                let inputs = u64::from(state.bits());
                let sample = if stamped && state != before {
                    CardInputSample::stamped(t_ns, inputs, Some(t_ns - 50))
                } else {
                    CardInputSample::level(t_ns, inputs)
                };
                let look = AxisSample::new(&sample, since_ns, InsertionPermit { insert, shadow: false });
                let [quick, careful] = &mut axes;
                let mut told = [Vec::new(), Vec::new()];
                let mut toggled = [None; 2];
                if quick.count_regular_edge(&look) {
                    calm += 1;
                } else {
                    toggled[0] = quick.look(&look, state != before, &mut |kind| told[0].push(kind));
                }
                toggled[1] = careful.look(&look, state != before, &mut |kind| told[1].push(kind));
                prop_assert_eq!(toggled[0], toggled[1]);
                prop_assert_eq!(&told[0], &told[1]);
                prop_assert_eq!(format!("{quick:?}"), format!("{careful:?}"));
                if toggled[0].is_some() && done {
                    for axis in &mut axes {
                        axis.written(t_ns + 10);
                    }
                }
            }
            prop_assume!(calm > 0);
        }
    }
}
