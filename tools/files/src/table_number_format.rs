//! The number format of a table.
//! It has a decimal point or comma, and thousands separators or none.
//!
//! A cell shows its decimal mark in three cases. It has both marks (`1.000,5`), one mark several times
//! (`1.000.000`), or one that cannot separate thousands (`38,1125`, `0,125`). One mark before three digits
//! (`1.000`, `38,125`) does not show it; then the other cells of the column decide.

use crate::csv::{CsvStyle, Oddities, Reader, RowsCommentedOut, TrailingSeparators};
use crate::decimal_parser::{SIGNS, number};
use crate::input_error::InputError;
use crate::text_file::unreadable;
use std::borrow::Cow;
use std::io::{Read, Seek};
use std::path::Path;

/// Thousands separators of some countries, besides point and comma.
const BLANKS: [char; 6] = [' ', '\u{a0}', '\u{2009}', '\u{202f}', '\'', '\u{2019}'];

/// The decimal marks that a table's cells show.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DecimalMarks {
    /// The mark that this column's cells show.
    column: Option<char>,
    /// The mark that any cell of the table shows.
    table: Option<char>,
    /// Whether commas separate the cells.
    /// A comma within a cell is then no decimal mark unless a cell shows that it is.
    commas_part: bool,
    /// Whether thousands separators are known to be used.
    /// A cell of the table shows them, or the user has given the decimal mark.
    is_grouped: bool,
}

impl DecimalMarks {
    /// The format of a column of these cells.
    /// `table` is what [`DecimalMarks::mark_of`] finds among all cells, `by` the separator of cells.
    pub fn of<'t>(column: impl IntoIterator<Item = &'t str> + Clone, table: Option<char>, by: char) -> Self {
        let is_grouped = column.clone().into_iter().any(shows_thousands);
        Self { is_grouped, ..Self::shown(Self::mark_of(column), table, by) }
    }

    /// The format of a column from its own mark, if any, and the table's, if any.
    pub fn shown(column: Option<char>, table: Option<char>, by: char) -> Self {
        Self { column, table, commas_part: by == ',', is_grouped: false }
    }

    /// The format of a column whose decimal mark the user has given.
    pub fn written(mark: char) -> Self {
        Self { column: Some(mark), table: Some(mark), commas_part: false, is_grouped: true }
    }

    /// The decimal mark of the first cell that shows one.
    pub fn mark_of<'t>(cells: impl IntoIterator<Item = &'t str>) -> Option<char> {
        cells.into_iter().find_map(shown_mark)
    }

    /// The finite number in a cell. `None` if there is none, or if it has two readings.
    pub fn parse(self, text: &str) -> Option<f64> {
        number(&self.plain(text)?)
    }

    /// A cell's number with a decimal point and without thousands separators.
    /// `None` if it has two readings.
    pub fn plain(self, text: &str) -> Option<Cow<'_, str>> {
        if !text.contains(['.', ',']) && !text.contains(BLANKS) {
            return Some(Cow::Borrowed(text));
        }
        let default = if text.contains(',') {
            // A lone comma before three digits.
            match self.table {
                Some(mark) => Some(mark).filter(|mark| *mark == ','),
                None => Some(',').filter(|_| !self.commas_part),
            }
        } else if text.contains('.') && self.table == Some(',') {
            None
        } else {
            Some('.')
        };
        let mark = self.column.or_else(|| shown_mark(text)).or(default)?;
        // 12.345 beside 12,4: thousands, or another decimal mark.
        let is_other = has_two_readings(text) && !text.contains(mark);
        ungrouped(text, mark).filter(|_| self.is_grouped || !is_other).map(Cow::Owned)
    }

    /// Whether a cell's mark may be a decimal mark or separate thousands.
    /// No other cell decides it.
    pub fn leaves_open(self, text: &str) -> bool {
        self.column.is_none() && self.table.is_none() && has_two_readings(text)
    }

    /// What to write instead of a cell that is no number or has two readings.
    pub fn expected(self, text: &str) -> &'static str {
        if number_body(text).is_none() {
            return "a finite number";
        }
        let other = if self.column == Some(',') { '.' } else { ',' };
        match self.column.or(self.table) {
            Some(',') if text.contains('.') => {
                "a decimal comma, as the numbers beside it: a dot beside decimal commas may part thousands"
            }
            Some('.') if text.contains(other) => {
                "a decimal point, as the numbers beside it: a comma beside decimal points may part thousands"
            }
            None if text.contains(',') => {
                "a finite number with a decimal point: the comma may part thousands or be the decimal mark"
            }
            _ => "a finite number",
        }
    }
}

