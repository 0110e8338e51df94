//! A drift is analysed by `model fit` and by the reconciliation.
//! They must choose the same sensors with overlapping intervals, or give a reason. Machines, heat and noise
//! are made here, by formulas.

#![allow(clippy::unwrap_used)] // a test's own helpers

use rtec_fit::thermal;
use rtec_model::machine::Machine;
use rtec_model::record::{Axis, Column, Record, Role, RunKind};
use rtec_reconcile::{ReconciliationOptions, reconcile};
use std::path::Path;
use test_needs::dice::Dice;

/// The parts of a simulated drift.
struct Plan {
    seed: u64,
    rows: usize,
    step_s: f64,
    /// Bodies: how warm they get, K, and how fast, s.
    bodies: &'static [(f64, f64)],
    /// Growth by the first body's difference to the air: µm/K, µm/K², and its lag, s.
    um_per_k: f64,
    um_per_k2: f64,
    tau_s: f64,
    noise_um: f64,
    memory: f64,
}

const PLANS: [Plan; 5] = [
    Plan {
        seed: 1,
        rows: 240,
        step_s: 120.0,
        bodies: &[(12.0, 900.0), (7.0, 3000.0), (4.0, 9000.0)],
        um_per_k: 3.0,
        um_per_k2: 0.0,
        tau_s: 0.0,
        noise_um: 0.3,
        memory: 0.3,
    },
    Plan {
        seed: 2,
        rows: 300,
        step_s: 60.0,
        bodies: &[(10.0, 700.0), (9.0, 900.0), (8.0, 1200.0), (3.0, 6000.0)],
        um_per_k: 2.0,
        um_per_k2: 0.0,
        tau_s: 1500.0,
        noise_um: 0.4,
        memory: 0.5,
    },
    Plan {
        seed: 3,
        rows: 400,
        step_s: 60.0,
        bodies: &[(14.0, 1500.0), (13.0, 1600.0), (6.0, 5000.0), (2.0, 15000.0), (5.0, 2500.0)],
        um_per_k: -4.0,
        um_per_k2: 0.05,
        tau_s: 0.0,
        noise_um: 0.5,
        memory: 0.6,
    },
    Plan {
        seed: 4,
        rows: 180,
        step_s: 180.0,
        bodies: &[(9.0, 1000.0), (5.0, 1100.0)],
        um_per_k: 1.2,
        um_per_k2: 0.0,
        tau_s: 900.0,
        noise_um: 0.5,
        memory: 0.0,
    },
    Plan {
        seed: 5,
        rows: 500,
        step_s: 60.0,
        bodies: &[(11.0, 800.0), (6.0, 2500.0), (6.0, 2600.0), (4.0, 8000.0), (3.0, 12000.0), (5.0, 1800.0)],
        um_per_k: 5.0,
        um_per_k2: 0.0,
        tau_s: 2400.0,
        noise_um: 0.6,
        memory: 0.7,
    },
];

impl Plan {
    fn record(&self) -> Record {
        let mut d = Dice::new(70_000 + self.seed);
        let (n, h) = (self.rows, self.step_s);
        let mut state = vec![0.0; self.bodies.len()];
        let (mut speed, mut late, mut before, mut noise) = (0.0, 0.0, 0.0, 0.0);
        let mut warm: Vec<Vec<f64>> = vec![Vec::new(); self.bodies.len() + 1];
        let (mut time, mut error) = (Vec::new(), Vec::new());
        let phase: Vec<f64> = (0..=self.bodies.len()).map(|_| 6.0 * d.unit()).collect();
        for i in 0..n {
            if i % 25 == 0 {
                speed = if d.unit() < 0.3 { 0.0 } else { 0.2 + 0.8 * d.unit() };
            }
            let t = i as f64 * h;
            let air = 20.0 + 0.7 * (t / 8000.0 + phase[0]).sin();
            let mut first = 0.0;
            for (b, (gain, tau)) in self.bodies.iter().enumerate() {
                state[b] += (gain * speed - state[b]) * (1.0 - (-h / tau).exp());
                let own = 0.4 * (t / (2000.0 + 800.0 * b as f64) + phase[b + 1]).sin();
                let degc = air + state[b] + own;
                if b == 0 {
                    first = degc - air;
                }
                warm[b].push(degc + 0.01 * d.normal());
            }
            warm[self.bodies.len()].push(air + 0.01 * d.normal());
            // The lag's response to a straight line between two rows.
            if i == 0 || self.tau_s == 0.0 {
                late = first;
            } else {
                let slope = (first - before) / h;
                late = first - slope * self.tau_s
                    + (late - before + slope * self.tau_s) * (-h / self.tau_s).exp();
            }
            before = first;
            noise = self.memory * noise + (1.0 - self.memory * self.memory).sqrt() * d.normal();
            time.push(t);
            error.push(7.0 + self.um_per_k * late + self.um_per_k2 * late * late + self.noise_um * noise);
        }
        let mut columns = vec![Column::new("t", Role::Time, time)];
        for (b, data) in warm.into_iter().enumerate() {
            let name = if b == self.bodies.len() { "air".to_owned() } else { format!("T{}", b + 1) };
            columns.push(Column::new(&name, Role::Temperature, data));
        }
        columns.push(Column::new("e", Role::Error(Axis::new("z").unwrap()), error));
        Record::new(Path::new(&format!("drift{}.run.toml", self.seed)), RunKind::Drift, columns).unwrap()
    }
}

