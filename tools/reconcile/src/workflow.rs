//! The whole of it: analysis, the last fit, what is written into the model, the figures.

use crate::Options;
use crate::advice::advice;
use crate::analysis::analyse;
use crate::answer::{Answer, Finding, Rival};
use crate::cause::Shape;
use crate::doubt::{self, doubts};
use crate::fit::{self, Term, Way};
use crate::gap::{Gap, gaps, traces};
use crate::problem::{Stack, known, rms};
use crate::unexplained;
use crate::verdict::{Reconciliation, Refined, Verdict};
use crate::where_found::{self, Place};
use rtec_files::InputError;
use rtec_fit::quiet;
use rtec_measure::derive::derive;
use rtec_measure::plausible::Suspicion;
use rtec_model::effect::{Dictionary, Effect, Heat, Law, Search};
use rtec_model::machine::{Machine, Provenance, Source};
use rtec_model::record::{Kind, Record, Role};
use std::borrow::Cow;

/// How far a value must move from the model's, in standard errors: about one in ten thousand by chance.
const BEYOND_CHANCE: f64 = 3.9;
/// What is left is no agreement when it is so many times the noise.
const FAR: f64 = 8.0;
/// Rows are not thinned to fewer than this.
const FEWEST_ROWS: usize = 300;
/// Steps of the last fit, and of one curve of several that stand for a shape.
const STEPS: usize = 12;
const CURVE_STEPS: usize = 6;

/// The first stage alone: where measured and simulated disagree.
///
/// # Errors
/// The model reads a sensor or channel that a record lacks.
pub fn find(train: &[Record], machine: &Machine) -> Result<Vec<Place>, InputError> {
    for record in train {
        machine.predict(record)?;
    }
    let stack = Stack::new(train);
    let file: Vec<Effect> = machine.effects().cloned().collect();
    Ok(where_found::places(&stack, &file))
}

/// Reconciles: the whole workflow.
///
/// # Errors
/// The model reads a sensor or channel that a record lacks.
pub fn reconcile(
    train: &[Record],
    holdout: &[Record],
    machine: &Machine,
    options: &Options,
) -> Result<Reconciliation, InputError> {
    for record in train.iter().chain(holdout) {
        machine.predict(record)?;
    }
    if let Some(record) = train.first().filter(|_| train.iter().all(|r| r.responses().next().is_none())) {
        let expected = "a column of role error.AXIS or force.AXIS: no effect of a model is a tilt";
        return Err(InputError::whole(&record.path, "no response", expected));
    }
    let (train, holdout, derived) = with_motion(train, holdout);
    let (train, holdout) = (&train[..], &holdout[..]);
    let doubts = doubts(train, holdout, machine);
    let nothing_left = doubts.train.is_empty();
    let given = if nothing_left { train.to_vec() } else { doubts.train };
    let Analysed { train, wild, mut answer, used, every } = Analysed::of(given, machine, options.level);
    let train = &train[..];
    if nothing_left {
        // All of it is doubted: it is shown beside the model as it is, and nothing is learned from it.
        answer.findings.clear();
        answer.unexplained.clear();
    }
    let mut stack = Stack::new(&used);
    stack.sigma.clone_from(&answer.sigma);
    let mut fitted = Fitted::of(&stack, machine, &answer);
    let mut model = machine.clone();
    let shape = answer.unexplained.first().filter(|_| options.unexplained);
    let laws = shape.and_then(|shape| fitted.stand_in(&stack, shape, train, &mut model, answer.phi));
    for (f, t) in answer.findings.iter_mut().zip(fitted.found()) {
        f.effect = whole_counts(&t.effect, train, &t.half);
    }
    warm_plate(&mut answer.findings, train, machine.dictionary());
    let refined = if nothing_left { Vec::new() } else { fitted.correct(&mut model) };
    let write = Writer { train, date: options.date.as_ref() };
    let mut effects = Vec::new();
    for (f, t) in answer.findings.iter().zip(fitted.found()) {
        // An effect of this very identity is in the model already: then it was a correction, not an addition.
        if write.add(&mut model, &f.effect, &t.half, "") {
            effects.push((f.clone(), t.half.clone()));
        }
    }
    let curve = fitted.curve().filter(|t| write.add(&mut model, &t.effect, &t.half, ": unexplained"));
    let curve = curve.map(|t| t.effect.clone()).zip(laws);
    let (mut traces_of, mut gap) = (Vec::new(), Vec::new());
    let mut said = doubts.said;
    said.extend(wild);
    let mut why = None;
    if options.figures {
        traces_of = traces(train, &doubts.holdout, machine, &model);
        gap = gaps(&stack, &used, &traces_of, &fitted.terms, &answer, doubts.holdout.is_empty());
        said.extend(doubt::other_machine(&doubts.holdout, &mut gap));
        if doubts.holdout.is_empty() && gap.iter().any(Gap::is_wider) {
            why =
                Some("what fits these rows does not predict them by blocks: how much is closed is not said");
            gap.iter_mut().filter(|g| g.is_wider()).for_each(|g| g.doubted = true);
        }
        let far = gap.iter().find(|g| g.train[1] > FAR * g.floor);
        if let Some(g) = far.filter(|_| effects.is_empty() && answer.unexplained.is_empty()) {
            // Nothing was found, and far more is left than the noise: that is no model without a gap.
            answer.unexplained.push(Shape {
                response: answer_response(&stack, g),
                against: vec!["time".to_owned()],
                manner: format!(
                    "{:.0} times as large as the noise, along nothing in particular",
                    g.train[1] / g.floor
                ),
            });
        }
    }
    let verdict = Verdict::of(&effects, &answer.unexplained);
    let mut advice = advice(verdict, &effects, &answer.unexplained, train, machine.dictionary());
    if nothing_left {
        why = Some("every record is doubted: mend what the suspicions say, then reconcile again");
    }
    if let Some(why) = why {
        advice = if advice.is_empty() { why.to_owned() } else { format!("{why}; {advice}") };
    }
    Ok(Reconciliation {
        verdict,
        places: where_found::places(&stack, &answer.file),
        advice,
        suspicions: said,
        derived,
        effects,
        unexplained: answer.unexplained,
        curve,
        refined,
        gap,
        ranking: answer.ranking,
        model,
        traces: traces_of,
        level: options.level,
        phi: answer.phi,
        every,
    })
}

