//! Makes the engine in the state that the last process left.
//! Totals come from the state file and the inverters. Feed hold and faults stay. Every doubt is latched as a fault.

use crate::DaemonStartFailure;
use crate::stderr_journal_log::{self, SyslogLevel};
use rtec_control::config::Config;
use rtec_control::protocol::explain_fault;
use rtec_driver::card::Card;
use rtec_rt::engine::{Engine, MachineConfig, StartError};
use rtec_rt::journal::{Journal, JournalError, StateAtOpen, resume};
use rtec_rt::link_messages::{Fault, FeedHoldSource};
use rtec_rt::state_file_watch::StateFileWatch;

/// The engine on `card`, the content of its state file, and the file's watch.
/// It has a state file where the card's outputs outlive the process.
///
/// # Errors
/// When the state file cannot be used, the card cannot be read, or the state of an inverter is unknown.
pub(crate) fn engine<C: Card>(
    card: &mut C,
    config: &Config,
) -> anyhow::Result<(Engine, StateAtOpen, Option<StateFileWatch>)> {
    // The outputs of a mock card end with its process, and so does its MTC. There is no state to take over.
    let journal = if config.card.is_real() {
        let file = config.control.state_path();
        Some(Journal::open(&file, &config.identity()).map_err(DaemonStartFailure::from)?)
    } else {
        None
    };
    let before = journal.as_ref().map_or(StateAtOpen::NOTHING, |(_, found)| *found);
    let taken = take_over(card, config, &before)?;
    let completed: Vec<i64> = taken.iter().map(|t| t.completed).collect();
    let machine = MachineConfig { lines: config.lines, may_arm: false };
    let mut engine = match Engine::new(card, &config.engine_axes(), machine, &completed) {
        Ok(engine) => engine,
        Err(StartError::HalfInverted(n)) => {
            let why = format!(
                "axis {}: its two inverters are not equal, and the state file knows of no insertion that was under way. \
                 Nothing is written; switch the MTC off, set both inverters equal, start again and home",
                config.axes[n].name
            );
            return Err(DaemonStartFailure::Fault(why).into());
        }
        Err(error) => return Err(DaemonStartFailure::Unreachable(error.to_string()).into()),
    };
    if config.hold_without_mtc {
        engine.hold_without_mtc();
    }
    for (n, axis) in taken.iter().enumerate() {
        let name = &config.axes[n].name;
        if axis.completed % 2 != 0 {
            let text = format!("axis {name}: left in the middle of an insertion; it is finished now");
            stderr_journal_log::say(SyslogLevel::Error, &text);
        }
        if journal.is_some() && !axis.mtc_known {
            engine.lose_controller(n);
        }
        for &fault in &axis.faults {
            stderr_journal_log::say(SyslogLevel::Error, &format!("axis {name}: {}", explain_fault(fault)));
            // The fault is in the first status. Nobody is there yet to get an event.
            engine.latch(Some(n as u8), fault, card, &mut |_| true)?;
        }
    }
    let unknown_hold = before.hold_unexplained();
    let lost = [(before.thread_lost, Fault::ThreadLost), (unknown_hold, Fault::RecordLost)];
    let lost = lost.into_iter().filter_map(|(lost, fault)| lost.then_some(fault));
    for fault in before.machine.iter().flat_map(|m| m.faults.iter()).chain(lost) {
        stderr_journal_log::say(SyslogLevel::Error, explain_fault(fault));
        engine.latch(None, fault, card, &mut |_| true)?;
    }
    // If the file does not say why feed hold is on, it stays on.
    if let Some(machine) = before.machine.filter(|m| m.hold_output) {
        engine.take_over_hold(machine.held);
    }
    if unknown_hold && engine.status().held.is_none() {
        engine.take_over_hold(Some(FeedHoldSource::FoundOn));
    }
    say_found(&engine, config, &before);
    let kept = journal.map(|(journal, _)| engine.keep_journal(journal)).transpose();
    let state_file = kept.map_err(|source| {
        let path = config.control.state_path();
        DaemonStartFailure::from(JournalError::Io { path, source })
    })?;
    Ok((engine, before, state_file.flatten()))
}

/// Why the MTC's count is unknown when the state file is of another boot.
pub(crate) const OTHER_BOOT: &str =
    "the computer was restarted: the state file is of before, and the controller may have lost its power too";

/// Logs the state that was taken over, and what is unknown.
fn say_found(engine: &Engine, config: &Config, before: &StateAtOpen) {
    if before.older {
        let text = "the state file is of the version before: it says nothing of feed hold, nor whether the controller was homed";
        stderr_journal_log::say(SyslogLevel::Warning, text);
    }
    if before.other_boot {
        stderr_journal_log::say(SyslogLevel::Warning, OTHER_BOOT);
    }
    let status = engine.status();
    match status.held {
        Some(FeedHoldSource::FoundOn) => {
            stderr_journal_log::say(
                SyslogLevel::Warning,
                "feed hold was found on; nobody knows who asked for it",
            );
        }
        Some(FeedHoldSource::Controller) => {
            stderr_journal_log::say(SyslogLevel::Warning, "feed hold: the controller was off");
        }
        Some(FeedHoldSource::User(uid)) => {
            stderr_journal_log::say(
                SyslogLevel::Warning,
                &format!("feed hold: user {uid} asked for it before the restart"),
            );
        }
        None => {}
    }
    let axes = config.axes.iter().zip(status.axes());
    let unknown: Vec<&str> = axes.filter(|(_, s)| !s.mtc_known).map(|(a, _)| a.name.as_str()).collect();
    if !unknown.is_empty() {
        let text = format!(
            "nobody knows what the controller counts of {}: home it, then `rtecctl home --controller-homed`",
            unknown.join(", ")
        );
        stderr_journal_log::say(SyslogLevel::Warning, &text);
    }
}

/// State of an axis that the last process left.
struct RestoredAxisState {
    completed: i64,
    mtc_known: bool,
    faults: Vec<Fault>,
}

/// The completed total of each axis, and the faults to latch.
/// They follow from the state file and the present inverters.
fn take_over<C: Card>(
    card: &mut C,
    config: &Config,
    before: &StateAtOpen,
) -> anyhow::Result<Vec<RestoredAxisState>> {
    let outputs = card.outputs().map_err(|e| DaemonStartFailure::Unreachable(e.to_string()))?;
    let axes = config.axes.iter().zip(before.records.iter().zip(before.damaged)).map(
        |(axis, (records, damaged))| {
            let inverters = axis.engine.lines.inverters(outputs);
            let found = resume(*records, inverters);
            // Only `clear` ends a fault, whatever the inverters show.
            let newest = records.iter().flatten().next();
            let mut faults: Vec<Fault> = newest.iter().flat_map(|r| r.faults.iter()).collect();
            if found.is_none() && !(before.first_start && inverters == 0) {
                // Without a file the inverters should be off. With a file there should be a record.
                let lost = !before.first_start && newest.is_none();
                faults.push(if lost { Fault::RecordLost } else { Fault::InvertersMoved });
            }
            if damaged && !faults.contains(&Fault::RecordLost) {
                faults.push(Fault::RecordLost);
            }
            let (completed, mtc_known) =
                found.map_or((0, false), |r| (r.completed, r.mtc_known && !before.other_boot));
            RestoredAxisState { completed, mtc_known, faults }
        },
    );
    Ok(axes.collect())
}
