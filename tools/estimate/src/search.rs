//! The search for the likeliest set of hypotheses.
//! Several sets grow side by side, one member at a time. Then members are exchanged (one for one, two for two) and left out, until nothing
//! improves the set.

use crate::bank::Look;
use crate::cause::Cause;
use crate::effort::{
    DIFFERENCES, HARMONICS, HOPELESS, KEPT, MOST_MEMBERS, MOST_SHAPES, PEAKS, STRONG, TRIED, USUAL_TRIED,
    WAVES_KEPT, WORTHLESS,
};
use crate::family::{Families, Family, Scan};
use crate::priors::{
    AGAIN, ALIKE, BENT_SHARE, CONTRIBUTION, LEVELS, LISTED, USUAL_SHARE, USUAL_WITHIN, WIDE,
};
use crate::problem::{Base, Problem};
use crate::rows::Rows;
use crate::shapes::changing_wave;
use rtec_least_squares::{Factor, add, dot};
use rtec_model::effect::{Difference, Effect, Heat, Refine, Search as How};
use rtec_model::record::Axis;
use std::cell::{OnceCell, RefCell};
use std::collections::HashMap;
use std::rc::Rc;
use std::sync::Arc;

/// A member of a set.
#[derive(Debug, Clone)]
pub struct Member {
    /// Its family.
    pub family: usize,
    /// The known effect that it replaces.
    pub replaces: Option<usize>,
    /// With its non-linear parameters.
    pub cause: Cause,
    /// Size of its prior, in typical sizes.
    pub level: f64,
    /// Log prior: name, place in the grid, level.
    pub prior: f64,
    /// Its columns, whitened by the noise of its search.
    columns: Rc<Columns>,
    /// The bank's products with its columns beside the base; computed on first use.
    shares: Rc<OnceCell<Columns>>,
}

impl Member {
    /// Number of columns.
    #[must_use]
    pub fn width(&self) -> usize {
        self.columns.len()
    }

    fn set_columns(&mut self, columns: Columns) {
        self.columns = Rc::new(columns);
        self.shares = Rc::default();
    }
}

/// A set with its fit.
#[derive(Debug, Clone)]
pub struct Set {
    /// The members.
    pub members: Vec<Member>,
    /// The base's columns, then the members'.
    pub factor: Factor,
    /// log p(y | S) + log p(S), up to a constant.
    pub score: f64,
}

/// Something to be looked at exactly.
#[derive(Debug, Clone)]
pub struct Seed {
    /// Its family.
    pub family: usize,
    /// With its non-linear parameters.
    pub cause: Cause,
    /// Log weight of its place in the grid.
    pub weight: f64,
    /// Log odds by the quick look, the family's prior included.
    pub score: f64,
}

/// The search.
pub struct Search<'p> {
    /// What is explained.
    pub problem: &'p Problem<'p>,
    /// What may explain it.
    pub families: &'p Families,
    /// Set-up terms and known effects.
    pub base: Base,
    /// The quick look beside the base alone.
    pub look: Look,
    /// Rounding that rows share, for intervals.
    pub rounding: Vec<crate::setup::Term>,
    /// Cached columns of waves, whitened, and their products with the base's.
    waves: RefCell<Waves>,
}

/// Whitened columns.
type Columns = Vec<Vec<f64>>;
/// By family and the bits of the frequency.
type Waves = HashMap<(usize, u64), Rc<[Columns; 2]>>;

/// Evidence of columns at each level of their size.
#[derive(Debug, Clone, Copy)]
pub struct Gain {
    /// Log Bayes factor, summed over the levels.
    pub total: f64,
    /// The best level.
    pub level: f64,
    /// Log Bayes factor there, with the level's weight.
    pub best: f64,
}

fn log_sum(values: impl IntoIterator<Item = f64>) -> f64 {
    let values: Vec<f64> = values.into_iter().collect();
    let top = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if top == f64::NEG_INFINITY {
        return top;
    }
    top + values.iter().map(|v| (v - top).exp()).sum::<f64>().ln()
}

/// Log likelihood of a residual.
/// The noise's size is estimated from it, but not below its floor.
#[must_use]
pub fn fit(left: f64, freedom: f64) -> f64 {
    let left = left.max(1e-9 * freedom);
    if left > freedom { -0.5 * freedom * ((left / freedom).ln() + 1.0) } else { -0.5 * left }
}

/// Gain of columns from ½ log |I + t²S| and t²hᵀ(I + t²S)⁻¹h at each level.
fn gain_of(at_level: impl Fn(f64) -> (f64, f64), left: f64, freedom: f64) -> Gain {
    let now = fit(left, freedom);
    let at = LEVELS.map(|(level, weight)| {
        let (half_log_det, less) = at_level(level * level);
        weight.ln() - half_log_det + fit(left - less, freedom) - now
    });
    let best = (0..at.len()).max_by(|a, b| at[*a].total_cmp(&at[*b])).unwrap_or(0);
    Gain { total: log_sum(at), level: LEVELS[best].0, best: at[best] }
}

/// Gain of one column.
fn gain_of_one(square: f64, along: f64, left: f64, freedom: f64) -> Gain {
    let of = |t: f64| {
        let l = 1.0 + t * square.max(0.0);
        (0.5 * l.ln(), t * along * along / l)
    };
    gain_of(of, left, freedom)
}

/// Gain of columns with these products with the residual and among each other.
#[must_use]
pub fn gain(along: &[f64], among: &[f64], left: f64, freedom: f64) -> Gain {
    let p = along.len();
    if p == 1 {
        return gain_of_one(among[0], along[0], left, freedom);
    }
    let of = |t: f64| {
        // Cholesky's triangle of I + t²S, row by row, and along it the solution of L z = h.
        let mut triangle = vec![0.0; p * p];
        let mut z = vec![0.0; p];
        let (mut half_log_det, mut less) = (0.0, 0.0);
        for i in 0..p {
            let (above, own) = triangle.split_at_mut(i * p);
            for j in 0..i {
                let row = &above[j * p..=j * p + j];
                own[j] = (t * among[i * p + j] - dot(&own[..j], &row[..j])) / row[j];
            }
            // A pivot of I plus a sum of squares is at least one, up to rounding.
            let pivot = (1.0 + t * among[i * p + i] - dot(&own[..i], &own[..i])).max(1.0).sqrt();
            z[i] = (along[i] - dot(&own[..i], &z[..i])) / pivot;
            own[i] = pivot;
            half_log_det += pivot.ln();
            less += t * z[i] * z[i];
        }
        (half_log_det, less)
    };
    gain_of(of, left, freedom)
}

