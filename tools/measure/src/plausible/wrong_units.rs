//! Minutes or hours called seconds and inches called millimetres, in one record.

use super::robust_stats::{distinct, median, range};
use super::{MistakeKind, Suspicion};
use crate::iso230::{FittedCircle, line};
use rtec_model::record::{Axis, Column, Record, Role, RunKind};
use std::collections::VecDeque;

/// Shortest time in which a body warms through half its range, s.
/// A bearing's ring takes a minute.
const HALF_WARM_S: f64 = 20.0;
/// Below this time the unit is hours rather than minutes, s.
const HOURS_S: f64 = 0.7;
/// Smallest range of a temperature that tells anything of time, K.
const MOVES_K: f64 = 2.0;
const MM_PER_INCH: f64 = 25.4;

pub(super) fn look(record: &Record, out: &mut Vec<Suspicion>) {
    heat(record, out);
    circle(record, out);
    bar(record, out);
    for axis in record.axes(Role::Position).cloned().collect::<Vec<_>>() {
        inches(record, &axis, out);
    }
    exchanged(record, out);
}

/// Largest scale error over the travel, ppm: the bound in the effect dictionary.
const STEEPEST_PPM: f64 = 1000.0;
/// Shortest bar, mm.
const SHORTEST_BAR_MM: f64 = 20.0;

/// Detects a bar's length in inches: too short, and whole centimetres if converted.
fn bar(record: &Record, out: &mut Vec<Suspicion>) {
    let Some(circle) = record.circle() else { return small_circle(record, out) };
    let mm = circle.radius_mm * MM_PER_INCH;
    if circle.radius_mm < SHORTEST_BAR_MM && (mm / 10.0 - (mm / 10.0).round()).abs() < 0.01 {
        let name = record.column(&Role::Angle).map_or("", |c| c.name.as_str());
        let radius = circle.radius_mm;
        let text = format!("radius_mm = {radius} is shorter than any bar and looks like inches: {mm:.0} mm");
        out.push(Suspicion::new(record, name, MistakeKind::Unit, &[], text));
    }
}

/// Detects a circle in inches if the record names no bar.
/// It is smaller than any bar's circle, has no round radius, and is whole centimetres once converted.
fn small_circle(record: &Record, out: &mut Vec<Suspicion>) {
    let moves = |c: &&Column| matches!(c.role, Role::Position(_)) && range(&c.data) > 0.0;
    let moving: Vec<&Column> = record.columns.iter().filter(moves).collect();
    let [a, b] = moving[..] else { return };
    let round =
        FittedCircle::through(&a.data, &b.data).filter(|r| record.kind == RunKind::Ballbar && r.is_met());
    let Some(FittedCircle { radius, .. }) = round.filter(|r| r.radius < SHORTEST_BAR_MM) else { return };
    let whole = |mm: f64, of: f64| (mm / of - (mm / of).round()).abs() * of < OFF_RADIUS * mm;
    let inches = radius * MM_PER_INCH;
    if whole(inches, 10.0) && !whole(radius, 0.5) {
        let text = format!(
            "runs on a circle of {radius:.4} mm radius, smaller than any bar's and of {inches:.0} mm if it were inches"
        );
        for c in [a, b] {
            out.push(Suspicion::new(record, &c.name, MistakeKind::Unit, &[], text.clone()));
        }
    }
}

/// Largest share by which an axis's position errors change a circle's radius.
const OFF_RADIUS: f64 = 5e-4;

