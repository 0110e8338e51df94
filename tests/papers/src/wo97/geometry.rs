//! Tables 1 to 3: circles, linear displacement, tool changes.

use super::{AXES, INCH_UM, column, error_of, of_axis, record};
use crate::rows::Agreement::Within;
use crate::rows::Rows;
use rtec_model::record::{Record, Role};
use rtec_sim::compensation_experiments::ExperimentResult;

/// Table 1, inches ·10⁻⁴: plane, feed, total error clockwise and counter-clockwise, reversal error likewise.
type Circle = ((usize, usize), u32, [Option<f64>; 2], [Option<f64>; 2]);
const TABLE_1: [Circle; 9] = [
    ((0, 1), 10, [Some(9.0), Some(8.0)], [Some(3.0), Some(1.0)]),
    ((0, 1), 50, [Some(9.0), Some(12.0)], [Some(2.0), Some(2.0)]),
    ((0, 1), 100, [Some(11.0), Some(20.0)], [Some(2.0), Some(3.0)]),
    ((1, 2), 10, [Some(13.0), Some(11.0)], [Some(2.0), Some(1.0)]),
    ((1, 2), 50, [Some(15.0), Some(11.0)], [Some(8.0), Some(2.0)]),
    ((1, 2), 100, [Some(24.0), Some(18.0)], [Some(18.0), Some(3.0)]),
    ((2, 0), 10, [Some(6.0), Some(7.0)], [Some(2.0), None]),
    ((2, 0), 50, [None, Some(10.0)], [None, Some(2.0)]),
    ((2, 0), 100, [Some(17.0), Some(14.0)], [Some(9.0), Some(1.0)]),
];

/// Table 1: total error of each circle, largest minus smallest radial deviation about its own centre; and the largest step
/// of either axis where it turns.
pub(super) fn circles(rows: &mut Rows, found: &ExperimentResult) {
    let names = ["x", "y", "z"];
    let each = || {
        TABLE_1.iter().flat_map(|circle| {
            let ((i, j), inches, ..) = *circle;
            let record = record(found, &format!("ballbar-{}{}-{inches}", names[i], names[j])).ok();
            // Clockwise is the second cycle of the experiment.
            record.into_iter().flat_map(move |r| [(circle, r, 0, "CW", 2.0), (circle, r, 1, "CCW", 1.0)])
        })
    };
    for (&((i, j), inches, totals, _), record, k, way, cycle) in each() {
        let (angles, n) = (column(record, &Role::Angle), column(record, &Role::Cycle));
        let (a, b) = (error_of(record, i), error_of(record, j));
        let radial: Vec<(f64, f64)> = (0..angles.len())
            .filter(|row| (n[*row] - cycle).abs() < 0.5)
            .map(|row| (angles[row], a[row] * angles[row].cos() + b[row] * angles[row].sin()))
            .collect();
        let inch = about_its_centre(&radial) / INCH_UM;
        let what = format!("{}{} {way}, {inches} in/min: total error", AXES[i], AXES[j]);
        let why = "squareness, scale, reversal and following errors of the machine file are fitted to this column by six numbers; its \
                   circles have no vibration, and their radius is ours (150 mm)";
        // Figures that the scan has lost are left out.
        if let Some(says) = totals[k] {
            rows.fitted().number(("Table 1", &what, "in"), says * 1e-4, inch, Within(0.0006), why);
        }
    }
    for (&((i, j), inches, _, reversals), record, k, way, cycle) in each() {
        let inch = reversal(record, i, cycle).max(reversal(record, j, cycle)) / INCH_UM;
        let what = format!("{}{} {way}, {inches} in/min: largest reversal error", AXES[i], AXES[j]);
        let why = "the machine file's reversal is the same at every speed. On the real machine that of Z grew ninefold clockwise and \
                   hardly counter-clockwise. A reversal that grows with the speed grows both ways, as the run of the last rows shows";
        // Figures that the scan has lost are left out.
        if let Some(says) = reversals[k] {
            rows.number(("Table 1", &what, "in"), says * 1e-4, inch, Within(0.0004), why);
        }
    }
}

/// The reversal error of Z that table 1 has clockwise at 100 in/min, µm.
pub(super) const GROWN_UM: f64 = 18e-4 * INCH_UM;

/// The circles of a machine whose reversal of Z has grown to [`GROWN_UM`].
/// They show what a reversal that grows with the speed does.
pub(super) fn grown_reversal(rows: &mut Rows, found: &ExperimentResult) {
    let Ok(record) = record(found, "ballbar-yz-100") else { return };
    for (way, cycle, says) in [("CW", 2.0, 18.0), ("CCW", 1.0, 3.0)] {
        // Clockwise is what was set.
        let rows = if way == "CW" { rows.given() } else { &mut *rows };
        let table = "Table 1, run with a reversal of Z of 0.0018 in";
        let what = format!("YZ {way}, 100 in/min: largest reversal error");
        let inch = reversal(record, 1, cycle).max(reversal(record, 2, cycle)) / INCH_UM;
        let why = "a reversal turns the axis back by as much whichever way the circle is run, so growth with the speed cannot give both \
                   columns. What acts one way round alone is the servo's, and the patent says nothing of it";
        rows.number((table, &what, "in"), says * 1e-4, inch, Within(0.0004), why);
    }
}

