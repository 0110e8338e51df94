//! One temperature or channel beside the others of its record.

use super::stats::{distinct, line, median, quantum, range, span, spread, steps};
use super::{Suspicion, What, is_sensor};
use crate::iso230::correlation;
use rtec_model::limits::disconnected;
use rtec_model::record::{Column, Record, Role};

/// What any sensor on a machine tool can read, °C.
const DEGC: [f64; 2] = [-40.0, 150.0];

pub(super) fn look(record: &Record, out: &mut Vec<Suspicion>) {
    let sensors: Vec<&Column> = record.columns.iter().filter(|c| c.role == Role::Temperature).collect();
    let mut good: Vec<&Column> = Vec::new();
    for c in &sensors {
        let others: Vec<&Column> = sensors.iter().filter(|o| o.name != c.name).copied().collect();
        let before = out.len();
        unplugged(record, c, &others, out);
        if out.len() == before {
            unit(record, c, &others, out);
        }
        if out.len() == before {
            good.push(c);
        }
    }
    for c in &good {
        let others: Vec<&Column> = good.iter().filter(|o| o.name != c.name).copied().collect();
        if !stuck(record, c, &others, out) && !jump(record, c, &others, out) {
            wild(record, c, &others, out);
        }
    }
    copies(record, out);
}

/// Rows that show an open input's code, or what no sensor reads.
fn unplugged(record: &Record, c: &Column, others: &[&Column], out: &mut Vec<Suspicion>) {
    let coded = |v: f64| disconnected(v).filter(|(_, certain)| *certain).map(|d| d.0);
    let rest: Vec<f64> = c
        .data
        .iter()
        .copied()
        .filter(|v| disconnected(*v).is_none() && *v > DEGC[0] && *v < DEGC[1])
        .collect();
    // Where this sensor is warm at other times, or else the others.
    let usual = if rest.is_empty() {
        let near = others.iter().flat_map(|o| &o.data).copied().filter(|v| *v > DEGC[0] && *v < DEGC[1]);
        median(near.collect())
    } else {
        median(rest.clone())
    };
    let known = !rest.is_empty() || !others.is_empty();
    let mut rows = Vec::new();
    let mut why = "";
    for (i, v) in c.data.iter().enumerate() {
        let off = coded(*v).or_else(|| {
            let doubtful = disconnected(*v).map(|d| d.0);
            doubtful.filter(|_| known && (v - usual).abs() > 15.0 && !passes_through(c, i))
        });
        if let Some(off) = off {
            rows.push(i);
            why = off;
        }
    }
    if let Some(i) = rows.first() {
        let all = rows.len() == c.data.len();
        let text = format!("reads {} degC: {why}{}", c.data[*i], if all { "" } else { " in some rows" });
        out.push(Suspicion::new(record, &c.name, What::Unplugged, if all { &[] } else { &rows }, text));
        return;
    }
    let beyond: Vec<usize> =
        (0..c.data.len()).filter(|i| c.data[*i] < DEGC[0] || c.data[*i] > DEGC[1]).collect();
    if beyond.is_empty() || kelvin(&c.data) {
        return;
    }
    let [lo, hi] = span(&beyond.iter().map(|i| c.data[*i]).collect::<Vec<_>>());
    let all = beyond.len() == c.data.len();
    let text = format!("reads {lo:.1} to {hi:.1} degC, outside the {} to {} of a machine", DEGC[0], DEGC[1]);
    out.push(Suspicion::new(record, &c.name, What::Range, if all { &[] } else { &beyond }, text));
}

/// A value next to which there are others nearly the same: the sensor got there by degrees.
fn passes_through(c: &Column, i: usize) -> bool {
    let near = |j: usize| {
        let d = (c.data[j] - c.data[i]).abs();
        d > 0.0 && d < 3.0
    };
    (i > 0 && near(i - 1)) || (i + 1 < c.data.len() && near(i + 1))
}

fn kelvin(v: &[f64]) -> bool {
    let [lo, hi] = span(v);
    lo > 263.15 && hi < 393.15
}

