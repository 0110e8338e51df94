//! Checks one temperature or channel against the others of its record.

use super::duplicates_and_outliers::bridged;
use super::robust_stats::{distinct, median, quantum, spread, steps};
use super::small_sample_outliers;
use super::{MistakeKind, Suspicion, is_sensor};
use rtec_model::disconnected_sensor_codes::disconnected;
use rtec_model::record::{Column, Record, Role, span};

/// Range of a sensor on a machine tool, °C.
pub(crate) const DEGC: [f64; 2] = [-40.0, 150.0];

pub(super) fn look(record: &Record, out: &mut Vec<Suspicion>) {
    let sensors: Vec<&Column> = record.temperatures().collect();
    // Sensors that are read at least at times, with unread rows interpolated, and whether all rows were read.
    let mut read: Vec<(Column, bool)> = Vec::new();
    for c in &sensors {
        let others: Vec<&Column> = sensors.iter().filter(|o| o.name != c.name).copied().collect();
        let before = out.len();
        unplugged(record, c, &others, out);
        if out.len() == before {
            unit(record, c, &others, out);
        }
        if out.len() == before {
            loose(record, c, out);
        }
        let found = &out[before..];
        if found.iter().all(|s| s.what != MistakeKind::Unit && !s.rows.is_empty()) {
            let rows: Vec<usize> =
                found.iter().flat_map(Suspicion::row_list).map(|row| row - record.first_row()).collect();
            let data = bridged(&c.data, &rows);
            read.push((Column { data, ..(*c).clone() }, found.is_empty()));
        }
    }
    for (c, is_whole) in &read {
        let others: Vec<&Column> = read.iter().map(|(o, _)| o).filter(|o| o.name != c.name).collect();
        if !misread(record, c, &others, out) && *is_whole {
            jump(record, c, &others, out);
        }
    }
    copies(record, out);
}

/// Detects the code of an open input and values outside the range of a sensor.
fn unplugged(record: &Record, c: &Column, others: &[&Column], out: &mut Vec<Suspicion>) {
    let coded = |v: f64| disconnected(v).filter(|(_, certain)| *certain).map(|d| d.0);
    let is_possible = |v: &f64| *v > DEGC[0] && *v < DEGC[1];
    let rest: Vec<f64> =
        c.data.iter().copied().filter(|v| disconnected(*v).is_none() && is_possible(v)).collect();
    // The sensor's usual value at other times, or else that of the others.
    let usual = if rest.is_empty() {
        median(others.iter().flat_map(|o| &o.data).copied().filter(is_possible))
    } else {
        median(rest.clone())
    };
    let known = !rest.is_empty() || !others.is_empty();
    let mut rows = Vec::new();
    // Each code, and why it is one.
    let mut codes: Vec<(f64, &str)> = Vec::new();
    for (i, v) in c.data.iter().enumerate() {
        let off = coded(*v).or_else(|| {
            let doubtful = disconnected(*v).map(|d| d.0);
            doubtful.filter(|_| known && (v - usual).abs() > 15.0 && !passes_through(c, i))
        });
        if let Some(off) = off {
            rows.push(i);
            if !codes.iter().any(|(code, _)| code.to_bits() == v.to_bits()) {
                codes.push((*v, off));
            }
        }
    }
    if !rows.is_empty() {
        let all = rows.len() == c.data.len();
        let codes: Vec<String> = codes.iter().map(|(code, why)| format!("{code} degC: {why}")).collect();
        let text = format!("reads {}{}", codes.join(", and "), if all { "" } else { " in some rows" });
        out.push(Suspicion::new(
            record,
            &c.name,
            MistakeKind::Unplugged,
            if all { &[] } else { &rows },
            text,
        ));
        return;
    }
    if let Some((rows, step_k)) = frozen(record, c) {
        let degc = c.data[rows.start];
        let text = format!(
            "reads {degc} degC row after row behind a step of {step_k:.1} K, as a sensor that fails does"
        );
        let rows: Vec<usize> = rows.collect();
        out.push(Suspicion::new(record, &c.name, MistakeKind::Unplugged, &rows, text));
        return;
    }
    let beyond: Vec<usize> =
        (0..c.data.len()).filter(|i| c.data[*i] < DEGC[0] || c.data[*i] > DEGC[1]).collect();
    if beyond.is_empty() || kelvin(&c.data) {
        return;
    }
    let [lo, hi] = span(beyond.iter().map(|i| c.data[*i]));
    let all = beyond.len() == c.data.len();
    let text = format!("reads {lo:.1} to {hi:.1} degC, outside the {} to {} of a machine", DEGC[0], DEGC[1]);
    out.push(Suspicion::new(record, &c.name, MistakeKind::Range, if all { &[] } else { &beyond }, text));
}

