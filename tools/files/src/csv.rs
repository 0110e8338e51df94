//! Reads CSV line by line: UTF-8, UTF-16 or Windows-1252.
//! A byte-order mark and CRLF are accepted. A cell in double quotes may hold commas, `#` and doubled quotes.
//! Every finding has its line and column. A row of separators alone counts as empty, because spreadsheets
//! write such rows.
//!
//! Lines of other programs are skipped. These are comments that begin with `;`, `%` or `//`. They are also
//! lines before the columns' names, if the caller asks for names that are in a later line.
//!
//! A comment begins with a `#` at a line's start. After a whole row it begins with a `#` that has a blank on
//! one side. Within a cell `#` is text: `#1`, `No#2`, `Sample #,t`, `#N/A`, and `1 # 2` if cells are still to
//! come.
//!
//! Lines and comments are parsed here, because the `csv` crate knows comments only as whole lines and gives
//! no columns. That crate's parser ([`csv_core`]) splits lines with quotes. Lines without a quote are split
//! at their commas.

use crate::decimal::{decimal, number, plain_decimal};
use crate::file_kind::FileKind;
use crate::input::InputError;
use crate::lines::Lines;
use crate::text::{UTF8, is_western, not_utf8, opened, western};
use crate::units;
use crate::words::{cut, nearest, quoted, shown};
use std::borrow::Cow;
use std::cell::RefCell;
use std::fmt::Write as _;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Reads a CSV row by row; memory stays flat for a file of any length.
#[derive(Debug)]
pub struct Reader<R> {
    pub(crate) lines: Lines<R>,
    parser: Parser,
    by: u8,
    /// Cells per row, once the header is read.
    width: Option<usize>,
    encoding: Encoding,
    /// The present line, decoded, if it is not UTF-8.
    decoded: String,
    commented: Option<Commented>,
    /// Rows that end with extra separators after the last named column, and others.
    beyond: Beyond,
    /// Number of another program's lines before the columns' names.
    preamble: usize,
}

/// Rows that end with more separators than their header, and rows that do not.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Beyond {
    /// The line of the first such row.
    pub(crate) line: usize,
    pub(crate) rows: usize,
    /// Number of rows that end as their header does.
    pub(crate) others: usize,
}

/// The encoding of the lines so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Encoding {
    Ascii,
    Utf8,
    Western,
}

/// Lines that begin with `#` but look like rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Commented {
    /// The first such line, from 1.
    pub line: usize,
    /// The number of such lines.
    pub lines: usize,
}

/// A row that [`Reader::plain_row`] has found.
/// It has the length of the row's text, and of its line with the line's end, bytes.
#[derive(Debug, Clone, Copy)]
pub struct PlainRow {
    text: usize,
    line: usize,
}

/// The parser of quoted cells, shared by the rows.
/// Its state ends with each cell, and a built parser cannot be cloned.
type Parser = RefCell<csv_core::Reader>;

impl Reader<File> {
    /// Opens a file.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn open(file: &Path) -> Result<Self, InputError> {
        Self::new(file, opened(file)?)
    }
}

impl<R: Read> Reader<R> {
    /// Reads from `input`; `file` is its name in error messages.
    ///
    /// # Errors
    /// The input cannot be read.
    pub fn new(file: &Path, input: R) -> Result<Self, InputError> {
        Ok(Self {
            lines: Lines::new(file, input)?,
            parser: parser(b','),
            by: b',',
            width: None,
            encoding: Encoding::Ascii,
            decoded: String::new(),
            commented: None,
            beyond: Beyond::default(),
            preamble: 0,
        })
    }

