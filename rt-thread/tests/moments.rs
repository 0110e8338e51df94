//! What happens at exactly which moment: a card whose looks, edges and writes have the times that a test gives them.
//!
//! The boundaries of the engine's rules stand in its documentation; each is tried at the last nanosecond on either side.

#![allow(clippy::unwrap_used)]

use rtec_driver::card::{AxisLines, Card, CardError, MachineLines, Sample};
use rtec_driver::quadrature::{Decoder, Signal, State};
use rtec_rt::axis::{AxisConfig, RestPolicy};
use rtec_rt::engine::{Engine, MachineConfig};
use rtec_rt::event::{Event, EventKind, Fault, Faults, GateState, Mode, Refusal, Request};
use rtec_rt::journal::{Journal, StateRecord};
use std::path::PathBuf;

const PROBE: u64 = 1 << 28;
const BOTH: u64 = 0b11;

#[derive(Default)]
struct Hand {
    t_ns: u64,
    inputs: u64,
    outputs: u64,
    /// The time of the change that the next look shows, on a card that stamps.
    stamp: Option<u64>,
    /// Lines on which nothing passes unseen.
    complete: u64,
    /// So long after its order a write is in effect, and the card says so.
    tells_ns: Option<u64>,
    /// Time and outputs.
    writes: Vec<(u64, u64)>,
    /// Until when the last look might have slept.
    wake_ns: u64,
    /// Looked into at each write.
    state_file: Option<PathBuf>,
    noted: Vec<Vec<u8>>,
}

impl Card for Hand {
    fn sample(&mut self, wake_ns: u64) -> Result<Sample, CardError> {
        self.wake_ns = wake_ns;
        Ok(Sample {
            edge_ns: self.stamp.take(),
            complete: self.complete,
            ..Sample::level(self.t_ns, self.inputs)
        })
    }

    fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError> {
        self.outputs = self.outputs & !mask | value & mask;
        if mask & (1 << 28) == 0 {
            self.writes.push((self.t_ns, self.outputs));
        }
        self.noted.extend(self.state_file.as_ref().map(|file| std::fs::read(file).unwrap()));
        Ok(self.tells_ns.map(|ns| self.t_ns + ns))
    }

    fn outputs(&mut self) -> Result<u64, CardError> {
        Ok(self.outputs)
    }
}

struct Rig {
    engine: Engine,
    card: Hand,
    events: Vec<Event>,
    keep: bool,
}

impl Rig {
    /// Homed and enabled, at 1000 ns.
    fn new(configs: &[AxisConfig], card: Hand) -> Self {
        let mut card = Hand { t_ns: 1000, ..card };
        let machine = MachineConfig { lines: MachineLines::standard(), may_arm: true };
        let mut engine = Engine::new(&mut card, configs, machine, &[]).unwrap();
        engine.start_homed(&mut card, &mut |_| true).unwrap();
        Self { engine, card, events: Vec::new(), keep: true }
    }

    /// One axis that never accelerates: the next edge comes no sooner than the last did.
    fn steady(config: AxisConfig, card: Hand) -> Self {
        Self::new(&[AxisConfig { max_accel_counts_s2: 0.0, ..one(config) }], card)
    }

    fn take(&mut self, request: Request) {
        let Self { engine, card, events, keep } = self;
        let report = &mut |e| {
            events.push(e);
            *keep
        };
        engine.take(request, card, report).unwrap();
    }

    fn correct(&mut self, total_counts: i64) {
        self.take(Request::Correct { axis: 0, total_counts, large: false });
    }

    fn look(&mut self, t_ns: u64) {
        self.card.t_ns = t_ns;
        let Self { engine, card, events, keep } = self;
        let report = &mut |e| {
            events.push(e);
            *keep
        };
        engine.poll(card, u64::MAX, report).unwrap();
    }

    /// Looks every 10 ns, the last at `until_ns`.
    fn looks(&mut self, until_ns: u64) {
        while self.card.t_ns < until_ns {
            self.look((self.card.t_ns + 10).min(until_ns));
        }
    }

