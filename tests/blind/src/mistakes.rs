//! Mistakes that people make with their records.
//! Each case has a twin without the mistake.

use crate::bench::{Bench, Heat, Kind};
use crate::case::Hides;
use crate::choose;
use crate::dice::Dice;
use crate::scene::Scene;
use std::f64::consts::{PI, TAU};

/// Mistakes: the word that the answer should give, and what was done.
pub const KINDS: [(&str, &str); 14] = [
    ("unit", "errors in mm, called µm, in one record"),
    ("unit", "positions in m, called mm, in one record"),
    ("sign", "error's sign flipped in one record"),
    ("direction", "direction flipped in one record"),
    ("direction", "direction as 0 and 1"),
    ("unit", "actual position in place of the error"),
    ("doubled", "rows doubled"),
    ("unplugged", "a sensor reads 999.9"),
    ("unplugged", "a sensor reads -127"),
    ("stuck", "a sensor is stuck"),
    ("swapped", "two sensors swapped in one record"),
    ("swapped", "two sensors swapped against the model"),
    ("outliers", "one row in twenty wild"),
    ("other_machine", "hold-out of another machine"),
];

/// A mistake in a scene.
#[derive(Clone, Debug)]
pub struct Mistake {
    /// The word that the answer should give.
    pub what: &'static str,
    /// The description, one line.
    pub text: &'static str,
    /// Columns with the mistake.
    pub columns: Vec<String>,
}

/// A random scene without a mistake; `None` where the draw makes no case.
pub(crate) fn scene(dice: &mut Dice) -> Option<Scene> {
    let mut rig = Heat::new(dice);
    rig.sensors = dice.int(3, 5);
    let rows = dice.log(80.0, 240.0) as usize;
    let (targets, regular) = (dice.int(8, 21), dice.chance(0.5));
    let first = Bench::new(dice, Kind::Line, rows, Some(rig)).with_targets(targets, regular).on_the_clock(1);
    let mut benches = vec![first];
    for _ in 0..dice.int(1, 2) {
        let mut again = benches[0].clone();
        let before = benches[benches.len() - 1].run(0);
        again.start_s = before.time().last().copied().unwrap_or(0.0) + 900.0;
        benches.push(again);
    }
    let mut s = Scene::new(dice, "mistakes", &benches);
    // Each record is another run of the bench.
    s.runs = benches.iter().enumerate().map(|(k, b)| b.run(k as u64)).collect();
    s.held = vec![benches[0].run(77)];
    for law in ["thermal_growth", "reversal", "scale", "position_map"] {
        let Some(mut k) = choose::source(dice, &s.runs[0], law, benches[0].places) else { continue };
        if law == "thermal_growth" {
            k.text.truncate(1);
            k.num.retain(|(key, _)| *key != "reference_degC");
        }
        let size = dice.log(4.0, 12.0);
        s.sized(&mut k, size).then_some(())?;
        let off = *dice.pick(&[0.0, 0.03]);
        s.know(dice, k, off);
    }
    if dice.chance(0.4) {
        let law = *dice.pick(&["offset", "following_error", "thermal_expansion", "screw_periodic"]);
        let mut h = choose::source(dice, &s.runs[0], law, benches[0].places)?;
        let size = dice.log(2.0, 8.0);
        s.hides = Hides::One;
        (s.sized(&mut h, size) && s.hide(h)).then_some(())?;
    }
    Some(s)
}

