//! The unchanged engine on the simulated machine.

#![allow(clippy::unwrap_used)]

use rtec_model::machine::Machine;
use rtec_sim::axis::AxisSpec;
use rtec_sim::corrected_machine_sim::{CorrectedMachineSim, MachineSnapshot, MachineSpec};
use rtec_sim::machine::{ControllerFault, ControllerLimits, SimMachine};
use rtec_sim::nc_block::Block;
use std::path::Path;

fn model(text: &str) -> Machine {
    Machine::parse(Path::new("m.toml"), &format!("name = \"m\"\n{text}")).unwrap()
}

fn sim(truth: &Machine, known: Option<&Machine>) -> CorrectedMachineSim {
    CorrectedMachineSim::new(&MachineSpec::machining_centre(), truth, known, [0.0; 3], 1).unwrap()
}

fn rapid(to: [f64; 3]) -> Block {
    Block::Rapid { to }
}

fn feed(to: [f64; 3], feed_mm_min: f64) -> Block {
    Block::Feed { to, feed_mm_s: feed_mm_min / 60.0 }
}

/// A full circle in XY.
fn circle(from: [f64; 3], centre_mm: [f64; 2], clockwise: bool, feed_mm_min: f64) -> Block {
    let centre = (centre_mm[0], centre_mm[1]);
    Block::Arc { to: from, plane: (0, 1), centre, clockwise, feed_mm_s: feed_mm_min / 60.0 }
}

#[test]
fn an_ideal_machine_goes_where_it_is_commanded() {
    let mut s = sim(&Machine::ideal("m"), None);
    let end = [25.0, -30.0, 10.0];
    s.run([rapid([20.0, -30.0, 10.0]), feed(end, 500.0), circle(end, [20.0, -30.0], true, 1000.0)]).unwrap();
    let m = s.moment();
    for (n, p) in end.into_iter().enumerate() {
        assert!((m.axes[n].position_mm - p).abs() <= 0.0011, "{m:?}");
        assert!((m.counted_mm[n] - p).abs() <= 0.0011, "{m:?}");
        assert!(m.off_um(n).abs() < 1e-12);
    }
}

#[test]
fn following_error_stays_small_in_motion() {
    let mut s = sim(&Machine::ideal("m"), None);
    let end = [100.0, 60.0, 0.0];
    s.machine.load([feed(end, 6000.0), circle(end, [80.0, 60.0], false, 2000.0)]);
    let mut worst: f64 = 0.0;
    while !s.machine.finished() {
        s.advance(0.01).unwrap();
        let m: MachineSnapshot = s.moment();
        worst = worst.max((m.axes[0].position_mm - m.command.p_mm[0]).abs());
    }
    println!("worst following error {worst} mm");
    assert!(worst < 0.05, "{worst} mm");
}

/// Counts added at the MTC move the axis the other way.
/// (NISTIR 4832, Altering the Position Signal)
#[test]
fn a_known_error_is_taken_out_and_an_unknown_one_stays() {
    let truth = model("[[effect]]\nname = \"scale.x\"\nppm = 100\n[[effect]]\nname = \"offset.y\"\num = 7\n");
    let off = |known: Option<&Machine>| {
        let mut s = sim(&truth, known);
        s.run([feed([200.0, 10.0, 0.0], 5000.0)]).unwrap();
        s.advance(0.5).unwrap();
        let (m, tool_mm) = (s.moment(), s.machine.tool_mm());
        ([0, 1].map(|n| m.off_um(n)), [tool_mm[0] - 200.0, tool_mm[1] - 10.0].map(|e| 1000.0 * e))
    };
    let (off_without, tool_without) = off(None);
    assert!((off_without[0] - 20.0).abs() < 0.01 && (off_without[1] - 7.0).abs() < 0.01, "{off_without:?}");
    assert!((tool_without[0] - 20.0).abs() < 1.5);
    let (off_with, tool_with) = off(Some(&truth));
    assert!(off_with.iter().all(|e| e.abs() <= 1.01), "{off_with:?}");
    assert!(tool_with.iter().all(|e| e.abs() <= 2.6), "{tool_with:?}");
}