    /// An edge of an axis, in a direction, that a look at this time shows.
    fn edge_of(&mut self, axis: u8, up: bool, t_ns: u64) {
        let lines = AxisLines::standard(axis, false);
        let next = lines.scale(self.card.inputs).next(up);
        for (bit, level) in [(lines.a, next.a()), (lines.b, next.b())] {
            self.card.inputs = self.card.inputs & !(1 << bit) | u64::from(level) << bit;
        }
        self.look(t_ns);
    }

    fn edge(&mut self, up: bool, t_ns: u64) {
        self.edge_of(0, up, t_ns);
    }

    /// The same on a card that stamps it at that very time.
    fn stamped(&mut self, up: bool, t_ns: u64) {
        self.card.stamp = Some(t_ns);
        self.edge(up, t_ns);
    }

    fn faults(&self) -> Vec<Fault> {
        let fault = |e: &Event| if let EventKind::Fault(f) = e.kind { Some(f) } else { None };
        self.events.iter().filter_map(fault).collect()
    }

    fn refusals(&self) -> Vec<Refusal> {
        let why = |e: &Event| if let EventKind::Refused { why, .. } = e.kind { Some(why) } else { None };
        self.events.iter().filter_map(why).collect()
    }

    /// Times of the writes, ns after `from_ns`.
    fn written(&self, from_ns: u64) -> Vec<u64> {
        self.card.writes.iter().map(|(t_ns, _)| t_ns - from_ns).collect()
    }
}

fn one(config: AxisConfig) -> AxisConfig {
    AxisConfig { lines: AxisLines::standard(0, config.lines.read_back.is_some()), ..config }
}

/// A card that stamps its edges and tells when a write is in effect: 20 ns after its order.
fn stamping() -> Hand {
    Hand { complete: u64::MAX, tells_ns: Some(20), ..Hand::default() }
}

fn resting(after_ns: u64) -> AxisConfig {
    AxisConfig { rest: RestPolicy::Insert { after_ns }, ..AxisConfig::default() }
}

#[test]
fn the_time_that_an_insertion_needs_is_the_sum_of_all_its_delays() {
    let config = AxisConfig { detect_ns: 7, write_ns: 11, guard_ns: 13, ..AxisConfig::default() };
    assert_eq!(config.gate().unwrap().need_ns(), 7 + 500 + 2 * (11 + 500) + 13);
}

#[test]
fn an_insertion_begins_within_the_promise_of_its_gate_and_at_no_other_time() {
    // Edges 10 µs apart, and so no other before 10 µs have passed; two separations before it the insertion must begin, and one after
    // the edge it may.
    let guard_ns = 30;
    for (at_ns, begun, late) in [(499, 0, 0), (500, 1, 0), (10_000 - 1030, 1, 0), (10_000 - 1029, 0, 1)] {
        let mut rig = Rig::steady(AxisConfig { guard_ns, ..AxisConfig::default() }, stamping());
        rig.stamped(true, 10_000);
        rig.correct(2);
        rig.stamped(true, 20_000);
        assert_eq!(rig.engine.status().axes[0].gate, GateState::Inserting);
        rig.look(20_000 + at_ns);
        let axis = rig.engine.status().axes[0];
        assert_eq!((rig.card.writes.len(), axis.late), (begun, late), "{at_ns} ns after the edge");
        assert_eq!(rig.events.iter().filter(|e| e.kind == EventKind::Late).count() as u64, late);
    }
}

