//! The finish cut's corrections (NISTIR 4854, section 5).
//! Errors by angle become requested counts by machine position.

use crate::error_cor_file::{PointError, turned_near};
use crate::geometric_fit::Zx;
use serde::Serialize;
use std::fmt::Write as _;

/// The effect of the corrector's counts on one axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisCountConversion {
    /// The length of one count.
    pub count_um: f64,
    /// Counts of one insertion.
    /// There are 2 for Design C, 4 for the Original RTEC and Design A, 1 for Design B.
    pub increment: i64,
    /// +1 if the axis counts up in the part's positive direction, otherwise −1.
    pub sign: f64,
}

impl AxisCountConversion {
    /// Length of one insertion.
    pub fn increment_um(&self) -> f64 {
        self.count_um * self.increment as f64
    }

    /// Requested total that removes an error.
    /// An axis stops short by the additional counts that the MTC sees. So too much material needs counts of
    /// its own sign.
    pub fn requested(&self, error_um: f64) -> i64 {
        (self.sign * error_um / self.increment_um()).round() as i64 * self.increment
    }

    /// Displacement of the axis by a requested total, in µm: the removed error.
    pub fn taken_um(&self, requested: i64) -> f64 {
        self.sign * requested as f64 * self.count_um
    }
}

/// The arc of the finish cut, and the machine positions along it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FinishCutArc {
    /// Centre of the arc in part coordinates.
    pub centre: Zx,
    /// Radius of the finished surface.
    pub radius_mm: f64,
    /// Radius of the tool's nose: its centre runs on the larger arc.
    /// Negative in a hollow arc, where it runs inside.
    pub nose_mm: f64,
    /// Machine position at which the nose's centre is at the part's origin.
    /// It consists of work offset and tool dimensions.
    pub origin: Zx,
}

impl FinishCutArc {
    /// Machine position while the surface at this angle is cut.
    pub fn machine_at(&self, angle_rad: f64) -> Zx {
        self.part_at(angle_rad) + self.origin
    }

    /// Centre of the tool's nose at this angle, in part coordinates.
    pub fn part_at(&self, angle_rad: f64) -> Zx {
        self.centre + Zx::at_angle(angle_rad) * (self.radius_mm + self.nose_mm)
    }

    /// The surface angle that is cut at a machine position.
    pub fn angle_at(&self, machine: Zx) -> f64 {
        (machine - self.origin - self.centre).angle_rad()
    }
}

/// One line of the table.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FinishCutCorrectionRow {
    /// Angle of the surface that is cut.
    pub angle_rad: f64,
    /// Error to remove, interpolated between the probed points.
    pub error_um: f64,
    /// The centre of the tool's nose in part coordinates.
    pub part_mm: Zx,
    /// Machine position at that moment.
    pub machine_mm: Zx,
    /// Requested totals `[z, x]`, in counts.
    pub requested: [i64; 2],
    /// The error along the surface's normal that the counts cannot remove, in µm.
    pub left_um: f64,
}

impl FinishCutCorrectionRow {
    /// The row at a place, with the totals of both axes for its error.
    pub(crate) fn new(
        axes: &[AxisCountConversion; 2],
        angle_rad: f64,
        error_um: f64,
        part_mm: Zx,
        origin: Zx,
    ) -> Self {
        let n = Zx::at_angle(angle_rad);
        let requested = requested(axes, n * error_um);
        let taken = Zx::new(axes[0].taken_um(requested[0]), axes[1].taken_um(requested[1]));
        let left_um = error_um - taken.dot(n);
        Self { angle_rad, error_um, part_mm, machine_mm: part_mm + origin, requested, left_um }
    }
}

fn requested(axes: &[AxisCountConversion; 2], components_um: Zx) -> [i64; 2] {
    [axes[0].requested(components_um.z), axes[1].requested(components_um.x)]
}

