//! `screw_slope.A`: the amplitude of a screw's wave grows along the axis.

use crate::effect::periodic_laws::{SineLaw, period, phase};
use crate::effect::{LawDescription, Law, RequiredInput, LawParameter, ParameterFitMethod, LawSearchSettings};
use std::sync::Arc;

pub(super) fn law() -> Arc<dyn Law> {
    let description = LawDescription {
        name: "screw_slope".into(),
        law: "e = um_per_m·p/1000·sin(2πp/period_mm + phase)".into(),
        cause: "a screw that wobbles more the farther its nut is from the fixed bearing".into(),
        experiment: "linear displacement over the whole travel with targets that are no whole fraction of the lead".into(),
        parameters: vec![
            period("period_mm", "mm", [0.5, 60.0], "the periods of screw_periodic"),
            LawParameter::new("um_per_m", "um/m", [0.0, 200.0], ParameterFitMethod::Amplitude)
                .typically(4.0)
                .within([-1000.0, 1000.0], "a screw that wobbles by more than a millimetre does not turn"),
            phase(),
        ],
        needs: vec![RequiredInput::Position(0)],
        searched: LawSearchSettings { repeats: true, beside: Some(super::screw_periodic::NAME), ..LawSearchSettings::default() },
        ..LawDescription::default()
    };
    Arc::new(SineLaw { description, unit_mm: 1.0, most_periods: None, grows: true })
}