impl<'p> Search<'p> {
    /// A search of a problem under a noise.
    /// The families' columns must be whitened already.
    #[must_use]
    pub fn new(problem: &'p Problem<'p>, families: &'p Families, base: Base) -> Self {
        let look = families.bank.look(&base.factor);
        let rounding = crate::setup::rounding(problem.rows);
        Self { problem, families, base, look, rounding, waves: RefCell::default() }
    }

    fn family(&self, family: usize) -> &Family {
        &self.families.list[family]
    }

    /// The set without members.
    #[must_use]
    pub fn nothing(&self) -> Set {
        let score = fit(self.base.factor.left(), self.base.freedom);
        Set { members: Vec::new(), factor: self.base.factor.clone(), score }
    }

    /// Whitened columns of a cause.
    #[must_use]
    pub fn columns(&self, cause: &Cause) -> Vec<Vec<f64>> {
        let mut columns = cause.columns(self.problem.rows);
        for c in &mut columns {
            self.base.noise.whiten(self.problem.rows, c);
        }
        columns
    }

    /// Gain of columns beside a factor.
    #[must_use]
    pub fn gain(&self, factor: &Factor, columns: &[Vec<f64>]) -> Gain {
        self.gain_of(factor, columns, &columns.iter().map(|c| factor.shares(c)).collect::<Columns>())
    }

    /// As `gain`, for columns whose products with the factor are known.
    fn gain_of(&self, factor: &Factor, columns: &[Vec<f64>], shares: &[Vec<f64>]) -> Gain {
        let p = columns.len();
        let along: Vec<f64> = columns.iter().map(|c| dot(c, factor.residual())).collect();
        let mut among = vec![0.0; p * p];
        for i in 0..p {
            for j in 0..=i {
                let d = dot(&columns[i], &columns[j]) - dot(&shares[i], &shares[j]);
                among[i * p + j] = d;
                among[j * p + i] = d;
            }
        }
        gain(&along, &among, factor.left(), self.base.freedom)
    }

    /// The quick look beside a set.
    /// The bank's products with a member's columns, beside the base, are computed once. Those with the factor's orthonormal columns follow
    /// from R.
    #[must_use]
    pub fn look_at(&self, set: &Set) -> Look {
        let bank = &self.families.bank;
        let from = self.base.factor.len();
        let mut new: Columns = Vec::new();
        for m in &set.members {
            let beside = |c: &Vec<f64>| bank.shares(&self.base.factor.beside(c));
            for raw in m.shares.get_or_init(|| m.columns.iter().map(beside).collect()) {
                let r = &set.factor.triangle()[from + new.len()][from..];
                let mut share: Vec<f64> = raw.iter().map(|x| x * m.level).collect();
                for (r, other) in r.iter().zip(&new) {
                    add(&mut share, -r, other);
                }
                let size = r[new.len()];
                for x in &mut share {
                    *x /= size;
                }
                new.push(share);
            }
        }
        let mut look = self.look.clone();
        bank.after(&mut look, &new, &set.factor.along()[from..]);
        look
    }

    /// A set with one member more; `None` where its values are impossible.
    #[must_use]
    pub fn with(&self, set: &Set, seed: &Seed) -> Option<Set> {
        self.built(set, self.weighed(set, seed)?.1)
    }

    /// One more member of a set, and the set's score with it.
    /// The score leaves out the correction for whole counts.
    fn weighed(&self, set: &Set, seed: &Seed) -> Option<(f64, Member)> {
        rtec_files::watch::step();
        if set.members.len() >= MOST_MEMBERS {
            return None;
        }
        let columns = self.columns(&seed.cause);
        let gain = self.gain(&set.factor, &columns);
        let prior = self.prior(set, seed.family) + seed.weight + gain.total - gain.best;
        let level_weight =
            LEVELS.iter().find(|l| l.0.to_bits() == gain.level.to_bits()).map_or(0.0, |l| l.1.ln());
        let member = Member {
            family: seed.family,
            replaces: self.family(seed.family).replaces,
            cause: seed.cause.clone(),
            level: gain.level,
            prior: prior + level_weight,
            columns: Rc::new(columns),
            shares: Rc::default(),
        };
        Some((set.score + prior + gain.best, member))
    }

    /// The set with that member.
    fn built(&self, set: &Set, member: Member) -> Option<Set> {
        let mut factor = set.factor.clone();
        push(&mut factor, &member);
        let mut members = set.members.clone();
        members.push(member);
        let set = self.scored(members, factor);
        self.possible(&set).then_some(set)
    }

    fn scored(&self, members: Vec<Member>, factor: Factor) -> Set {
        let prior: f64 = members.iter().map(|m| m.prior).sum();
        let det = factor.half_log_det() - self.base.factor.half_log_det();
        let score = fit(factor.left(), self.base.freedom) - det + prior + self.whole(&members, &factor);
        Set { members, factor, score }
    }

    /// Correction to the likelihood for lost counts, which are whole numbers.
    /// There are fewer whole numbers than real ones.
    fn whole(&self, members: &[Member], factor: &Factor) -> f64 {
        let count_um = self.problem.rows.records.iter().find_map(|r| r.count_um);
        let Some(count_um) = count_um else { return 0.0 };
        let of = |m: &Member| m.cause.effect().is_some_and(|e| e.description().whole_counts);
        if !members.iter().any(of) {
            return 0.0;
        }
        let (beta, inverse) = (factor.solve(), factor.inverse());
        let mut at = self.base.factor.len();
        let mut sum = 0.0;
        for m in members {
            if of(m)
                && let Some(size) = m.cause.effect().and_then(|e| crate::cause::sizes(e).first().copied())
            {
                let unit = size * m.level;
                let (um, sd) = (beta[at] * unit, dot(&inverse[at], &inverse[at]).sqrt() * unit);
                let off = um - count_um * (um / count_um).round().abs().max(1.0).copysign(um);
                let fewer = (count_um / (sd * std::f64::consts::TAU.sqrt())).max(1.0).ln();
                sum += fewer - 0.5 * (off / sd.max(1e-12)).powi(2);
            }
            at += m.width();
        }
        sum
    }

