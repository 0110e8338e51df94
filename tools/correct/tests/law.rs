//! The control law as the daemon runs it, tick by tick.
//! The engine inserts at once.

#![allow(clippy::unwrap_used)] // a test's own helpers

mod bench;

use bench::{Bench, GROWTH, LAG, SCALE, TICK_S, machine, part, part_errors, sensor};
use rtec_correct::part_table::PartTable;
use rtec_model::record::{Axis, Role};
use rtec_part::cor::{FeatureErrors, LineError};
use rtec_part::fit::Zx;
use rtec_rt::event::{AxisStatus, Fault, MAX_AXES, Mode, Status};

#[test]
fn a_total_follows_the_axis_within_its_window_and_does_not_chatter() {
    let mut bench = Bench::new();
    bench.load(SCALE);
    bench.tick();
    // A rapid over 400 mm between two evaluations: 40 counts, and no more than the window at once.
    bench.status.axes[0].position_counts = 400_000;
    bench.run(1.0, 0, |_| None);
    assert_eq!(bench.status.axes[0].requested, 40);
    // Where an increment begins it does not matter how the scale trembles; further on, it follows.
    for k in 0..200 {
        bench.status.axes[0].position_counts = 410_000 + 3 * (k % 2);
        bench.tick();
        assert_eq!(bench.status.axes[0].requested, 40);
    }
    // An axis that goes to and fro over the boundary changes its total once, not every time.
    let changes = (0..200).filter(|k| {
        bench.status.axes[0].position_counts = 410_000 + 500 * (k % 2);
        bench.tick()[0].is_some()
    });
    assert_eq!((changes.count(), bench.status.axes[0].requested), (1, 42));
    bench.status.axes[0].position_counts = 440_000;
    assert_eq!(bench.tick()[0], Some(44));
    assert_eq!(bench.tick(), [None; MAX_AXES], "what is requested is not requested again");
    let (total, sum) = bench.explained_um(0);
    assert!((total - 44.0).abs() < 1e-12 && (total - sum).abs() < 1e-9, "{total} {sum}");
}

#[test]
fn loading_and_unloading_are_ramps() {
    let mut bench = Bench::of(10.0, 1000.0, Vec::new());
    bench.status.axes[0].position_counts = 400_000;
    bench.load(SCALE);
    assert!(bench.run(2.0, 0, |_| None) <= 2);
    assert!((18..=22).contains(&bench.status.axes[0].requested), "half way after two of four seconds");
    bench.run(3.0, 0, |_| None);
    assert_eq!(bench.status.axes[0].requested, 40);
    assert!(bench.corrector.unload() && !bench.corrector.unload());
    assert!(bench.run(6.0, 0, |_| None) <= 2);
    assert_eq!(bench.status.axes[0].requested, 0);
}

