//! Files as people have them. Each is of a kind that was once read wrongly.

#![allow(clippy::unwrap_used, clippy::format_collect, reason = "helpers and inputs of tests")]

use rtec_part::batch_evaluation::{self, SignificanceLimits};
use rtec_part::part_errors::{NominalShape, ProbedPoints};
use std::path::PathBuf;

fn field(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/field").join(name)
}

#[test]
fn a_spreadsheet_is_one_batch_however_it_is_saved() {
    let judgement = SignificanceLimits { alpha: 0.01, least_um: 1.0 };
    for (name, written) in [
        ("batch-point.csv", None),
        ("batch-comma.csv", Some("columns parted by semicolons, decimal commas")),
        ("batch-sep-line.csv", Some("columns parted by semicolons, decimal commas")),
        ("batch-thousands.csv", Some("columns parted by semicolons, decimal commas")),
        ("batch-utf16.csv", Some("UTF-16, columns parted by semicolons, decimal commas")),
    ] {
        let batch = batch_evaluation::evaluate_columns(&field(name), &[], None, judgement).unwrap();
        assert!((batch.places[0].mean_um - 11.55).abs() < 0.005, "{name}: {}", batch.places[0].mean_um);
        assert_eq!(
            batch.written.as_deref().map(|w| w.contains(written.unwrap_or("-"))),
            written.map(|_| true)
        );
    }
}

#[test]
fn a_size_below_its_standard_error_is_not_told() {
    let probed = ProbedPoints::read(&field("six-points.csv")).unwrap();
    let report = probed.errors(NominalShape::Circle { radius_mm: 27.3504 }, 0.0).unwrap();
    assert!(!report.is_size_known());
    assert!(report.size_standard_error_um.unwrap() > 57.0, "{:?}", report.size_standard_error_um);
}

/// Six points on a taper of 3°.
/// A difference of half its standard error is not reported as an angle; 0.05° are.
#[test]
fn an_angle_within_its_interval_is_not_told() {
    let scatter_um = [1.9, -0.7, -2.3, 2.6, -1.1, 0.4];
    for (taper_deg, known) in [(3.0, false), (3.05, true)] {
        let slope = f64::to_radians(3.0).tan();
        let row = |(i, e): (usize, &f64)| {
            let z = 10.0 * i as f64;
            format!("{z},{:.6}\n", 20.0 + z * slope + e * 1e-3)
        };
        let rows: String = scatter_um.iter().enumerate().map(row).collect();
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("taper.csv");
        std::fs::write(&file, format!("z_mm,x_mm\n{rows}")).unwrap();
        let report = ProbedPoints::read(&file)
            .unwrap()
            .errors(NominalShape::Line { taper_deg: Some(taper_deg) }, 0.0)
            .unwrap();
        assert_eq!(report.is_inclination_known(), known, "{:?}", report.inclination_error_deg);
        // Student's t of four degrees of freedom, not of a normal distribution.
        let wide = report.inclination_within_deg().unwrap() / report.inclination_standard_error_deg.unwrap();
        assert!((wide - 2.776).abs() < 1e-3, "{wide}");
    }
}

mod drawings {
    use super::field;
    use rtec_part::contour::{Contour, FeatureKind, Segment, Spline};
    use rtec_part::contour_from_dxf::{self, DxfOptions};
    use rtec_part::geometric_fit::Zx;

    fn contour(name: &str) -> Contour {
        contour_from_dxf::read(&field(name), &DxfOptions::default()).unwrap().0
    }

    #[test]
    fn nearly_straight_arcs_are_straight_and_said() {
        for name in ["speck-1e-7.dxf", "speck-1e-13.dxf"] {
            let contour = contour(name);
            let cylinders =
                contour.features.iter().filter(|f| matches!(f.kind, FeatureKind::Cylinder { .. })).count();
            assert_eq!((contour.features.len(), cylinders), (3, 1), "{name}");
            assert!(contour.cleaned[0].contains("took 1 arc as straight: within 0.00001 mm"), "{name}");
        }
    }

    #[test]
    fn a_vertex_given_twice_is_one() {
        let contour = contour("vertex-twice.dxf");
        assert_eq!(contour.features.len(), 3);
        assert!(contour.cleaned[0].contains("left out 1 vertex within 0.001 mm"), "{:?}", contour.cleaned);
    }

