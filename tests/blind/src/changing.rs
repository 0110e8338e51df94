//! Repeatable shapes over the position that are not a single wave.
//! They are changing periods, several waves, kinks and steps.

use crate::bench::{Bench, Kind};
use crate::case::Hides;
use crate::dice::Dice;
use crate::scene::Scene;
use crate::source::Source;

/// A random scene; `None` where the draw makes no case.
pub(crate) fn scene(dice: &mut Dice, choice: f64) -> Option<Scene> {
    let rows = dice.log(80.0, 600.0) as usize;
    let targets = (dice.log(20.0, 200.0) as usize).min(rows / 2);
    let regular = dice.chance(0.4);
    let bench = Bench::new(dice, Kind::Line, rows, None).with_targets(targets, regular);
    let mut s = Scene::new(dice, "changing", std::slice::from_ref(&bench));
    let axis = &bench.axes[0];
    if dice.chance(0.3) {
        let mut k = Source::new(format!("reversal.{axis}")).p("um", dice.sign());
        let size = dice.log(1.0, 6.0);
        s.sized(&mut k, size).then_some(())?;
        s.know(dice, k, 0.05);
    }
    let shape = ["?chirp", "?chirp", "?waves", "?kinks", "?stairs"][(choice * 5.0) as usize];
    let mut h =
        Source::new(format!("{shape}.{axis}")).p("um", dice.sign()).p("c", dice.int(1, 1_000_000) as f64);
    let size = dice.log(0.7, 20.0);
    s.hides = Hides::Stranger;
    // A shape over the position includes a constant and a straight line.
    let with = |more: &[&str]| {
        let mut names: Vec<String> = more.iter().map(|n| format!("{n}.{axis}")).collect();
        names.push(format!("position_map.{axis}"));
        names.sort();
        names
    };
    s.also = vec![with(&[]), with(&["offset"]), with(&["scale"]), with(&["offset", "scale"])];
    (s.sized(&mut h, size) && s.hide_shape(h, &["position_map"], true)).then_some(s)
}
