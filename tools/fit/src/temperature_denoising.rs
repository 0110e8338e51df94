//! Removes the sensors' noise and rounding from temperatures.
//! A machine follows the true temperature, which is smooth; its log has noise and quantisation. A law fitted
//! to the log would prefer whatever averages these: a lag, or a pair of sensors.
//!
//! The result is a smooth series near the log (Whittaker, Proc. Edinb. Math. Soc. 41 (1923) 63). Restricted
//! maximum likelihood chooses the smoothness from the sensor's own record. A reading in coarse steps only
//! tells that temperature and noise were within half a step of it; there Laplace's approximation of the
//! likelihood chooses smoothness and noise. A log that jumps stays unchanged.

use rtec_least_squares::BandedFactor;
use rtec_measure::gauge_resolution::step_of;
use rtec_model::record::{Record, Role, median};
use statrs::function::erf::erfc;
use std::f64::consts::{PI, SQRT_2};

/// Fewest rows that allow noise to be separated from changes.
const FEWEST: usize = 12;
/// Largest noise of a machine's sensor, K; a noisier log jumps for another reason.
/// Thermocouples with a long lead scatter by some tenths of a kelvin.
const NOISIEST_K: f64 = 0.5;
/// Largest row-to-row autocorrelation of removed noise.
const ALIKE: f64 = 0.3;
/// Decades of the smoothness penalty.
const DECADES: std::ops::RangeInclusive<i32> = -1..=6;
/// Penalties per decade.
const STEPS: i32 = 2;
/// Noise tried for coarse readings, in steps.
/// Below the first value the result does not change.
const NOISE_IN_STEPS: [f64; 4] = [0.0625, 0.125, 0.25, MOST_IN_STEPS];
/// Noise in steps above which rounding acts as white noise.
const MOST_IN_STEPS: f64 = 0.5;
/// Most Newton steps to the most likely series.
const NEWTON: usize = 40;
/// Change of the criterion that ends them.
const CLOSE: f64 = 1e-3;
/// Most halvings of a Newton step.
const HALVED: usize = 12;

/// The record with the noise removed from each temperature.
#[must_use]
pub fn temperatures(record: &Record) -> Record {
    smoothed(record).0
}

/// The smoothed record, and the uncertainty of its temperatures.
pub(crate) fn smoothed(record: &Record) -> (Record, SmoothingUncertainty) {
    let mut quiet = record.clone();
    let mut spread = Vec::new();
    let time = record.time_s();
    for (at, column) in quiet.columns.iter_mut().enumerate().filter(|(_, c)| c.role == Role::Temperature) {
        if let Some(found) = SmoothedSeries::of(time, &column.data) {
            column.data = found.x;
            spread.push((at, found.factor, found.sd));
        }
    }
    (quiet, SmoothingUncertainty(spread))
}

/// Uncertainty of a record's smoothed temperatures.
/// Per column: index, factor of the precision, and standard deviation of its unit.
pub(crate) struct SmoothingUncertainty(Vec<(usize, BandedFactor, f64)>);

impl SmoothingUncertainty {
    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The n-th random draw of temperatures from their distribution.
    pub(crate) fn draw(&self, smoothed: &Record, n: usize) -> Record {
        let mut drawn = smoothed.clone();
        for (at, factor, sd) in &self.0 {
            let mut seed = (n as u64) << 32 | *at as u64;
            let errors = factor.with_this_precision(|| normal(&mut seed));
            drawn.columns[*at].data.iter_mut().zip(errors).for_each(|(x, e)| *x += sd * e);
        }
        drawn
    }
}

/// A series without its noise.
struct SmoothedSeries {
    x: Vec<f64>,
    /// Factor of the precision, in units of 1/sd².
    factor: BandedFactor,
    sd: f64,
}

