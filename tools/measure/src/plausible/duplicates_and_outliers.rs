//! Duplicated rows, and outliers and constant stretches of responses.

use super::physical_peaks::{LARGEST_PEAK_UM, beside, excused, read_along, stays, ways};
use super::robust_stats::{distinct, longest_run, median, medians_of_others, quantum, range, spread, steps};
use super::small_sample_outliers::{self, SmallSampleOutliers};
use super::{MistakeKind, Suspicion};
use crate::gauge_resolution::repeats;
use rtec_model::record::{Column, Record, Role};
use statrs::distribution::{Beta, Binomial, ContinuousCDF as _, DiscreteCDF as _};
use std::collections::HashMap;

/// Shortest stretch of one value that is examined, rows.
const SHORTEST: usize = 6;
/// Stretch of one value that chance does not explain, rows.
const FLAT: usize = 20;
/// Outliers are rows farther off than this fraction of the farthest: 1 / `APART`.
const APART: f64 = 5.0;
/// Fewest rows of a pasted block.
const BLOCK: usize = 8;
/// Largest probability by chance at which equal rows are called duplicated.
const DOUBLED_BY_CHANCE: f64 = 0.01;

pub(super) fn look(record: &Record, all: &[Record], out: &mut Vec<Suspicion>) {
    doubled(record, out);
    for c in record.measured() {
        let same = one_reading(c);
        if same.is_empty() {
            flat(record, all, c, out);
        }
        // The other rows are checked as if these were interpolated.
        let without = Column { data: bridged(&c.data, &same), ..c.clone() };
        let SmallSampleOutliers { mut rows, spread } = wild(record, &without);
        rows.retain(|row| same.binary_search(row).is_err());
        rows.extend(same);
        rows.sort_unstable();
        let Some(first) = rows.first() else { continue };
        let (far, n, as_one) = (rows.len(), c.data.len(), c.data[*first]);
        let text = format!(
            "{far} of {n} rows are far off those beside them, as {as_one:.2} (the others spread by {spread:.2})"
        );
        out.push(Suspicion::new(record, &c.name, MistakeKind::Outliers, &rows, text));
    }
}

/// Ratio of distances from the median at which a reading is beyond all others.
const BEYOND: f64 = 20.0;
/// Largest share of such rows.
const FEW_ROWS: f64 = 0.12;
/// Probability above which equal consecutive rows may be chance.
const ALIKE_BY_CHANCE: f64 = 0.05;

/// Consecutive rows with one exact value far beyond all others, such as 9999.
/// An instrument writes it if it has no reading. The gauge must seldom repeat a value, because every state of
/// a machine has a gauge's noise.
fn one_reading(c: &Column) -> Vec<usize> {
    let v = &c.data;
    let usual = median(v.clone());
    let mut by_distance: Vec<usize> = (0..v.len()).collect();
    by_distance.sort_by(|a, b| (v[*a] - usual).abs().total_cmp(&(v[*b] - usual).abs()));
    let far = |i: usize| (v[by_distance[i]] - usual).abs();
    let most = (FEW_ROWS * v.len() as f64) as usize;
    let Some(gap) = (v.len() - most..v.len()).find(|i| *i > 0 && far(*i) > BEYOND * far(i - 1)) else {
        return Vec::new();
    };
    let mut rows = by_distance.split_off(gap);
    rows.sort_unstable();
    let rest: Vec<f64> = (0..v.len()).filter(|i| rows.binary_search(i).is_err()).map(|i| v[i]).collect();
    let alike = steps(&rest).iter().filter(|step| **step == 0.0).count() as f64 / (rest.len() - 1) as f64;
    let chance = alike.powi(rows.len() as i32 - 1);
    let is_one = rows.len() > 1 && rows.iter().all(|i| v[*i].to_bits() == v[rows[0]].to_bits());
    if is_one && chance < ALIKE_BY_CHANCE { rows } else { Vec::new() }
}

