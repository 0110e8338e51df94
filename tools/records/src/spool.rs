//! Sends finished records to the shop's store.
//! They wait in a spool folder until the store has them.
//!
//! A record is sent as `inbox/MACHINE/DIGEST/NAME.run.toml` with its CSV beside it. The digest is of both
//! files, so a record has the same key however often it is sent. The sidecar is sent last: if it is there,
//! the record is complete. A record moves to `sent/` below the spool only after it was read back from the
//! store unchanged.

use rtec_files::InputError;
use rtec_files::untrusted_folder::UntrustedFolder;
use rtec_model::record::{Record, hex};
use sha2::{Digest, Sha256};
use std::io;
use std::path::{Path, PathBuf};

/// Folder of sent records, below the spool.
pub const SENT: &str = "sent";
/// Number of digits of a digest in a record's key.
const DIGITS: usize = 16;
/// Largest size of a sidecar, bytes: two thousand columns.
pub const LONGEST_SIDECAR: u64 = 64 << 10;
/// Largest size of a file that is sent, bytes.
const LONGEST_SENT: u64 = 1 << 30;
/// Prefixes of folders of records that are put into the spool or moved to the sent.
/// If the program is killed in between, the next one finishes the work.
const PUTTING: &str = ".rtec-put-";
const SENDING: &str = ".rtec-sent-";

/// A store of records; its keys are paths with `/`.
pub trait RecordStore {
    /// Stores bytes under a key, whole or not at all.
    ///
    /// # Errors
    /// When the store cannot be reached, or refuses the bytes.
    fn put(&self, key: &str, bytes: &[u8]) -> io::Result<()>;

    /// The bytes under a key, or `None`.
    ///
    /// # Errors
    /// When the store cannot be reached.
    fn get(&self, key: &str) -> io::Result<Option<Vec<u8>>>;
}

/// A store in a folder of this computer or a mounted share.
/// Other programs write to it too, so no link in it is followed.
#[derive(Debug, Clone)]
pub struct FolderStore(PathBuf);

impl FolderStore {
    /// Opens an existing folder.
    /// A missing folder is a share that is not mounted, and is not created.
    ///
    /// # Errors
    /// When there is no such folder.
    pub fn open(path: &Path) -> io::Result<Self> {
        UntrustedFolder::open(path).map(|_| Self(path.to_owned()))
    }
}

/// The folders and the file of a key.
fn parts(key: &str) -> (impl Iterator<Item = &str>, &str) {
    let (folders, file) = key.rsplit_once('/').unwrap_or(("", key));
    (folders.split('/').filter(|f| !f.is_empty()), file)
}

impl RecordStore for FolderStore {
    fn put(&self, key: &str, bytes: &[u8]) -> io::Result<()> {
        let (mut folders, file) = parts(key);
        let folder =
            folders.try_fold(UntrustedFolder::open(&self.0)?, |folder, name| folder.make_folder(name))?;
        folder.write(file, bytes, 0o644 & folder.mode()?, &|| true)
    }

    fn get(&self, key: &str) -> io::Result<Option<Vec<u8>>> {
        let (mut folders, file) = parts(key);
        // A missing share is an error, and not a store without this key.
        let root = UntrustedFolder::open(&self.0)?;
        match folders.try_fold(root, |folder, name| folder.folder(name)) {
            Ok(folder) => folder.read(file, LONGEST_SENT),
            Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(e) => Err(e),
        }
    }
}

/// Result of one round of sending.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct ShippingResult {
    /// Keys of the records that the store now holds, in order.
    pub sent: Vec<String>,
    /// Findings on files that are no records, which stay in the spool.
    pub kept: Vec<InputError>,
}

impl ShippingResult {
    /// The printed result: the keys and their number, or one line of JSON.
    pub fn text(&self, json: bool) -> String {
        if json {
            let kept: Vec<String> = self.kept.iter().map(ToString::to_string).collect();
            let document = serde_json::json!({"sent": self.sent, "kept": kept}).to_string();
            return rtec_files::file_format_stamp::signed(document) + "\n";
        }
        let places = self.sent.iter().fold(String::new(), |all, place| all + place + "\n");
        format!("{places}{} records sent, {} kept\n", self.sent.len(), self.kept.len())
    }

