//! Checks the records of a session against one another.

use super::robust_stats::{median, middle_range, range};
use super::sensor_regression::{sensor_regression, with_lags};
use super::{MistakeKind, Suspicion, approach_outliers};
use crate::iso230::correlation;
use rtec_model::record::{Axis, Column, Record, Role, RunKind, mean, span};

/// Records with exactly the rows of an earlier one.
/// Pairs of the earlier record's index and its own.
pub fn repeated(records: &[&Record]) -> Vec<(usize, usize)> {
    let same = |a: &Record, b: &Record| {
        let twin =
            |c: &Column| b.columns.iter().any(|o| o.name == c.name && o.role == c.role && o.data == c.data);
        a.rows() == b.rows() && a.columns.len() == b.columns.len() && a.columns.iter().all(twin)
    };
    let first = |k: usize| (0..k).find(|i| same(records[*i], records[k]));
    (0..records.len()).filter(|k| records[*k].rows() > 1).filter_map(|k| Some((first(k)?, k))).collect()
}

pub(super) fn look(records: &[Record], out: &mut Vec<Suspicion>) {
    let all: Vec<&Record> = records.iter().collect();
    for (first, again) in repeated(&all) {
        out.push(Suspicion::again(&records[first], &records[again]));
    }
    let (mut opposite, mut crossed) = (Vec::new(), Vec::new());
    for (j, b) in records.iter().enumerate() {
        for (i, a) in records[..j].iter().enumerate() {
            units(a, b, out);
            opposite.extend(signs(a, b).into_iter().map(|c| (i, j, vec![c])));
            crossed.extend(exchanged(a, b).map(|pair| (i, j, pair)));
        }
    }
    for (at, columns) in odd_ones(opposite) {
        let text = "has the sign opposite to the other record's, place by place";
        for c in columns {
            out.push(Suspicion::new(&records[at], &c, MistakeKind::Sign, &[], text.to_owned()));
        }
    }
    for (at, pair) in odd_ones(crossed) {
        for (own, other) in [(0, 1), (1, 0)] {
            let other = &pair[other];
            let text =
                format!("reads what {other} reads in the other record, and that one what this one does");
            out.push(Suspicion::new(&records[at], &pair[own], MistakeKind::Swapped, &[], text));
        }
    }
}

/// The records at fault among pairs that contradict each other.
/// The record with most contradictions comes first; of two alone, the later one.
fn odd_ones(mut pairs: Vec<(usize, usize, Vec<String>)>) -> Vec<(usize, Vec<String>)> {
    let mut found = Vec::new();
    while let Some((_, _, columns)) = pairs.first().cloned() {
        let own = |p: &&(usize, usize, Vec<String>)| p.2 == columns;
        let count = |k: usize| pairs.iter().filter(own).filter(|p| p.0 == k || p.1 == k).count();
        let all = pairs.iter().filter(own).flat_map(|p| [p.0, p.1]);
        let Some(worst) = all.max_by_key(|k| (count(*k), *k)) else { break };
        pairs.retain(|p| p.2 != columns || (p.0 != worst && p.1 != worst));
        found.push((worst, columns));
    }
    found
}

/// Whether the targets are whole millimetres if read in metres.
/// Those of short strokes in millimetres are not.
fn is_round_in_metres(c: &Column) -> bool {
    let round = |p: &&f64| (*p * 1000.0 - (*p * 1000.0).round()).abs() < 0.06;
    c.data.iter().filter(round).count() * 10 >= c.data.len() * 9
}

