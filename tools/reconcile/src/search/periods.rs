//! The period of a wave: peaks of the periodogram of what a set leaves, each refined exactly.

use super::cross::Cross;
use super::offers::{Offer, Source};
use super::periodogram::peaks;
use super::sets::{Set, sharpened};
use super::{Search, Seen};
use crate::cause::{Cause, Shape};
use crate::extent::{GRID_SHARE, aliases, likeliest, pitch};
use crate::gram::{self, Products, dot, products};
use crate::waves::Wave;

/// Frequencies that are looked at twice, and closely; those beyond once.
const MOST_FREQUENCIES: f64 = 262_144.0;

/// Spacing of the frequencies, in periods over the span.
const FREQUENCY_STEP: f64 = 0.3;

/// The same beyond the first [`MOST_FREQUENCIES`]: four fifths of a wave's power are seen between two of them.
const FAST_STEP: f64 = 0.5;

/// A wave is given up where tuning cannot make it the best, nor a rival: it gains at most so many times more by it, and
/// so much beyond that.
const NEARBY: f64 = 1.15;

const SLACK: f64 = 3.0;

/// Below the set's own score by so much an offer plays no part.
const HOPELESS: f64 = 12.0;

/// Rows from which on frequencies far up are tried: among a million of them one fits a few dozen rows by chance.
const FAR_ROWS: usize = 120;

/// Turns over the whole extent below which what a wave shows on a grid is no wave.
const SLOWEST_TURNS: f64 = 1.5;
/// Noise of a smaller coefficient looks the same to a periodogram as white noise.
const VISIBLE_MEMORY: f64 = 0.3;
/// What a wave without a name costs beyond one with a name, nats.
const UNNAMED: f64 = 3.0;

/// Rows of which so much of the mean square changed have the same peaks.
const SAME: f64 = 1e-3;

/// Even frequencies.
struct Band {
    from: f64,
    step: f64,
    count: usize,
}

/// A wave of one frequency as an addition to a set: its score with what the search of it costs.
struct Tone {
    score: f64,
    f: f64,
    cost: f64,
}

