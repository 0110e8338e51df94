//! The search itself: a beam over sets of explanations.

use super::Search;
use super::offers::Offer;
use super::sets::Set;

/// How wide the search goes.
const BEAM_NAMED: usize = 3;

const BEAM_UNNAMED: usize = 2;
/// How many offers a set of names takes, named and unnamed, and how many one with a shape.
const OFFERS_TO_NAMES: [usize; 2] = [7, 4];
const OFFERS_TO_SHAPES: [usize; 2] = [3, 0];

/// Most effects that are looked for at once.
const DEPTH: usize = 14;
/// Sets of more members are polished only where they lead.
const POLISHED: usize = 2;
/// A set so far behind the best of its kind is not grown.
const BEHIND: f64 = 60.0;

/// What a search found: the best sets of each size and kind, best first.
pub(crate) struct Found {
    pub(crate) named: Set,
    pub(crate) any: Set,
    /// Sets of names only that were visited, best first.
    pub(crate) visited: Vec<Set>,
}

impl Search<'_, '_> {
    /// Beam search over sets of explanations.
    pub(crate) fn run(&mut self) -> Found {
        let empty = self.empty();
        let mut beam = vec![empty.clone()];
        let mut found = Found { named: empty.clone(), any: empty.clone(), visited: vec![empty] };
        for _ in 0..DEPTH {
            let lifted = self.lifted(&beam);
            beam.extend(lifted);
            let grown = self.grown(&beam);
            let before = found.any.score.max(found.named.score);
            let best = grown.iter().map(|s| s.score).fold(f64::NEG_INFINITY, f64::max);
            let names = grown.iter().filter(|s| self.named(s));
            let best_named = names.map(|s| s.score).fold(f64::NEG_INFINITY, f64::max);
            for set in &grown {
                if self.named(set) {
                    if set.score > found.named.score {
                        found.named = set.clone();
                    }
                    found.visited.push(set.clone());
                }
                if set.score > found.any.score {
                    found.any = set.clone();
                }
            }
            // A level that does not pay ends the search, for names and for anything.
            if best <= before && best_named < found.named.score {
                break;
            }
            let leads = |named: bool| {
                let of = grown.iter().filter(|s| self.named(s) == named);
                of.map(|s| s.score).fold(f64::NEG_INFINITY, f64::max)
            };
            let (names, shapes) = (leads(true), leads(false));
            let near = |s: &Set| s.score > if self.named(s) { names } else { shapes } - BEHIND;
            beam = grown.iter().filter(|s| near(s)).cloned().collect();
        }
        found.visited.sort_by(|a, b| b.score.total_cmp(&a.score));
        found
    }

    /// Sets of one member more: the best few of names alone and the best few with a shape.
    fn grown(&mut self, beam: &[Set]) -> Vec<Set> {
        self.forget_all_but(beam);
        self.meet_bank(beam.iter().flat_map(|s| s.ids.iter().copied()).chain([self.y]));
        let mut next: Vec<(usize, Offer)> = Vec::new();
        for (i, set) in beam.iter().enumerate() {
            let [named, unnamed] = if self.named(set) { OFFERS_TO_NAMES } else { OFFERS_TO_SHAPES };
            next.extend(self.offers(set, named, unnamed, i == 0).into_iter().map(|o| (i, o)));
        }
        next.sort_by(|a, b| b.1.score.total_cmp(&a.1.score));
        let mut seen: Vec<Vec<usize>> = Vec::new();
        let mut room = [BEAM_UNNAMED, BEAM_NAMED];
        let mut grown = Vec::new();
        for (i, offer) in next {
            let set = &beam[i];
            let mut key: Vec<usize> =
                set.members.iter().map(|m| m.hypothesis).chain([offer.hypothesis]).collect();
            key.sort_unstable();
            let pure = self.named(set) && self.all.list[offer.hypothesis].named();
            if room[usize::from(pure)] == 0 || seen.contains(&key) {
                continue;
            }
            seen.push(key);
            let leads = room[usize::from(pure)] == [BEAM_UNNAMED, BEAM_NAMED][usize::from(pure)];
            room[usize::from(pure)] -= 1;
            let set = self.take(set, &offer);
            // The others are polished once they lead.
            grown.push(if leads || set.members.len() <= POLISHED { self.polish(set) } else { set });
        }
        grown
    }

