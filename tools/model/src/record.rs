//! A run in memory: columns by role, row by row.
//!
//! In a file it is a run record (guide, "Run records"), which `rtec-measure` reads and writes.

use crate::ballbar_circle::{Circle, ColumnsFromAngle};
use rtec_files::InputError;
use rtec_files::text_file::{open_regular, unreadable};
use sha2::{Digest, Sha256};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

pub use crate::role::{Axis, Column, LINEAR, Role, RunKind};
pub use crate::statistics::{mean, median, span};

/// One run: its columns in the CSV's order, rows in order of acquisition.
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    /// The sidecar, as the user named it.
    pub path: PathBuf,
    /// The CSV's name, from the sidecar.
    pub file: String,
    /// SHA-256 of the CSV, in hexadecimal; empty for a record made in memory.
    pub sha256: String,
    /// The kind of the run.
    pub kind: RunKind,
    /// The length of one count, µm.
    pub count_um: Option<f64>,
    /// The day of the run, as ISO 8601.
    pub date: Option<String>,
    /// Free text about the run.
    pub note: Option<String>,
    /// The CSV's format if it is unusual: decimal commas, semicolons, UTF-16.
    pub written: Option<String>,
    /// The name of the gauges' zero, which records of the same name share.
    /// Without a name the record has its own zero.
    pub zero: Option<String>,
    /// Where the axis of a positioning run turned back; `None` if not stated.
    pub turns: Option<ReversalPoint>,
    /// The listed columns, in the CSV's order.
    pub columns: Vec<Column>,
    time_s: Vec<f64>,
    /// For a piece of a record: the number of rows before it.
    first_row: usize,
    /// For a record of selected rows: the place of each in the file.
    /// Empty if it has all rows.
    selected: Vec<usize>,
    /// For a circle measured by a bar: the circle and the columns from its angle.
    circle: Option<(Circle, ColumnsFromAngle)>,
}

/// Where the axis of a positioning run turned back.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ReversalPoint {
    /// So far beyond the end targets, mm; `None` if the distance is not stated.
    Overtravel(Option<f64>),
    /// At the end targets themselves.
    AtTarget,
}

/// Centres are one within this share of the radius.
const SAME_PLACE: f64 = 0.01;

/// Smallest travel of an axis that drives a circle, as a share of the radius.
const MOVES: f64 = 0.1;

impl Record {
    /// How far beyond its end targets a positioning run turned, mm.
    /// Zero if it turned at them, or if nothing is stated.
    pub fn overtravel_mm(&self) -> f64 {
        match self.turns {
            Some(ReversalPoint::Overtravel(Some(over_mm))) => over_mm,
            _ => 0.0,
        }
    }

    /// Whether the travel since a turn is known for the rows after it.
    pub fn tells_turns(&self) -> bool {
        self.kind != RunKind::Positioning
            || matches!(self.turns, Some(ReversalPoint::Overtravel(Some(_)) | ReversalPoint::AtTarget))
    }

    /// A record made in memory (by the simulator or the recorder).
    ///
    /// # Errors
    /// The same findings as for a file: columns of unequal length, a role given twice, a value that is not
    /// finite, decreasing time, no response.
    pub fn new(path: &Path, kind: RunKind, columns: Vec<Column>) -> Result<Self, InputError> {
        let record = Self::log(path, kind, columns)?;
        if !record.columns.iter().any(|c| c.role.is_measured()) {
            let expected = "a column of role error.AXIS or force.AXIS";
            return Err(InputError::whole(path, "no response", expected));
        }
        Ok(record)
    }

