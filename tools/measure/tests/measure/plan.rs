//! The test sequence for a machine.

#![allow(clippy::unwrap_used)] // a test's own helpers

use rtec_measure::plan::{PlanAxis, TargetRun, markdown, sequence};

#[test]
fn the_sequence_holds_what_the_patent_asks_for() {
    let axes = ["x", "y", "z"].map(|n| PlanAxis { name: n.into(), travel_mm: 500.0 });
    let steps = sequence(&axes, 6000.0, Some(150.0));
    let count = |what: &str| steps.iter().filter(|s| s.record.starts_with(what)).count();
    // Three planes at three feeds both ways, three lines, straightness of each axis in two directions,
    // tool changes, six spindle runs.
    let counts =
        [count("ballbar_"), count("linear_"), count("straightness_"), count("tool_change"), steps.len()];
    assert_eq!(counts, [18, 3, 6, 1, 34]);
    let runs = ["spindle_cold_dry", "spindle_cold_wet", "spindle_warm", "production_cycle", "cool_down"];
    for want in runs {
        assert_eq!(steps.iter().filter(|s| s.record == want).count(), 1, "{want}");
    }
    assert!(steps.iter().all(|s| rtec_model::record::RunKind::parse(s.kind).is_some()));
    // Record names are those of the effects, and tilts of five gauges have roles.
    let bow = steps.iter().find(|s| s.record == "straightness_y_x").unwrap();
    assert!(["position.x", "error.y"].iter().all(|role| bow.columns.iter().any(|c| c == role)));
    let of_z = steps.iter().find(|s| s.record == "straightness_z_x").unwrap();
    assert!(of_z.evaluate.contains("straightness.z.x is EZX"));
    let warm = &steps.iter().find(|s| s.record == "spindle_warm").unwrap().columns;
    for role in steps.iter().flat_map(|s| &s.columns).filter(|c| *c != "every temperature sensor") {
        assert!(rtec_model::record::Role::parse(role).is_some(), "{role}");
    }
    assert!(warm.iter().any(|c| c == "angle_error.s.b") && warm.iter().any(|c| c == "angle_error.s.a"));
    let text = markdown("m", &steps);
    assert!(text.contains("## 34. cool_down") && text.contains("254 mm/min"));
    // Targets are away from the ends, so that both approaches are possible.
    let line = &steps.iter().find(|s| s.record == "linear_x").unwrap().run;
    let ends: Vec<f64> = line.split(' ').filter_map(|w| w.parse().ok()).collect();
    assert!(ends[0] >= 2.0 && ends[10] <= 498.0 && ends.len() >= 11, "{line}");
    // Targets are not all a whole number of 5 mm leads apart.
    assert!(ends[..11].windows(3).any(|w| ((w[2] - w[1]) - (w[1] - w[0])).abs() > 1.0), "{line}");
}

/// A screw's wave of any period is sampled at many phases.
#[test]
fn no_period_of_a_screw_fits_the_targets() {
    for travel_mm in [200.0, 400.0, 500.0, 600.0, 800.0, 1200.0] {
        let axis = PlanAxis { name: "x".into(), travel_mm };
        for count in [11, 13, 21, 41, 81] {
            let run = TargetRun::uneven(&axis, count, 2, None);
            let per_mm = (0..).map(|k| 1.0 / 60.0 + f64::from(k) * 0.1 / travel_mm).take_while(|f| *f <= 2.0);
            let worst = per_mm.map(|f| {
                let (c, s) = run.targets_mm.iter().fold((0.0, 0.0), |(c, s), p| {
                    let phase = std::f64::consts::TAU * f * p;
                    (c + phase.cos(), s + phase.sin())
                });
                f64::hypot(c, s) / count as f64
            });
            let worst = worst.fold(0.0, f64::max);
            assert!(worst < 0.9, "{count} targets on {travel_mm} mm: {worst}");
            let apart = run.targets_mm.windows(2).map(|w| w[1] - w[0]);
            let least = apart.fold(f64::MAX, f64::min) * (count - 1) as f64 / travel_mm;
            assert!(least > 0.15, "{count} targets on {travel_mm} mm: {least}");
        }
    }
}

/// ISO 230-2:2014, 5.3: targets at most 250 mm apart, and cycles on 2 m.
#[test]
fn a_long_axis_has_a_long_run_and_the_cycles_on_two_metres() {
    let steps = sequence(&[PlanAxis { name: "x".into(), travel_mm: 4000.0 }], 6000.0, Some(150.0));
    let numbers = |record: &str| -> Vec<f64> {
        let run = &steps.iter().find(|s| s.record == record).unwrap().run;
        run.split(" mm from").next().unwrap().split(' ').filter_map(|w| w.parse().ok()).collect()
    };
    let long = numbers("linear_x");
    let (first, last) = (long[0], long[long.len() - 1]);
    assert!((last - first) / (long.len() - 1) as f64 <= 250.0 && first >= 2.0 && last <= 3998.0, "{long:?}");
    let short = numbers("linear_x_2m");
    assert!(short.len() >= 10 && (short[short.len() - 1] - short[0] - 2000.0).abs() < 1e-6, "{short:?}");
    assert!(steps.iter().find(|s| s.record == "linear_x").unwrap().run.contains("once each way"));
}
