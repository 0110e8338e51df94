//! Circular tests: deviations by ISO 230-4:2005, and their causes with intervals.
//!
//! | symbol | covers | meaning |
//! |---|---|---|
//! | G | one contour | circular deviation: range of the radial deviation about the least-squares circle |
//! | G(b) | both ways | the same over both contours about their common circle (bi-directional circular deviation) |
//! | F max, F min | one contour | radial deviation: largest and smallest about the nominal radius, centred by least squares |
//! | D | both ways | mean bi-directional radial deviation: mean radius minus the nominal one |
//! | H | both ways | hysteresis: largest difference of both contours at one angle (ISO 230-4:1996) |
//!
//! The diagnosis fits effects of the model (scale, squareness, reversal, spike, following error, screw) to
//! the radial errors of all records of a plane. Each record has its own centre and mean radius.

use crate::gauge_resolution::step_of;
use crate::iso230::{CircleAndDriftUncertainty, FittedCircle, error_axes, lacks};
use crate::motion_from_positions::noise;
use rtec_files::Result;
use rtec_model::ballbar_circle::{Circle, rates, turn_rad};
use rtec_model::effect::{Dictionary, Effect, sign};
use rtec_model::record::{Axis, Column, Record, Role, RunKind, median, span};
use serde::Serialize;
use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};
use std::ops::Range;

mod diagnosis;
mod effect_search;
mod spike_interval;
mod unexplained_structure;

pub use diagnosis::{CauseContribution, Diagnosis, FittedCyclicError, FittedReversalSpike};

/// One contour: a run in one direction of rotation at one feed.
/// Values in µm unless named otherwise.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ContourResult {
    /// File name of its record.
    pub record: String,
    /// `ccw` (from the first axis towards the second) or `cw`.
    pub direction: &'static str,
    /// Feed along the circle, mm/min, where time and radius are known.
    pub feed_mm_per_min: Option<f64>,
    /// Angle covered, degrees.
    pub turned_deg: f64,
    /// Circular deviation.
    #[serde(rename = "G")]
    pub g: f64,
    /// Largest radial deviation.
    #[serde(rename = "F_max")]
    pub f_max: f64,
    /// Smallest radial deviation.
    #[serde(rename = "F_min")]
    pub f_min: f64,
    /// Centre of its least-squares circle.
    pub centre_um: [f64; 2],
    /// Radius of its least-squares circle minus the nominal one.
    pub radius_um: f64,
    /// Standard errors of the centre's coordinates and of the radius.
    /// They assume random residuals, and are large on a short arc.
    pub standard_error_um: [f64; 3],
    /// Angle (rad) and deviation from the least-squares circle, row by row.
    #[serde(skip)]
    pub trace: Vec<(f64, f64)>,
}

/// Circular tests of one plane.
/// Values in µm unless named otherwise; `None` where the runs do not show them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BallbarResult {
    /// The plane, as the two axes.
    pub plane: String,
    /// Nominal radius, mm.
    pub radius_mm: Option<f64>,
    /// Largest circular deviation counter-clockwise.
    #[serde(rename = "G_ccw")]
    pub g_ccw: Option<f64>,
    /// Largest circular deviation clockwise.
    #[serde(rename = "G_cw")]
    pub g_cw: Option<f64>,
    /// Largest bi-directional circular deviation of a record.
    /// If no record has both directions, of all records together.
    #[serde(rename = "G_b")]
    pub g_b: Option<f64>,
    /// Largest radial deviation.
    #[serde(rename = "F_max")]
    pub f_max: f64,
    /// Smallest radial deviation.
    #[serde(rename = "F_min")]
    pub f_min: f64,
    /// Mean bi-directional radial deviation.
    #[serde(rename = "D")]
    pub d: Option<f64>,
    /// Largest hysteresis.
    #[serde(rename = "H")]
    pub h: Option<f64>,
    /// Causes of the deviations.
    #[serde(flatten)]
    pub diagnosis: Diagnosis,
    /// Uncertainty of the figures, if the conditions state contributors.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub uncertainty: Option<CircleAndDriftUncertainty>,
    /// Every contour.
    pub contours: Vec<ContourResult>,
    /// Warnings about its use.
    pub warnings: Vec<String>,
}

