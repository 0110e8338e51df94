//! The control side's watch over the state file.
//! The file may be removed, replaced, overwritten or truncated. The real-time thread stores to its pages and cannot
//! notice that. The control side finds such a loss and writes the file again from the engine's state.
//!
//! | what is done | by whom |
//! |---|---|
//! | [`StateFileWatch::lost`] | the control side, again and again |
//! | [`StateFileWatch::renew`]: the pages of a new file where those of the lost one were | the control side |
//! | `Request::StateFileLost`: everything is noted, the fault is latched | the real-time thread |
//! | [`StateFileWatch::place`]: the new file gets the name | the control side |
//!
//! A store to a page that was cut off ends a process by SIGBUS. [`StateFileWatch::outlive_truncation`] puts a page of memory
//! there instead, and the store is repeated.

use crate::journal::{
    BYTES, HEAD_WORDS, Journal, JournalError, LOST, LOST_AT, Mapping, PAGE_WORDS, TEXT_AT, beside, empty,
};
use nix::errno::Errno;
use nix::fcntl::Flock;
use std::fs::{File, Metadata};
use std::io;
use std::os::unix::fs::{FileExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// How a state file was lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StateFileLoss {
    /// No file has its name.
    Removed,
    /// Another file has its name.
    Replaced,
    /// Its size has changed.
    Resized,
    /// It does not hold the noted records.
    Overwritten,
}

/// A state file that a journal writes, seen from the control side.
#[derive(Debug)]
pub struct StateFileWatch {
    path: PathBuf,
    mapping: Arc<Mapping>,
    /// Device and inode of the file whose pages are mapped.
    mapped: (u64, u64),
    /// The words of the head, without records and times.
    head: Vec<u64>,
    /// The file of [`StateFileWatch::renew`], locked as long as it is open.
    /// `placed` tells whether it has the name.
    made: Option<Flock<File>>,
    placed: bool,
}

fn identity(file: &Metadata) -> (u64, u64) {
    (file.dev(), file.ino())
}

impl StateFileWatch {
    /// Watches over the file that `journal` writes.
    /// The file must have its name already ([`Journal::place`]).
    ///
    /// # Errors
    /// When the system does not say which file it is.
    pub fn watch(journal: &Journal) -> io::Result<Self> {
        let (mapping, file, path) = journal.shared();
        let mapped = identity(&file.metadata()?);
        let head = |n| if (HEAD_WORDS..TEXT_AT).contains(&n) || n == LOST_AT { 0 } else { mapping.load(n) };
        let head = (0..PAGE_WORDS).map(head).collect();
        Ok(Self { path: path.to_owned(), mapping, mapped, head, made: None, placed: false })
    }

    /// Path of the state file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// How the file was lost, if it is no longer the one that is written.
    pub fn lost(&self) -> Option<StateFileLoss> {
        let Ok(found) = std::fs::symlink_metadata(&self.path) else { return Some(StateFileLoss::Removed) };
        if identity(&found) != self.mapped {
            return Some(StateFileLoss::Replaced);
        }
        if found.len() != BYTES.get() as u64 || CUT_OFF.load(Ordering::Acquire) == self.mapping.base() {
            return Some(StateFileLoss::Resized);
        }
        let whole = |page| (0..4).all(|k| self.mapping.load(page + k) == self.head[k]);
        let kept = (whole(0) || whole(PAGE_WORDS)) && self.mapping.has_what_was_noted();
        (!kept).then_some(StateFileLoss::Overwritten)
    }

