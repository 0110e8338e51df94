//! What chance alone would find: the same search on noise made from the residual by moving its blocks about.

use crate::gram::{Cholesky, Products, Vector, dot};
use crate::search::{Search, Set};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{RngCore, SeedableRng};

/// The seed of every permutation; stated in the verdict.
pub const SEED: u64 = 4832;

/// A distribution of largest values: Gumbel, fitted by its first two moments.
#[derive(Debug, Clone, Copy)]
struct Extreme {
    location: f64,
    width: f64,
}

impl Extreme {
    fn fit(values: &[f64]) -> Self {
        let n = values.len().max(1) as f64;
        let mean = values.iter().sum::<f64>() / n;
        let var = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
        // The tail of a likelihood ratio falls no faster than e⁻ˣ, whatever a few dozen draws say.
        let width = (var.sqrt() * 6f64.sqrt() / std::f64::consts::PI).max(0.8);
        Self { location: mean - 0.577_215_664_901_532_9 * width, width }
    }

    /// Probability of a value at least this large.
    fn tail(self, value: f64) -> f64 {
        -(-(-(value - self.location) / self.width).exp()).exp_m1()
    }
}

/// What chance finds in noise like this data's.
pub(crate) struct Chance {
    /// Largest gain in score of any named hypothesis on the grid.
    named: Extreme,
    /// Of any hypothesis.
    any: Extreme,
    /// The rounds of noise.
    pub(crate) draws: Vec<Vec<f64>>,
}

/// By how much a search finds a gain more often than its grid alone: it goes on between the grid's points, over a
/// million frequencies, and to several effects at once. On blind cases without anything hidden the bare grid's
/// probabilities let 9 of 620 pass at the level of 1 %, with this factor 1 of 1110; what is hidden is found as often.
const BEYOND_GRID: f64 = 20.0;
/// The same beside something that is certain: it is not in every run that there is more to find.
const BESIDE: f64 = 3.0;

impl Chance {
    /// Probability that chance alone gives a name so large a gain, where `first`: where there is nothing else.
    pub(crate) fn of_name(&self, gain: f64, first: bool) -> f64 {
        let beyond = if first { BEYOND_GRID } else { BESIDE };
        (beyond * self.named.tail(gain)).min(1.0)
    }

    /// The same for a name or a shape.
    pub(crate) fn of_anything(&self, gain: f64) -> f64 {
        (BEYOND_GRID * self.any.tail(gain)).min(1.0)
    }
}

/// A uniform number below `n`.
fn below(rng: &mut Xoshiro256PlusPlus, n: usize) -> usize {
    ((u128::from(rng.next_u64()) * n as u128) >> 64) as usize
}

impl Search<'_, '_> {
    /// Noise like the residual of a set: innovations in blocks, blocks in random order, autocorrelation put back.
    fn noise(&self, residual: &[f64], phi: f64, inflate: f64, rng: &mut Xoshiro256PlusPlus) -> Vec<f64> {
        let mut out = vec![0.0; residual.len()];
        for s in &self.stack.ranges {
            let r = &residual[s.clone()];
            let n = r.len();
            let mut e: Vec<f64> = (0..n)
                .map(|i| if i == 0 { r[0] * (1.0 - phi * phi).sqrt() } else { r[i] - phi * r[i - 1] })
                .collect();
            let mean = e.iter().sum::<f64>() / n as f64;
            e.iter_mut().for_each(|x| *x = (*x - mean) * inflate);
            let length = (n as f64).cbrt().ceil() as usize;
            let mut moved = Vec::with_capacity(n + length);
            while moved.len() < n {
                let start = below(rng, n);
                let sign = if rng.next_u64() & 1 == 0 { 1.0 } else { -1.0 };
                moved.extend((0..length).map(|k| sign * e[(start + k) % n]));
            }
            let mut x = moved[0] / (1.0 - phi * phi).sqrt();
            for (i, o) in out[s.clone()].iter_mut().enumerate() {
                if i > 0 {
                    x = phi * x + moved[i];
                }
                *o = x;
            }
        }
        out
    }

