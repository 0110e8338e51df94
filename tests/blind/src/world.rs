//! Random experiments on random machines, and what each error source adds to them.
//!
//! The formulas here are written from the file format's table alone: nothing is shared with the code under test.

use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{RngCore, SeedableRng};
use std::f64::consts::{PI, TAU};

/// Random numbers of one case.
pub struct Dice(Xoshiro256PlusPlus);

impl Dice {
    /// Dice of a seed.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self(Xoshiro256PlusPlus::seed_from_u64(seed))
    }
    /// Uniform in [0, 1).
    pub fn unit(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }
    /// Uniform in a range.
    pub fn within(&mut self, lo: f64, hi: f64) -> f64 {
        lo + (hi - lo) * self.unit()
    }
    /// Uniform in the logarithm.
    pub fn log(&mut self, lo: f64, hi: f64) -> f64 {
        (self.within(lo.ln(), hi.ln())).exp()
    }
    /// A whole number, both ends possible.
    pub fn int(&mut self, lo: usize, hi: usize) -> usize {
        lo + (self.unit() * (hi - lo + 1) as f64) as usize
    }
    /// True with probability `p`.
    pub fn chance(&mut self, p: f64) -> bool {
        self.unit() < p
    }
    /// One of several, each equally likely.
    pub fn pick<'a, T>(&mut self, from: &'a [T]) -> &'a T {
        &from[self.int(0, from.len() - 1)]
    }
    /// Standard normal (Box and Muller).
    pub fn normal(&mut self) -> f64 {
        let u = 1.0 - self.unit();
        (-2.0 * u.ln()).sqrt() * (TAU * self.unit()).cos()
    }
    /// −1 or +1, each equally likely.
    pub fn sign(&mut self) -> f64 {
        if self.chance(0.5) { 1.0 } else { -1.0 }
    }
}

/// One logged column of a run.
#[derive(Clone)]
pub struct Col {
    /// Name in the CSV.
    pub name: String,
    /// Role in the sidecar.
    pub role: String,
    /// Unit in the sidecar.
    pub unit: &'static str,
    /// Values; a truth that is not logged is kept with `logged = false`.
    pub v: Vec<f64>,
    /// Whether it goes into the CSV.
    pub logged: bool,
}

/// One run of an experiment.
#[derive(Clone, Default)]
pub struct Run {
    /// Kind, as the sidecar has it.
    pub kind: &'static str,
    /// The columns but the responses.
    pub cols: Vec<Col>,
    /// Roles of the responses.
    pub responses: Vec<String>,
    /// Number of rows.
    pub n: usize,
}

impl Run {
    fn add(&mut self, name: &str, role: &str, unit: &'static str, v: Vec<f64>, logged: bool) {
        self.n = v.len();
        self.cols.push(Col { name: name.into(), role: role.into(), unit, v, logged });
    }
    fn get(&self, role: &str) -> Option<&[f64]> {
        self.cols.iter().find(|c| c.role == role).map(|c| &c.v[..])
    }
    fn has(&self, role: &str) -> bool {
        self.cols.iter().any(|c| c.role == role && c.logged)
    }
    fn named(&self, name: &str) -> Vec<f64> {
        self.cols.iter().find(|c| c.name == name).map_or_else(|| vec![0.0; self.n], |c| c.v.clone())
    }
    /// Names of the columns of a role.
    #[must_use]
    pub fn names(&self, role: &str) -> Vec<String> {
        self.cols.iter().filter(|c| c.role == role && c.logged).map(|c| c.name.clone()).collect()
    }
    fn time(&self) -> Vec<f64> {
        match self.cols.iter().find(|c| c.role == "time" && c.logged) {
            Some(c) => c.v.clone(),
            None => (0..self.n).map(|i| i as f64).collect(),
        }
    }
    fn dir(&self, axis: &str) -> Vec<f64> {
        if self.has(&format!("direction.{axis}")) {
            return self.get(&format!("direction.{axis}")).unwrap_or_default().to_vec();
        }
        let v = self.get(&format!("velocity.{axis}")).unwrap_or_default();
        v.iter().map(|&v| if v == 0.0 { 0.0 } else { v.signum() }).collect()
    }
}