/// Step that no body makes between two rows before constant readings, K.
const FAILS_K: f64 = 15.0;
/// Fewest equal rows after such a step.
const STANDS: usize = 5;

/// Rows with one exact value after an impossible step, and the step's size, K.
/// They end with another such step or with the record: a bus reads this from a sensor that does not answer.
fn frozen(record: &Record, c: &Column) -> Option<(std::ops::Range<usize>, f64)> {
    let (v, time) = (&c.data, record.time_s());
    let usual_s = median(steps(time));
    let leaps = |i: usize| (v[i] - v[i - 1]).abs() >= FAILS_K && time[i] - time[i - 1] <= PAUSE * usual_s;
    let mut start = 1;
    while start < v.len() {
        let stands = v[start..].iter().take_while(|x| x.to_bits() == v[start].to_bits()).count();
        let end = start + stands;
        if stands >= STANDS && leaps(start) && (end == v.len() || leaps(end)) {
            // A sensor that comes back from a failure also steps: then it failed before, not now.
            let moves = |rows: &[f64]| rows.windows(2).any(|w| w[0].to_bits() != w[1].to_bits());
            if moves(&v[..start]) {
                return Some((start..end, (v[start] - v[start - 1]).abs()));
            }
        }
        start = end;
    }
    None
}

/// Largest row-to-row noise of a working sensor, K.
const SCATTER_K: f64 = 1.0;

/// Detects a loose contact or an open input: scatter of kelvins from row to row.
fn loose(record: &Record, c: &Column, out: &mut Vec<Suspicion>) {
    let moves = steps(&c.data);
    let turns = moves.windows(2).filter(|w| w[0] * w[1] < 0.0).count();
    let noise = noise_k(&c.data);
    // Of pure noise, two of three steps turn back.
    if c.data.len() >= 20 && noise > SCATTER_K && 2 * turns > moves.len() {
        let text = format!(
            "scatters by {noise:.1} K from row to row, as no body's temperature does: a loose contact or an open input"
        );
        out.push(Suspicion::new(record, &c.name, MistakeKind::Unplugged, &[], text));
    }
}

/// Standard deviation of a sensor's noise, from second differences, K.
fn noise_k(v: &[f64]) -> f64 {
    let second = v.windows(3).map(|w| (w[0] - 2.0 * w[1] + w[2]).abs());
    // The median of a normal variable's size is 0.6745 σ; a second difference has six times the variance.
    median(second) / 0.6745 / 6_f64.sqrt()
}

/// Whether a neighbouring value is near: the sensor got there gradually.
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

/// Detects kelvin or degrees Fahrenheit called °C.
fn unit(record: &Record, c: &Column, others: &[&Column], out: &mut Vec<Suspicion>) {
    if kelvin(&c.data) {
        let text = format!("reads {:.1} degC, which looks like kelvin", c.data[0]);
        out.push(Suspicion::new(record, &c.name, MistakeKind::Unit, &[], text));
        return;
    }
    let [lo, hi] = span(&c.data);
    let celsius = (c.data[0] - 32.0) / 1.8;
    if lo < 50.0 || hi > 150.0 || !(12.0..=36.0).contains(&celsius) {
        return;
    }
    let starts: Vec<f64> = others.iter().map(|o| o.data[0]).filter(|v| (5.0..50.0).contains(v)).collect();
    // With other sensors: converted, it starts near them. Alone: even the coldest value is at least 50.
    let looks = if starts.is_empty() {
        others.iter().all(|o| span(&o.data)[0] >= 50.0)
    } else {
        let usual = median(starts);
        (celsius - usual).abs() < 5.0 && c.data[0] - usual > 25.0
    };
    if looks {
        let start = c.data[0];
        let text =
            format!("starts at {start:.1} degC, which looks like degrees Fahrenheit ({celsius:.1} degC)");
        out.push(Suspicion::new(record, &c.name, MistakeKind::Unit, &[], text));
    }
}

