//! The status, as `rtecctl status --json` prints it.

use super::{
    PartTable, PartTableState, RunningModelReport, SensorStateReport, explain_not_homed, explain_unknown,
};
use rtec_rt::link_messages::Fault;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The state of the corrector.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DaemonStatus {
    /// The daemon's version.
    #[serde(default)]
    pub version: String,
    /// Version of its protocol: [`super::PROTOCOL`].
    #[serde(default)]
    pub protocol: u32,
    /// The machine's name, as `[machine] name` has it.
    pub machine: String,
    /// `run`, `shadow`, `probe`, `hold`, `fault` or `disabled`.
    pub mode: String,
    /// Every axis is homed.
    pub homed: bool,
    /// Corrections are enabled. Hold and probing freeze them and do not disable them.
    #[serde(default)]
    pub enabled: bool,
    /// Who asked for feed hold, while it is on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hold: Option<FeedHoldReport>,
    /// Time since the daemon's start, s.
    pub uptime_s: f64,
    /// The ledger of every axis balances.
    /// It is also `false` while an axis's MTC count is unknown, since no ledger exists then.
    pub balanced: bool,
    /// Latched faults of the machine as a whole.
    pub faults: Vec<Fault>,
    /// Every latched fault, of the machine and of its axes, with its time.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub latched_faults: Vec<LatchedFault>,
    /// Number of times each fault was latched since the daemon's start, by its word.
    #[serde(default)]
    pub latched: BTreeMap<String, u64>,
    /// Why the record of commands cannot be written now, and the number lost.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub record_trouble: Option<String>,
    /// Why nothing is corrected now, and what to do about it; empty while correcting.
    pub why_not: Vec<String>,
    /// The one of `why_not` that keeps only the model out, if any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model_refused: Option<String>,
    /// Files edited since they were read, so that the running state differs from them.
    /// Each comes with what to do.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub edited: Vec<String>,
    /// The real-time thread: set-up, losses and latencies.
    pub rt: RtStatus,
    /// The running model.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<RunningModelReport>,
    /// The loaded part table.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub table: Option<PartTable>,
    /// Error that the part table removes at this moment, if it applies.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub table_now: Option<PartTableState>,
    /// The temperature sensors, in the configuration's order.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sensors: Vec<SensorStateReport>,
    /// The axes, in the configuration's order.
    pub axes: Vec<AxisReport>,
}

impl DaemonStatus {
    /// Whether the MTC's count is known on every axis, so that the ledger can balance.
    pub fn ledger_known(&self) -> bool {
        self.axes.iter().all(|axis| axis.mtc_known)
    }

    /// Reason why positions are not valid, and what to do; none if all are homed.
    pub fn not_homed(&self) -> Option<String> {
        let names = |which: fn(&AxisReport) -> bool| -> Vec<&str> {
            self.axes.iter().filter(|a| which(a)).map(|a| a.name.as_str()).collect()
        };
        let (unknown, away) = (names(|a| !a.mtc_known), names(|a| !a.homed));
        if unknown.is_empty() {
            (!away.is_empty()).then(|| explain_not_homed(&away))
        } else {
            Some(explain_unknown(&unknown))
        }
    }
}

/// Feed hold, while it is on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FeedHoldReport {
    /// Who asked for it: a user, `the controller`, `fault`, or `unknown`.
    /// It is `unknown` if feed hold was on when the daemon started.
    pub by: String,
    /// Start of the hold, s since 1970; none if unknown. A restart keeps it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_s: Option<f64>,
}

/// A latched fault.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LatchedFault {
    /// The axis; none for the machine as a whole.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub axis: Option<String>,
    /// The fault.
    pub fault: Fault,
    /// When it was latched, s since 1970; none if unknown.
    /// A restart keeps it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_s: Option<f64>,
}

