//! Shared by the tests of `rtecctl part`.
#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use serde_json::Value;
use std::fmt::Write as _;
use std::path::Path;
use std::process::{Command, Output};

pub(crate) fn part(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_rtecctl"))
        .arg("part")
        .args(arguments)
        .current_dir(folder)
        .env("SOURCE_DATE_EPOCH", "709171199")
        .output()
        .unwrap()
}

pub(crate) fn json(folder: &Path, arguments: &[&str]) -> Value {
    let output = part(folder, arguments);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{arguments:?}: {said}");
    crate::document(&output.stdout)
}

/// A taper of −20° with 8 µm too much at one of twelve points.
/// All points are 30 µm outside its drawing.
pub(crate) fn taper(folder: &Path) {
    let (sin, cos) = (-20.0_f64).to_radians().sin_cos();
    let (mut text, mut expected) = (String::from("z_mm,x_mm\n"), String::new());
    for k in 0..12 {
        let (s, off) = (2.0 * f64::from(k), 0.03 + if k == 5 { 0.008 } else { 0.0 });
        let (z, x) = (100.0 - s * cos, 30.0 - s * sin);
        let _ = writeln!(text, "{:.6},{:.6}", z - off * sin, x + off * cos);
        let _ = writeln!(expected, "POINT touch {}, {z:.6}, {x:.6}, 0.000000", k + 1);
    }
    std::fs::write(folder.join("taper.csv"), text).unwrap();
    std::fs::write(folder.join("expected.cdl"), expected).unwrap();
}

/// A quarter of a nose around Z 127, in mm, as a minimal drawing.
pub(crate) fn drawing(radius_mm: f64) -> String {
    format!(
        "0\nSECTION\n2\nHEADER\n9\n$ACADVER\n1\nAC1015\n9\n$INSUNITS\n70\n4\n0\nENDSEC\n0\nSECTION\n2\nENTITIES\n\
         0\nARC\n5\n2F\n8\n0\n10\n127.0\n20\n0.0\n30\n0.0\n40\n{radius_mm}\n50\n0.0\n51\n90.0\n0\nENDSEC\n0\nEOF\n"
    )
}