/// A record as a circle: angle and radial error, with plane and radius if known.
#[derive(Clone)]
pub(crate) struct CircleTrace {
    pub(crate) record: Record,
    name: String,
    plane: String,
    pub(crate) angle: Vec<f64>,
    pub(crate) radial: Vec<f64>,
    /// Resolution of the gauge, µm; 0 if its readings show none.
    step_um: f64,
    /// Mean number of consecutive equal readings, which share one rounding error.
    alike_rows: f64,
    /// Rows of each contour and its direction, +1 counter-clockwise.
    pub(crate) contours: Vec<(Range<usize>, f64)>,
}

/// Evaluates circular tests, plane by plane.
/// A record has a radial error over the angle, or two axes with position and error.
///
/// # Errors
/// A record that is no circle, or has less than half a turn.
pub fn evaluate(records: &[Record]) -> Result<Vec<BallbarResult>> {
    let mut planes: Vec<(String, Vec<CircleTrace>)> = Vec::new();
    for record in records {
        let trace = CircleTrace::of(record)?;
        match planes.iter_mut().find(|(name, _)| same_plane(name, &trace.plane)) {
            Some((_, traces)) => traces.push(trace),
            None => planes.push((trace.plane.clone(), vec![trace])),
        }
    }
    planes.into_iter().map(|(plane, traces)| plane_of(plane, &traces)).collect()
}

/// Largest gap of a full circle, degrees, or two rows if that is more.
const MISSING_DEG: f64 = 2.0;

/// Deviation of the mean radius that no scale error explains, µm per mm of radius.
const FAR_OFF: f64 = 0.5;

/// Whether two radii are the same within 1 %.
fn alike(a: f64, b: f64) -> bool {
    (a / b - 1.0).abs() < 0.01
}

fn same_plane(a: &str, b: &str) -> bool {
    a == b || a.split_once('-').is_some_and(|(x, y)| format!("{y}-{x}") == b)
}

fn plane_of(plane: String, traces: &[CircleTrace]) -> Result<BallbarResult> {
    let contours: Vec<ContourResult> = traces.iter().flat_map(CircleTrace::evaluate).collect();
    let largest =
        |of: &dyn Fn(&ContourResult) -> Option<f64>| contours.iter().filter_map(of).reduce(f64::max);
    let way = |w: &'static str| move |c: &ContourResult| (c.direction == w).then_some(c.g);
    let both = bidirectional(traces);
    let of_both = |f: fn(&[Row]) -> Option<f64>| both.iter().filter_map(|b| f(b)).reduce(f64::max);
    let mean_radius: Vec<f64> = both.iter().filter_map(|b| Some(round_fit(&pairs(b))?[0])).collect();
    let mut warnings = Vec::new();
    let short = |c: &&ContourResult| {
        360.0 - c.turned_deg > MISSING_DEG.max(2.5 * c.turned_deg / c.trace.len() as f64)
    };
    if let Some(c) = contours.iter().find(short) {
        let turned = c.turned_deg.round();
        let what = "its deviations are those of the arc";
        warnings.push(format!("a contour of less than a full circle, {turned:.0}°: {what}"));
    }
    let radii: Vec<f64> = traces.iter().filter_map(|t| t.record.circle().map(|c| c.radius_mm)).collect();
    let mixed = radii.iter().any(|r| !alike(*r, radii[0]));
    if mixed {
        let list = radii.iter().map(f64::to_string).collect::<Vec<_>>().join(", ");
        warnings.push(format!(
            "circles of different radii ({list} mm): each figure is the largest of any; evaluate them one by one for the figures of each"
        ));
    }
    let off = |t: &CircleTrace| {
        let mm = t.record.circle()?.radius_mm;
        t.evaluate().into_iter().map(|c| c.radius_um).find(|um| um.abs() > FAR_OFF * mm)
    };
    if let Some(um) = traces.iter().find_map(off) {
        warnings.push(format!(
            "the mean radius is {um:.0} µm off the nominal one: radius_mm is not the bar's, or its zero is not set; F and D say nothing else"
        ));
    }
    let diagnosis = diagnosis::diagnose(traces, &mut warnings)?;
    Ok(BallbarResult {
        radius_mm: radii.first().copied().filter(|_| !mixed),
        g_ccw: largest(&way("ccw")),
        g_cw: largest(&way("cw")),
        g_b: of_both(|b| range_about(&pairs(b))),
        f_max: largest(&|c| Some(c.f_max)).unwrap_or(0.0),
        f_min: -largest(&|c| Some(-c.f_min)).unwrap_or(0.0),
        d: mean_radius.iter().copied().max_by(|a, b| a.abs().total_cmp(&b.abs())),
        h: of_both(hysteresis),
        diagnosis,
        uncertainty: None,
        contours,
        warnings,
        plane,
    })
}

