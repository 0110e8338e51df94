//! The service manager: reports (`sd_notify(3)`) and its store of file descriptors.
//! Descriptors in the store outlive this process.
//!
//! | message | when |
//! |---|---|
//! | `READY=1` | the engine looks at the card, and its set-up has been read back and reported |
//! | `STATUS=` | the mode and each axis's completed total, at most once a second |
//! | `WATCHDOG=1` | from the control loop, and only while the real-time thread looks at the card |
//! | `STOPPING=1` | a signal has come: parking |
//! | `FDSTORE=1` | a descriptor whose closing would release output lines; it comes back at the next start |
//!
//! Without a service manager nothing is reported and nothing comes back.

use anyhow::Context;
use nix::sys::socket::{ControlMessage, MsgFlags, UnixAddr, sendmsg};
use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::io::IoSlice;
use std::os::fd::{AsRawFd, BorrowedFd, FromRawFd, OwnedFd, RawFd};
use std::os::linux::net::SocketAddrExt;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::time::{Duration, Instant};

/// The first passed descriptor (`sd_listen_fds(3)`).
const FIRST: RawFd = 3;
/// Shortest time between two reports of the status.
const STATUS_EVERY: Duration = Duration::from_secs(1);

/// The service manager, or none.
pub(crate) struct ServiceManager {
    socket: Option<UnixDatagram>,
    /// Expected time between two watchdog messages.
    /// `None` without a watchdog.
    watchdog_every: Option<Duration>,
    fed: Instant,
    /// Number of looks at the card when the watchdog was last fed.
    polls: u64,
    reported: Instant,
    status: String,
    /// Descriptors from the store that were not taken yet, by name.
    stored: BTreeMap<String, OwnedFd>,
    /// Names of the descriptors from the store, which still has them.
    in_store: BTreeSet<String>,
}

impl ServiceManager {
    /// Reads the environment, and takes over the passed descriptors.
    /// It must be called first.
    ///
    /// # Errors
    /// When the environment is contradictory, or the notification socket is missing.
    pub(crate) fn from_environment() -> anyhow::Result<Self> {
        let number = |name: &str| -> anyhow::Result<Option<u64>> {
            let Some(text) = std::env::var_os(name) else { return Ok(None) };
            let number = text.to_str().and_then(|t| t.parse().ok());
            Ok(Some(number.with_context(|| format!("found {name}={}, expected a number", text.display()))?))
        };
        let me = u64::from(std::process::id());
        let count = if number("LISTEN_PID")? == Some(me) { number("LISTEN_FDS")?.unwrap_or(0) } else { 0 };
        let names = std::env::var("LISTEN_FDNAMES").unwrap_or_default();
        let mut names = names.split(':');
        let mut stored = BTreeMap::new();
        for n in 0..RawFd::try_from(count).context("LISTEN_FDS")? {
            let fd = take(FIRST + n).with_context(|| format!("descriptor {} of LISTEN_FDS", FIRST + n))?;
            stored.insert(names.next().unwrap_or("unknown").to_owned(), fd);
        }
        let for_us = number("WATCHDOG_PID")?.is_none_or(|pid| pid == me);
        // Half the time is what sd_watchdog_enabled(3) advises.
        let watchdog = number("WATCHDOG_USEC")?.filter(|_| for_us);
        let socket = std::env::var_os("NOTIFY_SOCKET").map(|path| connect(&path)).transpose()?;
        let watchdog_every = watchdog.map(|us| Duration::from_micros(us / 2));
        Ok(Self::new(socket, watchdog_every, stored))
    }

    fn new(
        socket: Option<UnixDatagram>,
        watchdog_every: Option<Duration>,
        stored: BTreeMap<String, OwnedFd>,
    ) -> Self {
        let (fed, reported, in_store) = (Instant::now(), Instant::now(), stored.keys().cloned().collect());
        Self { socket, watchdog_every, fed, polls: 0, reported, status: String::new(), stored, in_store }
    }

    /// The descriptors stored by an earlier process under names with this beginning.
    pub(crate) fn take_back(&mut self, beginning: &str) -> Vec<OwnedFd> {
        let (taken, left) =
            std::mem::take(&mut self.stored).into_iter().partition(|(name, _)| name.starts_with(beginning));
        self.stored = left;
        BTreeMap::into_values(taken).collect()
    }

    /// Names of descriptors from the store that were not taken.
    /// They stay open, so that their lines keep their levels.
    pub(crate) fn left_over(&self) -> impl Iterator<Item = &str> {
        self.stored.keys().map(String::as_str)
    }

    /// Gives a descriptor to the store, which keeps it beyond the end of this process.
    /// A descriptor that came from the store is still in it. Returns `false` without a service manager.
    ///
    /// # Errors
    /// When it could not be sent.
    pub(crate) fn keep(&self, name: &str, fd: BorrowedFd<'_>) -> anyhow::Result<bool> {
        if self.in_store.contains(name) {
            return Ok(true);
        }
        let message = format!("FDSTORE=1\nFDNAME={name}\n");
        self.send(&message, Some(fd), MsgFlags::empty()).with_context(|| format!("storing descriptor {name}"))
    }

    /// Reports that the engine runs and its set-up is reported.
    ///
    /// # Errors
    /// When the message could not be sent.
    pub(crate) fn ready(&self) -> anyhow::Result<()> {
        self.send("READY=1\n", None, MsgFlags::empty()).context("telling the service manager")?;
        Ok(())
    }

    /// Reports that a signal has come.
    pub(crate) fn stopping(&self) {
        // An error does not matter, because the sender of the signal knows.
        let _ = self.send("STOPPING=1\nSTATUS=parking\n", None, MsgFlags::MSG_DONTWAIT);
    }

