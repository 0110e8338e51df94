//! What chance alone would find: the same search on noise made from the residual by moving its blocks about.

use crate::cholesky::{Cholesky, KNOWN};
use crate::gram::{Products, Vector};
use crate::lanes::dot;
use crate::search::{AtPhi, Search, Set, Share};
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
    /// The same of waves, of a name and of any: the best of so many frequencies, each of which gains more than x with
    /// probability e⁻ˣ; logarithm of their number less their price.
    waves: [f64; 2],
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
        (beyond * self.named.tail(gain) + (self.waves[0] - gain).exp()).min(1.0)
    }

    /// The same for a name or a shape.
    pub(crate) fn of_anything(&self, gain: f64) -> f64 {
        (BEYOND_GRID * self.any.tail(gain) + (self.waves[1] - gain).exp()).min(1.0)
    }
}

/// A uniform number below `n`.
pub(crate) fn below(rng: &mut Xoshiro256PlusPlus, n: usize) -> usize {
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
            for x in &mut e {
                *x = (*x - mean) * inflate;
            }
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
        let draws: Vec<Vector> = (0..rounds)
            .map(|_| Vector::new(self.noise(&residual, phi, inflate, &mut rng), &self.stack.ranges))
            .collect();
        let rounds = Rounds::new(self, &draws);
        let mut best_named = vec![f64::NEG_INFINITY; draws.len()];
        let mut best_any = best_named.clone();
        let mut values = Vec::new();
        for (i, atom) in self.all.atoms.iter().enumerate() {
            let columns = atom.columns.len();
            let crowd = self.crowding_cost(&rounds.empty, atom.hypothesis, columns);
            let price = atom.cost + self.dimension_cost(columns) + crowd;
            let named = self.all.list[atom.hypothesis].named();
            // What is the best for a name is no better than the best of all.
            let least = if named { &mut best_named } else { &mut best_any };
            rounds.raise(self, i, price, least, &mut values);
            if named {
                best_any.iter_mut().zip(&best_named).for_each(|(any, named)| *any = any.max(*named));
            }
        }
        let waves = |any: bool| -> f64 {
            let of = self.waves.iter().filter(|w| w.span > 0.0 && (any || w.effect.is_some()));
            of.map(|w| (w.independent().ln() - self.wave_cost(w) - self.dimension_cost(2)).exp())
                .sum::<f64>()
                .ln()
        };
        let waves = [waves(false), waves(true)];
        Chance { named: Extreme::fit(&best_named), any: Extreme::fit(&best_any), waves }
    }
}

/// Rounds of noise, each fitted by the model's own parameters at every noise coefficient.
struct Rounds {
    empty: Set,
    count: usize,
    /// Per noise coefficient.
    at: Vec<RoundsAt>,
    /// Per round: log likelihood without anything beside the model.
    null: Vec<f64>,
    /// The least of it at any noise coefficient.
    least: Vec<f64>,
}

/// The rounds at one noise coefficient.
struct RoundsAt {
    /// Per column of the bank, one value for each round: its product with the round's noise, less what the model's own
    /// parameters explain of both.
    with_bank: Vec<f64>,
    /// Per parameter of the model, one value for each column of the bank: its share, L⁻¹ of their products.
    shares: Vec<Share>,
    /// Per round: sum of squares that the model's own parameters leave, and the log likelihood of that.
    rss: Vec<f64>,
    alone: Vec<f64>,
}

