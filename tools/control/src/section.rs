//! Strict reading of a TOML table: each key is asked for once, what nobody asked for is a finding.

use rtec_driver::gpio::{Bias, Drive, GpioLine, LineId};
use rtec_driver::input::InputError;
use std::fmt::Display;
use std::ops::{Range, RangeInclusive};
use std::path::Path;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// A TOML file being read, and what was found wrong so far.
pub(crate) struct Source<'a> {
    pub file: &'a Path,
    pub text: &'a str,
    pub findings: Vec<InputError>,
}

impl Source<'_> {
    /// Adds a finding at a byte offset.
    pub(crate) fn finding(&mut self, offset: usize, found: impl Into<String>, expected: impl Into<String>) {
        self.findings.push(InputError::at_offset(self.file, self.text, offset, found, expected));
    }
}

/// A value and where it stands.
#[derive(Debug, Clone, Copy)]
pub(crate) struct At<T> {
    pub value: T,
    pub offset: usize,
}

/// One table.
pub(crate) struct Section<'a> {
    /// As a person writes it: `[card]`.
    pub title: &'static str,
    /// Where it begins.
    pub offset: usize,
    table: Option<&'a DeTable<'a>>,
    asked: Vec<&'static str>,
}

impl<'a> Section<'a> {
    /// The file's outermost table.
    pub(crate) fn root(table: &'a DeTable<'a>) -> Self {
        Self { title: "the file", offset: 0, table: Some(table), asked: Vec::new() }
    }

    /// A table that the file does not have: every key in it is missing.
    fn absent(title: &'static str, offset: usize) -> Self {
        Self { title, offset, table: None, asked: Vec::new() }
    }

    fn take(&mut self, key: &'static str) -> Option<&'a Spanned<DeValue<'a>>> {
        self.asked.push(key);
        self.table?.get(key)
    }

    /// Is the key there? Counts as asked for.
    pub(crate) fn has(&mut self, key: &'static str) -> bool {
        self.take(key).is_some()
    }

    /// The table under a key, or an absent one.
    pub(crate) fn table(&mut self, source: &mut Source<'_>, key: &'static str, title: &'static str) -> Self {
        let Some(value) = self.take(key) else { return Self::absent(title, self.offset) };
        let offset = value.span().start;
        let table = value.get_ref().as_table();
        if table.is_none() {
            source.finding(
                offset,
                shown(source.text, key, &value.span()),
                format!("a table, written {title}"),
            );
        }
        Self { title, offset, table, asked: Vec::new() }
    }

    /// The tables of an array of tables.
    pub(crate) fn tables(
        &mut self,
        source: &mut Source<'_>,
        key: &'static str,
        title: &'static str,
    ) -> Vec<Self> {
        let Some(value) = self.take(key) else { return Vec::new() };
        let offset = value.span().start;
        let Some(array) = value.get_ref().as_array() else {
            source.finding(offset, format!("[{key}]"), format!("{title}, one per {key}"));
            return Vec::new();
        };
        let mut tables = Vec::new();
        for item in array {
            match item.get_ref().as_table() {
                Some(table) => tables.push(Self {
                    title,
                    offset: item.span().start,
                    table: Some(table),
                    asked: Vec::new(),
                }),
                None => source.finding(item.span().start, key, format!("a table, written {title}")),
            }
        }
        tables
    }

    /// The value of a key, if it is there and as `parse` wants it.
    fn value<T>(
        &mut self,
        source: &mut Source<'_>,
        key: &'static str,
        expected: impl Display,
        parse: impl FnOnce(&'a DeValue<'a>) -> Option<T>,
    ) -> Option<At<T>> {
        let value = self.take(key)?;
        let offset = value.span().start;
        let parsed = parse(value.get_ref());
        if parsed.is_none() {
            source.finding(offset, shown(source.text, key, &value.span()), format!("{key} = {expected}"));
        }
        parsed.map(|value| At { value, offset })
    }

