//! `angular.A.B.C`: a tilt that grows along one axis, at the lever of another.

use crate::effect::{LawDescription, Law, LinearLaw, EffectNameAxes, RequiredInput, LawParameter};
use std::sync::Arc;

pub(super) fn law() -> Arc<dyn Law> {
    let description = LawDescription {
        name: "angular".into(),
        law: "e_A = urad_per_m·p_B·p_C/1e6".into(),
        cause: "pitch, yaw or roll that grows along one axis, at the lever of another".into(),
        experiment: "the same linear displacement line at two or more offsets of the other axis (ISO 230-1)"
            .into(),
        naming: EffectNameAxes::Three,
        parameters: vec![LawParameter::linear("urad_per_m", "urad/m", 5000.0).typically(60.0).within(
            [-50_000.0, 50_000.0],
            "50 mrad in a metre: a guideway is scraped, let alone ground, a hundred times better",
        )],
        needs: vec![RequiredInput::Position(1), RequiredInput::Position(2)],
        symmetric: true,
        ..LawDescription::default()
    };
    Arc::new(LinearLaw { description, basis: |i, _, out| out[0] = i.p_mm[1] * i.p_mm[2] / 1e6 })
}