/// A row: angle, radial error, direction of rotation.
type Row = (f64, f64, f64);

/// Rows of each record with both directions.
/// If there is none, of all records of one radius together.
fn bidirectional(traces: &[CircleTrace]) -> Vec<Vec<Row>> {
    let rows = |t: &CircleTrace, centred: bool| -> Vec<Row> {
        let of = |(rows, turn): &(Range<usize>, f64)| {
            let points: Vec<(f64, f64)> = rows.clone().map(|i| (t.angle[i], t.radial[i])).collect();
            // Records of one direction were set up separately, so each is centred.
            let [_, a, b] = round_fit(&points).filter(|_| centred).unwrap_or([0.0; 3]);
            points.into_iter().map(|(p, e)| (p, e - a * p.cos() - b * p.sin(), *turn)).collect::<Vec<_>>()
        };
        t.contours.iter().flat_map(of).collect()
    };
    let goes_both = |rows: &[Row]| rows.iter().any(|r| r.2 > 0.0) && rows.iter().any(|r| r.2 < 0.0);
    let mut found: Vec<_> = traces.iter().map(|t| rows(t, false)).filter(|r| goes_both(r)).collect();
    if found.is_empty() {
        let radius = |t: &CircleTrace| t.record.circle().map_or(1.0, |c| c.radius_mm);
        let mut left: Vec<&CircleTrace> = traces.iter().collect();
        while let Some(first) = left.first().map(|t| radius(t)) {
            let (own, others): (Vec<&CircleTrace>, _) =
                left.into_iter().partition(|t| alike(radius(t), first));
            let all: Vec<_> = own.into_iter().flat_map(|t| rows(t, true)).collect();
            found.extend(Some(all).filter(|r| goes_both(r)));
            left = others;
        }
    }
    found
}

fn pairs(rows: &[Row]) -> Vec<(f64, f64)> {
    rows.iter().map(|r| (r.0, r.1)).collect()
}

/// Radius and centre of the least-squares circle of small radial deviations.
/// Sectors have equal weight, however many rows they have. `None` if the points give no circle.
fn round_fit(points: &[(f64, f64)]) -> Option<[f64; 3]> {
    let count = (points.len() / 4).clamp(12, 360);
    let sector = |angle: f64| ((angle.rem_euclid(TAU) / TAU * count as f64) as usize).min(count - 1);
    let mut rows = vec![0.0_f64; count];
    for (angle, _) in points {
        rows[sector(*angle)] += 1.0;
    }
    let root = |p: &(f64, f64)| rows[sector(p.0)].sqrt().recip();
    let (columns, y) = round_columns(points, root);
    rtec_least_squares::solve(&columns, &y).ok()?.values.try_into().ok()
}

/// Columns of radius and centre, and the deviations, times each row's root weight.
fn round_columns(points: &[(f64, f64)], root: impl Fn(&(f64, f64)) -> f64) -> ([Vec<f64>; 3], Vec<f64>) {
    let of = |f: fn(f64) -> f64| points.iter().map(|p| root(p) * f(p.0)).collect();
    ([of(|_| 1.0), of(f64::cos), of(f64::sin)], points.iter().map(|p| root(p) * p.1).collect())
}

/// Standard errors of [`round_fit`]: centre's coordinates, then radius.
fn round_errors(points: &[(f64, f64)], [radius, a, b]: [f64; 3]) -> Option<[f64; 3]> {
    let (columns, y) = round_columns(points, |_| 1.0);
    let left = points.iter().map(|(p, e)| (e - radius - a * p.cos() - b * p.sin()).powi(2)).sum::<f64>();
    let freedom = points.len().checked_sub(3).filter(|n| *n > 0)? as f64;
    let spread = rtec_least_squares::solve(&columns, &y).ok()?.spread();
    Some([1, 2, 0].map(|i| spread[i] * (left / freedom).sqrt()))
}

/// Range of the radial deviation about the least-squares circle.
fn range_about(points: &[(f64, f64)]) -> Option<f64> {
    let [_, a, b] = round_fit(points)?;
    let left = points.iter().map(|(p, e)| e - a * p.cos() - b * p.sin());
    let [lo, hi] = span(left);
    Some(hi - lo)
}

