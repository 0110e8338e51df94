//! Alternates noise and search until both settle; then names, values and intervals.

use crate::cause::{Cause, Shape};
use crate::effort::{
    HOPELESS, LAST_STEPS, MOMENT_ROWS, NOISE_STEPS, REMEMBERS, ROUNDS, SETTLED, STRONG, UNDER_NOISE,
};
use crate::family::{Families, Scan};
use crate::priors::{HELD, LISTED, MOST_PHI, SAME_PERIOD};
use crate::problem::{Problem, Units, in_step, is_beyond_chance};
use crate::rows::{Noise, Rows};
use crate::search::{Member, Search, Set, fit, known_again};
use crate::setup;
use crate::wander::{self, Wander, wanders};
use rtec_least_squares::dot;
use rtec_model::effect::{Dictionary, Difference, Effect, Refine, Search as How};
use rtec_model::machine::NORMAL_95;
use rtec_model::record::{Record, Role};

/// Another explanation of the same thing.
#[derive(Debug, Clone, PartialEq)]
pub struct Rival {
    /// Name of the effect.
    pub name: String,
    /// Its temperature difference, where it has one.
    pub sensor: Option<Difference>,
    /// The value that differs where the name is the same: a parameter, in its own unit.
    pub differs: Option<(String, f64)>,
    /// Log odds by which the explanation given is better.
    pub margin: f64,
}

impl Rival {
    /// Its name, with what it reads or the value that differs.
    #[must_use]
    pub fn label(&self) -> String {
        let sensor = self.sensor.as_ref().map_or_else(String::new, |d| format!(" ({d})"));
        let differs = self.differs.as_ref().map_or_else(String::new, |(key, v)| format!(" ({key} = {v:.4})"));
        format!("{}{sensor}{differs}", self.name)
    }
}

/// A member of the likeliest set.
#[derive(Debug, Clone)]
pub struct Found {
    /// The effect with its values; none where it is a shape.
    pub effect: Option<Effect>,
    /// The shape.
    pub shape: Option<Shape>,
    /// The effect of the model that it replaces.
    pub replaces: Option<usize>,
    /// Half widths of its 95 % intervals, value by value.
    pub half: Vec<f64>,
    /// Values that were not estimated.
    pub held: Vec<usize>,
    /// Log odds of the set with it against the set without it.
    pub evidence: f64,
    /// Posterior share of the name among all candidates for its place, 0 to 1.
    pub name_mass: f64,
    /// Posterior share of this mode within its name.
    pub mode_mass: f64,
    /// Posterior share of shapes without a name for its place.
    pub shape_mass: f64,
    /// For a step in time: the 95 % interval of its moment.
    pub moments: Option<[f64; 2]>,
    /// What else it might be, likeliest first.
    pub rivals: Vec<Rival>,
}

/// A known effect of the model that the rows correct.
#[derive(Debug, Clone)]
pub struct Moved {
    /// Its place in the model.
    pub place: usize,
    /// The effect as estimated from the rows.
    pub after: Effect,
    /// Half widths of its 95 % intervals, value by value.
    pub half: Vec<f64>,
    /// Whether it moved beyond chance.
    pub beyond_chance: bool,
}

/// What was found of a record's set-up.
#[derive(Debug, Clone, PartialEq)]
pub struct SetUp {
    /// Which record.
    pub record: usize,
    /// Which response.
    pub response: String,
    /// What.
    pub what: setup::What,
    /// Its value, in its unit.
    pub value: f64,
    /// Half width of its 95 % interval.
    pub half: f64,
}

/// A name that was tried.
#[derive(Debug, Clone)]
pub struct Tried {
    /// Name, with its sensors.
    pub label: String,
    /// Log odds against what was accepted in its place.
    /// Names far below the best were only looked at quickly.
    pub odds: f64,
    /// Whether it is in the answer.
    pub accepted: bool,
    /// What was accepted in its place.
    pub place: String,
}

/// The answer.
#[derive(Debug, Clone)]
pub struct Estimate {
    /// The members of the likeliest set, strongest first.
    pub found: Vec<Found>,
    /// The model's own effects as the rows have them.
    pub known: Vec<Moved>,
    /// Set-ups.
    pub set_up: Vec<SetUp>,
    /// The noise.
    pub noise: Noise,
    /// The whitened residual.
    pub residual: Vec<f64>,
    /// log p(y, S), up to a constant of the rows.
    pub score: f64,
    /// Names that were tried.
    pub tried: Vec<Tried>,
    /// The members of the likeliest set, as a start for the analysis of other records.
    pub members: Vec<Member>,
}

