//! Removes the sensors' noise from temperatures.
//! A machine grows with the true temperature, which is smooth; its log carries a hundredth of a kelvin of
//! noise. A law fitted to the log would prefer anything that averages that noise: a lag of some seconds, or a
//! pair of sensors.
//!
//! The result is the smoothest series near the log (Whittaker, Proc. Edinb. Math. Soc. 41 (1923) 63).
//! Restricted maximum likelihood decides how near. A log that jumps stays as it is.

use rtec_model::record::{Record, Role};

/// Fewest rows that allow noise to be separated from changes.
const FEWEST: usize = 12;
/// Largest noise of a machine's sensor, K.
/// A log with more jumps for another reason.
const NOISIEST_K: f64 = 0.15;
/// Largest row-to-row autocorrelation of removed noise. Above it, it is not noise.
const ALIKE: f64 = 0.3;
/// Penalties that are tried: powers of ten, and steps within each.
const DECADES: std::ops::RangeInclusive<i32> = -1..=6;
const STEPS: i32 = 2;

/// The record with the noise removed from each temperature.
#[must_use]
pub fn temperatures(record: &Record) -> Record {
    let mut quiet = record.clone();
    let time = record.time_s();
    for column in quiet.columns.iter_mut().filter(|c| c.role == Role::Temperature) {
        if let Some(data) = series(time, &column.data) {
            column.data = data;
        }
    }
    quiet
}

/// One series without its noise. `None` if it has none, or is too short.
/// `t` never decreases.
#[must_use]
pub fn series(t: &[f64], y: &[f64]) -> Option<Vec<f64>> {
    let bends = Bends::of(t, y)?;
    let mut best: Option<(f64, Vec<f64>)> = None;
    for step in DECADES.start() * STEPS..=DECADES.end() * STEPS {
        let penalty = 10_f64.powf(f64::from(step) / f64::from(STEPS));
        let (score, x) = bends.smooth(y, penalty);
        if best.as_ref().is_none_or(|(s, _)| score < *s) {
            best = Some((score, x));
        }
    }
    let (_, x) = best?;
    // Noise is small and uncorrelated from row to row.
    let taken: Vec<f64> = y.iter().zip(&x).map(|(y, x)| y - x).collect();
    let squares: f64 = taken.iter().map(|e| e * e).sum();
    let with_next: f64 = taken.windows(2).map(|w| w[0] * w[1]).sum();
    let small = squares <= NOISIEST_K * NOISIEST_K * y.len() as f64;
    (small && with_next < ALIKE * squares).then_some(x)
}

/// Changes of slope from row to row, each relative to its expected size.
/// The expected size depends on the time between rows.
struct Bends {
    /// Weights of three consecutive rows.
    rows: Vec<[f64; 3]>,
    n: usize,
}

impl Bends {
    /// `None` if there are few rows, if all have one time, or if they never change.
    fn of(t: &[f64], y: &[f64]) -> Option<Self> {
        let n = y.len();
        if n < FEWEST || t.len() != n || y.iter().all(|v| v.to_bits() == y[0].to_bits()) {
            return None;
        }
        let mut gaps: Vec<f64> = t.windows(2).map(|w| w[1] - w[0]).collect();
        if gaps.iter().any(|g| *g <= 0.0) {
            return None;
        }
        let usual = {
            let mut sorted = gaps.clone();
            sorted.sort_by(f64::total_cmp);
            sorted[sorted.len() / 2]
        };
        for gap in &mut gaps {
            *gap /= usual;
        }
        let row = |w: &[f64]| {
            let scale = f64::midpoint(w[0], w[1]).sqrt();
            [1.0 / w[0] / scale, -(1.0 / w[0] + 1.0 / w[1]) / scale, 1.0 / w[1] / scale]
        };
        Some(Self { rows: gaps.windows(2).map(row).collect(), n })
    }

    /// The smoothest series at this penalty, and its criterion.
    /// The criterion is minus twice the restricted log likelihood, up to a constant.
    fn smooth(&self, y: &[f64], penalty: f64) -> (f64, Vec<f64>) {
        // I + penalty·DᵀD: the diagonal and two neighbours, factored as LDLᵀ.
        let n = self.n;
        let (mut d, mut one, mut two) = (vec![1.0; n], vec![0.0; n], vec![0.0; n]);
        for (i, [a, b, c]) in self.rows.iter().enumerate() {
            d[i] += penalty * a * a;
            d[i + 1] += penalty * b * b;
            d[i + 2] += penalty * c * c;
            one[i + 1] += penalty * a * b;
            one[i + 2] += penalty * b * c;
            two[i + 2] += penalty * a * c;
        }
        let mut log_size = 0.0;
        let mut x = y.to_vec();
        for i in 0..n {
            if i >= 2 {
                two[i] /= d[i - 2];
                one[i] -= two[i] * one[i - 1] * d[i - 2];
                d[i] -= two[i] * two[i] * d[i - 2];
                x[i] -= two[i] * x[i - 2];
            }
            if i >= 1 {
                one[i] /= d[i - 1];
                d[i] -= one[i] * one[i] * d[i - 1];
                x[i] -= one[i] * x[i - 1];
            }
            log_size += d[i].ln();
        }
        for (x, d) in x.iter_mut().zip(&d) {
            *x /= d;
        }
        for i in (0..n).rev() {
            if i + 1 < n {
                x[i] -= one[i + 1] * x[i + 1];
            }
            if i + 2 < n {
                x[i] -= two[i + 2] * x[i + 2];
            }
        }
        let free = n as f64 - 2.0;
        let left: f64 = y.iter().zip(&x).map(|(y, x)| y * (y - x)).sum();
        let variance = (left / free).max(1e-18);
        (free * variance.ln() + log_size - free * penalty.ln(), x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(seed: u64, n: usize) -> Vec<f64> {
        let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
        let mut uniform = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            state as f64 / u64::MAX as f64
        };
        (0..n).map(|_| (0..12).map(|_| uniform()).sum::<f64>() - 6.0).collect()
    }

    fn rms(x: impl Iterator<Item = f64>) -> f64 {
        let v: Vec<f64> = x.collect();
        (v.iter().map(|x| x * x).sum::<f64>() / v.len() as f64).sqrt()
    }

    /// A warm-up with a hundredth of a kelvin of noise.
    /// Most of the noise is removed, and nothing of the warm-up.
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

    /// Rows at uneven times, and a kink where the spindle is switched.
    /// The change is not larger than the noise was.
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

    /// Temperatures that are independent from row to row show no removable noise.
    #[test]
    fn what_jumps_stays_as_it_is() {
        let t: Vec<f64> = (0..100).map(f64::from).collect();
        let jumps: Vec<f64> = noise(9, 100).iter().map(|e| 25.0 + 5.0 * e).collect();
        assert_eq!(series(&t, &jumps), None);
        assert_eq!((series(&t, &[20.0; 100]), series(&t[..5], &jumps[..5])), (None, None));
    }
}
