//! The control protocol: JSON lines over a Unix stream socket.
//! Each request has one answer.
//!
//! ```text
//! → {"do":"correct","axis":"x","total_counts":12}
//! ← {"done":{}}
//! → {"do":"enable"}
//! ← {"refused":{"why":"not_homed","text":"…"}}
//! ```
//!
//! A connection's role, and so what it may request, depends on its socket ([`crate::client_role`]).
//!
//! `watch` turns the connection into a stream of `event` answers until it is closed.
//!
//! A file is read with its caller's rights: the open descriptor comes with the request's line (`SCM_RIGHTS`, unix(7)), one for
//! `table_load`, for `model_load` one per name in `files`: the model first, then the dictionary and the chain that it names.
//! Without descriptors a path is only opened for root, for the daemon's own user, and if it is the configuration's own.

mod explanations;
mod status;

use crate::client_role::ClientRole;
pub use explanations::{explain_fault, explain_not_homed, explain_refusal, explain_unknown, word};
pub use rtec_correct::explain::{
    AxisCorrectionComponents, AxisTotalChange, CorrectionComponent, ModelChangePreview, RunningModelReport,
    SensorStateReport,
};
pub use rtec_correct::part_table::{PartTable, PartTableState};
use rtec_files::message_text::printable;
use serde::{Deserialize, Serialize};
pub use status::{
    AxisReport, DaemonStatus, FeedHoldReport, LatchedFault, RtStatus, SpeedLimits, TimeDistribution,
};

/// Version of this protocol.
/// New fields and requests do not raise it; a change of existing ones does.
pub const PROTOCOL: u32 = 1;
/// Longest request line, bytes.
pub const MAX_LINE: usize = 4096;

/// A client's request.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "do", rename_all = "snake_case", deny_unknown_fields)]
pub enum ClientRequest {
    /// Asks for the whole status at this moment.
    Status {},
    /// The axis is at its home position.
    Home {
        /// Name of the axis; all axes without it.
        #[serde(default)]
        axis: Option<String>,
        /// Whether the MTC has been homed there too.
        /// If `true`, the MTC's count contains none of the counts inserted before. If `false`, the total is
        /// kept. Without it, an axis with inserted counts at the MTC is refused.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        controller_homed: Option<bool>,
    },
    /// Corrections on: insertions follow the requested totals from now on.
    Enable {
        /// A jump beyond the belief window is intended.
        #[serde(default)]
        accept_jump: bool,
    },
    /// Corrections off; the inserted counts stay.
    Disable {},
    /// As `disable`, at the end of `rtecctl park`; the record of commands notes it.
    Park {},
    /// Compute everything, write nothing.
    Shadow {},
    /// Requests the total correction of an axis.
    Correct {
        /// Name of the axis.
        axis: String,
        /// Total since homing, counts.
        total_counts: i64,
        /// A change beyond the belief window is intended.
        #[serde(default)]
        large: bool,
    },
    /// Probing mode: corrections are frozen and every trip of the probe is captured.
    Probe {
        /// `true` switches it on, `false` off.
        on: bool,
    },
    /// Sets the hold line to the controller: feed hold while it is on.
    Hold {
        /// `true` switches it on, `false` off.
        on: bool,
    },
    /// Releases latched faults.
    Clear {},
    /// Sends every event from now on.
    Watch {},
    /// Asks for changes of an axis's ledger since homing, a page at a time.
    Ledger {
        /// Name of the axis.
        axis: String,
        /// Number of the first change wanted.
        #[serde(default)]
        from: u64,
    },
    /// Shows what a machine model would change now, or takes it.
    ModelLoad {
        /// Absolute path of the file; without it, the configuration's.
        #[serde(default)]
        file: Option<String>,
        /// Takes the model if its hash is still this one.
        #[serde(default)]
        take: Option<String>,
        /// Takes it although its validity has ended.
        #[serde(default)]
        expired: bool,
        /// Absolute paths of the descriptors that come with this line, in order.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        files: Vec<String>,
    },
    /// Unloads the model.
    ModelUnload {},
    /// Loads the last unloaded model again, as it was read then.
    ModelAgain {},
    /// Jogs a simulated axis and reads its position.
    Jog {
        /// Name of the axis.
        axis: String,
        /// Target as the controller displays it, mm; without it only read.
        #[serde(default)]
        display_mm: Option<f64>,
        /// The axis goes on to and fro, as before it was jogged.
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        go_on: bool,
    },
    /// Asks for the components of each axis's correction.
    Explain {
        /// Name of the axis; all axes without it.
        #[serde(default)]
        axis: Option<String>,
    },
    /// Loads a part's errors (`part table`), which are removed where the tool cuts.
    /// They are added to the other sources.
    TableLoad(PartTable),
    /// Unloads the part table.
    TableUnload {},
    /// Passes a finished run record to the spool folder.
    /// The descriptors of its sidecar and its CSV come with this line. Without descriptors it only asks
    /// whether records are kept.
    Keep {
        /// Their names, in that order.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        files: Vec<String>,
    },
    /// Asks for everything that can be seen now, in one answer.
    Observe {
        /// Number of the last event already known.
        /// Without it, all kept events are sent.
        #[serde(default)]
        events_after: Option<u64>,
    },
    /// Asks as whom the daemon knows this connection.
    Whoami {},
}

