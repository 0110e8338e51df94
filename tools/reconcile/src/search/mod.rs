//! The search for the set of effects that explains what the model does not: a beam over sets, every hypothesis fitted
//! jointly with the model's own parameters, non-linear parameters refined, every price of freedom paid.
//!
//! | module | what |
//! |---|---|
//! | `sets` | sets of explanations and their fits |
//! | `cross` | what further columns add to a set |
//! | `left` | the same for every grid point: what a set leaves of the bank |
//! | `offers` | which explanation could join a set |
//! | `periods`, `tones` | the period of a wave; its tones worked out once |
//! | `peaks`, `periodogram`, `targets` | which periods are tried: peaks of what a set leaves, over all rows and where targets are few |
//! | `refine` | non-linear parameters between grid points |
//! | `beam` | the order in which sets are tried |

mod beam;
mod cross;
mod left;
mod offers;
mod peaks;
mod periodogram;
mod periods;
mod refine;
mod sets;
mod targets;
mod tones;

pub(crate) use beam::Found;
pub(crate) use left::Share;
pub(crate) use offers::Offer;
pub(crate) use sets::{AtPhi, Member, Set};

use crate::gram::{Products, Vector};
use crate::hypotheses::{Hypotheses, reference_column};
use crate::problem::{Known, Stack};
use crate::waves::Wave;
use left::{Left, Lie};
use offers::Ranked;
use periodogram::{OnPlaces, Transform};
use rtec_model::effect::Effect;
use std::cell::{Cell, OnceCell, RefCell};
use std::collections::HashMap;
use std::ops::Range;
use std::rc::Rc;
use tones::{ROOM, Seen};

/// Noise coefficients that every fit is tried at: tanh of an even grid, up to 0.7. From row to row up to that is noise;
/// what is slower is structure.
const NOISE_STEP: f64 = 0.289;

const NOISE_GRID: std::ops::RangeInclusive<i32> = -1..=3;
/// The same where a name is judged: what only wanders slowly is structure, but no ground for a name.
const WANDERING: std::ops::RangeInclusive<i32> = -1..=8;

/// As many as the longest grid has.
const MOST_COEFFICIENTS: usize = (*WANDERING.end() - *WANDERING.start() + 1) as usize;

fn coefficients_of(grid: std::ops::RangeInclusive<i32>) -> Vec<f64> {
    grid.map(|i| (f64::from(i) * NOISE_STEP).tanh()).collect()
}

/// Products by vector and hypothesis.
type WithOwn = HashMap<(usize, usize), Rc<[Products]>>;

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
    /// The bank's columns that each hypothesis's grid points lie in.
    columns_of: Vec<Range<usize>>,
    /// Products of a vector with those of one hypothesis, once they are asked for without the others'.
    with_own: RefCell<WithOwn>,
    /// Products among vectors, once they are asked for: `pairs[i][j]`, j ≤ i.
    pairs: Vec<Vec<OnceCell<Products>>>,
    /// Vectors by their bits.
    places: HashMap<u64, Vec<usize>>,
    /// Degrees of freedom that noise is judged by.
    pub(crate) nu: f64,
    pub(crate) phis: Vec<f64>,
    transform: RefCell<Transform>,
    /// Per wave, of its own rows and of the further ones: how its frequencies lie on the places.
    places_seen: Vec<Vec<OnceCell<Vec<OnPlaces>>>>,
    /// Frequencies worth a look, per wave: the highest peaks met so far.
    peaks: RefCell<Vec<Vec<f64>>>,
    /// Per wave: its rows when its peaks were last looked for.
    looked_at: RefCell<Vec<Option<Vec<f64>>>>,
    /// Waves that were looked at, by hypothesis and frequency.
    seen: RefCell<HashMap<(usize, u64), Seen>>,
    /// Values that the waves may still keep.
    room: Cell<usize>,
    /// Rankings that were asked for, by what the set's vectors and hypotheses are.
    rankings: RefCell<HashMap<Vec<usize>, Rc<[Ranked]>>>,
    /// Rows of each response.
    rows_of: Vec<usize>,
    /// Per hypothesis: the responses that it acts on, each with the share of its coefficients that counts there.
    acts_on: Vec<Vec<(usize, f64)>>,
    /// How the columns of each atom of several lie in the bank.
    lie: Vec<Lie>,
    /// What sets left of the bank's columns.
    left: RefCell<Vec<Rc<Left>>>,
    /// Room for more of it.
    spare: RefCell<Vec<[Vec<f64>; 3]>>,
}

