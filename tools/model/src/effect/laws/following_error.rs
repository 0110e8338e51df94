//! `following_error.A`: lag of the position loop.

use crate::effect::{LawDescription, Law, LinearLaw, RequiredInput, LawParameter, ProbingDependence};
use std::sync::Arc;

/// First part of the effect's name.
pub const NAME: &str = "following_error";

pub(super) fn law() -> Arc<dyn Law> {
    let description =
        LawDescription {
            name: NAME.into(),
            law: "e = ms·v".into(),
            cause: "lag of the position loop (1/Kv), delay of the reading".into(),
            experiment: "ballbar or straight line at three feeds, both ways".into(),
            parameters: vec![LawParameter::linear("ms", "ms", 200.0).typically(0.3).within(
                [-10_000.0, 10_000.0],
                "a position loop slower than Kv = 0.1/s does not follow at all",
            )],
            needs: vec![RequiredInput::Velocity],
            probing: ProbingDependence::Displaced,
            ..LawDescription::default()
        };
    Arc::new(LinearLaw { description, basis: |i, _, out| out[0] = i.v_mm_s })
}
