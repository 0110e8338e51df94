use super::*;
use crate::live::{AxisNow, Frame, Layout, Live};
use crate::record::{Column, Turns};
use std::path::Path;

/// A record with something in every column; responses error.x, error.y and force.x.
fn record(kind: Kind, rows: usize, responses: &[&str]) -> Record {
    let axis = |n: &str| Axis::new(n).unwrap();
    let mut columns = Vec::new();
    let mut add = |name: &str, role: Role, of: &dyn Fn(f64) -> f64| {
        let unit = role.unit().unwrap_or("1").to_owned();
        let data = (0..rows).map(|i| of(i as f64)).collect();
        columns.push(Column { name: name.to_owned(), role, unit, data });
    };
    add("t", Role::Time, &|i| 7.0 * i + (i % 3.0));
    add("x", Role::Position(axis("x")), &|i| 40.0 * (i / 6.0).sin());
    add("y", Role::Position(axis("y")), &|i| 100.0 - 3.0 * i);
    add("z", Role::Position(axis("z")), &|i| 2.0 * i + 5.0);
    add("dx", Role::Direction(axis("x")), &|i| if (i / 6.0).cos() > 0.0 { 1.0 } else { -1.0 });
    add("vx", Role::Velocity(axis("x")), &|i| 6.0 * (i / 6.0).cos());
    add("ax", Role::Acceleration(axis("x")), &|i| -(i / 6.0).sin());
    add("Fx", Role::Load(axis("x")), &|i| 10.0 * i);
    add("T1", Role::Temperature, &|i| 20.0 + 0.3 * i + (i / 4.0).sin());
    add("T2", Role::Temperature, &|i| 21.0 + 0.1 * i);
    add("n", Role::SpindleSpeed, &|i| 500.0 * (i % 7.0));
    add("wet", Role::Coolant, &|i| f64::from(i % 5.0 > 2.0));
    add("angle", Role::Angle, &|i| 0.37 * i);
    add("z9", Role::Channel, &|i| i * i);
    for r in responses {
        add(&format!("r_{r}"), Role::parse(r).unwrap(), &|_| 0.0);
    }
    Record::new(Path::new("test.run.toml"), kind, columns).unwrap()
}

/// One effect of every law, with parameters that leave no term out.
fn one_of_each() -> Vec<Effect> {
    let d = Dictionary::default();
    let effect = |name: &str, values: &[f64], sensor: Option<Difference>| {
        let mut e = d.effect(name).unwrap();
        e.set_values(values).unwrap();
        e.delta = sensor;
        e
    };
    let t1 = || Some(Difference::single("T1"));
    vec![
        effect("offset.x", &[3.0], None),
        effect("scale.x", &[12.0], None),
        effect("position_map.x", &[-30.0, -5.0, 10.0, 33.0, 1.0, -2.0, 3.0, 0.5], None),
        effect("screw_periodic.x", &[5.0, 2.0, 0.7], None),
        effect("subdivision.x", &[20.0, 0.4, -2.0], None),
        effect("reversal.x", &[6.0], None),
        effect("reversal_spike.x", &[4.0, 2.5], None),
        effect("straightness.x.y", &[-10.0, 20.0, 60.0, -1.0, 2.0, 1.0], None),
        effect("squareness.x.y", &[25.0], None),
        effect("rotation.y.x", &[30.0], None),
        effect("angular.x.y.z", &[40.0], None),
        effect("thermal_expansion.x", &[11.5], t1()),
        effect("thermal_growth.x", &[0.114, -0.0008], Some(Difference::pair("T1", "T2"))),
        effect(
            "thermal_lag.x",
            &[1.2, 0.05, 90.0],
            Some(Difference { sensor: "T1".into(), against: Against::Reference(18.0) }),
        ),
        effect("warm_up.x", &[15.0, 120.0], None),
        effect("coolant.x", &[-3.0], None),
        effect("spindle_speed.x", &[0.8, 0.1], None),
        effect("following_error.x", &[1.5], None),
        effect("acceleration_error.x", &[4.0], None),
        effect("stiffness.x", &[0.02], None),
        effect("lost_counts.x", &[5.0, 100.0], None),
        effect("probe_latency.x", &[800.0], None),
        effect("probe_lobing", &[3.0, 3.0, 0.4], None),
        effect("form_bump", &[5.0, 1.0, 2.0], None),
        effect("channel.x.z9", &[0.01], None),
        effect("inertia.x", &[95.0], None),
        effect("friction_viscous.x", &[203.0], None),
        effect("friction_coulomb.x", &[20.0], None),
        effect("friction_asymmetric.x", &[17.0], None),
        effect("force_offset.x", &[-3.0], None),
        effect("reversal_slope.x", &[9.0], None),
        effect("screw_slope.x", &[5.0, 6.0, 0.7], None),
    ]
}

