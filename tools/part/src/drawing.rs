//! The part's contour from a DXF drawing: entities ordered along it, bad drawings named.
//!
//! The drawing shows the upper half of the part: its X is the part's axis (Z of the machine), its Y the distance from
//! the axis (X of the machine), as in NISTIR 4854, figures 4 and 7.

use crate::contour::{Contour, Segment, Spline};
use crate::errors::ErrorReport;
use crate::fit::Zx;
use crate::unit::Unit;
use dxf::entities::{Entity, EntityType};
use dxf::enums::Units;
use dxf::{Drawing, Vector};
use rtec_files::InputError;
use rtec_files::file_kind::FileKind;
use std::collections::{BTreeSet, HashMap};
use std::f64::consts::{PI, TAU};
use std::path::Path;

fn unit_of_header(units: Units) -> Option<Unit> {
    Some(Unit(match units {
        Units::Millimeters => 1.0,
        Units::Inches => 25.4,
        Units::Centimeters => 10.0,
        Units::Decimeters => 100.0,
        Units::Meters => 1000.0,
        Units::Microns => 1e-3,
        Units::Mils => 0.0254,
        Units::Feet => 304.8,
        _ => return None,
    }))
}

/// How to read a drawing.
#[derive(Debug, Clone, Copy)]
pub struct Options<'a> {
    /// The drawing's unit, where its header does not say or is not to be believed.
    pub unit: Option<Unit>,
    /// Take only this layer.
    pub layer: Option<&'a str>,
    /// Ends that are closer than this are one point, in mm.
    pub tolerance_mm: f64,
}

impl Default for Options<'_> {
    fn default() -> Self {
        Self { unit: None, layer: None, tolerance_mm: 1e-3 }
    }
}

/// An empty drawing in mm whose file depends on nothing but its content.
#[must_use]
pub fn new_dxf() -> Drawing {
    let mut drawing = Drawing::new();
    drawing.header.version = dxf::enums::AcadVersion::R2000;
    drawing.header.default_drawing_units = Units::Millimeters;
    let header = &mut drawing.header;
    (header.creation_date, header.update_date) = Default::default();
    (header.creation_date_universal, header.update_date_universal) = Default::default();
    (header.fingerprint_guid, header.version_guid) = Default::default();
    drawing
}

impl ErrorReport {
    /// Outline and error bars as DXF (R2000, mm): layers `OUTLINE` and `WHISKER`.
    ///
    /// # Errors
    /// The DXF library could not write (memory only: it does not happen).
    pub fn whisker_dxf(&self) -> Result<Vec<u8>, dxf::DxfError> {
        let w = self.whiskers();
        let mut drawing = new_dxf();
        let mut line = |a: Zx, b: Zx, layer: &str| {
            let ends =
                dxf::entities::Line::new(dxf::Point::new(a.z, a.x, 0.0), dxf::Point::new(b.z, b.x, 0.0));
            let mut entity = Entity::new(EntityType::Line(ends));
            layer.clone_into(&mut entity.common.layer);
            drawing.add_entity(entity);
        };
        for pair in w.outline.windows(2) {
            line(pair[0], pair[1], "OUTLINE");
        }
        for (foot, head) in w.bars {
            line(foot, head, "WHISKER");
        }
        let mut bytes = Vec::new();
        drawing.save(&mut bytes)?;
        Ok(bytes)
    }
}

/// The unit that a drawing's header names.
///
/// # Errors
/// No DXF.
pub fn header_unit(file: &Path) -> Result<Option<Unit>, InputError> {
    Ok(unit_of_header(load(file)?.1.header.default_drawing_units))
}

