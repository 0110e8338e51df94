//! Puts finished records into the spool folder (`[control] spool`).
//! From there `rtecctl ship` sends them to the shop.
//!
//! | record | where it comes from |
//! |---|---|
//! | a probing run | the trips from `probe on` to its end: positions and temperatures without a measured error, so it is a log |
//! | any other | a client that recorded it hands it over (`keep`), and the loader reads it |
//!
//! Each record is written by a thread of its own. A disk that is full, missing or hanging costs the record, and an
//! event reports that.

use rtec_control::config::{ConfiguredAxis, ControlConfig};
use rtec_control::protocol::ProbeTripReport;
use rtec_files::InputError;
use rtec_files::date;
use rtec_files::message_text::{quoted, unseen};
use rtec_model::record::{Column, Record, Role, RunKind, check};
use rtec_records::run_record_files::{parse_log, to_csv, to_sidecar};
use rtec_records::spool::{self, SpoolLimits};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;

/// Number of trips in a record; the next trip begins another record.
const TRIPS: usize = 50_000;
/// Largest number of threads that hang on a disk.
const HANGING: usize = 4;
/// Share of the spool's disk that stays free, %.
const FREE_PERCENT: u64 = 5;

/// One trip of the probe, at the same time for all axes.
struct ProbeTrip {
    at_ns: [u64; 2],
    /// Position of each axis, mm.
    position_mm: Vec<Option<f64>>,
    degc: Vec<Option<f64>>,
}

/// A probing run under way.
struct ProbingRun {
    /// Time of its begin: on the card's clock, ns, and in seconds since 1970.
    began_ns: u64,
    began_s: f64,
    trips: Vec<ProbeTrip>,
}

/// Result of a record: its file, or why it was not kept.
pub(crate) type SpoolResult = Result<PathBuf, String>;

/// A spool folder with its limits.
#[derive(Debug, Clone)]
pub(crate) struct SpoolFolder {
    pub folder: PathBuf,
    pub limits: SpoolLimits,
}

impl SpoolFolder {
    /// The spool that the configuration names.
    pub(crate) fn of(control: &ControlConfig) -> Option<Self> {
        let limits = SpoolLimits { most_bytes: control.spool_mb << 20, free_percent: FREE_PERCENT };
        control.spool.clone().map(|folder| Self { folder, limits })
    }

    fn put(&self, record: Record, csv: &[u8], go_on: &dyn Fn() -> bool) -> Result<PathBuf, String> {
        let Self { folder, limits } = self;
        spool::put(record, csv, folder, *limits, go_on).map_err(|error| {
            if folder.is_dir() { format!("{}: {error}", folder.display()) } else { no_folder(folder) }
        })
    }
}

/// Writes records into the spool folder, with the probing run under way.
pub(crate) struct RecordSpoolWriter {
    spool: Option<SpoolFolder>,
    /// Names of the temperature sensors, with their indices among all sensors.
    sensors: Vec<(usize, String)>,
    run: Option<ProbingRun>,
    results: (Sender<SpoolResult>, Receiver<SpoolResult>),
    writing: usize,
}

impl RecordSpoolWriter {
    pub(crate) fn new(spool: Option<SpoolFolder>, sensors: Vec<(usize, String)>) -> Self {
        if let Some(SpoolFolder { folder, .. }) = spool.clone() {
            // Finishes the work of a killed daemon. Nobody waits for the disk; without a thread the next record does
            // it.
            let _ = std::thread::Builder::new().name("spool".into()).spawn(move || spool::finish(&folder));
        }
        Self { spool, sensors, run: None, results: channel(), writing: 0 }
    }

    pub(crate) fn spool(&self) -> Option<&SpoolFolder> {
        self.spool.as_ref()
    }

    /// The problem that keeps records from being kept, if any.
    pub(crate) fn trouble(&self) -> Option<String> {
        let folder = self.spool.as_ref().map(|s| &s.folder).filter(|f| !f.is_dir())?;
        Some(format!("[control] spool: {}", no_folder(folder)))
    }

    /// Begins a probing run.
    pub(crate) fn begin(&mut self, began_ns: u64, began_s: f64) {
        self.run = self.spool.is_some().then(|| ProbingRun { began_ns, began_s, trips: Vec::new() });
    }

