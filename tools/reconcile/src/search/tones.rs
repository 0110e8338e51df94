//! Waves of one frequency against sets: what was worked out for one set serves all that begin with the same vectors.

use super::Search;
use super::sets::{AtPhi, Set, same};
use crate::cholesky;
use crate::gram::{Products, products};
use crate::lanes::{dot, dots};
use crate::waves::Wave;
use std::ops::Range;

/// Values that the waves that were looked at may keep: 64 MB.
pub(super) const ROOM: usize = 8_000_000;

/// A wave of one frequency.
pub(super) struct Seen {
    /// Sine and cosine, where there is room for them.
    columns: Option<Vec<Vec<f64>>>,
    /// Of the sine with itself, of the cosine with the sine, of the cosine with itself.
    own: [Products; 3],
    /// Products with vectors, those that were asked for: by the vector's number, in rising order.
    with: Vec<(usize, [Products; 2])>,
    /// Per noise coefficient: against the set that was the last.
    solved: Vec<Solved>,
}

impl Seen {
    /// Forgets what was worked out for sets: their vectors stay, what the model's file says of them does not.
    pub(super) fn forget_sets(&mut self) {
        self.solved.clear();
    }
}

/// L⁻¹ of the products of sine and cosine with a set's vectors.
#[derive(Default)]
struct Solved {
    ids: Vec<usize>,
    sines: Vec<f64>,
    cosines: Vec<f64>,
}

impl Solved {
    /// The same for another set: from where the vectors are others.
    fn go_to(&mut self, ids: &[usize], fit: &AtPhi, mut with: impl FnMut(usize) -> [Products; 2]) {
        let same = same(&self.ids, ids);
        self.sines.truncate(same);
        self.cosines.truncate(same);
        self.ids.clear();
        self.ids.extend_from_slice(ids);
        for (i, id) in ids.iter().enumerate().skip(same) {
            let [sine, cosine] = with(*id).map(|p| p.at(fit.phi));
            let row = fit.factor.row(i);
            let [known_sine, known_cosine] = dots(&self.sines, &self.cosines, &row[..i]);
            self.sines.push((sine - known_sine) / row[i]);
            self.cosines.push((cosine - known_cosine) / row[i]);
        }
    }
}

impl Search<'_, '_> {
    /// Score of a set with a wave of one frequency beside it.
    pub(super) fn wave_score(&self, set: &Set, wave: &Wave, f: f64, cost: f64) -> f64 {
        let ranges = &wave.segments[..];
        let mut all = self.seen.borrow_mut();
        let first = || self.first_seen(wave, f, ranges);
        let Seen { columns, own, with, solved } =
            all.entry((wave.hypothesis, f.to_bits())).or_insert_with(first);
        let (mut made, mut last) = (None, 0);
        let mut with = |id: usize| -> [Products; 2] {
            // Vectors are asked for one after the other: most often it is the next.
            let next = with.get(last + 1).is_some_and(|(known, _)| *known == id);
            let at = if next { last + 1 } else { with.partition_point(|(known, _)| *known < id) };
            last = at;
            if with.get(at).is_none_or(|(known, _)| *known != id) {
                let c = match columns {
                    Some(kept) => &*kept,
                    None => made.get_or_insert_with(|| self.wave_columns(wave, f)),
                };
                with.insert(at, (id, self.vectors[id].products_with([&c[0], &c[1]], ranges)));
            }
            with[at].1
        };
        let with_y = with(self.y);
        if solved.len() < set.fits.len() {
            solved.resize_with(set.fits.len(), Solved::default);
        }
        let loglik = self.over_noise(set, |i| {
            let fit = &set.fits[i];
            let Solved { sines, cosines, .. } = {
                solved[i].go_to(&set.ids, fit, &mut with);
                &solved[i]
            };
            let [sine, cosine] = with_y.map(|p| p.at(fit.phi));
            let mut g = [sine - dot(sines, &fit.z), cosine - dot(cosines, &fit.z)];
            let [ss, cs, cc] = own.map(|p| p.at(fit.phi));
            let new = |full: f64, left: f64| if left < cholesky::KNOWN * full { f64::INFINITY } else { left };
            let mut m = [
                new(ss, ss - dot(sines, sines)),
                0.0,
                cs - dot(cosines, sines),
                new(cc, cc - dot(cosines, cosines)),
            ];
            cholesky::reduce(&mut m, &mut g);
            self.loglik(fit, dot(&g, &g))
        });
        loglik - self.price(set, wave.hypothesis, cost, 2)
    }

