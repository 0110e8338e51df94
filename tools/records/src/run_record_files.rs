//! Run records on file: `NAME.run.toml` beside a CSV.
//! They are read strictly and written whole (tools/guide/reference/records.md).

use rtec_files::clock_column::{self, absolute_ns, of_day_ns};
use rtec_files::csv::{self, CsvStyle, Reader};
use rtec_files::date;
use rtec_files::file_format_stamp;
use rtec_files::strict_toml::{Document, Table};
use rtec_files::text_file::{LONGEST, open_regular};
use rtec_files::{DecimalMarks, InputError, TableNumberFormat, column_units};
use rtec_model::ballbar_circle::Circle;
use rtec_model::file_kind::FileKind;
use rtec_model::record::{
    Axis, Column, LINEAR, Record, ReversalPoint, Role, RunKind, check, hex, range_alone,
};
use sha2::{Digest, Sha256};
use std::fmt::Write as _;
use std::fs::File;
use std::io::{Read, Seek};
use std::path::{Path, PathBuf};

/// The roles as an error message lists them.
pub const ROLES: &str = "a role: time, cycle, temperature, spindle_speed, coolant, angle, channel, or position, direction, \
     velocity, acceleration, load, error, force with an axis (position.y), or angle_error with two (angle_error.x.b)";

/// Reads a record from its sidecar.
///
/// # Errors
/// The first finding, with file, line and column: an unreadable file, an unknown key, kind or role, or a
/// wrong unit. In the CSV a listed column that is missing, a short row, a value that is missing or not
/// finite, time running backwards, or no response.
pub fn read(path: &Path) -> Result<Record, InputError> {
    let record = read_log(path)?;
    has_response(path, &record.columns)?;
    Ok(record)
}

fn has_response(path: &Path, columns: &[Column]) -> Result<(), InputError> {
    if columns.iter().any(|c| c.role.is_measured()) {
        return Ok(());
    }
    let found = "no response among the columns";
    Err(InputError::whole(path, found, "a column of role error.AXIS or force.AXIS"))
}

/// Reads a log: a record that need not have a response (a recorded shift).
///
/// # Errors
/// As [`read`], apart from the response.
pub fn read_log(path: &Path) -> Result<Record, InputError> {
    let sidecar = Sidecar::parse(path, &rtec_files::text_file::read(path)?)?;
    let (csv_path, file) = sidecar.open(path)?;
    let bytes = file.metadata().map_or(0, |m| m.len());
    if bytes > LONGEST {
        let found = format!("more than {LONGEST} bytes");
        return Err(sidecar.unreadable(&csv_path, &found));
    }
    of_parts(path, sidecar, &csv_path, file, bytes)
}

/// Reads a log from its sidecar's text and its CSV; `path` is the sidecar's.
///
/// # Errors
/// As [`read_log`].
pub fn parse_log(path: &Path, sidecar: &str, csv: impl Read + Seek) -> Result<Record, InputError> {
    let sidecar = Sidecar::parse(path, sidecar)?;
    let csv_path = sidecar.csv_path(path);
    of_parts(path, sidecar, &csv_path, csv, 0)
}

/// The name of the CSV in a sidecar.
///
/// # Errors
/// When it is no sidecar, or names a file in another folder.
pub fn csv_name(path: &Path, sidecar: &str) -> Result<String, InputError> {
    let sidecar = Sidecar::parse(path, sidecar)?;
    let mut parts = Path::new(&sidecar.file).components();
    match (parts.next(), parts.next()) {
        (Some(std::path::Component::Normal(name)), None) if name == sidecar.file.as_str() => Ok(sidecar.file),
        _ => Err(sidecar
            .file_error
            .clone()
            .with(format!("`{}`", sidecar.file), "a CSV in the folder of its sidecar")),
    }
}

/// Reads a record of any number of rows in pieces, with bounded memory.
pub struct RecordPieceReader {
    path: PathBuf,
    sidecar: Sidecar,
    /// Length of the CSV, bytes.
    bytes: u64,
    rows: RowReader<File>,
    /// Number of rows before the present piece.
    before: usize,
}

/// Some rows of a record.
pub struct RecordPiece {
    /// The rows as a record without a hash.
    pub record: Record,
    /// The rows' text in the CSV, with columns that are not listed.
    pub texts: Vec<String>,
}

impl RecordPieceReader {
    /// Opens a record before its first piece.
    /// Returns `None` for a ballbar's circle, because the place of a row there depends on the rows around it.
    ///
    /// # Errors
    /// Errors of [`read`] before the rows.
    pub fn of(path: &Path) -> Result<Option<Self>, InputError> {
        let sidecar = Sidecar::parse(path, &rtec_files::text_file::read(path)?)?;
        if sidecar.circle.is_some() {
            return Ok(None);
        }
        let (csv_path, mut file) = sidecar.open(path)?;
        let bytes = file.metadata().map_or(0, |m| m.len());
        let marks = sidecar.marks(&csv_path, &mut file)?;
        let rows = RowReader::new(&csv_path, file, &sidecar, marks)?;
        has_response(path, &rows.columns)?;
        Ok(Some(Self { path: path.to_owned(), sidecar, bytes, rows, before: 0 }))
    }

    /// Goes back before the first piece.
    ///
    /// # Errors
    /// When the file has changed.
    pub fn rewind(&mut self) -> Result<(), InputError> {
        let (csv_path, file) = self.sidecar.open(&self.path)?;
        self.rows = RowReader::new(&csv_path, file, &self.sidecar, self.rows.marks.take())?;
        self.before = 0;
        Ok(())
    }

    /// Kind of the run.
    pub fn kind(&self) -> RunKind {
        self.sidecar.kind
    }

    /// Largest possible number of rows in the file.
    /// Each field has at least one character behind it.
    pub fn most_rows(&self) -> u64 {
        self.bytes / self.rows.slots.len().max(1) as u64
    }

    /// Text of the CSV's header.
    pub fn header(&self) -> &str {
        self.rows.header.text()
    }

    /// Style of further cells beside the CSV's own.
    pub fn style(&self) -> CsvStyle {
        self.rows.marks.as_ref().map_or_else(CsvStyle::default, TableNumberFormat::style)
    }

    /// The next rows, at most `rows`; `None` at the end.
    ///
    /// # Errors
    /// Errors of [`read`] in these rows.
    pub fn next(&mut self, rows: usize) -> Result<Option<RecordPiece>, InputError> {
        let mut texts = Vec::with_capacity(rows);
        let record = self.fill(rows, |text| texts.push(String::from_utf8_lossy(text).into_owned()))?;
        Ok(record.map(|record| RecordPiece { record, texts }))
    }

