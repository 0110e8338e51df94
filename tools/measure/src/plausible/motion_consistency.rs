//! Checks positions, directions, speeds, times and errors against one another.

use super::robust_stats::{distinct, median, middle_range, quantum, range, spread, steps};
use super::{MistakeKind, Suspicion};
use crate::iso230::{FittedCircle, correlation, line};
use rtec_model::ballbar_circle::turn_rad;
use rtec_model::record::{Axis, Column, Record, Role, RunKind, span};

/// The longest axes of machine tools, mm.
const LONGEST_MM: f64 = 30_000.0;

pub(super) fn look(record: &Record, out: &mut Vec<Suspicion>) {
    clock(record, out);
    angle(record, out);
    let axes: Vec<Axis> = record.axes(Role::Position).cloned().collect();
    let mut taken: Vec<String> = Vec::new();
    for axis in &axes {
        let Some(p) = record.column(&Role::Position(axis.clone())) else { continue };
        if let Some(e) = record.column(&Role::Error(axis.clone()))
            && (actual(record, p, e, out) || exchanged(record, axis, p, e, out))
        {
            taken.push(e.name.clone());
            continue;
        }
        position_unit(record, p, out);
        direction(record, axis, p, out);
        speed(record, axis, p, out);
    }
    in_another_column(record, &axes, out);
    for e in record.responses().filter(|e| matches!(e.role, Role::Error(_)) && !taken.contains(&e.name)) {
        error_unit(record, e, out);
    }
}

/// Detects milliseconds or days called seconds, and a clock that was set.
fn clock(record: &Record, out: &mut Vec<Suspicion>) {
    let Some(t) = record.column(&Role::Time) else { return };
    if t.data.len() < 5 {
        return;
    }
    let between = steps(&t.data);
    let usual = median(between.iter().copied().filter(|d| *d > 0.0));
    let limit = match record.kind {
        RunKind::Drift => 3600.0,
        RunKind::Dynamics | RunKind::Ballbar | RunKind::FeedSweep => 60.0,
        _ => 900.0,
    };
    // Whole seconds that are not whole minutes, over weeks: loggers are set to 1, 10 or 60 s, not to 1000 s.
    let whole = t.data.iter().all(|t| t.fract() == 0.0);
    let long = usual * t.data.len() as f64 > 20.0 * DAY_S && whole && usual % 60.0 != 0.0;
    let epoch_ms = t.data[0] > 5e11;
    // People read gauges by hand every quarter of an hour or a multiple of it, up to four hours.
    let by_hand = record.kind == RunKind::Drift && usual % 900.0 == 0.0 && usual <= 14_400.0;
    if usual >= limit && !by_hand || long || epoch_ms {
        let text = format!("rows are {usual} s apart, which looks like milliseconds");
        out.push(Suspicion::new(record, &t.name, MistakeKind::Unit, &[], text));
        return;
    }
    // A spreadsheet counts days from 1900: 36 526 to 58 000 are dates of this century.
    if record.kind == RunKind::Drift
        && usual > 0.0
        && usual < 0.05
        && (36_526.0..58_000.0).contains(&t.data[0])
    {
        let start = t.data[0];
        let text = format!(
            "begins at {start:.3} in steps of {usual:.5}, which looks like the days of a spreadsheet"
        );
        out.push(Suspicion::new(record, &t.name, MistakeKind::Unit, &[], text));
        return;
    }
    let Some(at) = (0..between.len()).max_by(|a, b| between[*a].total_cmp(&between[*b])) else { return };
    if between[at] > LONGEST_PAUSE_S.max(1000.0 * usual) {
        let days = between[at] / DAY_S;
        let text = format!("steps by {days:.1} days: a clock that was set, or two runs in one file");
        out.push(Suspicion::new(record, &t.name, MistakeKind::Jump, &[at + 1], text));
    }
}

const DAY_S: f64 = 86_400.0;
/// Longest pause in a run, s: a long weekend.
const LONGEST_PAUSE_S: f64 = 5.0 * DAY_S;

