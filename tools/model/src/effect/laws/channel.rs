//! `channel.A.NAME`: a logged quantity with no physics named.

use crate::effect::{LawDescription, Law, LinearLaw, EffectNameAxes, RequiredInput, LawParameter, LawSearchSettings};
use std::sync::Arc;

/// Extra price over an effect that has a physical cause, nats.
const NO_PHYSICS: f64 = 2.5;

pub(super) fn law() -> Arc<dyn Law> {
    let description = LawDescription {
        name: "channel".into(),
        law: "e = gain·NAME".into(),
        cause: "a logged quantity with no physics named".into(),
        experiment: "that quantity varied on its own, everything else held".into(),
        naming: EffectNameAxes::Channel,
        parameters: vec![
            // No physics bounds it, whatever the channel's unit. Beyond this, sums lose the other effects to
            // rounding.
            LawParameter::linear("gain", "um/1", 1e12).within(
                [-1e12, 1e12],
                "1e-12 of the channel's unit would make a micrometre of error: the unit is wrong",
            ),
        ],
        needs: vec![RequiredInput::Channel],
        searched: LawSearchSettings { price: NO_PHYSICS, ..LawSearchSettings::default() },
        ..LawDescription::default()
    };
    Arc::new(LinearLaw { description, basis: |i, _, out| out[0] = i.channel })
}
