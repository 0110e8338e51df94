//! Requests of the protocol, carried out on the link to the real-time thread.

use crate::cards::Stand;
use crate::log::{Level, Log};
use crate::temperatures::{Temperatures, history};
use rtec_control::config::{Config, ConfiguredAxis};
use rtec_control::protocol::{
    AxisReport, ClientRequest, DaemonStatus, Distribution, Happened, Jump, ModelPreview, PartTable, Response,
    Rt, explain_fault, explain_refusal, word,
};
use rtec_correct::Corrector;
use rtec_correct::explain::Reading;
use rtec_correct::sensors::Watch;
use rtec_files::InputError;
use rtec_model::date;
use rtec_model::machine::Machine;
use rtec_model::record::Role;
use rtec_part::errors::read_error_cor;
use rtec_rt::engine::Timing;
use rtec_rt::event::{Event, EventKind, Mode, Refusal, Request, Status};
use rtec_rt::histogram::Reader;
use rtec_rt::link::{ControlEnd, REQUESTS};
use rtec_rt::setup::{Report, Wanted};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// The real-time thread takes a request within a millisecond or two; one that takes longer than this does not run.
const PATIENCE: Duration = Duration::from_secs(2);
/// A request that finds an insertion under way is repeated so often.
const BUSY_TRIES: u32 = 50;

/// What is known of the real-time thread from its start on.
pub(crate) struct SetUp {
    /// The card drives a real machine.
    pub real: bool,
    pub wanted: Option<Wanted>,
    pub missing: Option<Report>,
    pub timing: Timing,
}

pub(crate) struct Session {
    config: Config,
    set_up: SetUp,
    started: Instant,
    patience: Duration,
    temperatures: Temperatures,
    corrector: Corrector,
    /// Time of the corrector's next look.
    due: Instant,
    /// Who stands at the machine, where it is a simulated one.
    stand: Option<Stand>,
    /// The model's file is not what was taken last.
    model_refused: Option<String>,
    /// What happened since the server last asked.
    happened: Vec<Happened>,
    /// The day, since 1970-01-01.
    today: fn() -> i64,
}

/// Which model was taken last: a file of this name beside the state file. Only that one runs after a restart. Its hash, its
/// file, and [`MEANT`] where it was taken although its validity had ended.
const TAKEN: &str = "model.taken";
const MEANT: &str = "although expired";
/// What to do about a model whose validity has ended.
const LOOK_AGAIN: &str = "`rtecctl model validate` it on a new record and fit again where it is no longer true; `rtecctl model \
                          load --expired` takes it as it is, `rtecctl model unload` goes on without";

impl Session {
    pub(crate) fn new(config: Config, set_up: SetUp, temperatures: Temperatures) -> Self {
        let setups = config.axes.iter().map(ConfiguredAxis::law).collect();
        let model = &config.model;
        let corrector = Corrector::new(setups, model.ramp_um_s, model.lead_ms * 1e-3, temperatures.now_s());
        Self {
            config,
            set_up,
            started: Instant::now(),
            patience: PATIENCE,
            temperatures,
            corrector,
            due: Instant::now(),
            stand: None,
            model_refused: None,
            happened: Vec::new(),
            today: date::today,
        }
    }

    pub(crate) fn axes(&self) -> &[ConfiguredAxis] {
        &self.config.axes
    }

    /// How often the real-time thread must see a sign of life.
    pub(crate) fn beat_every(&self) -> Duration {
        let stale = Duration::from_millis((self.config.control.stale_ms / 4).clamp(1, 20));
        stale.min(Duration::from_millis(self.config.model.period_ms))
    }

    /// The machine is simulated: it can be jogged from here.
    pub(crate) fn stand_at(&mut self, stand: Stand) {
        self.stand = Some(stand);
    }

    /// Where the temperatures' log and the name of the taken model are: beside the state file.
    fn directory(&self) -> PathBuf {
        self.config.control.state_path().parent().unwrap_or(Path::new("")).to_owned()
    }

