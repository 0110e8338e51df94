//! From what is known of the machine to requested totals: requested = model + part table + operator, per axis.
//!
//! Micrometres become counts here, rounded to the design's increment with hysteresis. A total follows the axis within its
//! belief window; a change that no motion of the axis asks for (a model loaded, corrections enabled, a sensor back) is
//! a ramp, never a jump.

use crate::temperatures;
use rtec_control::config::{Axis as AxisConfig, Config};
use rtec_control::protocol::{Change, Explained, ModelPreview, Part, PartTable, Reading, TableNow, Trip};
use rtec_files::InputError;
use rtec_model::date;
use rtec_model::effect::{Difference, Effect, Naming, Need, STANDARD_DEGC};
use rtec_model::live::{AxisNow, Frame, Layout, Live};
use rtec_model::machine::Machine;
use rtec_model::record::{Axis, Role};
use rtec_model::sensors::{Use, Watch};
use rtec_part::fit::Zx;
use rtec_part::table::{AxisCounts, Cut, Table};
use rtec_rt::event::{AxisStatus, MAX_AXES, Mode, Status};
use std::collections::VecDeque;
use std::path::Path;

/// A total changes when it is further than half an increment and this much of one off.
const HYSTERESIS: f64 = 0.25;
/// Beyond an increment, how far an axis must come back before it counts as having turned, counts.
const TURNED_COUNTS: i64 = 2;
/// Positions that are kept: half a second of them.
const KEPT: usize = 64;
/// A drive has followed an insertion after so many evaluations.
const SETTLED: usize = 30;
/// Velocity is taken over so many evaluations.
const SPEED_OVER: usize = 3;
/// A lag is known to 2 % after so many of its time constants.
const LAGS_KNOWN: f64 = 4.0;
/// Temperatures as far apart as this are those of a machine that has stood still for long, K.
const COLD_K: f64 = 1.0;
/// Shorter gaps in the temperatures never make a lag forget, s.
const GAP_S: f64 = 15.0;

/// A part table acts in full within this distance of its arc, mm, and no more beyond the second: a tool on its way
/// elsewhere is none of its business.
const TABLE_NEAR_MM: [f64; 2] = [2.0, 10.0];

/// The part table that is loaded.
struct PartErrors {
    shown: PartTable,
    table: Table,
    /// Its two axes among ours.
    axes: [usize; 2],
}

impl PartErrors {
    /// What it takes out at a machine position that is reached in the table's lead, µm.
    fn components_um(&self, place: Zx, velocity_mm_s: Zx) -> Zx {
        let lead_s = self.shown.lead_ms * 1e-3;
        let off_mm = self.off_mm(place + velocity_mm_s * lead_s);
        let [near, far] = TABLE_NEAR_MM;
        let share = ((far - off_mm) / (far - near)).clamp(0.0, 1.0);
        self.table.components_um(place, velocity_mm_s, lead_s) * share
    }

    /// From a machine position to the arc that the tool's nose runs on.
    fn off_mm(&self, place: Zx) -> f64 {
        let cut = &self.table.cut;
        ((place - cut.origin - cut.centre).norm() - cut.radius_mm - cut.nose_mm).abs()
    }
}

/// A model ready to run.
struct Loaded {
    machine: Machine,
    live: Live,
    /// Per sensor and channel of the layout: its place among the configured sensors.
    sensors: Vec<usize>,
    channels: Vec<usize>,
    /// Where spindle speed, coolant and each axis's load come from.
    rpm: Option<usize>,
    coolant: Option<usize>,
    loads: Vec<Option<usize>>,
    /// Per axis of the layout: places of the configured sensors that its effects read.
    reads: Vec<Vec<usize>>,
    lags: Vec<Lag>,
    /// What the model would like to know and nobody tells.
    unheard: Vec<String>,
    inputs: Inputs,
    /// What each configured sensor was good for at the last look.
    states: Vec<Use>,
    /// It was taken although its validity had ended.
    although_expired: bool,
}

/// What the model was told last.
#[derive(Debug, Clone, Default)]
struct Inputs {
    temperatures_degc: Vec<f64>,
    channels: Vec<f64>,
    rpm: f64,
    coolant: f64,
    held: Vec<bool>,
}

impl Inputs {
    fn frame<'a>(&'a self, t_s: f64, axes: &'a [AxisNow], probing: bool) -> Frame<'a> {
        Frame {
            t_s,
            axes,
            temperatures_degc: &self.temperatures_degc,
            channels: &self.channels,
            rpm: self.rpm,
            coolant: self.coolant,
            angle_rad: 0.0,
            probing,
            held: &self.held,
        }
    }

    /// Every part as warm as the others: a machine that has stood still for long.
    fn cold(&self) -> bool {
        let t = self.temperatures_degc.iter().copied();
        t.clone().fold(f64::MIN, f64::max) - t.fold(f64::MAX, f64::min) <= COLD_K
    }
}

/// What is known of the state of a first-order lag.
#[derive(Debug, Clone)]
struct Lag {
    axis: usize,
    tau_s: f64,
    /// It has followed its input without a gap since then, s.
    since_s: f64,
    last_s: f64,
    /// It was in equilibrium when it began.
    settled: bool,
}

impl Lag {
    /// An input came at a time; the machine was cold then, or not.
    fn hear(&mut self, now_s: f64, cold: bool) {
        let gap_s = now_s - self.last_s;
        if gap_s > (self.tau_s / 4.0).max(GAP_S) {
            self.since_s = now_s;
            self.settled = cold && gap_s > LAGS_KNOWN * self.tau_s;
        }
        self.last_s = now_s;
    }

    /// How long until it is known, s; none when it is.
    fn unknown_s(&self, now_s: f64) -> Option<f64> {
        let left = LAGS_KNOWN * self.tau_s - (now_s - self.since_s);
        (!self.settled && left > 0.0).then_some(left)
    }
}

/// One axis.
struct AxisLive {
    name: String,
    /// Its place in the layout; none where its name is none for a model.
    place: Option<usize>,
    count_um: f64,
    increment: i64,
    window: i64,
    max: i64,
    direction: f64,
    /// The furthest places in its direction: of the scale, and as the MTC counts.
    furthest: [i64; 2],
    /// What the sources ask for, µm.
    model_um: f64,
    table_um: f64,
    /// What the ramp has still to go, µm.
    offset_um: f64,
    /// The sum of it, µm, and as counts.
    out_um: f64,
    counts: i64,
    operator_counts: i64,
    /// It follows its sources now.
    active: bool,
    /// Why its total stands still, or its thermal part.
    holds: Option<String>,
    stands: Option<String>,
    limited: bool,
}

/// All axes.
pub(crate) struct Corrector {
    axes: Vec<AxisLive>,
    layout_axes: Vec<Axis>,
    model: Option<Loaded>,
    table: Option<PartErrors>,
    ramp_um_s: f64,
    started_s: f64,
    last_s: f64,
    /// Recent states, newest last.
    seen: VecDeque<Status>,
    now: Vec<AxisNow>,
    /// A source has changed: what follows is a ramp.
    changed: bool,
    /// The day, since 1970-01-01.
    today: i64,
}

impl Corrector {
    pub(crate) fn new(config: &Config, now_s: f64) -> Self {
        let mut layout_axes = Vec::new();
        let mut axes = Vec::new();
        for axis in &config.axes {
            let place = Axis::new(&axis.name).map(|a| {
                layout_axes.push(a);
                layout_axes.len() - 1
            });
            axes.push(AxisLive::new(axis, place));
        }
        Self {
            now: vec![AxisNow::default(); layout_axes.len()],
            axes,
            layout_axes,
            model: None,
            table: None,
            ramp_um_s: config.model.ramp_um_s,
            started_s: now_s,
            last_s: now_s,
            seen: VecDeque::with_capacity(KEPT),
            changed: false,
            today: date::today(),
        }
    }

