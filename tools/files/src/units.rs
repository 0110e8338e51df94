//! Units that the name of a column states: `Time [ms]`, `X (in)`, `position_mm`.

/// What people write, and the same unit as formats.md writes it.
const ALIASES: [(&str, &str); 24] = [
    ("µm", "um"),
    ("μm", "um"),
    ("micron", "um"),
    ("microns", "um"),
    ("µs", "us"),
    ("μs", "us"),
    ("sec", "s"),
    ("seconds", "s"),
    ("msec", "ms"),
    ("min.", "min"),
    ("\"", "in"),
    ("inches", "in"),
    ("°C", "degC"),
    ("℃", "degC"),
    ("C", "degC"),
    ("°F", "degF"),
    ("F", "degF"),
    ("°", "deg"),
    ("mm/s²", "mm/s2"),
    ("m/s²", "m/s2"),
    ("mm/s^2", "mm/s2"),
    ("m/s^2", "m/s2"),
    ("1/min", "rpm"),
    ("µrad", "urad"),
];

/// A unit as formats.md writes it, one that is not known as it stands.
#[must_use]
pub fn plain(unit: &str) -> &str {
    ALIASES.iter().find(|(alias, _)| *alias == unit).map_or(unit, |(_, plain)| plain)
}

/// A unit in a column's name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stated<'n> {
    /// As formats.md writes it, where it is known.
    pub unit: &'n str,
    /// It stands in brackets, where nothing but a unit stands.
    pub in_brackets: bool,
    /// The name without it.
    pub name: &'n str,
}

/// The unit that a name states.
/// It stands in brackets at the end, or behind a blank, a `/` or the last `_`.
#[must_use]
pub fn stated(name: &str) -> Option<Stated<'_>> {
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
        return is_word.then(|| Stated { unit: plain(inside), in_brackets: true, name: name[..open].trim() });
    }
    // Behind a blank a letter or a digit tells one column from another: `T C`, `Probe 1`.
    let is_word = |unit: &str| unit.chars().nth(1).is_some() && !unit.ends_with(|c: char| c.is_ascii_digit());
    let behind_blank = name.rsplit_once(char::is_whitespace).filter(|(_, unit)| is_word(unit));
    let (name, unit) = behind_blank.or_else(|| name.split_once('/')).or_else(|| name.rsplit_once('_'))?;
    Some(Stated { unit: plain(unit.trim()), in_brackets: false, name: name.trim_end_matches('/').trim() })
}

#[cfg(test)]
mod tests {
    use super::*;

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
