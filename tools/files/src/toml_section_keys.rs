//! One table of keys per section of a TOML file.
//! The table reads and checks the section, and documents it on the reference page. A [`TomlSection`] takes each
//! key once and collects every finding of its file.

use crate::input_error::InputError;
use crate::message_text::{nearest, unseen};
use crate::strict_toml::{Document, Table, TomlKeyValue};
use std::fmt::{self, Display, Write as _};
use std::path::Path;
use std::str::FromStr;

/// One key: how it is read, checked and described.
#[derive(Debug, Clone, Copy)]
pub struct TomlKeySpec {
    /// The key's name, with its unit.
    pub name: &'static str,
    /// The values that it takes.
    pub takes: AcceptedKeyValue,
    /// The unit of its value; empty if it has none.
    pub unit: &'static str,
    /// The default; [`REQUIRED`] if the key is required.
    pub default: &'static str,
    /// Its meaning, in a phrase.
    pub meaning: &'static str,
}

/// Declares the table of a section's keys.
/// Each key is `name: takes, unit, default, meaning;`.
#[macro_export]
macro_rules! keys {
    ($(#[$doc:meta])* $visible:vis $table:ident:
     $($name:ident: $takes:expr, $unit:expr, $default:expr, $meaning:expr;)*) => {
        $(#[$doc])*
        $visible const $table: &[$crate::toml_section_keys::TomlKeySpec] = &[$($crate::toml_section_keys::TomlKeySpec {
            name: stringify!($name),
            takes: $takes,
            unit: $unit,
            default: $default,
            meaning: $meaning,
        }),*];
    };
}

/// The default of a required key.
pub const REQUIRED: &str = "required";

/// The values that a key takes.
#[derive(Debug, Clone, Copy)]
pub enum AcceptedKeyValue {
    /// Text that is not empty.
    Text,
    /// One line of text that can be shown, at most 256 bytes.
    Line,
    /// A name that can be shown and typed, at most 64 characters.
    Name,
    /// A [`AcceptedKeyValue::Name`] without blanks.
    Word,
    /// `true` or `false`.
    Flag,
    /// A whole number from the first bound to the second.
    Whole(i64, i64),
    /// A number from the first bound to the second.
    Number(f64, f64),
    /// Two numbers within ± this, the lower first.
    Range(f64),
    /// One of these words.
    Choice(&'static [&'static str]),
    /// A value that other code reads, described in words.
    Own(&'static str),
}

impl Display for AcceptedKeyValue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Text | Self::Line => f.write_str("text"),
            Self::Name => f.write_str("a name"),
            Self::Word => f.write_str("one word"),
            Self::Flag => f.write_str("`true`, `false`"),
            Self::Whole(low, high) => write!(f, "{low} to {high}"),
            Self::Number(low, high) => write!(f, "{low} to {high}"),
            Self::Range(limit) => write!(f, "`[lowest, highest]` within ±{limit:e}"),
            Self::Choice(words) => {
                let words: Vec<_> = words.iter().map(|word| format!("`{word}`")).collect();
                f.write_str(&words.join(", "))
            }
            Self::Own(words) => f.write_str(words),
        }
    }
}

impl TomlKeySpec {
    /// Its meaning, as a terminal shows it.
    fn in_words(&self) -> String {
        self.meaning.replace('`', "")
    }
}

/// The reference page's table of a section.
pub fn markdown(title: &str, keys: &[TomlKeySpec]) -> String {
    let mut page = format!("| `{title}` | takes | default | meaning |\n|---|---|---|---|\n");
    for TomlKeySpec { name, takes, unit, default, meaning } in keys {
        let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
        // Writing to a String does not fail.
        let _ = writeln!(page, "| `{name}` | {takes}{unit} | {default} | {meaning} |");
    }
    page
}

/// The words to choose from, in quotes.
fn quoted(words: &[&str]) -> String {
    words.iter().map(|word| format!("\"{word}\"")).collect::<Vec<_>>().join(" or ")
}

/// A file with a list of all its findings.
#[derive(Debug)]
pub struct FileWithFindings<'a> {
    /// The file, as the user named it.
    pub file: &'a Path,
    /// The file's whole text, from which findings take their line and column.
    pub text: &'a str,
    /// The findings so far.
    pub findings: Vec<InputError>,
}

