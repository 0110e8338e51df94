//! The search for the set of effects that explains what the model does not: a beam over sets, every hypothesis fitted
//! jointly with the model's own parameters, non-linear parameters refined, every price of freedom paid.

use crate::analysis::effect_of;
use crate::gram::{self, Cholesky, Products, Vector, dot, products};
use crate::hypotheses::{
    Atom, Cause, Hypotheses, Hypothesis, Shape, Teeth, Wave, aliases, likeliest, moments, pitch,
    reference_column, taus,
};
use crate::problem::{Known, Stack, rms};
use rtec_model::effect::{ANOTHER_REFERENCE, Against, Effect, Refine};
use rustfft::FftPlanner;
use rustfft::num_complex::Complex32;
use std::cell::{Cell, OnceCell, RefCell};
use std::collections::HashMap;
use std::rc::Rc;

/// Noise coefficients that every fit is tried at: tanh of an even grid.
const NOISE_STEP: f64 = 0.35;
const NOISE_GRID: std::ops::RangeInclusive<i32> = -1..=7;

/// Frequencies that are looked at twice, and closely; those beyond once.
const MOST_FREQUENCIES: f64 = 262_144.0;

/// Spacing of the frequencies, in periods over the span.
const FREQUENCY_STEP: f64 = 0.3;
/// The same beyond the first [`MOST_FREQUENCIES`]: four fifths of a wave's power are seen between two of them.
const FAST_STEP: f64 = 0.5;

/// Noise of a smaller coefficient is not asked whether plain least squares agrees.
const LONG_MEMORY: f64 = 0.5;
/// F value beyond which plain least squares contradicts a fit.
const CONTRADICTION: f64 = 25.0;

/// A fit at one noise coefficient.
#[derive(Debug, Clone)]
pub(crate) struct AtPhi {
    pub(crate) phi: f64,
    pub(crate) factor: Cholesky,
    /// L⁻¹ of the right-hand side.
    pub(crate) z: Vec<f64>,
    pub(crate) rss: f64,
}

/// A wave is given up where tuning cannot make it the best, nor a rival: it gains at most so many times more by it, and
/// so much beyond that.
const NEARBY: f64 = 1.15;
const SLACK: f64 = 3.0;
/// Below the set's own score by so much an offer plays no part.
const HOPELESS: f64 = 12.0;

/// How far from a grid the places may lie that a wave cannot tell from it, in periods.
pub(crate) const GRID_SHARE: f64 = 0.02;

/// Rows from which on frequencies far up are tried: among a million of them one fits a few dozen rows by chance.
const FAR_ROWS: usize = 120;
/// Turns over the whole extent below which what a wave shows on a grid is no wave.
const SLOWEST_TURNS: f64 = 1.5;

/// An accepted explanation inside a set.
#[derive(Debug, Clone)]
pub(crate) struct Member {
    pub(crate) cause: Cause,
    pub(crate) hypothesis: usize,
    pub(crate) cost: f64,
    vectors: Vec<usize>,
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
}

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
    columns: Source,
}

#[derive(Debug, Clone)]
enum Source {
    Bank(Vec<usize>),
    Made(Vec<Vec<f64>>),
}

/// Everything that a search keeps.
pub(crate) struct Search<'p, 'r> {
    pub(crate) stack: &'p Stack<'r>,
    pub(crate) all: &'p Hypotheses,
    pub(crate) waves: &'p [Wave],
    known: Vec<Known>,
    /// Size of the noise, in units of the stack's: the model's parameters are worth that many observations.
    noise: f64,
    pub(crate) vectors: Vec<Vector>,
    /// What the model leaves, and the slopes of its parameters, among the vectors.
    pub(crate) y: usize,
    pub(crate) slopes: Vec<usize>,
    /// Products of each vector with the bank's columns, once they are asked for.
    with_bank: Vec<OnceCell<Vec<Products>>>,
    /// Products among vectors, once they are asked for: `pairs[i][j]`, j ≤ i.
    pairs: Vec<Vec<OnceCell<Products>>>,
    /// Vectors by their bits.
    places: HashMap<u64, Vec<usize>>,
    /// Degrees of freedom that noise is judged by.
    pub(crate) nu: f64,
    pub(crate) phis: Vec<f64>,
    /// How many of the noise coefficients are in use: the first few, while a search takes no structure for noise.
    usable: usize,
    transform: RefCell<Transform>,
    /// Per wave: how its frequencies lie on the places.
    places_seen: Vec<OnceCell<Vec<OnPlaces>>>,
    /// Frequencies worth a look, per wave: the highest peaks met so far.
    peaks: RefCell<Vec<Vec<f64>>>,
    /// Waves that were looked at, by hypothesis and frequency.
    seen: RefCell<HashMap<(usize, u64), Seen>>,
    /// Values that the waves may still keep.
    room: Cell<usize>,
    /// Rankings that were asked for, by what the set's vectors and hypotheses are.
    rankings: RefCell<HashMap<Vec<usize>, Rc<[Ranked]>>>,
}

/// A wave of one frequency.
struct Seen {
    /// Where there is room for them.
    columns: Option<Vec<Vec<f64>>>,
    own: Vec<Products>,
    /// Products with vectors, those that were asked for.
    with: Vec<Option<[Products; 2]>>,
}

/// Values that the waves that were looked at may keep: 64 MB.
const ROOM: usize = 8_000_000;

/// A name with everything that speaks for it.
pub(crate) struct Ranked {
    pub(crate) name: String,
    pub(crate) evidence: f64,
    /// One per sensor, best first.
    pub(crate) offers: Vec<Offer>,
}

/// Room for the sums of one fit after the other.
#[derive(Default)]
struct Scratch {
    values: Vec<f64>,
    a: Vec<f64>,
    m: Vec<f64>,
    g: Vec<f64>,
}

/// The columns of a hypothesis against a set: products with the set's vectors, with the response, among themselves.
struct Cross {
    /// `[column][vector of the set]`
    with_set: Vec<Vec<Products>>,
    with_y: Vec<Products>,
    own: Vec<Products>,
}

