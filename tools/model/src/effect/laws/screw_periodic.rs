//! `screw_periodic.A`: a wave along the travel.
//! Its period is a turn of a screw or an encoder.

use crate::effect::periodic_laws::{SineLaw, amplitude, period, phase};
use crate::effect::{LawDescription, Law, RequiredInput, LawSearchSettings, PeriodicLawSettings};
use std::sync::Arc;

/// First part of the effect's name.
pub const NAME: &str = "screw_periodic";

/// Leads that ball screws are made with, mm (ISO 3408-2).
const LEADS_MM: [f64; 15] =
    [1.0, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 20.0, 25.0, 32.0, 40.0];

pub(super) fn law() -> Arc<dyn Law> {
    let bounds = "half the finest and one and a half times the coarsest lead of ISO 3408-2, 1 to 40 mm";
    let wobble = "a screw that wobbles by more than a millimetre does not turn";
    let wave = PeriodicLawSettings { unit_mm: 1.0, usual_mm: &LEADS_MM, steps: None, most_periods: None };
    let description = LawDescription {
        name: NAME.into(),
        law: "e = um·sin(2πp/period_mm + phase)".into(),
        cause: "wobble of the ball screw or of its bearings, once or twice a turn; eccentric rotary encoder".into(),
        experiment: "linear displacement over a few turns with targets that are no whole fraction of the lead (ISO 230-2)"
            .into(),
        parameters: vec![
            period("period_mm", "mm", [0.5, 60.0], bounds),
            amplitude(100.0, 2.0).within([-1000.0, 1000.0], wobble),
            phase(),
        ],
        needs: vec![RequiredInput::Position(0)],
        searched: LawSearchSettings { repeats: true, wave: Some(wave), ..LawSearchSettings::default() },
        ..LawDescription::default()
    };
    Arc::new(SineLaw { description, unit_mm: 1.0, most_periods: None, grows: false })
}
