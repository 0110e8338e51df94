//! Which of many explanations by heat? Sensors that warm together fit the past in hundreds of ways, and what fits it
//! best may be far off an hour later. So an explanation is asked to foretell: fitted on the rows before a moment, it
//! predicts those after it. One that cannot, although it fits, gives way to the simplest physics that can: growth in
//! proportion to how much warmer one place is than the machine's surroundings, later by a lag.

use crate::analysis::effect_of;
use crate::gram::{Cholesky, dot};
use crate::hypotheses::{Atom, Cause};
use crate::problem::rms;
use crate::search::{Search, Set};
use rtec_model::effect::{Against, Difference, Effect, Heat};
use rtec_model::record::{Kind, Role};

/// Moments that later rows are foretold from, as shares of the run.
const MOMENTS: [f64; 4] = [0.4, 0.55, 0.7, 0.85];
/// Foretelling that is so much worse than fitting shows a law that is not the cause.
const UNSTEADY: f64 = 1.5;
/// The same where several effects of heat are added up, or one is no machine's: more freedom to fit what is not there.
const UNSTEADY_SUM: f64 = 1.2;
/// What foretells nearly as well as the best is not told from it.
const EQUAL: f64 = 1.5;
/// Share of the gap by which the simplest physics may fit worse.
const WORSE: f64 = 0.03;
/// Growth of a metre of steel, the longest that grows as one: 12 µm/K.
const MOST_UM_PER_K: f64 = 12.0;
/// Where a machine at rest may have no growth, °C.
const REFERENCE_DEGC: std::ops::RangeInclusive<f64> = -10.0..=60.0;
/// Longest lag, as a share of the rows it is fitted on.
const LONGEST_LAG: f64 = 1.0 / 3.0;
/// Sensors within so much of the coldest show the surroundings, K.
const SURROUNDINGS_K: f64 = 1.0;
/// Fewer rows foretell nothing.
const FEWEST_ROWS: usize = 200;

