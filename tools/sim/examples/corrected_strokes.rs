//! The real-time thread on a mock card with a moving axis that this corrects.
//! Run it as `corrected_strokes [SECONDS]`.
use rtec_correct::{AxisCorrectionSettings, Corrector, RAMP_UM_S};
use rtec_driver::{card::AxisLines, card::MachineLines, clock::Monotonic, mock_card::MockCard};
use rtec_model::machine::Machine;
use rtec_rt::engine::{Engine, MachineConfig};
use rtec_rt::link_messages::{CorrectorMode, EventKind, RequestToRt};
use rtec_rt::{axis::AxisConfig, pinned_rt_thread::ThreadOptions, pinned_rt_thread::spawn};
use rtec_sim::stroking_axes::{StrokeMotion, moving_axes};
use std::path::Path;
use std::time::{Duration, Instant};

#[cfg_attr(test, test)]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let seconds = std::env::args().nth(1).and_then(|s| s.parse().ok()).unwrap_or(1.0);
    let lines = AxisLines::standard(0, true);
    // 1 µm per count: 20 mm there and back at 60 mm/s.
    let motion = StrokeMotion { stroke_counts: 2e4, feed_counts_s: 6e4, dwell_s: 0.1, on_feedback: true };
    let (axes, operator) = moving_axes(&[(lines, motion)], MachineLines::default());
    let mut card = MockCard::new(axes, Monotonic);
    let axis = AxisConfig { lines, max_correction_counts: 100, ..AxisConfig::default() };
    let machine = MachineConfig { lines: MachineLines::default(), may_arm: true };
    let engine = Engine::new(&mut card, &[axis], machine, &[])?;
    let options = ThreadOptions { wanted: None, real: false, stale_after_ns: 500_000_000 };
    let mut running = spawn(engine, card, options)?;

    let known = "name = \"axis\"\n[[effect]]\nname = \"scale.x\"\nppm = 1000.0\n";
    let (name, increment_counts) = ("x".to_owned(), rtec_rt::axis::INCREMENT_COUNTS);
    let (window_counts, max_counts) = (axis.window_counts, axis.max_correction_counts);
    let setup = AxisCorrectionSettings { name, count_um: 1.0, increment_counts, window_counts, max_counts };
    let mut law = Corrector::new(vec![setup], RAMP_UM_S, 0.01, 0.0);
    law.load(Machine::parse(Path::new("axis"), known)?, &|_| Vec::new())?;

    running.control.send(RequestToRt::Home { axis: 0, position_counts: 0, controller_homed: true })?;
    let (begun, mut faults) = (Instant::now(), 0);
    while begun.elapsed() < Duration::from_secs_f64(seconds) && !running.control.ended() {
        std::thread::sleep(Duration::from_millis(5));
        running.control.beat();
        let status = running.control.status();
        while let Some(event) = running.control.event() {
            match event.kind {
                EventKind::HomeSet { position_counts } => {
                    running.control.send(RequestToRt::ConfirmHome { axis: 0, position_counts })?;
                }
                EventKind::Homed { .. } => running.control.send(RequestToRt::Enable)?,
                EventKind::Mode(CorrectorMode::Run) => operator.cycle_start(),
                EventKind::Fault(_) => faults += 1,
                _ => {}
            }
        }
        let totals = law.tick(begun.elapsed().as_secs_f64(), &status, &[]);
        if let Some(total_counts) = totals[0] {
            running.control.send(RequestToRt::Correct { axis: 0, total_counts, large: false })?;
        }
    }
    let (ended, _) = running.stop();
    let (axis, truth) = (ended.status.axes[0], &operator.truth[0]);
    println!("{} looks, {} insertions, {faults} faults", ended.status.polls, axis.insertions);
    assert!(axis.insertions > 0 && faults == 0 && truth.illegal() == 0);
    assert_eq!(truth.mtc_counts() - axis.position_counts, axis.completed);
    Ok(())
}