/// An error source of the true machine.
#[derive(Clone, Debug)]
pub struct Source {
    /// The name by which the answer has to call it; a shape of no dictionary starts with `?`.
    pub name: String,
    /// Parameters with one value, by name.
    pub num: Vec<(&'static str, f64)>,
    /// Parameters with one value per knot.
    pub arr: Vec<(&'static str, Vec<f64>)>,
    /// Names of the sensors, by key (`sensor`, `minus`).
    pub text: Vec<(&'static str, String)>,
}

impl Source {
    fn new(name: String) -> Self {
        Self { name, num: vec![], arr: vec![], text: vec![] }
    }
    fn p(mut self, key: &'static str, v: f64) -> Self {
        self.num.push((key, v));
        self
    }
    /// The value of a parameter that has only one; 0 where it has none.
    #[must_use]
    pub fn val(&self, key: &str) -> f64 {
        self.num.iter().find(|(k, _)| *k == key).map_or(0.0, |(_, v)| *v)
    }
    fn array(&self, key: &str) -> &[f64] {
        self.arr.iter().find(|(k, _)| *k == key).map_or(&[], |(_, v)| &v[..])
    }
    fn word(&self, key: &str) -> Option<&str> {
        self.text.iter().find(|(k, _)| *k == key).map(|(_, v)| &v[..])
    }
    fn law(&self) -> &str {
        self.name.split('.').next().unwrap_or("")
    }
    fn part(&self, i: usize) -> &str {
        self.name.split('.').nth(i).unwrap_or("")
    }
    /// Keys by which the size of the effect scales.
    fn sizes(&self) -> Vec<&'static str> {
        self.num
            .iter()
            .map(|(k, _)| *k)
            .filter(|k| {
                ![
                    "period_mm",
                    "period_um",
                    "phase_rad",
                    "length_mm",
                    "tau_s",
                    "at_s",
                    "lobes",
                    "centre_rad",
                    "width_rad",
                    "reference_degC",
                    "c",
                ]
                .contains(k)
            })
            .collect()
    }
    /// Makes it larger by a factor.
    pub fn scale(&mut self, by: f64) {
        let sizes = self.sizes();
        for (k, v) in &mut self.num {
            if sizes.contains(k) {
                *v *= by;
            }
        }
        for (k, v) in &mut self.arr {
            if *k == "um" {
                v.iter_mut().for_each(|v| *v *= by);
            }
        }
    }
    /// Puts its parameters a little off, as a model that was fitted some time ago has them.
    pub fn off(&mut self, dice: &mut Dice, share: f64) {
        let sizes = self.sizes();
        for (k, v) in &mut self.num {
            match *k {
                "period_mm" | "period_um" => *v *= 1.0 + 1e-4 * dice.normal(),
                "phase_rad" => *v += share * dice.normal(),
                "at_s" | "lobes" | "reference_degC" => {}
                "centre_rad" => *v += 0.1 * share * dice.normal(),
                _ if sizes.contains(k) || *k == "tau_s" || *k == "length_mm" || *k == "width_rad" => {
                    *v *= 1.0 + share * dice.normal();
                }
                _ => {}
            }
        }
        if let [(_, knots), (_, um)] = &mut self.arr[..] {
            um.iter_mut().for_each(|v| *v *= 1.0 + share * dice.normal());
            flatten(knots, um);
        }
    }
    /// `[[effect]]` of a model.
    #[must_use]
    pub fn toml(&self) -> String {
        let mut s = format!("[[effect]]\nname = \"{}\"\n", self.name);
        for (k, v) in &self.text {
            s += &format!("{k} = \"{v}\"\n");
        }
        for (k, v) in &self.num {
            if *k == "lobes" {
                s += &format!("{k} = {}\n", *v as i64);
            } else {
                s += &format!("{k} = {v:?}\n");
            }
        }
        for (k, v) in &self.arr {
            s += &format!("{k} = {v:?}\n");
        }
        s + "\n"
    }

    fn delta(&self, run: &Run) -> Vec<f64> {
        let a = run.named(self.word("sensor").unwrap_or(""));
        if let Some(m) = self.word("minus") {
            a.iter().zip(run.named(m)).map(|(a, b)| a - b).collect()
        } else {
            let reference = self.num.iter().find(|(k, _)| *k == "reference_degC").map_or(20.0, |(_, v)| *v);
            a.iter().map(|a| a - reference).collect()
        }
    }

    /// What this source adds to one response over a run.
    #[must_use]
    pub fn on(&self, run: &Run, response: &str) -> Vec<f64> {
        let n = run.n;
        let zero = vec![0.0; n];
        let axis = response.split('.').nth(1).unwrap_or("");
        let force = response.starts_with("force");
        let a = self.part(1);
        let col = |role: String| run.get(&role).map_or_else(|| vec![0.0; n], <[f64]>::to_vec);
        let pos = |ax: &str| col(format!("position.{ax}"));
        let vel = |ax: &str| col(format!("velocity.{ax}"));
        let law = self.law();
        let is_force = law.starts_with("friction")
            || law.starts_with("inertia")
            || law == "force_offset"
            || law.starts_with("?f");
        if is_force != force {
            return zero;
        }
        if law == "rotation" {
            let other = if axis == a { self.part(2) } else { a };
            if axis != a && axis != self.part(2) {
                return zero;
            }
            let s = if axis == a { -1.0 } else { 1.0 };
            return pos(other).iter().map(|p| s * self.val("urad") * p / 1000.0).collect();
        }
        if !a.is_empty() && axis != a {
            return zero;
        }
        let map = |v: Vec<f64>, f: &dyn Fn(f64) -> f64| v.into_iter().map(f).collect::<Vec<_>>();
        match law {
            "offset" => vec![self.val("um"); n],
            "scale" => map(pos(a), &|p| self.val("ppm") * p / 1000.0),
            "position_map" => map(pos(a), &|p| broken_line(self.array("knots_mm"), self.array("um"), p)),
            "straightness" => {
                map(pos(self.part(2)), &|p| broken_line(self.array("knots_mm"), self.array("um"), p))
            }
            "screw_periodic" => map(pos(a), &|p| {
                self.val("um") * (TAU * p / self.val("period_mm") + self.val("phase_rad")).sin()
            }),
            "subdivision" => map(pos(a), &|p| {
                self.val("um") * (TAU * p * 1000.0 / self.val("period_um") + self.val("phase_rad")).sin()
            }),
            "reversal" => map(run.dir(a), &|d| self.val("um") * d / 2.0),
            "reversal_spike" => {
                let (p, d) = (pos(a), run.dir(a));
                let mut since: Option<f64> = None;
                (0..n)
                    .map(|i| {
                        if i > 0 && d[i] * d[i - 1] < 0.0 {
                            since = Some(0.0);
                        }
                        since = since.map(|way| way + (p[i] - p[i - 1]).abs());
                        since.map_or(0.0, |way| self.val("um") * d[i] * (-way / self.val("length_mm")).exp())
                    })
                    .collect()
            }
            "squareness" => map(pos(self.part(2)), &|p| self.val("urad") * p / 1000.0),
            "angular" => pos(self.part(2))
                .iter()
                .zip(pos(self.part(3)))
                .map(|(b, c)| self.val("urad_per_m") * b * c / 1e6)
                .collect(),
            "thermal_expansion" => self
                .delta(run)
                .iter()
                .zip(pos(a))
                .map(|(d, p)| self.val("ppm_per_K") * d * p / 1000.0)
                .collect(),
            "thermal_growth" => {
                map(self.delta(run), &|d| self.val("um_per_K") * d + self.val("um_per_K2") * d * d)
            }
            "thermal_lag" => {
                // The lag's exact answer to a straight line between two rows.
                let (d, t, tau) = (self.delta(run), run.time(), self.val("tau_s"));
                let mut y = d[0];
                (0..n)
                    .map(|i| {
                        if i > 0 && t[i] > t[i - 1] {
                            let h = t[i] - t[i - 1];
                            let k = (d[i] - d[i - 1]) / h;
                            y = (d[i] - k * tau) + (y - d[i - 1] + k * tau) * (-h / tau).exp();
                        }
                        self.val("um_per_K") * y + self.val("um_per_K2") * y * y
                    })
                    .collect()
            }
            "warm_up" => map(run.time(), &|t| self.val("um") * (1.0 - (-t / self.val("tau_s")).exp())),
            "coolant" => map(col("coolant".into()), &|w| if w > 0.5 { self.val("um") } else { 0.0 }),
            "spindle_speed" => map(col("spindle_speed".into()), &|r| {
                let k = r / 1000.0;
                self.val("um_per_krpm") * k + self.val("um_per_krpm2") * k * k
            }),
            "following_error" => map(vel(a), &|v| self.val("ms") * v),
            "acceleration_error" => {
                map(col(format!("acceleration.{a}")), &|v| self.val("um_per_m_s2") * v / 1000.0)
            }
            "stiffness" => map(col(format!("load.{a}")), &|f| self.val("um_per_N") * f),
            "lost_counts" => map(run.time(), &|t| if t >= self.val("at_s") { self.val("um") } else { 0.0 }),
            "probe_latency" => map(vel(a), &|v| self.val("us") * v / 1000.0),
            "probe_lobing" => map(col("angle".into()), &|w| {
                self.val("um") * (self.val("lobes") * w + self.val("phase_rad")).cos()
            }),
            "form_bump" => map(col("angle".into()), &|w| {
                let d = (w - self.val("centre_rad") + PI).rem_euclid(TAU) - PI;
                if d.abs() > self.val("width_rad") / 2.0 {
                    0.0
                } else {
                    self.val("um") * (1.0 + (TAU * d / self.val("width_rad")).cos()) / 2.0
                }
            }),
            "channel" => map(run.named(self.part(2)), &|z| self.val("gain") * z),
            "inertia" => map(col(format!("acceleration.{a}")), &|v| self.val("kg") * v / 1000.0),
            "friction_viscous" => map(vel(a), &|v| self.val("N_s_per_m") * v / 1000.0),
            "friction_coulomb" => map(vel(a), &|v| if v == 0.0 { 0.0 } else { self.val("N") * v.signum() }),
            "friction_asymmetric" => map(vel(a), &|v| self.val("N_s_per_m") * v.abs() / 1000.0),
            "force_offset" => vec![self.val("N"); n],
            _ => self.stranger(run, a),
        }
    }

    /// Shapes that are in no dictionary; `c` is their free number.
    fn stranger(&self, run: &Run, a: &str) -> Vec<f64> {
        let n = run.n;
        let c = self.val("c");
        let col = |role: String| run.get(&role).map_or_else(|| vec![0.0; n], <[f64]>::to_vec);
        let unit = |v: Vec<f64>| {
            let (lo, hi) = v.iter().fold((f64::MAX, f64::MIN), |(l, h), &x| (l.min(x), h.max(x)));
            v.into_iter()
                .map(|x| if hi > lo { 2.0 * (x - lo) / (hi - lo) - 1.0 } else { 0.0 })
                .collect::<Vec<_>>()
        };
        let p = unit(col(format!("position.{a}")));
        let v = unit_size(col(format!("velocity.{a}")));
        let t = unit(run.time());
        let d = run.dir(a);
        let sensor = self.word("sensor").map(|s| unit(run.named(s))).unwrap_or_default();
        let shape: Vec<f64> = (0..n)
            .map(|i| match self.law() {
                "?dir_times_position" => d[i] * p[i],
                "?dir_times_wave" => d[i] * (PI * c * p[i]).sin(),
                "?time_wave" => (PI * c * (t[i] + 1.0)).sin(),
                "?time_burst" => (-((t[i] - c) / 0.12).powi(2)).exp(),
                "?time_saw" => (c * (t[i] + 1.0)).fract() - 0.5,
                "?speed_squared" | "?f_speed_squared" => v[i] * v[i].abs() - 0.77 * v[i],
                "?stribeck" | "?f_stribeck" => v[i].signum() * (-(v[i] / 0.15).powi(2)).exp(),
                "?f_cogging" => (PI * c * p[i]).sin(),
                "?f_position_friction" => p[i] * v[i].signum(),
                "?temperature_wave" => (PI * c * sensor[i]).sin(),
                "?temperature_knee" => (sensor[i] - c).max(0.0),
                "?angle_square" => {
                    let w = run.get("angle").unwrap_or_default();
                    (c * w[i]).sin().signum()
                }
                "?angle_saw" => {
                    let w = run.get("angle").unwrap_or_default();
                    (c * w[i] / TAU).rem_euclid(1.0) - 0.5
                }
                "?drifting_scale" => p[i] * t[i],
                "?position_time_wave" => p[i] * (PI * c * t[i]).sin(),
                "?load_squared" => {
                    let f = run.get(&format!("load.{a}")).unwrap_or_default();
                    let m = f.iter().fold(1e-9_f64, |m, x| m.max(x.abs()));
                    let z = f[i] / m;
                    z * z.abs() - 0.7 * z
                }
                "?saddle" => {
                    let b = run.get(&format!("position.{}", self.part(2))).unwrap_or_default();
                    let m = b.iter().fold(1e-9_f64, |m, x| m.max(x.abs()));
                    (PI * c * p[i]).sin() * (PI * b[i] / m).sin()
                }
                other => unreachable!("no shape {other}"),
            })
            .collect();
        shape.into_iter().map(|s| self.val("um") * s).collect()
    }
}

fn unit_size(v: Vec<f64>) -> Vec<f64> {
    let m = v.iter().fold(1e-9_f64, |m, x| m.max(x.abs()));
    v.into_iter().map(|x| x / m).collect()
}

fn broken_line(x: &[f64], y: &[f64], at: f64) -> f64 {
    if at <= x[0] {
        return y[0];
    }
    for k in 1..x.len() {
        if at <= x[k] {
            return y[k - 1] + (y[k] - y[k - 1]) * (at - x[k - 1]) / (x[k] - x[k - 1]);
        }
    }
    y[y.len() - 1]
}

/// Takes the constant and the straight line out of values at knots.
fn flatten(x: &[f64], y: &mut [f64]) {
    let n = x.len() as f64;
    let (mx, my) = (x.iter().sum::<f64>() / n, y.iter().sum::<f64>() / n);
    let sxx: f64 = x.iter().map(|v| (v - mx).powi(2)).sum();
    let sxy: f64 = x.iter().zip(y.iter()).map(|(a, b)| (a - mx) * (b - my)).sum();
    for (a, b) in x.iter().zip(y) {
        *b -= my + sxy / sxx * (a - mx);
    }
}

/// How a family of cases differs in manner from another.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Manner {
    /// The family the method was developed on.
    First,
    /// Other experiments, other column names, other noise: for validation.
    Second,
}

/// Settings of an experiment that training and hold-out runs share.
#[derive(Clone)]
pub struct Plan {
    /// Name of the experiment, one of [`DESIGNS`].
    pub design: &'static str,
    axes: Vec<String>,
    travel: f64,
    n: usize,
    seed: u64,
    time: bool,
    cycles: usize,
    sensors: usize,
    alike: bool,
    decoys: usize,
    regular: bool,
    manner: Manner,
    speed_constant: bool,
    extra: [bool; 4],
}

/// Names of the experiments.
pub const DESIGNS: [&str; 10] = [
    "positioning",
    "sweep",
    "drift",
    "spots",
    "plate",
    "volume",
    "ballbar",
    "dynamics",
    "probing",
    "feed_sweep",
];

impl Plan {
    /// A random plan of an experiment.
    pub fn new(dice: &mut Dice, design: &'static str, manner: Manner) -> Self {
        let second = manner == Manner::Second;
        let names: &[&str] = if second { &["x", "y", "z", "u", "w"] } else { &["x", "y", "z"] };
        let mut axes: Vec<String> = Vec::new();
        while axes.len() < 3 {
            let a = (*dice.pick(names)).to_owned();
            if !axes.contains(&a) {
                axes.push(a);
            }
        }
        let n = if dice.chance(0.15) { dice.log(1500.0, 5000.0) } else { dice.log(60.0, 1500.0) } as usize;
        Self {
            design,
            axes,
            travel: dice.log(60.0, 900.0),
            n,
            seed: dice.0.next_u64(),
            time: dice.chance(0.75),
            cycles: dice.int(1, 6),
            sensors: dice.int(1, if second { 6 } else { 5 }),
            alike: dice.chance(0.3),
            decoys: dice.int(0, 4),
            regular: dice.chance(0.6),
            manner,
            speed_constant: dice.chance(0.3),
            extra: [dice.chance(0.5), dice.chance(0.5), dice.chance(0.5), dice.chance(0.5)],
        }
    }