    /// The fit of the members of another search, as they are.
    #[must_use]
    pub fn of(&self, mut members: Vec<Member>) -> Set {
        for m in &mut members {
            m.set_columns(self.columns(&m.cause));
        }
        self.grown_from(self.base.factor.clone(), members, 0)
    }

    /// The fit of members of which the first `done` are in a factor.
    fn grown_from(&self, mut factor: Factor, members: Vec<Member>, done: usize) -> Set {
        for m in &members[done..] {
            push(&mut factor, m);
        }
        self.scored(members, factor)
    }

    /// The factor of a set's first `count` members.
    fn first(&self, set: &Set, count: usize) -> Factor {
        let width: usize = set.members[..count].iter().map(Member::width).sum();
        set.factor.first(self.base.factor.len() + width)
    }

    /// Log prior of one more member of a family.
    fn prior(&self, set: &Set, family: usize) -> f64 {
        let again = set.members.iter().filter(|m| m.family == family).count();
        self.family(family).prior - AGAIN * again as f64
    }

    /// Coefficients of each member, in its columns' standard deviations.
    #[must_use]
    pub fn coefficients(&self, set: &Set) -> Vec<Vec<f64>> {
        let beta = set.factor.solve();
        let mut at = self.base.factor.len();
        set.members
            .iter()
            .map(|m| {
                let own = beta[at..at + m.width()].iter().map(|b| b * m.level).collect();
                at += m.width();
                own
            })
            .collect()
    }

    /// Whether all effects are within their physical bounds.
    #[must_use]
    pub fn possible(&self, set: &Set) -> bool {
        let beta = self.coefficients(set);
        set.members.iter().zip(&beta).all(|(m, b)| {
            self.family(m.family).replaces.is_some()
                || m.cause
                    .solved(self.problem.rows, b)
                    .is_none_or(|e| e.is_physical() && !turns_back(self.problem.rows, &e))
        })
    }

    /// Whether a family may join a set.
    fn may_join(&self, set: &Set, family: usize) -> bool {
        let f = self.family(family);
        if let Some(shape) = f.shape.as_ref().filter(|_| !f.set_up) {
            let same = |m: &&Member| matches!(&m.cause, Cause::Shape(s) if s.0.response == shape.response);
            let already = set.members.iter().filter(same).count();
            if already >= MOST_SHAPES {
                return false;
            }
        }
        f.repeats() || !set.members.iter().any(|m| m.family == family)
    }

    /// The seeds worth an exact look beside a set, best first.
    /// `long`: fine waves over long travel too.
    #[must_use]
    pub fn seeds(&self, set: &Set, look: &Look, long: bool) -> Vec<Seed> {
        let (left, freedom) = (set.factor.left(), self.base.freedom);
        let mut seeds: Vec<Seed> = Vec::new();
        let mut weighed: Option<Vec<f64>> = None;
        for (number, family) in self.families.list.iter().enumerate() {
            if !self.may_join(set, number) {
                continue;
            }
            let prior = self.prior(set, number);
            match &family.scan {
                Scan::Grid(points) => {
                    let of = |group: usize| {
                        let (columns, at) = self.families.bank.group(group);
                        let p = columns.len();
                        gain(&look.along[columns], &look.among[at..at + p * p], left, freedom).total
                    };
                    let scored: Vec<f64> = points.iter().map(|(g, w, _)| of(*g) + w).collect();
                    let best = (0..points.len()).max_by(|a, b| scored[*a].total_cmp(&scored[*b]));
                    if let Some(i) = best {
                        let (_, weight, cause) = &points[i];
                        let total = log_sum(scored.iter().copied());
                        seeds.push(Seed {
                            family: number,
                            cause: cause.clone(),
                            weight: *weight,
                            score: prior + total,
                        });
                        // Other numbers of lobes and other places are separate modes.
                        let tells = cause.effect().is_some_and(|e| {
                            e.description().searched.repeats
                                && e.description().parameters.iter().any(|p| p.tells_apart)
                        });
                        for k in
                            (0..points.len()).filter(|k| tells && *k != i && scored[*k] > scored[i] - LISTED)
                        {
                            let (_, weight, cause) = &points[k];
                            let score = prior + total + scored[k] - scored[i];
                            seeds.push(Seed { family: number, cause: cause.clone(), weight: *weight, score });
                        }
                    }
                }
                Scan::Sensors { sensors, points } => {
                    seeds.extend(self.sensor_seeds(number, sensors, points, look, left, prior));
                }
                Scan::Beside { law, known } => {
                    let Some(effect) = &family.effect else { continue };
                    let own = set.members.iter().filter_map(|m| m.cause.effect());
                    let own = own.filter(|e| e.description().name == *law && e.axes() == effect.axes());
                    for period in known.iter().copied().chain(own.map(|e| e.scalar(0))) {
                        let Some(effect) = effect.with(&[(0, period)]) else { continue };
                        let cause = Cause::Effect { effect, free: 2, reference: false };
                        let score = prior + self.gain(&set.factor, &self.columns(&cause)).total;
                        seeds.push(Seed { family: number, cause, weight: 0.0, score });
                    }
                }
                Scan::Wave { along, .. } if along.is_long() && !long => {}
                Scan::Wave { .. } => {
                    let weighed = weighed.get_or_insert_with(|| {
                        let mut r = set.factor.residual().to_vec();
                        self.base.noise.transpose(self.problem.rows, &mut r);
                        r
                    });
                    seeds.extend(self.wave_seeds(number, set, weighed, prior));
                }
            }
        }
        seeds.retain(|s| s.score.is_finite());
        seeds.sort_by(|a, b| b.score.total_cmp(&a.score));
        seeds
    }

