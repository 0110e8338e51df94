//! Drawings: features in probing order, units, conics, and reports of bad drawings.
#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use dxf::entities::{Arc, Ellipse, Entity, EntityType, Line, LwPolyline, Spline};
use dxf::enums::Units;
use dxf::{LwPolylineVertex, Point, Vector};
use rtec_files::InputError;
use rtec_part::contour::{Contour, FeatureKind};
use rtec_part::contour_from_dxf::{DxfOptions, read};
use rtec_part::geometric_fit::Zx;
use rtec_part::length_unit::LengthUnit;

fn line(a: (f64, f64), b: (f64, f64)) -> EntityType {
    EntityType::Line(Line::new(Point::new(a.0, a.1, 0.0), Point::new(b.0, b.1, 0.0)))
}

fn arc(centre: (f64, f64), radius: f64, start_deg: f64, end_deg: f64) -> EntityType {
    EntityType::Arc(Arc::new(Point::new(centre.0, centre.1, 0.0), radius, start_deg, end_deg))
}

/// A part as in NISTIR 4854, in inches.
/// It has a nose of 1.5 in about Z 5, a cylinder, a face, a cylinder, a taper.
fn nose_part() -> Vec<EntityType> {
    vec![
        line((4.55, 1.5), (4.55, 1.8)),
        arc((5.0, 0.0), 1.5, 0.0, 90.0),
        line((3.0, 1.8), (0.5, 2.1)),
        line((5.0, 1.5), (4.55, 1.5)),
        line((4.55, 1.8), (3.0, 1.8)),
    ]
}

fn contour(
    units: Units,
    entities: Vec<EntityType>,
    options: &DxfOptions,
) -> Result<(Contour, LengthUnit), InputError> {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("part.dxf");
    let mut drawing = dxf::Drawing::new();
    drawing.header.version = dxf::enums::AcadVersion::R2000;
    drawing.header.default_drawing_units = units;
    for e in entities {
        drawing.add_entity(Entity::new(e));
    }
    drawing.save_file(&file).unwrap();
    read(&file, options)
}

fn finding(entities: Vec<EntityType>) -> InputError {
    contour(Units::Inches, entities, &DxfOptions::default()).unwrap_err()
}

#[test]
fn features_stand_in_probing_order() {
    let (part, unit) = contour(Units::Inches, nose_part(), &DxfOptions::default()).unwrap();
    assert_eq!(unit, LengthUnit::INCH);
    let kinds: Vec<FeatureKind> = part.features.iter().map(|f| f.kind).collect();
    assert!(
        matches!(kinds[0], FeatureKind::Arc { radius_mm, .. } if (radius_mm - 38.1).abs() < 1e-9),
        "{kinds:?}"
    );
    assert!(matches!(kinds[1], FeatureKind::Cylinder { radius_mm } if (radius_mm - 38.1).abs() < 1e-9));
    assert!(matches!(kinds[2], FeatureKind::Step { .. }) && matches!(kinds[3], FeatureKind::Cylinder { .. }));
    assert!(
        matches!(kinds[4], FeatureKind::Taper { angle_deg } if (angle_deg + 6.8428).abs() < 1e-3),
        "{kinds:?}"
    );
    assert!(
        (part.features[0].segment.at(0.0) - Zx::new(6.5 * 25.4, 0.0)).norm() < 1e-9,
        "starts on the axis"
    );
    // Normals point out of the material: along the radius on the nose, +Z on the face, +X on the cylinder.
    let n = part.place(0, part.features[0].segment.length_mm() / 2.0).normal;
    assert!((n - Zx::at_angle(std::f64::consts::FRAC_PI_4)).norm() < 1e-9);
    assert!((part.place(2, 1.0).normal - Zx::new(1.0, 0.0)).norm() < 1e-9);
    assert!((part.place(3, 1.0).normal - Zx::new(0.0, 1.0)).norm() < 1e-9);
}

#[test]
fn a_closed_drawing_and_a_ring_are_taken() {
    let mut closed = nose_part();
    closed.extend([line((0.5, 2.1), (0.5, 0.0)), line((0.5, 0.0), (6.5, 0.0))]);
    let (part, _) = contour(Units::Inches, closed, &DxfOptions::default()).unwrap();
    assert_eq!(part.features.len(), 6, "the axis is no feature");
    let vertex = |x, y| LwPolylineVertex { x, y, ..Default::default() };
    let ring = LwPolyline {
        flags: 1,
        vertices: vec![vertex(0.0, 10.0), vertex(0.0, 20.0), vertex(30.0, 20.0), vertex(30.0, 10.0)],
        ..Default::default()
    };
    let (ring, _) =
        contour(Units::Millimeters, vec![EntityType::LwPolyline(ring)], &DxfOptions::default()).unwrap();
    assert!(ring.closed);
    // The bore's surface faces the axis.
    let bore = ring.nearest(Zx::new(15.0, 9.0)).unwrap();
    assert!((bore.normal - Zx::new(0.0, -1.0)).norm() < 1e-9, "{bore:?}");
    let outside = ring.nearest(Zx::new(15.0, 21.0)).unwrap();
    assert!((outside.normal - Zx::new(0.0, 1.0)).norm() < 1e-9);
}

