//! The prepared evaluation of a model equals the plain one, to the last bit.
//! Cases: every law, shared and separate places, axes that the layout lacks, held axes, no probing, inputs
//! outside their range.

#![allow(clippy::unwrap_used)] // a test's own helpers

use proptest::prelude::*;
use rtec_model::effect::{
    AffectedQuantity, Dictionary, Effect, EffectMemory, EffectNameAxes, Input, ProbingDependence,
    ReferenceTemperature, RequiredInput, STANDARD_DEGC, TemperatureDifference,
};
use rtec_model::live_evaluation::{AxisMotionState, LiveModel, MachineState, MachineStateLayout};
use rtec_model::record::Axis;

const AXES: [&str; 3] = ["x", "y", "z"];
const SENSORS: [&str; 3] = ["T1", "T2", "T3"];

/// One effect in its plain form: every name is looked up at every instant.
struct Plain {
    effect: Effect,
    state: EffectMemory,
    thermal: (f64, f64),
}

/// Errors, forces, radial error.
type Sums = ([f64; 3], [f64; 3], f64);

impl Plain {
    fn add(&mut self, frame: &MachineState<'_>, sums: &mut Sums) {
        let (effect, law) = (&self.effect, self.effect.description());
        let place = |n: usize| effect.axes().get(n).and_then(|a| AXES.iter().position(|b| *b == a.as_str()));
        let at = |n: usize| place(n).map_or(AxisMotionState::default(), |a| frame.axes[a]);
        let degc = |name: &str| frame.temperatures_degc[SENSORS.iter().position(|s| *s == name).unwrap()];
        let held = |n: usize| place(n).is_some_and(|a| frame.held.get(a) == Some(&true));
        let (mut delta_k, mut t_s) = (0.0, frame.t_s);
        if let Some(d) = effect.delta.as_ref().filter(|_| law.needs.contains(&RequiredInput::Delta)) {
            if !(0..3).any(held) {
                let from = match &d.against {
                    ReferenceTemperature::Sensor(s) => degc(s),
                    ReferenceTemperature::Reference(t) => *t,
                    ReferenceTemperature::Standard => STANDARD_DEGC,
                };
                self.thermal = (degc(&d.sensor) - from, frame.t_s);
            }
            (delta_k, t_s) = self.thermal;
        }
        let input = Input {
            t_s,
            p_mm: [at(0).position_mm, at(1).position_mm, at(2).position_mm],
            dir: at(0).direction,
            past_mm: 0.0,
            v_mm_s: at(0).velocity_mm_s,
            a_mm_s2: at(0).acceleration_mm_s2,
            load_n: at(0).load_n,
            delta_k,
            rpm: frame.rpm,
            coolant: frame.coolant,
            angle_rad: frame.angle_rad,
            channel: effect.channel().map_or(0.0, |_| frame.channels[0]),
        };
        let before = self.state;
        for component in 0..if law.naming == EffectNameAxes::Pair { 2 } else { 1 } {
            self.state = before;
            let coefficients = effect.coefficients();
            let mut basis = vec![0.0; coefficients.len()];
            effect.law().basis(effect, &input, component, &mut self.state, &mut basis);
            let mut value = coefficients[0] * basis[0];
            for (c, b) in coefficients.iter().zip(&basis).skip(1) {
                value += c * b;
            }
            if law.probing == ProbingDependence::Only && !frame.probing {
                value = 0.0;
            }
            if let Some([lo, hi]) = effect.range_k {
                let asked = if law.lag.is_some() { self.state.x[0] } else { delta_k };
                let outside_k = (asked - hi).max(lo - asked).max(0.0);
                // The unknown beyond the bound is as large as the change left out. Half is left if it equals
                // the value.
                let bound = asked.clamp(lo, hi);
                let per_k = if bound == 0.0 { 1.0 } else { basis[0] / bound };
                let unknown = coefficients[0] * per_k * outside_k;
                if unknown != 0.0 {
                    value *= value * value / (value * value + unknown * unknown);
                }
            }
            match (place(component), law.quantity) {
                (Some(a), AffectedQuantity::Error) => sums.0[a] += value,
                (Some(a), AffectedQuantity::Force) => sums.1[a] += value,
                (None, _) if law.naming == EffectNameAxes::Plain => sums.2 += value,
                (None, _) => {}
            }
        }
    }
}

