//! The measurement model y = M(θ) + Z(η) + H(β, ψ) + e, linear in all but ψ.
//! This module holds everything but the hypotheses.

use crate::priors::{CHANCE, KNOWN_SHARE, MOST_PHI, NOISE, PERIOD_SHARE, TAILS};
use crate::rows_and_noise::{MeasuredRows, ResponseNoise, ResponseSegment};
use crate::search_limits::{OUT_OF_STEP, ROUNDING_STEPS};
use crate::set_up_terms::{self, SetUpTerm};
use rtec_least_squares::{QrFactor, add, dot};
use rtec_model::effect::{Effect, ParameterFitMethod, ParameterRefinement};
use rtec_model::record::rounding_error;
use statrs::distribution::{ChiSquared, ContinuousCDF as _};

/// A direction in which a known effect may deviate a little.
#[derive(Debug, Clone)]
pub struct KnownEffectDeviation {
    /// Index of the effect in the model.
    pub effect: usize,
    /// Indices of the values that move, each with its change at one standard deviation.
    pub along: Vec<(usize, f64)>,
    /// Change of the rows at one standard deviation.
    pub column: Vec<f64>,
}

/// Deviations of the model's known effects.
/// Amplitudes, phases and time constants are known to some per cent, periods as given.
#[must_use]
pub fn known(
    rows: &MeasuredRows<'_>,
    model: &[Effect],
    intervals: &[Vec<Option<f64>>],
) -> Vec<KnownEffectDeviation> {
    let mut out = Vec::new();
    for (e, effect) in model.iter().enumerate() {
        let law = effect.description();
        let width = effect.width();
        if !effect.constraints().is_empty() {
            let Some(p) = law.place(ParameterFitMethod::Linear) else { continue };
            let along = (0..width).map(|i| (p * width + i, KNOWN_SHARE * effect.get(p)[i])).collect();
            let mut column = rows.predict(effect);
            for x in &mut column {
                *x *= KNOWN_SHARE;
            }
            out.push(KnownEffectDeviation { effect: e, along, column });
            continue;
        }
        let slopes = rows.slopes(effect);
        for (i, p) in law.parameters.iter().enumerate() {
            for (v, slope) in slopes.iter().enumerate().take((i + 1) * width).skip(i * width) {
                let value = effect.values()[v];
                let stated = intervals.get(e).and_then(|i| i.get(v).copied().flatten());
                let share = match (p.search, p.refine) {
                    (ParameterFitMethod::Chosen, _)
                    | (ParameterFitMethod::Smooth, ParameterRefinement::Stays) => 0.0,
                    (ParameterFitMethod::Phase, _) | (_, ParameterRefinement::Step(_)) => KNOWN_SHARE,
                    _ => KNOWN_SHARE * value.abs(),
                };
                let sd = stated.map_or(share, |half| half / rtec_model::machine::NORMAL_95);
                if sd > 0.0 {
                    let column = slope.iter().map(|x| x * sd).collect();
                    out.push(KnownEffectDeviation { effect: e, along: vec![(v, sd)], column });
                }
            }
        }
        // Over many turns the digits of a period leave an error. The phase in the middle stays.
        if let (Some(t), Some(phase)) = (WaveCycles::of(rows, effect), law.place(ParameterFitMethod::Phase)) {
            let sd = PERIOD_SHARE * effect.scalar(0);
            let turned = std::f64::consts::TAU * PERIOD_SHARE * t.to_middle;
            let mut column = vec![0.0; rows.n];
            add(&mut column, sd, &slopes[0]);
            add(&mut column, turned, &slopes[phase]);
            out.push(KnownEffectDeviation { effect: e, along: vec![(0, sd), (phase, turned)], column });
        }
    }
    out.retain(|k| k.column.iter().any(|x| *x != 0.0));
    out
}

/// Turns of a wave over the positions of the rows.
struct WaveCycles {
    /// Over the whole travel.
    over_travel: f64,
    /// From the axis's zero to the middle of the travel.
    to_middle: f64,
}

impl WaveCycles {
    /// The turns of a wave of the model.
    fn of(rows: &MeasuredRows<'_>, wave: &Effect) -> Option<Self> {
        let facts = wave.description().searched.wave?;
        let places = rtec_model::effect::RecordExtent::places_mm(rows, wave.axes().first()?);
        let (lo, hi) = (places.first()?, places.last()?);
        let period_mm = wave.scalar(0) * facts.unit_mm;
        Some(Self { over_travel: (hi - lo) / period_mm, to_middle: 0.5 * (lo + hi) / period_mm })
    }
}

