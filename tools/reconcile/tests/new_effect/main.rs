//! A new effect needs only its file and its line in a list.
//! It is then found in records and evaluated, live and over a record, like any other.

#![allow(clippy::unwrap_used)] // helpers of tests count as tests

use rtec_model::effect::{Dictionary, Effect, Law};
use rtec_model::live_evaluation::{AxisMotionState, LiveModel, MachineState, MachineStateLayout};
use rtec_model::machine::Machine;
use rtec_model::record::{Axis, Column, Record, Role, RunKind};
use rtec_reconcile::{ReconciliationOptions, ReconciliationResult, reconcile};
use std::path::Path;
use std::sync::Arc;

/// A new effect, with parameters that a run of [`run`] shows well.
struct Sample {
    law: Arc<dyn Law>,
    name: &'static str,
    values: &'static [f64],
}

macro_rules! effects {
    ($($effect:ident,)*) => {
        $(mod $effect;)*

        fn effects() -> Vec<Sample> {
            vec![$($effect::sample()),*]
        }
    };
}

effects! {
    sag,
    twist,
}

fn axis(name: &str) -> Axis {
    Axis::new(name).unwrap()
}

/// A run up and down two axes, the error of x still zero.
fn run() -> Record {
    let column = |name: &str, role: Role, of: &dyn Fn(f64) -> f64| {
        let data = (0..600).map(|i| of(f64::from(i))).collect();
        Column { name: name.to_owned(), unit: role.unit().unwrap().to_owned(), role, data }
    };
    let columns = vec![
        column("t", Role::Time, &|i| 2.0 * i),
        column("x", Role::Position(axis("x")), &|i| 250.0 + 250.0 * (i / 11.0).sin()),
        column("z", Role::Position(axis("z")), &|i| 200.0 + 200.0 * (i / 37.0).cos()),
        column("e", Role::Error(axis("x")), &|_| 0.0),
    ];
    Record::new(Path::new("run.run.toml"), RunKind::Positioning, columns).unwrap()
}

/// The run of a machine with one effect, with noise of 0.5 µm.
fn shown(effect: &Effect) -> Record {
    let mut record = run();
    let mut error = vec![0.0; record.rows()];
    effect.add(&record, &Role::Error(axis("x")), &mut error).unwrap();
    let mut state = 88_172_645_463_325_252_u64;
    for e in &mut error {
        let mut sum = -6.0;
        for _ in 0..12 {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            sum += state as f64 / u64::MAX as f64;
        }
        *e += 0.5 * sum;
    }
    record.columns.last_mut().unwrap().data = error;
    record
}

fn reconciled(effect: &Effect, machine: &Machine) -> ReconciliationResult {
    reconcile(&[shown(effect)], &[], machine, &ReconciliationOptions::default()).unwrap()
}

/// Live evaluation gives the values of the record at every row.
fn live_is_the_record(effect: &Effect) {
    let record = run();
    let mut sum = vec![0.0; record.rows()];
    effect.add(&record, &Role::Error(axis("x")), &mut sum).unwrap();
    let layout = MachineStateLayout { axes: vec![axis("x"), axis("z")], ..MachineStateLayout::default() };
    let mut live = LiveModel::new([effect], layout).unwrap();
    for (row, want) in sum.iter().enumerate() {
        let at = |n: usize| AxisMotionState {
            position_mm: record.columns[n].data[row],
            ..AxisMotionState::default()
        };
        live.evaluate(&MachineState {
            t_s: record.time_s()[row],
            axes: &[at(1), at(2)],
            ..MachineState::default()
        });
        assert!((live.errors_um()[0] - want).abs() < 1e-12, "row {row}");
    }
    assert!(sum.iter().any(|e| e.abs() > 1.0));
}

#[test]
fn an_effect_of_a_new_file_is_evaluated_live_found_and_written() {
    for sample in effects() {
        let mut dictionary = Dictionary::default();
        dictionary.insert(Arc::clone(&sample.law)).unwrap();
        let mut effect = dictionary.effect(sample.name).unwrap();
        effect.set_values(sample.values).unwrap();
        live_is_the_record(&effect);
        let path = Path::new("m.toml");
        let machine = Machine::parse_with(path, "name = \"m\"\n", dictionary.clone()).unwrap();
        let answer = reconciled(&effect, &machine);
        let names: Vec<String> = answer.effects.iter().map(|(f, _)| f.effect.name()).collect();
        assert_eq!(names, [sample.name]);
        for (got, want) in answer.effects[0].0.effect.values().iter().zip(sample.values) {
            assert!((got - want).abs() < 0.05 * want.abs(), "{}: {got}, not {want}", sample.name);
        }
        let again = Machine::parse_with(path, &answer.model.to_text(), dictionary).unwrap();
        assert_eq!(again.effects().count(), 1);
    }
}

/// The same holds for a law that a project gives in a file instead of code.
#[test]
fn an_effect_of_a_projects_own_file_is_evaluated_live_and_found() {
    let dir = tempfile::tempdir().unwrap();
    let law = "[[law]]\nname = \"quill_droop\"\nnaming = \"A.B\"\nlaw = \"e = um·(p_B/100)²\"\ncause = \"weight\"\n\
               experiment = \"straightedge\"\nparameters = [{ name = \"um\", unit = \"um\", plausible = 50.0, \
               terms = [{ factor = 1e-4, p_B = 2 }] }]\n";
    std::fs::write(dir.path().join("own.toml"), law).unwrap();
    let text = "name = \"m\"\ndictionary = \"own.toml\"\n";
    let machine = Machine::parse(&dir.path().join("m.toml"), text).unwrap();
    let mut effect = machine.dictionary().effect("quill_droop.x.z").unwrap();
    effect.set("um", &[0.8]).unwrap();
    live_is_the_record(&effect);
    let answer = reconciled(&effect, &machine);
    let names: Vec<String> = answer.effects.iter().map(|(f, _)| f.effect.name()).collect();
    assert_eq!(names, ["quill_droop.x.z"]);
    assert!((answer.effects[0].0.effect.scalar(0) - 0.8).abs() < 0.02);
}