impl<'p, 'r> Search<'p, 'r> {
    /// [`Search::begin`] gives it what is to be explained.
    pub(crate) fn new(stack: &'p Stack<'r>, all: &'p Hypotheses, waves: &'p [Wave]) -> Self {
        let phis = coefficients_of(NOISE_GRID);
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
            columns_of: all.columns_of(),
            with_own: RefCell::default(),
            pairs: Vec::new(),
            places: HashMap::new(),
            nu: 0.0,
            phis,
            transform: RefCell::default(),
            places_seen: waves.iter().map(|w| w.parts().map(|_| OnceCell::new()).collect()).collect(),
            peaks: RefCell::new(Vec::new()),
            looked_at: RefCell::new(Vec::new()),
            seen: RefCell::new(HashMap::new()),
            room: Cell::new(ROOM),
            rankings: RefCell::default(),
            rows_of: (0..stack.responses.len()).map(|j| stack.rows(j).len()).collect(),
            acts_on: all.acts_on(stack, waves),
            lie: all.atoms.iter().filter_map(Lie::of).collect(),
            left: RefCell::default(),
            spare: RefCell::default(),
        }
    }

    /// Begins, or begins again with the model at other values of its parameters and noise of another size: what was
    /// worked out for columns that stay is kept. `missing`: measured minus simulated, weighed.
    pub(crate) fn begin(&mut self, noise: f64, known: Vec<Known>, missing: Vec<f64>) {
        self.noise = noise;
        self.y = self.register(missing, false);
        self.slopes = known.iter().map(|k| self.register(k.column.clone(), false)).collect();
        self.nu = (self.stack.n as f64 - known.len() as f64).max(self.stack.n as f64 / 2.0);
        self.known = known;
        *self.peaks.borrow_mut() = vec![Vec::new(); self.waves.len()];
        *self.looked_at.borrow_mut() = vec![None; self.waves.len()];
        self.rankings.borrow_mut().clear();
        self.forget_all_but(&[]);
        self.seen.get_mut().values_mut().for_each(Seen::forget_sets);
    }

    /// A set as it is when noise may wander slowly too, or no longer may.
    pub(crate) fn wandering(&mut self, may: bool, set: Set) -> Set {
        self.phis = coefficients_of(if may { WANDERING } else { NOISE_GRID });
        self.set(set.members, None)
    }

    fn add(&mut self, column: Vec<f64>) -> usize {
        let at = self.vectors.len();
        self.vectors.push(Vector::new(column, &self.stack.ranges));
        self.with_bank.push(OnceCell::new());
        self.pairs.push(vec![OnceCell::new(); at + 1]);
        at
    }

    /// The number of a vector, that of one with the same values where there is one. `height`: of a map.
    fn register(&mut self, column: Vec<f64>, height: bool) -> usize {
        let key = column
            .iter()
            .fold(0u64, |h, x| (h.rotate_left(5) ^ x.to_bits()).wrapping_mul(0x9E37_79B9_7F4A_7C15));
        if let Some(at) = self.places.get(&key).and_then(|p| {
            p.iter().find(|i| self.vectors[**i].known.is_some() == height && self.vectors[**i].data == column)
        }) {
            return *at;
        }
        let at = self.add(column);
        if height {
            let known = self.stack.height_known(&self.vectors[at].covers);
            self.vectors[at].known = Some(known);
        }
        self.places.entry(key).or_default().push(at);
        at
    }

    /// Products of a vector with the bank's columns.
    pub(crate) fn against_bank(&self, vector: usize) -> &[Products] {
        self.with_bank[vector].get_or_init(|| self.all.bank.products(&[&self.vectors[vector]]).swap_remove(0))
    }

    /// Products of a vector with the columns of one hypothesis.
    fn against_own(&self, vector: usize, hypothesis: usize) -> Rc<[Products]> {
        let columns = self.columns_of[hypothesis].clone();
        if let Some(all) = self.with_bank[vector].get() {
            return all[columns].into();
        }
        let product = |c: usize| self.all.bank.product(c, &self.vectors[vector]);
        let mut known = self.with_own.borrow_mut();
        let own = known.entry((vector, hypothesis)).or_insert_with(|| columns.map(product).collect());
        Rc::clone(own)
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
        *self.pairs[a][b].get_or_init(|| {
            let products = self.vectors[a].products(&self.vectors[b].data, &self.stack.ranges);
            let known = self.vectors[a].known.filter(|_| a == b);
            known.map_or(products, |known| products.and(known))
        })
    }

    /// The columns of an effect with free coefficients, weighed.
    fn columns(&self, effect: &Effect, free: &[usize], reference: bool) -> Vec<Vec<f64>> {
        let mut all = self.stack.basis(effect);
        let mut out: Vec<Vec<f64>> = free.iter().map(|i| std::mem::take(&mut all[*i])).collect();
        if reference {
            out.push(reference_column(self.stack, effect));
        }
        for column in &mut out {
            self.stack.weigh(column);
        }
        out
    }
}
