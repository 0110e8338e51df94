//! Standard error for the journal: one line per message, limited in rate.
//! Lines have systemd's level prefix where systemd listens. What standard error does not take at once is dropped. The
//! control loop never waits for a reader, and a full disk does not end the daemon.
//!
//! Faults, changes of mode, models and part tables go to the journal with fields of their own. They are datagrams of
//! journald's native protocol, sent where the journal reads standard error. If journald does not take them, they go
//! to standard error.
//!
//! | field | what |
//! |---|---|
//! | `MESSAGE_ID` | one per kind: `journalctl MESSAGE_ID=…` |
//! | `RTEC_EVENT` | `fault`, `mode`, `homed`, `model_loaded`, `model_unloaded`, `table_loaded`, `table_unloaded`, `record_anchor` |
//! | `RTEC_AXIS` | the axis, where there is one |
//! | `RTEC_REASON` | which fault, which mode |
//! | `RTEC_MODEL_SHA256` | the model's file |

use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use std::collections::BTreeMap;
use std::io::Write;
use std::os::fd::AsFd;
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::sync::{LazyLock, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Levels of syslog(3).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum SyslogLevel {
    Error = 3,
    Warning = 4,
    Notice = 5,
    Info = 6,
}

/// Number of messages of one kind in [`PERIOD`]; further ones are only counted.
const BURST: u32 = 20;
const PERIOD: Duration = Duration::from_secs(10);
/// The socket on which journald takes datagrams.
/// See `systemd.journal-fields(7)`, "Native Journal Protocol".
const JOURNALD: &str = "/run/systemd/journal/socket";

/// The message's kind, as 128 bits in hexadecimal.
fn message_id(event: &str) -> &'static str {
    match event {
        "fault" => "0c5d8f32302246b59de9154b96e463f1",
        "mode" => "7c49ee60f8204124bef7667a46dd3815",
        "model_loaded" | "model_unloaded" => "86b5e69ddf9646ac87019beea6e4ca56",
        "table_loaded" | "table_unloaded" => "f4b077e408d547388759fdd4152ac406",
        "record_anchor" => "5a3c0e5d7c924ab0b0f5a2c86c3a1d57",
        _ => "80c81ea96aa34fee9418710cd047f7c4",
    }
}

struct LogRateWindow {
    begun: Instant,
    written: u32,
    left_out: u32,
}

/// The log of this process.
static LOG: LazyLock<StderrJournalLog> = LazyLock::new(StderrJournalLog::new);

/// Writes a message. Unit tests write none.
pub(crate) fn say(level: SyslogLevel, text: &str) {
    LOG.say(level, text);
}

/// Writes as [`say`] does, but limits the number of messages of one `kind`.
pub(crate) fn event(level: SyslogLevel, kind: &str, text: &str) {
    LOG.event(level, kind, text);
}

/// Writes as [`event`] does, with fields for the journal.
/// `RTEC_EVENT` is `event`.
pub(crate) fn record(level: SyslogLevel, event: &str, text: &str, fields: &[(&str, &str)]) {
    LOG.record(level, event, text, fields);
}

struct StderrJournalLog {
    journal: bool,
    /// The journal's native socket, where it reads standard error too.
    native: Option<(UnixDatagram, PathBuf)>,
    kinds: Mutex<BTreeMap<String, LogRateWindow>>,
}

impl StderrJournalLog {
    fn new() -> Self {
        // systemd sets this where standard error is its journal (systemd.exec(5)).
        let journal = std::env::var_os("JOURNAL_STREAM").is_some();
        let native = journal.then(|| native(Path::new(JOURNALD))).flatten();
        Self { journal, native, kinds: Mutex::default() }
    }

    fn record(&self, level: SyslogLevel, event: &str, text: &str, fields: &[(&str, &str)]) {
        let message = datagram(level, event, text, fields);
        let native = self.native.as_ref().is_some_and(|(socket, to)| socket.send_to(&message, to).is_ok());
        if native {
            return;
        }
        self.event(level, event, text);
    }

