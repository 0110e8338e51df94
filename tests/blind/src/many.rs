//! Three to seven effects at once, in two to four records of different kinds.

use crate::bench::{Bench, Heat, Kind};
use crate::case::Hides;
use crate::choose;
use crate::dice::Dice;
use crate::rivals;
use crate::scene::Scene;
use crate::source::Source;

const LAWS: [&str; 17] = [
    "scale",
    "position_map",
    "screw_periodic",
    "reversal",
    "reversal_spike",
    "straightness",
    "squareness",
    "rotation",
    "thermal_expansion",
    "thermal_growth",
    "thermal_lag",
    "spindle_speed",
    "coolant",
    "following_error",
    "warm_up",
    "lost_counts",
    "offset",
];

/// Zeros of the gauges of a case's records.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Zeros {
    /// One zero for all gauges.
    Shared,
    /// Half of the records have a zero of their own.
    Own,
    /// Zeros of their own, and a ballbar that is read along its bar.
    Radial,
}

/// Own share of an effect up to which the others explain it, so it is not counted.
const TOLD: f64 = 0.02;

/// A random scene; `None` where the draw makes no case.
pub(crate) fn scene(dice: &mut Dice, choice: f64, zeros: Zeros) -> Option<Scene> {
    let mut kinds = vec![Kind::Line, Kind::Line, Kind::Plate, Kind::Drift];
    kinds.push(if zeros == Zeros::Radial { Kind::Radial } else { Kind::Circle });
    let wanted = dice.int(2, 4);
    while kinds.len() > wanted {
        // The kind that the class needs stays.
        let last = kinds.len() - 1 - usize::from(zeros == Zeros::Radial);
        kinds.remove(dice.int(0, last));
    }
    let rig = dice.chance(0.7).then(|| Heat::new(dice));
    let clock = dice.chance(0.8);
    let mut start = 0.0;
    let mut benches: Vec<Bench> = Vec::new();
    for (k, kind) in kinds.iter().enumerate() {
        let rows = dice.log(60.0, 300.0) as usize;
        let responses = dice.int(1, 3);
        let mut b = Bench::new(dice, *kind, rows, rig.clone());
        if clock {
            b = b.on_the_clock(responses);
        }
        b.start_s = start;
        if zeros != Zeros::Shared && (dice.chance(0.5) || *kind == Kind::Radial) {
            b.zero = Some(format!("setup {}", k + 1));
        }
        start = b.run(0).time().last().copied().unwrap_or(0.0) + dice.log(60.0, 3000.0);
        benches.push(b);
    }
    // Without a clock each record starts again at row 0.
    let mut s = Scene::new(dice, "many", &benches);
    if dice.chance(0.5) {
        s.held = benches.iter().map(|b| b.run(77)).collect();
    } else {
        s.held = vec![dice.pick(&benches).run(77)];
    }
    let draw = |dice: &mut Dice, s: &Scene| -> Option<Source> {
        let k = dice.int(0, s.runs.len() - 1);
        let law = *dice.pick(&LAWS);
        let needs_clock = ["warm_up", "lost_counts", "thermal_lag"].contains(&law);
        if needs_clock && !clock {
            return None;
        }
        choose::source(dice, &s.runs[k], law, benches[k].places)
    };
    for _ in 0..*dice.pick(&[0, 0, 1, 2]) {
        let Some(mut k) = draw(dice, &s) else { continue };
        let size = dice.log(1.0, 10.0);
        if !k.name.starts_with("lost_counts")
            && s.known.iter().all(|o| o.name != k.name)
            && s.sized(&mut k, size)
        {
            s.know(dice, k, 0.05);
        }
    }
    let wanted = 3 + (choice * 5.0) as usize;
    for _ in 0..60 {
        if s.hidden.len() == wanted {
            break;
        }
        let Some(mut h) = draw(dice, &s) else { continue };
        let size = dice.log(0.7, 20.0);
        if s.sized(&mut h, size) {
            s.hide(h);
        }
    }
    s.hides = Hides::Many;
    (s.hidden.len() + 1 >= wanted).then_some(s)
}

/// Whether each hidden effect must be found.
/// It must be large enough in some record, and the others must not explain it.
pub fn detectable(s: &Scene) -> Vec<bool> {
    (0..s.hidden.len())
        .map(|k| {
            let others: Vec<&Source> =
                (0..s.hidden.len()).filter(|j| *j != k).map(|j| &s.hidden[j]).chain(&s.known).collect();
            let constant = s.hidden[k].name.starts_with("offset.");
            !constant
                && s.ratio(&s.hidden[k]) >= 2.0
                && rivals::own_share(&s.hidden[k], &others, &s.runs) > TOLD
        })
        .collect()
}
