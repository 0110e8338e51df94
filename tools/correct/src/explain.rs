//! Components of a correction, for people and for the control socket.

use rtec_sensors::{SensorMonitor, SensorUsability};
use serde::{Deserialize, Serialize};

/// Changes that a model would make now.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ModelChangePreview {
    /// The name that `machine.toml` gives it.
    pub name: String,
    /// Path of its `machine.toml`.
    pub file: String,
    /// Its hash; `model load` takes the model only with this hash.
    pub sha256: String,
    /// Notes of its fits: response, dates, uncertainty.
    pub fits: Vec<String>,
    /// Warnings to read before taking it.
    pub warnings: Vec<String>,
    /// Fits whose validity has ended; taking the model then needs consent.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub expired: Vec<String>,
    /// One entry per axis that changes or might.
    pub axes: Vec<AxisTotalChange>,
}

/// Change on one axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AxisTotalChange {
    /// Name of the axis.
    pub axis: String,
    /// Its present total, counts.
    pub now_counts: i64,
    /// The present total, µm.
    pub now_um: f64,
    /// Its total with the new model, counts.
    pub then_counts: i64,
    /// The new total, µm.
    pub then_um: f64,
    /// Reason why it would not follow the model yet.
    pub holds: Option<String>,
}

/// Components of an axis's correction.
/// They are errors that are removed, µm: the axis moves by the opposite.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AxisCorrectionComponents {
    /// Name of the axis.
    pub axis: String,
    /// The total that is requested of the engine, counts since homing.
    pub requested: i64,
    /// The same total, µm: the sum of the parts.
    pub total_um: f64,
    /// Components of the total.
    pub parts: Vec<CorrectionComponent>,
    /// Reason why it does not follow the model; none if it does.
    pub holds: Option<String>,
}

/// One part of a correction.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CorrectionComponent {
    /// The name of an effect, or of one of the other parts.
    /// These are `chain`, `part table`, `operator`, `on its way` (the rest of the ramp), `rounding` (to the
    /// design's increment) and `beyond max_correction_counts`.
    pub name: String,
    /// Its share of the total, µm.
    pub um: f64,
    /// The sensors it reads.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sensors: Vec<SensorStateReport>,
    /// Distance of the temperature difference from the range of its fit, K.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub outside_k: Option<f64>,
    /// Remaining weight of the effect at this distance, 0 to 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub weight: Option<f64>,
}

impl CorrectionComponent {
    pub(crate) fn plain(name: &str, um: f64) -> Self {
        Self { name: name.to_owned(), um, sensors: Vec::new(), outside_k: None, weight: None }
    }
}

/// Present state of a temperature sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SensorStateReport {
    /// The sensor's name, as effects use it.
    pub sensor: String,
    /// Its place on the machine, for people.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub place: String,
    /// The sensor's last good value, °C.
    pub degc: Option<f64>,
    /// Age of that value, s.
    pub age_s: Option<f64>,
    /// `good`, `frozen` (the last good value is used instead) or `hold`.
    pub state: String,
    /// What is wrong with the sensor, if anything.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fault: Option<String>,
}

impl SensorStateReport {
    /// State of a sensor at a time, s.
    pub fn of(watch: &SensorMonitor, now_s: f64) -> Self {
        Self {
            sensor: watch.config().name.clone(),
            place: watch.config().place.clone(),
            degc: watch.value_degc(),
            age_s: watch.age_s(now_s),
            state: match watch.usable(now_s) {
                SensorUsability::Good => "good",
                SensorUsability::Frozen => "frozen",
                SensorUsability::Hold => "hold",
            }
            .to_owned(),
            fault: watch.fault().map(ToString::to_string),
        }
    }
}

/// The running model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunningModelReport {
    /// The name that `machine.toml` gives it.
    pub name: String,
    /// Path of its `machine.toml`.
    pub file: String,
    /// SHA-256 of that file, in hexadecimal.
    pub sha256: String,
    /// Notes of its fits.
    pub fits: Vec<String>,
    /// Fits whose validity has ended.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub expired: Vec<String>,
    /// Days since its oldest fit; none if no fit has a date.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub age_days: Option<i64>,
    /// Days until the first of its fits ends; below zero, past it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub days_left: Option<i64>,
    /// Present notes: past its date, outside the range of a fit, at a limit.
    pub notes: Vec<String>,
}