/// Makes the mistake number `kind` in a measured scene.
pub(crate) fn spoil(s: &mut Scene, kind: usize, dice: &mut Dice) -> Mistake {
    let (what, text) = KINDS[kind];
    let last = s.runs.len() - 1;
    let sensor = s.known[0].word("sensor").unwrap_or("T1").to_owned();
    let response = s.runs[0].responses[0].replace("error.", "e_");
    let mut columns: Vec<String> = Vec::new();
    let column = |s: &mut Scene,
                  run: usize,
                  pick: &dyn Fn(&str, &str) -> bool,
                  f: &mut dyn FnMut(usize, f64) -> f64| {
        let mut names = Vec::new();
        for c in s.runs[run].cols.iter_mut().filter(|c| pick(&c.name, &c.role)) {
            c.v.iter_mut().enumerate().for_each(|(i, v)| *v = f(i, *v));
            names.push(c.name.clone());
        }
        names
    };
    match kind {
        0 | 2 => {
            let by = if kind == 0 { 1e-3 } else { -1.0 };
            s.measured[last].iter_mut().flatten().for_each(|e| *e *= by);
            columns.push(response);
        }
        1 => columns = column(s, last, &|_, role| role.starts_with("position"), &mut |_, v| v * 1e-3),
        3 => columns = column(s, last, &|_, role| role.starts_with("direction"), &mut |_, v| -v),
        4 => {
            for k in 0..=last {
                columns = column(s, k, &|_, role| role.starts_with("direction"), &mut |_, v| v.max(0.0));
            }
        }
        5 => {
            for k in 0..=last {
                let p = s.runs[k].cols.iter().find(|c| c.role.starts_with("position")).map(|c| c.v.clone());
                for (e, p) in s.measured[k].iter_mut().flatten().zip(p.unwrap_or_default()) {
                    *e = p + *e * 1e-3;
                }
            }
            columns.push(response);
        }
        6 => {
            // A part of the log is doubled, each of its rows right behind itself.
            let n = s.runs[last].n;
            let (from, to) = (n / 4, n / 4 + (n as f64 * dice.within(0.2, 0.6)) as usize);
            let twice = |v: &[f64]| -> Vec<f64> {
                (0..n).flat_map(|i| vec![v[i]; if (from..to).contains(&i) { 2 } else { 1 }]).collect()
            };
            let run = &mut s.runs[last];
            run.cols.iter_mut().for_each(|c| c.v = twice(&c.v));
            run.true_degc.iter_mut().for_each(|(_, v)| *v = twice(v));
            run.n += to - from;
            s.measured[last].iter_mut().for_each(|e| *e = twice(e));
        }
        7 | 8 => {
            let value = if kind == 7 { 999.9 } else { -127.0 };
            let n = s.runs[last].n;
            let part = if dice.chance(0.4) { 0 } else { (n as f64 * dice.within(0.3, 0.8)) as usize };
            columns =
                column(s, last, &|name, _| name == sensor, &mut |i, v| if i < part { v } else { value });
        }
        9 => {
            let part = (s.runs[last].n as f64 * dice.within(0.0, 0.4)) as usize;
            let mut held = f64::NAN;
            columns = column(s, last, &|name, _| name == sensor, &mut |i, v| {
                if i <= part {
                    held = v;
                }
                held
            });
        }
        10 | 11 => {
            let names = s.runs[0].names("temperature");
            let others: Vec<&String> = names.iter().filter(|n| **n != sensor).collect();
            let other = (*dice.pick(&others)).clone();
            for k in if kind == 10 { last..=last } else { 0..=last } {
                let run = &mut s.runs[k];
                let at = |name: &str| run.cols.iter().position(|c| c.name == name);
                if let (Some(a), Some(b)) = (at(&sensor), at(&other)) {
                    let v = std::mem::take(&mut run.cols[a].v);
                    let w = std::mem::replace(&mut run.cols[b].v, v);
                    run.cols[a].v = w;
                }
            }
            columns = vec![sensor, other];
        }
        12 => {
            let sd = s.sd();
            let far = s.measured[last][0].iter().fold(0.0_f64, |m, e| m.max(e.abs()));
            for e in s.measured[last].iter_mut().flatten() {
                if dice.chance(0.05) {
                    *e += dice.sign() * dice.within(10.0, 50.0) * sd.max(far * 0.1);
                }
            }
            columns.push(response);
        }
        _ => {
            // Its errors are those of another machine: as large, with other shapes.
            let k = s.runs.len();
            let a = s.runs[0].responses[0].replace("error.", "");
            let p = s.held[0].get(&format!("position.{a}")).unwrap_or_default().to_vec();
            let size = crate::case::rms(&s.measured[k][0]).max(5.0 * s.sd());
            let (f, phase, up) = (dice.within(1.0, 3.0), dice.within(0.0, TAU), dice.sign());
            let reach = p.iter().fold(1e-9_f64, |m, v| m.max(v.abs()));
            let alone = s.noise_alone[k][0].clone();
            for ((e, p), n) in s.measured[k][0].iter_mut().zip(&p).zip(alone) {
                let x = p / reach;
                *e = n + size * (1.6 * up * x + 1.2 * (PI * f * x + phase).sin());
            }
            columns.push(response);
        }
    }
    Mistake { what, text, columns }
}
