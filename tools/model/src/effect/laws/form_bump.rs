//! `form_bump`: a raised cosine over part of a circle.
//! Its cause is the part's own form or a fault of the path.

use crate::effect::{
    LawDescription, Effect, RecordExtent, Input, Law, EffectNameAxes, RequiredInput, Out, EffectOwner, LawParameter, SearchGridPoint, ParameterRefinement,
    ParameterFitMethod,
    LawSearchSettings, EffectMemory,
};
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

#[derive(Debug)]
struct FormBump(LawDescription);

const UM: usize = 0;
const CENTRE: usize = 1;
const WIDTH: usize = 2;

pub(super) fn law() -> Arc<dyn Law> {
    Arc::new(FormBump(LawDescription {
        name: "form_bump".into(),
        law: "e = um·(1 + cos(2π(angle − centre_rad)/width_rad))/2 within ±width_rad/2 of the centre, else 0"
            .into(),
        cause: "local form: a hard spot, a chip, a mark of the cutter's entry".into(),
        naming: EffectNameAxes::Plain,
        parameters: vec![
            LawParameter::linear("um", "um", 500.0).typically(10.0)
                .within([-10_000.0, 10_000.0], "a bump of 10 mm is another part"),
            LawParameter::new("centre_rad", "rad", [-PI, TAU], ParameterFitMethod::Smooth)
                .within([-1e3, 1e3], "whole turns change nothing")
                .refined(ParameterRefinement::Step(0.12))
                .telling_apart()
                .cyclic(),
            LawParameter::new("width_rad", "rad", [0.05, TAU], ParameterFitMethod::Smooth)
                .within([1e-6, TAU], "at most the whole turn")
                .refined(ParameterRefinement::Factor(0.2)),
        ],
        needs: vec![RequiredInput::Angle],
        experiment: "the part probed densely all around, twice (a bump stays, a chip does not)".into(),
        owner: EffectOwner::Part,
        searched: LawSearchSettings { repeats: true, ..LawSearchSettings::default() },
        ..LawDescription::default()
    }))
}

/// Angle from the bump's centre, by the shorter way.
fn from_centre(effect: &Effect, now: &Input) -> f64 {
    let d = (now.angle_rad - effect.scalar(CENTRE)).rem_euclid(TAU);
    if d > PI { d - TAU } else { d }
}

impl Law for FormBump {
    fn describe(&self) -> &LawDescription {
        &self.0
    }

    fn basis(&self, effect: &Effect, now: &Input, _: usize, _: &mut EffectMemory, out: Out<'_>) {
        let (d, width) = (from_centre(effect, now), effect.scalar(WIDTH));
        out[0] = if d.abs() <= width / 2.0 { f64::midpoint(1.0, (TAU * d / width).cos()) } else { 0.0 };
    }

    fn slopes(&self, effect: &Effect, now: &Input, component: usize, state: &mut EffectMemory, out: Out<'_>) {
        self.basis(effect, now, component, state, &mut out[UM..=UM]);
        let (d, width) = (from_centre(effect, now), effect.scalar(WIDTH));
        if d.abs() <= width / 2.0 {
            let slope = effect.scalar(UM) / 2.0 * (TAU * d / width).sin() * TAU / width;
            out[CENTRE] = slope;
            out[WIDTH] = slope * d / width;
        }
    }

    /// Widths in a geometric series; for each, centres a quarter of the width apart.
    fn grid(&self, effect: &Effect, _: &dyn RecordExtent) -> Vec<SearchGridPoint> {
        let mut points = Vec::new();
        let mut width = 0.15;
        while width < 4.0 {
            let places = (TAU / width * 4.0).ceil() as usize;
            let price = (TAU / width * 2.0).ln() + 6f64.ln();
            for i in 0..places {
                let centre = TAU * i as f64 / places as f64;
                let at = effect.with(&[(CENTRE, centre), (WIDTH, width)]);
                points.extend(at.map(|effect| SearchGridPoint { effect, price }));
            }
            width *= 1.4;
        }
        points
    }
}
