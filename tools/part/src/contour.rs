//! The contour of a turned part: segments and features in probing order.

use crate::edge_tree::EdgeTree;
use crate::geometric_fit::Zx;
use crate::turning_plane_svg::SvgDrawing;
use serde::Serialize;
use std::f64::consts::{FRAC_PI_2, TAU};

/// Largest distance of a chord from its curve, in mm.
const CHORD_MM: f64 = 0.002;
/// Largest number of chords of one curve.
const MAX_CHORDS: usize = 4096;

/// One piece of the contour, from its start (t = 0) to its end (t = 1).
#[derive(Debug, Clone, PartialEq)]
pub enum Segment {
    /// A straight line.
    Line {
        /// Start of the line, mm.
        a: Zx,
        /// End of the line, mm.
        b: Zx,
    },
    /// An arc; a negative sweep runs clockwise.
    Arc {
        /// Centre, mm.
        centre: Zx,
        /// Radius of the arc.
        radius_mm: f64,
        /// Angle of the start from +Z.
        start_rad: f64,
        /// Signed angle to the end.
        sweep_rad: f64,
    },
    /// A piece of an ellipse.
    Ellipse {
        /// Centre, mm.
        centre: Zx,
        /// Semi-major axis, from the centre.
        major: Zx,
        /// Minor to major axis.
        ratio: f64,
        /// Parameter of the start.
        start_rad: f64,
        /// Parameter of the end minus that of the start; negative runs clockwise.
        sweep_rad: f64,
    },
    /// A rational B-spline: a free curve, or exactly a parabola, hyperbola or conic.
    Spline(Spline),
}

/// A rational B-spline.
#[derive(Debug, Clone, PartialEq)]
pub struct Spline {
    /// Degree, 1 or more.
    pub degree: usize,
    /// `points + degree + 1` ascending knots.
    pub knots: Vec<f64>,
    /// Control points, mm.
    pub points: Vec<Zx>,
    /// One positive weight per control point.
    pub weights: Vec<f64>,
}

impl Spline {
    /// De Boor's algorithm in homogeneous coordinates.
    fn at(&self, t: f64) -> Zx {
        let (p, n) = (self.degree, self.points.len());
        let (low, high) = (self.knots[p], self.knots[n]);
        let u = low + (high - low) * t.clamp(0.0, 1.0);
        // The last span that begins at or before u; at the very end, the last span that is not empty.
        let before = self.knots[..n].partition_point(|k| *k < u || u < high && *k <= u);
        let k = before.max(p + 1) - 1;
        let mut d: Vec<(f64, f64, f64)> = (0..=p)
            .map(|j| {
                let (q, w) = (self.points[j + k - p], self.weights[j + k - p]);
                (q.z * w, q.x * w, w)
            })
            .collect();
        for r in 1..=p {
            for j in (r..=p).rev() {
                let (a, b) = (self.knots[j + k - p], self.knots[j + 1 + k - r]);
                let f = if b > a { (u - a) / (b - a) } else { 0.0 };
                let mix = |lo: f64, hi: f64| lo * (1.0 - f) + hi * f;
                d[j] = (mix(d[j - 1].0, d[j].0), mix(d[j - 1].1, d[j].1), mix(d[j - 1].2, d[j].2));
            }
        }
        Zx::new(d[p].0 / d[p].2, d[p].1 / d[p].2)
    }

