//! Recorded quadrature.
//! Traces are CSV (`t_ns,a,b`) or VCD (IEEE 1364); requested totals are CSV.
//!
//! Readers stream: memory stays flat for a file of any length. A trace has one row per change and strictly
//! rising times. A row in which both signals change is passed on, because the engine reports illegal
//! transitions.
//!
//! Other programs use other names, and times in seconds: [`ColumnAssignment`] assigns them. If a table has other
//! columns too, rows in which neither a nor b changes belong to those, and are skipped.

use crate::atomic_write::AtomicFile;
use crate::clock_column::{self, ClockColumn};
use crate::column_units;
use crate::csv::{self, Cell, Header};
use crate::csv_table::ColumnAssignment;
use crate::file_kind::FileKind;
use crate::input_error::InputError;
use crate::line_reader::BUFFER;
use crate::table_number_format::{DecimalMarks, TableNumberFormat};
use crate::text_file::{open_regular, opened};
use crate::vcd::VcdReader;
use rtec_driver::quadrature::State;
use rtec_driver::trace_replay::{RequestedTotal, TracePoint};
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

/// Longest plain row, `18446744073709551615,1,1\r\n`, rounded up.
const PLAIN_ROW: usize = 32;

/// Number of first bytes that show the kind of a file.
const BEGIN: usize = 4096;

/// The file format of a trace.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TraceFormat {
    /// `t_ns,a,b`, one row per change.
    Csv,
    /// Value change dump, IEEE 1364, signals `a` and `b`.
    Vcd,
}

impl TraceFormat {
    /// The format that a file's extension names.
    ///
    /// # Errors
    /// The extension is neither `.csv` nor `.vcd`.
    pub fn of(file: &Path) -> Result<Self, InputError> {
        let extension = file.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
        match extension.as_str() {
            "csv" => Ok(Self::Csv),
            "vcd" => Ok(Self::Vcd),
            "" => Err(InputError::whole(file, "no extension", "a trace ending in .csv or .vcd")),
            other => {
                Err(InputError::whole(file, format!("extension .{other}"), "a trace ending in .csv or .vcd"))
            }
        }
    }
}

/// Reads a trace point by point; after an error it yields nothing more.
#[derive(Debug)]
pub struct TraceReader<R> {
    rows: csv::Reader<R>,
    last: Option<TracePoint>,
    points: TracePointSource,
    /// The latest time that is accepted, ns.
    latest_ns: u64,
    done: bool,
}

#[derive(Debug)]
enum TracePointSource {
    /// Rows of a table.
    /// It is plain if it has `t_ns,a,b` in this order and nothing else.
    Csv {
        table: Box<TraceColumns<3>>,
        is_plain: bool,
    },
    Vcd(VcdReader),
}

/// The places of a table's columns, and the format of its whole numbers.
#[derive(Debug)]
struct TraceColumns<const N: usize> {
    header: Header,
    places: [usize; N],
    /// Number of decimals that turn the time's unit into ns.
    shift: usize,
    /// The file, if it can be read twice to learn its decimal marks.
    /// `columns` are the columns that are read for that.
    file: Option<PathBuf>,
    columns: Vec<String>,
    numbers: Option<[DecimalMarks; N]>,
    /// State for times that are dates or times of the day.
    moments: ClockColumn,
    /// Whether no time has been read yet.
    at_start: bool,
    /// The zero of the times, ns.
    /// It is below zero if a scope was triggered after its first sample.
    origin_ns: i64,
    /// Whether the table has a row for each sample, not for each change.
    is_sampled: bool,
}

/// Names of a time column, each with the decimals that turn it into ns.
const TIMES: [(&str, usize); 4] = [("t_ns", 0), ("t_us", 3), ("t_ms", 6), ("t_s", 9)];