#[test]
fn a_part_table_acts_near_its_arc_and_says_when_it_does_not() {
    let mut bench = Bench::new();
    assert_eq!(bench.corrector.table_now(&bench.status), None);
    let wanted = part(["z", "x"]);
    bench.corrector.load_table(wanted.clone(), part_errors()).unwrap();
    assert_eq!(bench.corrector.table_shown(), Some(wanted));
    let mut seen = |z_mm: i64, change: fn(&mut Status)| {
        let kept = bench.status;
        bench.status.axes[2].position_counts = z_mm * 1000;
        change(&mut bench.status);
        bench.run(0.5, 2, |_| None);
        let now = bench.corrector.table_now(&bench.status).unwrap();
        bench.status = Status { t_ns: bench.status.t_ns, ..kept };
        now
    };
    let on = seen(40, |_| {});
    assert_eq!((on.state.as_str(), on.points, on.um, on.why), ("in_force", 3, [10.0, 0.0], None));
    assert!(on.off_mm.abs() < 1e-9);
    let far = seen(140, |_| {});
    assert_eq!((far.state.as_str(), far.off_mm, far.um), ("ready", 100.0, [0.0; 2]));
    for (change, why) in [
        ((|s| s.mode = Mode::Disabled) as fn(&mut Status), "corrections are off"),
        (|s| s.mode = Mode::Shadow, "shadow mode"),
        (|s| s.mode = Mode::Probe, "probing"),
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
/// As a convex one the same table would act 2 mm beside it.
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
    let point = |k: usize| LineError {
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
        bench.status = Status { t_ns: bench.status.t_ns, ..kept };
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

#[test]
fn nothing_is_asked_for_while_it_must_not_and_after_that_it_is_a_ramp() {
    type Change = fn(&mut Status);
    let not: [Change; 6] = [
        |s| s.mode = Mode::Disabled,
        |s| s.mode = Mode::Hold,
        |s| s.mode = Mode::Probe,
        |s| s.mode = Mode::Fault,
        |s| s.axes[0].homed = false,
        |s| {
            s.axes[0].faults.latch(Fault::PollGap);
        },
    ];
    for change in not {
        let mut bench = Bench::new();
        bench.load(SCALE);
        bench.tick();
        let before = bench.status;
        change(&mut bench.status);
        bench.status.axes[0].position_counts = 400_000;
        for _ in 0..100 {
            assert_eq!(bench.tick()[0], None, "{:?}", bench.status.mode);
        }
        let axes = bench.status.axes;
        bench.status = Status { t_ns: bench.status.t_ns, ..before };
        bench.status.axes[0].position_counts = axes[0].position_counts;
        assert!(bench.run(10.0, 0, |_| None) <= 2);
        assert_eq!(bench.status.axes[0].requested, 40);
    }
}

#[test]
fn the_operator_is_beside_the_model() {
    let mut bench = Bench::new();
    bench.load(SCALE);
    bench.status.axes[0].position_counts = 200_000;
    bench.run(6.0, 0, |_| None);
    assert_eq!(bench.status.axes[0].requested, 20);
    assert_eq!(bench.corrector.with_operator(0, -7), 13);
    bench.corrector.operator_is(0, -7);
    bench.status.axes[0].requested = 13;
    bench.status.axes[0].position_counts = 400_000;
    bench.run(1.0, 0, |_| None);
    assert_eq!(bench.status.axes[0].requested, 33);
    let (total, sum) = bench.explained_um(0);
    assert!((total - sum).abs() < 1e-9);
    // Homed again: all totals are zero, and the model's comes back in a ramp.
    bench.corrector.homed(0, 0);
    bench.status.axes[0] = AxisStatus { homed: true, ..AxisStatus::default() };
    bench.status.axes[0].position_counts = 400_000;
    assert!(bench.run(10.0, 0, |_| None) <= 2);
    assert_eq!(bench.status.axes[0].requested, 40);
}

/// A drive that makes room for an insertion with a lag of two ticks.
fn follow(bench: &mut Bench, axis: usize, commanded: i64, ticks: usize) -> usize {
    let mut changes = 0;
    for _ in 0..ticks {
        changes += usize::from(bench.tick()[axis].is_some());
        let a = &mut bench.status.axes[axis];
        a.position_counts += (commanded - a.in_effect - a.position_counts) / 2;
    }
    changes
}

/// The MTC counts what is inserted at once.
/// The drive makes room for it a little later. Neither is a turn, then or when the insertion is long past.
#[test]
fn a_direction_is_turned_by_the_axis_not_by_our_own_insertions() {
    for (um, back) in [(40.0, 30), (40.0, 10), (20.0, 25), (60.0, 7), (12.0, 14)] {
        let mut bench = Bench::new();
        bench.load(&format!("[[effect]]\nname = \"reversal.x\"\num = {um:?}\n"));
        for p in [0, 100, 200] {
            follow(&mut bench, 0, p, 20);
        }
        follow(&mut bench, 0, 200, 200);
        let half = (um / 2.0) as i64;
        assert_eq!(bench.status.axes[0].requested, half, "{um} up");
        follow(&mut bench, 0, 200 - back, 60);
        assert_eq!(bench.status.axes[0].requested, -half, "{um} down: a reversal is motion, no ramp");
        assert_eq!(follow(&mut bench, 0, 200 - back, 400), 0, "{um}, {back} back: it stands");
        follow(&mut bench, 0, 300, 60);
        assert_eq!(bench.status.axes[0].requested, half, "{um} up again");
        assert_eq!(follow(&mut bench, 0, 300, 400), 0);
    }
}

/// A total of the operator's on a standing axis is no motion either.
#[test]
fn an_operators_total_turns_no_axis() {
    let mut bench = Bench::new();
    bench.load("[[effect]]\nname = \"reversal.x\"\num = 20.0\n");
    follow(&mut bench, 0, 200, 200);
    assert_eq!(bench.status.axes[0].requested, 10);
    bench.corrector.operator_is(0, 30);
    follow(&mut bench, 0, 200, 5);
    assert_eq!(bench.status.axes[0].requested, 40);
    assert_eq!(follow(&mut bench, 0, 200, 400), 0);
}

#[test]
fn homing_keeps_the_direction_of_the_last_motion() {
    let mut bench = Bench::new();
    bench.load("[[effect]]\nname = \"reversal.y\"\num = 40.0\n");
    follow(&mut bench, 1, 13_000, 200);
    assert_eq!(bench.status.axes[1].requested, 20);
    bench.corrector.homed(1, 0);
    bench.status.axes[1] = AxisStatus { homed: true, ..AxisStatus::default() };
    assert!(bench.run(10.0, 1, |_| None) <= 2, "a ramp");
    assert_eq!(bench.status.axes[1].requested, 20);
}

/// A change that no motion asks for is a ramp: coolant that comes on, or ten seconds without a call.
#[test]
fn what_no_motion_asks_for_is_never_a_jump() {
    let mut bench = Bench::of(5.0, 1000.0, vec![sensor("wet", Role::Coolant)]);
    bench.watches[0].offer(bench.now_s, Ok(0.0));
    bench.load("[[effect]]\nname = \"coolant.z\"\num = 40.0\n");
    bench.run(0.5, 2, |_| None);
    assert_eq!(bench.z(), 0);
    bench.watches[0].offer(bench.now_s, Ok(1.0));
    for _ in 0..1000 {
        let before = bench.z();
        bench.watches[0].offer(bench.now_s, Ok(1.0));
        bench.tick();
        assert!(bench.z() - before <= 2);
    }
    assert!((39..=40).contains(&bench.z()), "{}", bench.z());
    let mut bench = Bench::new();
    bench.load("[[effect]]\nname = \"offset.z\"\num = 40.0\n");
    bench.run(0.02, 2, |_| None);
    bench.now_s += 10.0;
    bench.tick();
    assert!(bench.z() <= 6, "{} after a stall", bench.z());
}

/// An axis that stands is not sent back and forth by other axes' motion or the sensors' noise.
#[test]
fn noise_of_the_sensors_passes_no_count_while_another_axis_moves() {
    let mut bench = Bench::new();
    bench.load(GROWTH);
    bench.warm(20.1, 20.0);
    bench.run(2.0, 2, |_| None);
    let mut changes = 0;
    for k in 0..30_000_i64 {
        if k % 100 == 0 {
            // ±40 mK about the boundary between two totals: ±0.4 µm.
            let noise_k = 0.04 * ((k / 100 * 37 % 11) as f64 / 5.0 - 1.0);
            bench.warm(20.1 + noise_k, 20.0);
        }
        bench.status.axes[1].position_counts = (k % 2000) * 200;
        changes += usize::from(bench.tick()[2].is_some());
    }
    assert!(changes <= 1, "{changes}");
}

#[test]
fn a_lost_sensor_stands_then_holds_until_corrections_are_enabled() {
    let mut bench = Bench::new();
    bench.load(&[GROWTH, SCALE].concat());
    bench.run(30.0, 2, |t| Some((20.0 + 0.1 * (t - 1000.0), 20.0)));
    let warm = bench.z();
    assert!((28..=30).contains(&warm), "{warm}");
    // T1 says nothing, T2 goes on cooling: while T1 stands in, the difference goes on; then it holds.
    bench.run(40.0, 2, |_| None);
    let why: Vec<String> = bench.corrector.holding().collect();
    assert!(why.iter().any(|w| w.contains("axis z: thermal corrections hold: sensor T1")), "{why:?}");
    let held = bench.z();
    for k in 0..600 {
        bench.watches[1].offer(bench.now_s, Ok(20.0 - 0.001 * f64::from(k)));
        bench.tick();
        assert_eq!(bench.z(), held);
    }
    // What depends on position is not held.
    bench.status.axes[0].position_counts = 200_000;
    bench.tick();
    assert_eq!(bench.status.axes[0].requested, 20);
    // Enabled while it is silent, then back: that enables nothing by itself.
    bench.corrector.enabled();
    assert_eq!(bench.run(60.0, 2, |_| Some((26.0, 20.0))), 0);
    assert_eq!(bench.z(), held);
    let why: Vec<String> = bench.corrector.holding().collect();
    let back =
        "axis z: thermal corrections hold: sensor T1 is good again: `rtecctl enable` takes its correction up";
    assert_eq!(why, [back]);
    bench.corrector.enabled();
    assert!(bench.run(60.0, 2, |_| Some((26.0, 20.0))) <= 2, "a ramp");
    assert_eq!((bench.z(), bench.corrector.holding().count()), (60, 0));
}

#[test]
fn a_sensor_that_was_never_heard_holds_its_axis_only() {
    let mut bench = Bench::new();
    bench.load(&[GROWTH, SCALE].concat());
    bench.status.axes[0].position_counts = 400_000;
    bench.run(10.0, 2, |_| None);
    assert_eq!((bench.status.axes[0].requested, bench.z()), (40, 0));
    let why: Vec<String> = bench.corrector.holding().collect();
    assert_eq!(why, ["axis z holds: sensor T1: not read yet"]);
}

#[test]
fn outside_its_range_a_correction_fades_and_says_so() {
    let mut bench = Bench::new();
    bench.load(&format!("{GROWTH}range_K = [0.0, 3.0]\n"));
    bench.run(120.0, 2, |t| Some((20.0 + 0.1 * (t - 1000.0), 20.0)));
    // 3 K are 30 counts; 9 K more are unknown, three times as much: a tenth is left.
    assert!((2..=4).contains(&bench.z()), "{}", bench.z());
    let shown = bench.corrector.shown().unwrap();
    assert!(shown.notes[0].contains("outside the range it was fitted on: 10 % of it is left"), "{shown:?}");
    let (total, sum) = bench.explained_um(2);
    assert!((total - sum).abs() < 1e-9);
}

/// The explanation names the sensors, how far outside its range a fit is used, and the residual.
#[test]
fn a_part_is_explained_with_its_sensors_and_what_is_left_of_it() {
    let mut bench = Bench::new();
    bench.load(&format!("{GROWTH}range_K = [0.0, 3.0]\n"));
    for (delta_k, outside_k) in [(2.0, None), (3.5, Some(0.5))] {
        bench.run(60.0, 2, |_| Some((20.0 + delta_k, 20.0)));
        let explained = bench.corrector.explain(2, &bench.status.axes[2]);
        let part = explained.parts.iter().find(|p| p.name == "thermal_growth.z").unwrap();
        let sensors: Vec<_> = part.sensors.iter().map(|s| (s.sensor.as_str(), s.degc)).collect();
        assert_eq!(sensors, [("T1", Some(20.0 + delta_k)), ("T2", Some(20.0))]);
        assert_eq!(part.outside_k, outside_k);
        let outside: Vec<String> = bench.corrector.outside().collect();
        let notes = bench.corrector.shown().unwrap().notes;
        match outside_k {
            Some(_) => {
                assert!(outside == ["thermal_growth.z T1-T2"] && notes.len() == 1, "{outside:?} {notes:?}");
            }
            None => assert!(outside.is_empty() && notes.is_empty(), "{outside:?} {notes:?}"),
        }
        match part.weight {
            Some(weight) => assert!((part.um.abs() - weight * 30.0).abs() < 1e-9 && weight < 1.0, "{part:?}"),
            None => assert!(outside_k.is_none() && (part.um.abs() - 20.0).abs() < 1e-9, "{part:?}"),
        }
    }
}

/// After a restart in the middle, temperatures from the log give the same correction as without one.
#[test]
fn a_restart_knows_the_heat_from_the_log_or_holds() {
    let degc = |t: f64| {
        let warm = 12.0 * (1.0 - (-(t - 1000.0) / 150.0).exp());
        Some((20.0 + warm, 20.0))
    };
    // Until twenty seconds before the restart.
    let log: Vec<(f64, Vec<f64>)> = (0..57)
        .map(|k| {
            let t = 1000.0 + 5.0 * f64::from(k);
            let (t1, t2) = degc(t).unwrap();
            (t, vec![t1, t2])
        })
        .collect();
    let mut whole = Bench::new();
    let (t1, t2) = degc(1000.0).unwrap();
    whole.warm(t1, t2);
    whole.load(LAG);
    whole.run(300.0, 2, degc);
    assert_eq!(whole.corrector.holding().count(), 0, "cold at its start: known from there");
    let goal = whole.corrector.goal(2, &whole.status.axes[2]);
    assert!(goal > 30 && goal < 90, "{goal}: late, so not the 105 of the difference itself");

    let started = |log: Vec<(f64, Vec<f64>)>| {
        let mut bench = Bench::of(5.0, 1300.0, Vec::new());
        let (t1, t2) = degc(1300.0).unwrap();
        bench.warm(t1, t2);
        let past = |sensors: &[String]| {
            assert_eq!(sensors, ["T1", "T2"]);
            log.clone()
        };
        bench.corrector.load(machine(LAG), &past).unwrap();
        bench.tick();
        bench
    };
    let mut again = started(log);
    assert_eq!(again.corrector.holding().count(), 0);
    let same = again.corrector.goal(2, &again.status.axes[2]);
    assert!((same - goal).abs() <= 2, "{same} after a restart, {goal} without");
    whole.run(100.0, 2, degc);
    again.run(100.0, 2, degc);
    let [goal, same] = [&whole, &again].map(|b| b.corrector.goal(2, &b.status.axes[2]));
    assert!((same - goal).abs() <= 2, "{same} some time after a restart, {goal} without");

    // Without a log a warm machine holds until four lags have passed, and then goes there in a ramp.
    let mut blank = started(Vec::new());
    assert!(blank.corrector.holding().next().unwrap().contains("not known yet"));
    blank.run(300.0, 2, degc);
    assert_eq!(blank.z(), 0);
    assert!(blank.run(150.0, 2, degc) <= 2);
    assert!(blank.z() > 90 && blank.corrector.holding().count() == 0, "{}", blank.z());
}

#[test]
fn a_model_that_reads_what_the_machine_has_not_is_refused_by_name() {
    let mut bench = Bench::new();
    let mut refuse = |text: &str| bench.try_load(text).unwrap_err().to_string();
    let text = refuse(&GROWTH.replace("T2", "T9"));
    assert!(text.contains("temperature T9") && text.contains("T1, T2"), "{text}");
    // All of them at once, what reads each, and what to write where.
    let text = refuse(&GROWTH.replace("T1", "T8").replace("T2", "T18"));
    for part in [
        "T18 (read by thermal_growth.z), T8 (read by thermal_growth.z)",
        "[[sensor]] name = \"T18\", role = \"temperature\"; [[sensor]] name = \"T8\"",
        "in the rtec.toml that rtecd was started with",
    ] {
        assert!(text.contains(part), "{text}");
    }
    let text = refuse("[[effect]]\nname = \"channel.x.flow\"\ngain = 1.0\n");
    assert!(text.contains("role = \"channel\"") && text.ends_with("it has none"), "{text}");
    assert!(refuse("[[effect]]\nname = \"channel.x.flow\"\ngain = 1.0\n").contains("channel flow"));
    bench.load("[[effect]]\nname = \"coolant.z\"\num = 5.0\n");
    assert!(bench.corrector.shown().unwrap().notes[0].contains("no [[sensor]] of role coolant"));
}

/// Whoever loads it has been asked.
/// One that ends while it runs has not been meant, and says so once.
#[test]
fn a_model_that_ends_while_it_runs_goes_on_and_is_known_to_have_ended() {
    let fit = "[[fit]]\nresponse = \"error.x\"\ndate = \"1970-01-01\"\nvalid_until = \"1970-01-11\"\n\
               rms_um = 0.1\nhalf_width_um = 0.2\n";
    let mut bench = Bench::new();
    bench.corrector.day_is(9);
    bench.load(&[SCALE, fit].concat());
    bench.status.axes[0].position_counts = 400_000;
    bench.run(10.0, 0, |_| None);
    assert_eq!(bench.corrector.day_is(10), [""; 0], "its last day");
    assert!(bench.corrector.expired().is_empty());
    let ended = "error.x: the fit's validity ended on 1970-01-11";
    assert_eq!(bench.corrector.day_is(11), [ended]);
    assert_eq!(bench.corrector.day_is(11), [""; 0], "said once");
    assert_eq!(bench.corrector.expired(), [ended]);
    bench.status.axes[0].position_counts = 420_000;
    bench.tick();
    assert_eq!(bench.status.axes[0].requested, 42, "what cuts now goes on");
    let shown = bench.corrector.shown().unwrap();
    assert!(shown.expired == [ended] && shown.notes.contains(&ended.to_owned()), "{shown:?}");
    // Loaded again, somebody has meant it.
    bench.load(&[SCALE, fit].concat());
    assert!(bench.corrector.expired().is_empty());
    assert_eq!(bench.corrector.shown().unwrap().expired, [ended]);
}

#[test]
fn spindle_and_load_come_from_sensors_of_their_role() {
    let z = Axis::new("z").unwrap();
    let mut bench =
        Bench::of(5.0, 1000.0, vec![sensor("rpm", Role::SpindleSpeed), sensor("thrust", Role::Load(z))]);
    bench.watches[0].offer(bench.now_s, Ok(3000.0));
    bench.watches[1].offer(bench.now_s, Ok(400.0));
    bench.load(
        "[[effect]]\nname = \"spindle_speed.z\"\num_per_krpm = 2.0\num_per_krpm2 = 0.0\n[[effect]]\n\
         name = \"stiffness.z\"\num_per_N = 0.01\n",
    );
    bench.run(4.0, 2, |_| None);
    assert_eq!(bench.z(), 10);
}

#[test]
fn a_probed_point_gets_what_the_model_says_of_it() {
    let mut bench = Bench::new();
    bench.load(&[SCALE, GROWTH, "[[effect]]\nname = \"squareness.x.y\"\nurad = 50.0\n"].concat());
    bench.warm(23.0, 20.0);
    bench.status.mode = Mode::Probe;
    for p in [0, 50_000, 100_000] {
        bench.status.axes[1].position_counts = p;
        bench.tick();
    }
    let at = |t_back_s: f64| {
        let t_ns = bench.status.t_ns - (t_back_s * 1e9) as u64;
        bench.corrector.error_um_at(0, t_ns, 200.0).unwrap()
    };
    // 100 ppm of 200 mm, and 50 µrad of Y where it was then: 100 mm, or 50 mm one evaluation before.
    assert!((at(0.0) - 25.0).abs() < 1e-9, "{}", at(0.0));
    assert!((at(TICK_S) - 22.5).abs() < 1e-9);
    assert_eq!(bench.status.axes[0].requested, 0, "probing is not corrected");
}
