//! The last fit: values and intervals of the set that was found.

use super::{CorrectedKnownEffect, EstimatedHypothesis, SetUpEstimate};
use crate::candidate_hypotheses::HypothesisSearchSpace;
use crate::hypothesis_contribution::HypothesisContribution;
use crate::measurement_model::{chance_of, is_beyond_chance};
use crate::priors::HELD;
use crate::search::{HypothesisSearch, HypothesisSet, same_period};
use crate::search_limits::LAST_STEPS;
use crate::set_up_terms;
use rtec_least_squares::dot;
use rtec_model::effect::{Effect, ParameterFitMethod, ParameterRefinement};
use rtec_model::machine::NORMAL_95;

/// The last fit: all linear and non-linear parameters together.
pub(super) struct FinalFit<'s, 'p> {
    pub(super) search: &'s HypothesisSearch<'p>,
    pub(super) model: &'s [Effect],
    pub(super) members: Vec<FinalFitMember>,
    pub(super) left: f64,
    pub(super) inverse: Vec<Vec<f64>>,
    pub(super) beta: Vec<f64>,
}

/// A member of the last fit.
pub(super) struct FinalFitMember {
    pub(super) cause: HypothesisContribution,
    /// Size of its prior, in typical sizes.
    pub(super) level: f64,
    /// Index of its first column; the linear ones come first, then the non-linear ones.
    pub(super) at: usize,
    pub(super) width: usize,
    pub(super) bent: Vec<NonLinearParameter>,
    /// Coefficients that were left out.
    /// For each: number, index among the columns, and its standard deviation in its own unit.
    pub(super) left_out: Vec<(usize, usize, f64)>,
}

impl FinalFitMember {
    /// Coefficients in standard deviations of the cause's columns.
    pub(super) fn linear(&self, beta: &[f64]) -> Vec<f64> {
        beta[self.at..self.at + self.width].iter().map(|b| b * self.level).collect()
    }
}

/// A non-linear value in the last fit.
pub(super) struct NonLinearParameter {
    /// Index of the value.
    pub(super) value: usize,
    /// One standard deviation of it, in its unit.
    pub(super) sd: f64,
    /// Index of another value that moves with it, and its change per unit.
    /// A wave's phase moves with its period, so that the wave stays at the measured positions.
    pub(super) with: Option<(usize, f64)>,
}

/// Non-linear values that the last fit moves, with their standard deviations.
pub(super) fn bent(
    search: &HypothesisSearch<'_>,
    set: &HypothesisSet,
    family: usize,
    effect: &Effect,
) -> Vec<NonLinearParameter> {
    let families = &search.families.list;
    let family = &families[family];
    if family.replaces.is_some() || effect.width() > 1 {
        return Vec::new();
    }
    let law = effect.description();
    let mut scan = &family.scan;
    if let HypothesisSearchSpace::Beside { law, .. } = scan {
        let accompanied = |e: &Effect| e.description().name == *law && e.axes() == effect.axes();
        let mut waves = set.members.iter().filter_map(|m| m.cause.effect()).filter(|e| accompanied(e));
        // A wave of the set decides the period of both.
        if waves.any(|e| same_period(e, effect)) {
            return Vec::new();
        }
        let wave = families.iter().find(|f| f.effect.as_ref().is_some_and(accompanied));
        scan = wave.map_or(scan, |f| &f.scan);
    }
    let of = |(value, p): (usize, &rtec_model::effect::LawParameter)| {
        if p.search != ParameterFitMethod::Smooth {
            return None;
        }
        let v = effect.scalar(value);
        let (sd, with) = match (scan, p.refine) {
            (_, ParameterRefinement::Step(_)) => (1.0, None),
            (HypothesisSearchSpace::Wave { along, unit, .. }, _) => {
                let turns = std::f64::consts::TAU * along.middle() / unit / (v * v);
                (0.1 * v, law.place(ParameterFitMethod::Phase).map(|phase| (phase, turns)))
            }
            _ => (v.abs(), None),
        };
        Some(NonLinearParameter { value, sd, with })
    };
    law.parameters.iter().enumerate().filter_map(of).collect()
}

