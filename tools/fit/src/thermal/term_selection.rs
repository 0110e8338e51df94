//! Selects terms: CASC over the sensors, the refit by rounds, then exchanges.

use super::cross_validation::{CrossValidatedTerms, FoldLeastSquares};
use super::fit_candidates::TermSelectionProblem;
use super::report::{RankedSensor, RedundantSensor, RefitRound};
use super::term::{Pair, Term, pair_of, relagged, squared};
use rtec_least_squares::{QrFactor, dot};
use rtec_measure::iso230::correlation;

/// Correlation above which two sensors measure the same source of heat.
/// Source: WO 97/43703, "0.97 was selected".
pub const REDUNDANT: f64 = 0.97;

/// Largest number of rounds; more were seldom needed (WO 97/43703).
pub const ROUNDS: usize = 5;

/// Stride on the grid with which the search for a lag begins.
const COARSE: usize = 16;

/// Largest number of terms that are accepted provisionally.
const UNEARNED: usize = 2;

/// Number of candidates that pass the screening of a round.
const SCREENED: usize = 12;

/// Number of lags that the data can distinguish.
const LAG_CHOICES: usize = 4;

/// Most sensors of a model, the environment's included.
/// Source: WO 97/43703, "The final number may generally be only 4 or 5".
const SENSORS: usize = 5;

pub(super) struct TermSelection {
    pub(super) structure: CrossValidatedTerms,
    pub(super) rounds: Vec<CrossValidatedTerms>,
    /// The exchanges after the rounds.
    /// Each is the structure after it, whose last term is new, and the term that was removed.
    pub(super) swaps: Vec<(CrossValidatedTerms, Term)>,
    pub(super) kept: Vec<CrossValidatedTerms>,
    /// Sensor, α, and the index of the kept one that makes it redundant.
    pub(super) dropped: Vec<(CrossValidatedTerms, f64, usize)>,
    pub(super) tied: Vec<CrossValidatedTerms>,
    /// A structure with smaller residuals over all rows that was not chosen.
    pub(super) passed_over: Option<CrossValidatedTerms>,
}

impl TermSelection {
    /// The redundant sensors, each with the kept one that measures the same.
    pub(super) fn redundant(
        &self,
        ranked: &dyn Fn(&CrossValidatedTerms) -> RankedSensor,
        kept: &[RankedSensor],
    ) -> Vec<RedundantSensor> {
        let of = |(j, alpha, with): &(CrossValidatedTerms, f64, usize)| {
            let own = ranked(j);
            RedundantSensor {
                sensor: own.sensor,
                alpha: *alpha,
                with: kept[*with].sensor.clone(),
                gamma: own.gamma,
                gamma_lagged: own.gamma_lagged,
                range_k: own.range_k,
            }
        };
        self.dropped.iter().map(of).collect()
    }

    /// The rounds of the refit, followed by the exchanges.
    pub(super) fn history(&self, problem: &TermSelectionProblem) -> Vec<RefitRound> {
        let of = |j: &CrossValidatedTerms, added: String| RefitRound { added, r: j.r, cv_rms_um: j.rms() };
        let newest = |j: &CrossValidatedTerms| problem.name(j.terms[j.terms.len() - 1]);
        // The first round may have a difference with its square.
        let begun = |j: &CrossValidatedTerms| {
            j.terms.iter().map(|t| problem.name(*t)).collect::<Vec<_>>().join(" and ")
        };
        let name = |(k, j): (usize, &CrossValidatedTerms)| of(j, if k == 0 { begun(j) } else { newest(j) });
        let rounds = self.rounds.iter().enumerate().map(name);
        let swaps =
            self.swaps.iter().map(|(j, out)| of(j, format!("{} for {}", newest(j), problem.name(*out))));
        rounds.chain(swaps).collect()
    }

    /// A message about sensors that the data cannot distinguish from the chosen one.
    pub(super) fn rivals(&self, problem: &TermSelectionProblem) -> Option<String> {
        let names: Vec<String> = self.tied.iter().map(|j| problem.name(j.terms[0])).collect();
        let chosen = problem.name(*self.rounds.first()?.terms.first()?);
        (!names.is_empty()).then(|| {
            let names = names.join(", ");
            format!(
                "the data cannot tell {names} from {chosen}; the one that leads the growth most was taken"
            )
        })
    }
}

