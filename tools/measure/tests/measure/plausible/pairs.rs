//! Every mistake beside its clean twin.

use super::{
    Clean, Machine, Mistake, actual, again, ballbar, by_name, drift, dynamics, growing, lively_drift,
    long_axis, one, patched, plate, positioning, positioning_timed, probing, repeated, rows_again, scaled,
    two_drift, warming, warming_through, wild,
};
use rtec_measure::plausible::MistakeKind::{
    self, Direction, Doubled, Jump, Outliers, Range, Sign, Stuck, Swapped, Unit, Unplugged,
};
use rtec_measure::plausible::{steps_of, suspicions};
use rtec_model::record::Record;
use test_needs::dice::Dice;
use test_needs::{cases, repetitions};

fn three_positioning(m: &Machine, d: &mut Dice) -> Vec<Record> {
    ["a", "b", "c"].map(|n| m.positioning(d, n)).into()
}

/// A record with the decimal point of one position elsewhere; not of the first or the last row, nor one close to zero.
fn slipped(mut r: Record, name: &str, d: &mut Dice, by: f64) -> Record {
    let p = &mut by_name(&mut r, name).data;
    let farthest = p.iter().fold(0.0_f64, |m, p| m.max(p.abs()));
    let rows: Vec<usize> = (1..p.len() - 1).filter(|i| p[*i].abs() > 0.3 * farthest).collect();
    p[rows[d.below(rows.len())]] *= by;
    again(&r)
}

