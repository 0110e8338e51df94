//! Every history of looks, edges and inversions within a bound.
//! It covers all their orders, and all times at which inversions take effect.
//!
//! Time is divided into slots of 50 ns, three to a look. Each slot may hold a real edge, before or after the time at
//! which a write takes effect. Each look may be late, each write may fail, and after each look the process may end and
//! start again. A tape records these choices. The engine is run from the start for every possible tape (stateless model
//! checking, Godefroid 1997). The code under test is the engine's own, without a copy or a model.
//!
//! | what | choices | judged by |
//! |---|---|---|
//! | within | edges of some motion within the axis's limits: sets of reachable speeds, by another formula than the gate's | ledger balanced, no fault, no edge inside an insertion, the MTC's separation kept |
//! | disturbed | the same, with a late look, a failed write or a restart | balanced or latched |
//! | beyond | any edges, up to three in a look | balanced or latched. Two exceptions cannot be seen: two edges between the same two looks as an inversion, or while the MTC counts mirrored |
//!
//! A fault planted in each rule must be found. `RTEC_EXHAUSTIVE=1` widens the bounds.

#![allow(clippy::unwrap_used)]

use rtec_driver::card::{AxisLines, Card, CardError, CardInputSample, MachineLines};
use rtec_rt::axis::{AxisConfig, INCREMENT_COUNTS, InsertionAtRestPolicy};
use rtec_rt::engine::{Engine, MachineConfig};
use rtec_rt::link_messages::RequestToRt;
use std::collections::HashSet;
use std::hash::{DefaultHasher, Hash, Hasher};

const SLOT_NS: u64 = 50;
const LOOK: u64 = 3;
const SEPARATION_NS: u64 = 100;
const HYSTERESIS: f64 = 0.1;

/// Acceleration limit of an axis that can turn just after an insertion, counts/ns².
/// The axis turns back two slots later than an insertion needs.
fn accel_counts_ns2() -> f64 {
    // Detection and separation, then for each inversion: the look that finds it in effect, separation, and the next
    // look.
    let look_ns = (LOOK * SLOT_NS) as f64;
    let need_ns =
        look_ns + SEPARATION_NS as f64 + INCREMENT_COUNTS as f64 * (2.0 * look_ns + SEPARATION_NS as f64);
    2.0 * HYSTERESIS / (need_ns + 2.0 * SLOT_NS as f64).powi(2)
}

/// The choices of one history, in order: the one taken, of how many.
#[derive(Debug, Default)]
struct Tape {
    taken: Vec<(u8, u8)>,
    at: usize,
}

impl Tape {
    fn choose(&mut self, of: u8) -> u8 {
        if of < 2 {
            return 0;
        }
        if self.at == self.taken.len() {
            self.taken.push((0, of));
        }
        let (choice, known) = self.taken[self.at];
        assert_eq!(known, of, "the same history has other choices: something is not repeatable");
        self.at += 1;
        choice
    }

    /// Goes to the next history; `false` after the last.
    fn next(&mut self) -> bool {
        self.taken.truncate(self.at);
        self.at = 0;
        while let Some((choice, of)) = self.taken.pop() {
            if choice + 1 < of {
                self.taken.push((choice + 1, of));
                return true;
            }
        }
        false
    }
}

/// Possible speeds of an axis within its limits at its last edge.
/// They are in counts/ns, along the direction of the axis.
#[derive(Debug, Clone, Copy)]
struct Motion {
    accel_counts_ns2: f64,
    hysteresis_counts: f64,
    at_ns: u64,
    sense: i64,
    speeds: (f64, f64),
}