impl<'p, 'r> Search<'p, 'r> {
    /// [`Search::begin`] gives it what is to be explained.
    pub(crate) fn new(stack: &'p Stack<'r>, all: &'p Hypotheses, waves: &'p [Wave]) -> Self {
        let phis: Vec<f64> = NOISE_GRID.map(|i| (f64::from(i) * NOISE_STEP).tanh()).collect();
        let usable = phis.len();
        Self {
            stack,
            all,
            waves,
            known: Vec::new(),
            noise: 1.0,
            vectors: Vec::new(),
            y: 0,
            slopes: Vec::new(),
            with_bank: Vec::new(),
            pairs: Vec::new(),
            places: HashMap::new(),
            nu: 0.0,
            phis,
            usable,
            transform: RefCell::new(Transform::new()),
            places_seen: waves.iter().map(|_| OnceCell::new()).collect(),
            peaks: RefCell::new(Vec::new()),
            seen: RefCell::new(HashMap::new()),
            room: Cell::new(ROOM),
            rankings: RefCell::default(),
        }
    }

    /// Begins, or begins again with the model at other values of its parameters and noise of another size: what was
    /// worked out for columns that stay is kept. `missing`: measured minus simulated, weighed.
    pub(crate) fn begin(&mut self, noise: f64, known: Vec<Known>, missing: Vec<f64>) {
        self.noise = noise;
        self.y = self.register(missing);
        self.slopes = known.iter().map(|k| self.register(k.column.clone())).collect();
        self.nu = (self.stack.n as f64 - known.len() as f64).max(self.stack.n as f64 / 2.0);
        self.known = known;
        *self.peaks.borrow_mut() = vec![Vec::new(); self.waves.len()];
        self.rankings.borrow_mut().clear();
    }

    fn add(&mut self, column: Vec<f64>) -> usize {
        let at = self.vectors.len();
        self.vectors.push(Vector::new(column, &self.stack.ranges));
        self.with_bank.push(OnceCell::new());
        self.pairs.push(vec![OnceCell::new(); at + 1]);
        at
    }

    /// The number of a vector, that of one with the same values where there is one.
    fn register(&mut self, column: Vec<f64>) -> usize {
        let key = column
            .iter()
            .fold(0u64, |h, x| (h.rotate_left(5) ^ x.to_bits()).wrapping_mul(0x9E37_79B9_7F4A_7C15));
        if let Some(at) =
            self.places.get(&key).and_then(|p| p.iter().find(|i| self.vectors[**i].data == column))
        {
            return *at;
        }
        let at = self.add(column);
        self.places.entry(key).or_default().push(at);
        at
    }

    /// Products of a vector with the bank's columns.
    pub(crate) fn against_bank(&self, vector: usize) -> &[Products] {
        self.with_bank[vector].get_or_init(|| self.all.bank.products(&[&self.vectors[vector]]).swap_remove(0))
    }

    /// The same for several vectors in one go.
    fn meet_bank(&self, ids: impl IntoIterator<Item = usize>) {
        let mut missing: Vec<usize> =
            ids.into_iter().filter(|i| self.with_bank[*i].get().is_none()).collect();
        missing.sort_unstable();
        missing.dedup();
        let vectors: Vec<&Vector> = missing.iter().map(|i| &self.vectors[*i]).collect();
        for (i, products) in missing.iter().zip(self.all.bank.products(&vectors)) {
            // It was empty a moment ago.
            let _set = self.with_bank[*i].set(products);
        }
    }

    fn pair(&self, a: usize, b: usize) -> Products {
        let (a, b) = (a.max(b), a.min(b));
        *self.pairs[a][b].get_or_init(|| self.vectors[a].products(&self.vectors[b].data, &self.stack.ranges))
    }

    fn fits(&self, ids: &[usize]) -> Vec<AtPhi> {
        let b = ids.len();
        let pairs: Vec<Vec<Products>> =
            (0..b).map(|i| (0..=i).map(|j| self.pair(ids[i], ids[j])).collect()).collect();
        self.phis[..self.usable]
            .iter()
            .map(|&phi| {
                let mut a = vec![0.0; b * b];
                for (i, row) in pairs.iter().enumerate() {
                    for (j, p) in row.iter().enumerate() {
                        a[i * b + j] = p.at(phi);
                    }
                }
                let mut g: Vec<f64> = ids.iter().map(|i| self.pair(*i, self.y).at(phi)).collect();
                let mut rss = self.pair(self.y, self.y).at(phi);
                for (i, k) in self.known.iter().enumerate() {
                    // What the file says of a parameter counts as one more observation of it.
                    let w = (self.noise / k.sd).powi(2);
                    a[i * b + i] += w;
                    g[i] += w * k.target;
                    rss += w * k.target * k.target;
                }
                let factor = Cholesky::new(&a, b);
                let mut z = g;
                factor.forward(&mut z);
                let rss = (rss - dot(&z, &z)).max(1e-9);
                AtPhi { phi, factor, z, rss }
            })
            .collect()
    }

    pub(crate) fn loglik(&self, at: &AtPhi, gain: f64) -> f64 {
        self.loglik_of(at.phi, (at.rss - gain).max(1e-9 * at.rss))
    }

    pub(crate) fn loglik_of(&self, phi: f64, rss: f64) -> f64 {
        let segments = self.stack.ranges.len() as f64;
        -0.5 * self.nu * (rss / self.nu).ln() + 0.5 * segments * (1.0 - phi * phi).ln()
    }