impl<const N: usize> TraceColumns<N> {
    /// A table with a time and these columns.
    /// They are in this order unless the user has assigned them.
    fn new<R: Read>(
        rows: &mut csv::Reader<R>,
        names: [&str; N],
        columns: &ColumnAssignment,
        file: Option<&Path>,
    ) -> Result<Self, InputError> {
        let option = if N == COLUMNS.len() { "--columns" } else { "--request-columns" };
        let otherwise = format!(", or {option} with the columns' names or numbers");
        let (mut shift, mut wanted) = (0, names.map(str::to_owned));
        let header = if columns.is_empty() {
            rows.expect_header(names, &otherwise)?
        } else {
            let of_file = |name: &str| columns.place_of(name).map(str::to_owned);
            let times: Vec<_> = TIMES.iter().filter_map(|(t, n)| Some((of_file(t)?, *n))).collect();
            let [(time, decimals)] = times.as_slice() else {
                let known = TIMES.map(|(t, _)| t).join(", ");
                let found = if times.is_empty() { "no time" } else { "two times" };
                return Err(InputError::whole(Path::new(option), found, format!("one of {known}")));
            };
            shift = *decimals;
            wanted[0].clone_from(time);
            for (wanted, name) in wanted.iter_mut().zip(names).skip(1) {
                *wanted = of_file(name).ok_or_else(|| {
                    let expected = format!("{name}=COLUMN, the file's name or number");
                    InputError::whole(Path::new(option), format!("no {name}"), expected)
                })?;
            }
            rows.header_of("a header line", &wanted.each_ref().map(String::as_str))?
        };
        let mut places = [0; N];
        for (place, column) in places.iter_mut().zip(&wanted) {
            *place = header.place_or_number(column).map_err(|e| rows.instead_of(&header, e))?;
        }
        if (1..N).any(|n| places[..n].contains(&places[n])) {
            return Err(header.finding("one column for two names", "every column once"));
        }
        let time = header.names().nth(places[0]).unwrap_or_default();
        let stated = column_units::stated(time).and_then(|s| TIMES.iter().find(|(t, _)| t[2..] == *s.unit));
        if let Some((name, _)) = stated.filter(|(_, decimals)| *decimals != shift) {
            let found = format!("the column {time} as {}", TIMES[shift / 3].0);
            return Err(header.finding(found, format!("its own unit: {option} {name}={time}")));
        }
        let (file, moments) = (file.map(Path::to_owned), ClockColumn::default());
        let columns = wanted.to_vec();
        Ok(Self {
            header,
            places,
            shift,
            file,
            columns,
            numbers: None,
            moments,
            at_start: true,
            origin_ns: 0,
            is_sampled: false,
        })
    }

    /// Whether the table has other columns too.
    fn has_others(&self) -> bool {
        self.header.names().count() > N
    }

