//! Mistakes in records, each beside its clean twin.
//! Said, and nothing said of the twin. The machines and runs are made here, by formulas of their own.

#![allow(clippy::unwrap_used)] // a test's own helpers

mod exchanged;
mod machine;
mod misread;
mod pairs;
mod quiet;
mod units;
mod wild_rows;

use machine::Machine;
use rtec_builders::{column, record};
use rtec_model::record::{Column, Record, Role, RunKind};
use test_needs::dice::Dice;

/// Noise with memory from row to row, maybe read in steps.
fn noise(d: &mut Dice, n: usize) -> (Vec<f64>, Option<f64>) {
    let (sd, phi) = ((d.between(-1.6, 1.2)).exp(), if d.chance(0.5) { d.between(0.0, 0.7) } else { 0.0 });
    let step = d.chance(0.3).then(|| sd * d.between(0.1, 1.2));
    let mut x = 0.0;
    let v = (0..n).map(|_| {
        x = phi * x + (1.0 - phi * phi).sqrt() * d.normal();
        sd * x
    });
    (v.collect(), step)
}

fn read(v: Vec<f64>, step: Option<f64>) -> Vec<f64> {
    let q = step.unwrap_or(1e-3);
    v.into_iter().map(|v| (v / q).round() * q).collect()
}

fn by_name<'a>(r: &'a mut Record, name: &str) -> &'a mut Column {
    r.columns.iter_mut().find(|c| c.name == name).unwrap()
}

/// The record again after its columns were changed.
fn again(r: &Record) -> Record {
    let mut new = Record::new(&r.path, r.kind, r.columns.clone()).unwrap();
    new.count_um = r.count_um;
    new
}

fn scaled(mut r: Record, name: &str, by: f64, add: f64) -> Record {
    by_name(&mut r, name).data.iter_mut().for_each(|v| *v = *v * by + add);
    again(&r)
}

/// A column's values from a row on, until another.
fn patched(mut r: Record, name: &str, from: f64, to: f64, of: impl Fn(f64) -> f64) -> Record {
    let n = r.rows() as f64;
    let (a, b) = ((n * from) as usize, (n * to) as usize);
    by_name(&mut r, name).data[a..b].iter_mut().for_each(|v| *v = of(*v));
    again(&r)
}

fn rows_again(r: &Record, rows: &[usize]) -> Record {
    again(&r.select(rows))
}

type Clean = fn(&Machine, &mut Dice) -> Vec<Record>;
type Mistake = fn(Vec<Record>, &mut Dice) -> Vec<Record>;

fn positioning(m: &Machine, d: &mut Dice) -> Vec<Record> {
    vec![m.positioning(d, "a")]
}

fn drift(m: &Machine, d: &mut Dice) -> Vec<Record> {
    vec![m.drift(d, "a")]
}

fn ballbar(m: &Machine, d: &mut Dice) -> Vec<Record> {
    vec![m.ballbar(d)]
}

fn dynamics(_: &Machine, d: &mut Dice) -> Vec<Record> {
    vec![Machine::dynamics(d)]
}

fn plate(m: &Machine, d: &mut Dice) -> Vec<Record> {
    vec![m.plate(d)]
}

fn probing(_: &Machine, d: &mut Dice) -> Vec<Record> {
    vec![Machine::probing(d)]
}

fn two_drift(m: &Machine, d: &mut Dice) -> Vec<Record> {
    ["a", "b"].map(|n| m.drift(d, n)).into()
}

fn one(r: Vec<Record>) -> Record {
    r.into_iter().next().unwrap()
}

fn wild(mut r: Record, d: &mut Dice, share: f64, sds: f64) -> Record {
    let e = r.columns.iter_mut().rfind(|c| c.role.is_response()).unwrap();
    let steps: Vec<f64> = e.data.windows(2).map(|w| (w[1] - w[0]).abs()).collect();
    let mut sorted = steps.clone();
    sorted.sort_by(f64::total_cmp);
    let size = sorted[sorted.len() / 2].max(0.3);
    let n = e.data.len();
    for _ in 0..((n as f64 * share) as usize).max(1) {
        let i = d.below(n);
        e.data[i] += size * sds * if d.chance(0.5) { 1.0 } else { -1.0 };
    }
    again(&r)
}

fn positioning_timed(m: &Machine, d: &mut Dice) -> Vec<Record> {
    loop {
        let r = m.positioning(d, "a");
        if r.columns.iter().any(|c| c.name == "t") {
            return vec![r];
        }
    }
}

/// A test cycle of five times both ways.
fn repeated(m: &Machine, d: &mut Dice) -> Vec<Record> {
    loop {
        let r = m.positioning(d, "a");
        if r.columns.iter().any(|c| c.name == "n" && c.data.iter().any(|n| *n >= 4.0)) {
            return vec![r];
        }
    }
}