    /// As [`Record::new`], but a response is not required.
    /// A recorded shift or a probing run has none.
    ///
    /// # Errors
    /// As [`Record::new`], except for a missing response.
    pub fn log(path: &Path, kind: RunKind, columns: Vec<Column>) -> Result<Self, InputError> {
        let whole = |found: String, expected: &str| InputError::whole(path, found, expected);
        for (i, c) in columns.iter().enumerate() {
            if columns[..i].iter().any(|d| d.name == c.name) {
                return Err(whole(format!("two columns named `{}`", c.name), "each name once"));
            }
            if !c.role.may_repeat() && columns[..i].iter().any(|d| d.role == c.role) {
                return Err(whole(format!("role `{}` twice", c.role), "each role once"));
            }
            if c.role.is_rotary(&c.unit) {
                return Err(whole(format!("role `{}` in `{}`, of a rotary axis", c.role, c.unit), LINEAR));
            }
            if !c.role.accepts_unit(&c.unit) {
                let own = c.role.unit().map_or("a unit".to_owned(), |u| format!("`{u}`, the role's unit"));
                return Err(whole(format!("unit `{}` of role `{}`", c.unit, c.role), &own));
            }
            if c.data.len() != columns[0].data.len() {
                let expected = "as many in every column";
                return Err(whole(format!("{} values in `{}`", c.data.len(), c.name), expected));
            }
            for (row, &v) in c.data.iter().enumerate() {
                if let Err((found, expected)) = check(&c.role, v, row.checked_sub(1).map(|p| c.data[p])) {
                    return Err(InputError::at(path, row + 2, i + 1, found, expected));
                }
            }
        }
        if columns[0].data.is_empty() {
            return Err(whole("no rows".into(), "at least one"));
        }
        Ok(Self::of_checked(path, kind, columns))
    }

    /// A record of columns that are already checked.
    /// They have equal lengths and finite values, and time never decreases.
    ///
    /// # Panics
    /// Without a column.
    pub fn of_checked(path: &Path, kind: RunKind, columns: Vec<Column>) -> Self {
        let stem = path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
        Self {
            path: path.to_owned(),
            file: format!("{}.csv", stem.strip_suffix(".run.toml").unwrap_or(&stem)),
            sha256: String::new(),
            kind,
            count_um: None,
            date: None,
            note: None,
            written: None,
            zero: None,
            turns: None,
            time_s: times(kind, &columns),
            first_row: 0,
            selected: Vec::new(),
            columns,
            circle: None,
        }
    }

    /// Marks the record as a piece of a longer one that begins at `row` there.
    /// Without a time column the row number is the time, so it is shifted by `row`.
    #[must_use]
    pub fn from_row(mut self, row: usize) -> Self {
        self.first_row = row;
        if self.column(&Role::Time).is_none() {
            self.time_s.iter_mut().for_each(|t| *t += row as f64);
        }
        self
    }

    /// For a piece of a longer record: the number of rows before it.
    pub fn first_row(&self) -> usize {
        self.first_row
    }

    /// The number of a row in its file, from 1, counting rows that were left out.
    pub fn row_number(&self, row: usize) -> usize {
        self.first_row + self.selected.get(row).copied().unwrap_or(row) + 1
    }

    /// The circle that a bar measured, if the sidecar states it.
    pub fn circle(&self) -> Option<&Circle> {
        self.circle.as_ref().map(|(circle, _)| circle)
    }

    /// Whether the positions on the machine's axes are known.
    /// They are unknown only for a circle whose centre is not stated and whose positions are not logged.
    pub fn knows_places(&self) -> bool {
        let logged = |a: &Axis| self.columns.iter().any(|c| c.role == Role::Position(a.clone()));
        self.circle().is_none_or(|c| c.centre_mm.is_some() || c.plane.iter().all(logged))
    }

