//! Chains fitted component by component from simulated measurements.
//! They are compared with the chain that made the data and with the symbolic reference.

#![allow(clippy::unwrap_used)] // a test's own helpers

use rtec_fit::kinematic_chain_fit as chain_fit;
use rtec_model::kinematic_chain::KinematicChain;
use rtec_model::machine::Machine;
use rtec_model::record::{Axis, Column, Record, Role, RunKind};
use std::path::{Path, PathBuf};

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../model/tests/data").join(name)
}

/// A chain whose coefficients are all zero.
/// Only the powers are stated.
fn template(name: &str) -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let text = std::fs::read_to_string(data(name)).unwrap();
    let mut blank = String::new();
    for part in text.split_inclusive("value = ") {
        let rest = part.trim_start_matches(|c: char| c.is_ascii_digit() || "-.".contains(c));
        blank += if blank.is_empty() { part } else { rest };
        if part.ends_with("value = ") {
            blank.push_str("0.0");
        }
    }
    let path = dir.path().join(name);
    std::fs::write(&path, blank).unwrap();
    (dir, path)
}

struct Noise(u64);

impl Noise {
    fn normal(&mut self) -> f64 {
        let mut uniform = || {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 11) as f64 / (1_u64 << 53) as f64
        };
        (0..12).map(|_| uniform()).sum::<f64>() - 6.0
    }
}

/// Simulates what the true chain shows at a tool point along a path.
/// The path has positions and temperatures (T1 T2 T3 T6 T8 T18); the noise is in µm.
fn measure(
    truth: &KinematicChain,
    tool_mm: [f64; 3],
    path: &[([f64; 3], [f64; 6])],
    noise_um: f64,
    seed: u64,
) -> Record {
    let mut noise = Noise(seed);
    let mut columns = Vec::new();
    let mut add = |name: &str, role: Role, data: Vec<f64>| {
        columns.push(Column { name: name.into(), unit: role.unit().unwrap().into(), role, data });
    };
    let axis = |n: &str| Axis::new(n).unwrap();
    for (k, n) in ["x", "y", "z"].iter().enumerate() {
        add(n, Role::Position(axis(n)), path.iter().map(|p| p.0[k]).collect());
    }
    for (k, n) in ["T1", "T2", "T3", "T6", "T8", "T18"].iter().enumerate() {
        add(n, Role::Temperature, path.iter().map(|p| p.1[k]).collect());
    }
    for n in ["x", "y", "z"] {
        add(&format!("e{n}"), Role::Error(axis(n)), vec![0.0; path.len()]);
    }
    let mut record = Record::new(Path::new("m.run.toml"), RunKind::Positioning, columns).unwrap();
    let mut point = truth.clone();
    point.tool_mm = tool_mm;
    for n in ["x", "y", "z"] {
        let role = Role::Error(axis(n));
        let mut out = vec![0.0; path.len()];
        point.add(&record, &role, &mut out).unwrap();
        let zero = 3.7;
        let column = record.columns.iter_mut().find(|c| c.role == role).unwrap();
        column.data = out.into_iter().map(|v| v + zero + noise_um * noise.normal()).collect();
    }
    record
}

const COLD: [f64; 6] = [20.0; 6];

/// Positions from end to end of one axis, there and back, at these temperatures.
fn stroke(axis: usize, half_mm: f64, temperatures: [f64; 6]) -> Vec<([f64; 3], [f64; 6])> {
    let at = |i: i32| {
        let mut p = [0.0; 3];
        p[axis] = half_mm * (f64::from(i % 21) - 10.0) / 10.0;
        (p, temperatures)
    };
    (0..210).map(at).collect()
}

/// Measures an axis' six components, and the rotations of its guide (squareness).
/// A gauge is at four points of the spindle.
fn of_axis(
    chain: &KinematicChain,
    truth: &KinematicChain,
    names: &[String],
    axis: usize,
    noise_um: f64,
    temperatures: &[[f64; 6]],
) -> (KinematicChain, chain_fit::ChainFitReport) {
    let path: Vec<_> = temperatures.iter().flat_map(|t| stroke(axis, 250.0, *t)).collect();
    let offsets = [[0.0, 0.0, -150.0], [200.0, 0.0, -150.0], [0.0, 200.0, -150.0], [0.0, 0.0, -350.0]];
    let records: Vec<Record> = offsets
        .iter()
        .enumerate()
        .map(|(n, tool)| measure(truth, *tool, &path, noise_um, 7 + n as u64))
        .collect();
    let runs: Vec<chain_fit::RecordWithToolPoint<'_>> = records
        .iter()
        .zip(offsets)
        .map(|(record, tool)| chain_fit::RecordWithToolPoint { record, tool_mm: Some(tool) })
        .collect();
    chain_fit::fit(chain, names, &runs).unwrap()
}

const SIX: [&str; 6] = ["dx", "dy", "dz", "ex", "ey", "ez"];

