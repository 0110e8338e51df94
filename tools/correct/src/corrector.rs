//! All axes: requested = model + part table + operator.
//! Called every 10 to 20 ms (NISTIR 4832, Alternate Configurations).

use crate::AxisCorrectionSettings;
use crate::axis_motion::AxisMotionTracker;
use crate::correction_total::{AxisCorrectionTotal, TotalTickInputs};
use crate::explain::{
    AxisCorrectionComponents, AxisTotalChange, CorrectionComponent, ModelChangePreview, RunningModelReport,
    SensorStateReport,
};
use crate::model_evaluator::{ModelEvaluator, acts};
use crate::part_table::{LoadedPartTable, NEAR_MM, PartTable, PartTableState};
use rtec_files::InputError;
use rtec_files::date;
use rtec_model::effect::TemperatureDifference;
use rtec_model::live_evaluation::AxisMotionState;
use rtec_model::machine::{FitNote, Machine};
use rtec_model::record::Axis;
use rtec_part::error_cor_file::FeatureErrors;
use rtec_part::geometric_fit::Zx;
use rtec_rt::link_messages::{AxisStatus, CorrectorMode, CorrectorStatus, MAX_AXES};
use rtec_sensors::SensorMonitor;
use std::time::{Duration, Instant};

/// Logged temperatures of these sensors, oldest first: time, s, and °C.
/// The states of lags are computed from them.
pub type Past<'p> = &'p dyn Fn(&[String]) -> Vec<(f64, Vec<f64>)>;

/// Longest time by which the ramp advances in one call, however late, s.
const LONGEST_S: f64 = 1.0;

/// The corrector's state of one axis.
#[derive(Debug, Default)]
struct AxisCorrection {
    /// Its index in the model's layout; none if a model cannot name the axis.
    place: Option<usize>,
    /// Whole error by the model, µm.
    model_um: f64,
    /// Part of the model's error that depends on sensors and time, µm.
    slow_um: f64,
    /// Part of the model's error that depends on the direction, µm.
    turning_um: f64,
    table_um: f64,
    total: AxisCorrectionTotal,
    /// Reason why the total is held, and why its thermal part is.
    hold_reason: Option<String>,
    thermal_hold_reason: Option<String>,
}

/// The control law: it computes the total that each axis should have now.
#[derive(Debug)]
pub struct Corrector {
    setups: Vec<AxisCorrectionSettings>,
    axes: Vec<AxisCorrection>,
    model: Option<ModelEvaluator>,
    table: Option<LoadedPartTable>,
    ramp_um_s: f64,
    lead_s: f64,
    last_s: f64,
    motion: AxisMotionTracker,
    /// What models see.
    seen: ModelPreparer,
    /// A source has changed, so that the total approaches its new value in a ramp.
    changed: bool,
    /// Today, in days since 1970-01-01.
    today: i64,
}

/// Prepares models for a machine.
/// It can be sent to another thread while the corrector works on.
#[derive(Debug, Clone)]
pub struct ModelPreparer {
    /// Axes that a model can name, in the order of its layout.
    layout_axes: Vec<Axis>,
    /// Motion at the last tick, per axis of the layout.
    now: Vec<AxisMotionState>,
    started_s: f64,
    /// The sensors as last read, and the time of that, s.
    watches: Vec<SensorMonitor>,
    sensed_s: f64,
}

/// A model that is ready to run.
#[derive(Debug)]
pub struct PreparedModel(ModelEvaluator);

impl ModelPreparer {
    /// Prepares a model and computes its lags from past temperatures.
    ///
    /// # Errors
    /// The model reads something that this machine does not have.
    pub fn prepare(&self, machine: Machine, past: Past<'_>) -> Result<PreparedModel, InputError> {
        let mut source = ModelEvaluator::new(machine, &self.layout_axes, &self.watches)?;
        let rows = past(&source.live.layout().sensors);
        source.catch_up(rows, self.started_s, &self.now);
        Ok(PreparedModel(source))
    }

    /// Time at which its sensors were read, s on the corrector's clock.
    pub fn sensed_s(&self) -> f64 {
        self.sensed_s
    }
}

impl PreparedModel {
    /// The model.
    pub fn machine(&self) -> &Machine {
        &self.0.machine
    }

    /// Parts of the model without effect here, in sentences.
    /// They read axes or sensors that the configuration lacks.
    pub fn missing(&self) -> &[String] {
        self.0.missing()
    }

