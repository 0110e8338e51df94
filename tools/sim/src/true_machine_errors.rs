//! The machine's errors over time: the effects of its model under its own heat.
//! They move tool and probe alike.

use crate::machine::SimMachine;
use crate::noise::NoiseGenerator;
use crate::thermal_network::{SENSORS, ThermalNetwork};
use crate::trajectory::{AXES, AXIS_NAMES};
use rtec_model::effect::{Effect, EffectOwner, MechanicalParameter};
use rtec_model::live_evaluation::{AxisMotionState, LiveModel, MachineState, MachineStateLayout};
use rtec_model::record::Axis;

/// Inputs that a model of the simulated machine may read.
/// They are the controller's axes, all sensors and these channels.
pub(crate) fn layout(channels: Vec<String>) -> MachineStateLayout {
    MachineStateLayout {
        axes: AXIS_NAMES.iter().filter_map(|n| Axis::new(n)).collect(),
        sensors: SENSORS.iter().map(|s| s.0.to_owned()).collect(),
        channels,
    }
}

/// Whether an effect belongs to the probe, not to the machine or the part.
pub(crate) fn of_the_probe(effect: &Effect) -> bool {
    effect.description().owner == EffectOwner::Probe
}

/// Delay from contact to the probe's line by the true machine's effects, ns.
pub(crate) fn probe_delay_ns<'e>(effects: impl IntoIterator<Item = &'e Effect>) -> u64 {
    let late =
        effects.into_iter().filter(|e| e.description().mechanism == Some(MechanicalParameter::ProbeDelay));
    let us = late.map(|e| e.scalar(0)).fold(0.0, f64::max);
    (us * 1000.0) as u64
}

/// Sets the forces that the true machine's effects describe, on all its axes.
pub(crate) fn set_friction(machine: &mut SimMachine, effects: &[&Effect]) {
    for (axis, &p) in machine.axes.iter_mut().zip(&machine.place) {
        let of_axis = |e: &&Effect| e.axes().first().is_some_and(|a| a.as_str() == AXIS_NAMES[p]);
        for effect in effects.iter().copied().filter(of_axis) {
            let value = effect.values().first().copied().unwrap_or(0.0);
            match effect.description().mechanism {
                Some(MechanicalParameter::Mass) => axis.spec.mass_kg = value,
                Some(MechanicalParameter::ViscousFriction) => axis.spec.viscous_n_s_per_m = value,
                Some(MechanicalParameter::CoulombFriction) => axis.spec.coulomb_n = value,
                Some(MechanicalParameter::AsymmetricFriction) => axis.asymmetric_n_s_per_m = value,
                Some(MechanicalParameter::ConstantForce) => axis.offset_n = value,
                Some(MechanicalParameter::ProbeDelay) | None => {}
            }
        }
    }
}

/// The true machine's errors, and the heat that causes them.
#[derive(Debug)]
pub(crate) struct TrueMachineErrors {
    pub heat: ThermalNetwork,
    truth: LiveModel,
    pub channels: Vec<f64>,
    noise: NoiseGenerator,
}

impl TrueMachineErrors {
    pub(crate) fn new(truth: LiveModel, heat: ThermalNetwork, seed: u64) -> Self {
        let channels = vec![0.0; truth.layout().channels.len()];
        Self { heat, truth, channels, noise: NoiseGenerator::new(seed, 0xC0) }
    }

    pub(crate) fn channel_names(&self) -> &[String] {
        &self.truth.layout().channels
    }

    /// The present readings on a machine under these loads.
    /// Their order is that of [`CorrectorWithSensors`](crate::corrector_with_sensors::CorrectorWithSensors).
    pub(crate) fn readings(&self, machine: &SimMachine, load_n: [f64; AXES]) -> impl Iterator<Item = f64> {
        let others = [machine.rpm, f64::from(u8::from(machine.coolant))];
        let logged = self.heat.readings_degc().iter().chain(&self.channels).copied();
        logged.chain(others).chain(load_n)
    }

    /// Advances the channels by one second.
    pub(crate) fn move_channels(&mut self) {
        for channel in &mut self.channels {
            *channel += 0.1 * self.noise.normal() - 0.002 * *channel;
        }
    }

    /// Evaluates the errors at the machine's position and moves its tool by them.
    pub(crate) fn act(&mut self, t_s: f64, machine: &mut SimMachine, load_n: &[f64; AXES], angle_rad: f64) {
        let mut axes = [AxisMotionState::default(); AXES];
        for n in 0..machine.axes.len() {
            let p = machine.place[n];
            axes[p] = AxisMotionState { load_n: load_n[p], ..machine.motion(n) };
        }
        self.truth.evaluate(&MachineState {
            t_s,
            axes: &axes,
            temperatures_degc: self.heat.readings_degc(),
            channels: &self.channels,
            rpm: machine.rpm,
            coolant: f64::from(u8::from(machine.coolant)),
            angle_rad,
            ..MachineState::default()
        });
        machine.tool_offset_mm = self.errors_um().map(|e| e / 1000.0);
    }

    /// The last evaluated errors of X, Y, Z, µm.
    pub(crate) fn errors_um(&self) -> [f64; AXES] {
        let mut errors_um = [0.0; AXES];
        errors_um.copy_from_slice(&self.truth.errors_um()[..AXES]);
        errors_um
    }

    /// Radial effects at the last evaluated angle, µm.
    /// They are the part's form, and the probe's additional reach.
    pub(crate) fn radial_um(&self) -> (f64, f64) {
        let probe_um = self.truth.parts().filter(|p| of_the_probe(p.effect)).map(|p| p.value[0]).sum::<f64>();
        (self.truth.radial_um() - probe_um, probe_um)
    }
}
