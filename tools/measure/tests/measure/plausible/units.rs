//! Columns in other units than stated.

use super::{column, record, serpentine};
use rtec_measure::plausible::{MistakeKind, Suspicion, suspicions};
use rtec_model::record::{Record, RunKind};
use std::f64::consts::TAU;
use test_needs::dice::Dice;

/// A bar's length in inches, and one that is not the bar's.
#[test]
fn a_radius_in_inches_or_off_is_said() {
    if !test_needs::long() {
        return;
    }
    let record = |radius_mm: f64, off_um: f64| {
        let angles: Vec<f64> = (0..720).map(|i| TAU * f64::from(i) / 360.0).collect();
        let e = angles.iter().map(|a| off_um + 2.0 * (2.0 * a).sin() + (a * 97.0).sin()).collect();
        let columns = vec![column("a", "angle", angles), column("e", "error.r", e)];
        let plane = ["x", "y"].map(|n| rtec_model::record::Axis::new(n).unwrap());
        let circle = rtec_model::ballbar_circle::Circle { radius_mm, plane, centre_mm: None };
        record("b", RunKind::Ballbar, columns).with_circle(circle).unwrap()
    };
    for inches in [100.0, 150.0, 300.0].map(|mm| mm / 25.4) {
        let said = suspicions(&[record((inches * 1e4_f64).round() / 1e4, 3.0)]);
        assert!(
            said.iter().any(|s| s.what == MistakeKind::Unit && s.text.contains("inches")),
            "{inches}: {said:?}"
        );
    }
    for mm in [50.0, 100.0, 150.0, 300.0] {
        assert_eq!(suspicions(&[record(mm, 3.0)]), [], "{mm}");
    }
    let warned = |r: Record| rtec_measure::ballbar::evaluate(&[r]).unwrap()[0].warnings.join("\n");
    assert!(warned(record(150.0, -850.0)).contains("-850 µm off the nominal"));
    assert!(!warned(record(150.0, -20.0)).contains("off the nominal"));
}

/// A circle about its centre that no bar is named of.
/// In inches, as a grid plate's of ten millimetres, and as a bar's.
#[test]
fn a_circle_in_inches_without_a_bar_is_said() {
    let circle = |radius: f64| {
        let of = |f: fn(f64) -> f64| (0..360).map(|i| radius * f(f64::from(i) * TAU / 360.0)).collect();
        let mut d = Dice::new(5);
        let e = (0..360).map(|_| 2.0 * d.normal()).collect();
        let columns = vec![
            column("x", "position.x", of(f64::cos)),
            column("y", "position.y", of(f64::sin)),
            column("e", "error.x", e),
        ];
        suspicions(&[record("circle", RunKind::Ballbar, columns)])
    };
    for mm in [10.0, 12.5, 25.4, 100.0, 150.0] {
        assert_eq!(circle(mm), [], "{mm}");
    }
    for mm in [100.0, 150.0, 300.0] {
        let said = circle(mm / 25.4);
        let unit = |s: &Suspicion| s.what == MistakeKind::Unit && s.text.contains("inches");
        assert!(said.len() == 2 && said.iter().all(unit), "{mm}: {said:?}");
    }
}

