//! Finds where measured and simulated disagree.
//! It tests the residual for structure against every channel. Each p-value is from permutations of blocks of
//! the residual; a false-discovery rate decides which count.

use crate::SEED;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{RngCore, SeedableRng};
use rtec_estimate::UnnamedShape;
use rtec_estimate::measurement_model::EstimationProblem;
use rtec_estimate::rows_and_noise::{MeasuredRows, ResponseSegment};
use rtec_estimate::set_up_terms::SetUpTermKind;
use rtec_least_squares::dot;
use rtec_model::effect::Effect;
use rtec_model::machine::Machine;
use rtec_model::record::{Axis, Record, Role, span};
use serde::Serialize;

/// Structure of a response against one variable.
#[derive(Debug, Clone, Serialize)]
pub struct ResidualStructure {
    /// The response.
    pub response: String,
    /// The variable: a role, `temperature.T3`, `channel.z9`.
    pub against: String,
    /// Share of the residual's mean square that a smooth function of it explains.
    pub statistic: f64,
    /// Probability of as much by chance.
    pub p_value: f64,
    /// Smallest false-discovery rate at which it counts.
    pub q_value: f64,
    /// Mean residual per stretch of it: middle of the stretch, mean, number of rows.
    pub profile: Vec<[f64; 3]>,
    /// The period of a wave over it, in its unit, if a wave was found.
    pub period: Option<f64>,
    /// Whether it was found near the turns of that direction's axis.
    pub near_turns: bool,
}

impl ResidualStructure {
    /// The variable, with a wave's period: `position.x, period 10.0 mm`.
    #[must_use]
    pub fn against(&self) -> String {
        if self.near_turns {
            return format!("{}, near its turns", self.against);
        }
        let Some(period) = self.period else { return self.against.clone() };
        let unit = match self.against.split('.').next() {
            Some("time") => " s",
            Some("position") => " mm",
            Some("angle") => " rad",
            _ => "",
        };
        format!("{}, period {period:.4}{unit}", self.against)
    }

    /// Whether both are structure of the same response against the same variable.
    fn is_of(&self, other: &Self) -> bool {
        let of = |p: &Self| (p.response.clone(), p.against.clone(), p.near_turns);
        of(self) == of(other)
    }

    /// Whether it counts at a false-discovery rate of 5 %.
    #[must_use]
    pub fn counts(&self) -> bool {
        self.q_value <= 0.05
    }
}

/// Number of stretches of a channel that form a smooth function.
const STRETCHES: usize = 8;
/// Readings within this share of the whole range are at one place.
/// A place has at least [`ROWS_OF_PLACE`] rows.
const SAME_PLACE: f64 = 1e-3;
const ROWS_OF_PLACE: usize = 5;
/// Largest number of temperatures whose differences are tested.
const PAIRED_TEMPERATURES: usize = 6;

/// Length of a block in correlation lengths of the residual.
/// Cuts at the ends of blocks underestimate chance: by a quarter of the variance at twice the correlation
/// length.
const BLOCK: f64 = 5.0;
/// Permutations of the residual's blocks; they bound the smallest p-value.
const PERMUTATIONS: usize = 999;
/// Permutations as large as the finding that suffice to reject it.
const ENOUGH: usize = 20;

/// A place this clear is removed before weaker ones are tested.
const CLEAR: f64 = 0.01;

/// Most stronger channels beside which a channel is tested.
/// It is one fewer each time.
const BESIDE: usize = 2;

/// Largest row-to-row correlation of noise; slower changes are structure.
const NOISE_REMEMBERS: f64 = 0.7;
/// Spacing of a wave's frequencies, in waves over the whole range.
/// A frequency between them loses at most a tenth.
const WAVES_APART: f64 = 0.35;

/// Largest number of frequencies, so that a test takes a second at most.
const MOST_FREQUENCIES: usize = 3000;

/// The smallest p-value that is reported.
pub(crate) const LEAST_P: f64 = 1.0 / (PERMUTATIONS as f64 + 1.0);

