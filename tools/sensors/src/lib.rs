//! Sensors: how each is configured, read, trusted and logged.
//!
//! This crate does not know the effect of a reading in micrometres.

mod config; // `[[sensor]]` of a file: keys, bounds, defaults
pub mod sensor_bank; // all sensors of one bus: sysfs, recordings, feeds
pub mod sensor_bus_threads; // one thread per bus, and the latest readings
pub mod sensor_monitor; // whether a reading is believed: good, replaced by the last good value, or hold
pub mod sensor_text_stream; // lines `NAME VALUE` over TCP or a serial device
pub mod temperature_log; // the temperatures' log, which a restart reads back

pub use config::{KEYS, SensorConfig, SensorSource, read_tables};
pub use sensor_monitor::{SensorFault, SensorMonitor, SensorUsability};
