//! All rows of all responses of all records, one under the other, and their noise.

use crate::priors::{ALIKE_ROWS, MOST_PHI, NOISE};
use crate::search_limits::{MUCH_MEMORY, ONE_PLACE, SIZE_STEPS, TIME_CONSTANTS};
use rtec_model::effect::{AffectedQuantity, Dictionary, Effect, Law, RecordExtent};
use rtec_model::record::{Axis, Record, Role, span};
use std::ops::Range;

/// One response of one record: a stretch of the rows.
#[derive(Debug, Clone)]
pub struct ResponseSegment {
    /// Index of the record.
    pub record: usize,
    /// Index of the response.
    pub response: usize,
    /// Its rows.
    pub rows: Range<usize>,
}

/// All measured rows.
#[derive(Debug)]
pub struct MeasuredRows<'r> {
    /// The records.
    pub records: &'r [Record],
    /// The responses that any of them has.
    pub responses: Vec<Role>,
    /// The segments, response by response and record by record.
    pub segments: Vec<ResponseSegment>,
    /// Number of rows.
    pub n: usize,
    /// The measured values.
    pub measured: Vec<f64>,
}

impl<'r> MeasuredRows<'r> {
    /// The rows of these records.
    #[must_use]
    pub fn new(records: &'r [Record]) -> Self {
        let mut responses: Vec<Role> = Vec::new();
        for column in records.iter().flat_map(Record::responses) {
            if !responses.contains(&column.role) {
                responses.push(column.role.clone());
            }
        }
        let (mut segments, mut measured) = (Vec::new(), Vec::new());
        for (response, role) in responses.iter().enumerate() {
            for (r, record) in records.iter().enumerate() {
                if let Some(column) = record.column(role) {
                    let start = measured.len();
                    measured.extend_from_slice(&column.data);
                    segments.push(ResponseSegment { record: r, response, rows: start..measured.len() });
                }
            }
        }
        Self { records, responses, segments, n: measured.len(), measured }
    }

    /// The record of a segment.
    #[must_use]
    pub fn record(&self, segment: &ResponseSegment) -> &'r Record {
        &self.records[segment.record]
    }

    /// Whether a response is a force.
    #[must_use]
    pub fn is_force(&self, response: usize) -> bool {
        matches!(self.responses[response], Role::Force(_))
    }

    /// Number of rows of a response.
    #[must_use]
    pub fn count(&self, response: usize) -> usize {
        self.segments.iter().filter(|s| s.response == response).map(|s| s.rows.len()).sum()
    }

    /// The basis columns of an effect.
    #[must_use]
    pub fn basis(&self, effect: &Effect) -> Vec<Vec<f64>> {
        self.collect(effect, effect.coefficient_count(), |bound, component, out| {
            bound.basis(effect, component, out);
        })
    }

    /// The share of an axis's error that each row shows.
    /// `None` if no effect is a constant of the axis.
    #[must_use]
    pub fn share(&self, axis: &Axis) -> Option<Vec<f64>> {
        let dictionary = Dictionary::default();
        let law = dictionary
            .laws()
            .map(Law::describe)
            .find(|l| l.constant && l.quantity == AffectedQuantity::Error)?;
        let constant = dictionary.effect(&format!("{}.{axis}", law.name)).ok()?;
        Some(self.basis(&constant).swap_remove(0))
    }

    /// Derivatives of an effect by its values.
    #[must_use]
    pub fn slopes(&self, effect: &Effect) -> Vec<Vec<f64>> {
        self.collect(effect, effect.values().len(), |bound, component, out| {
            bound.slopes(effect, component, out);
        })
    }

    /// The error by an effect at every row.
    #[must_use]
    pub fn predict(&self, effect: &Effect) -> Vec<f64> {
        let mut out = vec![0.0; self.n];
        for (c, column) in effect.coefficients().iter().zip(self.basis(effect)) {
            rtec_least_squares::add(&mut out, *c, &column);
        }
        out
    }

    fn collect(
        &self,
        effect: &Effect,
        k: usize,
        fill: impl Fn(&rtec_model::effect::EffectInputColumns<'_>, usize, &mut [f64]),
    ) -> Vec<Vec<f64>> {
        let mut out: Vec<Vec<f64>> = (0..k).map(|_| vec![0.0; self.n]).collect();
        let mut buffer = Vec::new();
        for s in &self.segments {
            let record = self.record(s);
            if !is_placed(record, effect) {
                continue;
            }
            let acts = effect.acts_on(record);
            let role = &self.responses[s.response];
            let (Some((_, component)), Ok(bound)) =
                (acts.iter().find(|(r, _)| r == role), effect.bind(record))
            else {
                continue;
            };
            let rows = record.rows();
            if let [only] = &mut out[..] {
                fill(&bound, *component, &mut only[s.rows.clone()]);
                continue;
            }
            buffer.clear();
            buffer.resize(rows * k, 0.0);
            fill(&bound, *component, &mut buffer);
            for (column, part) in out.iter_mut().zip(buffer.chunks(rows)) {
                column[s.rows.clone()].copy_from_slice(part);
            }
        }
        out
    }
}

