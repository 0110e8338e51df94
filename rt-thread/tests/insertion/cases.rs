//! Single insertions, at every point and in every state.

use super::*;

/// A real edge at every point of an insertion, in steps of 25 ns.
/// It covers 4 states, 2 directions, both signs of the insertion and both directions of the edge. Regular edges come at
/// 100 and 200 µs. The total is requested at `ask_ns`, so that the insertion begins at `begin_ns`. Returns the overlaps
/// that were worked out and the faults that were latched.
fn an_edge_at_every_point(
    stamps: bool,
    rest: InsertionAtRestPolicy,
    ask_ns: u64,
    begin_ns: u64,
) -> (u64, Vec<Fault>) {
    let mut worked_out = 0;
    let mut latched = Vec::new();
    for start in 0..4_i64 {
        for direction in [1, -1] {
            for total in [2, -2] {
                for second in [1, -1] {
                    for at in (begin_ns - 500..begin_ns + 1500).step_by(25) {
                        let edges = vec![
                            (100_000, direction),
                            (200_000, direction),
                            (at, second),
                            (at + 700_000, direction),
                            (at + 1_200_000, direction),
                            (at + 1_700_000, direction),
                        ];
                        let rig = Rig::new(edges, start, Steady(40), stamps);
                        let config = AxisConfig { rest, ..AxisConfig::default() };
                        let (seen, status, events) = run(config, rig, &[(ask_ns, total)]);
                        let axis = &status.axes[0];
                        let what =
                            format!("{start} {direction} {total} {second} at {at} stamps {stamps}: {axis:?}");
                        assert_eq!(seen.illegal, 0, "{what}");
                        if axis.faults.any() {
                            assert!(!stamps, "a stamped order is never unknown: {what}");
                            latched.extend(events.iter().find_map(|e| match e {
                                EventKind::Fault(fault) => Some(*fault),
                                _ => None,
                            }));
                        } else {
                            assert_eq!(seen.mtc_minus_scale, axis.completed, "{what}");
                            assert_eq!(axis.completed, total, "served in the end: {what}");
                            worked_out += axis.overlaps;
                        }
                    }
                }
            }
        }
    }
    println!("{worked_out} worked out, {} latched: {:?}", latched.len(), latched.first());
    (worked_out, latched)
}

#[test]
fn a_real_edge_at_every_point_of_an_insertion_is_worked_out_where_its_order_is_certain() {
    let (worked_out, latched) = an_edge_at_every_point(true, InsertionAtRestPolicy::Wait, 150_000, 200_500);
    assert!(worked_out > 500 && latched.is_empty(), "{worked_out} overlaps worked out");
    // Polled, from rest and within the axis's limits, two looks tell the order unless an inversion lies between them.
    let rest = InsertionAtRestPolicy::Insert { after_ns: 400_000 };
    let (worked_out, latched) = an_edge_at_every_point(false, rest, 250_000, 600_000);
    assert!(worked_out > 500, "{worked_out} overlaps worked out");
    assert!(
        !latched.is_empty() && latched.len() < 128 && latched.iter().all(|f| *f == Fault::OrderUnknown),
        "{} of 2560 latched: only edges within a look of an inversion may",
        latched.len()
    );
}

/// Polled, an edge beyond the limits is latched, because it may hide two more.
#[test]
fn an_edge_inside_an_insertion_that_the_limits_forbid_is_latched() {
    let (worked_out, latched) = an_edge_at_every_point(false, InsertionAtRestPolicy::Wait, 150_000, 200_500);
    assert_eq!(worked_out, 0);
    assert!(latched.contains(&Fault::BeyondLimits) && latched.len() > 1000, "{} latched", latched.len());
}

/// The algorithm of NISTIR 4832 in every state and direction, without other events.
#[test]
fn every_state_direction_and_sign_is_served() {
    for start in 0..4_i64 {
        for direction in [1, -1] {
            for total in [4, -4, 40, -40] {
                let edges = (1..=200).map(|n| (n * 50_000, direction)).collect();
                let rig = Rig::new(edges, start, Steady(30), false);
                let (seen, status, _) = run(AxisConfig::default(), rig, &[(60_000, total)]);
                assert_kept(&seen, &status, 500);
                assert_eq!(status.axes[0].completed, total, "{start} {direction}");
            }
        }
    }
}

