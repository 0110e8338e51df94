//! The client's end of the control socket.

use crate::client_role::ClientRole;
use crate::config::{LONGEST_SOCKET, derived};
use crate::owner_only_directory::directory_owner;
use crate::protocol::{ClientRequest, DaemonResponse};
use nix::sys::socket::{ControlMessage, MsgFlags, UnixAddr, getsockopt, sendmsg, sockopt};
use nix::unistd::Uid;
use rtec_files::message_text::{printable, quoted};
use std::fs::File;
use std::io::{self, BufRead, BufReader, ErrorKind, IoSlice, Write};
use std::os::fd::{AsRawFd, RawFd};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Longest wait for an answer.
/// An answer takes milliseconds, that to a load some seconds. A daemon that takes longer has a problem.
const PATIENCE: Duration = Duration::from_secs(10);
/// Longest answer, bytes.
/// A page of a ledger or a whole status has some hundred thousand bytes.
const LONGEST_ANSWER: u64 = 16 << 20;

/// Reason why the daemon gave no answer.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)] // the messages say what they are
pub enum ClientError {
    #[error("cannot reach rtecd at {}: {source}; is it running? (systemctl status rtecd, or start rtecd)", socket.display())]
    Unreachable { socket: PathBuf, source: io::Error },
    #[error(
        "cannot reach rtecd at {}: found a path of {} bytes, expected at most {LONGEST_SOCKET} (unix(7)): a shorter directory, or \
         a symbolic link to it", socket.display(), socket.as_os_str().len()
    )]
    TooLong { socket: PathBuf },
    #[error(
        "cannot reach rtecd at {}: permission denied on every socket of it; ask for a group that may ([control] group, \
         operate.group, view.group of the configuration)", socket.display()
    )]
    Forbidden { socket: PathBuf },
    /// A process of another user listens there.
    /// `open` is a directory on its path that everybody can write to.
    #[error("{}: a process of user {uid} listens there, {}; nothing is said to it", socket.display(), expected(open.as_deref()))]
    Impostor { socket: PathBuf, uid: u32, open: Option<PathBuf> },
    #[error("no answer from rtecd{}", silence(.0))]
    Io(#[from] io::Error),
    #[error("rtecd answered {found}: {}; are rtecctl and rtecd of the same version?", printable(why))]
    Answer { found: String, why: String },
}

/// Describes whose process should listen there.
fn expected(open: Option<&Path>) -> String {
    match open {
        Some(open) => format!(
            "and everybody can write to {}, so that anybody may have put it there: expected one of root or of this user, or a \
             socket below directories that only their owners write to, as /run/rtec",
            open.display()
        ),
        None => "expected one of root, of this user, or of the owner of the socket's directory".to_owned(),
    }
}

/// Explains a broken connection to the user.
fn silence(error: &io::Error) -> String {
    match error.kind() {
        io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut => format!(
            " for {} s: it is there, but busy or stopped (systemctl status rtecd; journalctl -u rtecd)",
            PATIENCE.as_secs()
        ),
        ErrorKind::UnexpectedEof | ErrorKind::BrokenPipe | ErrorKind::ConnectionReset => {
            ": it has ended, or closed the connection (systemctl status rtecd; journalctl -u rtecd)"
                .to_owned()
        }
        _ => format!(": {error}"),
    }
}

/// A connection to the daemon.
#[derive(Debug)]
pub struct DaemonConnection {
    stream: BufReader<UnixStream>,
}

impl DaemonConnection {
    /// Connects by a socket.
    /// If this user may not use it, tries the sockets of lesser roles beside it.
    ///
    /// # Errors
    /// When nothing listens, this user may use none of them, or another user's process listens.
    pub fn connect(socket: &Path) -> Result<Self, ClientError> {
        let sockets = ClientRole::ALL.map(|role| derived(socket, role));
        Self::connect_to(&[&sockets[2], &sockets[1], &sockets[0]])
    }

