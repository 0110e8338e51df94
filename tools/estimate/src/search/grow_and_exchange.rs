//! Growth of sets, and exchange and removal of their members.

use super::screening::parameter_steps;
use super::{HypothesisSearch, HypothesisSet, HypothesisSetMember, ScreenedHypothesis, same_period};
use crate::candidate_hypotheses::{HypothesesOfOneName, HypothesisSearchSpace};
use crate::hypothesis_contribution::HypothesisContribution;
use crate::search_limits::{HOPELESS, KEPT, STRONG, TRIED, WORTHLESS};
use rtec_model::effect::Effect;
use rtec_model::record::Axis;

impl HypothesisSearch<'_> {
    /// Sets with one more member, best first.
    #[must_use]
    pub fn grown(&self, set: &HypothesisSet, most: usize, long: bool) -> Vec<HypothesisSet> {
        self.grown_by(set, most, long, |_| true)
    }

    /// Sets with one more member of families of one kind.
    pub(super) fn grown_by(
        &self,
        set: &HypothesisSet,
        most: usize,
        long: bool,
        kind: impl Fn(&HypothesesOfOneName) -> bool,
    ) -> Vec<HypothesisSet> {
        let seeds = self.screened(set, long);
        let mut seeds = seeds.iter().filter(|s| kind(self.family(s.family))).peekable();
        let Some(top) = seeds.peek().map(|s| s.score) else { return Vec::new() };
        let mut out: Vec<HypothesisSet> = Vec::new();
        let mut forms: Vec<(f64, usize, HypothesisSetMember)> = Vec::new();
        let mut pairs: Vec<HypothesisSet> = Vec::new();
        let mut waves: Vec<usize> = Vec::new();
        for (number, seed) in seeds.take(TRIED).enumerate() {
            if seed.score < (top - HOPELESS).max(WORTHLESS) {
                break;
            }
            let wave = matches!(self.family(seed.family).scan, HypothesisSearchSpace::Wave { .. });
            let pair = |seed| self.with(set, seed).and_then(|p| self.with_beside(&p));
            // A wave alone may be refined to another peak than with its companion.
            pairs.extend(wave.then(|| pair(seed)).flatten());
            let seed = self.refined(&set.factor, seed);
            let mut own = Self::richer(&seed);
            pairs.extend(wave.then(|| pair(&seed)).flatten());
            if wave && !waves.contains(&seed.family) {
                waves.push(seed.family);
                own.extend(self.changing(&set.factor, &seed));
            }
            own.push(seed);
            forms
                .extend(own.iter().filter_map(|f| self.weighed(set, f)).map(|(score, m)| (score, number, m)));
        }
        out.extend(pairs.into_iter().max_by(|a, b| a.score.total_cmp(&b.score)).map(|p| self.in_tune(p)));
        // Only sets that are kept are fitted.
        forms.sort_by(|a, b| b.0.total_cmp(&a.0));
        let counts = |m: &HypothesisSetMember| m.cause.effect().is_some_and(|e| e.description().whole_counts);
        let mut done: Vec<usize> = Vec::new();
        for (_, number, member) in forms {
            if done.contains(&number) || done.len() >= most && !counts(&member) {
                continue;
            }
            if let Some(built) = self.built(set, member) {
                done.push(number);
                out.push(built);
            }
        }
        out.sort_by(|a, b| b.score.total_cmp(&a.score));
        out.truncate(most);
        out
    }

    /// Adds, to a set that ends in a wave, the effects that only accompany waves.
    pub(super) fn with_beside(&self, set: &HypothesisSet) -> Option<HypothesisSet> {
        let last = set.members.last()?.cause.effect()?;
        let of = |(number, f): (usize, &HypothesesOfOneName)| {
            let HypothesisSearchSpace::Beside { law, .. } = &f.scan else { return None };
            let effect = f.effect.as_ref()?;
            if *law != last.description().name || effect.axes() != last.axes() {
                return None;
            }
            let effect = effect.with(&[(0, last.scalar(0))])?;
            let same = |m: &HypothesisSetMember| {
                m.family == number && m.cause.effect().is_some_and(|e| same_period(e, &effect))
            };
            if set.members.iter().any(same) {
                return None;
            }
            let cause = HypothesisContribution::Effect { effect, free: 2, reference: false };
            self.with(set, &ScreenedHypothesis { family: number, cause, weight: 0.0, score: 0.0 })
        };
        let best = self
            .families
            .list
            .iter()
            .enumerate()
            .filter_map(of)
            .max_by(|a, b| a.score.total_cmp(&b.score))?;
        // Before the periods agree, both members explain less.
        Some(best).filter(|s| s.score > set.score - HOPELESS)
    }

    /// Tunes the last two members, a wave and its companion, to one period.
    /// The period is where both explain most.
    pub(super) fn in_tune(&self, mut set: HypothesisSet) -> HypothesisSet {
        let n = set.members.len();
        let (Some(wave), HypothesisSearchSpace::Wave { along, unit, .. }) =
            (set.members[n - 2].cause.effect().cloned(), &self.family(set.members[n - 2].family).scan)
        else {
            return set;
        };
        let mut frequency = 1.0 / wave.scalar(0);
        let mut step = 0.2 / along.span() * unit;
        let others = self.first(&set, n - 2);
        let at = |set: &HypothesisSet, frequency: f64| {
            let mut members = set.members.clone();
            for m in &mut members[n - 2..] {
                let effect = m.cause.effect()?.with(&[(0, 1.0 / frequency)])?;
                m.cause = m.cause.with_effect(effect);
                m.set_columns(self.columns(&m.cause));
            }
            Some(self.grown_from(others.clone(), members, n - 2))
        };
        for _ in 0..12 {
            let tried = [-step, step].map(|by| at(&set, frequency + by).map(|s| (s, frequency + by)));
            let better = tried.into_iter().flatten().max_by(|a, b| a.0.score.total_cmp(&b.0.score));
            match better {
                Some((s, f)) if s.score > set.score => (set, frequency) = (s, f),
                _ => step *= 0.4,
            }
        }
        // In tune both may be larger than each was alone.
        let leveled = self.refined_last(&set, n - 2);
        self.refined_last(&leveled, n - 2)
    }

    /// Whether all members have names.
    pub(super) fn is_named(&self, set: &HypothesisSet) -> bool {
        set.members.iter().all(|m| {
            self.family(m.family).is_named()
                && matches!(
                    m.cause,
                    HypothesisContribution::Effect { .. } | HypothesisContribution::Map { .. }
                )
        })
    }

    /// Sets with one more member: the best ones, and the best ones with names.
    pub(super) fn children(&self, set: &HypothesisSet, long: bool) -> Vec<HypothesisSet> {
        let mut all = self.grown(set, KEPT + 1, long);
        if all.iter().filter(|s| self.family(s.members[s.members.len() - 1].family).is_named()).count() < 2 {
            all.extend(self.grown_by(set, 2, long, HypothesesOfOneName::is_named));
        }
        all
    }

    /// The best set that can be reached from a set.
    /// With `regrow`, several sets first grow from it in parallel.
    #[must_use]
    pub fn best(&self, start: &HypothesisSet, regrow: bool) -> HypothesisSet {
        let mut best = start.clone();
        let mut beam = if regrow { vec![start.clone()] } else { Vec::new() };
        let mut idle = 0;
        while idle < 2 && !beam.is_empty() {
            let mut next: Vec<HypothesisSet> =
                beam.iter().enumerate().flat_map(|(i, s)| self.children(s, i == 0)).collect();
            next.sort_by(|a, b| b.score.total_cmp(&a.score));
            // A shape can replace several names at once, so sets of names only have reserved places.
            let mut kept: Vec<HypothesisSet> = Vec::new();
            let mut named = 0;
            for s in next {
                let all_named = self.is_named(&s);
                let room = kept.len() < KEPT || (all_named && named < 2);
                if room && kept.iter().all(|k| (k.score - s.score).abs() > 1e-6 || differ(k, &s)) {
                    named += usize::from(all_named);
                    kept.push(s);
                }
            }
            match kept.first() {
                Some(s) if s.score > best.score => {
                    best = s.clone();
                    idle = 0;
                }
                _ => idle += 1,
            }
            kept.retain(|s| s.score > best.score - HOPELESS);
            beam = kept;
        }
        self.polished(best)
    }

    /// The best set reached by exchanging two members.
    /// Returns the same set if none is better.
    #[must_use]
    pub fn exchanged(&self, start: &HypothesisSet) -> HypothesisSet {
        let mut best = start.clone();
        while !best.members.is_empty() && (best.members.len() > 1 || !self.is_named(&best)) {
            let exchanged = self.two_for_two(&self.simpler(&best));
            if exchanged.score < best.score + 0.05 {
                break;
            }
            best = self.polished(exchanged);
        }
        best
    }

    /// Leaves out, exchanges and refines members until nothing improves.
    pub(super) fn polished(&self, mut best: HypothesisSet) -> HypothesisSet {
        for _ in 0..6 {
            let before = best.score;
            for i in (0..best.members.len()).rev() {
                let without = self.without(&best, i);
                if without.score > best.score && self.possible(&without) {
                    best = without;
                    continue;
                }
                for other in self.grown(&without, 1, false) {
                    if other.score > best.score + 1e-6 {
                        best = other;
                    }
                }
            }
            best = self.together(best);
            for other in self.grown(&best, 1, true) {
                if other.score > best.score {
                    best = other;
                }
            }
            if best.score < before + 0.05 {
                break;
            }
        }
        best
    }

    /// Exchanges each shape, and each two of the weakest members, for two others.
    pub(super) fn two_for_two(&self, set: &HypothesisSet) -> HypothesisSet {
        let mut best = set.clone();
        let alone: Vec<f64> = (0..set.members.len()).map(|i| self.without(set, i).score).collect();
        let mut weak: Vec<usize> = (0..set.members.len()).collect();
        weak.sort_by(|a, b| alone[*b].total_cmp(&alone[*a]));
        let is_shape = |i: &usize| matches!(set.members[*i].cause, HypothesisContribution::Shape(_));
        let mut gone: Vec<(HypothesisSet, bool)> =
            weak.iter().filter(|i| is_shape(i)).map(|i| (self.without(set, *i), true)).collect();
        weak.retain(|i| set.score - alone[*i] < STRONG);
        weak.truncate(3);
        for (k, i) in weak.iter().enumerate() {
            let both = |j: &usize| self.without(&self.without(set, *i.max(j)), *i.min(j));
            gone.extend(weak[..k].iter().map(|j| (both(j), false)));
        }
        for (without, was_shape) in gone {
            // A shape may stand for fine waves over a long travel, which elsewhere are too slow to look at.
            let mut ones = self.children(&without, was_shape);
            if was_shape {
                // Of names that act together, each alone may be far behind another kind.
                ones.extend(KINDS.iter().flat_map(|kind| self.grown_by(&without, 2, true, kind)));
            }
            for one in ones {
                let one = self.rechosen(one);
                if one.score > best.score + 1e-6 {
                    best = one.clone();
                }
                for two in self.grown(&one, 1, false) {
                    if two.score > best.score + 1e-6 {
                        best = two;
                    }
                }
            }
        }
        best
    }

    /// Re-selects the members that act on the same axis as the new last member.
    pub(super) fn rechosen(&self, set: HypothesisSet) -> HypothesisSet {
        let last = set.members.len() - 1;
        let Some(own) = set.members.last().and_then(axis_of) else { return set };
        self.chosen_again(set, &own, last)
    }

    /// Re-selects up to `most` members of an axis: maps and temperature laws.
    pub(super) fn chosen_again(&self, mut set: HypothesisSet, axis: &Axis, most: usize) -> HypothesisSet {
        for i in (0..most).rev() {
            let m = &set.members[i];
            let grid = matches!(self.family(m.family).scan, HypothesisSearchSpace::Grid(_))
                && !matches!(m.cause, HypothesisContribution::Map { .. });
            if axis_of(m).as_ref() != Some(axis) || grid {
                continue;
            }
            let without = self.without(&set, i);
            if let Some(other) = self.grown_by(&without, 1, false, HypothesesOfOneName::is_named).pop()
                && other.score > set.score
            {
                set = other;
            }
        }
        set
    }

    /// Exchanges a law and its companion for the law alone, with another reference.
    /// For example, an expansion and a scale error may be one expansion from another temperature.
    fn one_for_two(&self, set: &HypothesisSet) -> HypothesisSet {
        let mut best = set.clone();
        for (i, m) in set.members.iter().enumerate() {
            let Some(companion) = m.cause.effect().and_then(Effect::companion) else { continue };
            let same =
                |o: &HypothesisSetMember| o.cause.effect().is_some_and(|e| e.name() == companion.name());
            let Some(j) = set.members.iter().position(same) else { continue };
            let others = self.without(&self.without(set, i.max(j)), i.min(j));
            let own = self.family(m.family);
            best = self
                .grown_by(&others, 1, false, |f| std::ptr::eq(f, own))
                .into_iter()
                .fold(best, |best, one| if one.score > best.score { one } else { best });
        }
        best
    }

    /// A set without one of its weaker members; the others on its axis are re-selected.
    pub(super) fn simpler(&self, set: &HypothesisSet) -> HypothesisSet {
        let mut best = self.one_wave_for_two(&self.one_for_two(set));
        for i in 0..set.members.len() {
            let Some(axis) = axis_of(&set.members[i]) else { continue };
            let without = self.without(set, i);
            if set.score - without.score > 2.0 * STRONG {
                continue;
            }
            let most = without.members.len();
            let other = self.chosen_again(without, &axis, most);
            if other.score > best.score {
                best = other;
            }
        }
        best
    }

    /// Refines each member's non-linear parameters given the others', twice.
    pub(super) fn together(&self, mut set: HypothesisSet) -> HypothesisSet {
        if set.members.len() < 2 {
            return set;
        }
        for i in 0..set.members.len() {
            let m = set.members[i].clone();
            if m.cause.effect().is_none_or(|e| parameter_steps(self.family(m.family), e).is_empty()) {
                continue;
            }
            let without = self.without(&set, i);
            let seed = ScreenedHypothesis { family: m.family, cause: m.cause, weight: 0.0, score: 0.0 };
            let refined = self.refined(&without.factor, &seed);
            if refined.cause.effect() == seed.cause.effect() {
                continue;
            }
            let mut members = set.members.clone();
            members[i].set_columns(self.columns(&refined.cause));
            members[i].cause = refined.cause;
            let new = self.grown_from(self.first(&set, i), members, i);
            if new.score > set.score && self.possible(&new) {
                set = new;
            }
        }
        set
    }
}

/// Kinds of effects by their scan: waves, laws of temperatures, others.
const KINDS: [fn(&HypothesesOfOneName) -> bool; 3] = [
    |f| f.is_named() && matches!(f.scan, HypothesisSearchSpace::Wave { .. }),
    |f| f.is_named() && matches!(f.scan, HypothesisSearchSpace::Sensors { .. }),
    |f| f.is_named() && matches!(f.scan, HypothesisSearchSpace::Grid(_)),
];

/// The axis that a member acts on.
pub(super) fn axis_of(m: &HypothesisSetMember) -> Option<Axis> {
    m.cause.effect().and_then(|e| e.axes().first().cloned())
}

/// Whether two sets consist of different families.
pub(super) fn differ(a: &HypothesisSet, b: &HypothesisSet) -> bool {
    let of = |s: &HypothesisSet| {
        let mut f: Vec<usize> = s.members.iter().map(|m| m.family).collect();
        f.sort_unstable();
        f
    };
    of(a) != of(b)
}