    /// One line on the files that stay in the spool; `None` where there are none.
    pub fn stays(&self, spool: &Path) -> Option<String> {
        let n = self.kept.len();
        (n > 0).then(|| format!("{n} records stay in {}", spool.display()))
    }
}

/// Why sending ended early. Records that were not sent stay in the spool.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)] // the messages say what they are
pub enum ShipError {
    #[error(
        "found the machine's name `{0}`, expected letters, digits, `.`, `_` and `-`, none of the dots first"
    )]
    Name(String),
    #[error("{path}: {error}")]
    Spool { path: PathBuf, error: io::Error },
    #[error("the store: {key}: {error}; {left} records wait in the spool")]
    Store { key: String, error: io::Error, left: usize },
}

/// Limits of a spool on its disk.
#[derive(Debug, Clone, Copy)]
pub struct SpoolLimits {
    /// Largest size of all waiting records, bytes.
    pub most_bytes: u64,
    /// Share of the disk that stays free, %.
    /// It is at most `most_bytes`, because a percentage of a large disk is more than a spool needs.
    pub free_percent: u64,
}

impl SpoolLimits {
    /// No limits, for users who fill their own folders.
    pub const ANY: Self = Self { most_bytes: u64::MAX, free_percent: 0 };

    /// Checks that there is room for `bytes` more bytes.
    fn check_room(self, folder: &UntrustedFolder, bytes: u64) -> io::Result<()> {
        let full = |text: String| Err(io::Error::new(io::ErrorKind::StorageFull, text));
        let disk = nix::sys::statvfs::fstatvfs(folder)?;
        let (free, all) =
            (disk.blocks_available() * disk.fragment_size(), disk.blocks() * disk.fragment_size());
        let kept_free = (all / 100 * self.free_percent).min(self.most_bytes);
        if free.saturating_sub(bytes) < kept_free {
            return full(format!(
                "No space left for records: {} of {} MB are free, and {} MB are kept free",
                free >> 20,
                all >> 20,
                kept_free >> 20
            ));
        }
        if self.most_bytes == u64::MAX {
            return Ok(());
        }
        let waiting = folder.bytes()?;
        if waiting.saturating_add(bytes) > self.most_bytes {
            return full(format!(
                "{} MB of records wait, and this one has {} kB: at most {} MB may wait ([control] spool_mb). `rtecctl ship` \
                 sends them",
                waiting >> 20,
                bytes.div_ceil(1 << 10),
                self.most_bytes >> 20
            ));
        }
        Ok(())
    }
}

/// Puts a written record into a spool, which is created where it is missing.
///
/// # Errors
/// When the record cannot be read, or the spool cannot be written.
pub fn add(sidecar: &Path, spool: &Path) -> io::Result<PathBuf> {
    let record = super::run_record_files::read_log(sidecar).map_err(|e| no_record(&e))?;
    let csv = std::fs::read(sidecar.parent().unwrap_or(Path::new("")).join(&record.file))?;
    std::fs::create_dir_all(spool)?;
    put(record, &csv, spool, SpoolLimits::ANY, &|| true)
}

/// Puts a record into an existing spool: its CSV, then its sidecar, each whole.
/// It gets its own name, with a number added where another record waits under that name. `go_on` is asked
/// between pieces; where it returns false, the record is not kept.
///
/// # Errors
/// When the spool cannot be written or has no room. Partial files are removed.
pub fn put(
    mut record: Record,
    csv: &[u8],
    spool: &Path,
    limits: SpoolLimits,
    go_on: &dyn Fn() -> bool,
) -> io::Result<PathBuf> {
    let name = record.path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let stem = name.strip_suffix(".run.toml").unwrap_or(&name).to_owned();
    if let Some(hidden) = rtec_files::message_text::unseen(&stem) {
        let text = format!("found the name {stem:?} with {hidden:?}, expected one that can be read");
        return Err(io::Error::new(io::ErrorKind::InvalidInput, text));
    }
    let folder = UntrustedFolder::open(spool)?;
    finish_begun(&folder)?;
    limits.check_room(&folder, (csv.len() + super::run_record_files::to_sidecar(&record).len()) as u64)?;
    // A user who may read the folder may read the records, whatever the process's umask.
    let mode = folder.mode()?;
    let mut numbers = 1..;
    let (staged, begun) = loop {
        let staged = format!("{PUTTING}{}-{}", std::process::id(), numbers.next().unwrap_or_default());
        match folder.new_folder(&staged) {
            Err(e) if e.kind() == io::ErrorKind::AlreadyExists => {}
            made => break (staged, made?),
        }
    };
    // A lock while the process lives. A folder without a lock was left by a killed process.
    let held = begun.lock();
    let done = place(&mut record, csv, &stem, (&folder, &begun), mode & 0o644 | 0o600, go_on);
    drop(held);
    if done.is_err() {
        for name in begun.names()? {
            let _ = begun.remove(&name);
        }
    }
    let _ = folder.remove_folder(&staged);
    folder.sync()?;
    done.map(|name| spool.join(name))
}