/// The response that a gap's rows are largest in.
fn answer_response(stack: &Stack<'_>, gap: &Gap) -> String {
    let force = gap.unit == "N";
    let of = stack.responses.iter().map(ToString::to_string);
    of.filter(|r| r.starts_with("force") == force).collect::<Vec<_>>().join(", ")
}

/// The records with velocity and acceleration from their positions where they have none, and what was done.
fn with_motion(train: &[Record], holdout: &[Record]) -> (Vec<Record>, Vec<Record>, Vec<String>) {
    let mut notes = Vec::new();
    let mut of = |records: &[Record]| -> Vec<Record> {
        let mut records = records.to_vec();
        for r in &mut records {
            let columns = r.columns.len();
            let said = derive(r);
            if r.columns.len() > columns {
                notes.extend(said.into_iter().map(|n| format!("{}: {n}", r.file)));
            }
        }
        records
    };
    let (train, holdout) = (of(train), of(holdout));
    (train, holdout, notes)
}

/// All effects after the last fit.
struct Fitted {
    /// The model's own, then what was found, then maybe a curve.
    terms: Vec<Term>,
    file: Vec<Effect>,
    /// Which of the model's own moved beyond chance.
    moved: Vec<bool>,
    found: usize,
}

impl Fitted {
    /// Fits the model's effects and the findings jointly, then once more without those of the model's that did not move
    /// beyond chance: they stay as the file has them.
    fn of(stack: &Stack<'_>, machine: &Machine, answer: &Answer) -> Self {
        let file: Vec<Effect> = machine.effects().cloned().collect();
        let mut terms = present(stack, answer);
        terms.extend(answer.findings.iter().map(|f| Term::new(stack, f.effect.clone(), &f.held)));
        fit::fit(stack, &mut terms, answer.phi, STEPS, None);
        let moved: Vec<bool> = file.iter().zip(&terms).map(|(f, t)| beyond_chance(f, t)).collect();
        for (term, effect) in terms.iter_mut().zip(&file).zip(&moved).filter(|(_, m)| !**m).map(|(t, _)| t) {
            *term = Term::fixed(effect.clone());
        }
        fit::fit(stack, &mut terms, answer.phi, STEPS, None);
        Self { terms, file, moved, found: answer.findings.len() }
    }

