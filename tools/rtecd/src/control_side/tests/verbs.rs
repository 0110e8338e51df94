//! Every verb in every mode, on a machine with every line wired.

use super::*;

/// Wires of a card that gives a delayed thread time to look.
struct Patient(SharedWires);

impl Wires for Patient {
    fn levels(&mut self, t_ns: u64, outputs: u64) -> u64 {
        self.0.levels(t_ns, outputs)
    }

    fn step_limit_ns(&self) -> u64 {
        1000
    }
}

/// A daemon on a machine with every line wired, whose inputs the test sets.
struct Hand {
    session: ControlSide,
    running: rtec_rt::pinned_rt_thread::RtThreadHandle<MockCard<Patient, Monotonic>>,
    inputs: std::sync::Arc<std::sync::atomic::AtomicU64>,
    _directory: tempfile::TempDir,
}

const SWITCH: u64 = 1 << 29;
const READY: u64 = 1 << 30;

/// Homing works right behind the first edge.
/// A speed is known only from the second edge on, so one edge counts as no motion.
#[test]
fn homes_right_behind_the_first_edge() {
    let mut hand = Hand::new();
    hand.input(1, true);
    hand.done(&ClientRequest::Home { axis: None, controller_homed: Some(true) });
}

/// All state that a verb can change; a refused verb changes none of it.
#[derive(Debug, PartialEq)]
struct State {
    mode: CorrectorMode,
    enabled: bool,
    held: bool,
    model: bool,
    /// For each axis: requested, in effect, homed, MTC known, faults, operator in µm.
    axes: Vec<(i64, i64, bool, bool, usize, f64)>,
}

impl Hand {
    fn new() -> Self {
        let directory = tempfile::tempdir().unwrap();
        let mut config = Config::embedded();
        config.control.state_file = Some(directory.path().join("state"));
        config.lines.mtc_ready = Some(30);
        for axis in &mut config.axes {
            axis.engine.rest = rtec_rt::axis::InsertionAtRestPolicy::Insert { after_ns: 1 };
            axis.engine.lines.read_back = None;
        }
        let wires = SharedWires::default();
        let inputs = std::sync::Arc::clone(&wires.inputs);
        inputs.store(READY, std::sync::atomic::Ordering::Release);
        let mut card = MockCard::new(Patient(wires), Monotonic);
        let machine = MachineConfig { lines: config.lines, may_arm: true };
        let engine = Engine::new(&mut card, &config.engine_axes(), machine, &[]).unwrap();
        let set_up = set_up(&engine, false);
        let time = Rc::new(SystemClock(SteadyEpochClock::start()));
        let session =
            ControlSide::with_clock(time, config, set_up, SensorThreads::without_threads(Vec::new()));
        let options = ThreadOptions { wanted: None, real: false, stale_after_ns: 60_000_000_000 };
        let running = spawn(engine, card, options).unwrap();
        Self { session, running, inputs, _directory: directory }
    }

    fn ask(&mut self, request: &ClientRequest) -> DaemonResponse {
        ask(&mut self.session, request, &mut self.running.control)
    }

    fn done(&mut self, request: &ClientRequest) {
        let response = self.ask(request);
        assert!(matches!(response, DaemonResponse::Done { .. }), "{request:?}: {response:?}");
    }

    fn input(&mut self, mask: u64, on: bool) {
        let inputs = self.inputs.load(std::sync::atomic::Ordering::Acquire);
        let inputs = if on { inputs | mask } else { inputs & !mask };
        self.inputs.store(inputs, std::sync::atomic::Ordering::Release);
        // A status newer than the next one has seen the input.
        for _ in 0..2 {
            let polls = self.running.control.status().polls;
            while self.running.control.status().polls == polls {
                std::thread::yield_now();
            }
        }
    }

    fn state(&mut self) -> State {
        let status = self.running.control.status();
        let DaemonResponse::Explained { axes } = self.ask(&ClientRequest::Explain { axis: None }) else {
            panic!("no explanation")
        };
        let operator = |n: usize| axes[n].parts.iter().find(|p| p.name == "operator").map_or(0.0, |p| p.um);
        let each = status.axes().iter().enumerate();
        State {
            mode: status.mode,
            enabled: status.enabled,
            held: status.held.is_some(),
            model: self.session.corrector.running_model().is_some(),
            axes: each
                .map(|(n, a)| {
                    (a.requested, a.in_effect, a.homed, a.mtc_known, a.faults.iter().count(), operator(n))
                })
                .collect(),
        }
    }

    /// Homes the machine with 10 counts in effect on X, and enables corrections.
    fn running(&mut self) {
        use ClientRequest as R;
        self.input(SWITCH, false);
        self.input(READY, true);
        let controller_homed = Some(true);
        for request in [
            R::Clear {},
            R::Hold { on: false },
            R::Probe { on: false },
            R::Disable {},
            R::Home { axis: None, controller_homed },
            R::Enable { accept_jump: true },
            R::Correct { axis: "x".to_owned(), total_counts: 10, large: false },
        ] {
            self.done(&request);
        }
        while self.running.control.status().axes[0].in_effect != 10 {
            self.running.control.beat();
        }
    }
}

