//! Plans the run that separates an effect from its rivals, before it is measured.
//! Each possible run is simulated without noise. The residual that the best of a rival's curves leaves is
//! compared with the noise of the records.
//!
//! The log odds of a run are half of that residual, in noise variances (the likelihood ratio of normal
//! noise). Noise spreads them by √(2·odds). A run suffices if the odds less two such standard deviations are
//! still enough, whichever explanation is true.

use rtec_estimate::RivalExplanation;
use rtec_estimate::measurement_model::EstimationProblem;
use rtec_estimate::priors::HELD;
use rtec_estimate::rows_and_noise::{MeasuredRows, ResponseNoise};
use rtec_files::InputError;
use rtec_least_squares::QrFactor;
use rtec_measure::plan::{PlanAxis, PlannedRun, TargetRun, target_run};
use rtec_model::effect::{AffectedQuantity, Dictionary, Effect, ReferenceTemperature, TemperatureDifference};
use rtec_model::machine::Machine;
use rtec_model::record::{Axis, Column, Record, ReversalPoint, Role, RunKind};
use serde::Serialize;
use serde_json::{Map, Value};
use std::path::Path;

/// Numbers of targets and cycles of the runs that are tried.
const TARGETS: [usize; 4] = [11, 21, 41, 81];
const CYCLES: [usize; 3] = [2, 3, 5];
/// Temperature rise in the second half of a run that needs one, K.
const WARMER_K: f64 = 5.0;
/// Prior size of a curve, in units of a row's noise: practically free.
const FREE: f64 = 1e4;

/// An effect that a verdict named, with its unresolved rivals.
#[derive(Debug, Clone)]
pub struct UnresolvedEffect {
    /// The effect with its values.
    pub effect: Effect,
    /// Its rivals.
    pub rivals: Vec<RivalExplanation>,
    /// Noise of one reading, in the response's unit.
    pub noise: f64,
}

impl UnresolvedEffect {
    /// Reads the unresolved effects of a `verdict.json`.
    ///
    /// # Errors
    /// A file that is not a verdict, or names an effect that the dictionary does not have.
    pub fn read(path: &Path, dictionary: &Dictionary) -> Result<Vec<Self>, InputError> {
        let bad = |found: String| {
            InputError::whole(path, found, "verdict.json, as `rtecctl reconcile --out` writes it")
        };
        let text = std::fs::read_to_string(path).map_err(|e| bad(e.to_string()))?;
        let document: Value = serde_json::from_str(&text).map_err(|e| bad(e.to_string()))?;
        let list = document.get("effects").and_then(Value::as_array);
        let list = list.ok_or_else(|| bad("no list `effects`".to_owned()))?;
        let one = |v: &Value| {
            let map = v.as_object().ok_or_else(|| bad(format!("the effect {v}")))?;
            Self::of(map, &document, dictionary).map_err(&bad)
        };
        list.iter().map(one).collect()
    }

    fn of(map: &Map<String, Value>, document: &Value, dictionary: &Dictionary) -> Result<Self, String> {
        let name = name_of(map)?;
        let mut effect = dictionary.effect(name).map_err(|e| format!("the effect {}", e.found))?;
        effect.delta = difference(map);
        let inside = map.get("parameters").and_then(Value::as_object);
        let mut values = Vec::new();
        for p in &effect.description().parameters {
            let value = inside.and_then(|i| i.get(&p.name)?.get("value")).or_else(|| map.get(&p.name));
            let value = value.ok_or_else(|| format!("{name} without {}", p.name))?;
            let many = value.as_array().map(|a| a.iter().filter_map(Value::as_f64).collect::<Vec<_>>());
            values.extend(many.unwrap_or_else(|| value.as_f64().into_iter().collect()));
        }
        effect.set_values(&values).map_err(|e| e.to_string())?;
        let unit = if is_force(&effect) { "N" } else { "um" };
        let gaps = document
            .get("gap")
            .map_or_else(Vec::new, |g| g.as_array().cloned().unwrap_or_else(|| vec![g.clone()]));
        let own = gaps.iter().find(|g| g.get("unit").and_then(Value::as_str) == Some(unit));
        let noise = own.and_then(|g| g.get("floor")?.as_f64()).filter(|f| *f > 0.0);
        let rivals = map.get("alternatives").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
        let rival = |v: &Value| {
            let map = v.as_object().ok_or_else(|| format!("the alternative {v}"))?;
            let parameters = &effect.description().parameters;
            let differs = parameters.iter().find_map(|p| Some((p.name.clone(), map.get(&p.name)?.as_f64()?)));
            let margin = map.get("log_odds").and_then(Value::as_f64).unwrap_or(0.0);
            Ok(RivalExplanation { name: name_of(map)?.to_owned(), sensor: difference(map), differs, margin })
        };
        let rivals = rivals.iter().map(rival).collect::<Result<_, String>>()?;
        Ok(Self { noise: noise.ok_or_else(|| format!("no floor of the gap in {unit}"))?, effect, rivals })
    }
}

