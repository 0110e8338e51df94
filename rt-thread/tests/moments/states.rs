//! Status, faults and journal at the moment of a change.

use super::*;

#[test]
fn a_status_says_why_an_axis_does_or_does_not_correct() {
    let mut rig = Rig::steady(AxisConfig::default(), stamping());
    let shown = |rig: &Rig| {
        let axis = rig.engine.status().axes[0];
        (axis.gate, axis.edge_rate_hz)
    };
    rig.look(2000);
    assert_eq!(shown(&rig), (InsertionStatus::Done, 0.0));
    rig.stamped(true, 10_000);
    rig.look(12_000);
    assert_eq!(shown(&rig), (InsertionStatus::Done, 0.0), "one edge alone tells no speed");
    rig.stamped(true, 20_000);
    assert_eq!(shown(&rig), (InsertionStatus::Done, 1e5));
    rig.correct(2);
    rig.look(24_000);
    assert_eq!(shown(&rig), (InsertionStatus::WaitingForEdge, 1e5));
    rig.look(36_000);
    assert_eq!(shown(&rig), (InsertionStatus::WaitingForEdge, 62_500.0), "it has become slower");
    rig.look(20_000 + 50_000_000);
    assert_eq!(shown(&rig), (InsertionStatus::WaitingForEdge, 20.0));
    rig.look(20_001 + 50_000_000);
    assert_eq!(shown(&rig), (InsertionStatus::AtRest, 0.0));
    rig.stamped(true, 80_000_000);
    assert_eq!(shown(&rig).0, InsertionStatus::Inserting);
    rig.looks(80_002_000);
    assert_eq!(shown(&rig).0, InsertionStatus::Done);
    // An axis that inserts at rest shows what it waits for while its rest time runs.
    let mut rig = Rig::new(&[one(resting(100_000_000))], stamping());
    rig.stamped(true, 10_000);
    rig.correct(2);
    rig.look(90_000_000);
    assert_eq!(shown(&rig), (InsertionStatus::WaitingForEdge, 0.0));
}

#[test]
fn a_total_at_its_limit_is_within_it() {
    let config = AxisConfig { window_counts: 30, max_correction_counts: 90, ..one(AxisConfig::default()) };
    let config = AxisConfig { warn_counts: 60, ..config };
    for sign in [1, -1] {
        let mut rig = Rig::new(&[config], Hand::default());
        let requested = |rig: &Rig| rig.engine.status().axes[0].requested;
        for total in [30, 59] {
            rig.correct(sign * total);
        }
        assert_eq!((requested(&rig), rig.events.len()), (sign * 59, 0));
        rig.correct(sign * 90);
        assert_eq!((requested(&rig), rig.refusals()), (sign * 59, vec![Refusal::NotBelieved]));
        rig.correct(sign * 89);
        rig.correct(sign * 90);
        let warned: Vec<_> = rig.events[1..].iter().map(|e| e.kind).collect();
        let warning = |total| EventKind::Warning { total_counts: sign * total };
        assert_eq!((requested(&rig), warned), (sign * 90, vec![warning(89), warning(90)]));
        rig.events.clear();
        rig.correct(sign * 91);
        let refused = EventKind::Refused { total_counts: sign * 91, why: Refusal::AboveMaximum };
        assert_eq!(rig.events, [Event { t_ns: 1000, axis: Some(0), kind: refused }]);
    }
}

#[test]
fn what_is_found_outside_the_loop_is_latched_for_its_axis_or_for_the_machine() {
    for axis in [Some(0), None] {
        let mut rig = Rig::new(&[one(AxisConfig::default())], Hand::default());
        let Rig { engine, card, events, .. } = &mut rig;
        for _ in 0..2 {
            let report = &mut |e| {
                events.push(e);
                true
            };
            engine.latch(axis, Fault::RecordLost, card, report).unwrap();
        }
        let status = rig.engine.status();
        let faults = if axis.is_some() { status.axes[0].faults } else { status.faults };
        assert_eq!((status.mode, rig.faults()), (CorrectorMode::Fault, vec![Fault::RecordLost]), "told once");
        assert_eq!(faults.iter().collect::<Vec<_>>(), [Fault::RecordLost]);
        assert_eq!((rig.events[0].axis, status.axes[0].homed), (axis, axis.is_none()));
    }
}

