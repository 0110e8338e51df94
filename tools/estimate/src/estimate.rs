//! Alternates noise and search until both settle; then gives values and intervals.

mod candidates_for_member;
mod final_fit;

use crate::candidate_hypotheses::CandidateHypotheses;
use crate::hypothesis_contribution::UnnamedShape;
use crate::measurement_model::{EstimationProblem, UnitAssumption, with_corrected_periods};
use crate::priors::{KNOWN_SHARE, MOST_PHI};
use crate::rows_and_noise::{MeasuredRows, ResponseNoise, ResponseSegment};
use crate::search::{
    HypothesisSearch, HypothesisSet, HypothesisSetMember, converted_members, profile_log_likelihood,
};
use crate::search_limits::{HOPELESS, NOISE_STEPS, REMEMBERS, ROUNDS, SETTLED, STRONG, UNDER_NOISE};
use crate::set_up_terms;
use crate::wander::{self, Wander, wanders};
use candidates_for_member::place;
use final_fit::FinalFit;
use rtec_least_squares::dot;
use rtec_model::effect::{Dictionary, Effect, TemperatureDifference};
use rtec_model::record::{Record, Role};

/// An alternative explanation of the same errors.
#[derive(Debug, Clone, PartialEq)]
pub struct RivalExplanation {
    /// Name of the effect.
    pub name: String,
    /// Its temperature difference, if it has one.
    pub sensor: Option<TemperatureDifference>,
    /// If the name is the same, the parameter that differs, in its own unit.
    pub differs: Option<(String, f64)>,
    /// Log odds of the accepted explanation against this one.
    pub margin: f64,
}

impl RivalExplanation {
    /// Its name, with its sensors or the value that differs.
    #[must_use]
    pub fn label(&self) -> String {
        let sensor = self.sensor.as_ref().map_or_else(String::new, |d| format!(" ({d})"));
        let differs = self.differs.as_ref().map_or_else(String::new, |(key, v)| format!(" ({key} = {v:.4})"));
        format!("{}{sensor}{differs}", self.name)
    }
}

/// A member of the likeliest set.
#[derive(Debug, Clone)]
pub struct EstimatedHypothesis {
    /// The effect with its values; none for a shape.
    pub effect: Option<Effect>,
    /// The shape; none for an effect.
    pub shape: Option<UnnamedShape>,
    /// Index of the model's effect that it replaces.
    pub replaces: Option<usize>,
    /// Half widths of its 95 % intervals, value by value.
    pub half: Vec<f64>,
    /// Indices of values that were not estimated.
    pub held: Vec<usize>,
    /// Log odds of the set with it against the set without it.
    pub evidence: f64,
    /// Posterior share of the name among all candidates for this member, 0 to 1.
    pub name_mass: f64,
    /// Posterior share of this mode within its name.
    pub mode_mass: f64,
    /// Posterior share of shapes without a name for this member.
    pub shape_mass: f64,
    /// For a step in time: the 95 % interval of its moment.
    pub moments: Option<[f64; 2]>,
    /// Whether its size is known.
    /// The joint 95 % region of its coefficients then excludes zero.
    pub has_size: bool,
    /// Alternative explanations, likeliest first.
    pub rivals: Vec<RivalExplanation>,
}

/// A known effect of the model that the rows correct.
#[derive(Debug, Clone)]
pub struct CorrectedKnownEffect {
    /// Its index in the model.
    pub place: usize,
    /// The effect as estimated from the rows.
    pub after: Effect,
    /// Half widths of its 95 % intervals, value by value.
    pub half: Vec<f64>,
    /// Whether it changed by more than chance explains.
    pub beyond_chance: bool,
}

/// An estimated set-up term of a record.
#[derive(Debug, Clone, PartialEq)]
pub struct SetUpEstimate {
    /// Index of the record.
    pub record: usize,
    /// The response.
    pub response: String,
    /// Kind of the term.
    pub what: set_up_terms::SetUpTermKind,
    /// Its value, in its unit.
    pub value: f64,
    /// Half width of its 95 % interval.
    pub half: f64,
}

/// A name that was tried.
#[derive(Debug, Clone)]
pub struct TriedExplanation {
    /// Name, with its sensors.
    pub label: String,
    /// Log odds against the member accepted instead.
    /// Names far below the best were only computed quickly.
    pub odds: f64,
    /// Whether it is in the answer.
    pub accepted: bool,
    /// The member accepted instead.
    pub place: String,
}

