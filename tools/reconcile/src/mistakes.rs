//! Looks for people's mistakes beside a model.
//! It compares a record with the same record with a mistake corrected, by one likelihood. The likelihood is the
//! density of the numbers as the file has them.

use crate::findings_from_estimate::{AnalysisFindings, FoundEffect, analyse, score, stated};
use rtec_estimate::measurement_model::UnitAssumption;
use rtec_estimate::priors::TRAVEL_MM;
use rtec_estimate::{evidence_without_hypotheses, of_other_machine, unexplained};
use rtec_files::text_file::short;
use rtec_measure::plausible::{MistakeKind, Suspicion};
use rtec_model::ballbar_circle::Circle;
use rtec_model::effect::{Effect, TemperatureDifference};
use rtec_model::machine::Machine;
use rtec_model::record::{Axis, Column, Record, Role};
use std::f64::consts::PI;

/// A mistake that a record may carry.
#[derive(Clone)]
pub(crate) struct MistakeHypothesis {
    suspicion: Suspicion,
    /// The record with the mistake corrected; `None` if it is of another machine.
    corrected: Option<Record>,
    /// Log Jacobian of undoing the mistake, plus the evidence from directions.
    /// The Jacobian says how much closer the numbers lie in the file than after undoing. Directions must
    /// agree with positions. Of another machine's record, it is the log evidence of all its numbers.
    jacobian: f64,
}

impl MistakeHypothesis {
    /// Which units are possible while it is tested.
    /// Set-up terms have those of the responses and of time.
    fn units(&self) -> UnitAssumption {
        let set_up = |c: &Column| c.role == Role::Time || c.role.is_response();
        let columns = self.corrected.iter().flat_map(|r| &r.columns);
        let all = self.suspicion.column.is_empty();
        let asked = columns.into_iter().any(|c| (all || c.name == self.suspicion.column) && set_up(c));
        if self.suspicion.what == MistakeKind::Unit && asked {
            UnitAssumption::Any
        } else {
            UnitAssumption::AsWritten
        }
    }
}

/// Mistakes that were made together, each with its record's index.
type JointMistakes = Vec<(usize, MistakeHypothesis)>;

/// A mistake that is suspected of a record.
pub(crate) struct SuspectedMistake {
    pub(crate) suspicion: Suspicion,
    /// Log odds of the mistake.
    odds: f64,
    /// Names of the effects that are found with the mistake corrected.
    without: Vec<String>,
    /// Indices of the model's effects that are still replaced with it corrected.
    replaced: Vec<usize>,
}

impl SuspectedMistake {
    /// Whether it is so certain that nothing is learned from the record.
    pub(crate) fn is_certain(&self) -> bool {
        self.odds > CERTAIN.ln()
    }

    /// Whether the mistake explains a finding, with even odds or better.
    pub(crate) fn explains(&self, finding: &FoundEffect) -> bool {
        !self.without.contains(&finding.effect.name())
    }

    /// Whether the mistake explains what would else replace a known effect.
    pub(crate) fn spares(&self, answer: &AnalysisFindings) -> bool {
        replaced(answer).iter().any(|place| !self.replaced.contains(place))
    }
}

/// Indices of the model's effects that are off by far more than the model says.
fn replaced(answer: &AnalysisFindings) -> Vec<usize> {
    answer.estimate.found.iter().filter_map(|f| f.replaces).collect()
}

/// Prior odds of one kind of mistake: one record in this many carries it.
/// One in 30 carries any, of some 20 kinds (experience of people who read logs).
const ONE_IN: f64 = 600.0;
/// Odds at which a record is left out.
const CERTAIN: f64 = 99.0;
/// Most mistakes that are tested on all records together, and most that are found.
/// Only mistakes that make their own record likelier by more than their price are candidates.
const LOOKED_AT: usize = 3;
const MOST: usize = 3;
/// Largest ratio of a hold-out's residual to the training's noise, once corrected.
const EXPLAINED: f64 = 2.0;

