//! What must survive a crash of the process: each axis's inverters, completed total and latched faults, in a mapped file.
//!
//! The engine writes a record *before* it inverts anything, alternating between two slots per axis. After a crash one
//! of the two records agrees with the inverters as they are read back, and holds what was completed; if none does, the
//! axis is at fault. Writing is a few stores to memory: no system call in the loop. Put the file on a tmpfs (`/run`),
//! where the kernel never makes a page read-only to write it back; it is worthless after a power cut anyway, because
//! the inverters are.
//!
//! | page | what |
//! |---|---|
//! | 1 | head (magic, whose file it is), then the axes' slots |
//! | 2 | the same once more: a record is lost only when both copies are |
//!
//! The file belongs to one machine on one card with one wiring, and to one process at a time (`flock(2)`). A file that is
//! there and has no record of an axis is no first start: whoever opens it must latch that axis.

use crate::event::{Faults, MAX_AXES};
use nix::errno::Errno;
use nix::fcntl::{Flock, FlockArg, OFlag, posix_fallocate};
use nix::sys::mman::{MapFlags, ProtFlags, mmap, munmap};
use std::fs::File;
use std::io;
use std::num::NonZeroUsize;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::ptr::NonNull;
use std::sync::atomic::{AtomicU64, Ordering};

const MAGIC: u64 = u64::from_le_bytes(*b"RTECJ\0\0\x02");
/// Sequence number, inverters and faults, completed, check sum.
const SLOT_WORDS: usize = 4;
const AXIS_WORDS: usize = 2 * SLOT_WORDS;
/// Sequence numbers are below: nobody writes so many, and there is room to count on from any.
const ROOM: u64 = 1 << 63;
/// Magic, hash of the identity, its length, check sum.
const HEAD_WORDS: usize = 8;
/// Where the identity's text begins, and how much of it is kept for messages.
const TEXT_AT: usize = 64;
const PAGE_WORDS: usize = 512;
const TEXT_BYTES: usize = (PAGE_WORDS - TEXT_AT) * 8;
const COPIES: usize = 2;
const BYTES: NonZeroUsize = NonZeroUsize::new(COPIES * PAGE_WORDS * 8).unwrap();
const _: () = assert!(HEAD_WORDS + MAX_AXES * AXIS_WORDS <= TEXT_AT);

/// What an axis had in effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StateRecord {
    /// Bit 0: A inverted, bit 1: B inverted.
    pub inverters: u8,
    /// What is in the MTC's count, counts: the completed total, or an odd number halfway through an insertion.
    pub completed: i64,
    /// Why that is in doubt: a restart is no way round a latched fault.
    pub faults: Faults,
}

impl StateRecord {
    /// Inverters and faults in one word of the file.
    fn flags(self) -> u64 {
        u64::from(self.inverters) | u64::from(self.faults.bits()) << 8
    }

    fn of(flags: u64, completed: u64) -> Option<Self> {
        let inverters = (flags & 0xFF) as u8;
        let faults = Faults::from_bits(u32::try_from(flags >> 8).ok()?)?;
        (inverters < 4).then_some(Self { inverters, completed: completed as i64, faults })
    }
}

/// What a file had to say when it was opened.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Before {
    /// There was no file: a first start, at which no record can be missing.
    pub first_start: bool,
    /// Per axis, the valid records, newest first.
    pub records: [[Option<StateRecord>; 2]; MAX_AXES],
}

impl Before {
    /// As without a file.
    pub const NOTHING: Self = Self { first_start: true, records: [[None; 2]; MAX_AXES] };
}

