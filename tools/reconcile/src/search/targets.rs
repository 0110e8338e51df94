//! Periodograms over few targets. There a wave lies on the places like a map, a straight line or another wave, and many explain
//! nearly as much: what each explains is worked out exactly, target by target, beside all else of a set.

use super::Search;
use super::periodogram::peaks;
use super::sets::Set;
use crate::lanes::{self, dot};
use crate::waves::Wave;

/// Over more targets the fast transform tells the waves apart.
const FEW: usize = 40;
/// Rows nearer than this share of the shortest period are of one target.
const ONE_TARGET: f64 = 0.1;
/// More frequencies are not worked out one by one.
const MOST_FREQUENCIES: f64 = 20_000.0;
/// A column of which others explain all but this share is nothing new.
const NOTHING_NEW: f64 = 1e-3;

/// The rows of a wave, target by target.
struct Targets {
    /// Target of each row.
    of: Vec<usize>,
    /// Mean place of each.
    place: Vec<f64>,
    /// Root of its number of rows.
    root: Vec<f64>,
}

impl Targets {
    /// None where the rows are not of few targets.
    fn of(wave: &Wave) -> Option<Self> {
        let near = ONE_TARGET / wave.to;
        let mut first = Vec::new();
        for x in &wave.places {
            if first.last().is_none_or(|f| x - f > near) {
                first.push(*x);
                if first.len() > FEW {
                    return None;
                }
            }
        }
        let of: Vec<usize> = wave.along.iter().map(|x| first.partition_point(|f| f <= x) - 1).collect();
        let (mut place, mut count) = (vec![0.0; first.len()], vec![0.0_f64; first.len()]);
        for (x, t) in wave.along.iter().zip(&of) {
            place[*t] += x;
            count[*t] += 1.0;
        }
        place.iter_mut().zip(&count).for_each(|(p, n)| *p /= n.max(1.0));
        Some(Self { of, place, root: count.into_iter().map(f64::sqrt).collect() })
    }

    /// The mean of rows at each target, weighed by their number.
    fn means(&self, rows: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; self.place.len()];
        rows.iter().zip(&self.of).for_each(|(x, t)| out[*t] += x);
        out.iter_mut().zip(&self.root).for_each(|(o, r)| *o /= r.max(1.0));
        out
    }
}

/// Takes orthonormal directions off a vector.
fn project(v: &mut [f64], off: &[Vec<f64>]) {
    for d in off {
        let share = dot(v, d);
        v.iter_mut().zip(d).for_each(|(v, d)| *v -= share * d);
    }
}

/// Orthonormal directions of columns, without those that the others explain.
fn directions(columns: impl Iterator<Item = Vec<f64>>) -> Vec<Vec<f64>> {
    let mut out: Vec<Vec<f64>> = Vec::new();
    for mut c in columns {
        let whole = dot(&c, &c);
        project(&mut c, &out);
        project(&mut c, &out);
        let left = dot(&c, &c);
        if left > NOTHING_NEW * whole && left > 0.0 {
            for x in &mut c {
                *x /= left.sqrt();
            }
            out.push(c);
        }
    }
    out
}

