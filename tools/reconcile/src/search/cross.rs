//! What further columns add to a set, from products alone: no fit is made anew.

use super::Search;
use super::sets::Set;
use crate::gram::{self, Products, covered, dot, products};

/// Room for the sums of one fit after the other.
#[derive(Default)]
pub(super) struct Scratch {
    values: Vec<f64>,
    a: Vec<f64>,
    m: Vec<f64>,
    g: Vec<f64>,
}

/// The columns of a hypothesis against a set: products with the set's vectors, with the response, among themselves.
pub(super) struct Cross {
    /// `[column][vector of the set]`
    pub(super) with_set: Vec<Vec<Products>>,
    pub(super) with_y: Vec<Products>,
    pub(super) own: Vec<Products>,
}

impl Search<'_, '_> {
    pub(super) fn price(&self, set: &Set, cost: f64, columns: usize) -> f64 {
        set.loglik - set.score + cost + self.dimension_cost(columns)
    }

    /// Log likelihood of the set with further columns.
    pub(super) fn extended(&self, set: &Set, cross: &Cross) -> f64 {
        let with = |c: usize, i: usize| cross.with_set[c][i];
        self.joined(set, cross.with_y.len(), &mut Scratch::default(), with, |c| cross.with_y[c], &cross.own)
    }

    /// The same with a grid point's columns.
    pub(super) fn with_atom(&self, set: &Set, atom: usize, scratch: &mut Scratch) -> f64 {
        let columns = &self.all.atoms[atom].columns;
        let bank: Vec<&[Products]> = set.ids.iter().map(|i| self.against_bank(*i)).collect();
        let y = self.against_bank(self.y);
        self.joined(
            set,
            columns.len(),
            scratch,
            |c, i| bank[i][columns[c]],
            |c| y[columns[c]],
            &self.all.own[atom],
        )
    }

    /// The same with `k` columns of which only products are needed: with the set's vectors, with the response, and
    /// among themselves.
    pub(super) fn joined(
        &self,
        set: &Set,
        k: usize,
        scratch: &mut Scratch,
        with_set: impl Fn(usize, usize) -> Products,
        with_y: impl Fn(usize) -> Products,
        own: &[Products],
    ) -> f64 {
        let b = set.ids.len();
        let Scratch { values, a, m, g } = scratch;
        values.clear();
        a.resize(k * b, 0.0);
        m.resize(k * k, 0.0);
        g.resize(k, 0.0);
        let near = set.near();
        for at in &set.fits[near.clone()] {
            for c in 0..k {
                let row = &mut a[c * b..(c + 1) * b];
                for (i, x) in row.iter_mut().enumerate() {
                    *x = with_set(c, i).at(at.phi);
                }
                at.factor.forward(row);
                g[c] = with_y(c).at(at.phi) - dot(row, &at.z);
            }
            let mut p = 0;
            for i in 0..k {
                for j in 0..=i {
                    let full = own[p].at(at.phi);
                    p += 1;
                    let left = full - dot(&a[i * b..(i + 1) * b], &a[j * b..(j + 1) * b]);
                    // What the set explains already to 1 part in 10⁶ is no new explanation.
                    m[i * k + j] = if i == j && left < 1e-6 * full { f64::INFINITY } else { left };
                }
            }
            gram::reduce(m, g);
            let gain: f64 = g.iter().filter(|x| x.is_finite()).map(|x| x * x).sum();
            values.push(self.loglik(at, gain));
        }
        self.best_phi(values, near.start).0
    }

    pub(super) fn made_cross(&self, set: &Set, columns: &[Vec<f64>]) -> Cross {
        let ranges = covered(columns, &self.stack.ranges);
        let mut own = Vec::new();
        for i in 0..columns.len() {
            own.extend((0..=i).map(|j| products(&columns[i], &columns[j], ranges)));
        }
        let with = |id: usize, c: &Vec<f64>| self.vectors[id].products(c, ranges);
        Cross {
            with_set: columns.iter().map(|c| set.ids.iter().map(|i| with(*i, c)).collect()).collect(),
            with_y: columns.iter().map(|c| with(self.y, c)).collect(),
            own,
        }
    }
}
