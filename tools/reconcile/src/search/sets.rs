//! Sets of explanations, each fitted at every noise coefficient together with the model's own parameters, and what such a
//! fit says.

use super::{NOISE_GRID, NOISE_STEP, Search};
use crate::cause::Cause;
use crate::cholesky::{Cholesky, KNOWN, RIDGE};
use crate::hypotheses::Atom;
use crate::lanes::dot;
use crate::problem::{Segment, rms};
use rtec_model::effect::{ANOTHER_REFERENCE, Against, Effect};
use std::ops::Range;

/// Autocorrelation from row to row beyond which rows say the same thing over and over.
const CLOSE: f64 = 0.8;

/// Coefficients beside the rows of a response: a fit of more says nothing, however little it leaves, and each beyond that costs
/// so many nats. Of so many that are chosen for what they explain, a search finds as many more as it may take.
const MOST_CROWDED: f64 = 0.4;
const BEYOND_CROWDED: f64 = 1e4;

/// So much less than nothing may be left of all there is.
pub(super) const ROUNDING: f64 = 1e-9;

/// A fit at one noise coefficient.
#[derive(Debug, Clone)]
pub(crate) struct AtPhi {
    pub(crate) phi: f64,
    pub(crate) factor: Cholesky,
    /// L⁻¹ of the right-hand side.
    pub(crate) z: Vec<f64>,
    pub(crate) rss: f64,
    /// What noise of this memory adds to the log likelihood.
    pub(crate) memory: f64,
}

/// An accepted explanation inside a set.
#[derive(Debug, Clone)]
pub(crate) struct Member {
    pub(crate) cause: Cause,
    pub(crate) hypothesis: usize,
    pub(crate) cost: f64,
    pub(super) vectors: Vec<usize>,
}

impl Member {
    /// Number of its coefficients.
    pub(crate) fn columns(&self) -> usize {
        self.vectors.len()
    }
}

/// A set of explanations, fitted.
#[derive(Debug, Clone)]
pub(crate) struct Set {
    pub(crate) members: Vec<Member>,
    /// Log likelihood less the price of all freedom.
    pub(crate) score: f64,
    pub(crate) loglik: f64,
    pub(crate) fits: Vec<AtPhi>,
    pub(crate) ids: Vec<usize>,
    /// Per response: how many coefficients it has there.
    pub(super) crowd: Vec<f64>,
    /// Which of its fits is the best.
    top: usize,
}

impl Set {
    /// Its best fit and the two beside it: what joins it is looked at there first.
    pub(super) fn near(&self) -> Range<usize> {
        let to = (self.top + 2).clamp(3.min(self.fits.len()), self.fits.len());
        to.saturating_sub(3)..to
    }

    /// Coefficients at its best noise coefficient: known parameters' changes, then members' in order.
    pub(crate) fn coefficients(&self) -> Vec<f64> {
        let fit = &self.fits[self.top];
        let mut beta = fit.z.clone();
        fit.factor.backward(&mut beta);
        beta
    }
}

/// How many vectors two sets begin with alike.
pub(super) fn same(a: &[usize], b: &[usize]) -> usize {
    a.iter().zip(b).take_while(|(a, b)| a == b).count()
}

impl Search<'_, '_> {
    /// Fits at every noise coefficient. What they have in common with those of another set, which begins with some of the same
    /// vectors, is taken from it.
    fn fits(&self, ids: &[usize], like: Option<&Set>) -> Vec<AtPhi> {
        let same = like.map_or(0, |set| same(&set.ids, ids));
        let known =
            |phi: f64| like?.fits.iter().find(|f| f.phi.to_bits() == phi.to_bits()).map(|f| (f, same));
        let of = |&phi: &f64| {
            let (fit, sound) = self.fit(ids, phi, known(phi), 0.0);
            if sound { fit } else { self.fit(ids, phi, None, RIDGE).0 }
        };
        self.phis.iter().map(of).collect()
    }