/// Detects a lasting step that no other row or sensor shows.
fn jump(record: &Record, c: &Column, others: &[&Column], out: &mut Vec<Suspicion>) {
    let n = c.data.len();
    if n < 20 {
        return;
    }
    let own = steps(&c.data);
    let largest = (0..own.len()).max_by(|a, b| own[*a].abs().total_cmp(&own[*b].abs()));
    let Some(at) = largest else { return };
    let size = own[at].abs();
    let around = (at.saturating_sub(5)..(at + 6).min(own.len())).filter(|i| *i != at);
    let near = around.map(|i| own[i].abs()).fold(0.0, f64::max);
    let time = record.time_s();
    let usual_s = median(steps(time));
    let paused = time[at + 1] - time[at] > PAUSE * usual_s;
    let alone = others.iter().all(|o| (o.data[at + 1] - o.data[at]).abs() < 0.25 * size);
    if size < 4.0 || size < 8.0 * near || size < 20.0 * spread(&own) || paused || !alone || others.is_empty()
    {
        return;
    }
    // Heat that one body shows at once reaches others late: they begin to move then.
    let follows = |o: &&Column| begins_to_move(&o.data, at, FOLLOWS * size);
    if is_switched(record, &own, at) || others.iter().any(follows) {
        return;
    }
    let level = |r: std::ops::Range<usize>| median(c.data[r].to_vec());
    let stays = level(at + 1..(at + 6).min(n)) - level(at.saturating_sub(4)..at + 1);
    if (stays / own[at]) < 0.7 || at < 2 || at + 3 > n {
        return;
    }
    let (from, to) = (c.data[at], c.data[at + 1]);
    let text = format!("jumps from {from:.2} to {to:.2} degC between two rows, and stays");
    out.push(Suspicion::new(record, &c.name, MistakeKind::Jump, &[at + 1], text));
}

/// Rows on either side over which slopes are compared.
/// A slow body bends over many rows only.
const SIDES: [usize; 3] = [8, 16, 24];
/// Change of slope of a sensor that follows a jump, per window, as share of it.
const FOLLOWS: f64 = 0.05;
/// A change of slope must exceed this multiple of its standard error.
const CERTAIN: f64 = 6.0;
/// It must also exceed this multiple of the change one window earlier.
const NEW_BEND: f64 = 2.0;

/// Whether a sensor's slope changes after row `at`.
/// The change must be at least `least` kelvin over the rows of one side, and larger than the one before.
fn begins_to_move(v: &[f64], at: usize, least: f64) -> bool {
    // The noise is at least that of rounding to the resolution.
    let noise = noise_k(v).max(quantum(v) / 12_f64.sqrt());
    SIDES.iter().any(|side| bends(v, at, *side, least, noise))
}

/// The same test over `side` rows on either side.
fn bends(v: &[f64], at: usize, side: usize, least: f64, noise: f64) -> bool {
    let slope = |rows: std::ops::Range<usize>| -> Option<f64> {
        let rows = v.get(rows)?;
        let middle = (side - 1) as f64 / 2.0;
        let with = |(i, x): (usize, &f64)| (i as f64 - middle) * x;
        let square: f64 = (0..side).map(|i| (i as f64 - middle).powi(2)).sum();
        Some(rows.iter().enumerate().map(with).sum::<f64>() / square)
    };
    // The jump shows in the first row after `at`.
    let bend = |at: usize| Some(slope(at + 1..at + 1 + side)? - slope((at + 1).checked_sub(side)?..at + 1)?);
    let Some(here) = bend(at) else { return false };
    let before = at.checked_sub(side).and_then(bend).unwrap_or(0.0);
    let cube = (side * side * side - side) as f64;
    let error = noise * (2.0 * 12.0 / cube).sqrt();
    here.abs() > CERTAIN * error && here.abs() * side as f64 > least && here.abs() > NEW_BEND * before.abs()
}

/// A second step of this share of the largest shows that something is switched.
const AGAIN: f64 = 0.5;

/// Whether a jump comes from something switched.
/// The sensor jumps as far at other times, or the spindle or coolant changes there.
fn is_switched(record: &Record, own: &[f64], at: usize) -> bool {
    let again = own.iter().enumerate().any(|(i, d)| i.abs_diff(at) > 5 && d.abs() > AGAIN * own[at].abs());
    again || is_caused(record, at)
}

/// Whether the spindle or the coolant changes near the step after row `at`.
fn is_caused(record: &Record, at: usize) -> bool {
    let changes = |c: &Column| {
        let near = at.saturating_sub(1)..(at + 3).min(c.data.len());
        c.data[near].windows(2).any(|w| w[0].to_bits() != w[1].to_bits())
    };
    let cause = |c: &&Column| matches!(c.role, Role::Coolant | Role::SpindleSpeed);
    record.columns.iter().filter(cause).any(changes)
}

