//! Periodograms of rows at uneven places, over a million frequencies.

use crate::lanes;
use rustfft::FftPlanner;
use rustfft::num_complex::{Complex32, Complex64};
use std::cell::RefCell;

/// Values of a periodogram that are looked at together.
const STRETCH: usize = 64;

/// The three highest peaks of a periodogram, added to a list of frequencies.
pub(super) fn peaks(power: &mut [f64], from: f64, step: f64, list: &mut Vec<f64>) {
    let mut highest: Vec<f64> = power.chunks(STRETCH).map(largest).collect();
    for _ in 0..3 {
        let top = first_of_largest(power, &highest);
        let f = from + step * top as f64;
        if !list.iter().any(|g: &f64| (g - f).abs() < 2.0 * step) {
            list.push(f);
        }
        let (begin, end) = (top.saturating_sub(4), (top + 5).min(power.len()));
        power[begin..end].fill(0.0);
        for stretch in begin / STRETCH..end.div_ceil(STRETCH) {
            highest[stretch] = largest(&power[stretch * STRETCH..power.len().min((stretch + 1) * STRETCH)]);
        }
    }
}

/// The largest of some values, in several lanes.
fn largest(values: &[f64]) -> f64 {
    let mut lanes = [f64::NEG_INFINITY; 8];
    let larger = |a: f64, b: f64| if b > a { b } else { a };
    let chunks = values.chunks_exact(lanes.len());
    let rest = chunks.remainder().iter().copied().fold(f64::NEG_INFINITY, larger);
    for chunk in chunks {
        for (lane, value) in lanes.iter_mut().zip(chunk) {
            *lane = larger(*lane, *value);
        }
    }
    lanes.into_iter().fold(rest, larger)
}

/// Where the first of the largest values is, by those of each stretch.
fn first_of_largest(power: &[f64], highest: &[f64]) -> usize {
    let mut best = 0;
    for (i, h) in highest.iter().enumerate() {
        if *h > highest[best] {
            best = i;
        }
    }
    let stretch = &power[best * STRETCH..];
    let within = stretch.iter().take(STRETCH).position(|p| *p >= highest[best]);
    // Where nothing is a number the first stands for all.
    within.map_or(0, |within| best * STRETCH + within)
}

thread_local! {
    /// Planned once for each size: the factors of a large transform take as long as the transform.
    static PLANNER: RefCell<FftPlanner<f32>> = RefCell::new(FftPlanner::new());
}

/// Frequencies that are transformed at once, of few rows and of many: so few that all of it stays near the core, so many that
/// spreading the rows over a grid is not most of the work.
const PARTS: [usize; 2] = [4096, 16_384];
/// From so many rows on.
const MANY_ROWS: usize = 1000;

/// What a Fourier transform needs, kept from one to the next.
#[derive(Default)]
pub(super) struct Transform {
    grid: Vec<Complex32>,
    scratch: Vec<Complex32>,
    spread: Vec<Spread>,
}

/// How a row lies on the grid.
struct Spread {
    /// The first of its four neighbours, and the share that each has.
    first: usize,
    weights: [f64; 4],
    /// The row's wave at the middle of the part, and by how much it turns from part to part.
    wave: Complex64,
    turn: Complex64,
}

fn turned(turns: f64) -> Complex64 {
    let (sin, cos) = lanes::wave(turns);
    Complex64::new(cos, sin)
}

/// Frequencies of which one wave is worked out, and the others from it.
const TURNED: usize = 64;

/// Divides a power at even frequencies by what noise of a memory of φ makes of it, rows so far apart.
pub(super) fn whiten(power: &mut [f64], [from, step]: [f64; 2], phi: f64, gap: f64) {
    let turns: [Complex64; TURNED] = std::array::from_fn(|k| turned(step * k as f64 * gap));
    for (i, power) in power.chunks_mut(TURNED).enumerate() {
        let first = turned((from + step * (i * TURNED) as f64) * gap);
        for (power, turn) in power.iter_mut().zip(&turns) {
            let cos = first.re * turn.re - first.im * turn.im;
            *power /= 1.0 + phi * phi - 2.0 * phi * cos;
        }
    }
}

