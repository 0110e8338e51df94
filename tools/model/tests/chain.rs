//! The chain model against exact rational arithmetic and a first-order sum.
//! The exact values are from `data/chain_reference.py`; the sum is the well-known one of a turning centre.

use rtec_model::effect::{ReferenceTemperature, STANDARD_DEGC, TemperatureDifference};
use rtec_model::kinematic_chain::{KinematicChain, Transform, transform};
use rtec_model::live_evaluation::{AxisMotionState, LiveModel, MachineState, MachineStateLayout};
use rtec_model::machine::Machine;
use rtec_model::record::{Axis, Column, Record, Role, RunKind};
use std::path::Path;

fn data(name: &str) -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

#[test]
fn equal_to_the_symbolic_reference() {
    let names = ["T1", "T2", "T3", "T6", "T8", "T18"];
    let text = std::fs::read_to_string(data("chain_reference.csv")).unwrap();
    assert_eq!(text.lines().count(), 6);
    for line in text.lines() {
        let words: Vec<&str> = line.split(',').collect();
        let numbers: Vec<f64> = words[1..].iter().map(|w| w.parse().unwrap()).collect();
        let chain = KinematicChain::read(&data(words[0])).unwrap();
        let degc = |s: &str| numbers[3 + names.iter().position(|n| *n == s).unwrap()];
        let delta = |d: &TemperatureDifference| {
            degc(&d.sensor)
                - match &d.against {
                    ReferenceTemperature::Sensor(m) => degc(m),
                    ReferenceTemperature::Reference(t) => *t,
                    ReferenceTemperature::Standard => STANDARD_DEGC,
                }
        };
        let axis = |a: &rtec_model::record::Axis| {
            numbers[["x", "y", "z"].iter().position(|n| *n == a.as_str()).unwrap()]
        };
        let got = chain.error_um(axis, delta);
        for (g, want) in got.iter().zip(&numbers[9..]) {
            // The error is a difference of metres in µm: seven digits are lost, nine remain.
            assert!((g - want).abs() < 1e-9, "{line}: {g} and {want}");
        }
    }
}

/// Squareness and a carriage's yaw at the lever of the cross-slide.
/// The expected value is the first-order sum by hand.
#[test]
fn turning_centre_by_hand() {
    let chain = KinematicChain::read(&data("turning_centre.toml")).unwrap();
    let at = |x: f64, z: f64| {
        let axis = move |a: &rtec_model::record::Axis| if a.as_str() == "x" { x } else { z };
        // All temperatures equal and at 20 °C: geometry only.
        chain.error_um(axis, |_| 0.0)
    };
    let e = at(50.0, 200.0);
    // Carriage at p = 2 (100 mm): dx 1.92, dz 2.6 µm, ey 2 µrad.
    // Cross-slide at p = 0.5: dx −1.1, dz 0.1 µm, ey −1.5 µrad.
    // Its guide: ey 21 µrad. Spindle: ey 12 µrad.
    // Tool point in mm: from carriage and guide (120, −, 5), from the cross-slide (−80, −, −35), from the spindle
    // (120, −, 385).
    // A rotation ey moves x by +ey·z and z by −ey·x.
    let x = 1.92 + 2e-3 * 5.0 - 1.1 - 1.5e-3 * -35.0 + 21e-3 * 5.0 - 12e-3 * 385.0;
    let z = 2.6 - 2e-3 * 120.0 + 0.1 - 1.5e-3 * 80.0 - 21e-3 * 120.0 + 12e-3 * 120.0;
    assert!((e[0] - x).abs() < 2e-3 && (e[2] - z).abs() < 2e-3, "{e:?}: {x} {z}");
}