impl FileWithFindings<'_> {
    /// Adds a finding at a byte of the text.
    pub fn finding(&mut self, offset: usize, found: impl Into<String>, expected: impl Into<String>) {
        self.findings.push(InputError::at_offset(self.file, self.text, offset, found, expected));
    }

    /// Returns the value, or records its finding.
    pub fn keep<T>(&mut self, value: Result<T, InputError>) -> Option<T> {
        value.map_err(|finding| self.findings.push(finding)).ok()
    }
}

/// A value and its place in the text.
#[derive(Debug, Clone, Copy)]
pub struct LocatedValue<T> {
    /// The value, checked.
    pub value: T,
    /// Where the value begins in the text, bytes from the start.
    pub offset: usize,
}

/// A table whose keys are each taken once; keys that are left are findings.
#[derive(Debug)]
pub struct TomlSection<'a> {
    /// The section's title as a person writes it: `[card]`.
    pub title: &'static str,
    /// Where the section begins in the text, bytes from the start.
    pub offset: usize,
    table: Option<Table<'a>>,
    asked: Vec<&'static str>,
    keys: &'static [TomlKeySpec],
}

impl<'a> TomlSection<'a> {
    /// The file's outermost table.
    pub fn root(document: &'a Document<'_>) -> Self {
        Self::of("the file", 0, Some(document.root()))
    }

    /// A table, or an absent one, which has no key.
    fn of(title: &'static str, offset: usize, table: Option<Table<'a>>) -> Self {
        Self { title, offset, table, asked: Vec::new(), keys: &[] }
    }

    /// Adds the table of the section's keys.
    #[must_use]
    pub fn with(self, keys: &'static [TomlKeySpec]) -> Self {
        Self { keys, ..self }
    }

