mod histories;
mod verbs;

use super::*;
use rtec_driver::clock::Monotonic;
use rtec_driver::mock_card::{MockCard, SharedWires, Wires};
use rtec_files::csv::Reader;
use rtec_model::machine::Machine;
use rtec_rt::engine::{Engine, MachineConfig};
use rtec_rt::journal::StateAtOpen;
use rtec_rt::link::{REQUESTS, link};
use rtec_rt::pinned_rt_thread::{ThreadOptions, spawn};
use std::cell::Cell;

fn ask(session: &mut ControlSide, request: &ClientRequest, control: &mut ControlEnd) -> DaemonResponse {
    let deadline = Instant::now() + Duration::from_secs(60);
    loop {
        let beside = RequestContext { trusted: true, ..RequestContext::default() };
        match session.answer(request, beside, control) {
            RequestOutcome::Now(response) => return response,
            RequestOutcome::Again(response) if Instant::now() > deadline => return response,
            RequestOutcome::Again(_) => {}
            RequestOutcome::Later(_) => loop {
                control.beat();
                if let Some((_, response, _)) = session.loaded(|_| true, control) {
                    return response;
                }
                std::thread::sleep(Duration::from_millis(1));
            },
        }
    }
}

fn engine(config: &Config) -> (Engine, MockCard<SharedWires, Monotonic>) {
    let mut card = MockCard::new(SharedWires::default(), Monotonic);
    let machine = MachineConfig { lines: config.lines, may_arm: true };
    let engine = Engine::new(&mut card, &config.engine_axes(), machine, &[]).unwrap();
    (engine, card)
}

fn set_up(engine: &Engine, real: bool) -> RtStartupReport {
    RtStartupReport {
        real,
        wanted: None,
        missing: None,
        timing: engine.timing(),
        before: StateAtOpen::NOTHING,
    }
}

fn session(engine: &Engine) -> ControlSide {
    let time = Rc::new(SystemClock(SteadyEpochClock::start()));
    ControlSide::with_clock(
        time,
        Config::embedded(),
        set_up(engine, false),
        SensorThreads::without_threads(Vec::new()),
    )
}

/// The clock of a recorded shift.
struct Recorded(Cell<f64>);

impl ControlClock for Recorded {
    fn now(&self) -> Instant {
        Instant::now()
    }

    fn now_s(&self) -> f64 {
        self.0.get()
    }

    fn sleep(&self, _: Duration) {}
}

/// A recorded shift gives the same totals in the daemon's tick.
#[test]
fn a_recorded_shift_gets_the_recorded_totals() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../correct/tests/shift");
    let directory = tempfile::tempdir().unwrap();
    let mut config = Config::embedded();
    config.control.state_file = Some(directory.path().join("state"));
    config.model.lead_ms = 20.0;
    // The belief window of the recording.
    config.axes.iter_mut().for_each(|axis| axis.engine.window_counts = 50);
    let (engine, _card) = engine(&config);
    let watch = |n: &str| SensorMonitor::new(SensorConfig::believed(n, Role::Temperature));
    let time = Rc::new(Recorded(Cell::new(0.0)));
    let played = SensorThreads::without_threads(["T8", "T18"].map(watch).to_vec());
    let mut session = ControlSide::with_clock(Rc::clone(&time) as _, config, set_up(&engine, false), played);
    let machine = Machine::read(&folder.join("machine.toml")).unwrap();
    session.corrector.load(machine, &|_| Vec::new()).unwrap();
    let mut status = CorrectorStatus { mode: CorrectorMode::Run, axes_used: 3, ..CorrectorStatus::default() };
    status.axes.iter_mut().for_each(|a| a.homed = true);
    let (mut control, mut rt) = link(status);
    let mut reader = Reader::open(&folder.join("shift.csv")).unwrap();
    let header = reader.header("t_s, positions, sensors, operator, totals").unwrap();
    let mut rows = 0;
    while let Some(row) = reader.row().unwrap() {
        let mut at = Vec::new();
        let take = |_, cell: rtec_files::csv::Cell<'_>| cell.finite().map(|v| at.push(v));
        header.each(row, take).unwrap();
        time.0.set(at[0]);
        for (watch, value) in session.sensors.look().iter_mut().zip(&at[4..6]) {
            watch.offer(at[0], Ok(*value));
        }
        session.corrector.operator_is(0, at[6] as i64);
        status.t_ns = (at[0] * 1e9).round() as u64;
        (0..3).for_each(|n| status.axes[n].position_counts = at[1 + n] as i64);
        rt.publish(status);
        session.next_evaluation = Instant::now();
        session.tick(&mut control);
        while let Some(request) = rt.request() {
            let RequestToRt::Correct { axis, total_counts, large: false } = request else {
                panic!("{request:?} from the corrector")
            };
            let axis = &mut status.axes[usize::from(axis)];
            (axis.requested, axis.completed, axis.in_effect) = (total_counts, total_counts, total_counts);
        }
        for n in 0..3 {
            assert_eq!(status.axes[n].requested, at[7 + n] as i64, "axis {n} at {} s", at[0]);
        }
        rows += 1;
    }
    assert_eq!(rows, 2400);
}

