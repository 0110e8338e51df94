//! Which of many explanations by heat? Sensors that warm together fit the past in hundreds of ways, and what fits it
//! best may be far off an hour later. So an explanation is asked to predict: fitted on the rows before a moment, it
//! predicts those after it. One that cannot, although it fits, gives way to the simplest physics that can: growth in
//! proportion to how much warmer one place is than the machine's surroundings, later by a lag.

use crate::cause::Cause;
use crate::cholesky::Cholesky;
use crate::hypotheses::Atom;
use crate::lanes::dot;
use crate::problem::rms;
use crate::search::{Search, Set};
use rtec_model::effect::{Against, Difference, Effect, Heat};
use rtec_model::record::{Kind, Role};

/// Moments that later rows are predicted from, as shares of the run.
const MOMENTS: [f64; 4] = [0.4, 0.55, 0.7, 0.85];
/// Prediction that is so much worse than fitting shows a law that is not the cause.
const UNSTEADY: f64 = 1.5;
/// The same where several effects of heat are added up, or one is no machine's: more freedom to fit what is not there.
const UNSTEADY_SUM: f64 = 1.2;
/// What predicts nearly as well as the best is not told from it.
const EQUAL: f64 = 1.5;
/// Growth of a metre of steel, the longest that grows as one: 12 µm/K.
const MOST_UM_PER_K: f64 = 12.0;
/// Where a machine at rest may have no growth, °C.
const REFERENCE_DEGC: std::ops::RangeInclusive<f64> = -10.0..=60.0;
/// Longest lag, as a share of the rows it is fitted on.
const LONGEST_LAG: f64 = 1.0 / 3.0;
/// Sensors within so much of the coldest show the surroundings, K.
const SURROUNDINGS_K: f64 = 1.0;
/// So many explanations, of as many places, are averaged.
const AVERAGED: usize = 5;
/// Prediction so much worse than fitting is no matter of few early rows.
const WANDERS: f64 = 2.5;
/// What is left of a longer memory is structure and no noise.
const NOISE_MEMORY: f64 = 0.7;
/// Fewer rows predict nothing.
const FEWEST_ROWS: usize = 200;

/// How an explanation does.
struct Trial {
    /// RMS of later rows, predicted.
    ahead: f64,
    /// RMS over all rows, fitted.
    fitted: f64,
    /// Best grid point over all rows.
    at: usize,
}

/// Coefficients of a least-squares fit on rows, and its sum of squares.
fn fit(y: &[f64], columns: &[&[f64]], to: usize) -> (Vec<f64>, f64) {
    let k = columns.len();
    let mut a = vec![0.0; k * k];
    for i in 0..k {
        for j in 0..=i {
            a[i * k + j] = dot(&columns[i][..to], &columns[j][..to]);
        }
    }
    let mut b: Vec<f64> = columns.iter().map(|c| dot(&c[..to], &y[..to])).collect();
    let factor = Cholesky::new(&a, k);
    factor.forward(&mut b);
    let left = dot(&y[..to], &y[..to]) - dot(&b, &b);
    factor.backward(&mut b);
    (b, left.max(0.0))
}

/// Columns that stand in every fit, and grid points of which each fit takes its best: a lag with its columns.
fn trial(y: &[f64], fixed: &[&[f64]], grid: &[(f64, Vec<&[f64]>)], span_s: f64) -> Option<Trial> {
    let n = y.len();
    let best = |to: usize| {
        let longest = span_s * to as f64 / n as f64 * LONGEST_LAG;
        grid.iter()
            .enumerate()
            .filter(|(_, (lag, _))| *lag <= longest)
            .map(|(i, (_, own))| {
                let columns: Vec<&[f64]> = fixed.iter().chain(own).copied().collect();
                let (beta, left) = fit(y, &columns, to);
                (i, columns, beta, left)
            })
            .min_by(|a, b| a.3.total_cmp(&b.3))
    };
    let mut sum = 0.0;
    for share in MOMENTS {
        let to = (n as f64 * share) as usize;
        let (_, columns, beta, _) = best(to)?;
        let later: Vec<f64> =
            (to..n).map(|r| y[r] - columns.iter().zip(&beta).map(|(c, b)| c[r] * b).sum::<f64>()).collect();
        sum += rms(&later).powi(2);
    }
    let (at, _, _, left) = best(n)?;
    Some(Trial { ahead: (sum / MOMENTS.len() as f64).sqrt(), fitted: (left / n as f64).sqrt(), at })
}