    /// Connects by the first of these sockets that this user may use.
    ///
    /// # Errors
    /// As [`DaemonConnection::connect`].
    pub fn connect_to(sockets: &[&PathBuf]) -> Result<Self, ClientError> {
        let mut failed: Vec<(&PathBuf, io::Error)> = Vec::new();
        for socket in sockets {
            match UnixStream::connect(socket) {
                Ok(stream) => {
                    is_daemon(&stream, socket)?;
                    stream.set_read_timeout(Some(PATIENCE))?;
                    stream.set_write_timeout(Some(PATIENCE))?;
                    return Ok(Self { stream: BufReader::new(stream) });
                }
                Err(source) => failed.push((socket, source)),
            }
        }
        // A path derived from a valid one may be too long; no daemon listens there.
        let too_long = |socket: &Path| socket.as_os_str().len() > LONGEST_SOCKET;
        if let Some(socket) = sockets.iter().min_by_key(|s| s.as_os_str().len()).filter(|s| too_long(s)) {
            return Err(ClientError::TooLong { socket: (*socket).clone() });
        }
        failed.retain(|(socket, _)| !too_long(socket));
        // A socket that this user may use, but where nothing listens, explains more than a forbidden one.
        let of = |kind: ErrorKind| failed.iter().position(|(_, e)| e.kind() == kind);
        let denied = of(ErrorKind::PermissionDenied);
        let other = || failed.iter().position(|(_, e)| e.kind() != ErrorKind::NotFound);
        // The configured path is the shortest; the others are derived from it.
        let named = || (0..failed.len()).min_by_key(|n| failed[*n].0.as_os_str().len());
        let Some(n) = of(ErrorKind::ConnectionRefused).or(denied).or_else(other).or_else(named) else {
            return Err(io::Error::from(ErrorKind::NotFound).into());
        };
        let (socket, source) = failed.swap_remove(n);
        let socket = socket.clone();
        Err(if Some(n) == denied && source.kind() == ErrorKind::PermissionDenied {
            ClientError::Forbidden { socket }
        } else {
            ClientError::Unreachable { socket, source }
        })
    }

    /// Sends a request and waits for its answer.
    ///
    /// # Errors
    /// When there is none.
    pub fn ask(&mut self, request: &ClientRequest) -> Result<DaemonResponse, ClientError> {
        self.ask_with(request, &[])
    }

    /// Sends a request with open files and waits for the answer.
    /// The daemon reads these files instead of opening them itself.
    ///
    /// # Errors
    /// When there is none.
    pub fn ask_with(
        &mut self,
        request: &ClientRequest,
        files: &[File],
    ) -> Result<DaemonResponse, ClientError> {
        let mut line = serde_json::to_string(request).map_err(io::Error::other)?;
        line.push('\n');
        let mut rest = line.as_bytes();
        if !files.is_empty() {
            let fds: Vec<RawFd> = files.iter().map(AsRawFd::as_raw_fd).collect();
            let rights = [ControlMessage::ScmRights(&fds)];
            let stream = self.stream.get_ref().as_raw_fd();
            let sent =
                sendmsg::<UnixAddr>(stream, &[IoSlice::new(rest)], &rights, MsgFlags::MSG_NOSIGNAL, None);
            rest = &rest[sent.map_err(io::Error::from)?..];
        }
        // A daemon that refuses a connection answers before it reads. That answer can still be read.
        let sent = self.stream.get_mut().write_all(rest);
        match (self.answer(), sent) {
            (Err(ClientError::Io(_)), Err(sent)) => Err(sent.into()),
            (answer, _) => answer,
        }
    }

    /// Waits without limit: after `watch`, events come at any time.
    ///
    /// # Errors
    /// What the system reports.
    pub fn be_patient(&mut self) -> io::Result<()> {
        self.stream.get_ref().set_read_timeout(None)
    }

    /// Limits the wait for an answer.
    /// After `time` the answer is an error of kind `WouldBlock` or `TimedOut`.
    ///
    /// # Errors
    /// What the system reports.
    pub fn wait_at_most(&mut self, time: Duration) -> io::Result<()> {
        self.stream.get_ref().set_read_timeout(Some(time))
    }

    /// Reads the next answer.
    ///
    /// # Errors
    /// When there is none.
    pub fn answer(&mut self) -> Result<DaemonResponse, ClientError> {
        read_answer(&mut self.stream)
    }
}

/// Reads one line as an answer.
///
/// # Errors
/// There is none: the end, a line that is no answer, or one that does not end.
pub fn read_answer(input: impl BufRead) -> Result<DaemonResponse, ClientError> {
    let mut line = Vec::new();
    if input.take(LONGEST_ANSWER).read_until(b'\n', &mut line)? == 0 {
        return Err(io::Error::new(io::ErrorKind::UnexpectedEof, "it closed the connection").into());
    }
    if line.len() as u64 == LONGEST_ANSWER {
        let why = format!("{LONGEST_ANSWER} bytes without an end of line");
        return Err(io::Error::new(io::ErrorKind::InvalidData, why).into());
    }
    serde_json::from_slice(&line).map_err(|why| ClientError::Answer {
        found: quoted(String::from_utf8_lossy(&line).trim()),
        why: why.to_string(),
    })
}

