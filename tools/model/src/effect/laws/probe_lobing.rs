//! `probe_lobing`: a kinematic probe's pre-travel around its stylus.

use crate::effect::periodic_laws::{amplitude, phase, polar, set_polar};
use crate::effect::{
    LawDescription, Effect, RecordExtent, Input, Law, EffectNameAxes, RequiredInput, Out, EffectOwner, LawParameter, SearchGridPoint,
    ParameterFitMethod, LawSearchSettings,
    EffectMemory, ParameterValueError,
};
use std::sync::Arc;

/// um·cos(lobes·angle + phase).
#[derive(Debug)]
struct Lobing(LawDescription);

const UM: usize = 0;
const LOBES: usize = 1;
const PHASE: usize = 2;

pub(super) fn law() -> Arc<dyn Law> {
    let lobes = LawParameter::new("lobes", "1", [2.0, 12.0], ParameterFitMethod::Chosen)
        .within([1.0, 1000.0], "one lobe is an eccentric ring; a thousand are roughness")
        .telling_apart();
    Arc::new(Lobing(LawDescription {
        name: "probe_lobing".into(),
        law: "e = um·cos(lobes·angle + phase)".into(),
        cause: "a kinematic probe's pre-travel, different in every direction of touch".into(),
        experiment:
            "a ring gauge probed all around; turned by a part of a turn to tell the ring from the probe"
                .into(),
        naming: EffectNameAxes::Plain,
        parameters: vec![
            amplitude(50.0, 2.0).within([-1000.0, 1000.0], "pre-travel of a millimetre: the stylus is loose"),
            lobes,
            phase(),
        ],
        needs: vec![RequiredInput::Angle],
        owner: EffectOwner::Probe,
        searched: LawSearchSettings { repeats: true, ..LawSearchSettings::default() },
        ..LawDescription::default()
    }))
}

impl Law for Lobing {
    fn describe(&self) -> &LawDescription {
        &self.0
    }

    fn basis(&self, effect: &Effect, now: &Input, _: usize, _: &mut EffectMemory, out: Out<'_>) {
        // um·cos(x + φ) = um·cos φ·cos x − um·sin φ·sin x
        let (sin, cos) = (effect.scalar(LOBES) * now.angle_rad).sin_cos();
        (out[0], out[1]) = (cos, -sin);
    }

    fn slopes(&self, effect: &Effect, now: &Input, _: usize, _: &mut EffectMemory, out: Out<'_>) {
        let (sin, cos) = (effect.scalar(LOBES) * now.angle_rad + effect.scalar(PHASE)).sin_cos();
        out[UM] = cos;
        out[PHASE] = -effect.scalar(UM) * sin;
    }

    fn coefficients(&self, effect: &Effect, out: Out<'_>) {
        polar(effect, UM, PHASE, out);
    }

    fn set_coefficients(&self, effect: &mut Effect, from: &[f64]) {
        set_polar(effect, UM, PHASE, from);
    }

    fn coefficient_count(&self, _: usize) -> usize {
        2
    }

    fn check(&self, effect: &Effect) -> Result<(), ParameterValueError> {
        let lobes = effect.scalar(LOBES);
        if lobes.fract() == 0.0 {
            return Ok(());
        }
        Err(ParameterValueError::new("lobes", lobes.to_string(), "a whole number of lobes"))
    }

    /// A single lobe can also be an eccentric set-up: it is allowed at a price.
    fn grid(&self, effect: &Effect, _: &dyn RecordExtent) -> Vec<SearchGridPoint> {
        let told_apart = 11f64.ln();
        let mut points = SearchGridPoint::along(effect, LOBES, [1.0], 1.0 + told_apart);
        points.extend(SearchGridPoint::along(effect, LOBES, (2..=12).map(f64::from), told_apart));
        points
    }
}
