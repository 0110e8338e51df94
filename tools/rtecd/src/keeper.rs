//! Finished records into the spool folder (`[control] spool`), from where `rtecctl ship` sends them to the shop.
//!
//! | record | where it comes from |
//! |---|---|
//! | a probing run | here: every trip between `probe on` and its end; positions and temperatures, no error that anybody measured: a log |
//! | any other | a client that recorded it hands it over (`keep`), and the loader reads it |
//!
//! Each is written by a thread of its own: a disk that is full, gone or hanging costs a record and an event that says so.

use rtec_control::config::ConfiguredAxis;
use rtec_control::protocol::TripReport;
use rtec_measure::record::{parse_log, to_csv, to_sidecar};
use rtec_measure::spool;
use rtec_model::date;
use rtec_model::record::{Column, Kind, Record, Role, check};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;

/// A probing run of so many trips is a record; the next trip begins another.
const TRIPS: usize = 50_000;
/// Threads that may hang on a disk.
const HANGING: usize = 4;

/// One trip of the probe: the same moment for all axes.
struct Trip {
    at_ns: [u64; 2],
    /// Per axis, mm.
    position_mm: Vec<Option<f64>>,
    degc: Vec<Option<f64>>,
}

/// A probing run as it comes.
struct Run {
    /// When it began: the card's clock, ns, and seconds since 1970.
    began_ns: u64,
    began_s: f64,
    trips: Vec<Trip>,
}

/// What became of a record: the file, or why it was not kept.
pub(crate) type Kept = Result<PathBuf, String>;

/// The spool folder, and the probing run that is under way.
pub(crate) struct Keeper {
    folder: Option<PathBuf>,
    /// Names of the temperature sensors, each with its place among all sensors.
    sensors: Vec<(usize, String)>,
    run: Option<Run>,
    results: (Sender<Kept>, Receiver<Kept>),
    writing: usize,
}

impl Keeper {
    pub(crate) fn new(folder: Option<PathBuf>, sensors: Vec<(usize, String)>) -> Self {
        Self { folder, sensors, run: None, results: channel(), writing: 0 }
    }

    pub(crate) fn folder(&self) -> Option<&Path> {
        self.folder.as_deref()
    }

    /// What is to be mended before a record can be kept.
    pub(crate) fn trouble(&self) -> Option<String> {
        let folder = self.folder.as_ref().filter(|f| !f.is_dir())?;
        Some(format!("[control] spool: {}", no_folder(folder)))
    }

    /// Probing begins.
    pub(crate) fn begin(&mut self, began_ns: u64, began_s: f64) {
        self.run = self.folder.is_some().then(|| Run { began_ns, began_s, trips: Vec::new() });
    }

    /// One axis at a trip; the axes of one trip come one after the other.
    pub(crate) fn trip(&mut self, axis: usize, axes: &[ConfiguredAxis], trip: &TripReport, now_s: f64) {
        let Some(run) = &mut self.run else { return };
        if run.trips.last().is_none_or(|t| t.at_ns != trip.at_ns || t.position_mm[axis].is_some()) {
            if run.trips.len() == TRIPS {
                let next = Run { began_ns: trip.at_ns[0], began_s: now_s, trips: Vec::new() };
                let full = std::mem::replace(run, next);
                self.write(&full, axes);
                return self.trip(axis, axes, trip, now_s);
            }
            let (position_mm, degc) = (vec![None; axes.len()], trip.degc.clone());
            run.trips.push(Trip { at_ns: trip.at_ns, position_mm, degc });
        }
        if let Some(last) = run.trips.last_mut() {
            last.position_mm[axis] = Some(trip.position_mm);
        }
    }

    /// Probing has ended: what was captured is written.
    pub(crate) fn end(&mut self, axes: &[ConfiguredAxis]) {
        if let Some(run) = self.run.take().filter(|r| !r.trips.is_empty()) {
            self.write(&run, axes);
        }
    }

