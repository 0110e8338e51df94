//! A model evaluated at one instant, live.
//! The corrector evaluates it every 10–20 ms and the simulator at every step.
//!
//! [`LiveModel::new`] looks up everything by name once; [`LiveModel::evaluate`] allocates nothing. Effects with the
//! same inputs (axes, temperature difference, channel) share one `SharedInputs`, which is filled once per instant.
//!
//! Outside the range of ΔT that an effect was fitted on, ΔT is held at the bound and the effect fades. Let e
//! be its value at the bound, and u = |gain|·excess the part that holding leaves out. The weight is 1/(1 +
//! (u/e)²). It is one at the bound, so nothing jumps.
//!
//! An axis whose sensors are lost is held: its temperature differences and lags keep their values. Effects of
//! its position continue.

use crate::effect::{
    AffectedQuantity, Basis, Effect, EffectMemory, EffectNameAxes, Input, MissingInput, ProbingDependence,
    RequiredInput, ResolvedTemperatureDifference, STANDARD_DEGC, sign,
};
use crate::kinematic_chain::{JointInputIndices, KinematicChain};
use crate::machine::Machine;
use crate::record::Axis;

/// The order of a [`MachineState`]'s values: names of axes, sensors and channels.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct MachineStateLayout {
    /// Names of the axes.
    pub axes: Vec<Axis>,
    /// Names of the temperature sensors.
    pub sensors: Vec<String>,
    /// Names of the other logged channels.
    pub channels: Vec<String>,
}

/// The state of one axis at an instant.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct AxisMotionState {
    /// Position by the scale, mm.
    pub position_mm: f64,
    /// Velocity with its sign, mm/s.
    pub velocity_mm_s: f64,
    /// Acceleration with its sign, mm/s².
    pub acceleration_mm_s2: f64,
    /// Direction of approach, −1, 0, +1. An axis at rest keeps that of its last motion.
    pub direction: f64,
    /// Load on the axis, N.
    pub load_n: f64,
}

impl AxisMotionState {
    /// An axis moving at constant velocity; its direction is the velocity's sign.
    pub fn moving(position_mm: f64, velocity_mm_s: f64) -> Self {
        Self { position_mm, velocity_mm_s, direction: sign(velocity_mm_s), ..Self::default() }
    }
}

/// The state of the machine at an instant.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MachineState<'a> {
    /// Time on the caller's clock, s; never decreasing.
    pub t_s: f64,
    /// State of every axis of the layout.
    pub axes: &'a [AxisMotionState],
    /// Temperature of every sensor of the layout, °C.
    pub temperatures_degc: &'a [f64],
    /// Value of every channel of the layout, in the unit it is logged in.
    pub channels: &'a [f64],
    /// Speed of the spindle, rpm.
    pub rpm: f64,
    /// Coolant, on when above one half.
    pub coolant: f64,
    /// Angle on the part, rad.
    pub angle_rad: f64,
    /// Whether the machine is probing, so that effects of the probe act.
    pub probing: bool,
    /// Per axis of the layout: whether its thermal state is held.
    /// Empty if none is held.
    pub held: &'a [bool],
}

impl MachineState<'_> {
    fn holds(&self, axis: Option<usize>) -> bool {
        axis.and_then(|a| self.held.get(a)).is_some_and(|h| *h)
    }
}

/// The places in a frame of an effect's inputs.
#[derive(Debug, Clone, Copy, PartialEq)]
struct EffectInputIndices {
    /// Of the axes in the effect's name, among the layout's axes.
    axes: [Option<usize>; 3],
    delta: Option<ResolvedTemperatureDifference<usize>>,
    channel: Option<usize>,
}

/// The inputs that effects with the same places share at an instant.
#[derive(Debug, Clone)]
struct SharedInputs {
    places: EffectInputIndices,
    /// The inputs, filled at every instant.
    /// While one of a thermal effect's axes is held, its time and ΔT do not change.
    now: Input,
}

/// An effect with the places of all its inputs.
#[derive(Debug, Clone)]
struct LiveEffect {
    effect: Effect,
    coefficients: Vec<f64>,
    /// The basis and its coefficient, if the effect is just their product on one axis.
    quick: Option<(Basis, f64)>,
    /// Index of its reading.
    reading: usize,
    /// The place of each component in the sums.
    to: [usize; 2],
    /// Number of components: two for a pair.
    components: usize,
    /// Whether a weight applies: the effect may fade, or acts only while probing.
    weighed: bool,
    probing_only: bool,
    lagged: bool,
    state: EffectMemory,
    /// The present value of each component, µm or N.
    now: [f64; 2],
    /// How far ΔT is outside its fitted range, K, and the share of the effect left.
    outside_k: f64,
    weight: f64,
}