/// Tests every response against every channel; strongest first.
/// The residual is that of the original model with its own parameters adjusted to the data.
pub(crate) fn places(records: &[Record], machine: &Machine) -> Vec<ResidualStructure> {
    let stack = MeasuredRows::new(records);
    let model: Vec<Effect> = machine.effects().cloned().collect();
    let mut problem = EstimationProblem::new(&stack, &model, &crate::findings_from_estimate::stated(machine));
    let (sigmas, before) = left_by(&problem);
    let mut out = Vec::new();
    for (response, &sigma) in sigmas.iter().enumerate() {
        let (segments, residual) = of_response(&stack, &before, response);
        // Large effects hide small ones, so each channel is also tested beside stronger ones.
        let role = stack.responses[response].to_string();
        let channels = channels(&stack, &segments);
        let found: Vec<Option<ResidualStructure>> =
            channels.iter().map(|(against, x)| place(&role, against, x, &residual, sigma, 1.0)).collect();
        let mut alone: Vec<((String, Vec<f64>), ResidualStructure)> =
            channels.into_iter().zip(found).filter_map(|(channel, place)| Some((channel, place?))).collect();
        alone.sort_by(|a, b| b.1.statistic.total_cmp(&a.1.statistic));
        let mut left = vec![residual.clone()];
        for ((against, x), mut found) in alone {
            // A channel that follows a stronger one (cycles with time) is also tested without removing that
            // one.
            for left in left.iter().skip(1).rev().take(BESIDE) {
                if found.p_value <= LEAST_P {
                    break;
                }
                if let Some(beside) = place(&role, &against, &x, left, sigma, found.p_value) {
                    found.p_value = found.p_value.min(beside.p_value);
                }
            }
            if found.p_value <= CLEAR {
                let mut without = left[left.len() - 1].clone();
                flatten(&found, &x, &mut without);
                left.push(without);
            }
            out.push(found);
        }
    }
    strongest_first(&mut out);
    rate(&mut out);
    // A response without a finding is tested again without the air as a set-up term, because the air can follow
    // any drift.
    let nowhere = |role: &str| !out.iter().any(|p: &ResidualStructure| p.counts() && p.response == role);
    let roles: Vec<String> = stack.responses.iter().map(ToString::to_string).collect();
    let lost: Vec<usize> = (0..roles.len()).filter(|response| nowhere(&roles[*response])).collect();
    if lost.is_empty() {
        return out;
    }
    problem.terms.retain(|t| t.what != SetUpTermKind::Air);
    let (sigmas, before) = left_by(&problem);
    let mut closer = Vec::new();
    for response in lost {
        let (segments, residual) = of_response(&stack, &before, response);
        closer.extend(closely(&roles[response], &stack, &segments, &residual, sigmas[response]));
    }
    strongest_first(&mut closer);
    rate(&mut closer);
    // Two tests find twice as much by chance.
    for p in &mut closer {
        p.q_value = (2.0 * p.q_value).min(1.0);
    }
    closer.retain(ResidualStructure::counts);
    if !closer.is_empty() {
        out.retain(|p| !closer.iter().any(|c| c.is_of(p)));
        out.append(&mut closer);
        strongest_first(&mut out);
    }
    out
}

/// A finding of a later stage.
/// It has the share of the residual's mean square, its shape, and the probability by chance.
pub(crate) type FoundLater = (f64, UnnamedShape, f64);

/// Adds findings of later stages that this test alone does not show.
/// Their variable is what the law reads.
pub(crate) fn add_found(places: &mut Vec<ResidualStructure>, found: impl IntoIterator<Item = FoundLater>) {
    for (statistic, shape, p_value) in found {
        let reads = |p: &ResidualStructure| shape.against.contains(&p.against);
        let of = |p: &ResidualStructure| p.response == shape.response;
        if places.iter().any(|p| p.counts() && of(p) && reads(p)) {
            continue;
        }
        let own = places.iter_mut().filter(|p| of(p) && reads(p));
        match own.max_by(|a, b| a.statistic.total_cmp(&b.statistic)) {
            Some(place) => (place.p_value, place.q_value) = (place.p_value.min(p_value), p_value),
            None => places.push(ResidualStructure {
                response: shape.response,
                against: shape.against.join(" and "),
                statistic,
                p_value,
                q_value: p_value,
                profile: Vec::new(),
                period: None,
                near_turns: false,
            }),
        }
    }
    strongest_first(places);
}

