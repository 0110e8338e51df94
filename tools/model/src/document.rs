//! TOML read with line and column: a thin view over `toml_edit` whose every failure is an [`InputError`].

use rtec_driver::input::InputError;
use std::ops::Range;
use std::path::Path;
use toml_edit::{Document, Item, TableLike, Value};

/// Reads a text file; a byte-order mark is dropped.
///
/// # Errors
/// It cannot be read or is not UTF-8.
pub fn read(path: &Path) -> Result<String, InputError> {
    let bytes = std::fs::read(path)
        .map_err(|e| InputError::whole(path, format!("error `{e}`"), "a file that can be read"))?;
    decode(path, &bytes)
}

/// UTF-8 text without its byte-order mark.
///
/// # Errors
/// The place of the first byte that is not UTF-8.
pub fn decode(path: &Path, bytes: &[u8]) -> Result<String, InputError> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    match std::str::from_utf8(bytes) {
        Ok(text) => Ok(text.to_owned()),
        Err(e) => {
            let good = String::from_utf8_lossy(&bytes[..e.valid_up_to()]).into_owned();
            Err(InputError::at_offset(path, &good, good.len(), "a byte that is not UTF-8", "UTF-8 text"))
        }
    }
}

/// Parses TOML.
///
/// # Errors
/// The place and message of the first syntax error.
pub fn parse<'t>(path: &Path, text: &'t str) -> Result<Document<&'t str>, InputError> {
    Document::parse(text).map_err(|e| {
        let at = e.span().map_or(0, |s| s.start);
        InputError::at_offset(path, text, at, e.message().replace('\n', "; "), "valid TOML")
    })
}

/// A table and where it stands.
#[derive(Clone, Copy)]
pub struct Table<'d> {
    path: &'d Path,
    text: &'d str,
    of: &'d dyn TableLike,
    start: usize,
}

/// A key with its value.
#[derive(Clone, Copy)]
pub struct Entry<'d> {
    path: &'d Path,
    text: &'d str,
    key: &'d str,
    item: &'d Item,
    key_start: usize,
    start: usize,
}

impl<'d> Table<'d> {
    /// The root table of a document.
    #[must_use]
    pub fn root(path: &'d Path, text: &'d str, doc: &'d Document<&str>) -> Self {
        Self { path, text, of: doc.as_table(), start: 0 }
    }

    /// Refuses every key that is not among `known`.
    ///
    /// # Errors
    /// The first unknown key, with the closest known one where there is one.
    pub fn only(&self, known: &[&str]) -> Result<(), InputError> {
        for entry in self.entries() {
            if !known.contains(&entry.key) {
                let close = known.iter().find(|k| near(k, entry.key));
                let hint = close.map_or_else(String::new, |k| format!(" (did you mean `{k}`?)"));
                return Err(entry.unknown_key(&format!("one of {}{hint}", known.join(", "))));
            }
        }
        Ok(())
    }

    /// The entry of a key.
    #[must_use]
    pub fn get(&self, key: &str) -> Option<Entry<'d>> {
        self.entries().find(|e| e.key == key)
    }

    /// The entry of a key that must be there.
    ///
    /// # Errors
    /// It is missing.
    pub fn required(&self, key: &str, expected: &str) -> Result<Entry<'d>, InputError> {
        self.get(key).ok_or_else(|| self.error(format!("no `{key}`"), expected))
    }

    /// All entries, in the file's order.
    pub fn entries(&self) -> impl Iterator<Item = Entry<'d>> {
        let (path, text, start, table) = (self.path, self.text, self.start, self.of);
        table.iter().map(move |(key, item)| {
            let key_start = table.key(key).and_then(toml_edit::Key::span).map_or(start, |s| s.start);
            let start = item.span().map_or(key_start, |s: Range<usize>| s.start);
            Entry { path, text, key, item, key_start, start }
        })
    }

    /// A finding about this table.
    pub fn error(&self, found: impl Into<String>, expected: impl Into<String>) -> InputError {
        InputError::at_offset(self.path, self.text, self.start, found, expected)
    }
}