    /// Reports one turn of the control loop.
    /// `polls` is the number of looks at the card, `status` the status in words. It never waits. A message that the
    /// service manager does not take now is sent at a later turn.
    pub(crate) fn turn(&mut self, polls: u64, status: impl FnOnce() -> String) {
        if self.socket.is_none() {
            return;
        }
        let now = Instant::now();
        if self.watchdog_every.is_some_and(|every| now - self.fed >= every) && polls != self.polls {
            if matches!(self.send("WATCHDOG=1\n", None, MsgFlags::MSG_DONTWAIT), Ok(true)) {
                self.fed = now;
            }
            self.polls = polls;
        }
        if now - self.reported >= STATUS_EVERY || self.status.is_empty() {
            self.reported = now;
            let status = status();
            if status != self.status
                && matches!(self.send(&format!("STATUS={status}\n"), None, MsgFlags::MSG_DONTWAIT), Ok(true))
            {
                self.status = status;
            }
        }
    }

    fn send(&self, message: &str, fd: Option<BorrowedFd<'_>>, flags: MsgFlags) -> nix::Result<bool> {
        let Some(socket) = &self.socket else { return Ok(false) };
        let raw = fd.map(|fd| [fd.as_raw_fd()]);
        let rights: Vec<ControlMessage<'_>> = raw.iter().map(|fds| ControlMessage::ScmRights(fds)).collect();
        let text = [IoSlice::new(message.as_bytes())];
        sendmsg::<UnixAddr>(socket.as_raw_fd(), &text, &rights, flags | MsgFlags::MSG_NOSIGNAL, None)?;
        Ok(true)
    }
}

/// Takes over a passed descriptor, which is closed at every `exec`.
fn take(fd: RawFd) -> nix::Result<OwnedFd> {
    use nix::fcntl::{FcntlArg, FdFlag, fcntl};
    // SAFETY: the process that set LISTEN_PID for us opened it for us alone, and it is taken once. If it is not open
    // after all, the call below reports that.
    let fd = unsafe { OwnedFd::from_raw_fd(fd) };
    match fcntl(&fd, FcntlArg::F_SETFD(FdFlag::FD_CLOEXEC)) {
        Ok(_) => Ok(fd),
        Err(error) => {
            // Not open, so it must not be closed either.
            std::mem::forget(fd);
            Err(error)
        }
    }
}

fn connect(path: &OsStr) -> anyhow::Result<UnixDatagram> {
    let name = path.as_bytes();
    let address = match name.strip_prefix(b"@") {
        Some(name) => SocketAddr::from_abstract_name(name),
        None => SocketAddr::from_pathname(path),
    };
    let socket = UnixDatagram::unbound()?;
    let connected = address.and_then(|address| socket.connect_addr(&address));
    connected.with_context(|| format!("reaching the service manager at NOTIFY_SOCKET={}", path.display()))?;
    Ok(socket)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::fd::AsFd;

    fn manager(watchdog_every: Option<Duration>) -> (ServiceManager, UnixDatagram) {
        let (ours, theirs) = UnixDatagram::pair().unwrap();
        theirs.set_nonblocking(true).unwrap();
        let status = "as before".to_owned();
        let manager = ServiceManager::new(Some(ours), watchdog_every, BTreeMap::new());
        (ServiceManager { status, ..manager }, theirs)
    }

    fn received(socket: &UnixDatagram) -> Vec<String> {
        let mut buffer = [0; 256];
        let mut all = Vec::new();
        while let Ok(n) = socket.recv(&mut buffer) {
            all.push(String::from_utf8(buffer[..n].to_vec()).unwrap());
        }
        all
    }

    #[test]
    fn the_watchdog_is_fed_only_while_the_real_time_thread_gets_on() {
        let (mut manager, theirs) = manager(Some(Duration::ZERO));
        manager.turn(7, String::new);
        assert_eq!(received(&theirs), ["WATCHDOG=1\n"]);
        manager.turn(7, String::new);
        assert_eq!(received(&theirs), [""; 0], "it stands still");
        manager.turn(8, String::new);
        assert_eq!(received(&theirs), ["WATCHDOG=1\n"]);
    }

    #[test]
    fn nobody_who_reads_holds_the_control_loop_up_and_the_watchdog_is_made_good() {
        let (mut manager, theirs) = manager(Some(Duration::ZERO));
        for polls in 1..10_000 {
            manager.turn(polls, String::new);
        }
        let waiting = received(&theirs).len();
        assert!(waiting > 0 && waiting < 9_999, "{waiting}: the queue was never full");
        manager.turn(10_000, String::new);
        assert_eq!(received(&theirs), ["WATCHDOG=1\n"]);
    }

    #[test]
    fn what_came_back_is_taken_once_and_not_stored_again() {
        let (mut manager, theirs) = manager(None);
        let file = std::fs::File::open("/dev/null").unwrap();
        assert!(manager.keep("outputs-chip", file.as_fd()).unwrap());
        assert_eq!(received(&theirs), ["FDSTORE=1\nFDNAME=outputs-chip\n"]);
        for name in ["outputs-chip", "other"] {
            manager.stored.insert(name.to_owned(), file.try_clone().unwrap().into());
            manager.in_store.insert(name.to_owned());
        }
        assert_eq!(manager.take_back("outputs-").len(), 1);
        assert_eq!(manager.take_back("outputs-").len(), 0);
        assert_eq!(manager.left_over().collect::<Vec<_>>(), ["other"]);
        assert!(manager.keep("outputs-chip", file.as_fd()).unwrap());
        assert_eq!(received(&theirs), [""; 0]);
        manager.socket = None;
        manager.in_store.clear();
        assert!(!manager.keep("outputs-chip", file.as_fd()).unwrap(), "nobody keeps it");
    }
}
