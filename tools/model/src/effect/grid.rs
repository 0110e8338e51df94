//! Where a search for a missing effect looks first.
//! Each law lists grid points of its non-linear parameters over the records' range.

use super::Effect;
use crate::record::Axis;

/// What the records of a search span, asked by a law's grid.
pub trait Extent {
    /// Number of rows of all responses.
    fn rows(&self) -> usize;
    /// Time constants that the records can show, s, rising.
    /// They go from a few rows to beyond the longest record.
    fn time_constants_s(&self) -> Vec<f64>;
    /// Times of the rows at which a step may fall, s, rising.
    /// The first and last few are left out.
    fn moments_s(&self) -> Vec<f64>;
    /// Measured places of an axis, mm, rising; empty where none is logged.
    /// Places that differ by little are merged.
    fn places_mm(&self, axis: &Axis) -> Vec<f64>;
    /// Travel of single records along an axis, mm, where shorter than that of all together.
    ///
    /// Ranges that differ by little are merged.
    fn stretches_mm(&self, axis: &Axis) -> Vec<[f64; 2]>;
}

/// A grid point.
#[derive(Debug, Clone, PartialEq)]
pub struct Point {
    /// The effect with its non-linear parameters set.
    pub effect: Effect,
    /// Price of the search, nats: the logarithm of how many points can be distinguished.
    pub price: f64,
}

impl Point {
    /// A law without a non-linear parameter has one point.
    #[must_use]
    pub fn only(effect: &Effect) -> Vec<Self> {
        vec![Self { effect: effect.clone(), price: 0.0 }]
    }

    /// One point for each value of one parameter, all at one price.
    /// Values outside its bounds are left out.
    #[must_use]
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
    /// `None` outside their bounds.
    #[must_use]
    pub fn with(&self, set: &[(usize, f64)]) -> Option<Self> {
        let mut values = self.values().to_vec();
        for (parameter, value) in set {
            *values.get_mut(*parameter)? = *value;
        }
        self.with_values(&values)
    }

    /// The effect with other values of all its parameters; `None` outside their bounds.
    #[must_use]
    pub fn with_values(&self, values: &[f64]) -> Option<Self> {
        let mut effect = self.clone();
        effect.set_values(values).is_ok().then_some(effect)
    }

    /// Grid points of a search in records of this extent.
    #[must_use]
    pub fn grid(&self, records: &dyn Extent) -> Vec<Point> {
        self.law().grid(self, records)
    }
}
