//! Random whole lives of the daemon, each drawn from a seed.
//! One thread on one clock runs state file, start, real-time loop, link, requests, control law, sensors and model. So
//! each seed gives one history. The machine beyond the card moves by itself, and its MTC counts every change in true
//! order.
//!
//! | drawn | how |
//! |---|---|
//! | kills | between two looks; at an inversion that is noted and not made, or made and not known |
//! | state file | the record under way torn, or lost from one copy; the file lost, with the outputs or without; removed or overwritten in use |
//! | MTC | switched off and on again, as its line `mtc_ready` says; homed with the axis, or not |
//! | looks | late by up to 8 ms |
//! | card | a write that fails; both lines of an axis at once |
//! | control side | stops for longer than the stale time; floods of requests |
//! | people | every verb at any moment, right or wrong, in any role; the disable switch; faults cleared and the machine homed again |
//! | heat | sensors that drift, jump or fall silent; a model in and out; the day jumps by years |
//!
//! Through every restart the properties of `tools/guide/contributor/laws.md` must hold. Each has a planted fault here.
//!
//! `RTEC_HISTORIES` sets the number (default 200), and `RTEC_SEED` the first seed. Some events are not drawn. An MTC
//! that restarts while no daemon runs, and is back before the next one starts, cannot be noticed. Sockets and the
//! record of commands are tested in `tests/`.

#![allow(clippy::unwrap_used)] // a test's own helpers

mod judge;
mod machine;
mod mishaps;

use super::super::*;
use super::set_up;
use crate::start;
use judge::{Asked, Judge, Planted, World};
use machine::{AtWrite, Killed, Machine, Wires};
use rtec_control::client_role::ClientRole as Caller;
use rtec_driver::card::AxisLines;
use rtec_model::machine::Machine as Model;
use rtec_rt::engine::Engine;
use rtec_rt::journal::{HoldAndFaultsRecord, Journal};
use rtec_rt::link::link;
use rtec_rt::link_messages::{Fault, FaultSet};
use rtec_rt::pinned_rt_thread::SteppedLoop;
use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::fs;
use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use test_needs::asked;
use test_needs::dice::Dice;

const STALE_MS: u64 = 60;
const MODEL: &str = "name = \"history\"\n[[effect]]\nname = \"screw_periodic.x\"\nperiod_mm = 2.0\num = 15.0\nphase_rad = 0.0\n[[effect]]\nname = \"reversal.y\"\num = 9.0\n\
    [[effect]]\nname = \"thermal_growth.y\"\nsensor = \"T1\"\nminus = \"T2\"\num_per_K = 3.0\n";

thread_local! {
    static DAY: Cell<i64> = const { Cell::new(20_000) };
}

/// Totals of all histories.
#[derive(Debug, Default)]
struct Tally {
    histories: u64,
    looks: u64,
    edges: u64,
    insertions: u64,
    kills: u64,
    torn: u64,
    finished_halves: u64,
    not_started: u64,
    trusted_after: u64,
    requests: u64,
    refused: u64,
    held: u64,
    mtc_restarts: u64,
    power_cuts: u64,
    lost_files: u64,
    kept_totals: u64,
    /// Counts lost through noise at an edge within one look, by reason.
    /// Nobody could tell these from a step.
    unseen: [u64; 3],
    checks: u64,
    latched: BTreeMap<String, u64>,
}

/// The daemon that runs now, with people and failures around it.
struct Life {
    world: Rc<World>,
    dice: Dice,
    config: Config,
    lines: [AxisLines; 2],
    end_ns: u64,
    kill_ns: Option<u64>,
    heat: [f64; 2],
    speaks: usize,
    planted: Option<Planted>,
    mtc_restarts: u64,
}

