//! Terms of an instrument's set-up, which are never the machine's.
//! They are free in every record, never named, never written into a model and never corrected live. Each term
//! has one function; a new one needs its function and a line in [`TERMS`].

use crate::gaussian_process::{Kernel, directions, knots, shares};
use crate::priors::{
    AIR_UM_S, CENTRE_UM, CONTRIBUTION, KNOTS, LINE_HOURS, LINE_UM_PER_H, NOISE, PAUSE_STEPS, PLACE_MM,
    SMOOTH_RANK, TURN_URAD, ZERO_UM,
};
use crate::rows_and_noise::{MeasuredRows, ResponseSegment, is_placed};
use crate::search_limits::{AIR_DIRECTIONS, CIRCLE_PLACES, MOST_PAUSES, MOST_PLACES, PLACES_PER_MM};
use rtec_least_squares::projected_eigen;
use rtec_model::ballbar_circle::Circle;
use rtec_model::effect::{Effect, ParameterFitMethod};
use rtec_model::record::{Column, Record, Role, RunKind};

/// Kind of a set-up term.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SetUpTermKind {
    /// The gauge's zero, or the length or size of a bar or ring, µm.
    Zero,
    /// The circle's centre along the first axis of the plane, µm.
    CentreFirst,
    /// The circle's centre along the second axis of the plane, µm.
    CentreSecond,
    /// A line in time, µm/h.
    Line,
    /// Wander of air and stand in addition to the line, µm.
    Air,
    /// A jump at a pause, µm.
    Jump,
    /// Rounding that rows of one reading share, µm.
    Rounding,
    /// An effect of the model whose position the record does not state.
    Unplaced,
    /// Rotation of a plate relative to the others, µrad.
    Turn,
    /// A walk of a response that has no name.
    Wander,
    /// The first reading after a turn that the record does not state.
    AfterTurn,
}

/// A set-up term.
/// It has a column and the standard deviation of its coefficient.
#[derive(Debug, Clone)]
pub struct SetUpTerm {
    /// Its kind.
    pub what: SetUpTermKind,
    /// Index of its record; the first if several share it.
    pub record: usize,
    /// Its column over all rows.
    pub column: Vec<f64>,
    /// One standard deviation of the coefficient.
    pub sd: f64,
}

