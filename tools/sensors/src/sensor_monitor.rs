//! Trust in a sensor.
//! A sensor that is stuck, jumps, falls silent or reads an impossible value is reported by name. Its last
//! good value is used for a stated time, then corrections hold. The reader of the sensor offers each reading
//! here.

use crate::SensorConfig;
use rtec_model::disconnected_sensor_codes::disconnected;
use rtec_model::record::Role;
use std::sync::Arc;

/// Fault of a sensor.
#[derive(Debug, Clone, PartialEq)]
pub enum SensorFault {
    /// No reading: the reason, and since when (s of the caller's clock).
    Silent(String),
    /// A reading outside its range or not a number, °C.
    Implausible(f64),
    /// Value that an input reads without its sensor, °C, and its kind.
    Unplugged(f64, &'static str),
    /// A change that is impossibly fast: from, to, °C.
    Jump(f64, f64),
    /// Exactly this value for too long, °C.
    Stuck(f64),
}

impl std::fmt::Display for SensorFault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Silent(why) => write!(f, "silent ({why})"),
            Self::Implausible(v) => write!(f, "implausible: {v}"),
            Self::Unplugged(v, why) => write!(f, "unplugged: {v} is {why}"),
            Self::Jump(a, b) => write!(f, "jump from {a:.2} to {b:.2} °C"),
            Self::Stuck(v) => write!(f, "stuck at {v}"),
        }
    }
}

/// How a model may use a sensor now.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum SensorUsability {
    /// Its value is good.
    Good,
    /// Its last good value is used instead.
    Frozen,
    /// Too old: corrections that depend on it hold.
    Hold,
}

/// One sensor under watch.
#[derive(Debug, Clone)]
pub struct SensorMonitor {
    config: Arc<SensorConfig>,
    good: Option<(f64, f64)>,
    raw: Option<(f64, f64)>,
    last_reading_s: Option<f64>,
    /// Possible range of the next reading, by good readings and the fastest change.
    reach: Option<ReachableRange>,
    fault: Option<SensorFault>,
}

/// The range a value can have reached from the good readings so far, °C.
/// The fastest rate bounds the change over time, however often readings come.
#[derive(Debug, Clone, Copy)]
struct ReachableRange {
    low: f64,
    high: f64,
    at_s: f64,
}

impl ReachableRange {
    fn of(value: f64, at_s: f64) -> Self {
        Self { low: value, high: value, at_s }
    }

    /// The range some time later, at a rate, K/s.
    fn at(self, now_s: f64, rate: f64) -> Self {
        let change = rate * (now_s - self.at_s).max(0.0);
        Self { low: self.low - change, high: self.high + change, at_s: now_s }
    }

    /// The range after a good reading at the same time.
    fn with(self, value: f64) -> Self {
        Self { low: self.low.max(value), high: self.high.min(value), ..self }
    }
}

impl SensorMonitor {
    /// A sensor that has not been read yet.
    pub fn new(config: SensorConfig) -> Self {
        Self {
            config: Arc::new(config),
            good: None,
            raw: None,
            last_reading_s: None,
            reach: None,
            fault: None,
        }
    }

    /// Its configuration.
    pub fn config(&self) -> &SensorConfig {
        &self.config
    }

    /// Takes a reading, or the reason why there is none, at a time, s.
    pub fn offer(&mut self, now_s: f64, reading: Result<f64, String>) {
        let value = match reading {
            Err(why) => {
                let since = self.last_reading_s.map_or(f64::INFINITY, |h| now_s - h);
                if since > self.config.timeout_s {
                    self.fault = Some(SensorFault::Silent(why));
                }
                return;
            }
            Ok(v) => v,
        };
        self.last_reading_s = Some(now_s);
        let since_same = match self.raw {
            Some((v, at)) if v.to_bits() == value.to_bits() => now_s - at,
            _ => {
                self.raw = Some((value, now_s));
                0.0
            }
        };
        let [lo, hi] = self.config.range;
        self.fault = if let Some(why) = self.unplugged(now_s, value) {
            Some(SensorFault::Unplugged(value, why))
        } else if !value.is_finite() || value < lo || value > hi {
            Some(SensorFault::Implausible(value))
        } else if self.config.stuck_s > 0.0 && since_same > self.config.stuck_s {
            Some(SensorFault::Stuck(value))
        } else {
            let jumped = self.good.filter(|_| self.jumps(now_s, value));
            jumped.map(|(v, _)| SensorFault::Jump(v, value))
        };
        if self.fault.is_none() {
            self.good = Some((value, now_s));
            let before = self.reach.filter(|_| self.rate().is_finite());
            self.reach = Some(
                before.map_or(ReachableRange::of(value, now_s), |r| r.at(now_s, self.rate()).with(value)),
            );
        }
    }

