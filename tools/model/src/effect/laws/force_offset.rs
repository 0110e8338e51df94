//! `force_offset.A`: a constant force.

use crate::effect::{LawDescription, Law, LinearLaw, MechanicalParameter, LawParameter, AffectedQuantity};
use std::sync::Arc;

pub(super) fn law() -> Arc<dyn Law> {
    let description = LawDescription {
        name: "force_offset".into(),
        law: "f = N".into(),
        cause: "weight that is not balanced, amplifier offset, Coulomb friction that differs by direction"
            .into(),
        experiment: "slow strokes both ways (dynamics run)".into(),
        quantity: AffectedQuantity::Force,
        parameters: vec![LawParameter::linear("N", "N", 10_000.0).typically(20.0).within([-1e6, 1e6], "the weight of 100 t")],
        constant: true,
        mechanism: Some(MechanicalParameter::ConstantForce),
        ..LawDescription::default()
    };
    Arc::new(LinearLaw { description, basis: |_, _, out| out[0] = 1.0 })
}
