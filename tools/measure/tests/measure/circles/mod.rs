//! Circles run on machines that are known: what the ballbar's tests share.

#![allow(dead_code, clippy::unwrap_used)] // each test takes what it needs; a test's own helpers

use rtec_measure::ballbar::{self, BallbarResult};
use rtec_model::ballbar_circle::Circle;
use rtec_model::machine::Machine;
use rtec_model::record::{Axis, Column, Record, Role, RunKind};
use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::path::Path;

pub(crate) fn column(name: &str, role: &str, data: Vec<f64>) -> Column {
    Column::new(name, Role::parse(role).unwrap(), data)
}

/// Circles by angle and time only: each a sense of turning and a feed.
pub(crate) struct Run {
    pub(crate) radius_mm: f64,
    pub(crate) plane: [&'static str; 2],
    pub(crate) circles: Vec<(f64, f64)>,
    pub(crate) rows: usize,
    /// Angle of the first row, rad.
    pub(crate) from: f64,
}

impl Run {
    pub(crate) fn both(radius_mm: f64, feed_mm_s: f64) -> Self {
        Self {
            radius_mm,
            plane: ["x", "y"],
            circles: vec![(1.0, feed_mm_s), (-1.0, feed_mm_s)],
            rows: 720,
            from: 0.4,
        }
    }

    /// Rows of time, angle and sense of turning.
    pub(crate) fn rows(&self) -> Vec<[f64; 3]> {
        let mut now = 0.0;
        let mut rows = Vec::new();
        for (turn, feed) in &self.circles {
            let step = TAU * 1.02 / self.rows as f64;
            for i in 0..self.rows {
                rows.push([now, turn * (i as f64 + 0.5) * step + self.from, *turn]);
                now += step * self.radius_mm / feed;
            }
            now += 3.0;
        }
        rows
    }

    pub(crate) fn record(&self, name: &str, error: impl FnMut([f64; 3]) -> f64) -> Record {
        let rows = self.rows();
        let columns = vec![
            column("t", "time", rows.iter().map(|r| r[0]).collect()),
            column("a", "angle", rows.iter().map(|r| r[1].rem_euclid(TAU)).collect()),
            column("e", "error.r", rows.into_iter().map(error).collect()),
        ];
        let record = Record::new(Path::new(name), RunKind::Ballbar, columns).unwrap();
        let plane = self.plane.map(|n| Axis::new(n).unwrap());
        record.with_circle(Circle { radius_mm: self.radius_mm, plane, centre_mm: None }).unwrap()
    }

    /// As a machine's model has it, with noise of this size and memory.
    pub(crate) fn of_machine(&self, effects: &str, noise: &mut Noise, sd: f64, phi: f64) -> Record {
        let ideal = self.record("b.run.toml", |_| 0.0);
        let mut text = String::from("name = \"m\"\neffect = []\n");
        if !effects.is_empty() {
            text = String::from("name = \"m\"\n");
        }
        for line in effects.lines().map(str::trim).filter(|l| !l.is_empty()) {
            let (name, values) = line.split_once(' ').unwrap();
            let _ = write!(text, "[[effect]]\nname = \"{name}\"\n{}\n", values.replace("; ", "\n"));
        }
        let machine = Machine::parse(Path::new("m.toml"), &text).unwrap();
        let said = machine.predict(&ideal).unwrap().columns.swap_remove(0).1;
        let mut said = said.into_iter();
        let mut last = 0.0;
        self.record("b.run.toml", |_| {
            last = phi * last + (1.0 - phi * phi).sqrt() * sd * noise.normal();
            said.next().unwrap() + last
        })
    }
}

pub(crate) struct Noise(pub(crate) u64);

impl Noise {
    pub(crate) fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub(crate) fn normal(&mut self) -> f64 {
        let (u, v) = (1.0 - self.unit(), self.unit());
        (-2.0 * u.ln()).sqrt() * (TAU * v).cos()
    }

    pub(crate) fn within(&mut self, lo: f64, hi: f64) -> f64 {
        lo + (hi - lo) * self.unit()
    }
}

pub(crate) fn one(records: &[Record]) -> BallbarResult {
    let mut all = ballbar::evaluate(records).unwrap();
    assert_eq!(all.len(), 1);
    all.swap_remove(0)
}

#[track_caller]
pub(crate) fn near(got: impl Into<Option<f64>>, want: f64, within: f64) {
    let got = got.into().unwrap();
    assert!((got - want).abs() <= within, "{got} and {want}");
}

/// A map over the positions of a circle, random at knots 50 mm apart, without constant and line over the circle.
pub(crate) fn map_without_line(noise: &mut Noise, size_um: f64) -> String {
    let knots: Vec<f64> = (0..7).map(|k| -150.0 + 50.0 * f64::from(k)).collect();
    let mut um: Vec<f64> = knots.iter().map(|_| noise.within(-size_um, size_um)).collect();
    let at = |um: &[f64], p: f64| {
        let k = (((p + 150.0) / 50.0) as usize).min(5);
        um[k] + (um[k + 1] - um[k]) * (p - knots[k]) / 50.0
    };
    let circle: Vec<f64> = (0..720).map(|i| 150.0 * (TAU * f64::from(i) / 720.0).cos()).collect();
    let n = circle.len() as f64;
    let mean = circle.iter().map(|p| at(&um, *p)).sum::<f64>() / n;
    let slope =
        circle.iter().map(|p| at(&um, *p) * p).sum::<f64>() / circle.iter().map(|p| p * p).sum::<f64>();
    um.iter_mut().zip(&knots).for_each(|(u, p)| *u -= mean + slope * p);
    format!("knots_mm = {knots:?}; um = {um:?}")
}
