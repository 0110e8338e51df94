//! `rtecd`: the real-time thread, and the control side that talks to it for everyone else.
//!
//! | file | what |
//! |---|---|
//! | `cards` | the card that the configuration names |
//! | `temperatures` | the sensors' threads, and their log |
//! | `session` | requests of the protocol, carried out on the link |
//! | `server` | the control socket and its clients |
//! | `manager` | the service manager: ready, watchdog, the store for file descriptors |
//! | `log` | standard error, fit for the journal |
//!
//! What must not live here: the control law (`rtec-correct`), effects (`rtec-model`), the step between two edges (`rtec-rt`).

mod cards;
mod log;
mod manager;
mod server;
mod session;
mod temperatures;

use anyhow::Context;
use clap::Parser;
use log::{Level, Log};
use manager::Manager;
use nix::sys::signal::{SigSet, Signal};
use nix::sys::signalfd::{SfdFlags, SignalFd};
use rtec_control::card::{self, OpenError};
use rtec_control::config::{CardConfig, Config, ConfigFindings, PortPlace};
use rtec_control::lock::{self, LockError};
use rtec_driver::card::Card;
use rtec_files::InputError;
use rtec_rt::engine::{Engine, MachineConfig, StartError};
use rtec_rt::event::{Fault, MAX_AXES};
use rtec_rt::journal::{Journal, StateRecord, resume};
use rtec_rt::setup::{Report, System, Wanted};
use rtec_rt::thread::{ThreadOptions, spawn};
use session::Session;
use std::os::unix::net::UnixListener;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;
use temperatures::Temperatures;

/// Path of an installed machine's configuration.
const INSTALLED: &str = "/etc/rtec/rtec.toml";

/// Real-time error corrector: the daemon
#[derive(Debug, Parser)]
#[command(version)]
struct Args {
    /// The configuration [default: /etc/rtec/rtec.toml where it exists, else three simulated axes]
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// The control socket, instead of the configuration's
    #[arg(long, value_name = "PATH")]
    socket: Option<PathBuf>,
    /// With the mock card: a simulated turning centre on the axes z and x does what this file says, once; its cycle
    /// start is the release of feed hold
    #[arg(long, value_name = "FILE")]
    lathe: Option<PathBuf>,
}

/// Why the daemon does not start.
#[derive(Debug, thiserror::Error)]
enum Failure {
    /// Exit 1: somebody else is there already.
    #[error("{0}")]
    Taken(String),
    /// Exit 3: the card cannot be reached.
    #[error("{0}")]
    Unreachable(String),
    /// Exit 4: the card's state forbids it.
    #[error("{0}")]
    Fault(String),
}

impl From<LockError> for Failure {
    fn from(error: LockError) -> Self {
        match error {
            LockError::Io { what: "card", .. } => Self::Unreachable(error.to_string()),
            _ => Self::Taken(error.to_string()),
        }
    }
}

fn main() -> ExitCode {
    let mut log = Log::new();
    match run(&Args::parse(), &mut log) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            for line in format!("{error:#}").lines() {
                log.say(Level::Error, line);
            }
            ExitCode::from(exit_code(&error))
        }
    }
}

fn exit_code(error: &anyhow::Error) -> u8 {
    if error.is::<InputError>() || error.is::<ConfigFindings>() {
        return 2;
    }
    if error.is::<OpenError>() {
        return 3;
    }
    match error.downcast_ref::<Failure>() {
        Some(Failure::Unreachable(_)) => 3,
        Some(Failure::Fault(_)) => 4,
        Some(Failure::Taken(_)) | None => 1,
    }
}