impl Transform {
    /// Σ uᵢ·exp(2πj·f·xᵢ) at `count` frequencies from `from`, to a few per cent: rows spread over a fine even grid by
    /// cubic weights, fast Fourier transforms of parts of the band (Press and Rybicki, Astrophys. J. 338, 1989). They are given
    /// in order, some at a time.
    pub(super) fn sums(
        &mut self,
        x: &[f64],
        u: &[f64],
        from: f64,
        step: f64,
        count: usize,
        mut some: impl FnMut(&[Complex32]),
    ) {
        let part = PARTS[usize::from(x.len() >= MANY_ROWS)];
        let part = count.div_ceil(count.div_ceil(part).max(1));
        let size = room(part + part / 2);
        let Self { grid, scratch, spread } = self;
        spread.clear();
        // Frequencies are counted from the middle of the part, so that the grid need only hold half of it.
        let middle = from + step * (part / 2) as f64;
        spread.extend(x.iter().map(|x| {
            let place = x * step * size as f64;
            let base = place.floor();
            let w = place - base;
            // Lagrange's cubic through four neighbours.
            let weights = [
                -w * (w - 1.0) * (w - 2.0) / 6.0,
                (w + 1.0) * (w - 1.0) * (w - 2.0) / 2.0,
                -(w + 1.0) * w * (w - 2.0) / 2.0,
                (w + 1.0) * w * (w - 1.0) / 6.0,
            ];
            let first = (base as i64 - 1).rem_euclid(size as i64) as usize;
            Spread { first, weights, wave: turned(middle * x), turn: turned(step * part as f64 * x) }
        }));
        let fft = PLANNER.with_borrow_mut(|planner| planner.plan_fft_inverse(size));
        scratch.resize(fft.get_inplace_scratch_len().max(scratch.len()), Complex32::new(0.0, 0.0));
        let mut done = 0;
        while done < count {
            grid.clear();
            grid.resize(size, Complex32::new(0.0, 0.0));
            for (u, Spread { first, weights, wave, turn }) in u.iter().zip(&mut *spread) {
                for (k, weight) in weights.iter().enumerate() {
                    let at = if *first + k < size { *first + k } else { *first + k - size };
                    grid[at] += Complex32::new((wave.re * u * weight) as f32, (wave.im * u * weight) as f32);
                }
                *wave *= *turn;
            }
            fft.process_with_scratch(grid, scratch);
            // The lower half of the part stands at the grid's end.
            for values in [&grid[size - part / 2..], &grid[..part - part / 2]] {
                let values = &values[..values.len().min(count - done)];
                some(values);
                done += values.len();
            }
        }
    }

    /// How waves of these frequencies lie on the places.
    pub(super) fn places(&mut self, x: &[f64], from: f64, step: f64, count: usize) -> Vec<OnPlaces> {
        let share = vec![1.0 / x.len() as f64; x.len()];
        let (mut once, mut out) = (Vec::with_capacity(count), Vec::with_capacity(count));
        self.sums(x, &share, from, step, count, |some| once.extend_from_slice(some));
        self.sums(x, &share, 2.0 * from, 2.0 * step, count, |twice| {
            let once = &once[out.len()..];
            out.extend(once.iter().zip(twice).map(|(once, twice)| OnPlaces::new(*once, *twice)));
        });
        out
    }
}

/// Mean square of a cosine and of a sine over the places, their means taken off, and of the one times the other. Where
/// targets are few a wave may be mostly sine there, or mostly constant.
pub(super) struct OnPlaces {
    cos: f32,
    sin: f32,
    both: f32,
}

impl OnPlaces {
    /// From the means of exp(jθ) and exp(2jθ).
    fn new(once: Complex32, twice: Complex32) -> Self {
        Self {
            cos: 0.5 * (1.0 + twice.re) - once.re * once.re,
            sin: 0.5 * (1.0 - twice.re) - once.im * once.im,
            both: 0.5 * twice.im - once.re * once.im,
        }
    }

