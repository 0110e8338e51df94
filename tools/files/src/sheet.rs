//! A CSV whose columns are known, read whole: columns by name, every finding with its line and column.

use crate::csv::{Header, Reader};
use crate::input::InputError;
use crate::numbers::Marks;
use crate::words::shown;
use std::path::{Path, PathBuf};

/// A CSV file read whole.
#[derive(Debug, Clone)]
pub struct Sheet {
    file: PathBuf,
    header: Header,
    names: Vec<String>,
    rows: Vec<Row>,
    marks: Marks,
}

#[derive(Debug, Clone)]
struct Row {
    line: usize,
    /// Text and column (in characters, from 1) of each cell.
    cells: Vec<(String, usize)>,
}

impl Sheet {
    /// Read a file whose columns are all in `known`, or match `also` (say, temperature columns).
    ///
    /// # Errors
    /// Unreadable, no regular file, no header, unknown or repeated column, a row that is too short or too long.
    pub fn read(file: &Path, known: &[&str], also: fn(&str) -> bool) -> Result<Self, InputError> {
        Self::of(file, Reader::new(file, crate::text::bytes(file)?.as_slice())?, known, also)
    }

    /// As [`Sheet::read`], from text already in memory; `file` only names it.
    ///
    /// # Errors
    /// As [`Sheet::read`].
    pub fn parse(
        file: &Path,
        text: &str,
        known: &[&str],
        also: fn(&str) -> bool,
    ) -> Result<Self, InputError> {
        Self::of(file, Reader::new(file, text.as_bytes())?, known, also)
    }

    fn of<R: std::io::Read>(
        file: &Path,
        mut reader: Reader<R>,
        known: &[&str],
        also: fn(&str) -> bool,
    ) -> Result<Self, InputError> {
        let header = reader.header_by_any(&format!("a header: {}", known.join(",")))?;
        header.only(known, also)?;
        let mut rows = Vec::new();
        while let Some(row) = reader.row()? {
            let cells = header.cells(row)?;
            let cells = cells.iter().map(|cell| (cell.text().to_owned(), cell.column())).collect();
            rows.push(Row { line: row.line(), cells });
        }
        let names = header.names().map(str::to_owned).collect();
        let mut marks = Marks::new(reader.separator(), reader.is_utf16());
        for (place, (text, _)) in rows.iter().flat_map(|r: &Row| r.cells.iter().enumerate()) {
            marks.see(place, text);
        }
        Ok(Self { file: file.to_owned(), header, names, rows, marks })
    }

    /// The file as the user named it.
    #[must_use]
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// How the file is written where it is not as formats.md has it: UTF-16, another separator, decimal commas.
    #[must_use]
    pub fn written(&self) -> Option<String> {
        self.marks.written(&self.file)
    }

    /// Number of rows without the header.
    #[must_use]
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// No row at all.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// The columns' names in the file's order.
    #[must_use]
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Line of a row, from 1.
    #[must_use]
    pub fn line(&self, row: usize) -> usize {
        self.rows[row].line
    }

    /// A finding about one row.
    #[must_use]
    pub fn finding(&self, row: usize, found: impl Into<String>, expected: impl Into<String>) -> InputError {
        InputError::at(&self.file, self.line(row), 0, found, expected)
    }

    /// A column of finite numbers.
    ///
    /// # Errors
    /// No such column, or a cell that is no finite number.
    pub fn numbers(&self, name: &str) -> Result<Vec<f64>, InputError> {
        let i = self.header.place(name)?;
        let numbers = self.marks.numbers(i);
        self.rows
            .iter()
            .map(|row| {
                let (text, column) = &row.cells[i];
                numbers.parse(text).ok_or_else(|| {
                    let found = format!("{} in column {name}", shown(text));
                    InputError::at(&self.file, row.line, *column, found, numbers.expected(text))
                })
            })
            .collect()
    }

    /// A column of numbers that the file may leave out.
    ///
    /// # Errors
    /// As [`Sheet::numbers`] where the column is there.
    pub fn optional(&self, name: &str) -> Result<Option<Vec<f64>>, InputError> {
        if self.names.iter().any(|n| n == name) { self.numbers(name).map(Some) } else { Ok(None) }
    }

    /// A column of words.
    ///
    /// # Errors
    /// No such column, or an empty cell.
    pub fn words(&self, name: &str) -> Result<Vec<String>, InputError> {
        let i = self.header.place(name)?;
        self.rows
            .iter()
            .map(|row| {
                let (text, column) = &row.cells[i];
                if text.is_empty() {
                    let found = format!("{} in column {name}", shown(text));
                    return Err(InputError::at(&self.file, row.line, *column, found, "a name"));
                }
                Ok(text.clone())
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Sheet, InputError> {
        Sheet::parse(Path::new("p.csv"), text, &["z_mm", "x_mm"], |_| false)
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
            let file = Path::new("p.csv");
            let reader = Reader::new(file, bytes.as_slice()).unwrap();
            let sheet = Sheet::of(file, reader, &["z_mm", "x_mm"], |_| false).unwrap();
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
        let file = Path::new("p.csv");
        let reader = Reader::new(file, bytes.as_slice()).unwrap();
        let sheet = Sheet::of(file, reader, &["z_mm", "x_mm"], |_| false).unwrap();
        assert_eq!((sheet.len(), sheet.numbers("x_mm").unwrap()[39_999]), (40_000, 40_000.5));
        let reader = Reader::new(file, &bytes[..bytes.len() - 1]).unwrap();
        let error = Sheet::of(file, reader, &["z_mm", "x_mm"], |_| false).unwrap_err();
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
