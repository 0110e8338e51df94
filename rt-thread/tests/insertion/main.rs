//! The insertion logic against a simulated machine and MTC.
//! The card's looks come late, and its writes take effect some time after they were ordered. The decoder sees edges and
//! inversions in true order.

#![allow(clippy::unwrap_used)]

mod cases;

use proptest::prelude::*;
use rtec_driver::card::{AxisLines, Card, CardError, CardInputSample, MachineLines};
use rtec_rt::axis::{AxisConfig, InsertionAtRestPolicy};
use rtec_rt::engine::{Engine, MachineConfig};
use rtec_rt::link_messages::{CorrectorStatus, Event, EventKind, Fault, RequestToRt};
use std::collections::VecDeque;
use test_needs::motion::Motion;

/// Levels of A and B at each count of the cycle, in the positive direction.
const CYCLE: [(u8, u8); 4] = [(0, 0), (1, 0), (1, 1), (0, 1)];

fn state_at(count: i64) -> (u8, u8) {
    CYCLE[count.rem_euclid(4) as usize]
}

/// Delays of one computer: times between looks, and from a write to its effect.
trait Computer {
    fn gap_ns(&mut self) -> u64;
    fn write_ns(&mut self, gap_ns: u64) -> u64;
}

struct Rig<P> {
    /// Times, ns, and directions of the scale's edges.
    edges: Vec<(u64, i64)>,
    next: usize,
    scale: i64,
    t_ns: u64,
    outputs: u64,
    /// A write that is not in effect yet: (in effect at, outputs).
    flying: Option<(u64, u64)>,
    /// Every change at the XOR gates, in true order.
    /// The fields are time, scale count, inverters, and whether it is an inversion.
    log: Vec<(u64, i64, u64, bool)>,
    computer: P,
    /// The card timestamps edges and reports them one by one.
    /// It also reports when a write is in effect.
    stamps: bool,
    /// Timestamped edges not yet reported: (time, scale count after it).
    untold: VecDeque<(u64, i64)>,
    told: i64,
    next_gap: Option<u64>,
}

impl<P: Computer> Rig<P> {
    fn new(edges: Vec<(u64, i64)>, start: i64, computer: P, stamps: bool) -> Self {
        Self {
            edges,
            next: 0,
            scale: start,
            t_ns: 0,
            outputs: 0,
            flying: None,
            log: vec![(0, start, 0, false)],
            computer,
            stamps,
            untold: VecDeque::new(),
            told: start,
            next_gap: None,
        }
    }

    fn land(&mut self) {
        if let Some((t, outputs)) = self.flying.take() {
            self.outputs = outputs;
            self.log.push((t, self.scale, outputs & 3, true));
        }
    }

    /// Lets the world run to `t`, with edges and the pending write in true order.
    fn run_to(&mut self, t: u64) {
        while let Some(&(edge, step)) = self.edges.get(self.next).filter(|e| e.0 <= t) {
            if self.flying.is_some_and(|(w, _)| w <= edge) {
                self.land();
            }
            self.next += 1;
            self.scale += step;
            self.log.push((edge, self.scale, self.outputs & 3, false));
            self.untold.push_back((edge, self.scale));
        }
        if self.flying.is_some_and(|(w, _)| w <= t) {
            self.land();
        }
    }
}

impl<P: Computer> Card for Rig<P> {
    fn sample(&mut self, _wake_ns: u64) -> Result<CardInputSample, CardError> {
        // The recording ends between two insertions, some time after the last edge.
        let equal = self.flying.is_none() && matches!(self.outputs & 3, 0 | 3);
        if equal
            && self.next >= self.edges.len()
            && self.t_ns > self.edges.last().map_or(0, |e| e.0) + 100_000
        {
            return Err(CardError::Ended);
        }
        let gap = self.next_gap.take().unwrap_or_else(|| self.computer.gap_ns());
        let t = self.t_ns + gap;
        if self.stamps {
            if self.untold.is_empty() {
                let until = self.edges.get(self.next).map_or(t, |e| e.0.min(t));
                self.run_to(until);
                self.t_ns = until;
            }
            let edge = self.untold.pop_front();
            self.told = edge.map_or(self.told, |e| e.1);
            let (a, b) = state_at(self.told);
            return Ok(CardInputSample::stamped(self.t_ns, u64::from(a | b << 1), edge.map(|e| e.0)));
        }
        // The lines are read some time before the end of the look.
        self.run_to(t - gap / 4);
        let (a, b) = state_at(self.scale);
        self.t_ns = t;
        Ok(CardInputSample::level(t, u64::from(a | b << 1)))
    }

    fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError> {
        let outputs = self.outputs & !mask | value & mask;
        let gap = self.computer.gap_ns();
        // The read of the next look forces the write out before it.
        let delay = self.computer.write_ns(gap).min(gap - gap / 4);
        self.flying = Some((self.t_ns + delay, outputs));
        if self.stamps {
            self.t_ns += delay;
            self.run_to(self.t_ns);
            return Ok(Some(self.t_ns));
        }
        self.next_gap = Some(gap);
        Ok(None)
    }

    fn outputs(&mut self) -> Result<u64, CardError> {
        Ok(self.outputs)
    }
}

/// Counts and times at the MTC.
#[derive(Debug, Default, PartialEq, Eq)]
struct Seen {
    mtc_minus_scale: i64,
    illegal: u64,
    /// Shortest time from an inversion to its neighbour edge, ns.
    ours_ns: u64,
    /// Values of MTC − scale while both inverters were equal.
    offsets: Vec<i64>,
}

fn judge(log: &[(u64, i64, u64, bool)]) -> Seen {
    let out = |entry: &(u64, i64, u64, bool)| {
        let (a, b) = state_at(entry.1);
        (u64::from(a) ^ entry.2 & 1, u64::from(b) ^ entry.2 >> 1)
    };
    let position =
        |s: (u64, u64)| CYCLE.iter().position(|&(a, b)| (u64::from(a), u64::from(b)) == s).unwrap() as i64;
    let mut seen = Seen { ours_ns: u64::MAX, ..Seen::default() };
    let mut mtc = log[0].1;
    for pair in log.windows(2) {
        let step = (position(out(&pair[1])) - position(out(&pair[0]))).rem_euclid(4);
        match step {
            0 => continue,
            1 => mtc += 1,
            3 => mtc -= 1,
            _ => seen.illegal += 1,
        }
        if pair[1].3 || pair[0].3 && pair[0].0 > 0 {
            seen.ours_ns = seen.ours_ns.min(pair[1].0 - pair[0].0);
        }
        if pair[1].2 == 0 || pair[1].2 == 3 {
            seen.offsets.push(mtc - pair[1].1);
        }
    }
    seen.mtc_minus_scale = mtc - log.last().unwrap().1;
    seen
}

/// Runs the engine on a rig with totals requested at given times.
/// Returns what the MTC saw, the status and events.
fn run<P: Computer>(
    config: AxisConfig,
    mut rig: Rig<P>,
    totals: &[(u64, i64)],
) -> (Seen, CorrectorStatus, Vec<EventKind>) {
    let mut events = Vec::new();
    let mut tell = |e: Event| {
        events.push(e.kind);
        true
    };
    let machine = MachineConfig { lines: MachineLines::default(), may_arm: true };
    let config = AxisConfig { lines: AxisLines::standard(0, false), ..config };
    let mut engine = Engine::new(&mut rig, &[config], machine, &[]).unwrap();
    engine.start_homed(&mut rig, &mut tell).unwrap();
    let mut totals = totals.iter().peekable();
    while engine.poll(&mut rig, u64::MAX, &mut tell).is_ok() {
        while let Some(&&(_, total_counts)) = totals.peek().filter(|t| t.0 <= engine.now_ns()) {
            totals.next();
            engine
                .take(RequestToRt::Correct { axis: 0, total_counts, large: true }, &mut rig, &mut tell)
                .unwrap();
        }
    }
    rig.land();
    (judge(&rig.log), engine.status(), events)
}

/// A computer with a look every `look_ns`, whose writes are in effect at once.
struct Steady(u64);

impl Computer for Steady {
    fn gap_ns(&mut self) -> u64 {
        self.0
    }

    fn write_ns(&mut self, _gap: u64) -> u64 {
        1
    }
}

/// A computer with varying delays up to their limit, from a list of choices.
struct Jittery {
    choices: Vec<u16>,
    at: usize,
    max_gap_ns: u64,
}

impl Jittery {
    fn next(&mut self) -> u64 {
        self.at += 1;
        u64::from(self.choices[self.at % self.choices.len()])
    }
}

impl Computer for Jittery {
    fn gap_ns(&mut self) -> u64 {
        20 + self.next() * (self.max_gap_ns - 20) / u64::from(u16::MAX)
    }

    fn write_ns(&mut self, gap_ns: u64) -> u64 {
        1 + self.next() * gap_ns / u64::from(u16::MAX)
    }
}