/// Estimates what the records support beside a model.
/// `intervals` are the half widths that the model states, effect by effect and value by value.
#[must_use]
pub fn estimate(
    records: &[Record],
    dictionary: &Dictionary,
    model: &[Effect],
    intervals: &[Vec<Option<f64>>],
) -> Estimate {
    let rows = Rows::new(records);
    let given = model;
    let model = &in_step(&rows, model)[..];
    let mut problem = Problem::new(&rows, model, intervals);
    let mut families = Families::new(&rows, dictionary, model);
    let noise = problem.first_noise();
    let (mut found, mut left) = settle(&problem, &mut families, noise.clone(), None, model);
    // A slow signal is autocorrelated noise or an effect. Both are followed, and the likelier one is kept.
    if let Some(other) = noise.without_memory().filter(|_| !left.is_empty()) {
        let (second, members) = settle(&problem, &mut families, other, None, model);
        if second.score > found.score {
            (found, left) = (second, members);
        }
    }
    let wanders = wanders(&problem, &found.noise, &found.residual);
    if !wanders.is_empty() {
        if found.found.iter().any(|f| f.effect.is_some()) {
            // A name need not explain what a walk already explains.
            for w in &wanders {
                problem.terms.extend(wander::terms(&rows, w));
            }
            (found, _) = settle(&problem, &mut families, found.noise, Some(left), model);
        }
        for w in &wanders {
            found.found.push(Found::wander(&rows, w));
        }
    }
    for k in &mut found.known {
        k.beyond_chance |= model[k.place] != given[k.place];
    }
    found
}

/// Log evidence of the best explanation of the records, from given members.
/// The search gives up far below `enough`.
#[must_use]
pub fn score(
    records: &[Record],
    dictionary: &Dictionary,
    model: &[Effect],
    intervals: &[Vec<Option<f64>>],
    start: &[Member],
    units: Units,
    enough: f64,
) -> f64 {
    let rows = Rows::new(records);
    let model = &in_step(&rows, model)[..];
    let problem = Problem::new(&rows, model, intervals).in_units(units);
    let mut families = Families::new(&rows, dictionary, model);
    let start = known_again(&families, start);
    let noise = under(&problem, &start, problem.first_noise()).1;
    let mut best = f64::NEG_INFINITY;
    let goes_on = |search: &Search<'_>, set: &Set| {
        best = best.max(with_own_noise(search, set).0);
        best > enough - 2.0 * STRONG
    };
    settled(&problem, &mut families, noise, Some(start), goes_on, |_, _| ());
    best
}

/// Alternates search and noise until neither changes.
/// Returns the estimate and its members.
fn settle(
    problem: &Problem<'_>,
    families: &mut Families,
    first: Noise,
    start: Option<Vec<Member>>,
    model: &[Effect],
) -> (Estimate, Vec<Member>) {
    settled(
        problem,
        families,
        first,
        start,
        |_, _| true,
        |search, set| (answer(search, set, model), set.members.clone()),
    )
}

