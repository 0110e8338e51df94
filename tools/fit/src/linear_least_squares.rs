//! Least squares for parameters in which an error is linear.
//! They are effects named by the user, or terms of a chain.
//!
//! A gauge's zero is arbitrary, so every response of every record has its own constant, which is discarded.
//! Intervals come from leaving out each of ten stretches of rows in turn (delete-one-block jackknife). Errors
//! shared by neighbouring rows therefore do not narrow them. The same is done with stretches of places of
//! every axis, because an unexplained wave or bend repeats at its place. The widest interval is used.

use crate::repeated_residuals::{self, StructuredResidual};
use crate::statistics::quantile;
use crate::thermal::{FittedEffect, Intervals, jackknife_interval, provenance};
use rtec_files::InputError;
use rtec_files::date;
use rtec_files::text_file::short;
use rtec_least_squares::{Solution, compress_rows};
use rtec_measure::ballbar::in_motion;
use rtec_measure::gauge_resolution::{ReadingResolution, is_coarse_cause, step_of};
use rtec_model::effect::{
    AffectedQuantity, Dictionary, Effect, MissingInput, ParameterFitMethod, RequiredInput,
    TemperatureDifference,
};
use rtec_model::machine::{FitNote, Machine, NORMAL_95, SourceRecord};
use rtec_model::record::{Axis, Column, Record, Role, RunKind, span};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Number of stretches of rows that are left out in turn.
const BLOCKS: usize = 10;
/// Columns are dependent if less than this share of one is independent.
const DEPENDENT: f64 = 1e-5;

/// The fitted value of one parameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct FittedValue {
    pub(crate) value: f64,
    pub(crate) interval: [f64; 2],
}

/// A linear problem.
/// It has one column per parameter; the rows of all records follow each other.
#[derive(Debug, Default)]
pub(crate) struct LinearProblem {
    columns: Vec<Vec<f64>>,
    y: Vec<f64>,
    /// The rows of each response of each record.
    pieces: Vec<std::ops::Range<usize>>,
    /// The means of response and columns that were subtracted from each piece.
    /// `None` if the zero is known.
    means: Vec<Option<(f64, Vec<f64>)>>,
    /// Readings of a coarse gauge, by response of a record.
    rounded: Vec<QuantisedResponse>,
    /// Causes that were read in coarse steps.
    causes: Vec<QuantisedInput>,
    /// Position of an axis at every row, mm, by its name; `None` if it stood still.
    at_mm: BTreeMap<String, Vec<Option<f64>>>,
}

/// A response that was read in coarse steps.
#[derive(Debug)]
struct QuantisedResponse {
    /// Rows that read alike from one side.
    alike: Vec<Vec<usize>>,
    /// Standard deviation of the rounding error that repeats leave.
    sd: f64,
}

/// A cause (a temperature, a position in motion) that was read in coarse steps.
#[derive(Debug)]
struct QuantisedInput {
    /// The first row of its piece.
    start: usize,
    /// Change of every column per standard deviation of rounding, row by row.
    moves: Vec<Vec<f64>>,
    /// Rows of the piece that share one rounding error.
    alike: Vec<std::ops::Range<usize>>,
}

/// The step in which a cause was read.
/// Commanded positions are not readings and have none.
fn cause_step(record: &Record, column: &Column) -> Option<f64> {
    let moving = matches!(record.kind, RunKind::Dynamics | RunKind::Ballbar | RunKind::FeedSweep);
    match column.role {
        Role::Temperature | Role::Load(_) | Role::Channel => {}
        Role::Position(_) | Role::Velocity(_) if moving => {}
        _ => return None,
    }
    step_of(&column.data)
}

/// A message about a response whose readings are all equal; `None` if they vary.
/// They do not show the gauge's resolution, so nothing bounds smaller effects.
pub(crate) fn unread(record: &Record, column: &Column) -> Option<String> {
    column.data.iter().all(|v| v - column.data[0] == 0.0).then(|| {
        format!(
            "{}: {}: every reading is {}: the gauge's step is not known, so these readings bound no effect and are left out of the fit",
            record.path.display(),
            column.role,
            short(column.data[0])
        )
    })
}

impl LinearProblem {
    pub(crate) fn new(parameters: usize) -> Self {
        Self { columns: vec![Vec::new(); parameters], ..Self::default() }
    }

