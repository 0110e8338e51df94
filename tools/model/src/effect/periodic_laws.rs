//! Waves along a position.
//!
//! Amplitude and phase stand for two linear coefficients, amplitude times cosine and sine of the phase.

use super::{
    Effect, EffectMemory, Input, Law, LawDescription, LawParameter, Out, ParameterFitMethod,
    ParameterValueError,
};
use std::f64::consts::TAU;

/// Indices of period, amplitude and phase among the parameters.
const PERIOD: usize = 0;
const UM: usize = 1;
const PHASE: usize = 2;

/// um·sin(2πp/period + phase).
#[derive(Debug)]
pub(super) struct SineLaw {
    pub(super) description: LawDescription,
    /// Unit of the period, mm.
    pub(super) unit_mm: f64,
    /// Largest amplitude in periods, if the amplitude is bound to the period.
    pub(super) most_periods: Option<f64>,
    /// Whether the amplitude grows in proportion to the position: it is then per metre.
    pub(super) grows: bool,
}

/// The amplitude of a periodic law: above zero.
pub(super) fn amplitude(plausible: f64, typical: f64) -> LawParameter {
    LawParameter::new("um", "um", [0.0, plausible], ParameterFitMethod::Amplitude).typically(typical)
}

/// The phase of a periodic law.
pub(super) fn phase() -> LawParameter {
    LawParameter::new("phase_rad", "rad", [-TAU / 2.0, TAU / 2.0], ParameterFitMethod::Phase)
        .within([-1e3, 1e3], "whole turns change nothing")
        .or(0.0)
}

/// The period of a wave, of which a model may have several.
pub(super) fn period(name: &str, unit: &str, bounds: [f64; 2], source: &str) -> LawParameter {
    LawParameter::new(name, unit, bounds, ParameterFitMethod::Smooth).within(bounds, source).telling_apart()
}

/// The coefficients of a periodic law from its amplitude and phase.
pub(super) fn polar(effect: &Effect, um: usize, phase: usize, out: Out<'_>) {
    let (sin, cos) = effect.scalar(phase).sin_cos();
    (out[0], out[1]) = (effect.scalar(um) * cos, effect.scalar(um) * sin);
}

/// Sets amplitude and phase from the coefficients of a periodic law.
pub(super) fn set_polar(effect: &mut Effect, um: usize, phase: usize, from: &[f64]) {
    effect.get_mut(um)[0] = from[0].hypot(from[1]);
    effect.get_mut(phase)[0] = from[1].atan2(from[0]);
}

impl SineLaw {
    fn argument(&self, effect: &Effect, now: &Input) -> f64 {
        // Whole periods are removed first, so that the argument keeps its digits over long travel.
        TAU * (now.p_mm[0] / (effect.scalar(PERIOD) * self.unit_mm)).fract()
    }

    fn factor(&self, now: &Input) -> f64 {
        if self.grows { now.p_mm[0] / 1000.0 } else { 1.0 }
    }
}

impl Law for SineLaw {
    fn describe(&self) -> &LawDescription {
        &self.description
    }

    fn basis(&self, effect: &Effect, now: &Input, _: usize, _: &mut EffectMemory, out: Out<'_>) {
        // um·sin(x + φ) = um·cos φ·sin x + um·sin φ·cos x
        let (sin, cos) = self.argument(effect, now).sin_cos();
        (out[0], out[1]) = (self.factor(now) * sin, self.factor(now) * cos);
    }

    fn slopes(&self, effect: &Effect, now: &Input, _: usize, _: &mut EffectMemory, out: Out<'_>) {
        let (sin, cos) = (self.argument(effect, now) + effect.scalar(PHASE)).sin_cos();
        let (sin, cos) = (self.factor(now) * sin, self.factor(now) * cos);
        let (a, period) = (effect.scalar(UM), effect.scalar(PERIOD));
        out[UM] = sin;
        out[PHASE] = a * cos;
        out[PERIOD] = -a * cos * TAU * now.p_mm[0] / (period * period * self.unit_mm);
    }

    fn coefficients(&self, effect: &Effect, out: Out<'_>) {
        polar(effect, UM, PHASE, out);
    }

    fn set_coefficients(&self, effect: &mut Effect, from: &[f64]) {
        set_polar(effect, UM, PHASE, from);
    }

    fn coefficient_count(&self, _: usize) -> usize {
        2
    }

    fn check(&self, effect: &Effect) -> Result<(), ParameterValueError> {
        let Some(most) = self.most_periods else { return Ok(()) };
        let (um, largest) = (effect.scalar(UM), most * effect.scalar(PERIOD));
        if um.abs() <= largest {
            return Ok(());
        }
        Err(ParameterValueError::new(
            "um",
            format!("{um}"),
            format!("at most {largest} um, {most} of the period"),
        ))
    }
}
