//! When an insertion begins, and its distance from edges and writes.

use super::*;

#[test]
fn the_time_that_an_insertion_needs_is_the_sum_of_all_its_delays() {
    let config = AxisConfig { detect_ns: 7, write_ns: 11, guard_ns: 13, ..AxisConfig::default() };
    assert_eq!(config.gate().unwrap().need_ns(), 7 + 500 + 2 * (11 + 500) + 13);
}

#[test]
fn an_insertion_begins_within_the_promise_of_its_gate_and_at_no_other_time() {
    // Edges are 10 µs apart, so no other edge comes within 10 µs. The insertion may begin one separation after the
    // edge, and must begin two separations before the next.
    let guard_ns = 30;
    for (at_ns, begun, late) in [(499, 0, 0), (500, 1, 0), (10_000 - 1030, 1, 0), (10_000 - 1029, 0, 1)] {
        let mut rig = Rig::steady(AxisConfig { guard_ns, ..AxisConfig::default() }, stamping());
        rig.stamped(true, 10_000);
        rig.correct(2);
        rig.stamped(true, 20_000);
        assert_eq!(rig.engine.status().axes[0].gate, InsertionStatus::Inserting);
        rig.look(20_000 + at_ns);
        let axis = rig.engine.status().axes[0];
        assert_eq!((rig.card.writes.len(), axis.late), (begun, late), "{at_ns} ns after the edge");
        assert_eq!(rig.events.iter().filter(|e| e.kind == EventKind::Late).count() as u64, late);
    }
}

#[test]
fn what_an_opened_insertion_was_for_may_be_taken_back() {
    for (instead, written) in [
        (RequestToRt::Correct { axis: 0, total_counts: 4, large: false }, 1),
        (RequestToRt::Correct { axis: 0, total_counts: -2, large: false }, 0),
        (RequestToRt::Correct { axis: 0, total_counts: 0, large: false }, 0),
        (RequestToRt::Disable, 0),
    ] {
        let mut rig = Rig::steady(AxisConfig::default(), stamping());
        rig.stamped(true, 10_000);
        rig.correct(2);
        rig.stamped(true, 20_000);
        rig.take(instead);
        rig.look(20_500);
        assert_eq!(rig.card.writes.len(), written, "{instead:?}");
        assert_eq!(rig.engine.status().axes[0].late, 0, "given up, not late: {instead:?}");
    }
}

#[test]
fn the_shortest_period_of_the_gate_is_long_enough_and_a_nanosecond_less_is_not() {
    // 500 ns after the edge and after each of two inversions.
    for (period_ns, begun) in [(1500, 1), (1499, 0)] {
        let mut rig = Rig::steady(AxisConfig::default(), stamping());
        rig.correct(2);
        rig.stamped(true, 10_000);
        rig.stamped(true, 10_000 + period_ns);
        let axis = rig.engine.status().axes[0];
        assert_eq!(axis.waited_for_gate, 2 - begun, "the first edge tells no speed");
        assert_eq!(axis.gate, if begun == 1 { InsertionStatus::Inserting } else { InsertionStatus::TooFast });
        rig.look(10_500 + period_ns);
        assert_eq!(rig.card.writes.len() as u64, begun, "{period_ns} ns");
    }
}

#[test]
fn the_rate_cap_ends_at_its_very_moment() {
    // At 1000 counts/s, insertions of two counts are 2 ms apart.
    for (early_ns, gate) in [(0, InsertionStatus::Inserting), (1, InsertionStatus::RateCap)] {
        let config = AxisConfig { max_rate_counts_s: 1000.0, ..AxisConfig::default() };
        let mut rig = Rig::steady(config, stamping());
        rig.correct(4);
        rig.stamped(true, 10_000);
        rig.stamped(true, 20_000);
        rig.looks(22_000);
        let (done_ns, _) = *rig.card.writes.last().unwrap();
        rig.stamped(true, done_ns + 2_000_000 - early_ns);
        assert_eq!(rig.engine.status().axes[0].gate, gate, "{early_ns} ns early");
    }
}

