//! The last fit: all effects jointly in their own parameters, non-linear ones too, with an interval for each value.

use crate::gram::{Cholesky, Products, Vector};
use crate::problem::{Stack, rms};
use rtec_model::effect::{Effect, Search};

/// Half width of an interval in standard errors: 95 %.
const HALF_WIDTH: f64 = 1.96;

/// An effect in a fit.
#[derive(Debug, Clone)]
pub(crate) struct Term {
    pub(crate) effect: Effect,
    /// Which of its values are fitted.
    pub(crate) free: Vec<bool>,
    /// What the model's file says of its values, and how far that may be trusted: one standard deviation of each.
    pub(crate) prior: Option<(Vec<f64>, Vec<f64>)>,
    /// Half widths of the values' intervals.
    pub(crate) half: Vec<f64>,
}

impl Term {
    /// A term whose values are all free but those chosen beforehand (knots, lobes, the moment of a step).
    pub(crate) fn new(effect: Effect, held: &[usize]) -> Self {
        let width = effect.width();
        let parameters = &effect.description().parameters;
        let free = (0..effect.values().len())
            .map(|v| parameters[v / width].search != Search::Chosen && !held.contains(&v))
            .collect();
        let half = vec![0.0; effect.values().len()];
        Self { effect, free, prior: None, half }
    }

    /// A term that stays as it is.
    pub(crate) fn fixed(effect: Effect) -> Self {
        let n = effect.values().len();
        Self { effect, free: vec![false; n], prior: None, half: vec![0.0; n] }
    }
}

/// Rows that count, for a fit without some of them.
pub(crate) type Keep<'k> = Option<&'k [bool]>;

/// Measured minus the sum of the terms, weighed.
pub(crate) fn residual(stack: &Stack<'_>, terms: &[Term]) -> Vec<f64> {
    let mut r = stack.missing(terms.iter().map(|t| &t.effect));
    stack.weigh(&mut r);
    r
}

/// Gauss–Newton steps under noise of coefficient `phi`, each halved until it helps.
pub(crate) fn fit(stack: &Stack<'_>, terms: &mut [Term], phi: f64, steps: usize, keep: Keep<'_>) {
    for _ in 0..steps {
        let before = cost(stack, terms, phi, keep);
        let Some((places, step, _)) = newton(stack, terms, phi, keep) else { return };
        let start = terms.to_vec();
        let mut share = 1.0;
        let mut gained = 0.0;
        for _ in 0..6 {
            apply(terms, &start, &places, &step, share);
            gained = before - cost(stack, terms, phi, keep);
            if gained > 0.0 {
                break;
            }
            share *= 0.4;
        }
        if gained <= 0.0 {
            terms.clone_from_slice(&start);
            break;
        }
        if gained < 1e-4 {
            break;
        }
    }
    if let Some((places, _, variance)) = newton(stack, terms, phi, keep) {
        let r = residual(stack, terms);
        let noise = Vector::new(r.clone(), &stack.ranges).products(&r, &stack.ranges).at(phi)
            / (stack.n as f64 - places.len() as f64).max(1.0);
        for ((t, v), var) in places.iter().zip(&variance) {
            terms[*t].half[*v] = HALF_WIDTH * (var * noise).sqrt();
        }
    }
    for term in terms {
        tidy(term);
    }
}

fn apply(terms: &mut [Term], start: &[Term], places: &[(usize, usize)], step: &[f64], share: f64) {
    for (t, term) in terms.iter_mut().enumerate() {
        let mut values = start[t].effect.values().to_vec();
        for ((_, v), s) in places.iter().zip(step).filter(|((at, _), _)| *at == t) {
            let change = share * s;
            let parameter = &term.effect.description().parameters[v / term.effect.width()];
            // A length, time or period moves by no more than half of itself at once.
            let positive = parameter.bounds[0] > 0.0 || parameter.plausible[0] > 0.0;
            values[*v] += if positive { change.clamp(-0.5 * values[*v], 0.5 * values[*v]) } else { change };
        }
        let mut effect = start[t].effect.clone();
        // Values outside the law's bounds stay where they were.
        let _kept = effect.set_values(&values);
        term.effect = effect;
    }
}

