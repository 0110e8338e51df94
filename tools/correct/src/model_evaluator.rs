//! The machine model as a source.
//! From the sensors it gives each axis's error, or why the error is unknown.

use rtec_files::InputError;
use rtec_model::effect::{
    Effect, EffectNameAxes, RequiredInput, STANDARD_DEGC, TemperatureDifference, ThermalDependence,
};
use rtec_model::live_evaluation::{AxisMotionState, LiveModel, MachineState, MachineStateLayout};
use rtec_model::machine::{FitNote, Machine};
use rtec_model::record::{Axis, Role, span};
use rtec_sensors::{SensorMonitor, SensorUsability};

/// Time constants after which a lag is known to 2 %.
const LAGS_KNOWN: f64 = 4.0;
/// Largest spread of temperatures of a machine that has long been idle, K.
const COLD_K: f64 = 1.0;
/// Longest gap in the temperatures after which any lag is still known, s.
const GAP_S: f64 = 15.0;

/// A model ready to run. Axes are indexed as in its layout.
#[derive(Debug)]
pub(crate) struct ModelEvaluator {
    pub(crate) machine: Machine,
    pub(crate) live: LiveModel,
    /// Index of the configured sensor, per sensor and per channel of the layout.
    sensors: Vec<usize>,
    channels: Vec<usize>,
    /// Sensors of spindle speed, coolant and each axis's load.
    rpm: Option<usize>,
    coolant: Option<usize>,
    loads: Vec<Option<usize>>,
    /// Per axis: indices of the configured sensors that its effects read.
    reads: Vec<Vec<usize>>,
    lags: Vec<LagSettling>,
    /// Inputs of the model that no sensor gives.
    missing: Vec<String>,
    ranges: Vec<FittedTemperatureRange>,
    /// The last value of each configured sensor.
    values: Vec<Option<f64>>,
    inputs: NonAxisInputs,
    /// State of each configured sensor at the last reading.
    states: Vec<SensorUsability>,
    /// Sensors lost for so long that corrections hold until they are enabled again.
    lost: Vec<bool>,
    /// It was loaded although its validity had ended.
    pub(crate) although_expired: bool,
}

/// Inputs of the model other than the axes.
#[derive(Debug, Clone, Default)]
struct NonAxisInputs {
    temperatures_degc: Vec<f64>,
    channels: Vec<f64>,
    rpm: f64,
    coolant: f64,
    held: Vec<bool>,
}

