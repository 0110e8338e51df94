//! Imports any table with named columns.
//! Options: separator, number format, roles and units.

use super::{add_note, finite, record_of};
use rtec_files::clock_column::{self, ClockColumn, EpochTime, has_zone};
use rtec_files::csv::{Cell, Header, Reader, Row};
use rtec_files::text_file::rounded;
use rtec_files::{DecimalMarks, InputError, Result, TableNumberFormat, column_units};
use rtec_model::record::{Column, LINEAR, Record, Role, RunKind};
use std::borrow::Cow;
use std::path::Path;

/// A column of a table that is to be imported.
#[derive(Debug, Clone, PartialEq)]
pub struct ImportColumn {
    /// Name in the header, or number from 1 if the table has no header.
    pub column: String,
    /// Name in the record.
    pub name: String,
    /// Role in the record.
    pub role: Role,
    /// Unit in the record: the role's own, or any for a channel.
    pub unit: String,
    /// Factor and offset from the file's unit to that unit.
    pub scale: [f64; 2],
    /// Whether the user stated the unit; otherwise the column's name may state it.
    pub unit_given: bool,
    /// The file's unit, if the user stated it without a factor.
    pub unit_said: Option<String>,
}

impl ImportColumn {
    /// Parses `NAME=ROLE`, `NAME=ROLE:UNIT` or `NAME=ROLE:ANY*FACTOR=UNIT`.
    /// Examples: `gauge=error.z:mm`, `volt=force.x:V*35.15=N`.
    ///
    /// # Errors
    /// What was found and what was expected.
    pub fn parse(text: &str) -> Result<Self, (String, String)> {
        let form =
            "NAME=ROLE, NAME=ROLE:UNIT or NAME=ROLE:V*FACTOR=UNIT, as t=time:min or volt=force.x:V*35.15=N";
        let bad = |found: &str, expected: &str| (format!("`{found}`"), expected.to_owned());
        // A name may contain equal signs: split at the one before a role.
        let parts = text.match_indices('=').map(|(at, _)| (&text[..at], &text[at + 1..]));
        let role_of = |rest: &str| Role::parse(rest.split(':').next().unwrap_or(rest));
        let (name, rest) = parts
            .clone()
            .find(|(_, rest)| role_of(rest).is_some())
            .or_else(|| parts.clone().next())
            .ok_or_else(|| bad(text, form))?;
        let (role, unit) = rest.split_once(':').map_or((rest, None), |(r, u)| (r, Some(u)));
        let role = Role::parse(role)
            .ok_or_else(|| bad(role, "a role, as time, position.y, temperature, error.z"))?;
        if role.is_rotary(unit.unwrap_or_default()) {
            return Err(bad(rest, LINEAR));
        }
        let Some(unit) = unit else { return Self::of(name, name, role, None, 1.0, 0.0) };
        let Some((factor, unit)) =
            unit.split_once('*').map(|(_, rest)| rest.split_once('=').unwrap_or((rest, "")))
        else {
            return Self::of(name, name, role, Some(unit), 1.0, 0.0);
        };
        let number = finite(factor).filter(|v| *v != 0.0);
        let number = number.ok_or_else(|| bad(factor, "a factor that is no zero, as in V*35.15=N"))?;
        if unit.is_empty() {
            return Err(bad(rest, "the unit that the factor leads to, as in V*35.15=N"));
        }
        Ok(Self { unit_said: None, ..Self::of(name, name, role, Some(unit), number, 0.0)? })
    }

    /// A column with a quantity in a unit, after a factor and an offset.
    ///
    /// # Errors
    /// What was found and what was expected.
    pub fn of(
        column: &str,
        name: &str,
        role: Role,
        unit: Option<&str>,
        factor: f64,
        add: f64,
    ) -> Result<Self, (String, String)> {
        let own = role.unit();
        let unit = unit.map(column_units::plain);
        let (unit_there, further) = match (own, unit) {
            (None, any) => (any.unwrap_or("1"), [1.0, 0.0]),
            (Some(own), None) => (own, [1.0, 0.0]),
            (Some(own), Some(u)) if u == own => (own, [1.0, 0.0]),
            (Some(own), Some(u)) => {
                let others = column_units::others(own);
                let known: Vec<&str> = std::iter::once(own).chain(others.iter().map(|o| o.0)).collect();
                let error = || (format!("`{u}`"), format!("a unit of {role}: {}", known.join(", ")));
                let (_, f, a) = others.iter().find(|o| o.0 == u).ok_or_else(error)?;
                (own, [*f, *a])
            }
        };
        let scale = [factor * further[0], add * further[0] + further[1]];
        Ok(Self {
            column: column.to_owned(),
            name: column_units::with_unit_replaced(name, unit_there),
            unit: unit_there.to_owned(),
            role,
            scale,
            unit_given: unit.is_some(),
            unit_said: unit.map(str::to_owned),
        })
    }

