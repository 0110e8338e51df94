//! The finish cut of a straight feature: errors by place become requested counts.

use crate::arc_finish_cut_table::{AxisCountConversion, FinishCutCorrectionRow, csv_of, interpolated};
use crate::error_cor_file::StraightFeaturePointError;
use crate::geometric_fit::Zx;

/// A straight feature's errors, ready for its finish cut.
#[derive(Debug, Clone)]
pub struct StraightFinishCutTable {
    /// Errors by place, places ascending.
    pub errors: Vec<StraightFeaturePointError>,
    /// The counts of Z and of X.
    pub axes: [AxisCountConversion; 2],
    /// Radius of the tool's nose, mm: the distance of its centre from the surface.
    pub nose_mm: f64,
    /// Machine position at which the nose's centre is at the part's origin.
    pub origin: Zx,
}

impl StraightFinishCutTable {
    /// Direction of the surface normal, and along the feature towards larger places.
    fn directions(&self) -> (Zx, Zx) {
        let n = self.errors.first().map_or(Zx::new(0.0, 0.0), |e| Zx::at_angle(e.angle_rad));
        let way = self.errors.last().zip(self.errors.first()).map(|(b, a)| b.place - a.place);
        let along = n.along();
        (n, along * way.map_or(1.0, |w| w.dot(along).signum()))
    }

    /// A machine position relative to the feature's first point, mm.
    /// Returns the place along the feature, and the distance from the line of the nose's centre.
    fn at(&self, machine: Zx) -> [f64; 2] {
        let (n, along) = self.directions();
        let first = self.errors.first().map_or(Zx::new(0.0, 0.0), |e| e.place);
        let from = machine - self.origin - first;
        [from.dot(along), from.dot(n) - self.nose_mm]
    }

    /// Error at a distance from the first point, µm.
    /// It is linear between the probed points; beyond them the end values apply.
    pub fn error_um(&self, from_first_mm: f64) -> f64 {
        let Some(first) = self.errors.first() else { return 0.0 };
        interpolated(&self.errors, |e| (e.along_mm, e.error_um), first.along_mm + from_first_mm)
    }

    /// Components of the error, in µm, at a predicted machine position.
    /// It is reached in `lead_s` at a velocity in mm/s. For an arc see
    /// [`crate::arc_finish_cut_table::ArcFinishCutTable::components_um`].
    pub fn components_um(&self, machine: Zx, velocity_mm_s: Zx, lead_s: f64) -> Zx {
        let [along_mm, _] = self.at(machine + velocity_mm_s * lead_s);
        self.directions().0 * self.error_um(along_mm)
    }

    /// Distance of a machine position from the line segment of the nose's centre, mm.
    pub fn off_mm(&self, machine: Zx) -> f64 {
        let [along_mm, off_mm] = self.at(machine);
        let length_mm = match (self.errors.first(), self.errors.last()) {
            (Some(a), Some(b)) => b.along_mm - a.along_mm,
            _ => 0.0,
        };
        off_mm.hypot((along_mm - length_mm).max(-along_mm).max(0.0))
    }

    /// The table: a row at each probed point, and `between` rows between neighbours.
    pub fn rows(&self, between: usize) -> Vec<FinishCutCorrectionRow> {
        let steps = between + 1;
        let mut places: Vec<(f64, Zx, f64)> = Vec::new();
        for pair in self.errors.windows(2) {
            let (a, b) = (&pair[0], &pair[1]);
            places.extend((0..steps).map(|k| {
                let part = k as f64 / steps as f64;
                let error_um = a.error_um + part * (b.error_um - a.error_um);
                (a.angle_rad, a.place + (b.place - a.place) * part, error_um)
            }));
        }
        places.extend(self.errors.last().map(|e| (e.angle_rad, e.place, e.error_um)));
        let row = |(angle_rad, place, error_um): (f64, Zx, f64)| {
            let part_mm = place + Zx::at_angle(angle_rad) * self.nose_mm;
            FinishCutCorrectionRow::new(&self.axes, angle_rad, error_um, part_mm, self.origin)
        };
        places.into_iter().map(row).collect()
    }

    /// The same compensation as corners of straight moves in the NC program.
    /// They are in part coordinates.
    pub fn straight_moves(&self) -> Vec<Zx> {
        let corner = |e: &StraightFeaturePointError| {
            e.place + Zx::at_angle(e.angle_rad) * (self.nose_mm - e.error_um * 1e-3)
        };
        self.errors.iter().map(corner).collect()
    }

    /// The table as CSV, with the columns of [`crate::arc_finish_cut_table::csv`].
    /// `lead_mm` is the distance before each position at which its totals are sent. The cut runs towards
    /// larger places, or with `backwards` towards smaller ones.
    pub fn csv(&self, rows: &[FinishCutCorrectionRow], lead_mm: f64, backwards: bool) -> String {
        let way = match (self.errors.first(), self.errors.last()) {
            (Some(a), Some(b)) => (b.place - a.place).unit().unwrap_or(Zx::new(0.0, 0.0)),
            _ => Zx::new(0.0, 0.0),
        };
        let lead = way * if backwards { lead_mm } else { -lead_mm };
        csv_of(rows, |r| r.machine_mm + lead)
    }
}