impl Motion {
    /// The motion after an edge at `at_ns` in the direction `step`.
    /// `None` where no motion within the limits makes that edge.
    ///
    /// The edge is at distance d from v₀ after τ with |a| ≤ A. It is possible if e = d − v₀τ is within ±Aτ²/2. The
    /// speed at the end is between v₀ ± A(2√(τ²/2 ± e/A) − τ), by full acceleration one way and then the other.
    fn edge(&self, at_ns: u64, step: i64) -> Option<Self> {
        const PIECES: usize = 48;
        let (a, tau) = (self.accel_counts_ns2, (at_ns - self.at_ns) as f64);
        let along = step == self.sense;
        // The distance to the next mark, or back over the one just crossed, which is the hysteresis.
        let d = if along { 1.0 } else { -self.hysteresis_counts };
        let reach = a * tau / 2.0;
        let from = (self.speeds.0.max(d / tau - reach), self.speeds.1.min(d / tau + reach));
        if from.0 > from.1 {
            return None;
        }
        let (mut lo, mut hi) = (f64::INFINITY, f64::NEG_INFINITY);
        for k in 0..=PIECES {
            let v0 = from.0 + (from.1 - from.0) * k as f64 / PIECES as f64;
            // At the limits of the possible, rounding may exceed them.
            let e = (d - v0 * tau).clamp(-reach * tau, reach * tau);
            let fastest = v0 + a * (2.0 * (tau * tau / 2.0 + e / a).sqrt() - tau);
            let slowest = v0 - a * (2.0 * (tau * tau / 2.0 - e / a).sqrt() - tau);
            let (slowest, fastest) = if along { (slowest, fastest) } else { (-fastest, -slowest) };
            if fastest >= 0.0 {
                lo = lo.min(slowest.max(0.0));
                hi = hi.max(fastest);
            }
        }
        (hi >= lo).then_some(Self { at_ns, sense: step, speeds: (lo, hi), ..*self })
    }
}

/// A planted mistake of the configuration, or none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Plant {
    Nothing,
    /// The inverters of A and B are swapped.
    /// So the two inversions come in the wrong order.
    Order,
    /// The MTC needs two slots more than configured.
    Separation,
    /// The time of a write is configured as zero.
    /// So the gate opens where the next edge is too near.
    Gate,
    /// The axis turns back sooner than configured.
    TurnRound,
    /// The card sleeps beyond the wake time.
    Wake,
}

/// Bounds of the choices, and the configuration of the axis.
#[derive(Debug, Clone, Copy)]
struct Case {
    /// Direction of the axis before the choices begin.
    sense: i64,
    /// Requested total, counts.
    asked: i64,
    /// Place in the cycle of four counts at the start.
    phase: i64,
    /// Slots between the two edges that set the period.
    period: u64,
    /// Number of looks with choices.
    looks: u64,
    edges: u8,
    late: u8,
    failures: u8,
    restarts: u8,
    within: bool,
    plant: Plant,
}

/// Levels of A and B at each count of the cycle, in the positive direction.
const CYCLE: [u64; 4] = [0b00, 0b01, 0b11, 0b10];

/// Edges and inversions between two looks.
#[derive(Debug, Default)]
struct Between {
    edges: u32,
    /// An inversion took effect.
    ours: bool,
    /// An edge came while the MTC counted mirrored.
    mirrored: bool,
}

/// Scale, XOR gates, MTC and computer.
struct World<'a> {
    tape: &'a mut Tape,
    case: Case,
    slot: u64,
    /// Edges that are given: slot and direction. The chosen edges follow them.
    given: Vec<(u64, i64)>,
    choices: bool,
    /// Slot of the last given edge; no edge is chosen before it.
    second: u64,
    left: (u8, u8, u8),
    motion: Option<Motion>,
    scale: i64,
    mtc: i64,
    out: i64,
    outputs: u64,
    flying: Option<(u64, u64)>,
    changed_ns: Option<u64>,
    closest_ns: u64,
    disturbed: bool,
    between: Between,
    hidden: bool,
    /// Every change at the MTC, for the report of a failure.
    changes: Vec<(u64, bool)>,
}

