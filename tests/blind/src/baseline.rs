//! What an able analyst's afternoon gives: forward selection over the same dictionary by the Bayesian information
//! criterion, ordinary least squares, the model's own parameters fitted along.

use rtec_model::effect::{Dictionary, Effect};
use rtec_model::machine::Machine;
use rtec_model::record::{Record, Role};

/// Orthonormal columns of what is in the fit already.
#[derive(Default)]
struct Basis(Vec<Vec<f64>>);

impl Basis {
    /// What the basis leaves of a column.
    fn rest(&self, column: &[f64]) -> Vec<f64> {
        let mut c = column.to_vec();
        for q in &self.0 {
            let d: f64 = q.iter().zip(&c).map(|(a, b)| a * b).sum();
            c.iter_mut().zip(q).for_each(|(c, q)| *c -= d * q);
        }
        c
    }

    fn add(&mut self, column: &[f64]) -> bool {
        let before = length(column);
        let mut c = self.rest(column);
        c = self.rest(&c);
        let l = length(&c);
        if l <= 1e-6 * before || l == 0.0 {
            return false;
        }
        c.iter_mut().for_each(|x| *x /= l);
        self.0.push(c);
        true
    }
}

fn length(x: &[f64]) -> f64 {
    x.iter().map(|v| v * v).sum::<f64>().sqrt()
}

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
    match effect.card().name.as_str() {
        "thermal_lag" | "warm_up" => {
            (0..10).filter_map(|i| set(&[("tau_s", (t1 - t0) * 0.01 * 1.65_f64.powi(i))])).collect()
        }
        "reversal_spike" => {
            let (lo, hi) = places(0);
            (0..8).filter_map(|i| set(&[("length_mm", (hi - lo) * 0.3 * 0.6_f64.powi(i))])).collect()
        }
        "lost_counts" => {
            (1..80).filter_map(|i| set(&[("at_s", t0 + (t1 - t0) * f64::from(i) / 80.0)])).collect()
        }
        "probe_lobing" => (2..=9).filter_map(|i| set(&[("lobes", f64::from(i))])).collect(),
        "form_bump" => (0..24)
            .flat_map(|i| [0.3, 0.6, 1.2, 2.0].map(|w| (f64::from(i) * 0.262, w)))
            .filter_map(|(c, w)| set(&[("centre_rad", c), ("width_rad", w)]))
            .collect(),
        "screw_periodic" => {
            (0..500).filter_map(|i| set(&[("period_mm", 0.5 * 120f64.powf(f64::from(i) / 499.0))])).collect()
        }
        "subdivision" => {
            (0..800).filter_map(|i| set(&[("period_um", 200f64.powf(f64::from(i) / 799.0))])).collect()
        }
        "position_map" | "straightness" => {
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

/// Names it would add.
#[must_use]
pub fn forward_bic(records: &[Record], machine: &Machine) -> Vec<String> {
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
    let mut candidates: Vec<(String, Vec<Vec<f64>>)> = Vec::new();
    for e in Dictionary::default().candidates(&all) {
        let name = e.name();
        candidates.extend(grid(records, &e).iter().map(|g| {
            let mut columns = stacked(records, g, false);
            // The quadratic term of a temperature law is the analyst's second thought.
            if ["thermal_growth", "thermal_lag"].contains(&g.card().name.as_str()) {
                columns.truncate(1);
            }
            (name.clone(), columns)
        }));
    }
    let n = y.len() as f64;
    let mut names: Vec<String> = Vec::new();
    for _ in 0..6 {
        let r = basis.rest(&y);
        let rss = r.iter().map(|x| x * x).sum::<f64>();
        let mut best: Option<(f64, usize)> = None;
        for (i, (name, columns)) in candidates.iter().enumerate() {
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
            let gain = n * (rss / left.max(1e-12 * rss)).ln() - own.0.len() as f64 * n.ln();
            if best.is_none_or(|(g, _)| gain > g) {
                best = Some((gain, i));
            }
        }
        match best {
            Some((gain, i)) if gain > 0.0 => {
                names.push(candidates[i].0.clone());
                for column in &candidates[i].1 {
                    basis.add(column);
                }
            }
            _ => break,
        }
    }
    names
}