/// Largest difference of both directions in one sector.
/// Sectors are 1° wide, or wider if rows are scarce.
fn hysteresis(rows: &[Row]) -> Option<f64> {
    let count = (rows.len() / 4).clamp(36, 360);
    let mut sectors = vec![[(0.0, 0_u32); 2]; count];
    for (angle, e, turn) in rows {
        let sector = (angle.rem_euclid(TAU) / TAU * count as f64) as usize;
        let cell = &mut sectors[sector.min(count - 1)][usize::from(*turn > 0.0)];
        cell.0 += e;
        cell.1 += 1;
    }
    let mean = |(sum, n): (f64, u32)| (n > 0).then(|| sum / f64::from(n));
    sectors.iter().filter_map(|[cw, ccw]| Some((mean(*cw)? - mean(*ccw)?).abs())).reduce(f64::max)
}

impl CircleTrace {
    fn of(record: &Record) -> Result<Self> {
        let (record, plane) = as_circle(record)?;
        let get = |role: &Role| record.data(role).map(<[f64]>::to_vec).unwrap_or_default();
        let angle = get(&Role::Angle);
        let radial = Axis::new("r").map(|r| get(&Role::Error(r))).unwrap_or_default();
        let name = record.path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
        let contours = contours(&record, &angle);
        let step_um = step_of(&radial).unwrap_or(0.0);
        let alike_rows =
            radial.len() as f64 / radial.chunk_by(|a, b| a.to_bits() == b.to_bits()).count().max(1) as f64;
        let trace = Self { record, name, plane, angle, radial, step_um, alike_rows, contours };
        if !trace.contours.iter().any(|(rows, _)| trace.turned(rows) >= PI * 0.99) {
            let expected = "a contour over at least half a turn";
            return Err(lacks(&trace.record, "less than half a circle", expected));
        }
        Ok(trace)
    }

    /// Angle that a contour covers without gaps, rad.
    fn turned(&self, rows: &Range<usize>) -> f64 {
        let step = |i: usize| turn_rad(self.angle[i], self.angle[i + 1]).abs();
        let steps = rows.len().saturating_sub(1);
        let all = (rows.start..rows.start + steps).map(step);
        let gap = MISSING_DEG.to_radians().max(2.5 * all.clone().sum::<f64>() / steps.max(1) as f64);
        let (sum, count) = all.filter(|s| *s <= gap).fold((0.0, 0_u32), |(sum, n), s| (sum + s, n + 1));
        // Each end covers half a step more.
        sum * (1.0 + 1.0 / f64::from(count.max(1)))
    }

    /// Standard deviation of one reading, from the residual, µm.
    /// At least that of the gauge's rounding.
    fn scatter_um(&self, left: &[f64]) -> f64 {
        let mut turned = 0.0;
        let further = |i: usize| {
            turned += turn_rad(self.angle[i.saturating_sub(1)], self.angle[i]).abs();
            turned
        };
        let path: Vec<f64> = (0..self.angle.len()).map(further).collect();
        let runs: Vec<Range<usize>> = self.contours.iter().map(|(rows, _)| rows.clone()).collect();
        noise(&path, left, &runs).max(self.step_um / 12.0_f64.sqrt())
    }

    /// Variance of rounding per reading, µm².
    /// Consecutive equal readings share one error, so the variance is multiplied by their number.
    fn rounding_um2(&self) -> f64 {
        self.step_um * self.step_um / 12.0 * self.alike_rows
    }

    fn evaluate(&self) -> Vec<ContourResult> {
        // Path over time without the ends, where the speed changes; a coarse clock then matters only once.
        let speed = |rows: &Range<usize>| {
            let (circle, t) = (self.record.circle()?, self.record.data(&Role::Time)?);
            let end = rows.len() / 20;
            let inner = rows.start + end..rows.end - end;
            let span_s = t[inner.end - 1] - t[inner.start];
            let path_mm = circle.radius_mm * path_rad(&self.angle, inner);
            (span_s > 0.0).then(|| path_mm / span_s * 60.0)
        };
        let of = |(rows, turn): &(Range<usize>, f64)| {
            let points: Vec<(f64, f64)> = rows.clone().map(|i| (self.angle[i], self.radial[i])).collect();
            let [radius, a, b] = round_fit(&points)?;
            let standard_error_um = round_errors(&points, [radius, a, b])?;
            let centred = |(p, e): &(f64, f64)| e - a * p.cos() - b * p.sin();
            let [f_min, f_max] = span(points.iter().map(centred));
            Some(ContourResult {
                record: self.name.clone(),
                direction: if *turn > 0.0 { "ccw" } else { "cw" },
                feed_mm_per_min: speed(rows),
                turned_deg: self.turned(rows).to_degrees(),
                g: f_max - f_min,
                f_max,
                f_min,
                centre_um: [a, b],
                radius_um: radius,
                standard_error_um,
                trace: points.iter().map(|p| (p.0, centred(p) - radius)).collect(),
            })
        };
        self.contours.iter().filter_map(of).collect()
    }
}

