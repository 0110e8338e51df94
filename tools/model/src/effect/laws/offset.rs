//! `offset.A`: the zero of an axis.

use crate::effect::{LawDescription, ThermalDependence, Law, LinearLaw, LawParameter};
use std::sync::Arc;

/// First part of the effect's name.
pub const NAME: &str = "offset";

pub(super) fn law() -> Arc<dyn Law> {
    let description = LawDescription {
        name: NAME.into(),
        law: "e = um".into(),
        cause: "zero point, tool length, datum of the gauge".into(),
        experiment:
            "any run against a datum that is known; two set-ups of the gauge tell it from the datum's own \
                     error"
                .into(),
        parameters: vec![
            LawParameter::linear("um", "um", 2000.0).typically(10.0)
                .within([-10_000.0, 10_000.0], "a gauge reaches 10 mm: farther off is another datum"),
        ],
        heat: ThermalDependence::StandsIn,
        constant: true,
        ..LawDescription::default()
    };
    Arc::new(LinearLaw { description, basis: |_, _, out| out[0] = 1.0 })
}