/// Residuals beside set-up and known effects, and the noise of each response.
/// Each row is divided by its noise.
fn left_by(problem: &EstimationProblem<'_>) -> (Vec<f64>, Vec<f64>) {
    let mut noise = problem.first_noise();
    noise.phi.fill(0.0);
    let sigmas = noise.sigma.clone();
    (sigmas, problem.base(noise).factor.residual().to_vec())
}

/// The segments of a response, and its residuals about their mean.
fn of_response<'s>(
    stack: &'s MeasuredRows<'_>,
    left: &[f64],
    response: usize,
) -> (Vec<&'s ResponseSegment>, Vec<f64>) {
    let segments: Vec<&ResponseSegment> = stack.segments.iter().filter(|s| s.response == response).collect();
    let mut residual: Vec<f64> = segments.iter().flat_map(|s| left[s.rows.clone()].iter().copied()).collect();
    let mean = residual.iter().sum::<f64>() / residual.len().max(1) as f64;
    for r in &mut residual {
        *r -= mean;
    }
    (segments, residual)
}

fn strongest_first(places: &mut [ResidualStructure]) {
    places.sort_by(|a, b| a.p_value.total_cmp(&b.p_value).then(b.statistic.total_cmp(&a.statistic)));
}

/// A closer look at one response.
/// It tests slow changes against time, repeats at each target against the place, and waves over either. Slow
/// channels are left out, because a drift resembles each of them.
fn closely(
    role: &str,
    stack: &MeasuredRows<'_>,
    segments: &[&ResponseSegment],
    residual: &[f64],
    sigma: f64,
) -> Vec<ResidualStructure> {
    let mut out = Vec::new();
    for (against, x) in channels(stack, segments) {
        let place = against.starts_with("position.");
        let turns = against.starts_with(TRAVEL);
        if against != "time" && against != "angle" && !place && !turns {
            continue;
        }
        let bins = if place { places_of(&x) } else { groups(&against, &x) };
        out.extend(
            bins.and_then(|bins| judged(role, &against, &x, residual, sigma, &bins, NOISE_REMEMBERS, 1.0)),
        );
        if !turns {
            out.extend(wave(role, &against, &x, residual, sigma));
        }
    }
    out
}

