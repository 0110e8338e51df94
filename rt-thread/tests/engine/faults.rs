//! Faults that are latched, and the state that the next engine takes over.

use super::*;

#[test]
fn shadow_mode_counts_everything_and_writes_nothing() {
    let mut rig = Rig::with(windowed(), true);
    rig.take(RequestToRt::Home { axis: 0, position_counts: 0, controller_homed: true });
    rig.take(RequestToRt::ConfirmHome { axis: 0, position_counts: 0 });
    rig.take(RequestToRt::Shadow);
    rig.looks(1);
    let writes = rig.card.writes;
    rig.take(RequestToRt::Correct { axis: 0, total_counts: 6, large: true });
    rig.step(20);
    let axis = rig.status().axes[0];
    assert_eq!((axis.completed, axis.in_effect, axis.mtc_minus_scale), (6, 0, 0));
    assert_eq!(rig.card.writes, writes);
    // After enabling, the axis jumps by the requested total minus the total in effect.
    rig.take(RequestToRt::Enable);
    let axis = rig.status().axes[0];
    assert_eq!((axis.requested, axis.completed, axis.in_effect), (6, 0, 0));
    rig.step(20);
    assert_eq!(rig.status().axes[0].completed, 6);
    assert!(rig.status().balanced());
}

/// The first edge after shadow mode is counted from the present levels.
/// The scale may have moved by any number of counts meanwhile.
#[test]
fn shadow_mode_may_end_at_any_count() {
    for shadowed in 20..24 {
        let mut rig = Rig::running(windowed());
        rig.take(RequestToRt::Shadow);
        rig.correct(2);
        rig.step(shadowed);
        rig.take(RequestToRt::Enable);
        rig.step(3);
        rig.correct(4);
        rig.step(30);
        let axis = rig.status().axes[0];
        assert_eq!((axis.completed, axis.mtc_minus_scale), (4, 4), "after {shadowed} counts");
        assert!(rig.status().balanced() && rig.faults().is_empty(), "{:?}", rig.events);
    }
}

#[test]
fn a_silent_control_side_freezes_corrections_and_is_said() {
    let mut rig = Rig::running(windowed());
    rig.step(4);
    rig.correct(2);
    let mut events = Vec::new();
    rig.engine.set_control_stale(true, &mut |e: Event| {
        events.push(e.kind);
        true
    });
    rig.step(10);
    assert_eq!(
        (rig.status().axes[0].completed, rig.status().axes[0].gate),
        (0, InsertionStatus::ControlStale)
    );
    assert_eq!(events, [EventKind::ControlStale(true)]);
    assert_eq!(rig.status().events_lost, 0);
    // An event that the ring refuses is counted.
    rig.engine.set_control_stale(false, &mut |_| false);
    assert_eq!(rig.status().events_lost, 1);
    rig.step(10);
    assert_eq!((rig.status().axes[0].completed, rig.status().axes[0].gate), (0, InsertionStatus::Off));
    rig.take(RequestToRt::Enable);
    rig.step(10);
    assert_eq!(rig.status().axes[0].completed, 2);
}

#[test]
fn an_illegal_transition_holds_the_machine_and_needs_homing() {
    let mut rig = Rig::running(windowed());
    rig.step(4);
    rig.card.inputs ^= 3;
    rig.looks(2);
    assert_eq!((rig.faults(), rig.card.outputs & HOLD), (vec![Fault::IllegalTransition], HOLD));
    rig.take(RequestToRt::Clear);
    rig.correct(2);
    assert_eq!((rig.refusals(), rig.status().axes[0].homed), (vec![Refusal::NotHomed], false));
    assert_eq!(rig.status().axes[0].gate, InsertionStatus::NotHomed);
}

#[test]
fn a_card_that_fails_latches_and_says_so() {
    let mut rig = Rig::running(windowed());
    rig.card.broken = true;
    let error = rig.engine.poll(&mut rig.card, u64::MAX, &mut |_| true).unwrap_err();
    rig.engine.card_failed(error, &mut |_| true);
    assert_eq!(rig.status().mode, CorrectorMode::Fault);
    assert_eq!(rig.status().faults.iter().collect::<Vec<_>>(), [Fault::Card]);
}

