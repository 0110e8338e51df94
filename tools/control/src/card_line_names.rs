//! Names of card lines in a configuration.

use rtec_driver::gpio::{Bias, Drive, GpioLineId, GpioLineSettings};
use rtec_files::strict_toml::TomlKeyValue;
use rtec_files::toml_section_keys::{FileWithFindings, LocatedValue, TomlSection};

/// Name of a line in a configuration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum CardLineName<'a> {
    /// A line of the card's profile.
    Name(&'a str),
    /// A bit of the card's input or output word.
    Bit(u8),
}

/// Values of `bias`.
pub(crate) const BIASES: [(&str, Bias); 3] =
    [("pull-up", Bias::PullUp), ("pull-down", Bias::PullDown), ("disabled", Bias::Disabled)];
/// Values of `drive`.
pub(crate) const DRIVES: [(&str, Drive); 3] =
    [("push-pull", Drive::PushPull), ("open-drain", Drive::OpenDrain), ("open-source", Drive::OpenSource)];

/// Reads a line given by name or bit.
pub(crate) fn line<'a>(
    section: &mut TomlSection<'a>,
    source: &mut FileWithFindings<'_>,
    key: &'static str,
) -> Option<LocatedValue<CardLineName<'a>>> {
    section.value(source, key, "the name of a line of the card's profile, or its bit from 0 to 63", |v| {
        let bit = || u8::try_from(v.as_integer()?).ok().filter(|b| *b < 64);
        v.as_str().map(CardLineName::Name).or_else(|| bit().map(CardLineName::Bit))
    })
}

/// Reads a GPIO line given by name, number or a table.
/// Keys that the table omits are taken from `card`.
pub(crate) fn gpio_line(
    section: &mut TomlSection<'_>,
    source: &mut FileWithFindings<'_>,
    key: &'static str,
    card: &GpioLineSettings,
) -> Option<LocatedValue<GpioLineSettings>> {
    let expected = "the name of a line or its number, or { line = …, chip = \"gpiochip0\", active_low = true, \
                    bias = \"pull-up\" | \"pull-down\" | \"disabled\", drive = \"push-pull\" | \"open-drain\" | \
                    \"open-source\" }";
    let line_of = |value: TomlKeyValue<'_>| match value.as_str() {
        Some(name) => Some(GpioLineId::Name(name.to_owned())).filter(|_| !name.trim().is_empty()),
        None => u32::try_from(value.as_integer()?).ok().map(GpioLineId::Offset),
    };
    section.value(source, key, expected, |value| {
        let mut line = card.clone();
        let Some(table) = value.as_table() else {
            line.line = line_of(value)?;
            return Some(line);
        };
        line.line = line_of(table.get("line")?)?;
        for entry in table.entries() {
            match entry.key() {
                "line" => {}
                "chip" => line.chip = Some(entry.as_str()?.to_owned()),
                "active_low" => line.active_low = entry.as_bool()?,
                "bias" => line.bias = Some(word(entry, &BIASES)?),
                "drive" => line.drive = Some(word(entry, &DRIVES)?),
                _ => return None,
            }
        }
        Some(line)
    })
}

fn word<T: Copy>(entry: TomlKeyValue<'_>, words: &[(&str, T)]) -> Option<T> {
    let found = entry.as_str()?;
    words.iter().find(|(name, _)| *name == found).map(|(_, value)| *value)
}
