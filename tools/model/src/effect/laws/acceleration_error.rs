//! `acceleration_error.A`: bending under the machine's own inertia.

use crate::effect::{LawDescription, Law, LinearLaw, RequiredInput, LawParameter, LawSearchSettings};
use std::sync::Arc;

/// Extra price over an effect of the position, nats: it is rarer.
const RARER: f64 = 1.0;

pub(super) fn law() -> Arc<dyn Law> {
    let description = LawDescription {
        name: "acceleration_error".into(),
        law: "e = um_per_m_s2·a/1000".into(),
        cause: "drive train and structure bending under their own inertia".into(),
        experiment: "feed sweep with the same path at several accelerations".into(),
        parameters: vec![
            LawParameter::linear("um_per_m_s2", "um/(m/s2)", 100.0).typically(3.0)
                .within([-10_000.0, 10_000.0], "10 µm per mm/s²: so soft a drive train would resonate at 1.6 Hz"),
        ],
        needs: vec![RequiredInput::Acceleration],
        // Around a circle at constant speed the acceleration is proportional to the position, as of a scale.
        searched: LawSearchSettings { price: RARER, ..LawSearchSettings::default() },
        ..LawDescription::default()
    };
    Arc::new(LinearLaw { description, basis: |i, _, out| out[0] = i.a_mm_s2 / 1000.0 })
}
