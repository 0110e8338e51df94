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

impl Role {
    /// The role of this name (`time`, `position.y`, …).
    pub fn parse(text: &str) -> Option<Self> {
        if let Some(both) = text.strip_prefix("angle_error.") {
            let (moving, about) = both.split_once('.')?;
            return Some(Self::AngleError(Axis::new(moving)?, Axis::new(about)?));
        }
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

    /// The unit of this role; `None` if any unit is allowed (a channel).
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
            Self::AngleError(..) => "urad",
            Self::Channel => return None,
        })
    }

    /// Whether a column of this role may have this unit.
    /// Tilts are in µrad or arcseconds, all others in their own unit.
    pub fn takes(&self, unit: &str) -> bool {
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
            Self::AngleError(moving, about) => return write!(f, "angle_error.{moving}.{about}"),
        };
        match self.axis() {
            Some(axis) => write!(f, "{head}.{axis}"),
            None => f.write_str(head),
        }
    }
}

/// The kind of a run.
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
    if v > 0.0 {
        1.0
    } else if v < 0.0 {
        -1.0
    } else {
        0.0
    }
}
