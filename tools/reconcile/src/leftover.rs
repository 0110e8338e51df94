//! What a set of names leaves: too much of it, and the names are not the whole.

use crate::cause::Shape;
use crate::chance::Chance;
use crate::problem::rms;
use crate::rounding::saws;
use crate::search::{Member, Search, Set};
use rtec_model::effect::{Against, Difference, Effect, STANDARD_DEGC};
use rtec_model::record::Record;

/// Log odds by which a shape without a name must beat the best named explanation.
const SHAPE_DECISIVE: f64 = 5.0;
/// The same where the names leave little.
const SHAPE_INSTEAD: f64 = 12.0;
/// An effect that does less than this share of what is left is not worth a name: on a real machine everything shows a
/// little of everything.
const WORTH: f64 = 0.2;
/// Where named effects leave less than this share of the gap, what is left does not make the whole unknown.
pub(crate) const EXPLAINED: f64 = 0.25;
/// Where named effects leave less than this share of the gap, they are not exchanged for a shape without a name,
/// however well it fits: no law is true to a fiftieth.
const NEARLY_ALL: f64 = 0.05;
/// What names leave is far above the noise where it is so many times what the best account leaves.
const FAR: f64 = 1.5;

/// A curve turns back where so much of the temperatures seen lies beyond its turning, on either side.
const TURNED: f64 = 0.1;

/// A set with a knee over the temperature in place of a growth that bends so far that it turns back within the temperatures
/// seen, where the knee explains no less with no more values. Nothing grows and then shrinks as it warms: the parabola is the
/// nearest that the law comes to another curve, which has no name.
pub(crate) fn knee_instead(search: &mut Search<'_, '_>, named: &Set) -> Option<Set> {
    let effects = search.effects(named);
    for (i, effect) in effects.iter().enumerate() {
        let Some(delta) = effect.as_ref().filter(|e| turns_back(search, e)).and_then(|e| e.delta.clone())
        else {
            continue;
        };
        let rest = search.without(named, i);
        let values = named.members[i].columns();
        let along: Vec<String> = delta.sensors().map(|s| format!("temperature.{s}")).collect();
        let all = search.all;
        let knees = all.atoms.iter().filter(|a| {
            let over = |s: &Shape| matches!(&s.against[..], [one] if along.contains(one));
            a.columns.len() <= values && a.cause.shape().is_some_and(over)
        });
        let knees: Vec<usize> = knees.map(|a| a.hypothesis).collect();
        let each = (0..all.list.len()).filter(|h| knees.contains(h));
        let best = each.filter_map(|h| search.offer_of(&rest, h)).max_by(|a, b| a.score.total_cmp(&b.score));
        let Some(offer) = best else { continue };
        let instead = search.take(&rest, &offer);
        if instead.loglik >= named.loglik {
            return Some(instead);
        }
    }
    None
}

/// Whether a growth has its largest or least value well within the temperatures of its rows.
fn turns_back(search: &Search<'_, '_>, effect: &Effect) -> bool {
    let Some(delta) = effect.delta.as_ref().filter(|_| effect.coefficient_count() == 2) else { return false };
    let (slope, bend) = (effect.scalar(0), effect.scalar(1));
    let mut seen: Vec<f64> = search.stack.records.iter().flat_map(|r| differences(r, delta)).collect();
    seen.sort_by(f64::total_cmp);
    let at = |share: f64| seen.get((share * (seen.len().max(1) - 1) as f64) as usize);
    let rises = |d: &f64| slope + 2.0 * bend * d > 0.0;
    at(TURNED).zip(at(1.0 - TURNED)).is_some_and(|(cold, warm)| rises(cold) != rises(warm))
}