/// As `settle`, with callbacks.
/// After each round `goes_on` says whether to continue; `then` is called once both have settled.
fn settled<T>(
    problem: &Problem<'_>,
    families: &mut Families,
    first: Noise,
    start: Option<Vec<Member>>,
    mut goes_on: impl FnMut(&Search<'_>, &Set) -> bool,
    then: impl Fn(&Search<'_>, &Set) -> T,
) -> T {
    let rows = problem.rows;
    let mut noise = first;
    let mut members = start;
    let anew = members.is_none();
    let mut exchanged = false;
    for round in 0..ROUNDS {
        families.bank.whiten(rows, &noise);
        let search = Search::new(problem, families, problem.base(noise.clone()));
        // Under another noise a size may be impossible.
        let start = members.take().map(|m| search.of(m)).filter(|s| search.possible(s));
        let start = start.unwrap_or_else(|| search.nothing());
        let set = search.best(&start, anew && round == 0);
        if !goes_on(&search, &set) {
            return then(&search, &set);
        }
        if let Some((better, own)) = under_own_noise(&search, &set)
            && round + 1 < ROUNDS
        {
            noise = own;
            members = Some(better.members);
            continue;
        }
        let renewed = problem.renewed(&noise, &set.factor);
        let settled = (0..noise.sigma.len()).all(|j| {
            (renewed.sigma[j] / noise.sigma[j] - 1.0).abs() < SETTLED.0
                && (renewed.phi[j] - noise.phi[j]).abs() < SETTLED.1
        });
        if settled && round + 1 < ROUNDS && !exchanged {
            // Only once, when the noise is known, because exchanges take longest.
            exchanged = true;
            let other = search.exchanged(&set);
            if other.score > set.score + 0.05 {
                noise = problem.renewed(&noise, &other.factor);
                members = Some(other.members);
                continue;
            }
        }
        if settled || round + 1 == ROUNDS {
            return then(&search, &set);
        }
        noise = renewed;
        members = Some(set.members);
    }
    unreachable!("the last round answers")
}

/// Log evidence of a set under the noise that it leaves, and that noise.
fn with_own_noise(search: &Search<'_>, set: &Set) -> (f64, Noise) {
    under(search.problem, &set.members, search.problem.renewed(&search.base.noise, &set.factor))
}

/// Log evidence of members under the noise that they leave, and that noise.
/// It starts from a first guess of the noise.
fn under(problem: &Problem<'_>, members: &[Member], mut noise: Noise) -> (f64, Noise) {
    let mut total = f64::NEG_INFINITY;
    for _ in 0..NOISE_STEPS {
        let base = problem.base(noise.clone());
        let mut factor = base.factor.clone();
        for m in members {
            for mut c in m.cause.columns(problem.rows) {
                for x in &mut c {
                    *x *= m.level;
                }
                noise.whiten(problem.rows, &mut c);
                factor.push(&c);
            }
        }
        let prior: f64 = members.iter().map(|m| m.prior).sum();
        let freedom = base.freedom;
        total = fit(factor.left(), freedom) - factor.half_log_det()
            + prior
            + problem.log_scale(&noise)
            + noise.log_prior();
        noise = problem.renewed(&noise, &factor);
    }
    (total, noise)
}

/// Finds members that the noise model has absorbed.
/// Returns a set with one member more, under the noise that it leaves.
fn under_own_noise(search: &Search<'_>, set: &Set) -> Option<(Set, Noise)> {
    let look = search.look_at(set);
    let seeds = search.seeds(set, &look, false);
    let (now, _) = with_own_noise(search, set);
    let mut best: Option<(f64, Set, Noise)> = None;
    for seed in seeds.iter().take(UNDER_NOISE).filter(|s| s.score > -HOPELESS) {
        let Some(with) = search.with(set, &search.refined(&set.factor, seed)) else { continue };
        let (total, noise) = with_own_noise(search, &with);
        if total > best.as_ref().map_or(now, |b| b.0) {
            best = Some((total, with, noise));
        }
    }
    best.map(|(_, set, noise)| (set, noise))
}

fn log_sum(values: &[f64]) -> f64 {
    let top = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if top == f64::NEG_INFINITY {
        top
    } else {
        top + values.iter().map(|v| (v - top).exp()).sum::<f64>().ln()
    }
}

fn label(effect: &Effect) -> String {
    match &effect.delta {
        Some(d) => format!("{} ({d})", effect.name()),
        None => effect.name(),
    }
}

/// What could stand in the place of one member.
struct Place {
    found: Found,
    tried: Vec<Tried>,
    nothing: bool,
}

fn answer(search: &Search<'_>, set: &Set, model: &[Effect]) -> Estimate {
    let mut set = set.clone();
    let (mut found, mut tried) = (Vec::new(), Vec::new());
    let mut i = 0;
    while i < set.members.len() {
        let place = place(search, &set, i);
        if place.nothing {
            let without = search.without(&set, i);
            if search.possible(&without) {
                set = without;
                (i, found, tried) = (0, Vec::new(), Vec::new());
                continue;
            }
        }
        found.push(place.found);
        tried.extend(place.tried);
        i += 1;
    }
    let last = Last::new(search, &set, model);
    last.fill(&mut found);
    Last::tie_periods(&mut found);
    let known = last.known(&found);
    let mut set_up = last.set_up();
    set_up.extend(last.jumps(search, &found));
    let set_up_member = |i: &usize| search.families.list[set.members[*i].family].set_up;
    let mut order: Vec<usize> = (0..found.len()).filter(|i| !set_up_member(i)).collect();
    order.sort_by(|a, b| found[*b].evidence.total_cmp(&found[*a].evidence));
    let found = order.into_iter().map(|i| found[i].clone()).collect();
    tried.sort_by(|a: &Tried, b: &Tried| b.odds.total_cmp(&a.odds));
    let mut seen = Vec::new();
    tried.retain(|t| {
        !seen.contains(&t.label) && {
            seen.push(t.label.clone());
            true
        }
    });
    Estimate {
        found,
        known,
        set_up,
        noise: search.base.noise.clone(),
        residual: set.factor.residual().to_vec(),
        score: with_own_noise(search, &set).0,
        tried,
        members: set.members,
    }
}

/// A candidate for a place: family, label, effect, log mass.
type Stand = (usize, String, Option<Effect>, f64);

/// Adds the maps that are equivalent at these rows.
/// Each gets the mass of its prior relative to the member's.
fn add_alike_maps(search: &Search<'_>, set: &Set, member: usize, all: &mut Vec<Stand>) {
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

/// The posterior of one place: all that could stand there beside the other members.
fn place(search: &Search<'_>, set: &Set, member: usize) -> Place {
    let own = &set.members[member];
    let without = search.without(set, member);
    let look = search.look_at(&without);
    let seeds = search.seeds(&without, &look, true);
    let families = &search.families.list;
    let own_label = own.cause.effect().map_or_else(|| families[own.family].label(), label);
    // Family, label, effect, log mass.
    let mut all: Vec<Stand> = vec![(own.family, own_label.clone(), own.cause.effect().cloned(), set.score)];
    let top = seeds.first().map_or(0.0, |s| s.score).max(set.score - without.score);
    let far = seeds.iter().position(|s| s.score < top - HOPELESS - 2.0).unwrap_or(seeds.len());
    for seed in &seeds[..far] {
        let refined = search.refined(&without.factor, seed);
        let name = refined.cause.effect().map_or_else(|| families[seed.family].label(), label);
        let same_mode = seed.family == own.family && same_place(&own.cause, &refined.cause);
        if same_mode {
            continue;
        }
        if let Some(other) = search.with(&without, &refined) {
            all.push((seed.family, name, refined.cause.effect().cloned(), other.score));
        }
    }
    for seed in search.alike(own) {
        let refined = search.refined(&without.factor, &seed);
        let seen = |a: &Stand| {
            a.0 == seed.family
                && a.2.as_ref().zip(refined.cause.effect()).is_some_and(|(a, b)| same_period(a, b))
        };
        if !all.iter().any(seen)
            && let Some(other) = search.with(&without, &refined)
        {
            all.push((seed.family, own_label.clone(), refined.cause.effect().cloned(), other.score));
        }
    }
    add_alike_maps(search, set, member, &mut all);
    let masses: Vec<f64> = all.iter().map(|a| a.3).chain([without.score]).collect();
    let total = log_sum(&masses);
    let of = |yes: &dyn Fn(&Stand) -> bool| {
        let own: Vec<f64> = all.iter().filter(|a| yes(a)).map(|a| a.3).collect();
        (log_sum(&own) - total).exp()
    };
    let name = families[own.family].label();
    let name_mass = of(&|a| families[a.0].label() == name);
    let shape_mass = of(&|a| !families[a.0].is_named());
    let mode = (set.score - total).exp();
    let evidence = set.score - without.score;
    let mut rivals = Vec::new();
    let tried = |label: &str, odds: f64, accepted: bool| Tried {
        label: label.to_owned(),
        odds,
        accepted,
        place: own_label.clone(),
    };
    let mut all_tried = vec![tried(&own_label, 0.0, true)];
    for (family, label, effect, score) in all.iter().skip(1) {
        let margin = set.score - score;
        all_tried.push(tried(label, -margin, false));
        let Some(effect) =
            effect.as_ref().filter(|_| margin < LISTED && families[*family].replaces.is_none())
        else {
            continue;
        };
        let differs = (*family == own.family && effect.delta.is_none()).then(|| {
            let p = effect.description().parameters.iter().position(|p| p.tells_apart)?;
            Some((effect.description().parameters[p].name.clone(), effect.scalar(p)))
        });
        rivals.push(Rival {
            name: effect.name(),
            sensor: effect.delta.clone(),
            differs: differs.flatten(),
            margin,
        });
    }
    // Seeds far below the best were only looked at quickly.
    for seed in &seeds[far..] {
        let name = seed.cause.effect().map_or_else(|| families[seed.family].label(), label);
        all_tried.push(tried(&name, seed.score - evidence, false));
    }
    rivals.sort_by(|a, b| a.margin.total_cmp(&b.margin));
    let moments = moments(search, &without, own);
    let found = Found {
        moments,
        effect: own.cause.effect().filter(|_| families[own.family].replaces.is_none()).cloned(),
        shape: match &own.cause {
            Cause::Shape(both) => Some(both.0.clone()),
            _ => None,
        },
        replaces: families[own.family].replaces,
        half: Vec::new(),
        held: Vec::new(),
        evidence,
        name_mass,
        mode_mass: (mode / name_mass.max(1e-300)).min(1.0),
        shape_mass,
        rivals,
    };
    Place { found, tried: all_tried, nothing: evidence < 0.0 }
}

/// The 95 % interval of a step's moment, over the moments of the rows.
fn moments(search: &Search<'_>, without: &Set, own: &Member) -> Option<[f64; 2]> {
    use rtec_model::effect::Extent as _;
    let effect = own.cause.effect()?;
    let p = effect.description().parameters.iter().position(|p| p.refine == Refine::Moment)?;
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
    let total = log_sum(&mass);
    let mut order: Vec<usize> = (0..near.len()).collect();
    order.sort_by(|a, b| mass[*b].total_cmp(&mass[*a]));
    let (mut held, mut range) = (0.0, [f64::MAX, f64::MIN]);
    for i in order {
        // The step came after the row before.
        let before = all[(at.saturating_sub(MOMENT_ROWS) + i).saturating_sub(1)];
        range = [range[0].min(before), range[1].max(near[i])];
        held += (mass[i] - total).exp();
        if held >= HELD {
            break;
        }
    }
    Some(range)
}

/// Whether two waves of one law are one mode.
fn same_period(a: &Effect, b: &Effect) -> bool {
    (a.scalar(0) / b.scalar(0) - 1.0).abs() < SAME_PERIOD
}

/// Whether two causes of one family are one mode.
fn same_place(a: &Cause, b: &Cause) -> bool {
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
            Refine::TimeConstant(_) | Refine::Factor(_) => (x / y).ln().abs() < 1.0,
            Refine::Step(s) => (x - y).abs() < 4.0 * s,
            Refine::Moment => true,
            Refine::Stays => (x / y - 1.0).abs() < SAME_PERIOD,
        }
    })
}

