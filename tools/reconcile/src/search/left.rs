//! What a set leaves of the bank's columns: every grid point is scored from it, and a set that grew out of another
//! begins with what that one left.

use super::Search;
use super::sets::{AtPhi, ROUNDING, Set, same};
use crate::cholesky;
use crate::gram::Products;
use crate::hypotheses::Atom;
use crate::lanes::{dot, minus};
use std::ops::{Index, Range};
use std::rc::Rc;

/// So many are kept.
const KEPT: usize = 64;

/// Nothing over fewer columns than these is no gap.
const GAP: usize = 32;

/// What a vector has in common with each of the bank's columns, beside the vectors before it. With columns of other
/// responses than its own that is nothing: they are passed over.
#[derive(Clone)]
pub(crate) struct Share {
    values: Rc<Vec<f64>>,
    /// Columns outside these have nothing in common with it.
    runs: Rc<[Range<usize>]>,
}

impl Share {
    fn new(values: Vec<f64>) -> Self {
        let mut runs: Vec<Range<usize>> = Vec::new();
        for (i, _) in values.iter().enumerate().filter(|(_, v)| **v != 0.0) {
            match runs.last_mut() {
                Some(run) if i < run.end + GAP => run.end = i + 1,
                _ => runs.push(i..i + 1),
            }
        }
        Self { values: Rc::new(values), runs: runs.into() }
    }

    /// Whether it has nothing in common with any of these columns.
    fn is_nothing(&self, columns: &Range<usize>) -> bool {
        let at = self.runs.partition_point(|run| run.end <= columns.start);
        self.runs.get(at).is_none_or(|run| run.start >= columns.end)
    }

    /// `from - share²` in its place.
    fn take_squares_off(&self, from: &mut [f64]) {
        for run in &*self.runs {
            let (from, values) = (&mut from[run.clone()], &self.values[run.clone()]);
            from.iter_mut().zip(values).for_each(|(f, v)| *f -= v * v);
        }
    }

    /// `from - by·share` in its place.
    pub(crate) fn take_off(&self, by: f64, from: &mut [f64]) {
        for run in &*self.runs {
            minus(&mut from[run.clone()], by, &self.values[run.clone()]);
        }
    }
}

/// How the columns of an atom of several lie in the bank.
pub(super) struct Lie {
    within: Range<usize>,
    columns: Vec<usize>,
    /// One after the other.
    in_a_row: bool,
}

impl Lie {
    /// None for an atom of one column. All that is gone through for every share stands close together this way.
    pub(super) fn of(atom: &Atom) -> Option<Self> {
        let columns = atom.columns.clone();
        let from = columns.iter().copied().min()?;
        let within = from..columns.iter().copied().max()? + 1;
        let in_a_row = columns.iter().copied().eq(within.clone());
        (columns.len() > 1).then_some(Self { within, columns, in_a_row })
    }
}

impl Index<usize> for Share {
    type Output = f64;

    fn index(&self, column: usize) -> &f64 {
        &self.values[column]
    }
}

/// What a set leaves of the bank's columns, at one noise coefficient.
pub(super) struct Left {
    ids: Vec<usize>,
    phi: f64,
    /// Per vector of the set, one value for each column: L⁻¹ of their products.
    shares: Vec<Share>,
    /// Per column: its product with the response, less what the set explains of both.
    with_y: Vec<f64>,
    /// Per column: its product with itself, less the same.
    squares: Vec<f64>,
    /// Atom by atom of several columns: the products among them, packed by rows of the lower triangle, less the same.
    own: Vec<f64>,
}

/// How many products among its columns an atom of several keeps.
fn kept_of(columns: &[usize]) -> usize {
    let k = columns.len();
    if k > 1 { k * (k + 1) / 2 } else { 0 }
}

impl Left {
    /// By how much an atom of several columns shrinks what the set leaves, which is `rss`.
    fn gain(
        &self,
        atom: &Atom,
        full: &[Products],
        own: Range<usize>,
        rss: f64,
        (m, g): (&mut Vec<f64>, &mut Vec<f64>),
    ) -> f64 {
        let k = atom.columns.len();
        m.resize(k * k, 0.0);
        let mut gain = 0.0;
        for ridge in [0.0, cholesky::RIDGE] {
            g.clear();
            g.extend(atom.columns.iter().map(|c| self.with_y[*c]));
            let mut packed = self.own[own.clone()].iter().zip(full);
            for (r, row) in m.chunks_exact_mut(k.max(1)).enumerate() {
                for ((c, m), (own, full)) in row[..=r].iter_mut().enumerate().zip(&mut packed) {
                    *m = match *own {
                        own if c != r => own,
                        own if own < cholesky::KNOWN * full.at(self.phi) => f64::INFINITY,
                        own => own + ridge * full.at(self.phi),
                    };
                }
            }
            cholesky::reduce(m, g);
            gain = dot(g, g);
            if gain <= rss * (1.0 + ROUNDING) {
                break;
            }
        }
        gain
    }
}