    /// One fit, and whether it explains no more than there is; `like`: one of which so many vectors are the same.
    fn fit(&self, ids: &[usize], phi: f64, like: Option<(&AtPhi, usize)>, ridge: f64) -> (AtPhi, bool) {
        let b = ids.len();
        let same = like.map_or(0, |l| l.1);
        let (mut a, mut g) = (vec![0.0; b * b], vec![0.0; b]);
        for i in same..b {
            for (a, j) in a[i * b..=i * b + i].iter_mut().zip(ids) {
                *a = self.pair(ids[i], *j).at(phi);
            }
            a[i * b + i] *= 1.0 + ridge;
            g[i] = self.pair(ids[i], self.y).at(phi);
        }
        let mut rss = self.pair(self.y, self.y).at(phi);
        for (i, k) in self.known.iter().enumerate() {
            // What the file says of a parameter counts as one more observation of it.
            let w = (self.noise / k.sd).powi(2);
            if i >= same {
                a[i * b + i] += w;
                g[i] += w * k.target;
            }
            rss += w * k.target * k.target;
        }
        let (factor, mut z) = match like {
            Some((fit, same)) => {
                g[..same].copy_from_slice(&fit.z[..same]);
                (Cholesky::growing(&fit.factor, same, &a, b, KNOWN), g)
            }
            None => (Cholesky::dropping(&a, b, KNOWN), g),
        };
        factor.forward_from(same, &mut z);
        let left = rss - dot(&z, &z);
        let memory = 0.5 * self.stack.ranges.len() as f64 * (1.0 - phi * phi).ln();
        (AtPhi { phi, factor, z, rss: left.max(1e-9), memory }, left > -ROUNDING * rss)
    }

    pub(crate) fn loglik(&self, at: &AtPhi, gain: f64) -> f64 {
        self.loglik_of(at, (at.rss - gain).max(1e-9 * at.rss))
    }

    /// Log likelihood where a fit would leave another sum of squares.
    pub(crate) fn loglik_of(&self, at: &AtPhi, rss: f64) -> f64 {
        -0.5 * self.nu * (rss / self.nu).ln() + at.memory
    }

    /// Best over the noise coefficient, from values on its grid: a parabola through the best three.
    /// `from`: where on the grid the first of the values is.
    pub(crate) fn best_phi(&self, loglik: &[f64], from: usize) -> (f64, f64) {
        let top = (0..loglik.len()).max_by(|a, b| loglik[*a].total_cmp(&loglik[*b])).unwrap_or(0);
        if top == 0 || top + 1 == loglik.len() {
            return (loglik[top], self.phis[from + top]);
        }
        let (a, b, c) = (loglik[top - 1], loglik[top], loglik[top + 1]);
        let bend = a - 2.0 * b + c;
        let shift = if bend < 0.0 { 0.5 * (a - c) / bend } else { 0.0 };
        let at = (f64::from(*NOISE_GRID.start()) + (from + top) as f64 + shift) * NOISE_STEP;
        (b - 0.25 * (a - c) * shift, at.tanh())
    }

    /// What so many coefficients of one explanation cost: of many none can be large everywhere, so that each is looked
    /// for in a smaller room (a prior of unit information shared among them).
    pub(crate) fn dimension_cost(&self, columns: usize) -> f64 {
        let k = columns as f64;
        0.5 * k * (1.0 + self.stack.n as f64 / k.max(1.0)).ln()
    }

    /// What so many coefficients of all explanations together cost in a response beyond that: where they are not few beside
    /// its rows, columns of noise shrink what is left of it by more than half a nat each.
    fn crowding(&self, response: usize, columns: f64) -> f64 {
        let nu = self.nu * self.rows_of[response] as f64 / self.stack.n as f64;
        let share = columns / nu.max(1.0);
        let beyond = (share - MOST_CROWDED).max(0.0) * nu.max(1.0);
        let share = share.min(MOST_CROWDED);
        -0.5 * nu * ((1.0 - share).ln() + share) + BEYOND_CROWDED * beyond
    }

