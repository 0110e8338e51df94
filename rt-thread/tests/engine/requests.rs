//! Requests, belief, homing, limits, shadow and hold.

use super::*;

#[test]
fn nothing_is_accepted_before_homing_and_the_read_back_must_agree() {
    let mut rig = Rig::with(windowed(), true);
    rig.correct(2);
    rig.take(RequestToRt::Enable);
    rig.take(RequestToRt::Home { axis: 0, position_counts: 5000, controller_homed: true });
    rig.correct(2);
    rig.take(RequestToRt::ConfirmHome { axis: 0, position_counts: 4999 });
    rig.take(RequestToRt::Enable);
    assert_eq!(rig.refusals(), [Refusal::NotHomed; 5]);
    assert_eq!(rig.status().axes[0].position_counts, 5000);
    rig.take(RequestToRt::ConfirmHome { axis: 0, position_counts: 5000 });
    rig.take(RequestToRt::Enable);
    assert_eq!((rig.status().mode, rig.refusals().len()), (CorrectorMode::Run, 5));
}

#[test]
fn i_dont_believe_you_and_back_in_range_within_two_readings() {
    for late in [0, 1] {
        let mut rig = Rig::running(windowed());
        rig.correct(50);
        for _ in 0..late {
            rig.correct(50);
        }
        rig.correct(2);
        assert_eq!(rig.refusals(), vec![Refusal::NotBelieved; 1 + late]);
        assert_eq!((rig.status().axes[0].requested, rig.status().mode), (2, CorrectorMode::Run));
        // A believed request resets the count of doubts.
        rig.correct(50);
        rig.correct(50);
        assert!(rig.faults().is_empty());
    }
}

#[test]
fn i_still_dont_believe_you_holds_the_machine() {
    let mut rig = Rig::running(windowed());
    for _ in 0..3 {
        rig.correct(50);
    }
    assert_eq!(rig.faults(), [Fault::StillNotBelieved]);
    assert_eq!((rig.status().mode, rig.card.outputs & HOLD), (CorrectorMode::Fault, HOLD));
    rig.correct(2);
    assert_eq!(rig.refusals().last(), Some(&Refusal::FaultLatched));
    // The count is certain: after `Clear` the axis is still homed, and corrections wait to be enabled.
    rig.take(RequestToRt::Clear);
    assert_eq!((rig.status().mode, rig.card.outputs & HOLD), (CorrectorMode::Disabled, 0));
    rig.take(RequestToRt::Enable);
    assert_eq!(rig.status().mode, CorrectorMode::Run);
}

#[test]
fn a_large_change_is_believed_when_flagged() {
    let mut rig = Rig::running(windowed());
    rig.take(RequestToRt::Correct { axis: 0, total_counts: 80, large: true });
    assert_eq!((rig.status().axes[0].requested, rig.refusals().len()), (80, 0));
}

#[test]
fn maximum_warning_and_error_limit() {
    let mut rig = Rig::running(AxisConfig { warn_counts: 10, error_counts: 20, ..windowed() });
    for total_counts in [101, -101, i64::MAX, i64::MIN] {
        rig.take(RequestToRt::Correct { axis: 0, total_counts, large: true });
    }
    assert_eq!(rig.refusals(), [Refusal::AboveMaximum; 4]);
    rig.take(RequestToRt::Correct { axis: 0, total_counts: -12, large: true });
    assert!(rig.events.iter().any(|e| e.kind == EventKind::Warning { total_counts: -12 }));
    rig.take(RequestToRt::Correct { axis: 0, total_counts: 20, large: true });
    assert_eq!((rig.faults(), rig.status().mode), (vec![Fault::ErrorLimit], CorrectorMode::Fault));
    assert_eq!(rig.status().axes[0].requested, -12);
}

#[test]
fn a_request_while_disabled_is_answered() {
    let mut rig = Rig::running(windowed());
    rig.take(RequestToRt::Disable);
    rig.correct(0);
    rig.correct(2);
    assert_eq!(rig.refusals(), [Refusal::Disabled; 2], "no total is taken and forgotten");
    rig.events.clear();
    rig.take(RequestToRt::Enable);
    rig.card.inputs |= SWITCH;
    rig.looks(2);
    assert_eq!(rig.status().mode, CorrectorMode::Disabled);
    rig.correct(2);
    rig.take(RequestToRt::Enable);
    assert_eq!(rig.refusals(), [Refusal::DisableSwitch; 2]);
    rig.card.inputs &= !SWITCH;
    rig.looks(2);
    assert_eq!(
        (rig.status().mode, rig.status().off_because),
        (CorrectorMode::Disabled, DisableReason::Switch)
    );
    rig.step(8);
    assert_eq!(rig.status().axes[0].insertions, 0, "a released switch enables nothing");
    rig.take(RequestToRt::Enable);
    assert_eq!(rig.status().mode, CorrectorMode::Run);
}