    /// Adds a response of a record.
    /// `y` is the measured response; `columns` are its changes per unit of each parameter. The mean is
    /// subtracted unless the zero is known.
    pub(crate) fn push(&mut self, y: &[f64], columns: &[Vec<f64>], zero_is_known: bool) {
        let mean =
            |v: &[f64]| if zero_is_known { 0.0 } else { v.iter().sum::<f64>() / v.len().max(1) as f64 };
        let start = self.y.len();
        let of_y = mean(y);
        self.y.extend(y.iter().map(|v| v - of_y));
        self.pieces.push(start..self.y.len());
        let mut of_columns = Vec::with_capacity(columns.len());
        for (all, own) in self.columns.iter_mut().zip(columns) {
            let m = mean(own);
            all.extend(own.iter().map(|v| v - m));
            of_columns.push(m);
        }
        self.means.push((!zero_is_known).then_some((of_y, of_columns)));
    }

    /// Mean residual of a piece, µm: its own zero.
    /// `None` if that is known.
    fn zero_um(&self, found: &[FittedValue], piece: usize) -> Option<f64> {
        let (of_y, of_columns) = self.means[piece].as_ref()?;
        Some(of_y - found.iter().zip(of_columns).map(|(f, m)| f.value * m).sum::<f64>())
    }

    /// Notes that a coarse gauge rounds the response that was pushed last.
    /// Equal readings from one side have the same error. If noise dithers the steps, the remaining rounding
    /// error is equal from one side. Returns a message for the user.
    pub(crate) fn rounded_as(&mut self, record: &Record, column: &Column) -> Option<String> {
        let piece = self.pieces.last().cloned()?;
        let steps = ReadingResolution::of_response(record, column)?;
        let direction = column.role.axis().and_then(|a| record.data(&Role::Direction(a.clone())));
        let mut groups: BTreeMap<(i64, i64), Vec<usize>> = BTreeMap::new();
        for (i, reading) in column.data.iter().enumerate() {
            let value = if steps.is_coarse() { (reading / steps.step).round() as i64 } else { 0 };
            groups.entry((value, direction.map_or(0, |d| d[i] as i64))).or_default().push(piece.start + i);
        }
        self.rounded
            .push(QuantisedResponse { alike: groups.into_values().collect(), sd: steps.standard_error() });
        steps.is_coarse().then(|| {
            let unit = if matches!(column.role, Role::Error(_)) { "µm" } else { column.unit.as_str() };
            format!(
                "{}: {}: readings in steps of {} {unit}, most repeats alike: what rounding may do is in the intervals; a finer gauge makes \
                 them narrower",
                record.path.display(),
                column.role,
                short(steps.step)
            )
        })
    }

    /// Finds causes of a record that were read in coarse steps.
    /// They concern the response pushed last. `basis` gives the columns of a record. Returns the messages for
    /// the user.
    fn rounded_causes(
        &mut self,
        record: &Record,
        basis: &dyn Fn(&Record) -> Option<Vec<Vec<f64>>>,
    ) -> Vec<String> {
        let Some((piece, own)) = self.pieces.last().cloned().zip(basis(record)) else { return Vec::new() };
        let mut said = Vec::new();
        for (at, column) in record.columns.iter().enumerate() {
            let Some(step) = cause_step(record, column) else { continue };
            let mut moved = record.clone();
            moved.columns[at].data.iter_mut().for_each(|v| *v += step / 12f64.sqrt());
            let Some(moved) = basis(&moved) else { continue };
            let moves: Vec<Vec<f64>> =
                moved.iter().zip(&own).map(|(m, o)| m.iter().zip(o).map(|(m, o)| m - o).collect()).collect();
            if moves.iter().flatten().all(|m| *m == 0.0) {
                continue;
            }
            // Consecutive equal readings have the same error.
            let alike = column.data.chunk_by(|a, b| (a - b).abs() < 0.5 * step).scan(0, |from, rows| {
                let start = *from;
                *from += rows.len();
                Some(start..*from)
            });
            let alike = alike.collect();
            self.causes.push(QuantisedInput { start: piece.start, moves, alike });
            let [low, high] = span(&column.data);
            if is_coarse_cause(column, step, high - low) {
                let unit = if column.role == Role::Temperature { "K" } else { column.unit.as_str() };
                said.push(format!(
                    "{}: {}: readings in steps of {} {unit} over {} {unit}: what rounding may do is in the intervals",
                    record.path.display(),
                    column.name,
                    short(step),
                    short(1e-9 * (1e9 * (high - low)).round())
                ));
            }
        }
        said
    }

