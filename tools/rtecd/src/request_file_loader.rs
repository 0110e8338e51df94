//! A thread that reads and prepares the files of a request.
//! It reads one at a time, regular files only, within limits of size and time. The control side continues meanwhile.

use crate::record_spool::{SpoolFolder, SpoolResult, take_over};
use rtec_control::protocol::PartTable;
use rtec_correct::corrector::{ModelPreparer, PreparedModel};
use rtec_files::{InputError, text_file};
use rtec_model::effect::Dictionary;
use rtec_model::machine::Machine;
use rtec_part::error_cor_file::FeatureErrors;
use rtec_records::spool::LONGEST_SIDECAR;
use rtec_sensors::temperature_log::history;
use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::fs::File;
use std::os::fd::OwnedFd;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant};

/// Largest size of a model's files together, bytes.
/// A parsed TOML takes some 150 times its bytes in memory.
const LONGEST_MODEL: u64 = 2 << 20;
/// Largest size of a part's errors, bytes.
const LONGEST_ERRORS: u64 = 2 << 20;
/// Largest size of a record's CSV, bytes: a day of twenty columns, each second.
/// Its columns take at most four times as much memory.
const LONGEST_CSV: u64 = 32 << 20;
/// Largest number of points of a part.
const POINTS: usize = 20_000;
/// Time after which a load is given up.
pub(crate) const PATIENCE: Duration = Duration::from_secs(8);
/// Number of hanging loads at which nothing more is loaded.
/// They were given up, but still wait for a file system.
const HANGING: usize = 2;
/// Largest share of the control period that a model's evaluation may take.
const SHARE: f64 = 0.25;

/// Source of a request's files.
#[derive(Debug)]
pub(crate) enum FileSource {
    /// The named paths, which the daemon may open for its caller.
    Named,
    /// The caller's own descriptors, by path.
    Handed(BTreeMap<PathBuf, OwnedFd>),
    /// Texts that were read before.
    Kept(BTreeMap<PathBuf, String>),
}

/// Result of a load.
type LoadResult = (Ticket, Result<LoadedFiles, InputError>);

/// A load that is requested.
pub(crate) enum LoadRequest {
    /// A machine model, to be prepared.
    Model {
        file: PathBuf,
        source: FileSource,
        preparer: Box<ModelPreparer>,
        /// The directory of the temperatures' log.
        log: PathBuf,
        period: Duration,
    },
    /// A part's errors.
    Table { table: PartTable, source: FileSource },
    /// A finished record with sidecar and CSV, for the spool folder.
    Keep { files: [PathBuf; 2], source: FileSource, spool: SpoolFolder },
}

/// The loaded files.
pub(crate) enum LoadedFiles {
    /// A model, its warnings, and its files as they were read.
    Model { prepared: Box<PreparedModel>, warnings: Vec<String>, files: BTreeMap<PathBuf, String> },
    /// A part's errors.
    Table { table: PartTable, errors: FeatureErrors },
    /// The result of a record.
    Kept(SpoolResult),
}

/// Number of a load.
pub(crate) type Ticket = u64;

/// Flags between a load and the loader.
#[derive(Debug, Default)]
pub(crate) struct LoadFlags {
    /// The load must end.
    given_up: AtomicBool,
    /// The thread is reading a file.
    /// A read that hangs waits there and uses no processor time.
    reads: AtomicBool,
}

impl LoadFlags {
    fn go_on(&self) -> bool {
        !self.given_up.load(Ordering::Relaxed)
    }
}

/// The load under way.
struct LoadUnderWay {
    ticket: Ticket,
    since: Instant,
    flags: Arc<LoadFlags>,
}

/// The loader, with at most one load under way.
pub(crate) struct RequestFileLoader {
    results: (Sender<LoadResult>, Receiver<LoadResult>),
    running: Option<LoadUnderWay>,
    /// Loads that were given up and have not ended yet.
    hanging: Vec<(Ticket, Arc<LoadFlags>)>,
    next: Ticket,
}

impl RequestFileLoader {
    pub(crate) fn new() -> Self {
        Self { results: channel(), running: None, hanging: Vec::new(), next: 1 }
    }