    /// Time of one evaluation on this computer, the best of three.
    /// The model's state does not change.
    pub fn evaluation_time(&self, preparer: &ModelPreparer) -> Duration {
        let mut shortest = Duration::MAX;
        for _ in 0..3 {
            let mut trial = self.0.trial();
            let begun = Instant::now();
            trial(preparer.sensed_s - preparer.started_s, &preparer.now);
            shortest = shortest.min(begun.elapsed());
        }
        shortest
    }
}

impl Corrector {
    /// A corrector without sources.
    /// `ramp_um_s`: the rate at which a total approaches a new value that no motion asks for. `lead_s`: how long the
    /// model is evaluated ahead of the axes' motion. `now_s`: the time, s, on the clock of every later call.
    pub fn new(setups: Vec<AxisCorrectionSettings>, ramp_um_s: f64, lead_s: f64, now_s: f64) -> Self {
        let mut layout_axes = Vec::new();
        let mut axes = Vec::new();
        for s in &setups {
            let place = Axis::new(&s.name).map(|a| {
                layout_axes.push(a);
                layout_axes.len() - 1
            });
            axes.push(AxisCorrection {
                place,
                total: AxisCorrectionTotal::new(
                    s.count_um,
                    s.increment_counts,
                    s.window_counts,
                    s.max_counts,
                ),
                ..AxisCorrection::default()
            });
        }
        Self {
            motion: AxisMotionTracker::new(setups.len()),
            seen: ModelPreparer {
                now: vec![AxisMotionState::default(); layout_axes.len()],
                layout_axes,
                started_s: now_s,
                watches: Vec::new(),
                sensed_s: now_s,
            },
            setups,
            axes,
            model: None,
            table: None,
            ramp_um_s,
            lead_s,
            last_s: now_s,
            changed: false,
            today: date::today(),
        }
    }

    /// Sets the date; returns, once, the fits whose validity ends with this day.
    pub fn day_is(&mut self, today: i64) -> Vec<String> {
        let before = std::mem::replace(&mut self.today, today);
        let Some(model) = &self.model else { return Vec::new() };
        let known = model.machine.expired(before);
        model.machine.expired(today).into_iter().filter(|e| !known.contains(e)).collect()
    }

    /// Fits whose validity has ended without anybody having accepted that.
    pub fn expired(&self) -> Vec<String> {
        let model = self.model.as_ref().filter(|m| !m.although_expired);
        model.map_or_else(Vec::new, |m| m.machine.expired(self.today))
    }

    /// Returns what prepares a model for this machine, on any thread.
    pub fn preparer(&self) -> ModelPreparer {
        self.seen.clone()
    }

    /// Takes over the sensors as read at this time, s.
    /// Models, previews and explanations use these readings until the next ones.
    pub fn sense(&mut self, now_s: f64, watches: &[SensorMonitor]) {
        self.seen.sensed_s = now_s;
        watches.clone_into(&mut self.seen.watches);
    }

    /// The sensors as [`Corrector::sense`] last took them over.
    pub fn watches(&self) -> &[SensorMonitor] {
        &self.seen.watches
    }

    /// The sensors' state, described for people.
    pub fn readings(&self) -> Vec<SensorStateReport> {
        self.seen.watches.iter().map(|w| SensorStateReport::of(w, self.seen.sensed_s)).collect()
    }

    /// Loads a model; corrections approach it in a ramp.
    ///
    /// # Errors
    /// The model reads something that this machine does not have.
    pub fn load(&mut self, machine: Machine, past: Past<'_>) -> Result<(), InputError> {
        self.take(self.seen.prepare(machine, past)?);
        Ok(())
    }

    /// Takes a prepared model; corrections approach it in a ramp.
    pub fn take(&mut self, PreparedModel(mut source): PreparedModel) {
        source.although_expired = !source.machine.expired(self.today).is_empty();
        self.model = Some(source);
        self.changed = true;
    }

    /// Unloads the model; corrections return in a ramp.
    /// Returns whether there was one.
    pub fn unload(&mut self) -> bool {
        let was = self.model.take().is_some();
        self.changed |= was;
        for axis in &mut self.axes {
            (axis.model_um, axis.slow_um, axis.turning_um) = (0.0, 0.0, 0.0);
            (axis.hold_reason, axis.thermal_hold_reason) = (None, None);
        }
        was
    }

