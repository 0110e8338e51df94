//! Thermal effects, ISO 230-3: environment, rotation of the spindle and movement of axes, each a phase of its own.

use super::{correlation, error_axes, lacks, range, targets};
use crate::plot::{Chart, Series, Style};
use rtec_files::InputError;
use rtec_model::record::{Record, Role};
use serde::Serialize;
use std::collections::BTreeMap;
use std::ops::Range;

/// Thermal drift of one response over the whole test, and phase by phase. Ranges in µm.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Drift {
    /// The response, as `error.z`.
    pub response: String,
    /// The whole test.
    #[serde(flatten)]
    pub whole: Figures,
    /// Its phases, in order.
    pub phases: Vec<Phase>,
}

/// What a displacement did over some time.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Figures {
    /// Range of displacement within the first 60 minutes, d₆₀ (over the environment's phase: `E_TVE` of an hour).
    pub d_60: f64,
    /// Range of displacement over the whole time, `d_t`.
    pub d_t: f64,
    /// Range within the last 60 minutes: how steady the end is.
    pub d_last_60: f64,
    /// Displacement at the end against the start (means of the first and last hundredth of the rows).
    pub end: f64,
    /// Mean rate: slope of the straight line through it, µm/h.
    pub rate_per_h: f64,
    /// Largest rate over any 60 minutes, µm/h.
    pub max_rate_per_h: f64,
    /// Duration, min.
    pub t_min: f64,
    /// Per sensor: temperature and its correlation with the displacement.
    pub temperatures: BTreeMap<String, SensorDrift>,
}

/// One phase of a test, for one response.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Phase {
    /// `environment`, `spindle`, `movement` or `cooling`.
    pub phase: &'static str,
    /// The same in words, with speed or axis.
    pub what: String,
    /// When it began, min from the test's start.
    pub from_min: f64,
    /// Where the axis was read, mm, in a phase of movement with several places.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub at_mm: Option<f64>,
    /// What the displacement did.
    #[serde(flatten)]
    pub figures: Figures,
}

/// A sensor during a drift test.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SensorDrift {
    /// Highest minus lowest temperature, K.
    #[serde(rename = "range_K")]
    pub range_k: f64,
    /// Temperature at the end minus that at the start, K.
    #[serde(rename = "end_K")]
    pub end_k: f64,
    /// Slope of the straight line through it, K/h.
    #[serde(rename = "rate_K_per_h")]
    pub rate_k_per_h: f64,
    /// Correlation with the displacement.
    pub gamma: f64,
}

/// Shorter than this is no phase of its own, s; nor what is shorter than a twentieth of the test.
const SHORTEST_S: f64 = 900.0;
/// Places at which an axis is read while it moves to and fro: more are a log of the movement itself.
const MOST_PLACES: usize = 10;

/// Evaluates a drift run, response by response.
///
/// # Errors
/// The record has no time or no error response.
pub fn drift(record: &Record) -> Result<Vec<Drift>, InputError> {
    let t = record
        .data(&Role::Time)
        .ok_or_else(|| lacks(record, "no time", "a column of role time: drift is an error over time"))?;
    let spans = spans(record, t);
    let found: Vec<Drift> = error_axes(record)
        .into_iter()
        .map(|(axis, e)| {
            let all: Vec<usize> = (0..t.len()).collect();
            let phases = spans.iter().flat_map(|s| s.of(record, t, e)).collect();
            Drift { response: format!("error.{axis}"), whole: figures(record, t, e, &all), phases }
        })
        .collect();
    if found.is_empty() {
        return Err(lacks(record, "no error response", "a column of role error.AXIS"));
    }
    Ok(found)
}

/// What makes heat at a row.
#[derive(Debug, Clone, PartialEq)]
enum State {
    Rest,
    Spindle,
    Moves(String),
}

/// A stretch of rows in one state.
#[derive(Debug, Clone)]
struct Span {
    state: State,
    rows: Range<usize>,
    /// Heat was made before it.
    after_heat: bool,
}

