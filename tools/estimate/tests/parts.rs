//! Parts of the estimation, each alone.
//!
//! For tests beside the code Cargo compiles all of it a second time, which takes far longer than they run.

use rtec_estimate::candidate_hypotheses::CandidateHypotheses;
use rtec_estimate::gaussian_process::{Kernel, directions, knots};
use rtec_estimate::measurement_model::EstimationProblem;
use rtec_estimate::rows_and_noise::{MeasuredRows, needs_place};
use rtec_estimate::search::{HypothesisSearch, HypothesisSetMember};
use rtec_estimate::set_up_terms::step_of;
use rtec_estimate::wave_periodogram::Periodogram;
use rtec_model::ballbar_circle::Circle;
use rtec_model::effect::Dictionary;
use rtec_model::record::{Axis, Column, Record, Role, RunKind};

#[test]
fn finds_a_period_between_uneven_places() {
    let places: Vec<f64> = (0..200).map(|i| f64::from(i) * 2.0 + f64::from(i * i % 17) * 0.1).collect();
    let residual: Vec<f64> = places.iter().map(|p| (std::f64::consts::TAU * p / 7.3 + 0.4).sin()).collect();
    let rows = places.iter().enumerate().map(|(i, p)| (i, *p, 1.0)).collect();
    let along = Periodogram::new(rows, [1.0 / 60.0, 2.0]).unwrap();
    let best = along.peaks(&residual, 3)[0];
    assert!((1.0 / best - 7.3).abs() < 0.1, "{}", 1.0 / best);
    assert!(along.alias_frequencies(best).is_empty());
    let grid = (0..60).map(|i| (i, 4.0 * (i % 20) as f64, 1.0)).collect();
    let alike = Periodogram::new(grid, [1.0 / 60.0, 1.0]).unwrap().alias_frequencies(0.1);
    for f in [0.15, 0.35, 0.4, 0.6] {
        assert!(alike.iter().any(|a| (a - f).abs() < 0.002), "{f}: {alike:?}");
    }
    assert!(Periodogram::new(vec![(0, 1.0, 1.0); 20], [0.1, 1.0]).is_none());
}

/// The products that follow from R equal those computed directly.
/// A reading of 20 °C, whose column is nearly that of the zero, is included.
#[test]
fn the_look_beside_a_set_is_that_beside_its_factor() {
    let n = 400;
    let column = |name: &str, role: Role, of: &dyn Fn(f64) -> f64| Column {
        name: name.to_owned(),
        unit: role.unit().unwrap_or("1").to_owned(),
        role,
        data: (0..n).map(|i| of(f64::from(i))).collect(),
    };
    let warm = |i: f64| 0.2 * (i / 60.0).sin() + 0.01 * (i * 7919.0 % 1000.0) / 1000.0;
    let columns = vec![
        column("t", Role::Time, &|i| 30.0 * i),
        column("T1", Role::Temperature, &|i| 20.0 + warm(i)),
        column("T2", Role::Temperature, &|i| 20.0 + 0.9 * warm(i) + 0.001 * (i / 9.0).cos()),
        column("e", Role::Error(Axis::new("z").unwrap()), &|i| 30.0 * warm(i) + 0.05 * (i * 1.7).sin()),
    ];
    let records = [Record::new(std::path::Path::new("r.run.toml"), RunKind::Drift, columns).unwrap()];
    let rows = MeasuredRows::new(&records);
    let problem = EstimationProblem::new(&rows, &[], &[]);
    let mut families = CandidateHypotheses::new(&rows, &Dictionary::default(), &[]);
    let mut noise = problem.first_noise();
    (noise.sigma, noise.phi) = (vec![0.05], vec![0.0]);
    families.bank.whiten(&rows, &noise);
    let search = HypothesisSearch::new(&problem, &families, problem.base(noise));
    let set = search.grown(&search.nothing(), 1, true).swap_remove(0);
    let set = search.grown(&set, 1, true).into_iter().next().unwrap_or(set);
    assert!(!set.members.is_empty());
    let (quick, anew) = (search.look_at(&set), families.bank.screening_products(&set.factor));
    let near = |a: &[f64], b: &[f64], size: f64| {
        a.iter().zip(b).map(|(x, y)| (x - y).abs() / (size + y.abs())).fold(0.0, f64::max)
    };
    assert!(near(&quick.along, &anew.along, 1.0) < 0.05, "{}", near(&quick.along, &anew.along, 1.0));
    assert!(near(&quick.among, &anew.among, 1.0) < 0.05, "{}", near(&quick.among, &anew.among, 1.0));
}