    /// Runs it: the same plan with another `turn` is another run of the same experiment.
    #[must_use]
    pub fn run(&self, turn: u64) -> Run {
        let mut fixed = Dice::new(self.seed);
        let mut dice = Dice::new(self.seed ^ (turn + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15));
        let mut r = Run::default();
        match self.design {
            "positioning" | "sweep" => self.positioning(&mut r, &mut fixed, &mut dice),
            "drift" | "spots" => self.drift(&mut r, &mut fixed, &mut dice),
            "plate" | "volume" => self.plate(&mut r, &mut fixed, &mut dice),
            "ballbar" => self.ballbar(&mut r, &mut dice),
            "dynamics" => self.dynamics(&mut r, &mut fixed, &mut dice),
            "probing" => self.probing(&mut r, &mut dice),
            _ => self.feed_sweep(&mut r, &mut dice),
        }
        for k in 0..self.decoys {
            let name = match self.manner {
                Manner::First => format!("z{k}"),
                Manner::Second => {
                    [format!("aux_{k}"), format!("Öldruck-{k}"), format!("{k}%")][k % 3].clone()
                }
            };
            let kind = fixed.int(0, 3);
            let (f, ph) = (fixed.within(0.5, 4.0), dice.within(0.0, TAU));
            let mut walk = dice.normal();
            let v = (0..r.n)
                .map(|i| match kind {
                    0 => dice.normal(),
                    1 => {
                        walk += 0.1 * dice.normal();
                        walk
                    }
                    2 => (TAU * f * i as f64 / r.n as f64 + ph).sin() + 0.1 * dice.normal(),
                    _ => {
                        walk = 0.9 * walk + 0.4 * dice.normal();
                        50.0 + 10.0 * walk
                    }
                })
                .collect();
            r.add(&name, "channel", "1", v, true);
        }
        r
    }

