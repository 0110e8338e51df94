//! One connection: its user, its requests and its unread answers.
//! All of them are bounded.

use nix::cmsg_space;
use nix::errno::Errno;
use nix::sys::socket::{ControlMessageOwned, MsgFlags, UnixAddr, getsockopt, recvmsg, sockopt};
use rtec_control::client_role::ClientRole;
use rtec_control::protocol::{ClientProcess, ClientRequest, DaemonResponse, MAX_LINE};
use std::collections::VecDeque;
use std::io::{ErrorKind, IoSliceMut, Write};
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd, RawFd};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::time::{Duration, Instant};

/// Bytes of unread answers that a client may have.
/// Beyond it nothing more is read from the client, and a watcher is dropped.
const MAX_UNREAD: usize = 256 * 1024;
/// Time without a whole request after which a client is dropped.
/// Watchers may be silent. A client or watcher that reads no answer for this time is dropped too.
const IDLE: Duration = Duration::from_secs(30);
/// The same on a reserved place.
const IDLE_RESERVED: Duration = Duration::from_secs(2);
/// Largest number of descriptors with one message, which wait for their line.
const MAX_FILES: usize = 8;

/// Urgency of a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum RequestPriority {
    /// Takes corrections out of force or stops the machine; it comes first.
    First,
    /// Reads only, and takes little time.
    Look,
    /// Everything else.
    Turn,
}

/// A request that is not answered yet.
pub(crate) struct PendingRequest {
    pub request: Result<ClientRequest, String>,
    pub since: Instant,
}

impl PendingRequest {
    pub(crate) fn urgency(&self) -> RequestPriority {
        match self.request {
            Ok(ClientRequest::Disable {} | ClientRequest::Park {} | ClientRequest::Hold { .. }) => {
                RequestPriority::First
            }
            Ok(ClientRequest::Status {} | ClientRequest::Whoami {}) | Err(_) => RequestPriority::Look,
            Ok(_) => RequestPriority::Turn,
        }
    }
}

/// Stage of a connection's end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum ConnectionStage {
    Open,
    /// Nothing more is read; the connection closes when its answers are sent.
    Closing,
    Gone,
}

pub(crate) struct ClientConnection {
    pub id: u64,
    pub stream: UnixStream,
    pub caller: ClientProcess,
    pub role: ClientRole,
    /// It has a place that is reserved for urgent requests.
    pub reserved: bool,
    pub watching: bool,
    pub pending: Option<PendingRequest>,
    /// The answer to its request comes later.
    /// No further request is taken up until then.
    pub waits: bool,
    inbox: Vec<u8>,
    files: VecDeque<OwnedFd>,
    outbox: Vec<u8>,
    last_line: Instant,
    /// Time when it last read some of its answers, or had none.
    last_taken: Instant,
    stage: ConnectionStage,
}

impl ClientConnection {
    /// A connection on the socket of a role.
    pub(crate) fn new(id: u64, stream: UnixStream, role: ClientRole, socket: &Path) -> nix::Result<Self> {
        let peer = getsockopt(&stream, sockopt::PeerCredentials)?;
        let caller = ClientProcess {
            uid: peer.uid(),
            user: user_name(peer.uid()),
            pid: peer.pid(),
            exe: executable(peer.pid()),
            role: role.word().to_owned(),
            may: Vec::new(),
            socket: socket.display().to_string(),
        };
        Ok(Self {
            id,
            stream,
            caller,
            role,
            reserved: false,
            watching: false,
            pending: None,
            waits: false,
            inbox: Vec::new(),
            files: VecDeque::new(),
            outbox: Vec::new(),
            last_line: Instant::now(),
            last_taken: Instant::now(),
            stage: ConnectionStage::Open,
        })
    }

    /// Whether nobody has hung up.
    pub(crate) fn is_open(&self) -> bool {
        self.stage == ConnectionStage::Open
    }

    /// Whether nobody reads its answers any more.
    pub(crate) fn gone(&self) -> bool {
        self.stage == ConnectionStage::Gone
    }

    /// Moves on to a later stage; it never goes back.
    pub(crate) fn enter(&mut self, stage: ConnectionStage) {
        self.stage = self.stage.max(stage);
    }

    /// Whether to read from it: its answers and its last line must have been taken.
    pub(crate) fn reads(&self) -> bool {
        self.is_open() && self.outbox.len() < MAX_UNREAD && self.inbox.len() < 2 * MAX_LINE
    }

    pub(crate) fn unsent(&self) -> bool {
        !self.outbox.is_empty()
    }

    pub(crate) fn put(&mut self, response: &DaemonResponse) {
        // A response consists of numbers, strings and lists, so it always has a JSON form.
        let Ok(line) = serde_json::to_string(response) else { return };
        if self.outbox.is_empty() {
            self.last_taken = Instant::now();
        }
        self.outbox.extend_from_slice(line.as_bytes());
        self.outbox.push(b'\n');
    }