#[test]
fn what_an_opened_insertion_was_for_may_be_taken_back() {
    for (instead, written) in [
        (Request::Correct { axis: 0, total_counts: 4, large: false }, 1),
        (Request::Correct { axis: 0, total_counts: -2, large: false }, 0),
        (Request::Correct { axis: 0, total_counts: 0, large: false }, 0),
        (Request::Disable, 0),
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
    // 500 ns to the edge and twice to an inversion.
    for (period_ns, begun) in [(1500, 1), (1499, 0)] {
        let mut rig = Rig::steady(AxisConfig::default(), stamping());
        rig.correct(2);
        rig.stamped(true, 10_000);
        rig.stamped(true, 10_000 + period_ns);
        let axis = rig.engine.status().axes[0];
        assert_eq!(axis.waited_for_gate, 2 - begun, "the first edge tells no speed");
        assert_eq!(axis.gate, if begun == 1 { GateState::Inserting } else { GateState::TooFast });
        rig.look(10_500 + period_ns);
        assert_eq!(rig.card.writes.len() as u64, begun, "{period_ns} ns");
    }
}

#[test]
fn the_rate_cap_ends_at_its_very_moment() {
    // 1000 counts/s: 2 ms from an insertion of two counts to the next.
    for (early_ns, gate) in [(0, GateState::Inserting), (1, GateState::RateCap)] {
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
    // Told: in effect after 20 ns. Not told: at the next look, 10 ns on.
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
            // From the edge to the last order: once, and in no other figure.
            rig.stamped(true, 40_000);
            let times = rig.engine.timing().edge_to_done_ns.snapshot();
            assert_eq!((times.samples(), times.min(), times.max()), (1, due[1], due[1]));
        }
    }
}