/// The last fit: all linear and non-linear parameters together.
struct Last<'s, 'p> {
    search: &'s Search<'p>,
    model: &'s [Effect],
    members: Vec<Solved>,
    left: f64,
    inverse: Vec<Vec<f64>>,
    beta: Vec<f64>,
}

/// A member of the last fit.
struct Solved {
    cause: Cause,
    /// Size of its prior, in typical sizes.
    level: f64,
    /// Where its columns begin; its linear ones, then its non-linear ones.
    at: usize,
    width: usize,
    bent: Vec<Bent>,
    /// Coefficients that the rows did not require.
    /// For each: number, place among the columns, and its standard deviation in its own unit.
    left_out: Vec<(usize, usize, f64)>,
}

impl Solved {
    /// Coefficients in standard deviations of the cause's columns.
    fn linear(&self, beta: &[f64]) -> Vec<f64> {
        beta[self.at..self.at + self.width].iter().map(|b| b * self.level).collect()
    }
}

/// A non-linear value in the last fit.
struct Bent {
    /// Which value.
    value: usize,
    /// What one standard deviation of it is.
    sd: f64,
    /// Another value that moves with it, and by how much per unit.
    /// A wave's phase moves with its period, so that the wave stays where it is amid the places.
    with: Option<(usize, f64)>,
}