    /// Reads the bytes that have come, with their descriptors.
    pub(crate) fn read(&mut self) {
        let mut buffer = [0; MAX_LINE];
        let mut space = cmsg_space!([RawFd; MAX_FILES]);
        let mut into = [IoSliceMut::new(&mut buffer)];
        let flags = MsgFlags::MSG_DONTWAIT | MsgFlags::MSG_CMSG_CLOEXEC;
        let message = match recvmsg::<UnixAddr>(self.stream.as_raw_fd(), &mut into, Some(&mut space), flags) {
            Ok(message) => message,
            Err(Errno::EAGAIN | Errno::EINTR) => return,
            Err(_) => {
                self.enter(ConnectionStage::Gone);
                return;
            }
        };
        let mut fds = Vec::new();
        for control in message.cmsgs().into_iter().flatten() {
            if let ControlMessageOwned::ScmRights(raw) = control {
                // SAFETY: the kernel has just opened them for this process, and nobody else here knows of them.
                fds.extend(raw.into_iter().map(|fd| unsafe { OwnedFd::from_raw_fd(fd) }));
            }
        }
        let cut = message.flags.contains(MsgFlags::MSG_CTRUNC);
        let bytes = message.bytes;
        self.files.extend(fds);
        if cut || self.files.len() > MAX_FILES {
            self.files.clear();
            self.put(&DaemonResponse::Bad {
                text: format!("found more than {MAX_FILES} descriptors; expected those of one request"),
            });
            self.enter(ConnectionStage::Closing);
        } else if bytes == 0 {
            self.enter(ConnectionStage::Closing);
        } else {
            self.inbox.extend_from_slice(&buffer[..bytes]);
        }
    }

    /// Takes up the next whole line, if the one before is answered.
    pub(crate) fn take_up(&mut self) {
        if self.pending.is_some() || self.waits || self.outbox.len() >= MAX_UNREAD {
            return;
        }
        let Some(end) = self.inbox.iter().position(|&b| b == b'\n') else {
            if self.inbox.len() >= MAX_LINE && self.is_open() {
                let text = format!("found a line of more than {MAX_LINE} bytes; expected one request a line");
                self.put(&DaemonResponse::Bad { text });
                self.inbox.clear();
                self.enter(ConnectionStage::Closing);
            }
            return;
        };
        let line: Vec<u8> = self.inbox.drain(..=end).take(end).collect();
        self.last_line = Instant::now();
        let request = match std::str::from_utf8(&line) {
            Ok(line) => ClientRequest::parse(line.trim()),
            Err(_) => Err("found bytes that are no UTF-8; expected one JSON object a line".to_owned()),
        };
        self.pending = Some(PendingRequest { request, since: self.last_line });
    }

    /// Whether a line can be taken up.
    pub(crate) fn has_line(&self) -> bool {
        let free = self.pending.is_none() && !self.waits && self.outbox.len() < MAX_UNREAD;
        free && self.inbox.contains(&b'\n')
    }

    /// The descriptors that came with the present line.
    pub(crate) fn take_files(&mut self) -> Vec<OwnedFd> {
        self.files.drain(..).collect()
    }

    pub(crate) fn write(&mut self) {
        while !self.outbox.is_empty() {
            match self.stream.write(&self.outbox) {
                Ok(n) => {
                    self.last_taken = Instant::now();
                    self.outbox.drain(..n);
                }
                Err(e) if e.kind() == ErrorKind::WouldBlock => return,
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(_) => {
                    self.enter(ConnectionStage::Gone);
                    return;
                }
            }
        }
    }

    /// Whether the connection has ended, or must be ended.
    pub(crate) fn must_close(&self) -> bool {
        let patience = if self.reserved { IDLE_RESERVED } else { IDLE };
        let idle =
            !self.watching && !self.waits && self.pending.is_none() && self.last_line.elapsed() > patience;
        let stalled = self.unsent() && self.last_taken.elapsed() > patience;
        let deaf = stalled || self.watching && self.outbox.len() > MAX_UNREAD;
        let ended = self.stage == ConnectionStage::Closing
            && self.outbox.is_empty()
            && self.pending.is_none()
            && !self.waits;
        self.gone() || idle || deaf || ended && !self.inbox.contains(&b'\n')
    }

    /// Time of its last whole line.
    pub(crate) fn silent_since(&self) -> Instant {
        self.last_line
    }
}

/// The user's name in the local list of users.
/// A directory service could take too long to answer.
pub(crate) fn user_name(uid: u32) -> String {
    let users = std::fs::read_to_string("/etc/passwd").unwrap_or_default();
    let named = users.lines().find(|line| line.split(':').nth(2).and_then(|n| n.parse().ok()) == Some(uid));
    named.and_then(|line| line.split(':').next()).unwrap_or_default().to_owned()
}

/// Executable of a process, or its name in brackets where no more is visible.
fn executable(pid: i32) -> String {
    let plain = |text: &str| -> String {
        text.chars().take(256).map(|c| if c.is_control() { '?' } else { c }).collect()
    };
    match std::fs::read_link(format!("/proc/{pid}/exe")) {
        Ok(path) => plain(&path.to_string_lossy()),
        Err(_) => std::fs::read_to_string(format!("/proc/{pid}/comm"))
            .map_or(String::new(), |name| format!("[{}]", plain(name.trim()))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whoever_reads_nothing_is_dropped_a_watcher_too() {
        let (stream, _other) = UnixStream::pair().unwrap();
        stream.set_nonblocking(true).unwrap();
        let mut client = ClientConnection::new(1, stream, ClientRole::View, Path::new("s")).unwrap();
        client.watching = true;
        client.last_line = Instant::now().checked_sub(2 * IDLE).unwrap();
        // A watcher without anything to read may be silent.
        client.write();
        assert!(!client.must_close());
        while !client.unsent() {
            client.put(&DaemonResponse::Bad { text: "x".repeat(4096) });
            client.write();
        }
        assert!(!client.must_close());
        client.last_taken = Instant::now().checked_sub(2 * IDLE).unwrap();
        client.write();
        assert!(client.must_close());
    }
}