/// A silent real-time thread and a full ring give answers instead of a hang.
#[test]
fn a_full_ring_and_a_silent_thread_are_answers_not_hangs() {
    let (engine, _card) = engine(&Config::embedded());
    let mut session = session(&engine);
    session.patience = Duration::from_millis(1);
    let (mut control, _rt) = link(engine.status());
    let hold = ClientRequest::Hold { on: true };
    for _ in 0..REQUESTS {
        let DaemonResponse::Refused { why, .. } = ask(&mut session, &hold, &mut control) else {
            panic!("an answer from nobody")
        };
        assert_eq!(why, "no_answer");
    }
    let DaemonResponse::Refused { why, text, .. } = ask(&mut session, &hold, &mut control) else {
        panic!("an answer from nobody")
    };
    assert!(why == "ring_full" && text.contains("256 requests"), "{why}: {text}");
    // A status never waits for the real-time thread.
    assert!(matches!(ask(&mut session, &ClientRequest::Status {}, &mut control), DaemonResponse::Status(_)));
}

/// A model that ends while it runs stays active, and is not enabled again.
/// It needs a new consent.
#[test]
fn corrections_are_not_enabled_on_a_model_that_has_ended() {
    let directory = tempfile::tempdir().unwrap();
    let mut config = Config::embedded();
    config.control.state_file = Some(directory.path().join("state"));
    let (engine, card) = engine(&config);
    let mut session = session(&engine);
    session.config = config;
    let options = ThreadOptions { wanted: None, real: false, stale_after_ns: 10_000_000_000 };
    let mut running = spawn(engine, card, options).unwrap();
    let control = &mut running.control;
    let file = directory.path().join("m.toml");
    let text = "name = \"m\"\n[[fit]]\nresponse = \"error.x\"\ndate = \"1970-01-01\"\nvalid_until = \"1970-01-11\"\n\
                rms_um = 0.1\nhalf_width_um = 0.2\n";
    std::fs::write(&file, text).unwrap();
    let sha256 = Machine::read(&file).unwrap().sha256().to_owned();
    let load = |expired| ClientRequest::ModelLoad {
        file: Some(file.display().to_string()),
        take: Some(sha256.clone()),
        expired,
        files: Vec::new(),
    };
    let (enable, done) = (ClientRequest::Enable { accept_jump: false }, DaemonResponse::done());
    let refused = |response: DaemonResponse| match response {
        DaemonResponse::Refused { why, text, .. } => (why, text),
        other => panic!("{other:?}"),
    };
    session.today = || 10;
    assert_eq!(ask(&mut session, &load(false), control), done);
    assert_eq!(ask(&mut session, &ClientRequest::Home { axis: None, controller_homed: None }, control), done);
    assert_eq!(ask(&mut session, &enable, control), done);
    session.today = || 11;
    session.tick(control);
    let status = session.status(control);
    assert!(status.why_not.is_empty(), "what is cut goes on: {:?}", status.why_not);
    assert_eq!(status.model.unwrap().expired.len(), 1);
    assert_eq!(ask(&mut session, &ClientRequest::Disable {}, control), done);
    assert!(session.status(control).why_not.iter().any(|w| w.contains("validity ended on 1970-01-11")));
    let (why, text) = refused(ask(&mut session, &enable, control));
    assert!(why == "expired" && text.contains("load --expired"), "{why}: {text}");
    assert_eq!(refused(ask(&mut session, &load(false), control)).0, "expired");
    // A restart does not load it without consent. With consent it is loaded and can be enabled.
    session.corrector.unload();
    session.take_up_model();
    assert!(session.status(control).model.is_none());
    assert_eq!(ask(&mut session, &load(true), control), done);
    session.corrector.unload();
    session.take_up_model();
    assert!(session.status(control).model.is_some());
    assert_eq!(ask(&mut session, &enable, control), done);
    running.stop();
}