    fn temperatures(&self, r: &mut Run, t: &[f64], heat: &[f64], fixed: &mut Dice, dice: &mut Dice) {
        let span = (t[t.len() - 1] - t[0]).max(1.0);
        let ambient0 = fixed.within(18.5, 23.0);
        let (da, pa) = (fixed.within(0.2, 2.0), dice.within(0.0, TAU));
        let rate = fixed.within(0.4, 1.5);
        let ambient: Vec<f64> =
            t.iter().map(|t| ambient0 + da * (TAU * rate * (t - span * 0.1) / span + pa).sin()).collect();
        let prefix = if self.manner == Manner::Second { "PT100_" } else { "T" };
        let noise = fixed.log(0.003, 0.05);
        let mut first: Option<Vec<f64>> = None;
        for k in 0..self.sensors {
            let tau = span * fixed.log(0.02, 0.6);
            let gain = fixed.within(1.0, 9.0);
            let own = fixed.within(0.0, 0.6);
            let (own_rate, own_phase) = (fixed.within(0.7, 3.0), dice.within(0.0, TAU));
            let mut x = 0.0;
            let mut v: Vec<f64> = (0..t.len())
                .map(|i| {
                    if i > 0 {
                        x += (heat[i] - x) * (1.0 - (-(t[i] - t[i - 1]) / tau).exp());
                    }
                    ambient[i] + gain * x + own * (TAU * own_rate * t[i] / span + own_phase).sin()
                })
                .collect();
            if k == self.sensors - 1 && k > 0 {
                v.clone_from(&ambient);
            }
            if k == 1
                && self.alike
                && let Some(f) = &first
            {
                let g = fixed.within(0.9, 1.1);
                v = f.iter().map(|f| 20.0 + g * (f - 20.0)).collect();
            }
            first.get_or_insert_with(|| v.clone());
            v.iter_mut().for_each(|v| *v = ((*v + noise * dice.normal()) * 1000.0).round() / 1000.0);
            r.add(&format!("{prefix}{k}"), "temperature", "degC", v, true);
        }
    }

