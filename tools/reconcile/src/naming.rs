//! What the search found gets its names: whatever does not stand out from chance goes, what the data cannot tell from it
//! is listed beside it, and what no name explains becomes a shape.

use crate::anew::along_axes;
use crate::answer::{Answer, Finding, ROUNDS, Rival, Tried};
use crate::cause::{Cause, Shape};
use crate::chance::Chance;
use crate::lanes::dot;
use crate::leftover::{beyond_bounds, knee_instead, slightest, unexplained};
use crate::search::{Found, Member, Search, Set};
use crate::simpler::{ALIKE, DECISIVE, merged, plainer, slimmed, with_offset};
use rtec_model::effect::{self, Against, Difference, Effect, Need, STANDARD_DEGC};

/// The same hypothesis with other values free is taken instead where it is so much better.
const RECHOSEN: f64 = 1.0;
/// So much chance never gives, nats: where all that was found is worth more, a few rounds of noise show it.
const BEYOND_CHANCE: f64 = 60.0;
/// Rounds of noise then.
const FEW_ROUNDS: usize = 12;
/// More waves of one law on an axis are no name.
const NAMED_WAVES: usize = 2;
/// More bumps of one law around a circle are none: they stand for a curve.
const NAMED_BUMPS: usize = 5;
/// Most rivals that are listed for one effect.
const MOST_RIVALS: usize = 12;

/// What was decided on the way to the findings.
struct Conclusion<'f> {
    found: &'f Found,
    set: Set,
    chance: Chance,
    level: f64,
    unexplained: Vec<Shape>,
    /// Where a steadier explanation took the place of what fits best: what predicts as well.
    equals: Option<Vec<usize>>,
}

/// Names what a search found, beside the model as it is now.
pub(crate) fn conclude(search: &mut Search<'_, '_>, found: &Found, now: &[Effect], level: f64) -> Answer {
    let named = renamed(search, found.named.clone());
    let named = along_axes(search, named);
    let named = slimmed(search, named);
    let named = with_offset(search, &named);
    let named = plainer(search, found, named);
    let mut named = merged(search, &named);
    let any = slimmed(search, found.any.clone());
    // The level holds for the whole answer: a half for names, a half for shapes.
    let level = level / 2.0;
    let rounds = if settled(search, &named, &any) { FEW_ROUNDS } else { ROUNDS };
    let chance = search.chance(if any.score > named.score { &any } else { &named }, rounds);
    named = standing_out(search, named, &chance, level);
    let mut equals = None;
    if let Some((set, others)) = search.steadier(&named) {
        (named, equals) = (set, Some(others));
    } else {
        named = search.with_references(named);
        named = level_instead(search, named, &chance, level);
        named = constant_instead(search, named);
    }
    let mut beyond = Vec::new();
    if !search.physical(&named) {
        // Outside its bounds nothing is named, however well it fits: what is left of the set, or the best that a machine may
        // have.
        let full = named.clone();
        let left = search.bounded(named);
        let best = found.visited.iter().find(|set| search.physical(set) && set.score > left.score).cloned();
        let best = standing_out(search, best.unwrap_or_else(|| left.clone()), &chance, level);
        let best = search.bounded(best);
        beyond = beyond_bounds(search, &best, &full, &chance, level);
        // Nothing takes the place of what no machine has.
        named = if beyond.is_empty() { best } else { standing_out(search, left, &chance, level) };
    }
    let (named, crowd) = without_crowds(search, named);
    let mut unexplained = unexplained(search, &named, &any, &chance, level);
    let knee = if unexplained.is_empty() { knee_instead(search, &named) } else { None };
    if let Some(knee) = &knee {
        unexplained.extend(knee.members.iter().filter_map(|m| m.cause.shape().cloned()));
    }
    let set = if unexplained.is_empty() { named } else { knee.unwrap_or_else(|| any.clone()) };
    unexplained.extend(beyond);
    let (set, again) = without_crowds(search, set);
    unexplained.extend(crowd.into_iter().chain(again));
    unexplained.dedup();
    let mut tried = TriedList::of(search, &set);
    let conclusion = Conclusion { found, set, chance, level, unexplained, equals };
    let findings = conclusion.findings(search, &mut tried);
    let Conclusion { set, unexplained, .. } = conclusion;
    let best = if any.score > set.score { any } else { set };
    let evidence = best.score - search.weight();
    // What only wanders slowly makes values less certain; what is left is judged without it.
    let best = search.wandering(true, best);
    let (_, phi) = search.residual(&best);
    let best = search.wandering(false, best);
    let (residual, _) = search.residual(&best);
    Answer {
        findings,
        unexplained,
        present: now.to_vec(),
        file: Vec::new(),
        anchor: Vec::new(),
        ranking: tried.best_first(),
        residual,
        phi,
        sigma: search.stack.sigma.clone(),
        evidence,
    }
}

