//! The experiments that characterise a machine, run on the simulated one: without and with compensation, each with a
//! run record and a plot.

use crate::axis::AxisSpec;
use crate::described::Described;
use crate::errors::NAMES;
use crate::gcode::Block;
use crate::heat::{FIGURE_9, SENSORS};
use crate::noise::Noise;
use crate::path::AXES;
use crate::sim::{Moment, Sim, SimError, Spec};
use crate::turning::{Setup, TurningError};
use rtec_files::InputError;
use rtec_measure::plot::{Chart, Series, Style};
use rtec_model::chain::Chain;
use rtec_model::effect::{Against, Difference, STANDARD_DEGC};
use rtec_model::machine::Machine;
use rtec_model::record::{Axis, Column, Kind, Record, Role};
use rtec_rt::axis::{Design, RestPolicy};
use serde_json::{Map, Value, json};
use std::path::Path;

/// What an experiment is run with.
#[derive(Debug, Clone, Copy)]
pub struct Setting<'a> {
    /// The machine as it really is.
    pub truth: &'a Machine,
    /// What the corrector knows of it.
    pub known: &'a Machine,
    /// Seed of all noise.
    pub seed: u64,
    /// Folder that records are to be written to.
    pub out: &'a Path,
}

/// What an experiment leaves.
#[derive(Debug)]
pub struct Findings {
    /// Run records, not yet written: as measured without compensation, and with it (`…-compensated`).
    pub records: Vec<Record>,
    /// Plots and tables beside the records: file name and text.
    pub plots: Vec<(String, String)>,
    /// What gauges on a mandrel showed, by record: its name and a row for each of its own.
    pub gauges: Vec<(String, Vec<Gauged>)>,
    /// The figures that the experiment is run for, by name with unit.
    pub summary: Map<String, Value>,
}

/// Distance between the two gauges of each direction on the mandrel, mm (WO 97/43703, figure 7, gives none).
pub const GAUGE_SPACING_MM: f64 = 100.0;

/// Five gauges at a mandrel in the spindle (WO 97/43703, figure 7): 2 and 5 in X, 1 and 4 in Y, near and far, 3 in Z.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gauged {
    /// Time of the simulation, s.
    pub t_s: f64,
    /// Gauges 1 to 5, µm.
    pub um: [f64; 5],
    /// Tilt of the spindle, by the two gauges of X and those of Y, arcseconds.
    pub tilt_arcsec: [f64; 2],
}

