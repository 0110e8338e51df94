//! Temperatures: one thread per bus, and a log that a restart reads back.
//! A slow sensor so delays only those of its own kind.

use rtec_control::sources::Bank;
use rtec_correct::sensors::{SensorConfig, SensorSource, Use, Watch};
use rtec_files::{InputError, csv};
use rtec_records::record;
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{self, BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// The log, and the one before it.
const NAMES: [&str; 2] = ["temperatures.csv", "temperatures.old.csv"];
/// A log of this size becomes the old one, bytes: some days of twenty sensors.
const FULL: u64 = 16 << 20;

/// Seconds since 1970 that never jump.
/// They begin at the system's time and continue on a steady clock.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Clock {
    Steady {
        start: Instant,
        start_s: f64,
    },
    /// A test's own time, s.
    #[cfg(test)]
    At(f64),
}

impl Clock {
    pub(crate) fn new() -> Self {
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Self::Steady { start: Instant::now(), start_s: since.as_secs_f64() }
    }

    pub(crate) fn now_s(&self) -> f64 {
        match self {
            Self::Steady { start, start_s } => start_s + start.elapsed().as_secs_f64(),
            #[cfg(test)]
            Self::At(t_s) => *t_s,
        }
    }
}

type Shared = Arc<Mutex<Vec<Watch>>>;

/// All sensors, as they were last read.
pub(crate) struct Temperatures {
    clock: Clock,
    /// Written by the bus's thread, read by the control side and the log.
    buses: Vec<Shared>,
    /// Per sensor, in the configuration's order: its bus and its place there.
    places: Vec<(usize, usize)>,
    seen: Vec<Watch>,
}

impl Temperatures {
    /// Starts the threads; `directory` is where the log is kept.
    ///
    /// # Errors
    /// A recording to be replayed that cannot be read.
    pub(crate) fn start(configs: &[SensorConfig], directory: &Path, log_s: f64) -> Result<Self, InputError> {
        let clock = Clock::new();
        let mut of_bus: BTreeMap<String, Vec<(usize, SensorConfig)>> = BTreeMap::new();
        for (n, config) in configs.iter().enumerate() {
            let bus = match &config.source {
                SensorSource::Iio { .. } => "iio",
                SensorSource::Hwmon { .. } => "hwmon",
                SensorSource::OneWire { .. } => "one_wire",
                SensorSource::Csv { .. } => "csv",
                SensorSource::Line { from, .. } => from,
            };
            of_bus.entry(bus.to_owned()).or_default().push((n, config.clone()));
        }
        let mut places = vec![(0, 0); configs.len()];
        let mut buses = Vec::new();
        for members in of_bus.into_values() {
            for (k, (n, _)) in members.iter().enumerate() {
                places[*n] = (buses.len(), k);
            }
            let own = members.into_iter().map(|m| m.1).collect();
            let bank = Bank::new(own, Path::new("/"), record::read_log)?;
            let shared: Shared = Arc::new(Mutex::new(bank.sensors().to_vec()));
            buses.push(Arc::clone(&shared));
            // It may hang in a driver: nobody waits for it, its sensors grow old and are said to be silent.
            std::thread::spawn(move || listen(bank, &shared, clock));
        }
        let seen = configs.iter().cloned().map(Watch::new).collect();
        let temperatures = Self { clock, buses, places, seen };
        if !configs.is_empty() {
            let log = Log {
                directory: directory.to_owned(),
                names: configs.iter().map(|c| c.name.clone()).collect(),
                buses: temperatures.buses.clone(),
                places: temperatures.places.clone(),
            };
            std::thread::spawn(move || log.keep(clock, log_s));
        }
        Ok(temperatures)
    }

    /// Sensors that a test plays.
    #[cfg(test)]
    pub(crate) fn played(sensors: Vec<Watch>) -> Self {
        Self { clock: Clock::At(0.0), buses: Vec::new(), places: Vec::new(), seen: sensors }
    }

    /// What the played sensors read at a time, s.
    #[cfg(test)]
    pub(crate) fn play(&mut self, t_s: f64, values: &[f64]) {
        self.clock = Clock::At(t_s);
        for (watch, value) in self.seen.iter_mut().zip(values) {
            watch.offer(t_s, Ok(*value));
        }
    }

    pub(crate) fn now_s(&self) -> f64 {
        self.clock.now_s()
    }

    /// Takes over what has been read.
    /// A bus whose thread is at it right now keeps what it had.
    pub(crate) fn look(&mut self) {
        for (own, (bus, place)) in self.seen.iter_mut().zip(&self.places) {
            if let Ok(read) = self.buses[*bus].try_lock() {
                own.clone_from(&read[*place]);
            }
        }
    }

    /// The sensors, in the configuration's order.
    pub(crate) fn sensors(&self) -> &[Watch] {
        &self.seen
    }
}

fn listen(mut bank: Bank, shared: &Shared, clock: Clock) {
    let pause = Duration::from_secs_f64(bank.pause_s());
    loop {
        bank.poll(clock.now_s());
        // The lock is held for a copy only, never while a sensor is read.
        shared.lock().unwrap_or_else(PoisonError::into_inner).clone_from_slice(bank.sensors());
        std::thread::sleep(pause);
    }
}