/// Whether no decision hangs on how often chance alone finds so much: each member is worth far more, or nothing was found.
fn settled(search: &Search<'_, '_>, named: &Set, any: &Set) -> bool {
    let sure = |gain: f64| gain >= BEYOND_CHANCE;
    let members = |set: &Set| (0..set.members.len()).all(|i| sure(search.gain(&search.without(set, i), set)));
    let shapes = any.score - named.score;
    (shapes <= 0.0 || sure(shapes)) && members(named) && members(any)
}

/// Names that were tried.
struct TriedList(Vec<Tried>);

impl TriedList {
    /// The members of a set; where it has none, all that could have joined it.
    fn of(search: &Search<'_, '_>, set: &Set) -> Self {
        let mut tried = Self(Vec::new());
        for m in &set.members {
            tried.note(search.all.list[m.hypothesis].label(), 0.0, true);
        }
        if set.members.is_empty() {
            for r in &*search.ranking(set) {
                let o = &r.offers[0];
                tried.note(search.all.list[o.hypothesis].label(), o.score - set.score, false);
            }
        }
        tried
    }

    fn note(&mut self, label: String, odds: f64, accepted: bool) {
        match self.0.iter_mut().find(|t| t.label == label) {
            Some(t) => {
                t.odds = t.odds.max(odds);
                t.accepted |= accepted;
            }
            None => self.0.push(Tried { label, odds, accepted }),
        }
    }

    fn best_first(mut self) -> Vec<Tried> {
        self.0.sort_by(|a, b| b.accepted.cmp(&a.accepted).then(b.odds.total_cmp(&a.odds)));
        self.0
    }
}

/// What has no name in a crowd: of how many alike, what all of them are that go, and the shape that they stand for.
struct Crowd {
    most: usize,
    of: String,
    shape: Shape,
}

/// What a member is of, where many like it would be no name.
fn crowd(search: &Search<'_, '_>, member: &Member) -> Option<Crowd> {
    let Cause::Effect { effect, .. } = &member.cause else { return None };
    let shape = |response: String, along: String, manner: &str| Shape {
        response,
        against: vec![along],
        manner: manner.into(),
    };
    if effect.description().searched.wave.is_some() {
        let on = effect.axes().first()?;
        let manner = "repeats over the position, no few waves";
        let shape = shape(format!("error.{on}"), format!("position.{on}"), manner);
        return Some(Crowd { most: NAMED_WAVES, of: on.to_string(), shape });
    }
    if effect.description().needs == [Need::Angle] {
        let acts_on = effect.acts_on(&search.stack.records[0]);
        let response = acts_on.first()?.0.to_string();
        let shape = shape(response.clone(), "angle".into(), "runs over the angle, no few bumps");
        return Some(Crowd { most: NAMED_BUMPS, of: response, shape });
    }
    None
}

/// A set without the waves of an axis on which one law has more of them than have a name, and a shape for each such axis:
/// what repeats there is no wave. The same of bumps around a circle.
fn without_crowds(search: &Search<'_, '_>, set: Set) -> (Set, Vec<Shape>) {
    let mut shapes = Vec::new();
    let mut set = set;
    for m in set.members.clone() {
        let Some(Crowd { most, of, shape }) = crowd(search, &m) else { continue };
        if set.members.iter().filter(|o| o.hypothesis == m.hypothesis).count() > most {
            let goes = |o: &Member| crowd(search, o).is_some_and(|c| c.of == of);
            while let Some(i) = set.members.iter().position(goes) {
                set = search.without(&set, i);
            }
            shapes.push(shape);
        }
    }
    (set, shapes)
}

