//! Two columns in each other's place, beside the model: what it leaves of all responses of a record as it stands, and with the exchange
//! undone. An exchange has no size that could be fitted, so it is believed before a scale or a squareness that the model lacks.

use crate::cholesky::Cholesky;
use crate::lanes;
use crate::problem::rms;
use crate::suspected::{centred, simulated};
use crate::verdict::Refined;
use rtec_measure::plausible::{Suspicion, What};
use rtec_model::effect::Need;
use rtec_model::machine::Machine;
use rtec_model::record::{Axis, Column, Kind, Record, Role};

/// With the exchange undone the model leaves less than this share of the squares that it leaves of the record as it stands, and of
/// those of the responses themselves.
const BETTER: f64 = 0.4;
/// What straight lines leave that the model says nothing of is so many times as much; and that is no chance, nats.
const NO_PLAINER: f64 = 1.3;
const NO_CHANCE: f64 = 15.0;
/// A slope that makes less than this share of what the model says is none of its own.
const SAID: f64 = 0.25;
/// The amplitudes of a model are off by no more than this where a column in another unit makes it agree.
const AS_TOLD: std::ops::Range<f64> = 0.85..1.18;
/// A value of the model of less than so many standard errors may be anything: refined by whatever factor, it was not known.
const SAYS: f64 = 0.5;

/// Targets are chosen on multiples of this, and reached to within that, mm.
const ROUND_MM: f64 = 5.0;
const ROUND_OFF_MM: f64 = 0.05;

/// Two positions, or two errors, that agree with the model only in each other's place.
/// Which, and the record with them back in their places.
pub(crate) fn exchanged_columns(record: &Record, machine: &Machine) -> Option<([String; 2], Record)> {
    let all: Vec<&Column> = record.columns.iter().filter(|c| c.role.axis().is_some()).collect();
    let of = |what: fn(&Role) -> bool| -> Vec<&Column> {
        all.iter().filter(|c| what(&c.role) && rms(&centred(&c.data)) > 0.0).copied().collect()
    };
    let errors = of(|r| matches!(r, Role::Error(_)));
    let positions = of(|r| matches!(r, Role::Position(_)));
    let (now, own) = squares(record, machine);
    let mut best: Option<(f64, [String; 2], Record)> = None;
    for columns in [&errors, &positions] {
        for (i, a) in columns.iter().enumerate() {
            for b in &columns[i + 1..] {
                let (Some(x), Some(y)) = (a.role.axis(), b.role.axis()) else { continue };
                let alone = |c: &Column| c.name == a.name || c.name == b.name;
                let motion = |c: &Column| !matches!(c.role, Role::Error(_) | Role::Force(_));
                let is_error = matches!(a.role, Role::Error(_));
                let mut others = vec![with_exchanged(record, [x, y], &alone)];
                // A speed that follows from the positions is exchanged with them.
                others.extend((!is_error).then(|| with_exchanged(record, [x, y], &motion)));
                for other in others {
                    let then = squares(&other, machine).0;
                    if then < BETTER * now.min(own) && best.as_ref().is_none_or(|b| then < b.0) {
                        best = Some((then, [a.name.clone(), b.name.clone()], other));
                    }
                }
            }
        }
    }
    for (column, axis, other) in in_other_columns(record) {
        let then = squares(&other, machine).0;
        if then < BETTER * now.min(own) && best.as_ref().is_none_or(|b| then < b.0) {
            best = Some((then, [column, format!("the position of {axis}")], other));
        }
    }
    let (then, pair, undone) = best?;
    let plain = beside_free_lines(record, machine);
    let rows = (record.rows() * record.responses().count()) as f64;
    let nats = 0.5 * rows * (plain / then.max(f64::MIN_POSITIVE)).ln();
    (plain > NO_PLAINER * then && nats > NO_CHANCE).then_some((pair, undone))
}

