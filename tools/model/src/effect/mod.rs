//! The dictionary of effects (formats.md, "Effect names").
//!
//! A [`Law`] is a kind of effect: its formula, parameters, channels, derivative and experiment. An [`Effect`] is a
//! law with its axes, sensor and parameter values. Every law is written once, as *coefficients × basis* at one
//! instant, and serves the batch (a [`Bound`] effect over a record), the live path ([`crate::live`]) and fits:
//!
//! e(row) = Σₖ coefficientₖ · basisₖ(row; non-linear parameters)
//!
//! For most laws the coefficients are the parameters themselves. For a periodic law they are um·cos(phase) and
//! um·sin(phase), so that amplitude and phase are found by one linear fit.

mod form_bump;
mod knots;
mod linear;
mod lost_counts;
mod own;
mod periodic;
mod reversal_spike;
mod thermal;
mod warm_up;

use crate::record::{Axis, Kind, Record, Role};
use std::fmt::{self, Write as _};
use std::sync::{Arc, LazyLock};

/// How many axes (and what else) an effect's name carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Naming {
    /// `NAME`: acts on `error.r`, or on the only error response.
    Plain,
    /// `NAME.A`
    One,
    /// `NAME.A.B`, A and B different.
    Two,
    /// `NAME.A.B`, one effect for both orders, written alphabetically; acts on A and on B.
    Pair,
    /// `NAME.A.B.C`
    Three,
    /// `NAME.A.CHANNEL`
    Channel,
}

/// What an effect reads, beside its parameters. Axis numbers count the axes of its name.
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
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// A position error, µm.
    Error,
    /// A drive force, N.
    Force,
}

/// How a fit finds a parameter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Search {
    /// The law is linear in it.
    Linear,
    /// Amplitude of a periodic law: found with the phase by a linear fit of two coefficients.
    Amplitude,
    /// Phase of a periodic law.
    Phase,
    /// Non-linear and smooth: search the range, then descend along the derivative.
    Smooth,
    /// Chosen from the data before the fit (knots, a whole number of lobes, the moment of a step): no derivative.
    Chosen,
}

/// A parameter of a law.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameter {
    /// Key in `machine.toml`.
    pub name: String,
    /// Its unit.
    pub unit: String,
    /// What a sound machine may show: bounds of a search, and a warning outside. In the parameter's own unit.
    pub plausible: [f64; 2],
    /// What the law is defined for; a value outside is an error.
    pub limits: [f64; 2],
    /// How a fit finds it.
    pub search: Search,
    /// One value per knot instead of a single one.
    pub array: bool,
    /// Value where the file gives none; `None` where it must be given.
    pub default: Option<f64>,
}

impl Parameter {
    pub(crate) fn new(name: &str, unit: &str, plausible: [f64; 2], search: Search) -> Self {
        let limits = [f64::NEG_INFINITY, f64::INFINITY];
        let (name, unit) = (name.to_owned(), unit.to_owned());
        Self { name, unit, plausible, limits, search, array: false, default: None }
    }

    pub(crate) fn linear(name: &str, unit: &str, plausible: f64) -> Self {
        Self::new(name, unit, [-plausible, plausible], Search::Linear)
    }

    pub(crate) fn limits(self, lo: f64, hi: f64) -> Self {
        Self { limits: [lo, hi], ..self }
    }

    pub(crate) fn or(self, default: f64) -> Self {
        Self { default: Some(default), ..self }
    }

    pub(crate) fn array(self) -> Self {
        Self { array: true, ..self }
    }
}

/// The description of a law.
#[derive(Debug, Clone, PartialEq)]
pub struct Card {
    /// First part of the effect's name.
    pub name: String,
    /// The formula, as formats.md writes it.
    pub law: String,
    /// What stands behind it in a machine.
    pub cause: String,
    /// How the effect's name goes on.
    pub naming: Naming,
    /// What it acts on.
    pub quantity: Quantity,
    /// Its parameters, in the order of [`Effect::values`].
    pub parameters: Vec<Parameter>,
    /// What it reads.
    pub needs: Vec<Need>,
    /// The run that excites it and tells it from its neighbours.
    pub experiment: String,
}

