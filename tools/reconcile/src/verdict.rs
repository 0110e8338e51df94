//! From the analysis to the document, the better model and the figures of the gap.

use crate::analysis::{Answer, Finding, Rival, Tried, analyse};
use crate::fit::{self, Term};
use crate::hypotheses::{self, Shape};
use crate::problem::{Stack, known, rms};
use crate::search::GRID_SHARE;
use crate::unexplained;
use crate::wherein::{self, Place};
use crate::{Options, SEED};
use rtec_files::InputError;
use rtec_model::effect::{Against, Dictionary, Difference, Effect, Heat, Law, Search};
use rtec_model::machine::{Machine, Provenance, Source};
use rtec_model::record::{Kind, Record, Role};
use serde_json::{Map, Value, json};
use std::borrow::Cow;

/// How far measured and simulated are apart, for the responses of one unit.
#[derive(Debug, Clone)]
pub struct Gap {
    /// The responses' unit.
    pub unit: String,
    /// Root mean square on the training records: before, after.
    pub train: [f64; 2],
    /// The same on the hold-outs.
    pub holdout: Option<[f64; 2]>,
    /// The same by blocked cross-validation, where there is no hold-out.
    pub blocked: Option<[f64; 2]>,
    /// Repeatability of the data.
    pub floor: f64,
}

impl Gap {
    /// Share of the gap that is closed on the hold-out (or by cross-validation): 1 is down to the floor.
    #[must_use]
    pub fn closed(&self) -> Option<f64> {
        let [before, after] = self.holdout.or(self.blocked).unwrap_or(self.train);
        (before > self.floor).then(|| (before - after) / (before - self.floor))
    }
}

/// What the data correct in the present model.
#[derive(Debug, Clone)]
pub struct Refined {
    /// Place in the model.
    pub place: usize,
    /// The effect as it was.
    pub before: Effect,
    /// The effect as the data have it, and half widths of its intervals.
    pub after: (Effect, Vec<f64>),
}

/// The whole answer.
#[derive(Debug)]
pub struct Reconciliation {
    /// `named`, `nothing_missing`, `unknown_effect` or `not_separable`.
    pub verdict: &'static str,
    /// Where measured and simulated disagree.
    pub places: Vec<Place>,
    /// What was added, strongest first, with half widths of the intervals.
    pub effects: Vec<(Finding, Vec<f64>)>,
    /// Structure without a name.
    pub unexplained: Vec<Shape>,
    /// Where asked for: the curve that stands for what is unexplained, and the file of its law.
    pub curve: Option<(Effect, String)>,
    /// Corrected parameters.
    pub refined: Vec<Refined>,
    /// The gap, one per unit.
    pub gap: Vec<Gap>,
    /// The experiment that would separate what this data cannot.
    pub advice: String,
    /// Names that were tried.
    pub ranking: Vec<Tried>,
    /// The better model.
    pub model: Machine,
    /// Per record and response: role, measured minus simulated before and after.
    pub traces: Vec<Trace>,
    /// False-alarm rate.
    pub level: f64,
    /// Autocorrelation of the noise from row to row.
    pub phi: f64,
    /// Every so many rows were analysed: 1 for all.
    pub every: usize,
}

/// What the simulation leaves of one response of one record.
#[derive(Debug, Clone)]
pub struct Trace {
    /// The record's file.
    pub file: String,
    /// The response.
    pub response: String,
    /// Whether it was held out.
    pub holdout: bool,
    /// Row times, s.
    pub time_s: Vec<f64>,
    /// Measured minus simulated with the model as it was.
    pub before: Vec<f64>,
    /// The same with the better model.
    pub after: Vec<f64>,
}

/// How far a value must move from the model's, in standard errors: about one in ten thousand by chance.
const BEYOND_CHANCE: f64 = 3.9;
/// Rows are not thinned to fewer than this.
const FEWEST_ROWS: usize = 300;
/// Folds of the blocked cross-validation.
const FOLDS: usize = 5;

