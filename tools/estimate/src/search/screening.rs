//! Candidates to join a set, and their non-linear parameters.

use super::{
    Columns, HypothesisSearch, HypothesisSet, HypothesisSetMember, ScreenedHypothesis, difference, gain,
    gain_of_one, log_sum,
};
use crate::candidate_hypotheses::{CandidateHypotheses, HypothesesOfOneName, HypothesisSearchSpace};
use crate::hypothesis_column_bank::ScreeningProducts;
use crate::hypothesis_contribution::{HypothesisContribution, UnnamedShape};
use crate::priors::{ALIKE, BENT_SHARE, CONTRIBUTION, LISTED, USUAL_SHARE, USUAL_WITHIN, WIDE};
use crate::rows_and_noise::MeasuredRows;
use crate::search_limits::{
    CHANGING, DIFFERENCES, HARMONICS, PEAKS, SAW_PHASES, TRIED, USUAL_TRIED, WAVES_KEPT,
};
use crate::unnamed_shapes::{changing_wave, envelopes};
use crate::wave_periodogram::Periodogram;
use rtec_least_squares::{QrFactor, add, dot, products_beside};
use rtec_model::effect::{
    Effect, ParameterFitMethod, ParameterRefinement, TemperatureDifference, ThermalDependence,
};
use std::rc::Rc;
use std::sync::Arc;

