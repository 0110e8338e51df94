//! `thermal_growth.A`: a temperature difference moves a point.

use crate::effect::{
    EffectInputColumns, LawDescription, Effect, ThermalDependence, Input, Law, RequiredInput, Out, LawParameter,
    EffectMemory,
};
use std::sync::Arc;

/// First part of the effect's name.
pub const NAME: &str = "thermal_growth";

#[derive(Debug)]
struct ThermalGrowth(LawDescription);

/// Growth per kelvin, and per kelvin squared.
pub(super) fn gains() -> [LawParameter; 2] {
    let source = "five metres of steel (12 ppm/K) grow by 60 µm/K, and the point of a machine by less";
    [
        LawParameter::linear("um_per_K", "um/K", 60.0).typically(2.5).within([-60.0, 60.0], source),
        LawParameter::linear("um_per_K2", "um/K2", 10.0).typically(0.08)
            .within([-60.0, 60.0], "bent so far that one kelvin doubles the largest growth")
            .or(0.0),
    ]
}

pub(super) fn law() -> Arc<dyn Law> {
    Arc::new(ThermalGrowth(LawDescription {
        name: NAME.into(),
        law: "e = um_per_K·ΔT + um_per_K2·ΔT²".into(),
        cause: "spindle, housing or column growing as it warms".into(),
        experiment:
            "spindle warm-up from cold with gauges at the nose, dry and wet, then cool-down (ISO 230-3)"
                .into(),
        parameters: gains().into(),
        needs: vec![RequiredInput::Delta],
        heat: ThermalDependence::Growth,
        companion: Some(super::offset::NAME),
        ..LawDescription::default()
    }))
}

impl Law for ThermalGrowth {
    fn describe(&self) -> &LawDescription {
        &self.0
    }

    fn basis(&self, effect: &Effect, now: &Input, _: usize, _: &mut EffectMemory, out: Out<'_>) {
        let d = effect.bounded(now.delta_k);
        out[0] = d;
        out[1] = d * d;
    }

    fn basis_rows(&self, effect: &Effect, bound: &EffectInputColumns<'_>, _: usize, _: &mut EffectMemory, out: Out<'_>) {
        let (first, second) = out.split_at_mut(bound.rows());
        for (row, (a, b)) in first.iter_mut().zip(second).enumerate() {
            *a = effect.bounded(bound.delta_k(row));
            *b = *a * *a;
        }
    }
}
