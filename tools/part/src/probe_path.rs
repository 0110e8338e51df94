//! Probing points and the probe's path between them.
//! The files are `pathfin.cdl` and the expected trip points (NISTIR 4854, sections 3 and 4).

use crate::contour::{Contour, SurfacePlace};
use crate::error_cor_file::MOST_MM;
use crate::geometric_fit::Zx;
use crate::length_unit::LengthUnit;
use crate::turning_plane_svg::SvgDrawing;
use rtec_files::{CsvTable, InputError};
use serde::Serialize;
use std::fmt::Write as _;
use std::path::Path;

// The documentation of the fields is the help of `rtecctl part`.
/// How the machine moves while probing
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "clap", derive(clap::Args))]
pub struct ProbingMotion {
    /// Probing feed, in mm/min
    #[cfg_attr(feature = "clap", arg(long, default_value_t = Self::REPORT.feed_mm_min))]
    pub feed_mm_min: f64,
    /// Acceleration to the feed, in mm/s²
    #[cfg_attr(feature = "clap", arg(long, default_value_t = Self::REPORT.accel_mm_s2))]
    pub accel_mm_s2: f64,
    /// Deceleration from the feed, in mm/s²
    #[cfg_attr(feature = "clap", arg(long, default_value_t = Self::REPORT.decel_mm_s2))]
    pub decel_mm_s2: f64,
    /// Constant velocity wanted on each side of the trip, in mm
    #[cfg_attr(feature = "clap", arg(long, default_value_t = Self::REPORT.window_mm))]
    pub window_mm: f64,
}

impl ProbingMotion {
    /// The turning centre of NISTIR 4854.
    /// At 2.5 m/min 5 mm of stand-off and 2.5 mm of over-travel leave about 2 mm of constant velocity. Of the
    /// 5.5 mm that remain, 4 mm are acceleration and 1.5 mm deceleration.
    pub const REPORT: Self =
        Self { feed_mm_min: 2500.0, accel_mm_s2: 217.0, decel_mm_s2: 578.7, window_mm: 1.0 };

    /// The probing feed in mm/s.
    pub fn velocity_mm_s(&self) -> f64 {
        self.feed_mm_min / 60.0
    }

    /// Travel from rest to the expected trip: acceleration, then the window.
    pub fn stand_off_mm(&self) -> f64 {
        self.velocity_mm_s().powi(2) / (2.0 * self.accel_mm_s2) + self.window_mm
    }

    /// Travel from the expected trip to rest: the window, then deceleration.
    pub fn over_travel_mm(&self) -> f64 {
        self.velocity_mm_s().powi(2) / (2.0 * self.decel_mm_s2) + self.window_mm
    }
}

/// The stylus behind the tip, a straight rod.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StylusStem {
    /// Length from the tip's centre.
    pub length_mm: f64,
    /// Radius of the rod.
    pub radius_mm: f64,
    /// Direction from the tip towards its holder, measured from +Z.
    pub angle_rad: f64,
}

/// The probe and its motion off and beyond the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProbeGeometry {
    /// Radius of the tip.
    pub tip_mm: f64,
    /// Travel from the start of the touch to the trip.
    pub stand_off_mm: f64,
    /// Travel from the trip to the end of the touch.
    pub over_travel_mm: f64,
    /// Its stylus, if collisions of it count.
    pub stem: Option<StylusStem>,
}

/// A gauging point and the path of the probe to it.
#[derive(Debug, Clone, PartialEq)]
pub struct GaugingPointWithBypass {
    /// The place on the nominal surface that is touched.
    pub place: SurfacePlace,
    /// Intermediate points from the previous gauging point.
    pub bypass: Vec<Zx>,
}

/// The role of a record in the path file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum PathPointRole {
    /// Start of a touch.
    Start,
    /// End of the touch of this gauging point (from 1).
    Touch(usize),
    /// Retraction from the surface.
    Finish,
    /// An intermediate point to go round the part.
    Bypass,
}