    fn first_seen(&self, wave: &Wave, f: f64, ranges: &[Range<usize>]) -> Seen {
        let c = self.wave_columns(wave, f);
        let own = [(0, 0), (1, 0), (1, 1)].map(|(i, j): (usize, usize)| products(&c[i], &c[j], ranges));
        let kept = self.room.get().checked_sub(2 * self.stack.n);
        if let Some(left) = kept {
            self.room.set(left);
        }
        Seen { columns: kept.map(|_| c), own, with: Vec::new(), solved: Vec::new() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hypotheses::Hypotheses;
    use crate::problem::Stack;
    use crate::testing::{circle, column, noise, record};
    use rtec_model::effect::Dictionary;
    use rtec_model::record::{Axis, Kind, Record, Role};
    use std::path::Path;

    /// A bug once: of a wave that a ballbar reads as well the axis's own rows alone were scored, so that periods were given that
    /// look the same at targets 20 mm apart and explain nothing of the circle. Another, where the circle's rows stand first: none
    /// between the last of them and the first were.
    #[test]
    fn a_wave_is_scored_at_all_rows_that_show_it() {
        let wave = |p: f64| 5.0 * (std::f64::consts::TAU * p / 14.2 + 0.4).sin();
        let dice = noise(3, 200);
        let mut line = record(60, |_| 0.0);
        for (i, p) in line.columns[1].data.iter_mut().enumerate() {
            *p = 20.0 * (i % 15) as f64;
        }
        let p = line.columns[1].data.clone();
        line.columns[2]
            .data
            .iter_mut()
            .zip(p)
            .enumerate()
            .for_each(|(i, (e, p))| *e = wave(p) + 0.1 * dice[i]);
        let circle = circle(140, 150.0, |a| {
            let row = (a / std::f64::consts::TAU * 139.0).round() as usize;
            a.cos() * wave(150.0 * a.cos()) + 0.1 * dice[60 + row]
        });
        // Another axis, whose rows stand between those of the two in some orders.
        let of_y = |i: usize| dice[i] * 0.1;
        let y = || Axis::new("y").unwrap();
        let columns = vec![
            column("t", Role::Time, (0..50).map(f64::from).collect()),
            column("y", Role::Position(y()), (0..50).map(|i| 7.0 * f64::from(i)).collect()),
            column("e", Role::Error(y()), (0..50).map(of_y).collect()),
        ];
        let sideways = Record::new(Path::new("y.run.toml"), Kind::Positioning, columns).unwrap();
        for records in [[&line, &circle, &sideways], [&circle, &sideways, &line], [&circle, &line, &sideways]]
        {
            let records = records.map(Clone::clone);
            let stack = Stack::new(&records);
            let (all, waves) = Hypotheses::new(&stack, &Dictionary::default());
            let mut search = Search::new(&stack, &all, &waves);
            search.begin(1.0, Vec::new(), stack.missing(&[]));
            let empty = search.empty();
            let is_screw = |h: usize| all.list[h].name == "screw_periodic.x";
            let offer = search.scan(&empty, true).into_iter().find(|o| is_screw(o.hypothesis)).unwrap();
            let taken = search.take(&empty, &offer);
            let off = (taken.score - offer.score).abs();
            assert!(off < 1e-6 * offer.score.abs(), "{} {}", taken.score, offer.score);
            let found = search.effects(&taken).pop().flatten().unwrap();
            assert!((found.scalar(0) - 14.2).abs() < 0.01, "{:?}", found.values());
        }
    }
}