/// Why an experiment failed.
#[derive(Debug, thiserror::Error)]
pub enum ExperimentError {
    /// The simulation could not go on.
    #[error(transparent)]
    Sim(#[from] SimError),
    /// The turning of a nose.
    #[error(transparent)]
    Turning(#[from] TurningError),
    /// A record or a model is not as it must be.
    #[error(transparent)]
    Record(#[from] InputError),
    /// A plot could not be drawn.
    #[error(transparent)]
    Plot(#[from] rtec_measure::plot::PlotError),
}

type Run = fn(&Setting<'_>) -> Result<Findings, ExperimentError>;

/// An experiment that characterises a machine.
#[derive(Debug, Clone, Copy)]
pub struct Experiment {
    /// The experiment's name on the command line.
    pub name: &'static str,
    /// What it does, in one line.
    pub what: &'static str,
    /// The machine that it is about, where a source describes one.
    pub own: Option<Own>,
    run: Run,
}

/// An experiment's own machine.
#[derive(Debug, Clone, Copy)]
pub struct Own {
    file: &'static str,
    /// The machine is the experiment: another one is another experiment.
    pub fixed: bool,
}

/// The turning centre of NISTIR 4832: what is to come out depends on its one error.
const NIST_4832: Option<Own> = Some(Own { file: "4832-machine.toml", fixed: true });
/// The turning centre of NISTIR 4854.
const NIST_4854: Option<Own> = Some(Own { file: "4854-machine.toml", fixed: false });
/// The machining centre of WO 97/43703.
const WO_97: Option<Own> = Some(Own { file: "wo97-machine.toml", fixed: false });

impl Experiment {
    /// Runs it.
    ///
    /// # Errors
    /// The machine's effects read what the simulation does not have, or the controller gave up.
    pub fn run(&self, setting: &Setting<'_>) -> Result<Findings, ExperimentError> {
        match self.own {
            Some(own) if own.fixed => {
                let machine = Described::default().machine(own.file)?;
                (self.run)(&Setting { truth: &machine, known: &machine, ..*setting })
            }
            _ => (self.run)(setting),
        }
    }

    /// The machine that it brings; none where the user's is wanted.
    ///
    /// # Errors
    /// Never: the files are within the program, and a test reads them.
    pub fn own_machine(&self) -> Result<Option<Machine>, InputError> {
        self.own.map(|own| Described::default().machine(own.file)).transpose()
    }

    /// The experiment of this name.
    #[must_use]
    pub fn find(name: &str) -> Option<&'static Self> {
        EXPERIMENTS.iter().find(|e| e.name == name)
    }
}

/// Every experiment, as `simulate --list` shows them.
pub const EXPERIMENTS: [Experiment; 13] = [
    Experiment {
        name: "linear-displacement",
        what: "ISO 230-2: 5 cycles over 13 targets, both directions, each axis against a laser",
        own: WO_97,
        run: linear_displacement,
    },
    Experiment {
        name: "ballbar",
        what: "circles of 150 mm in three planes, both ways, at 10, 50 and 100 in/min (WO 97/43703, table 1)",
        own: WO_97,
        run: ballbar,
    },
    Experiment {
        name: "drift",
        what: "the spindle cycle of WO 97/43703, figure 9, dry and wet: spindle growth and 20 temperatures",
        own: WO_97,
        run: drift,
    },
    Experiment {
        name: "production-cycle",
        what: "a wet spindle cycle that no characterisation runs: four hours of changing speeds and rests",
        own: WO_97,
        run: production,
    },
    Experiment {
        name: "tool-change-repeatability",
        what: "ten tool changes with arbitrary moves in between, back to a reference (WO 97/43703, table 3)",
        own: WO_97,
        run: tool_change,
    },
    Experiment {
        name: "drilling",
        what: "12 holes and counterbores, cold, warm and hot, wet (WO 97/43703, figure 12 and table 7)",
        own: WO_97,
        run: |setting| drilling(setting, false),
    },
    Experiment {
        name: "drilling-warm",
        what: "the same after three hours at 5000 rpm, wet, the corrector on throughout (WO 97/43703, test 2)",
        own: WO_97,
        run: |setting| drilling(setting, true),
    },
    Experiment {
        name: "hemisphere",
        what: "a 38.1 mm nose turned with a worn tool (25 µm flat) and probed at 2.5 m/min (NISTIR 4854)",
        own: NIST_4854,
        run: hemisphere,
    },
    Experiment { name: "plate", what: "a grid of holes over the XY plane", own: None, run: plate },
    Experiment {
        name: "feed-sweep",
        what: "the same stretch at feeds from 0.1 to 10 m/min, both directions",
        own: None,
        run: feed_sweep,
    },
    Experiment {
        name: "dynamics",
        what: "drive force over moves of rising speed and acceleration, 1 kHz",
        own: None,
        run: dynamics,
    },
    Experiment {
        name: "linear-error-240um",
        what: "240 µm per metre over a quarter of a metre: 15 corrections of 4 µm (NISTIR 4832, The \"Original RTEC\")",
        own: NIST_4832,
        run: linear_error,
    },
    Experiment {
        name: "rapid-catch-up",
        what: "a rapid too fast for insertions: corrections catch up before the tool enters the part (NISTIR 4832)",
        own: NIST_4832,
        run: rapid_catch_up,
    },
];

/// A row of a record.
#[derive(Debug, Clone)]
struct Row {
    now: Moment,
    temperatures: Vec<f64>,
    channels: Vec<f64>,
    load_n: [f64; AXES],
    cycle: f64,
    angle: Option<f64>,
    /// Direction of approach as commanded; the machine's own where not given.
    direction: Option<[f64; AXES]>,
    requested_um: [f64; AXES],
}

/// Rows measured so far, and how they become a record.
#[derive(Debug, Default)]
struct Log {
    rows: Vec<Row>,
}

impl Log {
    fn take(&mut self, sim: &mut Sim, cycle: f64) -> &mut Row {
        let now = sim.moment();
        let mut requested_um = [0.0; AXES];
        for (n, a) in sim.status().axes().iter().enumerate() {
            requested_um[sim.machine.place(n)] = a.requested as f64 * sim.machine.count_um(n);
        }
        self.rows.push(Row {
            now,
            temperatures: sim.temperatures_degc().to_vec(),
            channels: sim.channels().to_vec(),
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

/// What is measured: axes (0 X, 1 Y, 2 Z), and the instrument's noise, µm.
struct Measured<'a> {
    axes: &'a [usize],
    noise_um: f64,
    noise: Noise,
    channels: &'a [String],
}

/// Digits that the CSV shows: `v` rounded to `1/per` exactly as its decimal is.
fn digits(v: f64, per: f64) -> f64 {
    // Plus zero: one representation for it.
    (v * per).round() / per + 0.0
}

impl Log {
    /// The record of these rows: every quantity that an effect may read and that was not zero throughout.
    fn record(&self, path: &Path, kind: Kind, what: &mut Measured<'_>) -> Result<Record, InputError> {
        let rows = &self.rows;
        let mut columns = Vec::new();
        let mut add = |name: &str, role: Role, unit: &str, data: Vec<f64>, always: bool| {
            if always || data.iter().any(|v| *v != 0.0) {
                columns.push(Column { name: name.to_owned(), role, unit: unit.to_owned(), data });
            }
        };
        let column =
            |f: &dyn Fn(&Row) -> f64, per: f64| rows.iter().map(|r| digits(f(r), per)).collect::<Vec<_>>();
        let names: Vec<Axis> = NAMES.iter().filter_map(|n| Axis::new(n)).collect();
        add("t", Role::Time, "s", column(&|r| r.now.t_s, 1e6), true);
        for (p, axis) in names.iter().enumerate() {
            let n = axis.as_str();
            let dir = |r: &Row| r.direction.map_or(r.now.direction[p], |d| d[p]);
            add(n, Role::Position(axis.clone()), "mm", column(&|r| r.now.position_mm[p], 1e6), false);
            add(&format!("dir_{n}"), Role::Direction(axis.clone()), "1", column(&dir, 1.0), false);
            // Measured at a standstill there is no speed worth a column.
            let moves = rows.iter().any(|r| r.now.velocity_mm_s[p].abs() > 0.01);
            if moves {
                let (v, a) = (Role::Velocity(axis.clone()), Role::Acceleration(axis.clone()));
                add(&format!("v_{n}"), v, "mm/s", column(&|r| r.now.velocity_mm_s[p], 1e6), false);
                add(&format!("a_{n}"), a, "mm/s2", column(&|r| r.now.acceleration_mm_s2[p], 1e4), false);
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
        for (k, name) in what.channels.iter().enumerate() {
            add(name, Role::Channel, "1", column(&|r| r.channels[k], 1e6), true);
        }
        let (noise, sigma) = (&mut what.noise, what.noise_um);
        for &p in what.axes {
            let role = if kind == Kind::Dynamics {
                Role::Force(names[p].clone())
            } else {
                Role::Error(names[p].clone())
            };
            let (name, unit) = if kind == Kind::Dynamics { ("f", "N") } else { ("e", "um") };
            let value = |r: &Row| if kind == Kind::Dynamics { r.now.force_n[p] } else { r.now.off_um(p) };
            let data = rows.iter().map(|r| digits(value(r) + sigma * noise.normal(), 1e4)).collect();
            add(&format!("{name}_{}", names[p]), role, unit, data, true);
        }
        Record::new(path, kind, columns)
    }
}

/// Both runs of an experiment: without and with compensation.
struct Both {
    logs: [Log; 2],
    channels: Vec<String>,
}

fn both(
    setting: &Setting<'_>,
    spec: &Spec,
    at_mm: [f64; AXES],
    mut run: impl FnMut(&mut Sim, &mut Log) -> Result<(), SimError>,
) -> Result<Both, ExperimentError> {
    let mut done = Both { logs: [Log::default(), Log::default()], channels: Vec::new() };
    for (n, log) in done.logs.iter_mut().enumerate() {
        let mut sim = Sim::new(spec, setting.truth, (n == 1).then_some(setting.known), at_mm, setting.seed)?;
        run(&mut sim, log)?;
        done.channels = sim.channel_names().to_vec();
    }
    Ok(done)
}

impl Both {
    /// Two records, a plot of the errors over `x`, and their figures, into `findings`.
    fn publish(
        &self,
        setting: &Setting<'_>,
        name: &str,
        kind: Kind,
        (axes, noise_um): (&[usize], f64),
        x: (&str, &dyn Fn(&Row) -> f64),
        findings: &mut Findings,
    ) -> Result<(), ExperimentError> {
        let mut records = Vec::new();
        for (log, suffix) in self.logs.iter().zip(SUFFIXES) {
            let path = setting.out.join(format!("{name}{suffix}.run.toml"));
            let stream = 0x10 + suffix.len() as u64;
            let noise = Noise::new(setting.seed, stream);
            let mut what = Measured { axes, noise_um, noise, channels: &self.channels };
            let record = log.record(&path, kind, &mut what)?;
            records.push((record, log.rows.iter().map(x.1).collect()));
        }
        findings.publish(setting, name, records, x.0)
    }
}

/// What the files of both runs are called beside the experiment's name.
const SUFFIXES: [&str; 2] = ["", "-compensated"];

impl Findings {
    /// The records without and with compensation, each with its rows' places on the axis `x_title`; their plot and figures.
    fn publish(
        &mut self,
        setting: &Setting<'_>,
        name: &str,
        records: Vec<(Record, Vec<f64>)>,
        x_title: &str,
    ) -> Result<(), ExperimentError> {
        let dynamics = records.iter().any(|(r, _)| r.kind == Kind::Dynamics);
        let unit = if dynamics { "drive force, N" } else { "error, µm" };
        let mut chart = Chart::new(name, x_title, unit);
        let mut figures = Map::new();
        for ((mut record, x), (key, label)) in
            records.into_iter().zip([("without", "without"), ("with", "with compensation")])
        {
            record.count_um = Some(1.0);
            record.note = Some(format!("simulated, {label}, seed {}", setting.seed));
            for column in record.responses() {
                let axis = column.role.axis().map_or("", Axis::as_str);
                let points = x.iter().copied().zip(column.data.iter().copied()).collect();
                let rms = (column.data.iter().map(|e| e * e).sum::<f64>() / column.data.len() as f64).sqrt();
                let worst = column.data.iter().fold(0.0_f64, |w, e| w.max(e.abs()));
                let both = json!({"max": digits(worst, 1e3), "rms": digits(rms, 1e3)});
                figures.insert(format!("{axis}_{key}"), both);
                chart = chart.with(Series::new(&format!("{axis} {label}"), Style::Dots, points));
            }
            self.records.push(record);
        }
        self.plots.push((format!("{name}.svg"), chart.svg(900, 520)?));
        self.summary.insert(name.to_owned(), Value::Object(figures));
        Ok(())
    }
}

fn nothing() -> Findings {
    Findings { records: Vec::new(), plots: Vec::new(), gauges: Vec::new(), summary: Map::new() }
}

fn along(axis: usize, p: f64) -> [f64; AXES] {
    let mut to = [0.0; AXES];
    to[axis] = p;
    to
}

fn feed(to: [f64; AXES], mm_min: f64) -> Block {
    Block::Feed { to, feed_mm_s: mm_min / 60.0 }
}

fn linear_displacement(setting: &Setting<'_>) -> Result<Findings, ExperimentError> {
    let mut findings = nothing();
    let spec = Spec::machining_centre();
    for (p, axis) in spec.axes.iter().enumerate() {
        // ISO 230-2: targets over the travel, each off an even pitch by a random amount so that no period hides.
        let [lo, hi] = axis.travel_mm.map(|t| t * 0.95);
        let pitch = (hi - lo) / 12.0;
        let mut noise = Noise::new(setting.seed, 0x150 + p as u64);
        let targets: Vec<f64> = (0..13)
            .map(|k| ((lo + pitch * f64::from(k) + 3.0 * (noise.uniform() - 0.5)) * 1000.0).round() / 1000.0)
            .collect();
        // WO 97/43703, text before table 2: 64 in/min.
        let mm_min = 64.0 * 25.4;
        let over = 4.0;
        let runs = both(setting, &spec, [0.0; 3], |sim, log| {
            sim.run([Block::Rapid { to: along(p, targets[0] - 2.0 * over) }])?;
            for cycle in 0..5 {
                for up in [true, false] {
                    let order: Vec<f64> =
                        if up { targets.clone() } else { targets.iter().rev().copied().collect() };
                    for target in order {
                        sim.run([feed(along(p, target), mm_min)])?;
                        sim.advance(0.5)?;
                        let mut direction = [0.0; AXES];
                        direction[p] = if up { 1.0 } else { -1.0 };
                        log.take(sim, f64::from(cycle + 1)).direction = Some(direction);
                    }
                    let beyond = if up { targets[12] + over } else { targets[0] - over };
                    sim.run([feed(along(p, beyond), mm_min)])?;
                }
            }
            Ok(())
        })?;
        let name = format!("linear-displacement-{}", axis.name);
        let x = |r: &Row| r.now.position_mm[p];
        runs.publish(setting, &name, Kind::Positioning, (&[p], 0.1), ("position, mm", &x), &mut findings)?;
    }
    Ok(findings)
}

fn ballbar(setting: &Setting<'_>) -> Result<Findings, ExperimentError> {
    let mut findings = nothing();
    let spec = Spec::machining_centre();
    let radius = 150.0;
    for (i, j) in [(0, 1), (1, 2), (2, 0)] {
        for inches in [10.0, 50.0, 100.0] {
            let feed_mm_s = inches * 25.4 / 60.0;
            let mut start = [0.0; AXES];
            start[i] = radius;
            let runs = both(setting, &spec, [0.0; 3], |sim, log| {
                sim.run([Block::Rapid { to: start }])?;
                for clockwise in [false, true] {
                    let arc =
                        Block::Arc { to: start, plane: (i, j), centre: (0.0, 0.0), clockwise, feed_mm_s };
                    sim.machine.load([arc]);
                    let every_s = std::f64::consts::TAU * radius / feed_mm_s / 360.0;
                    // The first and the last degrees speed up and slow down.
                    while !sim.machine.finished() {
                        sim.advance(every_s)?;
                        if sim.machine.finished() {
                            break;
                        }
                        let row = log.take(sim, if clockwise { 2.0 } else { 1.0 });
                        let p = row.now.position_mm;
                        row.angle = Some(libm::atan2(p[j], p[i]));
                    }
                    sim.finish()?;
                }
                Ok(())
            })?;
            let name = format!("ballbar-{}{}-{inches}", NAMES[i], NAMES[j]);
            let x = |r: &Row| r.angle.unwrap_or(0.0);
            runs.publish(
                setting,
                &name,
                Kind::Ballbar,
                (&[i.min(j), i.max(j)], 0.1),
                ("angle, rad", &x),
                &mut findings,
            )?;
        }
    }
    Ok(findings)
}

/// Runs a spindle cycle at rest at the reference and measures every minute.
fn soak(sim: &mut Sim, log: &mut Log, cycle: &[(f64, f64)], coolant: bool) -> Result<(), SimError> {
    sim.set_control_period(100_000_000);
    sim.machine.load([Block::Coolant { on: coolant }]);
    log.take(sim, 1.0);
    for &(rpm, minutes) in cycle {
        sim.machine.load([Block::Spindle { rpm }]);
        for _ in 0..minutes as usize {
            sim.advance(60.0)?;
            log.take(sim, 1.0);
        }
    }
    Ok(())
}

/// What the five gauges show: the near ones where the tool is, the far ones where a tilt of the true machine's chain takes the
/// mandrel as well.
fn gauged(rows: &[Row], setting: &Setting<'_>) -> Vec<Gauged> {
    let arcsec = |um: f64| um / (GAUGE_SPACING_MM * 1e3) * 648_000.0 / std::f64::consts::PI;
    let mut noise = Noise::new(setting.seed, 0x6A06E);
    let chain = setting.truth.chain();
    let far = chain.map(|c| c.with_tool_moved([0.0, 0.0, GAUGE_SPACING_MM]));
    let row = |r: &Row| {
        let leans = match (chain, &far) {
            (Some(near), Some(far)) => {
                let um = |c: &Chain| c.error_um(|a| placed(r, a), |d| difference(&r.temperatures, d));
                let (near, far) = (um(near), um(far));
                [far[0] - near[0], far[1] - near[1]]
            }
            _ => [0.0; 2],
        };
        let mut gauge = |um: f64| um + 0.1 * noise.normal();
        let [x, y, z] = [0, 1, 2].map(|p| r.now.off_um(p));
        let um = [gauge(y), gauge(x), gauge(z), gauge(y + leans[1]), gauge(x + leans[0])];
        Gauged { t_s: r.now.t_s, um, tilt_arcsec: [arcsec(um[4] - um[1]), arcsec(um[3] - um[0])] }
    };
    rows.iter().map(row).collect()
}

fn placed(row: &Row, axis: &Axis) -> f64 {
    NAMES.iter().position(|n| *n == axis.as_str()).map_or(0.0, |p| row.now.position_mm[p])
}

/// A temperature difference by what the sensors read, K.
fn difference(degc: &[f64], of: &Difference) -> f64 {
    let read = |name: &str| SENSORS.iter().position(|s| s.0 == name).map_or(STANDARD_DEGC, |k| degc[k]);
    read(&of.sensor)
        - match &of.against {
            Against::Sensor(m) => read(m),
            Against::Reference(degc) => *degc,
            Against::Standard => STANDARD_DEGC,
        }
}

fn drift(setting: &Setting<'_>) -> Result<Findings, ExperimentError> {
    let mut findings = nothing();
    for (name, coolant) in [("drift-dry", false), ("drift-wet", true)] {
        let runs =
            both(setting, &Spec::machining_centre(), [0.0; 3], |sim, log| soak(sim, log, FIGURE_9, coolant))?;
        let x = |r: &Row| r.now.t_s / 60.0;
        runs.publish(setting, name, Kind::Drift, (&[0, 1, 2], 0.1), ("time, min", &x), &mut findings)?;
        let mut chart = Chart::new(&format!("{name}: temperatures"), "time, min", "temperature, °C");
        for sensor in ["T8", "T9", "T13", "T18", "T20"] {
            let k = SENSORS.iter().position(|s| s.0 == sensor).unwrap_or(0);
            let points = runs.logs[0].rows.iter().map(|r| (r.now.t_s / 60.0, r.temperatures[k])).collect();
            chart = chart.with(Series::new(sensor, Style::Line, points));
        }
        findings.plots.push((format!("{name}-temperatures.svg"), chart.svg(900, 520)?));
        let gauged = gauged(&runs.logs[0].rows, setting);
        let line = |g: &Gauged| {
            let cells = std::iter::once(g.t_s).chain(g.um).chain(g.tilt_arcsec);
            cells.map(|v| format!("{v:.3}")).collect::<Vec<_>>().join(",") + "\n"
        };
        let head = "t_s,gauge1_um,gauge2_um,gauge3_um,gauge4_um,gauge5_um,tilt_x_arcsec,tilt_y_arcsec\n";
        let table = gauged.iter().map(line).collect::<String>();
        findings.plots.push((format!("{name}-gauges.csv"), head.to_owned() + &table));
        findings.gauges.push((name.to_owned(), gauged));
    }
    Ok(findings)
}

/// Minutes at speeds that [`FIGURE_9`] does not have, and rests, in another order.
const PRODUCTION: &[(f64, f64)] = &[
    (2000.0, 25.0),
    (4500.0, 50.0),
    (0.0, 10.0),
    (3500.0, 45.0),
    (5000.0, 40.0),
    (0.0, 20.0),
    (2500.0, 30.0),
    (5200.0, 20.0),
];

fn production(setting: &Setting<'_>) -> Result<Findings, ExperimentError> {
    let mut findings = nothing();
    let runs =
        both(setting, &Spec::machining_centre(), [0.0; 3], |sim, log| soak(sim, log, PRODUCTION, true))?;
    let x = |r: &Row| r.now.t_s / 60.0;
    let axes = &[0, 1, 2][..];
    runs.publish(setting, "production-cycle", Kind::Drift, (axes, 0.1), ("time, min", &x), &mut findings)?;
    Ok(findings)
}

fn tool_change(setting: &Setting<'_>) -> Result<Findings, ExperimentError> {
    let mut findings = nothing();
    // 300 in/min between the changes (WO 97/43703, text before table 3).
    let mm_min = 300.0 * 25.4;
    let runs = both(setting, &Spec::machining_centre(), [0.0; 3], |sim, log| {
        let mut moves = Noise::new(setting.seed, 0x7001);
        let reference = [50.0, 20.0, -100.0];
        for cycle in 1..=10 {
            for _ in 0..3 {
                let to = [250.0, 300.0, 600.0].map(|r| ((moves.uniform() - 0.5) * 2.0 * r).round());
                sim.run([feed(to, mm_min)])?;
            }
            sim.run([feed(reference, mm_min)])?;
            sim.advance(0.5)?;
            log.take(sim, f64::from(cycle));
        }
        Ok(())
    })?;
    let x = |r: &Row| r.cycle;
    // How well the holder seats in the spindle: a micrometre or so in each direction.
    let what = (&[0, 1, 2][..], 1.2);
    runs.publish(
        setting,
        "tool-change-repeatability",
        Kind::Positioning,
        what,
        ("tool change", &x),
        &mut findings,
    )?;
    Ok(findings)
}

fn drilling(setting: &Setting<'_>, warm: bool) -> Result<Findings, ExperimentError> {
    let mut findings = nothing();
    // At 5000 rpm without any motion.
    let soak = |sim: &mut Sim, minutes: f64| {
        sim.run([Block::Spindle { rpm: 5000.0 }])?;
        sim.set_control_period(100_000_000);
        sim.advance(60.0 * minutes)?;
        sim.set_control_period(0);
        Ok::<_, SimError>(())
    };
    let inch = 25.4;
    // Figure 12: a plate of 24 in by 8 in; each cycle drills near its corners, the next an inch further in X.
    let hole = |cycle: usize, n: usize| {
        let (left, low) = (n == 0 || n == 3, n < 2);
        let x = if left { -11.0 } else { 9.0 } + cycle as f64;
        [x * inch, if low { -3.0 * inch } else { 3.0 * inch }, 0.0]
    };
    let runs = both(setting, &Spec::machining_centre(), [0.0, 0.0, 100.0], |sim, log| {
        sim.machine.load([Block::Coolant { on: true }]);
        if warm {
            soak(sim, 180.0)?;
        }
        for cycle in 0..3 {
            for n in 0..4 {
                let at = hole(cycle, n);
                let above = [at[0], at[1], 5.0];
                for (depth, rpm, thrust) in [(-0.5 * inch, 2500.0, 400.0), (-0.25 * inch, 1200.0, 250.0)] {
                    sim.run([Block::Rapid { to: above }, Block::Spindle { rpm }])?;
                    sim.machine.load([feed([at[0], at[1], depth], 150.0)]);
                    sim.load_n = [0.0, 0.0, thrust];
                    sim.finish()?;
                    log.take(sim, cycle as f64 + 1.0);
                    sim.load_n = [0.0; AXES];
                    sim.run([Block::Rapid { to: above }])?;
                }
            }
            if cycle < 2 {
                soak(sim, 90.0)?;
            }
        }
        Ok(())
    })?;
    let x = |r: &Row| r.now.t_s / 60.0;
    let name = if warm { "drilling-warm" } else { "drilling" };
    runs.publish(setting, name, Kind::Part, (&[0, 1, 2], 0.5), ("time, min", &x), &mut findings)?;
    // As table 7: deviations with reference to hole 1.
    let mut table = Map::new();
    for (log, label) in runs.logs.iter().zip(["without", "with"]) {
        for (p, axis) in NAMES.iter().enumerate() {
            let first = log.rows[0].now.off_um(p);
            let worst = log.rows.iter().fold(0.0_f64, |w, r| w.max((r.now.off_um(p) - first).abs()));
            table.insert(format!("{axis}_{label}_um"), json!(digits(worst, 1e3)));
        }
    }
    findings.summary.insert("largest deviation from hole 1".to_owned(), Value::Object(table));
    Ok(findings)
}

/// A probing session as a record of the part: what differs from row to row is the angle and, last, the radial error. Time,
/// place and temperatures are those at its end: where the machine was at each trip says no more than the angle does.
fn part_record(session: Record, path: &Path) -> Result<Record, InputError> {
    let mut columns = session.columns;
    columns.sort_by_key(|c| match c.role {
        Role::Time | Role::Position(_) | Role::Direction(_) => 0,
        Role::Temperature => 1,
        _ => 2,
    });
    for column in &mut columns {
        let last = column.data.last().copied().unwrap_or(0.0);
        let per = if matches!(column.role, Role::Error(_)) { 1e4 } else { 1e9 };
        for v in &mut column.data {
            *v = match column.role {
                Role::Angle | Role::Error(_) => digits(*v, per),
                _ => digits(last, 1e6),
            };
        }
        if matches!(column.role, Role::Error(_)) {
            "e_r".clone_into(&mut column.name);
        }
    }
    Record::new(path, Kind::Probing, columns)
}

/// The loop of NISTIR 4854 without and with correction: by what is known of the part's form, or else by what the
/// semi-finish cut's own probing finds.
fn hemisphere(setting: &Setting<'_>) -> Result<Findings, ExperimentError> {
    let mut findings = nothing();
    let setup = Setup {
        machine: setting.truth.clone(),
        design: "c".to_owned(),
        seed: setting.seed,
        ..Setup::default()
    };
    let (mut records, mut figures) = (Vec::new(), Map::new());
    for (suffix, label) in SUFFIXES.into_iter().zip(["without", "with"]) {
        let setup = if suffix.is_empty() {
            setup.clone()
        } else {
            Setup { model: Some(setting.known.clone()), ..setup.clone() }
        };
        let turned = setup.turn_nose(!suffix.is_empty())?;
        let path = setting.out.join(format!("hemisphere{suffix}.run.toml"));
        // A session whose trips are all there has a record.
        let Some(record) = turned.record else { continue };
        let record = part_record(record, &path)?;
        let errors = record.responses().flat_map(|c| c.data.iter());
        let (lo, hi) =
            errors.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), e| (lo.min(*e), hi.max(*e)));
        figures.insert(format!("form_{label}_um"), json!(digits(hi - lo, 1e3)));
        let angles =
            record.columns.iter().find(|c| c.role == Role::Angle).map_or_else(Vec::new, |c| c.data.clone());
        records.push((record, angles));
    }
    findings.publish(setting, "hemisphere", records, "angle from Z, rad")?;
    findings.summary.insert("form".to_owned(), Value::Object(figures));
    Ok(findings)
}

fn plate(setting: &Setting<'_>) -> Result<Findings, ExperimentError> {
    let mut findings = nothing();
    let runs = both(setting, &Spec::machining_centre(), [0.0; 3], |sim, log| {
        for row in 0..9 {
            for k in 0..9 {
                let column = if row % 2 == 0 { k } else { 8 - k };
                let to = [f64::from(column - 4) * 60.0, f64::from(row - 4) * 70.0, 0.0];
                sim.run([feed(to, 5000.0)])?;
                sim.advance(0.3)?;
                log.take(sim, 1.0);
            }
        }
        Ok(())
    })?;
    let x = |r: &Row| r.now.position_mm[0];
    runs.publish(setting, "plate", Kind::Plate, (&[0, 1], 0.3), ("X, mm", &x), &mut findings)?;
    Ok(findings)
}

fn feed_sweep(setting: &Setting<'_>) -> Result<Findings, ExperimentError> {
    let mut findings = nothing();
    let spec = Spec::machining_centre();
    for (p, axis) in spec.axes.iter().enumerate() {
        let runs = both(setting, &spec, [0.0; 3], |sim, log| {
            let half = 60.0;
            sim.run([Block::Rapid { to: along(p, -half) }])?;
            for (n, mm_min) in
                [100.0, 300.0, 1000.0, 2000.0, 4000.0, 6000.0, 8000.0, 10_000.0].into_iter().enumerate()
            {
                for way in [half, -half] {
                    sim.machine.load([feed(along(p, way), mm_min)]);
                    // Forty rows over the stretch, whatever the feed; speeding up and slowing down included.
                    let every_s = 2.0 * half / (mm_min / 60.0) / 40.0;
                    while !sim.machine.finished() {
                        sim.advance(every_s)?;
                        if !sim.machine.finished() {
                            log.take(sim, n as f64 + 1.0);
                        }
                    }
                    sim.finish()?;
                }
            }
            Ok(())
        })?;
        let name = format!("feed-sweep-{}", axis.name);
        let x = |r: &Row| r.now.velocity_mm_s[p];
        runs.publish(setting, &name, Kind::FeedSweep, (&[p], 0.1), ("speed, mm/s", &x), &mut findings)?;
    }
    Ok(findings)
}

fn dynamics(setting: &Setting<'_>) -> Result<Findings, ExperimentError> {
    let mut findings = nothing();
    let spec = Spec::machining_centre();
    for (p, axis) in spec.axes.iter().enumerate() {
        let runs = both(setting, &spec, [0.0; 3], |sim, log| {
            for (n, mm_min) in [1000.0, 3000.0, 6000.0, 10_000.0].into_iter().enumerate() {
                for way in [40.0 + 10.0 * n as f64, -40.0] {
                    sim.machine.load([feed(along(p, way), mm_min)]);
                    while !sim.machine.finished() {
                        sim.advance(0.001)?;
                        log.take(sim, n as f64 + 1.0);
                    }
                    sim.finish()?;
                }
            }
            Ok(())
        })?;
        let name = format!("dynamics-{}", axis.name);
        let x = |r: &Row| r.now.t_s;
        runs.publish(setting, &name, Kind::Dynamics, (&[p], 5.0), ("time, s", &x), &mut findings)?;
    }
    Ok(findings)
}

/// The report's machine: one axis of a metre, corrected by the Original RTEC.
#[must_use]
pub fn one_metre(count_um: f64, travel_mm: f64) -> Spec {
    let mut spec = Spec::new(vec![AxisSpec { count_um, ..AxisSpec::new("x", travel_mm) }]);
    spec.design = Design::Original;
    spec.rest = RestPolicy::Wait;
    spec
}

fn linear_error(setting: &Setting<'_>) -> Result<Findings, ExperimentError> {
    // A quarter of the travel at a cutting feed.
    over_a_part(setting, &one_metre(1.0, 1000.0), 250.0, 500.0)
}

/// X over the length of a part at a cutting feed: how often something is inserted, and where.
///
/// # Errors
/// As [`Experiment::run`].
pub fn over_a_part(
    setting: &Setting<'_>,
    spec: &Spec,
    length_mm: f64,
    mm_min: f64,
) -> Result<Findings, ExperimentError> {
    let mut findings = nothing();
    let mut insertions = 0;
    let runs = both(setting, spec, [0.0; 3], |sim, log| {
        sim.machine.load([feed(along(0, length_mm), mm_min)]);
        while !sim.machine.finished() {
            // A row every millimetre.
            sim.advance(60.0 / mm_min)?;
            log.take(sim, 1.0);
        }
        sim.finish()?;
        insertions = sim.status().axes[0].insertions;
        Ok(())
    })?;
    let x = |r: &Row| r.now.position_mm[0];
    runs.publish(
        setting,
        "linear-error-240um",
        Kind::Positioning,
        (&[0], 0.0),
        ("position, mm", &x),
        &mut findings,
    )?;
    findings.summary.insert("insertions".to_owned(), json!(insertions));
    Ok(findings)
}

fn rapid_catch_up(setting: &Setting<'_>) -> Result<Findings, ExperimentError> {
    let mut findings = nothing();
    let mut spec = one_metre(1.0, 1000.0);
    // The 8051's nine microseconds (NISTIR 4832): at rapid traverse they do not fit.
    let nine =
        crate::computer::Computer::i8051().configure(Design::Original, rtec_rt::axis::AxisConfig::default());
    (spec.detect_ns, spec.write_ns) = (nine.detect_ns + nine.guard_ns, 500);
    let (mut waited, mut entering) = (0, Vec::new());
    let runs = both(setting, &spec, [0.0; 3], |sim, log| {
        let rapid = [
            Block::Rapid { to: [400.0, 0.0, 0.0] },
            feed([410.0, 0.0, 0.0], 500.0),
            feed([440.0, 0.0, 0.0], 200.0),
        ];
        sim.machine.load(rapid);
        while !sim.machine.finished() {
            sim.advance(0.02)?;
            log.take(sim, 1.0);
        }
        waited = sim.status().axes[0].waited_for_gate;
        // The tool enters the part after ten millimetres of feed in air.
        entering =
            log.rows.iter().filter(|r| r.now.position_mm[0] > 410.0).map(|r| r.now.off_um(0)).collect();
        Ok(())
    })?;
    let x = |r: &Row| r.now.position_mm[0];
    runs.publish(
        setting,
        "rapid-catch-up",
        Kind::Positioning,
        (&[0], 0.0),
        ("position, mm", &x),
        &mut findings,
    )?;
    let pending = |r: &Row| (r.requested_um[0] - r.now.inserted_um[0]).abs();
    let worst = runs.logs[1].rows.iter().map(pending).fold(0.0, f64::max);
    let in_part = entering.iter().fold(0.0_f64, |w, e| w.max(e.abs()));
    findings.summary.insert("edges_waited_for_gate".to_owned(), json!(waited));
    findings.summary.insert("largest_backlog_um".to_owned(), json!(digits(worst, 1e3)));
    findings.summary.insert("largest_error_in_part_um".to_owned(), json!(digits(in_part, 1e3)));
    Ok(findings)
}