impl SmoothedSeries {
    /// `None` if there is no removable noise, or the series is too short.
    /// `t` never decreases.
    fn of(t: &[f64], y: &[f64]) -> Option<Self> {
        let bends = SlopeChanges::of(t, y)?;
        let found = bends.smooth_noisy(y)?;
        let taken: Vec<f64> = y.iter().zip(&found.x).map(|(y, x)| y - x).collect();
        let squares: f64 = taken.iter().map(|e| e * e).sum();
        // If noise is less than a step, what is removed is rounding, which neighbours share.
        let is_rounded = |step: &f64| {
            step / 12f64.sqrt() <= NOISIEST_K && (squares / y.len() as f64).sqrt() < MOST_IN_STEPS * step
        };
        if let Some(step) = step_of(y).filter(is_rounded) {
            return bends.smooth_quantised(y, step);
        }
        // Accept only small noise without row-to-row correlation.
        let with_next: f64 = taken.windows(2).map(|w| w[0] * w[1]).sum();
        let small = squares <= NOISIEST_K * NOISIEST_K * y.len() as f64;
        (small && with_next < ALIKE * squares).then_some(found)
    }
}

/// Changes of slope from row to row, relative to their expected size.
/// The expected size depends on the time between rows.
struct SlopeChanges {
    /// Weights of three consecutive rows.
    rows: Vec<[f64; 3]>,
    n: usize,
}

impl SlopeChanges {
    /// `None` for few rows, rows that share a time, or a constant series.
    fn of(t: &[f64], y: &[f64]) -> Option<Self> {
        let n = y.len();
        if n < FEWEST || t.len() != n || y.iter().all(|v| v.to_bits() == y[0].to_bits()) {
            return None;
        }
        let mut gaps: Vec<f64> = t.windows(2).map(|w| w[1] - w[0]).collect();
        if gaps.iter().any(|g| *g <= 0.0) {
            return None;
        }
        let usual = median(gaps.iter().copied());
        for gap in &mut gaps {
            *gap /= usual;
        }
        let row = |w: &[f64]| {
            let scale = f64::midpoint(w[0], w[1]).sqrt();
            [1.0 / w[0] / scale, -(1.0 / w[0] + 1.0 / w[1]) / scale, 1.0 / w[1] / scale]
        };
        Some(Self { rows: gaps.windows(2).map(row).collect(), n })
    }

    /// The smooth series whose difference from these readings is white noise.
    fn smooth_noisy(&self, y: &[f64]) -> Option<SmoothedSeries> {
        let weight = vec![1.0; self.n];
        let free = self.n as f64 - 2.0;
        let steps = DECADES.start() * STEPS..=DECADES.end() * STEPS;
        let tried = steps.map(|step| {
            let penalty = 10_f64.powf(f64::from(step) / f64::from(STEPS));
            let factor = self.factor(&weight, penalty);
            let x = factor.solve(y.to_vec());
            let left: f64 = y.iter().zip(&x).map(|(y, x)| y * (y - x)).sum();
            let variance = (left / free).max(1e-18);
            // Minus twice the restricted log likelihood, up to a constant.
            let criterion = free * variance.ln() + factor.log_determinant() - free * penalty.ln();
            (criterion, SmoothedSeries { x, factor, sd: variance.sqrt() })
        });
        tried.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, found)| found)
    }

    /// The smooth series whose noisy, rounded values are these readings.
    fn smooth_quantised(&self, y: &[f64], step: f64) -> Option<SmoothedSeries> {
        let cells: Vec<f64> = y.iter().map(|v| (v - y[0]) / step).collect();
        let mut best: Option<(f64, SmoothedSeries)> = None;
        for noise in NOISE_IN_STEPS {
            let mut x = cells.clone();
            for decade in *DECADES.start()..=DECADES.end() + 4 {
                let penalty = 10_f64.powi(decade);
                let (criterion, factor) = self.most_likely(&cells, noise, penalty, &mut x);
                if best.as_ref().is_none_or(|(least, _)| criterion < *least) {
                    let x = x.iter().map(|v| y[0] + v * step).collect();
                    best = Some((criterion, SmoothedSeries { x, factor, sd: step }));
                }
            }
        }
        best.map(|(_, found)| found)
    }

    /// Moves `x` to the most likely series of these readings, in steps of one.
    /// Returns its criterion and precision. The criterion is minus twice Laplace's log likelihood, up to a
    /// constant. Newton steps are halved until they improve it.
    fn most_likely(&self, cells: &[f64], noise: f64, penalty: f64, x: &mut Vec<f64>) -> (f64, BandedFactor) {
        let loss = |x: &[f64]| {
            let rounded: f64 = cells
                .iter()
                .zip(x)
                .map(|(c, x)| QuantisedReadingLikelihood::of(*c, *x, noise).log_likelihood)
                .sum();
            penalty * self.roughness(x) - 2.0 * rounded
        };
        let mut now = loss(x);
        for left in (0..NEWTON).rev() {
            let at: Vec<QuantisedReadingLikelihood> =
                cells.iter().zip(&*x).map(|(c, x)| QuantisedReadingLikelihood::of(*c, *x, noise)).collect();
            let factor = self.factor(&at.iter().map(|c| c.weight).collect::<Vec<_>>(), penalty);
            let aim = factor.solve(at.iter().zip(&*x).map(|(c, x)| c.weight * x + c.slope).collect());
            let part = |share: f64| {
                let tried: Vec<f64> = x.iter().zip(&aim).map(|(x, a)| x + share * (a - x)).collect();
                (loss(&tried), tried)
            };
            let shares = std::iter::successors(Some(1.0), |s| Some(0.5 * s)).take(HALVED);
            let better = shares.map(part).find(|(next, _)| now - next > CLOSE);
            let Some((next, moved)) = better.filter(|_| left > 0) else {
                let free = self.n as f64 - 2.0;
                return (now + factor.log_determinant() - free * penalty.ln(), factor);
            };
            (now, *x) = (next, moved);
        }
        unreachable!("the last step returns")
    }

    /// Sum of the squared changes of slope.
    fn roughness(&self, x: &[f64]) -> f64 {
        let bend = |([a, b, c], x): (&[f64; 3], &[f64])| (a * x[0] + b * x[1] + c * x[2]).powi(2);
        self.rows.iter().zip(x.windows(3)).map(bend).sum()
    }

    /// Factors weight + penalty·DᵀD.
    fn factor(&self, weight: &[f64], penalty: f64) -> BandedFactor {
        // Bands: the diagonal and two below it.
        let n = self.n;
        let (mut d, mut one, mut two) = (weight.to_vec(), vec![0.0; n], vec![0.0; n]);
        for (i, [a, b, c]) in self.rows.iter().enumerate() {
            d[i] += penalty * a * a;
            d[i + 1] += penalty * b * b;
            d[i + 2] += penalty * c * c;
            one[i + 1] += penalty * a * b;
            one[i + 2] += penalty * b * c;
            two[i + 2] += penalty * a * c;
        }
        BandedFactor::new(d, one, two)
    }
}