/// The format of a table: its separator, and the decimal mark of each column.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct TableNumberFormat {
    columns: Vec<Option<char>>,
    table: Option<char>,
    by: char,
    /// UTF-16 or Windows-1252.
    encoding: Option<&'static str>,
    /// The first cell with two readings.
    open: Option<String>,
    /// Whether a cell shows that a mark separates thousands.
    is_grouped: bool,
    oddities: Oddities,
}

impl TableNumberFormat {
    /// The format of a table before its first row.
    pub fn new<R: Read>(reader: &Reader<R>) -> Self {
        let mut marks = Self { by: reader.separator(), ..Self::default() };
        marks.read_so_far(reader);
        marks
    }

    /// Copies the reader's findings about encoding and rows.
    pub fn read_so_far<R: Read>(&mut self, reader: &Reader<R>) {
        self.encoding = reader.other_encoding();
        self.oddities = reader.oddities;
    }

    /// Adds a cell of a row; `place` is its column's index, from 0.
    pub fn see(&mut self, place: usize, text: &str) {
        let Some(mark) = shown_mark(text) else {
            if self.open.is_none() && has_two_readings(text) {
                self.open = Some(text.to_owned());
            }
            return;
        };
        self.table.get_or_insert(mark);
        self.is_grouped |= shows_thousands(text);
        if self.columns.len() <= place {
            self.columns.resize(place + 1, None);
        }
        self.columns[place].get_or_insert(mark);
    }

    /// The format of the rows that follow in a reader.
    ///
    /// # Errors
    /// As [`Reader::row`].
    pub fn of<R: Read>(reader: &mut Reader<R>) -> Result<Self, InputError> {
        let mut marks = Self::new(reader);
        marks.see_rows(reader)?;
        Ok(marks)
    }

    fn see_rows<R: Read>(&mut self, reader: &mut Reader<R>) -> Result<(), InputError> {
        let seen = loop {
            match reader.row() {
                Ok(Some(row)) => {
                    for (place, cell) in row.cells().enumerate() {
                        self.see(place, cell.text());
                    }
                }
                Ok(None) => break Ok(()),
                Err(e) => break Err(e),
            }
        };
        self.read_so_far(reader);
        seen
    }

    /// Finds the format of a table; afterwards the input is at its beginning again.
    /// `None` for a plain table: cells separated by commas, no quotes, UTF-8. Its numbers can only have a
    /// decimal point.
    ///
    /// # Errors
    /// There is no header; a row is not text; the input cannot be read.
    pub fn find<R: Read + Seek>(
        file: &Path,
        input: &mut R,
        columns: &[&str],
    ) -> Result<Option<Self>, InputError> {
        let rewind = |input: &mut R| input.rewind().map_err(|e| unreadable(file, &e));
        let mut reader = Reader::new(file, &mut *input)?;
        reader.header_of("a header line", columns)?;
        let plain = reader.separator() == ',' && reader.other_encoding().is_none();
        rewind(input)?;
        let plain = plain && is_plain(input).map_err(|e| unreadable(file, &e))?;
        rewind(input)?;
        if plain {
            return Ok(None);
        }
        let mut reader = Reader::new(file, &mut *input)?;
        reader.header_of("a header line", columns)?;
        let mut marks = Self::new(&reader);
        // A wrong row is reported when it is read, after the rows before it.
        let _ = marks.see_rows(&mut reader);
        rewind(input)?;
        Ok(Some(marks))
    }

    /// The number format of a column; `place` is the column's index, from 0.
    pub fn numbers(&self, place: usize) -> DecimalMarks {
        let shown = DecimalMarks::shown(self.columns.get(place).copied().flatten(), self.table, self.by);
        DecimalMarks { is_grouped: self.is_grouped, ..shown }
    }

