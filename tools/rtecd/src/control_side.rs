//! The control side's state and actions.
//! It handles requests, the corrector's ticks, and reports of the real-time thread.
//!
//! | file | what |
//! |---|---|
//! | `rt_requests` | requests that go to the real-time thread |
//! | `model_and_table_loads` | loads and unloads models and part tables |
//! | `status_reports` | the status and all other reports |

mod model_and_table_loads;
mod rt_requests;
mod status_reports;
#[cfg(test)]
mod tests;

use crate::audit_log_thread::Totals;
use crate::client_connection::user_name;
use crate::edited_files::EditedFilesChecker;
use crate::fault_ledger_history::FaultLedgerHistory;
use crate::mock_cards::SimulatedOperator;
use crate::record_spool::{RecordSpoolWriter, SpoolFolder, SpoolResult};
use crate::request_file_loader::{RequestFileLoader, Ticket};
use crate::stderr_journal_log::{self, SyslogLevel};
use model_and_table_loads::LoadPurpose;
use rtec_control::config::{Config, ConfiguredAxis, LatencyTestConditions};
use rtec_control::protocol::{ClientRequest, DaemonResponse, EventReport, NumberedEvent, word};
use rtec_correct::Corrector;
use rtec_files::date;
use rtec_model::record::Role;
use rtec_rt::engine::LoopHistograms;
use rtec_rt::journal::StateAtOpen;
use rtec_rt::link::ControlEnd;
use rtec_rt::link_messages::{
    CorrectorMode, CorrectorStatus, Event, EventKind, Fault, FeedHoldSource, Refusal, RequestToRt,
};
use rtec_rt::realtime_setup::{RtSettings, SetupReport, SystemRoot};
use rtec_rt::state_file_watch::{StateFileLoss, StateFileWatch};
use rtec_sensors::sensor_bus_threads::{SensorThreads, SteadyEpochClock};
use rtec_sensors::{SensorConfig, SensorMonitor};
use std::collections::{BTreeMap, VecDeque};
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::time::{Duration, Instant};

/// Time after which an unanswered request means that the real-time thread is stuck.
/// A running thread takes a request within a millisecond or two.
const PATIENCE: Duration = Duration::from_secs(2);
/// Time without a look at the card after which the real-time thread is lost.
/// With the turns of the control loop the delay stays below 0.2 s.
pub(crate) const STANDS_STILL: Duration = Duration::from_millis(150);
/// Silence of the control side itself that is logged.
/// A request without an answer takes [`PATIENCE`].
const STOOD_STILL: Duration = Duration::from_secs(3);
/// Interval of the checks of the state file.
const STATE_FILE_EVERY: Duration = Duration::from_secs(1);
/// Number of events that are kept for later questions.
const EVENTS: usize = 1000;

/// Outcome of a request.
pub(crate) enum RequestOutcome {
    /// It is answered.
    Now(DaemonResponse),
    /// An insertion is under way, so the request must be repeated.
    /// The response is for a caller who has no time left.
    Again(DaemonResponse),
    /// It is answered when this load is done.
    Later(Ticket),
}

impl RequestOutcome {
    fn of(answer: Result<DaemonResponse, DaemonResponse>) -> Self {
        match answer.unwrap_or_else(|e| e) {
            DaemonResponse::Refused { why, text, jumps } if why == word(Refusal::Busy) => {
                Self::Again(DaemonResponse::Refused { why, text, jumps })
            }
            response => Self::Now(response),
        }
    }
}

/// What comes with a request, apart from its line.
#[derive(Default)]
pub(crate) struct RequestContext {
    /// Open files of the caller, in the order in which they came.
    pub(crate) files: Vec<OwnedFd>,
    /// The caller may name files to open, because it is root or the daemon's own user.
    pub(crate) trusted: bool,
    /// Number and name of the caller's user.
    pub(crate) user: (u32, String),
}

/// Facts about the real-time thread from its start.
pub(crate) struct RtStartupReport {
    /// The card drives a real machine.
    pub real: bool,
    pub wanted: Option<RtSettings>,
    pub missing: Option<SetupReport>,
    pub timing: LoopHistograms,
    /// Content of the state file at the start.
    /// It tells when faults were latched, and in which boot of the computer.
    pub before: StateAtOpen,
}

