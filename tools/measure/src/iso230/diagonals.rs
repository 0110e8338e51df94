//! Body and face diagonals, ISO 230-6.
//! Axes move together along the diagonals of a box. Each diagonal has the figures of ISO 230-2; their
//! differences give squareness.

use super::{PositioningOptions, PositioningResult, error_axes, lacks, moments, positioning_with};
use rtec_files::Result;
use rtec_model::record::{Axis, Column, Record, Role, RunKind, mean, span};
use serde::Serialize;
use std::collections::BTreeMap;

/// One diagonal.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DiagonalResult {
    /// File name of its record.
    pub record: String,
    /// Axes that move.
    pub axes: Vec<String>,
    /// Direction of each axis along it, P or N, the last one positive: `PPP`, `NPP`.
    pub sense: String,
    /// Travel of each axis, mm.
    pub box_mm: Vec<f64>,
    /// Change of the mean error from end to end by the straight line through it, µm.
    pub slope_um: f64,
    /// Standard error of that change, µm; `None` for two targets.
    /// It assumes random residuals from the line.
    pub slope_standard_error_um: Option<f64>,
    /// An assumption about the sign of the error.
    #[serde(skip)]
    pub assumed: Option<String>,
    /// The figures along it.
    #[serde(flatten)]
    pub along: PositioningResult,
}

/// The diagonals of a box, or of its faces.
/// Values in µm unless named otherwise.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DiagonalTestResult {
    /// `body` or `face`.
    pub kind: &'static str,
    /// Diagonal systematic deviation: the largest E of the diagonals.
    #[serde(rename = "E_d")]
    pub e_d: Option<f64>,
    /// Diagonal accuracy: the largest A of the diagonals.
    #[serde(rename = "A_d")]
    pub a_d: Option<f64>,
    /// Diagonal reversal: the largest B of the diagonals.
    #[serde(rename = "B_d")]
    pub b_d: Option<f64>,
    /// Squareness per pair of axes, µrad, as `squareness.A.B`.
    /// Present if all diagonals of the box or face are.
    pub squareness_urad: BTreeMap<String, f64>,
    /// Their standard errors, µrad.
    pub squareness_standard_error_urad: BTreeMap<String, Option<f64>>,
    /// Mean scale along the diagonals, ppm.
    pub scale_ppm: f64,
    /// Its standard error, ppm.
    pub scale_standard_error_ppm: Option<f64>,
    /// Each diagonal.
    pub diagonals: Vec<DiagonalResult>,
    /// Warnings about its use.
    pub warnings: Vec<String>,
}

/// Evaluates diagonals of a box or of faces, one record each.
/// A record needs positions of the axes that move. It also needs the error along the diagonal (`error.d`, or
/// any name but x, y and z without a position), or the errors of all its axes.
///
/// # Errors
/// A record that is no straight line of two or three axes, or has no error along it; face and body diagonals
/// mixed; what [`positioning_with`] finds.
pub fn diagonals(records: &[Record], options: &PositioningOptions) -> Result<DiagonalTestResult> {
    let all = records.iter().map(|r| diagonal(r, options)).collect::<Result<Vec<_>, _>>()?;
    let first = all.first().map_or(0, |d| d.axes.len());
    if let Some((odd, r)) = all.iter().zip(records).find(|(d, _)| d.axes.len() != first) {
        let found = format!("a diagonal of {} axes beside those of {first}", odd.axes.len());
        return Err(lacks(r, &found, "diagonals of one box, or of faces"));
    }
    let largest =
        |of: fn(&PositioningResult) -> Option<f64>| all.iter().filter_map(|d| of(&d.along)).reduce(f64::max);
    let mut warnings = Vec::new();
    let (squareness_urad, squareness_standard_error_urad) = squareness(&all);
    if squareness_urad.is_empty() {
        let all = if first == 3 { "all four body diagonals" } else { "both diagonals of a face" };
        warnings.push(format!("no squareness: it takes {all} of one box"));
    }
    let scale_error = |d: &DiagonalResult| Some(d.slope_standard_error_um? / d.along.travel_mm * 1000.0);
    let scales: Vec<f64> = all.iter().map(|d| d.slope_um / d.along.travel_mm * 1000.0).collect();
    for d in &all {
        warnings.extend(d.assumed.iter().map(|a| format!("{}: {a}", d.sense)));
        for w in &d.along.warnings {
            // A warning that holds for all diagonals appears once.
            let common = all.iter().all(|o| o.along.warnings.contains(w));
            let words = if common { w.clone() } else { format!("{}: {w}", d.sense) };
            if !warnings.contains(&words) {
                warnings.push(words);
            }
        }
    }
    Ok(DiagonalTestResult {
        kind: if first == 3 { "body" } else { "face" },
        e_d: largest(|p| p.E),
        a_d: largest(|p| p.A),
        b_d: largest(|p| p.B),
        squareness_urad,
        squareness_standard_error_urad,
        scale_standard_error_ppm: standard_error_of_mean(all.iter().map(scale_error)),
        scale_ppm: scales.iter().sum::<f64>() / scales.len().max(1) as f64,
        diagonals: all,
        warnings,
    })
}