fn cost(stack: &Stack<'_>, terms: &[Term], phi: f64, keep: Keep<'_>) -> f64 {
    let mut r = residual(stack, terms);
    mask(&mut r, keep);
    let mut sum = Vector::new(r.clone(), &stack.ranges).products(&r, &stack.ranges).at(phi);
    for t in terms {
        if let Some((values, sd)) = &t.prior {
            for ((a, b), s) in t.effect.values().iter().zip(values).zip(sd) {
                if *s > 0.0 {
                    sum += ((a - b) / s).powi(2);
                }
            }
        }
    }
    sum
}

fn mask(x: &mut [f64], keep: Keep<'_>) {
    if let Some(keep) = keep {
        x.iter_mut().zip(keep).for_each(|(x, k)| *x *= f64::from(u8::from(*k)));
    }
}

/// One step: which values it moves, by how much, and the variance of each in units of the noise.
type Step = (Vec<(usize, usize)>, Vec<f64>, Vec<f64>);

fn newton(stack: &Stack<'_>, terms: &[Term], phi: f64, keep: Keep<'_>) -> Option<Step> {
    let free = Free::of(stack, terms, keep)?;
    let mut r = residual(stack, terms);
    mask(&mut r, keep);
    let mut normal = Normal::of(stack, &free, &r, phi);
    normal.pull_to_priors(terms, &free);
    normal.keep_maps_level(terms, &free, stack.n);
    let Normal { k, a, mut g } = normal;
    let factor = Cholesky::new(&a, k);
    let variance = factor.inverse_diagonal().iter().zip(&free.scale).map(|(v, s)| v / (s * s)).collect();
    factor.forward(&mut g);
    factor.backward(&mut g);
    let step = g.iter().zip(&free.scale).map(|(g, s)| g / s).collect();
    Some((free.places, step, variance))
}

/// The values that a step may move.
struct Free {
    /// Term and value.
    places: Vec<(usize, usize)>,
    /// Slopes, weighed, of unit size.
    columns: Vec<Vector>,
    /// What they were divided by.
    scale: Vec<f64>,
}

impl Free {
    /// None where the rows show no free value.
    fn of(stack: &Stack<'_>, terms: &[Term], keep: Keep<'_>) -> Option<Self> {
        let mut free = Self { places: Vec::new(), columns: Vec::new(), scale: Vec::new() };
        for (t, term) in terms.iter().enumerate() {
            if !term.free.iter().any(|f| *f) {
                continue;
            }
            for (v, mut column) in stack.slopes(&term.effect).into_iter().enumerate() {
                stack.weigh(&mut column);
                mask(&mut column, keep);
                let size = rms(&column);
                if term.free[v] && size > 1e-12 {
                    for c in &mut column {
                        *c /= size;
                    }
                    free.places.push((t, v));
                    free.scale.push(size);
                    free.columns.push(Vector::new(column, &stack.ranges));
                }
            }
        }
        (!free.places.is_empty()).then_some(free)
    }
}

/// The normal equations of a step.
struct Normal {
    k: usize,
    a: Vec<f64>,
    g: Vec<f64>,
}

impl Normal {
    fn of(stack: &Stack<'_>, free: &Free, r: &[f64], phi: f64) -> Self {
        let k = free.columns.len();
        let mut a = vec![0.0; k * k];
        for i in 0..k {
            for j in 0..=i {
                let p: Products = free.columns[i].products(&free.columns[j].data, &stack.ranges);
                a[i * k + j] = p.at(phi);
                a[j * k + i] = a[i * k + j];
            }
        }
        let g = free.columns.iter().map(|c| c.products(r, &stack.ranges).at(phi)).collect();
        Self { k, a, g }
    }

    /// What the file says of a value counts as one more observation of it.
    fn pull_to_priors(&mut self, terms: &[Term], free: &Free) {
        for (i, (t, v)) in free.places.iter().enumerate() {
            let diagonal = &mut self.a[i * self.k + i];
            if let Some((values, sd)) = &terms[*t].prior {
                let w = (1.0 / (sd[*v] * free.scale[i])).powi(2);
                *diagonal += w;
                self.g[i] += w * (values[*v] - terms[*t].effect.values()[*v]) * free.scale[i];
            }
            // A trace of a pull to where it is keeps what the data do not show where it is.
            *diagonal *= 1.0 + 1e-9;
        }
    }