fn load(file: &Path) -> Result<(Vec<u8>, Drawing), InputError> {
    let bytes = rtec_files::text::bytes(file).map_err(|e| {
        InputError::whole(file, format!("an unreadable file ({})", e.found), "a readable DXF file")
    })?;
    let bytes = with_line_feeds(bytes);
    if let Some((line, number)) = decimal_comma(&bytes) {
        let found = format!("'{number}'");
        return Err(InputError::at(file, line, 0, found, "a number with a decimal point, as DXF has it"));
    }
    let drawing = Drawing::load(&mut bytes.as_slice()).map_err(|e| {
        let found = e.to_string();
        let line = found.rsplit("line/offset ").next().and_then(|n| n.trim().parse().ok()).unwrap_or(0);
        let finding = InputError::at(file, line, 0, found, "a DXF drawing");
        let kind = FileKind::of_bytes(&bytes).or_else(|| FileKind::of(&String::from_utf8_lossy(&bytes)));
        match kind.filter(|kind| *kind != FileKind::Drawing) {
            Some(other) => InputError { line: 0, found: other.name().to_owned(), ..finding },
            None => finding,
        }
    })?;
    Ok((bytes, drawing))
}

/// Text whose lines end with a carriage return alone, as old Macintoshes wrote it, with line feeds instead.
fn with_line_feeds(mut bytes: Vec<u8>) -> Vec<u8> {
    if !bytes.contains(&b'\n') && !bytes.starts_with(BINARY) {
        bytes.iter_mut().filter(|byte| **byte == b'\r').for_each(|byte| *byte = b'\n');
    }
    bytes
}

/// What a binary DXF begins with.
const BINARY: &[u8] = b"AutoCAD Binary DXF";

/// The group codes of numbers with decimals (DXF reference, "Group code value types").
const DECIMALS: [std::ops::RangeInclusive<u32>; 5] = [10..=59, 110..=149, 210..=239, 460..=469, 1010..=1059];

/// Group codes and values, with the lines (from 1) on which the values stand.
fn pairs(text: &str) -> impl Iterator<Item = (u32, usize, &str)> {
    let mut lines = text.lines().enumerate();
    std::iter::from_fn(move || {
        let (Some((_, code)), Some((i, value))) = (lines.next(), lines.next()) else { return None };
        Some((code.trim().parse().unwrap_or(u32::MAX), i + 1, value.trim()))
    })
}

/// The first number with a decimal comma, and its line.
fn decimal_comma(bytes: &[u8]) -> Option<(usize, String)> {
    if bytes.starts_with(BINARY) || !bytes.contains(&b',') {
        return None;
    }
    let text = String::from_utf8_lossy(bytes);
    let is_number = |v: &str| v.matches(',').count() == 1 && v.replace(',', ".").parse::<f64>().is_ok();
    let mut numbers = pairs(&text).filter(|(code, ..)| DECIMALS.iter().any(|range| range.contains(code)));
    numbers.find(|(.., value)| is_number(value)).map(|(_, line, value)| (line, value.to_owned()))
}

/// The layers that a drawing does not show, in small letters: those that are off (a colour below zero) or frozen, and the one of
/// the points that dimensions hang on, which no program plots.
fn hidden_layers(text: &str) -> BTreeSet<String> {
    let mut hidden = BTreeSet::from(["defpoints".to_owned()]);
    let (mut in_layer, mut name, mut shown) = (false, "", true);
    for (code, _, value) in pairs(text) {
        match code {
            0 => {
                if in_layer && !shown {
                    hidden.insert(name.to_lowercase());
                }
                (in_layer, name, shown) = (value == "LAYER", "", true);
            }
            2 if in_layer => name = value,
            62 if in_layer => shown &= !value.starts_with('-'),
            70 if in_layer => shown &= value.parse::<i32>().unwrap_or(0) & FROZEN == 0,
            _ => {}
        }
    }
    hidden
}

/// Flag of a layer that is frozen (DXF, group code 70 of LAYER).
const FROZEN: i32 = 1;

/// Words and measures, which are no contour.
fn is_words(entity: &EntityType) -> bool {
    matches!(
        entity,
        EntityType::Text(_)
            | EntityType::MText(_)
            | EntityType::ModelPoint(_)
            | EntityType::Leader(_)
            | EntityType::Tolerance(_)
            | EntityType::RotatedDimension(_)
            | EntityType::RadialDimension(_)
            | EntityType::DiameterDimension(_)
            | EntityType::AngularThreePointDimension(_)
            | EntityType::OrdinateDimension(_)
    )
}