/// The first stage alone: where measured and simulated disagree. Noise is taken from what the model leaves, so that
/// structure which is named later counts as noise here: less is found than beside an answer, never more.
///
/// # Errors
/// The model reads a sensor or channel that a record lacks.
pub fn find(train: &[Record], machine: &Machine) -> Result<Vec<Place>, InputError> {
    for record in train {
        machine.predict(record)?;
    }
    let (stack, file, noise) = crate::analysis::noise_of(train, machine);
    Ok(wherein::places(&stack, &file, &noise))
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
    let (answer, used, every) = thinned(train, machine, options.level);
    let mut stack = Stack::new(&used);
    stack.sigma.clone_from(&answer.sigma);
    let file: Vec<Effect> = machine.effects().cloned().collect();
    let trust = |effects: &[Effect]| -> Vec<Vec<f64>> {
        let mut sd: Vec<Vec<f64>> = file.iter().map(|e| vec![0.0; e.values().len()]).collect();
        for k in known(&stack, 1.0, &answer.anchor, effects) {
            for (v, w) in &k.along {
                sd[k.effect][*v] = sd[k.effect][*v].max(k.sd * w.abs());
            }
        }
        sd
    };
    let sd = trust(&answer.present);
    let mut terms: Vec<Term> = answer
        .present
        .iter()
        .enumerate()
        .map(|(e, effect)| {
            let held: Vec<usize> = (0..sd[e].len()).filter(|v| sd[e][*v] == 0.0).collect();
            let mut t = Term::new(effect.clone(), &held);
            t.prior = Some((answer.anchor[e].values().to_vec(), sd[e].clone()));
            t
        })
        .collect();
    terms.extend(answer.findings.iter().map(|f| Term::new(f.effect.clone(), &f.held)));
    fit::fit(&stack, &mut terms, answer.phi, 12, None);
    // Only what moved beyond chance is corrected; the rest of the model stays as the file has it.
    let moved: Vec<bool> = file
        .iter()
        .zip(&terms)
        .map(|(f, t)| {
            f.values().iter().zip(t.effect.values()).zip(&t.half).any(|((a, b), half)| {
                *half > 0.0 && (a - b).abs() > BEYOND_CHANCE / 1.96 * half && (a - b).abs() > 1e-9 * a.abs()
            })
        })
        .collect();
    for (e, term) in terms.iter_mut().enumerate().take(file.len()) {
        if !moved[e] {
            *term = Term::fixed(file[e].clone());
        }
    }
    fit::fit(&stack, &mut terms, answer.phi, 12, None);
    let mut answer = answer;
    let mut model = machine.clone();
    let found = terms.len();
    let laws = match answer.unexplained.first() {
        Some(shape) if options.unexplained => {
            stand_in(&stack, shape, train, &mut model, &mut terms, answer.phi)
        }
        _ => None,
    };
    for (f, t) in answer.findings.iter_mut().zip(&terms[file.len()..found]) {
        f.effect = whole_counts(&t.effect, train, &t.half);
    }
    warm_plate(&mut answer.findings, train, machine.dictionary());
    let mut refined = Vec::new();
    for (e, before) in file.iter().enumerate().filter(|(e, _)| moved[*e]) {
        let (after, half) = (&terms[e].effect, &terms[e].half);
        write_values(&mut model, e, after, half);
        refined.push(Refined { place: e, before: before.clone(), after: (after.clone(), half.clone()) });
    }
    let mut effects = Vec::new();
    for (f, t) in answer.findings.iter().zip(&terms[file.len()..found]) {
        let provenance = Provenance {
            added_by: Some(format!("rtecctl reconcile {}", env!("CARGO_PKG_VERSION"))),
            date: options.date.clone(),
            from: train.iter().map(Source::of).collect(),
            interval: intervals(&f.effect, &t.half).into_iter().collect(),
        };
        // An effect of this very identity is in the model already: then it was a correction, not an addition.
        if model.push(f.effect.clone(), provenance).is_ok() {
            effects.push((f.clone(), t.half.clone()));
        }
    }
    let mut curve = None;
    if let (Some(t), Some(_)) = (terms.get(found), &laws) {
        let provenance = Provenance {
            added_by: Some(format!("rtecctl reconcile {}: unexplained", env!("CARGO_PKG_VERSION"))),
            date: options.date.clone(),
            from: train.iter().map(Source::of).collect(),
            interval: intervals(&t.effect, &t.half).into_iter().collect(),
        };
        if model.push(t.effect.clone(), provenance).is_ok() {
            curve = Some(t.effect.clone());
        }
    }
    let verdict = if !answer.unexplained.is_empty() {
        "unknown_effect"
    } else if effects.is_empty() {
        "nothing_missing"
    } else if effects.iter().any(|(f, _)| !f.rivals.is_empty()) {
        "not_separable"
    } else {
        "named"
    };
    let (mut traces_of, mut gap) = (Vec::new(), Vec::new());
    if options.figures {
        traces_of = traces(train, holdout, machine, &model);
        gap = gaps(&stack, &used, &traces_of, &terms, &answer, holdout.is_empty());
    }
    let mut advice = advice(verdict, &effects, &answer.unexplained, machine);
    for text in effects.iter().filter_map(|(f, _)| other_periods(&f.effect, train)) {
        advice = if advice.is_empty() { text } else { format!("{advice}; {text}") };
    }
    let places = wherein::places(&stack, &answer.file, &answer.draws);
    Ok(Reconciliation {
        verdict,
        places,
        effects,
        unexplained: answer.unexplained,
        curve: curve.zip(laws),
        refined,
        gap,
        advice,
        ranking: answer.ranking,
        model,
        traces: traces_of,
        level: options.level,
        phi: answer.phi,
        every,
    })
}