/// Detects targets in inches.
/// They are whole millimetres once converted, or an error along them is steeper than any scale's.
fn inches(record: &Record, axis: &Axis, out: &mut Vec<Suspicion>) {
    let Some(p) = record.column(&Role::Position(axis.clone())) else { return };
    let travel = range(&p.data);
    // On a plate the residual of the line also holds the other axis's squareness and rotation.
    let (fewest, left_share, shortest_mm) = match record.kind {
        RunKind::Positioning => (5, 0.1, 5.0),
        RunKind::Plate => (3, 0.3, 3.0),
        _ => return,
    };
    if travel < shortest_mm || distinct(&p.data) < fewest || out.iter().any(|s| s.is_of(record, p)) {
        return;
    }
    let whole = |per: f64| {
        let off = |v: &f64| (v * per - (v * per).round()).abs();
        p.data.iter().map(off).fold(0.0, f64::max)
    };
    let steep =
        record.column(&Role::Error(axis.clone())).and_then(|e| line(&p.data, &e.data).map(|l| (e, l)));
    let steep = steep.filter(|(e, (_, slope, left))| {
        slope.abs() * 1000.0 > STEEPEST_PPM
            && *left < left_share * range(&e.data)
            && !(record.kind == RunKind::Plate && drifts(&e.data, *left))
    });
    let text = if whole(MM_PER_INCH) < 0.004 && whole(1.0) > 0.1 {
        format!("{travel:.3} mm of travel, whole millimetres if it were inches")
    } else if let Some((e, (_, slope, _))) = steep {
        let ppm = slope * 1000.0;
        format!("{} runs along it by {ppm:.0} ppm, more than any scale's: it looks like inches", e.name)
    } else {
        return;
    };
    out.push(Suspicion::new(record, &p.name, MistakeKind::Unit, &[], text));
}

/// Residual ratio (over rows / over positions) below which a slope may be drift.
const AS_WELL: f64 = 1.5;

/// Whether an error may depend on time as well as on the position.
/// On a plate one of the axes crosses only once, and the machine may warm meanwhile. `left` is the residual
/// of the line over the positions.
fn drifts(e: &[f64], left: f64) -> bool {
    let rows: Vec<f64> = (0..e.len()).map(|i| i as f64).collect();
    line(&rows, e).is_some_and(|(_, _, over_time)| over_time < AS_WELL * left)
}

/// Detects a temperature and an error in each other's column.
/// The error begins at room temperature, and the sensor at the zero of a gauge.
fn exchanged(record: &Record, out: &mut Vec<Suspicion>) {
    if record.kind != RunKind::Drift || record.rows() < 20 {
        return;
    }
    let sensors: Vec<&Column> = record.temperatures().collect();
    let cold: Vec<&&Column> = sensors.iter().filter(|c| c.data[0].abs() < 5.0).collect();
    let [sensor] = cold[..] else { return };
    let others: Vec<f64> = sensors.iter().filter(|c| c.name != sensor.name).map(|c| c.data[0]).collect();
    let hall = if others.is_empty() { 21.0 } else { median(others) };
    let warm = |e: &&Column| {
        let lowest = e.data.iter().copied().fold(f64::INFINITY, f64::min);
        (12.0..=35.0).contains(&hall) && (e.data[0] - hall).abs() < 6.0 && lowest > 5.0
    };
    let errors: Vec<&Column> = record.responses().filter(|c| matches!(c.role, Role::Error(_))).collect();
    let taken: Vec<&&Column> = errors.iter().filter(|e| warm(e)).collect();
    if let [error] = taken[..] {
        let (own, name, cold) = (error.data[0], &sensor.name, sensor.data[0]);
        let text = format!("begins at {own:.2} where {name} begins at {cold:.2}: the two look exchanged");
        out.push(Suspicion::new(record, &error.name, MistakeKind::Swapped, &[], text));
    }
}

/// Detects temperatures of a drift test that change faster than a machine warms.
fn heat(record: &Record, out: &mut Vec<Suspicion>) {
    let Some(t) = record.column(&Role::Time).filter(|t| record.kind == RunKind::Drift && t.data.len() >= 20)
    else {
        return;
    };
    let temperatures = record.temperatures();
    let halves: Vec<f64> = temperatures.filter_map(|c| half_warm(&t.data, c)).collect();
    if halves.len() < 2 {
        return;
    }
    let half = median(halves);
    if half > 0.0 && half < HALF_WARM_S && !out.iter().any(|s| s.is_of(record, t)) {
        let unit = if half < HOURS_S { "hours" } else { "minutes" };
        let text = format!(
            "temperatures go half their way in {half:.2} s, faster than a machine warms, which looks like {unit}"
        );
        out.push(Suspicion::new(record, &t.name, MistakeKind::Unit, &[], text));
    }
}

