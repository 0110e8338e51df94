//! From probed points to part errors.
//! The tests cover tip, side of approach, files read and written, and findings.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

mod features;
mod files;

use rtec_part::geometric_fit::Zx;
use rtec_part::part_errors::NominalShape;
use std::fmt::Write as _;
use std::path::PathBuf;

const CIRCLE: NominalShape = NominalShape::Circle { radius_mm: 38.1 };

struct Files(tempfile::TempDir);

impl Files {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }
    fn with(&self, name: &str, text: &str) -> PathBuf {
        let file = self.0.path().join(name);
        std::fs::write(&file, text).unwrap();
        file
    }
}

fn bump_um(k: i32) -> f64 {
    [6.0, 14.0, 20.0, 14.0, 6.0].get((k - 4) as usize).copied().unwrap_or(0.0)
}

/// The tip's centres on a quadrant with a bump.
/// The tip is outside (+1) or inside (−1).
fn quadrant(tip_mm: f64, side: f64) -> String {
    (0..20).fold("z_mm,x_mm,approach_z,approach_x\n".to_owned(), |mut text, k| {
        let n = Zx::at_angle(std::f64::consts::FRAC_PI_2 * f64::from(k) / 19.0);
        let p = Zx::new(100.0, 0.5) + n * (38.1 + bump_um(k) * 1e-3 + side * tip_mm);
        let _ = writeln!(text, "{:.7},{:.7},{:.3},{:.3}", p.z, p.x, -3.0 * side * n.z, -3.0 * side * n.x);
        text
    })
}
