//! The engine as the control side sees it: requests, refusals, faults, modes, homing, probing, shadow.

#![allow(clippy::unwrap_used)]

use rtec_driver::card::{AxisLines, Card, CardError, MachineLines, Sample, Trouble, TroubleKind};
use rtec_driver::quadrature::Decoder;
use rtec_rt::axis::{AxisConfig, RestPolicy};
use rtec_rt::engine::{Engine, MachineConfig, StartError};
use rtec_rt::event::{
    Event, EventKind, Fault, GateState, HeldBy, Mode, OffBecause, Refusal, Request, Status,
};

const PROBE: u64 = 1 << 28;
const SWITCH: u64 = 1 << 29;
const READY: u64 = 1 << 30;
const HOLD: u64 = 1 << 28;

/// A card that a test turns by hand.
#[derive(Default)]
struct Bench {
    t_ns: u64,
    inputs: u64,
    outputs: u64,
    writes: usize,
    broken: bool,
    count: i64,
    /// What the next looks say beside the levels.
    /// `fresh` counts as said only with `says`.
    says: Option<Sample>,
}

impl Card for Bench {
    fn sample(&mut self, _wake_ns: u64) -> Result<Sample, CardError> {
        self.t_ns += 100;
        if self.broken {
            return Err(CardError::Io { op: "reading the lines", errno: 19 });
        }
        let level = Sample::level(self.t_ns, self.inputs);
        Ok(self.says.map_or(level, |s| Sample { t_ns: self.t_ns, inputs: self.inputs, ..s }))
    }

    fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError> {
        self.outputs = self.outputs & !mask | value & mask;
        self.writes += 1;
        Ok(None)
    }

    fn outputs(&mut self) -> Result<u64, CardError> {
        Ok(self.outputs)
    }
}

/// An engine on its bench.
struct Rig<C = Bench> {
    engine: Engine,
    card: C,
    events: Vec<Event>,
}

impl<C: Card> Rig<C> {
    fn on(mut card: C, config: AxisConfig, may_arm: bool) -> Self {
        let machine = MachineConfig { lines: MachineLines::standard(), may_arm };
        let engine = Engine::new(&mut card, &[config], machine, &[]).unwrap();
        Self { engine, card, events: Vec::new() }
    }

    /// Homed and enabled, A' and B' wired back.
    fn wired_back(card: C, config: AxisConfig) -> Self {
        let mut rig = Self::on(card, AxisConfig { lines: AxisLines::standard(0, true), ..config }, true);
        rig.engine.start_homed(&mut rig.card, &mut |_| true).unwrap();
        rig
    }

    fn take(&mut self, request: Request) {
        let events = &mut self.events;
        let tell = &mut |e| {
            events.push(e);
            true
        };
        self.engine.take(request, &mut self.card, tell).unwrap();
    }

    fn correct(&mut self, total_counts: i64) {
        self.take(Request::Correct { axis: 0, total_counts, large: false });
    }

    fn looks(&mut self, n: usize) {
        for _ in 0..n {
            let events = &mut self.events;
            let tell = &mut |e| {
                events.push(e);
                true
            };
            self.engine.poll(&mut self.card, u64::MAX, tell).unwrap();
        }
    }

    fn status(&self) -> Status {
        self.engine.status()
    }

    fn refusals(&self) -> Vec<Refusal> {
        let why = |e: &Event| if let EventKind::Refused { why, .. } = e.kind { Some(why) } else { None };
        self.events.iter().filter_map(why).collect()
    }

    fn faults(&self) -> Vec<Fault> {
        let fault = |e: &Event| if let EventKind::Fault(f) = e.kind { Some(f) } else { None };
        self.events.iter().filter_map(fault).collect()
    }
}

impl Rig {
    fn with(config: AxisConfig, may_arm: bool) -> Self {
        Self::on(Bench::default(), AxisConfig { lines: AxisLines::standard(0, false), ..config }, may_arm)
    }

    /// Homed and enabled.
    fn running(config: AxisConfig) -> Self {
        let mut rig = Self::with(config, true);
        rig.take(Request::Home { axis: 0, position_counts: 0, controller_homed: true });
        rig.take(Request::ConfirmHome { axis: 0, position_counts: 0 });
        rig.take(Request::Enable);
        assert_eq!(rig.status().mode, Mode::Run);
        rig.events.clear();
        rig
    }

