//! A CSV of numbers: the columns by name, every finding with its line and column.

use rtec_driver::input::InputError;
use std::path::{Path, PathBuf};

/// A CSV file read whole. UTF-8, a byte-order mark and CRLF accepted, `#` starts a comment.
#[derive(Debug, Clone)]
pub struct Sheet {
    file: PathBuf,
    header_line: usize,
    names: Vec<String>,
    rows: Vec<Row>,
}

#[derive(Debug, Clone)]
struct Row {
    line: usize,
    /// Text and column (in characters, from 1) of each cell.
    cells: Vec<(String, usize)>,
}

/// Read a file as UTF-8 text, without its byte-order mark.
///
/// # Errors
/// The file cannot be read or is no UTF-8.
pub fn read_text(file: &Path) -> Result<String, InputError> {
    let bytes = std::fs::read(file)
        .map_err(|e| InputError::whole(file, format!("an unreadable file ({e})"), "a readable file"))?;
    let mut text = String::from_utf8(bytes).map_err(|e| {
        let found = format!("a byte that is no UTF-8 at offset {}", e.utf8_error().valid_up_to());
        InputError::whole(file, found, "UTF-8 text")
    })?;
    if text.starts_with('\u{feff}') {
        text.remove(0);
    }
    Ok(text)
}

/// Write a whole file or none: to a neighbour first, then renamed over the name.
///
/// # Errors
/// As the file system reports them.
pub fn write_whole(file: &Path, content: &[u8]) -> std::io::Result<()> {
    let mut name = file.file_name().unwrap_or_default().to_owned();
    name.push(format!(".{}.tmp", std::process::id()));
    let neighbour = file.with_file_name(name);
    std::fs::write(&neighbour, content).and_then(|()| std::fs::rename(&neighbour, file)).inspect_err(|_| {
        // The first error is the one to report; a neighbour that was never made needs no removal.
        let _ = std::fs::remove_file(&neighbour);
    })
}

impl Sheet {
    /// Read a file whose columns are all in `known`, or match `also` (say, temperature columns).
    ///
    /// # Errors
    /// Unreadable, no header, unknown or repeated column, a row that is too short or too long.
    pub fn read(file: &Path, known: &[&str], also: fn(&str) -> bool) -> Result<Self, InputError> {
        Self::parse(file, &read_text(file)?, known, also)
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
        let mut lines = text.lines().enumerate().filter_map(|(i, line)| {
            let line = line.split('#').next().unwrap_or_default();
            (!line.trim().is_empty()).then(|| Row { line: i + 1, cells: cells(line) })
        });
        let Some(header) = lines.next() else {
            return Err(InputError::whole(file, "no line at all", format!("a header: {}", known.join(","))));
        };
        let mut names: Vec<String> = Vec::new();
        for (name, column) in header.cells {
            if !known.contains(&name.as_str()) && !also(&name) {
                let expected = format!("one of the columns {}", known.join(", "));
                return Err(InputError::at(file, header.line, column, format!("column '{name}'"), expected));
            }
            if names.contains(&name) {
                let found = format!("column '{name}' a second time");
                return Err(InputError::at(file, header.line, column, found, "every column once"));
            }
            names.push(name);
        }
        let rows: Vec<Row> = lines.collect();
        for row in &rows {
            if row.cells.len() != names.len() {
                let found = format!("{} values", row.cells.len());
                let expected = format!("{} values, one per column of the header", names.len());
                return Err(InputError::at(file, row.line, 0, found, expected));
            }
        }
        Ok(Self { file: file.to_owned(), header_line: header.line, names, rows })
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

    fn index(&self, name: &str) -> Result<usize, InputError> {
        self.names.iter().position(|n| n == name).ok_or_else(|| {
            let found = format!("the columns {}", self.names.join(", "));
            InputError::at(&self.file, self.header_line, 0, found, format!("a column '{name}'"))
        })
    }

    /// A column of finite numbers.
    ///
    /// # Errors
    /// No such column, or a cell that is no finite number.
    pub fn numbers(&self, name: &str) -> Result<Vec<f64>, InputError> {
        let i = self.index(name)?;
        self.rows
            .iter()
            .map(|row| {
                let (text, column) = &row.cells[i];
                text.parse().ok().filter(|v: &f64| v.is_finite()).ok_or_else(|| {
                    let found = format!("'{text}' in column '{name}'");
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
        let i = self.index(name)?;
        self.rows
            .iter()
            .map(|row| {
                let (text, column) = &row.cells[i];
                if text.is_empty() {
                    let found = format!("an empty cell in column '{name}'");
                    return Err(InputError::at(&self.file, row.line, *column, found, "a name"));
                }
                Ok(text.clone())
            })
            .collect()
    }
}

fn cells(line: &str) -> Vec<(String, usize)> {
    let mut column = 1;
    line.split(',')
        .map(|cell| {
            let lead = cell.chars().take_while(|c| c.is_whitespace()).count();
            let at = column + lead;
            column += cell.chars().count() + 1;
            (cell.trim().to_owned(), at)
        })
        .collect()
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
        assert_eq!(at(parse("z_mm,x_mm\n1,2\n1\n").unwrap_err()), (3, 0));
        for bad in ["nan", "inf", "", "1e999", "1;2"] {
            let sheet = parse(&format!("z_mm,x_mm\n1, {bad}\n")).unwrap();
            let e = sheet.numbers("x_mm").unwrap_err();
            assert_eq!(e.line, 2, "{bad}");
            assert!(e.column >= 3, "{bad}");
        }
        assert_eq!(at(parse("z_mm\n1\n").unwrap().numbers("x_mm").unwrap_err()), (1, 0));
        assert!(parse("").is_err());
    }
}