/// A law of growth: its temperature difference, then each parameter's interval.
type Law = (String, Vec<(String, [f64; 3])>);

fn by_fit(record: &Record) -> (Vec<Law>, Vec<String>) {
    let (_, reports) = thermal::fit(&[record], &[], &thermal::ThermalFitOptions::default()).unwrap();
    let of = |e: &thermal::FittedEffect| {
        let sensor = e.sensor.clone()?;
        let values = e.parameters.iter().map(|(k, p)| (k.clone(), [p.value, p.low, p.high])).collect();
        Some((format!("{sensor}-{}", e.minus.clone().unwrap_or("20".into())), values))
    };
    let laws = reports[0].effects.iter().filter_map(of).collect();
    (laws, reports[0].warnings.clone())
}

fn by_reconciliation(record: &Record) -> (Vec<Law>, String) {
    let r =
        reconcile(std::slice::from_ref(record), &[], &Machine::ideal("m"), &ReconciliationOptions::default())
            .unwrap();
    let json = r.to_json();
    let mut laws = Vec::new();
    for e in json["effects"].as_array().unwrap() {
        let Some(sensor) = e["sensor"].as_str() else { continue };
        let parameters = e["parameters"].as_object().unwrap();
        let get = |v: &serde_json::Value, k: &str| v[k].as_f64().unwrap();
        let values = parameters
            .iter()
            .map(|(k, v)| (k.clone(), [get(v, "value"), get(v, "low"), get(v, "high")]))
            .collect();
        laws.push((format!("{sensor}-{}", e["minus"].as_str().unwrap_or("20")), values));
    }
    (laws, format!("{} {}", json["verdict"], json["advice"]))
}

/// Whether both read the same temperatures and their intervals overlap.
/// Otherwise both must say why not.
fn agree(record: &Record) -> bool {
    let (fit, warnings) = by_fit(record);
    let (found, said) = by_reconciliation(record);
    let names = |laws: &[Law]| {
        let mut names: Vec<String> = laws.iter().map(|l| l.0.clone()).collect();
        names.sort();
        names
    };
    println!("{}\n  fit {fit:?}\n  {warnings:?}\n  reconcile {found:?}\n  {said}", record.file);
    if names(&fit) != names(&found) {
        assert!(said.contains("model fit"), "{}: no word of another choice: {said}", record.file);
        assert!(!warnings.is_empty(), "{}: the fit knows of no other choice", record.file);
        return false;
    }
    assert!(!said.contains("model fit"), "{said}");
    for ((name, a), (_, b)) in fit.iter().zip(&found) {
        for (key, [_, low, high]) in a {
            // A lag of zero has no interval on the other side.
            let Some((_, [_, other_low, other_high])) = b.iter().find(|(k, _)| k == key) else { continue };
            let overlap = low <= other_high && other_low <= high;
            assert!(overlap, "{}: {name} {key}: {low} to {high}, {other_low} to {other_high}", record.file);
        }
    }
    true
}

/// The formula's own difference is chosen, unless a reason for another is given.
#[test]
fn one_drift_is_one_law_or_both_say_why_not() {
    if !test_needs::long() {
        return;
    }
    let mut alike = 0;
    for plan in &PLANS {
        let record = plan.record();
        if !agree(&record) {
            continue;
        }
        alike += 1;
        let (laws, _) = by_fit(&record);
        assert_eq!(laws.len(), 1);
        assert_eq!(laws[0].0, "T1-air", "the body and the air that the formula has");
        let [_, low, high] = laws[0].1.iter().find(|(k, _)| k == "um_per_K").unwrap().1;
        assert!(low <= plan.um_per_k && plan.um_per_k <= high, "{}: {low} to {high}", record.file);
    }
    assert!(alike >= 4, "{alike} of five have one choice");
}

/// A real spindle's warm-up, every eighth minute.
/// The data is in `../shared/data`, outside the project.
#[test]
fn a_real_spindle_has_one_choice_or_both_say_why_not() {
    if !test_needs::long() {
        return;
    }
    let Some(path) = test_needs::shared("data/spindle_thermal/first_half.csv") else { return };
    let text = std::fs::read_to_string(&path).unwrap();
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    let mut data: Vec<Vec<f64>> = vec![Vec::new(); names.len()];
    for line in lines.step_by(8) {
        data.iter_mut().zip(line.split(',')).for_each(|(d, v)| d.push(v.parse().unwrap()));
    }
    for minute in &mut data[0] {
        *minute *= 60.0;
    }
    let role = |name: &str| match name {
        "minute" => Role::Time,
        "growth_um" => Role::Error(Axis::new("z").unwrap()),
        _ => Role::Temperature,
    };
    let columns = names.iter().zip(data).map(|(n, v)| Column::new(n, role(n), v)).collect();
    let record = Record::new(Path::new("spindle.run.toml"), RunKind::Drift, columns).unwrap();
    agree(&record);
}
