//! `reversal.A`: the lost motion of an axis after it turned back.

use crate::effect::{LawDescription, Law, LinearLaw, RequiredInput, LawParameter};
use std::sync::Arc;

/// First part of the effect's name.
pub const NAME: &str = "reversal";

pub(super) fn law() -> Arc<dyn Law> {
    let description = LawDescription {
        name: NAME.into(),
        law: "e = um·dir/2".into(),
        cause: "backlash and elastic wind-up between scale and tool".into(),
        experiment: "bidirectional linear displacement, targets approached from both sides (ISO 230-2)"
            .into(),
        parameters: vec![LawParameter::linear("um", "um", 200.0).typically(4.0).within(
            [-1000.0, 1000.0],
            "lost motion of a millimetre is a loose coupling, and repeats in no way",
        )],
        needs: vec![RequiredInput::Direction],
        ..LawDescription::default()
    };
    Arc::new(LinearLaw { description, basis: |i, _, out| out[0] = i.dir / 2.0 })
}