    /// Why nothing can be loaded now.
    pub(crate) fn busy(&self) -> Option<&'static str> {
        // A given-up load that still computes has the processor for itself, because another would slow it down.
        let computes = self.hanging.iter().any(|(_, told)| !told.reads.load(Ordering::Relaxed));
        if self.running.is_some() || computes {
            return Some("another file is being loaded: ask again when it is done");
        }
        let hangs = "two loads that were given up have not ended: end what their file systems wait for, or restart the daemon";
        (self.hanging.len() >= HANGING).then_some(hangs)
    }

    /// Starts a load. The caller checks first that none is running.
    ///
    /// # Errors
    /// When the system gives no thread.
    pub(crate) fn start(&mut self, job: LoadRequest) -> std::io::Result<Ticket> {
        let (ticket, done) = (self.next, self.results.0.clone());
        let told = Arc::<LoadFlags>::default();
        let own = Arc::clone(&told);
        std::thread::Builder::new().name("loader".into()).spawn(move || {
            // The receiver may have gone.
            let _ = done.send((ticket, work(job, &own)));
        })?;
        self.next += 1;
        self.running = Some(LoadUnderWay { ticket, since: Instant::now(), flags: told });
        Ok(ticket)
    }

    /// The next finished load, and whether it was given up before.
    pub(crate) fn done(&mut self) -> Option<(LoadResult, bool)> {
        let done = self.results.1.try_recv().ok()?;
        let before = self.hanging.len();
        self.hanging.retain(|(ticket, _)| *ticket != done.0);
        let given_up = self.hanging.len() < before;
        if !given_up {
            self.running = None;
        }
        Some((done, given_up))
    }

    /// Gives up the load if it takes too long; its caller must then get an answer.
    pub(crate) fn give_up(&mut self) -> Option<Ticket> {
        let LoadUnderWay { ticket, flags: told, .. } =
            self.running.take_if(|r| r.since.elapsed() > PATIENCE)?;
        told.given_up.store(true, Ordering::Relaxed);
        self.hanging.push((ticket, told));
        Some(ticket)
    }
}

/// Does a load on the calling thread.
pub(crate) fn work(job: LoadRequest, told: &LoadFlags) -> Result<LoadedFiles, InputError> {
    match job {
        LoadRequest::Model { file, source, preparer, log, period } => {
            let reader = LoadFileReader::new(&source, LONGEST_MODEL, told);
            let text = reader.read(&file)?;
            let machine =
                Machine::parse_from(&file, &text, Dictionary::default(), &|beside| reader.read(beside))?;
            // Records named by a model that was handed over are the caller's own business.
            let warnings =
                if matches!(source, FileSource::Named) { machine.changed_sources() } else { Vec::new() };
            let past = |names: &[String]| history(&log, names, preparer.sensed_s());
            let prepared = preparer.prepare(machine, &past)?;
            let (takes, may) = (prepared.evaluation_time(&preparer), period.mul_f64(SHARE));
            if takes > may {
                let found = format!("a model whose evaluation takes {:.1} ms", takes.as_secs_f64() * 1e3);
                let expected = format!("at most {:.1} ms: fewer effects", may.as_secs_f64() * 1e3);
                return Err(InputError::whole(&file, found, expected));
            }
            let files = reader.taken.into_inner();
            Ok(LoadedFiles::Model { prepared: Box::new(prepared), warnings, files })
        }
        LoadRequest::Table { table, source } => {
            let file = PathBuf::from(&table.errors);
            let bytes = LoadFileReader::new(&source, LONGEST_ERRORS, told).bytes(&file)?;
            let errors = FeatureErrors::parse(&file, &text_file::decode_western(&file, &bytes)?.0)?;
            if errors.len() > POINTS {
                let found = format!("{} points", errors.len());
                return Err(InputError::whole(&file, found, format!("at most {POINTS}")));
            }
            Ok(LoadedFiles::Table { table, errors })
        }
        LoadRequest::Keep { files: [sidecar, csv], source, spool } => {
            let text = LoadFileReader::new(&source, LONGEST_SIDECAR, told).read(&sidecar)?;
            let rows = LoadFileReader::new(&source, LONGEST_CSV, told).bytes(&csv)?;
            Ok(LoadedFiles::Kept(take_over(&sidecar, &text, &rows, &spool, &|| told.go_on())?))
        }
    }
}

/// Reads the files of one load, and keeps their texts.
struct LoadFileReader<'s> {
    source: &'s FileSource,
    longest: u64,
    /// Number of bytes that may still be read.
    left: Cell<u64>,
    flags: &'s LoadFlags,
    taken: RefCell<BTreeMap<PathBuf, String>>,
}

impl<'s> LoadFileReader<'s> {
    fn new(source: &'s FileSource, longest: u64, told: &'s LoadFlags) -> Self {
        Self { source, longest, left: Cell::new(longest), flags: told, taken: RefCell::default() }
    }

    fn read(&self, path: &Path) -> Result<String, InputError> {
        let content = match self.source {
            FileSource::Kept(files) => files.get(path).cloned().ok_or_else(|| missing(path))?,
            _ => text_file::decode(path, &self.bytes(path)?)?,
        };
        self.taken.borrow_mut().insert(path.to_owned(), content.clone());
        Ok(content)
    }

    fn bytes(&self, path: &Path) -> Result<Vec<u8>, InputError> {
        self.flags.reads.store(true, Ordering::Relaxed);
        let bytes = self.bytes_of(path);
        self.flags.reads.store(false, Ordering::Relaxed);
        bytes
    }

