//! Thermal effects, ISO 230-3: environment, spindle rotation and axis movement.

mod heat_phases;
mod scatter;
mod streamed;
mod two_pass_figures;

pub(crate) use streamed::StreamedDriftTest;

use super::{CircleAndDriftUncertainty, TestConditions, lacks, targets};
use crate::plot::{Chart, Series, Style};
use heat_phases::{HeatPhase, HeatPhaseCollector, HeatSource};
use rtec_files::Result;
use rtec_model::record::{Column, Record, Role};
use scatter::Scatter;
use serde::Serialize;
use std::collections::BTreeMap;
use two_pass_figures::{FirstPassSums, SecondPassSums};

/// Thermal drift of one response over the whole test, and phase by phase.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DriftResult {
    /// The response: `error.z`, or a tilt such as `angle_error.s.a` (spindle about A).
    pub response: String,
    /// Unit of its figures: `um`, or `urad` or `arcsec` of a tilt.
    pub unit: String,
    /// Standard deviation of one reading, in its unit.
    /// From neighbouring rows at one place, and at least that of the gauge's rounding.
    pub scatter: f64,
    /// The whole test.
    #[serde(flatten)]
    pub whole: DriftFigures,
    /// Its phases, in order.
    pub phases: Vec<DriftPhaseResult>,
    /// Uncertainty from instrument, set-up, room and scatter, µm.
    /// Only if the conditions state it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub uncertainty: Option<CircleAndDriftUncertainty>,
}

/// Figures of a displacement over a time.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DriftFigures {
    /// Range of displacement within the first 60 minutes, d₆₀.
    /// In the environment's phase: `E_TVE` of an hour.
    pub d_60: f64,
    /// Range of displacement over the whole time, `d_t`.
    pub d_t: f64,
    /// Range within the last 60 minutes: how steady the end is.
    pub d_last_60: f64,
    /// Mean of the last hundredth of the rows minus that of the first.
    pub end: f64,
    /// Slope of the straight line through the rows, µm/h.
    pub rate_per_h: f64,
    /// Largest rate over any 60 minutes, µm/h.
    /// `None` if the rows cover less time.
    pub max_rate_per_h: Option<f64>,
    /// Duration, min.
    pub t_min: f64,
    /// Per sensor: temperature and its correlation with the displacement.
    pub temperatures: BTreeMap<String, SensorDrift>,
}

/// One phase of a test, for one response.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DriftPhaseResult {
    /// `environment`, `spindle`, `movement` or `cooling`.
    pub phase: &'static str,
    /// The same in words, with speed or axis.
    pub what: String,
    /// When it began, min from the test's start.
    pub from_min: f64,
    /// Position of the axis, mm, in a movement phase with several positions.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub at_mm: Option<f64>,
    /// What the displacement did.
    #[serde(flatten)]
    pub figures: DriftFigures,
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
    /// Slope of the straight line through the readings, K/h.
    #[serde(rename = "rate_K_per_h")]
    pub rate_k_per_h: f64,
    /// Correlation with the displacement.
    pub gamma: f64,
}

/// Most positions at which a moving axis is read; more are a log of the movement.
const MOST_PLACES: usize = 10;

/// Evaluates a drift run, response by response.
///
/// # Errors
/// The record has no time or no error response.
pub fn drift(record: &Record) -> Result<Vec<DriftResult>> {
    let t = record
        .data(&Role::Time)
        .ok_or_else(|| lacks(record, "no time", "a column of role time: drift is an error over time"))?;
    let spans = spans_of(record, t);
    let found: Vec<DriftResult> = displaced(&record.columns)
        .map(|c| {
            let mut scatter = Scatter::default();
            let phases = spans.iter().flat_map(|s| phases(s, record, t, &c.data, &mut scatter)).collect();
            DriftResult { phases, ..DriftResult::of(c, figures(record, t, &c.data, 0..t.len()), &scatter) }
        })
        .collect();
    if found.is_empty() {
        return Err(lacks(record, "no error response", "a column of role error.AXIS or angle_error.s.a"));
    }
    Ok(found)
}

/// Adds the uncertainty budget to the displacements.
pub(crate) fn state_budget(all: &mut [DriftResult], conditions: &TestConditions) {
    for d in all.iter_mut().filter(|d| d.unit == "um") {
        d.uncertainty = conditions.drift_budget(d.scatter);
    }
}

impl DriftResult {
    /// A drift without phases, from the figures of the whole test.
    fn of(column: &Column, whole: DriftFigures, scatter: &Scatter) -> Self {
        let (response, unit) = (column.role.to_string(), column.unit.clone());
        let scatter = scatter.of_a_reading();
        Self { response, unit, scatter, whole, phases: Vec::new(), uncertainty: None }
    }
}

/// Columns that drift: displacements and tilts.
fn displaced(columns: &[Column]) -> impl Iterator<Item = &Column> {
    columns.iter().filter(|c| matches!(c.role, Role::Error(_) | Role::AngleError(..)))
}