/// One effect at the last instant.
#[derive(Debug, Clone, Copy)]
pub struct EffectValue<'l> {
    /// The effect that is evaluated.
    pub effect: &'l Effect,
    /// Its value, µm or N; the second one is for a pair's second axis.
    pub value: [f64; 2],
    /// How far ΔT was outside the range the effect was fitted on, K.
    pub outside_k: f64,
    /// The share of the effect that is left outside the range; 1 inside.
    pub weight: f64,
}

/// A chain with the places of its inputs.
#[derive(Debug, Clone)]
struct LiveChain {
    chain: KinematicChain,
    /// Per joint: its axis in the layout, and its components' sensors.
    places: Vec<JointInputIndices<usize, usize>>,
    /// The places of the axes x, y, z in the layout.
    out: [Option<usize>; 3],
    /// Temperatures of the last instant at which none of its axes was held.
    degc: Vec<f64>,
    now_um: [f64; 3],
}

/// A model ready to be evaluated.
#[derive(Debug, Clone)]
pub struct LiveModel {
    layout: MachineStateLayout,
    readings: Vec<SharedInputs>,
    items: Vec<LiveEffect>,
    chain: Option<LiveChain>,
    scratch: Vec<f64>,
    /// Errors of the layout's axes, µm, then their forces, N.
    /// Then the radial error, and the sum of effects on no axis of the layout.
    sums: Vec<f64>,
}

impl LiveModel {
    /// Prepares a machine's effects and chain for evaluation.
    /// The zero of a set-up is left out, because it belongs to the gauges and not to the machine.
    ///
    /// # Errors
    /// A sensor, channel or (for the chain) axis that the layout does not have.
    pub fn of(machine: &Machine, layout: MachineStateLayout) -> Result<Self, MissingInput> {
        Self::only(machine, layout, |_| true)
    }

    /// As [`LiveModel::of`], without the effects over the angle of a circle.
    /// A machine at work has no such angle.
    ///
    /// # Errors
    /// As [`LiveModel::of`].
    pub fn at_work(machine: &Machine, layout: MachineStateLayout) -> Result<Self, MissingInput> {
        Self::only(machine, layout, |e| !e.description().needs.contains(&RequiredInput::Angle))
    }

    fn only(
        machine: &Machine,
        layout: MachineStateLayout,
        acts: impl Fn(&Effect) -> bool,
    ) -> Result<Self, MissingInput> {
        let own = machine.listed().iter().filter(|l| !l.provenance.set_up).map(|l| &l.effect);
        let mut live = Self::new(own.filter(|e| acts(e)), layout)?;
        if let Some(chain) = machine.chain() {
            let layout = &live.layout;
            let missing = |what: String, has: String| MissingInput { effect: "chain".to_owned(), what, has };
            let places = chain.places(
                |axis| {
                    let has = || layout.axes.iter().map(Axis::as_str).collect::<Vec<_>>().join(", ");
                    let place = layout.axes.iter().position(|a| a == axis);
                    place.map(Some).ok_or_else(|| missing(format!("position.{axis}"), has()))
                },
                |sensor| {
                    let place = layout.sensors.iter().position(|s| s == sensor);
                    place.ok_or_else(|| missing(format!("temperature.{sensor}"), layout.sensors.join(", ")))
                },
            )?;
            let out = ["x", "y", "z"].map(|n| layout.axes.iter().position(|a| a.as_str() == n));
            live.chain = Some(LiveChain {
                chain: chain.clone(),
                places,
                out,
                degc: vec![STANDARD_DEGC; live.layout.sensors.len()],
                now_um: [0.0; 3],
            });
        }
        Ok(live)
    }

