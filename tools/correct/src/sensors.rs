//! Temperatures through what Linux offers, each watched: a sensor that is stuck, jumps, falls silent or reads what cannot
//! be is said by name; its last good value stands for a stated time, then corrections hold.
//!
//! | source | read from |
//! |---|---|
//! | `iio` | `/sys/bus/iio/devices/iio:deviceN`: `in_tempM_input`, or `in_tempM_raw` with its offset and scale |
//! | `hwmon` | `/sys/class/hwmon/hwmonN/tempM_input` of the chip of that name |
//! | `one_wire` | `/sys/bus/w1/devices/ID`: `temperature`, or `w1_slave` with its checksum's verdict |
//! | `csv` | a recorded CSV, replayed by its `t` column (s) |
//! | `line` | lines `NAME VALUE` or `NAME=VALUE` from `host:port` (TCP) or a serial device that is set up already |

use rtec_files::InputError;
use rtec_files::toml::Table;
use rtec_model::record::{Record, Role};
use std::collections::BTreeMap;
use std::fs;
use std::io::{self, Read};
use std::net::{TcpStream, ToSocketAddrs};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

/// Where a sensor's values come from.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
#[allow(missing_docs)]
pub enum Source {
    /// Device by its `name` file (or `iio:deviceN`), channel number.
    Iio { device: String, channel: u32 },
    /// Chip by its `name` file (or `hwmonN`), input number.
    Hwmon { chip: String, input: u32 },
    /// Device such as `28-0123456789ab`.
    OneWire { id: String },
    /// Column of a run record (its sidecar).
    Csv { record: PathBuf, column: String },
    /// `host:port` or `/dev/tty…`, and the name at the start of the line.
    Line { from: String, key: String },
}

/// A sensor as it is configured.
#[derive(Debug, Clone, PartialEq)]
pub struct Config {
    /// Name, as effects use it.
    pub name: String,
    /// Where it sits on the machine, for people.
    pub place: String,
    /// What it reads: a temperature, or what else an effect may ask for (spindle speed, coolant, load, channel).
    pub role: Role,
    /// Where its values come from.
    pub source: Source,
    /// Time between readings, s.
    pub period_s: f64,
    /// What it can plausibly read, °C (or its role's unit).
    pub range: [f64; 2],
    /// The fastest change that can be real, K/min; infinite for what is no temperature.
    pub max_rate_k_per_min: f64,
    /// Without a reading for so long it is silent, s.
    pub timeout_s: f64,
    /// Exactly the same value for so long is stuck, s; 0 where the sensor is too coarse to tell.
    pub stuck_s: f64,
    /// The last good value stands for so long, s; after that corrections hold.
    pub freeze_s: f64,
}