    /// Moves the scale one count every 100 looks.
    fn step(&mut self, counts: i64) {
        for _ in 0..counts.abs() {
            self.card.count += counts.signum();
            let state = [0, 1, 3, 2][self.card.count.rem_euclid(4) as usize];
            self.card.inputs = self.card.inputs & !3 | state;
            self.looks(100);
        }
    }
}

fn windowed() -> AxisConfig {
    AxisConfig { window_counts: 3, max_correction_counts: 100, ..AxisConfig::default() }
}

#[test]
fn nothing_is_accepted_before_homing_and_the_read_back_must_agree() {
    let mut rig = Rig::with(windowed(), true);
    rig.correct(2);
    rig.take(Request::Enable);
    rig.take(Request::Home { axis: 0, position_counts: 5000, controller_homed: true });
    rig.correct(2);
    rig.take(Request::ConfirmHome { axis: 0, position_counts: 4999 });
    rig.take(Request::Enable);
    assert_eq!(rig.refusals(), [Refusal::NotHomed; 5]);
    assert_eq!(rig.status().axes[0].position_counts, 5000);
    rig.take(Request::ConfirmHome { axis: 0, position_counts: 5000 });
    rig.take(Request::Enable);
    assert_eq!((rig.status().mode, rig.refusals().len()), (Mode::Run, 5));
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
        assert_eq!((rig.status().axes[0].requested, rig.status().mode), (2, Mode::Run));
        // Believed again: the next doubt starts from the beginning.
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
    assert_eq!((rig.status().mode, rig.card.outputs & HOLD), (Mode::Fault, HOLD));
    rig.correct(2);
    assert_eq!(rig.refusals().last(), Some(&Refusal::FaultLatched));
    // The count is not in doubt: cleared, the axis is still homed, and corrections wait to be enabled.
    rig.take(Request::Clear);
    assert_eq!((rig.status().mode, rig.card.outputs & HOLD), (Mode::Disabled, 0));
    rig.take(Request::Enable);
    assert_eq!(rig.status().mode, Mode::Run);
}

#[test]
fn a_large_change_is_believed_when_flagged() {
    let mut rig = Rig::running(windowed());
    rig.take(Request::Correct { axis: 0, total_counts: 80, large: true });
    assert_eq!((rig.status().axes[0].requested, rig.refusals().len()), (80, 0));
}

#[test]
fn maximum_warning_and_error_limit() {
    let mut rig = Rig::running(AxisConfig { warn_counts: 10, error_counts: 20, ..windowed() });
    for total_counts in [101, -101, i64::MAX, i64::MIN] {
        rig.take(Request::Correct { axis: 0, total_counts, large: true });
    }
    assert_eq!(rig.refusals(), [Refusal::AboveMaximum; 4]);
    rig.take(Request::Correct { axis: 0, total_counts: -12, large: true });
    assert!(rig.events.iter().any(|e| e.kind == EventKind::Warning { total_counts: -12 }));
    rig.take(Request::Correct { axis: 0, total_counts: 20, large: true });
    assert_eq!((rig.faults(), rig.status().mode), (vec![Fault::ErrorLimit], Mode::Fault));
    assert_eq!(rig.status().axes[0].requested, -12);
}

#[test]
fn a_request_while_disabled_is_answered() {
    let mut rig = Rig::running(windowed());
    rig.take(Request::Disable);
    rig.correct(0);
    rig.correct(2);
    assert_eq!(rig.refusals(), [Refusal::Disabled; 2], "no total is taken and forgotten");
    rig.events.clear();
    rig.take(Request::Enable);
    rig.card.inputs |= SWITCH;
    rig.looks(2);
    assert_eq!(rig.status().mode, Mode::Disabled);
    rig.correct(2);
    rig.take(Request::Enable);
    assert_eq!(rig.refusals(), [Refusal::DisableSwitch; 2]);
    rig.card.inputs &= !SWITCH;
    rig.looks(2);
    assert_eq!((rig.status().mode, rig.status().off_because), (Mode::Disabled, OffBecause::Switch));
    rig.step(8);
    assert_eq!(rig.status().axes[0].insertions, 0, "a released switch enables nothing");
    rig.take(Request::Enable);
    assert_eq!(rig.status().mode, Mode::Run);
}

