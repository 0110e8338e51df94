//! Reads the part's contour from a DXF drawing.
//! It orders entities along the contour and reports bad drawings.
//!
//! The drawing shows the upper half of the part (NISTIR 4854, figures 4 and 7). Its X is the part's axis
//! (machine Z). Its Y is the distance from the axis (machine X).

use crate::contour::{Contour, Segment, Spline};
use crate::dxf::{Drawing, Entity};
use crate::geometric_fit::Zx;
use crate::length_unit::LengthUnit;
use crate::part_errors::PartErrorReport;
use rtec_files::InputError;
use rtec_files::file_kind::FileKind;
use rtec_model::record::span;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::f64::consts::{PI, TAU};
use std::path::Path;

mod inserted_blocks;
mod short_segment_cleaning;

use inserted_blocks::{AffineMap, PlacedEntity};

/// The unit of `$INSUNITS`, by its number (DXF reference, "HEADER section").
fn unit_of_header(units: i32) -> Option<LengthUnit> {
    Some(LengthUnit(match units {
        1 => 25.4,
        2 => 304.8,
        4 => 1.0,
        5 => 10.0,
        6 => 1000.0,
        9 => 0.0254,
        13 => 1e-3,
        14 => 100.0,
        _ => return None,
    }))
}

// The documentation of the fields is the help of `rtecctl part`.
/// How to read a drawing
#[derive(Debug, Clone)]
#[cfg_attr(feature = "clap", derive(clap::Args))]
pub struct DxfOptions {
    /// The drawing's unit, where its header does not say
    #[cfg_attr(feature = "clap", arg(long = "units", value_name = "UNITS",
        value_parser = rtec_files::cli_option_parsers::one_of(&LengthUnit::ALL, &[])))]
    pub unit: Option<LengthUnit>,
    /// Take the contour from this layer only
    #[cfg_attr(feature = "clap", arg(long))]
    pub layer: Option<String>,
    /// Ends closer than this are one point, in mm
    #[cfg_attr(feature = "clap", arg(long, default_value_t = 1e-3))]
    pub tolerance_mm: f64,
}

impl Default for DxfOptions {
    fn default() -> Self {
        Self { unit: None, layer: None, tolerance_mm: 1e-3 }
    }
}

impl PartErrorReport {
    /// Outline and error bars as DXF (R2000, mm): layers `OUTLINE` and `WHISKER`.
    pub fn whisker_dxf(&self) -> String {
        let w = self.whiskers();
        let outline = w.outline.windows(2).map(|pair| (pair[0], pair[1], "OUTLINE"));
        let bars = w.bars.into_iter().map(|(foot, head)| (foot, head, "WHISKER"));
        let lines: Vec<_> =
            outline.chain(bars).map(|(a, b, layer)| ([a.z, a.x], [b.z, b.x], layer)).collect();
        crate::dxf::written(&lines)
    }
}

/// The unit that a drawing's header states.
///
/// # Errors
/// Not a DXF file.
pub fn header_unit(file: &Path) -> Result<Option<LengthUnit>, InputError> {
    Ok(unit_of_header(load(file)?.units))
}

fn load(file: &Path) -> Result<Drawing, InputError> {
    let bytes = rtec_files::text_file::bytes(file).map_err(|e| {
        InputError::whole(file, format!("an unreadable file ({})", e.found), "a readable DXF file")
    })?;
    Drawing::of(file, &bytes).map_err(|finding| {
        let kind = FileKind::of_bytes(&bytes).or_else(|| FileKind::of(&String::from_utf8_lossy(&bytes)));
        match kind.filter(|kind| *kind != FileKind::Drawing) {
            Some(other) => {
                InputError::whole(file, other.name(), "a DXF drawing: save or export the contour as DXF")
            }
            None => finding,
        }
    })
}

/// Text, dimensions and hatches, which are not part of a contour.
const ANNOTATIONS: &str =
    "TEXT MTEXT RTEXT ATTDEF ATTRIB POINT LEADER MULTILEADER TOLERANCE ACAD_TABLE HATCH VIEWPORT";

fn is_annotation(kind: &str) -> bool {
    kind.ends_with("DIMENSION") || ANNOTATIONS.split(' ').any(|annotation| annotation == kind)
}

/// Whether an entity only resembles a contour.
/// Such entities are filled areas, pictures and infinite lines.
fn is_aid(kind: &str) -> bool {
    matches!(kind, "SOLID" | "TRACE" | "3DFACE" | "XLINE" | "RAY" | "WIPEOUT" | "IMAGE" | "OLE2FRAME")
}