    /// Standard deviation of every parameter from rounding alone, at these values.
    fn rounding(&self, solution: &Solution) -> Vec<f64> {
        let covariance = solution.covariance();
        let mut squares = vec![0.0; self.columns.len()];
        // Adds rows with a common error; each is given in standard deviations of it.
        let mut add = |rows: &mut dyn Iterator<Item = (usize, f64)>| {
            let mut sum = vec![0.0; squares.len()];
            rows.for_each(|(i, by)| sum.iter_mut().zip(&self.columns).for_each(|(s, c)| *s += by * c[i]));
            for (s, row) in squares.iter_mut().zip(covariance.row_iter()) {
                *s += row.iter().zip(&sum).map(|(c, s)| c * s).sum::<f64>().powi(2);
            }
        };
        for rounded in &self.rounded {
            for rows in &rounded.alike {
                add(&mut rows.iter().map(|i| (*i, rounded.sd)));
            }
            // Among equal readings a parameter is only bounded: its effect must stay within one step. The
            // difference of two rounding errors has twice the variance of one.
            for column in &self.columns {
                let bounds = |rows: &Vec<usize>| span(rows.iter().map(|i| column[*i]));
                let ranges: Vec<[f64; 2]> = rounded.alike.iter().map(bounds).collect();
                let widest = ranges.iter().map(|[lo, hi]| hi - lo).fold(0.0, f64::max);
                if widest > 0.0 {
                    let unit = 2f64.sqrt() * rounded.sd / widest;
                    let within = rounded.alike.iter().zip(&ranges).flat_map(|(rows, [lo, hi])| {
                        rows.iter().map(move |i| (*i, unit * (column[*i] - f64::midpoint(*lo, *hi))))
                    });
                    add(&mut within.into_iter());
                }
            }
        }
        for cause in &self.causes {
            // Change of the response at a row per standard deviation of rounding.
            let error = |i: usize| cause.moves.iter().zip(&solution.values).map(|(m, v)| m[i] * v).sum();
            for rows in &cause.alike {
                add(&mut rows.clone().map(|i| (cause.start + i, error(i))));
            }
        }
        squares.into_iter().map(f64::sqrt).collect()
    }

    /// Records the positions of the axes that moved in the response pushed last.
    fn moved(&mut self, record: &Record) {
        let Some(piece) = self.pieces.last().cloned() else { return };
        for (axis, p) in repeated_residuals::moving(record) {
            let all = self.at_mm.entry(axis).or_default();
            all.resize(piece.start, None);
            all.extend(p.iter().copied().map(Some));
        }
    }

    /// The stretches that are left out in turn, as every row's block.
    /// The first set is of time, the others are of each axis' places.
    fn stretches(&self) -> Vec<Vec<usize>> {
        // Stretches divide each record's response, so that every stretch has rows of all of them.
        let block = |i: usize| {
            let piece = self.pieces.iter().find(|r| r.contains(&i));
            piece.map_or(0, |r| (i - r.start) * BLOCKS / r.len())
        };
        let in_time: Vec<usize> = (0..self.y.len()).map(block).collect();
        let of_axis = |p: &Vec<Option<f64>>| {
            let own = repeated_residuals::stretches(p, BLOCKS)?;
            Some(
                in_time
                    .iter()
                    .enumerate()
                    .map(|(i, t)| own.get(i).copied().flatten().unwrap_or(*t))
                    .collect(),
            )
        };
        let by_place: Vec<Vec<usize>> = self.at_mm.values().filter_map(of_axis).collect();
        std::iter::once(in_time).chain(by_place).collect()
    }

    /// RMS over the pieces that `take` chooses: without and with the solution.
    fn rms_um(&self, found: &[FittedValue], take: impl Fn(usize) -> bool) -> [f64; 2] {
        let (mut before, mut after, mut n) = (0.0, 0.0, 0.0);
        for i in self.pieces.iter().enumerate().filter(|(k, _)| take(*k)).flat_map(|(_, p)| p.clone()) {
            before += self.y[i].powi(2);
            after += self.left_um(found, i).powi(2);
            n += 1.0;
        }
        [(before / f64::max(n, 1.0)).sqrt(), (after / f64::max(n, 1.0)).sqrt()]
    }

