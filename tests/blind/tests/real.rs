//! Real machines: what reconciliation says about measured data that nobody made for it (`../shared/data`).

#![allow(clippy::unwrap_used)] // helpers of tests count as tests

use rtec_model::machine::Machine;
use rtec_model::record::{Axis, Column, Kind, Record, Role};
use rtec_reconcile::{Options, Reconciliation, reconcile};
use std::path::{Path, PathBuf};

fn data(name: &str) -> Option<String> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data").join(name);
    let text = std::fs::read_to_string(&path).ok();
    if text.is_none() {
        assert!(std::env::var_os("RTEC_REQUIRE").is_none(), "{} is not there", path.display());
        eprintln!("SKIPPED: ../shared/data/{name} not there");
    }
    text
}

fn column(name: &str, role: Role, data: Vec<f64>) -> Column {
    let unit = role.unit().unwrap_or("1").to_owned();
    Column { name: name.to_owned(), role, unit, data }
}

fn axis(name: &str) -> Axis {
    Axis::new(name).unwrap()
}

fn names(r: &Reconciliation) -> Vec<String> {
    r.effects.iter().map(|(f, _)| f.effect.name()).collect()
}

/// Rows of numbers of a CMM's table: nominal x, y in mm, errors in µm.
fn plate(text: &str) -> Record {
    let rows: Vec<Vec<f64>> = text
        .lines()
        .filter_map(|l| l.split_whitespace().map(|f| f.parse().ok()).collect::<Option<Vec<f64>>>())
        .filter(|v| v.len() == 9)
        .collect();
    let pick = |at: usize, by: f64| rows.iter().map(|r| r[at] * by).collect();
    let columns = vec![
        column("x", Role::Position(axis("x")), pick(2, 1.0)),
        column("y", Role::Position(axis("y")), pick(3, 1.0)),
        column("ex", Role::Error(axis("x")), pick(4, 1000.0)),
        column("ey", Role::Error(axis("y")), pick(5, 1000.0)),
    ];
    Record::new(&PathBuf::from("plate.run.toml"), Kind::Plate, columns).unwrap()
}

#[test]
fn a_plate_that_was_turned_is_called_turned() {
    let Some(text) = data("plate_cmm/D8131_1") else { return };
    let r = reconcile(&[plate(&text)], &[], &Machine::ideal("cnc"), &Options::default()).unwrap();
    assert!(names(&r).iter().any(|n| n == "rotation.x.y"), "{:?}", names(&r));
    let (rotation, _) = r.effects.iter().find(|(f, _)| f.effect.name() == "rotation.x.y").unwrap();
    // The owners' fit: 0.029° = 506 µrad, printed to 17 µrad.
    assert!((rotation.effect.scalar(0) - 506.0).abs() < 40.0, "{}", rotation.effect.scalar(0));
}

#[test]
fn a_plate_that_is_too_small_alike_may_be_cold() {
    let Some(text) = data("plate_cmm/D2130A1") else { return };
    let r = reconcile(&[plate(&text)], &[], &Machine::ideal("cnc"), &Options::default()).unwrap();
    assert_eq!(r.verdict, "not_separable");
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
        column("y", Role::Position(axis("y")), y),
        column("dir", Role::Direction(axis("y")), dir),
        column("n", Role::Cycle, n),
        column("e", Role::Error(axis("y")), e),
    ];
    let record = Record::new(&PathBuf::from("axis.run.toml"), Kind::Positioning, columns).unwrap();
    let r = reconcile(&[record], &[], &Machine::ideal("ecmc"), &Options::default()).unwrap();
    assert_eq!(names(&r)[..2], ["position_map.y", "reversal.y"]);
    // The owners' mean reversal: 12.77 µm, forward above backward here.
    // The way down follows the way up, so that theirs holds what the axis drifted in between.
    let drift = r.effects.iter().find(|(f, _)| f.effect.name() == "warm_up.y").map_or(0.0, |(f, _)| {
        let at = |row: f64| f.effect.scalar(0) * (1.0 - (-row / f.effect.scalar(1)).exp());
        let mean = |from: u32| {
            (0..5).flat_map(|c| (0..9).map(move |i| f64::from(18 * c + from + i))).map(at).sum::<f64>() / 45.0
        };
        mean(0) - mean(9)
    });
    let reversal = (r.effects[1].0.effect.scalar(0) + drift).abs();
    assert!((reversal - 12.77).abs() < 1.0, "{reversal}");
    assert!(r.places.iter().any(|p| p.against == "cycle" && p.q_value < 0.01), "the drift over the cycles");
}