    /// The model that was taken last runs on after a restart, unless its file has changed.
    pub(crate) fn take_up_model(&mut self, log: &mut Log) {
        let taken = std::fs::read_to_string(self.directory().join(TAKEN)).unwrap_or_default();
        let wanted = self.config.model.file.clone();
        let mut lines = taken.lines();
        let (sha256, file) = (lines.next().unwrap_or_default(), lines.next().map(PathBuf::from));
        let meant = lines.next() == Some(MEANT);
        let Some(file) = wanted.clone().or_else(|| file.clone()) else { return };
        let why = match Machine::read(&file) {
            Err(error) => error.to_string(),
            Ok(machine) if machine.sha256() == sha256 && !meant && self.ended(&machine).is_some() => {
                self.ended(&machine).unwrap_or_default()
            }
            Ok(machine) if machine.sha256() == sha256 => match self.load(machine) {
                Ok(()) => return log.say(Level::Notice, &format!("machine model {}", file.display())),
                Err(error) => error.to_string(),
            },
            Ok(_) if sha256.is_empty() => {
                format!("the model {} has not been taken yet: `rtecctl model load`", file.display())
            }
            Ok(_) => format!(
                "the model {} is not the one that was taken (its hash is another): `rtecctl model load` shows what it \
                 changes",
                file.display()
            ),
        };
        log.say(Level::Warning, &format!("no machine model: {why}"));
        self.model_refused = Some(why);
    }

    /// Why a model is not to be used any more: nobody has looked at it since its validity ended.
    fn ended(&self, machine: &Machine) -> Option<String> {
        let ended = machine.expired((self.today)());
        let file = machine.path.display();
        (!ended.is_empty()).then(|| format!("the model {file}: {}: {LOOK_AGAIN}", ended.join("; ")))
    }

    fn load(&mut self, machine: Machine) -> Result<(), InputError> {
        self.corrector.day_is((self.today)());
        self.temperatures.look();
        let (directory, now_s) = (self.directory(), self.temperatures.now_s());
        let past = |names: &[String]| history(&directory, names, now_s);
        self.corrector.load(machine, self.temperatures.sensors(), &past)?;
        self.model_refused = None;
        Ok(())
    }

    /// Lets the corrector look, where it is due, and sends what it asks for.
    pub(crate) fn tick(&mut self, control: &mut ControlEnd, log: &mut Log) {
        let now = Instant::now();
        if now < self.due {
            return;
        }
        let period = Duration::from_millis(self.config.model.period_ms);
        self.due = (self.due + period).max(now);
        self.temperatures.look();
        for ended in self.corrector.day_is((self.today)()) {
            let text = format!("machine model: {ended}; it goes on until corrections are next enabled");
            log.event(Level::Warning, "model_expired", &text);
        }
        let status = control.status();
        let (now_s, sensors) = (self.temperatures.now_s(), self.temperatures.sensors());
        let totals = self.corrector.tick(now_s, &status, sensors);
        for (axis, total) in totals.into_iter().enumerate() {
            let Some(total_counts) = total else { continue };
            let request = Request::Correct { axis: axis as u8, total_counts, large: false };
            if let Err(full) = control.send(request) {
                // It is a total: the next one makes it good.
                return log.event(Level::Warning, "ring_full", &full.to_string());
            }
        }
    }

    /// Takes what has happened since the last time.
    pub(crate) fn take_happened(&mut self) -> Vec<Happened> {
        std::mem::take(&mut self.happened)
    }

    /// Logs what the real-time thread has reported.
    pub(crate) fn drain(&mut self, control: &mut ControlEnd, log: &mut Log) {
        while let Some(event) = control.event() {
            self.note(&event, log);
        }
    }

    fn note(&mut self, event: &Event, log: &mut Log) {
        let axis = event.axis.and_then(|n| self.config.axes.get(usize::from(n)));
        let mut happened = Happened::of(event, axis.map(|a| (a.name.as_str(), a.count_um)));
        if let Some(n) = event.axis.map(usize::from) {
            if event.kind == EventKind::Homed {
                self.corrector.homed(n);
            }
            if let (EventKind::Trip(capture), Some(trip)) = (event.kind, &mut happened.trip) {
                let t_ns = u64::midpoint(capture.trip_ns.0, capture.trip_ns.1);
                trip.error_um = self.corrector.error_um_at(n, t_ns, trip.position_mm);
                trip.corrected_mm = trip.error_um.map(|um| trip.position_mm + um / 1000.0);
                let degc = |w: &Watch| w.value_degc().filter(|_| w.config().role == Role::Temperature);
                trip.degc = self.temperatures.sensors().iter().map(degc).collect();
            }
        }
        let level = match event.kind {
            EventKind::Fault(_) => Level::Error,
            EventKind::Refused { .. } | EventKind::Warning { .. } | EventKind::ControlStale(_) => {
                Level::Warning
            }
            EventKind::Mode(_) | EventKind::Homed => Level::Notice,
            _ => Level::Info,
        };
        let text = match &happened.axis {
            Some(axis) => format!("axis {axis}: {}", happened.text),
            None => happened.text.clone(),
        };
        log.event(level, &happened.kind, &text);
        self.happened.push(happened);
    }