/// The values, linearly interpolated over these rows.
pub(super) fn bridged(v: &[f64], rows: &[usize]) -> Vec<f64> {
    let mut out = v.to_vec();
    let is_good = |i: &usize| rows.binary_search(i).is_err();
    for row in rows {
        let before = (0..*row).rev().find(is_good);
        let behind = (*row..v.len()).find(is_good);
        out[*row] = match (before, behind) {
            (Some(a), Some(b)) => v[a] + (v[b] - v[a]) * (row - a) as f64 / (b - a) as f64,
            (Some(one), None) | (None, Some(one)) => v[one],
            (None, None) => v[*row],
        };
    }
    out
}

/// Detects duplicated rows: the row before once more, or a pasted block.
fn doubled(record: &Record, out: &mut Vec<Suspicion>) {
    let n = record.rows();
    if n < 4 {
        return;
    }
    // Values derived from positions and times differ in a copy, because its neighbours do.
    let is_derived = |c: &&Column| matches!(c.role, Role::Velocity(_) | Role::Acceleration(_));
    let whole: Vec<&Column> = record.columns.iter().filter(|c| !is_derived(c)).collect();
    // Time and cycle are counted, so pasted rows have their own.
    let counted = |c: &&Column| matches!(c.role, Role::Time | Role::Cycle);
    let measured: Vec<&Column> = whole.iter().copied().filter(|c| !counted(c)).collect();
    let same =
        |of: &[&Column], i: usize, j: usize| of.iter().all(|c| c.data[i].to_bits() == c.data[j].to_bits());
    // Equal neighbours. Without a time they must be far more frequent than equal rows seven apart.
    let next: Vec<usize> = (1..n).filter(|i| same(&whole, *i, i - 1)).collect();
    let apart = (7..n).filter(|i| same(&whole, *i, i - 7)).count();
    let told = match record.data(&Role::Time) {
        Some(time) => !next.is_empty() && !is_chance(record, time, next.len()),
        None => next.len() >= 3 && next.len() > 10 * apart,
    };
    if told {
        let text = format!("{} of {n} rows are the row before once more", next.len());
        out.push(Suspicion::new(record, "", MistakeKind::Doubled, &next, text));
        return;
    }
    let copies = pasted(record, &measured, &same);
    if !copies.is_empty() {
        let text = format!("{} of {n} rows repeat earlier ones in every measured value", copies.len());
        out.push(Suspicion::new(record, "", MistakeKind::Doubled, &copies, text));
    }
}

/// Whether coarse clocks and gauges alone make this many equal neighbours.
/// A clock finer than half a row never shows one time twice.
fn is_chance(record: &Record, time: &[f64], alike: usize) -> bool {
    let between = steps(time);
    if 2.0 * quantum(time) <= median(between.iter().copied().filter(|d| *d > 0.0)) {
        return false;
    }
    let is_cause = |c: &&Column| !c.role.is_measured() && c.role != Role::Time;
    let causes: Vec<&Column> = record.columns.iter().filter(is_cause).collect();
    let at_once =
        |i: usize| between[i] == 0.0 && causes.iter().all(|c| c.data[i].to_bits() == c.data[i + 1].to_bits());
    let pairs = (0..between.len()).filter(|i| at_once(*i)).count();
    let others: Vec<[usize; 2]> =
        (0..between.len()).filter(|i| between[*i] != 0.0).map(|i| [i, i + 1]).collect();
    let stays = |c: &Column| {
        let off: Vec<f64> = others.iter().map(|[i, j]| (c.data[*i] - c.data[*j]).abs()).collect();
        let same = off.iter().filter(|d| **d == 0.0).count() as f64 / off.len().max(1) as f64;
        // For noise over many steps of the gauge, half the differences lie within the median.
        let step = quantum(&c.data);
        same.max(0.5 * step / (2.0 * median(off) + step).max(f64::MIN_POSITIVE))
    };
    let p: f64 = record.measured().map(stays).product();
    Binomial::new(p.min(1.0), pairs as u64).is_ok_and(|b| b.sf(alike as u64 - 1) >= DOUBLED_BY_CHANCE)
}