    /// The curve split at its corners.
    /// A corner is possible only at a knot repeated `degree` times, because there the curve runs through a
    /// control point. `is_corner` decides for two directions.
    pub(crate) fn between_corners(mut self, is_corner: impl Fn(Zx, Zx) -> bool) -> Vec<Self> {
        let (p, mut pieces, mut i) = (self.degree, Vec::new(), self.degree + 1);
        while i < self.points.len() {
            let (u, n) = (self.knots[i], self.points.len());
            let times = self.knots[i..n].iter().take_while(|k| **k <= u).count();
            // At a knot repeated more often the curve jumps from the last point of one piece to the next.
            let (last, first) = (i - 1, i - 1 + times.saturating_sub(p));
            let inside = times >= p && self.knots[p] < u && u < self.knots[n] && first + 1 < n;
            let turns = || {
                let leg = |from: Zx, to: &Zx| Some(*to - from).filter(|d| d.norm() > 0.0);
                let before = self.points[..last].iter().rev().find_map(|q| leg(self.points[last], q));
                let behind = self.points[first + 1..].iter().find_map(|q| leg(self.points[first], q));
                times > p || before.zip(behind).is_some_and(|(a, b)| is_corner(a * -1.0, b))
            };
            if !inside || !turns() {
                i += times;
                continue;
            }
            let mut rest = Self {
                degree: p,
                knots: self.knots[i + times - p..].to_vec(),
                points: self.points.split_off(first),
                weights: self.weights.split_off(first),
            };
            rest.knots.insert(0, u);
            if times == p {
                self.points.push(rest.points[0]);
                self.weights.push(rest.weights[0]);
            }
            self.points.truncate(i);
            self.weights.truncate(i);
            self.knots.truncate(i);
            self.knots.resize(i + p + 1, u);
            pieces.push(std::mem::replace(&mut self, rest));
            i = p + 1;
        }
        pieces.push(self);
        pieces
    }

    fn reversed(&self) -> Self {
        let end = self.knots[self.knots.len() - 1] + self.knots[0];
        Self {
            degree: self.degree,
            knots: self.knots.iter().rev().map(|k| end - k).collect(),
            points: self.points.iter().rev().copied().collect(),
            weights: self.weights.iter().rev().copied().collect(),
        }
    }
}

impl Segment {
    /// The point at a parameter, 0 to 1.
    pub fn at(&self, t: f64) -> Zx {
        match self {
            Self::Line { a, b } => *a + (*b - *a) * t,
            Self::Arc { centre, radius_mm, start_rad, sweep_rad } => {
                *centre + Zx::at_angle(start_rad + sweep_rad * t) * *radius_mm
            }
            Self::Ellipse { centre, major, ratio, start_rad, sweep_rad } => {
                let (sin, cos) = (start_rad + sweep_rad * t).sin_cos();
                *centre + *major * cos + Zx::new(-major.x, major.z) * (ratio * sin)
            }
            Self::Spline(spline) => spline.at(t),
        }
    }

    /// Unit direction of travel at a parameter.
    fn direction(&self, t: f64) -> Zx {
        let step = 1e-5;
        let (low, high) = ((t - step).max(0.0), (t + step).min(1.0));
        let exact = match self {
            Self::Line { a, b } => *b - *a,
            Self::Arc { start_rad, sweep_rad, .. } => {
                let n = Zx::at_angle(start_rad + sweep_rad * t);
                Zx::new(-n.x, n.z) * sweep_rad.signum()
            }
            _ => self.at(high) - self.at(low),
        };
        exact.unit().unwrap_or(Zx::new(1.0, 0.0))
    }

    /// The same piece in the opposite direction.
    #[must_use]
    pub fn reversed(&self) -> Self {
        let mut turned = self.clone();
        match &mut turned {
            Self::Line { a, b } => std::mem::swap(a, b),
            Self::Arc { start_rad, sweep_rad, .. } | Self::Ellipse { start_rad, sweep_rad, .. } => {
                *start_rad += *sweep_rad;
                *sweep_rad = -*sweep_rad;
            }
            Self::Spline(spline) => *spline = spline.reversed(),
        }
        turned
    }

    /// Chords within 2 µm of the curve.
    pub fn polyline(&self) -> Vec<Zx> {
        let chords = self.chords();
        (0..=chords).map(|k| self.at(k as f64 / chords as f64)).collect()
    }

    fn chords(&self) -> usize {
        match self {
            Self::Line { .. } => 1,
            Self::Arc { radius_mm: r, sweep_rad, .. } => chords_of_arc(*r, *sweep_rad, CHORD_MM),
            Self::Ellipse { major, sweep_rad, .. } => chords_of_arc(major.norm() * 2.0, *sweep_rad, CHORD_MM),
            Self::Spline(spline) => (spline.points.len() * 64).min(MAX_CHORDS),
        }
    }