    /// As [`RecordPieceReader::next`], without the texts.
    ///
    /// # Errors
    /// Errors of [`read`] in these rows.
    pub fn next_record(&mut self, rows: usize) -> Result<Option<Record>, InputError> {
        self.fill(rows, |_| ())
    }

    fn fill(&mut self, rows: usize, mut keep: impl FnMut(&[u8])) -> Result<Option<Record>, InputError> {
        while self.rows.held() < rows && self.rows.next(&mut keep)? {}
        if self.rows.held() == 0 {
            return Ok(None);
        }
        let columns = self.rows.take();
        let mut record = Record::of_checked(&self.path, self.sidecar.kind, columns).from_row(self.before);
        self.before += record.rows();
        record.written = self.rows.written();
        self.sidecar.describe(&mut record);
        Ok(Some(record))
    }
}

fn of_parts(
    path: &Path,
    sidecar: Sidecar,
    csv_path: &Path,
    mut csv: impl Read + Seek,
    bytes: u64,
) -> Result<Record, InputError> {
    let marks = sidecar.marks(csv_path, &mut csv)?;
    let mut csv = HashingReader { input: csv, hash: Sha256::new() };
    let mut rows = RowReader::new(csv_path, &mut csv, &sidecar, marks)?;
    rows.expect(bytes);
    while rows.next(|_| ())? {}
    let (written, columns) = (rows.written(), rows.columns);
    let mut record = Record::of_checked(path, sidecar.kind, columns);
    record.written = written;
    record.sha256 = hex(&csv.hash.finalize());
    sidecar.describe(&mut record);
    match sidecar.circle {
        Some((circle, place)) => {
            record.with_circle(circle).map_err(|(found, expected)| place.with(found, expected))
        }
        None => Ok(record),
    }
}

/// A reader that hashes what it reads, so that a file is read only once.
struct HashingReader<R> {
    input: R,
    hash: Sha256,
}

impl<R: Read> Read for HashingReader<R> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let length = self.input.read(buffer)?;
        self.hash.update(&buffer[..length]);
        Ok(length)
    }
}

/// The CSV's own rows with further columns at the end, as CSV text.
/// Unlisted columns are kept.
///
/// # Errors
/// When the CSV can no longer be read, or its number of rows has changed.
pub fn csv_with(record: &Record, extra: &[(String, Vec<f64>)]) -> Result<String, InputError> {
    let path = record.path.parent().unwrap_or(Path::new("")).join(&record.file);
    let mut file = open_regular(&path)?;
    let names: Vec<&str> = record.columns.iter().map(|c| c.name.as_str()).collect();
    let marks = TableNumberFormat::find(&path, &mut file, &names)?;
    let style = marks.as_ref().map_or_else(CsvStyle::default, TableNumberFormat::style);
    let mut reader = Reader::new(&path, file)?;
    let mut out = String::with_capacity(24 * (record.columns.len() + extra.len()) * record.rows());
    let header = reader.header_with("a header line", &names)?;
    out.push_str(header.text());
    for (name, _) in extra {
        style.push_text(&mut out, name);
    }
    out.push('\n');
    let mut n = 0;
    while let Some(row) = reader.row()? {
        out.push_str(row.text());
        for (_, data) in extra {
            let Some(v) = data.get(n) else { break };
            style.push_number(&mut out, *v);
        }
        out.push('\n');
        n += 1;
    }
    if n != record.rows() {
        let expected = format!("{} rows, as when it was read", record.rows());
        return Err(InputError::whole(&path, format!("{n} rows"), expected));
    }
    Ok(out)
}

/// The CSV text of the record's columns.
/// Each number is the shortest decimal that reads back the same.
pub fn to_csv(record: &Record) -> String {
    let mut out = csv::header_line(record.columns.iter().map(|c| c.name.as_str()));
    out.push('\n');
    for row in 0..record.rows() {
        for (i, c) in record.columns.iter().enumerate() {
            let sep = if i == 0 { "" } else { "," };
            let _ = write!(out, "{sep}{}", c.data[row]);
        }
        out.push('\n');
    }
    out
}

/// The text of a record's sidecar (`NAME.run.toml`).
pub fn to_sidecar(record: &Record) -> String {
    let mut doc = toml_edit::DocumentMut::new();
    let mut put = |key: &str, of: Option<toml_edit::Value>| {
        if let Some(of) = of {
            doc[key] = toml_edit::value(of);
        }
    };
    let text = |of: &Option<String>| of.as_ref().map(Into::into);
    let circle = record.circle();
    put("format", Some(i64::from(file_format_stamp::FORMAT).into()));
    put("by", Some(file_format_stamp::writer().into()));
    put("file", Some((&record.file).into()));
    put("kind", Some(record.kind.name().into()));
    put("count_um", record.count_um.map(Into::into));
    put("radius_mm", circle.map(|c| c.radius_mm.into()));
    put("plane", circle.map(|c| c.plane.iter().map(Axis::as_str).collect::<toml_edit::Array>().into()));
    put("centre_mm", circle.and_then(|c| c.centre_mm).map(|c| toml_edit::Array::from_iter(c).into()));
    let (turns, over_mm) = match record.turns {
        None => (None, None),
        Some(ReversalPoint::AtTarget) => (Some("at_target".into()), None),
        Some(ReversalPoint::Overtravel(over_mm)) => (Some("overtravel".into()), over_mm.map(Into::into)),
    };
    put("turns", turns);
    put("over_mm", over_mm);
    put("date", text(&record.date));
    put("note", text(&record.note));
    put("zero", text(&record.zero));
    let mut columns = toml_edit::Table::new();
    for c in &record.columns {
        let mut t = toml_edit::InlineTable::new();
        t.insert("role", c.role.to_string().into());
        t.insert("unit", c.unit.as_str().into());
        columns.insert(&c.name, toml_edit::value(t));
    }
    doc["columns"] = toml_edit::Item::Table(columns);
    doc.to_string()
}

/// Changes the path of a record.
/// The sidecar gets that path, and the CSV the same name beside it.
///
/// # Errors
/// When the name does not end in `.run.toml`.
pub fn at(record: &mut Record, path: &Path) -> Result<(), InputError> {
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let stem = name.strip_suffix(".run.toml").filter(|s| !s.is_empty());
    let stem = stem.ok_or_else(|| InputError::whole(path, format!("the name `{name}`"), "NAME.run.toml"))?;
    record.file = format!("{stem}.csv");
    path.clone_into(&mut record.path);
    Ok(())
}

