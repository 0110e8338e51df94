//! The frequencies at which what a set leaves shows waves: peaks of its periodograms.

use super::Search;
use super::periodogram::{OnPlaces, peaks, whiten};
use super::periods::FREQUENCY_STEP;
use super::sets::{Set, sharpened};
use crate::lanes::dot;
use std::cell::OnceCell;
use std::ops::Range;

/// Frequencies that are looked at twice, and closely; those beyond once.
const MOST_FREQUENCIES: f64 = 262_144.0;

/// Of more frequencies the axis's own rows alone choose those that are tried: each of the finest waves lies on the places anew.
const MOST_TOGETHER: usize = 32_768;

/// The same beyond the first [`MOST_FREQUENCIES`]: four fifths of a wave's power are seen between two of them.
const FAST_STEP: f64 = 0.5;

/// Rows from which on frequencies far up are tried: among a million of them one fits a few dozen rows by chance.
const FAR_ROWS: usize = 120;

/// Noise of a smaller coefficient looks the same to a periodogram as white noise.
const VISIBLE_MEMORY: f64 = 0.3;
/// Rows of which so much of the mean square changed have the same peaks.
const SAME: f64 = 1e-3;

/// Even frequencies.
struct Band {
    from: f64,
    step: f64,
    count: usize,
}

/// Middle one of the distances from row to row.
fn median_gap(x: &[f64]) -> f64 {
    let mut gaps: Vec<f64> = x.windows(2).map(|w| (w[1] - w[0]).abs()).collect();
    gaps.sort_by(f64::total_cmp);
    gaps.get(gaps.len() / 2).copied().unwrap_or(0.0)
}

impl Search<'_, '_> {
    /// Frequencies at which the periodogram of what a set leaves is highest, added to the wave's list.
    pub(super) fn find_peaks(&self, set: &Set, at: usize) {
        let (residual, phi) = self.residual(set);
        let of = self.waves[at].parts().flat_map(|(rows, ..)| residual[rows.clone()].iter().copied());
        if !self.as_before(at, of.collect()) {
            self.peaks_of(set, at, (&residual, phi), &mut self.peaks.borrow_mut()[at]);
        }
    }

    /// The same alone, whatever was met so far.
    pub(super) fn fresh_peaks(&self, set: &Set, at: usize) -> Vec<f64> {
        let (residual, phi) = self.residual(set);
        let mut list = Vec::new();
        self.peaks_of(set, at, (&residual, phi), &mut list);
        list
    }

    fn peaks_of(&self, set: &Set, at: usize, (residual, phi): (&[f64], f64), list: &mut Vec<f64>) {
        let wave = &self.waves[at];
        let span = wave.span;
        if span <= 0.0 {
            return;
        }
        let from = wave.from.max(0.5 / span);
        if wave.to <= from {
            return;
        }
        let step = FREQUENCY_STEP / span;
        let wanted = ((wave.to - from) / step).ceil().max(2.0);
        let band = Band { from, step, count: wanted.min(MOST_FREQUENCIES) as usize };
        self.peaks_of_targets(set, wave, residual, [from, step], list);
        for p in [0.0, phi] {
            if p == 0.0 || p.abs() >= VISIBLE_MEMORY {
                let u = sharpened(residual, p, &self.stack.ranges);
                self.near_peaks(at, &u, &band, p, list);
            }
        }
        if wanted > MOST_FREQUENCIES && wave.along.len() >= FAR_ROWS {
            // Far up every wave is as good as random from row to row, so that one look with the noise's own
            // coefficient serves, on a coarser grid.
            let from = from + step * MOST_FREQUENCIES;
            let step = FAST_STEP / span;
            let count = ((wave.to - from) / step).ceil().max(2.0) as usize;
            let mut u = sharpened(residual, phi, &self.stack.ranges)[wave.rows.clone()].to_vec();
            wave.shared(&mut u);
            let x: Vec<f64> = wave.along.iter().map(|x| x - wave.places[0]).collect();
            let mut power: Vec<f64> = Vec::with_capacity(count);
            let mut transform = self.transform.borrow_mut();
            transform.sums(&x, &u, from, step, count, |some| {
                power.extend(some.iter().map(|z| f64::from(z.norm_sqr())));
            });
            peaks(&mut power, from, step, list);
        }
    }

    /// Whether a wave's rows are as they were when its peaks were last looked for: what joined the set acts elsewhere.
    fn as_before(&self, at: usize, rows: Vec<f64>) -> bool {
        let mut last = self.looked_at.borrow_mut();
        let same = last[at].as_ref().is_some_and(|before| {
            let squares = |x: &mut dyn Iterator<Item = f64>| x.map(|x| x * x).sum::<f64>();
            let off = squares(&mut before.iter().zip(&rows).map(|(a, b)| a - b));
            off < SAME * squares(&mut rows.iter().copied())
        });
        if !same {
            last[at] = Some(rows);
        }
        same
    }

    /// Peaks of a wave's periodogram at the lower frequencies, how waves lie on the places taken into account: of its own rows,
    /// and of all that show it.
    fn near_peaks(&self, at: usize, u: &[f64], band: &Band, phi: f64, list: &mut Vec<f64>) {
        let mut parts = self.waves[at].parts().zip(&self.places_seen[at]);
        let Some((own, seen)) = parts.next() else { return };
        let mut power = self.power(own, seen, u, band, phi);
        let further: Vec<Vec<f64>> = parts
            .filter(|_| band.count <= MOST_TOGETHER)
            .map(|(part, seen)| self.power(part, seen, u, band, phi))
            .collect();
        if !further.is_empty() {
            let mut all = power.clone();
            for more in &further {
                all.iter_mut().zip(more).for_each(|(all, more)| *all += more);
            }
            peaks(&mut all, band.from, band.step, list);
        }
        peaks(&mut power, band.from, band.step, list);
    }

    /// What waves of each frequency explain of some rows, up to a factor.
    fn power(
        &self,
        (rows, along, share): (&Range<usize>, &[f64], &[f64]),
        seen: &OnceCell<Vec<OnPlaces>>,
        u: &[f64],
        band: &Band,
        phi: f64,
    ) -> Vec<f64> {
        let &Band { from, step, count } = band;
        let first = along.iter().copied().fold(f64::MAX, f64::min);
        let x: Vec<f64> = along.iter().map(|x| x - first).collect();
        let mut u = u[rows.clone()].to_vec();
        u.iter_mut().zip(share).for_each(|(u, share)| *u *= share);
        let mean = u.iter().sum::<f64>() / u.len() as f64;
        for u in &mut u {
            *u -= mean;
        }
        let mut transform = self.transform.borrow_mut();
        let places = seen.get_or_init(|| transform.places(&x, from, step, count));
        let mut power: Vec<f64> = Vec::with_capacity(count);
        transform.sums(&x, &u, from, step, count, |some| {
            let places = &places[power.len()..];
            power.extend(places.iter().zip(some).map(|(place, z)| place.power(*z)));
        });
        // Of a wave that is a share of itself there so many rows are seen.
        let whole = if share.is_empty() { x.len() as f64 } else { dot(share, share) };
        for power in &mut power {
            *power /= whole;
        }
        if phi != 0.0 {
            whiten(&mut power, [from, step], phi, median_gap(&x));
        }
        power
    }
}