    /// The same for so many more of a hypothesis, beside those that a set has.
    pub(crate) fn crowding_cost(&self, set: &Set, hypothesis: usize, columns: usize) -> f64 {
        let of = |(response, share): &(usize, f64)| {
            let own = set.crowd[*response];
            self.crowding(*response, own + share * columns as f64) - self.crowding(*response, own)
        };
        self.acts_on[hypothesis].iter().map(of).sum()
    }

    /// A set of these members; `like`: another one of the same search, of which it may have the first members.
    pub(super) fn set(&self, members: Vec<Member>, like: Option<&Set>) -> Set {
        let mut ids = self.slopes.clone();
        ids.extend(members.iter().flat_map(|m| m.vectors.iter().copied()));
        let fits = self.fits(&ids, like);
        let values: Vec<f64> = fits.iter().map(|f| self.loglik(f, 0.0)).collect();
        let (loglik, _) = self.best_phi(&values, 0);
        let top = (0..values.len()).max_by(|a, b| values[*a].total_cmp(&values[*b])).unwrap_or(0);
        let mut crowd = vec![0.0; self.rows_of.len()];
        for m in &members {
            for (response, share) in &self.acts_on[m.hypothesis] {
                crowd[*response] += share * m.columns() as f64;
            }
        }
        let each = members.iter().map(|m| m.cost + self.dimension_cost(m.columns()));
        let crowded = crowd.iter().enumerate().map(|(j, columns)| self.crowding(j, *columns));
        let price = each.sum::<f64>() + crowded.sum::<f64>();
        Set { members, score: loglik - price, loglik, fits, ids, crowd, top }
    }

    pub(crate) fn empty(&self) -> Set {
        self.set(Vec::new(), None)
    }

    /// The set without one member.
    pub(crate) fn without(&self, set: &Set, member: usize) -> Set {
        let mut members = set.members.clone();
        members.remove(member);
        self.set(members, Some(set))
    }

    /// By how much a set is better than another. The sizes of several responses' noise were taken from what the search
    /// had found, which made whatever it found in one of them look certain: here each set has its own.
    pub(crate) fn gain(&self, from: &Set, to: &Set) -> f64 {
        let by_score = to.score - from.score;
        if self.stack.responses.len() == 1 {
            return by_score;
        }
        let own = |set: &Set| {
            let (residual, phi) = self.residual(set);
            let white = sharpened(&residual, phi, &self.stack.ranges);
            let mut loglik = 0.5 * self.stack.ranges.len() as f64 * (1.0 - phi * phi).ln();
            for j in 0..self.stack.responses.len() {
                let rows =
                    || self.stack.segments.iter().filter(|s| s.response == j).flat_map(|s| s.rows.clone());
                let squares: f64 = rows().map(|i| residual[i] * white[i]).sum();
                let n = rows().count() as f64;
                loglik -= 0.5 * n * (squares.max(1e-9) / n).ln();
            }
            loglik - (set.loglik - set.score)
        };
        by_score.min(own(to) - own(from))
    }

    /// By how much a score is larger than in the responses' own units, for what they are weighed by.
    pub(crate) fn weight(&self) -> f64 {
        let of = |s: &Segment| s.rows.len() as f64 * self.stack.sigma[s.response].max(f64::MIN_POSITIVE).ln();
        self.stack.segments.iter().map(of).sum::<f64>() * self.nu / self.stack.n.max(1) as f64
    }

    /// What the set leaves unexplained, weighed.
    pub(crate) fn residual(&self, set: &Set) -> (Vec<f64>, f64) {
        let fit = &set.fits[set.top];
        (self.left(set, fit), fit.phi)
    }

    /// What a set leaves with the coefficients of one of its fits.
    pub(super) fn left(&self, set: &Set, fit: &AtPhi) -> Vec<f64> {
        let mut beta = fit.z.clone();
        fit.factor.backward(&mut beta);
        let mut r = self.vectors[self.y].data.clone();
        for (b, i) in beta.iter().zip(&set.ids) {
            r.iter_mut().zip(&self.vectors[*i].data).for_each(|(r, x)| *r -= b * x);
        }
        r
    }

