//! The control socket: one thread, no client can hold up another or the heartbeat, everything is bounded.

use crate::log::{Level, Log};
use crate::session::Session;
use crate::{Failure, Outside};
use anyhow::Context;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::stat::{Mode, umask};
use nix::unistd::{Group, chown};
use rtec_control::config::ControlConfig;
use rtec_control::lock;
use rtec_control::protocol::{ClientRequest, MAX_LINE, Response};
use rtec_rt::link::ControlEnd;
use std::fs::{DirBuilder, Permissions};
use std::io::{ErrorKind, Read, Write};
use std::os::fd::AsFd;
use std::os::unix::fs::{DirBuilderExt, FileTypeExt, PermissionsExt};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;
use std::time::{Duration, Instant};

/// Clients at one time.
const MAX_CLIENTS: usize = 32;
/// Lines of one client that are answered before the next client has its turn.
const LINES_A_TURN: usize = 8;
/// Unread answers that a client may leave lying, bytes. Beyond it nothing more is read from it, and a watcher is dropped.
const MAX_UNREAD: usize = 256 * 1024;
/// A client that says nothing whole for so long is dropped; watchers may be silent.
const IDLE: Duration = Duration::from_secs(30);

/// The listening socket, for its group only, and the lock that makes it ours.
pub(crate) fn listen(control: &ControlConfig) -> anyhow::Result<(UnixListener, lock::Held)> {
    let socket = &control.socket;
    let group = match &control.group {
        None => None,
        Some(name) => Some(
            Group::from_name(name)
                .with_context(|| format!("looking up group {name}"))?
                .with_context(|| format!("there is no group {name} (found in [control] group)"))?
                .gid,
        ),
    };
    if let Some(directory) = socket.parent().filter(|d| !d.as_os_str().is_empty() && !d.exists()) {
        DirBuilder::new()
            .recursive(true)
            .mode(0o750)
            .create(directory)
            .with_context(|| format!("creating {}", directory.display()))?;
        chown(directory, None, group)
            .with_context(|| format!("giving {} to its group", directory.display()))?;
    }
    let held = lock::socket(socket).map_err(Failure::from)?;
    clear_stale(socket)?;
    // Born without access for anybody else; the group gets its own before the first client can be served.
    let before = umask(Mode::from_bits_truncate(0o177));
    let listener = UnixListener::bind(socket);
    umask(before);
    let listener = listener.with_context(|| format!("binding {}", socket.display()))?;
    if group.is_some() {
        chown(socket, None, group).with_context(|| format!("giving {} to its group", socket.display()))?;
        std::fs::set_permissions(socket, Permissions::from_mode(0o660))?;
    }
    listener.set_nonblocking(true)?;
    Ok((listener, held))
}

/// Removes a socket that nobody listens at.
fn clear_stale(socket: &Path) -> anyhow::Result<()> {
    let Ok(found) = std::fs::symlink_metadata(socket) else { return Ok(()) };
    if !found.file_type().is_socket() {
        let why = format!(
            "{}: found something that is no socket, expected nothing or an old socket",
            socket.display()
        );
        return Err(Failure::Taken(why).into());
    }
    match UnixStream::connect(socket) {
        Err(error) if error.kind() == ErrorKind::ConnectionRefused => std::fs::remove_file(socket)
            .with_context(|| format!("removing the old socket {}", socket.display())),
        Ok(_) => {
            let why = format!("socket {} is in use: another program listens at it", socket.display());
            Err(Failure::Taken(why).into())
        }
        Err(error) => Err(error).with_context(|| format!("trying the socket {}", socket.display())),
    }
}

struct Client {
    stream: UnixStream,
    inbox: Vec<u8>,
    outbox: Vec<u8>,
    watching: bool,
    last_line: Instant,
    /// Nothing more is read; it goes when the outbox is empty.
    closing: bool,
    gone: bool,
}

impl Client {
    fn new(stream: UnixStream) -> Self {
        Self {
            stream,
            inbox: Vec::new(),
            outbox: Vec::new(),
            watching: false,
            last_line: Instant::now(),
            closing: false,
            gone: false,
        }
    }

    fn reads(&self) -> bool {
        !self.closing && self.outbox.len() < MAX_UNREAD
    }

    fn wants(&self) -> PollFlags {
        let mut flags = PollFlags::empty();
        if self.reads() {
            flags |= PollFlags::POLLIN;
        }
        if !self.outbox.is_empty() {
            flags |= PollFlags::POLLOUT;
        }
        flags
    }

    fn put(&mut self, response: &Response) {
        // A response is numbers, strings and lists: it has a JSON form.
        let Ok(line) = serde_json::to_string(response) else { return };
        self.outbox.extend_from_slice(line.as_bytes());
        self.outbox.push(b'\n');
    }

    fn bad(&mut self, text: impl Into<String>) {
        self.put(&Response::Bad { text: text.into() });
    }

    fn read(&mut self) {
        let mut buffer = [0; MAX_LINE];
        match self.stream.read(&mut buffer) {
            Ok(0) => self.closing = true,
            Ok(n) => self.inbox.extend_from_slice(&buffer[..n]),
            Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {}
            Err(_) => self.gone = true,
        }
    }