/// Reports readings that a body cannot reach and leave.
/// Returns whether there are any.
fn misread(record: &Record, c: &Column, others: &[&Column], out: &mut Vec<Suspicion>) -> bool {
    let mut rows = excursions(record, c, others);
    let data = bridged(&c.data, &rows);
    rows.extend(wild(&Column { data, ..c.clone() }, others));
    rows.sort_unstable();
    rows.dedup();
    let Some(first) = rows.first() else { return false };
    let (bad, n, degc) = (rows.len(), c.data.len(), c.data[*first]);
    let text = format!("{bad} of {n} values far from those before and after, as {degc:.2} degC");
    out.push(Suspicion::new(record, &c.name, MistakeKind::Outliers, &rows, text));
    true
}

/// Largest share of misread rows; with more, no level is known to be the body's.
const MISREAD_SHARE: f64 = 0.25;
/// Most readings of a short failure: a bus without an answer, or an open contact.
const FEW_READINGS: usize = 4;
/// Fewest equal readings that cannot be a body with noise.
const EQUAL_READINGS: usize = 3;
/// A leap exceeds this multiple of the usual row-to-row change.
const LEAP_OVER_USUAL: f64 = 8.0;
/// Rows are missing if the time step exceeds this multiple of the usual one.
const PAUSE: f64 = 3.0;

/// Misread rows between leaps, or between a leap and an end of the record.
///
/// Leaps split the rows into stretches. The longest is the body's. A stretch that begins where the body's
/// last one ended also belongs to it. The rows between were misread if the machine gave no cause and no other
/// sensor shows them.
fn excursions(record: &Record, c: &Column, others: &[&Column]) -> Vec<usize> {
    let (v, time, n) = (&c.data, record.time_s(), c.data.len());
    let own = steps(v);

    if n < EXCURSION_ROWS {
        return Vec::new();
    }
    let usual_s = median(steps(time));
    let usual_k = median(own.iter().map(|d| d.abs()));
    // Too few rows for a robust spread.
    let least = if n < SHORTEST { FAILS_K } else { limit_k(v).min(FAILS_K) };
    let far = |k: f64| k.abs() >= least && k.abs() > LEAP_OVER_USUAL * usual_k;
    let leaps = |i: usize| far(own[i - 1]) && time[i] - time[i - 1] <= PAUSE * usual_s;
    let starts: Vec<usize> = std::iter::once(0).chain((1..n).filter(|i| leaps(*i))).chain([n]).collect();
    let stretches: Vec<std::ops::Range<usize>> = starts.windows(2).map(|w| w[0]..w[1]).collect();
    let Some(body) = (0..stretches.len()).max_by_key(|k| stretches[*k].len()) else { return Vec::new() };
    // For each stretch: whether it is the body's.
    let mut is_body = vec![false; stretches.len()];
    is_body[body] = true;
    let mut end = body;
    for k in body + 1..stretches.len() {
        if !far(v[stretches[k].start] - v[stretches[end].end - 1]) {
            (is_body[k], end) = (true, k);
        }
    }
    let mut start = body;
    for k in (0..body).rev() {
        if !far(v[stretches[k].end - 1] - v[stretches[start].start]) {
            (is_body[k], start) = (true, k);
        }
    }
    let mut rows = Vec::new();
    for run in runs_of(&is_body) {
        let off = stretches[run.start].start..stretches[run.end - 1].end;
        let edges: Vec<usize> = [off.start, off.end].into_iter().filter(|i| *i > 0 && *i < n).collect();
        let equal =
            off.len() >= EQUAL_READINGS && off.clone().all(|i| v[i].to_bits() == v[off.start].to_bits());
        let leap_k = edges.iter().map(|i| own[i - 1].abs()).fold(f64::INFINITY, f64::min);
        let back = edges.len() == 2;
        let fast = leap_k >= FAILS_K || equal || back && off.len() <= FEW_READINGS;
        let alone = |i: &usize| others.iter().all(|o| (o.data[*i] - o.data[i - 1]).abs() < 0.25 * leap_k);
        // No body is constant to the last digit, however many sensors show it.
        let own_fault = edges.iter().all(alone) || equal && leap_k >= FAILS_K;
        // After a real leap a body goes on in the same direction.
        let settles = |i: &usize| {
            let behind = own.get(*i).copied().unwrap_or(0.0) * own[i - 1].signum();
            !back && behind * LEAP_OVER_USUAL > leap_k
        };
        let caused = edges.iter().any(|i| is_caused(record, i - 1));
        if fast && own_fault && !caused && !edges.iter().any(settles) {
            rows.extend(off);
        }
    }
    if rows.len() as f64 > MISREAD_SHARE * n as f64 { Vec::new() } else { rows }
}

