//! A part table as a source: where it acts, and what it refuses.

use super::*;

#[test]
fn a_part_table_acts_near_its_arc_and_says_when_it_does_not() {
    let mut bench = Bench::new();
    assert_eq!(bench.corrector.table_now(&bench.status), None);
    let wanted = part(["z", "x"]);
    bench.corrector.load_table(wanted.clone(), part_errors()).unwrap();
    assert_eq!(bench.corrector.table_shown(), Some(wanted));
    let mut seen = |z_mm: i64, change: fn(&mut CorrectorStatus)| {
        let kept = bench.status;
        bench.status.axes[2].position_counts = z_mm * 1000;
        change(&mut bench.status);
        bench.run(0.5, 2, |_| None);
        let now = bench.corrector.table_now(&bench.status).unwrap();
        bench.status = CorrectorStatus { t_ns: bench.status.t_ns, ..kept };
        now
    };
    let on = seen(40, |_| {});
    assert_eq!((on.state.as_str(), on.points, on.um, on.why), ("in_force", 3, [10.0, 0.0], None));
    assert!(on.off_mm.abs() < 1e-9);
    let far = seen(140, |_| {});
    assert_eq!((far.state.as_str(), far.off_mm, far.um), ("ready", 100.0, [0.0; 2]));
    for (change, why) in [
        ((|s| s.mode = CorrectorMode::Disabled) as fn(&mut CorrectorStatus), "corrections are off"),
        (|s| s.mode = CorrectorMode::Shadow, "shadow mode"),
        (|s| s.mode = CorrectorMode::Probe, "probing"),
        (|s| s.axes[0].homed = false, "axis x: is not homed"),
        (
            |s| {
                s.axes[2].faults.latch(Fault::PollGap);
            },
            "axis z: has a fault",
        ),
    ] {
        let now = seen(40, change);
        assert!(now.state == "off" && now.why.as_deref().is_some_and(|w| w.starts_with(why)), "{now:?}");
    }
    assert!(bench.corrector.unload_table() && !bench.corrector.unload_table());
    assert_eq!(bench.corrector.table_now(&bench.status), None);
}

/// In a hollow arc the nose's centre runs inside: on 41 mm less 1 mm.
/// Taken as convex, the same table would act 2 mm away.
#[test]
fn a_hollow_arcs_table_acts_where_the_nose_runs_inside() {
    let hollow = PartTable { radius_mm: Some(41.0), hollow: true, ..part(["z", "x"]) };
    let mut bench = Bench::new();
    bench.corrector.load_table(hollow.clone(), part_errors()).unwrap();
    bench.status.axes[2].position_counts = 40_000;
    bench.run(0.5, 2, |_| None);
    let now = bench.corrector.table_now(&bench.status).unwrap();
    assert!((now.state.as_str(), now.um) == ("in_force", [10.0, 0.0]) && now.off_mm < 1e-9, "{now:?}");
    let said = bench.corrector.load_table(PartTable { nose_mm: 41.0, ..hollow }, part_errors()).unwrap_err();
    assert!(said.contains("expected one that fits into it"), "{said}");
}

/// A taper of 30° from Z 100, X 20 on, 40 mm long, probed every 10 mm.
/// Its corrections by hand: n = (−sin 30°, cos 30°) in Z and X, the nose's centre 1 mm outside.
#[test]
fn a_straight_features_table_acts_along_it_and_fades_beyond_its_ends() {
    let (sin, cos) = (0.5, 0.75_f64.sqrt());
    let um = [0.0, 8.0, 12.0, 4.0, 2.0];
    let point = |k: usize| StraightFeaturePointError {
        angle_rad: 120.0_f64.to_radians(),
        error_um: um[k],
        along_mm: 10.0 * k as f64 - 20.0,
        place: Zx::new(100.0 + 10.0 * k as f64 * cos, 20.0 + 10.0 * k as f64 * sin),
    };
    let errors = || FeatureErrors::Line((0..5).map(point).collect());
    let wanted = PartTable { centre_mm: None, radius_mm: None, ..part(["z", "x"]) };
    let mut bench = Bench::new();
    bench.corrector.load_table(wanted.clone(), errors()).unwrap();
    let mut seen = |along_mm: f64, off_mm: f64| {
        let kept = bench.status;
        let z_mm = 100.0 + along_mm * cos - (1.0 + off_mm) * sin;
        let x_mm = 20.0 + along_mm * sin + (1.0 + off_mm) * cos;
        bench.status.axes[2].position_counts = (z_mm * 1000.0).round() as i64;
        bench.status.axes[0].position_counts = (x_mm * 1000.0).round() as i64;
        bench.run(0.5, 2, |_| None);
        let now = bench.corrector.table_now(&bench.status).unwrap();
        bench.status = CorrectorStatus { t_ns: bench.status.t_ns, ..kept };
        now
    };
    // Between two points, at one, off it where it fades from 2 to 10 mm, and beyond its end.
    for (along_mm, off_mm, error_um) in [
        (15.0, 0.0, 10.0),
        (20.0, 0.0, 12.0),
        (20.0, 6.0, 6.0),
        (20.0, -6.0, 6.0),
        (41.0, 0.0, 2.0),
        (46.0, 0.0, 1.0),
    ] {
        let now = seen(along_mm, off_mm);
        let [z, x] = now.um;
        assert!(
            (z + error_um * sin).abs() < 2e-3 && (x - error_um * cos).abs() < 2e-3,
            "{along_mm}, {off_mm}: {now:?}"
        );
        assert_eq!((now.state.as_str(), now.points), ("in_force", 5));
    }
    assert_eq!(seen(80.0, 0.0).state, "ready");
    for (wrong, said) in [
        (part(["z", "x"]), "found a radius, a centre"),
        (PartTable { nose_mm: -1.0, ..wanted.clone() }, "nose_mm of 0 to 1000"),
        (PartTable { hollow: true, ..wanted.clone() }, "a hollow arc for the errors of a straight feature"),
    ] {
        let text = bench.corrector.load_table(wrong, errors()).unwrap_err();
        assert!(text.contains(said), "{text}");
    }
    assert!(bench.corrector.load_table(wanted, part_errors()).unwrap_err().contains("errors of an arc"));
}

#[test]
fn a_part_table_that_does_not_fit_the_machine_is_refused_and_the_one_before_it_stays() {
    let mut bench = Bench::new();
    let good = part(["z", "x"]);
    bench.corrector.load_table(good.clone(), part_errors()).unwrap();
    let beside = |change: fn(&mut PartTable)| {
        let mut wanted = good.clone();
        change(&mut wanted);
        wanted
    };
    for (wanted, said) in [
        (part(["b", "x"]), "found axis \"b\" for the part table, expected one of x, y, z"),
        (part(["z", "z"]), "two axes"),
        (beside(|t| t.radius_mm = Some(-1.0)), "a positive radius_mm"),
        (beside(|t| t.origin_mm[1] = f64::NAN), "finite places"),
        (beside(|t| t.lead_ms = 2000.0), "lead_ms of 0 to 1000"),
    ] {
        let text = bench.corrector.load_table(wanted, part_errors()).unwrap_err();
        assert!(text.contains(said), "{text}");
    }
    assert_eq!(bench.corrector.table_shown(), Some(good));
}
