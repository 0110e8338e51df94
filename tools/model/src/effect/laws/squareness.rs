//! `squareness.A.B`: two axes that are not square to each other.

use crate::effect::{LawDescription, Law, LinearLaw, EffectNameAxes, RequiredInput, LawParameter, LawSearchSettings};
use std::sync::Arc;

/// First part of the effect's name.
pub const NAME: &str = "squareness";

pub(super) fn law() -> Arc<dyn Law> {
    let description = LawDescription {
        name: NAME.into(),
        law: "e_A = urad·p_B/1000".into(),
        cause: "axis B not square to axis A".into(),
        experiment: "ballbar in the plane of both axes (ISO 230-4), or a square on both".into(),
        naming: EffectNameAxes::Two,
        parameters: vec![
            LawParameter::linear("urad", "urad", 2000.0).typically(25.0)
                .within([-5000.0, 5000.0], "5 mrad, a third of a degree, is seen with a workshop square"),
        ],
        needs: vec![RequiredInput::Position(1)],
        searched: LawSearchSettings { one_beside: Some("rotation"), ..LawSearchSettings::default() },
        ..LawDescription::default()
    };
    Arc::new(LinearLaw { description, basis: |i, _, out| out[0] = i.p_mm[1] / 1000.0 })
}