impl NonAxisInputs {
    fn frame<'a>(&'a self, t_s: f64, axes: &'a [AxisMotionState], probing: bool) -> MachineState<'a> {
        MachineState {
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

    /// Whether all temperatures are nearly equal: the machine has long been idle.
    fn cold(&self) -> bool {
        let [coldest, warmest] = span(&self.temperatures_degc);
        warmest - coldest <= COLD_K
    }
}

/// Whether the state of a first-order lag is known.
#[derive(Debug, Clone)]
struct LagSettling {
    axis: usize,
    tau_s: f64,
    /// Start of its uninterrupted input, s.
    since_s: f64,
    last_s: f64,
    /// It was in equilibrium with its input when it began to follow.
    settled: bool,
}

impl LagSettling {
    fn new(axis: usize, tau_s: f64) -> Self {
        Self { axis, tau_s, since_s: f64::NEG_INFINITY, last_s: f64::NEG_INFINITY, settled: false }
    }

    /// Notes an input at a time; `cold` if the machine was cold then.
    fn follow(&mut self, now_s: f64, cold: bool) {
        let gap_s = now_s - self.last_s;
        if gap_s > (self.tau_s / 4.0).max(GAP_S) {
            self.since_s = now_s;
            self.settled = cold && gap_s > LAGS_KNOWN * self.tau_s;
        }
        self.last_s = now_s;
    }

    /// Time until the lag is known, s; none if it is.
    fn unknown_s(&self, now_s: f64) -> Option<f64> {
        let left = LAGS_KNOWN * self.tau_s - (now_s - self.since_s);
        (!self.settled && left > 0.0).then_some(left)
    }
}

/// Range of a temperature difference that a fit was made on.
/// An effect may read that difference or not.
#[derive(Debug)]
struct FittedTemperatureRange {
    /// Index of the fit in the model, and of the difference in the fit.
    fit: usize,
    valid: usize,
    /// Indices of its sensors among the configured ones.
    sensor: usize,
    minus: Option<usize>,
}

impl FittedTemperatureRange {
    /// The ranges of a model whose sensors are configured.
    fn all(machine: &Machine, watches: &[SensorMonitor]) -> Vec<Self> {
        let mut all = Vec::new();
        for (fit, note) in machine.fits().iter().enumerate() {
            for (valid, v) in note.valid.iter().enumerate() {
                let minus = v.difference.minus().map_or(Some(None), |name| of_name(watches, name).map(Some));
                let places = of_name(watches, &v.difference.sensor).zip(minus);
                all.extend(places.map(|(sensor, minus)| Self { fit, valid, sensor, minus }));
            }
        }
        all
    }
}

/// Whether an effect acts on its axis `place`: the first, or either of a pair.
pub(crate) fn acts(effect: &Effect, place: Option<usize>) -> bool {
    place == Some(0) || place == Some(1) && effect.description().naming == EffectNameAxes::Pair
}

/// Whether an effect changes with the direction of the last motion.
fn depends_on_direction(effect: &Effect) -> bool {
    effect.description().needs.contains(&RequiredInput::Direction)
}

/// Whether an effect changes with sensors or time while no axis moves.
fn is_slow(effect: &Effect) -> bool {
    use RequiredInput::{Channel, Coolant, Delta, Load, SpindleSpeed, Time};
    let needs = &effect.description().needs;
    needs.iter().any(|n| matches!(n, Time | Delta | Load | SpindleSpeed | Coolant | Channel))
}

fn of_role(watches: &[SensorMonitor], role: &Role) -> Option<usize> {
    watches.iter().position(|w| w.config().role == *role)
}

fn of_name(watches: &[SensorMonitor], name: &str) -> Option<usize> {
    watches.iter().position(|w| w.config().name == name)
}

/// Indices of the configured sensors of these names and this role.
///
/// # Errors
/// All names that are not configured, what reads them, and what to add to the configuration.
fn places(
    machine: &Machine,
    names: &[String],
    (what, role): (&str, &Role),
    watches: &[SensorMonitor],
) -> Result<Vec<usize>, InputError> {
    let place = |n: &String| watches.iter().position(|w| w.config().name == *n && w.config().role == *role);
    let lacking: Vec<&String> = names.iter().filter(|n| place(n).is_none()).collect();
    if lacking.is_empty() {
        return Ok(names.iter().filter_map(place).collect());
    }
    let read = |n: &&String| format!("{n} (read by {})", readers(machine, n).join(", "));
    let read: Vec<String> = lacking.iter().map(read).collect();
    let found = format!("no {what} {} in the daemon's configuration", read.join(", "));
    let add = |n: &&String| format!("[[sensor]] name = \"{n}\", role = \"{role}\"");
    let add: Vec<String> = lacking.iter().map(add).collect();
    let has = watches.iter().filter(|w| w.config().role == *role).map(|w| w.config().name.as_str());
    let has: Vec<&str> = has.collect();
    let has = if has.is_empty() { "none".to_owned() } else { has.join(", ") };
    let expected = format!(
        "{}, each with its source, in the rtec.toml that rtecd was started with, and rtecd started again; of role {role} \
         it has {has}",
        add.join("; ")
    );
    Err(InputError::whole(&machine.path, found, expected))
}

/// The parts of a model that read a sensor or channel of this name.
fn readers(machine: &Machine, name: &str) -> Vec<String> {
    let reads = |e: &&Effect| {
        e.delta.iter().flat_map(TemperatureDifference::sensors).any(|s| s == name)
            || e.channel() == Some(name)
    };
    let mut readers: Vec<String> = machine.effects().filter(reads).map(Effect::name).collect();
    let mut of_chain =
        machine.chain().into_iter().flat_map(|c| c.deltas().flat_map(TemperatureDifference::sensors));
    if of_chain.any(|s| s == name) {
        readers.push("the chain".to_owned());
    }
    readers
}

/// Inputs of the effects that no configured sensor gives, and that count as zero.
/// Also axes that the model corrects but the configuration does not have, perhaps under another name.
fn missing(machine: &Machine, axes: &[Axis], watches: &[SensorMonitor]) -> Vec<String> {
    let mut missing = Vec::new();
    let mut absent: Vec<(&Axis, Vec<String>)> = Vec::new();
    for effect in machine.effects() {
        for (k, axis) in effect.axes().iter().enumerate().filter(|(_, axis)| !axes.contains(axis)) {
            let name = effect.name();
            let does = if acts(effect, Some(k)) {
                name
            } else {
                format!("{name}, which reads its position as zero")
            };
            match absent.iter_mut().find(|(a, _)| *a == axis) {
                Some((_, effects)) if effects.contains(&does) => {}
                Some((_, effects)) => effects.push(does),
                None => absent.push((axis, vec![does])),
            }
        }
    }
    for (axis, effects) in absent {
        let configured: Vec<&str> = axes.iter().map(Axis::as_str).collect();
        let like = configured.iter().find(|a| a.eq_ignore_ascii_case(axis.as_str()));
        missing.push(format!(
            "no axis {axis} in the daemon's configuration, which has {}{}: without effect here {}",
            configured.join(", "),
            like.map_or(String::new(), |a| format!(" (is {axis} its {a}? names count by their letters)")),
            effects.join(", ")
        ));
    }
    for effect in machine.effects() {
        for need in &effect.description().needs {
            let role = need.role(effect.axes());
            let given = match need {
                RequiredInput::SpindleSpeed | RequiredInput::Coolant | RequiredInput::Load => {
                    of_role(watches, &role).is_some()
                }
                _ => true,
            };
            if !given {
                missing.push(format!(
                    "{}: no [[sensor]] of role {role} in the daemon's configuration, taken as zero",
                    effect.name()
                ));
            }
            if *need == RequiredInput::Angle {
                missing.push(format!(
                    "{}: is over the angle of a circle, which a machine at work does not have: without effect here",
                    effect.name()
                ));
            }
        }
    }
    missing
}

/// Per axis: the configured sensors that its effects read.
fn reads(machine: &Machine, axes: &[Axis], watches: &[SensorMonitor]) -> Vec<Vec<usize>> {
    let mut reads = vec![Vec::new(); axes.len()];
    for (n, effect) in acting(machine, axes) {
        reads[n].extend(
            effect
                .delta
                .iter()
                .flat_map(TemperatureDifference::sensors)
                .filter_map(|name| of_name(watches, name)),
        );
        reads[n].extend(effect.channel().and_then(|name| of_name(watches, name)));
        let roles = effect.description().needs.iter().map(|need| need.role(effect.axes()));
        let others = roles.filter(|r| *r != Role::Temperature && *r != Role::Channel);
        reads[n].extend(others.filter_map(|r| of_role(watches, &r)));
    }
    if let Some(chain) = machine.chain() {
        let sensors = chain.deltas().flat_map(TemperatureDifference::sensors);
        let read: Vec<usize> = sensors.filter_map(|name| of_name(watches, name)).collect();
        for (n, axis) in axes.iter().enumerate() {
            if ["x", "y", "z"].contains(&axis.as_str()) {
                reads[n].extend(&read);
            }
        }
    }
    reads
}

/// Every effect with each axis that it acts on.
fn acting<'m>(machine: &'m Machine, axes: &[Axis]) -> impl Iterator<Item = (usize, &'m Effect)> {
    machine.effects().flat_map(move |effect| {
        effect.axes().iter().enumerate().filter_map(move |(k, axis)| {
            let n = axes.iter().position(|a| a == axis).filter(|_| acts(effect, Some(k)))?;
            Some((n, effect))
        })
    })
}

fn lags(machine: &Machine, axes: &[Axis]) -> Vec<LagSettling> {
    let lag = |(n, effect): (usize, &Effect)| {
        let tau_s = effect.value("tau_s").filter(|_| effect.delta.is_some())?;
        Some(LagSettling::new(n, tau_s[0]))
    };
    acting(machine, axes).filter_map(lag).collect()
}

impl ModelEvaluator {
    /// A model for these axes with input from these sensors.
    ///
    /// # Errors
    /// The model reads something that this machine does not have.
    pub(crate) fn new(
        machine: Machine,
        axes: &[Axis],
        watches: &[SensorMonitor],
    ) -> Result<Self, InputError> {
        let mut channels: Vec<String> =
            machine.effects().filter_map(Effect::channel).map(str::to_owned).collect();
        channels.dedup();
        let layout = MachineStateLayout { axes: axes.to_vec(), sensors: machine.sensors(), channels };
        let sensors = places(&machine, &layout.sensors, ("temperature", &Role::Temperature), watches)?;
        let channels = places(&machine, &layout.channels, ("channel", &Role::Channel), watches)?;
        let live = LiveModel::at_work(&machine, layout).map_err(|missing| {
            InputError::whole(&machine.path, missing.to_string(), "what the configuration has")
        })?;
        Ok(Self {
            inputs: NonAxisInputs {
                temperatures_degc: vec![STANDARD_DEGC; sensors.len()],
                channels: vec![0.0; channels.len()],
                held: vec![false; axes.len()],
                ..NonAxisInputs::default()
            },
            states: vec![SensorUsability::Hold; watches.len()],
            lost: vec![false; watches.len()],
            although_expired: false,
            rpm: of_role(watches, &Role::SpindleSpeed),
            coolant: of_role(watches, &Role::Coolant),
            loads: axes.iter().map(|a| of_role(watches, &Role::Load(a.clone()))).collect(),
            reads: reads(&machine, axes, watches),
            lags: lags(&machine, axes),
            missing: missing(&machine, axes, watches),
            ranges: FittedTemperatureRange::all(&machine, watches),
            values: vec![None; watches.len()],
            live,
            machine,
            sensors,
            channels,
        })
    }

