//! Names, parameters and bounds of all laws.

use super::super::*;
use super::one_of_each;
use std::path::Path;

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

/// Every parameter has bounds and a source, and no value is set outside them.
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
    // A fit sets coefficients without a check; `is_physical` checks afterwards.
    wave.set_coefficients(&[4.0, 4.0]);
    assert!(!wave.is_physical());
}

/// A law's file that is not in the list would not be an effect.
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
