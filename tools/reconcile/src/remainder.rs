//! Names beside what stays unexplained: a law that bends finds something to do in any structure. It is named where it closes a
//! fair share of the gap; what is a part of an unknown shape is no name.

use crate::answer::{Answer, Finding};
use crate::cause::Shape;
use crate::fit::{self, Term};
use crate::gap::Gap;
use crate::problem::Stack;
use rtec_model::effect::{Effect, Need, Quantity, Search};

/// What names leave is structure where it is so many times what the data repeat to; beside a shape, so many.
const STRUCTURE: f64 = 2.0;
const STRUCTURE_BESIDE: f64 = 1.5;
/// Share of a gap's square that a law which bends closes beside structure, or it is a part of that; a law of one size closes so
/// much.
const BENDING: f64 = 1.0 / 3.0;
const PLAIN: f64 = 0.05;
/// So many times the floor is said, whatever was named.
const SAID: f64 = 2.5;

/// How much of the square of what is missing a fit leaves, in the responses that an effect acts on.
struct Left<'s, 'r> {
    stack: &'s Stack<'r>,
    responses: Vec<usize>,
}

impl<'s, 'r> Left<'s, 'r> {
    fn of(stack: &'s Stack<'r>, effect: &Effect) -> Self {
        let does = stack.predict([effect]);
        let acts = |j: &usize| does[stack.rows(*j)].iter().any(|d| *d != 0.0);
        Self { stack, responses: (0..stack.responses.len()).filter(acts).collect() }
    }

    fn square(&self, terms: &[Term]) -> f64 {
        let left = fit::residual(self.stack, terms);
        let (mut sum, mut n) = (0.0, 0.0);
        for j in &self.responses {
            let rows = &left[self.stack.rows(*j)];
            sum += rows.iter().map(|r| r * r).sum::<f64>() * self.stack.sigma[*j].powi(2);
            n += rows.len() as f64;
        }
        sum / f64::max(n, 1.0)
    }
}

/// Whether it bends to much that is not it: by its knots, by values that it is not linear in, by the choice of its sensors.
fn bends(effect: &Effect) -> bool {
    let parameters = &effect.description().parameters;
    effect.delta.is_some() || effect.width() > 1 || parameters.iter().any(|p| p.search != Search::Linear)
}

/// Whether an effect reads the angle and nothing else.
fn over_angle(effect: &Effect) -> bool {
    matches!(effect.description().needs[..], [Need::Angle])
}

/// Whether far more is left than what the data repeat to.
fn structured(gap: &[Gap], beside: bool) -> bool {
    let times = if beside { STRUCTURE_BESIDE } else { STRUCTURE };
    gap.iter().any(|g| g.train[1] > times * g.floor)
}

/// The findings of an answer that are parts of what stays unexplained: all of a kind at once, or that which closes least. `terms`
/// fits the answer's findings; it may change them and has them back as they were.
pub(crate) fn part_of_the_unknown(
    stack: &Stack<'_>,
    answer: &mut Answer,
    gap: &[Gap],
    shapes: &[Shape],
    mut terms: impl FnMut(&mut Answer) -> Vec<Term>,
) -> Vec<usize> {
    // Every curve over the angle is a sum of lobes, and nearly one of bumps.
    if shapes.iter().any(|s| s.against == ["angle"]) {
        let all = answer.findings.iter().enumerate().filter(|(_, f)| over_angle(&f.effect));
        let all: Vec<usize> = all.map(|(i, _)| i).collect();
        if !all.is_empty() {
            return all;
        }
    }
    // What was chosen for what it predicts leaves much of what fits.
    let predicts = answer.findings.iter().any(Finding::is_part);
    if predicts || !structured(gap, !shapes.is_empty()) {
        return Vec::new();
    }
    let all = answer.findings.clone();
    let mut with = |answer: &mut Answer, keep: &dyn Fn(usize) -> bool| {
        answer.findings = all.iter().enumerate().filter(|(i, _)| keep(*i)).map(|(_, f)| f.clone()).collect();
        terms(answer)
    };
    let (whole, none) = (with(answer, &|_| true), with(answer, &|_| false));
    let mut least: Option<(f64, usize)> = None;
    for (i, f) in all.iter().enumerate() {
        let left = Left::of(stack, &f.effect);
        let force = f.effect.description().quantity == Quantity::Force;
        let Some(g) = gap.iter().find(|g| (g.unit == "N") == force) else { continue };
        let open = |before: f64| (before - g.floor * g.floor).max(f64::MIN_POSITIVE);
        let (before, after) = (left.square(&none), left.square(&whole));
        let (alone, without) = (with(answer, &|k| k == i), with(answer, &|k| k != i));
        let mut closed = (before - left.square(&alone)).min(left.square(&without) - after) / open(before);
        if let Some([before, after]) = g.blocked.filter(|_| bends(&f.effect)) {
            // What predicts no rows beside those that it was learned from closes nothing.
            closed = closed.min((before * before - after * after) / open(before * before));
        }
        let needed = if bends(&f.effect) { BENDING } else { PLAIN };
        if closed < needed && least.is_none_or(|l| closed / needed < l.0) {
            least = Some((closed / needed, i));
        }
    }
    answer.findings = all;
    least.into_iter().map(|l| l.1).collect()
}

/// What names leave where it is far more than what the data repeat to: in words, of the first such gap.
pub(crate) fn too_much(gap: &[Gap]) -> Option<(usize, String)> {
    let at = gap.iter().position(|g| g.train[1] > SAID * g.floor)?;
    let times = gap[at].train[1] / gap[at].floor.max(f64::MIN_POSITIVE);
    let times = if times < 1e4 { format!("{times:.1}") } else { "over 10000".to_owned() };
    Some((
        at,
        format!("{times} times as large as the noise beside what is named, along nothing in particular"),
    ))
}

/// What was a part of an unknown shape, as the shape.
pub(crate) fn shape_of(stack: &Stack<'_>, effect: &Effect) -> Option<Shape> {
    Shape::like(stack, effect, format!("in part as {} is", effect.name()))
}