    /// Parts of it without effect here, in sentences.
    pub(crate) fn missing(&self) -> &[String] {
        &self.missing
    }

    /// Computes the lags' states from past temperatures, oldest first.
    /// Times are on the clock of [`Self::evaluate`], s. Temperatures are in the order of the layout's sensors, °C.
    pub(crate) fn catch_up(&mut self, past: Vec<(f64, Vec<f64>)>, started_s: f64, axes: &[AxisMotionState]) {
        for (t_s, degc) in past {
            self.inputs.temperatures_degc = degc;
            let cold = self.inputs.cold();
            self.lags.iter_mut().for_each(|l| l.follow(t_s, cold));
            self.live.evaluate(&self.inputs.frame(t_s - started_s, axes, false));
        }
    }

    /// Takes over the sensors; returns whether one has become better or worse.
    pub(crate) fn read(&mut self, watches: &[SensorMonitor], now_s: f64) -> bool {
        let value = |n: usize| watches[n].value_degc();
        self.values.iter_mut().enumerate().for_each(|(n, v)| *v = value(n));
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
        for ((state, lost), watch) in self.states.iter_mut().zip(&mut self.lost).zip(watches) {
            let now = watch.usable(now_s);
            let before = std::mem::replace(state, now);
            changed |= before != now;
            *lost |= before != SensorUsability::Hold && now == SensorUsability::Hold;
        }
        for (held, reads) in self.inputs.held.iter_mut().zip(&self.reads) {
            *held = reads.iter().any(|n| self.lost[*n] || self.states[*n] == SensorUsability::Hold);
        }
        let cold = self.inputs.cold();
        for lag in &mut self.lags {
            if !self.inputs.held[lag.axis] {
                lag.follow(now_s, cold);
            }
        }
        changed
    }

