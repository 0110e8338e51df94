//! `friction_coulomb.A`: dry friction.

use crate::effect::{LawDescription, Law, LinearLaw, MechanicalParameter, RequiredInput, LawParameter, AffectedQuantity, sign};
use std::sync::Arc;

pub(super) fn law() -> Arc<dyn Law> {
    let description = LawDescription {
        name: "friction_coulomb".into(),
        law: "f = N·sign(v)".into(),
        cause: "dry friction of guideways, seals and preloaded nuts".into(),
        experiment: "slow strokes both ways (dynamics run)".into(),
        quantity: AffectedQuantity::Force,
        parameters: vec![
            LawParameter::linear("N", "N", 10_000.0).typically(40.0)
                .within([0.0, 1e6], "friction takes energy and gives none; at most the dry friction of 1000 t on rollers of 0.01"),
        ],
        needs: vec![RequiredInput::Velocity],
        mechanism: Some(MechanicalParameter::CoulombFriction),
        ..LawDescription::default()
    };
    Arc::new(LinearLaw { description, basis: |i, _, out| out[0] = sign(i.v_mm_s) })
}