fn states(record: &Record) -> Vec<State> {
    let rpm = record.data(&Role::SpindleSpeed);
    let axes: Vec<(String, &[f64])> = record
        .axes(Role::Position)
        .filter_map(|a| Some((a.to_string(), record.data(&Role::Position(a.clone()))?)))
        .collect();
    let moves = |p: &[f64], row: usize| {
        let other = |i: Option<usize>| i.and_then(|i| p.get(i)).is_some_and(|q| (q - p[row]).abs() > 0.01);
        other(row.checked_sub(1)) || other(Some(row + 1))
    };
    (0..record.rows())
        .map(|row| {
            if rpm.is_some_and(|r| r[row].abs() > 0.5) {
                return State::Spindle;
            }
            let moving: Vec<&str> =
                axes.iter().filter(|(_, p)| moves(p, row)).map(|(a, _)| a.as_str()).collect();
            if moving.is_empty() { State::Rest } else { State::Moves(moving.join(", ")) }
        })
        .collect()
}

/// The phases of a test: pauses belong to what they interrupt.
fn spans(record: &Record, t: &[f64]) -> Vec<Span> {
    let mut spans: Vec<Span> = Vec::new();
    for (row, state) in states(record).into_iter().enumerate() {
        match spans.last_mut() {
            Some(s) if s.state == state => s.rows.end = row + 1,
            _ => spans.push(Span { state, rows: row..row + 1, after_heat: false }),
        }
    }
    let last = t.len() - 1;
    let length = |s: &Span| t[s.rows.end.min(last)] - t[s.rows.start];
    let shortest = SHORTEST_S.min((t[last] - t[0]) / 20.0);
    while let Some(i) = (0..spans.len())
        .filter(|i| spans.len() > 1 && length(&spans[*i]) < shortest)
        .min_by(|a, b| length(&spans[*a]).total_cmp(&length(&spans[*b])))
    {
        let short = spans.remove(i);
        if i == 0 {
            spans[0].rows.start = short.rows.start;
        } else {
            spans[i - 1].rows.end = short.rows.end;
            if spans.get(i).is_some_and(|next| next.state == spans[i - 1].state) {
                let next = spans.remove(i);
                spans[i - 1].rows.end = next.rows.end;
            }
        }
    }
    let mut heat = false;
    for s in &mut spans {
        s.after_heat = heat;
        heat |= s.state != State::Rest;
    }
    spans
}

impl Span {
    fn name(&self, record: &Record) -> (&'static str, String) {
        match &self.state {
            State::Rest if self.after_heat => ("cooling", "at rest after heat".to_owned()),
            State::Rest if record.column(&Role::SpindleSpeed).is_none() => (
                "environment",
                "no axis moves, spindle_speed not recorded: environment (ETVE) only if it stood".to_owned(),
            ),
            State::Rest => ("environment", "environment (ETVE), at rest".to_owned()),
            State::Moves(axes) => ("movement", format!("movement of {axes}")),
            State::Spindle => {
                let rpm = record.data(&Role::SpindleSpeed).unwrap_or_default();
                let on: Vec<f64> =
                    self.rows.clone().filter_map(|r| rpm.get(r)).copied().filter(|v| v.abs() > 0.5).collect();
                let (lo, hi) =
                    on.iter().fold((f64::INFINITY, 0.0_f64), |(l, h), v| (l.min(v.abs()), h.max(v.abs())));
                let speed =
                    if hi - lo > 0.02 * hi { format!("{lo:.0} to {hi:.0}") } else { format!("{hi:.0}") };
                ("spindle", format!("spindle rotation, {speed} rpm"))
            }
        }
    }

    /// The phase for one response; one for each place at which a moving axis was read.
    fn of(&self, record: &Record, t: &[f64], e: &[f64]) -> Vec<Phase> {
        let (phase, what) = self.name(record);
        let rows: Vec<usize> = self.rows.clone().collect();
        let at = |at_mm: Option<f64>, rows: &[usize]| Phase {
            phase,
            what: what.clone(),
            from_min: (t[rows[0]] - t[0]) / 60.0,
            at_mm,
            figures: figures(record, t, e, rows),
        };
        let moving = match &self.state {
            State::Moves(axes) => {
                record.axes(Role::Position).find(|a| axes.split(", ").any(|n| n == a.as_str()))
            }
            _ => None,
        };
        let position = moving.and_then(|a| record.data(&Role::Position(a.clone())));
        if let Some(p) = position {
            let own: Vec<f64> = rows.iter().map(|r| p[*r]).collect();
            let places = targets(&own);
            if (2..=MOST_PLACES).contains(&places.len()) {
                let of = |place: &Vec<usize>| {
                    let there: Vec<usize> = place.iter().map(|i| rows[*i]).collect();
                    at(Some(own[place[0]]), &there)
                };
                return places.iter().filter(|p| p.len() > 1).map(of).collect();
            }
        }
        vec![at(None, &rows)]
    }
}