#[test]
fn read_back_that_does_not_follow_is_latched() {
    let config = AxisConfig { rest: InsertionAtRestPolicy::Insert { after_ns: 0 }, ..AxisConfig::default() };
    let mut rig = Rig::wired_back(Bench::default(), config);
    rig.take(RequestToRt::Correct { axis: 0, total_counts: 2, large: true });
    rig.looks(40);
    assert_eq!(rig.faults(), [Fault::ReadBackMismatch]);
    assert!(rig.engine.at_rest(), "the pair is finished all the same: the MTC must not count mirrored");
}

#[test]
fn unequal_inverters_that_no_insertion_explains_are_not_started() {
    let mut card = Bench { outputs: 1, ..Bench::default() };
    let machine = MachineConfig { lines: MachineLines::default(), may_arm: true };
    let started = Engine::new(&mut card, &[AxisConfig::default()], machine, &[]);
    assert_eq!(started.err(), Some(StartError::HalfInverted(0)));
}

/// The process dies between the two inversions of an insertion.
/// It does so in every state, upwards and downwards, with the inverters off and on before. The next engine finishes the
/// insertion, the MTC counts as the scale does again, and the fault is latched.
#[test]
fn an_insertion_cut_in_two_is_finished_by_the_next_engine_and_latched() {
    for case in 0..16_i64 {
        let (start, sign, before) = (2 + case % 4, if case & 4 == 0 { 2 } else { -2 }, case >> 3);
        let mut rig = Rig::running(AxisConfig::default());
        rig.step(start);
        let lines = AxisLines::standard(0, false);
        let at_mtc = |card: &Bench| lines.scale(card.inputs).inverted(lines.inverters(card.outputs));
        let mut total = 0;
        if before == 1 {
            rig.correct(2);
            rig.step(1);
            total = 2;
        }
        assert_eq!(rig.status().axes[0].completed, total);
        let mut mtc = Decoder::new(at_mtc(&rig.card));
        let scale = rig.card.count;
        rig.correct(total + sign);
        rig.card.count += 1;
        rig.card.inputs = [0, 1, 3, 2][rig.card.count.rem_euclid(4) as usize];
        mtc.update(at_mtc(&rig.card));
        for _ in 0..100 {
            if lines.inverters(rig.card.outputs).is_multiple_of(3) {
                rig.looks(1);
            }
        }
        mtc.update(at_mtc(&rig.card));
        let (inverters, odd) = rig.engine.in_effect(0).unwrap();
        assert_eq!((inverters, odd), (lines.inverters(rig.card.outputs), total + sign / 2));

        // Another process on the same card.
        let Rig { mut card, .. } = rig;
        let machine = MachineConfig { lines: MachineLines::standard(), may_arm: true };
        let mut engine = Engine::new(&mut card, &[AxisConfig::default()], machine, &[odd]).unwrap();
        for _ in 0..50 {
            engine.poll(&mut card, u64::MAX, &mut |_| true).unwrap();
            mtc.update(at_mtc(&card));
        }
        let status = engine.status();
        assert!(engine.at_rest() && lines.inverters(card.outputs).is_multiple_of(3));
        assert_eq!((status.mode, card.outputs & HOLD), (CorrectorMode::Fault, HOLD));
        assert_eq!(status.axes[0].faults.iter().collect::<Vec<_>>(), [Fault::Interrupted]);
        let offset = total + mtc.count() - (card.count - scale);
        assert_eq!((mtc.illegal(), offset), (0, status.axes[0].completed), "{start} {sign} {before}");
        assert!(status.balanced() && offset % 2 == 0 && (offset - odd).abs() == 1);
    }
}

#[test]
fn inverters_left_on_are_taken_over_and_the_next_insertion_turns_them_off() {
    let mut card = Bench { outputs: 3, ..Bench::default() };
    let machine = MachineConfig { lines: MachineLines::default(), may_arm: true };
    let mut engine = Engine::new(&mut card, &[AxisConfig::default()], machine, &[14]).unwrap();
    let axis = engine.status().axes[0];
    assert_eq!((axis.completed, axis.inverted, axis.homed), (14, true, false));
    assert!(engine.status().balanced());
    engine.start_homed(&mut card, &mut |_| true).unwrap();
    let mut rig = Rig { engine, card, events: Vec::new() };
    rig.correct(-2);
    rig.step(10);
    assert_eq!((rig.status().axes[0].completed, rig.card.outputs & 3), (-2, 0));
}

