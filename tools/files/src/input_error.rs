//! The error type for a file that a person wrote.
//! It says where, what was found and what was expected.

use crate::message_text::{cut_at, printable};
use std::fmt;
use std::path::{Path, PathBuf};

/// Longest text of `found` or `expected` in characters.
/// Part of it may come from the file.
const LONGEST: usize = 2000;

/// Bad input in a file: one finding, with its place and its remedy.
/// It ends a command with exit code 2.
#[derive(Debug, Clone, PartialEq, Eq)]
#[must_use = "a finding is to be returned or reported"]
pub struct InputError {
    /// The file, as the user named it.
    pub file: PathBuf,
    /// Line, from 1; 0 if the finding concerns the whole file.
    pub line: usize,
    /// Column in characters, from 1; 0 if the finding concerns the whole line.
    pub column: usize,
    /// What was found there.
    pub found: String,
    /// What was expected, and how to correct it.
    pub expected: String,
}

/// A result of reading what a person wrote.
pub type Result<T, E = InputError> = std::result::Result<T, E>;

impl InputError {
    /// A finding about the file as a whole.
    pub fn whole(file: &Path, found: impl Into<String>, expected: impl Into<String>) -> Self {
        Self::at(file, 0, 0, found, expected)
    }

    /// A finding at the beginning of a line, from 1.
    pub fn line(file: &Path, line: usize, found: impl Into<String>, expected: impl Into<String>) -> Self {
        Self::at(file, line, 1, found, expected)
    }

    /// A finding at a line and column, each from 1, or 0 if not known.
    pub fn at(
        file: &Path,
        line: usize,
        column: usize,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> Self {
        Self { file: file.to_owned(), line, column, found: found.into(), expected: expected.into() }
    }

    /// A finding at a byte offset of `text`, as TOML parsers report it.
    pub fn at_offset(
        file: &Path,
        text: &str,
        offset: usize,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> Self {
        let mut end = offset.min(text.len());
        while !text.is_char_boundary(end) {
            end -= 1;
        }
        let before = &text[..end];
        let line = before.matches('\n').count() + 1;
        let column = before.rsplit('\n').next().map_or(0, |tail| tail.chars().count()) + 1;
        Self::at(file, line, column, found, expected)
    }
}

impl fmt::Display for InputError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&printable(&self.file.to_string_lossy()))?;
        if self.line > 0 {
            write!(f, ":{}", self.line)?;
            if self.column > 0 {
                write!(f, ":{}", self.column)?;
            }
        }
        let [found, expected] = [&self.found, &self.expected].map(|text| cut_at(text, LONGEST));
        write!(f, ": found {}, expected {}", printable(&found), printable(&expected))
    }
}

impl std::error::Error for InputError {}

/// A message about input that is accepted nevertheless.
/// It is a line on a terminal, or a warning in a notebook.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum InputNotice {
    /// A fact to know before the result is used.
    Warning(String),
    /// What was done with the input, or what else could be done with it.
    Note(String),
}

impl fmt::Display for InputNotice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Warning(text) => write!(f, "warning: {text}"),
            Self::Note(text) => write!(f, "note: {text}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn offset_becomes_line_and_column() {
        let e = InputError::at_offset(Path::new("m.toml"), "a = 1\nµb = 2\n", 8, "x", "y");
        assert_eq!((e.line, e.column), (2, 2));
        assert_eq!(e.to_string(), "m.toml:2:2: found x, expected y");
    }

    #[test]
    fn what_a_file_says_does_not_act_on_a_terminal() {
        let e = InputError::whole(Path::new("m\u{1b}[1m.toml"), "unknown key \u{1b}[2J\n", "none of\u{7}");
        let said = "m\\u{1b}[1m.toml: found unknown key \\u{1b}[2J\\n, expected none of\\u{7}";
        assert_eq!(e.to_string(), said);
    }

    #[test]
    fn what_a_file_says_is_not_said_without_end() {
        let e = InputError::whole(Path::new("m"), "µ".repeat(25_000), "x");
        assert_eq!(e.to_string(), format!("m: found {}…, expected x", "µ".repeat(LONGEST)));
    }

    #[test]
    fn offset_past_the_end_or_inside_a_character_does_not_panic() {
        assert_eq!(InputError::at_offset(Path::new("m"), "µ", 1, "", "").column, 1);
        assert_eq!(InputError::at_offset(Path::new("m"), "a\n", 99, "", "").line, 2);
    }
}