/// What an effect reads at one instant; what it does not need is zero.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Input {
    /// Time, s.
    pub t_s: f64,
    /// Positions of the axes of the effect's name, mm.
    pub p_mm: [f64; 3],
    /// Direction of the first axis: −1, 0, +1.
    pub dir: f64,
    /// Velocity of the first axis, mm/s.
    pub v_mm_s: f64,
    /// Acceleration of the first axis, mm/s².
    pub a_mm_s2: f64,
    /// Load on the first axis, N.
    pub load_n: f64,
    /// Temperature difference, K.
    pub delta_k: f64,
    /// Spindle speed, rpm.
    pub rpm: f64,
    /// Coolant, on when above one half.
    pub coolant: f64,
    /// Angle on the part, rad.
    pub angle_rad: f64,
    /// The logged channel.
    pub channel: f64,
}

/// What an effect remembers from instant to instant (a lag, the travel since a reversal). A new record, or a new
/// start of the machine, begins with the default.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct State {
    /// An instant has been seen.
    pub started: bool,
    /// What it is worth is the law's own affair.
    pub x: [f64; 4],
}

/// Where basis values or slopes go: `out[k]` for coefficient or parameter k.
pub type Out<'a> = &'a mut [f64];

/// A kind of effect.
pub trait Law: fmt::Debug + Send + Sync {
    /// Its description.
    fn card(&self) -> &Card;

    /// The basis values at one instant for `component` (0; 1 is the second axis of a pair), after moving the state
    /// on to that instant. `out` has [`Effect::coefficient_count`] places.
    fn basis(&self, effect: &Effect, now: &Input, component: usize, state: &mut State, out: Out<'_>);

    /// The derivative of the effect by every parameter value, as [`Law::basis`] moves the state on. The default
    /// serves laws whose parameters are all linear.
    fn slopes(&self, effect: &Effect, now: &Input, component: usize, state: &mut State, out: Out<'_>) {
        self.basis(effect, now, component, state, out);
    }

    /// The coefficients that the effect's parameters stand for. The default: its linear parameters in order.
    fn coefficients(&self, effect: &Effect, out: Out<'_>) {
        let mut at = 0;
        for (i, p) in self.card().parameters.iter().enumerate() {
            if p.search == Search::Linear {
                let values = effect.get(i);
                out[at..at + values.len()].copy_from_slice(values);
                at += values.len();
            }
        }
    }

    /// Sets the parameters from coefficients; the inverse of [`Law::coefficients`].
    fn set_coefficients(&self, effect: &mut Effect, from: &[f64]) {
        let mut at = 0;
        for (i, p) in self.card().parameters.iter().enumerate() {
            if p.search == Search::Linear {
                let values = effect.get_mut(i);
                let n = values.len();
                values.copy_from_slice(&from[at..at + n]);
                at += n;
            }
        }
    }

    /// Number of coefficients of an effect with `n` values per array parameter.
    fn coefficient_count(&self, n: usize) -> usize {
        self.card().parameters.iter().filter(|p| p.search == Search::Linear).count() * n
    }

    /// Combinations of the coefficients that a fit must hold at zero because other effects explain them (the
    /// constant and the straight line of a position map). One row of weights each.
    fn constraints(&self, _effect: &Effect) -> Vec<Vec<f64>> {
        Vec::new()
    }

    /// What a set of values must fulfil beyond the limits of each; `Err` says what was found and what was expected.
    ///
    /// # Errors
    /// The parameter, what was found and what was expected.
    fn check(&self, _effect: &Effect) -> Result<(), ValueError> {
        Ok(())
    }

    /// Basis values over a whole record, column by column: `out[k·rows + row]`.
    fn basis_rows(&self, effect: &Effect, bound: &Bound<'_>, component: usize, out: Out<'_>) {
        let n = effect.coefficient_count();
        let mut state = State::default();
        let mut row_out = [0.0; 8];
        let mut long = Vec::new();
        let buffer: &mut [f64] = if n <= row_out.len() {
            &mut row_out[..n]
        } else {
            long.resize(n, 0.0);
            &mut long
        };
        for row in 0..bound.rows {
            self.basis(effect, &bound.input(row), component, &mut state, buffer);
            for (k, v) in buffer.iter().enumerate() {
                out[k * bound.rows + row] = *v;
            }
        }
    }
}

/// A parameter's value that will not do.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("`{parameter}`: found {found}, expected {expected}")]
pub struct ValueError {
    /// The parameter (or other key).
    pub parameter: String,
    /// What was found.
    pub found: String,
    /// What was expected.
    pub expected: String,
}

impl ValueError {
    pub(crate) fn new(parameter: &str, found: impl Into<String>, expected: impl Into<String>) -> Self {
        Self { parameter: parameter.to_owned(), found: found.into(), expected: expected.into() }
    }
}

/// What a temperature is compared with.
#[derive(Debug, Clone, PartialEq)]
pub enum Against {
    /// Another sensor: a differential pair.
    Sensor(String),
    /// A fixed temperature, °C.
    Reference(f64),
    /// Nothing given: 20 °C.
    Standard,
}

/// Reference temperature of dimensional metrology where none is given, °C (ISO 1).
pub const STANDARD_DEGC: f64 = 20.0;

/// A temperature difference: sensor minus sensor, or minus a reference.
#[derive(Debug, Clone, PartialEq)]
pub struct Difference {
    /// The sensor's name.
    pub sensor: String,
    /// What it is compared with.
    pub against: Against,
}

impl Difference {
    /// The sensors it reads: one or two.
    pub fn sensors(&self) -> impl Iterator<Item = &str> {
        let minus = match &self.against {
            Against::Sensor(minus) => Some(minus.as_str()),
            _ => None,
        };
        std::iter::once(self.sensor.as_str()).chain(minus)
    }

