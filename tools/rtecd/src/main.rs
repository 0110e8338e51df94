//! `rtecd`: the real-time thread, and the control side that serves its clients.
//!
//! | file | what |
//! |---|---|
//! | `mock_cards` | builds the card that the configuration names |
//! | `fault_ledger_history` | every change of the axes' ledgers, and how often each fault was latched |
//! | `record_spool` | writes finished records into the spool folder |
//! | `start` | the engine in the state that the last process left |
//! | `edited_files` | finds files that were edited since they were read |
//! | `control_side` | carries out requests of the protocol on the link |
//! | `listening_sockets` | the listening sockets, one per role |
//! | `client_connection` | one connection |
//! | `control_socket_server` | the order in which requests are served |
//! | `request_file_loader` | reads the files that requests name, off the control thread |
//! | `audit_log_thread` | writes the record of commands, off the control thread |
//! | `service_manager` | the service manager: ready, watchdog, the store for file descriptors |
//! | `stderr_journal_log` | standard error, fit for the journal |
//!
//! Elsewhere are the control law (`rtec-correct`), effects (`rtec-model`) and the step between two edges (`rtec-rt`).

mod audit_log_thread;
mod client_connection;
mod control_side;
mod control_socket_server;
mod edited_files;
mod fault_ledger_history;
mod listening_sockets;
mod mock_cards;
mod record_spool;
mod request_file_loader;
mod service_manager;
mod start;
mod stderr_journal_log;

use anyhow::Context;
use audit_log_thread::AuditLogSender;
use clap::Parser;
use control_side::ControlSide;
use control_socket_server::ServingEnd;
use edited_files::EditedFilesChecker;
use listening_sockets::ListeningSockets;
use nix::sys::signal::{SigSet, Signal};
use nix::sys::signalfd::{SfdFlags, SignalFd};
use rtec_control::card_opening::{self, CardAccess, CardOpenError, LocatedRegisters};
use rtec_control::config::{CardConfig, Config, ConfigFindings, INSTALLED};
use rtec_control::protocol::explain_fault;
use rtec_control::single_process_lock::{self, LockError};
use rtec_driver::card::Card;
use rtec_files::InputError;
use rtec_rt::journal::JournalError;
use rtec_rt::link_messages::Fault;
use rtec_rt::pinned_rt_thread::{ThreadOptions, spawn};
use rtec_rt::realtime_setup::{RtSettings, SetupFinding, SetupReport, SystemRoot};
use rtec_sensors::sensor_bus_threads::{SensorThreads, SteadyEpochClock};
use service_manager::ServiceManager;
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};
use stderr_journal_log::SyslogLevel;

/// Time after which a missing card is tried again.
const CARD_AGAIN: Duration = Duration::from_millis(100);
/// Why the process ends when its real-time thread is lost.
const LOST: &str =
    "the real-time thread is lost: the machine is held, and the service is to be started again";
/// Longest wait at the daemon's end for the disk of the record of commands.
const LOG_PATIENCE: Duration = Duration::from_secs(1);

/// Real-time error corrector: the daemon
#[derive(Debug, Parser)]
#[command(version)]
struct Args {
    /// The configuration [default: /etc/rtec/rtec.toml if there, else simulated axes]
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// The control socket, instead of the configuration's
    #[arg(long, value_name = "PATH")]
    socket: Option<PathBuf>,
    /// Seconds to wait for a card that is not there yet, before the start fails
    #[arg(long, value_name = "SECONDS", default_value_t = 0)]
    wait_for_card: u64,
    /// With the mock card: simulate a turning centre on z and x as this file says,
    /// once; its cycle starts when feed hold is released
    #[arg(long, value_name = "FILE")]
    lathe: Option<PathBuf>,
}