/// Detects degrees called radians, and an angle that contradicts the positions.
/// Degrees: more than a dozen turns if read as radians, and quarters of a degree, coarse steps or a whole
/// number of half turns.
fn angle(record: &Record, out: &mut Vec<Suspicion>) {
    let Some(a) = record.column(&Role::Angle) else { return };
    let [lo, hi] = span(&a.data);
    let nice = a.data.iter().filter(|v| ((**v * 4.0) - (**v * 4.0).round()).abs() < 1e-6).count();
    let coarse = median(steps(&a.data).iter().map(|d| d.abs())) > 0.2;
    let halves = range(&a.data) / 180.0;
    let whole = halves > 0.9 && (halves - halves.round()).abs() < 0.01;
    let looks = nice * 10 >= a.data.len() * 9 || coarse || whole;
    if range(&a.data) > 80.0 && lo >= -3601.0 && hi <= 3601.0 && looks {
        let text = format!("from {lo} to {hi} rad, which looks like degrees");
        out.push(Suspicion::new(record, &a.name, MistakeKind::Unit, &[], text));
    } else {
        beside_positions(record, a, out);
    }
}

/// Largest median deviation from the angle of the positions, rad.
/// 1° is a few rows late on a quick circle.
const OTHER_ANGLE_RAD: f64 = 0.0175;

fn beside_positions(record: &Record, angle: &Column, out: &mut Vec<Suspicion>) {
    let Some(circle) = record.circle() else { return };
    let [Some(x), Some(y)] = circle.plane.each_ref().map(|a| record.position(a)) else { return };
    let Some(round) = FittedCircle::through(x, y).filter(FittedCircle::is_met) else { return };
    let places = x.iter().zip(y).map(|(x, y)| round.angle(*x, *y));
    let off = |sign: f64| {
        let of = |(p, a): (f64, &f64)| turn_rad(sign * a, p).abs();
        median(places.clone().zip(&angle.data).map(of))
    };
    if off(1.0) > OTHER_ANGLE_RAD {
        let [a, b] = &circle.plane;
        let how = if off(-1.0) < OTHER_ANGLE_RAD { ": it runs the other way round" } else { "" };
        let off = format!("off by {:.3} rad in the middle{how}", off(1.0));
        let text = format!("is not the angle of the positions from {a} towards {b}: {off}");
        out.push(Suspicion::new(record, &angle.name, MistakeKind::Swapped, &[], text));
    }
}

/// Detects the reached position in place of the error: it has slope 1.
fn actual(record: &Record, p: &Column, e: &Column, out: &mut Vec<Suspicion>) -> bool {
    let Some((_, slope, left)) = line(&p.data, &e.data) else { return false };
    if distinct(&p.data) < 4 {
        return false;
    }
    for (per_mm, unit) in [(1.0, "mm"), (1000.0, "µm")] {
        if (slope / per_mm - 1.0).abs() < 2e-3 && left < 2e-3 * per_mm * range(&p.data) {
            let text =
                format!("follows {} one to one: the position reached in {unit}, not the error", p.name);
            out.push(Suspicion::new(record, &e.name, MistakeKind::Swapped, &[], text));
            return true;
        }
    }
    false
}

/// Sign of the movement into each row; `None` where the axis stays.
pub(super) fn moves(p: &[f64]) -> Vec<Option<f64>> {
    let sizes: Vec<f64> = steps(p).iter().map(|d| d.abs()).filter(|d| *d > 0.0).collect();
    let dead = 0.05 * median(sizes);
    let of = |i: usize| {
        let d = if i == 0 { 0.0 } else { p[i] - p[i - 1] };
        (d.abs() > dead).then(|| d.signum())
    };
    (0..p.len()).map(of).collect()
}