    /// States the circle of a ballbar run.
    /// Positions, directions and (with a time) velocities of its two axes then follow from the angle, unless
    /// they are logged.
    ///
    /// # Errors
    /// What was found and what was expected: a run of another kind, no radial error, no angle, one axis
    /// twice, a radius that is not above zero.
    pub fn with_circle(mut self, circle: Circle) -> Result<Self, (String, &'static str)> {
        if self.kind != RunKind::Ballbar {
            return Err((format!("a run of kind {}", self.kind.name()), "kind = \"ballbar\""));
        }
        let [a, b] = &circle.plane;
        if a == b || [a, b].iter().any(|n| n.as_str() == "r") {
            return Err((format!("the plane of {a} and {b}"), "two axes, as plane = [\"x\", \"y\"]"));
        }
        if !(circle.radius_mm.is_finite() && circle.radius_mm > 0.0) {
            return Err((format!("a radius of {}", circle.radius_mm), "a length above zero, mm"));
        }
        if !self.responses().any(|c| matches!(&c.role, Role::Error(a) if a.as_str() == "r")) {
            return Err(("no radial error".into(), "a column of role error.r"));
        }
        let Some(angle) = self.data(&Role::Angle) else {
            return Err(("no angle".into(), "a column of role angle"));
        };
        self.logs_plane(&circle)?;
        self.is_about(&circle, angle)?;
        let time_s = self.data(&Role::Time);
        let derived = circle.derive(angle, time_s, &self.columns);
        self.circle = Some((circle, derived));
        Ok(self)
    }

    /// Checks that the logged axes that move are those of the circle's plane.
    /// If an axis of the plane is not logged, its positions follow from the angle, unless another axis moves
    /// in its place.
    fn logs_plane(&self, circle: &Circle) -> Result<(), (String, &'static str)> {
        let logged: Vec<&Axis> = self.axes(Role::Position).collect();
        let Some(missing) = circle.plane.iter().find(|a| !logged.contains(a)) else { return Ok(()) };
        let moves = |a: &Axis| {
            let p = self.data(&Role::Position(a.clone())).unwrap_or_default();
            let [lo, hi] = span(p);
            hi - lo > MOVES * circle.radius_mm
        };
        let instead: Vec<&str> =
            logged.iter().filter(|a| !circle.plane.contains(a) && moves(a)).map(|a| a.as_str()).collect();
        if instead.is_empty() {
            return Ok(());
        }
        let [a, b] = &circle.plane;
        let found = format!(
            "plane = [\"{a}\", \"{b}\"], and no position of {missing}, while {} moves",
            instead.join(" and ")
        );
        Err((found, "the two axes that drive the circle, those whose positions the record logs"))
    }

    /// The logged positions run about the centre that is stated.
    /// A row's place less its bar gives a centre of its own. The stated one is among these, or near them.
    fn is_about(&self, circle: &Circle, angle: &[f64]) -> Result<(), (String, &'static str)> {
        let shares = [f64::cos as fn(f64) -> f64, f64::sin];
        for ((axis, share), stated) in circle.plane.iter().zip(shares).zip(circle.centre_mm.iter().flatten())
        {
            // Positions that follow from a circle stated before are not logged.
            let logged = self.columns.iter().find(|c| c.role == Role::Position(axis.clone()));
            let Some(p) = logged.map(|c| &c.data) else { continue };
            let [lo, hi] = span(p.iter().zip(angle).map(|(p, a)| p - circle.radius_mm * share(*a)));
            if (lo - stated).max(stated - hi) > SAME_PLACE * circle.radius_mm {
                let found = format!(
                    "centre_mm with {stated} mm on {axis}, while the positions of {axis} run about {:.3} mm",
                    f64::midpoint(lo, hi)
                );
                return Err((found, "the centre that the logged positions have, or no centre_mm"));
            }
        }
        Ok(())
    }

    /// Share of an axis' error in the radial error at every row: cos θ or sin θ.
    /// `None` for an axis that is not in the plane of the record's circle.
    pub(crate) fn share(&self, axis: &Axis) -> Option<&[f64]> {
        let (circle, derived) = self.circle.as_ref()?;
        circle.plane.iter().zip(&derived.share).find(|(a, _)| *a == axis).map(|(_, share)| share.as_slice())
    }

    /// The listed columns, then those computed from a circle's angle.
    fn known(&self) -> impl Iterator<Item = &Column> {
        self.columns.iter().chain(self.circle.iter().flat_map(|(_, derived)| &derived.columns))
    }

    /// Number of rows, equal in every column.
    pub fn rows(&self) -> usize {
        self.time_s.len()
    }