impl TermSelection {
    /// A message if all rows prefer another choice than cross-validation does.
    pub(super) fn by_all_rows(&self, problem: &TermSelectionProblem) -> Option<String> {
        let other = self.passed_over.as_ref()?;
        let names: Vec<String> = other.terms.iter().map(|t| problem.name(*t)).collect();
        Some(format!(
            "{} leaves less of all rows and predicts stretches of time that were left out no better: reconcile, which asks \
             all rows, may name it",
            names.join(" and ")
        ))
    }
}

impl TermSelectionProblem {
    /// The whole selection on the given folds.
    /// It returns the structure, its rounds and the rivals of its first term.
    pub(super) fn select(&self, folds: &[usize]) -> Option<TermSelection> {
        let mut singles = self.with_best_lags(&[], &self.offered, folds);
        singles.sort_by_key(|j| self.merit(j));
        let sources = self.driven_by_the_source(singles.clone(), folds);
        let best = sources.first()?.clone();
        // Of the differences that the data cannot distinguish from the best, take the one nearest to the
        // source of heat.
        let mut tied: Vec<CrossValidatedTerms> = sources.into_iter().filter(|j| !best.beats(j)).collect();
        let lag = |j: &CrossValidatedTerms| match j.terms[0] {
            Term::Thermal { lag, .. } => lag,
            _ => 0,
        };
        tied.sort_by_key(|j| std::cmp::Reverse(lag(j)));
        let first = tied.remove(0);
        let mut order = vec![first.clone()];
        order.extend(singles.iter().filter(|j| j.terms != first.terms).cloned());
        let (kept, dropped) = self.casc(order);
        let mut candidates: Vec<Pair> = kept.iter().filter_map(|j| pair_of(j.terms[0])).collect();
        candidates.extend(&self.pairs);
        let mean = self.judge(&[], folds)?;
        let begun = |first: CrossValidatedTerms, choices: usize, unearned: usize| {
            let rounds = self.refit(first, &mean, &candidates, (choices, unearned), folds);
            (!rounds.is_empty()).then(|| self.built(rounds, &candidates, folds))
        };
        let by_environment = begun(first.clone(), LAG_CHOICES * self.offered.len(), 0);
        // The environment may be the wrong sensor, or not matter. Is a structure that begins with any pair
        // simpler or better?
        let pair = self.best_pair(&candidates, folds).filter(|_| !self.explicit);
        let by_pair = pair.clone().and_then(|p| begun(p, LAG_CHOICES * candidates.len(), 0));
        let differences = |j: &CrossValidatedTerms| j.terms.iter().filter(|t| squared(**t).is_some()).count();
        let mut both = None;
        let chosen = match (by_environment, by_pair) {
            (Some(own), Some(other)) => {
                let (a, b) = (&own.1, &other.1);
                let simpler = differences(b) < differences(a) && !a.beats(b);
                let better = differences(b) <= differences(a) && b.beats(a);
                // If it has more terms, it must be better than the best of that many chance columns.
                let earned = b.earns(a, LAG_CHOICES * candidates.len());
                let (taken, left) = if simpler || better || earned { (other, own) } else { (own, other) };
                both = Some(left.1);
                Some(taken)
            }
            (own, other) => own.or(other),
        };
        // If no single difference explains enough, several together may.
        let chosen = chosen.or_else(|| begun(first.clone(), LAG_CHOICES * self.offered.len(), UNEARNED));
        let chosen = chosen.or_else(|| begun(pair?, LAG_CHOICES * candidates.len(), UNEARNED));
        // The temperatures explain no more than chance: nothing is added, but the sensors are ranked.
        let Some((rounds, structure, swaps)) = chosen else {
            let none = Vec::new;
            return Some(TermSelection {
                structure: mean,
                rounds: none(),
                swaps: Vec::new(),
                kept,
                dropped,
                tied: none(),
                passed_over: None,
            });
        };
        let passed_over =
            both.filter(|o| differences(o) <= differences(&structure) && o.gain_over(&structure) > 0.0);
        Some(TermSelection { structure, rounds, swaps, kept, dropped, tied, passed_over })
    }