fn name_of(map: &Map<String, Value>) -> Result<&str, String> {
    map.get("name").and_then(Value::as_str).ok_or_else(|| "an effect without a name".to_owned())
}

fn is_force(effect: &Effect) -> bool {
    effect.description().quantity == AffectedQuantity::Force
}

/// The temperature difference of an entry, if it has one.
fn difference(map: &Map<String, Value>) -> Option<TemperatureDifference> {
    let text = |key: &str| map.get(key).and_then(Value::as_str);
    let sensor = text("sensor")?.to_owned();
    let reference = map
        .get("reference_degC")
        .and_then(Value::as_f64)
        .map_or(ReferenceTemperature::Standard, ReferenceTemperature::Reference);
    let against = text("minus").map_or(reference, |m| ReferenceTemperature::Sensor(m.to_owned()));
    Some(TemperatureDifference { sensor, against })
}

/// The expected evidence of a run for an effect against a rival.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ExpectedEvidence {
    /// The effect.
    pub effect: String,
    /// The rival.
    pub rival: String,
    /// Expected log odds; `None` if no run of targets separates them.
    pub log_odds: Option<f64>,
    /// The record that separates them, or else the experiment that would.
    pub by: String,
}

/// The runs to make, and the evidence to expect.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NextRuns {
    /// The runs, in the form of a plan.
    pub steps: Vec<PlannedRun>,
    /// One entry for every effect and rival.
    pub tells: Vec<ExpectedEvidence>,
}

/// Whether log odds are beyond chance for one name among this many rivals.
fn is_enough(log_odds: f64, rivals: usize) -> bool {
    let wanted = (HELD / (1.0 - HELD)).ln() + (rivals.max(1) as f64).ln();
    log_odds - 2.0 * (2.0 * log_odds).sqrt() >= wanted
}

/// The axis along which an effect's curve runs.
/// It is the last axis of its name that the machine has.
fn along<'a>(effect: &Effect, axes: &'a [PlanAxis]) -> Option<&'a PlanAxis> {
    effect.axes().iter().rev().find_map(|a| axes.iter().find(|p| p.name == a.as_str()))
}