/// The clearest wave of a residual over one channel.
/// It uses least squares at each frequency (Lomb, Astrophys. Space Sci. 39 (1976) 447), on the residual
/// without its autocorrelation. The p-value allows for the number of frequencies tried.
fn wave(response: &str, against: &str, x: &[f64], residual: &[f64], sigma: f64) -> Option<ResidualStructure> {
    let n = residual.len();
    let [low, high] = span(x);
    let (span, squares) = (high - low, dot(residual, residual));
    if n < 12 || !(span > 0.0 && span.is_finite() && squares.is_finite() && squares > 0.0) {
        return None;
    }
    let phi = (dot(&residual[1..], &residual[..n - 1]) / squares).clamp(0.0, NOISE_REMEMBERS);
    let mut white: Vec<f64> = residual.windows(2).map(|w| w[1] - phi * w[0]).collect();
    let mean = white.iter().sum::<f64>() / white.len() as f64;
    for r in &mut white {
        *r -= mean;
    }
    let rows = white.len() as f64;
    let squares = dot(&white, &white);
    let step = WAVES_APART / span;
    // From one wave over the whole range to one in two rows, up to the largest number of frequencies.
    let first = (1.0 / WAVES_APART).ceil() as usize;
    let last = ((rows / 2.0 / WAVES_APART) as usize).min(MOST_FREQUENCIES);
    let turn = |v: f64, frequency: f64| (std::f64::consts::TAU * frequency * (v - low)).sin_cos();
    let advance: Vec<(f64, f64)> = x[1..].iter().map(|v| turn(*v, step)).collect();
    let mut at: Vec<(f64, f64)> = x[1..].iter().map(|v| turn(*v, step * first as f64)).collect();
    let mut best = (0.0, 0.0);
    for k in first..=last {
        let (mut s, mut c, mut cc, mut cs, mut sum_s, mut sum_c) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        for ((r, (sin, cos)), (by_sin, by_cos)) in white.iter().zip(&mut at).zip(&advance) {
            s += r * *sin;
            c += r * *cos;
            cc += *cos * *cos;
            cs += *cos * *sin;
            sum_s += *sin;
            sum_c += *cos;
            (*sin, *cos) = (*sin * by_cos + *cos * by_sin, *cos * by_cos - *sin * by_sin);
        }
        // Sums about their means; the residual's mean is zero.
        let (ss, cc) = (rows - cc - sum_s * sum_s / rows, cc - sum_c * sum_c / rows);
        let cs = cs - sum_c * sum_s / rows;
        let det = cc * ss - cs * cs;
        if det > 1e-6 * rows * rows {
            let share = (ss * c * c + cc * s * s - 2.0 * cs * c * s) / det / squares;
            if share > best.0 {
                best = (share, step * k as f64);
            }
        }
    }
    let (share, frequency) = best;
    let chance = (0.5 * (rows - 3.0) * (-share.min(1.0 - 1e-12)).ln_1p()).exp();
    let p_value = ((last + 1).saturating_sub(first) as f64 * chance).clamp(LEAST_P, 1.0);
    (frequency > 0.0).then(|| ResidualStructure {
        response: response.to_owned(),
        against: against.to_owned(),
        statistic: share,
        p_value,
        q_value: 1.0,
        profile: stretches(x).map_or_else(Vec::new, |bins| profile(&bins, x, residual, sigma)),
        period: Some(1.0 / frequency),
        near_turns: false,
    })
}

/// Mean residual over stretches of a channel.
fn profile(bins: &[Vec<usize>], x: &[f64], residual: &[f64], sigma: f64) -> Vec<[f64; 3]> {
    let mean_of = |b: &[usize], v: &[f64]| b.iter().map(|i| v[*i]).sum::<f64>() / b.len() as f64;
    bins.iter().map(|b| [mean_of(b, x), mean_of(b, residual) * sigma, b.len() as f64]).collect()
}

/// False-discovery rates of places that are sorted by p-value.
/// Source: Benjamini and Hochberg, J. R. Statist. Soc. B 57 (1995) 289.
fn rate(places: &mut [ResidualStructure]) {
    let m = places.len() as f64;
    let mut least = 1.0_f64;
    for (i, place) in places.iter_mut().enumerate().rev() {
        least = least.min(place.p_value * m / (i as f64 + 1.0));
        place.q_value = least;
    }
}

/// Channels that all of a response's segments log, with labels.
/// Differences of a few temperatures are added.
fn channels(stack: &MeasuredRows<'_>, segments: &[&ResponseSegment]) -> Vec<(String, Vec<f64>)> {
    let Some(first) = segments.first().map(|s| stack.record(s)) else { return Vec::new() };
    let mut channels: Vec<(String, Vec<f64>)> = Vec::new();
    for column in first.columns.iter().filter(|c| !c.role.is_measured()) {
        let of = |s: &&ResponseSegment| match column.role {
            Role::Temperature => stack.record(s).temperature(&column.name),
            Role::Channel => stack.record(s).channel(&column.name),
            _ => stack.record(s).data(&column.role),
        };
        let parts: Option<Vec<&[f64]>> = segments.iter().map(of).collect();
        channels.extend(parts.map(|parts| (column.label(), parts.concat())));
    }
    for axis in first.axes(Role::Position) {
        let parts: Option<Vec<Vec<f64>>> =
            segments.iter().map(|s| since_turn(stack.record(s), axis)).collect();
        channels.extend(parts.map(|parts| (format!("{TRAVEL}{axis}"), parts.concat())));
    }
    if first.column(&Role::Time).is_none() {
        let rows = segments.iter().flat_map(|s| (0..s.rows.len()).map(|r| r as f64)).collect();
        channels.push(("time".into(), rows));
    }
    let temperatures: Vec<(String, Vec<f64>)> =
        channels.iter().filter(|(l, _)| l.starts_with("temperature.")).cloned().collect();
    if temperatures.len() <= PAIRED_TEMPERATURES {
        for (i, (a, x)) in temperatures.iter().enumerate() {
            for (b, y) in &temperatures[i + 1..] {
                let b = b.trim_start_matches("temperature.");
                channels.push((format!("{a}-{b}"), x.iter().zip(y).map(|(x, y)| x - y).collect()));
            }
        }
    }
    channels
}