impl Search<'_, '_> {
    /// Log likelihood of a set with a grid point's columns beside it, for every grid point of which `wanted` is true.
    pub(super) fn with_atoms(
        &self,
        set: &Set,
        wanted: impl Fn(usize) -> bool,
        mut each: impl FnMut(usize, f64),
    ) {
        let mut left: Vec<Option<Rc<Left>>> = vec![None; set.fits.len()];
        let (mut m, mut g) = (Vec::new(), Vec::new());
        let mut from = 0;
        for (i, atom) in self.all.atoms.iter().enumerate() {
            let full = &self.all.own[i];
            let at = from..from + kept_of(&atom.columns);
            from = at.end;
            if !wanted(i) {
                continue;
            }
            let loglik = self.over_noise(set, |f| {
                let fit = &set.fits[f];
                let left = left[f].get_or_insert_with(|| self.left_of_bank(set, fit));
                let gain = match atom.columns[..] {
                    [one] => {
                        let (with, own) = (left.with_y[one], left.squares[one]);
                        // What the set explains already to 1 part in 10⁶ is no new explanation, and a column of zeros none.
                        if own > cholesky::KNOWN * full[0].at(fit.phi) { with * with / own } else { 0.0 }
                    }
                    _ => left.gain(atom, full, at.clone(), fit.rss, (&mut m, &mut g)),
                };
                self.loglik(fit, gain)
            });
            each(i, loglik);
        }
    }

    fn left_of_bank(&self, set: &Set, fit: &AtPhi) -> Rc<Left> {
        let kept = self.left.borrow();
        let at_phi = || kept.iter().filter(|l| l.phi.to_bits() == fit.phi.to_bits());
        // The set that it grew out of, or as much of it as was kept.
        let begins = |l: &&Rc<Left>| set.ids.starts_with(&l.ids);
        let before = at_phi().filter(begins).max_by_key(|l| l.ids.len()).cloned();
        // Shares of the first vectors are the same in any set that begins with them, whatever comes then.
        let alike = at_phi().max_by_key(|l| same(&l.ids, &set.ids));
        let shares = alike.map_or_else(Vec::new, |l| l.shares[..same(&l.ids, &set.ids)].to_vec());
        drop(kept);
        if let Some(all) = before.as_ref().filter(|l| l.ids.len() == set.ids.len()) {
            return Rc::clone(all);
        }
        let [mut with_y, mut squares, mut own] = self.spare.borrow_mut().pop().unwrap_or_default();
        let known = before.as_ref().map_or(0, |l| l.ids.len());
        if let Some(l) = before {
            with_y.extend_from_slice(&l.with_y);
            squares.extend_from_slice(&l.squares);
            own.extend_from_slice(&l.own);
        } else {
            let bank = &self.all.bank;
            with_y.extend(self.against_bank(self.y).iter().map(|p| p.at(fit.phi)));
            squares.extend((0..bank.len()).map(|c| bank.square(c).at(fit.phi)));
            let several = self.all.own.iter().filter(|own| own.len() > 1);
            own.extend(several.flatten().map(|p| p.at(fit.phi)));
        }
        let shares = self.shares(&set.ids, fit, &shares);
        let mut left = Left { ids: set.ids.clone(), phi: fit.phi, shares, with_y, squares, own };
        for (z, share) in fit.z.iter().zip(&left.shares).skip(known) {
            share.take_off(*z, &mut left.with_y);
            share.take_squares_off(&mut left.squares);
            self.take_off(share, &mut left.own);
        }
        let left = Rc::new(left);
        let mut kept = self.left.borrow_mut();
        kept.push(Rc::clone(&left));
        if kept.len() > KEPT {
            self.recycle(kept.remove(0));
        }
        left
    }

    /// Keeps the room of what is no longer needed.
    fn recycle(&self, left: Rc<Left>) {
        let mut spare = self.spare.borrow_mut();
        if spare.len() < KEPT
            && let Ok(Left { mut with_y, mut squares, mut own, .. }) = Rc::try_unwrap(left)
        {
            with_y.clear();
            squares.clear();
            own.clear();
            spare.push([with_y, squares, own]);
        }
    }

