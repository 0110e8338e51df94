//! Evaluates one machine model over the rows of a run, and at one instant.
use rtec_model::live_evaluation::{AxisMotionState, LiveModel, MachineState, MachineStateLayout};
use rtec_model::machine::Machine;
use rtec_model::record::{Axis, Column, Record, Role, RunKind};
use std::path::Path;

const MODEL: &str = "name = \"lathe\"
[[effect]]\nname = \"scale.z\"\nppm = 12.0
[[effect]]\nname = \"thermal_growth.z\"\nsensor = \"T8\"\nminus = \"T18\"\num_per_K = 1.5\n";

#[cfg_attr(test, test)]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let model = Machine::parse(Path::new("machine.toml"), MODEL)?;
    let z = Axis::new("z").ok_or("z is an axis")?;
    let warm = Column::new("T8", Role::Temperature, vec![20.0, 28.0]);
    let cold = Column::new("T18", Role::Temperature, vec![20.0, 20.0]);
    let place = Column::new("z", Role::Position(z.clone()), vec![100.0, 500.0]);
    let error = Column::new("ez", Role::Error(z.clone()), vec![1.3, 17.8]);
    let run = Record::new(Path::new("run.run.toml"), RunKind::Drift, vec![warm, cold, place, error])?;
    println!("z over the run, µm: {:?}", model.predict(&run)?.columns[0].1); // 1.2, then 6 + 12

    let sensors = vec!["T8".to_owned(), "T18".to_owned()]; // the order of the temperatures below
    let mut live =
        LiveModel::of(&model, MachineStateLayout { axes: vec![z], sensors, channels: Vec::new() })?;
    let axes = [AxisMotionState::moving(500.0, 20.0)];
    live.evaluate(&MachineState { axes: &axes, temperatures_degc: &[28.0, 20.0], ..MachineState::default() });
    assert!((live.errors_um()[0] - 18.0).abs() < 1e-9);
    Ok(())
}
