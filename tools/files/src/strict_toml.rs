//! Reads TOML strictly.
//! Unknown keys are findings, every finding has its line and column.
//!
//! [`Table`] and [`TomlKeyValue`] end at the first finding. [`crate::toml_section_keys::TomlSection`] reads on and collects every
//! finding of a file. Both give the same message for the same mistake.

use crate::input_error::InputError;
use crate::message_text::{cut, nearest};
use serde::de::DeserializeOwned;
use std::fmt::{self, Display};
use std::path::Path;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// A parsed TOML file that knows the place of each value.
#[derive(Debug)]
pub struct Document<'t> {
    file: &'t Path,
    text: &'t str,
    root: Spanned<DeTable<'t>>,
}

impl<'t> Document<'t> {
    /// Parses a text; `file` is its name in findings.
    ///
    /// # Errors
    /// The first syntax error.
    pub fn parse(file: &'t Path, text: &'t str) -> Result<Self, InputError> {
        let (document, findings) = Self::parse_all(file, text);
        findings.into_iter().next().map_or(Ok(document), Err)
    }

    /// As [`Document::parse`], with every syntax error.
    /// The document holds the parts that could be parsed.
    pub fn parse_all(file: &'t Path, text: &'t str) -> (Self, Vec<InputError>) {
        let (root, errors) = DeTable::parse_recoverable(text);
        let findings = errors.iter().map(|error| finding(file, text, error, "TOML")).collect();
        (Self { file, text, root }, findings)
    }

    /// The file's outermost table.
    pub fn root(&self) -> Table<'_> {
        Table { file: self.file, text: self.text, of: self.root.get_ref(), title: TableTitle::File, start: 0 }
    }
}

/// Reads a text into a type that declares its keys.
/// `expected` names the kind of file for messages.
///
/// # Errors
/// The first finding.
pub fn from_str<T: DeserializeOwned>(file: &Path, text: &str, expected: &str) -> Result<T, InputError> {
    toml::from_str(text).map_err(|error| finding(file, text, &error, expected))
}

/// Turns the parser's error into a finding.
fn finding(file: &Path, text: &str, error: &toml::de::Error, expected: &str) -> InputError {
    let start = error.span().map_or(0, |s| s.start);
    let message = error.message().trim().lines().collect::<Vec<_>>().join(", ");
    let (found, expected) = message.split_once(", expected ").unwrap_or((&message, expected));
    let line = &text[text[..start].rfind('\n').map_or(0, |at| at + 1)..];
    let line = line.lines().next().unwrap_or_default();
    if let Some((found, expected)) = mistaken(line) {
        return InputError::at_offset(file, text, start, found, expected);
    }
    let Some(key) = found.strip_prefix("unknown field ").map(|key| key.trim_matches('`')) else {
        return InputError::at_offset(file, text, start, found, expected);
    };
    let known: Vec<&str> = expected.split('`').skip(1).step_by(2).collect();
    let (found, expected) = unknown(key, &TableTitle::Here, &known);
    InputError::at_offset(file, text, start, found, expected)
}

/// Recognises what other programs write and TOML does not allow.
/// Returns found and expected.
fn mistaken(line: &str) -> Option<(String, String)> {
    const CURLY: [char; 6] = ['\u{201c}', '\u{201d}', '\u{201e}', '\u{2018}', '\u{2019}', '\u{ab}'];
    let value = line.split_once('=').map_or(line, |(_, value)| value).trim();
    if let Some(mark) = value.chars().find(|c| CURLY.contains(c)) {
        return Some((format!("the quotation mark {mark}"), "the straight one, \", at both ends".to_owned()));
    }
    let end = value.find(|c: char| !(c.is_ascii_digit() || "+-.,_".contains(c)))?;
    let (number, unit) = (value[..end].trim_end_matches(['.', ',']), value[end..].trim());
    let is_unit = !unit.is_empty() && unit.chars().all(|c| c.is_alphabetic() || "/²°%".contains(c));
    (number.contains(|c: char| c.is_ascii_digit()) && is_unit && !matches!(unit, "e" | "E" | "x" | "o" | "b"))
        .then(|| {
            (
                format!("{value}: a number and {unit}"),
                format!("the number alone, {}: its key names the unit", number.replace(',', ".")),
            )
        })
}

/// The message for an unknown key: found, expected.
fn unknown(key: &str, title: &impl Display, known: &[&str]) -> (String, String) {
    let expected = match nearest(key, known) {
        Some(near) => format!("a key of {title}; did you mean {near}?"),
        None => format!("a key of {title}: {}", known.join(", ")),
    };
    (format!("unknown key {key}"), expected)
}

/// The name of a table for messages.
#[derive(Debug, Clone, Copy)]
enum TableTitle<'d> {
    File,
    Here,
    Table(&'d str),
    Tables(&'d str),
}

impl Display for TableTitle<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File => f.write_str("the file"),
            Self::Here => f.write_str("this table"),
            Self::Table(key) => write!(f, "[{key}]"),
            Self::Tables(key) => write!(f, "[[{key}]]"),
        }
    }
}