/// Kelvin or degrees Fahrenheit called °C.
fn unit(record: &Record, c: &Column, others: &[&Column], out: &mut Vec<Suspicion>) {
    if kelvin(&c.data) {
        let text = format!("reads {:.1} degC, which looks like kelvin", c.data[0]);
        out.push(Suspicion::new(record, &c.name, What::Unit, &[], text));
        return;
    }
    let [lo, hi] = span(&c.data);
    let celsius = (c.data[0] - 32.0) / 1.8;
    if lo < 50.0 || hi > 150.0 || !(12.0..=36.0).contains(&celsius) {
        return;
    }
    let starts: Vec<f64> = others.iter().map(|o| o.data[0]).filter(|v| (5.0..50.0).contains(v)).collect();
    // Beside others: at their start once converted. Alone: no machine's coldest place is that warm from the start.
    let looks = if starts.is_empty() {
        others.iter().all(|o| span(&o.data)[0] >= 50.0)
    } else {
        let usual = median(starts);
        (celsius - usual).abs() < 5.0 && c.data[0] - usual > 25.0
    };
    if looks {
        let text = format!(
            "starts at {:.1} degC, which looks like degrees Fahrenheit ({celsius:.1} degC)",
            c.data[0]
        );
        out.push(Suspicion::new(record, &c.name, What::Unit, &[], text));
    }
}

/// Share of the steps at which a sensor changes.
fn liveliness(v: &[f64]) -> f64 {
    v.windows(2).filter(|w| w[0].to_bits() != w[1].to_bits()).count() as f64 / (v.len().max(2) - 1) as f64
}

/// Share of the steps at which a sensor turns back: changed by its noise, not by a trend.
fn dither(v: &[f64]) -> f64 {
    let changes: Vec<f64> = steps(v).into_iter().filter(|d| *d != 0.0).collect();
    changes.windows(2).filter(|w| w[0] * w[1] < 0.0).count() as f64 / (v.len().max(2) - 1) as f64
}

/// The longest run of one value: first row, and one past the last.
fn longest_run(v: &[f64]) -> (usize, usize) {
    let (mut best, mut start) = ((0, 0), 0);
    for i in 0..=v.len() {
        if i == v.len() || v[i].to_bits() != v[start].to_bits() {
            if i - start > best.1 - best.0 {
                best = (start, i);
            }
            start = i;
        }
    }
    best
}

fn stuck(record: &Record, c: &Column, others: &[&Column], out: &mut Vec<Suspicion>) -> bool {
    let n = c.data.len();
    if n < 20 {
        return false;
    }
    let (start, end) = longest_run(&c.data);
    if end - start == n {
        // A sensor of its own coarse resolution may stand still in a calm room; one among lively ones does not.
        let lively = others.iter().filter(|o| liveliness(&o.data) > 0.5).count();
        let moving = others.iter().filter(|o| range(&o.data) > 1.0).count();
        if others.len() >= 2 && lively == others.len() && moving > 0 && n >= 30
            || others.len() == 1 && lively == 1 && moving == 1 && n >= 30 && fine(c.data[0])
        {
            let text = format!("reads {} degC in every row while the others move", c.data[0]);
            out.push(Suspicion::new(record, &c.name, What::Stuck, &[], text));
            return true;
        }
        return false;
    }
    let length = end - start;
    if length < 12 {
        return false;
    }
    let outside: Vec<usize> = (0..n).filter(|i| *i < start || *i >= end).collect();
    let pick = |v: &[f64]| outside.iter().map(|i| v[*i]).collect::<Vec<f64>>();
    let own = pick(&c.data);
    // By its own changes: a value between two steps of a coarse sensor changes less than its average, hence the square.
    let p = (1.5 * dither(&own)).min(0.95);
    let chance = (length as f64) * (1.0 - 0.7 * p * p).ln() + (n as f64).ln();
    let by_itself = p >= 0.5 && own.len() >= 10 && chance < (1e-6_f64).ln();
    // By its neighbour: where the sensor that it goes with moved on, by many of its own steps.
    let by_neighbour = || {
        if own.len() < 20 || length < 15 {
            return false;
        }
        let best = others
            .iter()
            .map(|o| (correlation(&pick(&o.data), &own).abs(), o))
            .max_by(|a, b| a.0.total_cmp(&b.0));
        let Some((r, o)) = best.filter(|b| b.0 > 0.97) else { return false };
        let Some((_, slope, left)) = line(&pick(&o.data), &own) else { return false };
        let moved = slope.abs() * range(&o.data[start..end]);
        r > 0.97 && moved > (8.0 * quantum(&own)).max(10.0 * left).max(1.0)
    };
    if by_itself || by_neighbour() {
        let rows: Vec<usize> = (start..end).collect();
        let text = format!("reads {} degC in {length} rows on end, as it does nowhere else", c.data[start]);
        out.push(Suspicion::new(record, &c.name, What::Stuck, &rows, text));
        return true;
    }
    false
}