impl Life {
    fn new(seed: u64, directory: &Path, planted: Option<Planted>) -> Self {
        let mut dice = Dice::new(seed);
        let accel = 10_f64.powf(4.3 + 1.2 * dice.unit());
        let max_gap_ns = dice.within(3000, 20_000);
        let rest = if dice.one_in(4) { "rest_policy = 'insert'\nrest_quiet_ms = 5\n" } else { "" };
        let axis = |name: &str, at: u64| {
            format!(
                "[[axis]]\nname = '{name}'\ncount_um = 1.0\ntravel_mm = 400\nmax_correction_counts = 400\nwindow_counts = 40\n\
                 error_counts = 300\nmin_separation_ns = 3000\nmax_accel_counts_s2 = {}\nhysteresis_counts = 0.09\n\
                 {rest}lines = {{ a = 'in{}', b = 'in{}', invert_a = 'out{}', invert_b = 'out{}' }}\n",
                accel * 1.001,
                at,
                at + 1,
                at,
                at + 1
            )
        };
        let mtc_off = if dice.one_in(2) { "hold" } else { "freeze" };
        let text = format!(
            "[machine]\nname = 'history'\nmtc_off = '{mtc_off}'\n[card]\nbackend = 'mapped'\nfile = 'card'\nhold = 'out28'\n\
             disable = 'in29'\nmtc_ready = 'in30'\n{}{}\
             [rt]\ndetect_ns = {}\nwrite_ns = {}\nguard_ns = 50\n[control]\nstate_file = 'state'\nstale_ms = {STALE_MS}\n\
             [model]\nramp_um_s = 200\n",
            axis("x", 0),
            axis("y", 2),
            3 * max_gap_ns,
            2 * max_gap_ns
        );
        let file = directory.join("rtec.toml");
        let config = Config::parse(&file, &text).unwrap();
        let state_file = config.control.state_path();
        let lines = [0, 1].map(|n| config.axes[n].engine.lines);
        let machine = Machine::new(seed ^ 0x5eed, lines, accel, max_gap_ns, state_file);
        let turn_back_ns = config.engine_axes()[0].gate().unwrap().turn_back_ns();
        let judge = Judge {
            seed,
            base: [[0; 2]; 2],
            trusted: [false; 2],
            asked: Asked::default(),
            held: false,
            latched: Vec::new(),
            enabled: false,
            looks: 0,
            off_looks: 0,
            masked: [(0, 0); 2],
            turn_back_ns: turn_back_ns - 3 * max_gap_ns,
            unseen: [0; 3],
            lost: [None; 2],
            begun: 0,
            silent_ns: None,
            turns: 0,
            checks: 0,
            digest: 0,
            wrong: Vec::new(),
        };
        let world = World {
            base: Instant::now(),
            machine: Rc::new(RefCell::new(machine)),
            turns: RefCell::new(None),
            judge: RefCell::new(judge),
        };
        let end_ns = dice.within(200, 1200) * 1_000_000;
        Self {
            world: Rc::new(world),
            dice,
            config,
            lines,
            end_ns,
            kill_ns: None,
            heat: [20.0; 2],
            speaks: 2,
            planted,
            mtc_restarts: 0,
        }
    }

    fn now_ns(&self) -> u64 {
        self.world.machine.borrow().t_ns
    }

    /// Prints a line if there is only one history.
    fn tell(&self, what: &str) {
        if asked("RTEC_HISTORIES", 200) == 1 {
            println!("{:>10.3} ms {what}", self.now_ns() as f64 * 1e-6);
        }
    }