/// Mistakes of training records that explain them better than the findings do.
pub(crate) fn of_training(
    records: &[Record],
    machine: &Machine,
    first: &AnalysisFindings,
    level: f64,
) -> Vec<SuspectedMistake> {
    let mut out = Vec::new();
    let mut now = records.to_vec();
    let mut best: Option<AnalysisFindings> = None;
    // Log evidence of the present records, by the units that are possible.
    let mut as_they_stand: Vec<(UnitAssumption, f64)> = Vec::new();
    // Tested beside the original model, because findings may have absorbed the mistake as a change of the
    // machine.
    let model: Vec<Effect> = machine.effects().cloned().collect();
    while out.len() < MOST {
        let answer = best.as_ref().unwrap_or(first);
        if machine.effects().next().is_none() {
            break;
        }
        // Also tested beside the findings, because a missing effect may hide a mistake.
        let mut models = vec![model.clone()];
        models.extend(with_findings(&model, answer));
        let intervals = stated(machine);
        let mut tried: Vec<(f64, usize, MistakeHypothesis)> = Vec::new();
        for (k, record) in now.iter().enumerate() {
            let stands = |units| -> Vec<f64> {
                models.iter().map(|m| evidence_without_hypotheses(record, m, &intervals, units).0).collect()
            };
            let [written, any] = [UnitAssumption::AsWritten, UnitAssumption::Any].map(stands);
            let left: Vec<_> = models.iter().map(|m| unexplained(record, m)).collect();
            let mut all = candidates(record, &now, models.last().unwrap_or(&model));
            all.extend((now.len() > 1).then(|| other_machine(record, &model)));
            for m in all {
                let gain = |(model, (stands, left)): (&Vec<Effect>, (&f64, &Vec<f64>))| {
                    let Some(corrected) = &m.corrected else { return m.jacobian - stands };
                    // The model does not read the changed column here.
                    let same = m.jacobian == 0.0 && unexplained(corrected, model) == *left;
                    if same {
                        0.0
                    } else {
                        evidence_without_hypotheses(corrected, model, &intervals, m.units()).0 + m.jacobian
                            - stands
                    }
                };
                let stands = if m.units() == UnitAssumption::Any { &any } else { &written };
                let gain = models.iter().zip(stands.iter().zip(&left)).map(gain).fold(0.0, f64::max);
                if gain > 0.0 {
                    tried.push((gain, k, m));
                }
            }
        }
        tried.sort_by(|a, b| b.0.total_cmp(&a.0));
        // Keeps the likeliest mistake of each kind in each column.
        let mut kinds: Vec<(usize, MistakeKind, String)> = Vec::new();
        tried.retain(|(_, k, m)| {
            let kind = (*k, m.suspicion.what, m.suspicion.column.clone());
            let new = !kinds.contains(&kind);
            kinds.push(kind);
            new
        });
        let habit = habit(&tried, now.len());
        tried.retain(|t| t.0 > ONE_IN.ln());
        tried.truncate(LOOKED_AT);
        let mut sets: Vec<JointMistakes> = tried.into_iter().map(|(_, k, m)| vec![(k, m)]).collect();
        sets.extend(habit);
        let mut likeliest: Option<(f64, (UnitAssumption, f64), JointMistakes)> = None;
        for set in sets {
            let units = set[0].1.units();
            let known = as_they_stand.iter().find(|s| s.0 == units).map(|s| s.1);
            let before = known.unwrap_or_else(|| score(&now, machine, answer, units, f64::NEG_INFINITY));
            if known.is_none() {
                as_they_stand.push((units, before));
            }
            let gain_of_numbers: f64 = set.iter().map(|(_, m)| m.jacobian).sum();
            let mut gain = gain_of_numbers - before - ONE_IN.ln();
            let undone = score(&with_corrected(&now, &set), machine, answer, units, -gain);
            gain += undone;
            if gain > likeliest.as_ref().map_or(0.0, |b| b.0) {
                likeliest = Some((gain, (units, undone), set));
            }
        }
        let Some((gain, undone, set)) = likeliest else { break };
        as_they_stand = vec![undone];
        now = with_corrected(&now, &set);
        let then = analyse(&now, machine, level);
        let without: Vec<String> = then.findings.iter().map(|(f, _)| f.effect.name()).collect();
        out.extend(set.into_iter().map(|(_, m)| SuspectedMistake {
            suspicion: m.suspicion,
            odds: gain,
            without: without.clone(),
            replaced: replaced(&then),
        }));
        best = Some(then);
    }
    out
}