/// Whether an effect depends on the position along its axis.
/// A circle of unknown centre cannot show such an effect.
#[must_use]
pub fn needs_place(effect: &Effect) -> bool {
    use rtec_model::effect::RequiredInput;
    let law = effect.description();
    let places = law.needs.iter().filter(|n| matches!(n, RequiredInput::Position(_))).count();
    let line = law.needs.len() == 1
        && law.searched.wave.is_none()
        && law.place(rtec_model::effect::ParameterFitMethod::Amplitude).is_none()
        && effect.constraints().is_empty();
    places > 0 && !line && !law.after_turn
}

/// Whether a record has the positions that an effect needs.
#[must_use]
pub fn is_placed(record: &Record, effect: &Effect) -> bool {
    record.knows_places() || !needs_place(effect)
}

impl RecordExtent for MeasuredRows<'_> {
    fn rows(&self) -> usize {
        self.n
    }

    /// Time constants from two rows to twice the longest record, in equal ratios.
    fn time_constants_s(&self) -> Vec<f64> {
        let span = |t: &[f64]| t.last().zip(t.first()).map_or(0.0, |(b, a)| b - a);
        let longest = self
            .records
            .iter()
            .map(|r| (span(r.time_s()), r.rows()))
            .fold((0.0, 1), |a, b| if b.0 > a.0 { b } else { a });
        if longest.0 <= 0.0 {
            return Vec::new();
        }
        let lo = (longest.0 / longest.1 as f64 * 2.0).max(longest.0 / 300.0);
        let hi = longest.0 * 2.0;
        (0..TIME_CONSTANTS).map(|i| lo * (hi / lo).powf(i as f64 / (TIME_CONSTANTS - 1) as f64)).collect()
    }

    fn moments_s(&self) -> Vec<f64> {
        let mut times: Vec<f64> = self.records.iter().flat_map(|r| r.time_s().iter().copied()).collect();
        times.sort_by(f64::total_cmp);
        times.dedup();
        let cut = 3.min(times.len() / 2);
        times[cut..times.len() - cut].to_vec()
    }

    fn places_mm(&self, axis: &Axis) -> Vec<f64> {
        let role = Role::Position(axis.clone());
        let placed = self.records.iter().filter(|r| r.knows_places());
        let read: Vec<(bool, &[f64])> =
            placed.filter_map(|r| Some((r.zero.is_some(), r.data(&role)?))).collect();
        let [lo, hi] = span(read.iter().flat_map(|r| r.1));
        let close = (hi - lo) * ONE_PLACE;
        // Of a record at rest only its own zero is seen, not what differs from place to place.
        let moves = |p: &[f64]| {
            let [lo, hi] = span(p);
            hi - lo > close
        };
        let shows = read.iter().filter(|(shared_zero, p)| *shared_zero || moves(p));
        let mut all: Vec<f64> = shows.flat_map(|r| r.1).copied().collect();
        all.sort_by(f64::total_cmp);
        let mut out: Vec<(f64, f64)> = Vec::new();
        for x in all {
            match out.last_mut() {
                Some((sum, count)) if x - *sum / *count <= close => {
                    *sum += x;
                    *count += 1.0;
                }
                _ => out.push((x, 1.0)),
            }
        }
        out.into_iter().map(|(s, c)| s / c).collect()
    }

    fn travel_mm(&self, axis: &Axis) -> f64 {
        let role = Role::Position(axis.clone());
        let travel = |p: &[f64]| {
            let [lo, hi] = span(p);
            hi - lo
        };
        self.records.iter().filter_map(|r| r.data(&role)).map(travel).fold(0.0, f64::max)
    }
}

/// The noise of each response, and the weight of each row.
/// Noise has a size and an autocorrelation from row to row.
#[derive(Debug, Clone, PartialEq)]
pub struct ResponseNoise {
    /// Size of the new noise at each row, per response, in its unit.
    pub sigma: Vec<f64>,
    /// Autocorrelation from row to row, per segment.
    pub phi: Vec<f64>,
    /// Size of each segment's noise relative to its response's (another day or gauge).
    pub share: Vec<f64>,
    /// Root of each row's weight: below one for outliers.
    pub weight: Vec<f64>,
}