fn diagonal(record: &Record, options: &PositioningOptions) -> Result<DiagonalResult> {
    let travel = |a| {
        let p = record.position(a)?;
        let [lo, hi] = span(p);
        (hi - lo > 1e-3).then_some((a, p, hi - lo))
    };
    let moving: Vec<(&Axis, &[f64], f64)> = record.axes(Role::Position).filter_map(travel).collect();
    if !(2..=3).contains(&moving.len()) {
        let names: Vec<&str> = moving.iter().map(|m| m.0.as_str()).collect();
        let found = format!("{} moving axes ({})", moving.len(), names.join(", "));
        return Err(lacks(record, &found, "a diagonal: positions of two or three axes that move together"));
    }
    let length_mm = moving.iter().map(|m| m.2 * m.2).sum::<f64>().sqrt();
    // Whether each axis rises or falls with the last one.
    let last = moving[moving.len() - 1].1;
    let [lo, hi] = span(last);
    let share = |row: usize| (last[row] - lo) / (hi - lo);
    let mut unit: Vec<f64> = Vec::new();
    for (axis, p, travel) in &moving {
        let [low, high] = span(*p);
        let off = |from: f64, way: f64| {
            (0..p.len()).map(|row| (p[row] - from - way * travel * share(row)).abs()).fold(0.0, f64::max)
        };
        let way = if off(low, 1.0) <= off(high, -1.0) { 1.0 } else { -1.0 };
        let from = if way > 0.0 { low } else { high };
        if off(from, way) > 1e-3 * length_mm {
            let found = format!("position.{axis} that does not go in proportion to the others");
            return Err(lacks(record, &found, "positions along one straight line"));
        }
        unit.push(way * travel / length_mm);
    }
    let along: Vec<f64> = (0..record.rows()).map(|r| share(r) * length_mm).collect();
    let errors = error_axes(record);
    // A machine axis at rest is across the diagonal, not along it.
    let across = |a: &Axis| {
        ["x", "y", "z"].contains(&a.as_str()) || record.column(&Role::Position(a.clone())).is_some()
    };
    let own = errors.iter().find(|(a, _)| !across(a));
    // A device on the diagonal has its own positive direction, from its position or direction, or unknown.
    let sense = own.and_then(|(a, _)| sense(record, a, &along));
    let from_far = along.iter().find(|s| (**s - length_mm / 2.0).abs() > length_mm / 4.0);
    let assumed = own.filter(|_| sense.is_none() && from_far.is_some_and(|s| *s > length_mm / 2.0)).map(|(a, _)| {
        let axis = moving[moving.len() - 1].0;
        format!(
            "error.{a} is taken as positive with {axis}, although the run begins at its other end; where the device counts from \
             there, give direction.{a}"
        )
    });
    let error: Vec<f64> = if let Some((_, e)) = own {
        e.iter().map(|v| v * sense.unwrap_or(1.0)).collect()
    } else {
        let of = |a: &Axis| errors.iter().find(|(b, _)| *b == a).map(|(_, e)| *e);
        let all: Option<Vec<&[f64]>> = moving.iter().map(|m| of(m.0)).collect();
        let expected = "a column error.d, or the errors of all axes that move";
        let all = all.ok_or_else(|| lacks(record, "no error along the diagonal", expected))?;
        (0..record.rows()).map(|r| all.iter().zip(&unit).map(|(e, u)| e[r] * u).sum()).collect()
    };
    let direction = direction(record, own.map(|o| (o.0, sense.unwrap_or(1.0))), &moving, &unit);
    let expected = "a column direction.d, or the direction of one of its axes";
    let direction = direction.ok_or_else(|| lacks(record, "no direction of approach", expected))?;
    let d =
        own.map(|o| o.0.clone()).or_else(|| Axis::new("d")).ok_or_else(|| lacks(record, "no axis", "one"))?;
    let mut columns = vec![
        Column::new("position along the diagonal", Role::Position(d.clone()), along.clone()),
        Column::new("direction along the diagonal", Role::Direction(d.clone()), direction),
        Column::new("error along the diagonal", Role::Error(d), error.clone()),
    ];
    columns.extend(record.temperatures().cloned());
    let line = Record::of_checked(&record.path, RunKind::Positioning, columns);
    let along_it = positioning_with(&line, options)?;
    let along_it = along_it.into_iter().next().ok_or_else(|| lacks(record, "no error", "an error"))?;
    Ok(DiagonalResult {
        record: record.path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned()),
        axes: moving.iter().map(|m| m.0.to_string()).collect(),
        sense: unit.iter().map(|u| if *u > 0.0 { 'P' } else { 'N' }).collect(),
        assumed,
        box_mm: moving.iter().map(|m| m.2).collect(),
        slope_um: slope(&along_it).0 * along_it.travel_mm,
        slope_standard_error_um: slope(&along_it).1.map(|error| error * along_it.travel_mm),
        along: along_it,
    })
}

