//! Both runs of an experiment, without and with compensation.
//! The module makes their rows, records and plots.

use super::{ExperimentError, ExperimentInputs, ExperimentResult};
use crate::axis::AxisSpec;
use crate::corrected_machine_sim::{CorrectedMachineSim, MachineSnapshot, MachineSpec, SimError};
use crate::nc_block::Block;
use crate::noise::NoiseGenerator;
use crate::thermal_network::SENSORS;
use crate::trajectory::{AXES, AXIS_NAMES};
use rtec_files::InputError;
use rtec_measure::plot::{Chart, Series, Style};
use rtec_model::record::{Axis, Column, Record, Role, RunKind};
use serde_json::{Map, Value, json};
use std::path::Path;

#[derive(Debug, Clone)]
pub(super) struct MeasuredRow {
    pub(super) now: MachineSnapshot,
    pub(super) temperatures: Vec<f64>,
    pub(super) channels: Vec<f64>,
    pub(super) load_n: [f64; AXES],
    pub(super) cycle: f64,
    pub(super) angle: Option<f64>,
    /// Commanded direction of approach; the machine's own if not given.
    pub(super) direction: Option<[f64; AXES]>,
    pub(super) requested_um: [f64; AXES],
}

/// Rows measured so far, to become a record.
#[derive(Debug, Default)]
pub(super) struct MeasuredRowLog {
    pub(super) rows: Vec<MeasuredRow>,
}

impl MeasuredRowLog {
    pub(super) fn take(&mut self, sim: &mut CorrectedMachineSim, cycle: f64) -> &mut MeasuredRow {
        let now = sim.moment();
        let mut requested_um = [0.0; AXES];
        for (n, a) in sim.status().axes().iter().enumerate() {
            let machine = &sim.machine;
            requested_um[machine.place[n]] = a.requested as f64 * machine.axes[n].spec.count_um;
        }
        self.rows.push(MeasuredRow {
            now,
            temperatures: sim.errors.heat.readings_degc().to_vec(),
            channels: sim.errors.channels.clone(),
            load_n: sim.load_n,
            cycle,
            angle: None,
            direction: None,
            requested_um,
        });
        let last = self.rows.len() - 1;
        &mut self.rows[last]
    }
}

/// `v` rounded to `1/per`: exactly the value of the decimal in the CSV.
pub(super) fn digits(v: f64, per: f64) -> f64 {
    // Adding zero turns −0 into 0.
    (v * per).round() / per + 0.0
}