    fn cells<'a>(&self, row: csv::Row<'a>) -> Result<[Cell<'a>; N], InputError> {
        let cells = self.header.cells(row)?;
        Ok(self.places.map(|place| cells[place].clone()))
    }

    /// The whole number in a cell of column `n`, in the smallest unit.
    /// Its decimal mark is moved to the right.
    fn whole<T: std::str::FromStr>(
        &mut self,
        n: usize,
        cell: &Cell<'_>,
        shift: usize,
        by: char,
        expected: &str,
    ) -> Result<T, InputError> {
        let first = n == 0 && std::mem::take(&mut self.at_start);
        if shift == 0
            && (n > 0 || self.origin_ns == 0)
            && let Ok(number) = cell.text().parse()
        {
            return Ok(number);
        }
        let numbers = match self.numbers {
            Some(numbers) => numbers[n],
            None => self.find_numbers(by)?[n],
        };
        // A whole number has no decimals: a lone mark in it more likely separates thousands.
        let is_open = shift == 0 && numbers.leaves_open(cell.text());
        let plain = numbers.plain(cell.text()).filter(|_| !is_open);
        if n == 0 {
            let is_number = plain.as_deref().and_then(crate::decimal_parser::number).is_some();
            if !is_number && (first || self.moments.start().is_some()) {
                let ns = self.moments.absolute(cell.text()).and_then(|ns| ns.to_string().parse().ok());
                let expected = clock_column::expected_instead(cell.text()).unwrap_or(expected);
                return ns.ok_or_else(|| cell.finding(expected));
            }
            let unix = plain.as_deref().and_then(|plain| clock_column::unix(plain.parse().ok()?));
            if let Some((unit, _)) = unix.filter(|(unit, _)| first && *unit != &TIMES[shift / 3].0[2..]) {
                let found = format!("{}, Unix time in {unit}", cell.text());
                return Err(cell.finding_with_text(found, format!("a time in its own unit: t_{unit}=COLUMN")));
            }
        }
        let digits = plain.and_then(|plain| shifted(&plain, shift));
        if n == 0 {
            let ns = digits.as_deref().and_then(|digits| digits.parse::<i64>().ok());
            if N == COLUMNS.len() && first && ns.is_some_and(|ns| ns < 0) {
                self.origin_ns = ns.unwrap_or(0);
            }
            if self.origin_ns != 0 {
                let since = ns.and_then(|ns| ns.checked_sub(self.origin_ns)?.to_string().parse().ok());
                return since.ok_or_else(|| cell.finding(expected));
            }
        }
        let whole = digits.and_then(|digits| digits.parse().ok());
        whole.ok_or_else(|| cell.finding(expected))
    }

    /// The zero of the times in words, if they are dates or times of the day.
    /// It also says if times begin before a trigger.
    fn notes(&self) -> Option<String> {
        let since =
            |start| if clock_column::of_day_ns(start).is_some() { "midnight" } else { "1970-01-01 UTC" };
        let start = self
            .moments
            .start()
            .map(|start| format!("the first time is {start}; ns are counted since {}", since(start)));
        let origin = (N == COLUMNS.len() && self.origin_ns < 0).then(|| {
            format!("the first time is {} ns, before a trigger; ns are counted from it, those of the requests too", self.origin_ns)
        });
        let said: Vec<String> = start.into_iter().chain(origin).collect();
        (!said.is_empty()).then(|| format!("{}: {}", self.header.file().display(), said.join("; ")))
    }

    /// The number formats of the columns.
    /// All cells decide, if the file can be read twice.
    fn find_numbers(&mut self, by: char) -> Result<[DecimalMarks; N], InputError> {
        let columns: Vec<&str> = self.columns.iter().map(String::as_str).collect();
        let marks = match self.file.as_deref() {
            Some(file) => TableNumberFormat::find(file, &mut open_regular(file)?, &columns)?,
            None => None,
        };
        let of =
            |place| marks.as_ref().map_or(DecimalMarks::shown(None, None, by), |marks| marks.numbers(place));
        Ok(*self.numbers.insert(self.places.map(of)))
    }
}

/// The digits of a number whose decimal mark is moved right by some places.
/// It is rounded to a whole number.
fn shifted(plain: &str, places: usize) -> Option<String> {
    if plain.contains(['e', 'E']) {
        // Above 2^53 a float cannot hold every whole number.
        let number = crate::decimal_parser::number(plain)? * 10_f64.powi(places as i32);
        return (number.abs() < 9_007_199_254_740_992.0).then(|| format!("{number:.0}"));
    }
    let (whole, fraction) = plain.split_once('.').unwrap_or((plain, ""));
    if !fraction.bytes().all(|byte| byte.is_ascii_digit()) {
        return None;
    }
    if places == 0 {
        return fraction.bytes().all(|byte| byte == b'0').then(|| whole.to_owned());
    }
    let kept = &fraction[..places.min(fraction.len())];
    let digits = format!("{whole}{kept:0<places$}");
    // Halves are rounded up, because times are never negative.
    match fraction.as_bytes().get(places) {
        None | Some(b'0'..=b'4') => Some(digits),
        Some(_) => Some((digits.parse::<u64>().ok()? + 1).to_string()),
    }
}

impl TraceReader<File> {
    /// Opens a trace; the file's extension gives the format.
    ///
    /// # Errors
    /// The file cannot be read, its extension is unknown, or its header is wrong.
    pub fn open(file: &Path) -> Result<Self, InputError> {
        Self::open_columns(file, &ColumnAssignment::default())
    }

    /// As [`TraceReader::open`], with columns or signals that the user has assigned.
    ///
    /// # Errors
    /// As [`TraceReader::open`]; an assigned column or signal that is missing.
    pub fn open_columns(file: &Path, columns: &ColumnAssignment) -> Result<Self, InputError> {
        let format = TraceFormat::of(file)?;
        let again = file.is_file().then_some(file);
        let open = || Self::of(format, file, opened(file)?, columns, again);
        let mut reader = open()?;
        // Requests also count from the first time, so it is read in advance. Its faults are reported when it
        // is read.
        if again.is_some()
            && let TracePointSource::Csv { table, is_plain } = &mut reader.points
        {
            let mut ahead = open()?;
            let _ = ahead.next_point();
            if let TracePointSource::Csv { table: read, .. } = ahead.points
                && read.origin_ns != 0
            {
                (table.origin_ns, table.at_start, *is_plain) = (read.origin_ns, false, false);
            }
        }
        Ok(reader)
    }
}

