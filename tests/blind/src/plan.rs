//! Random experiments, for training and hold-out alike.

use crate::dice::Dice;
use crate::run::Run;
use std::f64::consts::TAU;

/// A family of cases, with its own experiments and names.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Manner {
    /// The family on which the method was developed.
    First,
    /// Other experiments, column names and noise, for validation.
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
    pub(crate) regular: bool,
    manner: Manner,
    pub(crate) speed_constant: bool,
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
            seed: dice.seed(),
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

    /// One run of the plan.
    /// Another `turn` is another run of the same experiment.
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
}