/// Relative change of speed that is another feed; below it an axis is at rest.
const FEED_SHARE: f64 = 0.2;

/// A shorter turn is a start or a stop, not a contour, rad.
const START_RAD: f64 = TAU / 20.0;

/// Angle that rows cover, in either direction, rad.
fn path_rad(angle: &[f64], rows: Range<usize>) -> f64 {
    rows.skip(1).map(|i| turn_rad(angle[i - 1], angle[i]).abs()).sum()
}

/// Runs of rows in one direction of rotation at one feed.
/// Start and stop belong to the contour that they begin and end.
fn contours(record: &Record, angle: &[f64]) -> Vec<(Range<usize>, f64)> {
    let n = angle.len();
    // Compare rows some distance apart, so that noise of the angle does not look like a reversal.
    let look = (n / 400).max(1);
    let sense = |i: usize| {
        let (a, b) = (i.saturating_sub(look), (i + look).min(n - 1));
        sign(turn_rad(angle[a], angle[b]))
    };
    let speed: Vec<f64> = match record.data(&Role::Time) {
        Some(t) => rates(angle, t).iter().map(|r| r.abs()).collect(),
        None => vec![1.0; n],
    };
    let turned = |rows: &Range<usize>| path_rad(angle, rows.clone());
    let mut found: Vec<(Range<usize>, f64)> = Vec::new();
    let mut usual = 0.0;
    for i in 0..n {
        let turn = sense(i);
        let is_other = |s: &f64| (s / usual - 1.0).abs() > FEED_SHARE;
        let all_other = (0..10).all(|k| speed.get(i + k).is_some_and(is_other));
        let other_feed = |rows: &Range<usize>| rows.len() > 20 && all_other;
        match found.last_mut().filter(|(_, t)| turn == 0.0 || (*t - turn).abs() < 0.5) {
            Some((rows, _)) if !other_feed(rows) => {
                rows.end = i + 1;
                usual += (speed[i] - usual) / rows.len() as f64;
            }
            // The speed of a start is not the feed. Rows at rest before it are left out.
            Some((rows, _)) if turned(rows) <= START_RAD => {
                let rests = |row: &usize| speed[*row] < FEED_SHARE * speed[i];
                rows.start = rows.clone().rev().find(rests).map_or(rows.start, |row| row + 1);
                (rows.end, usual) = (i + 1, speed[i]);
            }
            // Another direction or another feed starts another contour.
            _ => {
                found.push((i..i + 1, turn));
                usual = speed[i];
            }
        }
    }
    // A stop belongs to the contour that it ends, as long as the axes move.
    for i in (1..found.len()).rev() {
        let ((before, sense), (rows, turn)) = (&found[i - 1], &found[i]);
        if sense * turn > 0.0 && before.end == rows.start && turned(rows) <= START_RAD {
            let rests = |row: &usize| speed[*row] < FEED_SHARE * speed[before.end - 1];
            found[i - 1].0.end = rows.clone().find(rests).unwrap_or(rows.end);
            found.remove(i);
        }
    }
    // Near a change of direction the sign is uncertain.
    for i in 1..found.len() {
        let [(before, sense), (rows, turn)] = &mut found[i - 1..=i] else { break };
        if (*turn - *sense).abs() > 0.5 && rows.len() > 4 * look && before.len() > 4 * look {
            before.end -= look;
            rows.start += look;
        }
    }
    found.retain(|(rows, turn)| *turn != 0.0 && rows.len() > 4 && turned(rows) > START_RAD);
    found
}