    /// Loads a part's errors; corrections approach them in a ramp.
    ///
    /// # Errors
    /// What was found and what was expected.
    pub fn load_table(&mut self, wanted: PartTable, errors: FeatureErrors) -> Result<(), String> {
        let named = |n: usize| self.axes[n].place.is_some();
        let table = LoadedPartTable::new(wanted, errors, &self.setups, named)?;
        self.unload_table();
        self.table = Some(table);
        self.changed = true;
        Ok(())
    }

    /// Unloads the part table; corrections return in a ramp.
    /// Returns whether there was one.
    pub fn unload_table(&mut self) -> bool {
        let Some(table) = self.table.take() else { return false };
        table.axes.into_iter().for_each(|n| self.axes[n].table_um = 0.0);
        self.changed = true;
        true
    }

    /// The part table, as it was given.
    pub fn table_shown(&self) -> Option<PartTable> {
        self.table.as_ref().map(|t| t.shown.clone())
    }

    /// Present effect of the part table.
    pub fn table_now(&self, status: &CorrectorStatus) -> Option<PartTableState> {
        let table = self.table.as_ref()?;
        let um = table.axes.map(|n| self.axes[n].table_um);
        let [z_mm, x_mm] =
            table.axes.map(|n| status.axes[n].position_counts as f64 * self.setups[n].count_um / 1000.0);
        let off_mm = table.off_mm(Zx::new(z_mm, x_mm));
        let axis = table.axes.into_iter().find_map(|n| {
            let (name, s) = (&self.setups[n].name, &status.axes[n]);
            let why = match &self.axes[n].hold_reason {
                _ if !s.homed => "is not homed",
                _ if s.faults.any() => "has a fault",
                Some(why) => why,
                None => return None,
            };
            Some(format!("axis {name}: {why}"))
        });
        let why = match status.mode {
            CorrectorMode::Run => axis,
            CorrectorMode::Shadow => Some("shadow mode: computed, not written".to_owned()),
            CorrectorMode::Probe => Some("probing: positions are taken as the scales read".to_owned()),
            CorrectorMode::Disabled | CorrectorMode::Hold | CorrectorMode::Fault => {
                Some("corrections are off".to_owned())
            }
        };
        let state = match why {
            Some(_) => "off",
            None if um.iter().all(|um| *um == 0.0) && off_mm >= NEAR_MM[1] => "ready",
            None => "in_force",
        };
        Some(PartTableState {
            points: table.points(),
            state: state.to_owned(),
            off_mm,
            acts_within_mm: NEAR_MM[1],
            um,
            why,
        })
    }

    /// Changes that a model would make now.
    pub fn preview(
        &self,
        PreparedModel(mut then): PreparedModel,
        status: &CorrectorStatus,
    ) -> ModelChangePreview {
        let (watches, now_s) = (&self.seen.watches, self.seen.sensed_s);
        then.read(watches, now_s);
        then.evaluate(now_s - self.seen.started_s, &self.seen.now, false);
        let axes = self.axes.iter().zip(&self.setups).zip(status.axes()).map(|((axis, setup), s)| {
            let model_um = axis.place.map_or(0.0, |p| then.live.errors_um()[p]);
            AxisTotalChange {
                axis: setup.name.clone(),
                now_counts: s.requested,
                now_um: s.requested as f64 * setup.count_um,
                then_counts: axis.total.unlimited(model_um + axis.table_um),
                then_um: model_um + axis.table_um + axis.total.operator().1,
                holds: axis.place.and_then(|p| then.unknown(p, watches, now_s)),
            }
        });
        let axes = axes.collect();
        let warnings = self.notes(&then);
        let machine = &then.machine;
        ModelChangePreview {
            name: machine.name().to_owned(),
            file: machine.path.display().to_string(),
            sha256: machine.sha256().to_owned(),
            fits: fits(machine),
            warnings,
            expired: machine.expired(self.today),
            axes,
        }
    }

    /// Notes that an axis has been homed: its counter is zero.
    /// So is its total, except for counts that the MTC still contains (`kept_counts`).
    pub fn homed(&mut self, n: usize, kept_counts: i64) {
        if let Some(axis) = self.axes.get_mut(n) {
            if kept_counts == 0 {
                axis.total.zero();
            } else {
                axis.total.stop_following();
            }
        }
        self.motion.forget();
    }

    /// Notes that corrections have been enabled.
    /// Lost sensors that are good again are used from now on, in a ramp.
    pub fn enabled(&mut self) {
        self.changed |= self.model.as_mut().is_some_and(ModelEvaluator::enabled);
    }