/// Reads a drawing's contour and the unit of its coordinates.
///
/// # Errors
/// Not a DXF file, or unknown units. An entity that belongs to no contour, is given twice, has no length, or
/// is below the axis or out of the plane. A contour with a gap, a branch or several pieces.
pub fn read(file: &Path, options: &DxfOptions) -> Result<(Contour, LengthUnit), InputError> {
    let drawing = load(file)?;
    let unit = options.unit.or_else(|| unit_of_header(drawing.units)).ok_or_else(|| {
        let found = format!("unknown units ($INSUNITS: {})", drawing.unit_name());
        InputError::whole(file, found, "$INSUNITS of mm, cm, m, inch, …, or the unit named with --units")
    })?;
    let mut reader = ContourReader { file, unit, options, place: AffineMap::HERE };
    let (mut pieces, mut cleaned) = (Vec::new(), CleaningSummary::default());
    // If a layer is requested, it is read even if it is hidden.
    let is_hidden =
        |layer: &str| options.layer.is_none() && drawing.hidden_layers.contains(&layer.to_lowercase());
    for placed in inserted_blocks::placed(file, &drawing, unit.0, &is_hidden)? {
        let PlacedEntity { entity, layer, place, hidden_by } = placed;
        if is_annotation(&entity.kind) || options.layer.as_ref().is_some_and(|asked| asked != layer) {
            continue;
        }
        if hidden_by.is_some() || !entity.visible || is_hidden(layer) {
            cleaned.hidden += 1;
            cleaned.hidden_on.insert(hidden_by.unwrap_or(layer).to_owned());
            continue;
        }
        if is_aid(&entity.kind) {
            *cleaned.aids.entry(entity.kind.clone()).or_default() += 1;
            continue;
        }
        reader.place = place;
        reader.pieces(entity, &mut pieces, &mut cleaned)?;
    }
    if pieces.is_empty() && cleaned.hidden > 0 {
        let found = format!("no contour that is shown, and {}", cleaned.not_shown());
        let expected = "entities that are visible, on layers that are on; or --layer";
        return Err(InputError::whole(file, found, expected));
    }
    if pieces.is_empty() && cleaned.speck.is_none() {
        let layer = options.layer.as_ref().map_or(String::new(), |l| format!(" on layer '{l}'"));
        let there: BTreeSet<&str> = drawing.entities.iter().map(|e| e.layer.as_str()).collect();
        let there = there.into_iter().take(40).collect::<Vec<_>>().join(", ");
        let expected = match &options.layer {
            Some(_) if !there.is_empty() => format!("one of the layers that hold anything: {there}"),
            _ => "lines, arcs, ellipses or splines".to_owned(),
        };
        return Err(InputError::whole(file, format!("no contour{layer}"), expected));
    }
    reader.twice(&pieces)?;
    let (short, mut pieces): (Vec<SegmentFromEntity>, Vec<SegmentFromEntity>) =
        pieces.into_iter().partition(|piece| reader.is_speck(&piece.segment));
    for piece in short_segment_cleaning::joined(&short, options.tolerance_mm, &mut cleaned) {
        reader.is_fit(&piece.segment, &piece.entity, piece.line)?;
        pieces.push(piece);
    }
    if let (true, Some((line, speck))) = (pieces.is_empty(), &cleaned.speck) {
        let found = format!("{speck} without length, and nothing longer");
        return Err(InputError::at(file, *line, 0, found, "entities longer than the tolerance"));
    }
    let mut contour = reader.chain(pieces)?;
    contour.cleaned = cleaned.said(file, options.tolerance_mm);
    Ok((contour, unit))
}

/// Flag of a polyline's vertex that is a control point of the fitted curve.
/// (DXF, group code 70 of VERTEX.)
const FRAME: i32 = 16;

/// Largest distance of an arc from its chord to count as straight.
/// It is a share of the tolerance.
const FLAT: f64 = 0.01;

/// What was left out of a drawing or simplified.
#[derive(Debug, Clone, Default)]
struct CleaningSummary {
    /// Vertices within the tolerance of the previous one.
    vertices: usize,
    /// Pieces no longer than the tolerance, and the first of them.
    specks: usize,
    speck: Option<(usize, String)>,
    /// Arcs and ellipses from an angle to the same angle.
    no_sweeps: usize,
    /// Arcs and other curves that became straight lines.
    arcs: usize,
    curves: usize,
    /// Polylines whose control points were skipped in favour of the fitted curve.
    frames: usize,
    /// Ellipses that became circles.
    circles: usize,
    /// Entities that the drawing hides, and their layers.
    hidden: usize,
    hidden_on: BTreeSet<String>,
    /// Entities that are not part of a contour, by kind.
    aids: BTreeMap<String, usize>,
}

/// An ellipse with equal axes as an arc: some programs write circles this way.
fn rounded(segment: Segment, flat_mm: f64, cleaned: &mut CleaningSummary) -> Segment {
    match segment {
        Segment::Ellipse { centre, major, ratio, start_rad, sweep_rad }
            if major.norm() * (1.0 - ratio.abs()).abs() <= flat_mm =>
        {
            cleaned.circles += 1;
            let (turn, sign) = (major.x.atan2(major.z), ratio.signum());
            Segment::Arc {
                centre,
                radius_mm: major.norm(),
                start_rad: turn + sign * start_rad,
                sweep_rad: sign * sweep_rad,
            }
        }
        other => other,
    }
}