impl Config {
    /// Reads a `[[sensor]]` table.
    ///
    /// # Errors
    /// The first finding, with line and column.
    pub fn read(t: Table<'_>) -> Result<Self, InputError> {
        let common = [
            "name",
            "place",
            "role",
            "source",
            "period_s",
            "range",
            "range_degC",
            "max_rate_K_per_min",
            "timeout_s",
            "stuck_s",
            "freeze_s",
        ];
        let own = ["device", "channel", "chip", "input", "id", "record", "column", "from", "key"];
        t.only(&[common.as_slice(), &own].concat())?;
        let text = |key: &str, form: &str| Ok::<_, InputError>(t.required(key, form)?.str(form)?.to_owned());
        let number =
            |key: &str, default: f64| t.get(key).map_or(Ok(default), |e| e.positive("a number above zero"));
        let whole = |key: &str| match t.get(key) {
            None => Ok(0),
            Some(e) => match e.number("a whole number")? {
                v if v.fract() == 0.0 && v >= 0.0 => Ok(v as u32),
                v => Err(e.error(v.to_string(), "a whole number")),
            },
        };
        let name = text("name", "the sensor's name, as effects use it")?;
        let entry = t.required("source", "source = \"iio\", \"hwmon\", \"one_wire\", \"csv\" or \"line\"")?;
        let source = match entry.str("a source")? {
            "iio" => Source::Iio { device: text("device", "device = \"NAME\"")?, channel: whole("channel")? },
            "hwmon" => {
                Source::Hwmon { chip: text("chip", "chip = \"NAME\"")?, input: whole("input")?.max(1) }
            }
            "one_wire" => Source::OneWire { id: text("id", "id = \"28-…\"")? },
            "csv" => Source::Csv {
                record: PathBuf::from(text("record", "record = \"NAME.run.toml\"")?),
                column: t.get("column").map_or(Ok(name.as_str()), |e| e.str("a column"))?.to_owned(),
            },
            "line" => Source::Line {
                from: text("from", "from = \"host:port\" or \"/dev/tty…\"")?,
                key: t.get("key").map_or(Ok(name.as_str()), |e| e.str("a key"))?.to_owned(),
            },
            other => {
                return Err(entry.error(format!("source `{other}`"), "iio, hwmon, one_wire, csv or line"));
            }
        };
        let period_s = number("period_s", 1.0)?;
        let role = match t.get("role") {
            None => Role::Temperature,
            Some(e) => {
                let form = "temperature, spindle_speed, coolant, load.AXIS or channel";
                Role::parse(e.str(form)?).filter(is_sensed).ok_or_else(|| e.error(e.text(), form))?
            }
        };
        let warm = role == Role::Temperature;
        for key in if warm { &["range"][..] } else { &["range_degC", "max_rate_K_per_min"] } {
            if let Some(e) = t.get(key) {
                return Err(e.unknown_key(if warm {
                    "range_degC"
                } else {
                    "range, as it is no temperature"
                }));
            }
        }
        let limits = if warm { [-20.0, 120.0] } else { [-1e9, 1e9] };
        Ok(Self {
            place: t.get("place").map_or(Ok(""), |e| e.str("a place"))?.to_owned(),
            range: t
                .get(if warm { "range_degC" } else { "range" })
                .map_or(Ok(limits), |e| e.pair("[lowest, highest]"))?,
            max_rate_k_per_min: if warm { number("max_rate_K_per_min", 10.0)? } else { f64::INFINITY },
            timeout_s: number("timeout_s", 5.0 * period_s)?,
            stuck_s: t.get("stuck_s").map_or(Ok(0.0), |e| e.number("seconds"))?,
            freeze_s: number("freeze_s", 60.0)?,
            name,
            role,
            source,
            period_s,
        })
    }
}

impl Config {
    /// A sensor whose every reading is believed and never grows old: of a simulation, or of a recorded shift.
    #[must_use]
    pub fn believed(name: &str, role: Role) -> Self {
        Self {
            name: name.to_owned(),
            place: String::new(),
            role,
            source: Source::Csv { record: PathBuf::new(), column: name.to_owned() },
            period_s: 1.0,
            range: [f64::NEG_INFINITY, f64::INFINITY],
            max_rate_k_per_min: f64::INFINITY,
            timeout_s: f64::INFINITY,
            stuck_s: 0.0,
            freeze_s: f64::INFINITY,
        }
    }
}

fn is_sensed(role: &Role) -> bool {
    matches!(role, Role::Temperature | Role::SpindleSpeed | Role::Coolant | Role::Load(_) | Role::Channel)
}

/// What is wrong with a sensor.
#[derive(Debug, Clone, PartialEq)]
pub enum Fault {
    /// No reading: why, and since when (s of the caller's clock).
    Silent(String),
    /// A reading outside its range or not a number, °C.
    Implausible(f64),
    /// A change faster than can be real: from, to, °C.
    Jump(f64, f64),
    /// Exactly this value for too long, °C.
    Stuck(f64),
}

impl std::fmt::Display for Fault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Silent(why) => write!(f, "silent ({why})"),
            Self::Implausible(v) => write!(f, "implausible: {v}"),
            Self::Jump(a, b) => write!(f, "jump from {a:.2} to {b:.2} °C"),
            Self::Stuck(v) => write!(f, "stuck at {v}"),
        }
    }
}