    /// Sensor minus sensor.
    #[must_use]
    pub fn pair(sensor: &str, minus: &str) -> Self {
        Self { sensor: sensor.to_owned(), against: Against::Sensor(minus.to_owned()) }
    }

    /// Sensor minus the standard 20 °C.
    #[must_use]
    pub fn single(sensor: &str) -> Self {
        Self { sensor: sensor.to_owned(), against: Against::Standard }
    }
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.against {
            Against::Sensor(minus) => write!(f, "{}-{minus}", self.sensor),
            Against::Reference(degc) => write!(f, "{}-{degc}", self.sensor),
            Against::Standard => f.write_str(&self.sensor),
        }
    }
}

/// An effect: a law with its axes, its sensor and its parameters' values.
#[derive(Debug, Clone)]
pub struct Effect {
    law: Arc<dyn Law>,
    axes: Vec<Axis>,
    channel: Option<String>,
    /// The temperature difference, for laws that need one.
    pub delta: Option<Difference>,
    /// The range of ΔT it was fitted on, K: outside, ΔT is held at the bound instead of following a parabola out.
    pub range_k: Option<[f64; 2]>,
    /// For a lag: how far the lagged ΔT used to be from ΔT where it was fitted, RMS, K: what is not known of it at a
    /// start. It fades with the lag.
    pub start_k: Option<f64>,
    /// All values, parameter after parameter, each with as many as the effect has knots (1 for scalars).
    values: Vec<f64>,
}

impl PartialEq for Effect {
    fn eq(&self, other: &Self) -> bool {
        self.name() == other.name()
            && self.delta == other.delta
            && self.range_k == other.range_k
            && self.start_k == other.start_k
            && self.values == other.values
    }
}

impl Effect {
    /// The law.
    #[must_use]
    pub fn law(&self) -> &dyn Law {
        &*self.law
    }

    /// The law's description.
    #[must_use]
    pub fn card(&self) -> &Card {
        self.law.card()
    }

    /// The axes of its name.
    #[must_use]
    pub fn axes(&self) -> &[Axis] {
        &self.axes
    }

    /// The channel of its name.
    #[must_use]
    pub fn channel(&self) -> Option<&str> {
        self.channel.as_deref()
    }

    /// Its full name: `scale.x`, `angular.x.y.z`, `channel.z.FOO`.
    #[must_use]
    pub fn name(&self) -> String {
        let mut name = self.card().name.clone();
        for part in self.axes.iter().map(Axis::as_str).chain(self.channel()) {
            name.push('.');
            name.push_str(part);
        }
        name
    }

    /// Number of values per parameter: 1, or the number of knots.
    #[must_use]
    pub fn width(&self) -> usize {
        self.values.len() / self.card().parameters.len().max(1)
    }

    /// All values, parameter after parameter.
    #[must_use]
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// Values of the n-th parameter.
    #[must_use]
    pub fn get(&self, parameter: usize) -> &[f64] {
        let n = self.width();
        &self.values[parameter * n..(parameter + 1) * n]
    }

    fn get_mut(&mut self, parameter: usize) -> &mut [f64] {
        let n = self.width();
        &mut self.values[parameter * n..(parameter + 1) * n]
    }