impl Search<'_, '_> {
    /// Frequencies that explain most of what a set leaves of few targets, added to a list: by themselves, and beside all that
    /// the set and the model's own parameters may do there.
    pub(super) fn peaks_of_targets(
        &self,
        set: &Set,
        wave: &Wave,
        residual: &[f64],
        [from, step]: [f64; 2],
        list: &mut Vec<f64>,
    ) {
        let count = ((wave.to - from) / step).ceil().max(2.0);
        if count > MOST_FREQUENCIES || !wave.share.is_empty() {
            return;
        }
        let Some(targets) = Targets::of(wave) else { return };
        let y = targets.means(&residual[wave.rows.clone()]);
        let columns = set.ids.iter().map(|i| targets.means(&self.vectors[*i].data[wave.rows.clone()]));
        let beside = directions(columns);
        let off = [&[][..], &beside[..]];
        let left = off.map(|off| {
            let mut y = y.clone();
            project(&mut y, off);
            y
        });
        let mut powers = off.map(|_| Vec::with_capacity(count as usize));
        let mut wave = [vec![0.0; y.len()], vec![0.0; y.len()]];
        for i in 0..count as usize {
            let f = from + step * i as f64;
            let [sines, cosines] = &mut wave;
            for ((x, r), (s, c)) in targets.place.iter().zip(&targets.root).zip(sines.iter_mut().zip(cosines))
            {
                let (sin, cos) = lanes::wave(x * f);
                (*s, *c) = (sin * r, cos * r);
            }
            // Nothing is taken off for the first, so that one wave serves both.
            for ((off, y), power) in off.iter().zip(&left).zip(&mut powers) {
                power.push(explained(&mut wave, off, y));
            }
        }
        for mut power in powers {
            peaks(&mut power, from, step, list);
        }
    }
}

/// What sine and cosine explain of a vector once directions are taken off them, that are off the vector too.
fn explained([s, c]: &mut [Vec<f64>; 2], off: &[Vec<f64>], y: &[f64]) -> f64 {
    let whole = dot(s, s) + dot(c, c);
    project(s, off);
    project(c, off);
    let (ss, sc, cc) = (dot(s, s), dot(s, c), dot(c, c));
    let (ys, yc) = (dot(y, s), dot(y, c));
    let both = ss * cc - sc * sc;
    let most = ss.max(cc);
    if both > NOTHING_NEW * most * whole {
        (cc * ys * ys + ss * yc * yc - 2.0 * sc * ys * yc) / both
    } else if most > NOTHING_NEW * whole {
        (if ss > cc { ys } else { yc }).powi(2) / most
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hypotheses::Hypotheses;
    use crate::problem::{Known, Stack};
    use crate::testing::record;
    use rtec_model::effect::Dictionary;

    /// At eleven uneven targets, beside a map of the model that goes along with it, a wave is among the peaks: the
    /// transform's three highest are others.
    #[test]
    fn a_wave_is_found_beside_a_map_that_looks_like_it() {
        let at = [3.0, 21.5, 60.2, 93.7, 117.1, 142.6, 185.0, 221.3, 246.4, 273.9, 316.0];
        let mut run = record(110, |_| 0.0);
        for (row, p) in run.columns[1].data.iter_mut().enumerate() {
            *p = at[row % at.len()];
        }
        let p = run.columns[1].data.clone();
        let wave = |p: f64, period: f64| (std::f64::consts::TAU * p / period + 0.4).sin();
        for (e, p) in run.columns[2].data.iter_mut().zip(&p) {
            *e = 5.0 * wave(*p, 25.3);
        }
        let records = [run];
        let stack = Stack::new(&records);
        let (all, waves) = Hypotheses::new(&stack, &Dictionary::default());
        let mut search = Search::new(&stack, &all, &waves);
        // A slope that has half of the wave in it.
        let column: Vec<f64> = p.iter().map(|p| wave(*p, 25.3) + (p / 40.0).cos()).collect();
        let known = Known { effect: None, along: Vec::new(), column, sd: 1e3, target: 0.0 };
        search.begin(1.0, vec![known], stack.missing(&[]));
        let empty = search.empty();
        let (residual, _) = search.residual(&empty);
        let screw = waves.iter().find(|w| w.effect.as_ref().is_some_and(|e| e.name() == "screw_periodic.x"));
        let (screw, mut list) = (screw.unwrap(), Vec::new());
        let step = 0.3 / screw.span;
        search.peaks_of_targets(&empty, screw, &residual, [screw.from, step], &mut list);
        let near = |f: &f64| (f - 1.0 / 25.3).abs() < step;
        assert!(list.iter().any(near) && list.len() <= 6, "{list:?}");
    }
}