    /// Time of every row, s: the time column, or the row number without one.
    /// For a drift with a coarse clock, the rows that share a time are spread evenly over the clock's step.
    pub fn time_s(&self) -> &[f64] {
        &self.time_s
    }

    /// The axis label and values of a plot over time.
    /// They are minutes, or row numbers from 1 if the record has no times.
    pub fn over_time(&self) -> (&'static str, Vec<f64>) {
        match self.column(&Role::Time) {
            Some(t) => ("time (min)", t.data.iter().map(|t| t / 60.0).collect()),
            None => ("row", (1..=self.rows()).map(|n| n as f64).collect()),
        }
    }

    /// The column of a role that occurs only once.
    /// It is a listed column, or one computed from a circle's angle.
    pub fn column(&self, role: &Role) -> Option<&Column> {
        self.known().find(|c| c.role == *role)
    }

    /// The values of the column of a role that occurs only once, in the role's unit.
    pub fn data(&self, role: &Role) -> Option<&[f64]> {
        self.column(role).map(|c| c.data.as_slice())
    }

    /// The positions of an axis, mm.
    pub fn position(&self, axis: &Axis) -> Option<&[f64]> {
        self.data(&Role::Position(axis.clone()))
    }

    /// The logged direction of an axis, as signs.
    pub fn direction(&self, axis: &Axis) -> Option<&[f64]> {
        self.data(&Role::Direction(axis.clone()))
    }

    /// The direction of an axis, else its velocity, whose sign says the same.
    pub fn direction_or_velocity(&self, axis: &Axis) -> Option<&[f64]> {
        self.direction(axis).or_else(|| self.data(&Role::Velocity(axis.clone())))
    }

    /// The temperatures, in the CSV's order.
    pub fn temperatures(&self) -> impl Iterator<Item = &Column> {
        self.columns.iter().filter(|c| c.role == Role::Temperature)
    }

    /// A temperature by its sensor's name.
    pub fn temperature(&self, sensor: &str) -> Option<&[f64]> {
        self.named(&Role::Temperature, sensor)
    }

    /// A logged channel by its name.
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

    /// What was measured: the responses, and tilts.
    pub fn measured(&self) -> impl Iterator<Item = &Column> {
        self.columns.iter().filter(|c| c.role.is_measured())
    }

    /// The names of all columns of a role (sensors, channels), in the CSV's order.
    pub fn names(&self, role: &Role) -> impl Iterator<Item = &str> {
        self.columns.iter().filter(move |c| c.role == *role).map(|c| c.name.as_str())
    }

    /// The axes that have a column of the role that `role` makes, in the CSV's order.
    pub fn axes(&self, role: fn(Axis) -> Role) -> impl Iterator<Item = &Axis> {
        self.known().filter_map(move |c| {
            let axis = c.role.axis()?;
            (role(axis.clone()) == c.role).then_some(axis)
        })
    }

    /// A record of selected rows, in the given order, for cross-validation.
    /// Each row keeps its time.
    ///
    /// # Panics
    /// When a row is out of range.
    #[must_use]
    pub fn select(&self, rows: &[usize]) -> Self {
        let pick = |data: &[f64]| rows.iter().map(|&r| data[r]).collect::<Vec<_>>();
        let of = |columns: &[Column]| {
            columns.iter().map(|c| Column { data: pick(&c.data), ..c.clone() }).collect::<Vec<_>>()
        };
        // Columns from the angle depend on neighbouring rows, so each row keeps its values.
        let circle = self.circle.as_ref().map(|(circle, d)| {
            let share = [pick(&d.share[0]), pick(&d.share[1])];
            (circle.clone(), ColumnsFromAngle { share, columns: of(&d.columns) })
        });
        let place = |row: &usize| self.selected.get(*row).copied().unwrap_or(*row);
        let selected = rows.iter().map(place).collect();
        Self { columns: of(&self.columns), time_s: pick(&self.time_s), circle, selected, ..self.clone() }
    }
}