/// Edges at 20 µs, one of them with an insertion or not.
/// Then one at `after_ns` from the earliest moment that the last can have come.
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
    // Back over 0.05 counts at 10⁶ counts/s²: √(2·0.05/10⁶) s.
    let turn_back_ns = 316_227;
    for detect_ns in [0, 1000] {
        for touched in [false, true] {
            let latched: &[Fault] = if touched { &[Fault::BeyondLimits] } else { &[] };
            let turn = |after_ns| sooner_than_allowed(touched, detect_ns, false, after_ns);
            assert_eq!(turn(turn_back_ns - detect_ns), (0, vec![]), "{detect_ns} {touched}");
            assert_eq!(turn(turn_back_ns - detect_ns - 1), (1, latched.to_vec()), "{detect_ns} {touched}");
            // On in the same direction: 20 µs before, and 0.1 µs less is more than it can gain.
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
    rig.take(Request::Probe(true));
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
    // Another trip before it is complete is a bounce; an edge is none.
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
    // A silent control side: enabled again, no edge is needed.
    let mut rig = Rig::new(&[one(resting(5000))], Hand::default());
    rig.correct(2);
    rig.engine.set_control_stale(true, &mut |_| true);
    rig.looks(20_000);
    assert_eq!(rig.card.writes.len(), 0);
    rig.engine.set_control_stale(false, &mut |_| true);
    rig.look(20_010);
    assert_eq!(rig.card.writes.len(), 0);
    rig.take(Request::Enable);
    rig.look(20_020);
    assert_eq!(rig.card.writes.len(), 1);
}

/// Scale and MTC as they really were: changes in the order of their times.
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

/// A stamped edge beside an inversion: before its order, after it was in effect, or between, where only an edge of the
/// same signal leaves no doubt. In every state, either way, beside the first and the second inversion.
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
            // With the inverters on from before, or off.
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
                // Of the two places where the second inversion can end, the one nearer to what was asked for.
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
            // In effect somewhere between order and answer, where only an edge of the same signal can fall.
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
fn a_status_says_why_an_axis_does_or_does_not_correct() {
    let mut rig = Rig::steady(AxisConfig::default(), stamping());
    let shown = |rig: &Rig| {
        let axis = rig.engine.status().axes[0];
        (axis.gate, axis.edge_rate_hz)
    };
    rig.look(2000);
    assert_eq!(shown(&rig), (GateState::Done, 0.0));
    rig.stamped(true, 10_000);
    rig.look(12_000);
    assert_eq!(shown(&rig), (GateState::Done, 0.0), "one edge alone tells no speed");
    rig.stamped(true, 20_000);
    assert_eq!(shown(&rig), (GateState::Done, 1e5));
    rig.correct(2);
    rig.look(24_000);
    assert_eq!(shown(&rig), (GateState::WaitingForEdge, 1e5));
    rig.look(36_000);
    assert_eq!(shown(&rig), (GateState::WaitingForEdge, 62_500.0), "it has become slower");
    rig.look(20_000 + 50_000_000);
    assert_eq!(shown(&rig), (GateState::WaitingForEdge, 20.0));
    rig.look(20_001 + 50_000_000);
    assert_eq!(shown(&rig), (GateState::AtRest, 0.0));
    rig.stamped(true, 80_000_000);
    assert_eq!(shown(&rig).0, GateState::Inserting);
    rig.looks(80_002_000);
    assert_eq!(shown(&rig).0, GateState::Done);
    // One that inserts at rest does not wait for an edge; what it may not do yet it waits for.
    let mut rig = Rig::new(&[one(resting(100_000_000))], stamping());
    rig.stamped(true, 10_000);
    rig.correct(2);
    rig.look(90_000_000);
    assert_eq!(shown(&rig), (GateState::WaitingForEdge, 0.0));
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
fn in_the_middle_of_an_insertion_nothing_is_homed_or_armed() {
    let mut rig = Rig::new(&[one(resting(5000))], Hand::default());
    rig.correct(2);
    while rig.card.writes.is_empty() {
        rig.look(rig.card.t_ns + 10);
    }
    assert!(!rig.engine.at_rest());
    for request in [
        Request::Home { axis: 0, position_counts: 7, controller_homed: true },
        Request::Enable,
        Request::Shadow,
    ] {
        rig.take(request);
    }
    assert_eq!(rig.refusals(), [Refusal::Busy; 3]);
    assert_eq!(rig.events.iter().map(|e| e.axis).collect::<Vec<_>>(), [Some(0), None, None]);
    rig.looks(20_000);
    assert!(rig.engine.at_rest());
    rig.take(Request::Home { axis: 0, position_counts: 7, controller_homed: true });
    assert_eq!(rig.engine.status().axes[0].position_counts, 7);
    rig.take(Request::ConfirmHome { axis: 0, position_counts: 8 });
    assert_eq!((rig.refusals()[3], rig.events.last().unwrap().axis), (Refusal::NotHomed, Some(0)));
}

/// What is under way is finished.
/// Only shadow mode's copy would be thrown away half done.
#[test]
fn corrections_are_switched_off_at_any_moment_but_for_the_middle_of_a_shadowed_insertion() {
    for (mode, refused) in [(Request::Enable, vec![]), (Request::Shadow, vec![Refusal::Busy])] {
        let mut rig = Rig::new(&[one(resting(5000))], Hand::default());
        rig.take(mode);
        rig.correct(2);
        while rig.engine.at_rest() {
            rig.look(rig.card.t_ns + 10);
        }
        rig.take(Request::Disable);
        assert_eq!(rig.refusals(), refused, "{mode:?}");
        rig.looks(20_000);
        rig.take(Request::Disable);
        assert_eq!((rig.refusals(), rig.engine.mode()), (refused, Mode::Disabled));
        assert!(rig.engine.at_rest() && rig.engine.status().balanced());
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
        assert_eq!((status.mode, rig.faults()), (Mode::Fault, vec![Fault::RecordLost]), "told once");
        assert_eq!(faults.iter().collect::<Vec<_>>(), [Fault::RecordLost]);
        assert_eq!((rig.events[0].axis, status.axes[0].homed), (axis, axis.is_none()));
    }
}

/// Corrected by four, then in shadow mode by two more while the scale goes on: what is really in effect stays four throughout.
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
    rig.take(Request::Shadow);
    rig.correct(6);
    for n in 1..=5 {
        edges(&mut rig, 1);
        let axis = rig.engine.status().axes[0];
        assert_eq!((axis.in_effect, axis.mtc_minus_scale), (4, 4), "after {n} edges: {axis:?}");
    }
    assert_eq!((rig.engine.status().axes[0].completed, rig.card.writes.len()), (6, writes));
    rig.take(Request::Enable);
    let axis = rig.engine.status().axes[0];
    assert_eq!((axis.completed, axis.mtc_minus_scale, axis.requested), (4, 4, 6));
    edges(&mut rig, 3);
    assert_eq!(rig.engine.status().axes[0].completed, 6);
    assert!(rig.engine.status().balanced() && rig.faults().is_empty(), "{:?}", rig.faults());
}

/// A' and B' do not follow, which is found out a separation after the inversion is in effect: at the very look at which the next
/// insertion is due.
#[test]
fn a_fault_that_a_look_finds_holds_back_what_is_due_at_it() {
    let config = AxisConfig { lines: AxisLines::standard(0, true), ..resting(510) };
    let mut rig = Rig::new(&[config], Hand::default());
    rig.correct(4);
    rig.looks(20_000);
    assert_eq!((rig.faults(), rig.card.writes.len()), (vec![Fault::ReadBackMismatch], 2));
}

/// An axis with a fault counts its edges and does no more.
/// Cleared and armed again it corrects at the next one.
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
    rig.take(Request::Clear);
    rig.take(Request::Enable);
    assert_eq!((rig.card.writes.len(), rig.engine.mode()), (0, Mode::Run));
    rig.stamped(true, 50_000);
    rig.looks(52_000);
    assert_eq!(rig.written(50_000), [500, 1020]);
}

