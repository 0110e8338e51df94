//! Two sensors in each other's place: in one record, or in all of them against the model. Shown by what the model leaves, which is
//! what the exchange would change; or, where something else is missing too, by an exchange that explains more than what was
//! found in its stead.

use crate::answer::Answer;
use crate::suspected::{ALIKE, about, centred, simulated, whole};
use crate::undone::with_errors_exchanged;
use rtec_measure::plausible::{Suspicion, What};
use rtec_model::effect::Difference;
use rtec_model::machine::Machine;
use rtec_model::record::{Axis, Column, Record, Role};
use std::collections::BTreeSet;

/// What an exchange of two sensors would change is what is left, at one to one within this.
const ONE_TO_ONE: f64 = 0.25;
/// An exchange that would change less than this share of what the model says is not told from amplitudes that are off.
const SEEN: f64 = 0.35;
/// An exchange would change the response by this share of what is left of it at least, to be seen at all.
const UNTOLD: f64 = 0.5;
/// So many places, and at least so many rows at each, where what a place does is left out of it.
const PLACES: usize = 12;
const ROWS_A_PLACE: usize = 16;
/// Minus the mean of the rows at about the same place and in the same direction: what an effect of the position alone
/// would make is gone.
fn beside_places(record: &Record, role: &Role, x: &[f64]) -> Vec<f64> {
    let n = x.len();
    let places = (n / ROWS_A_PLACE).clamp(1, PLACES);
    let axis = role.axis();
    let of = |f: fn(rtec_model::record::Axis) -> Role| axis.and_then(|a| record.data(&f(a.clone())));
    let (p, d) = (of(Role::Position), of(Role::Direction));
    let (lo, hi) = p.unwrap_or(&[]).iter().fold((f64::MAX, f64::MIN), |(l, h), p| (l.min(*p), h.max(*p)));
    let place = |i: usize| {
        let at = p.filter(|_| hi > lo).map_or(0.0, |p| (p[i] - lo) / (hi - lo) * places as f64);
        2 * (at as usize).min(places - 1) + usize::from(d.is_some_and(|d| d[i] > 0.0))
    };
    let mut sums = vec![(0.0, 0.0); 2 * places];
    for (i, x) in x.iter().enumerate() {
        let s = &mut sums[place(i)];
        *s = (s.0 + x, s.1 + 1.0);
    }
    x.iter().enumerate().map(|(i, x)| x - sums[place(i)].0 / sums[place(i)].1).collect()
}

/// What the model leaves of a response, to be held beside what an exchange of two sensors would change.
struct Exchange<'r> {
    record: &'r Record,
    role: &'r Role,
    machine: &'r Machine,
    simulated: Vec<f64>,
    left: Vec<f64>,
}

/// Products of what an exchange would change with itself, with what is left, and of that with itself.
#[derive(Clone, Copy, Default)]
struct Products {
    own: f64,
    with: f64,
    all: f64,
}