    #[test]
    fn a_fitted_curve_is_taken_without_its_frame() {
        let (with_frame, alone) = (contour("spline-fit.dxf"), contour("fitted-only.dxf"));
        let kinds = |c: &Contour| c.features.iter().map(|f| f.kind).collect::<Vec<_>>();
        assert_eq!(kinds(&with_frame), kinds(&alone));
        assert!(with_frame.cleaned[0].contains("the fitted curve was taken"), "{:?}", with_frame.cleaned);
        assert!(alone.cleaned.is_empty());
    }

    fn line(a: [f64; 2], b: [f64; 2]) -> String {
        format!("0\nLINE\n8\n0\n10\n{}\n20\n{}\n11\n{}\n21\n{}\n", a[0], a[1], b[0], b[1])
    }

    /// A step, a cylinder of 80 mm, a step, and one entity.
    /// The entity is added, or replaces the cylinder.
    fn drawn(entity: &str, instead: bool) -> Result<Contour, rtec_files::InputError> {
        let cylinder = if instead { String::new() } else { line([80.0, 20.0], [0.0, 20.0]) };
        let (front, back) = (line([80.0, 0.0], [80.0, 20.0]), line([0.0, 20.0], [0.0, 0.0]));
        of_entities(&format!("{front}{cylinder}{entity}{back}"))
    }

    fn of_entities(entities: &str) -> Result<Contour, rtec_files::InputError> {
        let text = format!(
            "0\nSECTION\n2\nHEADER\n9\n$INSUNITS\n70\n4\n0\nENDSEC\n0\nSECTION\n2\nENTITIES\n{entities}0\nENDSEC\n0\nEOF\n"
        );
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("drawn.dxf");
        std::fs::write(&file, text).unwrap();
        contour_from_dxf::read(&file, &DxfOptions::default()).map(|(contour, _)| contour)
    }

    /// Group codes and values, one line each.
    fn entity(name: &str, groups: &[(i32, f64)]) -> String {
        let whole = |code: i32| (60..80).contains(&code) || code == 90;
        let lines = groups.iter().map(|(code, value)| {
            if whole(*code) { format!("{code}\n{}\n", *value as i64) } else { format!("{code}\n{value}\n") }
        });
        format!("0\n{name}\n8\n0\n{}", lines.collect::<String>())
    }

    fn spline(points: &[[f64; 2]]) -> String {
        let n = points.len();
        let mut groups = vec![(70, 8.0), (71, 3.0), (72, (n + 4) as f64), (73, n as f64), (74, 0.0)];
        groups.extend((0..n + 4).map(|k| (40, k.saturating_sub(3).min(n - 3) as f64)));
        groups.extend(points.iter().flat_map(|p| [(10, p[0]), (20, p[1]), (30, 0.0)]));
        entity("SPLINE", &groups)
    }

    /// A spline by its degree, its knots and its control points.
    fn spline_of(degree: usize, knots: &[f64], points: &[[f64; 2]]) -> String {
        let counts = [(71, degree), (72, knots.len()), (73, points.len()), (74, 0)];
        let mut groups = vec![(70, 8.0)];
        groups.extend(counts.map(|(code, n)| (code, n as f64)));
        groups.extend(knots.iter().map(|k| (40, *k)));
        groups.extend(points.iter().flat_map(|p| [(10, p[0]), (20, p[1]), (30, 0.0)]));
        entity("SPLINE", &groups)
    }

