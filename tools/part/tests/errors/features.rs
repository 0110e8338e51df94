//! Tapers, bores, faces and arcs.

use super::{CIRCLE, Files, quadrant};
use rtec_part::error_cor_file::{error_cor, read_arc};
use rtec_part::geometric_fit::Zx;
use rtec_part::part_errors::{NominalShape, ProbedPoints};
use std::fmt::Write as _;

#[test]
fn a_taper_and_a_bore_face_the_probe() {
    let files = Files::new();
    // A taper of 5° probed from outside, 10 µm too large in the middle; then the same line probed from inside.
    for side in [1.0, -1.0] {
        let (sin, cos) = 5_f64.to_radians().sin_cos();
        let text = (0..11).fold("z_mm,x_mm,approach_z,approach_x\n".to_owned(), |mut text, k| {
            let bulge = if k == 5 { 0.010 } else { 0.0 };
            let p = Zx::new(cos, sin) * (4.0 * f64::from(k)) + Zx::new(-sin, cos) * (side * (2.0 + bulge));
            let _ = writeln!(text, "{:.7},{:.7},{},{}", p.z, p.x + 20.0, sin * side, -cos * side);
            text
        });
        let probed = ProbedPoints::read(&files.with("p.csv", &text)).unwrap();
        let report = probed.errors(NominalShape::Line { taper_deg: Some(5.0) }, 2.0).unwrap();
        assert!((report.inclination_deg.unwrap() - 5.0).abs() < 1e-4, "{side} {:?}", report.inclination_deg);
        assert!(report.inclination_error_deg.unwrap().abs() < 1e-4);
        assert!((report.errors[5].error_um - 10.0).abs() < 0.1, "{side}: {:?}", report.errors[5]);
        // With the tip subtracted, the surface goes through (0, 20).
        let [z, x] = report.centre_mm;
        assert!(((x - 20.0) * cos - z * sin).abs() < 1e-4, "{side}: {z} {x}");
    }
}

/// One gross false trip spoils the circle and the line equally.
/// The arc of the other points is still recognised, and the trip is the point far off.
#[test]
fn a_gross_false_trip_is_no_straight_feature() {
    let files = Files::new();
    let probed = ProbedPoints::read(&files.with("p.csv", &quadrant(0.0, 1.0))).unwrap();
    for off_mm in [5.0, 30.0, 200.0] {
        let mut one = probed.clone();
        one.tip_centre[9] = one.tip_centre[9] + Zx::new(off_mm, -off_mm);
        assert!(!one.is_straight(true).unwrap(), "{off_mm}");
        let report = one.errors(CIRCLE, 0.0).unwrap();
        let worst = (0..20)
            .max_by(|a, b| report.robust.errors_um[*a].abs().total_cmp(&report.robust.errors_um[*b].abs()));
        assert_eq!(worst, Some(9), "{off_mm}");
        assert!((report.robust.radius_mm.unwrap() - 38.1).abs() < 0.002, "{off_mm}");
    }
}

/// A bump over much of the arc changes the size of the report's fit.
/// The report also gives the size of the robust fit, which does not change.
#[test]
fn the_size_by_the_robust_fit_stands_beside() {
    let files = Files::new();
    let probed = ProbedPoints::read(&files.with("p.csv", &quadrant(0.0, 1.0))).unwrap();
    let larger = NominalShape::Circle { radius_mm: 38.09 };
    let report = probed.errors(larger, 0.0).unwrap();
    assert!((report.robust.size_error_um.unwrap() - 10.0).abs() < 0.1, "{:?}", report.robust.size_error_um);
}