    fn write(&mut self, run: &Run, axes: &[ConfiguredAxis]) {
        let Some(folder) = self.folder.clone() else { return };
        let trips = run.trips.len();
        let lost = move |why: &str| format!("a probing run of {trips} trips is not kept: {why}");
        let done = self.results.0.clone();
        self.writing += 1;
        if self.writing > HANGING {
            let _ = done.send(Err(lost(&format!("{} does not answer", folder.display()))));
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
                let kept = spool::put(record, csv.as_bytes(), &folder);
                // At the end of the daemon nobody may be waiting any more.
                let _ = done.send(kept.map_err(|e| lost(&not_written(&folder, &e))));
            }
        });
        if let Err(error) = written {
            let _ = done.send(Err(lost(&format!("no thread to write it: {error}"))));
        }
    }

    /// What was written, or not, since the last time.
    pub(crate) fn done(&mut self) -> Option<Kept> {
        let done = self.results.1.try_recv().ok()?;
        self.writing -= 1;
        Some(done)
    }

    /// The same at the daemon's end: waits for the disk, but not for ever.
    pub(crate) fn last(&mut self, patience: Duration) -> Option<Kept> {
        if self.writing == 0 {
            return None;
        }
        self.writing -= 1;
        self.results.1.recv_timeout(patience).ok()
    }
}

/// A record that a client hands over: read as every record is, then put into the folder.
///
/// # Errors
/// It is no record, or cannot be written.
pub(crate) fn take_over(
    name: &Path,
    sidecar: &str,
    csv: &str,
    folder: &Path,
) -> Result<Kept, rtec_files::InputError> {
    let record = parse_log(name, sidecar, csv.as_bytes())?;
    // As it will stand in the folder, it must still be one.
    parse_log(name, &to_sidecar(&record), csv.as_bytes())?;
    let kept = spool::put(record, csv.as_bytes(), folder);
    Ok(kept.map_err(|e| format!("the record is not kept: {}", not_written(folder, &e))))
}

fn no_folder(folder: &Path) -> String {
    format!(
        "{} is no folder: no record is kept until it is one that the daemon may write to",
        folder.display()
    )
}

fn not_written(folder: &Path, error: &io::Error) -> String {
    if folder.is_dir() { format!("{}: {error}", folder.display()) } else { no_folder(folder) }
}