/// A drift of one record with several temperatures.
struct Run {
    /// What the model leaves, weighed.
    y: Vec<f64>,
    span_s: f64,
}

impl Run {
    /// None for other runs, or where nothing in the set is of heat.
    fn of(search: &Search<'_, '_>, set: &Set) -> Option<Self> {
        let record = &search.stack.records[0];
        let n = search.stack.n;
        let drift = record.kind == Kind::Drift && search.stack.ranges.len() == 1 && n >= FEWEST_ROWS;
        let heat = set.members.iter().any(|m| follows_heat(&m.cause));
        (drift && heat && record.names(&Role::Temperature).count() >= 2).then(|| Self {
            y: search.vectors[search.y].data.clone(),
            span_s: record.time_s()[n - 1] - record.time_s()[0],
        })
    }
}

/// Growth in proportion to one temperature difference, maybe late.
struct Simple {
    hypothesis: usize,
    trial: Trial,
    /// Its best grid point.
    atom: usize,
    /// Its growth, µm/K.
    gain: f64,
}

impl Search<'_, '_> {
    /// A steadier explanation than a set that fits but cannot predict, and what predicts as well; none where the set
    /// is steady, or nothing is steadier.
    pub(crate) fn steadier(&mut self, set: &Set) -> Option<(Set, Vec<usize>)> {
        let run = Run::of(self, set)?;
        let all: Vec<&[f64]> = set.ids.iter().map(|i| self.vectors[*i].data.as_slice()).collect();
        let own = trial(&run.y, &all, &[(0.0, Vec::new())], run.span_s)?;
        let plausible = self.plausible(set);
        if own.ahead < WANDERS * own.fitted && self.leaves_noise(set) && self.physical(set) {
            return None;
        }
        let simple = plausible && set.members.iter().filter(|m| grows(&m.cause)).count() < 2;
        let bound = if simple { UNSTEADY } else { UNSTEADY_SUM };
        if plausible && own.ahead < bound * own.fitted {
            return None;
        }
        let mut rest = set.clone();
        while let Some(i) = rest.members.iter().position(|m| follows_heat(&m.cause)) {
            rest = self.without(&rest, i);
        }
        let mut tried = self.simplest(&run, &rest);
        tried.sort_by(|a, b| a.trial.ahead.total_cmp(&b.trial.ahead));
        let least = tried.first()?.trial.ahead;
        // The simplest physics need not predict better than a sum of effects, only nearly as well.
        let needed = if simple { own.ahead / UNSTEADY } else { own.ahead * EQUAL };
        if plausible && least > needed {
            return None;
        }
        let sum = self.averaged(&tried);
        tried.retain(|t| t.trial.ahead <= EQUAL * least);
        let equals = tried.iter().map(|t| t.hypothesis).collect();
        Some((self.in_place(&rest, &sum), equals))
    }

    /// Whether nothing but noise is left, of no longer memory than noise has: then what explains the rows explains all of
    /// them, and early rows that predict the later ones badly only say how little they tell.
    fn leaves_noise(&mut self, set: &Set) -> bool {
        let free = self.wandering(true, set.clone());
        let (_, phi) = self.residual(&free);
        let _back = self.wandering(false, Set::clone(&free));
        phi < NOISE_MEMORY
    }

    /// The mean of several explanations, each by how well it predicts: one for each place of the machine, the best few.
    /// No single rule for choosing one of them holds from one stretch of time to the next; their mean does. `tried`: the
    /// one that predicts best first.
    fn averaged(&self, tried: &[Simple]) -> Vec<(usize, f64)> {
        let place = |t: &Simple| {
            self.all.list[t.hypothesis].sensor().map(|d| hot(d, &self.surroundings()).to_owned())
        };
        let mut best: Vec<&Simple> = Vec::new();
        for t in tried {
            if best.len() < AVERAGED && !best.iter().any(|b| place(b) == place(t)) {
                best.push(t);
            }
        }
        let weight = |t: &Simple| 1.0 / t.trial.ahead.powi(2).max(1e-12);
        let whole: f64 = best.iter().map(|t| weight(t)).sum();
        best.into_iter().map(|t| (t.atom, t.gain * weight(t) / whole)).collect()
    }

