//! Search for drift, spikes (grid of lengths) and cyclic errors (grid of periods).

use super::diagnosis::{DiagnosisFit, columns_of};
use super::{law, unexplained_structure};
use nalgebra::{DMatrix, DVector};
use rtec_least_squares::{QrFactor, orthonormal, projected_out};
use rtec_model::effect::{Dictionary, Effect, laws};
use rtec_model::record::{Axis, median, span};
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Gain, in squared standard deviations, from which a spike is fitted.
/// A spike is fitted early so that it does not bend other terms.
const SPIKE_FITTED: f64 = 6.0;
/// Gain from which a spike is reported: reached by one in 1000 circles of noise.
const SPIKE_TOLD: f64 = 18.0;
/// Shortest spike in the search, mm.
const SHORTEST_MM: f64 = 0.05;
/// Risk per circle, over all periods, of a cyclic error by chance.
const CYCLIC_RISK: f64 = 1e-3;
/// Range of periods, mm: screw pitches and pitch circles.
const PERIODS_MM: [f64; 2] = [0.5, 60.0];
/// Gain, in squared standard deviations, from which drift is fitted.
/// One in twenty circles of noise reaches it, over its three columns.
const DRIFT_FITTED: f64 = 7.8;

/// Lengths of the search for spikes, mm.
fn lengths_up_to(longest_mm: f64) -> impl Iterator<Item = f64> {
    (0..).map(|k| SHORTEST_MM * 1.5_f64.powi(k)).take_while(move |l| *l < longest_mm)
}