const TABLE: [&str; 32] = [
    "offset",
    "scale",
    "position_map",
    "screw_periodic",
    "subdivision",
    "reversal",
    "reversal_spike",
    "straightness",
    "squareness",
    "rotation",
    "angular",
    "thermal_expansion",
    "thermal_growth",
    "thermal_lag",
    "warm_up",
    "coolant",
    "spindle_speed",
    "following_error",
    "acceleration_error",
    "stiffness",
    "lost_counts",
    "probe_latency",
    "probe_lobing",
    "form_bump",
    "channel",
    "inertia",
    "friction_viscous",
    "friction_coulomb",
    "friction_asymmetric",
    "force_offset",
    "reversal_slope",
    "screw_slope",
];

#[test]
fn dictionary_is_the_table() {
    let d = Dictionary::default();
    let mut have: Vec<&str> = d.laws().map(|l| l.describe().name.as_str()).collect();
    let mut want = TABLE.to_vec();
    have.sort_unstable();
    want.sort_unstable();
    assert_eq!(have, want);
    assert_eq!(one_of_each().iter().map(|e| e.description().name.as_str()).collect::<Vec<_>>(), TABLE);
    for law in d.laws() {
        let c = law.describe();
        assert!(!c.law.is_empty() && !c.cause.is_empty() && !c.experiment.is_empty(), "{}", c.name);
    }
}

/// The effect's value at a row, from the record's columns and formats.md's formula alone.
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

fn value_on(effect: &Effect, r: &Record, response: &str) -> Vec<f64> {
    let mut out = vec![0.0; r.rows()];
    effect.add(r, &Role::parse(response).unwrap(), &mut out).unwrap();
    out
}

