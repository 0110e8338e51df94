//! `[[sensor]]` of a configuration: its keys, their bounds and defaults.

use rtec_files::keys;
use rtec_files::toml_section_keys::AcceptedKeyValue::{Choice, Name, Number, Own, Range, Text, Whole, Word};
use rtec_files::toml_section_keys::{FileWithFindings, LocatedValue, REQUIRED, TomlSection};
use rtec_model::record::Role;
use std::path::{Path, PathBuf};

keys! {
    /// The keys of `[[sensor]]`.
    pub KEYS:
    name: Word, "", REQUIRED, "the sensor's name, as effects use it";
    place: Name, "", "none", "where it sits";
    role: Own("`temperature`, `spindle_speed`, `coolant`, `load.AXIS`, `channel`"), "", "`temperature`", "what it reads";
    source: Choice(&["iio", "hwmon", "one_wire", "csv", "line"]), "", REQUIRED, "where its values come from";
    device: Name, "", REQUIRED, "`iio`: the device's name, as `iio:device0`";
    channel: Whole(0, 4095), "", "0", "`iio`: which of its temperatures";
    chip: Name, "", REQUIRED, "`hwmon`: the chip's name, as `tmp102`";
    input: Whole(0, 4095), "", "1", "`hwmon`: which of its temperatures";
    id: Text, "", REQUIRED, "`one_wire`: the sensor's number, as `28-0316a2798cff`";
    record: Text, "", REQUIRED, "`csv`: the recording, `NAME.run.toml`";
    column: Name, "", "its name", "`csv`: the column of the recording";
    from: Text, "", REQUIRED, "`line`: `host:port`, or a device as `/dev/ttyUSB0`";
    key: Name, "", "its name", "`line`: the first word of its lines `NAME VALUE`";
    period_s: Number(0.01, 3600.0), "s", "1", "time between two readings";
    timeout_s: Number(0.01, 1e6), "s", "5 periods", "without a reading for so long it is silent";
    freeze_s: Number(0.01, 1e6), "s", "60", "how long the last good value is used instead";
    stuck_s: Number(0.0, 1e6), "s", "0", "so long without any change is a fault; 0: never";
    range_degC: Range(1e9), "°C", "-20 to 120", "a temperature's plausible readings";
    range: Range(1e9), "", "no limit", "plausible readings of any other role";
    max_rate_K_per_min: Number(1e-3, 1e4), "K/min", "10", "the fastest change that is believed";
}

/// Source of a sensor's values.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
#[allow(missing_docs)]
pub enum SensorSource {
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

/// A configured sensor: the keys of its table.
#[derive(Debug, Clone, PartialEq)]
#[allow(missing_docs)] // [`KEYS`] describes them
pub struct SensorConfig {
    pub name: String,
    pub place: String,
    pub role: Role,
    pub source: SensorSource,
    pub period_s: f64,
    /// Its plausible range, °C (or the unit of its role).
    pub range: [f64; 2],
    /// Fastest possible change, K/min; infinite for roles other than temperature.
    pub max_rate_k_per_min: f64,
    pub timeout_s: f64,
    pub stuck_s: f64,
    pub freeze_s: f64,
}

impl SensorConfig {
    /// Reads one `[[sensor]]`.
    fn read(source: &mut FileWithFindings<'_>, mut s: TomlSection<'_>) -> Option<Self> {
        // A key of another source is accepted, but has no effect.
        for key in KEYS {
            s.has(key.name);
        }
        let name = s.text(source, "name");
        let place = s.text(source, "place").map_or(String::new(), |at| at.value.to_owned());
        let period_s = s.number_or_default(source, "period_s");
        let role = Self::role(source, &mut s);
        let warm = role == Role::Temperature;
        let refuse = |source: &mut FileWithFindings<'_>,
                      s: &mut TomlSection<'_>,
                      key: &'static str,
                      expected: &str| {
            if let Some(at) = s.value(source, key, expected, |_| Some(())) {
                source.finding(at.offset, format!("the key {key}"), expected);
            }
        };
        let (range, max_rate_k_per_min) = if warm {
            refuse(source, &mut s, "range", "range_degC: it reads a temperature");
            let range = s.range(source, "range_degC").map_or([-20.0, 120.0], |at| at.value);
            (range, s.number_or_default(source, "max_rate_K_per_min"))
        } else {
            for key in ["range_degC", "max_rate_K_per_min"] {
                refuse(source, &mut s, key, "range: it reads no temperature");
            }
            (s.range(source, "range").map_or([-1e9, 1e9], |at| at.value), f64::INFINITY)
        };
        let (given, timeout_s) = (Self::source(source, &mut s, name), s.number(source, "timeout_s"));
        let (stuck_s, freeze_s) = ["stuck_s", "freeze_s"].map(|key| s.number_or_default(source, key)).into();
        s.finish(source);
        Some(Self {
            place,
            role,
            period_s,
            range,
            max_rate_k_per_min,
            timeout_s: timeout_s.map_or(5.0 * period_s, |at| at.value),
            stuck_s,
            freeze_s,
            source: given?,
            name: name?.value.to_owned(),
        })
    }

