//! Reads a whole CSV whose columns are known.
//! Columns are found by name; every finding has its line and column.

use crate::csv::{Header, Reader};
use crate::file_kind::FileKind;
use crate::input_error::InputError;
use crate::message_text::{cut, shown};
use crate::table_number_format::TableNumberFormat;
use std::path::{Path, PathBuf};

/// A CSV file read whole.
#[derive(Debug, Clone)]
pub struct CsvTable {
    file: PathBuf,
    header: Header,
    names: Vec<String>,
    rows: Vec<CsvTableRow>,
    marks: TableNumberFormat,
    /// Columns that were ignored.
    unrelated: Vec<String>,
}

#[derive(Debug, Clone)]
struct CsvTableRow {
    line: usize,
    /// Text and column (in characters, from 1) of each cell.
    cells: Vec<(String, usize)>,
}

/// The user's assignment of columns, if a file has other names.
/// It holds pairs of the known name and the file's name or number, from 1.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ColumnAssignment(Vec<(String, String)>);

impl ColumnAssignment {
    /// Parses words such as `z_mm=3` or `z_mm=Z position`.
    ///
    /// # Errors
    /// A word without `=`; a name that is not in `known` and does not match `also`; one name twice.
    pub fn parse(words: &[String], known: &[&str], also: fn(&str) -> bool) -> Result<Self, InputError> {
        let mut columns: Vec<(String, String)> = Vec::new();
        for word in words {
            let usage = |expected: &str| InputError::whole(Path::new("--columns"), shown(word), expected);
            let (name, place) = word.split_once('=').map(|(n, p)| (n.trim(), p.trim())).unwrap_or_default();
            if name.is_empty() || place.is_empty() {
                let first = known.first().unwrap_or(&"NAME");
                return Err(usage(&format!("NAME=COLUMN, the file's name or number for each: {first}=1")));
            }
            if !known.contains(&name) && !also(name) {
                return Err(usage(&format!("one of {} in front of =", known.join(", "))));
            }
            if columns.iter().any(|(n, _)| n == name) {
                return Err(usage("each name once"));
            }
            columns.push((name.to_owned(), place.to_owned()));
        }
        Ok(Self(columns))
    }

    /// Whether the user has assigned no column.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The file's names or numbers.
    pub fn places(&self) -> Vec<&str> {
        self.0.iter().map(|(_, place)| place.as_str()).collect()
    }

    /// The file's name or number for a known name, if the user has assigned it.
    pub fn place_of(&self, name: &str) -> Option<&str> {
        self.0.iter().find(|(n, _)| n == name).map(|(_, place)| place.as_str())
    }
}

/// The finding that the file is the CSV of a run record beside it.
fn record_beside(file: &Path) -> Option<String> {
    let sidecar = file.with_extension("run.toml");
    let names_file = |text: &str| {
        let value =
            |line: &str| Some(line.trim().strip_prefix("file")?.trim().strip_prefix('=')?.trim().to_owned());
        let named = text.lines().find_map(value);
        named
            .zip(file.file_name())
            .is_some_and(|(named, own)| *named.trim_matches(['"', '\'']) == *own.to_string_lossy())
    };
    let is_its_csv = crate::text_file::read(&sidecar)
        .is_ok_and(|text| FileKind::of(&text) == Some(FileKind::RunRecord) && names_file(&text));
    is_its_csv.then(|| {
        format!("the rows of the run record {}, which `characterise evaluate` reads", sidecar.display())
    })
}

impl CsvTable {
    /// Reads a file whose columns are all in `known`, or match `also`.
    /// `also` may accept temperature columns, for example.
    ///
    /// # Errors
    /// Unreadable, no regular file, no header, unknown or repeated column, a row that is too short or too
    /// long, a file of another kind.
    pub fn read(file: &Path, known: &[&str], also: fn(&str) -> bool) -> Result<Self, InputError> {
        Self::of(file, &crate::text_file::bytes(file)?, known, also, &ColumnAssignment::default())
    }

    /// As [`CsvTable::read`], with the columns that the user has assigned.
    /// All other columns are ignored.
    ///
    /// # Errors
    /// As [`CsvTable::read`]; an assigned column that is missing.
    pub fn read_columns(
        file: &Path,
        known: &[&str],
        also: fn(&str) -> bool,
        columns: &ColumnAssignment,
    ) -> Result<Self, InputError> {
        Self::of(file, &crate::text_file::bytes(file)?, known, also, columns)
    }