fn run(args: &Args, log: &mut Log) -> anyhow::Result<()> {
    let mut manager = Manager::from_environment()?;
    let installed = Path::new(INSTALLED);
    let mut config = match &args.config {
        Some(file) => Config::load(file)?,
        None if installed.exists() => Config::load(installed)?,
        None => Config::embedded(),
    };
    if let Some(socket) = &args.socket {
        config.control.socket.clone_from(socket);
    }
    if let Some(file) = args.lathe.as_ref().filter(|_| config.card.backend() != "mock") {
        let found = format!("--lathe with card {}", config.card.backend());
        return Err(InputError::whole(file, found, "[card] backend = \"mock\"").into());
    }
    for note in &config.notes {
        log.say(Level::Warning, note);
    }
    // Before any thread starts: they all inherit the mask, and the signals come through the descriptor only.
    let signals = SigSet::from_iter([Signal::SIGTERM, Signal::SIGINT, Signal::SIGHUP]);
    signals.thread_block().context("blocking signals")?;
    let signals =
        SignalFd::with_flags(&signals, SfdFlags::SFD_NONBLOCK | SfdFlags::SFD_CLOEXEC).context("signalfd")?;

    let (listener, _lock) = server::listen(&config.control)?;
    let socket = config.control.socket.clone();
    let kept = manager.take_back("outputs-");
    for name in manager.left_over() {
        log.say(Level::Warning, &format!("stored descriptor {name}: nobody has a use for it; it stays open"));
    }
    let outside = Outside { listener: &listener, signals: &signals, manager: &mut manager };
    let done = match config.card.clone() {
        CardConfig::Mock if args.lathe.is_some() => {
            let file = args.lathe.as_deref().unwrap_or(Path::new(""));
            let (card, cuts) = cards::lathe(&config, file)?;
            let done = work(card, config, Kind::Harmless, outside, log);
            cuts.write().with_context(|| format!("writing the workpiece of {}", file.display()))?;
            done
        }
        CardConfig::Mock => {
            let (card, stand) = cards::mock(&config);
            work(card, config, Kind::Simulated(stand), outside, log)
        }
        CardConfig::Replay { traces } => {
            let card = cards::replay(&config, &traces)?;
            work(card, config, Kind::Harmless, outside, log)
        }
        CardConfig::Gpio(setup) => {
            let card = card::gpio(&setup, kept)?;
            // Before anything is inverted: from here on the lines outlive this process.
            for (name, fd) in card.kept() {
                if !outside.manager.keep(&name, fd)? {
                    let text = format!(
                        "{name}: no service manager keeps the lines; when this process dies they may fall, both \
                         inverters at once"
                    );
                    log.say(Level::Warning, &text);
                }
            }
            work(card, config, Kind::Real, outside, log)
        }
        CardConfig::Port { place: PortPlace::Parport(file), profile } => {
            work(card::parport(&file, &profile)?, config, Kind::Real, outside, log)
        }
        CardConfig::Port { place: PortPlace::Io(base), profile } => {
            work(card::ports(base, &profile)?, config, Kind::Real, outside, log)
        }
        CardConfig::Port { place: PortPlace::Pci(id, bar), profile } => {
            let base = card::io_bar(&id, bar, &profile)?;
            work(card::ports(base, &profile)?, config, Kind::Real, outside, log)
        }
        CardConfig::Mapped { place, profile } => {
            let (file, map) = card::register_file(&place, &profile)?;
            let _card_lock = lock::card(&file).map_err(Failure::from)?;
            let card = card::mapped(&file, map, &profile)?;
            let real = cards::drives_a_machine(&file)?;
            work(card, config, if real { Kind::Real } else { Kind::Harmless }, outside, log)
        }
    };
    // The lock is still held: nobody else can have a socket of this name.
    let _ = std::fs::remove_file(&socket);
    done
}

/// What hangs on a card.
enum Kind {
    /// A machine tool.
    Real,
    /// Another program, or a recording.
    Harmless,
    /// A simulated machine, and who stands at it.
    Simulated(cards::Stand),
}

/// Whom the daemon listens to and reports to: clients, signals, the service manager.
struct Outside<'a> {
    listener: &'a UnixListener,
    signals: &'a SignalFd,
    manager: &'a mut Manager,
}

