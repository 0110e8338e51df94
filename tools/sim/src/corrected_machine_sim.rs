//! The machine with the unchanged engine in its feedback, and a corrector.

use crate::axis::AxisSpec;
use crate::corrected_axis::GateInsertionDesign;
use crate::corrector_with_sensors::{CorrectorWithSensors, REST_NS, WINDOW_COUNTS};
use crate::gate_corrected_axes::GateCorrectedAxes;
use crate::machine::{ControllerFault, ControllerLimits, SimMachine};
use crate::nc_block::Block;
use crate::thermal_network::{ThermalNetwork, ThermalNetworkSpec};
use crate::trajectory::{AXES, Setpoint};
use crate::true_machine_errors::{TrueMachineErrors, layout, probe_delay_ns, set_friction};
use rtec_correct::AxisCorrectionSettings;
use rtec_driver::card::{AxisLines, CardError, MachineLines};
use rtec_files::InputError;
use rtec_model::effect::MissingInput;
use rtec_model::live_evaluation::{AxisMotionState, LiveModel};
use rtec_model::machine::Machine;
use rtec_rt::axis::{AxisConfig, InsertionAtRestPolicy};
use rtec_rt::engine::StartError;
use rtec_rt::link_messages::{CorrectorStatus, Event, EventKind, Fault, RequestToRt};

pub use crate::corrector_with_sensors::CONTROL_NS;

/// Keeps an event of the engine, which then goes on.
pub(crate) fn keep(events: &mut Vec<Event>, event: Event) -> bool {
    events.push(event);
    true
}

/// Construction of a machine.
#[derive(Debug, Clone)]
pub struct MachineSpec {
    /// The machine's axes.
    pub axes: Vec<AxisSpec>,
    /// The machine's controller.
    pub controller: ControllerLimits,
    /// Insertion design of every axis.
    pub design: GateInsertionDesign,
    /// Policy for an axis at rest.
    pub rest: InsertionAtRestPolicy,
    /// Longest time from an edge until the engine acts on it, ns, for the gate.
    pub detect_ns: u64,
    /// Longest time of a write to the card, ns.
    pub write_ns: u64,
    /// Temperature of the hall, °C.
    pub ambient_degc: f64,
    /// Its thermal properties.
    pub network: ThermalNetworkSpec,
}

impl MachineSpec {
    /// The machining centre of WO 97/43703: X 24 in, Y 28 in, Z 60 in.
    pub fn machining_centre() -> Self {
        Self::new(vec![AxisSpec::new("x", 609.6), AxisSpec::new("y", 711.2), AxisSpec::new("z", 1524.0)])
    }

    /// The turning centre of NISTIR 4832: X and Z, 1 µm scales.
    pub fn turning_centre() -> Self {
        Self::new(vec![AxisSpec::new("x", 400.0), AxisSpec::new("z", 1000.0)])
    }

    /// A machine with these axes, corrected by Design C, also at rest.
    pub fn new(axes: Vec<AxisSpec>) -> Self {
        Self {
            axes,
            controller: ControllerLimits::default(),
            design: GateInsertionDesign::C,
            rest: InsertionAtRestPolicy::Insert { after_ns: REST_NS },
            detect_ns: 500,
            write_ns: 200,
            ambient_degc: 20.0,
            network: ThermalNetworkSpec::default(),
        }
    }

    /// Lead at which errors are evaluated, s.
    /// It is one control period plus the lag of the position loop.
    fn lead_s(&self) -> f64 {
        let gain = self.axes.iter().map(|a| a.position_gain_per_s).fold(f64::INFINITY, f64::min);
        CONTROL_NS as f64 * 1e-9 + 1.0 / gain
    }

    /// The control side with the errors in `known`.
    fn control(
        &self,
        configs: &[AxisConfig],
        channels: &[String],
        known: &Machine,
    ) -> Result<CorrectorWithSensors, InputError> {
        let axes = self.axes.iter().zip(configs).map(|(axis, config)| AxisCorrectionSettings {
            name: axis.name.to_owned(),
            count_um: axis.count_um,
            increment_counts: self.design.increment_counts(),
            window_counts: config.window_counts,
            max_counts: config.max_correction_counts,
        });
        let mut control = CorrectorWithSensors::new(axes.collect(), channels, self.lead_s());
        control.load(known, &[])?;
        Ok(control)
    }

    /// The engine's configuration of each axis.
    fn configs(&self, machine: &SimMachine) -> Vec<AxisConfig> {
        let config = |(axis, &lines): (&AxisSpec, &AxisLines)| AxisConfig {
            lines,
            max_correction_counts: 5000,
            window_counts: WINDOW_COUNTS,
            min_separation_ns: 500,
            // The servo may exceed the acceleration of the trajectory.
            max_accel_counts_s2: 4.0 * axis.accel_mm_s2 * 1000.0 / axis.count_um,
            hysteresis_counts: axis.hysteresis_counts,
            rest: self.rest,
            detect_ns: self.detect_ns,
            write_ns: self.write_ns,
            ..AxisConfig::default()
        };
        self.axes.iter().zip(machine.lines()).map(config).collect()
    }
}