    /// As [`CsvTable::read`], from text already in memory; `file` only names it.
    ///
    /// # Errors
    /// As [`CsvTable::read`].
    pub fn parse(
        file: &Path,
        text: &str,
        known: &[&str],
        also: fn(&str) -> bool,
    ) -> Result<Self, InputError> {
        Self::of(file, text.as_bytes(), known, also, &ColumnAssignment::default())
    }

    fn of(
        file: &Path,
        bytes: &[u8],
        known: &[&str],
        also: fn(&str) -> bool,
        columns: &ColumnAssignment,
    ) -> Result<Self, InputError> {
        let expected = format!("a header: {}", known.join(","));
        let mut reader = Reader::new(file, bytes)?;
        let header = if columns.is_empty() {
            // A line with two of the names cannot be a coincidence.
            let enough = known.len().min(2);
            let has_enough =
                |header: &Header| known.iter().filter(|n| header.find(n).is_some()).count() >= enough;
            reader.header_where(&expected, has_enough)?
        } else {
            reader.header_of(&expected, &columns.places())?
        };
        let (header, unrelated) = if columns.is_empty() {
            header.known(known, also).map_err(|e| {
                let e = header.is_missing().map_or(e, |missing| InputError {
                    expected: format!("{}, as {}", missing.expected, known.join(",")),
                    ..missing
                });
                FileKind::of(&String::from_utf8_lossy(bytes))
                    .filter(|kind| {
                        let own = kind.columns().iter().all(|c| known.contains(c));
                        *kind != FileKind::Table && (kind.columns().is_empty() || !own)
                    })
                    .map(|kind| kind.name().to_owned())
                    .or_else(|| record_beside(file))
                    .map_or(e.clone(), |found| InputError { found, ..e })
            })?
        } else {
            (header.renamed(&columns.0)?, Vec::new())
        };
        let mut rows = Vec::new();
        while let Some(row) = reader.row()? {
            let cells = header.cells(row)?;
            let cells = cells.iter().map(|cell| (cell.text().to_owned(), cell.column())).collect();
            rows.push(CsvTableRow { line: row.line(), cells });
        }
        if rows.is_empty()
            && let Some(commented) = reader.rows_are_comments()
        {
            return Err(commented);
        }
        let names = header.names().filter(|name| !name.is_empty()).map(str::to_owned).collect();
        let mut marks = TableNumberFormat::new(&reader);
        for (place, (text, _)) in rows.iter().flat_map(|r: &CsvTableRow| r.cells.iter().enumerate()) {
            marks.see(place, text);
        }
        Ok(Self { file: file.to_owned(), header, names, rows, marks, unrelated })
    }

    /// The file as the user named it.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// How the file's format differs from the documented one.
    /// It may be UTF-16, have another separator or decimal commas, lines before the names, or ignored
    /// columns.
    pub fn written(&self) -> Option<String> {
        let names: Vec<String> = self.unrelated.iter().map(|name| cut(name)).collect();
        let left_out = (!names.is_empty())
            .then(|| format!("{}: left out the columns {}", self.file.display(), names.join(", ")));
        let said: Vec<String> = self.marks.written(&self.file).into_iter().chain(left_out).collect();
        (!said.is_empty()).then(|| said.join("; "))
    }

    /// Number of rows without the header.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Whether there is no row at all.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// The columns' names in the file's order.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Line of a row, from 1.
    pub fn line(&self, row: usize) -> usize {
        self.rows[row].line
    }

    /// A finding about one row.
    pub fn finding(&self, row: usize, found: impl Into<String>, expected: impl Into<String>) -> InputError {
        InputError::at(&self.file, self.line(row), 0, found, expected)
    }

    /// A column of finite numbers.
    ///
    /// # Errors
    /// No such column, or a cell that is no finite number.
    pub fn numbers(&self, name: &str) -> Result<Vec<f64>, InputError> {
        let numbers = self.marks.numbers(self.header.place(name)?);
        self.column(name, |text| numbers.parse(text).ok_or_else(|| numbers.expected(text)))
    }

