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

mod comments;
mod header;
mod row;
mod writing;

pub use header::Header;
pub use row::{Cell, Cells, Row};
pub use writing::{CsvStyle, cell, header_line};

use crate::decimal_parser::decimal;
use crate::file_kind::FileKind;
use crate::input_error::InputError;
use crate::line_reader::LineReader;
use crate::message_text::quoted;
use crate::text_file::{UTF8, WESTERN, is_western, not_utf8, opened, western};
use comments::{
    content, is_cell_separator, is_foreign_comment, looks_like_a_row, outside_quotes, width_of_rows,
};
use std::cell::RefCell;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Reads a CSV row by row; memory stays flat for a file of any length.
#[derive(Debug)]
pub struct Reader<R> {
    pub(crate) lines: LineReader<R>,
    parser: Parser,
    by: u8,
    /// Cells per row, once the header is read.
    width: Option<usize>,
    encoding: Encoding,
    /// The present line, decoded, if it is not UTF-8.
    decoded: String,
    pub(crate) oddities: Oddities,
}

/// Oddities of a table so far, which a note reports.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Oddities {
    pub(crate) commented: Option<RowsCommentedOut>,
    /// Rows that end with extra separators after the last named column, and others.
    pub(crate) beyond: TrailingSeparators,
    /// Number of another program's lines before the columns' names.
    pub(crate) preamble: usize,
}

/// Rows that end with more separators than their header, and rows that do not.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct TrailingSeparators {
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
pub(crate) struct RowsCommentedOut {
    /// The first such line, from 1.
    pub(crate) line: usize,
    /// The number of such lines.
    pub(crate) lines: usize,
}

/// A row that [`Reader::plain_row`] has found.
/// Lengths of its text, and of its line with the end, bytes.
#[derive(Debug, Clone, Copy)]
pub struct FastPathRow {
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
            lines: LineReader::new(file, input)?,
            parser: parser(b','),
            by: b',',
            width: None,
            encoding: Encoding::Ascii,
            decoded: String::new(),
            oddities: Oddities::default(),
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
                let first = RowsCommentedOut { line: self.lines.line, lines: 0 };
                self.oddities.commented.get_or_insert(first).lines += 1;
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
            let beyond = &mut self.oddities.beyond;
            if row.ends_beyond(width) {
                beyond.rows += 1;
                beyond.line = if beyond.rows == 1 { row.line } else { beyond.line };
            } else {
                beyond.others += 1;
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
    pub fn plain_row(&self, row: &mut [f64], skip: impl Fn(usize) -> bool) -> Option<FastPathRow> {
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
            [b'\n', ..] => Some(FastPathRow { text: at - 1, line: at }),
            [b'\r', b'\n', ..] => Some(FastPathRow { text: at - 1, line: at + 1 }),
            _ => None,
        }
    }

    /// Consumes the row that [`Reader::plain_row`] has just found.
    /// Returns its text, which is ASCII.
    #[inline]
    pub fn take(&mut self, row: FastPathRow) -> &[u8] {
        self.oddities.beyond.others += 1;
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
            self.oddities.preamble = first.line - before;
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
        let is_parted = outside_quotes(first.text.as_bytes()).any(|(_, byte)| is_cell_separator(byte, b','));
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

    /// Reads the row of names, which must contain these; further names are ignored.
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
        let RowsCommentedOut { line, lines } = self.oddities.commented?;
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

    /// The encoding so far, if it is not UTF-8.
    pub(crate) fn other_encoding(&self) -> Option<&'static str> {
        let western = (self.encoding == Encoding::Western).then_some(WESTERN);
        if self.lines.is_utf16() { Some("UTF-16") } else { western }
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

/// Number of lines that are searched for the columns' names.
const PREAMBLE: usize = 100;

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
            assert!(reader.row().unwrap().is_none() && reader.lines.is_utf16());
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
        assert_eq!(reader.oddities.commented, Some(RowsCommentedOut { line: 2, lines: 2 }));
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
        assert!(western.other_encoding() == Some(WESTERN) && western.row().unwrap().is_none());
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
        assert_eq!((h.place("e").unwrap(), h.find("x")), (2, None));
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
