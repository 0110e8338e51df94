//! The control law as the daemon runs it, tick by tick.
//! The engine inserts at once.

#![allow(clippy::unwrap_used)] // a test's own helpers

mod bench;
#[path = "law/part_table.rs"]
mod part_table;
#[path = "law/sensors.rs"]
mod sensors;

use bench::{Bench, GROWTH, LAG, SCALE, TICK_S, machine, part, part_errors, sensor};
use rtec_correct::part_table::PartTable;
use rtec_model::record::{Axis, Role};
use rtec_part::error_cor_file::{FeatureErrors, StraightFeaturePointError};
use rtec_part::geometric_fit::Zx;
use rtec_rt::link_messages::{AxisStatus, CorrectorMode, CorrectorStatus, Fault, MAX_AXES};

#[test]
fn a_total_follows_the_axis_within_its_window_and_does_not_chatter() {
    let mut bench = Bench::new();
    bench.load(SCALE);
    bench.tick();
    // A rapid over 400 mm between two evaluations: 40 counts, and no more than the window at once.
    bench.status.axes[0].position_counts = 400_000;
    bench.run(1.0, 0, |_| None);
    assert_eq!(bench.status.axes[0].requested, 40);
    // At the boundary of an increment, noise of the scale changes nothing; further on, the total follows.
    for k in 0..200 {
        bench.status.axes[0].position_counts = 410_000 + 3 * (k % 2);
        bench.tick();
        assert_eq!(bench.status.axes[0].requested, 40);
    }
    // An axis that moves back and forth across the boundary changes its total only once.
    let changes = (0..200).filter(|k| {
        bench.status.axes[0].position_counts = 410_000 + 500 * (k % 2);
        bench.tick()[0].is_some()
    });
    assert_eq!((changes.count(), bench.status.axes[0].requested), (1, 42));
    bench.status.axes[0].position_counts = 440_000;
    assert_eq!(bench.tick()[0], Some(44));
    assert_eq!(bench.tick(), [None; MAX_AXES], "what is requested is not requested again");
    let (total, sum) = bench.explained_um(0);
    assert!((total - 44.0).abs() < 1e-12 && (total - sum).abs() < 1e-9, "{total} {sum}");
}

#[test]
fn loading_and_unloading_are_ramps() {
    let mut bench = Bench::of(10.0, 1000.0, Vec::new());
    bench.status.axes[0].position_counts = 400_000;
    bench.load(SCALE);
    assert!(bench.run(2.0, 0, |_| None) <= 2);
    assert!((18..=22).contains(&bench.status.axes[0].requested), "half way after two of four seconds");
    bench.run(3.0, 0, |_| None);
    assert_eq!(bench.status.axes[0].requested, 40);
    assert!(bench.corrector.unload() && !bench.corrector.unload());
    assert!(bench.run(6.0, 0, |_| None) <= 2);
    assert_eq!(bench.status.axes[0].requested, 0);
}

#[test]
fn nothing_is_asked_for_while_it_must_not_and_after_that_it_is_a_ramp() {
    type Change = fn(&mut CorrectorStatus);
    let not: [Change; 6] = [
        |s| s.mode = CorrectorMode::Disabled,
        |s| s.mode = CorrectorMode::Hold,
        |s| s.mode = CorrectorMode::Probe,
        |s| s.mode = CorrectorMode::Fault,
        |s| s.axes[0].homed = false,
        |s| {
            s.axes[0].faults.latch(Fault::PollGap);
        },
    ];
    for change in not {
        let mut bench = Bench::new();
        bench.load(SCALE);
        bench.tick();
        let before = bench.status;
        change(&mut bench.status);
        bench.status.axes[0].position_counts = 400_000;
        for _ in 0..100 {
            assert_eq!(bench.tick()[0], None, "{:?}", bench.status.mode);
        }
        let axes = bench.status.axes;
        bench.status = CorrectorStatus { t_ns: bench.status.t_ns, ..before };
        bench.status.axes[0].position_counts = axes[0].position_counts;
        assert!(bench.run(10.0, 0, |_| None) <= 2);
        assert_eq!(bench.status.axes[0].requested, 40);
    }
}

#[test]
fn the_operator_is_beside_the_model() {
    let mut bench = Bench::new();
    bench.load(SCALE);
    bench.status.axes[0].position_counts = 200_000;
    bench.run(6.0, 0, |_| None);
    assert_eq!(bench.status.axes[0].requested, 20);
    assert_eq!(bench.corrector.with_operator(0, -7), 13);
    bench.corrector.operator_is(0, -7);
    bench.status.axes[0].requested = 13;
    bench.status.axes[0].position_counts = 400_000;
    bench.run(1.0, 0, |_| None);
    assert_eq!(bench.status.axes[0].requested, 33);
    let (total, sum) = bench.explained_um(0);
    assert!((total - sum).abs() < 1e-9);
    // After a new homing all totals are zero, and the model's total returns in a ramp.
    bench.corrector.homed(0, 0);
    bench.status.axes[0] = AxisStatus { homed: true, ..AxisStatus::default() };
    bench.status.axes[0].position_counts = 400_000;
    assert!(bench.run(10.0, 0, |_| None) <= 2);
    assert_eq!(bench.status.axes[0].requested, 40);
}

