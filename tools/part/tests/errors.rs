//! Probed points to part errors: tip, side of approach, files read and written, findings.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use rtec_part::cor::{FeatureErrors, error_cor, read_arc};
use rtec_part::errors::{Nominal, Probed};
use rtec_part::fit::Zx;
use std::fmt::Write as _;
use std::path::PathBuf;

const CIRCLE: Nominal = Nominal::Circle { radius_mm: 38.1 };

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

/// The tip's centres on a quadrant with a bump; the tip outside (+1) or inside (−1).
fn quadrant(tip_mm: f64, side: f64) -> String {
    (0..20).fold("z_mm,x_mm,approach_z,approach_x\n".to_owned(), |mut text, k| {
        let n = Zx::at_angle(std::f64::consts::FRAC_PI_2 * f64::from(k) / 19.0);
        let p = Zx::new(100.0, 0.5) + n * (38.1 + bump_um(k) * 1e-3 + side * tip_mm);
        let _ = writeln!(text, "{:.7},{:.7},{:.3},{:.3}", p.z, p.x, -3.0 * side * n.z, -3.0 * side * n.x);
        text
    })
}

#[test]
fn the_tip_is_taken_off_on_the_side_it_came_from() {
    let files = Files::new();
    for (tip_mm, side) in [(0.0, 1.0), (2.5, 1.0), (2.5, -1.0)] {
        let probed = Probed::read(&files.with("p.csv", &quadrant(tip_mm, side))).unwrap();
        let report = probed.errors(CIRCLE, tip_mm).unwrap();
        let radius_mm = report.radius_mm.unwrap();
        let off_mm = (report.centre_mm[0] - 100.0).hypot(report.centre_mm[1] - 0.5);
        assert!((radius_mm - 38.1).abs() < 0.005 && off_mm < 0.008, "{tip_mm} {side}: {radius_mm} {off_mm}");
        assert!(
            report.rejected.contains(&6) && !report.rejected.contains(&0) && !report.rejected.contains(&19)
        );
        assert!(report.sd_after_um < 0.5 * report.sd_before_um);
        assert!((report.errors[6].error_um - 20.0).abs() < 3.0);
        assert!((report.robust.errors_um[6] - 20.0).abs() < 1e-2, "exact where the rest is a perfect circle");
        assert!((report.robust.radius_mm.unwrap() - 38.1).abs() < 1e-5);
    }
}

/// As a spreadsheet saves it: separators, decimal commas, UTF-16, Windows-1252, quotes, the minus of typography.
#[test]
fn error_cor_is_read_as_a_spreadsheet_saves_it() {
    let files = Files::new();
    let utf16: Vec<u8> =
        "\u{feff}0,1;-1,5\r\n0,2;2,5\r\n".encode_utf16().flat_map(u16::to_le_bytes).collect();
    let dialects: [&[u8]; 9] = [
        b"0.1 -1.5\n0.2 2.5\n",
        b"0.1,-1.5\n0.2,2.5\n",
        b"sep=;\n0,1;-1,5\n0,2;2,5\n",
        b"0,1\t-1,5\n0,2\t2,5\n",
        b"0,1 -1,5\n0,2 2,5\n",
        b"# angle in rad, error in \xb5m\n0.1, -1.5\n0.2, 2.5\n",
        b"\"0,1\";\"-1,5\"\n\"0,2\";\"2,5\"\n",
        "0.1;\u{2212}1.5\n0.2;2.5\n".as_bytes(),
        &utf16,
    ];
    for bytes in dialects {
        let file = files.with("error.cor", "");
        std::fs::write(&file, bytes).unwrap();
        let read = read_arc(&file).unwrap_or_else(|e| panic!("{}: {e}", String::from_utf8_lossy(bytes)));
        let values: Vec<[f64; 2]> = read.iter().map(|e| [e.angle_rad, e.error_um]).collect();
        assert_eq!(values, [[0.1, -1.5], [0.2, 2.5]], "{}", String::from_utf8_lossy(bytes));
    }
    let names = read_arc(&files.with("error.cor", "angle_deg;error_um\n5;1\n")).unwrap_err();
    assert!(names.line == 1 && names.expected.contains("take the line of names out"), "{names}");
}