/// Why a state file cannot be used. Each leaves it as it was.
#[derive(Debug, thiserror::Error)]
pub enum JournalError {
    /// It cannot be opened, sized or mapped.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// Another process works with it.
    #[error("{}: another rtecd works with it; expected one daemon per state file ([control] state_file)", path.display())]
    Taken {
        /// The file.
        path: PathBuf,
    },
    /// It is no state file, or one of another version.
    #[error(
        "{}: found {found}, expected a state file of this version; with the MTC off and all inverters off remove it, start \
         again and home", path.display()
    )]
    Foreign {
        /// The file.
        path: PathBuf,
        /// What it is instead.
        found: String,
    },
    /// It is the state of another machine, card or wiring.
    #[error(
        "{}: it belongs to {theirs}, and this is {ours}; a machine needs a state file of its own ([control] state_file). If \
         this one has really become that: with the MTC off and all inverters off remove it, start again and home",
        path.display()
    )]
    Other {
        /// The file.
        path: PathBuf,
        /// Whose it is.
        theirs: String,
        /// Who we are.
        ours: String,
    },
}

/// The mapped file.
#[derive(Debug)]
pub struct Journal {
    words: NonNull<AtomicU64>,
    next: [u64; MAX_AXES],
    last: [Option<StateRecord>; MAX_AXES],
    /// The file is new, and no axis has a record yet.
    empty: bool,
    /// The lock is ours as long as this is open.
    held: Flock<File>,
}

// SAFETY: the mapping belongs to this value alone and is accessed as atomics only.
unsafe impl Send for Journal {}

/// A torn or foreign record must not pass: every bit of every word reaches every bit of the sum.
fn check(words: &[u64]) -> u64 {
    // No word that is written: zeros behind the magic must not sum up to zero.
    let mut sum = !MAGIC;
    for word in words {
        sum = (sum ^ word).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        sum ^= sum >> 29;
    }
    sum
}

/// A text as words, filled up with zeros.
fn words_of(text: &[u8]) -> impl Iterator<Item = u64> {
    text.chunks(8).map(|chunk| {
        let mut word = [0; 8];
        word[..chunk.len()].copy_from_slice(chunk);
        u64::from_le_bytes(word)
    })
}

impl Journal {
    /// Opens or creates the file of `identity`, a text that names machine, card and lines. Returns the journal and what
    /// was found in it.
    ///
    /// # Errors
    /// When the file cannot be opened, sized or mapped, is locked, is something else, or is somebody else's.
    pub fn open(path: &Path, identity: &str) -> Result<(Self, Before), JournalError> {
        let io = |source: io::Error| JournalError::Io { path: path.to_owned(), source };
        let mut options = File::options();
        options.read(true).write(true).create(true).truncate(false).mode(0o600);
        let file =
            options.custom_flags((OFlag::O_NOFOLLOW | OFlag::O_NONBLOCK).bits()).open(path).map_err(io)?;
        if !file.metadata().map_err(io)?.is_file() {
            let found = "something that is no regular file".to_owned();
            return Err(JournalError::Foreign { path: path.to_owned(), found });
        }
        let held = Flock::lock(file, FlockArg::LockExclusiveNonblock).map_err(|(_, errno)| match errno {
            Errno::EWOULDBLOCK => JournalError::Taken { path: path.to_owned() },
            errno => io(errno.into()),
        })?;
        let len = held.metadata().map_err(io)?.len();
        if len != 0 && len != BYTES.get() as u64 {
            let found = format!("{len} bytes instead of {BYTES}");
            return Err(JournalError::Foreign { path: path.to_owned(), found });
        }
        // Its blocks are taken now: with a disk that is full by then, the first store to the mapping would kill us.
        posix_fallocate(&*held, 0, BYTES.get() as i64).map_err(|e| io(e.into()))?;
        // SAFETY: a new shared mapping at an address of the kernel's choice disturbs no other memory of the process.
        let base = unsafe {
            mmap(None, BYTES, ProtFlags::PROT_READ | ProtFlags::PROT_WRITE, MapFlags::MAP_SHARED, &*held, 0)
        }
        .map_err(|e| io(e.into()))?;
        // From here on a mistake unmaps it.
        let first_start = len == 0;
        let words = base.cast();
        let mut journal =
            Self { words, next: [1; MAX_AXES], last: [None; MAX_AXES], empty: first_start, held };
        if !first_start {
            journal.is_ours(path, identity)?;
        }
        let mut records = [[None; 2]; MAX_AXES];
        for (axis, found) in records.iter_mut().enumerate() {
            let mut slots = [journal.slot(axis, 0), journal.slot(axis, 1)];
            slots.sort_by_key(|s| std::cmp::Reverse(s.map(|(seq, _)| seq)));
            journal.next[axis] = slots[0].map_or(1, |(seq, _)| seq + 1);
            *found = slots.map(|s| s.map(|(_, record)| record));
        }
        journal.write_head(identity);
        Ok((journal, Before { first_start, records }))
    }