impl ClientRequest {
    /// The lowest role that may make this request.
    pub const fn needs(&self) -> ClientRole {
        match self {
            Self::Status {}
            | Self::Watch {}
            | Self::Explain { .. }
            | Self::Observe { .. }
            | Self::Ledger { .. }
            | Self::Whoami {} => ClientRole::View,
            Self::Home { .. }
            | Self::Enable { .. }
            | Self::Disable {}
            | Self::Park {}
            | Self::Shadow {}
            | Self::Probe { .. }
            | Self::Hold { .. }
            | Self::Jog { .. }
            | Self::ModelAgain {}
            | Self::Keep { .. } => ClientRole::Operate,
            Self::Correct { .. }
            | Self::Clear {}
            | Self::ModelLoad { .. }
            | Self::ModelUnload {}
            | Self::TableLoad(_)
            | Self::TableUnload {} => ClientRole::SetUp,
        }
    }

    /// Reads a request line.
    ///
    /// # Errors
    /// The mistake in the line, and what is expected.
    pub fn parse(line: &str) -> Result<Self, String> {
        serde_json::from_str(line).map_err(|e| {
            let found = printable(&e.to_string()).into_owned();
            format!("found {found}; expected one JSON object such as {{\"do\":\"status\"}} or {{\"do\":\"correct\",\"axis\":\"x\",\"total_counts\":12}}")
        })
    }
}

/// The daemon's answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DaemonResponse {
    /// The requested status.
    Status(Box<DaemonStatus>),
    /// Done as requested.
    Done {
        /// Movements that `enable` causes, axis by axis.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        jumps: Vec<EnableJump>,
        /// Corrections were on before `enable`, which moves nothing then.
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        already: bool,
        /// Consequences of the request that may not be intended.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        warnings: Vec<String>,
    },
    /// Not done, and nothing was changed.
    Refused {
        /// Reason as one word.
        why: String,
        /// Reason, and what to do.
        text: String,
        /// The jumps that `enable` would make.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        jumps: Vec<EnableJump>,
    },
    /// A fault is latched: because of this request, or before it.
    Fault {
        /// Which fault it is, and what to do.
        text: String,
    },
    /// The request itself is wrong.
    Bad {
        /// What was found, and what was expected.
        text: String,
    },
    /// An event, sent as it happens (after `watch`).
    Event(Box<EventReport>),
    /// Changes that a model would make.
    ModelPreview(Box<ModelChangePreview>),
    /// Position of a simulated axis.
    Stands {
        /// Position that its controller displays, mm.
        display_mm: f64,
        /// Position that an indicator at the axis shows, mm.
        indicator_mm: f64,
    },
    /// A page of an axis's ledger.
    Ledger(LedgerPage),
    /// Components of the corrections.
    Explained {
        /// The requested axes.
        axes: Vec<AxisCorrectionComponents>,
    },
    /// Everything that can be seen.
    Observed(Box<DaemonSnapshot>),
    /// The caller, as the daemon knows it.
    Whoami(Box<ClientProcess>),
}

impl DaemonResponse {
    /// Done, without jumps or warnings.
    pub const fn done() -> Self {
        Self::done_with(Vec::new())
    }

    /// Done without jumps, with these warnings.
    pub const fn done_with(warnings: Vec<String>) -> Self {
        Self::Done { jumps: Vec::new(), already: false, warnings }
    }

