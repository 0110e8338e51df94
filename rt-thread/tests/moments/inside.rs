//! Edges beside and inside an insertion, in their true order.

use super::*;

/// The MTC's count minus the scale's, and its illegal states, from the true order.
/// `edges` and `writes` are sorted by time.
fn mtc_beside_scale(start: State, edges: &[(u64, bool)], writes: &[(u64, u64)]) -> (i64, u64) {
    let (mut scale, mut inverters, mut count) = (start, 0, 0);
    let mut mtc = Decoder::new(start);
    let edges = edges.iter().map(|&(t_ns, up)| (t_ns, 0, Some(up), 0));
    let mut all: Vec<_> = edges.chain(writes.iter().map(|&(t_ns, out)| (t_ns, 1, None, out))).collect();
    all.sort_unstable();
    for (_, _, up, out) in all {
        match up {
            Some(up) => {
                scale = scale.next(up);
                count += if up { 1 } else { -1 };
            }
            None => inverters = (out & BOTH) as u8,
        }
        mtc.update(scale.inverted(inverters));
    }
    (mtc.count() - count, mtc.illegal())
}

/// A timestamped edge beside an inversion is counted in its true order.
/// It comes before the order to invert, after the effect, or between them. Between them only an edge of the same signal
/// leaves no doubt. All states, directions, and both inversions are covered.
#[test]
fn a_stamped_edge_beside_an_inversion_is_counted_in_the_order_that_it_had() {
    const BESIDE: [(i64, bool); 5] = [(-30, true), (0, true), (1, false), (20, false), (21, true)];
    let (mut overlaps, mut doubted) = (0, 0);
    for case in 0..64 {
        let [up, add, second, inverted] = [4, 8, 16, 32].map(|bit| case & bit != 0);
        for (beside_ns, certain) in BESIDE {
            let mut rig = Rig::new(&[one(resting(5000))], stamping());
            let start = case & 3;
            for n in 0..start {
                rig.stamped(true, 10_000 * (n + 1));
            }
            // The inverters are on from an earlier insertion, or off.
            let before = if inverted { 2 } else { 0 };
            rig.correct(before);
            rig.looks(rig.card.t_ns + 20_000);
            let made = rig.card.writes.len();
            let total = before + if add { 2 } else { -2 };
            rig.correct(total);
            while rig.card.writes.len() < made + if second { 2 } else { 1 } {
                rig.look(rig.card.t_ns + 10);
            }
            let (order_ns, out) = *rig.card.writes.last().unwrap();
            let out_before = rig.card.writes.iter().rev().nth(1).map_or(0, |(_, out)| *out);
            let signal = if (out ^ out_before) & 1 != 0 { Signal::A } else { Signal::B };
            let same = State::from_bits(rig.card.inputs as u8).signal_towards(up) == signal;
            let edge_ns = order_ns.wrapping_add_signed(beside_ns);
            rig.card.stamp = Some(edge_ns);
            rig.edge(up, order_ns + 100);
            let what = format!("case {case}, {beside_ns} ns beside its order, same signal: {same}");
            if !certain && !same {
                assert_eq!(rig.faults(), [Fault::OrderUnknown], "{what}");
                doubted += 1;
                continue;
            }
            if !second {
                // The second inversion can end in two places. It ends in the one nearer to the requested total.
                let half = rig.engine.in_effect(0).unwrap().1;
                rig.looks(order_ns + 1000);
                let nearer =
                    if (half + 1 - total).abs() < (half - 1 - total).abs() { half + 1 } else { half - 1 };
                assert_eq!((half % 2 != 0, rig.engine.in_effect(0).unwrap().1), (true, nearer), "{what}");
            }
            rig.looks(order_ns + 20_000);
            assert!(rig.faults().is_empty(), "{what}: {:?}", rig.faults());
            let axis = rig.engine.status().axes[0];
            assert!(rig.engine.at_rest() && axis.mtc_minus_scale == axis.completed, "{what}: {axis:?}");
            let earlier = (0..start).map(|n| (10_000 * (n + 1), true));
            let edges: Vec<_> = earlier.chain([(edge_ns, up)]).collect();
            // An inversion is in effect some time between order and confirmation, where only an edge of the same signal
            // can fall.
            let landed: Vec<_> = rig.card.writes.iter().map(|(t_ns, out)| (t_ns + 10, *out)).collect();
            let really = mtc_beside_scale(State::default(), &edges, &landed);
            assert_eq!((axis.completed, 0), really, "{what}: {axis:?}");
            assert_eq!(axis.completed, total, "{what}: asked again where it was missed");
            overlaps += axis.overlaps;
        }
    }
    assert!(overlaps > 20 && doubted > 20, "{overlaps} {doubted}");
}