/// A control side that was silent and speaks again, a switch, an MTC that comes back: what came back enables nothing.
#[test]
fn nothing_that_comes_back_enables_corrections() {
    type Event<'a> = (&'a str, &'a dyn Fn(&mut Rig, bool), OffBecause);
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
        ("switch", &switch, OffBecause::Switch),
        ("MTC", &ready, OffBecause::Controller),
        ("control", &stale, OffBecause::ControlStale),
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
        assert_eq!((rig.status().mode, rig.status().axes[0].requested), (Mode::Run, 2), "{name}");
        for away in [true, false] {
            turn(&mut rig, away);
            let status = rig.status();
            assert_eq!((status.mode, status.enabled), (Mode::Disabled, false), "{name} {away}");
            assert_eq!(status.off_because, because, "{name}");
        }
        rig.step(12);
        assert_eq!(rig.status().axes[0].insertions, 0, "{name}");
    }
}

/// An MTC that was switched off has forgotten what it counted: until it is homed with the axis, nothing is enabled.
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
        assert_eq!((status.held, rig.card.outputs & HOLD != 0), (holds.then_some(HeldBy::Controller), holds));
        let home = |controller_homed| Request::Home { axis: 0, position_counts: 0, controller_homed };
        rig.take(home(true));
        assert_eq!(rig.refusals(), [Refusal::ControllerNotReady]);
        rig.events.clear();
        rig.card.inputs |= READY;
        rig.looks(2);
        assert_eq!(rig.card.outputs & HOLD != 0, holds, "hold does not fall by itself");
        rig.take(home(false));
        rig.take(Request::Hold { on: false, by: 0 });
        rig.take(Request::Enable);
        assert_eq!(rig.refusals(), [Refusal::ControllerUnknown, Refusal::NotHomed]);
        rig.take(home(true));
        rig.take(Request::ConfirmHome { axis: 0, position_counts: 0 });
        rig.take(Request::Enable);
        assert_eq!((rig.status().mode, rig.status().axes[0].in_effect), (Mode::Run, 0));
    }
}

/// Homing the scale alone keeps what the MTC counts.
/// It counts against the limit, and enabled again nothing moves.
#[test]
fn homing_the_scale_alone_keeps_the_total() {
    let config = AxisConfig { max_correction_counts: 10, ..windowed() };
    let mut rig = Rig::running(config);
    for round in 0..5 {
        rig.take(Request::Correct { axis: 0, total_counts: 10, large: true });
        rig.step(40);
        rig.take(Request::Home { axis: 0, position_counts: 7, controller_homed: false });
        rig.take(Request::ConfirmHome { axis: 0, position_counts: 7 });
        let axis = rig.status().axes[0];
        assert_eq!((axis.in_effect, axis.requested, axis.mtc_minus_scale), (10, 10, 10), "round {round}");
        assert_eq!((axis.position_counts, axis.homed, axis.mtc_known), (7, true, true));
        rig.take(Request::Correct { axis: 0, total_counts: 12, large: true });
    }
    assert_eq!(rig.refusals(), [Refusal::AboveMaximum; 5]);
    rig.take(Request::Home { axis: 0, position_counts: 7, controller_homed: true });
    let axis = rig.status().axes[0];
    assert_eq!((axis.in_effect, axis.requested, axis.mtc_minus_scale), (0, 0, 0));
    // After a fault that puts the count in doubt there is nothing to be kept.
    rig.engine.latch(Some(0), Fault::PollGap, &mut rig.card, &mut |_| true).unwrap();
    rig.take(Request::Clear);
    rig.events.clear();
    rig.take(Request::Home { axis: 0, position_counts: 7, controller_homed: false });
    assert_eq!(rig.refusals(), [Refusal::ControllerUnknown]);
}

