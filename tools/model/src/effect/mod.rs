//! The dictionary of effects.
//!
//! A [`Law`] is a kind of effect: its formula, parameters, channels, derivative and experiment. An [`Effect`]
//! is a law with its axes, sensor and parameter values. Every law is written once, as *coefficients × basis*
//! at one instant. It serves the batch ([`EffectInputColumns`] over a record), the live path ([`crate::live_evaluation`])
//! and fits:
//!
//! e(row) = Σₖ coefficientₖ · basisₖ(row; non-linear parameters)
//!
//! For most laws the coefficients are the parameters themselves. For a periodic law they are um·cos(phase)
//! and um·sin(phase), so that amplitude and phase are found by one linear fit.
//!
//! A built-in effect is one file of [`laws`] and one line in its list. Other code never asks for the name of
//! a law. It asks the law's [`LawDescription`] how the law is searched, how it depends on heat, what it belongs
//! to and what its bounds are.
//! A program's own law implements [`Law`] and joins a [`Dictionary`]. A project's own law comes from a file
//! (`own`).
//!
//! | module | what |
//! |---|---|
//! | `law_description` | the properties that a law states about itself |
//! | [`laws`] | the built-in effects |
//! | `linear_laws`, `wave`, `knots`, `lag` | parts that several laws share |
//! | `search_grid` | the points at which a search begins |
//! | `record_evaluation` | an effect over a record |
//! | `dictionary`, `own` | all laws by name; laws from a file |

mod dictionary;
mod lag;
mod law_description;
pub mod laws;
mod laws_from_file;
mod linear_laws;
mod periodic_laws;
mod piecewise_linear;
mod record_evaluation;
mod search_grid;
mod temperature_difference;

pub use crate::role::sign;
pub use dictionary::Dictionary;
pub use lag::{Lag, ParallelLags};
pub use law_description::{
    AffectedQuantity, EffectNameAxes, EffectOwner, LawDescription, LawParameter, LawSearchSettings,
    MechanicalParameter, ParameterFitMethod, ParameterRefinement, PeriodicLawSettings, ProbingDependence,
    RequiredInput, ThermalDependence,
};
use record_evaluation::RADIAL;
pub(crate) use record_evaluation::States;
pub use record_evaluation::{EffectInputColumns, MissingInput};
pub use search_grid::{RecordExtent, SearchGridPoint};
pub use temperature_difference::{ReferenceTemperature, STANDARD_DEGC, TemperatureDifference};
pub(crate) use temperature_difference::{ResolvedTemperatureDifference, read_difference};

use crate::record::{Axis, Record, Role, RunKind};
use linear_laws::LinearLaw;
use rtec_files::text_file::short;
use std::fmt::{self, Write as _};
use std::sync::Arc;

/// The inputs of an effect at one instant. Inputs that it does not need are zero.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Input {
    /// Time, s.
    pub t_s: f64,
    /// Positions of the axes of the effect's name, mm.
    pub p_mm: [f64; 3],
    /// Direction of the first axis: −1, 0, +1.
    pub dir: f64,
    /// How far beyond the last row of a direction the first axis turns back, mm.
    /// Zero if it turns at that row, or if every row of the motion is recorded.
    pub past_mm: f64,
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

/// The memory of an effect from instant to instant.
/// It holds a lag or the travel since a reversal. A new record, or a new start of the machine, begins with
/// the default.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct EffectMemory {
    /// Whether an instant has been seen.
    pub started: bool,
    /// Values whose meaning the law defines.
    pub x: [f64; 4],
}

/// Output for basis values or slopes: `out[k]` for coefficient or parameter k.
pub type Out<'a> = &'a mut [f64];

