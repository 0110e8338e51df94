//! Records of one response from unlike gauges, days and machines.

use super::noise::noise;
use super::{answer, names, record};
use rtec_measure::plausible::MistakeKind;
use rtec_model::record::{Column, Record, Role, RunKind};

/// Strokes over 20 targets.
/// The error `um` depends on position and direction; the noise has a size and a memory.
fn strokes(name: &str, seed: u64, um: &dyn Fn(f64, f64) -> f64, sigma: f64, phi: f64) -> Record {
    let (mut draw, mut last) = (noise(seed), 0.0);
    let n = 160;
    let place = |i: usize| {
        if (i / 20).is_multiple_of(2) { 7.3 * (i % 20) as f64 } else { 7.3 * (19 - i % 20) as f64 }
    };
    let way = |i: usize| if (i / 20).is_multiple_of(2) { 1.0 } else { -1.0 };
    let read = |i: usize| {
        last = phi * last + sigma * (1.0_f64 - phi * phi).sqrt() * draw();
        um(place(i), way(i)) + last
    };
    let error = (0..n).map(read).collect();
    let columns = vec![
        ("t", "time", (0..n).map(|i| 5.0 * i as f64).collect()),
        ("x", "position.x", (0..n).map(place).collect()),
        ("d", "direction.x", (0..n).map(way).collect()),
        ("e", "error.x", error),
    ];
    record(name, RunKind::Positioning, columns)
}

const MODEL: &str = "[[effect]]\nname = \"scale.x\"\nppm = 20.0\n[[effect]]\nname = \"reversal.x\"\num = 4.0\n\
                     [[effect]]\nname = \"screw_periodic.x\"\num = 3.0\nperiod_mm = 40.0\nphase_rad = 0.5\n";

fn modelled(ppm: f64, reversal_um: f64, wave_um: f64) -> impl Fn(f64, f64) -> f64 {
    move |mm, way| {
        ppm * mm / 1000.0
            + reversal_um / 2.0 * way
            + wave_um * (std::f64::consts::TAU * mm / 40.0 + 0.5).sin()
    }
}

#[test]
fn unlike_noise_of_two_records_names_nothing() {
    if !test_needs::long() {
        return;
    }
    let um = modelled(20.0, 4.0, 3.0);
    for (k, (quiet, loud, phi)) in
        [(0.1, 3.0, 0.0), (0.5, 0.5, 0.6), (0.1, 1.0, 0.55)].into_iter().enumerate()
    {
        for seed in 0..6 {
            let seed = 100 * k as u64 + 10 * seed + 1;
            let runs = [strokes("quiet", seed, &um, quiet, 0.0), strokes("loud", seed + 1, &um, loud, phi)];
            let r = answer(MODEL, &runs, &[]);
            assert!(names(&r).is_empty() && r.unexplained.is_empty(), "{k} {seed}: {:?}", names(&r));
        }
    }
}

#[test]
fn each_record_has_noise_of_its_own_size_and_memory() {
    use rtec_estimate::measurement_model::EstimationProblem;
    use rtec_estimate::rows_and_noise::MeasuredRows;
    let none = |_: f64, _: f64| 0.0;
    let runs = [strokes("quiet", 3, &none, 0.1, 0.0), strokes("loud", 5, &none, 2.0, 0.6)];
    let rows = MeasuredRows::new(&runs);
    let problem = EstimationProblem::new(&rows, &[], &[]);
    let mut noise = problem.first_noise();
    for _ in 0..20 {
        noise = problem.renewed(&noise, &problem.base(noise.clone()).factor);
    }
    let scatter = |s: usize| noise.size(&rows, s) / (1.0 - noise.phi[s] * noise.phi[s]).sqrt();
    for (s, sigma) in [(0, 0.1), (1, 2.0)] {
        assert!((scatter(s) / sigma - 1.0).abs() < 0.25, "{s}: {}", scatter(s));
    }
    assert!(noise.phi[0] < 0.25 && noise.phi[1] > 0.4, "{:?}", noise.phi);
}

#[test]
fn a_record_of_another_machine_is_said() {
    let own = modelled(20.0, 4.0, 3.0);
    let other = modelled(-12.0, 9.0, 1.0);
    let runs = [
        strokes("first", 1, &own, 0.3, 0.0),
        strokes("second", 2, &other, 0.3, 0.0),
        strokes("third", 3, &own, 0.3, 0.0),
    ];
    let r = answer(MODEL, &runs, &[]);
    let said: Vec<_> = r.suspicions.iter().map(|s| (s.record.as_str(), s.what)).collect();
    assert_eq!(said, [("second.run.toml", MistakeKind::OtherMachine)]);
    assert!(names(&r).is_empty() && r.unexplained.is_empty(), "{:?}", names(&r));
}

