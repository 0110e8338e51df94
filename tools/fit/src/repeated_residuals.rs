//! Residuals that repeat at a place.
//! They are compared with the scatter of the rows of one place. Stretches of places serve for leaving out.

use rtec_model::record::{Record, Role, span};
use statrs::distribution::{ContinuousCDF, FisherSnedecor};
use std::collections::BTreeMap;
use std::fmt;

/// An axis that moves by less counts as standing still, mm.
const STILL_MM: f64 = 1.0;
/// Positions that differ by less than this share of the travel are one place.
const ONE_PLACE: f64 = 2e-3;
/// With fewer places an axis counts as not moving.
const FEWEST: usize = 5;
/// Probability, per response, that noise alone seems structured.
const CHANCE: f64 = 1e-4;
/// Largest row-to-row autocorrelation of a residual that is noise.
/// Noise has at most 0.7; the rest allows for chance over [`ROWS`] rows. This test decides if no place was
/// visited twice.
const MEMORY: f64 = 0.85;
/// Fewest independent rows that [`MEMORY`] allows for.
const ROWS: usize = 40;
/// Resolution finer than that of any instrument, µm.
const RESOLUTION_UM: f64 = 1e-3;

/// The axes that move in a record, by name, with their positions.
pub(crate) fn moving(record: &Record) -> impl Iterator<Item = (String, &[f64])> {
    let of = |axis: &rtec_model::record::Axis| {
        let p = record.data(&Role::Position(axis.clone()))?;
        (range(p.iter().copied()) > STILL_MM).then(|| (axis.to_string(), p))
    };
    record.axes(Role::Position).filter_map(of).collect::<Vec<_>>().into_iter()
}

fn range(p: impl Iterator<Item = f64>) -> f64 {
    let [lo, hi] = span(p);
    (hi - lo).max(0.0)
}

/// Index of each row's place along an axis, in order, and the number of places.
fn numbered(p: &[Option<f64>]) -> (Vec<Option<usize>>, usize) {
    let near = ONE_PLACE * range(p.iter().flatten().copied());
    let mut order: Vec<usize> = (0..p.len()).filter(|i| p[*i].is_some()).collect();
    let at = |i: usize| p[i].unwrap_or(0.0);
    order.sort_by(|a, b| at(*a).total_cmp(&at(*b)));
    let (mut number, mut last) = (0, None);
    let mut out = vec![None; p.len()];
    for i in order {
        number += usize::from(last.is_some_and(|l| at(i) - l > near));
        last = Some(at(i));
        out[i] = Some(number);
    }
    (out, number + 1)
}

/// At most `most` stretches of neighbouring places. `None` if there are few places.
pub(crate) fn stretches(p: &[Option<f64>], most: usize) -> Option<Vec<Option<usize>>> {
    let (number, count) = numbered(p);
    let of = |n: Option<usize>| n.map(|n| n * most.min(count) / count);
    (count >= FEWEST).then(|| number.into_iter().map(of).collect())
}

/// A residual that is not noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct StructuredResidual {
    /// RMS of the whole residual, µm.
    rms_um: f64,
    /// Standard deviation of the rows of one place, µm.
    /// `None` if no place was visited twice.
    repeats_um: Option<f64>,
}

impl StructuredResidual {
    /// Tests these rows' residuals after a fit of `fitted` parameters.
    /// `None` if they may be noise.
    pub(crate) fn of(record: &Record, left_um: &[f64], fitted: usize) -> Option<Self> {
        let n = left_um.len();
        let rms_um = (left_um.iter().map(|v| v * v).sum::<f64>() / n.max(1) as f64).sqrt();
        let mut keys: Vec<Vec<i64>> = vec![Vec::new(); n];
        for (_, p) in moving(record) {
            let places = numbered(&p.iter().copied().map(Some).collect::<Vec<_>>()).0;
            keys.iter_mut().zip(places).for_each(|(k, n)| k.extend(n.map(|n| n as i64)));
        }
        if keys.first().is_none_or(Vec::is_empty) {
            return None;
        }
        for axis in record.axes(Role::Direction) {
            let d = record.data(&Role::Direction(axis.clone())).unwrap_or_default();
            keys.iter_mut().zip(d).for_each(|(k, d)| k.push(*d as i64));
        }
        let mut groups: BTreeMap<&[i64], Vec<f64>> = BTreeMap::new();
        for (key, v) in keys.iter().zip(left_um) {
            groups.entry(key).or_default().push(*v);
        }
        let again = (n - groups.len()) as f64;
        let others = groups.len() as f64 - fitted as f64 - 1.0;
        if again < 10.0 || others < 4.0 {
            let memory = left_um.windows(2).map(|w| w[0] * w[1]).sum::<f64>() / (rms_um * rms_um * n as f64);
            let structured = n >= ROWS && rms_um > RESOLUTION_UM && memory > MEMORY;
            return structured.then_some(Self { rms_um, repeats_um: None });
        }
        let (mut within, mut between) = (0.0, 0.0);
        for g in groups.values() {
            let mean = g.iter().sum::<f64>() / g.len() as f64;
            within += g.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
            between += g.len() as f64 * mean * mean;
        }
        let repeats = (within / again).max(RESOLUTION_UM * RESOLUTION_UM);
        let ratio = between / others / repeats;
        let beyond = FisherSnedecor::new(others, again).map_or(1.0, |f| 1.0 - f.cdf(ratio));
        // Variance between the places, less the part that noise causes in their means.
        let own = (between - others * repeats) / n as f64;
        (beyond < CHANCE && own > repeats).then(|| Self { rms_um, repeats_um: Some(repeats.sqrt()) })
    }
}

impl fmt::Display for StructuredResidual {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.2} µm RMS are left", self.rms_um)?;
        match self.repeats_um {
            Some(um) => write!(f, " where one place repeats within {um:.2} µm")?,
            None => f.write_str(" that change slowly from row to row")?,
        }
        f.write_str(
            ": there is something that these effects do not have (a wave, a bend); the intervals are widened by it, and \
             `rtecctl reconcile` looks for its name",
        )
    }
}