    fn word(&self, n: usize) -> &AtomicU64 {
        assert!(n < COPIES * PAGE_WORDS);
        // SAFETY: the mapping holds so many aligned words and lives as long as `self`; every bit pattern is valid.
        unsafe { self.words.add(n).as_ref() }
    }

    fn load(&self, n: usize) -> u64 {
        self.word(n).load(Ordering::Acquire)
    }

    /// Refuses the file of another version or of somebody else. A head that both copies have lost says nothing: the
    /// records are judged then.
    fn is_ours(&self, path: &Path, identity: &str) -> Result<(), JournalError> {
        for page in [0, PAGE_WORDS] {
            let [magic, hash, bytes, sum] = [0, 1, 2, 3].map(|k| self.load(page + k));
            if magic & 0xFF_FFFF_FFFF == MAGIC & 0xFF_FFFF_FFFF && magic != MAGIC {
                let found = format!("version {} of it", magic >> 56);
                return Err(JournalError::Foreign { path: path.to_owned(), found });
            }
            if magic != MAGIC || sum != check(&[magic, hash, bytes]) {
                continue;
            }
            if hash == hash_of(identity) {
                return Ok(());
            }
            let len = usize::try_from(bytes).unwrap_or(usize::MAX).min(TEXT_BYTES);
            let mut text: Vec<u8> =
                (0..len.div_ceil(8)).flat_map(|k| self.load(page + TEXT_AT + k).to_le_bytes()).collect();
            text.truncate(len);
            let theirs = String::from_utf8_lossy(&text).replace(|c: char| c.is_control(), " ");
            return Err(JournalError::Other { path: path.to_owned(), theirs, ours: identity.to_owned() });
        }
        let zero = (0..COPIES * PAGE_WORDS).all(|n| self.load(n) == 0);
        let a_record = (0..MAX_AXES).any(|axis| (0..2).any(|n| self.slot(axis, n).is_some()));
        if zero || a_record {
            return Ok(());
        }
        let found = "something else of the same size".to_owned();
        Err(JournalError::Foreign { path: path.to_owned(), found })
    }

    fn write_head(&self, identity: &str) {
        let text = identity.as_bytes();
        let (hash, bytes) = (hash_of(identity), text.len() as u64);
        for page in [0, PAGE_WORDS] {
            for (k, word) in words_of(&text[..text.len().min(TEXT_BYTES)]).enumerate() {
                self.word(page + TEXT_AT + k).store(word, Ordering::Release);
            }
            for (k, word) in [MAGIC, hash, bytes, check(&[MAGIC, hash, bytes])].into_iter().enumerate() {
                self.word(page + k).store(word, Ordering::Release);
            }
        }
    }

    /// The record of a slot, from whichever copy is whole; of two the newer.
    fn slot(&self, axis: usize, n: usize) -> Option<(u64, StateRecord)> {
        let copies = [0, PAGE_WORDS].map(|page| {
            let at = page + HEAD_WORDS + axis * AXIS_WORDS + n * SLOT_WORDS;
            let [seq, flags, completed, sum] = [0, 1, 2, 3].map(|k| self.load(at + k));
            let valid = (1..ROOM).contains(&seq) && sum == check(&[seq, flags, completed]);
            StateRecord::of(flags, completed).filter(|_| valid).map(|record| (seq, record))
        });
        copies.into_iter().flatten().max_by_key(|(seq, _)| *seq)
    }