    /// Notes that corrections were enabled: lost sensors that are good are used again.
    /// Returns whether there are any.
    pub(crate) fn enabled(&mut self) -> bool {
        let mut back = false;
        for (lost, state) in self.lost.iter_mut().zip(&self.states) {
            back |= *lost && *state != SensorUsability::Hold;
            *lost &= *state == SensorUsability::Hold;
        }
        back
    }

    /// Adds the axes' loads from their sensors, N.
    pub(crate) fn add_loads(&self, axes: &mut [AxisMotionState], watches: &[SensorMonitor]) {
        for (now, load) in axes.iter_mut().zip(&self.loads) {
            now.load_n = load.and_then(|w| watches[w].value_degc()).unwrap_or(0.0);
        }
    }

    /// Evaluates the model: time since the model's clock began, s.
    pub(crate) fn evaluate(&mut self, t_s: f64, axes: &[AxisMotionState], probing: bool) {
        self.live.evaluate(&self.inputs.frame(t_s, axes, probing));
    }

    /// Returns evaluations on a copy; the running state does not change.
    pub(crate) fn trial(&self) -> impl FnMut(f64, &[AxisMotionState]) {
        let mut live = self.live.clone();
        move |t_s, axes| live.evaluate(&self.inputs.frame(t_s, axes, false))
    }