/// The shortest runs of targets that separate open effects from their rivals.
/// There is one for each axis and response, on a machine with these axes and this model. If no such run
/// separates them, the experiment of the rival's law is listed.
#[must_use]
pub fn next_runs(open: &[UnresolvedEffect], machine: &Machine, axes: &[PlanAxis]) -> NextRuns {
    let mut out = NextRuns { steps: Vec::new(), tells: Vec::new() };
    for o in open.iter().filter(|o| !o.rivals.is_empty()) {
        let rivals: Vec<(&RivalExplanation, Option<Effect>)> =
            o.rivals.iter().map(|r| (r, effect_of(r, &o.effect, machine))).collect();
        let Some(axis) = along(&o.effect, axes) else {
            out.tells.extend(rivals.iter().map(|(r, e)| not_told(o, r, e.as_ref())));
            continue;
        };
        // Any explanation may be true: the one that was found, or a rival of the same law.
        let others = rivals.iter().filter(|(r, _)| r.differs.is_some()).filter_map(|(_, e)| e.as_ref());
        let truths: Vec<&Effect> = std::iter::once(&o.effect).chain(others).collect();
        let odds = |run: &TargetRun| -> Vec<f64> {
            let all: Vec<_> =
                truths.iter().map(|t| (*t, SimulatedRun::of(run, axis, o, t, machine))).collect();
            let of = |(r, e): &(&RivalExplanation, Option<Effect>)| {
                let Some(rival) = e.as_ref() else { return 0.0 };
                let others = all.iter().filter(|(truth, _)| !std::ptr::eq(*truth, rival));
                others.map(|(_, run)| run.log_odds(rival, r.differs.is_some())).fold(f64::INFINITY, f64::min)
            };
            rivals.iter().map(of).collect()
        };
        let runs = candidates(axis);
        // If the longest run does not separate a rival, no run does.
        let most = runs.last().map_or_else(Vec::new, &odds);
        let told: Vec<bool> = most.into_iter().map(|v| is_enough(v, rivals.len())).collect();
        let tells = |own: &[f64]| own.iter().zip(&told).all(|(v, told)| !told || is_enough(*v, rivals.len()));
        let found = runs.iter().map(|run| (run, odds(run))).find(|(_, own)| tells(own));
        let step = found.as_ref().filter(|_| told.contains(&true)).map(|(run, _)| {
            target_run(
                &format!("tell_{}", o.effect.name().replace('.', "_")),
                axis,
                response(&o.effect).as_str(),
                run,
            )
        });
        // A run already in the plan may separate it too.
        let same = |s: &PlannedRun| {
            step.as_ref().is_some_and(|own| (&s.run, &s.columns) == (&own.run, &own.columns))
        };
        let (step, is_new) = match out.steps.iter().find(|s| same(s)) {
            Some(made) => (Some(made.clone()), false),
            None => (step, true),
        };
        for (k, (rival, effect)) in rivals.iter().enumerate() {
            match (&step, &found) {
                (Some(step), Some((_, own))) if told[k] => out.tells.push(ExpectedEvidence {
                    effect: o.effect.name(),
                    rival: rival.label(),
                    log_odds: Some(own[k]),
                    by: step.record.clone(),
                }),
                _ => out.tells.push(not_told(o, rival, effect.as_ref())),
            }
        }
        out.steps.extend(step.filter(|_| is_new));
    }
    for (i, s) in out.steps.iter_mut().enumerate() {
        s.number = i + 1;
    }
    out
}

fn response(effect: &Effect) -> String {
    effect.axes().first().map_or_else(String::new, ToString::to_string)
}

fn not_told(o: &UnresolvedEffect, rival: &RivalExplanation, effect: Option<&Effect>) -> ExpectedEvidence {
    let by = if rival.name == o.effect.name() && rival.sensor.is_some() {
        "a run in which both sensors part: heat one place only, or let the machine cool while the surroundings warm".to_owned()
    } else {
        effect.map_or_else(String::new, |e| e.description().experiment.clone())
    };
    ExpectedEvidence { effect: o.effect.name(), rival: rival.label(), log_odds: None, by }
}

/// A rival as an effect.
/// It is the same law with the other value, or the rival's own law.
fn effect_of(rival: &RivalExplanation, found: &Effect, machine: &Machine) -> Option<Effect> {
    let mut effect = if rival.name == found.name() {
        found.clone()
    } else {
        machine.dictionary().effect(&rival.name).ok()?
    };
    if let Some((parameter, value)) = &rival.differs {
        effect.set(parameter, &[*value]).ok()?;
    }
    if rival.sensor.is_some() {
        effect.delta.clone_from(&rival.sensor);
    }
    Some(effect)
}

/// The runs that are tried, shortest first.
fn candidates(axis: &PlanAxis) -> Vec<TargetRun> {
    let mut all = Vec::new();
    for warmer_k in [None, Some(WARMER_K)] {
        for count in TARGETS {
            all.extend(CYCLES.iter().map(|cycles| TargetRun::uneven(axis, count, *cycles, warmer_k)));
        }
    }
    all.sort_by(|a, b| a.minutes().total_cmp(&b.minutes()));
    all
}