/// A count with its noun: `1 arc`, `2 arcs`.
fn several(n: usize, one: &str) -> String {
    if n == 1 { format!("1 {one}") } else { format!("{n} {one}s") }
}

impl CleaningSummary {
    /// A sentence about hidden entities.
    fn not_shown(&self) -> String {
        let layers: Vec<&str> = self.hidden_on.iter().take(8).map(String::as_str).collect();
        let entities = if self.hidden == 1 { "entity" } else { "entities" };
        let (n, layers) = (self.hidden, layers.join(", "));
        format!(
            "{n} {entities} not shown (invisible, or its layer off, frozen or not plotted): layer {layers}"
        )
    }

    /// The sentences for the user; empty if nothing was changed.
    fn said(&self, file: &Path, tolerance_mm: f64) -> Vec<String> {
        let [within, flat] = [tolerance_mm, tolerance_mm * FLAT].map(rtec_files::text_file::short);
        let vertices = if self.vertices == 1 { "vertex" } else { "vertices" };
        let straight = |n: usize, what: &str| {
            let curves = several(n, what);
            format!("took {curves} as straight: within {flat} mm of the chord, a hundredth of the tolerance")
        };
        let aids: Vec<String> = self.aids.iter().map(|(kind, n)| several(*n, kind)).collect();
        let n = self.vertices;
        let specks = several(self.specks, "piece");
        let no_sweeps = several(self.no_sweeps, "arc");
        let circles = several(self.circles, "ellipse");
        let frames = several(self.frames, "polyline");
        let whole = "(a whole circle is one from 0 to 360 degrees)";
        let round = format!("round within {flat} mm, a hundredth of the tolerance");
        let sentences = [
            (n, format!("left out {n} {vertices} within {within} mm of the one before")),
            (self.specks, format!("left out {specks} no longer than {within} mm")),
            (self.no_sweeps, format!("left out {no_sweeps} from an angle to the same angle {whole}")),
            (self.arcs, straight(self.arcs, "arc")),
            (self.curves, straight(self.curves, "curve")),
            (self.circles, format!("took {circles} as a circle: {round}")),
            (self.hidden, format!("left out {}", self.not_shown())),
            (aids.len(), format!("passed over {}: no contour", aids.join(", "))),
            (self.frames, format!("of {frames} the fitted curve was taken, not its control points")),
        ];
        let told = sentences.into_iter().filter(|(n, _)| *n > 0);
        told.map(|(_, text)| format!("{}: {text}", file.display())).collect()
    }
}

/// Largest distance of a part from its drawing's origin, mm.
const FARTHEST_MM: f64 = 1e5;

#[derive(Debug, Clone)]
struct SegmentFromEntity {
    segment: Segment,
    entity: String,
    line: usize,
}

impl SegmentFromEntity {
    fn ends(&self) -> [Zx; 2] {
        [self.segment.at(0.0), self.segment.at(1.0)]
    }
}

/// Points in a grid, so that neighbours are found without comparing all.
struct NeighbourGrid {
    cell: f64,
    cells: HashMap<[i64; 2], Vec<usize>>,
}

impl NeighbourGrid {
    /// The grid of points, by their indices; near means within `tolerance`.
    fn of(points: impl Iterator<Item = Zx>, tolerance: f64) -> Self {
        let mut places = Self { cell: tolerance.max(1e-9), cells: HashMap::new() };
        for (n, p) in points.enumerate() {
            places.cells.entry(places.at(p)).or_default().push(n);
        }
        places
    }

    fn at(&self, p: Zx) -> [i64; 2] {
        [p.z, p.x].map(|v| (v / self.cell).floor() as i64)
    }

    /// The indices of the points around a place.
    /// They include all within the tolerance, and some more.
    fn around(&self, p: Zx) -> impl Iterator<Item = usize> {
        self.cells_around(p).flatten().copied()
    }

    fn cells_around(&self, p: Zx) -> impl Iterator<Item = &Vec<usize>> {
        let [z, x] = self.at(p);
        let cells =
            (-1..=1).flat_map(move |i| (-1..=1).map(move |j| [z.saturating_add(i), x.saturating_add(j)]));
        cells.filter_map(|cell| self.cells.get(&cell))
    }
}

/// Whether an arc or ellipse begins and ends at the same angle.
/// It is then empty, because a whole circle ends at 360 degrees.
fn has_no_sweep(entity: &Entity) -> bool {
    let (from, to) = if entity.kind == "ARC" { (50, 51) } else { (41, 42) };
    entity.number(from).zip(entity.number(to)).is_some_and(|(from, to)| from.total_cmp(&to).is_eq())
}

fn axis_ratio(ellipse: &Entity) -> f64 {
    ellipse.number(40).unwrap_or(1.0)
}

struct ContourReader<'a> {
    file: &'a Path,
    unit: LengthUnit,
    options: &'a DxfOptions,
    /// The placement of the present entity.
    place: AffineMap,
}