/// A cylinder 6 µm too large with a bump.
/// Its size is that of the bump's neighbours. Size and error together are the distance of each point from its
/// expected place.
#[test]
fn size_and_errors_of_a_straight_feature_make_the_distance() {
    let files = Files::new();
    let bump = |k: i32| [12.0, 15.0, 12.0].get((k - 4) as usize).copied().unwrap_or(0.0);
    let text = (0..12).fold("z_mm,x_mm,approach_z,approach_x\n".to_owned(), |mut text, k| {
        let _ = writeln!(text, "{:.6},{:.6},0,-1", 10.0 + 5.0 * f64::from(k), 27.5 + (6.0 + bump(k)) * 1e-3);
        text
    });
    let probed = ProbedPoints::read(&files.with("cy.csv", &text)).unwrap();
    let expected: Vec<Zx> = (0..12).map(|k| Zx::new(10.0 + 5.0 * f64::from(k), 27.5)).collect();
    let report = probed.errors(NominalShape::Line { taper_deg: None }, 2.5).unwrap();
    let size = probed.outside_um(&report, &expected).unwrap();
    assert!((size - 6.0).abs() < 0.01, "{size}");
    for (k, e) in report.errors.iter().enumerate() {
        assert!((e.error_um + size - 6.0 - bump(k as i32)).abs() < 0.01, "point {k}: {e:?}");
    }
}

/// A straight feature of 12 points along z or x, from 10 mm, 2 mm apart.
///
/// The tip's centres are at `place_mm` across it. The feature has 30 µm too much material, 12 µm more in the
/// middle, and is tilted by `tilt_um` over its length.
fn straight(along_z: bool, place_mm: f64, outward: f64, tilt_um: f64, approach: &str) -> String {
    let header = format!("z_mm,x_mm{}\n", if approach.is_empty() { "" } else { ",approach_z,approach_x" });
    (0..12).fold(header, |mut text, k| {
        let bump = if (4..7).contains(&k) { 12.0 } else { 0.0 };
        let tilt = tilt_um * (f64::from(k) - 5.5) / 11.0;
        let (s, t) = (10.0 + 2.0 * f64::from(k), place_mm + (outward * (30.0 + bump) + tilt) * 1e-3);
        let (z, x) = if along_z { (s, t) } else { (t, s) };
        let _ = writeln!(text, "{z:.7},{x:.7}{approach}");
        text
    })
}

/// A face's side follows from its approach or the probe's path, never its tilt.
/// Without either it is refused.
#[test]
fn the_tilt_of_a_face_does_not_say_where_outward_is() {
    let files = Files::new();
    let read = |along_z, place, outward, tilt, approach: &str| {
        ProbedPoints::read(&files.with("p.csv", &straight(along_z, place, outward, tilt, approach))).unwrap()
    };
    // Front face at Z 5, rear face at Z −5, bore of 20 mm: outward is +Z, −Z, −X.
    for (along_z, place, outward, approach) in
        [(false, 7.5, 1.0, ",-1,0"), (false, -7.5, -1.0, ",1,0"), (true, 17.5, -1.0, ",0,1")]
    {
        let way = if along_z { Zx::new(0.0, -outward) } else { Zx::new(-outward, 0.0) };
        for tilt_um in [0.2, -0.2] {
            let given = read(along_z, place, outward, tilt_um, approach);
            let mut by_path = read(along_z, place, outward, tilt_um, "");
            by_path.touched_by(&[way; 12]).unwrap();
            for probed in [given, by_path] {
                let r = probed.errors(NominalShape::Line { taper_deg: None }, 2.5).unwrap();
                let (e, robust) = (r.errors[5].error_um, r.robust.errors_um[5]);
                assert!(
                    (e - 12.0).abs() < 0.2 && (robust - 12.0).abs() < 0.2,
                    "{place} {tilt_um}: {e} {robust}"
                );
                // The surface, 2.5 mm back from the tip's centres.
                let across = |centre: [f64; 2]| centre[usize::from(along_z)];
                let surface = place - outward * 2.47;
                for centre in [r.centre_mm, r.robust.centre_mm] {
                    assert!((across(centre) - surface).abs() < 1e-3, "{place} {tilt_um}: {centre:?}");
                }
            }
        }
    }
    for tilt_um in [0.2, -0.2] {
        let e = read(false, 7.5, 1.0, tilt_um, "")
            .errors(NominalShape::Line { taper_deg: None }, 2.5)
            .unwrap_err();
        assert!(e.found.contains("face") && e.expected.contains("approach_z"), "{e}");
    }
    // A path of another part, or of the other side.
    let mut probed = read(false, 7.5, 1.0, 0.2, ",-1,0");
    assert!(probed.touched_by(&[Zx::new(-1.0, 0.0); 11]).is_err());
    assert_eq!(probed.touched_by(&[Zx::new(1.0, 0.0); 12]).unwrap_err().line, 2);
}