/// Whether a change of position is a move and not noise of the reading.
fn is_move(from_mm: f64, to_mm: f64) -> bool {
    (from_mm - to_mm).abs() > 0.01
}

fn spans_of(record: &Record, t: &[f64]) -> Vec<HeatPhase> {
    let rpm = record.data(&Role::SpindleSpeed);
    let positions = record.axes(Role::Position);
    let axes: Vec<_> = positions.filter_map(|a| Some((a.as_str(), record.position(a)?))).collect();
    let moves = |p: &[f64], row: usize| {
        let other = |i: Option<usize>| i.and_then(|i| p.get(i)).is_some_and(|q| is_move(*q, p[row]));
        other(row.checked_sub(1)) || other(Some(row + 1))
    };
    let mut spans = HeatPhaseCollector::default();
    for (row, t) in t.iter().enumerate() {
        let moving: Vec<&str> = axes.iter().filter(|(_, p)| moves(p, row)).map(|(a, _)| *a).collect();
        spans.see(&moving, *t, rpm.map_or(0.0, |r| r[row]));
    }
    spans.phases()
}

/// The phase for one response, split by the positions of a moving axis.
fn phases(
    span: &HeatPhase,
    record: &Record,
    t: &[f64],
    e: &[f64],
    scatter: &mut Scatter,
) -> Vec<DriftPhaseResult> {
    let rows: Vec<usize> = span.rows.clone().collect();
    let mut at = |at_mm: Option<f64>, rows: &[usize]| {
        scatter.begin();
        for row in rows {
            scatter.see(t[*row], e[*row]);
        }
        let from_min = (t[rows[0]] - t[0]) / 60.0;
        span.phase(&record.columns, from_min, at_mm, figures(record, t, e, rows.iter().copied()))
    };
    if let HeatSource::Moves(axes) = &span.state
        && let Some(axis) = record.axes(Role::Position).find(|a| axes.split(", ").any(|n| n == a.as_str()))
        && let Some(p) = record.position(axis)
    {
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

fn figures(record: &Record, t: &[f64], e: &[f64], rows: impl Iterator<Item = usize> + Clone) -> DriftFigures {
    let degc: Vec<&[f64]> = record.temperatures().map(|c| c.data.as_slice()).collect();
    let of = |row: usize| (t[row], e[row], degc.as_slice(), row);
    let mut sums = FirstPassSums::new(degc.len());
    for row in rows.clone() {
        sums.see(of(row));
    }
    let mut look = SecondPassSums::at(sums);
    for row in rows {
        look.see(of(row));
    }
    look.figures(record.temperatures().map(|c| c.name.as_str()))
}

/// Charts of displacements and temperatures over time, with the phases marked.
pub fn drift_charts(record: &Record) -> Vec<Chart> {
    let t = record.time_s();
    let start = t[0];
    let minutes: Vec<f64> = t.iter().map(|t| (t - start) / 60.0).collect();
    let line = |name: &str, data: &[f64]| {
        let points = minutes.iter().copied().zip(data.iter().copied());
        Series::new(name, Style::Line, points.filter(|(_, v)| v.is_finite()).collect())
    };
    let errors =
        displaced(&record.columns).map(|c| (c.unit.clone(), line(&c.role.to_string(), &c.data))).collect();
    let degc = record.temperatures().map(|c| line(&c.name, &c.data)).collect();
    charts_of(errors, degc, &spans_of(record, t), &record.columns)
}

/// The charts of these lines over minutes, each line with its unit.
fn charts_of(
    errors: Vec<(String, Series)>,
    degc: Vec<Series>,
    spans: &[HeatPhase],
    columns: &[Column],
) -> Vec<Chart> {
    let start_s = spans.first().map_or(0.0, |s| s.start_s);
    let chart = |title: &str, y: &str, series: Vec<Series>| {
        let mut chart = Chart { series, ..Chart::new(title, "time (min)", y) };
        if spans.len() > 1 {
            chart.marks = spans.iter().map(|s| ((s.start_s - start_s) / 60.0, s.name(columns).1)).collect();
        }
        chart
    };
    let (lengths, tilts): (Vec<_>, Vec<_>) = errors.into_iter().partition(|(unit, _)| unit == "um");
    let series = |all: Vec<(String, Series)>| all.into_iter().map(|(_, s)| s).collect::<Vec<_>>();
    let mut charts = Vec::new();
    if !lengths.is_empty() {
        charts.push(chart("Thermal drift (ISO 230-3)", "displacement (µm)", series(lengths)));
    }
    for unit in ["urad", "arcsec"] {
        let own: Vec<_> = tilts.iter().filter(|(u, _)| u == unit).cloned().collect();
        if !own.is_empty() {
            charts.push(chart("Tilts (ISO 230-3)", &format!("tilt ({unit})"), series(own)));
        }
    }
    if !degc.is_empty() {
        charts.push(chart("Temperatures", "temperature (°C)", degc));
    }
    charts
}