/// Finds records of one kind whose positions or errors differ by a factor of 1000.
fn units(a: &Record, b: &Record, out: &mut Vec<Suspicion>) {
    if a.kind != b.kind {
        return;
    }
    for ca in &a.columns {
        let Some(cb) = b.column(&ca.role).filter(|_| !ca.role.may_repeat()) else { continue };
        let (ra, rb) = (middle_range(&ca.data), middle_range(&cb.data));
        let (small, large, r, c, of) = if ra < rb { (ra, rb, a, ca, b) } else { (rb, ra, b, cb, a) };
        let looks = match ca.role {
            Role::Position(_) => {
                small < 3.0 && (500.0..2000.0).contains(&(large / small)) && is_round_in_metres(c)
            }
            Role::Error(_) => small < 0.5 && (250.0..4000.0).contains(&(large / small)),
            _ => false,
        };
        let known = out.iter().any(|s| s.what == MistakeKind::Unit && s.is_of(r, c));
        if looks && small > 0.0 && !known {
            let (unit, of) = (&c.unit, of.path.display());
            let text = format!("varies by {small:.3} {unit}, in {of} by {large:.1}: a thousand times less");
            out.push(Suspicion::new(r, &c.name, MistakeKind::Unit, &[], text));
        }
    }
}

/// Errors whose dependence on position or temperature has the opposite sign.
fn signs(a: &Record, b: &Record) -> Vec<String> {
    let (a, b) = (&as_aligned(a), &as_aligned(b));
    let opposite = |ea: &Column| {
        let eb = b.column(&ea.role)?;
        (by_position(a, ea, b, eb) || by_temperature(a, ea, b, eb)).then(|| eb.name.clone())
    };
    a.responses().filter_map(opposite).collect()
}

/// A plate's record with the rotation of the plate removed from its errors.
fn as_aligned(record: &Record) -> Record {
    let mut out = record.clone();
    let axes: Vec<Axis> = record.axes(Role::Position).cloned().collect();
    let [a, b] = &axes[..] else { return out };
    if record.kind != RunKind::Plate {
        return out;
    }
    let centred = |role: Role| {
        let data = record.data(&role)?;
        let mean = mean(data);
        Some(data.iter().map(|v| v - mean).collect::<Vec<f64>>())
    };
    let read =
        |axis: &Axis| Some((centred(Role::Position(axis.clone()))?, centred(Role::Error(axis.clone()))?));
    let (Some((x, e_x)), Some((y, e_y))) = (read(a), read(b)) else { return out };
    let dot = |u: &[f64], v: &[f64]| u.iter().zip(v).map(|(u, v)| u * v).sum::<f64>();
    let size = dot(&x, &x) + dot(&y, &y);
    if size <= 0.0 {
        return out;
    }
    let turn = (dot(&e_y, &x) - dot(&e_x, &y)) / size;
    for c in &mut out.columns {
        let (along, by) = match &c.role {
            Role::Error(axis) if axis == a => (&y, turn),
            Role::Error(axis) if axis == b => (&x, -turn),
            _ => continue,
        };
        c.data.iter_mut().zip(along).for_each(|(e, p)| *e += by * p);
    }
    out
}

/// A temperature must vary by more than this in both records, K.
const TURNS_K: f64 = 0.5;
/// Correlation below which such a temperature runs in opposite directions.
const TURNS: f64 = -0.5;

/// Whether common temperatures agree within 2 K (medians); true if there are none.
/// Otherwise heat may change the sign of an error.
fn as_warm(a: &Record, b: &Record) -> bool {
    let off =
        |name: &str| Some(median(a.temperature(name)?.to_vec()) - median(b.temperature(name)?.to_vec()));
    a.names(&Role::Temperature).filter_map(off).all(|k| k.abs() < 2.0)
}

/// Bins of an axis's positions over two records.
struct PositionBins<'r> {
    count: usize,
    lo: f64,
    size: f64,
    data: [&'r [f64]; 2],
}

impl<'r> PositionBins<'r> {
    /// `None` if the axis does not move or is not logged in both records.
    fn of(axis: &Axis, count: usize, a: &'r Record, b: &'r Record) -> Option<Self> {
        let role = Role::Position(axis.clone());
        let data = [a.data(&role)?, b.data(&role)?];
        let [lo, hi] = span(data.concat());
        (hi > lo).then_some(Self { count, lo, size: hi - lo, data })
    }

    /// Bin of a row of the first (0) or second (1) record.
    fn bin(&self, side: usize, row: usize) -> usize {
        (((self.data[side][row] - self.lo) / self.size * self.count as f64) as usize).min(self.count - 1)
    }
}

