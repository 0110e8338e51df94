//! Waves along a variable: the frequencies at which the rows show one.

use crate::priors::ALIKE;
use crate::search_limits::{ALONE, FREQUENCY_STEP, LONGEST, PER_PERIOD};
use realfft::{RealFftPlanner, RealToComplex, num_complex::Complex};
use std::fmt;
use std::sync::Arc;

/// Spectra over a variable along which waves may run, at the rows that show them.
#[derive(Clone)]
pub struct Periodogram {
    /// Row, position, and the share of the wave that the row shows.
    rows: Vec<(usize, f64, f64)>,
    /// Range of frequencies, in turns per unit of position.
    range: [f64; 2],
    /// Range of the positions, and the lowest one.
    span: f64,
    from: f64,
    /// Pitch of the grid for the spectrum, and its number of points.
    pitch: f64,
    length: usize,
    transform: Arc<dyn RealToComplex<f64>>,
    /// Factor of each frequency's sums.
    /// Linear spreading over the grid damps short periods.
    undamped: Vec<f64>,
    /// Products of cosine and sine at each frequency, without their means.
    /// They are of cosine with itself, of sine with itself, and of both.
    products: Vec<[f64; 3]>,
}

impl fmt::Debug for Periodogram {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "a wave over {} rows, {:?} turns", self.rows.len(), self.range)
    }
}

impl Periodogram {
    /// Of rows at these positions; `None` if nothing moves or no period fits.
    #[must_use]
    pub fn new(rows: Vec<(usize, f64, f64)>, [lowest, highest]: [f64; 2]) -> Option<Self> {
        let (lo, hi) = rows.iter().fold((f64::MAX, f64::MIN), |(l, h), r| (l.min(r.1), h.max(r.1)));
        let span = hi - lo;
        if rows.len() < 8 || span.is_nan() || span <= 0.0 {
            return None;
        }
        let from = lowest.max(0.5 / span);
        let whole = span / FREQUENCY_STEP;
        let to = highest.min(LONGEST as f64 / PER_PERIOD / whole);
        if to <= from {
            return None;
        }
        let length = ((whole * to * PER_PERIOD).ceil() as usize).next_power_of_two().clamp(64, LONGEST);
        let pitch = whole / length as f64;
        let to = to.min(0.4 / pitch);
        let transform = RealFftPlanner::new().plan_fft_forward(length);
        if to <= from {
            return None;
        }
        let damped = |i: usize| {
            let x = std::f64::consts::PI * i as f64 / length as f64;
            if x > 0.0 { (x.sin() / x).powi(2) } else { 1.0 }
        };
        let undamped = (0..length / 2).map(|i| 1.0 / damped(i)).collect();
        let (range, products) = ([from, to], Vec::new());
        let mut new = Self { rows, range, span, from: lo, pitch, length, transform, undamped, products };
        new.products = new.products();
        Some(new)
    }

    fn products(&self) -> Vec<[f64; 3]> {
        let (n, whole) = self.rows.iter().fold((0.0, 0.0), |(n, w), r| (n + 1.0, w + r.2 * r.2));
        let (_, once) = self.transformed(self.rows.iter().map(|r| (r.1, r.2)));
        let (_, squared) = self.transformed(self.rows.iter().map(|r| (r.1, r.2 * r.2)));
        let of = |i: usize| {
            // The sum at twice the frequency gives the cosine's share of the power.
            let (mean, twice) = (once[i], squared[2 * i]);
            [
                0.5 * (whole + twice.re) - mean.re * mean.re / n,
                0.5 * (whole - twice.re) - mean.im * mean.im / n,
                0.5 * twice.im - mean.re * mean.im / n,
            ]
        };
        (0..self.length / 4).map(of).collect()
    }

    /// Range of the positions.
    #[must_use]
    pub fn span(&self) -> f64 {
        self.span
    }

    /// Middle of the positions.
    #[must_use]
    pub fn middle(&self) -> f64 {
        self.from + 0.5 * self.span
    }

