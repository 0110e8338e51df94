//! How the numbers of a column are written: decimal point or comma, thousands parted or not.
//!
//! A cell tells its decimal mark by itself where it has both marks (`1.000,5`), one mark several times (`1.000.000`), or one
//! that cannot part thousands (`38,1125`, `0,125`). One mark with three digits behind it (`1.000`, `38,125`) does not tell; the
//! other cells of the column decide then.

/// What parts thousands in some countries, beside the other one of point and comma.
const BLANKS: [char; 4] = [' ', '\u{a0}', '\u{202f}', '\''];

/// The decimal marks that a table's cells show.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Numbers {
    /// The mark that this column's cells show.
    column: Option<char>,
    /// The mark that any cell of the table shows.
    table: Option<char>,
    /// Commas part the cells: a comma within a cell is no decimal mark unless a cell shows that it is.
    commas_part: bool,
}

impl Numbers {
    /// For a column of these cells; `table` is what [`Numbers::mark_of`] finds among all cells, `by` what parts the cells.
    #[must_use]
    pub fn of<'t>(column: impl IntoIterator<Item = &'t str>, table: Option<char>, by: char) -> Self {
        Self::shown(Self::mark_of(column), table, by)
    }

    /// For a column whose cells show one mark, or none, in a table that shows one, or none.
    #[must_use]
    pub fn shown(column: Option<char>, table: Option<char>, by: char) -> Self {
        Self { column, table, commas_part: by == ',' }
    }

    /// For a column that has this decimal mark: somebody said so.
    #[must_use]
    pub fn written(mark: char) -> Self {
        Self { column: Some(mark), table: Some(mark), commas_part: false }
    }

    /// The decimal mark that the first cell shows that shows one.
    #[must_use]
    pub fn mark_of<'t>(cells: impl IntoIterator<Item = &'t str>) -> Option<char> {
        cells.into_iter().find_map(shown_mark)
    }

    /// The finite number in a cell; `None` where there is none, or where it has two readings.
    #[must_use]
    pub fn parse(self, text: &str) -> Option<f64> {
        let plain = || text.parse().ok().filter(|v: &f64| v.is_finite());
        if !text.contains(['.', ',']) && !text.contains(BLANKS) {
            return plain();
        }
        let default = if text.contains(',') {
            // A lone comma with three digits behind it.
            match self.table {
                Some(mark) => Some(mark).filter(|mark| *mark == ','),
                None => Some(',').filter(|_| !self.commas_part),
            }
        } else if self.table == Some(',') {
            None
        } else {
            Some('.')
        };
        let mark = self.column.or_else(|| shown_mark(text)).or(default)?;
        ungrouped(text, mark)?.parse().ok().filter(|v: &f64| v.is_finite())
    }

    /// What to write instead of a cell that is no number or has two readings.
    #[must_use]
    pub fn expected(self, text: &str) -> &'static str {
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

/// The decimal mark that a number shows by itself.
fn shown_mark(text: &str) -> Option<char> {
    let body = text.trim_start_matches(['+', '-']);
    let body = body.split(['e', 'E']).next().unwrap_or(body);
    let is_number = |c: char| c.is_ascii_digit() || c == '.' || c == ',' || BLANKS.contains(&c);
    if !body.contains(|c: char| c.is_ascii_digit()) || !body.chars().all(is_number) {
        return None;
    }
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

/// A number as the standard library reads it: decimal point, nothing that parts thousands.
fn ungrouped(text: &str, mark: char) -> Option<String> {
    let (sign, body) = text.split_at(text.len() - text.trim_start_matches(['+', '-']).len());
    let end = body.find(mark).or_else(|| body.find(['e', 'E'])).unwrap_or(body.len());
    let (whole, rest) = body.split_at(end);
    let parts: Vec<&str> = whole.split(|c| matches!(c, '.' | ',') || BLANKS.contains(&c)).collect();
    let digits = |p: &str| p.bytes().all(|b| b.is_ascii_digit());
    let grouped =
        parts.len() == 1 || (1..=3).contains(&parts[0].len()) && parts[1..].iter().all(|p| p.len() == 3);
    if !grouped || !parts.iter().all(|p| digits(p)) || sign.len() > 1 {
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
            (&["1.000"], ';', &[Some(1.0)]),
            (&["1,000"], ';', &[Some(1.0)]),
            (&["1,000"], ',', &[None]),
            (&["0,125", "-1,5e-3"], ',', &[Some(0.125), Some(-1.5e-3)]),
            (&["1 000,5", "1'000", "-12"], ';', &[Some(1000.5), Some(1000.0), Some(-12.0)]),
            (&["1.5", "1,5"], ';', &[Some(1.5), None]),
            (&["1,5", "1.5"], ';', &[Some(1.5), None]),
            (&["1.234.567", "12.34.5"], ';', &[Some(1_234_567.0), None]),
            (&["", "nan", "#N/A", "--1", "1e999", "."], ',', &[None, None, None, None, None, None]),
        ] {
            let numbers = Numbers::of(column.iter().copied(), Numbers::mark_of(column.iter().copied()), by);
            let read: Vec<Option<f64>> = column.iter().map(|c| numbers.parse(c)).collect();
            assert_eq!(read, wants, "{column:?}");
        }
    }

    #[test]
    fn lone_thousands_beside_decimal_commas_have_two_readings() {
        let numbers = Numbers::of(["1.000"], Some(','), ';');
        assert_eq!(numbers.parse("1.000"), None);
        assert!(numbers.expected("1.000").contains("may part thousands"));
    }
}