    /// The next whole line, without its end.
    fn line(&mut self) -> Option<Vec<u8>> {
        let Some(end) = self.inbox.iter().position(|&b| b == b'\n') else {
            if self.inbox.len() >= MAX_LINE && !self.closing {
                self.bad(format!("found a line of more than {MAX_LINE} bytes; expected one request a line"));
                self.inbox.clear();
                self.closing = true;
            }
            return None;
        };
        let mut line: Vec<u8> = self.inbox.drain(..=end).collect();
        line.pop();
        self.last_line = Instant::now();
        Some(line)
    }

    fn write(&mut self) {
        while !self.outbox.is_empty() {
            match self.stream.write(&self.outbox) {
                Ok(n) => {
                    self.outbox.drain(..n);
                }
                Err(e) if e.kind() == ErrorKind::WouldBlock => return,
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(_) => {
                    self.gone = true;
                    return;
                }
            }
        }
    }

    fn over(&self) -> bool {
        let dumb = !self.watching && self.last_line.elapsed() > IDLE;
        let deaf = self.watching && self.outbox.len() > MAX_UNREAD;
        self.gone || dumb || deaf || self.closing && self.outbox.is_empty() && !self.inbox.contains(&b'\n')
    }
}

/// Serves until a signal comes.
pub(crate) fn serve(
    outside: Outside<'_>,
    session: &mut Session,
    control: &mut ControlEnd,
    log: &mut Log,
) -> anyhow::Result<()> {
    let Outside { listener, signals, manager } = outside;
    let mut clients: Vec<Client> = Vec::new();
    let every = session.beat_every();
    let timeout = PollTimeout::try_from(every).unwrap_or(PollTimeout::from(10_u8));
    let mut end_reported = false;
    loop {
        control.beat();
        let status = control.status();
        manager.turn(status.polls, || session.in_short(&status));
        // Lines left over from the last turn must not wait for the next one to arrive.
        let waiting = clients.iter().any(|c| c.reads() && c.inbox.contains(&b'\n'));
        let ready = {
            let mut fds = vec![
                PollFd::new(signals.as_fd(), PollFlags::POLLIN),
                PollFd::new(listener.as_fd(), PollFlags::POLLIN),
            ];
            fds.extend(clients.iter().map(|c| PollFd::new(c.stream.as_fd(), c.wants())));
            match poll(&mut fds, if waiting { PollTimeout::ZERO } else { timeout }) {
                Ok(_) | Err(nix::errno::Errno::EINTR) => {}
                Err(error) => return Err(error).context("poll"),
            }
            fds.iter().map(|fd| fd.revents().unwrap_or(PollFlags::empty())).collect::<Vec<_>>()
        };
        if ready[0].contains(PollFlags::POLLIN)
            && let Some(signal) = signals.read_signal().context("reading signals")?
        {
            manager.stopping();
            log.say(Level::Notice, &format!("signal {}: parking", signal.ssi_signo));
            return Ok(());
        }
        for (client, ready) in clients.iter_mut().zip(&ready[2..]) {
            if client.reads() && ready.intersects(PollFlags::POLLIN | PollFlags::POLLHUP) {
                client.read();
            } else if ready.contains(PollFlags::POLLERR) {
                client.gone = true;
            }
            for _ in 0..LINES_A_TURN {
                if client.outbox.len() >= MAX_UNREAD {
                    break;
                }
                let Some(line) = client.line() else { break };
                obey(client, &line, session, control, log);
            }
        }
        if ready[1].contains(PollFlags::POLLIN) {
            accept(listener, &mut clients, log);
        }
        session.drain(control, log);
        session.tick(control, log);
        if control.ended() && !end_reported {
            end_reported = true;
            log.say(
                Level::Error,
                "the real-time thread has ended; corrections are frozen, status is still served",
            );
        }
        for happened in session.take_happened() {
            for client in clients.iter_mut().filter(|c| c.watching) {
                client.put(&Response::Event(Box::new(happened.clone())));
            }
        }
        clients.iter_mut().for_each(Client::write);
        clients.retain(|c| !c.over());
    }
}

fn obey(client: &mut Client, line: &[u8], session: &mut Session, control: &mut ControlEnd, log: &mut Log) {
    let line = match std::str::from_utf8(line) {
        Ok(line) => line.trim(),
        Err(_) => return client.bad("found bytes that are no UTF-8; expected one JSON object a line"),
    };
    match ClientRequest::parse(line) {
        Err(text) => client.bad(text),
        Ok(request) => {
            client.watching |= request == ClientRequest::Watch {};
            let response = session.answer(&request, control, log);
            client.put(&response);
        }
    }
}

fn accept(listener: &UnixListener, clients: &mut Vec<Client>, log: &mut Log) {
    match listener.accept() {
        Ok((stream, _)) => {
            if let Err(error) = stream.set_nonblocking(true) {
                return log.event(Level::Warning, "accept", &format!("a client was not served: {error}"));
            }
            let mut client = Client::new(stream);
            if clients.len() < MAX_CLIENTS {
                clients.push(client);
            } else {
                client.bad(format!("{MAX_CLIENTS} clients are connected already; try again later"));
                client.write();
            }
        }
        Err(e)
            if matches!(
                e.kind(),
                ErrorKind::WouldBlock | ErrorKind::Interrupted | ErrorKind::ConnectionAborted
            ) => {}
        Err(error) => {
            // Out of descriptors: the socket stays ready, so give the others time instead of spinning.
            log.event(Level::Warning, "accept", &format!("a client was not served: {error}"));
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}