/// Why the daemon does not start.
#[derive(Debug, thiserror::Error)]
enum DaemonStartFailure {
    /// Exit 1: another process is in its place, or a file that it needs cannot be kept.
    #[error("{0}")]
    Taken(String),
    /// Exit 3: the card cannot be reached.
    #[error("{0}")]
    Unreachable(String),
    /// Exit 4: the card's state forbids it.
    #[error("{0}")]
    Fault(String),
    /// Exit 1: the service must be started again.
    #[error("{0}")]
    Again(&'static str),
}

impl From<LockError> for DaemonStartFailure {
    fn from(error: LockError) -> Self {
        match error {
            LockError::Io { what: "card", .. } => Self::Unreachable(error.to_string()),
            _ => Self::Taken(error.to_string()),
        }
    }
}

impl From<JournalError> for DaemonStartFailure {
    fn from(error: JournalError) -> Self {
        let text = format!("state file {error}");
        match error {
            JournalError::Io { .. } | JournalError::Taken { .. } => Self::Taken(text),
            JournalError::Foreign { .. } | JournalError::Other { .. } => Self::Fault(text),
        }
    }
}

fn main() -> ExitCode {
    match run(&Args::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            for line in rtec_files::message_text::error_with_causes(error.as_ref()).lines() {
                stderr_journal_log::say(SyslogLevel::Error, line);
            }
            ExitCode::from(exit_code(&error))
        }
    }
}

fn exit_code(error: &anyhow::Error) -> u8 {
    if error.is::<InputError>() || error.is::<ConfigFindings>() {
        return 2;
    }
    if error.is::<CardOpenError>() {
        return 3;
    }
    match error.downcast_ref::<DaemonStartFailure>() {
        Some(DaemonStartFailure::Unreachable(_)) => 3,
        Some(DaemonStartFailure::Fault(_)) => 4,
        Some(DaemonStartFailure::Taken(_) | DaemonStartFailure::Again(_)) | None => 1,
    }
}