/// What a model may make of a sensor now.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Use {
    /// Its value is good.
    Good,
    /// Its last good value stands in.
    Frozen,
    /// Too old: corrections that depend on it hold.
    Hold,
}

/// One sensor under watch.
#[derive(Debug, Clone)]
pub struct Watch {
    config: Arc<Config>,
    good: Option<(f64, f64)>,
    raw: Option<(f64, f64)>,
    heard: Option<f64>,
    fault: Option<Fault>,
    due: f64,
}

impl Watch {
    /// A sensor that has not been read yet.
    #[must_use]
    pub fn new(config: Config) -> Self {
        Self {
            config: Arc::new(config),
            good: None,
            raw: None,
            heard: None,
            fault: None,
            due: f64::NEG_INFINITY,
        }
    }

    /// Its configuration.
    #[must_use]
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Takes a reading (or why there is none) at a time, s.
    pub fn offer(&mut self, now_s: f64, reading: Result<f64, String>) {
        let value = match reading {
            Err(why) => {
                let since = self.heard.map_or(f64::INFINITY, |h| now_s - h);
                if since > self.config.timeout_s {
                    self.fault = Some(Fault::Silent(why));
                }
                return;
            }
            Ok(v) => v,
        };
        self.heard = Some(now_s);
        let since_same = match self.raw {
            Some((v, at)) if v.to_bits() == value.to_bits() => now_s - at,
            _ => {
                self.raw = Some((value, now_s));
                0.0
            }
        };
        let [lo, hi] = self.config.range;
        self.fault = if !value.is_finite() || value < lo || value > hi {
            Some(Fault::Implausible(value))
        } else if self.config.stuck_s > 0.0 && since_same > self.config.stuck_s {
            Some(Fault::Stuck(value))
        } else {
            // What can have changed since the last good value; one second's worth for the reading itself.
            let jumped = self.good.filter(|(v, at)| {
                let may = self.config.max_rate_k_per_min / 60.0 * (now_s - at + 1.0);
                (value - v).abs() > may
            });
            jumped.map(|(v, _)| Fault::Jump(v, value))
        };
        if self.fault.is_none() {
            self.good = Some((value, now_s));
        }
    }

    /// The last good value, °C.
    #[must_use]
    pub fn value_degc(&self) -> Option<f64> {
        self.good.map(|g| g.0)
    }

    /// Its age, s.
    #[must_use]
    pub fn age_s(&self, now_s: f64) -> Option<f64> {
        self.good.map(|g| now_s - g.1)
    }

    /// What is wrong with it.
    #[must_use]
    pub fn fault(&self) -> Option<&Fault> {
        self.fault.as_ref()
    }

    /// What a model may make of it now.
    #[must_use]
    pub fn usable(&self, now_s: f64) -> Use {
        let old = self.age_s(now_s).unwrap_or(f64::INFINITY);
        if old > self.config.freeze_s.max(self.config.timeout_s) {
            Use::Hold
        } else if self.fault.is_some() || old > self.config.timeout_s {
            Use::Frozen
        } else {
            Use::Good
        }
    }
}

/// A feed of lines `NAME VALUE` or `NAME=VALUE` from `host:port` (TCP) or a serial device.
#[derive(Debug)]
pub struct Feed {
    from: String,
    stream: Option<Stream>,
    partial: Vec<u8>,
    values: BTreeMap<String, f64>,
    trouble: String,
    retry_at: f64,
    /// When it is next made sure that the device is still the one that was opened.
    check_at: f64,
}

/// Time between two tries to connect, and between two looks whether a device is still there, s.
const RETRY_S: f64 = 5.0;

#[derive(Debug)]
enum Stream {
    Tcp(TcpStream),
    Serial(fs::File),
}

impl Feed {
    /// A feed that connects at its first poll.
    #[must_use]
    pub fn new(from: &str) -> Self {
        Self {
            from: from.to_owned(),
            stream: None,
            partial: Vec::new(),
            values: BTreeMap::new(),
            trouble: "not connected yet".to_owned(),
            retry_at: f64::NEG_INFINITY,
            check_at: f64::NEG_INFINITY,
        }
    }

