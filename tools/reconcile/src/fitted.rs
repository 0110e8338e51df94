//! All effects after the last fit: which of them keep their place, what moved beyond chance, the curve that stands for what has
//! no name.

use crate::answer::{Answer, Finding};
use crate::cause::Shape;
use crate::fit::{self, Term, Way};
use crate::problem::{Stack, known, rms};
use crate::unexplained;
use crate::verdict::Refined;
use rtec_model::effect::{Effect, Search};
use rtec_model::machine::Machine;
use rtec_model::record::Record;

/// How far a value must move from the model's, in standard errors: about one in ten thousand by chance.
const BEYOND_CHANCE: f64 = 3.9;
/// The same of an effect's values together, nats: half the square of that, and so much more for each value but one.
const TOGETHER: f64 = 7.6;
const EACH_VALUE: f64 = 1.5;
/// A finding without which less than so much less is explained is none where its interval holds zero, nats.
const NEEDED: f64 = 4.0;
/// A value that was left out does no more than this share of what its effect does: one standard deviation.
const LEFT_OUT: f64 = 0.4;
/// Steps of the last fit, and of one curve of several that stand for a shape.
const STEPS: usize = 12;
const CURVE_STEPS: usize = 6;

/// All effects after the last fit.
pub(crate) struct Fitted {
    /// The model's own, then what was found, then maybe a curve.
    pub(crate) terms: Vec<Term>,
    file: Vec<Effect>,
    /// Which of the model's own moved beyond chance.
    moved: Vec<bool>,
    found: usize,
    /// What is there, and of a size that the rows do not tell: it has no name.
    pub(crate) sizeless: Vec<Shape>,
}

impl Fitted {
    /// Fits the model's effects and the findings jointly, then once more without those of the model's that did not move
    /// beyond chance: they stay as the file has them. A finding whose interval then holds zero is none: where as little is
    /// left without it, nothing is there; otherwise something is, but not this effect of this size.
    pub(crate) fn of(stack: &Stack<'_>, machine: &Machine, answer: &mut Answer) -> Self {
        take_in(answer);
        let mut fitted = Self::once(stack, machine, answer);
        let mut sizeless = Vec::new();
        // Of those that are left the sizes may hang on what is gone: they are looked at again.
        while let Some(fewer) = Self::without_doubtful(stack, machine, answer, &fitted, &mut sizeless) {
            fitted = fewer;
        }
        fitted.sizeless = sizeless;
        fitted
    }

    /// The fit without the last of the findings whose interval holds zero, or with fewer of its values; none where there is no such.
    fn without_doubtful(
        stack: &Stack<'_>,
        machine: &Machine,
        answer: &mut Answer,
        fitted: &Self,
        sizeless: &mut Vec<Shape>,
    ) -> Option<Self> {
        // One of two that stand for each other is certain once the other is gone.
        for place in (0..fitted.found).rev() {
            let Some(doubt) = doubt(&fitted.found()[place]) else { continue };
            let finding = answer.findings.remove(place);
            let without = Self::once(stack, machine, answer);
            let [with, left] = [fitted, &without].map(|f| rms(&fit::residual(stack, &f.terms)).max(1e-12));
            let needed = stack.n as f64 * (left / with).ln() >= NEEDED;
            if needed && doubt == Doubt::OfEach {
                let all = (place, finding.clone());
                if let Some(fewer) = Self::with_fewer_values(stack, machine, answer, all, with) {
                    return Some(fewer);
                }
                if has_other_periods(&finding) {
                    // Which period it has is open, and its size with it: so it is said.
                    answer.findings.insert(place, finding);
                    continue;
                }
            }
            if needed {
                let manner = format!("as {} of a size that is not told", finding.effect.name());
                sizeless.extend(Shape::like(stack, &finding.effect, manner));
            }
            return Some(without);
        }
        None
    }