impl MeasuredRowLog {
    /// The record of these rows.
    /// It has every quantity that an effect may read and that is not always zero.
    pub(super) fn record(
        &self,
        path: &Path,
        kind: RunKind,
        (axes, noise_um): (&[usize], f64),
        mut noise: NoiseGenerator,
        channels: &[String],
    ) -> Result<Record, InputError> {
        let rows = &self.rows;
        let mut columns = Vec::new();
        let mut add = |name: &str, role: Role, unit: &str, data: Vec<f64>, always: bool| {
            if always || data.iter().any(|v| *v != 0.0) {
                columns.push(Column { name: name.to_owned(), role, unit: unit.to_owned(), data });
            }
        };
        let column = |f: &dyn Fn(&MeasuredRow) -> f64, per: f64| {
            rows.iter().map(|r| digits(f(r), per)).collect::<Vec<_>>()
        };
        let names: Vec<Axis> = AXIS_NAMES.iter().filter_map(|n| Axis::new(n)).collect();
        add("t", Role::Time, "s", column(&|r| r.now.t_s, 1e6), true);
        for (p, axis) in names.iter().enumerate() {
            let n = axis.as_str();
            let dir = |r: &MeasuredRow| r.direction.map_or(r.now.axes[p].direction, |d| d[p]);
            add(n, Role::Position(axis.clone()), "mm", column(&|r| r.now.axes[p].position_mm, 1e6), false);
            add(&format!("dir_{n}"), Role::Direction(axis.clone()), "1", column(&dir, 1.0), false);
            // At a standstill a speed is not worth a column.
            let moves = rows.iter().any(|r| r.now.axes[p].velocity_mm_s.abs() > 0.01);
            if moves {
                let (v, a) = (Role::Velocity(axis.clone()), Role::Acceleration(axis.clone()));
                add(&format!("v_{n}"), v, "mm/s", column(&|r| r.now.axes[p].velocity_mm_s, 1e6), false);
                add(&format!("a_{n}"), a, "mm/s2", column(&|r| r.now.axes[p].acceleration_mm_s2, 1e4), false);
            }
            let load = Role::Load(axis.clone());
            add(&format!("load_{n}"), load, "N", column(&|r| r.load_n[p], 1e3), false);
        }
        add("n", Role::Cycle, "1", column(&|r| r.cycle, 1.0), false);
        for (k, (name, ..)) in SENSORS.iter().enumerate() {
            add(name, Role::Temperature, "degC", column(&|r| r.temperatures[k], 1e3), true);
        }
        add("rpm", Role::SpindleSpeed, "rpm", column(&|r| r.now.rpm, 1.0), false);
        add("wet", Role::Coolant, "1", column(&|r| f64::from(u8::from(r.now.coolant)), 1.0), false);
        if rows.iter().all(|r| r.angle.is_some()) {
            add("angle", Role::Angle, "rad", column(&|r| r.angle.unwrap_or(0.0), 1e9), true);
        }
        for (k, name) in channels.iter().enumerate() {
            add(name, Role::Channel, "1", column(&|r| r.channels[k], 1e6), true);
        }
        for &p in axes {
            let role = if kind == RunKind::Dynamics {
                Role::Force(names[p].clone())
            } else {
                Role::Error(names[p].clone())
            };
            let (name, unit) = if kind == RunKind::Dynamics { ("f", "N") } else { ("e", "um") };
            let value =
                |r: &MeasuredRow| if kind == RunKind::Dynamics { r.now.force_n[p] } else { r.now.off_um(p) };
            let data = rows.iter().map(|r| digits(value(r) + noise_um * noise.normal(), 1e4)).collect();
            add(&format!("{name}_{}", names[p]), role, unit, data, true);
        }
        Record::new(path, kind, columns)
    }
}

/// Both runs of an experiment, without and with compensation.
/// The second exists if a model of the machine is known.
pub(super) struct RunPair {
    name: String,
    pub(super) logs: Vec<MeasuredRowLog>,
    pub(super) channels: Vec<String>,
}

/// The seed of one run, from an FNV-1a hash of its name.
/// Runs of one experiment, and experiments with one seed, thus share no noise.
pub(super) fn seed_of(setting: &ExperimentInputs<'_>, run: &str) -> u64 {
    let hash = |h: u64, byte: u8| (h ^ u64::from(byte)).wrapping_mul(0x0100_0000_01B3);
    let mixed = run.bytes().fold(0xCBF2_9CE4_8422_2325 ^ setting.seed, hash);
    // Users of a seed count up from it.
    mixed >> 1
}

/// Nothing, or why an experiment failed.
pub(super) type Done = Result<(), ExperimentError>;

/// An experiment under way.
pub(super) struct ExperimentRun<'a> {
    pub(super) setting: &'a ExperimentInputs<'a>,
    pub(super) findings: ExperimentResult,
}

impl<'a> ExperimentRun<'a> {
    pub(super) fn new(setting: &'a ExperimentInputs<'a>) -> Self {
        Self { setting, findings: ExperimentResult::default() }
    }