    fn take(&mut self, key: &'static str) -> Option<TomlKeyValue<'a>> {
        if !self.asked.contains(&key) {
            self.asked.push(key);
        }
        self.table?.get(key)
    }

    /// Whether a key exists that no message suggests. If it does, it counts as taken.
    pub fn has_unoffered(&mut self, key: &'static str) -> bool {
        self.table.is_some_and(|t| t.get(key).is_some()) && self.has(key)
    }

    /// Whether the key exists. It counts as taken.
    pub fn has(&mut self, key: &'static str) -> bool {
        self.take(key).is_some()
    }

    /// The table under a key, or an absent one.
    #[must_use]
    pub fn table(
        &mut self,
        source: &mut FileWithFindings<'_>,
        key: &'static str,
        title: &'static str,
    ) -> Self {
        let Some(entry) = self.take(key) else { return Self::of(title, self.offset, None) };
        let table = source.keep(entry.table(&format!("a table, written {title}")));
        Self::of(title, entry.offset(), table)
    }

    /// The tables of an array of tables.
    pub fn tables(
        &mut self,
        source: &mut FileWithFindings<'_>,
        key: &'static str,
        title: &'static str,
    ) -> Vec<Self> {
        let Some(entry) = self.take(key) else { return Vec::new() };
        let tables = source.keep(entry.tables(&format!("{title}, one per {key}"))).unwrap_or_default();
        tables.into_iter().map(|table| Self::of(title, table.start, Some(table))).collect()
    }

    /// The value of a key, if it exists and `parse` accepts it.
    pub fn value<T>(
        &mut self,
        source: &mut FileWithFindings<'_>,
        key: &'static str,
        expected: impl Display,
        parse: impl FnOnce(TomlKeyValue<'a>) -> Option<T>,
    ) -> Option<LocatedValue<T>> {
        let entry = self.take(key)?;
        let parsed = parse(entry).ok_or_else(|| entry.mismatch(format!("{key} = {expected}")));
        source.keep(parsed).map(|value| LocatedValue { value, offset: entry.offset() })
    }

    /// One of several words. Messages show only the first `offered` of them.
    pub fn choice<T: Copy>(
        &mut self,
        source: &mut FileWithFindings<'_>,
        key: &'static str,
        offered: usize,
        choices: &[(&str, T)],
    ) -> Option<LocatedValue<T>> {
        let names: Vec<&str> = choices.iter().map(|(name, _)| *name).take(offered).collect();
        let mut expected = quoted(&names);
        if let Some(word) = self.table.and_then(|t| t.get(key)?.as_str())
            && let Some(near) = nearest(word, &names)
        {
            expected = format!("{expected}; did you mean \"{near}\"?");
        }
        self.value(source, key, expected, |v| {
            choices.iter().find(|(name, _)| v.as_str() == Some(name)).map(|(_, choice)| *choice)
        })
    }

    /// Reports that a key is missing, with its meaning.
    pub fn say_missing(&self, source: &mut FileWithFindings<'_>, key: &str, meaning: &str) {
        let found = format!("no {key} in {}", self.title);
        source.finding(self.offset, found, format!("{key}: {meaning}"));
    }

    fn lacks(&self, key: &str) -> bool {
        self.table.is_none_or(|t| t.get(key).is_none())
    }

    /// Reports every key that was not taken.
    pub fn finish(self, source: &mut FileWithFindings<'_>) {
        for entry in self.table.iter().flat_map(Table::entries) {
            if !self.asked.contains(&entry.key()) {
                source.findings.push(entry.unknown(&self.title, &self.asked));
            }
        }
    }

    fn declared(&self, name: &str) -> TomlKeySpec {
        match self.keys.iter().find(|key| key.name == name) {
            Some(key) => *key,
            None => unreachable!("{name} is not in the table of keys of {}", self.title),
        }
    }

    /// Reports that a declared key is missing.
    pub fn missing(&self, source: &mut FileWithFindings<'_>, name: &str) {
        let key = self.declared(name);
        let mut meaning = key.in_words();
        if let AcceptedKeyValue::Choice(words) = key.takes {
            meaning = format!("{meaning}: {}", quoted(words));
        } else if !key.unit.is_empty() {
            meaning = format!("{meaning}, {}", key.unit);
        }
        self.say_missing(source, name, &meaning);
    }

    /// The value of a required key; reports it if it is missing.
    pub fn required<T>(&self, source: &mut FileWithFindings<'_>, name: &str, value: Option<T>) -> Option<T> {
        if value.is_none() && self.lacks(name) {
            self.missing(source, name);
        }
        value
    }

    fn checked<T>(
        &self,
        source: &mut FileWithFindings<'_>,
        key: &TomlKeySpec,
        value: Option<T>,
    ) -> Option<T> {
        if key.default == REQUIRED { self.required(source, key.name, value) } else { value }
    }

    /// The text of a declared key.
    pub fn text(
        &mut self,
        source: &mut FileWithFindings<'_>,
        name: &'static str,
    ) -> Option<LocatedValue<&'a str>> {
        let key = self.declared(name);
        let expected = format!("text in quotes: {}", key.in_words());
        let at = self.value(source, name, expected, |v| v.as_str().filter(|s| !s.trim().is_empty()));
        let at = self.checked(source, &key, at)?;
        let bad = match key.takes {
            AcceptedKeyValue::Name => bad_name(name, at.value, false),
            AcceptedKeyValue::Word => bad_name(name, at.value, true),
            AcceptedKeyValue::Line => bad_line(name, at.value),
            _ => None,
        };
        let Some((found, expected)) = bad else { return Some(at) };
        source.finding(at.offset, found, expected);
        None
    }

    /// The truth value of a declared key; false if it is missing.
    pub fn flag(&mut self, source: &mut FileWithFindings<'_>, name: &'static str) -> bool {
        self.value(source, name, "true or false", |v| v.as_bool()).is_some_and(|at| at.value)
    }

    /// The whole number of a declared key.
    pub fn whole(
        &mut self,
        source: &mut FileWithFindings<'_>,
        name: &'static str,
    ) -> Option<LocatedValue<i64>> {
        let key = self.declared(name);
        let AcceptedKeyValue::Whole(low, high) = key.takes else {
            unreachable!("{name} takes no whole number")
        };
        let mut expected = format!("a whole number from {low} to {high}");
        let hex = |word: &str| i64::from_str_radix(word.strip_prefix("0x")?, 16).ok();
        if let Some(word) = self.table.and_then(|t| t.get(name)?.as_str())
            && word.parse().ok().or_else(|| hex(word)).is_some_and(|n| (low..=high).contains(&n))
        {
            expected = format!("{expected}, without quotes: {name} = {word}");
        }
        let value =
            self.value(source, name, expected, |v| v.as_integer().filter(|n| (low..=high).contains(n)));
        self.checked(source, &key, value)
    }

    /// The number of a declared key.
    pub fn number(
        &mut self,
        source: &mut FileWithFindings<'_>,
        name: &'static str,
    ) -> Option<LocatedValue<f64>> {
        let key = self.declared(name);
        let AcceptedKeyValue::Number(low, high) = key.takes else { unreachable!("{name} takes no number") };
        let value = self.value(source, name, format!("a number from {low} to {high}"), |v| {
            v.as_number().filter(|n| (low..=high).contains(n))
        });
        self.checked(source, &key, value)
    }

    /// The two numbers of a declared key.
    pub fn range(
        &mut self,
        source: &mut FileWithFindings<'_>,
        name: &'static str,
    ) -> Option<LocatedValue<[f64; 2]>> {
        let key = self.declared(name);
        let AcceptedKeyValue::Range(limit) = key.takes else { unreachable!("{name} takes no range") };
        self.value(source, name, format!("[lowest, highest] within ±{limit:e}"), |v| {
            v.pair("").ok().filter(|ends| ends.iter().all(|end| end.abs() <= limit))
        })
    }

    /// The value for the word of a declared key; `values` are in the words' order.
    pub fn pick<T: Copy>(
        &mut self,
        source: &mut FileWithFindings<'_>,
        name: &'static str,
        values: &[T],
    ) -> Option<LocatedValue<T>> {
        let key = self.declared(name);
        let AcceptedKeyValue::Choice(words) = key.takes else {
            unreachable!("{name} takes no word of a list")
        };
        let choices: Vec<_> = words.iter().copied().zip(values.iter().copied()).collect();
        let value = self.choice(source, name, choices.len(), &choices);
        self.checked(source, &key, value)
    }

    /// The declared default of a key, as a number.
    fn default<T: FromStr>(&self, name: &str) -> T {
        match self.declared(name).default.parse() {
            Ok(value) => value,
            Err(_) => unreachable!("the default of {name} is no number"),
        }
    }

    /// The whole number of a declared key, or its default.
    pub fn whole_or_default(&mut self, source: &mut FileWithFindings<'_>, name: &'static str) -> i64 {
        self.whole(source, name).map_or_else(|| self.default(name), |at| at.value)
    }

    /// The number of a declared key, or its default.
    pub fn number_or_default(&mut self, source: &mut FileWithFindings<'_>, name: &'static str) -> f64 {
        self.number(source, name).map_or_else(|| self.default(name), |at| at.value)
    }
}

/// A value as a finding shows it: printable, and cut if long.
fn shown(key: &str, value: &str) -> String {
    let shown: String = value.chars().take(24).flat_map(char::escape_debug).collect();
    let more = if value.chars().nth(24).is_some() { "…" } else { "" };
    format!("{key} = \"{shown}{more}\"")
}

/// The fault of a name, if it has one: found, expected.
fn bad_name(key: &str, name: &str, one_word: bool) -> Option<(String, &'static str)> {
    let found = shown(key, name);
    if let Some(c) = unseen(name) {
        let found = format!("{found} with the character U+{:04X}", u32::from(c));
        return Some((found, "characters that can be seen"));
    }
    let length = name.chars().count();
    if length > 64 {
        return Some((format!("{found} of {length} characters"), "at most 64 characters"));
    }
    if name.starts_with('-') {
        return Some((found, "a name that does not begin as an option does"));
    }
    if one_word && name.contains(char::is_whitespace) {
        return Some((found, "a name without blanks"));
    }
    (name.trim() != name).then_some((found, "no blank at its beginning or end"))
}

fn bad_line(key: &str, text: &str) -> Option<(String, &'static str)> {
    let bad = text.len() > 256 || unseen(text).is_some();
    bad.then(|| (shown(key, text), "at most 256 characters that can be seen"))
}

#[cfg(test)]
mod tests {
    use super::AcceptedKeyValue::*;
    use super::*;