    /// Sends a request and waits until it has been worked off; returns what was reported in the meantime.
    fn send(
        &mut self,
        request: Request,
        control: &mut ControlEnd,
        log: &mut Log,
    ) -> Result<Vec<Event>, Response> {
        let dead = |why: &str, text: &str| Response::Refused {
            why: why.to_owned(),
            text: text.to_owned(),
            jumps: Vec::new(),
        };
        let deadline = Instant::now() + self.patience;
        // What the corrector has sent is not answered to somebody else.
        while control.pending() > 0
            && control.pending() < REQUESTS
            && Instant::now() < deadline
            && !control.ended()
        {
            control.beat();
            std::thread::sleep(Duration::from_micros(200));
        }
        self.drain(control, log);
        control.send(request).map_err(|full| dead("ring_full", &full.to_string()))?;
        let mut events = Vec::new();
        // It is taken when the ring is empty, and worked off when a status is there that is newer than one read after
        // that. Its events come before that status.
        let mut taken_at = None;
        loop {
            control.beat();
            let status = control.status();
            let worked = taken_at.is_some_and(|polls| polls != status.polls);
            if taken_at.is_none() && control.pending() == 0 {
                taken_at = Some(control.status().polls);
            }
            while let Some(event) = control.event() {
                self.note(&event, log);
                events.push(event);
            }
            if worked {
                return Ok(events);
            }
            if control.ended() {
                return Err(dead(
                    "ended",
                    "the real-time thread has ended: see the log, then restart the daemon",
                ));
            }
            if Instant::now() > deadline {
                return Err(dead("no_answer", "the real-time thread does not answer: is its CPU taken?"));
            }
            std::thread::sleep(Duration::from_micros(200));
        }
    }

    /// Sends a request and turns what was reported into an answer; an insertion under way is waited for.
    fn carry_out(
        &mut self,
        request: Request,
        control: &mut ControlEnd,
        log: &mut Log,
    ) -> Result<Vec<Event>, Response> {
        for _ in 0..BUSY_TRIES {
            let events = self.send(request, control, log)?;
            let mut busy = false;
            for event in &events {
                match event.kind {
                    EventKind::Refused { why: Refusal::Busy, .. } => busy = true,
                    EventKind::Refused { why: Refusal::FaultLatched, .. } => {
                        return Err(Response::Fault {
                            text: explain_refusal(Refusal::FaultLatched).to_owned(),
                        });
                    }
                    EventKind::Refused { why, .. } => return Err(refused(why)),
                    EventKind::Fault(fault) => {
                        return Err(Response::Fault {
                            text: format!("{}: {}", word(fault), explain_fault(fault)),
                        });
                    }
                    _ => {}
                }
            }
            if !busy {
                return Ok(events);
            }
        }
        Err(refused(Refusal::Busy))
    }

    /// Carries out a request. `watch` is the server's.
    pub(crate) fn answer(
        &mut self,
        request: &ClientRequest,
        control: &mut ControlEnd,
        log: &mut Log,
    ) -> Response {
        let done = Response::Done { jumps: Vec::new() };
        let plain = |request| (request, done.clone());
        let (request, done) = match request {
            ClientRequest::Status {} => return Response::Status(Box::new(self.status(control))),
            ClientRequest::Home { axis } => {
                return self.home(axis.as_deref(), control, log).unwrap_or_else(|e| e);
            }
            ClientRequest::Enable { accept_jump } => {
                let jumps = self.jumps(&control.status());
                if let Some(refusal) = self.forbidden(&jumps, *accept_jump) {
                    return refusal;
                }
                (Request::Enable, Response::Done { jumps })
            }
            ClientRequest::Correct { axis, total_counts, large } => {
                let done = self.correct(axis, *total_counts, *large, control, log);
                return done.unwrap_or_else(|e| e);
            }
            ClientRequest::ModelLoad { file, take, expired } => {
                let done = self.model_load(file.as_deref(), take.as_deref(), *expired, control, log);
                return done.unwrap_or_else(|e| e);
            }
            ClientRequest::Jog { axis, display_mm } => {
                return self.jog(axis, *display_mm).unwrap_or_else(|e| e);
            }
            ClientRequest::ModelUnload {} => return self.model_unload(log),
            ClientRequest::Explain { axis } => {
                return self.explain(axis.as_deref(), control).unwrap_or_else(|e| e);
            }
            ClientRequest::TableLoad(table) => return self.table_load(table, log),
            ClientRequest::TableUnload {} => return self.table_unload(log),
            ClientRequest::Disable {} => plain(Request::Disable),
            ClientRequest::Shadow {} => plain(Request::Shadow),
            ClientRequest::Probe { on } => plain(Request::Probe(*on)),
            ClientRequest::Hold { on } => plain(Request::Hold(*on)),
            ClientRequest::Clear {} => plain(Request::Clear),
            ClientRequest::Watch {} => return done,
        };
        match self.carry_out(request, control, log) {
            Ok(_) => done,
            Err(response) => response,
        }
    }

