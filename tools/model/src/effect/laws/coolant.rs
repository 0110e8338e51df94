//! `coolant.A`: a constant error while coolant flows.

use crate::effect::{LawDescription, Law, LinearLaw, RequiredInput, LawParameter};
use std::sync::Arc;

/// First part of the effect's name.
pub const NAME: &str = "coolant";

pub(super) fn law() -> Arc<dyn Law> {
    let description = LawDescription {
        name: NAME.into(),
        law: "e = um while coolant is on".into(),
        cause: "coolant's pressure and chill on spindle and work".into(),
        experiment: "coolant switched on and off several times in one warm, steady run".into(),
        parameters: vec![LawParameter::linear("um", "um", 200.0).typically(6.0).within(
            [-1000.0, 1000.0],
            "a spindle of steel half a metre long and 100 K colder is 0.6 mm shorter",
        )],
        needs: vec![RequiredInput::Coolant],
        ..LawDescription::default()
    };
    Arc::new(LinearLaw { description, basis: |i, _, out| out[0] = f64::from(i.coolant > 0.5) })
}