/// A set from other readings keeps its members that are possible.
#[test]
fn only_what_is_impossible_leaves_a_set() {
    let n = 200;
    let warm = |i: f64| 0.2 * (i / 40.0).sin();
    let record = |um_per_k: [f64; 2]| {
        let column = |name: &str, role: Role, of: &dyn Fn(f64) -> f64| Column {
            name: name.to_owned(),
            unit: role.unit().unwrap_or("1").to_owned(),
            role,
            data: (0..n).map(|i| of(f64::from(i))).collect(),
        };
        let error = |axis| Role::Error(Axis::new(axis).unwrap());
        let columns = vec![
            column("t", Role::Time, &|i| 30.0 * i),
            column("T1", Role::Temperature, &|i| 20.0 + warm(i)),
            column("e_x", error("x"), &|i| um_per_k[0] * warm(i) + 0.05 * (i * 1.7).sin()),
            column("e_z", error("z"), &|i| um_per_k[1] * warm(i) + 0.05 * (i * 2.3).sin()),
        ];
        [Record::new(std::path::Path::new("r.run.toml"), RunKind::Drift, columns).unwrap()]
    };
    let searched = |records: &[Record], then: &dyn Fn(&HypothesisSearch<'_>) -> Vec<HypothesisSetMember>| {
        let rows = MeasuredRows::new(records);
        let problem = EstimationProblem::new(&rows, &[], &[]);
        let mut families = CandidateHypotheses::new(&rows, &Dictionary::default(), &[]);
        let mut noise = problem.first_noise();
        (noise.sigma, noise.phi) = (vec![0.05; 2], vec![0.0; 2]);
        families.bank.whiten(&rows, &noise);
        then(&HypothesisSearch::new(&problem, &families, problem.base(noise)))
    };
    let axes = |members: &[HypothesisSetMember]| -> Vec<String> {
        let mut axes: Vec<String> = members.iter().filter_map(|m| Some(m.cause.effect()?.name())).collect();
        axes.sort();
        axes
    };
    let both = searched(&record([5.0, 30.0]), &|search| search.best(&search.nothing(), true).members);
    assert_eq!(axes(&both), ["thermal_growth.x", "thermal_growth.z"]);
    // 300 µm/K are more than any machine grows.
    let left = searched(&record([5.0, 300.0]), &|search| {
        let set = search.set_of_members(both.clone());
        assert!(!search.possible(&set));
        search.possible_part(set).members
    });
    assert_eq!(axes(&left), ["thermal_growth.x"]);
}

#[test]
fn carries_no_line() {
    let knots: Vec<f64> = (0..20).map(f64::from).collect();
    let line = [vec![1.0; 20], knots.clone()];
    for kernel in [Kernel::Smooth(6.0), Kernel::Rough(6.0)] {
        let found = directions(&knots, kernel, &line, 12);
        assert!(found.len() >= 3);
        for d in &found {
            assert!(line.iter().all(|l| rtec_least_squares::dot(l, d).abs() < 1e-9));
        }
    }
}

#[test]
fn knots_lie_where_values_are() {
    assert_eq!(knots(&[0.0, 5.0, 0.0, 10.0, 5.0], 40), [0.0, 5.0, 10.0]);
    let apart: Vec<f64> = (0..100).map(|i| f64::from(i) * if i < 50 { 0.1 } else { 1.0 }).collect();
    let k = knots(&apart, 40);
    assert!(k.len() < 40 && k.iter().all(|k| !(8.0..45.0).contains(k)), "{k:?}");
    assert!(knots(&[3.0; 7], 40).is_empty());
}

