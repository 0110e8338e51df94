//! Explanations that could join a set: scanned over all grids, by name, best first.

use super::Search;
use super::cross::Cross;
use super::sets::{Member, Set};
use crate::cause::Cause;
use crate::gram::Products;
use crate::hypotheses::{Atom, Hypothesis};
use rtec_model::effect::Refine;
use std::rc::Rc;

/// So many waves of one law on one axis are looked for: one more than have a name.
const MOST_WAVES: usize = 3;
/// Turns by which two waves must differ over the whole travel.
const RESOLVED: f64 = 1.0;

/// How far behind the best an offer is refined: nats, or as a share of the best one's gain.
const NEAR_NATS: f64 = 25.0;
const NEAR_SHARE: f64 = 0.4;

/// So many nats below a sum a term of it is nothing.
const NOTHING_ADDED: f64 = 40.0;

/// An explanation that could join a set.
#[derive(Debug, Clone)]
pub(crate) struct Offer {
    pub(crate) cause: Cause,
    pub(crate) hypothesis: usize,
    pub(crate) cost: f64,
    /// Score of the set with it.
    pub(crate) score: f64,
    /// The same, averaged over the grid instead of its best point: what the hypothesis as a whole is worth.
    pub(crate) evidence: f64,
    pub(super) columns: Source,
}

#[derive(Debug, Clone)]
pub(super) enum Source {
    Bank(Vec<usize>),
    Made(Vec<Vec<f64>>),
}

/// A name with everything that speaks for it.
pub(crate) struct Ranked {
    pub(crate) name: String,
    pub(crate) evidence: f64,
    /// One per sensor, best first.
    pub(crate) offers: Vec<Offer>,
}

impl Search<'_, '_> {
    /// The best grid point of one hypothesis as an addition to a set: only its own columns are looked at.
    pub(crate) fn offer_of(&self, set: &Set, hypothesis: usize) -> Option<Offer> {
        let first = self.columns_of[hypothesis].start;
        let with_set: Vec<Rc<[Products]>> =
            set.ids.iter().map(|id| self.against_own(*id, hypothesis)).collect();
        let with_y = self.against_own(self.y, hypothesis);
        let mut best: Option<(usize, f64)> = None;
        let own = |(_, atom): &(usize, &Atom)| atom.hypothesis == hypothesis;
        for (i, atom) in self.all.atoms.iter().enumerate().filter(own) {
            let columns = || atom.columns.iter().map(|c| c - first);
            let cross = Cross {
                with_set: columns().flat_map(|c| with_set.iter().map(move |p| p[c])).collect(),
                with_y: columns().map(|c| with_y[c]).collect(),
                own: self.all.own[i].clone(),
            };
            let score =
                self.extended(set, &cross) - self.price(set, atom.hypothesis, atom.cost, atom.columns.len());
            if best.is_none_or(|b| score >= b.1) {
                best = Some((i, score));
            }
        }
        best.map(|(i, score)| self.bank_offer(i, score, score))
    }

    pub(super) fn bank_offer(&self, i: usize, score: f64, evidence: f64) -> Offer {
        let atom: &Atom = &self.all.atoms[i];
        Offer {
            cause: atom.cause.clone(),
            hypothesis: atom.hypothesis,
            cost: atom.cost,
            score,
            evidence,
            columns: Source::Bank(atom.columns.clone()),
        }
    }

    /// The best grid point of every hypothesis as an addition to a set, best first.
    pub(crate) fn scan(&self, set: &Set, fresh: bool) -> Vec<Offer> {
        self.meet_bank(set.ids.iter().copied().chain([self.y]));
        let mut best: Vec<Option<(f64, usize, f64)>> = vec![None; self.all.list.len()];
        // Grid points of one hypothesis stand one after the other, most with as many columns: their freedom costs the same.
        let mut last = (usize::MAX, 0, 0.0);
        self.with_atoms(
            set,
            |_| true,
            |i, loglik| {
                let atom = &self.all.atoms[i];
                let (hypothesis, columns) = (atom.hypothesis, atom.columns.len());
                if (last.0, last.1) != (hypothesis, columns) {
                    last = (hypothesis, columns, self.price(set, hypothesis, 0.0, columns));
                }
                let score = loglik - (last.2 + atom.cost);
                let place = &mut best[atom.hypothesis];
                *place = Some(match *place {
                    None => (score, i, score),
                    Some((s, at, all)) if s >= score => (s, at, log_sum(all, score)),
                    Some((_, _, all)) => (score, i, log_sum(all, score)),
                });
            },
        );
        let mut offers: Vec<Offer> = best
            .into_iter()
            .flatten()
            .map(|(score, i, evidence)| self.bank_offer(i, score, evidence))
            .collect();
        let tops = self.tops_of_kinds(set, &offers);
        for (i, wave) in self.waves.iter().enumerate() {
            if fresh {
                self.find_peaks(set, i);
            }
            let top = tops[usize::from(self.all.list[wave.hypothesis].named())];
            offers.extend(self.wave(set, wave, &self.peaks.borrow()[i], nearest(set, top)));
        }
        offers.sort_by(|a, b| b.score.total_cmp(&a.score));
        offers
    }

    /// The best scores of shapes and of names that may join a set.
    fn tops_of_kinds(&self, set: &Set, offers: &[Offer]) -> [f64; 2] {
        let mut tops = [f64::NEG_INFINITY; 2];
        for o in offers {
            let top = &mut tops[usize::from(self.all.list[o.hypothesis].named())];
            if o.score > *top && !self.repeats(set, o) {
                *top = o.score;
            }
        }
        tops
    }

