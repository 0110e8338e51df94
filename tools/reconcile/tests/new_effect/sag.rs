//! `sag.A.B`: a cantilever of length `length_mm` bends as B reaches out.
//! It does not bend before B leaves its guide.

use crate::Sample;
use rtec_model::effect::{
    LawDescription, Effect, RecordExtent, Input, Law, EffectNameAxes, RequiredInput, Out, LawParameter, SearchGridPoint, ParameterRefinement, ParameterFitMethod, EffectMemory,
};
use std::sync::Arc;

#[derive(Debug)]
struct Sag(LawDescription);

const UM: usize = 0;
const FREE: usize = 1;

pub(crate) fn sample() -> Sample {
    let law = Arc::new(Sag(LawDescription {
        name: "sag".into(),
        law: "e_A = um·(max(p_B − free_mm, 0)/100)³".into(),
        cause: "a ram bending under its own weight once it leaves its guide".into(),
        experiment: "a straightedge read across the whole reach".into(),
        naming: EffectNameAxes::Two,
        parameters: vec![
            LawParameter::linear("um", "um", 50.0)
                .within([-500.0, 500.0], "half a millimetre per 100 mm is a rope"),
            LawParameter::new("free_mm", "mm", [0.0, 1000.0], ParameterFitMethod::Smooth)
                .within([-1e4, 1e4], "no reach is longer than ten metres")
                .refined(ParameterRefinement::Step(20.0)),
        ],
        needs: vec![RequiredInput::Position(1)],
        ..LawDescription::default()
    }));
    Sample { law, name: "sag.x.z", values: &[4.0, 130.0] }
}

/// Reach beyond the guide, in units of 100 mm.
fn reach(effect: &Effect, now: &Input) -> f64 {
    (now.p_mm[1] - effect.scalar(FREE)).max(0.0) / 100.0
}

impl Law for Sag {
    fn describe(&self) -> &LawDescription {
        &self.0
    }

    fn basis(&self, effect: &Effect, now: &Input, _: usize, _: &mut EffectMemory, out: Out<'_>) {
        out[0] = reach(effect, now).powi(3);
    }

    fn slopes(&self, effect: &Effect, now: &Input, _: usize, _: &mut EffectMemory, out: Out<'_>) {
        let reach = reach(effect, now);
        out[UM] = reach.powi(3);
        out[FREE] = -3.0 * effect.scalar(UM) * reach.powi(2) / 100.0;
    }

    fn grid(&self, effect: &Effect, records: &dyn RecordExtent) -> Vec<SearchGridPoint> {
        let places = records.places_mm(&effect.axes()[1]);
        let free = places.iter().copied().step_by((places.len() / 10).max(1));
        SearchGridPoint::along(effect, FREE, free, 10f64.ln())
    }
}