    /// A refusal without jumps: its word, and its text for people.
    pub fn refused(why: impl Into<String>, text: impl Into<String>) -> Self {
        Self::Refused { why: why.into(), text: text.into(), jumps: Vec::new() }
    }
}

/// Everything that can be seen, for programs that watch the daemon.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DaemonSnapshot {
    /// As `status` answers.
    pub status: DaemonStatus,
    /// As `explain` answers, for all axes.
    pub explained: Vec<AxisCorrectionComponents>,
    /// Events after the last known one, oldest first.
    pub events: Vec<NumberedEvent>,
    /// Number of events after the last known one that are no longer kept.
    pub events_missed: u64,
    /// Distributions of times.
    pub histograms: RtLoopHistograms,
    /// The record of commands.
    pub log: AuditLogState,
    /// Connections, by role.
    pub clients: Vec<RoleConnectionCounts>,
}

/// An event and its number since the daemon's start, from 1.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NumberedEvent {
    /// Its number.
    pub n: u64,
    /// Time at which the daemon received it, s since 1970.
    pub at_s: f64,
    /// The event.
    pub event: EventReport,
}

/// Whole distributions of the real-time thread's times.
/// Each non-empty bucket is `[low_ns, high_ns, count]`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RtLoopHistograms {
    /// Time between two looks, ns.
    pub poll_gap_ns: Vec<[u64; 3]>,
    /// Time from an edge to the end of the insertion it opened, ns.
    pub edge_to_done_ns: Vec<[u64; 3]>,
    /// Sum of all times between two looks, ns.
    #[serde(default)]
    pub poll_gap_sum_ns: u64,
    /// Sum of all times from an edge to the end of its insertion, ns.
    #[serde(default)]
    pub edge_to_done_sum_ns: u64,
}

/// State of the record of commands.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct AuditLogState {
    /// Its file.
    pub file: String,
    /// Number of its last line; 0 before the first.
    pub last_n: u64,
    /// Hash of its last line.
    pub last_hash: String,
    /// Commands that could not be recorded since the start.
    pub lost: u64,
    /// What prevents recording now, if anything.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trouble: Option<String>,
}

impl AuditLogState {
    /// What prevents recording now, in words.
    pub fn in_words(&self) -> Option<String> {
        let why = self.trouble.as_ref()?;
        Some(format!("{}: {why}; {} commands are not recorded, corrections go on", self.file, self.lost))
    }
}

/// Connections of one role.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RoleConnectionCounts {
    /// The role.
    pub role: ClientRole,
    /// Number of connections.
    pub connected: usize,
    /// Number of those that watch.
    pub watching: usize,
}

/// The other end of a connection, as the kernel identifies it (`SO_PEERCRED`).
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClientProcess {
    /// User number.
    pub uid: u32,
    /// User name, if the number has one.
    pub user: String,
    /// Process number, as the daemon sees it.
    pub pid: i32,
    /// The process's executable, if it can be seen.
    pub exe: String,
    /// The role of the socket.
    pub role: String,
    /// Requests that this role may make.
    pub may: Vec<String>,
    /// The socket that it connected to.
    pub socket: String,
}

/// A page of the changes of an axis's ledger.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct LedgerPage {
    /// Number of the first row.
    /// They are counted since homing, or since the daemon's start.
    pub first: u64,
    /// The rows, oldest first.
    pub rows: Vec<LedgerRow>,
    /// Number of the next row to come.
    pub end: u64,
    /// Rows that are no longer kept: the oldest ones.
    pub dropped: u64,
    /// Time of the daemon's last look, on the card's clock, ns.
    pub now_ns: u64,
    /// Position at that look, counts.
    pub now_counts: i64,
}

/// A change of an axis's ledger, seen between two looks of the daemon (some 10 ms).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct LedgerRow {
    /// Time of the look before, on the card's clock, ns.
    pub since_ns: u64,
    /// Position then, counts.
    pub since_counts: i64,
    /// Time of the look that saw the change, ns.
    pub t_ns: u64,
    /// Position then, counts.
    pub position_counts: i64,
    /// Accepted total, counts.
    pub requested: i64,
    /// Inserted, counts; in shadow mode what would have been.
    pub completed: i64,
    /// Counts that the MTC's count really contains.
    pub in_effect: i64,
    /// Insertions since the daemon's start.
    pub insertions: u64,
}