    /// Prepares effects for evaluation: looks up all that they read.
    ///
    /// # Errors
    /// A sensor or channel that the layout does not have. An axis that it does not have reads as zero.
    pub fn new<'e>(
        effects: impl IntoIterator<Item = &'e Effect>,
        layout: MachineStateLayout,
    ) -> Result<Self, MissingInput> {
        let (mut items, mut readings) = (Vec::new(), Vec::<SharedInputs>::new());
        let mut longest = 0;
        let count = layout.axes.len();
        for effect in effects {
            let find = |what: &str, names: &[String], name: &str| {
                names.iter().position(|n| n == name).ok_or_else(|| MissingInput {
                    effect: effect.name(),
                    what: format!("{what}.{name}"),
                    has: names.join(", "),
                })
            };
            let mut axes = [None; 3];
            for (place, axis) in axes.iter_mut().zip(effect.axes()) {
                *place = layout.axes.iter().position(|a| a == axis);
            }
            let reads_delta = effect.description().needs.contains(&RequiredInput::Delta);
            let delta = effect.delta.as_ref().filter(|_| reads_delta);
            let sensor = |name: &str| find("temperature", &layout.sensors, name);
            let delta = delta.map(|delta| delta.find(sensor)).transpose()?;
            let channel = effect.channel().map(|c| find("channel", &layout.channels, c)).transpose()?;
            longest = longest.max(effect.coefficient_count());
            let places = EffectInputIndices { axes, delta, channel };
            let reading = readings.iter().position(|r| r.places == places).unwrap_or_else(|| {
                readings.push(SharedInputs { places, now: Input::default() });
                readings.len() - 1
            });
            let law = effect.description();
            let to = |component: usize| match (axes[component], law.quantity) {
                (Some(a), AffectedQuantity::Error) => a,
                (Some(a), AffectedQuantity::Force) => count + a,
                (None, _) if law.naming == EffectNameAxes::Plain => 2 * count,
                (None, _) => 2 * count + 1,
            };
            let coefficients = effect.coefficients();
            let components = if law.naming == EffectNameAxes::Pair { 2 } else { 1 };
            let weighed = effect.range_k.is_some() || law.probing == ProbingDependence::Only;
            let quick = match coefficients[..] {
                [only] if components == 1 && !weighed => effect.law().stateless().map(|basis| (basis, only)),
                _ => None,
            };
            items.push(LiveEffect {
                coefficients,
                quick,
                reading,
                to: [to(0), to(1)],
                components,
                weighed,
                probing_only: law.probing == ProbingDependence::Only,
                lagged: law.lag.is_some(),
                state: EffectMemory::default(),
                now: [0.0; 2],
                outside_k: 0.0,
                weight: 1.0,
                effect: effect.clone(),
            });
        }
        let (scratch, sums) = (vec![0.0; longest], vec![0.0; 2 * count + 2]);
        Ok(Self { layout, readings, items, chain: None, scratch, sums })
    }

    /// The layout it was made for.
    pub fn layout(&self) -> &MachineStateLayout {
        &self.layout
    }

    /// Evaluates all effects at an instant.
    /// The time must not decrease from call to call, because lags and reversals follow it.
    ///
    /// # Panics
    /// When the frame has fewer values than the layout has names.
    pub fn evaluate(&mut self, frame: &MachineState<'_>) {
        for reading in &mut self.readings {
            reading.fill(frame);
        }
        self.sums.fill(0.0);
        for item in &mut self.items {
            let now = &self.readings[item.reading].now;
            if let Some((basis, coefficient)) = item.quick {
                let mut value = [0.0];
                basis(now, 0, &mut value);
                item.now[0] = coefficient * value[0];
                self.sums[item.to[0]] += item.now[0];
                continue;
            }
            let basis = &mut self.scratch[..item.coefficients.len()];
            let mut component = 0;
            loop {
                let before = item.state;
                item.effect.law().basis(&item.effect, now, component, &mut item.state, basis);
                let mut value = match (&*item.coefficients, &*basis) {
                    // Most laws have one or two coefficients, and a loop would take longer than the sum.
                    ([c], [b]) => c * b,
                    ([c, d], [a, b]) => c * a + d * b,
                    (all, basis) => all.iter().zip(basis).map(|(c, b)| c * b).sum(),
                };
                if item.weighed {
                    let first = basis.first().copied().unwrap_or(0.0);
                    value = item.weigh(value, first, now.delta_k, frame.probing);
                }
                item.now[component] = value;
                self.sums[item.to[component]] += value;
                if component + 1 == item.components {
                    break;
                }
                // Both components of a pair start from the same state.
                item.state = before;
                component = 1;
            }
        }
        if let Some(live) = &mut self.chain {
            if !live.out.iter().any(|a| frame.holds(*a)) {
                live.degc.copy_from_slice(&frame.temperatures_degc[..self.layout.sensors.len()]);
            }
            let position = |axis: &usize| frame.axes[*axis].position_mm;
            live.now_um = live.chain.error_at_um(&live.places, position, |sensor| live.degc[*sensor]);
            for (place, e) in live.out.iter().zip(live.now_um) {
                if let Some(a) = place {
                    self.sums[*a] += e;
                }
            }
        }
    }

    /// Error of every axis of the layout at the last instant, µm.
    pub fn errors_um(&self) -> &[f64] {
        &self.sums[..self.layout.axes.len()]
    }

    /// Force of every axis of the layout at the last instant, N.
    pub fn forces_n(&self) -> &[f64] {
        let axes = self.layout.axes.len();
        &self.sums[axes..2 * axes]
    }

    /// Radial error of the probe's and the part's own effects at the last instant, µm.
    pub fn radial_um(&self) -> f64 {
        self.sums[2 * self.layout.axes.len()]
    }

    /// Every effect with its value at the last instant.
    pub fn parts(&self) -> impl Iterator<Item = EffectValue<'_>> {
        self.items.iter().map(|i| EffectValue {
            effect: &i.effect,
            value: i.now,
            outside_k: i.outside_k,
            weight: i.weight,
        })
    }

    /// The chain's error at the last instant, µm along x, y, z.
    pub fn chain_um(&self) -> Option<[f64; 3]> {
        self.chain.as_ref().map(|c| c.now_um)
    }
}