/// A mistake that every record shows, at the price of a single one.
/// Its author always makes it in the same way.
fn habit(tried: &[(f64, usize, MistakeHypothesis)], records: usize) -> Option<JointMistakes> {
    let same = |a: &MistakeHypothesis, b: &MistakeHypothesis| {
        (a.suspicion.what, &a.suspicion.column, &a.suspicion.text)
            == (b.suspicion.what, &b.suspicion.column, &b.suspicion.text)
    };
    let everywhere = |(_, _, m): &&(f64, usize, MistakeHypothesis)| {
        let own: Vec<f64> = tried.iter().filter(|t| same(&t.2, m)).map(|t| t.0).collect();
        records > 1 && m.corrected.is_some() && own.len() == records && own.iter().sum::<f64>() > ONE_IN.ln()
    };
    let (_, _, first) = tried.iter().find(everywhere)?;
    Some(tried.iter().filter(|t| same(&t.2, first)).map(|t| (t.1, t.2.clone())).collect())
}

/// The records with mistakes corrected, without those of another machine.
fn with_corrected(records: &[Record], mistakes: &JointMistakes) -> Vec<Record> {
    let of = |(k, record): (usize, &Record)| match mistakes.iter().find(|(at, _)| *at == k) {
        Some((_, mistake)) => mistake.corrected.clone(),
        None => Some(record.clone()),
    };
    records.iter().enumerate().filter_map(of).collect()
}

/// A record of another machine, which has the model's effects in other sizes.
fn other_machine(record: &Record, model: &[Effect]) -> MistakeHypothesis {
    let text = "the run agrees with the model only with other sizes of its effects: of another machine, or another state of it?";
    MistakeHypothesis {
        suspicion: Suspicion::new(record, "", MistakeKind::OtherMachine, &[], text.to_owned()),
        corrected: None,
        jacobian: of_other_machine(record, model),
    }
}

/// Mistakes of a hold-out whose removal lets the better model explain it.
pub(crate) fn of_hold_out(
    record: &Record,
    train: &[Record],
    model: &Machine,
    floor_um: &dyn Fn(&Role) -> f64,
) -> Option<Suspicion> {
    let effects: Vec<Effect> = model.effects().cloned().collect();
    let intervals = stated(model);
    if effects.is_empty() {
        return None;
    }
    let stands = |units| evidence_without_hypotheses(record, &effects, &intervals, units);
    let (as_it_stands, noise) = stands(UnitAssumption::AsWritten);
    let of_any_unit = stands(UnitAssumption::Any).0;
    let explained = |noise: &[(Role, f64)]| noise.iter().all(|(r, s)| *s <= EXPLAINED * floor_um(r));
    if explained(&noise) {
        return None;
    }
    let mut all = train.to_vec();
    all.push(record.clone());
    let weigh = |m: MistakeHypothesis| {
        let (then, noise) =
            evidence_without_hypotheses(m.corrected.as_ref()?, &effects, &intervals, m.units());
        let stands = if m.units() == UnitAssumption::Any { of_any_unit } else { as_it_stands };
        let gain = then + m.jacobian - stands - ONE_IN.ln() - CERTAIN.ln();
        (gain > 0.0 && explained(&noise)).then_some((gain, m.suspicion))
    };
    let found = candidates(record, &all, &effects).into_iter().filter_map(weigh);
    found.max_by(|a, b| a.0.total_cmp(&b.0)).map(|b| b.1)
}

/// The model with the findings added, if there are any.
fn with_findings(model: &[Effect], answer: &AnalysisFindings) -> Option<Vec<Effect>> {
    let found = answer.findings.iter().map(|(f, _)| f.effect.clone());
    let mut new = found.filter(|f| model.iter().all(|e| e.name() != f.name())).peekable();
    new.peek()?;
    Some(model.iter().cloned().chain(new).collect())
}

/// The record with other columns.
fn rebuilt(record: &Record, columns: Vec<Column>, circle: Option<Circle>) -> Option<Record> {
    let mut new = Record::new(&record.path, record.kind, columns).ok()?;
    (new.zero, new.count_um, new.turns) = (record.zero.clone(), record.count_um, record.turns);
    (new.file, new.sha256) = (record.file.clone(), record.sha256.clone());
    match circle {
        Some(circle) => new.with_circle(circle).ok(),
        None => Some(new),
    }
}

