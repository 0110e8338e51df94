//! The drilling test from every thermal state, with a model that never saw a hole.

use super::model::from_wet_runs;
use super::{AXES, Centre, Run, error_of, record};
use crate::PaperError;
use rtec_model::machine::Machine;
use rtec_sim::compensation_experiments::{PROMISED, UNSEEN};
use rtec_sim::corrected_machine_sim::MachineSpec;
use rtec_sim::described_machines::MachineDescriptions;
use rtec_sim::noise::NoiseGenerator;
use rtec_sim::thermal_network::ThermalNetworkSpec;

/// The experiments, one for each thermal state of the machine at the start.
pub const STARTS: [&str; 6] = [
    "drilling",
    "drilling-semi-warm",
    "drilling-warm",
    "drilling-fully-warm",
    "drilling-after-rest",
    "drilling-weekend",
];

/// What an axis was off by in a drilling test without and with the fitted model.
#[derive(Debug, Clone)]
pub struct StartResult {
    /// The experiment.
    pub start: &'static str,
    /// X, Y or Z.
    pub axis: &'static str,
    /// The largest error of the tool, without and with correction, µm.
    pub off_um: [f64; 2],
    /// The largest deviation from hole 1, without and with correction, µm.
    pub from_hole_1_um: [f64; 2],
    /// What is said before it corrects, µm: the promise, and the cost of
    /// temperatures at the start outside the range of the fit.
    pub promised_um: [f64; 2],
}

impl StartResult {
    /// The share of the tool's error that is left.
    pub fn left(&self) -> f64 {
        self.off_um[1] / self.off_um[0]
    }

    /// The share of the deviation from hole 1 that is left.
    pub fn left_from_hole_1(&self) -> f64 {
        self.from_hole_1_um[1] / self.from_hole_1_um[0]
    }

    /// The model said before that it cannot leave a quarter of the tool's error.
    pub fn warned(&self) -> bool {
        self.promised_um.iter().sum::<f64>() > 0.25 * self.off_um[0]
    }
}

/// Standard deviation of the logarithm of each drawn parameter.
const SPREAD: f64 = 0.3;

/// Another machining centre of the same build.
/// Each parameter of its errors and each of its thermal properties has a factor of its own.
/// A value out of the bounds of its law is drawn again.
fn drawn(truth: &Machine, machine: u64) -> Result<(Machine, ThermalNetworkSpec), PaperError> {
    let mut noise = NoiseGenerator::new(machine, 0xD2A);
    let mut factor = || (SPREAD * noise.normal()).exp();
    let network = ThermalNetworkSpec::drawn(&mut factor);
    let mut other = truth.clone();
    for (place, effect) in truth.effects().enumerate() {
        for (i, p) in effect.description().parameters.iter().enumerate().filter(|(_, p)| !p.array) {
            let fits =
                (0..100).any(|_| other.set(place, &p.name, &[effect.scalar(i) * factor()], None).is_ok());
            if !fits {
                return Err(PaperError::Cannot(format!(
                    "WO 97/43703: no {} of {} drawn",
                    p.name,
                    effect.name()
                )));
            }
        }
    }
    Ok((other, network))
}

/// Drills from each of [`STARTS`] with a drawn machine.
/// It is characterised, and the model is fitted on its wet runs alone.
/// `machine` is the seed of the drawn parameters and of all noise; 0 is the patent's own machine.
///
/// # Errors
/// A description that is not right, or a machine that stops.
pub fn starts(described: &MachineDescriptions, machine: u64) -> Result<Vec<StartResult>, PaperError> {
    let centre: Centre = described.read("wo97.toml")?;
    let truth = described.machine(&centre.machine)?;
    let (truth, network) =
        if machine == 0 { (truth, ThermalNetworkSpec::default()) } else { drawn(&truth, machine)? };
    let spec = MachineSpec { network, ..MachineSpec::machining_centre() };
    let run = Run { spec, truth: &truth, seed: machine };
    let model = from_wet_runs(&run)?;
    let mut all = Vec::new();
    for start in STARTS {
        let found = run.experiment(start, Some(&model))?;
        for (p, axis) in AXES.into_iter().enumerate() {
            let response = format!("error.{}", axis.to_lowercase());
            let (mut off_um, mut from_hole_1_um) = ([0.0; 2], [0.0; 2]);
            for (k, suffix) in ["", "-compensated"].into_iter().enumerate() {
                let um = error_of(record(&found, &format!("{start}{suffix}"))?, p);
                let largest = |zero: f64| um.iter().fold(0.0_f64, |w, e| w.max((e - zero).abs()));
                (off_um[k], from_hole_1_um[k]) = (largest(0.0), largest(um.first().copied().unwrap_or(0.0)));
            }
            let said_um = |title: &str| found.summary.get(title)?.get(format!("{response}_um"))?.as_f64();
            let promised_um = [PROMISED, UNSEEN].map(|title| said_um(title).unwrap_or(0.0));
            all.push(StartResult { start, axis, off_um, from_hole_1_um, promised_um });
        }
    }
    Ok(all)
}