    /// What was found.
    fn found(&self) -> &[Term] {
        &self.terms[self.file.len()..self.file.len() + self.found]
    }

    /// The curve that stands for what has no name.
    fn curve(&self) -> Option<&Term> {
        self.terms.get(self.file.len() + self.found)
    }

    /// Writes what moved beyond chance into the model.
    fn correct(&self, model: &mut Machine) -> Vec<Refined> {
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
    fn stand_in(
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

/// What is written beside an effect.
struct Writer<'w> {
    train: &'w [Record],
    date: Option<&'w String>,
}

impl Writer<'_> {
    /// Adds an effect to the model with where it comes from; not one of an identity that the model has.
    fn add(&self, model: &mut Machine, effect: &Effect, half: &[f64], why: &str) -> bool {
        let provenance = Provenance {
            added_by: Some(format!("rtecctl reconcile {}{why}", env!("CARGO_PKG_VERSION"))),
            date: self.date.cloned(),
            from: self.train.iter().map(Source::of).collect(),
            interval: intervals(effect, half).into_iter().collect(),
        };
        model.push(effect.clone(), provenance).is_ok()
    }
}

/// The records that were analysed, and what came of it.
struct Analysed {
    /// All their rows, as measured.
    train: Vec<Record>,
    /// Rows that were left out on the way.
    wild: Vec<Suspicion>,
    answer: Answer,
    /// What was looked at: temperatures without noise, every so many rows.
    used: Vec<Record>,
    every: usize,
}

impl Analysed {
    /// A few wild rows hide all else: what an answer leaves of them is far off everything, and then it is looked at once
    /// more without them.
    fn of(train: Vec<Record>, machine: &Machine, level: f64) -> Self {
        let quiet: Vec<Record> = train.iter().map(quiet::temperatures).collect();
        let (answer, used, every) = thinned(&quiet, machine, level);
        let rows = if every == 1 { doubt::wild(&quiet, &answer) } else { Vec::new() };
        if rows.iter().all(Vec::is_empty) {
            let used = used.into_owned();
            return Self { train, wild: Vec::new(), answer, used, every };
        }
        let pairs = || rows.iter().enumerate().filter(|(_, w)| !w.is_empty());
        let wild = pairs().filter_map(|(i, w)| doubt::say_wild(&train[i], w)).collect();
        let without = |records: &[Record]| -> Vec<Record> {
            records.iter().zip(&rows).map(|(r, w)| doubt::without_rows(r, w)).collect()
        };
        let (train, quiet) = (without(&train), without(&quiet));
        let (answer, used, every) = thinned(&quiet, machine, level);
        let used = used.into_owned();
        Self { train, wild, answer, used, every }
    }
}

/// The analysis of every nth row, n the least power of two at which noise and effects are told apart: rows much closer
/// than the noise forgets (a filtered force, sampled fast) say the same thing over and over.
fn thinned<'r>(train: &'r [Record], machine: &Machine, level: f64) -> (Answer, Cow<'r, [Record]>, usize) {
    let mut every = 1;
    let mut used = Cow::Borrowed(train);
    loop {
        let rows: usize = used.iter().map(Record::rows).sum();
        if let Some(answer) = analyse(&used, machine, level, rows >= 2 * FEWEST_ROWS) {
            return (answer, used, every);
        }
        every *= 2;
        let of = |r: &Record| r.select(&(0..r.rows()).step_by(every).collect::<Vec<_>>());
        used = train.iter().map(of).collect();
    }
}

/// Scales that are wrong alike on every axis of a plate whose temperature nobody logged may as well be a plate that is
/// not at 20 °C.
fn warm_plate(findings: &mut [Finding], train: &[Record], dictionary: &Dictionary) {
    let Some(expansion) = dictionary.laws().map(Law::describe).find(|l| l.heat == Heat::Expansion) else {
        return;
    };
    let scale = |f: &Finding| expansion.companion == Some(f.effect.description().name.as_str());
    let silent = train
        .iter()
        .all(|r| matches!(r.kind, Kind::Plate | Kind::Part) && r.column(&Role::Temperature).is_none());
    let ppm: Vec<f64> = findings.iter().filter(|f| scale(f)).map(|f| f.effect.scalar(0)).collect();
    let (lo, hi) = ppm.iter().fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(*v), h.max(*v)));
    if !silent || ppm.len() < 2 || lo * hi <= 0.0 || (hi - lo).abs() > 0.5 * lo.abs().max(hi.abs()) {
        return;
    }
    for f in findings.iter_mut().filter(|f| scale(f)) {
        let name = format!("{}.{}", expansion.name, f.effect.axes()[0]);
        f.rivals.push(Rival { name, sensor: None, margin: 0.0 });
    }
}