/// Prefix of an axis in the label of its travel since its last turn.
const TRAVEL: &str = "travel.";

/// Travel of an axis since its last turn, mm, with the direction as its sign.
/// A spike at the turns is a function of it. Rows before the first turn get the largest travel. `None`
/// without turns.
fn since_turn(record: &Record, axis: &Axis) -> Option<Vec<f64>> {
    let at = record.data(&Role::Position(axis.clone()))?;
    let direction =
        [Role::Direction(axis.clone()), Role::Velocity(axis.clone())].iter().find_map(|r| record.data(r))?;
    let [low, high] = span(at);
    let (mut sign, mut turned_at, mut turns) = (0.0, None, 0);
    let mut last = at.first().copied()?;
    let mut travel = Vec::with_capacity(at.len());
    for (p, d) in at.iter().zip(direction) {
        if *d != 0.0 && d * sign <= 0.0 {
            if sign != 0.0 {
                (turned_at, turns) = (Some(last), turns + 1);
            }
            sign = d.signum();
        }
        travel.push(sign * turned_at.map_or(high - low, |turn: f64| (p - turn).abs()));
        last = *p;
    }
    (turns > 0).then_some(travel)
}

/// Groups rows by their distance from zero, each sign apart.
/// The farther half is a group, then the farther half of the rest, and so on.
fn towards_zero(x: &[f64]) -> Option<Vec<Vec<usize>>> {
    let mut groups = Vec::new();
    for sign in [1.0, -1.0] {
        let mut own: Vec<usize> = (0..x.len()).filter(|i| x[*i] * sign > 0.0).collect();
        own.sort_by(|a, b| x[*a].abs().total_cmp(&x[*b].abs()));
        while own.len() >= 2 * ROWS_OF_PLACE {
            groups.push(own.split_off(own.len() / 2));
        }
        groups.push(own);
    }
    groups.retain(|g| !g.is_empty());
    (groups.len() > 2).then_some(groups)
}

/// The groups of rows by which a channel is tested.
fn groups(against: &str, x: &[f64]) -> Option<Vec<Vec<usize>>> {
    if against.starts_with(TRAVEL) { towards_zero(x) } else { stretches(x) }
}

/// A random number below `n`.
fn below(rng: &mut Xoshiro256PlusPlus, n: usize) -> usize {
    ((u128::from(rng.next_u64()) * n as u128) >> 64) as usize
}

/// Structure of a residual against one channel; `None` for a constant one.
/// Permutations end once the p-value can no longer be below `known`.
fn place(
    response: &str,
    against: &str,
    x: &[f64],
    residual: &[f64],
    sigma: f64,
    known: f64,
) -> Option<ResidualStructure> {
    let groups = groups(against, x)?;
    if !against.starts_with(TRAVEL) {
        return judged(response, against, x, residual, sigma, &groups, 0.99, known);
    }
    // What each direction has in common does not concern the turns.
    let mut beside = residual.to_vec();
    let (up, down): (Vec<usize>, Vec<usize>) = (0..x.len()).partition(|i| x[*i] > 0.0);
    take_means([up, down], &mut beside);
    judged(response, against, x, &beside, sigma, &groups, 0.99, known)
}