/// Share of the rows that move in the sign of `way`, and number of rows compared.
pub fn agreement(p: &[f64], way: &[f64]) -> (f64, usize) {
    let moves = moves(p);
    let rows = moves.iter().zip(way).filter(|(_, w)| **w != 0.0);
    let asked: Vec<bool> = rows.filter_map(|(m, w)| m.map(|m| m * w > 0.0)).collect();
    (asked.iter().filter(|a| **a).count() as f64 / asked.len().max(1) as f64, asked.len())
}

/// Values less the mean of the rows with the same sign of `way`.
fn beside_sides(v: &[f64], way: &[f64]) -> Vec<f64> {
    let mean = |up: bool| {
        let own = v.iter().zip(way).filter(|(_, w)| (**w > 0.0) == up);
        let (sum, n) = own.fold((0.0, 0.0), |(sum, n), (v, _)| (sum + v, n + 1.0));
        sum / f64::max(n, 1.0)
    };
    let means = [mean(false), mean(true)];
    v.iter().zip(way).map(|(v, w)| v - means[usize::from(*w > 0.0)]).collect()
}

/// Above this number of rows [`repeats`] compares a sample, to save time.
const ROWS_THAT_REPEAT: usize = 20_000;
/// Size of that sample.
const ROWS_DRAWN: usize = 4096;
/// Largest share of rows that may differ from those one period before.
const MAY_DIFFER: f64 = 0.03;

/// Whether a column repeats with a period and has at least five places.
fn repeats(v: &[f64]) -> bool {
    let n = v.len();
    let near = 5e-4 * range(v);
    let differs = |period: usize| {
        let rows = n - period;
        let other = |row: usize| (v[row + period] - v[row]).abs() > near;
        if n <= ROWS_THAT_REPEAT {
            let most = (MAY_DIFFER * rows as f64) as usize;
            return (0..rows).filter(|row| other(*row)).nth(most).is_some();
        }
        // One row of each stretch, at a pseudo-random place: evenly spaced rows may all be one place.
        let drawn = (0..ROWS_DRAWN).map(|k| {
            let dice = (k as u64).wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 33;
            let (from, to) = (k * rows / ROWS_DRAWN, (k + 1) * rows / ROWS_DRAWN);
            from + dice as usize % (to - from).max(1)
        });
        drawn.filter(|row| other(*row)).nth((MAY_DIFFER * ROWS_DRAWN as f64) as usize).is_some()
    };
    let round = (8..=n / 2).any(|period| !differs(period));
    // The values must be places: few, and farther apart than the tolerance.
    round && {
        let mut places = v.to_vec();
        places.sort_by(f64::total_cmp);
        places.dedup_by(|a, b| (*a - *b).abs() <= 2.0 * near);
        (5..=n / 2).contains(&places.len())
    }
}

/// Detects position and error in each other's column.
/// The error moves as a position does, and the position as an error.
fn exchanged(record: &Record, axis: &Axis, p: &Column, e: &Column, out: &mut Vec<Suspicion>) -> bool {
    let n = p.data.len();
    if n < 10 {
        return false;
    }
    let way = record.direction(axis).or_else(|| {
        record.data(&Role::Velocity(axis.clone())).filter(|_| record.kind == RunKind::Positioning)
    });
    let by_direction = way.is_some_and(|w| {
        let ((as_error, asked), (as_position, others)) = (agreement(&e.data, w), agreement(&p.data, w));
        // Reversal also makes an error move with the direction; within one direction only a position goes on.
        let (along, left) = agreement(&beside_sides(&e.data, w), w);
        asked.min(others).min(left) >= 10 && as_error.min(along) >= 0.95 && (0.2..=0.8).contains(&as_position)
    });
    let by_places = n >= 20 && repeats(&e.data) && !repeats(&p.data);
    let ramp = |v: &[f64]| {
        let d = steps(v);
        let usual = median(d.clone());
        usual != 0.0 && d.iter().all(|d| (d / usual - 1.0).abs() < 0.02)
    };
    let turns = steps(&p.data).windows(2).filter(|w| w[0] * w[1] < 0.0).count();
    let by_ramp = ramp(&e.data) && turns * 5 > n;
    if by_direction || by_places || by_ramp {
        let text = format!("moves as a position does, and {} as an error: the two look exchanged", p.name);
        out.push(Suspicion::new(record, &e.name, MistakeKind::Swapped, &[], text));
        return true;
    }
    false
}

