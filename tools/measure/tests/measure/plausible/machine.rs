//! A random machine and the records of its runs.

use super::{column, noise, read, record};
use rtec_model::record::{Record, RunKind};
use std::f64::consts::TAU;
use test_needs::dice::Dice;

/// Settings that several records of one machine share.
pub(super) struct Machine {
    pub(super) ppm: f64,
    pub(super) reversal: f64,
    pub(super) wave: f64,
    pub(super) period: f64,
    pub(super) travel: f64,
    pub(super) targets: usize,
    pub(super) um_per_k: f64,
    pub(super) sensors: Vec<(f64, f64)>,
    pub(super) step_k: f64,
}

impl Machine {
    pub(super) fn random(d: &mut Dice) -> Self {
        let step_k = [0.0, 0.001, 0.01, 0.0625, 0.1][d.below(5)];
        let mut sensors = vec![(0.02, 20000.0)];
        for _ in 0..3 + d.below(4) {
            let gain = d.between(2.0, 14.0);
            sensors.push((gain, d.between(300.0, 6000.0)));
        }
        let sign = if d.chance(0.5) { 1.0 } else { -1.0 };
        Self {
            ppm: sign * d.between(20.0, 90.0),
            reversal: d.between(-8.0, 8.0),
            wave: d.between(0.0, 3.0),
            period: d.between(3.0, 40.0),
            travel: d.between(120.0, 950.0),
            targets: 9 + d.below(25),
            um_per_k: d.between(1.5, 5.0),
            sensors,
            step_k,
        }
    }

    pub(super) fn error(&self, p: f64, dir: f64) -> f64 {
        self.ppm * p / 1000.0 + self.reversal * dir / 2.0 + self.wave * (TAU * p / self.period).sin()
    }

    /// Temperatures over a cycle of spindle speeds, the air first; speeds in krpm.
    pub(super) fn temperatures(&self, d: &mut Dice, t: &[f64], krpm: &[f64]) -> Vec<Vec<f64>> {
        let (air, drift, phase) = (d.between(18.0, 24.0), d.between(0.3, 1.5), d.between(0.0, TAU));
        let span = t[t.len() - 1];
        let of = |(k, (gain, tau)): (usize, &(f64, f64)), d: &mut Dice| {
            let (mut x, mut v) = (0.0, Vec::new());
            for i in 0..t.len() {
                let h = if i == 0 { 0.0 } else { t[i] - t[i - 1] };
                x += (gain * krpm[i] / 6.0 - x) * (1.0 - (-h / tau).exp());
                let room = air + drift * (TAU * t[i] / span + phase).sin();
                v.push(room + if k == 0 { 0.0 } else { x } + d.normal() * 0.01);
            }
            if self.step_k > 0.0 { read(v, Some(self.step_k)) } else { v }
        };
        self.sensors.iter().enumerate().map(|s| of(s, d)).collect()
    }

    pub(super) fn positioning(&self, d: &mut Dice, name: &str) -> Record {
        let pitch = self.travel / (self.targets - 1) as f64;
        let jitter = if d.chance(0.5) { 0.3 } else { 0.0 };
        let places: Vec<f64> =
            (0..self.targets).map(|k| pitch * (k as f64 + jitter * (d.unit() - 0.5))).collect();
        let (mut p, mut dir, mut cycle) = (vec![], vec![], vec![]);
        for c in 0..2 + d.below(4) {
            for k in 0..2 * self.targets {
                let up = k < self.targets;
                let at = if up { k } else { 2 * self.targets - 1 - k };
                p.push(places[at]);
                dir.push(if up { 1.0 } else { -1.0 });
                cycle.push(c as f64 + 1.0);
            }
        }
        let n = p.len();
        if d.chance(0.5) {
            for p in &mut p {
                *p = ((*p + 0.002 * d.normal()) * 1e5).round() / 1e5;
            }
        }
        let (e, step) = noise(d, n);
        let e = e.iter().zip(&p).zip(&dir).map(|((e, p), dir)| e + self.error(*p, *dir)).collect();
        let mut columns = vec![];
        let dwell = d.between(3.0, 30.0);
        let t: Vec<f64> = (0..n).map(|i| (i as f64 * dwell * 10.0).round() / 10.0).collect();
        if d.chance(0.7) {
            columns.push(column("t", "time", t.clone()));
        }
        columns.push(column("x", "position.x", p));
        columns.push(column("dir", "direction.x", dir));
        if d.chance(0.7) {
            columns.push(column("n", "cycle", cycle));
        }
        if d.chance(0.4) {
            let krpm: Vec<f64> = t.iter().map(|_| 2.0).collect();
            for (k, v) in self.temperatures(d, &t, &krpm).into_iter().enumerate() {
                columns.push(column(&format!("T{k}"), "temperature", v));
            }
        }
        columns.push(column("e", "error.x", read(e, step)));
        let mut r = record(name, RunKind::Positioning, columns);
        r.count_um = step;
        r
    }

