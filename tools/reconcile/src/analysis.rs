//! From runs and a model to the answer: what is missing, what else it might be, what the model had slightly wrong.

use crate::chance::Chance;
use crate::hypotheses::{Cause, Hypotheses, Shape};
use crate::problem::{Known, Stack, known, rms};
use crate::search::{Found, Search, Set, level_name};
use rtec_model::effect::{Difference, Effect};
use rtec_model::machine::Machine;
use rtec_model::record::Record;

/// Rounds of block permutation.
const ROUNDS: usize = 40;
/// Log odds below which the data do not decide between two explanations.
const DECISIVE: f64 = 3.0;
/// Log odds by which a shape without a name must beat the best named explanation.
const SHAPE_DECISIVE: f64 = 1.5;
/// The same where the names leave little.
const SHAPE_INSTEAD: f64 = 12.0;

/// An effect that changes the root mean square by less than this share of the whole gap is not worth a name: on a real
/// machine everything shows a little of everything.
const WORTH: f64 = 0.015;
/// Where named effects leave less than this share of the gap, what is left does not make the whole unknown.
const EXPLAINED: f64 = 0.2;
/// Where named effects leave less than this share of the gap, they are not exchanged for a shape without a name,
/// however well it fits: no law is true to a fiftieth.
const NEARLY_ALL: f64 = 0.05;
/// Most rivals that are listed for one effect.
const MOST_RIVALS: usize = 12;

/// Another explanation of the same thing.
#[derive(Debug, Clone, PartialEq)]
pub struct Rival {
    /// Name of the effect.
    pub name: String,
    /// Its temperature difference, where it has one.
    pub sensor: Option<Difference>,
    /// Log odds by which the explanation given is better.
    pub margin: f64,
}

/// An effect that was found.
#[derive(Debug, Clone)]
pub struct Finding {
    /// The effect with its parameters.
    pub effect: Effect,
    /// Values that the law has and the data did not call for: held where they are.
    pub held: Vec<usize>,
    /// Probability that chance alone explains as much.
    pub p_value: f64,
    /// Log likelihood gained, less the price of its freedom.
    pub evidence: f64,
    /// What the data cannot tell from it.
    pub rivals: Vec<Rival>,
}

/// The answer, before anything is written.
#[derive(Debug)]
pub struct Answer {
    /// Effects to add, strongest first.
    pub findings: Vec<Finding>,
    /// Structure that no effect explains.
    pub unexplained: Vec<Shape>,
    /// The model's own effects with their parameters as the data have them, before the last fit.
    pub present: Vec<Effect>,
    /// The model's own effects as the file has them.
    pub file: Vec<Effect>,
    /// The same with the periods that were found by a search: what a fit starts from and is held to.
    pub anchor: Vec<Effect>,
    /// Every name that was tried as the next one, best first: log odds against what was accepted.
    pub ranking: Vec<Tried>,
    /// What is left unexplained, and the noise's coefficient.
    pub residual: Vec<f64>,
    /// First-order autocorrelation of the noise.
    pub phi: f64,
    /// Size of the noise per response.
    pub sigma: Vec<f64>,
    /// Noise made by moving the residual's blocks about, weighed: what `where` is judged by.
    pub draws: Vec<Vec<f64>>,
}

/// A name that was tried.
#[derive(Debug, Clone)]
pub struct Tried {
    /// Name, with its sensors.
    pub label: String,
    /// Log odds of the best set with it in place of the nearest accepted effect (or beside them).
    pub odds: f64,
    /// Whether it is in the answer.
    pub accepted: bool,
}

fn noise_guess(stack: &Stack<'_>, missing: &[f64]) -> Vec<f64> {
    (0..stack.responses.len())
        .map(|j| {
            let (mut all, mut steps) = (Vec::new(), Vec::new());
            for s in stack.segments.iter().filter(|s| s.response == j) {
                let m = &missing[s.rows.clone()];
                all.extend_from_slice(m);
                steps.extend(m.windows(2).map(|w| w[1] - w[0]));
            }
            let size = rms(&all).max(1e-9);
            (rms(&steps) / 2f64.sqrt()).clamp(0.1 * size, size)
        })
        .collect()
}