/// Runs the engine on `card` until a signal ends it.
fn work<C: Card + Send + 'static>(
    mut card: C,
    config: Config,
    kind: Kind,
    outside: Outside<'_>,
    log: &mut Log,
) -> anyhow::Result<()> {
    let real = matches!(kind, Kind::Real);
    let directory = config.control.state_path();
    let directory = directory.parent().unwrap_or(Path::new(""));
    let temperatures = Temperatures::start(&config.sensors, directory, config.model.log_s)?;
    // The outputs of a mock card end with its process: there is nothing to be taken over.
    let journal = match config.card {
        CardConfig::Gpio(_) | CardConfig::Mapped { .. } | CardConfig::Port { .. } => {
            let file = config.control.state_path();
            let opened = Journal::open(&file).with_context(|| format!("state file {}", file.display()))?;
            Some(opened)
        }
        CardConfig::Mock | CardConfig::Replay { .. } => None,
    };
    let found = journal.as_ref().map_or([[None; 2]; MAX_AXES], |(_, found)| *found);
    let (completed, moved) = take_over(&mut card, &config, &found)?;
    let machine = MachineConfig { lines: config.lines, may_arm: false };
    let mut engine = match Engine::new(&mut card, &config.engine_axes(), machine, &completed) {
        Ok(engine) => engine,
        Err(StartError::HalfInverted(n)) => {
            let why = format!(
                "axis {}: its two inverters are not equal, and the state file knows of no insertion that was under way. \
                 Nothing is written; switch the MTC off, set both inverters equal, start again and home",
                config.axes[n].name
            );
            return Err(Failure::Fault(why).into());
        }
        Err(error) => return Err(Failure::Unreachable(error.to_string()).into()),
    };
    for (axis, _) in config.axes.iter().zip(&completed).filter(|(_, total)| *total % 2 != 0) {
        log.say(
            Level::Error,
            &format!("axis {}: left in the middle of an insertion; it is finished now", axis.name),
        );
    }
    for n in moved {
        log.say(
            Level::Error,
            &format!("axis {}: the inverters are not where the state file left them", config.axes[n].name),
        );
        // What is latched now stands in the status from the first one on; there is no one yet to report it to.
        engine.latch(Some(n as u8), Fault::InvertersMoved, &mut card, &mut |_| true)?;
    }
    if let Some((journal, _)) = journal {
        engine.keep_journal(journal);
    }
    // A mock needs no real time; with `cpu` it gets it, so that a set-up can be tried without a machine.
    let system = System::live();
    let wanted = (real || config.rt.cpu.is_some()).then(|| Wanted {
        cpu: config.rt.cpu.unwrap_or_else(|| system.default_cpu()),
        priority: config.rt.priority,
    });
    let options = ThreadOptions { wanted, real, stale_after_ns: config.control.stale_ms * 1_000_000 };
    let mut running = spawn(engine, card, options)?;
    log.say(
        Level::Notice,
        &format!(
            "machine \"{}\": card {}, {} axes, socket {}",
            config.machine,
            config.card.backend(),
            config.axes.len(),
            config.control.socket.display()
        ),
    );
    for finding in running.report.iter().flat_map(Report::missing) {
        let text =
            format!("{}: wanted {}, found {}: {}", finding.name, finding.wanted, finding.got, finding.remedy);
        log.say(Level::Warning, &text);
    }
    let set_up = session::SetUp {
        real,
        wanted: options.wanted,
        missing: running.report.take(),
        timing: running.timing.clone(),
    };
    let mut session = Session::new(config, set_up, temperatures);
    session.take_up_model(log);
    if let Kind::Simulated(stand) = kind {
        session.stand_at(stand);
    }
    // The status that the link began with is older than the first look.
    while running.control.status().polls == 0 && !running.control.ended() {
        running.control.beat();
        std::thread::sleep(Duration::from_millis(1));
    }
    outside.manager.ready()?;
    let served = server::serve(outside, &mut session, &mut running.control, log);
    let (ended, mut control) = running.stop();
    session.drain(&mut control, log);
    for (axis, status) in session.axes().iter().zip(ended.status.axes()) {
        let text = format!(
            "parked axis {}: completed {:+} counts, inverters {}",
            axis.name,
            status.in_effect,
            if status.inverted { "on" } else { "off" }
        );
        log.say(Level::Notice, &text);
    }
    served
}

/// What each axis had completed before, from the state file and the inverters as they are; and the axes where the two
/// disagree.
fn take_over<C: Card>(
    card: &mut C,
    config: &Config,
    found: &[[Option<StateRecord>; 2]; MAX_AXES],
) -> anyhow::Result<(Vec<i64>, Vec<usize>)> {
    let outputs = card.outputs().map_err(|e| Failure::Unreachable(e.to_string()))?;
    let (mut completed, mut moved) = (Vec::new(), Vec::new());
    for (n, axis) in config.axes.iter().enumerate() {
        let inverters = axis.engine.lines.inverters(outputs);
        let before = resume(found[n], inverters);
        let first_start = found[n] == [None, None] && inverters == 0;
        if before.is_none() && !first_start {
            moved.push(n);
        }
        completed.push(before.unwrap_or(0));
    }
    Ok((completed, moved))
}
