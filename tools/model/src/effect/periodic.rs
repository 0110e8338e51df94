//! Periodic effects: `screw_periodic.A`, `subdivision.A`, `probe_lobing`. Amplitude and phase stand for two linear
//! coefficients, amplitude times cosine and sine of the phase.

use super::{Card, Effect, Input, Law, Naming, Need, Out, Parameter, Quantity, Search, State, ValueError};
use std::f64::consts::TAU;
use std::sync::Arc;

#[derive(Debug)]
struct Periodic {
    card: Card,
    kind: Kind,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    /// um·sin(2πp/period + phase); the period is worth this many mm per unit of the parameter.
    Sine { mm: f64 },
    /// um·cos(lobes·angle + phase).
    Lobes,
}

impl Periodic {
    /// Places of period (or lobes), amplitude and phase among the parameters.
    const fn places(&self) -> (usize, usize, usize) {
        match self.kind {
            Kind::Sine { .. } => (0, 1, 2),
            Kind::Lobes => (1, 0, 2),
        }
    }

    fn argument(&self, effect: &Effect, now: &Input) -> f64 {
        match self.kind {
            // Whole periods are taken off first: the argument keeps its digits over long travel.
            Kind::Sine { mm } => TAU * (now.p_mm[0] / (effect.scalar(0) * mm)).fract(),
            Kind::Lobes => effect.scalar(1) * now.angle_rad,
        }
    }
}

impl Law for Periodic {
    fn card(&self) -> &Card {
        &self.card
    }

    fn basis(&self, effect: &Effect, now: &Input, _: usize, _: &mut State, out: Out<'_>) {
        let (sin, cos) = self.argument(effect, now).sin_cos();
        // um·sin(x + φ) = um·cos φ·sin x + um·sin φ·cos x; um·cos(x + φ) = um·cos φ·cos x − um·sin φ·sin x
        (out[0], out[1]) = match self.kind {
            Kind::Sine { .. } => (sin, cos),
            Kind::Lobes => (cos, -sin),
        };
    }

    fn slopes(&self, effect: &Effect, now: &Input, _: usize, _: &mut State, out: Out<'_>) {
        let (shape, um, phase) = self.places();
        let (sin, cos) = (self.argument(effect, now) + effect.scalar(phase)).sin_cos();
        let a = effect.scalar(um);
        match self.kind {
            Kind::Sine { mm } => {
                let period = effect.scalar(shape);
                out[um] = sin;
                out[phase] = a * cos;
                out[shape] = -a * cos * TAU * now.p_mm[0] / (period * period * mm);
            }
            Kind::Lobes => {
                out[um] = cos;
                out[phase] = -a * sin;
            }
        }
    }

    fn coefficients(&self, effect: &Effect, out: Out<'_>) {
        let (_, um, phase) = self.places();
        let (sin, cos) = effect.scalar(phase).sin_cos();
        out[0] = effect.scalar(um) * cos;
        out[1] = effect.scalar(um) * sin;
    }

    fn set_coefficients(&self, effect: &mut Effect, from: &[f64]) {
        let (_, um, phase) = self.places();
        effect.get_mut(um)[0] = from[0].hypot(from[1]);
        effect.get_mut(phase)[0] = from[1].atan2(from[0]);
    }

    fn coefficient_count(&self, _: usize) -> usize {
        2
    }

    fn check(&self, effect: &Effect) -> Result<(), ValueError> {
        if self.kind == Kind::Lobes && effect.scalar(1).fract() != 0.0 {
            return Err(ValueError::new("lobes", effect.scalar(1).to_string(), "a whole number of lobes"));
        }
        Ok(())
    }
}

pub(super) fn laws(laws: &mut Vec<Arc<dyn Law>>) {
    let um = |plausible: f64| Parameter::new("um", "um", [0.0, plausible], Search::Amplitude);
    let phase = || Parameter::new("phase_rad", "rad", [-TAU / 2.0, TAU / 2.0], Search::Phase).or(0.0);
    let period =
        |name: &str, unit: &str, lo, hi| Parameter::new(name, unit, [lo, hi], Search::Smooth).limits(lo, hi);
    let mut sine = |name: &str, period: Parameter, mm, plausible, cause: &str, experiment: &str| {
        laws.push(Arc::new(Periodic {
            card: Card {
                name: name.to_owned(),
                law: format!("e = um·sin(2πp/{} + phase)", period.name),
                cause: cause.to_owned(),
                naming: Naming::One,
                quantity: Quantity::Error,
                parameters: vec![period, um(plausible), phase()],
                needs: vec![Need::Position(0)],
                experiment: experiment.to_owned(),
            },
            kind: Kind::Sine { mm },
        }));
    };
    sine(
        "screw_periodic",
        period("period_mm", "mm", 0.5, 60.0),
        1.0,
        100.0,
        "wobble of the ball screw or of its bearings, once or twice a turn; eccentric rotary encoder",
        "linear displacement over a few turns with targets that are no whole fraction of the lead (ISO 230-2)",
    );
    sine(
        "subdivision",
        period("period_um", "um", 1.0, 200.0),
        1e-3,
        5.0,
        "interpolation of the scale's signal period: offsets, amplitudes and phase of its sine and cosine",
        "slow motion over a few signal periods in steps much finer than one",
    );
    laws.push(Arc::new(Periodic {
        card: Card {
            name: "probe_lobing".to_owned(),
            law: "e = um·cos(lobes·angle + phase)".to_owned(),
            cause: "a kinematic probe's pre-travel, different in every direction of touch".to_owned(),
            naming: Naming::Plain,
            quantity: Quantity::Error,
            parameters: vec![
                um(50.0),
                Parameter::new("lobes", "1", [2.0, 12.0], Search::Chosen).limits(1.0, 1000.0),
                phase(),
            ],
            needs: vec![Need::Angle],
            experiment:
                "a ring gauge probed all around; turned by a part of a turn to tell the ring from the probe"
                    .to_owned(),
        },
        kind: Kind::Lobes,
    }));
}