/// Reason why a simulation cannot be made or continued.
#[derive(Debug, thiserror::Error)]
pub enum SimError {
    /// An effect reads a sensor or channel that the simulated machine does not have.
    #[error(transparent)]
    Missing(#[from] MissingInput),
    /// The corrector's model reads something that the simulated machine does not have.
    #[error(transparent)]
    Model(#[from] InputError),
    /// The engine cannot correct the machine as specified.
    #[error(transparent)]
    Start(#[from] StartError),
    /// The simulated card failed, which it never does.
    #[error(transparent)]
    Card(#[from] CardError),
    /// The controller stopped.
    #[error("the controller stopped at {t_s:.3} s: {fault:?}")]
    Servo {
        /// Time of the stop, s of the simulation's time.
        t_s: f64,
        /// The controller's fault.
        fault: ControllerFault,
    },
    /// The engine latched a fault.
    #[error("the engine latched {fault:?} at {t_s:.3} s")]
    Engine {
        /// Time of the fault, s of the simulation's time.
        t_s: f64,
        /// The fault that the engine latched.
        fault: Fault,
    },
}

/// State of the machine at one moment.
#[derive(Debug, Clone, PartialEq)]
pub struct MachineSnapshot {
    /// Time of the simulation, s.
    pub t_s: f64,
    /// The controller's command.
    pub command: Setpoint,
    /// Motion of X, Y, Z by the scales.
    pub axes: [AxisMotionState; AXES],
    /// Position by the controller's count, mm.
    pub counted_mm: [f64; AXES],
    /// Force of the drives, N.
    pub force_n: [f64; AXES],
    /// The true machine's error: tool minus scale, µm.
    pub error_um: [f64; AXES],
    /// Inserted correction, µm.
    pub inserted_um: [f64; AXES],
    /// Speed of the spindle, rpm.
    pub rpm: f64,
    /// The coolant flows.
    pub coolant: bool,
}

impl MachineSnapshot {
    /// The tool's deviation from its position by the controller, µm.
    /// It is the machine's error minus the inserted correction.
    pub fn off_um(&self, axis: usize) -> f64 {
        self.error_um[axis] - self.inserted_um[axis]
    }
}

/// A running simulation: machine, engine and control law together.
#[derive(Debug)]
pub struct CorrectedMachineSim {
    /// The machine under the engine.
    pub machine: SimMachine,
    corrected: GateCorrectedAxes,
    pub(crate) errors: TrueMachineErrors,
    control: Option<CorrectorWithSensors>,
    control_ns: u64,
    next_control_ns: u64,
    events: Vec<Event>,
    /// Load on X, Y, Z, N, set by the simulated cut.
    pub load_n: [f64; AXES],
}

impl CorrectedMachineSim {
    /// A cold machine at rest, homed at `at_mm` (X, Y, Z), with the errors of `truth`.
    /// `known` is the corrector's model; with `None` corrections are off.
    ///
    /// # Errors
    /// An effect reads what the machine does not have, or no time is left for an insertion.
    pub fn new(
        spec: &MachineSpec,
        truth: &Machine,
        known: Option<&Machine>,
        at_mm: [f64; AXES],
        seed: u64,
    ) -> Result<Self, SimError> {
        let effects = truth.effects().chain(known.into_iter().flat_map(Machine::effects));
        let mut channels: Vec<String> = effects.filter_map(|e| e.channel().map(str::to_owned)).collect();
        channels.sort();
        channels.dedup();
        let mut machine = SimMachine::new(&spec.axes, spec.controller.clone(), at_mm);
        set_friction(&mut machine, &truth.effects().collect::<Vec<_>>());
        machine.set_surface(None, probe_delay_ns(truth.effects()));
        let configs = spec.configs(&machine);
        let origins: Vec<i64> = machine.axes.iter().map(|axis| axis.origin).collect();
        let lines = MachineLines::standard();
        let corrected =
            GateCorrectedAxes::new(spec.design, &mut machine, &configs, lines, &origins, &mut |_| true)?;
        let control = known.map(|known| spec.control(&configs, &channels, known)).transpose()?;
        let heat = ThermalNetwork::cold(spec.ambient_degc, 0.02, seed).with_network(spec.network.clone());
        let mut sim = Self {
            machine,
            corrected,
            errors: TrueMachineErrors::new(LiveModel::of(truth, layout(channels))?, heat, seed),
            control,
            control_ns: CONTROL_NS,
            next_control_ns: CONTROL_NS,
            events: Vec::new(),
            load_n: [0.0; AXES],
        };
        sim.act();
        Ok(sim)
    }

    /// Gives the errors in `known` to a corrector without a model.
    ///
    /// # Errors
    /// An effect reads what the machine does not have.
    pub fn know(&mut self, spec: &MachineSpec, known: &Machine) -> Result<(), SimError> {
        let configs = spec.configs(&self.machine);
        let channels = self.errors.channel_names().to_vec();
        self.control = Some(spec.control(&configs, &channels, known)?);
        Ok(())
    }

    /// Reasons why axes do not follow the model now; empty if all follow.
    pub fn holding(&self) -> Vec<String> {
        self.control.as_ref().map_or_else(Vec::new, CorrectorWithSensors::holding)
    }

    /// The engine's status at this moment.
    pub fn status(&self) -> CorrectorStatus {
        self.corrected.status()
    }

    /// Sets the time between two computations of totals, ns.
    /// Errors of a machine at rest change slowly.
    pub fn set_control_period(&mut self, control_ns: u64) {
        self.control_ns = control_ns.max(CONTROL_NS);
    }

    /// Runs for `seconds`.
    ///
    /// # Errors
    /// The controller stopped, or the engine latched a fault.
    pub fn advance(&mut self, seconds: f64) -> Result<(), SimError> {
        self.advance_by_ns((seconds * 1e9).round() as u64)
    }

    fn advance_by_ns(&mut self, ns: u64) -> Result<(), SimError> {
        let end_ns = self.machine.now_ns() + ns;
        loop {
            let by_ns = end_ns.min(self.next_control_ns);
            let (corrected, machine, events) = (&mut self.corrected, &mut self.machine, &mut self.events);
            let mut report = |e: Event| keep(events, e);
            while corrected.now_ns() < by_ns {
                corrected.poll(machine, by_ns, &mut report)?;
            }
            if by_ns == self.next_control_ns {
                self.control()?;
            }
            self.digest()?;
            if by_ns == end_ns {
                return Ok(());
            }
        }
    }

    /// Runs until the program is done and the axes have come to rest.
    ///
    /// # Errors
    /// As [`CorrectedMachineSim::advance`].
    pub fn finish(&mut self) -> Result<(), SimError> {
        while !self.machine.finished() {
            self.advance_by_ns(CONTROL_NS)?;
        }
        self.advance_by_ns(10 * CONTROL_NS)
    }

    /// Loads blocks and runs them to their end.
    ///
    /// # Errors
    /// As [`CorrectedMachineSim::advance`].
    pub fn run(&mut self, blocks: impl IntoIterator<Item = Block>) -> Result<(), SimError> {
        self.machine.load(blocks);
        self.finish()
    }

    /// Turns events into errors.
    fn digest(&mut self) -> Result<(), SimError> {
        for event in self.events.drain(..) {
            if let EventKind::Fault(fault) = event.kind {
                return Err(SimError::Engine { t_s: event.t_ns as f64 * 1e-9, fault });
            }
        }
        match self.machine.fault() {
            Some(fault) => Err(SimError::Servo { t_s: self.machine.now_ns() as f64 * 1e-9, fault }),
            None => Ok(()),
        }
    }

    /// Runs every 10 ms: heat, the true machine's errors, and new totals.
    fn control(&mut self) -> Result<(), SimError> {
        rtec_files::cancellable_computation::step();
        let t_s = self.next_control_ns as f64 * 1e-9;
        self.next_control_ns += self.control_ns;
        self.errors.heat.advance(t_s, self.machine.rpm, self.machine.coolant);
        if self.next_control_ns.is_multiple_of(1_000_000_000) {
            self.errors.move_channels();
        }
        self.act();
        let Some(control) = &mut self.control else { return Ok(()) };
        let status = self.corrected.status();
        let requests = control.requests(t_s, &status, &mut self.errors.readings(&self.machine, self.load_n));
        let mut report = |e: Event| keep(&mut self.events, e);
        for request in requests {
            self.corrected.take(request, &mut self.machine, &mut report)?;
        }
        Ok(())
    }

    /// Applies the true machine's errors at its position.
    fn act(&mut self) {
        let t_s = self.machine.now_ns() as f64 * 1e-9;
        self.errors.act(t_s, &mut self.machine, &self.load_n, 0.0);
    }

    /// The present state of the machine.
    pub fn moment(&mut self) -> MachineSnapshot {
        self.act();
        let m = &self.machine;
        let mut now = MachineSnapshot {
            t_s: m.now_ns() as f64 * 1e-9,
            command: m.command,
            axes: m.command.p_mm.map(|position_mm| AxisMotionState { position_mm, ..Default::default() }),
            counted_mm: m.command.p_mm,
            force_n: [0.0; AXES],
            error_um: self.errors.errors_um(),
            inserted_um: [0.0; AXES],
            rpm: m.rpm,
            coolant: m.coolant,
        };
        for (n, (axis, &p)) in m.axes.iter().zip(&m.place).enumerate() {
            now.axes[p] = m.motion(n);
            now.counted_mm[p] = axis.counted_mm();
            now.force_n[p] = axis.force_n;
            now.inserted_um[p] = m.mtc_minus_scale(n) as f64 * axis.spec.count_um;
        }
        now
    }

    /// Switches feed hold on or off, as an operator's request to the engine.
    ///
    /// # Errors
    /// The simulated card failed.
    pub fn hold(&mut self, on: bool) -> Result<(), SimError> {
        let mut report = |e: Event| keep(&mut self.events, e);
        self.corrected.take(RequestToRt::Hold { on, by: 0 }, &mut self.machine, &mut report)?;
        Ok(())
    }
}