/// Waves of the model with their periods corrected by the rows.
/// Over many turns a period of four digits is out of step.
#[must_use]
pub fn with_corrected_periods(rows: &MeasuredRows<'_>, model: &[Effect]) -> Vec<Effect> {
    let mut model = model.to_vec();
    for e in 0..model.len() {
        let effect = &model[e];
        let Some(turns) = WaveCycles::of(rows, effect) else { continue };
        let (period, off) = (effect.scalar(0), turns.over_travel * PERIOD_SHARE);
        if off < OUT_OF_STEP {
            continue;
        }
        let others: Vec<Effect> =
            model.iter().enumerate().filter(|(i, _)| *i != e).map(|(_, m)| m.clone()).collect();
        let problem = EstimationProblem::new(rows, &others, &[]);
        let base = problem.base(problem.first_noise());
        let steps = (3.0 * off / (0.5 * OUT_OF_STEP)).ceil().min(300.0) as i32;
        let mut best: Option<(f64, Effect)> = None;
        let mut as_given = 0.0;
        for k in -steps..=steps {
            let sds = 3.0 * f64::from(k) / f64::from(steps);
            let Some(tried) = effect.with(&[(0, period * (1.0 + sds * PERIOD_SHARE))]) else { continue };
            let mut columns = rows.basis(&tried);
            for c in &mut columns {
                base.noise.whiten(rows, c);
            }
            let gain = columns_gain(&base.factor, &columns, base.freedom) - 0.5 * sds * sds;
            if k == 0 {
                as_given = gain;
            }
            if best.as_ref().is_none_or(|b| gain > b.0) {
                best = Some((gain, tried));
            }
        }
        if let Some((_, tried)) = best.filter(|b| is_beyond_chance(2.0 * (b.0 - as_given), 1)) {
            // Phase and period belong together: the phase is that of the rows.
            let mut factor = base.factor.clone();
            for c in rows.basis(&tried) {
                let mut c: Vec<f64> = c.iter().map(|x| x * 100.0).collect();
                base.noise.whiten(rows, &mut c);
                factor.push(&c);
            }
            let beta = factor.solve();
            let own: Vec<f64> = beta[base.factor.len()..].iter().map(|b| b * 100.0).collect();
            let mut fitted = tried.clone();
            fitted.set_coefficients(&own);
            if let Some(p) = effect.description().place(ParameterFitMethod::Phase) {
                let um = effect
                    .description()
                    .place(ParameterFitMethod::Amplitude)
                    .map_or(0.0, |a| effect.scalar(a));
                let turn = if um < 0.0 { std::f64::consts::PI } else { 0.0 };
                model[e] = tried.with(&[(p, fitted.scalar(p) + turn)]).unwrap_or_else(|| effect.clone());
            }
        }
    }
    model
}

/// Log likelihood gained by columns of any size.
fn columns_gain(factor: &QrFactor, columns: &[Vec<f64>], freedom: f64) -> f64 {
    let mut with = factor.clone();
    for c in columns {
        with.push(&c.iter().map(|x| x * 30.0).collect::<Vec<_>>());
    }
    0.5 * freedom * (factor.left() / with.left().max(1e-300)).ln()
}

/// Probability that chance alone puts several parameters so far from zero.
/// The squared distance is in standard deviations.
#[must_use]
pub fn chance_of(distance: f64, parameters: usize) -> f64 {
    ChiSquared::new(parameters as f64).map_or(1.0, |chance| chance.sf(distance.max(0.0)))
}

/// Whether a squared distance of several parameters is beyond chance.
#[must_use]
pub fn is_beyond_chance(distance: f64, parameters: usize) -> bool {
    chance_of(distance, parameters) < CHANCE
}

/// Whether a unit is in question.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum UnitAssumption {
    /// The unit is what the record states.
    AsWritten,
    /// Set-up terms do not prefer one unit to another, of a response or of time.
    /// Relative to the noise, zero, centre and line have the size that they have with a usual noise. A line
    /// has its largest size, whatever the run's length. Air has no influence.
    Any,
}

