//! Non-linear parameters between the points of a grid.

use super::Search;
use super::offers::{Offer, Source};
use super::sets::Set;
use crate::cause::{Cause, Shape};
use crate::extent::{moments, taus};
use crate::teeth::Teeth;
use rtec_model::effect::{Effect, Refine};

impl Search<'_, '_> {
    /// Score of a set with an effect added at its own non-linear parameters, search unpaid.
    pub(crate) fn score_of(&self, set: &Set, hypothesis: usize, effect: &Effect) -> f64 {
        let free: Vec<usize> = (0..effect.coefficient_count()).collect();
        let columns = self.columns(effect, &free, false);
        self.extended(set, &self.made_cross(set, &columns)) - self.price(set, hypothesis, 0.0, columns.len())
    }

    /// Refines the non-linear parameters of an offer to a set.
    pub(super) fn refine(&self, set: &Set, offer: Offer) -> Offer {
        if let Cause::Teeth(shape, teeth) = &offer.cause {
            let (shape, teeth) = (shape.clone(), *teeth);
            return self.sharpened_teeth(set, offer, shape, teeth);
        }
        let Cause::Effect { effect, .. } = &offer.cause else { return offer };
        let parameters = effect.description().parameters.iter().enumerate();
        let refined: Vec<(usize, Refine)> =
            parameters.map(|(i, p)| (i, p.refine)).filter(|(_, r)| *r != Refine::Stays).collect();
        if refined.is_empty() {
            return offer;
        }
        let mut climb = Climb::from(self, set, &offer, effect.clone());
        for (parameter, _) in refined.iter().filter(|(_, r)| *r == Refine::Moment) {
            climb.over_moments(*parameter);
        }
        climb.over_steps(&refined);
        climb.end(offer.evidence)
    }

    /// Turns and phase to the row: the last tooth tells the turns, all of them the phase.
    pub(super) fn sharpened_teeth(&self, set: &Set, offer: Offer, shape: Shape, teeth: Teeth) -> Offer {
        let mut best = (teeth, offer.score, None);
        let (mut turns, mut phase) = (0.04 * teeth.turns, 0.08);
        for _ in 0..12 {
            for (dt, dp) in
                [(turns, 0.0), (-turns, 0.0), (0.0, phase), (0.0, -phase), (turns, -phase), (-turns, phase)]
            {
                let next = Teeth { turns: best.0.turns + dt, phase: best.0.phase + dp, ..best.0 };
                let mut column = next.column(self.stack);
                self.stack.weigh(&mut column);
                let columns = vec![column];
                let score = self.extended(set, &self.made_cross(set, &columns))
                    - self.price(set, offer.hypothesis, offer.cost, 1);
                if score > best.1 {
                    best = (next, score, Some(columns));
                }
            }
            turns *= 0.65;
            phase *= 0.65;
        }
        let (teeth, score, made) = best;
        let columns = made.map_or(offer.columns, Source::Made);
        Offer {
            cause: Cause::Teeth(shape, teeth),
            score,
            evidence: offer.evidence.max(score),
            columns,
            ..offer
        }
    }

    /// Refines each member's non-linear parameters with the others in place.
    pub(crate) fn polish(&mut self, set: Set) -> Set {
        let mut set = set;
        if set.members.len() < 2 {
            return set;
        }
        for i in 0..set.members.len() {
            let rest = self.without(&set, i);
            let member = set.members[i].clone();
            let columns = member.vectors.iter().map(|v| self.vectors[*v].data.clone()).collect();
            let offer = Offer {
                cause: member.cause.clone(),
                hypothesis: member.hypothesis,
                cost: member.cost,
                score: set.score,
                evidence: set.score,
                columns: Source::Made(columns),
            };
            let refined = match self.waves.iter().enumerate().find(|(_, w)| w.hypothesis == member.hypothesis)
            {
                Some((i, w)) => {
                    let mut peaks = self.peaks.borrow()[i].clone();
                    peaks.extend(w.frequency(&member.cause));
                    self.wave(&rest, w, &peaks, set.score).unwrap_or(offer)
                }
                None => self.refine(&rest, offer),
            };
            if refined.score > set.score + 1e-3 {
                let next = self.take(&rest, &refined);
                set = self.in_place_of(next, i);
            }
        }
        set
    }

