//! The period of a wave: peaks of the periodogram of what a set leaves, each refined exactly.

use super::Search;
use super::offers::{Offer, Source};
use super::sets::{Member, Set};
use crate::cause::{Cause, Shape};
use crate::cholesky;
use crate::extent::{GRID_SHARE, aliases, likeliest, pitch};
use crate::lanes::{self, dot};
use crate::waves::Wave;

/// Spacing of the frequencies, in periods over the span.
pub(super) const FREQUENCY_STEP: f64 = 0.3;

/// A wave is given up where tuning cannot make it the best, nor a rival: it explains at most so many times more by it, and
/// gains so much beyond that.
const NEARBY: f64 = 1.15;

const SLACK: f64 = 3.0;

/// Two frequencies are the same where they differ by so few turns over the extent.
const SAME_TURNS: f64 = 1e-3;

/// No wave explains more than so much of what is left.
const ALL: f64 = 0.999_999;

/// Below the set's own score by so much an offer plays no part.
const HOPELESS: f64 = 12.0;

/// Turns over the whole extent below which what a wave shows on a grid is no wave.
const SLOWEST_TURNS: f64 = 1.5;
/// What a wave without a name costs beyond one with a name, nats.
const UNNAMED: f64 = 3.0;

/// Peaks that are so near the best are no worse, nats.
const NO_WORSE: f64 = 3.0;

/// A wave of one frequency as an addition to a set: its score with what the search of it costs.
struct Tone {
    score: f64,
    f: f64,
    cost: f64,
}

/// The longest periods are no likelier than so, nats.
const MOST_LIKELY: f64 = 3.0;

/// So many of the longest periods that look the same as a peak at nearly even places are looked at, and so many are listed.
const LOWEST: usize = 3;
const LISTED: usize = 8;
/// Distances of nearly even places differ by no more than this share.
const UNEVEN: f64 = 0.1;
/// Turns over the whole extent by which two periods differ.
const RESOLVED: f64 = 1.0;

/// The distance of places that are nearly even; none where they are not.
fn even(places: &[f64]) -> Option<f64> {
    let gaps: Vec<f64> = places.windows(2).map(|w| w[1] - w[0]).collect();
    let mean = places.last()? - places.first()?;
    let mean = mean / gaps.len().max(1) as f64;
    (gaps.len() > 2 && gaps.iter().all(|g| (g / mean - 1.0).abs() < UNEVEN)).then_some(mean)
}

/// How near a usual period a found one is the same.
const USUAL: f64 = 0.005;

/// By how much a frequency is cheaper than the most of them, nats: periods are as likely in each octave, and long ones are few.
fn rarer(wave: &Wave, f: f64) -> f64 {
    let octaves = (wave.to / wave.from).ln().max(1.0);
    (f * octaves / (wave.to - wave.from)).max(1e-6).ln().clamp(-MOST_LIKELY, 0.0)
}

/// Of two frequencies with their scores the one that is worse, then the one that is better.
fn in_order(a: (f64, f64), b: (f64, f64)) -> ((f64, f64), (f64, f64)) {
    if a.0 > b.0 { (b, a) } else { (a, b) }
}

/// The frequency that leaves least, from one with a higher score than those on either side of it: what a wave leaves is a parabola
/// over its frequency, however sharp the peak of its logarithm. None where that cannot be told.
fn least_left([a, b]: [(f64, f64); 2], top: (f64, f64), nu: f64) -> Option<f64> {
    let more = |s: (f64, f64)| (2.0 * (top.0 - s.0) / nu).exp_m1();
    let ([to_a, to_b], [more_a, more_b]) = ([a, b].map(|s| s.1 - top.1), [a, b].map(more));
    let by = 0.5 * (to_a * to_a * more_b - to_b * to_b * more_a) / (to_a * more_b - to_b * more_a);
    (more_a + more_b).is_finite().then_some(by).filter(|by| by.is_finite()).map(|by| top.1 + by)
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

/// Periods that machines are made with, mm; none for a shape.
fn usual_mm(wave: &Wave) -> &'static [f64] {
    let facts = wave.effect.as_ref().and_then(|e| e.description().searched.wave);
    facts.map_or(&[], |w| w.usual_mm)
}