/// Largest minus smallest of radial deviations, their first harmonic (the circle's centre) taken out.
fn about_its_centre(radial: &[(f64, f64)]) -> f64 {
    let n = radial.len().max(1) as f64;
    let mean = radial.iter().map(|r| r.1).sum::<f64>() / n;
    let of = |f: fn(f64) -> f64| radial.iter().map(|(a, e)| 2.0 * (e - mean) * f(*a)).sum::<f64>() / n;
    let (c, s) = (of(f64::cos), of(f64::sin));
    let left = radial.iter().map(|(a, e)| e - mean - c * a.cos() - s * a.sin());
    let (lo, hi) = left.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), e| (lo.min(e), hi.max(e)));
    (hi - lo).max(0.0)
}

/// The step of an axis' own error where it turns, µm: between the rows a few degrees before and after. The first and the last
/// degrees speed up and slow down.
fn reversal(record: &Record, axis: usize, cycle: f64) -> f64 {
    let (error, n) = (error_of(record, axis), column(record, &Role::Cycle));
    let direction = of_axis(record, Role::Direction, axis);
    if direction.is_empty() {
        return 0.0;
    }
    let own: Vec<usize> = (0..error.len()).filter(|k| (n[*k] - cycle).abs() < 0.5).collect();
    let steady = own.get(8..own.len().saturating_sub(8)).unwrap_or_default();
    let mean = |r: std::ops::Range<usize>| error[r.clone()].iter().sum::<f64>() / r.len() as f64;
    let turns = steady.iter().filter(|k| direction[**k] * direction[**k - 1] < 0.0);
    turns.map(|k| (mean(k + 1..k + 3) - mean(k - 3..k - 1)).abs()).fold(0.0, f64::max)
}

/// Table 2: the mean of both directions over the travel, and what sets the directions apart.
pub(super) fn displacement(rows: &mut Rows, found: &ExperimentResult) -> [f64; 3] {
    let mut scales = [0.0; 3];
    for (p, (scale, reversal)) in
        [(0.0013, 0.0004), (0.0006, 0.0002), (0.0027, 0.0003)].into_iter().enumerate()
    {
        let Ok(record) = record(found, &format!("linear-displacement-{}", ["x", "y", "z"][p])) else {
            continue;
        };
        let (place, direction) = (of_axis(record, Role::Position, p), of_axis(record, Role::Direction, p));
        let error = error_of(record, p);
        // Targets in order: their mean by direction.
        let mut targets: Vec<f64> = place.iter().map(|v| v.round()).collect();
        targets.sort_by(f64::total_cmp);
        targets.dedup();
        let mean = |t: f64, up: bool| {
            let own: Vec<f64> = (0..error.len())
                .filter(|k| (place[*k].round() - t).abs() < 1.5 && (direction[*k] > 0.0) == up)
                .map(|k| error[k])
                .collect();
            own.iter().sum::<f64>() / own.len().max(1) as f64
        };
        let both: Vec<[f64; 2]> = targets.iter().map(|t| [mean(*t, true), mean(*t, false)]).collect();
        let first = both.first().map_or(0.0, |b| b[0]);
        let um = both.iter().flatten().map(|e| (e - first).abs()).fold(0.0, f64::max);
        let apart = both.iter().map(|[u, d]| (u - d).abs()).sum::<f64>() / both.len().max(1) as f64;
        scales[p] = um;
        let what = format!("{} axis: largest scale error", AXES[p]);
        let why = "over 95 % of the travel, from its first target; the error is put in as a straight line";
        rows.given().number(("Table 2", &what, "in"), scale, um / INCH_UM, Within(0.0003), why);
        let what = format!("{} axis: reversal error", AXES[p]);
        let why = "the mean over the targets";
        rows.given().number(("Table 2", &what, "in"), reversal, apart / INCH_UM, Within(0.0001), why);
    }
    scales
}

/// Table 3: ten tool changes, inches ·10⁻⁴, X, Y and Z (below a ten-thousandth: 0.5).
const TABLE_3: [[f64; 3]; 10] = [
    [0.0, 0.0, 0.0],
    [-4.0, 1.0, 0.5],
    [-3.0, 2.0, 0.5],
    [-2.0, 2.0, 0.5],
    [-2.0, 3.0, 0.5],
    [-3.0, 2.0, 0.5],
    [-3.0, 3.0, 2.0],
    [-2.0, 3.0, 0.5],
    [-4.0, 3.0, 0.5],
    [-4.0, 4.0, 0.5],
];

pub(super) fn tool_changes(rows: &mut Rows, found: &ExperimentResult) -> [f64; 3] {
    let mut largest = [0.0; 3];
    let Ok(record) = record(found, "tool-change-repeatability") else { return largest };
    for p in 0..3 {
        let error = error_of(record, p);
        let ours: Vec<f64> = error.iter().map(|e| (e - error[0]) / INCH_UM).collect();
        for (run, says) in TABLE_3.iter().enumerate() {
            let gets = ours.get(run).copied().unwrap_or(0.0);
            // The others are measured from the first run.
            let rows = if run == 0 { rows.given() } else { &mut *rows };
            let what = format!("run {}, {} axis", run + 1, AXES[p]);
            let why = "how one holder seats once; here 1.2 µm of chance and the reversals of the way back, there a shift after the first \
                change as well";
            rows.number(("Table 3 and figure 6", &what, "in"), says[p] * 1e-4, gets, Within(0.0006), why);
        }
        largest[p] = ours.iter().map(|e| e.abs()).fold(0.0, f64::max) * INCH_UM;
    }
    largest
}