/// Result of the estimation.
#[derive(Debug, Clone)]
pub struct EstimationResult {
    /// The members of the likeliest set, strongest first.
    pub found: Vec<EstimatedHypothesis>,
    /// The model's own effects as estimated from the rows.
    pub known: Vec<CorrectedKnownEffect>,
    /// The set-up terms.
    pub set_up: Vec<SetUpEstimate>,
    /// The noise.
    pub noise: ResponseNoise,
    /// The whitened residual.
    pub residual: Vec<f64>,
    /// Indices of the records whose rows repeat themselves.
    /// They are closer together than the noise's correlation length.
    pub remembering: Vec<usize>,
    /// log p(y, S), up to a constant of the rows.
    pub score: f64,
    /// Names that were tried.
    pub tried: Vec<TriedExplanation>,
    /// The members of the likeliest set, as a start for the analysis of other records.
    pub members: Vec<HypothesisSetMember>,
}

/// Estimates what the records support in addition to a model.
/// `intervals` are the half widths that the model states, effect by effect and value by value.
#[must_use]
pub fn estimate(
    records: &[Record],
    dictionary: &Dictionary,
    model: &[Effect],
    intervals: &[Vec<Option<f64>>],
) -> EstimationResult {
    let rows = MeasuredRows::new(records);
    let given = model;
    let model = &with_corrected_periods(&rows, model)[..];
    let mut problem = EstimationProblem::new(&rows, model, intervals);
    let mut families = CandidateHypotheses::new(&rows, dictionary, model);
    let noise = problem.first_noise();
    let (mut found, mut left) = settle(&problem, &mut families, noise.clone(), None, model);
    // A slow signal is autocorrelated noise or an effect. Both are tried, and the likelier one is kept.
    if let Some(other) = noise.without_memory().filter(|_| !left.is_empty()) {
        let (second, members) = settle(&problem, &mut families, other, None, model);
        if second.score > found.score {
            (found, left) = (second, members);
        }
    }
    let wanders = wanders(&problem, &found.noise, &found.residual);
    if !wanders.is_empty() {
        if found.found.iter().any(|f| f.effect.is_some()) {
            // Names need not explain what a walk already explains.
            for w in &wanders {
                problem.terms.extend(wander::terms(&rows, w));
            }
            (found, _) = settle(&problem, &mut families, found.noise, Some(left), model);
        }
        for w in &wanders {
            found.found.push(EstimatedHypothesis::wander(&rows, w));
        }
    }
    for k in &mut found.known {
        k.beyond_chance |= model[k.place] != given[k.place];
    }
    found
}

/// Log evidence of the best explanation of the records, from given members.
/// The search stops far below `enough`.
#[must_use]
pub fn score(
    records: &[Record],
    dictionary: &Dictionary,
    model: &[Effect],
    intervals: &[Vec<Option<f64>>],
    start: &[HypothesisSetMember],
    units: UnitAssumption,
    enough: f64,
) -> f64 {
    let rows = MeasuredRows::new(records);
    let model = &with_corrected_periods(&rows, model)[..];
    let problem = EstimationProblem::new(&rows, model, intervals).in_units(units);
    let mut families = CandidateHypotheses::new(&rows, dictionary, model);
    let start = converted_members(&families, start);
    let noise = under(&problem, &start, problem.first_noise()).1;
    let mut best = f64::NEG_INFINITY;
    let goes_on = |search: &HypothesisSearch<'_>, set: &HypothesisSet| {
        best = best.max(with_own_noise(search, set).0);
        best > enough - 2.0 * STRONG
    };
    settled(&problem, &mut families, noise, Some(start), goes_on, |_, _| ());
    best
}

