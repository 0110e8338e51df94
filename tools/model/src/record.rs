//! Run records: `NAME.run.toml` beside a CSV (formats.md, "Run record"), read strictly and written whole.

use crate::date;
use rtec_files::InputError;
use rtec_files::csv::{self, Reader};
use rtec_files::toml::Document;
use sha2::{Digest, Sha256};
use std::fmt;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// The name of an axis (`x`, `y`, `z`, `c`; `r` for the radial error of a probing run).
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Axis(String);

impl Axis {
    /// An axis name: a letter, then letters, digits or `_`.
    #[must_use]
    pub fn new(name: &str) -> Option<Self> {
        let mut chars = name.chars();
        let ok = chars.next().is_some_and(|c| c.is_ascii_alphabetic())
            && chars.all(|c| c.is_ascii_alphanumeric() || c == '_');
        ok.then(|| Self(name.to_owned()))
    }

    /// The name as written.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for Axis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// What a column is. Errors and forces are responses, everything else is what they may depend on.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Role {
    /// Time, s; never decreasing.
    Time,
    /// Position of an axis, mm.
    Position(Axis),
    /// Direction of approach of an axis, −1, 0 or +1.
    Direction(Axis),
    /// Signed velocity of an axis, mm/s.
    Velocity(Axis),
    /// Acceleration of an axis, mm/s².
    Acceleration(Axis),
    /// Number of the repeat.
    Cycle,
    /// Temperature, °C; the column's own name is the sensor's name.
    Temperature,
    /// Spindle speed, rpm.
    SpindleSpeed,
    /// Coolant, on when above one half.
    Coolant,
    /// Load on an axis, N.
    Load(Axis),
    /// Angle on the part or of probing, rad.
    Angle,
    /// Any other logged quantity, in any unit.
    Channel,
    /// Response: measured minus nominal, µm.
    Error(Axis),
    /// Response of a dynamics run: force, N.
    Force(Axis),
}

impl Role {
    /// The role of this name (`time`, `position.y`, …).
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        let (head, axis) = match text.split_once('.') {
            Some((head, axis)) => (head, Some(Axis::new(axis)?)),
            None => (text, None),
        };
        Some(match (head, axis) {
            ("time", None) => Self::Time,
            ("cycle", None) => Self::Cycle,
            ("temperature", None) => Self::Temperature,
            ("spindle_speed", None) => Self::SpindleSpeed,
            ("coolant", None) => Self::Coolant,
            ("angle", None) => Self::Angle,
            ("channel", None) => Self::Channel,
            ("position", Some(a)) => Self::Position(a),
            ("direction", Some(a)) => Self::Direction(a),
            ("velocity", Some(a)) => Self::Velocity(a),
            ("acceleration", Some(a)) => Self::Acceleration(a),
            ("load", Some(a)) => Self::Load(a),
            ("error", Some(a)) => Self::Error(a),
            ("force", Some(a)) => Self::Force(a),
            _ => return None,
        })
    }

    /// The unit this role is given in; `None` where any will do (a channel).
    #[must_use]
    pub fn unit(&self) -> Option<&'static str> {
        Some(match self {
            Self::Time => "s",
            Self::Position(_) => "mm",
            Self::Direction(_) | Self::Cycle | Self::Coolant => "1",
            Self::Velocity(_) => "mm/s",
            Self::Acceleration(_) => "mm/s2",
            Self::Temperature => "degC",
            Self::SpindleSpeed => "rpm",
            Self::Load(_) | Self::Force(_) => "N",
            Self::Angle => "rad",
            Self::Error(_) => "um",
            Self::Channel => return None,
        })
    }

    /// An error or a force: what a model predicts.
    #[must_use]
    pub fn is_response(&self) -> bool {
        matches!(self, Self::Error(_) | Self::Force(_))
    }

    /// The axis it belongs to.
    #[must_use]
    pub fn axis(&self) -> Option<&Axis> {
        match self {
            Self::Position(a)
            | Self::Direction(a)
            | Self::Velocity(a)
            | Self::Acceleration(a)
            | Self::Load(a)
            | Self::Error(a)
            | Self::Force(a) => Some(a),
            _ => None,
        }
    }

    /// Only temperatures and channels may stand in several columns.
    fn may_repeat(&self) -> bool {
        matches!(self, Self::Temperature | Self::Channel)
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let head = match self {
            Self::Time => "time",
            Self::Position(_) => "position",
            Self::Direction(_) => "direction",
            Self::Velocity(_) => "velocity",
            Self::Acceleration(_) => "acceleration",
            Self::Cycle => "cycle",
            Self::Temperature => "temperature",
            Self::SpindleSpeed => "spindle_speed",
            Self::Coolant => "coolant",
            Self::Load(_) => "load",
            Self::Angle => "angle",
            Self::Channel => "channel",
            Self::Error(_) => "error",
            Self::Force(_) => "force",
        };
        match self.axis() {
            Some(axis) => write!(f, "{head}.{axis}"),
            None => f.write_str(head),
        }
    }
}