    /// The fit in which fewer of a finding's values are free and its size is told from zero: one of several sizes stands for all of
    /// them, that which explains most; a wave that is met at two or three places of its period alone has the phase of the smallest
    /// size. None where that explains less than `with`, what all of them leave.
    fn with_fewer_values(
        stack: &Stack<'_>,
        machine: &Machine,
        answer: &mut Answer,
        (place, finding): (usize, Finding),
        with: f64,
    ) -> Option<Self> {
        let mut best: Option<(f64, Finding, Self)> = None;
        for one in fewer_values(&finding) {
            answer.findings.insert(place, one.clone());
            let fewer = Self::once(stack, machine, answer);
            answer.findings.remove(place);
            let left = rms(&fit::residual(stack, &fewer.terms)).max(1e-12);
            let less = stack.n as f64 * (left / with).ln();
            let own = &fewer.found()[place];
            let size = own.effect.description().place(Search::Amplitude).map(|i| own.effect.scalar(i).abs());
            let worth = size.unwrap_or(less);
            let told = self::doubt(own).is_none();
            if told && less < NEEDED && best.as_ref().is_none_or(|b| worth < b.0) {
                best = Some((worth, one, fewer));
            }
        }
        let (_, one, fewer) = best?;
        answer.findings.insert(place, one);
        Some(fewer)
    }

    fn once(stack: &Stack<'_>, machine: &Machine, answer: &Answer) -> Self {
        let file: Vec<Effect> = machine.effects().cloned().collect();
        let mut terms = present(stack, answer);
        terms.extend(answer.findings.iter().map(|f| Term::new(stack, f.effect.clone(), &f.held)));
        fit::fit(stack, &mut terms, answer.phi, STEPS, None);
        let mut moved: Vec<bool> = file.iter().zip(&terms).map(|(f, t)| beyond_chance(f, t)).collect();
        let terms = settled(stack, &file, &terms, &mut moved, answer.phi);
        let mut fitted = Self { terms, file, moved, found: answer.findings.len(), sizeless: Vec::new() };
        fitted.widen(stack, answer);
        fitted
    }

    /// A value that was left out is no estimate of nothing: how large it may be, and how far the others are off for it,
    /// a fit with it shows. It is the lesser part of its effect, or it would have been found. Nor is a map straight between
    /// its knots: it has as many as the rows call for, and what it does beside them is in the others' values.
    fn widen(&mut self, stack: &Stack<'_>, answer: &Answer) {
        let mut whole = self.terms.clone();
        let (mut widened, mut finer, mut parts) = (false, Vec::new(), Vec::new());
        for (i, f) in answer.findings.iter().enumerate() {
            let at = self.file.len() + i;
            if !f.held.is_empty() && whole[at].ways.is_empty() {
                parts.push(at);
            } else if !f.held.is_empty() {
                whole[at] = Term::with_left_out(stack, &whole[at].effect, &f.held, LEFT_OUT);
                widened = true;
            } else if let Some(map) = Term::finer(stack, &whole[at].effect, LEFT_OUT) {
                whole[at] = map;
                finer.push(at);
            }
        }
        let all = self.file.len()..self.file.len() + self.found;
        if widened || !finer.is_empty() {
            self.widen_to(stack, whole, answer.phi, all.filter(|at| !finer.contains(at)));
        }
        // Of the parts of a sum each may be nothing, or twice itself; the sum is what it is, and so is what stands beside it.
        if !parts.is_empty() {
            let mut open = self.terms.clone();
            for at in &parts {
                let held: Vec<usize> = (0..open[*at].effect.values().len()).collect();
                open[*at] = Term::with_left_out(stack, &open[*at].effect, &held, 1.0);
            }
            self.widen_to(stack, open, answer.phi, parts.into_iter());
        }
    }

    /// Intervals of these that hold what a fit with more freedom shows of them.
    fn widen_to(
        &mut self,
        stack: &Stack<'_>,
        mut whole: Vec<Term>,
        phi: f64,
        of: impl Iterator<Item = usize>,
    ) {
        fit::fit(stack, &mut whole, phi, STEPS, None);
        for at in of {
            let (own, other) = (&mut self.terms[at], &whole[at]);
            let values = own.effect.values().iter().zip(other.effect.values()).zip(&other.half);
            for (half, ((a, b), h)) in own.half.iter_mut().zip(values) {
                *half = half.max(reach((a - b).abs(), *h));
            }
        }
    }