struct Log {
    directory: PathBuf,
    names: Vec<String>,
    buses: Vec<Shared>,
    places: Vec<(usize, usize)>,
}

impl Log {
    fn keep(&self, clock: Clock, every_s: f64) {
        let mut logged = false;
        loop {
            std::thread::sleep(Duration::from_secs_f64(every_s));
            let now_s = clock.now_s();
            let values: Vec<Option<f64>> = self
                .places
                .iter()
                .map(|(bus, place)| {
                    let read = self.buses[*bus].lock().unwrap_or_else(PoisonError::into_inner);
                    let watch = &read[*place];
                    watch.value_degc().filter(|_| watch.usable(now_s) == Use::Good)
                })
                .collect();
            if let Err(error) = append(&self.directory, &self.names, now_s, &values)
                && !logged
            {
                logged = true;
                let name = self.directory.join(NAMES[0]);
                eprintln!(
                    "rtecd: warning: {}: {error}: a restart will not know the machine's heat",
                    name.display()
                );
            }
        }
    }
}

/// Adds a row; what is not good is left empty.
fn append(directory: &Path, names: &[String], now_s: f64, values: &[Option<f64>]) -> io::Result<()> {
    let [path, old] = NAMES.map(|n| directory.join(n));
    let header = format!("t,{}\n", csv::header_line(names.iter().map(String::as_str)));
    let mut begun = String::new();
    if let Ok(file) = File::open(&path) {
        let size = file.metadata()?.len();
        BufReader::new(file).read_line(&mut begun)?;
        if size > FULL || begun != header {
            std::fs::rename(&path, old)?;
            begun.clear();
        }
    }
    let mut row = if begun.is_empty() { header } else { String::new() };
    let cell = |v: &Option<f64>| v.map_or(String::new(), |v| v.to_string());
    let cells: Vec<String> = values.iter().map(cell).collect();
    row += &[format!("{now_s:.3}"), cells.join(",")].join(",");
    row.push('\n');
    // One write: a row is there whole, or torn at the very end of the file, where the reader drops it.
    OpenOptions::new().append(true).create(true).open(path)?.write_all(row.as_bytes())
}

/// The logged rows of these sensors, oldest first: time and temperatures, °C.
/// Rows where one of them is not known are left out, as is what a crash has torn and what the clock has passed twice.
pub(crate) fn history(directory: &Path, names: &[String], now_s: f64) -> Vec<(f64, Vec<f64>)> {
    let mut rows: Vec<(f64, Vec<f64>)> = Vec::new();
    for name in NAMES.iter().rev() {
        let file = directory.join(name);
        let Ok(mut bytes) = std::fs::read(&file) else { continue };
        // What has no end was torn.
        bytes.truncate(bytes.iter().rposition(|b| *b == b'\n').map_or(0, |end| end + 1));
        let Ok(mut reader) = csv::Reader::new(&file, bytes.as_slice()) else { continue };
        let Ok(header) = reader.header("the sensors' names") else { continue };
        let places: Option<Vec<usize>> = names.iter().map(|n| header.find(n)).collect();
        let Some(places) = places else { continue };
        loop {
            let row = match reader.row() {
                Ok(Some(row)) => row,
                Ok(None) => break,
                Err(_) => continue,
            };
            let Ok(cells) = header.cells(row) else { continue };
            let values: Result<Vec<f64>, _> = places.iter().map(|k| cells[*k].finite()).collect();
            if let (Ok(t_s), Ok(values)) = (cells[0].finite(), values)
                && t_s <= now_s
                && rows.last().is_none_or(|(before, _)| *before < t_s)
            {
                rows.push((t_s, values));
            }
        }
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_log_comes_back_and_what_is_torn_or_unknown_does_not() {
        let directory = tempfile::tempdir().unwrap();
        let names = |n: &[&str]| n.iter().map(|s| (*s).to_owned()).collect::<Vec<_>>();
        let put = |n: &[&str], t, v: &[Option<f64>]| append(directory.path(), &names(n), t, v).unwrap();
        put(&["T1", "T2"], 1.0, &[Some(20.0), Some(21.5)]);
        put(&["T1", "T2"], 2.0, &[Some(20.1), None]);
        put(&["T1", "T2"], 3.0, &[Some(20.2), Some(21.7)]);
        // Other sensors now: a new log, the old one is still read.
        put(&["T2", "T1", "T3"], 4.0, &[Some(21.8), Some(20.3), None]);
        put(&["T2", "T1", "T3"], 3.5, &[Some(21.8), Some(20.3), None]);
        put(&["T2", "T1", "T3"], 99.0, &[Some(21.8), Some(20.3), None]);
        let path = directory.path().join(NAMES[0]);
        OpenOptions::new().append(true).open(path).unwrap().write_all(b"5.0,21.9,2").unwrap();
        let found = history(directory.path(), &names(&["T1", "T2"]), 50.0);
        let want = [(1.0, vec![20.0, 21.5]), (3.0, vec![20.2, 21.7]), (4.0, vec![20.3, 21.8])];
        assert_eq!(found, want);
        assert_eq!(history(directory.path(), &names(&["T1"]), 50.0).len(), 4);
        assert!(history(directory.path(), &names(&["T9"]), 50.0).is_empty());
    }
}