    fn role(source: &mut FileWithFindings<'_>, s: &mut TomlSection<'_>) -> Role {
        let expected = "temperature, spindle_speed, coolant, load.AXIS or channel";
        let sensed = |role: &Role| {
            matches!(
                role,
                Role::Temperature | Role::SpindleSpeed | Role::Coolant | Role::Load(_) | Role::Channel
            )
        };
        let role = s.value(source, "role", expected, |v| Role::parse(v.as_str()?).filter(sensed));
        role.map_or(Role::Temperature, |at| at.value)
    }

    fn source(
        source: &mut FileWithFindings<'_>,
        s: &mut TomlSection<'_>,
        name: Option<LocatedValue<&str>>,
    ) -> Option<SensorSource> {
        let kind = s.pick(source, "source", &["iio", "hwmon", "one_wire", "csv", "line"])?.value;
        let name = name.map_or(String::new(), |at| at.value.to_owned());
        // The key that must say where the readings are, and its permitted values.
        let (key, good, expected): (_, fn(&str) -> bool, _) = match kind {
            "iio" => ("device", is_one_folder, "a device's name, as \"iio:device0\""),
            "hwmon" => ("chip", is_one_folder, "a chip's name, as \"tmp102\""),
            "one_wire" => ("id", is_one_wire, "a 1-wire number, as \"28-0316a2798cff\""),
            "csv" => ("record", |_| true, "a recording, as \"NAME.run.toml\""),
            _ => ("from", is_feed, "\"host:port\" (port 1 to 65535), or a device as \"/dev/ttyUSB0\""),
        };
        let at = s.text(source, key)?;
        if !good(at.value) {
            let shown: String = at.value.chars().take(40).flat_map(char::escape_debug).collect();
            source.finding(at.offset, format!("{key} = \"{shown}\""), expected);
        }
        let text = at.value.to_owned();
        Some(match kind {
            "iio" => {
                SensorSource::Iio { device: text, channel: s.whole_or_default(source, "channel") as u32 }
            }
            "hwmon" => {
                let input = s.whole_or_default(source, "input").max(1) as u32;
                SensorSource::Hwmon { chip: text, input }
            }
            "one_wire" => SensorSource::OneWire { id: text },
            "csv" => SensorSource::Csv {
                column: s.text(source, "column").map_or(name, |at| at.value.to_owned()),
                record: source.file.parent().unwrap_or(Path::new("")).join(text),
            },
            _ => SensorSource::Line {
                from: text,
                key: s.text(source, "key").map_or(name, |at| at.value.to_owned()),
            },
        })
    }