    fn left_um(&self, found: &[FittedValue], i: usize) -> f64 {
        self.y[i] - found.iter().zip(&self.columns).map(|(f, c)| f.value * c[i]).sum::<f64>()
    }

    /// RMS over the pieces that `take` chooses, on unseen rows.
    /// Each stretch of time is predicted by the solution of all the others.
    fn unseen_um(&self, take: impl Fn(usize) -> bool) -> Option<f64> {
        let blocks = self.stretches().swap_remove(0);
        let equal = self.equal_rows(&blocks);
        let solutions = (0..BLOCKS).map(|b| without(&equal, b).ok()).collect::<Option<Vec<_>>>()?;
        let (mut sum, mut n) = (0.0, 0.0);
        for i in self.pieces.iter().enumerate().filter(|(k, _)| take(*k)).flat_map(|(_, r)| r.clone()) {
            let of = &solutions[blocks[i]];
            let said: f64 = self.columns.iter().zip(&of.values).map(|(c, v)| v * c[i]).sum();
            sum += (self.y[i] - said).powi(2);
            n += 1.0;
        }
        (n > 0.0).then(|| (sum / n).sqrt())
    }

    /// The blocks reduced to a few rows each, which have the same solution.
    fn equal_rows(&self, blocks: &[usize]) -> Vec<(Vec<Vec<f64>>, Vec<f64>)> {
        let of = |b: usize| {
            let own =
                |v: &Vec<f64>| v.iter().zip(blocks).filter(|(_, of)| **of == b).map(|(v, _)| *v).collect();
            compress_rows(&self.columns.iter().map(own).collect::<Vec<_>>(), &own(&self.y))
        };
        (0..BLOCKS).map(of).collect()
    }

    /// Half width that contains 95 % of the rows in the worst selected piece.
    /// The worst is used because one kind of run may show what another does not.
    fn half_width_um(&self, found: &[FittedValue], take: impl Fn(usize) -> bool) -> f64 {
        let own = self.pieces.iter().enumerate().filter(|(k, p)| take(*k) && !p.is_empty());
        own.map(|(_, p)| quantile(p.clone().map(|i| self.left_um(found, i).abs()).collect(), 0.95))
            .fold(1e-9, f64::max)
    }

    /// Solves, or returns the first parameter that these rows do not determine.
    /// It is not determined together with those before it.
    pub(crate) fn solve(&self) -> Result<Vec<FittedValue>, usize> {
        rtec_files::cancellable_computation::step();
        if self.y.is_empty() {
            return Err(0);
        }
        let solution = rtec_least_squares::solve(&self.columns, &self.y)?;
        let tiny = |c: &Vec<f64>| c.iter().map(|v| v * v).sum::<f64>().sqrt() <= 1e-12;
        let dependent = |k: &usize| solution.independent[*k] < DEPENDENT || tiny(&self.columns[*k]);
        if let Some(k) = (0..self.columns.len()).find(dependent) {
            return Err(k);
        }
        let mut found: Vec<FittedValue> = Vec::new();
        for blocks in self.stretches() {
            let of_these = self.jackknifed(&blocks, &solution.values)?;
            if found.is_empty() {
                found = of_these;
                continue;
            }
            let width = |f: &FittedValue| f.interval[1] - f.interval[0];
            let wider = found.iter_mut().zip(of_these).filter(|(f, other)| width(other) > width(f));
            wider.for_each(|(f, other)| *f = other);
        }
        for (f, sd) in found.iter_mut().zip(self.rounding(&solution)) {
            let beside = |bound: f64| (bound - f.value).hypot(NORMAL_95 * sd);
            f.interval = [f.value - beside(f.interval[0]), f.value + beside(f.interval[1])];
        }
        Ok(found)
    }