/// What a wave of one frequency stands for.
fn cause_of(wave: &Wave, f: f64) -> Option<Cause> {
    if let Some(effect) = &wave.effect {
        let effect = effect.with(&[(0, 1.0 / (f * wave.unit))])?;
        return Some(Cause::Effect { effect, free: vec![0, 1], reference: false });
    }
    let shape = wave.shape.clone()?;
    Some(Cause::Shape(Shape { manner: format!("periodic, period {:.4}", 1.0 / f), ..shape }))
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
        let wave = &self.waves[at];
        let span = wave.span();
        if span <= 0.0 {
            return;
        }
        let from = wave.from.max(0.5 / span);
        if wave.to <= from {
            return;
        }
        let (residual, phi) = self.residual(set);
        if self.as_before(at, &residual[wave.rows.clone()]) {
            return;
        }
        let step = FREQUENCY_STEP / span;
        let wanted = ((wave.to - from) / step).ceil().max(2.0);
        let x: Vec<f64> = wave.along.iter().map(|x| x - wave.places[0]).collect();
        let band = Band { from, step, count: wanted.min(MOST_FREQUENCIES) as usize };
        let list = &mut self.peaks.borrow_mut()[at];
        for p in [0.0, phi] {
            if p == 0.0 || p.abs() >= VISIBLE_MEMORY {
                let u = sharpened(&residual, p, &self.stack.ranges);
                let mut u = u[wave.rows.clone()].to_vec();
                wave.shared(&mut u);
                self.near_peaks(at, &x, &u, &band, p, list);
            }
        }
        if wanted > MOST_FREQUENCIES && x.len() >= FAR_ROWS {
            // Far up every wave is as good as random from row to row, so that one look with the noise's own
            // coefficient serves, on a coarser grid.
            let from = from + step * MOST_FREQUENCIES;
            let step = FAST_STEP / span;
            let count = ((wave.to - from) / step).ceil().max(2.0) as usize;
            let mut u = sharpened(&residual, phi, &self.stack.ranges)[wave.rows.clone()].to_vec();
            wave.shared(&mut u);
            let mut transform = self.transform.borrow_mut();
            let sums = transform.sums(&x, &u, from, step, count);
            let mut power: Vec<f64> = sums.map(|z| f64::from(z.norm_sqr())).collect();
            peaks(&mut power, from, step, list);
        }
    }

    /// Whether a wave's rows are as they were when its peaks were last looked for: what joined the set acts elsewhere.
    fn as_before(&self, at: usize, rows: &[f64]) -> bool {
        let mut last = self.looked_at.borrow_mut();
        let same = last[at].as_ref().is_some_and(|before| {
            let squares = |x: &mut dyn Iterator<Item = f64>| x.map(|x| x * x).sum::<f64>();
            let off = squares(&mut before.iter().zip(rows).map(|(a, b)| a - b));
            off < SAME * squares(&mut rows.iter().copied())
        });
        if !same {
            last[at] = Some(rows.to_vec());
        }
        same
    }

    /// Peaks of a wave's periodogram at the lower frequencies, how waves lie on the places taken into account.
    fn near_peaks(&self, at: usize, x: &[f64], u: &[f64], band: &Band, phi: f64, list: &mut Vec<f64>) {
        let &Band { from, step, count } = band;
        let mut transform = self.transform.borrow_mut();
        let places = self.places_seen[at].get_or_init(|| transform.places(x, from, step, count));
        let mean = u.iter().sum::<f64>() / u.len() as f64;
        let u: Vec<f64> = u.iter().map(|u| u - mean).collect();
        let sums = transform.sums(x, &u, from, step, count);
        let mut power: Vec<f64> = sums.zip(places).map(|(z, place)| place.power(z)).collect();
        if phi != 0.0 {
            let gap = median_gap(x);
            for (i, power) in power.iter_mut().enumerate() {
                let (_, cos) = gram::wave((from + step * i as f64) * gap);
                *power /= 1.0 + phi * phi - 2.0 * phi * cos;
            }
        }
        peaks(&mut power, from, step, list);
    }

    /// The best period of a periodic hypothesis: each peak refined exactly.
    pub(super) fn wave(&self, set: &Set, wave: &Wave, peaks: &[f64]) -> Option<Offer> {
        let span = wave.span();
        if span <= 0.0 {
            return None;
        }
        // Independent frequencies: as many as the span resolves, and no more than make a difference at these places.
        let independent = wave.independent();
        let cost = self.wave_cost(wave);
        let mut best = self.best_peak(set, wave, peaks, cost)?;
        let facts = wave.effect.as_ref().and_then(|e| e.description().searched.wave);
        if let Some(usual_mm) = facts.map(|w| w.usual_mm) {
            self.likeliest_alias(set, wave, &mut best, independent, usual_mm);
        }
        let Tone { score, f, cost } = best;
        let columns = self.wave_columns(wave, f);
        if let Some(most) = facts.and_then(|w| w.most_periods)
            && self.amplitude(set, [&columns[0], &columns[1]]) > most / (f * wave.unit)
        {
            return None;
        }
        let cause = cause_of(wave, f)?;
        let (hypothesis, columns) = (wave.hypothesis, Source::Made(columns));
        Some(Offer { cause, hypothesis, cost, score, evidence: score, columns })
    }

    /// What the search of a wave's period costs.
    pub(crate) fn wave_cost(&self, wave: &Wave) -> f64 {
        let extra = if self.all.list[wave.hypothesis].named() { 0.0 } else { UNNAMED };
        self.all.family_cost + wave.independent().ln() + extra
    }

    fn wave_score(&self, set: &Set, wave: &Wave, f: f64, cost: f64) -> f64 {
        self.extended(set, &self.wave_cross(set, wave, f)) - self.price(set, cost, 2)
    }

    /// The best frequency near the peaks.
    fn best_peak(&self, set: &Set, wave: &Wave, peaks: &[f64], cost: f64) -> Option<Tone> {
        let span = wave.span();
        // What a wave that explains nothing scores.
        let nothing = set.loglik - self.price(set, cost, 2);
        let mut best: Option<(f64, f64)> = None;
        for f0 in peaks {
            let bound = best.map_or(f64::NEG_INFINITY, |b| b.0).max(set.score - HOPELESS);
            let grid = wave.effect.as_ref().and_then(|_| pitch(&wave.places, GRID_SHARE / f0));
            let mut eval = |f: f64| {
                // On a grid whose pitch is a whole number of periods a wave is a constant or a slow bow, and no wave.
                if grid.is_some_and(|pitch| ((f * pitch).round() / pitch - f).abs() * span < SLOWEST_TURNS) {
                    return f64::NEG_INFINITY;
                }
                let score = self.wave_score(set, wave, f, cost);
                if best.as_ref().is_none_or(|b| score > b.0) {
                    best = Some((score, f));
                }
                score
            };
            let mut centre = (eval(*f0), *f0);
            let mut h = FREQUENCY_STEP / span;
            // Between two frequencies of the grid a wave shows at least 0.93 of its power; the nearer, the more.
            let mut nearby = NEARBY - 1.0;
            for _ in 0..8 {
                if (centre.0 - nothing) * (1.0 + nearby) + nothing + SLACK < bound {
                    break;
                }
                nearby *= 0.25;
                h *= 0.5;
                for f in
                    [centre.1 - h, centre.1 + h].into_iter().filter(|f| (wave.from..=wave.to).contains(f))
                {
                    let score = eval(f);
                    if score > centre.0 {
                        centre = (score, f);
                    }
                }
            }
        }
        best.map(|(score, f)| Tone { score, f, cost })
    }

    /// On a grid there are no more frequencies than places: fewer are paid for. Which of the aliases it is the data cannot
    /// say; the likeliest is given.
    fn likeliest_alias(&self, set: &Set, wave: &Wave, best: &mut Tone, independent: f64, usual_mm: &[f64]) {
        let span = wave.span();
        let Some(pitch) = pitch(&wave.places, GRID_SHARE / best.f) else { return };
        let cost = best.cost;
        let saved = independent.ln() - independent.min((span / pitch).max(2.0)).ln();
        best.cost -= saved;
        best.score += saved;
        let near: Vec<(f64, f64)> = aliases(best.f, pitch, [wave.from.max(0.5 / span), wave.to], 8)
            .into_iter()
            .map(|g| (self.wave_score(set, wave, g, cost - saved), g))
            .filter(|(s, _)| *s > best.score - 1.0)
            .collect();
        let periods: Vec<f64> = near.iter().map(|(_, g)| 1.0 / g).collect();
        if let Some(i) = likeliest(&periods, usual_mm) {
            (best.score, best.f) = near[i];
        }
    }

    /// The least amplitude of a wave of two columns that explains as much of what a set leaves as they do.
    pub(super) fn amplitude(&self, set: &Set, [s, c]: [&[f64]; 2]) -> f64 {
        let (left, _) = self.residual(set);
        let (ss, cc) = (dot(s, s), dot(c, c));
        let mut squares = [ss, 0.0, dot(s, c), cc];
        let mut with = [dot(s, &left), dot(c, &left)];
        gram::reduce(&mut squares, &mut with);
        let explained: f64 = with.iter().filter(|w| w.is_finite()).map(|w| w * w).sum();
        // However sine and cosine lie on the places, no smaller amplitude explains so much.
        let largest = f64::midpoint(ss, cc) + f64::hypot((ss - cc) / 2.0, dot(s, c));
        (explained / largest).sqrt()
    }

    pub(super) fn wave_columns(&self, wave: &Wave, f: f64) -> Vec<Vec<f64>> {
        let mut out = vec![vec![0.0; self.stack.n]; 2];
        if let [sines, cosines] = &mut out[..] {
            let both = sines[wave.rows.clone()].iter_mut().zip(&mut cosines[wave.rows.clone()]);
            for (x, (a, b)) in wave.along.iter().zip(both) {
                (*a, *b) = gram::wave(x * f);
            }
            wave.shared(&mut sines[wave.rows.clone()]);
            wave.shared(&mut cosines[wave.rows.clone()]);
        }
        for column in &mut out {
            self.stack.weigh(column);
        }
        out
    }

    /// The columns of a wave against a set; what was worked out once is kept.
    pub(super) fn wave_cross(&self, set: &Set, wave: &Wave, f: f64) -> Cross {
        let ranges = &self.stack.ranges;
        let mut all = self.seen.borrow_mut();
        let seen = all.entry((wave.hypothesis, f.to_bits())).or_insert_with(|| {
            let c = self.wave_columns(wave, f);
            let own =
                [(0, 0), (1, 0), (1, 1)].iter().map(|(i, j)| products(&c[*i], &c[*j], ranges)).collect();
            let kept = self.room.get().checked_sub(2 * self.stack.n);
            if let Some(left) = kept {
                self.room.set(left);
            }
            Seen { columns: kept.map(|_| c), own, with: Vec::new() }
        });
        seen.with.resize(self.vectors.len(), None);
        let mut made = None;
        let mut with = |id: usize| -> [Products; 2] {
            *seen.with[id].get_or_insert_with(|| {
                let c = seen
                    .columns
                    .as_ref()
                    .unwrap_or_else(|| made.get_or_insert_with(|| self.wave_columns(wave, f)));
                let v = &self.vectors[id];
                [v.products(&c[0], ranges), v.products(&c[1], ranges)]
            })
        };
        let y = with(self.y);
        let each: Vec<[Products; 2]> = set.ids.iter().map(|i| with(*i)).collect();
        Cross {
            with_set: (0..2).map(|k| each.iter().map(|p| p[k]).collect()).collect(),
            with_y: y.to_vec(),
            own: seen.own.clone(),
        }
    }
}