    /// Value of the n-th parameter, a scalar.
    #[must_use]
    pub fn scalar(&self, parameter: usize) -> f64 {
        self.get(parameter)[0]
    }

    /// Values of a parameter by its name.
    #[must_use]
    pub fn value(&self, name: &str) -> Option<&[f64]> {
        let i = self.card().parameters.iter().position(|p| p.name == name)?;
        Some(self.get(i))
    }

    /// Sets all values at once: parameter after parameter, arrays of equal length.
    ///
    /// # Errors
    /// A value outside the law's limits, arrays of unequal length.
    pub fn set_values(&mut self, values: &[f64]) -> Result<(), ValueError> {
        let card = self.law.card();
        let count = card.parameters.len();
        let arrays = card.parameters.iter().any(|p| p.array);
        if count == 0
            || values.is_empty()
            || !values.len().is_multiple_of(count)
            || (!arrays && values.len() != count)
        {
            return Err(ValueError::new(
                &card.name,
                format!("{} values", values.len()),
                format!("{count} parameters"),
            ));
        }
        let n = values.len() / count;
        for (p, of) in card.parameters.iter().zip(values.chunks(n)) {
            for v in of {
                if !v.is_finite() || *v < p.limits[0] || *v > p.limits[1] {
                    return Err(ValueError::new(&p.name, format!("{v}"), limits_text(p)));
                }
            }
        }
        let before = std::mem::replace(&mut self.values, values.to_vec());
        let checked = self.law.check(self);
        if checked.is_err() {
            self.values = before;
        }
        checked
    }

    /// Sets one parameter by its name; arrays keep their length.
    ///
    /// # Errors
    /// Unknown parameter, wrong number of values, a value outside the limits.
    pub fn set(&mut self, name: &str, values: &[f64]) -> Result<(), ValueError> {
        let position = self.card().parameters.iter().position(|p| p.name == name);
        let Some(i) = position.filter(|_| values.len() == self.width()) else {
            return Err(ValueError::new(
                name,
                format!("{} values", values.len()),
                "a parameter and its length",
            ));
        };
        let mut all = self.values.clone();
        let n = values.len();
        all[i * n..(i + 1) * n].copy_from_slice(values);
        self.set_values(&all)
    }

    /// The linear coefficients that its parameters stand for.
    #[must_use]
    pub fn coefficients(&self) -> Vec<f64> {
        let mut out = vec![0.0; self.coefficient_count()];
        self.law.coefficients(self, &mut out);
        out
    }

    /// Sets the parameters from linear coefficients.
    ///
    /// # Panics
    /// When there are not [`Effect::coefficient_count`] of them.
    pub fn set_coefficients(&mut self, from: &[f64]) {
        assert_eq!(from.len(), self.coefficient_count(), "one value per coefficient");
        let law = Arc::clone(&self.law);
        law.set_coefficients(self, from);
    }

    /// Number of linear coefficients.
    #[must_use]
    pub fn coefficient_count(&self) -> usize {
        self.law.coefficient_count(self.width())
    }

    /// Combinations of the coefficients that a fit must hold at zero.
    #[must_use]
    pub fn constraints(&self) -> Vec<Vec<f64>> {
        self.law.constraints(self)
    }

    /// The temperature difference, held inside the range it was fitted on.
    pub(crate) fn bounded(&self, delta_k: f64) -> f64 {
        self.range_k.map_or(delta_k, |[lo, hi]| delta_k.clamp(lo, hi))
    }

    /// The component with which it acts on a response of this role; `None` where it does not. `sole_error` tells
    /// that the response is the record's only error.
    fn component(&self, role: &Role, has_angle: bool, sole_error: bool) -> Option<usize> {
        let card = self.card();
        let ((Role::Error(axis), Quantity::Error) | (Role::Force(axis), Quantity::Force)) =
            (role, card.quantity)
        else {
            return None;
        };
        match card.naming {
            Naming::Plain => (has_angle && (axis.as_str() == "r" || sole_error)).then_some(0),
            Naming::Pair => self.axes.iter().position(|a| a == axis),
            _ => (self.axes.first() == Some(axis)).then_some(0),
        }
    }