/// Shadow mode leaves the total in effect unchanged.
/// The axis is corrected by four, then in shadow mode by two more while the scale moves on.
#[test]
fn shadow_mode_leaves_what_is_in_effect_as_it_was() {
    let back = AxisLines::standard(0, true);
    let config = AxisConfig { lines: back, ..AxisConfig::default() };
    let mut rig = Rig::steady(config, stamping());
    let follow = |rig: &mut Rig| {
        let mtc = (rig.card.inputs ^ rig.card.outputs) & BOTH;
        rig.card.inputs = rig.card.inputs & BOTH | mtc << 2;
    };
    let edges = |rig: &mut Rig, n: u64| {
        for _ in 0..n {
            rig.stamped(true, rig.card.t_ns.next_multiple_of(10_000) + 10_000);
            for _ in 0..40 {
                follow(rig);
                rig.look(rig.card.t_ns + 100);
            }
        }
    };
    rig.correct(4);
    edges(&mut rig, 5);
    assert_eq!(rig.engine.status().axes[0].completed, 4);
    let writes = rig.card.writes.len();
    rig.take(RequestToRt::Shadow);
    rig.correct(6);
    for n in 1..=5 {
        edges(&mut rig, 1);
        let axis = rig.engine.status().axes[0];
        assert_eq!((axis.in_effect, axis.mtc_minus_scale), (4, 4), "after {n} edges: {axis:?}");
    }
    assert_eq!((rig.engine.status().axes[0].completed, rig.card.writes.len()), (6, writes));
    rig.take(RequestToRt::Enable);
    let axis = rig.engine.status().axes[0];
    assert_eq!((axis.completed, axis.mtc_minus_scale, axis.requested), (4, 4, 6));
    edges(&mut rig, 3);
    assert_eq!(rig.engine.status().axes[0].completed, 6);
    assert!(rig.engine.status().balanced() && rig.faults().is_empty(), "{:?}", rig.faults());
}

/// A look that finds a fault holds back the insertion that is due at it.
/// A' and B' do not follow. That is found one separation after the inversion is in effect, when the next insertion is
/// due.
#[test]
fn a_fault_that_a_look_finds_holds_back_what_is_due_at_it() {
    let config = AxisConfig { lines: AxisLines::standard(0, true), ..resting(510) };
    let mut rig = Rig::new(&[config], Hand::default());
    rig.correct(4);
    rig.looks(20_000);
    assert_eq!((rig.faults(), rig.card.writes.len()), (vec![Fault::ReadBackMismatch], 2));
}

/// An axis with a fault only counts its edges.
/// Cleared and enabled again, it corrects at the next edge.
#[test]
fn a_cleared_axis_corrects_at_its_next_edge() {
    let mut rig = Rig::steady(AxisConfig { error_counts: 50, ..AxisConfig::default() }, stamping());
    rig.stamped(true, 10_000);
    rig.correct(2);
    rig.correct(50);
    assert_eq!(rig.faults(), [Fault::ErrorLimit]);
    for n in 2..5 {
        rig.stamped(true, 10_000 * n);
        rig.looks(10_000 * n + 2000);
    }
    rig.take(RequestToRt::Clear);
    rig.take(RequestToRt::Enable);
    assert_eq!((rig.card.writes.len(), rig.engine.mode()), (0, CorrectorMode::Run));
    rig.stamped(true, 50_000);
    rig.looks(52_000);
    assert_eq!(rig.written(50_000), [500, 1020]);
}

/// One look after the inversion is in effect finds a wrong read-back.
/// The card reports when a write is in effect, and looks are rare.
#[test]
fn a_read_back_that_does_not_follow_is_found_whenever_one_looks() {
    let config = AxisConfig { lines: AxisLines::standard(0, true), ..resting(5000) };
    let mut rig = Rig::new(&[config], stamping());
    rig.correct(2);
    for n in 1..12 {
        rig.look(1000 + 997 * n);
    }
    assert_eq!(rig.faults(), [Fault::ReadBackMismatch]);
}