    fn bytes_of(&self, path: &Path) -> Result<Vec<u8>, InputError> {
        let unreadable = |e: std::io::Error| text_file::unreadable(path, &e);
        let file = match self.source {
            FileSource::Handed(files) => {
                let fd = files.get(path).ok_or_else(|| missing(path))?;
                File::from(fd.try_clone().map_err(unreadable)?)
            }
            // Opened without waiting and not as a pipe, as every file that a person names.
            FileSource::Named => text_file::open_regular(path)?,
            FileSource::Kept(_) => return Err(missing(path)),
        };
        let found = file.metadata().map_err(unreadable)?;
        if !found.is_file() {
            return Err(InputError::whole(path, "a folder, pipe, socket or device", "a regular file"));
        }
        let too_long = || {
            let found = format!("more than {} bytes in all", self.longest);
            InputError::whole(path, found, "shorter files")
        };
        // Checked before any byte is read. A file that grows meanwhile is found below.
        if found.len() > self.left.get() {
            return Err(too_long());
        }
        let (mut content, mut buffer) = (Vec::with_capacity(found.len() as usize), vec![0; 64 << 10]);
        loop {
            if !self.flags.go_on() {
                let found = "a file that takes too long to read";
                return Err(InputError::whole(path, found, "a disk that answers"));
            }
            // From its beginning, wherever the caller has read to.
            let n = file.read_at(&mut buffer, content.len() as u64).map_err(unreadable)?;
            content.extend_from_slice(&buffer[..n]);
            if content.len() as u64 > self.left.get() {
                return Err(too_long());
            }
            if n == 0 {
                break;
            }
        }
        self.left.set(self.left.get() - content.len() as u64);
        Ok(content)
    }
}

fn missing(path: &Path) -> InputError {
    let found = "a file that did not come with the request";
    InputError::whole(path, found, "every file that the first one names")
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
        match work(
            LoadRequest::Table { table: table(file), source: FileSource::Named },
            &LoadFlags::default(),
        ) {
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
        File::create(&long).unwrap().set_len(LONGEST_ERRORS + 1).unwrap();
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
        let job = LoadRequest::Table { table: table(&file), source: FileSource::Handed(files) };
        assert!(
            matches!(work(job, &LoadFlags::default()), Ok(LoadedFiles::Table { errors, .. }) if errors.len() == 2)
        );
        let job = LoadRequest::Table {
            table: table(Path::new("/etc/passwd")),
            source: FileSource::Handed(BTreeMap::new()),
        };
        let Err(error) = work(job, &LoadFlags::default()) else { panic!("read") };
        assert!(error.to_string().contains("did not come with the request"), "{error}");
    }

    #[test]
    fn each_kind_of_file_has_its_own_bound() {
        let directory = tempfile::tempdir().unwrap();
        let at = |name: &str| directory.path().join(name);
        let spool = SpoolFolder {
            folder: directory.path().to_owned(),
            limits: rtec_records::spool::SpoolLimits::ANY,
        };
        for (sidecar, csv, bound) in
            [(LONGEST_SIDECAR + 1, 1, LONGEST_SIDECAR), (1, LONGEST_CSV + 1, LONGEST_CSV)]
        {
            for (name, bytes) in [("a.run.toml", sidecar), ("a.csv", csv)] {
                let file = File::create(at(name)).unwrap();
                std::io::Write::write_all(&mut &file, b"#").unwrap();
                file.set_len(bytes).unwrap();
            }
            let files = [at("a.run.toml"), at("a.csv")];
            let job = LoadRequest::Keep { files, source: FileSource::Named, spool: spool.clone() };
            let Err(error) = work(job, &LoadFlags::default()) else { panic!("kept") };
            assert!(error.to_string().contains(&format!("more than {bound} bytes")), "{error}");
        }
    }

    #[test]
    fn a_load_that_was_given_up_ends_and_others_go_on() {
        let directory = tempfile::tempdir().unwrap();
        let file = directory.path().join("error.cor");
        std::fs::write(&file, "0 1\n1 2\n").unwrap();
        let mut loader = RequestFileLoader::new();
        for n in 0..HANGING {
            assert!(loader.busy().is_none(), "{n}");
            // A load that hangs in a file system: it is not under way, and its result has not come.
            let told = Arc::new(LoadFlags { reads: true.into(), ..LoadFlags::default() });
            loader.hanging.push((1000 + n as Ticket, told));
        }
        assert!(loader.busy().unwrap().contains("have not ended"));
        loader.results.0.send((1000, Err(missing(&file)))).unwrap();
        assert!(loader.done().is_some_and(|(_, given_up)| given_up));
        assert!(loader.busy().is_none());
        // A load that computes is waited for.
        loader.hanging[0].1.reads.store(false, Ordering::Relaxed);
        assert!(loader.busy().unwrap().contains("another file is being loaded"));
        // A load that is given up ends without reading anything.
        let Err(error) = work(
            LoadRequest::Table { table: table(&file), source: FileSource::Named },
            &LoadFlags { given_up: true.into(), ..LoadFlags::default() },
        ) else {
            panic!("read")
        };
        assert!(error.to_string().contains("takes too long"), "{error}");
    }
}