/// A drive that makes room for an insertion with a lag of two ticks.
fn follow(bench: &mut Bench, axis: usize, commanded: i64, ticks: usize) -> usize {
    let mut changes = 0;
    for _ in 0..ticks {
        changes += usize::from(bench.tick()[axis].is_some());
        let a = &mut bench.status.axes[axis];
        a.position_counts += (commanded - a.in_effect - a.position_counts) / 2;
    }
    changes
}

/// A reversal's correction does not itself reverse the axis, at once or later.
/// The MTC counts it at once, and the drive follows a little later.
#[test]
fn a_reversal_does_not_turn_its_own_axis() {
    for (um, back) in [(40.0, 30), (40.0, 10), (20.0, 25), (60.0, 7), (12.0, 14)] {
        let mut bench = Bench::new();
        bench.load(&format!("[[effect]]\nname = \"reversal.x\"\num = {um:?}\n"));
        for p in [0, 100, 200] {
            follow(&mut bench, 0, p, 20);
        }
        follow(&mut bench, 0, 200, 200);
        let half = (um / 2.0) as i64;
        assert_eq!(bench.status.axes[0].requested, half, "{um} up");
        follow(&mut bench, 0, 200 - back, 60);
        assert_eq!(bench.status.axes[0].requested, -half, "{um} down: a reversal is motion, no ramp");
        assert_eq!(follow(&mut bench, 0, 200 - back, 400), 0, "{um}, {back} back: it stands");
        follow(&mut bench, 0, 300, 60);
        assert_eq!(bench.status.axes[0].requested, half, "{um} up again");
        assert_eq!(follow(&mut bench, 0, 300, 400), 0);
    }
}

/// Lost motion follows the table, which a correction at rest moves.
/// The table here has its own direction. It reverses once it has come back by three counts, whatever moved
/// it.
#[test]
fn a_correction_at_rest_turns_the_axis_and_its_reversal() {
    for um in [-60.0, -20.0, -6.0, 6.0, 20.0, 60.0_f64] {
        for (from, correction) in [(0, 100), (0, -100), (400, 100), (400, -100), (0, 30), (400, -30_i64)] {
            // If the reversal is ahead of the scale, a smaller way back fits neither direction.
            if um > 0.0 && correction.abs() <= um as i64 + 10 && correction * (200 - from) > 0 {
                continue;
            }
            let mut bench = Bench::new();
            bench.load(&format!("[[effect]]\nname = \"reversal.x\"\num = {um:?}\n"));
            let (mut direction, mut furthest) = (0, 0);
            let mut changes = 0;
            for k in 0..1200 {
                if k == 400 {
                    bench.corrector.operator_is(0, correction);
                }
                let commanded = if k < 100 { from } else { 200 };
                changes = if k < 1000 { 0 } else { changes } + follow(&mut bench, 0, commanded, 1);
                let at = bench.status.axes[0].position_counts;
                if (at - furthest) * direction > 0 {
                    furthest = at;
                } else if (at - furthest).abs() > 3 {
                    (direction, furthest) = ((at - furthest).signum(), at);
                }
            }
            let said = format!("{um} µm, from {from}, then {correction}: {:?}", bench.status.axes[0]);
            let left = bench.status.axes[0].requested - correction - direction * (um / 2.0) as i64;
            assert!(left.abs() <= 1 && changes == 0, "{left} left, {changes} changes: {said}");
        }
    }
}

#[test]
fn homing_keeps_the_direction_of_the_last_motion() {
    let mut bench = Bench::new();
    bench.load("[[effect]]\nname = \"reversal.y\"\num = 40.0\n");
    follow(&mut bench, 1, 13_000, 200);
    assert_eq!(bench.status.axes[1].requested, 20);
    bench.corrector.homed(1, 0);
    bench.status.axes[1] = AxisStatus { homed: true, ..AxisStatus::default() };
    assert!(bench.run(10.0, 1, |_| None) <= 2, "a ramp");
    assert_eq!(bench.status.axes[1].requested, 20);
}