impl Search<'_, '_> {
    /// The best period of a periodic hypothesis: each peak refined exactly that may come to more than `least`.
    pub(super) fn wave(&self, set: &Set, wave: &Wave, peaks: &[f64], least: f64) -> Option<Offer> {
        let span = wave.span;
        if span <= 0.0 {
            return None;
        }
        // Independent frequencies: as many as the span resolves, and no more than make a difference at these places.
        let independent = wave.independent();
        let cost = self.wave_cost(wave);
        let mut best = self.best_peak(set, wave, peaks, [cost, least])?;
        if wave.effect.is_some() {
            self.likeliest_alias(set, wave, &mut best, independent, usual_mm(wave));
        }
        let Tone { score, f, cost } = best;
        if !self.bearable(set, wave, f) {
            return None;
        }
        let columns = self.wave_columns(wave, f);
        let cause = cause_of(wave, f)?;
        let (hypothesis, columns) = (wave.hypothesis, Source::Made(columns));
        Some(Offer { cause, hypothesis, cost, score, evidence: score, columns })
    }

    /// The best period of a hypothesis that is a wave, of all that show in what a set leaves.
    pub(crate) fn wave_offer(&self, set: &Set, hypothesis: usize) -> Option<Offer> {
        let at = self.waves.iter().position(|w| w.hypothesis == hypothesis)?;
        let peaks = self.fresh_peaks(set, at);
        self.wave(set, &self.waves[at], &peaks, f64::NEG_INFINITY)
    }

    /// What the search of a wave's period costs.
    pub(crate) fn wave_cost(&self, wave: &Wave) -> f64 {
        let extra = if self.all.list[wave.hypothesis].named() { 0.0 } else { UNNAMED };
        self.all.family_cost + wave.independent().ln() + extra
    }

    /// The best frequency near the peaks that a wave's law allows.
    fn best_peak(&self, set: &Set, wave: &Wave, peaks: &[f64], [cost, least]: [f64; 2]) -> Option<Tone> {
        let mut tops = self.tops(set, wave, peaks, [cost, least]);
        tops.retain(|t| t.0 > f64::NEG_INFINITY);
        // What looks the same as a wave that no scale has may be one that it has; what only explains less is not.
        let least = tops.first()?.0 - NO_WORSE;
        let best = tops.iter().position(|t| t.0 > least && self.bearable(set, wave, t.1))?;
        let (score, f) = self.usual(set, wave, &tops[best..]);
        Some(Tone { score, f, cost: cost + rarer(wave, f) })
    }

    /// Every peak refined, and what looks the same as it at nearly even places; the best first, with their scores.
    /// Those that cannot come to `least` are left as they are.
    fn tops(&self, set: &Set, wave: &Wave, peaks: &[f64], [cost, least]: [f64; 2]) -> Vec<(f64, f64)> {
        let span = wave.span;
        // What a wave that explains nothing scores.
        let nothing = set.loglik - self.price(set, wave.hypothesis, cost, 2);
        let mut best = f64::NEG_INFINITY;
        let mut tops: Vec<(f64, f64)> = Vec::new();
        let mut refined = |f0: &f64, tops: &mut Vec<(f64, f64)>| {
            let bound = best.max(set.score - HOPELESS).max(least);
            let grid = wave.effect.as_ref().and_then(|_| wave.pitch(GRID_SHARE / f0));
            let eval = |f: f64| {
                // On a grid whose pitch is a whole number of periods a wave is a constant or a slow bow, and no wave.
                if grid.is_some_and(|pitch| ((f * pitch).round() / pitch - f).abs() * span < SLOWEST_TURNS) {
                    return f64::NEG_INFINITY;
                }
                self.wave_score(set, wave, f, cost + rarer(wave, f))
            };
            let mut centre = (eval(*f0), *f0);
            let mut h = FREQUENCY_STEP / span;
            // Between two frequencies of the grid a wave shows at least 0.93 of its power; the nearer, the more.
            let mut nearby = NEARBY - 1.0;
            let mut sides = None;
            for _ in 0..8 {
                if self.most_gained(centre.0 - nothing, nearby) + nothing + SLACK < bound {
                    break;
                }
                nearby *= 0.25;
                if let Some((between, [a, b])) =
                    sides.and_then(|s| Some((least_left(s, centre, self.nu)?, s)))
                {
                    if (between - centre.1).abs() * span < SAME_TURNS {
                        break;
                    }
                    let (other, middle) = in_order((eval(between), between), centre);
                    sides = Some(if other.1 < middle.1 { [other, b] } else { [a, other] });
                    centre = middle;
                    continue;
                }
                h *= 0.5;
                let beside = [centre.1 - h, centre.1 + h].map(|f| {
                    let within = (wave.from..=wave.to).contains(&f);
                    (if within { eval(f) } else { f64::NEG_INFINITY }, f)
                });
                let highest = beside.into_iter().fold(centre, |top, s| in_order(top, s).1);
                sides = (highest == centre).then_some(beside);
                centre = highest;
            }
            best = best.max(centre.0);
            tops.push(centre);
        };
        for f0 in peaks {
            refined(f0, &mut tops);
        }
        if let Some(pitch) = even(&wave.places) {
            for (_, f) in tops.clone() {
                for f0 in aliases(f, pitch, [wave.from.max(0.5 / span), wave.to], LOWEST, &[]) {
                    if !tops.iter().any(|t| (f0 - t.1).abs() * span < FREQUENCY_STEP) {
                        refined(&f0, &mut tops);
                    }
                }
            }
        }
        tops.sort_by(|a, b| b.0.total_cmp(&a.0));
        tops
    }

