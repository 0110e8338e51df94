//! What must survive a crash of the process: each axis's inverters and completed total, in a mapped file.
//!
//! The engine writes a record *before* it inverts anything, alternating between two slots per axis. After a crash one
//! of the two records agrees with the inverters as they are read back, and holds what was completed; if none does, the
//! axis is at fault. Writing is a few stores to memory: no system call in the loop. Put the file on a tmpfs (`/run`),
//! where the kernel never makes a page read-only to write it back; it is worthless after a power cut anyway, because
//! the inverters are.

use crate::event::MAX_AXES;
use nix::fcntl::posix_fallocate;
use nix::sys::mman::{MapFlags, ProtFlags, mmap, munmap};
use std::fs::File;
use std::io;
use std::num::NonZeroUsize;
use std::path::Path;
use std::ptr::NonNull;
use std::sync::atomic::{AtomicU64, Ordering};

const MAGIC: u64 = u64::from_le_bytes(*b"RTECJ\0\0\x01");
/// Sequence number, inverters, completed, check sum.
const SLOT_WORDS: usize = 4;
const AXIS_WORDS: usize = 2 * SLOT_WORDS;
const WORDS: usize = 8 + MAX_AXES * AXIS_WORDS;
const BYTES: NonZeroUsize = NonZeroUsize::new(WORDS * 8).unwrap();

/// What an axis had in effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StateRecord {
    /// Bit 0: A inverted, bit 1: B inverted.
    pub inverters: u8,
    /// What is in the MTC's count, counts: the completed total, or an odd number halfway through an insertion.
    pub completed: i64,
}

/// The mapped file.
#[derive(Debug)]
pub struct Journal {
    words: NonNull<AtomicU64>,
    next: [u64; MAX_AXES],
    last: [Option<StateRecord>; MAX_AXES],
}

// SAFETY: the mapping belongs to this value alone and is accessed as atomics only.
unsafe impl Send for Journal {}

fn check(seq: u64, inverters: u64, completed: u64) -> u64 {
    // A torn or foreign record must not pass: every bit of every word reaches every bit of the sum.
    let mut sum = MAGIC;
    for word in [seq, inverters, completed] {
        sum = (sum ^ word).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        sum ^= sum >> 29;
    }
    sum
}

impl Journal {
    /// Opens or creates the file. Returns the journal and, per axis, the valid records found in it, newest first.
    ///
    /// # Errors
    /// When the file cannot be opened, sized or mapped, or is something else.
    pub fn open(path: &Path) -> io::Result<(Self, [[Option<StateRecord>; 2]; MAX_AXES])> {
        let file = File::options().read(true).write(true).create(true).truncate(false).open(path)?;
        let len = file.metadata()?.len();
        if len != 0 && len != BYTES.get() as u64 {
            return Err(io::Error::new(
                io::ErrorKind::InvalidData,
                format!("{}: found {len} bytes, expected {BYTES}; is this another file?", path.display()),
            ));
        }
        // Its blocks are taken now: with a disk that is full by then, the first store to the mapping would kill us.
        posix_fallocate(&file, 0, BYTES.get() as i64)?;
        // SAFETY: a new shared mapping at an address of the kernel's choice disturbs no other memory of the process.
        let base = unsafe {
            mmap(None, BYTES, ProtFlags::PROT_READ | ProtFlags::PROT_WRITE, MapFlags::MAP_SHARED, &file, 0)
        }?;
        let mut journal = Self { words: base.cast(), next: [1; MAX_AXES], last: [None; MAX_AXES] };
        let magic = journal.word(0).load(Ordering::Acquire);
        if magic != 0 && magic != MAGIC {
            return Err(io::Error::new(
                io::ErrorKind::InvalidData,
                format!("{}: not a journal of this program's version", path.display()),
            ));
        }
        let mut found = [[None; 2]; MAX_AXES];
        for (axis, found) in found.iter_mut().enumerate() {
            let mut slots = [journal.slot(axis, 0), journal.slot(axis, 1)];
            slots.sort_by_key(|s| std::cmp::Reverse(s.map(|(seq, _)| seq)));
            journal.next[axis] = slots[0].map_or(1, |(seq, _)| seq + 1);
            *found = slots.map(|s| s.map(|(_, record)| record));
        }
        journal.word(0).store(MAGIC, Ordering::Release);
        Ok((journal, found))
    }

