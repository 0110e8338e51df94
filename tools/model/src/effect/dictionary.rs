//! All laws by name, and the candidate effects that a set of records could show.

use super::laws::BUILT_IN;
use super::{
    Effect, EffectNameAxes, EffectOwner, Law, LawDescription, LawParameter, ParameterFitMethod,
    ParameterValueError, ProbingDependence, RequiredInput, TemperatureDifference,
};
use crate::record::{Axis, LINEAR, Record, Role, RunKind};
use std::sync::Arc;

/// All laws by name: the built-in ones and a project's own.
#[derive(Debug, Clone)]
pub struct Dictionary {
    laws: Vec<Arc<dyn Law>>,
}

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
    /// The dictionary already has a law of that name.
    pub fn insert(&mut self, law: Arc<dyn Law>) -> Result<(), ParameterValueError> {
        let name = &law.describe().name;
        if self.laws.iter().any(|l| l.describe().name == *name) {
            return Err(ParameterValueError::new(
                name,
                "a law of that name",
                "a name the dictionary does not have",
            ));
        }
        self.laws.push(law);
        Ok(())
    }

    /// The effect of a full name (`scale.x`).
    /// Parameters have their default, or zero (linear ones), or the middle of their plausible range.
    ///
    /// # Errors
    /// Unknown law, or a name whose ending does not suit the law.
    pub fn effect(&self, name: &str) -> Result<Effect, ParameterValueError> {
        let (head, rest) = name.split_once('.').map_or((name, None), |(h, r)| (h, Some(r)));
        let Some(law) = self.laws.iter().find(|l| l.describe().name == head) else {
            let known = self.laws.iter().map(|l| l.describe().name.as_str()).collect::<Vec<_>>().join(", ");
            let expected = format!("an effect of the dictionary: {known}");
            return Err(ParameterValueError::new("name", format!("`{name}`"), expected));
        };
        let (axes, channel) = axes_of(law.describe(), rest).ok_or_else(|| {
            let expected = format!("a name like `{head}{}`", form(law.describe().naming));
            ParameterValueError::new("name", format!("`{name}`"), expected)
        })?;
        if axes.iter().any(Axis::is_rotary) {
            return Err(ParameterValueError::new("name", format!("`{name}`, of a rotary axis"), LINEAR));
        }
        let values: Vec<f64> = law.describe().parameters.iter().map(start_value).collect();
        let (law, width) = (Arc::clone(law), values.len().min(1));
        Ok(Effect { law, axes, channel, delta: None, range_k: None, start_k: None, values, width })
    }

    /// Every effect that could act in these records, in a fixed order.
    /// It takes each law on each response, with each sensor, sensor pair and channel that the records have in
    /// common. Parameters are those of [`Dictionary::effect`]. The caller places the knots.
    pub fn candidates(&self, records: &[&Record]) -> Vec<Effect> {
        let Some(common) = CommonColumns::of(records) else { return Vec::new() };
        let mut found: Vec<Effect> = Vec::new();
        for law in &self.laws {
            for name in common.names(law.describe()) {
                let Ok(effect) = self.effect(&name) else { continue };
                if common.shows(&effect) && !found.iter().any(|f| f.name() == effect.name()) {
                    found.extend(common.with_sensors(effect));
                }
            }
        }
        found
    }
}

/// What follows a law's name in an effect's name.
fn form(naming: EffectNameAxes) -> &'static str {
    match naming {
        EffectNameAxes::Plain => "",
        EffectNameAxes::One => ".x",
        EffectNameAxes::Two | EffectNameAxes::Pair => ".x.y",
        EffectNameAxes::Three => ".x.y.z",
        EffectNameAxes::Channel => ".x.NAME",
    }
}

/// The axes and the channel in the part of a name after the law's.
/// `None` if that part does not suit the law.
fn axes_of(law: &LawDescription, rest: Option<&str>) -> Option<(Vec<Axis>, Option<String>)> {
    let parts: Vec<&str> = match (law.naming, rest) {
        (EffectNameAxes::Channel, Some(r)) => r.splitn(2, '.').collect(),
        (_, Some(r)) => r.split('.').collect(),
        (_, None) => Vec::new(),
    };
    let axes = |names: &[&str]| names.iter().map(|n| Axis::new(n)).collect::<Option<Vec<Axis>>>();
    match (law.naming, parts.as_slice()) {
        (EffectNameAxes::Plain, []) => Some((Vec::new(), None)),
        (EffectNameAxes::One, [_]) | (EffectNameAxes::Three, [_, _, _]) => Some((axes(&parts)?, None)),
        (EffectNameAxes::Two | EffectNameAxes::Pair, [a, b]) if a != b => {
            let mut axes = axes(&parts)?;
            if law.naming == EffectNameAxes::Pair {
                axes.sort();
            }
            Some((axes, None))
        }
        (EffectNameAxes::Channel, [a, channel]) if !channel.is_empty() => {
            Some((axes(&[a])?, Some((*channel).to_owned())))
        }
        _ => None,
    }
}

/// The responses, sensors and channels that all records have.
struct CommonColumns<'r> {
    records: &'r [&'r Record],
    sensors: Vec<&'r str>,
    channels: Vec<&'r str>,
    positions: Vec<&'r Axis>,
    /// Axes of the responses, and those that a radial one is made of.
    axes: Vec<&'r Axis>,
    probing: bool,
}

