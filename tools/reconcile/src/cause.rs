//! What an explanation is: an effect of the dictionary with its non-linear parameters set, or a shape of no name.

use crate::problem::{Stack, leaves_a_line};
use crate::teeth::Teeth;
use rtec_model::effect::{Against, Effect, Need, STANDARD_DEGC};

/// A shape that is in no dictionary.
#[derive(Debug, Clone, PartialEq)]
pub struct Shape {
    /// The response it is seen in.
    pub response: String,
    /// What it runs along: roles, as in `where`.
    pub against: Vec<String>,
    /// In words: smooth, periodic, differs by direction, …
    pub manner: String,
}

impl Shape {
    /// What an effect looks like that is given no name; none where it acts on nothing that was measured.
    pub(crate) fn like(stack: &Stack<'_>, effect: &Effect, manner: String) -> Option<Self> {
        let acts = stack.records.iter().find_map(|r| effect.acts_on(r).into_iter().next())?;
        let role = |n: &Need| match n {
            Need::Delta => effect.delta.as_ref().map(|d| format!("temperature.{}", d.sensor)),
            Need::Channel => effect.channel().map(|c| format!("channel.{c}")),
            other => Some(other.role(effect.axes()).to_string()),
        };
        let mut against: Vec<String> = effect.description().needs.iter().filter_map(role).collect();
        if against.is_empty() {
            against.push("time".to_owned());
        }
        Some(Self { response: acts.0.to_string(), against, manner })
    }
}

/// An explanation.
#[derive(Debug, Clone)]
pub(crate) enum Cause {
    /// An effect with its non-linear parameters set; which coefficients are free, and whether its reference
    /// temperature is.
    Effect { effect: Effect, free: Vec<usize>, reference: bool },
    /// Several effects added up as they are: which of them it is the data do not say.
    Sum(Vec<Effect>),
    /// No effect of the dictionary.
    Shape(Shape),
    /// The same, of a kind whose turns and phase are refined.
    Teeth(Shape, Teeth),
}

impl Cause {
    /// The shape, where it is no effect of the dictionary.
    pub(crate) fn shape(&self) -> Option<&Shape> {
        match self {
            Self::Effect { .. } | Self::Sum(_) => None,
            Self::Shape(s) | Self::Teeth(s, _) => Some(s),
        }
    }

    /// Whether its coefficients are the free directions of a map's heights.
    pub(crate) fn is_map(&self) -> bool {
        matches!(self, Self::Effect { effect, .. } if leaves_a_line(effect))
    }

    /// The effects of a sum, times one number.
    pub(crate) fn parts(&self, by: f64) -> Vec<Effect> {
        let Self::Sum(parts) = self else { return Vec::new() };
        parts.iter().filter_map(|e| e.with(&[(0, by * e.scalar(0))])).collect()
    }

    /// The effect that it stands for in these rows, with these coefficients; none for a shape.
    pub(crate) fn effect(&self, stack: &Stack<'_>, gamma: &[f64]) -> Option<Effect> {
        let Self::Effect { effect, free, reference } = self else { return None };
        let mut effect = effect.clone();
        let k = effect.coefficient_count();
        let directions = stack.directions(&effect);
        let mut coefficients = vec![0.0; k];
        for (g, i) in gamma.iter().zip(free) {
            if directions.is_empty() {
                coefficients[*i] = *g;
            } else {
                coefficients.iter_mut().zip(&directions[*i]).for_each(|(c, d)| *c += g * d);
            }
        }
        if *reference {
            refer(&mut effect, &mut coefficients, gamma[free.len()]);
        }
        effect.set_coefficients(&coefficients);
        Some(effect)
    }
}

/// Turns a constant beside a law of ΔT into a reference temperature: c₂x² + c₁x + c₀ = c₂(x − d)² + b(x − d).
fn refer(effect: &mut Effect, c: &mut [f64], c0: f64) {
    let c1 = c[0];
    let c2 = c.get(1).copied().unwrap_or(0.0);
    let straight = -c0 / c1;
    let d = if c2 == 0.0 {
        straight
    } else {
        let inside = c1 * c1 - 4.0 * c2 * c0;
        let near = (-c1 + c1.signum() * inside.max(0.0).sqrt()) / (2.0 * c2);
        if inside >= 0.0 && near.is_finite() { near } else { straight }
    };
    if !d.is_finite() {
        return;
    }
    c[0] = c1 + 2.0 * c2 * d;
    if let Some(delta) = &mut effect.delta {
        delta.against = Against::Reference(STANDARD_DEGC + d);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rtec_model::effect::{Dictionary, Difference};

    /// Growth of ΔT from 20 °C beside a constant is growth from another temperature.
    #[test]
    fn a_constant_beside_growth_is_another_reference() {
        let records = [crate::testing::record(9, |i| i)];
        let stack = Stack::new(&records);
        let mut effect = Dictionary::default().effect("thermal_growth.x").unwrap();
        effect.delta = Some(Difference::single("T1"));
        for (free, gamma) in [(vec![0], vec![2.0, -6.0]), (vec![0, 1], vec![2.0, 0.1, -6.0])] {
            let cause = Cause::Effect { effect: effect.clone(), free, reference: true };
            let both = cause.effect(&stack, &gamma).unwrap();
            let Some(Difference { against: Against::Reference(degc), .. }) = both.delta else {
                panic!("no reference")
            };
            let (a, b) = (both.scalar(0), both.scalar(1));
            for t in [0.0, 3.0, 8.0] {
                let d = STANDARD_DEGC + t - degc;
                let want = gamma[0] * t
                    + if gamma.len() > 2 { gamma[1] * t * t } else { 0.0 }
                    + gamma[gamma.len() - 1];
                assert!((a * d + b * d * d - want).abs() < 1e-9, "at {t} K");
            }
        }
    }

    #[test]
    fn a_shape_stands_for_no_effect() {
        let shape =
            Shape { response: "error.x".into(), against: vec!["time".into()], manner: "smooth".into() };
        let cause = Cause::Shape(shape.clone());
        let records = [crate::testing::record(9, |i| i)];
        assert_eq!((cause.shape(), cause.effect(&Stack::new(&records), &[1.0])), (Some(&shape), None));
    }
}