fn three_axis(
    noise_um: f64,
) -> (KinematicChain, Vec<chain_fit::FittedChainTerm>, PathBuf, tempfile::TempDir) {
    let truth = KinematicChain::read(&data("three_axis.toml")).unwrap();
    let (dir, path) = template("three_axis.toml");
    let warm = [[23.0, 20.0, 20.0, 20.0, 20.0, 20.0], COLD];
    let mut chain = KinematicChain::read(&path).unwrap();
    let mut terms = Vec::new();
    // Seen from the work, which moves on Y's guide, X is out of square to Y.
    for (joint, guide, axis, temperatures) in [
        ("y slide", &[][..], 1, &[COLD][..]),
        ("x slide", &["y guide.ez"], 0, &warm[..]),
        ("z slide", &["z guide.ex", "z guide.ey"], 2, &[COLD][..]),
    ] {
        let mut names: Vec<String> = SIX.iter().map(|c| format!("{joint}.{c}")).collect();
        names.extend(guide.iter().map(|g| (*g).to_owned()));
        let (fitted, report) = of_axis(&chain, &truth, &names, axis, noise_um, temperatures);
        chain_fit::write(&path, &fitted, &report, &path).unwrap();
        chain = KinematicChain::read(&path).unwrap();
        assert_eq!(chain, fitted, "what is written is what was fitted");
        terms.extend(report.terms);
    }
    // Spindle growth and tilt: at rest, at two gauge points, while it warms.
    let heat = |i: u32| f64::from(i % 60) / 4.0;
    let warming: Vec<_> = (0..240)
        .map(|i| {
            ([0.0; 3], [20.0, 20.0, 20.0, 20.0 + 0.6 * heat(i) + f64::from(i / 60), 20.0 + heat(i), 20.0])
        })
        .collect();
    let tools = [[0.0, 0.0, -150.0], [0.0, 0.0, -350.0], [100.0, 0.0, -150.0], [0.0, 100.0, -150.0]];
    let records: Vec<Record> = tools.iter().map(|t| measure(&truth, *t, &warming, noise_um, 5)).collect();
    let runs: Vec<_> = records
        .iter()
        .zip(tools)
        .map(|(record, tool)| chain_fit::RecordWithToolPoint { record, tool_mm: Some(tool) })
        .collect();
    let names: Vec<String> = ["dx", "dy", "dz", "ex", "ey"].iter().map(|c| format!("spindle.{c}")).collect();
    let (fitted, report) = chain_fit::fit(&chain, &names, &runs).unwrap();
    chain_fit::write(&path, &fitted, &report, &path).unwrap();
    terms.extend(report.terms);
    (KinematicChain::read(&path).unwrap(), terms, path, dir)
}

/// 21 geometric errors and the spindle's growth and tilt, with no prior values.
/// The result is compared with the symbolic reference of the truth.
#[test]
fn three_axis_machine_component_by_component() {
    if !test_needs::long() {
        return;
    }
    let truth = KinematicChain::read(&data("three_axis.toml")).unwrap();
    let coefficients = |c: &KinematicChain| -> Vec<f64> {
        let of = c.joints.iter().flat_map(|j| &j.components).flat_map(|c| &c.terms);
        of.map(|t| t.coefficient).collect()
    };
    let (chain, terms, path, dir) = three_axis(0.0);
    assert_eq!(terms.len(), coefficients(&truth).len(), "every coefficient was fitted");
    for (got, want) in coefficients(&chain).iter().zip(coefficients(&truth)) {
        // Products with errors that are fitted later (18 µrad of 14 µrad) remain.
        assert!((got - want).abs() < 1e-3, "{got} and {want}");
    }
    // The chain is written, loaded as part of a machine, and predicts the reference's figures.
    let machine = "name = \"m\"\nchain = \"three_axis.toml\"\n";
    std::fs::write(dir.path().join("m.toml"), machine).unwrap();
    let machine = Machine::read(&dir.path().join("m.toml")).unwrap();
    let reference = std::fs::read_to_string(data("chain_reference.csv")).unwrap();
    let mut judged = 0;
    for line in reference.lines().filter(|l| l.starts_with("three_axis")) {
        let n: Vec<f64> = line.split(',').skip(1).map(|w| w.parse().unwrap()).collect();
        let at = ([n[0], n[1], n[2]], [n[3], n[4], n[5], n[6], n[7], n[8]]);
        let record = measure(&chain, chain.tool_mm, &[at], 0.0, 1);
        for ((_, got), want) in machine.predict(&record).unwrap().columns.iter().zip(&n[9..]) {
            assert!((got[0] - want).abs() < 2e-3, "{line}: {} and {want}", got[0]);
            judged += 1;
        }
    }
    assert_eq!(judged, 9);
    assert!(std::fs::read_to_string(path).unwrap().contains("# squareness of Z to Y and to X"));
}

