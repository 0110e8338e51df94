//! An axis measured from both sides, evaluated as ISO 230-2 has it.
use rtec_measure::iso230::positioning;
use rtec_model::record::{Axis, Column, Record, Role, RunKind};
use std::path::Path;

#[cfg_attr(test, test)]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let y = Axis::new("y").ok_or("y is an axis")?;
    let (mut at, mut side, mut error, mut repeat) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for cycle in 1..=5 {
        for dir in [1.0, -1.0] {
            for target in [0.0, 100.0, 200.0, 300.0, 400.0] {
                at.push(target);
                side.push(dir);
                repeat.push(f64::from(cycle));
                error.push(0.02 * target + 3.0 * dir); // 20 ppm, and a reversal of 6 µm
            }
        }
    }
    let columns = vec![
        Column::new("n", Role::Cycle, repeat),
        Column::new("y", Role::Position(y.clone()), at),
        Column::new("dir", Role::Direction(y.clone()), side),
        Column::new("e", Role::Error(y), error),
    ];
    let run = Record::new(Path::new("y.run.toml"), RunKind::Positioning, columns)?;
    let figures = &positioning(&run)?[0];
    println!("B {:?} µm, E {:?} µm, A {:?} µm", figures.B, figures.E, figures.A);
    assert!((figures.B.ok_or("no reversal")?.abs() - 6.0).abs() < 1e-9);
    assert!((figures.E.ok_or("no systematic deviation")? - 14.0).abs() < 1e-9); // 8 along the axis, and the reversal
    Ok(())
}
