//! Files that a request names, read and made ready by a thread of their own: one at a time, regular files only, within
//! limits of size and time. The control side goes on meanwhile.

use crate::keeper::{Kept, take_over};
use rtec_control::protocol::PartTable;
use rtec_correct::corrector::{Prepared, Preparer};
use rtec_correct::sensors::Watch;
use rtec_files::{InputError, text};
use rtec_model::effect::Dictionary;
use rtec_model::machine::Machine;
use rtec_part::cor::FeatureErrors;
use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::fs::File;
use std::os::fd::OwnedFd;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant};

/// All files of a request together are no longer than this, bytes.
const LONGEST: u64 = 2 << 20;
/// And a record with its CSV: a day of twenty columns, each second.
const LONGEST_RECORD: u64 = 64 << 20;
/// A part has no more points.
const POINTS: usize = 20_000;
/// A load that takes longer is given up.
pub(crate) const PATIENCE: Duration = Duration::from_secs(8);
/// Of the time between two evaluations a model may take so much.
const SHARE: f64 = 0.25;

/// Where the files of a request are.
#[derive(Debug)]
pub(crate) enum Source {
    /// Where their names say: files that the daemon may open for its caller.
    Named,
    /// The caller's own descriptors, by name.
    Handed(BTreeMap<PathBuf, OwnedFd>),
    /// What was read before.
    Kept(BTreeMap<PathBuf, String>),
}

/// Rows of logged temperatures, oldest first, of the sensors of these names: time, s, and °C.
type History = Box<dyn Fn(&[String]) -> Vec<(f64, Vec<f64>)> + Send>;

/// What became of a load.
type Done = (Ticket, Result<Loaded, InputError>);

/// What is to be read.
pub(crate) enum Job {
    /// A machine model, to be made ready.
    Model {
        file: PathBuf,
        source: Source,
        preparer: Box<Preparer>,
        watches: Vec<Watch>,
        /// Logged temperatures of the sensors of these names.
        past: History,
        now_s: f64,
        period: Duration,
    },
    /// A part's errors.
    Table { table: PartTable, source: Source },
    /// A finished record: its sidecar and its CSV, for the spool folder.
    Keep { files: [PathBuf; 2], source: Source, folder: PathBuf },
}

/// What was read.
pub(crate) enum Loaded {
    /// A model, what is to be said of it, and its files as they were read.
    Model { prepared: Box<Prepared>, warnings: Vec<String>, files: BTreeMap<PathBuf, String> },
    /// A part's errors.
    Table { table: PartTable, errors: FeatureErrors },
    /// What became of a record.
    Kept(Kept),
}

/// One load.
pub(crate) type Ticket = u64;

/// One thread that loads, or none.
pub(crate) struct Loader {
    results: (Sender<Done>, Receiver<Done>),
    /// What is being loaded, and since when; also after it has been given up.
    running: Option<(Ticket, Instant)>,
    next: Ticket,
}

impl Loader {
    pub(crate) fn new() -> Self {
        Self { results: channel(), running: None, next: 1 }
    }

    pub(crate) fn busy(&self) -> bool {
        self.running.is_some()
    }

    /// Starts a load; to be asked for only where none is running.
    ///
    /// # Errors
    /// The system gives no thread.
    pub(crate) fn start(&mut self, job: Job) -> std::io::Result<Ticket> {
        let (ticket, done) = (self.next, self.results.0.clone());
        std::thread::Builder::new().name("loader".into()).spawn(move || {
            // Nobody may be waiting any more.
            let _ = done.send((ticket, work(job)));
        })?;
        self.next += 1;
        self.running = Some((ticket, Instant::now()));
        Ok(ticket)
    }

    /// What has been loaded since the last time.
    pub(crate) fn done(&mut self) -> Option<Done> {
        let done = self.results.1.try_recv().ok()?;
        self.running = None;
        Some(done)
    }

    /// The load that has taken too long, whose caller is to be told.
    pub(crate) fn overdue(&self) -> Option<Ticket> {
        self.running.filter(|(_, since)| since.elapsed() > PATIENCE).map(|(ticket, _)| ticket)
    }
}

/// Does a job, on whichever thread.
pub(crate) fn work(job: Job) -> Result<Loaded, InputError> {
    match job {
        Job::Model { file, source, preparer, watches, past, now_s, period } => {
            let reader = Reader::new(&source);
            let text = reader.read(&file)?;
            let machine =
                Machine::parse_from(&file, &text, Dictionary::default(), &|beside| reader.read(beside))?;
            // Records beside a model that was handed over are the caller's to look at.
            let warnings =
                if matches!(source, Source::Named) { machine.changed_sources() } else { Vec::new() };
            let prepared = preparer.prepare(machine, &watches, &*past)?;
            let (takes, may) = (prepared.evaluation_time(&preparer, now_s), period.mul_f64(SHARE));
            if takes > may {
                let found = format!("a model whose evaluation takes {:.1} ms", takes.as_secs_f64() * 1e3);
                let expected = format!("at most {:.1} ms: fewer effects", may.as_secs_f64() * 1e3);
                return Err(InputError::whole(&file, found, expected));
            }
            let files = reader.taken();
            Ok(Loaded::Model { prepared: Box::new(prepared), warnings, files })
        }
        Job::Table { table, source } => {
            let file = PathBuf::from(&table.errors);
            let errors = FeatureErrors::parse(&file, &Reader::new(&source).read(&file)?)?;
            if errors.len() > POINTS {
                let found = format!("{} points", errors.len());
                return Err(InputError::whole(&file, found, format!("at most {POINTS}")));
            }
            Ok(Loaded::Table { table, errors })
        }
        Job::Keep { files: [sidecar, csv], source, folder } => {
            let reader = Reader::of(&source, LONGEST_RECORD);
            let (text, rows) = (reader.read(&sidecar)?, reader.read(&csv)?);
            Ok(Loaded::Kept(take_over(&sidecar, &text, &rows, &folder)?))
        }
    }
}