/// Detects metres or micrometres called millimetres.
fn position_unit(record: &Record, p: &Column, out: &mut Vec<Suspicion>) {
    let [lo, hi] = span(&p.data);
    let farthest = lo.abs().max(hi.abs());
    let text = if farthest > LONGEST_MM {
        format!("goes to {farthest:.0} mm, which looks like micrometres")
    } else {
        // Few places within 3 mm: a scan of a fine period has more places.
        let sizes: Vec<f64> = steps(&p.data).iter().map(|d| d.abs()).filter(|d| *d > 0.0).collect();
        let near = 0.05 * median(sizes.clone());
        let mut places = p.data.clone();
        places.sort_by(f64::total_cmp);
        places.dedup_by(|a, b| (*a - *b).abs() <= near);
        let static_run = matches!(
            record.kind,
            RunKind::Positioning | RunKind::Plate | RunKind::FeedSweep | RunKind::Ballbar
        );
        let (size, pitch) = (range(&p.data), median(sizes));
        let few = places.len() <= 45 && pitch >= 1e-3 && record.kind != RunKind::FeedSweep;
        let quick = matches!(record.kind, RunKind::Ballbar) && size < 0.7;
        // In a positioning run one axis moves; others move by their own error or its correction.
        let is_measured = |a: &&Axis| record.column(&Role::Error((*a).clone())).is_some();
        let mut others =
            record.axes(Role::Position).filter(|a| Some(*a) != p.role.axis()).filter(is_measured);
        let follows = record.kind == RunKind::Positioning
            && others.any(|a| record.position(a).is_some_and(|q| range(q) > 100.0 * size));
        if follows || !(static_run && size > 0.01 && size < 3.0 && places.len() >= 5 && (few || quick)) {
            return;
        }
        format!("moves over {size:.3} mm only, which looks like metres")
    };
    out.push(Suspicion::new(record, &p.name, MistakeKind::Unit, &[], text));
}

/// Detects the positions of one axis in the column of another.
/// The logged direction or speed of an axis at rest agrees with the only axis that moves.
fn in_another_column(record: &Record, axes: &[Axis], out: &mut Vec<Suspicion>) {
    let place = |a: &Axis| record.column(&Role::Position(a.clone()));
    let moving: Vec<&Axis> = axes.iter().filter(|a| place(a).is_some_and(|p| range(&p.data) > 0.0)).collect();
    let [only] = moving[..] else { return };
    let Some(p) = place(only)
        .filter(|_| record.kind == RunKind::Positioning && record.direction_or_velocity(only).is_none())
    else {
        return;
    };
    let still = record.axes(Role::Direction).chain(record.axes(Role::Velocity)).find(|a| *a != only);
    let Some((axis, way)) = still.and_then(|a| Some((a, record.direction_or_velocity(a)?))) else { return };
    let (agree, asked) = agreement(&p.data, way);
    let both_ways = way.iter().any(|w| *w > 0.0) && way.iter().any(|w| *w < 0.0);
    if both_ways && asked >= 10 && agree >= 0.95 {
        let text = format!(
            "moves as {axis} is said to, which stands still: the positions of {axis}, in the column of {only}?"
        );
        out.push(Suspicion::new(record, &p.name, MistakeKind::Swapped, &[], text));
    }
}