/// Non-linear values that the last fit moves, with their standard deviations.
fn bent(search: &Search<'_>, family: usize, effect: &Effect) -> Vec<Bent> {
    let family = &search.families.list[family];
    if family.replaces.is_some() || effect.width() > 1 || matches!(family.scan, Scan::Beside { .. }) {
        return Vec::new();
    }
    let law = effect.description();
    let of = |(value, p): (usize, &rtec_model::effect::Parameter)| {
        if p.search != How::Smooth {
            return None;
        }
        let v = effect.scalar(value);
        let (sd, with) = match (&family.scan, p.refine) {
            (_, Refine::Step(_)) => (1.0, None),
            (Scan::Wave { along, unit, .. }, _) => {
                let turns = std::f64::consts::TAU * along.middle() / unit / (v * v);
                (0.1 * v, law.place(How::Phase).map(|phase| (phase, turns)))
            }
            _ => (v.abs(), None),
        };
        Some(Bent { value, sd, with })
    };
    law.parameters.iter().enumerate().filter_map(of).collect()
}

impl<'s, 'p> Last<'s, 'p> {
    fn new(search: &'s Search<'p>, set: &Set, model: &'s [Effect]) -> Self {
        let mut causes: Vec<Cause> = set.members.iter().map(|m| m.cause.clone()).collect();
        let mut best: Option<Self> = None;
        let beta = search.coefficients(set);
        let mut solved: Vec<Option<Effect>> =
            causes.iter().zip(&beta).map(|(c, b)| c.solved(search.problem.rows, b)).collect();
        for _ in 0..LAST_STEPS {
            let last = Self::fit(search, set, model, &causes, &solved);
            if best.as_ref().is_some_and(|b| last.left > b.left + 0.01) {
                break;
            }
            let mut next = causes.clone();
            let mut moved = false;
            solved.clear();
            for (k, m) in last.members.iter().enumerate() {
                let mut now = m.cause.solved(search.problem.rows, &m.linear(&last.beta));
                if let Some(effect) = m.cause.effect() {
                    let mut set: Vec<(usize, f64)> = Vec::new();
                    for (b, bent) in m.bent.iter().enumerate() {
                        let v = effect.scalar(bent.value);
                        let most = 0.2 * v.abs().max(0.3);
                        let by = (last.beta[m.at + m.width + b] * bent.sd).clamp(-most, most);
                        set.push((bent.value, v + by));
                        if let Some((w, per)) = bent.with {
                            now = now.and_then(|e| e.with(&[(w, e.scalar(w) + per * by)]));
                        }
                    }
                    if let Some(effect) = effect.with(&set).filter(|_| !set.is_empty()) {
                        next[k] = m.cause.with_effect(effect);
                        now = now.and_then(|e| e.with(&set));
                        moved = true;
                    }
                }
                solved.push(now);
            }
            best = Some(last);
            causes = next;
            if !moved {
                break;
            }
        }
        best.unwrap_or_else(|| Self::fit(search, set, model, &causes, &solved))
    }

