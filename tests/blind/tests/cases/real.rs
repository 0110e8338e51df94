//! Reconciliation of real machines' measured data (`../shared/data`).
//! Nobody made these data for it.

#![allow(clippy::unwrap_used)] // helpers of tests count as tests

use rtec_builders::axis;
use rtec_model::machine::Machine;
use rtec_model::record::{Column, Record, Role, RunKind};
use rtec_reconcile::{ReconciliationOptions, ReconciliationResult, Verdict, reconcile};
use std::path::{Path, PathBuf};
use test_needs::repetitions;

fn data(name: &str) -> Option<String> {
    let path = test_needs::shared(&format!("data/{name}"))?;
    Some(std::fs::read_to_string(path).unwrap())
}

fn names(r: &ReconciliationResult) -> Vec<String> {
    r.effects.iter().map(|(f, _)| f.effect.name()).collect()
}

/// A record from a CMM's table: nominal x, y in mm, errors in µm.
fn plate(text: &str) -> Record {
    let rows: Vec<Vec<f64>> = text
        .lines()
        .filter_map(|l| l.split_whitespace().map(|f| f.parse().ok()).collect::<Option<Vec<f64>>>())
        .filter(|v| v.len() == 9)
        .collect();
    let pick = |at: usize, by: f64| rows.iter().map(|r| r[at] * by).collect();
    let columns = vec![
        Column::new("x", Role::Position(axis("x")), pick(2, 1.0)),
        Column::new("y", Role::Position(axis("y")), pick(3, 1.0)),
        Column::new("ex", Role::Error(axis("x")), pick(4, 1000.0)),
        Column::new("ey", Role::Error(axis("y")), pick(5, 1000.0)),
    ];
    Record::new(&PathBuf::from("plate.run.toml"), RunKind::Plate, columns).unwrap()
}

#[test]
fn a_plate_that_was_turned_is_called_turned() {
    let Some(text) = data("plate_cmm/D8131_1") else { return };
    let r =
        reconcile(&[plate(&text)], &[], &Machine::ideal("cnc"), &ReconciliationOptions::default()).unwrap();
    assert!(names(&r).iter().any(|n| n == "rotation.x.y"), "{:?}", names(&r));
    let (rotation, _) = r.effects.iter().find(|(f, _)| f.effect.name() == "rotation.x.y").unwrap();
    // The owners' fit is 0.029° = 506 µrad, printed to 17 µrad.
    assert!((rotation.effect.scalar(0) - 506.0).abs() < 40.0, "{}", rotation.effect.scalar(0));
}

#[test]
fn a_plate_that_is_too_small_alike_may_be_cold() {
    if !test_needs::long() {
        return;
    }
    let Some(text) = data("plate_cmm/D2130A1") else { return };
    let r =
        reconcile(&[plate(&text)], &[], &Machine::ideal("cnc"), &ReconciliationOptions::default()).unwrap();
    // The owners' fit has a quadrupole beside scale, a shape over the plane without a name in the dictionary.
    assert_eq!(r.verdict, Verdict::UnknownEffect);
    assert!(r.unexplained.iter().any(|s| s.manner == "smooth over the plane"), "{:?}", r.unexplained);
    let (scale, _) = r.effects.iter().find(|(f, _)| f.effect.name() == "scale.x").unwrap();
    assert!(scale.rivals.iter().any(|v| v.name == "thermal_expansion.x"));
    assert!(scale.effect.scalar(0) < -10.0 && scale.effect.scalar(0) > -40.0);
}