    /// Sine and cosine of a frequency at all of `n` rows, of this size.
    #[must_use]
    pub fn wave(&self, frequency: f64, n: usize, size: f64) -> [Vec<f64>; 2] {
        let mut out = [vec![0.0; n], vec![0.0; n]];
        for (row, place, share) in &self.rows {
            let (sin, cos) = (std::f64::consts::TAU * frequency * place).sin_cos();
            (out[0][*row], out[1][*row]) = (size * share * sin, size * share * cos);
        }
        out
    }

    /// A function of the position at all of `n` rows.
    #[must_use]
    pub fn over(&self, n: usize, f: impl Fn(f64) -> f64) -> Vec<f64> {
        let mut out = vec![0.0; n];
        for (row, place, share) in &self.rows {
            out[*row] = share * f(*place);
        }
        out
    }

    /// As [`Self::over`], whatever share of the wave a row shows.
    #[must_use]
    pub fn at(&self, n: usize, f: impl Fn(f64) -> f64) -> Vec<f64> {
        let mut out = vec![0.0; n];
        for (row, place, _) in &self.rows {
            out[*row] = f(*place);
        }
        out
    }

    /// The positions.
    #[must_use]
    pub fn positions(&self) -> Vec<f64> {
        self.rows.iter().map(|r| r.1).collect()
    }

    /// Whether its spectrum takes as long to compute as all other looks together.
    #[must_use]
    pub fn is_long(&self) -> bool {
        self.length > 1 << 15
    }

    /// Range of frequencies.
    #[must_use]
    pub fn range(&self) -> [f64; 2] {
        self.range
    }

    /// The strongest frequency near each of these, best first.
    /// Near means within a share of it. Strongest is by the power of a weighted residual.
    #[must_use]
    pub fn strongest_near(&self, residual: &[f64], frequencies: &[f64], share: f64) -> Vec<f64> {
        let step = FREQUENCY_STEP / self.span;
        let best = |f: &f64| {
            let steps = (share * f / step).ceil().clamp(1.0, 60.0);
            let pitch = (share * f / steps).min(step);
            let first = f - steps * pitch;
            let mut sums = vec![Complex::new(0.0, 0.0); 2 * steps as usize + 1];
            for (row, place, weight) in &self.rows {
                // From one frequency to the next each row turns by the same angle.
                let at = std::f64::consts::TAU * (place - self.from);
                let mut now = Complex::cis(at * first) * (residual[*row] * weight);
                let turn = Complex::cis(at * pitch);
                for sum in &mut sums {
                    *sum += now;
                    now *= turn;
                }
            }
            let power = sums.iter().map(Complex::norm_sqr).enumerate();
            power.max_by(|a, b| a.1.total_cmp(&b.1)).map(|(k, power)| (power, first + k as f64 * pitch))
        };
        let seen = frequencies.iter().filter(|f| **f >= self.range[0]);
        let mut all: Vec<(f64, f64)> = seen.filter_map(best).collect();
        all.sort_by(|a, b| b.0.total_cmp(&a.0));
        all.into_iter().map(|b| b.1).collect()
    }

    /// Frequencies of waves that look nearly the same at these positions.
    #[must_use]
    pub fn alias_frequencies(&self, frequency: f64) -> Vec<f64> {
        let rows = self.rows.iter().map(|r| r.0).max().map_or(0, |last| last + 1);
        let (step, power) = self.spectrum(&vec![1.0; rows]);
        let whole: f64 = self.rows.iter().map(|r| r.2).sum();
        // Half of the spectrum suffices: larger shifts lead out of the range.
        let last = power.len() - 1;
        let peaks = (1..last).filter(|i| power[*i] >= power[i - 1] && power[*i] > power[i + 1]);
        let shown = |d: f64| {
            let turn = std::f64::consts::TAU * d;
            let (mut a, mut b) = (0.0, 0.0);
            for (_, place, weight) in &self.rows {
                let (sin, cos) = (turn * (place - self.from)).sin_cos();
                a += weight * sin;
                b += weight * cos;
            }
            (a * a + b * b) / (whole * whole)
        };
        let top = |i: usize| {
            let d = i as f64 * step;
            let [l, m, r] = [d - 0.5 * step, d, d + 0.5 * step].map(shown);
            let bend = l + r - 2.0 * m;
            d + if bend < 0.0 { 0.25 * step * (l - r) / bend } else { 0.0 }
        };
        // Half a step from its top, a peak shows nine tenths of its power.
        let high = peaks.filter(|i| power[*i] > 0.8 * ALIKE * whole * whole);
        let shifts = high.map(top).filter(|d| shown(*d) > ALIKE);
        let of = |d: f64| [d - frequency, d + frequency, frequency - d];
        shifts.flat_map(of).filter(|f| (self.range[0]..=self.range[1]).contains(f)).collect()
    }

