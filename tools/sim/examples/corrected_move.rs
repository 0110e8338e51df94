//! One move on the same simulated machine, uncorrected and corrected.
use rtec_model::machine::Machine;
use rtec_sim::corrected_machine_sim::{CorrectedMachineSim, MachineSpec};
use rtec_sim::nc_block::Block;
use std::path::Path;

#[cfg_attr(test, test)]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let truth = "name = \"mill\"
[[effect]]\nname = \"scale.x\"\nppm = 100.0
[[effect]]\nname = \"reversal.x\"\num = 6.0\n";
    let truth = Machine::parse(Path::new("machine.toml"), truth)?;
    let off_um = |known: Option<&Machine>| -> Result<f64, Box<dyn std::error::Error>> {
        let mut sim = CorrectedMachineSim::new(&MachineSpec::machining_centre(), &truth, known, [0.0; 3], 1)?;
        let to = [150.0, 0.0, 0.0];
        sim.run([Block::Feed { to, feed_mm_s: 100.0 }, Block::Dwell { seconds: 2.0 }])?;
        Ok(sim.moment().off_um(0))
    };
    let (alone, corrected) = (off_um(None)?, off_um(Some(&truth))?);
    println!("X150: {alone:.1} µm off, corrected {corrected:.1} µm");
    assert!((alone - 18.0).abs() < 0.2 && corrected.abs() <= 2.0); // two counts are one insertion
    Ok(())
}
