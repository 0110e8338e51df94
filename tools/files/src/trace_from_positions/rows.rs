//! The rows of a position record.

use super::impossible_jumps::range_of;
use super::{LENGTHS, PositionRecord, TIMES};
use crate::clock_column::{self, ClockColumn};
use crate::csv::{Header, Reader};
use crate::text_file::open_regular;
use crate::{InputError, TableNumberFormat, column_units};

/// The rows of a position record, as time in ns and position in counts.
pub(super) struct PositionRows {
    rows: Reader<std::fs::File>,
    /// Number format; `None` for decimal points and commas as separators.
    pub(super) marks: Option<TableNumberFormat>,
    header: Header,
    pub(super) line: usize,
    time: usize,
    ns_per_unit: f64,
    position: usize,
    counts_per_unit: f64,
    last_ns: Option<u64>,
    time_unit: &'static str,
    /// Range of a counter that wraps around, counts; 0 for none.
    /// Below: its last reading, and the sum of its wraps.
    range: f64,
    last_counts: Option<f64>,
    begun_again: f64,
    /// Times that are dates or times of the day.
    pub(super) moments: ClockColumn,
    /// Offset subtracted from each numeric time, and the first time in words.
    /// The words are empty if nothing is subtracted.
    pub(super) start: Option<(f64, String)>,
    /// A note about a position column that names no unit.
    pub(super) without_unit: Option<String>,
}