    /// The style for further columns of the same table.
    pub fn style(&self) -> CsvStyle {
        CsvStyle { by: self.by, decimal_comma: self.table == Some(',') }
    }

    /// How the file's format differs from the documented one.
    /// It may be UTF-16, have another separator or decimal commas, or cells with two readings.
    pub fn written(&self, file: &Path) -> Option<String> {
        let by = match self.by {
            ',' => None,
            ';' => Some("columns parted by semicolons"),
            '\t' => Some("columns parted by tabs"),
            _ => Some("columns parted by |"),
        };
        let comma = (self.table == Some(',')).then_some("decimal commas");
        let parts: Vec<&str> = [self.encoding, by, comma].into_iter().flatten().collect();
        let read = (!parts.is_empty()).then(|| format!("read as {}", parts.join(", ")));
        self.format_note(file, read)
    }

    /// The cells of the file with two readings, in words.
    pub fn questions(&self, file: &Path) -> Option<String> {
        self.format_note(file, None)
    }

    fn format_note(&self, file: &Path, read: Option<String>) -> Option<String> {
        let preamble = self.oddities.preamble;
        let lines = if preamble == 1 { "1 line".to_owned() } else { format!("{preamble} lines") };
        let passed_over =
            (preamble > 0).then(|| format!("passed over {lines} in front of the columns' names"));
        let said = [read, passed_over, self.two_readings(), self.rows_commented(), self.separators()];
        let said: Vec<String> = said.into_iter().flatten().collect();
        (!said.is_empty()).then(|| format!("{}: {}", file.display(), said.join("; ")))
    }

    /// A cell whose mark may be a decimal mark or separate thousands.
    /// No other cell of the table decides it.
    fn two_readings(&self) -> Option<String> {
        let text = self.open.as_ref().filter(|_| self.table.is_none() && self.by != ',')?;
        let (mark, name) = if text.contains(',') { (',', "comma") } else { ('.', "point") };
        let other = if mark == ',' { "point" } else { "comma" };
        let (fraction, thousands) = (ungrouped(text, mark)?, text.replace(mark, ""));
        Some(format!(
            "{text} was read as {fraction}, with a decimal {name}; it may be {thousands}, as no cell shows the decimal mark: if so, \
             write it without the {name}, or one cell with a decimal {other}"
        ))
    }

    /// Reports extra separators at the end of rows.
    /// If every row has them, they are a program's habit. If only some have them, a cell may be missing.
    fn separators(&self) -> Option<String> {
        let TrailingSeparators { line, rows, others } = self.oddities.beyond;
        let end = if rows == 1 { "row ends" } else { "rows end" };
        (rows > 0 && others > 0).then(|| {
            format!(
                "{rows} {end} with a separator behind the last column (line {line} first), {others} do not: is a cell missing there?"
            )
        })
    }

    fn rows_commented(&self) -> Option<String> {
        let RowsCommentedOut { line, lines } = self.oddities.commented?;
        let (are, they) = if lines == 1 { ("line begins", "it is") } else { ("lines begin", "they are") };
        Some(format!(
            "{lines} {are} with # and a row's cells (line {line} first): a comment; put the first cell in quotes if {they} a row"
        ))
    }
}

/// Whether the input has neither quotes nor letters of Windows-1252.
fn is_plain(input: &mut impl Read) -> std::io::Result<bool> {
    let mut buffer = vec![0; 1 << 16];
    let mut kept = 0;
    loop {
        match input.read(&mut buffer[kept..]) {
            Ok(0) => return Ok(kept == 0),
            Ok(n) => {
                let text = &buffer[..kept + n];
                if memchr::memchr(b'"', text).is_some() {
                    return Ok(false);
                }
                // The buffer's end may cut a letter.
                let good = encoding_rs::Encoding::utf8_valid_up_to(text);
                if text.len() - good > 3 {
                    return Ok(false);
                }
                let end = text.len();
                buffer.copy_within(good..end, 0);
                kept = end - good;
            }
            Err(e) if e.kind() == std::io::ErrorKind::Interrupted => {}
            Err(e) => return Err(e),
        }
    }
}