    /// Notes what an axis will have in effect once the write that follows is made. No system call.
    #[inline]
    pub fn record(&mut self, axis: usize, record: StateRecord) {
        if self.last[axis] == Some(record) {
            return;
        }
        self.last[axis] = Some(record);
        self.empty = false;
        let seq = self.next[axis];
        self.next[axis] = seq + 1;
        let (flags, completed) = (record.flags(), record.completed as u64);
        let sum = check(&[seq, flags, completed]);
        for page in [0, PAGE_WORDS] {
            let at = page + HEAD_WORDS + axis * AXIS_WORDS + (seq & 1) as usize * SLOT_WORDS;
            // A record cut short fails its check sum; the one before it is in the other slot.
            self.word(at + 3).store(0, Ordering::Release);
            self.word(at).store(seq, Ordering::Release);
            self.word(at + 1).store(flags, Ordering::Release);
            self.word(at + 2).store(completed, Ordering::Release);
            self.word(at + 3).store(sum, Ordering::Release);
        }
    }
}

fn hash_of(identity: &str) -> u64 {
    let words: Vec<u64> =
        words_of(identity.as_bytes()).chain(std::iter::once(identity.len() as u64)).collect();
    check(&words)
}

impl Drop for Journal {
    fn drop(&mut self) {
        // SAFETY: base and length are those of the mapping made in `open`, and nothing refers to it any more.
        let _ = unsafe { munmap(self.words.cast(), BYTES.get()) };
        if self.empty {
            // A start that came to nothing: the next one is the first again.
            let _ = self.held.set_len(0);
        }
    }
}