const ROLES: &str = "a role: time, cycle, temperature, spindle_speed, coolant, angle, channel, or position, direction, \
     velocity, acceleration, load, error, force with an axis (position.y)";

/// What kind of run a record is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[allow(missing_docs)]
pub enum Kind {
    Positioning,
    Drift,
    Ballbar,
    Plate,
    Dynamics,
    Probing,
    FeedSweep,
    Part,
}

impl Kind {
    const ALL: [(&'static str, Self); 8] = [
        ("positioning", Self::Positioning),
        ("drift", Self::Drift),
        ("ballbar", Self::Ballbar),
        ("plate", Self::Plate),
        ("dynamics", Self::Dynamics),
        ("probing", Self::Probing),
        ("feed_sweep", Self::FeedSweep),
        ("part", Self::Part),
    ];

    /// The kind of this name.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL.iter().find(|(name, _)| *name == text).map(|&(_, kind)| kind)
    }

    /// Its name in a sidecar.
    #[must_use]
    pub fn name(self) -> &'static str {
        Self::ALL[self as usize].0
    }
}

/// One column that the sidecar lists.
#[derive(Debug, Clone, PartialEq)]
pub struct Column {
    /// Name in the CSV's header; a temperature's or channel's name.
    pub name: String,
    /// What it is.
    pub role: Role,
    /// Its unit, as written.
    pub unit: String,
    /// One value per row.
    pub data: Vec<f64>,
}

impl Column {
    /// How a verdict names it: its role, or `temperature.T3`, `channel.z9`.
    #[must_use]
    pub fn label(&self) -> String {
        if self.role.may_repeat() { format!("{}.{}", self.role, self.name) } else { self.role.to_string() }
    }
}

/// One run: its columns in the CSV's order, rows in order of acquisition.
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    /// The sidecar, as the user named it.
    pub path: PathBuf,
    /// The CSV as the sidecar names it.
    pub file: String,
    /// SHA-256 of the CSV, in hexadecimal; empty for a record made in memory.
    pub sha256: String,
    /// What kind of run it is.
    pub kind: Kind,
    /// What one count is worth, µm.
    pub count_um: Option<f64>,
    /// The day of the run, as ISO 8601.
    pub date: Option<String>,
    /// Free text about the run.
    pub note: Option<String>,
    /// The listed columns, in the CSV's order.
    pub columns: Vec<Column>,
    time_s: Vec<f64>,
}