    /// Seeds of a wave at the peaks of a residual's spectrum.
    /// The residual is `weighed` by the noise. Usual periods near a peak are added.
    fn wave_seeds(&self, number: usize, set: &Set, weighed: &[f64], prior: f64) -> Vec<Seed> {
        let family = self.family(number);
        let Scan::Wave { along, unit, .. } = &family.scan else { return Vec::new() };
        let mut seeds = Vec::new();
        let mut at = along.peaks(weighed, PEAKS);
        let facts = family.effect.as_ref().and_then(|e| e.description().searched.wave);
        if let Some(facts) = facts {
            // The usual ones have half of the prior, and look like others on a grid; some are finer than the spectrum goes.
            let usual: Vec<f64> = facts.usual_mm.iter().map(|p| 1.0 / p).collect();
            at.extend(along.near(weighed, &usual, 3e-4).into_iter().take(USUAL_TRIED));
        }
        let mut best = (f64::NEG_INFINITY, 0.0);
        for f in at {
            let Some(cause) = self.wave(family, f, 1) else { continue };
            let weight = wave_weight(family, f, *unit, along.range(), along.span());
            let key = (number, f.to_bits());
            let known = self.waves.borrow().get(&key).cloned();
            let known = known.unwrap_or_else(|| {
                let columns = self.columns(&cause);
                let shares = columns.iter().map(|c| self.base.factor.shares(c)).collect();
                let new = Rc::new([columns, shares]);
                let mut waves = self.waves.borrow_mut();
                if waves.len() < WAVES_KEPT {
                    waves.insert(key, Rc::clone(&new));
                }
                new
            });
            let [columns, base] = &*known;
            let shares = columns.iter().zip(base);
            let of = |(c, b): (&Vec<f64>, &Vec<f64>)| set.factor.shares_after(b.clone(), c);
            let shares: Columns = shares.map(of).collect();
            let score = prior + weight + self.gain_of(&set.factor, columns, &shares).total;
            if score > best.0 {
                best = (score, f);
            }
            seeds.push(Seed { family: number, cause, weight, score });
        }
        // A wave without a name need not be a sine.
        if family.effect.is_none()
            && best.1 > 0.0
            && let Some(cause) = self.wave(family, best.1, HARMONICS)
        {
            let weight = wave_weight(family, best.1, *unit, along.range(), along.span());
            let gain = self.gain(&set.factor, &self.columns(&cause)).total;
            seeds.push(Seed { family: number, cause, weight, score: prior + weight + gain });
        }
        seeds
    }

    /// The best temperature difference of each time constant.
    fn sensor_seeds(
        &self,
        number: usize,
        sensors: &[String],
        points: &[(usize, f64, Effect)],
        look: &Look,
        left: f64,
        prior: f64,
    ) -> Vec<Seed> {
        let n = sensors.len();
        let [alone, paired] = Families::sensor_weights(n);
        // Of each difference the best time constant: score, weight, place in the grid.
        let mut best = vec![(f64::NEG_INFINITY, 0.0, 0); n * n];
        let mut all = Vec::new();
        for (k, (group, weight, _)) in points.iter().enumerate() {
            let (columns, at) = self.families.bank.group(*group);
            let along = &look.along[columns];
            let among = |i: usize, j: usize| look.among[at + i * n + j];
            for i in 0..n {
                for j in i..n {
                    let (h, s, w) = if i == j {
                        (along[i], among(i, i), alone)
                    } else {
                        (along[i] - along[j], among(i, i) + among(j, j) - 2.0 * among(i, j), paired)
                    };
                    let score = w + weight + gain_of_one(s, h, left, self.base.freedom).total;
                    all.push(score);
                    if score > best[i * n + j].0 {
                        best[i * n + j] = (score, w + weight, k);
                    }
                }
            }
        }
        let mut best: Vec<_> =
            best.into_iter().enumerate().map(|(at, (score, w, k))| (score, w, k, at / n, at % n)).collect();
        best.sort_by(|a, b| b.0.total_cmp(&a.0));
        best.truncate(DIFFERENCES);
        let total = log_sum(all);
        let first = best.first().map_or(0.0, |b| b.0);
        best.into_iter()
            .map(|(score, weight, k, i, j)| {
                let mut effect = points[k].2.clone();
                effect.delta = Some(difference(sensors, i, j));
                let cause = Cause::Effect { effect, free: 1, reference: false };
                Seed { family: number, cause, weight, score: prior + total + score - first }
            })
            .collect()
    }

    /// A wave at a frequency.
    /// A wave without a name has harmonics, each of size one over its number.
    fn wave(&self, family: &Family, frequency: f64, harmonics: usize) -> Option<Cause> {
        let Scan::Wave { along, unit, .. } = &family.scan else { return None };
        if let Some(effect) = &family.effect {
            let effect = effect.with(&[(0, 1.0 / (frequency * unit))])?;
            return Some(Cause::Effect { effect, free: 2, reference: false });
        }
        let of = |k: usize| {
            let k = k as f64;
            along.wave(k * frequency, self.problem.rows.n, CONTRIBUTION / k)
        };
        let fine = |k: &usize| *k == 1 || *k as f64 * frequency <= along.range()[1];
        let columns = (1..=harmonics).filter(fine).flat_map(of).collect();
        Some(Cause::Shape(Arc::new((family.shape.clone()?, columns))))
    }

    /// The wave of another frequency that looks the same at these places.
    /// Of several, the one that is likeliest a priori.
    #[must_use]
    pub fn alike(&self, member: &Member) -> Vec<Seed> {
        let family = self.family(member.family);
        let (Scan::Wave { along, unit, .. }, Some(effect)) = (&family.scan, member.cause.effect()) else {
            return Vec::new();
        };
        let of = |f: f64| {
            let weight = wave_weight(family, f, *unit, along.range(), along.span());
            Some(Seed { family: member.family, cause: self.wave(family, f, 1)?, weight, score: weight })
        };
        let mut all: Vec<Seed> =
            along.alike(1.0 / (effect.scalar(0) * unit)).into_iter().filter_map(of).collect();
        all.sort_by(|a, b| b.score.total_cmp(&a.score));
        all.truncate(TRIED);
        all
    }