/// Writes a record's files in a folder beside it, then renames them.
fn place(
    record: &mut Record,
    csv: &[u8],
    stem: &str,
    (folder, begun): (&UntrustedFolder, &UntrustedFolder),
    mode: u32,
    go_on: &dyn Fn() -> bool,
) -> io::Result<String> {
    const DATA: &str = "csv";
    begun.write(DATA, csv, mode, go_on)?;
    for n in 1.. {
        let tail = if n == 1 { String::new() } else { format!("-{n}") };
        let name = format!("{stem}{tail}.run.toml");
        if folder.has(&name)? {
            continue;
        }
        super::run_record_files::at(record, &folder.path().join(&name)).map_err(|e| no_record(&e))?;
        // The sidecar names its CSV, so from here on any process can finish the work.
        begun.write(&name, super::run_record_files::to_sidecar(record).as_bytes(), mode, go_on)?;
        let taken = begun.rename(DATA, folder, &record.file);
        let taken = taken.and_then(|()| {
            begun.rename(&name, folder, &name).inspect_err(|_| {
                let _ = folder.rename(&record.file, begun, DATA);
            })
        });
        match taken {
            Err(e) if e.kind() == io::ErrorKind::AlreadyExists => begun.remove(&name)?,
            done => return done.map(|()| name),
        }
    }
    Err(io::ErrorKind::AlreadyExists.into())
}

/// Finishes the work of killed processes in a spool.
///
/// # Errors
/// When the file system fails.
pub fn finish(spool: &Path) -> io::Result<()> {
    finish_begun(&UntrustedFolder::open(spool)?)
}

/// Finishes the work of killed processes.
/// A record with both files is moved to its place; a partial one is removed. A record that was sent is moved
/// to the sent ones.
fn finish_begun(folder: &UntrustedFolder) -> io::Result<()> {
    for name in folder.names()? {
        if !name.starts_with(PUTTING) && !name.starts_with(SENDING) {
            continue;
        }
        let Ok(begun) = folder.folder(&name) else { continue };
        // A locked folder is in use. Where locks are impossible, it may be in use.
        let Ok(Some(_held)) = begun.lock() else { continue };
        if let Some(digits) = name.strip_prefix(SENDING) {
            move_to_sent(folder, &begun, digits)?;
            continue;
        }
        let files = begun.names()?;
        if let Some(sidecar) = files.iter().find(|f| f.ends_with(".run.toml")) {
            let csv = csv_of(sidecar);
            if files.iter().any(|f| f == "csv") && begun.rename("csv", folder, &csv).is_err()
                || begun.rename(sidecar, folder, sidecar).is_err()
            {
                // Another record has taken the name.
                continue;
            }
        }
        for file in begun.names()? {
            let _ = begun.remove(&file);
        }
        let _ = folder.remove_folder(&name);
    }
    Ok(())
}

/// The name of the CSV of a record in a spool.
fn csv_of(sidecar: &str) -> String {
    format!("{}.csv", sidecar.strip_suffix(".run.toml").unwrap_or(sidecar))
}

fn no_record(finding: &InputError) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, finding.to_string())
}