/// An MTC that takes its zero where the reference mark and A and B are on: with both inverters on it finds it two counts away,
/// with both off where the scale alone has it.
#[test]
fn a_mark_that_the_mtc_gates_is_found_two_counts_away_under_inverters() {
    let found_at = |total_counts: i64| {
        let mut rig = Rig::running(windowed());
        rig.take(Request::Correct { axis: 0, total_counts, large: true });
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

/// Feed hold that is on when the engine starts stays on, whoever asked for it, until it is released.
#[test]
fn hold_is_taken_over_from_the_card() {
    let machine = MachineConfig { lines: MachineLines::standard(), may_arm: true };
    let mut card = Bench { outputs: HOLD, ..Bench::default() };
    let engine = Engine::new(&mut card, &[windowed()], machine, &[]).unwrap();
    let mut rig = Rig { engine, card, events: Vec::new() };
    rig.looks(3);
    assert_eq!((rig.status().mode, rig.status().held), (Mode::Hold, Some(HeldBy::FoundOn)));
    assert_eq!((rig.card.outputs & HOLD, rig.card.writes), (HOLD, 1));
    rig.take(Request::Hold { on: true, by: 5 });
    assert_eq!(rig.status().held, Some(HeldBy::FoundOn), "whoever came first");
    rig.take(Request::Hold { on: false, by: 5 });
    assert_eq!((rig.status().mode, rig.card.outputs & HOLD), (Mode::Disabled, 0));
}

#[test]
fn a_real_card_without_its_set_up_is_not_armed_but_may_be_watched() {
    let mut rig = Rig::with(windowed(), false);
    rig.take(Request::Home { axis: 0, position_counts: 0, controller_homed: true });
    rig.take(Request::ConfirmHome { axis: 0, position_counts: 0 });
    rig.take(Request::Enable);
    assert_eq!((rig.refusals(), rig.status().mode), (vec![Refusal::NotArmable], Mode::Disabled));
    rig.take(Request::Shadow);
    assert_eq!(rig.status().mode, Mode::Shadow);
}

#[test]
fn shadow_mode_counts_everything_and_writes_nothing() {
    let mut rig = Rig::with(windowed(), true);
    rig.take(Request::Home { axis: 0, position_counts: 0, controller_homed: true });
    rig.take(Request::ConfirmHome { axis: 0, position_counts: 0 });
    rig.take(Request::Shadow);
    rig.looks(1);
    let writes = rig.card.writes;
    rig.take(Request::Correct { axis: 0, total_counts: 6, large: true });
    rig.step(20);
    let axis = rig.status().axes[0];
    assert_eq!((axis.completed, axis.in_effect, axis.mtc_minus_scale), (6, 0, 0));
    assert_eq!(rig.card.writes, writes);
    // Arming goes on from what is really there: the jump is requested minus in effect.
    rig.take(Request::Enable);
    let axis = rig.status().axes[0];
    assert_eq!((axis.requested, axis.completed, axis.in_effect), (6, 0, 0));
    rig.step(20);
    assert_eq!(rig.status().axes[0].completed, 6);
    assert!(rig.status().balanced());
}

/// Wherever the scale has gone meanwhile, the first edge after shadow mode is counted from the lines as they are.
#[test]
fn shadow_mode_may_end_at_any_count() {
    for shadowed in 20..24 {
        let mut rig = Rig::running(windowed());
        rig.take(Request::Shadow);
        rig.correct(2);
        rig.step(shadowed);
        rig.take(Request::Enable);
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
    assert_eq!((rig.status().axes[0].completed, rig.status().axes[0].gate), (0, GateState::ControlStale));
    assert_eq!(events, [EventKind::ControlStale(true)]);
    assert_eq!(rig.status().events_lost, 0);
    // One that nobody takes is counted.
    rig.engine.set_control_stale(false, &mut |_| false);
    assert_eq!(rig.status().events_lost, 1);
    rig.step(10);
    assert_eq!((rig.status().axes[0].completed, rig.status().axes[0].gate), (0, GateState::Off));
    rig.take(Request::Enable);
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
    rig.take(Request::Clear);
    rig.correct(2);
    assert_eq!((rig.refusals(), rig.status().axes[0].homed), (vec![Refusal::NotHomed], false));
    assert_eq!(rig.status().axes[0].gate, GateState::NotHomed);
}

#[test]
fn a_card_that_fails_latches_and_says_so() {
    let mut rig = Rig::running(windowed());
    rig.card.broken = true;
    let error = rig.engine.poll(&mut rig.card, u64::MAX, &mut |_| true).unwrap_err();
    rig.engine.card_failed(error, &mut |_| true);
    assert_eq!(rig.status().mode, Mode::Fault);
    assert_eq!(rig.status().faults.iter().collect::<Vec<_>>(), [Fault::Card]);
}

#[test]
fn read_back_that_does_not_follow_is_latched() {
    let config = AxisConfig { rest: RestPolicy::Insert { after_ns: 0 }, ..AxisConfig::default() };
    let mut rig = Rig::wired_back(Bench::default(), config);
    rig.take(Request::Correct { axis: 0, total_counts: 2, large: true });
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

/// Dies between the two inversions of an insertion: in every state, upwards and downwards, with the inverters off and
/// on before it. The successor finishes it, the MTC counts as the scale does again, and the fault is latched.
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

        // Another process, on the same card.
        let Rig { mut card, .. } = rig;
        let machine = MachineConfig { lines: MachineLines::standard(), may_arm: true };
        let mut engine = Engine::new(&mut card, &[AxisConfig::default()], machine, &[odd]).unwrap();
        for _ in 0..50 {
            engine.poll(&mut card, u64::MAX, &mut |_| true).unwrap();
            mtc.update(at_mtc(&card));
        }
        let status = engine.status();
        assert!(engine.at_rest() && lines.inverters(card.outputs).is_multiple_of(3));
        assert_eq!((status.mode, card.outputs & HOLD), (Mode::Fault, HOLD));
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
fn the_probe_captures_between_two_edges_and_corrections_stand_still() {
    let mut rig = Rig::running(windowed());
    rig.step(10);
    rig.take(Request::Probe(true));
    rig.correct(2);
    assert_eq!((rig.refusals(), rig.status().mode), (vec![Refusal::Probing], Mode::Probe));
    // Looks are 100 ns, counts 10 µs: trip after a quarter of a count.
    rig.card.count += 1;
    rig.card.inputs = rig.card.inputs & !3 | [0, 1, 3, 2][rig.card.count.rem_euclid(4) as usize];
    rig.looks(25);
    rig.card.inputs |= PROBE;
    rig.looks(5);
    rig.card.inputs &= !PROBE;
    rig.looks(5);
    rig.card.inputs |= PROBE;
    rig.looks(65);
    rig.step(1);
    let capture =
        rig.events.iter().find_map(|e| if let EventKind::Trip(c) = e.kind { Some(c) } else { None }).unwrap();
    let (position, half_width) = capture.position_counts();
    assert!((position - 11.25).abs() < 0.02, "{position} ± {half_width}: {capture:?}");
    assert!(half_width < 0.02);
    assert!(rig.events.iter().any(|e| e.kind == EventKind::Bounce));
    assert_eq!(rig.status().axes[0].completed, 0);
}

#[test]
fn a_trip_before_the_axis_stops_is_reported_as_that() {
    let mut rig = Rig::running(windowed());
    rig.step(-3);
    rig.take(Request::Probe(true));
    rig.card.inputs |= PROBE;
    rig.looks(2);
    rig.card.t_ns += 200_000_000;
    rig.looks(2);
    let capture =
        rig.events.iter().find_map(|e| if let EventKind::Trip(c) = e.kind { Some(c) } else { None }).unwrap();
    assert_eq!((capture.after, capture.position_counts()), (None, (-2.0, 1.0)));
}

/// A look that comes late may have read its lines long before: what the next one shows may be as old as the look before both.
#[test]
fn a_trip_seen_right_after_a_late_look_may_be_as_old_as_the_look_before_it() {
    for (late_ns, early_ns) in [(0, 100), (10_000_000, 10_000_200)] {
        let mut rig = Rig::running(windowed());
        rig.step(3);
        rig.take(Request::Probe(true));
        rig.looks(1000);
        rig.card.t_ns += late_ns;
        rig.looks(1);
        rig.card.inputs |= PROBE;
        rig.looks(1);
        let seen_ns = rig.card.t_ns;
        rig.card.t_ns += 200_000_000;
        rig.looks(2);
        let trip = |e: &Event| if let EventKind::Trip(c) = e.kind { Some(c.trip_ns) } else { None };
        assert_eq!(rig.events.iter().find_map(trip), Some((seen_ns - early_ns, seen_ns)), "{late_ns}");
    }
}

#[test]
fn operator_hold_asserts_the_line_and_freezes() {
    let mut rig = Rig::running(windowed());
    rig.step(1);
    rig.correct(2);
    rig.take(Request::Hold { on: true, by: 0 });
    rig.correct(6);
    rig.take(Request::Enable);
    rig.take(Request::Shadow);
    assert_eq!(rig.refusals(), [Refusal::Held; 3], "nothing may come on by itself when hold ends");
    rig.step(10);
    assert_eq!((rig.card.outputs & HOLD, rig.status().axes[0].completed), (HOLD, 0));
    assert!(rig.status().enabled && rig.status().held == Some(HeldBy::User(0)));
    rig.take(Request::Hold { on: false, by: 0 });
    rig.step(10);
    assert_eq!((rig.card.outputs & HOLD, rig.status().axes[0].completed), (0, 2));
}

#[test]
fn an_axis_that_is_not_there_is_refused() {
    let mut rig = Rig::running(windowed());
    rig.take(Request::Correct { axis: 1, total_counts: 2, large: false });
    rig.take(Request::Home { axis: 9, position_counts: 0, controller_homed: true });
    assert_eq!(rig.refusals(), [Refusal::NoSuchAxis; 2]);
}

#[test]
fn an_axis_on_its_way_that_shows_no_change_after_a_late_look_may_have_gone_round() {
    for (late_ns, latched) in [(1_000_000, false), (10_000_000, true)] {
        let mut rig = Rig::running(windowed());
        rig.step(1);
        // Four counts later the lines are as they were.
        rig.card.count += 4;
        rig.card.t_ns += late_ns;
        rig.looks(1);
        assert_eq!(rig.faults().contains(&Fault::PollGap), latched, "{late_ns} ns late");
        assert_eq!(rig.status().mode == Mode::Fault, latched, "{late_ns} ns late");
    }
    // One that came to rest is not accused.
    let mut rig = Rig::running(windowed());
    rig.step(3);
    rig.looks(1000);
    rig.faults();
    rig.card.t_ns += 10_000_000;
    rig.looks(1);
    assert!(!rig.faults().contains(&Fault::PollGap));
}

/// The same, asleep until a line changes.
#[derive(Default)]
struct Sleeper(Bench);

impl Card for Sleeper {
    const SLEEPS: bool = true;

    fn sample(&mut self, wake_ns: u64) -> Result<Sample, CardError> {
        self.0.sample(wake_ns)
    }

    fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError> {
        self.0.write(mask, value)
    }

    fn outputs(&mut self) -> Result<u64, CardError> {
        self.0.outputs()
    }
}

/// The figure that the self-test and the gate go by.
/// Of a polled card it is the time from look to look, with what the process was kept away; the time before the first
/// look was the set-up's.
#[test]
fn a_polled_cards_latency_is_the_time_between_two_looks() {
    let mut rig = Rig::with(windowed(), true);
    let found = |rig: &Rig| {
        let gaps = rig.engine.timing().poll_gap_ns.snapshot();
        (gaps.samples(), gaps.min(), gaps.max())
    };
    rig.card.t_ns += 5_000_000;
    rig.looks(1);
    assert_eq!(rig.engine.timing().poll_gap_ns.snapshot().samples(), 0, "no look was before it");
    rig.looks(10);
    assert_eq!(found(&rig), (10, 100, 100));
    rig.card.says = Some(Sample { waited_ns: 7000, ..Sample::level(0, 0) });
    rig.looks(1);
    assert_eq!(found(&rig), (11, 100, 7100));
    // The age of an edge that such a card stamps is another figure.
    rig.card.says = Some(Sample::stamped(0, 0, Some(1)));
    rig.looks(3);
    assert_eq!(found(&rig), (11, 100, 7100));
}

/// Of a card that sleeps it is the age of an edge when it is seen: how long nothing happened says nothing.
#[test]
fn a_sleeping_cards_latency_is_the_age_of_an_edge() {
    let config = AxisConfig { lines: AxisLines::standard(0, false), ..windowed() };
    let mut rig = Rig::on(Sleeper::default(), config, true);
    rig.looks(2);
    rig.card.0.t_ns += 60_000_000_000;
    rig.looks(5);
    assert_eq!(rig.engine.timing().poll_gap_ns.snapshot().samples(), 0, "no edge, no age");
    let seen_ns = rig.card.0.t_ns + 100;
    rig.card.0.says = Some(Sample::stamped(0, 0, Some(seen_ns - 42)));
    rig.looks(1);
    let gaps = rig.engine.timing().poll_gap_ns.snapshot();
    assert_eq!((gaps.samples(), gaps.min(), gaps.max()), (1, 42, 42));
    // Later looks, without an edge.
    rig.card.0.says = None;
    rig.looks(5);
    assert_eq!(rig.engine.timing().poll_gap_ns.snapshot().samples(), 1);
}

#[test]
fn a_late_look_before_the_second_edge_is_judged_from_rest() {
    // From rest at 1e6 counts/s² three counts take 2.4 ms: 1 ms is no loss of counts, 10 ms may be.
    for (late_ns, latched) in [(1_000_000, false), (10_000_000, true)] {
        let mut rig = Rig::running(windowed());
        rig.step(1);
        rig.card.count += 1;
        rig.card.inputs = rig.card.inputs & !3 | [0, 1, 3, 2][rig.card.count.rem_euclid(4) as usize];
        rig.card.t_ns += late_ns;
        rig.looks(1);
        assert_eq!(rig.faults().contains(&Fault::PollGap), latched, "{late_ns} ns late");
    }
}

#[test]
fn what_the_card_finds_is_latched_where_it_belongs() {
    let trouble =
        |kind, lines| Some(Sample { trouble: Some(Trouble { kind, lines }), ..Sample::level(0, 0) });
    for (kind, fault) in [
        (TroubleKind::SequenceGap, Fault::SequenceGap),
        (TroubleKind::QueueOverflow, Fault::QueueOverflow),
        (TroubleKind::EdgeMissed, Fault::EdgeMissed),
        (TroubleKind::CounterOverflow, Fault::CounterOverflow),
        (TroubleKind::CounterError, Fault::CounterError),
    ] {
        let mut rig = Rig::running(windowed());
        rig.card.says = trouble(kind, 0b11);
        rig.looks(2);
        let status = rig.status();
        assert_eq!((status.mode, status.axes[0].homed), (Mode::Fault, false), "{fault:?}");
        assert_eq!(status.axes[0].faults.iter().collect::<Vec<_>>(), [fault]);
        assert_eq!((rig.faults(), rig.card.outputs & HOLD), (vec![fault], HOLD));
        // On a line of no axis it is the machine's.
        let mut rig = Rig::running(windowed());
        rig.card.says = trouble(kind, PROBE);
        rig.looks(2);
        assert_eq!(rig.status().faults.iter().collect::<Vec<_>>(), [fault]);
        assert_eq!((rig.status().axes[0].faults.any(), rig.status().mode), (false, Mode::Fault));
    }
}

#[test]
fn nothing_is_written_while_a_further_change_is_known() {
    let mut rig = Rig::running(windowed());
    rig.step(3);
    let before = rig.card.writes;
    rig.correct(2);
    rig.card.says = Some(Sample { more: true, ..Sample::level(0, 0) });
    rig.step(1);
    assert_eq!(rig.card.writes, before);
    // The last of the queued changes shows where the axis really is: from here on it may be acted on.
    rig.card.says = None;
    rig.step(1);
    assert_eq!((rig.card.writes - before, rig.status().axes[0].completed), (2, 2));
    assert!(rig.status().balanced() && rig.faults().is_empty());
}

#[test]
fn a_card_that_counts_for_itself_may_be_looked_at_late() {
    let mut rig = Rig::running(windowed());
    rig.step(3);
    rig.card.says = Some(Sample { complete: 0b11, ..Sample::level(0, 0) });
    rig.card.t_ns += 1_000_000_000;
    rig.step(3);
    assert!(rig.faults().is_empty() && rig.status().balanced());
}

#[test]
fn the_read_back_waits_for_levels_of_this_very_moment() {
    let mut rig = Rig::wired_back(Bench::default(), windowed());
    // A' and B' stay as they were: a gate that does not follow. Nobody can tell before they have been read.
    rig.card.says = Some(Sample { fresh: 0, ..Sample::level(0, 0) });
    rig.step(3);
    rig.correct(2);
    rig.step(2);
    assert_eq!((rig.status().axes[0].completed, rig.faults().len()), (2, 0));
    rig.card.says = None;
    rig.looks(2);
    assert_eq!(rig.faults(), [Fault::ReadBackMismatch]);
}

/// Gates and receivers that follow after a while: A' and B' as they were `behind_ns` ago.
struct Following {
    bench: Bench,
    behind_ns: u64,
    was: Vec<(u64, u64)>,
}

impl Card for Following {
    fn sample(&mut self, wake_ns: u64) -> Result<Sample, CardError> {
        let sample = self.bench.sample(wake_ns)?;
        let now = (self.bench.inputs ^ self.bench.outputs) & 0b11;
        if self.was.last().is_none_or(|(_, back)| *back != now) {
            self.was.push((sample.t_ns, now));
        }
        let back = self.was.iter().rev().find(|(t_ns, _)| t_ns + self.behind_ns <= sample.t_ns);
        Ok(Sample { inputs: sample.inputs | back.map_or(0, |(_, back)| back << 2), ..sample })
    }

    fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError> {
        self.bench.write(mask, value)
    }

    fn outputs(&mut self) -> Result<u64, CardError> {
        self.bench.outputs()
    }
}

/// A bug once: A' and B' were compared at the first look after a write, and an input filter of a microsecond was a fault.
#[test]
fn a_read_back_that_follows_within_the_mtcs_separation_is_no_fault() {
    for (behind_ns, follows) in [(0, true), (100, true), (400, true), (2_000, false)] {
        let card = Following { bench: Bench::default(), behind_ns, was: Vec::new() };
        let mut rig = Rig::wired_back(card, AxisConfig::default());
        for n in 0..200_u64 {
            let total_counts = if n % 40 < 20 { 6 } else { -6 };
            rig.take(Request::Correct { axis: 0, total_counts, large: true });
            rig.card.bench.inputs = [0, 1, 3, 2][n as usize % 4];
            // An edge every 5 µs, looked at ten times a microsecond.
            rig.looks(50);
        }
        let (axis, faults) = (rig.status().axes[0], rig.faults());
        if follows {
            assert!(faults.is_empty() && axis.insertions > 20, "{behind_ns} ns behind: {faults:?}, {axis:?}");
        } else {
            assert_eq!(faults, [Fault::ReadBackMismatch], "{behind_ns} ns behind");
        }
    }
}

/// The axis stands, or goes on as before: what the machine's own lines say is seen at the look that shows it, both at once too.
#[test]
fn a_switch_is_seen_though_the_probe_trips_with_it() {
    for lines in [SWITCH, SWITCH | PROBE] {
        let mut rig = Rig::running(windowed());
        rig.step(4);
        rig.card.inputs |= lines;
        rig.looks(1);
        assert_eq!(rig.status().mode, Mode::Disabled, "{lines:#x}");
    }
}

impl Rig {
    /// One channel (1 A, 2 B) changes so many times, every 25 µs or every so many looks of 100 ns.
    fn alone(&mut self, channel: u64, edges: usize, looks: usize) {
        for _ in 0..edges {
            self.card.inputs ^= channel;
            self.looks(looks);
        }
    }

    /// Running, having moved by so many counts, on a card that keeps every edge or on one that looks.
    fn moved(counts: i64, keeps_edges: bool) -> Self {
        let mut rig = Self::running(AxisConfig::default());
        if keeps_edges {
            rig.card.says = Some(Sample { complete: 0b11, ..Sample::level(0, 0) });
        }
        rig.step(counts);
        rig
    }
}

#[test]
fn latches_a_channel_that_does_not_take_its_turn() {
    for channel in [1, 2] {
        for counts in [4, 5, 6, 7, -4, -5, -6, -7] {
            for keeps_edges in [false, true] {
                let mut rig = Rig::moved(counts, keeps_edges);
                rig.correct(40);
                // The first edge may still go on as before, and is the last that opens an insertion.
                rig.alone(channel, 15, 250);
                let (before, faults) = (rig.status().axes[0], rig.faults());
                assert!(
                    before.completed <= 2 && !faults.contains(&Fault::ChannelDead),
                    "{before:?} {faults:?}"
                );
                if before.completed == 0 {
                    assert_eq!((faults, before.gate), (vec![], GateState::OneChannel), "{channel} {counts}");
                }
                rig.alone(channel, 2, 250);
                assert!(rig.faults().contains(&Fault::ChannelDead), "{channel} {counts} {:?}", rig.faults());
                rig.alone(channel, 283, 250);
                let (after, status) = (rig.status().axes[0], rig.status());
                assert_eq!((status.mode, after.homed), (Mode::Fault, false));
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
        // It stands; one channel changes every 317 µs: no sooner than the axis can turn back.
        rig.step(1);
        let channel = if rig.card.count % 2 == 0 { 2 } else { 1 };
        rig.alone(channel, 1, 3170);
        rig.correct(40);
        rig.alone(channel, 1001, 3170);
        let axis = rig.status().axes[0];
        assert_eq!((rig.faults(), axis.completed, axis.gate), (vec![], 0, GateState::OneChannel));
        assert!(axis.waited_for_gate >= 1000);
        // It goes on, and everything is inserted.
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