/// A ballbar record without rows at rest before, between and after contours.
///
/// At rest the angle does not show from which direction the axes came.
pub fn in_motion(record: &Record) -> Record {
    let angle = record.circle().and_then(|_| record.data(&Role::Angle));
    let Some((angle, t)) = angle.zip(record.data(&Role::Time)) else { return record.clone() };
    let n = angle.len();
    let usual_s = median(t.windows(2).map(|w| w[1] - w[0]));
    // Speed into a row; after a gap, out of it.
    let speed = |row: usize| {
        let gap = row == 0 || t[row] - t[row - 1] > 2.5 * usual_s.max(f64::MIN_POSITIVE);
        let (from, to) = if gap { (row, (row + 1).min(n - 1)) } else { (row - 1, row) };
        turn_rad(angle[from], angle[to]).abs() / (t[to] - t[from])
    };
    let rate = rates(angle, t);
    let of = |(rows, _): (Range<usize>, f64)| (rows.clone(), median(rate[rows].iter().map(|r| r.abs())));
    let feeds: Vec<(Range<usize>, f64)> = contours(record, angle).into_iter().map(of).collect();
    let slowest = feeds.iter().map(|f| f.1).fold(f64::INFINITY, f64::min);
    let feed = |row: usize| feeds.iter().find(|f| f.0.contains(&row)).map_or(slowest, |f| f.1);
    // A row with the time of the row before is not at rest but duplicated, which is reported elsewhere.
    let rests = |row: usize| speed(row) <= FEED_SHARE * feed(row);
    let rows: Vec<usize> = (0..n).filter(|row| !rests(*row)).collect();
    if rows.is_empty() || rows.len() == n { record.clone() } else { record.select(&rows) }
}

/// The record as a circle with a radial error, and the name of its plane.
fn as_circle(record: &Record) -> Result<(Record, String)> {
    let name = |c: &Circle| format!("{}-{}", c.plane[0], c.plane[1]);
    if let Some(circle) = record.circle() {
        return Ok((record.clone(), name(circle)));
    }
    let radial = Axis::new("r").map(Role::Error).filter(|r| record.column(r).is_some());
    let positions: Vec<(&Axis, &[f64])> =
        record.axes(Role::Position).filter_map(|a| Some((a, record.position(a)?))).collect();
    let has_angle = record.column(&Role::Angle).is_some();
    if radial.is_some() && !has_angle {
        return Err(lacks(record, "error.r without an angle", "a column of role angle"));
    }
    let mut columns: Vec<Column> = record.columns.clone();
    let (plane, round): ([Axis; 2], FittedCircle) = if radial.is_some() {
        let [(a, pa), (b, pb), ..] = positions.as_slice() else {
            // Without plane or positions only deviations are known.
            return Ok((record.clone(), "first-second".to_owned()));
        };
        ([(*a).clone(), (*b).clone()], circle_of_positions(record, pa, pb)?)
    } else {
        let errors = error_axes(record);
        let error_of = |a: &Axis| errors.iter().find(|(e, _)| *e == a).map(|(_, data)| *data);
        let both: Vec<_> = positions.iter().filter_map(|(a, p)| Some((*a, *p, error_of(a)?))).collect();
        let [(ax, px, ex), (ay, py, ey), ..] = both.as_slice() else {
            let expected =
                "columns error.r and angle (with radius_mm and plane), or two axes with position and error";
            return Err(lacks(record, "no circular contour", expected));
        };
        let round = circle_of_positions(record, px, py)?;
        let angle: Vec<f64> = px.iter().zip(*py).map(|(x, y)| round.angle(*x, *y)).collect();
        let r = angle.iter().zip(ex.iter().zip(*ey)).map(|(a, (x, y))| x * a.cos() + y * a.sin()).collect();
        columns.retain(|c| !c.role.is_response() && c.role != Role::Angle);
        columns.push(Column::new("angle of the contour", Role::Angle, angle));
        columns.extend(Axis::new("r").map(|a| Column::new("radial error", Role::Error(a), r)));
        ([(*ax).clone(), (*ay).clone()], round)
    };
    let mut circle = Record::of_checked(&record.path, RunKind::Ballbar, columns);
    circle.file.clone_from(&record.file);
    let stated = Circle { radius_mm: round.radius, plane, centre_mm: None };
    let plane = name(&stated);
    let circle = circle.with_circle(stated).map_err(|(found, expected)| lacks(record, &found, expected))?;
    Ok((circle, plane))
}

/// The circle that the positions run on.
fn circle_of_positions(record: &Record, x: &[f64], y: &[f64]) -> Result<FittedCircle> {
    let error = || lacks(record, "positions that are on no circle", "positions of both axes on one circle");
    FittedCircle::through(x, y).filter(FittedCircle::is_met).ok_or_else(error)
}

/// The dictionary's effect of this built-in name, at zero.
pub(crate) fn law(dictionary: &Dictionary, name: &str, axes: &[&Axis]) -> Option<Effect> {
    let full = axes.iter().fold(name.to_owned(), |n, a| format!("{n}.{a}"));
    dictionary.effect(&full).ok()
}

/// Values by axis.
pub(crate) type ByAxis<T> = BTreeMap<String, T>;