    /// A day has begun, maybe. Fits whose validity ends with it are given back, once.
    pub(crate) fn day_is(&mut self, today: i64) -> Vec<String> {
        let before = std::mem::replace(&mut self.today, today);
        let Some(model) = &self.model else { return Vec::new() };
        let known = model.machine.expired(before);
        model.machine.expired(today).into_iter().filter(|e| !known.contains(e)).collect()
    }

    /// Fits of the model whose validity has ended, and nobody has said that this is meant.
    pub(crate) fn expired(&self) -> Vec<String> {
        let model = self.model.as_ref().filter(|m| !m.although_expired);
        model.map_or_else(Vec::new, |m| m.machine.expired(self.today))
    }

    /// Makes a model ready, its lags brought up from the log.
    ///
    /// # Errors
    /// What it reads and this machine does not have.
    fn prepare(
        &self,
        machine: Machine,
        watches: &[Watch],
        log: &Path,
        now_s: f64,
    ) -> Result<Loaded, InputError> {
        let mut loaded = Loaded::new(machine, &self.layout_axes, watches)?;
        let rows = temperatures::history(log, &loaded.live.layout().sensors.clone(), now_s);
        for (t_s, degc) in rows {
            loaded.inputs.temperatures_degc = degc;
            let cold = loaded.inputs.cold();
            loaded.lags.iter_mut().for_each(|l| l.hear(t_s, cold));
            loaded.live.evaluate(&loaded.inputs.frame(t_s - self.started_s, &self.now, false));
        }
        Ok(loaded)
    }

    /// Takes a model; corrections go to it in a ramp.
    ///
    /// # Errors
    /// As for a preview.
    pub(crate) fn load(
        &mut self,
        machine: Machine,
        watches: &[Watch],
        log: &Path,
        now_s: f64,
    ) -> Result<(), InputError> {
        let although_expired = !machine.expired(self.today).is_empty();
        self.model = Some(Loaded { although_expired, ..self.prepare(machine, watches, log, now_s)? });
        self.changed = true;
        Ok(())
    }

    /// No model from now on; corrections go back in a ramp.
    pub(crate) fn unload(&mut self) -> bool {
        let was = self.model.take().is_some();
        self.changed |= was;
        for axis in &mut self.axes {
            axis.model_um = 0.0;
            (axis.holds, axis.stands) = (None, None);
        }
        was
    }

    /// Takes a part's errors; corrections go to them in a ramp.
    ///
    /// # Errors
    /// What was found and what was expected.
    pub(crate) fn load_table(&mut self, wanted: PartTable) -> Result<(), String> {
        let mut axes = [0; 2];
        for (n, name) in axes.iter_mut().zip(&wanted.axes) {
            let names = || self.axes.iter().map(|a| a.name.as_str()).collect::<Vec<_>>().join(", ");
            let found = self.axes.iter().position(|a| a.name == *name && a.place.is_some());
            *n = found.ok_or_else(|| {
                format!("found axis {name:?} for the part table, expected one of {}", names())
            })?;
        }
        let [cz, cx] = wanted.centre_mm;
        let [oz, ox] = wanted.origin_mm;
        let good = [cz, cx, oz, ox].iter().all(|v| v.is_finite())
            && wanted.radius_mm.is_finite()
            && wanted.radius_mm > 0.0
            && (0.0..=1e3).contains(&wanted.nose_mm)
            && (0.0..=1e3).contains(&wanted.lead_ms)
            && axes[0] != axes[1];
        if !good {
            return Err(
                "found a part table with a value out of range; expected two axes, finite places, a positive \
                        radius_mm, nose_mm of 0 to 1000 and lead_ms of 0 to 1000"
                    .to_owned(),
            );
        }
        let errors =
            rtec_part::errors::read_error_cor(Path::new(&wanted.errors)).map_err(|e| e.to_string())?;
        let cut = Cut {
            centre: Zx::new(cz, cx),
            radius_mm: wanted.radius_mm,
            nose_mm: wanted.nose_mm,
            origin: Zx::new(oz, ox),
        };
        let counts = axes.map(|n| AxisCounts {
            count_um: self.axes[n].count_um,
            increment: self.axes[n].increment,
            sign: 1.0,
        });
        self.unload_table();
        self.table = Some(PartErrors { table: Table::new(cut, counts, errors), axes, shown: wanted });
        self.changed = true;
        Ok(())
    }

    /// No part table from now on; corrections go back in a ramp.
    pub(crate) fn unload_table(&mut self) -> bool {
        let Some(table) = self.table.take() else { return false };
        table.axes.into_iter().for_each(|n| self.axes[n].table_um = 0.0);
        self.changed = true;
        true
    }

    /// The part table, for the status.
    pub(crate) fn table_shown(&self) -> Option<PartTable> {
        self.table.as_ref().map(|t| t.shown.clone())
    }

    /// What the part table does now, for the status.
    pub(crate) fn table_now(&self, status: &Status) -> Option<TableNow> {
        let table = self.table.as_ref()?;
        let um = table.axes.map(|n| self.axes[n].table_um);
        let [z_mm, x_mm] =
            table.axes.map(|n| status.axes[n].position_counts as f64 * self.axes[n].count_um / 1000.0);
        let off_mm = table.off_mm(Zx::new(z_mm, x_mm));
        let axis = table.axes.into_iter().find_map(|n| {
            let (name, s) = (&self.axes[n].name, &status.axes[n]);
            let why = match &self.axes[n].holds {
                _ if !s.homed => "is not homed",
                _ if s.faults.any() => "has a fault",
                Some(why) => why,
                None => return None,
            };
            Some(format!("axis {name}: {why}"))
        });
        let why = match status.mode {
            Mode::Run => axis,
            Mode::Shadow => Some("shadow mode: computed, not written".to_owned()),
            Mode::Probe => Some("probing: positions are taken as the scales read".to_owned()),
            Mode::Disabled | Mode::Hold | Mode::Fault => Some("corrections are off".to_owned()),
        };
        let state = match why {
            Some(_) => "off",
            None if um.iter().all(|um| *um == 0.0) && off_mm >= TABLE_NEAR_MM[1] => "ready",
            None => "in_force",
        };
        Some(TableNow {
            points: table.table.points(),
            state: state.to_owned(),
            off_mm,
            acts_within_mm: TABLE_NEAR_MM[1],
            um,
            why,
        })
    }

    /// What a model would change now.
    ///
    /// # Errors
    /// What it reads and this machine does not have.
    pub(crate) fn preview(
        &self,
        machine: Machine,
        watches: &[Watch],
        log: &Path,
        now_s: f64,
        status: &Status,
    ) -> Result<ModelPreview, InputError> {
        let mut then = self.prepare(machine, watches, log, now_s)?;
        then.hear(watches, now_s);
        then.live.evaluate(&then.inputs.frame(now_s - self.started_s, &self.now, false));
        let axes = self.axes.iter().zip(status.axes()).map(|(axis, s)| {
            let model_um = axis.place.map_or(0.0, |p| then.live.errors_um()[p]);
            let then_um = model_um + axis.table_um + axis.operator_counts as f64 * axis.count_um;
            Change {
                axis: axis.name.clone(),
                now_counts: s.requested,
                now_um: s.requested as f64 * axis.count_um,
                then_counts: axis.rounded(model_um + axis.table_um) + axis.operator_counts,
                then_um,
                holds: axis.place.and_then(|p| then.unknown(p, watches, now_s)),
            }
        });
        let (axes, machine) = (axes.collect(), &then.machine);
        Ok(ModelPreview {
            name: machine.name().to_owned(),
            file: machine.path.display().to_string(),
            sha256: machine.sha256().to_owned(),
            fits: fits(machine),
            warnings: then.notes(&self.axes, self.today),
            expired: machine.expired(self.today),
            axes,
        })
    }

