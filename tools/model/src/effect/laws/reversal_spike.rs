//! `reversal_spike.A`: the peak after a change of direction.
//! It fades with the travel since the change.

use crate::effect::{
    LawDescription, Effect, RecordExtent, Input, Law, RequiredInput, Out, LawParameter, SearchGridPoint, ParameterRefinement, ParameterFitMethod,
    EffectMemory,
};
use std::sync::Arc;

/// First part of the effect's name.
pub const NAME: &str = "reversal_spike";

#[derive(Debug)]
struct ReversalSpike(LawDescription);

const UM: usize = 0;
const LENGTH: usize = 1;

pub(super) fn law() -> Arc<dyn Law> {
    Arc::new(ReversalSpike(LawDescription {
        name: NAME.into(),
        law: "e = um·dir·exp(−d/length_mm), d = travel since the last reversal".into(),
        cause: "static friction: the axis sticks while the drive winds up".into(),
        parameters: vec![
            LawParameter::linear("um", "um", 100.0).typically(3.0)
                .within([-1000.0, 1000.0], "a drive that winds up by a millimetre is broken"),
            LawParameter::new("length_mm", "mm", [0.01, 50.0], ParameterFitMethod::Smooth)
                .within([1e-9, 1e6], "a positive length")
                .refined(ParameterRefinement::Factor(0.3)),
        ],
        needs: vec![RequiredInput::Direction, RequiredInput::Position(0)],
        experiment:
            "ballbar (ISO 230-4), read at the quadrants; short strokes with dense readings after reversal"
                .into(),
        after_turn: true,
        ..LawDescription::default()
    }))
}

/// Travel since the axis turned, mm.
/// It turned at or beyond the last row of the old direction.
/// `None` before the first reversal or without a direction.
///
/// State: last direction, previous position, two travels.
///
/// The first travel is since the last row of the present direction; it becomes the start when the direction
/// changes. The second is since the reversal, −1 before the first.
fn travel(now: &Input, state: &mut EffectMemory) -> Option<f64> {
    let p = now.p_mm[0];
    if !state.started {
        *state = EffectMemory { started: true, x: [now.dir, p, 0.0, -1.0] };
        return None;
    }
    let [mut old, before, mut since_row, mut since_reversal] = state.x;
    let step = (p - before).abs();
    since_row += step;
    if since_reversal >= 0.0 {
        since_reversal += step;
    }
    if now.dir != 0.0 {
        if old * now.dir < 0.0 {
            since_reversal = now.past_mm + since_row;
        }
        old = now.dir;
        since_row = 0.0;
    }
    state.x = [old, p, since_row, since_reversal];
    (since_reversal >= 0.0 && now.dir != 0.0).then_some(since_reversal)
}

impl Law for ReversalSpike {
    fn describe(&self) -> &LawDescription {
        &self.0
    }

    fn basis(&self, effect: &Effect, now: &Input, _: usize, state: &mut EffectMemory, out: Out<'_>) {
        out[0] = travel(now, state).map_or(0.0, |d| now.dir * (-d / effect.scalar(LENGTH)).exp());
    }

    fn slopes(&self, effect: &Effect, now: &Input, _: usize, state: &mut EffectMemory, out: Out<'_>) {
        let Some(d) = travel(now, state) else { return };
        let length = effect.scalar(LENGTH);
        out[UM] = now.dir * (-d / length).exp();
        out[LENGTH] = effect.scalar(UM) * out[UM] * d / (length * length);
    }

    fn grid(&self, effect: &Effect, records: &dyn RecordExtent) -> Vec<SearchGridPoint> {
        let travel = records.travel_mm(&effect.axes()[0]);
        if travel <= 0.0 {
            return Vec::new();
        }
        SearchGridPoint::along(effect, LENGTH, (0..12).map(|i| travel * 0.4 * 0.6_f64.powi(i)), 8f64.ln())
    }
}
