//! Shared by the tests of the control law.
//! It has a machine whose engine inserts at once, its sensors, models and a part.
#![allow(dead_code)] // each test program uses a part of it

use rtec_correct::part_table::PartTable;
use rtec_correct::{AxisCorrectionSettings, Corrector};
use rtec_files::InputError;
use rtec_model::machine::Machine;
use rtec_model::record::Role;
use rtec_part::error_cor_file::{FeatureErrors, PointError};
use rtec_rt::link_messages::{CorrectorMode, CorrectorStatus, MAX_AXES};
use rtec_sensors::{SensorConfig, SensorMonitor, SensorSource};
use std::path::Path;

/// A machine of one or more axes whose engine completes each request at once.
pub(crate) struct Bench {
    pub(crate) corrector: Corrector,
    pub(crate) status: CorrectorStatus,
    pub(crate) watches: Vec<SensorMonitor>,
    pub(crate) now_s: f64,
}

pub(crate) const TICK_S: f64 = 0.01;

pub(crate) fn sensor(name: &str, role: Role) -> SensorConfig {
    SensorConfig {
        name: name.to_owned(),
        place: String::new(),
        role,
        source: SensorSource::Line { from: "x:1".to_owned(), key: name.to_owned() },
        period_s: 1.0,
        range: [-1e9, 1e9],
        max_rate_k_per_min: f64::INFINITY,
        timeout_s: 5.0,
        stuck_s: 0.0,
        freeze_s: 20.0,
    }
}

pub(crate) fn machine(text: &str) -> Machine {
    Machine::parse(Path::new("m.toml"), &format!("name = \"m\"\n{text}")).unwrap()
}

pub(crate) const SCALE: &str = "[[effect]]\nname = \"scale.x\"\nppm = 100.0\n";
pub(crate) const GROWTH: &str =
    "[[effect]]\nname = \"thermal_growth.z\"\nsensor = \"T1\"\nminus = \"T2\"\num_per_K = 10.0\n";
pub(crate) const LAG: &str =
    "[[effect]]\nname = \"thermal_lag.z\"\nsensor = \"T1\"\nminus = \"T2\"\num_per_K = 10.0\ntau_s = 100.0\n";

/// An axis with counts of 1 µm.
pub(crate) fn axis(name: &str) -> AxisCorrectionSettings {
    AxisCorrectionSettings {
        name: name.to_owned(),
        count_um: 1.0,
        increment_counts: 2,
        window_counts: 50,
        max_counts: 1000,
    }
}

impl Bench {
    pub(crate) fn new() -> Self {
        Self::of(5.0, 1000.0, Vec::new())
    }

    /// A bench with this ramp and start time; these sensors come before T1 and T2.
    pub(crate) fn of(ramp_um_s: f64, now_s: f64, mut sensors: Vec<SensorConfig>) -> Self {
        sensors.extend(["T1", "T2"].map(|name| sensor(name, Role::Temperature)));
        let mut status =
            CorrectorStatus { mode: CorrectorMode::Run, axes_used: 3, ..CorrectorStatus::default() };
        status.axes.iter_mut().for_each(|a| a.homed = true);
        let watches: Vec<SensorMonitor> = sensors.into_iter().map(SensorMonitor::new).collect();
        let mut corrector = Corrector::new(["x", "y", "z"].map(axis).to_vec(), ramp_um_s, 0.0, now_s);
        corrector.sense(now_s, &watches);
        Self { corrector, status, watches, now_s }
    }

    pub(crate) fn warm(&mut self, t1: f64, t2: f64) {
        self.watches[0].offer(self.now_s, Ok(t1));
        self.watches[1].offer(self.now_s, Ok(t2));
        self.corrector.sense(self.now_s, &self.watches);
    }

    pub(crate) fn load(&mut self, model: &str) {
        self.try_load(model).unwrap();
    }

    pub(crate) fn try_load(&mut self, model: &str) -> Result<(), InputError> {
        self.corrector.load(machine(model), &|_| Vec::new())
    }

    /// One evaluation, with an engine that accepts totals within its window.
    /// Returns the requested totals.
    pub(crate) fn tick(&mut self) -> [Option<i64>; MAX_AXES] {
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

    /// Evaluates for `s` seconds, with a reading of every sensor each second.
    /// Returns the largest step of the axis's total.
    pub(crate) fn run(
        &mut self,
        s: f64,
        axis: usize,
        mut degc: impl FnMut(f64) -> Option<(f64, f64)>,
    ) -> i64 {
        let (until, mut due_s, mut largest) = (self.now_s + s, self.now_s, 0);
        while self.now_s < until {
            if self.now_s >= due_s {
                due_s += 1.0;
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

    pub(crate) fn z(&self) -> i64 {
        self.status.axes[2].requested
    }

    pub(crate) fn explained_um(&self, n: usize) -> (f64, f64) {
        let e = self.corrector.explain(n, &self.status.axes[n]);
        (e.total_um, e.parts.iter().map(|p| p.um).sum())
    }
}

/// A nose of 40 mm about the machine's zero, on z and x.
/// 10 µm too large at the tip.
pub(crate) fn part(axes: [&str; 2]) -> PartTable {
    PartTable {
        errors: "error.cor".to_owned(),
        axes: axes.map(str::to_owned),
        centre_mm: Some([0.0; 2]),
        radius_mm: Some(39.0),
        nose_mm: 1.0,
        hollow: false,
        origin_mm: [0.0; 2],
        lead_ms: 0.0,
    }
}

pub(crate) fn part_errors() -> FeatureErrors {
    let point = |(angle_rad, error_um)| PointError { angle_rad, error_um, along_mm: None };
    FeatureErrors::Arc([(0.0, 10.0), (0.5, 0.0), (1.6, 0.0)].map(point).to_vec())
}