/// Makes the terms of one kind.
type Make = fn(&MeasuredRows<'_>, &[Effect], &mut Vec<SetUpTerm>);

/// All kinds of terms.
pub const TERMS: [Make; 9] = [zeros, centres, lines, air, unplaced, turned, after_turns, begins, dithered];

/// The set-up terms of these records.
#[must_use]
pub fn terms(rows: &MeasuredRows<'_>, model: &[Effect]) -> Vec<SetUpTerm> {
    let mut out = Vec::new();
    for make in TERMS {
        make(rows, model, &mut out);
    }
    out.retain(|t| t.column.iter().any(|x| *x != 0.0));
    out
}

fn column(rows: &MeasuredRows<'_>, s: &ResponseSegment, value: impl FnMut(usize) -> f64) -> Vec<f64> {
    let mut out = vec![0.0; rows.n];
    for (x, v) in out[s.rows.clone()].iter_mut().zip((0..s.rows.len()).map(value)) {
        *x = v;
    }
    out
}

fn errors<'a>(rows: &'a MeasuredRows<'_>) -> impl Iterator<Item = &'a ResponseSegment> {
    rows.segments.iter().filter(|s| !rows.is_force(s.response))
}

fn zeros(rows: &MeasuredRows<'_>, _: &[Effect], out: &mut Vec<SetUpTerm>) {
    let mut shared: Vec<(&str, usize, usize)> = Vec::new();
    for s in errors(rows) {
        let own = column(rows, s, |_| 1.0);
        if let Some(name) = rows.record(s).zero.as_deref() {
            if let Some((.., at)) = shared.iter().find(|(n, r, _)| *n == name && *r == s.response) {
                rtec_least_squares::add(&mut out[*at].column, 1.0, &own);
                continue;
            }
            shared.push((name, s.response, out.len()));
        }
        out.push(SetUpTerm { what: SetUpTermKind::Zero, record: s.record, column: own, sd: ZERO_UM });
    }
}

/// A circle's centre: one lobe per turn.
fn centres(rows: &MeasuredRows<'_>, _: &[Effect], out: &mut Vec<SetUpTerm>) {
    for s in errors(rows) {
        let record = rows.record(s);
        let radial = rows.responses[s.response].axis().is_some_and(|a| a.as_str() == "r");
        let only = record.responses().count() == 1 && matches!(record.kind, RunKind::Probing | RunKind::Part);
        let Some(angle) = record.data(&Role::Angle).filter(|_| radial || only) else { continue };
        for (what, f) in [
            (SetUpTermKind::CentreFirst, f64::cos as fn(f64) -> f64),
            (SetUpTermKind::CentreSecond, f64::sin),
        ] {
            out.push(SetUpTerm {
                what,
                record: s.record,
                column: column(rows, s, |i| f(angle[i])),
                sd: CENTRE_UM,
            });
        }
    }
}

/// Times of a record long enough for air and stand to creep, s from the first row.
/// If no time was written, rows are evenly spaced, and the run may last as long as a creep keeps its
/// direction.
fn creeping_s(record: &Record) -> Option<Vec<f64>> {
    if !matches!(record.kind, RunKind::Positioning | RunKind::Drift) {
        return None;
    }
    let t = record.time_s();
    let (first, last) = (*t.first()?, *t.last()?);
    let timed = record.column(&Role::Time).is_some();
    let pace = if timed { 1.0 } else { 3600.0 * LINE_HOURS / (last - first).max(1.0) };
    Some(t.iter().map(|t| (t - first) * pace).collect())
}

/// Rate of a line that creeps over a whole run as it can over the longest, µm/h.
#[must_use]
pub(crate) fn longest_creep(hours: &[f64]) -> f64 {
    LINE_UM_PER_H * LINE_HOURS / hours.iter().copied().fold(1e-9, f64::max)
}

/// Linear drift of air and stand over hours.
fn lines(rows: &MeasuredRows<'_>, _: &[Effect], out: &mut Vec<SetUpTerm>) {
    for s in errors(rows) {
        let Some(t) = creeping_s(rows.record(s)) else { continue };
        // Counted from the start, where the gauge was set to zero.
        let hours = column(rows, s, |i| t[i] / 3600.0);
        // A creep does not keep its direction for longer.
        let sd = longest_creep(&hours).min(LINE_UM_PER_H);
        out.push(SetUpTerm { what: SetUpTermKind::Line, record: s.record, column: hours, sd });
    }
}

/// Wander of air and stand in addition to the drift: a mean-reverting walk.
fn air(rows: &MeasuredRows<'_>, _: &[Effect], out: &mut Vec<SetUpTerm>) {
    for s in errors(rows) {
        let Some(t) = creeping_s(rows.record(s)) else { continue };
        let places = knots(&t, KNOTS);
        let (Some(first), Some(last)) = (places.first(), places.last()) else { continue };
        let length = AIR_UM_S.1.max(0.1 * (last - first));
        for d in directions(&places, Kernel::Rough(length), &[vec![1.0; places.len()]], AIR_DIRECTIONS) {
            let at = |i: usize| shares(&places, t[i]).iter().map(|(k, w)| w * d[*k]).sum();
            out.push(SetUpTerm {
                what: SetUpTermKind::Air,
                record: s.record,
                column: column(rows, s, at),
                sd: AIR_UM_S.0,
            });
        }
    }
}

/// Rows after which the run pauses.
#[must_use]
pub fn pauses(record: &Record) -> Vec<usize> {
    let Some(t) = record.data(&Role::Time) else { return Vec::new() };
    let gaps: Vec<f64> = t.windows(2).map(|w| w[1] - w[0]).collect();
    let mut sorted = gaps.clone();
    sorted.sort_by(f64::total_cmp);
    let Some(usual) = sorted.get(sorted.len() / 2).copied().filter(|g| *g > 0.0) else { return Vec::new() };
    (0..gaps.len()).filter(|i| gaps[*i] > PAUSE_STEPS * usual).collect()
}

/// A step for each pause of a run, one micrometre high.
/// Somebody may have touched the stand there. Steps are searched like hypotheses, because they are rare, and
/// then of any size.
#[must_use]
pub fn jumps(rows: &MeasuredRows<'_>) -> Vec<SetUpTerm> {
    let mut out = Vec::new();
    for s in errors(rows) {
        let record = rows.record(s);
        let pauses = pauses(record);
        if record.kind == RunKind::Ballbar || pauses.len() > MOST_PAUSES {
            continue;
        }
        for p in pauses {
            let step = column(rows, s, |i| f64::from(u8::from(i > p)));
            out.push(SetUpTerm { what: SetUpTermKind::Jump, record: s.record, column: step, sd: 1.0 });
        }
    }
    out
}

/// Grid index of a position.
#[must_use]
pub fn place_of(mm: f64) -> i64 {
    (mm * PLACES_PER_MM).round() as i64
}

/// Where each row was read: grid indices and directions of all axes.
/// All are equal if the record has no position of the response's axis. The names of the columns do not
/// matter: rows of one reading stay together.
fn places(rows: &MeasuredRows<'_>, s: &ResponseSegment) -> Vec<Vec<i64>> {
    let record = rows.record(s);
    let own = rows.responses[s.response].axis().cloned();
    let placed = own.is_some_and(|a| record.data(&Role::Position(a)).is_some());
    let of = |i: usize| {
        let key = |c: &Column| match c.role {
            Role::Position(_) => Some(place_of(c.data[i])),
            Role::Direction(_) => Some(c.data[i] as i64),
            _ => None,
        };
        if placed { record.columns.iter().filter_map(key).collect() } else { Vec::new() }
    };
    (0..s.rows.len()).map(of).collect()
}

/// The resolution of a gauge whose noise does not dither it.
/// Most repeats at one position then read the same. Also returns the groups of rows that share one reading in
/// one direction.
fn coarse(rows: &MeasuredRows<'_>, s: &ResponseSegment) -> Option<(f64, Vec<Vec<usize>>)> {
    let y = &rows.measured[s.rows.clone()];
    let values = numbers(y);
    let q = least_step(&values).filter(|q| are_multiples(&values, *q))?;
    if !is_repeated(y, values.len()) || values.len() > 60 {
        return None;
    }
    // A repeat is the next row at the same position; without positions it is the next row.
    let at = places(rows, s);
    let mut order: Vec<usize> = (0..y.len()).collect();
    order.sort_by_key(|i| (&at[*i], *i));
    let (mut repeats, mut same) = (0, 0);
    for w in order.windows(2).filter(|w| at[w[0]] == at[w[1]]) {
        repeats += 1;
        same += usize::from((y[w[0]] - y[w[1]]).abs() < 0.5 * q);
    }
    if repeats < 6 || 2 * same < repeats {
        return None;
    }
    let axis = rows.responses[s.response].axis().cloned();
    let direction = axis.and_then(|a| rows.record(s).data(&Role::Direction(a)));
    let way = |i: usize| direction.map_or(0, |d| d[i] as i64);
    let mut groups: Vec<((i64, i64), Vec<usize>)> = Vec::new();
    for (i, v) in y.iter().enumerate() {
        let key = ((v / q).round() as i64, way(i));
        match groups.iter_mut().find(|(k, _)| *k == key) {
            Some((_, rows)) => rows.push(i),
            None => groups.push((key, vec![i])),
        }
    }
    Some((q, groups.into_iter().map(|(_, g)| g).collect()))
}

/// The rounding error shared by rows of one reading.
/// Repeats do not average it away. It widens intervals; the noise is at least as large ([`floors`]).
#[must_use]
pub fn rounding(rows: &MeasuredRows<'_>) -> Vec<SetUpTerm> {
    let mut out = Vec::new();
    for s in errors(rows) {
        let Some((q, groups)) = coarse(rows, s) else { continue };
        for group in groups {
            let mut own = vec![0.0; rows.n];
            for i in group {
                own[s.rows.start + i] = 1.0;
            }
            out.push(SetUpTerm {
                what: SetUpTermKind::Rounding,
                record: s.record,
                column: own,
                sd: q / 12f64.sqrt(),
            });
        }
    }
    out
}

/// Rounding error that is left if noise dithers it in part.
/// Repeats at one position and direction share an error of q/π · exp(−2π²σ²/q²), the first harmonic of the
/// rounding sawtooth (Widrow 1956).
fn dithered(rows: &MeasuredRows<'_>, _: &[Effect], out: &mut Vec<SetUpTerm>) {
    for s in errors(rows) {
        let y = &rows.measured[s.rows.clone()];
        // Noise that dithers shows more numbers than a few.
        let Some(q) = step_of(y).filter(|_| numbers(y).len() >= 5) else { continue };
        let mut groups: std::collections::BTreeMap<Vec<i64>, Vec<usize>> = std::collections::BTreeMap::new();
        for (i, place) in places(rows, s).into_iter().enumerate().filter(|(_, p)| !p.is_empty()) {
            groups.entry(place).or_default().push(i);
        }
        groups.retain(|_, g| g.len() > 1);
        let (mut squares, mut freedom) = (0.0, 0.0);
        for g in groups.values() {
            let mean = g.iter().map(|i| y[*i]).sum::<f64>() / g.len() as f64;
            squares += g.iter().map(|i| (y[*i] - mean).powi(2)).sum::<f64>();
            freedom += g.len() as f64 - 1.0;
        }
        if groups.len() < 4 || groups.len() > MOST_PLACES || freedom < 2.0 * groups.len() as f64 {
            continue;
        }
        let noise2 = (squares / freedom - q * q / 12.0).max(0.01 * q * q);
        let pi = std::f64::consts::PI;
        let sd = q / (pi * 2f64.sqrt()) * (-2.0 * pi * pi * noise2 / (q * q)).exp();
        if sd < 0.02 * q {
            continue;
        }
        for g in groups.into_values() {
            let mut own = vec![0.0; rows.n];
            for i in g {
                own[s.rows.start + i] = 1.0;
            }
            out.push(SetUpTerm { what: SetUpTermKind::Rounding, record: s.record, column: own, sd });
        }
    }
}

/// Error of a record's responses by rounding only, µm RMS.
/// It is that of the coarsest gauge.
#[must_use]
pub fn resolution_um(record: &Record) -> f64 {
    let errors = record.responses().filter(|c| matches!(c.role, Role::Error(_)));
    errors.filter_map(|c| step_of(&c.data)).fold(0.0, f64::max) / 12f64.sqrt()
}

/// The step of which all numbers are multiples.
/// Two numbers define it. Each further one lies on it by chance in one case of 25, so five are not chance.
/// Of fewer, those that are read again define it, if most rows only repeat a number.
#[must_use]
pub fn step_of(y: &[f64]) -> Option<f64> {
    let values = numbers(y);
    let few = values.len() < 5;
    let of = if few { values.iter().copied().filter(|v| v.1 > 1).collect() } else { values.clone() };
    let q = least_step(&of)?;
    let shows = if few { is_repeated(y, values.len()) } else { values.len() < 400 };
    (shows && are_multiples(&values, q)).then_some(q)
}

/// The different numbers, rising, each with how often it is read.
fn numbers(y: &[f64]) -> Vec<(f64, usize)> {
    let mut sorted = y.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.chunk_by(|a, b| (*a - *b).abs() < 1e-9).map(|same| (same[0], same.len())).collect()
}

fn least_step(values: &[(f64, usize)]) -> Option<f64> {
    values.windows(2).map(|w| w[1].0 - w[0].0).reduce(f64::min)
}

fn are_multiples(values: &[(f64, usize)], q: f64) -> bool {
    values.iter().map(|v| (v.0 - values[0].0) / q).all(|steps| (steps - steps.round()).abs() < 0.02)
}

/// Whether so many different numbers are read three times each on average.
const fn is_repeated(y: &[f64], count: usize) -> bool {
    y.len() >= 8 && 3 * count <= y.len()
}

/// Smallest size of the noise, per segment: undithered rounding.
/// Where no reading ever changes, the gauge's step is unknown, and the noise has its usual size.
#[must_use]
pub fn floors(rows: &MeasuredRows<'_>) -> Vec<f64> {
    let coarse = |s: &ResponseSegment| coarse(rows, s).map_or(0.0, |c| c.0 / 12f64.sqrt());
    rows.segments.iter().map(|s| if stands_still(rows, s) { NOISE[0] } else { coarse(s) }).collect()
}

/// Whether all readings of a segment are equal.
fn stands_still(rows: &MeasuredRows<'_>, s: &ResponseSegment) -> bool {
    let y = &rows.measured[s.rows.clone()];
    y.iter().all(|v| v.to_bits() == y[0].to_bits())
}

/// Root of each row's weight.
/// Consecutive rows that read the same on a coarse gauge count as one.
/// All rows of a segment have the same weight. Weights that followed the readings would pull the mean to the
/// rounded values.
#[must_use]
pub fn weights(rows: &MeasuredRows<'_>) -> Vec<f64> {
    let mut out = vec![1.0; rows.n];
    for s in rows.segments.iter().filter(|s| stands_still(rows, s) || coarse(rows, s).is_some()) {
        let y = &rows.measured[s.rows.clone()];
        let runs = y.chunk_by(|a, b| (a - b).abs() < 1e-9).count();
        out[s.rows.clone()].fill((runs as f64 / y.len() as f64).sqrt());
    }
    out
}

/// Columns of an effect in circles whose centre is not stated.
/// There a wave has its own phase, and any other effect its own lobes. `sizes`: one per coefficient. Returns
/// record and column, at one standard deviation.
#[must_use]
pub fn unknown_centre_columns(
    rows: &MeasuredRows<'_>,
    effect: &Effect,
    sizes: &[f64],
) -> Vec<(usize, Vec<f64>)> {
    let mut out = Vec::new();
    for s in errors(rows) {
        let record = rows.record(s);
        if is_placed(record, effect) {
            continue;
        }
        let Some(angle) = record.data(&Role::Angle) else { continue };
        let role = &rows.responses[s.response];
        let acts = effect.acts_on(record);
        let (Some((_, component)), Ok(bound)) = (acts.iter().find(|(r, _)| r == role), effect.bind(record))
        else {
            continue;
        };
        let n = record.rows();
        let mut basis = vec![0.0; n * effect.coefficient_count()];
        bound.basis(effect, *component, &mut basis);
        if effect.description().searched.wave.is_some() {
            for (c, size) in basis.chunks(n).zip(sizes) {
                out.push((s.record, column(rows, s, |i| size * c[i])));
            }
            continue;
        }
        if effect.constraints().is_empty() {
            // In proportion to each position: about the circle's centre, plus its possible distance from the
            // axes' zero.
            for (c, size) in basis.chunks(n).zip(sizes) {
                out.push((s.record, column(rows, s, |i| size * c[i])));
            }
            for shifted in elsewhere(record) {
                let mut there = vec![0.0; n * effect.coefficient_count()];
                let Ok(bound) = effect.bind(&shifted) else { continue };
                bound.basis(effect, *component, &mut there);
                for ((a, b), size) in there.chunks(n).zip(basis.chunks(n)).zip(sizes) {
                    out.push((s.record, column(rows, s, |i| size * (a[i] - b[i]))));
                }
            }
            continue;
        }
        let squares = |(c, size): (&[f64], &f64)| size * size * c.iter().map(|v| v * v).sum::<f64>();
        let size = (basis.chunks(n).zip(sizes).map(squares).sum::<f64>() / n as f64).sqrt();
        // Mirrored so that its place stays the same, a circle shows the same of a map, or its opposite.
        let (of, along) = (effect.axes().first(), effect.axes().last());
        let Some(side) = record.circle().and_then(|c| c.plane.iter().position(|a| Some(a) == along)) else {
            continue;
        };
        let mirrored = |a: f64| if side == 0 { -a } else { std::f64::consts::PI - a };
        let sign = if of == along { 1.0 } else { -1.0 };
        for lobes in 2..=8 {
            let k = f64::from(lobes);
            let fits = |f: &fn(f64) -> f64| (f(k * mirrored(0.7)) - sign * f(k * 0.7)).abs() < 1e-9;
            for f in [f64::cos as fn(f64) -> f64, f64::sin].into_iter().filter(fits) {
                out.push((s.record, column(rows, s, |i| size / k.sqrt() * f(k * angle[i]))));
            }
        }
    }
    out
}

/// The same circle about another centre.
fn about(record: &Record, centre_mm: [f64; 2]) -> Option<Record> {
    let circle = record.circle()?.clone();
    record.clone().with_circle(Circle { centre_mm: Some(centre_mm), ..circle }).ok()
}

/// The same circle, moved along each of its axes.
fn elsewhere(record: &Record) -> Vec<Record> {
    [[PLACE_MM, 0.0], [0.0, PLACE_MM]].into_iter().filter_map(|centre| about(record, centre)).collect()
}

/// A map of the model in circles of unknown centre, at one standard deviation.
/// Each circle lies anywhere within the map's range, or anywhere on the axis if it does not fit in there. The
/// columns have the mean square of what the map shows at those places. Returns record and column.
fn somewhere_within(
    rows: &MeasuredRows<'_>,
    map: &Effect,
    along: usize,
    [from, to]: [f64; 2],
) -> Vec<(usize, Vec<f64>)> {
    let mut out = Vec::new();
    for s in errors(rows) {
        let record = rows.record(s);
        let (Some(circle), Some(axis)) = (record.circle(), map.axes().get(along)) else { continue };
        let role = &rows.responses[s.response];
        let acts = map.acts_on(record);
        let (Some(side), Some((_, component)), false) = (
            circle.plane.iter().position(|a| a == axis),
            acts.iter().find(|(r, _)| r == role),
            is_placed(record, map),
        ) else {
            continue;
        };
        let middle = 0.5 * (from + to);
        let reach = 0.5 * (to - from) - circle.radius_mm;
        let reach = if reach > 0.0 { reach } else { PLACE_MM };
        let mut shown: Vec<Vec<f64>> = Vec::new();
        for i in 0..CIRCLE_PLACES {
            let mut centre = [0.0; 2];
            centre[side] = middle + reach * ((2 * i + 1) as f64 / CIRCLE_PLACES as f64 - 1.0);
            let Some(there) = about(record, centre) else { continue };
            let Ok(bound) = map.bind(&there) else { continue };
            let mut basis = vec![0.0; record.rows() * map.coefficient_count()];
            bound.basis(map, *component, &mut basis);
            let mut column = vec![0.0; record.rows()];
            for (height, c) in map.coefficients().iter().zip(basis.chunks(record.rows())) {
                rtec_least_squares::add(&mut column, height / (CIRCLE_PLACES as f64).sqrt(), c);
            }
            shown.push(column);
        }
        if shown.is_empty() {
            continue;
        }
        let product = |i: usize, j: usize| rtec_least_squares::dot(&shown[i], &shown[j]);
        let found = projected_eigen(shown.len(), product, &[]);
        let largest = found.first().map_or(0.0, |d| d.0);
        for (_, direction) in found.iter().take_while(|d| d.0 > SMOOTH_RANK * largest) {
            let sum = |i: usize| direction.iter().zip(&shown).map(|(d, c)| d * c[i]).sum();
            out.push((s.record, column(rows, s, sum)));
        }
    }
    out
}

/// Effects of the model in circles of unknown centre.
fn unplaced(rows: &MeasuredRows<'_>, model: &[Effect], out: &mut Vec<SetUpTerm>) {
    for effect in model {
        if let Some((along, range_mm)) = effect.stretch_mm() {
            for (record, column) in somewhere_within(rows, effect, along, range_mm) {
                out.push(SetUpTerm { what: SetUpTermKind::Unplaced, record, column, sd: 1.0 });
            }
            continue;
        }
        let sizes: Vec<f64> = match effect.description().place(ParameterFitMethod::Amplitude) {
            Some(i) => vec![effect.scalar(i).abs(); effect.coefficient_count()],
            None => effect.coefficients().iter().map(|c| c.abs()).collect(),
        };
        for (record, column) in unknown_centre_columns(rows, effect, &sizes) {
            // Equal lobes of several effects are merged into one term, whose variance is their sum.
            let same = |t: &&mut SetUpTerm| {
                t.what == SetUpTermKind::Unplaced && t.record == record && proportional(&t.column, &column)
            };
            if let Some(t) = out.iter_mut().find(same) {
                let by = rms(&column) / rms(&t.column);
                t.sd = t.sd.hypot(by);
                continue;
            }
            out.push(SetUpTerm { what: SetUpTermKind::Unplaced, record, column, sd: 1.0 });
        }
    }
}

fn rms(column: &[f64]) -> f64 {
    (rtec_least_squares::dot(column, column) / column.len().max(1) as f64).sqrt()
}

fn proportional(a: &[f64], b: &[f64]) -> bool {
    let together = rtec_least_squares::dot(a, b).abs() / a.len().max(1) as f64;
    let apart = rms(a) * rms(b);
    apart > 0.0 && together > (1.0 - 1e-12) * apart
}

/// Rotation of each plate relative to the mean of all plates.
/// The mean rotation is part of the contract and stays.
fn turned(rows: &MeasuredRows<'_>, _: &[Effect], out: &mut Vec<SetUpTerm>) {
    let turns = turns(rows);
    if turns.len() < 2 {
        return;
    }
    let mut mean = vec![0.0; rows.n];
    for t in &turns {
        rtec_least_squares::add(&mut mean, 1.0 / turns.len() as f64, &t.column);
    }
    for mut t in turns {
        rtec_least_squares::add(&mut t.column, -1.0, &mean);
        out.push(t);
    }
}

/// Rotation of each plate on the table, µrad.
#[must_use]
pub fn turns(rows: &MeasuredRows<'_>) -> Vec<SetUpTerm> {
    let of = |(r, record): (usize, &Record)| {
        let axes: Vec<_> = record.axes(Role::Position).cloned().collect();
        let [a, b] = &axes[..] else { return None };
        let mut own = vec![0.0; rows.n];
        for s in errors(rows).filter(|s| s.record == r) {
            let Some(axis) = rows.responses[s.response].axis() else { continue };
            let (other, by) = if axis == a { (b, -1.0) } else { (a, 1.0) };
            let Some(p) = record.data(&Role::Position(other.clone())) else { continue };
            for (x, p) in own[s.rows.clone()].iter_mut().zip(p) {
                *x = by * p / 1000.0;
            }
        }
        Some(SetUpTerm { what: SetUpTermKind::Turn, record: r, column: own, sd: TURN_URAD })
    };
    rows.records.iter().enumerate().filter(|(_, r)| r.kind == RunKind::Plate).filter_map(of).collect()
}

/// First readings after turns whose place the run does not state.
#[must_use]
pub fn first_after_turn(record: &Record, direction: &[f64]) -> Vec<usize> {
    if record.tells_turns() {
        return Vec::new();
    }
    (1..direction.len()).filter(|i| direction[*i] * direction[i - 1] < 0.0).collect()
}

/// A spike of the model before the first turn of a record.
/// The axis's direction before the record is unknown, so a spike may act up to the first turn.
fn begins(rows: &MeasuredRows<'_>, model: &[Effect], out: &mut Vec<SetUpTerm>) {
    for effect in model.iter().filter(|e| e.description().after_turn) {
        let Some(axis) = effect.axes().first() else { continue };
        let values = [ParameterFitMethod::Linear, ParameterFitMethod::Smooth]
            .map(|how| effect.description().place(how));
        let ([Some(um), Some(length)], Some(share)) = (values, rows.share(axis)) else { continue };
        for s in errors(rows) {
            let record = rows.record(s);
            let (position, direction) = (Role::Position(axis.clone()), Role::Direction(axis.clone()));
            let (Some(p), Some(d)) = (record.data(&position), record.data(&direction)) else { continue };
            let way = d.iter().copied().find(|d| *d != 0.0).unwrap_or(0.0);
            let until = d.iter().position(|d| d * way < 0.0).unwrap_or(d.len());
            let mut travel = 0.0;
            let spike = |i: usize| {
                if i > 0 {
                    travel += (p[i] - p[i - 1]).abs();
                }
                let here = if i < until { d[i] * share[s.rows.start + i] } else { 0.0 };
                here * effect.scalar(um) * (-travel / effect.scalar(length)).exp()
            };
            out.push(SetUpTerm {
                what: SetUpTermKind::AfterTurn,
                record: s.record,
                column: column(rows, s, spike),
                sd: 1.0,
            });
        }
    }
}

/// First readings after an unstated turn: they contain no spike, or a whole one.
fn after_turns(rows: &MeasuredRows<'_>, model: &[Effect], out: &mut Vec<SetUpTerm>) {
    for s in errors(rows) {
        let record = rows.record(s);
        let Some(axis) = rows.responses[s.response].axis() else { continue };
        let Some(direction) = record.data(&Role::Direction(axis.clone())) else { continue };
        let first = first_after_turn(record, direction);
        if first.is_empty() {
            continue;
        }
        let mut own = vec![0.0; rows.n];
        for i in first {
            own[s.rows.start + i] = direction[i];
        }
        // As large and as rare as a spike may be, or as large as the model's own spike.
        let spikes = model.iter().filter(|e| e.description().after_turn && e.axes().first() == Some(axis));
        let own_um =
            spikes.filter_map(|e| Some(e.scalar(e.description().place(ParameterFitMethod::Linear)?).abs()));
        let sd = own_um.fold(0.3 * CONTRIBUTION, f64::max);
        out.push(SetUpTerm { what: SetUpTermKind::AfterTurn, record: s.record, column: own, sd });
    }
}