#[test]
fn conics_and_bulges_lie_where_they_should() {
    let ellipse = Ellipse {
        center: Point::new(50.0, 0.0, 0.0),
        major_axis: Vector::new(20.0, 0.0, 0.0),
        minor_axis_ratio: 0.5,
        start_parameter: 0.0,
        end_parameter: std::f64::consts::FRAC_PI_2,
        ..Default::default()
    };
    // A quarter of a circle of radius 10 as a rational quadratic: from (50, 10) to (40, 20) about (40, 10).
    let spline = Spline {
        degree_of_curve: 2,
        knot_values: vec![0.0, 0.0, 0.0, 1.0, 1.0, 1.0],
        weight_values: vec![1.0, std::f64::consts::FRAC_1_SQRT_2, 1.0],
        control_points: [(50.0, 10.0), (50.0, 20.0), (40.0, 20.0)]
            .map(|(x, y)| Point::new(x, y, 0.0))
            .to_vec(),
        ..Default::default()
    };
    // Half a circle of radius 2 from (40, 20) to (36, 20), bulge 1 = counter-clockwise.
    let vertex = |x, y, bulge| LwPolylineVertex { x, y, bulge, ..Default::default() };
    let bulge =
        LwPolyline { vertices: vec![vertex(40.0, 20.0, 1.0), vertex(36.0, 20.0, 0.0)], ..Default::default() };
    let all = vec![EntityType::Spline(spline), EntityType::Ellipse(ellipse), EntityType::LwPolyline(bulge)];
    let (part, _) = contour(Units::Millimeters, all, &DxfOptions::default()).unwrap();
    assert_eq!(part.features.len(), 3);
    for k in 0..=20 {
        let t = f64::from(k) / 20.0;
        let e = part.features[0].segment.at(t) - Zx::new(50.0, 0.0);
        assert!(((e.z / 20.0).powi(2) + (e.x / 10.0).powi(2) - 1.0).abs() < 1e-9);
        assert!(((part.features[1].segment.at(t) - Zx::new(40.0, 10.0)).norm() - 10.0).abs() < 1e-9, "{t}");
        assert!(((part.features[2].segment.at(t) - Zx::new(38.0, 20.0)).norm() - 2.0).abs() < 1e-9);
    }
    assert!((part.features[1].segment.length_mm() - 5.0 * std::f64::consts::PI).abs() < 1e-3);
    let on = part.place(1, 5.0);
    assert!((on.normal - (on.at - Zx::new(40.0, 10.0)).unit().unwrap()).norm() < 1e-4, "{on:?}");
}

#[test]
fn bad_drawings_are_named() {
    let e = contour(Units::Unitless, nose_part(), &DxfOptions::default()).unwrap_err();
    assert!(e.found.contains("unknown units"), "{e}");
    let inch = DxfOptions { unit: Some(LengthUnit::INCH), ..DxfOptions::default() };
    assert!(contour(Units::Unitless, nose_part(), &inch).is_ok());

    let mut gap = nose_part();
    gap[3] = line((5.0, 1.5), (4.56, 1.5));
    let e = finding(gap);
    assert!(e.found.contains("open contour") && e.found.contains("0.0100 units") && e.line > 0, "{e}");

    let mut twice = nose_part();
    twice.push(line((4.55, 1.8), (4.55, 1.5)));
    let e = finding(twice);
    assert!(e.found.contains("duplicate of LINE") && e.line > 0, "{e}");

    let mut open = nose_part();
    open.push(line((2.0, 0.0), (6.5, 0.0)));
    assert!(finding(open).found.contains("open contour"));

    let mut branch = nose_part();
    branch.push(line((5.0, 1.5), (5.0, 2.5)));
    assert!(finding(branch).found.contains("branch"));

    let mut below = nose_part();
    below[1] = arc((5.0, 0.0), 1.5, -10.0, 90.0);
    assert!(finding(below).found.contains("below the axis"));

    assert!(finding(vec![]).found.contains("no contour"));
    assert!(finding(vec![line((1.0, 1.0), (1.0, 1.0))]).found.contains("without length"));
    assert!(finding(vec![line((1.0, f64::NAN), (2.0, 1.0))]).line > 0);
    let circle = EntityType::Circle(dxf::entities::Circle::new(Point::new(5.0, 5.0, 0.0), 1.0));
    assert!(finding(vec![circle]).found.contains("CIRCLE"));
    assert!(finding(vec![EntityType::Spline(Spline::default())]).found.contains("control points"));
    let tilted = EntityType::Line(Line::new(Point::new(0.0, 1.0, 0.0), Point::new(1.0, 1.0, 0.5)));
    assert!(finding(vec![tilted]).found.contains("plane"));

    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("x.dxf");
    for junk in ["", "hello\n", "0\nSECTION\n2\nENTITIES\n0\nLINE\n10\nabc\n", "  0\nSECTION\n  2\n"] {
        std::fs::write(&file, junk).unwrap();
        assert!(read(&file, &DxfOptions::default()).is_err(), "{junk:?}");
    }
    assert!(read(&folder.path().join("none.dxf"), &DxfOptions::default()).is_err());
}

