//! Prints the simulation's speed: `cargo bench -p rtec-sim --bench sim_speed`.

use rtec_model::machine::Machine;
use rtec_sim::corrected_machine_sim::{CorrectedMachineSim, MachineSpec};
use rtec_sim::nc_block::Block;
use std::path::Path;
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let text =
        "name = \"m\"\n[[effect]]\nname = \"scale.x\"\nppm = 50\n[[effect]]\nname = \"scale.y\"\nppm = -80\n";
    let model = Machine::parse(Path::new("speed.toml"), text)?;
    let mut spec = MachineSpec::machining_centre();
    spec.axes.truncate(2);
    let mut sim = CorrectedMachineSim::new(&spec, &model, Some(&model), [-250.0, -250.0, 0.0], 1)?;
    // Both axes at 10 m/min at once.
    let to_and_fro = [250.0, -250.0].map(|at| Block::Rapid { to: [at, at, 0.0] });
    sim.machine.load([to_and_fro; 10].concat());
    let start = Instant::now();
    sim.finish()?;
    let wall_s = start.elapsed().as_secs_f64();
    let simulated_s = sim.machine.now_ns() as f64 * 1e-9;
    println!(
        "closed loop, two axes, 1 µm counts, 10 m/min, engine and corrector included: {simulated_s:.1} s in {wall_s:.3} s, \
         {:.0} × real time, {:.0} ns an edge, {} edges, {} insertions",
        simulated_s / wall_s,
        wall_s * 1e9 / sim.machine.edges() as f64,
        sim.machine.edges(),
        sim.status().axes().iter().map(|a| a.insertions).sum::<u64>()
    );
    Ok(())
}