    /// Values with intervals from leaving out each block in turn.
    fn jackknifed(&self, blocks: &[usize], values: &[f64]) -> Result<Vec<FittedValue>, usize> {
        let equal = self.equal_rows(blocks);
        let used = (0..BLOCKS).filter(|b| blocks.contains(b));
        let parts = used.map(|b| without(&equal, b)).collect::<Result<Vec<_>, _>>()?;
        let found = values.iter().enumerate().map(|(k, value)| {
            let parts: Vec<f64> = parts.iter().map(|s| s.values[k]).collect();
            FittedValue { value: *value, interval: jackknife_interval(*value, &parts) }
        });
        Ok(found.collect())
    }
}

/// The solution without one of these blocks.
fn without(equal: &[(Vec<Vec<f64>>, Vec<f64>)], block: usize) -> Result<Solution, usize> {
    let kept = || equal.iter().enumerate().filter(|(b, _)| *b != block).map(|(_, rows)| rows);
    let column = |k: usize| kept().flat_map(|(columns, _)| &columns[k]).copied().collect::<Vec<f64>>();
    let y: Vec<f64> = kept().flat_map(|(_, y)| y).copied().collect();
    rtec_least_squares::solve(&(0..equal[0].0.len()).map(column).collect::<Vec<_>>(), &y)
}

/// A record's own zero of a response, set by its gauge or its homing.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RecordResponseZero {
    /// The record's file.
    pub record: String,
    /// The response.
    pub response: String,
    /// Mean residual of the response, µm.
    pub um: f64,
}

/// The result of fitting named effects.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EffectFitReport {
    /// The fitted effects with their intervals.
    pub effects: Vec<FittedEffect>,
    /// RMS per response over all records, before and after, µm.
    /// Each record's own zero is subtracted.
    pub rms_um: Vec<(String, [f64; 2])>,
    /// The records' own zeros that were subtracted.
    /// They belong neither to the model nor to an interval.
    pub zeros: Vec<RecordResponseZero>,
    /// Messages about residuals that are not noise, by response.
    pub warnings: Vec<String>,
}

/// Adds the fitted effects to the machine.
fn written(
    machine: &mut Machine,
    effects: Vec<Effect>,
    found: &[FittedValue],
    records: &[&Record],
    date: &str,
) -> Result<Vec<FittedEffect>, InputError> {
    let usage = |found: String, expected: &str| InputError::whole(Path::new("--effects"), found, expected);
    let mut fitted = Vec::new();
    let mut at = 0;
    for mut effect in effects {
        let n = effect.coefficient_count();
        let own = &found[at..at + n];
        at += n;
        effect.set_coefficients(&own.iter().map(|f| f.value).collect::<Vec<_>>());
        let names = effect.description().parameters.iter().map(|p| p.name.clone());
        let interval: Intervals = names.zip(own.iter().map(|f| vec![f.interval])).collect();
        fitted.push(FittedEffect::of(&effect, &interval));
        let provenance = provenance(&effect, records, date.to_owned(), interval);
        machine.push(effect, provenance).map_err(|e| usage(e.to_string(), "each effect once"))?;
    }
    Ok(fitted)
}

/// Parses an effect, with temperatures as in `thermal_expansion.x:T3-T20`.
fn effect_of(text: &str, dictionary: &Dictionary) -> Result<Effect, InputError> {
    let usage = |found: String, expected: String| InputError::whole(Path::new("--effects"), found, expected);
    let (name, delta) = text.split_once(':').map_or((text, None), |(n, d)| (n, Some(d)));
    let mut effect = dictionary.effect(name).map_err(|e| usage(e.found, e.expected))?;
    if effect.description().parameters.iter().any(|p| p.search != ParameterFitMethod::Linear || p.array) {
        let found = format!("`{name}`, which is not linear in one number per parameter");
        return Err(usage(
            found,
            "an effect as scale, reversal, squareness; `reconcile` fits the others".into(),
        ));
    }
    match (effect.description().needs.contains(&RequiredInput::Delta), delta) {
        (true, Some(d)) => {
            effect.delta = Some(match d.split_once('-') {
                Some((sensor, minus)) => TemperatureDifference::pair(sensor, minus),
                None => TemperatureDifference::single(d),
            });
        }
        (true, None) => {
            return Err(usage(format!("`{text}`"), format!("{text}:SENSOR or {text}:SENSOR-SENSOR")));
        }
        (false, Some(d)) => return Err(usage(format!("`{d}` after `{name}`"), format!("`{name}` alone"))),
        (false, None) => {}
    }
    Ok(effect)
}