    /// What was found.
    pub(crate) fn found(&self) -> &[Term] {
        &self.terms[self.file.len()..self.file.len() + self.found]
    }

    /// The curve that stands for what has no name.
    pub(crate) fn curve(&self) -> Option<&Term> {
        self.terms.get(self.file.len() + self.found)
    }

    /// Writes what moved beyond chance into the model.
    pub(crate) fn correct(&self, model: &mut Machine) -> Vec<Refined> {
        let mut refined = Vec::new();
        for (place, before) in self.file.iter().enumerate().filter(|(e, _)| self.moved[*e]) {
            let (after, half) = (&self.terms[place].effect, &self.terms[place].half);
            write_values(model, place, after, half);
            refined.push(Refined { place, before: before.clone(), after: (after.clone(), half.clone()) });
        }
        refined
    }

    /// Adds the curve that stands for a shape to the terms, with as many knots as the data pay for. The laws that the
    /// model names then.
    pub(crate) fn stand_in(
        &mut self,
        stack: &Stack<'_>,
        shape: &Shape,
        train: &[Record],
        model: &mut Machine,
        phi: f64,
    ) -> Option<String> {
        let mut best: Option<(f64, Machine, Vec<Term>, String)> = None;
        for knots in [5, 9, 17, 33] {
            let (mut machine, mut all) = (model.clone(), self.terms.clone());
            let Some(curve) = unexplained::stand_in(shape, knots, train, &mut machine) else { continue };
            all.push(Term::new(stack, curve.effect, &[]));
            fit::fit(stack, &mut all, phi, CURVE_STEPS, None);
            let n = stack.n as f64;
            let score = n * rms(&fit::residual(stack, &all)).max(1e-12).ln() + 0.5 * knots as f64 * n.ln();
            if best.as_ref().is_none_or(|b| score < b.0) {
                best = Some((score, machine, all, curve.laws));
            }
        }
        let (_, machine, all, laws) = best?;
        (*model, self.terms) = (machine, all);
        Some(laws)
    }
}

/// The fit with those of the model's own effects as the file has them that did not move beyond chance. Values that stand for one
/// another (a slope and its bend over few kelvins) may each be anywhere and both be wrong: they moved where they explain too much
/// together.
fn settled(stack: &Stack<'_>, file: &[Effect], free: &[Term], moved: &mut [bool], phi: f64) -> Vec<Term> {
    let with = |moved: &[bool]| {
        let mut terms = free.to_vec();
        for ((term, effect), _) in terms.iter_mut().zip(file).zip(moved).filter(|(_, moved)| !**moved) {
            *term = Term::fixed(effect.clone());
        }
        fit::fit(stack, &mut terms, phi, STEPS, None);
        terms
    };
    let left = |terms: &[Term]| stack.n as f64 / 2.0 * fit::left(stack, terms, phi).max(1e-300).ln();
    let several = |e: usize| free[e].ways.len() > 1;
    let mut terms = with(moved);
    let (least, mut now) = (left(free), left(&terms));
    while now - least > TOGETHER && (0..file.len()).any(|e| !moved[e] && several(e)) {
        let mut best: Option<(f64, usize, Vec<Term>)> = None;
        for e in (0..file.len()).filter(|e| several(*e)) {
            if std::mem::replace(&mut moved[e], true) {
                continue;
            }
            let terms = with(moved);
            moved[e] = false;
            let gain = now - left(&terms) - EACH_VALUE * (free[e].ways.len() - 1) as f64;
            if gain > best.as_ref().map_or(TOGETHER, |b| b.0) {
                best = Some((gain, e, terms));
            }
        }
        let Some((_, e, better)) = best else { break };
        moved[e] = true;
        (now, terms) = (left(&better), better);
    }
    terms
}