    /// Makes a new file beside the lost one; the journal writes to it from here on.
    /// It has only its head.
    ///
    /// # Errors
    /// When the file cannot be made.
    pub fn renew(&mut self) -> Result<(), JournalError> {
        let path = beside(&self.path);
        let here = std::fs::symlink_metadata(&path).is_ok_and(|found| identity(&found) == self.mapped);
        if self.made.is_some() && !self.placed && here {
            // The file is already made; naming it failed the last time.
            return Ok(());
        }
        let io = |source: io::Error| JournalError::Io { path: path.clone(), source };
        let file = empty(&path)?;
        let bytes: Vec<u8> = self.head.iter().flat_map(|word| word.to_le_bytes()).collect();
        for page in [0, PAGE_WORDS] {
            file.write_all_at(&bytes, (page * 8) as u64).map_err(io)?;
        }
        let made = identity(&file.metadata().map_err(io)?);
        self.mapping.replace(&file).map_err(io)?;
        self.mapped = made;
        let _ = CUT_OFF.compare_exchange(self.mapping.base(), 0, Ordering::AcqRel, Ordering::Relaxed);
        (self.made, self.placed) = (Some(file), false);
        Ok(())
    }

    /// Gives the new file the name, once everything is noted in it.
    ///
    /// # Errors
    /// When the disk refuses it, or the file that has the name cannot be replaced.
    pub fn place(&mut self) -> io::Result<()> {
        if let Some(file) = self.made.as_ref().filter(|_| !self.placed) {
            file.sync_all()?;
            std::fs::rename(beside(&self.path), &self.path)?;
            self.placed = true;
        }
        Ok(())
    }

    /// Notes that the real-time thread no longer looks at the card.
    /// Another thread that notices this calls it. The next process finds [`crate::link_messages::Fault::ThreadLost`], and
    /// asserts feed hold.
    pub fn note_thread_lost(&self) {
        for page in [0, PAGE_WORDS] {
            self.mapping.put(page + LOST_AT, LOST);
        }
    }

    /// Lets the process survive when the file is cut short.
    /// A store to a page that was cut off then goes to memory, and [`StateFileWatch::lost`] reports it. Only one file per
    /// process can be protected.
    ///
    /// # Errors
    /// When the process has such a file already, or the system gives no handler.
    pub fn outlive_truncation(&self) -> io::Result<()> {
        if GUARDED.compare_exchange(0, self.mapping.base(), Ordering::AcqRel, Ordering::Relaxed).is_err() {
            return Err(Errno::EBUSY.into());
        }
        let handler: extern "C" fn(libc::c_int, *mut libc::siginfo_t, *mut libc::c_void) = on_bus_error;
        // SAFETY: an all-zero action is valid: no flags, an empty mask.
        let mut action: libc::sigaction = unsafe { std::mem::zeroed() };
        action.sa_sigaction = handler as libc::sighandler_t;
        action.sa_flags = libc::SA_SIGINFO | libc::SA_ONSTACK;
        // SAFETY: the handler calls nothing but mmap(2) and sigaction(2), and touches nothing but atomics.
        Errno::result(unsafe { libc::sigaction(libc::SIGBUS, &raw const action, std::ptr::null_mut()) })?;
        Ok(())
    }
}

impl Drop for StateFileWatch {
    fn drop(&mut self) {
        let _ = GUARDED.compare_exchange(self.mapping.base(), 0, Ordering::AcqRel, Ordering::Relaxed);
    }
}

/// Address of the mapping that is protected; 0 where there is none.
static GUARDED: AtomicUsize = AtomicUsize::new(0);
/// Address of a mapping whose pages were cut off and replaced by memory.
/// 0 where there is none.
static CUT_OFF: AtomicUsize = AtomicUsize::new(0);

