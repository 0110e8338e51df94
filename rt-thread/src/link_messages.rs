//! The messages of the link: requests, events and status.
//! All are `Copy`; nothing allocates.

use rtec_driver::card::CardFaultKind;
use serde::{Deserialize, Serialize};

/// Axes that one engine can hold.
pub const MAX_AXES: usize = 6;

/// A request of the control side. Requests are totals, never increments.
/// Axes are numbered from 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)] // of the fields
pub enum RequestToRt {
    /// The total correction of an axis in counts since homing.
    /// `large`: a change beyond the belief window is intended (a restart with a hot machine).
    Correct { axis: u8, total_counts: i64, large: bool },
    /// Sets the axis's counters to this value at its known place.
    /// `controller_homed`: the MTC has been homed there too, so its earlier count is forgotten. Otherwise the total
    /// in effect is kept.
    Home { axis: u8, position_counts: i64, controller_homed: bool },
    /// Confirms the position that was read back after [`RequestToRt::Home`].
    /// The control side sends it. Only the same value completes homing.
    ConfirmHome { axis: u8, position_counts: i64 },
    /// Enables corrections.
    /// Every axis must be homed and no fault latched; on a real card every setting must be verified too.
    Enable,
    /// Disables corrections: they freeze where they are.
    Disable,
    /// Shadow mode: computes, gates and counts everything, writes nothing.
    Shadow,
    /// Probing mode on or off: no corrections, positions captured at the probe's edge.
    Probe(bool),
    /// Feed hold on or off, and the number of the user who asks.
    Hold { on: bool, by: u32 },
    /// Release latched faults. Axes whose count is in doubt must be homed again.
    Clear,
    /// The state file was lost, and a new one is in its place.
    /// Everything is noted in the new file, and [`Fault::StateFileLost`] is latched.
    StateFileLost,
}

/// A fault, latched until cleared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[repr(u8)]
pub enum Fault {
    /// A and B of the scale changed at once, or an edge was missed.
    IllegalTransition,
    /// The MTC's counts minus the scale's are not the completed total.
    LedgerImbalance,
    /// The order of a real edge and an inversion is uncertain.
    /// They were too close, so the MTC's count is uncertain too.
    OrderUnknown,
    /// No look for so long that counts may have passed unseen.
    PollGap,
    /// Three requests in a row outside the belief window: "I still don't believe you".
    StillNotBelieved,
    /// A request reached the axis's error limit.
    ErrorLimit,
    /// A' and B' as read back do not follow from A, B and the inverters.
    ReadBackMismatch,
    /// The card could not be read or written.
    Card,
    /// The inverters at the start differ from those in the state file.
    InvertersMoved,
    /// The kernel's numbers of edges have a gap: two edges were merged into one.
    SequenceGap,
    /// The kernel's queue of edges was full, and the oldest were dropped.
    QueueOverflow,
    /// A line's level does not follow from its reported edges.
    EdgeMissed,
    /// The card's own counter overflowed.
    CounterOverflow,
    /// The card's own decoder saw an illegal transition, or disagrees with the lines.
    CounterError,
    /// The process before this one ended between the two inversions of an insertion.
    Interrupted,
    /// An edge came sooner than acceleration limit and hysteresis allow (polled cards).
    /// The gate relied on these limits, so more edges may have passed between two looks than were seen.
    BeyondLimits,
    /// The state file has lost what this axis had in effect.
    RecordLost,
    /// The real-time thread panicked or stalled. Nobody has looked at the lines since.
    ThreadLost,
    /// One channel keeps changing and the other does not, as with a broken wire.
    ChannelDead,
    /// The state file was removed, replaced, overwritten or cut short while in use.
    /// The daemon has written it again.
    StateFileLost,
}

impl From<CardFaultKind> for Fault {
    fn from(kind: CardFaultKind) -> Self {
        match kind {
            CardFaultKind::SequenceGap => Self::SequenceGap,
            CardFaultKind::QueueOverflow => Self::QueueOverflow,
            CardFaultKind::EdgeMissed => Self::EdgeMissed,
            CardFaultKind::CounterOverflow => Self::CounterOverflow,
            CardFaultKind::CounterError => Self::CounterError,
        }
    }
}

impl Fault {
    /// All faults, in the order of their bits.
    pub const ALL: [Self; 20] = [
        Self::IllegalTransition,
        Self::LedgerImbalance,
        Self::OrderUnknown,
        Self::PollGap,
        Self::StillNotBelieved,
        Self::ErrorLimit,
        Self::ReadBackMismatch,
        Self::Card,
        Self::InvertersMoved,
        Self::SequenceGap,
        Self::QueueOverflow,
        Self::EdgeMissed,
        Self::CounterOverflow,
        Self::CounterError,
        Self::Interrupted,
        Self::BeyondLimits,
        Self::RecordLost,
        Self::ThreadLost,
        Self::ChannelDead,
        Self::StateFileLost,
    ];

