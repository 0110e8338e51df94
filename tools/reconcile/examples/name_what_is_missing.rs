//! Names the effect that a model lacks: backlash is found and added.
use rtec_model::machine::Machine;
use rtec_model::record::{Axis, Column, Record, Role, RunKind};
use rtec_reconcile::{ReconciliationOptions, reconcile};
use std::path::Path;

#[cfg_attr(test, test)]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let text = "name = \"mill\"\n[[effect]]\nname = \"scale.y\"\nppm = 12.0\n";
    let model = Machine::parse(Path::new("machine.toml"), text)?;
    // Ten strokes up and ten down, a reading every 20 mm.
    let steps = || (0..420).map(|n| (n % 21, n / 21 % 2 == 0));
    let place_mm = |(k, up): (i32, bool)| 20.0 * f64::from(if up { k } else { 20 - k });
    let direction = |(_, up)| if up { 1.0 } else { -1.0 };
    let noise = |n: usize| 0.4 * ((n * n) as f64 * 0.7).sin();
    let error = |(n, step)| 0.012 * place_mm(step) + 3.0 * direction(step) + noise(n); // 6 µm, up less down
    let y = Axis::new("y").ok_or("y is an axis")?;
    let columns = vec![
        Column::new("y", Role::Position(y.clone()), steps().map(place_mm).collect()),
        Column::new("dir", Role::Direction(y.clone()), steps().map(direction).collect()),
        Column::new("e", Role::Error(y), steps().enumerate().map(error).collect()),
    ];
    let run = Record::new(Path::new("y_axis.run.toml"), RunKind::Positioning, columns)?;
    let answer = reconcile(&[run], &[], &model, &ReconciliationOptions::default())?;
    println!("{:#}\n{}", answer.to_json(), answer.model.to_text());
    assert!(answer.model.effects().any(|e| e.name() == "reversal.y"));
    Ok(())
}
