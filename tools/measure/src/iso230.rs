//! Evaluations of the ISO 230 series: positioning (230-2), thermal drift (230-3).

use crate::plot::{Chart, Series, Style};
use rtec_files::InputError;
use rtec_model::record::{Axis, Kind, Record, Role};
use serde::Serialize;
use std::collections::BTreeMap;

/// One target of a positioning run. Values in µm unless named otherwise.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Target {
    /// Target position, mm.
    pub position_mm: f64,
    /// Mean deviation approaching upwards, x̄↑.
    pub mean_up: Option<f64>,
    /// Mean deviation approaching downwards, x̄↓.
    pub mean_down: Option<f64>,
    /// Estimator of the standard uncertainty of positioning upwards, s↑.
    pub s_up: Option<f64>,
    /// Estimator of the standard uncertainty of positioning downwards, s↓.
    pub s_down: Option<f64>,
    /// Reversal value Bᵢ = x̄↑ − x̄↓.
    #[serde(rename = "B")]
    pub reversal: Option<f64>,
    /// Bidirectional repeatability of positioning at this target, Rᵢ.
    #[serde(rename = "R")]
    pub repeatability: Option<f64>,
    /// Approaches upwards and downwards.
    pub approaches: [usize; 2],
}

/// Accuracy and repeatability of positioning, ISO 230-2:2014. Values in µm; `None` where the run has only one
/// direction.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[allow(non_snake_case)]
#[allow(missing_docs)] // the standard's own symbols
pub struct Positioning {
    pub axis: String,
    pub A: Option<f64>,
    pub A_up: Option<f64>,
    pub A_down: Option<f64>,
    pub E: Option<f64>,
    pub E_up: Option<f64>,
    pub E_down: Option<f64>,
    pub R: Option<f64>,
    pub R_up: Option<f64>,
    pub R_down: Option<f64>,
    pub B: Option<f64>,
    pub B_mean: Option<f64>,
    pub M: Option<f64>,
    pub targets: Vec<Target>,
    pub warnings: Vec<String>,
}

/// Rows of equal target, in order of position.
fn targets(position: &[f64]) -> Vec<Vec<usize>> {
    let mut order: Vec<usize> = (0..position.len()).collect();
    order.sort_by(|a, b| position[*a].total_cmp(&position[*b]));
    let span = position[order[order.len() - 1]] - position[order[0]];
    // A position that is read instead of commanded scatters by far less than a ten-thousandth of the travel.
    let gap = span * 1e-4;
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for row in order {
        match groups.last_mut() {
            Some(g) if position[row] - position[g[g.len() - 1]] <= gap => g.push(row),
            _ => groups.push(vec![row]),
        }
    }
    for g in &mut groups {
        g.sort_unstable();
    }
    groups
}

