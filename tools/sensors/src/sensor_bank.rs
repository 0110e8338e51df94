//! All sensors of one bus, as Linux presents them.
//!
//! | source | read from |
//! |---|---|
//! | `iio` | `/sys/bus/iio/devices/iio:deviceN`: `in_tempM_input`, or `in_tempM_raw` with its offset and scale |
//! | `hwmon` | `/sys/class/hwmon/hwmonN/tempM_input` of the chip of that name |
//! | `one_wire` | `/sys/bus/w1/devices/ID`: `temperature`, or `w1_slave` with its checksum's verdict |
//! | `csv` | a recorded CSV, replayed by its `t` column (s) |
//! | `line` | lines `NAME VALUE` or `NAME=VALUE` from `host:port` (TCP) or a serial device that is set up already |

use crate::sensor_text_stream::SensorTextStream;
use crate::{SensorConfig, SensorMonitor, SensorSource};
use rtec_files::InputError;
use rtec_model::record::Record;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// All sensors of a machine.
#[derive(Debug)]
pub struct SensorBank {
    root: PathBuf,
    sensors: Vec<SensorMonitor>,
    /// Time of each sensor's next reading, s.
    due: Vec<f64>,
    feeds: Vec<SensorTextStream>,
    replays: BTreeMap<PathBuf, Record>,
    replay_start: Option<f64>,
}

impl SensorBank {
    /// Sensors under a root (`/`; tests use their own tree).
    /// `recording` reads a recording that is to be replayed.
    ///
    /// # Errors
    /// A recording to replay that cannot be read.
    pub fn new(
        configs: Vec<SensorConfig>,
        root: &Path,
        recording: impl Fn(&Path) -> Result<Record, InputError>,
    ) -> Result<Self, InputError> {
        let mut feeds: Vec<SensorTextStream> = Vec::new();
        let mut replays = BTreeMap::new();
        for c in &configs {
            match &c.source {
                SensorSource::Line { from, .. } if !feeds.iter().any(|f| f.from == *from) => {
                    let of_feed = configs.iter().filter_map(|c| match &c.source {
                        SensorSource::Line { from: other, key } if other == from => {
                            Some((key.clone(), c.timeout_s))
                        }
                        _ => None,
                    });
                    let (keys, timeouts): (Vec<String>, Vec<f64>) = of_feed.unzip();
                    // By then one of its sensors is silent, and the feed has sent nothing else either.
                    let idle_s = timeouts.into_iter().fold(f64::INFINITY, f64::min);
                    feeds.push(SensorTextStream::of(from, keys).idle_after(idle_s));
                }
                SensorSource::Csv { record, .. } if !replays.contains_key(record) => {
                    replays.insert(record.clone(), recording(record)?);
                }
                _ => {}
            }
        }
        let due = vec![f64::NEG_INFINITY; configs.len()];
        let sensors = configs.into_iter().map(SensorMonitor::new).collect();
        Ok(Self { root: root.to_owned(), sensors, due, feeds, replays, replay_start: None })
    }

    /// Longest time that may pass before the next reading is due, s.
    pub fn pause_s(&self) -> f64 {
        let shortest = self.sensors.iter().map(|w| w.config().period_s).fold(1.0, f64::min);
        if self.feeds.is_empty() { shortest / 2.0 } else { shortest.min(0.1) / 2.0 }
    }

    /// The sensors.
    pub fn sensors(&self) -> &[SensorMonitor] {
        &self.sensors
    }

