//! The candidates for one member: its names, its modes, its rivals.

use super::{EstimatedHypothesis, RivalExplanation, TriedExplanation, label};
use crate::hypothesis_contribution::HypothesisContribution;
use crate::priors::{HELD, LISTED, SAME_PERIOD};
use crate::search::{
    HypothesisSearch, HypothesisSet, HypothesisSetMember, ScreenedHypothesis, log_sum, same_period,
};
use crate::search_limits::{HOPELESS, MOMENT_ROWS};
use rtec_model::effect::{Effect, ParameterRefinement};

/// The posterior of the candidates for one member.
pub(super) struct CandidatePosterior {
    pub(super) found: EstimatedHypothesis,
    pub(super) tried: Vec<TriedExplanation>,
    pub(super) nothing: bool,
    /// A likelier set, with another cause instead of this member.
    pub(super) better: Option<HypothesisSet>,
}

/// A candidate for a member: family, label, effect, log mass.
pub(super) type WeightedCandidate = (usize, String, Option<Effect>, f64);

/// Adds the maps that are equivalent at these rows.
/// Each gets the mass of its prior relative to the member's.
pub(super) fn add_alike_maps(
    search: &HypothesisSearch<'_>,
    set: &HypothesisSet,
    member: usize,
    all: &mut Vec<WeightedCandidate>,
) {
    let families = &search.families.list;
    for seed in search.maps_alike(&search.of_last(set, member)) {
        let score = set.score + seed.score - families[set.members[member].family].prior;
        if let Some(known) = all.iter_mut().find(|a| a.0 == seed.family) {
            known.3 = known.3.max(score);
        } else {
            all.push((seed.family, families[seed.family].label(), seed.cause.effect().cloned(), score));
        }
    }
}

/// Adds the refined alternatives to a member.
/// Returns the likeliest set with one of them that is likelier than the given set.
fn add_refined(
    search: &HypothesisSearch<'_>,
    set: &HypothesisSet,
    without: &HypothesisSet,
    own: &HypothesisSetMember,
    seeds: &[ScreenedHypothesis],
    all: &mut Vec<WeightedCandidate>,
) -> Option<HypothesisSet> {
    let families = &search.families.list;
    let mut better: Option<HypothesisSet> = None;
    let mut keep = |other: HypothesisSet| {
        if other.score > better.as_ref().map_or(set.score + 0.05, |b| b.score) {
            better = Some(other);
        }
    };
    for seed in seeds {
        let refined = search.refined(&without.factor, seed);
        let name = refined.cause.effect().map_or_else(|| families[seed.family].label(), label);
        let same_mode = seed.family == own.family && same_place(&own.cause, &refined.cause);
        if same_mode {
            continue;
        }
        if let Some(other) = search.with(without, &refined) {
            all.push((seed.family, name, refined.cause.effect().cloned(), other.score));
            keep(other);
        }
    }
    // A wave's rival is the same wave, whose size changes along its travel.
    let changing = own.cause.effect().and_then(|_| search.changing(&without.factor, &own.seed()));
    if let Some(seed) = changing
        && let HypothesisContribution::Shape(shape) = &seed.cause
        && let Some(other) = search.with(without, &seed)
    {
        all.push((seed.family, shape.0.label(), None, other.score));
        keep(other);
    }
    for seed in search.alike(own) {
        let refined = search.refined(&without.factor, &seed);
        let seen = |a: &WeightedCandidate| {
            a.0 == seed.family
                && a.2.as_ref().zip(refined.cause.effect()).is_some_and(|(a, b)| same_period(a, b))
        };
        if !all.iter().any(seen)
            && let Some(other) = search.with(without, &refined)
        {
            all.push((seed.family, all[0].1.clone(), refined.cause.effect().cloned(), other.score));
            keep(other);
        }
    }
    better
}