/// The named effects, without duplicates and without those of the base.
fn effects_of(base: &Machine, names: &[String]) -> Result<Vec<Effect>, InputError> {
    let usage = |found: String, expected: &str| InputError::whole(Path::new("--effects"), found, expected);
    let effects = names.iter().map(|n| effect_of(n, base.dictionary())).collect::<Result<Vec<_>, _>>()?;
    for (i, e) in effects.iter().enumerate() {
        let twice = effects[..i].iter().chain(base.effects()).any(|o| o.identity() == e.identity());
        if twice {
            return Err(usage(
                format!("`{}` a second time", e.identity()),
                "effects that the base does not have",
            ));
        }
    }
    Ok(effects)
}

/// Half widths of a response by kind of run, from each piece's response and kind.
fn by_kind_um(
    problem: &LinearProblem,
    found: &[FittedValue],
    piece_of: &[(Role, Option<String>)],
    role: &Role,
) -> BTreeMap<String, f64> {
    let own = piece_of.iter().filter(|(r, _)| r == role);
    let kinds: BTreeSet<&String> = own.filter_map(|(_, kind)| kind.as_ref()).collect();
    let width = |kind: &String| {
        let take = |piece: usize| piece_of[piece].0 == *role && piece_of[piece].1.as_ref() == Some(kind);
        (kind.clone(), problem.half_width_um(found, take))
    };
    kinds.into_iter().map(width).collect()
}

/// Messages about pieces whose residuals are not noise, one line each.
fn structure(
    problem: &LinearProblem,
    found: &[FittedValue],
    owners: &[&Record],
    piece_of: &[(Role, Option<String>)],
) -> Vec<String> {
    let of = |n: usize| {
        let (record, role) = (owners[n], &piece_of[n].0);
        let left: Vec<f64> = problem.pieces[n].clone().map(|i| problem.left_um(found, i)).collect();
        Some(format!(
            "{}: {role}: {}",
            record.path.display(),
            StructuredResidual::of(record, &left, found.len())?
        ))
    };
    (0..problem.pieces.len()).filter_map(of).collect()
}

/// Change of a response per unit of each coefficient, row by row.
fn basis_of(effects: &[Effect], record: &Record, role: &Role) -> Result<Vec<Vec<f64>>, MissingInput> {
    let mut columns = Vec::new();
    for effect in effects {
        let (bound, rows) = (effect.bind(record)?, record.rows());
        let mut basis = vec![0.0; effect.coefficient_count() * rows];
        if let Some((_, component)) = effect.acts_on(record).into_iter().find(|(r, _)| r == role) {
            bound.basis(effect, component, &mut basis);
        }
        columns.extend(basis.chunks(rows).map(<[f64]>::to_vec));
    }
    Ok(columns)
}

/// The error for records that do not determine an effect.
/// `blank` lists responses whose readings are all equal.
fn not_shown(effect: Option<&Effect>, blank: &[String]) -> InputError {
    let name = effect.map_or(String::new(), Effect::identity);
    let (found, expected) = if let Some(said) = blank.first() {
        let expected = format!("readings that `{name}` changes by a step of the gauge, or a finer gauge");
        (format!("{said}; the others do not show `{name}`"), expected)
    } else {
        let experiment = effect.map_or(String::new(), |e| e.description().experiment.clone());
        let found =
            format!("records that do not tell `{name}` from the effects named before it, or from nothing");
        (found, format!("a record that does: {experiment}"))
    };
    InputError::whole(Path::new("--effects"), found, expected)
}

