//! A model evaluated at one instant: what the corrector asks every 10–20 ms and the simulator at every step.
//!
//! Everything is looked up by name once, in [`Live::new`]; [`Live::evaluate`] allocates nothing.

use crate::effect::{Against, Effect, Input, Missing, Naming, Need, Quantity, STANDARD_DEGC, State, sign};
use crate::record::Axis;

/// Where the values of a [`Frame`] stand: names of axes, sensors and channels, in the frame's order.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Layout {
    /// Axes.
    pub axes: Vec<Axis>,
    /// Temperature sensors.
    pub sensors: Vec<String>,
    /// Other logged channels.
    pub channels: Vec<String>,
}

/// One axis at an instant.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct AxisNow {
    /// Position, mm.
    pub position_mm: f64,
    /// Velocity, mm/s.
    pub velocity_mm_s: f64,
    /// Acceleration, mm/s².
    pub acceleration_mm_s2: f64,
    /// Direction of approach, −1, 0, +1. An axis at rest keeps that of its last motion.
    pub direction: f64,
    /// Load, N.
    pub load_n: f64,
}

impl AxisNow {
    /// An axis moving at constant velocity; its direction is the velocity's sign.
    #[must_use]
    pub fn moving(position_mm: f64, velocity_mm_s: f64) -> Self {
        Self { position_mm, velocity_mm_s, direction: sign(velocity_mm_s), ..Self::default() }
    }
}

/// The machine at an instant.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Frame<'a> {
    /// Time, s.
    pub t_s: f64,
    /// Per axis of the layout.
    pub axes: &'a [AxisNow],
    /// Per sensor of the layout, °C.
    pub temperatures_degc: &'a [f64],
    /// Per channel of the layout.
    pub channels: &'a [f64],
    /// Spindle speed, rpm.
    pub rpm: f64,
    /// Coolant, on when above one half.
    pub coolant: f64,
    /// Angle on the part, rad.
    pub angle_rad: f64,
    /// The machine is probing: effects of the probe act.
    pub probing: bool,
}

/// An effect with everything it reads looked up.
#[derive(Debug, Clone)]
struct Item {
    effect: Effect,
    coefficients: Vec<f64>,
    /// Places of the name's axes among the layout's.
    axes: [Option<usize>; 3],
    /// Places of the sensor and of the one to take off.
    sensor: Option<usize>,
    minus: Option<usize>,
    reference: f64,
    channel: Option<usize>,
    probing_only: bool,
    components: usize,
    state: State,
    /// What each component is worth now.
    now: [f64; 2],
}

/// A model ready to be evaluated.
#[derive(Debug, Clone)]
pub struct Live {
    layout: Layout,
    items: Vec<Item>,
    scratch: Vec<f64>,
    errors_um: Vec<f64>,
    forces_n: Vec<f64>,
    radial_um: f64,
}