/// Changes that no motion causes are ramps: coolant, ten seconds without a call.
#[test]
fn what_no_motion_asks_for_is_never_a_jump() {
    let mut bench = Bench::of(5.0, 1000.0, vec![sensor("wet", Role::Coolant)]);
    bench.watches[0].offer(bench.now_s, Ok(0.0));
    bench.load("[[effect]]\nname = \"coolant.z\"\num = 40.0\n");
    bench.run(0.5, 2, |_| None);
    assert_eq!(bench.z(), 0);
    bench.watches[0].offer(bench.now_s, Ok(1.0));
    for _ in 0..1000 {
        let before = bench.z();
        bench.watches[0].offer(bench.now_s, Ok(1.0));
        bench.tick();
        assert!(bench.z() - before <= 2);
    }
    assert!((39..=40).contains(&bench.z()), "{}", bench.z());
    let mut bench = Bench::new();
    bench.load("[[effect]]\nname = \"offset.z\"\num = 40.0\n");
    bench.run(0.02, 2, |_| None);
    bench.now_s += 10.0;
    bench.tick();
    assert!(bench.z() <= 6, "{} after a stall", bench.z());
}

#[test]
fn a_model_that_reads_what_the_machine_has_not_is_refused_by_name() {
    let mut bench = Bench::new();
    let mut refuse = |text: &str| bench.try_load(text).unwrap_err().to_string();
    let text = refuse(&GROWTH.replace("T2", "T9"));
    assert!(text.contains("temperature T9") && text.contains("T1, T2"), "{text}");
    // All of them at once, with their readers and what to configure.
    let text = refuse(&GROWTH.replace("T1", "T8").replace("T2", "T18"));
    for part in [
        "T18 (read by thermal_growth.z), T8 (read by thermal_growth.z)",
        "[[sensor]] name = \"T18\", role = \"temperature\"; [[sensor]] name = \"T8\"",
        "in the rtec.toml that rtecd was started with",
    ] {
        assert!(text.contains(part), "{text}");
    }
    let text = refuse("[[effect]]\nname = \"channel.x.flow\"\ngain = 1.0\n");
    assert!(text.contains("role = \"channel\"") && text.ends_with("it has none"), "{text}");
    assert!(refuse("[[effect]]\nname = \"channel.x.flow\"\ngain = 1.0\n").contains("channel flow"));
    bench.load("[[effect]]\nname = \"coolant.z\"\num = 5.0\n");
    assert!(bench.corrector.running_model().unwrap().notes[0].contains("no [[sensor]] of role coolant"));
}

/// A model that was loaded after its end has been accepted by its user.
/// One that ends while it runs has not been accepted, which is reported once.
#[test]
fn a_model_that_ends_while_it_runs_goes_on_and_is_known_to_have_ended() {
    let fit = "[[fit]]\nresponse = \"error.x\"\ndate = \"1970-01-01\"\nvalid_until = \"1970-01-11\"\n\
               rms_um = 0.1\nhalf_width_um = 0.2\n";
    let mut bench = Bench::new();
    bench.corrector.day_is(9);
    bench.load(&[SCALE, fit].concat());
    bench.status.axes[0].position_counts = 400_000;
    bench.run(10.0, 0, |_| None);
    assert_eq!(bench.corrector.day_is(10), [""; 0], "its last day");
    assert!(bench.corrector.expired().is_empty());
    let ended = "error.x: the fit's validity ended on 1970-01-11";
    assert_eq!(bench.corrector.day_is(11), [ended]);
    assert_eq!(bench.corrector.day_is(11), [""; 0], "said once");
    assert_eq!(bench.corrector.expired(), [ended]);
    bench.status.axes[0].position_counts = 420_000;
    bench.tick();
    assert_eq!(bench.status.axes[0].requested, 42, "what cuts now goes on");
    let shown = bench.corrector.running_model().unwrap();
    assert!(shown.expired == [ended] && shown.notes.contains(&ended.to_owned()), "{shown:?}");
    // Loading it again means acceptance.
    bench.load(&[SCALE, fit].concat());
    assert!(bench.corrector.expired().is_empty());
    assert_eq!(bench.corrector.running_model().unwrap().expired, [ended]);
}

#[test]
fn a_probed_point_gets_what_the_model_says_of_it() {
    let mut bench = Bench::new();
    bench.load(&[SCALE, GROWTH, "[[effect]]\nname = \"squareness.x.y\"\nurad = 50.0\n"].concat());
    bench.warm(23.0, 20.0);
    bench.status.mode = CorrectorMode::Probe;
    for p in [0, 50_000, 100_000] {
        bench.status.axes[1].position_counts = p;
        bench.tick();
    }
    let at = |t_back_s: f64| {
        let t_ns = bench.status.t_ns - (t_back_s * 1e9) as u64;
        bench.corrector.error_um_at(0, t_ns, 200.0).unwrap()
    };
    // 100 ppm of 200 mm, and 50 µrad of Y where it was then: 100 mm, or 50 mm one evaluation before.
    assert!((at(0.0) - 25.0).abs() < 1e-9, "{}", at(0.0));
    assert!((at(TICK_S) - 22.5).abs() < 1e-9);
    assert_eq!(bench.status.axes[0].requested, 0, "probing is not corrected");
}