/// The real-time thread: its set-up, losses and latencies.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
// Four independent flags; an enum would not be clearer.
#[allow(clippy::struct_excessive_bools)]
pub struct RtStatus {
    /// The thread runs.
    pub alive: bool,
    /// The card's backend: `mock`, `gpio`, `mapped`, `port` or `replay`.
    pub card: String,
    /// Corrections may be enabled on this card with this set-up.
    pub may_arm: bool,
    /// The CPU it is pinned to; none for an ordinary thread.
    pub cpu: Option<usize>,
    /// Its `SCHED_FIFO` priority; none for an ordinary thread.
    pub priority: Option<u8>,
    /// Real-time settings that are wrong: name, value found, remedy.
    pub missing: Vec<String>,
    /// Looks at the card so far.
    pub polls: u64,
    /// Events lost because the ring was full.
    pub events_lost: u64,
    /// The control side has been silent too long.
    pub control_stale: bool,
    /// The disable switch is on.
    pub disable_switch: bool,
    /// The MTC is on and counts; also `true` without an `mtc_ready` line.
    #[serde(default = "ready")]
    pub mtc_ready: bool,
    /// Time between two looks, ns.
    pub poll_gap_ns: TimeDistribution,
    /// Time from an edge to the end of the insertion it opened, ns.
    pub edge_to_done_ns: TimeDistribution,
}

/// Default for a daemon that does not send the field.
const fn ready() -> bool {
    true
}

/// A distribution of times, ns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct TimeDistribution {
    /// Smallest value, ns.
    pub min: u64,
    /// Median, ns.
    pub p50: u64,
    /// 99th percentile, ns.
    pub p99: u64,
    /// 99.99th percentile, ns.
    pub p9999: u64,
    /// Largest value, ns.
    pub max: u64,
    /// Number of values.
    pub samples: u64,
}

/// One axis: its position, its correction and its ledger.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AxisReport {
    /// The axis's name, as `[[axis]] name` has it.
    pub name: String,
    /// Position by the scale since homing, counts.
    pub position_counts: i64,
    /// The same position, mm.
    pub position_mm: f64,
    /// Total correction that the engine has accepted, counts since homing.
    pub requested: i64,
    /// Inserted, counts; in shadow mode what would have been.
    pub completed: i64,
    /// Counts that the MTC's count really contains.
    pub in_effect: i64,
    /// The MTC's count minus the scale's, counts: the other side of the ledger.
    pub mtc_minus_scale: i64,
    /// Both inverters are on.
    pub inverted: bool,
    /// The axis is homed: its position and totals are valid.
    pub homed: bool,
    /// The MTC has been homed, and nothing has put its count in doubt since.
    #[serde(default)]
    pub mtc_known: bool,
    /// Why it corrects or not: `done`, `inserting`, `waiting_for_edge`, `too_fast`, …
    pub gate: String,
    /// Scale edges per second.
    pub edge_rate_hz: f64,
    /// Latched faults of this axis.
    pub faults: Vec<Fault>,
    /// Largest total that is accepted, counts.
    pub max_correction_counts: i64,
    /// Belief window: the largest change of the total that is believed at once, counts.
    pub window_counts: i64,
    /// Insertions made since the daemon's start.
    pub insertions: u64,
    /// Edges at which the gate refused an insertion.
    pub waited_for_gate: u64,
    /// Edges inside an insertion, with a certain outcome.
    pub overlaps: u64,
    /// Insertions abandoned because a look came too late.
    pub late: u64,
    /// Illegal transitions of the scale.
    pub illegal: u64,
    /// Edges closer together than the axis's limits allow, on a polled card.
    #[serde(default)]
    pub beyond_limits: u64,
    /// Speeds of the axis.
    #[serde(flatten)]
    pub rates: SpeedLimits,
}

/// Speeds up to which an axis moves, is followed and is corrected, mm/min.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct SpeedLimits {
    /// Its rapid, as configured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rapid_mm_min: Option<f64>,
    /// Speed up to which every count is seen; none if nothing limits it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub followed_mm_min: Option<f64>,
    /// Speed up to which corrections are inserted; none if there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub corrected_mm_min: Option<f64>,
}

impl std::fmt::Display for SpeedLimits {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.told("corrected at no speed"))
    }
}

impl SpeedLimits {
    /// The speeds of an axis in words: rapid, followed and corrected, mm/min.
    /// `uncorrected` is the text if no speed allows insertions.
    pub fn told(&self, uncorrected: &str) -> String {
        // Axes in tests are slow.
        let digits = |v: f64| if v < 10.0 { 4 } else { 0 };
        let figure = |speed: f64| format!("{speed:.*} mm/min", digits(speed));
        let rapid = self.rapid_mm_min.map_or_else(String::new, |v| format!("rapid {}, ", figure(v)));
        let followed = self.followed_mm_min.map_or_else(|| "any speed".to_owned(), figure);
        let corrected = self
            .corrected_mm_min
            .map_or_else(|| uncorrected.to_owned(), |v| format!("corrected up to {}", figure(v)));
        format!("{rapid}followed up to {followed}, {corrected}")
    }
}