impl SharedInputs {
    fn fill(&mut self, frame: &MachineState<'_>) {
        let EffectInputIndices { axes, delta, channel } = &self.places;
        let nowhere = AxisMotionState::default();
        let at = |n: usize| axes[n].map_or(&nowhere, |a| &frame.axes[a]);
        let first = at(0);
        let mut thermal = (0.0, frame.t_s);
        if let Some(delta) = delta {
            thermal = (self.now.delta_k, self.now.t_s);
            if !axes.iter().any(|a| frame.holds(*a)) {
                thermal = (delta.kelvin(|sensor| frame.temperatures_degc[*sensor]), frame.t_s);
            }
        }
        self.now = Input {
            t_s: thermal.1,
            p_mm: [first.position_mm, at(1).position_mm, at(2).position_mm],
            dir: first.direction,
            past_mm: 0.0,
            v_mm_s: first.velocity_mm_s,
            a_mm_s2: first.acceleration_mm_s2,
            load_n: first.load_n,
            delta_k: thermal.0,
            rpm: frame.rpm,
            coolant: frame.coolant,
            angle_rad: frame.angle_rad,
            channel: channel.map_or(0.0, |c| frame.channels[c]),
        };
    }
}

impl LiveEffect {
    /// The value times its weight; zero for a probe's effect while nothing is probed.
    fn weigh(&mut self, value: f64, first: f64, delta_k: f64, probing: bool) -> f64 {
        self.fade(value, first, delta_k);
        if self.probing_only && !probing { 0.0 } else { value * self.weight }
    }

