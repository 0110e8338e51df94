//! One axis on a card in memory.
//! It requests two counts, which are inserted after one of the next edges.
use rtec_driver::mock_card::{MockCard, SharedWires};
use rtec_driver::{card::MachineLines, clock::Clock, quadrature::State};
use rtec_rt::{axis::AxisConfig, engine::Engine, engine::MachineConfig, link_messages::RequestToRt};
use std::sync::atomic::Ordering::Release;

struct Ticks(u64);
impl Clock for Ticks {
    fn now_ns(&mut self) -> u64 {
        self.0 += 100; // from look to look, ns
        self.0
    }
}
#[cfg_attr(test, test)]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (wires, mut scale) = (SharedWires::default(), State::default());
    let mut card = MockCard::new(wires.clone(), Ticks(0));
    let machine = MachineConfig { lines: MachineLines::default(), may_arm: true };
    let mut engine = Engine::new(&mut card, &[AxisConfig::default()], machine, &[])?;
    engine.start_homed(&mut card, &mut |_| true)?;
    engine.take(RequestToRt::Correct { axis: 0, total_counts: 2, large: true }, &mut card, &mut |_| true)?;
    for look in 1..=1000 {
        scale = if look % 100 == 0 { scale.next(true) } else { scale }; // 10 µs a count
        wires.inputs.store(u64::from(scale.bits()), Release);
        engine.poll(&mut card, u64::MAX, &mut |_| true)?;
    }
    let axis = engine.status().axes[0];
    assert_eq!((axis.position_counts, axis.completed, axis.mtc_minus_scale), (10, 2, 2));
    Ok(())
}