    #[test]
    fn names_that_a_terminal_or_a_shell_would_obey_are_found() {
        for bad in [
            "a\nb",
            "a\u{1b}[31m",
            "a\u{202e}b",
            "--help",
            "-x",
            " x",
            "x ",
            "\u{200b}",
            &"x".repeat(1 << 20),
        ] {
            let (found, expected) = bad_name("name", bad, false).unwrap();
            assert!(found.len() < 200 && unseen(&found).is_none(), "{found}");
            assert!(!expected.is_empty());
        }
        for good in ["x", "lathe 7", "Drehmaschine Süd", "X1", "日本", "a-b"] {
            assert_eq!(bad_name("name", good, false), None);
        }
        assert!(bad_name("name", "lathe 7", true).is_some());
    }

    keys! {
        KEYS:
        name: Word, "", REQUIRED, "the axis's name";
        count_um: Number(1e-4, 1000.0), "µm", REQUIRED, "what one count is worth";
        priority: Whole(1, 99), "", "80", "of the thread";
        rest: Choice(&["wait", "insert"]), "", "`wait`", "what it does at rest";
        on: Flag, "", "`false`", "whether it is on";
        range: Range(1e9), "°C", "none", "what is plausible";
    }

    type Found = (Option<String>, Option<f64>, i64, Option<bool>, bool, Option<[f64; 2]>);

