//! Runs a recorded shift through the law with the present and with a new model.
//! It shows, count by count, what would change before the new model is loaded.
//!
//! Positions, temperatures and loads are those of the shift. The engine inserts at once. Between two rows
//! every value is linear in time, so that ramp, window and lags see the time pass.

use crate::{AxisCorrectionSettings, Corrector};
use rtec_files::InputError;
use rtec_model::effect::Effect;
use rtec_model::machine::Machine;
use rtec_model::record::{Axis, Record, Role};
use rtec_rt::link_messages::{CorrectorMode, CorrectorStatus, MAX_AXES};
use rtec_sensors::{SensorConfig, SensorMonitor};
use serde::Serialize;
use std::collections::BTreeMap;

/// Time between two calls of the law, s.
/// At most [`MOST_TICKS`] calls are made between two rows, which may be minutes apart.
const PERIOD_S: f64 = 0.01;
/// Largest number of ticks between two rows; see [`PERIOD_S`].
const MOST_TICKS: f64 = 20.0;

/// Settings of the law that the shift does not state.
#[derive(Debug, Clone, PartialEq)]
pub struct RehearsalOptions {
    /// The axes of the configuration.
    /// Any other axis has Design C, a window of 12 µm, and the shift's count or 1 µm.
    pub axes: Vec<AxisCorrectionSettings>,
    /// The ramp's rate, µm/s (see [`Corrector::new`]).
    pub ramp_um_s: f64,
    /// Lead of the model, s (see [`Corrector::new`]).
    pub lead_s: f64,
}

impl Default for RehearsalOptions {
    fn default() -> Self {
        Self { axes: Vec::new(), ramp_um_s: crate::RAMP_UM_S, lead_s: 0.0 }
    }
}

impl RehearsalOptions {
    /// An axis without a configuration: Design C, a window of 12 µm.
    /// Its count is that of the shift, or 1 µm.
    fn axis(&self, name: &str, count_um: Option<f64>) -> AxisCorrectionSettings {
        let known = self.axes.iter().find(|a| a.name == name).cloned();
        let count_um = count_um.unwrap_or(1.0);
        known.unwrap_or_else(|| AxisCorrectionSettings {
            name: name.to_owned(),
            count_um,
            increment_counts: 2,
            window_counts: crate::belief_window_counts(count_um, 0.0),
            max_counts: 1_000_000,
        })
    }
}

/// Changes on one axis. A positive total removes a positive error.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AxisCorrectionChange {
    /// Name of the axis.
    pub axis: String,
    /// Size of one count, µm.
    pub count_um: f64,
    /// Largest correction of the present model and of the new one, µm.
    pub largest_um: [f64; 2],
    /// Largest change from one to the other, µm.
    pub change_um: f64,
    /// Time of the largest change, s on the shift's clock.
    pub change_at_s: f64,
    /// Root of the mean squared change, µm.
    pub change_rms_um: f64,
    /// Highest rate of the new correction from row to row, µm/s.
    pub fastest_um_per_s: f64,
    /// Share of the rows on which the axis would not follow the new model.
    /// Then a sensor is bad or a lag is not known yet.
    pub held: f64,
    /// Totals at every row, counts: time, s, present, new.
    #[serde(skip)]
    pub rows: Vec<(f64, [i64; 2])>,
}

/// Result of a rehearsal.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RehearsalResult {
    /// One entry per axis of the shift.
    pub axes: Vec<AxisCorrectionChange>,
    /// Share of the rows on which an effect of the new model was outside its range.
    pub outside: BTreeMap<String, f64>,
}

/// One column of the shift, and the sensor that takes its values.
struct SensorColumn<'r> {
    data: &'r [f64],
    watch: usize,
}

/// The law with one model, and the machine's state that it sees.
struct RehearsedCorrector<'r> {
    corrector: Corrector,
    status: CorrectorStatus,
    watches: Vec<SensorMonitor>,
    feeds: &'r [SensorColumn<'r>],
}

impl RehearsedCorrector<'_> {
    /// One tick with the present sensors and positions; totals complete at once.
    fn tick(&mut self, t_s: f64, t_ns: u64, position_counts: &[i64], reading: impl Fn(&[f64]) -> f64) {
        for feed in self.feeds {
            self.watches[feed.watch].offer(t_s, Ok(reading(feed.data)));
        }
        self.status.t_ns = t_ns;
        for (axis, counts) in self.status.axes.iter_mut().zip(position_counts) {
            axis.position_counts = *counts;
        }
        let totals = self.corrector.tick(t_s, &self.status, &self.watches);
        for (axis, total) in self.status.axes.iter_mut().zip(totals) {
            let total = total.unwrap_or(axis.requested);
            (axis.requested, axis.completed, axis.in_effect) = (total, total, total);
        }
    }
}

/// The axes of a shift and of the effects that act on it.
fn axes_of(shift: &Record, models: [&Machine; 2]) -> Vec<Axis> {
    let mut axes: Vec<Axis> = Vec::new();
    let of_effects = models.into_iter().flat_map(Machine::effects).flat_map(Effect::axes);
    for axis in shift.columns.iter().filter_map(|c| c.role.axis()).chain(of_effects) {
        if !axes.contains(axis) {
            axes.push(axis.clone());
        }
    }
    axes
}