    /// Whether the fault puts the axis's count in doubt, so that it must be homed.
    pub const fn loses_home(self) -> bool {
        !matches!(self, Self::StillNotBelieved | Self::ErrorLimit | Self::StateFileLost)
    }
}

/// A set of faults.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FaultSet(u32);

impl FaultSet {
    /// The empty set.
    pub const NONE: Self = Self(0);

    /// Adds a fault; returns `true` when it is new.
    pub fn latch(&mut self, fault: Fault) -> bool {
        let bit = 1 << fault as u8;
        let new = self.0 & bit == 0;
        self.0 |= bit;
        new
    }

    /// Whether the set holds at least one fault.
    pub const fn any(self) -> bool {
        self.0 != 0
    }

    /// Whether the set holds this fault.
    pub const fn has(self, fault: Fault) -> bool {
        self.0 & 1 << fault as u8 != 0
    }

    /// Faults of this set that are not in the other one.
    #[must_use]
    pub const fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// The set as a number, for the state file.
    pub(crate) const fn bits(self) -> u32 {
        self.0
    }

    /// The set of such a number.
    /// `None` if it has faults that this version does not know.
    pub(crate) fn from_bits(bits: u32) -> Option<Self> {
        let known = Fault::ALL.into_iter().fold(0, |all, f| all | 1 << f as u8);
        (bits & !known == 0).then_some(Self(bits))
    }

    /// Iterates over the faults of the set.
    pub fn iter(self) -> impl Iterator<Item = Fault> {
        Fault::ALL.into_iter().filter(move |f| self.has(*f))
    }
}

/// Why a request was not accepted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Refusal {
    /// There is no such axis.
    NoSuchAxis,
    /// A fault is latched; clear it first.
    FaultLatched,
    /// The axis is not homed, or the position read back is not the home position.
    NotHomed,
    /// Corrections are disabled, and the request is not zero.
    Disabled,
    /// The disable switch is on.
    DisableSwitch,
    /// Probing mode is on.
    Probing,
    /// Feed hold is on.
    Held,
    /// Beyond the axis's maximum.
    AboveMaximum,
    /// A change beyond the belief window: "I don't believe you".
    NotBelieved,
    /// The real-time set-up is incomplete, and the card drives a real machine.
    NotArmable,
    /// An insertion is under way; ask again.
    Busy,
    /// The MTC's count is not known: only homing the MTC and the axis makes it known.
    ControllerUnknown,
    /// The MTC is off, or its ready line is not on yet.
    ControllerNotReady,
}

/// Who asked for the feed hold that is on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum FeedHoldSource {
    /// The user of this number.
    User(u32),
    /// The MTC: it was switched off, and the configuration asks for feed hold then.
    Controller,
    /// Unknown: the line was on at the start, and the state file does not say why.
    FoundOn,
}

/// Why corrections were last switched off.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum DisableReason {
    /// The daemon started; nobody has enabled them since.
    #[default]
    Start,
    /// Somebody asked for it.
    Asked,
    /// The disable switch was on.
    Switch,
    /// The MTC was off.
    Controller,
    /// The control side was silent.
    ControlStale,
    /// A fault was latched.
    Fault,
}

/// An event that the engine reports.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Event {
    /// When, on the card's clock, ns.
    pub t_ns: u64,
    /// Which axis, from 0; `None` for the machine as a whole.
    pub axis: Option<u8>,
    /// What happened, with its figures.
    pub kind: EventKind,
}

/// Kind of an [`Event`], with its figures.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(missing_docs)] // of the fields
pub enum EventKind {
    /// A request was not accepted; its total where it was a correction, else 0.
    Refused { total_counts: i64, why: Refusal },
    /// A fault was latched.
    Fault(Fault),
    /// A request passed the axis's warning limit.
    Warning { total_counts: i64 },
    /// The counter was zeroed at the known place.
    /// The control side must now confirm the position that it reads.
    HomeSet { position_counts: i64 },
    /// Homing is complete.
    /// `kept_counts` are still in the MTC's count; 0 where it has been homed too.
    Homed { kept_counts: i64 },
    /// A real edge fell into an insertion; its effect was certain and is in the ledger.
    Overlap,
    /// An insertion was given up because the process looked too late.
    Late,
    /// The mode is now this one.
    Mode(CorrectorMode),
    /// The control side is silent for too long (`true`), or is back (`false`).
    /// Corrections freeze while it is silent.
    ControlStale(bool),
    /// The MTC counts (`true`), or it was switched off and its count is unknown.
    ControllerReady(bool),
    /// The probe tripped.
    Trip(ProbeCapture),
    /// The probe tripped again before the capture was complete.
    Bounce,
}