/// A model goes to its place in a ramp, which `enable` leaves as it is.
/// The same distance is a jump when corrections are off.
#[test]
fn enabling_what_is_on_moves_nothing() {
    let mut hand = Hand::new();
    hand.running();
    let file = hand.session.directory().join("m.toml");
    std::fs::write(&file, "name = \"m\"\n[[effect]]\nname = \"offset.y\"\num = -88.0\n").unwrap();
    let take = Some(Machine::read(&file).unwrap().sha256().to_owned());
    let file = Some(file.display().to_string());
    hand.done(&ClientRequest::ModelLoad { file, take, expired: false, files: Vec::new() });
    hand.session.next_evaluation = Instant::now();
    hand.session.tick(&mut hand.running.control);
    let enable = |accept_jump| ClientRequest::Enable { accept_jump };
    let before = hand.running.control.status().axes[1].requested;
    for accept_jump in [false, true] {
        let answer = hand.ask(&enable(accept_jump));
        let already = DaemonResponse::Done { jumps: Vec::new(), already: true, warnings: Vec::new() };
        assert_eq!(answer, already);
        assert_eq!(hand.running.control.status().axes[1].requested, before);
    }
    hand.done(&ClientRequest::Disable {});
    let answer = hand.ask(&enable(false));
    assert!(matches!(&answer, DaemonResponse::Refused { why, .. } if why == "jump"), "{answer:?}");
    hand.running.stop();
}

/// A function that puts a machine into a mode.
type Put = Box<dyn Fn(&mut Hand)>;
/// A condition that holds once a verb is done.
type Is = fn(&State) -> bool;

/// Every verb that changes a total or a mode, in every mode.
/// Either it is done and takes effect, or it is refused and nothing changes.
#[test]
fn every_verb_is_done_or_refused_in_every_mode() {
    use ClientRequest as R;
    let correct = |total_counts| R::Correct { axis: "x".to_owned(), total_counts, large: false };
    let home = |controller_homed| R::Home { axis: None, controller_homed };
    let (hold, probe, enable) = (|on| R::Hold { on }, |on| R::Probe { on }, R::Enable { accept_jump: false });
    let by = |requests: Vec<R>| -> Put { Box::new(move |hand| requests.iter().for_each(|r| hand.done(r))) };
    let modes: Vec<(&str, Put)> = vec![
        ("run", by(vec![])),
        ("disabled", by(vec![R::Disable {}])),
        ("shadow", by(vec![R::Shadow {}])),
        ("probe", by(vec![probe(true)])),
        ("probe, disabled", by(vec![R::Disable {}, probe(true)])),
        ("hold", by(vec![hold(true)])),
        ("hold, disabled", by(vec![R::Disable {}, hold(true)])),
        ("hold, shadow", by(vec![R::Shadow {}, hold(true)])),
        ("switch", Box::new(|hand| hand.input(SWITCH, true))),
        ("switch released", Box::new(|hand| [true, false].into_iter().for_each(|on| hand.input(SWITCH, on)))),
        ("MTC off", Box::new(|hand| hand.input(READY, false))),
        ("MTC on again", Box::new(|hand| [false, true].into_iter().for_each(|on| hand.input(READY, on)))),
        (
            "fault",
            Box::new(move |hand| {
                let far = R::Correct { axis: "x".to_owned(), total_counts: 900, large: false };
                (0..3).for_each(|_| drop(hand.ask(&far)));
            }),
        ),
    ];
    let verbs: Vec<(R, Is)> = vec![
        (correct(0), |s| s.axes[0].0 == 0 && s.axes[0].5 == 0.0),
        (correct(10), |s| s.axes[0].0 == 10),
        (correct(20), |s| s.axes[0].0 == 20 && s.axes[0].5 != 0.0),
        (home(None), |s| s.axes.iter().all(|a| a.2 && a.1 == 0)),
        (home(Some(true)), |s| s.axes.iter().all(|a| a.2 && a.3 && a.1 == 0 && a.0 == 0)),
        (home(Some(false)), |s| s.axes.iter().all(|a| a.2) && s.axes[0].1 == 10 && s.axes[0].0 == 10),
        (enable, |s| s.enabled && s.mode == CorrectorMode::Run),
        (R::Disable {}, |s| !s.enabled),
        (R::Park {}, |s| !s.enabled),
        (R::Shadow {}, |s| !s.enabled && s.mode == CorrectorMode::Shadow),
        (hold(true), |s| s.held && matches!(s.mode, CorrectorMode::Hold | CorrectorMode::Fault)),
        (hold(false), |s| !s.held),
        (probe(true), |s| {
            matches!(s.mode, CorrectorMode::Probe | CorrectorMode::Hold | CorrectorMode::Fault)
        }),
        (probe(false), |s| s.mode != CorrectorMode::Probe),
        (R::Clear {}, |s| s.mode != CorrectorMode::Fault && s.axes.iter().all(|a| a.4 == 0)),
        (R::ModelUnload {}, |s| !s.model),
        (R::ModelAgain {}, |s| s.model),
        (R::TableUnload {}, |_| true),
    ];
    let mut hand = Hand::new();
    let (mut done, mut refused) = (0, 0);
    let all = test_needs::long();
    // In a short run four: correcting, probing, switched off, with a fault.
    for (mode, put) in modes.iter().step_by(if all { 1 } else { 4 }) {
        for (verb, is) in &verbs {
            hand.running();
            put(&mut hand);
            let before = hand.state();
            let response = hand.ask(verb);
            let after = hand.state();
            if matches!(response, DaemonResponse::Done { .. }) {
                assert!(is(&after), "{mode}: {verb:?} is done, and {after:?}");
                done += 1;
            } else {
                assert_eq!(after, before, "{mode}: {verb:?}: {response:?}");
                refused += 1;
            }
        }
    }
    let least = if all { (80, 60) } else { (20, 15) };
    assert!(done > least.0 && refused > least.1, "{done} done, {refused} refused");
    hand.running.stop();
}