/// The device's direction along the diagonal: +1 with the last axis, or −1.
/// `None` without a direction column, or if the rows are not in order of movement: then both directions occur
/// under each sense.
fn sense(record: &Record, own: &Axis, along: &[f64]) -> Option<f64> {
    let way = record.direction_or_velocity(own)?;
    let step = |i: usize| along[i] - along[i - 1];
    let mean = |rising: bool| -> Option<f64> {
        let rows: Vec<usize> =
            (1..along.len()).filter(|i| if rising { step(*i) > 1e-3 } else { step(*i) < -1e-3 }).collect();
        let sum: f64 = rows.iter().map(|i| rtec_model::effect::sign(way[*i])).sum();
        (!rows.is_empty()).then(|| sum / rows.len() as f64)
    };
    let (up, down) = (mean(true)?, mean(false)?);
    (up.abs().min(down.abs()) > ORDERLY && up * down < 0.0).then(|| up.signum())
}

/// Least excess of rows with one direction, among rows moving one way.
const ORDERLY: f64 = 0.8;

/// Direction along the diagonal, from its own column or a moving axis's.
/// Its own column uses the device's direction.
fn direction(
    record: &Record,
    own: Option<(&Axis, f64)>,
    moving: &[(&Axis, &[f64], f64)],
    unit: &[f64],
) -> Option<Vec<f64>> {
    let turned = |(a, sense): (&Axis, f64)| -> Option<Vec<f64>> {
        Some(record.direction_or_velocity(a)?.iter().map(|v| rtec_model::effect::sign(*v) * sense).collect())
    };
    let of_axis = || moving.iter().zip(unit).find_map(|((a, ..), u)| turned((a, u.signum())));
    own.and_then(turned).or_else(of_axis)
}

/// Standard error of the mean of values with these standard errors.
fn standard_error_of_mean(errors: impl ExactSizeIterator<Item = Option<f64>>) -> Option<f64> {
    let n = errors.len() as f64;
    let squares: Option<f64> = errors.map(|error| Some(error?.powi(2))).sum();
    Some(squares?.sqrt() / n)
}

/// Slope of the mean error over the targets, µm/mm, and its standard error.
/// The error needs more than two targets.
fn slope(p: &PositioningResult) -> (f64, Option<f64>) {
    let (x, y): (Vec<f64>, Vec<f64>) = p.means().unzip();
    let [xx, xy, _] = moments(&x, &y);
    if xx <= 0.0 {
        return (0.0, None);
    }
    let (slope, mx, my, n) = (xy / xx, mean(&x), mean(&y), x.len() as f64);
    let left: f64 = x.iter().zip(&y).map(|(x, y)| (y - my - slope * (x - mx)).powi(2)).sum();
    (slope, (n > 2.0).then(|| (left / (n - 2.0) / xx).sqrt()))
}

/// Squareness from the diagonals of one box.
/// An error of A by the position of B changes a diagonal by α·A·B/D: longer if both axes rise or fall
/// together, else shorter.
fn squareness(all: &[DiagonalResult]) -> (BTreeMap<String, f64>, BTreeMap<String, Option<f64>>) {
    let (mut found, mut errors) = (BTreeMap::new(), BTreeMap::new());
    let mut boxes: Vec<Vec<&DiagonalResult>> = Vec::new();
    for d in all {
        let alike = |o: &DiagonalResult| {
            o.axes == d.axes && o.box_mm.iter().zip(&d.box_mm).all(|(a, b)| (a / b - 1.0).abs() < 0.02)
        };
        match boxes.iter_mut().find(|b| b.first().is_some_and(|o| alike(o))) {
            Some(b) => b.push(d),
            None => boxes.push(vec![d]),
        }
    }
    for own in boxes {
        let axes = own[0].axes.len();
        let senses: std::collections::BTreeSet<&str> = own.iter().map(|d| d.sense.as_str()).collect();
        if own.len() != senses.len() || senses.len() != 1 << (axes - 1) {
            continue;
        }
        for i in 0..axes {
            for j in i + 1..axes {
                let of = |d: &&DiagonalResult| {
                    let together = d.sense.as_bytes()[i] == d.sense.as_bytes()[j];
                    let change = d.slope_um * d.along.travel_mm / (d.box_mm[i] * d.box_mm[j]) * 1000.0;
                    if together { change } else { -change }
                };
                let mean = own.iter().map(of).sum::<f64>() / own.len() as f64;
                let area = |d: &DiagonalResult| d.box_mm[i] * d.box_mm[j];
                let error = |d: &&DiagonalResult| {
                    Some(d.slope_standard_error_um? * d.along.travel_mm / area(d) * 1000.0)
                };
                let pair = format!("{}.{}", own[0].axes[i], own[0].axes[j]);
                errors.insert(pair.clone(), standard_error_of_mean(own.iter().map(error)));
                found.insert(pair, mean);
            }
        }
    }
    (found, errors)
}