/// Refuses another user's process, which could accept commands and ignore them.
fn is_daemon(stream: &UnixStream, socket: &Path) -> Result<(), ClientError> {
    let peer = getsockopt(stream, sockopt::PeerCredentials).map_err(io::Error::from)?;
    let uid = peer.uid();
    if uid == 0 || uid == Uid::effective().as_raw() {
        return Ok(());
    }
    let open = match directory_owner(socket) {
        Ok(owner) if owner == uid => return Ok(()),
        Ok(_) => None,
        Err(open) => open,
    };
    Err(ClientError::Impostor { socket: socket.to_owned(), uid, open })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An impostor's answer cannot act on a terminal, and uses bounded memory.
    #[test]
    fn what_is_no_answer_is_shown_short_and_as_text() {
        for (key, says) in
            [("\u{1b}[2J\u{7}", "\\u{1b}[2J\\u{7}"), ("\\u001b[2J", "unknown variant `\\u{1b}[2J`")]
        {
            let line = format!("{{\"{key}\":{}}}\n", "1".repeat(100_000));
            let text = read_answer(line.as_bytes()).unwrap_err().to_string();
            assert!(!text.chars().any(char::is_control) && text.len() < 1000, "{text:?}");
            assert!(text.contains(says), "{text}");
        }
        let endless =
            read_answer(BufReader::with_capacity(1 << 20, io::repeat(b' '))).unwrap_err().to_string();
        assert!(endless.contains("without an end of line"), "{endless}");
        assert!(matches!(read_answer(&b""[..]), Err(ClientError::Io(_))));
        assert_eq!(read_answer(&b"{\"done\":{}}\n"[..]).unwrap(), DaemonResponse::done());
    }

    /// Numbers arrive exact to the last bit.
    #[test]
    fn what_the_daemon_sends_is_what_its_client_has() {
        let mut dice = test_needs::dice::Dice::new(1);
        for _ in 0..10_000 {
            let display_mm = dice.between(0.0, 1000.0);
            let sent = DaemonResponse::Stands { display_mm, indicator_mm: -display_mm / 3.0 };
            let line = serde_json::to_string(&sent).unwrap() + "\n";
            assert_eq!(read_answer(line.as_bytes()).unwrap(), sent, "{line}");
        }
    }

    /// One of three sockets is forbidden, one stale: the stale one is reported.
    #[test]
    fn a_daemon_that_has_died_is_not_mistaken_for_one_that_forbids() {
        let directory = tempfile::tempdir().unwrap();
        let at = |name: &str| directory.path().join(name);
        let (absent, left_over) = (at("control-long-name.sock"), at("s"));
        drop(std::os::unix::net::UnixListener::bind(&left_over).unwrap());
        for order in [[&absent, &left_over], [&left_over, &absent]] {
            let error = DaemonConnection::connect_to(&order).unwrap_err().to_string();
            assert!(error.contains("refused") && error.contains("is it running?"), "{error}");
        }
        // None of them exists: the configured path is reported.
        let (named, derived) = (at("c.sock"), at("c-view.sock"));
        let error = DaemonConnection::connect_to(&[&derived, &named]).unwrap_err().to_string();
        assert!(error.contains("/c.sock: No such file"), "{error}");
    }

    #[test]
    fn a_path_too_long_for_a_socket_is_said() {
        let long = PathBuf::from(format!("/tmp/{}", "x".repeat(120)));
        let error = DaemonConnection::connect(&long).unwrap_err().to_string();
        assert!(error.contains("a path of 125 bytes, expected at most 107"), "{error}");
        // A derived path may be longer than the limit.
        let short = PathBuf::from(format!("/tmp/{}", "x".repeat(100)));
        let error = DaemonConnection::connect(&short).unwrap_err().to_string();
        assert!(error.contains("No such file"), "{error}");
    }

    #[test]
    fn another_users_process_is_told_nothing() {
        if !Uid::effective().is_root() {
            eprintln!("skipped: to be another user takes root");
            return;
        }
        let directory = tempfile::tempdir().unwrap();
        let socket = directory.path().join("s");
        std::fs::set_permissions(directory.path(), std::os::unix::fs::PermissionsExt::from_mode(0o777))
            .unwrap();
        let mut python = std::process::Command::new("python3");
        python.args(["-c", "import os,socket,sys,time\nos.setuid(65534)\ns=socket.socket(socket.AF_UNIX)\ns.bind(sys.argv[1])\ns.listen()\nprint('ready',flush=True)\ntime.sleep(60)"]);
        let Ok(mut impostor) = python.arg(&socket).stdout(std::process::Stdio::piped()).spawn() else {
            eprintln!("skipped: no python3");
            return;
        };
        let mut said = String::new();
        BufReader::new(impostor.stdout.take().unwrap()).read_line(&mut said).unwrap();
        let found = DaemonConnection::connect(&socket);
        impostor.kill().unwrap();
        impostor.wait().unwrap();
        assert!(matches!(found, Err(ClientError::Impostor { uid: 65_534, .. })), "{said} {found:?}");
        let text = found.unwrap_err().to_string();
        assert!(text.contains("everybody can write to /") && text.contains("/run/rtec"), "{text}");
    }
}