    /// The error of an axis with all axes at these positions, µm.
    /// The running state does not change.
    pub(crate) fn error_um_at(&self, place: usize, t_s: f64, axes: &[AxisMotionState], probing: bool) -> f64 {
        let mut live = self.live.clone();
        live.evaluate(&self.inputs.frame(t_s, axes, probing));
        live.errors_um()[place]
    }

    /// Last error of an axis by the effects that `is` selects, µm.
    fn um_of(&self, place: usize, is: fn(&Effect) -> bool) -> f64 {
        let axis = &self.live.layout().axes[place];
        let own = |e: &Effect| e.axes().iter().position(|a| a == axis).filter(|k| acts(e, Some(*k)));
        let parts = self.live.parts().filter(|p| is(p.effect));
        parts.map(|p| own(p.effect).map_or(0.0, |k| p.value[k])).sum()
    }

    /// The part of an axis's last error that depends on its direction, µm.
    pub(crate) fn turning_um(&self, place: usize) -> f64 {
        self.um_of(place, depends_on_direction)
    }

    /// The part of an axis's last error that depends on sensors and time, µm.
    /// A chain that reads temperatures counts as a whole.
    pub(crate) fn slow_um(&self, place: usize) -> f64 {
        let axis = &self.live.layout().axes[place];
        let slow_um = self.um_of(place, is_slow);
        let along = ["x", "y", "z"].iter().position(|a| *a == axis.as_str());
        let warm = self.machine.chain().is_some_and(|c| c.deltas().next().is_some());
        slow_um + self.live.chain_um().zip(along).filter(|_| warm).map_or(0.0, |(um, k)| um[k])
    }

    /// Reason why the error of an axis is not known yet, if so.
    pub(crate) fn unknown(&self, place: usize, watches: &[SensorMonitor], now_s: f64) -> Option<String> {
        let never = self.reads[place].iter().map(|n| &watches[*n]).find(|w| w.value_degc().is_none());
        if let Some(w) = never {
            let why = w.fault().map_or("not read yet".to_owned(), ToString::to_string);
            return Some(format!("sensor {}: {why}", w.config().name));
        }
        if !self.live.errors_um()[place].is_finite() {
            return Some("the model gives no finite number here".to_owned());
        }
        let lags = self.lags.iter().filter(|l| l.axis == place);
        let longest = lags.filter_map(|l| Some((l.unknown_s(now_s)?, l.tau_s)));
        let (left_s, tau_s) = longest.max_by(|a, b| a.0.total_cmp(&b.0))?;
        Some(format!(
            "how warm the machine is inside is not known yet: no temperatures were logged for {LAGS_KNOWN} times the \
             lag of {tau_s:.0} s; it is in {left_s:.0} s"
        ))
    }