    /// Root mean square of what one member of a set does to the rows that it acts on, weighed.
    pub(crate) fn share(&self, set: &Set, member: usize) -> f64 {
        let mut does = self.does(set, member);
        does.retain(|d| *d != 0.0);
        rms(&does)
    }

    /// What one member of a set does, weighed.
    pub(crate) fn does(&self, set: &Set, member: usize) -> Vec<f64> {
        let beta = set.coefficients();
        let before: usize = set.members[..member].iter().map(Member::columns).sum();
        let mut does = vec![0.0; self.stack.n];
        for (b, i) in beta[self.slopes.len() + before..].iter().zip(&set.members[member].vectors) {
            does.iter_mut().zip(&self.vectors[*i].data).for_each(|(d, x)| *d += b * x);
        }
        does
    }

    /// Plain products of what one member of a set does with the bank's columns.
    pub(crate) fn does_against_bank(&self, set: &Set, member: usize) -> Vec<f64> {
        let beta = set.coefficients();
        let before: usize = set.members[..member].iter().map(Member::columns).sum();
        let mut out = vec![0.0; self.all.bank.len()];
        for (b, i) in beta[self.slopes.len() + before..].iter().zip(&set.members[member].vectors) {
            out.iter_mut().zip(self.against_bank(*i)).for_each(|(o, p)| *o += b * p.at(0.0));
        }
        out
    }

    /// The effects that a set's members stand for; none for a shape.
    pub(crate) fn effects(&self, set: &Set) -> Vec<Option<Effect>> {
        let beta = set.coefficients();
        let mut at = self.slopes.len();
        let of = |m: &Member| {
            at += m.columns();
            m.cause.effect(self.stack, &beta[at - m.columns()..at])
        };
        set.members.iter().map(of).collect()
    }

    /// Whether the rows stand closer together than noise forgets: what a set leaves of them repeats from row to row.
    pub(crate) fn oversampled(&self, set: &Set) -> bool {
        let (r, _) = self.residual(set);
        let (mut with_next, mut squares) = (0.0, 0.0);
        for s in &self.stack.ranges {
            let r = &r[s.clone()];
            with_next += dot(&r[1..], &r[..r.len() - 1]);
            squares += dot(r, r);
        }
        with_next > CLOSE * squares
    }

    /// The set with a grid point taken in.
    pub(crate) fn take_atom(&mut self, set: &Set, atom: &Atom) -> Set {
        self.joined_by(set, &atom.cause, atom.hypothesis, atom.cost, self.of_bank(&atom.columns))
    }

    pub(super) fn of_bank(&self, columns: &[usize]) -> Vec<Vec<f64>> {
        let bank = &self.all.bank;
        columns.iter().map(|c| bank.column(*c).into_iter().map(|x| x * bank.scale[*c]).collect()).collect()
    }

    pub(crate) fn joined_by(
        &mut self,
        set: &Set,
        cause: &Cause,
        hypothesis: usize,
        cost: f64,
        columns: Vec<Vec<f64>>,
    ) -> Set {
        let height = cause.is_map();
        let vectors = columns.into_iter().map(|c| self.register(c, height)).collect();
        let mut members = set.members.clone();
        members.push(Member { cause: cause.clone(), hypothesis, cost, vectors });
        self.set(members, Some(set))
    }

