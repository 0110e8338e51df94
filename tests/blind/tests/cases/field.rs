//! Records that an earlier search misread, each for a kind of mistake.
//! They come from people and from a simulated shop (`../shared/data/field`, not part of the project). The assertions
//! state the right answer.

#![allow(clippy::unwrap_used)] // helpers of tests count as tests

use rtec_measure::plausible::MistakeKind;
use rtec_model::machine::Machine;
use rtec_reconcile::{ReconciliationOptions, ReconciliationResult, Verdict, reconcile};

/// The answer for records of one case; `None` where the cases are not installed.
fn answer(case: &str, model: &str, train: &[&str], held: &[&str]) -> Option<ReconciliationResult> {
    let folder = test_needs::shared(&format!("data/field/{case}"))?;
    let read = |names: &[&str]| -> Vec<_> {
        let of =
            |n: &&str| rtec_measure::run_record_files::read(&folder.join(format!("{n}.run.toml"))).unwrap();
        names.iter().map(of).collect()
    };
    let machine = Machine::read(&folder.join(model)).unwrap();
    Some(reconcile(&read(train), &read(held), &machine, &ReconciliationOptions::default()).unwrap())
}

fn shop(case: &str, train: &[&str], held: &[&str]) -> Option<ReconciliationResult> {
    answer(&format!("shop/{case}"), "model.toml", train, held)
}

fn names(r: &ReconciliationResult) -> Vec<String> {
    r.effects.iter().map(|(f, _)| f.effect.name()).collect()
}

fn quiet(r: &ReconciliationResult) {
    assert!(r.verdict == Verdict::NothingMissing && r.refined.is_empty(), "{}", r.to_json());
    assert!(r.suspicions.is_empty() && r.left_out.is_empty(), "{}", r.to_json());
}

/// Asserts that the truth is within twice the interval.
fn near(r: &ReconciliationResult, name: &str, value: usize, truth: f64) {
    let (f, half) = r.effects.iter().find(|(f, _)| f.effect.name() == name).unwrap();
    let found = f.effect.values()[value];
    assert!((found - truth).abs() < 2.0 * half[value], "{name}: {found} ± {}, true {truth}", half[value]);
}

#[test]
fn a_bar_off_its_centre_is_the_set_up_s() {
    if !test_needs::long() {
        return;
    }
    let Some(r) = shop("01", &["bb"], &["bb-other-setup"]) else { return };
    quiet(&r);
    let centre = |n: &str| r.set_up[0].terms.iter().find(|t| t.0 == n).unwrap().1;
    assert!((centre("centre_um.0") - 12.0).abs() < 0.5 && (centre("centre_um.1") + 7.0).abs() < 0.5);
    assert_eq!(r.confirmed, Some(true));
}

#[test]
fn a_circle_elsewhere_is_no_map() {
    if !test_needs::long() {
        return;
    }
    for circle in ["bb", "bb-with-positions"] {
        let Some(r) = shop("03", &["lin-x", circle], &[]) else { return };
        quiet(&r);
    }
}

#[test]
fn a_spike_is_found_beside_a_line_with_over_travel() {
    if !test_needs::long() {
        return;
    }
    let Some(r) = shop("02", &["lin-y", "bb-u", "bb-d"], &[]) else { return };
    assert_eq!(names(&r), ["reversal_spike.y"], "{}", r.to_json());
    near(&r, "reversal_spike.y", 0, 3.0);
    near(&r, "reversal_spike.y", 1, 1.2);
}

#[test]
fn a_jump_in_a_pause_is_no_lost_count() {
    let Some(r) = shop("07", &["lin-x"], &[]) else { return };
    quiet(&r);
    let jump = r.set_up[0].terms.iter().find(|t| t.0 == "jump_um").unwrap();
    assert!((jump.1 - 2.5).abs() < 2.0 * jump.2, "{jump:?}");
}

#[test]
fn the_begin_of_a_circle_is_no_warm_up() {
    if !test_needs::long() {
        return;
    }
    let Some(r) = shop("08", &["bb-xy"], &["bb-xy-later"]) else { return };
    assert!(r.effects.is_empty() && r.suspicions.is_empty(), "{}", r.to_json());
}