    /// An axis has been homed: its counters and totals are zero.
    pub(crate) fn homed(&mut self, n: usize) {
        if let Some(axis) = self.axes.get_mut(n) {
            (axis.operator_counts, axis.active, axis.counts, axis.out_um) = (0, false, 0, 0.0);
            axis.offset_um = 0.0;
        }
        self.seen.clear();
    }

    /// The total that an operator's total makes together with the other sources, counts.
    pub(crate) fn with_operator(&self, n: usize, operator_counts: i64) -> i64 {
        self.axes[n].counts + operator_counts
    }

    /// The operator's total was taken.
    pub(crate) fn operator_is(&mut self, n: usize, operator_counts: i64) {
        self.axes[n].operator_counts = operator_counts;
    }

    /// The total that an axis is on its way to, counts; the one requested where no source asks.
    pub(crate) fn goal(&self, n: usize, status: &AxisStatus) -> i64 {
        let axis = &self.axes[n];
        if self.asks(n) && axis.holds.is_none() {
            let goal = axis.rounded(axis.model_um + axis.table_um) + axis.operator_counts;
            goal.clamp(-axis.max, axis.max)
        } else {
            status.requested
        }
    }

    /// A source other than the operator asks, or what it asked for is still on its way back.
    fn asks(&self, n: usize) -> bool {
        let axis = &self.axes[n];
        self.model.is_some()
            || self.table.as_ref().is_some_and(|t| t.axes.contains(&n))
            || axis.offset_um != 0.0
            || axis.counts != 0
    }

    /// Looks at everything and says which totals are to be requested now.
    pub(crate) fn tick(&mut self, now_s: f64, status: &Status, watches: &[Watch]) -> [Option<i64>; MAX_AXES] {
        let dt_s = (now_s - self.last_s).max(0.0);
        self.last_s = now_s;
        self.follow(status);
        let mut changed = std::mem::take(&mut self.changed);
        if let Some(model) = &mut self.model {
            changed |= model.hear(watches, now_s);
            for (now, load) in self.now.iter_mut().zip(&model.loads) {
                now.load_n = load.and_then(|w| watches[w].value_degc()).unwrap_or(0.0);
            }
            let probing = status.mode == Mode::Probe;
            model.live.evaluate(&model.inputs.frame(now_s - self.started_s, &self.now, probing));
        }
        if let Some(table) = &self.table {
            let now = table.axes.map(|n| self.axes[n].place.map_or(AxisNow::default(), |p| self.now[p]));
            let place = Zx::new(now[0].position_mm, now[1].position_mm);
            let out = table.components_um(place, Zx::new(now[0].velocity_mm_s, now[1].velocity_mm_s));
            (self.axes[table.axes[0]].table_um, self.axes[table.axes[1]].table_um) = (out.z, out.x);
        }
        let correcting = matches!(status.mode, Mode::Run | Mode::Shadow);
        let mut totals = [None; MAX_AXES];
        for (n, s) in status.axes().iter().enumerate() {
            let asks = self.asks(n);
            let axis = &mut self.axes[n];
            if let (Some(model), Some(p)) = (&self.model, axis.place) {
                let held = axis.holds.is_some();
                axis.holds = model.unknown(p, watches, now_s);
                changed |= held != axis.holds.is_some();
                if axis.holds.is_none() {
                    axis.model_um = model.live.errors_um()[p];
                }
                axis.stands = model.standing(p, watches, now_s).filter(|_| axis.holds.is_none());
            }
            if !asks || !correcting || !s.homed || s.faults.any() {
                axis.active = false;
                continue;
            }
            let wanted_um = axis.model_um + axis.table_um;
            if !axis.active {
                // Where the axis is: what it was asked for before counts, wherever that came from.
                axis.active = true;
                axis.counts = s.requested - axis.operator_counts;
                axis.out_um = axis.counts as f64 * axis.count_um;
                axis.offset_um = axis.out_um - wanted_um;
            } else if changed {
                axis.offset_um = axis.out_um - wanted_um;
            }
            if axis.holds.is_none() {
                let step = self.ramp_um_s * dt_s;
                axis.offset_um -= axis.offset_um.clamp(-step, step);
            }
            axis.out_um = wanted_um + axis.offset_um;
            let counts = axis.out_um / axis.count_um;
            if (counts - axis.counts as f64).abs() > (0.5 + HYSTERESIS) * axis.increment as f64 {
                axis.counts = axis.rounded(axis.out_um);
            } else if self.model.is_none() && axis.out_um == 0.0 {
                axis.counts = 0;
            }
            let goal = axis.counts + axis.operator_counts;
            let bounded = goal.clamp(-axis.max, axis.max);
            axis.limited = bounded != goal;
            // Catching up after a rapid, in steps that are believed.
            let next = bounded.clamp(s.requested - axis.window, s.requested + axis.window);
            if next != s.requested {
                totals[n] = Some(next);
            }
        }
        totals
    }

    /// Positions, velocities and directions from the latest state.
    fn follow(&mut self, status: &Status) {
        if self.seen.back().is_none_or(|last| last.t_ns < status.t_ns) {
            if self.seen.len() == KEPT {
                self.seen.pop_front();
            }
            self.seen.push_back(*status);
        }
        let back = |k: usize| self.seen.iter().rev().nth(k);
        let speed = |from: Option<&Status>, to: Option<&Status>, n: usize, count_um: f64| {
            let (Some(a), Some(b)) = (from, to) else { return 0.0 };
            let dt_s = (b.t_ns - a.t_ns) as f64 * 1e-9;
            let moved = b.axes[n].position_counts - a.axes[n].position_counts;
            if dt_s > 0.0 { moved as f64 * count_um / 1000.0 / dt_s } else { 0.0 }
        };
        for (n, (axis, s)) in self.axes.iter_mut().zip(status.axes()).enumerate() {
            // Our own insertions move the scale while the MTC's count stands, and the MTC's count until the drive has
            // followed: an axis has turned when both say so, and by more than was inserted a moment ago.
            let at = [s.position_counts, s.position_counts + s.in_effect];
            let moved = [0, 1].map(|k| at[k] - axis.furthest[k]);
            let own =
                back(SETTLED).or(self.seen.front()).map_or(0, |b| s.in_effect.abs_diff(b.axes[n].in_effect));
            let enough = axis.increment + TURNED_COUNTS + own as i64;
            let turned = |d: i64| moved.iter().all(|m| m * d > enough);
            let new = [1, -1].into_iter().find(|d| turned(*d));
            if let Some(d) = new {
                (axis.direction, axis.furthest) = (d as f64, at);
            } else {
                for (furthest, k) in axis.furthest.iter_mut().zip(0..) {
                    if moved[k] as f64 * axis.direction > 0.0 {
                        *furthest = at[k];
                    }
                }
            }
            let Some(now) = axis.place.map(|p| &mut self.now[p]) else { continue };
            let velocity_mm_s = speed(back(SPEED_OVER), back(0), n, axis.count_um);
            let before = speed(back(2 * SPEED_OVER), back(SPEED_OVER), n, axis.count_um);
            let between = match (back(2 * SPEED_OVER), back(0)) {
                (Some(a), Some(b)) => (b.t_ns - a.t_ns) as f64 * 0.5e-9,
                _ => 0.0,
            };
            *now = AxisNow {
                position_mm: s.position_counts as f64 * axis.count_um / 1000.0,
                velocity_mm_s,
                acceleration_mm_s2: if between > 0.0 { (velocity_mm_s - before) / between } else { 0.0 },
                direction: axis.direction,
                load_n: 0.0,
            };
        }
    }