    fn word(&self, n: usize) -> &AtomicU64 {
        assert!(n < WORDS);
        // SAFETY: the mapping holds `WORDS` aligned words and lives as long as `self`; every bit pattern is valid.
        unsafe { self.words.add(n).as_ref() }
    }

    fn slot(&self, axis: usize, n: usize) -> Option<(u64, StateRecord)> {
        let at = 8 + axis * AXIS_WORDS + n * SLOT_WORDS;
        let [seq, inverters, completed, sum] =
            [0, 1, 2, 3].map(|k| self.word(at + k).load(Ordering::Acquire));
        let valid = seq != 0 && sum == check(seq, inverters, completed) && inverters < 4;
        valid.then_some((seq, StateRecord { inverters: inverters as u8, completed: completed as i64 }))
    }

    /// Notes what an axis will have in effect once the write that follows is made. No system call.
    #[inline]
    pub fn record(&mut self, axis: usize, record: StateRecord) {
        if self.last[axis] == Some(record) {
            return;
        }
        self.last[axis] = Some(record);
        let seq = self.next[axis];
        self.next[axis] = seq + 1;
        let at = 8 + axis * AXIS_WORDS + (seq & 1) as usize * SLOT_WORDS;
        let (inverters, completed) = (u64::from(record.inverters), record.completed as u64);
        // A record cut short fails its check sum; the one before it is in the other slot.
        self.word(at + 3).store(0, Ordering::Release);
        self.word(at).store(seq, Ordering::Release);
        self.word(at + 1).store(inverters, Ordering::Release);
        self.word(at + 2).store(completed, Ordering::Release);
        self.word(at + 3).store(check(seq, inverters, completed), Ordering::Release);
    }
}

impl Drop for Journal {
    fn drop(&mut self) {
        // SAFETY: base and length are those of the mapping made in `open`, and nothing refers to it any more.
        let _ = unsafe { munmap(self.words.cast(), BYTES.get()) };
    }
}

/// What was completed, by the records found and the inverters as they are read back: the newest record that agrees.
#[must_use]
pub fn resume(found: [Option<StateRecord>; 2], inverters: u8) -> Option<i64> {
    found.into_iter().flatten().find(|r| r.inverters == inverters).map(|r| r.completed)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn open(file: &tempfile::NamedTempFile) -> [Option<StateRecord>; 2] {
        Journal::open(file.path()).unwrap().1[2]
    }

    #[test]
    fn the_record_before_the_write_is_found_beside_the_newest() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let records = [(0, 0), (1, 0), (3, 2), (2, 2), (0, 4)]
            .map(|(inverters, completed)| StateRecord { inverters, completed });
        let (mut journal, found) = Journal::open(file.path()).unwrap();
        assert_eq!(found, [[None; 2]; MAX_AXES]);
        for pair in records.windows(2) {
            journal.record(2, pair[0]);
            journal.record(2, pair[1]);
            let found = open(&file);
            assert_eq!(found, [Some(pair[1]), Some(pair[0])]);
            // Killed before or after the write: the inverters decide which.
            assert_eq!(resume(found, pair[0].inverters), Some(pair[0].completed));
            assert_eq!(resume(found, pair[1].inverters), Some(pair[1].completed));
        }
    }

    #[test]
    fn a_torn_record_is_not_believed() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let (mut journal, _) = Journal::open(file.path()).unwrap();
        journal.record(2, StateRecord { inverters: 0, completed: 10 });
        journal.record(2, StateRecord { inverters: 3, completed: 12 });
        for word in 0..SLOT_WORDS {
            let at = 8 + 2 * AXIS_WORDS + word;
            let kept = journal.word(at).swap(77, Ordering::AcqRel);
            assert_eq!(open(&file), [Some(StateRecord { inverters: 0, completed: 10 }), None]);
            journal.word(at).store(kept, Ordering::Release);
        }
        assert_eq!(resume(open(&file), 1), None);
    }

    #[test]
    fn another_file_is_refused_and_left_alone() {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), b"hello").unwrap();
        assert!(Journal::open(file.path()).unwrap_err().to_string().contains("found 5 bytes"));
        assert_eq!(std::fs::read(file.path()).unwrap(), b"hello");
    }
}