    /// Distribution of the best gain that `rounds` rounds of noise give, noise taken from the residual of `like`,
    /// over all grid hypotheses.
    pub(crate) fn chance(&self, like: &Set, rounds: usize) -> Chance {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(SEED);
        let (residual, phi) = self.residual(like);
        let inflate = (self.stack.n as f64 / (self.stack.n as f64 - like.ids.len() as f64).max(8.0)).sqrt();
        let empty = self.empty();
        let draws: Vec<Vector> = (0..rounds)
            .map(|_| Vector::new(self.noise(&residual, phi, inflate, &mut rng), &self.stack.ranges))
            .collect();
        let with_bank = self.all.bank.products(&draws.iter().collect::<Vec<_>>());
        let with_known: Vec<Vec<Products>> = draws
            .iter()
            .map(|d| {
                empty.ids.iter().map(|i| d.products(&self.vectors[*i].data, &self.stack.ranges)).collect()
            })
            .collect();
        let own: Vec<Products> = draws.iter().map(|d| d.products(&d.data, &self.stack.ranges)).collect();
        // For each noise coefficient: the model's own parameters' share of each draw.
        let start: Vec<Vec<(Vec<f64>, f64)>> = (0..rounds)
            .map(|d| {
                empty
                    .fits
                    .iter()
                    .map(|at| {
                        let mut z: Vec<f64> = with_known[d].iter().map(|p| p.at(at.phi)).collect();
                        at.factor.forward(&mut z);
                        let rss = (own[d].at(at.phi) - dot(&z, &z)).max(1e-9);
                        (z, rss)
                    })
                    .collect()
            })
            .collect();
        let null: Vec<f64> = (0..rounds)
            .map(|d| {
                let values: Vec<f64> = empty
                    .fits
                    .iter()
                    .zip(&start[d])
                    .map(|(at, (_, rss))| self.loglik_of(at.phi, *rss))
                    .collect();
                self.best_phi(&values).0
            })
            .collect();
        let mut best_named = vec![f64::NEG_INFINITY; rounds];
        let mut best_any = vec![f64::NEG_INFINITY; rounds];
        for (i, atom) in self.all.atoms.iter().enumerate() {
            let k = atom.columns.len();
            let b = empty.ids.len();
            let mut values = vec![Vec::with_capacity(empty.fits.len()); rounds];
            for (f, at) in empty.fits.iter().enumerate() {
                let mut a = vec![0.0; k * b];
                for (c, column) in atom.columns.iter().enumerate() {
                    let row = &mut a[c * b..(c + 1) * b];
                    for (x, id) in row.iter_mut().zip(&empty.ids) {
                        *x = self.against_bank(*id)[*column].at(at.phi);
                    }
                    at.factor.forward(row);
                }
                let mut m = vec![0.0; k * k];
                let mut p = 0;
                for r in 0..k {
                    for c in 0..=r {
                        let full = self.all.own[i][p].at(at.phi);
                        p += 1;
                        let left = full - dot(&a[r * b..(r + 1) * b], &a[c * b..(c + 1) * b]);
                        m[r * k + c] = if r == c && left < 1e-6 * full { f64::INFINITY } else { left };
                    }
                }
                let factor = Cholesky::new(&m, k);
                for d in 0..rounds {
                    let (z, rss) = &start[d][f];
                    let mut g: Vec<f64> = (0..k)
                        .map(|c| with_bank[d][atom.columns[c]].at(at.phi) - dot(&a[c * b..(c + 1) * b], z))
                        .collect();
                    factor.forward(&mut g);
                    let gain: f64 = g.iter().filter(|x| x.is_finite()).map(|x| x * x).sum();
                    values[d].push(self.loglik_of(at.phi, (rss - gain).max(1e-9 * rss)));
                }
            }
            let price = atom.cost + self.dimension_cost() * k as f64;
            for d in 0..rounds {
                let gain = self.best_phi(&values[d]).0 - null[d];
                best_any[d] = best_any[d].max(gain - price);
                if self.all.list[atom.hypothesis].named() {
                    best_named[d] = best_named[d].max(gain - price);
                }
            }
        }
        let draws = draws.into_iter().map(|d| d.data).collect();
        Chance { named: Extreme::fit(&best_named), any: Extreme::fit(&best_any), draws }
    }
}