    /// Sort key of structures, better first: the residual to nine digits.
    /// Different differences may give the same sum, and rounding must not decide between them. Then the one
    /// to the environment wins, because its gain is the body's own.
    fn merit(&self, j: &CrossValidatedTerms) -> (i64, bool) {
        let of_two = pair_of(j.terms[j.terms.len() - 1]).is_some_and(|(_, minus)| minus != self.environment);
        ((j.rms().ln() * 1e9).round() as i64, of_two)
    }

    /// Runs the rounds, exchanges terms and removes those that became unnecessary.
    fn built(
        &self,
        rounds: Vec<CrossValidatedTerms>,
        candidates: &[Pair],
        folds: &[usize],
    ) -> (Vec<CrossValidatedTerms>, CrossValidatedTerms, Vec<(CrossValidatedTerms, Term)>) {
        let (structure, swaps) = self.exchange(rounds[rounds.len() - 1].clone(), candidates, folds);
        let structure = self.without_idle(structure, candidates.len(), folds);
        let mut structure = self.to_environment(structure, folds);
        for term in structure.terms.clone() {
            let Some(square) = squared(term).filter(|q| self.square && !structure.terms.contains(q)) else {
                continue;
            };
            let bent = self.judge(&[structure.terms.as_slice(), &[square]].concat(), folds);
            let bent = bent.filter(|b| self.is_physical(b, folds)).map(|b| self.retune(b, folds));
            structure = bent.filter(|b| b.is_bent(&structure)).unwrap_or(structure);
        }
        (rounds, structure, swaps)
    }

    /// Rewrites sums as differences to the environment where possible.
    /// Beside T1−T0, T1−T2 adds the same as T2−T0, whose gain is the body's own.
    pub(super) fn to_environment(
        &self,
        mut now: CrossValidatedTerms,
        folds: &[usize],
    ) -> CrossValidatedTerms {
        for k in 0..now.terms.len() {
            let Term::Thermal { sensor, minus: Some(minus), lag, square: false } = now.terms[k] else {
                continue;
            };
            let to = |sensor: usize| Term::Thermal { sensor, minus: self.environment, lag, square: false };
            if Some(minus) == self.environment
                || squared(now.terms[k]).is_some_and(|q| now.terms.contains(&q))
            {
                continue;
            }
            let other = match [sensor, minus].map(|s| now.terms.contains(&to(s))) {
                [true, false] => to(minus),
                [false, true] => to(sensor),
                _ => continue,
            };
            // If the differences were given, no other one may be used.
            if self.explicit && pair_of(other).is_none_or(|p| !self.offered.contains(&p)) {
                continue;
            }
            let mut terms = now.terms.clone();
            terms[k] = other;
            if let Some(same) = self.judge(&terms, folds).filter(|j| self.is_physical(j, folds)) {
                now = same;
            }
        }
        now
    }

    /// The difference of any two sensors with the smallest residual alone.
    fn best_pair(&self, candidates: &[Pair], folds: &[usize]) -> Option<CrossValidatedTerms> {
        let screened = self.screen(&[], candidates, folds);
        let fits = self.with_best_lags(&[], &screened, folds).into_iter().map(|plain| {
            let bent = squared(plain.terms[0]).filter(|_| self.square);
            let bent = bent.and_then(|q| self.judge(&[plain.terms[0], q], folds));
            let bent = bent.filter(|b| self.is_physical(b, folds)).map(|b| self.retune(b, folds));
            bent.filter(|b| b.is_bent(&plain)).unwrap_or(plain)
        });
        fits.min_by_key(|j| self.merit(j))
    }