#[test]
fn inversions_keep_their_separation_from_edge_and_write_and_no_more() {
    // A reported write is in effect after 20 ns, an unreported one at the next look, 10 ns later.
    for (tells_ns, after_ns) in [(Some(20), 520), (None, 510)] {
        for total in [2, -2] {
            let mut rig = Rig::steady(AxisConfig::default(), Hand { tells_ns, ..stamping() });
            rig.stamped(true, 10_000);
            rig.correct(total);
            rig.stamped(true, 20_000);
            rig.looks(29_000);
            let due = [500, 500 + after_ns];
            assert_eq!(rig.written(20_000), due, "{total} {tells_ns:?}");
            let axis = rig.engine.status().axes[0];
            assert_eq!((axis.completed, axis.insertions, axis.overlaps), (total, 1, 0));
            assert!(axis.inverted, "two inversions leave both inverters on");
            // The time from the edge to the last order appears once, and in no other figure.
            rig.stamped(true, 40_000);
            let times = rig.engine.timing().edge_to_done_ns.snapshot();
            assert_eq!((times.samples(), times.min(), times.max()), (1, due[1], due[1]));
        }
    }
}

/// Edges 20 µs apart with or without an insertion, then one at `after_ns`.
/// `after_ns` counts from the earliest time that the last edge can have. Returns the number of early edges and the
/// faults.
fn sooner_than_allowed(touched: bool, detect_ns: u64, up: bool, after_ns: u64) -> (u64, Vec<Fault>) {
    let config = AxisConfig { detect_ns, ..AxisConfig::default() };
    let mut rig = Rig::new(&[one(config)], Hand::default());
    if touched {
        rig.correct(2);
    }
    for n in 1..=5 {
        rig.looks(20_000 * n - 10);
        rig.edge(true, 20_000 * n);
    }
    assert_eq!(rig.engine.status().axes[0].beyond_limits, 0, "a steady axis keeps its limits");
    let since_ns = 100_000 - 10;
    rig.looks(since_ns + after_ns - 10);
    rig.edge(up, since_ns + after_ns);
    (rig.engine.status().axes[0].beyond_limits, rig.faults())
}

#[test]
fn an_edge_sooner_than_the_limits_allow_is_counted_and_latched_once_something_of_ours_was_made() {
    // The way back is 0.05 counts at 10⁶ counts/s², which takes √(2·0.05/10⁶) s.
    let turn_back_ns = 316_227;
    for detect_ns in [0, 1000] {
        for touched in [false, true] {
            let latched: &[Fault] = if touched { &[Fault::BeyondLimits] } else { &[] };
            let turn = |after_ns| sooner_than_allowed(touched, detect_ns, false, after_ns);
            assert_eq!(turn(turn_back_ns - detect_ns), (0, vec![]), "{detect_ns} {touched}");
            assert_eq!(turn(turn_back_ns - detect_ns - 1), (1, latched.to_vec()), "{detect_ns} {touched}");
            // In the same direction the last period was 20 µs, and 0.1 µs less is more than the axis can gain.
            let on = |after_ns| sooner_than_allowed(touched, detect_ns, true, after_ns);
            assert_eq!(on(19_990), (0, vec![]), "{detect_ns} {touched}");
            assert_eq!(on(19_900 - detect_ns), (1, latched.to_vec()), "{detect_ns} {touched}");
        }
    }
}

#[test]
fn the_first_edges_after_homing_break_no_limit() {
    for up in [true, false] {
        let mut rig = Rig::new(&[one(AxisConfig::default())], Hand::default());
        rig.looks(1990);
        rig.edge(true, 2000);
        rig.looks(2390);
        rig.edge(true, 2400);
        rig.looks(2490);
        assert_eq!(rig.engine.status().axes[0].beyond_limits, 0, "how fast it was nobody knows");
        rig.edge(up, 2500);
        assert_eq!(rig.engine.status().axes[0].beyond_limits, 1);
    }
}