    /// Growth in proportion to each difference between a place of the machine and its surroundings, beside what a set
    /// has that is not of heat: those with a machine's gain.
    fn simplest(&self, run: &Run, rest: &Set) -> Vec<Simple> {
        let constant = vec![1.0; self.stack.n];
        let mut fixed: Vec<&[f64]> = rest.ids.iter().map(|i| self.vectors[*i].data.as_slice()).collect();
        fixed.push(&constant);
        let cold = self.surroundings();
        let mut tried = Vec::new();
        for (h, hypothesis) in self.all.list.iter().enumerate() {
            let growth = hypothesis.law().is_some_and(|l| l.heat == Heat::Growth);
            if growth && hypothesis.sensor().is_some_and(|d| outward(d, &cold)) {
                let simple = self.simple(run, &fixed, h);
                tried.extend(simple.filter(|s| s.gain.abs() <= MOST_UM_PER_K));
            }
        }
        tried
    }

    /// One of them.
    fn simple(&self, run: &Run, fixed: &[&[f64]], hypothesis: usize) -> Option<Simple> {
        let atoms: Vec<usize> = (0..self.all.atoms.len())
            .filter(|a| {
                self.all.atoms[*a].hypothesis == hypothesis && straight(&self.all.atoms[*a]).is_some()
            })
            .collect();
        let columns: Vec<Vec<Vec<f64>>> = atoms
            .iter()
            .map(|a| self.all.atoms[*a].columns.iter().map(|c| self.all.bank.column(*c)).collect())
            .collect();
        let lag = |a: &usize| straight(&self.all.atoms[*a]).unwrap_or(0.0);
        let grid: Vec<(f64, Vec<&[f64]>)> = atoms
            .iter()
            .zip(&columns)
            .map(|(a, c)| (lag(a), c.iter().map(Vec::as_slice).collect()))
            .collect();
        let trial = trial(&run.y, fixed, &grid, run.span_s)?;
        let columns: Vec<&[f64]> = fixed.iter().chain(&grid[trial.at].1).copied().collect();
        let (beta, _) = fit(&run.y, &columns, self.stack.n);
        let atom = atoms[trial.at];
        let gain = beta[columns.len() - 1] / self.all.bank.scale[self.all.atoms[atom].columns[0]];
        Some(Simple { hypothesis, trial, atom, gain })
    }

    /// A set with these grid points of growth added up, beside a constant.
    fn in_place(&mut self, rest: &Set, parts: &[(usize, f64)]) -> Set {
        let all = self.all;
        let mut column = vec![0.0; self.stack.n];
        let mut effects = Vec::new();
        for (atom, gain) in parts {
            let Cause::Effect { effect, .. } = &all.atoms[*atom].cause else { continue };
            effects.extend(effect.with(&[(0, *gain)]));
            let at = all.atoms[*atom].columns[0];
            let scale = all.bank.scale[at] * gain;
            column.iter_mut().zip(all.bank.column(at)).for_each(|(c, x)| *c += scale * x);
        }
        let Some((first, _)) = parts.first() else { return rest.clone() };
        let Atom { hypothesis, cost, .. } = all.atoms[*first];
        let steady = self.joined_by(rest, &Cause::Sum(effects), hypothesis, cost, vec![column]);
        let offset = all.atoms.iter().find(|a| all.list[a.hypothesis].is_offset());
        offset.map_or(steady.clone(), |a| self.take_atom(&steady, a))
    }

    /// Whether growth per kelvin and reference temperatures are a machine's.
    fn plausible(&self, set: &Set) -> bool {
        self.effects(set).iter().flatten().all(|effect| {
            let Some(difference) = &effect.delta else { return true };
            let growth = effect.description().heat == Heat::Growth;
            let gain = if growth { effect.scalar(0).abs() } else { 0.0 };
            let at_rest = match difference.against {
                Against::Reference(degc) => REFERENCE_DEGC.contains(&degc),
                _ => true,
            };
            gain <= MOST_UM_PER_K && at_rest
        })
    }

