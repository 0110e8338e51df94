//! One thread per bus reads its sensors, and one thread logs them.
//! A slow sensor thus delays only those of its own bus.

use crate::sensor_bank::SensorBank;
use crate::{SensorConfig, SensorMonitor, SensorSource, SensorUsability, temperature_log};
use rtec_files::InputError;
use rtec_model::record::Record;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Seconds since 1970 that never jump.
/// They begin at the system's time and continue on a steady clock.
#[derive(Debug, Clone, Copy)]
pub struct SteadyEpochClock {
    start: Instant,
    start_s: f64,
}

impl SteadyEpochClock {
    /// A clock that begins at the system's time.
    pub fn start() -> Self {
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Self { start: Instant::now(), start_s: since.as_secs_f64() }
    }

    /// Seconds since 1970.
    pub fn now_s(&self) -> f64 {
        self.start_s + self.start.elapsed().as_secs_f64()
    }
}

/// Last readings of each bus's thread.
/// `places`: each sensor's bus and index there, in the configuration's order.
#[derive(Clone, Default)]
struct LatestBusReadings {
    buses: Vec<Arc<Mutex<Vec<SensorMonitor>>>>,
    places: Vec<(usize, usize)>,
}

/// All sensors with their last readings.
pub struct SensorThreads {
    latest: LatestBusReadings,
    watches: Vec<SensorMonitor>,
}

impl SensorThreads {
    /// Starts the threads.
    /// Every `log_s` seconds the temperatures are written to the log in `directory`. `recording` reads a
    /// recording that is replayed.
    ///
    /// # Errors
    /// A recording to be replayed that cannot be read.
    pub fn start(
        configs: &[SensorConfig],
        clock: SteadyEpochClock,
        (directory, log_s): (&Path, f64),
        recording: impl Fn(&Path) -> Result<Record, InputError>,
    ) -> Result<Self, InputError> {
        let mut of_bus: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
        for (n, config) in configs.iter().enumerate() {
            let bus = match &config.source {
                SensorSource::Iio { .. } => "iio",
                SensorSource::Hwmon { .. } => "hwmon",
                SensorSource::OneWire { .. } => "one_wire",
                SensorSource::Csv { .. } => "csv",
                SensorSource::Line { from, .. } => from,
            };
            of_bus.entry(bus).or_default().push(n);
        }
        let mut latest = LatestBusReadings { buses: Vec::new(), places: vec![(0, 0); configs.len()] };
        for members in of_bus.into_values() {
            for (k, n) in members.iter().enumerate() {
                latest.places[*n] = (latest.buses.len(), k);
            }
            let own = members.iter().map(|n| configs[*n].clone()).collect();
            let bank = SensorBank::new(own, Path::new("/"), &recording)?;
            let shared = Arc::new(Mutex::new(bank.sensors().to_vec()));
            latest.buses.push(Arc::clone(&shared));
            // The thread may hang in a driver. Nothing waits for it; its sensors age and are reported as
            // silent.
            std::thread::spawn(move || listen(bank, &shared, clock));
        }
        if !configs.is_empty() {
            let names: Vec<String> = configs.iter().map(|c| c.name.clone()).collect();
            let (latest, directory) = (latest.clone(), directory.to_owned());
            std::thread::spawn(move || keep_log(&latest, &names, &directory, clock, log_s));
        }
        Ok(Self {
            latest,
            ..Self::without_threads(configs.iter().cloned().map(SensorMonitor::new).collect())
        })
    }

    /// Sensors without threads: the caller offers their readings.
    pub fn without_threads(watches: Vec<SensorMonitor>) -> Self {
        Self { latest: LatestBusReadings::default(), watches }
    }

    /// The sensors as last read, in the configuration's order.
    /// A bus whose thread is writing at this moment keeps its previous readings.
    pub fn look(&mut self) -> &mut [SensorMonitor] {
        for (own, (bus, place)) in self.watches.iter_mut().zip(&self.latest.places) {
            if let Ok(read) = self.latest.buses[*bus].try_lock() {
                own.clone_from(&read[*place]);
            }
        }
        &mut self.watches
    }
}

fn lock(shared: &Mutex<Vec<SensorMonitor>>) -> MutexGuard<'_, Vec<SensorMonitor>> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

fn listen(mut bank: SensorBank, shared: &Mutex<Vec<SensorMonitor>>, clock: SteadyEpochClock) {
    let pause = Duration::from_secs_f64(bank.pause_s());
    loop {
        bank.poll(clock.now_s());
        // The lock is held only for a copy, never during a reading.
        lock(shared).clone_from_slice(bank.sensors());
        std::thread::sleep(pause);
    }
}

fn keep_log(
    latest: &LatestBusReadings,
    names: &[String],
    directory: &Path,
    clock: SteadyEpochClock,
    every_s: f64,
) {
    let mut warned = false;
    loop {
        std::thread::sleep(Duration::from_secs_f64(every_s));
        let now_s = clock.now_s();
        let good = |(bus, place): &(usize, usize)| {
            let watch = &lock(&latest.buses[*bus])[*place];
            watch.value_degc().filter(|_| watch.usable(now_s) == SensorUsability::Good)
        };
        let values: Vec<Option<f64>> = latest.places.iter().map(good).collect();
        if let Err(error) = temperature_log::append(directory, names, now_s, &values)
            && !std::mem::replace(&mut warned, true)
        {
            let name: PathBuf = directory.join(temperature_log::NAMES[0]);
            eprintln!(
                "rtecd: warning: {}: {error}: a restart will not know the machine's heat",
                name.display()
            );
        }
    }
}