/// A temperature difference over a record's rows; empty where it lacks a sensor.
fn differences(record: &Record, delta: &Difference) -> Vec<f64> {
    let Some(warm) = record.temperature(&delta.sensor) else { return Vec::new() };
    match &delta.against {
        Against::Sensor(minus) => {
            let minus = record.temperature(minus).unwrap_or_default();
            warm.iter().zip(minus).map(|(t, m)| t - m).collect()
        }
        Against::Reference(degc) => warm.iter().map(|t| t - degc).collect(),
        Against::Standard => warm.iter().map(|t| t - STANDARD_DEGC).collect(),
    }
}

/// The member that does least on the rows that it acts on, where that is too little for a name, or is what rounding makes of the
/// others.
pub(crate) fn slightest(search: &Search<'_, '_>, named: &Set) -> Option<usize> {
    let left = search.residual(named).0;
    let share = |i: usize| {
        let does = search.does(named, i);
        let there = |v: &[f64]| {
            rms(&v.iter().zip(&does).filter(|(_, d)| **d != 0.0).map(|(v, _)| *v).collect::<Vec<_>>())
        };
        there(&does) / there(&left).max(1e-300)
    };
    let does: Vec<f64> = (0..named.members.len()).map(share).collect();
    let slighter = |a: &usize, b: &usize| does[*a].total_cmp(&does[*b]);
    if let Some(saw) = saws(search, named).into_iter().min_by(slighter) {
        return Some(saw);
    }
    let least = (0..does.len()).min_by(slighter)?;
    (does[least] < WORTH).then_some(least)
}

/// Structure that the names leave to shapes; empty where the names keep their place.
pub(crate) fn unexplained(
    search: &Search<'_, '_>,
    named: &Set,
    any: &Set,
    chance: &Chance,
    level: f64,
) -> Vec<Shape> {
    let whole = rms(&search.residual(&search.empty()).0);
    let left = rms(&search.residual(named).0);
    let mostly = !named.members.is_empty() && left < EXPLAINED * whole;
    // Names that leave next to nothing keep their place, and those that a shape only stands beside, where it does little.
    let beside = named.members.iter().all(|m| any.members.iter().any(|a| a.hypothesis == m.hypothesis));
    let little = left < FAR * rms(&search.residual(any).0);
    // A shape that says more with no more values is no bending of what the names say to the last nanometre.
    let values = |s: &Set| s.members.iter().map(Member::columns).sum::<usize>();
    let plain = !beside && values(any) <= values(named);
    let kept = mostly && !plain && ((beside && little) || left < NEARLY_ALL * whole);
    // A shape in place of the names, not beside them, has to be the far better account where they leave little.
    // The more names one shape replaces, the less.
    let each = any.members.len() as f64 / named.members.len().max(1) as f64;
    let needed = if mostly { SHAPE_INSTEAD * each.min(1.0) } else { SHAPE_DECISIVE };
    if kept || any.score <= named.score + needed {
        return Vec::new();
    }
    // In place of names it is the whole that chance would have to give.
    let gain = if beside { search.gain(named, any) } else { search.gain(&search.empty(), any) };
    if chance.of_anything(gain) > level {
        return Vec::new();
    }
    let saws = saws(search, any);
    let told = (0..any.members.len()).filter(|i| !saws.contains(i));
    told.filter_map(|i| any.members[i].cause.shape().cloned()).collect()
}

/// Structure that only effects outside their laws' bounds explain: no machine has them, so that it has no name. `full`: the
/// set with them. Empty where what is left without them, `named`, is as small.
pub(crate) fn beyond_bounds(
    search: &Search<'_, '_>,
    named: &Set,
    full: &Set,
    chance: &Chance,
    level: f64,
) -> Vec<Shape> {
    let [left, least] = [named, full].map(|s| rms(&search.residual(s).0));
    let gain = search.gain(named, full);
    if left < FAR * least || gain < SHAPE_INSTEAD || chance.of_anything(gain) > level {
        return Vec::new();
    }
    let effects = search.effects(full).into_iter().flatten();
    let like =
        |e: Effect| Shape::like(search.stack, &e, format!("as {} beyond what a machine can have", e.name()));
    effects.filter(|e| !e.is_physical()).filter_map(like).collect()
}