    fn fit(
        search: &'s Search<'p>,
        set: &Set,
        model: &'s [Effect],
        causes: &[Cause],
        solved: &[Option<Effect>],
    ) -> Self {
        let rows = search.problem.rows;
        let mut factor = search.base.factor.clone();
        let mut members = Vec::new();
        for ((cause, m), solved) in causes.iter().zip(&set.members).zip(solved) {
            let at = factor.len();
            let columns = search.columns(cause);
            let width = columns.len();
            for mut c in columns {
                for x in &mut c {
                    *x *= m.level;
                }
                factor.push(&c);
            }
            let mut own = Vec::new();
            if let Some(effect) = solved {
                own = bent(search, m.family, effect);
                let slopes = if own.is_empty() { Vec::new() } else { rows.slopes(effect) };
                for b in &own {
                    let mut c: Vec<f64> = slopes[b.value].iter().map(|x| x * b.sd).collect();
                    if let Some((with, per)) = b.with {
                        rtec_least_squares::add(&mut c, per * b.sd, &slopes[with]);
                    }
                    search.base.noise.whiten(rows, &mut c);
                    factor.push(&c);
                }
            }
            let cause = cause.clone();
            members.push(Solved { cause, level: m.level, at, width, bent: own, left_out: Vec::new() });
        }
        let beta = factor.solve();
        let left = factor.left();
        // Values are less certain beside possible further effects, and where all rows of one reading share an error.
        for m in &mut members {
            for (k, size, mut c) in m.cause.left_out(rows) {
                let sd = size * m.level;
                for x in &mut c {
                    *x *= sd;
                }
                search.base.noise.whiten(rows, &mut c);
                m.left_out.push((k, factor.len(), sd));
                factor.push(&c);
            }
        }
        for t in &search.rounding {
            let mut c: Vec<f64> = t.column.iter().map(|x| x * t.sd).collect();
            search.base.noise.whiten(rows, &mut c);
            factor.push(&c);
        }
        let inverse = factor.inverse();
        Self { search, model, members, left, inverse, beta }
    }

    fn covariance(&self, i: usize, j: usize) -> f64 {
        dot(&self.inverse[i], &self.inverse[j])
    }

    /// Squared distance of these coefficients from zero, in standard deviations.
    fn distance(&self, coefficients: &[usize]) -> f64 {
        let mut axes: Vec<(Vec<f64>, f64)> = Vec::new();
        for i in coefficients {
            let (mut left, mut beta) = (self.inverse[*i].clone(), self.beta[*i]);
            for (axis, along) in &axes {
                let share = dot(axis, &left);
                rtec_least_squares::add(&mut left, -share, axis);
                beta -= share * along;
            }
            let sd = dot(&left, &left).sqrt();
            if sd > 0.0 {
                axes.push((left.iter().map(|x| x / sd).collect(), beta / sd));
            }
        }
        axes.iter().map(|(_, along)| along * along).sum()
    }

    /// Values and half widths of the members.
    fn fill(&self, found: &mut [Found]) {
        let rows = self.search.problem.rows;
        for (f, m) in found.iter_mut().zip(&self.members) {
            if f.effect.is_none() {
                continue;
            }
            let linear = m.linear(&self.beta);
            let Some(mut effect) = m.cause.solved(rows, &linear) else { continue };
            let n = effect.values().len();
            // What one standard deviation of each column is in each value.
            let mut jacobian: Vec<(usize, Vec<f64>)> = Vec::new();
            for k in 0..m.width {
                let mut row = vec![0.0; n];
                let sd = self.covariance(m.at + k, m.at + k).sqrt() * m.level;
                let step = 1e-3 * sd;
                let at = |by: f64| {
                    let mut b = linear.clone();
                    b[k] += by;
                    m.cause.solved(rows, &b)
                };
                if let (Some(up), Some(down)) = (at(step), at(-step)) {
                    for (d, (u, l)) in row.iter_mut().zip(up.values().iter().zip(down.values())) {
                        // A phase may have turned by a whole turn.
                        let by = u - l;
                        let by = if by.abs() > 3.0 && sd > 0.0 && by.abs() > 1e3 * step { 0.0 } else { by };
                        *d = by / (2.0 * step) * m.level;
                    }
                }
                jacobian.push((m.at + k, row));
            }
            for (b, bent) in m.bent.iter().enumerate() {
                let mut row = vec![0.0; n];
                row[bent.value] = bent.sd;
                if let Some((with, per)) = bent.with {
                    row[with] = per * bent.sd;
                }
                jacobian.push((m.at + m.width + b, row));
            }
            for (k, at, sd) in &m.left_out {
                let mut coefficients = effect.coefficients();
                coefficients[*k] += sd;
                let mut other = effect.clone();
                other.set_coefficients(&coefficients);
                let row = other.values().iter().zip(effect.values()).map(|(a, b)| a - b).collect();
                jacobian.push((*at, row));
            }
            let mut half = vec![0.0; n];
            for (v, h) in half.iter_mut().enumerate() {
                let mut variance = 0.0;
                for (i, a) in &jacobian {
                    for (j, b) in &jacobian {
                        variance += a[v] * b[v] * self.covariance(*i, *j);
                    }
                }
                *h = NORMAL_95 * variance.max(0.0).sqrt();
            }
            if let Some(p) = effect.description().place(How::Phase) {
                // An interval of an angle is at most half a turn to either side.
                half[p] = half[p].min(std::f64::consts::PI);
            }
            if let (Some([from, to]), Some(p)) =
                (f.moments, effect.description().parameters.iter().position(|p| p.refine == Refine::Moment))
            {
                half[p] = 0.5 * (to - from);
                effect = effect.with(&[(p, f64::midpoint(from, to))]).unwrap_or(effect);
            }
            let held = (0..n).filter(|v| half[*v] <= 0.0).collect();
            (f.effect, f.half, f.held) = (Some(effect), half, held);
        }
    }