    /// A sensor whose readings are always believed and never expire.
    /// It is used in simulations and for recorded shifts.
    pub fn believed(name: &str, role: Role) -> Self {
        Self {
            name: name.to_owned(),
            place: String::new(),
            role,
            source: SensorSource::Csv { record: PathBuf::new(), column: name.to_owned() },
            period_s: 1.0,
            range: [f64::NEG_INFINITY, f64::INFINITY],
            max_rate_k_per_min: f64::INFINITY,
            timeout_s: f64::INFINITY,
            stuck_s: 0.0,
            freeze_s: f64::INFINITY,
        }
    }
}

/// Reads the `[[sensor]]` tables; a recording's path is relative to the file.
/// A table with a mistake gives a finding and no sensor.
pub fn read_tables(source: &mut FileWithFindings<'_>, root: &mut TomlSection<'_>) -> Vec<SensorConfig> {
    let mut all: Vec<SensorConfig> = Vec::new();
    for s in root.tables(source, "sensor", "[[sensor]]") {
        let offset = s.offset;
        let Some(sensor) = SensorConfig::read(source, s.with(KEYS)) else { continue };
        if all.iter().any(|known| known.name == sensor.name) {
            source.finding(offset, format!("sensor `{}` twice", sensor.name), "each name once");
        }
        all.push(sensor);
    }
    all
}

/// Whether this is a family and serial number (w1(7)), such as 28-0316a2798cff.
fn is_one_wire(id: &str) -> bool {
    let hex = |s: &str| !s.is_empty() && s.chars().all(|c| c.is_ascii_hexdigit());
    id.split_once('-')
        .is_some_and(|(family, serial)| family.len() == 2 && hex(family) && serial.len() <= 16 && hex(serial))
}

fn is_feed(from: &str) -> bool {
    if let Some(device) = from.strip_prefix('/') {
        return !device.is_empty() && !from.chars().any(char::is_control);
    }
    from.rsplit_once(':').is_some_and(|(host, port)| {
        let named =
            !host.is_empty() && !host.chars().any(|c| c.is_whitespace() || c.is_control() || c == '/');
        named && port.parse::<u16>().is_ok_and(|p| p > 0)
    })
}

fn is_one_folder(name: &str) -> bool {
    !name.is_empty() && name != "." && name != ".." && !name.contains(['/', '\0'])
}

/// A sensor of the tests: °C within 0 to 80, at most 6 K a minute.
#[cfg(test)]
pub(crate) fn for_test(name: &str, source: SensorSource) -> SensorConfig {
    let believed = SensorConfig::believed(name, Role::Temperature);
    let (range, max_rate_k_per_min) = ([0.0, 80.0], 6.0);
    SensorConfig {
        source,
        range,
        max_rate_k_per_min,
        timeout_s: 3.0,
        stuck_s: 20.0,
        freeze_s: 10.0,
        ..believed
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rtec_files::strict_toml::Document;

    fn tables(text: &str) -> Result<Vec<SensorConfig>, String> {
        let text = text.replace('\'', "\"");
        let file = Path::new("rtec.toml");
        let document = Document::parse(file, &text).unwrap();
        let mut source = FileWithFindings { file, text: &text, findings: Vec::new() };
        let all = read_tables(&mut source, &mut TomlSection::root(&document));
        let said: Vec<String> = source.findings.iter().map(ToString::to_string).collect();
        if said.is_empty() { Ok(all) } else { Err(said.join("\n")) }
    }

    /// Defaults: a reading each second, -20 to 120 °C, at most 10 K a minute.
    #[test]
    fn what_a_sensors_table_does_not_say_has_a_default() {
        let read = tables(
            "[[sensor]]\nname='T1'\nsource='iio'\ndevice='d'\n\
             [[sensor]]\nname='wet'\nsource='hwmon'\nchip='c'\nrole='coolant'\nperiod_s=2.0\n\
             [[sensor]]\nname='F'\nsource='csv'\nrecord='r.run.toml'\nrole='load.z'\nrange=[0,900]\n\
             [[sensor]]\nname='T2'\nsource='line'\nfrom='h:1'\nkey='k'\nrange_degC=[0,50]\nmax_rate_K_per_min=3\n",
        )
        .unwrap();
        let z = rtec_model::record::Axis::new("z").unwrap();
        let roles = [Role::Temperature, Role::Coolant, Role::Load(z), Role::Temperature];
        let ranges = [[-20.0, 120.0], [-1e9, 1e9], [0.0, 900.0], [0.0, 50.0]];
        let rates = [10.0, f64::INFINITY, f64::INFINITY, 3.0];
        let sources = [
            SensorSource::Iio { device: "d".into(), channel: 0 },
            SensorSource::Hwmon { chip: "c".into(), input: 1 },
            SensorSource::Csv { record: "r.run.toml".into(), column: "F".into() },
            SensorSource::Line { from: "h:1".into(), key: "k".into() },
        ];
        assert_eq!(read.len(), 4);
        for (n, s) in read.into_iter().enumerate() {
            assert_eq!((s.role, s.range, s.max_rate_k_per_min), (roles[n].clone(), ranges[n], rates[n]));
            assert_eq!(
                (s.period_s, s.timeout_s),
                ([1.0, 2.0, 1.0, 1.0][n], [5.0, 10.0, 5.0, 5.0][n]),
                "{}",
                s.name
            );
            assert_eq!((s.source, s.stuck_s, s.freeze_s), (sources[n].clone(), 0.0, 60.0));
        }
        assert_eq!(tables("").unwrap(), []);
    }

    #[test]
    fn a_sensors_table_that_cannot_be_meant_is_named_with_its_place() {
        let one = "[[sensor]]\nname='T1'\nsource='iio'\ndevice='d'\n";
        for (more, said) in [
            (one, "5:1: found sensor `T1` twice, expected each name once"),
            ("channel=1.5\n", "5:9: found channel = 1.5, expected channel = a whole number from 0 to 4095"),
            ("channel=-1\n", "5:9: found channel = -1, expected channel = a whole number from 0 to 4095"),
            (
                "role='position.x'\n",
                "5:6: found role = \"position.x\", expected role = temperature, spindle_speed",
            ),
            ("range=[0,50]\n", "5:7: found the key range, expected range_degC: it reads a temperature"),
            (
                "role='coolant'\nrange_degC=[0,1]\n",
                "6:12: found the key range_degC, expected range: it reads no temperature",
            ),
        ] {
            let found = tables(&[one, more].concat()).unwrap_err();
            assert!(found.contains(&format!("rtec.toml:{said}")), "{found}\n  for {said}");
        }
        assert_eq!(
            tables(&[one, "channel=3\n"].concat()).unwrap()[0].source,
            SensorSource::Iio { device: "d".into(), channel: 3 }
        );
    }
}