#[test]
fn what_the_card_finds_is_latched_where_it_belongs() {
    let trouble = |kind, lines| {
        Some(CardInputSample { trouble: Some(CardFault { kind, lines }), ..CardInputSample::level(0, 0) })
    };
    for (kind, fault) in [
        (CardFaultKind::SequenceGap, Fault::SequenceGap),
        (CardFaultKind::QueueOverflow, Fault::QueueOverflow),
        (CardFaultKind::EdgeMissed, Fault::EdgeMissed),
        (CardFaultKind::CounterOverflow, Fault::CounterOverflow),
        (CardFaultKind::CounterError, Fault::CounterError),
    ] {
        let mut rig = Rig::running(windowed());
        rig.card.says = trouble(kind, 0b11);
        rig.looks(2);
        let status = rig.status();
        assert_eq!((status.mode, status.axes[0].homed), (CorrectorMode::Fault, false), "{fault:?}");
        assert_eq!(status.axes[0].faults.iter().collect::<Vec<_>>(), [fault]);
        assert_eq!((rig.faults(), rig.card.outputs & HOLD), (vec![fault], HOLD));
        // On a line of no axis the fault is the machine's.
        let mut rig = Rig::running(windowed());
        rig.card.says = trouble(kind, PROBE);
        rig.looks(2);
        assert_eq!(rig.status().faults.iter().collect::<Vec<_>>(), [fault]);
        assert_eq!((rig.status().axes[0].faults.any(), rig.status().mode), (false, CorrectorMode::Fault));
    }
}

#[test]
fn latches_a_channel_that_does_not_take_its_turn() {
    for channel in [1, 2] {
        for counts in [4, 5, 6, 7, -4, -5, -6, -7] {
            for keeps_edges in [false, true] {
                let mut rig = Rig::moved(counts, keeps_edges);
                rig.correct(40);
                // The first edge may still be regular, and is the last one that opens an insertion.
                rig.alone(channel, 15, 250);
                let (before, faults) = (rig.status().axes[0], rig.faults());
                assert!(
                    before.completed <= 2 && !faults.contains(&Fault::ChannelDead),
                    "{before:?} {faults:?}"
                );
                if before.completed == 0 {
                    assert_eq!(
                        (faults, before.gate),
                        (vec![], InsertionStatus::OneChannel),
                        "{channel} {counts}"
                    );
                }
                rig.alone(channel, 2, 250);
                assert!(rig.faults().contains(&Fault::ChannelDead), "{channel} {counts} {:?}", rig.faults());
                rig.alone(channel, 283, 250);
                let (after, status) = (rig.status().axes[0], rig.status());
                assert_eq!((status.mode, after.homed), (CorrectorMode::Fault, false));
                assert_eq!(after.completed, before.completed, "nothing is inserted beside a dead channel");
                assert!(status.balanced());
                assert_eq!(rig.card.outputs & HOLD, HOLD);
            }
        }
    }
}

#[test]
fn an_axis_that_trembles_over_one_boundary_waits() {
    for keeps_edges in [false, true] {
        let mut rig = Rig::moved(5, keeps_edges);
        // The axis is at rest. One channel changes every 317 µs, which is no sooner than the axis can turn.
        rig.step(1);
        let channel = if rig.card.count % 2 == 0 { 2 } else { 1 };
        rig.alone(channel, 1, 3170);
        rig.correct(40);
        rig.alone(channel, 1001, 3170);
        let axis = rig.status().axes[0];
        assert_eq!((rig.faults(), axis.completed, axis.gate), (vec![], 0, InsertionStatus::OneChannel));
        assert!(axis.waited_for_gate >= 1000);
        // The axis moves on, and everything is inserted.
        for _ in 0..60 {
            rig.card.count += 1;
            rig.card.inputs = [0, 1, 3, 2][rig.card.count.rem_euclid(4) as usize];
            rig.looks(3170);
        }
        assert_eq!((rig.faults(), rig.status().axes[0].completed), (vec![], 40));
    }
}

#[test]
fn an_axis_that_goes_to_and_fro_over_two_boundaries_has_both_channels() {
    let mut rig = Rig::moved(5, true);
    for _ in 0..100 {
        rig.step(2);
        rig.step(-2);
    }
    assert_eq!(rig.faults(), []);
}