/// Structure of a residual over groups of rows, tested by permuting blocks.
/// `remembers` is the largest row-to-row correlation that counts as noise.
#[allow(clippy::too_many_arguments, reason = "what is looked at, and how")]
fn judged(
    response: &str,
    against: &str,
    x: &[f64],
    residual: &[f64],
    sigma: f64,
    bins: &[Vec<usize>],
    remembers: f64,
    known: f64,
) -> Option<ResidualStructure> {
    let mut bin = vec![0u32; x.len()];
    for (b, rows) in bins.iter().enumerate() {
        for i in rows {
            bin[*i] = b as u32;
        }
    }
    let explained =
        |sums: Vec<f64>| -> f64 { sums.iter().zip(bins).map(|(s, b)| s * s / b.len() as f64).sum() };
    let running = running(residual);
    let own = explained(sums_by(&runs(&bin, bin.len(), bins.len()), &running, &[0]));
    // Blocks are as long as the residual is correlated.
    let n = residual.len();
    let squares = dot(residual, residual);
    // If the squares overflow, no test is possible.
    if !squares.is_finite() {
        return None;
    }
    let next = dot(&residual[1..], &residual[..n - 1]) / squares.max(1e-300);
    let next = next.min(remembers);
    let memory = (1.0 + next) / (1.0 - next);
    let longest = (n / 10).max(2) as f64;
    let length = (BLOCK * memory).clamp((n as f64).cbrt().min(longest), longest) as usize;
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(SEED);
    let (mut tried, mut larger) = (0, 0);
    let mut order: Vec<usize> = (0..n.div_ceil(length)).collect();
    let mut begin = Vec::with_capacity(order.len());
    let runs = runs(&bin, length, bins.len());
    let enough = ENOUGH.min((known / LEAST_P) as usize);
    while tried < PERMUTATIONS && larger < enough {
        for i in (1..order.len()).rev() {
            order.swap(i, below(&mut rng, i + 1));
        }
        // Blocks begin anywhere, so that no row keeps its neighbours' bin.
        let shift = below(&mut rng, n);
        begin.clear();
        begin.extend(order.iter().map(|block| (block * length + shift) % n));
        let chance = explained(sums_by(&runs, &running, &begin));
        larger += usize::from(chance >= own);
        tried += 1;
    }
    let p_value = (larger + 1) as f64 / (tried + 1) as f64;
    let of_turns = against.strip_prefix(TRAVEL);
    Some(ResidualStructure {
        response: response.to_owned(),
        against: of_turns.map_or_else(|| against.to_owned(), |axis| format!("direction.{axis}")),
        near_turns: of_turns.is_some(),
        statistic: own / squares.max(1e-300),
        p_value,
        q_value: 1.0,
        profile: profile(bins, x, residual, sigma),
        period: None,
    })
}

/// Neighbouring rows of one stretch: their first and last row within a block.
struct RowStretch {
    block: u32,
    from: u32,
    to: u32,
}

/// The runs of rows in each block, for each stretch.
/// Most are long, because most channels change slowly.
fn runs(bin: &[u32], length: usize, bins: usize) -> Vec<Vec<RowStretch>> {
    let mut out: Vec<Vec<RowStretch>> = (0..bins).map(|_| Vec::new()).collect();
    for (block, bins) in bin.chunks(length).enumerate() {
        let mut from = 0;
        for same in bins.chunk_by(|a, b| a == b) {
            let to = from + same.len() as u32;
            out[same[0] as usize].push(RowStretch { block: block as u32, from, to });
            from = to;
        }
    }
    out
}

/// Running sums of a residual up to each row, over two rounds.
fn running(residual: &[f64]) -> Vec<f64> {
    let mut sum = 0.0;
    let twice = residual.iter().chain(residual).map(|r| {
        sum += r;
        sum
    });
    std::iter::once(0.0).chain(twice).collect()
}

/// Sums of a residual by stretch, from its running sums.
/// `begin` is the row from which each block takes its residuals, which continue cyclically.
fn sums_by(runs: &[Vec<RowStretch>], running: &[f64], begin: &[usize]) -> Vec<f64> {
    let of = |RowStretch { block, from, to }: &RowStretch| {
        let running = &running[begin[*block as usize]..];
        running[*to as usize] - running[*from as usize]
    };
    runs.iter().map(|stretch| stretch.iter().map(of).sum()).collect()
}