    /// Best over the noise coefficient, from values on its grid: a parabola through the best three.
    pub(crate) fn best_phi(&self, loglik: &[f64]) -> (f64, f64) {
        let top = (0..loglik.len()).max_by(|a, b| loglik[*a].total_cmp(&loglik[*b])).unwrap_or(0);
        if top == 0 || top + 1 == loglik.len() {
            return (loglik[top], self.phis[top]);
        }
        let (a, b, c) = (loglik[top - 1], loglik[top], loglik[top + 1]);
        let bend = a - 2.0 * b + c;
        let shift = if bend < 0.0 { 0.5 * (a - c) / bend } else { 0.0 };
        let at = (f64::from(*NOISE_GRID.start()) + top as f64 + shift) * NOISE_STEP;
        (b - 0.25 * (a - c) * shift, at.tanh())
    }

    pub(crate) fn dimension_cost(&self) -> f64 {
        0.5 * (self.stack.n as f64).ln()
    }

    fn set(&self, members: Vec<Member>) -> Set {
        let mut ids = self.slopes.clone();
        ids.extend(members.iter().flat_map(|m| m.vectors.iter().copied()));
        let fits = self.fits(&ids);
        let values: Vec<f64> = fits.iter().map(|f| self.loglik(f, 0.0)).collect();
        let (loglik, _) = self.best_phi(&values);
        let price: f64 =
            members.iter().map(|m| m.cost + self.dimension_cost() * m.vectors.len() as f64).sum();
        Set { members, score: loglik - price, loglik, fits, ids }
    }

    pub(crate) fn empty(&self) -> Set {
        self.set(Vec::new())
    }