/// The error at a place, linear between points `(place, error)`.
/// Their places ascend. Beyond them the end values apply, and without points it is zero.
pub(crate) fn interpolated<T>(points: &[T], of: impl Fn(&T) -> (f64, f64), at: f64) -> f64 {
    let next = points.partition_point(|p| of(p).0 <= at);
    match (next.checked_sub(1).map(|i| of(&points[i])), points.get(next).map(&of)) {
        (Some((a, a_um)), Some((b, b_um))) => a_um + (at - a) / (b - a) * (b_um - a_um),
        (Some((_, um)), None) | (None, Some((_, um))) => um,
        (None, None) => 0.0,
    }
}

/// Errors by angle, ready for the finish cut.
#[derive(Debug, Clone)]
pub struct ArcFinishCutTable {
    /// The arc that is cut.
    pub cut: FinishCutArc,
    /// The counts of Z and of X.
    pub axes: [AxisCountConversion; 2],
    errors: Vec<PointError>,
}

impl ArcFinishCutTable {
    /// A table from the errors of the semi-finish cut.
    /// Their angles ascend, as [`crate::error_cor_file::read_arc`] reads them.
    pub fn new(cut: FinishCutArc, axes: [AxisCountConversion; 2], mut errors: Vec<PointError>) -> Self {
        errors.sort_by(|a, b| a.angle_rad.total_cmp(&b.angle_rad));
        Self { cut, axes, errors }
    }

    /// The errors that it was made from, angles ascending.
    pub fn errors(&self) -> &[PointError] {
        &self.errors
    }

    /// Number of probed points in the table.
    pub fn points(&self) -> usize {
        self.errors.len()
    }

    /// Error at an angle, µm, linear between the probed points.
    /// Beyond them the end values apply, so that there is no step where the tool enters.
    pub fn error_um(&self, angle_rad: f64) -> f64 {
        let (Some(first), Some(last)) = (self.errors.first(), self.errors.last()) else { return 0.0 };
        // On an arc across ±π an angle from a direction may be a turn away from the table's.
        let angle_rad = turned_near(angle_rad, f64::midpoint(first.angle_rad, last.angle_rad));
        interpolated(&self.errors, |e| (e.angle_rad, e.error_um), angle_rad)
    }

    /// Components of the error, µm, at the machine position reached in `lead_s`.
    /// The velocity is in mm/s. The error is evaluated ahead, so that the counts are inserted when the tool
    /// cuts there. The geometric-thermal model is added before the sum is converted to counts.
    pub fn components_um(&self, machine: Zx, velocity_mm_s: Zx, lead_s: f64) -> Zx {
        let angle_rad = self.cut.angle_at(machine + velocity_mm_s * lead_s);
        Zx::at_angle(angle_rad) * self.error_um(angle_rad)
    }

    /// Requested totals `[z, x]` for components in µm.
    pub fn requested(&self, components_um: Zx) -> [i64; 2] {
        requested(&self.axes, components_um)
    }

    /// The table: a row at each probed point, and `between` rows between neighbours.
    pub fn rows(&self, between: usize) -> Vec<FinishCutCorrectionRow> {
        let steps = between + 1;
        let mut angles: Vec<f64> = Vec::new();
        for pair in self.errors.windows(2) {
            let (a, b) = (pair[0].angle_rad, pair[1].angle_rad);
            angles.extend((0..steps).map(|k| a + (b - a) * k as f64 / steps as f64));
        }
        angles.extend(self.errors.last().map(|e| e.angle_rad));
        let row = |angle_rad: f64| {
            let (error_um, part_mm) = (self.error_um(angle_rad), self.cut.part_at(angle_rad));
            FinishCutCorrectionRow::new(&self.axes, angle_rad, error_um, part_mm, self.cut.origin)
        };
        angles.into_iter().map(row).collect()
    }