/// A silent control side switches corrections off, and the status says so.
/// After its return they wait to be enabled.
#[test]
fn a_stale_control_side_freezes_corrections_and_is_named() {
    let config = Config::embedded();
    let (engine, card) = engine(&config);
    let mut session = session(&engine);
    let options = ThreadOptions { wanted: None, real: false, stale_after_ns: 20_000_000 };
    let mut running = spawn(engine, card, options).unwrap();
    let control = &mut running.control;
    let done = DaemonResponse::done();
    assert_eq!(ask(&mut session, &ClientRequest::Home { axis: None, controller_homed: None }, control), done);
    let enabled = ask(&mut session, &ClientRequest::Enable { accept_jump: false }, control);
    let DaemonResponse::Done { jumps, warnings, already: false } = enabled else { panic!("{enabled:?}") };
    assert!(jumps.is_empty() && warnings[0].starts_with("no model is loaded"), "{warnings:?}");
    while !control.status().control_stale {
        std::thread::sleep(Duration::from_millis(1));
    }
    let status = session.status(control);
    assert!(status.rt.control_stale && status.axes[0].gate == "control_stale", "{status:?}");
    assert!(status.why_not.iter().any(|w| w.contains("silent")), "{:?}", status.why_not);
    while control.status().control_stale {
        control.beat();
        std::thread::sleep(Duration::from_millis(1));
    }
    // The return enables nothing.
    let why = session.status(control).why_not;
    assert_eq!(why, ["corrections are off since the control side was silent: `rtecctl enable`"]);
    let enable = ClientRequest::Enable { accept_jump: false };
    assert!(matches!(ask(&mut session, &enable, control), DaemonResponse::Done { .. }));
    assert!(session.status(control).why_not.is_empty());
    let (ended, mut control) = running.stop();
    assert!(ended.status.balanced());
    // A thread that has ended is reported.
    let DaemonResponse::Refused { why, .. } = ask(&mut session, &ClientRequest::Clear {}, &mut control)
    else {
        panic!("an answer from nobody")
    };
    assert_eq!(why, "ended");
}

/// A real card with another machine's figures, or too fast an axis, is not armed.
/// The status says why.
#[test]
fn a_card_without_figures_of_its_own_is_not_armed() {
    let text = "[machine]\nname = 'm'\n[card]\nbackend = 'mapped'\nuio = '/dev/uio0'\n[[axis]]\nname = 'x'\ncount_um = 0.1\n\
        travel_mm = 400\nmax_correction_counts = 100\nwindow_counts = 50\nmin_separation_ns = 100\nmax_accel_mm_s2 = 100\n\
        rapid_mm_min = 30000\nlines = { a = 'in0', b = 'in1', invert_a = 'out0', invert_b = 'out1' }\n\
        [rt]\ndetect_ns = 1000\nwrite_ns = 300\n";
    let foreign = "measured = { card = 'another', kernel = '1.0', cpu = 'any', date = '2026-01-01' }\n";
    let figures = Config::parse(Path::new("rtec.toml"), text).unwrap();
    let here = format!("{}\n", LatencyTestConditions::here(&figures.card, 0, &SystemRoot::live()));
    for (measured, slower, says) in [
        ("", false, &["does not say where", "5000000 edges/s"][..]),
        (foreign, true, &["was measured with card \"another\""]),
        (&here, false, &["5000000 edges/s"]),
        (&here, true, &[]),
    ] {
        let text = format!("{text}{measured}").replace("30000", if slower { "3000" } else { "30000" });
        let config = Config::parse(Path::new("rtec.toml"), &text).unwrap();
        let (engine, _card) = engine(&config);
        let time = Rc::new(SystemClock(SteadyEpochClock::start()));
        let session = ControlSide::with_clock(
            time,
            config,
            set_up(&engine, true),
            SensorThreads::without_threads(Vec::new()),
        );
        let (mut control, _rt) = link(engine.status());
        let (refusal, status) =
            (session.forbidden(&engine.status(), &[], true), session.status(&mut control));
        assert_eq!(refusal.is_some(), !says.is_empty(), "{refusal:?}");
        let why = format!("{refusal:?} {:?}", status.why_not);
        for text in says {
            assert_eq!(
                why.replace('\\', "").matches(text).count(),
                2,
                "{text} at enable and in the status: {why}"
            );
        }
        assert!(!status.rt.may_arm, "without a verified set-up nothing is armed");
        assert_eq!(status.axes[0].rates.followed_mm_min.map(f64::round), Some(6000.0));
    }
}