    fn positioning(&self, r: &mut Run, fixed: &mut Dice, dice: &mut Dice) {
        let a = &self.axes[0];
        r.kind = "positioning";
        r.responses = vec![format!("error.{a}")];
        let start = if fixed.chance(0.5) { 0.0 } else { -self.travel / 2.0 };
        let sweep = self.design == "sweep";
        let targets = if sweep { (self.n / 2).max(30) } else { fixed.int(7, 41) };
        let cycles = if sweep { 1 } else { self.cycles.max((60 / (2 * targets)) + 1) };
        let base: Vec<f64> = (0..targets)
            .map(|i| {
                let step = self.travel / (targets - 1) as f64;
                let j = if self.regular && !sweep { 0.0 } else { fixed.within(-0.45, 0.45) };
                start + step * (i as f64 + j)
            })
            .collect();
        let mut feed = vec![];
        let (mut p, mut d, mut c) = (vec![], vec![], vec![]);
        for cyc in 0..cycles {
            let f = if self.speed_constant { 20.0 } else { *dice.pick(&[5.0, 10.0, 20.0, 40.0]) };
            for (dir, order) in [(1.0, base.clone()), (-1.0, base.iter().rev().copied().collect::<Vec<_>>())]
            {
                for q in order {
                    p.push(((q + 0.002 * dice.normal()) * 1e5).round() / 1e5);
                    d.push(dir);
                    c.push(cyc as f64 + 1.0);
                    feed.push(f * dir);
                }
            }
        }
        let n = p.len();
        let dwell = fixed.within(1.0, 30.0);
        let t: Vec<f64> = (0..n).map(|i| (i as f64 * dwell * 10.0).round() / 10.0).collect();
        r.add("t", "time", "s", t.clone(), self.time);
        r.add(&format!("pos_{a}"), &format!("position.{a}"), "mm", p, true);
        if self.manner == Manner::First || self.extra[3] || !self.extra[0] {
            r.add("dir", &format!("direction.{a}"), "1", d, true);
        }
        if self.extra[0] {
            r.add("feed", &format!("velocity.{a}"), "mm/s", feed, true);
        }
        if cycles > 1 {
            r.add("n", "cycle", "1", c, true);
        }
        if self.extra[1] {
            let heat: Vec<f64> = (0..n).map(|i| (TAU * i as f64 / n as f64 * 0.7).sin().abs()).collect();
            self.temperatures(r, &t, &heat, fixed, dice);
        }
        if self.extra[2] {
            let f = (0..n).map(|_| dice.within(-200.0, 400.0).round()).collect();
            r.add("F", &format!("load.{a}"), "N", f, true);
        }
    }

    fn drift(&self, r: &mut Run, fixed: &mut Dice, dice: &mut Dice) {
        let a = &self.axes[2];
        r.kind = "drift";
        r.responses = vec![format!("error.{a}")];
        if self.extra[3] && self.design == "drift" {
            r.responses.push(format!("error.{}", self.axes[0]));
        }
        let n = self.n.max(80);
        let span = fixed.log(1800.0, 30000.0);
        let t: Vec<f64> = (0..n).map(|i| (span * i as f64 / n as f64 * 10.0).round() / 10.0).collect();
        let levels = dice.int(3, 9);
        let cuts: Vec<f64> = (0..levels).map(|_| dice.unit()).collect();
        let level: Vec<f64> = (0..=levels)
            .map(|_| if dice.chance(0.3) { 0.0 } else { (dice.within(0.5, 12.0) * 2.0).round() * 500.0 })
            .collect();
        let rpm: Vec<f64> = t.iter().map(|t| level[cuts.iter().filter(|c| **c < t / span).count()]).collect();
        let heat: Vec<f64> = rpm.iter().map(|r| (r / 6000.0).powf(1.5)).collect();
        r.add(if self.manner == Manner::Second { "clock" } else { "t" }, "time", "s", t.clone(), self.time);
        self.temperatures(r, &t, &heat, fixed, dice);
        if self.extra[0] || self.manner == Manner::First {
            r.add("rpm", "spindle_speed", "rpm", rpm, true);
        }
        if self.extra[1] {
            let k = dice.int(2, 6) as f64;
            let ph = dice.unit();
            let wet = t.iter().map(|t| f64::from(u8::from((k * t / span + ph).fract() > 0.5))).collect();
            r.add("wet", "coolant", "1", wet, true);
        }
        if self.design == "spots" {
            let spots: Vec<f64> =
                (0..fixed.int(2, 7)).map(|i| (i as f64 * self.travel / 6.0).round()).collect();
            let p: Vec<f64> = (0..n).map(|i| spots[i % spots.len()]).collect();
            r.add("pz", &format!("position.{a}"), "mm", p, true);
        }
    }

    fn plate(&self, r: &mut Run, fixed: &mut Dice, dice: &mut Dice) {
        let (a, b, c) = (&self.axes[0], &self.axes[1], &self.axes[2]);
        r.kind = "plate";
        let volume = self.design == "volume";
        r.responses = vec![format!("error.{a}")];
        if !volume || self.extra[0] {
            r.responses.push(format!("error.{b}"));
        }
        let m = ((self.n.clamp(60, 900)) as f64).sqrt() as usize;
        let repeats = if m < 14 { self.cycles.min(3) } else { 1 };
        let (mut x, mut y, mut z, mut cyc) = (vec![], vec![], vec![], vec![]);
        let centred = fixed.chance(0.6);
        for k in 0..repeats {
            for i in 0..m {
                for jj in 0..m {
                    let j = if i % 2 == 0 { jj } else { m - 1 - jj };
                    let jit = if self.regular { 0.0 } else { 0.3 };
                    let s = |g: usize, d: &mut Dice| {
                        self.travel
                            * ((g as f64 + jit * d.within(-1.0, 1.0)) / (m - 1) as f64
                                - if centred { 0.5 } else { 0.0 })
                    };
                    x.push((s(i, fixed) * 1e3).round() / 1e3);
                    y.push((s(j, fixed) * 1e3).round() / 1e3);
                    z.push((dice.within(0.0, 0.6) * self.travel).round());
                    cyc.push(k as f64);
                }
            }
        }
        let n = x.len();
        let t: Vec<f64> = (0..n).map(|i| i as f64 * 15.0).collect();
        r.add("t", "time", "s", t.clone(), self.time && self.extra[3]);
        r.add("X", &format!("position.{a}"), "mm", x, true);
        r.add("Y", &format!("position.{b}"), "mm", y, true);
        if volume {
            r.add("Z", &format!("position.{c}"), "mm", z, true);
        }
        if repeats > 1 {
            r.add("rep", "cycle", "1", cyc, true);
        }
        if self.extra[1] {
            let heat: Vec<f64> = (0..n).map(|i| i as f64 / n as f64).collect();
            self.temperatures(r, &t, &heat, fixed, dice);
        }
    }