#[test]
fn the_iso_230_axis_has_a_map_and_a_reversal() {
    let Some(text) = data("axis_iso230/y_axis.dat") else { return };
    let value = |key: &str| -> f64 {
        text.lines().find_map(|l| l.strip_prefix(key)?.strip_prefix('=')).unwrap().parse().unwrap()
    };
    let (mut y, mut dir, mut n, mut e) = (vec![], vec![], vec![], vec![]);
    for cycle in 1..=5 {
        for (d, name, order) in
            [(1.0, "FWD", (1..=9).collect::<Vec<_>>()), (-1.0, "BWD", (1..=9).rev().collect())]
        {
            for i in order {
                let target = value(&format!("TGT_DATA[{i}]"));
                y.push(target);
                dir.push(d);
                n.push(f64::from(cycle));
                e.push(1000.0 * (value(&format!("REF_DATA_{name}[{i},{cycle}]")) - target));
            }
        }
    }
    let columns = vec![
        Column::new("y", Role::Position(axis("y")), y),
        Column::new("dir", Role::Direction(axis("y")), dir),
        Column::new("n", Role::Cycle, n),
        Column::new("e", Role::Error(axis("y")), e),
    ];
    let record = Record::new(&PathBuf::from("axis.run.toml"), RunKind::Positioning, columns).unwrap();
    let r = reconcile(&[record], &[], &Machine::ideal("ecmc"), &ReconciliationOptions::default()).unwrap();
    // A map, a reversal, and a change over the cycles: a warm-up from a zero that was set on the warm machine.
    assert_eq!(names(&r), ["position_map.y", "reversal.y", "warm_up.y"]);
    assert!(
        r.places.iter().any(|p| p.against == "cycle" && p.q_value < 0.01),
        "the drift over the cycles: {:?}",
        r.places.iter().map(|p| (p.against.clone(), p.p_value, p.q_value)).collect::<Vec<_>>()
    );
    // The owners' mean reversal, 12.77 µm, includes the drift between the ways up and down, 20 µm in five cycles.
    let of = |n: usize, key: &str| r.effects[n].0.effect.value(key).unwrap()[0];
    let (reversal, drift) = (of(1, "um").abs(), of(2, "um").abs());
    println!("reversal {reversal:.2} µm, drift {drift:.1} µm; {:?}", r.gap);
    assert!((reversal - 12.77).abs() < 0.15 * drift, "{reversal}");
    assert!(r.gap[0].closed().unwrap() > 0.9);
}

/// The motion and force of the EMPS axis, one row every `every` ms.
/// Position and force pass the same Gaussian filter with its corner at `corner_hz`, without phase shift.
fn emps(text: &str, corner_hz: f64, every: usize) -> Record {
    let rows: Vec<[f64; 2]> = text
        .lines()
        .skip(1)
        .map(|l| {
            let f: Vec<f64> = l.split(',').map(|f| f.parse().unwrap()).collect();
            [1e3 * f[2], 35.1507 * f[3]]
        })
        .collect();
    let sd = 2f64.ln().sqrt() / (std::f64::consts::TAU * corner_hz) * 1e3;
    let reach = (4.0 * sd).ceil() as usize;
    let weights: Vec<f64> =
        (0..=2 * reach).map(|k| (-0.5 * ((k as f64 - reach as f64) / sd).powi(2)).exp()).collect();
    let total: f64 = weights.iter().sum();
    let smooth = |at: usize, k: usize| -> f64 {
        weights.iter().zip(&rows[at - reach..]).map(|(w, r)| w * r[k]).sum::<f64>() / total
    };
    let places: Vec<usize> = (reach + 1..rows.len() - reach - 1).step_by(every).collect();
    let pick = |f: &dyn Fn(usize) -> f64| places.iter().map(|r| f(*r)).collect::<Vec<_>>();
    let columns = vec![
        Column::new("t", Role::Time, pick(&|r| r as f64 * 1e-3)),
        Column::new("x", Role::Position(axis("x")), pick(&|r| smooth(r, 0))),
        Column::new("v", Role::Velocity(axis("x")), pick(&|r| (smooth(r + 1, 0) - smooth(r - 1, 0)) / 2e-3)),
        Column::new(
            "a",
            Role::Acceleration(axis("x")),
            pick(&|r| (smooth(r + 1, 0) - 2.0 * smooth(r, 0) + smooth(r - 1, 0)) / 1e-6),
        ),
        Column::new("f", Role::Force(axis("x")), pick(&|r| smooth(r, 1))),
    ];
    Record::new(&PathBuf::from("emps.run.toml"), RunKind::Dynamics, columns).unwrap()
}