/// How an explanation does.
struct Trial {
    /// RMS of later rows, foretold.
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

impl Search<'_, '_> {
    /// A steadier explanation than a set that fits but cannot foretell, and what foretells as well; none where the set
    /// is steady, or nothing is steadier.
    pub(crate) fn steadier(&mut self, set: &Set) -> Option<(Set, Vec<usize>)> {
        let record = &self.stack.records[0];
        let n = self.stack.n;
        let heat = |e: &Effect| e.description().heat != Heat::None;
        let of = |cause: &Cause| matches!(cause, Cause::Effect { effect, .. } if heat(effect));
        let drift = record.kind == Kind::Drift && self.stack.ranges.len() == 1 && n >= FEWEST_ROWS;
        if !drift || record.names(&Role::Temperature).count() < 2 || !set.members.iter().any(|m| of(&m.cause))
        {
            return None;
        }
        let span = record.time_s()[n - 1] - record.time_s()[0];
        let y = self.vectors[self.y].data.clone();
        let all: Vec<&[f64]> = set.ids.iter().map(|i| self.vectors[*i].data.as_slice()).collect();
        let own = trial(&y, &all, &[(0.0, Vec::new())], span)?;
        let plausible = self.plausible(set);
        let simple = plausible && set.members.iter().filter(|m| grows(&m.cause)).count() < 2;
        let bound = if simple { UNSTEADY } else { UNSTEADY_SUM };
        if plausible && own.ahead < bound * own.fitted {
            return None;
        }
        let mut rest = set.clone();
        while let Some(i) = rest.members.iter().position(|m| of(&m.cause)) {
            rest = self.without(&rest, i);
        }
        let constant = vec![1.0; n];
        let mut fixed: Vec<&[f64]> = rest.ids.iter().map(|i| self.vectors[*i].data.as_slice()).collect();
        fixed.push(&constant);
        let whole = rms(&self.residual(&self.empty()).0);
        let cold = self.surroundings();
        let mut tried: Vec<(usize, Trial, usize)> = Vec::new();
        for (h, hypothesis) in self.all.list.iter().enumerate() {
            let Some(difference) = hypothesis.sensor() else { continue };
            let follows = hypothesis.law().is_some_and(|l| l.heat == Heat::Growth);
            if !follows || !outward(difference, &cold) {
                continue;
            }
            let atoms: Vec<usize> = (0..self.all.atoms.len())
                .filter(|a| self.all.atoms[*a].hypothesis == h && straight(&self.all.atoms[*a]).is_some())
                .collect();
            let columns: Vec<Vec<Vec<f64>>> = atoms
                .iter()
                .map(|a| self.all.atoms[*a].columns.iter().map(|c| self.all.bank.column(*c)).collect())
                .collect();
            let grid: Vec<(f64, Vec<&[f64]>)> = atoms
                .iter()
                .zip(&columns)
                .map(|(a, columns)| {
                    let lag = straight(&self.all.atoms[*a]).unwrap_or(0.0);
                    (lag, columns.iter().map(Vec::as_slice).collect())
                })
                .collect();
            let Some(t) = trial(&y, &fixed, &grid, span) else { continue };
            let columns: Vec<&[f64]> = fixed.iter().chain(&grid[t.at].1).copied().collect();
            let (beta, _) = fit(&y, &columns, n);
            let column = self.all.atoms[atoms[t.at]].columns[0];
            let gain = beta[columns.len() - 1] / self.all.bank.scale[column];
            if t.fitted <= own.fitted + WORSE * whole && gain.abs() <= MOST_UM_PER_K {
                let at = atoms[t.at];
                tried.push((h, t, at));
            }
        }
        tried.sort_by(|a, b| a.1.ahead.total_cmp(&b.1.ahead));
        let least = tried.first()?.1.ahead;
        // The simplest physics need not foretell better than a sum of effects, only nearly as well.
        let needed = if simple { own.ahead / UNSTEADY } else { own.ahead * EQUAL };
        if plausible && least > needed {
            return None;
        }
        tried.retain(|t| t.1.ahead <= EQUAL * least);
        // What leads the growth most is nearest to its cause: heat flows outwards, and growth follows.
        let lag = |at: usize| straight(&self.all.atoms[at]).unwrap_or(0.0);
        let first = (0..tried.len()).rev().max_by(|a, b| lag(tried[*a].2).total_cmp(&lag(tried[*b].2)))?;
        let (_, _, at) = tried.remove(first);
        let equals = tried.iter().map(|t| t.0).collect();
        let mut atom = self.all.atoms[at].clone();
        if let Cause::Effect { effect, free, reference } = &mut atom.cause
            && !effect.delta.as_ref().is_some_and(Difference::is_pair)
        {
            let constant = self.all.atoms.iter().find(|a| {
                a.hypothesis == atom.hypothesis
                    && matches!(&a.cause, Cause::Effect { effect: e, free: f, reference: true }
                        if e.values() == effect.values() && f == free)
            })?;
            *reference = true;
            atom.columns.clone_from(&constant.columns);
        }
        let mut steady = self.take_atom(&rest, &atom);
        if matches!(&atom.cause, Cause::Effect { reference: false, .. })
            && let Some(a) = self.all.atoms.iter().find(|a| self.all.list[a.hypothesis].is_offset())
        {
            steady = self.take_atom(&steady, a);
        }
        Some((steady, equals))
    }

    /// Whether growth per kelvin and reference temperatures are a machine's.
    fn plausible(&self, set: &Set) -> bool {
        let beta = self.coefficients(set);
        let mut at = self.slopes.len();
        set.members.iter().all(|m| {
            let gamma = &beta[at..at + m.columns()];
            at += m.columns();
            let Some(effect) = effect_of(&m.cause, gamma) else { return true };
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

/// Growth that follows a temperature, or only the time.
fn grows(cause: &Cause) -> bool {
    matches!(cause, Cause::Effect { effect, .. } if effect.delta.is_some() || effect.description().heat == Heat::FromStart)
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
