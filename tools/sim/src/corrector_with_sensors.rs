//! The control side of the simulated machine.
//! It has sensors with plausibility checks, and the daemon's control law.

use crate::thermal_network::SENSORS;
use crate::trajectory::AXIS_NAMES;
use rtec_correct::part_table::PartTable;
use rtec_correct::{AxisCorrectionSettings, Corrector, RAMP_UM_S};
use rtec_files::InputError;
use rtec_model::machine::Machine;
use rtec_model::record::{Axis, Role};
use rtec_part::error_cor_file::FeatureErrors;
use rtec_part::error_cor_file::PointError;
use rtec_rt::link_messages::{CorrectorStatus, RequestToRt};
use rtec_sensors::{SensorConfig, SensorMonitor};

/// Time between two computations of totals, ns.
/// (NISTIR 4832, Alternate Configurations: every 10 to 20 ms)
pub const CONTROL_NS: u64 = 10_000_000;
/// Quiet time after which an axis counts as at rest, ns.
/// It must exceed the longest quiet time of a reversing axis. On the slowest circle, 150 mm at 10 in/min, the
/// axis accelerates at 119 counts/s². From one edge over a count and the hysteresis to the next it takes
/// 2·√(2·1.1/119) s, which is 0.27 s. An insertion into a moving axis may coincide with its next edge, and
/// the controller sees both as one.
pub(crate) const REST_NS: u64 = 300_000_000;
/// Belief window of the simulated corrector, counts.
pub(crate) const WINDOW_COUNTS: i64 = 64;

/// The control side of a simulation: checked sensors and the control law.
#[derive(Debug)]
pub(crate) struct CorrectorWithSensors {
    law: Corrector,
    watches: Vec<SensorMonitor>,
}

impl CorrectorWithSensors {
    /// The control side of a machine switched on at time 0.
    /// The law evaluates the model `lead_s` ahead.
    pub(crate) fn new(axes: Vec<AxisCorrectionSettings>, channels: &[String], lead_s: f64) -> Self {
        let axis = |n: &str| Axis::new(n).map(Role::Load);
        let temperatures = SENSORS.iter().map(|s| (s.0.to_owned(), Role::Temperature));
        let channels = channels.iter().map(|c| (c.clone(), Role::Channel));
        let others = [("rpm".to_owned(), Role::SpindleSpeed), ("wet".to_owned(), Role::Coolant)];
        let loads = AXIS_NAMES.iter().filter_map(|n| Some((format!("load_{n}"), axis(n)?)));
        let all = temperatures.chain(channels).chain(others).chain(loads);
        let watches: Vec<SensorMonitor> =
            all.map(|(name, role)| SensorMonitor::new(SensorConfig::believed(&name, role))).collect();
        let mut law = Corrector::new(axes, RAMP_UM_S, lead_s, 0.0);
        law.sense(0.0, &watches);
        Self { law, watches }
    }

    /// Loads a model and computes its lags from past temperatures.
    /// `past` has the time since the machine was switched on, s, and all sensors, °C.
    ///
    /// # Errors
    /// An effect reads what the machine does not have.
    pub(crate) fn load(&mut self, model: &Machine, past: &[(f64, Vec<f64>)]) -> Result<(), InputError> {
        let of = |names: &[String]| {
            let place = |n: &String| SENSORS.iter().position(|s| s.0 == n);
            let places: Vec<usize> = names.iter().filter_map(place).collect();
            past.iter().map(|(t_s, degc)| (*t_s, places.iter().map(|k| degc[*k]).collect())).collect()
        };
        self.law.load(model.clone(), &of)
    }

    /// Loads a part table.
    ///
    /// # Errors
    /// What was found and what was expected.
    pub(crate) fn load_table(&mut self, table: PartTable, errors: Vec<PointError>) -> Result<(), String> {
        self.law.load_table(table, FeatureErrors::Arc(errors))
    }

    /// Runs one evaluation; returns the totals to request of the engine.
    pub(crate) fn requests(
        &mut self,
        t_s: f64,
        status: &CorrectorStatus,
        readings: &mut dyn Iterator<Item = f64>,
    ) -> impl Iterator<Item = RequestToRt> + use<> {
        for (watch, value) in self.watches.iter_mut().zip(readings) {
            watch.offer(t_s, Ok(value));
        }
        let totals = self.law.tick(t_s, status, &self.watches);
        totals.into_iter().enumerate().filter_map(|(axis, total)| {
            Some(RequestToRt::Correct { axis: axis as u8, total_counts: total?, large: false })
        })
    }

    /// Reasons why axes do not follow the model.
    pub(crate) fn holding(&self) -> Vec<String> {
        self.law.holding().collect()
    }

    /// Whether every axis has the total that its sources want.
    pub(crate) fn settled(&self, status: &CorrectorStatus) -> bool {
        status.axes().iter().enumerate().all(|(n, s)| self.law.settled(n, s))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rtec_files::csv::{Cell, Reader};
    use rtec_rt::link_messages::CorrectorMode;
    use std::path::Path;

    /// The recorded shift of `rtec-correct`'s tests gives the same totals here.
    #[test]
    fn a_recorded_shift_gets_the_recorded_totals() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../correct/tests/shift");
        let axis = |name: &str| AxisCorrectionSettings {
            name: name.to_owned(),
            count_um: 1.0,
            increment_counts: 2,
            window_counts: 50,
            max_counts: 1000,
        };
        let mut control = CorrectorWithSensors::new(["x", "y", "z"].map(axis).to_vec(), &[], 0.02);
        control.load(&Machine::read(&folder.join("machine.toml")).unwrap(), &[]).unwrap();
        let place = |name: &str| SENSORS.iter().position(|s| s.0 == name).unwrap();
        let mut degc = vec![20.0; SENSORS.len()];
        let mut status =
            CorrectorStatus { mode: CorrectorMode::Run, axes_used: 3, ..CorrectorStatus::default() };
        status.axes.iter_mut().for_each(|a| a.homed = true);
        let mut reader = Reader::open(&folder.join("shift.csv")).unwrap();
        let header = reader.header("t_s, positions, sensors, operator, totals").unwrap();
        let mut rows = 0;
        while let Some(row) = reader.row().unwrap() {
            let mut at = Vec::new();
            header.each(row, |_, cell: Cell<'_>| cell.finite().map(|v| at.push(v))).unwrap();
            (degc[place("T8")], degc[place("T18")]) = (at[4], at[5]);
            status.t_ns = (at[0] * 1e9).round() as u64;
            (0..3).for_each(|n| status.axes[n].position_counts = at[1 + n] as i64);
            // Neither speed, coolant nor loads.
            let mut now = degc.iter().copied().chain([0.0; 2 + AXIS_NAMES.len()]);
            for request in control.requests(at[0], &status, &mut now) {
                let RequestToRt::Correct { axis, total_counts, large: false } = request else {
                    panic!("{request:?}")
                };
                let axis = &mut status.axes[usize::from(axis)];
                (axis.requested, axis.completed, axis.in_effect) = (total_counts, total_counts, total_counts);
            }
            for n in 0..3 {
                // The simulated machine has no operator.
                let operator = if n == 0 { at[6] as i64 } else { 0 };
                assert_eq!(status.axes[n].requested + operator, at[7 + n] as i64, "axis {n} at {} s", at[0]);
            }
            rows += 1;
        }
        assert_eq!(rows, 2400);
    }
}
