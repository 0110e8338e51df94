//! The contribution of a hypothesis to the rows.
//! It is an effect of the dictionary with its non-linear parameters set, or a shape without a name.

use crate::priors::{CONTRIBUTION, OF_MOST, REFERENCE_K};
use crate::rows_and_noise::MeasuredRows;
use crate::set_up_terms::{first_after_turn, unknown_centre_columns};
use rtec_least_squares::dot;
use rtec_model::effect::{Effect, ParameterFitMethod, ReferenceTemperature, RequiredInput, STANDARD_DEGC};
use rtec_model::record::Role;
use std::sync::Arc;

/// A shape that is in no dictionary.
#[derive(Debug, Clone, PartialEq)]
pub struct UnnamedShape {
    /// The response in which it is seen.
    pub response: String,
    /// The variables it depends on: roles, as in `where`.
    pub against: Vec<String>,
    /// Its manner in words: smooth, periodic, differs by direction, …
    pub manner: String,
}

impl UnnamedShape {
    /// Its variables and its manner.
    #[must_use]
    pub fn label(&self) -> String {
        format!("unnamed {} {}", self.against.join(" "), self.manner)
    }

    /// The shape that describes an effect without a name.
    /// `None` if the effect acts on nothing that was measured.
    #[must_use]
    pub fn like(rows: &MeasuredRows<'_>, effect: &Effect, manner: &str) -> Option<Self> {
        let acts = rows.records.iter().find_map(|r| effect.acts_on(r).into_iter().next())?;
        let role = |n: &RequiredInput| match n {
            RequiredInput::Delta => effect.delta.as_ref().map(|d| format!("temperature.{}", d.sensor)),
            RequiredInput::Channel => effect.channel().map(|c| format!("channel.{c}")),
            other => Some(other.role(effect.axes()).to_string()),
        };
        let mut against: Vec<String> = effect.description().needs.iter().filter_map(role).collect();
        if against.is_empty() {
            against.push("time".to_owned());
        }
        Some(Self { response: acts.0.to_string(), against, manner: manner.to_owned() })
    }
}

/// The contribution of a hypothesis to the rows.
#[derive(Debug, Clone)]
pub enum HypothesisContribution {
    /// An effect.
    /// Its first `free` coefficients, and whether its reference temperature is free too.
    Effect {
        /// The effect, with its non-linear parameters set.
        effect: Effect,
        /// Number of free coefficients.
        free: usize,
        /// Whether one more column is for another reference temperature.
        reference: bool,
    },
    /// A map: directions over its knots.
    Map {
        /// The effect, with its knots.
        effect: Effect,
        /// Heights of each direction at one standard deviation.
        directions: Arc<Vec<Vec<f64>>>,
    },
    /// A shape without a name: its columns at one standard deviation.
    Shape(Arc<(UnnamedShape, Vec<Vec<f64>>)>),
}

impl HypothesisContribution {
    /// The effect, if it is one.
    #[must_use]
    pub fn effect(&self) -> Option<&Effect> {
        match self {
            Self::Effect { effect, .. } | Self::Map { effect, .. } => Some(effect),
            Self::Shape(_) => None,
        }
    }

    /// The same with another effect.
    #[must_use]
    pub fn with_effect(&self, other: Effect) -> Self {
        match self {
            Self::Effect { free, reference, .. } => {
                Self::Effect { effect: other, free: *free, reference: *reference }
            }
            same => same.clone(),
        }
    }

    /// The columns, each at one standard deviation for a typical size.
    /// The coefficients' columns come first. Columns for records that do not state the effect's position
    /// follow.
    #[must_use]
    pub fn columns(&self, rows: &MeasuredRows<'_>) -> Vec<Vec<f64>> {
        match self {
            Self::Shape(both) => both.1.clone(),
            Self::Map { effect, directions } => {
                let raw = rows.basis(effect);
                let size = height_size(effect);
                let of = |d: &Vec<f64>| {
                    let mut out = vec![0.0; rows.n];
                    for (height, column) in d.iter().zip(&raw) {
                        rtec_least_squares::add(&mut out, height * size, column);
                    }
                    out
                };
                let mut columns: Vec<Vec<f64>> = directions.iter().map(of).collect();
                let sizes = vec![size; effect.coefficient_count()];
                columns.extend(unknown_centre_columns(rows, effect, &sizes).into_iter().map(|c| c.1));
                columns
            }
            Self::Effect { effect, free, reference } => {
                let mut columns = rows.basis(effect);
                columns.truncate(*free);
                if effect.description().after_turn {
                    without_untold_turns(rows, effect, &mut columns);
                }
                for (column, size) in columns.iter_mut().zip(sizes(effect)) {
                    let size = size_by_column(size, column);
                    for x in column.iter_mut() {
                        *x *= size;
                    }
                }
                if *reference && let Some(companion) = effect.companion() {
                    let size = sizes(effect)[0] * REFERENCE_K;
                    let mut level = rows.basis(&companion).swap_remove(0);
                    for x in &mut level {
                        *x *= size;
                    }
                    columns.push(level);
                }
                columns.extend(unknown_centre_columns(rows, effect, &sizes(effect)).into_iter().map(|c| c.1));
                columns
            }
        }
    }