#[test]
fn what_no_machine_could_hold_is_refused_at_once() {
    let ellipse_to = |major: f64, ratio: f64, end_parameter: f64| {
        EntityType::Ellipse(Ellipse {
            major_axis: Vector::new(major, 0.0, 0.0),
            minor_axis_ratio: ratio,
            start_parameter: 0.0,
            end_parameter,
            ..Ellipse::default()
        })
    };
    let ellipse = |major: f64, ratio: f64| ellipse_to(major, ratio, 1.5);
    let found = finding(vec![ellipse(1.0, 4e9)]);
    assert!(found.found.contains("axis ratio of 4e9"), "{found}");
    // One that turns back on itself is refused; a flat one that does not is a line.
    let found = finding(vec![ellipse_to(1.0, 1e-9, 4.0)]);
    assert!(found.found.contains("axis ratio"), "{found}");
    let found = finding(vec![ellipse(1e6, 0.5)]);
    assert!(found.found.contains("more than 100 m"), "{found}");
    let found = finding(vec![line((0.0, 1.0), (1e9, 1.0))]);
    assert!(found.found.contains("more than 100 m"), "{found}");
}

/// Another library's drawing reads the same as text and as binary.
/// The versions are R12 and R2000.
#[test]
fn binary_drawings_read_like_text() {
    let folder = tempfile::tempdir().unwrap();
    for version in [dxf::enums::AcadVersion::R12, dxf::enums::AcadVersion::R2000] {
        let mut drawing = dxf::Drawing::new();
        drawing.header.version = version;
        drawing.header.default_drawing_units = Units::Inches;
        for entity in nose_part() {
            drawing.add_entity(Entity::new(entity));
        }
        let [text, binary] = ["text.dxf", "binary.dxf"].map(|name| folder.path().join(name));
        drawing.save_file(&text).unwrap();
        drawing.save_file_binary(&binary).unwrap();
        let inch = DxfOptions { unit: Some(LengthUnit::INCH), ..DxfOptions::default() };
        let [text, binary] = [text, binary].map(|file| format!("{:?}", read(&file, &inch).unwrap()));
        assert_eq!(text, binary, "{version:?}");
        assert!(text.contains("38.0"), "{text}");
    }
    let whole = std::fs::read(folder.path().join("binary.dxf")).unwrap();
    // Cut at the end of its entities, because what follows is not part of the contour.
    let place = |word: &[u8]| whole.windows(word.len()).position(|w| w == word).unwrap();
    let entities = place(b"ENTITIES");
    let end = entities + whole[entities..].windows(6).position(|w| w == b"ENDSEC").unwrap();
    for n in (0..end).step_by(7) {
        let file = folder.path().join("cut.dxf");
        std::fs::write(&file, &whole[..n]).unwrap();
        assert!(read(&file, &DxfOptions::default()).is_err(), "{n} of {} bytes", whole.len());
    }
}

#[test]
fn broken_groups_are_named_with_their_line() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("x.dxf");
    let head = "0\nSECTION\n2\nENTITIES\n0\nLINE\n8\nR\\U+00E4nder\n";
    for (text, line, found) in [
        (format!("{head}10\nabc\n"), 10, "'abc'"),
        (format!("{head}10\n1,5\n"), 10, "'1,5'"),
        (format!("{head}ten\n1.5\n"), 9, "'ten'"),
        (format!("{head}10\n1.5\n"), 4, "the end of the file within the section ENTITIES"),
        ("0\nSECTION\n2\nENTITIES\n0\nENDSEC\n5\n1F\n0\nEOF\n".to_owned(), 8, "group 5 '1F'"),
    ] {
        std::fs::write(&file, &text).unwrap();
        let e = read(&file, &DxfOptions::default()).unwrap_err();
        assert_eq!((e.line, &*e.found), (line, found), "{text}");
    }
    let rest = "10\n0\n20\n9\n11\n5\n21\n9\n0\nENDSEC\n0\nEOF\n";
    let read_layer = |bytes: &[u8]| {
        std::fs::write(&file, bytes).unwrap();
        let options = DxfOptions {
            layer: Some("Ränder".to_owned()),
            unit: Some(LengthUnit::INCH),
            ..DxfOptions::default()
        };
        read(&file, &options).map(|(contour, _)| contour.features.len())
    };
    // Escaped, in UTF-8, in Windows-1252, with the line ends of three systems.
    let escaped = format!("{head}{rest}");
    let utf8 = escaped.replace("\\U+00E4", "ä");
    let western: Vec<u8> = utf8.chars().map(|c| c as u8).collect();
    assert_eq!(read_layer(escaped.as_bytes()), Ok(1));
    assert_eq!(read_layer(utf8.as_bytes()), Ok(1));
    assert_eq!(read_layer(&western), Ok(1));
    assert_eq!(read_layer(escaped.replace('\n', "\r").as_bytes()), Ok(1));
    assert_eq!(read_layer(escaped.replace('\n', "\r\n").as_bytes()), Ok(1));
}