    /// Length along the contour, in mm.
    pub fn length_mm(&self) -> f64 {
        match self {
            Self::Line { a, b } => (*b - *a).norm(),
            Self::Arc { radius_mm, sweep_rad, .. } => radius_mm * sweep_rad.abs(),
            _ => {
                let chords = self.chords().max(64).next_multiple_of(2);
                let sum = |by: usize| -> f64 {
                    let at: Vec<Zx> =
                        (0..=chords).step_by(by).map(|k| self.at(k as f64 / chords as f64)).collect();
                    at.windows(2).map(|w| (w[1] - w[0]).norm()).sum()
                };
                // Chords are too short by the square of their length; those twice as long show by how much.
                sum(1) + (sum(1) - sum(2)) / 3.0
            }
        }
    }

    /// The parameter at a length from the start; `chords` are those of this segment.
    fn parameter(&self, along_mm: f64, chords: &[Zx]) -> f64 {
        if matches!(self, Self::Line { .. } | Self::Arc { .. }) {
            return (along_mm / self.length_mm()).clamp(0.0, 1.0);
        }
        let mut passed = 0.0;
        for (k, w) in chords.windows(2).enumerate() {
            let step = (w[1] - w[0]).norm();
            if passed + step >= along_mm {
                let part = if step > 0.0 { (along_mm - passed) / step } else { 0.0 };
                return ((k as f64 + part) / (chords.len() - 1) as f64).clamp(0.0, 1.0);
            }
            passed += step;
        }
        1.0
    }
}

/// Number of chords that keep an arc within `off_mm`.
/// The sagitta is r (1 − cos(δ/2)).
pub fn chords_of_arc(radius_mm: f64, sweep_rad: f64, off_mm: f64) -> usize {
    let cos = 1.0 - off_mm / radius_mm;
    let step = if cos > -1.0 { 2.0 * cos.acos() } else { TAU };
    ((sweep_rad.abs() / step).ceil() as usize).clamp(1, MAX_CHORDS)
}

/// The kind of a feature in a machinist's terms.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum FeatureKind {
    /// A surface parallel to the part's axis.
    Cylinder {
        /// Distance from the axis.
        radius_mm: f64,
    },
    /// A face, square to the axis.
    Step {
        /// Position along the part's axis.
        z_mm: f64,
    },
    /// A cone about the part's axis.
    Taper {
        /// Inclination to the axis.
        angle_deg: f64,
    },
    /// A sphere if its centre is on the axis, else a torus or a fillet.
    Arc {
        /// Position of the centre along the part's axis.
        centre_z_mm: f64,
        /// Distance of the centre from the part's axis.
        centre_x_mm: f64,
        /// Radius of the arc.
        radius_mm: f64,
    },
    /// An ellipse, a parabola or a free curve.
    Conic,
}

/// One feature of the contour.
#[derive(Debug, Clone)]
pub struct Feature {
    /// `F1`, `F2`, … in probing order.
    pub name: String,
    /// Its kind in a machinist's terms.
    pub kind: FeatureKind,
    /// The feature's geometry, in probing order.
    pub segment: Segment,
    /// The drawing's entity that it came from.
    pub entity: String,
}

/// A place on the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfacePlace {
    /// Index of the feature in [`Contour::features`], from 0.
    pub feature: usize,
    /// Distance along the feature from its start.
    pub along_mm: f64,
    /// The point itself, mm.
    pub at: Zx,
    /// Unit normal, out of the material.
    pub normal: Zx,
}

/// The turned part's outline: its features joined end to end.
#[derive(Debug, Clone)]
pub struct Contour {
    /// Features in probing order: from the free end (largest Z) towards the chuck.
    pub features: Vec<Feature>,
    /// Whether it ends where it starts (a ring).
    /// Otherwise it runs from the axis or a free end to the chuck.
    pub closed: bool,
    /// Whether the material is on the left of the direction of travel.
    material_left: bool,
    chords: Vec<(usize, Vec<Zx>)>,
    /// All chords; for each its feature and its start along that, mm.
    surface: EdgeTree,
    starts: Vec<(usize, f64)>,
    outline: EdgeTree,
    /// What was left out of the drawing or simplified, one sentence each.
    pub cleaned: Vec<String>,
}