/// A probing run as a record: a row per trip. An axis or a sensor that was not known at every trip has no column.
fn record(run: &Run, axes: &[ConfiguredAxis], sensors: &[(usize, String)]) -> Option<Record> {
    let seconds = |t: &Trip| u64::midpoint(t.at_ns[0], t.at_ns[1]).saturating_sub(run.began_ns) as f64 / 1e9;
    let column = |name: &str, role: Role, data: Vec<f64>| {
        let unit = role.unit().unwrap_or("1").to_owned();
        Column { name: name.to_owned(), role, unit, data }
    };
    let good = |role: &Role, data: &[f64]| data.iter().all(|v| check(role, *v, None).is_ok());
    let mut columns = vec![column("t", Role::Time, run.trips.iter().map(seconds).collect())];
    let mut counts_um = Vec::new();
    for (n, axis) in axes.iter().enumerate() {
        let name = format!("position.{}", axis.name);
        let data: Option<Vec<f64>> = run.trips.iter().map(|t| t.position_mm[n]).collect();
        if let (Some(role), Some(data)) = (Role::parse(&name), data)
            && good(&role, &data)
        {
            columns.push(column(&name, role, data));
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
            columns.push(column(name, Role::Temperature, data));
        }
    }
    let (day, of_day) = ((run.began_s / 86_400.0) as i64, (run.began_s % 86_400.0) as u64);
    let day = date::format(day);
    let time = format!("{:02}{:02}{:02}", of_day / 3600, of_day / 60 % 60, of_day % 60);
    let name = format!("probing-{}-{time}.run.toml", day.replace('-', ""));
    let mut record = Record::of_checked(Path::new(&name), Kind::Probing, columns);
    record.date = Some(day);
    // One for all axes, or none: they are as configured, not computed.
    counts_um.dedup_by(|a, b| a.to_bits() == b.to_bits());
    record.count_um = Some(counts_um[0]).filter(|_| counts_um.len() == 1);
    record.note = Some("captured by rtecd while probing, without correction".to_owned());
    Some(record)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rtec_control::config::Config;

    fn report(t_ns: u64, position_mm: f64, degc: Vec<Option<f64>>) -> TripReport {
        TripReport {
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

    fn probed(keeper: &mut Keeper, trips: usize) {
        let axes = Config::embedded().axes;
        // 2026-08-01 10:15:02.
        keeper.begin(1_000_000_000, 1_785_579_302.0);
        for n in 0..trips {
            let t_ns = 2_000_000_000 + n as u64 * 500_000_000;
            for axis in [0, 2] {
                let mm = n as f64 + 100.0 * axis as f64;
                keeper.trip(axis, &axes, &report(t_ns, mm, vec![Some(20.5), (n > 0).then_some(21.0)]), 0.0);
            }
        }
        keeper.end(&axes);
    }

    fn sensors() -> Vec<(usize, String)> {
        vec![(0, "T1".to_owned()), (1, "T2".to_owned())]
    }

    #[test]
    fn a_probing_run_is_a_record_of_what_was_known_at_every_trip() {
        let folder = tempfile::tempdir().unwrap();
        let mut keeper = Keeper::new(Some(folder.path().to_owned()), sensors());
        probed(&mut keeper, 3);
        let file = keeper.last(Duration::from_secs(60)).unwrap().unwrap();
        assert_eq!(file, folder.path().join("probing-20260801-101502.run.toml"));
        let record = rtec_measure::record::read_log(&file).unwrap();
        let names: Vec<&str> = record.columns.iter().map(|c| c.name.as_str()).collect();
        // The second axis was never seen, the second sensor not at the first trip.
        assert_eq!(names, ["t", "position.x", "position.z", "T1"]);
        assert_eq!(record.columns[0].data, [1.000_000_001, 1.500_000_001, 2.000_000_001]);
        assert_eq!(record.columns[2].data, [200.0, 201.0, 202.0]);
        assert_eq!((record.kind.name(), record.date.as_deref()), ("probing", Some("2026-08-01")));
        // The same second again is another record; probing without a trip is none.
        probed(&mut keeper, 1);
        assert!(
            keeper
                .last(Duration::from_secs(60))
                .unwrap()
                .unwrap()
                .ends_with("probing-20260801-101502-2.run.toml")
        );
        probed(&mut keeper, 0);
        assert!(keeper.last(Duration::ZERO).is_none());
    }

    #[test]
    fn a_run_without_an_end_becomes_records_of_a_bounded_length() {
        let folder = tempfile::tempdir().unwrap();
        let mut keeper = Keeper::new(Some(folder.path().to_owned()), sensors());
        probed(&mut keeper, TRIPS + 2);
        let mut rows = Vec::new();
        for _ in 0..2 {
            let file = keeper.last(Duration::from_secs(60)).unwrap().unwrap();
            rows.push(rtec_measure::record::read_log(&file).unwrap().rows());
        }
        rows.sort_unstable();
        assert_eq!(rows, [2, TRIPS]);
    }

    #[test]
    fn a_folder_that_is_gone_costs_the_record_and_says_so() {
        let folder = tempfile::tempdir().unwrap();
        let mut keeper = Keeper::new(Some(folder.path().join("gone")), sensors());
        assert!(keeper.trouble().unwrap().contains("is no folder"));
        probed(&mut keeper, 4);
        let why = keeper.last(Duration::from_secs(60)).unwrap().unwrap_err();
        assert!(why.contains("4 trips is not kept") && why.contains("is no folder"), "{why}");
        // Without a spool nothing is kept in memory either.
        let mut keeper = Keeper::new(None, sensors());
        probed(&mut keeper, 4);
        assert!(keeper.last(Duration::ZERO).is_none() && keeper.trouble().is_none());
    }
}
