//! The search for the likeliest set of hypotheses.
//! Several sets grow in parallel, one member at a time. Then members are exchanged (one for one, two for two)
//! and left out, until nothing improves the set.

mod grow_and_exchange;
mod screening;

use crate::candidate_hypotheses::{CandidateHypotheses, HypothesesOfOneName, HypothesisSearchSpace};
use crate::hypothesis_column_bank::ScreeningProducts;
use crate::hypothesis_contribution::HypothesisContribution;
use crate::measurement_model::{EstimationProblem, WhitenedBaseline};
use crate::priors::{AGAIN, LEVELS, SAME_PERIOD};
use crate::search_limits::{MOST_MEMBERS, MOST_SHAPES};
use rtec_least_squares::{QrFactor, add, dot, prior_terms};
use rtec_model::effect::{Effect, TemperatureDifference};
use screening::turns_back;
use std::cell::{OnceCell, RefCell};
use std::collections::HashMap;
use std::rc::Rc;

/// A member of a set.
#[derive(Debug, Clone)]
pub struct HypothesisSetMember {
    /// Its family.
    pub family: usize,
    /// Index of the model's effect that it replaces.
    pub replaces: Option<usize>,
    /// Its contribution, with its non-linear parameters.
    pub cause: HypothesisContribution,
    /// Size of its prior, in typical sizes.
    pub level: f64,
    /// Log prior: name, grid point, level.
    pub prior: f64,
    /// Log weight of its grid point.
    weight: f64,
    /// Its columns, whitened by the noise of its search.
    columns: Rc<Columns>,
    /// A number that stands for its family, its columns and its level.
    mark: u64,
    /// The bank's products with its columns after the base; computed on first use.
    shares: Rc<OnceCell<Columns>>,
}

impl HypothesisSetMember {
    /// Number of columns.
    #[must_use]
    pub fn width(&self) -> usize {
        self.columns.len()
    }

    /// The seed that it grew from, with its present non-linear parameters.
    pub(crate) fn seed(&self) -> ScreenedHypothesis {
        ScreenedHypothesis { family: self.family, cause: self.cause.clone(), weight: self.weight, score: 0.0 }
    }

    fn set_columns(&mut self, columns: Columns) {
        self.mark = mark(self.family, &columns, self.level);
        self.columns = Rc::new(columns);
        self.shares = Rc::default();
    }
}

/// A number that stands for a member.
/// Two families may have the same columns, and only one of them may join again.
/// Others have the same one by a chance of one in 2⁶⁴.
fn mark(family: usize, columns: &Columns, level: f64) -> u64 {
    let numbers = columns.iter().flatten().chain([&level]);
    numbers.fold(family as u64 + 1, |mark, x| {
        (mark.rotate_left(5) ^ x.to_bits()).wrapping_mul(0x517c_c1b7_2722_0a95)
    })
}

/// A set with its fit.
#[derive(Debug, Clone)]
pub struct HypothesisSet {
    /// The members.
    pub members: Vec<HypothesisSetMember>,
    /// The base's columns, then the members'.
    pub factor: QrFactor,
    /// log p(y | S) + log p(S), up to a constant.
    pub score: f64,
}

/// A hypothesis to be computed exactly.
#[derive(Debug, Clone)]
pub struct ScreenedHypothesis {
    /// Its family.
    pub family: usize,
    /// Its contribution, with its non-linear parameters.
    pub cause: HypothesisContribution,
    /// Log weight of its grid point.
    pub weight: f64,
    /// Log odds by the quick look, including the family's prior.
    pub score: f64,
}

/// A search under one noise.
pub struct HypothesisSearch<'p> {
    /// The rows and the model, to be explained.
    pub problem: &'p EstimationProblem<'p>,
    /// The hypotheses that may explain them.
    pub families: &'p CandidateHypotheses,
    /// Set-up terms and known effects.
    pub base: WhitenedBaseline,
    /// The quick look after the base only.
    pub look: ScreeningProducts,
    /// Rounding errors that rows share; they widen intervals.
    pub rounding: Vec<crate::set_up_terms::SetUpTerm>,
    cache: SearchCache,
}

