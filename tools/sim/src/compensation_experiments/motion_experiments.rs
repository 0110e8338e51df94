//! Experiments in motion: displacement, circles, the plate, feeds and drive forces.

use super::runs::{Done, ExperimentRun, MeasuredRow, MeasuredRowLog, along, feed, places};
use crate::corrected_machine_sim::CorrectedMachineSim;
use crate::nc_block::Block;
use crate::noise::NoiseGenerator;
use crate::trajectory::{AXES, AXIS_NAMES};
use rtec_model::record::RunKind;

pub(super) fn linear_displacement(experiment: &mut ExperimentRun<'_>) -> Done {
    for (axis, p) in experiment.axes() {
        // ISO 230-2: targets over the travel, each off an even pitch by a random amount, so that no period is
        // hidden.
        let [lo, hi] = axis.travel_mm.map(|t| t * 0.95);
        let pitch = (hi - lo) / 12.0;
        let mut noise = NoiseGenerator::new(experiment.setting.seed, 0x150 + p as u64);
        let targets: Vec<f64> = (0..13)
            .map(|k| ((lo + pitch * f64::from(k) + 3.0 * (noise.uniform() - 0.5)) * 1000.0).round() / 1000.0)
            .collect();
        // WO 97/43703, text before table 2: 64 in/min.
        let mm_min = 64.0 * 25.4;
        let over = 4.0;
        let name = format!("linear-displacement-{}", axis.name);
        let runs = experiment.run_pair(&name, |sim, log| {
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
        let x = |r: &MeasuredRow| r.now.axes[p].position_mm;
        experiment.publish(&runs, RunKind::Positioning, (&[p], 0.1), ("position (mm)", &x))?;
    }
    Ok(())
}

pub(super) fn ballbar(experiment: &mut ExperimentRun<'_>) -> Done {
    let radius = 150.0;
    let there = places(experiment.setting.spec);
    let planes = [(0, 1), (1, 2), (2, 0)].into_iter().filter(|(i, j)| there.contains(i) && there.contains(j));
    for (i, j) in planes {
        for inches in [10.0, 50.0, 100.0] {
            let feed_mm_s = inches * 25.4 / 60.0;
            let mut start = [0.0; AXES];
            start[i] = radius;
            let name = format!("ballbar-{}{}-{inches}", AXIS_NAMES[i], AXIS_NAMES[j]);
            let runs = experiment.run_pair(&name, |sim, log| {
                sim.run([Block::Rapid { to: start }])?;
                for clockwise in [false, true] {
                    let arc =
                        Block::Arc { to: start, plane: (i, j), centre: (0.0, 0.0), clockwise, feed_mm_s };
                    let take = |sim: &mut CorrectedMachineSim, log: &mut MeasuredRowLog| {
                        let row = log.take(sim, if clockwise { 2.0 } else { 1.0 });
                        let [y, x] = [j, i].map(|p| row.now.axes[p].position_mm);
                        row.angle = Some(libm::atan2(y, x));
                    };
                    sim.machine.load([arc]);
                    let every_s = std::f64::consts::TAU * radius / feed_mm_s / 360.0;
                    // In the first and the last degrees the axes accelerate and decelerate.
                    while !sim.machine.finished() {
                        sim.advance(every_s)?;
                        if sim.machine.finished() {
                            break;
                        }
                        take(sim, log);
                    }
                    sim.finish()?;
                    // At the end the axes turn back for the other direction. Without this row the place of
                    // that reversal would be unknown.
                    take(sim, log);
                }
                Ok(())
            })?;
            let x = |r: &MeasuredRow| r.angle.unwrap_or(0.0);
            experiment.publish(&runs, RunKind::Ballbar, (&[i.min(j), i.max(j)], 0.1), ("angle, rad", &x))?;
        }
    }
    Ok(())
}

pub(super) fn plate(experiment: &mut ExperimentRun<'_>) -> Done {
    let runs = experiment.run_pair("plate", |sim, log| {
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
    let x = |r: &MeasuredRow| r.now.axes[0].position_mm;
    experiment.publish(&runs, RunKind::Plate, (&[0, 1], 0.3), ("X (mm)", &x))
}

pub(super) fn feed_sweep(experiment: &mut ExperimentRun<'_>) -> Done {
    for (axis, p) in experiment.axes() {
        let name = format!("feed-sweep-{}", axis.name);
        let runs = experiment.run_pair(&name, |sim, log| {
            let half = 60.0;
            sim.run([Block::Rapid { to: along(p, -half) }])?;
            for (n, mm_min) in
                [100.0, 300.0, 1000.0, 2000.0, 4000.0, 6000.0, 8000.0, 10_000.0].into_iter().enumerate()
            {
                for way in [half, -half] {
                    sim.machine.load([feed(along(p, way), mm_min)]);
                    // Forty rows over the stretch at any feed, including acceleration and deceleration.
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
        let x = |r: &MeasuredRow| r.now.axes[p].velocity_mm_s;
        experiment.publish(&runs, RunKind::FeedSweep, (&[p], 0.1), ("speed, mm/s", &x))?;
    }
    Ok(())
}

pub(super) fn dynamics(experiment: &mut ExperimentRun<'_>) -> Done {
    for (axis, p) in experiment.axes() {
        let name = format!("dynamics-{}", axis.name);
        let runs = experiment.run_pair(&name, |sim, log| {
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
        let x = |r: &MeasuredRow| r.now.t_s;
        experiment.publish(&runs, RunKind::Dynamics, (&[p], 5.0), ("time, s", &x))?;
    }
    Ok(())
}
