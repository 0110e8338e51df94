//! What a thermal effect reads: a temperature difference.

use std::fmt;

/// What a temperature is compared with.
#[derive(Debug, Clone, PartialEq)]
pub enum Against {
    /// Another sensor: a differential pair.
    Sensor(String),
    /// A fixed temperature, °C.
    Reference(f64),
    /// Nothing given: 20 °C.
    Standard,
}

/// Reference temperature of dimensional metrology where none is given, °C (ISO 1).
pub const STANDARD_DEGC: f64 = 20.0;

/// A temperature difference: sensor minus sensor, or minus a reference.
#[derive(Debug, Clone, PartialEq)]
pub struct Difference {
    /// The sensor's name.
    pub sensor: String,
    /// What it is compared with.
    pub against: Against,
}

impl Difference {
    /// The sensors it reads: one or two.
    pub fn sensors(&self) -> impl Iterator<Item = &str> {
        let minus = match &self.against {
            Against::Sensor(minus) => Some(minus.as_str()),
            _ => None,
        };
        std::iter::once(self.sensor.as_str()).chain(minus)
    }

    /// Sensor minus sensor.
    #[must_use]
    pub fn pair(sensor: &str, minus: &str) -> Self {
        Self { sensor: sensor.to_owned(), against: Against::Sensor(minus.to_owned()) }
    }

    /// Whether it is sensor minus sensor.
    #[must_use]
    pub fn is_pair(&self) -> bool {
        matches!(self.against, Against::Sensor(_))
    }

    /// Sensor minus the standard 20 °C.
    #[must_use]
    pub fn single(sensor: &str) -> Self {
        Self { sensor: sensor.to_owned(), against: Against::Standard }
    }
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.against {
            Against::Sensor(minus) => write!(f, "{}-{minus}", self.sensor),
            Against::Reference(degc) => write!(f, "{}-{degc}", self.sensor),
            Against::Standard => f.write_str(&self.sensor),
        }
    }
}
