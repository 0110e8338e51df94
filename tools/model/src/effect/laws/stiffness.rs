//! `stiffness.A`: bending under a load.

use crate::effect::{LawDescription, Law, LinearLaw, RequiredInput, LawParameter};
use std::sync::Arc;

pub(super) fn law() -> Arc<dyn Law> {
    let description = LawDescription {
        name: "stiffness".into(),
        law: "e = um_per_N·load".into(),
        cause: "compliance between scale and tool or work".into(),
        experiment: "known loads on an axis at rest (ISO 230-1, static compliance)".into(),
        parameters: vec![
            LawParameter::linear("um_per_N", "um/N", 1.0).typically(0.02)
                .within([-100.0, 100.0], "0.01 N/µm: a spring, no machine"),
        ],
        needs: vec![RequiredInput::Load],
        ..LawDescription::default()
    };
    Arc::new(LinearLaw { description, basis: |i, _, out| out[0] = i.load_n })
}
