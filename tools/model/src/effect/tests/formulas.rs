//! Each law against its formula.

use super::super::*;
use super::{one_of_each, record, value_on};
use crate::record::ReversalPoint;

/// The effect's value at a row by the guide's formula, from the record's columns.
fn by_hand(name: &str, r: &Record, row: usize) -> f64 {
    let col = |n: &str| r.columns.iter().find(|c| c.name == n).unwrap().data[row];
    let (t, x, y, z, v) = (col("t"), col("x"), col("y"), col("z"), col("vx"));
    let pi = std::f64::consts::PI;
    match name {
        "offset.x" => 3.0,
        "scale.x" => 12.0 * x / 1000.0,
        "screw_periodic.x" => 2.0 * (2.0 * pi * x / 5.0 + 0.7).sin(),
        "subdivision.x" => 0.4 * (2.0 * pi * x * 1000.0 / 20.0 - 2.0).sin(),
        "reversal.x" => 3.0 * col("dx"),
        "squareness.x.y" => 25.0 * y / 1000.0,
        "rotation.x.y" => -30.0 * y / 1000.0,
        "angular.x.y.z" => 40.0 * y * z / 1e6,
        "thermal_expansion.x" => 11.5 * (col("T1") - 20.0) * x / 1000.0,
        "thermal_growth.x" => {
            let d = col("T1") - col("T2");
            0.114 * d - 0.0008 * d * d
        }
        "warm_up.x" => 15.0 * (1.0 - (-t / 120.0).exp()),
        "coolant.x" => -3.0 * col("wet"),
        "spindle_speed.x" => 0.8 * col("n") / 1e3 + 0.1 * (col("n") / 1e3).powi(2),
        "following_error.x" => 1.5 * v,
        "acceleration_error.x" => 4.0 * col("ax") / 1000.0,
        "stiffness.x" => 0.02 * col("Fx"),
        "lost_counts.x" => {
            if t >= 100.0 {
                5.0
            } else {
                0.0
            }
        }
        "probe_latency.x" => 0.8 * v,
        "probe_lobing" => 3.0 * (3.0 * col("angle") + 0.4).cos(),
        "channel.x.z9" => 0.01 * col("z9"),
        "inertia.x" => 95.0 * col("ax") / 1000.0,
        "friction_viscous.x" => 203.0 * v / 1000.0,
        "friction_coulomb.x" => 20.0 * sign(v),
        "friction_asymmetric.x" => 17.0 * v.abs() / 1000.0,
        "force_offset.x" => -3.0,
        "reversal_slope.x" => 9.0 * x / 1000.0 * col("dx") / 2.0,
        "screw_slope.x" => 6.0 * x / 1000.0 * (2.0 * pi * x / 5.0 + 0.7).sin(),
        _ => f64::NAN,
    }
}

#[test]
fn laws_are_the_formulas() {
    for e in one_of_each() {
        let force = e.description().quantity == AffectedQuantity::Force;
        let r = record(RunKind::Probing, 60, &[if force { "force.x" } else { "error.x" }]);
        let out = value_on(&e, &r, if force { "force.x" } else { "error.x" });
        if by_hand(&e.name(), &r, 0).is_nan() {
            continue; // has a test of its own
        }
        for (row, v) in out.iter().enumerate() {
            let want = by_hand(&e.name(), &r, row);
            assert!((v - want).abs() < 1e-9 * want.abs().max(1.0), "{} row {row}: {v} != {want}", e.name());
        }
    }
}

#[test]
fn slopes_agree_with_central_differences() {
    for e in one_of_each() {
        let force = e.description().quantity == AffectedQuantity::Force;
        let r = record(RunKind::Probing, 60, &[if force { "force.x" } else { "error.x" }]);
        let (_, component) = e.acts_on(&r)[0].clone();
        let bound = e.bind(&r).unwrap();
        let mut slopes = vec![0.0; r.rows() * e.values().len()];
        bound.slopes(&e, component, &mut slopes);
        for i in 0..e.values().len() {
            let p = &e.description().parameters[i / e.width()];
            if p.search == ParameterFitMethod::Chosen {
                assert!(slopes[i * r.rows()..(i + 1) * r.rows()].iter().all(|s| *s == 0.0));
                continue;
            }
            let h = 2e-7 * e.values()[i].abs().max(1e-3);
            let shifted = |by: f64| {
                let mut values = e.values().to_vec();
                values[i] += by;
                let mut moved = e.clone();
                moved.set_values(&values).unwrap();
                let mut out = vec![0.0; r.rows()];
                bound.add(&moved, component, &mut out);
                out
            };
            let (up, down) = (shifted(h), shifted(-h));
            let scale = up.iter().fold(1e-6_f64, |a, b| a.max(b.abs()));
            for row in 0..r.rows() {
                let want = (up[row] - down[row]) / (2.0 * h);
                let got = slopes[i * r.rows() + row];
                let close = 1e-5 * want.abs() + 1e-11 * scale / h;
                assert!((got - want).abs() <= close, "{} by {} row {row}: {got} != {want}", e.name(), p.name);
            }
        }
    }
}

#[test]
fn rotation_acts_on_both_axes() {
    let e = &one_of_each()[9];
    let r = record(RunKind::Plate, 5, &["error.x", "error.y"]);
    let (x, y) = (&r.columns[1].data, &r.columns[2].data);
    for row in 0..5 {
        assert!((value_on(e, &r, "error.x")[row] + 30.0 * y[row] / 1e3).abs() < 1e-12);
        assert!((value_on(e, &r, "error.y")[row] - 30.0 * x[row] / 1e3).abs() < 1e-12);
    }
}