/// Removes a channel's means from a residual.
/// They are taken per place if each has many rows, otherwise per stretch.
fn flatten(found: &ResidualStructure, x: &[f64], residual: &mut [f64]) {
    let by_place = || places_of(x).or_else(|| stretches(x));
    let groups = if found.near_turns { towards_zero(x) } else { by_place() }.unwrap_or_default();
    take_means(groups, residual);
}

/// Removes the mean of each group of rows from a residual.
fn take_means(groups: impl IntoIterator<Item = Vec<usize>>, residual: &mut [f64]) {
    for rows in groups {
        let mean = rows.iter().map(|i| residual[*i]).sum::<f64>() / rows.len().max(1) as f64;
        for i in rows {
            residual[i] -= mean;
        }
    }
}

/// Rows by place, if a channel returns to few places.
/// Repeated approaches to a target differ by little.
fn places_of(x: &[f64]) -> Option<Vec<Vec<usize>>> {
    let mut order: Vec<usize> = (0..x.len()).collect();
    order.sort_by(|a, b| x[*a].total_cmp(&x[*b]));
    let range = x[*order.last()?] - x[order[0]];
    let near = |a: &usize, b: &usize| x[*b] - x[*a] <= SAME_PLACE * range;
    let groups: Vec<Vec<usize>> = order.chunk_by(near).map(<[usize]>::to_vec).collect();
    (groups.len() > 1 && groups.iter().all(|g| g.len() >= ROWS_OF_PLACE)).then_some(groups)
}