    /// The law's coefficients that are not free.
    /// For each: its number, its standard deviation in its own unit, and the column of one unit.
    #[must_use]
    pub fn left_out(&self, rows: &MeasuredRows<'_>) -> Vec<(usize, f64, Vec<f64>)> {
        let Self::Effect { effect, free, .. } = self else { return Vec::new() };
        if effect.coefficient_count() <= *free {
            return Vec::new();
        }
        let all = self.coefficient_sizes(rows).into_iter().zip(rows.basis(effect)).enumerate();
        all.skip(*free).map(|(k, (size, column))| (k, size, column)).collect()
    }

    /// The effect that these coefficients describe; `None` for a shape.
    /// The coefficients are in standard deviations of the columns above.
    #[must_use]
    pub fn solved(&self, rows: &MeasuredRows<'_>, beta: &[f64]) -> Option<Effect> {
        match self {
            Self::Shape(_) => None,
            Self::Map { effect, directions } => {
                let size = height_size(effect);
                let mut heights = vec![0.0; effect.coefficient_count()];
                for (b, d) in beta.iter().zip(directions.iter()) {
                    rtec_least_squares::add(&mut heights, b * size, d);
                }
                let mut effect = effect.clone();
                effect.set_coefficients(&heights);
                Some(effect)
            }
            Self::Effect { effect, free, reference } => {
                let mut coefficients = vec![0.0; effect.coefficient_count()];
                for (i, (b, size)) in beta.iter().take(*free).zip(self.coefficient_sizes(rows)).enumerate() {
                    coefficients[i] = b * size;
                }
                let mut effect = effect.clone();
                if *reference {
                    let c0 = beta[*free] * sizes(&effect)[0] * REFERENCE_K;
                    refer(&mut effect, coefficients[0], c0);
                }
                effect.set_coefficients(&coefficients);
                Some(effect)
            }
        }
    }

    /// One standard deviation of each coefficient of an effect, in its own unit.
    #[must_use]
    pub fn coefficient_sizes(&self, rows: &MeasuredRows<'_>) -> Vec<f64> {
        let Some(effect) = self.effect() else { return Vec::new() };
        let sizes = sizes(effect);
        if sizes.iter().all(|s| *s > 0.0) {
            return sizes;
        }
        let raw = rows.basis(effect);
        sizes.into_iter().zip(&raw).map(|(size, column)| size_by_column(size, column)).collect()
    }
}

/// Prior size of a map's heights.
fn height_size(effect: &Effect) -> f64 {
    let parameters = &effect.description().parameters;
    let heights = parameters.iter().find(|p| p.array && p.search == ParameterFitMethod::Linear);
    heights.map_or(CONTRIBUTION, rtec_model::effect::LawParameter::prior_size)
}

/// Prior size of a coefficient.
/// Where the dictionary has none, its column contributes as much as is usual.
fn size_by_column(size: f64, column: &[f64]) -> f64 {
    if size > 0.0 {
        return size;
    }
    let n = column.len().max(1) as f64;
    let mean = column.iter().sum::<f64>() / n;
    let rms = (dot(column, column) / n - mean * mean).max(0.0).sqrt();
    CONTRIBUTION / rms.max(1e-300)
}

/// Prior sizes of an effect's coefficients, in their own units.
/// Zero if only the data give a scale (a channel).
#[must_use]
pub fn sizes(effect: &Effect) -> Vec<f64> {
    let law = effect.description();
    let k = effect.coefficient_count();
    if let Some(i) = law.place(ParameterFitMethod::Amplitude) {
        // An amplitude limited by the period is typically a share of the period.
        let by_period = law.searched.wave.and_then(|w| Some(w.most_periods? * w.unit_mm * 1e3));
        let size = by_period.map_or(law.parameters[i].prior_size(), |most| OF_MOST * most * effect.scalar(0));
        return vec![size; k];
    }
    let of = |p: &rtec_model::effect::LawParameter| {
        let scaleless = p.typical <= 0.0 && p.plausible[1] > 1e9;
        if scaleless { 0.0 } else { p.prior_size() }
    };
    let linear = law.parameters.iter().filter(|p| p.search == ParameterFitMethod::Linear);
    linear.flat_map(|p| vec![of(p); if p.array { effect.width() } else { 1 }]).take(k).collect()
}

/// Zeroes a spike's columns at readings after turns that the record does not state.
fn without_untold_turns(rows: &MeasuredRows<'_>, effect: &Effect, columns: &mut [Vec<f64>]) {
    let Some(axis) = effect.axes().first() else { return };
    for s in &rows.segments {
        let record = rows.record(s);
        let Some(direction) = record.data(&Role::Direction(axis.clone())) else { continue };
        for i in first_after_turn(record, direction) {
            for c in columns.iter_mut() {
                c[s.rows.start + i] = 0.0;
            }
        }
    }
}

/// Turns a constant added to a law of ΔT into a reference temperature.
/// The identity is c₁x + c₀ = c₁(x − d).
fn refer(effect: &mut Effect, c1: f64, c0: f64) {
    let d = -c0 / c1;
    if d.is_finite()
        && d.abs() < 10.0
        && let Some(delta) = &mut effect.delta
    {
        delta.against = ReferenceTemperature::Reference(STANDARD_DEGC + d);
    }
}