    /// The set without one member.
    pub(crate) fn without(&self, set: &Set, member: usize) -> Set {
        let mut members = set.members.clone();
        members.remove(member);
        self.set(members)
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

    fn price(&self, set: &Set, cost: f64, columns: usize) -> f64 {
        set.loglik - set.score + cost + self.dimension_cost() * columns as f64
    }

    /// Log likelihood of the set with further columns.
    fn extended(&self, set: &Set, cross: &Cross) -> f64 {
        let with = |c: usize, i: usize| cross.with_set[c][i];
        self.joined(set, cross.with_y.len(), &mut Scratch::default(), with, |c| cross.with_y[c], &cross.own)
    }

    /// The same with a grid point's columns.
    fn with_atom(&self, set: &Set, atom: usize, scratch: &mut Scratch) -> f64 {
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
    fn joined(
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
        for at in &set.fits {
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
        self.best_phi(values).0
    }

    fn made_cross(&self, set: &Set, columns: &[Vec<f64>]) -> Cross {
        let ranges = &self.stack.ranges;
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

    /// The columns of a wave against a set; what was worked out once is kept.
    fn wave_cross(&self, set: &Set, wave: &Wave, f: f64) -> Cross {
        let ranges = &self.stack.ranges;
        let mut all = self.seen.borrow_mut();
        let seen = all.entry((wave.hypothesis, f.to_bits())).or_insert_with(|| {
            let c = self.wave_columns(wave, f);
            let own =
                [(0, 0), (1, 0), (1, 1)].iter().map(|(i, j)| products(&c[*i], &c[*j], ranges)).collect();
            let kept = self.room.get().checked_sub(2 * self.stack.n);
            if let Some(left) = kept {
                self.room.set(left);
            }
            Seen { columns: kept.map(|_| c), own, with: Vec::new() }
        });
        seen.with.resize(self.vectors.len(), None);
        let mut made = None;
        let mut with = |id: usize| -> [Products; 2] {
            *seen.with[id].get_or_insert_with(|| {
                let c = seen
                    .columns
                    .as_ref()
                    .unwrap_or_else(|| made.get_or_insert_with(|| self.wave_columns(wave, f)));
                let v = &self.vectors[id];
                [v.products(&c[0], ranges), v.products(&c[1], ranges)]
            })
        };
        let y = with(self.y);
        let each: Vec<[Products; 2]> = set.ids.iter().map(|i| with(*i)).collect();
        Cross {
            with_set: (0..2).map(|k| each.iter().map(|p| p[k]).collect()).collect(),
            with_y: y.to_vec(),
            own: seen.own.clone(),
        }
    }

    /// The best grid point of one hypothesis as an addition to a set.
    pub(crate) fn offer_of(&self, set: &Set, hypothesis: usize) -> Option<Offer> {
        let mut scratch = Scratch::default();
        let mut scored = |i: usize| {
            let atom = &self.all.atoms[i];
            self.with_atom(set, i, &mut scratch) - self.price(set, atom.cost, atom.columns.len())
        };
        (0..self.all.atoms.len())
            .filter(|i| self.all.atoms[*i].hypothesis == hypothesis)
            .map(|i| (i, scored(i)))
            .max_by(|a, b| a.1.total_cmp(&b.1))
            .map(|(i, score)| self.bank_offer(i, score, score))
    }

    fn bank_offer(&self, i: usize, score: f64, evidence: f64) -> Offer {
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
        let mut scratch = Scratch::default();
        for (i, atom) in self.all.atoms.iter().enumerate() {
            let score = self.with_atom(set, i, &mut scratch) - self.price(set, atom.cost, atom.columns.len());
            let place = &mut best[atom.hypothesis];
            *place = Some(match *place {
                None => (score, i, score),
                Some((s, at, all)) if s >= score => (s, at, log_sum(all, score)),
                Some((_, _, all)) => (score, i, log_sum(all, score)),
            });
        }
        let mut offers: Vec<Offer> = best
            .into_iter()
            .flatten()
            .map(|(score, i, evidence)| self.bank_offer(i, score, evidence))
            .collect();
        for (i, wave) in self.waves.iter().enumerate() {
            if fresh {
                self.find_peaks(set, i);
            }
            offers.extend(self.wave(set, wave, &self.peaks.borrow()[i]));
        }
        offers.sort_by(|a, b| b.score.total_cmp(&a.score));
        offers
    }

    /// What the set leaves unexplained, weighed.
    pub(crate) fn residual(&self, set: &Set) -> (Vec<f64>, f64) {
        let top = (0..set.fits.len())
            .max_by(|a, b| self.loglik(&set.fits[*a], 0.0).total_cmp(&self.loglik(&set.fits[*b], 0.0)))
            .unwrap_or(0);
        let fit = &set.fits[top];
        (self.left(set, fit), fit.phi)
    }

    /// What a set leaves with the coefficients of one of its fits.
    fn left(&self, set: &Set, fit: &AtPhi) -> Vec<f64> {
        let mut beta = fit.z.clone();
        fit.factor.backward(&mut beta);
        let mut r = self.vectors[self.y].data.clone();
        for (b, i) in beta.iter().zip(&set.ids) {
            r.iter_mut().zip(&self.vectors[*i].data).for_each(|(r, x)| *r -= b * x);
        }
        r
    }

    /// Root mean square of what one member of a set does, weighed.
    pub(crate) fn share(&self, set: &Set, member: usize) -> f64 {
        let beta = self.coefficients(set);
        let before: usize = set.members[..member].iter().map(Member::columns).sum();
        let mut does = vec![0.0; self.stack.n];
        for (b, i) in beta[self.slopes.len() + before..].iter().zip(&set.members[member].vectors) {
            does.iter_mut().zip(&self.vectors[*i].data).for_each(|(d, x)| *d += b * x);
        }
        rms(&does)
    }

    /// Coefficients of the set at its best noise coefficient: known parameters' changes, then members' in order.
    pub(crate) fn coefficients(&self, set: &Set) -> Vec<f64> {
        let fits = self.fits(&set.ids);
        let top = (0..fits.len())
            .max_by(|a, b| self.loglik(&fits[*a], 0.0).total_cmp(&self.loglik(&fits[*b], 0.0)))
            .unwrap_or(0);
        let mut beta = fits[top].z.clone();
        fits[top].factor.backward(&mut beta);
        beta
    }

    /// Whether the noise coefficient that fits best is bought with coefficients that plain least squares contradicts:
    /// noise that wanders so slowly would not have let plain least squares explain so much more (Hausman,
    /// Econometrica 46 (1978) 1251: two estimates that differ where they should not show a wrong model). A law whose
    /// steps the record has smoothed does that: all it has left to say then lies in a few rows.
    pub(crate) fn contradicted(&self, set: &Set) -> bool {
        let top = set.fits.iter().max_by(|a, b| self.loglik(a, 0.0).total_cmp(&self.loglik(b, 0.0)));
        let plain = set.fits.iter().find(|f| f.phi == 0.0);
        let (Some(top), Some(plain)) = (top, plain) else { return false };
        if top.phi < LONG_MEMORY {
            return false;
        }
        let left = |fit: &AtPhi| {
            let r = self.left(set, fit);
            dot(&r, &r)
        };
        let (fitted, plain) = (left(top), left(plain));
        let k = set.ids.len().max(1) as f64;
        let independent = self.stack.n as f64 * (1.0 - top.phi) / (1.0 + top.phi);
        (fitted - plain) / k > CONTRADICTION * plain / (independent - k).max(1.0)
    }

    /// Frequencies at which the periodogram of what a set leaves is highest, added to the wave's list.
    fn find_peaks(&self, set: &Set, at: usize) {
        let wave = &self.waves[at];
        let span = wave.span();
        if span <= 0.0 {
            return;
        }
        let from = wave.from.max(0.5 / span);
        if wave.to <= from {
            return;
        }
        let (residual, phi) = self.residual(set);
        let step = FREQUENCY_STEP / span;
        let wanted = ((wave.to - from) / step).ceil().max(2.0);
        let count = wanted.min(MOST_FREQUENCIES) as usize;
        let x: Vec<f64> = wave.along.iter().map(|x| x - wave.places[0]).collect();
        let mut gaps: Vec<f64> = x.windows(2).map(|w| (w[1] - w[0]).abs()).collect();
        gaps.sort_by(f64::total_cmp);
        let gap = gaps.get(gaps.len() / 2).copied().unwrap_or(0.0);
        let mut transform = self.transform.borrow_mut();
        let list = &mut self.peaks.borrow_mut()[at];
        let places = self.places_seen[at].get_or_init(|| transform.places(&x, from, step, count));
        for p in [0.0, phi] {
            if p != 0.0 && p.abs() < 0.3 {
                continue;
            }
            let mut u = sharpened(&residual, p, &self.stack.ranges).split_off(wave.rows.start);
            u.truncate(x.len());
            let mean = u.iter().sum::<f64>() / u.len() as f64;
            u.iter_mut().for_each(|u| *u -= mean);
            let sums = transform.sums(&x, &u, from, step, count);
            let mut power: Vec<f64> = sums.zip(places).map(|(z, place)| place.power(z)).collect();
            if p != 0.0 {
                for (i, p2) in power.iter_mut().enumerate() {
                    let (_, cos) = gram::wave((from + step * i as f64) * gap);
                    *p2 /= 1.0 + p * p - 2.0 * p * cos;
                }
            }
            peaks(&mut power, from, step, list);
        }
        if wanted > MOST_FREQUENCIES && x.len() >= FAR_ROWS {
            // Far up every wave is as good as random from row to row, so that one look with the noise's own
            // coefficient serves, on a coarser grid.
            let from = from + step * MOST_FREQUENCIES;
            let step = FAST_STEP / span;
            let count = ((wave.to - from) / step).ceil().max(2.0) as usize;
            let u = sharpened(&residual, phi, &self.stack.ranges);
            let sums = transform.sums(&x, &u[wave.rows.clone()], from, step, count);
            let mut power: Vec<f64> = sums.map(|z| f64::from(z.norm_sqr())).collect();
            peaks(&mut power, from, step, list);
        }
    }

    /// The best period of a periodic hypothesis: each peak refined exactly.
    fn wave(&self, set: &Set, wave: &Wave, peaks: &[f64]) -> Option<Offer> {
        let span = wave.span();
        if span <= 0.0 {
            return None;
        }
        let from = wave.from.max(0.5 / span);
        let step = FREQUENCY_STEP / span;
        // Independent frequencies: as many as the span resolves, and no more than make a difference at these places.
        let cost_of_search = ((wave.to - from) * span).max(2.0);
        let hypothesis = &self.all.list[wave.hypothesis];
        let extra = if hypothesis.named() { 0.0 } else { 3.0 };
        let cost = self.all.family_cost + cost_of_search.ln() + extra;
        // What a wave that explains nothing scores.
        let nothing = set.loglik - self.price(set, cost, 2);
        let mut best: Option<(f64, f64)> = None;
        for f0 in peaks {
            let best_before = best.map_or(f64::NEG_INFINITY, |b| b.0);
            let grid = wave.effect.as_ref().and_then(|_| pitch(&wave.places, GRID_SHARE / f0));
            let mut eval = |f: f64| {
                // On a grid whose pitch is a whole number of periods a wave is a constant or a slow bow, and no wave.
                if grid.is_some_and(|pitch| ((f * pitch).round() / pitch - f).abs() * span < SLOWEST_TURNS) {
                    return f64::NEG_INFINITY;
                }
                let score = self.extended(set, &self.wave_cross(set, wave, f)) - self.price(set, cost, 2);
                if best.as_ref().is_none_or(|b| score > b.0) {
                    best = Some((score, f));
                }
                score
            };
            let mut centre = (eval(*f0), *f0);
            let bound = best_before.max(set.score - HOPELESS);
            let mut h = step;
            // Between two frequencies of the grid a wave shows at least 0.93 of its power; the nearer, the more.
            let mut nearby = NEARBY - 1.0;
            for _ in 0..8 {
                if (centre.0 - nothing) * (1.0 + nearby) + nothing + SLACK < bound {
                    break;
                }
                nearby *= 0.25;
                h *= 0.5;
                for f in [centre.1 - h, centre.1 + h] {
                    if f >= wave.from && f <= wave.to {
                        let s = eval(f);
                        if s > centre.0 {
                            centre = (s, f);
                        }
                    }
                }
            }
        }
        let (mut score, mut f) = best?;
        let mut cost = cost;
        let facts = wave.effect.as_ref().and_then(|e| e.description().searched.wave);
        if let Some(usual_mm) = facts.map(|w| w.usual_mm)
            && let Some(pitch) = pitch(&wave.places, GRID_SHARE / f)
        {
            // On a grid there are no more frequencies than places; which of the aliases it is the data cannot say.
            let paid = cost_of_search.min((span / pitch).max(2.0)).ln();
            let saved = cost_of_search.ln() - paid;
            (cost, score) = (cost - saved, score + saved);
            let near: Vec<(f64, f64)> = aliases(f, pitch, [from, wave.to], 8)
                .into_iter()
                .map(|g| {
                    let s = self.extended(set, &self.wave_cross(set, wave, g)) - self.price(set, cost, 2);
                    (s, g)
                })
                .filter(|(s, _)| *s > score - 1.0)
                .collect();
            let periods: Vec<f64> = near.iter().map(|(_, g)| 1.0 / g).collect();
            if let Some(i) = likeliest(&periods, usual_mm) {
                (score, f) = near[i];
            }
        }
        let columns = self.wave_columns(wave, f);
        if let Some(most) = facts.and_then(|w| w.most_periods)
            && self.amplitude(set, [&columns[0], &columns[1]]) > most / (f * wave.unit)
        {
            return None;
        }
        let cause = match (&wave.effect, &wave.shape) {
            (Some(e), _) => {
                let effect = e.with(&[(0, 1.0 / (f * wave.unit))])?;
                Cause::Effect { effect, free: vec![0, 1], reference: false }
            }
            (None, Some(shape)) => {
                let mut shape = shape.clone();
                shape.manner = format!("periodic, period {:.4}", 1.0 / f);
                Cause::Shape(shape)
            }
            (None, None) => return None,
        };
        Some(Offer {
            cause,
            hypothesis: wave.hypothesis,
            cost,
            score,
            evidence: score,
            columns: Source::Made(columns),
        })
    }

    /// The least amplitude of a wave of two columns that explains as much of what a set leaves as they do.
    fn amplitude(&self, set: &Set, [s, c]: [&[f64]; 2]) -> f64 {
        let (left, _) = self.residual(set);
        let (ss, cc) = (dot(s, s), dot(c, c));
        let mut squares = [ss, 0.0, dot(s, c), cc];
        let mut with = [dot(s, &left), dot(c, &left)];
        gram::reduce(&mut squares, &mut with);
        let explained: f64 = with.iter().filter(|w| w.is_finite()).map(|w| w * w).sum();
        // However sine and cosine lie on the places, no smaller amplitude explains so much.
        let largest = f64::midpoint(ss, cc) + f64::hypot((ss - cc) / 2.0, dot(s, c));
        (explained / largest).sqrt()
    }

    fn wave_columns(&self, wave: &Wave, f: f64) -> Vec<Vec<f64>> {
        let mut out = vec![vec![0.0; self.stack.n]; 2];
        if let [sines, cosines] = &mut out[..] {
            let both = sines[wave.rows.clone()].iter_mut().zip(&mut cosines[wave.rows.clone()]);
            for (x, (a, b)) in wave.along.iter().zip(both) {
                (*a, *b) = gram::wave(x * f);
            }
        }
        out.iter_mut().for_each(|c| self.stack.weigh(c));
        out
    }

    /// The columns of an effect with free coefficients, weighed.
    pub(crate) fn columns(&self, effect: &Effect, free: &[usize], reference: bool) -> Vec<Vec<f64>> {
        let all = self.stack.basis(effect);
        let mut out: Vec<Vec<f64>> = free.iter().map(|i| all[*i].clone()).collect();
        if reference {
            out.push(reference_column(self.stack, effect));
        }
        out.iter_mut().for_each(|c| self.stack.weigh(c));
        out
    }

    /// Score of a set with an effect added at its own non-linear parameters, search unpaid.
    pub(crate) fn score_of(&self, set: &Set, effect: &Effect) -> f64 {
        let free: Vec<usize> = (0..effect.coefficient_count()).collect();
        let columns = self.columns(effect, &free, false);
        self.extended(set, &self.made_cross(set, &columns)) - self.price(set, 0.0, columns.len())
    }

    /// Refines the non-linear parameters of an offer to a set.
    pub(crate) fn refine(&self, set: &Set, offer: Offer) -> Offer {
        if let Cause::Teeth(shape, teeth) = &offer.cause {
            let (shape, teeth) = (shape.clone(), *teeth);
            return self.sharpened_teeth(set, offer, shape, teeth);
        }
        let Cause::Effect { effect, free, reference } = &offer.cause else { return offer };
        let refined: Vec<(usize, Refine)> = effect
            .description()
            .parameters
            .iter()
            .enumerate()
            .map(|(i, p)| (i, p.refine))
            .filter(|(_, r)| *r != Refine::Stays)
            .collect();
        if refined.is_empty() {
            return offer;
        }
        let (free, reference) = (free.clone(), *reference);
        let eval = |e: &Effect| {
            let columns = self.columns(e, &free, reference);
            let score = self.extended(set, &self.made_cross(set, &columns))
                - self.price(set, offer.cost, columns.len());
            (score, columns)
        };
        let mut effect = effect.clone();
        let (mut score, mut columns) = eval(&effect);
        let mut take = |effect: &mut Effect, parameter: usize, value: f64| -> bool {
            let Some(next) = effect.with(&[(parameter, value)]) else { return false };
            let (s, c) = eval(&next);
            let better = s > score;
            if better {
                (score, columns) = (s, c);
                *effect = next;
            }
            better
        };
        for (parameter, _) in refined.iter().filter(|(_, r)| *r == Refine::Moment) {
            let times = moments(self.stack);
            let mut reach = (times.len() / 160).max(1) as isize;
            while reach >= 1 {
                for side in [-reach, reach] {
                    let now = effect.scalar(*parameter);
                    let at = times.partition_point(|t| *t < now) as isize + side;
                    if let Some(t) = usize::try_from(at).ok().and_then(|i| times.get(i)) {
                        take(&mut effect, *parameter, *t);
                    }
                }
                reach = if reach > 1 { (reach * 2 / 3).max(1) } else { 0 };
            }
        }
        let longest = taus(self.stack).last().copied().unwrap_or(f64::MAX);
        let mut shrink = 1.0;
        for _ in 0..7 {
            for (parameter, refine) in &refined {
                for side in [-1.0, 1.0] {
                    let now = effect.scalar(*parameter);
                    let next = match refine {
                        Refine::Step(by) => now + side * by * shrink,
                        Refine::Factor(by) | Refine::TimeConstant(by) => now * (side * by * shrink).exp(),
                        Refine::Stays | Refine::Moment => continue,
                    };
                    let too_long = matches!(refine, Refine::TimeConstant(_)) && next > longest;
                    if !too_long && take(&mut effect, *parameter, next) {
                        break;
                    }
                }
            }
            shrink *= 0.6;
        }
        let cause = Cause::Effect { effect, free, reference };
        Offer { cause, score, evidence: offer.evidence.max(score), columns: Source::Made(columns), ..offer }
    }

    /// Turns and phase to the row: the last tooth tells the turns, all of them the phase.
    fn sharpened_teeth(&self, set: &Set, offer: Offer, shape: Shape, teeth: Teeth) -> Offer {
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
                let score =
                    self.extended(set, &self.made_cross(set, &columns)) - self.price(set, offer.cost, 1);
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

    /// The set with an offer taken in.
    pub(crate) fn take(&mut self, set: &Set, offer: &Offer) -> Set {
        let columns = match &offer.columns {
            Source::Bank(at) => self.of_bank(at),
            Source::Made(columns) => columns.clone(),
        };
        self.joined_by(set, &offer.cause, offer.hypothesis, offer.cost, columns)
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
            let level = level_name(&effect);
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

    /// The set with a grid point taken in.
    pub(crate) fn take_atom(&mut self, set: &Set, atom: &Atom) -> Set {
        self.joined_by(set, &atom.cause, atom.hypothesis, atom.cost, self.of_bank(&atom.columns))
    }

    fn of_bank(&self, columns: &[usize]) -> Vec<Vec<f64>> {
        let bank = &self.all.bank;
        columns.iter().map(|c| bank.column(*c).into_iter().map(|x| x * bank.scale[*c]).collect()).collect()
    }

    fn joined_by(
        &mut self,
        set: &Set,
        cause: &Cause,
        hypothesis: usize,
        cost: f64,
        columns: Vec<Vec<f64>>,
    ) -> Set {
        let vectors = columns.into_iter().map(|c| self.register(c)).collect();
        let mut members = set.members.clone();
        members.push(Member { cause: cause.clone(), hypothesis, cost, vectors });
        self.set(members)
    }

    pub(crate) fn named(&self, set: &Set) -> bool {
        set.members.iter().all(|m| self.all.list[m.hypothesis].named())
    }

    /// Whether an offer repeats what a set has: the same hypothesis, unless it may stand twice.
    fn repeats(&self, set: &Set, offer: &Offer) -> bool {
        let may = |h: &Hypothesis| h.law().is_some_and(|l| l.searched.repeats);
        set.members.iter().any(|m| {
            let (a, b) = (&self.all.list[m.hypothesis], &self.all.list[offer.hypothesis]);
            m.hypothesis == offer.hypothesis && !(may(b) || (a.named() && a.name != b.name))
        })
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

    fn ranked(&self, set: &Set) -> Vec<Ranked> {
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
            let close = r.evidence > top - 40.0 || i < 3;
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
        for offer in self.scan(set, fresh) {
            let hypothesis = &self.all.list[offer.hypothesis];
            let room = &mut left[usize::from(hypothesis.named())];
            if *room == 0 || self.repeats(set, &offer) {
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

/// The name of what does the same as another reference temperature of a thermal law.
pub(crate) fn level_name(effect: &Effect) -> String {
    effect.companion().map_or_else(String::new, |level| level.name())
}

/// log(eᵃ + eᵇ)
fn log_sum(a: f64, b: f64) -> f64 {
    let (hi, lo) = if a > b { (a, b) } else { (b, a) };
    hi + (lo - hi).exp().ln_1p()
}

/// K·r with K = `WᵀW`, the inverse covariance of the noise.
fn sharpened(r: &[f64], phi: f64, segments: &[std::ops::Range<usize>]) -> Vec<f64> {
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

/// The three highest peaks of a periodogram, added to a list of frequencies.
fn peaks(power: &mut [f64], from: f64, step: f64, list: &mut Vec<f64>) {
    for _ in 0..3 {
        let mut top = 0;
        for (i, p) in power.iter().enumerate() {
            if *p > power[top] {
                top = i;
            }
        }
        let f = from + step * top as f64;
        if !list.iter().any(|g: &f64| (g - f).abs() < 2.0 * step) {
            list.push(f);
        }
        let end = (top + 5).min(power.len());
        power[top.saturating_sub(4)..end].fill(0.0);
    }
}

/// What a Fourier transform needs, kept from one to the next.
struct Transform {
    planner: FftPlanner<f32>,
    grid: Vec<Complex32>,
    scratch: Vec<Complex32>,
}

impl Transform {
    fn new() -> Self {
        Self { planner: FftPlanner::new(), grid: Vec::new(), scratch: Vec::new() }
    }

    /// Σ uᵢ·exp(2πj·f·xᵢ) at `count` frequencies from `from`, to a few per cent: rows spread over a fine even grid by
    /// cubic weights, one fast Fourier transform (Press and Rybicki, Astrophys. J. 338, 1989).
    fn sums(
        &mut self,
        x: &[f64],
        u: &[f64],
        from: f64,
        step: f64,
        count: usize,
    ) -> impl Iterator<Item = Complex32> {
        let size = room(count + count / 2);
        // Frequencies are counted from the middle of the band, so that the grid need only hold half of it.
        let middle = from + step * (count / 2) as f64;
        let Self { planner, grid, scratch } = self;
        grid.clear();
        grid.resize(size, Complex32::new(0.0, 0.0));
        for (x, u) in x.iter().zip(u) {
            let (sin, cos) = gram::wave(middle * x);
            let place = x * step * size as f64;
            let base = place.floor();
            let w = place - base;
            // Lagrange's cubic through four neighbours.
            let weights = [
                -w * (w - 1.0) * (w - 2.0) / 6.0,
                (w + 1.0) * (w - 1.0) * (w - 2.0) / 2.0,
                -(w + 1.0) * w * (w - 2.0) / 2.0,
                (w + 1.0) * w * (w - 1.0) / 6.0,
            ];
            for (k, weight) in weights.iter().enumerate() {
                let at = (base as i64 + k as i64 - 1).rem_euclid(size as i64) as usize;
                grid[at] += Complex32::new((cos * u * weight) as f32, (sin * u * weight) as f32);
            }
        }
        let fft = planner.plan_fft_inverse(size);
        scratch.resize(fft.get_inplace_scratch_len().max(scratch.len()), Complex32::new(0.0, 0.0));
        fft.process_with_scratch(grid, scratch);
        // The lower half of the band stands at the grid's end.
        grid[size - count / 2..].iter().chain(&grid[..count - count / 2]).copied()
    }

    /// How waves of these frequencies lie on the places.
    fn places(&mut self, x: &[f64], from: f64, step: f64, count: usize) -> Vec<OnPlaces> {
        let share = vec![1.0 / x.len() as f64; x.len()];
        let once: Vec<Complex32> = self.sums(x, &share, from, step, count).collect();
        let twice = self.sums(x, &share, 2.0 * from, 2.0 * step, count);
        once.into_iter().zip(twice).map(|(once, twice)| OnPlaces::new(once, twice)).collect()
    }
}

/// Mean square of a cosine and of a sine over the places, their means taken off, and of the one times the other. Where
/// targets are few a wave may be mostly sine there, or mostly constant.
struct OnPlaces {
    cos: f32,
    sin: f32,
    both: f32,
}

impl OnPlaces {
    /// From the means of exp(jθ) and exp(2jθ).
    fn new(once: Complex32, twice: Complex32) -> Self {
        Self {
            cos: 0.5 * (1.0 + twice.re) - once.re * once.re,
            sin: 0.5 * (1.0 - twice.re) - once.im * once.im,
            both: 0.5 * twice.im - once.re * once.im,
        }
    }

    /// What the wave explains beside a constant (Zechmeister and Kürster, Astron. Astrophys. 496, 2009), up to a factor.
    fn power(&self, z: Complex32) -> f64 {
        // No more than the sums are good for is believed of a wave that is next to nothing on the places.
        let whole = (self.cos * self.sin - self.both * self.both).max(LEAST_WHOLE);
        f64::from((self.sin * z.re * z.re + self.cos * z.im * z.im - 2.0 * self.both * z.re * z.im) / whole)
    }
}

/// A quarter where the places are spread well.
const LEAST_WHOLE: f32 = 0.05;

/// The smallest size from `least` on that a Fourier transform is quick at: a power of two, or three quarters of one.
fn room(least: usize) -> usize {
    let whole = least.next_power_of_two().max(64);
    if whole / 4 * 3 >= least { whole / 4 * 3 } else { whole }
}

/// How wide the search goes.
const BEAM_NAMED: usize = 3;
const BEAM_UNNAMED: usize = 2;
/// Coefficient of noise with a short memory: its half-life is below two rows.
const SHORT_MEMORY: f64 = 0.65;
/// By how much several effects in noise of short memory must be the better account than noise of long memory: a search
/// for several at once finds more by chance than one step of it.
const SHORT_MARGIN: f64 = 12.0;
/// Most effects that are looked for at once.
const DEPTH: usize = 5;

/// What a search found: the best sets of each size and kind, best first.
pub(crate) struct Found {
    pub(crate) named: Set,
    pub(crate) any: Set,
    /// Sets of names only that were visited, best first.
    pub(crate) visited: Vec<Set>,
}

impl Search<'_, '_> {
    /// Search over sets of explanations. Several strong effects together look like noise with a long memory, in which
    /// none of them stands out by itself: where the data ask for such noise the search is done once more with noise of
    /// short memory only, and what it found judged with all of them.
    pub(crate) fn run(&mut self) -> Found {
        let mut found = self.beam();
        let short = self.phis.partition_point(|p| *p < SHORT_MEMORY);
        let empty = self.empty();
        let values: Vec<f64> = empty.fits.iter().map(|f| self.loglik(f, 0.0)).collect();
        if self.best_phi(&values).1 < SHORT_MEMORY {
            return found;
        }
        let all = std::mem::replace(&mut self.usable, short);
        let second = self.beam();
        self.usable = all;
        let mut beside = Vec::new();
        let first = found.named.score;
        for set in second.visited.into_iter().chain([second.any]) {
            let set = self.set(set.members);
            let set = self.thinned(set);
            if !self.physical(&set) {
                continue;
            }
            if self.named(&set) {
                if set.score > found.named.score + SHORT_MARGIN {
                    found.named = set.clone();
                }
                beside.push(set.clone());
            }
            if set.score > found.any.score + SHORT_MARGIN {
                found.any = set;
            }
        }
        // Its other sets are rivals only of what it found itself.
        if found.named.score > first {
            found.visited.append(&mut beside);
        }
        found.visited.sort_by(|a, b| b.score.total_cmp(&a.score));
        found
    }

    /// The first member of a set whose effect is outside its law's bounds.
    fn unphysical(&self, set: &Set) -> Option<usize> {
        let beta = self.coefficients(set);
        let mut at = self.slopes.len();
        set.members.iter().position(|m| {
            let gamma = &beta[at..at + m.columns()];
            at += m.columns();
            effect_of(&m.cause, gamma).is_some_and(|e| !e.is_physical())
        })
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

    /// The set without the members that do not pay.
    fn thinned(&self, set: Set) -> Set {
        let mut set = set;
        loop {
            let fewer = (0..set.members.len())
                .map(|i| self.without(&set, i))
                .max_by(|a, b| a.score.total_cmp(&b.score));
            match fewer {
                Some(f) if f.score >= set.score => set = f,
                _ => return set,
            }
        }
    }

    /// Beam search over sets of explanations.
    fn beam(&mut self) -> Found {
        let empty = self.empty();
        let mut beam = vec![empty.clone()];
        let (mut named, mut any) = (empty.clone(), empty.clone());
        let mut visited = vec![empty];
        for _ in 0..DEPTH {
            let lifted = self.lifted(&beam);
            beam.extend(lifted);
            self.meet_bank(beam.iter().flat_map(|s| s.ids.iter().copied()).chain([self.y]));
            let mut next: Vec<(usize, Offer)> = Vec::new();
            for (i, set) in beam.iter().enumerate() {
                let pure = self.named(set);
                let offers = self.offers(set, if pure { 7 } else { 3 }, if pure { 4 } else { 0 }, i == 0);
                next.extend(offers.into_iter().map(|o| (i, o)));
            }
            next.sort_by(|a, b| b.1.score.total_cmp(&a.1.score));
            let mut seen: Vec<Vec<usize>> = Vec::new();
            let mut room = [BEAM_UNNAMED, BEAM_NAMED];
            let mut grown = Vec::new();
            for (i, offer) in next {
                let set = &beam[i];
                let mut key: Vec<usize> =
                    set.members.iter().map(|m| m.hypothesis).chain([offer.hypothesis]).collect();
                key.sort_unstable();
                let pure = self.named(set) && self.all.list[offer.hypothesis].named();
                if room[usize::from(pure)] == 0 || seen.contains(&key) {
                    continue;
                }
                seen.push(key);
                room[usize::from(pure)] -= 1;
                let set = set.clone();
                let set = self.take(&set, &offer);
                let set = self.polish(set);
                if self.physical(&set) {
                    grown.push(set);
                }
            }
            let before = any.score.max(named.score);
            for set in &grown {
                if self.named(set) {
                    if set.score > named.score {
                        named = set.clone();
                    }
                    visited.push(set.clone());
                }
                if set.score > any.score {
                    any = set.clone();
                }
            }
            let best = grown.iter().map(|s| s.score).fold(f64::NEG_INFINITY, f64::max);
            let best_named =
                grown.iter().filter(|s| self.named(s)).map(|s| s.score).fold(f64::NEG_INFINITY, f64::max);
            // A level that does not pay ends the search, for names and for anything.
            if best <= before && best_named < named.score {
                break;
            }
            beam = grown;
        }
        visited.sort_by(|a, b| b.score.total_cmp(&a.score));
        Found { named, any, visited }
    }

    /// The best set of names with a constant beside it: what starts from anywhere (a drift from the mean that the
    /// record was zeroed at) pays only together with its constant, and neither pays alone.
    fn lifted(&mut self, beam: &[Set]) -> Vec<Set> {
        let Some(set) = beam.iter().find(|s| self.named(s)).cloned() else { return Vec::new() };
        let all = self.all;
        all.atoms
            .iter()
            .filter(|a| all.list[a.hypothesis].is_offset())
            .filter(|a| set.members.iter().all(|m| m.hypothesis != a.hypothesis))
            .map(|a| self.take_atom(&set, a))
            .collect()
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
                Some((i, w)) => self.wave(&rest, w, &self.peaks.borrow()[i]).unwrap_or(offer),
                None => self.refine(&rest, offer),
            };
            if refined.score > set.score + 1e-3 {
                let next = self.take(&rest, &refined);
                // Its place stays the same.
                let mut members = next.members;
                if let Some(last) = members.pop() {
                    members.insert(i, last);
                }
                set = self.set(members);
            }
        }
        set
    }
}