    /// Adds to a captured position what the model says of it, and the temperatures. Positions are not corrected while
    /// probing; the other axes are taken where they were at that time.
    pub(crate) fn at_trip(&self, n: usize, t_ns: u64, trip: &mut Trip, watches: &[Watch]) {
        let degc = |w: &Watch| w.value_degc().filter(|_| w.config().role == Role::Temperature);
        trip.degc = watches.iter().map(degc).collect();
        let (Some(model), Some(place)) = (&self.model, self.axes[n].place) else { return };
        if self.axes[n].holds.is_some() {
            return;
        }
        let mut now = self.now.clone();
        let nearest = self.seen.iter().min_by_key(|s| s.t_ns.abs_diff(t_ns));
        for (k, axis) in self.axes.iter().enumerate() {
            if let (Some(p), Some(s)) = (axis.place, nearest) {
                now[p].position_mm = s.axes[k].position_counts as f64 * axis.count_um / 1000.0;
            }
        }
        now[place].position_mm = trip.position_mm;
        let mut live = model.live.clone();
        live.evaluate(&model.inputs.frame(self.last_s - self.started_s, &now, true));
        let error_um = live.errors_um()[place];
        trip.error_um = Some(error_um);
        trip.corrected_mm = Some(trip.position_mm + error_um / 1000.0);
    }

    /// What the correction of an axis is made of; the parts sum to the total.
    pub(crate) fn explain(&self, n: usize, status: &AxisStatus, watches: &[Watch], now_s: f64) -> Explained {
        let axis = &self.axes[n];
        let total_um = status.requested as f64 * axis.count_um;
        let mut parts = Vec::new();
        let plain = |name: &str, um: f64| Part {
            name: name.to_owned(),
            um,
            sensors: Vec::new(),
            outside_k: None,
            weight: None,
        };
        if let (Some(model), Some(place)) = (&self.model, axis.place) {
            for p in model.live.parts() {
                let own = p.effect.axes().iter().position(|a| *a == self.layout_axes[place]);
                let Some(um) = own.and_then(|k| p.value.get(k)).filter(|_| acts(p.effect, own)) else {
                    continue;
                };
                let read = p.effect.delta.iter().flat_map(Difference::sensors);
                let find = |name: &str| watches.iter().find(|w| w.config().name == name);
                parts.push(Part {
                    sensors: read.filter_map(find).map(|w| reading(w, now_s)).collect(),
                    outside_k: (p.outside_k > 0.0).then_some(p.outside_k),
                    weight: (p.weight < 1.0).then_some(p.weight),
                    ..plain(&p.effect.name(), *um)
                });
            }
            let along = ["x", "y", "z"].iter().position(|a| *a == axis.name);
            if let (Some(chain), Some(k)) = (model.live.chain_um(), along) {
                parts.push(plain("chain", chain[k]));
            }
        }
        if axis.table_um != 0.0 {
            parts.push(plain("part table", axis.table_um));
        }
        if axis.operator_counts != 0 {
            parts.push(plain("operator", axis.operator_counts as f64 * axis.count_um));
        }
        let sum = |parts: &[Part]| parts.iter().map(|p| p.um).sum::<f64>();
        if axis.active && axis.offset_um != 0.0 {
            parts.push(plain("on its way", axis.offset_um));
        }
        let left = total_um - sum(&parts);
        let rest = if axis.active || !self.asks(n) { "rounding" } else { "not followed now" };
        if left.abs() > 1e-9 {
            parts.push(plain(rest, left));
        }
        Explained {
            axis: axis.name.clone(),
            requested: status.requested,
            total_um,
            parts,
            holds: axis.holds.clone().or_else(|| axis.stands.clone()),
        }
    }

    /// The model that runs, for the status.
    pub(crate) fn shown(&self) -> Option<rtec_control::protocol::Model> {
        let model = self.model.as_ref()?;
        Some(rtec_control::protocol::Model {
            name: model.machine.name().to_owned(),
            file: model.machine.path.display().to_string(),
            sha256: model.machine.sha256().to_owned(),
            fits: fits(&model.machine),
            expired: model.machine.expired(self.today),
            notes: model.notes(&self.axes, self.today),
        })
    }

    /// Why an axis does not follow its model.
    pub(crate) fn holding(&self) -> impl Iterator<Item = String> {
        self.axes.iter().flat_map(|a| {
            let holds = a.holds.iter().map(|why| format!("axis {} holds: {why}", a.name));
            holds
                .chain(a.stands.iter().map(|why| format!("axis {}: thermal corrections hold: {why}", a.name)))
        })
    }
}

impl AxisLive {
    fn new(config: &AxisConfig, place: Option<usize>) -> Self {
        let increment = config.engine.design.increment_counts();
        Self {
            name: config.name.clone(),
            place,
            count_um: config.count_um,
            increment,
            window: config.engine.window_counts,
            max: config.engine.max_correction_counts / increment * increment,
            direction: 0.0,
            furthest: [0; 2],
            model_um: 0.0,
            table_um: 0.0,
            offset_um: 0.0,
            out_um: 0.0,
            counts: 0,
            operator_counts: 0,
            active: false,
            holds: None,
            stands: None,
            limited: false,
        }
    }

    fn rounded(&self, um: f64) -> i64 {
        let increments = um / self.count_um / self.increment as f64;
        increments.round() as i64 * self.increment
    }
}

/// An effect acts on the axis of its first place; a pair on both.
fn acts(effect: &Effect, place: Option<usize>) -> bool {
    place == Some(0) || place == Some(1) && effect.card().naming == Naming::Pair
}

fn fits(machine: &Machine) -> Vec<String> {
    let of = |f: &rtec_model::machine::FitNote| {
        format!(
            "{}: fitted {}, good until {}, 95 % within ±{:.2} µm",
            f.response, f.date, f.valid_until, f.half_width_um
        )
    };
    machine.fits().iter().map(of).collect()
}

/// A sensor, for people.
pub(crate) fn reading(watch: &Watch, now_s: f64) -> Reading {
    Reading {
        sensor: watch.config().name.clone(),
        place: watch.config().place.clone(),
        degc: watch.value_degc(),
        age_s: watch.age_s(now_s),
        state: match watch.usable(now_s) {
            Use::Good => "good",
            Use::Frozen => "frozen",
            Use::Hold => "hold",
        }
        .to_owned(),
        fault: watch.fault().map(ToString::to_string),
    }
}