impl Rounds {
    fn new(search: &Search<'_, '_>, draws: &[Vector]) -> Self {
        let empty = search.empty();
        let ranges = &search.stack.ranges;
        let with_bank = search.all.bank.products_with_noise(draws);
        let with_known = |d: &Vector| -> Vec<Products> {
            empty.ids.iter().map(|i| d.products(&search.vectors[*i].data, ranges)).collect()
        };
        let known: Vec<Vec<Products>> = draws.iter().map(with_known).collect();
        let own: Vec<Products> = draws.iter().map(|d| d.products(&d.data, ranges)).collect();
        let of = |at: &AtPhi| {
            let shares = search.shares(&empty.ids, at, &[]);
            let mut out = RoundsAt {
                with_bank: vec![0.0; search.all.bank.len() * draws.len()],
                shares,
                rss: Vec::with_capacity(draws.len()),
                alone: Vec::with_capacity(draws.len()),
            };
            for (d, products) in with_bank.iter().enumerate() {
                let mut z: Vec<f64> = known[d].iter().map(|p| p.at(at.phi)).collect();
                at.factor.forward(&mut z);
                let rss = (own[d].at(at.phi) - dot(&z, &z)).max(1e-9);
                out.rss.push(rss);
                out.alone.push(search.loglik_of(at, rss));
                let mut with: Vec<f64> = products.iter().map(|p| p.at(at.phi)).collect();
                for (z, share) in z.iter().zip(&out.shares) {
                    share.take_off(*z, &mut with);
                }
                let places = out.with_bank[d..].iter_mut().step_by(draws.len());
                places.zip(with).for_each(|(place, w)| *place = w);
            }
            out
        };
        let at: Vec<RoundsAt> = empty.fits.iter().map(of).collect();
        let alone = |d: usize| at.iter().map(move |at| at.alone[d]);
        let null = (0..draws.len()).map(|d| search.best_phi(&alone(d).collect::<Vec<f64>>(), 0).0);
        let null = null.collect();
        let least = (0..draws.len()).map(|d| alone(d).fold(f64::INFINITY, f64::min)).collect();
        Self { empty, count: draws.len(), at, null, least }
    }

    /// Raises the best gain of each round to what it gains by a grid point's columns beside the model, less their price.
    /// `values` is room to work in.
    fn raise(
        &self,
        search: &Search<'_, '_>,
        atom: usize,
        price: f64,
        best: &mut [f64],
        values: &mut Vec<f64>,
    ) {
        let columns = &search.all.atoms[atom].columns;
        let (k, rounds) = (columns.len(), self.count);
        values.clear();
        values.resize((self.at.len() + k) * rounds, 0.0);
        let (values, g) = values.split_at_mut(self.at.len() * rounds);
        for ((fit, at), values) in self.empty.fits.iter().zip(&self.at).zip(values.chunks_exact_mut(rounds)) {
            let factor = at.factor(search, atom, fit.phi);
            for (c, g) in columns.iter().zip(g.chunks_exact_mut(rounds)) {
                g.copy_from_slice(&at.with_bank[c * rounds..(c + 1) * rounds]);
            }
            factor.forward_many(g, rounds);
            for g in g.chunks_exact(rounds) {
                values.iter_mut().zip(g).for_each(|(v, g)| *v += g * g);
            }
        }
        for (d, best) in best.iter_mut().enumerate() {
            let needed = *best + price + self.null[d];
            if self.at_most(search, d, values) <= needed {
                continue;
            }
            let own = self.empty.fits.iter().zip(&self.at).enumerate().map(|(f, (fit, at))| {
                let rss = at.rss[d];
                search.loglik_of(fit, (rss - values[f * rounds + d]).max(1e-9 * rss))
            });
            let gain = search.best_phi(&own.collect::<Vec<f64>>(), 0).0 - self.null[d];
            *best = best.max(gain - price);
        }
    }

    /// No less than a round's log likelihood beside what so much is explained by at each noise coefficient, without a logarithm:
    /// -ln(1 - r) is below r + r² up to a half, and the parabola over the noise coefficient comes to no more than an eighth of
    /// its height above its highest point.
    fn at_most(&self, search: &Search<'_, '_>, round: usize, explained: &[f64]) -> f64 {
        let mut top = f64::NEG_INFINITY;
        for (at, explained) in self.at.iter().zip(explained.chunks_exact(self.count)) {
            let share = explained[round] / at.rss[round];
            if share.is_nan() || share > 0.5 {
                return f64::INFINITY;
            }
            top = top.max(at.alone[round] + 0.5 * search.nu * (share + share * share));
        }
        top + (top - self.least[round]) / 8.0
    }
}