    fn ballbar(&self, r: &mut Run, dice: &mut Dice) {
        let (a, b) = (&self.axes[0], &self.axes[1]);
        r.kind = "ballbar";
        r.responses = vec![format!("error.{a}"), format!("error.{b}")];
        let radius = self.travel.min(300.0) / 2.0;
        let n = self.n.clamp(200, 3000);
        let mut cols: [Vec<f64>; 11] = Default::default();
        let mut now = 0.0;
        let feeds = if self.speed_constant { vec![30.0] } else { vec![10.0, 50.0] };
        let passes = 2 * feeds.len();
        for pass in 0..passes {
            let turn = if pass % 2 == 0 { 1.0 } else { -1.0 };
            let feed = feeds[pass / 2];
            let w = turn * feed / radius;
            let m = n / passes;
            for i in 0..m {
                let th: f64 = turn * TAU * 1.1 * i as f64 / m as f64 + 0.3;
                let (s, c) = th.sin_cos();
                let row = [
                    now,
                    radius * c,
                    radius * s,
                    (-w * s).signum(),
                    (w * c).signum(),
                    -radius * w * s,
                    radius * w * c,
                    -radius * w * w * c,
                    -radius * w * w * s,
                    th.rem_euclid(TAU),
                    pass as f64,
                ];
                cols.iter_mut().zip(row).for_each(|(c, v)| c.push(v));
                now += (TAU * 1.1 / m as f64 / w.abs()).max(1e-4);
            }
            now += 5.0;
        }
        let _ = dice.unit();
        let [t, x, y, dx, dy, vx, vy, ax, ay, th, pass] = cols;
        r.add("t", "time", "s", t, self.time);
        r.add("x", &format!("position.{a}"), "mm", x, true);
        r.add("y", &format!("position.{b}"), "mm", y, true);
        if self.extra[0] {
            r.add("dx", &format!("direction.{a}"), "1", dx, true);
            r.add("dy", &format!("direction.{b}"), "1", dy, true);
        }
        r.add("vx", &format!("velocity.{a}"), "mm/s", vx, true);
        r.add("vy", &format!("velocity.{b}"), "mm/s", vy, true);
        if self.extra[1] {
            r.add("ax", &format!("acceleration.{a}"), "mm/s2", ax, true);
            r.add("ay", &format!("acceleration.{b}"), "mm/s2", ay, true);
        }
        let _ = th;
        if self.extra[2] {
            r.add("pass", "cycle", "1", pass, true);
        }
    }

    fn moves(&self, dice: &mut Dice, n: usize, dt: f64) -> [Vec<f64>; 4] {
        let waves: Vec<(f64, f64, f64)> =
            (0..3).map(|_| (dice.within(0.1, 0.6), dice.within(0.0, TAU), dice.within(0.2, 1.0))).collect();
        let mut out: [Vec<f64>; 4] = Default::default();
        for i in 0..n {
            let t = i as f64 * dt;
            let (mut p, mut v, mut acc) = (0.0, 0.0, 0.0);
            for (f, ph, g) in &waves {
                let w = TAU * f;
                p += g * (w * t + ph).sin();
                v += g * w * (w * t + ph).cos();
                acc -= g * w * w * (w * t + ph).sin();
            }
            let s = self.travel / 4.0;
            for (o, x) in out.iter_mut().zip([t, p * s, v * s, acc * s]) {
                o.push(x);
            }
        }
        out
    }

    fn dynamics(&self, r: &mut Run, fixed: &mut Dice, dice: &mut Dice) {
        let a = &self.axes[1];
        r.kind = "dynamics";
        r.responses = vec![format!("force.{a}")];
        let n = self.n.clamp(300, 5000);
        let _ = fixed.unit();
        let [t, p, v, acc] = self.moves(dice, n, 20.0 / n as f64);
        r.add("t_s", "time", "s", t, self.time);
        r.add("q", &format!("position.{a}"), "mm", p, true);
        r.add("qd", &format!("velocity.{a}"), "mm/s", v, true);
        r.add("qdd", &format!("acceleration.{a}"), "mm/s2", acc, true);
    }

    fn probing(&self, r: &mut Run, dice: &mut Dice) {
        r.kind = if self.extra[2] && self.manner == Manner::Second { "part" } else { "probing" };
        let a = &self.axes[0];
        let radial = self.extra[0];
        r.responses = vec![if radial { "error.r".into() } else { format!("error.{a}") }];
        let n = self.n.clamp(60, 1200);
        let turns = dice.int(1, 3) as f64;
        let angle: Vec<f64> = (0..n)
            .map(|i| ((turns * TAU * i as f64 / n as f64).rem_euclid(TAU) * 1e5).round() / 1e5)
            .collect();
        let t: Vec<f64> = (0..n).map(|i| i as f64 * 4.0).collect();
        r.add("t", "time", "s", t, self.time && self.extra[1]);
        r.add(if self.manner == Manner::Second { "theta" } else { "ang" }, "angle", "rad", angle, true);
        if r.kind == "probing" && (!radial || self.extra[3]) {
            let axis = if radial { "r" } else { a };
            let v: Vec<f64> = (0..n)
                .map(|_| *dice.pick(&[1.0, 2.0, 5.0, 8.0]) * if radial { -1.0 } else { dice.sign() })
                .collect();
            if !radial {
                r.add("d", &format!("direction.{axis}"), "1", v.iter().map(|v| v.signum()).collect(), true);
            }
            r.add("v", &format!("velocity.{axis}"), "mm/s", v, true);
        }
        if !radial && self.extra[3] {
            let p: Vec<f64> = r.get("angle").unwrap_or_default().iter().map(|w| 40.0 * w.cos()).collect();
            r.add("p", &format!("position.{a}"), "mm", p, true);
        }
    }