impl Record {
    /// A record made in memory (by the simulator or the recorder).
    ///
    /// # Errors
    /// The same findings as [`Record::read`]: columns of unequal length, a role given twice, a value that is not
    /// finite, time running backwards, no response.
    pub fn new(path: &Path, kind: Kind, columns: Vec<Column>) -> Result<Self, InputError> {
        let whole = |found: String, expected: &str| InputError::whole(path, found, expected);
        for (i, c) in columns.iter().enumerate() {
            if columns[..i].iter().any(|d| d.name == c.name) {
                return Err(whole(format!("two columns named `{}`", c.name), "each name once"));
            }
            if !c.role.may_repeat() && columns[..i].iter().any(|d| d.role == c.role) {
                return Err(whole(format!("role `{}` twice", c.role), "each role once"));
            }
            if c.role.unit().is_some_and(|u| u != c.unit) {
                return Err(whole(format!("unit `{}` of role `{}`", c.unit, c.role), "the role's unit"));
            }
            if c.data.len() != columns[0].data.len() {
                return Err(whole(
                    format!("{} values in `{}`", c.data.len(), c.name),
                    "as many in every column",
                ));
            }
            for (row, &v) in c.data.iter().enumerate() {
                if let Err((found, expected)) = check(&c.role, v, row.checked_sub(1).map(|p| c.data[p])) {
                    return Err(InputError::at(path, row + 2, i + 1, found, expected));
                }
            }
        }
        if !columns.iter().any(|c| c.role.is_response()) {
            return Err(whole("no response".into(), "a column of role error.AXIS or force.AXIS"));
        }
        if columns[0].data.is_empty() {
            return Err(whole("no rows".into(), "at least one"));
        }
        let stem = path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
        let file = format!("{}.csv", stem.strip_suffix(".run.toml").unwrap_or(&stem));
        let time_s = times(&columns);
        Ok(Self {
            path: path.to_owned(),
            file,
            sha256: String::new(),
            kind,
            count_um: None,
            date: None,
            note: None,
            columns,
            time_s,
        })
    }

    /// Reads a record from its sidecar.
    ///
    /// # Errors
    /// The first finding, with file, line and column: unreadable file, unknown key, kind or role, wrong unit, a
    /// listed column that is not in the CSV, a short row, a value that is missing or not finite, time running
    /// backwards, no response.
    pub fn read(path: &Path) -> Result<Self, InputError> {
        let record = Self::read_log(path)?;
        if record.responses().next().is_none() {
            let found = "no response among the columns";
            return Err(InputError::whole(path, found, "a column of role error.AXIS or force.AXIS"));
        }
        Ok(record)
    }

    /// Reads a log: a record that need not have a response (a recorded shift).
    ///
    /// # Errors
    /// As [`Record::read`], but for the response.
    pub fn read_log(path: &Path) -> Result<Self, InputError> {
        let sidecar = Sidecar::read(path)?;
        let csv_path = path.parent().unwrap_or(Path::new("")).join(&sidecar.file);
        let bytes = std::fs::read(&csv_path).map_err(|e| {
            sidecar
                .file_error
                .clone()
                .with(format!("`{}` ({e})", csv_path.display()), "a CSV that can be read")
        })?;
        let columns = parse_csv(&csv_path, &bytes, &sidecar)?;
        let time_s = times(&columns);
        Ok(Self {
            path: path.to_owned(),
            file: sidecar.file,
            sha256: hex(&Sha256::digest(&bytes)),
            kind: sidecar.kind,
            count_um: sidecar.count_um,
            date: sidecar.date,
            note: sidecar.note,
            columns,
            time_s,
        })
    }

