//! `scale.A`: an error proportional to the position.

use crate::effect::{LawDescription, Law, LinearLaw, RequiredInput, LawParameter};
use std::sync::Arc;

/// First part of the effect's name.
pub const NAME: &str = "scale";

pub(super) fn law() -> Arc<dyn Law> {
    let description = LawDescription {
        name: NAME.into(),
        law: "e = ppm·p/1000".into(),
        cause: "length error of the scale or of the screw's lead, cosine error of the set-up".into(),
        experiment: "linear displacement over the whole travel (ISO 230-2) at a steady, known temperature"
            .into(),
        parameters: vec![
            LawParameter::linear("ppm", "ppm", 1000.0).typically(15.0)
                .within([-1000.0, 1000.0], "the loosest screw (ISO 3408-3, grade 10) is 700 ppm off"),
        ],
        needs: vec![RequiredInput::Position(0)],
        ..LawDescription::default()
    };
    Arc::new(LinearLaw { description, basis: |i, _, out| out[0] = i.p_mm[0] / 1000.0 })
}