/// Sends the records of a spool, one after the other.
///
/// # Errors
/// The first failure of the store or of the spool.
pub fn ship(spool: &Path, store: &dyn RecordStore, machine: &str) -> Result<ShippingResult, ShipError> {
    let letter = |c: char| c.is_ascii_alphanumeric() || "._-".contains(c);
    if machine.is_empty() || machine.starts_with('.') || !machine.chars().all(letter) {
        return Err(ShipError::Name(machine.to_owned()));
    }
    let trouble = |path: &Path, error| ShipError::Spool { path: path.to_owned(), error };
    let folder = UntrustedFolder::open(spool).map_err(|e| trouble(spool, e))?;
    finish_begun(&folder).map_err(|e| trouble(spool, e))?;
    let waiting = waiting(&folder).map_err(|e| trouble(spool, e))?;
    let mut round = ShippingResult::default();
    if !waiting.is_empty() {
        // Checked before the first record is sent. A record that cannot be moved would be sent again and
        // again.
        let tried = format!(".tried-{}", std::process::id());
        let sent = folder.make_folder(SENT).and_then(|sent| {
            sent.write(&tried, b"", 0o600, &|| true)?;
            sent.remove(&tried)
        });
        sent.map_err(|e| trouble(&spool.join(SENT), e))?;
    }
    for (n, name) in waiting.iter().enumerate() {
        let sidecar = spool.join(name);
        let files = match read_waiting(&folder, &sidecar, name) {
            Ok(Some(read)) => read,
            Ok(None) => continue,
            Err(finding) => {
                round.kept.push(finding);
                continue;
            }
        };
        let digest =
            hex(&files.iter().fold(Sha256::new(), |h, f| h.chain_update(Sha256::digest(&f.1))).finalize());
        let digits = &digest[..DIGITS];
        let place = format!("inbox/{machine}/{digits}");
        // The sidecar last.
        for (file, bytes) in &files {
            let key = format!("{place}/{file}");
            let failed = |error| ShipError::Store { key: key.clone(), error, left: waiting.len() - n };
            if store.get(&key).map_err(failed)?.as_ref() == Some(bytes) {
                continue;
            }
            store.put(&key, bytes).map_err(failed)?;
            if store.get(&key).map_err(failed)?.as_ref() != Some(bytes) {
                return Err(failed(io::Error::other("what was read back is not what was sent")));
            }
        }
        let put_aside = || -> io::Result<()> {
            let sending = folder.make_folder(&format!("{SENDING}{digits}"))?;
            let _held = sending.lock();
            // The sidecar first, because no record waits without it.
            for (file, _) in files.iter().rev() {
                match folder.rename(file, &sending, file) {
                    // Another process is moving this record, or it was sent before.
                    Err(e) if e.kind() == io::ErrorKind::NotFound => {}
                    done => done?,
                }
            }
            move_to_sent(&folder, &sending, digits)
        };
        match put_aside() {
            Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(trouble(&sidecar, e)),
            _ => {}
        }
        round.sent.push(place);
    }
    Ok(round)
}

/// Reads a waiting record: its CSV and its sidecar, each with its name.
/// Returns `None` if another process that sends from this spool has sent it.
///
/// # Errors
/// Why it is no record, so that it stays in the spool.
fn read_waiting(folder: &UntrustedFolder, sidecar: &Path, name: &str) -> Result<Option<Files>, InputError> {
    let read = |file: &str, longest, expected| {
        folder.read(file, longest).map_err(|e| InputError::whole(sidecar, e.to_string(), expected))
    };
    let Some(words) = read(name, LONGEST_SIDECAR, "a record's sidecar")? else { return Ok(None) };
    let text = rtec_files::text_file::decode(sidecar, &words)?;
    let csv = super::run_record_files::csv_name(sidecar, &text)?;
    let Some(data) = read(&csv, LONGEST_SENT, "a CSV beside it")? else {
        if read(name, LONGEST_SIDECAR, "a record's sidecar")?.is_none() {
            return Ok(None);
        }
        let expected = "the CSV that it names, in the same folder";
        return Err(InputError::whole(sidecar, format!("no file {csv} beside it"), expected));
    };
    super::run_record_files::parse_log(sidecar, &text, io::Cursor::new(&data))?;
    Ok(Some([(csv, data), (name.to_owned(), words)]))
}

