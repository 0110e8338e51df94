//! Two baselines, as an able analyst makes them in an afternoon.
//!
//! They are forward selection by the Bayesian information criterion, and the LASSO with cross-validation. Both use the
//! same dictionary and a grid of non-linear parameters, and refit the parameters of the model.

use crate::linear::{Basis, dot, length};
use rtec_model::effect::{Dictionary, Effect, ParameterFitMethod, ThermalDependence};
use rtec_model::machine::Machine;
use rtec_model::record::{Record, Role};

fn stacked(records: &[Record], effect: &Effect, slopes: bool) -> Vec<Vec<f64>> {
    let k = if slopes { effect.values().len() } else { effect.coefficient_count() };
    let mut out = vec![Vec::new(); k];
    for r in records {
        let acts = effect.acts_on(r);
        for c in r.responses() {
            let mut part = vec![0.0; k * r.rows()];
            if let (Some((_, at)), Ok(bound)) =
                (acts.iter().find(|(role, _)| *role == c.role), effect.bind(r))
            {
                if slopes {
                    bound.slopes(effect, *at, &mut part);
                } else {
                    bound.basis(effect, *at, &mut part);
                }
            }
            out.iter_mut().zip(part.chunks(r.rows())).for_each(|(o, p)| o.extend_from_slice(p));
        }
    }
    out
}

/// Grid points of a candidate's non-linear parameters.
fn grid(records: &[Record], effect: &Effect) -> Vec<Effect> {
    let set = |pairs: &[(&str, f64)]| {
        let mut e = effect.clone();
        pairs.iter().all(|(n, v)| e.set(n, &[*v]).is_ok()).then_some(e)
    };
    let time: Vec<f64> = records.iter().flat_map(|r| r.time_s().iter().copied()).collect();
    let (t0, t1) = (time[0], time.iter().copied().fold(0.0, f64::max));
    let places = |axis: usize| {
        let role = Role::Position(effect.axes()[axis].clone());
        let all: Vec<f64> = records.iter().filter_map(|r| r.data(&role)).flatten().copied().collect();
        all.iter().fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(*v), h.max(*v)))
    };
    match searched_by(effect)[..] {
        ["tau_s"] => (0..10).filter_map(|i| set(&[("tau_s", (t1 - t0) * 0.01 * 1.65_f64.powi(i))])).collect(),
        ["length_mm"] => {
            let (lo, hi) = places(0);
            (0..8).filter_map(|i| set(&[("length_mm", (hi - lo) * 0.3 * 0.6_f64.powi(i))])).collect()
        }
        ["at_s"] => (1..80).filter_map(|i| set(&[("at_s", t0 + (t1 - t0) * f64::from(i) / 80.0)])).collect(),
        ["lobes"] => (2..=9).filter_map(|i| set(&[("lobes", f64::from(i))])).collect(),
        ["centre_rad", "width_rad"] => (0..24)
            .flat_map(|i| [0.3, 0.6, 1.2, 2.0].map(|w| (f64::from(i) * 0.262, w)))
            .filter_map(|(c, w)| set(&[("centre_rad", c), ("width_rad", w)]))
            .collect(),
        ["period_mm"] => {
            (0..500).filter_map(|i| set(&[("period_mm", 0.5 * 120f64.powf(f64::from(i) / 499.0))])).collect()
        }
        ["period_um"] => {
            (0..800).filter_map(|i| set(&[("period_um", 200f64.powf(f64::from(i) / 799.0))])).collect()
        }
        ["knots_mm"] => {
            let (lo, hi) = places(effect.axes().len() - 1);
            [5, 8, 12]
                .iter()
                .filter_map(|k| {
                    let knots = (0..*k).map(|i| lo + (hi - lo) * f64::from(i) / f64::from(*k - 1));
                    let values: Vec<f64> = knots.chain((0..*k).map(|_| 0.0)).collect();
                    let mut e = effect.clone();
                    e.set_values(&values).is_ok().then_some(e)
                })
                .collect()
        }
        _ => vec![effect.clone()],
    }
}

/// Keys of an effect's non-linear parameters.
fn searched_by(effect: &Effect) -> Vec<&str> {
    let parameters = effect.description().parameters.iter();
    parameters
        .filter(|p| matches!(p.search, ParameterFitMethod::Smooth | ParameterFitMethod::Chosen))
        .map(|p| p.name.as_str())
        .collect()
}

/// Number of parameters of a candidate that its grid searches.
/// Each counts like one that is fitted. Knots do not count, because each has a height that is fitted.
fn searched(effect: &Effect) -> usize {
    searched_by(effect).iter().filter(|key| **key != "knots_mm").count()
}

/// One grid point of an effect.
struct Candidate {
    name: String,
    columns: Vec<Vec<f64>>,
    searched: usize,
}