/// An effect of the n-th law; `seed` chooses its axis, difference and values.
fn effect(n: usize, seed: u64) -> Effect {
    let d = Dictionary::default();
    let law = d.laws().nth(n % d.laws().count()).unwrap().describe();
    // `w` is an axis that the layout does not have.
    let letters = ["x", "y", "z", "w"];
    let axis = |k: usize| letters[(seed as usize + k) % 4];
    let name = match law.naming {
        EffectNameAxes::Plain => law.name.clone(),
        EffectNameAxes::One => format!("{}.{}", law.name, axis(0)),
        EffectNameAxes::Two | EffectNameAxes::Pair => format!("{}.{}.{}", law.name, axis(0), axis(1)),
        EffectNameAxes::Three => format!("{}.{}.{}.{}", law.name, axis(0), axis(1), axis(2)),
        EffectNameAxes::Channel => format!("{}.{}.load", law.name, axis(0)),
    };
    let mut e = d.effect(&name).unwrap();
    let value = |k: usize, [lo, hi]: [f64; 2]| {
        let share = ((seed >> (8 * (k % 7))) & 0xff) as f64 / 255.0;
        let (lo, hi) = (lo.max(-50.0), hi.min(50.0).max(lo));
        lo + share * (hi - lo)
    };
    let values: Vec<f64> = if law.parameters.iter().any(|p| p.array) {
        let knots = [-40.0, 0.0, 10.0, 60.0];
        knots.into_iter().chain((0..4).map(|k| value(k, [-9.0, 9.0]))).collect()
    } else {
        law.parameters.iter().enumerate().map(|(k, p)| value(k, p.plausible)).collect()
    };
    // Values that the law refuses are left at its default.
    let _ = e.set_values(&values);
    if law.needs.contains(&RequiredInput::Delta) {
        e.delta = Some(match seed % 4 {
            0 => TemperatureDifference::pair("T1", "T2"),
            1 => {
                TemperatureDifference { sensor: "T3".into(), against: ReferenceTemperature::Reference(21.5) }
            }
            2 => TemperatureDifference { sensor: "T2".into(), against: ReferenceTemperature::Standard },
            _ => TemperatureDifference::pair("T3", "T1"),
        });
        e.range_k = seed.is_multiple_of(3).then_some([-1.0, 2.0]);
    }
    e
}

fn instant() -> impl Strategy<Value = ([[f64; 5]; 3], [f64; 3], [f64; 5], [bool; 4])> {
    let axis = || prop::array::uniform5(-60.0..60.0_f64);
    (
        prop::array::uniform3(axis()),
        prop::array::uniform3(18.0..25.0_f64),
        prop::array::uniform5(-3.0..3.0_f64),
        prop::array::uniform4(any::<bool>()),
    )
}

proptest! {
    #[test]
    fn prepared_is_plain_to_the_last_bit(
        chosen in prop::collection::vec((0..64_usize, any::<u64>()), 1..40),
        instants in prop::collection::vec(instant(), 1..30),
    ) {
        // Every law once, and the chosen ones again.
        let count = Dictionary::default().laws().count();
        let effects: Vec<Effect> = (0..count).map(|n| effect(n, chosen[n % chosen.len()].1))
            .chain(chosen.iter().map(|(n, seed)| effect(*n, *seed))).collect();
        let layout = MachineStateLayout {
            axes: AXES.map(|a| Axis::new(a).unwrap()).to_vec(),
            sensors: SENSORS.map(String::from).to_vec(),
            channels: vec!["load".into()],
        };
        let mut live = LiveModel::new(&effects, layout).unwrap();
        let mut plain: Vec<Plain> = effects.into_iter()
            .map(|effect| Plain { effect, state: EffectMemory::default(), thermal: (0.0, 0.0) }).collect();
        let mut t_s = 0.0;
        for (axes, temperatures_degc, [step, channel, rpm, coolant, angle_rad], [hx, hy, hz, probing]) in instants {
            t_s += step.max(0.0);
            let axes = axes.map(|[p, v, a, dir, load]| AxisMotionState {
                position_mm: p,
                velocity_mm_s: v,
                acceleration_mm_s2: a,
                direction: if dir.abs() < 10.0 { 0.0 } else { dir.signum() },
                load_n: load,
            });
            let frame = MachineState {
                t_s,
                axes: &axes,
                temperatures_degc: &temperatures_degc,
                channels: &[channel],
                rpm: 1000.0 * rpm,
                coolant,
                angle_rad,
                probing,
                held: &[hx && hy, hy && hz, hz && hx],
            };
            live.evaluate(&frame);
            let mut sums = Sums::default();
            for p in &mut plain {
                p.add(&frame, &mut sums);
            }
            // The sign of zero does not count: −0 plus 0 is 0.
            let bits = |v: &[f64]| v.iter().map(|v| (v + 0.0).to_bits()).collect::<Vec<_>>();
            prop_assert_eq!(bits(live.errors_um()), bits(&sums.0));
            prop_assert_eq!(bits(live.forces_n()), bits(&sums.1));
            prop_assert_eq!(bits(&[live.radial_um()]), bits(&[sums.2]));
        }
    }
}