/// Moves a sent record to the sent ones.
/// Its sidecar is in the folder `sending` already.
fn move_to_sent(folder: &UntrustedFolder, sending: &UntrustedFolder, digits: &str) -> io::Result<()> {
    let names = sending.names()?;
    // A kill between the two moves leaves the CSV in the spool. The sidecar names it, and no other record
    // does.
    for sidecar in names.iter().filter(|n| n.ends_with(".run.toml") && !folder.has(n).unwrap_or(true)) {
        let words = sending.read(sidecar, LONGEST_SIDECAR)?.unwrap_or_default();
        let text = String::from_utf8_lossy(&words);
        if let Ok(csv) = super::run_record_files::csv_name(&sending.path().join(sidecar), &text)
            && folder.has(&csv)?
        {
            folder.rename(&csv, sending, &csv)?;
        }
    }
    let sent = folder.make_folder(SENT)?.make_folder(digits)?;
    for file in sending.names()? {
        match sending.rename(&file, &sent, &file) {
            // The same bytes are there already, because the folder is named by their digest.
            Err(e) if e.kind() == io::ErrorKind::AlreadyExists => sending.remove(&file)?,
            Err(e) if e.kind() == io::ErrorKind::NotFound => {}
            done => done?,
        }
    }
    match folder.remove_folder(&format!("{SENDING}{digits}")) {
        Err(e) if e.kind() != io::ErrorKind::NotFound => Err(e),
        _ => folder.sync(),
    }
}

/// A record's CSV and its sidecar: name and bytes.
type Files = [(String, Vec<u8>); 2];