/// Whether a number's only mark may be decimal or a thousands separator.
fn has_two_readings(text: &str) -> bool {
    let marks = number_body(text).map_or(0, |body| body.matches(['.', ',']).count());
    marks == 1 && !text.contains(['e', 'E']) && !text.contains(BLANKS)
}

/// Whether a number shows that point or comma separates its thousands.
/// Examples are `1.000,5` and `1.000.000`.
fn shows_thousands(text: &str) -> bool {
    let marks: Vec<char> = number_body(text)
        .map_or_else(Vec::new, |body| body.matches(['.', ',']).flat_map(str::chars).collect());
    marks.len() > 1 && shown_mark(text).is_some()
}

/// A number without sign and exponent; `None` if it has other characters.
fn number_body(text: &str) -> Option<&str> {
    let body = text.trim_start_matches(SIGNS);
    let (body, exponent) = body.split_once(['e', 'E']).unwrap_or((body, "0"));
    let is_number = |c: char| c.is_ascii_digit() || c == '.' || c == ',' || BLANKS.contains(&c);
    let has_digits = body.contains(|c: char| c.is_ascii_digit());
    (has_digits && body.chars().all(is_number) && exponent.parse::<i32>().is_ok()).then_some(body)
}

/// The decimal mark that a number shows by itself.
fn shown_mark(text: &str) -> Option<char> {
    let mark = mark_by_shape(text)?;
    number(&ungrouped(text, mark)?).map(|_| mark)
}

fn mark_by_shape(text: &str) -> Option<char> {
    let body = number_body(text)?;
    let last = body.rfind(['.', ','])?;
    let mark = char::from(body.as_bytes()[last]);
    let other = if mark == '.' { ',' } else { '.' };
    if body.contains(other) {
        return Some(mark);
    }
    if body.matches(mark).count() > 1 {
        return Some(other);
    }
    let (whole, fraction) = (&body[..last], &body[last + 1..]);
    let may_part = fraction.len() == 3 && (1..=3).contains(&whole.len()) && !whole.starts_with('0');
    (!may_part).then_some(mark)
}