/// The positions of a positioning run that may stand in another axis's column: the axis whose error was read stands still, and another
/// one moves. The column, whose it may be, and the record with it in its place.
fn in_other_columns(record: &Record) -> Vec<(String, Axis, Record)> {
    let moves = |axis: &Axis| {
        record.data(&Role::Position(axis.clone())).is_some_and(|p| rms(&centred(p)) > ROUND_OFF_MM)
    };
    let mut out = Vec::new();
    for axis in record.axes(Role::Error).filter(|a| record.kind == Kind::Positioning && !moves(a)) {
        for other in record.axes(Role::Position).filter(|o| moves(o)) {
            let Some(column) = record.column(&Role::Position(other.clone())) else { continue };
            let mut undone = record.clone();
            for c in &mut undone.columns {
                let to = |a: &Axis| match a {
                    a if a == axis => other.clone(),
                    a if a == other => axis.clone(),
                    a => a.clone(),
                };
                c.role = match &c.role {
                    Role::Position(a) => Role::Position(to(a)),
                    Role::Direction(a) => Role::Direction(to(a)),
                    Role::Velocity(a) => Role::Velocity(to(a)),
                    Role::Acceleration(a) => Role::Acceleration(to(a)),
                    role => role.clone(),
                };
            }
            out.push((column.name.clone(), axis.clone(), undone));
        }
    }
    out
}

/// The record with its errors along two axes in each other's place.
pub(crate) fn with_errors_exchanged(record: &Record, axes: [&Axis; 2]) -> Record {
    with_exchanged(record, axes, &|c| matches!(c.role, Role::Error(_)))
}

/// A slope over an axis's position that the rows correct by the factor between two units of length, in each record that shows it: its
/// positions are given in another unit. Targets on round millimetres are in millimetres.
pub(crate) fn by_a_unit(train: &[Record], refined: &[Refined]) -> Vec<Suspicion> {
    let mut out = Vec::new();
    for r in refined
        .iter()
        .filter(|r| r.before.description().needs == [Need::Position(0)] && r.before.width() == 1)
    {
        let by = r.after.0.scalar(0) / r.before.scalar(0);
        let role = Role::Position(r.before.axes()[0].clone());
        let Some((_, unit)) = other_units(&role).iter().find(|(unit, _)| AS_TOLD.contains(&(by / unit)))
        else {
            continue;
        };
        let text = |c: &Column| {
            let law = &r.before.description().parameters[0];
            format!(
                "the run agrees with the model only with {} of {:.1} {} for {:.1}: {} given in {unit}, called {}?",
                r.before.name(),
                r.after.0.scalar(0),
                law.unit,
                r.before.scalar(0),
                c.name,
                c.unit
            )
        };
        let shown = train.iter().filter_map(|t| Some((t, t.column(&role)?)));
        let shown = shown.filter(|(_, c)| rms(&centred(&c.data)) > 0.0 && !is_of_round_mm(c));
        out.extend(shown.map(|(t, c)| Suspicion::new(t, &c.name, What::Unit, &[], text(c))));
    }
    out
}

/// What a column may be in instead of its unit, and by how much that is more.
pub(crate) fn other_units(role: &Role) -> &'static [(f64, &'static str)] {
    match role {
        Role::Position(_) => &[(1e3, "m"), (1e-3, "µm"), (25.4, "inch")],
        Role::SpindleSpeed => &[(60.0, "rev/s"), (1e3, "krpm")],
        Role::Time => &[(60.0, "min"), (3600.0, "h"), (1e-3, "ms")],
        _ => &[],
    }
}

/// Targets people choose in mm: those of another unit are round in that one.
pub(crate) fn is_of_round_mm(column: &Column) -> bool {
    let off = |p: &f64| (p - ROUND_MM * (p / ROUND_MM).round()).abs() < ROUND_OFF_MM;
    matches!(column.role, Role::Position(_)) && column.data.iter().all(off)
}