#[test]
fn a_remainder_smaller_than_one_increment_stays() {
    for (total, served) in [(7, 6), (-3, -2), (1, 0)] {
        let edges = (1..=200).map(|n| (n * 50_000, 1)).collect();
        let rig = Rig::new(edges, 0, Steady(30), false);
        let (seen, status, _) = run(AxisConfig::default(), rig, &[(60_000, total)]);
        assert_eq!((status.axes[0].completed, seen.mtc_minus_scale), (served, served));
    }
}

#[test]
fn at_rest_the_policy_decides() {
    for (rest, served) in
        [(InsertionAtRestPolicy::Wait, 0), (InsertionAtRestPolicy::Insert { after_ns: 10_000 }, 6)]
    {
        let config = AxisConfig { rest, ..AxisConfig::default() };
        let rig = Rig::new(vec![(10_000, 1)], 0, Steady(30), false);
        let (seen, status, _) = run(config, rig, &[(20_000, 6)]);
        assert_kept(&seen, &status, 500);
        assert_eq!(status.axes[0].completed, served);
    }
}

#[test]
fn no_insertion_while_the_axis_is_too_fast_and_catch_up_afterwards() {
    // At first 1 µs a count, which is too fast for 500 ns separation, then 100 µs a count.
    let fast = (1..=1000_u64).map(|n| (10_000 + n * 1000, 1));
    let slow = (1..=100_u64).map(|n| (1_010_000 + n * 100_000, 1));
    let config = AxisConfig { max_accel_counts_s2: 0.0, ..AxisConfig::default() };
    let rig = Rig::new(fast.chain(slow).collect(), 0, Steady(30), false);
    let (seen, status, _) = run(config, rig, &[(20_000, 20)]);
    assert_kept(&seen, &status, 500);
    assert_eq!(status.axes[0].completed, 20);
    assert!(status.axes[0].waited_for_gate > 900);
}

#[test]
fn the_rate_cap_spaces_insertions() {
    // 1000 counts/s: one insertion of 2 counts every 2 ms, with an edge every 100 µs for 10 ms.
    let edges = (1..=100_u64).map(|n| (n * 100_000, 1)).collect();
    let config = AxisConfig { max_rate_counts_s: 1000.0, ..AxisConfig::default() };
    let (seen, status, _) = run(config, Rig::new(edges, 0, Steady(50), false), &[(150_000, 100)]);
    assert_kept(&seen, &status, 500);
    assert_eq!(status.axes[0].completed, 10);
}

#[test]
fn an_illegal_transition_is_latched_and_corrections_freeze() {
    let mut edges: Vec<_> = (1..=20_u64).map(|n| (n * 100_000, 1)).collect();
    edges[10].1 = 2;
    let (seen, status, events) =
        run(AxisConfig::default(), Rig::new(edges, 0, Steady(50), false), &[(1_150_000, 4)]);
    let axis = &status.axes[0];
    assert_eq!((axis.illegal, axis.completed, seen.mtc_minus_scale), (1, 0, -2));
    assert!(!axis.homed);
    assert!(events.contains(&EventKind::Fault(Fault::IllegalTransition)));
}

#[test]
fn a_look_that_comes_too_late_is_latched_when_counts_may_have_passed() {
    struct Sleepy(u64);
    impl Computer for Sleepy {
        fn gap_ns(&mut self) -> u64 {
            self.0 += 1;
            if self.0 == 20_000 { 400_000 } else { 50 }
        }

        fn write_ns(&mut self, _gap: u64) -> u64 {
            1
        }
    }
    // 100 µs a count: four counts pass in 400 µs, and the fifth looks like the first.
    let edges = (1..=30_u64).map(|n| (n * 100_000, 1)).collect();
    let config = AxisConfig { max_accel_counts_s2: 1e3, hysteresis_counts: 0.1, ..AxisConfig::default() };
    let (_, status, events) = run(config, Rig::new(edges, 0, Sleepy(0), false), &[(150_000, 4)]);
    assert!(status.axes[0].faults.any());
    assert!(
        events.contains(&EventKind::Fault(Fault::PollGap))
            || events.contains(&EventKind::Fault(Fault::IllegalTransition))
    );
}