    /// What tells effects of one name apart in one model: sensors, periods, knots, times, the place of a bump.
    #[must_use]
    pub fn identity(&self) -> String {
        let mut id = self.name();
        if self.card().name == "angular" && self.axes[1] > self.axes[2] {
            id = format!("angular.{}.{}.{}", self.axes[0], self.axes[2], self.axes[1]);
        }
        if let Some(d) = &self.delta {
            let _ = write!(id, " {}", d.sensor);
            if let Against::Sensor(minus) = &d.against {
                let _ = write!(id, "-{minus}");
            }
        }
        for (i, p) in self.card().parameters.iter().enumerate() {
            let apart = ["period_mm", "period_um", "lobes", "knots_mm", "at_s", "tau_s", "centre_rad"];
            if apart.contains(&p.name.as_str()) {
                let _ = write!(id, " {}={:?}", p.name, self.get(i));
            }
        }
        id
    }

    /// Finds the columns that this effect reads.
    ///
    /// # Errors
    /// A sensor or channel that the record does not have. A quantity that it does not log (velocity, load, …) is
    /// taken as zero and listed in [`Bound::taken_as_zero`].
    pub fn bind<'r>(&self, record: &'r Record) -> Result<Bound<'r>, Missing> {
        let named = |data: Option<&'r [f64]>, role: &Role, name: &str| {
            data.ok_or_else(|| Missing {
                effect: self.name(),
                what: format!("{role}.{name}"),
                has: record.names(role).collect::<Vec<_>>().join(", "),
            })
        };
        let mut bound = Bound {
            rows: record.rows(),
            t: record.time_s(),
            p: [None; 3],
            dir: None,
            dir_from_velocity: false,
            v: None,
            a: None,
            load: None,
            sensor: None,
            minus: None,
            reference: STANDARD_DEGC,
            rpm: None,
            coolant: None,
            angle: None,
            channel: None,
            taken_as_zero: Vec::new(),
        };
        for &need in &self.card().needs {
            let role = need.role(&self.axes);
            let data = record.data(&role);
            let place = match need {
                Need::Time => continue,
                Need::Delta => {
                    let Some(d) = &self.delta else { continue };
                    bound.sensor = Some(named(record.temperature(&d.sensor), &role, &d.sensor)?);
                    match &d.against {
                        Against::Sensor(m) => bound.minus = Some(named(record.temperature(m), &role, m)?),
                        Against::Reference(degc) => bound.reference = *degc,
                        Against::Standard => {}
                    }
                    continue;
                }
                Need::Channel => {
                    let name = self.channel().unwrap_or_default();
                    bound.channel = Some(named(record.channel(name), &role, name)?);
                    continue;
                }
                Need::Direction if data.is_none() => {
                    bound.dir = record.data(&Role::Velocity(self.axes[0].clone()));
                    bound.dir_from_velocity = true;
                    if bound.dir.is_none() {
                        bound.taken_as_zero.push(role);
                    }
                    continue;
                }
                Need::Position(n) => &mut bound.p[n],
                Need::Direction => &mut bound.dir,
                Need::Velocity => &mut bound.v,
                Need::Acceleration => &mut bound.a,
                Need::Load => &mut bound.load,
                Need::SpindleSpeed => &mut bound.rpm,
                Need::Coolant => &mut bound.coolant,
                Need::Angle => &mut bound.angle,
            };
            *place = data;
            if data.is_none() {
                bound.taken_as_zero.push(role);
            }
        }
        Ok(bound)
    }

    /// The responses of a record on which it acts: column's role and component.
    #[must_use]
    pub fn acts_on(&self, record: &Record) -> Vec<(Role, usize)> {
        if self.card().name == "probe_latency" && record.kind != Kind::Probing {
            return Vec::new();
        }
        let roles: Vec<&Role> = record.responses().map(|c| &c.role).collect();
        let errors = roles.iter().filter(|r| matches!(r, Role::Error(_))).count();
        let radial = roles.iter().any(|r| r.to_string() == "error.r");
        let has_angle = record.column(&Role::Angle).is_some();
        let component = |role: &Role| self.component(role, has_angle, errors == 1 && !radial);
        roles.into_iter().filter_map(|r| Some((r.clone(), component(r)?))).collect()
    }

    /// Adds the effect to `out` at every row of a record, for one response; nothing where it does not act on it.
    ///
    /// # Errors
    /// As [`Effect::bind`].
    ///
    /// # Panics
    /// When `out` does not have one place per row.
    pub fn add(&self, record: &Record, response: &Role, out: Out<'_>) -> Result<(), Missing> {
        if let Some((_, component)) = self.acts_on(record).into_iter().find(|(role, _)| role == response) {
            self.bind(record)?.add(self, component, out);
        }
        Ok(())
    }
}