    /// Fastest possible change, K/s.
    fn rate(&self) -> f64 {
        self.config.max_rate_k_per_min / 60.0
    }

    /// Whether a value differs by more than can have changed since the good values.
    /// One second of change is allowed for the reading itself.
    fn jumps(&self, now_s: f64, value: f64) -> bool {
        let Some(reach) = self.reach.filter(|_| self.rate().is_finite()) else { return false };
        let ReachableRange { low, high, .. } = reach.at(now_s, self.rate());
        // A difference by rounding is not a change.
        let reading = self.rate() + 1e-9;
        value > high + reading || value < low - reading
    }

    /// Reason why this reading is not a temperature of the machine, if so.
    /// It is an error code outside any machine's range, or a code (85 °C, 0 °C) that it cannot have reached.
    fn unplugged(&self, now_s: f64, value: f64) -> Option<&'static str> {
        if self.config.role != Role::Temperature || self.config.range[0] == f64::NEG_INFINITY {
            return None;
        }
        let (why, certain) = disconnected(value)?;
        (certain || self.good.is_none() || self.jumps(now_s, value)).then_some(why)
    }

    /// The last good value, °C.
    pub fn value_degc(&self) -> Option<f64> {
        self.good.map(|g| g.0)
    }

    /// Its age, s.
    pub fn age_s(&self, now_s: f64) -> Option<f64> {
        self.good.map(|g| now_s - g.1)
    }

    /// What is wrong with it, if anything.
    pub fn fault(&self) -> Option<&SensorFault> {
        self.fault.as_ref()
    }

    /// How a model may use it now.
    pub fn usable(&self, now_s: f64) -> SensorUsability {
        let old = self.age_s(now_s).unwrap_or(f64::INFINITY);
        if old > self.config.freeze_s.max(self.config.timeout_s) {
            SensorUsability::Hold
        } else if self.fault.is_some() || old > self.config.timeout_s {
            SensorUsability::Frozen
        } else {
            SensorUsability::Good
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SensorSource;
    use crate::config::for_test as config;

    fn watch() -> SensorMonitor {
        SensorMonitor::new(config("T1", SensorSource::OneWire { id: "28-0".into() }))
    }

    #[test]
    fn a_good_sensor_is_good_and_ages() {
        let mut w = watch();
        assert_eq!(w.usable(0.0), SensorUsability::Hold);
        w.offer(0.0, Ok(20.0));
        assert_eq!((w.value_degc(), w.usable(2.0)), (Some(20.0), SensorUsability::Good));
        assert_eq!((w.usable(5.0), w.usable(11.0)), (SensorUsability::Frozen, SensorUsability::Hold));
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
            assert_eq!(w.usable(now), SensorUsability::Frozen, "{fault}");
            assert_eq!(w.usable(now + 30.0), SensorUsability::Hold, "{fault}");
        };
        says(&[(1.0, Ok(20.05)), (2.0, Ok(25.0))], "jump from 20.05 to 25.00", 20.05);
        says(&[(1.0, Ok(99.0))], "implausible: 99", 20.0);
        says(&[(1.0, Ok(-127.0))], "unplugged: -127 is a DS18B20 that does not answer", 20.0);
        says(&[(1.0, Ok(0.0))], "unplugged: 0", 20.0);
        says(&[(1.0, Ok(f64::NAN))], "implausible", 20.0);
        says(&[(4.0, Err("gone".into()))], "silent (gone)", 20.0);
        let same: Vec<(f64, Result<f64, String>)> = (1..24).map(|i| (f64::from(i), Ok(20.0))).collect();
        says(&same, "stuck at 20", 20.0);
    }

    /// The limit is 6 K a minute, however often readings come and with whatever noise.
    #[test]
    fn the_limit_of_a_change_is_over_time_not_per_reading() {
        for (per_s, noise) in [(1.0, 0.0), (20.0, 0.0), (20.0, 0.05), (1000.0, 0.05)] {
            let follows = |k_per_min: f64| {
                let mut w = SensorMonitor::new(SensorConfig { stuck_s: 0.0, ..watch().config().clone() });
                let mut last = 20.0;
                for n in 0..(120.0 * per_s) as u32 {
                    let t = f64::from(n) / per_s;
                    let value = 20.0 + k_per_min / 60.0 * t + if n % 2 == 0 { noise } else { -noise };
                    w.offer(t, Ok(value));
                    last = value;
                }
                (w.value_degc().unwrap(), last)
            };
            let (seen, true_degc) = follows(5.0);
            assert!((seen - true_degc).abs() < 1e-9, "{per_s} a second, noise {noise}: {seen} {true_degc}");
            // 15 times too fast for two minutes: it is believed for 6 K a minute and one second of change,
            // not 90 K a minute.
            let (seen, _) = follows(90.0);
            assert!(seen < 20.0 + 2.0 * 6.0 + 0.2 + 2.0 * noise, "{per_s} a second, noise {noise}: {seen}");
        }
    }

    #[test]
    fn one_missed_reading_is_no_fault_and_a_jump_that_comes_back_is_forgiven() {
        let mut w = watch();
        w.offer(0.0, Ok(20.0));
        w.offer(1.0, Err("busy".into()));
        assert_eq!((w.fault(), w.usable(1.0)), (None, SensorUsability::Good));
        w.offer(2.0, Ok(27.0));
        w.offer(3.0, Ok(20.2));
        assert_eq!((w.fault(), w.value_degc()), (None, Some(20.2)));
    }

    /// A value exactly at a limit is within it.
    /// Limits are range, change, silence, unchanged value and age.
    #[test]
    fn at_its_limits_a_sensor_is_still_good() {
        let channel = |value: f64| {
            let range = [10.0, 80.0];
            let source = SensorSource::OneWire { id: "28-0".into() };
            let mut w =
                SensorMonitor::new(SensorConfig { range, role: Role::Channel, ..config("c", source) });
            w.offer(0.0, Ok(value));
            w.fault().is_some()
        };
        assert_eq!([9.9, 10.0, 80.0, 80.1].map(channel), [true, false, false, true]);
        // 6 K a minute: a kelvin in nine seconds, plus one second of change for the reading itself.
        let jump = |value: f64| {
            let mut w = watch();
            w.offer(100.0, Ok(20.0));
            w.offer(109.0, Ok(value));
            w.fault().is_some()
        };
        assert_eq!([18.9, 19.0, 21.0, 21.1].map(jump), [true, false, false, true]);
        let silent = |s: f64| {
            let mut w = watch();
            w.offer(100.0, Ok(20.0));
            w.offer(100.0 + s, Err("gone".into()));
            (w.fault().is_some(), w.usable(100.0 + s))
        };
        assert_eq!([2.0, 3.0].map(silent), [(false, SensorUsability::Good); 2]);
        assert_eq!(
            [3.1, 10.0, 10.1].map(silent),
            [(true, SensorUsability::Frozen), (true, SensorUsability::Frozen), (true, SensorUsability::Hold)]
        );
        // The same value for more than 20 s is stuck; a changing value is not, for any time.
        let stuck = |until: i32, step: f64| {
            let mut w = watch();
            (0..=until).for_each(|s| w.offer(100.0 + f64::from(s), Ok(20.0 + step * f64::from(s))));
            w.fault().cloned()
        };
        assert_eq!((stuck(20, 0.0), stuck(21, 0.0)), (None, Some(SensorFault::Stuck(20.0))));
        assert_eq!(stuck(60, 0.01), None);
    }

    /// 0 and 85 °C are temperatures too, but not as a sensor's first reading.
    /// For other roles, and where every reading is believed, they are ordinary values.
    #[test]
    fn a_code_is_one_only_where_a_temperature_is_read() {
        let source = SensorSource::OneWire { id: "28-0".into() };
        let temperature = SensorConfig { range: [-20.0, 120.0], ..config("T1", source) };
        let first = |config: SensorConfig, value: f64| {
            let mut w = SensorMonitor::new(config);
            w.offer(0.0, Ok(value));
            w.value_degc()
        };
        for code in [0.0, 85.0] {
            assert_eq!(first(temperature.clone(), code), None);
            assert_eq!(first(SensorConfig { role: Role::Coolant, ..temperature.clone() }, code), Some(code));
            assert_eq!(first(SensorConfig::believed("T1", Role::Temperature), code), Some(code));
            let mut w = SensorMonitor::new(temperature.clone());
            w.offer(0.0, Ok(code + 0.05));
            w.offer(1.0, Ok(code));
            assert_eq!((w.fault(), w.value_degc()), (None, Some(code)), "it was nearly there before");
        }
    }
}
