//! The properties that a law states about itself.
//! With them no caller depends on the law's name.

use crate::record::{Axis, Role};

/// The axes, and the channel if any, that an effect's name has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum EffectNameAxes {
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

/// An input of an effect, beside its parameters.
/// Axis numbers count the axes of its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RequiredInput {
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

impl RequiredInput {
    /// The role of the column with this quantity, for an effect of these axes.
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

/// The quantity that an effect acts on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum AffectedQuantity {
    /// A position error, µm.
    #[default]
    Error,
    /// A drive force, N.
    Force,
}

/// What an effect belongs to: the machine, the probe or the part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum EffectOwner {
    /// The machine: the effect is in everything that it makes or measures.
    #[default]
    Machine,
    /// The probe: the effect is in what is probed, but not in the part.
    Probe,
    /// The part: its own form.
    Part,
}

/// How probing changes whether an effect acts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ProbingDependence {
    /// The effect acts in every run.
    #[default]
    Alike,
    /// The effect acts only while the machine probes.
    Only,
    /// Another effect takes its place in a probing run, where it is not a candidate.
    Displaced,
}

/// How an effect depends on heat.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ThermalDependence {
    /// It does not.
    #[default]
    None,
    /// Not caused by heat, but a steady value or one step can imitate a drift.
    StandsIn,
    /// It grows with the time since the start instead of a temperature.
    FromStart,
    /// Growth at a point.
    /// Its first coefficient is in µm/K of the temperature difference, lagged or not.
    Growth,
    /// Proportional to a temperature difference and to a length.
    Expansion,
}

/// The mechanism whose size is an effect's first parameter.
/// It is part of an axis' mechanics or of the probe. A simulation builds it in, and the effect on the
/// position follows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MechanicalParameter {
    /// Moved mass, kg.
    Mass,
    /// Viscous friction, N·s/m.
    ViscousFriction,
    /// Dry friction, N.
    CoulombFriction,
    /// Viscous friction that differs by direction, N·s/m.
    AsymmetricFriction,
    /// A constant force, N.
    ConstantForce,
    /// Time from contact to capture, µs.
    ProbeDelay,
}

/// How a fit finds a parameter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ParameterFitMethod {
    /// The law is linear in it.
    #[default]
    Linear,
    /// Amplitude of a periodic law.
    /// A linear fit of two coefficients finds it with the phase.
    Amplitude,
    /// Phase of a periodic law.
    Phase,
    /// Non-linear and smooth: search the range, then descend along the derivative.
    Smooth,
    /// Chosen from the data before the fit, so it has no derivative.
    /// Examples are knots, a whole number of lobes and the time of a step.
    Chosen,
}

/// How a search refines a parameter from the best point of the law's grid.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum ParameterRefinement {
    /// Not at all: it keeps the grid's value.
    #[default]
    Stays,
    /// By steps; the first one is in the parameter's unit, later ones are shorter.
    Step(f64),
    /// By steps of its logarithm.
    Factor(f64),
    /// By steps of the logarithm of a time constant.
    /// It is not refined beyond the longest that the records show. A constant far longer than the run looks
    /// like a straight line and predicts nothing.
    TimeConstant(f64),
    /// From one row's time to another's.
    Moment,
}

/// A parameter of a law.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LawParameter {
    /// Key in `machine.toml`.
    pub name: String,
    /// Its unit.
    pub unit: String,
    /// The range that a sound machine may show, in the parameter's own unit.
    /// A search begins there. A value outside causes a warning.
    pub plausible: [f64; 2],
    /// Its usual size on machines that have it, in the parameter's unit.
    /// It is the scale of an amplitude's prior. Zero if it is unknown: then a part of `plausible` replaces it
    /// ([`LawParameter::prior_size`]).
    pub typical: f64,
    /// Physical bounds: a value outside is an error.
    pub bounds: [f64; 2],
    /// Why the bounds are these; empty if there are none.
    pub source: String,
    /// How a fit finds it.
    pub search: ParameterFitMethod,
    /// How a search refines it.
    pub refine: ParameterRefinement,
    /// One value per knot instead of a single one.
    pub array: bool,
    /// Two effects of one name are distinct if this parameter differs.
    /// Examples are a period, knots and a time.
    pub tells_apart: bool,
    /// Periodic: a full turn further the value means the same.
    pub cyclic: bool,
    /// Value if the file gives none; `None` if the file must give one.
    pub default: Option<f64>,
}

impl LawParameter {
    /// A required parameter without bounds.
    /// `plausible` is its range in a sound machine.
    pub fn new(name: &str, unit: &str, plausible: [f64; 2], search: ParameterFitMethod) -> Self {
        Self {
            name: name.to_owned(),
            unit: unit.to_owned(),
            plausible,
            bounds: [f64::NEG_INFINITY, f64::INFINITY],
            search,
            ..Self::default()
        }
    }

    /// A linear parameter of either sign, plausible up to ±`plausible`.
    pub fn linear(name: &str, unit: &str, plausible: f64) -> Self {
        Self::new(name, unit, [-plausible, plausible], ParameterFitMethod::Linear)
    }