    /// Takes what one share explains of them off the products among each atom's columns.
    fn take_off(&self, share: &Share, own: &mut [f64]) {
        let mut rest = own;
        for Lie { within, columns, in_a_row } in &self.lie {
            let (mut own, behind) = rest.split_at_mut(kept_of(columns));
            rest = behind;
            if share.is_nothing(within) {
                continue;
            }
            for (r, c) in columns.iter().enumerate() {
                let (row, below) = own.split_at_mut(r + 1);
                own = below;
                let by = share[*c];
                // A column of another response than the share's.
                if by == 0.0 {
                    continue;
                }
                if *in_a_row {
                    minus(row, by, &share.values[within.start..=within.start + r]);
                } else {
                    row.iter_mut().zip(columns).for_each(|(o, d)| *o -= by * share[*d]);
                }
            }
        }
    }

    /// L⁻¹ of the products of a fit's vectors with the bank's columns, vector by vector; the first of them are known.
    pub(crate) fn shares(&self, ids: &[usize], fit: &AtPhi, known: &[Share]) -> Vec<Share> {
        let mut shares = known.to_vec();
        for (i, id) in ids.iter().enumerate().skip(known.len()) {
            let row = fit.factor.row(i);
            let mut share: Vec<f64> = self.against_bank(*id).iter().map(|p| p.at(fit.phi)).collect();
            for (l, before) in row.iter().zip(&shares) {
                before.take_off(*l, &mut share);
            }
            for x in &mut share {
                *x /= row[i];
            }
            shares.push(Share::new(share));
        }
        shares
    }

    /// Forgets what was left by sets that have little in common with these.
    pub(super) fn forget_all_but(&self, sets: &[Set]) {
        let all = std::mem::take(&mut *self.left.borrow_mut());
        for left in all {
            if sets.iter().any(|s| 2 * same(&left.ids, &s.ids) >= s.ids.len()) {
                self.left.borrow_mut().push(left);
            } else {
                self.recycle(left);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hypotheses::Hypotheses;
    use crate::problem::Stack;
    use crate::testing::{noise, record};
    use rtec_model::effect::Dictionary;

    /// What is scored from products alone is what a fit of all columns gives, for a set that grew and for one that is new.
    #[test]
    fn a_grid_point_scores_what_its_fit_does() {
        let dice = noise(31, 150);
        let records = [record(150, |i| dice[i as usize] + if i >= 70.0 { 4.0 } else { 0.0 })];
        let stack = Stack::new(&records);
        let (all, waves) = Hypotheses::new(&stack, &Dictionary::default());
        let mut search = Search::new(&stack, &all, &waves);
        search.begin(1.0, Vec::new(), stack.missing(&[]));
        let mut set = search.empty();
        for step in 0..3 {
            let scores = |search: &Search<'_, '_>, set: &Set| {
                let mut out = vec![0.0; all.atoms.len()];
                search.with_atoms(set, |_| true, |i, loglik| out[i] = loglik);
                out
            };
            search.meet_bank(set.ids.iter().copied().chain([search.y]));
            let grown = scores(&search, &set);
            search.forget_all_but(&[]);
            let new = scores(&search, &set);
            let mut alike = 0;
            for (i, atom) in all.atoms.iter().enumerate().step_by(7) {
                let fitted = search.take_atom(&set, atom).loglik;
                assert!((grown[i] - new[i]).abs() < 1e-7, "{step}, {i}: {} and {}", grown[i], new[i]);
                // Not all noise coefficients are looked at.
                assert!(new[i] < fitted + 0.5, "{step}, {i}: {} and {fitted}", new[i]);
                alike += usize::from((new[i] - fitted).abs() < 1e-6);
            }
            assert!(alike * 7 > all.atoms.len() * 3 / 4, "{step}: {alike} alike");
            let best = (0..new.len()).max_by(|a, b| new[*a].total_cmp(&new[*b])).unwrap();
            set = search.take_atom(&set, &all.atoms[best]);
        }
    }

    /// A grid point whose column is zero in all rows explains nothing.
    #[test]
    fn a_column_of_zeros_scores_what_the_set_does() {
        let dice = noise(32, 90);
        let records = [record(90, |i| dice[i as usize])];
        let stack = Stack::new(&records);
        let (mut all, waves) = Hypotheses::new(&stack, &Dictionary::default());
        let column = all.push(&stack, vec![0.0; 90]);
        let nothing = Atom { columns: vec![column], ..all.atoms[0].clone() };
        all.atoms.push(nothing);
        all.own.push(all.bank.own(&[column]));
        let mut search = Search::new(&stack, &all, &waves);
        search.begin(1.0, Vec::new(), stack.missing(&[]));
        let set = search.empty();
        let mut scored = Vec::new();
        search.with_atoms(&set, |i| i + 1 == all.atoms.len(), |_, loglik| scored.push(loglik));
        assert!((scored[0] - set.loglik).abs() < 1e-6, "{scored:?}, not {}", set.loglik);
    }
}
