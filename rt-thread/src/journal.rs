//! The state that must survive a crash of the process, in a mapped file.
//! For each axis it is inverters, completed total, latched faults and whether the MTC's count is known. For the machine
//! it is feed hold, who asked for it, and the time of each fault.
//!
//! The engine writes a record *before* it inverts anything, alternating between two slots per axis. After a crash one
//! of the two records agrees with the inverters as they are read back, and holds what was completed. If neither
//! agrees, the axis gets a fault. Writing is a few stores to memory, so the loop makes no system call. Put the file
//! on a tmpfs (`/run`), where the kernel never makes a page read-only to write it back. A file on a disk survives a
//! power cut, but the MTC's count does not. The file therefore says in which boot of the computer it was written.
//! After another boot the count is unknown.
//!
//! | page | what |
//! |---|---|
//! | 1 | head (magic, whose file it is), the axes' slots, the machine's slots, the times of faults |
//! | 2 | the same once more: a record is lost only when both copies are |
//!
//! A file of version 2 can be read. It has no machine's slots and no times, and does not say whether the MTC was homed.
//!
//! The file belongs to one machine on one card with one wiring, and to one process at a time (`flock(2)`). If an
//! existing file lacks the record of an axis, that is no first start, and the caller must latch that axis. A first
//! start therefore writes a file without the name. It gives it the name once every record is in it
//! ([`Journal::place`]).

use crate::link_messages::{Fault, FaultSet, FeedHoldSource, MAX_AXES};
use nix::errno::Errno;
use nix::fcntl::{AT_FDCWD, Flock, FlockArg, OFlag, RenameFlags, posix_fallocate, renameat2};
use nix::sys::mman::{MapFlags, ProtFlags, mmap, munmap};
use std::fs::File;
use std::io;
use std::num::NonZeroUsize;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::ptr::NonNull;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

const MAGIC: u64 = u64::from_le_bytes(*b"RTECJ\0\0\x03");
/// Magic of the version before, which can be read.
const MAGIC_2: u64 = u64::from_le_bytes(*b"RTECJ\0\0\x02");
/// Sequence number, flags, completed or user, check sum.
const SLOT_WORDS: usize = 4;
const AXIS_WORDS: usize = 2 * SLOT_WORDS;
/// Sequence numbers must be below this, so that counting on never overflows.
const ROOM: u64 = 1 << 63;
/// Magic, hash of the identity, its length, check sum.
pub(crate) const HEAD_WORDS: usize = 8;
/// Row of the machine's slots, behind those of the axes.
const MACHINE: usize = MAX_AXES;
const ROWS: usize = MAX_AXES + 1;
/// Word at which the times begin: a row for each axis and one for the machine.
/// A row has a time for each fault. The machine's row ends with the time of feed hold.
const TIMES_AT: usize = 64;
const ROW_WORDS: usize = 32;
const HOLD_AT: usize = ROW_WORDS - 1;
const _: () = assert!(Fault::ALL.len() <= HOLD_AT);
/// Word at which the identity's text begins, which is kept for messages.
/// A long one is cut off at the end of the page.
pub(crate) const TEXT_AT: usize = 320;
const TEXT_AT_2: usize = 64;
pub(crate) const PAGE_WORDS: usize = 512;
const TEXT_BYTES: usize = (PAGE_WORDS - TEXT_AT) * 8;
const COPIES: usize = 2;
const ACCESS: ProtFlags = ProtFlags::PROT_READ.union(ProtFlags::PROT_WRITE);
pub(crate) const BYTES: NonZeroUsize = NonZeroUsize::new(COPIES * PAGE_WORDS * 8).unwrap();
const _: () = assert!(HEAD_WORDS + ROWS * AXIS_WORDS <= TIMES_AT && TIMES_AT + ROWS * ROW_WORDS <= TEXT_AT);
/// The head's word for a lost real-time thread, and its value then.
pub(crate) const LOST_AT: usize = 4;
pub(crate) const LOST: u64 = u64::from_le_bytes(*b"RTECLOST");
/// The head's words for the boot of the computer: its hash and a check sum.
/// The file was written in that boot.
const BOOT_AT: usize = 5;
const BOOT_FILE: &str = "/proc/sys/kernel/random/boot_id";
const _: () = assert!(LOST_AT < BOOT_AT && BOOT_AT + 2 <= HEAD_WORDS);
/// A time of the card's clock is in the upper bits of its word, in µs.
/// Its check sum is in the lower bits.
const TIME_SHIFT: u32 = 16;

#[cfg(test)]
thread_local! {
    /// Stores of this thread to files, in order: the word's number and its value.
    pub(crate) static STORES: std::cell::RefCell<Vec<(usize, u64)>> = const { std::cell::RefCell::new(Vec::new()) };
}

/// State of an axis that was in effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AxisStateRecord {
    /// Bit 0: A inverted, bit 1: B inverted.
    pub inverters: u8,
    /// Counts inserted into the MTC's count.
    /// It is the completed total, or an odd number halfway through an insertion.
    pub completed: i64,
    /// Latched faults, which a restart must not clear.
    pub faults: FaultSet,
    /// The MTC has been homed, and nothing has put its count in doubt since.
    pub mtc_known: bool,
}

impl AxisStateRecord {
    /// Inverters, faults and the MTC's state in one word of the file.
    fn flags(self) -> u64 {
        u64::from(self.inverters) | u64::from(self.faults.bits()) << 8 | u64::from(self.mtc_known) << 40
    }

    fn of([flags, completed]: [u64; 2]) -> Option<Self> {
        let inverters = (flags & 0xFF) as u8;
        let faults = FaultSet::from_bits((flags >> 8) as u32)?;
        let mtc_known = flags >> 40 == 1;
        let valid = inverters < 4 && flags >> 41 == 0;
        valid.then_some(Self { inverters, completed: completed as i64, faults, mtc_known })
    }
}

/// State of the machine as a whole that was in effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct HoldAndFaultsRecord {
    /// Who asked for feed hold.
    pub held: Option<FeedHoldSource>,
    /// Feed hold is on, asked for by somebody or by a fault.
    pub hold_output: bool,
    /// The machine's own latched faults.
    pub faults: FaultSet,
}