/// Name, the clean records, the mistake, what must be said, and of which column ("" for any).
const PAIRS: [(&str, Clean, Mistake, MistakeKind, &str); 58] = [
    ("position in m", positioning, |r, _| vec![scaled(one(r), "x", 1e-3, 0.0)], Unit, "x"),
    ("position in µm", positioning, |r, _| vec![scaled(one(r), "x", 1e3, 0.0)], Unit, "x"),
    ("plate in m", plate, |r, _| vec![scaled(one(r), "X", 1e-3, 0.0)], Unit, "X"),
    ("error in mm", positioning, |r, _| vec![scaled(one(r), "e", 1e-3, 0.0)], Unit, "e"),
    ("error in m", drift, |r, _| vec![scaled(one(r), "e", 1e-6, 0.0)], Unit, "e"),
    ("temperature in K", drift, |r, _| vec![scaled(one(r), "T1", 1.0, 273.15)], Unit, "T1"),
    ("temperature in °F", drift, |r, _| vec![scaled(one(r), "T0", 1.8, 32.0)], Unit, "T0"),
    ("time in ms, positioning", positioning_timed, |r, _| vec![scaled(one(r), "t", 1e3, 0.0)], Unit, "t"),
    ("time in ms, drift", drift, |r, _| vec![scaled(one(r), "t", 1e3, 0.0)], Unit, "t"),
    ("time in ms, ballbar", ballbar, |r, _| vec![scaled(one(r), "t", 1e3, 0.0)], Unit, "t"),
    ("position in m, ballbar", ballbar, |r, _| vec![scaled(one(r), "x", 1e-3, 0.0)], Unit, "x"),
    ("speed in mm/min", ballbar, |r, _| vec![scaled(one(r), "vx", 60.0, 0.0)], Unit, "vx"),
    ("position in m, dynamics", dynamics, |r, _| vec![scaled(one(r), "q", 1e-3, 0.0)], Unit, "q"),
    ("speed with the other sign", dynamics, |r, _| vec![scaled(one(r), "qd", -1.0, 0.0)], Sign, "qd"),
    (
        "angle in degrees",
        probing,
        |r, _| {
            let n = r[0].rows() as f64;
            let mut r = one(r);
            for (i, v) in by_name(&mut r, "w").data.iter_mut().enumerate() {
                *v = (i as f64 * 360.0 / n).round();
            }
            vec![again(&r)]
        },
        Unit,
        "w",
    ),
    ("direction opposite", positioning, |r, _| vec![scaled(one(r), "dir", -1.0, 0.0)], Direction, "dir"),
    ("direction 0 and 1", positioning, |r, _| vec![scaled(one(r), "dir", 0.5, 0.5)], Direction, "dir"),
    ("direction always 1", positioning, |r, _| vec![scaled(one(r), "dir", 0.0, 1.0)], Direction, "dir"),
    ("direction opposite, circle", ballbar, |r, _| vec![scaled(one(r), "dx", -1.0, 0.0)], Direction, "dx"),
    (
        "position and error exchanged",
        positioning,
        |r, _| {
            let mut r = one(r);
            let x = std::mem::take(&mut by_name(&mut r, "x").data);
            let e = std::mem::replace(&mut by_name(&mut r, "e").data, x);
            by_name(&mut r, "x").data = e;
            vec![again(&r)]
        },
        Swapped,
        "e",
    ),
    ("actual position in mm", positioning, |r, _| vec![actual(one(r), 1.0)], Swapped, "e"),
    ("actual position in µm", positioning, |r, _| vec![actual(one(r), 1000.0)], Swapped, "e"),
    ("unplugged at 999.9", drift, |r, _| vec![scaled(one(r), "T2", 0.0, 999.9)], Unplugged, "T2"),
    (
        "unplugged at -127, at times",
        drift,
        |r, _| vec![patched(one(r), "T2", 0.4, 0.6, |_| -127.0)],
        Unplugged,
        "T2",
    ),
    (
        "power-on value 85, at times",
        drift,
        |r, _| vec![patched(one(r), "T1", 0.5, 0.51, |_| 85.0)],
        Unplugged,
        "T1",
    ),
    ("850 °C", drift, |r, _| vec![patched(one(r), "T3", 0.7, 1.0, |_| 850.0)], Unplugged, "T3"),
    ("-32768", drift, |r, _| vec![patched(one(r), "T3", 0.1, 0.2, |_| -32768.0)], Unplugged, "T3"),
    ("0 °C from a row on", drift, |r, _| vec![patched(one(r), "T2", 0.6, 1.0, |_| 0.0)], Unplugged, "T2"),
    ("410 °C", drift, |r, _| vec![scaled(one(r), "T2", 1.0, 410.0)], Range, "T2"),
    ("dead all the time", lively_drift, |r, _| vec![scaled(one(r), "T2", 0.0, 23.4)], Stuck, "T2"),
    (
        "stuck for a stretch",
        lively_drift,
        |r, _| vec![patched(one(r), "T1", 0.3, 0.7, |_| 31.02)],
        Stuck,
        "T1",
    ),
    ("a step of 12 K", drift, |r, _| vec![patched(one(r), "T0", 0.5, 1.0, |v| v + 12.0)], Jump, "T0"),
    (
        "sensor spikes",
        drift,
        |r, d| {
            let mut r = one(r);
            let n = r.rows();
            for _ in 0..5 {
                let i = 5 + d.below(n - 10);
                by_name(&mut r, "T1").data[i] += 25.0;
            }
            vec![again(&r)]
        },
        Outliers,
        "T1",
    ),
    (
        "rows doubled",
        positioning,
        |r, _| {
            let rows: Vec<usize> =
                (0..r[0].rows()).flat_map(|i| if i % 5 == 2 { vec![i, i] } else { vec![i] }).collect();
            vec![rows_again(&r[0], &rows)]
        },
        Doubled,
        "",
    ),
    (
        "every row doubled",
        drift,
        |r, _| {
            let rows: Vec<usize> = (0..r[0].rows()).flat_map(|i| [i, i]).collect();
            vec![rows_again(&r[0], &rows)]
        },
        Doubled,
        "",
    ),
    (
        "a block pasted again",
        plate,
        |r, _| {
            let n = r[0].rows();
            let rows: Vec<usize> = (0..n).chain(10..10 + n / 3).collect();
            vec![rows_again(&r[0], &rows)]
        },
        Doubled,
        "",
    ),
    (
        "two columns alike",
        drift,
        |r, _| {
            let mut r = one(r);
            let t = by_name(&mut r, "T1").data.clone();
            by_name(&mut r, "T3").data = t;
            vec![again(&r)]
        },
        Doubled,
        "T3",
    ),
    ("5 % wild rows", positioning, |r, d| vec![wild(one(r), d, 0.05, 40.0)], Outliers, "e"),
    ("two wild approaches of all", repeated, |r, d| vec![wild(one(r), d, 0.02, 40.0)], Outliers, "e"),
    ("time in minutes, drift", warming, |r, _| vec![scaled(one(r), "t", 1.0 / 60.0, 0.0)], Unit, "t"),
    ("time in hours, drift", warming, |r, _| vec![scaled(one(r), "t", 1.0 / 3600.0, 0.0)], Unit, "t"),
    ("1 % wild rows", drift, |r, d| vec![wild(one(r), d, 0.01, 40.0)], Outliers, "e"),
    (
        "the direction of one run of several",
        positioning,
        |r, _| {
            let mut r = one(r);
            let m = r
                .columns
                .iter()
                .find(|c| c.name == "dir")
                .unwrap()
                .data
                .iter()
                .take_while(|d| **d > 0.0)
                .count();
            by_name(&mut r, "dir").data[..m].iter_mut().for_each(|v| *v = -1.0);
            vec![again(&r)]
        },
        Direction,
        "dir",
    ),
    (
        "a gauge that stands from the first row on",
        positioning,
        |r, _| vec![scaled(one(r), "e", 0.0, 1.7)],
        Stuck,
        "e",
    ),
    ("a gauge that stands, drift", drift, |r, _| vec![scaled(one(r), "e", 0.0, -3.0)], Stuck, "e"),
    (
        "a sign that turns on the way",
        repeated,
        |r, _| vec![patched(one(r), "e", 0.4, 1.0, |v| -v)],
        Sign,
        "e",
    ),
    (
        "a sign that turns on the way, drift",
        growing,
        |r, _| vec![patched(one(r), "e", 0.6, 1.0, |v| -v)],
        Sign,
        "e",
    ),
    ("position in inches", long_axis, |r, _| vec![scaled(one(r), "x", 1.0 / 25.4, 0.0)], Unit, "x"),
    (
        "temperature and error exchanged",
        drift,
        |r, _| {
            let mut r = one(r);
            let e = std::mem::take(&mut by_name(&mut r, "e").data);
            let t = std::mem::replace(&mut by_name(&mut r, "T1").data, e);
            by_name(&mut r, "e").data = t;
            vec![again(&r)]
        },
        Swapped,
        "e",
    ),
    (
        "a clock put forward",
        warming_through,
        |r, _| {
            let at = r[0].rows() / 8;
            let mut r = one(r);
            by_name(&mut r, "t").data[at..].iter_mut().for_each(|t| *t += 3600.0);
            vec![again(&r)]
        },
        Jump,
        "t",
    ),
    (
        "a sign in one of three",
        three_positioning,
        |mut r, _| {
            r[0] = scaled(r[0].clone(), "e", -1.0, 0.0);
            r
        },
        Sign,
        "e",
    ),
    (
        "a sign in one of two drifts",
        two_drift,
        |mut r, _| {
            r[1] = scaled(r[1].clone(), "e", -1.0, 0.0);
            r
        },
        Sign,
        "e",
    ),
    (
        "two sensors exchanged in one record",
        two_drift,
        |mut r, _| {
            let a = std::mem::take(&mut by_name(&mut r[1], "T0").data);
            let b = std::mem::replace(&mut by_name(&mut r[1], "T1").data, a);
            by_name(&mut r[1], "T0").data = b;
            r[1] = again(&r[1]);
            r
        },
        Swapped,
        "",
    ),
    ("decimal point to the right", positioning, |r, d| vec![slipped(one(r), "x", d, 10.0)], Outliers, "x"),
    ("decimal point to the left", positioning, |r, d| vec![slipped(one(r), "x", d, 0.1)], Outliers, "x"),
    ("decimal point, plate", plate, |r, d| vec![slipped(one(r), "X", d, 0.1)], Outliers, "X"),
    (
        "decimal point by two, three runs",
        three_positioning,
        |r, d| {
            let mut r = r;
            r[1] = slipped(r[1].clone(), "x", d, 100.0);
            r
        },
        Outliers,
        "x",
    ),
    (
        "a bus that reads all ones of a sensor",
        drift,
        |r, d| {
            let reads = [-0.0625, 127.5, 128.86, 130.0][d.below(4)];
            vec![patched(one(r), "T1", 0.4, 1.0, |_| reads)]
        },
        Unplugged,
        "T1",
    ),
];