/// Adds the curve that stands for a shape to the terms, with as many knots as the data pay for. The laws that the model
/// names then.
fn stand_in(
    stack: &Stack<'_>,
    shape: &Shape,
    train: &[Record],
    model: &mut Machine,
    terms: &mut Vec<Term>,
    phi: f64,
) -> Option<String> {
    let mut best: Option<(f64, Machine, Vec<Term>, String)> = None;
    for knots in [5, 9, 17, 33] {
        let (mut machine, mut all) = (model.clone(), terms.clone());
        let Some(curve) = unexplained::stand_in(shape, knots, train, &mut machine) else { continue };
        all.push(Term::new(curve.effect, &[]));
        fit::fit(stack, &mut all, phi, 6, None);
        let n = stack.n as f64;
        let score = n * rms(&fit::residual(stack, &all)).max(1e-12).ln() + 0.5 * knots as f64 * n.ln();
        if best.as_ref().is_none_or(|b| score < b.0) {
            best = Some((score, machine, all, curve.laws));
        }
    }
    let (_, machine, all, laws) = best?;
    (*model, *terms) = (machine, all);
    Some(laws)
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

fn traces(train: &[Record], holdout: &[Record], before: &Machine, after: &Machine) -> Vec<Trace> {
    let mut out = Vec::new();
    for (record, held) in train.iter().map(|r| (r, false)).chain(holdout.iter().map(|r| (r, true))) {
        for column in record.responses() {
            let left = |machine: &Machine| {
                let mut sum = vec![0.0; record.rows()];
                for e in machine.effects() {
                    let _absent = e.add(record, &column.role, &mut sum);
                }
                column.data.iter().zip(&sum).map(|(m, s)| m - s).collect::<Vec<f64>>()
            };
            out.push(Trace {
                file: record.file.clone(),
                response: column.role.to_string(),
                holdout: held,
                time_s: record.time_s().to_vec(),
                before: left(before),
                after: left(after),
            });
        }
    }
    out
}

fn unit_of(response: &str) -> &'static str {
    if response.starts_with("force") { "N" } else { "um" }
}