#[test]
fn every_axis_is_told_of_its_own_writes_alone() {
    let config = |axis, after_ns| AxisConfig { lines: AxisLines::standard(axis, false), ..resting(after_ns) };
    // The second axis begins 300 ns after the first; each keeps its own separation.
    let mut rig =
        Rig::new(&[config(0, 5000), config(1, 5300)], Hand { tells_ns: Some(20), ..Hand::default() });
    for axis in [0, 1] {
        rig.take(RequestToRt::Correct { axis, total_counts: 2, large: false });
    }
    rig.looks(9000);
    let (a, b) = (6000, 6300);
    let due = [(a, 0b0001), (b, 0b0101), (a + 520, 0b0111), (b + 520, 0b1111)];
    assert_eq!(rig.card.writes, due);
    assert!(rig.engine.status().axes()[..2].iter().all(|axis| axis.completed == 2));
    assert!(rig.engine.status().balanced());
    // A write of one axis does not tell when the other axis's write was in effect. An edge after that time is certainly
    // the last.
    let mut rig = Rig::new(&[config(0, 5000), config(1, 5010)], stamping());
    for axis in [0, 1] {
        rig.take(RequestToRt::Correct { axis, total_counts: 2, large: false });
    }
    rig.looks(6020);
    assert_eq!(rig.written(0), [6000, 6010]);
    rig.card.stamp = Some(6025);
    rig.edge(false, 6040);
    assert_eq!(rig.faults(), []);
    // Two axes due at once get one write.
    let mut rig = Rig::new(&[config(0, 5000), config(1, 5000)], Hand::default());
    for axis in [0, 1] {
        rig.take(RequestToRt::Correct { axis, total_counts: -2, large: false });
    }
    rig.looks(9000);
    assert_eq!(rig.card.writes, [(a, 0b1010), (a + 510, 0b1111)]);
}

#[test]
fn an_event_that_nobody_takes_is_counted() {
    let mut rig = Rig::new(&[one(AxisConfig::default())], Hand::default());
    rig.card.inputs ^= BOTH;
    rig.keep = false;
    rig.look(2000);
    let lost = rig.events.len() as u64;
    assert!(lost > 1, "{:?}", rig.events);
    assert_eq!(rig.engine.status().events_lost, lost);
    rig.keep = true;
    rig.card.inputs ^= 1;
    rig.look(3000);
    assert_eq!(rig.engine.status().events_lost, lost);
}

#[test]
fn arming_waits_for_the_real_time_set_up() {
    let mut card = Hand::default();
    let machine = MachineConfig { lines: MachineLines::standard(), may_arm: false };
    let mut engine = Engine::new(&mut card, &[one(AxisConfig::default())], machine, &[]).unwrap();
    engine.start_homed(&mut card, &mut |_| true).unwrap();
    assert_eq!(engine.mode(), CorrectorMode::Disabled);
    engine.set_may_arm(true);
    engine.take(RequestToRt::Enable, &mut card, &mut |_| true).unwrap();
    assert_eq!(engine.mode(), CorrectorMode::Run);
}

/// The state file at each write holds the state after that write.
/// At each look that finds a fault it holds the fault.
#[test]
fn everything_is_noted_before_it_is_made() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("state");
    let open = || Journal::open(&file, "moments").unwrap();
    let mut rig = Rig::new(&[one(resting(5000))], Hand::default());
    rig.engine.keep_journal(open().0).unwrap();
    rig.card.state_file = Some(file.clone());
    let found = |bytes: &[u8]| {
        let copy = folder.path().join("copy");
        std::fs::write(&copy, bytes).unwrap();
        Journal::open(&copy, "moments").unwrap().1.records[0][0]
    };
    let record = |inverters, completed, fault: Option<Fault>| {
        let mut faults = FaultSet::NONE;
        fault.map(|f| faults.latch(f));
        Some(AxisStateRecord { inverters, completed, faults, mtc_known: fault.is_none() })
    };
    let now = || found(&std::fs::read(&file).unwrap());
    assert_eq!(now(), record(0, 0, None), "noted from the start");
    rig.correct(2);
    rig.looks(8000);
    let noted: Vec<_> = rig.card.noted.iter().map(|bytes| found(bytes)).collect();
    assert_eq!(noted, [record(1, 1, None), record(3, 2, None)]);
    // After homing, the total in effect is zero.
    rig.take(RequestToRt::Home { axis: 0, position_counts: 0, controller_homed: true });
    assert_eq!(now(), record(3, 0, None));
    rig.take(RequestToRt::ConfirmHome { axis: 0, position_counts: 0 });
    // A look so late that counts may have passed.
    for n in 1..=3 {
        rig.looks(10_000 + 10_000 * n - 10);
        rig.edge(true, 10_000 + 10_000 * n);
    }
    assert!(rig.faults().is_empty(), "{:?}", rig.faults());
    rig.look(60_000_000);
    assert_eq!((rig.faults(), now()), (vec![Fault::PollGap], record(3, 0, Some(Fault::PollGap))));
}
