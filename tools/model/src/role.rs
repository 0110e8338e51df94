//! The role and axis of a column, and the kind of a run.

use std::fmt;

/// The text that a message shows as expected if a rotary axis is named.
pub const LINEAR: &str = "a linear axis: rotary axes (A, B and C of ISO 841) are not measured, fitted, simulated or corrected by any \
                          verb, since positions are in mm and errors in µm";

/// The name of an axis (`x`, `y`, `z`; `r` for the radial error of a probing run).
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Axis(String);

impl Axis {
    /// An axis name: a letter, then letters, digits or `_`.
    pub fn new(name: &str) -> Option<Self> {
        let mut chars = name.chars();
        let ok = chars.next().is_some_and(|c| c.is_ascii_alphabetic())
            && chars.all(|c| c.is_ascii_alphanumeric() || c == '_');
        ok.then(|| Self(name.to_owned()))
    }

    /// The name as written.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// Whether the name is a rotary axis': A, B and C turn about X, Y and Z (ISO 841).
    pub fn is_rotary(&self) -> bool {
        matches!(self.as_str(), "a" | "b" | "c" | "A" | "B" | "C")
    }
}

impl fmt::Display for Axis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// The role of a column.
/// Errors and forces are responses; all other roles are inputs that these may depend on.
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
    /// Tilt about the second axis while the first one moves, µrad or arcseconds.
    /// For axes x and b it is EBX (ISO 230-1). It is measured, but is no response of a model, because no
    /// effect acts on it.
    AngleError(Axis, Axis),
}

/// All that holds for every column of a role.
struct RoleUnitAndLimit {
    /// Its name in a sidecar, before the axis.
    name: &'static str,
    unit: Option<&'static str>,
    /// The largest possible value of either sign, in the unit.
    most: f64,
    /// What a message expects of a value.
    expected: &'static str,
}

/// The roles that belong to no axis.
const PLAIN: [Role; 7] = [
    Role::Time,
    Role::Cycle,
    Role::Temperature,
    Role::SpindleSpeed,
    Role::Coolant,
    Role::Angle,
    Role::Channel,
];

/// The roles that belong to one axis.
const OF_AXIS: [fn(Axis) -> Role; 7] = [
    Role::Position,
    Role::Direction,
    Role::Velocity,
    Role::Acceleration,
    Role::Load,
    Role::Error,
    Role::Force,
];

impl Role {
    /// The role of this name (`time`, `position.y`, …).
    pub fn parse(text: &str) -> Option<Self> {
        if let Some(both) = text.strip_prefix("angle_error.") {
            let (moving, about) = both.split_once('.')?;
            return Some(Self::AngleError(Axis::new(moving)?, Axis::new(about)?));
        }
        let Some((name, axis)) = text.split_once('.') else {
            return PLAIN.into_iter().find(|role| role.facts().name == text);
        };
        let axis = Axis::new(axis)?;
        OF_AXIS.iter().map(|of| of(axis.clone())).find(|role| role.facts().name == name)
    }

    /// All that holds for every column of this role.
    fn facts(&self) -> RoleUnitAndLimit {
        let facts = |name, unit, most, expected| RoleUnitAndLimit { name, unit, most, expected };
        match self {
            // Three hundred thousand years: an epoch in ms passes and is questioned, one in ns does not.
            Self::Time => facts("time", Some("s"), 1e13, "a time within ±1e13 s"),
            // A kilometre: the largest gantries have some fifty metres.
            Self::Position(_) => {
                facts("position", Some("mm"), 1e6, "a position in mm, within ±1e6 (is it in µm?)")
            }
            Self::Direction(_) => facts("direction", Some("1"), 1e3, "a direction: +1, -1 (or 0)"),
            Self::Velocity(_) => facts("velocity", Some("mm/s"), 1e6, "a velocity within ±1e6 mm/s"),
            Self::Acceleration(_) => {
                facts("acceleration", Some("mm/s2"), 1e9, "an acceleration within ±1e9 mm/s²")
            }
            Self::Cycle => facts("cycle", Some("1"), 1e9, "a repeat's number within ±1e9"),
            // An unconnected input may give its raw reading, a number of 16 bit.
            Self::Temperature => facts("temperature", Some("degC"), 1e5, "a temperature within ±1e5 degC"),
            Self::SpindleSpeed => facts("spindle_speed", Some("rpm"), 1e7, "a spindle speed within ±1e7 rpm"),
            Self::Coolant => facts("coolant", Some("1"), 1e3, "coolant: 0 or 1"),
            Self::Load(_) => facts("load", Some("N"), 1e9, "a force within ±1e9 N"),
            Self::Angle => facts("angle", Some("rad"), 1e7, "an angle within ±1e7 rad"),
            // Any unit: counters of 64 bit and pressures in Pa included.
            Self::Channel => facts("channel", None, 1e30, "a value within ±1e30"),
            // A position in µm in place of an error is read, and questioned.
            Self::Error(_) => facts("error", Some("um"), 1e9, "an error within ±1e9 µm"),
            Self::Force(_) => facts("force", Some("N"), 1e9, "a force within ±1e9 N"),
            Self::AngleError(..) => facts("angle_error", Some("urad"), 1e9, "a tilt within ±1e9"),
        }
    }