/// The columns of a trace, assigned by words such as `t_s=1` or `a=Channel 0`.
///
/// # Errors
/// As [`ColumnAssignment::parse`].
pub fn trace_columns(words: &[String]) -> Result<ColumnAssignment, InputError> {
    ColumnAssignment::parse(words, &["t_ns", "t_us", "t_ms", "t_s", "a", "b"], |_| false)
}

/// As [`trace_columns`], for requested totals.
///
/// # Errors
/// As [`ColumnAssignment::parse`].
pub fn request_columns(words: &[String]) -> Result<ColumnAssignment, InputError> {
    ColumnAssignment::parse(words, &["t_ns", "t_us", "t_ms", "t_s", "requested"], |_| false)
}

impl<R: Read> TraceReader<R> {
    /// Reads a trace from `input`; `file` is its name in error messages.
    ///
    /// # Errors
    /// The header is missing or wrong.
    pub fn new(format: TraceFormat, file: &Path, input: R) -> Result<Self, InputError> {
        Self::of(format, file, input, &ColumnAssignment::default(), None)
    }

    fn of(
        format: TraceFormat,
        file: &Path,
        input: R,
        columns: &ColumnAssignment,
        again: Option<&Path>,
    ) -> Result<Self, InputError> {
        let mut rows = csv::Reader::new(file, input)?;
        let points = match format {
            TraceFormat::Csv => {
                let table = TraceColumns::new(&mut rows, COLUMNS, columns, again)?;
                let is_plain = table.places == [0, 1, 2] && table.shift == 0 && !table.has_others();
                TracePointSource::Csv { table: Box::new(table), is_plain }
            }
            TraceFormat::Vcd => {
                let begin = rows.lines.unread();
                let begin = String::from_utf8_lossy(&begin[..begin.len().min(BEGIN)]).into_owned();
                let names = ["a", "b"].map(|name| columns.place_of(name));
                if TIMES.iter().any(|(time, _)| columns.place_of(time).is_some()) {
                    let expected = "a and b alone: a VCD tells its times by itself";
                    return Err(InputError::whole(Path::new("--columns"), "a time's column", expected));
                }
                let vcd = VcdReader::definitions(&mut rows.lines, names);
                TracePointSource::Vcd(vcd.map_err(|e| FileKind::instead_of(Some(FileKind::Vcd), &begin, e))?)
            }
        };
        Ok(Self { rows, last: None, points, latest_ns: u64::MAX, done: false })
    }

    /// The same trace for a player, which adds to the times.
    /// A time that leaves no room for that is a bad row.
    #[must_use]
    pub fn playable(self) -> Self {
        Self { latest_ns: LATEST_PLAYED_NS, ..self }
    }

    /// How the file's format differs from the documented one.
    /// It may be UTF-16 or have another separator.
    pub fn written(&self) -> Option<String> {
        (!matches!(self.points, TracePointSource::Vcd(_))).then(|| written(&self.rows))?
    }

    /// Notes for the user about what was read so far.
    /// They give the zero of dates, and levels that were unknown at first.
    pub fn notes(&self) -> Option<String> {
        match &self.points {
            TracePointSource::Csv { table, .. } => table.notes(),
            TracePointSource::Vcd(vcd) => {
                Some(format!("{}: {}", self.rows.lines.file.display(), vcd.unknown_level_note()?))
            }
        }
    }

    /// A note if the rows so far are samples, not changes.
    pub fn sampled(&self) -> Option<String> {
        let TracePointSource::Csv { table, .. } = &self.points else { return None };
        let file = self.rows.lines.file.display();
        table
            .is_sampled
            .then(|| format!("{file}: a row a sample: rows in which nothing changes were passed over"))
    }