impl World<'_> {
    fn levels(&self) -> u64 {
        CYCLE[self.scale.rem_euclid(4) as usize]
    }

    fn mtc_looks(&mut self, t_ns: u64) {
        let seen = self.levels() ^ self.outputs & 3;
        let place = CYCLE.iter().position(|&s| s == seen).unwrap() as i64;
        match (place - self.out).rem_euclid(4) {
            0 => return,
            1 => self.mtc += 1,
            3 => self.mtc -= 1,
            _ => panic!("an illegal state at the MTC"),
        }
        self.out = place;
        self.changes.push((t_ns, t_ns.is_multiple_of(SLOT_NS)));
        if let Some(before_ns) = self.changed_ns.replace(t_ns) {
            self.closest_ns = self.closest_ns.min(t_ns - before_ns);
        }
    }

    fn land(&mut self) {
        if let Some((slot, outputs)) = self.flying.take_if(|(slot, _)| *slot <= self.slot) {
            self.outputs = outputs;
            self.between.ours = true;
            self.mtc_looks(slot * SLOT_NS);
        }
    }

    /// Lets one slot pass: a write takes effect, then an edge may come.
    fn pass(&mut self) {
        self.land();
        let at_ns = self.slot * SLOT_NS + SLOT_NS / 2;
        let step = if let Some(n) = self.given.iter().position(|(slot, _)| *slot == self.slot) {
            self.given.swap_remove(n).1
        } else if self.choices && self.slot > self.second && self.left.0 > 0 {
            let may = |step| !self.case.within || self.motion.is_none_or(|m| m.edge(at_ns, step).is_some());
            let options: Vec<i64> = [0, 1, -1].into_iter().filter(|&step| step == 0 || may(step)).collect();
            let step = options[usize::from(self.tape.choose(options.len() as u8))];
            self.left.0 -= u8::from(step != 0);
            step
        } else {
            0
        };
        if step != 0 {
            // Only the direction of the first edge is known. Beyond the limits nothing is known.
            let any = Motion {
                accel_counts_ns2: accel_counts_ns2(),
                hysteresis_counts: if self.case.plant == Plant::TurnRound {
                    HYSTERESIS / 4.0
                } else {
                    HYSTERESIS
                },
                at_ns,
                sense: step,
                speeds: (0.0, 1.0 / SLOT_NS as f64),
            };
            self.motion = match self.motion {
                Some(before) if self.case.within => Some(before.edge(at_ns, step).unwrap()),
                _ => Some(any),
            };
            self.scale += step;
            self.between.edges += 1;
            self.between.mirrored |= matches!(self.outputs & 3, 1 | 2);
            self.mtc_looks(at_ns);
        }
        self.slot += 1;
    }
}

impl Card for World<'_> {
    fn sample(&mut self, wake_ns: u64) -> Result<CardInputSample, CardError> {
        let mut slots = LOOK;
        if self.choices && self.left.1 > 0 && self.tape.choose(2) == 1 {
            self.left.1 -= 1;
            self.disturbed = true;
            slots = 10 * LOOK;
        }
        if self.case.plant == Plant::Wake && self.choices && wake_ns / SLOT_NS > self.slot {
            slots += 5 * LOOK;
        }
        for _ in 0..slots {
            self.pass();
        }
        self.land();
        let between = std::mem::take(&mut self.between);
        self.hidden |= between.edges > 1 && (between.ours || between.mirrored);
        Ok(CardInputSample::level(self.slot * SLOT_NS, self.levels()))
    }

    fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError> {
        if self.choices && self.left.2 > 0 && self.tape.choose(2) == 1 {
            self.left.2 -= 1;
            self.disturbed = true;
            return Err(CardError::Io { op: "write", errno: 5 });
        }
        let (mask, value) = if self.case.plant == Plant::Order {
            (mask >> 1 & 1 | (mask & 1) << 1, value >> 1 & 1 | (value & 1) << 1)
        } else {
            (mask, value)
        };
        let after = if self.choices { u64::from(self.tape.choose(LOOK as u8 + 1)) } else { 0 };
        self.flying = Some((self.slot + after, self.outputs & !mask | value & mask));
        Ok(None)
    }

    fn outputs(&mut self) -> Result<u64, CardError> {
        Ok(self.outputs)
    }
}

#[derive(Debug, Default)]
struct Tally {
    histories: u64,
    looks: u64,
    insertions: u64,
    latched: u64,
    /// Histories that end with a lost count and no fault.
    /// Two edges fell in one look beside an inversion, or while the MTC counted mirrored.
    unseen: u64,
    states: HashSet<u64>,
}

fn config(case: &Case) -> AxisConfig {
    let look_ns = LOOK * SLOT_NS;
    AxisConfig {
        lines: AxisLines::standard(0, false),
        rest: InsertionAtRestPolicy::Wait,
        min_separation_ns: SEPARATION_NS,
        max_accel_counts_s2: accel_counts_ns2() * 1e18,
        hysteresis_counts: HYSTERESIS,
        detect_ns: look_ns,
        // A write is in effect by the next look, which confirms it, and the next write follows a look later.
        write_ns: if case.plant == Plant::Gate { 0 } else { 2 } * look_ns,
        ..AxisConfig::default()
    }
}