/// Whether a record made in memory would read back the same.
/// Its columns' names are in the CSV's header.
///
/// # Errors
/// When a column has no name, or one that a header does not give back.
pub fn can_be_written(record: &Record) -> Result<(), InputError> {
    let header = csv::header_line(record.columns.iter().map(|c| c.name.as_str())) + "\n";
    let names: Vec<String> = Reader::new(&record.path, header.as_bytes())
        .and_then(|mut r| Ok(r.header("a header line")?.names().map(str::to_owned).collect()))
        .unwrap_or_default();
    for (i, column) in record.columns.iter().enumerate() {
        if column.name.is_empty() || names.get(i) != Some(&column.name) {
            let found = format!("a column of the name `{}`", column.name);
            return Err(InputError::whole(&record.path, found, "a name that a CSV's header gives back"));
        }
    }
    Ok(())
}

/// Writes `NAME.run.toml` and its CSV, each whole or not at all; sets the hash.
/// The sidecar goes to [`Record::path`].
///
/// # Errors
/// When the directory cannot be written.
pub fn write(record: &mut Record) -> std::io::Result<()> {
    let csv = to_csv(record);
    let dir = record.path.parent().unwrap_or(Path::new(""));
    rtec_files::atomic_write::write_atomically(&dir.join(&record.file), csv.as_bytes())?;
    record.sha256 = hex(&Sha256::digest(csv.as_bytes()));
    rtec_files::atomic_write::write_atomically(&record.path, to_sidecar(record).as_bytes())
}

/// Reads and checks the rows of a record's CSV one by one.
struct RowReader<R> {
    reader: Reader<R>,
    /// Format of the numbers; `None` for decimal points and commas between cells.
    marks: Option<TableNumberFormat>,
    header: csv::Header,
    /// The listed columns in the CSV's order, with the values read so far.
    columns: Vec<Column>,
    /// Field of the CSV for each listed column.
    places: Vec<usize>,
    /// Listed column for each field of the CSV.
    slots: Vec<Option<usize>>,
    /// Limits of each field by [`check`]; `low` to `high` are valid.
    /// A field that is not listed may have any value.
    low: Vec<f64>,
    high: Vec<f64>,
    /// Fields with further checks: time does not run backwards, directions are whole.
    further: Vec<usize>,
    /// Last value of each column before the rows in memory.
    before: Vec<Option<f64>>,
    /// Fields of a row that is read by the fast path.
    fields: Vec<f64>,
}

impl<R: Read> RowReader<R> {
    fn new(
        path: &Path,
        csv: R,
        sidecar: &Sidecar,
        marks: Option<TableNumberFormat>,
    ) -> Result<Self, InputError> {
        let mut reader = Reader::new(path, csv)?;
        let header = reader.header_with("a header line", &sidecar.names())?;
        if sidecar.columns.iter().any(|l| header.find(&l.name).is_none())
            && let Some(missing) = header.is_missing()
        {
            return Err(missing);
        }
        for listed in &sidecar.columns {
            if header.find(&listed.name).is_none() {
                let missing = header.place(&listed.name).err();
                if let Some(missing) = &missing {
                    let other = reader.instead_of(&header, missing.clone());
                    if other.found != missing.found {
                        return Err(other);
                    }
                }
                let expected = missing.map_or_else(String::new, |e| e.expected);
                let expected = format!("{expected} in {}", path.display());
                return Err(listed.place.clone().with(format!("column `{}`", listed.name), &expected));
            }
            header.place(&listed.name)?;
        }
        let fields = header.names().count();
        let mut slots: Vec<Option<usize>> = vec![None; fields];
        let (mut low, mut high) = (vec![f64::NEG_INFINITY; fields], vec![f64::INFINITY; fields]);
        let (mut columns, mut places, mut further) = (Vec::new(), Vec::new(), Vec::new());
        for (place, name) in header.names().enumerate() {
            if let Some(l) = sidecar.columns.iter().find(|c| c.name == name) {
                slots[place] = Some(columns.len());
                places.push(place);
                match range_alone(&l.role) {
                    Some(range) => [low[place], high[place]] = range,
                    None => further.push(place),
                }
                let (name, role, unit) = (l.name.clone(), l.role.clone(), l.unit.clone());
                columns.push(Column { name, role, unit, data: Vec::new() });
            }
        }
        let before = vec![None; columns.len()];
        let fields = vec![0.0; fields];
        Ok(Self { reader, marks, header, columns, places, slots, low, high, further, before, fields })
    }

    /// Reserves memory for the rows of a CSV of `bytes` bytes.
    /// The estimate assumes rows as long as the header; most are longer.
    fn expect(&mut self, bytes: u64) {
        let rows = bytes as usize / self.header.text().len().max(1);
        self.columns.iter_mut().for_each(|c| c.data.reserve(rows.min(1 << 20)));
    }

    /// The CSV's format, where it is unusual.
    fn written(&self) -> Option<String> {
        let file = self.header.file();
        self.marks
            .as_ref()
            .map_or_else(|| TableNumberFormat::new(&self.reader).written(file), |marks| marks.written(file))
    }

    /// Number of rows in the columns.
    fn held(&self) -> usize {
        self.columns.first().map_or(0, |c| c.data.len())
    }

    /// Returns the columns and continues with empty ones.
    fn take(&mut self) -> Vec<Column> {
        for (column, before) in self.columns.iter().zip(&mut self.before) {
            *before = column.data.last().copied().or(*before);
        }
        let bare = |c: &Column| Column::new(&c.name, c.role.clone(), Vec::with_capacity(c.data.len()));
        let empty = self.columns.iter().map(|c| Column { unit: c.unit.clone(), ..bare(c) }).collect();
        std::mem::replace(&mut self.columns, empty)
    }

    /// Reads the next row into the columns; `false` at the end. `kept` gets its text.
    #[inline]
    fn next(&mut self, kept: impl FnOnce(&[u8])) -> Result<bool, InputError> {
        if self.marks.is_none()
            && let Some(row) = self.reader.plain_row(&mut self.fields, |place| self.slots[place].is_none())
            && self.fields_are_good()
        {
            for (column, place) in self.columns.iter_mut().zip(&self.places) {
                column.data.push(self.fields[*place]);
            }
            kept(self.reader.take(row));
            return Ok(true);
        }
        self.next_with_care(kept)
    }

    #[inline]
    fn fields_are_good(&self) -> bool {
        // Counts all invalid values without a branch for each, because nearly every row is good.
        let ranges = self.low.iter().zip(&self.high);
        let outside = self.fields.iter().zip(ranges).filter(|(v, (low, high))| v < low || v > high).count();
        outside == 0
            && self.further.iter().all(|place| {
                self.slots[*place].is_none_or(|slot| {
                    let (column, before) = (&self.columns[slot], self.before[slot]);
                    check(&column.role, self.fields[*place], column.data.last().copied().or(before)).is_ok()
                })
            })
    }

