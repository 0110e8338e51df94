//! The control protocol: JSON lines over a Unix stream socket, one answer per request.
//!
//! ```text
//! → {"do":"correct","axis":"x","total_counts":12}
//! ← {"done":{}}
//! → {"do":"enable"}
//! ← {"refused":{"why":"not_homed","text":"…"}}
//! ```
//!
//! | request | fields |
//! |---|---|
//! | `status`, `disable`, `shadow`, `clear`, `watch` | – |
//! | `home` | `axis`; all without it |
//! | `enable` | `accept_jump` |
//! | `correct` | `axis`, `total_counts`, `large` |
//! | `probe`, `hold` | `on` |
//! | `model_load` | `file`, `take`: the hash that was shown; without it what would change is shown |
//! | `model_unload` | – |
//! | `jog` | `axis`, `display_mm`: a simulated axis only |
//! | `explain` | `axis`; all without it |
//! | `table_load` | `errors`, `axes`, `centre_mm`, `radius_mm`, `nose_mm`, `origin_mm`, `lead_ms` |
//! | `table_unload` | – |
//!
//! `watch` turns the connection into a stream of `event` answers until it is closed.

pub use rtec_correct::explain::{Change, Contribution, Explained, ModelPreview, Reading, RunningModel};
pub use rtec_correct::part_table::{PartTable, TableNow};
use rtec_rt::event::{Event, EventKind, Fault, Refusal};
use serde::{Deserialize, Serialize};

/// Longest request line, bytes.
pub const MAX_LINE: usize = 4096;

/// What a client asks for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "do", rename_all = "snake_case", deny_unknown_fields)]
pub enum ClientRequest {
    /// Asks for the whole status at this moment.
    Status {},
    /// The axis is at its known place.
    Home {
        /// Name of the axis; all axes without it.
        #[serde(default)]
        axis: Option<String>,
    },
    /// Corrections on: insertions follow the requested totals from now on.
    Enable {
        /// A jump beyond the belief window is meant.
        #[serde(default)]
        accept_jump: bool,
    },
    /// Corrections off, frozen where they are.
    Disable {},
    /// Compute everything, write nothing.
    Shadow {},
    /// The total correction of an axis.
    Correct {
        /// Name of the axis.
        axis: String,
        /// Total since homing, counts.
        total_counts: i64,
        /// A change beyond the belief window is meant.
        #[serde(default)]
        large: bool,
    },
    /// Probing mode: corrections are frozen and every trip of the probe is captured.
    Probe {
        /// `true` switches it on, `false` off.
        on: bool,
    },
    /// The hold line to the controller: feed hold while it is on.
    Hold {
        /// `true` switches it on, `false` off.
        on: bool,
    },
    /// Releases latched faults.
    Clear {},
    /// Send every event from now on.
    Watch {},
    /// A machine model: what it would change now, or take it.
    ModelLoad {
        /// The file, absolute; that of the configuration without it.
        #[serde(default)]
        file: Option<String>,
        /// Take it, if its hash is still this one.
        #[serde(default)]
        take: Option<String>,
        /// Take it although its validity has ended.
        #[serde(default)]
        expired: bool,
    },
    /// No model from now on.
    ModelUnload {},
    /// A simulated axis: jog it, and read it.
    Jog {
        /// Name of the axis.
        axis: String,
        /// Where to, as the controller displays it, mm; only read without it.
        #[serde(default)]
        display_mm: Option<f64>,
    },
    /// What each axis's correction is made of.
    Explain {
        /// Name of the axis; all axes without it.
        #[serde(default)]
        axis: Option<String>,
    },
    /// A part's errors, to be taken out where the tool cuts (`part table`), on top of everything else.
    TableLoad(PartTable),
    /// No part table from now on.
    TableUnload {},
}

impl ClientRequest {
    /// Reads a request line.
    ///
    /// # Errors
    /// What is wrong with it, and what is expected.
    pub fn parse(line: &str) -> Result<Self, String> {
        serde_json::from_str(line).map_err(|e| {
            format!("found {e}; expected one JSON object such as {{\"do\":\"status\"}} or {{\"do\":\"correct\",\"axis\":\"x\",\"total_counts\":12}}")
        })
    }
}

