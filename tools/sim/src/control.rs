//! The control side of the simulated machine: its sensors under watch, and the control law that the daemon runs.

use crate::errors::NAMES;
use crate::heat::SENSORS;
use crate::path::AXES;
use rtec_correct::part_table::PartTable;
use rtec_correct::sensors::{Config, Watch};
use rtec_correct::{AxisSetup, Corrector, RAMP_UM_S};
use rtec_files::InputError;
use rtec_model::machine::Machine;
use rtec_model::record::{Axis, Role};
use rtec_part::errors::PointError;
use rtec_rt::event::{Request, Status};

/// How often new totals are computed, ns (NISTIR 4832, Alternate Configurations: every 10 to 20 ms).
pub const CONTROL_NS: u64 = 10_000_000;
/// Largest change that the simulated corrector believes at once, counts.
pub(crate) const WINDOW_COUNTS: i64 = 64;

/// What the machine's sensors read at one moment.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Readings<'a> {
    /// Readings in the order of [`SENSORS`], °C.
    pub degc: &'a [f64],
    /// Values of the logged channels, in the layout's order.
    pub channels: &'a [f64],
    pub rpm: f64,
    pub coolant: bool,
    /// Load on X, Y, Z, N.
    pub load_n: [f64; AXES],
}

/// The control side of a simulation: watched sensors and the control law.
#[derive(Debug)]
pub(crate) struct Control {
    law: Corrector,
    watches: Vec<Watch>,
}

impl Control {
    /// For a machine with these axes and channels, switched on at time 0; the law asks `lead_s` ahead.
    pub(crate) fn new(axes: Vec<AxisSetup>, channels: &[String], lead_s: f64) -> Self {
        let axis = |n: &str| Axis::new(n).map(Role::Load);
        let temperatures = SENSORS.iter().map(|s| (s.0.to_owned(), Role::Temperature));
        let channels = channels.iter().map(|c| (c.clone(), Role::Channel));
        let others = [("rpm".to_owned(), Role::SpindleSpeed), ("wet".to_owned(), Role::Coolant)];
        let loads = NAMES.iter().filter_map(|n| Some((format!("load_{n}"), axis(n)?)));
        let all = temperatures.chain(channels).chain(others).chain(loads);
        let watches = all.map(|(name, role)| Watch::new(Config::believed(&name, role))).collect();
        Self { law: Corrector::new(axes, RAMP_UM_S, lead_s, 0.0), watches }
    }

    /// Takes a model, its lags brought up from the heat of the past: time since the machine was switched on, s, and all
    /// sensors, °C.
    ///
    /// # Errors
    /// An effect reads what the machine does not have.
    pub(crate) fn load(&mut self, model: &Machine, past: &[(f64, Vec<f64>)]) -> Result<(), InputError> {
        let of = |names: &[String]| {
            let place = |n: &String| SENSORS.iter().position(|s| s.0 == n);
            let places: Vec<usize> = names.iter().filter_map(place).collect();
            past.iter().map(|(t_s, degc)| (*t_s, places.iter().map(|k| degc[*k]).collect())).collect()
        };
        self.law.load(model.clone(), &self.watches, &of)
    }

    /// Takes a part table.
    ///
    /// # Errors
    /// What was found and what was expected.
    pub(crate) fn load_table(&mut self, table: PartTable, errors: Vec<PointError>) -> Result<(), String> {
        self.law.load_table(table, errors)
    }

    /// One evaluation: what to request of the engine now.
    pub(crate) fn requests(
        &mut self,
        t_s: f64,
        status: &Status,
        now: Readings<'_>,
    ) -> impl Iterator<Item = Request> + use<> {
        let others = [now.rpm, f64::from(u8::from(now.coolant))];
        let values = now.degc.iter().chain(now.channels).chain(&others).chain(&now.load_n);
        for (watch, value) in self.watches.iter_mut().zip(values) {
            watch.offer(t_s, Ok(*value));
        }
        let totals = self.law.tick(t_s, status, &self.watches);
        totals.into_iter().enumerate().filter_map(|(axis, total)| {
            Some(Request::Correct { axis: axis as u8, total_counts: total?, large: false })
        })
    }

    /// Every axis is where its sources want it.
    pub(crate) fn settled(&self, status: &Status) -> bool {
        status.axes().iter().enumerate().all(|(n, s)| self.law.settled(n, s))
    }
}