impl RoundsAt {
    /// Factor of the products among a grid point's columns, less what the model's own parameters explain of them.
    fn factor(&self, search: &Search<'_, '_>, atom: usize, phi: f64) -> Cholesky {
        let columns = &search.all.atoms[atom].columns;
        let k = columns.len();
        let mut m = vec![0.0; k * k];
        let mut p = 0;
        for r in 0..k {
            for c in 0..=r {
                let full = search.all.own[atom][p].at(phi);
                p += 1;
                let explained: f64 = self.shares.iter().map(|s| s[columns[r]] * s[columns[c]]).sum();
                let left = full - explained;
                m[r * k + c] = if r == c && left < KNOWN * full { f64::INFINITY } else { left };
            }
        }
        Cholesky::dropping(&m, k, KNOWN)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hypotheses::Hypotheses;
    use crate::problem::{Known, Stack, rms};
    use crate::testing::{noise, record};
    use rtec_model::effect::Dictionary;

    /// Gumbel's distribution of location 2 and width 1.5: mean and tail as tables have them.
    #[test]
    fn the_tail_of_largest_values_is_gumbels() {
        let n = 4000;
        let values: Vec<f64> =
            (1..n).map(|i| 2.0 - 1.5 * (-(f64::from(i) / f64::from(n)).ln()).ln()).collect();
        let fitted = Extreme::fit(&values);
        assert!((fitted.location - 2.0).abs() < 0.05 && (fitted.width - 1.5).abs() < 0.05, "{fitted:?}");
        // One in a hundred lies beyond location + 4.6 widths.
        assert!((Extreme { location: 2.0, width: 1.5 }.tail(2.0 + 4.600_149 * 1.5) - 0.01).abs() < 1e-5);
    }

    /// Noise is not found in noise; an offset of twenty standard errors is no chance.
    #[test]
    fn chance_gives_what_noise_gives() {
        let dice = noise(3, 200);
        let records = [record(200, |i| dice[i as usize])];
        let stack = Stack::new(&records);
        let (all, waves) = Hypotheses::new(&stack, &Dictionary::default());
        let mut search = Search::new(&stack, &all, &waves);
        search.begin(1.0, Vec::new(), stack.missing(&[]));
        let chance = search.chance(&search.empty(), 20);
        assert!(chance.of_name(-40.0, true) > 0.99 && chance.of_anything(-40.0) > 0.99);
        assert!(
            chance.of_name(60.0, true) < 1e-6 && chance.of_name(60.0, false) <= chance.of_name(60.0, true)
        );
    }

    /// Columns of which the model's own parameters leave next to nothing, and of the second beside the first only what was
    /// rounded off: no noise is explained by that.
    #[test]
    fn what_is_rounded_off_is_no_chance() {
        let dice = noise(3, 200);
        let records = [record(200, |i| dice[i as usize])];
        let stack = Stack::new(&records);
        let (all, waves) = Hypotheses::new(&stack, &Dictionary::default());
        let mut search = Search::new(&stack, &all, &waves);
        let two = all.atoms.iter().find(|a| a.columns.len() == 2).unwrap();
        let (left, rounded) = (noise(5, 200), noise(6, 200));
        let known = two.columns.iter().zip([0.0, 1e-7]).map(|(c, off)| {
            let column = all.bank.column(*c);
            let size = rms(&column);
            let column: Vec<f64> = column
                .iter()
                .zip(left.iter().zip(&rounded))
                .map(|(x, (left, rounded))| x + size * (1.2e-3 * left + off * rounded))
                .collect();
            Known { effect: None, along: Vec::new(), column, sd: 1e6, target: 0.0 }
        });
        search.begin(1.0, known.collect(), stack.missing(&[]));
        let chance = search.chance(&search.empty(), 20);
        assert!(chance.any.location < 20.0, "{:?}", chance.any);
    }
}