    /// Number of rows.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.time_s.len()
    }

    /// Time of every row, s: the time column as it stands, or the row number where there is none.
    #[must_use]
    pub fn time_s(&self) -> &[f64] {
        &self.time_s
    }

    /// The column of a role that can stand only once.
    #[must_use]
    pub fn column(&self, role: &Role) -> Option<&Column> {
        self.columns.iter().find(|c| c.role == *role)
    }

    /// Its values.
    #[must_use]
    pub fn data(&self, role: &Role) -> Option<&[f64]> {
        self.column(role).map(|c| c.data.as_slice())
    }

    /// A temperature by its sensor's name.
    #[must_use]
    pub fn temperature(&self, sensor: &str) -> Option<&[f64]> {
        self.named(&Role::Temperature, sensor)
    }

    /// A logged channel by its name.
    #[must_use]
    pub fn channel(&self, name: &str) -> Option<&[f64]> {
        self.named(&Role::Channel, name)
    }

    fn named(&self, role: &Role, name: &str) -> Option<&[f64]> {
        self.columns.iter().find(|c| c.role == *role && c.name == name).map(|c| c.data.as_slice())
    }

    /// The responses, in the CSV's order.
    pub fn responses(&self) -> impl Iterator<Item = &Column> {
        self.columns.iter().filter(|c| c.role.is_response())
    }

    /// The names of all columns of a role (sensors, channels), in the CSV's order.
    pub fn names(&self, role: &Role) -> impl Iterator<Item = &str> {
        self.columns.iter().filter(move |c| c.role == *role).map(|c| c.name.as_str())
    }

    /// The axes that have a column of the role that `role` makes, in the CSV's order.
    pub fn axes(&self, role: fn(Axis) -> Role) -> impl Iterator<Item = &Axis> {
        self.columns.iter().filter_map(move |c| {
            let axis = c.role.axis()?;
            (role(axis.clone()) == c.role).then_some(axis)
        })
    }

    /// A record of some rows only, in the given order, for cross-validation; the time stays each row's own.
    ///
    /// # Panics
    /// When a row is out of range.
    #[must_use]
    pub fn select(&self, rows: &[usize]) -> Self {
        let pick = |data: &[f64]| rows.iter().map(|&r| data[r]).collect::<Vec<_>>();
        Self {
            columns: self.columns.iter().map(|c| Column { data: pick(&c.data), ..c.clone() }).collect(),
            time_s: pick(&self.time_s),
            ..self.clone()
        }
    }

    /// The CSV's own rows (unlisted columns too) with further columns at the end, as CSV text.
    ///
    /// # Errors
    /// The CSV can no longer be read, or its number of rows has changed since.
    pub fn csv_with(&self, extra: &[(String, Vec<f64>)]) -> Result<String, InputError> {
        let path = self.path.parent().unwrap_or(Path::new("")).join(&self.file);
        let mut reader = Reader::open(&path)?;
        let mut out = String::with_capacity(24 * (self.columns.len() + extra.len()) * self.rows());
        let header = reader.header("a header line")?;
        out.push_str(header.text());
        for (name, _) in extra {
            let _ = write!(out, ",{}", csv::cell(name));
        }
        out.push('\n');
        let mut n = 0;
        while let Some(row) = reader.row()? {
            out.push_str(row.text());
            for (_, data) in extra {
                let Some(v) = data.get(n) else { break };
                let _ = write!(out, ",{v}");
            }
            out.push('\n');
            n += 1;
        }
        if n != self.rows() {
            let expected = format!("{} rows, as when it was read", self.rows());
            return Err(InputError::whole(&path, format!("{n} rows"), expected));
        }
        Ok(out)
    }

    /// The CSV text of the record's columns: shortest decimal that reads back as the same number.
    #[must_use]
    pub fn to_csv(&self) -> String {
        let mut out = csv::header_line(self.columns.iter().map(|c| c.name.as_str()));
        out.push('\n');
        for row in 0..self.rows() {
            for (i, c) in self.columns.iter().enumerate() {
                let sep = if i == 0 { "" } else { "," };
                let _ = write!(out, "{sep}{}", c.data[row]);
            }
            out.push('\n');
        }
        out
    }

    /// The sidecar's text.
    #[must_use]
    pub fn to_sidecar(&self) -> String {
        let mut doc = toml_edit::DocumentMut::new();
        doc["file"] = toml_edit::value(&self.file);
        doc["kind"] = toml_edit::value(self.kind.name());
        if let Some(um) = self.count_um {
            doc["count_um"] = toml_edit::value(um);
        }
        if let Some(date) = &self.date {
            doc["date"] = toml_edit::value(date);
        }
        if let Some(note) = &self.note {
            doc["note"] = toml_edit::value(note);
        }
        let mut columns = toml_edit::Table::new();
        for c in &self.columns {
            let mut t = toml_edit::InlineTable::new();
            t.insert("role", c.role.to_string().into());
            t.insert("unit", c.unit.as_str().into());
            columns.insert(&c.name, toml_edit::value(t));
        }
        doc["columns"] = toml_edit::Item::Table(columns);
        doc.to_string()
    }

    /// Writes `NAME.run.toml` (at [`Record::path`]) and its CSV, each whole or not at all; sets the hash.
    ///
    /// # Errors
    /// The directory cannot be written.
    pub fn write(&mut self) -> std::io::Result<()> {
        let csv = self.to_csv();
        let dir = self.path.parent().unwrap_or(Path::new(""));
        rtec_files::write::whole(&dir.join(&self.file), csv.as_bytes())?;
        self.sha256 = hex(&Sha256::digest(csv.as_bytes()));
        rtec_files::write::whole(&self.path, self.to_sidecar().as_bytes())
    }
}