/// A straight line's direction within (−90, 90] degrees.
pub(crate) fn folded_deg(deg: f64) -> f64 {
    if deg > 90.0 {
        deg - 180.0
    } else if deg <= -90.0 {
        deg + 180.0
    } else {
        deg
    }
}

impl FeatureKind {
    pub(crate) fn of(segment: &Segment) -> Self {
        match segment {
            Segment::Line { a, b } => {
                let d = *b - *a;
                let deg = folded_deg(d.x.atan2(d.z).to_degrees());
                if deg.abs() < 1e-4 {
                    Self::Cylinder { radius_mm: a.x }
                } else if (deg.abs() - 90.0).abs() < 1e-4 {
                    Self::Step { z_mm: a.z }
                } else {
                    Self::Taper { angle_deg: deg }
                }
            }
            Segment::Arc { centre, radius_mm, .. } => {
                Self::Arc { centre_z_mm: centre.z, centre_x_mm: centre.x, radius_mm: *radius_mm }
            }
            Segment::Ellipse { .. } | Segment::Spline(_) => Self::Conic,
        }
    }
}

/// A nose as a contour: a quarter of a circle about the part's axis.
pub fn nose(centre: Zx, radius_mm: f64) -> Contour {
    let arc = Segment::Arc { centre, radius_mm, start_rad: 0.0, sweep_rad: FRAC_PI_2 };
    Contour::new(vec![(arc, "nose".to_owned())], false)
}

/// Centre and radius of a contour's nose: a quarter circle at its free end.
/// `None` if the contour begins with something else.
pub fn nose_of(contour: &Contour) -> Option<(Zx, f64)> {
    // Drawings are exact to 1 µm, and on a nose of 100 mm their angles are as exact.
    const NEAR: (f64, f64) = (1e-3, 1e-5);
    let Segment::Arc { centre, radius_mm, start_rad, sweep_rad } = contour.features.first()?.segment else {
        return None;
    };
    let quarter = start_rad.abs() < NEAR.1 && (sweep_rad - FRAC_PI_2).abs() < NEAR.1;
    (quarter && centre.x.abs() < NEAR.0).then_some((centre, radius_mm))
}

impl Contour {
    /// A contour from consecutive segments, each with the name of its entity.
    pub fn new(mut chain: Vec<(Segment, String)>, closed: bool) -> Self {
        if !chain.is_empty() {
            let turn = |chain: &mut Vec<(Segment, String)>| {
                chain.reverse();
                for (segment, _) in chain.iter_mut() {
                    *segment = segment.reversed();
                }
            };
            if closed {
                if signed_area(&chain, true) < 0.0 {
                    turn(&mut chain);
                }
                // A ring starts at its outer corner nearest the free end.
                let key = |s: &Segment| s.at(0.0).z + 1e-6 * s.at(0.0).x;
                let first = (0..chain.len()).max_by(|&a, &b| key(&chain[a].0).total_cmp(&key(&chain[b].0)));
                chain.rotate_left(first.unwrap_or(0));
            } else {
                let (a, b) = (chain[0].0.at(0.0), chain[chain.len() - 1].0.at(1.0));
                if (b.z, -b.x) > (a.z, -a.x) {
                    turn(&mut chain);
                }
            }
        }
        let material_left = signed_area(&chain, closed) > 0.0;
        let features: Vec<Feature> = chain
            .into_iter()
            .enumerate()
            .map(|(i, (segment, entity))| Feature {
                name: format!("F{}", i + 1),
                kind: FeatureKind::of(&segment),
                segment,
                entity,
            })
            .collect();
        let chords: Vec<(usize, Vec<Zx>)> =
            features.iter().enumerate().map(|(i, f)| (i, f.segment.polyline())).collect();
        let (mut edges, mut starts) = (Vec::new(), Vec::new());
        for (feature, points) in &chords {
            let mut along_mm = 0.0;
            for w in points.windows(2) {
                edges.push([w[0], w[1]]);
                starts.push((*feature, along_mm));
                along_mm += (w[1] - w[0]).norm();
            }
        }
        let outline = outline(chords.iter().flat_map(|(_, c)| c.iter().copied()), closed);
        let (surface, outline) = (EdgeTree::new(edges), EdgeTree::new(outline));
        Self { features, closed, material_left, chords, surface, starts, outline, cleaned: Vec::new() }
    }