#[test]
fn a_wave_that_grows_is_one_wave() {
    if !test_needs::long() {
        return;
    }
    for case in ["09", "10"] {
        let Some(r) = shop(case, &["lin-x"], &["lin-x-later"]) else { return };
        for (f, _) in &r.effects {
            assert!(f.effect.name().starts_with("screw_"), "{}", r.to_json());
            assert!((f.effect.scalar(0) - 10.0).abs() < 0.1, "{}", r.to_json());
        }
        assert!(r.confirmed == Some(true) && r.gap[0].closed() > Some(0.7), "{}", r.to_json());
    }
}

/// A resonance of the spindle's speed, which no law has, is not named.
/// Any correction in its place is not confirmed.
#[test]
fn a_resonance_is_not_confirmed_as_a_law() {
    if !test_needs::long() {
        return;
    }
    let Some(r) = shop("11", &["drift", "drift2"], &["shift"]) else { return };
    assert!(r.verdict == Verdict::UnknownEffect || r.confirmed == Some(false), "{}", r.to_json());
}

#[test]
fn sensors_that_are_as_likely_are_not_named() {
    let Some(r) = shop("12", &["lin-x"], &["lin-x-later"]) else { return };
    assert_eq!((r.verdict, names(&r)[0].as_str()), (Verdict::NotSeparable, "thermal_expansion.x"));
    assert!(r.effects[0].0.rivals.len() > 1 && r.suspicions.is_empty(), "{}", r.to_json());
}

#[test]
fn a_right_line_is_not_thrown_out() {
    if !test_needs::long() {
        return;
    }
    let circles = ["lin-x", "lin-y", "bb-xy-250", "bb-xy-1250", "bb-xy-2500"];
    let Some(r) = shop("13", &circles, &["lin-x-later", "lin-y-later", "bb-later"]) else { return };
    assert!(r.suspicions.is_empty() && r.left_out.is_empty(), "{}", r.to_json());
    let mut found = names(&r);
    found.sort();
    let squareness = found.iter().position(|n| n.starts_with("squareness.")).unwrap();
    found.remove(squareness);
    assert_eq!(found, ["reversal.x", "reversal.y", "reversal_spike.x", "scale.y"]);
    near(&r, "reversal_spike.x", 0, 1.5);
}

#[test]
fn mistakes_in_angle_bar_and_axis_are_said() {
    if !test_needs::long() {
        return;
    }
    let cases = [
        ("14", ["m6", "lin-x", "lin-y"], MistakeKind::Direction),
        ("14", ["m4", "lin-x", "lin-y"], MistakeKind::Unit),
        ("15", ["m10", "lin-x", "bb-xy"], MistakeKind::Swapped),
    ];
    for (case, train, what) in cases {
        let Some(r) = shop(case, &train, &[]) else { return };
        let bad = format!("{}.run.toml", train[0]);
        assert!(r.suspicions.iter().any(|s| s.what == what), "{}", r.to_json());
        assert!(r.suspicions.iter().all(|s| s.record.ends_with(&bad)), "{}", r.to_json());
        assert!(r.effects.is_empty() && r.refined.is_empty(), "{}", r.to_json());
    }
}

/// At eight even angles three lobes look like five, so neither is named.
#[test]
fn lobes_that_look_alike_are_not_separable() {
    let Some(r) = answer("", "empty.machine.toml", &["ring8"], &[]) else { return };
    assert_eq!(r.verdict, Verdict::NotSeparable, "{}", r.to_json());
    let (f, half) = &r.effects[0];
    let others = f.rivals.iter().filter_map(|v| Some(v.differs.as_ref()?.1));
    let lobes: Vec<f64> = others.chain([f.effect.value("lobes").unwrap()[0]]).collect();
    assert!([3.0, 5.0].iter().all(|n| lobes.contains(n)), "{lobes:?}");
    assert!(half.iter().any(|h| *h > 0.0));
}

#[test]
fn a_reversal_read_on_a_coarse_dial_keeps_its_interval() {
    let Some(r) = answer("", "empty.machine.toml", &["dial10"], &[]) else { return };
    let (f, half) = &r.effects[0];
    assert_eq!(f.effect.name(), "reversal.x");
    assert!((f.effect.scalar(0) - 6.0).abs() < half[0], "{} ± {}", f.effect.scalar(0), half[0]);
}