/// A value of better resolution than a sixteenth of a kelvin.
fn fine(v: f64) -> bool {
    let whole = |v: f64| (v - v.round()).abs() < 1e-6;
    !(whole(16.0 * v) || whole(10.0 * v))
}

/// A step that stays, which neither this sensor's other rows nor any other sensor shows.
fn jump(record: &Record, c: &Column, others: &[&Column], out: &mut Vec<Suspicion>) -> bool {
    let n = c.data.len();
    if n < 20 {
        return false;
    }
    let own = steps(&c.data);
    let Some(at) = (0..own.len()).max_by(|a, b| own[*a].abs().total_cmp(&own[*b].abs())) else {
        return false;
    };
    let size = own[at].abs();
    let around = (at.saturating_sub(5)..(at + 6).min(own.len())).filter(|i| *i != at);
    let near = around.map(|i| own[i].abs()).fold(0.0, f64::max);
    let time = record.time_s();
    let usual_s = median(steps(time));
    let paused = time[at + 1] - time[at] > 3.0 * usual_s;
    let alone = others.iter().all(|o| (o.data[at + 1] - o.data[at]).abs() < 0.25 * size);
    if size < 4.0 || size < 8.0 * near || size < 20.0 * spread(&own) || paused || !alone || others.is_empty()
    {
        return false;
    }
    let level = |r: std::ops::Range<usize>| median(c.data[r].to_vec());
    let stays = level(at + 1..(at + 6).min(n)) - level(at.saturating_sub(4)..at + 1);
    if (stays / own[at]) < 0.7 || at < 2 || at + 3 > n {
        return false;
    }
    let text =
        format!("jumps from {:.2} to {:.2} degC between two rows, and stays", c.data[at], c.data[at + 1]);
    out.push(Suspicion::new(record, &c.name, What::Jump, &[at + 1], text));
    true
}

/// Single values far from those before and after.
fn wild(record: &Record, c: &Column, others: &[&Column], out: &mut Vec<Suspicion>) {
    let n = c.data.len();
    if n < 20 {
        return;
    }
    let left: Vec<f64> =
        (0..n).map(|i| c.data[i] - median(c.data[i.saturating_sub(2)..(i + 3).min(n)].to_vec())).collect();
    let limit = (15.0 * spread(&left)).max(3.0);
    // A warm moment of the machine is seen by another sensor too.
    let peak = |v: &[f64], i: usize| v[i] - f64::midpoint(v[i - 1], v[i + 1]);
    let alone = |i: usize| others.iter().all(|o| peak(&o.data, i).abs() < 0.1 * left[i].abs());
    let rows: Vec<usize> = (2..n - 2).filter(|i| left[*i].abs() > limit && alone(*i)).collect();
    if !rows.is_empty() && rows.len() * 10 <= n {
        let text = format!(
            "{} of {n} values far from those before and after, as {:.2} degC",
            rows.len(),
            c.data[rows[0]]
        );
        out.push(Suspicion::new(record, &c.name, What::Outliers, &rows, text));
    }
}

/// Two columns that are one.
fn copies(record: &Record, out: &mut Vec<Suspicion>) {
    let columns: Vec<&Column> =
        record.columns.iter().filter(|c| is_sensor(c) || c.role.is_response()).collect();
    for (k, c) in columns.iter().enumerate() {
        if record.rows() < 10 || distinct(&c.data) < 4 {
            continue;
        }
        if let Some(first) = columns[..k].iter().find(|f| f.data == c.data) {
            let text = format!("the same in every row as {}", first.name);
            out.push(Suspicion::new(record, &c.name, What::Doubled, &[], text));
        }
    }
}
