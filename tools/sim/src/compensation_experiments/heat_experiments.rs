//! Experiments with heat: spindle cycles, tool changes, drilling.

use super::runs::{Done, ExperimentRun, MeasuredRow, MeasuredRowLog, RunPair, digits, feed, places, seed_of};
use super::{
    ExperimentError, ExperimentInputs, ExperimentResult, GAUGE_SPACING_MM, MandrelGaugeReadings, PROMISED,
    UNSEEN,
};
use crate::corrected_machine_sim::{CorrectedMachineSim, MachineSpec, SimError};
use crate::nc_block::Block;
use crate::noise::NoiseGenerator;
use crate::thermal_network::{FIGURE_9, SENSORS};
use crate::trajectory::{AXES, AXIS_NAMES};
use rtec_measure::plot::{Chart, Series, Style};
use rtec_model::effect::{STANDARD_DEGC, TemperatureDifference};
use rtec_model::kinematic_chain::KinematicChain;
use rtec_model::machine::{FitNote, ValidTemperatureRange};
use rtec_model::record::{Axis, Record, RunKind};
use serde_json::{Map, Value, json};
use std::fmt::Write as _;

/// Runs a spindle cycle at rest at the reference and measures every minute.
fn soak(
    sim: &mut CorrectedMachineSim,
    log: &mut MeasuredRowLog,
    cycle: &[(f64, f64)],
    coolant: bool,
) -> Result<(), SimError> {
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

/// Runs a spindle cycle as an experiment and publishes it over the time.
fn soaked(
    experiment: &mut ExperimentRun<'_>,
    name: &str,
    cycle: &[(f64, f64)],
    coolant: bool,
) -> Result<RunPair, ExperimentError> {
    let runs = experiment.run_pair(name, |sim, log| soak(sim, log, cycle, coolant))?;
    let places = places(experiment.setting.spec);
    experiment.publish(&runs, RunKind::Drift, (&places, 0.1), ("time (min)", &minutes))?;
    Ok(runs)
}

fn minutes(row: &MeasuredRow) -> f64 {
    row.now.t_s / 60.0
}

/// Readings of the five gauges.
/// The near ones are at the tool. A tilt in the true machine's chain also moves the mandrel at the far ones.
fn gauged(rows: &[MeasuredRow], setting: &ExperimentInputs<'_>, run: &str) -> Vec<MandrelGaugeReadings> {
    let arcsec = |um: f64| um / (GAUGE_SPACING_MM * 1e3) * 648_000.0 / std::f64::consts::PI;
    let mut noise = NoiseGenerator::new(seed_of(setting, run), 0x6A06E);
    let chain = setting.truth.chain();
    let far = chain.map(|c| c.with_tool_moved([0.0, 0.0, GAUGE_SPACING_MM]));
    let row = |r: &MeasuredRow| {
        let leans = match (chain, &far) {
            (Some(near), Some(far)) => {
                let um =
                    |c: &KinematicChain| c.error_um(|a| placed(r, a), |d| difference(&r.temperatures, d));
                let (near, far) = (um(near), um(far));
                [far[0] - near[0], far[1] - near[1]]
            }
            _ => [0.0; 2],
        };
        let mut gauge = |um: f64| um + 0.1 * noise.normal();
        let [x, y, z] = [0, 1, 2].map(|p| r.now.off_um(p));
        let um = [gauge(y), gauge(x), gauge(z), gauge(y + leans[1]), gauge(x + leans[0])];
        MandrelGaugeReadings {
            t_s: r.now.t_s,
            um,
            tilt_arcsec: [arcsec(um[4] - um[1]), arcsec(um[3] - um[0])],
        }
    };
    rows.iter().map(row).collect()
}

fn placed(row: &MeasuredRow, axis: &Axis) -> f64 {
    AXIS_NAMES.iter().position(|n| *n == axis.as_str()).map_or(0.0, |p| row.now.axes[p].position_mm)
}

/// A temperature difference from the sensors' readings, K.
fn difference(degc: &[f64], of: &TemperatureDifference) -> f64 {
    let read = |name: &str| SENSORS.iter().position(|s| s.0 == name).map_or(STANDARD_DEGC, |k| degc[k]);
    read(&of.sensor) - of.minus().map_or(of.reference_degc(), read)
}

pub(super) fn drift(experiment: &mut ExperimentRun<'_>) -> Done {
    for (name, coolant) in [("drift-dry", false), ("drift-wet", true)] {
        let runs = soaked(experiment, name, FIGURE_9, coolant)?;
        let mut chart = Chart::new(&format!("{name}: temperatures"), "time (min)", "temperature (°C)");
        for sensor in ["T8", "T9", "T13", "T18", "T20"] {
            let k = SENSORS.iter().position(|s| s.0 == sensor).unwrap_or(0);
            let points = runs.logs[0].rows.iter().map(|r| (minutes(r), r.temperatures[k])).collect();
            chart = chart.with(Series::new(sensor, Style::Line, points));
        }
        experiment.findings.plots.push((format!("{name}-temperatures.svg"), chart.svg(900, 520)?));
        let gauged = gauged(&runs.logs[0].rows, experiment.setting, name);
        let line = |g: &MandrelGaugeReadings| {
            let cells = std::iter::once(g.t_s).chain(g.um).chain(g.tilt_arcsec);
            cells.map(|v| format!("{v:.3}")).collect::<Vec<_>>().join(",") + "\n"
        };
        let head = "t_s,gauge1_um,gauge2_um,gauge3_um,gauge4_um,gauge5_um,tilt_x_arcsec,tilt_y_arcsec\n";
        let table = gauged.iter().map(line).collect::<String>();
        experiment.findings.plots.push((format!("{name}-gauges.csv"), head.to_owned() + &table));
        experiment.findings.gauges.push((name.to_owned(), gauged));
    }
    Ok(())
}

/// A cycle with speeds, minutes and rests that differ from [`FIGURE_9`].
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

pub(super) fn production(experiment: &mut ExperimentRun<'_>) -> Done {
    soaked(experiment, "production-cycle", PRODUCTION, true).map(drop)
}

pub(super) fn tool_change(experiment: &mut ExperimentRun<'_>) -> Done {
    let seed = experiment.setting.seed;
    // 300 in/min between the changes (WO 97/43703, text before table 3).
    let mm_min = 300.0 * 25.4;
    let runs = experiment.run_pair("tool-change-repeatability", |sim, log| {
        let mut moves = NoiseGenerator::new(seed, 0x7001);
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
    let x = |r: &MeasuredRow| r.cycle;
    // Repeatability of the holder in the spindle: about a micrometre in each direction.
    let what = (&[0, 1, 2][..], 1.2);
    experiment.publish(&runs, RunKind::Positioning, what, ("tool change", &x))
}

/// The wet runs for the model of WO 97/43703 (text before equation 2).
/// They are in addition to the spindle cycle and the production cycle. Warm-up, speeds and cool-down are one
/// record, because a lag is known only from a start in equilibrium.
const WET_RUNS: [(&str, &[(f64, f64)]); 2] = [
    (
        "warm-day",
        &[
            (5000.0, 360.0),
            (3000.0, 40.0),
            (5500.0, 40.0),
            (1500.0, 40.0),
            (4500.0, 40.0),
            (0.0, 20.0),
            (2500.0, 40.0),
            (5200.0, 40.0),
            (0.0, 180.0),
        ],
    ),
    (
        "shift",
        &[
            (1500.0, 60.0),
            (0.0, 30.0),
            (5500.0, 60.0),
            (2500.0, 60.0),
            (0.0, 60.0),
            (4000.0, 90.0),
            (0.0, 60.0),
            (5500.0, 120.0),
            (0.0, 30.0),
            (3000.0, 60.0),
        ],
    ),
];

pub(super) fn wet_runs(experiment: &mut ExperimentRun<'_>) -> Done {
    for (name, cycle) in WET_RUNS {
        soaked(experiment, name, cycle, true)?;
    }
    Ok(())
}

/// Initial thermal state of a drilling test.
#[derive(Debug, Clone, Copy)]
pub(super) struct DrillingStartState {
    /// The spindle's earlier cycle, wet: rpm and minutes.
    pub(super) before: &'static [(f64, f64)],
    /// Temperature at which hall and machine stood, °C.
    /// The hall is heated for an hour before the start.
    pub(super) stood_degc: Option<f64>,
}

const HOLES: usize = 4;
/// Passes of a cycle (WO 97/43703, p. 25): the second an inch further in X.
const PASSES: usize = 2;
const CYCLES: usize = 3;
const INCH_MM: f64 = 25.4;

/// Position of a hole.
/// Figure 12: a plate of 24 in by 8 in. Each pass drills near its corners, the next one an inch further in X.
fn hole_mm(cycle: usize, pass: usize, n: usize) -> [f64; 3] {
    let (left, low) = (n == 0 || n == 3, n < 2);
    let x = if left { -11.0 } else { 6.0 } + (PASSES * cycle + pass) as f64;
    [x * INCH_MM, if low { -3.0 * INCH_MM } else { 3.0 * INCH_MM }, 0.0]
}

/// Runs the spindle through a cycle without any motion: rpm and minutes.
fn warm(sim: &mut CorrectedMachineSim, cycle: &[(f64, f64)]) -> Result<(), SimError> {
    for &(rpm, minutes) in cycle {
        sim.run([Block::Spindle { rpm }])?;
        sim.set_control_period(100_000_000);
        sim.advance(60.0 * minutes)?;
        sim.set_control_period(0);
    }
    Ok(())
}

pub(super) fn drilling(experiment: &mut ExperimentRun<'_>, name: &str, start: &DrillingStartState) -> Done {
    let setting = experiment.setting;
    let ambient_degc = start.stood_degc.unwrap_or(setting.spec.ambient_degc);
    let spec = MachineSpec { ambient_degc, ..setting.spec.clone() };
    let runs = experiment.both_on(&spec, [0.0, 0.0, 100.0], name, |sim, log| {
        if start.stood_degc.is_some() {
            sim.errors.heat.ambient_degc = setting.spec.ambient_degc;
            warm(sim, &[(0.0, 60.0)])?;
        }
        sim.machine.load([Block::Coolant { on: true }]);
        warm(sim, start.before)?;
        for cycle in 0..CYCLES {
            for (pass, n) in (0..PASSES * HOLES).map(|k| (k / HOLES, k % HOLES)) {
                let at = hole_mm(cycle, pass, n);
                let above = [at[0], at[1], 5.0];
                for (depth, rpm, thrust) in
                    [(-0.5 * INCH_MM, 2500.0, 400.0), (-0.25 * INCH_MM, 1200.0, 250.0)]
                {
                    sim.run([Block::Rapid { to: above }, Block::Spindle { rpm }])?;
                    sim.machine.load([feed([at[0], at[1], depth], 150.0)]);
                    sim.load_n = [0.0, 0.0, thrust];
                    sim.finish()?;
                    log.take(sim, cycle as f64 + 1.0);
                    sim.load_n = [0.0; AXES];
                    sim.run([Block::Rapid { to: above }])?;
                }
            }
            if cycle + 1 < CYCLES {
                warm(sim, &[(5000.0, 90.0)])?;
            }
        }
        Ok(())
    })?;
    experiment.publish(&runs, RunKind::Part, (&[0, 1, 2], 0.5), ("time (min)", &minutes))?;
    by_hole(name, &mut experiment.findings)?;
    promised(setting, &runs.logs[0].rows[0], &mut experiment.findings);
    Ok(())
}

/// Deviations relative to hole 1, as in table 7 and figures 21 to 23.
/// Each axis has a table, a plot and its largest deviation. Holes are as measured, as in `rtec-papers`.
fn by_hole(name: &str, findings: &mut ExperimentResult) -> Done {
    let off_um = |record: &Record, p: usize| -> Vec<f64> {
        let um = record.responses().nth(p).map_or(&[][..], |c| &c.data);
        um.iter().map(|e| digits(e - um[0], 1e3)).collect()
    };
    let records = std::mem::take(&mut findings.records);
    let labels = || records.iter().zip(["without", "with"]);
    let mut largest = Map::new();
    for (record, label) in labels() {
        for (p, axis) in AXIS_NAMES.iter().enumerate() {
            let worst = off_um(record, p).iter().fold(0.0_f64, |w, um| w.max(um.abs()));
            largest.insert(format!("{axis}_{label}_um"), json!(worst));
        }
    }
    findings.summary.insert("largest deviation from hole 1".to_owned(), Value::Object(largest));
    for (p, axis) in AXIS_NAMES.iter().enumerate() {
        let title = format!("{name}: deviation from hole 1 in {}", axis.to_uppercase());
        let mut chart = Chart::new(&title, "hole", "deviation (µm)");
        for (record, label) in labels() {
            let um = off_um(record, p);
            for cycle in 0..CYCLES {
                let holes = cycle * PASSES * HOLES..(cycle + 1) * PASSES * HOLES;
                let points = holes.map(|hole| (hole as f64 + 1.0, um[2 * hole])).collect();
                let series = format!("{label}, cycle {}", ["I", "II", "III"][cycle]);
                let style = if label == "with" { Style::Line } else { Style::Dots };
                chart = chart.with(Series::new(&series, style, points));
            }
        }
        findings.plots.push((format!("{name}-holes-{axis}.svg"), chart.svg(900, 420)?));
    }
    let mut table = "cycle,pass,hole,bore".to_owned();
    for (_, label) in labels() {
        table += &AXIS_NAMES.map(|axis| format!(",{axis}_{label}_um")).concat();
    }
    for row in 0..records[0].rows() {
        let (hole, bore) = (row / 2, ["hole", "counterbore"][row % 2]);
        let (cycle, pass) = (hole / (PASSES * HOLES), hole / HOLES % PASSES);
        // Writing to a String does not fail.
        let _ = write!(table, "\n{},{},{},{bore}", cycle + 1, pass + 1, hole + 1);
        for (record, _) in labels() {
            for p in 0..AXES {
                let _ = write!(table, ",{}", off_um(record, p)[row]);
            }
        }
    }
    findings.plots.push((format!("{name}-holes.csv"), table + "\n"));
    findings.records = records;
    Ok(())
}

/// Residuals that the model's own fits promise, and where they cannot.
/// A correction may gain nothing if the machine moves by less. `first`: the row at hole 1.
fn promised(setting: &ExperimentInputs<'_>, first: &MeasuredRow, findings: &mut ExperimentResult) {
    let Some(known) = setting.known else { return };
    let fits = known.fits();
    let mut say = |title: &str, of: &dyn Fn(&FitNote) -> Option<f64>| {
        let um = |fit: &FitNote| Some((format!("{}_um", fit.response), json!(digits(of(fit)?, 1e3))));
        let all: Map<String, Value> = fits.iter().filter_map(um).collect();
        if !all.is_empty() {
            findings.summary.insert(title.to_owned(), Value::Object(all));
        }
    };
    say(PROMISED, &|fit| Some(known.promised_um(fit)));
    say("promised, of that the reversal that a correction at rest may leave", &|fit| {
        Some(known.turned_back_um(&fit.response)).filter(|um| *um > 0.0)
    });
    say(UNSEEN, &|fit| {
        let seen = |v: &ValidTemperatureRange| v.outside_um(difference(&first.temperatures, &v.difference));
        let um = fit.valid.iter().map(seen).fold(0.0, f64::max);
        (um > fit.half_width_um).then_some(um)
    });
}