fn limits_text(p: &Parameter) -> String {
    match p.limits {
        [lo, hi] if lo.is_finite() && hi.is_finite() => format!("a value from {lo} to {hi} ({})", p.unit),
        [lo, _] if lo.is_finite() => format!("a value above {lo} ({})", p.unit),
        _ => format!("a finite number ({})", p.unit),
    }
}

/// A sensor or channel that an effect names and a record does not have.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("no {what}, which effect {effect} reads (the record has: {has})")]
pub struct Missing {
    /// The effect.
    pub effect: String,
    /// `temperature.T8`, `channel.z9`.
    pub what: String,
    /// What the record has of that role.
    pub has: String,
}

/// The columns of a record that an effect reads. Good for every value of the effect's parameters, so that a search
/// over non-linear parameters binds once.
#[derive(Debug, Clone)]
pub struct Bound<'r> {
    rows: usize,
    t: &'r [f64],
    p: [Option<&'r [f64]>; 3],
    dir: Option<&'r [f64]>,
    dir_from_velocity: bool,
    v: Option<&'r [f64]>,
    a: Option<&'r [f64]>,
    load: Option<&'r [f64]>,
    sensor: Option<&'r [f64]>,
    minus: Option<&'r [f64]>,
    reference: f64,
    rpm: Option<&'r [f64]>,
    coolant: Option<&'r [f64]>,
    angle: Option<&'r [f64]>,
    channel: Option<&'r [f64]>,
    taken_as_zero: Vec<Role>,
}

/// Sign with sign(0) = 0.
#[must_use]
pub fn sign(v: f64) -> f64 {
    if v > 0.0 {
        1.0
    } else if v < 0.0 {
        -1.0
    } else {
        0.0
    }
}

impl Bound<'_> {
    /// Number of rows.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Quantities the effect reads and the record does not log: taken as zero (at rest, dry, unloaded).
    #[must_use]
    pub fn taken_as_zero(&self) -> &[Role] {
        &self.taken_as_zero
    }

    /// What the effect reads at a row.
    #[must_use]
    pub fn input(&self, row: usize) -> Input {
        let at = |column: Option<&[f64]>| column.map_or(0.0, |c| c[row]);
        let dir = at(self.dir);
        Input {
            t_s: self.t[row],
            p_mm: [at(self.p[0]), at(self.p[1]), at(self.p[2])],
            dir: if self.dir_from_velocity { sign(dir) } else { dir },
            v_mm_s: at(self.v),
            a_mm_s2: at(self.a),
            load_n: at(self.load),
            delta_k: self.delta_k(row),
            rpm: at(self.rpm),
            coolant: at(self.coolant),
            angle_rad: at(self.angle),
            channel: at(self.channel),
        }
    }

    fn delta_k(&self, row: usize) -> f64 {
        self.sensor.map_or(0.0, |s| s[row] - self.minus.map_or(self.reference, |m| m[row]))
    }

    /// Basis values of `effect` over the record, column by column: `out[k·rows + row]` for coefficient k.
    ///
    /// # Panics
    /// When `out` does not have rows × coefficients places.
    pub fn basis(&self, effect: &Effect, component: usize, out: Out<'_>) {
        assert_eq!(out.len(), self.rows * effect.coefficient_count(), "one column per coefficient");
        effect.law.basis_rows(effect, self, component, out);
    }

    /// Adds the effect to `out` at every row.
    ///
    /// # Panics
    /// When `out` does not have one place per row.
    pub fn add(&self, effect: &Effect, component: usize, out: Out<'_>) {
        assert_eq!(out.len(), self.rows, "one place per row");
        let coefficients = effect.coefficients();
        let mut columns = vec![0.0; self.rows * coefficients.len()];
        self.basis(effect, component, &mut columns);
        for (c, column) in coefficients.iter().zip(columns.chunks(self.rows.max(1))) {
            for (o, b) in out.iter_mut().zip(column) {
                *o += c * b;
            }
        }
    }

    /// Derivative of the effect by every parameter value, column by column: `out[i·rows + row]` for value i of
    /// [`Effect::values`]. Columns of parameters that are chosen, not searched, are zero.
    ///
    /// # Panics
    /// When `out` does not have rows × values places.
    pub fn slopes(&self, effect: &Effect, component: usize, out: Out<'_>) {
        let n = effect.values.len();
        assert_eq!(out.len(), self.rows * n, "one column per parameter value");
        let mut state = State::default();
        let mut buffer = vec![0.0; n];
        for row in 0..self.rows {
            buffer.fill(0.0);
            effect.law.slopes(effect, &self.input(row), component, &mut state, &mut buffer);
            for (i, v) in buffer.iter().enumerate() {
                out[i * self.rows + row] = *v;
            }
        }
    }
}