fn gaps(
    stack: &Stack<'_>,
    train: &[Record],
    traces: &[Trace],
    terms: &[Term],
    answer: &Answer,
    fold: bool,
) -> Vec<Gap> {
    let mut units: Vec<&str> = traces.iter().map(|t| unit_of(&t.response)).collect();
    units.sort_unstable();
    units.dedup();
    let blocked = fold.then(|| blocked(stack, terms, answer));
    units
        .into_iter()
        .map(|unit| {
            let pooled = |held: bool| -> Option<[f64; 2]> {
                let of: Vec<&Trace> =
                    traces.iter().filter(|t| t.holdout == held && unit_of(&t.response) == unit).collect();
                if of.is_empty() {
                    return None;
                }
                let pool =
                    |f: fn(&Trace) -> &[f64]| rms(&of.iter().flat_map(|t| f(t)).copied().collect::<Vec<_>>());
                Some([pool(|t| &t.before), pool(|t| &t.after)])
            };
            let train_gap = pooled(false).unwrap_or([0.0; 2]);
            let rows =
                |s: &&crate::problem::Segment| unit_of(&stack.responses[s.response].to_string()) == unit;
            let mut left = Vec::new();
            for s in stack.segments.iter().filter(rows) {
                left.extend(answer.residual[s.rows.clone()].iter().map(|r| r * stack.sigma[s.response]));
            }
            let freedom = terms.iter().flat_map(|t| &t.half).filter(|h| **h > 0.0).count() as f64;
            let n = left.len() as f64;
            let noise = rms(&left) * (n / (n - freedom).max(1.0)).sqrt();
            let floor = repeatability(stack, train, answer, unit).unwrap_or(noise).min(noise);
            let blocked = blocked.as_ref().map(|all| {
                let mut after = Vec::new();
                for s in stack.segments.iter().filter(rows) {
                    after.extend(all[s.rows.clone()].iter().map(|r| r * stack.sigma[s.response]));
                }
                [train_gap[0], rms(&after)]
            });
            Gap { unit: unit.to_owned(), train: train_gap, holdout: pooled(true), blocked, floor }
        })
        .collect()
}

/// Spread among repeats at equal positions and directions, where a record has a cycle column: of what the best
/// explanation leaves, so that a drift from cycle to cycle is no lack of repeatability.
fn repeatability(stack: &Stack<'_>, train: &[Record], answer: &Answer, unit: &str) -> Option<f64> {
    let (mut sum, mut freedom) = (0.0, 0.0);
    for s in stack.segments.iter().filter(|s| unit_of(&stack.responses[s.response].to_string()) == unit) {
        let record = &train[s.record];
        record.column(&Role::Cycle)?;
        let keys: Vec<&[f64]> = record
            .columns
            .iter()
            .filter(|c| {
                matches!(c.role, Role::Position(_) | Role::Direction(_) | Role::Coolant | Role::Angle)
            })
            .map(|c| c.data.as_slice())
            .collect();
        if keys.is_empty() {
            return None;
        }
        let mut groups: std::collections::BTreeMap<Vec<i64>, Vec<f64>> = std::collections::BTreeMap::new();
        for (row, r) in answer.residual[s.rows.clone()].iter().enumerate() {
            // Positions reached again differ by little: 50 µm is the same target.
            let key = keys.iter().map(|k| (k[row] * 20.0).round() as i64).collect();
            groups.entry(key).or_default().push(r * stack.sigma[s.response]);
        }
        for g in groups.values().filter(|g| g.len() > 1) {
            let mean = g.iter().sum::<f64>() / g.len() as f64;
            sum += g.iter().map(|x| (x - mean).powi(2)).sum::<f64>();
            freedom += g.len() as f64 - 1.0;
        }
    }
    (freedom > 10.0).then(|| (sum / freedom).sqrt())
}

/// What the better model leaves of rows that its parameters were not fitted on, block by block, weighed.
fn blocked(stack: &Stack<'_>, terms: &[Term], answer: &Answer) -> Vec<f64> {
    let mut out = vec![0.0; stack.n];
    for fold in 0..FOLDS {
        let mut keep = vec![true; stack.n];
        for s in &stack.ranges {
            let n = s.len();
            keep[s.start + n * fold / FOLDS..s.start + n * (fold + 1) / FOLDS].fill(false);
        }
        let mut without = terms.to_vec();
        fit::fit(stack, &mut without, answer.phi, 2, Some(&keep));
        let r = fit::residual(stack, &without);
        for (i, k) in keep.iter().enumerate() {
            if !k {
                out[i] = r[i];
            }
        }
    }
    out
}