/// The response, the columns of the model's parameters, and all candidates.
struct Problem {
    y: Vec<f64>,
    basis: Basis,
    candidates: Vec<Candidate>,
}

fn problem(records: &[Record], machine: &Machine) -> Problem {
    let mut y: Vec<f64> =
        records.iter().flat_map(|r| r.responses().flat_map(|c| c.data.iter().copied())).collect();
    let mut basis = Basis::default();
    let mut at = 0;
    for r in records {
        for c in r.responses() {
            let mut sum = vec![0.0; r.rows()];
            for e in machine.effects() {
                let _absent = e.add(r, &c.role, &mut sum);
            }
            y[at..at + r.rows()].iter_mut().zip(&sum).for_each(|(y, s)| *y -= s);
            at += r.rows();
        }
    }
    for e in machine.effects() {
        for column in stacked(records, e, true) {
            basis.add(&column);
        }
    }
    let all: Vec<&Record> = records.iter().collect();
    let mut candidates = Vec::new();
    for e in Dictionary::default().candidates(&all) {
        let name = e.name();
        candidates.extend(grid(records, &e).iter().map(|g| {
            let mut columns = stacked(records, g, false);
            // An analyst adds the quadratic term of a temperature law only later.
            if g.description().heat == ThermalDependence::Growth {
                columns.truncate(1);
            }
            Candidate { name: name.clone(), columns, searched: searched(&e) }
        }));
    }
    Problem { y, basis, candidates }
}

/// Names that forward selection by BIC would add.
pub fn forward_bic(records: &[Record], machine: &Machine) -> Vec<String> {
    let Problem { y, mut basis, candidates } = problem(records, machine);
    let n = y.len() as f64;
    let mut names: Vec<String> = Vec::new();
    for _ in 0..6 {
        let r = basis.rest(&y);
        let rss = r.iter().map(|x| x * x).sum::<f64>();
        let mut best: Option<(f64, usize)> = None;
        for (i, Candidate { name, columns, searched }) in candidates.iter().enumerate() {
            if names.contains(name) {
                continue;
            }
            let mut own = Basis::default();
            let mut left = rss;
            for column in columns {
                let c = basis.rest(column);
                if length(&c) > 1e-6 * length(column) && own.add(&c) {
                    let q = &own.0[own.0.len() - 1];
                    left -= q.iter().zip(&r).map(|(a, b)| a * b).sum::<f64>().powi(2);
                }
            }
            let gain = n * (rss / left.max(1e-12 * rss)).ln() - (own.0.len() + searched) as f64 * n.ln();
            if best.is_none_or(|(g, _)| gain > g) {
                best = Some((gain, i));
            }
        }
        match best {
            Some((gain, i)) if gain > 0.0 => {
                names.push(candidates[i].name.clone());
                for column in &candidates[i].columns {
                    basis.add(column);
                }
            }
            _ => break,
        }
    }
    names
}

/// Folds of the cross-validation, each a block of rows.
const FOLDS: usize = 5;
/// Penalties, from the largest down, each this share of the one before.
const STEP: f64 = 0.8;
const STEPS: i32 = 18;
/// Grid points per name that the LASSO gets.
/// They are those with the highest correlation with the response (Fan and Lv, J. R. Statist. Soc. B 70 (2008) 849).
const SCREENED: usize = 12;
/// Share of the explained size below which an effect is dropped.
/// The LASSO takes a little of everything.
const WORTH: f64 = 0.1;

/// A least-squares problem with an L1 penalty and columns of unit length.
struct Lasso<'c> {
    y: Vec<f64>,
    columns: Vec<&'c [f64]>,
}

impl Lasso<'_> {
    /// Coefficients for falling penalties, on the rows that `keep` selects.
    /// The method is coordinate descent from the solution before (Friedman, Hastie and Tibshirani, J. Stat. Softw. 33
    /// (2010) 1).
    fn path(&self, penalties: &[f64], keep: &dyn Fn(usize) -> bool) -> Vec<Vec<f64>> {
        let rows: Vec<usize> = (0..self.y.len()).filter(|r| keep(*r)).collect();
        let share = rows.len() as f64 / self.y.len() as f64;
        let columns: Vec<Vec<f64>> =
            self.columns.iter().map(|c| rows.iter().map(|r| c[*r]).collect()).collect();
        let squares: Vec<f64> = columns.iter().map(|c| dot(c, c).max(1e-12)).collect();
        let mut left: Vec<f64> = rows.iter().map(|r| self.y[*r]).collect();
        let mut beta = vec![0.0; columns.len()];
        let mut out = Vec::new();
        let mut active: Vec<usize> = Vec::new();
        for penalty in penalties {
            let bound = penalty * share;
            for _ in 0..20 {
                for _ in 0..60 {
                    let mut moved = 0.0_f64;
                    for &j in &active {
                        let g = dot(&columns[j], &left) + squares[j] * beta[j];
                        let next = g.signum() * (g.abs() - bound).max(0.0) / squares[j];
                        let change = next - beta[j];
                        if change != 0.0 {
                            left.iter_mut().zip(&columns[j]).for_each(|(l, c)| *l -= change * c);
                            beta[j] = next;
                            moved = moved.max(change.abs());
                        }
                    }
                    if moved < 1e-3 * bound {
                        break;
                    }
                }
                // Inactive columns above the penalty become active.
                let before = active.len();
                let joining = (0..columns.len())
                    .filter(|j| !active.contains(j) && dot(&columns[*j], &left).abs() > bound * 1.001)
                    .collect::<Vec<_>>();
                active.extend(joining);
                if active.len() == before {
                    break;
                }
            }
            out.push(beta.clone());
        }
        out
    }
}

