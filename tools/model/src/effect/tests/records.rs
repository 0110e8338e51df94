//! Effects over records: whole, in pieces and live.

use super::super::*;
use super::{one_of_each, record, value_on};
use crate::live_evaluation::{AxisMotionState, LiveModel, MachineState, MachineStateLayout};

/// A whole record gives the same digits as its rows one by one.
#[test]
fn a_record_in_one_go_is_its_instants_one_by_one() {
    for e in one_of_each() {
        let force = e.description().quantity == AffectedQuantity::Force;
        let mut r = record(RunKind::Probing, 60, &[if force { "force.x" } else { "error.x" }]);
        // Two rows of one instant.
        r.columns[0].data[10] = r.columns[0].data[9];
        let (bound, k) = (e.bind(&r).unwrap(), e.coefficient_count());
        let mut all = vec![f64::NAN; 60 * k];
        bound.basis(&e, 0, &mut all);
        let (mut state, mut one) = (EffectMemory::default(), vec![0.0; k]);
        for row in 0..60 {
            e.law().basis(&e, &bound.input(row), 0, &mut state, &mut one);
            for (c, x) in one.iter().enumerate() {
                assert_eq!(all[c * 60 + row].to_bits(), x.to_bits(), "{} row {row}", e.name());
            }
        }
    }
}

/// A record in pieces gives the same digits as the whole.
#[test]
fn a_record_in_pieces_is_the_record_in_one_go() {
    for e in one_of_each() {
        let force = e.description().quantity == AffectedQuantity::Force;
        let r = record(RunKind::Probing, 60, &[if force { "force.x" } else { "error.x" }]);
        let mut whole = vec![0.0; 60];
        e.bind(&r).unwrap().add(&e, 0, &mut whole);
        let (mut states, mut pieces) = (States::default(), Vec::new());
        for rows in [0..1, 1..2, 2..31, 31..60] {
            let piece = r.select(&rows.collect::<Vec<_>>());
            let mut out = vec![0.0; piece.rows()];
            e.bind(&piece).unwrap().add_on(&e, 0, &mut states, &mut out);
            pieces.extend(out);
        }
        let bits = |all: &[f64]| all.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&pieces), bits(&whole), "{}", e.name());
    }
}

#[test]
fn probe_effects_find_their_response() {
    let all = one_of_each();
    let (lobing, latency) = (&all[22], &all[21]);
    let roles = |e: &Effect, kind, of: &[&str]| {
        e.acts_on(&record(kind, 3, of)).into_iter().map(|(r, _)| r.to_string()).collect::<Vec<_>>()
    };
    assert_eq!(roles(lobing, RunKind::Probing, &["error.x"]), ["error.x"]);
    assert_eq!(roles(lobing, RunKind::Probing, &["error.x", "error.r"]), ["error.r"]);
    assert_eq!(roles(lobing, RunKind::Probing, &["error.x", "error.y"]), Vec::<String>::new());
    assert_eq!(roles(latency, RunKind::Probing, &["error.x"]), ["error.x"]);
    assert_eq!(roles(latency, RunKind::Positioning, &["error.x"]), Vec::<String>::new());
}

#[test]
fn direction_may_come_from_velocity() {
    let with = record(RunKind::Positioning, 20, &["error.x"]);
    let mut without = with.clone();
    without.columns.retain(|c| c.name != "dx");
    let e = &one_of_each()[5];
    assert_eq!(value_on(e, &with, "error.x"), value_on(e, &without, "error.x"));
    without.columns.retain(|c| c.name != "vx");
    assert_eq!(e.bind(&without).unwrap().taken_as_zero().len(), 1);
    assert!(value_on(e, &without, "error.x").iter().all(|v| *v == 0.0));
}

#[test]
fn a_sensor_that_is_not_there_is_named() {
    let mut e = one_of_each()[12].clone();
    e.delta = Some(TemperatureDifference::pair("T1", "T99"));
    let missing = e.bind(&record(RunKind::Drift, 3, &["error.x"])).unwrap_err();
    assert_eq!((missing.what.as_str(), missing.has.as_str()), ("temperature.T99", "T1, T2"));
}

#[test]
fn live_is_the_batch_row_by_row() {
    let effects = one_of_each();
    let r = record(RunKind::Probing, 60, &["error.x", "error.y", "force.x"]);
    let axes: Vec<Axis> = ["x", "y", "z"].iter().map(|n| Axis::new(n).unwrap()).collect();
    let layout =
        MachineStateLayout { axes, sensors: vec!["T1".into(), "T2".into()], channels: vec!["z9".into()] };
    let mut live = LiveModel::new(&effects, layout).unwrap();
    let sums: Vec<Vec<f64>> = ["error.x", "error.y", "force.x"]
        .iter()
        .map(|response| {
            let mut out = vec![0.0; r.rows()];
            for e in &effects {
                e.add(&r, &Role::parse(response).unwrap(), &mut out).unwrap();
            }
            out
        })
        .collect();
    let col = |n: &str, row: usize| r.columns.iter().find(|c| c.name == n).unwrap().data[row];
    let near = |a: f64, b: f64| (a - b).abs() < 1e-9;
    for row in 0..r.rows() {
        let want: Vec<f64> = sums.iter().map(|s| s[row]).collect();
        let x = AxisMotionState {
            position_mm: col("x", row),
            velocity_mm_s: col("vx", row),
            acceleration_mm_s2: col("ax", row),
            direction: col("dx", row),
            load_n: col("Fx", row),
        };
        let rest = |n: &str| AxisMotionState { position_mm: col(n, row), ..AxisMotionState::default() };
        live.evaluate(&MachineState {
            t_s: col("t", row),
            axes: &[x, rest("y"), rest("z")],
            temperatures_degc: &[col("T1", row), col("T2", row)],
            channels: &[col("z9", row)],
            rpm: col("n", row),
            coolant: col("wet", row),
            angle_rad: col("angle", row),
            probing: true,
            held: &[],
        });
        assert!(near(live.errors_um()[0], want[0]), "row {row}");
        assert!(near(live.errors_um()[1], want[1]), "row {row}");
        assert!(near(live.forces_n()[0], want[2]), "row {row}");
    }
    assert_eq!(live.parts().count(), effects.len());
}

#[test]
fn candidates_need_their_channels() {
    let d = Dictionary::default();
    let names = |kind, responses: &[&str]| {
        let r = record(kind, 3, responses);
        d.candidates(&[&r]).iter().map(Effect::identity).collect::<Vec<_>>()
    };
    let one = names(RunKind::Positioning, &["error.x"]);
    for want in ["scale.x", "squareness.x.y", "squareness.x.z", "following_error.x", "channel.x.z9"] {
        assert!(one.iter().any(|n| n == want), "{want} not in {one:?}");
    }
    for (start, count) in
        [("thermal_growth.x", 3), ("rotation", 0), ("probe_latency", 0), ("inertia", 0), ("angular.x", 3)]
    {
        assert_eq!(one.iter().filter(|n| n.starts_with(start)).count(), count, "{start}");
    }
    let two = names(RunKind::Plate, &["error.x", "error.y"]);
    assert_eq!(two.iter().filter(|n| n.starts_with("rotation")).count(), 1);
    let probing = names(RunKind::Probing, &["error.x"]);
    assert!(
        probing.iter().any(|n| n == "probe_latency.x") && !probing.iter().any(|n| n == "following_error.x")
    );
    let force = names(RunKind::Dynamics, &["force.x"]);
    assert_eq!(
        force,
        ["inertia.x", "friction_viscous.x", "friction_coulomb.x", "friction_asymmetric.x", "force_offset.x"]
    );
}