impl HypothesisSearch<'_> {
    /// Seeds worth computing exactly for a set, best first.
    /// `long`: also fine waves over long travel.
    #[must_use]
    pub fn screened(&self, set: &HypothesisSet, long: bool) -> Rc<[ScreenedHypothesis]> {
        let mut marks: Vec<u64> = set.members.iter().map(|m| m.mark).collect();
        marks.sort_unstable();
        let key = (marks, long);
        let known = self.cache.screenings.borrow().get(&key).cloned();
        known.unwrap_or_else(|| {
            let new: Rc<[ScreenedHypothesis]> = self.screened_anew(set, long).into();
            self.cache.screenings.borrow_mut().insert(key, Rc::clone(&new));
            new
        })
    }

    fn screened_anew(&self, set: &HypothesisSet, long: bool) -> Vec<ScreenedHypothesis> {
        let look = &self.look_at(set);
        let (left, freedom) = (set.factor.left(), self.base.freedom);
        let mut seeds: Vec<ScreenedHypothesis> = Vec::new();
        let mut weighed: Option<Vec<f64>> = None;
        for (number, family) in self.families.list.iter().enumerate() {
            if !self.may_join(set, number) {
                continue;
            }
            let prior = self.prior(set, number);
            match &family.scan {
                HypothesisSearchSpace::Grid(points) => {
                    let of = |group: usize| {
                        let (columns, at) = self.families.bank.group(group);
                        let p = columns.len();
                        gain(&look.along[columns], &look.among[at..at + p * p], left, freedom).total
                    };
                    let scored: Vec<f64> = points.iter().map(|(g, w, _)| of(*g) + w).collect();
                    let best = (0..points.len()).max_by(|a, b| scored[*a].total_cmp(&scored[*b]));
                    if let Some(i) = best {
                        let (group, weight, cause) = &points[i];
                        let mut total = log_sum(scored.iter().copied());
                        // Rounding that is left of several columns which the set spans may look like a gain, and
                        // would hide all others.
                        if total > 0.0 && self.families.bank.group(*group).0.len() > 1 {
                            let exact = weight + self.gain(&set.factor, &self.columns(cause)).total;
                            total += (exact - scored[i]).min(0.0);
                        }
                        seeds.push(ScreenedHypothesis {
                            family: number,
                            cause: cause.clone(),
                            weight: *weight,
                            score: prior + total,
                        });
                        // Another number of lobes or another position is a mode of its own.
                        let tells = cause.effect().is_some_and(|e| {
                            e.description().searched.repeats
                                && e.description().parameters.iter().any(|p| p.tells_apart)
                        });
                        for k in
                            (0..points.len()).filter(|k| tells && *k != i && scored[*k] > scored[i] - LISTED)
                        {
                            let (_, weight, cause) = &points[k];
                            let score = prior + total + scored[k] - scored[i];
                            seeds.push(ScreenedHypothesis {
                                family: number,
                                cause: cause.clone(),
                                weight: *weight,
                                score,
                            });
                        }
                    }
                }
                HypothesisSearchSpace::Sensors { sensors, points } => {
                    seeds.extend(self.sensor_seeds(number, sensors, points, look, left, prior));
                }
                HypothesisSearchSpace::Beside { law, known } => {
                    let Some(effect) = &family.effect else { continue };
                    let own = set.members.iter().filter_map(|m| m.cause.effect());
                    let own = own.filter(|e| e.description().name == *law && e.axes() == effect.axes());
                    for period in known.iter().copied().chain(own.map(|e| e.scalar(0))) {
                        let Some(effect) = effect.with(&[(0, period)]) else { continue };
                        let cause = HypothesisContribution::Effect { effect, free: 2, reference: false };
                        let score = prior + self.gain(&set.factor, &self.columns(&cause)).total;
                        seeds.push(ScreenedHypothesis { family: number, cause, weight: 0.0, score });
                    }
                }
                HypothesisSearchSpace::Wave { along, .. } if along.is_long() && !long => {}
                HypothesisSearchSpace::Wave { .. } => {
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
    pub(super) fn wave_seeds(
        &self,
        number: usize,
        set: &HypothesisSet,
        weighed: &[f64],
        prior: f64,
    ) -> Vec<ScreenedHypothesis> {
        let family = self.family(number);
        let HypothesisSearchSpace::Wave { along, unit, .. } = &family.scan else { return Vec::new() };
        let mut seeds = Vec::new();
        let mut at = along.peaks(weighed, PEAKS);
        let facts = family.effect.as_ref().and_then(|e| e.description().searched.wave);
        if let Some(facts) = facts {
            // Usual periods have half of the prior, and look like others on a grid. Some are finer than the
            // spectrum.
            let usual: Vec<f64> = facts.usual_mm.iter().map(|p| 1.0 / p).collect();
            at.extend(along.strongest_near(weighed, &usual, 3e-4).into_iter().take(USUAL_TRIED));
        }
        let mut best = (f64::NEG_INFINITY, 0.0);
        for f in at {
            let Some(cause) = self.wave(family, f, 1) else { continue };
            let weight = wave_weight(family, f, *unit, along.range(), along.span());
            let key = (number, f.to_bits());
            let known = self.cache.waves.borrow().get(&key).cloned();
            let known = known.unwrap_or_else(|| {
                let columns = self.columns(&cause);
                let shares = columns.iter().map(|c| self.base.factor.shares(c)).collect();
                let new = Rc::new([columns, shares]);
                let mut waves = self.cache.waves.borrow_mut();
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
            seeds.push(ScreenedHypothesis { family: number, cause, weight, score });
        }
        seeds.extend(self.growing_wave_seeds(number, set, weighed, prior));
        // A wave without a name need not be a sine. What was seen less than twice does not repeat.
        if family.effect.is_none()
            && best.1 * along.span() >= 2.0
            && let Some(cause) = self.wave(family, best.1, HARMONICS)
        {
            let weight = wave_weight(family, best.1, *unit, along.range(), along.span());
            let products = Self::products(&set.factor, &self.columns(&cause));
            let (left, freedom) = (set.factor.left(), self.base.freedom);
            let gain = gain(&products.0, &products.1, left, freedom).total;
            seeds.push(ScreenedHypothesis { family: number, cause, weight, score: prior + weight + gain });
            let weight = weight - f64::from(SAW_PHASES).ln();
            let saw = saw_tooth(family, best.1, saw_phase(products, left, freedom), self.problem.rows.n);
            seeds.extend(saw.map(|cause| {
                let gain = self.gain(&set.factor, &self.columns(&cause)).total;
                ScreenedHypothesis { family: number, cause, weight, score: prior + weight + gain }
            }));
        }
        seeds
    }

    /// The best temperature difference of each time constant.
    pub(super) fn sensor_seeds(
        &self,
        number: usize,
        sensors: &[String],
        points: &[(usize, f64, Effect)],
        look: &ScreeningProducts,
        left: f64,
        prior: f64,
    ) -> Vec<ScreenedHypothesis> {
        let n = sensors.len();
        let [alone, paired] = CandidateHypotheses::sensor_weights(n);
        // The best time constant of each difference: score, weight, grid point.
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
                let cause = HypothesisContribution::Effect { effect, free: 1, reference: false };
                ScreenedHypothesis { family: number, cause, weight, score: prior + total + score - first }
            })
            .collect()
    }

    /// A wave at a frequency.
    /// A wave without a name has harmonics, each of size one over its number.
    pub(super) fn wave(
        &self,
        family: &HypothesesOfOneName,
        frequency: f64,
        harmonics: usize,
    ) -> Option<HypothesisContribution> {
        let HypothesisSearchSpace::Wave { along, unit, .. } = &family.scan else { return None };
        if let Some(effect) = &family.effect {
            let effect = effect.with(&[(0, 1.0 / (frequency * unit))])?;
            return Some(HypothesisContribution::Effect { effect, free: 2, reference: false });
        }
        let of = |k: usize| {
            let k = k as f64;
            along.wave(k * frequency, self.problem.rows.n, CONTRIBUTION / k)
        };
        let fine = |k: &usize| *k == 1 || *k as f64 * frequency <= along.range()[1];
        let columns = (1..=harmonics).filter(fine).flat_map(of).collect();
        Some(HypothesisContribution::Shape(Arc::new((family.shape.clone()?, columns))))
    }

    /// Seeds of a wave with its companion.
    /// They are at the peaks of the spectrum of what grows along the travel.
    /// At its own frequency a wave that grows from the middle to both ends shows no power.
    fn growing_wave_seeds(
        &self,
        number: usize,
        set: &HypothesisSet,
        weighed: &[f64],
        prior: f64,
    ) -> Vec<ScreenedHypothesis> {
        let family = self.family(number);
        let HypothesisSearchSpace::Wave { along, unit, .. } = &family.scan else { return Vec::new() };
        let Some((companion, beside)) = family.effect.as_ref().and_then(|e| self.companion_of(e)) else {
            return Vec::new();
        };
        let grows = along.at(weighed.len(), |place| (place - along.middle()) / along.span());
        let growing: Vec<f64> = weighed.iter().zip(&grows).map(|(r, x)| r * x).collect();
        let of = |f: f64| {
            let cause = self.wave(family, f, 1)?;
            let weight = wave_weight(family, f, *unit, along.range(), along.span());
            let mut columns = self.columns(&cause);
            let effect = beside.with(&[(0, cause.effect()?.scalar(0))])?;
            columns.extend(self.columns(&HypothesisContribution::Effect {
                effect,
                free: 2,
                reference: false,
            }));
            let prior = prior + self.prior(set, companion);
            let score = prior + weight + self.gain(&set.factor, &columns).total;
            Some(ScreenedHypothesis { family: number, cause, weight, score })
        };
        along.peaks(&growing, PEAKS).into_iter().filter_map(of).collect()
    }

    /// The effect that only accompanies waves of this law and axis.
    /// Its hypotheses' index comes first.
    fn companion_of(&self, wave: &Effect) -> Option<(usize, &Effect)> {
        let all = self.families.list.iter().enumerate();
        all.filter_map(|(number, f)| Some((number, &f.scan, f.effect.as_ref()?))).find_map(
            |(number, scan, e)| {
                let HypothesisSearchSpace::Beside { law, .. } = scan else { return None };
                (*law == wave.description().name && e.axes() == wave.axes()).then_some((number, e))
            },
        )
    }

    /// The wave of another frequency that looks the same at these positions.
    /// Of several, the one with the highest prior.
    #[must_use]
    pub fn alike(&self, member: &HypothesisSetMember) -> Vec<ScreenedHypothesis> {
        let family = self.family(member.family);
        let (HypothesisSearchSpace::Wave { along, unit, .. }, Some(effect)) =
            (&family.scan, member.cause.effect())
        else {
            return Vec::new();
        };
        let of = |f: f64| {
            let weight = wave_weight(family, f, *unit, along.range(), along.span());
            Some(ScreenedHypothesis {
                family: member.family,
                cause: self.wave(family, f, 1)?,
                weight,
                score: weight,
            })
        };
        let mut all: Vec<ScreenedHypothesis> =
            along.alias_frequencies(1.0 / (effect.scalar(0) * unit)).into_iter().filter_map(of).collect();
        all.sort_by(|a, b| b.score.total_cmp(&a.score));
        all.truncate(TRIED);
        all
    }

    /// Maps that are equivalent to the last member at these rows.
    /// On a circle z² = r² − x². Chance decides which of two maps the data prefer, in directions that neither
    /// needs. A plain bow is equivalent to a law: guideways that are warmer above than below bend along a
    /// parabola.
    #[must_use]
    pub fn maps_alike(&self, set: &HypothesisSet) -> Vec<ScreenedHypothesis> {
        let Some(own) = set.members.last().filter(|m| m.cause.effect().is_some()) else {
            return Vec::new();
        };
        let without = self.first(set, set.members.len() - 1);
        let beta = set.factor.solve();
        let mut found = vec![0.0; self.problem.rows.n];
        for (c, b) in own.columns.iter().zip(&beta[without.len()..]) {
            add(&mut found, b * own.level, c);
        }
        let found = without.projected_out(&found);
        let power = dot(&found, &found);
        let shows = |columns: Columns| {
            let mut other = QrFactor::new(&found);
            for c in columns {
                other.push(&without.projected_out(&c).iter().map(|x| x * WIDE).collect::<Vec<_>>());
            }
            1.0 - dot(other.residual(), other.residual()) / power
        };
        let is_map = matches!(own.cause, HypothesisContribution::Map { .. });
        let of = |(family, f): (usize, &HypothesesOfOneName)| {
            let HypothesisSearchSpace::Grid(points) = &f.scan else { return None };
            let other = family != own.family && f.replaces.is_none();
            let mut maps =
                points.iter().filter(|p| other && matches!(p.2, HypothesisContribution::Map { .. }));
            let (_, weight, cause) =
                maps.find(|p| shows(if is_map { self.columns(&p.2) } else { self.bow(&p.2) }) > ALIKE)?;
            Some(ScreenedHypothesis { family, cause: cause.clone(), weight: *weight, score: f.prior })
        };
        self.families.list.iter().enumerate().filter_map(of).collect()
    }

    /// The bow of a map: a parabola over its knots, without constant and straight line.
    fn bow(&self, map: &HypothesisContribution) -> Columns {
        let HypothesisContribution::Map { effect, .. } = map else { return Columns::new() };
        let knots = effect.get(0);
        let share = |k: &f64| (k - knots[0]) / (knots[knots.len() - 1] - knots[0]);
        let powers = (0..3).map(|p| knots.iter().map(|k| share(k).powi(p)).collect()).collect();
        let mut columns = self
            .columns(&HypothesisContribution::Map { effect: effect.clone(), directions: Arc::new(powers) });
        let mut bow = QrFactor::new(&columns.pop().unwrap_or_default());
        for line in columns {
            bow.push_free(&line);
        }
        vec![bow.residual().to_vec()]
    }

    /// Refines a seed's non-linear parameters to the best explanation.
    #[must_use]
    pub fn refined(&self, factor: &QrFactor, seed: &ScreenedHypothesis) -> ScreenedHypothesis {
        let Some(effect) = seed.cause.effect().cloned() else { return seed.clone() };
        let moves = parameter_steps(self.family(seed.family), &effect);
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
        // A period that refinement moved out of the usual range is not a usual period.
        let at = |e: Option<&Effect>| self.weight_at(seed.family, e);
        let less = narrower + at(Some(&now)) - at(seed.cause.effect());
        ScreenedHypothesis {
            family: seed.family,
            cause: seed.cause.with_effect(now),
            weight: seed.weight + less,
            score: seed.score + (best - before).max(0.0) + less,
        }
    }

    /// Log prior weight of a wave's period; zero for other causes.
    pub(super) fn weight_at(&self, family: usize, effect: Option<&Effect>) -> f64 {
        let family = self.family(family);
        let (HypothesisSearchSpace::Wave { along, unit, .. }, Some(effect)) = (&family.scan, effect) else {
            return 0.0;
        };
        wave_weight(family, 1.0 / (effect.scalar(0) * unit), *unit, along.range(), along.span())
    }

    /// Richer forms of a seed.
    /// They are growth with a square of ΔT, another reference temperature, and a wave that changes.
    pub(super) fn richer(seed: &ScreenedHypothesis) -> Vec<ScreenedHypothesis> {
        let mut out = Vec::new();
        let HypothesisContribution::Effect { effect, free, .. } = &seed.cause else { return out };
        let law = effect.description();
        if law.companion.is_some() && effect.delta.is_some() {
            if effect.coefficient_count() > *free {
                let cause = HypothesisContribution::Effect {
                    effect: effect.clone(),
                    free: free + 1,
                    reference: false,
                };
                out.push(ScreenedHypothesis { cause, weight: seed.weight + BENT_SHARE.ln(), ..seed.clone() });
            }
            let pair = effect.delta.as_ref().is_some_and(TemperatureDifference::is_pair);
            let constant = effect.companion().is_some_and(|c| c.description().constant);
            if !pair && !constant {
                let cause =
                    HypothesisContribution::Effect { effect: effect.clone(), free: *free, reference: true };
                out.push(ScreenedHypothesis { cause, weight: seed.weight + BENT_SHARE.ln(), ..seed.clone() });
            }
        }
        out
    }

    /// A wave whose size changes along its travel, from a seed that is a wave.
    /// It has no name. What comes and goes has its strongest peaks beside its own frequency, so those near the
    /// seed's are tried too.
    pub(crate) fn changing(
        &self,
        factor: &QrFactor,
        seed: &ScreenedHypothesis,
    ) -> Option<ScreenedHypothesis> {
        let family = self.family(seed.family);
        let HypothesisSearchSpace::Wave { along, unit, .. } = &family.scan else { return None };
        let rows = self.problem.rows;
        let shape = match &seed.cause {
            HypothesisContribution::Shape(both) if both.1.len() == 2 => both.0.clone(),
            cause => UnnamedShape::like(rows, cause.effect()?, "")?,
        };
        let of = |f: &HypothesesOfOneName| f.shape.as_ref().is_some_and(|s| s.response == shape.response);
        let number = self.families.list.iter().position(of)?;
        let shape = UnnamedShape { manner: "periodic, of changing size".to_owned(), ..shape };
        let envelopes = self.envelopes(seed.family, along);
        if envelopes.is_empty() {
            return None;
        }
        let orthonormal = factor.matrix();
        let own = |basis: &[Vec<f64>]| {
            let columns = changing_wave(basis, &envelopes);
            let white = self.whitened(columns.clone());
            let along: Vec<f64> = white.iter().map(|c| dot(c, factor.residual())).collect();
            let among = products_beside(&orthonormal, &white);
            (gain(&along, &among, factor.left(), self.base.freedom).total, columns)
        };
        let beside = |k: i32| {
            let frequency = 1.0 / (seed.cause.effect()?.scalar(0) * unit) + f64::from(k) / along.span();
            (along.range()[0]..along.range()[1]).contains(&frequency).then_some(())?;
            Some(own(&self.wave(family, frequency, 1)?.columns(rows)))
        };
        let half = CHANGING as i32 / 2;
        let near = (-half..=half).filter(|k| *k != 0).filter_map(beside);
        let columns = near.chain([own(&seed.cause.columns(rows))]).max_by(|a, b| a.0.total_cmp(&b.0))?.1;
        let cause = HypothesisContribution::Shape(Arc::new((shape, columns)));
        Some(ScreenedHypothesis { family: number, cause, weight: seed.weight, score: seed.score })
    }

    /// Sizes of a changing wave of a family.
    fn envelopes(&self, family: usize, along: &Periodogram) -> Rc<Columns> {
        let mut known = self.cache.envelopes.borrow_mut();
        let new = || Rc::new(envelopes(along, self.problem.rows.n));
        Rc::clone(known.entry(family).or_insert_with(new))
    }

    /// One wave of changing size instead of a wave and another one.
    /// The other one may be a shape along the same axis.
    /// Waves close to each other beat, and look like one that comes and goes.
    pub(super) fn one_wave_for_two(&self, set: &HypothesisSet) -> HypothesisSet {
        let mut best = set.clone();
        for (j, wave) in set.members.iter().enumerate() {
            let is_wave = matches!(self.family(wave.family).scan, HypothesisSearchSpace::Wave { .. });
            let Some(like) = wave.cause.effect().filter(|_| is_wave) else { continue };
            let Some(like) = UnnamedShape::like(self.problem.rows, like, "") else { continue };
            let same = |m: &HypothesisSetMember| match &m.cause {
                HypothesisContribution::Shape(own) => {
                    own.0.response == like.response && own.0.against == like.against
                }
                _ => m.family == wave.family,
            };
            for i in (0..set.members.len()).filter(|i| *i != j && same(&set.members[*i])) {
                let mut others = self.without(&self.without(set, i.max(j)), i.min(j));
                let alone = |s: &HypothesisSet| s.members.iter().position(|m| !self.is_accompanied(s, m));
                while let Some(companion) = alone(&others) {
                    others = self.without(&others, companion);
                }
                let one = self.changing(&others.factor, &wave.seed()).and_then(|s| self.with(&others, &s));
                best =
                    one.into_iter().fold(best, |best, one| if one.score > best.score { one } else { best });
            }
        }
        best
    }
}

/// The phase at which a saw-tooth explains most, by its harmonics.
/// `along` and `among` are the products of sines and cosines of size one over their number.
fn saw_phase((along, among): (Vec<f64>, Vec<f64>), left: f64, freedom: f64) -> f64 {
    let p = along.len();
    let gain_at = |phase: &f64| {
        // x − ½ = −Σ sin(2πkx) / (πk) for x in 0 … 1.
        let of = |k: usize| (-std::f64::consts::TAU * k as f64 * phase).sin_cos();
        let shares: Vec<f64> = (1..=p / 2).map(of).flat_map(|(sin, cos)| [cos, sin]).collect();
        let square: f64 = (0..p).map(|i| shares[i] * dot(&among[i * p..(i + 1) * p], &shares)).sum();
        let size = 2.0 / std::f64::consts::PI;
        gain_of_one(size * size * square, size * dot(&along, &shares), left, freedom).total
    };
    let phases = (0..SAW_PHASES).map(|k| f64::from(k) / f64::from(SAW_PHASES));
    phases.max_by(|a, b| gain_at(a).total_cmp(&gain_at(b))).unwrap_or(0.0)
}

/// A saw-tooth of this frequency that falls back at a phase, in turns.
/// Chillers, pumps and thermostats that switch leave one over time.
fn saw_tooth(
    family: &HypothesesOfOneName,
    frequency: f64,
    phase: f64,
    n: usize,
) -> Option<HypothesisContribution> {
    let HypothesisSearchSpace::Wave { along, .. } = &family.scan else { return None };
    let shape = UnnamedShape { manner: "saw-tooth".to_owned(), ..family.shape.clone()? };
    let column = along.over(n, |at| 2.0 * CONTRIBUTION * ((frequency * at - phase).rem_euclid(1.0) - 0.5));
    Some(HypothesisContribution::Shape(Arc::new((shape, vec![column]))))
}

/// Whether a growth changes sign within the measured temperatures.
/// No part of a machine does that.
pub(super) fn turns_back(rows: &MeasuredRows<'_>, effect: &Effect) -> bool {
    let [per_k, per_k2] = effect.coefficients()[..] else { return false };
    if effect.description().heat != ThermalDependence::Growth || per_k2 == 0.0 {
        return false;
    }
    let warm = rows.basis(effect).swap_remove(0);
    let (lo, hi) = warm.iter().fold((0.0_f64, 0.0_f64), |(l, h), x| (l.min(*x), h.max(*x)));
    (per_k + 2.0 * per_k2 * lo) * (per_k + 2.0 * per_k2 * hi) < 0.0
}

/// Log prior weight of a wave of this frequency.
/// Uniform in the logarithm of the period; usual periods weigh more.
pub(super) fn wave_weight(
    family: &HypothesesOfOneName,
    frequency: f64,
    unit: f64,
    [from, to]: [f64; 2],
    span: f64,
) -> f64 {
    // Typical width of a mode, as a share of the frequency.
    let cell = (0.35 / span / frequency).min(1.0);
    let even = cell / (to / from).ln().max(cell);
    let Some(facts) = family.effect.as_ref().and_then(|e| e.description().searched.wave) else {
        return even.ln();
    };
    let period_mm = 1.0 / (frequency * unit) * facts.unit_mm;
    let usual: Vec<f64> = facts.usual_mm.iter().flat_map(|p| [*p, 0.5 * p]).collect();
    let near = usual.iter().any(|u| (period_mm / u - 1.0).abs() < USUAL_WITHIN);
    // The mode takes its part of the band around a usual period.
    let part = (0.5 * cell / USUAL_WITHIN).min(1.0);
    let usual = if near { USUAL_SHARE / usual.len() as f64 * part } else { 0.0 };
    ((1.0 - USUAL_SHARE) * even + usual).ln()
}

/// A step of a non-linear parameter.
pub(super) struct ParameterStep {
    parameter: usize,
    /// First step.
    step: f64,
    how: ParameterRefinement,
    /// Range that the rows can show.
    range: [f64; 2],
}

pub(super) fn parameter_steps(family: &HypothesesOfOneName, effect: &Effect) -> Vec<ParameterStep> {
    if family.replaces.is_some() {
        return Vec::new();
    }
    if let HypothesisSearchSpace::Wave { along, unit, .. } = &family.scan {
        let step = 0.2 / along.span() * unit;
        return vec![ParameterStep {
            parameter: 0,
            step,
            how: ParameterRefinement::Stays,
            range: everything(),
        }];
    }
    let of = |(parameter, p): (usize, &rtec_model::effect::LawParameter)| {
        let (ParameterRefinement::Step(step)
        | ParameterRefinement::Factor(step)
        | ParameterRefinement::TimeConstant(step)) = p.refine
        else {
            return None;
        };
        let range = family.range(parameter);
        (p.search == ParameterFitMethod::Smooth).then_some(ParameterStep {
            parameter,
            step,
            how: p.refine,
            range,
        })
    };
    effect.description().parameters.iter().enumerate().filter_map(of).collect()
}

/// The unbounded range.
pub(super) fn everything() -> [f64; 2] {
    [f64::NEG_INFINITY, f64::INFINITY]
}

impl ParameterStep {
    fn moved(&self, effect: &Effect, by: f64) -> Option<Effect> {
        let v = effect.scalar(self.parameter);
        let to = match self.how {
            ParameterRefinement::Step(_) => v + by,
            // A period moves by its frequency.
            ParameterRefinement::Stays => 1.0 / (1.0 / v + by),
            _ => v * by.exp(),
        };
        let to = to.clamp(self.range[0], self.range[1]);
        effect.with(&[(self.parameter, to)])
    }
}

impl HypothesesOfOneName {
    /// Range of one parameter that the rows can show.
    fn range(&self, parameter: usize) -> [f64; 2] {
        let wider = |[lo, hi]: [f64; 2], effect: &Effect| {
            let v = effect.scalar(parameter);
            [lo.min(v), hi.max(v)]
        };
        let none = [f64::INFINITY, f64::NEG_INFINITY];
        let [lo, hi] = match &self.scan {
            HypothesisSearchSpace::Grid(points) => {
                points.iter().filter_map(|p| p.2.effect()).fold(none, wider)
            }
            HypothesisSearchSpace::Sensors { points, .. } => points.iter().map(|p| &p.2).fold(none, wider),
            _ => none,
        };
        if lo < hi { [lo, hi] } else { everything() }
    }
}