/// The unit of a column: the option's, else that of its name.
/// The two must not contradict each other.
/// None if its name has no unit; an unknown one in brackets is refused.
fn unit_of(
    header: &Header,
    place: usize,
    given: Option<&str>,
    units: [(&'static str, f64); 5],
    option: &str,
) -> Result<Option<(&'static str, f64)>, InputError> {
    let name = header.names().nth(place).unwrap_or_default();
    let stated = column_units::stated(name);
    if let Some((unit, stated)) = given.and_then(|unit| Some((unit, column_units::contradicted(name, unit)?)))
    {
        let found = format!("the column {name} with {option} {unit}: its name says {stated}");
        let expected = format!("{option} {stated}, or none; or another name if that is wrong");
        return Err(header.finding(found, expected));
    }
    let unit = given.or(stated.as_ref().map(|stated| stated.unit));
    let known = units.into_iter().find(|(name, _)| unit == Some(*name));
    if let (Some(unit), None, true) = (unit, known, stated.is_some_and(|stated| stated.in_brackets)) {
        let found = format!("the unit {unit} in the name of column {name}");
        return Err(header.finding(found, format!("one of {}, or {option}", units.map(|u| u.0).join(", "))));
    }
    Ok(known)
}

impl PositionRows {
    pub(super) fn open(record: &PositionRecord, counter_bits: u32) -> Result<Self, InputError> {
        let mut rows = Reader::open(&record.file)?;
        let options = &record.options;
        let named = [&options.column, &options.time_column].into_iter().flatten().map(String::as_str);
        let named: Vec<&str> = named.collect();
        let expected = "a header such as t_s,position_mm";
        let time_of = |name: &str| {
            let stated = column_units::stated(name)?;
            let is_time = stated.name == "t" || stated.name.eq_ignore_ascii_case("time");
            TIMES.into_iter().find(|(unit, _)| is_time && *unit == stated.unit)
        };
        let header = if named.is_empty() {
            let has_both = |header: &Header| {
                header.names().any(|name| time_of(name).is_some())
                    && header.names().any(|name| name.starts_with("position"))
            };
            rows.header_where(expected, has_both)?
        } else {
            rows.header_of(expected, &named)?
        };
        let columns = || format!("the columns {}", header.text());
        let (time, (time_unit, ns_per_unit)) = if let Some(column) = &options.time_column {
            let place = header.place_or_number(column)?;
            let unit = unit_of(&header, place, options.time_unit.as_deref(), TIMES, "--time-unit")?;
            (place, unit.unwrap_or(TIMES[0]))
        } else {
            let mut named = header.names().enumerate();
            named.find_map(|(place, name)| Some((place, time_of(name)?))).ok_or_else(|| {
                let expected = "a time column: t_s, t_ms, t_us or t_ns, or --time-column";
                let finding = header.is_missing().unwrap_or_else(|| header.finding(columns(), expected));
                rows.instead_of(&header, finding)
            })?
        };
        let position = if let Some(column) = &options.column {
            header.place_or_number(column)?
        } else {
            let mut matching = header.names().enumerate().filter(|(_, name)| name.starts_with("position"));
            let (Some((position, _)), None) = (matching.next(), matching.next()) else {
                let expected = "one column whose name begins with position (or --column NAME)";
                return Err(rows.instead_of(&header, header.finding(columns(), expected)));
            };
            position
        };
        let length = unit_of(&header, position, options.unit.as_deref(), LENGTHS, "--unit")?;
        let without_unit = length.is_none().then(|| {
            let name = header.names().nth(position).unwrap_or_default();
            format!("{}: column '{name}' names no unit: taken as m (see --unit)", record.file.display())
        });
        let (_, unit_um) = length.unwrap_or(LENGTHS[0]);
        // A pipe cannot be read twice, so its numbers must have decimal points.
        let names = || [time, position].into_iter().filter_map(|place| header.names().nth(place)).collect();
        let named: Vec<&str> = if named.is_empty() { names() } else { named };
        let marks = if record.file.is_file() {
            TableNumberFormat::find(&record.file, &mut open_regular(&record.file)?, &named)?
        } else {
            None
        };
        let counts_per_unit = unit_um / record.count_um;
        Ok(Self {
            rows,
            marks,
            header,
            line: 0,
            time,
            time_unit,
            ns_per_unit,
            position,
            counts_per_unit,
            last_ns: None,
            range: if counter_bits > 0 { range_of(counter_bits) } else { 0.0 },
            last_counts: None,
            begun_again: 0.0,
            moments: ClockColumn::default(),
            start: None,
            without_unit,
        })
    }

    pub(super) fn next(&mut self) -> Result<Option<(u64, f64)>, InputError> {
        let Some(row) = self.rows.row()? else { return Ok(None) };
        self.line = row.line();
        let (mut time, mut counts) = (0.0, 0.0);
        self.header.each(row, |place, cell| {
            let numbers = self.marks.as_ref().map(|marks| marks.numbers(place));
            let finite = |name| {
                let number = match numbers {
                    None => cell.finite().ok(),
                    Some(numbers) => numbers.parse(cell.text()),
                };
                let expected = || numbers.map_or("a finite number", |n| n.expected(cell.text()));
                number.ok_or_else(|| cell.finding(format!("the {name}: {}", expected())))
            };
            if place == self.time {
                let first = self.start.is_none();
                if first && let Some(ns) = self.moments.since_start(cell.text()) {
                    time = ns as f64;
                    return Ok(());
                }
                if let Some(start) = self.moments.start() {
                    let slashes = clock_column::expected_instead(cell.text())
                        .filter(|_| clock_column::has_two_days(cell.text()));
                    let expected =
                        slashes.map_or_else(|| format!("a time as in the first row, {start}"), str::to_owned);
                    return Err(cell.finding(expected));
                }
                let written =
                    || clock_column::expected_instead(cell.text()).map(|expected| cell.finding(expected));
                let read = finite("time").map_err(|e| written().unwrap_or(e))?;
                if first && clock_column::filetime(read).is_some() {
                    let name = self.header.names().nth(place).unwrap_or_default();
                    let found = format!("{read} in column {name}, Windows FILETIME in steps of 100 ns");
                    return Err(cell.finding_with_text(
                        found,
                        "a time in s, ms, µs or ns since the start: (t - first) / 10 is one in µs",
                    ));
                }
                if first
                    && self.time_unit == "d"
                    && let Some(date) = clock_column::spreadsheet(read)
                {
                    self.start = Some((read, format!("{read}, {} of {}", date.what, date.day)));
                }
                if first && let Some((unit, day)) = clock_column::unix(read) {
                    if unit != self.time_unit {
                        let name = self.header.names().nth(place).unwrap_or_default();
                        let found = format!("{read} in column {name}, Unix time in {unit}");
                        return Err(cell.finding_with_text(
                            found,
                            format!("a time in {}; or the column called t_{unit}", self.time_unit),
                        ));
                    }
                    self.start = Some((read, format!("{read}, Unix time of {day}")));
                }
                // A scope's time is 0 at its trigger.
                let start = || {
                    if read < 0.0 {
                        (read, format!("{read} {}, before a trigger", self.time_unit))
                    } else {
                        (0.0, String::new())
                    }
                };
                let start = self.start.get_or_insert_with(start).0;
                time = (read - start) * self.ns_per_unit;
            }
            if place == self.position {
                counts = finite("position")? * self.counts_per_unit;
            }
            Ok(())
        })?;
        if self.range > 0.0 {
            let step = counts - self.last_counts.replace(counts).unwrap_or(counts);
            self.begun_again -= self.range * (step / self.range).round();
            counts += self.begun_again;
        }
        // Beyond 2^53 a time in ns or a count is no longer exact in a float.
        let exact = 9_007_199_254_740_992.0;
        if !(0.0..exact).contains(&time) {
            return Err(row.finding("a time out of range", "a time from 0 to 104 days"));
        }
        if counts.abs() >= exact {
            return Err(row.finding("a position out of range", "a position below 2^53 counts"));
        }
        let t_ns = time.round() as u64;
        if let Some(last) = self.last_ns
            && t_ns <= last
        {
            let expected = format!("a time after the row before, {} s", last as f64 / 1e9);
            return Err(row.finding(format!("the time {} s", t_ns as f64 / 1e9), expected));
        }
        self.last_ns = Some(t_ns);
        Ok(Some((t_ns, counts)))
    }
}