/// Movement of an axis if corrections are enabled now.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EnableJump {
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
pub struct EventReport {
    /// Time of the event on the card's clock, ns.
    pub t_ns: u64,
    /// The axis; none for the machine as a whole.
    pub axis: Option<String>,
    /// Kind of the event, as one word.
    pub kind: String,
    /// The event as a sentence.
    pub text: String,
    /// Position of the axis when the probe tripped.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trip: Option<ProbeTripReport>,
}

/// The position of one axis at a trip of the probe, captured by the engine.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ProbeTripReport {
    /// Position, interpolated between the neighbouring edges, counts.
    pub position_counts: f64,
    /// The same position, mm.
    pub position_mm: f64,
    /// Half width of its interval, counts.
    pub uncertainty_counts: f64,
    /// The same half width, µm.
    #[serde(default)]
    pub uncertainty_um: f64,
    /// The earliest and latest time of the trip on the card's clock, ns, for all axes.
    #[serde(default)]
    pub at_ns: [u64; 2],
    /// The model's error of the axis at this place, µm.
    /// Add it to the position, which is not corrected while probing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error_um: Option<f64>,
    /// The position with that error added, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub corrected_mm: Option<f64>,
    /// Temperatures at that time, in the order of the status's sensors, °C.
    /// Null if one is not known.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub degc: Vec<Option<f64>>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use rtec_rt::link_messages::Refusal;

    /// The documented list and the applied rule agree.
    #[test]
    fn what_a_role_may_is_what_it_needs() {
        let fields = r#""axis":"x","total_counts":1,"on":true,"errors":"e","axes":["z","x"],"centre_mm":[0,0],
                        "radius_mm":1,"nose_mm":1,"origin_mm":[0,0],"lead_ms":1"#;
        let all = ClientRole::SetUp.may();
        for name in &all {
            // The first subset of fields that this request accepts.
            let takes = |keys: &[&str]| {
                let given: serde_json::Map<String, serde_json::Value> =
                    serde_json::from_str(&format!("{{{fields}}}")).unwrap();
                let mut map: serde_json::Map<String, serde_json::Value> =
                    given.into_iter().filter(|(k, _)| keys.contains(&k.as_str())).collect();
                map.insert("do".into(), (*name).into());
                ClientRequest::parse(&serde_json::Value::Object(map).to_string()).ok()
            };
            let table =
                ["errors", "axes", "centre_mm", "radius_mm", "nose_mm", "origin_mm", "lead_ms"].as_slice();
            let request = [&[][..], &["axis"], &["axis", "total_counts"], &["on"], table]
                .into_iter()
                .find_map(takes)
                .unwrap_or_else(|| panic!("{name}"));
            let needed = request.needs();
            for role in ClientRole::ALL {
                assert_eq!(role.may().contains(name), needed <= role, "{name} {role}");
            }
        }
    }

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
            (r#"{"do":"\u001b[2J"}"#, "unknown variant `\\u{1b}[2J`"),
        ] {
            let found = ClientRequest::parse(line).unwrap_err();
            assert!(found.contains(wants), "{found}");
        }
    }

    /// Every request of the document for other programs is accepted.
    #[test]
    fn the_document_s_requests_are_taken() {
        let text = include_str!("../../guide/reference/protocol.md");
        assert!(text.starts_with(&format!("# The control protocol, version {PROTOCOL}\n")));
        let requests: Vec<_> = text.lines().filter(|l| l.starts_with("{\"do\"")).collect();
        assert_eq!(requests.len(), 15);
        for line in requests {
            ClientRequest::parse(line).unwrap();
        }
        for name in ClientRole::SetUp.may() {
            assert!(text.contains(&format!("\"{name}\"")) || text.contains(&format!("`{name}`")), "{name}");
        }
    }

    #[test]
    fn answers_have_the_shape_that_is_documented() {
        let done = DaemonResponse::done();
        assert_eq!(serde_json::to_string(&done).unwrap(), r#"{"done":{}}"#);
        let refused = DaemonResponse::refused(word(Refusal::NotHomed), "t");
        assert_eq!(serde_json::to_string(&refused).unwrap(), r#"{"refused":{"why":"not_homed","text":"t"}}"#);
    }
}