/// The runs as one stack, the model's effects, and rounds of noise made from what the model leaves once its own
/// parameters are fitted.
pub(crate) fn noise_of<'r>(
    records: &'r [Record],
    machine: &Machine,
) -> (Stack<'r>, Vec<Effect>, Vec<Vec<f64>>) {
    let mut stack = Stack::new(records);
    let file: Vec<Effect> = machine.effects().cloned().collect();
    let simulated = stack.predict(&file);
    let mut missing: Vec<f64> = stack.measured.iter().zip(&simulated).map(|(m, s)| m - s).collect();
    stack.sigma = noise_guess(&stack, &missing);
    stack.weigh(&mut missing);
    let parameters = known(&stack, 1.0, &file, &file);
    let none = Hypotheses::default();
    let mut search = Search::new(&stack, &none, &[]);
    search.begin(1.0, parameters, missing);
    let noise = search.chance(&search.empty(), ROUNDS).draws;
    (stack, file, noise)
}

/// Finds and names what is missing. With `thinnable`, `None` when the rows are too close together for that: fewer of
/// them say more.
pub(crate) fn analyse(records: &[Record], machine: &Machine, level: f64, thinnable: bool) -> Option<Answer> {
    let mut stack = Stack::new(records);
    let file: Vec<Effect> = machine.effects().cloned().collect();
    let mut now = file.clone();
    let simulated = stack.predict(&now);
    let missing: Vec<f64> = stack.measured.iter().zip(&simulated).map(|(m, s)| m - s).collect();
    stack.sigma = noise_guess(&stack, &missing);
    let mut anchor = file.clone();
    // Size of the noise in units of the stack's; of one response it need not be weighed anew.
    let mut noise = 1.0;
    retune(&stack, noise, &mut anchor, &mut now, &[]);
    let alone = stack.responses.len() == 1;
    let mut passes = PASSES;
    loop {
        let (all, waves) = Hypotheses::new(&stack, machine.dictionary());
        let mut search = Search::new(&stack, &all, &waves);
        let sigma: Vec<f64> = loop {
            let simulated = stack.predict(&now);
            let mut missing: Vec<f64> = stack.measured.iter().zip(&simulated).map(|(m, s)| m - s).collect();
            stack.weigh(&mut missing);
            let parameters = known(&stack, noise, &anchor, &now);
            search.begin(noise, parameters.clone(), missing);
            let found = search.run();
            if thinnable && (search.contradicted(&found.named) || search.contradicted(&found.any)) {
                return None;
            }
            let (residual, _) = search.residual(&found.any);
            let beta = search.coefficients(&found.any);
            let mut moved = moved(&now, &parameters, &beta);
            let bent = bend(&stack, &now, &moved, &parameters, &beta) / noise;
            let change: Vec<f64> = (0..stack.responses.len())
                .map(|j| {
                    let segments = stack.segments.iter().filter(|s| s.response == j);
                    let rows: Vec<f64> = segments.flat_map(|s| &residual[s.rows.clone()]).copied().collect();
                    (rms(&rows) / noise).clamp(0.02, 50.0)
                })
                .collect();
            let off = change.iter().any(|c| !(0.75..1.35).contains(c));
            if alone && off {
                noise *= change[0];
            }
            // A wave beside a wave of the model may be the model's own, out of tune: seen now that the rest is explained.
            let mut tuned = false;
            if passes > 0 {
                let mut at = parameters.len();
                let mut beside = Vec::new();
                for m in &found.any.members {
                    beside.extend(effect_of(&m.cause, &beta[at..at + m.columns()]));
                    at += m.columns();
                }
                let same = |e: &Effect| now.iter().any(|n| is_wave(n) && n.name() == e.name());
                if beside.iter().any(&same) {
                    beside.retain(|e| !same(e));
                    let mut trial = moved.clone();
                    tuned = retune(&stack, noise, &mut anchor, &mut trial, &beside);
                    if tuned {
                        moved = trial;
                    }
                }
            }
            // Only beside the model's parameters does it matter how large the noise of one response is.
            let weigh = off && !(alone && parameters.is_empty());
            if passes == 0 || !(weigh || bent > 0.1 || tuned) {
                let mut answer = conclude(&mut search, &found, &now, level);
                answer.sigma.iter_mut().for_each(|s| *s *= noise);
                answer.residual.iter_mut().for_each(|r| *r /= noise);
                answer.draws.iter_mut().flatten().for_each(|d| *d /= noise);
                return Some(Answer { file, anchor, ..answer });
            }
            passes -= 1;
            now = moved;
            if !alone {
                break stack.sigma.iter().zip(&change).map(|(a, b)| a * b).collect();
            }
        };
        stack.sigma = sigma;
    }
}