#[test]
fn feed_hold_stops_the_path_and_lets_it_go_on() {
    let mut s = sim(&Machine::ideal("m"), None);
    s.machine.load([feed([100.0, 0.0, 0.0], 6000.0)]);
    s.advance(0.5).unwrap();
    s.hold(true).unwrap();
    s.advance(0.5).unwrap();
    let held = s.moment().axes[0].position_mm;
    s.advance(0.5).unwrap();
    assert!((s.moment().axes[0].position_mm - held).abs() < 0.002 && held < 60.0);
    s.hold(false).unwrap();
    s.finish().unwrap();
    assert!((s.moment().axes[0].position_mm - 100.0).abs() < 0.0011);
}

#[test]
fn an_illegal_state_is_a_servo_fault() {
    use rtec_driver::card::Card;
    let mut s = sim(&Machine::ideal("m"), None);
    s.machine.write(3, 3).unwrap();
    assert_eq!(s.machine.fault(), Some(ControllerFault::IllegalState { axis: 0 }));
}

/// An independent decoder of the lines agrees with the machine's counters.
/// The gates change at random meanwhile.
#[test]
fn the_counters_say_what_the_lines_show() {
    use rtec_driver::card::Card;
    use rtec_driver::quadrature::{Decoder, State};
    // Closed on the motor's encoder, so signals from the gates move nothing.
    let axis = |name| AxisSpec { on_feedback: false, ..AxisSpec::new(name, 400.0) };
    let axes = [
        AxisSpec { interpolation_um: 0.2, ..axis("x") },
        AxisSpec { hysteresis_counts: 0.7, ..axis("y") },
        axis("z"),
    ];
    let controller = ControllerLimits { decoder_hz: f64::INFINITY, max_following_mm: 1e3 };
    let mut machine = SimMachine::new(&axes, controller, [0.0; 3]);
    let turn = [0.0, 1.0, 3.0];
    let there = [rapid([12.0, -7.0, 3.0]), feed(turn, 4000.0)];
    let back = [circle(turn, [4.0, 1.0], false, 3000.0), rapid([-3.0; 3])];
    machine.load(there.into_iter().chain(back));
    let (mut scale, mut mtc) = ([Decoder::default(); 3], [Decoder::default(); 3]);
    let (mut last_ns, mut least_ns, mut edges) = ([0; 3], [u64::MAX; 3], 0);
    let mut random = 1_u64;
    let mut draw = |below: u64| {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (random >> 33) % below
    };
    let mut outputs = 0;
    while !machine.finished() {
        let (t_ns, wake_ns) = (machine.now_ns(), machine.now_ns() + draw(30_000));
        let sample = machine.sample(wake_ns).unwrap();
        assert!(t_ns <= sample.t_ns && sample.t_ns <= wake_ns, "{t_ns} {wake_ns} {sample:?}");
        let mut seen = vec![sample.inputs];
        if draw(50) == 0 {
            // One inverter of one axis; towards the end two at once, and the MTC sees both signals change.
            let lines = if edges > 20_000 { 3 } else { 1 + draw(2) };
            let mask = lines << (2 * draw(3));
            outputs ^= mask;
            machine.write(mask, outputs).unwrap();
            seen.push(machine.inputs());
        }
        for inputs in seen {
            for n in 0..3 {
                let bits = inputs >> (4 * n);
                let (at_scale, at_mtc) = (State::from_bits(bits as u8), State::from_bits((bits >> 2) as u8));
                edges += u64::from(at_scale != scale[n].state());
                scale[n].update(at_scale);
                if at_mtc != mtc[n].state() {
                    mtc[n].update(at_mtc);
                    least_ns[n] =
                        least_ns[n].min(sample.t_ns - std::mem::replace(&mut last_ns[n], sample.t_ns));
                }
            }
        }
        for n in 0..3 {
            let found = (machine.mtc_counts(n), machine.mtc_minus_scale(n), machine.illegal(n));
            let shown = (mtc[n].count(), mtc[n].count() - scale[n].count(), mtc[n].illegal());
            assert_eq!(found, shown, "axis {n} at {} ns", sample.t_ns);
            assert_eq!((scale[n].illegal(), machine.min_separation_ns(n)), (0, least_ns[n]), "axis {n}");
        }
        assert_eq!(machine.edges(), edges);
        if machine.fault().is_some() {
            break;
        }
    }
    let illegal: u64 = mtc.iter().map(Decoder::illegal).sum();
    let fault = machine.fault();
    assert!(matches!(fault, Some(ControllerFault::IllegalState { .. })), "{fault:?}, {edges} edges");
    assert!(edges > 20_000 && illegal == 1, "{edges} edges, {illegal} illegal");
}
