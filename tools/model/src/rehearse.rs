//! A recorded shift replayed against a new model: what would change before it is loaded.

use crate::effect::sign;
use crate::live::{AxisNow, Frame, Layout, Live};
use crate::machine::Machine;
use crate::plot::{Chart, Series, Style};
use crate::record::{Axis, Record, Role};
use rtec_files::InputError;
use serde::Serialize;
use std::collections::BTreeMap;

/// What changes on one axis. Corrections are the negative of the predicted errors.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AxisChange {
    /// The axis.
    pub axis: String,
    /// Largest correction of the present model and of the new one, µm.
    pub largest_um: [f64; 2],
    /// Largest change from one to the other, µm, and when, s.
    pub change_um: f64,
    /// When.
    pub change_at_s: f64,
    /// Root of the mean squared change, µm.
    pub change_rms_um: f64,
    /// Fastest the new correction moves from row to row, µm/s.
    pub fastest_um_per_s: f64,
    /// Corrections at every row: time, present, new.
    #[serde(skip)]
    pub rows: Vec<[f64; 3]>,
}

/// What a rehearsal found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Rehearsal {
    /// Per axis.
    pub axes: Vec<AxisChange>,
    /// Share of the rows on which an effect of the new model was outside its range, by effect.
    pub outside: BTreeMap<String, f64>,
}

/// The layout that a record can fill: its axes, sensors and channels.
#[must_use]
pub fn layout_of(record: &Record) -> Layout {
    let mut axes: Vec<Axis> = Vec::new();
    for axis in record.columns.iter().filter_map(|c| c.role.axis()) {
        if !axes.contains(axis) {
            axes.push(axis.clone());
        }
    }
    let names = |role: &Role| record.names(role).map(str::to_owned).collect();
    Layout { axes, sensors: names(&Role::Temperature), channels: names(&Role::Channel) }
}

/// Calls `each` with every row of a record as a frame of [`layout_of`] it.
pub fn frames(record: &Record, layout: &Layout, mut each: impl FnMut(usize, &Frame<'_>)) {
    let mut axes = vec![AxisNow::default(); layout.axes.len()];
    let mut temperatures = vec![0.0; layout.sensors.len()];
    let mut channels = vec![0.0; layout.channels.len()];
    for row in 0..record.rows() {
        let at = |role: &Role| record.data(role).map(|d| d[row]);
        for (now, axis) in axes.iter_mut().zip(&layout.axes) {
            let of = |role: fn(Axis) -> Role| at(&role(axis.clone()));
            let velocity_mm_s = of(Role::Velocity).unwrap_or(0.0);
            *now = AxisNow {
                position_mm: of(Role::Position).unwrap_or(0.0),
                velocity_mm_s,
                acceleration_mm_s2: of(Role::Acceleration).unwrap_or(0.0),
                direction: of(Role::Direction).unwrap_or(sign(velocity_mm_s)),
                load_n: of(Role::Load).unwrap_or(0.0),
            };
        }
        for (t, name) in temperatures.iter_mut().zip(&layout.sensors) {
            *t = record.temperature(name).map_or(0.0, |d| d[row]);
        }
        for (c, name) in channels.iter_mut().zip(&layout.channels) {
            *c = record.channel(name).map_or(0.0, |d| d[row]);
        }
        let frame = Frame {
            t_s: record.time_s()[row],
            axes: &axes,
            temperatures_degc: &temperatures,
            channels: &channels,
            rpm: at(&Role::SpindleSpeed).unwrap_or(0.0),
            coolant: at(&Role::Coolant).unwrap_or(0.0),
            angle_rad: at(&Role::Angle).unwrap_or(0.0),
            probing: record.kind == crate::record::Kind::Probing,
            held: &[],
        };
        each(row, &frame);
    }
}

/// Replays a shift against the present model and a new one.
///
/// # Errors
/// A sensor or channel that the shift does not have.
pub fn rehearse(present: &Machine, new: &Machine, shift: &Record) -> Result<Rehearsal, InputError> {
    let layout = layout_of(shift);
    let live = |m: &Machine| {
        Live::of(m, layout.clone()).map_err(|e| {
            InputError::whole(&shift.path, e.to_string(), "every sensor and channel that the model reads")
        })
    };
    let (mut before, mut after) = (live(present)?, live(new)?);
    let mut rows: Vec<Vec<[f64; 3]>> = vec![Vec::with_capacity(shift.rows()); layout.axes.len()];
    let mut outside: BTreeMap<String, f64> = BTreeMap::new();
    frames(shift, &layout, |_, frame| {
        before.evaluate(frame);
        after.evaluate(frame);
        for (a, rows) in rows.iter_mut().enumerate() {
            rows.push([frame.t_s, -before.errors_um()[a], -after.errors_um()[a]]);
        }
        for part in after.parts().filter(|p| p.outside_k > 0.0) {
            *outside.entry(part.effect.identity()).or_default() += 1.0 / shift.rows() as f64;
        }
    });
    let axes = layout.axes.iter().zip(rows).map(|(axis, rows)| {
        let largest = |k: usize| rows.iter().map(|r| r[k].abs()).fold(0.0, f64::max);
        let worst = rows.iter().max_by(|a, b| (a[2] - a[1]).abs().total_cmp(&(b[2] - b[1]).abs()));
        let squares: f64 = rows.iter().map(|r| (r[2] - r[1]).powi(2)).sum();
        let speeds = rows.windows(2).filter(|w| w[1][0] > w[0][0]);
        AxisChange {
            axis: axis.to_string(),
            largest_um: [largest(1), largest(2)],
            change_um: worst.map_or(0.0, |r| r[2] - r[1]),
            change_at_s: worst.map_or(0.0, |r| r[0]),
            change_rms_um: (squares / rows.len().max(1) as f64).sqrt(),
            fastest_um_per_s: speeds
                .map(|w| ((w[1][2] - w[0][2]) / (w[1][0] - w[0][0])).abs())
                .fold(0.0, f64::max),
            rows,
        }
    });
    Ok(Rehearsal { axes: axes.collect(), outside })
}

impl AxisChange {
    /// Both corrections over time.
    #[must_use]
    pub fn chart(&self) -> Chart {
        let line = |name: &str, k: usize| {
            Series::new(name, Style::Line, self.rows.iter().map(|r| (r[0] / 60.0, r[k])).collect())
        };
        Chart::new(&format!("Correction of axis {}", self.axis), "time (min)", "correction (µm)")
            .with(line("present model", 1))
            .with(line("new model", 2))
    }
}