    /// The record's column with these values.
    pub(super) fn filled(&self, data: Vec<f64>) -> Column {
        Column { unit: self.unit.clone(), ..Column::new(&self.name, self.role.clone(), data) }
    }

    /// The column in the unit that its header name states, and that unit.
    fn by_header(&self, header: &Header, place: usize) -> Result<(Self, Option<String>)> {
        let name = header.names().nth(place).unwrap_or_default();
        if let Some((said, stated)) =
            self.unit_said.as_deref().and_then(|s| Some((s, column_units::contradicted(name, s)?)))
        {
            let (role, found) = (&self.role, format!("column {name} as {said}: its name says {stated}"));
            let expected =
                format!("{name}={role}:{stated}, or {name}={role}:{said}*1={said} if the name is wrong");
            return Err(header.finding(found, expected));
        }
        let Some(stated) =
            column_units::stated(name).filter(|_| !self.unit_given && self.role.unit() != Some("1"))
        else {
            return Ok((self.clone(), None));
        };
        let [factor, add] = self.scale;
        match Self::of(&self.column, &self.name, self.role.clone(), Some(stated.unit), factor, add) {
            // Any word may follow a `_`, and any word is a valid unit of a channel.
            Ok(_) if self.role.unit().is_none() && !stated.in_brackets => Ok((self.clone(), None)),
            Ok(found) => {
                let is_other = self.role.unit().is_some_and(|own| own != stated.unit);
                Ok((found, is_other.then(|| format!("{name} in {}", stated.unit))))
            }
            Err((_, expected)) if stated.in_brackets => {
                let found = format!("the unit {} in the name of column {name}", stated.unit);
                let state = format!("{expected}; or its unit stated: {name}={}:UNIT", self.role);
                Err(header.finding(found, state))
            }
            Err(_) => Ok((self.clone(), None)),
        }
    }
}

/// Format of a table.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TableSyntax {
    /// Separator of columns: `,`, `;`, a tab, or a blank for any number of blanks.
    /// `None`: from the header line.
    pub by: Option<char>,
    /// Whether numbers have a decimal comma.
    /// `None`: allowed if semicolons separate the columns.
    pub decimal_comma: Option<bool>,
    /// Leading lines to skip.
    pub skip: usize,
    /// Whether it has no header line; columns are named by number, from 1.
    pub nameless: bool,
    /// Start of a comment, in addition to `#`.
    pub comment: Option<String>,
    /// Whether it is a log, which needs no response.
    pub log: bool,
}

/// The text in the form that the CSV reader accepts, with the same line numbers.
fn prepared<'t>(text: &'t str, form: &TableSyntax) -> Cow<'t, str> {
    if form.skip == 0 && form.comment.is_none() && form.by != Some(' ') {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len());
    for (i, line) in text.lines().enumerate() {
        let mut line = if i < form.skip { "" } else { line };
        if let Some(at) = form.comment.as_ref().and_then(|c| line.find(c.as_str())) {
            line = &line[..at];
        }
        if form.by == Some(' ') {
            // The first blank after a word becomes a tab, so columns of cells stay.
            let mut inside = false;
            for c in line.trim_end().chars() {
                let blank = c.is_whitespace();
                out.push(match (blank, inside) {
                    (false, _) => c,
                    (true, true) => '\t',
                    (true, false) => ' ',
                });
                inside = !blank;
            }
        } else {
            out.push_str(line);
        }
        out.push('\n');
    }
    Cow::Owned(out)
}

/// Expected first line of a table.
const HEADER: &str = "a header line";

