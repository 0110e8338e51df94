//! `rtecctl top`: the corrector's state on a full screen, live.
//! It shows the state and sends no commands.

mod view;

use crate::daemon_connection::{DaemonArgs, observe};
use crate::full_screen::{Key, RawModeScreen, keys};
use crate::terminal::signs;
use nix::poll::PollFlags;
use nix::sys::signal::{SigSet, Signal};
use nix::sys::signalfd::{SfdFlags, SignalFd};
use ratatui_core::terminal::Terminal;
use rtec_control::daemon_client::DaemonConnection;
use rtec_control::protocol::DaemonSnapshot;
use std::io::IsTerminal;
use std::os::fd::AsFd;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::Duration;
use view::TopScreenState;

/// Show the corrector on the whole terminal: axes, error by effect, sensors, latencies, events, the last minutes
///
/// Keys: ? help, q quit. It commands nothing. Without colours where `NO_COLOR` is set.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Time between two looks, as 500ms
    #[arg(long, value_name = "TIME", default_value = "500ms", value_parser = rtec_files::cli_option_parsers::duration)]
    every: Duration,
    #[command(flatten)]
    daemon: DaemonArgs,
}

/// Interval at which a missing daemon is looked for.
const AGAIN: Duration = Duration::from_secs(1);
/// Number of events fetched at a look.
const EVENTS: u64 = 40;
/// Longest delay of a key.
const KEYS: Duration = Duration::from_millis(100);
/// Shortest interval; the daemon has other work.
const FASTEST: Duration = Duration::from_millis(50);

/// Result of a look at the daemon: what it shows, or why it does not answer.
type PollResult = Result<Box<DaemonSnapshot>, String>;

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let every = args.every;
    if args.daemon.json || !std::io::stdout().is_terminal() || !std::io::stdin().is_terminal() {
        fail!(Bad, "top needs a terminal; elsewhere: `rtecctl status --watch`, for programs with --json");
    }
    ensure!(every >= FASTEST, Bad, "--every: expected 50ms or more");
    // The first connection is made before the screen is taken, so that a wrong socket is reported as usual.
    drop(args.daemon.view()?);
    // Before the thread starts, because it inherits the mask. A signal must not leave the terminal in raw
    // mode.
    let signals = SigSet::from_iter([Signal::SIGTERM, Signal::SIGHUP]);
    signals.thread_block()?;
    let signals = SignalFd::with_flags(&signals, SfdFlags::SFD_NONBLOCK | SfdFlags::SFD_CLOEXEC)?;
    let (to, looks) = channel();
    let daemon = args.daemon.clone();
    std::thread::spawn(move || look(&daemon, every, &to));
    let colour = crate::terminal::colours_are_wanted();
    let mut terminal = Terminal::new(RawModeScreen::take()?)?;
    terminal.clear()?;
    show(&mut terminal, &looks, &signals, TopScreenState::new(colour, every))
}

/// Looks repeatedly until the receiver is gone.
fn look(daemon: &DaemonArgs, every: Duration, to: &Sender<PollResult>) {
    let (mut client, mut last) = (None, 0);
    loop {
        let found = once(daemon, &mut client, &mut last);
        let wait = if found.is_ok() { every } else { AGAIN };
        client.take_if(|_| found.is_err());
        if to.send(found.map_err(|error| format!("{error:#}"))).is_err() {
            return;
        }
        std::thread::sleep(wait);
    }
}

fn once(
    daemon: &DaemonArgs,
    client: &mut Option<DaemonConnection>,
    last: &mut u64,
) -> anyhow::Result<Box<DaemonSnapshot>> {
    let client = match client {
        Some(client) => client,
        None => client.insert(daemon.view()?),
    };
    // The first look learns the number of events; the next ones take the last few.
    let seen = observe(client, Some(last.saturating_sub(EVENTS)))?;
    *last = seen.events.last().map_or(*last, |e| e.n);
    // A restarted daemon counts from the start.
    if seen.events.is_empty() {
        *last = 0;
    }
    Ok(Box::new(seen))
}

fn show(
    terminal: &mut Terminal<RawModeScreen>,
    looks: &Receiver<PollResult>,
    signals: &SignalFd,
    mut view: TopScreenState,
) -> anyhow::Result<()> {
    loop {
        match looks.recv_timeout(KEYS) {
            Ok(Ok(seen)) => view.take(*seen),
            Ok(Err(why)) => view.gone(why),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return Ok(()),
        }
        // At a closed terminal, reading keys would wait for ever.
        let gone = PollFlags::POLLHUP | PollFlags::POLLERR | PollFlags::POLLNVAL;
        let hung_up = signs(std::io::stdin().as_fd(), PollFlags::empty())?.intersects(gone);
        if hung_up || signals.read_signal()?.is_some() {
            return Ok(());
        }
        for key in keys()? {
            match key {
                Key::Interrupt | Key::Letter('q') => return Ok(()),
                Key::Letter('?' | 'h') => view.help = !view.help,
                Key::Escape => view.help = false,
                Key::Letter(_) => {}
            }
        }
        terminal.draw(|frame| view.draw(frame))?;
    }
}