/// A table and its place.
#[derive(Debug, Clone, Copy)]
pub struct Table<'d> {
    file: &'d Path,
    text: &'d str,
    of: &'d DeTable<'d>,
    title: TableTitle<'d>,
    pub(crate) start: usize,
}

impl<'d> Table<'d> {
    /// Refuses every key that is not among `known`.
    ///
    /// # Errors
    /// The first unknown key, with the most similar known one, if any.
    pub fn only(&self, known: &[&str]) -> Result<(), InputError> {
        match self.entries().find(|entry| !known.contains(&entry.key)) {
            Some(entry) => Err(entry.unknown(&self.title, known)),
            None => Ok(()),
        }
    }

    /// The entry of a key.
    pub fn get(&self, key: &str) -> Option<TomlKeyValue<'d>> {
        let (key, value) = self.of.get_key_value(key)?;
        Some(self.entry(key, value))
    }

    /// The entry of a required key.
    ///
    /// # Errors
    /// It is missing.
    pub fn required(&self, key: &str, expected: &str) -> Result<TomlKeyValue<'d>, InputError> {
        self.get(key).ok_or_else(|| self.error(format!("no {key} in {}", self.title), expected))
    }

    /// All entries, in the file's order.
    pub fn entries(&self) -> impl Iterator<Item = TomlKeyValue<'d>> + use<'d> {
        let table = *self;
        self.of.iter().map(move |(key, value)| table.entry(key, value))
    }

    fn entry(
        &self,
        key: &'d Spanned<toml::de::DeString<'d>>,
        value: &'d Spanned<DeValue<'d>>,
    ) -> TomlKeyValue<'d> {
        let (file, text) = (self.file, self.text);
        TomlKeyValue { file, text, key: key.get_ref(), key_start: key.span().start, value }
    }

    /// A finding about this table.
    pub fn error(&self, found: impl Into<String>, expected: impl Into<String>) -> InputError {
        InputError::at_offset(self.file, self.text, self.start, found, expected)
    }
}

/// A key with its value.
#[derive(Debug, Clone, Copy)]
pub struct TomlKeyValue<'d> {
    file: &'d Path,
    text: &'d str,
    key: &'d str,
    key_start: usize,
    value: &'d Spanned<DeValue<'d>>,
}