    fn connect(&self) -> io::Result<Stream> {
        if self.from.starts_with('/') {
            let file = fs::OpenOptions::new()
                .read(true)
                .custom_flags(libc::O_NONBLOCK | libc::O_NOCTTY)
                .open(&self.from)?;
            return Ok(Stream::Serial(file));
        }
        let none = || io::Error::new(io::ErrorKind::NotFound, "no such host");
        let address = self.from.to_socket_addrs()?.next().ok_or_else(none)?;
        let stream = TcpStream::connect_timeout(&address, Duration::from_millis(200))?;
        stream.set_nonblocking(true)?;
        Ok(Stream::Tcp(stream))
    }

    /// The value of a key that came with the last poll, or what is in the way.
    ///
    /// # Errors
    /// No such value: the feed's last trouble.
    pub fn value(&self, key: &str) -> Result<f64, &str> {
        self.values.get(key).copied().ok_or(&self.trouble)
    }

    /// Takes in what has come; values are taken once, so that silence shows.
    pub fn poll(&mut self, now_s: f64) {
        self.values.clear();
        if let Some(Stream::Serial(file)) = &self.stream
            && now_s >= self.check_at
        {
            self.check_at = now_s + RETRY_S;
            // A device that was pulled out reads as one that has nothing to say, and comes back as another file.
            if let Err(gone) = same(file, Path::new(&self.from)) {
                self.trouble = gone.to_string();
                self.stream = None;
            }
        }
        if self.stream.is_none() && now_s >= self.retry_at {
            match self.connect() {
                Ok(s) => self.stream = Some(s),
                Err(e) => {
                    self.trouble = e.to_string();
                    self.retry_at = now_s + RETRY_S;
                }
            }
        }
        let mut buffer = [0; 4096];
        while let Some(stream) = &mut self.stream {
            let got = match stream {
                Stream::Tcp(s) => s.read(&mut buffer),
                Stream::Serial(s) => s.read(&mut buffer),
            };
            match got {
                Ok(0) if matches!(stream, Stream::Serial(_)) => break,
                Ok(n) if n > 0 => {
                    self.partial.extend_from_slice(&buffer[..n]);
                    self.take_lines();
                }
                Err(e) if e.kind() == io::ErrorKind::WouldBlock => break,
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                end => {
                    self.trouble = end.err().map_or("closed by the other side".to_owned(), |e| e.to_string());
                    self.stream = None;
                    self.retry_at = now_s + RETRY_S;
                }
            }
        }
    }

    fn take_lines(&mut self) {
        while let Some(end) = self.partial.iter().position(|b| *b == b'\n') {
            let line: Vec<u8> = self.partial.drain(..=end).collect();
            let text = String::from_utf8_lossy(&line);
            let mut words = text.trim().splitn(2, ['=', ' ', '\t', ',']);
            if let (Some(key), Some(value)) = (words.next(), words.next()) {
                if let Ok(v) = value.trim().parse::<f64>() {
                    self.values.insert(key.trim().to_owned(), v);
                } else {
                    self.trouble = format!("`{}` is no line NAME VALUE", text.trim());
                }
            }
        }
        // A feed that never ends its line is no feed.
        if self.partial.len() > 65_536 {
            self.partial.clear();
            "a line longer than 64 KiB".clone_into(&mut self.trouble);
        }
    }
}

/// Whether a path still names the file that was opened.
fn same(file: &fs::File, path: &Path) -> io::Result<()> {
    let (open, now) = (file.metadata()?, fs::metadata(path)?);
    if (open.dev(), open.ino()) == (now.dev(), now.ino()) {
        return Ok(());
    }
    Err(io::Error::other("it was taken away, and is another one now"))
}

/// All sensors of a machine.
#[derive(Debug)]
pub struct Bank {
    root: PathBuf,
    sensors: Vec<Watch>,
    feeds: Vec<Feed>,
    replays: BTreeMap<PathBuf, Record>,
    replay_start: Option<f64>,
}

