//! What every insertion design does: look at a card, take totals, give status.
//!
//! | design | implemented by |
//! |---|---|
//! | Original RTEC, Design A (NISTIR 4832) | [`crate::full_cycle::FullCycle`] |
//! | Design B (NISTIR 4832) | [`crate::through::DesignB`] |
//! | Design C (NISTIR 4832) | [`rtec_rt::engine::Engine`], which is the one that corrects machines |
//! | Error Correction Circuit (CMTI 2014) | [`crate::ecc::Ecc`] |

use rtec_driver::card::{AxisLines, Card, CardError, MachineLines};
use rtec_rt::axis::{self, AxisConfig};
use rtec_rt::engine::{Engine, MachineConfig, StartError};
use rtec_rt::event::{AxisStatus, Event, Request};

/// One corrected axis, homed: what a replay, or a comparison of designs, drives.
pub trait CorrectedAxis {
    /// One look at the card and everything that follows from it.
    /// A card that can wait does so at most until `by_ns`.
    ///
    /// # Errors
    /// When the card fails.
    fn poll<C: Card>(
        &mut self,
        card: &mut C,
        by_ns: u64,
        report: &mut impl FnMut(Event) -> bool,
    ) -> Result<(), CardError>;

    /// Takes a new total, counts.
    ///
    /// # Errors
    /// When the card fails.
    fn correct<C: Card>(
        &mut self,
        total_counts: i64,
        large: bool,
        card: &mut C,
        report: &mut impl FnMut(Event) -> bool,
    ) -> Result<(), CardError>;

    /// The axis at this moment.
    fn axis(&self) -> AxisStatus;

    /// The card's time of the last look, ns.
    fn now_ns(&self) -> u64;
}

impl CorrectedAxis for Engine {
    fn poll<C: Card>(
        &mut self,
        card: &mut C,
        by_ns: u64,
        report: &mut impl FnMut(Event) -> bool,
    ) -> Result<(), CardError> {
        Engine::poll(self, card, by_ns, report)
    }

    fn correct<C: Card>(
        &mut self,
        total_counts: i64,
        large: bool,
        card: &mut C,
        report: &mut impl FnMut(Event) -> bool,
    ) -> Result<(), CardError> {
        self.take(Request::Correct { axis: 0, total_counts, large }, card, report)
    }

    fn axis(&self) -> AxisStatus {
        self.status().axes[0]
    }

    fn now_ns(&self) -> u64 {
        Engine::now_ns(self)
    }
}

/// An engine of one axis on `card`, homed where it stands, corrections enabled.
///
/// # Errors
/// When the axis cannot be corrected as configured.
pub fn homed_engine<C: Card>(
    config: AxisConfig,
    card: &mut C,
    report: &mut impl FnMut(Event) -> bool,
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
pub enum GateDesign {
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

impl GateDesign {
    /// Counts of one insertion.
    #[must_use]
    pub const fn increment_counts(self) -> i64 {
        match self {
            Self::Original | Self::A => 4,
            Self::C => axis::INCREMENT_COUNTS,
        }
    }
}