/// What a search computes once.
#[derive(Default)]
struct SearchCache {
    /// Columns of waves, whitened, and their products with the base's columns.
    waves: RefCell<Waves>,
    /// Seeds of sets. Exchanges and removals come back to the same sets.
    screenings: RefCell<Screenings>,
    /// Sizes of changing waves by family, at all rows.
    envelopes: RefCell<HashMap<usize, Rc<Columns>>>,
}

/// Whitened columns.
type Columns = Vec<Vec<f64>>;
/// Waves by family and by the bits of the frequency.
type Waves = HashMap<(usize, u64), Rc<[Columns; 2]>>;
/// Seeds by the marks of a set's members, without and with long waves.
type Screenings = HashMap<(Vec<u64>, bool), Rc<[ScreenedHypothesis]>>;

/// Evidence of columns at each level of their size.
#[derive(Debug, Clone, Copy)]
pub struct PriorScaleEvidence {
    /// Log Bayes factor, summed over the levels.
    pub total: f64,
    /// The best level.
    pub level: f64,
    /// Log Bayes factor at that level, including its weight.
    pub best: f64,
}

pub(crate) fn log_sum(values: impl IntoIterator<Item = f64>) -> f64 {
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
pub fn profile_log_likelihood(left: f64, freedom: f64) -> f64 {
    let left = left.max(1e-9 * freedom);
    if left > freedom { -0.5 * freedom * ((left / freedom).ln() + 1.0) } else { -0.5 * left }
}

/// Gain of columns from ½ log |I + t²S| and t²hᵀ(I + t²S)⁻¹h at each level.
fn gain_of(at_level: impl Fn(f64) -> (f64, f64), left: f64, freedom: f64) -> PriorScaleEvidence {
    let now = profile_log_likelihood(left, freedom);
    let at = LEVELS.map(|(level, weight)| {
        let (half_log_det, less) = at_level(level * level);
        weight.ln() - half_log_det + profile_log_likelihood(left - less, freedom) - now
    });
    let best = (0..at.len()).max_by(|a, b| at[*a].total_cmp(&at[*b])).unwrap_or(0);
    PriorScaleEvidence { total: log_sum(at), level: LEVELS[best].0, best: at[best] }
}

/// Gain of one column.
fn gain_of_one(square: f64, along: f64, left: f64, freedom: f64) -> PriorScaleEvidence {
    let of = |t: f64| {
        let l = 1.0 + t * square.max(0.0);
        (0.5 * l.ln(), t * along * along / l)
    };
    gain_of(of, left, freedom)
}

/// Gain of columns with these products with the residual and among each other.
#[must_use]
pub fn gain(along: &[f64], among: &[f64], left: f64, freedom: f64) -> PriorScaleEvidence {
    let p = along.len();
    if p == 1 {
        return gain_of_one(among[0], along[0], left, freedom);
    }
    gain_of(|t| prior_terms(along, among, t), left, freedom)
}

impl<'p> HypothesisSearch<'p> {
    /// A search of a problem under a noise.
    /// The families' columns must be whitened already.
    #[must_use]
    pub fn new(
        problem: &'p EstimationProblem<'p>,
        families: &'p CandidateHypotheses,
        base: WhitenedBaseline,
    ) -> Self {
        let look = families.bank.screening_products(&base.factor);
        let rounding = crate::set_up_terms::rounding(problem.rows);
        Self { problem, families, base, look, rounding, cache: SearchCache::default() }
    }

    fn family(&self, family: usize) -> &HypothesesOfOneName {
        &self.families.list[family]
    }

    /// The set without members.
    #[must_use]
    pub fn nothing(&self) -> HypothesisSet {
        let score = profile_log_likelihood(self.base.factor.left(), self.base.freedom);
        HypothesisSet { members: Vec::new(), factor: self.base.factor.clone(), score }
    }

    /// Whitened columns of a cause.
    #[must_use]
    pub fn columns(&self, cause: &HypothesisContribution) -> Vec<Vec<f64>> {
        self.whitened(cause.columns(self.problem.rows))
    }

    fn whitened(&self, mut columns: Columns) -> Columns {
        for c in &mut columns {
            self.base.noise.whiten(self.problem.rows, c);
        }
        columns
    }

    /// Gain of columns added to a factor.
    #[must_use]
    pub fn gain(&self, factor: &QrFactor, columns: &[Vec<f64>]) -> PriorScaleEvidence {
        let (along, among) = Self::products(factor, columns);
        gain(&along, &among, factor.left(), self.base.freedom)
    }

    /// As [`Self::products_of`], for columns that are new to the factor.
    fn products(factor: &QrFactor, columns: &[Vec<f64>]) -> (Vec<f64>, Vec<f64>) {
        Self::products_of(factor, columns, &columns.iter().map(|c| factor.shares(c)).collect::<Columns>())
    }

    /// As [`Self::gain`], for columns whose products with the factor are known.
    fn gain_of(&self, factor: &QrFactor, columns: &[Vec<f64>], shares: &[Vec<f64>]) -> PriorScaleEvidence {
        let (along, among) = Self::products_of(factor, columns, shares);
        gain(&along, &among, factor.left(), self.base.freedom)
    }

    /// Products of columns with a factor's residual, and among each other.
    /// The latter are those after projection on the factor.
    fn products_of(factor: &QrFactor, columns: &[Vec<f64>], shares: &[Vec<f64>]) -> (Vec<f64>, Vec<f64>) {
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
        (along, among)
    }

    /// The quick look after a set.
    /// The bank's products with a member's columns, after the base, are computed once. Those with the
    /// factor's orthonormal columns follow from R.
    #[must_use]
    pub fn look_at(&self, set: &HypothesisSet) -> ScreeningProducts {
        let bank = &self.families.bank;
        let from = self.base.factor.len();
        let mut new: Columns = Vec::new();
        for m in &set.members {
            let beside = |c: &Vec<f64>| self.base.factor.projected_out(c);
            let shares = || bank.shares_of(&m.columns.iter().map(beside).collect::<Columns>());
            for raw in m.shares.get_or_init(shares) {
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
        bank.update_products(&mut look, &new, &set.factor.along()[from..]);
        look
    }

    /// A set with one more member; `None` if its values are impossible.
    #[must_use]
    pub fn with(&self, set: &HypothesisSet, seed: &ScreenedHypothesis) -> Option<HypothesisSet> {
        self.built(set, self.weighed(set, seed)?.1)
    }

    /// One more member of a set, and the set's score with it.
    /// The score is without the correction for whole counts.
    fn weighed(&self, set: &HypothesisSet, seed: &ScreenedHypothesis) -> Option<(f64, HypothesisSetMember)> {
        rtec_files::cancellable_computation::step();
        if set.members.len() >= MOST_MEMBERS {
            return None;
        }
        let columns = self.columns(&seed.cause);
        let gain = self.gain(&set.factor, &columns);
        let prior = self.prior(set, seed.family) + seed.weight + gain.total - gain.best;
        let level_weight =
            LEVELS.iter().find(|l| l.0.to_bits() == gain.level.to_bits()).map_or(0.0, |l| l.1.ln());
        let member = HypothesisSetMember {
            family: seed.family,
            replaces: self.family(seed.family).replaces,
            cause: seed.cause.clone(),
            level: gain.level,
            prior: prior + level_weight,
            weight: seed.weight,
            mark: mark(seed.family, &columns, gain.level),
            columns: Rc::new(columns),
            shares: Rc::default(),
        };
        Some((set.score + prior + gain.best, member))
    }

    /// The set with that member.
    fn built(&self, set: &HypothesisSet, member: HypothesisSetMember) -> Option<HypothesisSet> {
        let mut factor = set.factor.clone();
        push(&mut factor, &member);
        let mut members = set.members.clone();
        members.push(member);
        let set = self.scored(members, factor);
        self.possible(&set).then_some(set)
    }

    fn scored(&self, members: Vec<HypothesisSetMember>, factor: QrFactor) -> HypothesisSet {
        let prior: f64 = members.iter().map(|m| m.prior).sum();
        let det = factor.half_log_det() - self.base.factor.half_log_det();
        let score = profile_log_likelihood(factor.left(), self.base.freedom) - det
            + prior
            + self.whole_count_correction(&members, &factor);
        HypothesisSet { members, factor, score }
    }

    /// Correction to the likelihood for lost counts, which are whole numbers.
    /// There are fewer whole numbers than real ones.
    fn whole_count_correction(&self, members: &[HypothesisSetMember], factor: &QrFactor) -> f64 {
        let count_um = self.problem.rows.records.iter().find_map(|r| r.count_um);
        let Some(count_um) = count_um else { return 0.0 };
        let of = |m: &HypothesisSetMember| m.cause.effect().is_some_and(|e| e.description().whole_counts);
        if !members.iter().any(of) {
            return 0.0;
        }
        let (beta, inverse) = (factor.solve(), factor.inverse());
        let mut at = self.base.factor.len();
        let mut sum = 0.0;
        for m in members {
            if of(m)
                && let Some(size) =
                    m.cause.effect().and_then(|e| crate::hypothesis_contribution::sizes(e).first().copied())
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

    /// The fit of the members of another search, unchanged.
    #[must_use]
    pub fn set_of_members(&self, mut members: Vec<HypothesisSetMember>) -> HypothesisSet {
        for m in &mut members {
            m.set_columns(self.columns(&m.cause));
        }
        self.grown_from(self.base.factor.clone(), members, 0)
    }

    /// The fit of members, of which the first `done` are in the factor already.
    fn grown_from(
        &self,
        mut factor: QrFactor,
        members: Vec<HypothesisSetMember>,
        done: usize,
    ) -> HypothesisSet {
        for m in &members[done..] {
            push(&mut factor, m);
        }
        self.scored(members, factor)
    }

    /// The factor of a set's first `count` members.
    fn first(&self, set: &HypothesisSet, count: usize) -> QrFactor {
        let width: usize = set.members[..count].iter().map(HypothesisSetMember::width).sum();
        set.factor.first(self.base.factor.len() + width)
    }

    /// Log prior of one more member of a family.
    fn prior(&self, set: &HypothesisSet, family: usize) -> f64 {
        let again = set.members.iter().filter(|m| m.family == family).count();
        self.family(family).prior - AGAIN * again as f64
    }

    /// Coefficients of each member, in its columns' standard deviations.
    #[must_use]
    pub fn coefficients(&self, set: &HypothesisSet) -> Vec<Vec<f64>> {
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

    /// Whether a member that only accompanies waves has its wave.
    /// The wave is in the set or in the model.
    fn is_accompanied(&self, set: &HypothesisSet, member: &HypothesisSetMember) -> bool {
        let (HypothesisSearchSpace::Beside { law, known }, Some(own)) =
            (&self.family(member.family).scan, member.cause.effect())
        else {
            return true;
        };
        let near = |period: f64| (period / own.scalar(0) - 1.0).abs() < SAME_PERIOD;
        known.iter().any(|period| near(*period))
            || set
                .members
                .iter()
                .filter_map(|m| m.cause.effect())
                .any(|e| e.description().name == *law && e.axes() == own.axes() && near(e.scalar(0)))
    }

    /// Whether all effects are within their physical bounds, and no companion is alone.
    #[must_use]
    pub fn possible(&self, set: &HypothesisSet) -> bool {
        self.impossible(set).is_none()
    }

    /// The first member beyond its physical bounds, or a companion that is alone.
    fn impossible(&self, set: &HypothesisSet) -> Option<usize> {
        let beta = self.coefficients(set);
        set.members.iter().zip(&beta).position(|(m, b)| {
            !self.is_accompanied(set, m)
                || self.family(m.family).replaces.is_none()
                    && m.cause
                        .solved(self.problem.rows, b)
                        .is_some_and(|e| !e.is_physical() || turns_back(self.problem.rows, &e))
        })
    }

    /// A set without the members that are impossible in it.
    #[must_use]
    pub fn possible_part(&self, mut set: HypothesisSet) -> HypothesisSet {
        while let Some(member) = self.impossible(&set) {
            set = self.without(&set, member);
        }
        set
    }

    /// Whether a family may join a set.
    fn may_join(&self, set: &HypothesisSet, family: usize) -> bool {
        let f = self.family(family);
        if let Some(shape) = f.shape.as_ref().filter(|_| !f.set_up) {
            let same = |m: &&HypothesisSetMember| matches!(&m.cause, HypothesisContribution::Shape(s) if s.0.response == shape.response);
            let already = set.members.iter().filter(same).count();
            if already >= MOST_SHAPES {
                return false;
            }
        }
        if f.effect.as_ref().is_some_and(|e| self.is_one_of_two(set, e)) {
            return false;
        }
        f.repeats() || !set.members.iter().any(|m| m.family == family)
    }

    /// Whether a set has the same law with exchanged axes.
    /// It counts where a third law makes the two one.
    fn is_one_of_two(&self, set: &HypothesisSet, effect: &Effect) -> bool {
        let Some(beside) = effect.description().searched.one_beside else { return false };
        let is = |e: &Effect, law: &str| e.description().name == law;
        let other = |e: &Effect| is(e, &effect.description().name) && e.axes().iter().rev().eq(effect.axes());
        let third = |e: &Effect| is(e, beside) && e.axes().iter().all(|a| effect.axes().contains(a));
        set.members.iter().filter_map(|m| m.cause.effect()).any(other)
            && self.families.list.iter().filter_map(|f| f.effect.as_ref()).any(third)
    }

    /// A set without one of its members.
    #[must_use]
    pub fn without(&self, set: &HypothesisSet, member: usize) -> HypothesisSet {
        let mut members = set.members.clone();
        let width = members.remove(member).width();
        let from = self.base.factor.len()
            + set.members[..member].iter().map(HypothesisSetMember::width).sum::<usize>();
        self.scored(members, set.factor.without(from..from + width))
    }

    /// The same set with one of its members moved to the end.
    /// Its non-linear parameters are refined and its level is chosen again, given all others, if that is likelier.
    fn refined_last(&self, set: &HypothesisSet, member: usize) -> HypothesisSet {
        let without = self.without(set, member);
        let mut seed = set.members[member].seed();
        let before = self.weight_at(seed.family, seed.cause.effect());
        seed.cause = self.refined(&without.factor, &seed).cause;
        seed.weight += self.weight_at(seed.family, seed.cause.effect()) - before;
        let new = self.with(&without, &seed).filter(|new| new.score > set.score);
        new.unwrap_or_else(|| self.of_last(set, member))
    }

    /// The same set with one of its members moved to the end.
    #[must_use]
    pub fn of_last(&self, set: &HypothesisSet, member: usize) -> HypothesisSet {
        let HypothesisSet { mut members, factor, .. } = self.without(set, member);
        let done = members.len();
        members.push(set.members[member].clone());
        self.grown_from(factor, members, done)
    }
}

/// Converts members of another search into members of these families.
/// Members that depend on the rows themselves are dropped.
#[must_use]
pub fn converted_members(
    families: &CandidateHypotheses,
    members: &[HypothesisSetMember],
) -> Vec<HypothesisSetMember> {
    let of = |m: &HypothesisSetMember| {
        let effect = m.cause.effect()?;
        let same = |f: &HypothesesOfOneName| {
            f.replaces == m.replaces && f.effect.as_ref().is_some_and(|e| e.name() == effect.name())
        };
        let mut m = m.clone();
        m.family = families.list.iter().position(same)?;
        Some(m)
    };
    members.iter().filter_map(of).collect()
}

/// Whether two waves of one law are one mode.
pub(crate) fn same_period(a: &Effect, b: &Effect) -> bool {
    (a.scalar(0) / b.scalar(0) - 1.0).abs() < SAME_PERIOD
}

/// Adds a member's columns to a factor.
fn push(factor: &mut QrFactor, member: &HypothesisSetMember) {
    for c in member.columns.iter() {
        factor.push(&c.iter().map(|x| x * member.level).collect::<Vec<_>>());
    }
}

/// A temperature difference of these sensors: one alone, or one against another.
#[must_use]
pub fn difference(sensors: &[String], i: usize, j: usize) -> TemperatureDifference {
    if i == j {
        TemperatureDifference::single(&sensors[i])
    } else {
        TemperatureDifference::pair(&sensors[i], &sensors[j])
    }
}