/// Probability that a block of `block` rows repeats an earlier one by chance.
/// A coarse gauge often repeats its reading at a place; the rows outside the copies show how often.
fn repeats_by_chance(record: &Record, copies: &[usize], block: usize) -> f64 {
    let is_copy = |row: &usize| copies.binary_search(row).is_ok();
    let of = |c: &Column| {
        let groups = repeats(record, c);
        let pairs: Vec<&[usize]> =
            groups.iter().flat_map(|rows| rows.windows(2)).filter(|w| !w.iter().any(is_copy)).collect();
        let is_same = |w: &&&[usize]| c.data[w[0]].to_bits() == c.data[w[1]].to_bits();
        let (same, all) = (pairs.iter().filter(is_same).count() as f64, pairs.len() as f64);
        // Selection bias: the longest block was chosen, so the other rows repeat too seldom. Use the upper
        // confidence limit.
        let most = Beta::new(same + 1.0, all - same).map_or(1.0, |b| b.inverse_cdf(0.95));
        if all > 0.0 { most } else { 0.5 }
    };
    let again: f64 = record.measured().map(of).product();
    record.rows() as f64 * again.powi(block as i32)
}

/// Rows of blocks that repeat an earlier block beyond chance.
fn pasted(
    record: &Record,
    measured: &[&Column],
    same: &dyn Fn(&[&Column], usize, usize) -> bool,
) -> Vec<usize> {
    let n = record.rows();
    // Only noise cannot repeat by itself: one response must be rough in time or from place to place.
    let noisy = record.measured().any(|c| {
        let by_place: Vec<f64> = ways(record, c).concat().iter().map(|i| c.data[*i]).collect();
        (rough(&c.data) || rough(&by_place) || differs_at_its_places(record, c)) && distinct(&c.data) * 4 > n
    });
    if !noisy || n < 2 * BLOCK {
        return Vec::new();
    }
    let key = |i: usize| measured.iter().map(|c| c.data[i].to_bits()).collect::<Vec<u64>>();
    let mut first: HashMap<Vec<u64>, Vec<usize>> = HashMap::new();
    for i in 0..n {
        first.entry(key(i)).or_default().push(i);
    }
    let (mut rows, mut longest) = (Vec::new(), 0);
    let mut i = 1;
    while i < n {
        let starts = first.get(&key(i)).map_or(&[][..], Vec::as_slice);
        // The longest run from here that an earlier stretch also has.
        let length = |j: usize| (0..n - i).take_while(|k| j + k < i && same(measured, i + k, j + k)).count();
        let best = starts.iter().filter(|j| **j < i).take(50).map(|j| length(*j)).max().unwrap_or(0);
        if best >= BLOCK {
            rows.extend(i..i + best);
            longest = longest.max(best);
            i += best;
        } else {
            i += 1;
        }
    }
    // A machine without noise repeats in every cycle, so at most half of the rows may be copies.
    let is_machine = rows.len() * 2 > n || repeats_by_chance(record, &rows, longest) >= DOUBLED_BY_CHANCE;
    if is_machine { Vec::new() } else { rows }
}

/// Whether readings at one place and direction are seldom equal.
fn differs_at_its_places(record: &Record, c: &Column) -> bool {
    let places = places(record, c, &ways(record, c));
    let (mut all, mut own) = (0, 0);
    for place in places.iter().filter(|p| p.len() >= 3) {
        all += place.len();
        own += distinct(&place.iter().map(|i| c.data[*i]).collect::<Vec<_>>());
    }
    all >= 2 * BLOCK && own * 10 >= all * 7
}

/// Whether the values turn back in more than 35 % of the steps.
fn rough(v: &[f64]) -> bool {
    let d = steps(v);
    let turns = d.windows(2).filter(|w| w[0] * w[1] < 0.0).count();
    turns * 100 > 35 * d.len()
}

/// Whether a constant gauge may only be coarse.
/// Its value is a whole step of the other coarse gauges.
/// Compares with the other responses of the record, else with the same response of other records. Coarse is a
/// step of 1 µm or more.
fn as_coarse_as_others(record: &Record, all: &[Record], c: &Column) -> bool {
    let is_coarse = |o: &Column| {
        let q = quantum(&o.data);
        q >= 1.0 && (c.data[0] / q - (c.data[0] / q).round()).abs() < 1e-6
    };
    let moves = |o: &&Column| distinct(&o.data) > 1;
    let mut beside = record.responses().filter(|o| o.name != c.name).filter(moves).map(is_coarse).peekable();
    if beside.peek().is_some() {
        return beside.all(|coarse| coarse);
    }
    all.iter().filter_map(|r| r.column(&c.role)).filter(moves).any(is_coarse)
}