    /// Removes terms that are not justified beside the others.
    fn without_idle(
        &self,
        mut now: CrossValidatedTerms,
        candidates: usize,
        folds: &[usize],
    ) -> CrossValidatedTerms {
        while now.terms.len() > 1 {
            let rest = |k: usize| {
                let bent = squared(now.terms[k]);
                let keep = |(j, t): (usize, &Term)| (j != k && Some(*t) != bent).then_some(*t);
                let terms: Vec<Term> = now.terms.iter().enumerate().filter_map(keep).collect();
                let left = self.judge(&terms, folds).filter(|_| !terms.is_empty())?;
                let left = Some(self.retune(left, folds)).filter(|j| self.is_physical(j, folds))?;
                let square = matches!(now.terms[k], Term::Thermal { square: true, .. });
                let earned =
                    if square { now.is_bent(&left) } else { now.earns(&left, LAG_CHOICES * candidates) };
                (!earned).then_some(left)
            };
            let idle = (0..now.terms.len()).filter_map(rest);
            let Some(best) = idle.min_by_key(|j| self.merit(j)) else { break };
            now = best;
        }
        now
    }

    /// Leaves out sensors that measure the same as a better one, in order of merit.
    /// Returns those kept, and those dropped with their α and the kept one's index.
    fn casc(
        &self,
        order: Vec<CrossValidatedTerms>,
    ) -> (Vec<CrossValidatedTerms>, Vec<(CrossValidatedTerms, f64, usize)>) {
        let mut kept: Vec<CrossValidatedTerms> = Vec::new();
        let mut dropped: Vec<(CrossValidatedTerms, f64, usize)> = Vec::new();
        for j in order {
            let column = |j: &CrossValidatedTerms| self.column(j.terms[0]);
            let own = column(&j);
            let alphas = kept.iter().enumerate().map(|(k, o)| (k, correlation(&own, &column(o)).abs()));
            match alphas.max_by(|a, b| a.1.total_cmp(&b.1)).filter(|(_, alpha)| *alpha >= REDUNDANT) {
                Some((with, alpha)) => dropped.push((j, alpha, with)),
                None => kept.push(j),
            }
        }
        (kept, dropped)
    }

    /// The rounds of the refit, the first term's included.
    /// Adds the next best term while it is justified. Returns nothing if no term improves on the mean.
    ///
    /// If two bodies drive the growth, either alone leaves the other's share. That share is slow and so has
    /// few independent values. Neither term is therefore justified alone, but both together are. The first
    /// `unearned` terms are accepted provisionally, until later terms justify all.
    fn refit(
        &self,
        first: CrossValidatedTerms,
        mean: &CrossValidatedTerms,
        candidates: &[Pair],
        (choices_of_first, unearned): (usize, usize),
        folds: &[usize],
    ) -> Vec<CrossValidatedTerms> {
        let mut standing = usize::from(first.beyond_chance(mean, choices_of_first));
        let mut rounds = vec![first];
        // Once a term is accepted, every further term must be justified by itself.
        while rounds.len() < ROUNDS && (standing > 0 || rounds.len() <= unearned) {
            let now = &rounds[rounds.len() - 1];
            // The same difference a second time would only correct an inexact lag.
            let new = |p: &Pair| now.terms.iter().all(|t| pair_of(*t) != Some(*p));
            let few = |(s, m): &Pair| {
                let term = Term::plain((*s, *m));
                Self::sensor_count(&[now.terms.as_slice(), &[term]].concat()) <= SENSORS
            };
            let offered: Vec<_> = candidates.iter().copied().filter(new).filter(few).collect();
            let screened = self.screen(&now.terms, &offered, folds);
            let mut next = self.with_best_lags(&now.terms, &screened, folds);
            let mut extra = self.unlike_differences(&now.terms);
            extra.retain(|t| !now.terms.contains(t));
            next.extend(extra.into_iter().filter_map(|t| {
                let judged = self.judge(&[now.terms.as_slice(), &[t]].concat(), folds)?;
                self.is_physical(&judged, folds).then_some(judged)
            }));
            next.sort_by_key(|j| self.merit(j));
            // The patent asks R to improve by 1 %, which is impossible if R is above 0.99. Here a term stays
            // if unseen blocks are better with it, by more than the best of that many chance columns.
            let choices = LAG_CHOICES * (offered.len() + 1);
            let next: Vec<CrossValidatedTerms> = next.into_iter().map(|j| self.retune(j, folds)).collect();
            let bent =
                |j: &CrossValidatedTerms| matches!(j.terms.last(), Some(Term::Thermal { square: true, .. }));
            let stands = |j: &CrossValidatedTerms| match standing {
                0 => j.beyond_chance(mean, choices.max(choices_of_first)),
                _ if bent(j) => j.is_bent(now),
                _ => j.earns(now, choices),
            };
            let earned: Vec<&CrossValidatedTerms> = next.iter().filter(|j| stands(j)).collect();
            let added = match earned.first() {
                // The square of a difference already used is preferred to another difference that is not
                // better.
                Some(best) => {
                    standing = rounds.len() + 1;
                    earned.iter().find(|j| bent(j)).filter(|b| !best.beats(b)).unwrap_or(best)
                }
                None if standing > 0 => break,
                None => match next.iter().find(|j| j.rms() < now.rms() && !bent(j)) {
                    Some(tried) => tried,
                    None => break,
                },
            };
            rounds.push(added.clone());
        }
        rounds.truncate(standing);
        rounds
    }