/// Names of the sidecars of a spool, in order.
fn waiting(folder: &UntrustedFolder) -> io::Result<Vec<String>> {
    let mut names = folder.names()?;
    names.retain(|n| n.ends_with(".run.toml") && !n.starts_with('.'));
    Ok(names)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::{Cell, RefCell};
    use std::collections::BTreeMap;

    /// A store that fails before its nth call, or in the middle of it.
    /// It keeps complete files.
    struct Flaky {
        calls: Cell<usize>,
        gone_at: usize,
        torn: bool,
        held: RefCell<BTreeMap<String, Vec<u8>>>,
        puts: RefCell<BTreeMap<String, usize>>,
    }

    impl Flaky {
        fn call(&self) -> io::Result<()> {
            self.calls.set(self.calls.get() + 1);
            if self.calls.get() == self.gone_at { Err(io::ErrorKind::ConnectionReset.into()) } else { Ok(()) }
        }
    }

    impl RecordStore for Flaky {
        fn put(&self, key: &str, bytes: &[u8]) -> io::Result<()> {
            let gone = self.call();
            if gone.is_err() && self.torn {
                self.held.borrow_mut().insert(key.to_owned(), bytes[..bytes.len() / 2].to_vec());
            }
            gone?;
            *self.puts.borrow_mut().entry(key.to_owned()).or_default() += 1;
            self.held.borrow_mut().insert(key.to_owned(), bytes.to_vec());
            Ok(())
        }

        fn get(&self, key: &str) -> io::Result<Option<Vec<u8>>> {
            self.call()?;
            Ok(self.held.borrow().get(key).cloned())
        }
    }

    fn waits(spool: &Path) -> Vec<String> {
        waiting(&UntrustedFolder::open(spool).unwrap()).unwrap()
    }

    fn names(folder: &Path) -> Vec<String> {
        UntrustedFolder::open(folder).unwrap().names().unwrap()
    }

    fn record(folder: &Path, name: &str, value: f64) {
        let sidecar = format!(
            "file = \"{name}.csv\"\nkind = \"drift\"\n[columns]\ne = {{ role = \"error.z\", unit = \"um\" }}\n"
        );
        std::fs::write(folder.join(format!("{name}.csv")), format!("e\n{value}\n2.5\n")).unwrap();
        std::fs::write(folder.join(format!("{name}.run.toml")), sidecar).unwrap();
    }

    #[test]
    fn a_store_that_goes_away_at_any_moment_loses_nothing_and_takes_nothing_twice() {
        for torn in [false, true] {
            for gone_at in 1..20 {
                let spool = tempfile::tempdir().unwrap();
                for (name, value) in [("a", 1.0), ("b", 2.0), ("c", 3.0)] {
                    record(spool.path(), name, value);
                }
                let store = Flaky {
                    calls: Cell::new(0),
                    gone_at,
                    torn,
                    held: RefCell::default(),
                    puts: RefCell::default(),
                };
                let first = ship(spool.path(), &store, "mill-7");
                // Six files, with three calls each.
                assert_eq!(first.is_err(), gone_at <= 18, "{gone_at}");
                let second = ship(spool.path(), &store, "mill-7").unwrap();
                assert!(second.kept.is_empty());
                let held = store.held.borrow();
                assert_eq!(held.len(), 6, "{gone_at}: {:?}", held.keys());
                assert!(store.puts.borrow().values().all(|n| *n == 1), "{gone_at}");
                let mut values: Vec<&[u8]> = held
                    .iter()
                    .filter(|(k, _)| !k.ends_with(".run.toml"))
                    .map(|(_, v)| v.as_slice())
                    .collect();
                values.sort_unstable();
                assert_eq!(values, [&b"e\n1\n2.5\n"[..], b"e\n2\n2.5\n", b"e\n3\n2.5\n"]);
                assert!(waits(spool.path()).is_empty());
                assert_eq!(std::fs::read_dir(spool.path().join(SENT)).unwrap().count(), 3);
            }
        }
    }

    #[test]
    fn the_same_record_again_is_one_and_a_broken_one_stays() {
        let (spool, to) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let store = FolderStore::open(to.path()).unwrap();
        record(spool.path(), "a", 1.0);
        std::fs::write(spool.path().join("b.run.toml"), "kind = 3\n").unwrap();
        let round = ship(spool.path(), &store, "m").unwrap();
        assert_eq!((round.sent.len(), round.kept.len()), (1, 1));
        assert!(spool.path().join("b.run.toml").exists());
        record(spool.path(), "a", 1.0);
        std::fs::remove_dir_all(spool.path().join(SENT)).unwrap();
        assert_eq!(ship(spool.path(), &store, "m").unwrap().sent, round.sent);
        assert_eq!(std::fs::read_dir(to.path().join("inbox/m")).unwrap().count(), 1);
        // A share that is not mounted is not created.
        drop(to);
        record(spool.path(), "c", 4.0);
        assert!(matches!(ship(spool.path(), &store, "m"), Err(ShipError::Store { left: 1, .. })));
        assert!(matches!(ship(spool.path(), &store, "../m"), Err(ShipError::Name(_))));
    }

    /// A store whose spool is sent by another process too.
    struct Beside<'a> {
        spool: &'a Path,
        store: &'a FolderStore,
        calls: Cell<usize>,
        at: usize,
    }

    impl Beside<'_> {
        fn call(&self) {
            self.calls.set(self.calls.get() + 1);
            if self.calls.get() == self.at {
                ship(self.spool, self.store, "m").unwrap();
            }
        }
    }

    impl RecordStore for Beside<'_> {
        fn put(&self, key: &str, bytes: &[u8]) -> io::Result<()> {
            self.call();
            self.store.put(key, bytes)
        }

        fn get(&self, key: &str) -> io::Result<Option<Vec<u8>>> {
            self.call();
            self.store.get(key)
        }
    }

    #[test]
    fn two_who_send_from_one_spool_lose_nothing_and_stop_at_nothing() {
        for at in 1..=14 {
            let (spool, to) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
            for (name, value) in [("a", 1.0), ("b", 2.0), ("c", 3.0)] {
                record(spool.path(), name, value);
            }
            let folder = FolderStore::open(to.path()).unwrap();
            let store = Beside { spool: spool.path(), store: &folder, calls: Cell::new(0), at };
            let round = ship(spool.path(), &store, "m").unwrap();
            assert!(round.kept.is_empty(), "{at}: {:?}", round.kept);
            assert!(waits(spool.path()).is_empty(), "{at}");
            assert_eq!(std::fs::read_dir(to.path().join("inbox/m")).unwrap().count(), 3, "{at}");
            assert_eq!(std::fs::read_dir(spool.path().join(SENT)).unwrap().count(), 3, "{at}");
        }
    }

    #[test]
    fn a_spool_that_cannot_be_written_sends_nothing() {
        let (spool, to) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        record(spool.path(), "a", 1.0);
        // A file is in the place of the folder for sent records.
        std::fs::write(spool.path().join(SENT), "").unwrap();
        let store = FolderStore::open(to.path()).unwrap();
        assert!(matches!(ship(spool.path(), &store, "m"), Err(ShipError::Spool { .. })));
        assert!(std::fs::read_dir(to.path()).unwrap().next().is_none());
    }

    #[test]
    fn a_record_is_spooled_under_a_name_of_its_own() {
        let (made, spool) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        record(made.path(), "a", 1.0);
        let sidecar = made.path().join("a.run.toml");
        let first = add(&sidecar, spool.path()).unwrap();
        record(made.path(), "a", 2.0);
        let second = add(&sidecar, spool.path()).unwrap();
        let value = |p: &Path| crate::run_record_files::read(p).unwrap().columns[0].data[0];
        assert_eq!((value(&first), value(&second)), (1.0, 2.0));
        assert_eq!(
            waits(spool.path()),
            [second, first].map(|p| p.file_name().unwrap().to_str().unwrap().to_owned())
        );
    }

    fn read_back(folder: &Path, name: &str) -> Record {
        crate::run_record_files::read(&folder.join(format!("{name}.run.toml"))).unwrap()
    }

    #[test]
    fn ship_follows_no_link_out_of_the_shop_or_the_spool() {
        use std::os::unix::fs::symlink;
        // Each place of a key is a link elsewhere: nothing is written there, and the record waits.
        let away = tempfile::tempdir().unwrap();
        for linked in ["inbox", "inbox/m", "inbox/m/DIGEST"] {
            let (spool, shop) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
            record(spool.path(), "a", 1.0);
            let store = FolderStore::open(shop.path()).unwrap();
            let place = {
                let other = tempfile::tempdir().unwrap();
                record(other.path(), "a", 1.0);
                ship(
                    other.path(),
                    &FolderStore::open(tempfile::tempdir().unwrap().keep().as_path()).unwrap(),
                    "m",
                )
            };
            let linked = shop.path().join(linked.replace("inbox/m/DIGEST", &place.unwrap().sent[0]));
            std::fs::create_dir_all(linked.parent().unwrap()).unwrap();
            symlink(away.path(), &linked).unwrap();
            let error = ship(spool.path(), &store, "m").unwrap_err().to_string();
            assert!(error.contains("found a link") && error.contains("1 records wait"), "{error}");
            assert!(names(away.path()).is_empty());
            assert_eq!(waits(spool.path()), ["a.run.toml"]);
        }
        // A link in the place of the file itself is replaced.
        let (spool, shop) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        record(spool.path(), "a", 1.0);
        let first = ship(spool.path(), &FolderStore::open(shop.path()).unwrap(), "m").unwrap().sent.remove(0);
        let precious = away.path().join("precious");
        std::fs::write(&precious, "mine").unwrap();
        for file in ["a.csv", "a.run.toml"] {
            let at = shop.path().join(&first).join(file);
            std::fs::remove_file(&at).unwrap();
            symlink(&precious, &at).unwrap();
        }
        record(spool.path(), "a", 1.0);
        let error =
            ship(spool.path(), &FolderStore::open(shop.path()).unwrap(), "m").unwrap_err().to_string();
        assert!(error.contains("found a link"), "{error}");
        assert_eq!(std::fs::read(&precious).unwrap(), b"mine");
        // Nothing is read through a link in the spool, or from another folder.
        let (spool, shop) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        record(away.path(), "far", 1.0);
        symlink(away.path().join("far.run.toml"), spool.path().join("a.run.toml")).unwrap();
        symlink(away.path().join("far.csv"), spool.path().join("far.csv")).unwrap();
        let words = std::fs::read_to_string(away.path().join("far.run.toml")).unwrap();
        std::fs::write(spool.path().join("b.run.toml"), &words).unwrap();
        for (name, file) in
            [("c", away.path().join("far.csv").display().to_string()), ("d", "../far.csv".to_owned())]
        {
            std::fs::write(spool.path().join(format!("{name}.run.toml")), words.replace("far.csv", &file))
                .unwrap();
        }
        let round = ship(spool.path(), &FolderStore::open(shop.path()).unwrap(), "m").unwrap();
        assert_eq!((round.sent.len(), round.kept.len()), (0, 4), "{round:?}");
        assert!(names(shop.path()).is_empty());
    }

    #[test]
    fn whoever_is_killed_leaves_a_whole_record_or_none() {
        // A kill while putting: before the sidecar, after it, and between the two renames.
        for (files, kept) in [(&["csv"][..], false), (&["csv", "a.run.toml"], true), (&["a.run.toml"], true)]
        {
            let (made, spool) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
            record(made.path(), "a", 7.0);
            let begun = spool.path().join(format!("{PUTTING}1-1"));
            std::fs::create_dir(&begun).unwrap();
            for file in files {
                let from = if *file == "csv" { "a.csv" } else { file };
                std::fs::copy(made.path().join(from), begun.join(file)).unwrap();
            }
            if files.len() == 1 && kept {
                std::fs::copy(made.path().join("a.csv"), spool.path().join("a.csv")).unwrap();
            }
            record(made.path(), "b", 8.0);
            add(&made.path().join("b.run.toml"), spool.path()).unwrap();
            let expected: &[&str] =
                if kept { &["a.csv", "a.run.toml", "b.csv", "b.run.toml"] } else { &["b.csv", "b.run.toml"] };
            assert_eq!(names(spool.path()), expected, "{files:?}");
            if kept {
                assert!((read_back(spool.path(), "a").columns[0].data[0] - 7.0).abs() < 1e-12);
            }
        }
        // A kill while moving a sent record: after the sidecar, and after both.
        for both in [false, true] {
            let (spool, shop) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
            record(spool.path(), "a", 1.0);
            let sending = spool.path().join(format!("{SENDING}0123"));
            std::fs::create_dir(&sending).unwrap();
            std::fs::rename(spool.path().join("a.run.toml"), sending.join("a.run.toml")).unwrap();
            if both {
                std::fs::rename(spool.path().join("a.csv"), sending.join("a.csv")).unwrap();
            }
            ship(spool.path(), &FolderStore::open(shop.path()).unwrap(), "m").unwrap();
            assert_eq!(names(spool.path()), [SENT]);
            assert_eq!(names(&spool.path().join("sent/0123")), ["a.csv", "a.run.toml"]);
        }
        // The folder of a living process is left alone.
        let (made, spool) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let folder = UntrustedFolder::open(spool.path()).unwrap();
        let begun = folder.make_folder(&format!("{PUTTING}1-1")).unwrap();
        let _held = begun.lock().unwrap().unwrap();
        record(made.path(), "b", 8.0);
        add(&made.path().join("b.run.toml"), spool.path()).unwrap();
        assert_eq!(names(spool.path()).len(), 3);
    }

    #[test]
    fn a_spool_takes_no_more_than_its_room() {
        let (made, spool) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        record(made.path(), "a", 1.0);
        let put_one = |limits: SpoolLimits, go_on: &dyn Fn() -> bool| {
            let record = read_back(made.path(), "a");
            let csv = std::fs::read(made.path().join("a.csv")).unwrap();
            put(record, &csv, spool.path(), limits, go_on)
        };
        let limits = SpoolLimits { most_bytes: 1 << 20, free_percent: 0 };
        let mut kept = 0;
        let error = loop {
            match put_one(limits, &|| true) {
                Ok(_) => kept += 1,
                Err(error) => break error,
            }
            assert!(kept < 1000);
        };
        // Two files of one block each.
        assert!((100..=128).contains(&kept), "{kept}");
        assert_eq!(error.kind(), io::ErrorKind::StorageFull);
        assert!(error.to_string().contains("at most 1 MB may wait ([control] spool_mb)"), "{error}");
        // A large disk that is nearly full has room for a small spool.
        put_one(SpoolLimits { most_bytes: 4 << 20, free_percent: 101 }, &|| true).unwrap();
        let files = names(spool.path()).len();
        let error = put_one(SpoolLimits { most_bytes: u64::MAX, free_percent: 101 }, &|| true).unwrap_err();
        assert!(error.to_string().contains("No space left for records"), "{error}");
        let error = put_one(SpoolLimits::ANY, &|| false).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::Interrupted);
        assert_eq!(names(spool.path()).len(), files);
        let mut odd = read_back(made.path(), "a");
        odd.path = PathBuf::from("a\u{202e}b.run.toml");
        let error = put(odd, b"e\n1\n", spool.path(), SpoolLimits::ANY, &|| true).unwrap_err();
        assert!(error.to_string().contains("expected one that can be read"), "{error}");
    }
}