/// A ballbar's positions in inches beside a radius in millimetres.
/// In millimetres nothing is said.
#[test]
fn inches_on_a_circle_are_said() {
    let record = |per_mm: f64, radius_mm: f64, turn: f64| {
        let angles: Vec<f64> = (0..720).map(|i| turn * f64::from(i) / 360.0).collect();
        let of = |f: fn(f64) -> f64| angles.iter().map(|a| 150.0 * f(*a) * per_mm).collect::<Vec<_>>();
        let columns = vec![
            column("a", "angle", angles.clone()),
            column("x", "position.x", of(f64::cos)),
            column("y", "position.y", of(f64::sin)),
            column("e", "error.r", angles.iter().map(|a| 2.0 * (2.0 * a).sin()).collect()),
        ];
        let plane = ["x", "y"].map(|n| rtec_model::record::Axis::new(n).unwrap());
        let circle = rtec_model::ballbar_circle::Circle { radius_mm, plane, centre_mm: None };
        record("b", RunKind::Ballbar, columns).with_circle(circle).unwrap()
    };
    let said = |r: Record| suspicions(&[r]).into_iter().map(|s| (s.what, s.column)).collect::<Vec<_>>();
    let both = [(MistakeKind::Unit, "x".to_owned()), (MistakeKind::Unit, "y".to_owned())];
    for turn in [TAU, 0.35 * TAU] {
        assert_eq!(said(record(1.0, 150.0, turn)), []);
        assert_eq!(said(record(1.0 / 25.4, 150.0, turn)), both);
        // A radius typed wrong beside the positions, larger or smaller; the bar's diameter.
        for (radius_mm, hint) in
            [(75.0, "radius_mm is 75"), (160.0, "radius_mm is 160"), (300.0, "looks like the diameter")]
        {
            let found = suspicions(&[record(1.0, radius_mm, turn)]);
            assert!(found.len() == 2 && found[0].text.contains(hint), "{radius_mm}: {found:?}");
        }
    }
}

/// A plate's holes in inches.
/// Round in millimetres once they are converted, or a scale that no machine has.
#[test]
fn a_plate_in_inches_is_said() {
    let plate = |per_mm: f64, pitch_mm: f64| {
        let mut d = Dice::new(11);
        let (mut x, mut y, mut ex, mut ey) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for i in 0..25 {
            let (px, py) = (pitch_mm * f64::from(i % 5), pitch_mm * f64::from(i / 5));
            x.push(px * per_mm);
            y.push(py * per_mm);
            ex.push(0.05 * px - 0.01 * py + 0.3 * d.normal());
            ey.push(0.025 * py + 0.02 * px + 0.3 * d.normal());
        }
        let columns = vec![
            column("x", "position.x", x),
            column("y", "position.y", y),
            column("ex", "error.x", ex),
            column("ey", "error.y", ey),
        ];
        suspicions(&[record("p", RunKind::Plate, columns)])
    };
    for pitch_mm in [25.0, 40.0, 33.3] {
        assert_eq!(plate(1.0, pitch_mm), [], "{pitch_mm}");
        let said = plate(1.0 / 25.4, pitch_mm);
        assert!(
            said.iter().any(|s| s.what == MistakeKind::Unit && s.text.contains("inches")),
            "{pitch_mm}: {said:?}"
        );
    }
}

/// Lines over targets.
/// As steep as the dictionary has scales is a scale, steeper is another unit.
#[test]
fn a_steep_scale_is_no_inch_and_a_steeper_line_is() {
    let run = |ppm: f64| {
        let mut d = Dice::new(12);
        let x: Vec<f64> = (0..40).map(|i| 17.3 * f64::from(i % 20)).collect();
        let e = x.iter().map(|x| ppm / 1000.0 * x + 0.3 * d.normal()).collect();
        suspicions(&[record(
            "r",
            RunKind::Positioning,
            vec![column("x", "position.x", x), column("e", "error.x", e)],
        )])
    };
    for ppm in [-846.0, 700.0, 960.0] {
        assert_eq!(run(ppm), [], "{ppm}");
    }
    for ppm in [-1100.0, 2500.0] {
        let said = run(ppm);
        assert!(
            said.iter().any(|s| s.what == MistakeKind::Unit && s.text.contains("inches")),
            "{ppm}: {said:?}"
        );
    }
    let scale = rtec_model::effect::Dictionary::default().effect("scale.x").unwrap();
    let [low, high] = scale.description().parameters[0].bounds;
    assert!((low + 1000.0).abs() < 1e-9 && (high - 1000.0).abs() < 1e-9, "{low} to {high}");
}

/// What drifts while a plate is gone over runs along the axis that goes across once: no inch says so.
#[test]
fn a_drift_over_a_plate_is_no_inch() {
    let mut d = Dice::new(6);
    let columns = serpentine(12, &mut |_, _, row| 2.1 * row as f64 + 2.0 * d.normal());
    assert_eq!(suspicions(&[record("p", RunKind::Plate, columns)]), []);
}

