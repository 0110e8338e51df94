//! The readings of a temperature input without a working sensor.

/// Common codes of disconnected temperature sensors, °C.
/// They are from the data sheets of DS18B20 (power-on value), MAX6675 and MAX31855, and from the ranges of
/// PT100 (IEC 60751) and thermocouples type K (IEC 60584). Others are the ends of 16 bit numbers in tenths
/// and hundredths, and absolute zero. A machine cannot have the temperatures that are certain; the others must
/// be ruled out by other readings.
const DISCONNECTED: [(f64, &str, bool); 25] = [
    (999.9, "an open input's code", true),
    (999.0, "an open input's code", true),
    (-999.0, "an open input's code", true),
    (-999.9, "an open input's code", true),
    (9999.0, "an open input's code", true),
    (-9999.0, "an open input's code", true),
    (9999.9, "an open input's code", true),
    (-127.0, "a DS18B20 that does not answer", true),
    (127.937_5, "a DS18B20 whose conversion was cut short", true),
    (850.0, "an open PT100", true),
    (-200.0, "a shorted PT100", true),
    (1372.0, "an open thermocouple", true),
    (1023.75, "an open MAX6675 input", true),
    (32767.0, "the end of a 16 bit number", true),
    (32768.0, "the end of a 16 bit number", true),
    (-32768.0, "the end of a 16 bit number", true),
    (3276.7, "the end of a 16 bit number in tenths", true),
    (-3276.8, "the end of a 16 bit number in tenths", true),
    (327.67, "the end of a 16 bit number in hundredths", true),
    (-327.68, "the end of a 16 bit number in hundredths", true),
    (65535.0, "the end of a 16 bit number", true),
    (6553.5, "the end of a 16 bit number in tenths", true),
    (-273.15, "absolute zero", true),
    (85.0, "the power-on value of a DS18B20", false),
    (0.0, "an input without a sensor", false),
];

/// Why this reading is a code of a disconnected sensor and not a temperature.
/// `true`: certain. `false`: a machine can have this temperature too (85 °C, 0 °C), and the neighbouring rows
/// decide.
pub fn disconnected(degc: f64) -> Option<(&'static str, bool)> {
    // Readings may have been rounded to tenths or to single precision.
    let is = |value: f64| (value - degc).abs() <= 1e-6 * value.abs().max(1e-3);
    DISCONNECTED.iter().find(|(value, ..)| is(*value)).map(|&(_, why, certain)| (why, certain))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_told_from_temperatures() {
        assert_eq!(disconnected(-127.0), Some(("a DS18B20 that does not answer", true)));
        assert_eq!(disconnected(999.900_02).map(|d| d.1), Some(true));
        assert_eq!(disconnected(127.94), None);
        assert_eq!(disconnected(127.937_5).map(|d| d.1), Some(true));
        assert_eq!(disconnected(85.0).map(|d| d.1), Some(false));
        assert_eq!(disconnected(0.0).map(|d| d.1), Some(false));
        assert_eq!(disconnected(f64::from(999.9_f32)).map(|d| d.1), Some(true));
        for degc in [20.0, 84.9375, 85.0625, -40.0, 0.0625, 150.0] {
            assert_eq!(disconnected(degc), None, "{degc}");
        }
    }
}
