//! Shapes outside the dictionary, each with an experiment that shows it.

use crate::bench::{Bench, Heat, Kind};
use crate::case::Hides;
use crate::choose;
use crate::dice::Dice;
use crate::scene::Scene;
use crate::source::Source;

/// Shape, kind of experiment, and whether it needs sensors or several speeds.
const SHAPES: [(&str, Kind, bool, bool); 10] = [
    ("?breathing", Kind::Drift, true, false),
    ("?breathing", Kind::Line, false, false),
    ("?place_two_sensors", Kind::Line, true, false),
    ("?hysteresis", Kind::Line, false, false),
    ("?one_way_wave", Kind::Line, false, false),
    ("?place_speed", Kind::Line, false, true),
    ("?place_speed", Kind::Circle, false, true),
    ("?dead_zone", Kind::Drift, true, false),
    ("?cross_speed_squared", Kind::Circle, false, true),
    ("?ageing", Kind::Drift, true, false),
];

/// A random scene; `None` where the draw makes no case.
pub(crate) fn scene(dice: &mut Dice, choice: f64) -> Option<Scene> {
    let (shape, kind, sensors, speeds) = SHAPES[(choice * SHAPES.len() as f64) as usize];
    let rows = dice.log(120.0, 600.0) as usize;
    let rig = (sensors || dice.chance(0.2)).then(|| Heat::new(dice));
    let responses = dice.int(1, 2);
    let (targets, regular) = (dice.int(10, 40), dice.chance(0.4));
    let mut bench = Bench::new(dice, kind, rows, rig).with_targets(targets, regular).on_the_clock(responses);
    bench.speeds |= speeds;
    let mut s = Scene::new(dice, "strangers", std::slice::from_ref(&bench));
    let axis = &bench.axes[0];
    if dice.chance(0.3) {
        let law = *dice.pick(&["scale", "reversal", "thermal_growth", "following_error"]);
        if let Some(mut k) = choose::source(dice, &s.runs[0], law, bench.places) {
            let size = dice.log(1.0, 6.0);
            s.sized(&mut k, size).then_some(())?;
            s.know(dice, k, 0.05);
        }
    }
    let mut h = Source::new(format!("{shape}.{axis}.{}", bench.axes[1]))
        .p("um", dice.sign())
        .p("c", dice.int(1, 1_000_000) as f64);
    let names = s.runs[0].names("temperature");
    if sensors {
        let one = dice.int(0, names.len() - 1);
        let two = (one + dice.int(1, names.len() - 1)) % names.len();
        h.text = vec![("sensor", names[one].clone()), ("minus", names[two].clone())];
    }
    let size = dice.log(0.7, 20.0);
    s.hides = Hides::Stranger;
    (s.sized(&mut h, size) && s.hide_shape(h, &[], true)).then_some(s)
}