impl<'d> TomlKeyValue<'d> {
    /// The key, as the file has it.
    pub fn key(&self) -> &'d str {
        self.key
    }

    /// The value as the file has it; text without its quotes.
    pub fn text(&self) -> String {
        self.as_str().unwrap_or_else(|| self.written()).to_owned()
    }

    fn written(&self) -> &'d str {
        self.text.get(self.value.span()).unwrap_or_default().trim()
    }

    /// The byte of the text at which the value begins.
    pub fn offset(&self) -> usize {
        self.value.span().start
    }

    /// A finding about the value.
    pub fn error(&self, found: impl Into<String>, expected: impl Into<String>) -> InputError {
        InputError::at_offset(self.file, self.text, self.offset(), found, expected)
    }

    /// A finding about the key.
    pub fn key_error(&self, found: impl Into<String>, expected: impl Into<String>) -> InputError {
        InputError::at_offset(self.file, self.text, self.key_start, found, expected)
    }

    /// The finding that the key is unknown here.
    pub fn unknown_key(&self, expected: &str) -> InputError {
        self.key_error(format!("unknown key {}", self.key), expected)
    }

    pub(crate) fn unknown(&self, title: &impl Display, known: &[&str]) -> InputError {
        let (found, expected) = unknown(self.key, title, known);
        self.key_error(found, expected)
    }

    /// The finding that the value is not what was expected.
    pub fn mismatch(&self, expected: impl Into<String>) -> InputError {
        let first_line = self.written().lines().next().unwrap_or_default();
        self.error(format!("{} = {}", self.key, cut(first_line)), expected)
    }

    /// The value, if it is text.
    pub fn as_str(&self) -> Option<&'d str> {
        self.value.get_ref().as_str()
    }

    /// The value, if it is a truth value.
    pub fn as_bool(&self) -> Option<bool> {
        self.value.get_ref().as_bool()
    }

    /// The value, if it is a whole number of 64 bits.
    pub fn as_integer(&self) -> Option<i64> {
        let number = self.value.get_ref().as_integer()?;
        i64::from_str_radix(number.as_str(), number.radix()).ok()
    }

    /// The value, if it is a finite number or a whole number.
    pub fn as_number(&self) -> Option<f64> {
        number(self.value.get_ref())
    }

    /// The value, if it is a table.
    pub fn as_table(&self) -> Option<Table<'d>> {
        let of = self.value.get_ref().as_table()?;
        Some(Table {
            file: self.file,
            text: self.text,
            of,
            title: TableTitle::Table(self.key),
            start: self.offset(),
        })
    }

    /// The value as text.
    ///
    /// # Errors
    /// It is something else.
    pub fn str(&self, expected: &str) -> Result<&'d str, InputError> {
        self.as_str().ok_or_else(|| self.mismatch(expected))
    }

    /// The value as a truth value.
    ///
    /// # Errors
    /// It is something else.
    pub fn bool(&self, expected: &str) -> Result<bool, InputError> {
        self.as_bool().ok_or_else(|| self.mismatch(expected))
    }

    /// The value as a whole number within the range of `T`.
    ///
    /// # Errors
    /// It is something else, or out of range.
    pub fn integer<T: TryFrom<i64>>(&self, expected: &str) -> Result<T, InputError> {
        self.as_integer().and_then(|n| n.try_into().ok()).ok_or_else(|| self.mismatch(expected))
    }

    /// The value as a finite number; a whole number is accepted.
    ///
    /// # Errors
    /// It is something else, infinite or not a number.
    pub fn number(&self, expected: &str) -> Result<f64, InputError> {
        self.as_number().ok_or_else(|| self.mismatch(expected))
    }

    /// The value as a number from `low` to `high`.
    /// `expected` names the quantity and its unit.
    ///
    /// # Errors
    /// It is something else, or outside.
    pub fn within(&self, [low, high]: [f64; 2], expected: &str) -> Result<f64, InputError> {
        let v = self.number(expected)?;
        if (low..=high).contains(&v) {
            return Ok(v);
        }
        Err(self.error(
            format!("{} = {}", self.key(), crate::text_file::short(v)),
            format!("{expected}, from {low} to {high}"),
        ))
    }

    /// The value as a finite number above zero.
    ///
    /// # Errors
    /// It is something else.
    pub fn positive(&self, expected: &str) -> Result<f64, InputError> {
        self.as_number().filter(|v| *v > 0.0).ok_or_else(|| self.mismatch(expected))
    }

    /// The value as an array of finite numbers.
    ///
    /// # Errors
    /// It is something else.
    pub fn numbers(&self, expected: &str) -> Result<Vec<f64>, InputError> {
        numbers(self.value.get_ref()).ok_or_else(|| self.mismatch(expected))
    }

    /// The value as an array of text.
    ///
    /// # Errors
    /// It is something else.
    pub fn strings(&self, expected: &str) -> Result<Vec<&'d str>, InputError> {
        let array = self.value.get_ref().as_array();
        let all = array.and_then(|a| a.iter().map(|v| v.get_ref().as_str()).collect());
        all.ok_or_else(|| self.mismatch(expected))
    }

    /// The value as a pair of finite numbers, the first not above the second.
    ///
    /// # Errors
    /// It is something else.
    pub fn pair(&self, expected: &str) -> Result<[f64; 2], InputError> {
        pair(self.value.get_ref()).ok_or_else(|| self.mismatch(expected))
    }

    /// The value as pairs of finite numbers: one pair, or an array of pairs.
    ///
    /// # Errors
    /// It is something else, or the first number of a pair is the larger one.
    pub fn pairs(&self, expected: &str) -> Result<Vec<[f64; 2]>, InputError> {
        let array = self.value.get_ref().as_array().ok_or_else(|| self.mismatch(expected))?;
        if array.iter().all(|v| v.get_ref().is_array()) {
            let pairs: Option<Vec<_>> = array.iter().map(|v| pair(v.get_ref())).collect();
            return pairs.ok_or_else(|| self.mismatch(expected));
        }
        Ok(vec![self.pair(expected)?])
    }

    /// The value as a table, `[header]` or inline.
    ///
    /// # Errors
    /// It is something else.
    pub fn table(&self, expected: &str) -> Result<Table<'d>, InputError> {
        self.as_table().ok_or_else(|| self.mismatch(expected))
    }

    /// The value as a list of tables: `[[header]]` or an array of inline tables.
    /// An empty array is accepted.
    ///
    /// # Errors
    /// It is something else.
    pub fn tables(&self, expected: &str) -> Result<Vec<Table<'d>>, InputError> {
        let array = self.value.get_ref().as_array().ok_or_else(|| self.mismatch(expected))?;
        let of = |v: &'d Spanned<DeValue<'d>>| {
            let (file, text, title) = (self.file, self.text, TableTitle::Tables(self.key));
            let table =
                v.get_ref().as_table().map(|of| Table { file, text, of, title, start: v.span().start });
            table.ok_or_else(|| InputError::at_offset(file, text, v.span().start, self.key, expected))
        };
        array.iter().map(of).collect()
    }
}

fn number(value: &DeValue<'_>) -> Option<f64> {
    let text = match value {
        DeValue::Integer(n) if n.radix() == 10 => n.as_str(),
        DeValue::Float(n) => n.as_str(),
        _ => return None,
    };
    text.parse().ok().filter(|n: &f64| n.is_finite())
}

fn numbers(value: &DeValue<'_>) -> Option<Vec<f64>> {
    value.as_array()?.iter().map(|v| number(v.get_ref())).collect()
}

fn pair(value: &DeValue<'_>) -> Option<[f64; 2]> {
    match numbers(value)?[..] {
        [lo, hi] if lo <= hi => Some([lo, hi]),
        _ => None,
    }
}