/// What was completed and latched, by the records found and the inverters as they are read back: the newest record that
/// agrees.
#[must_use]
pub fn resume(found: [Option<StateRecord>; 2], inverters: u8) -> Option<StateRecord> {
    found.into_iter().flatten().find(|r| r.inverters == inverters)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::FileExt;

    const OURS: &str = "machine \"lathe 7\" on card mapped";
    const AT: u64 = (HEAD_WORDS as u64 + 2 * AXIS_WORDS as u64) * 8;

    fn new() -> (tempfile::TempDir, PathBuf) {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("state");
        (directory, path)
    }

    fn record(inverters: u8, completed: i64) -> StateRecord {
        StateRecord { inverters, completed, faults: Faults::NONE }
    }

    fn found(path: &Path) -> [Option<StateRecord>; 2] {
        let (_, before) = Journal::open(path, OURS).unwrap();
        assert!(!before.first_start);
        before.records[2]
    }

    fn zero(path: &Path, at: u64, bytes: usize) {
        File::options().write(true).open(path).unwrap().write_all_at(&vec![0; bytes], at).unwrap();
    }

    #[test]
    fn the_record_before_the_write_is_found_beside_the_newest() {
        let (_directory, path) = new();
        let records = [(0, 0), (1, 0), (3, 2), (2, 2), (0, 4)]
            .map(|(inverters, completed)| record(inverters, completed));
        assert_eq!(Journal::open(&path, OURS).unwrap().1, Before::NOTHING);
        for pair in records.windows(2) {
            let mut journal = Journal::open(&path, OURS).unwrap().0;
            journal.record(2, pair[0]);
            journal.record(2, pair[1]);
            drop(journal);
            let found = found(&path);
            assert_eq!(found, [Some(pair[1]), Some(pair[0])]);
            // Killed before or after the write: the inverters decide which.
            assert_eq!(resume(found, pair[0].inverters), Some(pair[0]));
            assert_eq!(resume(found, pair[1].inverters), Some(pair[1]));
        }
    }

    #[test]
    fn what_is_latched_is_found_and_what_nobody_knows_is_no_record() {
        let (_directory, path) = new();
        let mut faults = Faults::NONE;
        assert!(
            faults.latch(crate::event::Fault::PollGap) && faults.latch(crate::event::Fault::OrderUnknown)
        );
        let latched = StateRecord { faults, ..record(3, 8) };
        let mut journal = Journal::open(&path, OURS).unwrap().0;
        journal.record(2, record(3, 8));
        journal.record(2, latched);
        drop(journal);
        assert_eq!(resume(found(&path), 3), Some(latched));
        assert_eq!(StateRecord::of(latched.flags() | 1 << 39, 8), None);
        assert_eq!(StateRecord::of(latched.flags() | 1 << 40, 8), None);
        assert_eq!(StateRecord::of(4, 8), None);
    }

    #[test]
    fn a_torn_record_is_not_believed() {
        let (_directory, path) = new();
        let mut journal = Journal::open(&path, OURS).unwrap().0;
        journal.record(2, record(0, 10));
        journal.record(2, record(3, 12));
        drop(journal);
        let file = File::options().read(true).write(true).open(&path).unwrap();
        for word in 0..SLOT_WORDS as u64 {
            let places = [AT + 8 * word, AT + 8 * word + 8 * PAGE_WORDS as u64];
            let mut kept = [0; 8];
            file.read_exact_at(&mut kept, places[0]).unwrap();
            let put = |word: &[u8; 8]| places.map(|at| file.write_all_at(word, at).unwrap()).len();
            assert_eq!(put(&77_u64.to_le_bytes()), COPIES);
            assert_eq!(found(&path), [Some(record(0, 10)), None]);
            assert_eq!(put(&kept), COPIES);
        }
        assert_eq!(resume(found(&path), 1), None);
    }

    /// Found by a fuzz target: a number that cannot be counted on from, with its right sum.
    #[test]
    fn a_record_of_the_last_number_there_is_is_not_believed() {
        let (_directory, path) = new();
        let older = record(0, 10);
        let mut journal = Journal::open(&path, OURS).unwrap().0;
        journal.record(2, older);
        journal.record(2, record(3, 12));
        drop(journal);
        let file = File::options().read(true).write(true).open(&path).unwrap();
        for seq in [u64::MAX, u64::MAX - 1, ROOM] {
            for (word, value) in [seq, 3, 12, check(&[seq, 3, 12])].iter().enumerate() {
                for copy in 0..COPIES as u64 {
                    let at = AT + 8 * (word as u64 + PAGE_WORDS as u64 * copy);
                    file.write_all_at(&value.to_le_bytes(), at).unwrap();
                }
            }
            assert_eq!(found(&path), [Some(older), None]);
        }
        let mut journal = Journal::open(&path, OURS).unwrap().0;
        journal.record(2, record(1, 11));
        journal.record(2, record(3, 12));
        drop(journal);
        assert_eq!(found(&path)[0], Some(record(3, 12)));
    }

    #[test]
    fn sixty_four_lost_bytes_lose_no_record_wherever_they_are() {
        let (_directory, path) = new();
        let newest = record(3, 14);
        let mut journal = Journal::open(&path, OURS).unwrap().0;
        journal.record(2, record(0, 12));
        journal.record(2, newest);
        drop(journal);
        let whole = std::fs::read(&path).unwrap();
        for at in (0..whole.len() - 63).step_by(8) {
            std::fs::write(&path, &whole).unwrap();
            zero(&path, at as u64, 64);
            assert_eq!(found(&path)[0], Some(newest), "at {at}");
        }
        // In both copies: nothing is known, and it is no first start.
        zero(&path, AT, 64);
        zero(&path, AT + 8 * PAGE_WORDS as u64, 64);
        assert_eq!(found(&path), [None, None]);
        zero(&path, 0, BYTES.get());
        assert_eq!(found(&path), [None, None]);
    }

    /// The next version has to read what this one wrote: the sum as it was worked out by another hand.
    #[test]
    fn the_check_sum_stays_what_it_is() {
        assert_eq!(check(&[]), 0xFDFF_FFB5_BCBA_ABAD);
        assert_eq!(check(&[1, 3, 2]), 0x9714_1578_D3EE_0E6D);
        assert_eq!(check(&[u64::MAX, 0x103, u64::MAX - 1]), 0xA73A_743B_AC0D_C4B3);
    }

    #[test]
    fn a_later_opening_counts_on_and_keeps_the_newest_record_before_it() {
        let (_directory, path) = new();
        let (a, b, c, d) = (record(0, 2), record(1, 3), record(3, 4), record(2, 5));
        let mut journal = Journal::open(&path, OURS).unwrap().0;
        for noted in [a, b, c] {
            journal.record(2, noted);
        }
        drop(journal);
        assert_eq!(found(&path), [Some(c), Some(b)]);
        let mut journal = Journal::open(&path, OURS).unwrap().0;
        journal.record(2, d);
        drop(journal);
        assert_eq!(found(&path), [Some(d), Some(c)]);
    }

    #[test]
    fn another_file_is_refused_and_left_alone() {
        let (_directory, path) = new();
        let noise = vec![0x5A; BYTES.get()];
        let mut last = vec![0; BYTES.get()];
        last[BYTES.get() - 1] = 1;
        let mut older = vec![0; BYTES.get()];
        older[..8].copy_from_slice(b"RTECJ\0\0\x01");
        for (content, wants) in [
            (b"hello".to_vec(), "found 5 bytes"),
            (noise, "something else"),
            (last, "something else"),
            (older, "version 1"),
        ] {
            std::fs::write(&path, &content).unwrap();
            let error = Journal::open(&path, OURS).unwrap_err().to_string();
            assert!(error.contains(wants) && error.contains("expected a state file"), "{error}");
            assert_eq!(std::fs::read(&path).unwrap(), content);
        }
        let link = path.with_file_name("link");
        std::os::unix::fs::symlink(&path, &link).unwrap();
        assert!(matches!(Journal::open(&link, OURS), Err(JournalError::Io { .. })), "a link is not followed");
    }

    #[test]
    fn one_process_at_a_time_and_one_machine() {
        let (_directory, path) = new();
        let first = Journal::open(&path, OURS).unwrap().0;
        assert!(matches!(Journal::open(&path, OURS), Err(JournalError::Taken { .. })));
        drop(first);
        assert_eq!(Journal::open(&path, OURS).unwrap().1, Before::NOTHING, "nothing had been noted");
        let mut ours = Journal::open(&path, OURS).unwrap().0;
        ours.record(0, record(0, 0));
        drop(ours);
        let error = Journal::open(&path, "machine \"mill 2\"").unwrap_err().to_string();
        assert!(
            error.contains("belongs to machine \"lathe 7\" on card mapped, and this is machine \"mill 2\""),
            "{error}"
        );
        assert!(Journal::open(&path, OURS).is_ok());
        // One name that begins as the other.
        assert!(matches!(Journal::open(&path, &OURS[..8]), Err(JournalError::Other { .. })));
    }

    #[test]
    fn every_axis_has_two_records_of_its_own() {
        let (_directory, path) = new();
        let noted = |axis: usize, n: i64| record(1, 100 * axis as i64 + 2 * n);
        let mut ours = Journal::open(&path, OURS).unwrap().0;
        (1..=2).for_each(|n| (0..MAX_AXES).for_each(|axis| ours.record(axis, noted(axis, n))));
        drop(ours);
        let before = Journal::open(&path, OURS).unwrap().1;
        for (axis, found) in before.records.iter().enumerate() {
            assert_eq!(*found, [Some(noted(axis, 2)), Some(noted(axis, 1))], "axis {axis}");
        }
    }

    /// An identity that is longer than the file has room for is told from another all the same, and named as far as there is room.
    #[test]
    fn of_a_long_identity_is_kept_what_there_is_room_for() {
        let (_directory, path) = new();
        let long: String = (0..5000_u32).map(|k| char::from(b'a' + (k % 23) as u8)).collect();
        let mut ours = Journal::open(&path, &long).unwrap().0;
        ours.record(5, record(0, 8));
        drop(ours);
        assert_eq!(Journal::open(&path, &long).unwrap().1.records[5], [Some(record(0, 8)), None]);
        match Journal::open(&path, &(long[..4999].to_owned() + "!")) {
            Err(JournalError::Other { theirs, .. }) => assert_eq!(theirs, long[..3584]),
            other => panic!("{other:?}"),
        }
    }
}