    /// The slow path, cell by cell, which gives a finding its place.
    #[inline(never)]
    fn next_with_care(&mut self, kept: impl FnOnce(&[u8])) -> Result<bool, InputError> {
        let (header, before, marks) = (&self.header, &self.before, &self.marks);
        let Some(row) = self.reader.row()? else {
            let none = self.columns.first().is_none_or(|c| c.data.is_empty() && before[0].is_none());
            return if none { Err(header.no_rows()) } else { Ok(false) };
        };
        header
            .each(row, |place, cell| {
                let Some(slot) = self.slots[place] else { return Ok(()) };
                let column = &mut self.columns[slot];
                let v = match marks {
                    // In any table a blank may separate thousands.
                    None => cell.finite().or_else(|e| DecimalMarks::written('.').parse(cell.text()).ok_or(e)),
                    Some(marks) => {
                        let numbers = marks.numbers(place);
                        let expected = || cell.finding(numbers.expected(cell.text()));
                        numbers.parse(cell.text()).ok_or_else(expected)
                    }
                };
                let v = v.map_err(|e| {
                    if column.role == Role::Time
                        && (absolute_ns(cell.text()) != [None; 2] || of_day_ns(cell.text()).is_some())
                    {
                        let name = &column.name;
                        let import = format!(
                            "`rtecctl characterise import --format csv --columns {name}=time,…` sets it back"
                        );
                        let expected = format!("seconds since the run's start, a number; {import}");
                        return header.named(place, InputError { expected, ..e });
                    }
                    let instead =
                        clock_column::expected_instead(cell.text()).filter(|_| column.role == Role::Time);
                    let e = instead.map_or(e, |expected| cell.finding(expected));
                    header.named(place, e)
                })?;
                let checked = check(&column.role, v, column.data.last().copied().or(before[slot]));
                checked.map_err(|(found, expected)| {
                    header.named(place, cell.finding_with_text(found, expected))
                })?;
                column.data.push(v);
                Ok(())
            })
            .map_err(|e| {
                let columns = header.names().count();
                if !row.has_decimal_commas(columns) {
                    return e;
                }
                // Only a hint, because the row may just have a field too many.
                let expected = format!(
                    "{}; or, if these are decimal commas between commas, the table written with semicolons",
                    e.expected
                );
                InputError { expected, ..e }
            })?;
        kept(row.text().as_bytes());
        Ok(true)
    }
}

/// The keys of a sidecar.
#[rustfmt::skip]
const KEYS: [&str; 14] = [
    "file", "kind", "count_um", "radius_mm", "plane", "centre_mm", "turns", "over_mm", "date", "note", "zero", "columns",
    "format", "by",
];

/// Positions in the sidecar, for findings that show only in the CSV.
#[derive(Debug, Clone)]
struct SidecarErrorPlace(InputError);

impl SidecarErrorPlace {
    fn with(self, found: String, expected: &str) -> InputError {
        InputError { found, expected: expected.to_owned(), ..self.0 }
    }
}

#[derive(Debug)]
struct DeclaredColumn {
    name: String,
    role: Role,
    unit: String,
    place: SidecarErrorPlace,
}

#[derive(Debug)]
struct Sidecar {
    file: String,
    file_error: SidecarErrorPlace,
    kind: RunKind,
    count_um: Option<f64>,
    /// The circle of a ballbar run, and its place in the sidecar.
    circle: Option<(Circle, SidecarErrorPlace)>,
    turns: Option<ReversalPoint>,
    date: Option<String>,
    note: Option<String>,
    zero: Option<String>,
    columns: Vec<DeclaredColumn>,
}

impl Sidecar {
    /// Copies the sidecar's facts about the whole run into a record.
    fn describe(&self, record: &mut Record) {
        let Self { file, date, note, zero, .. } = self;
        (record.file, record.date, record.note, record.zero) =
            (file.clone(), date.clone(), note.clone(), zero.clone());
        (record.count_um, record.turns) = (self.count_um, self.turns);
    }

    fn csv_path(&self, path: &Path) -> PathBuf {
        path.parent().unwrap_or(Path::new("")).join(&self.file)
    }

    fn names(&self) -> Vec<&str> {
        self.columns.iter().map(|c| c.name.as_str()).collect()
    }

    fn marks(
        &self,
        csv_path: &Path,
        csv: &mut (impl Read + Seek),
    ) -> Result<Option<TableNumberFormat>, InputError> {
        TableNumberFormat::find(csv_path, csv, &self.names())
    }

    /// Opens the CSV of the sidecar at `path`.
    fn open(&self, path: &Path) -> Result<(PathBuf, File), InputError> {
        let csv = self.csv_path(path);
        let file = open_regular(&csv).map_err(|e| self.unreadable(&csv, &e.found))?;
        Ok((csv, file))
    }

    fn unreadable(&self, csv: &Path, found: &str) -> InputError {
        self.file_error.clone().with(format!("`{}` ({found})", csv.display()), "a CSV that can be read")
    }

    fn parse(path: &Path, text: &str) -> Result<Self, InputError> {
        let mistaken = |e: InputError| FileKind::RunRecord.finding(path, text, e);
        let doc = Document::parse(path, text).map_err(mistaken)?;
        let root = doc.root();
        root.only(&KEYS).map_err(mistaken)?;
        file_format_stamp::check(&root)?;
        let file = root.required("file", "the CSV's name, as file = \"NAME.csv\"")?;
        let kind = root.required("kind", "the kind of run, as kind = \"positioning\"")?;
        let kinds = RunKind::ALL.map(|(name, _)| name).join(", ");
        let parsed_kind = RunKind::parse(kind.str("a kind of run")?)
            .ok_or_else(|| kind.error(format!("kind `{}`", kind.text()), format!("one of {kinds}")))?;
        let count_um = root.get("count_um").map(|v| v.positive("µm per count, above zero")).transpose()?;
        let circle = read_circle(&root)?;
        let turns = read_turns(&root, parsed_kind)?;
        // A date may be one of TOML's own, or a string.
        let day = |v: rtec_files::strict_toml::TomlKeyValue<'_>| match date::parse(&v.text()) {
            Some(_) => Ok(v.text()),
            None => Err(v.error(v.text(), "a day as 2026-05-01")),
        };
        let date = root.get("date").map(day).transpose()?;
        let zero = root.get("zero").map(|v| v.str("a name").map(str::to_owned)).transpose()?;
        let note = root.get("note").map(|v| v.str("free text").map(str::to_owned)).transpose()?;
        let listed =
            root.required("columns", "a table [columns] of the CSV's columns")?.table("a table [columns]")?;
        let mut columns: Vec<DeclaredColumn> = Vec::new();
        for entry in listed.entries() {
            let t = entry.table("{ role = \"…\", unit = \"…\" }")?;
            t.only(&["role", "unit"])?;
            let role_value = t.required("role", ROLES)?;
            let role = Role::parse(role_value.str(ROLES)?)
                .ok_or_else(|| role_value.error(format!("role `{}`", role_value.text()), ROLES))?;
            let unit_value = t.required("unit", "the column's unit, as unit = \"mm\"")?;
            let unit = unit_value.str("a unit")?;
            if role.is_rotary(unit) {
                let found = format!("role `{role}` in `{unit}`, of a rotary axis");
                return Err(role_value.error(found, LINEAR));
            }
            if let Some(expected) = role.unit().filter(|_| !role.accepts_unit(unit)) {
                let or = if role.accepts_unit("arcsec") { " or \"arcsec\"" } else { "" };
                let expected = format!("\"{expected}\"{or}, the unit of role `{role}`");
                return Err(unit_value.error(format!("unit `{unit}`"), expected));
            }
            if let Some(stated) = column_units::contradicted(entry.key(), unit) {
                let found = format!("unit `{unit}` of column {}: its name says {stated}", entry.key());
                let expected = format!(
                    "the column in {unit} under a name that says so, as `characterise import --columns '{}={role}'` writes it",
                    entry.key()
                );
                return Err(unit_value.error(found, expected));
            }
            if !role.may_repeat() && columns.iter().any(|c| c.role == role) {
                return Err(role_value.error(format!("role `{role}` a second time"), "each role once"));
            }
            let place = SidecarErrorPlace(entry.key_error("", ""));
            columns.push(DeclaredColumn { name: entry.key().to_owned(), role, unit: unit.to_owned(), place });
        }
        let file_error = SidecarErrorPlace(file.error("", ""));
        let file = file.str("the CSV's name")?.to_owned();
        Ok(Self { file, file_error, kind: parsed_kind, count_um, circle, turns, date, note, zero, columns })
    }
}