    /// The next row that has more than a comment.
    ///
    /// # Errors
    /// It is not UTF-8, a quote in it is not closed, or the input cannot be read.
    pub fn row(&mut self) -> Result<Option<Row<'_>>, InputError> {
        let (range, length) = loop {
            let Some(range) = self.lines.line()? else { return Ok(None) };
            let line = self.lines.bytes(range.clone());
            if is_foreign_comment(line, self.by, self.width) {
                continue;
            }
            let length = content(line, self.by, self.width).len();
            if length > 0 {
                break (range, length);
            }
            if looks_like_a_row(line, self.by, self.width) {
                let (line, first) = (self.lines.line, self.commented);
                self.commented = Some(Commented {
                    line: first.map_or(line, |c| c.line),
                    lines: first.map_or(1, |c| c.lines + 1),
                });
            }
        };
        let (lines, parser, by) = (&self.lines, &self.parser, self.by);
        let bytes = lines.bytes(range);
        let (whole, length) = match std::str::from_utf8(bytes) {
            Ok(line) if line.is_ascii() => (line, length),
            Ok(line) if self.encoding != Encoding::Western => {
                self.encoding = Encoding::Utf8;
                (line, length)
            }
            Ok(_) => {
                let found = "letters in UTF-8 behind lines in Windows-1252";
                return Err(InputError::at(&lines.file, lines.line, 0, found, "one encoding, best UTF-8"));
            }
            Err(e) => {
                if let Some(kind) = FileKind::of_bytes(bytes).filter(|_| lines.line == 1) {
                    return Err(InputError::whole(&lines.file, kind.name(), kind.as_text()));
                }
                let (good, bad) = bytes.split_at(e.valid_up_to());
                if self.encoding == Encoding::Utf8 || !good.is_ascii() || !is_western(bytes) {
                    let column = String::from_utf8_lossy(good).chars().count() + 1;
                    return Err(InputError::at(&lines.file, lines.line, column, not_utf8(bad[0]), UTF8));
                }
                self.encoding = Encoding::Western;
                self.decoded = western(bytes);
                let length = content(self.decoded.as_bytes(), by, self.width).len();
                (self.decoded.as_str(), length)
            }
        };
        let row = Row { file: &lines.file, line: lines.line, text: &whole[..length], whole, parser, by };
        if has_quote(row.text) {
            row.quotes_are_closed()?;
        }
        if let Some(width) = self.width {
            if row.ends_beyond(width) {
                self.beyond.rows += 1;
                self.beyond.line = if self.beyond.rows == 1 { row.line } else { self.beyond.line };
            } else {
                self.beyond.others += 1;
            }
        }
        Ok(Some(row))
    }

    /// Fast path: the numbers of the next row, if it has as many cells as `row`.
    /// Fields that `skip` marks are not read. The result equals that of [`Reader::row`] and [`Cell::finite`],
    /// but is faster, because each byte is read once. Nothing is consumed: [`Reader::take`] does that.
    /// `None`, with undefined values in `row`, if the row needs the careful reader. It then has a quote, a
    /// comment, blanks or a mistake, or exceeds the buffer.
    #[inline]
    pub fn plain_row(&self, row: &mut [f64], skip: impl Fn(usize) -> bool) -> Option<PlainRow> {
        let (ahead, by) = (self.lines.unread(), self.by);
        let (last, mut at) = (row.len().checked_sub(1)?, 0);
        // A blank separator may also end the row. A single field that is skipped may be no row at all.
        if !matches!(by, b',' | b';') || last == 0 && skip(0) {
            return None;
        }
        for (n, place) in row.iter_mut().enumerate() {
            let rest = &ahead[at..];
            let is_end = |byte: u8| byte == by || byte == b'\n' || byte == b'\r';
            let (number, length) = match decimal(rest) {
                Some((number, length)) if rest.get(length).is_some_and(|byte| is_end(*byte)) => {
                    (number, length)
                }
                _ => other_field(rest, is_end, skip(n))?,
            };
            *place = number;
            at += length + 1;
            if n < last && rest[length] != by {
                return None;
            }
        }
        match &ahead[at - 1..] {
            [b'\n', ..] => Some(PlainRow { text: at - 1, line: at }),
            [b'\r', b'\n', ..] => Some(PlainRow { text: at - 1, line: at + 1 }),
            _ => None,
        }
    }

    /// Consumes the row that [`Reader::plain_row`] has just found.
    /// Returns its text, which is ASCII.
    #[inline]
    pub fn take(&mut self, row: PlainRow) -> &[u8] {
        self.beyond.others += 1;
        self.lines.take_line(row.line, row.text).trim_ascii_end()
    }

    /// The first row, as the columns' names.
    ///
    /// # Errors
    /// There is no row: `expected` says what it should hold. Otherwise as [`Reader::row`].
    pub fn header(&mut self, expected: &str) -> Result<Header, InputError> {
        let first = self.first_line(expected)?;
        let ((_, header), _) = self.best(&first, Some(self.by), &|_| true);
        self.width = Some(header.names.len());
        Ok(header)
    }

    /// The first row, as the columns' names, with the separator that gives all `names`.
    /// The separator is `;`, a tab or `|` if the row has no comma, else a comma. It applies to all rows. A
    /// line `sep=X` before it, as spreadsheets write it, sets the separator. `names` choose among several
    /// separators in the row, and among the first lines.
    ///
    /// # Errors
    /// As [`Reader::header`]; a `sep=` of another character than `,`, `;`, `|` and a tab.
    pub fn header_with(&mut self, expected: &str, names: &[&str]) -> Result<Header, InputError> {
        self.header_where(expected, |header| names.iter().all(|name| header.find(name).is_some()))
    }

    /// As [`Reader::header_with`], from the first line with the wanted columns.
    /// Lines before it are skipped. If there is no such line, the first one is used.
    ///
    /// # Errors
    /// As [`Reader::header_with`].
    pub fn header_where(
        &mut self,
        expected: &str,
        is_wanted: impl Fn(&Header) -> bool,
    ) -> Result<Header, InputError> {
        let mut first = self.first_line(expected)?;
        let mut by = None;
        if let Some(said) = first.text.get(..4).filter(|s| s.eq_ignore_ascii_case("sep=")) {
            let separator = match &first.text[said.len()..] {
                "" => b'\t', // the blanks at a line's end are dropped
                "," => b',',
                ";" => b';',
                "|" => b'|',
                other => {
                    let (found, expected) =
                        (format!("{said}{other}"), "sep= with a comma, a semicolon, | or a tab");
                    return Err(InputError::at(&self.lines.file, first.line, 0, found, expected));
                }
            };
            (self.parser, self.by) = (parser(separator), separator);
            by = Some(separator);
            first = self.first_line(expected)?;
        }
        let (mut best, wanted) = self.best(&first, by, &is_wanted);
        if !wanted && let Some(lines) = self.lines_before(by, &is_wanted)? {
            for _ in 0..lines {
                self.lines.line()?;
            }
            let before = std::mem::replace(&mut first, self.first_line(expected)?).line;
            self.preamble = first.line - before;
            (best, _) = self.best(&first, by, &is_wanted);
        }
        let (by, header) = best;
        (self.parser, self.by, self.width) = (parser(by), by, Some(header.names.len()));
        Ok(header)
    }

    /// The columns' names in a line, split so that the wanted names are found.
    /// If none does, by the likeliest separator.
    fn best(
        &self,
        first: &FirstLine,
        by: Option<u8>,
        is_wanted: &impl Fn(&Header) -> bool,
    ) -> ((u8, Header), bool) {
        // The first name may contain the # that seems to begin a comment.
        let is_parted = outside_quotes(first.text.as_bytes()).any(|(_, byte)| is_separator(byte, b','));
        let text = if is_parted { &first.text } else { &first.whole };
        let has = |by: &u8| outside_quotes(text.as_bytes()).any(|(_, byte)| byte == *by);
        let mut separators: Vec<u8> = [b';', b'\t'].into_iter().filter(has).collect();
        // Lines of SHDR have bars and commas.
        separators.extend(if has(&b'|') && !has(&b',') { &b"|,"[..] } else { b"," });
        let separators = by.map_or(separators, |by| vec![by]);
        let cut = |by: u8| content(first.whole.as_bytes(), by, width_of_rows(self.lines.unread(), by)).len();
        // A name may contain a # that would begin a comment. It is kept if the caller asks for that name.
        let cut_off = separators.iter().map(|by| (*by, cut(*by)));
        let lengths = cut_off.chain(separators.iter().map(|by| (*by, first.whole.len())));
        let header_by = |(by, length): (u8, usize)| {
            let text = &first.whole[..length];
            let row =
                Row { file: &self.lines.file, line: first.line, text, whole: text, parser: &parser(by), by };
            (by, Header::of(row))
        };
        let mut headers: Vec<(u8, Header)> = lengths.map(header_by).collect();
        let best = headers.iter().position(|(_, header)| is_wanted(header));
        (headers.swap_remove(best.unwrap_or(0)), best.is_some())
    }

    /// The number of following lines before one with the wanted names.
    fn lines_before(
        &mut self,
        by: Option<u8>,
        is_wanted: &impl Fn(&Header) -> bool,
    ) -> Result<Option<usize>, InputError> {
        self.lines.fill_lines(PREAMBLE)?;
        let has_names = |line: &[u8]| {
            let text = std::str::from_utf8(line).map_or_else(|_| western(line), str::to_owned);
            let whole = text.trim_ascii_end().to_owned();
            let is_open = whole.matches('"').count() % 2 == 1;
            let is_empty = content(whole.as_bytes(), self.by, None).is_empty();
            let first = FirstLine { line: self.lines.line + 1, text: whole.clone(), whole };
            let is_row = !(is_open || is_empty || is_foreign_comment(line, self.by, None));
            is_row && self.best(&first, by, is_wanted).1
        };
        Ok(self.lines.unread().split(|byte| *byte == b'\n').take(PREAMBLE).position(has_names))
    }

    /// As [`Reader::header_with`], for columns given by name or number from 1.
    /// See [`Reader::or_numbers`].
    ///
    /// # Errors
    /// As [`Reader::header_with`].
    pub fn header_of(&mut self, expected: &str, columns: &[&str]) -> Result<Header, InputError> {
        let names: Vec<&str> = columns.iter().filter(|column| !is_number(column)).copied().collect();
        let header = self.header_with(expected, &names)?;
        Ok(self.or_numbers(header, columns))
    }

    /// The header that was just read, or numbers in place of names.
    /// If all wanted columns are numbers and the line holds values, the line becomes a row and the columns
    /// are numbered.
    pub fn or_numbers(&mut self, header: Header, columns: &[&str]) -> Header {
        if columns.is_empty() || !columns.iter().all(is_number) || header.is_missing().is_none() {
            return header;
        }
        self.lines.unread_line();
        header.numbered()
    }

    /// The first line that has more than a comment.
    fn first_line(&mut self, expected: &str) -> Result<FirstLine, InputError> {
        let file = self.lines.file.clone();
        let is_empty = self.lines.unread().trim_ascii().is_empty();
        let row = self.row()?;
        let none = || {
            let found = if is_empty {
                "no header"
            } else {
                "no header: every line is empty or a comment, which begins with #, ;, % or //"
            };
            InputError::whole(&file, found, expected)
        };
        let row = row.ok_or_else(none)?;
        Ok(FirstLine {
            line: row.line,
            text: row.text.to_owned(),
            whole: row.whole.trim_ascii_end().to_owned(),
        })
    }

    /// Reads the row of names, which must hold these; further names are ignored.
    /// `otherwise` tells the user of another option.
    ///
    /// # Errors
    /// A name is missing.
    pub fn expect_header<const N: usize>(
        &mut self,
        names: [&str; N],
        otherwise: &str,
    ) -> Result<Header, InputError> {
        let wanted = format!("the header {}", names.join(","));
        let header = self.header_with(&format!("{wanted}{otherwise}"), &names)?;
        if names.iter().all(|name| header.find(name).is_some()) {
            return Ok(header);
        }
        let finding = match header.is_missing() {
            Some(missing) => {
                InputError { expected: format!("{wanted} in front of them{otherwise}"), ..missing }
            }
            None => header.finding(quoted(&header.text), format!("{wanted}{otherwise}")),
        };
        Err(self.instead_of(&header, finding))
    }

    /// A finding about the header, or that the file is of another kind.
    pub fn instead_of(&self, header: &Header, finding: InputError) -> InputError {
        let text = format!("{}\n{}", header.text, String::from_utf8_lossy(self.lines.unread()));
        FileKind::instead_of(None, &text, finding)
    }

    /// The finding that there is no row, only comments that look like rows.
    pub fn rows_are_comments(&self) -> Option<InputError> {
        let Commented { line, lines } = self.commented?;
        let found = format!("{lines} lines that begin with # and have a row's cells, and no other row");
        let expected =
            "rows: a line that begins with # is a comment; put its first cell in quotes if it is a row";
        Some(InputError::at(&self.lines.file, line, 1, found, expected))
    }

    /// Sets another ASCII character than a comma as the separator.
    #[must_use]
    pub fn parted_by(mut self, by: char) -> Self {
        self.by = u8::try_from(by).unwrap_or(b',');
        self.parser = parser(self.by);
        self
    }

    /// Numbers of rows so far that end with extra separators, and of others.
    pub(crate) fn beyond(&self) -> Beyond {
        self.beyond
    }

    /// Number of lines that were skipped before the columns' names.
    pub(crate) fn preamble(&self) -> usize {
        self.preamble
    }

    /// Whether a line so far was not UTF-8, and was read as Windows-1252.
    pub fn is_western(&self) -> bool {
        self.encoding == Encoding::Western
    }

    /// Lines so far that begin with `#` but look like rows.
    pub fn commented(&self) -> Option<Commented> {
        self.commented
    }

    /// Whether the input is UTF-16.
    pub fn is_utf16(&self) -> bool {
        self.lines.is_utf16()
    }

    /// The separator: a comma unless [`Reader::header_with`] found another.
    pub fn separator(&self) -> char {
        char::from(self.by)
    }
}