/// Position of an axis around a trip of the probe.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProbeCapture {
    /// The trip lies between these two times, ns.
    pub trip_ns: (u64, u64),
    /// The last count edge before the trip: its place and its time, ns.
    /// The boundary between counts n − 1 and n is at n. Before a first edge there is no time.
    pub before: (i64, Option<u64>),
    /// The next count edge in the same form; `None` if the axis stopped.
    pub after: Option<(i64, u64)>,
}

impl ProbeCapture {
    /// Position at the trip, and half the width of its uncertainty, both in counts.
    /// The position is interpolated between the two neighbouring edges at constant speed.
    pub fn position_counts(&self) -> (f64, f64) {
        let (p0, t0) = self.before;
        let (lo, hi) = (self.trip_ns.0 as f64, self.trip_ns.1 as f64);
        let mid = f64::midpoint(lo, hi);
        match (t0, self.after) {
            (Some(t0), Some((p1, t1))) if t1 > t0 && p1 != p0 => {
                let per_ns = (p1 - p0) as f64 / (t1 - t0) as f64;
                let fraction = ((mid - t0 as f64) * per_ns).clamp(-1.0, 1.0);
                (p0 as f64 + fraction, ((hi - lo) / 2.0 * per_ns.abs()).min(1.0))
            }
            _ => (p0 as f64, 1.0),
        }
    }
}

/// Mode of the corrector as a whole.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum CorrectorMode {
    /// Corrections are off, frozen where they are.
    #[default]
    Disabled,
    /// Corrections are on.
    /// Insertions are made where a total is pending and the gate allows.
    Run,
    /// Everything is computed, nothing is written.
    Shadow,
    /// Probing: no corrections, positions captured.
    Probe,
    /// Feed hold is on at the operator's wish; corrections are frozen.
    Hold,
    /// A fault is latched, feed hold is on, corrections are frozen.
    Fault,
}

/// Why an axis is, or is not, correcting now.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum InsertionStatus {
    /// Nothing is pending.
    #[default]
    Done,
    /// An insertion is under way.
    Inserting,
    /// A correction is pending and the next edge opens the gate.
    WaitingForEdge,
    /// The axis is too fast for an insertion.
    TooFast,
    /// One channel has changed twice and the other not.
    /// The axis turned, oscillates over one boundary, or has a broken wire.
    OneChannel,
    /// The rate cap holds the next insertion back.
    RateCap,
    /// The axis is at rest, and its rest policy is to wait.
    AtRest,
    /// The axis is not homed since the start, or since a fault that lost its count.
    NotHomed,
    /// Corrections are off (see the mode).
    Off,
    /// The control side is silent.
    ControlStale,
    /// A fault is latched.
    Fault,
}

/// One axis, as a status shows it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct AxisStatus {
    /// Scale position, counts from the machine's zero.
    pub position_counts: i64,
    /// The MTC's count minus the scale's since homing: the left side of the ledger.
    pub mtc_minus_scale: i64,
    /// The accepted total, counts.
    pub requested: i64,
    /// Inserted counts; in shadow mode the counts that would have been inserted.
    pub completed: i64,
    /// Counts in effect in the MTC's count: `completed` outside shadow mode.
    pub in_effect: i64,
    /// Both inverters are on.
    pub inverted: bool,
    /// Counters zeroed at the known place, and the place confirmed.
    pub homed: bool,
    /// The difference of the MTC's and the scale's counts is certain.
    /// The MTC has been homed, and nothing has put it in doubt since.
    pub mtc_known: bool,
    /// Why it is or is not correcting.
    pub gate: InsertionStatus,
    /// Scale edges per second now.
    pub edge_rate_hz: f64,
    /// The axis's latched faults.
    pub faults: FaultSet,
    /// Insertions made since the start.
    pub insertions: u64,
    /// Edges at which a correction was pending and the gate was shut.
    pub waited_for_gate: u64,
    /// Real edges that fell into an insertion with a certain outcome.
    pub overlaps: u64,
    /// Insertions given up because the process looked too late.
    pub late: u64,
    /// Illegal transitions of the scale.
    pub illegal: u64,
    /// Edges that came sooner than the axis's limits allow, on a polled card.
    pub beyond_limits: u64,
}