/// Names that the LASSO would add.
/// The penalty is the largest within one standard error of the best, cross-validated in blocks of rows. A name counts
/// from a tenth of the size that this penalty selects.
pub fn lasso(records: &[Record], machine: &Machine) -> Vec<String> {
    let Problem { y, basis, candidates } = problem(records, machine);
    let y = basis.rest(&y);
    // Unit columns, orthogonal to the model's own parameters; of each name the closest ones.
    let mut screened: Vec<(usize, f64, Vec<Vec<f64>>)> = Vec::new();
    for (i, Candidate { columns, .. }) in candidates.iter().enumerate() {
        let mut own = Basis::default();
        for c in columns {
            let c = basis.rest(c);
            if length(&c) > 1e-6 * columns.iter().map(|c| length(c)).fold(0.0, f64::max) {
                own.add(&c);
            }
        }
        let closeness = own.0.iter().map(|q| dot(q, &y).powi(2)).sum::<f64>() / own.0.len().max(1) as f64;
        screened.push((i, closeness, own.0));
    }
    screened.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut taken: std::collections::BTreeMap<&str, usize> = std::collections::BTreeMap::new();
    screened.retain(|(i, ..)| {
        let n = taken.entry(candidates[*i].name.as_str()).or_default();
        *n += 1;
        *n <= SCREENED
    });
    let owner: Vec<usize> = screened.iter().flat_map(|(i, _, c)| c.iter().map(move |_| *i)).collect();
    let columns: Vec<&[f64]> = screened.iter().flat_map(|(_, _, c)| c.iter().map(Vec::as_slice)).collect();
    let lasso = Lasso { y, columns };
    let n = lasso.y.len();
    let most = lasso.columns.iter().map(|c| dot(c, &lasso.y).abs()).fold(0.0, f64::max);
    let penalties: Vec<f64> = (0..STEPS).map(|k| most * STEP.powi(k)).collect();
    let folds: Vec<Vec<f64>> = (0..FOLDS)
        .map(|fold| {
            let held = n * fold / FOLDS..n * (fold + 1) / FOLDS;
            let path = lasso.path(&penalties, &|r| !held.contains(&r));
            path.iter()
                .map(|beta| {
                    let mut left = lasso.y[held.clone()].to_vec();
                    for (b, c) in beta.iter().zip(&lasso.columns).filter(|(b, _)| **b != 0.0) {
                        left.iter_mut().zip(&c[held.clone()]).for_each(|(l, c)| *l -= b * c);
                    }
                    dot(&left, &left) / left.len().max(1) as f64
                })
                .collect()
        })
        .collect();
    let mean = |k: usize| folds.iter().map(|f| f[k]).sum::<f64>() / FOLDS as f64;
    let best = (0..penalties.len()).min_by(|a, b| mean(*a).total_cmp(&mean(*b))).unwrap_or(0);
    let spread = folds.iter().map(|f| (f[best] - mean(best)).powi(2)).sum::<f64>() / (FOLDS - 1) as f64;
    let within = mean(best) + (spread / FOLDS as f64).sqrt();
    let chosen = (0..=best).find(|k| mean(*k) <= within).unwrap_or(best);
    let beta = lasso.path(&penalties[..=chosen], &|_| true).pop().unwrap_or_default();
    let mut sizes: std::collections::BTreeMap<&str, Vec<f64>> = std::collections::BTreeMap::new();
    for ((b, c), i) in beta.iter().zip(&lasso.columns).zip(&owner).filter(|((b, _), _)| **b != 0.0) {
        let sum = sizes.entry(candidates[*i].name.as_str()).or_insert_with(|| vec![0.0; n]);
        sum.iter_mut().zip(*c).for_each(|(s, c)| *s += b * c);
    }
    let all: f64 = sizes.values().map(|v| length(v)).sum();
    sizes.iter().filter(|(_, v)| length(v) >= WORTH * all).map(|(n, _)| (*n).to_owned()).collect()
}
