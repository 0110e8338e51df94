//! The temperature difference that a thermal effect reads.

use rtec_files::InputError;
use rtec_files::strict_toml::{Table, TomlKeyValue};
use std::fmt;

/// The temperature that a sensor is compared with.
#[derive(Debug, Clone, PartialEq)]
pub enum ReferenceTemperature {
    /// Another sensor: a differential pair.
    Sensor(String),
    /// A fixed temperature, °C.
    Reference(f64),
    /// No reference given: 20 °C.
    Standard,
}

/// Reference temperature of dimensional metrology if none is given, °C (ISO 1).
pub const STANDARD_DEGC: f64 = 20.0;

/// A temperature difference: sensor minus sensor, or minus a reference.
#[derive(Debug, Clone, PartialEq)]
pub struct TemperatureDifference {
    /// The sensor's name.
    pub sensor: String,
    /// The temperature that it is compared with.
    pub against: ReferenceTemperature,
}

impl TemperatureDifference {
    /// Finds the sensors.
    pub(crate) fn find<S, E>(
        &self,
        of: impl Fn(&str) -> Result<S, E>,
    ) -> Result<ResolvedTemperatureDifference<S>, E> {
        let (sensor, minus) = (of(&self.sensor)?, self.minus().map(of).transpose()?);
        Ok(ResolvedTemperatureDifference { sensor, minus, reference_degc: self.reference_degc() })
    }

    /// The sensors it reads: one or two.
    pub fn sensors(&self) -> impl Iterator<Item = &str> {
        std::iter::once(self.sensor.as_str()).chain(self.minus())
    }

    /// The sensor subtracted, if it is a pair.
    pub fn minus(&self) -> Option<&str> {
        match &self.against {
            ReferenceTemperature::Sensor(minus) => Some(minus),
            ReferenceTemperature::Reference(_) | ReferenceTemperature::Standard => None,
        }
    }

    /// The fixed temperature subtracted, °C; of a pair the standard one.
    pub fn reference_degc(&self) -> f64 {
        if let ReferenceTemperature::Reference(degc) = self.against { degc } else { STANDARD_DEGC }
    }

    /// The difference of two sensors.
    pub fn pair(sensor: &str, minus: &str) -> Self {
        Self { sensor: sensor.to_owned(), against: ReferenceTemperature::Sensor(minus.to_owned()) }
    }

    /// Whether it is the difference of two sensors.
    pub fn is_pair(&self) -> bool {
        self.minus().is_some()
    }

    /// The difference in full, with the standard temperature.
    /// It is `T3-20` if the name alone is `T3`.
    pub fn in_full(&self) -> String {
        match self.against {
            ReferenceTemperature::Standard => format!("{}-{STANDARD_DEGC}", self.sensor),
            _ => self.to_string(),
        }
    }

    /// Sensor minus the standard 20 °C.
    pub fn single(sensor: &str) -> Self {
        Self { sensor: sensor.to_owned(), against: ReferenceTemperature::Standard }
    }
}

/// A difference whose sensors have been found, as places or as columns.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ResolvedTemperatureDifference<S> {
    sensor: S,
    minus: Option<S>,
    reference_degc: f64,
}

impl<S> ResolvedTemperatureDifference<S> {
    /// The difference from each sensor's temperature, K.
    pub(crate) fn kelvin(&self, degc: impl Fn(&S) -> f64) -> f64 {
        degc(&self.sensor) - self.minus.as_ref().map_or(self.reference_degc, &degc)
    }
}

impl fmt::Display for TemperatureDifference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.against {
            ReferenceTemperature::Sensor(minus) => write!(f, "{}-{minus}", self.sensor),
            ReferenceTemperature::Reference(degc) => {
                // Four decimals are enough: a fitted reference has more digits than anybody reads.
                let text = format!("{degc:.4}");
                write!(f, "{}-{}", self.sensor, text.trim_end_matches('0').trim_end_matches('.'))
            }
            ReferenceTemperature::Standard => f.write_str(&self.sensor),
        }
    }
}

/// Reads a reference temperature, °C, within the range of workshops.
fn reference_degc(entry: TomlKeyValue<'_>) -> Result<f64, InputError> {
    entry.within([-40.0, 150.0], "a reference temperature in degC")
}

/// Reads `sensor` with `minus`, with `reference_degC`, or alone.
pub(crate) fn read_difference(table: Table<'_>) -> Result<TemperatureDifference, InputError> {
    let sensor = table.required("sensor", "the sensor's name, as sensor = \"T8\"")?;
    let against = match (table.get("minus"), table.get("reference_degC")) {
        (Some(_), Some(r)) => {
            return Err(r.key_error("`minus` and `reference_degC` both", "one of the two, or neither"));
        }
        (Some(m), None) => {
            let minus = m.str("a sensor's name")?;
            if minus == sensor.str("a sensor's name")? {
                return Err(m.error(format!("`{minus}` minus itself"), "another sensor: this is always 0 K"));
            }
            ReferenceTemperature::Sensor(minus.to_owned())
        }
        (None, Some(r)) => ReferenceTemperature::Reference(reference_degc(r)?),
        (None, None) => ReferenceTemperature::Standard,
    };
    Ok(TemperatureDifference { sensor: sensor.str("a sensor's name")?.to_owned(), against })
}