/// Computes the basis of each coefficient at one instant, for one component.
/// The second argument is the component: 1 is the second axis of a pair.
pub type Basis = fn(&Input, usize, Out<'_>);

/// A kind of effect.
pub trait Law: fmt::Debug + Send + Sync {
    /// The law's description.
    fn describe(&self) -> &LawDescription;

    /// The basis values at one instant for `component`.
    /// `component` is 0, or 1 for the second axis of a pair. The state moves on to that instant. `out` has
    /// [`Effect::coefficient_count`] places.
    fn basis(&self, effect: &Effect, now: &Input, component: usize, state: &mut EffectMemory, out: Out<'_>);

    /// [`Law::basis`] as a plain function, if it depends only on the inputs.
    /// It then needs no state and no value of the effect. A caller that asks at every instant may keep the
    /// function and call only that.
    fn stateless(&self) -> Option<Basis> {
        None
    }

    /// The derivative of the effect by every parameter value.
    /// It moves the state on, as [`Law::basis`] does. The default serves laws whose parameters are all
    /// linear.
    fn slopes(&self, effect: &Effect, now: &Input, component: usize, state: &mut EffectMemory, out: Out<'_>) {
        self.basis(effect, now, component, state, out);
    }

    /// The coefficients that belong to the effect's parameters.
    /// By default these are its linear parameters in order.
    fn coefficients(&self, effect: &Effect, out: Out<'_>) {
        let mut at = 0;
        for (i, p) in self.describe().parameters.iter().enumerate() {
            if p.search == ParameterFitMethod::Linear {
                let values = effect.get(i);
                out[at..at + values.len()].copy_from_slice(values);
                at += values.len();
            }
        }
    }

    /// Sets the parameters from coefficients; the inverse of [`Law::coefficients`].
    fn set_coefficients(&self, effect: &mut Effect, from: &[f64]) {
        let mut at = 0;
        for (i, p) in self.describe().parameters.iter().enumerate() {
            if p.search == ParameterFitMethod::Linear {
                let values = effect.get_mut(i);
                let n = values.len();
                values.copy_from_slice(&from[at..at + n]);
                at += n;
            }
        }
    }

    /// Number of coefficients of an effect with `n` values per array parameter.
    fn coefficient_count(&self, n: usize) -> usize {
        self.describe().parameters.iter().filter(|p| p.search == ParameterFitMethod::Linear).count() * n
    }

    /// The range of an axis that the effect's values were stated on, mm.
    /// The first value is the axis' index in the name. Beyond the range the end values apply.
    fn stretch_mm(&self, _effect: &Effect) -> Option<(usize, [f64; 2])> {
        None
    }

    /// Combinations of the coefficients that a fit must hold at zero.
    /// Other effects explain them, such as the constant and the straight line of a position map. One row of
    /// weights each.
    fn constraints(&self, _effect: &Effect) -> Vec<Vec<f64>> {
        Vec::new()
    }

    /// Checks a set of values beyond the bounds of each.
    ///
    /// # Errors
    /// The parameter, what was found and what was expected.
    fn check(&self, _effect: &Effect) -> Result<(), ParameterValueError> {
        Ok(())
    }

    /// Grid points of the law's non-linear parameters, each with its price.
    /// They suit records of this extent. The default serves laws that have no such parameter.
    fn grid(&self, effect: &Effect, _records: &dyn RecordExtent) -> Vec<SearchGridPoint> {
        SearchGridPoint::only(effect)
    }

    /// Basis values over the rows of a record, column by column.
    /// `out[k·rows + row]` belongs to coefficient k. The state moves on to the last row.
    fn basis_rows(
        &self,
        effect: &Effect,
        bound: &EffectInputColumns<'_>,
        component: usize,
        state: &mut EffectMemory,
        out: Out<'_>,
    ) {
        let n = effect.coefficient_count();
        let mut row_out = [0.0; 8];
        let mut long = Vec::new();
        let buffer: &mut [f64] = if n <= row_out.len() {
            &mut row_out[..n]
        } else {
            long.resize(n, 0.0);
            &mut long
        };
        for row in 0..bound.rows() {
            self.basis(effect, &bound.input(row), component, state, buffer);
            for (k, v) in buffer.iter().enumerate() {
                out[k * bound.rows() + row] = *v;
            }
        }
    }
}

/// A parameter value that is not allowed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("`{parameter}`: found {found}, expected {expected}")]
pub struct ParameterValueError {
    /// The parameter (or other key).
    pub parameter: String,
    /// What was found.
    pub found: String,
    /// What was expected.
    pub expected: String,
}

impl ParameterValueError {
    pub(crate) fn new(parameter: &str, found: impl Into<String>, expected: impl Into<String>) -> Self {
        Self { parameter: parameter.to_owned(), found: found.into(), expected: expected.into() }
    }
}

/// An effect: a law with its axes, its sensor and its parameters' values.
#[derive(Debug, Clone)]
pub struct Effect {
    law: Arc<dyn Law>,
    axes: Vec<Axis>,
    channel: Option<String>,
    /// The temperature difference, for laws that need one.
    pub delta: Option<TemperatureDifference>,
    /// The range of ΔT that the effect was fitted on, K.
    /// Outside, ΔT is held at the bound, because a fitted parabola must not be extrapolated.
    pub range_k: Option<[f64; 2]>,
    /// For a lag: RMS of lagged ΔT minus ΔT in the fitted records, K.
    /// It is the uncertainty of the lag's state at a start, and fades with the lag.
    pub start_k: Option<f64>,
    /// All values, parameter after parameter.
    /// Each parameter has as many as the effect has knots (1 for scalars).
    values: Vec<f64>,
    /// Values per parameter: 1, or the number of knots.
    /// It is stored because a law asks for it at every instant.
    width: usize,
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
    pub fn law(&self) -> &dyn Law {
        &*self.law
    }

    /// The law's description.
    pub fn description(&self) -> &LawDescription {
        self.law.describe()
    }

    /// The axes of its name.
    pub fn axes(&self) -> &[Axis] {
        &self.axes
    }

    /// The channel of its name.
    pub fn channel(&self) -> Option<&str> {
        self.channel.as_deref()
    }

    /// Its full name: `scale.x`, `angular.x.y.z`, `channel.z.FOO`.
    pub fn name(&self) -> String {
        let mut name = self.description().name.clone();
        for part in self.axes.iter().map(Axis::as_str).chain(self.channel()) {
            name.push('.');
            name.push_str(part);
        }
        name
    }

    /// Number of values per parameter: 1, or the number of knots.
    pub fn width(&self) -> usize {
        self.width
    }

    /// All values, parameter after parameter.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// Values of the n-th parameter.
    pub fn get(&self, parameter: usize) -> &[f64] {
        let n = self.width();
        &self.values[parameter * n..(parameter + 1) * n]
    }

    fn get_mut(&mut self, parameter: usize) -> &mut [f64] {
        let n = self.width();
        &mut self.values[parameter * n..(parameter + 1) * n]
    }

    /// Value of the n-th parameter, a scalar.
    pub fn scalar(&self, parameter: usize) -> f64 {
        self.values[parameter * self.width]
    }

    /// Values of a parameter by its name.
    pub fn value(&self, name: &str) -> Option<&[f64]> {
        let i = self.description().parameters.iter().position(|p| p.name == name)?;
        Some(self.get(i))
    }

    /// Sets all values at once: parameter after parameter, arrays of equal length.
    ///
    /// # Errors
    /// A value outside its bounds, arrays of unequal length.
    pub fn set_values(&mut self, values: &[f64]) -> Result<(), ParameterValueError> {
        let law = self.law.describe();
        let count = law.parameters.len();
        let arrays = law.parameters.iter().any(|p| p.array);
        if count == 0
            || values.is_empty()
            || !values.len().is_multiple_of(count)
            || (!arrays && values.len() != count)
        {
            let expected = format!("{count} parameters");
            return Err(ParameterValueError::new(&law.name, format!("{} values", values.len()), expected));
        }
        let n = values.len() / count;
        for (p, of) in law.parameters.iter().zip(values.chunks(n)) {
            for v in of {
                if !v.is_finite() || *v < p.bounds[0] || *v > p.bounds[1] {
                    return Err(ParameterValueError::new(&p.name, short(*v), bounds_text(p)));
                }
            }
        }
        let before =
            (std::mem::replace(&mut self.values, values.to_vec()), std::mem::replace(&mut self.width, n));
        let checked = self.law.check(self);
        if checked.is_err() {
            (self.values, self.width) = before;
        }
        checked
    }

    /// Whether its values are inside the law's bounds.
    /// Linear coefficients are set without that check.
    pub fn is_physical(&self) -> bool {
        self.with_values(&self.values).is_some()
    }

    /// Sets one parameter by its name; arrays keep their length.
    ///
    /// # Errors
    /// Unknown parameter, wrong number of values, a value outside its bounds.
    pub fn set(&mut self, name: &str, values: &[f64]) -> Result<(), ParameterValueError> {
        let position = self.description().parameters.iter().position(|p| p.name == name);
        let Some(i) = position.filter(|_| values.len() == self.width()) else {
            let expected = "a parameter and its length";
            return Err(ParameterValueError::new(name, format!("{} values", values.len()), expected));
        };
        let mut all = self.values.clone();
        let n = values.len();
        all[i * n..(i + 1) * n].copy_from_slice(values);
        self.set_values(&all)
    }

    /// The linear coefficients that belong to its parameters.
    pub fn coefficients(&self) -> Vec<f64> {
        let mut out = vec![0.0; self.coefficient_count()];
        self.law.coefficients(self, &mut out);
        out
    }

    /// Sets the parameters from linear coefficients.
    ///
    /// # Panics
    /// When `from` does not have [`Effect::coefficient_count`] values.
    pub fn set_coefficients(&mut self, from: &[f64]) {
        assert_eq!(from.len(), self.coefficient_count(), "one value per coefficient");
        let law = Arc::clone(&self.law);
        law.set_coefficients(self, from);
    }

    /// Number of linear coefficients.
    pub fn coefficient_count(&self) -> usize {
        self.law.coefficient_count(self.width())
    }

    /// The range of an axis that its values were stated on, mm.
    /// The first value is the axis' index in the name. Beyond the range the end values apply.
    pub fn stretch_mm(&self) -> Option<(usize, [f64; 2])> {
        self.law.stretch_mm(self)
    }

    /// Combinations of the coefficients that a fit must hold at zero.
    pub fn constraints(&self) -> Vec<Vec<f64>> {
        self.law.constraints(self)
    }

    /// The temperature difference, held inside the range it was fitted on.
    pub(crate) fn bounded(&self, delta_k: f64) -> f64 {
        self.range_k.map_or(delta_k, |[lo, hi]| delta_k.clamp(lo, hi))
    }

    /// The component with which it acts on a response of this role, or `None`.
    /// `sole_error` says that the response is the record's only error. `plane` holds the axes that a radial
    /// error is composed of.
    fn component(&self, role: &Role, has_angle: bool, sole_error: bool, plane: &[Axis]) -> Option<usize> {
        let law = self.description();
        let ((Role::Error(axis), AffectedQuantity::Error) | (Role::Force(axis), AffectedQuantity::Force)) =
            (role, law.quantity)
        else {
            return None;
        };
        let of_plane = |axes: &[Axis]| axis.as_str() == "r" && axes.iter().any(|a| plane.contains(a));
        match law.naming {
            EffectNameAxes::Plain => (has_angle && (axis.as_str() == "r" || sole_error)).then_some(0),
            EffectNameAxes::Pair if of_plane(&self.axes) => Some(RADIAL),
            EffectNameAxes::Pair => self.axes.iter().position(|a| a == axis),
            _ if of_plane(&self.axes[..1]) => Some(RADIAL),
            _ => (self.axes.first() == Some(axis)).then_some(0),
        }
    }

    /// The same effect with exchangeable axes in alphabetical order.
    #[must_use]
    pub fn in_order(&self) -> Self {
        let mut effect = self.clone();
        if self.description().symmetric {
            effect.axes[1..].sort();
        }
        effect
    }

    /// The effect that acts like a shift of this one's reference temperature, at zero.
    /// It is an offset for growth and a scale for an expansion. `None` for an effect that reads no
    /// temperature.
    pub fn companion(&self) -> Option<Self> {
        let law = self.description().companion?;
        Dictionary::default().effect(&format!("{law}.{}", self.axes.first()?)).ok()
    }

    /// The name with all that distinguishes effects of one name in one model.
    /// That is sensors, periods, knots, times, the place of a bump.
    pub fn identity(&self) -> String {
        let mut id = self.in_order().name();
        if let Some(d) = &self.delta {
            let _ = write!(id, " {}", d.sensor);
            if let Some(minus) = d.minus() {
                let _ = write!(id, "-{minus}");
            }
        }
        for (i, p) in self.description().parameters.iter().enumerate() {
            if p.tells_apart {
                let _ = write!(id, " {}={:?}", p.name, self.get(i));
            }
        }
        id
    }

    /// Responses of a record on which the effect acts: role and component.
    /// The component is 0 or 1 of a pair, or 2 for the projection of both on the radial error of a circle.
    pub fn acts_on(&self, record: &Record) -> Vec<(Role, usize)> {
        if self.description().probing == ProbingDependence::Only && record.kind != RunKind::Probing {
            return Vec::new();
        }
        let roles: Vec<&Role> = record.responses().map(|c| &c.role).collect();
        let errors = roles.iter().filter(|r| matches!(r, Role::Error(_))).count();
        let radial = roles.iter().any(|r| r.to_string() == "error.r");
        let has_angle = record.column(&Role::Angle).is_some();
        let plane = record.circle().map_or(&[][..], |c| &c.plane);
        let component = |role: &Role| self.component(role, has_angle, errors == 1 && !radial, plane);
        roles.into_iter().filter_map(|r| Some((r.clone(), component(r)?))).collect()
    }

    /// Adds the effect to `out` at every row of a record, for one response.
    /// It adds nothing to a response that it does not act on.
    ///
    /// # Errors
    /// As [`Effect::bind`].
    ///
    /// # Panics
    /// When `out` does not have one place per row.
    pub fn add(&self, record: &Record, response: &Role, out: Out<'_>) -> Result<(), MissingInput> {
        if let Some((_, component)) = self.acts_on(record).into_iter().find(|(role, _)| role == response) {
            self.bind(record)?.add(self, component, out);
        }
        Ok(())
    }
}

fn bounds_text(p: &LawParameter) -> String {
    match p.bounds {
        [lo, hi] if lo.is_finite() && hi.is_finite() => {
            format!("a value from {lo} to {hi} ({}): {}", p.unit, p.source)
        }
        _ => format!("a finite number ({})", p.unit),
    }
}

#[cfg(test)]
mod tests;