    /// Adds one axis at a trip; the axes of one trip come one after the other.
    pub(crate) fn trip(&mut self, axis: usize, axes: &[ConfiguredAxis], trip: &ProbeTripReport, now_s: f64) {
        let Some(run) = &mut self.run else { return };
        if run.trips.last().is_none_or(|t| t.at_ns != trip.at_ns || t.position_mm[axis].is_some()) {
            if run.trips.len() == TRIPS {
                let next = ProbingRun { began_ns: trip.at_ns[0], began_s: now_s, trips: Vec::new() };
                let full = std::mem::replace(run, next);
                self.write(&full, axes);
                return self.trip(axis, axes, trip, now_s);
            }
            let (position_mm, degc) = (vec![None; axes.len()], trip.degc.clone());
            run.trips.push(ProbeTrip { at_ns: trip.at_ns, position_mm, degc });
        }
        if let Some(last) = run.trips.last_mut() {
            last.position_mm[axis] = Some(trip.position_mm);
        }
    }

    /// Ends the probing run and writes its trips.
    pub(crate) fn end(&mut self, axes: &[ConfiguredAxis]) {
        if let Some(run) = self.run.take().filter(|r| !r.trips.is_empty()) {
            self.write(&run, axes);
        }
    }

    fn write(&mut self, run: &ProbingRun, axes: &[ConfiguredAxis]) {
        let Some(spool) = self.spool.clone() else { return };
        let trips = run.trips.len();
        let lost = move |why: &str| format!("a probing run of {trips} trips is not kept: {why}");
        let done = self.results.0.clone();
        self.writing += 1;
        if self.writing > HANGING {
            let _ = done.send(Err(lost(&format!("{} does not answer", spool.folder.display()))));
            return;
        }
        let Some(record) = record(run, axes, &self.sensors) else {
            let _ = done.send(Err(lost("no axis was seen at every trip")));
            return;
        };
        let written = std::thread::Builder::new().name("spool".into()).spawn({
            let done = done.clone();
            move || {
                let csv = to_csv(&record);
                let kept = spool.put(record, csv.as_bytes(), &|| true);
                // At the end of the daemon the receiver may have gone.
                let _ = done.send(kept.map_err(|why| lost(&why)));
            }
        });
        if let Err(error) = written {
            let _ = done.send(Err(lost(&format!("no thread to write it: {error}"))));
        }
    }

    /// The next finished record, if any.
    pub(crate) fn done(&mut self) -> Option<SpoolResult> {
        let done = self.results.1.try_recv().ok()?;
        self.writing -= 1;
        Some(done)
    }

    /// The next finished record at the daemon's end.
    /// It waits for the disk, but at most `patience`.
    pub(crate) fn last(&mut self, patience: Duration) -> Option<SpoolResult> {
        if self.writing == 0 {
            return None;
        }
        self.writing -= 1;
        self.results.1.recv_timeout(patience).ok()
    }
}

/// Reads a record that a client hands over and puts it into the folder.
/// `go_on` returns `false` once this takes too long. The record is then not kept.
///
/// # Errors
/// When it is no record, or cannot be written.
pub(crate) fn take_over(
    name: &Path,
    sidecar: &str,
    csv: &[u8],
    spool: &SpoolFolder,
    go_on: &dyn Fn() -> bool,
) -> Result<SpoolResult, InputError> {
    // The record must be valid in its new place too. Only one of the two is in memory at a time.
    let words =
        to_sidecar(&parse_log(name, sidecar, InterruptibleReader { bytes: io::Cursor::new(csv), go_on })?);
    let record = parse_log(name, &words, InterruptibleReader { bytes: io::Cursor::new(csv), go_on })?;
    let texts = record.columns.iter().map(|c| &c.name).chain(&record.note).chain(&record.zero);
    let file = record.path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    if let Some((text, c)) = texts.chain([&file]).find_map(|text| Some((text, unseen(text)?))) {
        let found = format!("{} with the character U+{:04X}", quoted(text), u32::from(c));
        return Err(InputError::whole(name, found, "names and notes of characters that can be seen"));
    }
    let kept = spool.put(record, csv, go_on);
    Ok(kept.map_err(|why| format!("the record is not kept: {why}")))
}

/// Bytes that end when reading takes too long.
struct InterruptibleReader<'a> {
    bytes: io::Cursor<&'a [u8]>,
    go_on: &'a dyn Fn() -> bool,
}

impl io::Read for InterruptibleReader<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if (self.go_on)() { self.bytes.read(buffer) } else { Err(io::Error::other("it took too long")) }
    }
}

impl io::Seek for InterruptibleReader<'_> {
    fn seek(&mut self, to: io::SeekFrom) -> io::Result<u64> {
        self.bytes.seek(to)
    }
}

fn no_folder(folder: &Path) -> String {
    format!(
        "{} is no folder: no record is kept until it is one that the daemon may write to",
        folder.display()
    )
}

