//! The protocol's words explained to people: refusals, faults, events.

use super::{EventReport, ProbeTripReport};
use rtec_rt::link_messages::{Event, EventKind, Fault, Refusal};
use serde::Serialize;

/// A name as the protocol writes it.
pub fn word(name: impl Serialize) -> String {
    match serde_json::to_value(name) {
        Ok(serde_json::Value::String(word)) => word,
        _ => String::new(),
    }
}

/// Explains a refusal, and what to do.
pub const fn explain_refusal(why: Refusal) -> &'static str {
    match why {
        Refusal::NoSuchAxis => "there is no such axis",
        Refusal::FaultLatched => {
            "a fault is latched: see `rtecctl status`, mend its cause, then `rtecctl clear`"
        }
        Refusal::NotHomed => "not homed: move to the home position, then `rtecctl home`",
        Refusal::Disabled => "corrections are disabled: `rtecctl enable` first",
        Refusal::DisableSwitch => "the hardware disable switch is on",
        Refusal::Held => "feed hold is on: `rtecctl hold off` first",
        Refusal::Probing => "probing mode is on: `rtecctl probe off` first",
        Refusal::AboveMaximum => "beyond max_correction_counts of this axis; nothing is changed",
        Refusal::NotBelieved => {
            "the change is larger than window_counts of this axis. Nothing is changed; --large if it is meant"
        }
        Refusal::NotArmable => {
            "the real-time set-up or the measured latency is missing and the card drives a real machine: see \
             `rtecctl status` and `rtecctl platform`"
        }
        Refusal::Busy => "an insertion is under way: ask again",
        Refusal::ControllerUnknown => {
            "nobody knows what the controller counts: home it, move to the home position, then `rtecctl home \
             --controller-homed`"
        }
        Refusal::ControllerNotReady => "the controller is off: its line mtc_ready says so",
    }
}

/// Lists axes whose MTC count is unknown, and what to do.
pub fn explain_unknown(axes: &[&str]) -> String {
    format!(
        "the controller's count is not known: {}; home the controller and move there, then `rtecctl home --controller-homed`",
        axes.join(", ")
    )
}

/// Lists axes that are not homed, and what to do.
pub fn explain_not_homed(axes: &[&str]) -> String {
    let many = if axes.len() == 1 { "axis" } else { "axes" };
    format!("{many} {}: {}", axes.join(", "), explain_refusal(Refusal::NotHomed))
}

/// Explains a fault, and what to do.
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
        Fault::BeyondLimits => {
            "an edge came sooner than max_accel and the scale's hysteresis allow, so the speed gate promised too much and \
             the MTC's count may be uncertain by a cycle: look for vibration, set max_accel_mm_s2 and hysteresis_counts \
             to what the axis does, clear, home again"
        }
        Fault::StillNotBelieved => {
            "three requests in a row were outside the belief window (window_counts): `rtecctl log` says who asked for what; \
             then clear"
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
        Fault::RecordLost => {
            "the state file has lost what this axis had in effect, or who asked for feed hold: the MTC's count is uncertain; \
             clear, home again"
        }
        Fault::ThreadLost => {
            "the real-time thread panicked or stood still, and nobody looked at the lines: see the log, restart the \
             daemon, clear, home again"
        }
        Fault::StateFileLost => {
            "the state file was removed, replaced, overwritten or cut short while the daemon wrote it. It is written anew: see \
             `rtecctl log`, find who did it, then clear"
        }
        Fault::ChannelDead => {
            "A or B of the scale changes again and again while the other never does: a wire or the receiver of that \
             channel is broken; `rtecctl card probe --watch` shows which; mend it, clear, home again"
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

impl EventReport {
    /// An event in words. `axis` gives the name and µm per count of an axis.
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
            EventKind::Homed { kept_counts: 0 } => ("homed", "homed".to_owned()),
            EventKind::Homed { kept_counts } => {
                ("homed", format!("homed, the scale alone: the controller still counts {kept_counts:+}"))
            }
            EventKind::Overlap => {
                ("overlap", "an edge fell into an insertion and is in the ledger".to_owned())
            }
            EventKind::Late => ("late", "an insertion was given up: looked too late".to_owned()),
            EventKind::Mode(mode) => ("mode", format!("mode {}", word(mode))),
            EventKind::ControlStale(true) => {
                ("control_stale", "the control side is silent: corrections are off".to_owned())
            }
            EventKind::ControlStale(false) => ("control_stale", "the control side answers again".to_owned()),
            EventKind::ControllerReady(true) => {
                ("mtc_ready", "the controller is on again: home it, then the axes".to_owned())
            }
            EventKind::ControllerReady(false) => {
                ("mtc_ready", "the controller is off: its count is not known, corrections are off".to_owned())
            }
            EventKind::Trip(capture) => {
                let (position_counts, uncertainty_counts) = capture.position_counts();
                let count_um = axis.map_or(0.0, |(_, um)| um);
                let position_mm = position_counts * count_um / 1000.0;
                trip = Some(ProbeTripReport {
                    position_counts,
                    position_mm,
                    uncertainty_counts,
                    uncertainty_um: uncertainty_counts * count_um,
                    at_ns: [capture.trip_ns.0, capture.trip_ns.1],
                    ..ProbeTripReport::default()
                });
                ("trip", format!("probe tripped at {position_counts:.3} ± {uncertainty_counts:.3} counts"))
            }
            EventKind::Bounce => {
                ("bounce", "the probe tripped again before the capture was complete".to_owned())
            }
        };
        let axis = axis.map(|(name, _)| name.to_owned());
        Self { t_ns: event.t_ns, axis, kind: kind.to_owned(), text, trip }
    }
}
