//! Units in the names of columns: `Time [ms]`, `X (in)`, `position_mm`.

/// The program's spelling of a unit, and others.
const ALIASES: [(&str, &[&str]); 17] = [
    ("um", &["µm", "μm", "micron", "microns", "micrometre", "micrometer"]),
    ("mm", &["millimetre", "millimeter"]),
    ("m", &["metre", "meter"]),
    ("us", &["µs", "μs", "microseconds"]),
    ("s", &["sec", "Sek", "second", "seconds"]),
    ("ms", &["msec", "millisecond", "milliseconds"]),
    ("min", &["min.", "minutes"]),
    ("h", &["hours"]),
    ("in", &["\"", "inch", "Inch", "inches", "Zoll"]),
    ("mil", &["thou"]),
    ("degC", &["deg C", "Celsius", "°C", "℃", "C"]),
    ("degF", &["°F", "F"]),
    ("deg", &["°"]),
    ("mm/s2", &["mm/s²", "mm/s^2"]),
    ("m/s2", &["m/s²", "m/s^2"]),
    ("rpm", &["1/min"]),
    ("urad", &["µrad"]),
];

/// A unit in the program's spelling; an unknown unit stays as it is.
pub fn plain(unit: &str) -> &str {
    ALIASES.iter().find(|(_, others)| others.contains(&unit)).map_or(unit, |(plain, _)| plain)
}

/// A unit's name, its factor to the quantity's own unit, and the offset after it.
pub type Unit = (&'static str, f64, f64);

/// Seconds of a day.
pub const DAY_S: f64 = 86_400.0;
/// A step of Windows' FILETIME, s.
pub const FILETIME_S: f64 = 1e-7;

/// Units of each quantity; the first is the program's own.
const QUANTITIES: [(&str, &[Unit]); 8] = [
    (
        "s",
        &[
            ("ns", 1e-9, 0.0),
            ("100ns", FILETIME_S, 0.0),
            ("us", 1e-6, 0.0),
            ("ms", 1e-3, 0.0),
            ("min", 60.0, 0.0),
            ("h", 3600.0, 0.0),
            ("d", DAY_S, 0.0),
        ],
    ),
    ("mm", &[("um", 1e-3, 0.0), ("nm", 1e-6, 0.0), ("m", 1e3, 0.0), ("in", 25.4, 0.0), ("mil", 0.0254, 0.0)]),
    (
        "um",
        &[("nm", 1e-3, 0.0), ("mm", 1e3, 0.0), ("m", 1e6, 0.0), ("in", 25_400.0, 0.0), ("mil", 25.4, 0.0)],
    ),
    (
        "mm/s",
        &[
            ("mm/min", 1.0 / 60.0, 0.0),
            ("m/min", 1000.0 / 60.0, 0.0),
            ("m/s", 1e3, 0.0),
            ("in/min", 25.4 / 60.0, 0.0),
            ("inch/min", 25.4 / 60.0, 0.0),
            ("inch/s", 25.4, 0.0),
        ],
    ),
    ("mm/s2", &[("m/s2", 1e3, 0.0)]),
    ("degC", &[("K", 1.0, -273.15), ("degF", 5.0 / 9.0, -160.0 / 9.0)]),
    ("rad", &[("deg", std::f64::consts::PI / 180.0, 0.0)]),
    ("N", &[("kN", 1e3, 0.0), ("lbf", 4.448_221_615_260_5, 0.0)]),
];

/// Units that can be converted to `own`; empty if there are none.
pub fn others(own: &str) -> &'static [Unit] {
    QUANTITIES.iter().find(|(unit, _)| *unit == own).map_or(&[], |(_, others)| others)
}

fn is_one_quantity(a: &str, b: &str) -> bool {
    let has = |own: &str, others: &[Unit], unit: &str| own == unit || others.iter().any(|o| o.0 == unit);
    QUANTITIES.iter().any(|(own, others)| has(own, others, a) && has(own, others, b))
}

/// The unit in a name, if it contradicts the unit that the column is read in.
///
/// Both are of one quantity and differ. After a `_` or a blank a single letter is part of the name (`x_m` may
/// be x as measured).
pub fn contradicted<'n>(name: &'n str, said: &str) -> Option<&'n str> {
    let (stated, said) = (stated(name)?, plain(said));
    let is_unit = stated.in_brackets || stated.unit.len() > 1 && stated.name.len() < name.trim().len();
    (is_unit && stated.unit != said && is_one_quantity(stated.unit, said)).then_some(stated.unit)
}