/// A return to normal enables nothing.
/// The control side is heard again, the disable switch goes off, or the MTC is back.
#[test]
fn nothing_that_comes_back_enables_corrections() {
    type Event<'a> = (&'a str, &'a dyn Fn(&mut Rig, bool), DisableReason);
    let line = |bit: u64| {
        move |rig: &mut Rig, _: bool| {
            rig.card.inputs ^= bit;
            rig.looks(2);
        }
    };
    let (switch, ready) = (line(SWITCH), line(READY));
    let stale = |rig: &mut Rig, away: bool| {
        rig.engine.set_control_stale(away, &mut |_| true);
        rig.looks(2);
    };
    let cases: [Event<'_>; 3] = [
        ("switch", &switch, DisableReason::Switch),
        ("MTC", &ready, DisableReason::Controller),
        ("control", &stale, DisableReason::ControlStale),
    ];
    for (name, turn, because) in cases {
        let lines = MachineLines { mtc_ready: Some(30), ..MachineLines::standard() };
        let machine = MachineConfig { lines, may_arm: true };
        let mut card = Bench { inputs: READY, ..Bench::default() };
        let engine = Engine::new(&mut card, &[windowed()], machine, &[]).unwrap();
        let mut rig = Rig { engine, card, events: Vec::new() };
        rig.engine.start_homed(&mut rig.card, &mut |_| true).unwrap();
        rig.looks(2);
        rig.correct(2);
        assert_eq!((rig.status().mode, rig.status().axes[0].requested), (CorrectorMode::Run, 2), "{name}");
        for away in [true, false] {
            turn(&mut rig, away);
            let status = rig.status();
            assert_eq!((status.mode, status.enabled), (CorrectorMode::Disabled, false), "{name} {away}");
            assert_eq!(status.off_because, because, "{name}");
        }
        rig.step(12);
        assert_eq!(rig.status().axes[0].insertions, 0, "{name}");
    }
}

/// After the MTC was off, nothing is enabled until MTC and axis are homed.
/// The MTC has lost its count.
#[test]
fn an_mtc_that_was_off_has_to_be_homed() {
    for holds in [false, true] {
        let lines = MachineLines { mtc_ready: Some(30), ..MachineLines::standard() };
        let machine = MachineConfig { lines, may_arm: true };
        let mut card = Bench { inputs: READY, ..Bench::default() };
        let engine = Engine::new(&mut card, &[windowed()], machine, &[]).unwrap();
        let mut rig = Rig { engine, card, events: Vec::new() };
        if holds {
            rig.engine.hold_without_mtc();
        }
        rig.engine.start_homed(&mut rig.card, &mut |_| true).unwrap();
        rig.looks(2);
        rig.correct(2);
        rig.step(12);
        assert_eq!(rig.status().axes[0].in_effect, 2);
        rig.card.inputs &= !READY;
        rig.looks(2);
        let status = rig.status();
        assert!(!status.mtc_ready && !status.axes[0].homed && !status.axes[0].mtc_known);
        assert_eq!(
            (status.held, rig.card.outputs & HOLD != 0),
            (holds.then_some(FeedHoldSource::Controller), holds)
        );
        let home = |controller_homed| RequestToRt::Home { axis: 0, position_counts: 0, controller_homed };
        rig.take(home(true));
        assert_eq!(rig.refusals(), [Refusal::ControllerNotReady]);
        rig.events.clear();
        rig.card.inputs |= READY;
        rig.looks(2);
        assert_eq!(rig.card.outputs & HOLD != 0, holds, "hold does not fall by itself");
        rig.take(home(false));
        rig.take(RequestToRt::Hold { on: false, by: 0 });
        rig.take(RequestToRt::Enable);
        assert_eq!(rig.refusals(), [Refusal::ControllerUnknown, Refusal::NotHomed]);
        rig.take(home(true));
        rig.take(RequestToRt::ConfirmHome { axis: 0, position_counts: 0 });
        rig.take(RequestToRt::Enable);
        assert_eq!((rig.status().mode, rig.status().axes[0].in_effect), (CorrectorMode::Run, 0));
    }
}

/// Homing the scale alone keeps the total that the MTC counts.
/// The total counts against the limit, and nothing moves when corrections are enabled again.
#[test]
fn homing_the_scale_alone_keeps_the_total() {
    let config = AxisConfig { max_correction_counts: 10, ..windowed() };
    let mut rig = Rig::running(config);
    for round in 0..5 {
        rig.take(RequestToRt::Correct { axis: 0, total_counts: 10, large: true });
        rig.step(40);
        rig.take(RequestToRt::Home { axis: 0, position_counts: 7, controller_homed: false });
        rig.take(RequestToRt::ConfirmHome { axis: 0, position_counts: 7 });
        let axis = rig.status().axes[0];
        assert_eq!((axis.in_effect, axis.requested, axis.mtc_minus_scale), (10, 10, 10), "round {round}");
        assert_eq!((axis.position_counts, axis.homed, axis.mtc_known), (7, true, true));
        rig.take(RequestToRt::Correct { axis: 0, total_counts: 12, large: true });
    }
    assert_eq!(rig.refusals(), [Refusal::AboveMaximum; 5]);
    rig.take(RequestToRt::Home { axis: 0, position_counts: 7, controller_homed: true });
    let axis = rig.status().axes[0];
    assert_eq!((axis.in_effect, axis.requested, axis.mtc_minus_scale), (0, 0, 0));
    // After a fault that puts the count in doubt, no total is kept.
    rig.engine.latch(Some(0), Fault::PollGap, &mut rig.card, &mut |_| true).unwrap();
    rig.take(RequestToRt::Clear);
    rig.events.clear();
    rig.take(RequestToRt::Home { axis: 0, position_counts: 7, controller_homed: false });
    assert_eq!(rig.refusals(), [Refusal::ControllerUnknown]);
}