impl Loaded {
    fn new(machine: Machine, axes: &[Axis], watches: &[Watch]) -> Result<Self, InputError> {
        let of_role = |role: &Role| watches.iter().position(|w| w.config().role == *role);
        let named = |names: &[String], role: &Role| -> Vec<usize> {
            let place =
                |n: &String| watches.iter().position(|w| w.config().name == *n && w.config().role == *role);
            names.iter().filter_map(place).collect()
        };
        let mut layout = Layout { axes: axes.to_vec(), ..Layout::default() };
        let mut wanted = machine.sensors();
        let mut unheard = Vec::new();
        for effect in machine.effects() {
            layout.channels.extend(effect.channel().map(str::to_owned));
            for need in &effect.card().needs {
                let role = need.role(effect.axes());
                let given = match need {
                    Need::SpindleSpeed | Need::Coolant | Need::Load => of_role(&role).is_some(),
                    Need::Angle => false,
                    _ => true,
                };
                if !given {
                    unheard.push(format!("{}: no [[sensor]] of role {role}, taken as zero", effect.name()));
                }
            }
        }
        layout.channels.dedup();
        let has = |role: &Role| {
            let names = watches.iter().filter(|w| w.config().role == *role).map(|w| w.config().name.as_str());
            names.collect::<Vec<_>>().join(", ")
        };
        let (sensors, channels) =
            (named(&wanted, &Role::Temperature), named(&layout.channels, &Role::Channel));
        for (what, names, role) in
            [("temperature", &wanted, Role::Temperature), ("channel", &layout.channels, Role::Channel)]
        {
            let missing = names
                .iter()
                .find(|n| !watches.iter().any(|w| w.config().name == **n && w.config().role == role));
            if let Some(name) = missing {
                let found = format!("a {what} {name} is read");
                let expected = format!("one of the configuration's [[sensor]]: {}", has(&role));
                return Err(InputError::whole(&machine.path, found, expected));
            }
        }
        layout.sensors.append(&mut wanted);
        let find = |name: &str| watches.iter().position(|w| w.config().name == name);
        let mut reads = vec![Vec::new(); axes.len()];
        let mut lags = Vec::new();
        for effect in machine.effects() {
            for (k, axis) in effect.axes().iter().enumerate() {
                let Some(n) = axes.iter().position(|a| a == axis).filter(|_| acts(effect, Some(k))) else {
                    continue;
                };
                reads[n].extend(effect.delta.iter().flat_map(Difference::sensors).filter_map(find));
                reads[n].extend(effect.channel().and_then(find));
                let roles = effect.card().needs.iter().map(|need| need.role(effect.axes()));
                reads[n].extend(
                    roles
                        .filter(|r| *r != Role::Temperature && *r != Role::Channel)
                        .filter_map(|r| of_role(&r)),
                );
                if let Some([tau_s]) = effect.value("tau_s").filter(|_| effect.delta.is_some()) {
                    let never = f64::NEG_INFINITY;
                    lags.push(Lag { axis: n, tau_s: *tau_s, since_s: never, last_s: never, settled: false });
                }
            }
        }
        if let Some(chain) = machine.chain() {
            let read: Vec<usize> = chain.deltas().flat_map(Difference::sensors).filter_map(find).collect();
            for (n, axis) in axes.iter().enumerate() {
                if ["x", "y", "z"].contains(&axis.as_str()) {
                    reads[n].extend(&read);
                }
            }
        }
        let live = Live::of(&machine, layout).map_err(|missing| {
            InputError::whole(&machine.path, missing.to_string(), "what the configuration has")
        })?;
        let loads = axes.iter().map(|a| of_role(&Role::Load(a.clone()))).collect();
        Ok(Self {
            inputs: Inputs {
                temperatures_degc: vec![STANDARD_DEGC; sensors.len()],
                channels: vec![0.0; channels.len()],
                held: vec![false; axes.len()],
                ..Inputs::default()
            },
            states: vec![Use::Hold; watches.len()],
            although_expired: false,
            rpm: of_role(&Role::SpindleSpeed),
            coolant: of_role(&Role::Coolant),
            machine,
            live,
            sensors,
            channels,
            loads,
            reads,
            lags,
            unheard,
        })
    }

    /// Takes the sensors in; says whether one of them has become better or worse.
    fn hear(&mut self, watches: &[Watch], now_s: f64) -> bool {
        let value = |n: usize| watches[n].value_degc();
        let take = |to: &mut [f64], from: &[usize]| {
            for (to, n) in to.iter_mut().zip(from) {
                *to = value(*n).unwrap_or(*to);
            }
        };
        take(&mut self.inputs.temperatures_degc, &self.sensors);
        take(&mut self.inputs.channels, &self.channels);
        self.inputs.rpm = self.rpm.and_then(value).unwrap_or(0.0);
        self.inputs.coolant = self.coolant.and_then(value).unwrap_or(0.0);
        let mut changed = false;
        for (state, watch) in self.states.iter_mut().zip(watches) {
            let now = watch.usable(now_s);
            changed |= std::mem::replace(state, now) != now;
        }
        for (held, reads) in self.inputs.held.iter_mut().zip(&self.reads) {
            *held = reads.iter().any(|n| self.states[*n] == Use::Hold);
        }
        let cold = self.inputs.cold();
        for lag in &mut self.lags {
            if !self.inputs.held[lag.axis] {
                lag.hear(now_s, cold);
            }
        }
        changed
    }

    /// Why nothing can be said of an axis yet.
    fn unknown(&self, place: usize, watches: &[Watch], now_s: f64) -> Option<String> {
        let never = self.reads[place].iter().map(|n| &watches[*n]).find(|w| w.value_degc().is_none());
        if let Some(w) = never {
            let why = w.fault().map_or("not read yet".to_owned(), ToString::to_string);
            return Some(format!("sensor {}: {why}", w.config().name));
        }
        let lags = self.lags.iter().filter(|l| l.axis == place);
        let longest = lags.filter_map(|l| Some((l.unknown_s(now_s)?, l.tau_s)));
        let (left_s, tau_s) = longest.max_by(|a, b| a.0.total_cmp(&b.0))?;
        Some(format!(
            "how warm the machine is inside is not known yet: no temperatures were logged for {LAGS_KNOWN} times the \
             lag of {tau_s:.0} s; it is in {left_s:.0} s"
        ))
    }

    /// Why the thermal state of an axis stands still.
    fn standing(&self, place: usize, watches: &[Watch], now_s: f64) -> Option<String> {
        let lost = self.reads[place].iter().map(|n| &watches[*n]).find(|w| w.usable(now_s) == Use::Hold)?;
        let why = lost.fault().map_or("silent".to_owned(), ToString::to_string);
        let age_s = lost.age_s(now_s).unwrap_or(0.0);
        Some(format!("sensor {}: {why}; its last good value is {age_s:.0} s old", lost.config().name))
    }