/// Checks the direction of approach against the movement.
fn direction(record: &Record, axis: &Axis, p: &Column, out: &mut Vec<Suspicion>) {
    let Some(d) = record.column(&Role::Direction(axis.clone())) else { return };
    let n = d.data.len() as f64;
    let share = |of: &dyn Fn(f64) -> bool| d.data.iter().filter(|v| of(**v)).count() as f64 / n;
    let (agree, asked) = agreement(&p.data, &d.data);
    let moves = moves(&p.data);
    let moved = moves.iter().flatten().count() as f64;
    let at_zero = moves.iter().zip(&d.data).filter(|(_, d)| **d == 0.0);
    let at_zero: Vec<bool> = at_zero.filter_map(|(m, _)| Some((*m)? < 0.0)).collect();
    let down = at_zero.iter().filter(|down| **down).count();
    let ups = moves.iter().flatten().filter(|m| **m > 0.0).count() as f64;
    let downs = moved - ups;
    let one_sided = matches!(
        record.kind,
        RunKind::Positioning | RunKind::FeedSweep | RunKind::Ballbar | RunKind::Dynamics
    ) && ups >= 0.3 * moved
        && downs >= 0.3 * moved
        && moved >= 10.0;
    // Rows sorted by position do not show how each was approached.
    let is_sorted = p.data.is_sorted() || p.data.iter().rev().is_sorted();
    let zeros = share(&|v| v == 0.0);
    let is_one_sign = share(&|v| v > 0.0) == 0.0 || share(&|v| v < 0.0) == 0.0;
    let is_one_way = at_zero.len() >= 5 && (5 * down >= 4 * at_zero.len() || 5 * down <= at_zero.len());
    let text = if (0.25..1.0).contains(&zeros) && is_one_sign && is_one_way {
        "is 0 while the axis moves: it looks like 0 and 1 for -1 and +1".to_owned()
    } else if distinct(&d.data) == 1 && one_sided {
        format!("is {} in every row, yet {} moves both ways", d.data[0], p.name)
    } else if asked >= 10 && agree <= 0.12 && !is_sorted {
        "is opposite to the movement into each row".to_owned()
    } else {
        return;
    };
    out.push(Suspicion::new(record, &d.name, MistakeKind::Direction, &[], text));
}

/// Checks a logged speed against positions and times of a run sampled in motion.
fn speed(record: &Record, axis: &Axis, p: &Column, out: &mut Vec<Suspicion>) {
    let Some(v) = record.column(&Role::Velocity(axis.clone())) else { return };
    let Some(t) = record.column(&Role::Time) else { return };
    if !matches!(record.kind, RunKind::Ballbar | RunKind::Dynamics | RunKind::FeedSweep) || p.data.len() < 30
    {
        return;
    }
    let Some((ratio, r)) = per_second(&p.data, &t.data, &v.data) else { return };
    if r.abs() < 0.9 {
        return;
    }
    let of_speed = record
        .column(&Role::Acceleration(axis.clone()))
        .and_then(|a| per_second(&v.data, &t.data, &a.data).filter(|(_, r)| r.abs() > 0.9).map(|f| f.0));
    let about = |k: f64| (ratio.abs() / k - 1.0).abs() < 0.2;
    let in_ms = of_speed.is_some_and(|f| (f / 1e3 - 1.0).abs() < 0.2);
    let looks = [
        (about(1e3) && in_ms, t, "looks like milliseconds: speeds say so"),
        (
            about(1e3),
            p,
            "looks like metres (or the speed like µm/s, the time like ms): the two disagree by 1000",
        ),
        (about(1e-3), p, "looks like micrometres (or the speed like m/s): the two disagree by 1000"),
        (about(60.0), v, "looks like mm/min: it is 60 times what positions and times say"),
        (about(1.0 / 60.0), t, "looks like minutes (or the speed like m/s by 16.7): speeds say so"),
    ];
    let (column, what, text) = match looks.into_iter().find(|l| l.0) {
        Some((_, column, text)) => (column, MistakeKind::Unit, text),
        None if ratio < 0.0 && r < -0.9 => (v, MistakeKind::Sign, "has the sign opposite to the movement"),
        None => return,
    };
    out.push(Suspicion::new(record, &column.name, what, &[], text.to_owned()));
}

