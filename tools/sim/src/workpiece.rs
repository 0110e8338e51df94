//! The workpiece after cuts by a worn nose, and its surface for a probe.

use rtec_files::CsvTable;
use rtec_files::InputError;
use rtec_part::error_cor_file::PointError;
use rtec_part::geometric_fit::Zx;
use std::f64::consts::FRAC_PI_2;
use std::fmt::Write as _;
use std::path::Path;

/// The tool's nose, ground or worn flat at one position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ToolNose {
    /// Radius of the nose, mm.
    pub radius_mm: f64,
    /// Depth of the flat, µm.
    pub flat_um: f64,
    /// Surface angle at which the middle of the flat cuts, rad.
    pub flat_rad: f64,
}

/// The workpiece: radius by angle around the arc's centre.
#[derive(Debug, Clone, PartialEq)]
pub struct Workpiece {
    /// Centre of the arc in part coordinates.
    pub centre: Zx,
    radius_mm: Vec<f64>,
}

/// Angles of the workpiece, from slightly before to slightly beyond the quadrant.
const LOW_RAD: f64 = -0.03;
const STEP_RAD: f64 = 5e-4;
const STEPS: usize = 3263;

impl Workpiece {
    /// A raw part: a circle around `centre` (part coordinates) with this radius, mm.
    pub fn raw(centre: Zx, radius_mm: f64) -> Self {
        Self { centre, radius_mm: vec![radius_mm; STEPS] }
    }

    /// Radius at an angle.
    pub fn radius_mm(&self, angle_rad: f64) -> f64 {
        let at = ((angle_rad - LOW_RAD) / STEP_RAD - 0.5).clamp(0.0, (STEPS - 2) as f64);
        let (k, part) = (at as usize, at.fract());
        self.radius_mm[k] * (1.0 - part) + self.radius_mm[k + 1] * part
    }

    /// Distance of a position (part coordinates) from the surface, mm; negative inside.
    pub fn distance_mm(&self, at: Zx) -> f64 {
        let p = at - self.centre;
        p.norm() - self.radius_mm(p.angle_rad())
    }

    /// Errors of the surface from the nominal circle, as by a measuring machine.
    pub fn truth(&self, radius_mm: f64, number: usize) -> Vec<PointError> {
        (0..number)
            .map(|k| {
                let angle_rad = FRAC_PI_2 * k as f64 / (number - 1) as f64;
                PointError {
                    angle_rad,
                    error_um: (self.radius_mm(angle_rad) - radius_mm) * 1e3,
                    along_mm: None,
                }
            })
            .collect()
    }

    /// The workpiece as CSV: radii at even steps of angle around one centre.
    pub fn to_csv(&self) -> String {
        let mut text = "centre_z_mm,centre_x_mm,radius_mm\n".to_owned();
        for r in &self.radius_mm {
            let _ = writeln!(text, "{},{},{r:.7}", self.centre.z, self.centre.x);
        }
        text
    }

    /// Reads a workpiece from a CSV file.
    ///
    /// # Errors
    /// As [`CsvTable::read`], or another number of radii than a workpiece has.
    pub fn read(file: &Path) -> Result<Self, InputError> {
        let sheet = CsvTable::read(file, &["centre_z_mm", "centre_x_mm", "radius_mm"], |_| false)?;
        let (z, x) = (sheet.numbers("centre_z_mm")?, sheet.numbers("centre_x_mm")?);
        let centre = z.first().zip(x.first()).map_or(Zx::new(0.0, 0.0), |(&z, &x)| Zx::new(z, x));
        let radii = sheet.numbers("radius_mm")?;
        let found = format!("{} radii", radii.len());
        Self::from_radii(centre, radii)
            .ok_or_else(|| InputError::whole(file, found, "a workpiece as `part finish` writes it"))
    }

    /// A workpiece from stored radii; `None` if their number is wrong.
    pub fn from_radii(centre: Zx, radius_mm: Vec<f64>) -> Option<Self> {
        (radius_mm.len() == STEPS && radius_mm.iter().all(|r| r.is_finite()))
            .then_some(Self { centre, radius_mm })
    }

    /// Removes the material that the nose reaches at one position of its centre.
    /// It cuts `deeper_um` beyond its radius.
    pub fn cut(&mut self, tool: ToolNose, nose_centre: Zx, deeper_um: f64) {
        let facing = (nose_centre - self.centre).angle_rad();
        let nose_mm = tool.radius_mm + deeper_um * 1e-3;
        for k in -175..=175 {
            let angle = facing + f64::from(k) * 2e-3;
            let flat_mm = (tool.radius_mm - tool.flat_um * 1e-3) / (angle - tool.flat_rad).cos();
            let reach_mm = if flat_mm > 0.0 { nose_mm.min(flat_mm) } else { nose_mm };
            let p = nose_centre - Zx::at_angle(angle) * reach_mm - self.centre;
            let at = (p.angle_rad() - LOW_RAD) / STEP_RAD;
            if at >= 0.0
                && let Some(radius) = self.radius_mm.get_mut(at as usize)
            {
                *radius = radius.min(p.norm());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A flat leaves the support function of the nose, that is of the flat's two ends.
    /// (NISTIR 4854, Part-Form Error)
    #[test]
    fn a_flat_of_25_um_leaves_25_um_where_its_middle_cuts() {
        let tool = ToolNose { radius_mm: 0.8, flat_um: 25.0, flat_rad: 0.7 };
        let half = (1.0 - tool.flat_um / 1000.0 / tool.radius_mm).acos();
        let mut part = Workpiece::raw(Zx::new(127.0, 0.0), 39.0);
        for k in -20..=1620 {
            part.cut(tool, part.centre + Zx::at_angle(f64::from(k) * 1e-3) * (38.1 + tool.radius_mm), 0.0);
        }
        for away in [0.0, 0.05, 0.1, 0.2, 0.3, -0.15] {
            let left_um = (part.radius_mm(0.7 + away) - 38.1) * 1e3;
            let worn = if away.abs() >= half { 0.0 } else { 1.0 - (half - away.abs()).cos() };
            let said_um = 1e3 * tool.radius_mm * worn;
            assert!((left_um - said_um).abs() < 0.6, "{away}: {left_um} µm, {said_um} µm");
        }
    }
}