fn times(columns: &[Column]) -> Vec<f64> {
    match columns.iter().find(|c| c.role == Role::Time) {
        Some(c) => c.data.clone(),
        None => (0..columns[0].data.len()).map(|row| row as f64).collect(),
    }
}

/// What one value must be, given its role and the value before it.
fn check(role: &Role, v: f64, previous: Option<f64>) -> Result<(), (String, &'static str)> {
    if !v.is_finite() {
        return Err((format!("`{v}`"), "a finite number"));
    }
    match role {
        Role::Time if previous.is_some_and(|p| v < p) => {
            Err((format!("time {v} after {}", previous.unwrap_or(v)), "time that never decreases"))
        }
        Role::Direction(_) if ![-1.0, 0.0, 1.0].contains(&v) => {
            Err((format!("`{v}`"), "a direction: +1, -1 (or 0)"))
        }
        _ => Ok(()),
    }
}

pub(crate) fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut s, b| {
        let _ = write!(s, "{b:02x}");
        s
    })
}

fn parse_csv(path: &Path, bytes: &[u8], sidecar: &Sidecar) -> Result<Vec<Column>, InputError> {
    let mut reader = Reader::new(path, bytes)?;
    let header = reader.header("a header line")?;
    // For every field of the CSV the listed column it belongs to.
    let mut slots: Vec<Option<usize>> = vec![None; header.names().count()];
    for listed in &sidecar.columns {
        if header.find(&listed.name).is_none() {
            let missing = header.place(&listed.name).err();
            let expected = missing.map_or_else(String::new, |e| e.expected);
            let expected = format!("{expected} in {}", path.display());
            return Err(listed.place.clone().with(format!("column `{}`", listed.name), &expected));
        }
        header.place(&listed.name)?;
    }
    let mut columns: Vec<Column> = Vec::new();
    for (slot, name) in slots.iter_mut().zip(header.names()) {
        if let Some(l) = sidecar.columns.iter().find(|c| c.name == name) {
            *slot = Some(columns.len());
            let (name, role, unit) = (l.name.clone(), l.role.clone(), l.unit.clone());
            columns.push(Column { name, role, unit, data: Vec::new() });
        }
    }
    while let Some(row) = reader.row()? {
        header.each(row, |place, cell| {
            let Some(column) = slots[place].map(|slot| &mut columns[slot]) else { return Ok(()) };
            let v = cell.finite().map_err(|e| header.named(place, e))?;
            let checked = check(&column.role, v, column.data.last().copied());
            checked.map_err(|(found, expected)| header.named(place, cell.said(found, expected)))?;
            column.data.push(v);
            Ok(())
        })?;
    }
    if columns.first().is_none_or(|c| c.data.is_empty()) {
        return Err(header.no_rows());
    }
    Ok(columns)
}

/// Where in the sidecar something stood, for findings that show only when the CSV is read.
#[derive(Debug, Clone)]
struct Place(InputError);

impl Place {
    fn with(self, found: String, expected: &str) -> InputError {
        InputError { found, expected: expected.to_owned(), ..self.0 }
    }
}

#[derive(Debug)]
struct Listed {
    name: String,
    role: Role,
    unit: String,
    place: Place,
}

#[derive(Debug)]
struct Sidecar {
    file: String,
    file_error: Place,
    kind: Kind,
    count_um: Option<f64>,
    date: Option<String>,
    note: Option<String>,
    columns: Vec<Listed>,
}

