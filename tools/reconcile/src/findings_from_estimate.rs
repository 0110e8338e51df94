//! Turns an estimate into findings.
//! They are effects with a name, shapes without one, and corrections of the model.

use rtec_estimate::measurement_model::UnitAssumption;
use rtec_estimate::rows_and_noise::MeasuredRows;
use rtec_estimate::{EstimatedHypothesis, EstimationResult, RivalExplanation, UnnamedShape};
use rtec_model::effect::{Effect, ParameterFitMethod};
use rtec_model::machine::Machine;
use rtec_model::record::Record;

/// An effect that was found.
#[derive(Debug, Clone)]
pub struct FoundEffect {
    /// The effect with its parameters.
    pub effect: Effect,
    /// Indices of values that the data did not determine: they keep the law's values.
    pub held: Vec<usize>,
    /// Probability that chance alone explains as much.
    pub p_value: f64,
    /// Log odds of the set with it against the set without it.
    pub evidence: f64,
    /// Posterior share of its name for its place, 0 to 1; shapes are left out.
    pub name_mass: f64,
    /// Posterior share of its mode (a period, a number of lobes) within its name.
    pub mode_mass: f64,
    /// The explanations that the data cannot distinguish from it.
    pub rivals: Vec<RivalExplanation>,
}

/// The answer, before anything is written into the model.
#[derive(Debug, Clone)]
pub(crate) struct AnalysisFindings {
    /// Effects with half widths of their intervals, strongest first.
    pub(crate) findings: Vec<(FoundEffect, Vec<f64>)>,
    pub(crate) unexplained: Vec<UnnamedShape>,
    /// Effects that may be parts of what is unexplained.
    /// A curve for it stands beside them.
    pub(crate) parts_of_unknown: Vec<(FoundEffect, Vec<f64>)>,
    pub(crate) estimate: EstimationResult,
}

/// Half widths of the model's intervals, effect by effect and value by value.
pub(crate) fn stated(machine: &Machine) -> Vec<Vec<Option<f64>>> {
    let of = |l: &rtec_model::machine::EffectWithProvenance| {
        let width = l.effect.width();
        let names = l.effect.description().parameters.iter();
        names
            .flat_map(|p| {
                let pairs = l.provenance.interval.get(&p.name);
                (0..width).map(move |i| pairs.and_then(|v| v.get(i)).map(|[lo, hi]| 0.5 * (hi - lo)))
            })
            .collect()
    };
    machine.listed().iter().map(of).collect()
}

/// Bound on the probability that chance alone gives such odds.
/// Under chance the mean Bayes factor is one, so a factor of x has a probability below 1/x (Markov's
/// inequality). The price of one more effect is not part of the prior over names, so it is taken out again.
fn p_value(f: &EstimatedHypothesis) -> f64 {
    (-f.evidence - rtec_estimate::priors::PRICE).exp().min(1.0)
}

/// Analyses records beside a model, at a false-alarm rate.
pub(crate) fn analyse(records: &[Record], machine: &Machine, level: f64) -> AnalysisFindings {
    let model: Vec<Effect> = machine.effects().cloned().collect();
    let estimate = rtec_estimate::estimate(records, machine.dictionary(), &model, &stated(machine));
    let rows = MeasuredRows::new(records);
    let mut findings = Vec::new();
    let mut unexplained = Vec::new();
    for f in estimate.found.iter().filter(|f| f.replaces.is_some() || p_value(f) <= level) {
        match (&f.effect, &f.shape) {
            // A name is accepted if shapes hold less than half of its posterior and its size is not zero.
            (Some(effect), _) if f.shape_mass < rtec_estimate::priors::THERE && f.has_size => {
                findings.push((finding(f, effect), f.half.clone()));
            }
            (Some(effect), _) => {
                unexplained.extend(UnnamedShape::like(&rows, effect, "not as any effect of the dictionary"));
            }
            (None, Some(shape)) => unexplained.push(shape.clone()),
            (None, None) => {}
        }
    }
    let mut parts_of_unknown = Vec::new();
    for k in (0..findings.len()).rev() {
        let found: &(FoundEffect, Vec<f64>) = &findings[k];
        if let Some(part) = part_of_unknown(&rows, &found.0.effect, &unexplained) {
            unexplained.push(part);
            parts_of_unknown.push(findings.remove(k));
        }
    }
    AnalysisFindings { findings, unexplained, parts_of_unknown, estimate }
}

/// The shape that an effect describes, if it may be a part of something unknown.
/// An unknown function of a variable has any form. No law with a form of its own over that variable can be told
/// from a part of it. A map has any form itself.
fn part_of_unknown(
    rows: &MeasuredRows<'_>,
    effect: &Effect,
    unknown: &[UnnamedShape],
) -> Option<UnnamedShape> {
    let law = effect.description();
    let has_form = law.parameters.iter().any(|p| p.search != ParameterFitMethod::Linear && !p.array);
    // Growth is a function of a difference of temperatures, and a spike after a turn one of the past.
    if !has_form || effect.delta.is_some() || law.after_turn {
        return None;
    }
    let own = UnnamedShape::like(rows, effect, &format!("in part like {}", effect.name()))?;
    let covers = |shape: &UnnamedShape| {
        shape.response == own.response && own.against.iter().all(|v| shape.against.contains(v))
    };
    unknown.iter().any(covers).then_some(own)
}

/// Log evidence of the best explanation of records, from an answer's members.
/// The search stops early if it is far below `enough`.
pub(crate) fn score(
    records: &[Record],
    machine: &Machine,
    from: &AnalysisFindings,
    units: UnitAssumption,
    enough: f64,
) -> f64 {
    let model: Vec<Effect> = machine.effects().cloned().collect();
    let start = &from.estimate.members;
    rtec_estimate::score(records, machine.dictionary(), &model, &stated(machine), start, units, enough)
}

fn finding(f: &EstimatedHypothesis, effect: &Effect) -> FoundEffect {
    FoundEffect {
        effect: effect.clone(),
        held: f.held.clone(),
        p_value: p_value(f),
        evidence: f.evidence,
        name_mass: f.name_mass / (1.0 - f.shape_mass).max(1e-9),
        mode_mass: f.mode_mass,
        rivals: f.rivals.clone(),
    }
}