/// Groups rows into stretches; `None` for a constant.
/// The groups are by value if there are few values, otherwise of equal numbers of rows.
fn stretches(x: &[f64]) -> Option<Vec<Vec<usize>>> {
    let mut order: Vec<usize> = (0..x.len()).collect();
    order.sort_by(|a, b| x[*a].total_cmp(&x[*b]));
    let mut distinct: Vec<f64> = order.iter().map(|i| x[*i]).collect();
    distinct.dedup();
    if distinct.len() < 2 {
        return None;
    }
    if distinct.len() <= STRETCHES {
        let of = |v: f64| order.iter().copied().filter(|i| x[*i].to_bits() == v.to_bits()).collect();
        return Some(distinct.iter().map(|v| of(*v)).collect());
    }
    let n = order.len();
    let bins = STRETCHES.min(n / 4).max(2);
    Some((0..bins).map(|b| order[n * b / bins..n * (b + 1) / bins].to_vec()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_records::{noise, record};
    use rtec_model::record::Column;

    #[test]
    fn an_error_along_the_position_is_found_there() {
        let dice = noise(5, 240);
        let mut run = record(240, |i| dice[i as usize]);
        let p = run.columns[1].data.clone();
        for (e, p) in run.columns[2].data.iter_mut().zip(&p) {
            *e += (p / 25.0).powi(2);
        }
        let records = [run];
        let found = places(&records, &Machine::ideal("m"));
        assert_eq!((found[0].against.as_str(), found.len()), ("position.x", 2));
        assert!(
            found[0].p_value == LEAST_P && found[0].q_value < 0.003 && found[0].profile.len() == STRETCHES,
            "{:?}",
            found[0]
        );
    }

    /// A spike is found near the turns, which are a hundredth of the travel.
    #[test]
    fn a_spike_is_found_near_its_turns() {
        let mut falsely = 0;
        for seed in 0..20 {
            let dice = noise(500 + seed, 1200);
            // Strokes of 120 mm, a reading every 2 mm, and closer ones after each turn.
            let step = |k: usize| if k < 10 { 0.1 } else { 2.0 };
            let (mut p, mut rows) = (0.0, Vec::new());
            for i in 0..1200 {
                let (stroke, k) = (i / 60, i % 60);
                let dir = if stroke % 2 == 0 { 1.0 } else { -1.0 };
                p += dir * step(k);
                let d: f64 = (0..=k).map(step).sum();
                rows.push((p, dir, if stroke == 0 { 0.0 } else { 2.0 * dir * (-d / 0.8).exp() }));
            }
            let of = |size: f64| {
                let mut run = record(1200, |i| dice[i as usize] + size * rows[i as usize].2);
                run.columns[1].data = rows.iter().map(|r| r.0).collect();
                let dir = rows.iter().map(|r| r.1).collect();
                run.columns.push(Column::new("dir", Role::Direction(crate::test_records::axis()), dir));
                places(&[run], &Machine::ideal("m"))
            };
            let found = of(1.0);
            let near = found.iter().find(|p| p.near_turns).expect("looked at");
            assert!(near.counts() && near.against() == "direction.x, near its turns", "{seed}: {found:?}");
            falsely += usize::from(of(0.0).iter().any(|p| p.near_turns && p.counts()));
        }
        assert!(falsely <= 3, "{falsely} of 20");
    }

    /// A residual whose squares overflow has no place.
    #[test]
    fn numbers_beyond_all_measure_have_no_place() {
        let x: Vec<f64> = (0..60).map(f64::from).collect();
        for huge in [1e200, f64::INFINITY, f64::NAN] {
            let residual: Vec<f64> = x.iter().map(|x| huge * (x / 7.0).sin()).collect();
            assert!(place("error.x", "time", &x, &residual, 1.0, 0.05).is_none(), "{huge}");
        }
    }

    /// Sensors of pure noise beside a drifting error are found only as often as chance.
    #[test]
    fn noise_is_no_place() {
        let mut few = 0;
        for seed in 0..40 {
            let (drift, other) = (noise(100 + seed, 200), noise(300 + seed, 200));
            let mut sum = 0.0;
            let walk: Vec<f64> = drift
                .iter()
                .map(|d| {
                    sum = 0.7 * sum + d;
                    sum
                })
                .collect();
            let mut run = record(200, |i| walk[i as usize]);
            run.columns.push(Column::new("z", Role::Channel, other));
            let records = [run];
            let found = places(&records, &Machine::ideal("m"));
            let z = found.iter().find(|p| p.against == "channel.z").unwrap();
            assert!(z.p_value >= LEAST_P);
            few += usize::from(z.p_value < 0.05);
        }
        assert!(few <= 6, "{few} of 40 below 5 %");
    }

    /// Reference: row i of block k has the value i rows after the block's beginning.
    #[test]
    fn blocks_are_summed_where_they_are_moved_to() {
        let residual = noise(9, 103);
        let bin: Vec<u32> = (0..103).map(|i| i * i / 7 % 8).collect();
        let begin = |block: usize| (block * 37 + 90) % 103;
        let begins: Vec<usize> = (0..11).map(begin).collect();
        let sums = sums_by(&runs(&bin, 10, 8), &running(&residual), &begins);
        for (b, sum) in sums.iter().enumerate() {
            let rows = (0..103).filter(|i| bin[*i] as usize == b);
            let want: f64 = rows.map(|i| residual[(begin(i / 10) + i % 10) % 103]).sum();
            assert!((sum - want).abs() < 1e-12, "stretch {b}: {sum}, not {want}");
        }
    }

    /// The paper's example: four of fifteen p-values are below the line at 5 %.
    #[test]
    fn false_discoveries_are_rated_as_in_the_paper() {
        let p = [
            0.0001, 0.0004, 0.0019, 0.0095, 0.0201, 0.0278, 0.0298, 0.0344, 0.0459, 0.3240, 0.4262, 0.5719,
            0.6528, 0.7590, 1.0,
        ];
        let of = |p_value: f64| ResidualStructure {
            response: String::new(),
            against: String::new(),
            statistic: 0.0,
            p_value,
            q_value: 1.0,
            profile: Vec::new(),
            period: None,
            near_turns: false,
        };
        let mut all: Vec<ResidualStructure> = p.map(of).into();
        rate(&mut all);
        assert_eq!(all.iter().filter(|p| p.q_value <= 0.05).count(), 4);
    }
}
