//! Readings in steps of a coarse gauge: rounding an error that runs through many of the steps makes a saw of it, which looks like a wave
//! or a broken line of less than a step, and is neither.

use crate::extent::resolution;
use crate::problem::{Segment, rms};
use crate::search::{Search, Set};
use std::f64::consts::{PI, TAU};

/// Where what is left is a larger share of a step than this, its noise leaves nothing of the saw: rounding by itself leaves 0.29.
const COARSE: f64 = 0.6;
/// So much of what an explanation does, along the saw, makes it the saw.
const MADE: f64 = 0.4;
/// Terms of the saw's series.
const TERMS: i32 = 12;

/// A segment that was read in coarse steps.
struct Coarse<'s> {
    segment: &'s Segment,
    /// The step, µm (of a force N), and the standard deviation of the noise before it was rounded, in steps.
    step: f64,
    noise: f64,
}

/// The segments whose readings are coarse beside what a set leaves of them.
fn coarse<'s>(search: &'s Search<'_, '_>, set: &Set) -> Vec<Coarse<'s>> {
    let stack = search.stack;
    let left = search.residual(set).0;
    let of = |segment: &'s Segment| {
        let step = resolution(&stack.measured[segment.rows.clone()])?;
        let share = rms(&left[segment.rows.clone()]) * stack.sigma[segment.response] / step;
        let noise = (share * share - 1.0 / 12.0).max(0.0).sqrt();
        (share < COARSE).then_some(Coarse { segment, step, noise })
    };
    stack.segments.iter().filter_map(of).collect()
}

/// The members of a set of which what they do is mostly what rounding makes of the others: the mean rounding error of what these predict,
/// with their noise, by its Fourier series.
pub(crate) fn saws(search: &Search<'_, '_>, set: &Set) -> Vec<usize> {
    let coarse = coarse(search, set);
    if coarse.is_empty() {
        return Vec::new();
    }
    let stack = search.stack;
    let is_saw = |member: &usize| {
        let rest = search.residual(&search.without(set, *member)).0;
        let does = search.does(set, *member);
        let mut along = 0.0;
        for Coarse { segment, step, noise } in &coarse {
            let sigma = stack.sigma[segment.response];
            for row in segment.rows.clone() {
                let steps = (stack.measured[row] - rest[row] * sigma) / step;
                along += does[row] * saw(steps, *noise) * step / sigma;
            }
        }
        along > MADE * does.iter().map(|d| d * d).sum::<f64>()
    };
    (0..set.members.len()).filter(is_saw).collect()
}

/// By how much a value is rounded up or down in the mean, in steps: the value too, and its noise.
fn saw(value: f64, noise: f64) -> f64 {
    let term = |k: i32| {
        let k = f64::from(k);
        let fades = (-2.0 * (PI * k * noise).powi(2)).exp();
        fades * (TAU * k * (value - value.round())).sin() / (PI * k)
    };
    (1..=TERMS).map(|k| if k % 2 == 0 { term(k) } else { -term(k) }).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{axis, column, noise, record};
    use crate::{Options, reconcile};
    use rtec_model::machine::Machine;
    use rtec_model::record::Role;

    /// Beside rounding itself, of values without noise and with some.
    #[test]
    fn the_mean_rounding_error_is_a_saw() {
        let dice = noise(3, 20_000);
        for (value, spread) in [(0.2, 0.0), (-0.3, 0.0), (7.4, 0.15), (7.4, 0.3), (2.65, 0.2), (0.1, 0.6)] {
            let off = |n: &f64| (value + spread * n).round() - (value + spread * n);
            let mean = dice.iter().map(off).sum::<f64>() / dice.len() as f64;
            // Twelve terms overshoot by a few per cent of a step.
            assert!(
                (mean - saw(value, spread)).abs() < 0.04,
                "{value} {spread}: {mean} {}",
                saw(value, spread)
            );
        }
    }

    /// A scale and a reversal, read to 1 µm with a tenth of that as noise: of twelve runs all had a screw of 0.2 to 0.5 µm, a map or a
    /// cycle. A wave of 1.5 µm is read as well, and is named.
    #[test]
    fn a_saw_that_rounding_makes_is_no_wave() {
        let mut screws = 0;
        for seed in 0..10_u64 {
            let dice = noise(seed, 400);
            let ppm = 9.0 + 5.1 * seed as f64;
            let wave = if seed % 2 == 0 { 0.0 } else { 1.5 };
            let mut run = record(300, |_| 0.0);
            let p: Vec<f64> = (0..300)
                .map(|i| {
                    let leg = i % 100;
                    let target = f64::from(if leg < 50 { leg } else { 99 - leg });
                    11.3 * target + 2.0 * (1.7 * target).sin()
                })
                .collect();
            for (i, e) in run.columns[2].data.iter_mut().enumerate() {
                let way = if i % 100 < 50 { 0.9 } else { -0.9 };
                let turn = wave * (TAU * p[i] / 37.0 + 0.4).sin();
                *e = (ppm * p[i] / 1000.0 + way + turn + 0.1 * dice[i]).round();
            }
            run.columns[1].data = p;
            let ways = (0..300).map(|i| if i % 100 < 50 { 1.0 } else { -1.0 }).collect();
            run.columns.push(column("dir", Role::Direction(axis()), ways));
            let answer = reconcile(&[run], &[], &Machine::ideal("m"), &Options::default()).unwrap();
            let names: Vec<String> = answer.effects.iter().map(|(f, _)| f.effect.name()).collect();
            let screw = names.iter().any(|n| n == "screw_periodic.x");
            if wave > 0.0 {
                screws += usize::from(screw);
            } else {
                let other = |n: &String| {
                    !(n.starts_with("scale") || n.starts_with("offset") || n.starts_with("reversal"))
                };
                let unexplained = &answer.unexplained;
                assert!(
                    !names.iter().any(other) && unexplained.is_empty(),
                    "{seed}: {names:?} {unexplained:?}"
                );
            }
        }
        assert!(screws >= 4, "{screws} of 5");
    }
}