/// Lost counts are whole ones: rounded where the interval allows.
fn whole_counts(effect: &Effect, records: &[Record], half: &[f64]) -> Effect {
    let mut out = effect.clone();
    let count = records.iter().find_map(|r| r.count_um);
    if let (true, Some(count)) = (effect.description().whole_counts, count) {
        let um = effect.scalar(0);
        let whole = (um / count).round() * count;
        if whole != 0.0 && (um - whole).abs() < half[0] * 2.0 {
            out = out.with(&[(0, whole)]).unwrap_or(out);
        }
    }
    out
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

fn intervals(effect: &Effect, half: &[f64]) -> Vec<(String, Vec<[f64; 2]>)> {
    let width = effect.width();
    effect
        .description()
        .parameters
        .iter()
        .enumerate()
        .filter(|(i, p)| {
            p.search != Search::Chosen && half[i * width..(i + 1) * width].iter().any(|h| *h > 0.0)
        })
        .map(|(i, p)| {
            let pairs = effect.get(i).iter().zip(&half[i * width..]).map(|(v, h)| [v - h, v + h]).collect();
            (p.name.clone(), pairs)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{noise, record};

    /// A reversal of no name is in no one's way: an error in proportion to the position is a scale, and nothing else.
    #[test]
    fn what_is_missing_is_named_and_written() {
        let dice = noise(7, 300);
        let mut run = record(300, |i| dice[i as usize]);
        let p = run.columns[1].data.clone();
        for (e, p) in run.columns[2].data.iter_mut().zip(&p) {
            *e += 120.0 * p / 1000.0;
        }
        let r = reconcile(&[run], &[], &Machine::ideal("m"), &Options::default()).unwrap();
        assert_eq!(r.verdict, Verdict::Named, "{}", r.to_json());
        let (f, half) = &r.effects[0];
        assert_eq!((f.effect.name().as_str(), r.model.effects().count()), ("scale.x", 1));
        assert!((f.effect.scalar(0) - 120.0).abs() < 2.0 * half[0] && f.p_value < 1e-3);
        assert!(r.gap[0].closed().is_some_and(|c| c > 0.9), "{:?}", r.gap);
    }

    #[test]
    fn lost_counts_are_whole_where_the_interval_allows() {
        let mut effect = Dictionary::default().effect("lost_counts.x").unwrap();
        effect.set("um", &[9.7]).unwrap();
        let mut run = record(10, |i| i);
        run.count_um = Some(2.0);
        assert!((whole_counts(&effect, &[run.clone()], &[0.5, 0.0]).scalar(0) - 10.0).abs() < 1e-12);
        assert!((whole_counts(&effect, &[run], &[0.1, 0.0]).scalar(0) - 9.7).abs() < 1e-12);
    }

    /// A slope of 3 mm in a metre is no scale: nothing is named outside its bounds, nor written.
    #[test]
    fn outside_its_bounds_nothing_is_named() {
        let dice = noise(8, 300);
        let mut run = record(300, |i| dice[i as usize]);
        let p = run.columns[1].data.clone();
        for (e, p) in run.columns[2].data.iter_mut().zip(&p) {
            *e += 3000.0 * p / 1000.0;
        }
        let r = reconcile(&[run], &[], &Machine::ideal("m"), &Options::default()).unwrap();
        assert!(r.effects.iter().all(|(f, _)| f.effect.is_physical() && f.effect.name() != "scale.x"));
        assert!(r.model.effects().all(Effect::is_physical), "{}", r.model.to_text());
        let rivals = r.effects.iter().flat_map(|(f, _)| &f.rivals);
        assert!(rivals.into_iter().all(|r| r.name != "scale.x"));
    }
}
