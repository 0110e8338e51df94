//! The answer of an analysis, before anything is written: what was found, what else it might be, what is left.

use crate::cause::Shape;
use rtec_model::effect::{Difference, Effect};

/// Rounds of block permutation.
pub(crate) const ROUNDS: usize = 40;

/// Another explanation of the same thing.
#[derive(Debug, Clone, PartialEq)]
pub struct Rival {
    /// Name of the effect.
    pub name: String,
    /// Its temperature difference, where it has one.
    pub sensor: Option<Difference>,
    /// The value that differs where the name is the same: a parameter, in its own unit.
    pub differs: Option<(String, f64)>,
    /// Log odds by which the explanation given is better.
    pub margin: f64,
}

impl Rival {
    /// Its name, with what it reads or the value that differs.
    #[must_use]
    pub fn label(&self) -> String {
        let sensor = self.sensor.as_ref().map_or_else(String::new, |d| format!(" ({d})"));
        let differs = self.differs.as_ref().map_or_else(String::new, |(key, v)| format!(" ({key} = {v:.4})"));
        format!("{}{sensor}{differs}", self.name)
    }
}

/// An effect that was found.
#[derive(Debug, Clone)]
pub struct Finding {
    /// The effect with its parameters.
    pub effect: Effect,
    /// Values that the law has and the data did not call for: held where they are.
    pub held: Vec<usize>,
    /// Probability that chance alone explains as much.
    pub p_value: f64,
    /// Log likelihood gained, less the price of its freedom.
    pub evidence: f64,
    /// What the data cannot tell from it.
    pub rivals: Vec<Rival>,
}

/// The answer, before anything is written.
#[derive(Debug)]
pub struct Answer {
    /// Effects to add, strongest first.
    pub findings: Vec<Finding>,
    /// Structure that no effect explains.
    pub unexplained: Vec<Shape>,
    /// The model's own effects with their parameters as the data have them, before the last fit.
    pub present: Vec<Effect>,
    /// The model's own effects as the file has them.
    pub file: Vec<Effect>,
    /// The same with the periods that were found by a search: what a fit starts from and is held to.
    pub anchor: Vec<Effect>,
    /// Every name that was tried as the next one, best first: log odds against what was accepted.
    pub ranking: Vec<Tried>,
    /// What is left unexplained, and the noise's coefficient.
    pub residual: Vec<f64>,
    /// First-order autocorrelation of the noise.
    pub phi: f64,
    /// Size of the noise per response.
    pub sigma: Vec<f64>,
    /// Log likelihood of the best account of the records, in their own units, less the price of its freedom.
    pub evidence: f64,
}

/// A name that was tried.
#[derive(Debug, Clone)]
pub struct Tried {
    /// Name, with its sensors.
    pub label: String,
    /// Log odds of the best set with it in place of the nearest accepted effect (or beside them).
    pub odds: f64,
    /// Whether it is in the answer.
    pub accepted: bool,
}