/// Reads the wanted columns of a table.
/// Times may be ISO 8601: then time 0 is the first row's, and the record's note states its date.
///
/// # Errors
/// A wanted column that is missing or occurs twice, a row that is too short or too long, a field that is not
/// a number, and errors of [`Record::new`].
pub fn table(
    from: &Path,
    text: &str,
    wanted: &[ImportColumn],
    form: &TableSyntax,
    kind: RunKind,
    to: &Path,
) -> Result<Record> {
    let (whole, text) = (text, prepared(text, form));
    let (mut reader, header) = opened(from, &text, wanted, form)?;
    let places = wanted
        .iter()
        .map(|w| match &header {
            Some(header) => header.place_or_number(&w.column),
            None => w.column.parse::<usize>().ok().and_then(|n| n.checked_sub(1)).ok_or_else(|| {
                let expected = "a column's number, from 1: the table has no names";
                InputError::whole(from, format!("column `{}`", w.column), expected)
            }),
        })
        .collect::<Result<Vec<_>, _>>()?;
    let mut by_name = Vec::new();
    let of = |(w, place): (&ImportColumn, &usize)| {
        let Some(header) = &header else { return Ok(w.clone()) };
        let (column, stated) = w.by_header(header, *place)?;
        by_name.extend(stated);
        Ok(column)
    };
    let own: Vec<ImportColumn> = wanted.iter().zip(&places).map(of).collect::<Result<_>>()?;
    let (wanted, places, clock_place) = with_one_time(own, places);
    let wanted = wanted.as_slice();
    let (numbers, written) = numbers(from, &text, wanted, form, &places)?;
    let mut data = vec![Vec::new(); wanted.len()];
    let mut clock = TimeColumnState::of(&text, wanted, &places, reader.separator());
    let by = reader.separator();
    let cut = cut_line(whole, by);
    while let Some(row) = reader.row()? {
        if cut == Some(row.line()) {
            continue;
        }
        let cells = cells(header.as_ref(), row, form, by)?;
        for (((w, place), numbers), data) in wanted.iter().zip(&places).zip(&numbers).zip(&mut data) {
            let cell = cells.get(*place).ok_or_else(|| {
                row.finding(format!("{} fields", cells.len()), format!("a field {}", place + 1))
            })?;
            let named = |e: InputError| match &header {
                Some(header) => header.named(*place, e),
                None => InputError { found: format!("{} in column {}", e.found, place + 1), ..e },
            };
            let is_time = w.role == Role::Time && (w.scale[0] - 1.0 == 0.0) && w.scale[1] == 0.0;
            let of_day = clock_place.filter(|_| is_time).and_then(|place| cells.get(place));
            let moment = of_day.map_or(Cow::Borrowed(cell.text()), |clock| joined(cell.text(), clock.text()));
            if is_time && let Some(s) = clock.moment(&moment, data.is_empty()) {
                if let Some(expected) = clock.set_back(&moment, s, data) {
                    return Err(named(cell.finding(expected)));
                }
                data.push(s);
                continue;
            }
            if is_time && clock.moments.start().is_some() {
                let expected = clock_column::expected_instead(cell.text())
                    .filter(|_| clock_column::has_two_days(cell.text()));
                let as_before = "a time as in the rows before, 2022-08-08T13:51:37.25Z or 13:51:37";
                return Err(named(cell.finding(expected.unwrap_or(as_before))));
            }
            let number = numbers.parse(cell.text()).ok_or_else(|| {
                let in_units = data.is_empty() && cells.iter().all(|cell| is_unit(cell.text()));
                named(cell.finding(expected_of(cell.text(), is_time, in_units, *numbers)))
            })?;
            if w.role == Role::Time && w.scale[1] == 0.0 {
                let number = clock.number(number, w, data.is_empty());
                data.push(rounded(number.map_err(|expected| named(cell.finding(expected)))? * w.scale[0]));
                continue;
            }
            let is_own = w.scale[0].to_bits() == 1.0_f64.to_bits() && w.scale[1] == 0.0;
            data.push(if is_own { number } else { rounded(number * w.scale[0] + w.scale[1]) });
        }
    }
    if data.first().is_none_or(Vec::is_empty) {
        return Err(match &header {
            Some(header) => reader.rows_are_comments().unwrap_or_else(|| header.no_rows()),
            None => InputError::whole(from, "no rows", "at least one"),
        });
    }
    let columns = wanted.iter().zip(data).map(|(w, data)| w.filled(data)).collect();
    let mut record = record_of(to, kind, columns, form.log)?;
    let by_name = (!by_name.is_empty())
        .then(|| format!("{}: read by its name: {}", from.display(), by_name.join(", ")));
    let said: Vec<String> = written.into_iter().chain(by_name).collect();
    record.written = (!said.is_empty()).then(|| said.join("; "));
    clock.note(&mut record);
    if let Some(line) = cut {
        let why = "it has no line end, and its last number has fewer decimals than those before";
        add_note(&mut record, &format!("line {line}, the last, was left out: {why}; was the log cut off?"));
    }
    Ok(record)
}