    /// The most that a wave gains by tuning that shows it by so much more of its power: as what is left shrinks, a little more
    /// explained gains much.
    fn most_gained(&self, gain: f64, more: f64) -> f64 {
        let explained = 1.0 - (-2.0 * gain.max(0.0) / self.nu).exp();
        -0.5 * self.nu * (1.0 - (explained * (1.0 + more)).min(ALL)).ln()
    }

    /// Whether a wave of this frequency that explains what a set leaves keeps its law's largest amplitude.
    fn bearable(&self, set: &Set, wave: &Wave, f: f64) -> bool {
        let facts = wave.effect.as_ref().and_then(|e| e.description().searched.wave);
        let Some(most) = facts.and_then(|w| w.most_periods) else { return true };
        let columns = self.wave_columns(wave, f);
        self.amplitude(set, [&columns[0], &columns[1]]) <= most / (f * wave.unit)
    }

    /// Of peaks that are no worse than the first the one with a period that machines are made with.
    fn usual(&self, set: &Set, wave: &Wave, tops: &[(f64, f64)]) -> (f64, f64) {
        let best = tops[0];
        let Some(facts) = wave.effect.as_ref().and_then(|e| e.description().searched.wave) else {
            return best;
        };
        let near = tops.iter().filter(|t| t.0 > best.0 - NO_WORSE);
        let made = |t: &&(f64, f64)| {
            facts.usual_mm.iter().any(|l| (1.0 / t.1 / l - 1.0).abs() < USUAL)
                && self.bearable(set, wave, t.1)
        };
        let mut made = near.filter(made);
        made.next().map_or(best, |t| *t)
    }

    /// Other periods that explain a wave of a set as well at these places, in the law's own unit, with the log odds by
    /// which they are worse. `rest`: the set without it.
    pub(crate) fn other_periods(&self, rest: &Set, member: &Member) -> Vec<(f64, f64)> {
        let Some((i, wave)) = self.waves.iter().enumerate().find(|(_, w)| w.hypothesis == member.hypothesis)
        else {
            return Vec::new();
        };
        let Some(own) = wave.frequency(&member.cause) else { return Vec::new() };
        let cost = self.wave_cost(wave);
        let score = |f: f64| self.wave_score(rest, wave, f, cost);
        let mine = score(own);
        let peaks = self.peaks.borrow()[i].clone();
        let mut all: Vec<f64> =
            self.tops(rest, wave, &peaks, [cost, f64::NEG_INFINITY]).iter().map(|t| t.1).collect();
        if let Some(pitch) = pitch(&wave.places, GRID_SHARE / own) {
            let range = [wave.from.max(0.5 / wave.span), wave.to];
            all.extend(aliases(own, pitch, range, LISTED, usual_mm(wave)));
        }
        all.sort_by(f64::total_cmp);
        let mut out: Vec<(f64, f64)> = Vec::new();
        let mut last = own;
        for f in all {
            let apart = |g: f64| (f - g).abs() * wave.span > RESOLVED;
            let margin = mine - score(f);
            if apart(own) && apart(last) && margin < NO_WORSE && self.bearable(rest, wave, f) {
                out.push((1.0 / (f * wave.unit), margin.max(0.0)));
                last = f;
            }
        }
        out
    }