/// A set without what does not stand out from chance.
fn standing_out(search: &mut Search<'_, '_>, named: Set, chance: &Chance, level: f64) -> Set {
    let mut named = named;
    loop {
        let members = named.members.len();
        let wandering = search.wandering(true, named);
        let left = pruned(search, wandering, chance, level);
        named = search.wandering(false, left);
        if named.members.len() == members {
            return named;
        }
        // What is left may have better names now.
        named = renamed(search, named);
    }
}

/// A set without the weakest of what does not stand out from chance, again and again.
fn pruned(search: &Search<'_, '_>, named: Set, chance: &Chance, level: f64) -> Set {
    let mut named = named;
    loop {
        if let Some(slight) = slightest(search, &named) {
            named = search.without(&named, slight);
            continue;
        }
        let mut rests: Vec<Set> = (0..named.members.len()).map(|i| search.without(&named, i)).collect();
        let evidence: Vec<f64> = rests.iter().map(|rest| search.gain(rest, &named)).collect();
        let alone = named.members.len() == 1;
        let constant =
            |i: usize| search.all.list[named.members[i].hypothesis].law().is_some_and(|law| law.constant);
        // Beside others a name is given where the data decide for it; a constant may be another one's own zero.
        let slight = |i: usize| !alone && !constant(i) && evidence[i] < DECISIVE;
        let falls = |i: &usize| slight(*i) || chance.of_name(evidence[*i], alone) > level;
        let weakest = (0..evidence.len()).filter(falls).min_by(|a, b| evidence[*a].total_cmp(&evidence[*b]));
        if let Some(w) = weakest {
            named = rests.swap_remove(w);
            continue;
        }
        // Several may hold each other up and be worth nothing together.
        let chances = |s: &Set| chance.of_name(search.gain(s, &named), s.members.is_empty());
        match fewer(search, &named).into_iter().rev().find(|s| chances(s) > level) {
            Some(rest) => named = rest,
            None => return named,
        }
    }
}