impl ContourReader<'_> {
    /// Whether two points count as one.
    fn near(&self, p: Zx, q: Zx) -> bool {
        #[cfg(test)]
        tests::LOOKS.with(|looks| looks.set(looks.get() + 1));
        (p - q).norm() <= self.options.tolerance_mm
    }

    fn point(&self, [x, y, _]: [f64; 3]) -> Zx {
        Zx::new(x, y) * self.unit.0
    }

    fn pieces(
        &self,
        entity: &Entity,
        out: &mut Vec<SegmentFromEntity>,
        cleaned: &mut CleaningSummary,
    ) -> Result<(), InputError> {
        let (line, normal) = (entity.line, entity.normal());
        // A drawing need not have handles.
        let own = if entity.handle.is_empty() { format!("(line {line})") } else { entity.handle.clone() };
        let named = |kind: &str| format!("{kind} {own} on layer {}", entity.layer);
        let refuse = |kind: &str, what: &str, expected: &str| {
            Err(InputError::at(self.file, line, 0, format!("{} {what}", named(kind)), expected))
        };
        // Seen from below, x is reversed: the object coordinates of DXF for a downward normal.
        let mirror = if normal[2] < 0.0 { -1.0 } else { 1.0 };
        let level = |heights: &[f64]| heights.iter().all(|z| z.abs() < 1e-6);
        let flat = |heights: &[f64]| normal[0].abs() < 1e-9 && normal[1].abs() < 1e-9 && level(heights);
        let is_closed = entity.flags() & 1 != 0;
        let corner = |[x, y, bulge]: [f64; 3]| (Zx::new(mirror * x, y) * self.unit.0, mirror * bulge);
        let kind = &*entity.kind;
        let (in_plane, segments) = match kind {
            "LINE" => {
                let (a, b) = (entity.point(10), entity.point(11));
                (level(&[a[2], b[2]]), vec![Segment::Line { a: self.point(a), b: self.point(b) }])
            }
            "ARC" | "ELLIPSE" if has_no_sweep(entity) => {
                cleaned.no_sweeps += 1;
                cleaned.speck.get_or_insert_with(|| (line, named(kind)));
                return Ok(());
            }
            "ARC" => (flat(&[entity.point(10)[2]]), vec![self.arc(entity, mirror)]),
            "ELLIPSE" => {
                let (segment, ratio) = (self.ellipse(entity, mirror), axis_ratio(entity));
                // The longer axis is the major one (DXF, group code 40). A smaller ratio than this is a line.
                // An ellipse that is a line within the tolerance is accepted as that, whatever its ratio.
                let is_line = || self.is_speck(&segment) || self.is_line(&segment);
                if !(0.0..=1.0 + 1e-9).contains(&ratio) || ratio < 1e-6 && !is_line() {
                    let what = format!("with an axis ratio of {ratio:e}");
                    return refuse(kind, &what, "a minor axis of 0.000001 to 1 times the major one");
                }
                (flat(&[entity.point(10)[2], entity.point(11)[2]]), vec![segment])
            }
            "LWPOLYLINE" => {
                let corners: Vec<_> = entity.rows([10, 20, 42]).into_iter().map(corner).collect();
                (flat(&[]), self.bulged(&corners, is_closed, cleaned))
            }
            "POLYLINE" => {
                // The control points of a fitted curve are not on it.
                let (frame, fitted): (Vec<&Entity>, Vec<_>) =
                    entity.vertices.iter().partition(|v| v.flags() & FRAME != 0);
                cleaned.frames += usize::from(!fitted.is_empty() && !frame.is_empty());
                let curve = if fitted.is_empty() { frame } else { fitted };
                let points: Vec<_> =
                    curve.iter().map(|v| (v.point(10), v.number(42).unwrap_or(0.0))).collect();
                let corners: Vec<_> =
                    points.iter().map(|([x, y, _], bulge)| corner([*x, *y, *bulge])).collect();
                let heights: Vec<f64> = points.iter().map(|(p, _)| p[2]).collect();
                (flat(&heights), self.bulged(&corners, is_closed, cleaned))
            }
            "SPLINE" => {
                let Some(spline) = self.spline(entity) else {
                    let expected =
                        "control points with knots and positive weights, as CAD systems write them";
                    return refuse(kind, "without a complete set of control points and knots", expected);
                };
                let heights: Vec<f64> = entity.rows([10, 20, 30]).iter().map(|p| p[2]).collect();
                (flat(&heights), self.smooth(spline, cleaned))
            }
            "CIRCLE" => {
                let length_mm = TAU * entity.number(40).unwrap_or(0.0).abs() * self.unit.0;
                if length_mm > self.options.tolerance_mm || length_mm.is_nan() {
                    return refuse(kind, "in the contour", "the half profile above the axis: an arc of it");
                }
                cleaned.specks += 1;
                return Ok(());
            }
            _ => return refuse(kind, "in the contour", "lines, arcs, ellipses, splines and polylines"),
        };
        if !in_plane {
            return refuse(kind, "out of the drawing's plane", "a flat drawing at elevation 0");
        }
        for segment in segments.into_iter().map(|segment| self.place.put(segment)) {
            let segment = if self.is_speck(&segment) {
                Segment::Line { a: segment.at(0.0), b: segment.at(1.0) }
            } else {
                let segment = rounded(self.straightened(segment, cleaned), self.flat_mm(), cleaned);
                self.is_fit(&segment, &named(kind), line)?;
                segment
            };
            out.push(SegmentFromEntity { segment, entity: named(kind), line });
        }
        Ok(())
    }

    /// Checks that a piece can be part of a contour.
    fn is_fit(&self, segment: &Segment, entity: &str, line: usize) -> Result<(), InputError> {
        let chords = segment.polyline();
        let (what, expected) = if !chords.iter().all(|p| p.z.is_finite() && p.x.is_finite()) {
            ("with a coordinate that is no number", "finite coordinates")
        } else if chords.iter().any(|p| p.z.abs().max(p.x.abs()) > FARTHEST_MM) {
            ("more than 100 m from the origin", "a part that a machine could hold")
        } else if chords.iter().any(|p| p.x < -self.options.tolerance_mm) {
            ("below the axis", "the half profile at Y ≥ 0")
        } else {
            return Ok(());
        };
        Err(InputError::at(self.file, line, 0, format!("{entity} {what}"), expected))
    }

    /// `mirror` is −1 for an arc that is seen from below.
    fn arc(&self, arc: &Entity, mirror: f64) -> Segment {
        let [start, end] = [50, 51].map(|code| arc.number(code).unwrap_or(0.0));
        let (sweep, start) = ((end - start).rem_euclid(360.0).to_radians(), start.to_radians());
        let mut centre = self.point(arc.point(10));
        centre.z *= mirror;
        Segment::Arc {
            centre,
            radius_mm: arc.number(40).unwrap_or(0.0) * self.unit.0,
            start_rad: if mirror < 0.0 { PI - start } else { start },
            sweep_rad: mirror * if sweep == 0.0 { TAU } else { sweep },
        }
    }

    /// `mirror` is −1 for an ellipse that is seen from below.
    fn ellipse(&self, ellipse: &Entity, mirror: f64) -> Segment {
        let (start, end) = (ellipse.number(41).unwrap_or(0.0), ellipse.number(42).unwrap_or(TAU));
        let sweep = (end - start).rem_euclid(TAU);
        Segment::Ellipse {
            centre: self.point(ellipse.point(10)),
            major: self.point(ellipse.point(11)),
            ratio: mirror * axis_ratio(ellipse),
            start_rad: start,
            sweep_rad: if sweep == 0.0 { TAU } else { sweep },
        }
    }

    /// Whether a piece is no longer than the tolerance, so that its neighbours meet.
    fn is_speck(&self, segment: &Segment) -> bool {
        segment.length_mm() <= self.options.tolerance_mm
    }

    /// Largest distance of an arc from its chord to count as straight, mm.
    fn flat_mm(&self) -> f64 {
        self.options.tolerance_mm * FLAT
    }

    /// A piece that is straight within the tolerance, as a line.
    fn straightened(&self, segment: Segment, cleaned: &mut CleaningSummary) -> Segment {
        if !self.is_line(&segment) {
            return segment;
        }
        match segment {
            Segment::Line { .. } => return segment,
            Segment::Arc { .. } => cleaned.arcs += 1,
            Segment::Ellipse { .. } | Segment::Spline(_) => cleaned.curves += 1,
        }
        Segment::Line { a: segment.at(0.0), b: segment.at(1.0) }
    }

    /// Whether a piece follows its chord without turning back.
    /// Its distance from the chord is at most [`Self::flat_mm`].
    fn is_line(&self, segment: &Segment) -> bool {
        let [a, b] = [segment.at(0.0), segment.at(1.0)];
        let points = match segment {
            Segment::Line { .. } => return true,
            Segment::Arc { radius_mm, sweep_rad, .. } => {
                return sweep_rad.abs() < PI
                    && 2.0 * radius_mm * (sweep_rad / 4.0).sin().powi(2) <= self.flat_mm();
            }
            // It turns back at the ends of its major axis, where its parameter is a whole number of half turns.
            Segment::Ellipse { start_rad, sweep_rad, .. } => {
                let [low, high] =
                    [start_rad.min(start_rad + sweep_rad), start_rad.max(start_rad + sweep_rad)];
                if ((low / PI + 1e-9).floor() + 1.0) * PI < high - 1e-9 {
                    return false;
                }
                segment.polyline()
            }
            // It stays within the hull of its control points and turns back no more often than they do.
            Segment::Spline(spline) => spline.points.clone(),
        };
        let Some(way) = (b - a).unit() else { return false };
        let across = Zx::new(-way.x, way.z);
        let along = |p: &Zx| (*p - a).dot(way);
        points.iter().all(|p| (*p - a).dot(across).abs() <= self.flat_mm())
            && points.windows(2).all(|w| along(&w[1]) >= along(&w[0]) - 1e-9)
    }

    /// Lines and arcs of a polyline.
    /// A bulge is the tangent of a quarter of its arc's angle. A vertex within the tolerance of the previous
    /// one is the same vertex.
    fn bulged(&self, corners: &[(Zx, f64)], closed: bool, cleaned: &mut CleaningSummary) -> Vec<Segment> {
        let mut kept: Vec<(Zx, f64)> = Vec::with_capacity(corners.len());
        for &(at, bulge) in corners {
            match kept.last_mut() {
                Some((last, own)) if self.is_doubled(*last, *own, at) => {
                    cleaned.vertices += 1;
                    *own = bulge;
                }
                _ => kept.push((at, bulge)),
            }
        }
        if closed && kept.len() > 2 {
            let (last, own) = kept[kept.len() - 1];
            if self.is_doubled(last, own, kept[0].0) {
                cleaned.vertices += 1;
                kept.pop();
            }
        }
        let n = kept.len();
        let count = if closed { n } else { n.saturating_sub(1) };
        (0..count)
            .map(|i| {
                let ((a, bulge), (b, _)) = (kept[i], kept[(i + 1) % n]);
                // Checked before the centre is computed, because a small bulge puts it far away.
                if bulge.abs() * (b - a).norm() / 2.0 <= self.flat_mm() {
                    cleaned.arcs += usize::from(bulge != 0.0);
                    return Segment::Line { a, b };
                }
                let (half, sweep_rad) = ((b - a) * 0.5, 4.0 * bulge.atan());
                let centre = a + half + Zx::new(-half.x, half.z) * ((1.0 - bulge * bulge) / (2.0 * bulge));
                Segment::Arc {
                    centre,
                    radius_mm: (a - centre).norm(),
                    start_rad: (a - centre).angle_rad(),
                    sweep_rad,
                }
            })
            .collect()
    }

    /// Whether the way from one vertex to the next is no longer than the tolerance.
    /// The arc of a large bulge is longer.
    fn is_doubled(&self, from: Zx, bulge: f64, to: Zx) -> bool {
        let chord = (to - from).norm();
        let way = if bulge == 0.0 { 1.0 } else { (1.0 + bulge * bulge) * bulge.atan() / bulge };
        chord * way <= self.options.tolerance_mm
    }

    /// The smooth pieces of a spline; one of degree 1 is a polyline.
    fn smooth(&self, spline: Spline, cleaned: &mut CleaningSummary) -> Vec<Segment> {
        if spline.degree == 1 {
            let corners: Vec<_> = spline.points.iter().map(|p| (*p, 0.0)).collect();
            return self.bulged(&corners, false, cleaned);
        }
        let turns = |before: Zx, behind: Zx| {
            let across = Zx::new(-behind.x, behind.z);
            let off_mm = before.dot(across).abs() / before.norm().max(behind.norm());
            before.dot(behind) <= 0.0 || off_mm > self.flat_mm()
        };
        spline.between_corners(turns).into_iter().map(Segment::Spline).collect()
    }

    fn spline(&self, s: &Entity) -> Option<Spline> {
        let points: Vec<Zx> = s.rows([10, 20, 30]).into_iter().map(|p| self.point(p)).collect();
        let (n, degree) = (points.len(), s.number(71)? as usize);
        let (knots, mut weights): (Vec<f64>, Vec<f64>) = (s.all(40).collect(), s.all(41).collect());
        if weights.is_empty() {
            weights = vec![1.0; n];
        }
        let whole = degree >= 1
            && n > degree
            && knots.len() == n + degree + 1
            && knots.windows(2).all(|k| k[0] <= k[1])
            && knots[degree] < knots[n]
            && weights.len() == n
            && weights.iter().all(|w| w.is_finite() && *w > 0.0);
        whole.then_some(Spline { degree, knots, points, weights })
    }

    fn twice(&self, pieces: &[SegmentFromEntity]) -> Result<(), InputError> {
        let tolerance = self.options.tolerance_mm;
        let lengths: Vec<f64> = pieces.iter().map(|p| p.segment.length_mm()).collect();
        let starts = NeighbourGrid::of(pieces.iter().flat_map(SegmentFromEntity::ends), tolerance);
        let middles = NeighbourGrid::of(pieces.iter().map(|p| p.segment.at(0.5)), tolerance);
        for (i, a) in pieces.iter().enumerate() {
            let ([a0, a1], middle) = (a.ends(), a.segment.at(0.5));
            let same = |j: &usize| {
                let [b0, b1] = pieces[*j].ends();
                let reach = short_segment_cleaning::reach_mm(lengths[i], lengths[*j]).min(tolerance);
                let near = |p: Zx, q: Zx| self.near(p, q) && (p - q).norm() <= reach;
                let ends = near(a0, b0) && near(a1, b1) || near(a0, b1) && near(a1, b0);
                reach > 0.0 && ends && near(middle, pieces[*j].segment.at(0.5))
            };
            // Searches around the place with the fewest neighbours, because many pieces may meet in one point
            // or cross.
            let crowd = |grid: &NeighbourGrid, p: Zx| grid.cells_around(p).map(Vec::len).sum::<usize>();
            let [c0, c1, of_middles] = [crowd(&starts, a0), crowd(&starts, a1), crowd(&middles, middle)];
            let first = if of_middles <= c0.min(c1) {
                middles.around(middle).filter(|j| *j < i).filter(same).min()
            } else {
                let end = if c0 <= c1 { a0 } else { a1 };
                starts.around(end).map(|end| end / 2).filter(|j| *j < i).filter(same).min()
            };
            if let Some(j) = first {
                let found = format!("{}, a duplicate of {}", a.entity, pieces[j].entity);
                return Err(InputError::at(self.file, a.line, 0, found, "every entity once"));
            }
        }
        Ok(())
    }

    /// Orders the pieces along the contour.
    fn chain(&self, pieces: Vec<SegmentFromEntity>) -> Result<Contour, InputError> {
        let tol = self.options.tolerance_mm;
        // A line on the axis closes a drawing but is not a surface.
        let on_axis = |p: &SegmentFromEntity| matches!(p.segment, Segment::Line { a, b } if a.x.abs() <= tol && b.x.abs() <= tol);
        let (axis, rest): (Vec<SegmentFromEntity>, Vec<SegmentFromEntity>) =
            pieces.into_iter().partition(on_axis);
        if rest.is_empty() {
            return Err(InputError::whole(self.file, "nothing but the axis", "the part's contour"));
        }
        let ends: Vec<(usize, Zx)> =
            rest.iter().enumerate().flat_map(|(i, p)| p.ends().map(|e| (i, e))).collect();
        let places = NeighbourGrid::of(ends.iter().map(|(_, at)| *at), tol);
        // Two are enough to decide.
        let met = |k: usize| {
            let others = places.around(ends[k].1).filter(|j| *j != k);
            others.filter(|j| self.near(ends[*j].1, ends[k].1)).take(2).count()
        };
        if let Some(k) = (0..ends.len()).find(|&k| met(k) > 1) {
            let (i, at) = ends[k];
            let (at, one) = (self.words(at), &rest[i].entity);
            let found = format!("a branch at {at}: more than two entities meet ({one} is one)");
            return Err(InputError::at(self.file, rest[i].line, 0, found, "one contour without branches"));
        }
        let free: Vec<usize> = (0..ends.len()).filter(|&k| met(k) == 0).collect();
        if free.len() > 2 {
            return Err(self.gap(&rest, &ends, &free));
        }
        let closed = free.is_empty();
        if let [a, b] = free[..] {
            let meets_axis =
                |k: usize| axis.iter().any(|p| p.ends().iter().any(|e| self.near(*e, ends[k].1)));
            if meets_axis(a) != meets_axis(b) {
                let k = if meets_axis(a) { b } else { a };
                let piece = &rest[ends[k].0];
                let found = format!("an open contour: {} ends at {}", piece.entity, self.words(ends[k].1));
                let expected = "a contour that returns to the axis";
                return Err(InputError::at(self.file, piece.line, 0, found, expected));
            }
        }
        let mut tail = free.first().map_or(ends[0].1, |&k| ends[k].1);
        let mut chain = Vec::with_capacity(rest.len());
        let mut rest: Vec<Option<SegmentFromEntity>> = rest.into_iter().map(Some).collect();
        loop {
            let free =
                places.around(tail).filter(|k| rest[ends[*k].0].is_some() && self.near(ends[*k].1, tail));
            let Some(piece) = free.map(|k| ends[k].0).min().and_then(|i| rest[i].take()) else { break };
            let [start, end] = piece.ends();
            let forward = self.near(start, tail);
            tail = if forward { end } else { start };
            chain.push((if forward { piece.segment } else { piece.segment.reversed() }, piece.entity));
        }
        if let Some(left) = rest.into_iter().flatten().next() {
            let found = format!("a second contour ({} is part of it)", left.entity);
            let expected = "one contour, or --layer to choose it";
            return Err(InputError::at(self.file, left.line, 0, found, expected));
        }
        short_segment_cleaning::close_joints(&mut chain, closed);
        Ok(Contour::new(chain, closed))
    }

    fn gap(&self, rest: &[SegmentFromEntity], ends: &[(usize, Zx)], free: &[usize]) -> InputError {
        // Sorted along the drawing's longer side, so that near ends follow each other.
        let side = |of: &dyn Fn(Zx) -> f64| {
            let [least, most] = span(free.iter().map(|k| of(ends[*k].1)));
            most - least
        };
        let along = side(&|p| p.z) >= side(&|p| p.x);
        let place = |k: usize| if along { ends[k].1.z } else { ends[k].1.x };
        let mut sorted = free.to_vec();
        sorted.sort_by(|a, b| place(*a).total_cmp(&place(*b)));
        let mut least = (f64::INFINITY, free[0], free[0]);
        for (n, &a) in sorted.iter().enumerate() {
            for &b in &sorted[n + 1..] {
                if place(b) - place(a) > least.0 {
                    break;
                }
                let off = (ends[a].1 - ends[b].1).norm();
                // Among equal gaps, the one that comes first in the drawing.
                let (first, second) = (a.min(b), a.max(b));
                if ends[a].0 != ends[b].0 && (off, second, first) < (least.0, least.2, least.1) {
                    least = (off, first, second);
                }
            }
        }
        let (off, a, b) = least;
        let (first, second) = (&rest[ends[a].0], &rest[ends[b].0]);
        let what = if self.overlap(first, second) { "an overlap" } else { "a gap" };
        let [at, other] =
            [(first, a), (second, b)].map(|(p, k)| format!("{} at {}", p.entity, self.words(ends[k].1)));
        let found =
            format!("an open contour: {what} of {:.4} units between {at} and {other}", off / self.unit.0);
        InputError::at(self.file, second.line.max(first.line), 0, found, "entities that meet end to end")
    }

    /// Whether two lines overlap over some length.
    fn overlap(&self, first: &SegmentFromEntity, second: &SegmentFromEntity) -> bool {
        let (Segment::Line { a, b }, Segment::Line { a: c, b: d }) = (&first.segment, &second.segment) else {
            return false;
        };
        let along = *b - *a;
        let place = |p: Zx| (p - *a).z * along.z / along.norm() + (p - *a).x * along.x / along.norm();
        let off = |p: Zx| ((p - *a).z * along.x - (p - *a).x * along.z).abs() / along.norm();
        let (from, to) = (place(*c).min(place(*d)).max(0.0), place(*c).max(place(*d)).min(along.norm()));
        let tolerance = self.options.tolerance_mm;
        off(*c) <= tolerance && off(*d) <= tolerance && to - from > tolerance
    }

    fn words(&self, p: Zx) -> String {
        format!("({:.4}, {:.4})", p.z / self.unit.0, p.x / self.unit.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;

    thread_local! {
        /// Number of pairs of points that were compared.
        pub(super) static LOOKS: Cell<u64> = const { Cell::new(0) };
    }

    /// Reads lines in this order; returns the result and the number of comparisons.
    fn reads(lines: &[[f64; 4]]) -> (Result<usize, String>, u64) {
        let lines: Vec<_> = lines.iter().map(|[z0, x0, z1, x1]| ([*z0, *x0], [*z1, *x1], "0")).collect();
        let directory = tempfile::tempdir().unwrap();
        let file = directory.path().join("a.dxf");
        std::fs::write(&file, crate::dxf::written(&lines)).unwrap();
        LOOKS.with(|looks| looks.set(0));
        let read = read(&file, &DxfOptions::default());
        let found = read.map(|(contour, _)| contour.chords().len()).map_err(|e| e.found);
        (found, LOOKS.with(Cell::get))
    }

    #[test]
    fn work_grows_with_the_drawing_and_not_with_its_square() {
        if !test_needs::long() {
            return;
        }
        let n = 20_000_u32;
        let step = |i: u32| f64::from(i) * 0.01;
        // A profile in mixed order, every second line drawn backwards.
        let profile: Vec<[f64; 4]> = (0..n)
            .map(|k| (k * 7919) % n)
            .map(|i| {
                let (a, b) = ([step(i), 10.0 + (step(i)).sin()], [step(i + 1), 10.0 + (step(i + 1)).sin()]);
                if i % 2 == 0 { [a[0], a[1], b[0], b[1]] } else { [b[0], b[1], a[0], a[1]] }
            })
            .collect();
        let (read, looks) = reads(&profile);
        assert_eq!(read, Ok(n as usize));
        assert!(looks < 60 * u64::from(n), "{looks}");
        // All in one point, all across one point, none that meet, and one that occurs twice.
        let star = |r: f64, from: f64| -> Vec<[f64; 4]> {
            let turn = |i: u32| f64::from(i) * 3.0 / f64::from(n);
            (0..n)
                .map(|i| (turn(i).cos() * r, turn(i).sin() * r))
                .map(|(z, x)| [-z * from, 50.0 - x * from, z, 50.0 + x])
                .collect()
        };
        let apart: Vec<[f64; 4]> = (0..n).map(|i| [step(i), 1.0, step(i) + 0.003, 1.0]).collect();
        let mut twice = profile.clone();
        twice.push(profile[3]);
        for (lines, wants) in [
            (star(40.0, 0.0), "a branch at"),
            (star(40.0, 1.0), "an open contour: a gap of"),
            (apart, "an open contour: a gap of 0.0070"),
            (twice, "a duplicate of"),
        ] {
            let (read, looks) = reads(&lines);
            assert!(read.as_ref().is_err_and(|found| found.contains(wants)), "{wants}: {read:?}");
            assert!(looks < 60 * u64::from(n), "{wants}: {looks}");
        }
    }
}
