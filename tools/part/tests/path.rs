//! Probing points and paths.
//! The tests cover the report's figures, the files, collisions and by-passes.
#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use rtec_part::contour::{Contour, Segment};
use rtec_part::geometric_fit::Zx;
use rtec_part::length_unit::LengthUnit;
use rtec_part::probe_path::{
    PathPointRole, ProbeGeometry, ProbingMotion, ProbingPlan, StylusStem, number_at, pathfin, read_pathfin,
};
use std::f64::consts::FRAC_PI_2;

/// The part of NISTIR 4854, figures 4 and 7, in mm.
/// It has a nose of 1.5 in about Z 5, a cylinder, a step to 1.8 in, a cylinder.
fn part() -> Contour {
    let at = |z: f64, x: f64| Zx::new(z, x) * 25.4;
    let line = |a, b| (Segment::Line { a, b }, String::new());
    let nose = Segment::Arc { centre: at(5.0, 0.0), radius_mm: 38.1, start_rad: 0.0, sweep_rad: FRAC_PI_2 };
    Contour::new(
        vec![
            (nose, String::new()),
            line(at(5.0, 1.5), at(4.55, 1.5)),
            line(at(4.55, 1.5), at(4.55, 1.8)),
            line(at(4.55, 1.8), at(3.0, 1.8)),
        ],
        false,
    )
}

/// A tip of 5 mm diameter.
/// The touch ends with its centre on the nominal surface, as in figure 7.
const PROBE: ProbeGeometry =
    ProbeGeometry { tip_mm: 2.5, stand_off_mm: 5.12, over_travel_mm: 2.5, stem: None };

#[test]
fn the_reports_stand_off_and_over_travel() {
    let m = ProbingMotion::REPORT;
    assert!((m.stand_off_mm() - 5.0).abs() < 0.01, "{}", m.stand_off_mm());
    assert!((m.over_travel_mm() - 2.5).abs() < 0.01, "{}", m.over_travel_mm());
    let slow = ProbingMotion { feed_mm_min: 125.0, ..m };
    assert!(slow.stand_off_mm() < 1.02 && slow.over_travel_mm() < 1.01);
}

#[test]
fn figure_seven_comes_out() {
    let part = part();
    let mut plan = ProbingPlan::new(PROBE);
    plan.add_number(&part, 0, 20, 0.0);
    let text = pathfin(&plan.records(), LengthUnit::INCH);
    assert_eq!(text.lines().count(), 60);
    // NISTIR 4854, figure 7: the nineteenth of twenty points on the quadrant.
    for line in [
        "POINT start 5.148643, 1.793852, 0.000000",
        "POINT touch 19, 5.123869, 1.494877, 0.000000",
        "POINT finish 5.148643, 1.793852, 0.000000",
        "POINT start 5.000000, 1.800000, 0.000000",
        "POINT touch 20, 5.000000, 1.500000, 0.000000",
    ] {
        assert!(text.contains(line), "{line}\n{text}");
    }
    assert!(plan.hits(&part).is_empty(), "{:?}", plan.hits(&part));
}