    fn number(&self, axis: &str) -> Result<usize, Response> {
        self.config.axis(axis).ok_or_else(|| {
            let names: Vec<&str> = self.config.axes.iter().map(|a| a.name.as_str()).collect();
            let mut text = format!("found axis {axis:?}, expected one of {}", names.join(", "));
            if let Some(near) = self.config.nearest_axis(axis) {
                text = format!("{text}; did you mean {near}?");
            }
            Response::Bad { text }
        })
    }

    /// The operator's total, beside what the other sources ask for.
    fn correct(
        &mut self,
        axis: &str,
        operator_counts: i64,
        large: bool,
        control: &mut ControlEnd,
        log: &mut Log,
    ) -> Result<Response, Response> {
        let n = self.number(axis)?;
        let on = matches!(control.status().mode, Mode::Run | Mode::Shadow);
        let total_counts =
            if on { self.corrector.with_operator(n, operator_counts) } else { operator_counts };
        self.carry_out(Request::Correct { axis: n as u8, total_counts, large }, control, log)?;
        if on {
            self.corrector.operator_is(n, operator_counts);
        }
        Ok(Response::Done { jumps: Vec::new() })
    }

    /// Shows what a model would change, or takes the one that was shown.
    fn model_load(
        &mut self,
        file: Option<&str>,
        take: Option<&str>,
        expired: bool,
        control: &mut ControlEnd,
        log: &mut Log,
    ) -> Result<Response, Response> {
        let file = file.map(PathBuf::from).or_else(|| self.config.model.file.clone()).ok_or_else(|| {
            Response::Bad {
                text: "found no file; expected one, or [model] file in the configuration".to_owned(),
            }
        })?;
        let bad = |e: InputError| Response::Bad { text: e.to_string() };
        let machine = Machine::read(&file).map_err(bad)?;
        let sha256 = machine.sha256().to_owned();
        let Some(shown) = take else {
            self.temperatures.look();
            let (now_s, directory) = (self.temperatures.now_s(), self.directory());
            let mut warnings = machine.changed_sources();
            self.corrector.day_is((self.today)());
            let status = control.status();
            let watches = self.temperatures.sensors();
            let past = |names: &[String]| history(&directory, names, now_s);
            let preview = self.corrector.preview(machine, watches, &past, now_s, &status).map_err(bad)?;
            warnings.extend(preview.warnings);
            return Ok(Response::ModelPreview(Box::new(ModelPreview { warnings, ..preview })));
        };
        if shown != sha256 {
            let text = format!("{} has changed since it was shown: nothing is taken", file.display());
            return Err(Response::Refused { why: "changed".to_owned(), text, jumps: Vec::new() });
        }
        let ended = self.ended(&machine);
        if let Some(text) = ended.clone().filter(|_| !expired) {
            return Err(Response::Refused { why: "expired".to_owned(), text, jumps: Vec::new() });
        }
        self.load(machine).map_err(bad)?;
        let meant = ended.map_or(String::new(), |_| format!("{MEANT}\n"));
        self.remember(&format!("{sha256}\n{}\n{meant}", file.display()), log);
        log.say(Level::Notice, &format!("machine model {} taken, SHA-256 {sha256}", file.display()));
        Ok(Response::Done { jumps: Vec::new() })
    }

    fn remember(&self, text: &str, log: &mut Log) {
        let path = self.directory().join(TAKEN);
        if let Err(error) = rtec_files::write::whole(&path, text.as_bytes()) {
            let text = format!("{}: {error}: a restart will not know which model was taken", path.display());
            log.say(Level::Warning, &text);
        }
    }

    fn model_unload(&mut self, log: &mut Log) -> Response {
        // One that was refused at the start is given up, too.
        if !self.corrector.unload() && self.model_refused.take().is_none() {
            let text = "no model is loaded".to_owned();
            return Response::Refused { why: "no_model".to_owned(), text, jumps: Vec::new() };
        }
        self.remember("", log);
        log.say(Level::Notice, "machine model unloaded");
        Response::Done { jumps: Vec::new() }
    }