/// A finding that is one of the model's own effects, farther off than its value was trusted to be, is a correction to that one:
/// the fit begins there, and no second one of the same name is fitted beside it.
fn take_in(answer: &mut Answer) {
    let Answer { findings, present, anchor, .. } = answer;
    findings.retain(|f| {
        let law = f.effect.description();
        let linear = law.parameters.iter().all(|p| p.search == Search::Linear && !p.array);
        let own = present.iter().position(|e| linear && e.identity() == f.effect.identity());
        let Some(own) = own else { return true };
        let moved = |e: &Effect| {
            let values: Vec<f64> = e.values().iter().zip(f.effect.values()).map(|(a, b)| a + b).collect();
            let mut moved = e.clone();
            moved.set_values(&values).is_ok().then_some(moved)
        };
        // Out of the law's bounds it is no correction.
        let Some((now, held)) = moved(&present[own]).zip(moved(&anchor[own])) else { return true };
        (present[own], anchor[own]) = (now, held);
        false
    });
}

/// Half width of an interval about a value that holds 95 % where the truth is so far from it, give or take an interval's half
/// width: of what is far off one side alone counts.
fn reach(off: f64, half: f64) -> f64 {
    off.hypot(half).max(off + ONE_SIDED * half)
}

/// What 95 % are above, as a share of the half width that holds 95 %.
const ONE_SIDED: f64 = 0.84;

/// Phases that a wave is tried at, over half a turn: the other half has the size's other sign.
const PHASES: usize = 16;

/// A finding with fewer of its values free: each of its sizes alone, or a wave of one phase.
fn fewer_values(finding: &Finding) -> Vec<Finding> {
    let law = finding.effect.description();
    let held = |set: &[(usize, f64)]| {
        let effect = finding.effect.with(set)?;
        Some(Finding { effect, held: set.iter().map(|(i, _)| *i).collect(), ..finding.clone() })
    };
    if let Some(phase) = law.place(Search::Phase) {
        let turn = |k: usize| std::f64::consts::PI * (k as f64 / PHASES as f64 - 0.5);
        return (0..PHASES).filter_map(|k| held(&[(phase, turn(k))])).collect();
    }
    let linear = |i: &usize| law.parameters[*i].search == Search::Linear && !law.parameters[*i].array;
    let sizes: Vec<usize> = (0..law.parameters.len()).filter(linear).collect();
    let alone = |i: &usize| {
        let none: Vec<(usize, f64)> = sizes.iter().filter(|o| *o != i).map(|o| (*o, 0.0)).collect();
        held(&none)
    };
    if sizes.len() > 1 { sizes.iter().filter_map(alone).collect() } else { Vec::new() }
}

/// Whether it is a wave that looks the same at other periods.
fn has_other_periods(finding: &Finding) -> bool {
    finding.rivals.iter().any(|r| r.differs.is_some())
}

/// Why an effect may be nothing.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Doubt {
    /// The interval of its one size holds zero.
    OfAll,
    /// The interval of each of its sizes holds zero: together they may be certain.
    OfEach,
}

/// Whether the intervals of an effect's size hold zero.
fn doubt(term: &Term) -> Option<Doubt> {
    let law = term.effect.description();
    let kind = [Search::Linear, Search::Amplitude].into_iter().find(|s| law.place(*s).is_some())?;
    // The parts of a sum are as uncertain as the choice among them.
    if term.effect.width() > 1 || term.ways.is_empty() {
        return None;
    }
    let sizes = (0..law.parameters.len()).filter(|i| law.parameters[*i].search == kind);
    let free: Vec<usize> = sizes.filter(|i| term.half[*i] > 0.0).collect();
    let zero = |i: &usize| term.effect.scalar(*i).abs() < term.half[*i];
    // A wave's amplitude and phase are one size: at two places to a period neither is told alone, and the wave is there.
    let all = if free.len() == 1 && kind == Search::Linear { Doubt::OfAll } else { Doubt::OfEach };
    (!free.is_empty() && free.iter().all(zero)).then_some(all)
}