#[test]
fn map_is_linear_between_knots_and_constant_beyond() {
    let e = &one_of_each()[2];
    let mut out = [0.0; 4];
    let mut at = |p: f64| {
        let now = Input { p_mm: [p, 0.0, 0.0], ..Input::default() };
        e.law().basis(e, &now, 0, &mut EffectMemory::default(), &mut out);
        out.iter().zip(e.get(1)).map(|(b, u)| b * u).sum::<f64>()
    };
    for (p, um) in
        [(-99.0, 1.0), (-30.0, 1.0), (-17.5, -0.5), (-5.0, -2.0), (10.0, 3.0), (33.0, 0.5), (99.0, 0.5)]
    {
        assert!((at(p) - um).abs() < 1e-12, "{p}");
    }
    let rows = e.constraints();
    assert_eq!((rows.len(), rows[0].len()), (2, 4));
}

/// A first-order lag equals the exact solution for a ramp, whatever the step.
/// The ramp begins in equilibrium.
#[test]
fn lag_is_exact_for_linear_input() {
    let mut e = Dictionary::default().effect("thermal_lag.z").unwrap();
    e.set_values(&[1.0, 0.0, 50.0]).unwrap();
    for steps in [&[10.0; 30][..], &[0.0, 1.0, 200.0, 0.5, 0.0, 300.0][..]] {
        let mut state = EffectMemory::default();
        let mut t = 5.0;
        let mut out = [0.0; 2];
        let now = |t: f64| Input { t_s: t, delta_k: 2.0 + 0.1 * (t - 5.0), ..Input::default() };
        e.law().basis(&e, &now(t), 0, &mut state, &mut out);
        assert!((out[0] - 2.0).abs() + (out[1] - 4.0).abs() < 1e-12);
        for h in steps {
            t += h;
            e.law().basis(&e, &now(t), 0, &mut state, &mut out);
            let s = t - 5.0;
            let want = 2.0 + 0.1 * (s - 50.0 * (1.0 - (-s / 50.0).exp()));
            assert!((out[0] - want).abs() < 1e-12, "{t}: {} {want}", out[0]);
        }
    }
}

#[test]
fn spike_counts_travel_from_the_last_row_of_the_old_direction() {
    let mut e = Dictionary::default().effect("reversal_spike.x").unwrap();
    e.set_values(&[10.0, 2.0]).unwrap();
    let mut state = EffectMemory::default();
    let mut out = [0.0];
    // position, direction, travel since the reversal (none before the first)
    for (p, dir, d) in [
        (0.0, 1.0, None),
        (5.0, 1.0, None),
        (4.0, -1.0, Some(1.0)),
        (2.0, -1.0, Some(3.0)),
        (2.5, 0.0, None), // at rest: no direction, no effect; the travel goes on
        (1.5, -1.0, Some(4.5)),
        (1.0, 0.0, None),
        (1.25, 1.0, Some(0.75)),
        (2.25, 1.0, Some(1.75)),
    ] {
        let now = Input { p_mm: [p, 0.0, 0.0], dir, ..Input::default() };
        e.law().basis(&e, &now, 0, &mut state, &mut out);
        let want = d.map_or(0.0, |d: f64| dir * (-d / 2.0).exp());
        assert!((out[0] - want).abs() < 1e-12, "at {p}: {} {want}", out[0]);
    }
}

/// If a run turns beyond its targets, the first target is further from the turn.
#[test]
fn a_spike_dies_out_on_the_way_that_no_row_shows() {
    let mut run = record(RunKind::Positioning, 20, &["error.x"]);
    for (column, of) in [("x", [1.0, 9.0, 9.0, 1.0]), ("dx", [1.0, 1.0, -1.0, -1.0])] {
        let data = &mut run.columns.iter_mut().find(|c| c.name == column).unwrap().data;
        data.iter_mut().enumerate().for_each(|(i, x)| *x = of[i.min(3)]);
    }
    let spike =
        Dictionary::default().effect("reversal_spike.x").unwrap().with(&[(0, 4.0), (1, 2.0)]).unwrap();
    for (turns, past_mm) in [
        (None, 0.0),
        (Some(ReversalPoint::AtTarget), 0.0),
        (Some(ReversalPoint::Overtravel(None)), 0.0),
        (Some(ReversalPoint::Overtravel(Some(3.0))), 3.0),
    ] {
        run.turns = turns;
        let said = value_on(&spike, &run, "error.x");
        for (row, travel_mm) in [(2, past_mm), (3, past_mm + 8.0)] {
            let want = -4.0 * f64::exp(-travel_mm / 2.0);
            assert!((said[row] - want).abs() < 1e-12, "{turns:?}, row {row}: {} {want}", said[row]);
        }
    }
}

#[test]
fn outside_its_range_growth_is_held() {
    let mut e = one_of_each()[12].clone();
    e.range_k = Some([0.0, 1.0]);
    let r = record(RunKind::Drift, 60, &["error.x"]);
    let top = 0.114 - 0.0008;
    assert!(value_on(&e, &r, "error.x").iter().all(|v| (0.0..=top).contains(v)));
}