/// What the daemon answers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Response {
    /// The status asked for.
    Status(Box<DaemonStatus>),
    /// Done as asked.
    Done {
        /// What `enable` moves, axis by axis.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        jumps: Vec<Jump>,
    },
    /// Not done, nothing is changed.
    Refused {
        /// Why, as one word.
        why: String,
        /// Why, and what to do.
        text: String,
        /// The jumps that `enable` would make.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        jumps: Vec<Jump>,
    },
    /// A fault is latched: because of this request, or before it.
    Fault {
        /// Which fault it is, and what to do.
        text: String,
    },
    /// The request itself is wrong.
    Bad {
        /// What was found, what was expected.
        text: String,
    },
    /// An event, as it happens (after `watch`).
    Event(Box<Happened>),
    /// What a model would change.
    ModelPreview(Box<ModelPreview>),
    /// Position of a simulated axis.
    Stands {
        /// What its controller displays, mm.
        display_mm: f64,
        /// What an indicator at the axis shows, mm.
        indicator_mm: f64,
    },
    /// What corrections are made of.
    Explained {
        /// The axes asked for.
        axes: Vec<Explained>,
    },
}

/// How far an axis moves when corrections are enabled now.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Jump {
    /// Name of the axis.
    pub axis: String,
    /// Counts to be inserted.
    pub counts: i64,
    /// The same length, µm.
    pub um: f64,
    /// The axis's belief window, counts.
    pub window_counts: i64,
}

/// One event, in words.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Happened {
    /// Time of the event on the card's clock, ns.
    pub t_ns: u64,
    /// The axis; none for the machine as a whole.
    pub axis: Option<String>,
    /// What, as one word.
    pub kind: String,
    /// What, as a sentence.
    pub text: String,
    /// Where the axis was when the probe tripped.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trip: Option<TripReport>,
}

/// The position of one axis at a trip of the probe, captured by the engine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TripReport {
    /// Position, interpolated between the neighbouring edges, counts.
    pub position_counts: f64,
    /// The same position, mm.
    pub position_mm: f64,
    /// Half the width of what it may be, counts.
    pub uncertainty_counts: f64,
    /// The same half width, µm.
    #[serde(default)]
    pub uncertainty_um: f64,
    /// The trip lies between these two times of the card's clock, ns: the same for all axes.
    #[serde(default)]
    pub at_ns: [u64; 2],
    /// What the machine model says of the axis at this place, µm: to be added to the position, which is not corrected
    /// while probing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error_um: Option<f64>,
    /// The position with that taken in, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub corrected_mm: Option<f64>,
    /// Temperatures at that time, in the order of the status's sensors, °C; null where none is known.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub degc: Vec<Option<f64>>,
}

/// The state of the corrector.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DaemonStatus {
    /// The machine's name, as `[machine] name` has it.
    pub machine: String,
    /// `run`, `shadow`, `probe`, `hold`, `fault` or `disabled`.
    pub mode: String,
    /// Every axis is homed.
    pub homed: bool,
    /// Since the daemon's start, s.
    pub uptime_s: f64,
    /// The ledger of every axis balances.
    pub balanced: bool,
    /// Latched faults of the machine as a whole.
    pub faults: Vec<Fault>,
    /// Why nothing is corrected now, and what to do about it; empty while correcting.
    pub why_not: Vec<String>,
    /// The real-time thread: set-up, losses and latencies.
    pub rt: Rt,
    /// The model that runs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<RunningModel>,
    /// The part table that is loaded.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub table: Option<PartTable>,
    /// What the part table takes out at this moment, where it is in force.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub table_now: Option<TableNow>,
    /// The temperature sensors, in the configuration's order.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sensors: Vec<Reading>,
    /// The axes, in the configuration's order.
    pub axes: Vec<AxisReport>,
}

/// The real-time thread: how it was set up, what it lost, how quick it is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[allow(clippy::struct_excessive_bools)] // Each is a lamp of its own.
pub struct Rt {
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
    /// Real-time settings that are not as they should be: name, what was found, what to do.
    pub missing: Vec<String>,
    /// Looks at the card so far.
    pub polls: u64,
    /// Events that found the ring full.
    pub events_lost: u64,
    /// The control side is silent.
    pub control_stale: bool,
    /// The disable switch is on.
    pub disable_switch: bool,
    /// Time between two looks, ns.
    pub poll_gap_ns: Distribution,
    /// Time from an edge to the end of the insertion it opened, ns.
    pub edge_to_done_ns: Distribution,
}