/// The bar's length and the plane of a ballbar run: both or neither.
fn read_circle(root: &Table<'_>) -> Result<Option<(Circle, SidecarErrorPlace)>, InputError> {
    const LENGTH: &str = "the bar's nominal length beside `plane`, as radius_mm = 150.0";
    const PLANE: &str =
        "two axes, the angle running from the first towards the second, as plane = [\"x\", \"y\"]";
    let (radius, plane) = match (root.get("radius_mm"), root.get("plane")) {
        (None, None) => {
            return match root.get("centre_mm") {
                Some(centre) => {
                    Err(centre.error("`centre_mm` without a circle", "radius_mm and plane beside it"))
                }
                None => Ok(None),
            };
        }
        (Some(radius), plane) => {
            (radius, plane.ok_or_else(|| radius.error("no `plane` beside `radius_mm`", PLANE))?)
        }
        (None, Some(plane)) => return Err(plane.error("no `radius_mm` beside `plane`", LENGTH)),
    };
    let radius_mm = radius.positive(LENGTH)?;
    let names = plane.strings(PLANE)?;
    let axes: Option<Vec<Axis>> = names.iter().map(|n| Axis::new(n)).collect();
    let plane_axes: [Axis; 2] = axes.and_then(|a| a.try_into().ok()).ok_or_else(|| plane.mismatch(PLANE))?;
    let centre = "where the circle's centre is on the two axes, mm, as centre_mm = [250.0, 120.0]";
    let two = |v: rtec_files::strict_toml::TomlKeyValue<'_>| {
        let numbers = v.numbers(centre)?;
        <[f64; 2]>::try_from(numbers).map_err(|_| v.mismatch(centre))
    };
    let centre_mm = root.get("centre_mm").map(two).transpose()?;
    Ok(Some((Circle { radius_mm, plane: plane_axes, centre_mm }, SidecarErrorPlace(plane.error("", "")))))
}

