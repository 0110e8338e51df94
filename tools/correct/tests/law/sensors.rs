//! Sensors that are lost, never read or out of range, and a restart.

use super::*;

/// Neither motion of other axes nor noise of sensors moves an axis at rest.
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
    // T1 is silent and T2 cools on. While T1's last value is used, the difference changes; then it holds.
    bench.run(40.0, 2, |_| None);
    let why: Vec<String> = bench.corrector.holding().collect();
    assert!(why.iter().any(|w| w.contains("axis z: thermal corrections hold: sensor T1")), "{why:?}");
    let held = bench.z();
    for k in 0..600 {
        bench.watches[1].offer(bench.now_s, Ok(20.0 - 0.001 * f64::from(k)));
        bench.tick();
        assert_eq!(bench.z(), held);
    }
    // The part that depends on position is not held.
    bench.status.axes[0].position_counts = 200_000;
    bench.tick();
    assert_eq!(bench.status.axes[0].requested, 20);
    // Enabling while it is silent does not use the sensor when it returns.
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
    // 3 K are 30 counts. 9 K more are outside the range, three times its width: a tenth is left.
    assert!((2..=4).contains(&bench.z()), "{}", bench.z());
    let shown = bench.corrector.running_model().unwrap();
    assert!(shown.notes[0].contains("outside the range it was fitted on: 10 % of it is left"), "{shown:?}");
    let (total, sum) = bench.explained_um(2);
    assert!((total - sum).abs() < 1e-9);
}

/// The explanation names sensors, distance outside the range, and residual.
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
        let notes = bench.corrector.running_model().unwrap().notes;
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

/// After a restart the logged temperatures give the same correction.
#[test]
fn a_restart_knows_the_heat_from_the_log_or_holds() {
    let degc = |t: f64| {
        let warm = 12.0 * (1.0 - (-(t - 1000.0) / 150.0).exp());
        Some((20.0 + warm, 20.0))
    };
    // Logged until twenty seconds before the restart.
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

    // Without a log, a warm machine holds until four lags have passed; then it follows in a ramp.
    let mut blank = started(Vec::new());
    assert!(blank.corrector.holding().next().unwrap().contains("not known yet"));
    blank.run(300.0, 2, degc);
    assert_eq!(blank.z(), 0);
    assert!(blank.run(150.0, 2, degc) <= 2);
    assert!(blank.z() > 90 && blank.corrector.holding().count() == 0, "{}", blank.z());
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