/// A unit may be left out or converted twice, of one response or of all.
#[test]
fn a_unit_is_said_in_both_directions() {
    if !test_needs::long() {
        return;
    }
    let um = modelled(20.0, 4.0, 3.0);
    let scaled = |by_error: f64, by_place: f64| {
        let mut r = strokes("second", 2, &um, 0.3, 0.0);
        for c in &mut r.columns {
            let by = match c.name.as_str() {
                "e" => by_error,
                "x" => by_place,
                _ => 1.0,
            };
            c.data.iter_mut().for_each(|v| *v *= by);
        }
        r
    };
    for (column, error, place) in [
        ("e", 25.4, 1.0),
        ("e", 1.0 / 25.4, 1.0),
        ("e", 10.0, 1.0),
        ("e", 1e-3, 1.0),
        ("x", 1.0, 25.4),
        ("x", 1.0, 1.0 / 25.4),
        ("x", 1.0, 0.1),
    ] {
        let runs = [strokes("first", 1, &um, 0.3, 0.0), scaled(error, place)];
        let r = answer(MODEL, &runs, &[]);
        let said: Vec<_> = r.suspicions.iter().map(|s| (s.column.as_str(), s.what)).collect();
        assert_eq!(said, [(column, MistakeKind::Unit)], "{error} {place}: {:?}", r.suspicions);
    }
}

/// A quick run with noise that lasts repeats itself.
/// A slow line beside it does not.
#[test]
fn only_rows_that_repeat_themselves_are_left_out() {
    let line = strokes("line", 3, &|mm, _| 3.5 * mm / 1000.0, 0.3, 0.0);
    let n = 1400;
    let (mut draw, mut last) = (noise(5), 0.0);
    let long = |_| {
        last = 0.97 * last + 0.2 * draw();
        last
    };
    let error: Vec<f64> = (0..n).map(long).collect();
    let columns = vec![("t", "time", (0..n).map(|i| 0.01 * f64::from(i)).collect()), ("e", "error.z", error)];
    let r = answer("", &[line.clone(), record("quick", RunKind::Drift, columns)], &[]);
    assert!(r.every > 1, "{}", r.every);
    let alone = answer("", &[line], &[]);
    assert_eq!((names(&alone), alone.every), (vec!["scale.x".to_owned()], 1));
    let evidence = |r: &rtec_reconcile::ReconciliationResult| {
        r.effects.iter().find(|(f, _)| f.effect.name() == "scale.x").map_or(0.0, |(f, _)| f.evidence)
    };
    assert!(evidence(&r) > 0.9 * evidence(&alone), "{} {}", evidence(&r), evidence(&alone));
}

/// Of gauges with steps of 1 µm one never moves.
/// Its growth is less than a step.
#[test]
fn a_gauge_that_stands_still_tells_no_more_than_its_step() {
    let n = 240;
    let warm: Vec<f64> = (0..n).map(|i| 20.0 + 0.8 * (f64::from(i) / 40.0).sin()).collect();
    let mut draw = noise(11);
    let mut read = |um_per_k: f64, at: f64| -> Vec<f64> {
        warm.iter().map(|degc| (at + um_per_k * (degc - 20.0) + 0.05 * draw()).round()).collect()
    };
    let columns = vec![
        ("t", "time", (0..n).map(|i| 60.0 * f64::from(i)).collect()),
        ("ex", "error.x", read(2.0, 0.4)),
        ("ey", "error.y", read(0.3, -3.0)),
        ("T", "temperature", warm.clone()),
    ];
    assert!(columns[2].2.iter().all(|um| um.to_bits() == (-3.0_f64).to_bits()));
    let mut line = strokes("line", 7, &|_, _| 0.0, 0.2, 0.0);
    for c in &mut line.columns {
        c.role = Role::parse(&c.role.to_string().replace(".x", ".y")).unwrap();
    }
    line.columns.push(Column::new("T", Role::Temperature, vec![20.0; line.rows()]));
    let growth = |axis: &str, um: f64| {
        format!("[[effect]]\nname = \"thermal_growth.{axis}\"\num_per_K = {um}\nsensor = \"T\"\n")
    };
    let model = growth("x", 2.0) + &growth("y", 0.3);
    let r = answer(&model, &[record("drift", RunKind::Drift, columns), line], &[]);
    assert!(names(&r).is_empty() && r.unexplained.is_empty() && r.suspicions.is_empty(), "{}", r.to_json());
    assert!(r.refined.is_empty(), "{}", r.to_json());
}
