//! The grid on which a search for a missing effect begins.
//! Each law lists grid points of its non-linear parameters over the records' range.

use super::Effect;
use crate::record::Axis;

/// The extent of a search's records, which a law's grid asks for.
pub trait RecordExtent {
    /// Number of rows of all responses.
    fn rows(&self) -> usize;
    /// Time constants that the records can show, s, rising.
    /// They go from a few rows to beyond the longest record.
    fn time_constants_s(&self) -> Vec<f64>;
    /// Times of the rows at which a step may fall, s, rising.
    /// The first and last few are left out.
    fn moments_s(&self) -> Vec<f64>;
    /// Measured places of an axis, mm, rising; empty if none is logged.
    /// Places that differ by little are merged.
    fn places_mm(&self, axis: &Axis) -> Vec<f64>;
    /// Longest travel of one record along an axis, mm, wherever its zero is.
    fn travel_mm(&self, axis: &Axis) -> f64;
}

/// A grid point.
#[derive(Debug, Clone, PartialEq)]
pub struct SearchGridPoint {
    /// The effect with its non-linear parameters set.
    pub effect: Effect,
    /// Price of the search, nats.
    /// It is the logarithm of the number of points that can be distinguished.
    pub price: f64,
}

impl SearchGridPoint {
    /// The single point of a law without non-linear parameters.
    pub fn only(effect: &Effect) -> Vec<Self> {
        vec![Self { effect: effect.clone(), price: 0.0 }]
    }

    /// One point for each value of one parameter, all at one price.
    /// Values outside its bounds are left out.
    pub fn along(
        effect: &Effect,
        parameter: usize,
        values: impl IntoIterator<Item = f64>,
        price: f64,
    ) -> Vec<Self> {
        let at = |value| Some(Self { effect: effect.with(&[(parameter, value)])?, price });
        values.into_iter().filter_map(at).collect()
    }
}

impl Effect {
    /// The effect with some of its scalar parameters at other values.
    /// `None` if a value is outside its bounds.
    pub fn with(&self, set: &[(usize, f64)]) -> Option<Self> {
        let mut values = self.values().to_vec();
        for (parameter, value) in set {
            *values.get_mut(*parameter)? = *value;
        }
        self.with_values(&values)
    }

    /// The effect with other values of all parameters; `None` if one is out of bounds.
    pub fn with_values(&self, values: &[f64]) -> Option<Self> {
        let mut effect = self.clone();
        effect.set_values(values).is_ok().then_some(effect)
    }

    /// The law's grid points in records of this extent.
    pub fn grid(&self, records: &dyn RecordExtent) -> Vec<SearchGridPoint> {
        self.law().grid(self, records)
    }
}