/// One record of the path file: a target of the tip's centre, in mm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PathPoint {
    /// The role of the place: start, touch, finish or by-pass.
    pub role: PathPointRole,
    /// Target of the tip's centre, mm.
    pub at: Zx,
}

/// A collision of the probe with the part.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Collision {
    /// The gauging point, from 1, on the path to it.
    pub point: usize,
    /// Whether it is during the touch and not on the path to it.
    pub touching: bool,
    /// The tip's centre at the collision, mm.
    pub at: Zx,
    /// The feature that is hit.
    pub feature: String,
    /// The part of the probe that hits it: tip or stem.
    pub by: &'static str,
}

/// The plan of a probing session.
#[derive(Debug, Clone)]
pub struct ProbingPlan {
    /// The probe that the path is made for.
    pub probe: ProbeGeometry,
    /// Gauging points in probing order.
    pub points: Vec<GaugingPointWithBypass>,
}

/// Steps in which a move is checked, in mm.
const STEP_MM: f64 = 0.2;
/// Allowance for chords and rounding, in mm.
const SLACK_MM: f64 = 0.005;

/// Number of points on a length at a spacing.
/// The spacing is reduced so that both ends get a point.
pub fn number_at(length_mm: f64, spacing_mm: f64) -> usize {
    (length_mm / spacing_mm - 1e-9).ceil().max(1.0) as usize + 1
}

impl ProbingPlan {
    /// A plan without points.
    pub const fn new(probe: ProbeGeometry) -> Self {
        Self { probe, points: Vec::new() }
    }

    /// Adds evenly spaced points to a feature, within a margin at both ends.
    /// A single point goes to the middle.
    pub fn add_number(&mut self, contour: &Contour, feature: usize, number: usize, margin_mm: f64) {
        let length_mm = (contour.features[feature].segment.length_mm() - 2.0 * margin_mm).max(0.0);
        for k in 0..number {
            let part = if number == 1 { 0.5 } else { k as f64 / (number - 1) as f64 };
            self.add(contour.place(feature, margin_mm + part * length_mm));
        }
    }

    /// Adds the places nearest to the points of a file `z_mm,x_mm`.
    ///
    /// # Errors
    /// A bad file, or a point further than `off_mm` from the contour.
    pub fn add_file(&mut self, contour: &Contour, file: &Path, off_mm: f64) -> Result<(), InputError> {
        let sheet = CsvTable::read(file, &["z_mm", "x_mm"], |_| false)?;
        for (row, (z, x)) in sheet.numbers("z_mm")?.into_iter().zip(sheet.numbers("x_mm")?).enumerate() {
            let p = Zx::new(z, x);
            match contour.nearest(p) {
                Some(place) if (place.at - p).norm() <= off_mm => self.add(place),
                _ => {
                    let found = format!("({z}, {x}), which is not on the contour");
                    let exchanged = Zx::new(x, z);
                    let near = |q: SurfacePlace| (q.at - exchanged).norm() <= off_mm;
                    let is_exchanged = contour.nearest(exchanged).is_some_and(near);
                    let hint = if is_exchanged { ": with z_mm and x_mm exchanged it is" } else { "" };
                    return Err(sheet.finding(row, found, format!("a point within {off_mm} mm of it{hint}")));
                }
            }
        }
        Ok(())
    }

    /// Adds one place; the points stay in probing order.
    pub fn add(&mut self, place: SurfacePlace) {
        let key = |p: &SurfacePlace| (p.feature, p.along_mm);
        let at = self.points.partition_point(|q| key(&q.place) <= key(&place));
        if let Some(next) = self.points.get_mut(at) {
            next.bypass.clear(); // it led from another point
        }
        self.points.insert(at, GaugingPointWithBypass { place, bypass: Vec::new() });
    }

    /// Removes the point at an index.
    pub fn remove(&mut self, index: usize) {
        self.points.remove(index);
        if let Some(next) = self.points.get_mut(index) {
            next.bypass.clear();
        }
    }