/// A simulated run, read without noise.
struct SimulatedRun {
    records: Vec<Record>,
    model: Vec<Effect>,
    noise: f64,
}

impl SimulatedRun {
    fn of(
        run: &TargetRun,
        axis: &PlanAxis,
        open: &UnresolvedEffect,
        truth: &Effect,
        machine: &Machine,
    ) -> Self {
        let model: Vec<Effect> = machine.effects().cloned().collect();
        let rivals = open.rivals.iter().filter_map(|r| r.sensor.as_ref());
        let known = model.iter().chain([&open.effect]).filter_map(|e| e.delta.as_ref());
        let mut sensors: Vec<String> =
            rivals.chain(known).flat_map(TemperatureDifference::sensors).map(str::to_owned).collect();
        sensors.sort_unstable();
        sensors.dedup();
        let records = record(run, axis, &response(&open.effect), &sensors).into_iter();
        let records = records.map(|mut r| {
            let one = [r.clone()];
            let rows = MeasuredRows::new(&one);
            let mut says = rows.predict(truth);
            for e in &model {
                rtec_least_squares::add(&mut says, 1.0, &rows.predict(e));
            }
            for c in r.columns.iter_mut().filter(|c| c.role.is_response()) {
                c.data.clone_from(&says);
            }
            r
        });
        Self { records: records.collect(), model, noise: open.noise }
    }

    /// Log odds against the best curve of a rival's law.
    /// If `given`, the rival keeps its values.
    fn log_odds(&self, rival: &Effect, given: bool) -> f64 {
        let rows = MeasuredRows::new(&self.records);
        let problem = EstimationProblem::unrounded(&rows, &self.model, &[]);
        let base = problem.base(ResponseNoise::white(&rows, self.noise.max(1e-6)));
        let left = |effect: &Effect| {
            let mut factor: QrFactor = base.factor.clone();
            for mut column in rows.basis(effect) {
                let rms = (column.iter().map(|v| v * v).sum::<f64>() / column.len().max(1) as f64).sqrt();
                if rms > 0.0 {
                    for v in &mut column {
                        *v *= FREE * self.noise / rms;
                    }
                    base.noise.whiten(&rows, &mut column);
                    factor.push(&column);
                }
            }
            factor.left()
        };
        if given {
            return 0.5 * left(rival);
        }
        let grid = rival.grid(&rows).into_iter().map(|point| left(&point.effect));
        0.5 * grid.chain([left(rival)]).fold(f64::INFINITY, f64::min)
    }
}

/// The rows of a run whose error is still zero.
fn record(run: &TargetRun, axis: &PlanAxis, response: &str, sensors: &[String]) -> Option<Record> {
    let (along, of) = (Axis::new(&axis.name)?, Axis::new(response)?);
    let [mut t, mut p, mut d, mut n, mut k] = [const { Vec::new() }; 5];
    for (cycle, way, target, warm) in run.readings() {
        t.push(run.seconds_each() * t.len() as f64);
        p.push(target);
        d.push(way);
        n.push(cycle as f64);
        k.push(if warm { run.warmer_k.unwrap_or(0.0) } else { 0.0 });
    }
    let error = vec![0.0; t.len()];
    let mut columns = vec![
        Column::new("t", Role::Time, t),
        Column::new("p", Role::Position(along.clone()), p),
        Column::new("d", Role::Direction(along), d),
        Column::new("n", Role::Cycle, n),
        Column::new("e", Role::Error(of), error),
    ];
    let warm = |s: &String| Column::new(s, Role::Temperature, k.iter().map(|k| 20.0 + k).collect());
    columns.extend(sensors.iter().map(warm));
    let mut record = Record::new(Path::new("next.run.toml"), RunKind::Positioning, columns).ok()?;
    record.turns = Some(ReversalPoint::Overtravel(None));
    Some(record)
}