/// Clock of the control side. A simulation has its own.
pub(crate) trait ControlClock {
    fn now(&self) -> Instant;
    /// Seconds since 1970, without steps.
    fn now_s(&self) -> f64;
    fn sleep(&self, duration: Duration);
}

/// The system's clock.
struct SystemClock(SteadyEpochClock);

impl ControlClock for SystemClock {
    fn now(&self) -> Instant {
        Instant::now()
    }

    fn now_s(&self) -> f64 {
        self.0.now_s()
    }

    fn sleep(&self, duration: Duration) {
        std::thread::sleep(duration);
    }
}

pub(crate) struct ControlSide {
    config: Config,
    set_up: RtStartupReport,
    time: Rc<dyn ControlClock>,
    started: Instant,
    patience: Duration,
    /// The sensors' threads; each tick passes their readings to the corrector.
    sensors: SensorThreads,
    corrector: Corrector,
    /// Time of the corrector's next evaluation.
    next_evaluation: Instant,
    /// Time when this side was last active.
    looked: Instant,
    /// The person at the machine, if it is simulated.
    simulated_operator: Option<SimulatedOperator>,
    /// Why corrections can never be enabled on this card and computer.
    unfit: Vec<String>,
    /// The check for edited files; `None` in a simulation.
    edited_files: Option<EditedFilesChecker>,
    /// Why the model of the last process was not taken up, if so.
    model_refused: Option<String>,
    loader: RequestFileLoader,
    record_spool: RecordSpoolWriter,
    /// Purpose of the load under way.
    load_purpose: Option<LoadPurpose>,
    /// Number of looks at the card when a request was last left unanswered.
    unanswered: Option<u64>,
    /// The latest events, and the number of all events.
    events: VecDeque<NumberedEvent>,
    event_count: u64,
    /// Events since the server last asked.
    unreported_events: Vec<EventReport>,
    /// Earlier events, for later questions.
    history: FaultLedgerHistory,
    /// Times when each fault was latched, on the card's clock, ns.
    /// `held_ns` is the time of the request for feed hold.
    latched_ns: BTreeMap<(Option<usize>, u8), u64>,
    held_ns: Option<u64>,
    /// Number and name of the user who asked for feed hold last.
    holder: (u32, String),
    /// Gives the present day, counted from 1970-01-01.
    today: fn() -> i64,
    /// The state file, if any.
    /// Beside it are the time of its next check, and the last message about it.
    state_file: Option<StateFileWatch>,
    state_file_due: Instant,
    state_file_said: String,
}

impl ControlSide {
    pub(crate) fn new(
        config: Config,
        set_up: RtStartupReport,
        (sensors, clock): (SensorThreads, SteadyEpochClock),
        edited_files: Option<EditedFilesChecker>,
    ) -> Self {
        Self { edited_files, ..Self::with_clock(Rc::new(SystemClock(clock)), config, set_up, sensors) }
    }

    fn with_clock(
        time: Rc<dyn ControlClock>,
        config: Config,
        set_up: RtStartupReport,
        mut sensors: SensorThreads,
    ) -> Self {
        let setups = config.axes.iter().map(ConfiguredAxis::axis_setup).collect();
        let (model, axes) = (&config.model, config.axes.len());
        let temperature = |c: &SensorConfig| c.role == Role::Temperature;
        let logged = config.sensors.iter().enumerate().filter(|(_, c)| temperature(c));
        let logged = logged.map(|(n, c)| (n, c.name.clone())).collect();
        let record_spool = RecordSpoolWriter::new(SpoolFolder::of(&config.control), logged);
        let mut corrector = Corrector::new(setups, model.ramp_um_s, model.lead_ms * 1e-3, time.now_s());
        corrector.sense(time.now_s(), sensors.look());
        let places = std::iter::once(None).chain((0..axes).map(Some));
        let known = places.flat_map(|axis| Fault::ALL.map(|fault| (axis, fault)));
        let latched_ns = known
            .filter_map(|(axis, f)| Some(((axis, f as u8), set_up.before.times.latched_ns(axis, f)?)))
            .collect();
        let cpu = set_up.wanted.map_or(0, |w| w.cpu);
        let here = || LatencyTestConditions::here(&config.card, cpu, &SystemRoot::live());
        let unfit = if set_up.real { config.unfit(&here()) } else { Vec::new() };
        Self {
            latched_ns,
            held_ns: set_up.before.times.held_ns(),
            holder: (u32::MAX, String::new()),
            unfit,
            edited_files: None,
            config,
            set_up,
            started: time.now(),
            patience: PATIENCE,
            sensors,
            corrector,
            next_evaluation: time.now(),
            looked: time.now(),
            simulated_operator: None,
            model_refused: None,
            loader: RequestFileLoader::new(),
            record_spool,
            load_purpose: None,
            unanswered: None,
            events: VecDeque::new(),
            event_count: 0,
            unreported_events: Vec::new(),
            history: FaultLedgerHistory::new(axes),
            today: date::today,
            state_file: None,
            state_file_due: time.now(),
            state_file_said: String::new(),
            time,
        }
    }