impl HoldAndFaultsRecord {
    /// Flags and user as two words of the file.
    fn words(self) -> [u64; 2] {
        let (by, user) = match self.held {
            None => (0, 0),
            Some(FeedHoldSource::User(user)) => (1, u64::from(user)),
            Some(FeedHoldSource::Controller) => (2, 0),
            Some(FeedHoldSource::FoundOn) => (3, 0),
        };
        [by | u64::from(self.hold_output) << 2 | u64::from(self.faults.bits()) << 8, user]
    }

    fn of([flags, user]: [u64; 2]) -> Option<Self> {
        let held = match flags & 3 {
            0 => None,
            1 => Some(FeedHoldSource::User(u32::try_from(user).ok()?)),
            2 => Some(FeedHoldSource::Controller),
            _ => Some(FeedHoldSource::FoundOn),
        };
        let faults = FaultSet::from_bits(u32::try_from(flags >> 8).ok()?)?;
        (flags & 0xF8 == 0).then_some(Self { held, hold_output: flags >> 2 & 1 == 1, faults })
    }
}

/// Times of the latched faults and of the request for feed hold (card's clock).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FaultAndHoldTimes([[Option<u64>; ROW_WORDS]; ROWS]);

impl FaultAndHoldTimes {
    /// When a fault was latched, ns; `None` where that is not known.
    /// Without an axis it is a fault of the machine as a whole.
    pub fn latched_ns(&self, axis: Option<usize>, fault: Fault) -> Option<u64> {
        self.0.get(axis.unwrap_or(MACHINE))?[fault as usize]
    }

    /// When feed hold was asked for, ns.
    pub const fn held_ns(&self) -> Option<u64> {
        self.0[MACHINE][HOLD_AT]
    }
}

/// Contents of a state file when it was opened.
#[allow(clippy::struct_excessive_bools)] // each is independent of the others
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StateAtOpen {
    /// There was no file. At a first start no record can be missing.
    pub first_start: bool,
    /// The file is of version 2.
    /// It does not record feed hold, faults that leave the count certain, or whether the MTC was homed.
    pub older: bool,
    /// Per axis, the valid records, newest first.
    pub records: [[Option<AxisStateRecord>; 2]; MAX_AXES],
    /// The computer was restarted since the file was written, or may have been.
    /// The MTC's count is then unknown. It is `false` where the kernel does not report its boot.
    pub other_boot: bool,
    /// Axes with a record that is damaged in both copies and may be the newest.
    pub damaged: [bool; MAX_AXES],
    /// The machine's record is damaged in both copies, or there is none.
    pub machine_damaged: bool,
    /// The machine's newest valid record.
    pub machine: Option<HoldAndFaultsRecord>,
    /// Times of faults and of feed hold.
    pub times: FaultAndHoldTimes,
    /// The process before this one lost its real-time thread.
    /// See [`crate::state_file_watch::StateFileWatch::note_thread_lost`].
    pub thread_lost: bool,
}

impl StateAtOpen {
    /// The contents at a first start.
    pub const NOTHING: Self = Self {
        first_start: true,
        older: false,
        records: [[None; 2]; MAX_AXES],
        other_boot: false,
        damaged: [false; MAX_AXES],
        machine_damaged: false,
        machine: None,
        times: FaultAndHoldTimes([[None; ROW_WORDS]; ROWS]),
        thread_lost: false,
    };

    /// Whether the reason of feed hold, or its state, is unknown.
    /// Then the machine's record is lost, or names neither a user nor a fault. The fault of an axis is recorded before
    /// the hold that it causes, and cleared after it.
    pub fn hold_unexplained(&self) -> bool {
        let faulted = self.records.iter().any(|found| found[0].is_some_and(|r| r.faults.any()));
        let unasked =
            |m: HoldAndFaultsRecord| m.hold_output && m.held.is_none() && !m.faults.any() && !faulted;
        self.machine_damaged || self.machine.is_some_and(unasked)
    }
}

/// Why a state file cannot be used. An error leaves the file unchanged.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)] // the messages say what they are
pub enum JournalError {
    #[error("{}: {source}", path.display())]
    Io { path: PathBuf, source: io::Error },
    #[error("{}: another rtecd works with it; expected one daemon per state file ([control] state_file)", path.display())]
    Taken { path: PathBuf },
    #[error(
        "{}: found {found}, expected a state file of this version; with the MTC off and all inverters off remove it, start \
         again and home", path.display()
    )]
    Foreign { path: PathBuf, found: String },
    #[error(
        "{}: it belongs to {theirs}, and this is {ours}; a machine needs a state file of its own ([control] state_file). If \
         this one has really become that: with the MTC off and all inverters off remove it, start again and home",
        path.display()
    )]
    Other { path: PathBuf, theirs: String, ours: String },
}

/// The mapped file.
/// The journal writes it, and [`crate::state_file_watch::StateFileWatch`] watches over it.
#[derive(Debug)]
pub(crate) struct Mapping {
    words: NonNull<AtomicU64>,
    /// Number of the newest record that was noted, for each row.
    noted: [AtomicU64; ROWS],
}

// SAFETY: the mapping belongs to this value alone, lives as long as it, and is accessed as atomics only.
unsafe impl Send for Mapping {}
// SAFETY: as above.
unsafe impl Sync for Mapping {}

impl Mapping {
    fn of(file: &File) -> io::Result<Self> {
        // SAFETY: a new shared mapping at an address of the kernel's choice disturbs no other memory of the process.
        let base = unsafe { mmap(None, BYTES, ACCESS, MapFlags::MAP_SHARED, file, 0) }?;
        Ok(Self { words: base.cast(), noted: [const { AtomicU64::new(0) }; ROWS] })
    }

    /// Maps another file of this size in place of this one.
    pub(crate) fn replace(&self, file: &File) -> io::Result<()> {
        let flags = MapFlags::MAP_SHARED | MapFlags::MAP_FIXED | MapFlags::MAP_POPULATE;
        // SAFETY: the range is this mapping's own, and stays mapped throughout: who stores meanwhile meets either file.
        unsafe { mmap(NonZeroUsize::new(self.base()), BYTES, ACCESS, flags, file, 0) }?;
        Ok(())
    }

