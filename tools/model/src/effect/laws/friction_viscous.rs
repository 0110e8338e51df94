//! `friction_viscous.A`: force in proportion to the velocity.

use crate::effect::{LawDescription, Law, LinearLaw, MechanicalParameter, RequiredInput, LawParameter, AffectedQuantity};
use std::sync::Arc;

pub(super) fn law() -> Arc<dyn Law> {
    let description = LawDescription {
        name: "friction_viscous".into(),
        law: "f = N_s_per_m·v/1000".into(),
        cause: "lubricant sheared in guideways, screw and bearings".into(),
        experiment: "strokes at several steady speeds, both ways (dynamics run)".into(),
        quantity: AffectedQuantity::Force,
        parameters: vec![
            LawParameter::linear("N_s_per_m", "N·s/m", 100_000.0).typically(200.0)
                .within([0.0, 1e6], "friction takes energy and gives none; 1 kN at 1 mm/s is more than oil in any guideway takes"),
        ],
        needs: vec![RequiredInput::Velocity],
        mechanism: Some(MechanicalParameter::ViscousFriction),
        ..LawDescription::default()
    };
    Arc::new(LinearLaw { description, basis: |i, _, out| out[0] = i.v_mm_s / 1000.0 })
}