    /// What the wave explains beside a constant (Zechmeister and Kürster, Astron. Astrophys. 496, 2009), up to a factor.
    pub(super) fn power(&self, z: Complex32) -> f64 {
        // No more than the sums are good for is believed of a wave that is next to nothing on the places.
        let whole = (self.cos * self.sin - self.both * self.both).max(LEAST_WHOLE);
        f64::from((self.sin * z.re * z.re + self.cos * z.im * z.im - 2.0 * self.both * z.re * z.im) / whole)
    }
}

/// A quarter where the places are spread well.
const LEAST_WHOLE: f32 = 0.05;

/// The smallest size from `least` on that a Fourier transform is quick at: a power of two, or three quarters of one.
fn room(least: usize) -> usize {
    let whole = least.next_power_of_two().max(64);
    if whole / 4 * 3 >= least { whole / 4 * 3 } else { whole }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::noise;

    /// Frequencies in several parts and in one, few rows and many: sums as they are by their definition, to a few per cent of the
    /// rows' root.
    #[test]
    fn sums_are_those_of_their_definition() {
        for (rows, count) in [(40, 700), (300, 9000), (1200, 20_000)] {
            let u = noise(5, rows);
            let x: Vec<f64> = noise(6, rows).iter().map(|x| 30.0 * x).collect();
            let (from, step) = (0.7, 0.002);
            let mut sums = Vec::new();
            Transform::default().sums(&x, &u, from, step, count, |some| sums.extend_from_slice(some));
            assert_eq!(sums.len(), count);
            let mut squares = 0.0;
            for (i, z) in sums.iter().enumerate().step_by(7) {
                let turns = from + step * i as f64;
                let (mut re, mut im) = (0.0, 0.0);
                for (x, u) in x.iter().zip(&u) {
                    let (sin, cos) = lanes::wave(turns * x);
                    re += u * cos;
                    im += u * sin;
                }
                let off = (f64::from(z.re) - re).hypot(f64::from(z.im) - im) / (rows as f64).sqrt();
                assert!(off < 0.35, "{rows} rows, frequency {i} of {count}: {off}");
                squares += off * off;
            }
            let rms = (squares / (count as f64 / 7.0)).sqrt();
            assert!(rms < 0.06, "{rows} rows, {count} frequencies: {rms}");
        }
    }

    #[test]
    fn power_is_divided_by_that_of_noise() {
        let (from, step, phi, gap) = (0.3, 0.0007, 0.97, 1.7);
        let mut power = vec![1.0; 1000];
        whiten(&mut power, [from, step], phi, gap);
        for (i, power) in power.into_iter().enumerate() {
            let (_, cos) = lanes::wave((from + step * i as f64) * gap);
            let of_noise = 1.0 + phi * phi - 2.0 * phi * cos;
            assert!((power * of_noise - 1.0).abs() < 1e-9, "{i}: {power}");
        }
    }

    /// As by looking at every value each time.
    #[test]
    fn the_three_highest_peaks_are_found() {
        for n in [9, 63, 64, 65, 500] {
            for seed in 1..20 {
                let power: Vec<f64> = noise(seed, n).iter().map(|x| (4.0 * x * x).round()).collect();
                let mut slow = Vec::new();
                let mut left = power.clone();
                for _ in 0..3 {
                    let most = left.iter().copied().fold(0.0, f64::max);
                    let top = left.iter().position(|p| *p >= most).unwrap_or(0);
                    if slow.iter().all(|f: &f64| (f - top as f64).abs() >= 2.0) {
                        slow.push(top as f64);
                    }
                    let end = (top + 5).min(n);
                    left[top.saturating_sub(4)..end].fill(0.0);
                }
                let mut found = Vec::new();
                peaks(&mut power.clone(), 0.0, 1.0, &mut found);
                assert_eq!(found, slow, "{n} values, seed {seed}");
            }
        }
    }
}
