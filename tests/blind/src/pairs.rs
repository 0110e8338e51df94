//! Two effects of any laws over the wider experiments, in one record or two.

use crate::bench::{Bench, Heat, Kind};
use crate::case::{Hides, LAWS};
use crate::choose;
use crate::dice::Dice;
use crate::scene::Scene;

/// A random scene; `None` where the draw makes no case.
pub(crate) fn scene(dice: &mut Dice) -> Option<Scene> {
    let kind = *dice.pick(&[Kind::Line, Kind::Line, Kind::Drift, Kind::Plate, Kind::Circle]);
    let rig = dice.chance(0.5).then(|| Heat::new(dice));
    let rows = dice.log(60.0, 600.0) as usize;
    let first = Bench::new(dice, kind, rows, rig);
    let mut benches = vec![first];
    if dice.chance(0.25) {
        let mut again = benches[0].clone();
        again.start_s = benches[0].run(0).time().last().copied().unwrap_or(0.0) + 600.0;
        benches.push(again);
    }
    let mut s = Scene::new(dice, "pairs", &benches);
    for _ in 0..dice.int(0, 2) {
        let law = *dice.pick(&LAWS);
        if ["lost_counts", "channel", "form_bump"].contains(&law) {
            continue;
        }
        let Some(mut k) = choose::source(dice, &s.runs[0], law, benches[0].places) else { continue };
        let size = dice.log(1.0, 10.0);
        let off = *dice.pick(&[0.0, 0.03, 0.1]);
        if s.known.iter().all(|o| o.name != k.name) && s.sized(&mut k, size) {
            s.know(dice, k, off);
        }
    }
    for _ in 0..20 {
        let law = *dice.pick(&LAWS);
        let Some(mut h) = choose::source(dice, &s.runs[0], law, benches[0].places) else { continue };
        let size = dice.log(0.7, 20.0);
        if s.sized(&mut h, size) && s.hide(h) && s.hidden.len() == 2 {
            break;
        }
    }
    s.hides = Hides::Two;
    (s.hidden.len() == 2 && s.all_told()).then_some(s)
}
