//! The names of a table's columns.

use super::row::{Cell, Row};
use crate::column_units;
use crate::input_error::InputError;
use crate::message_text::{cut, nearest, quoted};
use std::path::{Path, PathBuf};

/// The columns' names, from the first row.
#[derive(Debug, Clone)]
pub struct Header {
    file: PathBuf,
    line: usize,
    pub(super) text: String,
    /// Name of each column, and its place in the line in characters, from 1.
    pub(super) names: Vec<(String, usize)>,
}

impl Header {
    pub(super) fn of(row: Row<'_>) -> Self {
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
    pub(super) fn numbered(&self) -> Self {
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
        let Some(said) = column_units::stated(name).map(|s| s.unit) else { return Ok(()) };
        column_units::contradicted(column, said).map_or(Ok(()), |stated| {
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
    pub(super) fn only(&self, known: &[&str], also: impl Fn(&str) -> bool) -> Result<(), InputError> {
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
                return Err(cell.extra_field_finding(columns, &self.text));
            }
            take(columns, cell)?;
            columns += 1;
        }
        match self.names.get(columns) {
            Some((missing, _)) => Err(row.missing_field_finding(columns, self.names.len(), missing)),
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