/// How often the search is done again with better values of the model's own parameters and of the noise's size.
const PASSES: usize = 3;

fn is_wave(effect: &Effect) -> bool {
    effect.description().searched.wave.is_some()
}

/// Searches the periods of the model's own periodic effects: over a long travel a period that is a little off is out
/// of step by whole turns, which no linear correction mends. `beside` is what was found missing beside them. What is
/// mended counts as if the file had said so. Whether anything was.
fn retune(
    stack: &Stack<'_>,
    noise: f64,
    anchor: &mut [Effect],
    now: &mut [Effect],
    beside: &[Effect],
) -> bool {
    let mut any = false;
    for e in 0..now.len() {
        if !is_wave(&now[e]) {
            continue;
        }
        let others = now.iter().enumerate().filter(|(i, _)| *i != e).map(|(_, x)| x);
        let simulated = stack.predict(others.chain(beside));
        let mut missing: Vec<f64> = stack.measured.iter().zip(&simulated).map(|(m, s)| m - s).collect();
        stack.weigh(&mut missing);
        let others: Vec<Known> =
            known(stack, noise, anchor, now).into_iter().filter(|k| k.effect != e).collect();
        let (none, waves) = Hypotheses::periods(stack, &now[e]);
        let mut search = Search::new(stack, &none, &waves);
        search.begin(noise, others, missing);
        let empty = search.empty();
        let Some(best) = search.scan(&empty, true).into_iter().next() else { continue };
        let same = search.score_of(&empty, &now[e]);
        if best.score > same + 6.0 {
            let set = search.take(&empty, &best);
            let beta = search.coefficients(&set);
            let at = beta.len() - 2;
            let Some(found) = effect_of(&best.cause, &beta[at..]) else { continue };
            // Another amplitude is another effect, not this one with its period mended.
            let ratio = found.scalar(1) / now[e].scalar(1).abs().max(1e-12);
            if (0.4..2.5).contains(&ratio) {
                let [period, phase] = [found.scalar(0), found.scalar(2)];
                let mended = anchor[e].values().to_vec();
                // Both keep the law's bounds: they come from the law itself.
                let _set = anchor[e].set_values(&[period, mended[1], phase]);
                now[e] = found;
                any = true;
            }
        }
    }
    any
}

/// The model's effects with the changes that a fit asks for.
fn moved(now: &[Effect], parameters: &[Known], beta: &[f64]) -> Vec<Effect> {
    let mut out = now.to_vec();
    for (e, effect) in out.iter_mut().enumerate() {
        let mut values = effect.values().to_vec();
        for (k, b) in parameters.iter().zip(beta).filter(|(k, _)| k.effect == e) {
            k.along.iter().for_each(|(v, w)| values[*v] += w * b);
        }
        // A change that leaves the law's bounds is not made.
        let _kept = effect.set_values(&values);
    }
    out
}