    /// On a grid there are no more frequencies than places: fewer are paid for. Which of the aliases it is the data cannot
    /// say; the likeliest is given.
    fn likeliest_alias(&self, set: &Set, wave: &Wave, best: &mut Tone, independent: f64, usual_mm: &[f64]) {
        let span = wave.span;
        let Some(pitch) = wave.pitch(GRID_SHARE / best.f) else { return };
        let cost = self.wave_cost(wave);
        best.score += best.cost - cost;
        best.cost = cost;
        let saved = independent.ln() - independent.min((span / pitch).max(2.0)).ln();
        best.cost -= saved;
        best.score += saved;
        let near: Vec<(f64, f64)> =
            aliases(best.f, pitch, [wave.from.max(0.5 / span), wave.to], LISTED, usual_mm)
                .into_iter()
                .map(|g| (self.wave_score(set, wave, g, cost - saved), g))
                .filter(|(s, _)| *s > best.score - 1.0)
                .collect();
        let periods: Vec<f64> = near.iter().map(|(_, g)| 1.0 / g).collect();
        if let Some(i) = likeliest(&periods, usual_mm) {
            (best.score, best.f) = near[i];
        }
        // It is one of so many that look the same: a law of longer periods needs no such chance.
        let alike = (2.0 * best.f * pitch).max(1.0).ln();
        best.cost += alike;
        best.score -= alike;
    }

    /// The least amplitude of a wave of two columns that explains as much of what a set leaves as they do.
    pub(super) fn amplitude(&self, set: &Set, [s, c]: [&[f64]; 2]) -> f64 {
        let (left, _) = self.residual(set);
        let (ss, cc) = (dot(s, s), dot(c, c));
        let mut squares = [ss, 0.0, dot(s, c), cc];
        let mut with = [dot(s, &left), dot(c, &left)];
        cholesky::reduce(&mut squares, &mut with);
        let explained: f64 = with.iter().filter(|w| w.is_finite()).map(|w| w * w).sum();
        // However sine and cosine lie on the places, no smaller amplitude explains so much.
        let largest = f64::midpoint(ss, cc) + f64::hypot((ss - cc) / 2.0, dot(s, c));
        (explained / largest).sqrt()
    }

    pub(super) fn wave_columns(&self, wave: &Wave, f: f64) -> Vec<Vec<f64>> {
        let mut out = vec![vec![0.0; self.stack.n]; 2];
        if let [sines, cosines] = &mut out[..] {
            lanes::waves(f, &wave.along, &mut sines[wave.rows.clone()], &mut cosines[wave.rows.clone()]);
            wave.shared(&mut sines[wave.rows.clone()]);
            wave.shared(&mut cosines[wave.rows.clone()]);
            for (rows, along, share) in &wave.also {
                for ((row, x), share) in rows.clone().zip(along).zip(share) {
                    let (sine, cosine) = lanes::wave(x * f);
                    (sines[row], cosines[row]) = (share * sine, share * cosine);
                }
            }
        }
        for column in &mut out {
            self.stack.weigh(column);
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The frequency of a parabola's lowest point, from a log likelihood that is sharp there.
    #[test]
    fn the_frequency_that_leaves_least_is_between_its_neighbours() {
        let nu = 300.0;
        let score = |f: f64| -0.5 * nu * (0.001 + (f - 2.03).powi(2)).ln();
        let at = |f: f64| (score(f), f);
        let found = least_left([at(1.9), at(2.1)], at(2.0), nu);
        assert!(found.is_some_and(|f| (f - 2.03).abs() < 1e-9), "{found:?}");
        // Uneven neighbours, and one that is not there.
        let found = least_left([at(2.0), at(2.3)], at(2.05), nu);
        assert!(found.is_some_and(|f| (f - 2.03).abs() < 1e-9), "{found:?}");
        assert!(least_left([(f64::NEG_INFINITY, 1.9), at(2.1)], at(2.0), nu).is_none());
        assert!(least_left([at(2.0), at(2.0)], at(2.0), nu).is_none());
    }
}
