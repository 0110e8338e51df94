//! Records of gauges that read in coarse steps.
//! The intervals include the steps, and a message reports them.

use rtec_fit::linear_least_squares::fit_named;
use rtec_fit::thermal;
use rtec_model::effect::TemperatureDifference;
use rtec_model::machine::Machine;
use rtec_model::record::{Column, Record, Role, RunKind};
use std::path::Path;
use test_needs::dice::Dice;

/// Five times both ways over nine targets.
/// The error is a constant and a reversal, read in steps.
fn run(offset: f64, reversal: f64, step: f64, wobble: f64) -> Record {
    let (mut p, mut dir, mut e) = (vec![], vec![], vec![]);
    for n in 0..10_u32 {
        let way = if n % 2 == 0 { 1.0 } else { -1.0 };
        for k in 0..9_u32 {
            let noise = wobble * (f64::from(7 * n + 3 * k) * 1.7).sin();
            p.push(50.0 * f64::from(if way > 0.0 { k } else { 8 - k }));
            dir.push(way);
            e.push(((offset + reversal * way / 2.0 + noise) / step).round() * step);
        }
    }
    let columns =
        vec![column("x", "position.x", p), column("d", "direction.x", dir), column("e", "error.x", e)];
    Record::new(Path::new("x.run.toml"), RunKind::Positioning, columns).expect("a record")
}

#[test]
fn intervals_hold_the_truth_at_every_step() {
    let base = Machine::parse(Path::new("m.toml"), "name = \"m\"\neffect = []\n").expect("a machine");
    for step in [10.0, 5.0, 2.0] {
        let mut held = 0;
        for n in 0..25_u32 {
            let (offset, truth) = (0.37 * f64::from(n), 2.0 + 0.4 * f64::from(n));
            let record = run(offset, truth, step, 0.4);
            let Ok((_, report)) = fit_named(&base, &["reversal.x".to_owned()], &[&record], "2026-01-01", 30)
            else {
                assert!(record.columns[2].data.iter().all(|e| e - record.columns[2].data[0] == 0.0));
                held += 1; // nothing is claimed of what is below a step
                continue;
            };
            let found = report.effects[0].parameters["um"];
            held += u32::from(found.low <= truth && truth <= found.high);
            // Two readings that are two steps apart look like one step of twice the size.
            let coarse = report.warnings.iter().any(|w| w.contains("readings in steps of"));
            assert!(coarse || step < 5.0, "{step}: {:?}", report.warnings);
        }
        assert!(held >= 23, "{held} of 25 in steps of {step} µm");
    }
}

fn column(name: &str, role: &str, data: Vec<f64>) -> Column {
    Column::new(name, Role::parse(role).expect("a role"), data)
}

fn rounded(v: f64, step: f64) -> f64 {
    if step > 0.0 { (v / step).round() * step } else { v }
}

/// Five times both ways over 500 mm, read in steps of 5 µm without noise.
/// In some runs a scale changes no reading of one direction.
#[test]
fn a_scale_below_a_step_is_held() {
    let base = Machine::ideal("m");
    let names = ["scale.x", "reversal.x"].map(str::to_owned);
    let (mut held, mut flat, mut runs, mut dice) = ([0; 2], 0, 0, Dice::new(11));
    while runs < 120 {
        let [ppm, reversal] = [30.0, 6.0].map(|most| dice.between(-most, most));
        let places: Vec<f64> = (0..11_u32).map(|k| 50.0 * f64::from(k) + dice.between(0.0, 4.0)).collect();
        let (mut p, mut dir, mut e) = (vec![], vec![], vec![]);
        for n in 0..110 {
            let way = if n / 11 % 2 == 0 { 1.0 } else { -1.0 };
            let at = places[if way > 0.0 { n % 11 } else { 10 - n % 11 }];
            p.push(at);
            dir.push(way);
            e.push(rounded(0.7 + ppm * at / 1000.0 + reversal * way / 2.0 + 0.02 * dice.normal(), 5.0));
        }
        flat += usize::from(dir.iter().zip(&e).all(|(d, v)| *v - e[usize::from(*d < 0.0) * 11] == 0.0));
        let columns =
            vec![column("x", "position.x", p), column("d", "direction.x", dir), column("e", "error.x", e)];
        let record = Record::new(Path::new("x.run.toml"), RunKind::Positioning, columns).expect("a record");
        let Ok((_, report)) = fit_named(&base, &names, &[&record], "2026-01-01", 30) else { continue };
        runs += 1;
        for (held, (effect, truth)) in held.iter_mut().zip(report.effects.iter().zip([ppm, reversal])) {
            let found = effect.parameters.values().next().expect("a parameter");
            assert!(found.low < found.high, "{}: no interval", effect.name);
            *held += usize::from(found.low <= truth && truth <= found.high);
        }
    }
    println!("held {held:?} of 120, {flat} of them without a step along the axis");
    assert!(flat >= 5, "{flat} runs whose scale changes no reading");
    assert!(held.iter().all(|h| *h >= 110), "{held:?} of 120 held");
}