    /// Reads all sensors that are due at a time, s.
    pub fn poll(&mut self, now_s: f64) {
        for feed in &mut self.feeds {
            feed.poll(now_s);
        }
        let start = *self.replay_start.get_or_insert(now_s);
        for (watch, due) in self.sensors.iter_mut().zip(&mut self.due) {
            let config = watch.config();
            let line = matches!(config.source, SensorSource::Line { .. });
            if now_s < *due && !line {
                continue;
            }
            *due = now_s + config.period_s;
            let reading = match &config.source {
                SensorSource::Iio { device, channel } => iio(&self.root, device, *channel),
                SensorSource::Hwmon { chip, input } => hwmon(&self.root, chip, *input),
                SensorSource::OneWire { id } => one_wire(&self.root, id),
                SensorSource::Csv { record, column } => replay(&self.replays[record], column, now_s - start),
                SensorSource::Line { from, key } => {
                    let feed = self.feeds.iter().find(|f| f.from == *from);
                    feed.map_or_else(|| Err(String::new()), |feed| feed.value(key))
                }
            };
            watch.offer(now_s, reading);
        }
    }
}

fn read_number(path: &Path) -> Result<f64, String> {
    let text = fs::read_to_string(path).map_err(|e| format!("{}: {e}", path.display()))?;
    text.trim().parse().map_err(|_| format!("{}: `{}` is no number", path.display(), text.trim()))
}

/// The folder in `class` with this name, or whose `name` file contains it.
fn folder(class: &Path, name: &str) -> Result<PathBuf, String> {
    let own = class.join(name);
    if own.is_dir() {
        return Ok(own);
    }
    let list = fs::read_dir(class).map_err(|e| format!("{}: {e}", class.display()))?;
    let mut all: Vec<PathBuf> = list.filter_map(|e| Some(e.ok()?.path())).collect();
    all.sort();
    let named = |p: &PathBuf| fs::read_to_string(p.join("name")).is_ok_and(|n| n.trim() == name);
    all.into_iter().find(named).ok_or_else(|| format!("no {name} under {}", class.display()))
}

fn iio(root: &Path, device: &str, channel: u32) -> Result<f64, String> {
    let dir = folder(&root.join("sys/bus/iio/devices"), device)?;
    // A device with one channel may omit its number.
    let stem = [format!("in_temp{channel}"), "in_temp".to_owned()];
    let found = stem
        .iter()
        .find(|s| dir.join(format!("{s}_input")).exists() || dir.join(format!("{s}_raw")).exists());
    let stem = found.ok_or_else(|| format!("{}: no temperature {channel}", dir.display()))?;
    let file = |what: &str| dir.join(format!("{stem}_{what}"));
    if file("input").exists() {
        return Ok(read_number(&file("input"))? / 1000.0);
    }
    let or =
        |what: &str, default: f64| if file(what).exists() { read_number(&file(what)) } else { Ok(default) };
    Ok((read_number(&file("raw"))? + or("offset", 0.0)?) * or("scale", 1.0)? / 1000.0)
}

fn hwmon(root: &Path, chip: &str, input: u32) -> Result<f64, String> {
    let dir = folder(&root.join("sys/class/hwmon"), chip)?;
    Ok(read_number(&dir.join(format!("temp{input}_input")))? / 1000.0)
}

fn one_wire(root: &Path, id: &str) -> Result<f64, String> {
    let dir = root.join("sys/bus/w1/devices").join(id);
    if dir.join("temperature").exists() {
        return Ok(read_number(&dir.join("temperature"))? / 1000.0);
    }
    let path = dir.join("w1_slave");
    let text = fs::read_to_string(&path).map_err(|e| format!("{}: {e}", path.display()))?;
    if !text.lines().next().is_some_and(|l| l.trim_end().ends_with("YES")) {
        return Err(format!("{}: checksum wrong", path.display()));
    }
    let value = text.split("t=").nth(1).and_then(|v| v.trim().parse::<f64>().ok());
    value.map(|v| v / 1000.0).ok_or_else(|| format!("{}: no t=", path.display()))
}