    /// Frequencies at which a wave explains most of a weighted residual, best first.
    /// At few positions sine and cosine may look alike, or like a constant. The power is therefore what both
    /// explain in addition to a constant.
    #[must_use]
    pub fn peaks(&self, residual: &[f64], most: usize) -> Vec<f64> {
        let (step, sums) = self.transformed(self.rows.iter().map(|r| (r.1, residual[r.0] * r.2)));
        let first = (self.range[0] / step).ceil() as usize;
        let last = ((self.range[1] / step) as usize).min(self.products.len() - 1);
        let ridge = ALONE * self.rows.iter().map(|r| r.2 * r.2).sum::<f64>();
        let explained = |i: usize| {
            let [cc, ss, cs] = self.products[i];
            let (cc, ss) = (cc.max(0.0) + ridge, ss.max(0.0) + ridge);
            let (c, s) = (sums[i].re, sums[i].im);
            (ss * c * c + cc * s * s - 2.0 * cs * c * s) / (cc * ss - cs * cs).max(ridge * ridge)
        };
        let all: Vec<f64> = (first..=last).map(explained).collect();
        let at = |i: usize| all.get(i).copied().unwrap_or(0.0);
        let is_peak = |i: &usize| at(*i) >= i.checked_sub(1).map_or(0.0, at) && at(*i) > at(i + 1);
        // Between two frequencies of the grid, a wave shows up to a tenth less than its power.
        let top = |i: usize| {
            let [l, m, r] = [i.checked_sub(1).map_or(0.0, at), at(i), at(i + 1)];
            m + (l - r).powi(2) / (8.0 * (2.0 * m - l - r)).max(1e-300)
        };
        let mut peaks: Vec<(f64, usize)> = (0..all.len()).filter(is_peak).map(|i| (top(i), i)).collect();
        peaks.sort_by(|a, b| b.0.total_cmp(&a.0));
        peaks.truncate(most);
        peaks.into_iter().map(|(_, i)| (first + i) as f64 * step).collect()
    }

    /// Step of frequency, and the power of a weighted residual at each frequency.
    fn spectrum(&self, residual: &[f64]) -> (f64, Vec<f64>) {
        let (step, sums) = self.transformed(self.rows.iter().map(|r| (r.1, residual[r.0] * r.2)));
        (step, sums.iter().map(Complex::norm_sqr).collect())
    }

    /// Step of frequency, and each frequency's sums of values with cosine and sine.
    fn transformed(&self, values: impl Iterator<Item = (f64, f64)>) -> (f64, Vec<Complex<f64>>) {
        let mut grid = vec![0.0; self.length];
        for (place, x) in values {
            let u = (place - self.from) / self.pitch;
            let (i, w) = (u.floor() as usize % self.length, u.fract());
            grid[i] += (1.0 - w) * x;
            grid[(i + 1) % self.length] += w * x;
        }
        let sums = transformed(&*self.transform, &mut grid);
        let sums = sums.iter().zip(&self.undamped).map(|(sum, undamped)| sum.conj() * undamped).collect();
        (1.0 / (self.pitch * self.length as f64), sums)
    }
}

/// The transform of real numbers, which it overwrites.
pub(crate) fn transformed(transform: &dyn RealToComplex<f64>, values: &mut [f64]) -> Vec<Complex<f64>> {
    let mut sums = transform.make_output_vec();
    transform.process(values, &mut sums).expect("buffers of the transform's own length");
    sums
}