impl Products {
    fn of(change: &[f64], left: &[f64]) -> Self {
        Self { own: dot(change, change), with: dot(change, left), all: dot(left, left) }
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// A record with two of its sensors in each other's place.
pub(crate) fn with_exchanged(record: &Record, a: &str, b: &str) -> Record {
    let mut other = record.clone();
    for column in other.columns.iter_mut().filter(|c| c.role == Role::Temperature) {
        let from = match column.name.as_str() {
            n if n == a => b,
            n if n == b => a,
            _ => continue,
        };
        if let Some(data) = record.temperature(from) {
            column.data = data.to_vec();
        }
    }
    other
}

impl<'r> Exchange<'r> {
    fn new(record: &'r Record, c: &'r Column, machine: &'r Machine) -> Self {
        let simulated = simulated(record, &c.role, machine);
        let left: Vec<f64> = centred(&c.data).iter().zip(&simulated).map(|(y, s)| y - s).collect();
        let left = beside_places(record, &c.role, &left);
        Self { record, role: &c.role, machine, simulated, left }
    }

    /// How much of the change of an exchange is there, beside anything that a place may do, and which share of what is left
    /// that explains.
    fn of(&self, a: &str, b: &str) -> Option<(f64, f64)> {
        let change = self.change(a, b, SEEN)?;
        // Nor what another size of the model's own effects would make.
        let says = beside_places(self.record, self.role, &self.simulated);
        let size = dot(&says, &says).max(f64::MIN_POSITIVE);
        let beside = |v: &[f64]| -> Vec<f64> {
            let share = dot(v, &says) / size;
            v.iter().zip(&says).map(|(v, s)| v - share * s).collect()
        };
        let Products { own, with, all } = Products::of(&beside(&change), &beside(&self.left));
        (own > 0.0 && all > 0.0).then(|| (with / own, own / all))
    }

    /// What an exchange changes, beside anything that a place may do; none where it is less than this share of what the model
    /// says.
    fn change(&self, a: &str, b: &str, seen: f64) -> Option<Vec<f64>> {
        let other = with_exchanged(self.record, a, b);
        let then = simulated(&other, self.role, self.machine);
        let change: Vec<f64> = then.iter().zip(&self.simulated).map(|(t, s)| t - s).collect();
        let change = beside_places(self.record, self.role, &change);
        let says = beside_places(self.record, self.role, &self.simulated);
        (dot(&change, &change) > seen * seen * dot(&says, &says)).then_some(change)
    }
}

/// Two sensors in each other's place: what the model leaves of the response is what the exchange would change, at one to
/// one, beside anything that a place may do.
pub(crate) fn exchanged(record: &Record, c: &Column, machine: &Machine) -> Option<[String; 2]> {
    let sensors: Vec<&str> = record.names(&Role::Temperature).collect();
    let beside = Exchange::new(record, c, machine);
    let mut best: Option<(f64, [String; 2])> = None;
    for (i, a) in sensors.iter().enumerate() {
        for b in &sensors[i + 1..] {
            let Some((slope, size)) = beside.of(a, b) else { continue };
            let explains = slope * slope * size;
            if (slope - 1.0).abs() < ONE_TO_ONE
                && explains > ALIKE
                && best.as_ref().is_none_or(|x| explains > x.0)
            {
                best = Some((explains, [(*a).to_owned(), (*b).to_owned()]));
            }
        }
    }
    best.map(|b| b.1)
}

/// Where one record shows two sensors exchanged, others that show it less clearly: those that the exchange makes better.
pub(crate) fn swapped_alike(records: &[Record], found: &[Suspicion], machine: &Machine) -> Vec<Suspicion> {
    let mut more = Vec::new();
    let pairs = records.iter().flat_map(|r| {
        let own = found.iter().any(|s| s.what == What::Swapped && about(s, r));
        r.responses().filter_map(move |c| exchanged(r, c, machine).filter(|_| own))
    });
    let mut pairs: Vec<[String; 2]> = pairs.collect();
    pairs.sort();
    pairs.dedup();
    for pair in pairs {
        let straight = |(slope, _): (f64, f64)| slope < 0.5;
        let rest = records.iter().filter(|r| !found.iter().any(|s| about(s, r) && whole(s, r)));
        let rest: Vec<&Record> = rest.collect();
        let of = |r: &Record| {
            r.responses()
                .filter_map(|c| Exchange::new(r, c, machine).of(&pair[0], &pair[1]))
                .collect::<Vec<_>>()
        };
        // One record that is clearly as the model has it speaks for the others: the exchange is that record's alone.
        if rest.iter().any(|r| of(r).into_iter().any(|x| straight(x) && x.1 > UNTOLD)) {
            continue;
        }
        for r in rest {
            if of(r).into_iter().any(|x| !straight(x)) {
                let [a, b] = &pair;
                let text =
                    format!("the run agrees with the model better with {a} and {b} exchanged, as others do");
                more.push(Suspicion::new(r, a, What::Swapped, &[], text));
            }
        }
    }
    more
}

/// An exchange that would change less than this share of what the model says is not looked into.
const SEEN_AT_ALL: f64 = 0.1;
/// Nor one whose change is there by less than so much, or more, or explains less of what is left than that.
const THERE: std::ops::Range<f64> = 0.4..1.6;
const EXPLAINS: f64 = 0.1;
/// So many exchanges are looked into.
const LOOKED_INTO: usize = 3;
/// An exchange that explains the records better by so much, nats, than effects that are looked for is the likelier: that one
/// should go as another sensor's, to the size, is the price of a coincidence.
const LIKELIER: f64 = 3.0;

/// An exchange of errors has nothing else to be held beside: it is believed where it explains so much more, nats.
const FAR_LIKELIER: f64 = 15.0;

/// Errors along two axes in each other's place, in one record or in all of them, that explain all of what nothing explains as they
/// stand. `looked_at`: what an analysis of other records comes to.
pub(crate) fn errors_instead(
    records: &[Record],
    answer: &Answer,
    looked_at: impl Fn(&[Record]) -> Option<Answer>,
) -> Vec<Suspicion> {
    if answer.unexplained.is_empty() {
        return Vec::new();
    }
    let varies = |c: &&Column| matches!(c.role, Role::Error(_)) && centred(&c.data).iter().any(|x| *x != 0.0);
    let mut best: Option<(f64, Vec<Suspicion>)> = None;
    let pair = |r: &'_ Record| -> Option<[(Axis, String); 2]> {
        let of = |c: &Column| Some((c.role.axis()?.clone(), c.name.clone()));
        r.columns.iter().filter(varies).filter_map(of).collect::<Vec<_>>().try_into().ok()
    };
    let pairs: Vec<Option<[(Axis, String); 2]>> = records.iter().map(pair).collect();
    let with: Vec<usize> = (0..records.len()).filter(|k| pairs[*k].is_some()).collect();
    let together = (with.len() > 1).then(|| with.clone());
    for group in with.iter().map(|k| vec![*k]).chain(together).take(LOOKED_INTO) {
        let other = |(k, r): (usize, &Record)| match &pairs[k] {
            Some([(a, _), (b, _)]) if group.contains(&k) => with_errors_exchanged(r, [a, b]),
            _ => r.clone(),
        };
        let others: Vec<Record> = records.iter().enumerate().map(other).collect();
        // A shape that has no name has none in the other error either.
        let Some(Answer { evidence, .. }) = looked_at(&others).filter(|a| a.unexplained.is_empty()) else {
            continue;
        };
        if evidence > best.as_ref().map_or(answer.evidence + FAR_LIKELIER, |b| b.0) {
            let said = group.iter().filter_map(|k| {
                let [(_, a), (_, b)] = pairs[*k].as_ref()?;
                let text = format!(
                    "the run is explained far better with {a} and {b} exchanged than with anything missing"
                );
                Some(Suspicion::new(&records[*k], a, What::Swapped, &[], text))
            });
            best = Some((evidence, said.collect()));
        }
    }
    best.map_or_else(Vec::new, |b| b.1)
}

/// Sensors in each other's place, in one record or in all of them, that explain the records better than what was found does.
/// `evidence`: what an analysis of other records comes to.
pub(crate) fn instead(
    records: &[Record],
    machine: &Machine,
    answer: &Answer,
    evidence: impl Fn(&[Record]) -> Option<f64>,
) -> Vec<Suspicion> {
    if answer.findings.is_empty() && answer.unexplained.is_empty() {
        return Vec::new();
    }
    let read: BTreeSet<&str> =
        machine.effects().filter_map(|e| e.delta.as_ref()).flat_map(Difference::sensors).collect();
    let Some(first) = records.first() else { return Vec::new() };
    let sensors: Vec<&str> = first.names(&Role::Temperature).collect();
    let alone = if records.len() > 1 { records.len() } else { 0 };
    let groups: Vec<Vec<usize>> = (0..alone).map(|k| vec![k]).chain([(0..records.len()).collect()]).collect();
    let beside: Vec<Vec<Exchange<'_>>> =
        records.iter().map(|r| r.responses().map(|c| Exchange::new(r, c, machine)).collect()).collect();
    let mut tried: Vec<(f64, &[usize], [&str; 2])> = Vec::new();
    for (i, a) in sensors.iter().enumerate() {
        for b in sensors[i + 1..].iter().filter(|b| read.contains(*b) || read.contains(a)) {
            for group in &groups {
                let of = group.iter().flat_map(|k| &beside[*k]);
                let of = of.filter_map(|x| Some(Products::of(&x.change(a, b, SEEN_AT_ALL)?, &x.left)));
                let Products { own, with, all } = of.fold(Products::default(), |s, p| Products {
                    own: s.own + p.own,
                    with: s.with + p.with,
                    all: s.all + p.all,
                });
                let explains = with * with / (own * all).max(f64::MIN_POSITIVE);
                if own > 0.0 && THERE.contains(&(with / own)) && explains > EXPLAINS {
                    tried.push((with * with / own, group, [a, b]));
                }
            }
        }
    }
    tried.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut best: Option<(f64, &[usize], [&str; 2])> = None;
    for (_, group, pair) in tried.into_iter().take(LOOKED_INTO) {
        let other = |(k, r): (usize, &Record)| {
            if group.contains(&k) { with_exchanged(r, pair[0], pair[1]) } else { r.clone() }
        };
        let others: Vec<Record> = records.iter().enumerate().map(other).collect();
        let Some(found) = evidence(&others) else { continue };
        if found > best.map_or(answer.evidence + LIKELIER, |b| b.0) {
            best = Some((found, group, pair));
        }
    }
    let Some((_, group, [a, b])) = best else { return Vec::new() };
    let whole = group.len() == records.len();
    let text = if whole {
        format!("the runs agree with the model better with {a} and {b} exchanged than with anything missing")
    } else {
        format!("the run agrees with the others better with {a} and {b} exchanged than with anything missing")
    };
    group.iter().map(|k| Suspicion::new(&records[*k], a, What::Swapped, &[], text.clone())).collect()
}