    /// The next point, or `None` at the end.
    ///
    /// # Errors
    /// The first row that does not suit the format.
    #[inline]
    pub fn next_point(&mut self) -> Result<Option<TracePoint>, InputError> {
        if matches!(self.points, TracePointSource::Csv { is_plain: true, .. })
            && let Some(last) = self.last
            && let Some(row) = self.rows.lines.ahead::<PLAIN_ROW>()
            && let Some((point, length)) = plain_row(row)
            && point.t_ns > last.t_ns
            && point.t_ns <= self.latest_ns
            && point.state != last.state
        {
            self.rows.lines.take_line(length, 0);
            self.last = Some(point);
            return Ok(Some(point));
        }
        self.next_slowly()
    }

    #[cold]
    #[inline(never)]
    fn next_slowly(&mut self) -> Result<Option<TracePoint>, InputError> {
        if self.done {
            return Ok(None);
        }
        let next = match &mut self.points {
            TracePointSource::Vcd(vcd) => vcd.next(&mut self.rows.lines, self.last),
            TracePointSource::Csv { table, is_plain } => {
                let row = csv_row(&mut self.rows, table, self.last);
                *is_plain &= table.origin_ns == 0;
                row
            }
        };
        match next {
            Ok(Some(point)) if point.t_ns > self.latest_ns => {
                self.done = true;
                let lines = &self.rows.lines;
                let found = format!("the time {} ns", point.t_ns);
                let expected = format!("a time of at most {LATEST_PLAYED_NS} ns in a trace that is played");
                Err(InputError::at(&lines.file, lines.line, 0, found, expected))
            }
            Ok(Some(point)) => {
                self.last = Some(point);
                Ok(Some(point))
            }
            Ok(None) if self.last.is_none() => {
                self.done = true;
                Err(InputError::whole(
                    &self.rows.lines.file,
                    "a trace without a point",
                    "at least the initial state of a and b",
                ))
            }
            end => {
                self.done = true;
                end
            }
        }
    }
}

fn written<R: Read>(rows: &csv::Reader<R>) -> Option<String> {
    TableNumberFormat::new(rows).written(&rows.lines.file)
}

impl<R: Read> Iterator for TraceReader<R> {
    type Item = Result<TracePoint, InputError>;

    #[inline]
    fn next(&mut self) -> Option<Self::Item> {
        self.next_point().transpose()
    }
}

/// Reads requested totals (`t_ns,requested`), times never falling.
/// After an error it yields nothing more.
#[derive(Debug)]
pub struct RequestedTotalReader<R> {
    rows: csv::Reader<R>,
    table: TraceColumns<2>,
    last_ns: u64,
    done: bool,
}

impl RequestedTotalReader<File> {
    /// Opens a file of requests, with the columns that the user has assigned.
    ///
    /// # Errors
    /// The file cannot be read, its header is wrong, or an assigned column is missing.
    pub fn open_columns(file: &Path, columns: &ColumnAssignment) -> Result<Self, InputError> {
        Self::of(file, opened(file)?, columns, file.is_file().then_some(file))
    }

    /// As [`RequestedTotalReader::open_columns`], for totals on a trace's clock.
    /// If the trace begins before a trigger, both count from its first time.
    ///
    /// # Errors
    /// As [`RequestedTotalReader::open_columns`].
    pub fn open_beside(
        file: &Path,
        columns: &ColumnAssignment,
        trace: &TraceReader<impl Read>,
    ) -> Result<Self, InputError> {
        let mut reader = Self::open_columns(file, columns)?;
        if let TracePointSource::Csv { table, .. } = &trace.points {
            reader.table.origin_ns = table.origin_ns;
        }
        Ok(reader)
    }
}

impl<R: Read> RequestedTotalReader<R> {
    /// Reads requests from `input`; `file` is its name in error messages.
    ///
    /// # Errors
    /// The header is missing or wrong.
    pub fn new(file: &Path, input: R) -> Result<Self, InputError> {
        Self::of(file, input, &ColumnAssignment::default(), None)
    }

    fn of(
        file: &Path,
        input: R,
        columns: &ColumnAssignment,
        again: Option<&Path>,
    ) -> Result<Self, InputError> {
        let mut rows = csv::Reader::new(file, input)?;
        let table = TraceColumns::new(&mut rows, ["t_ns", "requested"], columns, again)?;
        Ok(Self { rows, table, last_ns: 0, done: false })
    }

