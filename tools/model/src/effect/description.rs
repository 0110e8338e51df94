//! What a law states about itself, so that no caller depends on its name.

use crate::record::{Axis, Role};

/// How many axes (and what else) an effect's name carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Naming {
    /// `NAME`: acts on `error.r`, or on the only error response.
    Plain,
    /// `NAME.A`
    #[default]
    One,
    /// `NAME.A.B`, A and B different.
    Two,
    /// `NAME.A.B`, one effect for both orders, written alphabetically.
    /// It acts on A and on B.
    Pair,
    /// `NAME.A.B.C`
    Three,
    /// `NAME.A.CHANNEL`
    Channel,
}

/// What an effect reads, beside its parameters.
///
/// Axis numbers count the axes of its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Need {
    /// Time, s.
    Time,
    /// Position of the n-th axis, mm.
    Position(usize),
    /// Direction of approach of the first axis (or the sign of its velocity).
    Direction,
    /// Velocity of the first axis, mm/s.
    Velocity,
    /// Acceleration of the first axis, mm/s².
    Acceleration,
    /// Load on the first axis, N.
    Load,
    /// A temperature difference, K.
    Delta,
    /// Spindle speed, rpm.
    SpindleSpeed,
    /// Coolant, on or off.
    Coolant,
    /// Angle on the part, rad.
    Angle,
    /// The channel of the effect's name.
    Channel,
}

impl Need {
    /// The role of the column it comes from, for an effect of these axes.
    #[must_use]
    pub fn role(self, axes: &[Axis]) -> Role {
        let axis = |n: usize| axes[n].clone();
        match self {
            Self::Time => Role::Time,
            Self::Position(n) => Role::Position(axis(n)),
            Self::Direction => Role::Direction(axis(0)),
            Self::Velocity => Role::Velocity(axis(0)),
            Self::Acceleration => Role::Acceleration(axis(0)),
            Self::Load => Role::Load(axis(0)),
            Self::Delta => Role::Temperature,
            Self::SpindleSpeed => Role::SpindleSpeed,
            Self::Coolant => Role::Coolant,
            Self::Angle => Role::Angle,
            Self::Channel => Role::Channel,
        }
    }
}

/// What an effect acts on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Quantity {
    /// A position error, µm.
    #[default]
    Error,
    /// A drive force, N.
    Force,
}

/// Whose an effect is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Owner {
    /// The machine's: it is in whatever the machine makes or measures.
    #[default]
    Machine,
    /// The probe's: in what is probed, not in the part.
    Probe,
    /// The part's own form.
    Part,
}

/// What probing has to do with an effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Probing {
    /// Nothing.
    #[default]
    Alike,
    /// It acts while the machine probes, and only then.
    Only,
    /// In a run of probing another effect takes its place: there it is no candidate.
    Displaced,
}

/// How an effect stands to heat.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Heat {
    /// Not at all.
    #[default]
    None,
    /// It is not caused by heat, but steady or in one step it can stand in for a drift.
    StandsIn,
    /// It grows with the time since the start instead of a temperature.
    FromStart,
    /// Growth at a point.
    /// Its first coefficient is µm/K of the temperature difference, lagged or not.
    Growth,
    /// In proportion to a temperature difference and to a length.
    Expansion,
}

/// The mechanism whose size an effect's first parameter gives.
/// It is part of an axis's mechanics or of the probe. A simulation builds it in, and the effect on the position
/// follows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mechanism {
    /// Moved mass, kg.
    Mass,
    /// Viscous friction, N·s/m.
    ViscousFriction,
    /// Dry friction, N.
    CoulombFriction,
    /// Viscous friction that differs by direction, N·s/m.
    AsymmetricFriction,
    /// A force that is always there, N.
    ConstantForce,
    /// Time from contact to capture, µs.
    ProbeDelay,
}

/// How a fit finds a parameter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Search {
    /// The law is linear in it.
    Linear,
    /// Amplitude of a periodic law.
    /// A linear fit of two coefficients finds it with the phase.
    Amplitude,
    /// Phase of a periodic law.
    Phase,
    /// Non-linear and smooth: search the range, then descend along the derivative.
    Smooth,
    /// Chosen from the data before the fit, so it has no derivative.
    /// Examples are knots, a whole number of lobes, the time of a step.
    Chosen,
}

/// How a search goes on from the best point of the law's grid along one parameter.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Refine {
    /// It stays where the grid has it.
    #[default]
    Stays,
    /// First step to either side, in the parameter's unit; later ones are shorter.
    Step(f64),
    /// The same for its logarithm.
    Factor(f64),
    /// The same for the logarithm of a time constant.
    ///
    /// It is not refined beyond the longest that the records show. A constant far longer than the run looks like a
    /// straight line and predicts nothing.
    TimeConstant(f64),
    /// From one moment of the records to another.
    Moment,
}

/// A parameter of a law.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameter {
    /// Key in `machine.toml`.
    pub name: String,
    /// Its unit.
    pub unit: String,
    /// What a sound machine may show: where a search begins, and a warning outside.
    ///
    /// In the parameter's own unit.
    pub plausible: [f64; 2],
    /// Its usual size on machines that have it, in the parameter's unit.
    /// It is the scale of an amplitude's prior. Zero where it is unknown: then a part of `plausible` replaces it
    /// ([`Parameter::prior_size`]).
    pub typical: f64,
    /// Physical bounds: outside them a value is an error.
    pub bounds: [f64; 2],
    /// Where the bounds come from; empty where there are none.
    pub source: String,
    /// How a fit finds it.
    pub search: Search,
    /// How a search refines it.
    pub refine: Refine,
    /// One value per knot instead of a single one.
    pub array: bool,
    /// Two effects of one name with different values of it are two effects.
    /// Examples are a period, knots, a time.
    pub tells_apart: bool,
    /// A place on a circle: a turn further on it is the same.
    pub cyclic: bool,
    /// Value where the file gives none; `None` where it must be given.
    pub default: Option<f64>,
}