#[test]
fn each_mistake_is_said_and_its_clean_twin_is_not() {
    if !test_needs::long() {
        return;
    }
    let turns: Vec<u64> = repetitions(0..cases(15)).collect();
    let (mut said, mut all, mut wrong, mut clean) = (0, 0, 0, 0);
    for (k, (name, make, mistake, what, of)) in PAIRS.iter().enumerate() {
        let (mut own, mut missed, mut false_ones) = (0_u32, Vec::new(), Vec::new());
        for turn in turns.iter().copied() {
            let mut d = Dice::new(1000 * k as u64 + turn);
            let machine = Machine::random(&mut d);
            let records = make(&machine, &mut d);
            let twin = suspicions(&records);
            let steps = steps_of(&records);
            clean += 1;
            wrong += u32::from(!twin.is_empty() || !steps.is_empty());
            false_ones.extend(steps);
            false_ones.extend(twin.iter().map(ToString::to_string));
            let found = suspicions(&mistake(records, &mut d));
            let right = found.iter().any(|s| s.what == *what && (of.is_empty() || s.column == *of));
            own += u32::from(right);
            if !right {
                missed.push((turn, found.iter().map(ToString::to_string).collect::<Vec<_>>()));
            }
        }
        all += turns.len() as u32;
        said += own;
        println!("{name:38} {own:3} of {}; clean twins suspected: {}", turns.len(), false_ones.len());
        missed.iter().take(2).for_each(|m| println!("    missed {m:?}"));
        false_ones.iter().take(3).for_each(|f| println!("    clean: {f}"));
    }
    let (rate, false_rate) = (f64::from(said) / f64::from(all), f64::from(wrong) / f64::from(clean));
    println!(
        "said {said} of {all} ({:.1} %), clean suspected {wrong} of {clean} ({:.2} %)",
        100.0 * rate,
        100.0 * false_rate
    );
    assert!(rate >= 0.9 && false_rate <= 0.01);
}