/// Points of two features are refused at the first of the second.
/// One call has one radius, one tip and one side.
#[test]
fn points_of_two_features_are_refused() {
    let files = Files::new();
    let named = |second: &str| {
        let text = quadrant(0.0, 1.0);
        let rows = text.lines().enumerate().map(|(i, row)| match i {
            0 => format!("{row},feature\n"),
            1..=10 => format!("{row},F1\n"),
            _ => format!("{row},{second}\n"),
        });
        ProbedPoints::read(&files.with("p.csv", &rows.collect::<String>()))
    };
    assert!(named("F1").is_ok());
    let e = named("F3").unwrap_err();
    assert!(e.line == 12 && e.found == "a point of F3 among those of F1", "{e}");
}

/// A fillet at a shoulder begins where its angle is ±π.
/// Noise must not put its first point at the other end. The planted error appears in the table at each
/// direction, and nothing appears beside the arc.
#[test]
fn an_arc_across_the_turn_keeps_its_order() {
    use rtec_part::arc_finish_cut_table::{ArcFinishCutTable, AxisCountConversion, FinishCutArc};
    let files = Files::new();
    let centre = Zx::new(50.0, 30.0);
    let planted = |a: f64| 8.0 * (6.0 * a).cos();
    for start_deg in [170.0_f64, 179.999, 180.0, 180.001] {
        let angle = |k: i32| (start_deg + 90.0 * f64::from(k) / 23.0).to_radians();
        let text = (0..24).fold("z_mm,x_mm,approach_z,approach_x\n".to_owned(), |text, k| {
            // The tip is inside; its centres are on a circle of 4 mm.
            let n = Zx::at_angle(angle(k));
            let p = centre + n * (4.0 + planted(angle(k)) * 1e-3);
            text + &format!("{:.7},{:.7},{:.5},{:.5}\n", p.z, p.x, n.z, n.x)
        });
        let nominal = NominalShape::Circle { radius_mm: 5.0 };
        let report = ProbedPoints::read(&files.with("p.csv", &text)).unwrap().errors(nominal, 1.0).unwrap();
        let file = files.with("error.cor", &error_cor(&report.errors));
        let errors = read_arc(&file).unwrap();
        for pair in errors.windows(2) {
            assert!((pair[1].angle_rad - pair[0].angle_rad - 0.0683).abs() < 0.002, "{start_deg}: {pair:?}");
        }
        assert!((errors[0].error_um - report.errors[0].error_um).abs() < 1e-3, "{start_deg}");
        let cut = FinishCutArc { centre, radius_mm: 5.0, nose_mm: 0.0, origin: Zx::new(0.0, 0.0) };
        let axes = [AxisCountConversion { count_um: 1.0, increment: 2, sign: 1.0 }; 2];
        let table = ArcFinishCutTable::new(cut, axes, errors);
        for (k, e) in report.errors.iter().enumerate() {
            // Asked by the place, as the live table is. The fitted centre is about 0.01 rad from the planted
            // one.
            let place = centre + Zx::at_angle(angle(k as i32)) * 5.0;
            let um = table.components_um(place, Zx::new(0.0, 0.0), 0.0);
            let along = um.dot(Zx::at_angle(angle(k as i32)));
            assert!((along - e.error_um).abs() < 0.6, "{start_deg} {k}: {along} {e:?}");
        }
        let rows = table.rows(4);
        assert!(rows.iter().all(|r| (r.part_mm.z - 50.0) < 0.9), "{start_deg}: an entry in the air");
    }
    // A file sorted by direction: an arc with its ends out of order.
    let e = read_arc(&files.with("error.cor", "-3.0 1\n-1.6 2\n3.1 1\n")).unwrap_err();
    assert!(e.line == 3 && e.found.contains("half a turn"), "{e}");
}