fn parser(by: u8) -> Parser {
    let any = csv_core::Terminator::Any(b'\n');
    RefCell::new(csv_core::ReaderBuilder::new().delimiter(by).terminator(any).build())
}

fn has_quote(text: &str) -> bool {
    memchr::memchr(b'"', text.as_bytes()).is_some()
}

/// Whether a column is given by its number.
fn is_number(column: &&str) -> bool {
    column.parse::<usize>().is_ok()
}

/// The first line of a table, with its comment and without.
#[derive(Debug)]
struct FirstLine {
    line: usize,
    text: String,
    whole: String,
}

/// A line without its comment and the blanks at its end.
/// Empty if it has only separators.
fn content(line: &[u8], by: u8, width: Option<usize>) -> &[u8] {
    let comment = if memchr::memchr(b'#', line).is_some() { comment_at(line, by, width) } else { None };
    let text = line[..comment.unwrap_or(line.len())].trim_ascii_end();
    if text.first().is_none_or(|first| first.is_ascii_whitespace() || is_separator(*first, by))
        && text.iter().all(|byte| byte.is_ascii_whitespace() || is_separator(*byte, by))
    {
        return &[];
    }
    text
}

/// Number of lines that are searched for the columns' names.
const PREAMBLE: usize = 100;

/// Whether a line is another program's comment.
/// A row whose first cell begins in the same way is not. `width`: the number of cells in a row.
fn is_foreign_comment(line: &[u8], by: u8, width: Option<usize>) -> bool {
    let (mark, rest) = match line.trim_ascii_start() {
        [b'/', b'/', ..] => return true,
        [mark @ (b';' | b'%'), rest @ ..] => (*mark, rest),
        _ => return false,
    };
    let apart = rest.first().is_none_or(|byte| byte.is_ascii_whitespace() || *byte == mark);
    match width {
        _ if mark == b'%' && apart => true,
        None if mark == b';' => apart || !rest.contains(&mark) && rest.trim_ascii().contains(&b' '),
        None => false,
        Some(_) if mark == b';' && by != mark => true,
        Some(width) => outside_quotes(line).filter(|(_, byte)| *byte == by).count() + 1 != width,
    }
}