#[test]
fn a_look_after_an_inversion_that_is_late_enough_for_a_turn_is_latched() {
    let latched = |complete: u64, late_ns: u64| {
        let mut rig = Rig::new(&[one(AxisConfig::default())], Hand { complete, ..Hand::default() });
        for n in 1..=3 {
            rig.looks(100_000 * n - 10);
            rig.edge(true, 100_000 * n);
        }
        rig.correct(2);
        rig.looks(399_990);
        rig.edge(true, 400_000);
        while rig.card.writes.is_empty() {
            rig.look(rig.card.t_ns + 10);
        }
        rig.look(rig.card.t_ns + late_ns);
        rig.faults()
    };
    assert_eq!(latched(0, 316_226), []);
    assert_eq!(latched(0, 316_227), [Fault::PollGap]);
    assert_eq!(latched(BOTH, 400_000), [], "a card that keeps every edge");
}

#[test]
fn a_capture_that_finds_no_edge_is_complete_a_tenth_of_a_second_after_the_trip() {
    let mut rig = Rig::new(&[one(AxisConfig::default())], Hand::default());
    rig.take(RequestToRt::Probe(true));
    rig.events.clear();
    rig.card.inputs |= PROBE;
    rig.look(5000);
    let end_ns = 5000 + 100_000_000;
    rig.look(6000);
    assert_eq!(rig.events, [], "one trip, and the line stays");
    rig.look(end_ns);
    assert_eq!(rig.card.wake_ns, end_ns + 1, "a card that sleeps is woken for it");
    assert_eq!(rig.events, []);
    rig.look(end_ns + 1);
    let [Event { kind: EventKind::Trip(capture), axis: Some(0), .. }] = rig.events[..] else {
        panic!("{:?}", rig.events)
    };
    assert_eq!((capture.trip_ns, capture.before, capture.after), ((1000, 5000), (0, None), None));
    // Another trip before the capture is complete is a bounce; an edge is not.
    rig.card.inputs &= !PROBE;
    rig.look(end_ns + 1000);
    rig.edge(true, end_ns + 2000);
    assert_eq!(rig.events.len(), 1);
    for n in 0..4 {
        rig.card.inputs ^= PROBE;
        rig.look(end_ns + 3000 + 1000 * n);
    }
    assert_eq!(rig.events[1..].iter().map(|e| e.kind).collect::<Vec<_>>(), [EventKind::Bounce]);
}

#[test]
fn a_card_that_sleeps_is_woken_when_something_is_due_and_not_before() {
    let mut rig = Rig::steady(AxisConfig::default(), stamping());
    rig.stamped(true, 10_000);
    rig.correct(2);
    rig.look(11_000);
    rig.look(11_001);
    assert_eq!(rig.card.wake_ns, u64::MAX, "nothing but an edge");
    rig.stamped(true, 20_000);
    rig.look(20_010);
    assert_eq!(rig.card.wake_ns, 20_500, "the separation from the edge");
    rig.look(20_500);
    rig.look(20_510);
    rig.look(20_520);
    assert_eq!(rig.card.wake_ns, 20_500 + 20 + 500, "the separation from the first inversion");
}

#[test]
fn at_rest_an_insertion_begins_after_the_quiet_time_where_one_is_asked_for() {
    let mut rig = Rig::new(&[one(resting(5000))], Hand::default());
    rig.looks(8000);
    assert_eq!((rig.card.writes.len(), rig.card.wake_ns), (0, u64::MAX), "nothing is asked for");
    rig.edge(true, 10_000);
    rig.correct(2);
    rig.looks(14_999);
    assert_eq!((rig.card.writes.len(), rig.card.wake_ns), (0, 15_000));
    rig.look(15_000);
    assert_eq!(rig.card.writes.len(), 1);
    // After a silent control side and a new `Enable`, no edge is needed.
    let mut rig = Rig::new(&[one(resting(5000))], Hand::default());
    rig.correct(2);
    rig.engine.set_control_stale(true, &mut |_| true);
    rig.looks(20_000);
    assert_eq!(rig.card.writes.len(), 0);
    rig.engine.set_control_stale(false, &mut |_| true);
    rig.look(20_010);
    assert_eq!(rig.card.writes.len(), 0);
    rig.take(RequestToRt::Enable);
    rig.look(20_020);
    assert_eq!(rig.card.writes.len(), 1);
}
