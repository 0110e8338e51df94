//! The corrected axes of a simulated machine, by engine or full-cycle design.

use crate::corrected_axis::{CardResult, CorrectedAxis as _, EventSink, GateInsertionDesign};
use crate::full_cycle_insertion::FullCycleCorrector;
use rtec_driver::card::{Card, MachineLines};
use rtec_rt::axis::AxisConfig;
use rtec_rt::engine::{Engine, MachineConfig, StartError};
use rtec_rt::link_messages::{CorrectorStatus, RequestToRt};

/// The corrected axes of a simulated machine, for any gate design.
#[derive(Debug)]
pub(crate) enum GateCorrectedAxes {
    C(Box<Engine>),
    FullCycle(FullCycleCorrector),
}

impl GateCorrectedAxes {
    /// Takes over the card in its present state.
    /// It homes axis `n` at `origins[n]` and enables corrections.
    pub(crate) fn new<C: Card>(
        design: GateInsertionDesign,
        card: &mut C,
        configs: &[AxisConfig],
        lines: MachineLines,
        origins: &[i64],
        report: &mut impl EventSink,
    ) -> Result<Self, StartError> {
        if design != GateInsertionDesign::C {
            return FullCycleCorrector::new(design, card, configs, lines, |n| origins[n])
                .map(Self::FullCycle);
        }
        let mut engine = Engine::new(card, configs, MachineConfig { lines, may_arm: true }, &[])?;
        engine.start_homed_at(card, |n| origins[n], report)?;
        Ok(Self::C(Box::new(engine)))
    }

    pub(crate) fn poll<C: Card>(
        &mut self,
        card: &mut C,
        by_ns: u64,
        report: &mut impl EventSink,
    ) -> CardResult {
        match self {
            Self::C(engine) => engine.poll(card, by_ns, report),
            Self::FullCycle(axes) => axes.poll(card, by_ns, report),
        }
    }

    pub(crate) fn take<C: Card>(
        &mut self,
        request: RequestToRt,
        card: &mut C,
        report: &mut impl EventSink,
    ) -> CardResult {
        match self {
            Self::C(engine) => engine.take(request, card, report),
            Self::FullCycle(axes) => match request {
                RequestToRt::Correct { axis, total_counts, large } => {
                    axes.correct_axis(usize::from(axis), total_counts, large, card, report)
                }
                _ => Ok(()),
            },
        }
    }

    pub(crate) fn status(&self) -> CorrectorStatus {
        match self {
            Self::C(engine) => engine.status(),
            Self::FullCycle(axes) => axes.status(),
        }
    }

    pub(crate) fn now_ns(&self) -> u64 {
        match self {
            Self::C(engine) => engine.now_ns(),
            Self::FullCycle(axes) => axes.now_ns(),
        }
    }
}