    fn start(&self, point: &GaugingPointWithBypass) -> Zx {
        point.place.at + point.place.normal * (self.probe.tip_mm + self.probe.stand_off_mm)
    }

    /// The expected tip's centre at each trip.
    pub fn expected(&self) -> Vec<Zx> {
        self.points.iter().map(|p| p.place.at + p.place.normal * self.probe.tip_mm).collect()
    }

    /// The whole path.
    /// For each point it has by-passes, start, touch (through the surface by the over-travel) and finish.
    pub fn records(&self) -> Vec<PathPoint> {
        let mut records = Vec::new();
        for (i, p) in self.points.iter().enumerate() {
            records.extend(p.bypass.iter().map(|&at| PathPoint { role: PathPointRole::Bypass, at }));
            let start = self.start(p);
            let end = p.place.at + p.place.normal * (self.probe.tip_mm - self.probe.over_travel_mm);
            records.push(PathPoint { role: PathPointRole::Start, at: start });
            records.push(PathPoint { role: PathPointRole::Touch(i + 1), at: end });
            records.push(PathPoint { role: PathPointRole::Finish, at: start });
        }
        records
    }

    /// The feature that the probe at a place collides with, and by which part.
    /// The allowance is for the tip only, because at a trip it touches.
    fn meets(&self, contour: &Contour, tip: Zx) -> Option<(usize, &'static str)> {
        let met = |p: Zx, radius_mm: f64| {
            let within_mm = if contour.inside(p) { f64::INFINITY } else { radius_mm - SLACK_MM };
            contour.feature_within(p, within_mm)
        };
        if let Some(feature) = met(tip, self.probe.tip_mm) {
            return Some((feature, "tip"));
        }
        let stem = self.probe.stem?;
        let steps = (stem.length_mm / stem.radius_mm.max(STEP_MM)).ceil().max(1.0) as usize;
        (1..=steps).find_map(|k| {
            let p = tip + Zx::at_angle(stem.angle_rad) * (stem.length_mm * k as f64 / steps as f64);
            Some((met(p, stem.radius_mm)?, "stylus"))
        })
    }

    fn first_hit(&self, contour: &Contour, from: Zx, to: Zx) -> Option<(Zx, usize, &'static str)> {
        let steps = ((to - from).norm() / STEP_MM).ceil().max(1.0) as usize;
        (0..=steps).find_map(|k| {
            let at = from + (to - from) * (k as f64 / steps as f64);
            self.meets(contour, at).map(|(feature, by)| (at, feature, by))
        })
    }

    fn way(&self, index: usize) -> Vec<Zx> {
        let mut way: Vec<Zx> =
            index.checked_sub(1).map(|i| self.start(&self.points[i])).into_iter().collect();
        way.extend(&self.points[index].bypass);
        way.push(self.start(&self.points[index]));
        way
    }

    /// All collisions of the probe on its path, or in a touch before the trip.
    pub fn hits(&self, contour: &Contour) -> Vec<Collision> {
        let mut hits = Vec::new();
        for (i, p) in self.points.iter().enumerate() {
            let mut note = |found: Option<(Zx, usize, &'static str)>, touching| {
                if let Some((at, feature, by)) = found {
                    let feature = contour.features[feature].name.clone();
                    hits.push(Collision { point: i + 1, touching, at, feature, by });
                }
            };
            for leg in self.way(i).windows(2) {
                note(self.first_hit(contour, leg[0], leg[1]), false);
            }
            let trip = p.place.at + p.place.normal * self.probe.tip_mm;
            note(self.first_hit(contour, self.start(p), trip), true);
        }
        hits
    }