/// Merges date and time of day in two columns into one time column.
/// Returns the columns, their places, and the place of the second column.
fn with_one_time(
    mut wanted: Vec<ImportColumn>,
    mut places: Vec<usize>,
) -> (Vec<ImportColumn>, Vec<usize>, Option<usize>) {
    let times: Vec<usize> = (0..wanted.len()).filter(|k| wanted[*k].role == Role::Time).collect();
    let [_, second] = *times else { return (wanted, places, None) };
    wanted.remove(second);
    let place = places.remove(second);
    (wanted, places, Some(place))
}

/// Joins a date and a time of day given in either order.
fn joined(one: &str, other: &str) -> Cow<'static, str> {
    Cow::Owned(if clock_column::is_day(one) { format!("{one} {other}") } else { format!("{other} {one}") })
}

/// A reader of the table after its header, and the header if there is one.
fn opened<'t>(
    from: &Path,
    text: &'t str,
    wanted: &[ImportColumn],
    form: &TableSyntax,
) -> Result<(Reader<&'t [u8]>, Option<Header>)> {
    let mut reader = Reader::new(from, text.as_bytes())?;
    if let Some(by) = form.by {
        reader = reader.parted_by(if by == ' ' { '\t' } else { by });
    }
    let columns: Vec<&str> = wanted.iter().map(|w| w.column.as_str()).collect();
    let header = match (form.nameless, form.by) {
        (true, _) => None,
        (false, Some(_)) => {
            let header = reader.header(HEADER)?;
            Some(reader.or_numbers(header, &columns))
        }
        (false, None) => Some(reader.header_of(HEADER, &columns)?),
    };
    Ok((reader, header))
}

/// The expected content of a cell that is not a number.
fn expected_of(cell: &str, is_time: bool, in_units: bool, numbers: DecimalMarks) -> &'static str {
    if let Some(expected) = clock_column::expected_instead(cell).filter(|_| is_time) {
        expected
    } else if in_units {
        "a finite number: a line of units is to be deleted, --columns states them, as t=time:min"
    } else {
        numbers.expected(cell)
    }
}

/// Whether the text is empty or may be a unit: short and not a number.
fn is_unit(text: &str) -> bool {
    let bare = text.trim_matches(['(', ')', '[', ']', '\'', ' ']);
    bare.chars().count() <= 8 && !bare.starts_with(|c: char| c.is_ascii_digit() || "+-.".contains(c))
}

/// Fewest rows with equal decimals that show a program's number format.
const ALIKE_ROWS: usize = 5;

/// The last line, from 1, if the log was cut off within its last number.
/// Such a line has no line end, and fewer decimals than all others.
fn cut_line(text: &str, by: char) -> Option<usize> {
    if text.ends_with(['\n', '\r']) {
        return None;
    }
    let decimals = |line: &str| -> Option<usize> {
        let cell = line.trim_end().rsplit(by).next()?.trim();
        let is_number = cell.bytes().all(|b| b.is_ascii_digit() || b"+-.,eE".contains(&b));
        (is_number && cell.contains(|c: char| c.is_ascii_digit())).then_some(())?;
        Some(cell.rsplit_once(['.', ',']).map_or(0, |(_, fraction)| fraction.len()))
    };
    let lines: Vec<&str> = text.lines().collect();
    let (last, before) = lines.split_last()?;
    // Stops at the header and the lines before it, which have no number there.
    let counts: Vec<usize> = before.iter().rev().map_while(|line| decimals(line)).collect();
    let usual = *counts.first()?;
    let cut = counts.len() >= ALIKE_ROWS && counts.iter().all(|n| *n == usual) && decimals(last)? < usual;
    cut.then_some(lines.len())
}