/// Periods that a grid of targets cannot tell from the one that is given.
fn other_periods(effect: &Effect, train: &[Record]) -> Option<String> {
    let law = effect.description();
    let unit_mm = law.searched.wave?.unit_mm;
    let role = Role::Position(effect.axes()[0].clone());
    let mut places: Vec<f64> = train.iter().filter_map(|r| r.data(&role)).flatten().copied().collect();
    places.sort_by(f64::total_cmp);
    let period_mm = effect.scalar(0) * unit_mm;
    let pitch = hypotheses::pitch(&places, GRID_SHARE * period_mm)?;
    let [lo, hi] = law.parameters[0].bounds;
    let range = [1.0 / (hi * unit_mm), 1.0 / (lo * unit_mm)];
    let others: Vec<String> = hypotheses::aliases(1.0 / period_mm, pitch, range, 7)
        .iter()
        .map(|f| 1.0 / (f * unit_mm))
        .filter(|p| (p / effect.scalar(0) - 1.0).abs() > 1e-3)
        .map(|p| format!("{p:.4}"))
        .collect();
    let unit = &law.parameters[0].unit;
    (!others.is_empty()).then(|| {
        format!(
            "the targets of {} lie on a grid of {pitch:.4} mm, on which a period of {:.4} {unit} looks the same as {} {unit} \
             and more: targets at uneven distances (or the lead by the screw's data sheet) tell which it is",
            effect.name(),
            effect.scalar(0),
            others.join(", ")
        )
    })
}

fn advice(verdict: &str, effects: &[(Finding, Vec<f64>)], shapes: &[Shape], machine: &Machine) -> String {
    let dictionary = machine.dictionary();
    match verdict {
        "not_separable" => {
            let mut parts: Vec<String> = Vec::new();
            for (f, _) in effects.iter().filter(|(f, _)| !f.rivals.is_empty()) {
                let name = f.effect.name();
                let same: Vec<String> = f
                    .rivals
                    .iter()
                    .filter(|r| r.name == name)
                    .filter_map(|r| r.sensor.as_ref().map(ToString::to_string))
                    .collect();
                if !same.is_empty() {
                    parts.push(format!(
                        "{name}: sensors {} and {} saw the same here; a run in which they part (heat one place only, or \
                         let the machine cool while the surroundings warm) would tell them apart",
                        f.effect.delta.as_ref().map_or_else(String::new, ToString::to_string),
                        same.join(", ")
                    ));
                }
                let mut seen = vec![name.clone()];
                for r in &f.rivals {
                    if seen.contains(&r.name) {
                        continue;
                    }
                    seen.push(r.name.clone());
                    if let Ok(e) = dictionary.effect(&r.name) {
                        parts.push(format!("{name} or {}: {}", r.name, e.description().experiment));
                    }
                }
            }
            parts.join("; ")
        }
        "unknown_effect" => shapes
            .iter()
            .map(|s| {
                format!(
                    "{} has structure against {} ({}) that no effect of the dictionary explains: repeat the run with {} \
                     varied by itself, all else held",
                    s.response,
                    s.against.join(" and "),
                    s.manner,
                    s.against[0]
                )
            })
            .collect::<Vec<_>>()
            .join("; "),
        "named" => effects
            .iter()
            .map(|(f, _)| format!("to narrow {}: {}", f.effect.name(), f.effect.description().experiment))
            .collect::<Vec<_>>()
            .join("; "),
        _ => String::new(),
    }
}

fn sensor_keys(map: &mut Map<String, Value>, sensor: Option<&Difference>) {
    if let Some(d) = sensor {
        map.insert("sensor".into(), json!(d.sensor));
        match &d.against {
            Against::Sensor(m) => map.insert("minus".into(), json!(m)),
            Against::Reference(degc) => map.insert("reference_degC".into(), json!(degc)),
            Against::Standard => None,
        };
    }
}