    /// A text.
    pub(crate) fn string(
        &mut self,
        source: &mut Source<'_>,
        key: &'static str,
        expected: &str,
    ) -> Option<At<&'a str>> {
        self.value(source, key, expected, |v| v.as_str().filter(|s| !s.trim().is_empty()))
    }

    /// One of several words; the first `offered` of them are those a person is told of.
    pub(crate) fn choice<T: Copy>(
        &mut self,
        source: &mut Source<'_>,
        key: &'static str,
        offered: usize,
        choices: &[(&str, T)],
    ) -> Option<At<T>> {
        let names: Vec<&str> = choices.iter().map(|(name, _)| *name).take(offered).collect();
        let mut expected = names.iter().map(|name| format!("\"{name}\"")).collect::<Vec<_>>().join(" or ");
        if let Some(word) = self.table.and_then(|t| t.get(key)).and_then(|v| v.get_ref().as_str())
            && let Some(near) = nearest(word, &names)
        {
            expected = format!("{expected}; did you mean \"{near}\"?");
        }
        self.value(source, key, expected, |v| {
            choices.iter().find(|(name, _)| v.as_str() == Some(name)).map(|(_, choice)| *choice)
        })
    }

    /// A whole number within bounds.
    pub(crate) fn integer(
        &mut self,
        source: &mut Source<'_>,
        key: &'static str,
        range: RangeInclusive<i64>,
    ) -> Option<At<i64>> {
        let expected = format!("a whole number from {} to {}", range.start(), range.end());
        self.value(source, key, expected, |v| {
            let number = v.as_integer()?;
            i64::from_str_radix(number.as_str(), number.radix()).ok().filter(|n| range.contains(n))
        })
    }

    /// A finite number above `low` and up to `high`.
    pub(crate) fn positive(
        &mut self,
        source: &mut Source<'_>,
        key: &'static str,
        high: f64,
    ) -> Option<At<f64>> {
        self.value(source, key, format!("a number above 0, up to {high}"), |v| {
            number(v).filter(|n| *n > 0.0 && *n <= high)
        })
    }

    /// A finite number within ±`limit`.
    pub(crate) fn signed(
        &mut self,
        source: &mut Source<'_>,
        key: &'static str,
        limit: f64,
    ) -> Option<At<f64>> {
        self.value(source, key, format!("a number from -{limit} to {limit}"), |v| {
            number(v).filter(|n| n.abs() <= limit)
        })
    }

    /// A line: its name, or its bit.
    pub(crate) fn line(&mut self, source: &mut Source<'_>, key: &'static str) -> Option<At<LineName<'a>>> {
        self.value(source, key, "the name of a line of the card's profile, or its bit from 0 to 63", |v| {
            match v {
                DeValue::String(name) => Some(LineName::Name(name)),
                DeValue::Integer(n) => {
                    u8::from_str_radix(n.as_str(), n.radix()).ok().filter(|b| *b < 64).map(LineName::Bit)
                }
                _ => None,
            }
        })
    }

    /// A GPIO line: its name, its number, or a table that says more. What the table leaves out is in `card`.
    pub(crate) fn gpio_line(
        &mut self,
        source: &mut Source<'_>,
        key: &'static str,
        card: &GpioLine,
    ) -> Option<At<GpioLine>> {
        let expected = "the name of a line or its number, or { line = …, chip = \"gpiochip0\", active_low = true, \
                        bias = \"pull-up\" | \"pull-down\" | \"disabled\", drive = \"push-pull\" | \"open-drain\" | \
                        \"open-source\" }";
        let line_of = |value: &DeValue<'_>| match value {
            DeValue::String(name) if !name.trim().is_empty() => Some(LineId::Name(name.to_string())),
            DeValue::Integer(n) => u32::from_str_radix(n.as_str(), n.radix()).ok().map(LineId::Offset),
            _ => None,
        };
        self.value(source, key, expected, |value| {
            let mut line = card.clone();
            let DeValue::Table(table) = value else {
                line.line = line_of(value)?;
                return Some(line);
            };
            line.line = line_of(table.get("line")?.get_ref())?;
            for (key, value) in table {
                let value = value.get_ref();
                match key.get_ref().as_ref() {
                    "line" => {}
                    "chip" => line.chip = Some(value.as_str()?.to_owned()),
                    "active_low" => line.active_low = value.as_bool()?,
                    "bias" => line.bias = Some(word(value.as_str()?, &BIASES)?),
                    "drive" => line.drive = Some(word(value.as_str()?, &DRIVES)?),
                    _ => return None,
                }
            }
            Some(line)
        })
    }

    /// Says that a key must be there.
    pub(crate) fn missing(&self, source: &mut Source<'_>, key: &str, meaning: &str) {
        let found = format!("no {key} in {}", self.title);
        source.finding(self.offset, found, format!("{key}: {meaning}"));
    }

    /// A key that must be there: reports it where it is missing.
    pub(crate) fn required<T>(
        &self,
        source: &mut Source<'_>,
        key: &str,
        meaning: &str,
        value: Option<T>,
    ) -> Option<T> {
        if value.is_none() && !self.table.is_some_and(|t| t.contains_key(key)) {
            self.missing(source, key, meaning);
        }
        value
    }

    /// Reports every key that nobody asked for.
    pub(crate) fn finish(self, source: &mut Source<'_>) {
        for (key, _) in self.table.into_iter().flatten() {
            let name: &str = key.get_ref();
            if self.asked.contains(&name) {
                continue;
            }
            let expected = match nearest(name, &self.asked) {
                Some(near) => format!("a key of {}; did you mean {near}?", self.title),
                None => format!("a key of {}: {}", self.title, self.asked.join(", ")),
            };
            source.finding(key.span().start, format!("unknown key {name}"), expected);
        }
    }
}