/// All laws by name: the built-in ones of formats.md, and a project's own.
#[derive(Debug, Clone)]
pub struct Dictionary {
    laws: Vec<Arc<dyn Law>>,
}

static BUILT_IN: LazyLock<Vec<Arc<dyn Law>>> = LazyLock::new(|| {
    let mut laws: Vec<Arc<dyn Law>> = Vec::new();
    linear::laws(&mut laws);
    knots::laws(&mut laws);
    periodic::laws(&mut laws);
    thermal::laws(&mut laws);
    laws.push(Arc::new(reversal_spike::ReversalSpike::new()));
    laws.push(Arc::new(warm_up::WarmUp::new()));
    laws.push(Arc::new(lost_counts::LostCounts::new()));
    laws.push(Arc::new(form_bump::FormBump::new()));
    laws
});

impl Default for Dictionary {
    fn default() -> Self {
        Self { laws: BUILT_IN.clone() }
    }
}

impl Dictionary {
    /// The laws, built-in ones first.
    pub fn laws(&self) -> impl Iterator<Item = &dyn Law> {
        self.laws.iter().map(|l| &**l)
    }

    /// Adds a project's own law.
    ///
    /// # Errors
    /// A law of that name is there already.
    pub fn insert(&mut self, law: Arc<dyn Law>) -> Result<(), ValueError> {
        let name = &law.card().name;
        if self.laws.iter().any(|l| l.card().name == *name) {
            return Err(ValueError::new(name, "a law of that name", "a name the dictionary does not have"));
        }
        self.laws.push(law);
        Ok(())
    }

    /// The effect of a full name (`scale.x`), with every parameter at its default, or at zero (linear ones) or in
    /// the middle of its plausible range.
    ///
    /// # Errors
    /// Unknown law, or a name that does not go on as the law's does.
    pub fn effect(&self, name: &str) -> Result<Effect, ValueError> {
        let bad = |expected: String| ValueError::new("name", format!("`{name}`"), expected);
        let (head, rest) = name.split_once('.').map_or((name, None), |(h, r)| (h, Some(r)));
        let Some(law) = self.laws.iter().find(|l| l.card().name == head) else {
            let known = self.laws.iter().map(|l| l.card().name.as_str()).collect::<Vec<_>>().join(", ");
            return Err(bad(format!("an effect of the dictionary: {known}")));
        };
        let naming = law.card().naming;
        let form = |rest: &str| bad(format!("a name like `{head}{rest}`"));
        let axis = |text: &str, rest: &str| Axis::new(text).ok_or_else(|| form(rest));
        let parts: Vec<&str> = match (naming, rest) {
            (Naming::Channel, Some(r)) => r.splitn(2, '.').collect(),
            (_, Some(r)) => r.split('.').collect(),
            (_, None) => Vec::new(),
        };
        let (mut axes, mut channel) = (Vec::new(), None);
        match (naming, parts.as_slice()) {
            (Naming::Plain, []) => {}
            (Naming::Plain, _) => return Err(form("")),
            (Naming::One, [a]) => axes.push(axis(a, ".x")?),
            (Naming::One, _) => return Err(form(".x")),
            (Naming::Two | Naming::Pair, [a, b]) if a != b => {
                axes.extend([axis(a, ".x.y")?, axis(b, ".x.y")?]);
                if naming == Naming::Pair {
                    axes.sort();
                }
            }
            (Naming::Two | Naming::Pair, _) => return Err(form(".x.y")),
            (Naming::Three, [a, b, c]) => {
                axes.extend([axis(a, ".x.y.z")?, axis(b, ".x.y.z")?, axis(c, ".x.y.z")?]);
            }
            (Naming::Three, _) => return Err(form(".x.y.z")),
            (Naming::Channel, [a, c]) if !c.is_empty() => {
                axes.push(axis(a, ".x.NAME")?);
                channel = Some((*c).to_owned());
            }
            (Naming::Channel, _) => return Err(form(".x.NAME")),
        }
        let values = law.card().parameters.iter().map(start_value).collect();
        Ok(Effect { law: Arc::clone(law), axes, channel, delta: None, range_k: None, start_k: None, values })
    }