impl Conclusion<'_> {
    /// The set's effects with what the data cannot tell from each, strongest first.
    fn findings(&self, search: &mut Search<'_, '_>, tried: &mut TriedList) -> Vec<Finding> {
        let mut findings = Vec::new();
        for (i, effect) in search.effects(&self.set).into_iter().enumerate() {
            findings.extend(self.parts(search, i));
            let Some(mut effect) = effect.filter(Effect::is_physical) else { continue };
            let member = &self.set.members[i];
            let evidence = search.gain(&search.without(&self.set, i), &self.set);
            if self.entangled(search, i, &effect, evidence) {
                continue;
            }
            let p_value = self.chance.of_name(evidence, self.set.members.len() == 1);
            let mut rivals = self.rivals(search, i, &effect, tried);
            if let Cause::Effect { reference: true, .. } = member.cause
                && let Some(level) = level_beside(search, &self.set, &effect)
            {
                // Another reference temperature and a constant (or a scale) beside the law do the same to these data.
                if effect.delta.as_ref().is_some_and(plausible_reference) {
                    rivals.push(Rival { name: level.name(), sensor: None, differs: None, margin: 0.0 });
                } else if let Some((own, level)) = split_reference(&effect, level) {
                    effect = own;
                    let (held, rivals) = (Vec::new(), Vec::new());
                    findings.push(Finding { effect: level, held, p_value, evidence, rivals });
                }
            }
            let rest = search.without(&self.set, i);
            let period = &effect.description().parameters.first().map_or("", |p| p.name.as_str()).to_owned();
            for (value, margin) in search.other_periods(&rest, &self.set.members[i]) {
                let differs = Some((period.clone(), value));
                rivals.push(Rival { name: effect.name(), sensor: None, differs, margin });
            }
            rivals.sort_by(|a, b| a.margin.total_cmp(&b.margin));
            rivals.truncate(MOST_RIVALS);
            findings.push(Finding { effect, held: held(&member.cause), p_value, evidence, rivals });
        }
        findings.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
        findings
    }

    /// The parts of a sum, none of which can be told from the others.
    fn parts(&self, search: &Search<'_, '_>, member: usize) -> Vec<Finding> {
        let before: usize = self.set.members[..member].iter().map(Member::columns).sum();
        let by = self.set.coefficients()[search.slopes.len() + before];
        let evidence = search.gain(&search.without(&self.set, member), &self.set);
        let p_value = self.chance.of_name(evidence, self.set.members.len() == 1);
        let parts = self.set.members[member].cause.parts(by);
        let others = self.equals.iter().flatten().map(|h| rival(search, *h, 0.0));
        let mut all: Vec<Rival> = parts
            .iter()
            .map(|e| Rival { name: e.name(), sensor: e.delta.clone(), differs: None, margin: 0.0 })
            .collect();
        for o in others {
            if !all.iter().any(|r| r.name == o.name && r.sensor == o.sensor) {
                all.push(o);
            }
        }
        let of = |effect: Effect| {
            let held = (0..effect.values().len()).collect();
            let mut rivals = all.clone();
            rivals.retain(|r| r.sensor != effect.delta);
            rivals.truncate(MOST_RIVALS);
            Finding { effect, held, p_value, evidence, rivals }
        };
        parts.into_iter().map(of).collect()
    }

    /// Beside a shape without a name only what stands out by itself is named, and of what reads the same as the shape only
    /// what does more.
    fn entangled(&self, search: &Search<'_, '_>, member: usize, effect: &Effect, evidence: f64) -> bool {
        if self.unexplained.is_empty() {
            return false;
        }
        let shapes = (0..self.set.members.len()).filter(|i| self.set.members[*i].cause.shape().is_some());
        let theirs = shapes.map(|i| search.share(&self.set, i)).fold(0.0, f64::max);
        let lesser = search.share(&self.set, member) < theirs;
        (reads(effect, &self.unexplained) && lesser) || self.chance.of_anything(evidence) > self.level
    }

    fn rivals(
        &self,
        search: &mut Search<'_, '_>,
        i: usize,
        effect: &Effect,
        tried: &mut TriedList,
    ) -> Vec<Rival> {
        if let Some(equals) = &self.equals {
            // What predicts as well, not what fits as well.
            let equals = equals.iter().filter(|_| effect.delta.is_some());
            return equals.map(|h| rival(search, *h, 0.0)).collect();
        }
        if !self.unexplained.is_empty() {
            return Vec::new();
        }
        let mut rivals = self.ranked(search, i, tried);
        self.visited(search, &self.set.members[i], &mut rivals);
        rivals
    }

    /// What would do as well in a member's place.
    fn ranked(&self, search: &mut Search<'_, '_>, i: usize, tried: &mut TriedList) -> Vec<Rival> {
        let (set, member) = (&self.set, &self.set.members[i]);
        let own = search.all.list[member.hypothesis].name.clone();
        let rest = search.without(set, i);
        let ranking = search.ranking(&rest);
        let top = ranking.iter().find(|r| r.name == own).map_or(set.score, |r| r.evidence.max(set.score));
        let mut rivals = Vec::new();
        for r in &*ranking {
            let label = search.all.list[r.offers[0].hypothesis].label();
            tried.note(label, r.offers[0].score - set.score, false);
            let alike = r.name == own;
            let margin = if alike { 0.0 } else { top - r.evidence };
            if margin >= DECISIVE {
                continue;
            }
            let best = if alike { set.score } else { r.offers[0].score };
            let close = |h: usize, score: f64| h != member.hypothesis && best - score < DECISIVE;
            for o in r.offers.iter().filter(|o| close(o.hypothesis, o.score)) {
                let instead = search.take(&rest, o);
                if search.physical(&instead) {
                    rivals.push(rival(search, o.hypothesis, margin.max(best - o.score)));
                }
            }
        }
        rivals
    }

    /// Whether each member of a set stands out from chance: a set with another in it is no rival.
    fn stands(&self, search: &Search<'_, '_>, set: &Set) -> bool {
        let alone = set.members.len() == 1;
        let gain = |i: usize| search.gain(&search.without(set, i), set);
        (0..set.members.len()).all(|i| self.chance.of_name(gain(i), alone) <= self.level)
    }

    /// Members of other sets that were visited, as good as this one and without this member.
    fn visited(&self, search: &Search<'_, '_>, member: &Member, rivals: &mut Vec<Rival>) {
        let set = &self.set;
        let name = |h: usize| &search.all.list[h].name;
        let lacks = |h: usize| !set.members.iter().any(|m| name(m.hypothesis) == name(h));
        for v in self.found.visited.iter().filter(|v| set.score - v.score < DECISIVE) {
            let has = v.members.iter().any(|x| x.hypothesis == member.hypothesis);
            if has || !search.physical(v) || !self.stands(search, v) {
                continue;
            }
            for x in v.members.iter().filter(|x| lacks(x.hypothesis)) {
                let rival = rival(search, x.hypothesis, set.score - v.score);
                if !rivals.iter().any(|r| r.name == rival.name && r.sensor == rival.sensor) {
                    rivals.push(rival);
                }
            }
        }
    }
}