/// Edges of an axis within an acceleration limit, through a scale with hysteresis.
fn motion(pieces: &[(i8, u16)], accel_counts_s2: f64, max_speed: f64, hysteresis: f64) -> Vec<(u64, i64)> {
    let mut motion = Motion::new(accel_counts_s2, max_speed, hysteresis);
    let mut edges: Vec<(u64, i64)> = Vec::new();
    for &(throttle, length_us) in pieces {
        let end_ns = motion.now_ns() + f64::from(length_us) * 1000.0;
        while motion.now_ns() < end_ns {
            if let Some((t_ns, step)) = motion.step(f64::from(throttle) / 127.0) {
                edges.push((edges.last().map_or(t_ns, |last| t_ns.max(last.0 + 1)), step));
            }
        }
    }
    edges
}

fn pieces() -> impl Strategy<Value = Vec<(i8, u16)>> {
    prop::collection::vec((any::<i8>().prop_map(|a| a.max(-127)), 10_u16..3000), 4..24)
}

fn totals() -> impl Strategy<Value = Vec<(u64, i64)>> {
    prop::collection::vec((0_u64..30_000_000, -40_i64..=40), 1..20).prop_map(|mut t| {
        t.sort_unstable();
        t
    })
}

/// Checks ledger, legality and separation, which hold whenever the gate is right.
fn assert_kept(seen: &Seen, status: &CorrectorStatus, separation_ns: u64) {
    let axis = &status.axes[0];
    assert!(!axis.faults.any(), "{axis:?}");
    assert_eq!(seen.illegal, 0);
    assert_eq!(seen.mtc_minus_scale, axis.completed);
    assert_eq!(axis.mtc_minus_scale, axis.completed);
    assert!(seen.ours_ns >= separation_ns, "{} ns beside our inversion", seen.ours_ns);
    assert!(seen.offsets.iter().all(|o| o % 2 == 0));
    assert_eq!(axis.completed % 2, 0);
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    /// Random motion with reversals and dither, random requests, random latencies.
    /// The latencies stay within the gate's configuration.
    #[test]
    fn the_ledger_balances_within_the_promise(
        pieces in pieces(), totals in totals(), choices in prop::collection::vec(any::<u16>(), 64),
        log_accel in 4.0..7.0_f64, stamps in any::<bool>(), max_gap_ns in 40_u64..400,
    ) {
        let accel = 10_f64.powf(log_accel);
        let hysteresis = 0.1;
        let config = AxisConfig {
            max_accel_counts_s2: accel * 1.001, hysteresis_counts: hysteresis * 0.9,
            // An edge is seen at the end of the next look at the latest, and acted on one look after its separation.
            detect_ns: 3 * max_gap_ns, write_ns: 2 * max_gap_ns, guard_ns: 50, ..AxisConfig::default()
        };
        prop_assume!(config.gate().is_some());
        let edges = motion(&pieces, accel, 300_000.0, hysteresis);
        let rig = Rig::new(edges, 0, Jittery { choices, at: 0, max_gap_ns }, stamps);
        let (seen, status, _) = run(config, rig, &totals);
        assert_kept(&seen, &status, 500);
        prop_assert_eq!(status.axes[0].overlaps, 0);
    }

    /// With latencies far too long, the ledger balances or a fault is latched.
    /// Edges come at any moment. An insertion never makes an illegal state.
    #[test]
    fn beyond_the_promise_it_balances_or_is_latched(
        times in prop::collection::vec((1_u64..5000, any::<bool>()), 1..400), totals in totals(),
        choices in prop::collection::vec(any::<u16>(), 64), stamps in any::<bool>(), max_gap_ns in 21_u64..1200,
        insert_at_rest in any::<bool>(),
    ) {
        let mut t = 1000;
        let edges: Vec<_> = times.iter().map(|&(dt, up)| { t += dt; (t, if up { 1 } else { -1 }) }).collect();
        let rest = if insert_at_rest { InsertionAtRestPolicy::Insert { after_ns: 2000 } } else { InsertionAtRestPolicy::Wait };
        let config = AxisConfig { rest, ..AxisConfig::default() };
        let totals: Vec<_> = totals.iter().map(|&(t, n)| (t / 100, n)).collect();
        let rig = Rig::new(edges, 0, Jittery { choices, at: 0, max_gap_ns }, stamps);
        let (seen, status, events) = run(config, rig, &totals);
        let axis = &status.axes[0];
        prop_assert_eq!(seen.illegal, 0);
        if axis.faults.any() {
            prop_assert!(events.iter().any(|e| matches!(e, EventKind::Fault(_))));
        } else if stamps || times.iter().all(|&(dt, _)| dt > 2 * max_gap_ns) {
            // Looks further apart can miss two edges that cancel out, with an inversion between them.
            prop_assert_eq!(seen.mtc_minus_scale, axis.completed);
            prop_assert_eq!(axis.mtc_minus_scale, axis.completed);
        }
    }
}
