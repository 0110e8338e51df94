//! `[[sensor]]` for the control law, with checks for values that make no sense.

use super::plain;
use rtec_correct::sensors::{self, SensorConfig, SensorSource};
use rtec_files::toml::{SourceFile, Table};
use std::path::Path;

/// Time between two readings, s.
const PERIOD_S: [f64; 2] = [0.01, 3600.0];
/// Other times of a sensor, s.
const TIME_S: [f64; 2] = [0.01, 1e6];

/// Fastest change that is believed, K/min.
const RATE_K_PER_MIN: [f64; 2] = [1e-3, 1e4];
/// Ends of a range, °C or what the sensor measures in.
const RANGE: f64 = 1e9;
/// Highest number of a channel or an input.
const CHANNEL: f64 = 4095.0;

/// The `[[sensor]]` tables; recordings to replay are beside the configuration.
pub(super) fn read(source: &mut SourceFile<'_>, root: &Table<'_>) -> Vec<SensorConfig> {
    let file = source.file;
    let mut all = source.keep(sensors::read_tables(root)).unwrap_or_default();
    let tables = root.get("sensor").and_then(|e| e.tables("[[sensor]] tables").ok()).unwrap_or_default();
    // Where the tables could not be read the finding is there already.
    for (table, sensor) in tables.iter().zip(&mut all) {
        check(source, table, sensor);
        if let SensorSource::Csv { record, .. } = &mut sensor.source {
            *record = file.parent().unwrap_or(Path::new("")).join(&*record);
        }
    }
    all
}

fn check(source: &mut SourceFile<'_>, table: &Table<'_>, sensor: &SensorConfig) {
    for key in ["name", "place", "device", "chip", "key", "column"] {
        if let Some(entry) = table.get(key)
            && let Some(text) = entry.as_str()
            && let Some((found, expected)) = plain::bad_name(key, text, key == "name")
        {
            source.finding(entry.offset(), found, expected);
        }
    }
    let mut times = vec![("period_s", sensor.period_s, PERIOD_S)];
    times.extend([("timeout_s", sensor.timeout_s, TIME_S), ("freeze_s", sensor.freeze_s, TIME_S)]);
    if sensor.stuck_s != 0.0 {
        times.push(("stuck_s", sensor.stuck_s, TIME_S));
    }
    for (key, value, [low, high]) in times {
        // What is not written follows from the period.
        if let Some(entry) = table.get(key)
            && !(low..=high).contains(&value)
        {
            source.finding(entry.offset(), format!("{key} = {value:e}"), format!("{low} to {high} s"));
        }
    }
    let number = |key: &str| table.get(key).and_then(|e| Some((e.offset(), e.as_number()?)));
    let [low, high] = RATE_K_PER_MIN;
    if let Some((at, rate)) = number("max_rate_K_per_min").filter(|(_, rate)| !(low..=high).contains(rate)) {
        source.finding(at, format!("max_rate_K_per_min = {rate:e}"), format!("{low} to {high} K/min"));
    }
    for key in ["channel", "input"] {
        if let Some((at, number)) = number(key).filter(|(_, number)| *number > CHANNEL) {
            source.finding(at, format!("{key} = {number:e}"), format!("a whole number up to {CHANNEL}"));
        }
    }
    for key in ["range", "range_degC"] {
        if let Some(entry) = table.get(key)
            && sensor.range.iter().any(|end| end.abs() > RANGE)
        {
            source.finding(
                entry.offset(),
                format!("{key} = {}", entry.text()),
                format!("ends within ±{RANGE:e}"),
            );
        }
    }
    let (key, bad, expected) = match &sensor.source {
        SensorSource::OneWire { id } => ("id", !is_one_wire(id), "a 1-wire number, as \"28-0316a2798cff\""),
        SensorSource::Line { from, .. } => {
            ("from", !is_feed(from), "\"host:port\" (port 1 to 65535), or a device as \"/dev/ttyUSB0\"")
        }
        SensorSource::Iio { device, .. } => {
            ("device", !is_one_folder(device), "a device's name, as \"iio:device0\"")
        }
        SensorSource::Hwmon { chip, .. } => ("chip", !is_one_folder(chip), "a chip's name, as \"tmp102\""),
        SensorSource::Csv { .. } => return,
    };
    if let Some(entry) = table.get(key).filter(|_| bad) {
        let shown: String = entry.text().chars().take(40).flat_map(char::escape_debug).collect();
        source.finding(entry.offset(), format!("{key} = \"{shown}\""), expected);
    }
}

/// Family and serial number (w1(7)): 28-0316a2798cff.
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