/// Reads the files of one job, and knows what it has read.
struct Reader<'s> {
    source: &'s Source,
    longest: u64,
    /// Bytes that may still come.
    left: Cell<u64>,
    taken: RefCell<BTreeMap<PathBuf, String>>,
}

impl<'s> Reader<'s> {
    fn new(source: &'s Source) -> Self {
        Self::of(source, LONGEST)
    }

    fn of(source: &'s Source, longest: u64) -> Self {
        Self { source, longest, left: Cell::new(longest), taken: RefCell::default() }
    }

    fn read(&self, path: &Path) -> Result<String, InputError> {
        let content = match self.source {
            Source::Kept(files) => files.get(path).cloned().ok_or_else(|| missing(path))?,
            Source::Handed(files) => {
                let fd = files.get(path).ok_or_else(|| missing(path))?;
                let file = fd.try_clone().map_err(|e| text::unreadable(path, &e))?;
                self.decode(path, &File::from(file))?
            }
            Source::Named => {
                // Without waiting, and through no pipe: as every file that a person names.
                self.decode(path, &text::open_regular(path)?)?
            }
        };
        self.taken.borrow_mut().insert(path.to_owned(), content.clone());
        Ok(content)
    }

    fn decode(&self, path: &Path, file: &File) -> Result<String, InputError> {
        let unreadable = |e: std::io::Error| text::unreadable(path, &e);
        if !file.metadata().map_err(unreadable)?.is_file() {
            return Err(InputError::whole(path, "a folder, pipe, socket or device", "a regular file"));
        }
        let (mut content, mut buffer) = (Vec::new(), vec![0; 64 << 10]);
        loop {
            // From its beginning, wherever the caller has read to.
            let n = file.read_at(&mut buffer, content.len() as u64).map_err(unreadable)?;
            content.extend_from_slice(&buffer[..n]);
            if content.len() as u64 > self.left.get() {
                let longest = self.longest;
                let found = format!("more than {longest} bytes in all");
                return Err(InputError::whole(path, found, "shorter files"));
            }
            if n == 0 {
                break;
            }
        }
        self.left.set(self.left.get() - content.len() as u64);
        text::decode(path, &content)
    }

    fn taken(self) -> BTreeMap<PathBuf, String> {
        self.taken.into_inner()
    }
}

fn missing(path: &Path) -> InputError {
    InputError::whole(
        path,
        "a file that did not come with the request",
        "every file that the first one names",
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(file: &Path) -> PartTable {
        PartTable {
            errors: file.display().to_string(),
            axes: ["z".into(), "x".into()],
            centre_mm: Some([0.0, 0.0]),
            radius_mm: Some(10.0),
            nose_mm: 0.5,
            hollow: false,
            origin_mm: [0.0, 0.0],
            lead_ms: 0.0,
        }
    }

    fn refused(file: &Path) -> String {
        match work(Job::Table { table: table(file), source: Source::Named }) {
            Ok(_) => panic!("{} was read", file.display()),
            Err(error) => error.to_string(),
        }
    }

    #[test]
    fn pipes_devices_and_what_is_too_long_are_refused_at_once() {
        let directory = tempfile::tempdir().unwrap();
        let pipe = directory.path().join("pipe");
        nix::unistd::mkfifo(&pipe, nix::sys::stat::Mode::S_IRWXU).unwrap();
        for file in [&pipe, Path::new("/dev/zero"), Path::new("/dev/stdin"), directory.path()] {
            assert!(refused(file).contains("expected a regular file"), "{}", refused(file));
        }
        let long = directory.path().join("long");
        File::create(&long).unwrap().set_len(LONGEST + 1).unwrap();
        assert!(refused(&long).contains("more than 2097152 bytes"), "{}", refused(&long));
        let many = directory.path().join("many");
        let rows: String =
            (0..=POINTS).map(|n| format!("{:.4} 1", n as f64 * 1e-4)).collect::<Vec<_>>().join("\n");
        std::fs::write(&many, rows).unwrap();
        assert!(refused(&many).contains("20001 points"), "{}", refused(&many));
    }

    #[test]
    fn what_was_handed_over_is_read_through_its_descriptor_only() {
        let directory = tempfile::tempdir().unwrap();
        let file = directory.path().join("error.cor");
        std::fs::write(&file, "0 1\n1 2\n").unwrap();
        let open = File::open(&file).unwrap();
        std::fs::remove_file(&file).unwrap();
        let files = BTreeMap::from([(file.clone(), OwnedFd::from(open))]);
        let job = Job::Table { table: table(&file), source: Source::Handed(files) };
        assert!(matches!(work(job), Ok(Loaded::Table { errors, .. }) if errors.len() == 2));
        let job =
            Job::Table { table: table(Path::new("/etc/passwd")), source: Source::Handed(BTreeMap::new()) };
        let Err(error) = work(job) else { panic!("read") };
        assert!(error.to_string().contains("did not come with the request"), "{error}");
    }
}