#[test]
fn laws_are_the_formulas() {
    for e in one_of_each() {
        let force = e.description().quantity == Quantity::Force;
        let r = record(Kind::Probing, 60, &[if force { "force.x" } else { "error.x" }]);
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

/// The same digits in one go over a record as instant by instant, on the machine.
#[test]
fn a_record_in_one_go_is_its_instants_one_by_one() {
    for e in one_of_each() {
        let force = e.description().quantity == Quantity::Force;
        let mut r = record(Kind::Probing, 60, &[if force { "force.x" } else { "error.x" }]);
        // Two rows of one instant.
        r.columns[0].data[10] = r.columns[0].data[9];
        let (bound, k) = (e.bind(&r).unwrap(), e.coefficient_count());
        let mut all = vec![f64::NAN; 60 * k];
        bound.basis(&e, 0, &mut all);
        let (mut state, mut one) = (State::default(), vec![0.0; k]);
        for row in 0..60 {
            e.law().basis(&e, &bound.input(row), 0, &mut state, &mut one);
            for (c, x) in one.iter().enumerate() {
                assert_eq!(all[c * 60 + row].to_bits(), x.to_bits(), "{} row {row}", e.name());
            }
        }
    }
}

/// The same digits piece by piece as in one go.
#[test]
fn a_record_in_pieces_is_the_record_in_one_go() {
    for e in one_of_each() {
        let force = e.description().quantity == Quantity::Force;
        let r = record(Kind::Probing, 60, &[if force { "force.x" } else { "error.x" }]);
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
fn slopes_agree_with_central_differences() {
    for e in one_of_each() {
        let force = e.description().quantity == Quantity::Force;
        let r = record(Kind::Probing, 60, &[if force { "force.x" } else { "error.x" }]);
        let (_, component) = e.acts_on(&r)[0].clone();
        let bound = e.bind(&r).unwrap();
        let mut slopes = vec![0.0; r.rows() * e.values().len()];
        bound.slopes(&e, component, &mut slopes);
        for i in 0..e.values().len() {
            let p = &e.description().parameters[i / e.width()];
            if p.search == Search::Chosen {
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
fn coefficients_and_parameters_are_one_thing() {
    for e in one_of_each() {
        let mut other = e.clone();
        let c = e.coefficients();
        other.set_coefficients(&vec![0.0; c.len()]);
        other.set_coefficients(&c);
        for (a, b) in e.values().iter().zip(other.values()) {
            assert!((a - b).abs() < 1e-12, "{}: {:?} {:?}", e.name(), e.values(), other.values());
        }
    }
}

#[test]
fn names_read_back() {
    let d = Dictionary::default();
    for e in one_of_each() {
        assert_eq!(d.effect(&e.name()).unwrap().name(), e.name());
    }
    assert_eq!(d.effect("rotation.y.x").unwrap().name(), "rotation.x.y");
    assert_eq!(d.effect("channel.z.a.b").unwrap().channel(), Some("a.b"));
    for bad in [
        "",
        "scale",
        "scale.",
        "scale.x.y",
        "scale.1",
        "rotation.x.x",
        "angular.x.y",
        "channel.x",
        "probe_lobing.x",
    ] {
        assert!(d.effect(bad).is_err(), "{bad}");
    }
}

#[test]
fn rotation_acts_on_both_axes() {
    let e = &one_of_each()[9];
    let r = record(Kind::Plate, 5, &["error.x", "error.y"]);
    let (x, y) = (&r.columns[1].data, &r.columns[2].data);
    for row in 0..5 {
        assert!((value_on(e, &r, "error.x")[row] + 30.0 * y[row] / 1e3).abs() < 1e-12);
        assert!((value_on(e, &r, "error.y")[row] - 30.0 * x[row] / 1e3).abs() < 1e-12);
    }
}

#[test]
fn probe_effects_find_their_response() {
    let all = one_of_each();
    let (lobing, latency) = (&all[22], &all[21]);
    let roles = |e: &Effect, kind, of: &[&str]| {
        e.acts_on(&record(kind, 3, of)).into_iter().map(|(r, _)| r.to_string()).collect::<Vec<_>>()
    };
    assert_eq!(roles(lobing, Kind::Probing, &["error.x"]), ["error.x"]);
    assert_eq!(roles(lobing, Kind::Probing, &["error.x", "error.r"]), ["error.r"]);
    assert_eq!(roles(lobing, Kind::Probing, &["error.x", "error.y"]), Vec::<String>::new());
    assert_eq!(roles(latency, Kind::Probing, &["error.x"]), ["error.x"]);
    assert_eq!(roles(latency, Kind::Positioning, &["error.x"]), Vec::<String>::new());
}

#[test]
fn map_is_linear_between_knots_and_constant_beyond() {
    let e = &one_of_each()[2];
    let mut out = [0.0; 4];
    let mut at = |p: f64| {
        let now = Input { p_mm: [p, 0.0, 0.0], ..Input::default() };
        e.law().basis(e, &now, 0, &mut State::default(), &mut out);
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

/// First-order lag against the exact solution for a ramp that starts from equilibrium, whatever the step.
#[test]
fn lag_is_exact_for_linear_input() {
    let mut e = Dictionary::default().effect("thermal_lag.z").unwrap();
    e.set_values(&[1.0, 0.0, 50.0]).unwrap();
    for steps in [&[10.0; 30][..], &[0.0, 1.0, 200.0, 0.5, 0.0, 300.0][..]] {
        let mut state = State::default();
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
    let mut state = State::default();
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

/// A run that turns beyond its targets is that much further from the turn at the first of them.
#[test]
fn a_spike_dies_out_on_the_way_that_no_row_shows() {
    let mut run = record(Kind::Positioning, 20, &["error.x"]);
    for (column, of) in [("x", [1.0, 9.0, 9.0, 1.0]), ("dx", [1.0, 1.0, -1.0, -1.0])] {
        let data = &mut run.columns.iter_mut().find(|c| c.name == column).unwrap().data;
        data.iter_mut().enumerate().for_each(|(i, x)| *x = of[i.min(3)]);
    }
    let spike =
        Dictionary::default().effect("reversal_spike.x").unwrap().with(&[(0, 4.0), (1, 2.0)]).unwrap();
    for (turns, past_mm) in [
        (None, 0.0),
        (Some(Turns::AtTarget), 0.0),
        (Some(Turns::Overtravel(None)), 0.0),
        (Some(Turns::Overtravel(Some(3.0))), 3.0),
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
fn direction_may_come_from_velocity() {
    let with = record(Kind::Positioning, 20, &["error.x"]);
    let mut without = with.clone();
    without.columns.retain(|c| c.name != "dx");
    let e = &one_of_each()[5];
    assert_eq!(value_on(e, &with, "error.x"), value_on(e, &without, "error.x"));
    without.columns.retain(|c| c.name != "vx");
    assert_eq!(e.bind(&without).unwrap().taken_as_zero().len(), 1);
    assert!(value_on(e, &without, "error.x").iter().all(|v| *v == 0.0));
}

#[test]
fn outside_its_range_growth_is_held() {
    let mut e = one_of_each()[12].clone();
    e.range_k = Some([0.0, 1.0]);
    let r = record(Kind::Drift, 60, &["error.x"]);
    let top = 0.114 - 0.0008;
    assert!(value_on(&e, &r, "error.x").iter().all(|v| (0.0..=top).contains(v)));
}

#[test]
fn a_sensor_that_is_not_there_is_named() {
    let mut e = one_of_each()[12].clone();
    e.delta = Some(Difference::pair("T1", "T99"));
    let missing = e.bind(&record(Kind::Drift, 3, &["error.x"])).unwrap_err();
    assert_eq!((missing.what.as_str(), missing.has.as_str()), ("temperature.T99", "T1, T2"));
}

#[test]
fn live_is_the_batch_row_by_row() {
    let effects = one_of_each();
    let r = record(Kind::Probing, 60, &["error.x", "error.y", "force.x"]);
    let axes: Vec<Axis> = ["x", "y", "z"].iter().map(|n| Axis::new(n).unwrap()).collect();
    let layout = Layout { axes, sensors: vec!["T1".into(), "T2".into()], channels: vec!["z9".into()] };
    let mut live = Live::new(&effects, layout).unwrap();
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
        let x = AxisNow {
            position_mm: col("x", row),
            velocity_mm_s: col("vx", row),
            acceleration_mm_s2: col("ax", row),
            direction: col("dx", row),
            load_n: col("Fx", row),
        };
        let rest = |n: &str| AxisNow { position_mm: col(n, row), ..AxisNow::default() };
        live.evaluate(&Frame {
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
    let one = names(Kind::Positioning, &["error.x"]);
    for want in ["scale.x", "squareness.x.y", "squareness.x.z", "following_error.x", "channel.x.z9"] {
        assert!(one.iter().any(|n| n == want), "{want} not in {one:?}");
    }
    for (start, count) in
        [("thermal_growth.x", 3), ("rotation", 0), ("probe_latency", 0), ("inertia", 0), ("angular.x", 3)]
    {
        assert_eq!(one.iter().filter(|n| n.starts_with(start)).count(), count, "{start}");
    }
    let two = names(Kind::Plate, &["error.x", "error.y"]);
    assert_eq!(two.iter().filter(|n| n.starts_with("rotation")).count(), 1);
    let probing = names(Kind::Probing, &["error.x"]);
    assert!(
        probing.iter().any(|n| n == "probe_latency.x") && !probing.iter().any(|n| n == "following_error.x")
    );
    let force = names(Kind::Dynamics, &["force.x"]);
    assert_eq!(
        force,
        ["inertia.x", "friction_viscous.x", "friction_coulomb.x", "friction_asymmetric.x", "force_offset.x"]
    );
}

/// formats.md, "Bounds": with a reason each, and nothing is set outside them.
#[test]
fn every_parameter_has_bounds_with_a_source() {
    for law in Dictionary::default().laws().map(Law::describe) {
        for p in &law.parameters {
            let [lo, hi] = p.bounds;
            assert!(lo.is_finite() && hi.is_finite() && lo < hi, "{} {}", law.name, p.name);
            assert!(p.source.len() > 10, "{} {}: bounds without a reason", law.name, p.name);
            let [from, to] = p.plausible;
            assert!(from >= lo && to <= hi, "{} {}: plausible, but refused", law.name, p.name);
        }
    }
    let d = Dictionary::default();
    let refused = |name: &str, key: &str, value: f64| {
        let e = d.effect(name).unwrap().set(key, &[value]).unwrap_err();
        assert!(e.parameter == key && e.expected.len() > 20, "{e}");
    };
    refused("scale.x", "ppm", 1001.0);
    refused("thermal_growth.z", "um_per_K", -60.5);
    refused("thermal_lag.z", "um_per_K", 61.0);
    refused("screw_periodic.x", "period_mm", 61.0);
    let mut wave = d.effect("subdivision.x").unwrap();
    wave.set_values(&[20.0, 5.0, 0.0]).unwrap();
    assert!(wave.set("um", &[5.1]).unwrap_err().expected.contains("0.25 of the period"));
    // Coefficients are set as a fit finds them, and asked afterwards.
    wave.set_coefficients(&[4.0, 4.0]);
    assert!(!wave.is_physical());
}

/// A file whose line was forgotten is no effect.
#[test]
fn every_file_of_a_law_is_in_the_list() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/effect/laws");
    let dictionary = Dictionary::default();
    let mut files = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_stem().unwrap().to_str().unwrap().to_owned();
        if name != "mod" {
            files += 1;
            assert!(dictionary.laws().any(|l| l.describe().name == name), "{name}");
        }
    }
    assert_eq!(files, dictionary.laws().count());
}