    /// Other maps that are equivalent to the last member at these rows.
    /// On a circle z² = r² − x². Which of them the data prefer is chance, in directions that none of them needs.
    #[must_use]
    pub fn maps_alike(&self, set: &Set) -> Vec<Seed> {
        let Some(own) = set.members.last().filter(|m| matches!(m.cause, Cause::Map { .. })) else {
            return Vec::new();
        };
        let without = self.first(set, set.members.len() - 1);
        let beta = set.factor.solve();
        let mut found = vec![0.0; self.problem.rows.n];
        for (c, b) in own.columns.iter().zip(&beta[without.len()..]) {
            add(&mut found, b * own.level, c);
        }
        let found = without.beside(&found);
        let power = dot(&found, &found);
        let shows = |cause: &Cause| {
            let mut other = Factor::new(&found);
            for c in self.columns(cause) {
                other.push(&without.beside(&c).iter().map(|x| x * WIDE).collect::<Vec<_>>());
            }
            1.0 - dot(other.residual(), other.residual()) / power
        };
        let of = |(family, f): (usize, &Family)| {
            let Scan::Grid(points) = &f.scan else { return None };
            let other = family != own.family && f.replaces.is_none();
            let maps = points.iter().filter(|p| other && matches!(p.2, Cause::Map { .. }));
            let (_, weight, cause) = maps.into_iter().find(|p| shows(&p.2) > ALIKE)?;
            Some(Seed { family, cause: cause.clone(), weight: *weight, score: f.prior })
        };
        self.families.list.iter().enumerate().filter_map(of).collect()
    }

    /// Refines a seed's non-linear parameters to where it explains most.
    #[must_use]
    pub fn refined(&self, factor: &Factor, seed: &Seed) -> Seed {
        let Some(effect) = seed.cause.effect().cloned() else { return seed.clone() };
        let moves = moves(self.family(seed.family), &effect);
        if moves.is_empty() {
            return seed.clone();
        }
        let value = |effect: &Effect| {
            let cause = seed.cause.with_effect(effect.clone());
            self.gain(factor, &self.columns(&cause)).total
        };
        let mut now = effect;
        let mut best = value(&now);
        let mut narrower = 0.0;
        for round in 0..2 {
            for m in &moves {
                let mut step = if round == 0 { m.step } else { m.step * 0.3 };
                for _ in 0..4 {
                    let (Some(down), Some(up)) = (m.moved(&now, -step), m.moved(&now, step)) else { break };
                    let (a, b) = (value(&down), value(&up));
                    if a > best && a >= b {
                        (now, best) = (down, a);
                    } else if b > best {
                        (now, best) = (up, b);
                    } else {
                        let bend = a + b - 2.0 * best;
                        let at = if bend < -1e-9 { 0.5 * step * (a - b) / bend } else { 0.0 };
                        if at != 0.0
                            && let Some(top) = m.moved(&now, at)
                        {
                            let v = value(&top);
                            if v > best {
                                (now, best) = (top, v);
                            }
                        }
                        if round == 1 || moves.len() == 1 {
                            // Width of the mode relative to a cell of the grid.
                            let width = (std::f64::consts::TAU * step * step / (-bend).max(1e-12)).sqrt();
                            narrower = (width / (2.0 * m.step)).ln().min(0.0);
                        }
                        step *= 0.4;
                    }
                }
            }
        }
        let before = self.gain(factor, &self.columns(&seed.cause)).total;
        // A period that left the usual range by refinement is no usual period.
        let at = |e: Option<&Effect>| self.weight_at(seed.family, e);
        let less = narrower + at(Some(&now)) - at(seed.cause.effect());
        Seed {
            family: seed.family,
            cause: seed.cause.with_effect(now),
            weight: seed.weight + less,
            score: seed.score + (best - before).max(0.0) + less,
        }
    }

    /// Log prior weight of a wave's period; zero for other causes.
    fn weight_at(&self, family: usize, effect: Option<&Effect>) -> f64 {
        let family = self.family(family);
        let (Scan::Wave { along, unit, .. }, Some(effect)) = (&family.scan, effect) else { return 0.0 };
        wave_weight(family, 1.0 / (effect.scalar(0) * unit), *unit, along.range(), along.span())
    }

    /// Richer forms of a seed.
    /// Growth that bends, another reference temperature, a wave that changes.
    fn richer(seed: &Seed) -> Vec<Seed> {
        let mut out = Vec::new();
        let Cause::Effect { effect, free, .. } = &seed.cause else { return out };
        let law = effect.description();
        if law.companion.is_some() && effect.delta.is_some() {
            if effect.coefficient_count() > *free {
                let cause = Cause::Effect { effect: effect.clone(), free: free + 1, reference: false };
                out.push(Seed { cause, weight: seed.weight + BENT_SHARE.ln(), ..seed.clone() });
            }
            let pair = effect.delta.as_ref().is_some_and(Difference::is_pair);
            let constant = effect.companion().is_some_and(|c| c.description().constant);
            if !pair && !constant {
                let cause = Cause::Effect { effect: effect.clone(), free: *free, reference: true };
                out.push(Seed { cause, weight: seed.weight + BENT_SHARE.ln(), ..seed.clone() });
            }
        }
        out
    }

    /// A wave whose size changes along its way, beside a seed that is a wave.
    /// It has no name.
    fn changing(&self, seed: &Seed) -> Option<Seed> {
        let Scan::Wave { along, .. } = &self.family(seed.family).scan else { return None };
        let effect = seed.cause.effect()?;
        let shape = crate::cause::Shape::like(self.problem.rows, effect, "periodic, of changing size")?;
        let family = self
            .families
            .list
            .iter()
            .position(|f| f.shape.as_ref().is_some_and(|s| s.response == shape.response))?;
        let basis = seed.cause.columns(self.problem.rows);
        let columns = changing_wave(self.problem.rows, &basis, &along.places(self.problem.rows.n));
        if columns.is_empty() {
            return None;
        }
        let cause = Cause::Shape(Arc::new((shape, columns)));
        Some(Seed { family, cause, weight: seed.weight, score: seed.score })
    }

    /// Sets with one member more, best first.
    #[must_use]
    pub fn grown(&self, set: &Set, most: usize, long: bool) -> Vec<Set> {
        self.grown_by(set, most, long, |_| true)
    }