#[test]
fn error_cor_is_read_as_it_is_written() {
    let files = Files::new();
    let report =
        Probed::read(&files.with("p.csv", &quadrant(2.5, 1.0))).unwrap().errors(CIRCLE, 2.5).unwrap();
    let text = error_cor(&report.errors);
    let back = read_arc(&files.with("error.cor", &text)).unwrap();
    assert_eq!(back.len(), 20);
    for (a, b) in back.iter().zip(&report.errors) {
        assert!((a.angle_rad - b.angle_rad).abs() < 1e-6 && (a.error_um - b.error_um).abs() < 1e-3);
    }
    for (bad, line) in [
        ("0.1 2\n0.1 3\n", 2),
        ("0.1\n", 1),
        ("0.1 2 3\n", 1),
        ("# none\n", 0),
        ("0 nan\n", 1),
        ("0 1\n0.1 1e300\n", 2),
        ("-1e300 1\n", 1),
        ("0 1\n90 1\n", 2),
    ] {
        assert_eq!(read_arc(&files.with("error.cor", bad)).unwrap_err().line, line, "{bad:?}");
    }
    // Of a straight feature: a face at Z 5, its normal along Z.
    let face = "0 1 -10 5 0\n0 2 0 5 -10\n0 1.5 10 5 -20\n";
    let read = FeatureErrors::read(&files.with("error.cor", face)).unwrap();
    assert_eq!((read.len(), read.range_um()), (3, [1.0, 2.0]));
    let arc = FeatureErrors::read(&files.with("error.cor", "0 -1.5\n0.1 -2.5\n")).unwrap();
    assert_eq!((arc.len(), arc.range_um()), (2, [-2.5, -1.5]));
    for (bad, line) in [
        ("0 1 -10 5 0\n0 1e300 0 5 -10\n", 2),
        ("0 1 -10 5 0\n0 2 1e300 5 -10\n", 2),
        ("0 1 -10 5 0\n0 2 -10 5 -10\n", 2),
        ("0 1 -10 5 0\n0 2 0 15 0\n", 2),
        ("0 1 -10 5 0\n0.5 2 0 5 -10\n", 2),
        ("0 1 -10 5 0\n0 2\n", 2),
        ("0 1 -10 5 0\n", 0),
    ] {
        let said = FeatureErrors::read(&files.with("error.cor", bad)).unwrap_err();
        assert_eq!(said.line, line, "{bad:?}: {said}");
    }
}

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
        let probed = Probed::read(&files.with("p.csv", &text)).unwrap();
        let report = probed.errors(Nominal::Line { taper_deg: Some(5.0) }, 2.0).unwrap();
        assert!((report.inclination_deg.unwrap() - 5.0).abs() < 1e-4, "{side} {:?}", report.inclination_deg);
        assert!(report.inclination_error_deg.unwrap().abs() < 1e-4);
        assert!((report.errors[5].error_um - 10.0).abs() < 0.1, "{side}: {:?}", report.errors[5]);
        // The surface goes through (0, 20) when the tip is taken off.
        let [z, x] = report.centre_mm;
        assert!(((x - 20.0) * cos - z * sin).abs() < 1e-4, "{side}: {z} {x}");
    }
}

