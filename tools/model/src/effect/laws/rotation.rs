//! `rotation.A.B`: the work or plate is turned in the plane of two axes.

use crate::effect::{LawDescription, Law, LinearLaw, EffectNameAxes, RequiredInput, LawParameter};
use std::sync::Arc;

pub(super) fn law() -> Arc<dyn Law> {
    let description = LawDescription {
        name: "rotation".into(),
        law: "e_A = −urad·p_B/1000, e_B = +urad·p_A/1000".into(),
        cause: "work or plate turned about the normal of the plane of both axes".into(),
        experiment:
            "a plate measured in both axes; the same plate turned by a quarter tells it from squareness"
                .into(),
        naming: EffectNameAxes::Pair,
        parameters: vec![LawParameter::linear("urad", "urad", 5000.0).typically(30.0).within(
            [-50_000.0, 50_000.0],
            "beyond 50 mrad an error in proportion to the angle is no longer the rotation's to a thousandth",
        )],
        needs: vec![RequiredInput::Position(0), RequiredInput::Position(1)],
        ..LawDescription::default()
    };
    Arc::new(LinearLaw {
        description,
        basis: |i, component, out| {
            out[0] = if component == 0 { -i.p_mm[1] / 1000.0 } else { i.p_mm[0] / 1000.0 };
        },
    })
}
