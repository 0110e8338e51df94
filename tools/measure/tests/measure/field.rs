//! Records as people have them: each stands for a kind that was evaluated wrongly once.

use rtec_files::Said;
use rtec_measure::evaluation::{Asked, Evaluation, Standard, evaluate_files};
use rtec_measure::export::Wanted;
use rtec_measure::export::linuxcnc::Unit;
use rtec_measure::export::order::{Name, Order};
use rtec_measure::import;
use rtec_model::machine::Machine;
use rtec_model::record::Axis;
use std::path::{Path, PathBuf};

fn field(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/field").join(name)
}

fn evaluated(name: &str, standard: Standard) -> (Evaluation, Vec<String>) {
    let (asked, mut said) = (Asked { standard: Some(standard), ..Asked::default() }, Vec::new());
    let found = evaluate_files(&[field(name)], &asked, &mut |s: Said| said.push(s.to_string())).unwrap();
    (found, said)
}

#[test]
fn creep_of_a_probe_is_not_its_repeatability() {
    let (found, said) = evaluated("creeping-probe.run.toml", Standard::Repeatability);
    let z = &found.document["z"];
    assert!((z["s_um"].as_f64().unwrap() - 9.88).abs() < 0.01, "{z}");
    assert!((z["trend_um_per_return"].as_f64().unwrap() + 1.1).abs() < 0.05, "{z}");
    assert!((z["s_about_trend_um"].as_f64().unwrap() - 0.65).abs() < 0.1, "{z}");
    assert!(said.iter().any(|s| s.contains("the returns drift by")), "{said:?}");
}

#[test]
fn power_on_readings_are_in_no_figure() {
    let (found, said) = evaluated("power-on-85.run.toml", Standard::Iso230_3);
    assert!(said.iter().any(|s| s.contains("power-on value")), "{said:?}");
    let sensor = &found.document["temperatures"]["T1"];
    assert!((sensor["range_K"].as_f64().unwrap() - 7.74).abs() < 0.01, "{sensor}");
    assert!((sensor["end_K"].as_f64().unwrap() - 7.7).abs() < 0.05, "{sensor}");
    assert!(sensor["gamma"].as_f64().unwrap() > 0.98, "{sensor}");
}

#[test]
fn a_clock_of_unix_times_is_said() {
    let (_, said) = evaluated("epoch.run.toml", Standard::Iso230_3);
    assert!(
        said.iter().any(|s| s.contains("t begins at 1767700000: Unix time in s (2026-01-06)")),
        "{said:?}"
    );
}

#[test]
fn angular_targets_are_refused_by_their_file_type() {
    let file = field("angular-table.rta");
    let text = import::any_text(&file, &std::fs::read(&file).unwrap()).unwrap();
    let error = import::rtl(&file, &text, &Axis::new("x").unwrap(), Path::new("to.run.toml")).unwrap_err();
    assert_eq!((error.line, error.found.as_str()), (2, "File type `rta` (angular targets, in degrees)"));
}

#[test]
fn a_table_leaves_what_stays_when_it_is_applied() {
    let machine = Machine::read(&field("inch-backlash.machine.toml")).unwrap();
    let order = Order {
        axis: "x".to_owned(),
        wanted: Wanted { from_mm: -254.0, to_mm: 0.0, step_mm: None, limit_um: 0.5, most: None },
        temperatures_degc: Vec::new(),
        at_mm: Vec::new(),
        format: Name::Linuxcnc,
        unit: Unit::Inch,
        axis_name: None,
        encoder: 0,
        reference_mm: None,
        axis_number: None,
        form: None,
    };
    let exported = order.of(&machine).unwrap();
    let left = exported.document["max_up_um"].as_f64().unwrap();
    assert!((left - 4.08).abs() < 0.05, "{left}");
    assert!(
        exported.warnings.iter().any(|w| w.contains("moves the drive by up to")),
        "{:?}",
        exported.warnings
    );
}

#[test]
fn steps_of_a_dial_are_said_beside_its_figures() {
    let (found, said) = evaluated("dial10.run.toml", Standard::Iso230_2);
    assert_eq!(found.document["resolution"]["step"], 10.0);
    // The truth is 6 µm.
    let reversal = found.document["B_mean"].as_f64().unwrap();
    assert!((reversal - 6.0).abs() < found.document["resolution"]["reversal_within"].as_f64().unwrap());
    assert!(said.iter().any(|s| s.contains("readings in steps of 10 µm")), "{said:?}");
}

#[test]
fn warming_of_an_axis_is_not_its_repeatability() {
    let (found, said) = evaluated("warming-axis.run.toml", Standard::Iso230_2);
    let (with, about) = (&found.document["R"], &found.document["drift"]["R_about_drift"]);
    // 3 µm of reversal and a noise of 0.25 µm; the axis grows by 8 µm an hour and more.
    let (with, about) = (with.as_f64().unwrap(), about.as_f64().unwrap());
    assert!(with > 8.0 && about > 3.5 && about < 5.0, "{with} {about}");
    assert!(said.iter().any(|s| s.contains("the approaches drift by")), "{said:?}");
}