    /// A spline may hold corners: each smooth piece is a feature, whatever its degree.
    #[test]
    fn a_spline_is_cut_at_its_corners() {
        let (from, corner, to) = ([80.0, 20.0], [50.0, 20.0], [0.0, 30.0]);
        let between = |a: [f64; 2], b: [f64; 2], t: f64| [a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t];
        let straight =
            |a, b, degree: usize| (0..degree).map(move |k| between(a, b, k as f64 / degree as f64));
        for degree in 1..=5 {
            let points: Vec<_> =
                straight(from, corner, degree).chain(straight(corner, to, degree)).chain([to]).collect();
            let mut knots = vec![0.0; degree + 1];
            knots.extend(vec![0.4; degree]);
            knots.extend(vec![1.0; degree + 1]);
            let back = line(to, [0.0, 0.0]);
            let front = line([80.0, 0.0], from);
            let contour =
                of_entities(&format!("{front}{}{back}", spline_of(degree, &knots, &points))).unwrap();
            let kinds: Vec<_> = contour.features.iter().map(|f| f.kind).collect();
            let [_, FeatureKind::Cylinder { radius_mm }, FeatureKind::Taper { angle_deg }, _] = kinds[..]
            else {
                panic!("degree {degree}: {kinds:?}")
            };
            assert!((radius_mm - 20.0).abs() < 1e-9, "{radius_mm}");
            assert!((angle_deg.abs() - (10.0_f64 / 50.0).atan().to_degrees()).abs() < 1e-9, "{angle_deg}");
        }
        // Béziers that go on without a corner are one feature.
        let smooth =
            [[80.0, 20.0], [70.0, 20.0], [60.0, 22.0], [50.0, 24.0], [40.0, 26.0], [10.0, 20.0], [0.0, 20.0]];
        let knots = [0.0, 0.0, 0.0, 0.0, 0.5, 0.5, 0.5, 1.0, 1.0, 1.0, 1.0];
        assert_eq!(drawn(&spline_of(3, &knots, &smooth), true).unwrap().features.len(), 3);
    }

    /// Lengths are those of the curve, not of chords.
    #[test]
    fn a_curve_is_as_long_as_it_is() {
        let root = 0.5_f64.sqrt();
        let quarter = Spline {
            degree: 2,
            knots: vec![0.0, 0.0, 0.0, 1.0, 1.0, 1.0],
            points: vec![Zx::new(20.0, 0.0), Zx::new(20.0, 20.0), Zx::new(0.0, 20.0)],
            weights: vec![1.0, root, 1.0],
        };
        let exact_mm = 10.0 * std::f64::consts::PI;
        for segment in [
            Segment::Spline(quarter),
            Segment::Ellipse {
                centre: Zx::new(0.0, 0.0),
                major: Zx::new(20.0, 0.0),
                ratio: 1.0,
                start_rad: 0.0,
                sweep_rad: std::f64::consts::FRAC_PI_2,
            },
        ] {
            assert!((segment.length_mm() - exact_mm).abs() < 1e-6, "{}", segment.length_mm());
        }
    }

    #[test]
    fn specks_of_every_entity_are_left_out_and_said() {
        let speck = [[80.0, 20.0]; 4];
        for (name, more) in [
            ("line", entity("LINE", &[(10, 80.0), (20, 20.0), (11, 80.0), (21, 20.000_000_1)])),
            ("arc", entity("ARC", &[(10, 75.0), (20, 20.0), (40, 5.0), (50, 0.0), (51, 1e-6)])),
            (
                "arc without radius",
                entity("ARC", &[(10, 80.0), (20, 20.0), (40, 1e-7), (50, 0.0), (51, 90.0)]),
            ),
            ("circle", entity("CIRCLE", &[(10, 80.0), (20, 20.0), (40, 0.0)])),
            (
                "ellipse",
                entity(
                    "ELLIPSE",
                    &[(10, 80.0), (20, 20.0), (11, 1e-7), (21, 0.0), (40, 0.5), (41, 0.0), (42, 1.5)],
                ),
            ),
            (
                "flat ellipse",
                entity(
                    "ELLIPSE",
                    &[(10, 80.0), (20, 20.0), (11, 1e-4), (21, 0.0), (40, 1e-7), (41, 0.0), (42, 1.5)],
                ),
            ),
            ("spline", spline(&speck)),
            (
                "polyline",
                entity("LWPOLYLINE", &[(90, 2.0), (70, 0.0), (10, 80.0), (20, 20.0), (10, 80.0), (20, 20.0)]),
            ),
        ] {
            let contour = drawn(&more, false).unwrap();
            assert_eq!(contour.features.len(), 3, "{name}");
            assert!(
                contour.cleaned.iter().any(|c| c.contains("left out 1 ")),
                "{name}: {:?}",
                contour.cleaned
            );
        }
    }

