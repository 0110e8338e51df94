//! The finish cut of a straight feature: errors by place become requested counts by machine position.

use crate::errors::LineError;
use crate::fit::Zx;
use crate::table::{AxisCounts, FinishRow};
use std::fmt::Write as _;

/// A straight feature's errors, ready for its finish cut.
#[derive(Debug, Clone)]
pub struct LineTable {
    /// Errors by place, places ascending.
    pub errors: Vec<LineError>,
    /// Counts of Z and of X.
    pub axes: [AxisCounts; 2],
    /// Radius of the tool's nose, mm: its centre runs so far outside the surface.
    pub nose_mm: f64,
    /// Machine position at which the nose's centre is at the part's origin.
    pub origin: Zx,
}

impl LineTable {
    /// The table: at each probed point and `between` steps between each two.
    #[must_use]
    pub fn rows(&self, between: usize) -> Vec<FinishRow> {
        let steps = between + 1;
        let mut places: Vec<(f64, Zx, f64)> = Vec::new();
        for pair in self.errors.windows(2) {
            let (a, b) = (&pair[0], &pair[1]);
            places.extend((0..steps).map(|k| {
                let part = k as f64 / steps as f64;
                (
                    a.angle_rad,
                    a.place + (b.place - a.place) * part,
                    a.error_um + part * (b.error_um - a.error_um),
                )
            }));
        }
        places.extend(self.errors.last().map(|e| (e.angle_rad, e.place, e.error_um)));
        let row = |(angle_rad, place, error_um): (f64, Zx, f64)| {
            let n = Zx::at_angle(angle_rad);
            let part_mm = place + n * self.nose_mm;
            let wanted = n * error_um;
            let requested = [self.axes[0].requested(wanted.z), self.axes[1].requested(wanted.x)];
            let taken = Zx::new(self.axes[0].taken_um(requested[0]), self.axes[1].taken_um(requested[1]));
            let left_um = error_um - taken.dot(n);
            FinishRow { angle_rad, error_um, part_mm, machine_mm: part_mm + self.origin, requested, left_um }
        };
        places.into_iter().map(row).collect()
    }

    /// The same compensation written into the NC program instead: corners of the straight moves, part coordinates.
    #[must_use]
    pub fn straight_moves(&self) -> Vec<Zx> {
        let corner = |e: &LineError| e.place + Zx::at_angle(e.angle_rad) * (self.nose_mm - e.error_um * 1e-3);
        self.errors.iter().map(corner).collect()
    }

    /// The table as CSV, with the columns of [`crate::table::csv`]: `lead_mm` is how far before each position its totals are
    /// to be sent along the cut, which runs towards larger places, or with `backwards` towards smaller ones.
    #[must_use]
    pub fn csv(&self, rows: &[FinishRow], lead_mm: f64, backwards: bool) -> String {
        let way = match (self.errors.first(), self.errors.last()) {
            (Some(a), Some(b)) => (b.place - a.place).unit().unwrap_or(Zx::new(0.0, 0.0)),
            _ => Zx::new(0.0, 0.0),
        };
        let lead = way * if backwards { lead_mm } else { -lead_mm };
        let mut text = crate::table::HEADER.to_owned();
        for r in rows {
            let send = r.machine_mm + lead;
            let _ = writeln!(
                text,
                "{:.6},{:.3},{:.5},{:.5},{:.5},{:.5},{:.5},{:.5},{},{},{:.3}",
                r.angle_rad,
                r.error_um,
                r.part_mm.z,
                r.part_mm.x,
                r.machine_mm.z,
                r.machine_mm.x,
                send.z,
                send.x,
                r.requested[0],
                r.requested[1],
                r.left_um
            );
        }
        text
    }
}