/// The quadrant as a machine that is off records it: the scale reads nominal minus the error.
#[test]
fn the_geometric_thermal_correction_takes_the_machines_error_out() {
    let files = Files::new();
    let model = "name = \"lathe\"\n[[effect]]\nname = \"scale.z\"\nppm = 40.0\n\
                 [[effect]]\nname = \"thermal_growth.x\"\nsensor = \"T8\"\nminus = \"T18\"\num_per_K = 2.0\num_per_K2 = 0.0\n\
                 [[effect]]\nname = \"reversal.z\"\num = 4.0\n";
    let machine = rtec_model::machine::Machine::read(&files.with("machine.toml", model)).unwrap();
    let origin = Zx::new(300.0, 0.0);
    let mut text = "z_mm,x_mm,approach_z,approach_x,t_s,T8,T18\n".to_owned();
    for k in 0..20 {
        let n = Zx::at_angle(std::f64::consts::FRAC_PI_2 * f64::from(k) / 19.0);
        let p = Zx::new(100.0, 0.5) + n * 38.1;
        let (t8, t18) = (24.0 + 0.1 * f64::from(k), 20.5);
        // Every approach is towards −Z but the last, which is square to it.
        let reversal_um = if n.z > 1e-6 { -2.0 } else { 0.0 };
        let error_um = Zx::new(40.0e-3 * (p.z + origin.z) + reversal_um, 2.0 * (t8 - t18));
        let read = p - error_um * 1e-3;
        let (az, ax) = (if k == 19 { 0.0 } else { -n.z }, -n.x);
        let _ = writeln!(text, "{:.7},{:.7},{az:.6},{ax:.6},{k},{t8:.1},{t18}", read.z, read.x);
    }
    let file = files.with("p.csv", &text);
    let mut probed = Probed::read(&file).unwrap();
    let off = probed.errors(CIRCLE, 0.0).unwrap();
    assert!((off.centre_mm[0] - 100.0).abs() > 0.010, "uncorrected, the centre is {:?}", off.centre_mm);
    probed.correct_geometric_thermal(&machine, origin).unwrap();
    let report = probed.errors(CIRCLE, 0.0).unwrap();
    let [z, x] = report.centre_mm;
    assert!((z - 100.0).abs() < 2e-5 && (x - 0.5).abs() < 2e-5, "{z} {x}");
    assert!(report.form_um < 0.1, "{}", report.form_um);
    let mut bare = Probed::read(&files.with("p.csv", &quadrant(0.0, 1.0))).unwrap();
    assert!(bare.correct_geometric_thermal(&machine, origin).unwrap_err().found.contains("T8"));
}

#[test]
fn bad_points_are_named_by_their_line() {
    let files = Files::new();
    let good = quadrant(2.5, 1.0);
    let mut lines: Vec<&str> = good.lines().collect();
    let other_side = "138.1,0.5,1,0";
    lines[2] = other_side;
    let probed = Probed::read(&files.with("p.csv", &lines.join("\n"))).unwrap();
    assert_eq!(probed.errors(CIRCLE, 2.5).unwrap_err().line, 3);
    lines[2] = "138.1,0.5,0,0";
    assert_eq!(Probed::read(&files.with("p.csv", &lines.join("\n"))).unwrap_err().line, 3);
    assert!(Probed::read(&files.with("p.csv", "z_mm,x_mm,approach_z\n1,2,3\n")).is_err());
    let two = Probed::read(&files.with("p.csv", "z_mm,x_mm,T3\n1,2,20.1\n2,1,20.2\n")).unwrap();
    assert!(two.errors(CIRCLE, 0.0).unwrap_err().found.contains("2 points"));
    let probed = Probed::read(&files.with("p.csv", &good)).unwrap();
    assert!(probed.check_expected(&probed.tip_centre, 0.1).is_ok());
    let mut fewer = probed.tip_centre.clone();
    fewer.remove(4);
    let said = probed.check_expected(&fewer, 0.1).unwrap_err().found;
    assert_eq!(said, "20 trips, the first that is not in its place is point 5");
    let said = probed.check_expected(&probed.tip_centre[..19], 0.1).unwrap_err().found;
    assert!(said.ends_with("point 20"), "{said}");
    let mut off = probed.tip_centre.clone();
    off[7].z += 0.2;
    assert!(probed.check_expected(&off, 0.1).unwrap_err().found.contains("point 8"));
}

