//! The control law, ten milliseconds at a time.
//! The scale is 100 ppm too long, and the axis moves to 400 mm.
use rtec_correct::{AxisCorrectionSettings, Corrector, RAMP_UM_S};
use rtec_model::machine::Machine;
use rtec_rt::link_messages::{CorrectorMode, CorrectorStatus};
use std::path::Path;

#[cfg_attr(test, test)]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (name, count_um) = ("x".to_owned(), 1.0);
    let x =
        AxisCorrectionSettings { name, count_um, increment_counts: 2, window_counts: 50, max_counts: 1000 };
    let mut law = Corrector::new(vec![x], RAMP_UM_S, 0.0, 0.0);
    let model = "name = \"mill\"\n[[effect]]\nname = \"scale.x\"\nppm = 100.0\n";
    law.load(Machine::parse(Path::new("machine.toml"), model)?, &|_| Vec::new())?;

    let mut status = CorrectorStatus { mode: CorrectorMode::Run, axes_used: 1, ..CorrectorStatus::default() };
    status.axes[0].homed = true;
    for tick in 1..=1000 {
        status.t_ns = tick * 10_000_000;
        status.axes[0].position_counts = i64::min(tick as i64 * 800, 400_000); // 80 mm/s
        let [total, ..] = law.tick(tick as f64 * 0.01, &status, &[]);
        if let Some(total) = total {
            status.axes[0].requested = total;
            (status.axes[0].completed, status.axes[0].in_effect) = (total, total); // the engine would insert
        }
    }
    println!("{:#?}", law.explain(0, &status.axes[0]));
    assert_eq!(status.axes[0].requested, 40); // 400 mm · 100 ppm
    Ok(())
}