fn parameters(
    effect: &Effect,
    half: &[f64],
    before: Option<&Effect>,
) -> (Map<String, Value>, Map<String, Value>) {
    let (mut beside, mut inside) = (Map::new(), Map::new());
    let width = effect.width();
    for (i, p) in effect.description().parameters.iter().enumerate() {
        let one = |v: Vec<f64>| if p.array { json!(v) } else { json!(v[0]) };
        if p.array && p.search == Search::Chosen {
            beside.insert(p.name.clone(), json!(effect.get(i)));
            continue;
        }
        let h = &half[i * width..(i + 1) * width];
        let values = effect.get(i);
        let mut entry = Map::new();
        if let Some(b) = before {
            entry.insert("before".into(), one(b.get(i).to_vec()));
        }
        entry.insert("value".into(), one(values.to_vec()));
        entry.insert("low".into(), one(values.iter().zip(h).map(|(v, h)| v - h).collect()));
        entry.insert("high".into(), one(values.iter().zip(h).map(|(v, h)| v + h).collect()));
        inside.insert(p.name.clone(), Value::Object(entry));
    }
    (beside, inside)
}

impl Reconciliation {
    /// The document of formats.md.
    #[must_use]
    pub fn to_json(&self) -> Value {
        let effects: Vec<Value> = self
            .effects
            .iter()
            .map(|(f, half)| {
                let (mut map, inside) = parameters(&f.effect, half, None);
                map.insert("name".into(), json!(f.effect.name()));
                sensor_keys(&mut map, f.effect.delta.as_ref());
                map.insert("parameters".into(), Value::Object(inside));
                map.insert("p_value".into(), json!(f.p_value));
                map.insert("log_evidence".into(), json!(f.evidence));
                let alternatives: Vec<Value> = f
                    .rivals
                    .iter()
                    .map(|r| {
                        let mut m = Map::new();
                        m.insert("name".into(), json!(r.name));
                        sensor_keys(&mut m, r.sensor.as_ref());
                        m.insert("log_odds".into(), json!(r.margin));
                        Value::Object(m)
                    })
                    .collect();
                map.insert("alternatives".into(), json!(alternatives));
                Value::Object(map)
            })
            .collect();
        let refined: Vec<Value> = self
            .refined
            .iter()
            .map(|r| {
                let (mut map, inside) = parameters(&r.after.0, &r.after.1, Some(&r.before));
                map.insert("name".into(), json!(r.before.name()));
                sensor_keys(&mut map, r.before.delta.as_ref());
                map.insert("parameters".into(), Value::Object(inside));
                Value::Object(map)
            })
            .collect();
        let gaps: Vec<Value> = self
            .gap
            .iter()
            .map(|g| {
                let pair = |p: [f64; 2]| json!({"before": p[0], "after": p[1]});
                json!({
                    "train": pair(g.train),
                    "holdout": g.holdout.map(pair),
                    "cross_validation": g.blocked.map(pair),
                    "floor": g.floor,
                    "unit": g.unit,
                    "closed": g.closed(),
                })
            })
            .collect();
        json!({
            "verdict": self.verdict,
            "where": self.places.iter().map(Place::to_json).collect::<Vec<_>>(),
            "effects": effects,
            "refined": refined,
            "stand_in": self.curve.as_ref().map(|(e, _)| json!({"name": e.name(), "file": crate::LAWS_FILE})),
            "unexplained": self.unexplained.iter().map(|s| json!({
                "response": s.response, "against": s.against, "manner": s.manner,
            })).collect::<Vec<_>>(),
            "gap": if let [one] = &gaps[..] { one.clone() } else { json!(gaps) },
            "advice": self.advice,
            "tried": self.ranking.iter().map(|t| json!({
                "name": t.label, "log_odds": t.odds, "accepted": t.accepted,
            })).collect::<Vec<_>>(),
            "level": self.level,
            "seed": SEED,
            "noise": {"autocorrelation": self.phi, "every_nth_row": self.every},
        })
    }
}