    /// Reason why the thermal correction of an axis is held, if so.
    pub(crate) fn thermal_hold_reason(
        &self,
        place: usize,
        watches: &[SensorMonitor],
        now_s: f64,
    ) -> Option<String> {
        let reads = || self.reads[place].iter().copied();
        let Some(lost) = reads().map(|n| &watches[n]).find(|w| w.usable(now_s) == SensorUsability::Hold)
        else {
            let back = &watches[reads().find(|n| self.lost[*n])?].config().name;
            return Some(format!("sensor {back} is good again: `rtecctl enable` takes its correction up"));
        };
        let why = lost.fault().map_or("silent".to_owned(), ToString::to_string);
        let age_s = lost.age_s(now_s).unwrap_or(0.0);
        Some(format!("sensor {}: {why}; its last good value is {age_s:.0} s old", lost.config().name))
    }

    /// Fits that have not seen the present thermal state.
    /// Each names the difference with the largest possible error. Only errors above the fit's own uncertainty
    /// are listed.
    fn unseen(&self) -> Vec<String> {
        let unseen = |(n, fit): (usize, &FitNote)| {
            let now = |r: &FittedTemperatureRange| {
                let v = &fit.valid[r.valid];
                let minus = r.minus.map_or(Some(v.difference.reference_degc()), |n| self.values[n])?;
                let delta_k = self.values[r.sensor]? - minus;
                Some((v, delta_k, v.outside_um(delta_k)))
            };
            let own = self.ranges.iter().filter(|r| r.fit == n).filter_map(now);
            let (v, delta_k, um) = own.max_by(|a, b| a.2.total_cmp(&b.2))?;
            let ([lo, hi], unit) = (v.range_k, FitNote::unit_of(&fit.response));
            (um > fit.half_width_um).then(|| {
                format!(
                    "{}: {} is {delta_k:.1} K, and the fit saw {lo:.1} to {hi:.1} K: up to {um:.0} {unit} may be left, not ±{:.1} {unit}",
                    fit.response, v.difference, fit.half_width_um
                )
            })
        };
        self.machine.fits().iter().enumerate().filter_map(unseen).collect()
    }

    /// Notes about the model on a day (days since 1970-01-01).
    pub(crate) fn notes(&self, today: i64) -> Vec<String> {
        let mut notes = self.machine.doubts(today);
        notes.extend(self.missing.iter().cloned());
        notes.extend(self.unseen());
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
            if p.effect.description().heat == ThermalDependence::FromStart {
                notes.push(format!("{}: its time counts from the daemon's start", p.effect.name()));
            }
        }
        notes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A lag of 100 s with uninterrupted input since 1000 s, after a gap.
    /// `cold`: the machine was cold then.
    fn lag(gap_s: f64, cold: bool) -> LagSettling {
        let mut lag = LagSettling::new(0, 100.0);
        lag.follow(1000.0 - gap_s, false);
        lag.follow(1000.0, cold);
        lag
    }

    /// A quarter of a lag is no gap.
    /// After a longer one four lags pass until it is known again.
    #[test]
    fn a_lag_forgets_over_a_gap_of_more_than_a_quarter_of_it() {
        let known_in = |lag: &LagSettling, s: f64| lag.unknown_s(1000.0 + s);
        assert_eq!(known_in(&lag(25.0, false), 0.0), Some(375.0), "since before");
        assert_eq!(known_in(&lag(26.0, false), 0.0), Some(400.0), "forgotten");
        assert_eq!(known_in(&lag(26.0, false), 399.0), Some(1.0));
        assert_eq!(known_in(&lag(26.0, false), 400.0), None, "known from then on");
        // A short lag tolerates a gap of 15 s too.
        let mut short = LagSettling::new(0, 20.0);
        short.follow(0.0, false);
        short.follow(15.0, false);
        assert_eq!(short.unknown_s(15.0), Some(65.0));
    }

    /// A cold machine that was unobserved for four lags has no unknown heat inside.
    #[test]
    fn a_cold_machine_is_known_at_once_after_four_lags_unseen() {
        assert_eq!(lag(401.0, true).unknown_s(1000.0), None);
        assert_eq!(lag(401.0, false).unknown_s(1000.0), Some(400.0), "warm");
        assert_eq!(lag(400.0, true).unknown_s(1000.0), Some(400.0), "not for longer");
    }
}