    /// As [`TraceReader::written`].
    pub fn written(&self) -> Option<String> {
        written(&self.rows)
    }

    /// As [`TraceReader::notes`].
    pub fn notes(&self) -> Option<String> {
        self.table.notes()
    }

    fn row(&mut self) -> Result<Option<RequestedTotal>, InputError> {
        let by = self.rows.separator();
        let Some(row) = self.rows.row()? else { return Ok(None) };
        let [t, requested] = self.table.cells(row)?;
        let t_ns = self.table.whole(0, &t, self.table.shift, by, TIME)?;
        if t_ns < self.last_ns {
            return Err(t.finding(format!("a time not before the last one, {} ns", self.last_ns)));
        }
        let requested = self.table.whole(1, &requested, 0, by, "a whole number of counts")?;
        self.last_ns = t_ns;
        Ok(Some(RequestedTotal { t_ns, requested }))
    }
}

impl<R: Read> Iterator for RequestedTotalReader<R> {
    type Item = Result<RequestedTotal, InputError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.done {
            return None;
        }
        let row = self.row().transpose();
        self.done = !matches!(row, Some(Ok(_)));
        row
    }
}

/// Writes a trace point by point, buffered.
/// The caller gives strictly rising times and one point per change.
#[derive(Debug)]
pub struct TraceWriter<W: Write> {
    out: io::BufWriter<W>,
    format: TraceFormat,
    last: Option<State>,
}

impl<W: Write> TraceWriter<W> {
    /// Makes a writer and writes the header.
    ///
    /// # Errors
    /// What `out` reports.
    pub fn new(format: TraceFormat, out: W) -> io::Result<Self> {
        let mut out = io::BufWriter::with_capacity(BUFFER, out);
        out.write_all(match format {
            TraceFormat::Csv => b"t_ns,a,b\n".as_slice(),
            TraceFormat::Vcd => {
                b"$timescale 1 ns $end\n$var wire 1 ! a $end\n$var wire 1 \" b $end\n$enddefinitions $end\n"
            }
        })?;
        Ok(Self { out, format, last: None })
    }

    /// Writes one point.
    ///
    /// # Errors
    /// What the output reports.
    #[inline]
    pub fn write(&mut self, point: TracePoint) -> io::Result<()> {
        match self.format {
            TraceFormat::Csv => self.csv(point),
            TraceFormat::Vcd => self.vcd(point),
        }
    }

    #[inline]
    fn csv(&mut self, TracePoint { t_ns, state }: TracePoint) -> io::Result<()> {
        let mut row = [0; PLAIN_ROW];
        let mut digits = itoa::Buffer::new();
        let digits = digits.format(t_ns).as_bytes();
        let end = digits.len();
        row[..end].copy_from_slice(digits);
        row[end..end + 5].copy_from_slice(&[b',', level(state.a()), b',', level(state.b()), b'\n']);
        self.out.write_all(&row[..end + 5])
    }

    fn vcd(&mut self, TracePoint { t_ns, state }: TracePoint) -> io::Result<()> {
        let mut digits = itoa::Buffer::new();
        self.out.write_all(b"#")?;
        self.out.write_all(digits.format(t_ns).as_bytes())?;
        let Some(last) = self.last.replace(state) else {
            let (a, b) = (u8::from(state.a()), u8::from(state.b()));
            return write!(self.out, "\n$dumpvars\n{a}!\n{b}\"\n$end\n");
        };
        if state.a() != last.a() {
            self.out.write_all(&[b'\n', level(state.a()), b'!'])?;
        }
        if state.b() != last.b() {
            self.out.write_all(&[b'\n', level(state.b()), b'"'])?;
        }
        self.out.write_all(b"\n")
    }

    /// Writes the buffered rest and returns the output.
    ///
    /// # Errors
    /// What the output reports.
    pub fn finish(self) -> io::Result<W> {
        self.out.into_inner().map_err(io::IntoInnerError::into_error)
    }
}

/// A trace file that gets its name only when it is complete.
/// Until [`AtomicTraceFile::finish`] it is a temporary file beside it, which is removed when dropped.
#[derive(Debug)]
pub struct AtomicTraceFile(TraceWriter<AtomicFile>);