    fn read(text: &str) -> (Found, Vec<String>) {
        let file = Path::new("f.toml");
        let document = Document::parse(file, text).unwrap();
        let mut source = FileWithFindings { file, text, findings: Vec::new() };
        let mut s = TomlSection::root(&document).with(KEYS);
        let found = (
            s.text(&mut source, "name").map(|at| at.value.to_owned()),
            s.number(&mut source, "count_um").map(|at| at.value),
            s.whole_or_default(&mut source, "priority"),
            s.pick(&mut source, "rest", &[false, true]).map(|at| at.value),
            s.flag(&mut source, "on"),
            s.range(&mut source, "range").map(|at| at.value),
        );
        s.finish(&mut source);
        (found, source.findings.iter().map(ToString::to_string).collect())
    }

    #[test]
    fn a_table_of_keys_reads_its_section() {
        let all = "name = 'x'\ncount_um = 2\npriority = 7\nrest = 'insert'\non = true\nrange = [-1, 2]\n";
        let found = (Some("x".to_owned()), Some(2.0), 7, Some(true), true, Some([-1.0, 2.0]));
        assert_eq!(read(all), (found, Vec::new()));
        let found = (Some("x".to_owned()), Some(2.0), 80, None, false, None);
        assert_eq!(read("name = 'x'\ncount_um = 2\n"), (found, Vec::new()));
    }

    #[test]
    fn each_mistake_has_its_line_and_what_was_expected() {
        let said = read("name = 'a b'\npriority = 100\nrest = 'inert'\non = 1\nrange = [2, 1]\nrang = 1\n").1;
        let expected = [
            "f.toml:1:8: found name = \"a b\", expected a name without blanks",
            "f.toml:1:1: found no count_um in the file, expected count_um: what one count is worth, µm",
            "f.toml:2:12: found priority = 100, expected priority = a whole number from 1 to 99",
            "f.toml:3:8: found rest = 'inert', expected rest = \"wait\" or \"insert\"; did you mean \"insert\"?",
            "f.toml:4:6: found on = 1, expected on = true or false",
            "f.toml:5:9: found range = [2, 1], expected range = [lowest, highest] within ±1e9",
            "f.toml:6:1: found unknown key rang, expected a key of the file; did you mean range?",
        ];
        assert_eq!(said, expected);
    }

    #[test]
    fn the_reference_shows_every_key() {
        let page = markdown("[[axis]]", KEYS);
        assert!(
            page.contains("| `count_um` | 0.0001 to 1000 µm | required | what one count is worth |"),
            "{page}"
        );
        assert!(page.contains("| `rest` | `wait`, `insert` | `wait` | what it does at rest |"), "{page}");
        assert_eq!(page.lines().count(), KEYS.len() + 2);
    }
}