/// Runs one history; an error says what is wrong with it.
fn history(tape: &mut Tape, case: Case, tally: &mut Tally) -> Result<(), String> {
    const FIRST: u64 = 9;
    // The edges fall at any place within a look.
    let second = FIRST + case.period + u64::from(tape.choose(LOOK as u8));
    let given = vec![(second - case.period, case.sense), (second, case.sense)];
    let mut world = World {
        tape,
        case,
        slot: 0,
        given,
        choices: false,
        second,
        left: (case.edges, case.late, case.failures),
        motion: None,
        scale: case.phase,
        mtc: 0,
        out: 0,
        outputs: 0,
        flying: None,
        changed_ns: None,
        closest_ns: u64::MAX,
        disturbed: false,
        between: Between::default(),
        hidden: false,
        changes: Vec::with_capacity(16),
    };
    world.out = case.phase.rem_euclid(4);
    let told = config(&case);
    let machine = MachineConfig { lines: MachineLines::default(), may_arm: true };
    let quiet = &mut |_| true;
    let mut engine = Engine::new(&mut world, &[told], machine, &[]).unwrap();
    engine.start_homed(&mut world, quiet).unwrap();
    let ask = RequestToRt::Correct { axis: 0, total_counts: case.asked, large: true };
    engine.take(ask, &mut world, quiet).unwrap();
    while world.slot + LOOK <= second {
        engine.poll(&mut world, u64::MAX, quiet).unwrap();
    }
    world.choices = true;
    let (mut restarts, mut failed) = (case.restarts, false);
    for _ in 0..case.looks {
        if let Err(error) = engine.poll(&mut world, u64::MAX, quiet) {
            engine.card_failed(error, quiet);
            failed = true;
            break;
        }
        tally.looks += 1;
        note(&mut tally.states, &engine, &world);
        if restarts > 0 && world.tape.choose(2) == 1 {
            restarts -= 1;
            world.disturbed = true;
            let known = engine.in_effect(0).unwrap().1;
            // A process takes longer to start than a write takes to be in effect.
            for _ in 0..2 * LOOK {
                world.pass();
            }
            engine = Engine::new(&mut world, &[told], machine, &[known]).map_err(|e| e.to_string())?;
        }
    }
    tally.histories += 1;
    world.choices = false;
    if !case.within {
        // The axis moves on regularly, because a mistake shows at the next edges if at all.
        let from = world.slot.next_multiple_of(LOOK) + 20;
        world.given = (0..4).map(|n| (from + 60 * n, case.sense)).collect();
    }
    let until = world.slot + if case.within { 14 * LOOK } else { 100 * LOOK };
    while !failed && world.slot < until {
        engine.poll(&mut world, u64::MAX, quiet).map_err(|e| e.to_string())?;
    }
    let axis = engine.status().axes[0];
    tally.insertions += axis.insertions;
    let offset = world.mtc - (world.scale - case.phase);
    let balanced = engine.in_effect(0).unwrap().1 == offset && engine.at_rest();
    let faults: Vec<_> = axis.faults.iter().collect();
    let latched = failed || !faults.is_empty();
    tally.latched += u64::from(latched);
    if case.within && !world.disturbed {
        let needed_ns = SEPARATION_NS + if case.plant == Plant::Separation { 2 * SLOT_NS } else { 0 };
        if latched || !balanced || axis.overlaps > 0 || world.closest_ns < needed_ns {
            return Err(format!(
                "within the limits: {faults:?}, the MTC {offset} beyond the scale, the engine believes {:?}, {} edges \
                 inside an insertion, {} ns apart at the MTC (ns, ours: {:?})",
                engine.in_effect(0),
                axis.overlaps,
                world.closest_ns,
                world.changes
            ));
        }
    } else if !latched && !balanced {
        if case.within || !world.hidden {
            return Err(format!(
                "the MTC {offset} beyond the scale, the engine believes {:?}",
                engine.in_effect(0)
            ));
        }
        tally.unseen += 1;
    }
    Ok(())
}