    /// The machine's identity, in words.
    pub(crate) fn identity(&self) -> String {
        self.config.identity()
    }

    pub(crate) fn axes(&self) -> &[ConfiguredAxis] {
        &self.config.axes
    }

    /// Interval at which the real-time thread must see a sign of life.
    pub(crate) fn beat_every(&self) -> Duration {
        let stale = Duration::from_millis((self.config.control.stale_ms / 4).clamp(1, 20));
        stale.min(Duration::from_millis(self.config.model.period_ms))
    }

    /// Time without a look after which the real-time thread is lost.
    /// An ordinary thread may be kept waiting by others.
    pub(crate) fn stands_still_after(&self) -> Duration {
        if self.set_up.wanted.is_some() { STANDS_STILL } else { PATIENCE }
    }

    /// Makes the machine a simulated one, which can be jogged.
    pub(crate) fn stand_at(&mut self, stand: SimulatedOperator) {
        self.simulated_operator = Some(stand);
    }

    /// Directory of the temperatures' log and the loaded model, beside the state file.
    fn directory(&self) -> PathBuf {
        self.config.control.state_path().parent().unwrap_or(Path::new("")).to_owned()
    }

    /// Lets the corrector evaluate, if it is due, and sends its requests.
    pub(crate) fn tick(&mut self, control: &mut ControlEnd) {
        let status = control.status();
        self.history.look(&status);
        if let Some(FeedHoldSource::User(uid)) = status.held
            && uid != self.holder.0
        {
            // The user comes from the process before this one.
            self.holder = (uid, user_name(uid));
        }
        self.set_up.before.other_boot &= status.axes().iter().any(|a| !a.mtc_known);
        self.held_ns = status.held.and(self.held_ns.or(Some(status.t_ns)));
        while let Some(kept) = self.record_spool.done() {
            self.tell_kept(kept, control.status().t_ns);
        }
        let now = self.time.now();
        self.stood_still(now, control);
        if now >= self.state_file_due {
            self.state_file_due = now + STATE_FILE_EVERY;
            self.look_after_state_file(control);
        }
        if now < self.next_evaluation {
            return;
        }
        let period = Duration::from_millis(self.config.model.period_ms);
        self.next_evaluation = (self.next_evaluation + period).max(now);
        for ended in self.corrector.day_is((self.today)()) {
            let text = format!("machine model: {ended}; it goes on until corrections are next enabled");
            stderr_journal_log::event(SyslogLevel::Warning, "model_expired", &text);
        }
        let status = control.status();
        if let Some(stand) = &self.simulated_operator {
            // As a machine's operator, it moves once all axes are homed, and not during feed hold.
            let held = matches!(status.mode, CorrectorMode::Hold | CorrectorMode::Fault);
            stand.feed(!held && status.axes().iter().all(|a| a.homed));
        }
        let totals = self.corrector.tick(self.time.now_s(), &status, self.sensors.look());
        for (axis, total) in totals.into_iter().enumerate() {
            let Some(total_counts) = total else { continue };
            let request = RequestToRt::Correct { axis: axis as u8, total_counts, large: false };
            if let Err(full) = control.send(request) {
                // The next total makes up for it.
                return stderr_journal_log::event(SyslogLevel::Warning, "ring_full", &full.to_string());
            }
        }
    }

    /// Starts to check the state file.
    pub(crate) fn watch_over(&mut self, state_file: Option<StateFileWatch>) {
        self.state_file = state_file;
    }

