//! Files of points and errors, the tip, and the drawing of errors.

use super::{CIRCLE, Files, quadrant};
use rtec_part::error_cor_file::{FeatureErrors, error_cor, read_arc};
use rtec_part::geometric_fit::Zx;
use rtec_part::part_errors::ProbedPoints;
use std::fmt::Write as _;

#[test]
fn the_tip_is_taken_off_on_the_side_it_came_from() {
    let files = Files::new();
    for (tip_mm, side) in [(0.0, 1.0), (2.5, 1.0), (2.5, -1.0)] {
        let probed = ProbedPoints::read(&files.with("p.csv", &quadrant(tip_mm, side))).unwrap();
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

/// Files as a spreadsheet saves them.
/// They have separators, decimal commas, UTF-16, Windows-1252, quotes, the minus of typography.
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
        ProbedPoints::read(&files.with("p.csv", &quadrant(2.5, 1.0))).unwrap().errors(CIRCLE, 2.5).unwrap();
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

/// The quadrant as recorded by a machine with errors.
/// The scale reads nominal minus the error.
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
        // Every approach is towards −Z except the last, which is square to it.
        let reversal_um = if n.z > 1e-6 { -2.0 } else { 0.0 };
        let error_um = Zx::new(40.0e-3 * (p.z + origin.z) + reversal_um, 2.0 * (t8 - t18));
        let read = p - error_um * 1e-3;
        let (az, ax) = (if k == 19 { 0.0 } else { -n.z }, -n.x);
        let _ = writeln!(text, "{:.7},{:.7},{az:.6},{ax:.6},{k},{t8:.1},{t18}", read.z, read.x);
    }
    let file = files.with("p.csv", &text);
    let mut probed = ProbedPoints::read(&file).unwrap();
    let off = probed.errors(CIRCLE, 0.0).unwrap();
    assert!((off.centre_mm[0] - 100.0).abs() > 0.010, "uncorrected, the centre is {:?}", off.centre_mm);
    probed.correct_geometric_thermal(&machine, origin).unwrap();
    let report = probed.errors(CIRCLE, 0.0).unwrap();
    let [z, x] = report.centre_mm;
    assert!((z - 100.0).abs() < 2e-5 && (x - 0.5).abs() < 2e-5, "{z} {x}");
    assert!(report.form_um < 0.1, "{}", report.form_um);
    let mut bare = ProbedPoints::read(&files.with("p.csv", &quadrant(0.0, 1.0))).unwrap();
    assert!(bare.correct_geometric_thermal(&machine, origin).unwrap_err().found.contains("T8"));
}

#[test]
fn bad_points_are_named_by_their_line() {
    let files = Files::new();
    let good = quadrant(2.5, 1.0);
    let mut lines: Vec<&str> = good.lines().collect();
    let other_side = "138.1,0.5,1,0";
    lines[2] = other_side;
    let probed = ProbedPoints::read(&files.with("p.csv", &lines.join("\n"))).unwrap();
    assert_eq!(probed.errors(CIRCLE, 2.5).unwrap_err().line, 3);
    lines[2] = "138.1,0.5,0,0";
    assert_eq!(ProbedPoints::read(&files.with("p.csv", &lines.join("\n"))).unwrap_err().line, 3);
    assert!(ProbedPoints::read(&files.with("p.csv", "z_mm,x_mm,approach_z\n1,2,3\n")).is_err());
    let two = ProbedPoints::read(&files.with("p.csv", "z_mm,x_mm,T3\n1,2,20.1\n2,1,20.2\n")).unwrap();
    assert!(two.errors(CIRCLE, 0.0).unwrap_err().found.contains("2 points"));
    let probed = ProbedPoints::read(&files.with("p.csv", &good)).unwrap();
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
        ProbedPoints::read(&files.with("p.csv", &quadrant(2.5, 1.0))).unwrap().errors(CIRCLE, 2.5).unwrap();
    let text = report.whisker_dxf();
    assert_eq!(text, report.whisker_dxf());
    // A CAD library finds nothing to report or repair.
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
    // One more in the legend, if any is dropped.
    let dropped = report.rejected.len() + usize::from(!report.rejected.is_empty());
    assert_eq!(svg.matches("class=\"dropped\"").count(), dropped);
}

/// Points far from their expected places that fit if read differently.
/// The finding says how.
#[test]
fn exchanged_columns_diameters_and_inches_are_told() {
    let files = Files::new();
    let probed = ProbedPoints::read(&files.with("p.csv", &quadrant(2.5, 1.0))).unwrap();
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