/// How far the changes are from linear, in units of the noise.
fn bend(stack: &Stack<'_>, now: &[Effect], moved: &[Effect], parameters: &[Known], beta: &[f64]) -> f64 {
    let (a, b) = (stack.predict(now), stack.predict(moved));
    let mut d: Vec<f64> = b.iter().zip(&a).map(|(b, a)| b - a).collect();
    stack.weigh(&mut d);
    for (k, b) in parameters.iter().zip(beta) {
        d.iter_mut().zip(&k.column).for_each(|(d, c)| *d -= b * c);
    }
    rms(&d)
}

/// The effect that a member stands for, with its coefficients.
pub(crate) fn effect_of(cause: &Cause, gamma: &[f64]) -> Option<Effect> {
    let Cause::Effect { effect, free, reference } = cause else { return None };
    let mut effect = effect.clone();
    let k = effect.coefficient_count();
    let directions = crate::problem::free_directions(&effect.constraints(), k);
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
        delta.against = rtec_model::effect::Against::Reference(rtec_model::effect::STANDARD_DEGC + d);
    }
}

/// One member at a time may have a better name, with the others in place.
fn renamed(search: &mut Search<'_, '_>, set: Set) -> Set {
    let mut named = set;
    for _ in 0..3 {
        let mut changed = false;
        for i in 0..named.members.len() {
            let rest = search.without(&named, i);
            let member = named.members[i].hypothesis;
            let ranking = search.ranking(&rest);
            let Some(first) = ranking.first() else { continue };
            let offer = first.offers[0].clone();
            let own = &search.all.list[member].name;
            let present =
                ranking.iter().find(|r| r.name == *own).map_or(named.score, |r| r.evidence.max(named.score));
            let better =
                if first.name == *own { offer.score > named.score + 1e-6 } else { first.evidence > present };
            if offer.hypothesis == member || !better {
                continue;
            }
            let next = search.take(&rest, &offer);
            let next = search.polish(next);
            if !search.physical(&next) {
                continue;
            }
            named = next;
            changed = true;
            break;
        }
        if !changed {
            break;
        }
    }
    named
}

/// A constant beside a member may make another explanation of that member better than itself: a step that a search
/// by single steps does not take.
fn with_offset(search: &mut Search<'_, '_>, set: &Set) -> Set {
    let offsets: Vec<usize> = (0..search.all.list.len())
        .filter(|h| search.all.list[*h].law().is_some_and(|l| l.constant))
        .collect();
    let thermal = |i: usize| search.all.list[set.members[i].hypothesis].sensor().is_some();
    let n = set.members.len();
    let mut rests: Vec<Set> = (0..n).map(|i| search.without(set, i)).collect();
    // Two sensors with a constant between them may be their difference.
    for i in (0..n).filter(|i| thermal(*i)) {
        for j in (i + 1..n).filter(|j| thermal(*j)) {
            rests.push(search.without(&search.without(set, j), i));
        }
    }
    let mut best = set.clone();
    for rest in rests {
        for h in &offsets {
            if set.members.iter().any(|m| m.hypothesis == *h) {
                continue;
            }
            let Some(offset) = search.offer_of(&rest, *h) else { continue };
            let level = search.take(&rest, &offset);
            let Some(offer) = search.offers(&level, 1, 0, false).into_iter().next() else { continue };
            if offer.score > best.score + 1e-6 {
                let next = search.take(&level, &offer);
                let next = search.polish(next);
                if search.physical(&next) {
                    best = next;
                }
            }
        }
    }
    best
}

/// A set without its weakest member, without the weakest of what is left, and so on to the empty set.
fn fewer(search: &Search<'_, '_>, set: &Set) -> Vec<Set> {
    let mut out: Vec<Set> = Vec::new();
    for _ in 0..set.members.len() {
        let from = out.last().unwrap_or(set);
        let each = (0..from.members.len()).map(|i| search.without(from, i));
        out.extend(each.max_by(|a, b| a.score.total_cmp(&b.score)));
    }
    out
}