    /// Writes the state file again if it was lost, and latches the fault.
    /// Otherwise the totals and faults in effect would be lost with the process.
    pub(crate) fn look_after_state_file(&mut self, control: &mut ControlEnd) {
        let lost = self.state_file.as_ref().filter(|_| !control.ended()).and_then(StateFileWatch::lost);
        let Some((lost, mut file)) = lost.and_then(|lost| Some((lost, self.state_file.take()?))) else {
            return;
        };
        let renewed = file.renew().map_err(|error| error.to_string());
        // The fault is latched in any case, and noted where that is possible.
        let noted = self.send(RequestToRt::StateFileLost, control);
        let noted = noted.map_err(|_| "the real-time thread does not answer".to_owned());
        let placed = renewed.and(noted).and_then(|_| file.place().map_err(|error| error.to_string()));
        let what = match lost {
            StateFileLoss::Removed => "removed",
            StateFileLoss::Replaced => "replaced by another",
            StateFileLoss::Resized => "cut short or made longer",
            StateFileLoss::Overwritten => "overwritten",
        };
        let path = file.path().display();
        let text = match placed {
            Ok(()) => format!("state file {path}: it was {what}; it is written anew"),
            Err(why) => format!(
                "state file {path}: it was {what}, and cannot be written anew: {why}. A restart would know neither faults nor \
                 counts"
            ),
        };
        self.state_file = Some(file);
        if self.state_file_said != text {
            stderr_journal_log::record(SyslogLevel::Error, "state_file_lost", &text, &[]);
            let t_ns = control.status().t_ns;
            self.tell_own(t_ns, "state_file_lost", text.clone());
            self.state_file_said = text;
        }
    }

    /// Notes for the next process that the real-time thread stands still.
    /// Returns `false` where it cannot be noted.
    pub(crate) fn note_thread_lost(&self) -> bool {
        self.state_file.as_ref().is_none_or(|file| {
            file.note_thread_lost();
            file.lost().is_none()
        })
    }

    /// Logs that the process was stopped, or had no CPU, when it runs again.
    fn stood_still(&mut self, now: Instant, control: &mut ControlEnd) {
        let gap = now.duration_since(self.looked);
        self.looked = now;
        if gap < STOOD_STILL {
            return;
        }
        let text = format!("the daemon did not run for {:.1} s", gap.as_secs_f64());
        stderr_journal_log::event(SyslogLevel::Warning, "stood_still", &text);
        let t_ns = control.status().t_ns;
        self.tell_own(t_ns, "stood_still", text);
    }

    /// Whether the end of the record of commands is written to the system's journal.
    pub(crate) fn anchors_record(&self) -> bool {
        self.config.control.log_anchor
    }

    /// The problem that keeps records from being kept, if any.
    pub(crate) fn spool_trouble(&self) -> Option<String> {
        self.record_spool.trouble()
    }

    /// Logs the result of a record.
    fn tell_kept(&mut self, kept: SpoolResult, t_ns: u64) {
        let (level, kind, text) = match kept {
            Ok(file) => (SyslogLevel::Info, "record_kept", format!("record {}", file.display())),
            Err(why) => (SyslogLevel::Warning, "record_not_kept", why),
        };
        stderr_journal_log::event(level, kind, &text);
        self.tell_own(t_ns, kind, text);
    }

    /// Writes the captured record at the daemon's end, within this time.
    pub(crate) fn keep_the_rest(&mut self, patience: Duration) {
        self.record_spool.end(&self.config.axes);
        while let Some(kept) = self.record_spool.last(patience) {
            self.tell_kept(kept, 0);
        }
    }

    /// Tells an event of the daemon itself.
    fn tell_own(&mut self, t_ns: u64, kind: &str, text: String) {
        self.tell(EventReport { t_ns, axis: None, kind: kind.to_owned(), text, trip: None });
    }

    /// Keeps an event for later questions, and passes it on.
    fn tell(&mut self, happened: EventReport) {
        self.event_count += 1;
        if self.events.len() == EVENTS {
            self.events.pop_front();
        }
        let at_s = self.time.now_s();
        self.events.push_back(NumberedEvent { n: self.event_count, at_s, event: happened.clone() });
        self.unreported_events.push(happened);
    }