    /// Candidates that are not differences.
    /// They are coolant, spindle speed, and the squares of the differences already used.
    fn unlike_differences(&self, terms: &[Term]) -> Vec<Term> {
        let coolant = self.coolant.as_ref().map(|_| Term::Coolant);
        let speed = self.speed.as_ref().map(|_| Term::Speed);
        let squares = terms.iter().filter_map(|t| squared(*t)).filter(|_| self.square);
        coolant.into_iter().chain(speed).chain(squares).collect()
    }

    /// Tries to exchange each term for one that is better beside all others.
    /// Each term was only the best beside those before it. A single term is kept, because physics chose it.
    /// Returns the final structure, and each exchange with the term that was removed.
    fn exchange(
        &self,
        mut now: CrossValidatedTerms,
        candidates: &[Pair],
        folds: &[usize],
    ) -> (CrossValidatedTerms, Vec<(CrossValidatedTerms, Term)>) {
        let mut swaps = Vec::new();
        let mut swapped = now.terms.len() > 1;
        for _ in 0..ROUNDS {
            if !std::mem::take(&mut swapped) {
                break;
            }
            for k in 0..now.terms.len() {
                if pair_of(now.terms[k]).is_none()
                    || squared(now.terms[k]).is_none_or(|q| now.terms.contains(&q))
                {
                    continue;
                }
                let mut rest = now.terms.clone();
                rest.remove(k);
                // The same difference a second time would only correct an inexact lag.
                let new = |p: &Pair| rest.iter().all(|t| pair_of(*t) != Some(*p));
                let offered: Vec<Pair> = candidates.iter().copied().filter(new).collect();
                let screened = self.screen(&rest, &offered, folds);
                let fits = self.with_best_lags(&rest, &screened, folds);
                let few = fits.into_iter().filter(|j| Self::sensor_count(&j.terms) <= SENSORS);
                let best = few.min_by_key(|j| self.merit(j));
                if let Some(best) = best.filter(|b| b.beats(&now)) {
                    let out = now.terms[k];
                    now = self.retune(best, folds);
                    swapped = true;
                    // The same difference with another lag is not an exchange.
                    if now.terms.last().and_then(|t| pair_of(*t)) != pair_of(out) {
                        swaps.push((now.clone(), out));
                    }
                }
            }
        }
        (now, swaps)
    }

    /// The offered differences whose growth has the sign of the hottest body's.
    /// Heat comes from that body. If it is hardly correlated with the response, all are returned.
    fn driven_by_the_source(
        &self,
        singles: Vec<CrossValidatedTerms>,
        folds: &[usize],
    ) -> Vec<CrossValidatedTerms> {
        let rows: Vec<usize> = self.stretches(folds).flatten().collect();
        let warmth = |j: &CrossValidatedTerms| {
            let Some((sensor, minus)) = pair_of(j.terms[0]) else { return 0.0 };
            let u = self.column(Term::plain((sensor, minus)));
            rows.iter().map(|i| u[*i]).sum::<f64>() / rows.len() as f64
        };
        let hottest = singles.iter().max_by(|a, b| warmth(a).total_cmp(&warmth(b)));
        let way = hottest.map_or(0.0, |j| self.gamma(j.terms[0], folds));
        if self.explicit || way.abs() < 0.5 {
            return singles;
        }
        singles.into_iter().filter(|j| j.coefficients[1] * way > 0.0).collect()
    }