    /// Sensors that show the machine's surroundings: the coldest on average.
    fn surroundings(&self) -> Vec<String> {
        let record = &self.stack.records[0];
        let means: Vec<(String, f64)> = record
            .names(&Role::Temperature)
            .filter_map(|s| {
                let t = record.temperature(s)?;
                Some((s.to_owned(), t.iter().sum::<f64>() / t.len() as f64))
            })
            .collect();
        let coldest = means.iter().map(|m| m.1).fold(f64::INFINITY, f64::min);
        means.into_iter().filter(|m| m.1 <= coldest + SURROUNDINGS_K).map(|m| m.0).collect()
    }
}

/// Follows heat, or stands in for it.
fn follows_heat(cause: &Cause) -> bool {
    matches!(cause, Cause::Effect { effect, .. } if effect.description().heat != Heat::None)
}

/// Growth that follows a temperature, or only the time.
fn grows(cause: &Cause) -> bool {
    let grows = |e: &Effect| e.delta.is_some() || e.description().heat == Heat::FromStart;
    matches!(cause, Cause::Effect { effect, .. } if grows(effect))
}

/// The sensor of a difference that is not of the surroundings.
fn hot<'d>(difference: &'d Difference, surroundings: &[String]) -> &'d str {
    match &difference.against {
        Against::Sensor(m) if surroundings.contains(&difference.sensor) => m,
        _ => &difference.sensor,
    }
}

/// Between a place of the machine and its surroundings, or a fixed temperature.
fn outward(difference: &Difference, surroundings: &[String]) -> bool {
    let outside = |s: &String| surroundings.contains(s);
    match &difference.against {
        Against::Sensor(m) => outside(&difference.sensor) != outside(m),
        _ => !outside(&difference.sensor),
    }
}

/// The lag of a grid point that is in proportion to its difference; none for a parabola or a free reference.
fn straight(atom: &Atom) -> Option<f64> {
    match &atom.cause {
        Cause::Effect { effect, free, reference: false } if free == &[0] => {
            Some(effect.description().lag.map_or(0.0, |tau| effect.scalar(tau)))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(n: usize) -> Vec<f64> {
        (0..n).map(|i| i as f64).collect()
    }

    /// What is the cause predicts as well as it fits; what only runs beside it for a while does not.
    #[test]
    fn a_law_that_is_not_the_cause_fits_and_does_not_predict() {
        let n = 400;
        let cause: Vec<f64> = line(n).iter().map(|i| (i / 60.0).sin()).collect();
        let y: Vec<f64> = cause.iter().map(|c| 3.0 * c).collect();
        let beside: Vec<Vec<f64>> =
            (0..5).map(|k| line(n).iter().map(|i| (i / 400.0).powi(k)).collect()).collect();
        let right = trial(&y, &[&cause], &[(0.0, Vec::new())], 400.0).unwrap();
        let columns: Vec<&[f64]> = beside.iter().map(Vec::as_slice).collect();
        let wrong = trial(&y, &columns, &[(0.0, Vec::new())], 400.0).unwrap();
        assert!(right.ahead < 1e-6 && right.fitted < 1e-6);
        assert!(wrong.ahead > UNSTEADY * wrong.fitted, "{} and {}", wrong.ahead, wrong.fitted);
    }

    #[test]
    fn a_lag_as_long_as_the_run_is_not_tried() {
        let (y, column) = (line(100), line(100));
        let grid = |lag: f64| vec![(lag, vec![column.as_slice()])];
        assert!(trial(&y, &[], &grid(5.0), 100.0).is_some());
        assert!(trial(&y, &[], &grid(50.0), 100.0).is_none());
    }

    #[test]
    fn heat_flows_from_the_machine_to_its_surroundings() {
        let cold = vec!["T0".to_owned(), "T1".to_owned()];
        assert!(outward(&Difference::pair("T8", "T0"), &cold) && outward(&Difference::single("T8"), &cold));
        assert!(
            !outward(&Difference::pair("T8", "T9"), &cold) && !outward(&Difference::pair("T0", "T1"), &cold)
        );
        assert!(!outward(&Difference::single("T1"), &cold));
    }
}
