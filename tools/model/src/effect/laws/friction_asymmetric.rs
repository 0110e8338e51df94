//! `friction_asymmetric.A`: viscous friction that differs by direction.

use crate::effect::{LawDescription, Law, LinearLaw, MechanicalParameter, RequiredInput, LawParameter, AffectedQuantity};
use std::sync::Arc;

pub(super) fn law() -> Arc<dyn Law> {
    let description = LawDescription {
        name: "friction_asymmetric".into(),
        law: "f = N_s_per_m·abs(v)/1000".into(),
        cause: "viscous friction that differs by direction".into(),
        experiment: "strokes at several steady speeds, both ways (dynamics run)".into(),
        quantity: AffectedQuantity::Force,
        parameters: vec![
            LawParameter::linear("N_s_per_m", "N·s/m", 100_000.0).typically(60.0)
                .within([-1e6, 1e6], "as viscous friction itself"),
        ],
        needs: vec![RequiredInput::Velocity],
        mechanism: Some(MechanicalParameter::AsymmetricFriction),
        ..LawDescription::default()
    };
    Arc::new(LinearLaw { description, basis: |i, _, out| out[0] = i.v_mm_s.abs() / 1000.0 })
}