/// Fits effects that the user names, in addition to those of the base.
/// It uses least squares on all responses of the records, errors and forces, and returns the base with the
/// effects added.
///
/// # Errors
/// An unknown effect, one that the base has, one that is not linear; a record that lacks an input of an
/// effect; effects that these records cannot distinguish.
pub fn fit_named(
    base: &Machine,
    names: &[String],
    records: &[&Record],
    date: &str,
    valid_days: i64,
) -> Result<(Machine, EffectFitReport), InputError> {
    let usage = |found: String, expected: &str| InputError::whole(Path::new("--effects"), found, expected);
    let moving: Vec<Record> = records.iter().map(|r| in_motion(r)).collect();
    let records: &[&Record] = &moving.iter().collect::<Vec<_>>();
    let effects = effects_of(base, names)?;
    if let Some(effect) = effects.iter().find(|e| records.iter().all(|r| e.acts_on(r).is_empty())) {
        let quantity =
            if effect.description().quantity == AffectedQuantity::Force { "force" } else { "error" };
        let axis = effect.axes().first().map_or("AXIS", Axis::as_str);
        let found = format!("`{}`, and no record with a response that it acts on", effect.identity());
        return Err(usage(found, &format!("a record with a column of role {quantity}.{axis}")));
    }
    let count: usize = effects.iter().map(Effect::coefficient_count).sum();
    let mut problem = LinearProblem::new(count);
    let mut roles: Vec<Role> = Vec::new();
    // Response and kind of run of each piece.
    let mut piece_of: Vec<(Role, Option<String>)> = Vec::new();
    let mut owners: Vec<&Record> = Vec::new();
    let (mut coarse, mut blank) = (Vec::new(), Vec::new());
    for record in records {
        let left = base.without_prediction(record)?;
        for column in left.responses() {
            let columns = basis_of(&effects, &left, &column.role).map_err(|m| m.of(record))?;
            let is_known = |e: &Effect| {
                e.description().constant && e.acts_on(&left).iter().any(|(role, _)| *role == column.role)
            };
            let zero_is_known = effects.iter().any(is_known);
            if columns.iter().all(|c| c.iter().all(|v| *v == 0.0)) {
                continue;
            }
            if let Some(said) = record.column(&column.role).and_then(|read| unread(record, read)) {
                blank.push(said);
                continue;
            }
            problem.push(&column.data, &columns, zero_is_known);
            problem.moved(record);
            // The column as read is used, because the difference to the base has no steps.
            coarse.extend(record.column(&column.role).and_then(|read| problem.rounded_as(record, read)));
            coarse.extend(
                problem.rounded_causes(&left, &|record| basis_of(&effects, record, &column.role).ok()),
            );
            owners.push(record);
            if !roles.contains(&column.role) {
                roles.push(column.role.clone());
            }
            piece_of.push((column.role.clone(), FitNote::kind_of(record)));
        }
    }
    let owner = |k: usize| {
        let mut at = 0;
        effects.iter().find(|e| {
            at += e.coefficient_count();
            k < at
        })
    };
    let found = problem.solve().map_err(|k| not_shown(owner(k), &blank))?;
    let rms = |role: &Role| problem.rms_um(&found, |piece| piece_of[piece].0 == *role);
    let rms_um = roles.iter().map(|r| (r.to_string(), rms(r))).collect();
    let mut warnings = structure(&problem, &found, &owners, &piece_of);
    warnings.extend(blank.into_iter().chain(coarse));
    let mut machine = base.clone();
    for role in &roles {
        let seen: Vec<&Record> = records.iter().filter(|r| r.column(role).is_some()).copied().collect();
        let mut note = FitNote {
            response: role.to_string(),
            date: date.to_owned(),
            valid_until: date::parse(date).map_or_else(|| date.to_owned(), |d| date::format(d + valid_days)),
            rms_um: problem.unseen_um(|piece| piece_of[piece].0 == *role).unwrap_or(rms(role)[1]),
            half_width_um: problem.half_width_um(&found, |piece| piece_of[piece].0 == *role),
            valid: Vec::new(),
            at_mm: Some(FitNote::places(&seen)),
            by_kind_um: by_kind_um(&problem, &found, &piece_of, role),
            from: seen.iter().map(|r| SourceRecord::of(r)).collect(),
        };
        if let Some(earlier) = base.fits().iter().find(|f| f.response == note.response) {
            note.add_earlier_fit(earlier, 0.0);
        }
        machine.note_fit(note);
    }
    let fitted = written(&mut machine, effects, &found, records, date)?;
    let zero = |(piece, (record, (role, _))): (usize, (&&Record, &(Role, Option<String>)))| {
        let name = record.path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
        Some(RecordResponseZero {
            record: name,
            response: role.to_string(),
            um: problem.zero_um(&found, piece)?,
        })
    };
    let zeros = owners.iter().zip(&piece_of).enumerate().filter_map(zero).collect();
    Ok((machine, EffectFitReport { effects: fitted, rms_um, zeros, warnings }))
}