/// The next standard normal number of a sequence.
/// (`SplitMix64`; Box and Muller 1958.)
fn normal(state: &mut u64) -> f64 {
    let mut uniform = || {
        *state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = *state;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    };
    let (a, b) = (1.0 - uniform(), uniform());
    (-2.0 * a.ln()).sqrt() * (2.0 * PI * b).cos()
}

/// Likelihood of one step as the reading of a value.
/// The logarithm, its slope and its negative curvature.
struct QuantisedReadingLikelihood {
    log_likelihood: f64,
    slope: f64,
    weight: f64,
}

impl QuantisedReadingLikelihood {
    /// For the reading `cell`, in steps of one, the value `x` and this noise.
    fn of(cell: f64, x: f64, noise: f64) -> Self {
        // Uses symmetry: on this side small differences keep their digits.
        let (off, side) = ((cell - x).abs(), if cell < x { -1.0 } else { 1.0 });
        let (near, far) = ((off - 0.5) / noise, (off + 0.5) / noise);
        let density = |z: f64| (-0.5 * z * z).exp() / (2.0 * PI).sqrt();
        let within = 0.5 * (erfc(near / SQRT_2) - erfc(far / SQRT_2));
        let slope = (density(near) - density(far)) / within;
        let weight = slope * slope + (far * density(far) - near * density(near)) / within;
        let per = noise * noise;
        Self { log_likelihood: within.ln(), slope: side * slope / noise, weight: weight.max(1e-9) / per }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn series(t: &[f64], y: &[f64]) -> Option<Vec<f64>> {
        SmoothedSeries::of(t, y).map(|found| found.x)
    }

    fn noise(mut seed: u64, n: usize) -> Vec<f64> {
        (0..n).map(|_| normal(&mut seed)).collect()
    }

    fn rms(x: impl Iterator<Item = f64>) -> f64 {
        let v: Vec<f64> = x.collect();
        (v.iter().map(|x| x * x).sum::<f64>() / v.len() as f64).sqrt()
    }

    /// Most of 0.01 K of noise is removed, and nothing of the warm-up.
    #[test]
    fn noise_goes_and_the_warm_up_stays() {
        let t: Vec<f64> = (0..300).map(|i| 60.0 * f64::from(i)).collect();
        let truth: Vec<f64> = t.iter().map(|t| 22.0 + 9.0 * (1.0 - (-t / 4000.0).exp())).collect();
        for seed in 1..20 {
            let log: Vec<f64> = truth.iter().zip(noise(seed, 300)).map(|(t, e)| t + 0.01 * e).collect();
            let quiet = series(&t, &log).unwrap();
            let left = rms(quiet.iter().zip(&truth).map(|(a, b)| a - b));
            assert!(left < 0.005, "seed {seed}: {left} K of 0.01 K left");
        }
    }

    /// Uneven times and a kink where the spindle starts: less error than noise.
    #[test]
    fn a_kink_survives() {
        let t: Vec<f64> = (0..200).map(|i| 10.0 * f64::from(i) + if i > 90 { 900.0 } else { 0.0 }).collect();
        let truth: Vec<f64> =
            t.iter().map(|t| if *t < 600.0 { 21.0 } else { 21.0 + 0.004 * (t - 600.0) }).collect();
        let log: Vec<f64> = truth.iter().zip(noise(5, 200)).map(|(t, e)| t + 0.02 * e).collect();
        let quiet = series(&t, &log).unwrap();
        let left = rms(quiet.iter().zip(&truth).map(|(a, b)| a - b));
        assert!(left < 0.014, "{left}");
    }

    /// Rounding to 0.5 K is mostly removed; levels that differ by more stay.
    #[test]
    fn steps_go_and_levels_stay() {
        let t: Vec<f64> = (0..300).map(|i| 60.0 * f64::from(i)).collect();
        let truth: Vec<f64> = t.iter().map(|t| 22.0 + 9.0 * (1.0 - (-t / 4000.0).exp())).collect();
        for (seed, scatter) in [(3, 0.03), (4, 0.1), (5, 0.2)] {
            let log =
                truth.iter().zip(noise(seed, 300)).map(|(t, e)| (2.0 * (t + scatter * e)).round() / 2.0);
            let quiet = series(&t, &log.collect::<Vec<_>>()).unwrap();
            let left = rms(quiet.iter().zip(&truth).map(|(a, b)| a - b));
            assert!(left < 0.06, "{scatter} K: {left} K of 0.144 K left");
        }
        let levels: Vec<f64> = (0..300).map(|i| 20.0 + 5.0 * f64::from(i / 40 % 3)).collect();
        assert_eq!(
            series(&t, &levels).filter(|x| rms(x.iter().zip(&levels).map(|(a, b)| a - b)) > 0.1),
            None
        );
    }

    /// Draws differ from the smoothed series as much as the truth does.
    #[test]
    fn draws_scatter_as_the_truth_does() {
        let t: Vec<f64> = (0..300).map(|i| 60.0 * f64::from(i)).collect();
        let truth: Vec<f64> = t.iter().map(|t| 22.0 + 9.0 * (1.0 - (-t / 4000.0).exp())).collect();
        let (mut off, mut drawn) = (vec![], vec![]);
        for seed in 0..20 {
            let log: Vec<f64> = truth.iter().zip(noise(seed, 300)).map(|(t, e)| t + 0.2 * e).collect();
            let found = SmoothedSeries::of(&t, &log).unwrap();
            off.extend(found.x.iter().zip(&truth).map(|(a, b)| a - b));
            let mut state = seed;
            let errors = found.factor.with_this_precision(|| normal(&mut state));
            drawn.extend(errors.into_iter().map(|e| found.sd * e));
        }
        let (off, drawn) = (rms(off.into_iter()), rms(drawn.into_iter()));
        assert!((0.7..1.5).contains(&(drawn / off)), "{drawn} K drawn, {off} K off");
    }

    /// Temperatures that are independent from row to row show no removable noise.
    #[test]
    fn what_jumps_stays_as_it_is() {
        let t: Vec<f64> = (0..100).map(f64::from).collect();
        let jumps: Vec<f64> = noise(9, 100).iter().map(|e| 25.0 + 5.0 * e).collect();
        assert_eq!(series(&t, &jumps), None);
        assert_eq!((series(&t, &[20.0; 100]), series(&t[..5], &jumps[..5])), (None, None));
    }
}