impl Live {
    /// Looks up everything the effects read.
    ///
    /// # Errors
    /// A sensor or channel that the layout does not have. An axis that it does not have reads as zero.
    pub fn new<'e>(effects: impl IntoIterator<Item = &'e Effect>, layout: Layout) -> Result<Self, Missing> {
        let mut items = Vec::new();
        let mut longest = 0;
        for effect in effects {
            let find = |what: &str, names: &[String], name: &str| {
                names.iter().position(|n| n == name).ok_or_else(|| Missing {
                    effect: effect.name(),
                    what: format!("{what}.{name}"),
                    has: names.join(", "),
                })
            };
            let mut axes = [None; 3];
            for (place, axis) in axes.iter_mut().zip(effect.axes()) {
                *place = layout.axes.iter().position(|a| a == axis);
            }
            let (mut sensor, mut minus, mut reference) = (None, None, STANDARD_DEGC);
            if let Some(delta) = effect.delta.as_ref().filter(|_| effect.card().needs.contains(&Need::Delta))
            {
                sensor = Some(find("temperature", &layout.sensors, &delta.sensor)?);
                match &delta.against {
                    Against::Sensor(m) => minus = Some(find("temperature", &layout.sensors, m)?),
                    Against::Reference(degc) => reference = *degc,
                    Against::Standard => {}
                }
            }
            let channel = effect.channel().map(|c| find("channel", &layout.channels, c)).transpose()?;
            longest = longest.max(effect.coefficient_count());
            items.push(Item {
                coefficients: effect.coefficients(),
                axes,
                sensor,
                minus,
                reference,
                channel,
                probing_only: effect.card().name == "probe_latency",
                components: if effect.card().naming == Naming::Pair { 2 } else { 1 },
                state: State::default(),
                now: [0.0; 2],
                effect: effect.clone(),
            });
        }
        let axes = layout.axes.len();
        Ok(Self {
            layout,
            items,
            scratch: vec![0.0; longest],
            errors_um: vec![0.0; axes],
            forces_n: vec![0.0; axes],
            radial_um: 0.0,
        })
    }

    /// The layout it was made for.
    #[must_use]
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Forgets lags and reversals: the next instant is the first of a new start.
    pub fn restart(&mut self) {
        for item in &mut self.items {
            item.state = State::default();
        }
    }

    /// Evaluates all effects at an instant. Call it with time never decreasing: lags and reversals move on with it.
    ///
    /// # Panics
    /// When the frame has fewer values than the layout has names.
    pub fn evaluate(&mut self, frame: &Frame<'_>) {
        self.errors_um.fill(0.0);
        self.forces_n.fill(0.0);
        self.radial_um = 0.0;
        for item in &mut self.items {
            let at = |n: usize| item.axes[n].map_or(AxisNow::default(), |a| frame.axes[a]);
            let first = at(0);
            let delta_k = item.sensor.map_or(0.0, |s| {
                let from = item.minus.map_or(item.reference, |m| frame.temperatures_degc[m]);
                frame.temperatures_degc[s] - from
            });
            let input = Input {
                t_s: frame.t_s,
                p_mm: [first.position_mm, at(1).position_mm, at(2).position_mm],
                dir: first.direction,
                v_mm_s: first.velocity_mm_s,
                a_mm_s2: first.acceleration_mm_s2,
                load_n: first.load_n,
                delta_k,
                rpm: frame.rpm,
                coolant: frame.coolant,
                angle_rad: frame.angle_rad,
                channel: item.channel.map_or(0.0, |c| frame.channels[c]),
            };
            let basis = &mut self.scratch[..item.coefficients.len()];
            let law = item.effect.law();
            let before = item.state;
            for component in 0..item.components {
                // Both components of a pair start from the same state.
                item.state = before;
                law.basis(&item.effect, &input, component, &mut item.state, basis);
                let value: f64 = item.coefficients.iter().zip(basis.iter()).map(|(c, b)| c * b).sum();
                let value = if item.probing_only && !frame.probing { 0.0 } else { value };
                item.now[component] = value;
                match (item.axes[component], law.card().quantity) {
                    (Some(a), Quantity::Error) => self.errors_um[a] += value,
                    (Some(a), Quantity::Force) => self.forces_n[a] += value,
                    (None, _) if law.card().naming == Naming::Plain => self.radial_um += value,
                    (None, _) => {}
                }
            }
        }
    }

    /// Error of every axis of the layout at the last instant, µm.
    #[must_use]
    pub fn errors_um(&self) -> &[f64] {
        &self.errors_um
    }

    /// Force of every axis of the layout at the last instant, N.
    #[must_use]
    pub fn forces_n(&self) -> &[f64] {
        &self.forces_n
    }

    /// Radial error of the probe's and the part's own effects at the last instant, µm.
    #[must_use]
    pub fn radial_um(&self) -> f64 {
        self.radial_um
    }

    /// Every effect with what it was worth at the last instant (µm or N; the second value is a pair's second axis).
    pub fn contributions(&self) -> impl Iterator<Item = (&Effect, [f64; 2])> {
        self.items.iter().map(|i| (&i.effect, i.now))
    }
}