/// How a configuration names a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum LineName<'a> {
    /// A line of the card's profile.
    Name(&'a str),
    /// A bit of the card's input or output word.
    Bit(u8),
}

/// What `bias` can be.
pub(crate) const BIASES: [(&str, Bias); 3] =
    [("pull-up", Bias::PullUp), ("pull-down", Bias::PullDown), ("disabled", Bias::Disabled)];
/// What `drive` can be.
pub(crate) const DRIVES: [(&str, Drive); 3] =
    [("push-pull", Drive::PushPull), ("open-drain", Drive::OpenDrain), ("open-source", Drive::OpenSource)];

fn word<T: Copy>(found: &str, words: &[(&str, T)]) -> Option<T> {
    words.iter().find(|(name, _)| *name == found).map(|(_, value)| *value)
}

fn number(value: &DeValue<'_>) -> Option<f64> {
    let text = match value {
        DeValue::Integer(n) if n.radix() == 10 => n.as_str(),
        DeValue::Float(n) => n.as_str(),
        _ => return None,
    };
    text.parse().ok().filter(|n: &f64| n.is_finite())
}

/// `key = value` as it stands in the file, cut where it is long.
fn shown(text: &str, key: &str, span: &Range<usize>) -> String {
    let value = text.get(span.clone()).unwrap_or_default().lines().next().unwrap_or_default();
    let short: String = value.chars().take(60).collect();
    let dots = if short.len() < value.len() { "…" } else { "" };
    format!("{key} = {short}{dots}")
}

/// The word that was probably meant.
#[must_use]
pub fn nearest<'w>(word: &str, words: &[&'w str]) -> Option<&'w str> {
    let scored = words.iter().map(|w| (strsim::damerau_levenshtein(word, w), *w));
    let (distance, near) = scored.min_by_key(|(d, _)| *d)?;
    let length = word.chars().count();
    (distance < length && distance <= 1 + length / 4).then_some(near)
}