    pub(crate) fn base(&self) -> usize {
        self.words.as_ptr() as usize
    }

    fn word(&self, n: usize) -> &AtomicU64 {
        assert!(n < COPIES * PAGE_WORDS);
        // SAFETY: the mapping holds so many aligned words and lives as long as `self`; every bit pattern is valid.
        unsafe { self.words.add(n).as_ref() }
    }

    pub(crate) fn load(&self, n: usize) -> u64 {
        self.word(n).load(Ordering::Acquire)
    }

    /// Stores one word. Every store goes through here.
    #[inline]
    pub(crate) fn put(&self, n: usize, value: u64) {
        #[cfg(test)]
        STORES.with_borrow_mut(|stores| stores.push((n, value)));
        self.word(n).store(value, Ordering::Release);
    }

    /// The undamaged copies of a slot: sequence number, flags and value.
    fn copies(&self, row: usize, n: usize) -> impl Iterator<Item = [u64; 3]> {
        [0, PAGE_WORDS].into_iter().filter_map(move |page| {
            let at = page + HEAD_WORDS + row * AXIS_WORDS + n * SLOT_WORDS;
            let [seq, flags, value, sum] = [0, 1, 2, 3].map(|k| self.load(at + k));
            let whole = (1..ROOM).contains(&seq) && sum == check(&[seq, flags, value]);
            whole.then_some([seq, flags, value])
        })
    }

    /// Whether the newest record noted for every row is in the file.
    pub(crate) fn has_what_was_noted(&self) -> bool {
        (0..ROWS).all(|row| {
            let noted = self.noted[row].load(Ordering::Acquire);
            noted == 0 || (0..2).flat_map(|n| self.copies(row, n)).any(|[seq, ..]| seq >= noted)
        })
    }
}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: base and length are those of the mapping made in `of`, and nothing refers to it any more.
        let _ = unsafe { munmap(self.words.cast(), BYTES.get()) };
    }
}

/// The state of an engine in a mapped file.
#[derive(Debug)]
pub struct Journal {
    mapping: Arc<Mapping>,
    next: [u64; ROWS],
    last: [Option<AxisStateRecord>; MAX_AXES],
    last_machine: Option<HoldAndFaultsRecord>,
    /// Faults whose times are in the file, a set for each row.
    /// `timed_hold` is the same for feed hold.
    timed: [FaultSet; ROWS],
    timed_hold: bool,
    /// The times as they are in the file.
    times: Box<[[u64; ROW_WORDS]; ROWS]>,
    identity: String,
    /// This boot of the computer.
    boot: Option<u64>,
    path: PathBuf,
    /// Path of the new file at a first start, until it gets its name.
    unplaced: Option<PathBuf>,
    /// Holds the lock as long as it is open.
    held: Flock<File>,
}