/// An hour of summer time, s.
const SUMMER_S: f64 = 3600.0;
/// Values of a counter of 32 bits.
const COUNTER: f64 = 4_294_967_296.0;

/// Order of day and month in a column; `None` if no cell looks like a date.
fn slash_order(text: &str, place: usize, by: char) -> Option<clock_column::SlashDateOrder> {
    let is_date = |cell: &str| cell.contains(['/', '-']);
    is_date(text).then_some(())?;
    let cell =
        |line: &str| line.split(by).nth(place).map(|cell| cell.trim_matches(['"', ' ', '\r']).to_owned());
    let cells: Vec<String> = text.lines().filter_map(cell).filter(|cell| is_date(cell)).collect();
    clock_column::slash_order(cells.iter().map(String::as_str))
}

/// State of a time column that may not begin with the run.
#[derive(Default)]
struct TimeColumnState {
    moments: ClockColumn,
    /// The last time as written.
    written: String,
    /// The first row's time in the column's unit, if its epoch is long before the run.
    counted: Option<(f64, EpochTime)>,
    /// The last numeric time, in the file's unit.
    last: Option<f64>,
}

impl TimeColumnState {
    /// For a table's time column, whose dates may show their order.
    fn of(text: &str, wanted: &[ImportColumn], places: &[usize], by: char) -> Self {
        let time = wanted.iter().zip(places).find(|(w, _)| w.role == Role::Time);
        let order = time.and_then(|(_, place)| slash_order(text, *place, by));
        Self { moments: ClockColumn::of_order(order), ..Self::default() }
    }

    /// Seconds since the first row, of a date or a time of day.
    fn moment(&mut self, text: &str, first: bool) -> Option<f64> {
        if !first && self.moments.start().is_none() {
            return None;
        }
        Some(self.moments.since_start(text)? as f64 / 1e9)
    }

    /// Message about a time set back by an hour, as at the end of summer time.
    /// `before` are the times so far.
    fn set_back(&mut self, text: &str, s: f64, before: &[f64]) -> Option<String> {
        let last = std::mem::replace(&mut self.written, text.to_owned());
        let [.., a, b] = before else { return None };
        let step = b - a;
        let hour = (b + step - s - SUMMER_S).abs() <= 0.5 * step + 1.0;
        (s < *b && hour && !has_zone(text)).then(|| {
            format!(
                "a time after {last}: was the clock set back from summer time? Write the times with their offset, as \
                 2025-10-26T02:00:00+01:00"
            )
        })
    }

    /// Parses a numeric time, or returns what was expected.
    /// It is relative to the first row if its epoch is long before the run.
    fn number(&mut self, number: f64, w: &ImportColumn, first: bool) -> Result<f64, String> {
        let in_days = (w.scale[0] - column_units::DAY_S).abs() < 0.5;
        let in_filetime = w.scale[0].to_bits() == column_units::FILETIME_S.to_bits();
        let counted = || match () {
            () if in_days => clock_column::spreadsheet(number),
            () if in_filetime => clock_column::filetime(number),
            () => clock_column::recognise_epoch_time(number * w.scale[0]),
        };
        let instead = |time: &str, EpochTime { unit, what, .. }: EpochTime| {
            format!("a time in {time}: this is {what} in {unit}, as {}=time:{unit}", w.column)
        };
        if first && let Some(found) = counted() {
            if !matches!(found.unit, "s" | "d") && !in_filetime {
                return Err(instead("s, or its unit", found));
            }
            self.counted = Some((number, found));
        } else if let Some(found) =
            clock_column::recognise_epoch_time(number).filter(|_| first && w.scale[0] > 1.0)
        {
            // The number is a clock in its own unit, but not in minutes or hours.
            return Err(instead("the unit of its clock", found));
        }
        if self.last.replace(number).is_some_and(|last| last < COUNTER && last - number > 0.9 * COUNTER) {
            let again = "a counter of 32 bits has begun again";
            return Err(format!("a time that never decreases: {again}; add {COUNTER} from this row on"));
        }
        Ok(number - self.counted.as_ref().map_or(0.0, |(first, _)| *first))
    }