#[test]
fn two_edges_inside_an_insertion_end_it_at_once() {
    for (edges, waited) in [(1, true), (2, false)] {
        let mut rig = Rig::new(&[one(resting(5000))], stamping());
        rig.correct(2);
        while rig.card.writes.is_empty() {
            rig.look(rig.card.t_ns + 10);
        }
        let order_ns = rig.card.t_ns;
        for n in 1..=edges {
            rig.stamped(true, order_ns + 50 * n);
        }
        assert_eq!(rig.card.writes.len(), if waited { 1 } else { 2 }, "{edges} edges");
        assert_eq!(rig.engine.status().axes[0].overlaps, edges);
        rig.looks(order_ns + 50 * edges + 499);
        assert_eq!(rig.card.writes.len(), if waited { 1 } else { 2 }, "the separation from the last edge");
        rig.look(order_ns + 50 * edges + 500);
        assert_eq!(rig.card.writes.len(), 2, "{edges} edges");
        assert!(rig.faults().is_empty());
    }
}

#[test]
fn both_signals_at_once_inside_an_insertion_are_edges_inside_it() {
    let mut rig = Rig::new(&[one(resting(5000))], stamping());
    rig.correct(2);
    while rig.card.writes.is_empty() {
        rig.look(rig.card.t_ns + 10);
    }
    for n in 1..=2 {
        assert_eq!(rig.card.writes.len(), 1);
        rig.card.inputs ^= BOTH;
        rig.look(rig.card.t_ns + 50 * n);
    }
    assert_eq!((rig.card.writes.len(), rig.faults()), (2, vec![Fault::IllegalTransition]));
    assert!(rig.engine.at_rest() && rig.engine.status().balanced());
}

#[test]
fn in_the_middle_of_an_insertion_nothing_is_homed_or_armed() {
    let mut rig = Rig::new(&[one(resting(5000))], Hand::default());
    rig.correct(2);
    while rig.card.writes.is_empty() {
        rig.look(rig.card.t_ns + 10);
    }
    assert!(!rig.engine.at_rest());
    for request in [
        RequestToRt::Home { axis: 0, position_counts: 7, controller_homed: true },
        RequestToRt::Enable,
        RequestToRt::Shadow,
    ] {
        rig.take(request);
    }
    assert_eq!(rig.refusals(), [Refusal::Busy; 3]);
    assert_eq!(rig.events.iter().map(|e| e.axis).collect::<Vec<_>>(), [Some(0), None, None]);
    rig.looks(20_000);
    assert!(rig.engine.at_rest());
    rig.take(RequestToRt::Home { axis: 0, position_counts: 7, controller_homed: true });
    assert_eq!(rig.engine.status().axes[0].position_counts, 7);
    rig.take(RequestToRt::ConfirmHome { axis: 0, position_counts: 8 });
    assert_eq!((rig.refusals()[3], rig.events.last().unwrap().axis), (Refusal::NotHomed, Some(0)));
}

/// Corrections can be switched off at any moment, and an insertion is finished.
/// Only shadow mode refuses while its copy is in the middle of an insertion.
#[test]
fn corrections_are_switched_off_at_any_moment_but_for_the_middle_of_a_shadowed_insertion() {
    for (mode, refused) in [(RequestToRt::Enable, vec![]), (RequestToRt::Shadow, vec![Refusal::Busy])] {
        let mut rig = Rig::new(&[one(resting(5000))], Hand::default());
        rig.take(mode);
        rig.correct(2);
        while rig.engine.at_rest() {
            rig.look(rig.card.t_ns + 10);
        }
        rig.take(RequestToRt::Disable);
        assert_eq!(rig.refusals(), refused, "{mode:?}");
        rig.looks(20_000);
        rig.take(RequestToRt::Disable);
        assert_eq!((rig.refusals(), rig.engine.mode()), (refused, CorrectorMode::Disabled));
        assert!(rig.engine.at_rest() && rig.engine.status().balanced());
    }
}