/// A check sum in which every bit of every word reaches every bit.
/// A torn or foreign record does not pass.
fn check(words: &[u64]) -> u64 {
    // The start value is no word that is written, so that zeros behind the magic do not sum up to zero. Version 2 had
    // the same.
    let mut sum = !MAGIC_2;
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
    /// Opens or creates the file of `identity`, and returns its contents.
    /// `identity` is a text that names machine, card and lines.
    ///
    /// # Errors
    /// When the file cannot be opened, sized or mapped, is locked, is no state file, or has another identity.
    pub fn open(path: &Path, identity: &str) -> Result<(Self, StateAtOpen), JournalError> {
        let io = |source: io::Error| JournalError::Io { path: path.to_owned(), source };
        let mut unplaced = None;
        let held = match opened(path, false) {
            Err(JournalError::Io { source, .. }) if source.kind() == io::ErrorKind::NotFound => {
                let file = beside(path);
                let held = empty(&file)?;
                unplaced = Some(file);
                held
            }
            held => held?,
        };
        let len = held.metadata().map_err(io)?.len();
        if len != BYTES.get() as u64 {
            let found = format!("{len} bytes instead of {BYTES}");
            return Err(JournalError::Foreign { path: path.to_owned(), found });
        }
        // Allocates its blocks now. On a full disk the first store to the mapping would kill the process.
        posix_fallocate(&*held, 0, BYTES.get() as i64).map_err(|e| io(e.into()))?;
        let first_start = unplaced.is_some();
        let mut journal = Self {
            mapping: Arc::new(Mapping::of(&held).map_err(io)?),
            next: [1; ROWS],
            last: [None; MAX_AXES],
            last_machine: None,
            timed: [FaultSet::NONE; ROWS],
            timed_hold: false,
            times: Box::new([[0; ROW_WORDS]; ROWS]),
            identity: identity.to_owned(),
            boot: boot(),
            path: path.to_owned(),
            unplaced,
            held,
        };
        let older = !first_start && journal.is_ours(path, identity)?;
        let mut before = StateAtOpen { first_start, older, ..StateAtOpen::NOTHING };
        before.damaged = std::array::from_fn(|axis| journal.damaged(axis, AxisStateRecord::of));
        for (axis, found) in before.records.iter_mut().enumerate() {
            *found = journal.newest_first(axis, AxisStateRecord::of);
            journal.timed[axis] = found[0].map_or(FaultSet::NONE, |r| r.faults);
        }
        before.other_boot = !first_start && journal.boot.is_some_and(|now| journal.boot() != Some(now));
        if older {
            // The text of version 2 is where this version has other words.
            journal.wipe(TIMES_AT..PAGE_WORDS);
        } else {
            let damaged = journal.damaged(MACHINE, HoldAndFaultsRecord::of);
            before.machine = journal.newest_first(MACHINE, HoldAndFaultsRecord::of)[0];
            before.machine_damaged = !first_start && (damaged || before.machine.is_none());
            journal.timed[MACHINE] = before.machine.map_or(FaultSet::NONE, |m| m.faults);
            journal.timed_hold = before.machine.is_some_and(|m| m.held.is_some());
            before.times = journal.read_times();
            before.thread_lost = [0, PAGE_WORDS].iter().any(|page| journal.load(page + LOST_AT) == LOST);
        }
        Ok((journal, before))
    }

    /// Mapping, file and path for [`crate::state_file_watch::StateFileWatch`].
    pub(crate) fn shared(&self) -> (Arc<Mapping>, &File, &Path) {
        (Arc::clone(&self.mapping), &self.held, &self.path)
    }

    /// The valid records of a row, newest first.
    /// The next record continues their numbers.
    fn newest_first<T: Copy>(&mut self, row: usize, of: impl Fn([u64; 2]) -> Option<T>) -> [Option<T>; 2] {
        let mut slots = [self.slot(row, 0, &of), self.slot(row, 1, &of)];
        slots.sort_by_key(|s| std::cmp::Reverse(s.map(|(seq, _)| seq)));
        self.next[row] = slots[0].map_or(1, |(seq, _)| seq + 1);
        if slots[0].is_none() {
            // Wiped slots tell the next process as much as damaged ones, until the next record.
            let at = HEAD_WORDS + row * AXIS_WORDS;
            self.wipe(at..at + AXIS_WORDS);
        }
        slots.map(|s| s.map(|(_, record)| record))
    }

    /// Whether a record of this row that may be the newest is damaged in both copies.
    /// A record that was cut short before there was another never was in effect.
    fn damaged<T>(&self, row: usize, of: impl Fn([u64; 2]) -> Option<T>) -> bool {
        let slots = [0, 1].map(|n| self.slot(row, n, &of).map(|(seq, _)| seq));
        (0..2).any(|n| {
            let [first, second] = [0, PAGE_WORDS].map(|page| {
                let at = page + HEAD_WORDS + row * AXIS_WORDS + n * SLOT_WORDS;
                [0, 1, 2, 3].map(|k| self.load(at + k))
            });
            let none_yet =
                first[3] == 0 && second == [0; SLOT_WORDS] && slots[1 - n].is_none_or(|seq| seq < 2);
            slots[n].is_none() && !none_yet
        })
    }

    /// The boot of the computer in which the file was written, from an undamaged copy.
    fn boot(&self) -> Option<u64> {
        [0, PAGE_WORDS].into_iter().find_map(|page| {
            let found = [0, 1].map(|k| self.load(page + BOOT_AT + k));
            (found == boot_words(found[0])).then_some(found[0])
        })
    }

    fn wipe(&self, words: std::ops::Range<usize>) {
        for page in [0, PAGE_WORDS] {
            words.clone().for_each(|n| self.put(page + n, 0));
        }
    }

    #[inline]
    fn put(&self, n: usize, value: u64) {
        self.mapping.put(n, value);
    }

    fn load(&self, n: usize) -> u64 {
        self.mapping.load(n)
    }

    /// Refuses the file of another version or another identity.
    /// Returns whether it is of the version before. A head that is damaged in both copies is accepted, and the records
    /// are judged then.
    fn is_ours(&self, path: &Path, identity: &str) -> Result<bool, JournalError> {
        for page in [0, PAGE_WORDS] {
            let [magic, hash, bytes, sum] = [0, 1, 2, 3].map(|k| self.load(page + k));
            let ours = magic == MAGIC || magic == MAGIC_2;
            if magic & 0xFF_FFFF_FFFF == MAGIC & 0xFF_FFFF_FFFF && !ours {
                let found = format!("version {} of it", magic >> 56);
                return Err(JournalError::Foreign { path: path.to_owned(), found });
            }
            if !ours || sum != check(&[magic, hash, bytes]) {
                continue;
            }
            let older = magic == MAGIC_2;
            if hash == hash_of(identity) {
                return Ok(older);
            }
            let text_at = if older { TEXT_AT_2 } else { TEXT_AT };
            let len = usize::try_from(bytes).unwrap_or(usize::MAX).min(TEXT_BYTES);
            let mut text: Vec<u8> =
                (0..len.div_ceil(8)).flat_map(|k| self.load(page + text_at + k).to_le_bytes()).collect();
            text.truncate(len);
            let theirs = String::from_utf8_lossy(&text).replace(|c: char| c.is_control(), " ");
            return Err(JournalError::Other { path: path.to_owned(), theirs, ours: identity.to_owned() });
        }
        let zero = (0..COPIES * PAGE_WORDS).all(|n| self.load(n) == 0);
        let a_record =
            (0..MAX_AXES).any(|axis| (0..2).any(|n| self.slot(axis, n, AxisStateRecord::of).is_some()));
        if zero || a_record {
            return Ok(false);
        }
        let found = "something else of the same size".to_owned();
        Err(JournalError::Foreign { path: path.to_owned(), found })
    }

    fn write_head(&self, identity: &str) {
        let text = identity.as_bytes();
        let (hash, bytes) = (hash_of(identity), text.len() as u64);
        for page in [0, PAGE_WORDS] {
            for (k, word) in words_of(&text[..text.len().min(TEXT_BYTES)]).enumerate() {
                self.put(page + TEXT_AT + k, word);
            }
            for (k, word) in [MAGIC, hash, bytes, check(&[MAGIC, hash, bytes])].into_iter().enumerate() {
                self.put(page + k, word);
            }
        }
    }

    /// The record of a slot from an undamaged copy; the newer one of two.
    fn slot<T>(&self, row: usize, n: usize, of: impl Fn([u64; 2]) -> Option<T>) -> Option<(u64, T)> {
        let records = self.mapping.copies(row, n);
        let records = records.filter_map(|[seq, flags, value]| Some((seq, of([flags, value])?)));
        records.max_by_key(|(seq, _)| *seq)
    }

    /// Marks the file as complete and gives it its name.
    /// It also notes this boot of the computer. Every record must be in the file. If the process is killed before, the
    /// next one finds the same contents.
    ///
    /// # Errors
    /// When the disk refuses it, or another process has placed its file meanwhile.
    pub fn place(&mut self) -> io::Result<()> {
        self.write_head(&self.identity);
        for page in [0, PAGE_WORDS] {
            for (k, word) in self.boot.into_iter().flat_map(boot_words).enumerate() {
                self.put(page + BOOT_AT + k, word);
            }
        }
        if let Some(new) = &self.unplaced {
            self.held.sync_all()?;
            renameat2(AT_FDCWD, new, AT_FDCWD, &self.path, RenameFlags::RENAME_NOREPLACE)?;
            self.unplaced = None;
        }
        Ok(())
    }

    /// Notes at `t_ns` the state of an axis that the following write puts in effect.
    /// It makes no system call.
    #[inline]
    pub fn record(&mut self, axis: usize, record: AxisStateRecord, t_ns: u64) {
        if self.last[axis] == Some(record) {
            return;
        }
        self.last[axis] = Some(record);
        if record.faults != self.timed[axis] {
            self.note_times(axis, record.faults, t_ns);
        }
        self.store(axis, [record.flags(), record.completed as u64]);
    }

    /// Notes at `t_ns` the state of the machine as a whole. It makes no system call.
    pub fn record_machine(&mut self, record: HoldAndFaultsRecord, t_ns: u64) {
        if self.last_machine == Some(record) {
            return;
        }
        self.last_machine = Some(record);
        self.note_times(MACHINE, record.faults, t_ns);
        let held = record.held.is_some();
        if held && !self.timed_hold {
            self.note_time(MACHINE, HOLD_AT, t_ns);
        }
        self.timed_hold = held;
        self.store(MACHINE, record.words());
        if record.faults.has(Fault::ThreadLost) {
            self.wipe(LOST_AT..LOST_AT + 1);
        }
    }

    /// Notes everything again, because the file is a new one with nothing but its head.
    /// It makes no system call.
    pub(crate) fn note_again(&mut self) {
        for row in 0..ROWS {
            for (k, word) in self.times[row].into_iter().enumerate() {
                self.put_time(row, k, word);
            }
            let words = match self.last.get(row) {
                Some(axis) => axis.map(|r| [r.flags(), r.completed as u64]),
                None => self.last_machine.map(HoldAndFaultsRecord::words),
            };
            // Both slots get the record, because an empty slot looks like a lost record.
            for words in words.into_iter().cycle().take(2 * usize::from(words.is_some())) {
                self.store(row, words);
            }
        }
    }

    fn store(&mut self, row: usize, [flags, value]: [u64; 2]) {
        let seq = self.next[row];
        self.next[row] = seq + 1;
        let sum = check(&[seq, flags, value]);
        for page in [0, PAGE_WORDS] {
            let at = page + HEAD_WORDS + row * AXIS_WORDS + (seq & 1) as usize * SLOT_WORDS;
            // A record cut short fails its check sum. The one before it is in the other slot.
            self.put(at + 3, 0);
            self.put(at, seq);
            self.put(at + 1, flags);
            self.put(at + 2, value);
            self.put(at + 3, sum);
        }
        self.mapping.noted[row].store(seq, Ordering::Release);
    }

    /// Notes the time of every fault that is new.
    #[cold]
    fn note_times(&mut self, row: usize, faults: FaultSet, t_ns: u64) {
        for fault in faults.without(self.timed[row]).iter() {
            self.note_time(row, fault as usize, t_ns);
        }
        self.timed[row] = faults;
    }

    fn note_time(&mut self, row: usize, k: usize, t_ns: u64) {
        let us = t_ns / 1000;
        self.times[row][k] = us << TIME_SHIFT | time_check(row, k, us);
        self.put_time(row, k, self.times[row][k]);
    }

    fn put_time(&self, row: usize, k: usize, word: u64) {
        for page in [0, PAGE_WORDS] {
            self.put(page + TIMES_AT + row * ROW_WORDS + k, word);
        }
    }

    /// Reads the times from an undamaged copy.
    fn read_times(&mut self) -> FaultAndHoldTimes {
        let mut times = FaultAndHoldTimes([[None; ROW_WORDS]; ROWS]);
        for (row, k) in (0..ROWS).flat_map(|row| (0..ROW_WORDS).map(move |k| (row, k))) {
            let copies = [0, PAGE_WORDS].map(|page| self.load(page + TIMES_AT + row * ROW_WORDS + k));
            let whole = |word: &u64| {
                let us = word >> TIME_SHIFT;
                us > 0 && word & 0xFFFF == time_check(row, k, us)
            };
            if let Some(word) = copies.into_iter().find(whole) {
                self.times[row][k] = word;
                times.0[row][k] = Some((word >> TIME_SHIFT) * 1000);
            }
        }
        times
    }
}