impl ResponseNoise {
    /// White noise of one size in all rows of all responses.
    #[must_use]
    pub fn white(rows: &MeasuredRows<'_>, sigma: f64) -> Self {
        let count = rows.responses.len();
        Self {
            sigma: vec![sigma; count],
            phi: vec![0.0; rows.segments.len()],
            share: vec![1.0; rows.segments.len()],
            weight: vec![1.0; rows.n],
        }
    }

    /// First guess of the noise, from the residual after the model.
    /// It uses the steps from row to row and the largest autocorrelation of noise.
    #[must_use]
    pub fn guess(rows: &MeasuredRows<'_>, left: &[f64]) -> Self {
        let (mut sigma, mut phi) = (Vec::new(), vec![0.0; rows.segments.len()]);
        for j in 0..rows.responses.len() {
            let (mut all, mut with, mut steps, mut n) = (0.0, 0.0, 0.0, 0.0);
            for s in rows.segments.iter().filter(|s| s.response == j) {
                let part = &left[s.rows.clone()];
                let mean = part.iter().sum::<f64>() / part.len().max(1) as f64;
                all += part.iter().map(|x| (x - mean).powi(2)).sum::<f64>();
                with += part.windows(2).map(|w| (w[0] - mean) * (w[1] - mean)).sum::<f64>();
                steps += part.windows(2).map(|w| (w[1] - w[0]).powi(2)).sum::<f64>();
                n += part.len() as f64;
            }
            let memory = (with / all.max(1e-300)).clamp(0.0, MOST_PHI);
            let size = (all / n.max(1.0)).sqrt();
            let own = (steps / n.max(1.0) / (2.0 * (1.0 - memory).max(0.1))).sqrt()
                * (1.0 - memory * memory).sqrt();
            rows.segments
                .iter()
                .zip(&mut phi)
                .filter(|(s, _)| s.response == j)
                .for_each(|(_, p)| *p = memory);
            sigma.push(own.min(size).max(1e-3 * size).max(1e-9));
        }
        Self { sigma, phi, share: vec![1.0; rows.segments.len()], weight: vec![1.0; rows.n] }
    }

    /// Updates the sizes of the noise from the squares of each segment's new noise.
    /// The squares are in the response's unit.
    /// A segment's size has an inverse gamma prior about its response's size, so that size is the harmonic
    /// mean of its segments.
    pub fn resize(&mut self, rows: &MeasuredRows<'_>, squares: &[f64]) {
        for (j, sigma) in self.sigma.iter_mut().enumerate() {
            let own: Vec<usize> =
                (0..rows.segments.len()).filter(|s| rows.segments[*s].response == j).collect();
            let n = |s: usize| rows.segments[s].rows.len() as f64;
            let mean = own.iter().map(|s| squares[*s]).sum::<f64>() / rows.count(j).max(1) as f64;
            let mut variance = mean.max(1e-18);
            let size = |s: usize, all: f64| (squares[s] + ALIKE_ROWS * all) / (n(s) + ALIKE_ROWS);
            for _ in 0..SIZE_STEPS {
                let inverse: f64 = own.iter().map(|s| size(*s, variance).recip()).sum();
                variance = own.len() as f64 / inverse;
            }
            *sigma = variance.sqrt();
            for s in own {
                self.share[s] = (size(s, variance) / variance).sqrt();
            }
        }
    }

    /// Raises each segment's noise, with its autocorrelation, to at least this, µm.
    pub fn at_least(&mut self, rows: &MeasuredRows<'_>, um: &[f64]) {
        for (number, least) in um.iter().enumerate() {
            let size = self.size(rows, number) / (1.0 - self.phi[number].powi(2)).sqrt();
            if size < *least {
                self.share[number] *= least / size;
            }
        }
    }

    /// Standard deviation of the new noise at each row of a segment.
    #[must_use]
    pub fn size(&self, rows: &MeasuredRows<'_>, segment: usize) -> f64 {
        self.sigma[rows.segments[segment].response] * self.share[segment]
    }

    /// The same steps from row to row without autocorrelation.
    /// `None` if there is little of it.
    #[must_use]
    pub fn without_memory(&self) -> Option<Self> {
        if self.phi.iter().all(|phi| *phi < MUCH_MEMORY) {
            return None;
        }
        let mut other = self.clone();
        for (share, phi) in other.share.iter_mut().zip(&mut other.phi) {
            *share *= ((1.0 - *phi) / (1.0 - *phi * *phi)).sqrt();
            *phi = 0.0;
        }
        Some(other)
    }