/// Detects a constant response: a gauge that is not read.
fn flat(record: &Record, all: &[Record], c: &Column, out: &mut Vec<Suspicion>) {
    let n = c.data.len();
    if n >= FLAT && distinct(&c.data) == 1 && !as_coarse_as_others(record, all, c) {
        let text = format!("reads {} in every row, as no gauge that is read does", c.data[0]);
        out.push(Suspicion::new(record, &c.name, MistakeKind::Stuck, &[], text));
        return;
    }
    if n < 40 {
        return;
    }
    let best = longest_run(&c.data);
    let length = best.1 - best.0;
    let outside: Vec<f64> = (0..n).filter(|i| *i < best.0 || *i >= best.1).map(|i| c.data[i]).collect();
    if outside.len() < 20 || length < SHORTEST {
        return;
    }
    let changes = outside.windows(2).filter(|w| w[0].to_bits() != w[1].to_bits()).count();
    let p = changes as f64 / (outside.len() - 1) as f64;
    // A coarse reading changes less often near the middle of a step, hence the square.
    let chance = length as f64 * (1.0 - 0.7 * p.min(0.95).powi(2)).ln() + (n as f64).ln();
    let long =
        length >= FLAT && p >= 0.7 && distinct(&outside) * 4 > outside.len() && chance < (1e-8_f64).ln();
    // A noisy gauge: the probability of equal neighbours is taken from the other rows, times three.
    let alike = 3.0 * ((1.0 - p) * (outside.len() - 1) as f64 + 1.0) / outside.len() as f64;
    let (from, to) = longest_run(&outside);
    let usual = to - from;
    let noisy = rough(&outside) && alike < 0.8 && length >= 3 * usual;
    if long || noisy && (length - 1) as f64 * alike.max(0.1).ln() + (n as f64).ln() < (1e-5_f64).ln() {
        let rows: Vec<usize> = (best.0..best.1).collect();
        let text = format!("reads {} in {length} rows on end, as it does nowhere else", c.data[best.0]);
        out.push(Suspicion::new(record, &c.name, MistakeKind::Stuck, &rows, text));
    }
}