/// Fewer rows do not separate the body from misread values.
const EXCURSION_ROWS: usize = 8;

/// Ranges of consecutive `false`.
fn runs_of(flags: &[bool]) -> Vec<std::ops::Range<usize>> {
    let places: Vec<usize> = (0..flags.len()).filter(|k| !flags[*k]).collect();
    places.chunk_by(|a, b| a + 1 == *b).map(|run| run[0]..run[run.len() - 1] + 1).collect()
}

/// Each row's deviation from the median of the five rows around it.
fn off_near(v: &[f64]) -> Vec<f64> {
    let near = |i: usize| median(v[i.saturating_sub(2)..(i + 3).min(v.len())].to_vec());
    (0..v.len()).map(|i| v[i] - near(i)).collect()
}

/// Deviation from the neighbours above which a reading is an outlier, K.
/// It includes fast steps, because a switched body moves fast and turns without a misreading.
fn limit_k(v: &[f64]) -> f64 {
    let mut moves: Vec<f64> = steps(v).iter().map(|d| d.abs()).collect();
    moves.sort_by(f64::total_cmp);
    (15.0 * spread(&off_near(v))).max(LEAST_K).max(3.0 * moves[moves.len() * 9 / 10])
}

/// Single values far from those before and after.
fn wild(c: &Column, others: &[&Column]) -> Vec<usize> {
    let n = c.data.len();
    // If the machine causes a peak, another sensor shows it too.
    let peak = |v: &[f64], i: usize| v[i] - f64::midpoint(v[i - 1], v[i + 1]);
    let alone = |i: usize, off: f64| others.iter().all(|o| peak(&o.data, i).abs() < 0.1 * off.abs());
    if n < SHORTEST {
        let honest = |i: usize, off: f64| i == 0 || i == n - 1 || off < LEAST_K || !alone(i, off);
        let found = small_sample_outliers::is_small_sample(n)
            .then(|| small_sample_outliers::wild(&c.data, &[vec![(0..n).collect()]], &honest, |_| false));
        return found.map_or_else(Vec::new, |found| found.rows);
    }
    let (left, limit) = (off_near(&c.data), limit_k(&c.data));
    let rows: Vec<usize> = (2..n - 2).filter(|i| left[*i].abs() > limit && alone(*i, left[*i])).collect();
    if rows.len() * 10 <= n { rows } else { Vec::new() }
}

/// Fewer rows give no robust spread.
const SHORTEST: usize = 20;
/// Smallest deviation of an outlier, K.
const LEAST_K: f64 = 3.0;

/// Detects two columns with the same values.
fn copies(record: &Record, out: &mut Vec<Suspicion>) {
    let columns: Vec<&Column> =
        record.columns.iter().filter(|c| is_sensor(c) || c.role.is_response()).collect();
    for (k, c) in columns.iter().enumerate() {
        if record.rows() < 10 || distinct(&c.data) < 4 {
            continue;
        }
        if let Some(first) = columns[..k].iter().find(|f| f.data == c.data) {
            let text = format!("the same in every row as {}", first.name);
            out.push(Suspicion::new(record, &c.name, MistakeKind::Doubled, &[], text));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sensors that follow a jump begin to move then.
    /// Sensors that move already or later do not follow it.
    #[test]
    fn what_others_follow_is_no_jump() {
        let body = |from: usize, tau: f64| -> Vec<f64> {
            let late = |i: usize| if i < from { 0.0 } else { 1.0 - (-((i - from) as f64) / tau).exp() };
            (0..120).map(|i| 21.0 + 5.0 * late(i) + 0.02 * ((i * 7 % 11) as f64 / 5.0 - 1.0)).collect()
        };
        for tau in [4.0, 15.0, 50.0] {
            assert!(begins_to_move(&body(60, tau), 60, 0.05 * 5.0), "{tau}");
            assert!(!begins_to_move(&body(0, tau), 60, 0.05 * 5.0), "{tau}: warm already");
            assert!(!begins_to_move(&body(90, tau), 60, 0.05 * 5.0), "{tau}: later");
        }
    }
}