/// Notes the state of engine and world, as far as later events depend on it.
fn note(states: &mut HashSet<u64>, engine: &Engine, world: &World) {
    let axis = engine.status().axes[0];
    let mut hash = DefaultHasher::new();
    (world.levels(), world.outputs, world.flying.map(|(slot, to)| (slot - world.slot.min(slot), to)))
        .hash(&mut hash);
    (world.mtc - world.scale, engine.in_effect(0), axis.requested, axis.homed, engine.at_rest())
        .hash(&mut hash);
    (world.slot * SLOT_NS - world.motion.map_or(0, |m| m.at_ns), world.left).hash(&mut hash);
    (world.changed_ns.map(|t| world.slot * SLOT_NS - t), format!("{:?}", axis.gate)).hash(&mut hash);
    axis.faults.iter().for_each(|f| f.hash(&mut hash));
    states.insert(hash.finish());
}

/// Runs every history of a case until one is wrong.
fn all(case: Case, tally: &mut Tally) -> Result<(), String> {
    let mut tape = Tape::default();
    loop {
        history(&mut tape, case, tally).map_err(|e| format!("{e}; {case:?}, choices {:?}", tape.taken))?;
        if !tape.next() {
            return Ok(());
        }
    }
}

fn wide() -> bool {
    std::env::var_os("RTEC_EXHAUSTIVE").is_some()
}

const WITHIN: Case = Case {
    sense: 1,
    asked: 4,
    phase: 0,
    period: 36,
    looks: 14,
    edges: 2,
    late: 0,
    failures: 0,
    restarts: 0,
    within: true,
    plant: Plant::Nothing,
};

/// A case in both directions of axis and correction, from each place in the cycle.
fn turned(case: Case) -> impl Iterator<Item = Case> {
    [1, -1].into_iter().flat_map(move |sense| {
        [1, -1].into_iter().flat_map(move |sign| {
            (0..4).map(move |phase| Case { sense, asked: sign * case.asked, phase, ..case })
        })
    })
}

fn run(name: &str, cases: impl Iterator<Item = Case>) -> Tally {
    let mut tally = Tally::default();
    let mut count = 0;
    for case in cases {
        count += 1;
        if let Err(wrong) = all(case, &mut tally) {
            panic!("{name}: {wrong}");
        }
    }
    println!(
        "{name}: {count} cases, {} histories, {} looks, {} states, {} insertions, {} latched, lost where nobody can see {}",
        tally.histories,
        tally.looks,
        tally.states.len(),
        tally.insertions,
        tally.latched,
        tally.unseen
    );
    assert!(tally.insertions > 0, "{name}: nothing was inserted");
    tally
}

#[test]
fn within_its_limits_no_history_loses_a_count() {
    let looks = if wide() { 22 } else { 14 };
    let edges = if wide() { 3 } else { 2 };
    // The fastest period that the gate admits, and a slower one.
    let first = config(&WITHIN).gate().unwrap().min_period_ns().div_ceil(SLOT_NS);
    for period in [first + 2 * LOOK, 3 * first] {
        run(&format!("within {period}"), turned(Case { period, looks, edges, ..WITHIN }));
    }
}

#[test]
fn late_looks_failed_writes_and_restarts_balance_or_are_latched() {
    let looks = if wide() { 10 } else { 7 };
    let base = Case { period: 36, looks, edges: 1, ..WITHIN };
    run("late", turned(Case { late: 1, ..base }));
    run("failed", turned(Case { failures: 1, ..base }));
    run("restart", turned(Case { restarts: 1, ..base }));
}

#[test]
fn beyond_its_limits_every_history_balances_is_latched_or_cannot_be_seen() {
    let looks = if wide() { 6 } else { 4 };
    let edges = if wide() { 4 } else { 3 };
    let tally = run("beyond", turned(Case { period: 36, looks, edges, within: false, ..WITHIN }));
    assert!(tally.latched > 0 && tally.unseen > 0, "{tally:?}");
}

#[test]
fn a_fault_planted_in_each_rule_is_found() {
    for plant in [Plant::Order, Plant::Separation, Plant::Gate, Plant::TurnRound, Plant::Wake] {
        let found = [14, 36, 76].into_iter().find_map(|period| {
            turned(Case { period, plant, ..WITHIN }).find_map(|case| all(case, &mut Tally::default()).err())
        });
        println!("{plant:?}: {}", found.as_deref().unwrap_or("NOT FOUND"));
        assert!(found.is_some(), "{plant:?} was not found");
    }
}