    fn feed_sweep(&self, r: &mut Run, dice: &mut Dice) {
        let a = &self.axes[1];
        r.kind = "feed_sweep";
        r.responses = vec![format!("error.{a}")];
        let n = self.n.clamp(100, 2500);
        let [t, p, v, acc] = self.moves(dice, n, 60.0 / n as f64);
        if self.extra[0] {
            r.add(
                "sgn",
                &format!("direction.{a}"),
                "1",
                v.iter().map(|v| if *v < 0.0 { -1.0 } else { 1.0 }).collect(),
                true,
            );
        }
        r.add("t", "time", "s", t, self.time);
        r.add("y", &format!("position.{a}"), "mm", p, true);
        r.add("vy", &format!("velocity.{a}"), "mm/s", v, true);
        if self.extra[1] {
            r.add("ay", &format!("acceleration.{a}"), "mm/s2", acc, true);
        }
        if self.extra[2] {
            let mut f = 0.0;
            let load = (0..n)
                .map(|_| {
                    f = 0.95 * f + 30.0 * dice.normal();
                    f
                })
                .collect();
            r.add("F", &format!("load.{a}"), "N", load, true);
        }
    }

    /// A random source that a run of this plan can show, or none for a kind that it cannot.
    pub fn source(&self, dice: &mut Dice, run: &Run, law: &str) -> Option<Source> {
        let resp = dice.pick(&run.responses).clone();
        let (head, a) = resp.split_once('.')?;
        let force = head == "force";
        let p = run.get(&format!("position.{a}"));
        let span = |v: &[f64]| v.iter().fold((f64::MAX, f64::MIN), |(l, h), &x| (l.min(x), h.max(x)));
        let time = run.time();
        let (t0, t1) = (time[0], time[run.n - 1]);
        let name = format!("{law}.{a}");
        let needs = |ok: bool| ok.then_some(());
        if force != (law.starts_with("friction") || law == "inertia" || law == "force_offset") {
            return None;
        }
        let varies = |role: String| {
            run.has(&role)
                && run.get(&role).is_some_and(|v| {
                    let (l, h) = span(v);
                    h > l
                })
        };
        let others: Vec<&str> =
            run.cols.iter().filter_map(|c| c.role.strip_prefix("position.")).filter(|b| *b != a).collect();
        let sensors = run.names("temperature");
        let thermal = |dice: &mut Dice, s: Source| {
            let mut s = s;
            let one = dice.pick(&sensors).clone();
            if sensors.len() > 2 && dice.chance(0.3) {
                let two = sensors.iter().rev().find(|x| **x != one)?.clone();
                s.text = vec![("sensor", one), ("minus", two)];
            } else {
                s.text = vec![("sensor", one)];
                if dice.chance(0.25) {
                    s = s.p("reference_degC", (dice.within(18.0, 24.0) * 2.0).round() / 2.0);
                }
            }
            Some(s)
        };
        let line = |dice: &mut Dice, v: &[f64], name: String| {
            let (lo, hi) = span(v);
            let k = dice.int(4, 11);
            let mut distinct: Vec<i64> = v.iter().map(|x| (x * 1000.0).round() as i64).collect();
            distinct.sort_unstable();
            distinct.dedup_by(|a, b| (*a - *b).abs() < 300);
            if distinct.len() < 5 {
                return None;
            }
            let k = k.min(distinct.len() - 1).max(4);
            let knots: Vec<f64> = (0..k).map(|i| lo + (hi - lo) * i as f64 / (k - 1) as f64).collect();
            let mut walk = 0.0;
            let mut um: Vec<f64> = (0..k)
                .map(|_| {
                    walk = 0.5 * walk + dice.normal();
                    walk
                })
                .collect();
            flatten(&knots, &mut um);
            let mut s = Source::new(name);
            s.arr = vec![("knots_mm", knots), ("um", um)];
            Some(s)
        };
        Some(match law {
            "offset" => Source::new(name).p("um", dice.sign()),
            "force_offset" => Source::new(name).p("N", dice.sign()),
            "scale" => {
                needs(varies(format!("position.{a}")))?;
                Source::new(name).p("ppm", dice.sign())
            }
            "position_map" => line(dice, p?, name)?,
            "straightness" => {
                let b = *others.first()?;
                let v = run.get(&format!("position.{b}"))?;
                line(dice, v, format!("straightness.{a}.{b}"))?
            }
            "screw_periodic" => {
                let (lo, hi) = span(p?);
                let mut gaps: Vec<f64> = p?.to_vec();
                gaps.sort_by(f64::total_cmp);
                gaps.dedup_by(|x, y| (*x - *y).abs() < 0.01);
                // Few places and a wave through them: a map, a scale or an offset as well.
                needs(gaps.len() >= 8)?;
                let step = (hi - lo) / gaps.len() as f64;
                let period =
                    *dice.pick(&[2.0, 4.0, 5.0, 6.0, 10.0, 12.0, 16.0, 20.0, 25.0]) * dice.within(0.97, 1.03);
                needs(
                    period < (hi - lo) / 2.5
                        && (period > 2.3 * step || (!self.regular && period > 0.5 * step)),
                )?;
                Source::new(name).p("period_mm", period).p("um", 1.0).p("phase_rad", dice.within(-PI, PI))
            }
            "subdivision" => {
                let mut places: Vec<i64> = p?.iter().map(|p| (p * 1e4).round() as i64).collect();
                places.sort_unstable();
                places.dedup();
                needs(places.len() > 50 && (self.design == "sweep" || !self.regular))?;
                let period = if dice.chance(0.5) {
                    *dice.pick(&[2.0, 4.0, 10.0, 20.0, 40.0, 100.0])
                } else {
                    dice.log(4.0, 150.0)
                };
                Source::new(name).p("period_um", period).p("um", 1.0).p("phase_rad", dice.within(-PI, PI))
            }
            "reversal" => {
                needs(
                    span(&run.dir(a)).1 > span(&run.dir(a)).0
                        && !run.dir(a).is_empty()
                        && run.dir(a).len() == run.n,
                )?;
                Source::new(name).p("um", dice.sign())
            }
            "reversal_spike" => {
                let d = run.dir(a);
                needs(d.len() == run.n && run.kind != "probing")?;
                let (lo, hi) = span(p?);
                let length = (hi - lo) * dice.log(0.01, 0.15);
                let turns = d.windows(2).filter(|w| w[0] * w[1] < 0.0).count();
                needs(turns >= 2)?;
                Source::new(name).p("um", dice.sign()).p("length_mm", length)
            }
            "squareness" => {
                needs(run.responses.len() == 1)?;
                Source::new(format!("squareness.{a}.{}", others.first()?)).p("urad", dice.sign())
            }
            "rotation" => {
                needs(run.responses.len() == 2)?;
                let mut ab: Vec<&str> = run.responses.iter().map(|r| &r[6..]).collect();
                ab.sort_unstable();
                needs(run.has(&format!("position.{}", ab[0])) && run.has(&format!("position.{}", ab[1])))?;
                Source::new(format!("rotation.{}.{}", ab[0], ab[1])).p("urad", dice.sign())
            }
            "angular" => {
                needs(others.len() >= 2)?;
                let mut bc = [others[0], others[1]];
                bc.sort_unstable();
                Source::new(format!("angular.{a}.{}.{}", bc[0], bc[1])).p("urad_per_m", dice.sign())
            }
            "thermal_expansion" => {
                needs(!sensors.is_empty() && varies(format!("position.{a}")))?;
                {
                    let s = Source::new(name).p("ppm_per_K", dice.sign());
                    thermal(dice, s)?
                }
            }
            "thermal_growth" => {
                needs(!sensors.is_empty())?;
                let k2 = if dice.chance(0.4) { dice.within(-0.05, 0.05) } else { 0.0 };
                {
                    let s = Source::new(name).p("um_per_K", dice.sign()).p("um_per_K2", k2);
                    thermal(dice, s)?
                }
            }
            "thermal_lag" => {
                needs(!sensors.is_empty() && run.n > 80)?;
                let tau = (t1 - t0) * dice.log(0.03, 0.3);
                {
                    let s = Source::new(name).p("um_per_K", dice.sign()).p("um_per_K2", 0.0).p("tau_s", tau);
                    thermal(dice, s)?
                }
            }
            "warm_up" => Source::new(name).p("um", dice.sign()).p("tau_s", (t1 - t0) * dice.log(0.04, 0.5)),
            "coolant" => {
                needs(varies("coolant".into()))?;
                Source::new(name).p("um", dice.sign())
            }
            "spindle_speed" => {
                needs(varies("spindle_speed".into()))?;
                let k2 = if dice.chance(0.4) { dice.within(-0.06, 0.06) } else { 0.0 };
                Source::new(name).p("um_per_krpm", dice.sign()).p("um_per_krpm2", k2)
            }
            "following_error" => {
                needs(run.kind != "probing" && varies(format!("velocity.{a}")))?;
                Source::new(name).p("ms", dice.sign())
            }
            "acceleration_error" => {
                needs(varies(format!("acceleration.{a}")))?;
                Source::new(name).p("um_per_m_s2", dice.sign())
            }
            "stiffness" => {
                needs(varies(format!("load.{a}")))?;
                Source::new(name).p("um_per_N", dice.sign())
            }
            "lost_counts" => Source::new(name)
                .p("um", dice.sign())
                .p("at_s", ((t0 + (t1 - t0) * dice.within(0.15, 0.85)) * 10.0).round() / 10.0),
            "probe_latency" => {
                needs(run.kind == "probing" && varies(format!("velocity.{a}")))?;
                Source::new(name).p("us", dice.sign())
            }
            "probe_lobing" => {
                needs(run.has("angle"))?;
                Source::new("probe_lobing".into())
                    .p("um", 1.0)
                    .p("lobes", dice.int(2, 6) as f64)
                    .p("phase_rad", dice.within(-PI, PI))
            }
            "form_bump" => {
                needs(run.has("angle"))?;
                Source::new("form_bump".into())
                    .p("um", dice.sign())
                    .p("centre_rad", dice.within(0.0, TAU))
                    .p("width_rad", dice.log(0.25, 2.5))
            }
            "channel" => {
                let z = run.names("channel");
                needs(!z.is_empty())?;
                Source::new(format!("channel.{a}.{}", dice.pick(&z))).p("gain", dice.sign())
            }
            "inertia" => Source::new(name).p("kg", dice.sign()),
            "friction_viscous" | "friction_asymmetric" => Source::new(name).p("N_s_per_m", dice.sign()),
            "friction_coulomb" => Source::new(name).p("N", dice.sign()),
            _ => return None,
        })
    }