/// A dial shows its step by five numbers, or by fewer that it repeats.
#[test]
fn a_dial_shows_its_step_by_few_numbers_too() {
    for count in 2..5 {
        let dial: Vec<f64> = (0..60).map(|i| 10.0 * f64::from(i * count / 60) - 20.0).collect();
        assert_eq!(step_of(&dial), Some(10.0), "{count}");
    }
    assert_eq!(step_of(&[1.0, 2.0, 3.0]), None);
    let mut knocked = vec![0.0; 60];
    knocked[7] = 40.0;
    assert_eq!(step_of(&knocked), None, "one wild reading is no step");
    assert_eq!(step_of(&[4.0; 60]), None);
    assert_eq!(step_of(&(0..60).map(|i| f64::from(i * i % 61).sqrt()).collect::<Vec<_>>()), None);
}

/// What does not depend on the place is searched on a circle of unknown centre too.
#[test]
fn a_circle_of_unknown_centre_shows_all_that_needs_no_place() {
    let columns =
        [("t", "time", 0.1), ("a", "angle", 0.02), ("T1", "temperature", 0.01), ("e", "error.r", 0.0)];
    let of = |(name, role, step): (&str, &str, f64)| {
        let wave = |i: f64| if step == 0.0 { (0.7 * i).sin() } else { step * i };
        Column::new(name, Role::parse(role).unwrap(), (0..700).map(|i| wave(f64::from(i))).collect())
    };
    let record =
        Record::new(std::path::Path::new("b.run.toml"), RunKind::Ballbar, columns.map(of).to_vec()).unwrap();
    let names = |centre_mm| {
        let plane = ["x", "y"].map(|a| Axis::new(a).unwrap());
        let records = [record.clone().with_circle(Circle { radius_mm: 100.0, plane, centre_mm }).unwrap()];
        let rows = MeasuredRows::new(&records);
        let families = CandidateHypotheses::new(&rows, &Dictionary::default(), &[]);
        let effects = families.list.into_iter().filter_map(|f| f.effect);
        effects.filter(|e| !needs_place(e)).map(|e| e.name()).collect::<Vec<_>>()
    };
    let placed = names(Some([0.0, 0.0]));
    assert!(placed.contains(&"reversal_spike.x".to_owned()) && placed.len() > 10, "{placed:?}");
    assert_eq!(names(None), placed);
}

/// All numbers that decide an answer are in this file, and there are few of them.
#[test]
fn constants_are_few_and_each_says_what_it_is() {
    let text = include_str!("../src/priors.rs");
    let lines: Vec<&str> = text.lines().collect();
    let constants = lines.iter().enumerate().filter(|(_, l)| l.starts_with("pub const"));
    let mut n = 0;
    for (i, line) in constants {
        n += 1;
        assert!(lines[i - 1].starts_with("///"), "{line} says nothing");
    }
    assert!((20..=40).contains(&n), "{n} constants");
}

/// No other file names a number.
/// Numbers that decide are here, limits of the work are in `search_limits.rs`.
#[test]
fn no_other_file_has_a_constant() {
    let mut left = vec![std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("src")];
    while let Some(file) = left.pop() {
        if file.is_dir() {
            left.extend(std::fs::read_dir(file).unwrap().map(|f| f.unwrap().path()));
            continue;
        }
        let name = file.file_name().unwrap().to_string_lossy().into_owned();
        let text = std::fs::read_to_string(&file).unwrap();
        for line in text.lines().map(str::trim_start) {
            let constant = line.strip_prefix("pub const ").or_else(|| line.strip_prefix("const "));
            let number = constant.and_then(|c| c.split_once(": ")).filter(|(_, of)| {
                let of = of.trim_start_matches(['[', '(']);
                of.starts_with("f64") || of.starts_with("usize")
            });
            let own = ["priors.rs", "search_limits.rs"].contains(&&*name);
            assert!(own || number.is_none(), "{name}: {line}");
        }
    }
}