/// Rows far from their neighbours in time and in position and direction.
fn wild(record: &Record, c: &Column) -> SmallSampleOutliers {
    let n = c.data.len();
    if small_sample_outliers::is_small_sample(n) {
        return small_sample_outliers::of_response(record, c);
    }
    if n < small_sample_outliers::FEW || range(&c.data) <= 0.0 {
        return SmallSampleOutliers::default();
    }
    let may_peak = excused(record);
    let mut orders = vec![vec![(0..n).collect()]];
    orders.extend(Some(ways(record, c)).filter(|by_place| !by_place.is_empty()));
    // Use the order in which the response is smoothest, or the same place at other times.
    let in_order = |o: &Vec<Vec<usize>>| {
        let (left, alone) = beside(&c.data, o);
        // On a steep course each row is its own median, however noisy.
        let scale = width(&left).max(noise_along(&c.data, o));
        (left, alone, scale)
    };
    let mut lefts: Vec<(Vec<f64>, Vec<bool>, f64)> = orders.iter().map(in_order).collect();
    let mates = orders.get(1).map(|ways| places(record, c, ways));
    if let Some(places) = &mates
        && places.iter().all(|p| p.len() >= 3)
    {
        let left = of_place(&c.data, places);
        let scale = width(&left);
        lefts.push((left, vec![true; n], scale));
    }
    let Some((left, alone, scale)) = lefts.into_iter().min_by(|a, b| a.2.total_cmp(&b.2)) else {
        return SmallSampleOutliers::default();
    };
    let none = SmallSampleOutliers { rows: Vec::new(), spread: scale };
    if scale <= 0.0 {
        return none;
    }
    // A deviation that a place always has is the machine's.
    let mut usual_there = vec![false; n];
    let at_places = mates.as_ref().map_or(0.0, |m| width(&of_place(&c.data, m)));
    for place in mates.iter().flatten().filter(|p| p.len() >= 2) {
        let values: Vec<f64> = place.iter().map(|i| c.data[*i]).collect();
        for (i, others) in place.iter().zip(medians_of_others(&values)) {
            let off = (c.data[*i] - others).abs();
            usual_there[*i] = off < 0.5 * left[*i].abs() || place.len() >= 3 && off < 4.0 * at_places;
        }
    }
    // No spike at a reversal or a start is larger than the dictionary's bound.
    let excused =
        |i: usize| may_peak[i] && !(matches!(c.role, Role::Error(_)) && left[i].abs() > LARGEST_PEAK_UM);
    let far = |i: usize| left[i].abs() / scale;
    // A level that lasts is a state of the machine: lost counts, coolant, or a run without a reversal before
    // it.
    let own = |i: &usize| alone[*i] && !excused(*i) && !usual_there[*i] && !stays(&c.data, *i, left[*i]);
    let worst = (0..n).filter(own).map(far).fold(0.0, f64::max);
    // Far outliers are separated from the rest, however heavy its tails.
    let apart = (worst / APART).max(8.0);
    let rows: Vec<usize> = (0..n).filter(|i| far(*i) > apart && own(i)).collect();
    // Many moderately far rows are heavy tails or a shape, not outliers.
    let tail = (apart / 2.0).max(4.5);
    let bulk = (0..n).filter(|i| rows.binary_search(i).is_err() && !excused(*i) && far(*i) > tail).count();
    // Many close together are a shape: by chance one of four has a neighbour if one row in twenty is chosen.
    let close = rows.windows(2).filter(|w| w[1] - w[0] <= 3).count();
    if rows.len() >= 4 && 2 * close > rows.len() {
        return none;
    }
    let enough = rows.len() >= 2 && worst > 15.0 || worst > 20.0;
    let few = rows.len() as f64 <= FEW_ROWS * n as f64;
    if enough && few && 2 * bulk <= rows.len() { SmallSampleOutliers { rows, spread: scale } } else { none }
}

/// Robust standard deviation; from the 90th percentile if most values are 0.
fn width(v: &[f64]) -> f64 {
    let by_half = spread(v);
    if by_half > 0.0 {
        return by_half;
    }
    let mut sizes: Vec<f64> = v.iter().map(|v| v.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    // Nine of ten of a normal distribution lie within 1.645 σ.
    sizes[sizes.len() * 9 / 10] / 1.645
}

/// Standard deviation of the noise in these orders, from second differences.
fn noise_along(v: &[f64], orders: &[Vec<usize>]) -> f64 {
    let off = |w: &[usize]| v[w[0]] - 2.0 * v[w[1]] + v[w[2]];
    let all: Vec<f64> = orders.iter().flat_map(|o| o.windows(3).map(off)).collect();
    spread(&all) / 6_f64.sqrt()
}

/// The rows of each place, from the rows of each direction sorted by position.
fn places(record: &Record, c: &Column, ways: &[Vec<usize>]) -> Vec<Vec<usize>> {
    let Some(p) = read_along(record, c).and_then(|a| record.position(a)) else { return Vec::new() };
    let of_way = |rows: &Vec<usize>| {
        let near = 0.2 * range(p) / rows.len().max(1) as f64;
        rows.chunk_by(|a, b| p[*b] - p[*a] <= near).map(<[usize]>::to_vec).collect::<Vec<_>>()
    };
    ways.iter().flat_map(of_way).collect()
}

/// Each row's deviation from the median of its place.
fn of_place(v: &[f64], places: &[Vec<usize>]) -> Vec<f64> {
    let mut left = vec![0.0; v.len()];
    for place in places {
        let usual = median(place.iter().map(|i| v[*i]));
        for i in place {
            left[*i] = v[*i] - usual;
        }
    }
    left
}