    /// Adds by-pass points where the path to a point collides with the part.
    /// They go over the top or round the front, with the fewest points that are clear. If no such detour is
    /// clear, the path is unchanged, and [`ProbingPlan::hits`] names it.
    pub fn add_bypasses(&mut self, contour: &Contour, clear_mm: f64) {
        let away = self.probe.tip_mm + clear_mm;
        let top = contour.reach() + Zx::new(away, away);
        for i in 1..self.points.len() {
            let way = self.way(i);
            let clear = |plan: &Self, way: &[Zx]| {
                way.windows(2).all(|leg| plan.first_hit(contour, leg[0], leg[1]).is_none())
            };
            if clear(self, &way) {
                continue;
            }
            let (a, b) = (way[0], way[way.len() - 1]);
            let detours = [
                vec![Zx::new(b.z, a.x)],
                vec![Zx::new(a.z, b.x)],
                vec![Zx::new(a.z, top.x), Zx::new(b.z, top.x)],
                vec![Zx::new(top.z, a.x), Zx::new(top.z, b.x)],
                vec![Zx::new(a.z, top.x), top, Zx::new(top.z, b.x)],
                vec![Zx::new(top.z, a.x), top, Zx::new(b.z, top.x)],
            ];
            let found = detours.into_iter().find(|detour| {
                let whole: Vec<Zx> = std::iter::once(a).chain(detour.iter().copied()).chain([b]).collect();
                clear(self, &whole)
            });
            if let Some(detour) = found {
                self.points[i].bypass = detour;
            }
        }
    }