    /// Total of an axis with another operator's total, counts.
    pub fn with_operator(&self, n: usize, operator_counts: i64) -> i64 {
        self.axes[n].total.with_operator(operator_counts)
    }

    /// Notes that the engine accepted the operator's total.
    pub fn operator_is(&mut self, n: usize, operator_counts: i64) {
        self.axes[n].total.set_operator(operator_counts);
    }

    /// Total that an axis is approaching, counts.
    /// It is the requested total if no source acts on the axis.
    pub fn goal(&self, n: usize, status: &AxisStatus) -> i64 {
        let axis = &self.axes[n];
        if self.asks(n) && axis.hold_reason.is_none() {
            axis.total.goal(axis.model_um + axis.table_um)
        } else {
            status.requested
        }
    }

    /// Whether the axis has completed the total that its sources want.
    pub fn settled(&self, n: usize, status: &AxisStatus) -> bool {
        let asked = !self.asks(n) || self.axes[n].total.settled(status.requested);
        asked && self.axes[n].hold_reason.is_none() && status.completed == status.requested
    }

    /// Whether a source other than the operator acts, or a ramp is under way.
    fn asks(&self, n: usize) -> bool {
        self.model.is_some()
            || self.table.as_ref().is_some_and(|t| t.axes.contains(&n))
            || self.axes[n].total.on_its_way()
    }

    /// Takes over the sensors, and returns the totals to be requested now.
    pub fn tick(
        &mut self,
        now_s: f64,
        status: &CorrectorStatus,
        watches: &[SensorMonitor],
    ) -> [Option<i64>; MAX_AXES] {
        // After a stall the ramp continues where it was.
        let dt_s = (now_s - self.last_s).clamp(0.0, LONGEST_S);
        self.last_s = now_s;
        self.sense(now_s, watches);
        self.follow(status);
        let mut changed = std::mem::take(&mut self.changed);
        changed |= self.ask_model(status);
        self.ask_table();
        let correcting = matches!(status.mode, CorrectorMode::Run | CorrectorMode::Shadow);
        let mut totals = [None; MAX_AXES];
        for (n, s) in status.axes().iter().enumerate() {
            let asks = self.asks(n);
            let last = self.model.is_none();
            let axis = &mut self.axes[n];
            if !asks || !correcting || !s.homed || s.faults.any() {
                axis.total.stop_following();
                self.motion.total_is(n, s.requested, 0);
                continue;
            }
            totals[n] = axis.total.next(TotalTickInputs {
                um: axis.model_um - axis.slow_um + axis.table_um,
                slow_um: axis.slow_um,
                requested: s.requested,
                ramp_um: if axis.hold_reason.is_none() { self.ramp_um_s * dt_s } else { 0.0 },
                changed,
                last,
            });
            let part_counts = (axis.turning_um / self.setups[n].count_um).round() as i64;
            self.motion.total_is(n, axis.total.bounded(), part_counts);
        }
        totals
    }

    /// Updates the axes' motion, in the model's layout.
    fn follow(&mut self, status: &CorrectorStatus) {
        self.motion.follow(status, &self.setups);
        for (axis, now) in self.axes.iter().zip(self.motion.now()) {
            if let Some(p) = axis.place {
                self.seen.now[p] = *now;
            }
        }
    }

    /// Evaluates the model and stores its errors, if they are known.
    /// Returns whether its sensors have become better or worse.
    fn ask_model(&mut self, status: &CorrectorStatus) -> bool {
        let Some(model) = &mut self.model else { return false };
        let (watches, now_s) = (&self.seen.watches, self.seen.sensed_s);
        let mut changed = model.read(watches, now_s);
        model.add_loads(&mut self.seen.now, watches);
        let probing = status.mode == CorrectorMode::Probe;
        if self.lead_s > 0.0 {
            let mut ahead = self.seen.now.clone();
            let slowing_s = self.lead_s + self.motion.speed_age_s();
            for a in &mut ahead {
                a.position_mm += a.velocity_mm_s * self.lead_s;
                a.velocity_mm_s = slowed_mm_s(a, slowing_s);
            }
            model.evaluate(now_s - self.seen.started_s, &ahead, probing);
        } else {
            model.evaluate(now_s - self.seen.started_s, &self.seen.now, probing);
        }
        for axis in self.axes.iter_mut().take(status.axes().len()) {
            let Some(p) = axis.place else { continue };
            let held = axis.hold_reason.is_some();
            axis.hold_reason = model.unknown(p, watches, now_s);
            changed |= held != axis.hold_reason.is_some();
            if axis.hold_reason.is_none() {
                axis.model_um = model.live.errors_um()[p];
                axis.slow_um = model.slow_um(p);
                axis.turning_um = model.turning_um(p);
            }
            axis.thermal_hold_reason =
                model.thermal_hold_reason(p, watches, now_s).filter(|_| axis.hold_reason.is_none());
        }
        changed
    }