/// A distribution of times, ns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Distribution {
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
    /// What is really in the MTC's count, counts.
    pub in_effect: i64,
    /// The MTC's count minus the scale's, counts: the other side of the ledger.
    pub mtc_minus_scale: i64,
    /// Both inverters are on.
    pub inverted: bool,
    /// The axis is homed: its position and its totals mean something.
    pub homed: bool,
    /// Why it is or is not correcting: `done`, `inserting`, `waiting_for_edge`, `too_fast`, …
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
    /// Edges at which the gate was shut.
    pub waited_for_gate: u64,
    /// Edges inside an insertion, with a certain outcome.
    pub overlaps: u64,
    /// Insertions given up because the process looked too late.
    pub late: u64,
    /// Illegal transitions of the scale.
    pub illegal: u64,
}

/// A name as the protocol writes it.
#[must_use]
pub fn word(name: impl Serialize) -> String {
    match serde_json::to_value(name) {
        Ok(serde_json::Value::String(word)) => word,
        _ => String::new(),
    }
}

/// What a refusal means, and what to do.
#[must_use]
pub const fn explain_refusal(why: Refusal) -> &'static str {
    match why {
        Refusal::NoSuchAxis => "there is no such axis",
        Refusal::FaultLatched => {
            "a fault is latched: see `rtecctl status`, mend its cause, then `rtecctl clear`"
        }
        Refusal::NotHomed => "not homed: move to the home position, then `rtecctl home`",
        Refusal::Disabled => {
            "corrections are disabled: `rtecctl enable` first; only a total of 0 is taken now"
        }
        Refusal::DisableSwitch => "the hardware disable switch is on",
        Refusal::Probing => "probing mode is on: `rtecctl probe off` first",
        Refusal::AboveMaximum => "beyond max_correction_counts of this axis; nothing is changed",
        Refusal::NotBelieved => {
            "I don't believe you: the change is larger than window_counts of this axis. Nothing is changed; --large if it \
             is meant"
        }
        Refusal::NotArmable => {
            "the real-time set-up or the measured latency is missing and the card drives a real machine: see \
             `rtecctl status` and `rtecctl platform`"
        }
        Refusal::Busy => "an insertion is under way: ask again",
    }
}

/// What a fault means, and what to do.
#[must_use]
pub const fn explain_fault(fault: Fault) -> &'static str {
    match fault {
        Fault::IllegalTransition => {
            "A and B of the scale changed at once, or an edge was missed: check the scale and its cable, clear, home again"
        }
        Fault::LedgerImbalance => {
            "counts to the MTC minus counts of the scale is not what was completed: clear, home again"
        }
        Fault::OrderUnknown => {
            "a real edge and an inversion fell together: the MTC's count is uncertain by a cycle; wire the read-back or \
             raise guard_ns, clear, home again"
        }
        Fault::PollGap => {
            "the lines were not looked at for too long: see `rtecctl platform`, clear, home again"
        }
        Fault::StillNotBelieved => {
            "I still don't believe you: three requests in a row outside the belief window; clear"
        }
        Fault::ErrorLimit => "a request reached error_counts of this axis; clear",
        Fault::ReadBackMismatch => {
            "A' and B' are not what the inverters should make of A and B: check the gates, home again"
        }
        Fault::Card => "the card could not be read or written: see the log, then restart the daemon",
        Fault::Interrupted => {
            "the daemon before this one ended in the middle of an insertion; it has been finished, but the MTC counted \
             mirrored meanwhile: clear, home again"
        }
        Fault::InvertersMoved => {
            "the inverters are not where the state file left them: the MTC's count is uncertain; clear, home again"
        }
        Fault::SequenceGap => {
            "the kernel merged two edges into one (its sequence numbers jump): the axis is too fast for these GPIO lines, \
             or their interrupt thread is kept waiting (`rtecctl platform`); clear, home again"
        }
        Fault::QueueOverflow => {
            "edges came faster than they were taken from the kernel's queue, which dropped the oldest: see \
             `rtecctl platform`, clear, home again"
        }
        Fault::EdgeMissed => {
            "a line is not where its edges have led: an edge was never reported, or with the wrong polarity; check the \
             signal and the axis's speed, clear, home again"
        }
        Fault::CounterOverflow => "the card's own counter overflowed: clear, home again",
        Fault::CounterError => {
            "the card's own decoder saw an illegal transition, or disagrees with its lines: check the scale and its \
             cable, clear, home again"
        }
    }
}