    /// The set with an offer taken in.
    pub(crate) fn take(&mut self, set: &Set, offer: &Offer) -> Set {
        let columns = match &offer.columns {
            Source::Bank(at) => self.of_bank(at),
            Source::Made(columns) => columns.clone(),
        };
        self.joined_by(set, &offer.cause, offer.hypothesis, offer.cost, columns)
    }

    /// Whether an offer repeats what a set has: the same hypothesis, unless it may stand twice. Waves of one law may,
    /// each told from the others over what was travelled.
    pub(crate) fn repeats(&self, set: &Set, offer: &Offer) -> bool {
        let may = |h: &Hypothesis| h.law().is_some_and(|l| l.searched.repeats);
        let alike = |m: &&Member| {
            let (a, b) = (&self.all.list[m.hypothesis], &self.all.list[offer.hypothesis]);
            m.hypothesis == offer.hypothesis && !(a.named() && a.name != b.name)
        };
        let same: Vec<&Member> = set.members.iter().filter(alike).collect();
        let Some(first) = same.first() else { return false };
        if !may(&self.all.list[first.hypothesis]) {
            return true;
        }
        let Some(wave) = self.waves.iter().find(|w| w.hypothesis == offer.hypothesis) else { return false };
        let near = |m: &&Member| {
            let both = wave.frequency(&m.cause).zip(wave.frequency(&offer.cause));
            both.is_some_and(|(a, b)| (a - b).abs() * wave.span < RESOLVED)
        };
        same.len() >= MOST_WAVES || same.iter().any(near)
    }

    /// Named explanations as additions to a set, by name: the evidence of each name over all its sensors and grid
    /// points, with its best offers refined. Best first.
    pub(crate) fn ranking(&self, set: &Set) -> Rc<[Ranked]> {
        let key: Vec<usize> =
            set.ids.iter().copied().chain(set.members.iter().map(|m| m.hypothesis)).collect();
        if let Some(known) = self.rankings.borrow().get(&key) {
            return Rc::clone(known);
        }
        let ranking: Rc<[Ranked]> = self.ranked(set).into();
        self.rankings.borrow_mut().insert(key, Rc::clone(&ranking));
        ranking
    }

    pub(super) fn ranked(&self, set: &Set) -> Vec<Ranked> {
        let mut out: Vec<Ranked> = Vec::new();
        for offer in self.scan(set, false) {
            let hypothesis = &self.all.list[offer.hypothesis];
            if !hypothesis.named() || self.repeats(set, &offer) {
                continue;
            }
            match out.iter_mut().find(|r| r.name == hypothesis.name) {
                Some(r) => {
                    r.evidence = log_sum(r.evidence, offer.evidence);
                    r.offers.push(offer);
                }
                None => out.push(Ranked {
                    name: hypothesis.name.clone(),
                    evidence: offer.evidence,
                    offers: vec![offer],
                }),
            }
        }
        let top = out.iter().map(|r| r.evidence).fold(f64::NEG_INFINITY, f64::max);
        for (i, r) in out.iter_mut().enumerate() {
            // Far behind, no refinement will bring it back.
            let close = near(set, top, r.evidence) || i < 2;
            let offers = std::mem::take(&mut r.offers);
            r.offers = offers
                .into_iter()
                .enumerate()
                .map(|(k, o)| if close && k < 3 { self.refine(set, o) } else { o })
                .collect();
            r.offers.sort_by(|a, b| b.score.total_cmp(&a.score));
            r.evidence = r.evidence.max(r.offers[0].score);
        }
        out.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
        out
    }

    /// Best additions to a set, refined: so many named and so many unnamed.
    pub(crate) fn offers(&self, set: &Set, named: usize, unnamed: usize, fresh: bool) -> Vec<Offer> {
        let mut left = [unnamed, named];
        let mut out = Vec::new();
        let mut sensors: Vec<(String, usize)> = Vec::new();
        let mut top = [f64::NEG_INFINITY; 2];
        for offer in self.scan(set, fresh) {
            let hypothesis = &self.all.list[offer.hypothesis];
            let kind = usize::from(hypothesis.named());
            let room = &mut left[kind];
            if *room == 0 || self.repeats(set, &offer) {
                continue;
            }
            top[kind] = top[kind].max(offer.score);
            // A moment of the grid may be far from the moment itself.
            let jumps =
                hypothesis.law().is_some_and(|l| l.parameters.iter().any(|p| p.refine == Refine::Moment));
            if !jumps && !near(set, top[kind], offer.score) {
                continue;
            }
            // Many sensors of one law must not crowd out other laws.
            let law = if hypothesis.named() { hypothesis.name.clone() } else { offer.hypothesis.to_string() };
            match sensors.iter_mut().find(|(l, _)| *l == law) {
                Some((_, n)) if *n >= 2 => continue,
                Some((_, n)) => *n += 1,
                None => sensors.push((law, 1)),
            }
            *room -= 1;
            out.push(self.refine(set, offer));
        }
        out.sort_by(|a, b| b.score.total_cmp(&a.score));
        out
    }
}

/// Whether an offer is so near the best that refining it may make it the best: refined, an effect gains a few nats, or a
/// share of what it gains anyway.
fn near(set: &Set, top: f64, score: f64) -> bool {
    score > nearest(set, top)
}

/// The score from which on it is.
fn nearest(set: &Set, top: f64) -> f64 {
    top - NEAR_NATS.max(NEAR_SHARE * (top - set.score))
}

/// log(eᵃ + eᵇ)
fn log_sum(a: f64, b: f64) -> f64 {
    let (hi, lo) = if a > b { (a, b) } else { (b, a) };
    // Of a number with sixteen digits nothing changes.
    if lo < hi - NOTHING_ADDED { hi } else { hi + (lo - hi).exp().ln_1p() }
}