    fn ask_table(&mut self) {
        let Some(table) = &self.table else { return };
        let now =
            table.axes.map(|n| self.axes[n].place.map_or(AxisMotionState::default(), |p| self.seen.now[p]));
        let place = Zx::new(now[0].position_mm, now[1].position_mm);
        let out = table.components_um(place, Zx::new(now[0].velocity_mm_s, now[1].velocity_mm_s));
        (self.axes[table.axes[0]].table_um, self.axes[table.axes[1]].table_um) = (out.z, out.x);
    }

    /// The model's error of an axis at a captured position, µm.
    /// Positions are not corrected while probing. The other axes are taken where they were at that time of
    /// the card's clock. `None` if the error is not known.
    pub fn error_um_at(&self, n: usize, t_ns: u64, position_mm: f64) -> Option<f64> {
        let (Some(model), Some(place)) = (&self.model, self.axes[n].place) else { return None };
        if self.axes[n].hold_reason.is_some() {
            return None;
        }
        let mut now = self.seen.now.clone();
        for (k, (axis, setup)) in self.axes.iter().zip(&self.setups).enumerate() {
            if let (Some(p), Some(counts)) = (axis.place, self.motion.position_counts_at(k, t_ns)) {
                now[p].position_mm = counts as f64 * setup.count_um / 1000.0;
            }
        }
        now[place].position_mm = position_mm;
        Some(model.error_um_at(place, self.last_s - self.seen.started_s, &now, true))
    }

    /// Components of an axis's correction; they sum to the total.
    pub fn explain(&self, n: usize, status: &AxisStatus) -> AxisCorrectionComponents {
        let (axis, setup) = (&self.axes[n], &self.setups[n]);
        let total_um = status.requested as f64 * setup.count_um;
        let mut parts = self.model_parts(n);
        if axis.table_um != 0.0 {
            parts.push(CorrectionComponent::plain("part table", axis.table_um));
        }
        let (operator_counts, operator_um) = axis.total.operator();
        if operator_counts != 0 {
            parts.push(CorrectionComponent::plain("operator", operator_um));
        }
        let ramp_um = axis.total.ramp_left_um();
        if ramp_um != 0.0 {
            parts.push(CorrectionComponent::plain("on its way", ramp_um));
        }
        let left_um = total_um - parts.iter().map(|p| p.um).sum::<f64>();
        let rest = match axis.total.limited() {
            Some(_) => "beyond max_correction_counts",
            None if axis.total.following() || !self.asks(n) => "rounding",
            None => "not followed now",
        };
        if left_um.abs() > 1e-9 {
            parts.push(CorrectionComponent::plain(rest, left_um));
        }
        AxisCorrectionComponents {
            axis: setup.name.clone(),
            requested: status.requested,
            total_um,
            parts,
            holds: axis.hold_reason.clone().or_else(|| axis.thermal_hold_reason.clone()),
        }
    }

    fn model_parts(&self, n: usize) -> Vec<CorrectionComponent> {
        let (Some(model), Some(place)) = (&self.model, self.axes[n].place) else { return Vec::new() };
        let mut parts = Vec::new();
        for p in model.live.parts() {
            let own = p.effect.axes().iter().position(|a| *a == self.seen.layout_axes[place]);
            let Some(um) = own.and_then(|k| p.value.get(k)).filter(|_| acts(p.effect, own)) else {
                continue;
            };
            let read = p.effect.delta.iter().flat_map(TemperatureDifference::sensors);
            let find = |name: &str| self.seen.watches.iter().find(|w| w.config().name == name);
            parts.push(CorrectionComponent {
                sensors: read
                    .filter_map(find)
                    .map(|w| SensorStateReport::of(w, self.seen.sensed_s))
                    .collect(),
                outside_k: (p.outside_k > 0.0).then_some(p.outside_k),
                weight: (p.weight < 1.0).then_some(p.weight),
                ..CorrectionComponent::plain(&p.effect.name(), *um)
            });
        }
        let along = ["x", "y", "z"].iter().position(|a| *a == self.setups[n].name);
        if let (Some(chain), Some(k)) = (model.live.chain_um(), along) {
            parts.push(CorrectionComponent::plain("chain", chain[k]));
        }
        parts
    }