/// The check sum of a time, 16 bits.
fn time_check(row: usize, k: usize, us: u64) -> u64 {
    check(&[row as u64, k as u64, us]) >> 48
}

/// Opens a file, or makes it, and locks it.
fn opened(path: &Path, create: bool) -> Result<Flock<File>, JournalError> {
    let io = |source: io::Error| JournalError::Io { path: path.to_owned(), source };
    let mut options = File::options();
    options.read(true).write(true).create(create).truncate(false).mode(0o600);
    let file = options.custom_flags((OFlag::O_NOFOLLOW | OFlag::O_NONBLOCK).bits()).open(path).map_err(io)?;
    if !file.metadata().map_err(io)?.is_file() {
        let found = "something that is no regular file".to_owned();
        return Err(JournalError::Foreign { path: path.to_owned(), found });
    }
    Flock::lock(file, FlockArg::LockExclusiveNonblock).map_err(|(_, errno)| match errno {
        Errno::EWOULDBLOCK => JournalError::Taken { path: path.to_owned() },
        errno => io(errno.into()),
    })
}

/// Makes and locks a state file of zeros, or clears one that was not completed.
pub(crate) fn empty(path: &Path) -> Result<Flock<File>, JournalError> {
    let io = |source: io::Error| JournalError::Io { path: path.to_owned(), source };
    let held = opened(path, true)?;
    held.set_len(0).map_err(io)?;
    posix_fallocate(&*held, 0, BYTES.get() as i64).map_err(|e| io(e.into()))?;
    Ok(held)
}

/// Path of the new file until it is complete and gets the state file's name.
pub(crate) fn beside(path: &Path) -> PathBuf {
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(".new");
    path.with_file_name(name)
}

/// The words of a boot in the head, with the check sum.
fn boot_words(boot: u64) -> [u64; 2] {
    [boot, check(&[BOOT_AT as u64, boot])]
}