fn by_position(a: &Record, ea: &Column, b: &Record, eb: &Column) -> bool {
    let Some(axis) = ea.role.axis() else { return false };
    let Some(own) = PositionBins::of(axis, 12, a, b).filter(|_| as_warm(a, b)) else { return false };
    // On a plate or a circle the other moving axes are part of the place; their bins are coarser.
    let mut bins = vec![own];
    for other in a.axes(Role::Position).filter(|o| *o != axis) {
        bins.extend(
            PositionBins::of(other, 4, a, b).filter(|o| o.size > approach_outliers::MOVES * bins[0].size),
        );
    }
    let all = bins.iter().map(|b| b.count).product::<usize>();
    let means = |r: &Record, e: &[f64], side: usize| {
        let d = r.direction(axis);
        let mut sums = vec![(0.0, 0.0, 0.0); 2 * all];
        for (i, e) in e.iter().enumerate() {
            let bin = bins.iter().fold(0, |bin, b| bin * b.count + b.bin(side, i));
            let up = usize::from(d.is_some_and(|d| d[i] > 0.0));
            let s = &mut sums[2 * bin + up];
            *s = (s.0 + 1.0, s.1 + e, s.2 + e * e);
        }
        sums
    };
    let (ma, mb) = (means(a, &ea.data, 0), means(b, &eb.data, 1));
    let both: Vec<usize> = (0..2 * all).filter(|k| ma[*k].0 >= 2.0 && mb[*k].0 >= 2.0).collect();
    if both.len() < 8 {
        return false;
    }
    let mean = |m: &[(f64, f64, f64)]| both.iter().map(|k| m[*k].1 / m[*k].0).collect::<Vec<f64>>();
    let (xa, xb) = (mean(&ma), mean(&mb));
    // The place must explain most of the error in both records.
    let clear = |m: &[(f64, f64, f64)], x: &[f64]| {
        let within: f64 = both.iter().map(|k| m[*k].2 - m[*k].1 * m[*k].1 / m[*k].0).sum();
        let rows: f64 = both.iter().map(|k| m[*k].0).sum();
        let all = x.iter().sum::<f64>() / x.len() as f64;
        let between: f64 = both.iter().zip(x).map(|(k, x)| m[*k].0 * (x - all).powi(2)).sum();
        between > 2.0 * within && rows >= 16.0
    };
    // A temperature that rises over the places in one record and falls in the other changes the sign by
    // itself.
    let turns = |name: &str| {
        let at = |r: &Record, side: usize| r.temperature(name).map(|t| mean(&means(r, t, side)));
        let opposite =
            |(x, y): (Vec<f64>, Vec<f64>)| range(&x).min(range(&y)) > TURNS_K && correlation(&x, &y) < TURNS;
        at(a, 0).zip(at(b, 1)).is_some_and(opposite)
    };
    if a.names(&Role::Temperature).any(turns) {
        return false;
    }
    let ratio = range(&xa) / range(&xb).max(1e-12);
    correlation(&xa, &xb) < -0.85 && (0.5..2.0).contains(&ratio) && clear(&ma, &xa) && clear(&mb, &xb)
}

/// Whether each record's temperatures predict the other's error with opposite sign.
fn by_temperature(a: &Record, ea: &Column, b: &Record, eb: &Column) -> bool {
    let names: Vec<&str> = a.names(&Role::Temperature).filter(|n| b.temperature(n).is_some()).collect();
    let warm = |r: &Record| names.iter().any(|n| r.temperature(n).is_some_and(|t| range(t) > 2.0));
    if names.is_empty() || a.rows() < 30 || b.rows() < 30 || !warm(a) || !warm(b) {
        return false;
    }
    let opposite = |a: &Record, ea: &[f64], b: &Record, eb: &[f64]| {
        let told = sensor_regression(a, ea, &names);
        let says = told.predict(b, &names);
        let ratio = middle_range(&says) / middle_range(eb).max(1e-12);
        told.left < 0.25 * middle_range(ea) / 3.3
            && correlation(&says, eb) < -0.85
            && (0.5..2.0).contains(&ratio)
    };
    opposite(a, &ea.data, b, &eb.data) && opposite(b, &eb.data, a, &ea.data)
}