    /// The candidates that explain most of these terms' residual, whatever their lag.
    fn screen(&self, terms: &[Term], candidates: &[Pair], folds: &[usize]) -> Vec<Pair> {
        // The constant and the terms, weighted, zero outside the folds; then the residual beside them.
        let mut roots = vec![0.0; self.y.len()];
        self.stretches(folds).flatten().for_each(|i| roots[i] = self.weight[i].sqrt());
        let weighted = |v: &[f64]| v.iter().zip(&roots).map(|(v, w)| v * w).collect::<Vec<f64>>();
        let mut factor = QrFactor::new(&weighted(&self.y));
        factor.push_free(&roots);
        for t in terms {
            factor.push_free(&weighted(&self.column(*t)));
        }
        let basis: Vec<Vec<f64>> = factor.columns().iter().map(|q| weighted(q)).collect();
        let left = weighted(factor.residual());
        let mut scores = vec![0.0; candidates.len()];
        for screened in &self.screened {
            // Each sensor's projections on the basis and on the residual. Those of a difference are the
            // differences.
            let of = |v: &Vec<f64>| {
                let known: Vec<f64> = basis.iter().map(|q| dot(q, v)).collect();
                (known, dot(&left, v))
            };
            let sensors: Vec<(Vec<f64>, f64)> = screened.centred.iter().map(of).collect();
            for (score, (sensor, minus)) in scores.iter_mut().zip(candidates) {
                let (known, with) = &sensors[*sensor];
                let other = minus.map(|m| &sensors[m]);
                let beside = |k: usize| known[k] - other.map_or(0.0, |(known, _)| known[k]);
                let squares = screened.squares(self.sensors.len(), (*sensor, *minus), folds);
                let own = squares - (0..known.len()).map(|k| beside(k).powi(2)).sum::<f64>();
                let with = with - other.map_or(0.0, |(_, with)| *with);
                if own > 1e-12 * squares.max(1.0) {
                    *score = f64::max(*score, with * with / own);
                }
            }
        }
        let mut scored: Vec<_> = candidates.iter().zip(scores).collect();
        scored.sort_by(|a, b| b.1.total_cmp(&a.1));
        scored.into_iter().take(SCREENED).map(|(c, _)| *c).collect()
    }

    /// Number of sensors that these terms read.
    fn sensor_count(terms: &[Term]) -> usize {
        let mut read: Vec<usize> =
            terms.iter().filter_map(|t| pair_of(*t)).flat_map(|(s, m)| [Some(s), m]).flatten().collect();
        read.sort_unstable();
        read.dedup();
        read.len()
    }

    /// Searches each lag again with the others held, now that all terms are known.
    fn retune(&self, mut now: CrossValidatedTerms, folds: &[usize]) -> CrossValidatedTerms {
        for k in 0..now.terms.len() {
            let Term::Thermal { lag: at @ 1.., square: false, .. } = now.terms[k] else { continue };
            // The square of a difference has its lag.
            let others = relagged(&now.terms, k, 0);
            let (moved, rest): (Vec<usize>, Vec<usize>) =
                (0..others.len()).partition(|n| others[*n] != now.terms[*n]);
            let of = |places: &[usize], terms: &[Term]| places.iter().map(|n| terms[*n]).collect::<Vec<_>>();
            let rest = of(&rest, &now.terms);
            let Some(beside) = self.beside(&rest, folds) else { return now };
            let mut other = |lag: usize| {
                let moved = of(&moved, &relagged(&now.terms, k, lag));
                let with = |beside: FoldLeastSquares, term: &Term| beside.with(&self.column(*term));
                let solved = moved.iter().try_fold(beside.clone(), with)?.solve()?;
                let terms = [rest.as_slice(), &moved].concat();
                self.physical(&terms, &solved.coefficients, folds).then(|| solved.rms())
            };
            let best = self.nearer((at, now.rms()), &mut other).0;
            if best != at {
                now = self.judge(&relagged(&now.terms, k, best), folds).unwrap_or(now);
            }
        }
        now
    }