/// Checks that a sensor can be read now, under a root.
/// Feeds from other computers and recordings are not checked.
///
/// # Errors
/// The reason why nothing can be read.
pub fn look(root: &Path, source: &SensorSource) -> Result<(), String> {
    match source {
        SensorSource::Iio { device, channel } => iio(root, device, *channel).map(drop),
        SensorSource::Hwmon { chip, input } => hwmon(root, chip, *input).map(drop),
        SensorSource::OneWire { id } => one_wire(root, id).map(drop),
        SensorSource::Line { from, .. } if from.starts_with('/') => {
            fs::metadata(from).map(drop).map_err(|e| format!("{from}: {e}"))
        }
        SensorSource::Line { .. } | SensorSource::Csv { .. } => Ok(()),
    }
}

/// The latest row at a time since the replay's start.
/// After the last row the sensor is silent.
fn replay(record: &Record, column: &str, t_s: f64) -> Result<f64, String> {
    let data = record.columns.iter().find(|c| c.name == column).map(|c| &c.data);
    let data = data.ok_or_else(|| format!("no column {column} in the recording"))?;
    let t = record.time_s();
    let after = t.partition_point(|v| *v - t[0] <= t_s);
    let step = if t.len() > 1 { (t[t.len() - 1] - t[0]) / (t.len() - 1) as f64 } else { 0.0 };
    if t_s > t[t.len() - 1] - t[0] + step {
        return Err("end of the recording".to_owned());
    }
    Ok(data[after.max(1) - 1])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SensorFault;
    use crate::SensorUsability;
    use crate::config::for_test as config;
    use std::io::Write;
    use std::net::{TcpListener, TcpStream};
    use std::time::Duration;

    fn no_recording(path: &Path) -> Result<Record, InputError> {
        Err(InputError::whole(path, "a recording", "none in this test"))
    }

    #[test]
    fn sysfs_in_its_three_dialects() {
        let dir = tempfile::tempdir().unwrap();
        let put = |path: &str, text: &str| {
            let p = dir.path().join(path);
            fs::create_dir_all(p.parent().unwrap()).unwrap();
            fs::write(p, text).unwrap();
        };
        put("sys/bus/iio/devices/iio:device0/name", "adt7420\n");
        put("sys/bus/iio/devices/iio:device0/in_temp0_raw", "2000\n");
        put("sys/bus/iio/devices/iio:device0/in_temp0_offset", "-320\n");
        put("sys/bus/iio/devices/iio:device0/in_temp0_scale", "12.5\n");
        put("sys/bus/iio/devices/iio:device1/in_temp_input", "21500\n");
        put("sys/class/hwmon/hwmon0/name", "k10temp\n");
        put("sys/class/hwmon/hwmon3/name", "tmp102\n");
        put("sys/class/hwmon/hwmon3/temp1_input", "23125\n");
        put("sys/bus/w1/devices/28-00a/w1_slave", "72 01 : crc=4f YES\n72 01 t=23125\n");
        put("sys/bus/w1/devices/28-00b/w1_slave", "72 01 : crc=4f NO\n72 01 t=23125\n");
        put("sys/bus/w1/devices/28-00c/temperature", "-1250\n");
        let root = dir.path();
        assert_eq!(iio(root, "adt7420", 0), Ok(21.0));
        assert_eq!(iio(root, "iio:device1", 3), Ok(21.5));
        assert_eq!(hwmon(root, "tmp102", 1), Ok(23.125));
        assert_eq!(one_wire(root, "28-00a"), Ok(23.125));
        assert_eq!(one_wire(root, "28-00c"), Ok(-1.25));
        for bad in [one_wire(root, "28-00b"), iio(root, "nothing", 0), hwmon(root, "k10temp", 1)] {
            assert!(bad.is_err());
        }
        let mut bank = SensorBank::new(
            vec![
                config("T1", SensorSource::Hwmon { chip: "tmp102".into(), input: 1 }),
                config("T2", SensorSource::OneWire { id: "28-00b".into() }),
            ],
            root,
            no_recording,
        )
        .unwrap();
        bank.poll(0.0);
        bank.poll(5.0);
        let states: Vec<SensorUsability> = bank.sensors().iter().map(|w| w.usable(5.0)).collect();
        assert_eq!(states, [SensorUsability::Good, SensorUsability::Hold]);
    }

    #[test]
    fn a_line_feed_over_tcp() {
        let server = TcpListener::bind("127.0.0.1:0").unwrap();
        let from = server.local_addr().unwrap().to_string();
        let line = |key: &str| SensorSource::Line { from: from.clone(), key: key.into() };
        let mut bank = SensorBank::new(
            vec![config("T1", line("T1")), config("T2", line("b"))],
            Path::new("/"),
            no_recording,
        )
        .unwrap();
        bank.poll(0.0);
        let (mut peer, _) = server.accept().unwrap();
        peer.write_all(b"T1 21.5\nb=22.25\nnonsense\nT1 21.5").unwrap();
        // The bytes are still in the loopback; a thousand polls are more than enough.
        for i in 0..1000 {
            bank.poll(0.001 * f64::from(i));
            if bank.sensors().iter().all(|w| w.value_degc().is_some()) {
                break;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        let values: Vec<Option<f64>> = bank.sensors().iter().map(SensorMonitor::value_degc).collect();
        assert_eq!(values, [Some(21.5), Some(22.25)]);
        drop(peer);
        bank.poll(9.0);
        bank.poll(20.0);
        assert!(
            matches!(bank.sensors()[0].fault(), Some(SensorFault::Silent(_))),
            "{:?}",
            bank.sensors()[0].fault()
        );
        assert_eq!(bank.sensors()[0].usable(20.0), SensorUsability::Hold);
    }

    /// A gateway that loses power leaves its connection open and sends no more lines.
    #[test]
    fn a_gateway_that_was_power_cycled_is_connected_again_and_the_reason_is_true() {
        let server = TcpListener::bind("127.0.0.1:0").unwrap();
        let from = server.local_addr().unwrap().to_string();
        let line = |key: &str| SensorSource::Line { from: from.clone(), key: key.into() };
        let all = vec![config("a", line("a")), config("b", line("b"))];
        let mut bank = SensorBank::new(all, Path::new("/"), no_recording).unwrap();
        bank.poll(0.0);
        let (mut peer, _) = server.accept().unwrap();
        let why = |bank: &SensorBank, n: usize| bank.sensors()[n].fault().map(ToString::to_string);
        let comes = |bank: &mut SensorBank, peer: &mut TcpStream, text: &str, now_s: f64| {
            peer.write_all(text.as_bytes()).unwrap();
            let before = bank.sensors()[0].age_s(now_s);
            for _ in 0..20_000 {
                bank.poll(now_s);
                if bank.sensors()[0].age_s(now_s) != before || before == Some(0.0) {
                    return;
                }
                std::thread::sleep(Duration::from_millis(1));
            }
            panic!("nothing came");
        };
        comes(&mut bank, &mut peer, "a 20\nb 21\n", 1.0);
        // Only one of them continues.
        for s in 2..=8 {
            comes(&mut bank, &mut peer, "a 20\n", f64::from(s));
        }
        assert_eq!(
            (why(&bank, 0), why(&bank, 1)),
            (None, Some("silent (connected, no line b for 7 s)".into()))
        );
        // The gateway loses its power and closes nothing. After the sensor's timeout it is connected again.
        server.set_nonblocking(true).unwrap();
        bank.poll(12.0);
        assert_eq!(why(&bank, 0).unwrap(), "silent (connected, no line a for 4 s)");
        assert!(server.accept().is_err());
        bank.poll(14.0);
        bank.poll(14.1);
        let (mut again, _) = (0..20_000)
            .find_map(|_| {
                std::thread::sleep(Duration::from_millis(1));
                server.accept().ok()
            })
            .unwrap();
        bank.poll(18.0);
        assert_eq!(why(&bank, 0).unwrap(), "silent (connected, nothing came for 4 s)");
        comes(&mut bank, &mut again, "a 20.1\nb 21.1\n", 18.5);
        assert_eq!((why(&bank, 0), why(&bank, 1)), (None, None));
        drop(peer);
    }
}