/// A hypothesis as another explanation.
fn rival(search: &Search<'_, '_>, hypothesis: usize, margin: f64) -> Rival {
    let h = &search.all.list[hypothesis];
    Rival { name: h.name.clone(), sensor: h.sensor().cloned(), differs: None, margin }
}

/// Linear parameters that a cause does not let free.
fn held(cause: &Cause) -> Vec<usize> {
    let Cause::Effect { effect, free, .. } = cause else { return Vec::new() };
    if !effect.constraints().is_empty() || effect.width() != 1 {
        return Vec::new();
    }
    let parameters = effect.description().parameters.iter().enumerate();
    let linear = parameters.filter(|(_, p)| p.search == effect::Search::Linear).map(|(v, _)| v);
    linear.enumerate().filter(|(k, _)| !free.contains(k)).map(|(_, v)| v).collect()
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
            // The same with other values free is a better name, too.
            let alike = offer.hypothesis == member && offer.score < named.score + RECHOSEN;
            if alike || !better {
                continue;
            }
            let next = search.take(&rest, &offer);
            named = search.polish(next);
            changed = true;
            break;
        }
        if !changed {
            break;
        }
    }
    named
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

/// How far from 20 °C a reference temperature may be and still be one, K.
const REFERENCE_REACH: f64 = 8.0;

fn plausible_reference(delta: &Difference) -> bool {
    matches!(delta.against, Against::Reference(degc) if (degc - STANDARD_DEGC).abs() <= REFERENCE_REACH)
}

/// What does the same as another reference temperature of a thermal effect: an offset, or a scale beside an expansion.
/// None where the set or the model has it.
fn level_beside(search: &Search<'_, '_>, set: &Set, effect: &Effect) -> Option<Effect> {
    let name = effect.companion()?.name();
    if set.members.iter().any(|m| search.all.list[m.hypothesis].name == name) {
        return None;
    }
    search.all.atoms.iter().find_map(|a| match &a.cause {
        Cause::Effect { effect, .. } if effect.name() == name => Some(effect.clone()),
        _ => None,
    })
}

/// The set with the constant alone in place of a thermal law whose reference temperature took the constant in, where what the
/// law does beyond that is no more than chance gives: a constant and a temperature that wanders are no growth.
fn level_instead(search: &mut Search<'_, '_>, named: Set, chance: &Chance, level: f64) -> Set {
    let mut named = named;
    for i in (0..named.members.len()).rev() {
        let Cause::Effect { reference: true, .. } = named.members[i].cause else { continue };
        let effect = search.effects(&named).swap_remove(i);
        let Some(constant) = effect.and_then(|e| level_beside(search, &named, &e)) else { continue };
        let name = constant.name();
        let rest = search.without(&named, i);
        let Some(own) = search.all.list.iter().position(|h| h.name == name) else { continue };
        let Some(offer) = search.offer_of(&rest, own) else { continue };
        let instead = search.take(&rest, &offer);
        let gain = search.gain(&instead, &named);
        if gain < DECISIVE || chance.of_name(gain, false) > level {
            named = instead;
        }
    }
    named
}