impl Bank {
    /// Sensors under a root (`/`; tests put their own tree there).
    ///
    /// # Errors
    /// A recording to replay that cannot be read.
    pub fn new(configs: Vec<Config>, root: &Path) -> Result<Self, InputError> {
        let mut feeds: Vec<Feed> = Vec::new();
        let mut replays = BTreeMap::new();
        for c in &configs {
            match &c.source {
                Source::Line { from, .. } if !feeds.iter().any(|f| f.from == *from) => {
                    feeds.push(Feed::new(from));
                }
                Source::Csv { record, .. } if !replays.contains_key(record) => {
                    replays.insert(record.clone(), rtec_measure::record::read_log(record)?);
                }
                _ => {}
            }
        }
        let sensors = configs.into_iter().map(Watch::new).collect();
        Ok(Self { root: root.to_owned(), sensors, feeds, replays, replay_start: None })
    }

    /// The longest time after which something may be due, s.
    #[must_use]
    pub fn pause_s(&self) -> f64 {
        let shortest = self.sensors.iter().map(|w| w.config.period_s).fold(1.0, f64::min);
        if self.feeds.is_empty() { shortest / 2.0 } else { shortest.min(0.1) / 2.0 }
    }

    /// The sensors.
    #[must_use]
    pub fn sensors(&self) -> &[Watch] {
        &self.sensors
    }

    /// Reads what is due at a time, s.
    pub fn poll(&mut self, now_s: f64) {
        for feed in &mut self.feeds {
            feed.poll(now_s);
        }
        let start = *self.replay_start.get_or_insert(now_s);
        for watch in &mut self.sensors {
            let line = matches!(watch.config.source, Source::Line { .. });
            if now_s < watch.due && !line {
                continue;
            }
            watch.due = now_s + watch.config.period_s;
            let reading = match &watch.config.source {
                Source::Iio { device, channel } => iio(&self.root, device, *channel),
                Source::Hwmon { chip, input } => hwmon(&self.root, chip, *input),
                Source::OneWire { id } => one_wire(&self.root, id),
                Source::Csv { record, column } => replay(&self.replays[record], column, now_s - start),
                Source::Line { from, key } => {
                    let feed = self.feeds.iter().find(|f| f.from == *from);
                    let value = feed.and_then(|f| f.values.get(key).copied());
                    value.ok_or_else(|| feed.map_or(String::new(), |f| f.trouble.clone()))
                }
            };
            watch.offer(now_s, reading);
        }
    }

    /// The worst of the named sensors, and which: what a model that reads them may do now.
    #[must_use]
    pub fn usable<'a>(&'a self, names: &[String], now_s: f64) -> (Use, Option<&'a Watch>) {
        let known = self.sensors.iter().filter(|w| names.contains(&w.config.name));
        let worst = known.max_by_key(|w| w.usable(now_s));
        let all = names.iter().all(|n| self.sensors.iter().any(|w| w.config.name == *n));
        match worst {
            Some(w) if all => (w.usable(now_s), Some(w)),
            _ if names.is_empty() => (Use::Good, None),
            w => (Use::Hold, w),
        }
    }
}

fn number_of(path: &Path) -> Result<f64, String> {
    let text = fs::read_to_string(path).map_err(|e| format!("{}: {e}", path.display()))?;
    text.trim().parse().map_err(|_| format!("{}: `{}` is no number", path.display(), text.trim()))
}

/// The folder under `class` that is called so, or whose `name` file says so.
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
    // A device with one channel may leave its number out.
    let stem = [format!("in_temp{channel}"), "in_temp".to_owned()];
    let found = stem
        .iter()
        .find(|s| dir.join(format!("{s}_input")).exists() || dir.join(format!("{s}_raw")).exists());
    let stem = found.ok_or_else(|| format!("{}: no temperature {channel}", dir.display()))?;
    let file = |what: &str| dir.join(format!("{stem}_{what}"));
    if file("input").exists() {
        return Ok(number_of(&file("input"))? / 1000.0);
    }
    let or =
        |what: &str, default: f64| if file(what).exists() { number_of(&file(what)) } else { Ok(default) };
    Ok((number_of(&file("raw"))? + or("offset", 0.0)?) * or("scale", 1.0)? / 1000.0)
}