    /// Adds the date of time 0 and oddities of the clock to the note.
    fn note(self, record: &mut Record) {
        if let Some(text) = self.moments.start() {
            if let Some(day) = self.moments.first_day() {
                record.date = Some(day);
            }
            add_note(record, &format!("time 0 is {text}"));
        }
        if let Some((first, EpochTime { what, day, .. })) = self.counted {
            add_note(record, &format!("time 0 is {first}, {what} of {day}"));
            record.date = Some(day);
        }
        let local = self.moments.start().is_some_and(|text| !has_zone(text));
        let gap = record.data(&Role::Time).and_then(put_forward).filter(|_| local);
        if let Some((row, gap_s, usual_s)) = gap {
            let text = format!(
                "row {row} is {gap_s} s after the row before, the others {usual_s} s: was the clock put forward to summer time? \
                 Then write the times with their offset, as 2025-03-30T03:00:00+02:00"
            );
            add_note(record, &text);
        }
    }
}

/// The one row that comes an hour late, from 1.
/// Also its time step and the usual one, s.
fn put_forward(times: &[f64]) -> Option<(usize, f64, f64)> {
    let mut steps: Vec<f64> = times.windows(2).map(|w| w[1] - w[0]).collect();
    let at = steps.iter().position(|s| *s >= SUMMER_S)?;
    let gap = steps.swap_remove(at);
    steps.sort_by(f64::total_cmp);
    let (usual, most) = (*steps.get(steps.len() / 2)?, *steps.last()?);
    let is_hour = usual > 0.0 && most < 0.5 * SUMMER_S && (gap - usual - SUMMER_S).abs() <= 0.5 * usual + 1.0;
    let tidy = |s: f64| (s * 1e3).round() / 1e3;
    is_hour.then(|| (at + 2, tidy(gap), tidy(usual)))
}

/// Number format of each wanted column, and a message about it.
/// From the form, or from all cells of the column.
fn numbers(
    from: &Path,
    text: &str,
    wanted: &[ImportColumn],
    form: &TableSyntax,
    places: &[usize],
) -> Result<(Vec<DecimalMarks>, Option<String>)> {
    if let Some(comma) = form.decimal_comma {
        return Ok((vec![DecimalMarks::written(if comma { ',' } else { '.' }); places.len()], None));
    }
    let (mut reader, _) = opened(from, text, wanted, form)?;
    let marks = TableNumberFormat::of(&mut reader)?;
    let written = if form.by.is_none() { marks.written(from) } else { marks.questions(from) };
    Ok((places.iter().map(|place| marks.numbers(*place)).collect(), written))
}

fn cells<'a>(header: Option<&Header>, row: Row<'a>, form: &TableSyntax, by: char) -> Result<Vec<Cell<'a>>> {
    let Some(header) = header else { return Ok(row.cells().collect()) };
    header.cells(row).map_err(|e| {
        let (fields, names) = (row.cells().count(), header.names().count());
        if by == ',' && form.decimal_comma != Some(true) && row.has_decimal_commas(names) {
            let found = format!("{fields} fields in {names} columns: decimal commas between commas?");
            let expected = "numbers with a decimal point, or columns parted by semicolons or tabs";
            return row.finding(found, expected);
        }
        e
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_a_log_cut_off_within_a_number() {
        let rows = "t,e\n0,21.50\n1,21.52\n2,21.53\n3,21.53\n4,21.55\n";
        assert_eq!(cut_line(&format!("{rows}5,2"), ','), Some(7));
        for whole in ["", "5,21.56", "5,21.56\n", "5,2\n"] {
            assert_eq!(cut_line(&format!("{rows}{whole}"), ','), None, "{whole}");
        }
        // Some programs omit trailing zeros.
        assert_eq!(cut_line("e\n1.5\n1.25\n1.5\n1.5\n1.5\n2", ','), None);
    }

    #[test]
    fn finds_an_hour_that_a_clock_was_put_forward() {
        assert_eq!(put_forward(&[0.0, 10.0, 3620.0, 3630.0]), Some((3, 3610.0, 10.0)));
        for times in [&[0.0, 10.0, 20.0][..], &[0.0, 10.0, 2000.0, 2010.0], &[0.0, 3600.0, 7200.0]] {
            assert_eq!(put_forward(times), None, "{times:?}");
        }
    }
}