    /// The same by families of one kind.
    fn grown_by(&self, set: &Set, most: usize, long: bool, kind: impl Fn(&Family) -> bool) -> Vec<Set> {
        let look = self.look_at(set);
        let mut seeds = self.seeds(set, &look, long);
        seeds.retain(|s| kind(self.family(s.family)));
        let Some(top) = seeds.first().map(|s| s.score) else { return Vec::new() };
        let mut out: Vec<Set> = Vec::new();
        let mut forms: Vec<(f64, usize, Member)> = Vec::new();
        let mut pairs: Vec<Set> = Vec::new();
        let mut waves = 0;
        for (number, seed) in seeds.into_iter().take(TRIED).enumerate() {
            if seed.score < (top - HOPELESS).max(WORTHLESS) {
                break;
            }
            let seed = self.refined(&set.factor, &seed);
            let mut own = Self::richer(&seed);
            let wave = matches!(self.family(seed.family).scan, Scan::Wave { .. });
            if wave && waves < 2 {
                waves += 1;
                own.extend(self.changing(&seed));
            }
            if wave {
                pairs.extend(self.with(set, &seed).and_then(|p| self.with_beside(&p)));
            }
            own.push(seed);
            forms
                .extend(own.iter().filter_map(|f| self.weighed(set, f)).map(|(score, m)| (score, number, m)));
        }
        out.extend(pairs.into_iter().max_by(|a, b| a.score.total_cmp(&b.score)).map(|p| self.in_tune(p)));
        // Only what is kept is fitted.
        forms.sort_by(|a, b| b.0.total_cmp(&a.0));
        let counts = |m: &Member| m.cause.effect().is_some_and(|e| e.description().whole_counts);
        let mut done: Vec<usize> = Vec::new();
        for (_, number, member) in forms {
            if done.contains(&number) || done.len() >= most && !counts(&member) {
                continue;
            }
            if let Some(built) = self.built(set, member) {
                done.push(number);
                out.push(built);
            }
        }
        out.sort_by(|a, b| b.score.total_cmp(&a.score));
        out.truncate(most);
        out
    }

    /// Adds to a set that ends in a wave the effects that only accompany waves.
    fn with_beside(&self, set: &Set) -> Option<Set> {
        let last = set.members.last()?.cause.effect()?;
        let of = |(number, f): (usize, &Family)| {
            let Scan::Beside { law, .. } = &f.scan else { return None };
            let effect = f.effect.as_ref()?;
            if *law != last.description().name || effect.axes() != last.axes() {
                return None;
            }
            let effect = effect.with(&[(0, last.scalar(0))])?;
            let cause = Cause::Effect { effect, free: 2, reference: false };
            self.with(set, &Seed { family: number, cause, weight: 0.0, score: 0.0 })
        };
        let best = self
            .families
            .list
            .iter()
            .enumerate()
            .filter_map(of)
            .max_by(|a, b| a.score.total_cmp(&b.score))?;
        // Before the periods agree both explain less.
        Some(best).filter(|s| s.score > set.score - HOPELESS)
    }

    /// Tunes the last two members, a wave and its companion, to one period.
    /// The period is where both explain most.
    fn in_tune(&self, mut set: Set) -> Set {
        let n = set.members.len();
        let (Some(wave), Scan::Wave { along, unit, .. }) =
            (set.members[n - 2].cause.effect().cloned(), &self.family(set.members[n - 2].family).scan)
        else {
            return set;
        };
        let mut frequency = 1.0 / wave.scalar(0);
        let mut step = 0.2 / along.span() * unit;
        let others = self.first(&set, n - 2);
        let at = |set: &Set, frequency: f64| {
            let mut members = set.members.clone();
            for m in &mut members[n - 2..] {
                let effect = m.cause.effect()?.with(&[(0, 1.0 / frequency)])?;
                m.cause = m.cause.with_effect(effect);
                m.set_columns(self.columns(&m.cause));
            }
            Some(self.grown_from(others.clone(), members, n - 2))
        };
        for _ in 0..12 {
            let tried = [-step, step].map(|by| at(&set, frequency + by).map(|s| (s, frequency + by)));
            let better = tried.into_iter().flatten().max_by(|a, b| a.0.score.total_cmp(&b.0.score));
            match better {
                Some((s, f)) if s.score > set.score => (set, frequency) = (s, f),
                _ => step *= 0.4,
            }
        }
        set
    }

    /// Whether all members have names.
    fn is_named(&self, set: &Set) -> bool {
        set.members.iter().all(|m| {
            self.family(m.family).is_named() && matches!(m.cause, Cause::Effect { .. } | Cause::Map { .. })
        })
    }

    /// A set without one of its members.
    #[must_use]
    pub fn without(&self, set: &Set, member: usize) -> Set {
        let mut members = set.members.clone();
        members.remove(member);
        self.grown_from(self.first(set, member), members, member)
    }

    /// The same set with one of its members last.
    #[must_use]
    pub fn of_last(&self, set: &Set, member: usize) -> Set {
        let mut members = set.members.clone();
        let last = members.remove(member);
        members.push(last);
        self.grown_from(self.first(set, member), members, member)
    }

    /// Sets with one member more: the best, and the best by names.
    fn children(&self, set: &Set, long: bool) -> Vec<Set> {
        let mut all = self.grown(set, KEPT + 1, long);
        if all.iter().filter(|s| self.family(s.members[s.members.len() - 1].family).is_named()).count() < 2 {
            all.extend(self.grown_by(set, 2, long, Family::is_named));
        }
        all
    }

    /// The best set that can be reached from one.
    /// With `anew`, several sets first grow from it side by side.
    #[must_use]
    pub fn best(&self, start: &Set, anew: bool) -> Set {
        let mut best = start.clone();
        let mut beam = if anew { vec![start.clone()] } else { Vec::new() };
        let mut idle = 0;
        while idle < 2 && !beam.is_empty() {
            let mut next: Vec<Set> =
                beam.iter().enumerate().flat_map(|(i, s)| self.children(s, i == 0)).collect();
            next.sort_by(|a, b| b.score.total_cmp(&a.score));
            // A shape can replace several names at once, so sets of names alone keep places of their own.
            let mut kept: Vec<Set> = Vec::new();
            let mut named = 0;
            for s in next {
                let all_named = self.is_named(&s);
                let room = kept.len() < KEPT || (all_named && named < 2);
                if room && kept.iter().all(|k| (k.score - s.score).abs() > 1e-6 || differ(k, &s)) {
                    named += usize::from(all_named);
                    kept.push(s);
                }
            }
            match kept.first() {
                Some(s) if s.score > best.score => {
                    best = s.clone();
                    idle = 0;
                }
                _ => idle += 1,
            }
            kept.retain(|s| s.score > best.score - HOPELESS);
            beam = kept;
        }
        self.polished(best)
    }

