//! Finished records on their way to the shop: a spool folder that they wait in, and the store that they are sent to.
//!
//! A record is sent as `inbox/MACHINE/DIGEST/NAME.run.toml` with its CSV beside it; the digest is of both, so that the same record
//! has the same place however often it is sent. The sidecar goes last: where it stands, the record is whole. Only what was read back
//! from the store as it was sent leaves the spool, for `sent/` below it.

use rtec_files::{InputError, write};
use rtec_model::record::{Record, hex};
use sha2::{Digest, Sha256};
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

/// Where sent records are kept, below the spool.
pub const SENT: &str = "sent";
/// Digits of a digest that stand in a record's place.
const DIGITS: usize = 16;

/// What takes records: keys are paths with `/`.
pub trait Store {
    /// Stores bytes under a key, whole or not at all.
    ///
    /// # Errors
    /// The store is not to be reached, or does not take it.
    fn put(&self, key: &str, bytes: &[u8]) -> io::Result<()>;

    /// What stands under a key.
    ///
    /// # Errors
    /// The store is not to be reached.
    fn get(&self, key: &str) -> io::Result<Option<Vec<u8>>>;
}

/// A folder: of this computer, or a share that is mounted.
#[derive(Debug, Clone)]
pub struct Folder(PathBuf);

impl Folder {
    /// A folder that is there: one that is missing is a share that is not mounted, and is not made.
    ///
    /// # Errors
    /// No such folder.
    pub fn open(path: &Path) -> io::Result<Self> {
        if path.is_dir() { Ok(Self(path.to_owned())) } else { Err(io::Error::from(io::ErrorKind::NotFound)) }
    }
}

impl Store for Folder {
    fn put(&self, key: &str, bytes: &[u8]) -> io::Result<()> {
        if !self.0.is_dir() {
            return Err(io::Error::from(io::ErrorKind::NotFound));
        }
        let path = self.0.join(key);
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder)?;
        }
        write::whole(&path, bytes)
    }

    fn get(&self, key: &str) -> io::Result<Option<Vec<u8>>> {
        match std::fs::read(self.0.join(key)) {
            Ok(bytes) => Ok(Some(bytes)),
            Err(e) if e.kind() == io::ErrorKind::NotFound && self.0.is_dir() => Ok(None),
            Err(e) => Err(e),
        }
    }
}

/// What one round of sending did.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Round {
    /// Places of the records that the store now holds, in order.
    pub sent: Vec<String>,
    /// Records that are none, and stay where they are: each with its finding.
    pub kept: Vec<InputError>,
}

impl Round {
    /// What is printed of it: the places, and how many; or one JSON document, in a line.
    #[must_use]
    pub fn text(&self, json: bool) -> String {
        if json {
            let kept: Vec<String> = self.kept.iter().map(ToString::to_string).collect();
            return format!("{}\n", serde_json::json!({"sent": self.sent, "kept": kept}));
        }
        let places = self.sent.iter().fold(String::new(), |all, place| all + place + "\n");
        format!("{places}{} records sent, {} kept\n", self.sent.len(), self.kept.len())
    }

    /// What is no record and stays in the spool, in a line; none where nothing does.
    #[must_use]
    pub fn stays(&self, spool: &Path) -> Option<String> {
        let n = self.kept.len();
        (n > 0).then(|| format!("{n} records stay in {}", spool.display()))
    }
}

/// Why sending ended early. What was sent before is sent; what was not waits.
#[derive(Debug, thiserror::Error)]
pub enum ShipError {
    /// The name of the machine would not be one folder of the store.
    #[error(
        "found the machine's name `{0}`, expected letters, digits, `.`, `_` and `-`, none of the dots first"
    )]
    Name(String),
    /// The spool cannot be read, or what was sent cannot be put aside.
    #[error("{path}: {error}")]
    Spool {
        /// The file or folder.
        path: PathBuf,
        /// Why.
        error: io::Error,
    },
    /// The store is not to be reached, or lost what it was given.
    #[error("the store: {key}: {error}; {left} records wait in the spool")]
    Store {
        /// What was on its way.
        key: String,
        /// Why.
        error: io::Error,
        /// Records that wait, this one among them.
        left: usize,
    },
}