    /// What to know of it now.
    fn notes(&self, axes: &[AxisLive], today: i64) -> Vec<String> {
        let mut notes = self.machine.doubts(today);
        notes.extend(self.unheard.iter().cloned());
        for p in self.live.parts() {
            if p.outside_k > 0.0 {
                let delta = p.effect.delta.as_ref().map_or(String::new(), |d| format!(" ({d})"));
                notes.push(format!(
                    "{}{delta} is {:.1} K outside the range it was fitted on: {:.0} % of it is left",
                    p.effect.name(),
                    p.outside_k,
                    100.0 * p.weight
                ));
            }
            if p.effect.card().name == "warm_up" {
                notes.push(format!("{}: its time counts from the daemon's start", p.effect.name()));
            }
        }
        let limited = axes.iter().filter(|a| a.limited);
        notes.extend(limited.map(|a| {
            format!(
                "axis {}: more is asked for than max_correction_counts = {}; it is held there",
                a.name, a.max
            )
        }));
        notes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rtec_model::sensors;
    use std::fmt::Write as _;

    /// A machine of one or more axes as the engine would have it: what is requested is completed at once.
    struct Bench {
        corrector: Corrector,
        status: Status,
        watches: Vec<Watch>,
        now_s: f64,
        log: tempfile::TempDir,
    }

    const TICK_S: f64 = 0.01;

    fn machine(text: &str) -> Machine {
        Machine::parse(Path::new("m.toml"), &format!("name = \"m\"\n{text}")).unwrap()
    }

    const SCALE: &str = "[[effect]]\nname = \"scale.x\"\nppm = 100.0\n";
    const GROWTH: &str =
        "[[effect]]\nname = \"thermal_growth.z\"\nsensor = \"T1\"\nminus = \"T2\"\num_per_K = 10.0\n";
    const LAG: &str = "[[effect]]\nname = \"thermal_lag.z\"\nsensor = \"T1\"\nminus = \"T2\"\num_per_K = 10.0\ntau_s = 100.0\n";

    impl Bench {
        fn new(config: &str) -> Self {
            let sensor = |n: &str| {
                format!(
                    "[[sensor]]\nname = \"{n}\"\nsource = \"line\"\nfrom = \"x:1\"\ntimeout_s = 5\nfreeze_s = 20\n"
                )
            };
            let text =
                format!("{}\n{config}\n{}{}", rtec_control::config::EMBEDDED, sensor("T1"), sensor("T2"));
            let config = Config::parse(Path::new("rtec.toml"), &text).unwrap();
            let mut status = Status { mode: Mode::Run, axes_used: 3, ..Status::default() };
            status.axes.iter_mut().for_each(|a| a.homed = true);
            Self {
                corrector: Corrector::new(&config, 1000.0),
                status,
                watches: config.sensors.iter().cloned().map(Watch::new).collect(),
                now_s: 1000.0,
                log: tempfile::tempdir().unwrap(),
            }
        }

        fn warm(&mut self, t1: f64, t2: f64) {
            self.watches[0].offer(self.now_s, Ok(t1));
            self.watches[1].offer(self.now_s, Ok(t2));
        }

        fn load(&mut self, model: &str) {
            let log = self.log.path().to_owned();
            self.corrector.load(machine(model), &self.watches, &log, self.now_s).unwrap();
        }

        /// One evaluation, and an engine that takes what is within its window; the totals asked for.
        fn tick(&mut self) -> [Option<i64>; MAX_AXES] {
            self.now_s += TICK_S;
            self.status.t_ns += (TICK_S * 1e9) as u64;
            let totals = self.corrector.tick(self.now_s, &self.status, &self.watches);
            for (axis, total) in self.status.axes.iter_mut().zip(totals) {
                if let Some(total) = total {
                    assert!((total - axis.requested).abs() <= 50, "{total} after {}", axis.requested);
                    (axis.requested, axis.completed, axis.in_effect) = (total, total, total);
                }
            }
            totals
        }

        /// Evaluations for so long, with the sensors heard every second; the largest step of an axis's total.
        fn run(&mut self, s: f64, axis: usize, mut degc: impl FnMut(f64) -> Option<(f64, f64)>) -> i64 {
            let (until, mut heard, mut largest) = (self.now_s + s, self.now_s, 0);
            while self.now_s < until {
                if self.now_s >= heard {
                    heard += 1.0;
                    if let Some((t1, t2)) = degc(self.now_s) {
                        self.warm(t1, t2);
                    }
                }
                let before = self.status.axes[axis].requested;
                self.tick();
                largest = largest.max((self.status.axes[axis].requested - before).abs());
            }
            largest
        }

        fn z(&self) -> i64 {
            self.status.axes[2].requested
        }

        fn explained_um(&self, n: usize) -> (f64, f64) {
            let e = self.corrector.explain(n, &self.status.axes[n], &self.watches, self.now_s);
            (e.total_um, e.parts.iter().map(|p| p.um).sum())
        }
    }

    #[test]
    fn a_total_follows_the_axis_within_its_window_and_does_not_chatter() {
        let mut bench = Bench::new("");
        bench.load(SCALE);
        bench.tick();
        // A rapid over 400 mm between two evaluations: 40 counts, and no more than the window at once.
        bench.status.axes[0].position_counts = 400_000;
        bench.run(1.0, 0, |_| None);
        assert_eq!(bench.status.axes[0].requested, 40);
        // Where an increment begins it does not matter how the scale trembles; further on, it follows.
        for k in 0..200 {
            bench.status.axes[0].position_counts = 410_000 + 500 * (k % 2);
            bench.tick();
            assert_eq!(bench.status.axes[0].requested, 40);
        }
        bench.status.axes[0].position_counts = 420_000;
        assert_eq!(bench.tick()[0], Some(42));
        assert_eq!(bench.tick(), [None; MAX_AXES], "what is requested is not requested again");
        let (total, sum) = bench.explained_um(0);
        assert!((total - 42.0).abs() < 1e-12 && (total - sum).abs() < 1e-9, "{total} {sum}");
    }

    #[test]
    fn loading_and_unloading_are_ramps() {
        let mut bench = Bench::new("[model]\nramp_um_s = 10");
        bench.status.axes[0].position_counts = 400_000;
        bench.load(SCALE);
        assert!(bench.run(2.0, 0, |_| None) <= 2);
        assert!((18..=22).contains(&bench.status.axes[0].requested), "half way after two of four seconds");
        bench.run(3.0, 0, |_| None);
        assert_eq!(bench.status.axes[0].requested, 40);
        assert!(bench.corrector.unload() && !bench.corrector.unload());
        assert!(bench.run(6.0, 0, |_| None) <= 2);
        assert_eq!(bench.status.axes[0].requested, 0);
    }

    /// A nose of 40 mm about the machine's zero, on z and x; 10 µm too large at the tip.
    fn part(bench: &Bench, axes: [&str; 2]) -> PartTable {
        let file = bench.log.path().join("error.cor");
        std::fs::write(&file, "0.0 10.0\n0.5 0.0\n1.6 0.0\n").unwrap();
        PartTable {
            errors: file.display().to_string(),
            axes: axes.map(str::to_owned),
            centre_mm: [0.0; 2],
            radius_mm: 39.0,
            nose_mm: 1.0,
            origin_mm: [0.0; 2],
            lead_ms: 0.0,
        }
    }

    #[test]
    fn a_part_table_acts_near_its_arc_and_says_when_it_does_not() {
        let mut bench = Bench::new("");
        assert_eq!(bench.corrector.table_now(&bench.status), None);
        let wanted = part(&bench, ["z", "x"]);
        bench.corrector.load_table(wanted.clone()).unwrap();
        assert_eq!(bench.corrector.table_shown(), Some(wanted));
        let mut seen = |z_mm: i64, change: fn(&mut Status)| {
            let kept = bench.status;
            bench.status.axes[2].position_counts = z_mm * 1000;
            change(&mut bench.status);
            bench.run(0.5, 2, |_| None);
            let now = bench.corrector.table_now(&bench.status).unwrap();
            bench.status = Status { t_ns: bench.status.t_ns, ..kept };
            now
        };
        let on = seen(40, |_| {});
        assert_eq!((on.state.as_str(), on.points, on.um, on.why), ("in_force", 3, [10.0, 0.0], None));
        assert!(on.off_mm.abs() < 1e-9);
        let far = seen(140, |_| {});
        assert_eq!((far.state.as_str(), far.off_mm, far.um), ("ready", 100.0, [0.0; 2]));
        for (change, why) in [
            ((|s| s.mode = Mode::Disabled) as fn(&mut Status), "corrections are off"),
            (|s| s.mode = Mode::Shadow, "shadow mode"),
            (|s| s.mode = Mode::Probe, "probing"),
            (|s| s.axes[0].homed = false, "axis x: is not homed"),
            (
                |s| {
                    s.axes[2].faults.latch(rtec_rt::event::Fault::PollGap);
                },
                "axis z: has a fault",
            ),
        ] {
            let now = seen(40, change);
            assert!(now.state == "off" && now.why.as_deref().is_some_and(|w| w.starts_with(why)), "{now:?}");
        }
        assert!(bench.corrector.unload_table() && !bench.corrector.unload_table());
        assert_eq!(bench.corrector.table_now(&bench.status), None);
    }

    #[test]
    fn a_part_table_that_does_not_fit_the_machine_is_refused_and_the_one_before_it_stays() {
        let mut bench = Bench::new("");
        let good = part(&bench, ["z", "x"]);
        bench.corrector.load_table(good.clone()).unwrap();
        let beside = |change: fn(&mut PartTable)| {
            let mut wanted = good.clone();
            change(&mut wanted);
            wanted
        };
        for (wanted, said) in [
            (part(&bench, ["b", "x"]), "found axis \"b\" for the part table, expected one of x, y, z"),
            (part(&bench, ["z", "z"]), "two axes"),
            (beside(|t| t.radius_mm = -1.0), "a positive radius_mm"),
            (beside(|t| t.origin_mm[1] = f64::NAN), "finite places"),
            (beside(|t| t.lead_ms = 2000.0), "lead_ms of 0 to 1000"),
            (beside(|t| t.errors.push_str(".none")), "error.cor.none: found No such file"),
        ] {
            let text = bench.corrector.load_table(wanted).unwrap_err();
            assert!(text.contains(said), "{text}");
        }
        assert_eq!(bench.corrector.table_shown(), Some(good));
    }

    #[test]
    fn nothing_is_asked_for_while_it_must_not_and_after_that_it_is_a_ramp() {
        type Change = fn(&mut Status);
        let not: [Change; 6] = [
            |s| s.mode = Mode::Disabled,
            |s| s.mode = Mode::Hold,
            |s| s.mode = Mode::Probe,
            |s| s.mode = Mode::Fault,
            |s| s.axes[0].homed = false,
            |s| {
                s.axes[0].faults.latch(rtec_rt::event::Fault::PollGap);
            },
        ];
        for change in not {
            let mut bench = Bench::new("");
            bench.load(SCALE);
            bench.tick();
            let before = bench.status;
            change(&mut bench.status);
            bench.status.axes[0].position_counts = 400_000;
            for _ in 0..100 {
                assert_eq!(bench.tick()[0], None, "{:?}", bench.status.mode);
            }
            let axes = bench.status.axes;
            bench.status = Status { t_ns: bench.status.t_ns, ..before };
            bench.status.axes[0].position_counts = axes[0].position_counts;
            assert!(bench.run(10.0, 0, |_| None) <= 2);
            assert_eq!(bench.status.axes[0].requested, 40);
        }
    }

    #[test]
    fn the_operator_is_beside_the_model() {
        let mut bench = Bench::new("");
        bench.load(SCALE);
        bench.status.axes[0].position_counts = 200_000;
        bench.run(6.0, 0, |_| None);
        assert_eq!(bench.status.axes[0].requested, 20);
        assert_eq!(bench.corrector.with_operator(0, -7), 13);
        bench.corrector.operator_is(0, -7);
        bench.status.axes[0].requested = 13;
        bench.status.axes[0].position_counts = 400_000;
        bench.run(1.0, 0, |_| None);
        assert_eq!(bench.status.axes[0].requested, 33);
        let (total, sum) = bench.explained_um(0);
        assert!((total - sum).abs() < 1e-9);
        // Homed again: all totals are zero, and the model's comes back in a ramp.
        bench.corrector.homed(0);
        bench.status.axes[0] = AxisStatus { homed: true, ..AxisStatus::default() };
        bench.status.axes[0].position_counts = 400_000;
        assert!(bench.run(10.0, 0, |_| None) <= 2);
        assert_eq!(bench.status.axes[0].requested, 40);
    }

    #[test]
    fn a_direction_is_turned_by_the_axis_not_by_our_own_insertions() {
        let mut bench = Bench::new("");
        bench.load("[[effect]]\nname = \"reversal.x\"\num = 40.0\n");
        // The MTC counts what is inserted at once; the drive makes room for it a little later.
        let to = |bench: &mut Bench, commanded: i64, ticks: usize| {
            for _ in 0..ticks {
                bench.tick();
                let axis = &mut bench.status.axes[0];
                axis.position_counts += (commanded - axis.in_effect - axis.position_counts) / 2;
            }
        };
        for p in [0, 100, 200] {
            to(&mut bench, p, 20);
        }
        to(&mut bench, 200, 200);
        assert_eq!(bench.status.axes[0].requested, 20);
        to(&mut bench, 170, 200);
        assert_eq!(bench.status.axes[0].requested, -20, "a reversal is motion: no ramp");
    }

    #[test]
    fn a_lost_sensor_stands_then_holds_and_comes_back_without_a_jump() {
        let mut bench = Bench::new("");
        bench.load(&[GROWTH, SCALE].concat());
        bench.run(30.0, 2, |t| Some((20.0 + 0.1 * (t - 1000.0), 20.0)));
        let warm = bench.z();
        assert!((28..=30).contains(&warm), "{warm}");
        // T1 says nothing, T2 goes on cooling: while T1 stands in, the difference goes on; then it holds.
        bench.run(40.0, 2, |_| None);
        let why: Vec<String> = bench.corrector.holding().collect();
        assert!(why.iter().any(|w| w.contains("axis z: thermal corrections hold: sensor T1")), "{why:?}");
        let held = bench.z();
        for k in 0..600 {
            bench.watches[1].offer(bench.now_s, Ok(20.0 - 0.001 * f64::from(k)));
            bench.tick();
            assert_eq!(bench.z(), held);
        }
        // What depends on position is not held.
        bench.status.axes[0].position_counts = 200_000;
        bench.tick();
        assert_eq!(bench.status.axes[0].requested, 20);
        assert!(bench.run(60.0, 2, |_| Some((26.0, 20.0))) <= 2, "a ramp");
        assert_eq!((bench.z(), bench.corrector.holding().count()), (60, 0));
    }

    #[test]
    fn a_sensor_that_was_never_heard_holds_its_axis_only() {
        let mut bench = Bench::new("");
        bench.load(&[GROWTH, SCALE].concat());
        bench.status.axes[0].position_counts = 400_000;
        bench.run(10.0, 2, |_| None);
        assert_eq!((bench.status.axes[0].requested, bench.z()), (40, 0));
        let why: Vec<String> = bench.corrector.holding().collect();
        assert_eq!(why, ["axis z holds: sensor T1: not read yet"]);
    }

    #[test]
    fn outside_its_range_a_correction_fades_and_says_so() {
        let mut bench = Bench::new("");
        bench.load(&format!("{GROWTH}range_K = [0.0, 3.0]\n"));
        bench.run(120.0, 2, |t| Some((20.0 + 0.1 * (t - 1000.0), 20.0)));
        assert!(bench.z().abs() <= 2, "{}", bench.z());
        let shown = bench.corrector.shown().unwrap();
        assert!(
            shown.notes[0].contains("outside the range it was fitted on: 0 % of it is left"),
            "{shown:?}"
        );
        let (total, sum) = bench.explained_um(2);
        assert!((total - sum).abs() < 1e-9);
    }

    /// Temperatures as a log and as they come: a restart in the middle gives the same correction as none.
    #[test]
    fn a_restart_knows_the_heat_from_the_log_or_holds() {
        let degc = |t: f64| {
            let warm = 12.0 * (1.0 - (-(t - 1000.0) / 150.0).exp());
            Some((20.0 + warm, 20.0))
        };
        let mut log = "t,T1,T2\n".to_owned();
        for k in 0..60 {
            let t = 1000.0 + 5.0 * f64::from(k);
            let (t1, t2) = degc(t).unwrap();
            let _ = writeln!(log, "{t},{t1},{t2}");
        }
        let mut whole = Bench::new("");
        let (t1, t2) = degc(1000.0).unwrap();
        whole.warm(t1, t2);
        whole.load(LAG);
        whole.run(300.0, 2, degc);
        assert_eq!(whole.corrector.holding().count(), 0, "cold at its start: known from there");
        let goal = whole.corrector.goal(2, &whole.status.axes[2]);
        assert!(goal > 30 && goal < 90, "{goal}: late, so not the 105 of the difference itself");

        let started = |log: Option<&str>| {
            let mut bench = Bench::new("");
            bench.now_s = 1300.0;
            bench.corrector.started_s = 1300.0;
            bench.corrector.last_s = 1300.0;
            if let Some(log) = log {
                std::fs::write(bench.log.path().join("temperatures.csv"), log).unwrap();
            }
            let (t1, t2) = degc(1300.0).unwrap();
            bench.warm(t1, t2);
            bench.load(LAG);
            bench.tick();
            bench
        };
        let again = started(Some(&log));
        assert_eq!(again.corrector.holding().count(), 0);
        let same = again.corrector.goal(2, &again.status.axes[2]);
        assert!((same - goal).abs() <= 2, "{same} after a restart, {goal} without");

        // Without a log a warm machine holds until four lags have passed, and then goes there in a ramp.
        let mut blank = started(None);
        assert!(blank.corrector.holding().next().unwrap().contains("not known yet"));
        blank.run(300.0, 2, degc);
        assert_eq!(blank.z(), 0);
        assert!(blank.run(150.0, 2, degc) <= 2);
        assert!(blank.z() > 90 && blank.corrector.holding().count() == 0, "{}", blank.z());
    }

    #[test]
    fn a_model_that_reads_what_the_machine_has_not_is_refused_by_name() {
        let bench = Bench::new("");
        let refuse = |text: &str| {
            let m = machine(text);
            let found = bench.corrector.prepare(m, &bench.watches, bench.log.path(), bench.now_s);
            found.err().unwrap().to_string()
        };
        let text = refuse(&GROWTH.replace("T2", "T9"));
        assert!(text.contains("temperature T9") && text.contains("T1, T2"), "{text}");
        assert!(refuse("[[effect]]\nname = \"channel.x.flow\"\ngain = 1.0\n").contains("channel flow"));
        let coolant = machine("[[effect]]\nname = \"coolant.z\"\num = 5.0\n");
        let loaded = bench.corrector.prepare(coolant, &bench.watches, bench.log.path(), 0.0).unwrap();
        assert!(loaded.notes(&[], 0)[0].contains("no [[sensor]] of role coolant"));
    }

    /// Whoever loads it has been asked; one that ends while it runs has not been meant, and says so once.
    #[test]
    fn a_model_that_ends_while_it_runs_goes_on_and_is_known_to_have_ended() {
        let fit = "[[fit]]\nresponse = \"error.x\"\ndate = \"1970-01-01\"\nvalid_until = \"1970-01-11\"\n\
                   rms_um = 0.1\nhalf_width_um = 0.2\n";
        let mut bench = Bench::new("");
        bench.corrector.day_is(9);
        bench.load(&[SCALE, fit].concat());
        bench.status.axes[0].position_counts = 400_000;
        bench.run(10.0, 0, |_| None);
        assert_eq!(bench.corrector.day_is(10), [""; 0], "its last day");
        assert!(bench.corrector.expired().is_empty());
        let ended = "error.x: the fit's validity ended on 1970-01-11";
        assert_eq!(bench.corrector.day_is(11), [ended]);
        assert_eq!(bench.corrector.day_is(11), [""; 0], "said once");
        assert_eq!(bench.corrector.expired(), [ended]);
        bench.status.axes[0].position_counts = 420_000;
        bench.tick();
        assert_eq!(bench.status.axes[0].requested, 42, "what cuts now goes on");
        let shown = bench.corrector.shown().unwrap();
        assert!(shown.expired == [ended] && shown.notes.contains(&ended.to_owned()), "{shown:?}");
        // Loaded again, somebody has meant it.
        bench.load(&[SCALE, fit].concat());
        assert!(bench.corrector.expired().is_empty());
        assert_eq!(bench.corrector.shown().unwrap().expired, [ended]);
    }

    #[test]
    fn spindle_and_load_come_from_sensors_of_their_role() {
        let extra = "[[sensor]]\nname = \"rpm\"\nrole = \"spindle_speed\"\nsource = \"line\"\nfrom = \"x:1\"\n\
                     [[sensor]]\nname = \"thrust\"\nrole = \"load.z\"\nsource = \"line\"\nfrom = \"x:1\"\n";
        let mut bench = Bench::new(extra);
        assert_eq!(sensors::Config::clone(bench.watches[0].config()).name, "rpm");
        bench.watches[0].offer(bench.now_s, Ok(3000.0));
        bench.watches[1].offer(bench.now_s, Ok(400.0));
        bench.load(
            "[[effect]]\nname = \"spindle_speed.z\"\num_per_krpm = 2.0\num_per_krpm2 = 0.0\n[[effect]]\n\
             name = \"stiffness.z\"\num_per_N = 0.01\n",
        );
        bench.run(4.0, 2, |_| None);
        assert_eq!(bench.z(), 10);
    }

    #[test]
    fn a_probed_point_gets_what_the_model_says_of_it_and_the_temperatures() {
        let mut bench = Bench::new("");
        bench.load(&[SCALE, GROWTH, "[[effect]]\nname = \"squareness.x.y\"\nurad = 50.0\n"].concat());
        bench.warm(23.0, 20.0);
        bench.status.mode = Mode::Probe;
        for p in [0, 50_000, 100_000] {
            bench.status.axes[1].position_counts = p;
            bench.tick();
        }
        let at = |t_back_s: f64| {
            let mut trip = Trip {
                position_counts: 200_000.0,
                position_mm: 200.0,
                uncertainty_counts: 0.1,
                uncertainty_um: 0.1,
                at_ns: [0; 2],
                error_um: None,
                corrected_mm: None,
                degc: Vec::new(),
            };
            let t_ns = bench.status.t_ns - (t_back_s * 1e9) as u64;
            bench.corrector.at_trip(0, t_ns, &mut trip, &bench.watches);
            trip
        };
        // 100 ppm of 200 mm, and 50 µrad of Y where it was then: 100 mm, or 50 mm one evaluation before.
        let trip = at(0.0);
        assert!((trip.error_um.unwrap() - 25.0).abs() < 1e-9, "{trip:?}");
        assert!((trip.corrected_mm.unwrap() - 200.025).abs() < 1e-9);
        assert_eq!(trip.degc, [Some(23.0), Some(20.0)]);
        assert!((at(TICK_S).error_um.unwrap() - 22.5).abs() < 1e-9);
        assert_eq!(bench.status.axes[0].requested, 0, "probing is not corrected");
    }
}
