//! Sensors: how each is configured, read, trusted and logged.
//!
//! | module | what |
//! |---|---|
//! | `config` | `[[sensor]]` of a file: keys, bounds, defaults |
//! | [`bank`] | all sensors of one bus: sysfs, recordings, feeds |
//! | [`feed`] | lines `NAME VALUE` over TCP or a serial device |
//! | [`trust`] | whether a reading is believed: good, replaced by the last good value, or hold |
//! | [`buses`] | one thread per bus, and the latest readings |
//! | [`log`] | the temperatures' log, which a restart reads back |
//!
//! This crate does not know the effect of a reading in micrometres.

pub mod bank;
pub mod buses;
mod config;
pub mod feed;
pub mod log;
pub mod trust;

pub use config::{KEYS, SensorConfig, SensorSource, read_tables};
pub use trust::{SensorFault, Use, Watch};