    /// A column, each cell as `read` understands it; its error says what was expected.
    fn column<T>(
        &self,
        name: &str,
        read: impl Fn(&str) -> Result<T, &'static str>,
    ) -> Result<Vec<T>, InputError> {
        let place = self.header.place(name)?;
        let cells = self.rows.iter().map(|row| (row.line, &row.cells[place]));
        let read = |(line, (text, column)): (usize, &(String, usize))| {
            let found = || format!("{} in column {name}", shown(text));
            read(text).map_err(|expected| InputError::at(&self.file, line, *column, found(), expected))
        };
        cells.map(read).collect()
    }

    /// A column of numbers that the file may leave out.
    ///
    /// # Errors
    /// As [`CsvTable::numbers`], if the column exists.
    pub fn optional(&self, name: &str) -> Result<Option<Vec<f64>>, InputError> {
        if self.names.iter().any(|n| n == name) { self.numbers(name).map(Some) } else { Ok(None) }
    }

    /// A column of words.
    ///
    /// # Errors
    /// No such column, or an empty cell.
    pub fn words(&self, name: &str) -> Result<Vec<String>, InputError> {
        self.column(name, |text| if text.is_empty() { Err("a name") } else { Ok(text.to_owned()) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<CsvTable, InputError> {
        CsvTable::parse(Path::new("p.csv"), text, &["z_mm", "x_mm"], |_| false)
    }

    fn of_bytes(bytes: &[u8]) -> Result<CsvTable, InputError> {
        CsvTable::of(Path::new("p.csv"), bytes, &["z_mm", "x_mm"], |_| false, &ColumnAssignment::default())
    }

    #[test]
    fn columns_go_by_name_or_number() {
        let known = ["z_mm", "x_mm", "point"];
        let columns = |words: &[&str]| {
            let words: Vec<String> = words.iter().map(|w| (*w).to_owned()).collect();
            ColumnAssignment::parse(&words, &known, |_| false)
        };
        let read = |bytes: &[u8], words: &[&str]| {
            CsvTable::of(Path::new("p.csv"), bytes, &known, |_| false, &columns(words)?)
        };
        let spare = b"Punkt;Radius X;Laenge Z\n1;2,5;10,25\n2;3,5;11\n";
        for words in [["z_mm=3", "x_mm=2"], ["z_mm=Laenge Z", "x_mm=Radius X"], ["x_mm=2", "z_mm=Laenge Z"]] {
            let sheet = read(spare, &words).unwrap();
            assert_eq!(sheet.numbers("z_mm").unwrap(), [10.25, 11.0], "{words:?}");
            assert_eq!(sheet.numbers("x_mm").unwrap(), [2.5, 3.5], "{words:?}");
            assert_eq!(sheet.names().len(), 2, "{words:?}");
        }
        // The file has no line of names.
        let sheet = read(b"1;2,5;10,25\n2;3,5;11\n", &["z_mm=3", "x_mm=2"]).unwrap();
        assert_eq!((sheet.len(), sheet.numbers("z_mm").unwrap()[0]), (2, 10.25));
        let error = read(b"1;2,5;10,25\n2;3,5;11\n", &[]).unwrap_err();
        assert_eq!(
            error.expected,
            "the columns' names there: the line that names them is missing, as z_mm,x_mm,point"
        );
        assert_eq!(read(spare, &["z_mm=4", "x_mm=2"]).unwrap_err().found, "no column 4");
        for words in [&["z=3"][..], &["z_mm"], &["z_mm="], &["z_mm=1", "z_mm=2"]] {
            assert!(columns(words).is_err(), "{words:?}");
        }
    }

    #[test]
    fn a_file_of_another_kind_is_named() {
        let batch = parse("part,feature,error_um\n1,D1,2\n").unwrap_err();
        assert_eq!(batch.found, "a batch of parts: it has columns part, feature");
        assert_eq!(parse("0\nSECTION\n").unwrap_err().found, "a DXF drawing");
        let folder = tempfile::tempdir().unwrap();
        let csv = folder.path().join("axis.csv");
        std::fs::write(&csv, "t,e\n0,1\n").unwrap();
        let read = || CsvTable::read(&csv, &["z_mm", "x_mm"], |_| false).unwrap_err().found;
        assert_eq!(read(), "column 't'");
        std::fs::write(csv.with_extension("run.toml"), "file = \"axis.csv\"\n[columns]\n").unwrap();
        assert!(read().starts_with("the rows of the run record "), "{}", read());
        let book = of_bytes(b"PK\x03\x04\x14\0\x06\0\xee\n").unwrap_err();
        assert_eq!(book.expected, "a text file: save the sheet as CSV");
    }

    #[test]
    fn comments_and_crlf_are_taken() {
        let sheet = parse("# probe\r\nz_mm, x_mm # mm\r\n\r\n1, 2\r\n3,4 # last\r\n").unwrap();
        assert_eq!(sheet.numbers("x_mm").unwrap(), [2.0, 4.0]);
        assert_eq!(sheet.line(1), 5);
    }

    #[test]
    fn spreadsheets_write_the_same_table_in_many_ways() {
        let utf16 = |text: &str| -> Vec<u8> {
            [0xff, 0xfe].into_iter().chain(text.encode_utf16().flat_map(u16::to_le_bytes)).collect()
        };
        let german = "z_mm;x_mm\r\n38,5;1.000,25\r\n-1;999,5\r\n";
        for bytes in [
            german.as_bytes().to_vec(),
            format!("\u{feff}sep=;\n{german}").into_bytes(),
            utf16(german),
            utf16(&format!("SEP=;\r\n{german}")),
            german.replace(';', "\t").into_bytes(),
            b"sep=|\nz_mm|x_mm\n38,5|1000,25\n-1|999,5\n".to_vec(),
            b"z_mm,x_mm\n38.5,\"1,000.25\"\n-1,999.5\n".to_vec(),
            b"\"z_mm\",\"x_mm\"\n\"38,5\",\"1.000,25\"\n\"-1\",\"999,5\"\n".to_vec(),
        ] {
            let sheet = of_bytes(&bytes).unwrap();
            let shown = String::from_utf8_lossy(&bytes);
            assert_eq!(sheet.numbers("z_mm").unwrap(), [38.5, -1.0], "{shown}");
            assert_eq!(sheet.numbers("x_mm").unwrap(), [1000.25, 999.5], "{shown}");
        }
        let said = parse("z_mm;x_mm\n1,5;2\n").unwrap().written().unwrap();
        assert_eq!(said, "p.csv: read as columns parted by semicolons, decimal commas");
        assert_eq!(parse("z_mm,x_mm\n1.5,2\n").unwrap().written(), None);
    }

    #[test]
    fn a_long_table_in_utf16_is_read_whole() {
        let text: String = std::iter::once("z_mm,x_mm\n".to_owned())
            .chain((0..40_000).map(|i| format!("{i},{}.5 # µ\n", i + 1)))
            .collect();
        let bytes: Vec<u8> =
            [0xfe, 0xff].into_iter().chain(text.encode_utf16().flat_map(u16::to_be_bytes)).collect();
        let sheet = of_bytes(&bytes).unwrap();
        assert_eq!((sheet.len(), sheet.numbers("x_mm").unwrap()[39_999]), (40_000, 40_000.5));
        let error = of_bytes(&bytes[..bytes.len() - 1]).unwrap_err();
        assert_eq!(error.found, "text in UTF-16 with half a character in it");
    }

    #[test]
    fn each_finding_has_its_place() {
        let at = |e: InputError| (e.line, e.column);
        assert_eq!(at(parse("z_mm,y_mm\n").unwrap_err()), (1, 6));
        assert_eq!(at(parse("z_mm,z_mm\n").unwrap_err()), (1, 6));
        assert_eq!(at(parse("z_mm,x_mm\n1,2\n1\n").unwrap_err()), (3, 2));
        for bad in ["nan", "inf", "", "1e999", "1;2", "#N/A", "1.2.3"] {
            let sheet = parse(&format!("z_mm,x_mm\n1, {bad}\n")).unwrap();
            let e = sheet.numbers("x_mm").unwrap_err();
            assert_eq!(e.line, 2, "{bad}");
            assert!(e.column >= 3, "{bad}");
        }
        assert_eq!(at(parse("z_mm\n1\n").unwrap().numbers("x_mm").unwrap_err()), (1, 1));
        assert!(parse("").is_err());
    }
}