/// The model's own effects as terms, each held to the file's values as far as they are trusted.
fn present(stack: &Stack<'_>, answer: &Answer) -> Vec<Term> {
    let mut ways: Vec<Vec<Way>> = answer.present.iter().map(|_| Vec::new()).collect();
    for k in known(stack, 1.0, &answer.anchor, &answer.present) {
        if let Some(e) = k.effect {
            ways[e].push(Way { along: k.along, sd: k.sd });
        }
    }
    let of =
        |((effect, anchor), ways): ((&Effect, &Effect), Vec<Way>)| Term::given(effect.clone(), anchor, ways);
    answer.present.iter().zip(&answer.anchor).zip(ways).map(of).collect()
}

/// Whether a fit has moved a value of the model's effect so far from the file's.
fn beyond_chance(file: &Effect, term: &Term) -> bool {
    file.values().iter().zip(term.effect.values()).zip(&term.half).any(|((a, b), half)| {
        *half > 0.0 && (a - b).abs() > BEYOND_CHANCE / 1.96 * half && (a - b).abs() > 1e-9 * a.abs()
    })
}

fn write_values(model: &mut Machine, place: usize, effect: &Effect, half: &[f64]) {
    let width = effect.width();
    for (i, p) in effect.description().parameters.iter().enumerate() {
        if p.search == Search::Chosen {
            continue;
        }
        let values = effect.get(i);
        let interval: Vec<[f64; 2]> =
            values.iter().zip(&half[i * width..]).map(|(v, h)| [v - h, v + h]).collect();
        // The values come from the law itself; they keep its bounds.
        let _written = model.set(place, &p.name, values, Some(&interval));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::nothing_learned;
    use crate::answer::Finding;
    use crate::testing::{axis, column};
    use rtec_model::effect::Difference;
    use rtec_model::record::{Kind, Record, Role};
    use std::path::Path;

    /// The mean of two explanations by sensors that warm alike: how much of it is of which is open, and the intervals say so.
    #[test]
    fn the_parts_of_a_sum_have_intervals() {
        let warm = |i: usize| 8.0 * (1.0 - (-(i as f64) / 60.0).exp());
        let noise = |i: usize| ((i * 7919 % 101) as f64 - 50.0) / 50.0;
        let of = |f: &dyn Fn(usize) -> f64| (0..200).map(f).collect::<Vec<f64>>();
        let columns = vec![
            column("t", Role::Time, of(&|i| 30.0 * i as f64)),
            column("T1", Role::Temperature, of(&|i| 20.0 + warm(i))),
            column("T2", Role::Temperature, of(&|i| 20.0 + 0.8 * warm(i) + 0.02 * noise(i))),
            column("e", Role::Error(axis()), of(&|i| 3.0 * warm(i) + 0.1 * noise(i + 3))),
        ];
        let records = [Record::new(Path::new("drift.run.toml"), Kind::Drift, columns).unwrap()];
        let machine = Machine::ideal("m");
        let mut answer = nothing_learned(&records, &machine);
        for (sensor, um_per_k) in [("T1", 1.5), ("T2", 1.875)] {
            let mut effect = machine.dictionary().effect("thermal_growth.x").unwrap();
            effect.delta = Some(Difference::single(sensor));
            let effect = effect.with(&[(0, um_per_k)]).unwrap();
            let held = (0..effect.values().len()).collect();
            answer.findings.push(Finding {
                effect,
                held,
                p_value: 0.001,
                evidence: 50.0,
                rivals: Vec::new(),
            });
        }
        let mut stack = Stack::new(&records);
        stack.sigma.clone_from(&answer.sigma);
        let fitted = Fitted::of(&stack, &machine, &mut answer);
        assert_eq!(fitted.found().len(), 2);
        for part in fitted.found() {
            let (um_per_k, half) = (part.effect.scalar(0), part.half[0]);
            assert!(half > 0.01 * um_per_k && half < 5.0 * um_per_k, "{um_per_k} ± {half}");
        }
    }
}
