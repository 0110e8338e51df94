//! `thermal_lag.A`: growth at a point that follows the sensor late.

use crate::effect::lag::{LagStepDecay, Lag};
use crate::effect::{
    EffectInputColumns, LawDescription, Effect, RecordExtent, ThermalDependence, Input, Law, RequiredInput, Out, LawParameter, SearchGridPoint,
    ParameterRefinement, ParameterFitMethod,
    EffectMemory,
};
use std::sync::Arc;

/// First part of the effect's name.
pub const NAME: &str = "thermal_lag";

#[derive(Debug)]
struct ThermalLag(LawDescription);

const TAU: usize = 2;

pub(super) fn law() -> Arc<dyn Law> {
    let tau = LawParameter::new("tau_s", "s", [30.0, 36_000.0], ParameterFitMethod::Smooth)
        .within([1e-6, 1e9], "a positive time; a lag of 30 years is no change at all")
        .refined(ParameterRefinement::TimeConstant(0.35))
        .telling_apart();
    let [linear, square] = super::thermal_growth::gains();
    Arc::new(ThermalLag(LawDescription {
        name: NAME.into(),
        law: "e = um_per_K·L + um_per_K2·L², L = ΔT passed through a first-order lag".into(),
        cause: "a massive part that follows the measured temperature late".into(),
        experiment:
            "spindle warm-up in steps, each held shorter and longer than the lag, then cool-down (ISO 230-3)"
                .into(),
        parameters: vec![linear, square, tau],
        needs: vec![RequiredInput::Delta, RequiredInput::Time],
        heat: ThermalDependence::Growth,
        companion: Some(super::offset::NAME),
        lag: Some(TAU),
        ..LawDescription::default()
    }))
}

/// The lagged ΔT and, if `SLOPE` asks for it, its derivative by tau.
/// The state holds both, with the input and the time of the previous instant.
fn advance<const SLOPE: bool>(tau_s: f64, now: &Input, state: &mut EffectMemory) -> (f64, f64) {
    let u = now.delta_k;
    if !state.started {
        *state = EffectMemory { started: true, x: [u, 0.0, u, now.t_s] };
        return (u, 0.0);
    }
    let [mut y, mut dy, u0, t0] = state.x;
    let h = now.t_s - t0;
    if h > 0.0 {
        let decay = LagStepDecay::over(h, tau_s);
        if SLOPE {
            dy = decay.step_slope(tau_s, dy, [y, u0, u]);
        }
        y = decay.step(tau_s, [y, u0, u]);
    }
    state.x = [y, dy, u, now.t_s];
    (y, dy)
}

impl Law for ThermalLag {
    fn describe(&self) -> &LawDescription {
        &self.0
    }

    fn basis(&self, effect: &Effect, now: &Input, _: usize, state: &mut EffectMemory, out: Out<'_>) {
        let (y, _) = advance::<false>(effect.scalar(TAU), now, state);
        let y = effect.bounded(y);
        out[0] = y;
        out[1] = y * y;
    }

    fn basis_rows(
        &self,
        effect: &Effect,
        bound: &EffectInputColumns<'_>,
        _: usize,
        state: &mut EffectMemory,
        out: Out<'_>,
    ) {
        let (first, second) = out.split_at_mut(bound.rows());
        let [lagged, _, input, t_s] = state.x;
        let mut lag = Lag::going_on(effect.scalar(TAU), state.started.then_some([lagged, input, t_s]));
        for (row, (a, b)) in first.iter_mut().zip(second).enumerate() {
            *a = effect.bounded(lag.next(bound.t_s[row], bound.delta_k(row)));
            *b = *a * *a;
        }
        if let Some([lagged, input, t_s]) = lag.at() {
            *state = EffectMemory { started: true, x: [lagged, 0.0, input, t_s] };
        }
    }

    fn slopes(&self, effect: &Effect, now: &Input, _: usize, state: &mut EffectMemory, out: Out<'_>) {
        let (y, dy) = advance::<true>(effect.scalar(TAU), now, state);
        let inside = effect.bounded(y);
        out[0] = inside;
        out[1] = inside * inside;
        let moved = if inside.to_bits() == y.to_bits() { dy } else { 0.0 };
        out[TAU] = (effect.scalar(0) + 2.0 * effect.scalar(1) * y) * moved;
    }

    /// Pairs of sensors are many, so they get every other time constant only.
    fn grid(&self, effect: &Effect, records: &dyn RecordExtent) -> Vec<SearchGridPoint> {
        let all = records.time_constants_s();
        let price = (all.len() as f64).ln();
        let every = if effect.delta.as_ref().is_some_and(super::super::TemperatureDifference::is_pair) { 2 } else { 1 };
        SearchGridPoint::along(effect, TAU, all.into_iter().step_by(every), price)
    }
}