    fn say(&self, level: SyslogLevel, text: &str) {
        if cfg!(test) {
            return;
        }
        let line = if self.journal {
            format!("<{}>{text}\n", level as u8)
        } else {
            let word = match level {
                SyslogLevel::Error => "error: ",
                SyslogLevel::Warning => "warning: ",
                SyslogLevel::Notice | SyslogLevel::Info => "",
            };
            format!("rtecd: {word}{text}\n")
        };
        let mut stderr = std::io::stderr();
        // A pipe that is ready to be written takes a whole line without waiting (pipe(7)).
        let mut ready = [PollFd::new(stderr.as_fd(), PollFlags::POLLOUT)];
        if poll(&mut ready, PollTimeout::ZERO).is_ok_and(|n| n > 0) {
            let _ = stderr.write_all(line.as_bytes()); // a failure cannot be reported anywhere
        }
    }

    fn event(&self, level: SyslogLevel, kind: &str, text: &str) {
        let (write, before) = self.admits(kind);
        if before > 0 {
            self.say(level, &format!("{kind}: {before} more of these were left out"));
        }
        if write {
            self.say(level, text);
        }
    }

    /// Whether a message of this kind is written now.
    /// And how many were left out before it.
    fn admits(&self, kind: &str) -> (bool, u32) {
        let now = Instant::now();
        let mut kinds = self.kinds.lock().unwrap_or_else(PoisonError::into_inner);
        let window =
            kinds.entry(kind.to_owned()).or_insert(LogRateWindow { begun: now, written: 0, left_out: 0 });
        let mut before = 0;
        if now.duration_since(window.begun) > PERIOD {
            before = window.left_out;
            *window = LogRateWindow { begun: now, written: 0, left_out: 0 };
        }
        let write = window.written < BURST;
        *(if write { &mut window.written } else { &mut window.left_out }) += 1;
        (write, before)
    }
}

/// A socket that never waits, where the receiver exists.
fn native(to: &Path) -> Option<(UnixDatagram, PathBuf)> {
    let socket = UnixDatagram::unbound().ok().filter(|_| to.exists())?;
    socket.set_nonblocking(true).ok()?;
    Some((socket, to.to_owned()))
}

/// A message in the journal's native form: `KEY=value`.
/// A value of several lines is given with its length.
fn datagram(level: SyslogLevel, event: &str, text: &str, fields: &[(&str, &str)]) -> Vec<u8> {
    let priority = (level as u8).to_string();
    let own = [
        ("MESSAGE", text),
        ("PRIORITY", &priority),
        ("SYSLOG_IDENTIFIER", "rtecd"),
        ("MESSAGE_ID", message_id(event)),
        ("RTEC_EVENT", event),
    ];
    let mut bytes = Vec::new();
    for (key, value) in own.iter().chain(fields) {
        bytes.extend_from_slice(key.as_bytes());
        if value.contains('\n') {
            bytes.push(b'\n');
            bytes.extend_from_slice(&(value.len() as u64).to_le_bytes());
        } else {
            bytes.push(b'=');
        }
        bytes.extend_from_slice(value.as_bytes());
        bytes.push(b'\n');
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_is_one_datagram_with_its_fields() {
        let directory = tempfile::tempdir().unwrap();
        let at = directory.path().join("journal");
        let journald = UnixDatagram::bind(&at).unwrap();
        journald.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
        let log = StderrJournalLog { journal: true, native: native(&at), ..StderrJournalLog::new() };
        log.record(
            SyslogLevel::Error,
            "fault",
            "axis x: poll_gap",
            &[("RTEC_AXIS", "x"), ("RTEC_REASON", "poll_gap")],
        );
        let mut bytes = [0; 512];
        let n = journald.recv(&mut bytes).unwrap();
        let found = std::str::from_utf8(&bytes[..n]).unwrap();
        let wanted = "MESSAGE=axis x: poll_gap\nPRIORITY=3\nSYSLOG_IDENTIFIER=rtecd\nMESSAGE_ID=\
                      0c5d8f32302246b59de9154b96e463f1\nRTEC_EVENT=fault\nRTEC_AXIS=x\nRTEC_REASON=poll_gap\n";
        assert_eq!(found, wanted);
        // A value of several lines is given with its length, so that none of its lines passes for a field.
        let two = datagram(SyslogLevel::Notice, "mode", "a\nRTEC_AXIS=y", &[]);
        assert!(two.starts_with(b"MESSAGE\n\x0d\0\0\0\0\0\0\0a\nRTEC_AXIS=y\nPRIORITY=5\n"));
        assert!(native(&directory.path().join("nobody")).is_none());
    }
}