/// Read a drawing's contour and the unit its coordinates are in.
///
/// # Errors
/// No DXF, unknown units, an entity that is no part of a contour (or without length, or below the axis, or out of the
/// plane), an entity that is there twice, a contour with a gap, a branch or in several pieces.
pub fn read(file: &Path, options: &Options) -> Result<(Contour, Unit), InputError> {
    let (bytes, drawing) = load(file)?;
    let unit =
        options.unit.or_else(|| unit_of_header(drawing.header.default_drawing_units)).ok_or_else(|| {
            let found = format!("unknown units ($INSUNITS: {:?})", drawing.header.default_drawing_units);
            InputError::whole(file, found, "$INSUNITS of mm, cm, m, inch, …, or the unit named with --units")
        })?;
    let text = String::from_utf8_lossy(&bytes);
    let reader = Reader { file, lines: lines_of_handles(&text), unit, options };
    let (mut pieces, mut cleaned) = (Vec::new(), Cleaned::default());
    let hidden = hidden_layers(&text);
    for entity in drawing.entities().filter(|e| !e.common.is_in_paper_space && !is_words(&e.specific)) {
        let layer = &entity.common.layer;
        if options.layer.is_some_and(|asked| asked != layer) {
            continue;
        }
        // Whoever asks for a layer gets it.
        if !entity.common.is_visible || options.layer.is_none() && hidden.contains(&layer.to_lowercase()) {
            cleaned.hidden += 1;
            cleaned.hidden_on.insert(layer.clone());
            continue;
        }
        reader.pieces(entity, &mut pieces, &mut cleaned)?;
    }
    if let (true, Some((line, speck))) = (pieces.is_empty(), &cleaned.speck) {
        let found = format!("{speck} without length, and nothing longer");
        return Err(InputError::at(file, *line, 0, found, "entities longer than the tolerance"));
    }
    if pieces.is_empty() && cleaned.hidden > 0 {
        let found = format!("no contour that is shown, and {}", cleaned.not_shown());
        return Err(InputError::whole(
            file,
            found,
            "entities that are visible, on layers that are on; or --layer",
        ));
    }
    if pieces.is_empty() {
        let layer = options.layer.map_or(String::new(), |l| format!(" on layer '{l}'"));
        let there: BTreeSet<&str> = drawing.entities().map(|e| e.common.layer.as_str()).collect();
        let there = there.into_iter().take(40).collect::<Vec<_>>().join(", ");
        let expected = match options.layer {
            Some(_) if !there.is_empty() => format!("one of the layers that hold anything: {there}"),
            _ => "lines, arcs, ellipses or splines".to_owned(),
        };
        return Err(InputError::whole(file, format!("no contour{layer}"), expected));
    }
    reader.twice(&pieces)?;
    let mut contour = reader.chain(pieces)?;
    contour.cleaned = cleaned.said(file, options.tolerance_mm);
    Ok((contour, unit))
}

/// Flag of a vertex of a polyline: a control point of the curve that was fitted (DXF, group code 70 of VERTEX).
const FRAME: i32 = 16;

/// An arc that leaves its chord by less than this share of the tolerance is straight.
const FLAT: f64 = 0.01;

/// What was left out of a drawing, or taken as something simpler.
#[derive(Debug, Clone, Default)]
struct Cleaned {
    /// Vertices within the tolerance of the one before.
    vertices: usize,
    /// Pieces no longer than the tolerance, and the first of them.
    specks: usize,
    speck: Option<(usize, String)>,
    /// Arcs that were taken as straight, and other curves.
    arcs: usize,
    curves: usize,
    /// Polylines whose control points were passed over for the curve fitted to them.
    frames: usize,
    /// Ellipses that were taken as circles.
    circles: usize,
    /// Entities that the drawing does not show, and their layers.
    hidden: usize,
    hidden_on: BTreeSet<String>,
}