    /// A random shape that is in no dictionary and that this run can show.
    pub fn stranger(&self, dice: &mut Dice, run: &Run) -> Option<Source> {
        let resp = dice.pick(&run.responses).clone();
        let a = resp.split_once('.')?.1.to_owned();
        let has = |role: &str| run.has(&format!("{role}.{a}"));
        let mut can: Vec<(&str, f64)> = vec![];
        if resp.starts_with("force") {
            can.extend([
                ("?f_speed_squared", 0.0),
                ("?f_stribeck", 0.0),
                ("?f_cogging", dice.within(4.0, 9.0)),
                ("?f_position_friction", 0.0),
            ]);
        } else {
            let d = run.dir(&a);
            if has("position") && d.len() == run.n && run.kind != "probing" {
                can.extend([("?dir_times_position", 0.0), ("?dir_times_wave", dice.within(0.7, 2.0))]);
            }
            // In a single turn the angle is the time, and a burst a bump of the form.
            let once = run.get("angle").is_some_and(|w| w.windows(2).all(|w| w[1] >= w[0]));
            if !once {
                can.extend([
                    ("?time_wave", dice.within(1.5, 6.0)),
                    ("?time_burst", dice.within(-0.7, 0.7)),
                    ("?time_saw", dice.within(1.5, 4.0)),
                ]);
            }
            if run.kind == "feed_sweep" || (run.kind == "ballbar" && !self.speed_constant) {
                can.extend([("?speed_squared", 0.0), ("?stribeck", 0.0)]);
            }
            if !run.names("temperature").is_empty() {
                can.extend([
                    ("?temperature_wave", dice.within(1.5, 3.0)),
                    ("?temperature_knee", dice.within(-0.3, 0.5)),
                ]);
            }
            if run.has("angle") {
                can.extend([("?angle_square", dice.int(1, 3) as f64), ("?angle_saw", dice.int(1, 4) as f64)]);
            }
            if has("position") && run.kind == "positioning" {
                can.extend([("?drifting_scale", 0.0), ("?position_time_wave", dice.within(0.8, 2.0))]);
            }
            if has("load") {
                can.push(("?load_squared", 0.0));
            }
        }
        let (law, c) = *dice.pick(&can);
        let mut s = Source::new(format!("{law}.{a}")).p("um", dice.sign()).p("c", c);
        if law.starts_with("?temp") {
            s.text = vec![("sensor", dice.pick(&run.names("temperature")).clone())];
        }
        Some(s)
    }
}