    /// The machine's axes, each with its place (0 X, 1 Y, 2 Z).
    pub(super) fn axes(&self) -> impl Iterator<Item = (&'a AxisSpec, usize)> + use<'a> {
        let spec = self.setting.spec;
        spec.axes.iter().zip(places(spec))
    }

    pub(super) fn run_pair(
        &self,
        name: &str,
        run: impl FnMut(&mut CorrectedMachineSim, &mut MeasuredRowLog) -> Result<(), SimError>,
    ) -> Result<RunPair, ExperimentError> {
        self.both_on(self.setting.spec, [0.0; AXES], name, run)
    }

    /// As [`ExperimentRun::run_pair`], on another machine from another place.
    pub(super) fn both_on(
        &self,
        spec: &MachineSpec,
        at_mm: [f64; AXES],
        name: &str,
        mut run: impl FnMut(&mut CorrectedMachineSim, &mut MeasuredRowLog) -> Result<(), SimError>,
    ) -> Result<RunPair, ExperimentError> {
        let setting = self.setting;
        let mut done = RunPair { name: name.to_owned(), logs: Vec::new(), channels: Vec::new() };
        for (known, suffix) in std::iter::once(None).chain(setting.known.map(Some)).zip(SUFFIXES) {
            let seed = seed_of(setting, &format!("{name}{suffix}"));
            let mut sim = CorrectedMachineSim::new(spec, setting.truth, known, at_mm, seed)?;
            let mut log = MeasuredRowLog::default();
            run(&mut sim, &mut log)?;
            done.logs.push(log);
            done.channels = sim.errors.channel_names().to_vec();
        }
        Ok(done)
    }

    /// Adds two records, their errors' plot over `x`, and their figures.
    pub(super) fn publish(
        &mut self,
        runs: &RunPair,
        kind: RunKind,
        what: (&[usize], f64),
        x: (&str, &dyn Fn(&MeasuredRow) -> f64),
    ) -> Done {
        let mut records = Vec::new();
        for (log, suffix) in runs.logs.iter().zip(SUFFIXES) {
            let run = format!("{}{suffix}", runs.name);
            let path = self.setting.out.join(format!("{run}.run.toml"));
            let noise = NoiseGenerator::new(seed_of(self.setting, &run), 0x10);
            let record = log.record(&path, kind, what, noise, &runs.channels)?;
            records.push((record, log.rows.iter().map(x.1).collect()));
        }
        self.publish_records(&runs.name, records, x.0)
    }

    /// Publishes both records with their plot and figures.
    /// Each has its rows' positions on the axis `x_title`.
    pub(super) fn publish_records(
        &mut self,
        name: &str,
        records: Vec<(Record, Vec<f64>)>,
        x_title: &str,
    ) -> Done {
        let dynamics = records.iter().any(|(r, _)| r.kind == RunKind::Dynamics);
        let unit = if dynamics { "drive force (N)" } else { "error (µm)" };
        let mut chart = Chart::new(name, x_title, unit);
        let mut figures = Map::new();
        for ((mut record, x), (key, label)) in
            records.into_iter().zip([("without", "without"), ("with", "with compensation")])
        {
            record.count_um = Some(1.0);
            record.note = Some(format!("simulated, {label}, seed {}", self.setting.seed));
            for column in record.responses() {
                let axis = column.role.axis().map_or("", Axis::as_str);
                let points = x.iter().copied().zip(column.data.iter().copied()).collect();
                let rms = (column.data.iter().map(|e| e * e).sum::<f64>() / column.data.len() as f64).sqrt();
                let worst = column.data.iter().fold(0.0_f64, |w, e| w.max(e.abs()));
                let both = json!({"max": digits(worst, 1e3), "rms": digits(rms, 1e3)});
                figures.insert(format!("{axis}_{key}"), both);
                chart = chart.with(Series::new(&format!("{axis} {label}"), Style::Dots, points));
            }
            self.findings.records.push(record);
        }
        self.findings.plots.push((format!("{name}.svg"), chart.svg(900, 520)?));
        self.findings.summary.insert(name.to_owned(), Value::Object(figures));
        Ok(())
    }
}

/// Suffixes of both runs' files, after the experiment's name.
pub(super) const SUFFIXES: [&str; 2] = ["", "-compensated"];

/// The controller's axis (0 X, 1 Y, 2 Z) of each axis that a machine has.
pub(super) fn places(spec: &MachineSpec) -> Vec<usize> {
    spec.axes.iter().filter_map(|a| AXIS_NAMES.iter().position(|n| *n == a.name)).collect()
}

pub(super) fn along(axis: usize, p: f64) -> [f64; AXES] {
    let mut to = [0.0; AXES];
    to[axis] = p;
    to
}

pub(super) fn feed(to: [f64; AXES], mm_min: f64) -> Block {
    Block::Feed { to, feed_mm_s: mm_min / 60.0 }
}
