//! The rows of a table, and their cells.

use super::comments::outside_quotes;
use super::{Parser, has_quote};
use crate::decimal_parser::{number, plain_decimal};
use crate::input_error::InputError;
use crate::message_text::{quoted, shown};
use std::borrow::Cow;
use std::path::Path;

/// One row, without comment.
#[derive(Debug, Clone, Copy)]
pub struct Row<'a> {
    pub(super) file: &'a Path,
    pub(super) line: usize,
    pub(super) text: &'a str,
    /// The text with its comment.
    pub(super) whole: &'a str,
    pub(super) parser: &'a Parser,
    pub(super) by: u8,
}

impl<'a> Row<'a> {
    /// Line of the file, from 1.
    pub fn line(&self) -> usize {
        self.line
    }

    /// The row as the file has it.
    pub fn text(&self) -> &'a str {
        self.text
    }

    /// A finding about the row as a whole.
    pub fn finding(&self, found: impl Into<String>, expected: impl Into<String>) -> InputError {
        InputError::at(self.file, self.line, 0, found, expected)
    }

    /// The cells, from left to right.
    #[inline]
    pub fn cells(self) -> Cells<'a> {
        Cells { row: self, next: Some(0), quotes: has_quote(self.text) }
    }

    /// Whether it ends with a separator after `width` cells.
    pub(super) fn ends_beyond(self, width: usize) -> bool {
        self.text.as_bytes().last() == Some(&self.by)
            && outside_quotes(self.text.as_bytes()).filter(|(_, byte)| *byte == self.by).count() >= width
    }

    /// Whether a row has too many fields because of decimal commas.
    /// All fields are then numbers without a point.
    pub fn has_decimal_commas(&self, columns: usize) -> bool {
        let cells: Vec<&str> = self.text.split(',').map(str::trim).collect();
        let whole = |c: &&str| !c.contains('.') && c.parse::<f64>().is_ok_and(f64::is_finite);
        (columns + 1..=2 * columns).contains(&cells.len()) && cells.iter().all(whole)
    }

    pub(super) fn missing_field_finding(&self, cells: usize, columns: usize, missing: &str) -> InputError {
        let found = format!("the end of the row after {cells} of {columns} fields");
        let column = self.text.chars().count() + 1;
        InputError::at(self.file, self.line, column, found, format!("the field {missing}"))
    }

    pub(super) fn quotes_are_closed(self) -> Result<(), InputError> {
        let mut cells = self.cells();
        while let Some(start) = cells.next {
            let open = cells.quoted_cell(start).is_none();
            if open {
                let found =
                    format!("a quote that is not closed: {}", quoted(self.text[start..].trim_start()));
                return Err(self.at(start, found, "a second quote on the same line"));
            }
        }
        Ok(())
    }

    /// A finding at the character that begins at a byte of the text.
    fn at(&self, start: usize, found: impl Into<String>, expected: impl Into<String>) -> InputError {
        let column = self.text[..start].chars().count() + 1;
        let blanks = self.text[start..].chars().take_while(|c| c.is_whitespace()).count();
        InputError::at(self.file, self.line, column + blanks, found, expected)
    }
}

/// The cells of a row.
#[derive(Debug)]
pub struct Cells<'a> {
    row: Row<'a>,
    /// Start of the next cell in the row, bytes; `None` after the last.
    next: Option<usize>,
    quotes: bool,
}

impl<'a> Cells<'a> {
    /// The cell that begins at a byte, by the `csv` crate's parser.
    /// `None` if its quote is not closed.
    #[cold]
    fn quoted_cell(&mut self, start: usize) -> Option<Cow<'a, str>> {
        self.next = None;
        let rest = self.row.text[start..].trim_ascii_start();
        if !rest.starts_with('"') {
            return Some(Cow::Borrowed(self.plain_cell(start)));
        }
        let mut parser = self.row.parser.borrow_mut();
        parser.reset();
        let mut out = vec![0; rest.len() + 1];
        let (result, used, mut length) = parser.read_field(rest.as_bytes(), &mut out);
        let mut raw = rest;
        if let csv_core::ReadFieldResult::Field { .. } = result {
            self.next = Some(self.row.text.len() - rest.len() + used);
            raw = &rest[..used - 1];
        } else {
            // Within quotes the end of the line is text; outside it is the end of the cell.
            let (end, _, more) = parser.read_field(b"\n", &mut out[length..]);
            length += more;
            if !matches!(end, csv_core::ReadFieldResult::Field { .. }) {
                return None;
            }
        }
        // Blanks after the closing quote do not belong to the cell.
        out.truncate(length - (raw.len() - raw.trim_ascii_end().len()));
        Some(Cow::Owned(String::from_utf8_lossy(&out).into_owned()))
    }

    #[inline]
    fn plain_cell(&mut self, start: usize) -> &'a str {
        let rest = &self.row.text[start..];
        // Byte by byte, because cells are too short for the search that `str::split` does.
        let length = rest.bytes().position(|byte| byte == self.row.by);
        self.next = length.map(|length| start + length + 1);
        rest[..length.unwrap_or(rest.len())].trim_ascii()
    }
}

impl<'a> Iterator for Cells<'a> {
    type Item = Cell<'a>;

    #[inline]
    fn next(&mut self) -> Option<Cell<'a>> {
        let start = self.next?;
        let text = if self.quotes {
            // The row's quotes were checked when it was read: all are closed.
            self.quoted_cell(start).unwrap_or_default()
        } else {
            Cow::Borrowed(self.plain_cell(start))
        };
        Some(Cell { row: self.row, start, text })
    }
}

/// One cell, without quotes and the blanks around it.
#[derive(Debug, Clone)]
pub struct Cell<'a> {
    row: Row<'a>,
    start: usize,
    pub(super) text: Cow<'a, str>,
}

impl Cell<'_> {
    /// The cell's text.
    #[inline]
    pub fn text(&self) -> &str {
        &self.text
    }

    /// A finding at this cell: it shows the cell's text as what was found.
    pub fn finding(&self, expected: impl Into<String>) -> InputError {
        self.finding_with_text(shown(&self.text), expected)
    }

    /// A finding at this cell, with the caller's own words for what was found.
    pub fn finding_with_text(&self, found: impl Into<String>, expected: impl Into<String>) -> InputError {
        self.row.at(self.start, found, expected)
    }

    /// Column of the cell's first character, from 1.
    pub fn column(&self) -> usize {
        self.finding_with_text("", "").column
    }

    /// The cell's finite number.
    ///
    /// # Errors
    /// It is not a finite number.
    #[inline]
    pub fn finite(&self) -> Result<f64, InputError> {
        if let Some(number) = plain_decimal(self.text.as_bytes()) {
            return Ok(number);
        }
        number(&self.text).ok_or_else(|| self.finding("a finite number"))
    }

    pub(super) fn extra_field_finding(&self, columns: usize, names: &str) -> InputError {
        let after =
            if names.len() <= 60 { names.to_owned() } else { format!("{columns} fields, one per column") };
        self.finding(format!("the end of the row after {after}"))
    }
}