/// The record with some columns changed.
fn changed(record: &Record, which: &dyn Fn(&Column) -> bool, change: &dyn Fn(f64) -> f64) -> Option<Record> {
    let mut columns = record.columns.clone();
    columns.iter_mut().filter(|c| which(c)).for_each(|c| c.data.iter_mut().for_each(|x| *x = change(*x)));
    rebuilt(record, columns, record.circle().cloned())
}

/// The record with roles renamed.
fn renamed(record: &Record, to: &dyn Fn(&Role) -> Role) -> Option<Record> {
    let mut columns = record.columns.clone();
    for c in &mut columns {
        c.role = to(&c.role);
    }
    let mut circle = record.circle().cloned();
    for axis in circle.iter_mut().flat_map(|c| &mut c.plane) {
        if let Some(other) = to(&Role::Position(axis.clone())).axis() {
            *axis = other.clone();
        }
    }
    rebuilt(record, columns, circle)
}

fn with_axis(role: &Role, axis: Axis) -> Role {
    match role {
        Role::Position(_) => Role::Position(axis),
        Role::Direction(_) => Role::Direction(axis),
        Role::Velocity(_) => Role::Velocity(axis),
        Role::Acceleration(_) => Role::Acceleration(axis),
        Role::Load(_) => Role::Load(axis),
        Role::Error(_) => Role::Error(axis),
        Role::Force(_) => Role::Force(axis),
        other => other.clone(),
    }
}

/// Factors of the units in which a column may be given, with the units' names.
type UnitFactors = &'static [(f64, &'static str)];
/// Those of an error instead of µm.
const ERROR_UNITS: UnitFactors = &[
    (1e3, "in mm"),
    (25.4, "in thousandths of an inch"),
    (25.4e3, "in inches"),
    (1e-3, "in nm"),
    (10.0, "with the decimal point one place off"),
];
/// Those of a force instead of N.
const FORCE_UNITS: UnitFactors =
    &[(1e3, "in kN"), (9.81, "in kp"), (10.0, "with the decimal point one place off")];

/// A factor in a form for people: 25.4 or 1/25.4.
fn times(by: f64) -> String {
    if by < 1.0 { format!("1/{}", short(1.0 / by)) } else { short(by) }
}

/// Factors that undo a mistaken unit, and what it looks like.
/// A conversion was left out or made twice, so each factor occurs with its inverse.
fn undone_units(units: UnitFactors, called: &str) -> Vec<(f64, String)> {
    let mut out: Vec<(f64, String)> =
        units.iter().map(|(by, unit)| (*by, format!("given {unit}, called {called}?"))).collect();
    for (by, unit) in units {
        let back = 1.0 / by;
        if out.iter().all(|(other, _)| (other / back - 1.0).abs() > 1e-9) {
            out.push((back, format!("given in {called}, converted as if {unit}?")));
        }
    }
    out
}
/// The shortest and the longest travel of a machine's axis, mm.
const TRAVELS_MM: [f64; 2] = [1e-1, 3e4];
/// Log prior of a travel, without a constant: travels far from the usual are rare.
fn travel_prior(mm: f64) -> f64 {
    let [middle, factor] = TRAVEL_MM;
    if (TRAVELS_MM[0]..=TRAVELS_MM[1]).contains(&mm) {
        -((mm / middle).ln() / factor.ln()).powi(2).ln_1p()
    } else {
        f64::NEG_INFINITY
    }
}
/// Units that other columns may be given in, and their factors.
const fn other_units(role: &Role) -> UnitFactors {
    match role {
        Role::Position(_) => &[(1e3, "in m"), (1e-3, "in µm"), (25.4, "in inch"), (10.0, "in cm")],
        Role::Velocity(_) => &[(1.0 / 60.0, "in mm/min"), (1e3, "in m/s"), (1e3 / 60.0, "in m/min")],
        Role::Acceleration(_) => &[(1e3, "in m/s²"), (9806.65, "in g")],
        Role::Load(_) => &[(9.806_65, "in kgf"), (4.448_22, "in lbf"), (1e3, "in kN")],
        Role::SpindleSpeed => &[(60.0, "in rev/s"), (1e3, "in krpm")],
        Role::Time => &[(60.0, "in min"), (3600.0, "in h"), (1e-3, "in ms")],
        _ => &[],
    }
}
/// Lengths that ballbars are made with, mm.
const BARS_MM: [f64; 8] = [50.0, 75.0, 100.0, 150.0, 200.0, 250.0, 300.0, 600.0];