/// A card that tells, looked at now and then: the first look after the inversion was in effect is enough.
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
        rig.take(Request::Correct { axis, total_counts: 2, large: false });
    }
    rig.looks(9000);
    let (a, b) = (6000, 6300);
    let due = [(a, 0b0001), (b, 0b0101), (a + 520, 0b0111), (b + 520, 0b1111)];
    assert_eq!(rig.card.writes, due);
    assert!(rig.engine.status().axes()[..2].iter().all(|axis| axis.completed == 2));
    assert!(rig.engine.status().balanced());
    // What one axis writes says nothing of when the other's was in effect: an edge after that is last, beyond doubt.
    let mut rig = Rig::new(&[config(0, 5000), config(1, 5010)], stamping());
    for axis in [0, 1] {
        rig.take(Request::Correct { axis, total_counts: 2, large: false });
    }
    rig.looks(6020);
    assert_eq!(rig.written(0), [6000, 6010]);
    rig.card.stamp = Some(6025);
    rig.edge(false, 6040);
    assert_eq!(rig.faults(), []);
    // Both at once: one write.
    let mut rig = Rig::new(&[config(0, 5000), config(1, 5000)], Hand::default());
    for axis in [0, 1] {
        rig.take(Request::Correct { axis, total_counts: -2, large: false });
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
    assert_eq!(engine.mode(), Mode::Disabled);
    engine.set_may_arm(true);
    engine.take(Request::Enable, &mut card, &mut |_| true).unwrap();
    assert_eq!(engine.mode(), Mode::Run);
}

/// The state file at each write has what that write makes.
/// And at each look at which a fault is found, the fault.
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
        let mut faults = Faults::NONE;
        fault.map(|f| faults.latch(f));
        Some(StateRecord { inverters, completed, faults, mtc_known: fault.is_none() })
    };
    let now = || found(&std::fs::read(&file).unwrap());
    assert_eq!(now(), record(0, 0, None), "noted from the start");
    rig.correct(2);
    rig.looks(8000);
    let noted: Vec<_> = rig.card.noted.iter().map(|bytes| found(bytes)).collect();
    assert_eq!(noted, [record(1, 1, None), record(3, 2, None)]);
    // Homed anew: what is in effect is nothing.
    rig.take(Request::Home { axis: 0, position_counts: 0, controller_homed: true });
    assert_eq!(now(), record(3, 0, None));
    rig.take(Request::ConfirmHome { axis: 0, position_counts: 0 });
    // A look so late that counts may have passed.
    for n in 1..=3 {
        rig.looks(10_000 + 10_000 * n - 10);
        rig.edge(true, 10_000 + 10_000 * n);
    }
    assert!(rig.faults().is_empty(), "{:?}", rig.faults());
    rig.look(60_000_000);
    assert_eq!((rig.faults(), now()), (vec![Fault::PollGap], record(3, 0, Some(Fault::PollGap))));
}