    /// The unit of this role; `None` if any unit is allowed (a channel).
    pub fn unit(&self) -> Option<&'static str> {
        self.facts().unit
    }

    /// The range of a column of this role, in its unit, and the same in words.
    /// It is wider than any machine by orders of magnitude, so that sums and squares stay finite. Possible but
    /// unlikely values are the concern of `rtec_measure::plausible`.
    pub(crate) fn possible(&self) -> ([f64; 2], &'static str) {
        let RoleUnitAndLimit { most, expected, .. } = self.facts();
        ([-most, most], expected)
    }

    /// Whether a column of this role may have this unit.
    /// Tilts are in µrad or arcseconds, all others in their own unit.
    pub fn accepts_unit(&self, unit: &str) -> bool {
        self.unit().is_none_or(|own| own == unit)
            || (matches!(self, Self::AngleError(..)) && unit == "arcsec")
    }

    /// Whether it belongs to a rotary axis, by the axis' name or by the unit.
    pub fn is_rotary(&self, unit: &str) -> bool {
        match self {
            Self::AngleError(moving, _) => moving.is_rotary(),
            other => other
                .axis()
                .is_some_and(|a| a.is_rotary() || ["deg", "degree", "°", "rad", "arcsec"].contains(&unit)),
        }
    }

    /// Whether a model predicts it: an error or a force.
    pub fn is_response(&self) -> bool {
        matches!(self, Self::Error(_) | Self::Force(_))
    }

    /// Whether a run measures it: a response or a tilt.
    pub fn is_measured(&self) -> bool {
        self.is_response() || matches!(self, Self::AngleError(..))
    }

    /// The axis it belongs to.
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

    /// Whether several columns may have it: only temperatures and channels.
    pub fn may_repeat(&self) -> bool {
        matches!(self, Self::Temperature | Self::Channel)
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = self.facts().name;
        if let Self::AngleError(moving, about) = self {
            return write!(f, "{name}.{moving}.{about}");
        }
        match self.axis() {
            Some(axis) => write!(f, "{name}.{axis}"),
            None => f.write_str(name),
        }
    }
}

/// The kind of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[allow(missing_docs)]
pub enum RunKind {
    Positioning,
    Drift,
    Ballbar,
    Plate,
    Dynamics,
    Probing,
    FeedSweep,
    Part,
}

impl RunKind {
    /// All kinds with their names.
    pub const ALL: [(&'static str, Self); 8] = [
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
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL.iter().find(|(name, _)| *name == text).map(|&(_, kind)| kind)
    }

    /// The kind's name in a sidecar.
    pub fn name(self) -> &'static str {
        Self::ALL[self as usize].0
    }
}

/// One column that the sidecar lists.
#[derive(Debug, Clone, PartialEq)]
pub struct Column {
    /// Name in the CSV's header; a temperature's or channel's name.
    pub name: String,
    /// The role of the column.
    pub role: Role,
    /// The column's unit, as the sidecar writes it.
    pub unit: String,
    /// One value per row.
    pub data: Vec<f64>,
}

impl Column {
    /// A column with values in the role's own unit.
    /// For a role without one (a channel) it is 1.
    pub fn new(name: &str, role: Role, data: Vec<f64>) -> Self {
        Self { name: name.to_owned(), unit: role.unit().unwrap_or("1").to_owned(), role, data }
    }

    /// Its name in a verdict: its role, or `temperature.T3`, `channel.z9`.
    pub fn label(&self) -> String {
        if self.role.may_repeat() { format!("{}.{}", self.role, self.name) } else { self.role.to_string() }
    }
}

/// Sign with sign(0) = 0.
pub fn sign(v: f64) -> f64 {
    f64::from(i8::from(v > 0.0) - i8::from(v < 0.0))
}