/// Shortest time in which a smooth sensor goes through half its range, s.
/// `None` if it moves by less than [`MOVES_K`] or jumps.
fn half_warm(t: &[f64], c: &Column) -> Option<f64> {
    let size = range(&c.data);
    if size < MOVES_K {
        return None;
    }
    // Large steps are a jump or a loose contact.
    let largest = c.data.windows(2).map(|w| (w[1] - w[0]).abs()).fold(0.0, f64::max);
    if largest > 0.2 * size { None } else { shortest_window(t, &c.data, size / 2.0) }
}

/// Shortest time in which the values differ by `apart`.
/// Sliding window: each queue keeps the rows that can still be its highest or its lowest.
fn shortest_window(t: &[f64], data: &[f64], apart: f64) -> Option<f64> {
    let mut shortest = f64::INFINITY;
    let (mut highest, mut lowest) = (VecDeque::<usize>::new(), VecDeque::<usize>::new());
    for (j, &v) in data.iter().enumerate().filter(|(_, v)| v.is_finite()) {
        while highest.back().is_some_and(|&k| data[k] <= v) {
            highest.pop_back();
        }
        while lowest.back().is_some_and(|&k| data[k] >= v) {
            lowest.pop_back();
        }
        highest.push_back(j);
        lowest.push_back(j);
        while let (Some(&high), Some(&low)) = (highest.front(), lowest.front())
            && data[high] - data[low] >= apart
        {
            // One of the two is this row; the other leaves the window.
            let first = high.min(low);
            shortest = shortest.min(t[j] - t[first]);
            for rows in [&mut highest, &mut lowest] {
                while rows.front().is_some_and(|&k| k <= first) {
                    rows.pop_front();
                }
            }
        }
    }
    shortest.is_finite().then_some(shortest)
}

/// Checks the radius of the positions' circle against `radius_mm` of the sidecar.
fn circle(record: &Record, out: &mut Vec<Suspicion>) {
    let Some(circle) = record.circle() else { return };
    let [Some(a), Some(b)] = circle.plane.each_ref().map(|axis| record.column(&Role::Position(axis.clone())))
    else {
        return;
    };
    let Some(round) = FittedCircle::through(&a.data, &b.data).filter(FittedCircle::is_met) else { return };
    let times = circle.radius_mm / round.radius;
    let is = |of: f64| (times / of - 1.0).abs() < OTHER_RADIUS;
    if is(1.0) {
        return;
    }
    let others = [
        (MM_PER_INCH, ": the positions look like inches"),
        (1.0 / MM_PER_INCH, ": radius_mm looks like inches"),
        (2.0, ": radius_mm looks like the diameter"),
    ];
    let looks = others.into_iter().find(|(of, _)| is(*of)).map_or("", |(_, looks)| looks);
    let (radius, stated) = (round.radius, circle.radius_mm);
    let text = format!("runs on a circle of {radius:.3} mm radius, and radius_mm is {stated}{looks}");
    for column in [a, b] {
        out.push(Suspicion::new(record, &column.name, MistakeKind::Unit, &[], text.clone()));
    }
}

/// Relative deviation above which the radius is of another circle.
const OTHER_RADIUS: f64 = 0.03;

#[cfg(test)]
mod tests {
    use super::shortest_window;
    use proptest::prelude::*;

    proptest! {
        /// The same as comparing every pair of rows.
        #[test]
        fn the_shortest_window_is_that_of_all_pairs(
            steps in prop::collection::vec((0_u8..4, -3_i8..=3), 1..60),
            apart in 1_u8..9,
        ) {
            let (mut t, mut data, mut at, mut v) = (vec![], vec![], 0.0, 0.0);
            for (dt, dv) in steps {
                at += f64::from(dt);
                v += f64::from(dv);
                t.push(at);
                data.push(v);
            }
            let apart = f64::from(apart);
            let pairs = (0..t.len()).flat_map(|i| (i..t.len()).map(move |j| (i, j)));
            let plain = pairs.filter(|&(i, j)| (data[j] - data[i]).abs() >= apart).map(|(i, j)| t[j] - t[i]);
            prop_assert_eq!(shortest_window(&t, &data, apart), plain.reduce(f64::min));
        }
    }
}
