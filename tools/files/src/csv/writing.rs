//! Writes cells and header lines that read back the same.

use std::borrow::Cow;
use std::fmt::Write as _;

/// A cell written so that it reads back the same.
/// It is quoted if it is empty, has blanks at its ends, or holds a comma, a quote, a `#`, another separator
/// or a byte-order mark.
pub fn cell(text: &str) -> Cow<'_, str> {
    let quoted = [',', '"', '#', ';', '\t', '\u{feff}'];
    if text.is_empty() || text.contains(quoted) || text.trim().len() < text.len() {
        return Cow::Owned(format!("\"{}\"", text.replace('"', "\"\"")));
    }
    Cow::Borrowed(text)
}

/// The style for appending cells to a table's rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CsvStyle {
    /// The separator.
    pub by: char,
    /// Whether numbers have a decimal comma.
    pub decimal_comma: bool,
}

impl Default for CsvStyle {
    fn default() -> Self {
        Self { by: ',', decimal_comma: false }
    }
}

impl CsvStyle {
    /// Appends a text cell, after a separator.
    pub fn push_text(self, row: &mut String, text: &str) {
        row.push(self.by);
        row.push_str(&cell(text));
    }

    /// Appends a number, after a separator.
    pub fn push_number(self, row: &mut String, number: f64) {
        row.push(self.by);
        let quote = if self.decimal_comma && self.by == ',' { "\"" } else { "" };
        let number = number.to_string();
        let number = if self.decimal_comma { number.replace('.', ",") } else { number };
        let _ = write!(row, "{quote}{number}{quote}");
    }
}

/// The names of columns as a header line, without the line's end.
pub fn header_line<'n>(names: impl IntoIterator<Item = &'n str>) -> String {
    names.into_iter().map(cell).collect::<Vec<_>>().join(",")
}