    /// Every effect that could act in these records: each law on each response, with each sensor, sensor pair and
    /// channel that the records have in common, in a fixed order. Parameters as [`Dictionary::effect`] leaves them;
    /// knots are for the caller to place.
    #[must_use]
    pub fn candidates(&self, records: &[&Record]) -> Vec<Effect> {
        let Some(first) = records.first() else { return Vec::new() };
        let everywhere = |role: &Role| records.iter().all(|r| r.column(role).is_some());
        let common = |role: Role| -> Vec<&str> {
            let in_all = |n: &&str| records.iter().all(|r| r.names(&role).any(|m| m == *n));
            first.names(&role).filter(in_all).collect()
        };
        let sensors = common(Role::Temperature);
        let channels = common(Role::Channel);
        let positions: Vec<&Axis> =
            first.axes(Role::Position).filter(|a| everywhere(&Role::Position((*a).clone()))).collect();
        let responses: Vec<&Role> = first.responses().map(|c| &c.role).filter(|r| everywhere(r)).collect();
        let probing = records.iter().all(|r| r.kind == Kind::Probing);
        let mut found: Vec<Effect> = Vec::new();
        for law in &self.laws {
            let card = law.card();
            let mut names: Vec<String> = Vec::new();
            for axis in responses.iter().filter_map(|r| r.axis()) {
                let others = positions.iter().filter(|p| **p != axis);
                match card.naming {
                    Naming::Plain => names.push(card.name.clone()),
                    Naming::One => names.push(format!("{}.{axis}", card.name)),
                    Naming::Two | Naming::Pair => {
                        names.extend(others.map(|b| format!("{}.{axis}.{b}", card.name)));
                    }
                    Naming::Three => {
                        for (i, b) in positions.iter().enumerate() {
                            names.extend(
                                positions[i + 1..].iter().map(|c| format!("{}.{axis}.{b}.{c}", card.name)),
                            );
                        }
                    }
                    Naming::Channel => {
                        names.extend(channels.iter().map(|c| format!("{}.{axis}.{c}", card.name)));
                    }
                }
            }
            for name in names {
                let Ok(effect) = self.effect(&name) else { continue };
                let acts = records.iter().all(|r| !effect.acts_on(r).is_empty());
                let both =
                    card.naming != Naming::Pair || records.iter().all(|r| effect.acts_on(r).len() == 2);
                let readable = card.needs.iter().all(|n| match n {
                    Need::Time | Need::Channel => true,
                    Need::Delta => !sensors.is_empty(),
                    Need::Direction => {
                        let axis = effect.axes[0].clone();
                        everywhere(&Role::Direction(axis.clone())) || everywhere(&Role::Velocity(axis))
                    }
                    _ => everywhere(&n.role(&effect.axes)),
                });
                let offered = !(card.name == "following_error" && probing);
                if !(acts && both && readable && offered) || found.iter().any(|f| f.name() == effect.name()) {
                    continue;
                }
                if card.needs.contains(&Need::Delta) {
                    for (i, s) in sensors.iter().enumerate() {
                        found.push(Effect { delta: Some(Difference::single(s)), ..effect.clone() });
                        for m in &sensors[i + 1..] {
                            found.push(Effect { delta: Some(Difference::pair(s, m)), ..effect.clone() });
                        }
                    }
                } else {
                    found.push(effect);
                }
            }
        }
        found
    }
}

/// Where a parameter starts: its default, zero, or the (geometric, where it can be) middle of its plausible range.
fn start_value(p: &Parameter) -> f64 {
    let [lo, hi] = p.plausible;
    match p.search {
        _ if p.default.is_some() => p.default.unwrap_or_default(),
        Search::Linear | Search::Amplitude | Search::Phase => 0.0,
        _ if lo > 0.0 => (lo * hi).sqrt(),
        _ => f64::midpoint(lo, hi),
    }
}

#[cfg(test)]
mod tests;
