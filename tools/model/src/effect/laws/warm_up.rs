//! `warm_up.A`: a drift from the start, without a logged cause.

use crate::effect::{
    EffectInputColumns, LawDescription, Effect, RecordExtent, ThermalDependence, Input, Law, RequiredInput, Out, LawParameter, SearchGridPoint,
    ParameterRefinement, ParameterFitMethod, EffectMemory,
};
use std::sync::Arc;

#[derive(Debug)]
struct WarmUp(LawDescription);

const UM: usize = 0;
const TAU: usize = 1;

pub(super) fn law() -> Arc<dyn Law> {
    Arc::new(WarmUp(LawDescription {
        name: "warm_up".into(),
        law: "e = um·(1 − exp(−t/tau_s)), from t = 0".into(),
        cause: "warming that no sensor of the record follows".into(),
        parameters: vec![
            LawParameter::linear("um", "um", 500.0).typically(12.0)
                .within([-10_000.0, 10_000.0], "ten metres of steel 80 K warmer grow by 10 mm"),
            LawParameter::new("tau_s", "s", [30.0, 36_000.0], ParameterFitMethod::Smooth)
                .within([1e-6, 1e9], "a positive time; 30 years to warm up is no change at all")
                .refined(ParameterRefinement::TimeConstant(0.35))
                .telling_apart(),
        ],
        needs: vec![RequiredInput::Time],
        experiment: "drift from a cold start with temperatures logged at every heat source (ISO 230-3)"
            .into(),
        heat: ThermalDependence::FromStart,
        ..LawDescription::default()
    }))
}

/// The share of the final drift that is reached at a time, 0 to 1.
fn drift(t_s: f64, tau_s: f64) -> f64 {
    -(-t_s.max(0.0) / tau_s).exp_m1()
}

impl Law for WarmUp {
    fn describe(&self) -> &LawDescription {
        &self.0
    }

    fn basis(&self, effect: &Effect, now: &Input, _: usize, _: &mut EffectMemory, out: Out<'_>) {
        out[0] = drift(now.t_s, effect.scalar(TAU));
    }

    fn basis_rows(&self, effect: &Effect, bound: &EffectInputColumns<'_>, _: usize, _: &mut EffectMemory, out: Out<'_>) {
        let tau_s = effect.scalar(TAU);
        for (row, out) in out.iter_mut().enumerate() {
            *out = drift(bound.t_s[row], tau_s);
        }
    }

    fn slopes(&self, effect: &Effect, now: &Input, _: usize, _: &mut EffectMemory, out: Out<'_>) {
        let (t, tau) = (now.t_s.max(0.0), effect.scalar(TAU));
        let e = (-t / tau).exp();
        out[UM] = 1.0 - e;
        out[TAU] = -effect.scalar(UM) * e * t / (tau * tau);
    }

    fn grid(&self, effect: &Effect, records: &dyn RecordExtent) -> Vec<SearchGridPoint> {
        let all = records.time_constants_s();
        let price = (all.len() as f64).ln();
        SearchGridPoint::along(effect, TAU, all, price)
    }
}