    /// The set with a constant taken for the reference temperature of the thermal law that it stands beside: the same
    /// columns, and one effect less.
    pub(crate) fn with_references(&mut self, set: Set) -> Set {
        for j in (0..set.members.len()).rev() {
            let Cause::Effect { effect, free, reference: false } = &set.members[j].cause else { continue };
            let (mut cause, effect, free) = (set.members[j].cause.clone(), effect.clone(), free.clone());
            if !effect.delta.as_ref().is_some_and(|d| matches!(d.against, Against::Standard)) {
                continue;
            }
            let Some(level) = effect.companion().map(|level| level.name()) else { continue };
            let is_level = |m: &Member| self.all.list[m.hypothesis].name == level;
            let Some(i) = set.members.iter().position(is_level) else { continue };
            if let Cause::Effect { reference, .. } = &mut cause {
                *reference = true;
            }
            let Member { hypothesis, cost, .. } = set.members[j];
            let rest = self.without(&self.without(&set, i.max(j)), i.min(j));
            let columns = self.columns(&effect, &free, true);
            let next = self.joined_by(&rest, &cause, hypothesis, cost + ANOTHER_REFERENCE, columns);
            if next.score > set.score {
                return self.with_references(next);
            }
        }
        set
    }

    pub(crate) fn named(&self, set: &Set) -> bool {
        set.members.iter().all(|m| self.all.list[m.hypothesis].named())
    }

    /// The first member of a set whose effect is outside its law's bounds.
    pub(super) fn unphysical(&self, set: &Set) -> Option<usize> {
        self.effects(set).iter().position(|e| e.as_ref().is_some_and(|e| !e.is_physical()))
    }

    /// Whether all its effects are inside their laws' bounds: outside them nothing is named.
    pub(crate) fn physical(&self, set: &Set) -> bool {
        self.unphysical(set).is_none()
    }

    /// The set without the members outside their laws' bounds.
    pub(crate) fn bounded(&self, set: Set) -> Set {
        let mut set = set;
        while let Some(i) = self.unphysical(&set) {
            set = self.without(&set, i);
        }
        set
    }
}

/// K·r with K = `WᵀW`, the inverse covariance of the noise.
pub(super) fn sharpened(r: &[f64], phi: f64, segments: &[std::ops::Range<usize>]) -> Vec<f64> {
    let mut out: Vec<f64> = r.iter().map(|x| (1.0 + phi * phi) * x).collect();
    for s in segments {
        for i in s.clone() {
            if i > s.start {
                out[i] -= phi * r[i - 1];
            }
            if i + 1 < s.end {
                out[i] -= phi * r[i + 1];
            }
        }
        out[s.start] -= phi * phi * r[s.start];
        out[s.end - 1] -= phi * phi * r[s.end - 1];
    }
    out
}

#[cfg(test)]
mod tests {
    use super::super::Search;
    use crate::hypotheses::Hypotheses;
    use crate::problem::Stack;
    use crate::testing::{noise, record};
    use rtec_model::effect::Dictionary;

    /// A map with a knot for every other row fits noise as it fits anything: it is worth less than nothing, whatever it leaves.
    /// One of a quarter of the rows is judged by what it explains.
    #[test]
    fn more_coefficients_than_two_fifths_of_the_rows_say_nothing() {
        let dice = noise(41, 60);
        let records = [record(60, |i| dice[i as usize])];
        let stack = Stack::new(&records);
        let (all, waves) = Hypotheses::new(&stack, &Dictionary::default());
        let mut search = Search::new(&stack, &all, &waves);
        search.begin(1.0, Vec::new(), stack.missing(&[]));
        let mut set = search.empty();
        let (mut within, mut beyond) = (0, 0);
        for h in 0..all.list.len() {
            let Some(offer) = search.offer_of(&set, h) else { continue };
            let next = search.take(&set, &offer);
            let share = next.ids.len() as f64 / 60.0;
            if share <= 0.4 {
                assert!(
                    (next.score - offer.score).abs() < 1.0 && next.score > -500.0,
                    "{share}: {}",
                    next.score
                );
                within += 1;
                set = next;
            } else if share > 0.5 {
                assert!(next.score < -1e4 && offer.score < -1e4, "{share}: {} {}", next.score, offer.score);
                beyond += 1;
            }
        }
        assert!(within > 5 && beyond > 0, "{within} {beyond}");
    }
}
