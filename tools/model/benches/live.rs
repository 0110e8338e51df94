//! Speed of a model at one instant: one effect of every law, and more of them.
//!
//! Prints the times and asserts nothing: `cargo bench --workspace --bench live`.

use rtec_builders::axis;
use rtec_model::effect::{Dictionary, Effect, EffectNameAxes, RequiredInput, TemperatureDifference};
use rtec_model::live_evaluation::{AxisMotionState, LiveModel, MachineState, MachineStateLayout};
use std::hint::black_box;
use std::time::Instant;

/// One effect of every law of the dictionary.
fn every_law() -> Vec<Effect> {
    let d = Dictionary::default();
    let mut effects = Vec::new();
    for law in d.laws() {
        let name = &law.describe().name;
        let name = match law.describe().naming {
            EffectNameAxes::Plain => name.clone(),
            EffectNameAxes::One => format!("{name}.x"),
            EffectNameAxes::Two | EffectNameAxes::Pair => format!("{name}.x.z"),
            EffectNameAxes::Three => format!("{name}.x.y.z"),
            EffectNameAxes::Channel => format!("{name}.x.load"),
        };
        let mut e = d.effect(&name).expect("the dictionary's own names");
        if e.description().needs.contains(&RequiredInput::Delta) {
            e.delta = Some(TemperatureDifference::pair("T1", "T2"));
        }
        effects.push(e);
    }
    effects
}

/// A model of `count` effects: one of every law, repeated as often as needed.
fn live(count: usize) -> LiveModel {
    let effects: Vec<Effect> = every_law().into_iter().cycle().take(count).collect();
    let layout = MachineStateLayout {
        axes: vec![axis("x"), axis("y"), axis("z")],
        sensors: vec!["T1".into(), "T2".into()],
        channels: vec!["load".into()],
    };
    LiveModel::new(&effects, layout).expect("everything is in the layout")
}

/// A motion as a series of instants.
struct Motion {
    t_s: f64,
    instants: Vec<(f64, [AxisMotionState; 3])>,
}

impl Motion {
    /// Prepares the next instants, so that this work is outside the timed part.
    fn go_on(&mut self, instants: usize) {
        self.instants.clear();
        for _ in 0..instants {
            self.t_s += 0.01;
            let t = self.t_s;
            let axes = [
                AxisMotionState::moving(100.0 * t.sin(), t.cos()),
                AxisMotionState::moving(t, 1.0),
                AxisMotionState::moving(2.0, -1.0),
            ];
            self.instants.push((t, axes));
        }
    }

    /// Evaluates the model at each of the prepared instants.
    fn ask(&self, live: &mut LiveModel) {
        for (t_s, axes) in &self.instants {
            live.evaluate(&MachineState {
                t_s: *t_s,
                axes,
                temperatures_degc: &[25.0, 20.0],
                channels: &[1.0],
                ..MachineState::default()
            });
            black_box(live.errors_um());
        }
    }
}

fn main() {
    // `[EFFECTS] N`: runs exactly N instants, for counting instructions.
    let words = std::env::args().skip(1).filter(|a| a != "--bench");
    let numbers: Vec<usize> = words.map(|w| w.parse().expect("a whole number")).collect();
    let mut motion = Motion { t_s: 0.0, instants: Vec::new() };
    let counted = match numbers[..] {
        [] => None,
        [instants] => Some((30, instants)),
        [count, instants, ..] => Some((count, instants)),
    };
    if let Some((count, instants)) = counted {
        motion.go_on(instants);
        return motion.ask(&mut live(count));
    }
    for (count, instants) in [(30, 1000), (300, 100), (1000, 30)] {
        let mut live = live(count);
        let mut ns: Vec<f64> = (0..200)
            .map(|_| {
                motion.go_on(instants);
                let start = Instant::now();
                motion.ask(&mut live);
                start.elapsed().as_nanos() as f64 / instants as f64
            })
            .collect();
        ns.sort_by(f64::total_cmp);
        println!("live: {count} effects in {:.3} µs", ns[ns.len() / 2] / 1e3);
    }
}
