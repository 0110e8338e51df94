//! `thermal_expansion.A`: a temperature difference changes a length.

use crate::effect::{
    EffectInputColumns, LawDescription, Effect, ThermalDependence, Input, Law, RequiredInput, Out, LawParameter, EffectMemory,
};
use std::sync::Arc;

#[derive(Debug)]
struct ThermalExpansion(LawDescription);

pub(super) fn law() -> Arc<dyn Law> {
    Arc::new(ThermalExpansion(LawDescription {
        name: "thermal_expansion".into(),
        law: "e = ppm_per_K·ΔT·p/1000".into(),
        cause: "scale, screw or work longer than at the reference temperature".into(),
        experiment: "linear displacement over the whole travel, cold and warm (ISO 230-2 and 230-3)".into(),
        parameters: vec![
            LawParameter::linear("ppm_per_K", "ppm/K", 50.0).typically(10.0)
                .within([-200.0, 200.0], "plastics grow by 200 ppm/K, metals by 5 to 30"),
        ],
        needs: vec![RequiredInput::Delta, RequiredInput::Position(0)],
        heat: ThermalDependence::Expansion,
        companion: Some(super::scale::NAME),
        ..LawDescription::default()
    }))
}

impl Law for ThermalExpansion {
    fn describe(&self) -> &LawDescription {
        &self.0
    }

    fn basis(&self, effect: &Effect, now: &Input, _: usize, _: &mut EffectMemory, out: Out<'_>) {
        out[0] = effect.bounded(now.delta_k) * now.p_mm[0] / 1000.0;
    }

    fn basis_rows(&self, effect: &Effect, bound: &EffectInputColumns<'_>, _: usize, _: &mut EffectMemory, out: Out<'_>) {
        let Some(p_mm) = bound.p_mm[0] else { return out.fill(0.0) };
        for ((row, out), p_mm) in out.iter_mut().enumerate().zip(p_mm) {
            *out = effect.bounded(bound.delta_k(row)) * p_mm / 1000.0;
        }
    }
}