    /// Names and contents of the plan's files: path, expected trips, drawing.
    pub fn files(&self, contour: &Contour, unit: LengthUnit) -> [(&'static str, String); 3] {
        let expected = self.expected();
        let touch = |(i, at): (usize, &Zx)| PathPoint { role: PathPointRole::Touch(i + 1), at: *at };
        let trips: Vec<PathPoint> = expected.iter().enumerate().map(touch).collect();
        [
            ("pathfin.cdl", pathfin(&self.records(), unit)),
            ("probpath.cdl", pathfin(&trips, unit)),
            ("points.svg", self.svg(contour)),
        ]
    }

    /// The contour with points, touches, paths and collisions.
    pub fn svg(&self, contour: &Contour) -> String {
        let mut svg = SvgDrawing::default();
        contour.draw(&mut svg, true);
        let size = 0.012 * contour.reach().norm();
        for (i, p) in self.points.iter().enumerate() {
            svg.polyline(&self.way(i), "bypass");
            svg.polyline(&[self.start(p), p.place.at], "move");
            svg.dot(p.place.at, 0.4 * size, "kept");
            svg.text(self.start(p) + p.place.normal * (0.7 * size), size, &(i + 1).to_string());
        }
        let hits = self.hits(contour);
        for hit in &hits {
            svg.dot(hit.at, self.probe.tip_mm, "dropped");
        }
        let mut legend =
            vec![("outline", "the part"), ("move", "touch of a point, by its number"), ("kept", "the point")];
        if (0..self.points.len()).any(|i| !self.way(i).is_empty()) {
            legend.push(("bypass", "the way between two touches"));
        }
        if !hits.is_empty() {
            legend.push(("dropped", "collision"));
        }
        svg.finish("Probing points", &legend)
    }
}

/// The text of the path file.
/// It has one `POINT` record per place, coordinates in the drawing's unit, the third always 0 (NISTIR 4854,
/// figure 7).
pub fn pathfin(records: &[PathPoint], unit: LengthUnit) -> String {
    records.iter().fold(String::new(), |mut text, r| {
        let role = match r.role {
            PathPointRole::Start => "start".to_owned(),
            PathPointRole::Touch(n) => format!("touch {n},"),
            PathPointRole::Finish => "finish".to_owned(),
            PathPointRole::Bypass => "bypass".to_owned(),
        };
        // A tiny negative number would be printed as -0.000000.
        let value = |mm: f64| (mm / unit.0 * 1e6).round() / 1e6 + 0.0;
        let _ = writeln!(text, "POINT {role} {:.6}, {:.6}, 0.000000", value(r.at.z), value(r.at.x));
        text
    })
}

/// Reads a file of expected trips (`probpath.cdl`).
/// It has the tip's centre at the trip of each gauging point.
///
/// # Errors
/// A line that is not a touch record, gauging points out of sequence, or none at all.
pub fn read_expected(file: &Path, unit: LengthUnit) -> Result<Vec<Zx>, InputError> {
    let records = read_records(file, unit)?;
    if let Some((line, _)) = records.iter().find(|(_, r)| !matches!(r.role, PathPointRole::Touch(_))) {
        let expected = "the expected trips, as touches";
        return Err(InputError::at(file, *line, 1, "a record that is no touch", expected));
    }
    Ok(records.into_iter().map(|(_, r)| r.at).collect())
}

/// Reads a path file.
///
/// # Errors
/// A line that is not a record, gauging points out of sequence, or no record at all.
pub fn read_pathfin(file: &Path, unit: LengthUnit) -> Result<Vec<PathPoint>, InputError> {
    let records = read_records(file, unit)?;
    let order = |i: usize| records.get(i).map(|(_, r): &(usize, PathPoint)| r.role);
    for (i, (line, r)) in records.iter().enumerate() {
        let touch_is_embraced = !matches!(r.role, PathPointRole::Touch(_))
            || i > 0
                && order(i - 1) == Some(PathPointRole::Start)
                && order(i + 1) == Some(PathPointRole::Finish);
        if !touch_is_embraced {
            return Err(InputError::at(file, *line, 0, "a touch", "start, touch and finish in this order"));
        }
    }
    Ok(records.into_iter().map(|(_, r)| r).collect())
}

/// Direction of motion of each touch of a path.
pub fn approaches(records: &[PathPoint]) -> Vec<Zx> {
    touches(records).filter_map(|[from, to]| (to - from).unit()).collect()
}

/// The start and the farthest end of each touch of a path.
pub(crate) fn touches(records: &[PathPoint]) -> impl Iterator<Item = [Zx; 2]> {
    let to_touch = records.windows(2).filter(|w| matches!(w[1].role, PathPointRole::Touch(_)));
    to_touch.map(|w| [w[0].at, w[1].at])
}

/// The records with their line numbers.
fn read_records(file: &Path, unit: LengthUnit) -> Result<Vec<(usize, PathPoint)>, InputError> {
    let mut records = Vec::new();
    let mut touches = 0;
    for (i, line) in rtec_files::text_file::read(file)?.lines().enumerate() {
        let words: Vec<&str> = line.split([' ', '\t', ',']).filter(|w| !w.is_empty()).collect();
        if words.is_empty() {
            continue;
        }
        let bad =
            |found: &str, expected: &str| Err(InputError::at(file, i + 1, 1, format!("'{found}'"), expected));
        let form = "POINT start|touch N,|finish|bypass Z, X, 0";
        if !words[0].eq_ignore_ascii_case("POINT") || words.len() < 2 {
            return bad(line.trim(), form);
        }
        let (role, rest) = match words[1].to_ascii_lowercase().as_str() {
            "start" => (PathPointRole::Start, &words[2..]),
            "finish" => (PathPointRole::Finish, &words[2..]),
            "bypass" => (PathPointRole::Bypass, &words[2..]),
            "touch" => {
                touches += 1;
                if words.get(2).and_then(|n| n.parse().ok()) != Some(touches) {
                    return bad(line.trim(), &format!("gauging point {touches}"));
                }
                (PathPointRole::Touch(touches), &words[3..])
            }
            other => return bad(other, "start, touch, finish or bypass"),
        };
        let numbers: Option<Vec<f64>> =
            rest.iter().map(|w| w.parse().ok().filter(|v: &f64| v.is_finite())).collect();
        let Some([z, x, _]) = numbers.as_deref() else { return bad(line.trim(), form) };
        let at = Zx::new(*z, *x) * unit.0;
        if at.z.abs().max(at.x.abs()) > MOST_MM {
            return bad(line.trim(), &format!("places within ±{MOST_MM} mm"));
        }
        records.push((i + 1, PathPoint { role, at }));
    }
    if touches == 0 {
        return Err(InputError::whole(file, "no gauging point", "start, touch, finish for each point"));
    }
    Ok(records)
}