/// The posterior of one member: all candidates, given the other members.
pub(super) fn place(search: &HypothesisSearch<'_>, set: &HypothesisSet, member: usize) -> CandidatePosterior {
    let own = &set.members[member];
    let without = search.without(set, member);
    let seeds = search.screened(&without, true);
    let families = &search.families.list;
    let own_label = own.cause.effect().map_or_else(|| families[own.family].label(), label);
    // Family, label, effect, log mass.
    let mut all: Vec<WeightedCandidate> =
        vec![(own.family, own_label.clone(), own.cause.effect().cloned(), set.score)];
    let top = seeds.first().map_or(0.0, |s| s.score).max(set.score - without.score);
    let far = seeds.iter().position(|s| s.score < top - HOPELESS - 2.0).unwrap_or(seeds.len());
    let better = add_refined(search, set, &without, own, &seeds[..far], &mut all);
    add_alike_maps(search, set, member, &mut all);
    let masses: Vec<f64> = all.iter().map(|a| a.3).chain([without.score]).collect();
    let total = log_sum(masses.iter().copied());
    let of = |yes: &dyn Fn(&WeightedCandidate) -> bool| {
        let own: Vec<f64> = all.iter().filter(|a| yes(a)).map(|a| a.3).collect();
        (log_sum(own) - total).exp()
    };
    let name = families[own.family].label();
    let name_mass = of(&|a| families[a.0].label() == name);
    let shape_mass = of(&|a| !families[a.0].is_named());
    let mode = (set.score - total).exp();
    let evidence = set.score - without.score;
    let mut rivals = Vec::new();
    let tried = |label: &str, odds: f64, accepted: bool| TriedExplanation {
        label: label.to_owned(),
        odds,
        accepted,
        place: own_label.clone(),
    };
    let mut all_tried = vec![tried(&own_label, 0.0, true)];
    all[1..].sort_by(|a, b| b.3.total_cmp(&a.3));
    // All within fair odds are listed, and as many as the credible set needs in addition to the accepted
    // name.
    let whole = log_sum(all.iter().map(|a| a.3));
    let mut held = (set.score - whole).exp();
    for (family, label, effect, score) in all.iter().skip(1) {
        let margin = set.score - score;
        all_tried.push(tried(label, -margin, false));
        let listed = margin < LISTED || held < HELD;
        held += (score - whole).exp();
        let Some(effect) = effect.as_ref().filter(|_| listed && families[*family].replaces.is_none()) else {
            continue;
        };
        let differs = (*family == own.family && effect.delta.is_none()).then(|| {
            let p = effect.description().parameters.iter().position(|p| p.tells_apart)?;
            Some((effect.description().parameters[p].name.clone(), effect.scalar(p)))
        });
        rivals.push(RivalExplanation {
            name: effect.name(),
            sensor: effect.delta.clone(),
            differs: differs.flatten(),
            margin,
        });
    }
    // Seeds far below the best were only computed quickly.
    for seed in &seeds[far..] {
        let name = seed.cause.effect().map_or_else(|| families[seed.family].label(), label);
        all_tried.push(tried(&name, seed.score - evidence, false));
    }
    rivals.sort_by(|a, b| a.margin.total_cmp(&b.margin));
    let moments = moments(search, &without, own);
    let found = EstimatedHypothesis {
        moments,
        effect: own.cause.effect().filter(|_| families[own.family].replaces.is_none()).cloned(),
        shape: match &own.cause {
            HypothesisContribution::Shape(both) => Some(both.0.clone()),
            _ => None,
        },
        replaces: families[own.family].replaces,
        half: Vec::new(),
        held: Vec::new(),
        evidence,
        name_mass,
        mode_mass: (mode / name_mass.max(1e-300)).min(1.0),
        shape_mass,
        has_size: true,
        rivals,
    };
    CandidatePosterior { found, tried: all_tried, nothing: evidence < 0.0, better }
}

/// The 95 % interval of a step's moment, over the moments of the rows.
pub(super) fn moments(
    search: &HypothesisSearch<'_>,
    without: &HypothesisSet,
    own: &HypothesisSetMember,
) -> Option<[f64; 2]> {
    use rtec_model::effect::RecordExtent as _;
    let effect = own.cause.effect()?;
    let p = effect.description().parameters.iter().position(|p| p.refine == ParameterRefinement::Moment)?;
    let all = search.problem.rows.moments_s();
    let at = all.partition_point(|t| *t < effect.scalar(p));
    let near = &all[at.saturating_sub(MOMENT_ROWS)..(at + MOMENT_ROWS).min(all.len())];
    let mass: Vec<f64> = near
        .iter()
        .map(|t| {
            let Some(e) = effect.with(&[(p, *t)]) else { return f64::NEG_INFINITY };
            search.gain(&without.factor, &search.columns(&own.cause.with_effect(e))).total
        })
        .collect();
    let total = log_sum(mass.iter().copied());
    let mut order: Vec<usize> = (0..near.len()).collect();
    order.sort_by(|a, b| mass[*b].total_cmp(&mass[*a]));
    let (mut held, mut range) = (0.0, [f64::MAX, f64::MIN]);
    for i in order {
        // The step came after the previous row.
        let before = all[(at.saturating_sub(MOMENT_ROWS) + i).saturating_sub(1)];
        range = [range[0].min(before), range[1].max(near[i])];
        held += (mass[i] - total).exp();
        if held >= HELD {
            break;
        }
    }
    Some(range)
}

/// Whether two causes of one family are one mode.
pub(super) fn same_place(a: &HypothesisContribution, b: &HypothesisContribution) -> bool {
    let (Some(a), Some(b)) = (a.effect(), b.effect()) else { return true };
    if a.delta != b.delta {
        return false;
    }
    let law = a.description();
    law.parameters.iter().enumerate().all(|(i, p)| {
        if p.array || !p.tells_apart {
            return true;
        }
        let (x, y) = (a.scalar(i), b.scalar(i));
        match p.refine {
            ParameterRefinement::TimeConstant(_) | ParameterRefinement::Factor(_) => (x / y).ln().abs() < 1.0,
            ParameterRefinement::Step(s) => (x - y).abs() < 4.0 * s,
            ParameterRefinement::Moment => true,
            ParameterRefinement::Stays => (x / y - 1.0).abs() < SAME_PERIOD,
        }
    })
}