/// Alternates search and noise until neither changes.
/// Returns the estimate and its members.
fn settle(
    problem: &EstimationProblem<'_>,
    families: &mut CandidateHypotheses,
    first: ResponseNoise,
    start: Option<Vec<HypothesisSetMember>>,
    model: &[Effect],
) -> (EstimationResult, Vec<HypothesisSetMember>) {
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
/// After each round `goes_on` decides whether to continue; `then` is called once both have settled.
fn settled<T>(
    problem: &EstimationProblem<'_>,
    families: &mut CandidateHypotheses,
    first: ResponseNoise,
    start: Option<Vec<HypothesisSetMember>>,
    mut goes_on: impl FnMut(&HypothesisSearch<'_>, &HypothesisSet) -> bool,
    then: impl Fn(&HypothesisSearch<'_>, &HypothesisSet) -> T,
) -> T {
    let rows = problem.rows;
    let mut noise = first;
    let mut members = start;
    let regrow = members.is_none();
    let mut exchanged = false;
    for round in 0..ROUNDS {
        families.bank.whiten(rows, &noise);
        let search = HypothesisSearch::new(problem, families, problem.base(noise.clone()));
        // Under another noise a value may be impossible.
        let start = search.possible_part(search.set_of_members(members.take().unwrap_or_default()));
        let set = search.best(&start, regrow && round == 0);
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
        let settled = (0..noise.sigma.len())
            .all(|j| (renewed.sigma[j] / noise.sigma[j] - 1.0).abs() < SETTLED.0)
            && renewed.phi.iter().zip(&noise.phi).all(|(a, b)| (a - b).abs() < SETTLED.1);
        // Only once, because exchanges take most time; and in time, even if the noise is still changing.
        if !exchanged && (settled || round + 2 == ROUNDS) && round + 1 < ROUNDS {
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

/// Log evidence of a set under the noise that it leaves, with that noise.
fn with_own_noise(search: &HypothesisSearch<'_>, set: &HypothesisSet) -> (f64, ResponseNoise) {
    under(search.problem, &set.members, search.problem.renewed(&search.base.noise, &set.factor))
}

/// Log evidence of members under the noise that they leave, with that noise.
/// It starts from a first guess of the noise.
fn under(
    problem: &EstimationProblem<'_>,
    members: &[HypothesisSetMember],
    mut noise: ResponseNoise,
) -> (f64, ResponseNoise) {
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
        total = profile_log_likelihood(factor.left(), freedom) - factor.half_log_det()
            + prior
            + problem.log_scale(&noise)
            + noise.log_prior(problem.rows);
        noise = problem.renewed(&noise, &factor);
    }
    (total, noise)
}

/// A likelier set with one member more or less.
/// Each set is compared under the noise that it leaves, and returned with that noise. Noise may have absorbed
/// a member, and a member may have absorbed noise.
fn under_own_noise(
    search: &HypothesisSearch<'_>,
    set: &HypothesisSet,
) -> Option<(HypothesisSet, ResponseNoise)> {
    let seeds = search.screened(set, false);
    let (now, _) = with_own_noise(search, set);
    let more = seeds.iter().take(UNDER_NOISE).filter(|s| s.score > -HOPELESS);
    let more = more.filter_map(|seed| search.with(set, &search.refined(&set.factor, seed)));
    let less = (0..set.members.len()).map(|i| search.without(set, i)).filter(|s| search.possible(s));
    let mut best: Option<(f64, HypothesisSet, ResponseNoise)> = None;
    for other in more.chain(less) {
        let (total, noise) = with_own_noise(search, &other);
        if total > best.as_ref().map_or(now, |b| b.0) {
            best = Some((total, other, noise));
        }
    }
    best.map(|(_, set, noise)| (set, noise))
}

fn label(effect: &Effect) -> String {
    match &effect.delta {
        Some(d) => format!("{} ({d})", effect.name()),
        None => effect.name(),
    }
}

fn answer(search: &HypothesisSearch<'_>, set: &HypothesisSet, model: &[Effect]) -> EstimationResult {
    let mut set = set.clone();
    let (mut found, mut tried) = (Vec::new(), Vec::new());
    let mut i = 0;
    while i < set.members.len() {
        let place = place(search, &set, i);
        let without = place.nothing.then(|| search.without(&set, i)).filter(|s| search.possible(s));
        if let Some(other) = place.better.or(without) {
            set = other;
            (i, found, tried) = (0, Vec::new(), Vec::new());
            continue;
        }
        found.push(place.found);
        tried.extend(place.tried);
        i += 1;
    }
    let last = FinalFit::new(search, &set, model);
    last.fill(&mut found);
    FinalFit::tie_periods(&mut found);
    let known = last.known(&found);
    let mut set_up = last.set_up();
    set_up.extend(last.jumps(search, &found));
    let set_up_member = |i: &usize| search.families.list[set.members[*i].family].set_up;
    let mut order: Vec<usize> = (0..found.len()).filter(|i| !set_up_member(i)).collect();
    order.sort_by(|a, b| found[*b].evidence.total_cmp(&found[*a].evidence));
    let found = order.into_iter().map(|i| found[i].clone()).collect();
    tried.sort_by(|a: &TriedExplanation, b: &TriedExplanation| b.odds.total_cmp(&a.odds));
    let mut seen = Vec::new();
    tried.retain(|t| {
        !seen.contains(&t.label) && {
            seen.push(t.label.clone());
            true
        }
    });
    EstimationResult {
        found,
        known,
        set_up,
        noise: search.base.noise.clone(),
        residual: set.factor.residual().to_vec(),
        remembering: remembering(search.problem.rows, &search.base.noise, set.factor.residual()),
        score: with_own_noise(search, &set).0,
        tried,
        members: set.members,
    }
}

impl EstimatedHypothesis {
    /// A walk without a name.
    fn wander(rows: &MeasuredRows<'_>, w: &Wander) -> Self {
        let shape = UnnamedShape {
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
            has_size: true,
            rivals: Vec::new(),
        }
    }
}

/// Records whose rows are correlated for longer than the noise model allows.
/// The rows are then closer together than the noise's correlation length.
fn remembering(rows: &MeasuredRows<'_>, noise: &ResponseNoise, residual: &[f64]) -> Vec<usize> {
    let long = |(s, phi): (&ResponseSegment, &f64)| {
        let own = &residual[s.rows.clone()];
        let with: f64 = own.windows(2).map(|w| w[0] * w[1]).sum();
        (*phi >= MOST_PHI && with > REMEMBERS * dot(own, own)).then_some(s.record)
    };
    let mut records: Vec<usize> = rows.segments.iter().zip(&noise.phi).filter_map(long).collect();
    records.sort_unstable();
    records.dedup();
    records
}

/// Residuals of a record after model and set-up, response by response.
#[must_use]
pub fn unexplained(record: &Record, model: &[Effect]) -> Vec<f64> {
    let rows = MeasuredRows::new(std::slice::from_ref(record));
    let mut left = rows.measured.clone();
    for effect in model {
        rtec_least_squares::add(&mut left, -1.0, &rows.predict(effect));
    }
    left
}

/// Log evidence of one record if it is of another machine.
/// That machine has the model's effects in any sizes.
#[must_use]
pub fn of_other_machine(record: &Record, model: &[Effect]) -> f64 {
    let rows = MeasuredRows::new(std::slice::from_ref(record));
    let mut problem = EstimationProblem::new(&rows, model, &[]);
    // Instead of a share of each size, all of it.
    problem.known.iter_mut().flat_map(|k| &mut k.column).for_each(|x| *x /= KNOWN_SHARE);
    without_hypotheses(problem).0
}

/// Log evidence of one record without hypotheses, with the noise that is left.
fn without_hypotheses(mut problem: EstimationProblem<'_>) -> (f64, ResponseNoise) {
    // Relative to other records the plate may be rotated.
    problem.terms.extend(set_up_terms::turns(problem.rows));
    let mut noise = problem.first_noise();
    let mut total = f64::NEG_INFINITY;
    for _ in 0..NOISE_STEPS {
        let base = problem.base(noise.clone());
        total = profile_log_likelihood(base.factor.left(), base.freedom) - base.factor.half_log_det()
            + problem.log_scale(&noise)
            + noise.log_prior(problem.rows);
        noise = problem.renewed(&noise, &base.factor);
    }
    (total, noise)
}

/// Log evidence of one record if the model lacks nothing.
/// Also returns the size of the residual noise per response.
#[must_use]
pub fn evidence_without_hypotheses(
    record: &Record,
    model: &[Effect],
    intervals: &[Vec<Option<f64>>],
    units: UnitAssumption,
) -> (f64, Vec<(Role, f64)>) {
    let rows = MeasuredRows::new(std::slice::from_ref(record));
    let problem = EstimationProblem::new(&rows, model, intervals).in_units(units);
    let (total, noise) = without_hypotheses(problem);
    (total, rows.responses.iter().cloned().enumerate().map(|(j, r)| (r, noise.scatter(&rows, j))).collect())
}