/// The axes on whose errors (`true`: forces) a record is informative.
/// They are those of its responses and of a circle's plane.
fn responding(record: &Record) -> impl Iterator<Item = (bool, &Axis)> {
    let of = |c: &'_ crate::record::Column| matches!(c.role, Role::Force(_));
    let own = record.responses().filter_map(move |c| Some((of(c), c.role.axis()?)));
    own.chain(record.circle().into_iter().flat_map(|c| c.plane.iter().map(|a| (false, a))))
}

impl<'r> CommonColumns<'r> {
    fn of(records: &'r [&'r Record]) -> Option<Self> {
        let first = records.first()?;
        let everywhere = |role: &Role| records.iter().all(|r| r.column(role).is_some());
        let named = |role: Role| -> Vec<&str> {
            let in_all = |n: &&str| records.iter().all(|r| r.names(&role).any(|m| m == *n));
            first.names(&role).filter(in_all).collect()
        };
        let positions = first.axes(Role::Position).filter(|a| everywhere(&Role::Position((*a).clone())));
        let axes = responding(first)
            .filter(|(force, a)| records.iter().all(|r| responding(r).any(|(f, b)| (f, b) == (*force, a))));
        Some(Self {
            records,
            sensors: named(Role::Temperature),
            channels: named(Role::Channel),
            positions: positions.collect(),
            axes: axes.map(|(_, axis)| axis).collect(),
            probing: records.iter().all(|r| r.kind == RunKind::Probing),
        })
    }

    fn everywhere(&self, role: &Role) -> bool {
        self.records.iter().all(|r| r.column(role).is_some())
    }

    /// All names that a law's effects can have in these records.
    fn names(&self, law: &LawDescription) -> Vec<String> {
        let mut names: Vec<String> = Vec::new();
        for axis in &self.axes {
            let name = format!("{}.{axis}", law.name);
            let others = self.positions.iter().filter(|p| *p != axis);
            match law.naming {
                EffectNameAxes::Plain => names.push(law.name.clone()),
                EffectNameAxes::One => names.push(name),
                EffectNameAxes::Two | EffectNameAxes::Pair => {
                    names.extend(others.map(|b| format!("{name}.{b}")));
                }
                EffectNameAxes::Three => {
                    for (i, b) in self.positions.iter().enumerate() {
                        names.extend(self.positions[i + 1..].iter().map(|c| format!("{name}.{b}.{c}")));
                    }
                }
                EffectNameAxes::Channel => names.extend(self.channels.iter().map(|c| format!("{name}.{c}"))),
            }
        }
        names
    }

    /// Whether every record has the response and the inputs of an effect.
    fn shows(&self, effect: &Effect) -> bool {
        let law = effect.description();
        let components = if law.naming == EffectNameAxes::Pair { 2 } else { 1 };
        let readable = |need: &RequiredInput| match need {
            RequiredInput::Time | RequiredInput::Channel => true,
            RequiredInput::Delta => !self.sensors.is_empty(),
            RequiredInput::Direction => {
                let axis = effect.axes[0].clone();
                self.everywhere(&Role::Direction(axis.clone())) || self.everywhere(&Role::Velocity(axis))
            }
            _ => self.everywhere(&need.role(&effect.axes)),
        };
        // A ballbar turns about its balls: no probe takes part in a circle.
        let circle = self.records.iter().any(|r| r.circle().is_some());
        // The bar's radial error is no axis of its own: what depends on a position acts on the two axes.
        let of_bar = effect.axes.first().is_some_and(|a| a.as_str() == "r")
            && law.needs.iter().any(|n| matches!(n, RequiredInput::Position(_)));
        self.records.iter().all(|r| effect.acts_on(r).len() >= components)
            && !(circle && (law.owner != EffectOwner::Machine || of_bar))
            && law.needs.iter().all(readable)
            && !(law.probing == ProbingDependence::Displaced && self.probing)
    }

    /// The effect, or one per sensor and sensor pair if it reads a temperature.
    fn with_sensors(&self, effect: Effect) -> Vec<Effect> {
        if !effect.description().needs.contains(&RequiredInput::Delta) {
            return vec![effect];
        }
        let with = |delta: TemperatureDifference| Effect { delta: Some(delta), ..effect.clone() };
        let mut found = Vec::new();
        for (i, s) in self.sensors.iter().enumerate() {
            found.push(with(TemperatureDifference::single(s)));
            found.extend(self.sensors[i + 1..].iter().map(|m| with(TemperatureDifference::pair(s, m))));
        }
        found
    }
}

/// The start value of a parameter: its default, zero, or the middle of its range.
/// The middle of the plausible range is geometric where possible.
fn start_value(p: &LawParameter) -> f64 {
    let [lo, hi] = p.plausible;
    match p.search {
        _ if p.default.is_some() => p.default.unwrap_or_default(),
        ParameterFitMethod::Linear | ParameterFitMethod::Amplitude | ParameterFitMethod::Phase => 0.0,
        _ if lo > 0.0 => (lo * hi).sqrt(),
        _ => f64::midpoint(lo, hi),
    }
}