/// The record with the columns of two axes in each other's place, those that are asked for.
fn with_exchanged(record: &Record, [a, b]: [&Axis; 2], which: &dyn Fn(&Column) -> bool) -> Record {
    let mut other = record.clone();
    for column in other.columns.iter_mut().filter(|c| which(c)) {
        let from = match column.role.axis() {
            Some(axis) if axis == a => b,
            Some(axis) if axis == b => a,
            _ => continue,
        };
        let alike = |c: &&Column| {
            std::mem::discriminant(&c.role) == std::mem::discriminant(&column.role)
                && c.role.axis() == Some(from)
        };
        if let Some(source) = record.columns.iter().find(alike) {
            column.data.clone_from(&source.data);
        }
    }
    other
}

/// Squares that the model leaves of all responses, and of the responses themselves, without their means.
fn squares(record: &Record, machine: &Machine) -> (f64, f64) {
    record.responses().fold((0.0, 0.0), |(left, all), c| {
        let (y, s) = (centred(&c.data), simulated(record, &c.role, machine));
        let missing: Vec<f64> = y.iter().zip(&s).map(|(y, s)| y - s).collect();
        (left + lanes::dot(&missing, &missing), all + lanes::dot(&y, &y))
    })
}

/// Squares that are left of the record as it stands beside the straight lines over positions that the model says nothing of.
fn beside_free_lines(record: &Record, machine: &Machine) -> f64 {
    let of_place = |c: &&Column| matches!(c.role, Role::Position(_)) && rms(&centred(&c.data)) > 0.0;
    let lines: Vec<Vec<f64>> = record.columns.iter().filter(of_place).map(|c| centred(&c.data)).collect();
    let left = |c: &Column| {
        let s = simulated(record, &c.role, machine);
        let mut missing: Vec<f64> = centred(&c.data).iter().zip(&s).map(|(y, s)| y - s).collect();
        let says = |(line, slope): (&Vec<f64>, f64)| slope.abs() * rms(line) > SAID * rms(&s);
        let own = slopes(&lines.iter().collect::<Vec<_>>(), &s);
        let free: Vec<&Vec<f64>> = lines
            .iter()
            .zip(own)
            .filter(|(line, slope)| !says((line, *slope)))
            .map(|(line, _)| line)
            .collect();
        for (line, slope) in free.iter().zip(slopes(&free, &missing)) {
            lanes::minus(&mut missing, slope, line);
        }
        lanes::dot(&missing, &missing)
    };
    record.responses().map(left).sum()
}

/// Slopes of the straight lines that leave least.
pub(crate) fn slopes(lines: &[&Vec<f64>], y: &[f64]) -> Vec<f64> {
    if lines.is_empty() {
        return Vec::new();
    }
    let products: Vec<f64> = lines.iter().flat_map(|a| lines.iter().map(|b| lanes::dot(a, b))).collect();
    let factor = Cholesky::new(&products, lines.len());
    let mut slopes: Vec<f64> = lines.iter().map(|a| lanes::dot(a, y)).collect();
    factor.forward(&mut slopes);
    factor.backward(&mut slopes);
    slopes
}

/// The record with some columns times a number; times, too.
pub(crate) fn times(record: &Record, which: &dyn Fn(&Column) -> bool, by: f64) -> Record {
    let mut other = record.clone();
    for column in other.columns.iter_mut().filter(|c| which(c)) {
        column.data.iter_mut().for_each(|x| *x *= by);
    }
    if record.columns.iter().any(|c| c.role == Role::Time && which(c)) {
        // The rows' times are the column's, and no circle is looked at here.
        other = Record::new(&record.path, record.kind, other.columns).unwrap_or_else(|_| record.clone());
        (other.zero, other.count_um) = (record.zero.clone(), record.count_um);
    }
    other
}

/// Whether what the model says then is what was measured, to the size; and what it says as it stands is not its noise.
pub(crate) fn is_as_told(y: &[f64], now: &[f64], then: &[f64]) -> bool {
    let size = lanes::dot(then, then);
    let left: Vec<f64> = y.iter().zip(then).map(|(y, s)| y - s).collect();
    size > 0.0
        && AS_TOLD.contains(&(lanes::dot(then, y) / size))
        && rms(now) * (y.len() as f64).sqrt() > SAYS * rms(&left)
}