fn conclude(search: &mut Search<'_, '_>, found: &Found, now: &[Effect], level: f64) -> Answer {
    let mut named = found.named.clone();
    let any = found.any.clone();
    named = renamed(search, named);
    named = with_offset(search, &named);
    // The level holds for the whole answer: a half for names, a half for shapes.
    let level = level / 2.0;
    let chance: Chance = search.chance(if any.score > named.score { &any } else { &named }, ROUNDS);
    // What does not stand out from chance goes, weakest first.
    let whole = rms(&search.residual(&search.empty()).0);
    let mut evidence: Vec<f64>;
    loop {
        let mut rests: Vec<Set> = (0..named.members.len()).map(|i| search.without(&named, i)).collect();
        evidence = rests.iter().map(|rest| search.gain(rest, &named)).collect();
        let now = rms(&search.residual(&named).0);
        let worth: Vec<f64> = rests.iter().map(|rest| rms(&search.residual(rest).0) - now).collect();
        let least = (0..worth.len()).min_by(|a, b| worth[*a].total_cmp(&worth[*b]));
        let slight = |w: &usize| {
            // Where all else that drifts has become noise, the last effect is measured by what it does itself.
            let alone = named.members.len() == 1;
            worth[*w] < WORTH * whole
                && !(alone && search.share(&named, *w).powi(2) > 2.0 * WORTH * whole.powi(2))
        };
        if let Some(w) = least.filter(slight) {
            named = renamed(search, rests.swap_remove(w));
            continue;
        }
        let weakest = (0..evidence.len()).min_by(|a, b| evidence[*a].total_cmp(&evidence[*b]));
        match weakest {
            Some(w) if chance.of_name(evidence[w], named.members.len() == 1) > level => {
                named = rests.swap_remove(w);
            }
            _ => {
                // Several may hold each other up and be worth nothing together.
                let mut chain = fewer(search, &named).into_iter().rev();
                let chances = |s: &Set| chance.of_name(search.gain(s, &named), s.members.is_empty());
                match chain.find(|s| chances(s) > level) {
                    Some(rest) => named = rest,
                    None => break,
                }
            }
        }
    }
    let steadier = search.steadier(&named);
    let equals = steadier.map(|(set, equals)| {
        named = set;
        equals
    });
    if equals.is_none() {
        named = search.with_references(named);
    }
    named = search.bounded(named);
    let left = rms(&search.residual(&named).0);
    let mostly = !named.members.is_empty() && left < EXPLAINED * whole;
    // Names that leave next to nothing, or that the shape only stands beside, keep their place.
    let beside = named.members.iter().all(|m| any.members.iter().any(|a| a.hypothesis == m.hypothesis));
    let kept = mostly && (beside || left < NEARLY_ALL * whole);
    // A shape in place of the names, not beside them, has to be the far better account where they leave little.
    // The more names one shape replaces, the less.
    let each = any.members.len() as f64 / named.members.len().max(1) as f64;
    let needed = if mostly { SHAPE_INSTEAD * each.min(1.0) } else { SHAPE_DECISIVE };
    let mut unexplained: Vec<Shape> = Vec::new();
    if !kept && any.score > named.score + needed {
        // In place of names it is the whole that chance would have to give.
        let from = if beside { named.clone() } else { search.empty() };
        if chance.of_anything(search.gain(&from, &any)) <= level {
            unexplained.extend(any.members.iter().filter_map(|m| m.cause.shape().cloned()));
        }
    }
    let set = if unexplained.is_empty() { named.clone() } else { any.clone() };
    let beta = search.coefficients(&set);
    let mut tried: Vec<Tried> = Vec::new();
    let note = |tried: &mut Vec<Tried>, label: String, odds: f64, accepted: bool| match tried
        .iter_mut()
        .find(|t| t.label == label)
    {
        Some(t) => {
            t.odds = t.odds.max(odds);
            t.accepted |= accepted;
        }
        None => tried.push(Tried { label, odds, accepted }),
    };
    for m in &set.members {
        note(&mut tried, search.all.list[m.hypothesis].label(), 0.0, true);
    }
    if set.members.is_empty() {
        for r in &*search.ranking(&set) {
            let o = &r.offers[0];
            note(&mut tried, search.all.list[o.hypothesis].label(), o.score - set.score, false);
        }
    }
    let mut at = now_len(search);
    let mut findings = Vec::new();
    for (i, m) in set.members.iter().enumerate() {
        let k = m.columns();
        let gamma = &beta[at..at + k];
        at += k;
        let Some(mut effect) = effect_of(&m.cause, gamma).filter(Effect::is_physical) else { continue };
        let own = search.gain(&search.without(&set, i), &set);
        let p_value = chance.of_name(own, set.members.len() == 1);
        // Beside a shape without a name only what reads something else, and stands out by itself, is named.
        let entangled =
            !unexplained.is_empty() && (reads(&effect, &unexplained) || chance.of_anything(own) > level);
        if entangled {
            continue;
        }
        let mut list: Vec<Rival> = Vec::new();
        if let Some(equals) = &equals {
            // What foretells as well, not what fits as well.
            if effect.delta.is_some() {
                list.extend(equals.iter().map(|h| {
                    let h = &search.all.list[*h];
                    Rival { name: h.name.clone(), sensor: h.sensor().cloned(), margin: 0.0 }
                }));
            }
        } else if unexplained.is_empty() {
            let own_name = &search.all.list[m.hypothesis].name;
            let rest = search.without(&set, i);
            let ranking = search.ranking(&rest);
            let top =
                ranking.iter().find(|r| r.name == *own_name).map_or(set.score, |r| r.evidence.max(set.score));
            for r in &*ranking {
                let o = &r.offers[0];
                note(&mut tried, search.all.list[o.hypothesis].label(), o.score - set.score, false);
                let alike = r.name == *own_name;
                let margin = if alike { 0.0 } else { top - r.evidence };
                if margin >= DECISIVE {
                    continue;
                }
                let best = if alike { set.score } else { r.offers[0].score };
                for o in r.offers.iter().filter(|o| o.hypothesis != m.hypothesis && best - o.score < DECISIVE)
                {
                    let instead = search.take(&rest, o);
                    if !search.physical(&instead) {
                        continue;
                    }
                    let h = &search.all.list[o.hypothesis];
                    let margin = margin.max(best - o.score);
                    list.push(Rival { name: h.name.clone(), sensor: h.sensor().cloned(), margin });
                }
            }
            for v in found.visited.iter().filter(|v| set.score - v.score < DECISIVE) {
                let lacks = |h: usize| {
                    !set.members.iter().any(|m| search.all.list[m.hypothesis].name == search.all.list[h].name)
                };
                if v.members.iter().any(|x| x.hypothesis == m.hypothesis) {
                    continue;
                }
                for x in v.members.iter().filter(|x| lacks(x.hypothesis)) {
                    let h = &search.all.list[x.hypothesis];
                    if !list.iter().any(|r| r.name == h.name && r.sensor.as_ref() == h.sensor()) {
                        list.push(Rival {
                            name: h.name.clone(),
                            sensor: h.sensor().cloned(),
                            margin: set.score - v.score,
                        });
                    }
                }
            }
        }
        let held = match &m.cause {
            Cause::Effect { effect, free, .. } if effect.constraints().is_empty() && effect.width() == 1 => {
                let linear = effect.description().parameters.iter().enumerate();
                linear
                    .filter(|(_, p)| p.search == rtec_model::effect::Search::Linear)
                    .enumerate()
                    .filter(|(k, _)| !free.contains(k))
                    .map(|(_, (v, _))| v)
                    .collect()
            }
            _ => Vec::new(),
        };
        if let Cause::Effect { reference: true, .. } = m.cause
            && let Some(level) = level_beside(search, &set, &effect)
        {
            // Another reference temperature and a constant (or a scale) beside the law do the same to these data.
            let name = level.name();
            if effect.delta.as_ref().is_some_and(plausible_reference) {
                list.push(Rival { name, sensor: None, margin: 0.0 });
            } else if let Some(split) = split_reference(&effect, level) {
                effect = split.0;
                findings.push(Finding {
                    effect: split.1,
                    held: Vec::new(),
                    p_value,
                    evidence: own,
                    rivals: Vec::new(),
                });
            }
        }
        list.sort_by(|a, b| a.margin.total_cmp(&b.margin));
        list.truncate(MOST_RIVALS);
        findings.push(Finding { effect, held, p_value, evidence: own, rivals: list });
    }
    findings.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
    tried.sort_by(|a, b| b.accepted.cmp(&a.accepted).then(b.odds.total_cmp(&a.odds)));
    let (residual, phi) = search.residual(if any.score > set.score { &any } else { &set });
    Answer {
        findings,
        unexplained,
        present: now.to_vec(),
        file: Vec::new(),
        anchor: Vec::new(),
        ranking: tried,
        residual,
        phi,
        sigma: search.stack.sigma.clone(),
        draws: chance.draws,
    }
}