/// Whether a byte is a separator; before the header is read, any possible one.
fn is_separator(byte: u8, by: u8) -> bool {
    byte == by || by == b',' && matches!(byte, b';' | b'\t' | b'|')
}

/// The texts that spreadsheets write into a cell that they cannot calculate.
const CELL_ERRORS: [&[u8]; 9] =
    [b"#N/A", b"#NV", b"#DIV/0!", b"#VALUE!", b"#WERT!", b"#REF!", b"#NAME?", b"#NUM!", b"#NULL!"];

/// The place where a line's comment begins. `width`: cells per row, if known.
fn comment_at(line: &[u8], by: u8, width: Option<usize>) -> Option<usize> {
    let (mut cells, mut at_cell) = (1, true);
    for (at, byte) in outside_quotes(line) {
        if byte == by {
            (cells, at_cell) = (cells + 1, true);
            continue;
        }
        if byte == b'#' {
            let behind = line.get(at + 1);
            let is_error = at_cell && CELL_ERRORS.iter().any(|error| line[at..].starts_with(error));
            let is_first = line[..at].trim_ascii_start().is_empty();
            let is_blank = |byte: Option<&u8>| byte.is_none_or(u8::is_ascii_whitespace);
            let apart = is_blank(behind) || is_blank(at.checked_sub(1).map(|at| &line[at]));
            let parted = behind.is_some_and(|byte| *byte != b' ' && is_separator(*byte, by));
            let is_whole = width.is_none_or(|width| cells >= width);
            // A line that begins with # is a comment, whatever follows.
            if !is_error && (is_first || apart && !parted && is_whole) {
                return Some(at);
            }
        }
        at_cell &= byte.is_ascii_whitespace() || is_separator(byte, by);
    }
    None
}

/// Whether a comment looks like a row: `#1;2,5;3`, `#1;D1;2,5`.
/// It has as many cells, a word in the first and a number in another.
fn looks_like_a_row(line: &[u8], by: u8, width: Option<usize>) -> bool {
    let Some(text) = line.trim_ascii().strip_prefix(b"#").and_then(|text| std::str::from_utf8(text).ok())
    else {
        return false;
    };
    let mut cells = text.split(char::from(by));
    let is_word =
        cells.next().is_some_and(|first| first.starts_with(|c: char| !c.is_whitespace() && c != '#'));
    let numbers = cells.clone().filter(|cell| number(&cell.trim().replace(',', ".")).is_some()).count();
    is_word && numbers > 0 && width == Some(1 + cells.count())
}

/// The number of cells in the next row without `#`, as far as the text goes.
fn width_of_rows(ahead: &[u8], by: u8) -> Option<usize> {
    let rows = ahead.split(|byte| *byte == b'\n').filter(|line| memchr::memchr(b'#', line).is_none());
    let row = rows.map(|line| content(line, by, None)).find(|line| !line.is_empty())?;
    Some(1 + outside_quotes(row).filter(|(_, byte)| *byte == by).count())
}

/// The bytes of a line outside quotes, with their positions.
fn outside_quotes(line: &[u8]) -> impl Iterator<Item = (usize, u8)> {
    let mut inside = false;
    line.iter().copied().enumerate().filter(move |(_, byte)| {
        inside ^= *byte == b'"';
        !inside
    })
}