    /// Gives a wave that accompanies another the other's period and its interval.
    fn tie_periods(found: &mut [Found]) {
        for i in 0..found.len() {
            let Some(effect) = found[i].effect.clone() else { continue };
            let wave = effect.description().place(How::Amplitude).is_some();
            let Some(law) = effect.description().searched.beside.filter(|_| wave) else { continue };
            let near = |f: &&Found| {
                f.effect.as_ref().is_some_and(|e| {
                    e.description().name == law
                        && e.axes() == effect.axes()
                        && (e.scalar(0) / effect.scalar(0) - 1.0).abs() < 0.02
                })
            };
            let Some(other) = found.iter().find(near).cloned() else { continue };
            let period = other.effect.as_ref().map_or(effect.scalar(0), |e| e.scalar(0));
            found[i].effect = effect.with(&[(0, period)]).or(Some(effect));
            found[i].half[0] = other.half[0];
        }
    }

    /// The model's effects as the rows have them.
    fn known(&self, found: &[Found]) -> Vec<Moved> {
        let problem = self.search.problem;
        let from = problem.terms.len();
        (0..self.model.len())
            .filter_map(|place| {
                let effect = &self.model[place];
                let mut values = effect.values().to_vec();
                let mut half = vec![0.0; values.len()];
                let own: Vec<usize> =
                    (0..problem.known.len()).filter(|i| problem.known[*i].effect == place).collect();
                let at: Vec<usize> = own.iter().map(|i| from + i).collect();
                let mut beyond = is_beyond_chance(self.distance(&at), own.len());
                for (i, k) in own.iter().map(|i| (*i, &problem.known[*i])) {
                    let sd = self.covariance(from + i, from + i).sqrt();
                    for (v, by) in &k.along {
                        values[*v] += by * self.beta[from + i];
                        half[*v] = NORMAL_95 * (by * sd).abs();
                    }
                }
                let replaced = found.iter().position(|f| f.replaces == Some(place));
                if let Some(m) = replaced.map(|r| &self.members[r]) {
                    beyond = true;
                    let mut e = effect.with_values(&values)?;
                    let mut coefficients = e.coefficients();
                    let sizes = m.cause.coefficient_sizes(problem.rows);
                    for (k, c) in coefficients.iter_mut().enumerate().take(m.width) {
                        *c += self.beta[m.at + k] * m.level * sizes[k];
                    }
                    e.set_coefficients(&coefficients);
                    values = e.values().to_vec();
                    let sd = self.covariance(m.at, m.at).sqrt() * m.level * sizes[0];
                    for (v, h) in half.iter_mut().enumerate() {
                        if v / effect.width() == 0 || *h > 0.0 {
                            *h = h.max(NORMAL_95 * sd);
                        }
                    }
                }
                let after = effect.with_values(&values)?;
                Some(Moved { place, after, half, beyond_chance: beyond })
            })
            .collect()
    }