fn run(args: &Args) -> anyhow::Result<()> {
    let mut manager = ServiceManager::from_environment()?;
    let installed = Path::new(INSTALLED);
    let file = args.config.as_deref().or(installed.exists().then_some(installed));
    let mut config = file.map_or_else(|| Ok(Config::embedded()), Config::load)?;
    if let Some(socket) = &args.socket {
        config.control.socket.clone_from(socket);
    }
    if let Some(file) = args.lathe.as_ref().filter(|_| config.card.backend() != "mock") {
        let found = format!("--lathe with card {}", config.card.backend());
        return Err(InputError::whole(file, found, "[card] backend = \"mock\"").into());
    }
    for note in &config.notes {
        stderr_journal_log::say(SyslogLevel::Warning, note);
    }
    // Before any thread starts, so that all inherit the mask and signals come through the descriptor only.
    let signals = SigSet::from_iter([Signal::SIGTERM, Signal::SIGINT, Signal::SIGHUP]);
    signals.thread_block().context("blocking signals")?;
    let signals =
        SignalFd::with_flags(&signals, SfdFlags::SFD_NONBLOCK | SfdFlags::SFD_CLOEXEC).context("signalfd")?;

    let edited_files = Some(EditedFilesChecker::watch(file));
    let sockets = listening_sockets::listen(&config.control)?;
    let kept = manager.take_back("outputs-");
    for name in manager.left_over() {
        stderr_journal_log::say(
            SyslogLevel::Warning,
            &format!("stored descriptor {name}: nobody has a use for it; it stays open"),
        );
    }
    let patience =
        CardOpenRetry { until: Instant::now() + Duration::from_secs(args.wait_for_card), signals: &signals };
    let outside = Outside { sockets: &sockets, signals: &signals, manager: &mut manager, edited_files };
    match config.card.clone() {
        CardConfig::Mock if args.lathe.is_some() => {
            let file = args.lathe.as_deref().unwrap_or(Path::new(""));
            let (card, cuts) = mock_cards::lathe(&config, file)?;
            let done = work(card, config, MachineKind::Harmless, outside);
            cuts.write().with_context(|| format!("writing the workpiece of {}", file.display()))?;
            done
        }
        CardConfig::Mock => {
            let (card, stand) = mock_cards::mock(&config);
            work(card, config, MachineKind::Simulated(stand), outside)
        }
        CardConfig::Replay { traces } => {
            let card = mock_cards::replay(&config, &traces)?;
            work(card, config, MachineKind::Harmless, outside)
        }
        CardConfig::Gpio(setup) => {
            let copies = || kept.iter().map(OwnedFd::try_clone).collect::<std::io::Result<Vec<_>>>();
            let kept = || copies().unwrap_or_default();
            let Some(card) = patience.open(|| card_opening::gpio(&setup, kept()))? else { return Ok(()) };
            // Before anything is inverted, so that the lines outlive this process.
            for (name, fd) in card.kept() {
                if !outside.manager.keep(&name, fd)? {
                    let text = format!(
                        "{name}: no service manager keeps the lines; when this process dies they may fall, both \
                         inverters at once"
                    );
                    stderr_journal_log::say(SyslogLevel::Warning, &text);
                }
            }
            work(card, config, MachineKind::Real, outside)
        }
        CardConfig::Registers { place, profile } => {
            // Found again at each try: meanwhile another driver may have taken the card, or it was reset.
            let open = || match card_opening::find(&place, &profile, CardAccess::Drive)? {
                LocatedRegisters::Parport(file) => {
                    card_opening::parport(&file, &profile).map(OpenedRegisters::Parport)
                }
                LocatedRegisters::Ports(base) => {
                    card_opening::ports(base, &profile).map(OpenedRegisters::Ports)
                }
                // Opened once before it is locked, because a missing file is waited for.
                LocatedRegisters::Map(file, map) => {
                    card_opening::mapped(&file, map, &profile).map(|_| OpenedRegisters::Map(file, map))
                }
            };
            let Some(opened) = patience.open(open)? else { return Ok(()) };
            match opened {
                OpenedRegisters::Parport(card) => work(card, config, MachineKind::Real, outside),
                OpenedRegisters::Ports(card) => work(card, config, MachineKind::Real, outside),
                OpenedRegisters::Map(file, map) => {
                    let _card_lock = single_process_lock::card(&file).map_err(DaemonStartFailure::from)?;
                    let card = card_opening::mapped(&file, map, &profile)?;
                    let real = mock_cards::drives_a_machine(&file)?;
                    work(card, config, if real { MachineKind::Real } else { MachineKind::Harmless }, outside)
                }
            }
        }
    }
}

/// Registers that were opened; a map is opened again under its lock.
enum OpenedRegisters<Parport, Ports> {
    Parport(Parport),
    Ports(Ports),
    Map(PathBuf, u8),
}

/// Longest wait for a card that comes up late.
struct CardOpenRetry<'a> {
    until: Instant,
    signals: &'a SignalFd,
}

impl CardOpenRetry<'_> {
    /// Opens a card, and tries again until it is there.
    /// Returns `None` when a signal ends the waiting.
    fn open<T>(&self, mut open: impl FnMut() -> Result<T, CardOpenError>) -> anyhow::Result<Option<T>> {
        let mut said = String::new();
        loop {
            let error = match open() {
                Ok(card) => return Ok(Some(card)),
                Err(error) if Instant::now() >= self.until => return Err(error.into()),
                Err(error) => error.to_string(),
            };
            if error != said {
                stderr_journal_log::say(SyslogLevel::Warning, &format!("waiting for the card: {error}"));
                said = error;
            }
            if self.signals.read_signal().context("reading signals")?.is_some() {
                return Ok(None);
            }
            std::thread::sleep(CARD_AGAIN);
        }
    }
}

/// Kind of machine behind a card.
enum MachineKind {
    /// A machine tool.
    Real,
    /// Another program, or a recording.
    Harmless,
    /// A simulated machine, with the person who operates it.
    Simulated(mock_cards::SimulatedOperator),
}