/// One row, without comment.
#[derive(Debug, Clone, Copy)]
pub struct Row<'a> {
    file: &'a Path,
    line: usize,
    text: &'a str,
    /// The text with its comment.
    whole: &'a str,
    parser: &'a Parser,
    by: u8,
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
    fn ends_beyond(self, width: usize) -> bool {
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

    fn short(&self, cells: usize, columns: usize, missing: &str) -> InputError {
        let found = format!("the end of the row after {cells} of {columns} fields");
        let column = self.text.chars().count() + 1;
        InputError::at(self.file, self.line, column, found, format!("the field {missing}"))
    }

    fn quotes_are_closed(self) -> Result<(), InputError> {
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
    /// Whether the row has a quote.
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
    text: Cow<'a, str>,
}

impl<'a> Cell<'a> {
    /// The cell's text.
    #[inline]
    pub fn text(&self) -> &str {
        &self.text
    }

    /// The cell's row.
    pub fn row(&self) -> Row<'a> {
        self.row
    }

    /// A finding at this cell: it shows the cell's text as what was found.
    pub fn finding(&self, expected: impl Into<String>) -> InputError {
        self.said(shown(&self.text), expected)
    }

    /// A finding at this cell, with the caller's own words for what was found.
    pub fn said(&self, found: impl Into<String>, expected: impl Into<String>) -> InputError {
        self.row.at(self.start, found, expected)
    }

    /// Column of the cell's first character, from 1.
    pub fn column(&self) -> usize {
        self.said("", "").column
    }

    /// The cell's number.
    ///
    /// # Errors
    /// It is not a number.
    #[inline]
    pub fn number<T: std::str::FromStr>(&self, expected: &str) -> Result<T, InputError> {
        self.text.parse().map_err(|_| self.finding(expected))
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

    fn beyond(&self, columns: usize, names: &str) -> InputError {
        let after =
            if names.len() <= 60 { names.to_owned() } else { format!("{columns} fields, one per column") };
        self.finding(format!("the end of the row after {after}"))
    }
}

/// Reads a field that is not a plain decimal, up to its end byte.
/// The result is that of the standard library's parser, or any value if the field is skipped.
#[inline(never)]
fn other_field(text: &[u8], is_end: impl Fn(u8) -> bool, skip: bool) -> Option<(f64, usize)> {
    let length = text.iter().position(|byte| is_end(*byte))?;
    let field = std::str::from_utf8(&text[..length]).ok().filter(|field| field.is_ascii())?;
    if skip {
        return (!field.contains(['"', '#'])).then_some((0.0, length));
    }
    field.parse().ok().filter(|v: &f64| v.is_finite()).map(|v| (v, length))
}

/// The columns' names, from the first row.
#[derive(Debug, Clone)]
pub struct Header {
    file: PathBuf,
    line: usize,
    text: String,
    /// Name of each column, and its place in the line in characters, from 1.
    names: Vec<(String, usize)>,
}

impl Header {
    fn of(row: Row<'_>) -> Self {
        let named = |cell: Cell<'_>| {
            let column = cell.column();
            (cell.text.into_owned(), column)
        };
        let mut names: Vec<(String, usize)> = row.cells().map(named).collect();
        // Trailing separators name no column: spreadsheets write them after removed columns.
        let named = names.iter().rposition(|(name, _)| !name.is_empty()).map_or(1, |last| last + 1);
        names.truncate(named);
        Self { file: row.file.to_owned(), line: row.line, text: row.text.to_owned(), names }
    }

    /// The names, in the file's order.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.names.iter().map(|(name, _)| name.as_str())
    }

    /// The file of this header.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// Line of the file, from 1.
    pub fn line(&self) -> usize {
        self.line
    }

    /// The row as the file has it.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// The names as a message shows them: a limited number, long ones cut.
    pub fn shown(&self) -> String {
        const SHOWN: usize = 40;
        let names = self.names().take(SHOWN).map(cut).collect::<Vec<_>>().join(", ");
        match self.names.len().saturating_sub(SHOWN) {
            0 => names,
            more => format!("{names} and {more} more"),
        }
    }

    /// Numbers the columns from 1, for a first row that holds values.
    fn numbered(&self) -> Self {
        let names = (1..=self.names.len()).map(|n| (n.to_string(), 1)).collect();
        Self { names, ..self.clone() }
    }

    /// Index of a column by its name, or else by its number from 1.
    ///
    /// # Errors
    /// As [`Header::place`].
    pub fn place_or_number(&self, column: &str) -> Result<usize, InputError> {
        match column.parse::<usize>() {
            Ok(number) if self.find(column).is_none() && (1..=self.names.len()).contains(&number) => {
                Ok(number - 1)
            }
            _ => self.place(column),
        }
    }

    /// The columns renamed.
    /// `columns` has pairs of the new name and the column's name or number. Columns in no pair lose their
    /// names.
    ///
    /// # Errors
    /// As [`Header::place`].
    pub(crate) fn renamed(&self, columns: &[(String, String)]) -> Result<Self, InputError> {
        let mut renamed = self.clone();
        renamed.names.iter_mut().for_each(|(name, _)| name.clear());
        for (name, column) in columns {
            let place = self.place_or_number(column)?;
            self.is_in_unit_of(name, place)?;
            if !renamed.names[place].0.is_empty() {
                return Err(self.finding(format!("column {column} a second time"), "every column once"));
            }
            renamed.names[place].0.clone_from(name);
        }
        Ok(renamed)
    }

    /// Checks that a column's name does not contradict the unit that it is read in.
    ///
    /// # Errors
    /// It does; the finding has both units.
    pub fn is_in_unit_of(&self, name: &str, place: usize) -> Result<(), InputError> {
        let column = self.names().nth(place).unwrap_or_default();
        let Some(said) = units::stated(name).map(|s| s.unit) else { return Ok(()) };
        units::contradicted(column, said).map_or(Ok(()), |stated| {
            let found = format!("the column {column} as {name}: its name says {stated}");
            Err(self
                .finding(found, format!("a column in {said}, or its values in {said} under another name")))
        })
    }

    /// A finding if the first row has values in place of names.
    /// More of its cells are numbers than are not.
    pub fn is_missing(&self) -> Option<InputError> {
        let is_number = |text: &str| text.trim().replace(',', ".").parse::<f64>().is_ok();
        // The separator may be any: a table without commas may lack its names, too.
        let by = [';', '\t', '|'].into_iter().find(|by| self.text.contains(*by));
        let cells: Vec<&str> = match by {
            Some(by) => self.text.split(by).collect(),
            None => self.names().collect(),
        };
        let numbers = cells.iter().filter(|c| is_number(c)).count();
        (2 * numbers > cells.len()).then(|| {
            let found = format!("numbers ({}) in the first line", quoted(&self.text));
            self.finding(found, "the columns' names there: the line that names them is missing")
        })
    }

    /// The index of a column that must occur once.
    ///
    /// # Errors
    /// It is missing, or occurs twice.
    pub fn place(&self, name: &str) -> Result<usize, InputError> {
        let mut found = self.names.iter().enumerate().filter(|(_, (n, _))| n == name);
        match (found.next(), found.next()) {
            (Some((place, _)), None) => Ok(place),
            (Some(_), Some((again, _))) => Err(self.twice(again)),
            (None, _) => {
                if let Some(missing) = self.is_missing() {
                    return Err(missing);
                }
                let names: Vec<&str> = self.names().collect();
                let near = nearest(name, &names).map_or_else(String::new, |n| format!("; did you mean {n}?"));
                let near = self.blanks_part([name]).map_or(near, str::to_owned);
                let found = format!("no column {name}");
                Err(self.finding(found, format!("a column {name} among {}{near}", self.shown())))
            }
        }
    }

    /// Finds that only blanks separate the columns.
    /// One of these names must then occur as a word.
    fn blanks_part<'n>(&self, names: impl IntoIterator<Item = &'n str>) -> Option<&'static str> {
        // A column given by its number is one of at least that many words.
        let count = self.text.split_ascii_whitespace().count();
        let is_of = |name: &str, word: &str| {
            word == name || name.parse::<usize>().is_ok_and(|number| (2..=count).contains(&number))
        };
        let mut words = names
            .into_iter()
            .flat_map(|name| self.text.split_ascii_whitespace().map(move |word| is_of(name, word)));
        (self.names.len() == 1 && self.text.contains(' ') && words.any(|is_one| is_one)).then_some(
            ", parted by commas, semicolons, tabs or |: blanks part these; write one of those in their place, or read the table by \
             `characterise import --format own`, whose form has separator = \"blank\"",
        )
    }

    /// Adds the column's name to a finding at a cell.
    pub fn named(&self, place: usize, finding: InputError) -> InputError {
        let name = self.names.get(place).map_or("", |(name, _)| name);
        InputError { found: format!("{} in column {name}", finding.found), ..finding }
    }

    /// The index of the column of this name, if there is one.
    pub fn find(&self, name: &str) -> Option<usize> {
        self.names().position(|n| n == name)
    }

    /// The columns that are known, or match `also`, and the names of the others.
    ///
    /// # Errors
    /// A column that occurs twice, a name nearly equal to a missing one, or another kind of table.
    pub(crate) fn known(
        &self,
        known: &[&str],
        also: fn(&str) -> bool,
    ) -> Result<(Self, Vec<String>), InputError> {
        let is_known = |name: &str| known.contains(&name) || also(name);
        let missing: Vec<&str> = known.iter().copied().filter(|k| self.find(k).is_none()).collect();
        let is_slip = |name: &str| nearest(name, &missing).is_some();
        // A single name may also occur in another kind of table.
        let is_one_of_these = known.len() - missing.len() >= known.len().min(2);
        let (mut kept, mut unrelated) = (self.clone(), Vec::new());
        for (name, _) in &mut kept.names {
            if is_one_of_these && !is_known(name) && !is_slip(name) {
                unrelated.push(std::mem::take(name));
            }
        }
        unrelated.retain(|name| !name.is_empty());
        kept.only(known, |name| name.is_empty() || also(name))?;
        Ok((kept, unrelated))
    }

    /// Checks that every column is known and occurs once.
    ///
    /// # Errors
    /// The first that is not or does not.
    fn only(&self, known: &[&str], also: impl Fn(&str) -> bool) -> Result<(), InputError> {
        for (n, (name, column)) in self.names.iter().enumerate() {
            if !known.contains(&name.as_str()) && !also(name) {
                let near = nearest(name, known).map_or_else(String::new, |k| format!("; did you mean {k}?"));
                let near = self.blanks_part(known.iter().copied()).map_or(near, str::to_owned);
                let expected = format!("one of the columns {}{near}", known.join(", "));
                let found = format!("column {}", quoted(name));
                return Err(InputError::at(&self.file, self.line, *column, found, expected));
            }
            if !name.is_empty() && self.find(name) != Some(n) {
                return Err(self.twice(n));
            }
        }
        Ok(())
    }

    /// The finding that a column's name occurs a second time.
    pub fn twice(&self, place: usize) -> InputError {
        let (name, column) = &self.names[place];
        let found = format!("column {} a second time", quoted(name));
        InputError::at(&self.file, self.line, *column, found, "every column once")
    }

    /// A finding about the header.
    pub fn finding(&self, found: impl Into<String>, expected: impl Into<String>) -> InputError {
        InputError::at(&self.file, self.line, 1, found, expected)
    }

    /// The finding that the file ends where rows should begin.
    pub fn no_rows(&self) -> InputError {
        InputError::at(&self.file, self.line + 1, 0, "no rows", "at least one row of values")
    }

    /// Passes each cell of a row, with its column's index, to `take`.
    ///
    /// # Errors
    /// The first error of `take`; then that the row is too short or too long.
    #[inline]
    pub fn each<'a>(
        &self,
        row: Row<'a>,
        mut take: impl FnMut(usize, Cell<'a>) -> Result<(), InputError>,
    ) -> Result<(), InputError> {
        let mut columns = 0;
        for cell in row.cells() {
            if columns == self.names.len() {
                if cell.text().is_empty() {
                    continue;
                }
                return Err(cell.beyond(columns, &self.text));
            }
            take(columns, cell)?;
            columns += 1;
        }
        match self.names.get(columns) {
            Some((missing, _)) => Err(row.short(columns, self.names.len(), missing)),
            None => Ok(()),
        }
    }

    /// The cells of a row, as many as there are columns.
    ///
    /// # Errors
    /// The row is too short or too long.
    pub fn cells<'a>(&self, row: Row<'a>) -> Result<Vec<Cell<'a>>, InputError> {
        let mut cells = Vec::with_capacity(self.names.len());
        self.each(row, |_, cell| {
            cells.push(cell);
            Ok(())
        })?;
        Ok(cells)
    }
}

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
pub struct Style {
    /// The separator.
    pub by: char,
    /// Whether numbers have a decimal comma.
    pub decimal_comma: bool,
}