impl<'d> Entry<'d> {
    /// The key.
    #[must_use]
    pub fn key(&self) -> &'d str {
        self.key
    }

    /// The value as it would be written, for messages.
    #[must_use]
    pub fn text(&self) -> String {
        match self.item.as_str() {
            Some(s) => s.to_owned(),
            None => self.item.to_string().trim().to_owned(),
        }
    }

    /// A finding about the value.
    pub fn error(&self, found: impl Into<String>, expected: impl Into<String>) -> InputError {
        InputError::at_offset(self.path, self.text, self.start, found, expected)
    }

    /// A finding about the key.
    pub fn key_error(&self, found: impl Into<String>, expected: impl Into<String>) -> InputError {
        InputError::at_offset(self.path, self.text, self.key_start, found, expected)
    }

    /// The key is not known here.
    #[must_use]
    pub fn unknown_key(&self, expected: &str) -> InputError {
        self.key_error(format!("unknown key `{}`", self.key), expected)
    }

    fn mismatch(&self, expected: &str) -> InputError {
        self.error(format!("`{} = {}`", self.key, self.text()), expected)
    }

    /// The value as text.
    ///
    /// # Errors
    /// It is something else.
    pub fn str(&self, expected: &str) -> Result<&'d str, InputError> {
        self.item.as_str().ok_or_else(|| self.mismatch(expected))
    }

    /// The value as a truth value.
    ///
    /// # Errors
    /// It is something else.
    pub fn bool(&self, expected: &str) -> Result<bool, InputError> {
        self.item.as_bool().ok_or_else(|| self.mismatch(expected))
    }

    /// The value as a finite number; an integer will do.
    ///
    /// # Errors
    /// It is something else, infinite or not a number.
    pub fn number(&self, expected: &str) -> Result<f64, InputError> {
        self.item.as_value().and_then(number).ok_or_else(|| self.mismatch(expected))
    }

    /// The value as a finite number above zero.
    ///
    /// # Errors
    /// It is something else.
    pub fn positive(&self, expected: &str) -> Result<f64, InputError> {
        let v = self.number(expected)?;
        if v > 0.0 { Ok(v) } else { Err(self.mismatch(expected)) }
    }

    /// The value as an array of finite numbers.
    ///
    /// # Errors
    /// It is something else.
    pub fn numbers(&self, expected: &str) -> Result<Vec<f64>, InputError> {
        let array = self.item.as_array().ok_or_else(|| self.mismatch(expected))?;
        array.iter().map(|v| number(v).ok_or_else(|| self.mismatch(expected))).collect()
    }

    /// The value as a pair of finite numbers, the first not above the second.
    ///
    /// # Errors
    /// It is something else.
    pub fn pair(&self, expected: &str) -> Result<[f64; 2], InputError> {
        match self.numbers(expected)?[..] {
            [lo, hi] if lo <= hi => Ok([lo, hi]),
            _ => Err(self.mismatch(expected)),
        }
    }

    /// The value as pairs of finite numbers: one pair, or an array of pairs.
    ///
    /// # Errors
    /// It is something else, or a pair runs backwards.
    pub fn pairs(&self, expected: &str) -> Result<Vec<[f64; 2]>, InputError> {
        let array = self.item.as_array().ok_or_else(|| self.mismatch(expected))?;
        if array.iter().all(Value::is_array) {
            let pair = |v: &Value| match v.as_array()?.iter().map(number).collect::<Option<Vec<_>>>()?[..] {
                [lo, hi] if lo <= hi => Some([lo, hi]),
                _ => None,
            };
            return array.iter().map(|v| pair(v).ok_or_else(|| self.mismatch(expected))).collect();
        }
        Ok(vec![self.pair(expected)?])
    }

    /// The value as a table, `[header]` or inline.
    ///
    /// # Errors
    /// It is something else.
    pub fn table(&self, expected: &str) -> Result<Table<'d>, InputError> {
        let table = self.item.as_table_like().ok_or_else(|| self.mismatch(expected))?;
        Ok(Table { path: self.path, text: self.text, of: table, start: self.start })
    }

    /// The value as a list of tables: `[[header]]` or an array of inline tables (empty too).
    ///
    /// # Errors
    /// It is something else.
    pub fn tables(&self, expected: &str) -> Result<Vec<Table<'d>>, InputError> {
        let of = |table: &'d dyn TableLike, span: Option<Range<usize>>| Table {
            path: self.path,
            text: self.text,
            of: table,
            start: span.map_or(self.start, |s| s.start),
        };
        match self.item {
            Item::ArrayOfTables(list) => Ok(list.iter().map(|t| of(t, t.span())).collect()),
            Item::Value(Value::Array(list)) => list
                .iter()
                .map(|v| v.as_inline_table().map(|t| of(t, t.span())).ok_or_else(|| self.mismatch(expected)))
                .collect(),
            _ => Err(self.mismatch(expected)),
        }
    }
}

fn number(v: &Value) -> Option<f64> {
    v.as_float().or_else(|| v.as_integer().map(|i| i as f64)).filter(|f| f.is_finite())
}

/// One edit apart, or one the start of the other: worth a hint.
fn near(a: &str, b: &str) -> bool {
    if a.starts_with(b) || b.starts_with(a) || a.eq_ignore_ascii_case(b) {
        return true;
    }
    let (a, b): (Vec<char>, Vec<char>) = (a.chars().collect(), b.chars().collect());
    let head = a.iter().zip(&b).take_while(|(x, y)| x == y).count();
    let tail = a.iter().rev().zip(b.iter().rev()).take_while(|(x, y)| x == y).count();
    head + tail + 1 >= a.len().max(b.len()) && a.len().abs_diff(b.len()) <= 1
}