fn times(kind: RunKind, columns: &[Column]) -> Vec<f64> {
    match columns.iter().find(|c| c.role == Role::Time) {
        Some(c) if kind == RunKind::Drift => spread(&c.data).unwrap_or_else(|| c.data.clone()),
        Some(c) => c.data.clone(),
        None => (0..columns[0].data.len()).map(|row| row as f64).collect(),
    }
}

/// Harmonics of a gauge's saw: the error of the sum is a hundredth of a step.
const ROUNDING_HARMONICS: i32 = 12;

/// Expected rounding error of a reading under Gaussian noise (Widrow 1956).
/// The step is `q`; the value that is read is `off` from a multiple of it.
pub fn rounding_error(q: f64, off: f64, variance: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    let harmonic = |k: i32| {
        let (sign, k) = (if k % 2 == 0 { 1.0 } else { -1.0 }, f64::from(k));
        sign * q / (PI * k) * (TAU * k * off / q).sin() * (-0.5 * variance * (TAU * k / q).powi(2)).exp()
    };
    (1..=ROUNDING_HARMONICS).map(harmonic).sum()
}

/// The step of a coarse clock, s, if most rows share their time with another.
pub fn shared_step(time_s: &[f64]) -> Option<f64> {
    let steps = || time_s.windows(2).map(|w| w[1] - w[0]).filter(|step| *step > 0.0);
    let is_shared = 2 * steps().count() < time_s.len();
    steps().min_by(f64::total_cmp).filter(|_| is_shared)
}

/// Spreads the times of rows that share a coarse clock's step evenly over it.
/// A logger reads evenly, so the rows of a step fill it. Without this, a lag of 400 s read by a clock of
/// minutes would be taken for growth (`tests/field/lag-by-minutes.csv`).
/// The first and the last step may be cut off, so they get the spacing of the fullest one. `None` if the
/// clock is fine enough.
fn spread(time_s: &[f64]) -> Option<Vec<f64>> {
    let step = shared_step(time_s)?;
    let groups: Vec<&[f64]> = time_s.chunk_by(|a, b| a >= b).collect();
    let fullest = groups.iter().map(|rows| rows.len()).max()?;
    let mut spread = Vec::with_capacity(time_s.len());
    for (n, rows) in groups.iter().enumerate() {
        let at_end = n == 0 || n + 1 == groups.len();
        let apart = step / if at_end { fullest } else { rows.len() } as f64;
        let first = if n == 0 { rows[0] + step - apart * rows.len() as f64 } else { rows[0] };
        spread.extend((0..rows.len()).map(|row| first + apart * row as f64));
    }
    Some(spread)
}

/// Checks one value, given its role and the previous value.
///
/// # Errors
/// What was found and what was expected.
pub fn check(role: &Role, v: f64, previous: Option<f64>) -> Result<(), (String, &'static str)> {
    if !v.is_finite() {
        return Err((format!("`{v}`"), "a finite number"));
    }
    let ([low, high], expected) = role.possible();
    if v < low || v > high {
        return Err((format!("`{v:e}`"), expected));
    }
    match role {
        Role::Time if previous.is_some_and(|p| v < p) => {
            Err((format!("time {v} after {}", previous.unwrap_or(v)), "time that never decreases"))
        }
        Role::Direction(_) if ![-1.0, 0.0, 1.0].contains(&v) => Err((format!("`{v}`"), expected)),
        _ => Ok(()),
    }
}

/// The allowed range of this role, if [`check`] checks only the range.
pub fn range_alone(role: &Role) -> Option<[f64; 2]> {
    (!matches!(role, Role::Time | Role::Direction(_))).then(|| role.possible().0)
}

/// The SHA-256 of a file of any length, in the form of [`Record::sha256`].
///
/// # Errors
/// It cannot be read, or is no regular file.
pub fn sha256_of(file: &Path) -> Result<String, InputError> {
    let mut hash = Sha256::new();
    std::io::copy(&mut open_regular(file)?, &mut hash).map_err(|e| unreadable(file, &e))?;
    Ok(hex(&hash.finalize()))
}

/// Bytes as lower-case hexadecimal digits.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut s, b| {
        let _ = write!(s, "{b:02x}");
        s
    })
}
