//! Which of three sensors does a spindle's growth follow, and with what lag?
use rtec_fit::thermal::{self, ThermalFitOptions};
use rtec_model::record::{Axis, Column, Record, Role, RunKind};
use std::path::Path;

#[cfg_attr(test, test)]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let minutes = || (0..600).map(f64::from);
    let heat_k = |t: f64| 8.0 * (1.0 - (-t / 90.0).exp()) * (1.0 + 0.5 * (t / 70.0).sin());
    let wobble = |t: f64, k: f64| 0.02 * (k * t * t).sin(); // in place of noise
    let (mut deep_k, gain) = (0.0, 1.0 - (-1.0_f64 / 30.0).exp()); // 30 min behind
    let growth = minutes().map(|t| {
        deep_k += (heat_k(t) - deep_k) * gain;
        1.7 * deep_k + wobble(t, 0.9)
    });
    let z = Role::Error(Axis::new("z").ok_or("z is an axis")?);
    let time_s = minutes().map(|t| 60.0 * t).collect();
    let mut columns = vec![Column::new("t", Role::Time, time_s), Column::new("ez", z, growth.collect())];
    for (name, share, k) in [("bearing", 1.0, 0.3), ("column", 0.1, 0.5), ("air", 0.0, 0.7)] {
        let degc = minutes().map(|t| 20.0 + share * heat_k(t) + wobble(t, k)).collect();
        columns.push(Column::new(name, Role::Temperature, degc));
    }
    let run = Record::new(Path::new("warm_up.run.toml"), RunKind::Drift, columns)?;
    let (_, reports) = thermal::fit(&[&run], &[], &ThermalFitOptions::default())?;
    println!("{:#?}", reports[0].effects);
    assert_eq!(reports[0].effects[1].sensor.as_deref(), Some("bearing"));
    Ok(())
}