    /// Sets how far ΔT (after any lag) is outside the range, and the weight left.
    ///
    /// The weight gives the value nearest to the truth if the part left out beyond the bound is unknown. Half
    /// of the effect is left if the unknown is as large as the value.
    /// Fading never removes more than half of the unknown, so two effects that nearly cancel also do so
    /// beyond the bound.
    /// `first` is the law's first basis function, at the bound.
    fn fade(&mut self, value: f64, first: f64, delta_k: f64) {
        let Some([lo, hi]) = self.effect.range_k else { return };
        // The first value of a lag's state is the lagged difference.
        let asked = if self.lagged { self.state.x[0] } else { delta_k };
        self.outside_k = (asked - hi).max(lo - asked).max(0.0);
        let bound = asked.clamp(lo, hi);
        // The first basis function per kelvin: 1 for growth, the position for an expansion.
        let per_k = if bound == 0.0 { 1.0 } else { first / bound };
        let left_out = self.coefficients.first().map_or(0.0, |gain| (gain * per_k).abs() * self.outside_k);
        let known = value * value;
        self.weight = if left_out > 0.0 { known / (known + left_out * left_out) } else { 1.0 };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Regression: the zero of a gauge was corrected on the machine's axes.
    #[test]
    fn the_zero_of_a_set_up_is_never_corrected() {
        let of = |text: &str| Machine::parse(std::path::Path::new("m.toml"), text).unwrap();
        let own = "[[effect]]\nname = \"offset.z\"\num = 2.0\n";
        let zero = "[[effect]]\nname = \"offset.z\"\num = 7.0\nset_up = true\n";
        for (text, um) in [(own.to_owned(), 2.0), (zero.to_owned(), 0.0), (format!("{zero}{own}"), 2.0)] {
            let machine = of(&format!("name = \"m\"\n{text}"));
            assert_eq!(of(&machine.to_text()).listed(), machine.listed());
            let layout =
                MachineStateLayout { axes: vec![Axis::new("z").unwrap()], ..MachineStateLayout::default() };
            let mut live = LiveModel::of(&machine, layout).unwrap();
            live.evaluate(&MachineState { axes: &[AxisMotionState::default()], ..MachineState::default() });
            assert!((live.errors_um()[0] - um).abs() < 1e-12, "{text}");
        }
        for law in ["scale.z\"\nppm = 2.0\n", "force_offset.z\"\nN = 2.0\n"] {
            let text = format!("name = \"m\"\n[[effect]]\nname = \"{law}set_up = true\n");
            let e = Machine::parse(std::path::Path::new("m.toml"), &text).unwrap_err();
            assert!(e.to_string().contains("set_up for a zero alone"), "{e}");
        }
    }

    #[test]
    fn outside_its_range_an_effect_fades_without_a_jump() {
        let text = "name = \"m\"\n[[fit]]\nresponse = \"error.z\"\ndate = \"2026-01-01\"\nvalid_until = \"2027-01-01\"\n\
                    rms_um = 0.4\nhalf_width_um = 0.8\n[[effect]]\nname = \"thermal_growth.z\"\nsensor = \"T1\"\n\
                    um_per_K = 2.0\num_per_K2 = -0.3\nrange_K = [0.0, 4.0]\n";
        let machine = Machine::parse(std::path::Path::new("m.toml"), text).unwrap();
        let layout = MachineStateLayout {
            axes: vec![Axis::new("z").unwrap()],
            sensors: vec!["T1".into()],
            channels: vec![],
        };
        let mut live = LiveModel::of(&machine, layout).unwrap();
        let mut at = |degc: f64| {
            let frame = MachineState {
                axes: &[AxisMotionState::default()],
                temperatures_degc: &[degc],
                ..MachineState::default()
            };
            live.evaluate(&frame);
            let part = live.parts().next().unwrap();
            (live.errors_um()[0], part.weight, part.outside_k)
        };
        let top = 2.0 * 4.0 - 0.3 * 16.0;
        assert!((at(24.0).0 - top).abs() < 1e-12 && (at(24.0 + 1e-6).0 - top).abs() < 1e-9);
        // 1.6 K outside leave 3.2 µm unknown, as much as the effect's value, so half is left.
        let (e, weight, outside) = at(25.6);
        assert!((weight - 0.5).abs() < 1e-9 && (e - top / 2.0).abs() < 1e-9 && (outside - 1.6).abs() < 1e-9);
        assert!(at(60.0).0.abs() < 0.01);
    }

    /// Two lags nearly cancel, as fits make them.
    /// A little beyond the range of one, fading removes no more than is unknown there.
    #[test]
    fn fading_takes_less_than_is_unknown() {
        let effect = |sensor: &str, gain: f64, hi: f64| {
            format!(
                "[[effect]]\nname = \"thermal_growth.z\"\nsensor = \"{sensor}\"\num_per_K = {gain:.1}\num_per_K2 = 0.0\n\
                 range_K = [0.0, {hi:.1}]\n"
            )
        };
        let layout = || MachineStateLayout {
            axes: vec![Axis::new("z").unwrap()],
            sensors: vec!["T1".into(), "T2".into()],
            channels: vec![],
        };
        for (gain, hi) in [(45.0, 6.2), (5.0, 10.0), (2.0, 3.0)] {
            let text = format!("name = \"m\"\n{}{}", effect("T1", gain, hi), effect("T2", -0.7 * gain, 50.0));
            let machine = Machine::parse(std::path::Path::new("m.toml"), &text).unwrap();
            let mut live = LiveModel::of(&machine, layout()).unwrap();
            for beyond_k in [0.0, 0.01, 0.1, 0.5, 1.0, 3.0, 10.0, 100.0] {
                let degc = 20.0 + hi + beyond_k;
                let frame = MachineState {
                    axes: &[AxisMotionState::default()],
                    temperatures_degc: &[degc, 20.0 + hi],
                    ..MachineState::default()
                };
                live.evaluate(&frame);
                let (e, at_the_bound) = (live.errors_um()[0], 0.3 * gain * hi);
                let unknown = gain * beyond_k;
                assert!(
                    (e - at_the_bound).abs() <= 0.5 * unknown + 1e-9,
                    "{gain} {beyond_k}: {e}, {at_the_bound}"
                );
            }
        }
    }
}
