//! What an axis does along its own position, chosen anew: a scale, a map and waves stand for one another, and of a map and a scale
//! that were taken for a wave no exchange of one member leads back.

use crate::problem::leaves_a_line;
use crate::search::{Offer, Search, Set};
use rtec_model::effect::{Effect, Need};

/// Knots of the plain map that a wave is looked for beside.
const PLAIN: usize = 6;
/// Laws of an axis's position that are taken one after the other.
const MOST: usize = 4;

/// An effect along the position of the one axis that it is of.
fn is_along(effect: &Effect) -> bool {
    let finer = effect.description().searched.wave.is_some() && !is_wave(effect);
    effect.axes().len() == 1 && effect.description().needs == [Need::Position(0)] && !finer
}

/// A wave of millimetres: those of a scale's own period are finer than any map.
fn is_wave(effect: &Effect) -> bool {
    effect.description().searched.wave.is_some_and(|w| w.unit_mm >= 1.0)
}

/// The laws of one axis's position, by hypothesis.
struct Along {
    plain: Vec<usize>,
    waves: Vec<usize>,
}

/// The set with what each axis does along its position chosen anew, where that says more or the same with less.
pub(crate) fn along_axes(search: &mut Search<'_, '_>, set: Set) -> Set {
    let all = search.all;
    let mut best = set;
    let of = |h: usize| all.list[h].effect.as_ref().filter(|e| is_along(e));
    let mut axes: Vec<_> = best
        .members
        .iter()
        .filter_map(|m| of(m.hypothesis))
        .filter(|e| leaves_a_line(e) || is_wave(e))
        .map(|e| e.axes()[0].clone())
        .collect();
    axes.sort();
    axes.dedup();
    for axis in axes {
        let own = (0..all.list.len()).filter(|h| of(*h).is_some_and(|e| e.axes()[0] == axis));
        let (waves, plain) = own.partition(|h| of(*h).is_some_and(is_wave));
        let along = Along { plain, waves };
        for start in along.starts(search, &best) {
            let next = along.filled(search, start);
            let next = search.polish(next);
            if next.score > best.score {
                best = next;
            }
        }
    }
    best
}

impl Along {
    fn has(&self, hypothesis: usize) -> bool {
        self.plain.contains(&hypothesis) || self.waves.contains(&hypothesis)
    }

    /// The set without any of these laws, and then one of each in turn; a wave also as it is found beside a plain map, which then
    /// goes.
    fn starts(&self, search: &mut Search<'_, '_>, set: &Set) -> Vec<Set> {
        let all = search.all;
        let mut rest = set.clone();
        while let Some(i) = rest.members.iter().position(|m| self.has(m.hypothesis)) {
            rest = search.without(&rest, i);
        }
        let is_map = |h: &usize| all.list[*h].effect.as_ref().is_some_and(leaves_a_line);
        let mut from = vec![rest.clone()];
        for map in self.plain.iter().filter(|h| is_map(h)) {
            let plain = all.atoms.iter().filter(|a| a.hypothesis == *map && a.columns.len() <= PLAIN);
            let plain: Vec<Set> = plain.map(|a| search.take_atom(&rest, a)).collect();
            from.extend(plain.into_iter().max_by(|a, b| a.score.total_cmp(&b.score)));
        }
        let mut out = Vec::new();
        for from in from {
            for wave in &self.waves {
                let Some(offer) = search.wave_offer(&from, *wave) else { continue };
                let mut start = search.take(&from, &offer);
                if start.members.len() > rest.members.len() + 1 {
                    start = search.without(&start, rest.members.len());
                }
                out.push(start);
            }
        }
        for h in &self.plain {
            let offer = search.offer_of(&rest, *h);
            out.extend(offer.map(|o| search.take(&rest, &o)));
        }
        out
    }

    /// The best of these laws taken one after the other, as long as that says more; a map is chosen again beside what came later.
    fn filled(&self, search: &mut Search<'_, '_>, start: Set) -> Set {
        let mut set = start;
        for _ in 0..MOST {
            let mut best: Option<Offer> = None;
            for h in self.plain.iter().chain(&self.waves) {
                let wave = self.waves.contains(h);
                let offer = if wave { search.wave_offer(&set, *h) } else { search.offer_of(&set, *h) };
                let offer = offer.filter(|o| o.score > set.score + 1e-6 && !search.repeats(&set, o));
                if let Some(offer) = offer.filter(|o| best.as_ref().is_none_or(|b| o.score > b.score)) {
                    best = Some(offer);
                }
            }
            let Some(offer) = best else { break };
            set = search.take(&set, &offer);
            set = self.again(search, set);
        }
        set
    }

    /// Each of these laws that has no period once more beside the others; what is worth nothing goes.
    fn again(&self, search: &mut Search<'_, '_>, set: Set) -> Set {
        let mut set = set;
        let mut i = 0;
        while i < set.members.len() {
            let h = set.members[i].hypothesis;
            if !self.has(h) {
                i += 1;
                continue;
            }
            let rest = search.without(&set, i);
            if rest.score > set.score {
                set = rest;
                continue;
            }
            if self.plain.contains(&h)
                && let Some(offer) = search.offer_of(&rest, h).filter(|o| o.score > set.score + 1e-6)
            {
                let next = search.take(&rest, &offer);
                set = search.in_place_of(next, i);
            }
            i += 1;
        }
        set
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hypotheses::Hypotheses;
    use crate::problem::Stack;
    use crate::testing::{noise, record};
    use rtec_model::effect::Dictionary;

    /// A screw of 47 mm and a scale: a map of many knots was taken for both, and no exchange of one member led back from it.
    #[test]
    fn a_map_that_was_taken_for_a_wave_and_a_scale_gives_way_to_both() {
        let dice = noise(9, 200);
        let mut run = record(200, |i| 0.3 * dice[i as usize]);
        let p = run.columns[1].data.clone();
        let wave = |p: f64| 3.0 * (std::f64::consts::TAU * p / 47.0 + 0.7).sin();
        run.columns[2].data.iter_mut().zip(p).for_each(|(e, p)| *e += wave(p) + 0.05 * p);
        let records = [run];
        let stack = Stack::new(&records);
        let (all, waves) = Hypotheses::new(&stack, &Dictionary::default());
        let mut search = Search::new(&stack, &all, &waves);
        search.begin(1.0, Vec::new(), stack.missing(&[]));
        let by_name = |n: &str| all.list.iter().position(|h| h.name == n).unwrap();
        let mut set = search.empty();
        for name in ["position_map.x", "scale.x"] {
            let offer = search.offer_of(&set, by_name(name)).unwrap();
            set = search.take(&set, &offer);
        }
        let names = |s: &Set| {
            let mut of: Vec<_> = s.members.iter().map(|m| all.list[m.hypothesis].name.clone()).collect();
            of.sort();
            of
        };
        assert_eq!(names(&set), ["position_map.x", "scale.x"]);
        let next = along_axes(&mut search, set.clone());
        assert!(next.score > set.score + 20.0, "{} {}", next.score, set.score);
        assert_eq!(names(&next), ["scale.x", "screw_periodic.x"]);
        let again = along_axes(&mut search, next.clone());
        assert_eq!((names(&again), again.score), (names(&next), next.score));
    }
}