#[test]
fn the_path_file_is_read_as_it_is_written() {
    let part = part();
    let mut plan = ProbingPlan::new(PROBE);
    plan.add_number(&part, 0, 5, 0.0);
    plan.add_number(&part, 3, number_at(part.features[3].segment.length_mm() - 2.0, 10.0), 1.0);
    plan.points[5].bypass = vec![Zx::new(130.0, 60.0)];
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("pathfin.cdl");
    for unit in [LengthUnit::MM, LengthUnit::INCH] {
        std::fs::write(&file, pathfin(&plan.records(), unit)).unwrap();
        let back = read_pathfin(&file, unit).unwrap();
        assert_eq!(back.len(), plan.records().len());
        for (a, b) in back.iter().zip(plan.records()) {
            assert!(a.role == b.role && (a.at - b.at).norm() < 2e-5, "{a:?} {b:?}");
        }
    }
    let points = plan.expected();
    assert!((points[6] - points[5]).norm() <= 10.0, "spacing is a largest distance");
    for (bad, line) in [
        ("POINT start 1, 2\n", 1),
        ("POINT start 1, 2, 0\nPOINT touch 2, 1, 1, 0\n", 2),
        ("POINT start 1, x, 0\n", 1),
        ("LINE 1,2,0\n", 1),
        ("POINT hover 1, 2, 0\n", 1),
        ("POINT touch 1, 1, 2, 0\n", 1),
        // Line numbers are those of the file, not of the records.
        ("\n\nPOINT touch 1, 1, 2, 0\n", 3),
        // A place that could not be written again.
        ("POINT start 1, 1e305, 0\n", 1),
        ("", 0),
    ] {
        std::fs::write(&file, bad).unwrap();
        assert_eq!(read_pathfin(&file, LengthUnit::MM).unwrap_err().line, line, "{bad:?}");
    }
}

#[test]
fn collisions_are_found_and_gone_round() {
    let part = part();
    // From the nose's end over the step to the larger cylinder, and a face point near the inner corner.
    let mut plan = ProbingPlan::new(ProbeGeometry { stand_off_mm: 1.0, over_travel_mm: 0.5, ..PROBE });
    plan.add_number(&part, 1, 1, 0.0);
    plan.add(part.place(3, 20.0));
    let hits = plan.hits(&part);
    assert!(hits.iter().any(|h| h.point == 2 && !h.touching && h.by == "tip"), "{hits:?}");
    plan.add_bypasses(&part, 2.0);
    assert!(plan.hits(&part).is_empty());
    assert!(plan.records().iter().any(|r| r.role == PathPointRole::Bypass));
    // Half a millimetre from the step's face, a tip of 2.5 mm touches the face first.
    let mut corner = ProbingPlan::new(PROBE);
    corner.add(part.place(1, part.features[1].segment.length_mm() - 0.5));
    let hits = corner.hits(&part);
    assert!(hits.iter().any(|h| h.touching && h.feature == "F3"), "{hits:?}");
    // A stylus along −Z passes through the part; an upright one is clear.
    let stem = |angle_rad| StylusStem { length_mm: 60.0, radius_mm: 2.0, angle_rad };
    let with = |angle| {
        let mut plan = ProbingPlan::new(ProbeGeometry { stem: Some(stem(angle)), ..PROBE });
        plan.add_number(&part, 0, 1, 0.0);
        plan.hits(&part)
    };
    assert!(with(FRAC_PI_2).is_empty());
    assert!(with(std::f64::consts::PI).iter().any(|h| h.by == "stylus"));
}

#[test]
fn a_fast_move_through_the_whole_part_is_seen() {
    let part = part();
    let mut plan = ProbingPlan::new(PROBE);
    plan.add(part.place(0, 0.0));
    plan.add(part.place(3, 30.0));
    let hits = plan.hits(&part);
    assert!(hits.iter().any(|h| h.point == 2), "{hits:?}");
    plan.add_bypasses(&part, 3.0);
    assert!(plan.hits(&part).is_empty());
}

#[test]
fn points_from_a_file_must_be_on_the_part() {
    let part = part();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("points.csv");
    std::fs::write(&file, "z_mm,x_mm\n120,38.1\n165.1,0\n").unwrap();
    let mut plan = ProbingPlan::new(PROBE);
    plan.add_file(&part, &file, 0.1).unwrap();
    assert!((plan.points[0].place.at - Zx::new(165.1, 0.0)).norm() < 0.01, "in probing order");
    std::fs::write(&file, "z_mm,x_mm\n120,38.1\n160,60\n").unwrap();
    assert_eq!(ProbingPlan::new(PROBE).add_file(&part, &file, 0.1).unwrap_err().line, 3);
}