impl Default for Style {
    fn default() -> Self {
        Self { by: ',', decimal_comma: false }
    }
}

impl Style {
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

#[cfg(test)]
mod tests {
    use super::*;

    /// The fast path and the cells give the same numbers, whatever the rows hold.
    #[test]
    fn a_plain_row_is_what_its_cells_say() {
        use proptest::prelude::*;
        use proptest::strategy::ValueTree;
        let cell = prop_oneof![
            8 => (-200_000..200_000_i32, 0..9_usize).prop_map(|(n, d)| format!("{:.d$}", f64::from(n) / 64.0)),
            2 => any::<f64>().prop_map(|v| v.to_string()),
            1 => "[-+0-9.eE \",#;\r\n\u{b5}]{0,18}",
            1 => "[0-9]{0,20}[.]?[0-9]{0,20}",
        ];
        let end = prop::sample::select(vec!["\n", "\n", "\r\n", " \n", ",\n", "# c\n", ""]);
        let rows = prop::collection::vec((prop::collection::vec(cell, 3), end), 1..6);
        let mut runner = proptest::test_runner::TestRunner::deterministic();
        let (mut short, mut all) = (0, 0);
        for _ in 0..4000 {
            let tree = rows.new_tree(&mut runner).unwrap().current();
            let text: String = tree.iter().map(|(cells, end)| cells.join(",") + end).collect();
            let [mut quick, mut slow] = [(); 2].map(|()| reader(&text));
            loop {
                let mut numbers = [0.0; 3];
                let plain = quick.plain_row(&mut numbers, |place| place == 1);
                let mine = plain
                    .map(|row| (String::from_utf8(quick.take(row).to_owned()).unwrap(), quick.lines.line));
                let mine = match mine {
                    Some(mine) => mine,
                    None => match quick.row() {
                        Ok(Some(row)) => (row.text().to_owned(), row.line()),
                        _ => break,
                    },
                };
                let row = slow.row().unwrap().unwrap();
                all += 1;
                assert_eq!(mine, (row.text().to_owned(), row.line()), "{text:?}");
                if plain.is_some() {
                    short += 1;
                    let cells: Vec<Cell<'_>> = row.cells().collect();
                    assert_eq!(cells.len(), 3, "{text:?}");
                    for n in [0, 2] {
                        let said: f64 = cells[n].text().parse().unwrap();
                        assert_eq!(numbers[n].to_bits(), said.to_bits(), "{text:?}");
                    }
                }
            }
        }
        assert!(short > 2000 && all > short + 2000, "{short} of {all} rows");
    }

    #[test]
    fn a_column_is_found_by_its_quoted_name() {
        let mut reader = reader("t, \"T3, bed\" # degC\n0,20.5\n");
        let header = reader.header("t and a temperature").unwrap();
        let at = header.place("T3, bed").unwrap();
        let row = reader.row().unwrap().unwrap();
        assert_eq!(header.cells(row).unwrap()[at].finite().unwrap().to_string(), "20.5");
    }

    fn reader(text: &str) -> Reader<&[u8]> {
        Reader::new(Path::new("a.csv"), text.as_bytes()).unwrap()
    }