/// Everything except the hypotheses, whitened by one noise.
pub struct WhitenedBaseline {
    /// The noise by which it is whitened.
    pub noise: ResponseNoise,
    /// Set-up terms, then known effects.
    pub factor: QrFactor,
    /// Degrees of freedom of the rows, with all of this fitted.
    pub freedom: f64,
}

/// The rows, the model's known effects and the set-up terms.
pub struct EstimationProblem<'r> {
    /// The rows.
    pub rows: &'r MeasuredRows<'r>,
    /// Measured minus simulated by the model as given.
    pub missing: Vec<f64>,
    /// The set-up terms.
    pub terms: Vec<SetUpTerm>,
    /// The known effects.
    pub known: Vec<KnownEffectDeviation>,
    /// Smallest size of the noise, per segment.
    pub floors: Vec<f64>,
    /// Root of each row's weight, before outliers are weighted down.
    pub weights: Vec<f64>,
    /// RMS of the gauge's rounding error, per segment, µm.
    /// No reading in the file is finer than this.
    pub rounding_um: Vec<f64>,
}

impl<'r> EstimationProblem<'r> {
    /// The problem of rows that a gauge read, with a model.
    /// `intervals` are the half widths that the model states, value by value.
    #[must_use]
    pub fn new(rows: &'r MeasuredRows<'r>, model: &[Effect], intervals: &[Vec<Option<f64>>]) -> Self {
        let mut problem = Self {
            floors: set_up_terms::floors(rows),
            weights: set_up_terms::weights(rows),
            ..Self::with_terms(rows, model, intervals, set_up_terms::terms(rows, model))
        };
        problem.take_rounding_out();
        problem
    }

    /// The same for computed rows, which no gauge has rounded.
    #[must_use]
    pub fn unrounded(rows: &'r MeasuredRows<'r>, model: &[Effect], intervals: &[Vec<Option<f64>>]) -> Self {
        let mut terms = set_up_terms::terms(rows, model);
        terms.retain(|t| t.what != set_up_terms::SetUpTermKind::Rounding);
        Self::with_terms(rows, model, intervals, terms)
    }

    fn with_terms(
        rows: &'r MeasuredRows<'r>,
        model: &[Effect],
        intervals: &[Vec<Option<f64>>],
        terms: Vec<SetUpTerm>,
    ) -> Self {
        let mut missing = rows.measured.clone();
        for effect in model {
            add(&mut missing, -1.0, &rows.predict(effect));
        }
        Self {
            rows,
            missing,
            terms,
            known: known(rows, model, intervals),
            floors: vec![0.0; rows.segments.len()],
            weights: vec![1.0; rows.n],
            rounding_um: vec![0.0; rows.segments.len()],
        }
    }

    /// Removes the rounding error of a coarse gauge that noise does not dither.
    /// Equal readings round alike, so the error is a sawtooth over the reading and not a finding. Model and
    /// set-up predict the readings. If the prediction is bad, the sawtooth averages out and nothing is
    /// removed.
    fn take_rounding_out(&mut self) {
        let steps: Vec<Option<f64>> = self
            .rows
            .segments
            .iter()
            .map(|s| set_up_terms::step_of(&self.rows.measured[s.rows.clone()]))
            .collect();
        if steps.iter().all(Option::is_none) {
            return;
        }
        self.rounding_um = steps.iter().map(|q| q.unwrap_or(0.0) / 12f64.sqrt()).collect();
        let as_read = self.missing.clone();
        for _ in 0..ROUNDING_STEPS {
            let factor = self.base(ResponseNoise::white(self.rows, 1.0)).factor;
            let mut taken = vec![0.0; self.rows.n];
            for (s, q) in self.rows.segments.iter().zip(&steps) {
                let Some(q) = *q else { continue };
                let own = s.rows.clone();
                // Residual of the unchanged readings, with the same prediction.
                let left = |row: usize| factor.residual()[row] + as_read[row] - self.missing[row];
                let square = own.clone().map(|row| left(row).powi(2)).sum::<f64>() / own.len() as f64;
                let rounding = q * q / 12.0;
                for row in own.clone() {
                    let leverage: f64 = factor.columns().iter().map(|c| c[row] * c[row]).sum();
                    let variance = (square - rounding).max(0.0) + leverage.min(1.0) * square;
                    let read = self.rows.measured[row];
                    let off = read - left(row) - self.rows.measured[own.start];
                    taken[row] = rounding_error(q, off, variance);
                }
            }
            self.missing.clone_from(&as_read);
            add(&mut self.missing, -1.0, &taken);
        }
    }