    /// The set with its last member moved to a place.
    pub(crate) fn in_place_of(&self, set: Set, place: usize) -> Set {
        let mut set = set;
        let mut members = std::mem::take(&mut set.members);
        if let Some(last) = members.pop() {
            members.insert(place, last);
        }
        self.set(members, Some(&set))
    }
}

/// The way of an effect's non-linear parameters to a better score.
struct Climb<'s, 'p, 'r> {
    search: &'s Search<'p, 'r>,
    set: &'s Set,
    free: Vec<usize>,
    reference: bool,
    hypothesis: usize,
    cost: f64,
    effect: Effect,
    score: f64,
    columns: Vec<Vec<f64>>,
}

impl<'s, 'p, 'r> Climb<'s, 'p, 'r> {
    fn from(search: &'s Search<'p, 'r>, set: &'s Set, offer: &Offer, effect: Effect) -> Self {
        let (free, reference) = match &offer.cause {
            Cause::Effect { free, reference, .. } => (free.clone(), *reference),
            Cause::Sum(_) | Cause::Shape(_) | Cause::Teeth(..) => (Vec::new(), false),
        };
        let (score, columns, hypothesis, cost) = (0.0, Vec::new(), offer.hypothesis, offer.cost);
        let mut climb = Self { search, set, free, reference, hypothesis, cost, effect, score, columns };
        (climb.score, climb.columns) = climb.eval(&climb.effect);
        climb
    }

    fn eval(&self, effect: &Effect) -> (f64, Vec<Vec<f64>>) {
        let (search, set) = (self.search, self.set);
        let columns = search.columns(effect, &self.free, self.reference);
        let score = search.extended(set, &search.made_cross(set, &columns))
            - search.price(set, self.hypothesis, self.cost, columns.len());
        (score, columns)
    }

    /// Goes there when it is better.
    fn take(&mut self, parameter: usize, value: f64) -> bool {
        let Some(next) = self.effect.with(&[(parameter, value)]) else { return false };
        let (score, columns) = self.eval(&next);
        let better = score > self.score;
        if better {
            (self.score, self.columns, self.effect) = (score, columns, next);
        }
        better
    }

    /// From moment to moment of the records, first far, then near.
    fn over_moments(&mut self, parameter: usize) {
        let times = moments(self.search.stack);
        let mut reach = (times.len() / 160).max(1) as isize;
        while reach >= 1 {
            for side in [-reach, reach] {
                let now = self.effect.scalar(parameter);
                let at = times.partition_point(|t| *t < now) as isize + side;
                if let Some(t) = usize::try_from(at).ok().and_then(|i| times.get(i)) {
                    self.take(parameter, *t);
                }
            }
            reach = if reach > 1 { (reach * 2 / 3).max(1) } else { 0 };
        }
    }

    /// Steps to either side, each round shorter.
    fn over_steps(&mut self, refined: &[(usize, Refine)]) {
        let longest = taus(self.search.stack).last().copied().unwrap_or(f64::MAX);
        let mut shrink = 1.0;
        for _ in 0..7 {
            for (parameter, refine) in refined {
                for side in [-1.0, 1.0] {
                    let now = self.effect.scalar(*parameter);
                    let next = match refine {
                        Refine::Step(by) => now + side * by * shrink,
                        Refine::Factor(by) | Refine::TimeConstant(by) => now * (side * by * shrink).exp(),
                        Refine::Stays | Refine::Moment => continue,
                    };
                    let too_long = matches!(refine, Refine::TimeConstant(_)) && next > longest;
                    if !too_long && self.take(*parameter, next) {
                        break;
                    }
                }
            }
            shrink *= 0.6;
        }
    }

    /// The offer of where it is now.
    fn end(self, evidence: f64) -> Offer {
        let Self { free, reference, hypothesis, cost, effect, score, columns, .. } = self;
        let cause = Cause::Effect { effect, free, reference };
        let (evidence, columns) = (evidence.max(score), Source::Made(columns));
        Offer { cause, hypothesis, cost, score, evidence, columns }
    }
}