/// A number as the standard library reads it.
/// It has a decimal point and no thousands separators.
fn ungrouped(text: &str, mark: char) -> Option<String> {
    let (sign, body) = text.split_at(text.len() - text.trim_start_matches(SIGNS).len());
    let end = body.find(mark).or_else(|| body.find(['e', 'E'])).unwrap_or(body.len());
    let (whole, rest) = body.split_at(end);
    let parts: Vec<&str> = whole.split(|c| matches!(c, '.' | ',') || BLANKS.contains(&c)).collect();
    let digits = |p: &str| p.bytes().all(|b| b.is_ascii_digit());
    // 1,234,567, or 12,34,567 as in India.
    let are_groups = match &parts[1..] {
        [] => true,
        [middle @ .., last] => {
            let of = |digits: usize| middle.iter().all(|p| p.len() == digits);
            last.len() == 3 && (parts[0].len() <= 3 && of(3) || parts[0].len() <= 2 && of(2))
        }
    } && (parts.len() == 1 || !parts[0].is_empty());
    if !are_groups || !parts.iter().all(|p| digits(p)) || sign.chars().count() > 1 {
        return None;
    }
    let rest = rest.strip_prefix(mark).map_or_else(|| rest.to_owned(), |fraction| format!(".{fraction}"));
    Some(format!("{sign}{}{rest}", parts.concat()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_are_found_by_what_the_column_shows() {
        for (column, by, wants) in [
            (&["38,1000", "1.000,0000", "1.000"][..], ';', &[Some(38.1), Some(1000.0), Some(1000.0)][..]),
            (&["38.1", "1,000.5", "1,000"], ',', &[Some(38.1), Some(1000.5), Some(1000.0)]),
            (&["12,4", "12.345"], ';', &[Some(12.4), None]),
            (&["12.4", "12,345"], ';', &[Some(12.4), None]),
            (&["12,4", "1 234"], ';', &[Some(12.4), Some(1234.0)]),
            (&["1.000"], ';', &[Some(1.0)]),
            (&["1,000"], ';', &[Some(1.0)]),
            (&["1,000"], ',', &[None]),
            (&["0,125", "-1,5e-3"], ',', &[Some(0.125), Some(-1.5e-3)]),
            (&["1 000,5", "1'000", "-12"], ';', &[Some(1000.5), Some(1000.0), Some(-12.0)]),
            (&["1.5", "1,5"], ';', &[Some(1.5), None]),
            (&["1,5", "1.5"], ';', &[Some(1.5), None]),
            (
                &["\u{2212}3,5", "\u{2212}1.000,25", "\u{2212}2"],
                ';',
                &[Some(-3.5), Some(-1000.25), Some(-2.0)],
            ),
            (&["\u{2212}3.5", "\u{2212}-2", "\u{2212}"], ',', &[Some(-3.5), None, None]),
            (&["1.234.567", "12.34.5"], ';', &[Some(1_234_567.0), None]),
            (&["", "nan", "#N/A", "--1", "1e999", "."], ',', &[None, None, None, None, None, None]),
        ] {
            let numbers =
                DecimalMarks::of(column.iter().copied(), DecimalMarks::mark_of(column.iter().copied()), by);
            let read: Vec<Option<f64>> = column.iter().map(|c| numbers.parse(c)).collect();
            assert_eq!(read, wants, "{column:?}");
        }
    }

    #[test]
    fn a_number_with_two_readings_is_questioned() {
        let written = |text: &str| {
            let mut reader = Reader::new(Path::new("a.csv"), text.as_bytes()).unwrap();
            reader.header_with("names", &[]).unwrap();
            TableNumberFormat::of(&mut reader).unwrap().written(Path::new("a.csv"))
        };
        let says = "a.csv: read as columns parted by semicolons; 1.500 was read as 1.500, with a decimal point; it may be 1500, as \
                    no cell shows the decimal mark: if so, write it without the point, or one cell with a decimal comma";
        assert_eq!(written("x;e\n1.500;2\n").unwrap(), says);
        assert!(
            written("x;e\n-12,500;2\n")
                .unwrap()
                .contains("-12,500 was read as -12.500, with a decimal comma; it may be -12500")
        );
        for settled in ["x;e\n1.500;0.5\n", "x;e\n1.500;2,5\n", "x;e\n1.5e3;1.500e2\n", "x;e\n1500;2\n"] {
            assert!(
                !written(settled).unwrap().contains("two readings")
                    && !written(settled).unwrap().contains("may be"),
                "{settled}"
            );
        }
        assert_eq!(written("x,e\n1.500,2\n"), None);
    }

    #[test]
    fn a_plain_file_has_neither_quotes_nor_foreign_letters() {
        let long = "µ,1\n".repeat(40_000);
        for (bytes, plain) in [
            (long.as_bytes(), true),
            (b"1,2\n", true),
            (b"1,\"2\"\n", false),
            (b"1,\xb5m is text in Windows-1252\n", false),
            (b"1,\xb5", false),
        ] {
            assert_eq!(is_plain(&mut &bytes[..]).unwrap(), plain);
        }
    }

    /// Separated thousands are read with any decimal mark.
    #[test]
    fn thousands_are_read_beside_every_decimal_mark() {
        for blank in BLANKS {
            for table in [None, Some('.'), Some(',')] {
                for by in [';', ','] {
                    let text = format!("-1{blank}234{blank}567");
                    let numbers = DecimalMarks::of([text.as_str()], table, by);
                    assert_eq!(numbers.parse(&text), Some(-1_234_567.0), "{blank:?} {table:?} {by}");
                }
            }
        }
        for (text, right) in [
            ("1,00,000", Some(100_000.0)),
            ("12,34,567.5", Some(1_234_567.5)),
            ("123,45,678", None),
            ("1,00,00", None),
        ] {
            assert_eq!(DecimalMarks::of([text], Some('.'), ',').parse(text), right, "{text}");
        }
    }

    #[test]
    fn lone_thousands_beside_decimal_commas_have_two_readings() {
        let numbers = DecimalMarks::of(["1.000"], Some(','), ';');
        assert_eq!(numbers.parse("1.000"), None);
        assert!(numbers.expected("1.000").contains("may part thousands"));
    }
}