    /// The same problem with only those terms of the set-up that are set by hand.
    /// Lines and jumps in time are then part of what a record shows.
    #[must_use]
    pub fn by_hand(mut self) -> Self {
        use set_up_terms::SetUpTermKind::{CentreFirst, CentreSecond, Unplaced, Zero};
        self.terms.retain(|t| matches!(t.what, Zero | CentreFirst | CentreSecond | Unplaced));
        self
    }

    /// The same problem with units in question, or not.
    #[must_use]
    pub fn in_units(mut self, units: UnitAssumption) -> Self {
        use set_up_terms::SetUpTermKind::{Air, CentreFirst, CentreSecond, Line, Zero};
        if units == UnitAssumption::AsWritten {
            return self;
        }
        let noise = self.first_noise();
        self.terms.retain(|t| t.what != Air);
        for t in &mut self.terms {
            let row = t.column.iter().position(|x| *x != 0.0).unwrap_or(0);
            let segment = self.rows.segments.iter().find(|s| s.rows.contains(&row));
            if let (Zero | CentreFirst | CentreSecond | Line, Some(s)) = (t.what, segment) {
                if t.what == Line {
                    t.sd = set_up_terms::longest_creep(&t.column);
                }
                t.sd *= noise.sigma[s.response] / NOISE[0];
            }
        }
        self
    }

    /// Set-up terms and known effects, whitened by a noise.
    #[must_use]
    pub fn base(&self, noise: ResponseNoise) -> WhitenedBaseline {
        let whiten = |column: &[f64], by: f64| {
            let mut c: Vec<f64> = column.iter().map(|x| x * by).collect();
            noise.whiten(self.rows, &mut c);
            c
        };
        let mut factor = QrFactor::new(&whiten(&self.missing, 1.0));
        for t in &self.terms {
            factor.push(&whiten(&t.column, t.sd));
        }
        for k in &self.known {
            factor.push(&whiten(&k.column, 1.0));
        }
        let freedom = (self.rows.n as f64 - factor.freedom()).max(2.0);
        WhitenedBaseline { noise, factor, freedom }
    }

    /// First guess of the noise, from the residual after set-up and model.
    #[must_use]
    pub fn first_noise(&self) -> ResponseNoise {
        let mut left = self.base(ResponseNoise::white(self.rows, 1e-3)).factor.residual().to_vec();
        for x in &mut left {
            *x *= 1e-3;
        }
        let mut noise = ResponseNoise::guess(self.rows, &left);
        let segments = &self.rows.segments;
        let steps =
            |s: &ResponseSegment| left[s.rows.clone()].windows(2).map(|w| (w[1] - w[0]).powi(2)).sum();
        let steps: Vec<f64> = segments.iter().map(steps).collect();
        // The steps divide the response's squares among its segments.
        let squares = |(s, own): (&ResponseSegment, &f64)| {
            let all: f64 =
                segments.iter().zip(&steps).filter(|o| o.0.response == s.response).map(|o| o.1).sum();
            let share =
                if all > 0.0 { own / all } else { s.rows.len() as f64 / self.rows.count(s.response) as f64 };
            noise.sigma[s.response].powi(2) * self.rows.count(s.response) as f64 * share
        };
        let squares: Vec<f64> = segments.iter().zip(&steps).map(squares).collect();
        noise.resize(self.rows, &squares);
        noise.phi.iter_mut().zip(&self.floors).filter(|(_, f)| **f > 0.0).for_each(|(p, _)| *p = 0.0);
        noise.at_least(self.rows, &self.floors);
        noise.at_least(self.rows, &self.rounding_um);
        noise.weight.clone_from(&self.weights);
        noise
    }

    /// Log of the density's normalisation under a noise.
    /// It is Σ log(w/σ) + ½ Σ log(1 − φ²), plus the cost of rows in the tails. A weight w² contributes
    /// ½ w²e² − log w per row. The density with that weight is (m/2) log((ν + e²)/m) plus a constant, with
    /// m = ν + (start of the tails)². The difference must be added: otherwise an outlier would cost almost
    /// nothing, and the set that gives up most rows would win.
    #[must_use]
    pub fn log_scale(&self, noise: &ResponseNoise) -> f64 {
        let (freedom, from) = TAILS;
        let most = freedom + from * from;
        let tail = |(w, own): (&f64, &f64)| {
            let less = w / own;
            own * own * (most * less.ln() + 0.5 * freedom * (1.0 - less * less)) - less.ln()
        };
        noise.log_scale(self.rows) + noise.weight.iter().zip(&self.weights).map(tail).sum::<f64>()
    }

