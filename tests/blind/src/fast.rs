//! Cycles of a few to some dozens of rows, in records with gaps.
//! They come from logged coolant, or from a pump that is not logged.

use crate::bench::{Bench, Heat, Kind};
use crate::case::Hides;
use crate::dice::Dice;
use crate::scene::Scene;
use crate::source::Source;

/// A random scene; `None` where the draw makes no case.
pub(crate) fn scene(dice: &mut Dice, choice: f64) -> Option<Scene> {
    let rows = dice.log(100.0, 600.0) as usize;
    let rig = dice.chance(0.5).then(|| Heat::new(dice));
    let kind = if dice.chance(0.7) { Kind::Drift } else { Kind::Line };
    let period = dice.log(5.0, 60.0);
    let gaps = dice.int(1, 4);
    let logged = choice < 0.4;
    let responses = dice.int(1, 2);
    let mut bench = Bench::new(dice, kind, rows, rig).on_the_clock(responses);
    (bench.wet, bench.gaps) = (logged.then_some(period), gaps);
    let mut s = Scene::new(dice, "fast", std::slice::from_ref(&bench));
    let axis = &bench.axes[0];
    // A cycle needs at least three periods.
    (period * 3.0 < s.runs[0].n as f64).then_some(())?;
    let size = dice.log(0.7, 20.0);
    if logged {
        let mut h = Source::new(format!("coolant.{axis}")).p("um", dice.sign());
        s.hides = Hides::One;
        (s.sized(&mut h, size) && s.hide(h)).then_some(s)
    } else {
        let shape = *dice.pick(&["?cycle_sine", "?cycle_square", "?cycle_saw", "?cycle_charge"]);
        let mut h = Source::new(format!("{shape}.{axis}")).p("um", dice.sign()).p("c", period);
        s.hides = Hides::Stranger;
        (s.sized(&mut h, size) && s.hide_shape(h, &[], false)).then_some(s)
    }
}