fn hwmon(root: &Path, chip: &str, input: u32) -> Result<f64, String> {
    let dir = folder(&root.join("sys/class/hwmon"), chip)?;
    Ok(number_of(&dir.join(format!("temp{input}_input")))? / 1000.0)
}

fn one_wire(root: &Path, id: &str) -> Result<f64, String> {
    let dir = root.join("sys/bus/w1/devices").join(id);
    if dir.join("temperature").exists() {
        return Ok(number_of(&dir.join("temperature"))? / 1000.0);
    }
    let path = dir.join("w1_slave");
    let text = fs::read_to_string(&path).map_err(|e| format!("{}: {e}", path.display()))?;
    if !text.lines().next().is_some_and(|l| l.trim_end().ends_with("YES")) {
        return Err(format!("{}: checksum wrong", path.display()));
    }
    let value = text.split("t=").nth(1).and_then(|v| v.trim().parse::<f64>().ok());
    value.map(|v| v / 1000.0).ok_or_else(|| format!("{}: no t=", path.display()))
}

/// The row that was last at a time since the replay's start; after the last row the sensor is silent.
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

/// Reads the `[[sensor]]` tables of a file.
///
/// # Errors
/// The first finding, with line and column.
pub fn read_tables(root: &Table<'_>) -> Result<Vec<Config>, InputError> {
    let mut found: Vec<Config> = Vec::new();
    let tables = root.get("sensor").map(|e| e.tables("[[sensor]] tables")).transpose()?;
    for t in tables.unwrap_or_default() {
        let config = Config::read(t)?;
        if found.iter().any(|c| c.name == config.name) {
            let found = format!("sensor `{}` twice", config.name);
            return Err(t.required("name", "")?.error(found, "each name once"));
        }
        found.push(config);
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;
    use std::net::TcpListener;

    fn config(name: &str, source: Source) -> Config {
        Config {
            name: name.into(),
            place: String::new(),
            source,
            period_s: 1.0,
            role: Role::Temperature,
            range: [0.0, 80.0],
            max_rate_k_per_min: 6.0,
            timeout_s: 3.0,
            stuck_s: 20.0,
            freeze_s: 10.0,
        }
    }

    fn watch() -> Watch {
        Watch::new(config("T1", Source::OneWire { id: "28-0".into() }))
    }

    #[test]
    fn a_good_sensor_is_good_and_ages() {
        let mut w = watch();
        assert_eq!(w.usable(0.0), Use::Hold);
        w.offer(0.0, Ok(20.0));
        assert_eq!((w.value_degc(), w.usable(2.0)), (Some(20.0), Use::Good));
        assert_eq!((w.usable(5.0), w.usable(11.0)), (Use::Frozen, Use::Hold));
        assert_eq!(w.age_s(2.0), Some(2.0));
    }

    #[test]
    fn every_fault_is_named_frozen_and_then_holds() {
        let says = |readings: &[(f64, Result<f64, String>)], fault: &str, still: f64| {
            let mut w = watch();
            w.offer(0.0, Ok(20.0));
            for (t, r) in readings {
                w.offer(*t, r.clone());
            }
            let now = readings.last().unwrap().0;
            assert!(w.fault().is_some_and(|f| f.to_string().contains(fault)), "{fault}: {:?}", w.fault());
            assert_eq!(w.value_degc(), Some(still), "{fault}");
            assert_eq!(w.usable(now), Use::Frozen, "{fault}");
            assert_eq!(w.usable(now + 30.0), Use::Hold, "{fault}");
        };
        says(&[(1.0, Ok(20.05)), (2.0, Ok(25.0))], "jump from 20.05 to 25.00", 20.05);
        says(&[(1.0, Ok(99.0))], "implausible: 99", 20.0);
        says(&[(1.0, Ok(f64::NAN))], "implausible", 20.0);
        says(&[(4.0, Err("gone".into()))], "silent (gone)", 20.0);
        let same: Vec<(f64, Result<f64, String>)> = (1..24).map(|i| (f64::from(i), Ok(20.0))).collect();
        says(&same, "stuck at 20", 20.0);
    }

    #[test]
    fn one_missed_reading_is_no_fault_and_a_jump_that_comes_back_is_forgiven() {
        let mut w = watch();
        w.offer(0.0, Ok(20.0));
        w.offer(1.0, Err("busy".into()));
        assert_eq!((w.fault(), w.usable(1.0)), (None, Use::Good));
        w.offer(2.0, Ok(27.0));
        w.offer(3.0, Ok(20.2));
        assert_eq!((w.fault(), w.value_degc()), (None, Some(20.2)));
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
        let mut bank = Bank::new(
            vec![
                config("T1", Source::Hwmon { chip: "tmp102".into(), input: 1 }),
                config("T2", Source::OneWire { id: "28-00b".into() }),
            ],
            root,
        )
        .unwrap();
        bank.poll(0.0);
        bank.poll(5.0);
        assert_eq!(bank.usable(&["T1".into()], 5.0).0, Use::Good);
        let (worst, which) = bank.usable(&["T1".into(), "T2".into()], 5.0);
        assert_eq!((worst, which.unwrap().config().name.as_str()), (Use::Hold, "T2"));
        assert_eq!(bank.usable(&["T9".into()], 5.0).0, Use::Hold);
    }

    #[test]
    fn a_line_feed_over_tcp() {
        let server = TcpListener::bind("127.0.0.1:0").unwrap();
        let from = server.local_addr().unwrap().to_string();
        let line = |key: &str| Source::Line { from: from.clone(), key: key.into() };
        let mut bank =
            Bank::new(vec![config("T1", line("T1")), config("T2", line("b"))], Path::new("/")).unwrap();
        bank.poll(0.0);
        let (mut peer, _) = server.accept().unwrap();
        peer.write_all(b"T1 21.5\nb=22.25\nnonsense\nT1 21.5").unwrap();
        // The bytes are on their way through the loopback; a thousand polls are more than they need.
        for i in 0..1000 {
            bank.poll(0.001 * f64::from(i));
            if bank.sensors().iter().all(|w| w.value_degc().is_some()) {
                break;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        let values: Vec<Option<f64>> = bank.sensors().iter().map(Watch::value_degc).collect();
        assert_eq!(values, [Some(21.5), Some(22.25)]);
        drop(peer);
        bank.poll(9.0);
        bank.poll(20.0);
        assert!(
            matches!(bank.sensors()[0].fault(), Some(Fault::Silent(_))),
            "{:?}",
            bank.sensors()[0].fault()
        );
        assert_eq!(bank.usable(&["T1".into()], 20.0).0, Use::Hold);
    }

    /// A bug once: a serial adapter that was pulled out and put in again stayed silent for good.
    #[test]
    fn a_device_that_comes_back_is_opened_again() {
        let directory = tempfile::tempdir().unwrap();
        let device = directory.path().join("ttyUSB0");
        fs::write(&device, "T1 20\n").unwrap();
        let mut feed = Feed::new(device.to_str().unwrap());
        feed.poll(0.0);
        assert_eq!(feed.value("T1"), Ok(20.0));
        fs::remove_file(&device).unwrap();
        feed.poll(6.0);
        assert!(feed.value("T1").is_err_and(|why| why.contains("No such file")), "{:?}", feed.value("T1"));
        fs::write(&device, "T1 21\n").unwrap();
        feed.poll(12.0);
        assert_eq!(feed.value("T1"), Ok(21.0));
        // Another one at once in its place.
        let other = directory.path().join("other");
        fs::write(&other, "T1 22\n").unwrap();
        fs::rename(&other, &device).unwrap();
        feed.poll(18.0);
        assert_eq!(feed.value("T1"), Ok(22.0));
    }
}