/// A drift test in which the machine warms.
fn warming(m: &Machine, d: &mut Dice) -> Vec<Record> {
    loop {
        let r = m.drift(d, "a");
        let warm = |c: &&Column| {
            let (lo, hi) = c.data.iter().fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(*v), h.max(*v)));
            c.role == Role::Temperature && hi - lo > 4.0
        };
        if r.columns.iter().filter(warm).count() >= 3 {
            return vec![r];
        }
    }
}

/// A drift test in which the machine grows by more than its noise, at rest at first.
fn growing(m: &Machine, d: &mut Dice) -> Vec<Record> {
    loop {
        let r = one(warming(m, d));
        let e = &r.columns.iter().find(|c| c.name == "e").unwrap().data;
        let size = e.iter().fold(0.0_f64, |s, v| s.max(v.abs()));
        let at = (e.len() as f64 * 0.6) as usize;
        let rough = e.windows(2).map(|w| (w[1] - w[0]).abs()).sum::<f64>() / e.len() as f64;
        if size > 10.0 && e[at].abs() > 12.0 * rough {
            return vec![r];
        }
    }
}

fn actual(mut r: Record, per_mm: f64) -> Record {
    let x = by_name(&mut r, "x").data.clone();
    let e = &mut by_name(&mut r, "e").data;
    e.iter_mut().zip(x).for_each(|(e, x)| *e = per_mm * (x + *e / 1000.0));
    again(&r)
}

/// A scale that is far off, over an axis of half a metre.
fn long_axis(m: &Machine, d: &mut Dice) -> Vec<Record> {
    let sensors = m.sensors.clone();
    let long = Machine { ppm: 60.0, wave: 1.0, reversal: 3.0, travel: 400.0 + m.travel / 2.0, sensors, ..*m };
    loop {
        let r = long.positioning(d, "a");
        let e = &r.columns.iter().find(|c| c.name == "e").unwrap().data;
        let rough = e.windows(2).map(|w| (w[1] - w[0]).abs()).sum::<f64>() / e.len() as f64;
        if rough < 4.0 {
            return vec![r];
        }
    }
}

/// A machine that warms from the first row on at one speed.
fn warming_through(m: &Machine, d: &mut Dice) -> Vec<Record> {
    let slow = m.sensors.iter().map(|(gain, tau)| (*gain, tau.max(3000.0))).collect();
    let steady = Machine { sensors: slow, step_k: 0.001, ..*m };
    loop {
        let r = steady.drift(d, "a");
        let t = |k: usize| &r.columns.iter().find(|c| c.name == format!("T{k}")).unwrap().data;
        let at = r.rows() / 8;
        let rate = |k: usize, i: usize| (t(k)[i + 9] - t(k)[i]) / 9.0;
        let every = r.columns[0].data[1];
        let enough = |k: usize| {
            let (a, b) = (rate(k, at - 10), rate(k, at));
            (a - b).abs() < 0.15 * a.abs() && a.abs() * 3600.0 / every > 2.5
        };
        if at > 12 && (1..4).filter(|k| enough(*k)).count() >= 2 {
            return vec![r];
        }
    }
}

/// Sensors whose readings move from row to row.
fn lively_drift(m: &Machine, d: &mut Dice) -> Vec<Record> {
    let fine = Machine { step_k: 0.001, sensors: m.sensors.clone(), ..*m };
    vec![fine.drift(d, "a")]
}

/// Rounded as it is written.
fn rounded(v: impl Iterator<Item = f64>, step: f64) -> Vec<f64> {
    v.map(|v| (v / step).round() * step).collect()
}

/// Targets whose positions are given, three times to and fro.
/// A position for each row.
fn to_and_fro(targets: &[f64], d: &mut Dice) -> Vec<f64> {
    let there = targets.iter();
    let once: Vec<f64> = there.clone().chain(there.rev()).copied().collect();
    (0..3).flat_map(|_| once.clone()).map(|p| p + 0.003 * d.normal()).collect()
}

fn along(kind: RunKind, p: Vec<f64>, d: &mut Dice) -> Record {
    let e = p.iter().map(|p| 0.02 * p + 0.4 * d.normal()).collect();
    record("a", kind, vec![column("x", "position.x", p), column("e", "error.x", e)])
}

/// A plate gone over in a serpentine, along y within each column: x, y, and the rows' errors by a formula of place and row.
fn serpentine(side: usize, error: &mut dyn FnMut(f64, f64, usize) -> f64) -> Vec<Column> {
    let (mut x, mut y, mut e) = (vec![], vec![], vec![]);
    for column in 0..side {
        for k in 0..side {
            let k = if column % 2 == 0 { k } else { side - 1 - k };
            let (px, py) = (20.0 * column as f64, 20.0 * k as f64);
            e.push(error(px, py, x.len()));
            x.push(px);
            y.push(py);
        }
    }
    vec![column("x", "position.x", x), column("y", "position.y", y), column("e", "error.x", e)]
}
