//! Blocks that a drawing inserts, and the placement of their entities.
//!
//! Source: Autodesk, DXF reference, "BLOCKS section" and "INSERT".

use crate::contour::{Segment, Spline};
use crate::dxf::{Drawing, Entity};
use crate::geometric_fit::Zx;
use rtec_files::InputError;
use std::f64::consts::FRAC_PI_2;
use std::path::Path;

/// Deepest nesting of blocks; a block that contains itself would have no end.
const DEEPEST: usize = 16;
/// Largest number of entities: rows and columns of inserted blocks multiply.
const MOST: usize = 100_000;

/// A linear map of the plane and a shift.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct AffineMap {
    /// The images of the unit vectors of z and x.
    axes: [Zx; 2],
    shift: Zx,
}

impl AffineMap {
    /// The identity: nothing moves.
    pub(super) const HERE: Self =
        Self { axes: [Zx { z: 1.0, x: 0.0 }, Zx { z: 0.0, x: 1.0 }], shift: Zx { z: 0.0, x: 0.0 } };

    fn vector(&self, v: Zx) -> Zx {
        self.axes[0] * v.z + self.axes[1] * v.x
    }

    fn point(&self, p: Zx) -> Zx {
        self.vector(p) + self.shift
    }

    /// This placement followed by an outer one.
    fn within(&self, outer: &Self) -> Self {
        Self { axes: self.axes.map(|axis| outer.vector(axis)), shift: outer.point(self.shift) }
    }

    /// The placement of a block in one column and row of an INSERT.
    /// `base` is the block's base point.
    fn of(insert: &Entity, base: Zx, [column, row]: [f64; 2], mm: f64) -> Self {
        let value = |code: i32, default: f64| insert.number(code).unwrap_or(default);
        let (sin, cos) = value(50, 0.0).to_radians().sin_cos();
        // Seen from below, x is reversed.
        let mirror = if insert.normal()[2] < 0.0 { -1.0 } else { 1.0 };
        let turned = |p: Zx| Zx::new(mirror * (cos * p.z - sin * p.x), sin * p.z + cos * p.x);
        let axes = [Zx::new(value(41, 1.0), 0.0), Zx::new(0.0, value(42, 1.0))].map(turned);
        let [x, y, _] = insert.point(10);
        let step = turned(Zx::new(column * value(44, 0.0), row * value(45, 0.0)));
        let linear = Self { axes, shift: Zx::new(0.0, 0.0) };
        let shift = (Zx::new(mirror * x, y) + step - linear.vector(base)) * mm;
        Self { shift, ..linear }
    }

    /// A piece at this placement.
    /// An arc becomes a piece of an ellipse if the map distorts it.
    pub(super) fn put(&self, segment: Segment) -> Segment {
        if *self == Self::HERE {
            return segment;
        }
        let [u, v] = self.axes;
        match segment {
            Segment::Line { a, b } => Segment::Line { a: self.point(a), b: self.point(b) },
            Segment::Spline(spline) => {
                let points = spline.points.iter().map(|p| self.point(*p)).collect();
                Segment::Spline(Spline { points, ..spline })
            }
            Segment::Arc { centre, radius_mm, start_rad, sweep_rad } => {
                let keeps =
                    u.dot(v).abs() <= ROUND * u.dot(u) && (u.norm() - v.norm()).abs() <= ROUND * u.norm();
                if keeps {
                    let (turn, sign) = (u.angle_rad(), cross(u, v).signum());
                    return Segment::Arc {
                        centre: self.point(centre),
                        radius_mm: radius_mm * u.norm(),
                        start_rad: turn + sign * start_rad,
                        sweep_rad: sign * sweep_rad,
                    };
                }
                self.ellipse(centre, [Zx::new(radius_mm, 0.0), Zx::new(0.0, radius_mm)], start_rad, sweep_rad)
            }
            Segment::Ellipse { centre, major, ratio, start_rad, sweep_rad } => {
                let minor = Zx::new(-major.x, major.z) * ratio;
                self.ellipse(centre, [major, minor], start_rad, sweep_rad)
            }
        }
    }

