//! `form_bump`: a raised cosine over part of a circle, as a part's own form or a fault of the path leaves it.

use super::{Card, Effect, Input, Law, Naming, Need, Out, Parameter, Quantity, Search, State};
use std::f64::consts::{PI, TAU};

#[derive(Debug)]
pub(super) struct FormBump(Card);

const UM: usize = 0;
const CENTRE: usize = 1;
const WIDTH: usize = 2;

impl FormBump {
    pub(super) fn new() -> Self {
        Self(Card {
            name: "form_bump".to_owned(),
            law: "e = um·(1 + cos(2π(angle − centre_rad)/width_rad))/2 within ±width_rad/2 of the centre, else 0"
                .to_owned(),
            cause: "local form: a hard spot, a chip, a mark of the cutter's entry".to_owned(),
            naming: Naming::Plain,
            quantity: Quantity::Error,
            parameters: vec![
                Parameter::linear("um", "um", 500.0),
                Parameter::new("centre_rad", "rad", [-PI, TAU], Search::Smooth),
                Parameter::new("width_rad", "rad", [0.05, TAU], Search::Smooth).limits(1e-6, TAU),
            ],
            needs: vec![Need::Angle],
            experiment: "the part probed densely all around, twice (a bump stays, a chip does not)".to_owned(),
        })
    }
}

/// Angle from the bump's centre, by the shorter way.
fn from_centre(effect: &Effect, now: &Input) -> f64 {
    let d = (now.angle_rad - effect.scalar(CENTRE)).rem_euclid(TAU);
    if d > PI { d - TAU } else { d }
}

impl Law for FormBump {
    fn card(&self) -> &Card {
        &self.0
    }

    fn basis(&self, effect: &Effect, now: &Input, _: usize, _: &mut State, out: Out<'_>) {
        let (d, width) = (from_centre(effect, now), effect.scalar(WIDTH));
        out[0] = if d.abs() <= width / 2.0 { f64::midpoint(1.0, (TAU * d / width).cos()) } else { 0.0 };
    }

    fn slopes(&self, effect: &Effect, now: &Input, component: usize, state: &mut State, out: Out<'_>) {
        self.basis(effect, now, component, state, &mut out[UM..=UM]);
        let (d, width) = (from_centre(effect, now), effect.scalar(WIDTH));
        if d.abs() <= width / 2.0 {
            let slope = effect.scalar(UM) / 2.0 * (TAU * d / width).sin() * TAU / width;
            out[CENTRE] = slope;
            out[WIDTH] = slope * d / width;
        }
    }
}