    /// Jumps at pauses, which are searched as hypotheses are.
    fn jumps(&self, search: &Search<'_>, found: &[Found]) -> Vec<SetUp> {
        let terms = setup::jumps(search.problem.rows);
        let of = |(m, f): (&Solved, &Found)| {
            let shape = f.shape.as_ref()?;
            let Cause::Shape(both) = &m.cause else { return None };
            let term = terms
                .iter()
                .find(|t| t.column.iter().zip(&both.1[0]).all(|(a, b)| (*a == 0.0) == (*b == 0.0)))?;
            let size = crate::priors::JUMP_UM_PROBABILITY.0 * m.level;
            Some(SetUp {
                record: term.record,
                response: shape.response.clone(),
                what: setup::What::Jump,
                value: self.beta[m.at] * size,
                half: NORMAL_95 * self.covariance(m.at, m.at).sqrt() * size,
            })
        };
        self.members
            .iter()
            .zip(found)
            .filter(|(_, f)| f.shape.as_ref().is_some_and(|s| s.manner == "a jump at a pause"))
            .filter_map(of)
            .collect()
    }

    fn set_up(&self) -> Vec<SetUp> {
        let problem = self.search.problem;
        let named = |w: setup::What| {
            use setup::What::{CentreFirst, CentreSecond, Jump, Line, Zero};
            matches!(w, Zero | CentreFirst | CentreSecond | Line | Jump)
        };
        let of = |(i, t): (usize, &setup::Term)| {
            let row = t.column.iter().position(|x| *x != 0.0)?;
            let segment = problem.rows.segments.iter().find(|s| s.rows.contains(&row))?;
            Some(SetUp {
                record: t.record,
                response: problem.rows.responses[segment.response].to_string(),
                what: t.what,
                value: self.beta[i] * t.sd,
                half: NORMAL_95 * self.covariance(i, i).sqrt() * t.sd,
            })
        };
        problem.terms.iter().enumerate().filter(|(_, t)| named(t.what)).filter_map(of).collect()
    }
}

impl Found {
    /// A walk without a name.
    fn wander(rows: &Rows<'_>, w: &Wander) -> Self {
        let shape = Shape {
            response: rows.responses[w.response].to_string(),
            against: vec!["time".to_owned()],
            manner: format!("wanders, over some {:.0} rows", w.rows),
        };
        Self {
            effect: None,
            shape: Some(shape),
            replaces: None,
            half: Vec::new(),
            held: Vec::new(),
            evidence: w.odds,
            name_mass: 0.0,
            mode_mass: 1.0,
            shape_mass: 1.0,
            moments: None,
            rivals: Vec::new(),
        }
    }

    /// Whether its size is known: an interval of one of its sizes excludes zero.
    #[must_use]
    pub fn has_size(&self) -> bool {
        let Some(effect) = &self.effect else { return true };
        let width = effect.width();
        let parameters = effect.description().parameters.iter().enumerate();
        parameters.filter(|(_, p)| matches!(p.search, How::Linear | How::Amplitude)).any(|(i, _)| {
            let half = self.half.iter().skip(i * width);
            effect.get(i).iter().zip(half).any(|(v, h)| v.abs() > *h)
        })
    }
}

impl Estimate {
    /// Whether rows are correlated for longer than the noise model allows.
    /// The rows are then closer together than the noise forgets.
    #[must_use]
    pub fn remembers(&self) -> bool {
        self.noise.phi.iter().any(|phi| *phi >= MOST_PHI) && {
            let r = &self.residual;
            let with: f64 = r.windows(2).map(|w| w[0] * w[1]).sum();
            with > REMEMBERS * dot(r, r)
        }
    }
}

/// Residuals of a record beside a model, set-up included, response by response.
#[must_use]
pub fn unexplained(record: &Record, model: &[Effect]) -> Vec<f64> {
    let rows = Rows::new(std::slice::from_ref(record));
    let mut left = rows.measured.clone();
    for effect in model {
        rtec_least_squares::add(&mut left, -1.0, &rows.predict(effect));
    }
    left
}

/// Log evidence of one record beside a model that lacks nothing.
/// Also returns the size of the residual noise per response.
#[must_use]
pub fn alone(
    record: &Record,
    model: &[Effect],
    intervals: &[Vec<Option<f64>>],
    units: Units,
) -> (f64, Vec<(Role, f64)>) {
    let records = std::slice::from_ref(record);
    let rows = Rows::new(records);
    let mut problem = Problem::new(&rows, model, intervals).in_units(units);
    // Relative to other records the plate may be turned.
    problem.terms.extend(setup::turns(&rows));
    let mut noise = problem.first_noise();
    let mut total = f64::NEG_INFINITY;
    for _ in 0..NOISE_STEPS {
        let base = problem.base(noise.clone());
        total = fit(base.factor.left(), base.freedom) - base.factor.half_log_det()
            + problem.log_scale(&noise)
            + noise.log_prior();
        noise = problem.renewed(&noise, &base.factor);
    }
    let size = |j: usize| noise.sigma[j] / (1.0 - noise.phi[j] * noise.phi[j]).sqrt();
    (total, rows.responses.iter().cloned().enumerate().map(|(j, r)| (r, size(j))).collect())
}