impl DiagnosisFit<'_> {
    /// Adds drift, spikes and cyclic errors that show, then refines them together.
    pub(super) fn search(&mut self, axes: [&Axis; 2], told: &mut Vec<String>) {
        let d = Dictionary::default();
        self.memory();
        self.add_drift();
        self.memory();
        self.add_spikes(&d, axes, told);
        let spikes = self.terms.len();
        for axis in axes {
            if let Some(effect) = self.best_wave(&d, axis) {
                let name = format!("cyclic.{axis}");
                self.push(&name, Some(vec![(effect, 1.0)]));
                told.push(name);
            }
        }
        self.memory();
        if self.terms.len() > spikes {
            // A large wave with a wrong period hides a spike.
            self.free_all(told);
            self.terms.retain(|t| !t.name.starts_with("spike."));
            told.retain(|name| !name.starts_with("spike."));
            // Start with the clearest spike, because its residual looks like a spike of the other axis.
            let gain = |axis| self.best_spike(&d, axis).map_or(0.0, |(_, gain)| gain);
            let [a, b] = axes;
            let order = if gain(b) > gain(a) { [b, a] } else { axes };
            self.add_spikes(&d, order, told);
            self.memory();
        }
        self.free_all(told);
        self.drop_endless(told);
    }

    /// Adds a spike for each axis that shows one, in this order.
    /// With one direction of rotation, reversal and structure hide a spike: it is always fitted.
    fn add_spikes(&mut self, d: &Dictionary, axes: [&Axis; 2], told: &mut Vec<String>) {
        let fitted = if self.structure.both_ways { SPIKE_FITTED } else { 0.0 };
        for axis in axes {
            if let Some((effect, gain)) = self.best_spike(d, axis).filter(|(_, gain)| *gain > fitted) {
                let name = format!("spike.{axis}");
                self.push(&name, Some(vec![(effect, 1.0)]));
                told.extend((gain > SPIKE_TOLD && self.structure.both_ways).then_some(name));
            }
        }
    }

    /// Removes endless spikes, and reported ones whose interval contains zero.
    /// They followed no spike, or a single row.
    fn drop_endless(&mut self, told: &mut Vec<String>) {
        let longest_mm = self.traces[0].record.circle().map_or(f64::INFINITY, |c| c.radius_mm) / 2.0;
        let before = self.terms.len();
        let halves = self.value_uncertainty().halves;
        let mut at = 0;
        self.terms.retain(|t| {
            let half = halves.get(at).copied().unwrap_or(0.0);
            at += t.free.len();
            let Some((spike, _)) = t.parts.first().filter(|_| t.name.starts_with("spike.")) else {
                return true;
            };
            let (um, length_mm) = (spike.scalar(0), spike.scalar(1));
            let none = told.contains(&t.name) && um.abs() <= half;
            length_mm < longest_mm && length_mm > SHORTEST_MM / 2.0 && !none
        });
        if self.terms.len() < before {
            told.retain(|name| self.terms.iter().any(|t| t.name == *name));
            self.free_all(told);
        }
    }

    /// Whether harmonics explain more than noise does in nine of ten circles.
    pub(super) fn harmonics_show(&self) -> bool {
        let m = self.structure.columns.ncols();
        if m == 0 {
            return false;
        }
        let (q, left, variance) = self.prepared();
        let gain = self.gain(&q, &left, variance, &columns_of(&self.structure.columns)).0;
        ChiSquared::new(m as f64).is_ok_and(|c| gain > c.inverse_cdf(0.9))
    }

    /// Adds drift to the columns beside the terms, where it shows.
    fn add_drift(&mut self) {
        if !self.structure.both_ways {
            return;
        }
        for (i, t) in self.traces.iter().enumerate() {
            let columns = unexplained_structure::drift(t, self.start[i], self.n);
            let (q, left, variance) = self.prepared();
            if !columns.is_empty() && self.gain(&q, &left, variance, &columns).0 > DRIFT_FITTED {
                self.take_beside(&DMatrix::from_columns(&columns));
                self.drift += columns.len();
            }
        }
    }

    /// Gain in squared standard deviations by these columns, and their values.
    fn gain(
        &self,
        q: &DMatrix<f64>,
        left: &DVector<f64>,
        variance: f64,
        columns: &[DVector<f64>],
    ) -> (f64, DVector<f64>) {
        let own: Vec<DVector<f64>> = columns.iter().map(|c| self.apart(q, c)).collect();
        let own: Vec<&[f64]> = own.iter().map(DVector::as_slice).collect();
        match rtec_least_squares::solve(&own, left.as_slice()) {
            Ok(found) => ((left.norm_squared() - found.left()) / variance, DVector::from_vec(found.values)),
            Err(_) => (0.0, DVector::zeros(columns.len())),
        }
    }

    /// A whitened column less its part along the basis `q`.
    pub(super) fn apart(&self, q: &DMatrix<f64>, column: &DVector<f64>) -> DVector<f64> {
        projected_out(q, self.white(column))
    }

    fn prepared(&self) -> (DMatrix<f64>, DVector<f64>, f64) {
        let j = self.jacobian();
        let left = self.white(&self.left());
        let variance = left.norm_squared() / self.freedom(j.ncols());
        (orthonormal(j), left, variance.max(1e-18))
    }

    /// The spike that explains most of the residual, and its gain.
    /// Lengths go from 0.05 mm to a third of the radius.
    fn best_spike(&self, d: &Dictionary, axis: &Axis) -> Option<(Effect, f64)> {
        let radius_mm = self.traces[0].record.circle()?.radius_mm;
        let spike = law(d, laws::reversal_spike::NAME, &[axis])?;
        let (q, left, variance) = self.prepared();
        // With one direction of rotation a long spike looks like a map.
        let longest = radius_mm / if self.structure.both_ways { 3.0 } else { 30.0 };
        let lengths = lengths_up_to(longest);
        let of = |length: f64| {
            let effect = spike.with(&[(1, length)])?;
            let (gain, beta) = self.gain(&q, &left, variance, &self.basis(&effect, None));
            Some((effect.with(&[(0, beta[0])])?, gain))
        };
        lengths.filter_map(of).max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Log Bayes factor for columns against none of them (Kass and Raftery 1995).
    /// `typical_um` is the standard deviation of their amplitudes' prior.
    pub(super) fn odds(&self, columns: &[DVector<f64>], typical_um: f64) -> f64 {
        let (q, left, variance) = self.prepared();
        let left = left / variance.sqrt();
        let mut factor = QrFactor::new(left.as_slice());
        for c in columns {
            factor.push((self.apart(&q, c) * (typical_um / variance.sqrt())).as_slice());
        }
        0.5 * (left.norm_squared() - factor.left()) - factor.half_log_det()
    }

    /// Log Bayes factor for a spike of an axis against none, averaged over lengths.
    pub(super) fn spike_odds(&self, axis: &Axis) -> Option<f64> {
        let spike = law(&Dictionary::default(), laws::reversal_spike::NAME, &[axis])?;
        let typical_um = spike.description().parameters[0].typical;
        let longest = self.traces[0].record.circle()?.radius_mm / 3.0;
        let of = |length| Some(self.odds(&self.basis(&spike.with(&[(1, length)])?, None), typical_um));
        let all: Vec<f64> = lengths_up_to(longest).filter_map(of).collect();
        let top = all.iter().copied().reduce(f64::max)?;
        Some(top + (all.iter().map(|o| (o - top).exp()).sum::<f64>() / all.len() as f64).ln())
    }

    /// The cyclic error that explains most of the residual, beyond chance.
    fn best_wave(&self, d: &Dictionary, axis: &Axis) -> Option<Effect> {
        let wave = law(d, laws::screw_periodic::NAME, &[axis])?;
        let places = self.traces.iter().filter_map(|t| t.record.position(axis));
        let mut steps = places.clone().flat_map(|p| p.windows(2)).map(|w| (w[1] - w[0]).abs()).peekable();
        steps.peek()?;
        let [low, high] = span(places.clone().flatten());
        let span = high - low;
        let shortest = PERIODS_MM[0].max(2.5 * median(steps));
        let (from, to) = (1.0 / PERIODS_MM[1].min(span / 3.0), 1.0 / shortest);
        if to <= from {
            return None;
        }
        let (q, left, variance) = self.prepared();
        let step = 0.3 / span;
        let count = ((to - from) / step).ceil().max(2.0) as usize;
        let of = |f: f64| {
            let mut effect = wave.with(&[(0, 1.0 / f)])?;
            let (gain, beta) = self.gain(&q, &left, variance, &self.basis(&effect, None));
            effect.set_coefficients(beta.as_slice());
            Some((effect, gain))
        };
        let (mut best, mut gain) =
            (0..count).filter_map(|i| of(from + step * i as f64)).max_by(|a, b| a.1.total_cmp(&b.1))?;
        let mut h = step;
        for _ in 0..12 {
            h *= 0.5;
            for g in [-h, h] {
                if let Some(other) = of(1.0 / best.scalar(0) + g).filter(|o| o.1 > gain) {
                    (best, gain) = other;
                }
            }
        }
        (gain > 2.0 * (count as f64 / CYCLIC_RISK).ln() && best.scalar(1) > 0.0).then_some(best)
    }

    /// Frees lengths of reported spikes, periods and phases too, and minimises.
    pub(super) fn free_all(&mut self, told: &[String]) {
        for t in &mut self.terms {
            if t.name.starts_with("spike.") && told.contains(&t.name) {
                t.free = vec![0, 1];
            } else if t.name.starts_with("cyclic.") {
                t.free = vec![0, 1, 2];
            }
        }
        let mut before = f64::INFINITY;
        for _ in 0..30 {
            let now = self.step();
            if before - now <= 1e-9 * now {
                break;
            }
            before = now;
        }
    }
}