/// Two plates, one of which warms while the other cools.
/// The errors are the other way round from place to place, by no sign.
#[test]
fn a_plate_that_cools_is_none_of_the_other_sign() {
    let mut d = Dice::new(7);
    let mut plate = |name: &str, way: f64| {
        let degc = |row: usize| 21.0 + way * 0.9 * (row as f64 / 100.0 - 0.5);
        let mut columns = serpentine(10, &mut |_, _, row| 12.0 * (degc(row) - 21.0) + 0.3 * d.normal());
        columns.push(column("T1", "temperature", (0..100).map(degc).collect()));
        record(name, RunKind::Plate, columns)
    };
    let records = [plate("a", 1.0), plate("b", -1.0)];
    assert_eq!(suspicions(&records), []);
}

/// Half of a run in mm among µm, and the directions of half of its runs turned.
/// A drift that begins at nothing, or at rest, is neither.
#[test]
fn another_unit_and_other_directions_from_a_row_on_are_said() {
    for seed in 1..=20 {
        let mut d = Dice::new(seed);
        let targets: Vec<f64> = (0..13).map(|k| 77.3 * f64::from(k) - 460.0).collect();
        let (mut p, mut way, mut e) = (Vec::new(), Vec::new(), Vec::new());
        for run in 0..10 {
            let up = run % 2 == 0;
            for k in 0..13 {
                let at = targets[if up { k } else { 12 - k }];
                p.push(at + 20.0 * d.unit());
                way.push(if up { 1.0 } else { -1.0 });
                e.push(0.022 * at + if up { -3.0 } else { 3.0 } + 0.1 * d.normal());
            }
        }
        let made = |way: Vec<f64>, e: Vec<f64>| {
            let columns = [("z", "position.z", p.clone()), ("dir", "direction.z", way), ("e", "error.z", e)];
            record(
                "half",
                RunKind::Positioning,
                columns.into_iter().map(|(n, r, v)| column(n, r, v)).collect(),
            )
        };
        assert_eq!(suspicions(&[made(way.clone(), e.clone())]), [], "{seed}");
        let rounded = |x: f64| (x * 1e4).round() / 1e4;
        for rows in [0..65, 65..130, 91..130] {
            let half = |i: usize, x: f64| if rows.contains(&i) { rounded(x / 1000.0) } else { rounded(x) };
            let found =
                suspicions(&[made(way.clone(), e.iter().enumerate().map(|(i, x)| half(i, *x)).collect())]);
            let unit = found.iter().find(|s| s.what == MistakeKind::Unit && s.column == "e");
            let said = unit.map_or(Vec::new(), Suspicion::row_list);
            let same = said.iter().filter(|i| rows.contains(i)).count();
            assert!(same + 3 >= rows.len() && said.len() <= rows.len() + 3, "{seed} {rows:?}: {found:?}");
        }
        let turned = way.iter().enumerate().map(|(i, w)| if i < 65 { *w } else { -w }).collect();
        let found = suspicions(&[made(turned, e.clone())]);
        let said =
            found.iter().find(|s| s.what == MistakeKind::Direction).map_or(Vec::new(), Suspicion::row_list);
        assert!(said.len() > 55 && said.iter().all(|i| (65..130).contains(i)), "{found:?}");
        // A spindle that stands for a while, and then grows by a thousand times its noise.
        let grows = |i: i32| if i < 100 { 0.0 } else { 60.0 * (1.0 - (-f64::from(i - 100) / 60.0).exp()) };
        let t: Vec<f64> = (0..300).map(|i| 60.0 * f64::from(i)).collect();
        let e = (0..300).map(|i| grows(i) + 0.05 * d.normal()).collect();
        let r = record("drift", RunKind::Drift, vec![column("t", "time", t), column("e", "error.z", e)]);
        assert_eq!(suspicions(&[r]), [], "{seed}");
    }
}
