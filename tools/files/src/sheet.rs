//! A CSV whose columns are known, read whole: columns by name, every finding with its line and column.

use crate::csv::{Header, Reader};
use crate::input::InputError;
use crate::words::shown;
use std::path::{Path, PathBuf};

/// A CSV file read whole.
#[derive(Debug, Clone)]
pub struct Sheet {
    file: PathBuf,
    header: Header,
    names: Vec<String>,
    rows: Vec<Row>,
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
    /// Unreadable, no header, unknown or repeated column, a row that is too short or too long.
    pub fn read(file: &Path, known: &[&str], also: fn(&str) -> bool) -> Result<Self, InputError> {
        Self::of(file, Reader::open(file)?, known, also)
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
        let header = reader.header(&format!("a header: {}", known.join(",")))?;
        header.only(known, also)?;
        let mut rows = Vec::new();
        while let Some(row) = reader.row()? {
            let cells = header.cells(row)?;
            let cells = cells.iter().map(|cell| (cell.text().to_owned(), cell.column())).collect();
            rows.push(Row { line: row.line(), cells });
        }
        let names = header.names().map(str::to_owned).collect();
        Ok(Self { file: file.to_owned(), header, names, rows })
    }

    /// The file as the user named it.
    #[must_use]
    pub fn file(&self) -> &Path {
        &self.file
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
        self.rows
            .iter()
            .map(|row| {
                let (text, column) = &row.cells[i];
                text.parse().ok().filter(|v: &f64| v.is_finite()).ok_or_else(|| {
                    let found = format!("{} in column {name}", shown(text));
                    InputError::at(&self.file, row.line, *column, found, "a finite number")
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
    fn each_finding_has_its_place() {
        let at = |e: InputError| (e.line, e.column);
        assert_eq!(at(parse("z_mm,y_mm\n").unwrap_err()), (1, 6));
        assert_eq!(at(parse("z_mm,z_mm\n").unwrap_err()), (1, 6));
        assert_eq!(at(parse("z_mm,x_mm\n1,2\n1\n").unwrap_err()), (3, 2));
        for bad in ["nan", "inf", "", "1e999", "1;2"] {
            let sheet = parse(&format!("z_mm,x_mm\n1, {bad}\n")).unwrap();
            let e = sheet.numbers("x_mm").unwrap_err();
            assert_eq!(e.line, 2, "{bad}");
            assert!(e.column >= 3, "{bad}");
        }
        assert_eq!(at(parse("z_mm\n1\n").unwrap().numbers("x_mm").unwrap_err()), (1, 1));
        assert!(parse("").is_err());
    }
}