/// The set with an axis's zero in place of what comes to no more on these rows: a drift that has ended after two rows, counts that were
/// lost before the third. The data do not decide between them, and the zero has no value that they do not tell.
fn constant_instead(search: &mut Search<'_, '_>, named: Set) -> Set {
    let all = search.all;
    let mut named = named;
    for i in (0..named.members.len()).rev() {
        let Some(effect) = &all.list[named.members[i].hypothesis].effect else { continue };
        let zero = |h: &usize| {
            let of = all.list[*h].effect.as_ref().filter(|_| all.list[*h].is_offset());
            of.is_some_and(|zero| zero.axes().first() == effect.axes().first())
        };
        let Some(zero) = (0..all.list.len()).find(zero) else { continue };
        if named.members.iter().any(|m| m.hypothesis == zero) {
            continue;
        }
        let rest = search.without(&named, i);
        let Some(offer) = search.offer_of(&rest, zero).filter(|o| o.score > named.score - DECISIVE) else {
            continue;
        };
        let instead = search.take(&rest, &offer);
        let (does, level) = (search.does(&named, i), search.does(&instead, rest.members.len()));
        if dot(&does, &level).powi(2) > ALIKE * dot(&does, &does) * dot(&level, &level) {
            named = instead;
        }
    }
    named
}

/// The same as a law of the difference from 20 °C beside a constant: c₁(x − d) + c₂(x − d)², with x from 20 °C.
fn split_reference(effect: &Effect, mut level: Effect) -> Option<(Effect, Effect)> {
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
    level = level.with(&[(0, second * d * d - first * d)])?;
    Some((own, level))
}

/// Whether an effect reads what a shape runs along; a temperature runs along time.
fn reads(effect: &Effect, shapes: &[Shape]) -> bool {
    let along = |text: &str| shapes.iter().any(|s| s.against.iter().any(|a| a.starts_with(text)));
    effect.description().needs.iter().any(|n| match n {
        Need::Delta | Need::Time => along("time") || along("temperature"),
        Need::Velocity | Need::Direction | Need::Acceleration => along("velocity") || along("direction"),
        Need::Channel => effect.channel().is_some_and(|c| along(&format!("channel.{c}"))) || along("time"),
        Need::Position(_) => along(&n.role(effect.axes()).to_string()),
        other => along(&other.role(effect.axes()).to_string()),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rtec_model::effect::Dictionary;

    fn growth(against: Against, values: &[f64]) -> Effect {
        let mut effect = Dictionary::default().effect("thermal_growth.z").unwrap();
        effect.delta = Some(Difference { sensor: "T1".into(), against });
        effect.set_values(values).unwrap();
        effect
    }

    /// Growth from a reference that no machine has is growth from 20 °C and an offset: the same at every temperature.
    #[test]
    fn a_reference_that_is_none_is_an_offset() {
        let effect = growth(Against::Reference(36.0), &[2.0, 0.1]);
        assert!(!plausible_reference(effect.delta.as_ref().unwrap()));
        let (own, level) = split_reference(&effect, effect.companion().unwrap()).unwrap();
        assert_eq!(
            (own.delta.as_ref().unwrap(), level.name().as_str()),
            (&Difference::single("T1"), "offset.z")
        );
        let at = |e: &Effect, d: f64| e.scalar(0) * d + e.scalar(1) * d * d;
        for degc in [18.0, 25.0, 40.0] {
            let split = at(&own, degc - 20.0) + level.scalar(0);
            assert!((at(&effect, degc - 36.0) - split).abs() < 1e-9, "{degc} °C");
        }
        assert!(plausible_reference(&Difference { sensor: "T1".into(), against: Against::Reference(23.0) }));
    }

    /// Beside a shape along the time nothing is named that follows time or temperature.
    #[test]
    fn what_reads_what_a_shape_runs_along_is_entangled_with_it() {
        let shape = |against: &str| {
            vec![Shape { response: "error.z".into(), against: vec![against.into()], manner: "smooth".into() }]
        };
        let warm = growth(Against::Standard, &[1.0, 0.0]);
        let scale = Dictionary::default().effect("scale.z").unwrap();
        assert!(reads(&warm, &shape("time")) && reads(&warm, &shape("temperature.T4")));
        assert!(reads(&scale, &shape("position.z")));
        assert!(!reads(&scale, &shape("time")) && !reads(&warm, &shape("position.z")));
    }

    #[test]
    fn what_a_grid_point_leaves_out_is_held() {
        let effect = growth(Against::Standard, &[1.0, 0.0]);
        let cause = |free: Vec<usize>| Cause::Effect { effect: effect.clone(), free, reference: false };
        assert_eq!((held(&cause(vec![0])), held(&cause(vec![0, 1]))), (vec![1], vec![]));
    }
}
