//! The readings of a temperature input without a working sensor.

/// The reading of a temperature input whose sensor is off, open or shorted, °C.
struct Disconnected {
    value: f64,
    why: &'static str,
    /// A machine can also have this temperature, so other readings must rule it out.
    real: bool,
}

const fn code(value: f64, why: &'static str) -> Disconnected {
    Disconnected { value, why, real: false }
}

/// Common codes of disconnected temperature sensors, °C.
/// They are from the data sheets of DS18B20 (power-on value), MAX6675 and MAX31855, and from the ranges of
/// PT100 (IEC 60751) and thermocouples type K (IEC 60584). Others are the ends of 16 bit numbers in tenths
/// and hundredths, and absolute zero.
const DISCONNECTED: [Disconnected; 25] = [
    code(999.9, "an open input's code"),
    code(999.0, "an open input's code"),
    code(-999.0, "an open input's code"),
    code(-999.9, "an open input's code"),
    code(9999.0, "an open input's code"),
    code(-9999.0, "an open input's code"),
    code(9999.9, "an open input's code"),
    code(-127.0, "a DS18B20 that does not answer"),
    code(127.937_5, "a DS18B20 whose conversion was cut short"),
    code(850.0, "an open PT100"),
    code(-200.0, "a shorted PT100"),
    code(1372.0, "an open thermocouple"),
    code(1023.75, "an open MAX6675 input"),
    code(32767.0, "the end of a 16 bit number"),
    code(32768.0, "the end of a 16 bit number"),
    code(-32768.0, "the end of a 16 bit number"),
    code(3276.7, "the end of a 16 bit number in tenths"),
    code(-3276.8, "the end of a 16 bit number in tenths"),
    code(327.67, "the end of a 16 bit number in hundredths"),
    code(-327.68, "the end of a 16 bit number in hundredths"),
    code(65535.0, "the end of a 16 bit number"),
    code(6553.5, "the end of a 16 bit number in tenths"),
    code(-273.15, "absolute zero"),
    Disconnected { value: 85.0, why: "the power-on value of a DS18B20", real: true },
    Disconnected { value: 0.0, why: "an input without a sensor", real: true },
];

/// Why this reading is a code of a disconnected sensor and not a temperature.
/// `true`: certain. `false`: a machine can have this temperature too (85 °C, 0 °C), and the neighbouring rows
/// decide.
pub fn disconnected(degc: f64) -> Option<(&'static str, bool)> {
    // Readings may have been rounded to tenths or to single precision.
    let found = DISCONNECTED.iter().find(|d| (d.value - degc).abs() <= 1e-6 * d.value.abs().max(1e-3));
    found.map(|d| (d.why, !d.real))
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