/// The daemon's outside: clients, signals and the service manager.
struct Outside<'a> {
    sockets: &'a ListeningSockets,
    signals: &'a SignalFd,
    manager: &'a mut ServiceManager,
    edited_files: Option<EditedFilesChecker>,
}

/// Runs the engine on `card` until a signal ends it.
fn work<C: Card + Send + 'static>(
    mut card: C,
    config: Config,
    kind: MachineKind,
    mut outside: Outside<'_>,
) -> anyhow::Result<()> {
    let real = matches!(kind, MachineKind::Real);
    let directory = config.control.state_path();
    let directory = directory.parent().unwrap_or(Path::new(""));
    let clock = SteadyEpochClock::start();
    let log_to = (directory, config.model.log_s);
    let sensors =
        SensorThreads::start(&config.sensors, clock, log_to, rtec_records::run_record_files::read_log)?;
    let (engine, before, state_file) = start::engine(&mut card, &config)?;
    if let Some(file) = &state_file {
        file.outlive_truncation().context("a handler for a state file that is cut short")?;
    }
    // A mock needs no real time. With `cpu` it gets a set-up all the same, so that it can be tried without a machine.
    let system = SystemRoot::live();
    let wanted = (real || config.rt.cpu.is_some()).then(|| RtSettings {
        cpu: config.rt.cpu.unwrap_or_else(|| system.default_cpu()),
        priority: config.rt.priority,
    });
    let options = ThreadOptions { wanted, real, stale_after_ns: config.control.stale_ms * 1_000_000 };
    let mut running = spawn(engine, card, options)?;
    let (machine, backend, axes) = (&config.machine, config.card.backend(), config.axes.len());
    let socket = config.control.socket.display();
    let text = format!("machine \"{machine}\": card {backend}, {axes} axes, socket {socket}");
    stderr_journal_log::say(SyslogLevel::Notice, &text);
    for SetupFinding { name, wanted, got, remedy, .. } in running.report.iter().flat_map(SetupReport::missing)
    {
        stderr_journal_log::say(
            SyslogLevel::Warning,
            &format!("{name}: wanted {wanted}, found {got}: {remedy}"),
        );
    }
    let set_up = control_side::RtStartupReport {
        real,
        wanted: options.wanted,
        missing: running.report.take(),
        timing: running.timing.clone(),
        before,
    };
    let log_file = config.control.log_path();
    let mut audit = AuditLogSender::start(&log_file, outside.sockets.viewers)
        .context("starting the record of commands")?;
    let mut session = ControlSide::new(config, set_up, (sensors, clock), outside.edited_files.take());
    session.watch_over(state_file);
    session.take_up_model();
    if let Some(trouble) = session.spool_trouble() {
        stderr_journal_log::say(SyslogLevel::Warning, &trouble);
    }
    if let MachineKind::Simulated(stand) = kind {
        session.stand_at(stand);
    }
    // The link's first status is older than the first look.
    while running.control.status().polls == 0 && !running.control.ended() {
        running.control.beat();
        std::thread::sleep(Duration::from_millis(1));
    }
    let started = format!("rtecd {} at {}", rtec_files::file_format_stamp::VERSION, session.identity());
    audit.note("start", started, session.totals(&mut running.control));
    for happened in session.found_at_start(&running.control.status()) {
        audit.happened(&happened, session.totals(&mut running.control));
    }
    outside.manager.ready()?;
    let served = control_socket_server::serve(outside, &mut session, &mut running.control, &mut audit);
    if matches!(served, Ok(ServingEnd::StandsStill)) {
        // The thread cannot be ended and holds the card. The next process finds the fault and asserts feed hold.
        let mut text = explain_fault(Fault::ThreadLost).to_owned();
        if !session.note_thread_lost() {
            text += "; the state file is not there to be told";
        }
        audit.note("thread_lost", text, session.totals(&mut running.control));
        audit.end(LOG_PATIENCE);
        return Err(DaemonStartFailure::Again(LOST).into());
    }
    session.look_after_state_file(&mut running.control);
    let (ended, mut control) = running.stop();
    session.drain(&mut control);
    session.keep_the_rest(LOG_PATIENCE);
    let told = ["record_not_kept", "state_file_lost", "fault"];
    for happened in session.take_happened().iter().filter(|h| told.contains(&h.kind.as_str())) {
        audit.happened(happened, session.totals(&mut control));
    }
    for (axis, status) in session.axes().iter().zip(ended.status.axes()) {
        let (name, in_effect) = (&axis.name, status.in_effect);
        let inverters = if status.inverted { "on" } else { "off" };
        let text = format!("parked axis {name}: completed {in_effect:+} counts, inverters {inverters}");
        stderr_journal_log::say(SyslogLevel::Notice, &text);
    }
    audit.end(LOG_PATIENCE);
    match served? {
        ServingEnd::Panicked => Err(DaemonStartFailure::Again(LOST).into()),
        ServingEnd::HungUp => {
            Err(DaemonStartFailure::Again("a hangup ended it, and nobody asked for that").into())
        }
        ServingEnd::Asked | ServingEnd::StandsStill => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rtec_driver::card::{CardError, CardInputSample};
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

    /// A card whose looks panic once the test says so.
    struct Panics<C> {
        card: C,
        planted: Arc<AtomicBool>,
        outputs: Arc<AtomicU64>,
    }

    impl<C: Card> Card for Panics<C> {
        fn sample(&mut self, wake_ns: u64) -> Result<CardInputSample, CardError> {
            assert!(!self.planted.load(Ordering::Acquire), "planted");
            self.card.sample(wake_ns)
        }

        fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError> {
            let before = self.outputs.load(Ordering::Acquire);
            self.outputs.store(before & !mask | value & mask, Ordering::Release);
            self.card.write(mask, value)
        }

        fn outputs(&mut self) -> Result<u64, CardError> {
            self.card.outputs()
        }
    }

    /// A panic of the real-time thread latches the fault and asserts feed hold.
    #[test]
    fn a_panic_of_the_thread_holds_and_ends_the_daemon() {
        let directory = tempfile::tempdir().unwrap();
        let mut config = Config::embedded();
        config.control.socket = directory.path().join("socket");
        config.control.state_file = Some(directory.path().join("state"));
        config.control.log_file = Some(directory.path().join("audit.log"));
        let hold = 1 << config.lines.hold.unwrap();
        let (card, _) = mock_cards::mock(&config);
        let (planted, outputs) = (Arc::<AtomicBool>::default(), Arc::<AtomicU64>::default());
        let card = Panics { card, planted: Arc::clone(&planted), outputs: Arc::clone(&outputs) };
        let sockets = listening_sockets::listen(&config.control).unwrap();
        let signals = SignalFd::new(&SigSet::empty()).unwrap();
        let mut manager = ServiceManager::from_environment().unwrap();
        let outside =
            Outside { sockets: &sockets, signals: &signals, manager: &mut manager, edited_files: None };
        let log_file = config.control.log_path();
        let served = std::thread::spawn(move || {
            while !std::fs::read_to_string(&log_file).is_ok_and(|log| log.contains("start")) {
                std::thread::sleep(Duration::from_millis(1));
            }
            assert_eq!(outputs.load(Ordering::Acquire) & hold, 0);
            planted.store(true, Ordering::Release);
            (outputs, log_file)
        });
        let ended = work(card, config, MachineKind::Harmless, outside).unwrap_err();
        let (outputs, log_file) = served.join().unwrap();
        assert_eq!((exit_code(&ended), ended.to_string()), (1, LOST.to_owned()));
        assert_eq!(outputs.load(Ordering::Acquire) & hold, hold);
        let log = std::fs::read_to_string(log_file).unwrap();
        assert!(log.contains("thread_lost"), "{log}");
    }
}