    /// Divides a column by the noise, which then has unit size and no correlation.
    pub fn whiten(&self, rows: &MeasuredRows<'_>, column: &mut [f64]) {
        for (number, s) in rows.segments.iter().enumerate() {
            let (by, phi) = (1.0 / self.size(rows, number), self.phi[number]);
            let part = &mut column[s.rows.clone()];
            let weight = &self.weight[s.rows.clone()];
            let mut before = 0.0;
            let first = (1.0 - phi * phi).sqrt();
            for (i, (x, w)) in part.iter_mut().zip(weight).enumerate() {
                let now = *x;
                let new = if i == 0 { first * now } else { now - phi * before };
                *x = new * by * w;
                before = now;
            }
        }
    }

    /// The transpose of [`ResponseNoise::whiten`].
    /// The product of a whitened column with `column` is that of the column with the result.
    pub fn transpose(&self, rows: &MeasuredRows<'_>, column: &mut [f64]) {
        for (number, s) in rows.segments.iter().enumerate() {
            let (by, phi) = (1.0 / self.size(rows, number), self.phi[number]);
            let part = &mut column[s.rows.clone()];
            let weight = &self.weight[s.rows.clone()];
            let first = (1.0 - phi * phi).sqrt();
            for i in 0..part.len() {
                let own = part[i] * weight[i] * by * if i == 0 { first } else { 1.0 };
                let next = part.get(i + 1).map_or(0.0, |x| x * weight[i + 1] * by);
                part[i] = own - phi * next;
            }
        }
    }

    /// Log prior of the noise's sizes, up to a constant.
    #[must_use]
    pub fn log_prior(&self, rows: &MeasuredRows<'_>) -> f64 {
        let [middle, factor] = NOISE;
        let of = |(j, sigma): (usize, &f64)| {
            let phi = self.mean_phi(rows, j);
            let size = sigma / (1.0 - phi * phi).sqrt();
            -0.5 * ((size / middle).ln() / factor.ln()).powi(2) - 0.5 * (2.0 * phi / MOST_PHI).powi(2)
        };
        let apart = |share: &f64| -0.5 * ALIKE_ROWS * (2.0 * share.ln() + share.powi(-2) - 1.0);
        let differs = |(s, phi): (&ResponseSegment, &f64)| {
            -0.5 * (2.0 * (phi - self.mean_phi(rows, s.response)) / MOST_PHI).powi(2)
        };
        self.sigma.iter().enumerate().map(of).sum::<f64>()
            + self.share.iter().map(apart).sum::<f64>()
            + rows.segments.iter().zip(&self.phi).map(differs).sum::<f64>()
    }

    /// Autocorrelation of a response: the mean of its segments, by their rows.
    fn mean_phi(&self, rows: &MeasuredRows<'_>, response: usize) -> f64 {
        let own = || rows.segments.iter().zip(&self.phi).filter(|(s, _)| s.response == response);
        own().map(|(s, phi)| s.rows.len() as f64 * phi).sum::<f64>() / rows.count(response).max(1) as f64
    }

    /// Standard deviation of a response's noise over all its rows.
    /// It includes the part that the autocorrelation adds.
    #[must_use]
    pub fn scatter(&self, rows: &MeasuredRows<'_>, response: usize) -> f64 {
        let own = rows.segments.iter().enumerate().filter(|(_, s)| s.response == response);
        let squares = own.map(|(number, s)| {
            let (size, phi) = (self.size(rows, number), self.phi[number]);
            s.rows.len() as f64 * size * size / (1.0 - phi * phi)
        });
        (squares.sum::<f64>() / rows.count(response).max(1) as f64).sqrt()
    }

    /// log of the density's Jacobian: Σ log(w/σ) + ½ Σ log(1 − φ²).
    #[must_use]
    pub fn log_scale(&self, rows: &MeasuredRows<'_>) -> f64 {
        rows.segments
            .iter()
            .enumerate()
            .map(|(number, s)| {
                let (sigma, phi) = (self.size(rows, number), self.phi[number]);
                let weights: f64 = self.weight[s.rows.clone()].iter().map(|w| w.ln()).sum();
                weights - (s.rows.len() as f64) * sigma.ln() + 0.5 * (1.0 - phi * phi).ln()
            })
            .sum()
    }
}