/// Prepared evaluation, live or by rows, equals the plain one to the last bit.
/// Sensors and axes are in another order than in the chain, with one more of each.
#[test]
fn live_and_by_rows_it_is_what_its_names_say() {
    let chain = KinematicChain::read(&data("turning_centre.toml")).unwrap();
    let machine =
        Machine::parse(Path::new("m.toml"), "name = \"m\"\n").unwrap().with_chain(Some(chain.clone()));
    let (axes, sensors) = (["z", "y", "x"], ["T18", "T3", "T6", "T9", "T2", "T8"]);
    let axis = |name: &str| Axis::new(name).unwrap();
    let layout = MachineStateLayout {
        axes: axes.map(axis).into(),
        sensors: sensors.map(String::from).into(),
        channels: vec![],
    };
    let mut live = LiveModel::of(&machine, layout).unwrap();
    let value = |row: usize, column: usize| ((row * 7 + column * 31) % 23) as f64 * 1.37 - 4.0;
    let rows = 0..40_usize;
    let column = |name: &str, role: Role, n: usize| {
        Column::new(name, role, rows.clone().map(|row| value(row, n)).collect())
    };
    let places = axes.iter().enumerate().map(|(n, a)| column(a, Role::Position(axis(a)), n));
    let degc = sensors.iter().enumerate().map(|(n, s)| column(s, Role::Temperature, 3 + n));
    let error = std::iter::once(column("e", Role::Error(axis("x")), 20));
    let columns = places.chain(degc).chain(error).collect();
    let record = Record::new(Path::new("r.run.toml"), RunKind::Drift, columns).unwrap();
    let mut by_rows = vec![0.0; record.rows()];
    chain.add(&record, &Role::Error(axis("x")), &mut by_rows).unwrap();
    for row in rows.clone() {
        let at = |n: usize| value(row, n);
        let degc = |s: &str| at(3 + sensors.iter().position(|n| *n == s).unwrap());
        let delta = |d: &TemperatureDifference| match &d.against {
            ReferenceTemperature::Sensor(m) => degc(&d.sensor) - degc(m),
            ReferenceTemperature::Reference(t) => degc(&d.sensor) - t,
            ReferenceTemperature::Standard => degc(&d.sensor) - STANDARD_DEGC,
        };
        let want = chain.error_um(|a| at(axes.iter().position(|n| *n == a.as_str()).unwrap()), delta);
        assert!(want.iter().any(|e| e.abs() > 1.0), "{want:?}");
        let now = [0, 1, 2].map(|n| AxisMotionState::moving(at(n), 0.0));
        let temperatures: Vec<f64> = (3..9).map(at).collect();
        live.evaluate(&MachineState {
            axes: &now,
            temperatures_degc: &temperatures,
            ..MachineState::default()
        });
        assert_eq!(live.chain_um().unwrap().map(f64::to_bits), want.map(f64::to_bits), "{row}");
        assert_eq!(by_rows[row].to_bits(), want[0].to_bits(), "{row}");
    }
}

#[test]
fn nothing_wrong_gives_nothing() {
    let chain = KinematicChain { joints: Vec::new(), tool_mm: [1.0, 2.0, 3.0] };
    assert!(chain.error_um(|_| 7.0, |_| 3.0).iter().all(|e| *e == 0.0));
    assert_eq!(transform([0.0; 3], [0.0; 3]), Transform::IDENTITY);
}

#[test]
fn findings_carry_their_place() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("c.toml");
    for (text, line, found) in [
        ("[[joint]]\nname = \"a\"\nbranch = \"wrok\"\n", 3, "wrok"),
        ("[[joint]]\nname = \"a\"\nbranch = \"work\"\naxis = \"w\"\n", 4, "without direction"),
        ("[[joint]]\nname = \"a\"\nbranch = \"work\"\ncomponent = [{ of = \"dq\", terms = [] }]\n", 4, "dq"),
        (
            "[[joint]]\nname = \"a\"\nbranch = \"work\"\ncomponent = [{ of = \"dx\", terms = [{ dT = 1, value = 1 }] }]\n",
            4,
            "without `sensor`",
        ),
        ("joints = 1\n", 1, "unknown key"),
    ] {
        std::fs::write(&path, text).unwrap();
        let e = KinematicChain::read(&path).unwrap_err();
        assert!(e.line == line && e.found.contains(found), "{e}");
    }
}