impl<'s, 'p> FinalFit<'s, 'p> {
    pub(super) fn new(search: &'s HypothesisSearch<'p>, set: &HypothesisSet, model: &'s [Effect]) -> Self {
        let mut causes: Vec<HypothesisContribution> = set.members.iter().map(|m| m.cause.clone()).collect();
        let mut best: Option<Self> = None;
        let beta = search.coefficients(set);
        let mut solved: Vec<Option<Effect>> =
            causes.iter().zip(&beta).map(|(c, b)| c.solved(search.problem.rows, b)).collect();
        for _ in 0..LAST_STEPS {
            let last = Self::fit(search, set, model, &causes, &solved);
            if best.as_ref().is_some_and(|b| last.left > b.left + 0.01) {
                break;
            }
            let mut next = causes.clone();
            let mut moved = false;
            solved.clear();
            for (k, m) in last.members.iter().enumerate() {
                let mut now = m.cause.solved(search.problem.rows, &m.linear(&last.beta));
                if let Some(effect) = m.cause.effect() {
                    let mut set: Vec<(usize, f64)> = Vec::new();
                    for (b, bent) in m.bent.iter().enumerate() {
                        let v = effect.scalar(bent.value);
                        let most = 0.2 * v.abs().max(0.3);
                        let by = (last.beta[m.at + m.width + b] * bent.sd).clamp(-most, most);
                        set.push((bent.value, v + by));
                        if let Some((w, per)) = bent.with {
                            now = now.and_then(|e| e.with(&[(w, e.scalar(w) + per * by)]));
                        }
                    }
                    if let Some(effect) = effect.with(&set).filter(|_| !set.is_empty()) {
                        next[k] = m.cause.with_effect(effect);
                        now = now.and_then(|e| e.with(&set));
                        moved = true;
                    }
                }
                solved.push(now);
            }
            best = Some(last);
            causes = next;
            if !moved {
                break;
            }
        }
        best.unwrap_or_else(|| Self::fit(search, set, model, &causes, &solved))
    }

    pub(super) fn fit(
        search: &'s HypothesisSearch<'p>,
        set: &HypothesisSet,
        model: &'s [Effect],
        causes: &[HypothesisContribution],
        solved: &[Option<Effect>],
    ) -> Self {
        let rows = search.problem.rows;
        let mut factor = search.base.factor.clone();
        let mut members = Vec::new();
        for ((cause, m), solved) in causes.iter().zip(&set.members).zip(solved) {
            let at = factor.len();
            let columns = search.columns(cause);
            let width = columns.len();
            for mut c in columns {
                for x in &mut c {
                    *x *= m.level;
                }
                factor.push(&c);
            }
            let mut own = Vec::new();
            if let Some(effect) = solved {
                own = bent(search, set, m.family, effect);
                let slopes = if own.is_empty() { Vec::new() } else { rows.slopes(effect) };
                for b in &own {
                    let mut c: Vec<f64> = slopes[b.value].iter().map(|x| x * b.sd).collect();
                    if let Some((with, per)) = b.with {
                        rtec_least_squares::add(&mut c, per * b.sd, &slopes[with]);
                    }
                    search.base.noise.whiten(rows, &mut c);
                    factor.push(&c);
                }
            }
            let cause = cause.clone();
            members.push(FinalFitMember {
                cause,
                level: m.level,
                at,
                width,
                bent: own,
                left_out: Vec::new(),
            });
        }
        let mut beta = factor.solve();
        let left = factor.left();
        // Values are less certain if further effects may exist, and if all rows of one reading share an
        // error.
        for m in &mut members {
            for (k, size, mut c) in m.cause.left_out(rows) {
                let sd = size * m.level;
                for x in &mut c {
                    *x *= sd;
                }
                search.base.noise.whiten(rows, &mut c);
                m.left_out.push((k, factor.len(), sd));
                factor.push(&c);
            }
        }
        beta.resize(factor.len(), 0.0);
        for t in &search.rounding {
            let mut c: Vec<f64> = t.column.iter().map(|x| x * t.sd).collect();
            search.base.noise.whiten(rows, &mut c);
            factor.push(&c);
        }
        let inverse = factor.inverse();
        Self { search, model, members, left, inverse, beta }
    }

    pub(super) fn covariance(&self, i: usize, j: usize) -> f64 {
        dot(&self.inverse[i], &self.inverse[j])
    }

    /// Squared distance of these coefficients from zero, in standard deviations.
    pub(super) fn distance(&self, coefficients: &[usize]) -> f64 {
        let mut axes: Vec<(Vec<f64>, f64)> = Vec::new();
        for i in coefficients {
            let (mut left, mut beta) = (self.inverse[*i].clone(), self.beta[*i]);
            for (axis, along) in &axes {
                let share = dot(axis, &left);
                rtec_least_squares::add(&mut left, -share, axis);
                beta -= share * along;
            }
            let sd = dot(&left, &left).sqrt();
            if sd > 0.0 {
                axes.push((left.iter().map(|x| x / sd).collect(), beta / sd));
            }
        }
        axes.iter().map(|(_, along)| along * along).sum()
    }

