//! The engine as the last process left the machine: totals by the state file and the inverters, doubts latched.

use crate::Failure;
use crate::log::{Level, Log};
use rtec_control::config::{CardConfig, Config};
use rtec_control::protocol::explain_fault;
use rtec_driver::card::Card;
use rtec_rt::engine::{Engine, MachineConfig, StartError};
use rtec_rt::event::Fault;
use rtec_rt::journal::{Before, Journal, resume};

/// The engine on `card`, with its state file where the card's outputs outlive the process.
///
/// # Errors
/// A state file that cannot be used, a card that cannot be read, inverters of which nobody knows.
pub(crate) fn engine<C: Card>(card: &mut C, config: &Config, log: &mut Log) -> anyhow::Result<Engine> {
    // The outputs of a mock card end with its process: there is nothing to be taken over.
    let journal = match config.card {
        CardConfig::Gpio(_) | CardConfig::Mapped { .. } | CardConfig::Port { .. } => {
            let file = config.control.state_path();
            Some(Journal::open(&file, &config.identity()).map_err(Failure::from)?)
        }
        CardConfig::Mock | CardConfig::Replay { .. } => None,
    };
    let found = journal.as_ref().map_or(Before::NOTHING, |(_, found)| *found);
    let (completed, uncertain) = take_over(card, config, &found)?;
    let machine = MachineConfig { lines: config.lines, may_arm: false };
    let mut engine = match Engine::new(card, &config.engine_axes(), machine, &completed) {
        Ok(engine) => engine,
        Err(StartError::HalfInverted(n)) => {
            let why = format!(
                "axis {}: its two inverters are not equal, and the state file knows of no insertion that was under way. \
                 Nothing is written; switch the MTC off, set both inverters equal, start again and home",
                config.axes[n].name
            );
            return Err(Failure::Fault(why).into());
        }
        Err(error) => return Err(Failure::Unreachable(error.to_string()).into()),
    };
    for (axis, _) in config.axes.iter().zip(&completed).filter(|(_, total)| *total % 2 != 0) {
        log.say(
            Level::Error,
            &format!("axis {}: left in the middle of an insertion; it is finished now", axis.name),
        );
    }
    for (n, fault) in uncertain {
        log.say(Level::Error, &format!("axis {}: {}", config.axes[n].name, explain_fault(fault)));
        // What is latched now stands in the status from the first one on; there is no one yet to report it to.
        engine.latch(Some(n as u8), fault, card, &mut |_| true)?;
    }
    if let Some((journal, _)) = journal {
        engine.keep_journal(journal);
    }
    Ok(engine)
}

/// Totals in the axes' order, and the axes of which that is not certain.
type TakenOver = (Vec<i64>, Vec<(usize, Fault)>);

/// What each axis had completed before, from the state file and the inverters as they are; and the axes of which that is
/// not certain, with the fault to be latched.
fn take_over<C: Card>(card: &mut C, config: &Config, before: &Before) -> anyhow::Result<TakenOver> {
    let outputs = card.outputs().map_err(|e| Failure::Unreachable(e.to_string()))?;
    let (mut completed, mut uncertain) = (Vec::new(), Vec::new());
    for (n, axis) in config.axes.iter().enumerate() {
        let inverters = axis.engine.lines.inverters(outputs);
        let found = resume(before.records[n], inverters);
        if found.is_none() && !(before.first_start && inverters == 0) {
            // Without a file the inverters should be off; with one there should be a record.
            let lost = !before.first_start && before.records[n] == [None, None];
            uncertain.push((n, if lost { Fault::RecordLost } else { Fault::InvertersMoved }));
        }
        // What was latched puts the total in doubt until the axis is homed.
        uncertain.extend(found.iter().flat_map(|r| r.faults.iter()).map(|fault| (n, fault)));
        completed.push(found.map_or(0, |r| r.completed));
    }
    Ok((completed, uncertain))
}