/// How far from 20 °C a reference temperature may be and still be one, K.
const REFERENCE_REACH: f64 = 8.0;

fn plausible_reference(delta: &Difference) -> bool {
    use rtec_model::effect::{Against, STANDARD_DEGC};
    matches!(delta.against, Against::Reference(degc) if (degc - STANDARD_DEGC).abs() <= REFERENCE_REACH)
}

/// What does the same as another reference temperature of a thermal effect: an offset, or a scale beside an expansion.
/// None where the set or the model has it.
fn level_beside(search: &Search<'_, '_>, set: &Set, effect: &Effect) -> Option<Effect> {
    let name = level_name(effect);
    if set.members.iter().any(|m| search.all.list[m.hypothesis].name == name) {
        return None;
    }
    search.all.atoms.iter().find_map(|a| match &a.cause {
        Cause::Effect { effect, .. } if effect.name() == name => Some(effect.clone()),
        _ => None,
    })
}

/// The same as a law of the difference from 20 °C beside a constant: c₁(x − d) + c₂(x − d)², with x from 20 °C.
fn split_reference(effect: &Effect, mut level: Effect) -> Option<(Effect, Effect)> {
    use rtec_model::effect::{Against, STANDARD_DEGC};
    let mut own = effect.clone();
    let delta = own.delta.as_mut()?;
    let Against::Reference(degc) = delta.against else { return None };
    delta.against = Against::Standard;
    let d = degc - STANDARD_DEGC;
    let k = own.coefficient_count();
    let first = own.scalar(0);
    let second = if k > 1 { own.scalar(1) } else { 0.0 };
    let mut values = own.values().to_vec();
    values[0] = first - 2.0 * second * d;
    own.set_values(&values).ok()?;
    let name = level.description().parameters[0].name.clone();
    level.set(&name, &[second * d * d - first * d]).ok()?;
    Some((own, level))
}

/// Whether an effect reads what a shape runs along; a temperature runs along time.
fn reads(effect: &Effect, shapes: &[Shape]) -> bool {
    use rtec_model::effect::Need;
    let along = |text: &str| shapes.iter().any(|s| s.against.iter().any(|a| a.starts_with(text)));
    effect.description().needs.iter().any(|n| match n {
        Need::Delta | Need::Time => along("time") || along("temperature"),
        Need::Velocity | Need::Direction | Need::Acceleration => along("velocity") || along("direction"),
        Need::Channel => effect.channel().is_some_and(|c| along(&format!("channel.{c}"))) || along("time"),
        Need::Position(_) => along(&n.role(effect.axes()).to_string()),
        other => along(&other.role(effect.axes()).to_string()),
    })
}

fn now_len(search: &Search<'_, '_>) -> usize {
    search.empty().ids.len()
}