/// The name with its unit replaced by the one that its column was converted to.
pub fn with_unit_replaced(name: &str, unit: &str) -> String {
    let Some(found) = contradicted(name, unit).and_then(|_| stated(name)) else { return name.to_owned() };
    let written = &name.trim()[found.name.len()..];
    let of_unit = written.trim_matches([' ', '[', ']', '(', ')', '/', '_']);
    format!("{}{}", found.name, written.replacen(of_unit, unit, 1))
}

/// A unit in a column's name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ColumnUnit<'n> {
    /// In the program's spelling, if it is known.
    pub unit: &'n str,
    /// Whether it is in brackets, which hold nothing but a unit.
    pub in_brackets: bool,
    /// The name without it.
    pub name: &'n str,
}

/// Finds the unit in a name.
/// It is in brackets at the end, or after a blank, a `/` or the last `_`.
pub fn stated(name: &str) -> Option<ColumnUnit<'_>> {
    let name = name.trim();
    let open = match name.chars().next_back()? {
        ']' => name.rfind('['),
        ')' => name.rfind('('),
        _ => None,
    };
    if let Some(open) = open {
        let inside = name[open + 1..name.len() - 1].trim();
        let is_word = !inside.is_empty()
            && !inside.contains(char::is_whitespace)
            && !inside.starts_with(|c: char| c.is_ascii_digit() && inside.len() == 1)
            && !inside.contains([':', ',', '#', '(', '[']);
        return is_word.then(|| ColumnUnit {
            unit: plain(inside),
            in_brackets: true,
            name: name[..open].trim(),
        });
    }
    // After a blank a letter or a digit distinguishes columns: `T C`, `Probe 1`.
    let is_word = |unit: &str| unit.chars().nth(1).is_some() && !unit.ends_with(|c: char| c.is_ascii_digit());
    let behind_blank = name.rsplit_once(char::is_whitespace).filter(|(_, unit)| is_word(unit));
    let (name, unit) = behind_blank.or_else(|| name.split_once('/')).or_else(|| name.rsplit_once('_'))?;
    Some(ColumnUnit { unit: plain(unit.trim()), in_brackets: false, name: name.trim_end_matches('/').trim() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_contradicts_another_unit_of_its_quantity() {
        for (name, said, stated, restated_as) in [
            ("nominal_in", "mm", Some("in"), "nominal_mm"),
            ("x [µm]", "mm", Some("um"), "x [mm]"),
            ("Abweichung [mm]", "um", Some("mm"), "Abweichung [um]"),
            ("Abweichung/mm", "um", Some("mm"), "Abweichung/um"),
            ("Time ms", "s", Some("ms"), "Time s"),
            ("X (inch)", "mm", Some("in"), "X (mm)"),
            ("T [°F]", "degC", Some("degF"), "T [degC]"),
            ("T_in", "degC", None, "T_in"),
            ("x_m", "mm", None, "x_m"),
            ("Time [ms]", "ms", None, "Time [ms]"),
            ("x [furlong]", "mm", None, "x [furlong]"),
            ("nominal", "mm", None, "nominal"),
        ] {
            assert_eq!(contradicted(name, said), stated, "{name}");
            assert_eq!(with_unit_replaced(name, said), restated_as, "{name}");
        }
    }

    #[test]
    fn names_state_units_in_brackets_or_behind_a_line() {
        let unit = |name| stated(name).map(|s| (s.unit, s.in_brackets, s.name));
        for (name, wants) in [
            ("Time [ms]", Some(("ms", true, "Time"))),
            ("X (in)", Some(("in", true, "X"))),
            ("e (µm)", Some(("um", true, "e"))),
            ("Temperature [°C]", Some(("degC", true, "Temperature"))),
            ("X [furlong]", Some(("furlong", true, "X"))),
            ("position_mm", Some(("mm", false, "position"))),
            ("Fehler mm", Some(("mm", false, "Fehler"))),
            ("Abweichung/mm", Some(("mm", false, "Abweichung"))),
            ("Time / ms", Some(("ms", false, "Time"))),
            ("t/s", Some(("s", false, "t"))),
            ("v mm/s", Some(("mm/s", false, "v"))),
            ("Probe 1", None),
            ("Motor F", None),
            ("Temp, °C (LGR S/N: 7)", None),
            ("Channel (1)", None),
            ("e # um", Some(("um", false, "e #"))),
            ("x", None),
            ("", None),
            ("[]", None),
        ] {
            assert_eq!(unit(name), wants, "{name}");
        }
    }
}
