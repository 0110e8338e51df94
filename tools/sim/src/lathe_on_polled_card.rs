//! The lathe behind a polled card on a virtual clock.
//! It knows changes only by the times of its polls.

use crate::attended_machine::AttendedMachine;
use crate::lathe::Lathe;
use crate::noise::NoiseGenerator;
use rtec_driver::card::{Card, CardError, CardInputSample};

/// The card.
/// Of all its polls, only the one before a change and the one that sees it are made.
#[derive(Debug)]
pub(crate) struct PolledLatheCard {
    pub attended: Lathe,
    poll_ns: u64,
    look_ns: u64,
    second_look_ns: Option<u64>,
    noise: NoiseGenerator,
}

impl PolledLatheCard {
    pub(crate) fn new(attended: Lathe, poll_ns: f64, seed: u64) -> Self {
        let poll_ns = poll_ns.round().max(1.0) as u64;
        let noise = NoiseGenerator::new(seed, 0x900C);
        Self { attended, poll_ns, look_ns: 0, second_look_ns: None, noise }
    }

    /// Time of the next poll; at the latest `wake_ns`.
    fn next_look_ns(&mut self, wake_ns: u64) -> Result<u64, CardError> {
        let next_ns = self.look_ns + self.poll_ns;
        let wake_ns = wake_ns.max(next_ns);
        loop {
            let (quiet_until_ns, changes) = self.attended.machine_mut().quiet_until_ns();
            if quiet_until_ns > wake_ns {
                return Ok(wake_ns);
            }
            if changes {
                let before_ns =
                    quiet_until_ns.saturating_sub(1 + (self.poll_ns as f64 * self.noise.uniform()) as u64);
                // Nothing has changed since the last poll; a poll just before the change may be in the past.
                if before_ns <= self.look_ns {
                    return Ok(next_ns);
                }
                self.second_look_ns = Some(before_ns + self.poll_ns);
                return Ok(before_ns);
            }
            self.attended.run_to(quiet_until_ns);
            if self.attended.finished() || self.attended.machine().fault().is_some() {
                return Err(CardError::Ended);
            }
        }
    }
}

impl Card for PolledLatheCard {
    fn sample(&mut self, wake_ns: u64) -> Result<CardInputSample, CardError> {
        self.look_ns = match self.second_look_ns.take() {
            Some(look_ns) => look_ns,
            None => self.next_look_ns(wake_ns)?,
        };
        self.attended.run_to(self.look_ns);
        let inputs = self.attended.machine().inputs();
        Ok(CardInputSample { complete: u64::MAX, ..CardInputSample::level(self.look_ns, inputs) })
    }

    fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError> {
        self.attended.machine_mut().write(mask, value)?;
        Ok(Some(self.look_ns))
    }

    fn outputs(&mut self) -> Result<u64, CardError> {
        self.attended.machine_mut().outputs()
    }
}