/// With a gauge's noise of 0.2 µm.
/// Intervals contain the truth as often as they state. At places that were not measured the chain is right
/// within the noise.
#[test]
fn noise_gives_intervals_that_hold() {
    if !test_needs::long() {
        return;
    }
    let truth = KinematicChain::read(&data("three_axis.toml")).unwrap();
    let (chain, terms, ..) = three_axis(0.2);
    let held = terms.iter().filter(|t| {
        let kind = SIX.iter().position(|n| *n == t.component).unwrap();
        let joint = truth.joints.iter().find(|j| j.name == t.joint).unwrap();
        let mut of = joint.components.iter().filter(|c| c.kind == kind).flat_map(|c| &c.terms);
        let want = of.find(|w| (w.position, w.temperature) == (t.p, t.dt)).unwrap().coefficient;
        t.interval[0] <= want && want <= t.interval[1]
    });
    let held = held.count();
    println!("{held} of {} intervals hold", terms.len());
    assert!(held as f64 >= 0.85 * terms.len() as f64);
    let corners = [[180.0, -140.0, -90.0], [-200.0, 150.0, 100.0], [60.0, 220.0, -200.0]];
    let path: Vec<_> = corners.iter().map(|p| (*p, [21.0, 20.0, 20.0, 26.0, 30.0, 20.0])).collect();
    let (a, b) =
        (measure(&truth, truth.tool_mm, &path, 0.0, 1), measure(&chain, truth.tool_mm, &path, 0.0, 1));
    let apart =
        a.responses().zip(b.responses()).flat_map(|(a, b)| a.data.iter().zip(&b.data).map(|(a, b)| a - b));
    let worst = apart.fold(0.0_f64, |w, d| w.max(d.abs()));
    println!("largest error at places not measured: {worst:.3} µm");
    assert!(worst < 0.5, "{worst} µm");
}

/// The eleven components of the two-axis turning centre.
#[test]
fn turning_centre_component_by_component() {
    if !test_needs::long() {
        return;
    }
    let truth = KinematicChain::read(&data("turning_centre.toml")).unwrap();
    let (_dir, path) = template("turning_centre.toml");
    let mut chain = KinematicChain::read(&path).unwrap();
    let warm = |t2: f64, t3: f64| [20.0, t2, t3, 20.0, 20.0, 20.0];
    let tools = [[-80.0, 0.0, -35.0], [20.0, 0.0, -35.0], [-80.0, 0.0, 65.0]];
    let go = |chain: &KinematicChain, names: &[&str], path: &[([f64; 3], [f64; 6])]| {
        let records: Vec<Record> = tools.iter().map(|t| measure(&truth, *t, path, 0.0, 3)).collect();
        let runs: Vec<_> = records
            .iter()
            .zip(tools)
            .map(|(record, tool)| chain_fit::RecordWithToolPoint { record, tool_mm: Some(tool) })
            .collect();
        let names: Vec<String> = names.iter().map(|n| (*n).to_owned()).collect();
        chain_fit::fit(chain, &names, &runs).unwrap().0
    };
    // The carriage's path in the frame of the spindle also shows parallelism: a known combination, fitted
    // together.
    let z: Vec<_> = [20.0, 23.0].iter().flat_map(|t| stroke(2, 200.0, warm(*t, 20.0))).collect();
    let x: Vec<_> = [20.0, 23.0].iter().flat_map(|t| stroke(0, 90.0, warm(20.0, *t))).collect();
    let heat = |i: u32| f64::from(i % 60) / 4.0;
    let still: Vec<_> = (0..240)
        .map(|i| {
            ([0.0; 3], [20.0, 20.0, 20.0, 20.0 + 0.6 * heat(i) + f64::from(i / 60), 20.0 + heat(i), 20.0])
        })
        .collect();
    let both: Vec<_> = z.iter().chain(&x).chain(&still).copied().collect();
    let all = [
        "carriage.dx",
        "carriage.dz",
        "carriage.ey",
        "cross-slide.dx",
        "cross-slide.dz",
        "cross-slide.ey",
        "cross-slide's guide.ey",
        "spindle.dx",
        "spindle.dz",
        "spindle.ey",
    ];
    chain = go(&chain, &all, &both);
    for (a, b) in chain.joints.iter().zip(&truth.joints) {
        for (c, d) in a.components.iter().zip(&b.components) {
            for (s, t) in c.terms.iter().zip(&d.terms) {
                let (got, want) = (s.coefficient, t.coefficient);
                assert!((got - want).abs() < 1e-3, "{} {}: {got} and {want}", a.name, c.kind);
            }
        }
    }
}

/// A coefficient that a record does not show is refused with a reason.
#[test]
fn what_a_record_does_not_determine_is_refused() {
    let truth = KinematicChain::read(&data("three_axis.toml")).unwrap();
    let record = measure(&truth, truth.tool_mm, &stroke(0, 200.0, COLD), 0.0, 1);
    let run = [chain_fit::RecordWithToolPoint { record: &record, tool_mm: None }];
    for (component, found) in [
        ("z slide.dz", "do not determine z slide.dz"),
        // Nothing warms.
        ("spindle.ex", "do not determine spindle.ex"),
        // Its temperature does not vary.
        ("x slide.dx", "dT = 1"),
        ("x slide.dq", "`x slide.dq`"),
    ] {
        let e = chain_fit::fit(&truth, &[component.to_owned()], &run).unwrap_err();
        assert!(e.to_string().contains(found), "{e}");
    }
}
