//! What further columns add to a set, from products alone: no fit is made anew.

use super::sets::{ROUNDING, Set};
use super::{MOST_COEFFICIENTS, Search};
use crate::cholesky;
use crate::gram::{Products, covered, products};
use crate::lanes::dot;
use std::ops::Range;

/// The columns of a hypothesis against a set: products with the set's vectors, with the response, among themselves.
pub(super) struct Cross {
    /// Column by column, one for each vector of the set.
    pub(super) with_set: Vec<Products>,
    pub(super) with_y: Vec<Products>,
    pub(super) own: Vec<Products>,
}

impl Search<'_, '_> {
    /// What a set costs with so many columns of a hypothesis beside it.
    pub(super) fn price(&self, set: &Set, hypothesis: usize, cost: f64, columns: usize) -> f64 {
        let crowd = self.crowding_cost(set, hypothesis, columns);
        set.loglik - set.score + cost + self.dimension_cost(columns) + crowd
    }

    /// Log likelihood of the set with further columns, of which only products are needed.
    pub(super) fn extended(&self, set: &Set, cross: &Cross) -> f64 {
        let (k, b) = (cross.with_y.len(), set.ids.len());
        let (mut a, mut m, mut g) = (vec![0.0; k * b], vec![0.0; k * k], vec![0.0; k]);
        self.over_noise(set, |f| {
            let at = &set.fits[f];
            a.iter_mut().zip(&cross.with_set).for_each(|(x, p)| *x = p.at(at.phi));
            (0..k).for_each(|c| at.factor.forward(&mut a[c * b..(c + 1) * b]));
            let mut gain = 0.0;
            for ridge in [0.0, cholesky::RIDGE] {
                for (c, g) in g.iter_mut().enumerate() {
                    *g = cross.with_y[c].at(at.phi) - dot(&a[c * b..(c + 1) * b], &at.z);
                }
                let mut p = 0;
                for i in 0..k {
                    for j in 0..=i {
                        let full = cross.own[p].at(at.phi);
                        p += 1;
                        let left = full - dot(&a[i * b..(i + 1) * b], &a[j * b..(j + 1) * b]);
                        m[i * k + j] = match left {
                            left if i != j => left,
                            left if left < cholesky::KNOWN * full => f64::INFINITY,
                            left => left + ridge * full,
                        };
                    }
                }
                cholesky::reduce(&mut m, &mut g);
                gain = dot(&g, &g);
                if gain <= at.rss * (1.0 + ROUNDING) {
                    break;
                }
            }
            self.loglik(at, gain)
        })
    }

    /// The best over the noise coefficient: from log likelihoods at the set's best fit and those beside it.
    pub(super) fn over_noise(&self, set: &Set, mut at_fit: impl FnMut(usize) -> f64) -> f64 {
        let Range { mut start, mut end } = set.near();
        let mut values = [0.0; MOST_COEFFICIENTS];
        for (i, value) in values.iter_mut().enumerate().take(end).skip(start) {
            *value = at_fit(i);
        }
        // What explains much leaves noise of another memory than the set had: on to where the best is inside.
        while start > 0 && values[start] > values[start + 1] {
            start -= 1;
            values[start] = at_fit(start);
        }
        while end < set.fits.len() && values[end - 1] > values[end - 2] {
            values[end] = at_fit(end);
            end += 1;
        }
        self.best_phi(&values[start..end], start).0
    }

    pub(super) fn made_cross(&self, set: &Set, columns: &[Vec<f64>]) -> Cross {
        let ranges = covered(columns, &self.stack.ranges);
        let mut own = Vec::new();
        for i in 0..columns.len() {
            own.extend((0..=i).map(|j| products(&columns[i], &columns[j], ranges)));
        }
        let with = |id: usize, c: &Vec<f64>| self.vectors[id].products(c, ranges);
        Cross {
            with_set: columns.iter().flat_map(|c| set.ids.iter().map(move |i| with(*i, c))).collect(),
            with_y: columns.iter().map(|c| with(self.y, c)).collect(),
            own,
        }
    }
}