    #[test]
    fn lines_shorter_than_the_tolerance_keep_their_way() {
        use std::f64::consts::FRAC_PI_2;
        // A quarter of a circle of 2 mm, then a cylinder and a face. The arc's steps, in µm, are repeated.
        let chained = |steps_um: &[f64], jumbled: bool| {
            let (mut angles, mut k) = (vec![0.0], 0);
            while let Some(last) = angles.last().copied().filter(|a| *a < FRAC_PI_2) {
                angles.push((last + steps_um[k % steps_um.len()] / 2000.0).min(FRAC_PI_2));
                k += 1;
            }
            let at = |angle: f64| [2.0 * angle.cos(), 2.0 * angle.sin()];
            let mut lines: Vec<String> = angles
                .windows(2)
                .enumerate()
                .map(|(i, w)| {
                    let turned = jumbled && i % 3 == 0;
                    if turned { line(at(w[1]), at(w[0])) } else { line(at(w[0]), at(w[1])) }
                })
                .collect();
            let n = lines.len();
            if jumbled {
                lines = (0..n).map(|i| lines[(i * 7919) % n].clone()).collect();
            }
            lines.push(line([2.0 * FRAC_PI_2.cos(), 2.0], [-8.0, 2.0]) + &line([-8.0, 2.0], [-8.0, 0.0]));
            of_entities(&lines.concat()).unwrap()
        };
        for (steps_um, jumbled) in [
            (&[0.52][..], false),
            (&[0.52], true),
            (&[0.9, 1.1], true),
            (&[0.01, 3.0], false),
            (&[0.3, 0.3, 5.0, 0.999, 0.1], true),
        ] {
            let contour = chained(steps_um, jumbled);
            let length: f64 = contour.features.iter().map(|f| f.segment.length_mm()).sum();
            assert!((length - 10.0 - std::f64::consts::PI).abs() < 1e-3, "{steps_um:?}: {length}");
            let off = contour.chords().iter().flat_map(|(_, c)| c).filter(|p| p.z > 1e-9);
            assert!(off.clone().all(|p| (p.norm() - 2.0).abs() < 1e-6), "{steps_um:?}");
            let said = &contour.cleaned[0];
            assert!(said.contains("left out") && said.contains("0.001 mm"), "{said}");
            let cylinders =
                contour.features.iter().filter(|f| matches!(f.kind, FeatureKind::Cylinder { .. }));
            assert_eq!(cylinders.count(), 1, "{steps_um:?}");
        }
    }

    #[test]
    fn small_fillets_of_short_lines_stay() {
        // A corner of 2 µm in five lines, between a face and a cylinder.
        let at = |k: u32| {
            let turn = f64::from(k) * std::f64::consts::FRAC_PI_2 / 5.0;
            [79.998 + 0.002 * turn.cos(), 19.998 + 0.002 * turn.sin()]
        };
        let mut text = line([80.0, 0.0], [80.0, 19.998]);
        text.extend((0..5).map(|k| line(at(k), at(k + 1))));
        text += &(line([79.998, 20.0], [0.0, 20.0]) + &line([0.0, 20.0], [0.0, 0.0]));
        let contour = of_entities(&text).unwrap();
        let small: f64 = contour.features.iter().map(|f| f.segment.length_mm()).filter(|mm| *mm < 0.1).sum();
        assert!((small - 0.003_141_6).abs() < 3e-4, "{small}");
        assert_eq!(contour.features.iter().filter(|f| f.segment.length_mm() > 1.0).count(), 3);
    }

    #[test]
    fn arcs_from_an_angle_to_the_same_are_nothing_and_said() {
        for more in [
            entity("ARC", &[(10, 75.0), (20, 20.0), (40, 5.0), (50, 30.0), (51, 30.0)]),
            entity(
                "ELLIPSE",
                &[(10, 75.0), (20, 20.0), (11, 5.0), (21, 0.0), (40, 0.5), (41, 1.0), (42, 1.0)],
            ),
        ] {
            let contour = drawn(&more, false).unwrap();
            assert_eq!(contour.features.len(), 3);
            let said = "left out 1 arc from an angle to the same angle";
            assert!(contour.cleaned[0].contains(said), "{:?}", contour.cleaned);
        }
        let alone = entity("ARC", &[(10, 75.0), (20, 20.0), (40, 5.0), (50, 30.0), (51, 30.0)]);
        assert!(of_entities(&alone).unwrap_err().found.contains("without length, and nothing longer"));
    }