/// The EMPS axis has Coulomb friction that differs by direction.
/// Inertia and viscous friction are known (the owners' figures). However the data are filtered and sampled, Coulomb
/// friction comes first. Then the way back is easier than the way out, and nothing else is found. The owners' offset,
/// 3.2 N, is what a constant makes of that difference; beside the difference it is 0.25 N.
#[test]
fn a_driven_axis_has_coulomb_friction_that_differs_by_direction() {
    let Some(text) = data("axis_dynamics/identification.csv") else { return };
    let model = "name = \"emps\"\n[[effect]]\nname = \"inertia.x\"\nkg = 95.11\n[[effect]]\n\
                 name = \"friction_viscous.x\"\nN_s_per_m = 203.5\n";
    let machine = Machine::parse(Path::new("emps.toml"), model).unwrap();
    for (corner_hz, every) in repetitions([(20.0, 10), (40.0, 10), (30.0, 4), (20.0, 25), (60.0, 20)]) {
        let record = emps(&text, corner_hz, every);
        let force = record.data(&Role::Force(axis("x"))).unwrap();
        let size = (force.iter().map(|f| f * f).sum::<f64>() / force.len() as f64).sqrt();
        let r = reconcile(&[record], &[], &machine, &ReconciliationOptions::default()).unwrap();
        let [before, after] = r.gap[0].train;
        println!(
            "{corner_hz} Hz, every {every} ms: {:?} {:.2} %, before {:.1} %, every {} rows",
            names(&r),
            100.0 * after / size,
            100.0 * before / size,
            r.every
        );
        assert_eq!(names(&r), ["friction_coulomb.x", "friction_asymmetric.x"]);
        let coulomb = r.effects[0].0.effect.scalar(0);
        assert!(
            (coulomb - 20.39).abs() < 1.2,
            "the owners' Coulomb friction, without what else is found: {coulomb} N"
        );
        assert!(after / size < 0.04, "the owners' best: 3.11 %");
    }
}

/// A raw log is enough: position in m and motor command in V at 1 kHz.
/// Velocity and acceleration are derived. On the later half of the run the force is known to the owners' figures.
#[test]
fn a_raw_log_of_position_and_current_is_enough() {
    if !test_needs::long() {
        return;
    }
    let Some(text) = data("axis_dynamics/identification.csv") else { return };
    let rows: Vec<[f64; 3]> = text
        .lines()
        .skip(1)
        .map(|l| {
            let f: Vec<f64> = l.split(',').map(|f| f.parse().unwrap()).collect();
            [f[0], 1e3 * f[2], 35.1507 * f[3]]
        })
        .collect();
    let part = |rows: &[[f64; 3]]| {
        let pick = |k: usize| rows.iter().map(|r| r[k]).collect::<Vec<_>>();
        let columns = vec![
            Column::new("t", Role::Time, pick(0)),
            Column::new("x", Role::Position(axis("x")), pick(1)),
            Column::new("f", Role::Force(axis("x")), pick(2)),
        ];
        Record::new(&PathBuf::from("raw.run.toml"), RunKind::Dynamics, columns).unwrap()
    };
    let model = "name = \"emps\"\n[[effect]]\nname = \"inertia.x\"\nkg = 95.11\n[[effect]]\n\
                 name = \"friction_viscous.x\"\nN_s_per_m = 203.5\n";
    let machine = Machine::parse(Path::new("emps.toml"), model).unwrap();
    let (early, late) = rows.split_at(rows.len() / 2);
    let late = part(late);
    let force = late.data(&Role::Force(axis("x"))).unwrap();
    let size = (force.iter().map(|f| f * f).sum::<f64>() / force.len() as f64).sqrt();
    let r = reconcile(&[part(early)], &[late], &machine, &ReconciliationOptions::default()).unwrap();
    let after = r.gap[0].holdout.unwrap()[1] / size;
    println!("{} {:?}, {:.2} % of the later force; {:?}", r.verdict, names(&r), 100.0 * after, r.derived);
    assert_eq!(names(&r)[..2], ["friction_coulomb.x", "friction_asymmetric.x"]);
    assert!(after < 0.053, "{after}");
}

/// Rows of the spindle run: growth and its sixteen temperatures.
/// `decoys` are further temperatures and channels.
fn spindle(text: &str, rows: std::ops::Range<usize>, decoys: &[(&str, Role, Vec<f64>)]) -> Record {
    let lines: Vec<Vec<f64>> =
        text.lines().skip(1).map(|l| l.split(',').map(|f| f.parse().unwrap()).collect()).collect();
    let pick = |k: usize, by: f64| lines[rows.clone()].iter().map(|l| l[k] * by).collect::<Vec<_>>();
    let mut columns = vec![
        Column::new("t", Role::Time, pick(0, 60.0)),
        Column::new("e", Role::Error(axis("z")), pick(1, 1.0)),
    ];
    columns.extend((0..16).map(|k| Column::new(&format!("T{k}"), Role::Temperature, pick(k + 2, 1.0))));
    columns.extend(decoys.iter().map(|(n, r, d)| Column::new(n, r.clone(), d[rows.clone()].to_vec())));
    Record::new(&PathBuf::from("spindle.run.toml"), RunKind::Drift, columns).unwrap()
}

