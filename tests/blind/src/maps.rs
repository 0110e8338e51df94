//! A machine that was mapped finer or farther than it is measured now.
//! One or more other effects are hidden, or none.

use crate::bench::{Bench, Heat, Kind};
use crate::case::Hides;
use crate::choose;
use crate::dice::Dice;
use crate::run::Run;
use crate::scene::Scene;
use crate::source::{Source, broken_line};

const MISSING: [&str; 9] = [
    "scale",
    "offset",
    "squareness",
    "rotation",
    "thermal_expansion",
    "screw_periodic",
    "reversal",
    "following_error",
    "thermal_growth",
];

/// A random scene; `None` where the draw makes no case.
pub(crate) fn scene(dice: &mut Dice, choice: f64) -> Option<Scene> {
    let plane = (0.75 * 2.0 / 9.0..0.75 * 4.0 / 9.0).contains(&choice);
    let kind = if plane || dice.chance(0.3) { Kind::Plate } else { Kind::Line };
    let rig = dice.chance(0.5).then(|| Heat::new(dice));
    let rows = dice.log(60.0, 300.0) as usize;
    let (targets, regular) = (dice.int(6, 16), dice.chance(0.4));
    let mut bench = Bench::new(dice, kind, rows, rig).with_targets(targets, regular);
    if plane {
        bench.responses = if choice < 0.25 { 1 } else { 2 };
    }
    let mut s = Scene::new(dice, "maps", std::slice::from_ref(&bench));
    let (a, b) = (&bench.axes[0], &bench.axes[1]);
    let mut maps = vec![map(dice, &s.runs, &bench, a, a)];
    if kind == Kind::Plate {
        let other = map(dice, &s.runs, &bench, a, b);
        if dice.chance(0.5) { maps = vec![other] } else { maps.push(other) }
    }
    for mut m in maps {
        let size = dice.log(3.0, 20.0);
        if !s.sized(&mut m, size) {
            return None;
        }
        let off = if dice.chance(0.4) { 0.0 } else { 0.1 };
        s.know(dice, m, off);
    }
    if choice < 0.75 {
        let law = MISSING[(choice / 0.75 * MISSING.len() as f64) as usize];
        let mut h = choose::source(dice, &s.runs[0], law, bench.places)?;
        let size = dice.log(0.7, 20.0);
        s.hides = Hides::One;
        (s.sized(&mut h, size) && s.hide(h)).then_some(())?;
    }
    Some(s)
}

/// The map of axis `a` over the position of `b`.
/// It has more knots than there are places, and ends beyond them.
fn map(dice: &mut Dice, runs: &[Run], bench: &Bench, a: &str, b: &str) -> Source {
    let p: Vec<f64> =
        runs.iter().filter_map(|r| r.get(&format!("position.{b}"))).flatten().copied().collect();
    let mut places: Vec<i64> = p.iter().map(|p| (p * 10.0).round() as i64).collect();
    places.sort_unstable();
    places.dedup();
    let count = ((places.len().min(31) as f64 * dice.within(1.1, 2.5)) as usize).clamp(8, 60);
    let beyond = |dice: &mut Dice| if dice.chance(0.6) { dice.within(0.02, 0.3) } else { 0.0 };
    let (lo, hi) = (
        bench.from_mm() - beyond(dice) * bench.travel_mm,
        bench.from_mm() + bench.travel_mm * (1.02 + beyond(dice)),
    );
    let knots: Vec<f64> = (0..count)
        .map(|i| ((lo + (hi - lo) * i as f64 / (count - 1) as f64) * 100.0).round() / 100.0)
        .collect();
    let mut walk = 0.0;
    let mut um: Vec<f64> = (0..count)
        .map(|_| {
            walk = 0.8 * walk + dice.normal();
            walk
        })
        .collect();
    // Without the constant and the straight line over the measured rows.
    let at: Vec<f64> = p.iter().map(|p| broken_line(&knots, &um, *p)).collect();
    let n = p.len() as f64;
    let (mp, me) = (p.iter().sum::<f64>() / n, at.iter().sum::<f64>() / n);
    let slope = p.iter().zip(&at).map(|(p, e)| (p - mp) * (e - me)).sum::<f64>()
        / p.iter().map(|p| (p - mp).powi(2)).sum::<f64>();
    for (u, k) in um.iter_mut().zip(&knots) {
        *u -= me + slope * (k - mp);
    }
    let mut s =
        Source::new(if a == b { format!("position_map.{a}") } else { format!("straightness.{a}.{b}") });
    s.arr = vec![("knots_mm", knots), ("um", um)];
    s
}