    #[test]
    fn flat_curves_of_every_entity_are_straight_and_said() {
        let half_turn = std::f64::consts::PI;
        let radius = 1e9_f64;
        let centre = 20.0 - (radius * radius - 1600.0).sqrt();
        let angle = |z: f64| (20.0 - centre).atan2(z).to_degrees();
        for (name, piece) in [
            (
                "arc",
                entity(
                    "ARC",
                    &[(10, 40.0), (20, centre), (40, radius), (50, angle(40.0)), (51, angle(-40.0))],
                ),
            ),
            (
                "ellipse",
                entity(
                    "ELLIPSE",
                    &[(10, 40.0), (20, 20.0), (11, 40.0), (21, 0.0), (40, 1e-9), (41, 0.0), (42, half_turn)],
                ),
            ),
            ("spline", spline(&[[80.0, 20.0], [80.0, 20.0], [60.0, 20.000_001], [20.0, 20.0], [0.0, 20.0]])),
        ] {
            let contour = drawn(&piece, true).unwrap();
            let cylinders =
                contour.features.iter().filter(|f| matches!(f.kind, FeatureKind::Cylinder { .. }));
            assert_eq!((contour.features.len(), cylinders.count()), (3, 1), "{name}");
            assert!(
                contour.cleaned.iter().any(|c| c.contains("as straight")),
                "{name}: {:?}",
                contour.cleaned
            );
        }
        // A curve that turns back is not a line.
        let back = entity(
            "ELLIPSE",
            &[(10, 40.0), (20, 20.0), (11, 40.0), (21, 0.0), (40, 1e-9), (41, 0.0), (42, 4.0)],
        );
        assert!(drawn(&back, true).unwrap_err().found.contains("an axis ratio of 1e-9"));
    }
}

#[test]
fn steps_of_a_caliper_are_in_a_batch_s_intervals() {
    // 6 µm too large, read by a caliper of 10 µm: every part reads 10.
    let rows: String = (1..=8).map(|part| format!("{part},D1,38.10,38.11\n")).collect();
    let judgement = SignificanceLimits { alpha: 0.01, least_um: 1.0 };
    let text = format!("part,feature,nominal_mm,measured_mm\n{rows}");
    let batch = batch_evaluation::evaluate_text(&PathBuf::from("b.csv"), &text, None, judgement).unwrap();
    let place = &batch.places[0];
    assert!((batch.step_um.unwrap() - 10.0).abs() < 1e-6);
    assert!(place.interval_um.is_some_and(|[low, high]| low < 6.0 && 6.0 < high), "{:?}", place.interval_um);
    // Half a step may be no error.
    let text = text.replace("38.11", "38.105").replace("8,D1,38.10,38.105", "8,D1,38.10,38.100");
    let batch = batch_evaluation::evaluate_text(&PathBuf::from("b.csv"), &text, None, judgement).unwrap();
    assert!((batch.step_um.unwrap() - 5.0).abs() < 1e-6, "{:?}", batch.step_um);
    let fine = batch_evaluation::evaluate_columns(&field("batch-point.csv"), &[], None, judgement).unwrap();
    assert_eq!(fine.step_um, None);
}

#[test]
fn steps_of_points_are_in_the_standard_errors() {
    // A quarter circle of 10 mm, its places rounded to 0.1 mm.
    let rows: String = (0..12)
        .map(|i| (f64::from(i) * 0.14).sin_cos())
        .map(|(x, z)| format!("{:.1},{:.1}\n", 10.0 * z, 10.0 * x))
        .collect();
    let probed = ProbedPoints::parse(&PathBuf::from("p.csv"), &format!("z_mm,x_mm\n{rows}")).unwrap();
    let report = probed.errors(NominalShape::Circle { radius_mm: 10.0 }, 0.0).unwrap();
    assert!((report.step_um.unwrap() - 100.0).abs() < 1e-6);
    assert!(report.size_standard_error_um.unwrap() > 100.0 / 12f64.sqrt() / 12f64.sqrt());
}