    /// The best set that exchanging two members reaches.
    /// Returns the same set if none is better.
    #[must_use]
    pub fn exchanged(&self, start: &Set) -> Set {
        let mut best = start.clone();
        while !best.members.is_empty() && (best.members.len() > 1 || !self.is_named(&best)) {
            let exchanged = self.two_for_two(&self.simpler(&best));
            if exchanged.score < best.score + 0.05 {
                break;
            }
            best = self.polished(exchanged);
        }
        best
    }

    /// Members left out, exchanged and refined again until nothing is better.
    fn polished(&self, mut best: Set) -> Set {
        for _ in 0..6 {
            let before = best.score;
            for i in (0..best.members.len()).rev() {
                let without = self.without(&best, i);
                if without.score > best.score && self.possible(&without) {
                    best = without;
                    continue;
                }
                for other in self.grown(&without, 1, false) {
                    if other.score > best.score + 1e-6 {
                        best = other;
                    }
                }
            }
            best = self.together(best);
            for other in self.grown(&best, 1, true) {
                if other.score > best.score {
                    best = other;
                }
            }
            if best.score < before + 0.05 {
                break;
            }
        }
        best
    }

    /// Exchanges each shape, and each two of the weakest members, for two others.
    fn two_for_two(&self, set: &Set) -> Set {
        let mut best = set.clone();
        let alone: Vec<f64> = (0..set.members.len()).map(|i| self.without(set, i).score).collect();
        let mut weak: Vec<usize> = (0..set.members.len()).collect();
        weak.sort_by(|a, b| alone[*b].total_cmp(&alone[*a]));
        let shapes = weak.iter().copied().filter(|i| matches!(set.members[*i].cause, Cause::Shape(_)));
        let mut gone: Vec<Set> = shapes.map(|i| self.without(set, i)).collect();
        weak.retain(|i| set.score - alone[*i] < STRONG);
        weak.truncate(3);
        for (k, i) in weak.iter().enumerate() {
            gone.extend(weak[..k].iter().map(|j| self.without(&self.without(set, *i.max(j)), *i.min(j))));
        }
        for without in gone {
            for one in self.children(&without, false) {
                let one = self.rechosen(one);
                if one.score > best.score + 1e-6 {
                    best = one.clone();
                }
                for two in self.grown(&one, 1, false) {
                    if two.score > best.score + 1e-6 {
                        best = two;
                    }
                }
            }
        }
        best
    }

    /// Re-selects the members that act on the same axis as the new last member.
    fn rechosen(&self, set: Set) -> Set {
        let last = set.members.len() - 1;
        let Some(own) = set.members.last().and_then(axis_of) else { return set };
        self.chosen_again(set, &own, last)
    }

    /// Re-selects up to `most` members of an axis: maps and temperature laws.
    fn chosen_again(&self, mut set: Set, axis: &Axis, most: usize) -> Set {
        for i in (0..most).rev() {
            let m = &set.members[i];
            let grid =
                matches!(self.family(m.family).scan, Scan::Grid(_)) && !matches!(m.cause, Cause::Map { .. });
            if axis_of(m).as_ref() != Some(axis) || grid {
                continue;
            }
            let without = self.without(&set, i);
            if let Some(other) = self.grown_by(&without, 1, false, Family::is_named).pop()
                && other.score > set.score
            {
                set = other;
            }
        }
        set
    }

    /// A set without one of its weaker members; the others on its axis are re-selected.
    fn simpler(&self, set: &Set) -> Set {
        let mut best = set.clone();
        for i in 0..set.members.len() {
            let Some(axis) = axis_of(&set.members[i]) else { continue };
            let without = self.without(set, i);
            if set.score - without.score > 2.0 * STRONG {
                continue;
            }
            let most = without.members.len();
            let other = self.chosen_again(without, &axis, most);
            if other.score > best.score {
                best = other;
            }
        }
        best
    }

    /// Refines each member's non-linear parameters beside the others', twice.
    fn together(&self, mut set: Set) -> Set {
        if set.members.len() < 2 {
            return set;
        }
        for i in 0..set.members.len() {
            let m = set.members[i].clone();
            if m.cause.effect().is_none_or(|e| moves(self.family(m.family), e).is_empty()) {
                continue;
            }
            let without = self.without(&set, i);
            let seed = Seed { family: m.family, cause: m.cause, weight: 0.0, score: 0.0 };
            let refined = self.refined(&without.factor, &seed);
            let mut members = set.members.clone();
            members[i].set_columns(self.columns(&refined.cause));
            members[i].cause = refined.cause;
            let new = self.grown_from(self.first(&set, i), members, i);
            if new.score > set.score && self.possible(&new) {
                set = new;
            }
        }
        set
    }
}

/// Converts members of another search into members of these families.
/// Members that depend on the rows themselves are dropped.
#[must_use]
pub fn known_again(families: &Families, members: &[Member]) -> Vec<Member> {
    let of = |m: &Member| {
        let effect = m.cause.effect()?;
        let same = |f: &Family| {
            f.replaces == m.replaces && f.effect.as_ref().is_some_and(|e| e.name() == effect.name())
        };
        let mut m = m.clone();
        m.family = families.list.iter().position(same)?;
        Some(m)
    };
    members.iter().filter_map(of).collect()
}

/// Adds a member's columns to a factor.
fn push(factor: &mut Factor, member: &Member) {
    for c in member.columns.iter() {
        factor.push(&c.iter().map(|x| x * member.level).collect::<Vec<_>>());
    }
}

/// Whether a growth changes sign within the temperatures seen.
/// No part of a machine does that.
fn turns_back(rows: &Rows<'_>, effect: &Effect) -> bool {
    let [per_k, per_k2] = effect.coefficients()[..] else { return false };
    if effect.description().heat != Heat::Growth || per_k2 == 0.0 {
        return false;
    }
    let warm = rows.basis(effect).swap_remove(0);
    let (lo, hi) = warm.iter().fold((0.0_f64, 0.0_f64), |(l, h), x| (l.min(*x), h.max(*x)));
    (per_k + 2.0 * per_k2 * lo) * (per_k + 2.0 * per_k2 * hi) < 0.0
}

/// The axis that a member acts on.
fn axis_of(m: &Member) -> Option<Axis> {
    m.cause.effect().and_then(|e| e.axes().first().cloned())
}