    /// Jogs a simulated axis, and reports what display and indicator show.
    fn jog(&self, axis: &str, display_mm: Option<f64>) -> Result<Response, Response> {
        let n = self.number(axis)?;
        let Some(stand) = &self.stand else {
            let text = "only a simulated machine can be jogged from here".to_owned();
            return Err(Response::Refused { why: "not_simulated".to_owned(), text, jumps: Vec::new() });
        };
        if let Some(mm) = display_mm {
            let travel_mm = self.config.axes[n].travel_mm;
            if mm.abs() > travel_mm {
                let text = format!("found {mm} mm, expected a place within the travel of {travel_mm} mm");
                return Err(Response::Bad { text });
            }
            stand.jog_to(n, mm);
        }
        let (display_mm, indicator_mm) = stand.read_mm(n);
        Ok(Response::Stands { display_mm, indicator_mm })
    }

    fn table_load(&mut self, table: &PartTable, log: &mut Log) -> Response {
        let errors = read_error_cor(Path::new(&table.errors)).map_err(|e| e.to_string());
        match errors.and_then(|errors| self.corrector.load_table(table.clone(), errors)) {
            Ok(()) => {
                log.say(Level::Notice, &format!("part table {}", table.errors));
                Response::Done { jumps: Vec::new() }
            }
            Err(text) => Response::Bad { text },
        }
    }

    fn table_unload(&mut self, log: &mut Log) -> Response {
        if !self.corrector.unload_table() {
            let text = "no part table is loaded".to_owned();
            return Response::Refused { why: "no_table".to_owned(), text, jumps: Vec::new() };
        }
        log.say(Level::Notice, "part table unloaded");
        Response::Done { jumps: Vec::new() }
    }

    fn explain(&mut self, axis: Option<&str>, control: &mut ControlEnd) -> Result<Response, Response> {
        let only = axis.map(|name| self.number(name)).transpose()?;
        let (status, now_s) = (control.status(), self.temperatures.now_s());
        let sensors = self.temperatures.sensors();
        let wanted = (0..self.config.axes.len()).filter(|n| only.is_none_or(|o| o == *n));
        let axes = wanted.map(|n| self.corrector.explain(n, &status.axes[n], sensors, now_s)).collect();
        Ok(Response::Explained { axes })
    }

    /// Homes one axis or all: the counter is set, read back here, and only the expected value completes it.
    fn home(
        &mut self,
        axis: Option<&str>,
        control: &mut ControlEnd,
        log: &mut Log,
    ) -> Result<Response, Response> {
        let axes = match axis {
            Some(name) => {
                let n = self.number(name)?;
                n..n + 1
            }
            None => 0..self.config.axes.len(),
        };
        for n in axes {
            let (axis, position_counts) = (n as u8, self.config.axes[n].home_counts);
            let events = self.carry_out(Request::Home { axis, position_counts }, control, log)?;
            let read_back = events.iter().find_map(|e| match e.kind {
                EventKind::HomeSet { position_counts } if e.axis == Some(axis) => Some(position_counts),
                _ => None,
            });
            if read_back != Some(position_counts) {
                let text = format!(
                    "axis {}: read back {read_back:?}, expected {position_counts} counts: not homed",
                    self.config.axes[n].name
                );
                return Err(Response::Refused { why: "home_read_back".to_owned(), text, jumps: Vec::new() });
            }
            self.carry_out(Request::ConfirmHome { axis, position_counts }, control, log)?;
        }
        Ok(Response::Done { jumps: Vec::new() })
    }

    /// What enabling would insert, axis by axis.
    fn jumps(&self, status: &Status) -> Vec<Jump> {
        let all = self.config.axes.iter().zip(status.axes()).enumerate();
        all.map(|(n, (axis, s))| (axis, self.corrector.goal(n, s) - s.in_effect))
            .filter(|(_, counts)| *counts != 0)
            .map(|(axis, counts)| Jump {
                axis: axis.name.clone(),
                counts,
                um: counts as f64 * axis.count_um,
                window_counts: axis.engine.window_counts,
            })
            .collect()
    }