impl AtomicTraceFile {
    /// Starts a trace in the format that the extension of `file` names.
    ///
    /// # Errors
    /// The extension is unknown, or the directory of `file` cannot be written to.
    pub fn create(file: &Path) -> Result<Self, InputError> {
        Self::create_noted(file, &[])
    }

    /// As [`AtomicTraceFile::create`], with lines of comment before the header.
    ///
    /// # Errors
    /// As [`AtomicTraceFile::create`].
    pub fn create_noted(file: &Path, notes: &[&str]) -> Result<Self, InputError> {
        let format = TraceFormat::of(file)?;
        let noted = AtomicFile::create(file).and_then(|mut out| {
            for note in notes {
                match format {
                    TraceFormat::Csv => writeln!(out, "# {note}")?,
                    TraceFormat::Vcd => writeln!(out, "$comment {note} $end")?,
                }
            }
            TraceWriter::new(format, out)
        });
        Ok(Self(noted.map_err(|e| InputError::whole(file, e.to_string(), "a place that can be written to"))?))
    }

    /// Writes one point; see [`TraceWriter::write`].
    ///
    /// # Errors
    /// What the file system reports.
    #[inline]
    pub fn write(&mut self, point: TracePoint) -> io::Result<()> {
        self.0.write(point)
    }

    /// Gives the file its name.
    ///
    /// # Errors
    /// What the file system reports; nothing is left behind then.
    pub fn finish(self) -> io::Result<()> {
        self.0.finish()?.finish()
    }
}
const COLUMNS: [&str; 3] = ["t_ns", "a", "b"];
/// Upper limit of a time and of any time that a player makes from it.
const LATEST_PLAYED_NS: u64 = i64::MAX as u64;
const TIME: &str = "a time in whole ns, from 0 to 18446744073709551615";

const fn level(high: bool) -> u8 {
    b'0' + high as u8
}

fn csv_row<R: Read>(
    rows: &mut csv::Reader<R>,
    table: &mut TraceColumns<3>,
    last: Option<TracePoint>,
) -> Result<Option<TracePoint>, InputError> {
    let by = rows.separator();
    while let Some(row) = rows.row()? {
        let [t, a, b] = table.cells(row)?;
        let t_ns = table.whole(0, &t, table.shift, by, TIME)?;
        let level = |cell: &Cell<'_>| match cell.text() {
            "0" => Ok(false),
            "1" => Ok(true),
            _ => Err(cell.finding("the level 0 or 1")),
        };
        let state = State::new(level(&a)?, level(&b)?);
        if let Some(last) = last {
            if t_ns <= last.t_ns {
                return Err(t.finding(format!("a time after the row before, {} ns", last.t_ns)));
            }
            if state == last.state {
                if table.has_others() || table.is_sampled {
                    continue;
                }
                let found = format!("the state {},{} again", a.text(), b.text());
                let refused = a.finding_with_text(found, "a change of a or b: one row per change");
                let text = row.text().to_owned();
                let ahead = String::from_utf8_lossy(rows.lines.unread());
                if !is_sampled(&text, &ahead, by, [table.places[1], table.places[2]]) {
                    return Err(refused);
                }
                table.is_sampled = true;
                continue;
            }
        }
        return Ok(Some(TracePoint { t_ns, state }));
    }
    Ok(None)
}

/// Number of rows that show whether a table has one per sample or per change.
const SHOWN_ROWS: usize = 64;
/// Fewer rows do not show it: a repeated state can be a lost edge.
const FEWEST_PAIRS: usize = 4;

/// Whether the rows are samples: at least half of them repeat the previous state.
/// `row` is the first one that does.
fn is_sampled(row: &str, ahead: &str, by: char, places: [usize; 2]) -> bool {
    let state = |line: &str| {
        let cells: Vec<&str> = line.split(by).map(str::trim).collect();
        places.map(|place| cells.get(place).map(|cell| (*cell).to_owned()))
    };
    let rows = std::iter::once(row).chain(ahead.lines().filter(|line| !line.trim().is_empty()));
    let states: Vec<_> = rows.take(SHOWN_ROWS).map(state).collect();
    let repeats = 1 + states.windows(2).filter(|w| w[0] == w[1]).count();
    states.len() >= FEWEST_PAIRS && 2 * repeats >= states.len()
}