    /// Each of these differences added to the given terms, with its best lag.
    pub(super) fn with_best_lags(
        &self,
        terms: &[Term],
        pairs: &[Pair],
        folds: &[usize],
    ) -> Vec<CrossValidatedTerms> {
        let Some(beside) = self.beside(terms, folds) else { return Vec::new() };
        pairs.iter().filter_map(|(s, m)| self.best_lag(&beside, terms, *s, *m, folds)).collect()
    }

    /// The best lag of a difference beside the given terms; none unless justified.
    /// The terms' columns are given.
    fn best_lag(
        &self,
        beside: &FoldLeastSquares,
        terms: &[Term],
        sensor: usize,
        minus: Option<usize>,
        folds: &[usize],
    ) -> Option<CrossValidatedTerms> {
        let with = |lag: usize| [terms, &[Term::Thermal { sensor, minus, lag, square: false }]].concat();
        let fit = |lag: usize| {
            let all = with(lag);
            let fit = beside.with(&self.column(all[terms.len()]))?;
            Some((fit, all))
        };
        let judge = |lag: usize| fit(lag).and_then(|(fit, all)| fit.judge(&all));
        let at = |lag: usize| {
            let (fit, all) = fit(lag)?;
            fit.solve().filter(|s| self.physical(&all, &s.coefficients, folds)).map(|s| s.rms())
        };
        let without = at(0).and_then(|_| judge(0));
        let coarse = (1..self.taus.len()).step_by(COARSE).filter_map(|lag| Some((lag, at(lag)?)));
        let coarse = coarse.min_by(|a, b| a.1.total_cmp(&b.1));
        let lagged = coarse.and_then(|best| judge(self.nearer(best, &mut |lag| at(lag)).0));
        match (without, lagged) {
            (Some(a), Some(b)) => Some(if b.earns(&a, LAG_CHOICES) { b } else { a }),
            (a, b) => a.or(b),
        }
    }

    /// Refines a lag and its residual with ever shorter steps of the grid.
    fn nearer(&self, mut best: (usize, f64), at: &mut dyn FnMut(usize) -> Option<f64>) -> (usize, f64) {
        for step in std::iter::successors(Some(COARSE / 2), |s| Some(s / 2)).take_while(|s| *s > 0) {
            let from = best.0;
            for lag in [from.saturating_sub(step), from + step] {
                if (1..self.taus.len()).contains(&lag)
                    && let Some(rms) = at(lag)
                    && rms < best.1
                {
                    best = (lag, rms);
                }
            }
        }
        best
    }

    /// The offered pairs, the one that moves most with the response first.
    pub(super) fn ranked_pairs(&self, folds: &[usize]) -> Vec<RankedSensor> {
        let best = self.with_best_lags(&[], &self.pairs, folds);
        let mut pairs: Vec<RankedSensor> = best.iter().map(|j| self.ranked(j, folds)).collect();
        pairs.sort_by(|a, b| b.gamma_lagged.abs().total_cmp(&a.gamma_lagged.abs()));
        pairs
    }

    /// The merit of a structure's last difference.
    pub(super) fn ranked(&self, j: &CrossValidatedTerms, folds: &[usize]) -> RankedSensor {
        let Term::Thermal { sensor, minus, lag, .. } = j.terms[j.terms.len() - 1] else {
            unreachable!("only differences are ranked")
        };
        let plain = Term::plain((sensor, minus));
        let t = &self.binned[sensor][0];
        let bound = |f: fn(f64, f64) -> f64| t.iter().copied().fold(t[0], f);
        RankedSensor {
            sensor: self.name(plain),
            gamma: self.gamma(plain, folds),
            gamma_lagged: self.gamma(Term::Thermal { sensor, minus, lag, square: false }, folds),
            tau_s: self.taus[lag],
            range_k: bound(f64::max) - bound(f64::min),
            cv_rms_um: j.rms(),
        }
    }
}