/// Slope of the straight line through points, per hour.
fn slope_per_h(t: &[f64], v: &[f64]) -> f64 {
    let n = t.len() as f64;
    let (mt, mv) = (t.iter().sum::<f64>() / n, v.iter().sum::<f64>() / n);
    let (mut tt, mut tv) = (0.0, 0.0);
    for (t, v) in t.iter().zip(v) {
        tt += (t - mt) * (t - mt);
        tv += (t - mt) * (v - mv);
    }
    if tt > 0.0 { tv / tt * 3600.0 } else { 0.0 }
}

fn figures(record: &Record, t: &[f64], e: &[f64], rows: &[usize]) -> Figures {
    let pick = |data: &[f64]| rows.iter().map(|r| data[*r]).collect::<Vec<f64>>();
    let (t, e) = (pick(t), pick(e));
    let (first, last) = (t[0], t[t.len() - 1]);
    let of = |from: f64, to: f64| {
        let inside = t.iter().zip(&e).filter(|(t, _)| **t >= from && **t <= to);
        range(inside.map(|(_, e)| (*e, *e))).unwrap_or(0.0)
    };
    let few = (e.len() / 100).max(1);
    let change = |v: &[f64]| {
        let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
        mean(&v[v.len() - few..]) - mean(&v[..few])
    };
    // Rate over an hour (or the whole where it is shorter), window sliding with the rows.
    let window = (last - first).min(3600.0);
    let mut rate: f64 = 0.0;
    let mut back = 0;
    for row in 0..t.len() {
        while t[row] - t[back] > window {
            back += 1;
        }
        let h = t[row] - t[back];
        if h >= 0.95 * window && h > 0.0 {
            rate = rate.max((e[row] - e[back]).abs() / h * 3600.0);
        }
    }
    let sensor = |data: &[f64]| {
        let v = pick(data);
        SensorDrift {
            range_k: range(v.iter().map(|v| (*v, *v))).unwrap_or(0.0),
            end_k: change(&v),
            rate_k_per_h: slope_per_h(&t, &v),
            gamma: correlation(&v, &e),
        }
    };
    let columns = record.columns.iter().filter(|c| c.role == Role::Temperature);
    Figures {
        d_60: of(first, first + 3600.0),
        d_t: of(first, last),
        d_last_60: of(last - 3600.0, last),
        end: change(&e),
        rate_per_h: slope_per_h(&t, &e),
        max_rate_per_h: rate,
        t_min: (last - first) / 60.0,
        temperatures: columns.map(|c| (c.name.clone(), sensor(&c.data))).collect(),
    }
}

/// Displacements and temperatures over time, the phases marked where they begin.
#[must_use]
pub fn drift_charts(record: &Record) -> Vec<Chart> {
    let t = record.time_s();
    let start = t[0];
    let minutes: Vec<f64> = t.iter().map(|t| (t - start) / 60.0).collect();
    let line = |name: &str, data: &[f64]| {
        Series::new(name, Style::Line, minutes.iter().copied().zip(data.iter().copied()).collect())
    };
    let spans = spans(record, t);
    let marked = |mut chart: Chart| {
        if spans.len() > 1 {
            chart.marks = spans.iter().map(|s| (minutes[s.rows.start], s.name(record).1)).collect();
        }
        chart
    };
    let mut errors = Chart::new("Thermal drift (ISO 230-3)", "time (min)", "displacement (µm)");
    for (axis, e) in error_axes(record) {
        errors = errors.with(line(&format!("error.{axis}"), e));
    }
    let mut temperatures = Chart::new("Temperatures", "time (min)", "temperature (°C)");
    for c in record.columns.iter().filter(|c| c.role == Role::Temperature) {
        temperatures = temperatures.with(line(&c.name, &c.data));
    }
    let mut charts = vec![marked(errors)];
    charts.extend(Some(temperatures).filter(|c| !c.series.is_empty()).map(marked));
    charts
}
