//! `inertia.A`: the force that accelerates an axis.

use crate::effect::{LawDescription, Law, LinearLaw, MechanicalParameter, RequiredInput, LawParameter, AffectedQuantity};
use std::sync::Arc;

pub(super) fn law() -> Arc<dyn Law> {
    let description = LawDescription {
        name: "inertia".into(),
        law: "f = kg·a/1000".into(),
        cause: "moved mass, with the drive's inertia referred to the axis".into(),
        experiment: "strokes at several accelerations (dynamics run)".into(),
        quantity: AffectedQuantity::Force,
        parameters: vec![
            LawParameter::linear("kg", "kg", 100_000.0).typically(120.0).within([0.0, 1e6], "no mass is negative; 1000 t: no axis moves that"),
        ],
        needs: vec![RequiredInput::Acceleration],
        mechanism: Some(MechanicalParameter::Mass),
        ..LawDescription::default()
    };
    Arc::new(LinearLaw { description, basis: |i, _, out| out[0] = i.a_mm_s2 / 1000.0 })
}