/// Reads a row without spaces or comment.
/// Returns the point and the row's length, or `None` if the careful reader must explain the row.
#[inline]
fn plain_row(row: &[u8; PLAIN_ROW]) -> Option<(TracePoint, usize)> {
    let (mut t_ns, mut at) = (0_u64, 0);
    // Eight digits at a time, then one by one. Twenty digits may overflow and need the careful reader.
    while at < 16
        && let Some(group) = eight_digits(row, at)
    {
        t_ns = t_ns * 100_000_000 + group;
        at += 8;
    }
    let mut digit = row[at].wrapping_sub(b'0');
    let first = at;
    while digit <= 9 {
        if at == 19 || at == first + 8 {
            return None;
        }
        t_ns = t_ns * 10 + u64::from(digit);
        at += 1;
        digit = row[at].wrapping_sub(b'0');
    }
    if at == 0 {
        return None;
    }
    let tail: [u8; 6] = *row[at..].first_chunk()?;
    let (a, b) = (tail[1] ^ b'0', tail[3] ^ b'0');
    let end = match (tail[4], tail[5]) {
        (b'\n', _) => 5,
        (b'\r', b'\n') => 6,
        _ => return None,
    };
    if tail[0] != b',' || tail[2] != b',' || (a | b) > 1 {
        return None;
    }
    Some((TracePoint { t_ns, state: State::from_bits(a | b << 1) }, at + end))
}

/// The number in eight ASCII digits, all at once; `None` if one is no digit.
#[inline]
fn eight_digits(row: &[u8; PLAIN_ROW], at: usize) -> Option<u64> {
    const ZEROS: u64 = u64::from_ne_bytes([b'0'; 8]);
    let value = u64::from_le_bytes(*row.get(at..)?.first_chunk()?) ^ ZEROS;
    // Adding 0x76 sets the high bit of a byte above 9, unless it was set before.
    if (value.wrapping_add(0x7676_7676_7676_7676) | value) & 0x8080_8080_8080_8080 != 0 {
        return None;
    }
    let pairs = value.wrapping_mul(10).wrapping_add(value >> 8) & 0x00ff_00ff_00ff_00ff;
    let fours = pairs.wrapping_mul(100).wrapping_add(pairs >> 16) & 0x0000_ffff_0000_ffff;
    Some(fours.wrapping_mul(10_000).wrapping_add(fours >> 32) & 0xffff_ffff)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quickly(text: &str) -> Option<(TracePoint, usize)> {
        let mut row = [b'x'; PLAIN_ROW];
        row[..text.len()].copy_from_slice(text.as_bytes());
        plain_row(&row)
    }

    #[test]
    fn a_plain_row_of_any_length_is_read_in_one_go() {
        let mut t_ns = 0;
        for digits in 1..=19 {
            t_ns = t_ns * 10 + digits % 10;
            for state in (0..4).map(State::from_bits) {
                for end in ["\n", "\r\n"] {
                    let (a, b) = (u8::from(state.a()), u8::from(state.b()));
                    let text = format!("{t_ns},{a},{b}{end}");
                    assert_eq!(quickly(&text), Some((TracePoint { t_ns, state }, text.len())), "{text}");
                }
            }
        }
        assert_eq!(
            quickly("9999999999999999999,1,0\n").map(|(point, _)| point.t_ns),
            Some(9_999_999_999_999_999_999)
        );
    }

    #[test]
    fn what_is_no_plain_row_is_left_to_the_careful_reader() {
        for text in [
            ",0,1\n",
            "18446744073709551615,0,1\n",
            "12,2,0\n",
            "12,0,2\n",
            "12,2,3\n",
            "12,3,2\n",
            "12;0,1\n",
            "12,0;1\n",
            "12,0,1 \n",
            "12,0,1\rx",
            "12 ,0,1\n",
            " 12,0,1\n",
            "1234567a,0,1\n",
            "1234567/,0,1\n",
            "1234567:,0,1\n",
            "-1,0,1\n",
            "1.5,0,1\n",
            "12,0,1,0\n",
        ] {
            assert_eq!(quickly(text), None, "{text:?}");
        }
    }
}
