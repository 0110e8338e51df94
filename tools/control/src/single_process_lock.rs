//! One program at a time: locks for a control socket and for a card's file.

use crate::audit_log::with_suffix;
use nix::errno::Errno;
use nix::fcntl::{Flock, FlockArg, OFlag};
use std::fs::{File, OpenOptions};
use std::io::{self, Read, Seek, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

/// A lock that lasts as long as this value.
pub type LockGuard = Flock<File>;

/// Reason why a lock could not be taken.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)] // the messages say what they are
pub enum LockError {
    /// Another process holds it: `by` is ` (process 123)`, or empty if it is not known.
    #[error("another rtecd{by} holds the {what} {}", path.display())]
    Taken { by: String, what: &'static str, path: PathBuf },
    #[error("{what} {}: {source}", path.display())]
    Io { what: &'static str, path: PathBuf, source: io::Error },
}

fn lock(path: &Path, what: &'static str, options: &OpenOptions) -> Result<LockGuard, LockError> {
    let io = |source| LockError::Io { what, path: path.to_owned(), source };
    let file = options.open(path).map_err(io)?;
    Flock::lock(file, FlockArg::LockExclusiveNonblock).map_err(|(mut held, errno)| {
        if errno != Errno::EWOULDBLOCK {
            return io(errno.into());
        }
        let mut holder = String::new();
        if what == "lock" {
            // The holder's process number only improves the message.
            let _ = held.read_to_string(&mut holder);
        }
        let holder = holder.trim();
        let by = if holder.is_empty() { String::new() } else { format!(" (process {holder})") };
        LockError::Taken { by, what, path: path.to_owned() }
    })
}

/// Locks a card's file of registers.
///
/// # Errors
/// When another process has it, or it cannot be opened.
pub fn card(file: &Path) -> Result<LockGuard, LockError> {
    // Symbolic links are followed, because those below /dev lead to the card.
    lock(file, "card", File::options().read(true).write(true))
}

/// Options of the lock file: it is written to, and never through a symbolic link.
fn own() -> OpenOptions {
    let mut options = File::options();
    options.read(true).write(true).custom_flags((OFlag::O_NOFOLLOW | OFlag::O_NONBLOCK).bits());
    options
}

/// Takes the lock beside a control socket and writes our process number to it.
///
/// # Errors
/// When another process has it, or it cannot be made.
pub fn socket(socket: &Path) -> Result<LockGuard, LockError> {
    let path = with_suffix(socket, "lock");
    let io = |source| LockError::Io { what: "lock", path: path.clone(), source };
    let mut held = lock(&path, "lock", own().create(true).truncate(false))?;
    held.set_len(0).and_then(|()| held.rewind()).map_err(io)?;
    writeln!(held, "{}", std::process::id()).map_err(io)?;
    Ok(held)
}

/// Keeps the daemon of a control socket from starting while the value lives.
/// `None` if no daemon has ever run.
///
/// # Errors
/// When the daemon runs.
pub fn keep_out(socket: &Path) -> Result<Option<LockGuard>, LockError> {
    let path = with_suffix(socket, "lock");
    if path.exists() { lock(&path, "lock", &own()).map(Some) } else { Ok(None) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_link_in_the_place_of_the_lock_is_not_written_through() {
        let directory = tempfile::tempdir().unwrap();
        let at = |name: &str| directory.path().join(name);
        std::fs::write(at("victim"), "precious").unwrap();
        std::os::unix::fs::symlink(at("victim"), at("s.lock")).unwrap();
        assert!(matches!(socket(&at("s")), Err(LockError::Io { .. })));
        std::fs::remove_file(at("victim")).unwrap();
        assert!(matches!(socket(&at("s")), Err(LockError::Io { .. })));
        assert!(!at("victim").exists());
        std::fs::remove_file(at("s.lock")).unwrap();
        let held = socket(&at("s")).unwrap();
        assert!(matches!(socket(&at("s")), Err(LockError::Taken { .. })));
        drop(held);
        assert!(keep_out(&at("s")).unwrap().is_some());
    }
}
