//! `subdivision.A`: a wave along the travel with the signal period of the scale.

use crate::effect::periodic_laws::{SineLaw, amplitude, period, phase};
use crate::effect::{LawDescription, Law, RequiredInput, LawSearchSettings, PeriodicLawSettings};
use std::sync::Arc;

/// Unit of the period, mm.
const UNIT_MM: f64 = 1e-3;

/// Usual signal periods of scales, mm.
/// Gratings have 2 to 100 µm, inductive scales 200 µm.
const SIGNALS_MM: [f64; 9] = [0.2, 0.128, 0.1, 0.04, 0.02, 0.01, 0.008, 0.004, 0.002];

/// Largest amplitude in periods.
/// If sine and cosine put the count off by a quarter of a period, counts are lost instead.
const MOST_PERIODS: f64 = 0.25;

pub(super) fn law() -> Arc<dyn Law> {
    let bounds = "signal periods of linear scales, from interferential (1 µm) to inductive ones (200 µm)";
    // Two steps of the positions to a period: a finer wave looks like a coarser one.
    let wave = PeriodicLawSettings { unit_mm: UNIT_MM, usual_mm: &SIGNALS_MM, steps: Some(2.0), most_periods: Some(MOST_PERIODS) };
    let description = LawDescription {
        name: "subdivision".into(),
        law: "e = um·sin(2πp/period_um + phase)".into(),
        cause:
            "interpolation of the scale's signal period: offsets, amplitudes and phase of its sine and cosine"
                .into(),
        experiment: "slow motion over a few signal periods in steps much finer than one".into(),
        parameters: vec![
            period("period_um", "um", [1.0, 200.0], bounds),
            amplitude(5.0, 0.3).within([-50.0, 50.0], "a quarter of the longest period"),
            phase(),
        ],
        needs: vec![RequiredInput::Position(0)],
        searched: LawSearchSettings { repeats: true, wave: Some(wave), ..LawSearchSettings::default() },
        ..LawDescription::default()
    };
    Arc::new(SineLaw { description, unit_mm: UNIT_MM, most_periods: Some(MOST_PERIODS), grows: false })
}
