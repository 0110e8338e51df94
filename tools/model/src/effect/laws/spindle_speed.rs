//! `spindle_speed.A`: growth that follows the spindle's speed at once.

use crate::effect::{LawDescription, Law, LinearLaw, RequiredInput, LawParameter};
use std::sync::Arc;

/// First part of the effect's name.
pub const NAME: &str = "spindle_speed";

pub(super) fn law() -> Arc<dyn Law> {
    let description = LawDescription {
        name: NAME.into(),
        law: "e = um_per_krpm·n + um_per_krpm2·n²".into(),
        cause: "centrifugal growth of bearings and shaft, axial shift under preload".into(),
        experiment: "short runs at several speeds, up and down, faster than the spindle warms (ISO 230-3)"
            .into(),
        parameters: vec![
            LawParameter::linear("um_per_krpm", "um/krpm", 20.0).typically(1.0)
                .within([-500.0, 500.0], "a bearing grows by tens of micrometres at its highest speed"),
            LawParameter::linear("um_per_krpm2", "um/krpm2", 5.0).typically(0.15)
                .within([-500.0, 500.0], "as the linear term")
                .or(0.0),
        ],
        needs: vec![RequiredInput::SpindleSpeed],
        ..LawDescription::default()
    };
    Arc::new(LinearLaw {
        description,
        basis: |i, _, out| {
            let n = i.rpm / 1000.0;
            out[0] = n;
            out[1] = n * n;
        },
    })
}