    /// Runs from the first start to the end of the history, through every kill.
    fn run(&mut self, tally: &mut Tally) {
        while self.now_ns() < self.end_ns {
            let life = self.dice.within(5, 600) * 1_000_000;
            self.kill_ns = (!self.dice.one_in(4)).then(|| self.now_ns() + life);
            let killed = catch_unwind(AssertUnwindSafe(|| self.live(tally)));
            match killed {
                Ok(()) => {}
                Err(payload) if payload.is::<Killed>() => tally.kills += 1,
                Err(payload) => resume_unwind(payload),
            }
            let died = self.world.machine.borrow_mut().die.take();
            self.tell(&format!("the process is gone ({died:?})"));
            if let Some(turns) = self.world.turns.borrow_mut().take() {
                turns.end(None);
            }
            if died == Some(AtWrite::Before) && !self.dice.one_in(4) {
                tally.torn += 1;
                self.tear();
            }
            if self.planted == Some(Planted::OldFile) {
                let m = self.world.machine.borrow();
                if !m.state_before.is_empty() {
                    fs::write(&m.state_file, &m.state_before).unwrap();
                }
            }
            if self.planted == Some(Planted::FileForgotten) {
                let _ = fs::remove_file(&self.world.machine.borrow().state_file);
            }
            if self.dice.one_in(12) {
                tally.power_cuts += 1;
                self.tell("power cut");
                self.world.machine.borrow_mut().lose_power();
                self.world.judge.borrow_mut().forget();
            }
            // No daemon runs, and the axes move on.
            let dead_ns = self.dice.within(10, 40_000) * 1000;
            self.world.machine.borrow_mut().write_fails = false;
            self.world.run(dead_ns);
        }
    }

    /// Runs one process from its start until it is killed or ends.
    fn live(&mut self, tally: &mut Tally) {
        let mut card = Wires(Rc::clone(&self.world.machine));
        let half = (0..2).any(|n| !self.world.machine.borrow().settled(n));
        if self.planted == Some(Planted::HoldForgotten) {
            self.forget_hold();
        }
        let Ok((mut engine, _, state_file)) = start::engine(&mut card, &self.config) else {
            // The message says what to do by hand, and that is done here.
            tally.not_started += 1;
            // At a first start there is no file.
            let _ = fs::remove_file(self.config.control.state_path());
            self.world.machine.borrow_mut().inverters_off();
            self.world.judge.borrow_mut().forget();
            return;
        };
        tally.finished_halves += u64::from(half);
        self.tell(&format!("started: {:?}", [0, 1].map(|n| engine.in_effect(n))));
        engine.set_may_arm(true);
        let set_up = set_up(&engine, false);
        let (mut control, rt) = link(engine.status());
        {
            let mut judge = self.world.judge.borrow_mut();
            let m = self.world.machine.borrow();
            judge.begins();
            judge.begun = m.axes.iter().map(|a| a.begun).sum();
            judge.keeps(&engine, &m);
            judge.check(&engine, &m);
            tally.trusted_after += judge.trusted.iter().filter(|t| **t).count() as u64;
        }
        let stale_ns =
            if self.planted == Some(Planted::NeverStale) { u64::MAX } else { STALE_MS * 1_000_000 };
        *self.world.turns.borrow_mut() = Some(SteppedLoop::new(engine, card, rt, stale_ns));
        let time: Rc<dyn ControlClock> = Rc::clone(&self.world) as Rc<dyn ControlClock>;
        let sensor = |n: &str| {
            SensorMonitor::new(SensorConfig {
                timeout_s: 0.1,
                ..SensorConfig::believed(n, Role::Temperature)
            })
        };
        let played = SensorThreads::without_threads(["T1", "T2"].map(sensor).to_vec());
        let mut session = ControlSide::with_clock(time, self.config.clone(), set_up, played);
        session.watch_over(state_file.filter(|_| self.planted != Some(Planted::FileUnwatched)));
        session.today = || DAY.get();
        session.patience = Duration::from_millis(40);
        let control = &mut control;
        let mut seen = Seen::default();
        while self.now_ns() < self.end_ns {
            if self.kill_ns.is_some_and(|at| self.now_ns() > at) && self.die() {
                tally.kills += 1;
                break;
            }
            control.beat();
            session.drain(control);
            if control.pending() == 0 {
                self.world.judge.borrow_mut().asked = Asked::default();
            }
            if self.planted == Some(Planted::EnablesItself) && self.dice.one_in(20) {
                let _ = control.send(RequestToRt::Enable);
            }
            tally.held += u64::from(self.world.judge.borrow().held);
            self.sense(&mut session);
            session.tick(control);
            session.take_happened();
            if control.ended() {
                // The service manager would not notice it. A person does, and starts the daemon again.
                break;
            }
            if seen.0 != session.latched(&control.status()) {
                self.tell(&format!("latched: {:?}", session.latched(&control.status())));
            }
            seen.count(&session.latched(&control.status()), tally);
            self.people(&mut session, control, tally);
            self.mishaps();
            self.lose_state_file(&mut session, control, tally);
            self.world.run(10_000_000);
        }
    }
}

