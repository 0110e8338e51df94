//! What an axis does over one position, chosen anew: a scale, a map and waves stand for one another, a straightness for a squareness
//! and a constant, and of two that were taken for one, or one for two, no exchange of one member leads back.

use crate::hypotheses::Hypothesis;
use crate::problem::leaves_a_line;
use crate::search::{Offer, Search, Set};
use crate::simpler::DECISIVE;
use rtec_model::effect::{Effect, Need};
use rtec_model::record::Axis;

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

/// The laws that do something over one position, by hypothesis.
struct Along {
    plain: Vec<usize>,
    waves: Vec<usize>,
}

/// The set with what each axis does along its position, and each straightness, chosen anew, where that says more, or as much
/// without a map.
pub(crate) fn along_axes(search: &mut Search<'_, '_>, set: Set) -> Set {
    let all = search.all;
    let mut best = set;
    let of = |h: usize| all.list[h].effect.as_ref();
    let mut axes: Vec<Vec<Axis>> = best
        .members
        .iter()
        .filter_map(|m| of(m.hypothesis))
        .filter(|e| leaves_a_line(e) || (is_along(e) && is_wave(e)))
        .map(|e| e.axes().to_vec())
        .collect();
    axes.sort();
    axes.dedup();
    for axes in axes {
        let along = match &axes[..] {
            [_] => Along::one_axis(&all.list, &axes),
            _ => Along::across(&all.list, &axes),
        };
        for start in along.starts(search, &best) {
            let next = along.filled(search, start);
            let next = search.polish(next);
            let is_map = |h: usize| along.has(h) && of(h).is_some_and(leaves_a_line);
            let maps = |s: &Set| s.members.iter().filter(|m| is_map(m.hypothesis)).count();
            // A map that is straight costs one name where a constant and a slope cost two, which is no ground for it.
            let names = next.members.len().saturating_sub(best.members.len()).min(1) as f64;
            let spared = if maps(&next) < maps(&best) { DECISIVE + names * all.family_cost } else { 0.0 };
            let least = best.score - spared;
            if next.score > least {
                best = next;
            }
        }
    }
    best
}

impl Along {
    /// Scale, map and waves of an axis, and what is constant on it.
    fn one_axis(list: &[Hypothesis], axes: &[Axis]) -> Self {
        let own = (0..list.len()).filter(|h| {
            let effect = list[*h].effect.as_ref().filter(|e| e.axes() == axes);
            effect.is_some_and(|e| is_along(e) || e.description().constant)
        });
        let (waves, plain) = own.partition(|h| list[*h].effect.as_ref().is_some_and(is_wave));
        Self { plain, waves }
    }

    /// A straightness, what is in proportion to the same position, and what is constant on its axis.
    fn across(list: &[Hypothesis], axes: &[Axis]) -> Self {
        let plain = (0..list.len()).filter(|h| {
            list[*h].effect.as_ref().is_some_and(|e| {
                let over = |n: &Need| matches!(n, Need::Position(_));
                let both = e.axes().len() == 2 && e.axes().iter().all(|a| axes.contains(a));
                let other_map = leaves_a_line(e) && e.axes() != axes;
                (both && e.description().needs.iter().all(over) && !other_map)
                    || (e.description().constant && e.axes()[0] == axes[0])
            })
        });
        Self { plain: plain.collect(), waves: Vec::new() }
    }

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
    use crate::testing::{circle, noise, record};
    use crate::{Options, reconcile};
    use rtec_model::effect::Dictionary;
    use rtec_model::machine::Machine;

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

    /// A map over the targets of an axis, level beyond them, and a circle that goes farther: even knots over all that was travelled fit
    /// it nowhere, and two or three waves stood for the rest.
    #[test]
    fn a_map_has_its_knots_where_the_axis_was_measured() {
        let knots: Vec<f64> = (0..9).map(|k| 12.4 * f64::from(k)).collect();
        let um = [4.0, -3.0, 6.0, -7.0, 5.0, 2.0, -6.0, 3.0, -4.0];
        let at = |p: f64| {
            let k = knots.partition_point(|k| *k <= p).clamp(1, 8);
            let w = ((p - knots[k - 1]) / 12.4).clamp(0.0, 1.0);
            um[k - 1] + w * (um[k] - um[k - 1])
        };
        for seed in [15, 17] {
            let dice = noise(seed, 600);
            let mut line = record(200, |i| 0.3 * dice[i as usize]);
            let p = line.columns[1].data.clone();
            line.columns[2].data.iter_mut().zip(p).for_each(|(e, p)| *e += at(p));
            let circle = circle(300, 150.0, |a| {
                let row = (a / std::f64::consts::TAU * 299.0).round() as usize;
                a.cos() * at(150.0 * a.cos()) + 0.3 * dice[200 + row]
            });
            let whole = reconcile(&[line, circle], &[], &Machine::ideal("m"), &Options::default()).unwrap();
            let named: Vec<String> = whole.effects.iter().map(|(f, _)| f.effect.name()).collect();
            assert!(named.contains(&"position_map.x".to_owned()), "{seed}: {named:?}");
            assert!(
                !named.iter().any(|n| n.starts_with("screw") || n.starts_with("subdivision")),
                "{seed}: {named:?}"
            );
        }
    }

    /// Out of square by 25 µrad and a constant: a broken line of four knots that is straight was named, and its own rivals, the two,
    /// were likelier.
    #[test]
    fn a_straightness_that_is_straight_gives_way_to_a_squareness() {
        let dice = noise(10, 800);
        let mut line = record(60, |i| 3.0 + 0.5 * dice[i as usize]);
        line.columns[1].data.iter_mut().enumerate().for_each(|(i, p)| *p = 20.0 * (i % 15) as f64);
        let circle = circle(700, 150.0, |a| {
            let row = (a / std::f64::consts::TAU * 699.0).round() as usize;
            a.cos() * (3.0 + 0.025 * 150.0 * a.sin()) + 0.5 * dice[60 + row]
        });
        let records = [line, circle];
        let stack = Stack::new(&records);
        let (all, waves) = Hypotheses::new(&stack, &Dictionary::default());
        let mut search = Search::new(&stack, &all, &waves);
        search.begin(0.5, Vec::new(), stack.missing(&[]));
        let straightness = all.list.iter().position(|h| h.name == "straightness.x.y").unwrap();
        let empty = search.empty();
        let offer = search.offer_of(&empty, straightness).unwrap();
        let set = search.take(&empty, &offer);
        let next = along_axes(&mut search, set);
        let mut names: Vec<&str> =
            next.members.iter().map(|m| all.list[m.hypothesis].name.as_str()).collect();
        names.sort_unstable();
        assert!(
            names.len() == 2 && names[0] == "offset.x" && names[1].starts_with("squareness."),
            "{names:?}"
        );
        // Nor is it taken back as one explanation that does without the constant.
        let whole = reconcile(&records, &[], &Machine::ideal("m"), &Options::default()).unwrap();
        let named: Vec<String> = whole.effects.iter().map(|(f, _)| f.effect.name()).collect();
        assert!(named.len() == 2 && named.contains(&"offset.x".to_owned()), "{named:?}");
        assert!(!named.iter().any(|n| n.starts_with("straightness")), "{named:?}");
    }
}