    pub(super) fn drift(&self, d: &mut Dice, name: &str) -> Record {
        let n = 150 + d.below(500);
        let every = [10.0, 30.0, 60.0][d.below(3)];
        let t: Vec<f64> = (0..n).map(|i| i as f64 * every).collect();
        let (mut krpm, mut speed) = (vec![], d.between(2.0, 8.0));
        for _ in 0..n {
            if d.chance(0.02) {
                speed = if d.chance(0.4) { 0.0 } else { d.between(1.0, 10.0) };
            }
            krpm.push(speed);
        }
        let temperatures = self.temperatures(d, &t, &krpm);
        let (e, step) = noise(d, n);
        let e = (0..n).map(|i| e[i] + self.um_per_k * (temperatures[1][i] - temperatures[0][i])).collect();
        let mut columns = vec![column("t", "time", t)];
        for (k, v) in temperatures.into_iter().enumerate() {
            columns.push(column(&format!("T{k}"), "temperature", v));
        }
        if d.chance(0.6) {
            columns.push(column("rpm", "spindle_speed", krpm.iter().map(|k| (k * 1000.0).round()).collect()));
        }
        if d.chance(0.5) {
            let wet: Vec<f64> = (0..n).map(|i| f64::from(u8::from((i / 40) % 3 == 1))).collect();
            columns.push(column("wet", "coolant", wet));
        }
        columns.push(column("e", "error.z", read(e, step)));
        record(name, RunKind::Drift, columns)
    }

    pub(super) fn plate(&self, d: &mut Dice) -> Record {
        let m = 7 + d.below(10);
        let (mut x, mut y) = (vec![], vec![]);
        for i in 0..m {
            for j in 0..m {
                x.push(self.travel * i as f64 / m as f64);
                y.push(self.travel * if i % 2 == 0 { j } else { m - 1 - j } as f64 / m as f64);
            }
        }
        let n = x.len();
        let (nx, step) = noise(d, n);
        let (ny, _) = noise(d, n);
        let ex = (0..n).map(|i| nx[i] + self.error(x[i], 0.0) - 0.02 * y[i]).collect();
        let ey = (0..n).map(|i| ny[i] + 0.02 * x[i]).collect();
        let columns = vec![
            column("X", "position.x", x),
            column("Y", "position.y", y),
            column("ex", "error.x", read(ex, step)),
            column("ey", "error.y", read(ey, None)),
        ];
        record("plate", RunKind::Plate, columns)
    }

    /// A circle both ways, sampled while it moves; with speeds, maybe accelerations.
    pub(super) fn ballbar(&self, d: &mut Dice) -> Record {
        let (radius, feed, m) = (150.0, d.between(10.0, 60.0), 150 + d.below(500));
        let mut c: Vec<Vec<f64>> = vec![vec![]; 9];
        let mut t = 0.0;
        for turn in [1.0, -1.0] {
            let w = turn * feed / radius;
            for i in 0..m {
                let a: f64 = turn * 1.1 * TAU * i as f64 / m as f64 + 0.3;
                let (s, k) = a.sin_cos();
                let row = [
                    t,
                    radius * k,
                    radius * s,
                    -radius * w * s,
                    radius * w * k,
                    -radius * w * w * k,
                    -radius * w * w * s,
                    self.error(radius * k, (-w * s).signum()),
                    0.01 * radius * k,
                ];
                c.iter_mut().zip(row).for_each(|(c, v)| c.push(v));
                t += 1.1 * TAU / m as f64 / w.abs();
            }
            t += 5.0;
        }
        let (n, step) = noise(d, 2 * m);
        let ex: Vec<f64> = c[7].iter().zip(n).map(|(e, n)| e + n).collect();
        let (n, _) = noise(d, 2 * m);
        let ey: Vec<f64> = c[8].iter().zip(n).map(|(e, n)| e + n).collect();
        let mut columns = vec![
            column("t", "time", c[0].clone()),
            column("x", "position.x", c[1].clone()),
            column("y", "position.y", c[2].clone()),
            column("vx", "velocity.x", c[3].clone()),
            column("vy", "velocity.y", c[4].clone()),
        ];
        columns.push(column("ax", "acceleration.x", c[5].clone()));
        columns.push(column("dx", "direction.x", c[3].iter().map(|v| v.signum()).collect()));
        columns.push(column("ex", "error.x", read(ex, step)));
        columns.push(column("ey", "error.y", read(ey, None)));
        record("ballbar", RunKind::Ballbar, columns)
    }

    pub(super) fn dynamics(d: &mut Dice) -> Record {
        let n = 400 + d.below(2000);
        let dt = 20.0 / n as f64;
        let (f, a) = (d.between(0.1, 0.5), d.between(10.0, 80.0));
        let w = TAU * f;
        let t: Vec<f64> = (0..n).map(|i| i as f64 * dt).collect();
        let p: Vec<f64> = t.iter().map(|t| a * (w * t).sin() + 3.0 * (2.3 * w * t).sin()).collect();
        let v: Vec<f64> = t.iter().map(|t| a * w * (w * t).cos() + 6.9 * w * (2.3 * w * t).cos()).collect();
        let acc: Vec<f64> = t
            .iter()
            .map(|t| -a * w * w * (w * t).sin() - 3.0 * (2.3 * w).powi(2) * (2.3 * w * t).sin())
            .collect();
        let (e, _) = noise(d, n);
        let force =
            (0..n).map(|i| 95.0 * acc[i] / 1000.0 + 0.2 * v[i] + 20.0 * v[i].signum() + e[i]).collect();
        let columns = vec![
            column("t", "time", t),
            column("q", "position.y", p),
            column("qd", "velocity.y", v),
            column("qdd", "acceleration.y", acc),
            column("f", "force.y", read(force, None)),
        ];
        record("dynamics", RunKind::Dynamics, columns)
    }

    pub(super) fn probing(d: &mut Dice) -> Record {
        let n = 60 + d.below(300);
        let angle: Vec<f64> = (0..n).map(|i| TAU * i as f64 / n as f64).collect();
        let (e, step) = noise(d, n);
        let e = (0..n).map(|i| e[i] + 4.0 * (3.0 * angle[i] + 0.4).cos()).collect();
        record(
            "probe",
            RunKind::Probing,
            vec![column("w", "angle", angle), column("e", "error.r", read(e, step))],
        )
    }
}