/// A direction contradicts its positions in one row out of this many.
/// The number is the experience of people who read logs. A direction of something else, such as the approach,
/// contradicts them in every other row. Both are equally likely a priori.
const CONTRADICTED: f64 = 100.0;

/// Number of axes whose direction is logged beside their position.
fn paired(record: &Record) -> usize {
    let has = |role: Role| record.column(&role).is_some();
    let both = |a: &&Axis| has(Role::Position((*a).clone())) && has(Role::Direction((*a).clone()));
    axes(record).iter().filter(both).count()
}

/// Log probability of the logged directions, given the logged positions.
fn agreement(record: &Record) -> f64 {
    let of = |axis: &Axis| {
        let position = record.data(&Role::Position(axis.clone()))?;
        let direction = record.data(&Role::Direction(axis.clone()))?;
        let went = position.windows(2).map(|p| p[1] - p[0]);
        let told: Vec<f64> = went.zip(&direction[1..]).map(|(by, way)| by * way).collect();
        let count = |of: fn(f64) -> bool| told.iter().filter(|x| of(**x)).count() as f64;
        let (rows, against, still) = (told.len() as f64, count(|x| x < 0.0), count(|x| x == 0.0));
        // If nothing moves, a position gives no information about the direction.
        let goes_with = -against * CONTRADICTED.ln()
            + (rows - against - still) * (-1.0 / CONTRADICTED).ln_1p()
            - still * std::f64::consts::LN_2;
        let is_apart = -rows * std::f64::consts::LN_2;
        let top = goes_with.max(is_apart);
        Some(top + ((goes_with - top).exp() + (is_apart - top).exp()).ln() - std::f64::consts::LN_2)
    };
    axes(record).iter().filter_map(of).sum()
}

/// A test of a column's role.
type Which = fn(&Role) -> bool;

/// Parts of an axis' data that may be under another axis' name.
const PARTS: [(&str, Which); 4] = [
    ("error", |role| matches!(role, Role::Error(_))),
    ("position", |role| matches!(role, Role::Position(_))),
    ("motion", |role| {
        use Role::{Acceleration, Direction, Position, Velocity};
        matches!(role, Position(_) | Direction(_) | Velocity(_) | Acceleration(_))
    }),
    ("run", |_| true),
];