/// Puts a written record into a spool, which is made where it is missing.
///
/// # Errors
/// The record cannot be read, the spool not be written.
pub fn add(sidecar: &Path, spool: &Path) -> io::Result<PathBuf> {
    let record = super::record::read_log(sidecar).map_err(|e| no_record(&e))?;
    let csv = std::fs::read(sidecar.parent().unwrap_or(Path::new("")).join(&record.file))?;
    std::fs::create_dir_all(spool)?;
    put(record, &csv, spool)
}

/// Puts a record into a spool that is there: its CSV, then its sidecar, each whole; under the record's own name, or with a
/// number behind it where another one waits under that name.
///
/// # Errors
/// The spool cannot be written: what was begun is taken away again.
pub fn put(mut record: Record, csv: &[u8], spool: &Path) -> io::Result<PathBuf> {
    let name = record.path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let stem = name.strip_suffix(".run.toml").unwrap_or(&name).to_owned();
    let mut n = 1;
    let at = loop {
        let tail = if n == 1 { String::new() } else { format!("-{n}") };
        let at = spool.join(format!("{stem}{tail}.run.toml"));
        super::record::at(&mut record, &at).map_err(|e| no_record(&e))?;
        // The CSV's name is taken first, so that two who come at once take two.
        match File::options().write(true).create_new(true).open(spool.join(&record.file)) {
            Ok(_) if at.exists() => std::fs::remove_file(spool.join(&record.file))?,
            Ok(_) => break at,
            Err(e) if e.kind() == io::ErrorKind::AlreadyExists => {}
            Err(e) => return Err(e),
        }
        n += 1;
    };
    let csv_at = spool.join(&record.file);
    let written = write::whole(&csv_at, csv)
        .and_then(|()| write::whole(&at, super::record::to_sidecar(&record).as_bytes()));
    if let Err(error) = written {
        let _ = std::fs::remove_file(csv_at);
        return Err(error);
    }
    Ok(at)
}

fn no_record(finding: &InputError) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, finding.to_string())
}

/// Sends what waits in a spool, one record after the other.
///
/// # Errors
/// The first failure of the store or of the spool.
pub fn ship(spool: &Path, store: &dyn Store, machine: &str) -> Result<Round, ShipError> {
    let letter = |c: char| c.is_ascii_alphanumeric() || "._-".contains(c);
    if machine.is_empty() || machine.starts_with('.') || !machine.chars().all(letter) {
        return Err(ShipError::Name(machine.to_owned()));
    }
    let waiting = waiting(spool).map_err(|error| ShipError::Spool { path: spool.to_owned(), error })?;
    let mut round = Round::default();
    if !waiting.is_empty() {
        // Before the first is sent, not after it: what cannot be put aside would be sent again and again.
        let sent = spool.join(SENT);
        let tried = sent.join(".tried");
        let made = std::fs::create_dir_all(&sent)
            .and_then(|()| std::fs::write(&tried, ""))
            .and_then(|()| std::fs::remove_file(&tried));
        // One who sends beside this one may have taken it away already.
        match made {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                return Err(ShipError::Spool { path: sent, error });
            }
            _ => {}
        }
    }
    for (n, sidecar) in waiting.iter().enumerate() {
        let (name, csv) = match super::record::read_log(sidecar) {
            // Another one who sends from this spool has sent it.
            Err(_) if !sidecar.exists() => continue,
            Ok(record) => {
                (sidecar.file_name().unwrap_or_default().to_string_lossy().into_owned(), record.file)
            }
            Err(finding) => {
                round.kept.push(finding);
                continue;
            }
        };
        let of = |path: PathBuf| match std::fs::read(&path) {
            Ok(bytes) => Ok(Some((path, bytes))),
            Err(_) if !sidecar.exists() => Ok(None),
            Err(error) => Err(ShipError::Spool { path, error }),
        };
        let (Some(data), Some(words)) = (of(spool.join(&csv))?, of(sidecar.clone())?) else { continue };
        let files = [data, words];
        let digest =
            hex(&files.iter().fold(Sha256::new(), |h, f| h.chain_update(Sha256::digest(&f.1))).finalize());
        let place = format!("inbox/{machine}/{}", &digest[..DIGITS]);
        // The sidecar last.
        for ((_, bytes), file) in files.iter().zip([&csv, &name]) {
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
        let sent = spool.join(SENT).join(&digest[..DIGITS]);
        let aside =
            |path: &Path| ShipError::Spool { path: path.to_owned(), error: io::Error::last_os_error() };
        std::fs::create_dir_all(&sent).map_err(|_| aside(&sent))?;
        // The sidecar first: without it nothing waits.
        for (from, file) in [(&files[1].0, &name), (&files[0].0, &csv)] {
            match std::fs::rename(from, sent.join(file)) {
                // Another one who sends from this spool has put it aside, the same files to the same place.
                Err(e) if e.kind() == io::ErrorKind::NotFound && sent.join(file).exists() => {}
                done => done.map_err(|_| aside(from))?,
            }
        }
        round.sent.push(place);
    }
    Ok(round)
}