    /// Why corrections must not be enabled, as far as it is known here.
    fn forbidden(&self, jumps: &[Jump], accept_jump: bool) -> Option<Response> {
        if self.set_up.real && !self.config.rt.latency_measured {
            return Some(refused(Refusal::NotArmable));
        }
        let ended = self.corrector.expired();
        if !ended.is_empty() {
            let text = format!("{}: {LOOK_AGAIN}", ended.join("; "));
            return Some(Response::Refused { why: "expired".to_owned(), text, jumps: Vec::new() });
        }
        let large = jumps.iter().any(|j| j.counts.abs() > j.window_counts);
        (large && !accept_jump).then(|| Response::Refused {
            why: "jump".to_owned(),
            text: "enabling would move an axis further than its belief window; --accept-jump if it is meant"
                .to_owned(),
            jumps: jumps.to_vec(),
        })
    }

    /// The state in a line, for the service manager.
    pub(crate) fn in_short(&self, now: &Status) -> String {
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

    fn status(&self, control: &mut ControlEnd) -> DaemonStatus {
        let now = control.status();
        let alive = !control.ended();
        let verified = self.set_up.missing.as_ref().is_some_and(Report::can_arm);
        let may_arm = !self.set_up.real || verified && self.config.rt.latency_measured;
        let missing = self.set_up.missing.iter().flat_map(Report::missing);
        let rt = Rt {
            alive,
            card: self.config.card.backend().to_owned(),
            may_arm,
            cpu: self.set_up.wanted.map(|w| w.cpu),
            priority: self.set_up.wanted.map(|w| w.priority),
            missing: missing
                .map(|f| format!("{}: wanted {}, found {}; {}", f.name, f.wanted, f.got, f.remedy))
                .collect(),
            polls: now.polls,
            events_lost: now.events_lost,
            control_stale: now.control_stale,
            disable_switch: now.disable_switch,
            poll_gap_ns: distribution(&self.set_up.timing.poll_gap_ns),
            edge_to_done_ns: distribution(&self.set_up.timing.edge_to_done_ns),
        };
        let axes = self.config.axes.iter().zip(now.axes()).map(|(axis, s)| AxisReport {
            name: axis.name.clone(),
            position_counts: s.position_counts,
            position_mm: s.position_counts as f64 * axis.count_um / 1000.0,
            requested: s.requested,
            completed: s.completed,
            in_effect: s.in_effect,
            mtc_minus_scale: s.mtc_minus_scale,
            inverted: s.inverted,
            homed: s.homed,
            gate: word(s.gate),
            edge_rate_hz: s.edge_rate_hz,
            faults: s.faults.iter().collect(),
            max_correction_counts: axis.engine.max_correction_counts,
            window_counts: axis.engine.window_counts,
            insertions: s.insertions,
            waited_for_gate: s.waited_for_gate,
            overlaps: s.overlaps,
            late: s.late,
            illegal: s.illegal,
        });
        DaemonStatus {
            machine: self.config.machine.clone(),
            mode: word(now.mode),
            homed: now.axes().iter().all(|a| a.homed),
            uptime_s: self.started.elapsed().as_secs_f64(),
            balanced: now.balanced(),
            faults: now.faults.iter().collect(),
            why_not: self.why_not(&now, alive, may_arm),
            rt,
            model: self.corrector.shown(),
            table: self.corrector.table_shown(),
            table_now: self.corrector.table_now(&now),
            sensors: self
                .temperatures
                .sensors()
                .iter()
                .map(|w| Reading::of(w, self.temperatures.now_s()))
                .collect(),
            axes: axes.collect(),
        }
    }

    /// Why nothing is corrected now, each with its remedy.
    fn why_not(&self, now: &Status, alive: bool, may_arm: bool) -> Vec<String> {
        let mut why = Vec::new();
        if !alive {
            why.push("the real-time thread has ended: see the log, then restart the daemon".to_owned());
        }
        for fault in now.faults.iter() {
            why.push(format!("{}: {}", word(fault), explain_fault(fault)));
        }
        for (axis, s) in self.config.axes.iter().zip(now.axes()) {
            for fault in s.faults.iter() {
                why.push(format!("axis {}: {}: {}", axis.name, word(fault), explain_fault(fault)));
            }
        }
        if now.disable_switch {
            why.push(explain_refusal(Refusal::DisableSwitch).to_owned());
        }
        if now.control_stale {
            why.push("the control side is silent".to_owned());
        }
        if !may_arm {
            why.push(explain_refusal(Refusal::NotArmable).to_owned());
            if !self.config.rt.latency_measured {
                why.push("[rt] has no detect_ns and write_ns: run `rtecctl selftest latency`".to_owned());
            }
        }
        let away: Vec<&str> = (self.config.axes.iter().zip(now.axes()))
            .filter(|(_, s)| !s.homed)
            .map(|(axis, _)| axis.name.as_str())
            .collect();
        if !away.is_empty() {
            why.push(format!("not homed: {}; move there, then `rtecctl home`", away.join(", ")));
        }
        match now.mode {
            Mode::Disabled => why.push("corrections are off: `rtecctl enable`".to_owned()),
            Mode::Shadow => why.push("shadow mode: everything is computed, nothing is written".to_owned()),
            Mode::Probe => why.push("probing mode: `rtecctl probe off`".to_owned()),
            Mode::Hold => why.push("feed hold: `rtecctl hold off`".to_owned()),
            Mode::Fault => why.push("when mended: `rtecctl clear`".to_owned()),
            Mode::Run => {}
        }
        if matches!(now.mode, Mode::Disabled | Mode::Fault) {
            why.extend(self.corrector.expired().iter().map(|e| format!("{e}: {LOOK_AGAIN}")));
        }
        why.extend(self.model_refused.iter().cloned());
        why.extend(self.corrector.holding());
        why
    }
}

fn refused(why: Refusal) -> Response {
    Response::Refused { why: word(why), text: explain_refusal(why).to_owned(), jumps: Vec::new() }
}

fn distribution(reader: &Reader) -> Distribution {
    let s = reader.snapshot();
    if s.samples() == 0 {
        return Distribution::default();
    }
    Distribution {
        min: s.min(),
        p50: s.p50(),
        p99: s.p99(),
        p9999: s.p9999(),
        max: s.max(),
        samples: s.samples(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rtec_correct::sensors;
    use rtec_driver::clock::Monotonic;
    use rtec_driver::mock::{MockCard, SharedWires};
    use rtec_files::csv::Reader;
    use rtec_rt::engine::{Engine, MachineConfig};
    use rtec_rt::link::{REQUESTS, link};
    use rtec_rt::thread::{ThreadOptions, spawn};

    fn engine(config: &Config) -> (Engine, MockCard<SharedWires, Monotonic>) {
        let mut card = MockCard::new(SharedWires::default(), Monotonic);
        let machine = MachineConfig { lines: config.lines, may_arm: true };
        let engine = Engine::new(&mut card, &config.engine_axes(), machine, &[]).unwrap();
        (engine, card)
    }

    fn session(engine: &Engine) -> Session {
        let set_up = SetUp { real: false, wanted: None, missing: None, timing: engine.timing() };
        let config = Config::embedded();
        let temperatures = Temperatures::start(&config.sensors, Path::new(""), 1.0).unwrap();
        Session::new(config, set_up, temperatures)
    }

    /// The recorded shift of `rtec-correct`'s tests through the daemon's own tick: the same totals, count for count.
    #[test]
    fn a_recorded_shift_gets_the_recorded_totals() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../correct/tests/shift");
        let directory = tempfile::tempdir().unwrap();
        let mut config = Config::embedded();
        config.control.state_file = Some(directory.path().join("state"));
        config.model.lead_ms = 20.0;
        let (engine, _card) = engine(&config);
        let set_up = SetUp { real: false, wanted: None, missing: None, timing: engine.timing() };
        let watch = |n: &str| Watch::new(sensors::SensorConfig::believed(n, Role::Temperature));
        let played = Temperatures::played(["T8", "T18"].map(watch).to_vec());
        let mut session = Session::new(config, set_up, played);
        session.load(Machine::read(&folder.join("machine.toml")).unwrap()).unwrap();
        let mut status = Status { mode: Mode::Run, axes_used: 3, ..Status::default() };
        status.axes.iter_mut().for_each(|a| a.homed = true);
        let (mut control, mut rt) = link(status);
        let mut log = Log::new();
        let mut reader = Reader::open(&folder.join("shift.csv")).unwrap();
        let header = reader.header("t_s, positions, sensors, operator, totals").unwrap();
        let mut rows = 0;
        while let Some(row) = reader.row().unwrap() {
            let mut at = Vec::new();
            let take = |_, cell: rtec_files::csv::Cell<'_>| cell.finite().map(|v| at.push(v));
            header.each(row, take).unwrap();
            session.temperatures.play(at[0], &at[4..6]);
            session.corrector.operator_is(0, at[6] as i64);
            status.t_ns = (at[0] * 1e9).round() as u64;
            (0..3).for_each(|n| status.axes[n].position_counts = at[1 + n] as i64);
            rt.publish(status);
            session.due = Instant::now();
            session.tick(&mut control, &mut log);
            while let Some(request) = rt.request() {
                let Request::Correct { axis, total_counts, large: false } = request else {
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

    /// A real-time thread that takes nothing: the request is answered, and when the ring is full that is said.
    #[test]
    fn a_full_ring_and_a_silent_thread_are_answers_not_hangs() {
        let (engine, _card) = engine(&Config::embedded());
        let mut session = session(&engine);
        session.patience = Duration::from_millis(1);
        let (mut control, _rt) = link(engine.status());
        let mut log = Log::new();
        let hold = ClientRequest::Hold { on: true };
        for _ in 0..REQUESTS {
            let Response::Refused { why, .. } = session.answer(&hold, &mut control, &mut log) else {
                panic!("an answer from nobody")
            };
            assert_eq!(why, "no_answer");
        }
        let Response::Refused { why, text, .. } = session.answer(&hold, &mut control, &mut log) else {
            panic!("an answer from nobody")
        };
        assert!(why == "ring_full" && text.contains("256 requests"), "{why}: {text}");
        // A status never waits for the real-time thread.
        assert!(matches!(
            session.answer(&ClientRequest::Status {}, &mut control, &mut log),
            Response::Status(_)
        ));
    }

    /// A model that ends while it runs goes on with what is being cut; it is not armed again before somebody has meant it.
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
        let mut log = Log::new();
        let file = directory.path().join("m.toml");
        let text = "name = \"m\"\n[[fit]]\nresponse = \"error.x\"\ndate = \"1970-01-01\"\nvalid_until = \"1970-01-11\"\n\
                    rms_um = 0.1\nhalf_width_um = 0.2\n";
        std::fs::write(&file, text).unwrap();
        let sha256 = Machine::read(&file).unwrap().sha256().to_owned();
        let load = |expired| ClientRequest::ModelLoad {
            file: Some(file.display().to_string()),
            take: Some(sha256.clone()),
            expired,
        };
        let (enable, done) =
            (ClientRequest::Enable { accept_jump: false }, Response::Done { jumps: Vec::new() });
        let refused = |response: Response| match response {
            Response::Refused { why, text, .. } => (why, text),
            other => panic!("{other:?}"),
        };
        session.today = || 10;
        assert_eq!(session.answer(&load(false), control, &mut log), done);
        assert_eq!(session.answer(&ClientRequest::Home { axis: None }, control, &mut log), done);
        assert_eq!(session.answer(&enable, control, &mut log), done);
        session.today = || 11;
        session.tick(control, &mut log);
        let status = session.status(control);
        assert!(status.why_not.is_empty(), "what is cut goes on: {:?}", status.why_not);
        assert_eq!(status.model.unwrap().expired.len(), 1);
        assert_eq!(session.answer(&ClientRequest::Disable {}, control, &mut log), done);
        assert!(session.status(control).why_not.iter().any(|w| w.contains("validity ended on 1970-01-11")));
        let (why, text) = refused(session.answer(&enable, control, &mut log));
        assert!(why == "expired" && text.contains("load --expired"), "{why}: {text}");
        assert_eq!(refused(session.answer(&load(false), control, &mut log)).0, "expired");
        // A restart does not take it up either, unless it was meant; then it is armed.
        session.corrector.unload();
        session.take_up_model(&mut log);
        assert!(session.status(control).model.is_none());
        assert_eq!(session.answer(&load(true), control, &mut log), done);
        session.corrector.unload();
        session.take_up_model(&mut log);
        assert!(session.status(control).model.is_some());
        assert_eq!(session.answer(&enable, control, &mut log), done);
        running.stop();
    }

    /// A control side that falls silent: corrections freeze, the status says so; back again, they go on.
    #[test]
    fn a_stale_control_side_freezes_corrections_and_is_named() {
        let config = Config::embedded();
        let (engine, card) = engine(&config);
        let mut session = session(&engine);
        let options = ThreadOptions { wanted: None, real: false, stale_after_ns: 20_000_000 };
        let mut running = spawn(engine, card, options).unwrap();
        let control = &mut running.control;
        let mut log = Log::new();
        let done = Response::Done { jumps: Vec::new() };
        assert_eq!(session.answer(&ClientRequest::Home { axis: None }, control, &mut log), done);
        assert_eq!(session.answer(&ClientRequest::Enable { accept_jump: false }, control, &mut log), done);
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
        assert!(session.status(control).why_not.is_empty());
        let (ended, mut control) = running.stop();
        assert!(ended.status.balanced());
        // A thread that has ended says so.
        let Response::Refused { why, .. } = session.answer(&ClientRequest::Clear {}, &mut control, &mut log)
        else {
            panic!("an answer from nobody")
        };
        assert_eq!(why, "ended");
    }
}