/// A model learned from the earlier rows predicts the later ones.
/// That holds whichever row separates them, and is far better than the learned mean. These rows do not show which
/// sensor is the cause, so several share the weight.
#[test]
fn a_spindle_grows_with_its_heat_and_later_hours_are_predicted() {
    if !test_needs::long() {
        return;
    }
    let Some(text) = data("spindle_thermal/first_half.csv") else { return };
    let model = Machine::ideal("spindle");
    let mut left_um = Vec::new();
    for split in repetitions([1000, 1200, 1400, 1600, 1800]) {
        let (early, late) = (spindle(&text, 0..split, &[]), spindle(&text, split..2341, &[]));
        let about = |r: &Record, centre: f64| -> f64 {
            let e = r.data(&Role::Error(axis("z"))).unwrap();
            (e.iter().map(|x| (x - centre).powi(2)).sum::<f64>() / e.len() as f64).sqrt()
        };
        let e = early.data(&Role::Error(axis("z"))).unwrap();
        let learned = about(&late, e.iter().sum::<f64>() / e.len() as f64);
        let r = reconcile(&[early], &[late], &model, &ReconciliationOptions::default()).unwrap();
        let after = r.gap[0].holdout.unwrap()[1];
        println!(
            "{split} min: {} {:?}, later {after:.3} µm; by the mean learned {learned:.3}",
            r.verdict,
            r.effects.iter().map(|(f, _)| (f.effect.name(), &f.effect.delta)).collect::<Vec<_>>()
        );
        assert!(matches!(r.verdict, Verdict::NotSeparable | Verdict::UnknownEffect), "{}", r.verdict);
        assert!(names(&r)[0].starts_with("thermal_"), "{:?}", names(&r));
        assert!(after < 0.25 * learned && after < 1.3, "{after} and {learned}");
        left_um.push(after);
    }
    assert!(left_um.iter().sum::<f64>() / (left_um.len() as f64) < 0.95, "{left_um:?}");
}

/// Every fourth minute of the whole run, with decoys.
///
/// Decoys among the temperatures are a random walk and a sensor with shuffled rows; among the channels a random walk.
/// Heat is named, relative to the surroundings and with a lag, and no decoy is.
#[test]
fn a_decoy_is_never_the_cause_of_growth() {
    use rand_xoshiro::rand_core::{RngCore, SeedableRng};
    let Some(text) = data("spindle_thermal/first_half.csv") else { return };
    let t3: Vec<f64> = text.lines().skip(1).map(|l| l.split(',').nth(5).unwrap().parse().unwrap()).collect();
    for seed in repetitions([1, 2]) {
        let mut rng = rand_xoshiro::Xoshiro256PlusPlus::seed_from_u64(seed);
        let mut walk = |start: f64, step: f64| -> Vec<f64> {
            let mut x = start;
            t3.iter()
                .map(|_| {
                    x += step * (rng.next_u64() as f64 / u64::MAX as f64 - 0.5);
                    x
                })
                .collect()
        };
        let (warm, logged) = (walk(24.0, 0.3), walk(0.0, 1.0));
        let mut shuffled = t3.clone();
        for i in (1..shuffled.len()).rev() {
            shuffled.swap(i, (rng.next_u64() % (i as u64 + 1)) as usize);
        }
        let decoys = [
            ("D1", Role::Temperature, warm),
            ("D2", Role::Temperature, shuffled),
            ("D3", Role::Channel, logged),
        ];
        let run = spindle(&text, 0..2341, &decoys).select(&(0..2341).step_by(4).collect::<Vec<_>>());
        let r =
            reconcile(&[run], &[], &Machine::ideal("spindle"), &ReconciliationOptions::default()).unwrap();
        println!(
            "{} {:?}",
            r.verdict,
            r.effects.iter().map(|(f, _)| (f.effect.name(), &f.effect.delta)).collect::<Vec<_>>()
        );
        assert_eq!(names(&r)[0], "thermal_lag.z");
        for (f, _) in &r.effects {
            let named = format!("{} {:?} {:?}", f.effect.name(), f.effect.delta, f.rivals);
            assert!(!named.contains("D1") && !named.contains("D2") && !named.contains("D3"), "{named}");
        }
    }
}