/// Median ratio of a logged rate to the slope of `x`, and their correlation.
fn per_second(x: &[f64], t: &[f64], rate: &[f64]) -> Option<(f64, f64)> {
    let at = 1..x.len() - 1;
    let slope = |i: usize| (x[i + 1] - x[i - 1]) / (t[i + 1] - t[i - 1]);
    let usual_s = median(steps(t));
    let rows: Vec<usize> =
        at.filter(|i| t[i + 1] > t[i - 1] && t[i + 1] - t[i - 1] < 4.0 * usual_s).collect();
    let (a, b): (Vec<f64>, Vec<f64>) = rows.iter().map(|i| (slope(*i), rate[*i])).unzip();
    if rows.len() < 20 || range(&a) <= 0.0 {
        return None;
    }
    let large = 0.3 * middle_range(&a);
    let ratios: Vec<f64> = a.iter().zip(&b).filter(|(a, _)| a.abs() > large).map(|(a, b)| b / a).collect();
    (ratios.len() >= 10).then(|| (median(ratios), correlation(&a, &b)))
}

/// Largest row-to-row noise of a machine's error, in counts.
const MOST_COUNTS: f64 = 20.0;

/// Detects millimetres called micrometres, and errors too large for a machine.
fn error_unit(record: &Record, e: &Column, out: &mut Vec<Suspicion>) {
    if e.data.len() < 8 || distinct(&e.data) < 3 {
        return;
    }
    let size = middle_range(&e.data);
    let q = quantum(&e.data);
    let multiples = |of: f64| {
        e.data.iter().all(|v| ((v / of) - (v / of).round()).abs() < 1e-3 * (v / of).abs().clamp(1.0, 100.0))
    };
    // Few thousandths of a count: a precise gauge has another resolution and noise of many steps.
    let noise =
        spread(&e.data.windows(3).map(|w| w[0] - 2.0 * w[1] + w[2]).collect::<Vec<_>>()) / 6_f64.sqrt();
    let counted = record.count_um.is_some_and(|count| {
        let small = count / 1000.0;
        size < 0.5 * count
            && (0.9..1.1).contains(&(q / small))
            && multiples(small)
            && range(&e.data) > 3.0 * small
            && noise < MOST_COUNTS * small
    });
    let driven = record.columns.iter().any(|c| matches!(c.role, Role::Velocity(_)));
    // Less than one count is too small in either unit. Most rows of a coarse gauge are equal, so its middle
    // range is 0.
    let tiny = size > 0.0 && size < 0.1 && record.count_um.is_none_or(|count| size < count);
    let text = if tiny || counted {
        format!("varies by {size:.2e} µm, which looks like millimetres")
    } else if size > 3000.0 && !driven {
        format!("varies by {size:.0} µm, which looks like another unit or another quantity")
    } else {
        return;
    };
    out.push(Suspicion::new(record, &e.name, MistakeKind::Unit, &[], text));
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A million rows: the cost must not grow with rows times periods.
    #[test]
    fn what_repeats_is_told_of_any_number_of_rows() {
        if !test_needs::long() {
            return;
        }
        let mut dice = 1_u64;
        let mut draw = || {
            dice = dice.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (dice >> 40) as f64
        };
        let mut noise: Vec<f64> = (0..1_000_000).map(|_| draw()).collect();
        assert!(!repeats(&noise));
        for i in 37..noise.len() {
            noise[i] = noise[i - 37];
        }
        assert!(repeats(&noise) && repeats(&noise[..400]));
        // Rows that repeat only at first do not count.
        let mut first_only = noise.clone();
        first_only[30_000..].iter_mut().for_each(|v| *v = draw());
        assert!(!repeats(&first_only));
        // One differing row in 150 is tolerated, one in 20 is not.
        let spoilt = |every: usize| -> Vec<f64> {
            let of = |(i, v): (usize, &f64)| if i % every == 0 { -v - 1e8 } else { *v };
            noise[..400].iter().enumerate().map(of).collect()
        };
        assert!(repeats(&spoilt(150)) && !repeats(&spoilt(20)));
    }
}