/// All mistakes that a record may carry.
#[expect(clippy::too_many_lines, reason = "one list, in the order of the words page")]
fn candidates(record: &Record, all: &[Record], model: &[Effect]) -> Vec<MistakeHypothesis> {
    use MistakeKind::{Direction, Sign, Swapped, Unit};
    let mut out = Vec::new();
    let rows = record.rows() as f64;
    let as_logged = agreement(record);
    let mut add =
        |what: MistakeKind, column: &str, text: String, corrected: Option<Record>, jacobian: f64| {
            if let Some(corrected) = corrected {
                let jacobian = jacobian + agreement(&corrected) - as_logged;
                let said = Suspicion::new(record, column, what, &[], text);
                out.push(MistakeHypothesis { suspicion: said, corrected: Some(corrected), jacobian });
            }
        };
    let only = |text: &str| format!("the run agrees with the model only {text}");
    // Each response by itself, and all together.
    let responses: Vec<&Column> = record.responses().collect();
    let together = (responses.len() > 1).then_some(&responses[..]);
    for group in responses.chunks(1).chain(together) {
        let own = |o: &Column| group.iter().any(|c| c.name == o.name);
        let (column, sign) = match group {
            [one] => (one.name.as_str(), "with the other sign: nominal minus measured?"),
            _ => ("", "with the other signs: nominal minus measured?"),
        };
        add(Sign, column, only(sign), changed(record, &own, &|x| -x), 0.0);
        let forces = group.iter().filter(|c| matches!(c.role, Role::Force(_))).count();
        // If all readings of a response are equal, every unit explains them equally well.
        let changes = |c: &&&Column| c.data.iter().any(|x| (x - c.data[0]).abs() > 0.0);
        let telling = group.iter().filter(changes).count();
        if telling == 0 || (forces > 0 && forces < group.len()) {
            continue;
        }
        let (units, called) = if forces > 0 { (FORCE_UNITS, "N") } else { (ERROR_UNITS, "µm") };
        for (by, text) in undone_units(units, called) {
            let text = only(&format!("{} times as large: {text}", times(by)));
            let numbers = rows * telling as f64;
            add(Unit, column, text, changed(record, &own, &|x| by * x), numbers * by.ln());
        }
    }
    let motion = |c: &Column| matches!(c.role, Role::Direction(_) | Role::Velocity(_));
    if let Some(first) = record.columns.iter().find(|c| motion(c)) {
        let text = only("with the directions exchanged");
        add(Direction, &first.name, text, changed(record, &motion, &|x| -x), 0.0);
    }
    let kinds: [fn(&Role) -> bool; 6] = [
        |r| matches!(r, Role::Position(_)),
        |r| matches!(r, Role::Velocity(_)),
        |r| matches!(r, Role::Acceleration(_)),
        |r| matches!(r, Role::Load(_)),
        |r| *r == Role::SpindleSpeed,
        |r| *r == Role::Time,
    ];
    for kind in kinds {
        let own: Vec<&Column> = record.columns.iter().filter(|c| kind(&c.role)).collect();
        let Some(first) = own.first() else { continue };
        for (by, text) in undone_units(other_units(&first.role), &first.unit) {
            // An axis at 50 mm can travel that far, although the run moves less than a micrometre.
            let travel = |c: &&Column| c.data.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
            let as_given = own.iter().map(travel).fold(0.0, f64::max);
            let place = matches!(first.role, Role::Position(_));
            // An axis that stays at its zero shows no travel, which is no evidence for another unit.
            let likelier = if place {
                travel_prior(by * as_given) - travel_prior(as_given.max(TRAVELS_MM[0]))
            } else {
                0.0
            };
            if likelier == f64::NEG_INFINITY {
                continue;
            }
            let text = only(&format!("with {} {} times this: {text}", first.name, times(by)));
            add(Unit, &first.name, text, changed(record, &|c| kind(&c.role), &|x| by * x), likelier);
        }
    }
    let load = |c: &Column| matches!(c.role, Role::Load(_));
    if let Some(first) = record.columns.iter().find(|c| load(c)) {
        let text = only("with the loads in the other direction");
        add(Sign, &first.name, text, changed(record, &load, &|x| -x), 0.0);
    }
    if let Some(wet) = record.columns.iter().find(|c| c.role == Role::Coolant) {
        let text = only(&format!("with {} the other way round: 1 while it is off?", wet.name));
        add(Swapped, &wet.name, text, changed(record, &|c| c.role == Role::Coolant, &|x| 1.0 - x), 0.0);
    }
    let warm = |c: &Column| c.role == Role::Temperature;
    if let Some(first) = record.columns.iter().find(|c| warm(c)) {
        let text = only("with its temperatures read as degrees Fahrenheit");
        add(Unit, &first.name, text, changed(record, &warm, &|x| (x - 32.0) / 1.8), 0.0);
    }
    let angle = |c: &Column| c.role == Role::Angle;
    if let Some(first) = record.columns.iter().find(|c| angle(c)) {
        type Mirror = fn(f64) -> f64;
        let mirrored: [(&str, Mirror); 3] = [
            ("with the angle the other way round", |x| -x),
            ("with the angle mirrored", |x| PI - x),
            ("with the angle from the other axis", |x| 0.5 * PI - x),
        ];
        for (text, of) in mirrored {
            add(Direction, &first.name, only(text), changed(record, &angle, &of), 0.0);
        }
        add(
            Unit,
            &first.name,
            only("with the angle in degrees"),
            changed(record, &angle, &|x| x * PI / 180.0),
            0.0,
        );
    }
    if let Some(circle) = record.circle() {
        for radius_mm in BARS_MM.into_iter().filter(|r| (r / circle.radius_mm - 1.0).abs() > 0.05) {
            let text = only(&format!("with a bar of {radius_mm} mm, stated {} mm", circle.radius_mm));
            let other = Circle { radius_mm, ..circle.clone() };
            add(Unit, "radius_mm", text, rebuilt(record, record.columns.clone(), Some(other)), 0.0);
        }
    }
    // Another axis's name, or two axes exchanged.
    let own: Vec<Axis> = axes(record);
    let mut names: Vec<Axis> =
        all.iter().flat_map(axes).chain(model.iter().flat_map(|e| e.axes().iter().cloned())).collect();
    names.sort();
    names.dedup();
    names.retain(|n| n.as_str() != "r");
    for a in own.iter().filter(|a| a.as_str() != "r") {
        for b in names.iter().filter(|b| *b != a && (*b > a || !own.contains(b))) {
            for (part, of) in PARTS {
                // The positions along a circle are those of its plane.
                let leaves_plane =
                    record.circle().is_some_and(|c| !(c.plane.contains(a) && c.plane.contains(b)));
                if part != "run" && leaves_plane {
                    continue;
                }
                let first = |axis| record.columns.iter().find(|c| of(&c.role) && c.role.axis() == Some(axis));
                let (column, text) = match (first(a), first(b)) {
                    (None, None) => continue,
                    (Some(p), Some(_)) if part == "motion" => {
                        (&p.name, format!("with the motions of {a} and {b} exchanged"))
                    }
                    (Some(p), Some(q)) if part != "run" => {
                        (&p.name, format!("with {} and {} exchanged", p.name, q.name))
                    }
                    (Some(p), _) if part == "run" => {
                        let own = record.column(&Role::Error(a.clone())).unwrap_or(p);
                        (&own.name, format!("as a run of {b}, called {a}"))
                    }
                    (Some(p), _) => (&p.name, format!("with the {part} of {b}, called that of {a}")),
                    (None, Some(q)) => (&q.name, format!("with the {part} of {a}, called that of {b}")),
                };
                let swap = |role: &Role| match role.axis() {
                    Some(axis) if of(role) && axis == a => with_axis(role, b.clone()),
                    Some(axis) if of(role) && axis == b => with_axis(role, a.clone()),
                    _ => role.clone(),
                };
                // A renamed part must leave the model as many effects to apply, and directions beside their
                // positions.
                let sound = |u: &Record| {
                    applicable_effects(u, model) >= applicable_effects(record, model)
                        && paired(u) >= paired(record)
                };
                let corrected = renamed(record, &swap).filter(|u| part == "run" || sound(u));
                add(Swapped, column, only(&text), corrected, 0.0);
            }
        }
    }
    let read: Vec<String> = model
        .iter()
        .filter_map(|e| e.delta.as_ref())
        .flat_map(TemperatureDifference::sensors)
        .map(str::to_owned)
        .collect();
    let sensors: Vec<&str> = record.names(&Role::Temperature).collect();
    for (i, a) in sensors.iter().enumerate() {
        for b in &sensors[i + 1..] {
            if read.iter().any(|r| r == a || r == b) {
                let text = only(&format!("with {a} and {b} exchanged"));
                add(Swapped, a, text, with_sensors_exchanged(record, a, b), 0.0);
            }
        }
    }
    out
}

/// Number of a model's effects that apply to a record.
fn applicable_effects(record: &Record, model: &[Effect]) -> usize {
    model.iter().filter(|e| !e.acts_on(record).is_empty() && e.bind(record).is_ok()).count()
}

fn axes(record: &Record) -> Vec<Axis> {
    let mut all: Vec<Axis> = record.columns.iter().filter_map(|c| c.role.axis().cloned()).collect();
    all.sort();
    all.dedup();
    all
}

fn with_sensors_exchanged(record: &Record, a: &str, b: &str) -> Option<Record> {
    let mut columns = record.columns.clone();
    let at = |name: &str| record.columns.iter().position(|c| c.role == Role::Temperature && c.name == name);
    let (i, j) = (at(a)?, at(b)?);
    columns[i].data.clone_from(&record.columns[j].data);
    columns[j].data.clone_from(&record.columns[i].data);
    rebuilt(record, columns, record.circle().cloned())
}