/// Runs a shift through the law with the present model and with a new one.
///
/// # Errors
/// A sensor or channel that the shift does not have; more axes than the engine holds.
pub fn rehearse(
    present: &Machine,
    new: &Machine,
    shift: &Record,
    options: &RehearsalOptions,
) -> Result<RehearsalResult, InputError> {
    let axes = axes_of(shift, [present, new]);
    if axes.len() > MAX_AXES {
        let found = format!("{} axes in the shift and the models", axes.len());
        return Err(InputError::whole(&shift.path, found, format!("at most {MAX_AXES}")));
    }
    let setups: Vec<AxisCorrectionSettings> =
        axes.iter().map(|a| options.axis(a.as_str(), shift.count_um)).collect();
    let sensed = |role: &Role| {
        matches!(role, Role::Temperature | Role::Channel | Role::SpindleSpeed | Role::Coolant | Role::Load(_))
    };
    let columns: Vec<_> = shift.columns.iter().filter(|c| sensed(&c.role)).collect();
    let feeds: Vec<SensorColumn<'_>> =
        columns.iter().enumerate().map(|(watch, c)| SensorColumn { data: &c.data, watch }).collect();
    let stage = |machine: &Machine| {
        let watches: Vec<SensorMonitor> = columns
            .iter()
            .map(|c| SensorMonitor::new(SensorConfig::believed(&c.name, c.role.clone())))
            .collect();
        let mut corrector = Corrector::new(setups.clone(), options.ramp_um_s, options.lead_s, 0.0);
        corrector.sense(0.0, &watches);
        corrector.load(machine.clone(), &|_| Vec::new()).map_err(|e| {
            InputError::whole(&shift.path, e.found, "every sensor and channel that the model reads")
        })?;
        let mut status = CorrectorStatus {
            mode: CorrectorMode::Run,
            axes_used: setups.len() as u8,
            ..CorrectorStatus::default()
        };
        status.axes.iter_mut().for_each(|a| a.homed = true);
        Ok(RehearsedCorrector { corrector, status, watches, feeds: &feeds })
    };
    let mut stages = [stage(present)?, stage(new)?];
    let mut changes = TotalsByRow::new(setups);
    run(shift, &axes, &mut stages, &mut changes);
    Ok(changes.judge(shift.rows()))
}

/// Calls the law at each row and between rows.
fn run(shift: &Record, axes: &[Axis], stages: &mut [RehearsedCorrector<'_>; 2], changes: &mut TotalsByRow) {
    let t = shift.time_s();
    let places: Vec<Option<&[f64]>> = axes.iter().map(|a| shift.data(&Role::Position(a.clone()))).collect();
    for row in 0..shift.rows() {
        let before = row.saturating_sub(1);
        let gap_s = t[row] - t[before];
        // A gap of one period gives one tick, despite rounding of its decimals.
        let ticks = (gap_s / PERIOD_S - 1e-6).ceil().clamp(1.0, MOST_TICKS);
        for k in 1..=ticks as u32 {
            let part = f64::from(k) / ticks;
            let reading = |data: &[f64]| data[before] + (data[row] - data[before]) * part;
            let t_s = reading(t);
            let counts: Vec<i64> = places
                .iter()
                .zip(&changes.setups)
                .map(|(p, s)| (p.map_or(0.0, reading) * 1000.0 / s.count_um).round() as i64)
                .collect();
            // The card's clock runs from the shift's first row.
            let t_ns = ((t_s - t[0]) * 1e9) as u64;
            for stage in &mut *stages {
                stage.tick(t_s, t_ns, &counts, reading);
            }
        }
        changes.take(t[row], stages);
    }
}

/// Totals collected row by row.
struct TotalsByRow {
    setups: Vec<AxisCorrectionSettings>,
    totals: Vec<Vec<(f64, [i64; 2])>>,
    held: Vec<usize>,
    outside: BTreeMap<String, usize>,
}

impl TotalsByRow {
    fn new(setups: Vec<AxisCorrectionSettings>) -> Self {
        let axes = setups.len();
        Self { setups, totals: vec![Vec::new(); axes], held: vec![0; axes], outside: BTreeMap::new() }
    }

    fn take(&mut self, t_s: f64, [present, new]: &mut [RehearsedCorrector<'_>; 2]) {
        for (n, rows) in self.totals.iter_mut().enumerate() {
            rows.push((t_s, [present.status.axes[n].requested, new.status.axes[n].requested]));
            self.held[n] += usize::from(new.corrector.holds(n).is_some());
        }
        for effect in new.corrector.outside() {
            *self.outside.entry(effect).or_default() += 1;
        }
    }

    fn judge(self, all: usize) -> RehearsalResult {
        let share = |n: usize| n as f64 / all.max(1) as f64;
        let axes = self.setups.into_iter().zip(self.totals).zip(self.held);
        let axes = axes.map(|((setup, rows), held)| {
            let um = |counts: i64| counts as f64 * setup.count_um;
            let change = |r: &(f64, [i64; 2])| um(r.1[1] - r.1[0]);
            let largest = |k: usize| rows.iter().map(|r| um(r.1[k]).abs()).fold(0.0, f64::max);
            let worst = rows.iter().max_by(|a, b| change(a).abs().total_cmp(&change(b).abs()));
            let squares: f64 = rows.iter().map(|r| change(r).powi(2)).sum();
            let speeds = rows.windows(2).filter(|w| w[1].0 > w[0].0);
            AxisCorrectionChange {
                largest_um: [largest(0), largest(1)],
                change_um: worst.map_or(0.0, change),
                change_at_s: worst.map_or(0.0, |r| r.0),
                change_rms_um: (squares / all.max(1) as f64).sqrt(),
                fastest_um_per_s: speeds
                    .map(|w| (um(w[1].1[1] - w[0].1[1]) / (w[1].0 - w[0].0)).abs())
                    .fold(0.0, f64::max),
                held: share(held),
                axis: setup.name,
                count_um: setup.count_um,
                rows,
            }
        });
        RehearsalResult {
            axes: axes.collect(),
            outside: self.outside.into_iter().map(|(effect, n)| (effect, share(n))).collect(),
        }
    }
}