#[test]
fn whiskers_are_drawn_at_two_hundred_and_fifty() {
    let files = Files::new();
    let report =
        Probed::read(&files.with("p.csv", &quadrant(2.5, 1.0))).unwrap().errors(CIRCLE, 2.5).unwrap();
    let text = report.whisker_dxf();
    assert_eq!(text, report.whisker_dxf());
    // A CAD library finds nothing to complain of or to mend.
    if test_needs::python("ezdxf", "python3-ezdxf") {
        let audit = "import ezdxf, sys; found = ezdxf.readfile(sys.argv[1]).audit(); \
                     sys.exit('\\n'.join(e.message for e in found.errors + found.fixes) or None)";
        let judged = std::process::Command::new(test_needs::PYTHON)
            .args(["-c", audit])
            .arg(files.with("whisker.dxf", &text))
            .output()
            .unwrap();
        assert!(judged.status.success(), "{}", String::from_utf8_lossy(&judged.stderr));
    }
    let drawing = dxf::Drawing::load(&mut text.as_bytes()).unwrap();
    let bars: Vec<f64> = drawing
        .entities()
        .filter(|e| e.common.layer == "WHISKER")
        .map(|e| match &e.specific {
            dxf::entities::EntityType::Line(l) => (l.p2.x - l.p1.x).hypot(l.p2.y - l.p1.y),
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(bars.len(), 20);
    for (bar, error) in bars.iter().zip(&report.errors) {
        assert!((bar - error.error_um.abs() * 0.25).abs() < 1e-6, "4 µm are 1 mm");
    }
    let svg = report.whisker_svg();
    // And one in the legend, where there is any.
    let dropped = report.rejected.len() + usize::from(!report.rejected.is_empty());
    assert_eq!(svg.matches("class=\"dropped\"").count(), dropped);
}

/// One gross false trip spoils the circle and the line alike: the arc of the others is still an arc, and the trip is the
/// point that is far off.
#[test]
fn a_gross_false_trip_is_no_straight_feature() {
    let files = Files::new();
    let probed = Probed::read(&files.with("p.csv", &quadrant(0.0, 1.0))).unwrap();
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

/// A bump over much of the arc pulls the size of the report's fit; the robust fit's stands beside it.
#[test]
fn the_size_by_the_robust_fit_stands_beside() {
    let files = Files::new();
    let probed = Probed::read(&files.with("p.csv", &quadrant(0.0, 1.0))).unwrap();
    let larger = Nominal::Circle { radius_mm: 38.09 };
    let report = probed.errors(larger, 0.0).unwrap();
    assert!((report.robust.size_error_um.unwrap() - 10.0).abs() < 0.1, "{:?}", report.robust.size_error_um);
}

/// A cylinder 6 µm large with a bump on it: the size is that of the bump's neighbours.
/// Size and error together are the distance of each point from its expected place.
#[test]
fn size_and_errors_of_a_straight_feature_make_the_distance() {
    let files = Files::new();
    let bump = |k: i32| [12.0, 15.0, 12.0].get((k - 4) as usize).copied().unwrap_or(0.0);
    let text = (0..12).fold("z_mm,x_mm,approach_z,approach_x\n".to_owned(), |mut text, k| {
        let _ = writeln!(text, "{:.6},{:.6},0,-1", 10.0 + 5.0 * f64::from(k), 27.5 + (6.0 + bump(k)) * 1e-3);
        text
    });
    let probed = Probed::read(&files.with("cy.csv", &text)).unwrap();
    let expected: Vec<Zx> = (0..12).map(|k| Zx::new(10.0 + 5.0 * f64::from(k), 27.5)).collect();
    let report = probed.errors(Nominal::Line { taper_deg: None }, 2.5).unwrap();
    let size = probed.outside_um(&report, &expected).unwrap();
    assert!((size - 6.0).abs() < 0.01, "{size}");
    for (k, e) in report.errors.iter().enumerate() {
        assert!((e.error_um + size - 6.0 - bump(k as i32)).abs() < 0.01, "point {k}: {e:?}");
    }
}

/// A straight feature of 12 points at `along` (z or x from 10 mm, 2 mm apart).
///
/// The tip's centres are at `place_mm` across it. The feature has 30 µm too much material, 12 µm more in the middle,
/// and is tilted by `tilt_um` over its length.
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

/// A face's side is told by its approach or by the probe's path, never by its tilt; without either it is refused.
#[test]
fn the_tilt_of_a_face_does_not_say_where_outward_is() {
    let files = Files::new();
    let read = |along_z, place, outward, tilt, approach: &str| {
        Probed::read(&files.with("p.csv", &straight(along_z, place, outward, tilt, approach))).unwrap()
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
                let r = probed.errors(Nominal::Line { taper_deg: None }, 2.5).unwrap();
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
        let e =
            read(false, 7.5, 1.0, tilt_um, "").errors(Nominal::Line { taper_deg: None }, 2.5).unwrap_err();
        assert!(e.found.contains("face") && e.expected.contains("approach_z"), "{e}");
    }
    // A path of another part, or of the other side.
    let mut probed = read(false, 7.5, 1.0, 0.2, ",-1,0");
    assert!(probed.touched_by(&[Zx::new(-1.0, 0.0); 11]).is_err());
    assert_eq!(probed.touched_by(&[Zx::new(1.0, 0.0); 12]).unwrap_err().line, 2);
}

/// One call has one radius, one tip and one side: points of two features are refused by the first of the second.
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
        Probed::read(&files.with("p.csv", &rows.collect::<String>()))
    };
    assert!(named("F1").is_ok());
    let e = named("F3").unwrap_err();
    assert!(e.line == 12 && e.found == "a point of F3 among those of F1", "{e}");
}

/// Points far from where they were expected, that would fit if read otherwise: it is said how.
#[test]
fn exchanged_columns_diameters_and_inches_are_told() {
    let files = Files::new();
    let probed = Probed::read(&files.with("p.csv", &quadrant(2.5, 1.0))).unwrap();
    let right = probed.tip_centre.clone();
    for (slip, said) in [
        ((|p| Zx::new(p.x, p.z)) as fn(Zx) -> Zx, "z_mm and x_mm exchanged"),
        (|p| Zx::new(p.z, 2.0 * p.x), "diameters"),
        (|p| p * (1.0 / 25.4), "25.4 times the points"),
        (|p| p * 25.4, "--path-units inch"),
    ] {
        let mut slipped = probed.clone();
        slipped.tip_centre = right.iter().map(|p| slip(*p)).collect();
        let e = slipped.check_expected(&right, 0.5).unwrap_err();
        assert!(e.expected.contains(said), "{e}");
    }
    let mut elsewhere = probed.clone();
    elsewhere.tip_centre = right.iter().map(|p| *p + Zx::new(7.0, 0.0)).collect();
    assert_eq!(elsewhere.check_expected(&right, 0.5).unwrap_err().expected, "a trip within 0.5 mm");
}

/// A fillet at a shoulder begins where its angle is ±π: noise must not put its first point at the other end. The planted
/// error is found in the table at each direction, and nothing beside the arc.
#[test]
fn an_arc_across_the_turn_keeps_its_order() {
    use rtec_part::table::{AxisCounts, FinishCut, FinishTable};
    let files = Files::new();
    let centre = Zx::new(50.0, 30.0);
    let planted = |a: f64| 8.0 * (6.0 * a).cos();
    for start_deg in [170.0_f64, 179.999, 180.0, 180.001] {
        let angle = |k: i32| (start_deg + 90.0 * f64::from(k) / 23.0).to_radians();
        let text = (0..24).fold("z_mm,x_mm,approach_z,approach_x\n".to_owned(), |text, k| {
            // The tip is inside; its centres on a circle of 4 mm.
            let n = Zx::at_angle(angle(k));
            let p = centre + n * (4.0 + planted(angle(k)) * 1e-3);
            text + &format!("{:.7},{:.7},{:.5},{:.5}\n", p.z, p.x, n.z, n.x)
        });
        let nominal = Nominal::Circle { radius_mm: 5.0 };
        let report = Probed::read(&files.with("p.csv", &text)).unwrap().errors(nominal, 1.0).unwrap();
        let file = files.with("error.cor", &error_cor(&report.errors));
        let errors = read_arc(&file).unwrap();
        for pair in errors.windows(2) {
            assert!((pair[1].angle_rad - pair[0].angle_rad - 0.0683).abs() < 0.002, "{start_deg}: {pair:?}");
        }
        assert!((errors[0].error_um - report.errors[0].error_um).abs() < 1e-3, "{start_deg}");
        let cut = FinishCut { centre, radius_mm: 5.0, nose_mm: 0.0, origin: Zx::new(0.0, 0.0) };
        let axes = [AxisCounts { count_um: 1.0, increment: 2, sign: 1.0 }; 2];
        let table = FinishTable::new(cut, axes, errors);
        for (k, e) in report.errors.iter().enumerate() {
            // As the live table asks, by the place; the fitted centre is some 0.01 rad from the planted one.
            let place = centre + Zx::at_angle(angle(k as i32)) * 5.0;
            let um = table.components_um(place, Zx::new(0.0, 0.0), 0.0);
            let along = um.dot(Zx::at_angle(angle(k as i32)));
            assert!((along - e.error_um).abs() < 0.6, "{start_deg} {k}: {along} {e:?}");
        }
        let rows = table.rows(4);
        assert!(rows.iter().all(|r| (r.part_mm.z - 50.0) < 0.9), "{start_deg}: an entry in the air");
    }
    // Written by who sorts directions: an arc with its ends out of order.
    let e = read_arc(&files.with("error.cor", "-3.0 1\n-1.6 2\n3.1 1\n")).unwrap_err();
    assert!(e.line == 3 && e.found.contains("half a turn"), "{e}");
}