    /// Values and half widths of the members.
    pub(super) fn fill(&self, found: &mut [EstimatedHypothesis]) {
        let rows = self.search.problem.rows;
        for (f, m) in found.iter_mut().zip(&self.members) {
            if f.effect.is_none() {
                continue;
            }
            let linear = m.linear(&self.beta);
            let Some(mut effect) = m.cause.solved(rows, &linear) else { continue };
            let n = effect.values().len();
            // Derivative of each value by one standard deviation of each column.
            let mut jacobian: Vec<(usize, Vec<f64>)> = Vec::new();
            for k in 0..m.width {
                let mut row = vec![0.0; n];
                let sd = self.covariance(m.at + k, m.at + k).sqrt() * m.level;
                let step = 1e-3 * sd;
                let at = |by: f64| {
                    let mut b = linear.clone();
                    b[k] += by;
                    m.cause.solved(rows, &b)
                };
                if let (Some(up), Some(down)) = (at(step), at(-step)) {
                    for (d, (u, l)) in row.iter_mut().zip(up.values().iter().zip(down.values())) {
                        // A phase may have jumped by a whole turn.
                        let by = u - l;
                        let by = if by.abs() > 3.0 && sd > 0.0 && by.abs() > 1e3 * step { 0.0 } else { by };
                        *d = by / (2.0 * step) * m.level;
                    }
                }
                jacobian.push((m.at + k, row));
            }
            for (b, bent) in m.bent.iter().enumerate() {
                let mut row = vec![0.0; n];
                row[bent.value] = bent.sd;
                if let Some((with, per)) = bent.with {
                    row[with] = per * bent.sd;
                }
                jacobian.push((m.at + m.width + b, row));
            }
            for (k, at, sd) in &m.left_out {
                let mut coefficients = effect.coefficients();
                coefficients[*k] += sd;
                let mut other = effect.clone();
                other.set_coefficients(&coefficients);
                let row = other.values().iter().zip(effect.values()).map(|(a, b)| a - b).collect();
                jacobian.push((*at, row));
            }
            let mut half = vec![0.0; n];
            for (v, h) in half.iter_mut().enumerate() {
                let mut variance = 0.0;
                for (i, a) in &jacobian {
                    for (j, b) in &jacobian {
                        variance += a[v] * b[v] * self.covariance(*i, *j);
                    }
                }
                *h = NORMAL_95 * variance.max(0.0).sqrt();
            }
            if let Some(p) = effect.description().place(ParameterFitMethod::Phase) {
                // An interval of an angle is at most half a turn to either side.
                half[p] = half[p].min(std::f64::consts::PI);
            }
            if let (Some([from, to]), Some(p)) = (
                f.moments,
                effect.description().parameters.iter().position(|p| p.refine == ParameterRefinement::Moment),
            ) {
                half[p] = 0.5 * (to - from);
                effect = effect.with(&[(p, f64::midpoint(from, to))]).unwrap_or(effect);
            }
            // Two coefficients that the rows do not tell apart may each be zero, but not both.
            let own: Vec<usize> =
                (m.at..m.at + m.width).chain(m.left_out.iter().map(|(_, at, _)| *at)).collect();
            f.has_size = chance_of(self.distance(&own), own.len()) < 1.0 - HELD;
            let held = (0..n).filter(|v| half[*v] <= 0.0).collect();
            (f.effect, f.half, f.held) = (Some(effect), half, held);
        }
    }

    /// Gives a wave that accompanies another the other's period and its interval.
    pub(super) fn tie_periods(found: &mut [EstimatedHypothesis]) {
        for i in 0..found.len() {
            let Some(effect) = found[i].effect.clone() else { continue };
            let wave = effect.description().place(ParameterFitMethod::Amplitude).is_some();
            let Some(law) = effect.description().searched.beside.filter(|_| wave) else { continue };
            let near = |f: &&EstimatedHypothesis| {
                f.effect.as_ref().is_some_and(|e| {
                    e.description().name == law && e.axes() == effect.axes() && same_period(e, &effect)
                })
            };
            let Some(other) = found.iter().find(near).cloned() else { continue };
            let period = other.effect.as_ref().map_or(effect.scalar(0), |e| e.scalar(0));
            found[i].effect = effect.with(&[(0, period)]).or(Some(effect));
            found[i].half[0] = other.half[0];
        }
    }