    /// Takes the events since the last call.
    pub(crate) fn take_happened(&mut self) -> Vec<EventReport> {
        std::mem::take(&mut self.unreported_events)
    }

    /// Logs what the real-time thread has reported.
    pub(crate) fn drain(&mut self, control: &mut ControlEnd) {
        while let Some(event) = control.event() {
            self.note(&event);
        }
    }

    fn note(&mut self, event: &Event) {
        let axis = event.axis.and_then(|n| self.config.axes.get(usize::from(n)));
        let mut happened = EventReport::of(event, axis.map(|a| (a.name.as_str(), a.count_um)));
        if let EventKind::Fault(fault) = event.kind {
            self.latched_ns.insert((event.axis.map(usize::from), fault as u8), event.t_ns);
        }
        if let Some(n) = event.axis.map(usize::from) {
            if let EventKind::Homed { kept_counts } = event.kind {
                self.corrector.homed(n, kept_counts);
            }
            if let (EventKind::Trip(capture), Some(trip)) = (event.kind, &mut happened.trip) {
                let t_ns = u64::midpoint(capture.trip_ns.0, capture.trip_ns.1);
                trip.error_um = self.corrector.error_um_at(n, t_ns, trip.position_mm);
                trip.corrected_mm = trip.error_um.map(|um| trip.position_mm + um / 1000.0);
                let degc =
                    |w: &SensorMonitor| w.value_degc().filter(|_| w.config().role == Role::Temperature);
                trip.degc = self.corrector.watches().iter().map(degc).collect();
                self.record_spool.trip(n, &self.config.axes, trip, self.time.now_s());
            }
        }
        match event.kind {
            EventKind::Mode(CorrectorMode::Probe) => self.record_spool.begin(event.t_ns, self.time.now_s()),
            EventKind::Mode(_) => self.record_spool.end(&self.config.axes),
            _ => {}
        }
        let level = match event.kind {
            EventKind::Fault(_) => SyslogLevel::Error,
            EventKind::Refused { .. }
            | EventKind::Warning { .. }
            | EventKind::ControlStale(_)
            | EventKind::ControllerReady(_) => SyslogLevel::Warning,
            EventKind::Mode(_) | EventKind::Homed { .. } => SyslogLevel::Notice,
            _ => SyslogLevel::Info,
        };
        let text = match &happened.axis {
            Some(axis) => format!("axis {axis}: {}", happened.text),
            None => happened.text.clone(),
        };
        let reason = match event.kind {
            EventKind::Fault(fault) => word(fault),
            EventKind::Mode(mode) => word(mode),
            _ => String::new(),
        };
        let fields = [("RTEC_AXIS", happened.axis.as_deref().unwrap_or("")), ("RTEC_REASON", &reason)];
        let fields: Vec<_> = fields.into_iter().filter(|(_, value)| !value.is_empty()).collect();
        // Trips and similar events may come by the thousand, so their lines are limited.
        let rare = matches!(event.kind, EventKind::Fault(_) | EventKind::Mode(_) | EventKind::Homed { .. });
        if rare {
            stderr_journal_log::record(level, &happened.kind, &text, &fields);
        } else {
            stderr_journal_log::event(level, &happened.kind, &text);
        }
        self.history.note(event);
        self.tell(happened);
    }