    fn rows(text: &str) -> Result<Vec<Vec<String>>, InputError> {
        let (mut reader, mut rows) = (reader(text), Vec::new());
        while let Some(row) = reader.row()? {
            rows.push(row.cells().map(|c| c.text().to_owned()).collect());
        }
        Ok(rows)
    }

    #[test]
    fn mark_line_ends_comments_and_blanks_are_no_matter() {
        let text =
            "\u{feff}# bench 3\r\n\r\nt, y # s, mm\r\n 1 ,\t2# up\r\n   # none\r\n,\r\n\"#1\", 2 # \"last\"";
        assert_eq!(rows(text).unwrap(), [["t", "y"], ["1", "2"], ["#1", "2"]]);
        assert!(rows("").unwrap().is_empty());
    }

    #[test]
    fn quotes_hold_commas_quotes_comments_and_blanks() {
        let text = "t, \"T3, bed\" ,\"5\"\" pipe\",\" # \",5\" bar,\n\"a\"";
        let expected = [vec!["t", "T3, bed", "5\" pipe", " # ", "5\" bar", ""], vec!["a"]];
        assert_eq!(rows(text).unwrap(), expected);
        let error = rows("t,e\nµ, \"1,2\n3,4\n").unwrap_err();
        let says =
            "a.csv:2:4: found a quote that is not closed: '\"1,2', expected a second quote on the same line";
        assert_eq!(error.to_string(), says);
    }

    #[test]
    fn lines_that_end_in_cr_alone_are_said_and_not_quoted() {
        let says = "a.csv:1: found lines that end in CR alone, expected lines that end in LF or CRLF, \
                    as `tr '\\r' '\\n' < FILE > NEW` writes them";
        for text in ["t,e\r0,1\r1,2\r".to_owned(), "t,e\r".to_owned() + &"0,1\r".repeat(50_000)] {
            assert_eq!(reader(&text).header("t and e").unwrap_err().to_string(), says);
        }
        assert_eq!(rows("t,e\r\r\n0,1\r\n").unwrap(), [["t", "e"], ["0", "1"]]);
    }

    #[test]
    fn reads_utf_16_with_and_without_its_mark() {
        let little: Vec<u8> = "\u{feff}t,µ\r\n0,1\n".encode_utf16().flat_map(u16::to_le_bytes).collect();
        let big: Vec<u8> = "\u{feff}t,µ\n0,1".encode_utf16().flat_map(u16::to_be_bytes).collect();
        for text in [&little[..], &little[2..], &big, &big[2..]] {
            let mut reader = Reader::new(Path::new("a.csv"), text).unwrap();
            let header = reader.header("t and µ").unwrap();
            assert_eq!(header.names().collect::<Vec<_>>(), ["t", "µ"]);
            assert_eq!(reader.row().unwrap().unwrap().text(), "0,1");
            assert!(reader.row().unwrap().is_none() && reader.is_utf16());
        }
    }

    #[test]
    fn a_hash_within_a_cell_is_no_comment() {
        for (text, wants) in [
            ("Sample #,t\n", &["Sample #", "t"][..]),
            ("1,#N/A,2 # note\n", &["1", "#N/A", "2"]),
            ("#N/A,1\n", &["#N/A", "1"]),
            ("1,#DIV/0!\n", &["1", "#DIV/0!"]),
            ("1,2 #note, and more\n", &["1", "2"]),
            ("1,2#\n", &["1", "2"]),
        ] {
            assert_eq!(rows(text).unwrap(), [wants], "{text}");
        }
        assert!(rows("#,a,b\n# N/A\n").unwrap().is_empty());
    }

    #[test]
    fn a_hash_begins_a_comment_behind_a_whole_row_only() {
        for (text, header, row) in [
            ("n;t;e\nNo#1;2;3\n", &["n", "t", "e"][..], &["No#1", "2", "3"][..]),
            ("n;t;e\nNo #1;2;3 # good\n", &["n", "t", "e"], &["No #1", "2", "3"]),
            ("t;e;n\n1;2;#3\n", &["t", "e", "n"], &["1", "2", "#3"]),
            ("e # um;t # s\n1;2\n", &["e # um", "t"], &["1", "2"]),
            ("t,y # s, mm\n1,2\n", &["t", "y"], &["1", "2"]),
            ("e # um,t\n# 1,2\n1,2# up\n3,4\n", &["e # um", "t"], &["1", "2"]),
            ("n|t\nNo # 1|2\n", &["n", "t"], &["No # 1", "2"]),
        ] {
            let mut reader = reader(text);
            let found = reader.header_with("names", &[]).unwrap();
            assert_eq!(found.names().collect::<Vec<_>>(), header, "{text}");
            let cells = found.cells(reader.row().unwrap().unwrap()).unwrap();
            assert_eq!(cells.iter().map(Cell::text).collect::<Vec<_>>(), row, "{text}");
        }
        let mut named = reader("t;e # um\n1;2\n");
        assert_eq!(named.header_with("names", &["e # um"]).unwrap().find("e # um"), Some(1));
    }

    #[test]
    fn rows_that_begin_with_a_hash_are_counted() {
        let mut reader = reader("n;e\n#1;2,5\n# 2;2,5\n#3;2,5\n## 4;5\n#5;a\n6;1\n");
        reader.header_with("names", &[]).unwrap();
        assert_eq!(reader.row().unwrap().unwrap().text(), "6;1");
        assert_eq!(reader.commented(), Some(Commented { line: 2, lines: 2 }));
    }

    #[test]
    fn rows_of_separators_alone_are_empty() {
        for text in ["t,e,,\n1,2,,\n,,,\n\n, , ,\n", "\n;;;\nt;e;;\n1;2;;\n;;;\n"] {
            let mut reader = reader(text);
            let header = reader.header_with("names", &[]).unwrap();
            assert_eq!(header.names().count(), 2);
            assert_eq!(header.cells(reader.row().unwrap().unwrap()).unwrap()[1].text(), "2");
            assert!(reader.row().unwrap().is_none(), "{text}");
        }
    }