    /// The noise estimated from a fit's residual.
    /// One step of expectation and maximisation.
    #[must_use]
    pub fn renewed(&self, noise: &ResponseNoise, factor: &QrFactor) -> ResponseNoise {
        let rows = self.rows;
        let e = factor.residual();
        let mut new = noise.clone();
        let mut of_segments = vec![0.0; rows.segments.len()];
        let mut of_leverage = vec![0.0; rows.segments.len()];
        for j in 0..rows.responses.len() {
            let segments: Vec<_> =
                rows.segments.iter().enumerate().filter(|(_, s)| s.response == j).collect();
            let n: f64 = segments.iter().map(|(_, s)| s.rows.len() as f64).sum();
            if n < 1.0 {
                continue;
            }
            let mut squares = 0.0;
            let mut leverage = 0.0;
            let mut sizes = Vec::new();
            for (number, s) in &segments {
                let part = &e[s.rows.clone()];
                sizes.extend(part.iter().zip(&noise.weight[s.rows.clone()]).map(|(x, w)| (x / w).abs()));
                let taken = factor.columns().iter().map(|q| dot(&q[s.rows.clone()], &q[s.rows.clone()]));
                let (own, taken) = (dot(part, part), taken.sum::<f64>());
                of_leverage[*number] = taken;
                of_segments[*number] =
                    (own + taken.min(0.9 * s.rows.len() as f64)) * noise.size(rows, *number).powi(2);
                squares += own;
                leverage += taken;
            }
            leverage = leverage.min(0.9 * n);
            let scale = ((squares + leverage) / n).sqrt().clamp(1e-3, 1e3);
            // Robust size of the middle of the rows, for their weights.
            sizes.sort_by(f64::total_cmp);
            let middle = (1.4826 * sizes[sizes.len() / 2]).max(0.3 * scale).max(1e-9);
            let mut phis = Vec::new();
            for (number, s) in &segments {
                let (sigma, phi) = (noise.size(rows, *number), noise.phi[*number]);
                let mut raw = Vec::with_capacity(s.rows.len());
                let mut before = 0.0;
                for (i, row) in s.rows.clone().enumerate() {
                    let step = e[row] / noise.weight[row] * sigma;
                    let now = if i == 0 { step / (1.0 - phi * phi).sqrt() } else { step + phi * before };
                    let limit = 4.0 * middle * sigma / (1.0 - phi * phi).sqrt();
                    raw.push(now.clamp(-limit, limit));
                    before = now;
                }
                let with: f64 = raw.windows(2).map(|w| w[0] * w[1]).sum();
                let own = s.rows.len() as f64;
                let taken = of_leverage[*number].min(0.9 * own);
                phis.push((own, with / dot(&raw, &raw).max(1e-300) + (taken + 1.0) / own));
                // A reading within its rounding error is not an outlier.
                let middle = middle.max(self.rounding_um[*number].max(self.floors[*number]) / sigma);
                for row in s.rows.clone() {
                    let off = (e[row] / noise.weight[row] / middle).powi(2);
                    let less = (TAILS.0 + TAILS.1 * TAILS.1) / (TAILS.0 + off);
                    new.weight[row] = self.weights[row] * less.min(1.0).sqrt();
                }
            }
            let mean = phis.iter().map(|(n, phi)| n * phi).sum::<f64>() / n;
            // A segment's autocorrelation differs from the response's as much as that differs from none.
            let prior_rows = (2.0 / MOST_PHI).powi(2);
            for ((number, _), (own, phi)) in segments.iter().zip(phis) {
                // The weights account for the steps of a coarse gauge; an autocorrelation would count them twice.
                let most = if self.floors[*number] > 0.0 { 0.0 } else { MOST_PHI };
                new.phi[*number] = ((own * phi + prior_rows * mean) / (own + prior_rows)).clamp(0.0, most);
            }
        }
        new.resize(rows, &of_segments);
        new.at_least(rows, &self.floors);
        new.at_least(rows, &self.rounding_um);
        new
    }
}