    /// The same compensation as end points of straight moves for the NC program.
    /// Each move stays within `off_mm` of the corrected path, with coordinates rounded to `decimals`. Points
    /// are in part coordinates; the first is where the cut starts.
    pub fn straight_moves(&self, off_mm: f64, decimals: i32) -> Vec<Zx> {
        let (Some(first), Some(last)) = (self.errors.first(), self.errors.last()) else { return Vec::new() };
        let scale = 10_f64.powi(decimals);
        let corner = |angle: f64| {
            let p = self.cut.part_at(angle) - Zx::at_angle(angle) * (self.error_um(angle) * 1e-3);
            Zx::new((p.z * scale).round() / scale, (p.x * scale).round() / scale)
        };
        let radius_mm = self.cut.radius_mm + self.cut.nose_mm;
        let plain_rad = 2.0 * (1.0 - off_mm / radius_mm).clamp(-1.0, 1.0).acos();
        let (mut from, mut at) = (first.angle_rad, corner(first.angle_rad));
        let mut corners = vec![at];
        while from < last.angle_rad && corners.len() <= MAX_MOVES {
            let fits = |to: f64| self.chord_off_mm([from, to], [at, corner(to)]) <= off_mm * SAMPLED;
            // Moves are not longer than on the plain arc, even if a hollow of the errors allows it, so that
            // the feed stays even.
            let mut long = last.angle_rad.min(from + plain_rad);
            let mut short = if fits(long) { long } else { from };
            while long - short > 1e-6 * plain_rad {
                let middle = f64::midpoint(short, long);
                if fits(middle) { short = middle } else { long = middle }
            }
            // If rounding alone exceeds the allowance, it continues nevertheless.
            from = if short > from { short } else { last.angle_rad.min(from + 0.1 * plain_rad) };
            at = corner(from);
            corners.push(at);
        }
        corners
    }

    /// Largest distance of a chord from the corrected path, along the radius.
    fn chord_off_mm(&self, [from, to]: [f64; 2], ends: [Zx; 2]) -> f64 {
        let [a, b] = ends.map(|p| p - self.cut.centre);
        let cross = |p: Zx, q: Zx| p.z * q.x - p.x * q.z;
        let kinks = self.errors.iter().map(|e| e.angle_rad).filter(|k| (from..to).contains(k));
        let even = (0..=SAMPLES).map(|k| from + (to - from) * f64::from(k) / f64::from(SAMPLES));
        even.chain(kinks).fold(0.0, |worst, angle| {
            let chord_mm = cross(a, b) / cross(Zx::at_angle(angle), b - a);
            let path_mm = self.cut.radius_mm + self.cut.nose_mm - self.error_um(angle) * 1e-3;
            (chord_mm - path_mm).abs().max(worst)
        })
    }
}

/// Number of checked places along a chord.
const SAMPLES: u32 = 32;
/// Share of the allowance that is safe between the checked places.
const SAMPLED: f64 = 0.998;
/// Largest number of straight moves in a program.
const MAX_MOVES: usize = 100_000;

/// The columns of a finish cut's table.
const HEADER: &str = "angle_rad,error_um,part_z_mm,part_x_mm,machine_z_mm,machine_x_mm,send_z_mm,send_x_mm,\
                                 requested_z,requested_x,left_um\n";

/// The table as CSV.
/// `lead_mm` is the distance before each position, along the cut, at which its totals are sent. The cut runs
/// towards larger angles, or with `backwards` towards smaller ones.
pub fn csv(
    table: &ArcFinishCutTable,
    rows: &[FinishCutCorrectionRow],
    lead_mm: f64,
    backwards: bool,
) -> String {
    let lead_rad = lead_mm / (table.cut.radius_mm + table.cut.nose_mm) * if backwards { 1.0 } else { -1.0 };
    csv_of(rows, |r| table.cut.machine_at(r.angle_rad + lead_rad))
}

/// The rows as CSV.
/// `send_at` is the machine position at which a row's totals are sent.
pub(crate) fn csv_of(
    rows: &[FinishCutCorrectionRow],
    send_at: impl Fn(&FinishCutCorrectionRow) -> Zx,
) -> String {
    let mut text = HEADER.to_owned();
    for r in rows {
        let send = send_at(r);
        let FinishCutCorrectionRow { angle_rad, error_um, part_mm, machine_mm, requested: [z, x], left_um } =
            r;
        let _ = writeln!(
            text,
            "{angle_rad:.6},{error_um:.3},{:.5},{:.5},{:.5},{:.5},{:.5},{:.5},{z},{x},{left_um:.3}",
            part_mm.z, part_mm.x, machine_mm.z, machine_mm.x, send.z, send.x
        );
    }
    text
}