    /// The best set of names with a constant beside it: what starts from anywhere (a drift from the mean that the
    /// record was zeroed at) pays only together with its constant, and neither pays alone.
    pub(super) fn lifted(&mut self, beam: &[Set]) -> Vec<Set> {
        let Some(set) = beam.iter().find(|s| self.named(s)).cloned() else { return Vec::new() };
        let all = self.all;
        all.atoms
            .iter()
            .filter(|a| all.list[a.hypothesis].is_offset())
            .filter(|a| set.members.iter().all(|m| m.hypothesis != a.hypothesis))
            .map(|a| self.take_atom(&set, a))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hypotheses::Hypotheses;
    use crate::problem::Stack;
    use crate::testing::{noise, record};
    use rtec_model::effect::Dictionary;
    use rtec_model::record::Record;

    /// What a search finds in one record.
    fn found(record: Record) -> (Vec<String>, Vec<Option<rtec_model::effect::Effect>>) {
        let records = [record];
        let stack = Stack::new(&records);
        let (all, waves) = Hypotheses::new(&stack, &Dictionary::default());
        let mut search = Search::new(&stack, &all, &waves);
        search.begin(1.0, Vec::new(), stack.missing(&[]));
        let found = search.run();
        // What comes next takes out what only another one's values called for.
        let named = crate::simpler::slimmed(&mut search, found.named);
        let mut names: Vec<String> =
            named.members.iter().map(|m| search.all.list[m.hypothesis].name.clone()).collect();
        names.sort();
        (names, search.effects(&named))
    }

    #[test]
    fn two_effects_at_once_are_found_and_nothing_in_noise() {
        let dice = noise(21, 300);
        let mut run = record(300, |i| dice[i as usize] + if i >= 140.0 { 6.0 } else { 0.0 });
        let p = run.columns[1].data.clone();
        for (e, p) in run.columns[2].data.iter_mut().zip(&p) {
            *e += 0.3 * p;
        }
        let (names, effects) = found(run);
        assert_eq!(names, ["lost_counts.x", "scale.x"]);
        let step = effects.iter().flatten().find(|e| e.description().whole_counts).unwrap();
        assert!((step.scalar(1) - 700.0).abs() < 1e-9, "refined to the row: {}", step.scalar(1));
        assert!(found(record(300, |i| dice[i as usize])).0.is_empty());
    }

    /// A wave between the grid's frequencies is refined; one of more than a quarter of its signal period is no
    /// interpolation error, whatever it explains.
    #[test]
    fn a_wave_is_found_at_its_period_and_not_beyond_its_bounds() {
        let dice = noise(22, 400);
        let wave = |um: f64, period_mm: f64| {
            let mut run = record(400, |i| 0.1 * dice[i as usize]);
            // At random places no wave looks like another.
            let p: Vec<f64> = noise(23, 400).iter().map(|x| 20.0 * x).collect();
            run.columns[1].data.clone_from(&p);
            for (e, p) in run.columns[2].data.iter_mut().zip(&p) {
                *e += um * (std::f64::consts::TAU * p / period_mm).sin();
            }
            found(run)
        };
        let (names, effects) = wave(1.0, 7.3);
        assert_eq!(names, ["screw_periodic.x"]);
        assert!((effects[0].as_ref().unwrap().scalar(0) - 7.3).abs() < 0.01);
        let (names, _) = wave(2.0, 0.02);
        assert_eq!(names, ["subdivision.x"]);
        let (names, _) = wave(9.0, 0.02);
        assert!(!names.contains(&"subdivision.x".to_owned()), "{names:?}");
    }
}