    /// The model's effects as estimated from the rows.
    pub(super) fn known(&self, found: &[EstimatedHypothesis]) -> Vec<CorrectedKnownEffect> {
        let problem = self.search.problem;
        let from = problem.terms.len();
        (0..self.model.len())
            .filter_map(|place| {
                let effect = &self.model[place];
                let mut values = effect.values().to_vec();
                let mut half = vec![0.0_f64; values.len()];
                let own: Vec<usize> =
                    (0..problem.known.len()).filter(|i| problem.known[*i].effect == place).collect();
                let at: Vec<usize> = own.iter().map(|i| from + i).collect();
                let mut beyond = is_beyond_chance(self.distance(&at), own.len());
                for (i, k) in own.iter().map(|i| (*i, &problem.known[*i])) {
                    let sd = self.covariance(from + i, from + i).sqrt();
                    for (v, by) in &k.along {
                        values[*v] += by * self.beta[from + i];
                        half[*v] = half[*v].hypot(NORMAL_95 * by * sd);
                    }
                }
                let replaced = found.iter().position(|f| f.replaces == Some(place));
                if let Some(m) = replaced.map(|r| &self.members[r]) {
                    beyond = true;
                    let mut e = effect.with_values(&values)?;
                    let mut coefficients = e.coefficients();
                    let sizes = m.cause.coefficient_sizes(problem.rows);
                    for (k, c) in coefficients.iter_mut().enumerate().take(m.width) {
                        *c += self.beta[m.at + k] * m.level * sizes[k];
                    }
                    e.set_coefficients(&coefficients);
                    values = e.values().to_vec();
                    let sd = self.covariance(m.at, m.at).sqrt() * m.level * sizes[0];
                    for (v, h) in half.iter_mut().enumerate() {
                        if v / effect.width() == 0 || *h > 0.0 {
                            *h = h.max(NORMAL_95 * sd);
                        }
                    }
                }
                let after = effect.with_values(&values)?;
                Some(CorrectedKnownEffect { place, after, half, beyond_chance: beyond })
            })
            .collect()
    }

    /// Jumps at pauses, which are searched like hypotheses.
    pub(super) fn jumps(
        &self,
        search: &HypothesisSearch<'_>,
        found: &[EstimatedHypothesis],
    ) -> Vec<SetUpEstimate> {
        let terms = set_up_terms::jumps(search.problem.rows);
        let of = |(m, f): (&FinalFitMember, &EstimatedHypothesis)| {
            let shape = f.shape.as_ref()?;
            let HypothesisContribution::Shape(both) = &m.cause else { return None };
            let term = terms
                .iter()
                .find(|t| t.column.iter().zip(&both.1[0]).all(|(a, b)| (*a == 0.0) == (*b == 0.0)))?;
            let size = crate::priors::JUMP_UM_PROBABILITY.0 * m.level;
            Some(SetUpEstimate {
                record: term.record,
                response: shape.response.clone(),
                what: set_up_terms::SetUpTermKind::Jump,
                value: self.beta[m.at] * size,
                half: NORMAL_95 * self.covariance(m.at, m.at).sqrt() * size,
            })
        };
        self.members
            .iter()
            .zip(found)
            .filter(|(_, f)| f.shape.as_ref().is_some_and(|s| s.manner == "a jump at a pause"))
            .filter_map(of)
            .collect()
    }

    pub(super) fn set_up(&self) -> Vec<SetUpEstimate> {
        let problem = self.search.problem;
        let named = |w: set_up_terms::SetUpTermKind| {
            use set_up_terms::SetUpTermKind::{CentreFirst, CentreSecond, Jump, Line, Zero};
            matches!(w, Zero | CentreFirst | CentreSecond | Line | Jump)
        };
        let of = |(i, t): (usize, &set_up_terms::SetUpTerm)| {
            let row = t.column.iter().position(|x| *x != 0.0)?;
            let segment = problem.rows.segments.iter().find(|s| s.rows.contains(&row))?;
            Some(SetUpEstimate {
                record: t.record,
                response: problem.rows.responses[segment.response].to_string(),
                what: t.what,
                value: self.beta[i] * t.sd,
                half: NORMAL_95 * self.covariance(i, i).sqrt() * t.sd,
            })
        };
        problem.terms.iter().enumerate().filter(|(_, t)| named(t.what)).filter_map(of).collect()
    }
}