    /// What offset and scale are for stays out of a map's heights: none of it in a new map, no change of it in a known
    /// one.
    fn keep_maps_level(&mut self, terms: &[Term], free: &Free, rows: usize) {
        for (t, term) in terms.iter().enumerate() {
            let Some(heights) = term.effect.description().place(Search::Linear) else { continue };
            let width = term.effect.width();
            let from = |v: usize| term.prior.as_ref().map_or(0.0, |(values, _)| values[v]);
            for weights in term.effect.constraints() {
                let own: Vec<(usize, f64)> = free
                    .places
                    .iter()
                    .enumerate()
                    .filter(|(_, (at, v))| *at == t && v / width == heights)
                    .map(|(i, (_, v))| (i, weights[v % width] / free.scale[i]))
                    .collect();
                let largest = own.iter().map(|(_, w)| w.abs()).fold(1e-300, f64::max);
                let pull = 1e3 * rows as f64 / (largest * largest);
                let values = weights.iter().zip(term.effect.get(heights)).enumerate();
                let now: f64 = values.map(|(k, (w, u))| w * (u - from(heights * width + k))).sum();
                for (i, wi) in &own {
                    for (j, wj) in &own {
                        self.a[i * self.k + j] += pull * wi * wj;
                    }
                    self.g[*i] -= pull * wi * now;
                }
            }
        }
    }
}

/// Amplitudes above zero, phases and angles within one turn.
fn tidy(term: &mut Term) {
    use std::f64::consts::{PI, TAU};
    let law = term.effect.description();
    let mut values = term.effect.values().to_vec();
    if let (Some(amplitude), Some(phase)) = (law.place(Search::Amplitude), law.place(Search::Phase)) {
        if values[amplitude] < 0.0 {
            values[amplitude] = -values[amplitude];
            values[phase] += PI;
        }
        values[phase] = (values[phase] + PI).rem_euclid(TAU) - PI;
    }
    for (value, _) in values.iter_mut().zip(&law.parameters).filter(|(_, p)| p.cyclic) {
        *value = value.rem_euclid(TAU);
    }
    // Only a change that means the same is made: it cannot leave the bounds.
    let _same = term.effect.set_values(&values);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{noise, record};
    use rtec_model::effect::Dictionary;
    use rtec_model::record::Record;
    use std::f64::consts::PI;

    /// A wave of 12.5 mm on a record of noise.
    fn run() -> Record {
        let dice = noise(11, 200);
        let mut run = record(200, |i| 0.2 * dice[i as usize]);
        let p = run.columns[1].data.clone();
        for (e, p) in run.columns[2].data.iter_mut().zip(&p) {
            *e += 3.0 * (2.0 * PI * p / 12.5 + 0.4).sin();
        }
        run
    }

    fn wave(values: &[f64]) -> Effect {
        let mut effect = Dictionary::default().effect("screw_periodic.x").unwrap();
        effect.set_values(values).unwrap();
        effect
    }

    #[test]
    fn all_parameters_move_to_where_the_data_are_with_an_interval_each() {
        let records = [run()];
        let stack = Stack::new(&records);
        let mut terms = vec![Term::new(wave(&[12.45, 2.0, 0.0]), &[])];
        fit(&stack, &mut terms, 0.0, 12, None);
        for ((got, want), half) in terms[0].effect.values().iter().zip([12.5, 3.0, 0.4]).zip(&terms[0].half) {
            assert!((got - want).abs() < 2.0 * half && *half < 0.1 * want, "{got} ± {half}, not {want}");
        }
    }

    #[test]
    fn a_value_that_is_trusted_stays_and_a_held_one_does_not_move() {
        let records = [run()];
        let stack = Stack::new(&records);
        let start = [12.5, 2.0, 0.4];
        let mut trusted = Term::new(wave(&start), &[0, 2]);
        trusted.prior = Some((start.to_vec(), vec![0.0, 1e-6, 0.0]));
        let mut terms = vec![trusted];
        fit(&stack, &mut terms, 0.0, 12, None);
        assert!((terms[0].effect.scalar(1) - 2.0).abs() < 1e-6);
        let held = [terms[0].effect.scalar(0) - 12.5, terms[0].effect.scalar(2) - 0.4];
        assert!(held.iter().all(|d| d.abs() < 1e-12), "{held:?}");
    }

    #[test]
    fn an_amplitude_below_zero_is_another_phase() {
        let mut term = Term::fixed(wave(&[12.5, -2.0, 3.0]));
        tidy(&mut term);
        assert!((term.effect.scalar(1) - 2.0).abs() < 1e-12);
        assert!((term.effect.scalar(2) - (3.0 - PI)).abs() < 1e-12);
    }
}