    /// The place at a length along a feature.
    pub fn place(&self, feature: usize, along_mm: f64) -> SurfacePlace {
        let segment = &self.features[feature].segment;
        let t = segment.parameter(along_mm, &self.chords[feature].1);
        let d = segment.direction(t);
        let right = Zx::new(d.x, -d.z);
        let normal = if self.material_left { right } else { right * -1.0 };
        SurfacePlace { feature, along_mm, at: segment.at(t), normal }
    }

    /// The place of the contour nearest to a point.
    /// `None` for a contour without features.
    pub fn nearest(&self, p: Zx) -> Option<SurfacePlace> {
        let (_, n, foot) = self.surface.nearest(p, f64::INFINITY)?;
        let (feature, along_mm) = self.starts[n];
        Some(self.place(feature, along_mm + (foot - self.surface.start(n)).norm()))
    }

    /// The feature nearest to a point, if its surface is nearer than `within_mm`.
    pub fn feature_within(&self, p: Zx, within_mm: f64) -> Option<usize> {
        let p = Zx::new(p.z, p.x.abs()); // the part is round
        self.surface.nearest(p, within_mm).map(|(_, n, _)| self.starts[n].0)
    }

    /// Whether a point is in the material. An open contour is closed along the axis.
    pub fn inside(&self, p: Zx) -> bool {
        self.outline.crossings(Zx::new(p.z, p.x.abs())) % 2 == 1 // the part is round
    }

    /// Largest Z and X of the contour, in mm.
    pub fn reach(&self) -> Zx {
        let all = self.chords.iter().flat_map(|(_, c)| c);
        all.fold(Zx::new(f64::MIN, f64::MIN), |m, p| Zx::new(m.z.max(p.z), m.x.max(p.x)))
    }

    /// Chords of each feature.
    pub fn chords(&self) -> &[(usize, Vec<Zx>)] {
        &self.chords
    }

    /// Draws the outline, the axis and the features' names.
    pub fn draw(&self, svg: &mut SvgDrawing, names: bool) {
        let (mut low, mut high) = (f64::MAX, f64::MIN);
        for (_, chords) in &self.chords {
            svg.polyline(chords, "outline");
            low = chords.iter().fold(low, |m, p| m.min(p.z));
            high = chords.iter().fold(high, |m, p| m.max(p.z));
        }
        svg.polyline(&[Zx::new(low - 3.0, 0.0), Zx::new(high + 3.0, 0.0)], "axis");
        if names {
            let size = 0.03 * (high - low).max(self.reach().x);
            for (i, f) in self.features.iter().enumerate() {
                let middle = self.place(i, f.segment.length_mm() / 2.0);
                // On the material's side, because the probe comes from the other.
                svg.text(middle.at + middle.normal * (-2.2 * size), size, &f.name);
            }
        }
    }
}

/// The edges through these corners; an open outline is closed along the axis.
fn outline(corners: impl Iterator<Item = Zx>, closed: bool) -> Vec<[Zx; 2]> {
    let mut corners: Vec<Zx> = corners.collect();
    if let (false, Some(&first), Some(&last)) = (closed, corners.first(), corners.last()) {
        corners.extend([Zx::new(last.z, 0.0), Zx::new(first.z, 0.0)]);
    }
    (0..corners.len()).map(|i| [corners[i], corners[(i + 1) % corners.len()]]).collect()
}

/// Twice the area that the chain encloses, positive counter-clockwise.
fn signed_area(chain: &[(Segment, String)], closed: bool) -> f64 {
    let edges = outline(chain.iter().flat_map(|(s, _)| s.polyline()), closed);
    edges.iter().map(|[p, q]| p.z * q.x - q.z * p.x).sum()
}