/// Sidecars of a spool, in order of their names.
fn waiting(spool: &Path) -> io::Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(spool)? {
        let path = entry?.path();
        if path.is_file() && path.to_string_lossy().ends_with(".run.toml") {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::{Cell, RefCell};
    use std::collections::BTreeMap;

    /// A store that goes away before its nth call, or in the middle of it; what it was given in full it keeps.
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

    impl Store for Flaky {
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
                // Six files of three calls each.
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
                assert!(waiting(spool.path()).unwrap().is_empty());
                assert_eq!(std::fs::read_dir(spool.path().join(SENT)).unwrap().count(), 3);
            }
        }
    }

    #[test]
    fn the_same_record_again_is_one_and_a_broken_one_stays() {
        let (spool, to) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let store = Folder::open(to.path()).unwrap();
        record(spool.path(), "a", 1.0);
        std::fs::write(spool.path().join("b.run.toml"), "kind = 3\n").unwrap();
        let round = ship(spool.path(), &store, "m").unwrap();
        assert_eq!((round.sent.len(), round.kept.len()), (1, 1));
        assert!(spool.path().join("b.run.toml").exists());
        record(spool.path(), "a", 1.0);
        std::fs::remove_dir_all(spool.path().join(SENT)).unwrap();
        assert_eq!(ship(spool.path(), &store, "m").unwrap().sent, round.sent);
        assert_eq!(std::fs::read_dir(to.path().join("inbox/m")).unwrap().count(), 1);
        // A share that is not mounted is not made.
        drop(to);
        record(spool.path(), "c", 4.0);
        assert!(matches!(ship(spool.path(), &store, "m"), Err(ShipError::Store { left: 1, .. })));
        assert!(matches!(ship(spool.path(), &store, "../m"), Err(ShipError::Name(_))));
    }

    /// A store beside which somebody else sends from the same spool.
    struct Beside<'a> {
        spool: &'a Path,
        store: &'a Folder,
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

    impl Store for Beside<'_> {
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
            let folder = Folder::open(to.path()).unwrap();
            let store = Beside { spool: spool.path(), store: &folder, calls: Cell::new(0), at };
            let round = ship(spool.path(), &store, "m").unwrap();
            assert!(round.kept.is_empty(), "{at}: {:?}", round.kept);
            assert!(waiting(spool.path()).unwrap().is_empty(), "{at}");
            assert_eq!(std::fs::read_dir(to.path().join("inbox/m")).unwrap().count(), 3, "{at}");
            assert_eq!(std::fs::read_dir(spool.path().join(SENT)).unwrap().count(), 3, "{at}");
        }
    }

    #[test]
    fn a_spool_that_cannot_be_written_sends_nothing() {
        let (spool, to) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        record(spool.path(), "a", 1.0);
        // A file where the folder of what was sent should be.
        std::fs::write(spool.path().join(SENT), "").unwrap();
        let store = Folder::open(to.path()).unwrap();
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
        let value = |p: &Path| crate::record::read(p).unwrap().columns[0].data[0];
        assert_eq!((value(&first), value(&second)), (1.0, 2.0));
        assert_eq!(waiting(spool.path()).unwrap(), [second, first].map(|p| p));
    }
}