    /// Carries out a request. The server handles `watch`, `whoami` and `observe`.
    pub(crate) fn answer(
        &mut self,
        request: &ClientRequest,
        beside: RequestContext,
        control: &mut ControlEnd,
    ) -> RequestOutcome {
        let done = DaemonResponse::done();
        let plain = |request| (request, done.clone());
        let (request, done) = match request {
            ClientRequest::Status {} => {
                return RequestOutcome::Now(DaemonResponse::Status(Box::new(self.status(control))));
            }
            ClientRequest::Home { axis, controller_homed } => {
                return RequestOutcome::of(self.home(axis.as_deref(), *controller_homed, control));
            }
            ClientRequest::Enable { accept_jump } => {
                let status = control.status();
                // Corrections that are on go on in their ramp, which is no jump.
                let already = status.mode == CorrectorMode::Run;
                let jumps = if already { Vec::new() } else { self.jumps(&status) };
                if let Some(refusal) = self.forbidden(&status, &jumps, *accept_jump) {
                    return RequestOutcome::Now(refusal);
                }
                let warnings = self.no_model().into_iter().collect();
                (RequestToRt::Enable, DaemonResponse::Done { jumps, already, warnings })
            }
            ClientRequest::Shadow {} => plain(RequestToRt::Shadow),
            ClientRequest::Correct { axis, total_counts, large } => {
                return RequestOutcome::of(self.correct(axis, *total_counts, *large, control));
            }
            ClientRequest::ModelLoad { file, take, expired, files } => {
                let wanted =
                    model_and_table_loads::ModelLoadOptions { take: take.clone(), expired: *expired };
                return self.model_load(file.as_deref(), files, wanted, beside);
            }
            ClientRequest::Jog { axis, display_mm, go_on } => {
                return RequestOutcome::of(self.jog(axis, *display_mm, *go_on));
            }
            ClientRequest::ModelUnload {} => return RequestOutcome::Now(self.model_unload()),
            ClientRequest::ModelAgain {} => return self.model_again(),
            ClientRequest::Explain { axis } => {
                return RequestOutcome::of(self.explain(axis.as_deref(), control));
            }
            ClientRequest::Ledger { axis, from } => {
                let page = self.number(axis).map(|n| DaemonResponse::Ledger(self.history.ledger(n, *from)));
                return RequestOutcome::of(page);
            }
            ClientRequest::Keep { files } => return self.keep(files, beside),
            ClientRequest::TableLoad(table) => return self.table_load(table, beside),
            ClientRequest::TableUnload {} => return RequestOutcome::Now(self.table_unload()),
            ClientRequest::Disable {} | ClientRequest::Park {} => plain(RequestToRt::Disable),
            ClientRequest::Probe { on } => plain(RequestToRt::Probe(*on)),
            ClientRequest::Hold { on } => {
                let by = beside.user.0;
                if *on {
                    self.holder = beside.user;
                }
                plain(RequestToRt::Hold { on: *on, by })
            }
            ClientRequest::Clear {} => plain(RequestToRt::Clear),
            ClientRequest::Watch {} | ClientRequest::Whoami {} | ClientRequest::Observe { .. } => {
                return RequestOutcome::Now(done);
            }
        };
        let answer = self.carry_out(request, control);
        if request == RequestToRt::Enable && answer.is_ok() {
            self.corrector.enabled();
        }
        RequestOutcome::of(answer.map(|_| done))
    }

    /// Totals of each axis: requested and in effect, counts.
    pub(crate) fn totals(&self, control: &mut ControlEnd) -> Totals {
        let status = control.status();
        let all = self.config.axes.iter().zip(status.axes());
        all.map(|(axis, s)| (axis.name.clone(), [s.requested, s.in_effect])).collect()
    }

    /// Latched faults: the axis (`None` for the machine's own) and the fault's word.
    pub(crate) fn latched(&self, now: &CorrectorStatus) -> Vec<(Option<String>, String)> {
        self.latched_faults(now).into_iter().map(|latched| (latched.axis, word(latched.fault))).collect()
    }

    /// Faults latched since before the first look, which have no events of their own.
    pub(crate) fn found_at_start(&self, now: &CorrectorStatus) -> Vec<EventReport> {
        let found = |(axis, fault): (Option<String>, String)| {
            let (kind, text) = ("fault".to_owned(), format!("{fault}, found at the start"));
            EventReport { t_ns: now.t_ns, axis, kind, text, trip: None }
        };
        self.latched(now).into_iter().map(found).collect()
    }

    /// SHA-256 of the running model.
    pub(crate) fn model_hash(&self) -> Option<String> {
        self.corrector.running_model().map(|m| m.sha256)
    }

    /// The state in one line, for the service manager.
    pub(crate) fn in_short(&self, now: &CorrectorStatus) -> String {
        let mut text = format!("mode {}", word(now.mode));
        for fault in now.faults.iter() {
            text = format!("{text}, {}", word(fault));
        }
        for (axis, s) in self.config.axes.iter().zip(now.axes()) {
            text = format!("{text}; {} {:+}", axis.name, s.in_effect);
            for fault in s.faults.iter() {
                text = format!("{text} {}", word(fault));
            }
        }
        text
    }
}