impl Parameter {
    /// A parameter without bounds that has to be given.
    /// `plausible` is its range in a sound machine.
    #[must_use]
    pub fn new(name: &str, unit: &str, plausible: [f64; 2], search: Search) -> Self {
        Self {
            name: name.to_owned(),
            unit: unit.to_owned(),
            plausible,
            typical: 0.0,
            bounds: [f64::NEG_INFINITY, f64::INFINITY],
            source: String::new(),
            search,
            refine: Refine::Stays,
            array: false,
            tells_apart: false,
            cyclic: false,
            default: None,
        }
    }

    /// A linear parameter of either sign, plausible up to so much.
    #[must_use]
    pub fn linear(name: &str, unit: &str, plausible: f64) -> Self {
        Self::new(name, unit, [-plausible, plausible], Search::Linear)
    }

    /// With the size that machines usually have.
    #[must_use]
    pub fn typically(self, size: f64) -> Self {
        Self { typical: size, ..self }
    }

    /// The scale of the prior of an amplitude, in the parameter's own unit.
    #[must_use]
    pub fn prior_size(&self) -> f64 {
        if self.typical > 0.0 {
            self.typical
        } else {
            self.plausible[1].abs().max(self.plausible[0].abs()) / 30.0
        }
    }

    /// With physical bounds and the sentence that says where they come from.
    /// What is plausible is within them.
    #[must_use]
    pub fn within(self, bounds: [f64; 2], source: &str) -> Self {
        let plausible = self.plausible.map(|x| x.clamp(bounds[0], bounds[1]));
        Self { bounds, plausible, source: source.to_owned(), ..self }
    }

    /// With a default value.
    #[must_use]
    pub fn or(self, default: f64) -> Self {
        Self { default: Some(default), ..self }
    }

    /// With one value per knot.
    #[must_use]
    pub fn array(self) -> Self {
        Self { array: true, ..self }
    }

    /// Refined in a search.
    #[must_use]
    pub fn refined(self, refine: Refine) -> Self {
        Self { refine, ..self }
    }

    /// Telling effects of one name apart.
    #[must_use]
    pub fn telling_apart(self) -> Self {
        Self { tells_apart: true, ..self }
    }

    /// On a circle.
    #[must_use]
    pub fn cyclic(self) -> Self {
        Self { cyclic: true, ..self }
    }
}

/// A periodic law of the first axis's position, with its period searched over all frequencies.
/// Its parameters are period, amplitude and phase, in this order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wave {
    /// Unit of the period, mm.
    pub unit_mm: f64,
    /// Usual periods of machines, mm: of several equally good ones they are likelier.
    pub usual_mm: &'static [f64],
    /// The shortest period that can be told from a longer one, in steps of the positions' reading.
    /// `None` for a period that is long compared with any step.
    pub steps: Option<f64>,
    /// Largest amplitude, in periods.
    pub most_periods: Option<f64>,
}

/// How a search for a missing effect treats a law.
///
/// Its grid is [`super::Law::grid`].
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Searched {
    /// What it costs beyond a law with physics behind it, nats.
    pub price: f64,
    /// Several of one name may act at once, each with its own period or place.
    pub repeats: bool,
    /// For a wave: what the search of its period has to know. It has no grid.
    pub wave: Option<Wave>,
    /// The law that it accompanies.
    /// It is used with that law's effect, and if that is a wave, with its period.
    pub beside: Option<&'static str>,
}

/// The description of a law. What a law leaves at its default holds for most.
#[derive(Debug, Clone, PartialEq, Default)]
#[allow(clippy::struct_excessive_bools)] // facts that do not depend on each other
pub struct Description {
    /// First part of the effect's name.
    pub name: String,
    /// The formula, as formats.md writes it.
    pub law: String,
    /// What stands behind it in a machine.
    pub cause: String,
    /// The run that excites it and tells it from its neighbours.
    pub experiment: String,
    /// How the effect's name goes on.
    pub naming: Naming,
    /// What it acts on.
    pub quantity: Quantity,
    /// Its parameters, in the order of [`super::Effect::values`].
    pub parameters: Vec<Parameter>,
    /// What it reads.
    pub needs: Vec<Need>,
    /// Whose it is.
    pub owner: Owner,
    /// What probing has to do with it.
    pub probing: Probing,
    /// How it stands to heat.
    pub heat: Heat,
    /// What a simulated machine builds in for it.
    pub mechanism: Option<Mechanism>,
    /// The law that does to a run what another reference temperature of this one does.
    /// `None` without a temperature.
    pub companion: Option<&'static str>,
    /// The time constant of a first-order lag of the temperature difference.
    pub lag: Option<usize>,
    /// It is the same at all times and places: the zero of its axis.
    pub constant: bool,
    /// It dies out with the travel since the axis turned.
    pub after_turn: bool,
    /// Its first parameter is a whole number of counts.
    pub whole_counts: bool,
    /// The axes behind the first may change places: written alphabetically.
    pub symmetric: bool,
    /// How a search treats it.
    pub searched: Searched,
}

impl Description {
    /// Whether it may be the zero of a gauge. A constant force is the machine's own.
    #[must_use]
    pub fn may_be_set_up(&self) -> bool {
        self.constant && self.quantity == Quantity::Error
    }

    /// The place of the first parameter that a fit finds in a certain way.
    #[must_use]
    pub fn place(&self, search: Search) -> Option<usize> {
        self.parameters.iter().position(|p| p.search == search)
    }
}