/// Whether two sets consist of different families.
fn differ(a: &Set, b: &Set) -> bool {
    let of = |s: &Set| {
        let mut f: Vec<usize> = s.members.iter().map(|m| m.family).collect();
        f.sort_unstable();
        f
    };
    of(a) != of(b)
}

/// A temperature difference of these sensors: one alone, or one against another.
#[must_use]
pub fn difference(sensors: &[String], i: usize, j: usize) -> Difference {
    if i == j { Difference::single(&sensors[i]) } else { Difference::pair(&sensors[i], &sensors[j]) }
}

/// Log prior weight of a wave of this frequency.
/// Uniform in the logarithm of the period; usual periods weigh more.
fn wave_weight(family: &Family, frequency: f64, unit: f64, [from, to]: [f64; 2], span: f64) -> f64 {
    // Typical width of a mode, as a share of the frequency.
    let cell = (0.35 / span / frequency).min(1.0);
    let even = cell / (to / from).ln().max(cell);
    let Some(facts) = family.effect.as_ref().and_then(|e| e.description().searched.wave) else {
        return even.ln();
    };
    let period_mm = 1.0 / (frequency * unit) * facts.unit_mm;
    let usual: Vec<f64> = facts.usual_mm.iter().flat_map(|p| [*p, 0.5 * p]).collect();
    let near = usual.iter().any(|u| (period_mm / u - 1.0).abs() < USUAL_WITHIN);
    let usual = if near { USUAL_SHARE / usual.len() as f64 } else { 0.0 };
    ((1.0 - USUAL_SHARE) * even + usual).ln()
}

/// A way to move a non-linear parameter.
struct Move {
    parameter: usize,
    /// First step.
    step: f64,
    how: Refine,
    /// What the rows can show of it.
    range: [f64; 2],
}

impl Move {
    fn moved(&self, effect: &Effect, by: f64) -> Option<Effect> {
        let v = effect.scalar(self.parameter);
        let to = match self.how {
            Refine::Step(_) => v + by,
            // A period: in its frequency.
            Refine::Stays => 1.0 / (1.0 / v + by),
            _ => v * by.exp(),
        };
        let to = to.clamp(self.range[0], self.range[1]);
        effect.with(&[(self.parameter, to)])
    }
}

fn moves(family: &Family, effect: &Effect) -> Vec<Move> {
    if family.replaces.is_some() {
        return Vec::new();
    }
    if let Scan::Wave { along, unit, .. } = &family.scan {
        let step = 0.2 / along.span() * unit;
        return vec![Move { parameter: 0, step, how: Refine::Stays, range: everything() }];
    }
    let of = |(parameter, p): (usize, &rtec_model::effect::Parameter)| {
        let (Refine::Step(step) | Refine::Factor(step) | Refine::TimeConstant(step)) = p.refine else {
            return None;
        };
        let range = family.range(parameter);
        (p.search == How::Smooth).then_some(Move { parameter, step, how: p.refine, range })
    };
    effect.description().parameters.iter().enumerate().filter_map(of).collect()
}

/// No bounds.
fn everything() -> [f64; 2] {
    [f64::NEG_INFINITY, f64::INFINITY]
}

impl Family {
    /// Range of the grid in one parameter: what the rows can show of it.
    fn range(&self, parameter: usize) -> [f64; 2] {
        let wider = |[lo, hi]: [f64; 2], effect: &Effect| {
            let v = effect.scalar(parameter);
            [lo.min(v), hi.max(v)]
        };
        let none = [f64::INFINITY, f64::NEG_INFINITY];
        let [lo, hi] = match &self.scan {
            Scan::Grid(points) => points.iter().filter_map(|p| p.2.effect()).fold(none, wider),
            Scan::Sensors { points, .. } => points.iter().map(|p| &p.2).fold(none, wider),
            _ => none,
        };
        if lo < hi { [lo, hi] } else { everything() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rtec_model::effect::Dictionary;
    use rtec_model::record::{Column, Kind, Record, Role};

    /// The products that follow from R equal those computed directly.
    /// A reading of 20 °C, which is nearly the zero's column, is included.
    #[test]
    fn the_look_beside_a_set_is_that_beside_its_factor() {
        let n = 400;
        let column = |name: &str, role: Role, of: &dyn Fn(f64) -> f64| Column {
            name: name.to_owned(),
            unit: role.unit().unwrap_or("1").to_owned(),
            role,
            data: (0..n).map(|i| of(f64::from(i))).collect(),
        };
        let warm = |i: f64| 0.2 * (i / 60.0).sin() + 0.01 * (i * 7919.0 % 1000.0) / 1000.0;
        let columns = vec![
            column("t", Role::Time, &|i| 30.0 * i),
            column("T1", Role::Temperature, &|i| 20.0 + warm(i)),
            column("T2", Role::Temperature, &|i| 20.0 + 0.9 * warm(i) + 0.001 * (i / 9.0).cos()),
            column("e", Role::Error(Axis::new("z").unwrap()), &|i| 30.0 * warm(i) + 0.05 * (i * 1.7).sin()),
        ];
        let records = [Record::new(std::path::Path::new("r.run.toml"), Kind::Drift, columns).unwrap()];
        let rows = Rows::new(&records);
        let problem = Problem::new(&rows, &[], &[]);
        let mut families = Families::new(&rows, &Dictionary::default(), &[]);
        let mut noise = problem.first_noise();
        (noise.sigma, noise.phi) = (vec![0.05], vec![0.0]);
        families.bank.whiten(&rows, &noise);
        let search = Search::new(&problem, &families, problem.base(noise));
        let set = search.grown(&search.nothing(), 1, true).swap_remove(0);
        let set = search.grown(&set, 1, true).into_iter().next().unwrap_or(set);
        assert!(!set.members.is_empty());
        let (quick, anew) = (search.look_at(&set), families.bank.look(&set.factor));
        let near = |a: &[f64], b: &[f64], size: f64| {
            a.iter().zip(b).map(|(x, y)| (x - y).abs() / (size + y.abs())).fold(0.0, f64::max)
        };
        assert!(near(&quick.along, &anew.along, 1.0) < 0.05, "{}", near(&quick.along, &anew.along, 1.0));
        assert!(near(&quick.among, &anew.among, 1.0) < 0.05, "{}", near(&quick.among, &anew.among, 1.0));
    }
}
