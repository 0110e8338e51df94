//! Interface of every insertion design: poll a card, take totals, give status.
//!
//! | design | implemented by |
//! |---|---|
//! | Original RTEC, Design A (NISTIR 4832) | [`crate::full_cycle_insertion::FullCycleCorrector`] |
//! | Design B (NISTIR 4832) | [`crate::pass_through_design_b::PassThroughDesignB`] |
//! | Design C (NISTIR 4832) | [`rtec_rt::engine::Engine`], which is the one that corrects machines |
//! | Error Correction Circuit (CMTI 2014) | [`crate::error_correction_circuit::ErrorCorrectionCircuitAxis`] |

use rtec_driver::card::{AxisLines, Card, CardError, MachineLines};
use rtec_driver::quadrature::{Decoder, State};
use rtec_rt::axis::{self, AxisConfig};
use rtec_rt::engine::{Engine, MachineConfig, StartError};
use rtec_rt::link_messages::{AxisStatus, Event, RequestToRt};

/// The MTC's decoder, with the time of each change.
/// Changes at one instant are one change to it: A and B at once are an illegal transition, in either order.
#[derive(Debug, Clone, Copy)]
pub struct MtcDecoder {
    now: Decoder,
    /// The decoder before the changes of the last instant.
    before: Decoder,
    last_ns: Option<u64>,
    /// Shortest time between two changes, ns.
    /// `u64::MAX` before the second change.
    pub min_separation_ns: u64,
}

impl MtcDecoder {
    /// A decoder at rest in this state.
    pub const fn new(state: State) -> Self {
        let now = Decoder::new(state);
        Self { now, before: now, last_ns: None, min_separation_ns: u64::MAX }
    }

    /// Takes a change of A and B to this state.
    #[inline]
    pub fn update(&mut self, t_ns: u64, state: State) {
        if let Some(last_ns) = self.last_ns.replace(t_ns) {
            self.min_separation_ns = self.min_separation_ns.min(t_ns - last_ns);
            if t_ns == last_ns {
                self.now = self.before;
            }
        }
        self.before = self.now;
        self.now.update(state);
    }

    /// The decoder with its count.
    pub const fn decoder(&self) -> &Decoder {
        &self.now
    }
}

/// Nothing, or the failure of a card.
pub type CardResult = Result<(), CardError>;

/// Takes the events of a corrector, and returns whether it kept them.
pub trait EventSink: FnMut(Event) -> bool {}

impl<F: FnMut(Event) -> bool> EventSink for F {}

/// One corrected and homed axis, for a replay or a comparison of designs.
pub trait CorrectedAxis {
    /// Handles one poll of the card, at `by_ns` at the latest if the card can wait.
    ///
    /// # Errors
    /// When the card fails.
    fn poll<C: Card>(&mut self, card: &mut C, by_ns: u64, report: &mut impl EventSink) -> CardResult;

    /// Takes a new total, counts.
    ///
    /// # Errors
    /// When the card fails.
    fn correct<C: Card>(
        &mut self,
        total_counts: i64,
        large: bool,
        card: &mut C,
        report: &mut impl EventSink,
    ) -> CardResult;

    /// The present state of the axis.
    fn axis(&self) -> AxisStatus;

    /// Time of the last poll on the card's clock, ns.
    fn now_ns(&self) -> u64;

    /// Largest deviation of split pulses from 90°, and range of a pulse's time, ns.
    fn split_pulses(&self) -> (f64, Option<(u64, u64)>) {
        (0.0, None)
    }
}

impl CorrectedAxis for Engine {
    fn poll<C: Card>(&mut self, card: &mut C, by_ns: u64, report: &mut impl EventSink) -> CardResult {
        Engine::poll(self, card, by_ns, report)
    }

    fn correct<C: Card>(
        &mut self,
        total_counts: i64,
        large: bool,
        card: &mut C,
        report: &mut impl EventSink,
    ) -> CardResult {
        self.take(RequestToRt::Correct { axis: 0, total_counts, large }, card, report)
    }

    fn axis(&self) -> AxisStatus {
        self.status().axes[0]
    }

    fn now_ns(&self) -> u64 {
        Engine::now_ns(self)
    }
}

/// An engine of one axis on `card`, homed at its position, corrections enabled.
///
/// # Errors
/// When the axis cannot be corrected as configured.
pub fn homed_engine<C: Card>(
    config: AxisConfig,
    card: &mut C,
    report: &mut impl EventSink,
) -> Result<Engine, StartError> {
    let config = AxisConfig { lines: AxisLines::standard(0, false), ..config };
    let machine = MachineConfig { lines: MachineLines::default(), may_arm: true };
    let mut engine = Engine::new(card, &[config], machine, &[])?;
    engine.start_homed(card, report)?;
    Ok(engine)
}

/// The designs that invert A and B by gates.
/// They can correct several axes of a simulated machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum GateInsertionDesign {
    /// ±4 counts by two pairs of inversions, begun at A = B = low only.
    /// (NISTIR 4832, the "Original RTEC")
    Original,
    /// ±4 counts by two pairs of inversions, begun in any state.
    /// (NISTIR 4832, Design A)
    A,
    /// ±2 counts by two inversions (NISTIR 4832, Design C).
    #[default]
    C,
}

impl GateInsertionDesign {
    /// Counts of one insertion.
    pub const fn increment_counts(self) -> i64 {
        match self {
            Self::Original | Self::A => 4,
            Self::C => axis::INCREMENT_COUNTS,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_and_b_at_one_instant_are_illegal_in_either_order() {
        for [first, second] in [[1, 3], [2, 3]] {
            let mut mtc = MtcDecoder::new(State::default());
            mtc.update(50, State::from_bits(first));
            assert_eq!(mtc.min_separation_ns, u64::MAX, "one edge has no spacing");
            mtc.update(50, State::from_bits(second));
            assert_eq!((mtc.decoder().illegal(), mtc.decoder().count(), mtc.min_separation_ns), (1, 0, 0));
            // A change there and back at one instant is no change.
            mtc.update(70, State::from_bits(second ^ 1));
            mtc.update(70, State::from_bits(second));
            assert_eq!((mtc.decoder().illegal(), mtc.decoder().count()), (1, 0));
        }
    }
}