/// Latched faults at the last turn, so that each is counted once.
#[derive(Default)]
struct Seen(Vec<(Option<String>, String)>);

impl Seen {
    fn count(&mut self, now: &[(Option<String>, String)], tally: &mut Tally) {
        for fault in now.iter().filter(|f| !self.0.contains(f)) {
            *tally.latched.entry(fault.1.clone()).or_default() += 1;
        }
        self.0 = now.to_vec();
    }
}

/// Runs one history; returns the violations and a digest.
fn history(seed: u64, planted: Option<Planted>, tally: &mut Tally) -> (Vec<String>, u64) {
    let directory = tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap();
    DAY.set(20_000);
    let mut life = Life::new(seed, directory.path(), planted);
    life.run(tally);
    let (judge, m) = (life.world.judge.borrow(), life.world.machine.borrow());
    tally.histories += 1;
    tally.mtc_restarts += life.mtc_restarts;
    tally.looks += m.looks;
    tally.checks += judge.checks;
    (0..3).for_each(|why| tally.unseen[why] += judge.unseen[why]);
    tally.insertions += judge.begun;
    tally.edges += m.axes.iter().map(|a| a.edges).sum::<u64>();
    let mut wrong = judge.wrong.clone();
    if (0..2).any(|n| judge.trusted[n] && judge.lost[n].is_some()) {
        wrong.push(format!("RTEC_SEED={seed}: a count is lost at the end, and no fault is latched"));
    }
    (wrong, judge.digest)
}

#[test]
fn no_history_loses_a_count_in_silence() {
    let first = asked("RTEC_SEED", 1);
    let seeds = first..first + asked("RTEC_HISTORIES", test_needs::fewer(200));
    let mut tally = Tally::default();
    let mut wrong = Vec::new();
    for seed in seeds {
        wrong.extend(history(seed, None, &mut tally).0);
    }
    println!("{tally:?}");
    assert!(
        wrong.is_empty(),
        "{} wrong:\n{}",
        wrong.len(),
        wrong.iter().take(20).cloned().collect::<Vec<_>>().join("\n")
    );
    if tally.histories >= 100 {
        let seen = [
            tally.insertions / 100,
            tally.kills,
            tally.torn,
            tally.finished_halves,
            tally.trusted_after,
            tally.refused,
            tally.held,
            tally.mtc_restarts,
            tally.power_cuts,
            tally.lost_files,
            tally.kept_totals,
        ];
        assert!(seen.iter().all(|n| *n > 10), "the histories have become empty: {tally:?}");
        assert!(tally.latched.len() >= 4, "{tally:?}");
        assert!(!tally.latched.contains_key("record_lost"), "a kill was taken for damage: {tally:?}");
    }
}

#[test]
fn a_seed_is_one_history() {
    let digest = |seed| history(seed, None, &mut Tally::default()).1;
    let (once, again, other) = (digest(7), digest(7), digest(8));
    assert!(once == again && once != other);
}

#[test]
fn planted_faults_are_found() {
    if !test_needs::long() {
        return;
    }
    for planted in Planted::ALL {
        let mut tally = Tally::default();
        let found = (1..=80).any(|seed| !history(seed, Some(planted), &mut tally).0.is_empty());
        assert!(found, "{planted:?}: {tally:?}");
    }
}