/// Reads where a positioning run turned back: at the end targets or beyond.
fn read_turns(root: &Table<'_>, kind: RunKind) -> Result<Option<ReversalPoint>, InputError> {
    const TURNS: &str =
        "turns = \"overtravel\" (the axis turned back beyond the end targets) or \"at_target\"";
    let over = root.get("over_mm");
    let Some(turns) = root.get("turns") else {
        return match over {
            Some(over) => Err(over.error("`over_mm` without `turns`", "turns = \"overtravel\" beside it")),
            None => Ok(None),
        };
    };
    if kind != RunKind::Positioning {
        return Err(
            turns.error(format!("`turns` in a run of kind {}", kind.name()), "kind = \"positioning\"")
        );
    }
    let over_mm = over.map(|v| v.positive("how far beyond the end targets, mm, above zero")).transpose()?;
    match (turns.str(TURNS)?, over_mm) {
        ("overtravel", over_mm) => Ok(Some(ReversalPoint::Overtravel(over_mm))),
        ("at_target", None) => Ok(Some(ReversalPoint::AtTarget)),
        ("at_target", Some(_)) => {
            Err(turns.error("`over_mm` beside turns = \"at_target\"", "turns = \"overtravel\""))
        }
        (other, _) => Err(turns.error(format!("`{other}`"), TURNS)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rtec_model::record::Axis;
    use std::io::Cursor;

    const SIDECAR: &str = "file = \"y.csv\"\nkind = \"positioning\"\ncount_um = 1.0\n[columns]\n\
                           t = { role = \"time\", unit = \"s\" }\ny = { role = \"position.y\", unit = \"mm\" }\n\
                           T3 = { role = \"temperature\", unit = \"degC\" }\ne = { role = \"error.y\", unit = \"um\" }\n";

    fn read(sidecar: &str, csv: &str) -> Result<Record, InputError> {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("y.csv"), csv).unwrap();
        std::fs::write(dir.path().join("y.run.toml"), sidecar).unwrap();
        super::read(&dir.path().join("y.run.toml"))
    }

    #[test]
    fn bom_crlf_comments_quotes_and_unlisted_columns() {
        let csv = "\u{feff}# bench 3\r\n\"t\", y,extra,T3,e # names\r\n0,1.5,x,20,3\r\n\r\n 1 , 2.5,,20.5,-4e0 # last\r\n";
        let r = read(&format!("\u{feff}{}", SIDECAR.replace('\n', "\r\n")), csv).unwrap();
        assert_eq!(r.rows(), 2);
        assert_eq!(r.time_s(), [0.0, 1.0]);
        assert_eq!(r.temperature("T3"), Some(&[20.0, 20.5][..]));
        assert_eq!(r.responses().next().unwrap().data, [3.0, -4.0]);
        assert_eq!(r.count_um, Some(1.0));
        assert_eq!(r.columns.iter().map(Column::label).collect::<Vec<_>>()[2], "temperature.T3");
    }

    #[test]
    fn a_header_with_a_quoted_comma_is_read_and_written() {
        let sidecar = SIDECAR.replace("T3 =", "\"T3, \\\"bed\\\" #2\" =");
        let csv = "t,\"y\", \"T3, \"\"bed\"\" #2\" ,e\n0,1.5,20,3\n1,2.5,\"20.5\",4\n";
        let mut r = read(&sidecar, csv).unwrap();
        assert_eq!(r.temperature("T3, \"bed\" #2"), Some(&[20.0, 20.5][..]));
        let folder = tempfile::tempdir().unwrap();
        r.path = folder.path().join("y.run.toml");
        write(&mut r).unwrap();
        assert_eq!(crate::run_record_files::read(&r.path).unwrap(), r);
        let more = csv_with(&r, &[("predicted, e".to_owned(), vec![1.0, 2.0])]).unwrap();
        assert!(more.starts_with("t,y,\"T3, \"\"bed\"\" #2\",e,\"predicted, e\"\n0,1.5,20,3,1\n"), "{more}");
    }

    #[test]
    fn findings_in_the_rows_carry_their_place() {
        for (rows, line, column, found) in [
            ("0,1,20\n", 2, 7, "after 3 of 4 fields"),
            ("0,1,20,3,4\n", 2, 10, "'4'"),
            ("0,1,20,\n", 2, 8, "nothing in column e"),
            ("0,1,20,nan\n", 2, 8, "nan"),
            ("0,1,20,inf\n", 2, 8, "inf"),
            ("0,1,abc,3\n", 2, 5, "'abc' in column T3"),
            ("0,1,20,3\n5,1,20,3\n4.5,1,20,3\n", 4, 1, "time 4.5 after 5"),
            ("0,1e300,20,3\n", 2, 3, "1e300"),
            ("0,1,20,-1e300\n", 2, 8, "-1e300"),
            ("", 2, 0, "no rows"),
        ] {
            let e = read(SIDECAR, &format!("t,y,T3,e\n{rows}")).unwrap_err();
            assert_eq!((e.line, e.column), (line, column), "{rows}: {e}");
            assert!(e.found.contains(found) && e.file.ends_with("y.csv"), "{rows}: {e}");
        }
        assert!(read(SIDECAR, "").unwrap_err().found.contains("no header"));
    }

    /// For any cells, the fast path reads what the full path reads.
    /// The first finding is the same too.
    #[test]
    fn rows_read_the_short_way_are_those_read_cell_by_cell() {
        use proptest::prelude::*;
        use proptest::strategy::ValueTree;
        let cell = prop_oneof![
            8 => (-2000..2000_i32, 0..5_usize).prop_map(|(n, d)| format!("{:.d$}", f64::from(n) / 64.0)),
            1 => any::<f64>().prop_map(|v| v.to_string()),
            2 => "[-+0-9.eE \",]{0,18}",
            1 => prop::sample::select(vec!["", "-", "-0", ".", "5.", ".5", "1e3", " 7 ", "\"3\"", "nan", "1e300", "+1", "\u{b5}"])
                .prop_map(str::to_owned),
        ];
        let rows = prop::collection::vec(prop::collection::vec(cell, 3..6), 1..8);
        let roles = ["time", "position.y", "temperature", "direction.y", "error.y"];
        let listed = |n: usize| {
            let of = Role::parse(roles[n]).unwrap();
            format!("c{n} = {{ role = \"{}\", unit = \"{}\" }}\n", roles[n], of.unit().unwrap())
        };
        let sidecar = "file = \"y.csv\"\nkind = \"positioning\"\n[columns]\n".to_owned()
            + &(0..5).map(listed).collect::<String>();
        let by_cells = |csv: &str| -> Result<Vec<Vec<f64>>, InputError> {
            let mut reader = Reader::new(Path::new("y.csv"), csv.as_bytes())?;
            let header = reader.header("a header line")?;
            let mut columns = vec![Vec::new(); 5];
            while let Some(row) = reader.row()? {
                header.each(row, |n, cell| {
                    let v = DecimalMarks::written('.')
                        .parse(cell.text())
                        .ok_or_else(|| header.named(n, cell.finding("a finite number")))?;
                    let checked = check(&Role::parse(roles[n]).unwrap(), v, columns[n].last().copied());
                    checked.map_err(|(f, e)| header.named(n, cell.finding_with_text(f, e)))?;
                    columns[n].push(v);
                    Ok(())
                })?;
            }
            if columns[0].is_empty() { Err(header.no_rows()) } else { Ok(columns) }
        };
        let bits = |columns: &[Vec<f64>]| -> Vec<Vec<u64>> {
            columns.iter().map(|c| c.iter().map(|v| v.to_bits()).collect()).collect()
        };
        let (mut good, mut bad) = (0, 0);
        let all = test_needs::fewer(4000);
        let mut runner = proptest::test_runner::TestRunner::deterministic();
        for _ in 0..all {
            let mut rows = rows.new_tree(&mut runner).unwrap().current();
            // Most rows have the right length and time that increases, because otherwise hardly any would be
            // read.
            for (n, row) in rows.iter_mut().enumerate() {
                let fits = row.iter().all(|c| c.parse::<f64>().is_ok());
                row[0] = if fits { n.to_string() } else { row[0].clone() };
                if fits {
                    row.resize(5, "3.25".to_owned());
                    row[3] = ["-1", "0", "1.0", "+1"][n % 4].to_owned();
                }
            }
            let text: String = rows.iter().map(|r| r.join(",") + "\n").collect();
            let csv = format!("c0,c1,c2,c3,c4\n{text}");
            let ours = parse_log(Path::new("y.run.toml"), &sidecar, Cursor::new(csv.as_bytes()));
            match (ours, by_cells(&csv)) {
                (Ok(ours), Ok(plain)) => {
                    good += 1;
                    let ours: Vec<Vec<f64>> = ours.columns.iter().map(|c| c.data.clone()).collect();
                    assert_eq!(bits(&ours), bits(&plain), "{csv}");
                }
                (Err(ours), Err(plain)) => {
                    bad += 1;
                    // Decimal commas get a further hint, and separated thousands another one.
                    let hints = ["written with semicolons", "may part thousands"];
                    let hint = hints.iter().any(|hint| ours.expected.contains(hint));
                    let expected = if hint { plain.expected.clone() } else { ours.expected.clone() };
                    assert_eq!(InputError { expected, ..ours }, plain, "{csv}");
                }
                (ours, plain) => panic!("{csv}: {ours:?}, {plain:?}"),
            }
        }
        assert!(good > all / 40 && bad > all / 40, "{good} read, {bad} refused");
    }

    #[test]
    fn reads_tables_as_spreadsheets_save_them() {
        let german = "t;y;T3;e\r\n0;1.000,5;20;-7,3703\r\n";
        let utf16 = |text: &str| -> Vec<u8> {
            "\u{feff}".encode_utf16().chain(text.encode_utf16()).flat_map(u16::to_le_bytes).collect()
        };
        for (bytes, written) in [
            (german.as_bytes().to_vec(), "columns parted by semicolons, decimal commas"),
            (format!("sep=;\n{german}").into_bytes(), "columns parted by semicolons, decimal commas"),
            (german.replace(';', "\t").into_bytes(), "columns parted by tabs, decimal commas"),
            (utf16(german), "UTF-16, columns parted by semicolons, decimal commas"),
            (b"t,y,T3,e\n0,\"1.000,5\",20,\"-7,3703\"\n".to_vec(), "decimal commas"),
            (b"t;y;T3;e\n0;1000.5;20;-7.3703\n".to_vec(), "columns parted by semicolons"),
        ] {
            let record = parse_log(Path::new("y.run.toml"), SIDECAR, Cursor::new(bytes)).unwrap();
            let data: Vec<f64> = record.columns.iter().map(|c| c.data[0]).collect();
            assert_eq!(data, [0.0, 1000.5, 20.0, -7.3703], "{written}");
            assert_eq!(record.written, Some(format!("y.csv: read as {written}")));
        }
        let plain =
            parse_log(Path::new("y.run.toml"), SIDECAR, Cursor::new("t,y,T3,e\n0,\"1,000.5\",20,2.5\n"));
        assert_eq!(plain.unwrap().written, None);
    }

    #[test]
    fn a_separator_in_a_name_parts_nothing() {
        let sidecar = SIDECAR.replace("T3 =", "\"T3; bed\" =");
        let record = read(&sidecar, "t,y,T3; bed,e\n0,1,20,3\n").unwrap();
        assert_eq!(record.temperature("T3; bed"), Some(&[20.0][..]));
    }

    #[test]
    fn rows_that_pass_for_comments_are_said() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("y.csv"), "n,t,e\n#1,0,1\n#2,1,1\n3,2,1\n").unwrap();
        let sidecar = "file = \"y.csv\"\nkind = \"drift\"\n[columns]\nt = { role = \"time\", unit = \"s\" }\n\
                       e = { role = \"error.y\", unit = \"um\" }\n";
        let path = folder.path().join("y.run.toml");
        std::fs::write(&path, sidecar).unwrap();
        let record = super::read(&path).unwrap();
        assert_eq!(record.rows(), 1);
        assert!(record.written.unwrap().contains("2 lines begin with # and a row's cells (line 2 first)"));
    }

    #[test]
    fn further_columns_are_written_as_the_table_is() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("y.run.toml");
        std::fs::write(&path, SIDECAR).unwrap();
        for (csv, with) in [
            ("t;y;T3;e;memo\n0;1,5;20;-7;a,b\n", "t;y;T3;e;memo;p\n0;1,5;20;-7;a,b;0,25\n"),
            ("t,y,T3,e\n0,\"1,5\",20,-7\n", "t,y,T3,e,p\n0,\"1,5\",20,-7,\"0,25\"\n"),
            ("t,y,T3,e\n0,1.5,20,-7\n", "t,y,T3,e,p\n0,1.5,20,-7,0.25\n"),
        ] {
            std::fs::write(folder.path().join("y.csv"), csv).unwrap();
            let record = super::read(&path).unwrap();
            assert_eq!(csv_with(&record, &[("p".to_owned(), vec![0.25])]).unwrap(), with);
        }
    }

    #[test]
    fn numbers_with_two_readings_are_refused() {
        let between = "2:11: found '3703', expected the end of the row after t,y,T3,e; or, if these are decimal commas between \
                       commas, the table written with semicolons";
        let nameless = "1:1: found numbers ('0,1.5,20,3') in the first line, expected the columns' names there: the line that \
                        names them is missing";
        for (csv, says) in [
            ("t,y,T3,e\n0,1,20,-7,3703\n", between),
            ("0,1.5,20,3\n1,1.5,20,3\n", nameless),
            (
                "t;y;T3;e\n0;1.000;20;1,5\n",
                "2:3: found '1.000' in column y, expected a decimal comma, as the numbers beside it: a dot beside decimal commas may \
                 part thousands",
            ),
        ] {
            let error = read(SIDECAR, csv).unwrap_err();
            assert!(error.to_string().ends_with(&format!("y.csv:{says}")), "{error}\n{says}");
        }
        assert!(read(SIDECAR, &"0,1,20,3\r".repeat(3000)).unwrap_err().to_string().len() < 300);
    }

    #[test]
    fn findings_in_the_sidecar_carry_their_place() {
        for (from, to, line, column, found) in [
            ("count_um", "count", 3, 1, "unknown key count"),
            ("count_um = 1.0", "date = \"1.5.2026\"", 3, 8, "1.5.2026"),
            ("positioning", "walking", 2, 8, "kind `walking`"),
            ("\"time\"", "\"clock\"", 5, 14, "role `clock`"),
            ("position.y", "position", 6, 14, "role `position`"),
            ("unit = \"mm\"", "unit = \"um\"", 6, 35, "unit `um`"),
            ("degC\" }", "degC\", x = 1 }", 7, 45, "unknown key x"),
            ("1.0", "-1.0", 3, 12, "count_um"),
            ("1.0", "nan", 3, 12, "count_um"),
            ("T3 =", "T4 =", 7, 1, "column `T4`"),
            ("error.y", "position.x", 8, 35, "unit `um`"),
            ("y.csv", "z.csv", 1, 8, "z.csv"),
        ] {
            let e = read(&SIDECAR.replacen(from, to, 1), "t,y,T3,e\n0,1,20,3\n").unwrap_err();
            assert_eq!((e.line, e.column), (line, column), "{to}: {e}");
            assert!(e.found.contains(found) && e.file.ends_with("y.run.toml"), "{to}: {e}");
        }
        let twice = format!("{SIDECAR}y2 = {{ role = \"position.y\", unit = \"mm\" }}\n");
        assert!(read(&twice, "t,y,T3,e,y2\n0,1,20,3,1\n").unwrap_err().found.contains("second time"));
        let none = SIDECAR.replace("error.y", "channel");
        assert!(read(&none, "t,y,T3,e\n0,1,20,3\n").unwrap_err().found.contains("no response"));
    }

    #[test]
    fn written_record_reads_back() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.run.toml");
        let y = Axis::new("y").unwrap();
        let column = |name: &str, role: Role, unit: &str, data: &[f64]| Column {
            name: name.into(),
            role,
            unit: unit.into(),
            data: data.to_vec(),
        };
        let columns = vec![
            column("t", Role::Time, "s", &[0.0, 0.1, 0.1 + 0.2]),
            column("bar", Role::Channel, "bar", &[1e-9, 2.0, 3.0]),
            column("e", Role::Error(y), "um", &[0.1, -0.2, 1e8]),
        ];
        let mut r = Record::new(&path, RunKind::Drift, columns).unwrap();
        r.count_um = Some(0.5);
        r.date = Some("2026-05-01".into());
        r.note = Some("simulated".into());
        r.zero = Some("probe on the table".into());
        write(&mut r).unwrap();
        assert_eq!(crate::run_record_files::read(&path).unwrap(), r);
        assert_eq!(r.sha256.len(), 64);
    }

    const BALLBAR: &str = "file = \"y.csv\"\nkind = \"ballbar\"\nradius_mm = 150.0\nplane = [\"x\", \"y\"]\n[columns]\n\
                           a = { role = \"angle\", unit = \"rad\" }\ne = { role = \"error.r\", unit = \"um\" }\n";

    #[test]
    fn a_ballbar_s_length_and_plane_are_kept_and_written_back() {
        let mut r = read(BALLBAR, "a,e\n0,1\n0.1,2\n0.2,3\n").unwrap();
        let circle = r.circle().unwrap();
        assert_eq!((circle.radius_mm, circle.plane[1].as_str()), (150.0, "y"));
        let folder = tempfile::tempdir().unwrap();
        r.path = folder.path().join("b.run.toml");
        r.file = "b.csv".into();
        write(&mut r).unwrap();
        assert_eq!(crate::run_record_files::read(&r.path).unwrap(), r);
        let text = std::fs::read_to_string(&r.path).unwrap();
        assert!(text.contains("radius_mm = 150.0\nplane = [\"x\", \"y\"]\n"), "{text}");
        // Columns derived from the angle are not written.
        assert_eq!(std::fs::read_to_string(folder.path().join("b.csv")).unwrap(), "a,e\n0,1\n0.1,2\n0.2,3\n");
        // A run without these keys reads as before.
        let plain = BALLBAR.replace("radius_mm = 150.0\nplane = [\"x\", \"y\"]\n", "");
        assert_eq!(read(&plain, "a,e\n0,1\n").unwrap().circle(), None);
    }

    #[test]
    fn findings_in_a_ballbar_s_sidecar_carry_their_place() {
        for (from, to, line, column, found, expected) in [
            ("150.0", "0.0", 3, 13, "radius_mm = 0.0", "nominal length"),
            ("150.0", "\"150\"", 3, 13, "radius_mm", "nominal length"),
            ("radius_mm = 150.0\n", "", 3, 9, "no `radius_mm`", "radius_mm = 150.0"),
            ("plane = [\"x\", \"y\"]\n", "", 3, 13, "no `plane`", "plane = [\"x\", \"y\"]"),
            ("[\"x\", \"y\"]", "\"xy\"", 4, 9, "plane = \"xy\"", "two axes"),
            ("[\"x\", \"y\"]", "[\"x\"]", 4, 9, "plane = [\"x\"]", "two axes"),
            ("[\"x\", \"y\"]", "[\"x\", \"x\"]", 4, 9, "plane of x and x", "two axes"),
            ("[\"x\", \"y\"]", "[\"x\", \"1\"]", 4, 9, "plane = ", "two axes"),
            ("\"ballbar\"", "\"probing\"", 4, 9, "kind probing", "ballbar"),
            ("error.r", "error.x", 4, 9, "no radial error", "error.r"),
            ("\"angle\", unit = \"rad\"", "\"cycle\", unit = \"1\"", 4, 9, "no angle", "role angle"),
        ] {
            let e = read(&BALLBAR.replacen(from, to, 1), "a,e\n0,1\n").unwrap_err();
            assert_eq!((e.line, e.column), (line, column), "{to}: {e}");
            assert!(e.found.contains(found) && e.expected.contains(expected), "{to}: {e}");
        }
    }

    /// A circle in x and y whose sidecar says x and z.
    /// The places of z would be taken from the angle. An axis that is not logged is allowed otherwise.
    #[test]
    fn a_plane_of_an_axis_that_nobody_logged_is_found() {
        let logged = "a = { role = \"angle\", unit = \"rad\" }\nx = { role = \"position.x\", unit = \"mm\" }\n\
                      y = { role = \"position.y\", unit = \"mm\" }\n";
        let sidecar = BALLBAR.replace("a = { role = \"angle\", unit = \"rad\" }\n", logged);
        let rows = "a,x,y,e\n0,150,0,1\n1.5707963,0,150,2\n3.1415926,-150,0,1\n";
        assert!(read(&sidecar, rows).is_ok());
        let e = read(&sidecar.replace("\"y\"]", "\"z\"]"), rows).unwrap_err();
        assert_eq!((e.line, e.column), (4, 9), "{e}");
        assert!(e.found.contains("no position of z, while y moves") && e.expected.contains("logs"), "{e}");
        // z is the height of the plane; and an axis of the plane may be known by the angle alone.
        let height = rows.replace(",150,2", ",0,2");
        assert!(read(&sidecar.replace("\"y\"]", "\"z\"]"), &height).is_ok());
        assert!(read(&BALLBAR.replace("\"y\"]", "\"z\"]"), "a,e\n0,1\n0.1,2\n").is_ok());
    }

    #[test]
    fn tilts_are_in_urad_or_arcsec() {
        let sidecar = |unit: &str| {
            format!(
                "file = \"y.csv\"\nkind = \"positioning\"\n[columns]\nx = {{ role = \"position.x\", unit = \"mm\" }}\n\
                 rx = {{ role = \"angle_error.x.b\", unit = \"{unit}\" }}\n"
            )
        };
        for unit in ["urad", "arcsec"] {
            let mut r = read(&sidecar(unit), "x,rx\n0,1\n1,2\n").unwrap();
            assert_eq!(
                (r.columns[1].role.to_string().as_str(), r.columns[1].unit.as_str()),
                ("angle_error.x.b", unit)
            );
            assert_eq!(r.responses().count(), 0);
            let folder = tempfile::tempdir().unwrap();
            r.path = folder.path().join("t.run.toml");
            r.file = "t.csv".into();
            write(&mut r).unwrap();
            assert_eq!(crate::run_record_files::read(&r.path).unwrap(), r);
        }
        let e = read(&sidecar("um"), "x,rx\n0,1\n").unwrap_err();
        assert!(e.found.contains("unit `um`") && e.expected.contains("\"urad\" or \"arcsec\""), "{e}");
        let e = read(&sidecar("urad").replace(".x.b", ".x"), "x,rx\n0,1\n").unwrap_err();
        assert!(e.found.contains("angle_error.x"), "{e}");
    }

    #[test]
    fn without_time_the_row_number_stands_for_seconds() {
        let sidecar = SIDECAR.replace("t = { role = \"time\", unit = \"s\" }\n", "");
        let r = read(&sidecar, "t,y,T3,e\n9,1,20,3\n8,1,20,3\n").unwrap();
        assert_eq!(r.time_s(), [0.0, 1.0]);
    }
}