/// Inverters shift the place of a reference mark by two counts.
/// The MTC takes its zero where the mark, A' and B' are on. With both inverters on that place is two counts away. With
/// both off it is the place that the scale alone has.
#[test]
fn a_mark_that_the_mtc_gates_is_found_two_counts_away_under_inverters() {
    let found_at = |total_counts: i64| {
        let mut rig = Rig::running(windowed());
        rig.take(RequestToRt::Correct { axis: 0, total_counts, large: true });
        rig.step(60);
        assert_eq!(rig.status().axes[0].in_effect, total_counts);
        let mark = 96..100_i64;
        while rig.card.count < 120 {
            rig.step(1);
            let seen = rig.card.inputs & 3 ^ rig.card.outputs & 3;
            if mark.contains(&rig.card.count) && seen == 3 {
                return rig.card.count;
            }
        }
        panic!("the mark was not found");
    };
    assert_eq!((found_at(0), found_at(4)), (98, 98), "both inverters off");
    assert_eq!((found_at(2), found_at(6)), (96, 96), "both on");
}

/// Feed hold that is on at the start stays on until it is released.
/// It does not matter who asked for it.
#[test]
fn hold_is_taken_over_from_the_card() {
    let machine = MachineConfig { lines: MachineLines::standard(), may_arm: true };
    let mut card = Bench { outputs: HOLD, ..Bench::default() };
    let engine = Engine::new(&mut card, &[windowed()], machine, &[]).unwrap();
    let mut rig = Rig { engine, card, events: Vec::new() };
    rig.looks(3);
    assert_eq!((rig.status().mode, rig.status().held), (CorrectorMode::Hold, Some(FeedHoldSource::FoundOn)));
    assert_eq!((rig.card.outputs & HOLD, rig.card.writes), (HOLD, 1));
    rig.take(RequestToRt::Hold { on: true, by: 5 });
    assert_eq!(rig.status().held, Some(FeedHoldSource::FoundOn), "whoever came first");
    rig.take(RequestToRt::Hold { on: false, by: 5 });
    assert_eq!((rig.status().mode, rig.card.outputs & HOLD), (CorrectorMode::Disabled, 0));
}

#[test]
fn a_real_card_without_its_set_up_is_not_armed_but_may_be_watched() {
    let mut rig = Rig::with(windowed(), false);
    rig.take(RequestToRt::Home { axis: 0, position_counts: 0, controller_homed: true });
    rig.take(RequestToRt::ConfirmHome { axis: 0, position_counts: 0 });
    rig.take(RequestToRt::Enable);
    assert_eq!((rig.refusals(), rig.status().mode), (vec![Refusal::NotArmable], CorrectorMode::Disabled));
    rig.take(RequestToRt::Shadow);
    assert_eq!(rig.status().mode, CorrectorMode::Shadow);
}

#[test]
fn operator_hold_asserts_the_line_and_freezes() {
    let mut rig = Rig::running(windowed());
    rig.step(1);
    rig.correct(2);
    rig.take(RequestToRt::Hold { on: true, by: 0 });
    rig.correct(6);
    rig.take(RequestToRt::Enable);
    rig.take(RequestToRt::Shadow);
    assert_eq!(rig.refusals(), [Refusal::Held; 3], "nothing may come on by itself when hold ends");
    rig.step(10);
    assert_eq!((rig.card.outputs & HOLD, rig.status().axes[0].completed), (HOLD, 0));
    assert!(rig.status().enabled && rig.status().held == Some(FeedHoldSource::User(0)));
    rig.take(RequestToRt::Hold { on: false, by: 0 });
    rig.step(10);
    assert_eq!((rig.card.outputs & HOLD, rig.status().axes[0].completed), (0, 2));
}

#[test]
fn an_axis_that_is_not_there_is_refused() {
    let mut rig = Rig::running(windowed());
    rig.take(RequestToRt::Correct { axis: 1, total_counts: 2, large: false });
    rig.take(RequestToRt::Home { axis: 9, position_counts: 0, controller_homed: true });
    assert_eq!(rig.refusals(), [Refusal::NoSuchAxis; 2]);
}