/// Handles a store to a page of the state file that was cut off.
/// Memory takes its place, and the store is repeated.
extern "C" fn on_bus_error(_signal: libc::c_int, info: *mut libc::siginfo_t, _context: *mut libc::c_void) {
    let base = GUARDED.load(Ordering::Acquire);
    // SAFETY: the kernel gives a valid siginfo_t to a handler with SA_SIGINFO; of SIGBUS it has an address.
    let at = unsafe { (*info).si_addr() } as usize;
    if base != 0 && (base..base + BYTES.get()).contains(&at) {
        let access = libc::PROT_READ | libc::PROT_WRITE;
        let flags = libc::MAP_PRIVATE | libc::MAP_ANONYMOUS | libc::MAP_FIXED;
        // SAFETY: the range is that of a mapping that lives while it is guarded, and stays mapped throughout.
        let put = unsafe { libc::mmap(base as *mut libc::c_void, BYTES.get(), access, flags, -1, 0) };
        if put != libc::MAP_FAILED {
            CUT_OFF.store(base, Ordering::Release);
            return;
        }
    }
    // The address is not in the mapping: the same access ends the process as without a handler.
    // SAFETY: an all-zero action is the default one.
    unsafe {
        let action: libc::sigaction = std::mem::zeroed();
        libc::sigaction(libc::SIGBUS, &raw const action, std::ptr::null_mut());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::journal::{AxisStateRecord, HoldAndFaultsRecord};
    use crate::link_messages::{FaultSet, FeedHoldSource};

    type Deed<'a> = (StateFileLoss, Box<dyn Fn() + 'a>);

    /// After any damage to the file in use, the next process finds all records in it.
    #[test]
    fn a_lost_file_is_told_and_written_anew() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let path = at("state");
        let axis =
            |completed| AxisStateRecord { inverters: 0, completed, faults: FaultSet::NONE, mtc_known: true };
        let held = HoldAndFaultsRecord {
            held: Some(FeedHoldSource::User(7)),
            hold_output: true,
            faults: FaultSet::NONE,
        };
        let open = || Journal::open(&path, "lost").unwrap();
        let (mut journal, _) = open();
        journal.record(0, axis(0), 1_000_000);
        journal.record_machine(HoldAndFaultsRecord { held: None, hold_output: false, ..held }, 1_000_000);
        journal.place().unwrap();
        let mut file = StateFileWatch::watch(&journal).unwrap();
        file.outlive_truncation().unwrap();
        let older = std::fs::read(&path).unwrap();
        journal.record_machine(held, 2_000_000);
        let deeds: [Deed<'_>; 7] = [
            (StateFileLoss::Removed, Box::new(|| std::fs::remove_file(&path).unwrap())),
            (StateFileLoss::Removed, Box::new(|| std::fs::rename(&path, at("away")).unwrap())),
            (StateFileLoss::Replaced, Box::new(|| std::fs::rename(at("other"), &path).unwrap())),
            (
                StateFileLoss::Resized,
                Box::new(|| File::options().write(true).open(&path).unwrap().set_len(0).unwrap()),
            ),
            (
                StateFileLoss::Resized,
                Box::new(|| File::options().write(true).open(&path).unwrap().set_len(4096).unwrap()),
            ),
            (StateFileLoss::Overwritten, Box::new(|| std::fs::write(&path, &older).unwrap())),
            (StateFileLoss::Overwritten, Box::new(|| std::fs::write(&path, vec![0; BYTES.get()]).unwrap())),
        ];
        for (n, (lost, deed)) in deeds.iter().enumerate() {
            std::fs::write(at("other"), &older).unwrap();
            assert_eq!(file.lost(), None, "{n}");
            deed();
            assert_eq!(file.lost(), Some(*lost), "{n}");
            // A store in the meantime does not end the process.
            let total = 2 * n as i64 + 2;
            journal.record(0, axis(total), 3_000_000);
            assert!(file.lost().is_some(), "{n}");
            file.renew().unwrap();
            journal.note_again();
            // Again, as after a failure to name the file.
            file.renew().unwrap();
            journal.record(0, axis(total + 1), 3_000_000);
            file.place().unwrap();
            assert_eq!(file.lost(), None, "{n}");
            assert!(matches!(Journal::open(&path, "lost"), Err(JournalError::Taken { .. })), "{n}");
            let copy = at("copy");
            std::fs::copy(&path, &copy).unwrap();
            let (_, before) = Journal::open(&copy, "lost").unwrap();
            assert_eq!(before.records[0], [Some(axis(total + 1)), Some(axis(total))], "{n}");
            assert_eq!((before.machine, before.times.held_ns()), (Some(held), Some(2_000_000)), "{n}");
            assert!(!before.hold_unexplained() && !before.damaged[0] && !before.other_boot, "{n}");
        }
        drop((journal, file));
        assert_eq!(open().1.machine, Some(held));
    }
}
