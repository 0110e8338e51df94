mod dictionary;
mod formulas;
mod records;

use super::*;
use crate::record::Column;
use std::path::Path;

/// A record with every role and the given responses.
fn record(kind: RunKind, rows: usize, responses: &[&str]) -> Record {
    let axis = |n: &str| Axis::new(n).unwrap();
    let mut columns = Vec::new();
    let mut add = |name: &str, role: Role, of: &dyn Fn(f64) -> f64| {
        columns.push(Column::new(name, role, (0..rows).map(|i| of(i as f64)).collect()));
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

/// One effect of every law, with parameters that exercise every term.
fn one_of_each() -> Vec<Effect> {
    let d = Dictionary::default();
    let effect = |name: &str, values: &[f64], sensor: Option<TemperatureDifference>| {
        let mut e = d.effect(name).unwrap();
        e.set_values(values).unwrap();
        e.delta = sensor;
        e
    };
    let t1 = || Some(TemperatureDifference::single("T1"));
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
        effect("thermal_growth.x", &[0.114, -0.0008], Some(TemperatureDifference::pair("T1", "T2"))),
        effect(
            "thermal_lag.x",
            &[1.2, 0.05, 90.0],
            Some(TemperatureDifference {
                sensor: "T1".into(),
                against: ReferenceTemperature::Reference(18.0),
            }),
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

fn value_on(effect: &Effect, r: &Record, response: &str) -> Vec<f64> {
    let mut out = vec![0.0; r.rows()];
    effect.add(r, &Role::parse(response).unwrap(), &mut out).unwrap();
    out
}