/// A probing run as a record with one row for each trip.
/// An axis or a sensor that was not known at every trip has no column.
fn record(run: &ProbingRun, axes: &[ConfiguredAxis], sensors: &[(usize, String)]) -> Option<Record> {
    let seconds =
        |t: &ProbeTrip| u64::midpoint(t.at_ns[0], t.at_ns[1]).saturating_sub(run.began_ns) as f64 / 1e9;
    let good = |role: &Role, data: &[f64]| data.iter().all(|v| check(role, *v, None).is_ok());
    let mut columns = vec![Column::new("t", Role::Time, run.trips.iter().map(seconds).collect())];
    let mut counts_um = Vec::new();
    for (n, axis) in axes.iter().enumerate() {
        let name = format!("position.{}", axis.name);
        let data: Option<Vec<f64>> = run.trips.iter().map(|t| t.position_mm[n]).collect();
        if let (Some(role), Some(data)) = (Role::parse(&name), data)
            && good(&role, &data)
        {
            columns.push(Column::new(&name, role, data));
            counts_um.push(axis.count_um);
        }
    }
    if counts_um.is_empty() {
        return None;
    }
    for (place, name) in sensors {
        let data: Option<Vec<f64>> =
            run.trips.iter().map(|t| t.degc.get(*place).copied().flatten()).collect();
        if let Some(data) = data.filter(|d| good(&Role::Temperature, d))
            && !columns.iter().any(|c| c.name == *name)
        {
            columns.push(Column::new(name, Role::Temperature, data));
        }
    }
    let (day, of_day) = ((run.began_s / 86_400.0) as i64, (run.began_s % 86_400.0) as u64);
    let day = date::format(day);
    let time = format!("{:02}{:02}{:02}", of_day / 3600, of_day / 60 % 60, of_day % 60);
    let name = format!("probing-{}-{time}.run.toml", day.replace('-', ""));
    let mut record = Record::of_checked(Path::new(&name), RunKind::Probing, columns);
    record.date = Some(day);
    // One value for all axes, or none. The values are configured and not computed, so they compare exactly.
    counts_um.dedup_by(|a, b| a.to_bits() == b.to_bits());
    record.count_um = Some(counts_um[0]).filter(|_| counts_um.len() == 1);
    record.note = Some("captured by rtecd while probing, without correction".to_owned());
    Some(record)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rtec_control::config::Config;

    fn report(t_ns: u64, position_mm: f64, degc: Vec<Option<f64>>) -> ProbeTripReport {
        ProbeTripReport {
            position_counts: position_mm * 1000.0,
            position_mm,
            uncertainty_counts: 0.5,
            uncertainty_um: 0.5,
            at_ns: [t_ns, t_ns + 2],
            error_um: None,
            corrected_mm: None,
            degc,
        }
    }

    fn probed(record_spool: &mut RecordSpoolWriter, trips: usize) {
        let axes = Config::embedded().axes;
        // 2026-08-01 10:15:02.
        record_spool.begin(1_000_000_000, 1_785_579_302.0);
        for n in 0..trips {
            let t_ns = 2_000_000_000 + n as u64 * 500_000_000;
            for axis in [0, 2] {
                let mm = n as f64 + 100.0 * axis as f64;
                record_spool.trip(
                    axis,
                    &axes,
                    &report(t_ns, mm, vec![Some(20.5), (n > 0).then_some(21.0)]),
                    0.0,
                );
            }
        }
        record_spool.end(&axes);
    }

    fn spool(folder: &Path) -> SpoolFolder {
        SpoolFolder { folder: folder.to_owned(), limits: SpoolLimits::ANY }
    }

    fn sensors() -> Vec<(usize, String)> {
        vec![(0, "T1".to_owned()), (1, "T2".to_owned())]
    }

    #[test]
    fn a_probing_run_is_a_record_of_what_was_known_at_every_trip() {
        let folder = tempfile::tempdir().unwrap();
        let mut record_spool = RecordSpoolWriter::new(Some(spool(folder.path())), sensors());
        probed(&mut record_spool, 3);
        let file = record_spool.last(Duration::from_secs(60)).unwrap().unwrap();
        assert_eq!(file, folder.path().join("probing-20260801-101502.run.toml"));
        let record = rtec_records::run_record_files::read_log(&file).unwrap();
        let names: Vec<&str> = record.columns.iter().map(|c| c.name.as_str()).collect();
        // The second axis was never known, the second sensor not at the first trip.
        assert_eq!(names, ["t", "position.x", "position.z", "T1"]);
        assert_eq!(record.columns[0].data, [1.000_000_001, 1.500_000_001, 2.000_000_001]);
        assert_eq!(record.columns[2].data, [200.0, 201.0, 202.0]);
        assert_eq!((record.kind.name(), record.date.as_deref()), ("probing", Some("2026-08-01")));
        // Another run within the same second is another record. A run without a trip is no record.
        probed(&mut record_spool, 1);
        assert!(
            record_spool
                .last(Duration::from_secs(60))
                .unwrap()
                .unwrap()
                .ends_with("probing-20260801-101502-2.run.toml")
        );
        probed(&mut record_spool, 0);
        assert!(record_spool.last(Duration::ZERO).is_none());
    }

    #[test]
    fn a_run_without_an_end_becomes_records_of_a_bounded_length() {
        let folder = tempfile::tempdir().unwrap();
        let mut record_spool = RecordSpoolWriter::new(Some(spool(folder.path())), sensors());
        probed(&mut record_spool, TRIPS + 2);
        let mut rows = Vec::new();
        for _ in 0..2 {
            let file = record_spool.last(Duration::from_secs(60)).unwrap().unwrap();
            rows.push(rtec_records::run_record_files::read_log(&file).unwrap().rows());
        }
        rows.sort_unstable();
        assert_eq!(rows, [2, TRIPS]);
    }

    #[test]
    fn a_folder_that_is_gone_costs_the_record_and_says_so() {
        let folder = tempfile::tempdir().unwrap();
        let mut record_spool = RecordSpoolWriter::new(Some(spool(&folder.path().join("gone"))), sensors());
        assert!(record_spool.trouble().unwrap().contains("is no folder"));
        probed(&mut record_spool, 4);
        let why = record_spool.last(Duration::from_secs(60)).unwrap().unwrap_err();
        assert!(why.contains("4 trips is not kept") && why.contains("is no folder"), "{why}");
        // Without a spool no run is kept in memory either.
        let mut record_spool = RecordSpoolWriter::new(None, sensors());
        probed(&mut record_spool, 4);
        assert!(record_spool.last(Duration::ZERO).is_none() && record_spool.trouble().is_none());
    }

    const SIDECAR: &str =
        "file = 'a.csv'\nkind = 'drift'\n[columns]\ne = { role = 'error.z', unit = 'um' }\n";

    #[test]
    fn a_name_that_a_terminal_would_obey_is_not_kept() {
        let folder = tempfile::tempdir().unwrap();
        let taken = |name: &str, sidecar: &str, csv: &str| {
            take_over(Path::new(name), sidecar, csv.as_bytes(), &spool(folder.path()), &|| true)
        };
        let escape = "\\u001b[2J";
        for (name, sidecar, csv) in [
            ("a\u{1b}[2J.run.toml", SIDECAR.to_owned(), "e\n1\n"),
            ("a\u{202e}.run.toml", SIDECAR.to_owned(), "e\n1\n"),
            ("a.run.toml", SIDECAR.replace("\ne =", &format!("\n\"e{escape}\" =")), "\"e\u{1b}[2J\"\n1\n"),
            ("a.run.toml", SIDECAR.replace("kind", &format!("note = \"{escape}\"\nkind")), "e\n1\n"),
            ("a.run.toml", SIDECAR.replace("kind", &format!("zero = \"{escape}\"\nkind")), "e\n1\n"),
        ] {
            let error = taken(name, &sidecar, csv).unwrap_err().to_string();
            assert!(error.contains("that can be seen"), "{error}");
            assert!(unseen(&error).is_none(), "{error:?}");
        }
        assert!(std::fs::read_dir(folder.path()).unwrap().next().is_none());
        taken("a.run.toml", SIDECAR, "e\n1\n").unwrap().unwrap();
    }

    #[test]
    fn what_takes_too_long_is_not_kept() {
        let folder = tempfile::tempdir().unwrap();
        let (looks, csv) = (std::cell::Cell::new(0), "e\n".to_owned() + &"1\n".repeat(1 << 17));
        // Given up at each check: while it is read, read again, and written.
        for most in 1.. {
            looks.set(0);
            let go_on = || {
                looks.set(looks.get() + 1);
                looks.get() < most
            };
            let kept =
                take_over(Path::new("a.run.toml"), SIDECAR, csv.as_bytes(), &spool(folder.path()), &go_on);
            if looks.get() < most {
                assert!(kept.unwrap().is_ok() && most > 6, "{most}");
                return;
            }
            assert!(!matches!(kept, Ok(Ok(_))), "{most}");
            assert!(std::fs::read_dir(folder.path()).unwrap().next().is_none(), "{most}");
        }
    }
}