    #[test]
    fn windows_1252_is_read_and_never_mixed_with_utf_8() {
        let mut western =
            Reader::new(Path::new("a.csv"), b"t,T (\xb0C)\n1,2\n# \xb5\n3,4 # \xb5m\n".as_slice()).unwrap();
        let header = western.header_with("names", &["T (°C)"]).unwrap();
        assert_eq!(header.names().last(), Some("T (°C)"));
        assert_eq!(western.row().unwrap().unwrap().text(), "1,2");
        assert_eq!(western.row().unwrap().unwrap().text(), "3,4");
        assert!(western.is_western() && western.row().unwrap().is_none());
        for mixed in [b"t,\xb0\n1,\xc2\xb0\n".as_slice(), b"t,\xc2\xb0\n1,\xb0\n"] {
            let mut reader = Reader::new(Path::new("a.csv"), mixed).unwrap();
            reader.header_with("names", &[]).unwrap();
            assert_eq!(reader.row().unwrap_err().line, 2);
        }
        assert!(!rows("µ\n").unwrap().is_empty());
    }

    #[test]
    fn a_first_line_of_numbers_is_no_header() {
        let numbers = (0..25).map(|n| format!("{n}.125")).collect::<Vec<_>>().join(",");
        let says = "a.csv:1:1: found numbers ('0.125,1.125,2.125,3.125,4.125,5.125,6.125,7.125,8.125,9.125,…') in \
                    the first line, expected the columns' names there: the line that names them is missing";
        assert_eq!(reader(&numbers).header("t").unwrap().place("t").unwrap_err().to_string(), says);
        for (text, missing) in
            [("0;1,5;20", true), ("T1,T2,20", false), ("2026-05-01,1,2", true), ("t,1", false)]
        {
            assert_eq!(reader(text).header("t").unwrap().is_missing().is_some(), missing, "{text}");
        }
        let many = (0..100).map(|n| format!("T{n}")).collect::<Vec<_>>().join(",");
        let error = reader(&many).header("t").unwrap().place("e").unwrap_err().to_string();
        assert!(error.contains(", T39 and 60 more") && error.len() < 400, "{error}");
    }

    #[test]
    fn a_byte_that_is_no_utf8_has_its_place() {
        let mut reader = Reader::new(Path::new("a.csv"), b"t,\xc2\xb5,\xb5\n".as_slice()).unwrap();
        let error = reader.row().unwrap_err().to_string();
        assert_eq!(error, "a.csv:1:5: found byte 0xb5, expected text in UTF-8");
    }

    #[test]
    fn short_and_long_rows_and_wrong_numbers_have_their_place() {
        let read = |row: &str| {
            let text = format!("t,\"e, z\"\n{row}\n");
            let mut reader = reader(&text);
            let header = reader.header("t and e")?;
            let row = reader.row()?.expect("a row");
            let numbers = header.cells(row)?.iter().map(Cell::finite).collect::<Result<Vec<_>, _>>()?;
            Ok::<_, InputError>(numbers)
        };
        assert_eq!(read(" 1 ,\"2.5\"").unwrap(), [1.0, 2.5]);
        assert_eq!(read("1,2.5,, ,").unwrap(), [1.0, 2.5]);
        for (row, says) in [
            ("1", "a.csv:2:2: found the end of the row after 1 of 2 fields, expected the field e, z"),
            ("1,2, 3", "a.csv:2:6: found '3', expected the end of the row after t,\"e, z\""),
            ("1,2,,3", "a.csv:2:6: found '3', expected the end of the row after t,\"e, z\""),
            ("µ,2", "a.csv:2:1: found 'µ', expected a finite number"),
            ("1, ", "a.csv:2:3: found nothing, expected a finite number"),
            ("1,  inf", "a.csv:2:5: found 'inf', expected a finite number"),
            ("1,NaN", "a.csv:2:3: found 'NaN', expected a finite number"),
            ("\"µ,\",2;5", "a.csv:2:1: found 'µ,', expected a finite number"),
            ("\"1\",2;5", "a.csv:2:5: found '2;5', expected a finite number"),
        ] {
            assert_eq!(read(row).unwrap_err().to_string(), says, "{row}");
        }
    }

    #[test]
    fn columns_are_found_by_name_and_the_nearest_is_said() {
        let header = |text: &str| reader(text).header("names").unwrap();
        let h = header("t_s, temperature_3, e");
        assert_eq!((h.place("e").unwrap(), h.find("x"), h.line()), (2, None, 1));
        let says = "a.csv:1:1: found no column temprature_3, expected a column temprature_3 among t_s, \
                    temperature_3, e; did you mean temperature_3?";
        assert_eq!(h.place("temprature_3").unwrap_err().to_string(), says);
        let twice = header("t, e,e").place("e").unwrap_err().to_string();
        assert_eq!(twice, "a.csv:1:6: found column 'e' a second time, expected every column once");
        let says =
            "a.csv:1:3: found column 'zmm', expected one of the columns z_mm, x_mm; did you mean z_mm?";
        assert_eq!(header("# c\nx_mm,z_mm").only(&["z_mm", "x_mm"], |_| false), Ok(()));
        assert_eq!(header("a,zmm").only(&["z_mm", "x_mm"], |n| n == "a").unwrap_err().to_string(), says);
        let none = reader("# nothing\n").header("names").unwrap_err().to_string();
        assert!(none.starts_with("a.csv: found no header: every line is empty or a comment"), "{none}");
    }

    #[test]
    fn the_header_says_what_parts_the_cells() {
        for (text, by) in [("a;\"b;c\"\n1,5;2\n", ';'), ("a\tb,c\n1\t2\n", '\t'), ("a,\"b;c\"\n1,2\n", ',')] {
            let mut reader = reader(text);
            let header = reader.header_with("names", &[]).unwrap();
            assert_eq!((reader.separator(), header.names().count()), (by, 2), "{text}");
            assert_eq!(header.cells(reader.row().unwrap().unwrap()).unwrap().len(), 2);
        }
    }

    #[test]
    fn whoever_reads_on_after_a_finding_comes_to_the_end() {
        let text = format!("t,e\n{}\n\"1,2\n3,4\n", "\0".repeat(300_000));
        let (mut reader, mut found, mut read) = (reader(&text), 0, 0);
        loop {
            match reader.row() {
                Ok(Some(_)) => read += 1,
                Ok(None) => break,
                Err(_) => found += 1,
            }
        }
        // Two lines are too long and one quote is not closed. The header, the long line's end and the last
        // row are read.
        assert_eq!((found, read), (3, 3));
    }

    #[test]
    fn what_is_written_reads_back() {
        let names = ["t", "T3, bed", "5\" pipe", "#1", " x ", "a;b", "µ", ""];
        let line = header_line(names);
        assert_eq!(rows(&line).unwrap(), [names]);
        // A name that could be taken for a blank line, or for the file's byte-order mark.
        for name in ["", "\u{feff}t"] {
            assert_eq!(rows(&header_line([name])).unwrap(), [[name]]);
        }
    }
}
