//! The correction table.
//! The tests cover counts and signs, interpolation, coordinates, sending ahead, and moves in the program
//! instead.
#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use rtec_part::arc_finish_cut_table::{ArcFinishCutTable, AxisCountConversion, FinishCutArc, csv};
use rtec_part::error_cor_file::PointError;
use rtec_part::geometric_fit::Zx;
use std::f64::consts::{FRAC_PI_2, TAU};

const CUT: FinishCutArc = FinishCutArc {
    centre: Zx::new(127.0, 0.0),
    radius_mm: 38.1,
    nose_mm: 0.794,
    origin: Zx::new(-400.0, 55.5),
};
/// The Original RTEC on 1 µm counts: 4 µm per correction.
const ORIGINAL: AxisCountConversion = AxisCountConversion { count_um: 1.0, increment: 4, sign: 1.0 };
const DESIGN_C: AxisCountConversion = AxisCountConversion { count_um: 1.0, increment: 2, sign: 1.0 };

fn bump(angle: f64) -> f64 {
    let off = (angle - 0.3).abs() / 0.5;
    if off < 0.5 { 21.4 * (1.0 + (TAU * off).cos()) / 2.0 } else { 0.0 }
}

fn table(axis: AxisCountConversion) -> ArcFinishCutTable {
    let errors = (0..20)
        .map(|k| {
            let angle_rad = FRAC_PI_2 * f64::from(k) / 19.0;
            PointError { angle_rad, error_um: bump(angle_rad), along_mm: None }
        })
        .collect();
    ArcFinishCutTable::new(CUT, [axis; 2], errors)
}

#[test]
fn the_largest_error_of_the_report_takes_five_corrections() {
    // NISTIR 4854: 21.4 µm at 4 µm per correction.
    assert_eq!(ORIGINAL.requested(21.4), 20);
    assert_eq!(ORIGINAL.requested(-21.4), -20);
    assert_eq!(AxisCountConversion { sign: -1.0, ..ORIGINAL }.requested(21.4), -20);
    // Additional counts at the MTC make the axis stop short by as much, so the material is removed.
    assert!((ORIGINAL.taken_um(20) - 20.0).abs() < 1e-12);
    let z = table(ORIGINAL).rows(9).iter().map(|r| r.requested[0]).max().unwrap();
    assert_eq!(z, 20, "near the axis the error is nearly all Z");
}

#[test]
fn what_is_left_is_within_half_an_increment_a_component() {
    for (axis, most_um) in [(ORIGINAL, 2.0 * 2_f64.sqrt()), (DESIGN_C, 2_f64.sqrt())] {
        let rows = table(axis).rows(9);
        assert_eq!(rows.len(), 19 * 10 + 1);
        for r in &rows {
            assert!(r.left_um.abs() <= most_um + 1e-9, "{r:?}");
            assert!((r.machine_mm - (r.part_mm + CUT.origin)).norm() < 1e-12);
            assert!(((r.part_mm - CUT.centre).norm() - 38.894).abs() < 1e-9);
            assert!(r.requested.iter().all(|c| c % axis.increment == 0));
        }
    }
}

#[test]
fn totals_are_asked_where_the_tool_will_be() {
    let table = table(ORIGINAL);
    let (now, soon) = (CUT.machine_at(0.20), CUT.machine_at(0.22));
    let lead_s = 0.05;
    let velocity = (soon - now) * (1.0 / lead_s);
    let asked = table.components_um(now, velocity, lead_s);
    let there = Zx::at_angle(0.22) * table.error_um(0.22);
    assert!((asked - there).norm() < 1e-6, "{asked:?} {there:?}");
    // Added to a thermal model: the sum is rounded once.
    let thermal = Zx::new(1.9, -0.6);
    assert_eq!(
        table.requested(there + thermal),
        [ORIGINAL.requested(there.z + 1.9), ORIGINAL.requested(there.x - 0.6)]
    );
    // Beyond the ends the end values apply.
    assert!((table.error_um(-0.5) - bump(0.0)).abs() < 1e-12 && table.error_um(3.0).abs() < 1e-9);
    // The file sends ahead of the cut, on the side from which the cut comes.
    let rows = table.rows(0);
    for (backwards, sign) in [(false, 1.0), (true, -1.0)] {
        let text = csv(&table, &rows, 2.0, backwards);
        let cells: Vec<f64> = text.lines().nth(8).unwrap().split(',').map(|c| c.parse().unwrap()).collect();
        let (at, send) = (Zx::new(cells[4], cells[5]), Zx::new(cells[6], cells[7]));
        assert!(((at - send).norm() - 2.0).abs() < 0.01);
        assert!(sign * (at.x - send.x) > 0.0);
    }
}

#[test]
fn the_program_instead_takes_ninety_odd_lines_within_a_micrometre_and_a_half() {
    // NISTIR 4854: ninety G01 lines approximate the 38 mm radius within about 1.5 µm.
    let table = table(ORIGINAL);
    let points = table.straight_moves(0.0015, 4);
    let lines = points.len() - 1;
    assert!((90..100).contains(&lines), "{lines}");
    let mut worst_mm = 0.0_f64;
    for pair in points.windows(2) {
        for k in 0..=50 {
            let p = pair[0] + (pair[1] - pair[0]) * (f64::from(k) / 50.0);
            let from = p - CUT.centre;
            let angle = from.angle_rad();
            let wanted = 38.894 - table.error_um(angle) * 1e-3;
            worst_mm = worst_mm.max((from.norm() - wanted).abs());
        }
    }
    assert!(worst_mm <= 0.0015 && worst_mm > 0.0014, "{worst_mm}");
    // If the step is coarser than the allowance no chord fits, but the path still ends.
    let coarse = table.straight_moves(0.0015, 2);
    assert!(coarse.len() > 100 && (*coarse.last().unwrap() - points[lines]).norm() < 0.01);
    let plain = ArcFinishCutTable::new(
        CUT,
        [ORIGINAL; 2],
        [0.0, FRAC_PI_2].map(|angle_rad| PointError { angle_rad, error_um: 0.0, along_mm: None }).to_vec(),
    );
    let worst_plain = plain.straight_moves(0.0015, 4).windows(2).fold(0.0_f64, |w, p| {
        let middle = (p[0] + p[1]) * 0.5 - CUT.centre;
        w.max((middle.norm() - 38.894).abs()).max(((p[0] - CUT.centre).norm() - 38.894).abs())
    });
    assert!(worst_plain <= 0.0015 && worst_plain > 0.001, "{worst_plain}");
    println!("{lines} lines, within {:.2} µm of the arc", worst_plain * 1e3);
}