fn mean_and_s(values: &[f64]) -> Option<(f64, f64)> {
    let n = values.len() as f64;
    if values.len() < 2 {
        return None;
    }
    let mean = values.iter().sum::<f64>() / n;
    let s = (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
    Some((mean, s))
}

fn range(values: impl IntoIterator<Item = (f64, f64)>) -> Option<f64> {
    let (mut lo, mut hi) = (f64::INFINITY, f64::NEG_INFINITY);
    for (l, h) in values {
        lo = lo.min(l);
        hi = hi.max(h);
    }
    (hi >= lo).then_some(hi - lo)
}

fn largest(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    values.into_iter().reduce(f64::max)
}

/// The errors of a record with their axes, for evaluations that take one axis at a time.
pub(crate) fn error_axes(record: &Record) -> Vec<(&Axis, &[f64])> {
    let of = |c: &'_ rtec_model::record::Column| matches!(c.role, Role::Error(_));
    let errors = record.columns.iter().filter(|c| of(c));
    errors.filter_map(|c| Some((c.role.axis()?, c.data.as_slice()))).collect()
}

pub(crate) fn lacks(record: &Record, found: &str, expected: &str) -> InputError {
    InputError::whole(&record.path, found, expected)
}

/// Evaluates a positioning run, axis by axis.
///
/// # Errors
/// No axis with error, position and direction of approach, or no target with two approaches from one side.
pub fn positioning(record: &Record) -> Result<Vec<Positioning>, InputError> {
    let mut found = Vec::new();
    for (axis, error) in error_axes(record) {
        let Some(position) = record.data(&Role::Position(axis.clone())) else { continue };
        let direction = record
            .data(&Role::Direction(axis.clone()))
            .or_else(|| record.data(&Role::Velocity(axis.clone())))
            .ok_or_else(|| lacks(record, "no direction of approach", "a column of role direction.AXIS"))?;
        found.push(evaluate_axis(axis, error, position, direction));
    }
    if found.is_empty() {
        return Err(lacks(
            record,
            "no axis with both error and position",
            "columns error.AXIS and position.AXIS",
        ));
    }
    if found.iter().all(|p| p.A_up.is_none() && p.A_down.is_none()) {
        return Err(lacks(record, "no target approached twice from one side", "at least two cycles"));
    }
    Ok(found)
}

fn evaluate_axis(axis: &Axis, error: &[f64], position: &[f64], direction: &[f64]) -> Positioning {
    let mut list = Vec::new();
    for rows in targets(position) {
        let side = |up: bool| -> Vec<f64> {
            let on_side = |r: &&usize| if up { direction[**r] > 0.0 } else { direction[**r] < 0.0 };
            rows.iter().filter(on_side).map(|r| error[*r]).collect()
        };
        let (up, down) = (side(true), side(false));
        let (u, d) = (mean_and_s(&up), mean_and_s(&down));
        let reversal = u.zip(d).map(|(u, d)| u.0 - d.0);
        let repeatability = u
            .zip(d)
            .map(|((mu, su), (md, sd))| (2.0 * su + 2.0 * sd + (mu - md).abs()).max(4.0 * su).max(4.0 * sd));
        list.push(Target {
            position_mm: rows.iter().map(|r| position[*r]).sum::<f64>() / rows.len() as f64,
            mean_up: u.map(|v| v.0),
            mean_down: d.map(|v| v.0),
            s_up: u.map(|v| v.1),
            s_down: d.map(|v| v.1),
            reversal,
            repeatability,
            approaches: [up.len(), down.len()],
        });
    }
    let ups: Vec<(f64, f64)> = list.iter().filter_map(|t| t.mean_up.zip(t.s_up)).collect();
    let downs: Vec<(f64, f64)> = list.iter().filter_map(|t| t.mean_down.zip(t.s_down)).collect();
    let spread = |v: &[(f64, f64)]| range(v.iter().map(|(m, s)| (m - 2.0 * s, m + 2.0 * s)));
    let means = |v: &[(f64, f64)]| range(v.iter().map(|(m, _)| (*m, *m)));
    let both: Vec<(f64, f64)> = ups.iter().chain(&downs).copied().collect();
    let bidirectional = !ups.is_empty() && !downs.is_empty();
    let reversals: Vec<f64> = list.iter().filter_map(|t| t.reversal).collect();
    let only = |v: Option<f64>| v.filter(|_| bidirectional);
    let mut warnings = Vec::new();
    let few = list.iter().filter(|t| t.approaches.iter().any(|n| *n > 0 && *n < 5)).count();
    if few > 0 {
        warnings.push(format!("{few} targets with fewer than the five approaches ISO 230-2 asks for"));
    }
    let mut centres = list.iter().filter_map(|t| Some(f64::midpoint(t.mean_up?, t.mean_down?)));
    Positioning {
        axis: axis.to_string(),
        A: only(spread(&both)),
        A_up: spread(&ups),
        A_down: spread(&downs),
        E: only(means(&both)),
        E_up: means(&ups),
        E_down: means(&downs),
        R: largest(list.iter().filter_map(|t| t.repeatability)),
        R_up: largest(ups.iter().map(|(_, s)| 4.0 * s)),
        R_down: largest(downs.iter().map(|(_, s)| 4.0 * s)),
        B: largest(reversals.iter().map(|b| b.abs())),
        B_mean: (!reversals.is_empty()).then(|| reversals.iter().sum::<f64>() / reversals.len() as f64),
        M: only(range(centres.by_ref().map(|c| (c, c)))),
        targets: list,
        warnings,
    }
}

impl Positioning {
    /// The standard's diagram: mean deviations with ±2s, both directions.
    #[must_use]
    pub fn chart(&self) -> Chart {
        let title = format!("Positioning of axis {} (ISO 230-2)", self.axis);
        let mut chart = Chart::new(&title, "position (mm)", "deviation (µm)");
        let of =
            |mean: fn(&Target) -> Option<f64>, s: fn(&Target) -> Option<f64>, k: f64| -> Vec<(f64, f64)> {
                self.targets.iter().filter_map(|t| Some((t.position_mm, mean(t)? + k * s(t)?))).collect()
            };
        let up = |k| of(|t| t.mean_up, |t| t.s_up, k);
        let down = |k| of(|t| t.mean_down, |t| t.s_down, k);
        for (label, points) in [("mean, up", up(0.0)), ("mean, down", down(0.0))] {
            chart = chart.with(Series::new(label, Style::Line, points));
        }
        for (label, lo, hi) in [("up ± 2s", up(-2.0), up(2.0)), ("down ± 2s", down(-2.0), down(2.0))] {
            if !lo.is_empty() {
                chart = chart.with(Series::new(label, Style::Band, [lo, hi].concat()));
            }
        }
        chart
    }
}

/// Thermal drift of one response, ISO 230-3. Ranges in µm.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Drift {
    /// The response, as `error.z`.
    pub response: String,
    /// Range of displacement within the first 60 minutes, d₆₀.
    pub d_60: f64,
    /// Range of displacement over the whole test, `d_t`.
    pub d_t: f64,
    /// Range within the last 60 minutes: how steady the end is.
    pub d_last_60: f64,
    /// Displacement at the end against the start (means of the first and last hundredth of the rows).
    pub end: f64,
    /// Largest rate over any 60 minutes, µm/h.
    pub max_rate_per_h: f64,
    /// Duration of the test, min.
    pub t_min: f64,
    /// Per sensor: temperature range, K, and correlation with the displacement.
    pub temperatures: BTreeMap<String, SensorDrift>,
}

