//! `twist.A.B`: a bed twists under a load that moves out.
//! The error is seen at the lever of A.

use crate::Sample;
use rtec_model::effect::{LawDescription, Effect, Input, Law, EffectNameAxes, RequiredInput, Out, LawParameter, EffectMemory};
use std::sync::Arc;

#[derive(Debug)]
struct Twist(LawDescription);

pub(crate) fn sample() -> Sample {
    let law = Arc::new(Twist(LawDescription {
        name: "twist".into(),
        law: "e_A = um·(p_A/100)·(p_B/100)²".into(),
        cause: "a bed on three feet under a table that moves out".into(),
        experiment: "the same line measured at three places of the other axis".into(),
        naming: EffectNameAxes::Two,
        parameters: vec![
            LawParameter::linear("um", "um", 5.0)
                .within([-100.0, 100.0], "a bed twists by milliradians, not by tenths"),
        ],
        needs: vec![RequiredInput::Position(0), RequiredInput::Position(1)],
        ..LawDescription::default()
    }));
    Sample { law, name: "twist.x.z", values: &[0.6] }
}

impl Law for Twist {
    fn describe(&self) -> &LawDescription {
        &self.0
    }

    fn basis(&self, _: &Effect, now: &Input, _: usize, _: &mut EffectMemory, out: Out<'_>) {
        out[0] = now.p_mm[0] / 100.0 * (now.p_mm[1] / 100.0).powi(2);
    }
}