    /// The running model.
    pub fn running_model(&self) -> Option<RunningModelReport> {
        let model = self.model.as_ref()?;
        Some(RunningModelReport {
            name: model.machine.name().to_owned(),
            file: model.machine.path.display().to_string(),
            sha256: model.machine.sha256().to_owned(),
            fits: fits(&model.machine),
            expired: model.machine.expired(self.today),
            age_days: model.machine.age_days(self.today),
            days_left: model.machine.days_left(self.today),
            notes: self.notes(model),
        })
    }

    fn notes(&self, model: &ModelEvaluator) -> Vec<String> {
        let mut notes = model.notes(self.today);
        for (axis, setup) in self.axes.iter().zip(&self.setups) {
            if let Some(max) = axis.total.limited() {
                notes.push(format!(
                    "axis {}: more is asked for than max_correction_counts = {max}; it is held there",
                    setup.name
                ));
            }
        }
        notes
    }

    /// Reason why an axis's total is held, if it is.
    pub fn holds(&self, n: usize) -> Option<&str> {
        self.axes[n].hold_reason.as_deref()
    }

    /// The model's effects that are now outside the range of their fit.
    pub fn outside(&self) -> impl Iterator<Item = String> {
        let parts = self.model.iter().flat_map(|m| m.live.parts());
        parts.filter(|p| p.outside_k > 0.0).map(|p| p.effect.identity())
    }

    /// Reasons why axes do not follow the model.
    pub fn holding(&self) -> impl Iterator<Item = String> {
        self.axes.iter().zip(&self.setups).flat_map(|(a, setup)| {
            let name = &setup.name;
            let holds = a.hold_reason.iter().map(move |why| format!("axis {name} holds: {why}"));
            let stands = a
                .thermal_hold_reason
                .iter()
                .map(move |why| format!("axis {name}: thermal corrections hold: {why}"));
            holds.chain(stands)
        })
    }
}

fn fits(machine: &Machine) -> Vec<String> {
    let of = |f: &FitNote| {
        let unit = FitNote::unit_of(&f.response);
        let turned_back = match machine.turned_back_um(&f.response) {
            um if um > 0.0 => {
                format!("; a correction at rest may leave {um:.2} {unit} of the reversal beside that")
            }
            _ => String::new(),
        };
        format!(
            "{}: fitted {}, good until {}, 95 % within ±{:.2} {unit}{}{turned_back}",
            f.response,
            f.date,
            f.valid_until,
            f.half_width_um,
            f.place_text()
        )
    };
    machine.fits().iter().map(of).collect()
}

/// Velocity of a decelerating axis after this time, at least zero.
/// Errors that depend on speed are then removed before the axis stops. Removing them later would move the
/// table back and reverse the axis.
fn slowed_mm_s(a: &AxisMotionState, after_s: f64) -> f64 {
    if a.velocity_mm_s * a.acceleration_mm_s2 >= 0.0 {
        return a.velocity_mm_s;
    }
    let size = (a.velocity_mm_s.abs() - a.acceleration_mm_s2.abs() * after_s).max(0.0);
    size.copysign(a.velocity_mm_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A slowing axis is evaluated at its later speed.
    /// After 30 ms at 200 mm/s² it is 6 mm/s slower.
    #[test]
    #[allow(clippy::float_cmp)] // what does not slow down is as it was
    fn an_axis_that_slows_down_is_asked_for_slower() {
        let after = |velocity_mm_s, acceleration_mm_s2| {
            slowed_mm_s(
                &AxisMotionState { velocity_mm_s, acceleration_mm_s2, ..AxisMotionState::default() },
                0.03,
            )
        };
        assert!((after(10.0, -200.0) - 4.0).abs() < 1e-12 && (after(-10.0, 200.0) + 4.0).abs() < 1e-12);
        assert_eq!((after(5.0, -200.0), after(-5.0, 200.0)), (0.0, 0.0));
        assert_eq!((after(10.0, 200.0), after(-10.0, -200.0), after(10.0, 0.0)), (10.0, -10.0, 10.0));
    }
}