    /// The image of an ellipse with these perpendicular half diameters.
    /// Their images are conjugate half diameters, from which the axes follow.
    fn ellipse(&self, centre: Zx, halves: [Zx; 2], start_rad: f64, sweep_rad: f64) -> Segment {
        let [p, q] = halves.map(|half| self.vector(half));
        let turn = 0.5 * (2.0 * p.dot(q)).atan2(p.dot(p) - q.dot(q));
        let axes = |turn: f64| [p * turn.cos() + q * turn.sin(), q * turn.cos() - p * turn.sin()];
        let longer = if axes(turn)[0].norm() < axes(turn)[1].norm() { turn + FRAC_PI_2 } else { turn };
        let [major, minor] = axes(longer);
        let (ratio, centre) = (cross(major, minor) / major.dot(major), self.point(centre));
        Segment::Ellipse { centre, major, ratio, start_rad: start_rad - longer, sweep_rad }
    }
}

/// Scales that differ by less count as equal.
const ROUND: f64 = 1e-9;

fn cross(a: Zx, b: Zx) -> f64 {
    a.z * b.x - a.x * b.z
}

/// An entity of the drawing itself or of an inserted block.
#[derive(Debug, Clone, Copy)]
pub(super) struct PlacedEntity<'d> {
    pub(super) entity: &'d Entity,
    pub(super) layer: &'d str,
    pub(super) place: AffineMap,
    /// The layer of an insertion that hides it, if any.
    pub(super) hidden_by: Option<&'d str>,
}

/// All entities of a drawing, including those of inserted blocks.
///
/// # Errors
/// A block that is missing, one that contains itself, or more entities than a contour has.
pub(super) fn placed<'d>(
    file: &Path,
    drawing: &'d Drawing,
    mm: f64,
    is_hidden: &dyn Fn(&str) -> bool,
) -> Result<Vec<PlacedEntity<'d>>, InputError> {
    let mut out = Vec::new();
    let mut open: Vec<(PlacedEntity<'d>, usize)> = Vec::new();
    let own = drawing.entities.iter().filter(|e| !e.in_paper_space);
    let here = own.map(|entity| PlacedEntity {
        entity,
        layer: &entity.layer,
        place: AffineMap::HERE,
        hidden_by: None,
    });
    open.extend(here.map(|placed| (placed, 0)).rev());
    while let Some((placed, depth)) = open.pop() {
        let PlacedEntity { entity, layer, .. } = placed;
        if entity.kind != "INSERT" {
            out.push(placed);
            continue;
        }
        let name = entity.name();
        let refuse =
            |found: String, expected: &str| Err(InputError::at(file, entity.line, 0, found, expected));
        let Some(block) = drawing.blocks.iter().find(|b| b.name.eq_ignore_ascii_case(name)) else {
            let found = format!("INSERT of the block '{name}'");
            return refuse(found, "a block of the drawing's BLOCKS section");
        };
        let count = |code: i32| entity.number(code).map_or(1, |n| (n as usize).clamp(1, MOST));
        let copies = count(70).saturating_mul(count(71));
        if depth >= DEEPEST || copies.saturating_mul(block.entities.len()) + open.len() + out.len() > MOST {
            let found = format!("INSERT of the block '{name}' {depth} blocks deep, {copies} times");
            return refuse(found, "blocks that do not hold themselves, with fewer than 100000 entities");
        }
        let base = Zx::new(block.base[0], block.base[1]);
        let unseen = placed.hidden_by.or_else(|| (!entity.visible || is_hidden(layer)).then_some(layer));
        for n in (0..copies).rev() {
            let at = [n % count(70), n / count(70)].map(|n| n as f64);
            let place = AffineMap::of(entity, base, at, mm).within(&placed.place);
            // Entities on a block's layer 0 are on the layer of the insertion.
            let of = |entity: &'d Entity| {
                let layer = if entity.layer == "0" { layer } else { entity.layer.as_str() };
                (PlacedEntity { entity, layer, place, hidden_by: unseen }, depth + 1)
            };
            open.extend(block.entities.iter().rev().map(of));
        }
    }
    Ok(out)
}