impl Sidecar {
    fn read(path: &Path) -> Result<Self, InputError> {
        let text = rtec_files::text::read(path)?;
        let doc = Document::parse(path, &text)?;
        let root = doc.root();
        root.only(&["file", "kind", "count_um", "date", "note", "columns"])?;
        let file = root.required("file", "the CSV's name, as file = \"NAME.csv\"")?;
        let kind = root.required("kind", "the kind of run, as kind = \"positioning\"")?;
        let kinds = Kind::ALL.map(|(name, _)| name).join(", ");
        let parsed_kind = Kind::parse(kind.str("a kind of run")?)
            .ok_or_else(|| kind.error(format!("kind `{}`", kind.text()), format!("one of {kinds}")))?;
        let count_um = root.get("count_um").map(|v| v.positive("µm per count, above zero")).transpose()?;
        // A date may be TOML's own or a string.
        let day = |v: rtec_files::toml::Entry<'_>| match date::parse(&v.text()) {
            Some(_) => Ok(v.text()),
            None => Err(v.error(v.text(), "a day as 2026-05-01")),
        };
        let date = root.get("date").map(day).transpose()?;
        let note = root.get("note").map(|v| v.str("free text").map(str::to_owned)).transpose()?;
        let listed =
            root.required("columns", "a table [columns] of the CSV's columns")?.table("a table [columns]")?;
        let mut columns: Vec<Listed> = Vec::new();
        for entry in listed.entries() {
            let t = entry.table("{ role = \"…\", unit = \"…\" }")?;
            t.only(&["role", "unit"])?;
            let role_value = t.required("role", ROLES)?;
            let role = Role::parse(role_value.str(ROLES)?)
                .ok_or_else(|| role_value.error(format!("role `{}`", role_value.text()), ROLES))?;
            let unit_value = t.required("unit", "the column's unit, as unit = \"mm\"")?;
            let unit = unit_value.str("a unit")?;
            if let Some(expected) = role.unit().filter(|u| *u != unit) {
                let expected = format!("\"{expected}\", the unit of role `{role}`");
                return Err(unit_value.error(format!("unit `{unit}`"), expected));
            }
            if !role.may_repeat() && columns.iter().any(|c| c.role == role) {
                return Err(role_value.error(format!("role `{role}` a second time"), "each role once"));
            }
            let place = Place(entry.key_error("", ""));
            columns.push(Listed { name: entry.key().to_owned(), role, unit: unit.to_owned(), place });
        }
        let file_error = Place(file.error("", ""));
        let file = file.str("the CSV's name")?.to_owned();
        Ok(Self { file, file_error, kind: parsed_kind, count_um, date, note, columns })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDECAR: &str = "file = \"y.csv\"\nkind = \"positioning\"\ncount_um = 1.0\n[columns]\n\
                           t = { role = \"time\", unit = \"s\" }\ny = { role = \"position.y\", unit = \"mm\" }\n\
                           T3 = { role = \"temperature\", unit = \"degC\" }\ne = { role = \"error.y\", unit = \"um\" }\n";

    fn read(sidecar: &str, csv: &str) -> Result<Record, InputError> {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("y.csv"), csv).unwrap();
        std::fs::write(dir.path().join("y.run.toml"), sidecar).unwrap();
        Record::read(&dir.path().join("y.run.toml"))
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
        r.write().unwrap();
        assert_eq!(Record::read(&r.path).unwrap(), r);
        let more = r.csv_with(&[("predicted, e".to_owned(), vec![1.0, 2.0])]).unwrap();
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
            ("", 2, 0, "no rows"),
        ] {
            let e = read(SIDECAR, &format!("t,y,T3,e\n{rows}")).unwrap_err();
            assert_eq!((e.line, e.column), (line, column), "{rows}: {e}");
            assert!(e.found.contains(found) && e.file.ends_with("y.csv"), "{rows}: {e}");
        }
        assert!(read(SIDECAR, "").unwrap_err().found.contains("no header"));
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
            column("e", Role::Error(y), "um", &[0.1, -0.2, 1e300]),
        ];
        let mut r = Record::new(&path, Kind::Drift, columns).unwrap();
        r.count_um = Some(0.5);
        r.date = Some("2026-05-01".into());
        r.note = Some("simulated".into());
        r.write().unwrap();
        assert_eq!(Record::read(&path).unwrap(), r);
        assert_eq!(r.sha256.len(), 64);
    }

    #[test]
    fn without_time_the_row_number_stands_for_seconds() {
        let sidecar = SIDECAR.replace("t = { role = \"time\", unit = \"s\" }\n", "");
        let r = read(&sidecar, "t,y,T3,e\n9,1,20,3\n8,1,20,3\n").unwrap();
        assert_eq!(r.time_s(), [0.0, 1.0]);
    }
}