/// A sensor during a drift test.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SensorDrift {
    /// Highest minus lowest temperature of the test, K.
    #[serde(rename = "range_K")]
    pub range_k: f64,
    /// Correlation with the displacement.
    pub gamma: f64,
}

/// Correlation coefficient; zero where one of the two does not vary.
#[must_use]
pub fn correlation(x: &[f64], y: &[f64]) -> f64 {
    let n = x.len() as f64;
    let (mx, my) = (x.iter().sum::<f64>() / n, y.iter().sum::<f64>() / n);
    let (mut xx, mut yy, mut xy) = (0.0, 0.0, 0.0);
    for (a, b) in x.iter().zip(y) {
        let (a, b) = (a - mx, b - my);
        xx += a * a;
        yy += b * b;
        xy += a * b;
    }
    if xx > 0.0 && yy > 0.0 { xy / (xx * yy).sqrt() } else { 0.0 }
}

/// Evaluates a drift run (environmental temperature variation, spindle or linear motion), response by response.
///
/// # Errors
/// The record has no time or no error response.
pub fn drift(record: &Record) -> Result<Vec<Drift>, InputError> {
    let t = record
        .data(&Role::Time)
        .ok_or_else(|| lacks(record, "no time", "a column of role time: drift is an error over time"))?;
    let (first, last) = (t[0], t[t.len() - 1]);
    let of = |e: &[f64], from: f64, to: f64| {
        range(t.iter().zip(e).filter(|(t, _)| **t >= from && **t <= to).map(|(_, e)| (*e, *e))).unwrap_or(0.0)
    };
    let temperatures = |e: &[f64]| {
        let columns = record.columns.iter().filter(|c| c.role == Role::Temperature);
        let drift = |data: &[f64]| SensorDrift {
            range_k: range(data.iter().map(|v| (*v, *v))).unwrap_or(0.0),
            gamma: correlation(data, e),
        };
        columns.map(|c| (c.name.clone(), drift(&c.data))).collect()
    };
    let found: Vec<Drift> = error_axes(record)
        .into_iter()
        .map(|(axis, e)| {
            let few = (e.len() / 100).max(1);
            let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
            // Rate over an hour (or the whole run where it is shorter), window sliding with the rows.
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
            Drift {
                response: format!("error.{axis}"),
                d_60: of(e, first, first + 3600.0),
                d_t: of(e, first, last),
                d_last_60: of(e, last - 3600.0, last),
                end: mean(&e[e.len() - few..]) - mean(&e[..few]),
                max_rate_per_h: rate,
                t_min: (last - first) / 60.0,
                temperatures: temperatures(e),
            }
        })
        .collect();
    if found.is_empty() {
        return Err(lacks(record, "no error response", "a column of role error.AXIS"));
    }
    Ok(found)
}

/// Displacements and temperatures over time.
#[must_use]
pub fn drift_charts(record: &Record) -> Vec<Chart> {
    let minutes: Vec<f64> = record.time_s().iter().map(|t| t / 60.0).collect();
    let line = |name: &str, data: &[f64]| {
        Series::new(name, Style::Line, minutes.iter().copied().zip(data.iter().copied()).collect())
    };
    let mut errors = Chart::new("Thermal drift (ISO 230-3)", "time (min)", "displacement (µm)");
    for (axis, e) in error_axes(record) {
        errors = errors.with(line(&format!("error.{axis}"), e));
    }
    let mut temperatures = Chart::new("Temperatures", "time (min)", "temperature (°C)");
    for c in record.columns.iter().filter(|c| c.role == Role::Temperature) {
        temperatures = temperatures.with(line(&c.name, &c.data));
    }
    if temperatures.series.is_empty() { vec![errors] } else { vec![errors, temperatures] }
}

/// Repeatability of returning to one position (tool changes, reference marks), from the record's first error per
/// axis: standard deviation and range, µm.
#[must_use]
pub fn repeatability(record: &Record) -> BTreeMap<String, [f64; 2]> {
    let of = |(axis, e): (&Axis, &[f64])| {
        let (_, s) = mean_and_s(e)?;
        Some((axis.to_string(), [s, range(e.iter().map(|v| (*v, *v)))?]))
    };
    error_axes(record).into_iter().filter_map(of).collect()
}

/// The evaluation that fits a record's kind.
#[must_use]
pub fn standard_for(kind: Kind) -> Option<&'static str> {
    match kind {
        Kind::Positioning => Some("iso230-2"),
        Kind::Drift => Some("iso230-3"),
        Kind::Ballbar => Some("ballbar"),
        _ => None,
    }
}