/// The whole corrector at one moment.
#[allow(clippy::struct_excessive_bools)] // Each is a lamp of its own.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CorrectorStatus {
    /// When, on the card's clock, ns.
    pub t_ns: u64,
    /// Its mode.
    pub mode: CorrectorMode,
    /// The control side is silent.
    pub control_stale: bool,
    /// The disable switch is on.
    pub disable_switch: bool,
    /// The MTC counts; `true` too where it has no ready line.
    pub mtc_ready: bool,
    /// Corrections are enabled, whatever else is in their way.
    /// Hold and probing do not switch them off.
    pub enabled: bool,
    /// Why corrections were last switched off.
    pub off_because: DisableReason,
    /// Who asked for feed hold, if anybody. A fault asserts it too.
    pub held: Option<FeedHoldSource>,
    /// Feed hold as it is written to the card, asked for or by a fault.
    pub hold_output: bool,
    /// Looks at the card so far.
    pub polls: u64,
    /// Events that found the ring full.
    pub events_lost: u64,
    /// The machine's own latched faults.
    pub faults: FaultSet,
    /// Axes in use.
    pub axes_used: u8,
    /// Every axis that the engine can hold; only the first `axes_used` are valid.
    pub axes: [AxisStatus; MAX_AXES],
}

impl CorrectorStatus {
    /// The axes in use, in the order of the configuration.
    pub fn axes(&self) -> &[AxisStatus] {
        &self.axes[..usize::from(self.axes_used)]
    }

    /// Whether every axis's ledger balances.
    /// An axis in the middle of an insertion is left out.
    pub fn balanced(&self) -> bool {
        self.axes().iter().all(|a| a.gate == InsertionStatus::Inserting || a.mtc_minus_scale == a.in_effect)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_all_faults_three_leave_the_count_certain() {
        let mut all = FaultSet::NONE;
        for (n, fault) in Fault::ALL.into_iter().enumerate() {
            assert!(all.latch(fault) && !all.latch(fault));
            assert_eq!((all.bits(), all.iter().count()), (u32::MAX >> (31 - n), n + 1));
            assert_eq!(FaultSet::from_bits(all.bits()), Some(all));
            let mut one = FaultSet::NONE;
            one.latch(fault);
            let certain = matches!(fault, Fault::StillNotBelieved | Fault::ErrorLimit | Fault::StateFileLost);
            assert_eq!(fault.loses_home(), !certain, "{fault:?}");
            assert!(one.has(fault) && all.without(one).iter().count() == n);
        }
        assert_eq!(FaultSet::from_bits(all.bits() + 1), None, "one that this version does not know");
    }

    #[test]
    fn a_trip_lies_between_its_two_edges_in_proportion_to_the_times() {
        let capture = |trip_ns, before, after| ProbeCapture { trip_ns, before, after }.position_counts();
        // Boundaries 7 and 9 at 1000 and 5000 ns: half a count in 1000 ns.
        assert_eq!(capture((1900, 2100), (7, Some(1000)), Some((9, 5000))), (7.5, 0.05));
        assert_eq!(capture((1900, 2100), (9, Some(1000)), Some((7, 5000))), (8.5, 0.05));
        assert_eq!(
            capture((0, 8000), (7, Some(1000)), Some((9, 5000))),
            (8.0, 1.0),
            "no more than a count either way"
        );
        // After a reversal, with two edges at once, before the first edge, or at a stop, the position is known within a
        // count.
        for (before, after) in [
            ((7, Some(1000)), Some((7, 5000))),
            ((7, Some(1000)), Some((9, 1000))),
            ((7, Some(1000)), Some((9, 900))),
            ((7, None), Some((9, 5000))),
            ((7, Some(1000)), None),
        ] {
            assert_eq!(capture((1900, 2100), before, after), (7.0, 1.0), "{before:?} {after:?}");
        }
    }

    #[test]
    fn a_ledger_balances_when_every_axis_in_use_does() {
        let axis = AxisStatus { mtc_minus_scale: 4, in_effect: 4, ..AxisStatus::default() };
        let off = AxisStatus { mtc_minus_scale: 3, ..axis };
        let mut status = CorrectorStatus { axes_used: 2, ..CorrectorStatus::default() };
        status.axes[..3].copy_from_slice(&[axis, axis, off]);
        assert_eq!(status.axes(), [axis, axis]);
        assert!(status.balanced(), "the third is not in use");
        status.axes[1] = off;
        assert!(!status.balanced());
        status.axes[1].gate = InsertionStatus::Inserting;
        assert!(status.balanced(), "halfway through an insertion");
    }
}
