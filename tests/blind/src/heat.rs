//! Machines whose error follows the true temperature.
//! The log has the sensors' noise and steps.

use crate::bench::{Bench, Heat, Kind};
use crate::case::Hides;
use crate::choose;
use crate::dice::Dice;
use crate::scene::Scene;

/// A random scene; `None` where the draw makes no case.
pub(crate) fn scene(dice: &mut Dice, choice: f64) -> Option<Scene> {
    let kind = if dice.chance(0.6) { Kind::Drift } else { Kind::Line };
    let rows = dice.log(80.0, 600.0) as usize;
    let rig = Heat::new(dice);
    let responses = dice.int(1, 3);
    let (targets, regular) = (dice.int(6, 21), dice.chance(0.5));
    let bench =
        Bench::new(dice, kind, rows, Some(rig)).with_targets(targets, regular).on_the_clock(responses);
    let mut s = Scene::new(dice, "heat", std::slice::from_ref(&bench));
    let laws: &[&str] = if kind == Kind::Drift {
        &["thermal_growth", "thermal_lag", "thermal_growth", "thermal_lag", "warm_up", "spindle_speed"]
    } else {
        &["thermal_growth", "thermal_lag", "thermal_expansion", "thermal_expansion", "reversal", "scale"]
    };
    if dice.chance(0.3) {
        let law = *dice.pick(laws);
        let mut k = choose::source(dice, &s.runs[0], law, bench.places)?;
        let size = dice.log(1.0, 10.0);
        s.sized(&mut k, size).then_some(())?;
        let off = *dice.pick(&[0.0, 0.03, 0.1]);
        s.know(dice, k, off);
    }
    let count = [0, 1, 1, 1, 1, 1, 2, 2][(choice * 8.0) as usize];
    for k in 0..count {
        // At least the first effect is thermal.
        let law = if k == 0 { laws[dice.int(0, 2)] } else { *dice.pick(laws) };
        let mut h = choose::source(dice, &s.runs[0], law, bench.places)?;
        let size = dice.log(0.7, 20.0);
        (s.sized(&mut h, size) && s.hide(h)).then_some(())?;
    }
    s.hides = [Hides::Nothing, Hides::One, Hides::Two][count];
    s.all_told().then_some(s)
}