/// A spindle's warm-up of five hours by two sensors.
/// Their noise and their steps, K.
fn warm_up(dice: &mut Dice, lag_s: f64, noise_k: f64, step_k: f64) -> (Record, f64) {
    let (tau_s, heat_k) = (dice.between(1500.0, 4000.0), dice.between(6.0, 14.0));
    let (off_s, room_s) = (18000.0 * dice.between(0.35, 0.6), dice.between(4000.0, 9000.0));
    let um_per_k = dice.between(0.8, 4.0) * if dice.chance(0.5) { -1.0 } else { 1.0 };
    let (mut body, mut behind) = (0.0, 0.0);
    let mut data = [vec![], vec![], vec![], vec![]];
    for second in (0..=18000_u32).step_by(5) {
        let t = f64::from(second);
        if second % 60 == 0 {
            let room = 20.0 + 0.5 * (t / room_s).sin();
            data[0].push(t);
            data[1].push(rounded(room + body + noise_k * dice.normal(), step_k));
            data[2].push(rounded(room + noise_k * dice.normal(), step_k));
            data[3].push(um_per_k * behind + 0.15 * dice.normal());
        }
        body += 5.0 / tau_s * (if t < off_s { heat_k } else { 0.0 } - body);
        behind = if lag_s > 0.0 { behind + 5.0 / lag_s * (body - behind) } else { body };
    }
    let names = [("t", "time"), ("T1", "temperature"), ("T2", "temperature"), ("z", "error.z")];
    let columns = names.into_iter().zip(data).map(|((name, role), data)| column(name, role, data)).collect();
    (Record::new(Path::new("z.run.toml"), RunKind::Drift, columns).expect("a record"), um_per_k)
}

/// Noise and steps of the temperatures make no lag.
/// A true lag is found within its interval.
#[test]
fn a_coarse_or_noisy_sensor_is_no_lag() {
    if !test_needs::long() {
        return;
    }
    let options = thermal::ThermalFitOptions {
        sensors: vec![TemperatureDifference::single("T1")],
        environment: Some("T2".to_owned()),
        ..thermal::ThermalFitOptions::default()
    };
    let mut dice = Dice::new(7);
    let (mut lags_of_none, mut found, mut held, mut gains) = (0, 0, 0, 0);
    for (noise_k, step_k) in [(0.1, 0.0), (0.2, 0.0), (0.03, 0.25), (0.03, 0.5), (0.2, 0.5)] {
        for n in 0..12 {
            let lag_s = if n % 2 == 0 { 0.0 } else { 120.0 * 30_f64.powf(dice.unit()) };
            let (record, um_per_k) = warm_up(&mut dice, lag_s, noise_k, step_k);
            let (_, reports) = thermal::fit(&[&record], &[], &options).expect("a fit");
            let effect = &reports[0].effects[1];
            let holds = |name: &str, truth: f64| {
                effect.parameters.get(name).is_some_and(|p| p.low <= truth && truth <= p.high)
            };
            gains += usize::from(holds("um_per_K", um_per_k));
            let lagged = effect.parameters.contains_key("tau_s");
            lags_of_none += usize::from(lagged && lag_s == 0.0);
            found += usize::from(lagged && lag_s > 0.0);
            held += usize::from(lag_s > 0.0 && holds("tau_s", lag_s));
        }
    }
    println!("{lags_of_none} lags of none, {found} found, {held} held; {gains} gains held");
    assert!(lags_of_none <= 3, "{lags_of_none} lags of 30 runs without one");
    assert!(found >= 29 && held >= 26, "{found} lags found and {held} held, of 30");
    assert!(gains >= 53, "{gains} gains held, of 60");
}