/// Smallest range of a sensor over a record to compare it with others, K.
const MOVES_K: f64 = 1.0;

/// Error ratio (as labelled / exchanged) at which one record proves an exchange.
const CERTAINLY: f64 = 2.5;
/// Error ratio that the prediction in the reverse direction must reach.
const LIKELY: f64 = 1.5;

/// The first pair of sensors that are exchanged between two records.
/// The other sensors predict for each what the other one reads.
fn exchanged(a: &Record, b: &Record) -> Option<Vec<String>> {
    let names: Vec<&str> = a.names(&Role::Temperature).filter(|n| b.temperature(n).is_some()).collect();
    if names.len() < 3 || a.rows() < 30 || b.rows() < 30 {
        return None;
    }
    let pairs = (0..names.len()).flat_map(|k| (0..k).map(move |i| (i, k)));
    // Sensors that show only noise cannot be predicted.
    let moves = |r: &Record, name: &str| r.temperature(name).is_some_and(|t| range(t) > MOVES_K);
    let both = |name: &str| moves(a, name) && moves(b, name);
    pairs.map(|(i, k)| (names[i], names[k])).filter(|(p, q)| both(p) && both(q)).find_map(|(p, q)| {
        let rest: Vec<&str> = names.iter().filter(|n| **n != p && **n != q).copied().collect();
        // Both directions must agree: a regression from one load only may fail for another load and look the
        // same.
        let crosses = |a: &Record, b: &Record, rest: &[&str]| {
            exchange_error_ratio(a, b, (p, q), rest).is_some_and(|by| by > CERTAINLY)
                && exchange_error_ratio(b, a, (p, q), rest).is_some_and(|by| by > LIKELY)
        };
        let found = crosses(a, b, &rest) || {
            // Heat that one body passes to another arrives late.
            let ((wide_a, all), (wide_b, _)) = (with_lags(a, &rest), with_lags(b, &rest));
            let all: Vec<&str> = all.iter().map(String::as_str).collect();
            3 * all.len() < a.rows().min(b.rows()) && crosses(&wide_a, &wide_b, &all)
        };
        found.then(|| vec![p.to_owned(), q.to_owned()])
    })
}

/// How much better a pair of sensors fits another record when exchanged.
/// A regression on the other sensors, fitted on `a`, predicts the pair in `b`. Returns the ratio of the
/// errors as labelled to those exchanged; `None` if a column is missing.
fn exchange_error_ratio(a: &Record, b: &Record, (p, q): (&str, &str), rest: &[&str]) -> Option<f64> {
    let columns = (a.temperature(p), a.temperature(q), b.temperature(p), b.temperature(q));
    let (Some(ap), Some(aq), Some(bp), Some(bq)) = columns else { return None };
    let (of_p, of_q) = (sensor_regression(a, ap, rest), sensor_regression(a, aq, rest));
    let (says_p, says_q) = (of_p.predict(b, rest), of_q.predict(b, rest));
    let away = |t: &[f64], says: &[f64]| {
        let d: f64 = t.iter().zip(says).map(|(t, s)| (t - s).powi(2)).sum();
        (d / t.len() as f64).sqrt()
    };
    let straight = [away(bp, &says_p), away(bq, &says_q)];
    let crossed = [away(bq, &says_p), away(bp, &says_q)];
    let fits = crossed[0] < (3.0 * of_p.left).max(1.0) && crossed[1] < (3.0 * of_q.left).max(1.0);
    // Otherwise both predictions would be wrong by the difference of the two, in opposite directions.
    let both = fits && (0..2).all(|s| straight[s] > (2.0 * crossed[s]).max(1.0));
    let by = straight[0].hypot(straight[1]) / crossed[0].hypot(crossed[1]).max(f64::MIN_POSITIVE);
    // If one of the two does not fit better exchanged, the ratio is limited to what is not yet a proof.
    Some(if both { by } else { by.min(CERTAINLY) })
}