/// An ellipse with equal axes, as an arc: some programs know no other circle.
fn rounded(segment: Segment, flat_mm: f64, cleaned: &mut Cleaned) -> Segment {
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

/// `1 arc`, `2 arcs`.
fn several(n: usize, one: &str) -> String {
    if n == 1 { format!("1 {one}") } else { format!("{n} {one}s") }
}

impl Cleaned {
    /// What the drawing does not show.
    fn not_shown(&self) -> String {
        let layers: Vec<&str> = self.hidden_on.iter().take(8).map(String::as_str).collect();
        let entities =
            if self.hidden == 1 { "1 entity".to_owned() } else { format!("{} entities", self.hidden) };
        format!(
            "{entities} not shown (invisible, or its layer off, frozen or not plotted): layer {}",
            layers.join(", ")
        )
    }

    /// What a person reads of it; empty where there was nothing.
    fn said(&self, file: &Path, tolerance_mm: f64) -> Vec<String> {
        let within = rtec_files::text::short(tolerance_mm);
        let parts = [
            (
                self.vertices,
                format!("{} within {within} mm of the one before", several(self.vertices, "vertex")),
            ),
            (self.specks, format!("{} no longer than {within} mm", several(self.specks, "piece"))),
        ];
        let mut out: Vec<String> = parts
            .into_iter()
            .filter(|(n, _)| *n > 0)
            .map(|(_, text)| format!("{}: left out {}", file.display(), text.replace("vertexs", "vertices")))
            .collect();
        for (n, what) in [(self.arcs, "arc"), (self.curves, "curve")].into_iter().filter(|(n, _)| *n > 0) {
            out.push(format!(
                "{}: took {} as straight: within {} mm of the chord, a hundredth of the tolerance",
                file.display(),
                several(n, what),
                rtec_files::text::short(tolerance_mm * FLAT)
            ));
        }
        if self.circles > 0 {
            out.push(format!(
                "{}: took {} as a circle: round within {} mm, a hundredth of the tolerance",
                file.display(),
                several(self.circles, "ellipse"),
                rtec_files::text::short(tolerance_mm * FLAT)
            ));
        }
        if self.hidden > 0 {
            out.push(format!("{}: left out {}", file.display(), self.not_shown()));
        }
        if self.frames > 0 {
            out.push(format!(
                "{}: of {} the fitted curve was taken, not its control points",
                file.display(),
                several(self.frames, "polyline")
            ));
        }
        out
    }
}

/// No part is farther from its drawing's origin, mm.
const FARTHEST_MM: f64 = 1e5;

#[derive(Debug, Clone)]
struct Piece {
    segment: Segment,
    entity: String,
    line: usize,
}

impl Piece {
    fn ends(&self) -> [Zx; 2] {
        [self.segment.at(0.0), self.segment.at(1.0)]
    }
}

/// Line of the file where each handle (group code 5) stands first, in small letters.
fn lines_of_handles(text: &str) -> HashMap<String, usize> {
    let mut found = HashMap::new();
    let mut lines = text.lines().enumerate();
    while let (Some((_, code)), Some((i, value))) = (lines.next(), lines.next()) {
        if code.trim() == "5" {
            found.entry(value.trim().to_ascii_lowercase()).or_insert(i + 1);
        }
    }
    found
}

/// Points by their places: those near one are found without a look at all others.
struct Places {
    cell: f64,
    cells: HashMap<[i64; 2], Vec<usize>>,
}

impl Places {
    /// Of points, by their numbers; near is within `tolerance`.
    fn of(points: impl Iterator<Item = Zx>, tolerance: f64) -> Self {
        let mut places = Self { cell: tolerance.max(1e-9), cells: HashMap::new() };
        for (n, p) in points.enumerate() {
            let at = places.at(p);
            places.cells.entry(at).or_default().push(n);
        }
        places
    }

    fn at(&self, p: Zx) -> [i64; 2] {
        [p.z, p.x].map(|v| (v / self.cell).floor() as i64)
    }

    /// The numbers of the points around a place: all that are within the tolerance, and some more.
    fn around(&self, p: Zx) -> impl Iterator<Item = usize> {
        let [z, x] = self.at(p);
        let cells =
            (-1..=1).flat_map(move |i| (-1..=1).map(move |j| [z.saturating_add(i), x.saturating_add(j)]));
        cells.filter_map(|cell| self.cells.get(&cell)).flatten().copied()
    }

    /// How many those are.
    fn crowd(&self, p: Zx) -> usize {
        let [z, x] = self.at(p);
        let cells = (-1..=1).flat_map(|i| (-1..=1).map(move |j| [z.saturating_add(i), x.saturating_add(j)]));
        cells.filter_map(|cell| self.cells.get(&cell)).map(Vec::len).sum()
    }
}

struct Reader<'a> {
    file: &'a Path,
    lines: HashMap<String, usize>,
    unit: Unit,
    options: &'a Options<'a>,
}