    /// Sets its usual size on machines.
    #[must_use]
    pub fn typically(self, size: f64) -> Self {
        Self { typical: size, ..self }
    }

    /// The scale of an amplitude's prior, in the parameter's own unit.
    pub fn prior_size(&self) -> f64 {
        if self.typical > 0.0 {
            self.typical
        } else {
            self.plausible[1].abs().max(self.plausible[0].abs()) / 30.0
        }
    }

    /// Sets physical bounds and the sentence that gives their source.
    /// The plausible range is cut to the bounds.
    #[must_use]
    pub fn within(self, bounds: [f64; 2], source: &str) -> Self {
        let plausible = self.plausible.map(|x| x.clamp(bounds[0], bounds[1]));
        Self { bounds, plausible, source: source.to_owned(), ..self }
    }

    /// Sets a default value.
    #[must_use]
    pub fn or(self, default: f64) -> Self {
        Self { default: Some(default), ..self }
    }

    /// Makes it an array: one value per knot.
    #[must_use]
    pub fn array(self) -> Self {
        Self { array: true, ..self }
    }

    /// Sets how a search refines it.
    #[must_use]
    pub fn refined(self, refine: ParameterRefinement) -> Self {
        Self { refine, ..self }
    }

    /// Makes it distinguish effects of one name.
    #[must_use]
    pub fn telling_apart(self) -> Self {
        Self { tells_apart: true, ..self }
    }

    /// Makes it periodic.
    #[must_use]
    pub fn cyclic(self) -> Self {
        Self { cyclic: true, ..self }
    }
}

/// A periodic law of the first axis's position.
/// A search tries its period over all frequencies. Its parameters are period, amplitude and phase, in this
/// order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PeriodicLawSettings {
    /// Unit of the period, mm.
    pub unit_mm: f64,
    /// Usual periods of machines, mm; among equally good ones they are preferred.
    pub usual_mm: &'static [f64],
    /// The shortest distinguishable period, in steps of the positions' resolution.
    /// `None` for a period that is long compared with any step.
    pub steps: Option<f64>,
    /// Largest amplitude, in periods.
    pub most_periods: Option<f64>,
}

/// How a search for a missing effect treats a law.
/// Its grid is [`super::Law::grid`].
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LawSearchSettings {
    /// Extra cost compared with a law with physics behind it, nats.
    pub price: f64,
    /// Several of one name may act at once, each with its own period or place.
    pub repeats: bool,
    /// For a wave: how its period is searched. A wave has no grid.
    pub wave: Option<PeriodicLawSettings>,
    /// The law that this one accompanies.
    /// A candidate of this law is bound to that law's effect and, if that is a wave, to its period.
    pub beside: Option<&'static str>,
    /// The law beside which it explains the same as with its axes exchanged.
    /// Of such two, one at most is in an answer: two axes have one squareness, and the work lies turned.
    pub one_beside: Option<&'static str>,
}

/// The description of a law. Its defaults hold for most laws.
#[derive(Debug, Clone, PartialEq, Default)]
#[allow(clippy::struct_excessive_bools)] // facts that do not depend on each other
pub struct LawDescription {
    /// First part of the effect's name.
    pub name: String,
    /// The formula, as the guide's page of effects shows it.
    pub law: String,
    /// Its usual cause in a machine.
    pub cause: String,
    /// The run that excites it and distinguishes it from similar effects.
    pub experiment: String,
    /// What follows the law's name in the effect's name.
    pub naming: EffectNameAxes,
    /// The quantity that it acts on.
    pub quantity: AffectedQuantity,
    /// Its parameters, in the order of [`super::Effect::values`].
    pub parameters: Vec<LawParameter>,
    /// The quantities that it reads.
    pub needs: Vec<RequiredInput>,
    /// What it belongs to.
    pub owner: EffectOwner,
    /// How probing changes whether it acts.
    pub probing: ProbingDependence,
    /// How it depends on heat.
    pub heat: ThermalDependence,
    /// The mechanism that a simulated machine builds in for it.
    pub mechanism: Option<MechanicalParameter>,
    /// The law that acts on a run like another reference temperature of this one.
    /// `None` for a law without a temperature.
    pub companion: Option<&'static str>,
    /// The parameter that is the time constant of a first-order lag of ΔT.
    pub lag: Option<usize>,
    /// Constant in time and place: the zero of its axis.
    pub constant: bool,
    /// It fades with the travel since the axis turned.
    pub after_turn: bool,
    /// Its first parameter is a whole number of counts.
    pub whole_counts: bool,
    /// The axes after the first may be exchanged; they are written alphabetically.
    pub symmetric: bool,
    /// How a search treats it.
    pub searched: LawSearchSettings,
}

impl LawDescription {
    /// Whether it may be the zero of a gauge. A constant force belongs to the machine.
    pub fn may_be_set_up(&self) -> bool {
        self.constant && self.quantity == AffectedQuantity::Error
    }

    /// The index of the first parameter that a fit finds in this way.
    pub fn place(&self, search: ParameterFitMethod) -> Option<usize> {
        self.parameters.iter().position(|p| p.search == search)
    }
}