impl Happened {
    /// An event in words. `axis` gives the name and µm per count of an axis.
    #[must_use]
    pub fn of(event: &Event, axis: Option<(&str, f64)>) -> Self {
        let mut trip = None;
        let (kind, text) = match event.kind {
            EventKind::Refused { total_counts: 0, why } => {
                ("refused", format!("refused: {}", explain_refusal(why)))
            }
            EventKind::Refused { total_counts, why } => {
                ("refused", format!("{total_counts:+} counts refused: {}", explain_refusal(why)))
            }
            EventKind::Fault(fault) => ("fault", format!("{}: {}", word(fault), explain_fault(fault))),
            EventKind::Warning { total_counts } => {
                ("warning", format!("a request of {total_counts:+} counts passed the warning limit"))
            }
            EventKind::HomeSet { position_counts } => {
                ("home_set", format!("counter set to {position_counts}"))
            }
            EventKind::Homed => ("homed", "homed".to_owned()),
            EventKind::Overlap => {
                ("overlap", "an edge fell into an insertion and is in the ledger".to_owned())
            }
            EventKind::Late => ("late", "an insertion was given up: looked too late".to_owned()),
            EventKind::Mode(mode) => ("mode", format!("mode {}", word(mode))),
            EventKind::ControlStale(true) => {
                ("control_stale", "the control side is silent: corrections freeze".to_owned())
            }
            EventKind::ControlStale(false) => ("control_stale", "the control side is heard again".to_owned()),
            EventKind::Trip(capture) => {
                let (position_counts, uncertainty_counts) = capture.position_counts();
                let count_um = axis.map_or(0.0, |(_, um)| um);
                let position_mm = position_counts * count_um / 1000.0;
                trip = Some(TripReport {
                    position_counts,
                    position_mm,
                    uncertainty_counts,
                    uncertainty_um: uncertainty_counts * count_um,
                    at_ns: [capture.trip_ns.0, capture.trip_ns.1],
                    error_um: None,
                    corrected_mm: None,
                    degc: Vec::new(),
                });
                ("trip", format!("probe tripped at {position_counts:.3} ± {uncertainty_counts:.3} counts"))
            }
            EventKind::Bounce => {
                ("bounce", "the probe tripped again before the capture was complete".to_owned())
            }
        };
        Self {
            t_ns: event.t_ns,
            axis: axis.map(|(name, _)| name.to_owned()),
            kind: kind.to_owned(),
            text,
            trip,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_are_strict() {
        let ok = ClientRequest::parse(r#"{"do":"correct","axis":"x","total_counts":-4}"#).unwrap();
        assert_eq!(ok, ClientRequest::Correct { axis: "x".into(), total_counts: -4, large: false });
        assert_eq!(ClientRequest::parse(r#"{"do":"status"}"#).unwrap(), ClientRequest::Status {});
        for (line, wants) in [
            ("", "EOF"),
            ("status", "expected value"),
            (r#"{"do":"stat"}"#, "unknown variant `stat`"),
            (r#"{"do":"status","x":1}"#, "unknown field `x`"),
            (r#"{"do":"correct","axis":"x"}"#, "missing field `total_counts`"),
            (r#"{"do":"correct","axis":"x","total_counts":1.5}"#, "floating point"),
            (r#"{"do":"probe","on":"yes"}"#, "invalid type"),
        ] {
            let found = ClientRequest::parse(line).unwrap_err();
            assert!(found.contains(wants), "{found}");
        }
    }

    #[test]
    fn answers_have_the_shape_that_is_documented() {
        let done = Response::Done { jumps: Vec::new() };
        assert_eq!(serde_json::to_string(&done).unwrap(), r#"{"done":{}}"#);
        let refused = Response::Refused { why: word(Refusal::NotHomed), text: "t".into(), jumps: Vec::new() };
        assert_eq!(serde_json::to_string(&refused).unwrap(), r#"{"refused":{"why":"not_homed","text":"t"}}"#);
    }
}