/// The hash of this boot of the computer, where the kernel reports it.
fn boot() -> Option<u64> {
    std::fs::read_to_string(BOOT_FILE).ok().filter(|id| !id.trim().is_empty()).map(|id| hash_of(id.trim()))
}

fn hash_of(identity: &str) -> u64 {
    let words: Vec<u64> =
        words_of(identity.as_bytes()).chain(std::iter::once(identity.len() as u64)).collect();
    check(&words)
}

impl Drop for Journal {
    fn drop(&mut self) {
        if let Some(new) = &self.unplaced {
            // A start that failed. If the file stays, the next start writes it again.
            let _ = std::fs::remove_file(new);
        }
    }
}

/// The newest record that agrees with the inverters as read back.
/// Latched faults and the MTC's state come from the newest record, whether or not its write was made.
pub fn resume(found: [Option<AxisStateRecord>; 2], inverters: u8) -> Option<AxisStateRecord> {
    let AxisStateRecord { faults, mtc_known, .. } = found.into_iter().flatten().next()?;
    let agrees = found.into_iter().flatten().find(|r| r.inverters == inverters)?;
    Some(AxisStateRecord { faults, mtc_known, ..agrees })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::state_file_watch::StateFileWatch;
    use std::os::unix::fs::FileExt;

    const OURS: &str = "machine \"lathe 7\" on card mapped";
    const AT: u64 = (HEAD_WORDS as u64 + 2 * AXIS_WORDS as u64) * 8;

    fn new() -> (tempfile::TempDir, PathBuf) {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("state");
        (directory, path)
    }

    /// The journal of a file with its name.
    fn begun(path: &Path, identity: &str) -> Journal {
        let (mut journal, _) = Journal::open(path, identity).unwrap();
        journal.place().unwrap();
        journal
    }

    /// Notes these records of axis 2.
    fn note(path: &Path, records: &[AxisStateRecord]) {
        let mut journal = begun(path, OURS);
        for record in records {
            journal.record(2, *record, 1000);
        }
    }

    fn record(inverters: u8, completed: i64) -> AxisStateRecord {
        AxisStateRecord { inverters, completed, faults: FaultSet::NONE, mtc_known: true }
    }

    fn found(path: &Path) -> [Option<AxisStateRecord>; 2] {
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
        assert_eq!(Journal::open(&path, OURS).unwrap().1, StateAtOpen::NOTHING);
        for pair in records.windows(2) {
            note(&path, pair);
            let found = found(&path);
            assert_eq!(found, [Some(pair[1]), Some(pair[0])]);
            // After a kill before or after the write, the inverters decide which record holds.
            assert_eq!(resume(found, pair[0].inverters), Some(pair[0]));
            assert_eq!(resume(found, pair[1].inverters), Some(pair[1]));
        }
    }

    #[test]
    fn what_is_latched_is_found_and_what_nobody_knows_is_no_record() {
        let (_directory, path) = new();
        let mut faults = FaultSet::NONE;
        assert!(
            faults.latch(crate::link_messages::Fault::PollGap)
                && faults.latch(crate::link_messages::Fault::OrderUnknown)
        );
        let latched = AxisStateRecord { faults, ..record(3, 8) };
        note(&path, &[record(3, 8), latched]);
        assert_eq!(resume(found(&path), 3), Some(latched));
        assert_eq!(AxisStateRecord::of([latched.flags() | 1 << 39, 8]), None);
        assert_eq!(AxisStateRecord::of([latched.flags() | 1 << 41, 8]), None);
        assert_eq!(AxisStateRecord::of([4, 8]), None);
    }

    fn set(faults: &[Fault]) -> FaultSet {
        let mut set = FaultSet::NONE;
        for fault in faults {
            assert!(set.latch(*fault));
        }
        set
    }

    /// Feed hold, its user, faults and their times survive the process.
    #[test]
    fn hold_and_the_times_of_faults_outlive_the_process() {
        let (_directory, path) = new();
        for held in [
            Some(FeedHoldSource::User(u32::MAX)),
            Some(FeedHoldSource::Controller),
            Some(FeedHoldSource::FoundOn),
            None,
        ] {
            for hold_output in [false, true] {
                let machine = HoldAndFaultsRecord { held, hold_output, faults: set(&[Fault::Card]) };
                let mut journal = begun(&path, OURS);
                journal.record_machine(machine, 5_000);
                drop(journal);
                assert_eq!(Journal::open(&path, OURS).unwrap().1.machine, Some(machine));
            }
        }
        assert_eq!(HoldAndFaultsRecord::of([8, 0]), None);
        assert_eq!(HoldAndFaultsRecord::of([1, 1 << 32]), None);
        let mut journal = begun(&path, OURS);
        let (first, both) = (set(&[Fault::ErrorLimit]), set(&[Fault::ErrorLimit, Fault::PollGap]));
        journal.record(2, AxisStateRecord { faults: first, ..record(0, 2) }, 7_000);
        journal.record(2, AxisStateRecord { faults: both, ..record(0, 2) }, 9_999);
        let user = HoldAndFaultsRecord {
            held: Some(FeedHoldSource::User(7)),
            hold_output: true,
            faults: FaultSet::NONE,
        };
        journal.record_machine(user, 11_000);
        drop(journal);
        let mut journal = begun(&path, OURS);
        // A fault that is still latched keeps its time in the next process, and so does feed hold.
        journal.record(2, AxisStateRecord { faults: both, ..record(0, 2) }, 20_000);
        journal.record_machine(HoldAndFaultsRecord { faults: set(&[Fault::Card]), ..user }, 21_000);
        drop(journal);
        let times = Journal::open(&path, OURS).unwrap().1.times;
        let of = |axis, fault| times.latched_ns(axis, fault);
        assert_eq!((of(Some(2), Fault::ErrorLimit), of(Some(2), Fault::PollGap)), (Some(7_000), Some(9_000)));
        assert_eq!((of(Some(1), Fault::ErrorLimit), times.held_ns()), (None, Some(11_000)));
        assert_eq!(of(None, Fault::Card), Some(21_000));
        // A time that is damaged in both copies is unknown, and nothing else is lost.
        for page in [0, PAGE_WORDS] {
            zero(&path, ((page + TIMES_AT + 2 * ROW_WORDS + Fault::PollGap as usize) * 8) as u64, 1);
        }
        let before = Journal::open(&path, OURS).unwrap().1;
        assert_eq!(before.times.latched_ns(Some(2), Fault::PollGap), None);
        assert_eq!(before.records[2][0].map(|r| r.faults), Some(both));
    }

    /// A fault that is latched with an inversion survives a kill before the write.
    #[test]
    fn what_is_latched_does_not_hang_on_the_write_that_was_not_made() {
        let latched = AxisStateRecord { faults: set(&[Fault::PollGap]), mtc_known: false, ..record(1, 3) };
        let found = [Some(latched), Some(record(0, 2))];
        let resumed = resume(found, 0).unwrap();
        assert_eq!((resumed.completed, resumed.faults, resumed.mtc_known), (2, latched.faults, false));
        assert_eq!(resume(found, 1), Some(latched));
        assert_eq!(resume(found, 3), None);
    }

    /// A file of version 2 keeps counts and faults; the MTC's state is unknown.
    #[test]
    fn the_file_of_the_version_before_is_read() {
        let (_directory, path) = new();
        let mut words = vec![0_u64; BYTES.get() / 8];
        let doubted = set(&[Fault::OrderUnknown]);
        for page in [0, PAGE_WORDS] {
            let text: Vec<u64> = words_of(OURS.as_bytes()).collect();
            words[page + TEXT_AT_2..][..text.len()].copy_from_slice(&text);
            let (hash, bytes) = (hash_of(OURS), OURS.len() as u64);
            words[page..page + 4].copy_from_slice(&[MAGIC_2, hash, bytes, check(&[MAGIC_2, hash, bytes])]);
            for (axis, flags, completed) in [(0, 3, 10_u64), (1, u64::from(doubted.bits()) << 8, 4)] {
                let slot = [1, flags, completed, check(&[1, flags, completed])];
                words[page + HEAD_WORDS + axis * AXIS_WORDS + SLOT_WORDS..][..4].copy_from_slice(&slot);
            }
        }
        let bytes: Vec<u8> = words.iter().flat_map(|w| w.to_le_bytes()).collect();
        std::fs::write(&path, &bytes).unwrap();
        let error = Journal::open(&path, "machine \"mill 2\"").unwrap_err().to_string();
        assert!(error.contains(OURS), "{error}");
        let (mut journal, before) = Journal::open(&path, OURS).unwrap();
        let unknown =
            |inverters, completed| AxisStateRecord { mtc_known: false, ..record(inverters, completed) };
        assert_eq!((before.older, before.machine, before.first_start), (true, None, false));
        assert_eq!(before.records[0], [Some(unknown(3, 10)), None]);
        assert_eq!(before.records[1], [Some(AxisStateRecord { faults: doubted, ..unknown(0, 4) }), None]);
        assert_eq!(before.times, StateAtOpen::NOTHING.times, "its text is no time");
        journal.place().unwrap();
        drop(journal);
        let again = Journal::open(&path, OURS).unwrap().1;
        assert_eq!((again.older, again.records), (false, before.records), "it is of this version now");
    }

    /// A noted loss of the thread is found by every process until one latches it.
    #[test]
    fn a_lost_thread_is_found_until_it_is_latched() {
        let (_directory, path) = new();
        let mut journal = begun(&path, OURS);
        journal.record(0, record(0, 0), 1000);
        StateFileWatch::watch(&journal).unwrap().note_thread_lost();
        drop(journal);
        assert!(Journal::open(&path, OURS).unwrap().1.thread_lost);
        let (mut journal, before) = Journal::open(&path, OURS).unwrap();
        assert!(before.thread_lost, "the first successor may have died before it latched it");
        let machine =
            HoldAndFaultsRecord { held: None, hold_output: true, faults: set(&[Fault::ThreadLost]) };
        journal.record_machine(machine, 1000);
        drop(journal);
        assert!(!Journal::open(&path, OURS).unwrap().1.thread_lost);
    }

    /// Both the PC and the MTC lost power, and the file on the disk survived.
    #[test]
    fn a_file_of_another_boot_is_told_until_its_records_say_what_follows() {
        let (_directory, path) = new();
        let machine = HoldAndFaultsRecord { held: None, hold_output: false, faults: FaultSet::NONE };
        let mut journal = begun(&path, OURS);
        journal.record(0, record(0, 4), 1000);
        journal.record_machine(machine, 1000);
        drop(journal);
        assert!(!Journal::open(&path, OURS).unwrap().1.other_boot);
        let file = File::options().write(true).open(&path).unwrap();
        // A boot word of another boot, a damaged one, and one missing as in version 2.
        for words in [boot_words(77), [77, 78], [0, 0]] {
            for page in [0, PAGE_WORDS] {
                for (k, word) in words.iter().enumerate() {
                    file.write_all_at(&word.to_le_bytes(), ((page + BOOT_AT + k) * 8) as u64).unwrap();
                }
            }
            assert!(Journal::open(&path, OURS).unwrap().1.other_boot);
            let (mut journal, before) = Journal::open(&path, OURS).unwrap();
            assert!(before.other_boot, "the first successor may have died before it noted anything");
            assert_eq!((before.records[0][0], before.machine), (Some(record(0, 4)), Some(machine)));
            journal.record_machine(machine, 1000);
            journal.place().unwrap();
            drop(journal);
            assert!(!Journal::open(&path, OURS).unwrap().1.other_boot);
        }
    }

    /// Both copies of the newest record are damaged.
    /// The older record lacks a fault that was latched with the newest.
    #[test]
    fn a_record_that_both_copies_have_lost_is_told() {
        let (_directory, path) = new();
        let machine = HoldAndFaultsRecord { held: None, hold_output: false, faults: FaultSet::NONE };
        let held = HoldAndFaultsRecord { held: Some(FeedHoldSource::User(7)), hold_output: true, ..machine };
        let mut journal = begun(&path, OURS);
        journal.record(2, record(0, 2), 1000);
        journal.record_machine(machine, 1000);
        journal.record(2, AxisStateRecord { faults: set(&[Fault::PollGap]), ..record(0, 2) }, 1000);
        journal.record_machine(held, 1000);
        journal.record(2, AxisStateRecord { faults: set(&[Fault::Card]), ..record(0, 2) }, 1000);
        journal.record_machine(HoldAndFaultsRecord { held: Some(FeedHoldSource::Controller), ..held }, 1000);
        drop(journal);
        let found = || Journal::open(&path, OURS).unwrap().1;
        let told =
            |before: StateAtOpen| (before.damaged.map(usize::from).iter().sum(), before.machine_damaged);
        assert_eq!(told(found()), (0_usize, false));
        let whole = std::fs::read(&path).unwrap();
        for (row, wants) in [(2, (1, false)), (MACHINE, (0, true))] {
            for slot in 0..2 {
                let at = (HEAD_WORDS + row * AXIS_WORDS + slot * SLOT_WORDS) * 8;
                for (first, bytes) in (0..SLOT_WORDS).map(|word| (8 * word, 1)).chain([(0, 32)]) {
                    std::fs::write(&path, &whole).unwrap();
                    for page in [0, PAGE_WORDS * 8] {
                        let mut damaged = whole[page + at + first..][..bytes].to_vec();
                        for byte in &mut damaged {
                            *byte = if bytes == 1 { !*byte } else { 0 };
                        }
                        let file = File::options().write(true).open(&path).unwrap();
                        file.write_all_at(&damaged, (page + at + first) as u64).unwrap();
                    }
                    assert_eq!(told(found()), wants, "row {row}, slot {slot}, byte {first}");
                }
            }
        }
        // Damage both slots; the next record that is noted is undamaged again.
        std::fs::write(&path, &whole).unwrap();
        for page in [0, PAGE_WORDS * 8] {
            let at = page + (HEAD_WORDS + 2 * AXIS_WORDS) * 8;
            let noise = vec![0x5A; AXIS_WORDS * 8];
            File::options().write(true).open(&path).unwrap().write_all_at(&noise, at as u64).unwrap();
        }
        let (mut journal, before) = Journal::open(&path, OURS).unwrap();
        assert_eq!((told(before), before.records[2]), ((1, false), [None, None]));
        journal.record(2, record(0, 6), 1000);
        drop(journal);
        assert_eq!((told(found()), found().records[2][0]), ((0, false), Some(record(0, 6))));
    }

    #[test]
    fn a_torn_record_is_not_believed() {
        let (_directory, path) = new();
        note(&path, &[record(0, 10), record(3, 12)]);
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

    /// Found by a fuzz target: the highest sequence number with its correct sum.
    #[test]
    fn a_record_of_the_last_number_there_is_is_not_believed() {
        let (_directory, path) = new();
        let older = record(0, 10);
        note(&path, &[older, record(3, 12)]);
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
        note(&path, &[record(1, 11), record(3, 12)]);
        assert_eq!(found(&path)[0], Some(record(3, 12)));
    }

    #[test]
    fn sixty_four_lost_bytes_lose_no_record_wherever_they_are() {
        let (_directory, path) = new();
        let newest = record(3, 14);
        note(&path, &[record(0, 12), newest]);
        let whole = std::fs::read(&path).unwrap();
        for at in (0..whole.len() - 63).step_by(8) {
            std::fs::write(&path, &whole).unwrap();
            zero(&path, at as u64, 64);
            assert_eq!(found(&path)[0], Some(newest), "at {at}");
        }
        // With both copies damaged nothing is known, and it is no first start.
        zero(&path, AT, 64);
        zero(&path, AT + 8 * PAGE_WORDS as u64, 64);
        assert_eq!(found(&path), [None, None]);
        zero(&path, 0, BYTES.get());
        assert_eq!(found(&path), [None, None]);
    }

    /// The check sum must not change, because the next version must read these files.
    /// The expected sum was worked out independently.
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
        note(&path, &[a, b, c]);
        assert_eq!(found(&path), [Some(c), Some(b)]);
        note(&path, &[d]);
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
            (Vec::new(), "found 0 bytes"),
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
        assert_eq!(Journal::open(&path, OURS).unwrap().1, StateAtOpen::NOTHING, "nothing had been noted");
        let mut ours = begun(&path, OURS);
        ours.record(0, record(0, 0), 1000);
        drop(ours);
        let error = Journal::open(&path, "machine \"mill 2\"").unwrap_err().to_string();
        assert!(
            error.contains("belongs to machine \"lathe 7\" on card mapped, and this is machine \"mill 2\""),
            "{error}"
        );
        assert!(Journal::open(&path, OURS).is_ok());
        // A name that is the beginning of the other one.
        assert!(matches!(Journal::open(&path, &OURS[..8]), Err(JournalError::Other { .. })));
    }

    #[test]
    fn every_axis_has_two_records_of_its_own() {
        let (_directory, path) = new();
        let noted = |axis: usize, n: i64| record(1, 100 * axis as i64 + 2 * n);
        let mut ours = begun(&path, OURS);
        (1..=2).for_each(|n| (0..MAX_AXES).for_each(|axis| ours.record(axis, noted(axis, n), 1000)));
        drop(ours);
        let before = Journal::open(&path, OURS).unwrap().1;
        for (axis, found) in before.records.iter().enumerate() {
            assert_eq!(*found, [Some(noted(axis, 2)), Some(noted(axis, 1))], "axis {axis}");
        }
    }

    /// An identity too long for the file is still told from others.
    /// It is named as far as there is room.
    #[test]
    fn of_a_long_identity_is_kept_what_there_is_room_for() {
        let (_directory, path) = new();
        let long: String = (0..5000_u32).map(|k| char::from(b'a' + (k % 23) as u8)).collect();
        let mut ours = begun(&path, &long);
        ours.record(5, record(0, 8), 1000);
        drop(ours);
        assert_eq!(Journal::open(&path, &long).unwrap().1.records[5], [Some(record(0, 8)), None]);
        match Journal::open(&path, &(long[..4999].to_owned() + "!")) {
            Err(JournalError::Other { theirs, .. }) => assert_eq!(theirs, long[..TEXT_BYTES]),
            other => panic!("{other:?}"),
        }
    }
}