impl Reader<'_> {
    /// Whether two points are one.
    fn near(&self, p: Zx, q: Zx) -> bool {
        #[cfg(test)]
        tests::LOOKS.with(|looks| looks.set(looks.get() + 1));
        (p - q).norm() <= self.options.tolerance_mm
    }

    fn point(&self, p: &dxf::Point) -> Zx {
        Zx::new(p.x, p.y) * self.unit.0
    }

    fn pieces(&self, entity: &Entity, out: &mut Vec<Piece>, cleaned: &mut Cleaned) -> Result<(), InputError> {
        let handle = entity.common.handle.as_string();
        // A drawing need not have any.
        let line = self.lines.get(&handle.to_ascii_lowercase()).copied().unwrap_or(0);
        let named = |kind: &str| format!("{kind} {handle} on layer {}", entity.common.layer);
        let refuse = |kind: &str, what: &str, expected: &str| {
            Err(InputError::at(self.file, line, 0, format!("{} {what}", named(kind)), expected))
        };
        // Seen from below, x runs the other way: the object coordinates of DXF for a downward normal.
        let mirror = |n: &Vector| if n.z < 0.0 { -1.0 } else { 1.0 };
        let flat = |n: &Vector, heights: &[f64]| {
            n.x.abs() < 1e-9 && n.y.abs() < 1e-9 && heights.iter().all(|z| z.abs() < 1e-6)
        };
        let (kind, in_plane, segments) = match &entity.specific {
            EntityType::Line(l) => {
                let s = Segment::Line { a: self.point(&l.p1), b: self.point(&l.p2) };
                ("LINE", flat(&Vector::z_axis(), &[l.p1.z, l.p2.z]), vec![s])
            }
            EntityType::Arc(a) => {
                let s = self.arc(a, mirror(&a.normal));
                ("ARC", flat(&a.normal, &[a.center.z]), vec![s])
            }
            // The greater axis is the major one (DXF, group code 40); a smaller ratio than this is a line.
            // One that is a line within the tolerance is taken as that, whatever its ratio.
            EntityType::Ellipse(e)
                if !(0.0..=1.0 + 1e-9).contains(&e.minor_axis_ratio) || self.is_too_flat(e) =>
            {
                let what = format!("with an axis ratio of {:e}", e.minor_axis_ratio);
                return refuse("ELLIPSE", &what, "a minor axis of 0.000001 to 1 times the major one");
            }
            EntityType::Ellipse(e) => {
                let s = self.ellipse(e, mirror(&e.normal));
                ("ELLIPSE", flat(&e.normal, &[e.center.z, e.major_axis.z]), vec![s])
            }
            EntityType::LwPolyline(p) => {
                let m = mirror(&p.extrusion_direction);
                let corners: Vec<(Zx, f64)> =
                    p.vertices.iter().map(|v| (Zx::new(m * v.x, v.y) * self.unit.0, m * v.bulge)).collect();
                (
                    "LWPOLYLINE",
                    flat(&p.extrusion_direction, &[]),
                    self.bulged(&corners, p.flags & 1 != 0, cleaned),
                )
            }
            EntityType::Polyline(p) => {
                let m = mirror(&p.normal);
                // The control points of a fitted curve stand beside it; they are not on it.
                let is_frame = |v: &&dxf::entities::Vertex| v.flags & FRAME != 0;
                let fitted = p.vertices().filter(|v| !is_frame(v)).count();
                let curve = || p.vertices().filter(|v| fitted == 0 || !is_frame(v));
                cleaned.frames += usize::from(fitted > 0 && curve().count() < p.vertices().count());
                let corners: Vec<(Zx, f64)> = curve()
                    .map(|v| (Zx::new(m * v.location.x, v.location.y) * self.unit.0, m * v.bulge))
                    .collect();
                let heights: Vec<f64> = curve().map(|v| v.location.z).collect();
                ("POLYLINE", flat(&p.normal, &heights), self.bulged(&corners, p.flags & 1 != 0, cleaned))
            }
            EntityType::Spline(s) => {
                let Some(spline) = self.spline(s) else {
                    let expected =
                        "control points with knots and positive weights, as CAD systems write them";
                    return refuse("SPLINE", "without a complete set of control points and knots", expected);
                };
                let heights: Vec<f64> = s.control_points.iter().map(|p| p.z).collect();
                ("SPLINE", flat(&s.normal, &heights), vec![Segment::Spline(spline)])
            }
            EntityType::Circle(c) if TAU * c.radius.abs() * self.unit.0 <= self.options.tolerance_mm => {
                cleaned.specks += 1;
                return Ok(());
            }
            EntityType::Circle(_) => {
                return refuse("CIRCLE", "in the contour", "the half profile above the axis: an arc of it");
            }
            other => {
                let name = format!("{other:?}");
                let name = name.split(['(', ' ']).next().unwrap_or_default().to_uppercase();
                return refuse(&name, "in the contour", "lines, arcs, ellipses, splines and polylines");
            }
        };
        if !in_plane {
            return refuse(kind, "out of the drawing's plane", "a flat drawing at elevation 0");
        }
        for segment in segments {
            if self.is_speck(&segment) {
                cleaned.specks += 1;
                cleaned.speck.get_or_insert_with(|| (line, named(kind)));
                continue;
            }
            let segment = rounded(self.straightened(segment, cleaned), self.flat_mm(), cleaned);
            if let Some((what, expected)) = self.unfit(&segment) {
                return refuse(kind, what, expected);
            }
            out.push(Piece { segment, entity: named(kind), line });
        }
        Ok(())
    }

    /// `mirror` is −1 for an arc that is seen from below.
    fn arc(&self, a: &dxf::entities::Arc, mirror: f64) -> Segment {
        let sweep = (a.end_angle - a.start_angle).rem_euclid(360.0).to_radians();
        let start = a.start_angle.to_radians();
        let mut centre = self.point(&a.center);
        centre.z *= mirror;
        Segment::Arc {
            centre,
            radius_mm: a.radius * self.unit.0,
            start_rad: if mirror < 0.0 { PI - start } else { start },
            sweep_rad: mirror * if sweep == 0.0 { TAU } else { sweep },
        }
    }

    /// `mirror` is −1 for an ellipse that is seen from below.
    fn ellipse(&self, e: &dxf::entities::Ellipse, mirror: f64) -> Segment {
        let sweep = (e.end_parameter - e.start_parameter).rem_euclid(TAU);
        Segment::Ellipse {
            centre: self.point(&e.center),
            major: Zx::new(e.major_axis.x, e.major_axis.y) * self.unit.0,
            ratio: mirror * e.minor_axis_ratio,
            start_rad: e.start_parameter,
            sweep_rad: if sweep == 0.0 { TAU } else { sweep },
        }
    }

    /// So small a ratio that it is no ellipse, and no line or speck either.
    fn is_too_flat(&self, e: &dxf::entities::Ellipse) -> bool {
        let segment = self.ellipse(e, 1.0);
        e.minor_axis_ratio < 1e-6 && !self.is_speck(&segment) && !self.is_line(&segment)
    }

    /// Why a piece is none of a part's contour: what, expected.
    fn unfit(&self, segment: &Segment) -> Option<(&'static str, &'static str)> {
        let chords = segment.polyline();
        if !chords.iter().all(|p| p.z.is_finite() && p.x.is_finite()) {
            Some(("with a coordinate that is no number", "finite coordinates"))
        } else if chords.iter().any(|p| p.z.abs().max(p.x.abs()) > FARTHEST_MM) {
            Some(("more than 100 m from the origin", "a part that a machine could hold"))
        } else if chords.iter().any(|p| p.x < -self.options.tolerance_mm) {
            Some(("below the axis", "the half profile at Y ≥ 0"))
        } else {
            None
        }
    }

    /// A piece that is no longer than the tolerance: its neighbours meet without it.
    fn is_speck(&self, segment: &Segment) -> bool {
        segment.length_mm() <= self.options.tolerance_mm
    }

    /// The most that an arc which is taken as straight leaves its chord, mm.
    fn flat_mm(&self) -> f64 {
        self.options.tolerance_mm * FLAT
    }

    /// A piece so flat that it is straight, as a line.
    fn straightened(&self, segment: Segment, cleaned: &mut Cleaned) -> Segment {
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

    /// Whether a piece goes along its chord, nowhere back, and leaves it by no more than [`Self::flat_mm`].
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

    /// Lines and arcs of a polyline; a bulge is the tangent of a quarter of its arc's angle. A vertex within the tolerance of
    /// the one before it is the same vertex.
    fn bulged(&self, corners: &[(Zx, f64)], closed: bool, cleaned: &mut Cleaned) -> Vec<Segment> {
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
                // Before the centre is worked out, which lies as far away as the bulge is small.
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

    /// The way from one vertex to the next is no longer than the tolerance: the arc of a large bulge is.
    fn is_doubled(&self, from: Zx, bulge: f64, to: Zx) -> bool {
        let chord = (to - from).norm();
        let way = if bulge == 0.0 { 1.0 } else { (1.0 + bulge * bulge) * bulge.atan() / bulge };
        chord * way <= self.options.tolerance_mm
    }

    fn spline(&self, s: &dxf::entities::Spline) -> Option<Spline> {
        let n = s.control_points.len();
        let degree = usize::try_from(s.degree_of_curve).ok()?;
        let weights = if s.weight_values.is_empty() { vec![1.0; n] } else { s.weight_values.clone() };
        let whole = degree >= 1
            && n > degree
            && s.knot_values.len() == n + degree + 1
            && s.knot_values.windows(2).all(|k| k[0] <= k[1])
            && s.knot_values[degree] < s.knot_values[n]
            && weights.len() == n
            && weights.iter().all(|w| w.is_finite() && *w > 0.0);
        let points = s.control_points.iter().map(|p| self.point(p)).collect();
        whole.then(|| Spline { degree, knots: s.knot_values.clone(), points, weights })
    }

    fn twice(&self, pieces: &[Piece]) -> Result<(), InputError> {
        let tolerance = self.options.tolerance_mm;
        let starts = Places::of(pieces.iter().flat_map(Piece::ends), tolerance);
        let middles = Places::of(pieces.iter().map(|p| p.segment.at(0.5)), tolerance);
        for (i, a) in pieces.iter().enumerate() {
            let ([a0, a1], middle) = (a.ends(), a.segment.at(0.5));
            let same = |j: &usize| {
                let [b0, b1] = pieces[*j].ends();
                let ends = self.near(a0, b0) && self.near(a1, b1) || self.near(a0, b1) && self.near(a1, b0);
                ends && self.near(middle, pieces[*j].segment.at(0.5))
            };
            // By the place where fewest others are: many may meet in one point, or lie across another.
            let crowds = [starts.crowd(a0), starts.crowd(a1), middles.crowd(middle)];
            let first = match crowds.iter().min() {
                Some(least) if *least == crowds[2] => {
                    middles.around(middle).filter(|j| *j < i).filter(same).min()
                }
                least => {
                    let end = if least == Some(&crowds[0]) { a0 } else { a1 };
                    starts.around(end).map(|end| end / 2).filter(|j| *j < i).filter(same).min()
                }
            };
            if let Some(j) = first {
                let found = format!("{}, a duplicate of {}", a.entity, pieces[j].entity);
                return Err(InputError::at(self.file, a.line, 0, found, "every entity once"));
            }
        }
        Ok(())
    }

    /// Order the pieces along the contour.
    fn chain(&self, pieces: Vec<Piece>) -> Result<Contour, InputError> {
        let tol = self.options.tolerance_mm;
        // What lies on the axis closes a drawing but is no surface.
        let on_axis =
            |p: &Piece| matches!(p.segment, Segment::Line { a, b } if a.x.abs() <= tol && b.x.abs() <= tol);
        let (axis, rest): (Vec<Piece>, Vec<Piece>) = pieces.into_iter().partition(on_axis);
        if rest.is_empty() {
            return Err(InputError::whole(self.file, "nothing but the axis", "the part's contour"));
        }
        let ends: Vec<(usize, Zx)> =
            rest.iter().enumerate().flat_map(|(i, p)| p.ends().map(|e| (i, e))).collect();
        let places = Places::of(ends.iter().map(|(_, at)| *at), tol);
        // Two say as much as more.
        let met = |k: usize| {
            let others = places.around(ends[k].1).filter(|j| *j != k);
            others.filter(|j| self.near(ends[*j].1, ends[k].1)).take(2).count()
        };
        if let Some(k) = (0..ends.len()).find(|&k| met(k) > 1) {
            let (i, at) = ends[k];
            let found = format!(
                "a branch at {}: more than two entities meet ({} is one)",
                self.words(at),
                rest[i].entity
            );
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
                return Err(InputError::at(
                    self.file,
                    piece.line,
                    0,
                    found,
                    "a contour that returns to the axis",
                ));
            }
        }
        let mut tail = free.first().map_or(ends[0].1, |&k| ends[k].1);
        let mut chain = Vec::with_capacity(rest.len());
        let mut rest: Vec<Option<Piece>> = rest.into_iter().map(Some).collect();
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
            return Err(InputError::at(
                self.file,
                left.line,
                0,
                found,
                "one contour, or --layer to choose it",
            ));
        }
        Ok(Contour::new(chain, closed))
    }

    fn gap(&self, rest: &[Piece], ends: &[(usize, Zx)], free: &[usize]) -> InputError {
        // In the order of their places along the drawing's longer side, where near ones follow each other.
        let side = |of: &dyn Fn(Zx) -> f64| {
            let all = free.iter().map(|k| of(ends[*k].1));
            all.clone().fold(f64::NEG_INFINITY, f64::max) - all.fold(f64::INFINITY, f64::min)
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
                // Of several the one that comes first in the drawing.
                let (first, second) = (a.min(b), a.max(b));
                if ends[a].0 != ends[b].0 && (off, second, first) < (least.0, least.2, least.1) {
                    least = (off, first, second);
                }
            }
        }
        let (off, a, b) = least;
        let (first, second) = (&rest[ends[a].0], &rest[ends[b].0]);
        let what = if self.overlap(first, second) { "an overlap" } else { "a gap" };
        let found = format!(
            "an open contour: {what} of {:.4} units between {} at {} and {} at {}",
            off / self.unit.0,
            first.entity,
            self.words(ends[a].1),
            second.entity,
            self.words(ends[b].1)
        );
        InputError::at(self.file, second.line.max(first.line), 0, found, "entities that meet end to end")
    }

    /// Whether two lines lie on one another over some length.
    fn overlap(&self, first: &Piece, second: &Piece) -> bool {
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
        /// Pairs of points that were compared.
        pub(super) static LOOKS: Cell<u64> = const { Cell::new(0) };
    }

    /// Reads lines that are drawn in this order; the finding, and pairs of points compared.
    fn reads(lines: &[[f64; 4]]) -> (Result<usize, String>, u64) {
        let mut drawing = new_dxf();
        for [z0, x0, z1, x1] in lines {
            let ends =
                dxf::entities::Line::new(dxf::Point::new(*z0, *x0, 0.0), dxf::Point::new(*z1, *x1, 0.0));
            drawing.add_entity(Entity::new(EntityType::Line(ends)));
        }
        let directory = tempfile::tempdir().unwrap();
        let file = directory.path().join("a.dxf");
        drawing.save_file(&file).unwrap();
        LOOKS.with(|looks| looks.set(0));
        let read = read(&file, &Options::default());
        let found = read.map(|(contour, _)| contour.chords().len()).map_err(|e| e.found);
        (found, LOOKS.with(Cell::get))
    }

    #[test]
    fn work_grows_with_the_drawing_and_not_with_its_square() {
        let n = 20_000_u32;
        let step = |i: u32| f64::from(i) * 0.01;
        // A profile in a jumbled order, every second line drawn backwards.
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
        // All in one point; all across one point; none that meet; one that is there twice.
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
